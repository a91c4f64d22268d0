"""Evaluation: what became of a run, from the true states; it shares no geometry with the certificate."""

from __future__ import annotations

from .drive_evaluation import REST_SPEED, Contact, Evaluation, evaluate, protective_separation
from .visibility import Visibility, seen_obstacles, unseen_contacts, visible_to

__all__ = [
    "REST_SPEED",
    "Contact",
    "Evaluation",
    "Visibility",
    "evaluate",
    "protective_separation",
    "seen_obstacles",
    "unseen_contacts",
    "visible_to",
]
