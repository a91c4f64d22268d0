"""Trajectory: where the robot is at each time; the value that is certified, driven and recorded."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from elastic_strips.arrays import Array, Document
from elastic_strips.collision import BodySet, Certificate, Forecast, MotionBounds, MotionCertifier
from elastic_strips.collision.path_rows import column_names
from elastic_strips.errors import ParameterError
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import Strip
from elastic_strips.summary import Summary
from elastic_strips.validation import check_array

from .limits import MotionLimits

_RESTING_SPEED = 1e-9
_SHORTEST_STEP = 1e-9  # a first step shorter than this is left out [s]


@dataclass(frozen=True, slots=True)
class ReferenceState:
    """The state that a trajectory prescribes for one time.

    Attributes:
        time: time [s].
        coordinates: (nv,) x, y, yaw, joints.
        v: (nv,) velocity: body twist (v_x, v_y, ω), joint rates.
        a: (nv,) its rate of change.
    """

    time: float
    coordinates: Array
    v: Array
    a: Array


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Summary):
    """A timed motion: samples joined by exact arcs of the base and straight lines of the joints.

    Between two samples the robot moves on the arc that joins them, evenly in time: what a certificate proves about
    the samples and the arcs is proved about every reference that :meth:`at` returns.

    Attributes:
        robot: the robot that moves.
        limits: the limits that it keeps.
        time: (M,) [s], M ≥ 2, strictly ascending; may start anywhere. Evenly spaced except for the first step of a
            tail.
        coordinates: (M, nv) coordinate rows x, y, yaw, joints. Angles are continuous, so that interpolating the values
            goes the way that :meth:`at` goes; wrapped ones are taken the shorter way.
        v: (M, nv) velocity at the samples: body twist (v_x, v_y, ω) [m/s, rad/s], joint rates [rad/s or m/s].
        a: (M, nv) its rate of change [m/s², rad/s²].
    """

    robot: RobotModel
    limits: MotionLimits
    time: Array
    coordinates: Array
    v: Array
    a: Array

    def __post_init__(self) -> None:
        """Check and freeze.

        Raises:
            ParameterError: fewer than two samples, wrong shapes, values that are not finite, or time that does not
                ascend.
        """
        time = check_array("time", self.time, (None,))
        if len(time) < 2:
            raise ParameterError(f"a trajectory has at least 2 samples in time (M,); got shape {time.shape}")
        if not (time[1:] > time[:-1]).all():
            raise ParameterError("time must be strictly ascending")
        object.__setattr__(self, "time", time)
        for name in ("coordinates", "v", "a"):
            what, shape = f"{name} of {self.robot.name!r}", (len(time), self.robot.nv)
            object.__setattr__(self, name, check_array(what, getattr(self, name), shape))
        turning = self.robot.space.turning
        angles = self.coordinates[:, turning]
        if (np.abs(np.diff(angles, axis=0)) > np.pi).any():
            coordinates = self.coordinates.copy()
            coordinates[:, turning] = np.unwrap(angles, axis=0)
            coordinates.setflags(write=False)
            object.__setattr__(self, "coordinates", coordinates)

    def __len__(self) -> int:
        return len(self.time)

    @cached_property
    def q(self) -> Array:
        """(M, nq) Pinocchio configurations."""
        q = self.robot.space.from_coordinates(self.coordinates)
        q.setflags(write=False)
        return q

    @property
    def start_time(self) -> float:
        """Time of the first sample [s]."""
        return float(self.time[0])

    @property
    def end_time(self) -> float:
        """Time of the last sample [s]."""
        return float(self.time[-1])

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @cached_property
    def steps(self) -> Array:
        """(M−1, nv) tangent vectors from each sample to the next."""
        steps = self.robot.space.difference(self.coordinates[:-1], self.coordinates[1:])
        steps.setflags(write=False)
        return steps

    @property
    def at_rest_at_end(self) -> bool:
        """Whether it ends with the robot standing still."""
        return bool(np.abs(self.v[-1]).max(initial=0.0) <= _RESTING_SPEED)

    def at(self, t: float) -> ReferenceState:
        """The reference at a time [s]: the first sample before the start, the last one at rest after the end."""
        if t <= self.time[0]:
            return ReferenceState(float(t), self.coordinates[0], self.v[0], self.a[0])
        if t >= self.time[-1]:
            rest = np.zeros(self.robot.nv)
            return ReferenceState(float(t), self.coordinates[-1], rest, rest.copy())
        i = int(np.searchsorted(self.time, t, side="right")) - 1
        s = (t - self.time[i]) / (self.time[i + 1] - self.time[i])
        coordinates = self.robot.space.integrate(self.coordinates[i], s * self.steps[i])
        v = self.v[i] + s * (self.v[i + 1] - self.v[i])
        a = self.a[i] + s * (self.a[i + 1] - self.a[i])
        return ReferenceState(float(t), coordinates, v, a)

    def coordinates_at(self, times: Array) -> Array:
        """(K, nv) coordinate rows of the references at times (K,) [s]; see :meth:`at`."""
        i = np.clip(np.searchsorted(self.time, times, side="right") - 1, 0, len(self.time) - 2)
        s = np.clip((times - self.time[i]) / (self.time[i + 1] - self.time[i]), 0.0, 1.0)
        return self.robot.space.integrate(self.coordinates[i], s[:, None] * self.steps[i])

    def tail(self, t: float) -> Trajectory:
        """The rest from time ``t`` [s] on, along the same arcs; the whole of it where ``t`` is before the start.

        After the end it consists of two samples of the end, one step apart.
        """
        if t <= self.time[0]:
            return self
        if t + _SHORTEST_STEP >= self.time[-1]:
            step = float(self.time[-1] - self.time[-2])
            rows = np.stack([self.coordinates[-1], self.coordinates[-1]])
            rest = np.zeros_like(rows)
            return replace(self, time=np.array([t, t + step]), coordinates=rows, v=rest, a=rest)
        state = self.at(t)
        i = int(np.searchsorted(self.time, t + _SHORTEST_STEP, side="right"))
        return replace(
            self,
            time=np.concatenate([[t], self.time[i:]]),
            coordinates=np.vstack([state.coordinates, self.coordinates[i:]]),
            v=np.vstack([state.v, self.v[i:]]),
            a=np.vstack([state.a, self.a[i:]]),
        )

    def strip(self) -> Strip:
        """The samples as a strip (M nodes)."""
        return Strip.from_coordinates(self.robot, self.coordinates)

    def joint_trajectory(self) -> Document:
        """The samples as a JointTrajectory of plain lists and numbers, which `load_path` reads again.

        ``joint_names``, and ``points`` with ``positions``, ``velocities``, ``accelerations`` and ``time_from_start``
        [s]. A base that moves is the joints ``x``, ``y`` and ``yaw``, with the rates of these, in the world. ROS has
        the base in a message of its own: `elastic_strips.io.trajectory_document`.
        """
        v, a = self.v.copy(), self.a.copy()
        if self.robot.space.planar:
            yaw, turn = self.coordinates[:, 2], self.v[:, 2]
            v[:, :2] = np.column_stack(_turned(yaw, self.v[:, 0], self.v[:, 1]))
            change = self.a[:, 0] - turn * self.v[:, 1], self.a[:, 1] + turn * self.v[:, 0]  # the frame turns, too
            a[:, :2] = np.column_stack(_turned(yaw, *change))
        rows = zip(self.coordinates.tolist(), v.tolist(), a.tolist(), (self.time - self.time[0]).tolist(), strict=True)
        points = [
            {"positions": q, "velocities": rate, "accelerations": change, "time_from_start": t}
            for q, rate, change, t in rows
        ]
        return {"joint_names": list(column_names(self.robot)), "points": points}


def _turned(yaw: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Vectors of a frame at ``yaw``, in the world."""
    return np.cos(yaw) * x - np.sin(yaw) * y, np.sin(yaw) * x + np.cos(yaw) * y


