"""Onward: the fastest certified motion along a strip, from the state that the robot will be in; what a tick came to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from elastic_strips.arrays import Array

from ..deform import DeformReport
from ..proximity import Forecast
from ..robot import RobotModel
from ..scene import Scene
from ..trajectory.limits import MotionLimits
from ..trajectory.path import RetimingError
from ..trajectory.retiming import Retimer
from ..trajectory.trajectory import ReferenceState, Trajectory, TrajectoryCertifier
from ..tunnel import Certificate
from .params import DriveParams
from .progress import remaining


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """What a planning tick came to.

    Attributes:
        motion, certificate: the certified motion, or the last one that was tried; None where there is none.
        accepted: whether the certificate holds.
        kept: whether the held motion is the best there is, and still certified: then ``motion`` is what is left of it.
        at_goal: whether the motion ends at the goal.
        reason: why there is no certified motion, or "".
        report: of the strip's tick.
        speed: fraction of full speed that the motion was planned for.
        timings: seconds by phase.
        evasive: whether the motion leaves the strip, to get out of the way of what moves.
        emergency: whether the motion, which needs no certificate, brakes on the way of the held one: the scene is not
            what that one's certificate allowed for, and it is no longer certified.
        late: so much later [s] than its tick it is ready.
    """

    motion: Trajectory | None
    certificate: Certificate | None
    accepted: bool
    kept: bool
    at_goal: bool
    reason: str
    report: DeformReport
    speed: float
    timings: dict[str, float] = field(default_factory=dict)
    evasive: bool = False
    emergency: bool = False
    late: float = 0.0


_LEAD_SPACING = 0.04
"""Spacing [m] of nodes that are taken over from the held motion."""
_LEADS = (0.5, 1.0)
"""Parts of the held motion that are followed first, where the strip has turned away too sharply."""


class Onward:
    """Workspace: times strips, and certifies the motions.

    Args:
        robot: whose motions.
        limits: of its motors.
        params: of the drive.
        spacing_weight: (nv,) metric of the strip's node spacing.
        self_clearance: distance to keep between the robot's own links [m].
    """

    def __init__(
        self, robot: RobotModel, limits: MotionLimits, params: DriveParams, spacing_weight: Array, self_clearance: float
    ) -> None:
        self.robot, self.limits, self.params, self.spacing_weight = robot, limits, params, spacing_weight
        # planned with less than the motors can do, so that there is something left when the way changes
        easy = limits.scaled(speed=1.0, acceleration=params.ease_acceleration)
        self.easy, self.hard = (Retimer(robot, each, dt=params.sample_dt) for each in (easy, limits))
        self.certifier = TrajectoryCertifier(
            robot, clearance=params.clearance, self_clearance=self_clearance, settle_time=params.settle_time
        )
        self._refused = 0

    def motion(
        self,
        start: ReferenceState,
        held: Trajectory,
        scene: Scene,
        possible: Forecast,
        report: DeformReport,
        timings: dict[str, float],
        lap: Callable[[str], None],
        *,
        astray: bool = False,
        surprised: Callable[[], bool],
    ) -> Proposal:
        """The fastest motion along the strip of a report that is certified, or why there is none.

        Args:
            start: where, when and how fast it begins: a state of ``held``.
            held: the motion that is executed.
            scene: sensed.
            possible: where its moving obstacles can be.
            report: of the strip's tick.
            timings: seconds by phase; ``lap(phase)`` adds to them.
            astray: whether the robot has left the strip, so that the held motion does not lead along it.
            surprised: tells whether the scene is not what the held motion's certificate allowed for.
        """
        chart = report.strip.chart
        speed_now = fastest_drive(self.limits, start.v)
        motion: Trajectory | None = None
        certificate: Certificate | None = None
        reason, at_goal, speed, tried = "", False, 0.0, False
        last = np.inf
        speeds = self.params.speeds
        if self._refused:  # while it waits or brakes there is time to try them in turn, the slowest first
            speeds = (speeds[-1 - (self._refused - 1) % len(speeds)],)
        self._refused += 1
        for speed in speeds:
            distance = self._distance(speed_now, speed)
            if distance >= last:
                break  # it would not be slower: the robot has not yet gathered speed
            last = distance
            motion, reason = self._timed(chart, start, held, distance, speed, astray)
            lap("retiming")
            if motion is None:
                continue
            tried = True
            certificate = self.certifier.certify(motion, scene, possible)
            lap("motion certificate")
            if certificate.certified:
                self._refused = 0
                at_goal = self._ends_at(motion, chart[-1])
                return Proposal(motion, certificate, True, False, at_goal, "", report, speed, timings)
            reason = f"motion at {speed:g} of full speed not certified: {certificate.broken}"
        if start.v.any() and ((unforeseen := surprised()) or not tried):
            rest = held.tail(start.time)
            verdict = self.certifier.certify(rest, scene, possible)
            lap("motion certificate")
            if not verdict.certified:
                motion, certificate = rest, verdict
                reason = f"the held motion is no longer certified: {verdict.broken}"
                if unforeseen:  # else what it was certified with is still a proof
                    motion = self.hard.brake(held, start.time)
                return Proposal(
                    motion, certificate, False, False, False, reason, report, speed, timings, emergency=unforeseen
                )
            if not tried:  # the robot has to stop here, and is doing so
                return Proposal(rest, verdict, False, True, False, reason, report, speed, timings)
        return Proposal(motion, certificate, False, False, False, reason, report, speed, timings)

    def _timed(
        self, chart: Array, start: ReferenceState, held: Trajectory, distance: float, speed: float, astray: bool
    ) -> tuple[Trajectory | None, str]:
        """A motion along the nodes, with ease where that is possible; or why there is none.

        Where the strip has turned away too sharply for the robot's speed, the motion first goes on as the held one.
        """
        reason = ""
        ways = [(0.0, self.easy), (0.0, self.hard)]
        if not astray:
            ways += [(lead, self.hard) for lead in _LEADS]
        for lead, retimer in ways:
            nodes = chart if lead == 0.0 else self._led(chart, start, held, lead)
            try:
                part = speed * self.params.ease_speed if retimer is self.easy else speed
                motion = retimer.horizon(
                    nodes, start.v, a_start=start.a, distance=distance, start_time=start.time, speed=part
                )
                return motion, ""
            except RetimingError as error:
                reason = reason or f"no motion along the strip: {error}"
            if not start.v.any():
                break
        return None, reason

    def _led(self, chart: Array, start: ReferenceState, held: Trajectory, share: float) -> Array:
        """Nodes that follow the held motion for a share of what is left of it, and then the strip."""
        space, weight = self.robot.space, self.spacing_weight
        ahead = held.chart[np.searchsorted(held.time, start.time, side="right") :]
        rows = [start.chart]
        for row in ahead[: int(np.ceil(share * len(ahead)))]:
            v = space.difference(rows[-1], row)
            if float((v * v) @ weight) > _LEAD_SPACING**2:
                rows.append(row)
        onward, _ = remaining(space, chart, rows[-1], weight, moving=False)
        return np.vstack([np.array(rows), onward[1:]])

    def _distance(self, speed_now: float, speed: float) -> float:
        """How far ahead a motion has to reach: until after the next one, at the speed it will have, and to stop."""
        params, limits = self.params, self.limits
        top = float(limits.drive_speed.max(initial=0.0)) or 1.0
        change = float(limits.drive_acceleration.min(initial=np.inf)) if limits.drive_dim else 4.0
        change *= params.ease_acceleration
        period = ((params.motion_every + 1) * params.plan_every + params.latency) * params.control_dt
        v = min(speed_now + change * period, max(speed * top, speed_now))
        return v * period + v * v / (2.0 * change) + 0.02

    def _ends_at(self, motion: Trajectory, goal: Array) -> bool:
        v = self.robot.space.difference(motion.chart[-1], goal)
        b = self.robot.space.base_nv
        near = float(np.hypot(*v[:2])) if b else 0.0
        return near <= 0.5 * self.params.goal_position and bool(
            np.abs(v[2 if b else 0 :]).max(initial=0.0) <= 0.5 * self.params.goal_angle
        )


def fastest_drive(limits: MotionLimits, v: Array) -> float:
    """Speed [m/s] of the fastest drive coordinate, or of the joints where those are faster by their own limits."""
    base = len(v) - len(limits.joint_speed)
    drive = np.abs(limits.to_drive(v[:base])).max(initial=0.0)
    share = (np.abs(v[base:]) / limits.joint_speed).max(initial=0.0)
    return float(max(drive, share * limits.drive_speed.max(initial=1.0)))
