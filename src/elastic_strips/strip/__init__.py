"""Strip room: elastic strips and their deformation; :mod:`elastic_strips.strip.paper` has the paper's own equations."""

import numpy  # noqa: F401  Coal loads it, too, and crashes where Ctrl-C comes meanwhile

from .constraint import AxisConstraint, LookAt, OrientationConstraint
from .deformer import Deformer
from .params import DeformParams
from .repair import RepairReport, displacement, repair
from .report import DeformReport, DeformStatus
from .strip import Strip, strip_clearance

__all__ = [
    "AxisConstraint",
    "DeformParams",
    "DeformReport",
    "DeformStatus",
    "Deformer",
    "LookAt",
    "OrientationConstraint",
    "RepairReport",
    "Strip",
    "displacement",
    "repair",
    "strip_clearance",
]
