"""MuJoCo model: a robot's URDF on its wheels and casters, on a floor, among obstacles as physical bodies."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import coal
import numpy as np
import numpy.typing as npt
from lxml import etree

from elastic_strips.arrays import Array
from elastic_strips.coal_shapes import ShapeKind, shape_of, support_points
from elastic_strips.errors import ParameterError, RobotError, missing_extra
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.robot.geometry import LinkGeometry
from elastic_strips.robot.xml_file import read_xml
from elastic_strips.scene import Obstacle
from elastic_strips.sim.plant import PlantParams
from elastic_strips.trajectory import MotionLimits

FLOOR, ROLLING, LINK, OBSTACLE = range(4)
"""Kinds of geoms: the floor; wheels and casters; the robot's other links; obstacles."""

_WITH_OBSTACLES, _WITH_FLOOR = 1, 2  # bits of contype and conaffinity
_TYRE_HALF_WIDTH = 0.02  # [m] half the width of a driven wheel
_TYRE_CONTACT = (0.006, 1.0)  # solref: time constant [s], damping ratio
# Softer, as with springs, so that the driven wheels carry nine tenths of the weight. On four rigid points their share
# is undetermined, and in fast curves the inner wheel lifted and lost its grip.
_CASTER_CONTACT = (0.02, 1.0)
_CONE_SIDES = 64


def _add_robot(mujoco: ModuleType, spec: Any, robot: RobotModel, limits: MotionLimits, wheels: list[str]) -> None:
    """The robot's pieces, its wheels and its casters; nothing of the robot touches the robot."""
    root = spec.worldbody.first_body()
    first = 2  # joint 1 is the planar root
    for piece in robot.geometries:
        if all(_rolls(link) for link in piece.links):
            continue
        carried = piece.joint >= first
        body = spec.joint(robot.model.names[piece.joint]).parent if carried else root
        # what the base carries may include wheels in one hull, so only the arm can touch the floor
        bits = _WITH_OBSTACLES | (_WITH_FLOOR if carried else 0)
        for values in _shape_geoms(mujoco, spec, piece.geometry, piece.placement, f"robot:{piece.name}"):
            body.add_geom(name=_name(spec, f"{LINK}|{_link(piece)}"), contype=bits, conaffinity=0, mass=0.0, **values)
    # Tyres are crowned: one point of contact each, half a track off the middle. A cylinder touches along a line, whose
    # two ends MuJoCo takes as points that cannot both roll in a turn: measured, the robot turned a quarter too slowly.
    for wheel in wheels:
        joint = spec.joint(wheel)
        quat = np.zeros(4)
        mujoco.mju_quatZ2Vec(quat, np.array(joint.axis))
        joint.parent.add_geom(
            name=_name(spec, f"{ROLLING}|{joint.parent.name}"),
            type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
            quat=quat,
            size=[limits.wheel_radius, limits.wheel_radius, _TYRE_HALF_WIDTH],
            contype=_WITH_OBSTACLES | _WITH_FLOOR,
            conaffinity=0,
            mass=0.0,
            priority=1,
            condim=3,
            friction=[1.0, 0.005, 0.0001],
            solref=_TYRE_CONTACT,
        )
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
                name=_name(spec, f"{ROLLING}|{body.name}"),
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                size=[height, 0.0, 0.0],
                contype=_WITH_OBSTACLES | _WITH_FLOOR,
                conaffinity=0,
                mass=0.0,
                priority=2,
                condim=1,
                solref=_CASTER_CONTACT,
            )


def _add_obstacle(mujoco: ModuleType, spec: Any, name: str, obstacle: Obstacle) -> bool:
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
            for values in _shape_geoms(mujoco, spec, shape, T, f"obstacle:{name}:{count}"):
                count += 1
                body.add_geom(
                    name=_name(spec, f"{OBSTACLE}|{name}"), contype=0, conaffinity=_WITH_OBSTACLES, mass=0.0, **values
                )
    return moves