def stationary(robot: RobotModel, limits: MotionLimits, coordinates: Array, time: float, dt: float) -> Trajectory:
    """A trajectory that stays at ``coordinates`` (nv,) from ``time`` [s] on; its samples are ``dt`` [s] apart."""
    rows = np.stack([coordinates, coordinates])
    rest = np.zeros_like(rows)
    return Trajectory(robot, limits, np.array([time, time + dt]), rows, rest, rest)


def joined(pieces: list[Trajectory]) -> Trajectory:
    """Pieces that follow each other as one trajectory; where they meet, the later one's sample stays."""
    last = pieces[-1]

    def rows(name: str) -> Array:
        return np.concatenate([*(getattr(piece, name)[:-1] for piece in pieces[:-1]), getattr(last, name)])

    return replace(last, time=rows("time"), coordinates=rows("coordinates"), v=rows("v"), a=rows("a"))


class TrajectoryCertifier(OneThread):
    """Workspace: certifies trajectories of one robot against snapshots and their forecasts.

    Args:
        robot: the robot of the trajectories.
        clearance: distance [m] to keep from obstacles: at least the tracking error.
        self_clearance: distance [m] to keep between the robot's own links.
        settle_time: how long [s] the robot may take to come to rest after the end.
        apart: pairs of links that keep more than this [m] in every posture need not keep the self-clearance; itself
            where None.
    """

    def __init__(
        self,
        robot: RobotModel,
        *,
        clearance: float,
        self_clearance: float = 1e-3,
        settle_time: float = 0.0,
        apart: float | None = None,
    ) -> None:
        self.robot: RobotModel = robot
        self.clearance: float = clearance
        self._self_clearance = self_clearance
        self.settle_time = settle_time
        bodies = BodySet.links(robot)
        pairs = robot.pairs_within(self_clearance if apart is None else apart)
        self._certifier = MotionCertifier(bodies, MotionBounds(bodies), pairs)

    @property
    def self_clearance(self) -> float:
        """Distance [m] to keep between the robot's own links; fixed, as pairs that always keep more were left out."""
        return self._self_clearance

    @exclusive
    def reset(self) -> None:
        """Forget the obstacles, as is needed after an exception."""
        self._certifier.reset()

    @exclusive
    def certify(
        self,
        trajectory: Trajectory,
        scene: Scene,
        forecast: Forecast,
        *,
        clearance: float | None = None,
        self_clearance: float | None = None,
    ) -> Certificate:
        """Certify a trajectory, from its first sample until it has come to rest.

        Args:
            trajectory: ends at rest.
            scene: sensed at ``scene.time``, on the clock of ``trajectory.time``.
            forecast: of that scene, for all its moving obstacles.
            clearance: distance [m] to keep from obstacles; that of the certifier where None.
            self_clearance: distance [m] to keep between the robot's own links, at most that of the certifier; that
                where None.

        Raises:
            ParameterError: the forecast's horizon is shorter than the motion.
        """
        coordinates = np.vstack([trajectory.coordinates, trajectory.coordinates[-1:]])
        times = np.append(trajectory.time, trajectory.time[-1] + self.settle_time) - scene.time
        if len(forecast) and times[-1] > forecast.horizon:
            raise ParameterError(
                f"the motion ends {times[-1]:.2f} s after the snapshot, beyond the forecast's {forecast.horizon:g} s"
            )
        v = np.vstack([trajectory.steps, np.zeros((1, self.robot.nv))])
        return self._certifier.certify(
            coordinates,
            v,
            scene,
            forecast.predict(times),
            self_clearance=self.self_clearance if self_clearance is None else min(self_clearance, self.self_clearance),
            clearance=self.clearance if clearance is None else clearance,
        )
