"""Sim room, separation: the protective separation distance of speed-and-separation monitoring, as a figure."""

from __future__ import annotations

from elastic_strips.execution.limits import MotionLimits
from elastic_strips.execution.params import DriveParams

from ..perception import PerceptionParams

WALKING_SPEED = 1.6
"""Speed of an approaching person [m/s] that the figure is made for (ISO/TS 15066 takes it from ISO 13855)."""


def protective_separation(
    limits: MotionLimits,
    params: DriveParams,
    perception: PerceptionParams,
    *,
    speed: float | None = None,
    approach: float = WALKING_SPEED,
) -> float:
    """S_p = S_h + S_r + S_s + C + Z_d + Z_r [m] of ISO/TS 15066, with C = 0.

    What a person walks until the robot stands, what the robot drives until it brakes, its braking distance, the error
    of the sensed position and that of its own. It is a figure to compare with, not a claim of conformity.

    Args:
        limits: of the motors.
        params: of the drive.
        perception: delay of the sensed scene.
        speed: of the base [m/s]; its largest where None.
        approach: speed of the person [m/s].
    """
    v = float(limits.drive_speed[:2].max(initial=0.0)) * params.ease_speed if speed is None else speed
    change = float(limits.drive_acceleration[:2].min(initial=1.0)) * params.ease_acceleration
    react = perception.delay + (params.plan_every + params.latency) * params.control_dt
    stop = v / change
    return (
        approach * (react + stop)
        + v * react
        + v * v / (2.0 * change)
        + params.assumptions.position_error
        + params.tracking_error
    )
