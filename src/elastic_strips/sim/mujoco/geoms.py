"""MuJoCo geoms: what collides in the simulation: the robot's convex pieces, wheels, casters, and obstacles."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ParameterError
from elastic_strips.execution.limits import MotionLimits
from elastic_strips.robot import LinkGeometry, RobotModel
from elastic_strips.robot.geometry import support_points
from elastic_strips.scene import Obstacle

FLOOR, ROLLING, LINK, OBSTACLE = range(4)
"""Kinds of geoms: the floor; wheels and casters; the robot's other links; obstacles."""

_WITH_OBSTACLES, WITH_FLOOR = 1, 2  # bits of contype and conaffinity
_TYRE = 0.02  # [m] half the width of a driven wheel
_TYRE_CONTACT = (0.006, 1.0)  # solref: time constant [s], damping ratio
# Softer, as if on springs: the driven wheels carry nine tenths of the weight. On four rigid points its share is left
# to chance, and in fast curves the inner wheel lifted and lost its grip.
_CASTER_CONTACT = (0.02, 1.0)
_CONE_SIDES = 64


def add_robot(mujoco: Any, spec: Any, robot: RobotModel, limits: MotionLimits, wheels: list[str]) -> None:
    """The robot's pieces, its wheels and its casters; nothing of the robot touches the robot."""
    root = spec.worldbody.first_body()
    first = 2  # joint 1 is the planar root
    for piece in robot.geometries:
        if all(_rolls(link) for link in piece.links):
            continue
        carried = piece.joint >= first
        body = spec.joint(robot.model.names[piece.joint]).parent if carried else root
        # what the base carries may include wheels in one hull, so only the arm can touch the floor
        bits = _WITH_OBSTACLES | (WITH_FLOOR if carried else 0)
        for values in shape_geoms(mujoco, spec, piece.geometry, piece.placement, f"robot:{piece.name}"):
            body.add_geom(name=_name(spec, f"{LINK}|{_link(piece)}"), contype=bits, conaffinity=0, mass=0.0, **values)
    # Tyres are crowned: one point of contact each, half a track off the middle. A cylinder touches along a line, whose
    # two ends MuJoCo takes as points that cannot both roll in a turn: measured, the robot turned a quarter too slowly.
    for wheel in wheels:
        joint = spec.joint(wheel)
        quat = np.zeros(4)
        mujoco.mju_quatZ2Vec(quat, np.array(joint.axis))
        joint.parent.add_geom(
            name=_name(spec, f"{ROLLING}|{joint.parent.name}"), type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, quat=quat,
            size=[limits.wheel_radius, limits.wheel_radius, _TYRE], contype=_WITH_OBSTACLES | WITH_FLOOR,
            conaffinity=0, mass=0.0, priority=1, condim=3, friction=[1.0, 0.005, 0.0001], solref=_TYRE_CONTACT,
        )  # fmt: skip
    casters = [b for b in spec.bodies if "caster" in b.name.lower() and b.first_body() is None]
    if not casters:
        raise ParameterError(f"{robot.urdf_path}: no link named *caster* holds the base up beside its two wheels")
    model = spec.copy().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for body in casters:
        height = float(data.xpos[mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body.name)][2])
        if height > 0.0:
            body.add_geom(
                name=_name(spec, f"{ROLLING}|{body.name}"), type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[height, 0.0, 0.0],
                contype=_WITH_OBSTACLES | WITH_FLOOR, conaffinity=0, mass=0.0, priority=2, condim=1,
                solref=_CASTER_CONTACT,
            )  # fmt: skip


def add_obstacle(mujoco: Any, spec: Any, name: str, obstacle: Obstacle) -> bool:
    """One body with a geom per convex part; True where it moves."""
    moves = obstacle.motion is not None
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, obstacle.pose[:3, :3].ravel().copy())
    body = spec.worldbody.add_body(name=f"obstacle:{name}", pos=obstacle.pose[:3, 3], quat=quat, mocap=moves)
    count = 0
    for part in obstacle.parts:
        members = part.boxes if part.geometry is None else ((part.geometry, np.zeros(3)),)
        for shape, offset in members:
            T = np.array(part.T_obstacle_part)
            T[:3, 3] += offset
            for values in shape_geoms(mujoco, spec, shape, T, f"obstacle:{name}:{count}"):
                count += 1
                body.add_geom(
                    name=_name(spec, f"{OBSTACLE}|{name}"), contype=0, conaffinity=_WITH_OBSTACLES, mass=0.0, **values
                )
    return moves


def shape_geoms(mujoco: Any, spec: Any, shape: Any, T: Array, name: str) -> list[dict[str, Any]]:
    """Keywords of the geoms that make up a Coal shape at the pose T (4, 4) in its body."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(T[:3, :3]).ravel())
    values: dict[str, Any] = {"pos": T[:3, 3].copy(), "quat": quat}
    kinds = mujoco.mjtGeom
    if isinstance(shape, coal.Sphere):
        return [{**values, "type": kinds.mjGEOM_SPHERE, "size": [float(shape.radius), 0.0, 0.0]}]
    if isinstance(shape, coal.Box):
        return [{**values, "type": kinds.mjGEOM_BOX, "size": np.array(shape.halfSide).ravel()}]
    if isinstance(shape, (coal.Cylinder, coal.Capsule)):
        kind = kinds.mjGEOM_CYLINDER if isinstance(shape, coal.Cylinder) else kinds.mjGEOM_CAPSULE
        return [{**values, "type": kind, "size": [float(shape.radius), float(shape.halfLength), 0.0]}]
    if isinstance(shape, coal.Cone):
        angle = np.linspace(0.0, 2.0 * np.pi, _CONE_SIDES, endpoint=False)
        ring = float(shape.radius) / np.cos(np.pi / _CONE_SIDES) * np.column_stack((np.cos(angle), np.sin(angle)))
        h = float(shape.halfLength)
        points = np.vstack((np.column_stack((ring, np.full(len(ring), -h))), [[0.0, 0.0, h]]))
    else:
        points, _ = support_points(shape)
    mesh = f"{name}:{len(spec.meshes)}"
    spec.add_mesh(name=mesh, uservert=points.ravel())
    return [{**values, "type": kinds.mjGEOM_MESH, "meshname": mesh}]


def _rolls(link: str) -> bool:
    return "wheel" in link.lower() or "caster" in link.lower()


def _link(piece: LinkGeometry) -> str:
    return piece.links[0] if len(piece.links) == 1 else piece.name


def _name(spec: Any, text: str) -> str:
    """A geom's name: kind, owner, and a number that makes it unique."""
    return f"{text}#{len(spec.geoms)}"
