"""Paths from OMPL: RRTConnect over base and joints, in a space whose straight motions the base can drive."""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from ..errors import ParameterError
from ..robot import BaseKind, RobotModel
from ..robot.space import Array
from ..scene import Scene
from .validity import Validity

JOINT_WEIGHT = 0.3
"""Weight [m/rad] of joint distances against base distances."""
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
    """

    chart: Array | None
    reason: str
    checks: int
    seconds: float


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
    fineness: float = 1.0,
) -> PathResult:
    """A path found by RRTConnect, shortcut, and sampled into waypoints.

    The base of a differential drive moves on Reeds–Shepp curves (arcs and lines, forwards and backwards), which its
    wheels can follow; an omnidirectional one on straight lines of SE(2); the joints move in step.

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
        fineness: configurations on an edge are checked so many times as densely as usual.

    Raises:
        ParameterError: a fineness that is not positive.
    """
    if not fineness > 0.0:
        raise ParameterError(f"ompl_path: fineness={fineness!r} must be > 0")
    from ompl import base as ob
    from ompl import geometric as og
    from ompl import util as ou

    began = perf_counter()
    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(seed % 2**31 + 1)
    space = robot.space
    ends = space.to_chart(np.stack((start, goal)))
    low, high = ends[:, :2].min(axis=0) - widen, ends[:, :2].max(axis=0) + widen
    planar = space.planar
    valid = Validity(robot, scene, margin=margin, low=low if planar else None, high=high if planar else None)
    states = _state_space(robot, ob, low, high, turning_radius)
    setup = og.SimpleSetup(states)
    info = setup.getSpaceInformation()
    reader = _Reader(robot)

    def is_valid(state: Any) -> bool:
        return valid(reader.configuration(state))

    setup.setStateValidityChecker(is_valid)
    for k in range(states.getSubspaceCount()):
        part = states.getSubspace(k)
        step = (_BASE_STEP if planar and k == 0 else _JOINT_STEP) / fineness
        part.setLongestValidSegmentFraction(min(step / part.getMaximumExtent(), 0.5))
    first, last = states.allocState(), states.allocState()
    reader.write(first, ends[0])
    reader.write(last, ends[1])
    for name, q in (("start", start), ("goal", goal)):
        if not valid(q):
            return PathResult(
                None, f"{name} is nearer than {margin:.3f} m to an obstacle", valid.checks, perf_counter() - began
            )
    setup.setStartAndGoalStates(first, last, 1e-6)
    planner = og.RRTConnect(info)
    planner.setRange(1.5 if planar else 0.6)
    setup.setPlanner(planner)
    solved = setup.solve(timeout)
    if not solved or not setup.haveExactSolutionPath():
        return PathResult(None, f"RRTConnect found no path in {timeout:.2f} s", valid.checks, perf_counter() - began)
    path = setup.getSolutionPath()
    simplifier = og.PathSimplifier(info)
    simplifier.reduceVertices(path, 12, 6)
    simplifier.partialShortcutPath(path, 12, 6)
    length = path.length()
    path.interpolate(max(math.ceil(length / spacing) + 1, 5))
    chart = np.array([reader.chart(s) for s in path.getStates()])
    chart[0], chart[-1] = ends
    if planar:
        chart[:, 2] = np.unwrap(chart[:, 2])
    return PathResult(chart, "", valid.checks, perf_counter() - began)


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
