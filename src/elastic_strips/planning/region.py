"""Region: where the base is looked for: the caller's bounds, or a box about start and goal that widens."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ..errors import ConfigurationError, ParameterError
from ..robot import RobotModel
from ..robot.space import Array
from ..scene import Scene
from ..strip import Strip
from .grid_path import FLOOR, footprint

Box2 = tuple[Array, Array]
"""Low and high corner (2,) of an upright box [m]."""

_ROOM = 1.0  # [m] beyond the robot that it gets to pass the outermost obstacle
_LEAST = 2.0  # [m] about start and goal, to turn and to back up


class Region:
    """Boxes of the plane in which the base is looked for.

    Without bounds a box about start and goal is widened until it holds all obstacles and the way around them.

    Args:
        robot: the robot; its base must move.
        scene: the obstacles.
        start, goal: configurations (nq,).
        bounds: low and high corner ((x, y), (x, y)) [m] of a box that the base does not leave.

    Attributes:
        given: the caller's bounds, or None.
        cover: the box beyond which there is nothing to be passed; the bounds where they are given.

    Raises:
        ParameterError: bounds of another shape, not finite, or empty.
        ConfigurationError: start or goal is outside of the bounds.
    """

    def __init__(
        self, robot: RobotModel, scene: Scene, start: Array, goal: Array, bounds: npt.ArrayLike | None = None
    ) -> None:
        self.ends = robot.space.to_chart(np.stack((start, goal)))[:, :2]
        self.given = None if bounds is None else _checked(bounds, self.ends)
        self.cover = self._cover(robot, scene, start, goal) if self.given is None else self.given

    @staticmethod
    def of(robot: RobotModel, scene: Scene, start: Array, goal: Array, bounds: npt.ArrayLike | None) -> Region | None:
        """The region of a robot whose base moves; None for a fixed base.

        Raises:
            ParameterError, ConfigurationError: bounds for a fixed base, or as :class:`Region`.
        """
        if robot.space.planar:
            return Region(robot, scene, start, goal, bounds)
        if bounds is not None:
            raise ParameterError(f"bounds={bounds!r}: the base of {robot.name!r} is fixed; leave them out")
        return None

    def _cover(self, robot: RobotModel, scene: Scene, start: Array, goal: Array) -> Box2:
        bodies = [footprint(robot, q) for q in (start, goal, robot.home_q)]
        outer, height = max(b.outer for b in bodies), max(b.height for b in bodies)
        table = scene.table
        low, high = table.center - table.half_extents, table.center + table.half_extents
        counts = (low[:, 2] < height) & (high[:, 2] > FLOOR)
        least, room = max(_LEAST, outer + _ROOM), outer + _ROOM
        corners = np.vstack((self.ends - least, self.ends + least, low[counts, :2] - room, high[counts, :2] + room))
        return np.min(corners, axis=0), np.max(corners, axis=0)

    def box(self, widen: float) -> Box2:
        """The box that reaches ``widen`` [m] beyond start and goal, no further than anything is; or the bounds."""
        low, high = self.cover
        if self.given is None:
            low = np.maximum(low, self.ends.min(axis=0) - widen)
            high = np.minimum(high, self.ends.max(axis=0) + widen)
        return low, high

    def boxes(self, widen: float) -> Iterator[Box2]:
        """Boxes that reach ``widen`` [m] beyond start and goal, then twice as far, until one is all there is."""
        while True:
            low, high = self.box(widen)
            yield low, high
            if np.array_equal(low, self.cover[0]) and np.array_equal(high, self.cover[1]):
                return
            widen *= 2.0

    def left_by(self, strip: Strip) -> float:
        """How far [m] the base leaves the caller's bounds on a strip; 0 without bounds."""
        if self.given is None:
            return 0.0
        low, high = self.given
        path = strip.robot.space.to_chart(strip.sample(0.1))[:, :2]
        return float(max((low - path).max(), (path - high).max(), 0.0))


def _checked(bounds: npt.ArrayLike, ends: Array) -> Box2:
    try:
        corners = np.array(bounds, dtype=float)
    except (TypeError, ValueError):
        corners = np.zeros(0)
    if corners.shape != (2, 2) or not np.isfinite(corners).all():
        raise ParameterError(f"bounds={bounds!r} must be ((x, y), (x, y)): two corners of finite numbers [m]")
    low, high = corners[0], corners[1]
    if not (low < high).all():
        raise ParameterError(f"bounds={bounds!r}: the first corner must lie below the second in x and y")
    for what, at in zip(("start", "goal"), ends, strict=True):
        if (at < low).any() or (at > high).any():
            raise ConfigurationError(
                f"{what}: the base at x={at[0]:.6g}, y={at[1]:.6g} m is outside of bounds={corners.tolist()}"
            )
    return low, high
