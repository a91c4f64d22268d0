"""Preset ``paper``: Eqs. 2-9 of the paper as printed, at its control points; the base moves as if omnidirectional."""

from .deformer import PaperDeformer, PaperParams, PaperReport

__all__ = ["PaperDeformer", "PaperParams", "PaperReport"]
