"""OMPL: paths of the whole body by sampling, in boxes that widen."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array

from ..errors import ConfigurationError, ParameterError
from ..robot import BaseKind, RobotModel
from ..scene import Scene
from ..strip import Strip
from .deadline import Deadline
from .grid_path import FLOOR, footprint
from .validity import Validity

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


JOINT_WEIGHT = 0.3
"""Weight [m/rad] of joint distances against base distances."""
_OMPL = threading.Lock()
"""OMPL draws all its seeds from one generator of the process: one search at a time, or seeds mean nothing."""
_BASE_STEP = 0.07  # spacing of validity checks [m]
_JOINT_STEP = 0.2  # and in joint space [rad]; the certificate, not the planner, vouches for what lies between


@dataclass(frozen=True, slots=True)
class PathResult:
    """What the planner found.

    Attributes:
        chart: (N, nv) waypoints along the path, or None where none was found.
        reason: why there is none, else empty.
        checks: configurations checked.
        seconds: planning and simplification.
        searched: whether it was searched at all; not where an end is too near something.
    """

    chart: Array | None
    reason: str
    checks: int
    seconds: float
    searched: bool = True


def ompl_path(
    robot: RobotModel,
    scene: Scene,
    start: Array,
    goal: Array,
    *,
    seed: int,
    margin: float,
    timeout: float,
    turning_radius: float = 0.3,
    spacing: float = 0.12,
    widen: float = 2.0,
    box: tuple[Array, Array] | None = None,
    fineness: float = 1.0,
    most: int | None = None,
    deadline: Deadline | None = None,
) -> PathResult:
    """A path found by RRTConnect, shortcut, and sampled into waypoints.

    The base of a differential drive moves on Reeds–Shepp curves (arcs and lines, forwards and backwards), which its
    wheels can follow; an omnidirectional one on straight lines of SE(2); the joints move in step.

    Threads wait for each other, so that equal seeds give equal paths in each.

    Args:
        robot: the robot.
        scene: the obstacles.
        start, goal: valid configurations (nq,).
        seed: of OMPL's random numbers.
        margin: distance to keep to obstacles [m].
        timeout: longest search [s].
        turning_radius: of the Reeds–Shepp curves [m].
        spacing: distance between waypoints [m].
        widen: how far beyond start and goal the base may go [m].
        box: low and high corner (2,) of where the base may go [m], instead of ``widen``.
        fineness: configurations on an edge are checked so many times as densely as usual.
        most: waypoints at most.
        deadline: until when to wait for other threads, to search and to shorten the path; none where None.

    Raises:
        ParameterError: a fineness that is not positive.
    """
    if not fineness > 0.0:
        raise ParameterError(f"ompl_path: fineness={fineness!r} must be > 0")
    began = Deadline(timeout)
    space = robot.space
    ends = space.to_chart(np.stack((start, goal)))
    low, high = (ends[:, :2].min(axis=0) - widen, ends[:, :2].max(axis=0) + widen) if box is None else box
    planar = space.planar
    valid = Validity(robot, scene, margin=margin, low=low if planar else None, high=high if planar else None)
    for name, q in (("start", start), ("goal", goal)):
        if not valid(q):
            return PathResult(
                None, f"{name} is nearer than {margin:.3f} m to an obstacle", valid.checks, began.spent, False
            )
    patience = threading.TIMEOUT_MAX if deadline is None else min(max(deadline.left, 0.0), threading.TIMEOUT_MAX)
    if not _OMPL.acquire(timeout=patience):
        return PathResult(None, "another thread's search with OMPL took all the time", valid.checks, began.spent, False)
    try:
        left = timeout if deadline is None else min(timeout, deadline.left)
        chart = None
        if left > 0.0:
            chart = _search(
                robot, valid, ends, low, high, seed, left, turning_radius, spacing, fineness, most, deadline
            )
    finally:
        _OMPL.release()
    if chart is None:
        return PathResult(None, f"RRTConnect found no path in {max(left, 0.0):.2f} s", valid.checks, began.spent)
    return PathResult(chart, "", valid.checks, began.spent)


def _search(
    robot: RobotModel, valid: Validity, ends: Array, low: Array, high: Array, seed: int, timeout: float,
    turning_radius: float, spacing: float, fineness: float, most: int | None, deadline: Deadline | None,
) -> Array | None:  # fmt: skip
    """Chart rows of a path, or None; for one thread at a time."""
    from ompl import base as ob
    from ompl import geometric as og
    from ompl import util as ou

    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(seed % 2**31 + 1)
    planar = robot.space.planar
    states = _state_space(robot, ob, low, high, turning_radius)
    setup = og.SimpleSetup(states)
    info = setup.getSpaceInformation()
    reader = _Reader(robot)

    def is_valid(state: Any) -> bool:  # when the time is over no further edge is taken, and no shortcut
        return (deadline is None or not deadline.over()) and valid(reader.configuration(state))

    setup.setStateValidityChecker(is_valid)
    for k in range(states.getSubspaceCount()):
        part = states.getSubspace(k)
        step = (_BASE_STEP if planar and k == 0 else _JOINT_STEP) / fineness
        part.setLongestValidSegmentFraction(min(step / part.getMaximumExtent(), 0.5))
    first, last = states.allocState(), states.allocState()
    reader.write(first, ends[0])
    reader.write(last, ends[1])
    setup.setStartAndGoalStates(first, last, 1e-6)
    planner = og.RRTConnect(info)
    planner.setRange(1.5 if planar else 0.6)
    setup.setPlanner(planner)
    if not setup.solve(timeout) or not setup.haveExactSolutionPath():
        return None
    path = setup.getSolutionPath()
    simplifier = og.PathSimplifier(info)
    simplifier.reduceVertices(path, 12, 6)
    simplifier.partialShortcutPath(path, 12, 6)
    count = max(math.ceil(path.length() / spacing) + 1, 5)
    path.interpolate(count if most is None else min(count, most))
    chart = np.array([reader.chart(s) for s in path.getStates()])
    chart[0], chart[-1] = ends
    if planar:
        chart[:, 2] = np.unwrap(chart[:, 2])
    if most is not None and len(chart) > most:
        chart = chart[np.linspace(0, len(chart) - 1, most).round().astype(int)]
    return chart


def _state_space(robot: RobotModel, ob: Any, low: Array, high: Array, turning_radius: float) -> Any:
    space = robot.space
    nj = space.nv - space.base_nv
    compound = ob.CompoundStateSpace()
    if space.planar:
        drive = robot.base_kind is BaseKind.DIFF_DRIVE
        base = ob.ReedsSheppStateSpace(turning_radius) if drive else ob.SE2StateSpace()
        bounds = ob.RealVectorBounds(2)
        for i in range(2):
            bounds.setLow(i, float(low[i]))
            bounds.setHigh(i, float(high[i]))
        base.setBounds(bounds)
        compound.addSubspace(base, 1.0)
    if nj:
        joints = ob.RealVectorStateSpace(nj)
        bounds = ob.RealVectorBounds(nj)
        for i in range(nj):
            lo, hi = space.lower[space.base_nv + i], space.upper[space.base_nv + i]
            bounds.setLow(i, float(lo) if np.isfinite(lo) else -np.pi)
            bounds.setHigh(i, float(hi) if np.isfinite(hi) else np.pi)
        joints.setBounds(bounds)
        compound.addSubspace(joints, JOINT_WEIGHT if space.planar else 1.0)
    return compound


class _Reader:
    """Reads and writes OMPL states of :func:`_state_space`."""

    def __init__(self, robot: RobotModel) -> None:
        self._space = robot.space
        self._planar = robot.space.planar
        self._nj = robot.space.nv - robot.space.base_nv
        self._q = robot.home_q.copy()
        self._plain = not robot.space.circular.any() and bool(
            (robot.space.idx_q == np.arange(self._nj) + (4 if self._planar else 0)).all()
        )

    def configuration(self, state: Any) -> Array:
        """The state as a configuration (nq,), in a buffer that the next call overwrites."""
        if not self._plain:
            return self._space.from_chart(self.chart(state))
        q = self._q
        offset = 0
        if self._planar:
            base = state[0]
            yaw = base.getYaw()
            q[0], q[1], q[2], q[3] = base.getX(), base.getY(), math.cos(yaw), math.sin(yaw)
            offset = 4
        if self._nj:
            joints = state[1 if self._planar else 0]
            for i in range(self._nj):
                q[offset + i] = joints[i]
        return q

    def chart(self, state: Any) -> Array:
        row = np.zeros(self._space.nv)
        if self._planar:
            base = state[0]
            row[:3] = base.getX(), base.getY(), base.getYaw()
        if self._nj:
            joints = state[1 if self._planar else 0]
            row[self._space.base_nv :] = [joints[i] for i in range(self._nj)]
        return row

    def write(self, state: Any, row: Array) -> None:
        if self._planar:
            state[0].setX(float(row[0]))
            state[0].setY(float(row[1]))
            yaw = math.remainder(float(row[2]), 2.0 * math.pi)
            state[0].setYaw(yaw if yaw < math.pi else -math.pi)  # OMPL refuses pi itself as out of bounds
        if self._nj:
            joints = state[1 if self._planar else 0]
            for i in range(self._nj):
                joints[i] = float(row[self._space.base_nv + i])
