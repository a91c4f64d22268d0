"""Study room: the paper's simulations run again, its methods compared, and the report of that."""

from __future__ import annotations

from .comparison import CASES, METHODS, Row, Trial, attempt, compare
from .paper_study import PaperStudy, paper_study
from .parameter_map import Cell, parameter_map
from .reactive import Outcome, ReactiveRun, Sighting, paper_reactively

__all__ = [
    "paper_study",
    "PaperStudy",
    "paper_reactively",
    "ReactiveRun",
    "Sighting",
    "Outcome",
    "compare",
    "attempt",
    "Trial",
    "Row",
    "CASES",
    "METHODS",
    "parameter_map",
    "Cell",
]
