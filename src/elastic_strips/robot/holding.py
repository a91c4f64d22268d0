"""Held objects: another robot value, with a shape that a frame carries among its pieces and self pairs."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol, TypeVar

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.errors import ConfigurationError, RobotError, nearest_name
from elastic_strips.validation import check_number

from .geometry import LinkGeometry, piece_of
from .kinematics import find_frame
from .unchecked_pairs import UncheckedPair, WhyUnchecked
from .value import RobotValue

R = TypeVar("R", bound=RobotValue)
_COLOR = np.array([0.85, 0.65, 0.25, 1.0])


class HeldPart(Protocol):
    """A convex part of a shape, in the shape's frame; a block of boxes where there is no geometry."""

    @property
    def geometry(self) -> coal.CollisionGeometry | None: ...
    @property
    def T_obstacle_part(self) -> Array: ...
    @property
    def boxes(self) -> Sequence[tuple[coal.Box, Array]]: ...


class HeldShape(Protocol):
    """A shape at a pose (4, 4): every obstacle is one."""

    @property
    def name(self) -> str | None: ...
    @property
    def pose(self) -> Array: ...
    @property
    def parts(self) -> Sequence[HeldPart]: ...


@dataclass(frozen=True, slots=True)
class _InFrame:
    """A shape at a pose (4, 4) in the frame that carries it."""

    name: str | None
    pose: Array
    parts: Sequence[HeldPart]


def attached(
    robot: R,
    shape: HeldShape,
    frame: str,
    *,
    q: ArrayLike | None = None,
    touch: Collection[str] = (),
    mass: float = 0.0,
    name: str | None = None,
) -> R:
    """The robot with a shape that one of its frames carries.

    The shape is part of the robot from then on: of distances and certificates, of its own collisions and of pictures.
    It must not touch the robot's other links, except those that ``touch`` names and those that move with the frame.

    Args:
        robot: the robot.
        shape: what is held: an obstacle. Its pose is in the frame, or in the world where ``q`` is given.
        frame: name of the frame that carries it.
        q: (nq,) the configuration in which it is taken up.
        touch: names of links that may touch it: fingers.
        mass: its mass [kg], at its origin.
        name: what to call it; the shape's name, or ``"load"``, where None.

    Raises:
        RobotError: an unknown frame or link, a name that a piece of the robot has already, or a negative mass.
        ConfigurationError: ``q`` is not valid, or the shape touches another link there.
    """
    index = find_frame(robot.model, frame)
    if index is None:
        raise RobotError(
            f"{robot.name!r} has no frame {frame!r}{nearest_name(frame, [f.name for f in robot.model.frames])}"
        )
    allowed = _links_that_touch(robot, touch)
    name = name or shape.name or "load"
    if any(piece.name == name or name in piece.links for piece in robot.geometries):
        raise RobotError(f"{robot.name!r} has a link or a shape {name!r} already; name=… gives another name")
    weight = check_number("mass", mass, low=0.0, error=RobotError)
    carrier = robot.model.frames[index]
    joint = int(carrier.parentJoint)
    if joint == 0:
        raise RobotError(f"frame {frame!r} of {robot.name!r} does not move: what it carries is an obstacle")
    T_joint_shape = _pose_in_joint(robot, carrier, shape.pose, q)
    pieces = _pieces(shape, name, joint, T_joint_shape)
    pairs, unchecked = _pairs(robot, len(pieces), joint, allowed, name)
    model = robot.model.copy()
    if weight > 0.0:
        model.appendBodyToJoint(joint, pin.Inertia(weight, np.zeros(3), np.zeros((3, 3))), pin.SE3(T_joint_shape))
    load = [_object(piece, index) for piece in pieces]
    eyes = robot.eyes
    if eyes is not None:  # what the robot holds is in its pictures, too
        there = np.linalg.inv(carrier.placement.homogeneous) @ T_joint_shape
        eyes = attached(eyes, _InFrame(name, there, shape.parts), frame, touch=touch, mass=weight)
    held = replace(
        robot,
        model=model,
        collision_model=_with_load(robot.collision_model, load, pairs),
        geometries=(*robot.geometries, *pieces),
        self_pairs=np.concatenate((robot.self_pairs, np.array(pairs, dtype=np.intp).reshape(-1, 2))),
        self_apart=np.concatenate((robot.self_apart, np.zeros(len(pairs)))),
        unchecked_pairs=(*robot.unchecked_pairs, *unchecked),
        visual=partial(_drawn_with_load, robot, load),
        eyes=eyes,
    )
    if q is None or robot.self_collision(q) is not None:
        return held
    hit = held.self_collision(q)
    if hit is not None:
        raise ConfigurationError(
            f"{name!r} touches the robot where it is taken up: {hit[0]!r} and {hit[1]!r}; touch=[…] names the links "
            "that may"
        )
    return held