def _shape_geoms(
    mujoco: ModuleType, spec: Any, shape: coal.CollisionGeometry, T: Array, name: str
) -> list[dict[str, Any]]:
    """Keywords of the geoms that make up a Coal shape at the pose T (4, 4) in its body."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(T[:3, :3]).ravel())
    values: dict[str, object] = {"pos": T[:3, 3].copy(), "quat": quat}
    kinds = mujoco.mjtGeom
    primitives = {
        ShapeKind.SPHERE: kinds.mjGEOM_SPHERE,
        ShapeKind.BOX: kinds.mjGEOM_BOX,
        ShapeKind.CYLINDER: kinds.mjGEOM_CYLINDER,
        ShapeKind.CAPSULE: kinds.mjGEOM_CAPSULE,
    }
    kind, size = shape_of(shape)
    if kind in primitives:
        return [{**values, "type": primitives[kind], "size": [*size, 0.0, 0.0][:3]}]
    if kind is ShapeKind.CONE:
        radius, h = size
        angle = np.linspace(0.0, 2.0 * np.pi, _CONE_SIDES, endpoint=False)
        ring = radius / np.cos(np.pi / _CONE_SIDES) * np.column_stack((np.cos(angle), np.sin(angle)))
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


_JOINT_ARMATURE = (
    0.1  # [kg m²] rotors seen through their gears; the geared drives of arms of this size have 0.05 to 0.5
)
_SLIDE_ARMATURE = 5.0  # [kg]
_WHEEL_ARMATURE = 0.01  # [kg m²]
_LOOP_TIME = (
    0.01  # [s] time constant of the joints' speed loops alone; the rest of their lag is a filter of the command
)


def import_mujoco() -> ModuleType:
    """The package ``mujoco``.

    Raises:
        MissingExtraError: it is not installed.
    """
    try:
        import mujoco  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise missing_extra("the MuJoCo plant", "mujoco", "sim") from error
    return mujoco


@dataclass(frozen=True, eq=False)
class MujocoModel:
    """A compiled model and where the robot's parts are in it.

    Attributes:
        model: ``mujoco.MjModel``.
        base: body index of the root link.
        wheel_qpos, wheel_dof: (2,) addresses of the driven wheels, left and right.
        wheel_sign: (2,) +1 where a positive turn drives forward.
        joint_qpos, joint_dof: (n,) addresses of the planned joints.
        kind: (ngeom,) FLOOR, ROLLING, LINK or OBSTACLE.
        owner: name of each geom's link or obstacle.
        obstacle_geoms: obstacle name → its geoms.
        mocap: moving obstacle name → mocap index.
        compensation: ((2 + n), (2 + n)) drag [1] and friction [rad/s or m/s] of the joints over the gains of their
            motors, for the drives to make up for.
        filters: (2 + n) time constants [s] of the filters of the commands.
    """

    model: Any
    base: int
    wheel_qpos: npt.NDArray[np.intp]
    wheel_dof: npt.NDArray[np.intp]
    wheel_sign: Array
    joint_qpos: npt.NDArray[np.intp]
    joint_dof: npt.NDArray[np.intp]
    kind: npt.NDArray[np.intp]
    owner: tuple[str, ...]
    obstacle_geoms: dict[str, npt.NDArray[np.intp]]
    mocap: dict[str, int]
    compensation: tuple[Array, Array]
    filters: Array


def build_model(
    robot: RobotModel, limits: MotionLimits, obstacles: Iterable[Obstacle], params: PlantParams, timestep: float
) -> MujocoModel:
    """Compile a robot among obstacles.

    Masses, inertias, joints and effort limits are the URDF's. Collision shapes are the robot's convex pieces, the ones
    of certificates, except for the driven wheels (ellipsoids, as crowned tyres) and the casters (frictionless
    spheres).

    Raises:
        ParameterError: the robot has no differential drive, no URDF, no wheels or casters in it, or joints that follow
            others.
        RobotError: MuJoCo refuses the model; the message quotes it.
    """
    if robot.base_kind is not BaseKind.DIFF_DRIVE or robot.urdf_path is None:
        raise ParameterError(
            f"MujocoPlant drives robots from a URDF with a differential drive; {robot.name!r} has base "
            f"{robot.base_kind.value!r} and URDF {robot.urdf_path!r}. KinematicPlant drives any robot"
        )
    path = Path(robot.urdf_path)
    if robot.followers:
        raise ParameterError(
            f"MujocoPlant moves no joints that follow others (<mimic>), and {robot.name!r} has "
            f"{', '.join(robot.followers)}: plan without their leaders (joints=…, --joints). KinematicPlant moves them"
        )
    mujoco = import_mujoco()
    try:
        spec = mujoco.MjSpec.from_string(_bare_urdf(path))
        missing = [n for n in robot.joint_names if spec.joint(n) is None]
        if missing:
            raise RobotError(f"{path}: MuJoCo did not read the joints {', '.join(missing)}")
        wheels = _driven_wheels(mujoco, spec, limits, path)
        _lock(mujoco, spec, robot, {w[0] for w in wheels})
        root = spec.worldbody.first_body()
        root.add_freejoint()
        _options(mujoco, spec, timestep)
        _add_robot(mujoco, spec, robot, limits, [w[0] for w in wheels])
        kinds = {name: _add_obstacle(mujoco, spec, name, o) for name, o in ((o.name or "", o) for o in obstacles)}
        compensation = _add_motors(mujoco, spec, robot, limits, params, [w[0] for w in wheels])
        model = spec.compile()
    except ValueError as error:
        if isinstance(error, (ParameterError, RobotError)):
            raise
        raise RobotError(f"{path}: MuJoCo cannot build the model: {' '.join(str(error).split())}") from None
    filters = np.array([0.0] * 2 + [max(params.joint_lag - _LOOP_TIME, 0.0)] * len(robot.joint_names))
    return _layout(mujoco, model, robot, wheels, kinds, compensation, filters)


def _bare_urdf(path: Path) -> str:
    """The URDF's links and joints without shapes; inertias that MuJoCo would refuse are given a thickness."""
    root = read_xml(path, root="robot", kind="URDF")
    for element in list(root):
        if element.tag not in ("link", "joint"):
            root.remove(element)
            continue
        for child in list(element):
            shape = child.tag in ("visual", "collision", "safety_controller", "mimic", "calibration")
            if shape or (child.tag == "inertial" and _weightless(child)):
                element.remove(child)
    extension = etree.SubElement(root, "mujoco")
    etree.SubElement(extension, "compiler", fusestatic="false", balanceinertia="true")
    return etree.tostring(root, encoding="unicode")


