"""Constraints: an axis of the robot that points in a direction, or at a place, at every node of a strip."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, ArrayLike, Mask
from elastic_strips.collision import BodySet, MotionBounds
from elastic_strips.errors import ConfigurationError, ParameterError, RobotError, nearest_name
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.robot.kinematics import find_frame
from elastic_strips.scene import Scene, UnknownMotion
from elastic_strips.validation import Bound, Positive, check_array, check_fields, check_type, named_arguments

from .solver import System
from .strip import Strip
from .workspace import NodePredictor

_log = logging.getLogger(__name__)
_LOOK_ANGLE = 0.01  # [rad] that the axis and its target turn between looks along a segment
_LEAST_SIGHT = 0.01  # [m] nearer than this there is no direction to a place
_USUAL_SIGHT = 0.05  # [m] nearer than this, looks are no denser
_MOST_NEWTON_STEPS = 30  # Newton's steps, at most
_PROJECTION_DAMPING, _LARGEST_JOINT_STEP = 1e-3, 0.3  # damping, and what a step turns a joint at most [rad]
_PROJECTION_SHARE = 0.2  # of the tolerance: so exactly rows are projected


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisConstraint:
    """An axis of a frame of the robot that is to point somewhere: an :class:`OrientationConstraint`, or a
    :class:`LookAt`.

    Attributes:
        frame: frame of the robot.
        axis: axis in that frame, of any length.
        tolerance: the constraint is satisfied where no node is further off than this [rad].
        gain: how strongly the strip is drawn to it, beside ``DeformParams.k_r``.
    """

    frame: str
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    tolerance: Annotated[float, Bound(above=0.0, high=np.pi, unit="rad")] = 0.1
    gain: Positive = 3.0

    def __post_init__(self) -> None:
        check_fields(self)
        self._check_vector("axis", self.axis)

    def _check_vector(self, what: str, value: ArrayLike) -> None:
        name = f"{type(self).__name__}.{what}"
        if np.linalg.norm(check_array(name, value, (3,))) < 1e-9:
            raise ParameterError(f"{name}={value!r} must be three numbers, not all 0")

    def place(self, scene: Scene) -> Array | None:
        """(3,) place [m] in a scene that the axis is to point at; None where it is to point in a direction.

        Raises:
            SceneError: there is no such obstacle.
        """
        return None

    def in_scene(self, scene: Scene) -> AxisConstraint:
        """The constraint with a place where it names an obstacle: where that is in this scene.

        Raises:
            SceneError: there is no such obstacle.
        """
        return self


@named_arguments
@dataclass(frozen=True, slots=True, kw_only=True)
class OrientationConstraint(AxisConstraint):
    """An axis of a frame of the robot that is to point in a direction, such as that of a tray that stays level.

    Attributes:
        frame, axis, tolerance, gain: see :class:`AxisConstraint`.
        direction: direction in the world in which it is to point.
    """

    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        AxisConstraint.__post_init__(self)
        self._check_vector("direction", self.direction)

    @staticmethod
    def from_configuration(
        robot: RobotModel,
        q: ArrayLike,
        frame: str,
        *,
        direction: tuple[float, float, float] = (0.0, 0.0, 1.0),
        **values: float,
    ) -> OrientationConstraint:
        """Keep a frame turned to a direction as it is at a configuration; by default as level as it is there.

        Args:
            robot: the robot.
            q: configuration (nq,).
            frame: frame of the robot.
            direction: direction in the world; any turn about it is free.
            **values: tolerance and gain.

        Raises:
            RobotError: the robot has no such frame.
        """
        index = _frame(robot, frame)
        data = robot.model.createData()
        pin.forwardKinematics(robot.model, data, robot.check_q(q))
        rotation = pin.updateFramePlacement(robot.model, data, index).rotation
        x, y, z = rotation.T @ np.asarray(direction, dtype=float)
        return OrientationConstraint(frame=frame, axis=(float(x), float(y), float(z)), direction=direction, **values)


@named_arguments
@dataclass(frozen=True, slots=True, kw_only=True)
class LookAt(AxisConstraint):
    """An axis of a frame of the robot that is to point at a place, such as a camera's at what it is to see.

    An obstacle is looked at where it is in the scene of each tick; one that moves, where it is expected when a node is
    reached. While it is not in the scene, its last place counts. Strips are planned for where it is at present.

    Attributes:
        frame, axis, tolerance, gain: see :class:`AxisConstraint`. The axis begins at the frame's origin.
        at: (3,) the place [m] in the world, or the name of an obstacle: then the origin of its pose.
    """

    at: tuple[float, float, float] | str

    def __post_init__(self) -> None:
        AxisConstraint.__post_init__(self)
        if not isinstance(self.at, str):
            check_array("LookAt.at", self.at, (3,))
        elif not self.at.strip():
            raise ParameterError(
                f"LookAt.at={self.at!r} is no name; it must be a place (3,) or the name of an obstacle"
            )

    def place(self, scene: Scene) -> Array | None:
        """See :meth:`AxisConstraint.place`."""
        return (
            scene.obstacle(self.at).pose[:3, 3].copy() if isinstance(self.at, str) else np.array(self.at, dtype=float)
        )

    def in_scene(self, scene: Scene) -> AxisConstraint:
        """See :meth:`AxisConstraint.in_scene`."""
        if not isinstance(self.at, str):
            return self
        x, y, z = scene.obstacle(self.at).pose[:3, 3].tolist()
        return replace(self, at=(x, y, z))


class ConstraintForce(OneThread):
    """Workspace: the force of a constraint on strips of one robot, and by how much they miss it.

    Args:
        robot: the robot of the frame.
        constraint: the constraint to satisfy.

    Attributes:
        constraint: the same.
        active: whether it acts.
        moving: (nv,) the coordinates that move the frame.

    Raises:
        RobotError: the robot has no such frame, or none of its joints turns it.
        ParameterError: another kind of constraint.
    """

    def __init__(self, robot: RobotModel, constraint: AxisConstraint) -> None:
        check_type("constraint", constraint, AxisConstraint)
        frame = robot.model.frames[_frame(robot, constraint.frame)]
        self.constraint: AxisConstraint = constraint
        self.active: bool = True
        self._robot = robot
        self._joint = int(frame.parentJoint)
        if self._joint == 0:
            raise RobotError(f"constraint: no joint of {robot.name!r} moves frame {constraint.frame!r}")
        axis = np.asarray(constraint.axis, dtype=float)
        self._axis = robot.tree.align[self._joint].T @ (frame.placement.rotation @ (axis / np.linalg.norm(axis)))
        self._origin = robot.tree.to_aligned(self._joint, frame.placement.homogeneous)[:3, 3]
        self._target: Array | None = None  # (3,) the direction, where it is one
        self._place: Array | None = None  # (3,) the place to look at, where it is known
        self._obstacle: int = -1  # its index in the scene
        self._prediction: NodePredictor | None = None
        self._warned = False
        if isinstance(constraint, OrientationConstraint):
            direction = np.asarray(constraint.direction, dtype=float)
            self._target = direction / np.linalg.norm(direction)
        elif not isinstance(constraint, LookAt):
            raise ParameterError("constraint is an AxisConstraint; it must be an OrientationConstraint or a LookAt")
        elif not isinstance(constraint.at, str):
            self._place = np.array(constraint.at, dtype=float)
        turns = robot.tree.support[self._joint] * np.abs(robot.tree.rate)
        turns[robot.tree.motion[robot.tree.prismatic]] = 0.0
        if robot.space.planar:
            turns[:2] = 0.0
            if self._target is not None:
                turns[2] = np.hypot(*self._target[:2]) > 0.0  # turns about the target do not count
        self._turns = robot.tree.summed(turns)
        self.moving: Mask = robot.tree.moving(self._joint)
        self._travel: MotionBounds | None = None  # of the frame's origin

    @property
    def enough(self) -> float:
        """Largest angle [rad] of configurations that are looked for: what is between them needs the rest."""
        return _PROJECTION_SHARE * self.constraint.tolerance

    @exclusive
    def find(self, scene: Scene) -> None:
        """Look where an obstacle is, if the constraint names one.

        Raises:
            SceneError: it is not there.
        """
        self.constraint.place(scene)
        self.see(scene)

    @exclusive
    def see(self, scene: Scene, prediction: NodePredictor | None = None) -> None:
        """Look where an obstacle is, if the constraint names one; where it is not there, its last place counts.

        Args:
            scene: the obstacles.
            prediction: where moving ones will be when each node is reached; as they stand where None.
        """
        constraint = self.constraint
        if not (isinstance(constraint, LookAt) and isinstance(constraint.at, str)):
            return
        self._obstacle, self._prediction = -1, None
        if constraint.at in scene:
            self._place, self._prediction = constraint.place(scene), prediction
            self._obstacle = scene.names.index(constraint.at)
        elif self._place is None and not self._warned:
            self._warned = True
            _log.warning("LookAt: there is no obstacle %r in the scene yet; nothing is looked at", constraint.at)

    @exclusive
    def push(self, system: System, kin: Kinematics) -> None:
        """Add force and matrix of V = Σ ½ k ‖a − t‖², with the axis a and its target t, if the constraint is active."""
        if not self.active or (self._target is None and self._place is None):
            return
        n, gain = kin.n, self.constraint.gain
        off, slopes = self.residual(kin)
        rows = slopes.reshape(3 * n, -1)
        system.add_rows(np.repeat(np.arange(n), 3), rows, -gain * off.reshape(-1), np.full(3 * n, gain))
        system.energies["constraint"] = 0.5 * gain * float((off**2).sum())

    def errors(self, kin: Kinematics) -> Array:
        """(N,) angle [rad] by which each node misses the constraint; π where there is no direction to its place."""
        return self._errors(kin, self._places(kin))

    def errors_at(self, coordinates: Array, places: Array | None = None) -> Array:
        """(N,) angle [rad] by which coordinate rows (N, nv) miss the constraint.

        Args:
            coordinates: the rows.
            places: (N, 3) what to look at [m] at each of them; what is known of it where None.
        """
        kin = Kinematics(self._robot.tree, len(coordinates))
        kin.update(coordinates)
        return self._errors(kin, self._places(kin) if places is None else places)

    def errors_held(self, row: Array, poses: Array) -> Array:
        """(…,) angle [rad] by which the constraint is missed at poses (…, 3) of the base with the joints of a
        coordinate row (nv,) as they are."""
        kin = Kinematics(self._robot.tree, 1)
        kin.update(row[None], jacobians=False)
        axis, origin, target = self._axes(kin)[0], self._origins(kin)[0], self._target
        turn = poses[..., 2] - row[2]
        cos, sin = np.cos(turn), np.sin(turn)
        x, y = cos * axis[0] - sin * axis[1], sin * axis[0] + cos * axis[1]
        if self._place is not None:
            out = origin[:2] - row[:2]
            line = np.stack(
                [
                    self._place[0] - poses[..., 0] - cos * out[0] + sin * out[1],
                    self._place[1] - poses[..., 1] - sin * out[0] - cos * out[1],
                    np.full(turn.shape, self._place[2] - origin[2]),
                ]
            )
            to = line / np.maximum(np.sqrt((line * line).sum(axis=0)), _LEAST_SIGHT)
        else:
            to = np.zeros(3) if target is None else target
        return np.arccos(np.clip(x * to[0] + y * to[1] + axis[2] * to[2], -1.0, 1.0))

    def bound(self, strip: Strip) -> tuple[float, int]:
        """Largest angle [rad] by which a strip misses the constraint, between its nodes too; and the segment of it.

        Between two looks the axis turns by no more than the joints that turn it do together. The direction to a place
        turns by no more than the way of frame and place against each other over the least distance on it. The angle is
        no more than half the sum of those at both looks and of both turns. What is looked at goes straight meanwhile.
        """
        space, rows = self._robot.space, strip.coordinates
        v = space.difference(rows[:-1], rows[1:])
        turn, slide = np.abs(v) @ self._turns, self._slides(v)
        swing = slide.copy()
        if slide.any():
            kin = Kinematics(self._robot.tree, len(rows))
            kin.update(rows)
            swing /= np.maximum(_least_between(self._sight(kin), slide), _USUAL_SIGHT)
        parts = np.maximum(np.ceil((turn + swing) / _LOOK_ANGLE).astype(int), 1)
        segment = np.repeat(np.arange(len(parts)), parts)
        share = (np.arange(len(segment)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[segment]
        kin = Kinematics(self._robot.tree, len(segment) + 1)
        kin.update(np.vstack((space.integrate(rows[segment], share[:, None] * v[segment]), rows[-1:])))
        places, turned = self._places(kin), (turn / parts)[segment]
        off = self._errors(kin, places)
        if places is not None:
            way = (slide / parts)[segment] + np.linalg.norm(np.diff(places, axis=0), axis=1)
            least = _least_between(np.linalg.norm(places - self._origins(kin), axis=1), way)
            turned += np.where(least > _LEAST_SIGHT, way / np.maximum(least, _LEAST_SIGHT), 2.0 * np.pi)
        most = np.minimum(0.5 * (off[:-1] + off[1:] + turned), np.pi)
        worst = int(np.argmax(most))
        return float(most[worst]), int(segment[worst])

    def missed(self, strip: Strip) -> str:
        """Where a strip misses the constraint, between its nodes too, and by how much; empty where it does not."""
        off, segment = self.bound(strip)
        most = self.constraint.tolerance
        if off <= most:
            return ""
        return (
            f"segment {segment}: {self.constraint.frame} is up to {off:.3f} rad off, {most:g} are allowed (tolerance)"
        )

    def check(self, q: Array, what: Sequence[str]) -> None:
        """Refuse configurations (K, nq) that do not satisfy the constraint.

        Raises:
            ConfigurationError: one of them does not; the message says which, and by how much.
        """
        for name, off in zip(what, self.errors_at(self._robot.space.to_coordinates(q)), strict=True):
            if off > self.constraint.tolerance:
                raise ConfigurationError(
                    f"{name} does not satisfy the constraint: {self.constraint.frame!r} is {off:.3f} rad off, "
                    f"{self.constraint.tolerance:g} are allowed (tolerance)"
                )

    def project(
        self, coordinates: Array, *, places: Array | None = None, steps: int = _MOST_NEWTON_STEPS
    ) -> tuple[Array, Array]:
        """Rows (N, nv) that satisfy the constraint, by the least motion of the joints, and by how much (N,) [rad] each
        misses it still.

        The base stays, because the path decides where it drives.

        Args:
            coordinates: the rows.
            places: (N, 3) what to look at [m] at each of them; what is known of it where None.
            steps: Newton's steps, at most.
        """
        space, b = self._robot.space, self._robot.space.base_nv
        rows = coordinates.copy()
        kin = Kinematics(self._robot.tree, len(rows))
        for k in range(steps + 1):
            kin.update(rows)
            at = self._places(kin) if places is None else places
            angle = self._errors(kin, at)
            todo = angle > self.enough
            if not todo.any() or k == steps:
                break
            off, slopes = self._residual(kin, at)
            J = slopes[todo][:, :, b:]  # (K, 3, n)
            step = np.linalg.solve(J @ J.transpose(0, 2, 1) + _PROJECTION_DAMPING * np.eye(3), off[todo][:, :, None])
            move = -(J.transpose(0, 2, 1) @ step)[:, :, 0]
            longest = np.abs(move).max(axis=1, keepdims=True)
            rows[todo, b:] += move * np.minimum(1.0, _LARGEST_JOINT_STEP / np.maximum(longest, _LARGEST_JOINT_STEP))
            np.clip(rows, space.lower, space.upper, out=rows)
        return rows, angle

    def project_path(self, coordinates: Array) -> Array:
        """Rows (N, nv) of a path whose inner ones are moved to where they satisfy the constraint, as :meth:`project`.

        Where neighbours end in different postures, of which there are many where the base has turned far, they are
        moved one after the other: what one is moved by, the next one is moved by first, from both ends on.
        """
        space, n = self._robot.space, len(coordinates)
        rows, _ = self.project(coordinates)
        rows[[0, -1]] = coordinates[[0, -1]]
        apart = [np.abs(space.difference(each[:-1], each[1:])[:, space.base_nv :]) for each in (coordinates, rows)]
        if (apart[1] <= apart[0] + _LARGEST_JOINT_STEP).all():
            return rows
        moved = np.zeros((2, *coordinates.shape))
        for way, order in enumerate((range(1, n - 1), range(n - 2, 0, -1))):
            last = np.zeros((1, space.nv))
            for k in order:
                first = space.integrate(coordinates[k : k + 1], last)
                row, _ = self.project(np.clip(first, space.lower, space.upper))
                last = space.difference(coordinates[k : k + 1], row)
                moved[way, k] = last[0]
        share = np.linspace(0.0, 1.0, n)[:, None]
        blended = space.integrate(coordinates, (1.0 - share) * moved[0] + share * moved[1])
        rows, _ = self.project(np.clip(blended, space.lower, space.upper))
        rows[[0, -1]] = coordinates[[0, -1]]
        return rows

    def residual(self, kin: Kinematics) -> tuple[Array, Array]:
        """By how much the axis misses its target, (N, 3), and the derivatives of that, (N, 3, nv)."""
        return self._residual(kin, self._places(kin))

    def _residual(self, kin: Kinematics, places: Array | None) -> tuple[Array, Array]:
        a = self._axes(kin)
        columns = kin.columns(self._joint)
        turning = columns[..., 3:]  # (N, nv, 3)
        slopes = np.cross(turning, a[:, None, :])
        if places is None:
            return a - (a if self._target is None else self._target), slopes.transpose(0, 2, 1)
        origins = self._origins(kin)
        line = places - origins
        sight = np.maximum(np.linalg.norm(line, axis=1), _LEAST_SIGHT)
        d = line / sight[:, None]
        moving = columns[..., :3] + np.cross(turning, origins[:, None, :])  # of the origin
        aside = moving - np.einsum("nvi,ni->nv", moving, d)[..., None] * d[:, None, :]
        return a - d, (slopes + aside / sight[:, None, None]).transpose(0, 2, 1)

    def places_at(self, scene: Scene, times: Array) -> Array | None:
        """(K, 3) what the axis is to point at [m] at times (K,) [s], by where it is and how it moves in a scene; None
        for a direction, or if not known."""
        if self._place is None:
            return None
        places = np.tile(self._place, (len(times), 1))
        if self._obstacle >= 0:
            known = scene.obstacles[self._obstacle]
            if known.motion is not None and not isinstance(known.motion, UnknownMotion):
                places += (times - scene.time)[:, None] * known.velocity()[0]
        return places

    def _errors(self, kin: Kinematics, places: Array | None) -> Array:
        a, target = self._axes(kin), self._target
        if places is not None:
            line = places - self._origins(kin)
            sight = np.linalg.norm(line, axis=1)
            target = line / np.maximum(sight, 1e-12)[:, None]
        elif target is None:
            return np.full(kin.n, np.pi)
        off = np.arctan2(np.linalg.norm(np.cross(a, target), axis=1), (a * target).sum(axis=1))
        return off if places is None else np.where(sight > _LEAST_SIGHT, off, np.pi)

    def _places(self, kin: Kinematics) -> Array | None:
        """(N, 3) what the axis is to point at [m] when each node is reached; None for a direction, or if not known."""
        if self._place is None:
            return None
        places = np.tile(self._place, (kin.n, 1))
        if self._prediction is not None:
            forecast = self._prediction(kin.coordinates[: kin.n])
            (column,) = np.nonzero(forecast.obstacles == self._obstacle)
            if len(column):
                places += forecast.shift[:, column[0]]
        return places

    def _sight(self, kin: Kinematics) -> Array:
        places = self._places(kin)
        return np.full(kin.n, np.inf) if places is None else np.linalg.norm(places - self._origins(kin), axis=1)

    def _slides(self, v: Array) -> Array:
        """Bounds (N,) [m] on how far the frame's origin moves along tangents (N, nv); 0 where that does not matter."""
        if self._target is not None:
            return np.zeros(len(v))
        if self._travel is None:
            self._travel = MotionBounds(_point(self._robot, self._joint, self._origin))
        return self._travel.travel(v)[:, 0]

    def _axes(self, kin: Kinematics) -> Array:
        """(N, 3) the axis in the world."""
        return kin.T[self._joint, : kin.n, :, :3] @ self._axis

    def _origins(self, kin: Kinematics) -> Array:
        """(N, 3) the frame's origin in the world [m]."""
        T = kin.T[self._joint, : kin.n]
        return T[:, :, :3] @ self._origin + T[:, :, 3]


def _least_between(sight: Array, way: Array) -> Array:
    """Bounds (N − 1,) from below [m] on distances between looks at which they are ``sight`` (N,), ``way`` apart."""
    return np.maximum(0.5 * (sight[:-1] + sight[1:] - way), 0.0)


def _point(robot: RobotModel, joint: int, local: Array) -> BodySet:
    """A point of a joint's aligned frame as a body, to bound its motion."""
    return BodySet(
        tree=robot.tree,
        names=("point",),
        labels=("point",),
        geometries=(coal.Sphere(0.0),),
        joint=np.array([joint], dtype=np.intp),
        rotation=np.eye(3)[None],
        translation=local[None],
        ends=np.tile(local, (1, 2, 1)),
        radius=np.zeros(1),
    )


def _frame(robot: RobotModel, name: str) -> int:
    index = find_frame(robot.model, name)
    if index is None:
        names = [frame.name for frame in robot.model.frames]
        raise RobotError(f"constraint: unknown frame {name!r}{nearest_name(name, names)}")
    return index
