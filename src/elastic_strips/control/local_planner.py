"""Local planner: one planning tick: the strip is deformed, and a certified motion is timed along it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from elastic_strips.collision import Certificate
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import Strip
from elastic_strips.strip.deformer import Deformer
from elastic_strips.strip.report import DeformReport
from elastic_strips.strip.workspace import PhaseClock
from elastic_strips.trajectory import MotionLimits, ReferenceState, Trajectory

from .evasion import EvasivePlanner
from .pace import Pace
from .params import DriveParams, Margins
from .prediction import ArrivalTimes, Outlook
from .progress import reconnect, trim_passed
from .strip_timer import PlanOutcome, PlanResult, StripTimer

BROKEN_STEPS = 4
"""Steps for which a strip that has broken gets new nodes; then other means have to help."""
_STUCK_EVERY = 4
"""After that it is deformed in every fourth tick while the robot waits, in case the obstacle in it goes away."""


class LocalPlanner:
    """Workspace: the strip ahead of the robot, and motions along it.

    Args:
        robot: the robot.
        limits: limits of its motors.
        params: parameters of the drive.
        strip: from the start to the goal.
        pace: how much time a tick has; None: enough.

    Attributes:
        strip: the strip that is followed, from the robot's configuration in the last tick on.
        margins: what motions keep from obstacles at present.
        off_strip: whether the robot has left it to evade, and has not come back.
        report: report of the strip's last tick; None before the first.
        evasion: plans manoeuvres off the strip; None where the robot only brakes and waits.
    """

    def __init__(
        self, robot: RobotModel, limits: MotionLimits, params: DriveParams, strip: Strip, pace: Pace | None = None
    ) -> None:
        self.robot: RobotModel = robot
        self.limits: MotionLimits = limits
        self.params: DriveParams = params
        self.margins: Margins = params.margins
        self.deformer: Deformer = Deformer(robot, params.strip, constraint=params.constraint)
        self.pace: Pace = Pace(params, None) if pace is None else pace
        self.timer: StripTimer = StripTimer(robot, limits, params, self.deformer.spacing_weight, self.pace)
        self.arrival: ArrivalTimes = ArrivalTimes(robot, limits)
        self.evasion: EvasivePlanner | None = None
        if params.evasion is not None:
            self.evasion = EvasivePlanner(robot, limits, params.evasion, dt=params.sample_dt, hold=self._held)
        self.strip: Strip = strip
        self.off_strip: bool = False
        self.report: DeformReport | None = None
        self._last: PlanResult | None = None
        self._proof: tuple[Trajectory, Outlook] | None = None  # a certified motion, and what against
        self._compared: tuple[Scene, Outlook, bool] | None = None  # whether a scene surprises after an outlook
        self._names: tuple[str, ...] = ()
        self._ticks = self._age = 0
        self._broken = 0  # steps in a row that have left the strip without a certificate
        self._step_took = self._evasion_took = 0.0  # [s] the last time

    @property
    def _held(self) -> float:
        """Time [s] for which a manoeuvre is held at least: until after the next one."""
        return 2 * self.pace.every * self.params.control_dt

    def take(self, strip: Strip, *, beside: bool = False) -> None:
        """Follow another strip from now on.

        Args:
            strip: begins where the robot is, or near it.
            beside: whether it begins only near the robot, so that it has to be joined.
        """
        self.strip = strip
        self._last, self._broken = None, 0
        self.off_strip = beside

    def allow(self, tracking_error: float) -> None:
        """Plan for another tracking error [m] from now on; motions certified for a smaller one are certified anew."""
        if tracking_error > self.margins.tracking_error:
            self._proof = None
        self.margins = replace(self.margins, tracking_error=tracking_error)
        self.deformer.keep_clearance(max(self.params.deform.clearance, self.margins.clearance))

    def reset(self) -> None:
        """Discard all state that is kept from tick to tick, except the strip; for use after an exception."""
        self.deformer.reset()
        self.timer.certifier.reset()
        self._last = self._proof = None

    def certify(self, motion: Trajectory, scene: Scene, tracking_error: float | None = None) -> Certificate:
        """Certify the rest of a motion against a newer scene, with the present tracking error or another one [m]."""
        outlook = self._outlook(scene)
        if tracking_error is not None:
            outlook = replace(outlook, margins=replace(self.margins, tracking_error=tracking_error))
        return self.timer.certify(motion, outlook)

    def _outlook(self, scene: Scene) -> Outlook:
        return Outlook.of(scene, self.params.assumptions, self.margins)

    def tick(self, now: float, scene: Scene, active: Trajectory, begin: float) -> PlanResult:
        """Deform the strip, and plan a motion along it.

        Args:
            now: time [s].
            scene: sensed at ``scene.time``.
            active: the trajectory that is executed.
            begin: start time [s] of the new motion.
        """
        result = self._unchanged(scene, active, begin) or self._plan(now, scene, active, begin)
        self._names, self._last = scene.names, result
        return result

    def _unchanged(self, scene: Scene, active: Trajectory, begin: float) -> PlanResult | None:
        """The last tick's motion where its certificate still holds, or its failure while the robot waits; else None.

        A motion reaches further than to the tick after next, so that every second tick may skip planning.
        """
        last = self._last
        if last is None or scene.names != self._names or self.off_strip:
            return None
        if last.outcome in (PlanOutcome.ARRIVE, PlanOutcome.EVADE):
            return None
        self._age += 1
        if self._age >= self.params.motion_every:
            return None
        if not active.at(begin).v.any() and not last.accepted:
            return PlanResult(PlanOutcome.NONE, None, None, last.reason, last.report, last.speed)
        if active is not last.motion or self._surprised(active, scene):
            return None
        return PlanResult(PlanOutcome.UNCHANGED, active, last.certificate, "", last.report, last.speed)

    def _plan(self, now: float, scene: Scene, active: Trajectory, begin: float) -> PlanResult:
        """Deform the strip, and plan a motion along it.

        Where planning is slow the active trajectory is certified first: a robot that has to brake does so at once.
        """
        start = active.at(begin)
        watch = PhaseClock()
        self._age = 0
        outlook = self._outlook(scene)
        if self.pace.slow and self.report is not None and start.v.any():
            brake = self._brake(start, active, outlook, self.report, watch)
            if brake is not None:
                return brake
        report = self._deform(now, outlook, start, watch)
        result = self.timer.motion(start, active, outlook, report, watch, off_strip=self.off_strip)
        if not result.accepted and start.v.any():
            result = self._on_active(result, start, active, outlook, watch)
        if self.evasion is not None and (self.pace.has(self._evasion_took) or not result.accepted):
            self.evasion.hold = self._held
            before = self.pace.reading()
            result = self.evasion.improved(result, start, active, outlook, self.timer.certify, self.arrival, self.pace)
            self._evasion_took = self.pace.reading() - before
            watch.mark("evasion")
        self.off_strip = result.outcome is PlanOutcome.EVADE or (self.off_strip and not result.accepted)
        if result.outcome is PlanOutcome.BRAKE:
            self._proof = None
        elif result.accepted and result.motion is not None:
            self._proof = result.motion, outlook
        return result

    def _brake(
        self, start: ReferenceState, active: Trajectory, outlook: Outlook, report: DeformReport, watch: PhaseClock
    ) -> PlanResult | None:
        """The active trajectory braked, where the scene is not what it was certified for, and it is certified no
        longer; else None."""
        if not self._surprised(active, outlook.scene):
            return None
        certificate = self.timer.certify(active.tail(start.time), outlook)
        watch.mark("motion certificate")
        if certificate.certified:
            self._proof = active, outlook
            return None
        self._proof = None
        reason = f"the held motion is no longer certified: {certificate.broken}"
        braked = self.timer.hard.brake(active, start.time)
        if braked.end_time >= active.end_time - 0.01:  # it brakes already: look for a way on
            return None
        return PlanResult(PlanOutcome.BRAKE, braked, certificate, reason, report, 0.0, watch.phases)

    def _on_active(
        self, result: PlanResult, start: ReferenceState, active: Trajectory, outlook: Outlook, watch: PhaseClock
    ) -> PlanResult:
        """Decide on the active trajectory where the robot moves and there is no new motion.

        It goes on to its end. The robot brakes at once only if the scene is not what the trajectory was certified for,
        and it is no longer certified.
        """
        surprised, tried = self._surprised(active, outlook.scene), result.certificate is not None
        if tried and not surprised:
            return result
        rest = active.tail(start.time)
        certificate = self.timer.certify(rest, outlook)
        watch.mark("motion certificate")
        if certificate.certified and tried:
            return result
        result = replace(result, motion=rest, certificate=certificate)
        if certificate.certified:  # the robot has to stop on it, and does
            return replace(result, outcome=PlanOutcome.UNCHANGED)
        result = replace(result, reason=f"the held motion is no longer certified: {certificate.broken}")
        if not surprised:  # its own certificate still holds
            return result
        return replace(result, outcome=PlanOutcome.BRAKE, motion=self.timer.hard.brake(active, start.time))

    def _surprised(self, active: Trajectory, scene: Scene) -> bool:
        """Whether a scene differs from what the motion's certificate allowed for, or whether that is not known."""
        if self._proof is None:
            return True
        motion, before = self._proof
        if motion is not active:
            return True
        if self._compared is None or self._compared[0] is not scene or self._compared[1].scene is not before.scene:
            self._compared = scene, before, not before.allows(scene)
        return self._compared[2]

    def _deform(self, now: float, outlook: Outlook, start: ReferenceState, watch: PhaseClock) -> DeformReport:
        """One tick of the strip from the start state on; several where it has just lost its certificate."""
        params, scene = self.params, outlook.scene
        expected = outlook.expected(params.horizon + now - scene.time)
        moving = bool(np.abs(start.v).max(initial=0.0) > 1e-6)
        ahead = reconnect if self.off_strip else trim_passed
        coordinates, source = ahead(
            self.robot.space, self.strip.coordinates, start.coordinates, self.deformer.spacing_weight, moving=moving
        )
        strip = self.deformer.carry(self.strip, coordinates, source)
        prediction = None
        if len(expected):
            prediction = partial(self.arrival.prediction, expected, start.time - scene.time)
        watch.mark("strip")
        self._ticks += 1
        before, last = self.report, self._last
        waits = last is not None and last.outcome in (PlanOutcome.NONE, PlanOutcome.BRAKE)
        stuck = self._broken > BROKEN_STEPS
        every = _STUCK_EVERY if stuck else 1 if prediction is None else 2
        if before is not None and waits and scene.names == self._names and self._ticks % every:
            report = replace(before, strip=strip)  # only the motion is planned again
        else:
            began = self.pace.reading()
            maintained = self._ticks % params.maintain_every == 0 and not stuck
            report = self.deformer.step(strip, scene, prediction=prediction, nodes=maintained, retry=False)
            self._step_took = self.pace.reading() - began
            self._broken = 0 if report.certified else self._broken + 1
        if before is not None and before.certified and not self.off_strip:
            for _ in range(params.recover_iterations):
                if report.certified or not self.pace.has(self._step_took, waits=True):
                    break
                report = self.deformer.step(
                    report.strip, scene, prediction=prediction, nodes=prediction is None, retry=False
                )
        self.strip, self.report = report.strip, report
        watch.mark("deform")
        return report
