"""Sampling: paths of the whole body by OMPL, and the checks of configurations and edges that they rest on."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision import Certificate
from elastic_strips.errors import ParameterError
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import Strip
from elastic_strips.strip.deformer import Deformer
from elastic_strips.strip.solver import project_rolling

from .problem import Deadline
from .validity import Checker, ValidityChecker

if TYPE_CHECKING:
    from ompl.base import RealVectorBounds
    from ompl.geometric import SimpleSetup

_JOINT_WEIGHT = 0.3  # [m/rad] of joint distances against base distances
OMPL_LOCK = threading.Lock()
"""OMPL draws all its seeds from one generator of the process: one search at a time, or seeds mean nothing."""
_STATE_SPACE_MARGIN = 2.0  # [m] the base may go so far beyond start and goal
_TURNING_RADIUS = 0.3  # of the Reeds–Shepp curves [m]
_BASE_STEP = 0.07  # spacing of validity checks [m]
_TURN_STEP = 0.14  # of a base that turns on the spot [rad]
_BASE_RANGE, _JOINT_RANGE = 1.5, 0.6  # longest edge of a tree, of base and joints together and of joints alone
_JOINT_STEP = 0.2  # and in joint space [rad]; what lies between is proven by the certificate, not the planner


@dataclass(frozen=True, slots=True)
class PathResult:
    """The result of the planner.

    Attributes:
        rows: (N, nv) waypoints along the path, or None where none was found.
        reason: why there is no path; empty where there is one.
        checks: number of configurations checked.
        searched: whether there was a search at all; there is none where an end is too near something.
    """

    rows: Array | None
    reason: str
    checks: int
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
    spacing: float = 0.12,
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
        seed: seed of OMPL's random numbers.
        margin: distance to keep to obstacles [m].
        timeout: longest search [s]; in seconds of work if the deadline bounds work.
        spacing: distance between waypoints [m].
        box: low and high corner (2,) of the area where the base may go [m]; 2 m beyond start and goal where None.
        fineness: how many times as densely as usual configurations on an edge are checked.
        most: largest number of waypoints.
        deadline: end of waiting for other threads, of the search and of shortening the path; no end where None.

    Raises:
        ParameterError: a fineness that is not positive.
    """
    if not fineness > 0.0:
        raise ParameterError(f"ompl_path: fineness={fineness!r} must be > 0")
    space = robot.space
    endpoints = space.to_coordinates(np.stack((start, goal)))
    base = endpoints[:, :2]
    low, high = (base.min(axis=0) - _STATE_SPACE_MARGIN, base.max(axis=0) + _STATE_SPACE_MARGIN) if box is None else box
    planar = space.planar
    valid = ValidityChecker(robot, scene, margin=margin, low=low if planar else None, high=high if planar else None)
    for name, q in (("start", start), ("goal", goal)):
        if not valid(q):
            return PathResult(None, f"{name} is nearer than {margin:.3f} m to an obstacle", valid.checks, False)
    if not OMPL_LOCK.acquire(timeout=waiting(deadline)):
        return PathResult(None, "another thread's search with OMPL took all the time", valid.checks, False)
    try:
        search = Deadline(timeout) if deadline is None else deadline.within(timeout)
        rows, left = None, search.left
        if left > 0.0:
            found = _search(valid, endpoints, (low, high), seed, fineness, search, deadline)
            rows = None if found is None else _rows_along(found, robot, endpoints, spacing, most)
    finally:
        OMPL_LOCK.release()
        valid.count()
    if rows is None:
        return PathResult(None, f"RRTConnect found no path in {max(left, 0.0):.2f} s", valid.checks)
    return PathResult(rows, "", valid.checks)


def waiting(deadline: Deadline | None) -> float:
    """How long [s] a thread waits for others' searches."""
    return threading.TIMEOUT_MAX if deadline is None else min(max(deadline.time_left, 0.0), threading.TIMEOUT_MAX)


def ended(valid: Checker, deadline: Deadline) -> bool:
    """Whether a search is over, with what was checked so far."""
    if deadline.of_work:
        valid.count()
    return deadline.over()


def solved(setup: SimpleSetup, valid: Checker, search: Deadline) -> bool:
    """Whether OMPL found a whole path; a search that only time ends uses OMPL's own clock, which costs nothing."""
    from ompl import base as ob

    until = ob.PlannerTerminationCondition(lambda: ended(valid, search)) if search.of_work else search.left
    return bool(setup.solve(until)) and setup.haveExactSolutionPath()


def seed_ompl(seed: int) -> None:
    """Quiet OMPL, and let it draw its numbers from this seed; with ``OMPL_LOCK`` held."""
    from ompl import util as ou

    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(seed % 2**31 + 1)


