"""Inverse kinematics of the whole body: many starts at once, within joint limits, by damped least squares.

All starts take their steps together, in arrays; one that stalls is begun anew elsewhere. Obstacles are not looked at.
The damping is that of Sugihara (2011): half of the squared error, which is robust far away and quick nearby.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, ArrayLike, Indices, Mask
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
_DRAWN = 8  # times as many random starts are drawn as are needed, where it is known which of them are promising
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


@dataclass(frozen=True, slots=True, eq=False)
class PoseTarget:
    """Where a frame is to be, and how it is to be turned.

    Attributes:
        frame: name of the frame.
        position: (3,) its position in the world [m]; or (N, 3), of each row another.
        turn: (3, 3) its rotation in the world, or (N, 3, 3); None leaves it free.
        within: (3,) how far it may be off along the world's axes [m]; infinite where an axis does not count.
    """

    frame: str
    position: Array
    turn: Array | None
    within: Array

    @staticmethod
    def of(frame: str, position: ArrayLike, orientation: ArrayLike | None, within: ArrayLike) -> PoseTarget:
        """A target as people state it: see :func:`inverse_kinematics`.

        Raises:
            ParameterError: an array of another shape, what is no rotation, or a negative ``within``.
        """
        about = check_array("within", within, (3,))
        if (about < 0.0).any():
            raise ParameterError(f"within={about.tolist()} must not be negative")
        turn = None if orientation is None else rotation_of(orientation)
        return PoseTarget(frame, check_array("position", position, (3,)), turn, about)

    def of_rows(self, rows: Indices) -> PoseTarget:
        """The target of some of the rows."""
        turn = self.turn if self.turn is None or self.turn.ndim == 2 else self.turn[rows]
        return replace(self, position=self.position if self.position.ndim == 1 else self.position[rows], turn=turn)


class Residual(Protocol):
    """Something that is to be 0 besides, as a constraint is."""

    @property
    def moving(self) -> Mask:
        """(nv,) the coordinates that change it."""
        ...

    @property
    def enough(self) -> float:
        """Largest of :meth:`errors` [rad] that will do."""
        ...

    def residual(self, kin: Kinematics) -> tuple[Array, Array]:
        """What is to be 0 at each node, (N, 3) [rad], and its derivatives (N, 3, nv)."""
        ...

    def errors(self, kin: Kinematics) -> Array:
        """(N,) how far each node is off [rad]."""
        ...


class PoseSolver(OneThread):
    """Workspace: brings one or several frames of a robot to poses.

    Args:
        robot: the robot.
        frames: names of its frames.
        also: what is to be 0 besides.

    Attributes:
        reaches: how far each of the frames gets from the base, whatever the joints do, at most [m].

    Raises:
        RobotError: an unknown frame, or one that does not move.
    """

    def __init__(self, robot: RobotValue, *frames: str, also: Residual | None = None) -> None:
        self.robot: RobotValue = robot
        self.frames: tuple[str, ...] = frames
        self.also: Residual | None = also
        self._frames = [_carried(robot, frame) for frame in frames]
        self.reaches: tuple[float, ...] = tuple(_reach(robot, *frame) for frame in self._frames)
        self._kin = Kinematics(robot.tree, _ROUND_STARTS)
        space = robot.space
        self.lower: Array = np.maximum(space.lower, -np.pi)
        self.upper: Array = np.minimum(space.upper, np.pi)
        moving = [robot.tree.moving(joint) for joint, _, _ in self._frames] + ([] if also is None else [also.moving])
        self._weight = np.where(np.any(moving, axis=0), 1.0, 0.0)
        self._weight[: space.base_nv] *= _BASE_WEIGHT

    def place(self, rows: Array, frame: int = 0) -> tuple[Array, Array]:
        """Positions (N, 3) [m] and rotations (N, 3, 3) of one of the frames at coordinate rows (N, nv)."""
        self._kin.update(rows)
        return self._placed(frame)

    def _placed(self, frame: int) -> tuple[Array, Array]:
        joint, rotation, translation = self._frames[frame]
        T = self._kin.T[joint, : self._kin.n]
        return T[:, :, :3] @ translation + T[:, :, 3], T[:, :, :3] @ rotation

    def errors(self, rows: Array, targets: Sequence[PoseTarget]) -> list[tuple[Array, Array]]:
        """Errors of each frame's position (N, 3) [m] and rotation (N, 3) [rad] in the world, at rows (N, nv).

        Args:
            rows: coordinate rows.
            targets: one for each of the frames, in their order.
        """
        self._kin.update(rows)
        out = []
        for k, target in enumerate(targets):
            at, rotation = self._placed(k)
            off = target.position - at
            off -= np.clip(off, -target.within, target.within)
            turn = target.turn
            angle = np.zeros_like(off) if turn is None else _rotation_vectors(turn @ rotation.transpose(0, 2, 1))
            out.append((off, angle))
        return out

    def random_rows(
        self, count: int, rng: np.random.Generator, targets: Sequence[PoseTarget], base: bool, here: Array
    ) -> Array:
        """Rows (count, nv) to begin with: joints anywhere, and a base that may move where it has the frames
        at their targets on the average."""
        b = self.robot.space.base_nv
        rows = rng.uniform(self.lower, self.upper, (count, self.robot.nv))
        if b and not base:
            rows[:, :b] = here[:b]
        elif b and targets:
            rows[:, :2], rows[:, 2] = 0.0, rng.uniform(-np.pi, np.pi, count)
            self._kin.update(rows)
            at = np.array([self._placed(k)[0][:, :2] for k in range(len(targets))])
            wanted = np.array([target.position[:2] for target in targets])
            rows[:, :2] = wanted.mean(axis=0) - at.mean(axis=0)  # below the target, wherever the arm holds the hand
        return rows

    @exclusive
    def solve(
        self,
        rows: Array,
        targets: Sequence[PoseTarget],
        free: Array,
        iterations: int = _ROUND_ITERATIONS,
        *,
        every: bool = False,
    ) -> tuple[Array, Array]:
        """Rows (N, nv) moved towards all targets together, and the weighted error [m] of each.

        Args:
            rows: where to begin.
            targets: one for each of the frames, in their order.
            free: (nv,) 1 for coordinates that may move, 0 for others.
            iterations: largest number of steps.
            every: whether all rows are to get there; with False it ends as soon as one does.
        """
        space, low, high = self.robot.space, self.robot.space.lower, self.robot.space.upper
        rows, size = rows.copy(), np.full(len(rows), np.inf)
        best, weight = rows.copy(), self._weight * free
        history: list[Array] = []
        active = np.arange(len(rows))
        for _ in range(iterations):
            x = rows[active]
            e = self._weighted(x, [target.of_rows(active) for target in targets])
            norm = np.sqrt((e * e).sum(axis=1))
            better = norm < size[active]
            best[active[better]], size[active[better]] = x[better], norm[better]
            history.append(size.copy())
            if not every and (size < _CONVERGED_ERROR).any():
                break
            going = size[active] >= _CONVERGED_ERROR
            if len(history) > _STALL_ITERATIONS:
                going &= size[active] < _STALL_RATIO * history[-_STALL_ITERATIONS][active]
            if not going.all():
                active, x, e, norm = active[going], x[going], e[going], norm[going]
                if len(active) == 0:
                    break
                self._kin.update(x)
            J = self._jacobians(len(x), [target.turn is not None for target in targets])
            g = np.einsum("nij,ni->nj", J, e)
            W = np.where((x <= low) & (g < 0.0) | (x >= high) & (g > 0.0), 0.0, weight)
            A = np.einsum("nij,nj,nkj->nik", J, W, J)
            k = np.arange(e.shape[1])
            A[:, k, k] += (0.5 * norm * norm + _LEAST_DAMPING)[:, None]
            step = W * np.einsum("nij,ni->nj", J, np.linalg.solve(A, e[:, :, None])[:, :, 0])
            step *= np.minimum(1.0, _LONGEST_STEP / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
            rows[active] = np.clip(space.integrate(x, step), low, high)
        return best, size

    def _weighted(self, rows: Array, targets: Sequence[PoseTarget]) -> Array:
        """All errors (N, M) [m] at rows (N, nv), angles by the lever."""
        parts: list[Array] = []
        for target, (off, angle) in zip(targets, self.errors(rows, targets), strict=True):
            parts += (off,) if target.turn is None else (off, _ANGLE_LEVER * angle)
        if self.also is not None:
            parts.append(-_ANGLE_LEVER * self.also.residual(self._kin)[0])
        return np.concatenate(parts, axis=1)

    def also_off(self, rows: Array) -> Array:
        """(N,) how far what is to be 0 besides is off at rows (N, nv) [rad]; 0 where there is nothing."""
        if self.also is None:
            return np.zeros(len(rows))
        self._kin.update(rows)
        return self.also.errors(self._kin)

    def _jacobians(self, n: int, turned: Sequence[bool]) -> Array:
        """Jacobians (n, 3 or 6 of each frame, and 3, nv) at the rows placed last; angles count by the lever."""
        kin, blocks = self._kin, []
        for (joint, _, translation), with_angle in zip(self._frames, turned, strict=True):
            T = kin.T[joint, :n]
            at = T[:, :, :3] @ translation + T[:, :, 3]
            columns = kin.columns(joint)
            blocks.append(columns[:, :, :3] + np.cross(columns[:, :, 3:], at[:, None, :]))
            if with_angle:
                blocks.append(_ANGLE_LEVER * columns[:, :, 3:])
        if self.also is not None:
            blocks.append(_ANGLE_LEVER * self.also.residual(kin)[1].transpose(0, 2, 1))
        return np.concatenate(blocks, axis=2).transpose(0, 2, 1)


def _carried(robot: RobotValue, frame: str) -> tuple[int, Array, Array]:
    """The joint of a frame, and its rotation (3, 3) and place (3,) [m] in that joint's aligned frame."""
    index = find_frame(robot.model, frame)
    if index is None:
        names = [f.name for f in robot.model.frames]
        raise RobotError(f"{robot.name!r} has no frame {frame!r}{nearest_name(frame, names)}")
    joint = int(robot.model.frames[index].parentJoint)
    if not robot.tree.moving(joint).any():
        raise RobotError(f"frame {frame!r} of {robot.name!r} does not move")
    placement = robot.tree.to_aligned(joint, robot.model.frames[index].placement.homogeneous)
    return joint, placement[:3, :3], placement[:3, 3]


