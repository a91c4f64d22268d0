"""Strip room: elastic strips and their deformation; :mod:`elastic_strips.strip.paper` has the paper's own equations."""

from .base_deformer import NodePredictor
from .constraint import OrientationConstraint
from .deformer import Deformer
from .params import DeformParams
from .report import DeformReport, DeformStatus, StripForces
from .strip import Strip, strip_clearance

__all__ = [
    "Strip",
    "strip_clearance",
    "Deformer",
    "DeformParams",
    "DeformReport",
    "DeformStatus",
    "StripForces",
    "OrientationConstraint",
    "NodePredictor",
]
