"""Study room: the paper's simulations run again, its methods compared, and the report of that."""

from __future__ import annotations

from .reactive import Outcome, ReactiveRun, Sighting, paper_reactively

__all__ = ["Outcome", "ReactiveRun", "Sighting", "paper_reactively"]
