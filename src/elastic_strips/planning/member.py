"""Member of a family: one strip with the workspace that deforms it."""

from __future__ import annotations

import numpy as np

from ..deform import Deformer, DeformParams, DeformReport
from ..robot import RobotModel
from ..scene import Scene
from .alternatives import Alternative, strip_cost


class Member:
    """One strip with the workspace that deforms it."""

    def __init__(self, robot: RobotModel, params: DeformParams, found: Alternative) -> None:
        self.deformer = Deformer(robot, params)
        self.report, self.base_class, self.method = found.report, found.base_class, found.method
        self.origin = found.strip.chart[0].copy()  # where the robot was when it was planned
        self.broken = self.better = 0  # ticks in a row, of those in which it was deformed

    def deform(self, scene: Scene) -> None:
        self.report = self.deformer.step(self.report.strip, scene)
        self.broken = 0 if self.report.usable else self.broken + 1

    @property
    def travelled(self) -> float:
        """How far from there it begins now [m]; 0 for a fixed base."""
        strip = self.report.strip
        return float(np.hypot(*(strip.chart[0] - self.origin)[:2])) if strip.robot.space.planar else 0.0

    @property
    def cost(self) -> float:
        return strip_cost(self.report, self.deformer.params)

    def alternative(self) -> Alternative:
        r = self.report
        return Alternative(r.strip, r, self.base_class, self.method, r.strip.length, self.cost)


def fault(report: DeformReport) -> str:
    """Why a strip is of no use."""
    broken = report.certificate.broken
    return str(broken) if broken is not None else report.reason
