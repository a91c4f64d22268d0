"""Study room: the paper's simulations run again, its methods compared, and the report of that."""

from __future__ import annotations

from .comparison import CASES, METHODS, TrialResult, compare
from .paper_study import PaperStudy, paper_study
from .simulation import PaperRun, parameter_map, simulate_paper

__all__ = [
    "paper_study",
    "PaperStudy",
    "simulate_paper",
    "PaperRun",
    "compare",
    "TrialResult",
    "CASES",
    "METHODS",
    "parameter_map",
]
