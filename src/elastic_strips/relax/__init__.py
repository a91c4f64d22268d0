"""Relaxation: forces become bounded displacements, explicitly (the paper) or implicitly (the default)."""

from .explicit import explicit_step
from .implicit import BandedSolver
from .rolling import ROLLING_TOLERANCE, project_rolling

__all__ = ["ROLLING_TOLERANCE", "BandedSolver", "explicit_step", "project_rolling"]
