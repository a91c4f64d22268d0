"""Inverse kinematics of the whole body: many starts at once, within joint limits, by damped least squares.

All starts take their steps together, in arrays; one that stalls is begun anew elsewhere. Obstacles are not looked at.
The damping is that of Sugihara (2011): half of the squared error, which is robust far away and quick nearby.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, ArrayLike, Mask
from elastic_strips.errors import ParameterError, RobotError, nearest_name
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.summary import Summary
from elastic_strips.validation import check_array

from .kinematics import Kinematics, find_frame
from .value import RobotValue

_ANGLE_LEVER = 0.3  # [m/rad] weight of an angle against a distance
_LEAST_DAMPING = 1e-6  # of the damping
_LONGEST_STEP = 0.6  # [rad or m] longest of any coordinate at once
_CONVERGED_ERROR = 1e-6  # [m] of the weighted error
_ROUND_ITERATIONS = 40  # of a round
_ROUND_STARTS = 16  # of a round
_MOST_ROUNDS = 8
_STALL_ITERATIONS, _STALL_RATIO = 12, 0.9  # a start whose error is not below 0.9 of what it was 12 iterations ago
_BASE_WEIGHT = 0.05  # of the base's motion: it moves little where joints do
_SAME_SOLUTION = 1e-2  # [rad or m] that two solutions differ in at least one coordinate
_POSITION_TOLERANCE, _ANGLE_TOLERANCE = 1e-4, 1e-3  # [m], [rad]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ReachResult(Summary):
    """Result of inverse kinematics.

    Attributes:
        q: (nq,) configuration that reaches the target, the nearest to where the search began; None where none does.
        distance: least distance of the frame from its target [m].
        angle: angle between its orientation and the target's [rad]; 0 where the orientation is free.
        reason: what happened, in words.
        solutions: (K, nq) all that were found, ``q`` first.
    """

    q: Array | None
    distance: float
    angle: float
    reason: str
    solutions: Array

    def _summary(self) -> dict[str, object]:
        return {"reached": self.q is not None, "solutions": len(self.solutions), "reason": self.reason}


class PoseSolver(OneThread):
    """Workspace: brings a frame of a robot to poses.

    Args:
        robot: the robot.
        frame: name of its frame.

    Raises:
        RobotError: an unknown frame, or one that does not move.
    """

    def __init__(self, robot: RobotValue, frame: str) -> None:
        index = find_frame(robot.model, frame)
        if index is None:
            names = [f.name for f in robot.model.frames]
            raise RobotError(f"{robot.name!r} has no frame {frame!r}{nearest_name(frame, names)}")
        self.robot: RobotValue = robot
        self.frame: str = frame
        self.joint: int = int(robot.model.frames[index].parentJoint)
        if not robot.tree.moving(self.joint).any():
            raise RobotError(f"frame {frame!r} of {robot.name!r} does not move")
        placement = robot.tree.to_aligned(self.joint, robot.model.frames[index].placement.homogeneous)
        self._rotation, self._translation = placement[:3, :3], placement[:3, 3]
        self._kin = Kinematics(robot.tree, _ROUND_STARTS)
        space = robot.space
        self.lower: Array = np.maximum(space.lower, -np.pi)
        self.upper: Array = np.minimum(space.upper, np.pi)
        self._weight = np.where(robot.tree.moving(self.joint), 1.0, 0.0)
        self._weight[: space.base_nv] *= _BASE_WEIGHT

    def place(self, rows: Array) -> tuple[Array, Array]:
        """Positions (N, 3) [m] and rotations (N, 3, 3) of the frame at coordinate rows (N, nv)."""
        kin = self._kin
        kin.update(rows)
        T = kin.T[self.joint, : kin.n]
        return T[:, :, :3] @ self._translation + T[:, :, 3], T[:, :, :3] @ self._rotation

    def error(self, rows: Array, position: Array, turn: Array | None, within: Array) -> tuple[Array, Array]:
        """Errors of the frame's position (N, 3) [m] and rotation (N, 3) [rad] in the world, at rows (N, nv)."""
        at, rotation = self.place(rows)
        off = position - at
        off -= np.clip(off, -within, within)
        return off, np.zeros_like(off) if turn is None else _rotation_vectors(turn @ rotation.transpose(0, 2, 1))

    def random_rows(self, count: int, rng: np.random.Generator, around: Array, base: bool, here: Array) -> Array:
        """Rows (count, nv) to begin with: joints anywhere, a base that may move about the target ``around`` (3,)."""
        b = self.robot.space.base_nv
        rows = rng.uniform(self.lower, self.upper, (count, self.robot.nv))
        if b and not base:
            rows[:, :b] = here[:b]
        elif b:
            rows[:, :2], rows[:, 2] = 0.0, rng.uniform(-np.pi, np.pi, count)
            rows[:, :2] = around[:2] - self.place(rows)[0][:, :2]  # below the target, wherever the arm holds the hand
        return rows

    @exclusive
    def solve(
        self,
        rows: Array,
        position: Array,
        turn: Array | None,
        within: Array,
        free: Array,
        iterations: int = _ROUND_ITERATIONS,
    ) -> tuple[Array, Array]:
        """Rows (N, nv) moved towards a pose, and the weighted error [m] of each."""
        space, low, high = self.robot.space, self.robot.space.lower, self.robot.space.upper
        rows, size = rows.copy(), np.full(len(rows), np.inf)
        best, weight = rows.copy(), self._weight * free
        history: list[Array] = []
        active = np.arange(len(rows))
        for _ in range(iterations):
            x = rows[active]
            off, angle = self.error(x, position, turn, within)
            e = off if turn is None else np.concatenate((off, _ANGLE_LEVER * angle), axis=1)
            norm = np.sqrt((e * e).sum(axis=1))
            better = norm < size[active]
            best[active[better]], size[active[better]] = x[better], norm[better]
            history.append(size.copy())
            if (size < _CONVERGED_ERROR).any():
                break
            if len(history) > _STALL_ITERATIONS:
                going = size[active] < _STALL_RATIO * history[-_STALL_ITERATIONS][active]
                active, x, e, norm = active[going], x[going], e[going], norm[going]
                if len(active) == 0:
                    break
                self.place(x)
            J = self._jacobians(len(x), turn is not None)
            g = np.einsum("nij,ni->nj", J, e)
            W = np.where((x <= low) & (g < 0.0) | (x >= high) & (g > 0.0), 0.0, weight)
            A = np.einsum("nij,nj,nkj->nik", J, W, J)
            k = np.arange(e.shape[1])
            A[:, k, k] += (0.5 * norm * norm + _LEAST_DAMPING)[:, None]
            step = W * np.einsum("nij,ni->nj", J, np.linalg.solve(A, e[:, :, None])[:, :, 0])
            step *= np.minimum(1.0, _LONGEST_STEP / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
            rows[active] = np.clip(space.integrate(x, step), low, high)
        return best, size

    def _jacobians(self, n: int, turned: bool) -> Array:
        """Jacobians (n, 3 or 6, nv) of the frame at the rows that were placed last; angles count by the lever."""
        kin = self._kin
        T = kin.T[self.joint, :n]
        at = T[:, :, :3] @ self._translation + T[:, :, 3]
        columns = kin.columns(self.joint)
        linear = columns[:, :, :3] + np.cross(columns[:, :, 3:], at[:, None, :])
        if not turned:
            return linear.transpose(0, 2, 1)
        return np.concatenate((linear, _ANGLE_LEVER * columns[:, :, 3:]), axis=2).transpose(0, 2, 1)


def inverse_kinematics(
    robot: RobotValue,
    frame: str,
    position: ArrayLike,
    orientation: ArrayLike | None = None,
    *,
    near: ArrayLike | None = None,
    base: bool = True,
    within: ArrayLike = (0.0, 0.0, 0.0),
    count: int = 1,
    seed: int = 0,
) -> ReachResult:
    """Configurations that bring a frame of the robot to a pose; obstacles and the robot's own links do not count.

    Args:
        robot: the robot.
        frame: name of its frame.
        position: (3,) position of the frame in the world [m].
        orientation: (4,) quaternion (x, y, z, w) of the frame in the world, or a rotation (3, 3); None leaves it free.
        near: (nq,) where the search begins, and by whose distance solutions are sorted; home where None.
        base: whether a base that can move may be moved.
        within: (3,) how far the frame may be off along the world's axes [m]: half the sides of a box.
        count: the search stops as soon as it has this many different solutions.
        seed: seed of the random starts.

    Raises:
        RobotError: an unknown frame, or one that does not move.
        ConfigurationError: ``near`` is not valid.
        ParameterError: a target or number that is not valid.
    """
    if count < 1:
        raise ParameterError(f"count={count!r} must be at least 1")
    search = PoseSearch(robot, frame, position, orientation, near=near, within=within, rng=np.random.default_rng(seed))
    found = np.zeros((0, robot.nv))
    for _ in range(_MOST_ROUNDS * (1 if count == 1 else 4)):
        found = search.sorted(np.concatenate((found, search.round(base=base))))
        if len(found) >= count:
            break
    solutions = robot.space.from_coordinates(found)
    if len(found) == 0:
        return ReachResult(None, search.distance, search.angle, search.missed(), solutions)
    return ReachResult(solutions[0], search.distance, search.angle, f"{frame!r} reaches it", solutions)


class PoseSearch(OneThread):
    """Workspace: looks for configurations with a frame of the robot at a pose, one round of starts after another.

    Args:
        robot: the robot.
        frame: name of its frame.
        position, orientation, near, within: as for :func:`inverse_kinematics`.
        rng: random numbers of the random starts.

    Attributes:
        distance, angle: how far the best so far is from the target [m], [rad].

    Raises:
        RobotError, ConfigurationError, ParameterError: as for :func:`inverse_kinematics`.
    """

    def __init__(
        self,
        robot: RobotValue,
        frame: str,
        position: ArrayLike,
        orientation: ArrayLike | None,
        *,
        near: ArrayLike | None,
        within: ArrayLike,
        rng: np.random.Generator,
    ) -> None:
        self.robot: RobotValue = robot
        self.distance: float = np.inf
        self.angle: float = 0.0
        self._solver = PoseSolver(robot, frame)
        self._position = check_array("position", position, (3,))
        self._within = check_array("within", within, (3,))
        if (self._within < 0.0).any():
            raise ParameterError(f"within={self._within.tolist()} must not be negative")
        self._turn = None if orientation is None else rotation_of(orientation)
        self._here = robot.space.to_coordinates(robot.home_q if near is None else robot.check_q(near, what="near"))
        self._rng, self._least, self._rounds = rng, np.inf, {False: 0, True: 0}

    @exclusive
    def round(self, *, base: bool) -> Array:
        """Coordinate rows (K, nv) of another round that reach the target, the nearest first; ``base``: it may move."""
        solver, space, here = self._solver, self.robot.space, self._here
        free = np.ones(self.robot.nv)
        if not base:
            free[: space.base_nv] = 0.0
        rows = solver.random_rows(_ROUND_STARTS, self._rng, self._position, base, here)
        if self._rounds[base] == 0:
            rows[0] = here
            if space.planar and base:
                rows[: _ROUND_STARTS // 2, space.base_nv :] = here[space.base_nv :]
        self._rounds[base] += 1
        rows, size = solver.solve(rows, self._position, self._turn, self._within, free)
        off, angle = (np.linalg.norm(e, axis=1) for e in solver.error(rows, self._position, self._turn, self._within))
        k = int(np.argmin(size))
        if size[k] < self._least:
            self._least, self.distance, self.angle = float(size[k]), float(off[k]), float(angle[k])
        return self.sorted(rows[(off <= _POSITION_TOLERANCE) & (angle <= _ANGLE_TOLERANCE)])

    def sorted(self, rows: Array) -> Array:
        """The rows (N, nv) that differ from each other, the nearest to where the search began first."""
        space = self.robot.space
        rows = _different(rows, space.circular, space.base_nv)
        here = np.tile(self._here, (len(rows), 1))
        return rows[np.argsort(np.linalg.norm(space.difference(here, rows), axis=1), kind="stable")]

    def missed(self) -> str:
        """Why nothing was found, in words."""
        frame = self._solver.frame
        if self.distance > _POSITION_TOLERANCE:
            return f"{self.distance:.3g} m out of reach of {frame!r}"
        return f"{frame!r} gets there, but turned by {self.angle:.3g} rad from what is asked"


def rotation_of(orientation: ArrayLike) -> Array:
    """A rotation (3, 3) of a quaternion (x, y, z, w) or of itself.

    Raises:
        ParameterError: neither of them, or not of unit length, or not a rotation.
    """
    given = np.asarray(orientation, dtype=float)
    if given.shape == (4,):
        if not 0.99 < np.linalg.norm(given) < 1.01:
            raise ParameterError(f"orientation={given.tolist()} is a quaternion whose length is not 1")
        return pin.Quaternion(given).normalized().matrix()
    R = check_array("orientation", given, (3, 3))
    if not np.allclose(R @ R.T, np.eye(3), atol=1e-4) or np.linalg.det(R) < 0.0:
        raise ParameterError(f"orientation={R.tolist()} is not a rotation")
    return R


def _rotation_vectors(R: Array) -> Array:
    """Rotations (N, 3, 3) as axes times angles (N, 3); half a turn about some axis is turned about that axis."""
    w = 0.5 * np.stack((R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]), axis=1)
    sine, cosine = np.sqrt((w * w).sum(axis=1)), 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0)
    angle = np.arctan2(sine, cosine)
    factor = np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 1.0)
    out = w * factor[:, None]
    half = (sine <= 1e-6) & (cosine < 0.0)
    if half.any():  # the axis is the longest column of R + 1
        S = R[half] + np.eye(3)
        column = S[np.arange(len(S)), :, np.argmax(np.diagonal(S, axis1=1, axis2=2), axis=1)]
        out[half] = np.pi * column / np.linalg.norm(column, axis=1)[:, None]
    return out


def _different(rows: Array, circular: Mask, b: int) -> Array:
    """Those of the rows (N, nv) that differ from all before them."""
    kept: list[int] = []
    for k in range(len(rows)):
        apart = np.abs(rows[kept] - rows[k])
        apart[:, b:] = np.where(circular, np.minimum(apart[:, b:], np.abs(2.0 * np.pi - apart[:, b:])), apart[:, b:])
        if (apart.max(axis=1, initial=0.0) > _SAME_SOLUTION).all():
            kept.append(k)
    return rows[kept]