def _weightless(inertial: Any) -> bool:
    """Whether an <inertial> has no mass; one with mass and no inertia gets that of a ball of 1 cm about its centre."""
    mass = float(inertial.find("mass").get("value"))
    if mass <= 0.0:
        return True
    inertia = inertial.find("inertia")
    value = {k: float(inertia.get(k, "0")) for k in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")}
    matrix = np.array(
        [
            [value["ixx"], value["ixy"], value["ixz"]],
            [value["ixy"], value["iyy"], value["iyz"]],
            [value["ixz"], value["iyz"], value["izz"]],
        ]
    )
    if np.linalg.eigvalsh(matrix).min() <= 1e-12:
        for key in value:
            inertia.set(key, repr(0.4 * mass * 1e-4 if key in ("ixx", "iyy", "izz") else 0.0))
    return False


def _lock(mujoco: ModuleType, spec: Any, robot: RobotModel, kept: set[str]) -> None:
    """Weld every joint that is neither planned nor a driven wheel at its locked value."""
    for joint in list(spec.joints):
        if joint.name in robot.joint_names or joint.name in kept:
            continue
        body, value = joint.parent, float(robot.locked.get(joint.name, 0.0))
        if value != 0.0:
            if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
                step = np.zeros(3)
                mujoco.mju_rotVecQuat(step, np.array(joint.axis) * value, np.array(body.quat))
                body.pos = np.array(body.pos) + step
            else:
                turn, out = np.zeros(4), np.zeros(4)
                mujoco.mju_axisAngle2Quat(turn, np.array(joint.axis), value)
                mujoco.mju_mulQuat(out, np.array(body.quat), turn)
                body.quat = out
        spec.delete(joint)


def _options(mujoco: ModuleType, spec: Any, timestep: float) -> None:
    option = spec.option
    option.timestep = timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0  # soft friction creeps; this makes it ten times as stiff as the normal direction
    spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], contype=0, conaffinity=_WITH_FLOOR
    )


def _driven_wheels(mujoco: ModuleType, spec: Any, limits: MotionLimits, path: Path) -> list[tuple[str, float]]:
    """Names of the left and the right driven wheel's joints, and their signs."""
    model = spec.copy().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found: list[tuple[float, str, float]] = []
    for joint in spec.joints:
        i = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint.name)
        if "wheel" not in joint.name.lower() or model.jnt_limited[i] or abs(data.xaxis[i][1]) < 0.999:
            continue
        y = float(data.xanchor[i][1])
        if abs(abs(y) - 0.5 * limits.track) < 2e-3:
            found.append((y, joint.name, math.copysign(1.0, data.xaxis[i][1])))
    found.sort()
    if len(found) != 2 or found[0][0] * found[1][0] >= 0.0:
        raise ParameterError(
            f"{path}: of the continuous joints named *wheel* about ±y, {[f[1] for f in found]} lie half a track "
            f"({0.5 * limits.track:g} m) off the middle; one on either side is needed"
        )
    (_, right, right_sign), (_, left, left_sign) = found
    return [(left, left_sign), (right, right_sign)]


