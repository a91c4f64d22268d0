"""Evaluation: what became of a run, from the true states; it shares no geometry with the certificate."""

from __future__ import annotations

from .laser_view import Visibility, seen_obstacles, visible_to
from .separation import protective_separation
from .verdict import REST_SPEED, Contact, Verdict, judge
from .visibility import unseen_contacts

__all__ = [
    "REST_SPEED",
    "Contact",
    "Verdict",
    "Visibility",
    "judge",
    "protective_separation",
    "seen_obstacles",
    "unseen_contacts",
    "visible_to",
]
