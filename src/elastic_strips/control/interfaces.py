"""Interfaces: what goes into a controller and what comes out of it: measurements, commands, states, events."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.trajectory import MotionLimits


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """What the sensors say at one time.

    Attributes:
        time: [s].
        drive: (k,) travel of the drive coordinates since the last measurement, from encoders (rims left, right [m] of
            a differential drive; x, y, yaw in the body's frame of an omnidirectional base); None where odometry is
            lost.
        joints: (n,) joint positions, from encoders [rad or m].
        pose: (3,) a localization fix x, y [m], yaw [rad], where one arrives now; else None.
        pose_time: the time [s] that the fix tells of, earlier than ``time``; None without a fix.
        contact: what the robot feels that it touches, in words; empty where nothing.
    """

    time: float
    drive: Array | None
    joints: Array
    pose: Array | None = None
    pose_time: float | None = None
    contact: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Command:
    """Speeds that the motors are told to turn with.

    Attributes:
        drive: (k,) drive coordinates: rims left, right [m/s] of a differential drive; x, y, yaw in the body's frame
            [m/s, rad/s] of an omnidirectional base; empty for a fixed one.
        joints: (n,) joint rates [rad/s or m/s].
    """

    drive: Array
    joints: Array

    @staticmethod
    def rest(limits: MotionLimits) -> Command:
        """All motors stand."""
        return Command(np.zeros(len(limits.drive_speed)), np.zeros(len(limits.joint_speed)))


class RunState(IntEnum):
    """What the robot is doing; a record keeps the labels beside the codes.

    ``MOVING``: it follows its reference. ``BRAKING``: it brakes. ``STOPPED``: it stands and waits. ``REACHED``: it is
    at the goal. ``FAILED``: the run ended elsewhere.
    """

    MOVING = 0
    BRAKING = 1
    STOPPED = 2
    REACHED = 3
    FAILED = 4

    @property
    def label(self) -> str:
        """Its word in documents and records."""
        return "slowing" if self is RunState.BRAKING else self.name.lower()


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened once: time [s], kind (one word) and what there is to say about it."""

    time: float
    kind: str
    reason: str = ""
