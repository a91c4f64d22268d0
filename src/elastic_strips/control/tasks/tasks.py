"""Tasks of a robot, and the deliberative layer, which decomposes them into steps with goals.

The layer has the map and the robot, and no deadline. The paths of its steps come from the motion planner, before the
first step and again where the layers below cannot go on.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.errors import ParameterError, RobotError, nearest_name
from elastic_strips.planning.validity import ValidityChecker
from elastic_strips.robot import RobotModel
from elastic_strips.robot.kinematics import find_frame
from elastic_strips.scene import Scene
from elastic_strips.summary import Summary
from elastic_strips.validation import Checked, Finite, check_array, check_fields


@dataclass(frozen=True, slots=True)
class DriveTo(Checked):
    """Drive the base to a pose, with the arm as it is.

    Attributes:
        x, y: [m]; yaw: [rad], in the world.
    """

    x: Finite
    y: Finite
    yaw: Finite

    def __str__(self) -> str:
        return f"drive to ({self.x:g}, {self.y:g}) m, {self.yaw:g} rad"


@dataclass(frozen=True, slots=True)
class ReachHand:
    """Bring a frame of the robot to a pose; the base moves where the arm alone does not reach.

    Attributes:
        position: (x, y, z) in the world [m].
        quaternion: (x, y, z, w) of the frame in the world; None leaves its orientation free.
        frame: of the robot.
    """

    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float] | None = None
    frame: str = "hand_frame"

    def __post_init__(self) -> None:
        check_fields(self)
        check_array("ReachHand.position", self.position, (3,))
        if self.quaternion is None:
            return
        if not 0.99 < np.linalg.norm(check_array("ReachHand.quaternion", self.quaternion, (4,))) < 1.01:
            raise ParameterError(f"ReachHand.quaternion={self.quaternion!r} must have unit length")

    def __str__(self) -> str:
        turned = "" if self.quaternion is None else " turned as asked"
        return f"reach ({', '.join(f'{v:g}' for v in self.position)}) m with {self.frame!r}{turned}"


@dataclass(frozen=True, slots=True)
class DriveAndReach(Checked):
    """Both at once: the base at a pose, the hand at another; one goal for the whole body."""

    drive: DriveTo
    reach: ReachHand

    def __str__(self) -> str:
        return f"{self.drive} and {self.reach}"


Task = DriveTo | ReachHand | DriveAndReach


_POSITION_TOLERANCE = 2e-3
"""Tolerance of a frame's position [m]."""
_ANGLE_TOLERANCE = 1e-2
"""[rad]"""
_LEVER = 0.3  # [m/rad] weight of an angle against a distance
_PULL = 1e-3  # weight of the joints' displacement against the target
_HOLD = 0.03  # weight of the base's displacement from a free place: it moves only where the arm does not reach
_RING = (0.4, 0.55, 0.7, 0.85)  # [m] first distances of a base from the target
_DIRECTIONS = 12  # on each ring
_POSTURES = 4  # of the arm, at each
_STARTS = 24  # postures of the arm where the base stays


@dataclass(frozen=True, slots=True)
class ReachResult:
    """Result of inverse kinematics.

    Attributes:
        q: (nq,) configuration that reaches the target, or None.
        distance: least one of the frame from its target [m].
        angle: of its orientation from the target's [rad]; 0 where the orientation is free.
        reason: what happened, in words.
    """

    q: Array | None
    distance: float
    angle: float
    reason: str


