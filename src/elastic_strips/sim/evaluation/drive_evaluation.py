"""Evaluation of a run from its true states, dense in time and independent of the planner's code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from elastic_strips.arrays import Array, ArrayLike, Document
from elastic_strips.control import Tolerance
from elastic_strips.control.params import DriveParams
from elastic_strips.control.record import ControlRows, Record, RecordError
from elastic_strips.errors import ParameterError, RobotError, SceneError
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.scene import World
from elastic_strips.sim.perception import PerceptionParams
from elastic_strips.summary import Summary
from elastic_strips.trajectory import MotionLimits
from elastic_strips.validation import check_number, check_type, named_arguments, shown

from .clearance_search import ClearanceSearch, ClosestApproach

REST_SPEED = 0.01
"""A robot is at rest while none of its control points is faster than this [m/s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """A time during which the robot and one obstacle touched, with gaps of no more than 0.25 s.

    Attributes:
        time, end: its first and last moment [s].
        link: the link with the deepest penetration.
        obstacle: the obstacle that was touched.
        depth: deepest penetration [m] among the recorded samples, and measured moments between them.
        speed: largest speed of any control point of the robot from the sample before to the one after it [m/s].
    """

    time: float
    end: float
    link: str
    obstacle: str
    depth: float
    speed: float

    @property
    def at_rest(self) -> bool:
        """Whether the robot stood: the obstacle moved into it."""
        return self.speed <= REST_SPEED


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Evaluation(Summary):
    """Evaluation of a run.

    Attributes:
        min_clearance_m: least measured distance of the robot to an obstacle; at most ``accuracy_m`` above the least at
            any time; negative in penetration, infinite without obstacles.
        accuracy_m: accuracy of ``min_clearance_m`` [m].
        closest: moment of the least distance, with link and obstacle; None without obstacles.
        contacts: all contacts in order of time, including those of a robot at rest.
        max_lateral_slip_m: largest sideways travel between two successive reference samples that do not both stand
            still; differential drives only.
        excess: limit by name → the most by which it was exceeded, relative to it; 0 where it was kept. ``drive`` is
            of the motors where the record has them, else over the ground; ``joints`` of the true speeds; each also as
            ``*_acceleration``; ``command_*`` are commands. Empty without limits.
        path_m: length of the base's true path; of the joints' path [rad] for a fixed base.
        time_s: time between the first and the last sample.
        rest_s: part of that time at rest, see `REST_SPEED`.
        reached: whether the last sample is at the goal; None without a goal.
        reached_s: time since the first sample from which on the robot was at the goal; None if it is not at the end.
        queries: number of measured exact distances.
    """

    min_clearance_m: float
    accuracy_m: float
    closest: ClosestApproach | None
    contacts: tuple[Contact, ...]
    max_lateral_slip_m: float
    excess: Mapping[str, float] = field(default_factory=dict)
    path_m: float
    time_s: float
    rest_s: float
    reached: bool | None
    reached_s: float | None
    queries: int

    @property
    def collisions(self) -> tuple[Contact, ...]:
        """Contacts into which the robot moved, or during which it moved."""
        return tuple(c for c in self.contacts if not c.at_rest)

    @property
    def rest_contacts(self) -> tuple[Contact, ...]:
        """Contacts during which the robot stood."""
        return tuple(c for c in self.contacts if c.at_rest)

    def as_dict(self) -> Document:
        """Plain values, ready for JSON; None for a clearance without obstacles."""
        names = ("max_lateral_slip_m", "path_m", "time_s", "rest_s", "reached", "reached_s", "accuracy_m")
        closest = self.closest
        return {
            "min_clearance_m": None if closest is None else self.min_clearance_m,
            "closest": None if closest is None else [closest.time, closest.link, closest.obstacle],
            "collisions": [_contact(c) for c in self.collisions],
            "rest_contacts": [_contact(c) for c in self.rest_contacts],
            "excess": dict(self.excess),
            **{name: getattr(self, name) for name in names},
            "asked": self.queries,
        }


def _contact(c: Contact) -> Document:
    return {
        "time": c.time,
        "end": c.end,
        "link": c.link,
        "obstacle": c.obstacle,
        "depth_m": c.depth,
        "speed_mps": c.speed,
    }


_SAME_EPISODE = 0.25  # [s]


@named_arguments
def evaluate(
    run: Record | Sequence[ArrayLike],
    robot: RobotModel,
    world: World | None = None,
    limits: MotionLimits | None = None,
    *,
    goal: ArrayLike | None = None,
    tolerance: Tolerance | None = None,
    accuracy: float = 1e-3,
) -> Evaluation:
    """Check the true motion of a run against the true obstacles, and its commands against the limits.

    Distances are measured between all pieces of the robot and all parts of existing obstacles. Between two samples the
    robot moves by ``pin.interpolate``, and the interval is bisected until the least distance is known.

    Args:
        run: a record, or the true motion alone: time (T,) [s], coordinate rows (T, nv), velocities (T, nv).
        robot: the robot that drove.
        world: the true obstacles; the record's where None.
        limits: limits to compare with; not compared where None.
        goal: coordinate row (nv,) of the goal; the record's where None.
        tolerance: how near counts as reached.
        accuracy: accuracy of the least distance [m].

    Raises:
        RecordError: another robot than the recorded one, or a motion that is not finite or not ascending in time.
        ParameterError: no world, an accuracy out of range, or a goal of the wrong size.
    """
    check_type("robot", robot, RobotModel, RobotError)
    check_type("world", world, World, SceneError, none=True)
    check_type("limits", limits, MotionLimits, none=True)
    check_type("tolerance", tolerance, Tolerance, none=True)
    check_number("accuracy", accuracy, low=1e-6, high=1.0, unit="m")
    record = run if isinstance(run, Record) else None
    if record is not None:
        record.check_robot(robot)
    time, coordinates, v = _motion(run, robot)
    if record is not None:
        world = record.world if world is None else world
        goal = record.goal if goal is None else goal
    if world is None:
        raise ParameterError("there is no world; a motion without a record needs world=World(Scene([…]))")
    speed = _speeds(robot, coordinates, v)
    search = ClearanceSearch(robot, time, coordinates, world)
    closest = search.closest(accuracy)
    contacts = () if closest is None or closest.distance > 0.0 else _episodes(search, time, speed)
    arrived = None if goal is None else _arrival(robot, time, coordinates, goal, tolerance or Tolerance())
    travel = robot.space.difference(coordinates[:-1], coordinates[1:])
    moved = np.hypot(travel[:, 0], travel[:, 1]) if robot.space.planar else np.linalg.norm(travel, axis=1)
    resting = speed <= REST_SPEED
    return Evaluation(
        min_clearance_m=np.inf if closest is None else closest.distance,
        accuracy_m=accuracy,
        closest=closest,
        contacts=tuple(contacts),
        max_lateral_slip_m=0.0 if record is None else _slip(robot, record.control),
        excess={} if limits is None else _excess(limits, robot, v, record),
        path_m=float(moved.sum()),
        time_s=float(time[-1] - time[0]),
        rest_s=float(np.diff(time)[resting[:-1] & resting[1:]].sum()),
        reached=None if goal is None else arrived is not None,
        reached_s=arrived,
        queries=search.queries,
    )


def _motion(run: Record | Sequence[ArrayLike], robot: RobotModel) -> tuple[Array, Array, Array]:
    rows = (run.control.time, run.control.coordinates, run.control.v) if isinstance(run, Record) else run
    try:
        time, coordinates, v = (np.asarray(a, dtype=float) for a in rows)
    except (TypeError, ValueError):
        raise RecordError(f"a motion is a Record, or arrays (time, coordinates, v), not {shown(run)}") from None
    if time.ndim != 1 or not len(time) or not (np.diff(time) > 0.0).all() or not np.isfinite(time).all():
        raise RecordError("the times of a motion must be one finite row (T,), T >= 1, strictly ascending")
    for name, array in (("coordinates", coordinates), ("v", v)):
        if array.shape != (len(time), robot.nv):
            raise RecordError(f"{name} has shape {array.shape}; {robot.name!r} wants {(len(time), robot.nv)}")
        bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
        if len(bad):
            raise RecordError(f"{name}[{bad[0]}] at {time[bad[0]]:g} s is not finite")
    turns = np.flatnonzero(robot.space.half_turn(robot.space.difference(coordinates[:-1], coordinates[1:])))
    if len(turns):
        raise RecordError(
            f"coordinates[{turns[0]}] at {time[turns[0]]:g} s and the next are half a turn apart: which way the robot "
            "turned is not known; record it more often"
        )
    return time, coordinates, v


def _speeds(robot: RobotModel, coordinates: Array, v: Array) -> Array:
    """(T,) largest speed of any control point [m/s]."""
    model, data, points = robot.model, robot.model.createData(), robot.control_point_set
    joints = sorted(set(points.joint.tolist()))
    twists = np.empty((len(coordinates), len(joints), 6))  # of each joint's frame, linear and angular, in that frame
    for row, q, rate in zip(twists, robot.space.from_coordinates(coordinates), v, strict=True):
        pin.forwardKinematics(model, data, q, rate)
        for k, joint in enumerate(joints):
            row[k] = data.v[joint].vector
    own = twists[:, [joints.index(j) for j in points.joint.tolist()]]
    velocity = own[..., :3] + np.cross(own[..., 3:], points.local)
    return np.linalg.norm(velocity, axis=-1).max(axis=1, initial=0.0)


def _episodes(search: ClearanceSearch, time: Array, speed: Array) -> list[Contact]:
    """Contacts of each obstacle, joined where they follow each other closely."""
    runs: dict[str, list[list[ClosestApproach]]] = {}
    for moment in search.contacts():
        own = runs.setdefault(moment.obstacle, [])
        if own:
            last = own[-1][-1]
            if moment.time - last.time <= _SAME_EPISODE or moment.place - last.place <= 1.0:
                own[-1].append(moment)
                continue
        own.append([moment])
    found = [_contact_of(moments, time, speed) for own in runs.values() for moments in own]
    return sorted(found, key=lambda c: c.time)


def _contact_of(moments: list[ClosestApproach], time: Array, speed: Array) -> Contact:
    first, last = moments[0].time, moments[-1].time
    deepest = min(moments, key=lambda m: m.distance)
    begin = max(int(np.searchsorted(time, first, side="left")) - 1, 0)  # an obstacle may stop the robot at once
    end = int(np.searchsorted(time, last, side="left")) + 1
    return Contact(
        time=first,
        end=last,
        link=deepest.link,
        obstacle=deepest.obstacle,
        depth=max(-deepest.distance, 0.0),
        speed=float(speed[begin:end].max()),
    )


def _slip(robot: RobotModel, rows: ControlRows) -> float:
    if robot.base_kind is not BaseKind.DIFF_DRIVE or len(rows) < 2:
        return 0.0
    sideways = np.abs(robot.space.difference(rows.reference[:-1], rows.reference[1:])[:, 1])
    stands = (rows.reference_v == 0.0).all(axis=1)  # a reference at rest may be moved to the estimate
    return _largest(sideways[~(stands[:-1] & stands[1:])])


def _excess(limits: MotionLimits, robot: RobotModel, v: Array, record: Record | None) -> dict[str, float]:
    base = robot.space.base_nv
    drive = limits.to_drive(v[:, :3]) if base else np.zeros((len(v), 0))
    if record is not None and np.isfinite(record.control.motors).all():
        drive = record.control.motors
    found = {"drive": _over(drive, limits.drive_speed), "joints": _over(v[:, base:], limits.joint_speed)}
    if record is not None:
        step = np.diff(record.control.time)[:, None]
        if drive is record.control.motors:  # speeds over the ground include slip
            found["drive_acceleration"] = _over(np.diff(drive, axis=0) / step, limits.drive_acceleration)
        found["joints_acceleration"] = _over(np.diff(v[:, base:], axis=0) / step, limits.joint_acceleration)
        found["command_drive"] = _over(record.control.drive, limits.drive_speed)
        found["command_joints"] = _over(record.control.joints, limits.joint_speed)
    return found


def _over(values: Array, limit: Array) -> float:
    """Largest relative excess of rows of values over a limit."""
    return _largest(np.abs(values) / limit - 1.0)


def _largest(values: Array) -> float:
    """The largest value, at least 0; NaNs are ignored."""
    return float(np.asarray(np.fmax.reduce(values.ravel(), initial=0.0)))


def _arrival(robot: RobotModel, time: Array, coordinates: Array, goal: ArrayLike, tolerance: Tolerance) -> float | None:
    """Time [s] since the first sample from which on the robot stays at the goal; None if it is not there at the end."""
    target = np.asarray(goal, dtype=float)
    if target.shape != (robot.nv,):
        raise ParameterError(f"the goal has shape {target.shape}; a coordinate row of {robot.name!r} has ({robot.nv},)")
    base = robot.space.base_nv
    rest = robot.space.difference(coordinates, np.broadcast_to(target, coordinates.shape))
    off = np.abs(rest[:, base:]) > tolerance.joints
    away: npt.NDArray[np.bool_] = np.asarray(off.any(axis=1))
    if base:
        far = np.hypot(*(coordinates[:, :2] - target[:2]).T) > tolerance.position
        away = away | far | (np.abs(rest[:, 2]) > tolerance.yaw)
    if away[-1]:
        return None
    late = np.flatnonzero(away)
    return float(time[late[-1] + 1 if len(late) else 0] - time[0])


_WALKING_SPEED = 1.6
"""Speed of an approaching person [m/s], by ISO/TS 15066 (from ISO 13855)."""


def protective_separation(
    limits: MotionLimits,
    params: DriveParams,
    perception: PerceptionParams,
    *,
    speed: float | None = None,
    approach: float = _WALKING_SPEED,
) -> float:
    """S_p = S_h + S_r + S_s + C + Z_d + Z_r [m] of ISO/TS 15066, with C = 0.

    These are the path of a person until the robot stands, that of the robot until it brakes, its braking distance, and
    the errors of the sensed position and of its own. It is for comparison, not a claim of conformity.

    Args:
        limits: limits of the motors.
        params: parameters of the drive.
        perception: delay of the sensed scene.
        speed: speed of the base [m/s]; its largest where None.
        approach: speed of the person [m/s].
    """
    v = float(limits.drive_speed[:2].max(initial=0.0)) * params.speed_scale if speed is None else speed
    change = float(limits.drive_acceleration[:2].min(initial=1.0)) * params.acceleration_scale
    react = perception.delay + (params.plan_every + params.latency) * params.control_dt
    stop = v / change
    return (
        approach * (react + stop)
        + v * react
        + v * v / (2.0 * change)
        + params.assumptions.position_error
        + params.tracking_error
    )
