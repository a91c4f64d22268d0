"""Tracking: commands that keep a robot on its reference trajectory."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.robot import RobotModel
from elastic_strips.trajectory import MotionLimits, ReferenceState
from elastic_strips.validation import Bound, Checked, NonNegative

from .interfaces import Command

_RESTING_REFERENCE = 1e-6  # [m/s, rad/s, m/s², rad/s²] a reference slower than this rests


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackingGains(Checked):
    """Gains of the tracking law and what it knows about the motors.

    Attributes:
        along: gain of the error along the base's heading (in both directions for an omnidirectional base) [1/s].
        across: gain of the error beside the heading, per metre driven: ω += across · v · e_y [1/m²].
        heading: gain of the heading's error [1/s]; it does not vanish with the speed, so turns in place are tracked.
        joint: gain of the joints' errors [1/s].
        wheel_lag, joint_lag: time constants of the motors' speed loops [s]; accelerations are led by them.
        hold: half of the control period plus the mean delay of commands: how old a command is on average when it acts
            [s].
        headroom: commands may exceed the limits, which references are planned with, by this factor; without it nothing
            could be caught up at full speed.
        most_base, most_turn, most_joint: bounds of the feedback [m/s, rad/s, rad/s or m/s], so that a jump of the
            estimate does not become a jerk of the robot.
    """

    along: NonNegative = 4.0
    across: NonNegative = 24.0
    heading: NonNegative = 9.0
    joint: NonNegative = 10.0
    wheel_lag: NonNegative = 0.04
    joint_lag: NonNegative = 0.03
    hold: NonNegative = 0.006
    headroom: Annotated[float, Bound(low=1.0)] = 1.1
    most_base: NonNegative = 0.25
    most_turn: NonNegative = 1.0
    most_joint: NonNegative = 0.5


class TrackingController:
    """Feed-forward of a reference's velocity and acceleration, plus feedback of the error in the base's own frame.

    Differential drive, with the error (e_x, e_y, e_θ) from the estimate to the reference in the base's frame:
    ``v = v_r cos e_θ + along·e_x``, ``ω = ω_r + heading·sin e_θ + across·v_r·e_y``. The gain of the heading is
    constant: a reference that turns in place is followed. An omnidirectional base is fed back in all three
    directions; a joint is by itself.

    Where a rim would have to exceed its limit (times the headroom), all drive speeds are scaled alike: the base
    slows down and keeps its curvature. Joints are limited one by one.

    A reference at rest gives exactly zero speeds, whatever the error: a robot at rest does not start to move.

    Args:
        robot: the robot; any kind of base.
        limits: what the references are planned with.
        gains: gains and lags.
    """

    gains: TrackingGains

    def __init__(self, robot: RobotModel, limits: MotionLimits, gains: TrackingGains | None = None) -> None:
        self.robot: RobotModel = robot
        self.limits: MotionLimits = limits
        self.gains = gains = TrackingGains() if gains is None else gains
        self._k, self._first = len(limits.drive_speed), robot.space.base_nv
        self._circular = robot.space.circular.copy() if robot.space.circular.any() else None
        self._drive_top = (limits.drive_speed * gains.headroom).tolist()
        self._joint_top = limits.joint_speed * gains.headroom
        self.rest: Command = Command.rest(limits)

    def command(self, reference: ReferenceState, estimate: Array, older: float = 0.0) -> Command:
        """The command for the period that begins now.

        Args:
            reference: state to follow now.
            estimate: (nv,) estimated coordinate row now.
            older: by how much [s] commands are older on average when they act than ``TrackingGains.hold``.
        """
        v, a = reference.v, reference.a
        if max(v.max(), -v.min(), a.max(), -a.min()) <= _RESTING_REFERENCE:
            return self.rest
        g, first = self.gains, self._first
        error = reference.coordinates[first:] - estimate[first:]
        if self._circular is not None:
            error = np.where(self._circular, np.remainder(error + np.pi, 2.0 * np.pi) - np.pi, error)
        feedback = np.minimum(np.maximum(g.joint * error, -g.most_joint), g.most_joint)
        rates = v[first:] + (g.joint_lag + g.hold + older) * a[first:] + feedback
        joints = np.minimum(np.maximum(rates, -self._joint_top), self._joint_top)
        if not self._k:
            return Command(self.rest.drive, joints)
        return Command(self._drive(reference, estimate, older), joints)

    def _drive(self, reference: ReferenceState, estimate: Array, older: float) -> Array:
        g = self.gains
        x, y, yaw = estimate[:3].tolist()
        x_r, y_r, yaw_r = reference.coordinates[:3].tolist()
        vx, vy, turn = reference.v[:3].tolist()
        ax, ay, spin = reference.a[:3].tolist()
        cos, sin = math.cos(yaw), math.sin(yaw)
        e_x, e_y = cos * (x_r - x) + sin * (y_r - y), cos * (y_r - y) - sin * (x_r - x)
        sin_e, cos_e = math.sin(yaw_r - yaw), math.cos(yaw_r - yaw)
        e_turn = math.atan2(sin_e, cos_e)
        lead = g.wheel_lag + g.hold + older
        if self._k == 2:
            forward = (vx + lead * ax) * cos_e + _bounded(g.along * e_x, g.most_base)
            # beyond 90 degrees the sine would decrease with the error
            correction = g.heading * (sin_e if cos_e > 0.0 else math.copysign(1.0, e_turn)) + g.across * vx * e_y
            omega = turn + lead * spin + _bounded(correction, g.most_turn)
            half = 0.5 * self.limits.track * omega
            drive = [forward - half, forward + half]
        else:
            wx, wy = vx + lead * ax, vy + lead * ay
            push_x, push_y = g.along * e_x, g.along * e_y
            size = math.hypot(push_x, push_y)
            shrink = g.most_base / size if size > g.most_base else 1.0
            drive = [
                cos_e * wx - sin_e * wy + shrink * push_x,
                sin_e * wx + cos_e * wy + shrink * push_y,
                turn + lead * spin + _bounded(g.heading * e_turn, g.most_turn),
            ]
        over = max(abs(u) / top for u, top in zip(drive, self._drive_top, strict=True))
        if over > 1.0:
            drive = [u / over for u in drive]
        return np.array(drive)


def _bounded(value: float, most: float) -> float:
    return max(-most, min(most, value))
