"""Execution room, evasion: which short motion of the base gets the robot out of the way of what comes.

A few hundred manoeuvres are rolled out some seconds ahead and compared by what they risk and by how far they get
towards the goal. That is a choice, no proof: the motion that begins the best one, and ends at rest, is driven only with
a certificate, like any other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..proximity import Forecast
from ..robot import RobotModel
from ..robot.space import Array, Mask, wrap_angle
from ..scene import Scene
from .limits import MotionLimits
from .manoeuvres import Targets, lattice, motion_to, roll_out, roll_to_rest
from .onward import fastest_drive
from .outlook import Outlook
from .params import EvasionParams
from .prediction import ArrivalTimes
from .proposal import Proposal
from .silhouette import Silhouette
from .timed_certificate import TrajectoryCertifier
from .trajectory import ReferenceState, Trajectory

_TOUCHING = 40.0
"""Cost per second of what would touch."""
_DETOUR = 1.5
"""Cost of a metre beside the strip, in metres along it."""
_TURN = 0.3
"""Cost of a heading that is off [s/rad]."""
_LONGER = (0.0, 0.2, 0.5, 0.9)
"""How much longer than necessary a manoeuvre may be followed [s], to end where nothing comes."""
_GAIN = 0.1
"""What another way has to gain [s] before a robot that is threatened, or moves, takes it."""
_PACE = 0.75
"""Part of the largest speed and acceleration that the strip is followed with, as it is foreseen."""
_STEADY = 0.15
"""What the manoeuvre that was chosen last is ahead of the others by [s]: it goes on unless another is better."""


@dataclass(frozen=True, slots=True)
class Prospect:
    """What a way to go on is expected to come to.

    Attributes:
        risk: of touching something or coming near it; 0 where nothing comes near [s].
        cost: risk, and the time that is left to the goal [s].
    """

    risk: float
    cost: float


class Evasion:
    """Workspace: compares manoeuvres among the moving obstacles of a snapshot.

    Args:
        robot: whose base moves; a fixed one has no manoeuvres.
        limits: of its motors.
        params: of the comparison.
        dt: distance of the samples of motions [s].
        hold: how long [s] a motion follows its manoeuvre at least before it brakes.
        clearance: distance [m] that certificates ask for.
    """

    def __init__(
        self, robot: RobotModel, limits: MotionLimits, params: EvasionParams, *, dt: float, hold: float,
        clearance: float,
    ) -> None:  # fmt: skip
        self.robot, self.limits, self.params = robot, limits, params
        self.dt, self.clearance = dt, clearance
        self._silhouette = Silhouette(robot)
        self._holds = hold + np.array(_LONGER)
        self._lattice: Targets | None = lattice(limits) if limits.drive_dim else None
        self._time: Array = params.step * np.arange(1, round(params.horizon / params.step) + 1, dtype=float)
        self._last: Array | None = None
        self._outlook: Outlook | None = None
        self._way = np.zeros((0, 2))
        self._rest = np.zeros(0)
        self._delay = 0.0

    def improved(
        self,
        proposal: Proposal,
        start: ReferenceState,
        held: Trajectory,
        scene: Scene,
        possible: Forecast,
        certifier: TrajectoryCertifier,
        arrival: ArrivalTimes,
    ) -> Proposal:
        """The proposal, or a certified motion off the strip where something comes or that is better than to wait.

        Args:
            proposal: along the strip.
            start: where and when the next motion begins; held: the motion that is executed.
            scene: sensed; possible: where its moving obstacles can be.
            certifier: of motions.
            arrival: times at the strip's nodes.
        """
        if not self.look(scene, possible, start, proposal.report.strip.chart):
            return proposal
        if proposal.accepted:
            rows = self._followed(proposal, start, arrival)
        else:
            motion = proposal.motion if proposal.emergency and proposal.motion is not None else held
            rows = np.array([motion.at(start.time + t).chart for t in self.time])
        plain = self.prospect(rows)
        threatened = plain.risk > self.params.calm
        broken = proposal.report.certificate.broken
        by_standing = broken is not None and broken.obstacle in scene and scene.obstacle(broken.obstacle).motion is None
        if not threatened and (proposal.accepted or by_standing):
            self._last = None
            return proposal
        gain = _GAIN if threatened or start.v.any() else self.params.gain
        for motion, _ in self.options(start, plain.cost - gain):
            certificate = certifier.certify(motion, scene, possible)
            if certificate.certified:
                return replace(
                    proposal, motion=motion, certificate=certificate, accepted=True, kept=False, at_goal=False,
                    reason="", evasive=True, emergency=False,
                )  # fmt: skip
        return proposal

    def _followed(self, proposal: Proposal, start: ReferenceState, arrival: ArrivalTimes) -> Array:
        """(T, nv) about where the robot is at :attr:`time` after the start if it follows the strip while that holds.

        Where the strip is broken the robot would have to stop: there it waits for what comes.
        """
        strip, speed, times = proposal.report.strip.chart, proposal.speed, self.time
        top = _PACE * float(self.limits.drive_speed.max(initial=1.0))
        change = _PACE * float(self.limits.drive_acceleration.min(initial=np.inf)) / top
        now = min(fastest_drive(self.limits, start.v) / top, speed)
        ramp = np.minimum(times, (speed - now) / change)
        passed = now * times + change * ramp * (times - 0.5 * ramp)
        reached = arrival(strip)
        broken = np.flatnonzero(~proposal.report.certificate.segments)
        if len(broken):
            passed = np.minimum(passed, reached[min(int(broken[0]), len(reached) - 1)])
        i = np.clip(np.searchsorted(reached, passed, side="right") - 1, 0, len(strip) - 2)
        s = np.clip((passed - reached[i]) / np.maximum(reached[i + 1] - reached[i], 1e-9), 0.0, 1.0)
        return self.robot.space.interpolate(strip[i], strip[i + 1], s)

    def look(self, scene: Scene, possible: Forecast, start: ReferenceState, strip: Array) -> bool:
        """Look around; whether anything that moves may come near within the horizon.

        Args:
            scene: sensed.
            possible: its moving obstacles, with the bounds of the errors.
            start: where the next motion begins, and when.
            strip: (M, nv) the way to the goal from there.
        """
        self._outlook = None
        if self._lattice is None or not len(possible):
            return False
        self._silhouette.update(start.chart)
        horizon = self.params.horizon
        reach = self._silhouette.reach + self.params.near + float(self.limits.drive_speed[:2].max()) * horizon
        outlook = Outlook(self._silhouette, scene, possible, start.chart[:2], reach=reach, horizon=horizon)
        if not outlook.movers:
            self._last = None
            return False
        self._outlook, self._delay = outlook, start.time - scene.time
        self._way = strip[:, :2]
        step = np.hypot(*np.diff(self._way, axis=0).T)
        self._rest = np.append(np.cumsum(step[::-1])[::-1], 0.0)
        return True

    @property
    def time(self) -> Array:
        """(T,) times [s] after the start at which prospects look at the robot."""
        return self._time

    def prospect(self, rows: Array) -> Prospect:
        """What chart rows (T, nv) at :attr:`time` after the start come to."""
        pose = rows[None, :, :3]
        risk = self._risk(pose)
        return Prospect(float(risk[0]), float(risk[0] + self._to_go(pose[:, -1])[0]))

    def options(self, start: ReferenceState, better: float) -> Iterator[tuple[Trajectory, Prospect]]:
        """Motions that begin manoeuvres whose cost is below ``better``, the best first.

        Each follows its manoeuvre for a while, and then brakes to rest where nothing can be by then, as it seems.
        """
        assert self._outlook is not None
        assert self._lattice is not None
        params, targets, last = self.params, self._lattice, self._last
        part, step = params.acceleration, params.step
        kinds = targets.different
        room = self._room(start, kinds)
        hold = room.argmax(axis=1)  # the shortest one that will do; the next tick plans anew
        targets = targets.take(np.take(room.any(axis=1), targets.kind))
        if not len(targets):
            return
        rollouts = roll_out(self.limits, start, targets, part=part, horizon=params.horizon, dt=step)
        risk = self._risk(rollouts.pose)
        cost = risk + self._to_go(rollouts.pose[:, -1])
        if last is not None:  # what was begun goes on unless another is better
            same = (np.abs(targets.first - last) < 1e-9).all(axis=1)
            cost[same] -= _STEADY
        best = np.argsort(cost, kind="stable")[: params.shortlist]
        best = best[cost[best] < better]
        aside = self._standing_risk(rollouts.pose[best])
        risk[best] += aside
        cost[best] += aside
        best = best[np.argsort(cost[best], kind="stable")]
        tried: set[int] = set()
        for i in best[cost[best] < better].tolist():
            kind = int(targets.kind[i])
            if kind in tried:
                continue
            if len(tried) >= params.tries:
                break
            tried.add(kind)
            motion = motion_to(
                self.robot,
                self.limits,
                start,
                kinds[kind],
                part=part,
                duration=float(self._holds[hold[kind]]),
                dt=self.dt,
            )
            if motion is not None:
                self._last = kinds[kind]
                yield motion, Prospect(float(risk[i]), float(cost[i]))
        self._last = None

    def _room(self, start: ReferenceState, kinds: Array) -> Mask:
        """(D, H) whether motions to targets (D, k), held for the times to choose from, seem to end well."""
        assert self._outlook is not None
        count = len(self._holds)
        hold = np.tile(self._holds, len(kinds))
        motions, rest = roll_to_rest(
            self.limits, start, np.repeat(kinds, count, axis=0), hold, part=self.params.acceleration, dt=0.1
        )
        apart = self._outlook.possible(motions.pose, self._delay + motions.time) - self.clearance
        over = motions.time > rest[:, None] + 0.25
        return ((apart > 0.0) | over).all(axis=1).reshape(-1, count)

    def _risk(self, pose: Array) -> Array:
        """(N,) cost [s] of coming near what moves: what is further off in time is less sure, and counts less."""
        assert self._outlook is not None
        params, t = self.params, self._time
        apart = self._outlook.near(pose, self._delay + t, params.lead) - self.clearance
        near = np.clip(1.0 - apart / (params.near + params.spread * t), 0.0, 1.5)
        weight = params.step * np.exp(-t / params.fade)
        return (params.care * near * near + _TOUCHING * (apart < 0.0)) @ weight

    def _standing_risk(self, pose: Array) -> Array:
        """(N,) cost [s] of touching what stands."""
        assert self._outlook is not None
        apart = self._outlook.from_standing(pose[:, 1::2])
        weight = 2.0 * self.params.step * np.exp(-self._time[1::2] / self.params.fade)
        return (_TOUCHING * (apart < self.clearance)) @ weight

    def _to_go(self, pose: Array) -> Array:
        """(N,) time [s] to the goal along the strip, from poses (N, 3): back to it, along it, and turning."""
        top = 0.8 * float(self.limits.drive_speed[:2].min())
        offset = self._way[None] - pose[:, None, :2]
        length = _DETOUR * np.sqrt(np.square(offset).sum(axis=2)) + self._rest
        node = length.argmin(axis=1)
        ahead = np.searchsorted(-self._rest, -np.maximum(self._rest[node] - 1.0, 0.0))
        ahead = np.minimum(ahead, len(self._rest) - 1)
        to = offset[np.arange(len(pose)), ahead]
        turn = np.abs(wrap_angle(np.arctan2(to[:, 1], to[:, 0]) - pose[:, 2]))
        turn = np.minimum(turn, np.pi - turn + 0.5)  # backing up is a way too
        turn = turn * np.minimum(np.hypot(to[:, 0], to[:, 1]), 1.0)  # at the goal there is none left
        return length[np.arange(len(pose)), node] / top + (_TURN * turn if self.limits.drive_dim == 2 else 0.0)
