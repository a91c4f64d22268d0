"""Path drive: a path of the base that is followed, and how long the robot has been stuck on it."""

from __future__ import annotations

from math import atan2, cos, hypot, sin

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.planning.initial_strip import waypoint_rows
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.strip import Strip
from elastic_strips.strip.followed import FollowedPath

_NODE_SPACING = 0.15  # [m] of the strip along a path
_FURTHER = 0.1  # [m] along the path, by which a robot is no longer stuck
_SAME_HEADING = 0.01  # [rad] there is nothing to turn
_SAME_PLACE = 0.05  # [m] a place that is nearer is in no direction


class PathDrive:
    """Workspace: a path of the base that a robot follows.

    Args:
        robot: the robot; its base moves.
        path: the path.
        yaw: heading [rad] at its end; None: along the path, or as it is for a base that slides.
        joints: (n,) as the joints [rad or m] are to be on it; None: as they are when it begins.
        wait: whether the robot waits where it cannot go on.

    Attributes:
        path, joints, wait: see above.
        told: what it was said to wait for since it got stuck.
    """

    def __init__(
        self, robot: RobotModel, path: FollowedPath, yaw: float | None, joints: Array | None, *, wait: bool
    ) -> None:
        self.path: FollowedPath = path
        self.joints: Array | None = joints
        self.wait: bool = wait
        self.told: set[str] = set()
        self._robot, self._yaw = robot, yaw
        self._goal: Array | None = None
        self._since: float | None = None  # [s] when it got stuck
        self._stuck_at = 0.0  # [m] along the path
        self._laid = -np.inf  # [s] when the strip was laid anew

    def strip_from(self, here: Array, *, turns: bool = False) -> Strip:
        """The strip along the rest of the path from a coordinate row (nv,) on; the joints end as they are to be on it.

        Args:
            here: where it begins.
            turns: whether it goes straight to the path, a little ahead, for which a differential drive first turns on
                the spot: next to what bounds it, an arc may lead out.
        """
        robot, (_, passed) = self._robot, self.path.nearest(here[None, :2])
        points = np.vstack([here[:2], self.path.ahead(float(passed[0]) + (self.path.within if turns else 0.0))])
        goal = self._goal
        if goal is None:
            goal, yaw = here.copy(), self._yaw
            goal[:2] = points[-1]
            if yaw is None and robot.base_kind is BaseKind.DIFF_DRIVE:
                way = self.path.points[-1] - self.path.points[-2]
                yaw = atan2(float(way[1]), float(way[0]))
            if yaw is not None:
                goal[2] = here[2] + atan2(sin(yaw - here[2]), cos(yaw - here[2]))
            base = robot.space.base_nv
            joints = self.joints = here[base:].copy() if self.joints is None else self.joints
            goal[base:] = here[base:] + robot.space.difference(here, np.concatenate([here[:base], joints]))[base:]
            self._goal = goal
        turn = _turn(here, points[1]) if turns and robot.base_kind is BaseKind.DIFF_DRIVE else here[None]
        start, end = robot.space.from_coordinates(np.stack([turn[-1], goal]))
        if float(np.hypot(*np.diff(points, axis=0).T).sum()) < 1e-3:
            return Strip.from_coordinates(robot, np.stack([here, goal]))
        rows = waypoint_rows(robot, start, end, points, spacing=_NODE_SPACING)
        return Strip.from_coordinates(robot, np.vstack([turn[:-1], rows]))

    def stuck(self, t: float, here: Array, *, moves: bool) -> float:
        """For how long [s] the robot has been stuck at the time ``t`` [s], where it stands; 0 while it moves.

        Who moves to and fro before something, and gets no further along the path, stays stuck.
        """
        passed = float(self.path.nearest(here[None, :2])[1][0])
        if moves:
            if passed > self._stuck_at + _FURTHER:
                self._since = None
                self.told.clear()
            return 0.0
        if self._since is None:
            self._since, self._stuck_at = t, passed
        return t - self._since

    def due(self, t: float, every: float) -> bool:
        """Whether the strip is to be laid onto the path anew, which is so at most once in ``every`` [s]."""
        if t - self._laid < every:
            return False
        self._laid = t
        return True


def _turn(here: Array, to: Array) -> Array:
    """(K, nv) rows on which a base turns on the spot, from a row (nv,) until it looks at a place (2,)."""
    x, y = (to - here[:2]).tolist()
    yaw = atan2(y, x) if hypot(x, y) > _SAME_PLACE else float(here[2])
    turn = atan2(sin(yaw - here[2]), cos(yaw - here[2]))
    if abs(turn) < _SAME_HEADING:
        return here[None]
    rows = np.repeat(here[None], int(abs(turn)) + 2, axis=0)
    rows[:, 2] += np.linspace(0.0, turn, len(rows))
    return rows
