"""Strip room: elastic strips and their deformation; :mod:`elastic_strips.strip.paper` has the paper's own equations."""

from .constraint import AxisTask, kept_as_at
from .deformer import Deformer
from .params import PRESETS, DeformParams
from .report import DeformReport, DeformStatus, ForceField
from .strip import Strip, strip_clearance
from .workspace import Foresight

__all__ = [
    "PRESETS",
    "AxisTask",
    "DeformParams",
    "DeformReport",
    "DeformStatus",
    "Deformer",
    "ForceField",
    "Foresight",
    "Strip",
    "kept_as_at",
    "strip_clearance",
]