class InverseKinematics:
    """Workspace: searches collision-free configurations of a robot that reach a target.

    Args:
        robot: the robot.
        rng: of the start values.
        margin: distance to keep to obstacles [m].
    """

    def __init__(self, robot: RobotModel, rng: np.random.Generator, *, margin: float = 0.03) -> None:
        self.robot: RobotModel = robot
        self.rng: np.random.Generator = rng
        self.margin: float = margin
        self._data = robot.model.createData()

    def with_arm(self, scene: Scene, q: npt.ArrayLike, task: ReachHand) -> ReachResult:
        """Search with the joints alone; the base stays where ``q`` (nq,) has it."""
        coordinates = self.robot.space.to_coordinates(self.robot.check_q(q))
        return self._search(
            scene, task, [coordinates, *self._postures(coordinates, _STARTS - 1)], coordinates, base=False
        )

    def with_base(self, scene: Scene, q: npt.ArrayLike, task: ReachHand) -> ReachResult:
        """Search with base and joints; start values are on rings about the target, those near ``q`` (nq,) first.

        With the joints as in ``q``, the base must be free at its start value and at the result: it drives there first.
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
                if free(self.robot.space.from_coordinates(row)):
                    begins += [
                        row,
                        *(r for r in self._postures(row, _POSTURES) if free(self.robot.space.from_coordinates(r))),
                    ][:2]
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
            q = self.robot.space.from_coordinates(row)
            if valid(q) and (not base or valid(_with_base_of(self.robot, row, near))):
                return ReachResult(q, distance, angle, f"{task}: within {1e3 * distance:.1f} mm")
            touching += 1
            best = ReachResult(
                None, distance, angle, f"{task}: all {touching} configurations that reach it touch something"
            )
        return best

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
        pin.forwardKinematics(self.robot.model, self._data, self.robot.space.from_coordinates(row))
        placement = pin.updateFramePlacement(self.robot.model, self._data, frame)
        off = placement.translation - target
        return off if turn is None else np.concatenate((off, _LEVER * pin.log3(turn.T @ placement.rotation)))

    def _slopes(self, row: Array, frame: int, turn: Array | None) -> Array:
        """Derivatives (3 or 6, nv) of :meth:`_off` by the coordinates."""
        model, data = self.robot.model, self._data
        q = self.robot.space.from_coordinates(row)
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

    def _frame(self, name: str) -> int:
        index = find_frame(self.robot.model, name)
        if index is None:
            names = [frame.name for frame in self.robot.model.frames]
            raise RobotError(f"reach: unknown frame {name!r}{nearest_name(name, names)}")
        return index


class StepKind(str, Enum):
    """Purpose of a step; the strip moves the whole body in any case."""

    NAVIGATION = "navigation"
    MANIPULATION = "manipulation"
    WHOLE_BODY = "whole body"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TaskStep(Summary):
    """A step of a task.

    Attributes:
        kind: its purpose.
        q: (nq,) its goal.
        text: description.
    """

    kind: StepKind
    q: Array
    text: str

    def __str__(self) -> str:
        return f"{self.kind.value}: {self.text}"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TaskPlan(Summary):
    """Steps of a task, none where it cannot be done, and the reason."""

    task: Task
    steps: tuple[TaskStep, ...]
    reason: str


class DeliberativeLayer:
    """Workspace: decomposes tasks into steps; their paths come from a :class:`PathService`.

    Args:
        robot: the robot.
        seed: of the search for goals.
        margin: distance that goals keep to obstacles [m].
    """

    def __init__(self, robot: RobotModel, *, seed: int = 0, margin: float = 0.03) -> None:
        self.robot = robot
        self._kinematics = InverseKinematics(robot, np.random.default_rng(seed), margin=margin)

    def decompose(self, task: Task, q: npt.ArrayLike, scene: Scene) -> TaskPlan:
        """Decompose a task into steps.

        Args:
            task: to be done.
            q: (nq,) present configuration.
            scene: static obstacles.

        Returns:
            The plan; without steps where no goal is found.
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
        x, y, yaw = (float(value) for value in row[:3])
        drive = DriveTo(x, y, yaw)
        before = _with_base_of(robot, row, robot.space.to_coordinates(here))
        steps = (
            TaskStep(StepKind.NAVIGATION, before, str(drive)),
            TaskStep(StepKind.MANIPULATION, found.q, str(task)),
        )
        return TaskPlan(task, steps, f"the arm does not reach from here: {drive} first; {found.reason}")

    def _driven(self, q: Array, drive: DriveTo) -> Array:
        row = self.robot.space.to_coordinates(q)
        row[:3] = drive.x, drive.y, drive.yaw
        return self.robot.space.from_coordinates(row)


def _with_base_of(robot: RobotModel, row: Array, joints: Array) -> Array:
    """(nq,) the base of one coordinate row, the joints of another one (nv,)."""
    b = robot.space.base_nv
    return robot.space.from_coordinates(np.concatenate((row[:b], joints[b:])))
