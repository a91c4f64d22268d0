"""Pilot: one planning tick: the strip gives way, and what lies ahead becomes a certified motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from time import perf_counter

import numpy as np

from ..deform import Deformer, DeformReport
from ..proximity import Forecast
from ..robot import RobotModel
from ..scene import Scene
from ..strip import Strip
from ..trajectory.limits import MotionLimits
from ..trajectory.trajectory import ReferenceState, Trajectory
from ..tunnel import Certificate
from .evasion import Evasion
from .params import DriveParams
from .prediction import ArrivalTimes, as_expected, predict, usual_pace
from .progress import reattached, remaining
from .strip_timer import Onward, Proposal


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
        self.deformer = Deformer(robot, deform, task=params.task)
        self.onward = Onward(robot, limits, params, self.deformer.spacing_weight, deform.self_clearance)
        self.certifier = self.onward.certifier
        self.arrival = ArrivalTimes(robot, usual_pace(robot, limits))
        self.evasion: Evasion | None = None
        if params.evasion is not None:
            hold = 2 * params.plan_every * params.control_dt
            self.evasion = Evasion(
                robot, limits, params.evasion, dt=params.sample_dt, hold=hold, clearance=params.clearance
            )
        self.strip = strip
        self.report: DeformReport | None = None
        self._last: Proposal | None = None
        self._proof: tuple[Trajectory, Scene, Forecast] | None = None  # what was certified last, and against what
        self._names: tuple[str, ...] = ()
        self._ticks = self._age = 0
        self._astray = False

    def take(self, strip: Strip) -> None:
        """Go on with another strip."""
        self.strip = strip
        self._last = None

    def reset(self) -> None:
        """Forget all that is kept from tick to tick, the strip aside; for after an exception."""
        self.deformer.reset()
        self.certifier.reset()
        self._last = self._proof = None

    def certify(self, motion: Trajectory, scene: Scene) -> Certificate:
        """Certify what is left of a motion once more, against a newer scene."""
        return self.certifier.certify(motion, scene, predict(scene, self.params.assumptions))

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
        """The motion of the last tick, where its certificate still holds; or to go on waiting. None: plan anew.

        A motion reaches further than to the tick after next: nothing is lost, and half the ticks are cheap.
        """
        last = self._last
        if last is None or scene.names != self._names or last.at_goal or last.evasive or self._astray:
            return None
        self._age += 1
        if self._age >= self.params.motion_every:
            return None
        if not held.at(begin).v.any() and not last.accepted:
            return Proposal(None, None, False, False, False, last.reason, last.report, last.speed)
        if held is not last.motion or self._surprised(held, scene):
            return None
        return Proposal(held, last.certificate, False, True, False, "", last.report, last.speed)

    def _anew(self, now: float, scene: Scene, held: Trajectory, begin: float) -> Proposal:
        """Deform the strip, and plan a motion along it."""
        params = self.params
        start = held.at(begin)
        mark = perf_counter()
        timings: dict[str, float] = {}
        self._age = 0

        def lap(phase: str) -> None:
            nonlocal mark
            t = perf_counter()
            timings[phase] = timings.get(phase, 0.0) + t - mark
            mark = t

        possible = predict(scene, params.assumptions)
        self._give_way(now, scene, start, lap)
        assert self.report is not None
        proposal = self.onward.motion(
            start, held, scene, possible, self.report, timings, lap,
            astray=self._astray, surprised=partial(self._surprised, held, scene),
        )  # fmt: skip
        if self.evasion is not None:
            proposal = self.evasion.improved(proposal, start, held, scene, possible, self.certifier, self.arrival)
            lap("evasion")
        self._astray = proposal.evasive or (self._astray and not proposal.accepted)
        if proposal.emergency:
            self._proof = None
        elif proposal.accepted and proposal.motion is not None:
            self._proof = proposal.motion, scene, possible
        return proposal

    def _surprised(self, held: Trajectory, scene: Scene) -> bool:
        """Whether a scene is not what the held motion's certificate allowed for, or nobody knows what that was."""
        if self._proof is None or self._proof[0] is not held:
            return True
        return not as_expected(scene, *self._proof[1:], self.params.assumptions)

    def _give_way(self, now: float, scene: Scene, start: ReferenceState, lap: Callable[[str], None]) -> None:
        """One tick of the strip from where the robot will be; more of them where it has just lost its certificate."""
        params = self.params
        expected = predict(scene, params.assumptions, horizon=params.horizon + now - scene.time, sure=True)
        moving = bool(np.abs(start.v).max(initial=0.0) > 1e-6)
        onward = reattached if self._astray else remaining
        chart, source = onward(
            self.robot.space, self.strip.chart, start.chart, self.deformer.spacing_weight, moving=moving
        )
        strip = self.deformer.carry(self.strip, chart, source)
        foresight = None
        if len(expected):
            foresight = partial(self.arrival.foresight, expected, start.time - scene.time)
        lap("strip")
        self._ticks += 1
        before, last = self.report, self._last
        waits = last is not None and not (last.accepted or last.kept) and scene.names == self._names
        if before is not None and waits and foresight is not None and self._ticks % 2:
            report = replace(before, strip=strip)  # it waits or brakes: only the motion is tried again
        else:
            report = self.deformer.step(
                strip, scene, foresight=foresight, nodes=self._ticks % params.maintain_every == 0
            )
        if before is not None and before.certified and not self._astray:
            for _ in range(params.recover_iterations):
                if report.certified:
                    break
                report = self.deformer.step(report.strip, scene, foresight=foresight)
        self.strip, self.report = report.strip, report
        lap("deform")
