"""Supervisor: owner of the active trajectory, which is certified and ends at rest."""

from __future__ import annotations

import logging

import numpy as np

from elastic_strips.collision import Certificate
from elastic_strips.trajectory import ReferenceState, Trajectory

from .interfaces import Event, RunState

_log = logging.getLogger(__name__)
_NOTHING_NEWER = "its motion had ended before the next one was planned"
_EVENT_REPEAT_TIME = 2.0  # [s] an event is not written down again within this time
_LARGEST_JUMP = 2e-3  # [m or rad] largest one from the active trajectory to a new one; ten times that in speed
_SPEED_ROUNDING = 0.02  # [m/s, rad/s] by rounding
_WORTHLESS_GAIN_OF_TIME = 0.01
"""A motion that comes to rest less than this [s] earlier is not worth taking."""


class RunLog:
    """Workspace: the robot's state, and the events so far.

    Attributes:
        state, reason: state of the robot, and why.
        events: in order of time.
        stops: (time [s], reason) of every stop short of the goal.
    """

    def __init__(self) -> None:
        self.state: RunState = RunState.STOPPED
        self.reason: str = "not started"
        self.events: list[Event] = []
        self.stops: list[tuple[float, str]] = []


class Supervisor(RunLog):
    """Workspace: owner of the active trajectory, the one that is executed.

    There always is one, and it ends at rest. A new motion replaces it only if it is certified, not late, and continues
    it; or if it is the active trajectory, braked. On any failure the active one is driven to its end.

    Args:
        resting: first trajectory, at rest.
        keep: the newest events and stops that are kept at least; all where None.

    Attributes:
        active: the trajectory that is executed.
        at_goal: whether the active trajectory ends at the goal.
        state, reason, events, stops: as for :class:`RunLog`.
    """

    def __init__(self, resting: Trajectory, *, keep: int | None = None) -> None:
        super().__init__()
        self.reset(resting)
        self._keep = keep
        self._rejection = self._holding = ""
        self._asked: tuple[float, Trajectory, ReferenceState] | None = None
        self.at_goal: bool = False

    def reset(self, resting: Trajectory) -> None:
        """At rest, move the active trajectory to the robot's estimated configuration.

        Args:
            resting: trajectory at rest there.
        """
        self.active: Trajectory = resting
        self._until = [resting]  # motions up to the active one, which is the last

    def restart(self, reason: str, now: float) -> None:
        """The active trajectory ends at no goal any more; at rest, ``reason`` is that of the state at the time ``now``
        [s]."""
        self.at_goal = False
        if self.at_rest(now):
            self._enter(RunState.STOPPED, reason, now)

    def log(self, time: float, kind: str, text: str) -> None:
        """Write down an event at ``time`` [s], unless it equals the last one of its kind, or one of a moment ago."""
        last = True
        for event in reversed(self.events):
            if event.kind == kind:
                if event.reason == text and (last or time - event.time < _EVENT_REPEAT_TIME):
                    return
                last = False
            if not last and time - event.time >= _EVENT_REPEAT_TIME:
                break
        self.events.append(Event(time, kind, text))
        if self._keep is not None:
            for old in (self.events, self.stops):
                if len(old) > 2 * self._keep:
                    del old[: -self._keep]
        _log.info("%.3f s: %s: %s", time, kind, text)

    def submit(self, motion: Trajectory, certificate: Certificate, now: float, *, at_goal: bool = False) -> bool:
        """Make a motion the active one if it is certified, not late, and continues the active trajectory.

        Args:
            motion: starts at a time after ``now``.
            certificate: certificate of this motion.
            now: time [s].
            at_goal: whether its end is the goal.

        Returns:
            Whether it was taken; otherwise it is rejected as by :meth:`reject`.
        """
        reason = self._fault(motion, now)
        if len(certificate.segments) != len(motion):  # its steps, and until it has come to rest
            reason = f"the certificate is of {len(certificate.segments)} steps, the new motion has {len(motion)}"
        elif not certificate.certified:
            reason = f"the new motion is not certified: {certificate.broken}"
        if reason:
            self.reject(reason, now)
            return False
        self._take(motion, now)
        self.at_goal = at_goal
        self._rejection = self._holding = ""
        self._enter(RunState.MOVING, "certified motion", now)
        return True

    def brake(self, motion: Trajectory, reason: str, now: float) -> bool:
        """Make a motion the active one that comes to rest earlier on the same path, as that is no longer certified.

        It needs no certificate: on the same path an earlier stop is never less safe.

        Args:
            motion: the active trajectory, braked from a time after ``now`` on.
            reason: why it brakes.
            now: time [s].

        Returns:
            Whether it was taken; it is not if it does not continue the active trajectory, or stops no earlier.
        """
        if self._fault(motion, now) or motion.end_time > self.active.end_time - _WORTHLESS_GAIN_OF_TIME:
            self.reject(reason, now)
            return False
        self._take(motion, now)
        self.at_goal, self._rejection = False, reason
        self.log(now, "braked", reason)
        self._enter(RunState.BRAKING, reason, now)
        return True

    def reject(self, reason: str, now: float) -> None:
        """Note that there is no new motion, and why; the active trajectory goes on to its end."""
        self._rejection = reason
        self.log(now, "refused", reason)
        if self.state is RunState.STOPPED:
            self.reason = reason
            if self.stops and self.stops[-1][1] == _NOTHING_NEWER:  # it ended between two ticks
                self.stops[-1] = (self.stops[-1][0], reason)

    def stand(self, reason: str) -> None:
        """Note why the robot stands, and will until somebody lets it go on, whatever else happens meanwhile."""
        if self.state is RunState.STOPPED:
            self.reason = reason

    def hold(self, reason: str) -> None:
        """Note that the active trajectory is still certified, and why the robot will stop at its end."""
        self._rejection, self._holding = "", reason

    def reference(self, t: float) -> ReferenceState:
        """State to follow at time ``t`` [s]: of the active trajectory once it has begun, until then of the previous."""
        motion = self._until[self._executed(t)]
        if self._asked is None or self._asked[0] != t or self._asked[1] is not motion:  # several times in a period
            self._asked = t, motion, motion.at(t)
        return self._asked[2]

    def at_rest(self, t: float) -> bool:
        """Whether the active trajectory has ended by time ``t`` [s]."""
        return t >= self.active.end_time

    def update(self, t: float) -> RunState:
        """Update the state to time ``t`` [s], and return it."""
        if self.at_rest(t):
            if self.at_goal:
                self._enter(RunState.REACHED, "at rest at the goal", t)
            elif self.state is not RunState.STOPPED:
                reason = self._rejection or self._holding or _NOTHING_NEWER
                self.stops.append((t, reason))
                self._enter(RunState.STOPPED, reason, t)
        elif self._rejection and self.state is RunState.MOVING:
            self._enter(RunState.BRAKING, self._rejection, t)
        return self.state

    def _take(self, motion: Trajectory, now: float) -> None:
        self.active = motion
        self._until = [*self._until[self._executed(now) :], motion]

    def _executed(self, t: float) -> int:
        """Index of the motion that is executed at a time [s]."""
        begun = [k for k, motion in enumerate(self._until) if motion.start_time <= t + 1e-9]
        return begun[-1] if begun else 0

    def _fault(self, motion: Trajectory, now: float) -> str:
        """Why a motion cannot follow the active one; empty where it can."""
        if not motion.at_rest_at_end:
            return "the new motion does not end at rest"
        if motion.start_time < now - 1e-9:
            return f"late tick: the new motion was to begin {now - motion.start_time:.3f} s ago"
        space, limits = motion.robot.space, motion.limits
        speeds = np.abs(np.hstack([limits.to_drive(motion.v[:, : space.base_nv]), motion.v[:, space.base_nv :]]))
        over = float((speeds - np.concatenate([limits.drive_speed, limits.joint_speed])).max(initial=0.0))
        if over > _SPEED_ROUNDING:
            return f"the new motion is {over:.3f} m/s or rad/s faster than the motors"
        state = self.active.at(motion.start_time)
        jump = np.abs(space.difference(state.coordinates, motion.coordinates[0])).max(initial=0.0)
        if jump > _LARGEST_JUMP:
            return f"the new motion begins {jump:.4f} m or rad beside the held one"
        drive = limits.to_drive(np.stack([state.v, motion.v[0]])[:, : space.base_nv])
        change = max(
            float(np.abs(np.diff(drive, axis=0)).max(initial=0.0)),
            float(np.abs(state.v - motion.v[0])[space.base_nv :].max(initial=0.0)),
        )
        if change > 10.0 * _LARGEST_JUMP:
            return f"the new motion begins with a jump in speed of {change:.3f} m/s or rad/s"
        return ""

    def _enter(self, state: RunState, reason: str, now: float) -> None:
        if state is not self.state:
            self.log(now, "state", f"{state.label}: {reason}")
        self.state: RunState = state
        self.reason: str = reason
