"""MuJoCo plant: rigid-body simulation of a robot on two driven wheels and casters, with contact."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.errors import ParameterError
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene, World
from elastic_strips.sim.plant import Odometry, PlantParams, check_limits
from elastic_strips.trajectory import MotionLimits

from .model import FLOOR, LINK, OBSTACLE, ROLLING, MujocoModel, build_model, import_mujoco

_SETTLE_TIME = 0.3  # [s] that a robot is given to sink into its tyres at a reset
_FRICTION_EDGE = 0.02  # [rad/s or m/s] speed above which the drives make up for all of their friction
_SAME_TOUCH = 0.1  # [s] shorter interruptions do not end a contact


@dataclass(frozen=True, slots=True)
class Touch:
    """A present contact of a robot's link.

    Attributes:
        link: the robot's link.
        other: the obstacle, or ``"floor"``.
        depth: depth of penetration [m].
        speed: speed of the link at the point of contact [m/s]; 0 for a robot at rest.
    """

    link: str
    other: str
    depth: float
    speed: float


@dataclass(frozen=True, slots=True)
class TouchEvent:
    """A contact from its beginning to its end.

    Attributes:
        link, other: what is in contact.
        start, end: first and last time [s].
        depth: largest depth [m].
        speed: speed of the link at the point of contact when it began [m/s].
    """

    link: str
    other: str
    start: float
    end: float
    depth: float
    speed: float


class MujocoPlant:
    """Workspace: a rigid-body simulation of a robot on a differential drive.

    The robot stands on its driven wheels (friction 1) and frictionless casters; other joints than the planned ones and
    the wheels are welded. Wheels and joints are turned by speed loops with the URDF's effort limits, tuned so that
    speeds follow with the lags of ``params``; the drives make up for their own drag and friction, and the joints for
    gravity and the forces of motion, as an arm's controller does: none of it acts on the base from outside. Slip comes
    from the contacts; ``params.slip``, ``slip_noise`` and ``acceleration_margin`` have no effect. Obstacles are solid;
    moving ones follow their motion whatever they touch. The robot collides with obstacles, and its arm with the floor,
    but never with itself.

    Args:
        robot: a robot from a URDF, with a differential drive.
        limits: limits with which its motions are planned.
        scene: obstacles, or a world of them over time; None for an empty floor.
        params: lags, jitter, speed margin and sensors.
        seed: seed of all noise, or a generator.
        timestep: time step of the simulation [s].

    Raises:
        MissingExtraError: mujoco (extra ``sim``) is not installed.
        ParameterError: a robot or limits that cannot be simulated.
        RobotError: MuJoCo refuses the model.
    """

    def __init__(
        self,
        robot: RobotModel,
        limits: MotionLimits,
        scene: Scene | World | None = None,
        params: PlantParams | None = None,
        seed: int | np.random.Generator = 0,
        *,
        timestep: float = 0.002,
    ) -> None:
        params = PlantParams() if params is None else params
        check_limits(robot, limits)
        if not 1e-4 <= timestep <= 0.005:
            raise ParameterError(f"timestep={timestep!r} must be within [0.0001, 0.005] s")
        self.robot: RobotModel = robot
        self.limits: MotionLimits = limits
        self.params: PlantParams = params
        self.timestep: float = timestep
        self._world = scene if isinstance(scene, World) else None
        self._scene = scene.scene if isinstance(scene, World) else (Scene() if scene is None else scene)
        self._layout: MujocoModel = build_model(robot, limits, self._scene, params, timestep)
        self._mujoco = import_mujoco()
        self._model: Any = self._layout.model
        self._data: Any = self._mujoco.MjData(self._model)
        self._rng = np.random.default_rng(seed)
        self._odometry = Odometry(params.odometry, self._rng, (2, len(robot.joint_names)))
        self._moving = [self._scene.obstacle(name) for name in self._layout.mocap]
        self._top = np.concatenate([limits.drive_speed / limits.wheel_radius, limits.joint_speed]) * params.speed_margin
        self._motor_sign = np.concatenate([self._layout.wheel_sign, np.ones(len(robot.joint_names))])
        self._drag, self._friction = self._layout.compensation
        # part of the way to a command in a time step
        self._follow = 1.0 - np.exp(-timestep / np.maximum(self._layout.filters, 1e-9))
        self._events: list[TouchEvent] = []
        self.reset(robot.space.to_coordinates(robot.home_q))

    @property
    def time(self) -> float:
        return self._time

    @property
    def coordinates(self) -> Array:
        """(nv,) base pose projected to the floor, joints."""
        data, layout = self._data, self._layout
        R = data.xmat[layout.base].reshape(3, 3)
        yaw = math.atan2(R[1, 0], R[0, 0])
        self._turns += round((self._yaw - yaw) / (2.0 * math.pi) - self._turns)
        self._yaw = yaw + 2.0 * math.pi * self._turns
        x, y, _ = data.xpos[layout.base]
        return np.concatenate(([x, y, self._yaw], data.qpos[layout.joint_qpos]))

    @property
    def v(self) -> Array:
        """(nv,) body twist in the floor's plane, joint rates."""
        data, layout = self._data, self._layout
        yaw = self.coordinates[2]
        cos, sin = math.cos(yaw), math.sin(yaw)
        vx, vy = float(data.qvel[0]), float(data.qvel[1])
        turn = float(data.xmat[layout.base].reshape(3, 3)[2] @ data.qvel[3:6])
        return np.concatenate(([cos * vx + sin * vy, cos * vy - sin * vx, turn], data.qvel[layout.joint_dof]))

    @property
    def motors(self) -> Array:
        """(2,) speeds of the wheels' rims."""
        layout = self._layout
        return self._data.qvel[layout.wheel_dof] * layout.wheel_sign * self.limits.wheel_radius

    @property
    def contact_events(self) -> tuple[TouchEvent, ...]:
        """All contacts since the reset, in order of their beginning."""
        return tuple(self._events)

    def reset(self, coordinates: Array, time: float = 0.0) -> None:
        """Put the robot at coordinates (nv,) at rest, with its weight on wheels and casters; forget all contacts."""
        coordinates = np.asarray(coordinates, dtype=float)
        mujoco, model, data, layout = self._mujoco, self._model, self._data, self._layout
        mujoco.mj_resetData(model, data)
        self._time = float(time)
        self._place(coordinates)
        for geoms in layout.obstacle_geoms.values():
            model.geom_conaffinity[geoms] = 0  # nothing but the floor holds a robot that settles
        for _ in range(round(_SETTLE_TIME / self.timestep)):
            mujoco.mj_step1(model, data)
            data.qfrc_applied[layout.joint_dof] = data.qfrc_bias[layout.joint_dof]
            mujoco.mj_step2(model, data)
        self._place(coordinates, keep_height=True)
        self._command, self._set_speed = np.zeros(len(self._motor_sign)), np.zeros(len(self._motor_sign))
        self._exist()
        self._carry(self._time)
        mujoco.mj_forward(model, data)
        self._events.clear()
        self._wheels_at = data.qpos[layout.wheel_qpos].copy()
        self._odometry.reset(self._time, (0.0, 0.0))

    def step(self, command: Command, dt: float) -> Measurement:
        """Apply a command for ``dt`` [s], a multiple of the time step; it arrives late by the jitter, in whole steps.

        Raises:
            ParameterError: a command of the wrong size or not finite, or another ``dt``.
        """
        wanted = np.concatenate([command.drive / self.limits.wheel_radius, command.joints])
        if wanted.shape != self._top.shape or not np.isfinite(wanted).all():
            raise ParameterError(
                f"command {command}: 2 finite rim speeds and {len(self._top) - 2} of joints are needed"
            )
        count = round(dt / self.timestep)
        if count < 1 or abs(count * self.timestep - dt) > 1e-9:
            raise ParameterError(f"dt={dt!r} must be a multiple of the time step {self.timestep:g} s")
        mujoco, model, data, layout = self._mujoco, self._model, self._data, self._layout
        new = np.zeros_like(wanted) if command.stop else np.clip(wanted, -self._top, self._top)
        late = round(self.params.jitter * float(self._rng.random()) / self.timestep) if self.params.jitter > 0 else 0
        begin = self._time
        self._exist()
        for i in range(count):
            if i == min(late, count - 1):
                self._command = new
            if self._moving:
                self._carry(begin + i * self.timestep)
            self._set_speed += self._follow * (self._command - self._set_speed)
            u = self._set_speed
            effort = self._drag * u + self._friction * np.tanh(u / _FRICTION_EDGE)
            data.ctrl[:] = self._motor_sign * (u + effort)
            mujoco.mj_step1(model, data)
            data.qfrc_applied[layout.joint_dof] = data.qfrc_bias[layout.joint_dof]
            mujoco.mj_step2(model, data)
            self._time = begin + (i + 1) * self.timestep
            self._note(self._time)
        self._time = begin + dt
        mujoco.mj_kinematics(model, data)
        turned = (data.qpos[layout.wheel_qpos] - self._wheels_at) * layout.wheel_sign
        coordinates = self.coordinates
        pose = (float(coordinates[0]), float(coordinates[1]), float(coordinates[2]))
        return self._odometry.measure(self._time, (turned * self.limits.wheel_radius).tolist(), coordinates[3:], pose)

    def contacts(self) -> tuple[Touch, ...]:
        """Present contacts of the robot, without wheels and casters on the floor."""
        mujoco, data, layout = self._mujoco, self._data, self._layout
        if data.ncon == 0:
            return ()
        geoms = data.contact.geom
        found: list[Touch] = []
        for i in np.flatnonzero(layout.kind[geoms].sum(axis=1) != FLOOR + ROLLING):
            a, b = (int(g) for g in geoms[i])
            mine, other = (a, b) if layout.kind[a] in (ROLLING, LINK) else (b, a)
            if layout.kind[other] not in (FLOOR, OBSTACLE):
                continue
            twist = np.zeros(6)
            body = int(self._model.geom_bodyid[mine])
            mujoco.mj_objectVelocity(self._model, data, mujoco.mjtObj.mjOBJ_BODY, body, twist, 0)
            point = data.contact.pos[i] - data.xpos[body]
            speed = float(np.linalg.norm(twist[3:] + np.cross(twist[:3], point)))
            found.append(Touch(layout.owner[mine], layout.owner[other], max(0.0, -float(data.contact.dist[i])), speed))
        return tuple(found)

    def lost_odometry(self, until: float) -> None:
        """Measure no encoder travel and no fix up to the time ``until`` [s]."""
        self._odometry.lose_odometry(until)

    def close(self) -> None:
        """Release the simulation; the plant cannot be used any more."""
        self._data = self._model = None

    def _place(self, coordinates: Array, *, keep_height: bool = False) -> None:
        """Set base and joints, at rest; height and tilt of a robot that has settled are kept."""
        mujoco, data, layout = self._mujoco, self._data, self._layout
        turn, quat = np.zeros(4), np.zeros(4)
        if keep_height:
            mujoco.mj_kinematics(self._model, data)
            R = data.xmat[layout.base].reshape(3, 3)
            mujoco.mju_axisAngle2Quat(
                turn, np.array([0.0, 0.0, 1.0]), float(coordinates[2]) - math.atan2(R[1, 0], R[0, 0])
            )
            mujoco.mju_mulQuat(quat, turn, data.qpos[3:7].copy())
        else:
            mujoco.mju_axisAngle2Quat(quat, np.array([0.0, 0.0, 1.0]), float(coordinates[2]))
            data.qpos[2] = 0.0
        data.qpos[:2], data.qpos[3:7] = coordinates[:2], quat
        data.qpos[layout.joint_qpos] = coordinates[3:]
        data.qvel[:] = data.ctrl[:] = data.qfrc_applied[:] = data.qacc_warmstart[:] = 0.0
        self._yaw, self._turns = float(coordinates[2]), 0

    def _exist(self) -> None:
        """Switch off contacts of obstacles that do not exist now."""
        for name, geoms in self._layout.obstacle_geoms.items():
            there = self._world is None or self._world.exists(name, self._time)
            self._model.geom_conaffinity[geoms] = int(there)

    def _carry(self, time: float) -> None:
        """Set the poses of moving obstacles."""
        for obstacle in self._moving:
            pose, k = obstacle.at(time).pose, self._layout.mocap[obstacle.name or ""]
            self._data.mocap_pos[k] = pose[:3, 3]
            self._mujoco.mju_mat2Quat(self._data.mocap_quat[k], np.ascontiguousarray(pose[:3, :3]).ravel())

    def _note(self, time: float) -> None:
        """Add the present contacts to the events."""
        data = self._data
        if data.ncon == 0 or not (self._layout.kind[data.contact.geom].sum(axis=1) != FLOOR + ROLLING).any():
            return
        for touch in self.contacts():
            for i in range(len(self._events) - 1, -1, -1):
                event = self._events[i]
                if (event.link, event.other) == (touch.link, touch.other) and time - event.end <= _SAME_TOUCH:
                    depth = max(event.depth, touch.depth)
                    self._events[i] = TouchEvent(event.link, event.other, event.start, time, depth, event.speed)
                    break
            else:
                self._events.append(TouchEvent(touch.link, touch.other, time, time, touch.depth, touch.speed))
