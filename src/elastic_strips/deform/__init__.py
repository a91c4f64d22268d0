"""Deformation: one tick of a strip, its parameters and its report."""

from .deformer import Deformer
from .params import PRESETS, DeformParams
from .report import DeformReport, DeformStatus, ForceField
from .workspace import Foresight

__all__ = ["PRESETS", "DeformParams", "DeformReport", "DeformStatus", "Deformer", "ForceField", "Foresight"]
