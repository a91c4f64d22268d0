"""Measurement: what a robot's encoders, its localization and its skin say at one time."""

from __future__ import annotations

from dataclasses import dataclass

from elastic_strips.arrays import Array


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

    @property
    def odometry_lost(self) -> bool:
        """Whether no encoder travel came."""
        return self.drive is None