def _add_motors(
    mujoco: ModuleType, spec: Any, robot: RobotModel, limits: MotionLimits, params: PlantParams, wheels: list[str]
) -> tuple[Array, Array]:
    """Speed loops: torque = kv (command − speed), with kv such that what the motor moves follows with a time constant.

    It is the wheels' lag for the wheels. The joints' loops are stiffer than their lag, so that the forces of the other
    joints disturb them less; a filter of the command makes up the difference.

    Returns drag and friction of each motor's joint over kv, for the drives to make up for.
    """
    motors = [*wheels, *robot.joint_names]
    for name in motors:
        joint = spec.joint(name)
        slides = joint.type == mujoco.mjtJoint.mjJNT_SLIDE
        joint.armature = _WHEEL_ARMATURE if name in wheels else (_SLIDE_ARMATURE if slides else _JOINT_ARMATURE)
    inertia = _inertia(mujoco, spec, robot, motors)
    total = float(sum(b.mass for b in spec.bodies))
    inertia[:2] = _WHEEL_ARMATURE + 0.5 * total * limits.wheel_radius**2
    loop = np.array([max(params.wheel_lag, _LOOP_TIME)] * 2 + [_LOOP_TIME] * len(robot.joint_names))
    kv = inertia / loop
    for name, gain in zip(motors, kv.tolist(), strict=True):
        joint = spec.joint(name)
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_velocity(kv=gain)
        if joint.actfrcrange[1] > 0.0:
            motor.forcelimited, motor.forcerange = True, joint.actfrcrange
    drag = np.array([float(np.ravel(spec.joint(name).damping)[0]) for name in motors])
    friction = np.array([float(spec.joint(name).frictionloss) for name in motors])
    return drag / kv, friction / kv


def _inertia(mujoco: ModuleType, spec: Any, robot: RobotModel, motors: list[str]) -> Array:
    """Largest inertia [kg m² or kg] that each motor has to move, at home and with all joints at zero."""
    model = spec.copy().compile()
    data = mujoco.MjData(model)
    coordinates = robot.space.to_coordinates(robot.home_q)[robot.space.base_nv :]
    ids = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, n) for n in motors]
    dofs = model.jnt_dofadr[ids]
    unit, column = np.zeros(model.nv), np.zeros(model.nv)
    most = np.zeros(len(motors))
    for joints in (coordinates, np.zeros_like(coordinates)):
        data.qpos[model.jnt_qposadr[ids[2:]]] = joints
        mujoco.mj_forward(model, data)
        for i, dof in enumerate(dofs):
            unit[dof] = 1.0
            mujoco.mj_mulM(model, data, column, unit)
            unit[dof] = 0.0
            most[i] = max(most[i], float(column[dof]))
    return most


def _layout(
    mujoco: ModuleType,
    model: Any,
    robot: RobotModel,
    wheels: list[tuple[str, float]],
    moves: dict[str, bool],
    compensation: tuple[Array, Array],
    filters: Array,
) -> MujocoModel:
    def ids(kind: Any, names: Iterable[str]) -> npt.NDArray[np.intp]:
        return np.array([mujoco.mj_name2id(model, kind, n) for n in names], dtype=np.intp)

    kind, owner = np.zeros(model.ngeom, dtype=np.intp), []
    for g in range(model.ngeom):
        code, _, rest = model.geom(g).name.partition("|")
        kind[g] = FLOOR if code == "floor" else int(code)
        owner.append(rest.rpartition("#")[0] if rest else "floor")
    wheel = ids(mujoco.mjtObj.mjOBJ_JOINT, [w[0] for w in wheels])
    joint = ids(mujoco.mjtObj.mjOBJ_JOINT, robot.joint_names)
    geoms = {n: np.array([g for g in range(model.ngeom) if kind[g] == OBSTACLE and owner[g] == n]) for n in moves}
    bodies = {n: mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"obstacle:{n}") for n, m in moves.items() if m}
    return MujocoModel(
        model=model,
        base=int(model.body_rootid[model.jnt_bodyid[wheel[0]]]),
        wheel_qpos=model.jnt_qposadr[wheel],
        wheel_dof=model.jnt_dofadr[wheel],
        wheel_sign=np.array([w[1] for w in wheels]),
        joint_qpos=model.jnt_qposadr[joint],
        joint_dof=model.jnt_dofadr[joint],
        kind=kind,
        owner=tuple(owner),
        obstacle_geoms=geoms,
        mocap={n: int(model.body_mocapid[b]) for n, b in bodies.items()},
        compensation=compensation,
        filters=filters,
    )
