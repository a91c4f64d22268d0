"""Execution room, pilot: one planning tick: the strip gives way, and what lies ahead becomes a certified motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from time import perf_counter

import numpy as np

from ..deform import Deformer, DeformReport
from ..proximity import Forecast
from ..robot import RobotModel
from ..robot.space import Array
from ..scene import Scene
from ..strip import Strip
from ..tunnel import Certificate
from .limits import MotionLimits
from .params import DriveParams
from .path import RetimingError
from .prediction import ArrivalTimes, predict
from .progress import remaining
from .retiming import Retimer
from .timed_certificate import TrajectoryCertifier
from .trajectory import ReferenceState, Trajectory

_LEAD_SPACING = 0.04
"""Spacing [m] of nodes that are taken over from the held motion."""


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


class Pilot:
    """Workspace: the strip ahead of the robot, and motions along it.

    Args:
        robot: whose strip.
        limits: of its motors.
        params: of the drive.
        strip: from the start to the goal.
    """

    def __init__(self, robot: RobotModel, limits: MotionLimits, params: DriveParams, strip: Strip) -> None:
        self.robot, self.limits, self.params = robot, limits, params
        deform = params.deform.replaced(clearance=max(params.deform.clearance, params.clearance))
        self.deformer = Deformer(robot, deform)
        # planned with less than the motors can do, so that there is something left when the way changes
        easy = limits.scaled(speed=1.0, acceleration=params.ease_acceleration)
        self.easy, self.hard = (Retimer(robot, each, dt=params.sample_dt) for each in (easy, limits))
        self.certifier = TrajectoryCertifier(
            robot, clearance=params.clearance, self_clearance=deform.self_clearance, settle_time=params.settle_time
        )
        self.arrival = ArrivalTimes(robot, _pace(robot, limits))
        self.strip = strip
        self.report: DeformReport | None = None
        self._ticks = 0
        self._age = 0
        self._last: Proposal | None = None
        self._names: tuple[str, ...] = ()
        self._turn = 0

    def take(self, strip: Strip) -> None:
        """Go on with another strip."""
        self.strip = strip
        self._last = None

    def tick(self, now: float, scene: Scene, held: Trajectory, begin: float) -> Proposal:
        """Deform the strip, and plan a motion along it.

        Args:
            now: time [s].
            scene: sensed at ``scene.time``.
            held: the motion that is executed.
            begin: time [s] at which the new one is to take over.
        """
        proposal = self._going_on(scene, held, begin) or self._anew(now, scene, held, begin)
        self._names, self._last = scene.names, proposal
        return proposal

    def _going_on(self, scene: Scene, held: Trajectory, begin: float) -> Proposal | None:
        """What is left of a motion that was planned a tick ago, where it is still certified; or to go on waiting.

        It was planned to reach further than to the tick after next: nothing is lost, and half the ticks are cheap.
        """
        last = self._last
        if last is None or scene.names != self._names or last.at_goal:
            return None
        self._age += 1
        if self._age >= self.params.motion_every:
            return None
        if not held.at(begin).v.any() and not last.accepted:
            return Proposal(None, None, False, False, False, last.reason, last.report, last.speed)
        if last.motion is None or held is not last.motion or not (last.accepted or last.kept):
            return None
        mark = perf_counter()
        certificate = self.certify(held.tail(begin), scene)
        if not certificate.certified:
            return None
        timings = {"motion certificate": perf_counter() - mark}
        return Proposal(held, certificate, False, True, False, "", last.report, last.speed, timings)

    def _anew(self, now: float, scene: Scene, held: Trajectory, begin: float) -> Proposal:
        """Deform the strip, and plan a motion along it."""
        start = held.at(begin)
        mark = perf_counter()
        timings: dict[str, float] = {}
        self._age = 0

        def lap(phase: str) -> None:
            nonlocal mark
            t = perf_counter()
            timings[phase] = timings.get(phase, 0.0) + t - mark
            mark = t

        params = self.params
        expected = predict(scene, params.assumptions, horizon=params.horizon + now - scene.time, sure=True)
        possible = predict(scene, params.assumptions)
        moving = bool(np.abs(start.v).max(initial=0.0) > 1e-6)
        chart, source = remaining(
            self.robot.space, self.strip.chart, start.chart, self.deformer.spacing_weight, moving=moving
        )
        strip = self.deformer.carry(self.strip, chart, source)
        delay = start.time - scene.time
        foresight = None
        if len(expected):
            foresight = partial(self.arrival.foresight, expected, delay)
        lap("strip")
        self._ticks += 1
        report = self.deformer.step(
            strip, scene, foresight=foresight, nodes=self._ticks % self.params.maintain_every == 0
        )
        if not report.certified and self.report is not None and self.report.certified:
            for _ in range(self.params.recover_iterations):  # it was lost just now: regain it before the next tick
                report = self.deformer.step(report.strip, scene, foresight=foresight)
                if report.certified:
                    break
        self.strip, self.report = report.strip, report
        lap("deform")
        return self._motion(start, held, scene, possible, report, timings, lap)

    def certify(self, motion: Trajectory, scene: Scene) -> Certificate:
        """Certify what is left of a motion once more, against a newer scene."""
        return self.certifier.certify(motion, scene, predict(scene, self.params.assumptions))

    def _motion(
        self,
        start: ReferenceState,
        held: Trajectory,
        scene: Scene,
        possible: Forecast,
        report: DeformReport,
        timings: dict[str, float],
        lap: Callable[[str], None],
    ) -> Proposal:
        """The fastest motion along the strip that is certified."""
        chart = report.strip.chart
        speed_now = _fastest(self.limits, start.v)
        motion: Trajectory | None = None
        certificate: Certificate | None = None
        reason, at_goal, speed, tried = "", False, 0.0, False
        last = np.inf
        speeds = self.params.speeds
        if not start.v.any():  # while it waits there is time to try them in turn
            speeds = (speeds[self._turn % len(speeds)],)
            self._turn += 1
        for speed in speeds:
            distance = self._distance(speed_now, speed)
            if distance >= last:
                break  # it would not be slower: the robot has not yet gathered speed
            last = distance
            motion, reason = self._timed(chart, start, held, distance, speed)
            lap("retiming")
            if motion is None:
                continue
            tried = True
            certificate = self.certifier.certify(motion, scene, possible)
            lap("motion certificate")
            if certificate.certified:
                self._turn = 0
                at_goal = self._ends_at(motion, chart[-1])
                return Proposal(motion, certificate, True, False, at_goal, "", report, speed, timings)
            reason = f"motion at {speed:g} of full speed not certified: {certificate.broken}"
        if not tried and start.v.any():  # the robot has to stop here, and is doing so
            motion = held.tail(start.time)
            certificate = self.certifier.certify(motion, scene, possible)
            lap("motion certificate")
            if certificate.certified:
                return Proposal(motion, certificate, False, True, False, reason, report, speed, timings)
            reason = f"the held motion is no longer certified: {certificate.broken}"
        return Proposal(motion, certificate, False, False, False, reason, report, speed, timings)

    def _timed(
        self, chart: Array, start: ReferenceState, held: Trajectory, distance: float, speed: float
    ) -> tuple[Trajectory | None, str]:
        """A motion along the nodes, with ease where that is possible; or why there is none.

        Where the strip has turned away too sharply for the robot's speed, the motion first goes on as the held one.
        """
        reason = ""
        for lead, retimer in ((0.0, self.easy), (0.0, self.hard), (0.5, self.hard), (1.0, self.hard)):
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
        space, weight = self.robot.space, self.deformer.spacing_weight
        ahead = held.chart[np.searchsorted(held.time, start.time, side="right") :]
        rows = [start.chart]
        for row in ahead[: int(np.ceil(share * len(ahead)))]:
            v = space.difference(rows[-1], row)
            if float((v * v) @ weight) > _LEAD_SPACING**2:
                rows.append(row)
        onward, _ = remaining(space, chart, rows[-1], weight, moving=False)
        return np.vstack([np.array(rows), onward[1:]])

    def _distance(self, speed_now: float, speed: float) -> float:
        """How far ahead a motion has to reach: two planning periods at the speed it will have, and the way to stop."""
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


def _pace(robot: RobotModel, limits: MotionLimits) -> Array:
    """(nv,) usual speeds: three quarters of what the motors can do."""
    space = robot.space
    pace = np.empty(space.nv)
    pace[space.base_nv :] = limits.joint_speed
    if limits.drive_dim == 2:
        top = float(limits.drive_speed.min())
        pace[:3] = top, top, 2.0 * top / limits.track
    elif limits.drive_dim == 3:
        pace[:3] = limits.drive_speed
    return 0.75 * pace


def _fastest(limits: MotionLimits, v: Array) -> float:
    """Speed [m/s] of the fastest drive coordinate, or of the joints where those are faster by their own limits."""
    base = len(v) - len(limits.joint_speed)
    drive = np.abs(limits.to_drive(v[:base])).max(initial=0.0)
    share = (np.abs(v[base:]) / limits.joint_speed).max(initial=0.0)
    return float(max(drive, share * limits.drive_speed.max(initial=1.0)))
