"""Tasks: what a robot is told to do, and how the deliberative layer decomposes it into steps and goals.

The layer knows the map and the robot, and takes its time. The paths of its steps come from the motion planner, before
the robot sets out, and again where the layers below cannot go on.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.errors import ParameterError, RobotError, nearest_name
from elastic_strips.planning.ompl_planner import ValidityChecker
from elastic_strips.robot import RobotModel
from elastic_strips.robot.kinematics import find_frame
from elastic_strips.scene import Scene
from elastic_strips.summary import Summary
from elastic_strips.validation import check_type, shown


@dataclass(frozen=True, slots=True)
class DriveTo:
    """Drive the base to a pose, the arm as it is.

    Attributes:
        x, y: [m]; yaw: [rad], in the world.
    """

    x: float
    y: float
    yaw: float

    def __post_init__(self) -> None:
        _finite("DriveTo", (self.x, self.y, self.yaw), 3)

    def __str__(self) -> str:
        return f"drive to ({self.x:g}, {self.y:g}) m, {self.yaw:g} rad"


@dataclass(frozen=True, slots=True)
class ReachHand:
    """Bring a frame of the robot to a pose; the base drives there where the arm alone does not reach.

    Attributes:
        position: (x, y, z) in the world [m].
        quaternion: (x, y, z, w) of the frame in the world; None leaves its orientation free.
        frame: of the robot.
    """

    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float] | None = None
    frame: str = "hand_frame"

    def __post_init__(self) -> None:
        _finite("ReachHand.position", self.position, 3)
        check_type("ReachHand.frame", self.frame, str)
        if self.quaternion is not None:
            _finite("ReachHand.quaternion", self.quaternion, 4)
            if not 0.99 < float(np.linalg.norm(self.quaternion)) < 1.01:
                raise ParameterError(f"ReachHand.quaternion={self.quaternion!r} must have unit length")

    def __str__(self) -> str:
        turned = "" if self.quaternion is None else " turned as asked"
        return f"reach ({', '.join(f'{v:g}' for v in self.position)}) m with {self.frame!r}{turned}"


@dataclass(frozen=True, slots=True)
class DriveAndReach:
    """Both at once: the base at a pose, the hand at another; one goal for the whole body."""

    drive: DriveTo
    reach: ReachHand

    def __post_init__(self) -> None:
        check_type("DriveAndReach.drive", self.drive, DriveTo)
        check_type("DriveAndReach.reach", self.reach, ReachHand)

    def __str__(self) -> str:
        return f"{self.drive} and {self.reach}"


Task = DriveTo | ReachHand | DriveAndReach


def _finite(what: str, values: tuple[float, ...], count: int) -> None:
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise ParameterError(f"{what}={shown(values)} must be {count} finite numbers")


_POSITION_TOLERANCE = 2e-3
"""A frame is where it is to be within so much [m]."""
_ANGLE_TOLERANCE = 1e-2
"""[rad]"""
_LEVER = 0.3  # [m/rad] what an angle counts beside a distance
_PULL = 1e-3  # how strongly joints are drawn to where they are, beside the target
_HOLD = 0.03  # how strongly a base is held where it was seen to have room: it moves only for what the arm cannot do
_RING = (0.4, 0.55, 0.7, 0.85)  # [m] distances of a base from what it reaches for, to begin with
_DIRECTIONS = 12  # on each ring
_POSTURES = 4  # of the arm, at each
_STARTS = 24  # postures of the arm where the base stays


@dataclass(frozen=True, slots=True)
class ReachResult:
    """A configuration that reaches, or None, and how near the best one came.

    Attributes:
        q: (nq,) or None.
        distance: of the frame from its target [m]; angle: [rad], 0 where the orientation is free.
        reason: what happened, for people.
    """

    q: Array | None
    distance: float
    angle: float
    reason: str


class InverseKinematics:
    """Workspace: looks for configurations of one robot that reach.

    Args:
        robot: the robot.
        rng: of the places to begin at.
        margin: distance to keep to obstacles [m].
    """

    def __init__(self, robot: RobotModel, rng: np.random.Generator, *, margin: float = 0.03) -> None:
        self.robot, self.rng, self.margin = robot, rng, margin
        self._data = robot.model.createData()

    def with_arm(self, scene: Scene, q: npt.ArrayLike, task: ReachHand) -> ReachResult:
        """Move the joints alone, the base stays where ``q`` (nq,) has it."""
        coordinates = self.robot.space.to_coordinates(self.robot.check_q(q))
        return self._search(
            scene, task, [coordinates, *self._postures(coordinates, _STARTS - 1)], coordinates, base=False
        )

    def with_base(self, scene: Scene, q: npt.ArrayLike, task: ReachHand) -> ReachResult:
        """Move base and joints; the base begins on rings about the target, those near ``q`` (nq,) first.

        With the joints as ``q`` has them, the base must have room where it begins and where it ends: it drives there
        first.
        """
        coordinates = self.robot.space.to_coordinates(self.robot.check_q(q))
        if not self.robot.space.planar:
            return self.with_arm(scene, q, task)
        target = np.asarray(task.position[:2])
        free = ValidityChecker(self.robot, scene, margin=self.margin)
        begins = []
        for radius in _RING:
            for angle in np.linspace(0.0, 2.0 * np.pi, _DIRECTIONS, endpoint=False) + self.rng.uniform(0.0, 0.5):
                row = coordinates.copy()
                row[:2] = target + radius * np.array([np.cos(angle), np.sin(angle)])
                row[2] = angle + np.pi + self.rng.uniform(-0.6, 0.6)
                if free(self._q(row)):
                    begins += [row, *(r for r in self._postures(row, _POSTURES) if free(self._q(r)))][:2]
        if not begins:
            return ReachResult(None, np.inf, 0.0, f"{task}: the base has no room about it")
        begins.sort(key=lambda row: float(np.hypot(*(row[:2] - coordinates[:2]))))
        return self._search(scene, task, begins, coordinates, base=True)

    def _postures(self, coordinates: Array, count: int) -> list[Array]:
        """Other postures at the same base pose: home, and random ones."""
        space, rows = self.robot.space, []
        home = space.to_coordinates(self.robot.home_q)
        low, high = np.clip(space.lower, -np.pi, None), np.clip(space.upper, None, np.pi)
        for k in range(count):
            row = coordinates.copy()
            b = space.base_nv
            row[b:] = home[b:] if k == 0 else self.rng.uniform(low[b:], high[b:])
            rows.append(row)
        return rows

    def _search(self, scene: Scene, task: ReachHand, begins: list[Array], near: Array, *, base: bool) -> ReachResult:
        frame = self._frame(task.frame)
        target = np.asarray(task.position, dtype=float)
        turn = None if task.quaternion is None else pin.Quaternion(np.asarray(task.quaternion)).normalized().matrix()
        valid = ValidityChecker(self.robot, scene, margin=self.margin)
        best = ReachResult(None, np.inf, 0.0, "nothing was tried")
        touching = 0
        for begin in begins:
            row = self._solve(begin, near, frame, target, turn, base=base)
            distance, angle = self._miss(row, frame, target, turn)
            if distance > _POSITION_TOLERANCE or angle > _ANGLE_TOLERANCE:
                if distance < best.distance:
                    best = ReachResult(None, distance, angle, f"{task}: the nearest that was found misses it by "
                                   f"{distance:.3f} m and {angle:.2f} rad")  # fmt: skip
                continue
            q = self._q(row)
            if valid(q) and (not base or valid(self._driven(near, row))):
                return ReachResult(q, distance, angle, f"{task}: within {1e3 * distance:.1f} mm")
            touching += 1
            best = ReachResult(
                None, distance, angle, f"{task}: all {touching} configurations that reach it touch something"
            )
        return best

    def _driven(self, near: Array, row: Array) -> Array:
        """(nq,) the base of ``row``, the joints of ``near``."""
        b = self.robot.space.base_nv
        return self._q(np.concatenate((row[:b], near[b:])))

    def _solve(self, begin: Array, near: Array, frame: int, target: Array, turn: Array | None, *, base: bool) -> Array:
        from scipy.optimize import least_squares  # late: slow to import

        space = self.robot.space
        first = 0 if base else space.base_nv
        low, high = space.lower[first:] + 1e-3, space.upper[first:] - 1e-3
        rest = np.concatenate((begin[: space.base_nv], near[space.base_nv :]))[first:]
        pull = np.full(space.nv - first, _PULL)
        pull[: space.base_nv - first] = _HOLD

        def residuals(x: Array) -> Array:
            row = np.concatenate((begin[:first], x))
            return np.concatenate((self._off(row, frame, target, turn), pull * (x - rest)))

        def slopes(x: Array) -> Array:
            row = np.concatenate((begin[:first], x))
            return np.vstack((self._slopes(row, frame, turn)[:, first:], np.diag(pull)))

        x = np.clip(begin[first:], low, high)
        found = least_squares(residuals, x, jac=slopes, bounds=(low, high), max_nfev=60, xtol=1e-9, ftol=1e-9)  # type: ignore[arg-type]
        return np.concatenate((begin[:first], found.x))

    def _off(self, row: Array, frame: int, target: Array, turn: Array | None) -> Array:
        """Position error [m] and, where it matters, orientation error times a lever [m]."""
        pin.forwardKinematics(self.robot.model, self._data, self._q(row))
        placement = pin.updateFramePlacement(self.robot.model, self._data, frame)
        off = placement.translation - target
        return off if turn is None else np.concatenate((off, _LEVER * pin.log3(turn.T @ placement.rotation)))

    def _slopes(self, row: Array, frame: int, turn: Array | None) -> Array:
        """Derivatives (3 or 6, nv) of :meth:`_off` by the coordinates."""
        model, data = self.robot.model, self._data
        q = self._q(row)
        pin.computeJointJacobians(model, data, q)
        placement = pin.updateFramePlacement(model, data, frame)
        J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        out = J[:3].copy()
        if turn is not None:
            relative = turn.T @ placement.rotation
            out = np.vstack((out, _LEVER * pin.Jlog3(relative) @ placement.rotation.T @ J[3:]))
        if (
            self.robot.space.planar
        ):  # the base's part of a tangent is in the base's frame, that of the coordinates in the world's
            cos, sin = np.cos(row[2]), np.sin(row[2])
            out[:, :2] = out[:, :2] @ np.array([[cos, sin], [-sin, cos]])
        return out

    def _miss(self, row: Array, frame: int, target: Array, turn: Array | None) -> tuple[float, float]:
        off = self._off(row, frame, target, turn)
        return float(np.linalg.norm(off[:3])), float(np.linalg.norm(off[3:]) / _LEVER)

    def _q(self, row: Array) -> Array:
        return self.robot.space.from_coordinates(row[None])[0]

    def _frame(self, name: str) -> int:
        index = find_frame(self.robot.model, name)
        if index is None:
            names = [frame.name for frame in self.robot.model.frames]
            raise RobotError(f"reach: unknown frame {name!r}{nearest_name(name, names)}")
        return index


class StepKind(str, Enum):
    """What a step is for; the strip moves the whole body in any case."""

    NAVIGATION = "navigation"
    MANIPULATION = "manipulation"
    WHOLE_BODY = "whole body"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TaskStep(Summary):
    """One goal on the way to a task.

    Attributes:
        kind: what it is for.
        q: (nq,) the goal.
        text: for people.
    """

    kind: StepKind
    q: Array
    text: str

    def __str__(self) -> str:
        return f"{self.kind.value}: {self.text}"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TaskPlan(Summary):
    """What the layer made of a task: its steps, none where it cannot be done, and why."""

    task: Task
    steps: tuple[TaskStep, ...]
    reason: str


class DeliberativeLayer:
    """Workspace: decomposes tasks into steps; their paths come from a :class:`PathService`.

    Args:
        robot: the robot.
        seed: of all that is sampled.
        margin: distance that goals keep to obstacles [m].
    """

    def __init__(self, robot: RobotModel, *, seed: int = 0, margin: float = 0.03) -> None:
        self.robot = robot
        self._kinematics = InverseKinematics(robot, np.random.default_rng(seed), margin=margin)

    def decompose(self, task: Task, q: npt.ArrayLike, scene: Scene) -> TaskPlan:
        """Decompose a task into steps that begin at a configuration.

        Args:
            task: what to do.
            q: (nq,) where the robot is.
            scene: what stands in the way of its goals.
        """
        robot = self.robot
        here = robot.check_q(q, what="q")
        if isinstance(task, DriveTo):
            step = TaskStep(StepKind.NAVIGATION, self._driven(here, task), str(task))
            return TaskPlan(task, (step,), "drive, the arm as it is")
        if isinstance(task, DriveAndReach):
            there = self._driven(here, task.drive)
            found = self._kinematics.with_arm(scene, there, task.reach)
            if found.q is None:
                return TaskPlan(task, (), found.reason)
            return TaskPlan(task, (TaskStep(StepKind.WHOLE_BODY, found.q, str(task)),), found.reason)
        found = self._kinematics.with_arm(scene, here, task)
        if found.q is not None:
            return TaskPlan(task, (TaskStep(StepKind.MANIPULATION, found.q, str(task)),), f"from here; {found.reason}")
        found = self._kinematics.with_base(scene, here, task)
        if found.q is None:
            return TaskPlan(task, (), found.reason)
        row = robot.space.to_coordinates(found.q)
        b = robot.space.base_nv
        before = robot.space.to_coordinates(here)
        before[:b] = row[:b]
        x, y, yaw = (float(value) for value in row[:3])
        drive = DriveTo(x, y, yaw)
        steps = (
            TaskStep(StepKind.NAVIGATION, robot.space.from_coordinates(before[None])[0], str(drive)),
            TaskStep(StepKind.MANIPULATION, found.q, str(task)),
        )
        return TaskPlan(task, steps, f"the arm does not reach from here: {drive} first; {found.reason}")

    def _driven(self, q: Array, drive: DriveTo) -> Array:
        row = self.robot.space.to_coordinates(q)
        row[:3] = drive.x, drive.y, drive.yaw
        return self.robot.space.from_coordinates(row[None])[0]