def _search(
    valid: ValidityChecker,
    endpoints: Array,
    box: tuple[Array, Array],
    seed: int,
    fineness: float,
    search: Deadline,
    deadline: Deadline | None,
) -> SimpleSetup | None:
    """OMPL with a path between two rows (2, nv), or None; for one thread at a time."""
    from ompl import geometric as og

    seed_ompl(seed)
    robot = valid.robot
    states = _state_space(robot, *box)
    setup = og.SimpleSetup(states)
    _set_steps(states, robot, fineness)
    reader = _Reader(robot)

    def is_valid(state: Any) -> bool:  # when the time is over no further edge is taken, and no shortcut
        if deadline is not None and ended(valid, deadline):
            return False
        return valid(reader.configuration(state)) if valid.native is None else valid.at(reader.row(state))

    setup.setStateValidityChecker(is_valid)
    first, last = states.allocState(), states.allocState()
    reader.write(first, endpoints[0])
    reader.write(last, endpoints[1])
    setup.setStartAndGoalStates(first, last, 1e-6)
    planner = og.RRTConnect(setup.getSpaceInformation())
    planner.setRange(_BASE_RANGE if robot.space.planar else _JOINT_RANGE)
    setup.setPlanner(planner)
    return setup if solved(setup, valid, search) else None


def _rows_along(setup: SimpleSetup, robot: RobotModel, endpoints: Array, spacing: float, most: int | None) -> Array:
    """Rows (N, nv) along the path that OMPL found, without its detours."""
    from ompl import geometric as og

    path, reader = setup.getSolutionPath(), _Reader(robot)
    simplifier = og.PathSimplifier(setup.getSpaceInformation())
    simplifier.reduceVertices(path, 12, 6)
    simplifier.partialShortcutPath(path, 12, 6)
    count = max(math.ceil(path.length() / spacing) + 1, 5)
    path.interpolate(count if most is None else min(count, most))
    rows = np.array([reader.row(s) for s in path.getStates()])
    rows[0], rows[-1] = endpoints
    if robot.space.planar:
        rows[:, 2] = np.unwrap(rows[:, 2])
    if most is not None and len(rows) > most:
        rows = rows[np.linspace(0, len(rows) - 1, most).round().astype(int)]
    return rows


def _set_steps(states: Any, robot: RobotModel, fineness: float) -> None:
    """Have edges looked at in steps of the base and of the joints, ``fineness`` times as densely as usual."""
    for k in range(states.getSubspaceCount()):
        part, of_base = states.getSubspace(k), robot.space.planar and k == 0
        parts = {part: _BASE_STEP if of_base else _JOINT_STEP}
        if of_base and robot.base_kind is not BaseKind.DIFF_DRIVE:
            # SE(2) asks its own two spaces; Reeds–Shepp curves are measured by themselves
            parts = {part.getSubspace(0): _BASE_STEP, part.getSubspace(1): _TURN_STEP}
        for one, step in parts.items():
            one.setLongestValidSegmentFraction(min(step / fineness / one.getMaximumExtent(), 0.5))


def _state_space(robot: RobotModel, low: Array, high: Array) -> Any:
    from ompl import base as ob

    space = robot.space
    nj = space.nv - space.base_nv
    compound = ob.CompoundStateSpace()
    if space.planar:
        drive = robot.base_kind is BaseKind.DIFF_DRIVE
        base = ob.ReedsSheppStateSpace(_TURNING_RADIUS) if drive else ob.SE2StateSpace()
        base.setBounds(real_bounds(low, high))
        compound.addSubspace(base, 1.0)
    if nj:
        joints = ob.RealVectorStateSpace(nj)
        lower, upper = space.lower[space.base_nv :], space.upper[space.base_nv :]
        joints.setBounds(
            real_bounds(np.where(np.isfinite(lower), lower, -np.pi), np.where(np.isfinite(upper), upper, np.pi))
        )
        compound.addSubspace(joints, _JOINT_WEIGHT if space.planar else 1.0)
    return compound


def real_bounds(low: Array, high: Array) -> RealVectorBounds:
    """OMPL's bounds of a space of real numbers."""
    from ompl import base as ob

    bounds = ob.RealVectorBounds(len(low))
    for i, (least, most) in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
        bounds.setLow(i, least)
        bounds.setHigh(i, most)
    return bounds


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
            return self._space.from_coordinates(self.row(state))
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

    def row(self, state: Any) -> Array:
        row, b = np.empty(self._space.nv), self._space.base_nv
        if self._planar:
            base = state[0]
            row[0], row[1], row[2] = base.getX(), base.getY(), base.getYaw()
        if self._nj:
            joints = state[1 if self._planar else 0]
            for k in range(self._nj):
                row[b + k] = joints[k]
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


def certify_path(deformer: Deformer, scene: Scene, rows: Array) -> Certificate:
    """The certificate of a path as it is, edge by edge, with the clearances of the deformer's parameters.

    A differential drive's waypoints are first moved, as little as possible, until wheels can follow them.

    Args:
        deformer: a workspace of the robot; its knowledge of other strips is lost.
        scene: the obstacles.
        rows: waypoints (N, nv).
    """
    robot = deformer.robot
    if robot.base_kind is BaseKind.DIFF_DRIVE:
        rows, _ = project_rolling(robot.space, rows)
    return deformer.certify(Strip.from_coordinates(robot, rows), scene)
