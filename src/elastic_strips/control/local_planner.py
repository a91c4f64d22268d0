"""Local planner: one planning tick: the strip is deformed, and a certified motion is timed along it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from itertools import islice

import numpy as np

from elastic_strips.arrays import Array, Mask
from elastic_strips.collision import Certificate
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Obstacle, Scene
from elastic_strips.scene.obstacle import LOST_LAYER
from elastic_strips.strip import Strip
from elastic_strips.strip.deformer import Deformer
from elastic_strips.strip.followed import FollowedPath
from elastic_strips.strip.report import DeformReport
from elastic_strips.strip.workspace import PhaseClock
from elastic_strips.trajectory import MotionLimits, ReferenceState, Trajectory
from elastic_strips.trajectory.trajectory import stationary

from .evasion import EvasivePlanner
from .itinerary import passed_at
from .joining import curves_onto
from .keeping import ConstraintKeeper
from .pace import Pace
from .params import DriveParams, Margins, Tolerance
from .prediction import ArrivalTimes, Outlook
from .progress import reconnect, trim_passed
from .strip_timer import PlanOutcome, PlanResult, StripTimer, fastest_drive
from .tracks import MoverTracks

_NEARER = 0.002  # [m] by which a motion may come nearer to what it leaves
_CURVE_ENDS = 0.05  # [m in the metric] before the end of a curve onto a strip, the robot is on it
_LOOKED_BACK, _LOOKED_STEP = 0.5, 0.01
"""Longest time [s], and its steps, over which it is looked whether the end of a strip was passed."""
_SLOW_SHARE = 0.15  # of the speed limits, below which a robot stops and turns at rest
_FREE_AHEAD = 1.5
"""A robot turns onto a strip at speed where so much of it [m in the metric] is certified."""
_MOST_CURVES = 4  # onto a strip, that are tried in a tick
_REGAINED_EVERY = 4  # ticks, after which the joints of a strip that misses its constraint are moved to satisfy it
_PASSING_SPEED = 0.3  # part of the speed limits with which a curve from the end of a strip on begins
_SAME_DIRECTION_COSINE = 0.995  # of the angle by which the end of the strip may turn until the way on is made anew
_TOGETHER = 0.5
"""Part of the nominal latency that the strip's step and the motion along it may take together: where they take longer,
a tick has one of the two, so that the robot's motion waits for neither."""
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
        tracks: how moving obstacles have changed their velocities of late.
        prepared: whether the last tick had the strip's step alone: the next one, which comes sooner, plans the motion.
        passed: when the end of the strip before was passed [s], and the reference (nv,) then; None where the robot has
            not gone on from one strip to another since :meth:`take`.
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
        self._keeper: ConstraintKeeper | None = None
        if self.deformer.constraint is not None:
            self._keeper = ConstraintKeeper(
                robot,
                limits,
                self.deformer.constraint,
                self_clearance=params.deform.self_clearance,
                dt=params.sample_dt,
            )
        self.timer: StripTimer = StripTimer(robot, limits, params, self.deformer.spacing_weight, self.pace)
        self.arrival: ArrivalTimes = ArrivalTimes(robot, limits, params.turn_speed)
        self.evasion: EvasivePlanner | None = None
        if params.evasion is not None:
            self.evasion = EvasivePlanner(
                robot,
                limits,
                params.evasion,
                dt=params.sample_dt,
                hold=self.timer.held,
                backward=params.backward,
                turn_speed=params.turn_speed,
            )
        self.tracks: MoverTracks = MoverTracks()
        self.strip: Strip = strip
        self.off_strip: bool = False
        self.report: DeformReport | None = None
        self.prepared: bool = False
        self.passed: tuple[float, Array] | None = None
        self._next: tuple[Strip, Tolerance] | None = None  # how the strip goes on, and how near its end is passed
        self._curve: Array | None = None  # rows that lead the robot onto the strip, and do not give way
        self._onward: tuple[Array | None, Array] | None = (
            None  # such rows from the end of the strip on, and what follows
        )
        self._joins = False  # whether the strip was taken by a robot in motion, that is not on it yet
        self._arriving: Array = np.zeros(0)  # direction in which the strip ends, for which they were made
        self._looked = -np.inf  # [s] until when it is known that the end was not passed
        self._last: PlanResult | None = None
        self._proof: tuple[Trajectory, Outlook] | None = None  # a certified motion, and what against
        self._compared: tuple[Scene, Outlook, bool] | None = None  # whether a scene surprises after an outlook
        self._names: tuple[str, ...] = ()
        self._ticks = self._age = 0
        self._broken = 0  # steps in a row that have left the strip without a certificate
        self._kept = 0  # ticks for which the strip stays as it is
        self._step_took = self._motion_took = self._evasion_took = 0.0  # [s] the last time
        self._stepped = False  # whether the last tick had a step of the strip

    def take(self, strip: Strip, *, beside: bool = False, as_it_is: bool = False) -> None:
        """Follow another strip from now on.

        Args:
            strip: begins where the robot is, or near it.
            beside: whether it begins only near the robot, so that it has to be joined.
            as_it_is: whether motions along it are tried before it gives way, at each of the speeds.
        """
        self._follow(strip, None)
        self._kept = len(self.params.speeds) if as_it_is else 0
        self.off_strip = self._joins = beside
        self._next = self._onward = self.passed = None

    def keep_to(self, path: FollowedPath | None) -> None:
        """Keep to a path from now on, or to none."""
        self.deformer.path = self.timer.path = path
        self._proof = None

    def _follow(self, strip: Strip, curve: Array | None) -> None:
        """Follow a strip, after rows (R, nv) of a curve onto it."""
        self.strip = strip
        self._curve, self._last, self._broken, self._kept = curve, None, 0, 0
        self.off_strip = self._joins = self.prepared = False

    def lead_on(self, strip: Strip, within: Tolerance) -> None:
        """Let motions go on from the end of the strip along another one, without a stop where that can be.

        Args:
            strip: begins where the present one ends.
            within: how near that end is passed.
        """
        self._next, self._onward, self._last = (strip, within), None, None

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
        self.prepared = False
        self.tracks = MoverTracks()

    def certify(self, motion: Trajectory, scene: Scene, tracking_error: float | None = None) -> Certificate:
        """Certify the rest of a motion against a newer scene, with the present tracking error or another one [m]."""
        outlook = self._outlook(scene)
        if tracking_error is not None:
            outlook = replace(outlook, margins=replace(self.margins, tracking_error=tracking_error))
        return self.timer.certify(motion, outlook)

    def beginning(
        self, motion: Trajectory, certificate: Certificate, scene: Scene
    ) -> tuple[Trajectory, Certificate] | None:
        """A certified beginning of a motion from rest; see :meth:`StripTimer.beginning`."""
        return self.timer.beginning(motion, certificate, self._outlook(scene))

    def certify_leaving(self, motion: Trajectory, scene: Scene) -> Certificate:
        """Certify a motion that leads away from what is nearer to the robot than the clearance where it begins.

        To that it keeps its distance, to within 2 mm, where it does not touch it. From all else that stands it keeps as
        much, and the tracking error at least: a thing in a map is several obstacles. To what moves, or may come from
        where nothing sees, it keeps the clearance: that may come after it.
        """
        start, kept = motion.at(motion.start_time), dict(zip(scene.names, scene, strict=True))
        most = least = self.margins.clearance
        while True:
            near = self.timer.certify(self._still(start), self._among(kept.values(), scene, most)).broken
            if near is None or near.obstacle not in kept or scene.moves(near.obstacle):
                break
            leaves = kept.pop(near.obstacle)
            least = min(least, near.clearance - _NEARER)
            if near.clearance > _NEARER:
                certificate = self.timer.certify(motion, self._among([leaves], scene, near.clearance - _NEARER))
                if not certificate.certified:
                    return certificate
        comes = [scene.moves(name) or name.startswith(LOST_LAYER) for name in kept]
        standing = [each for each, may in zip(kept.values(), comes, strict=True) if not may]
        coming = [each for each, may in zip(kept.values(), comes, strict=True) if may]
        certificate = self.timer.certify(motion, self._among(coming, scene, most))
        if not certificate.certified:
            return certificate
        enough = min(max(least, self.margins.tracking_error), most)
        return self.timer.certify(motion, self._among(standing, scene, enough))

    def _among(self, obstacles: Iterable[Obstacle], scene: Scene, clearance: float) -> Outlook:
        """An outlook on some obstacles of a scene, from which motions keep a clearance [m]."""
        outlook = self._outlook(Scene([*obstacles], time=scene.time))
        return replace(outlook, margins=Margins(clearance, 0.0))

    def cramped(self, state: ReferenceState, scene: Scene) -> tuple[str, float]:
        """What stands nearer to a robot that rests in a state than any motion may be, and how near [m]; empty and
        infinite where nothing does. What moves is not left, but evaded; where a mover may be that nothing sees, it is
        waited for until that is over."""
        near = self.timer.certify(self._still(state), self._outlook(scene)).broken
        if near is not None and near.obstacle.startswith(LOST_LAYER):
            kept = [scene.obstacle(name) for name in scene.names if not name.startswith(LOST_LAYER)]
            known = Scene(kept, time=scene.time)
            near = self.timer.certify(self._still(state), self._outlook(known)).broken
        if near is None or scene.moves(near.obstacle):
            return "", np.inf
        return f"{near.link} is {1e3 * near.clearance:.0f} mm from {near.obstacle}", near.clearance

    def knows_touched(self, state: ReferenceState, scene: Scene) -> bool:
        """Whether something is in a scene, standing or moving, that a robot may touch that rests in a state."""
        outlook = self._outlook(scene)
        outlook = replace(outlook, margins=replace(outlook.margins, margin=0.0))
        return self.timer.certify(self._still(state), outlook).broken is not None

    def _still(self, state: ReferenceState) -> Trajectory:
        """A trajectory that stays where a state is."""
        return stationary(self.robot, self.limits, state.coordinates, state.time, self.params.sample_dt)

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
        if self.evasion is not None:
            self.tracks.take(scene)
        prepared, self.prepared = self.prepared, False
        result = None if prepared else self._unchanged(scene, active, begin)
        if result is None:
            result = self._plan(now, scene, active, begin, prepared)
        self._names = scene.names
        if not self.prepared:
            self._last = result
        return result

    def _unchanged(self, scene: Scene, active: Trajectory, begin: float) -> PlanResult | None:
        """The last tick's motion where its certificate still holds, or its failure while the robot waits; else None.

        A motion reaches further than to the tick after next, so that every second tick may skip planning.
        """
        last = self._last
        if last is None or scene.names != self._names or self.off_strip:
            return None
        if last.outcome in (PlanOutcome.ARRIVE, PlanOutcome.JOIN, PlanOutcome.EVADE):
            return None
        self._age += 1
        if self._age >= self.params.motion_every:
            return None
        if not active.at(begin).v.any() and not last.accepted:
            return PlanResult(PlanOutcome.NONE, None, None, last.reason, last.report, last.speed)
        if active is not last.motion or self._surprised(active, scene):
            return None
        return PlanResult(PlanOutcome.UNCHANGED, active, last.certificate, "", last.report, last.speed)

    def _plan(self, now: float, scene: Scene, active: Trajectory, begin: float, prepared: bool) -> PlanResult:
        """Deform the strip, unless it is ``prepared``, and plan a motion along it, unless that is for the next tick.

        Where planning is slow the active trajectory is certified first: a robot that has to brake does so at once.
        """
        start = active.at(begin)
        watch = PhaseClock()
        self._go_on(active, begin)
        self._age = 0
        outlook = self._outlook(scene)
        if self.pace.slow and self.report is not None and start.v.any():
            brake = self._brake(start, active, outlook, self.report, watch)
            if brake is not None:
                return brake
        last = self._last
        apart = not prepared and last is not None and self._takes_long
        if apart and last is not None and start.v.any() and last.outcome is not PlanOutcome.BRAKE:
            prepared = bool(self.refuted(active, scene, start.time, anyway=True))  # then another motion comes first
            watch.mark("motion certificate")
        report = self._deform(now, outlook, start, watch, prepared)
        if apart and last is not None and self._stepped:
            self.prepared = True
            if start.v.any() and (last.accepted or last.outcome is PlanOutcome.UNCHANGED):
                return PlanResult(PlanOutcome.UNCHANGED, active, None, "", report, last.speed, watch.phases)
            return PlanResult(PlanOutcome.NONE, None, last.certificate, last.reason, report, last.speed, watch.phases)
        began = self.pace.reading()
        result = self._motion(start, active, outlook, report, watch)
        self._motion_took = self.pace.reading() - began
        return result

    @property
    def _takes_long(self) -> bool:
        """Whether the strip's step and the motion along it are not to be in the same tick."""
        nominal = max(self.params.latency, 1) * self.params.control_dt
        return self._step_took + self._motion_took > _TOGETHER * nominal

    def _motion(
        self, start: ReferenceState, active: Trajectory, outlook: Outlook, report: DeformReport, watch: PhaseClock
    ) -> PlanResult:
        """A motion along the strip, onto it or off it."""
        curved = self._joins and self._runs_on(start, report)
        result = self._curved(start, active, outlook, report, watch) if curved else None
        if result is None:
            result = self._along(start, active, outlook, report, watch)
        if not result.accepted and result.certificate is not None:
            nearer = self._nearer(start, outlook)
            if nearer is not None:
                outlook = nearer
                result = self._along(start, active, outlook, report, watch)
        timed = result.accepted or result.motion is not None
        if not result.accepted and start.v.any():
            result = self._on_active(result, start, active, outlook, watch)
        if self.evasion is not None and (self.pace.has(self._evasion_took) or not result.accepted):
            self.evasion.hold = self.timer.held
            before = self.pace.reading()
            evade, trend = self.evasion.improved, self.tracks.trend(outlook)
            keeper = self._keeper
            result = evade(result, start, active, outlook, self.timer.certify, self.arrival, self.pace, trend, keeper)
            self._evasion_took = self.pace.reading() - before
            watch.mark("evasion")
        refused = not result.accepted and result.outcome is not PlanOutcome.BRAKE
        beside = self._joins or self.off_strip  # only from there: on its strip, a robot keeps to what it has
        if refused and not timed and beside and self._runs_on(start, report):  # from a velocity that points elsewhere
            curve = None if curved else self._curved(start, active, outlook, report, watch)
            result = self.timer.joining(result, start, outlook, watch, self._keeper) if curve is None else curve
        on_strip = result.outcome in (PlanOutcome.FOLLOW, PlanOutcome.ARRIVE)
        self._joins = self._joins and not on_strip and result.outcome is not PlanOutcome.EVADE
        self.off_strip = result.outcome is PlanOutcome.EVADE or (self.off_strip and not on_strip)
        if self._curve is not None and not on_strip and start.v.any():
            self._curve, self.off_strip = None, True
        if result.outcome is PlanOutcome.BRAKE:
            self._proof = None
        elif result.accepted and result.motion is not None:
            self._proof = result.motion, outlook
        return result

    def _regained(self, coordinates: Array) -> Strip | None:
        """The strip with its joints moved to where they satisfy the constraint, every few ticks while it misses that;
        else None."""
        keeper, report, constraint = self._keeper, self.report, self.params.constraint
        if keeper is None or constraint is None or self.off_strip or report is None or self._ticks % _REGAINED_EVERY:
            return None
        if report.constraint_errors is None or report.constraint_errors[1:].max() <= constraint.tolerance:
            return None
        return Strip.from_coordinates(self.robot, keeper.path(coordinates))

    def _nearer(self, start: ReferenceState, outlook: Outlook) -> Outlook | None:
        """The outlook with the tracking error alone as its clearance, where the robot is nearer than its margin to
        something already, as where it has braked or was found to be elsewhere; None where it keeps its margin."""
        if outlook.margins.margin == 0.0 or self.timer.certify(self._still(start), outlook).certified:
            return None
        return Outlook(outlook.scene, outlook.possible, replace(outlook.margins, margin=0.0), outlook.assumptions)

    def _curved(
        self, start: ReferenceState, active: Trajectory, outlook: Outlook, report: DeformReport, watch: PhaseClock
    ) -> PlanResult | None:
        """A certified motion along a curve onto the strip, which is followed from now on; None where there is none."""
        before, began = (self.strip, self._curve), self.pace.reading()
        curves = curves_onto(
            self.robot,
            self.limits,
            start.coordinates,
            start.v,
            report.strip.coordinates,
            self.deformer.spacing_weight,
        )
        for curve, rest in islice(curves, _MOST_CURVES):
            if self._keeper is not None:
                curve = self._keeper.path(curve)
            self._curve, self.strip = curve, Strip.from_coordinates(self.robot, rest)
            segments = _proven(report)[len(report.strip) - len(rest) :]
            beyond = replace(report, strip=self.strip, certificate=replace(report.certificate, segments=segments))
            result = self._along(start, active, outlook, beyond, watch)
            if result.accepted:
                return result
            took, began = self.pace.reading() - began, self.pace.reading()
            if not self.pace.has(took, waits=True):
                break
        self.strip, self._curve = before
        return None

    def _runs_on(self, start: ReferenceState, report: DeformReport) -> bool:
        """Whether the robot moves so fast that a stop costs time, and has far to go on a strip that is free."""
        fast = fastest_drive(self.limits, start.v) > _SLOW_SHARE * float(self.limits.drive_speed.max(initial=1.0))
        if not fast or not self.timer.far(start, report.strip.coordinates[-1]):
            return False
        rows = report.strip.coordinates
        way = np.sqrt(self.deformer.spacing_weight) * self.robot.space.difference(rows[:-1], rows[1:])
        ahead = np.cumsum(np.linalg.norm(way, axis=1)) < _FREE_AHEAD
        return bool(_proven(report)[ahead].all())

    def _along(
        self, start: ReferenceState, active: Trajectory, outlook: Outlook, report: DeformReport, watch: PhaseClock
    ) -> PlanResult:
        """A motion along the curve onto the strip, the strip, and what follows, as far as there is any."""
        lead, onward = self._curve, self._leading_on(report.strip)
        motion = partial(self.timer.motion, start, active, outlook, report, watch, off_strip=self.off_strip, lead=lead)
        if onward is None or self._next is None:
            return motion()
        curve, rest = onward
        rows = rest if curve is None else np.vstack([curve, rest[1:]])
        return motion(onward=rows, passing=self._next[1])

    def _leading_on(self, strip: Strip) -> tuple[Array | None, Array] | None:
        """Rows of a curve from the end of the strip on, if one is needed, and of what follows; None where it ends."""
        if self._next is None:
            return None
        beyond, _ = self._next
        last = self.robot.space.difference(*strip.coordinates[-2:])
        y = self.limits.to_coordinates(last)
        y /= max(float(np.linalg.norm(y)), 1e-9)
        if self._onward is None or float(y @ self._arriving) < _SAME_DIRECTION_COSINE:
            self._arriving, weight, rows = y, self.deformer.spacing_weight, beyond.coordinates
            v = last * (
                _PASSING_SPEED / max(float((np.abs(self.limits.to_coordinates(last)) / self.limits.speed).max()), 1e-9)
            )
            curves = curves_onto(self.robot, self.limits, strip.coordinates[-1], v, rows, weight)
            curve, rest = next(curves, (None, rows))
            if curve is not None and self._keeper is not None:
                curve = self._keeper.path(curve)
            self._onward = curve, rest
        return self._onward

    def _go_on(self, active: Trajectory, begin: float) -> None:
        """Follow the next strip where the reference has passed the end of the present one by the time ``begin`` [s]."""
        since, self._looked = self._looked, begin
        if self._next is None or self._onward is None:
            return
        first = max(since, active.start_time, begin - _LOOKED_BACK)
        times = np.linspace(first, begin, max(int(np.ceil((begin - first) / _LOOKED_STEP)), 1) + 1)
        rows = active.coordinates_at(times)
        k = passed_at(self.robot, rows, self.strip.coordinates[-1], self._next[1])
        if k is None:
            return
        curve, rest = self._onward
        self._follow(Strip.from_coordinates(self.robot, rest), curve)
        self._next = self._onward = None
        self.passed = float(times[k]), rows[k]

    def refuted(self, active: Trajectory, scene: Scene, begin: float, *, anyway: bool = False) -> str:
        """Why the rest of the active trajectory is certified no longer, where a scene is not what it was certified for;
        empty where it still is.

        Args:
            active: the trajectory that is executed.
            scene: the newest scene.
            begin: time [s] from which on it could be braked.
            anyway: whether it is looked at too where the scene is what it was certified for.
        """
        surprised = self._surprised(active, scene)
        anew = self._proof is None or self._proof[1].scene is not scene  # else it was certified for this very scene
        if not (surprised or (anyway and anew)):
            return ""
        left = scene
        if self._proof is not None and self._proof[0] is active:  # what stands as it stood is proven already
            left = self._proof[1].uncovered(scene)
        certificate = self.timer.certify(active.tail(begin), self._as_proven(active, self._outlook(left)))
        if certificate.certified:
            self._proof = active, self._as_proven(active, self._outlook(scene))
            return ""
        if surprised:
            self._proof = None
        return f"the held motion is no longer certified: {certificate.broken}"

    def _brake(
        self, start: ReferenceState, active: Trajectory, outlook: Outlook, report: DeformReport, watch: PhaseClock
    ) -> PlanResult | None:
        """The active trajectory braked, where the scene is not what it was certified for, and it is certified no
        longer; else None."""
        reason = self.refuted(active, outlook.scene, start.time)
        watch.mark("motion certificate")
        if not reason:
            return None
        braked = self.timer.hard.brake(active, start.time)
        if braked.end_time >= active.end_time - 0.01:  # it brakes already: look for a way on
            return None
        return PlanResult(PlanOutcome.BRAKE, braked, None, reason, report, 0.0, watch.phases)

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
        certificate = self.timer.certify(rest, self._as_proven(active, outlook))
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

    def _as_proven(self, active: Trajectory, outlook: Outlook) -> Outlook:
        """The outlook with the margin that the active trajectory was proven with, where that is less: it led from a
        place nearer to something than the margin (:meth:`_nearer`), and still does."""
        if self._proof is None or self._proof[0] is not active:
            return outlook
        margin = min(self._proof[1].margins.margin, outlook.margins.margin)
        return replace(outlook, margins=replace(outlook.margins, margin=margin))

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

    def _deform(
        self, now: float, outlook: Outlook, start: ReferenceState, watch: PhaseClock, prepared: bool
    ) -> DeformReport:
        """One tick of the strip from the start state on; several where it has just lost its certificate; none where it
        is ``prepared``.

        What no sensor has seen does not push the strip, and is not in its certificate: it will be seen before the robot
        is there, or end the motions, which are certified among all that is in the scene.
        """
        params, scene = self.params, outlook.scene.seen
        expected = outlook.expected(params.horizon + now - scene.time)
        moving = bool(np.abs(start.v).max(initial=0.0) > 1e-6)
        space, weight, strip = self.robot.space, self.deformer.spacing_weight, self.strip
        regained = None
        if self._curve is not None:
            self._curve, _ = trim_passed(space, self._curve, start.coordinates, weight, moving=moving)
            left = np.sqrt(weight) * space.difference(start.coordinates, self._curve[-1])
            if len(self._curve) == 2 and float(np.linalg.norm(left)) < _CURVE_ENDS:
                self._curve = None
            elif not moving:  # at rest it can turn, and goes straight to the strip
                self._curve, self.off_strip = None, True
        if self._curve is None:
            ahead = reconnect if self.off_strip else trim_passed
            coordinates, source = ahead(space, strip.coordinates, start.coordinates, weight, moving=moving)
            if self.off_strip and self._keeper is not None:
                last = int(np.count_nonzero(source < 0)) + 1
                coordinates = np.vstack([self._keeper.path(coordinates[:last]), coordinates[last:]])
            regained = None if prepared else self._regained(coordinates)
            strip = self.deformer.carry(strip, coordinates, source)
        prediction = None
        if len(expected):
            prediction = partial(self.arrival.prediction, expected, start.time - scene.time)
        watch.mark("strip")
        self._ticks += not prepared
        self._stepped = False
        before, last = self.report, self._last
        waits = last is not None and last.outcome in (PlanOutcome.NONE, PlanOutcome.BRAKE)
        stuck = self._broken > BROKEN_STEPS
        every = _STUCK_EVERY if stuck else 1 if prediction is None else 2
        if before is not None and self._kept:
            self._kept -= 1
            self.strip, self.report = strip, replace(before, strip=strip)
            return self.report
        if before is not None and prepared:
            self.strip, self.report = strip, replace(before, strip=strip)
            return self.report
        if before is not None and waits and scene.names == self._names and self._ticks % every:
            report = replace(before, strip=strip)  # only the motion is planned again
        else:
            began = self.pace.reading()
            maintained = self._ticks % params.maintain_every == 0 and not stuck
            deform = partial(self.deformer.step, scene=scene, prediction=prediction, nodes=maintained, retry=False)
            report = deform(strip if regained is None else regained)
            if regained is not None and not report.certified:
                report = deform(strip)
            self._step_took, self._stepped = self.pace.reading() - began, True
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


def _proven(report: DeformReport) -> Mask:
    """(N−1,) segments of the strip of a report that are certified; of the nodes that the robot has passed since it was
    certified the segments are gone, and those of new ones are not certified."""
    known, count = report.certificate.segments, len(report.strip) - 1
    return np.concatenate([np.zeros(max(count - len(known), 0), dtype=bool), known[max(len(known) - count, 0) :]])
