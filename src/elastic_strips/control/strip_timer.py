"""Strip timer: the fastest certified motion along a strip, from a given state on."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision import Certificate
from elastic_strips.collision.certificate import LEFT_PATH, BrokenSegment
from elastic_strips.robot import RobotModel
from elastic_strips.strip.followed import FollowedPath
from elastic_strips.strip.report import DeformReport
from elastic_strips.strip.workspace import PhaseClock
from elastic_strips.trajectory import (
    MotionLimits,
    ReferenceState,
    Retimer,
    RetimingError,
    Trajectory,
    TrajectoryCertifier,
)
from elastic_strips.trajectory.trajectory import joined

from .itinerary import passed_at
from .joining import steered
from .keeping import ConstraintKeeper
from .pace import Pace
from .params import DriveParams, Tolerance
from .prediction import Outlook
from .progress import trim_passed

_TAKEN_OVER_SPACING = 0.04
"""Spacing [m] of nodes that are taken over from the active trajectory."""
_SHORTEST_MOTION = 1e-3
"""A motion leads nowhere if no coordinate [m or rad] ends further than this from its beginning."""
_LONGEST_TURN = 4.0  # [s] for which the robot is turned towards a strip; then it stops
_NEAR_END = 0.3
"""So near [m] to the end, beyond what it needs to brake, a robot stops and turns at rest."""
_FOLLOWED_SHARES = (0.5, 1.0)
"""Parts of the active trajectory that are followed first, where the strip bends too sharply."""
_BEGINNINGS = (1.6, 0.8)
"""Durations [s], about, to which a motion from rest is cut short where something moves near the rest of it."""


class PlanOutcome(Enum):
    """Decision of a planning tick on the active trajectory.

    ``NONE``: no certified motion was found; the active trajectory goes on to its end. ``UNCHANGED``: it is still
    certified, and stays. ``FOLLOW``: a certified motion along the strip replaces it. ``ARRIVE``: one that ends at the
    goal. ``JOIN``: one that turns towards the strip, from a velocity that points away from it. ``EVADE``: one that
    leaves the strip, to avoid moving obstacles. ``BRAKE``: it is no longer certified, as the
    scene is not what its certificate allowed for; the robot brakes on its path.
    """

    NONE = "none"
    UNCHANGED = "unchanged"
    FOLLOW = "follow"
    ARRIVE = "arrive"
    JOIN = "join"
    EVADE = "evade"
    BRAKE = "brake"


@dataclass(frozen=True, slots=True, eq=False)
class PlanResult:
    """Result of a planning tick.

    Attributes:
        outcome: decision on the active trajectory.
        motion, certificate: the certified motion (``UNCHANGED``: the rest of the active trajectory; ``BRAKE``: the
            active trajectory, braked, which needs no certificate), or the last one that was tried; None without one.
        reason: why there is no certified motion, or "".
        report: report of the strip's tick.
        speed: fraction of full speed that the motion was planned for.
        timings: seconds by phase.
        late: time [s] from its tick until it is ready.
        lead: (L, nv) rows that lead from the start onto the strip; None where that begins there.
    """

    outcome: PlanOutcome
    motion: Trajectory | None
    certificate: Certificate | None
    reason: str
    report: DeformReport
    speed: float
    timings: dict[str, float] = field(default_factory=dict)
    late: float = 0.0
    lead: Array | None = None

    @property
    def way(self) -> Array:
        """(K, nv) rows from the start on along the strip."""
        rows = self.report.strip.coordinates
        return rows if self.lead is None else np.vstack([self.lead, rows[1:]])

    @property
    def accepted(self) -> bool:
        """Whether it has a new certified motion."""
        return self.outcome in (PlanOutcome.FOLLOW, PlanOutcome.ARRIVE, PlanOutcome.JOIN, PlanOutcome.EVADE)


class StripTimer:
    """Workspace: times motions along strips, and certifies them.

    Args:
        robot: the robot.
        limits: limits of its motors.
        params: parameters of the drive.
        spacing_weight: (nv,) metric of the strip's node spacing.
        pace: how long planning takes; where None, as long as ``params`` say.

    Attributes:
        path: path that certified motions keep to, with the clearance that is kept from obstacles; None where there is
            none.
    """

    easy: Retimer
    hard: Retimer

    def __init__(
        self,
        robot: RobotModel,
        limits: MotionLimits,
        params: DriveParams,
        spacing_weight: Array,
        pace: Pace | None = None,
    ) -> None:
        self.robot: RobotModel = robot
        self.limits: MotionLimits = limits
        self.params: DriveParams = params
        self.spacing_weight: Array = spacing_weight
        # less than the motors' limits: reserves for when the path changes
        easy = limits.scaled(speed=1.0, acceleration=params.acceleration_scale)
        self.easy, self.hard = (
            Retimer(robot, each, dt=params.sample_dt, turn_speed=params.turn_speed) for each in (easy, limits)
        )
        self.certifier: TrajectoryCertifier = TrajectoryCertifier(
            robot,
            clearance=params.clearance,
            self_clearance=params.deform.self_clearance,
            settle_time=params.settle_time,
        )
        self.pace: Pace = Pace(params, None) if pace is None else pace
        self._speeds = params.speeds  # that are tried one after the other
        self.path: FollowedPath | None = None
        self._failures = 0
        self._turning = 0  # motions in a row that turned towards the strip
        self._attempt_took = 0.0  # [s] the last time

    def slow_down(self, part: float) -> None:
        """Plan motions with a part of the speeds of the parameters from now on."""
        self._speeds = tuple(part * speed for speed in self.params.speeds)

    def motion(
        self,
        start: ReferenceState,
        active: Trajectory,
        outlook: Outlook,
        report: DeformReport,
        watch: PhaseClock,
        *,
        off_strip: bool = False,
        lead: Array | None = None,
        onward: Array | None = None,
        passing: Tolerance | None = None,
    ) -> PlanResult:
        """The fastest certified motion along the strip of a report, or the reason why there is none.

        Args:
            start: first state of the motion, one of ``active``.
            active: the trajectory that is executed.
            outlook: of the tick.
            report: of the strip's tick.
            watch: measures the phases.
            off_strip: whether the robot has left the strip, so that the active trajectory does not lead along it.
            lead: (L, nv) rows that lead from the start onto the strip; None where that begins there.
            onward: (K, nv) rows from the end of the strip on, along which a motion may go on that passes the end within
                ``passing``; None where the robot stops there.
            passing: see ``onward``.
        """
        coordinates = report.strip.coordinates
        if lead is not None:
            coordinates = np.vstack([lead, coordinates[1:]])
        if onward is not None and passing is not None:
            passes = self._passing(start, active, outlook, coordinates, watch, off_strip, onward, passing)
            if passes is not None:
                self._failures = self._turning = 0
                speed = self._speeds[0]
                return PlanResult(PlanOutcome.FOLLOW, *passes, "", report, speed, watch.phases, lead=lead)
        speed_now = fastest_drive(self.limits, start.v)
        motion: Trajectory | None = None
        certificate: Certificate | None = None
        reason, speed = "", 0.0
        last = np.inf

        def result(outcome: PlanOutcome) -> PlanResult:
            return PlanResult(outcome, motion, certificate, reason, report, speed, watch.phases, lead=lead)

        speeds = self._speeds
        if self._failures:  # while it waits or brakes: one a tick, the slowest first
            speeds = (speeds[-1 - (self._failures - 1) % len(speeds)],)
        self._failures += 1
        for speed in speeds:
            distance = self._distance(speed_now, speed)
            if distance >= last:
                break  # it would not be slower: the robot has not yet gathered speed
            if last < np.inf and not self.pace.has(self._attempt_took, waits=True):
                break  # the next tick tries the slowest first
            last, began = distance, self.pace.reading()
            motion, reason = self._timed(coordinates, start, active, distance, speed, off_strip)
            watch.mark("retiming")
            if motion is None:
                if start.v.any():
                    break  # what cannot stop in time at this speed does not at a lower one
                continue
            certificate = self.certify(motion, outlook)
            self._attempt_took = self.pace.reading() - began
            watch.mark("motion certificate")
            if certificate.certified:
                arrives = self._ends_at(motion, coordinates[-1])
                if not (arrives or start.v.any()) and self._stays(motion):
                    reason = "the motion along the strip leads nowhere"
                    return result(PlanOutcome.NONE)
                self._failures, self._turning, reason = 0, 0, ""
                return result(PlanOutcome.ARRIVE if arrives else PlanOutcome.FOLLOW)
            reason = f"motion at {speed:g} of full speed not certified: {certificate.broken}"
            begins = None if start.v.any() else self.beginning(motion, certificate, outlook)
            watch.mark("motion certificate")
            if begins is not None:
                motion, certificate = begins
                self._failures, self._turning, reason = 0, 0, ""
                return result(PlanOutcome.FOLLOW)
        return result(PlanOutcome.NONE)

    def beginning(
        self, motion: Trajectory, certificate: Certificate, outlook: Outlook
    ) -> tuple[Trajectory, Certificate] | None:
        """A certified beginning of a motion from rest that was not certified because of something that moves; None
        where there is none.

        Slower motions are no shorter, and the longer one lasts, the more of the space about something that moves may be
        taken by then: beside people a robot goes by short motions, or not at all.

        Args:
            motion: the motion, from rest to rest.
            certificate: of it.
            outlook: of the tick.
        """
        broken = certificate.broken
        if broken is None or not outlook.scene.moves(broken.obstacle):
            return None
        for lasting in _BEGINNINGS:
            if lasting > 0.8 * motion.duration:
                continue
            at = motion.start_time + 0.5 * lasting  # as long to gather speed as to lose it
            i = int(np.searchsorted(motion.time, at, side="right"))
            rows = {name: getattr(motion, name)[: i + 1] for name in ("time", "coordinates", "v", "a")}
            short = joined([replace(motion, **rows), self.hard.brake(motion, float(motion.time[i]))])
            if self._stays(short):
                continue
            proof = self.certify(short, outlook)
            if proof.certified:
                return short, proof
        return None

    def joining(
        self,
        failed: PlanResult,
        start: ReferenceState,
        outlook: Outlook,
        watch: PhaseClock,
        keeper: ConstraintKeeper | None = None,
    ) -> PlanResult:
        """A certified motion that turns towards the strip; the failed result where there is none.

        Args:
            failed: result of :meth:`motion`, which found none along the strip.
            start: first state of the motion.
            outlook: of the tick.
            watch: measures the phases.
            keeper: of the strip's constraint; None where it has none.
        """
        if self._turning * self.pace.every * self.params.control_dt > _LONGEST_TURN:
            return failed
        for speed in self._speeds:
            motion = steered(
                self.robot,
                self.limits,
                start,
                failed.way,
                self.spacing_weight,
                hold=self.held,
                dt=self.params.sample_dt,
                speed=speed,
            )
            watch.mark("retiming")
            if motion is None:
                break
            several = (motion,) if keeper is None else keeper.motions(motion, outlook.scene, self.held, failed.way)
            proofs = ((each, self.certify(each, outlook)) for each in several)
            taken, certificate = next(((m, proof) for m, proof in proofs if proof.certified), (motion, None))
            watch.mark("motion certificate")
            if certificate is not None:
                self._turning, self._failures = self._turning + 1, 0
                return replace(failed, outcome=PlanOutcome.JOIN, motion=taken, certificate=certificate, speed=speed)
        return failed

    def far(self, start: ReferenceState, end: Array) -> bool:
        """Whether a robot in motion is so far from a coordinate row (nv,) that it need not stop for it yet."""
        way = np.sqrt(self.spacing_weight) * self.robot.space.difference(start.coordinates, end)
        apart = float(np.linalg.norm(way[:2] if self.limits.drive_dim else way))
        return apart > _NEAR_END + self._distance(fastest_drive(self.limits, start.v), 0.0)

    def _passing(
        self,
        start: ReferenceState,
        active: Trajectory,
        outlook: Outlook,
        coordinates: Array,
        watch: PhaseClock,
        off_strip: bool,
        onward: Array,
        within: Tolerance,
    ) -> tuple[Trajectory, Certificate] | None:
        """A certified motion at full speed that passes the end of the strip and goes on; None where there is none, or
        none gets so far."""
        speed = self._speeds[0]
        distance = self._distance(fastest_drive(self.limits, start.v), speed)
        way = np.sqrt(self.spacing_weight) * self.robot.space.difference(coordinates[:-1], coordinates[1:])
        if float(np.linalg.norm(way, axis=1).sum()) > 2.0 * distance:
            return None
        nodes = np.vstack([coordinates, onward[1:]])
        motion, _ = self._timed(nodes, start, active, distance, speed, off_strip)
        watch.mark("retiming")
        if motion is None:
            return None
        beyond = self.robot.space.difference(coordinates[-1], motion.coordinates[-1])
        if float(np.abs(beyond).max(initial=0.0)) < _SHORTEST_MOTION:  # it has to stop there
            return None
        if passed_at(self.robot, motion.coordinates, coordinates[-1], within) is None:
            return None
        certificate = self.certify(motion, outlook)
        watch.mark("motion certificate")
        return (motion, certificate) if certificate.certified else None

    @property
    def held(self) -> float:
        """Time [s] for which a motion off the strip is held at least: until after the next one."""
        return 2 * self.pace.every * self.params.control_dt

    def certify(self, motion: Trajectory, outlook: Outlook) -> Certificate:
        """Certify a motion from its first sample until it has come to rest, and that it keeps to the path that is
        followed, if there is one."""
        margins = outlook.margins
        certificate = self.certifier.certify(motion, outlook.scene, outlook.possible, clearance=margins.clearance)
        if self.path is None or not certificate.certified:
            return certificate
        beyond = self.path.bound(motion.coordinates[:, :3]) + margins.clearance - self.path.within
        worst = int(beyond.argmax())
        if beyond[worst] <= 0.0:
            return certificate
        segments = certificate.segments.copy()
        segments[: len(beyond)] &= beyond <= 0.0
        broken = BrokenSegment(worst, "base", "the path", -float(beyond[worst]), LEFT_PATH, True)
        return replace(certificate, segments=segments, broken=broken)

    def _timed(
        self,
        coordinates: Array,
        start: ReferenceState,
        active: Trajectory,
        distance: float,
        speed: float,
        off_strip: bool,
    ) -> tuple[Trajectory | None, str]:
        """A motion along the nodes, with reserves of acceleration where possible; or the reason why there is none.

        Where the strip bends too sharply for the robot's speed, the motion first follows the active trajectory.
        """
        reason = ""
        attempts = [(0.0, self.easy), (0.0, self.hard)]
        if self._failures > 1 and start.v.any():  # what all that the motors give and other ways failed with just now
            attempts = attempts[1:]
        elif not off_strip:
            attempts += [(share, self.hard) for share in _FOLLOWED_SHARES]
        for share, retimer in attempts:
            began = self.pace.reading()
            nodes = coordinates if share == 0.0 else self._continued(coordinates, start, active, share)
            try:
                part = speed * self.params.speed_scale if retimer is self.easy else speed
                motion = retimer.horizon(
                    nodes,
                    start.v,
                    a_start=start.a,
                    distance=distance,
                    start_time=start.time,
                    speed=part,
                    insist=retimer is self.hard,
                )
                return motion, ""
            except RetimingError as error:
                reason = reason or f"no motion along the strip: {error}"
            if not start.v.any() or not self.pace.has(self.pace.reading() - began, waits=True):
                break
        return None, reason

    def _continued(self, coordinates: Array, start: ReferenceState, active: Trajectory, share: float) -> Array:
        """Nodes that follow the active trajectory for a share of what is left of it, and then the strip."""
        space, weight = self.robot.space, self.spacing_weight
        ahead = active.coordinates[np.searchsorted(active.time, start.time, side="right") :]
        rows = [start.coordinates]
        for row in ahead[: int(np.ceil(share * len(ahead)))]:
            v = space.difference(rows[-1], row)
            if float((v * v) @ weight) > _TAKEN_OVER_SPACING**2:
                rows.append(row)
        rest, _ = trim_passed(space, coordinates, rows[-1], weight, moving=False)
        return np.vstack([np.array(rows), rest[1:]])

    def _distance(self, speed_now: float, speed: float) -> float:
        """Path length that a motion has to cover: until after the next one, at its speed, and to stop."""
        params, limits = self.params, self.limits
        top = float(limits.drive_speed.max(initial=0.0)) or 1.0
        change = float(limits.drive_acceleration.min(initial=np.inf)) if limits.drive_dim else 4.0
        change *= params.acceleration_scale
        period = ((params.motion_every + 1) * self.pace.every + self.pace.periods) * params.control_dt
        v = min(speed_now + change * period, max(speed * top, speed_now))
        return v * period + v * v / (2.0 * change) + 0.02

    def _stays(self, motion: Trajectory) -> bool:
        """Whether a motion ends where it begins; there would be another like it for ever."""
        way = self.robot.space.difference(motion.coordinates[0], motion.coordinates[-1])
        return float(np.abs(way).max(initial=0.0)) < _SHORTEST_MOTION

    def _ends_at(self, motion: Trajectory, goal: Array) -> bool:
        v = self.robot.space.difference(motion.coordinates[-1], goal)
        b = self.robot.space.base_nv
        apart = float(np.hypot(*v[:2])) if b else 0.0
        return apart <= 0.5 * self.params.goal_position and bool(
            np.abs(v[2 if b else 0 :]).max(initial=0.0) <= 0.5 * self.params.goal_angle
        )


def fastest_drive(limits: MotionLimits, v: Array) -> float:
    """Speed [m/s] of the fastest drive coordinate, or of the joints where those are faster by their own limits."""
    base = len(v) - len(limits.joint_speed)
    drive = np.abs(limits.to_drive(v[:base])).max(initial=0.0)
    share = (np.abs(v[base:]) / limits.joint_speed).max(initial=0.0)
    return float(max(drive, share * limits.drive_speed.max(initial=1.0)))
