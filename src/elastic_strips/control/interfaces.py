"""Interfaces: inputs and outputs of a controller: measurements, commands, states, events."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.trajectory import MotionLimits
from elastic_strips.validation import named_arguments


@named_arguments
@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """Readings of the robot's own sensors at one time.

    Attributes:
        time: time of the readings [s].
        drive: (k,) travel of the drive coordinates since the last measurement, from encoders (rims left, right [m] of
            a differential drive; x, y [m], yaw [rad] in the body frame of an omnidirectional base); None where
            odometry is lost.
        joints: (n,) joint positions, from encoders [rad or m].
        pose: (3,) localization fix x, y [m], yaw [rad] in the world, where one arrives now; else None.
        pose_time: time [s] at which the fix was measured, earlier than ``time``; None without a fix.
        pose_covariance: (3, 3) covariance of the fix, in the robot's frame [m², rad²]; None where it is not known.
        contact: description of a felt contact; empty without one.
        emergency: description of a pressed emergency stop; empty without one.

    Examples:
        >>> es.Measurement(time=0.01, drive=[0.002, 0.002], joints=[0.0] * 7).pose is None  # encoders alone
        True
    """

    time: float
    drive: Array | None
    joints: Array
    pose: Array | None = None
    pose_time: float | None = None
    pose_covariance: Array | None = None
    contact: str = ""
    emergency: str = ""


@named_arguments
@dataclass(frozen=True, slots=True, eq=False)
class Command:
    """Commanded speeds of the motors.

    Attributes:
        drive: (k,) drive coordinates: rims left, right [m/s] of a differential drive; x, y, yaw in the body frame
            [m/s, rad/s] of an omnidirectional base; empty for a fixed one.
        joints: (n,) joint rates [rad/s or m/s].
        stop: a safe stop: the driver cuts the motors' power and lets the brakes fall in, whatever the speeds say.

    Examples:
        >>> robot = es.load_robot("silvermate")
        >>> command = es.Command.rest(es.MotionLimits.for_robot(robot))
        >>> command.drive.tolist(), command.stop
        ([0.0, 0.0], False)
    """

    drive: Array
    joints: Array
    stop: bool = False

    @staticmethod
    def rest(limits: MotionLimits) -> Command:
        """The command of all motors at rest."""
        return Command(np.zeros(len(limits.drive_speed)), np.zeros(len(limits.joint_speed)))


class RunState(IntEnum):
    """State of a run; a record keeps the labels beside the codes.

    ``MOVING``: the robot follows its reference. ``BRAKING``: it brakes. ``STOPPED``: it stands and waits. ``REACHED``:
    it is at the goal. ``FAILED``: the run ended elsewhere.
    """

    MOVING = 0
    BRAKING = 1
    STOPPED = 2
    REACHED = 3
    FAILED = 4

    @property
    def label(self) -> str:
        """Name in documents and records."""
        return "slowing" if self is RunState.BRAKING else self.name.lower()

    def __str__(self) -> str:
        return self.label


@dataclass(frozen=True, slots=True)
class Event:
    """An event of a run: time [s], kind (one word) and reason."""

    time: float
    kind: str
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class GoalReached:
    """A goal that was reached.

    Attributes:
        time: when [s].
        goal: (nv,) coordinate row of the goal.
        position, yaw, joints: how far from it the reference came, or the robot came to rest, by its estimate: the base
            [m], its heading [rad], the joint that is furthest off [rad or m].
        frame: the frame whose pose was asked for, of several the one that is furthest off; empty where none was.
        hand: how far that, or else the last control point, was from where it is at the goal [m].
        passed: whether the robot went on without a stop.
    """

    time: float
    goal: Array
    position: float
    yaw: float
    joints: float
    frame: str
    hand: float
    passed: bool