def _reach(robot: RobotValue, joint: int, _rotation: Array, translation: Array) -> float:
    """How far [m] a place (3,) in a joint's aligned frame gets from the base's, or from the origin where that is fixed,
    at most: lengths add up."""
    tree, base = robot.tree, 1 if robot.space.planar else 0
    far = float(np.linalg.norm(translation))
    while joint > base:
        far += float(np.linalg.norm(tree.offset[joint, :3, 3]))
        if tree.prismatic[joint]:
            k = tree.coordinate_index[joint]
            ends = np.array((robot.space.lower[k], robot.space.upper[k]))
            far += float(np.abs(tree.multiplier[joint] * ends + tree.constant[joint]).max())
        joint = int(tree.parents[joint])
    return far


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
    target = PoseTarget.of(frame, position, orientation, within)
    search = PoseSearch(robot, [target], near=near, rng=np.random.default_rng(seed))
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
    """Workspace: looks for configurations with frames of the robot at their targets, all at once, one round of starts
    after another.

    Args:
        robot: the robot.
        targets: each of another frame.
        near: as for :func:`inverse_kinematics`.
        rng: random numbers of the random starts.
        also: what is to be 0 besides.
        promising: which of some rows (N, nv) are worth starting from, where the base may move; all are, where None.

    Attributes:
        misses: by how far the best so far misses each of the targets: distance [m] and angle [rad].

    Raises:
        RobotError, ConfigurationError: as for :func:`inverse_kinematics`.
    """

    def __init__(
        self,
        robot: RobotValue,
        targets: Sequence[PoseTarget],
        *,
        near: ArrayLike | None,
        rng: np.random.Generator,
        also: Residual | None = None,
        promising: Callable[[Array], Mask] | None = None,
    ) -> None:
        self.robot: RobotValue = robot
        self._promising = promising
        self.misses: list[tuple[float, float]] = [(np.inf, 0.0)] * len(targets)
        self._solver = PoseSolver(robot, *(target.frame for target in targets), also=also)
        self._also_off = 0.0
        self._targets = targets
        self._here = robot.space.to_coordinates(robot.home_q if near is None else robot.check_q(near, what="near"))
        self._rng, self._least, self._rounds = rng, np.inf, {False: 0, True: 0}

    @property
    def distance(self) -> float:
        """The largest distance of a frame from its target [m], of the best so far."""
        return max((distance for distance, _ in self.misses), default=0.0)

    @property
    def angle(self) -> float:
        """The largest angle by which a frame is turned differently [rad], of the best so far."""
        return max((angle for _, angle in self.misses), default=0.0)

    @property
    def out_of_reach(self) -> bool:
        """Whether the joints alone cannot bring a frame to its target, from where the base stands: it is further away
        than the arm is long."""
        base = np.zeros(3)
        base[:2] = self._here[:2] if self.robot.space.planar else 0.0
        for target, reach in zip(self._targets, self._solver.reaches, strict=True):
            off = target.position - base
            if np.linalg.norm(off - np.clip(off, -target.within, target.within)) > reach:
                return True
        return False

    def by_frame(self) -> dict[str, tuple[float, float]]:
        """The misses by the frames' names."""
        return dict(zip(self._solver.frames, self.misses, strict=True))

    @exclusive
    def round(self, *, base: bool) -> Array:
        """Coordinate rows (K, nv) of another round that reach the targets, the nearest first; ``base``: it may move."""
        solver, space, here = self._solver, self.robot.space, self._here
        free = np.ones(self.robot.nv)
        if not base:
            free[: space.base_nv] = 0.0
        rows = self._starts(base)
        if self._rounds[base] == 0:
            rows[0] = here
            if space.planar and base:
                rows[: _ROUND_STARTS // 2, space.base_nv :] = here[space.base_nv :]
        self._rounds[base] += 1
        rows, size = solver.solve(rows, self._targets, free)
        missed = [[np.linalg.norm(e, axis=1) for e in each] for each in solver.errors(rows, self._targets)]
        off, also = np.array(missed).reshape(-1, 2, len(rows)), solver.also_off(rows)
        k = int(np.argmin(size))
        if size[k] < self._least:
            self._least, self._also_off = float(size[k]), float(also[k])
            self.misses = [(float(distance), float(angle)) for distance, angle in off[:, :, k]]
        reached = (off <= np.array((_POSITION_TOLERANCE, _ANGLE_TOLERANCE))[:, None]).all(axis=(0, 1))
        if solver.also is not None:
            reached &= also <= solver.also.enough
        return self.sorted(rows[reached])

    def _starts(self, base: bool) -> Array:
        """Random rows to begin with, the promising ones first, where there are such."""
        promising = self._promising if base else None
        count = _ROUND_STARTS * (1 if promising is None else _DRAWN)
        rows = self._solver.random_rows(count, self._rng, self._targets, base, self._here)
        if promising is not None:
            rows = rows[np.argsort(~promising(rows), kind="stable")]
        return rows[:_ROUND_STARTS]

    def sorted(self, rows: Array) -> Array:
        """The rows (N, nv) that differ from each other, the nearest to where the search began first."""
        space = self.robot.space
        rows = _different(rows, space.circular, space.base_nv)
        here = np.tile(self._here, (len(rows), 1))
        return rows[np.argsort(np.linalg.norm(space.difference(here, rows), axis=1), kind="stable")]

    def missed(self) -> str:
        """Why nothing was found, in words: of each frame that misses its target."""
        said = []
        for frame, (distance, angle) in zip(self._solver.frames, self.misses, strict=True):
            if distance > _POSITION_TOLERANCE:
                said.append(f"{distance:.3g} m out of reach of {frame!r}")
            elif angle > _ANGLE_TOLERANCE:
                said.append(f"{frame!r} gets there, but turned by {angle:.3g} rad from what is asked")
        also = self._solver.also
        if also is not None and self._also_off > also.enough:
            said.append(f"the constraint stays {self._also_off:.3g} rad off")
        return " and ".join(said)


def rotation_of(orientation: ArrayLike, what: str = "orientation") -> Array:
    """A rotation (3, 3) of a quaternion (x, y, z, w) or of itself; ``what`` is its name in messages.

    Raises:
        ParameterError: neither of them, or not of unit length, or not a rotation.
    """
    given = np.asarray(orientation, dtype=float)
    if given.shape == (4,):
        if not 0.99 < np.linalg.norm(given) < 1.01:
            raise ParameterError(f"{what}={given.tolist()} is a quaternion whose length is not 1")
        return pin.Quaternion(given).normalized().matrix()
    R = check_array(what, given, (3, 3))
    if not np.allclose(R @ R.T, np.eye(3), atol=1e-4) or np.linalg.det(R) < 0.0:
        raise ParameterError(f"{what}={R.tolist()} is not a rotation")
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
