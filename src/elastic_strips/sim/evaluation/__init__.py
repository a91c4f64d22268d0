"""Evaluation of runs, from the true states; it shares no geometry code with the certificate."""

from __future__ import annotations

from .drive_evaluation import Contact, Evaluation, evaluate, protective_separation
from .visibility import seen_obstacles, visible_to

__all__ = ["Contact", "Evaluation", "evaluate", "protective_separation", "seen_obstacles", "visible_to"]