def _links_that_touch(robot: RobotValue, touch: Collection[str]) -> set[str]:
    """The links that may touch a load, which the robot must have."""
    allowed = {touch} if isinstance(touch, str) else set(touch)
    links = sorted({link for piece in robot.geometries for link in piece.links})
    for link in sorted(allowed - {f.name for f in robot.model.frames}):
        raise RobotError(f"touch: {robot.name!r} has no link {link!r}{nearest_name(link, links)}")
    return allowed


def _pose_in_joint(robot: RobotValue, carrier: pin.Frame, pose: Array, q: ArrayLike | None) -> Array:
    """Pose (4, 4) in its joint of what a frame carries: from that in the frame, or in the world at ``q``."""
    if q is None:
        return np.array(carrier.placement.homogeneous) @ pose
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.check_q(q))
    return np.linalg.inv(data.oMi[carrier.parentJoint].homogeneous) @ pose


def _with_load(
    shapes: pin.GeometryModel, load: Sequence[pin.GeometryObject], pairs: Sequence[tuple[int, int]] = ()
) -> pin.GeometryModel:
    """Shapes and a load, of which further pairs can touch."""
    both = shapes.clone()
    for item in load:
        both.addGeometryObject(item)
    for i, k in pairs:
        both.addCollisionPair(pin.CollisionPair(i, k))
    return both


def _drawn_with_load(robot: RobotValue, load: Sequence[pin.GeometryObject]) -> pin.GeometryModel:
    drawn = robot.visual_model
    return _with_load(drawn, load) if drawn.ngeoms else drawn.clone()  # else what collides is drawn, the load with it


def _pairs(
    robot: RobotValue, count: int, joint: int, allowed: set[str], name: str
) -> tuple[list[tuple[int, int]], list[UncheckedPair]]:
    """Pairs of the robot's pieces with those of a load on a joint, which come after them; and pairs not looked at."""
    others = [(i, own) for i, own in enumerate(robot.geometries) if own.joint != joint]
    first = len(robot.geometries)
    pairs = [(i, first + k) for k in range(count) for i, own in others if not allowed & set(own.links)]
    may_touch = {link for _, own in others if allowed & set(own.links) for link in own.links}
    unchecked = [UncheckedPair((min(link, name), max(link, name)), WhyUnchecked.ALLOWED) for link in sorted(may_touch)]
    return pairs, unchecked


def _pieces(shape: HeldShape, name: str, joint: int, T: Array) -> list[LinkGeometry]:
    """The parts of a shape as pieces of the robot, in a joint's frame."""
    found: list[tuple[coal.CollisionGeometry, Array]] = []
    for part in shape.parts:
        if part.geometry is not None:
            found.append((part.geometry, part.T_obstacle_part))
            continue
        for box, at in part.boxes:
            placed = part.T_obstacle_part.copy()
            placed[:3, 3] += placed[:3, :3] @ at
            found.append((box, placed))
    names = [name] if len(found) == 1 else [f"{name}_{k}" for k in range(len(found))]
    return [
        piece_of(each, (name,), joint, geometry, T @ placed)
        for each, (geometry, placed) in zip(names, found, strict=True)
    ]


def _object(piece: LinkGeometry, frame: int) -> pin.GeometryObject:
    pose = pin.SE3(piece.placement[:3, :3], piece.placement[:3, 3])
    made = pin.GeometryObject(piece.name, piece.joint, frame, pose, piece.geometry)
    made.meshColor = _COLOR
    return made
