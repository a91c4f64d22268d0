"""Execution room, replanning: when a strip has to be planned anew, and how."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..errors import ElasticStripsError
from ..planning import PlanReport, plan_report
from ..robot import RobotModel
from ..scene import Box, Obstacle, Scene
from ..strip import Strip
from .params import DriveParams
from .proposal import Proposal

_STANDING = 0.05
"""An obstacle that is slower than this [m/s] counts as standing for a planner."""
_TIMEOUT = 4.0
_BERTH, _MOST_BERTH = 0.2, 0.6
"""What stands but can move is kept away from by so much more [m] with every further plan, and at most."""


class Replanner:
    """Workspace: watches the strip, decides when it is given up, and plans another one.

    Args:
        robot: whose strips.
        params: of the drive.
        seed: of the planner.
        grid: whether a way over a grid may be used.

    Attributes:
        halted: whether the robot has to stop because what stands keeps the strip broken.
        pending: whether planning anew has been decided on; who has it done takes that back. due: time [s] at which its
            result is there.
        count: how often it was done.
    """

    def __init__(self, robot: RobotModel, params: DriveParams, *, seed: int, grid: bool) -> None:
        self.robot, self.params, self.seed, self.grid = robot, params, seed, grid
        self.deform = params.deform.replaced(clearance=max(params.deform.clearance, params.clearance))
        self.halted = self.pending = False
        self.due = 0.0
        self.count = 0
        self._since: float | None = None

    def plan(
        self, scene: Scene, start: npt.ArrayLike, goal: npt.ArrayLike, *, path: npt.ArrayLike | None = None
    ) -> PlanReport:
        """A strip among what stands; moving obstacles are left to the strip.

        Raises:
            ConfigurationError: start or goal is not sound, or in collision.
        """
        return plan_report(
            self.robot, standing(scene), start, goal, seed=self.seed, params=self.deform, path=path, grid=self.grid
        )

    def watch(self, t: float, proposal: Proposal, scene: Scene, *, at_rest: bool) -> str:
        """Look at a tick's strip; returns why it is to be planned anew, or "".

        A strip that what stands keeps broken is given up after a while, and the robot stops for it; so is one that
        leads nowhere while the robot stands. What moves on is waited for.
        """
        broken = proposal.report.certificate.broken
        by_standing = broken is not None and not _moves(scene, broken.obstacle)
        if not by_standing and (proposal.accepted or not at_rest):
            self._since, self.halted = None, False
            return ""
        if self._since is None:
            self._since = t
        if t - self._since <= self.params.replan_after * (1 + self.count):
            return ""
        self.halted = by_standing
        if not at_rest:
            return ""
        self._since, self.pending, self.due = None, True, t + self.params.replan_time
        return f"the strip is broken: {broken}" if by_standing else proposal.reason

    def plan_anew(self, scene: Scene, start: npt.ArrayLike, goal: npt.ArrayLike) -> tuple[Strip | None, str]:
        """Another strip, or None, and what happened.

        Somebody who stands may walk on: a strip close by has been of no use, and the next one leads past at a
        distance, or on another side, where there is room for that.
        """
        berth = min(_BERTH * self.count, _MOST_BERTH)
        self.count += 1
        still, reason = standing(scene), ""
        mobile = [o for o in still if scene.obstacle(o.name or "").motion is not None] if berth else []
        widths = (berth, 0.5 * berth, 0.0) if mobile else (0.0,)
        for width in widths:
            around = Scene([*still, *(_around(o, width) for o in mobile)], time=still.time) if width else still
            try:
                report = plan_report(
                    self.robot, around, start, goal, seed=self.seed + self.count, params=self.deform,
                    timeout=_TIMEOUT / len(widths), line=False, grid=self.grid,
                )  # fmt: skip
            except ElasticStripsError as error:
                reason = f"failed: {error}"
                continue
            if report.certified:
                self.halted = False
                return report.strip, report.reason
            reason = report.reason
        return None, reason


def standing(scene: Scene) -> Scene:
    """What a planner of still scenes gets: the obstacles that stand."""
    still = [o for o in scene if o.motion is None or np.linalg.norm(o.velocity()[0]) < _STANDING]
    return Scene([o.sensed(o.pose, None) for o in still], time=scene.time)


def _around(obstacle: Obstacle, width: float) -> Obstacle:
    """An upright box about an obstacle, wider than it by ``width`` [m] on every side."""
    rotation, shift = obstacle.pose[:3, :3], obstacle.pose[:3, 3]
    centre = np.array([rotation @ part.center + shift for part in obstacle.parts])
    half = np.array([np.abs(rotation) @ part.half_extents for part in obstacle.parts])
    low, high = (centre - half).min(axis=0), (centre + half).max(axis=0)
    size = high - low + 2.0 * width * np.array([1.0, 1.0, 0.0])
    return Box(size, at=0.5 * (low + high), name=f"about {obstacle.name}")


def _moves(scene: Scene, name: str) -> bool:
    return name in scene and scene.obstacle(name).motion is not None
