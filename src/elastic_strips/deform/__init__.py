"""Deformation: one tick of a strip, its parameters and its report."""

from .deformer import Deformer
from .params import PRESETS, DeformParams
from .report import DeformReport, DeformStatus, ForceField
from .task import AxisTask, kept_as_at
from .workspace import Prediction

__all__ = [
    "PRESETS",
    "AxisTask",
    "DeformParams",
    "DeformReport",
    "DeformStatus",
    "Deformer",
    "ForceField",
    "Prediction",
    "kept_as_at",
]
