"""Retreat: a robot that stands and touches something, or is too near to plan, backs off along the way that it came."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from itertools import islice, product

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ElasticStripsError
from elastic_strips.scene import UNSEEN_LAYER, Scene
from elastic_strips.scene.obstacle import LOST_LAYER, STOOD_LAYER
from elastic_strips.trajectory import Trajectory

from .executor import ExecutorLink
from .local_planner import LocalPlanner

_KEPT_ROWS, _ROW_SPACING = 800, 0.01
"""References that are kept, and their distance at least [m or rad]."""
_TOUCH_WAIT = 1.0  # [s] at rest, after which the robot backs off; also after it has seen nothing for a while
_SEES_NOTHING = 0.5  # [s] as long as this without a scene to plan with
_UNKNOWN_WAIT = 2.0  # [s] the same, from something that nobody has seen: who came goes on, and what stands does not
_BLIND_WAIT = 4.0  # [s] the same, of a robot that does not see where it backs off to: most others have gone by then
_RETREAT, _RETREAT_SPEED = 0.2, 0.2
"""How far it goes at once [m in the metric of motions], and with which part of its speed."""
_PARTS = (1.0, 0.4)  # of that, the second where nothing leads so far
_ASIDE_TURN, _ASIDE_STEPS = 0.5, 20
"""How far [rad] it turns away at once from what stands too near, and in how many steps it is looked whether it can."""
_MORE_ROOM = 0.01  # [m] by which it stands less near afterwards, at least: else it would go to and fro
_LOOK_EVERY = 0.2  # [s] whether it stands too near
_NEXT_ROUND = 0.5  # [s] after no way led away, until they are tried anew
_MOST_TOUCHES, _TOUCHES_TIME = 3, 60.0
"""After so many touches within this time [s] it stands. What came to it while it stood counts where it moved away."""


class Retreat:
    """Workspace: the way that a robot came, and when it backs off along it.

    Args:
        executor: takes the motions.
        planner: certifies them.
    """

    def __init__(self, executor: ExecutorLink, planner: LocalPlanner) -> None:
        self._executor, self._planner = executor, planner
        self._leaving: Trajectory | None = None  # the motion along which it backs off
        self._came: deque[Array] = deque(maxlen=_KEPT_ROWS)
        self._touches: deque[float] = deque(maxlen=_MOST_TOUCHES)  # [s] when it ran into something, or left what came
        self._since: float | None = None  # [s] when it stood, touching something
        self._backs = False  # whether it backs off
        self._free = True  # whether it has touched nothing since
        self._ran = False  # whether it moved when it began to touch something
        self._felt = False  # whether it touched something when asked last
        self._asked = self._sees_since = -np.inf  # [s] the last time, and the first one without a gap
        self._near, self._room = "", np.inf  # what it stood too near when it looked, how near [m] …
        self._looks_at = 0.0  # … and when [s] it looks again
        self._tried, self._refused = 0, ""  # ways, one a tick, and why the first of them was refused
        self._next_round = 0.0  # [s] when they are tried anew

    def note(self, row: Array) -> None:
        """Take note of a reference (nv,) that the robot followed on its way."""
        if self._backs:
            return
        if not self._came or float(np.abs(row - self._came[-1]).max(initial=0.0)) > _ROW_SPACING:
            self._came.append(row.copy())

    def backs_off(self, t: float, begin: float, scene: Scene, *, stuck: bool) -> bool:
        """Whether the robot backs off, tries to, or touches something: nothing else is planned then.

        Where it has stood so for a while, or so near to something that no motion is certified, it backs off along the
        way that it came, proven to be free of all else. From what is not in the scene it does so only where it ran into
        that itself, and later: who ran into the robot may be on that way.

        Args:
            t: time [s].
            begin: time [s] at which a motion that is planned now begins.
            scene: the obstacles.
            stuck: whether it is to go on to a goal, and found no motion.
        """
        executor, planner = self._executor, self._planner
        if t - self._asked > _SEES_NOTHING:  # who stood before its sensors may be on their way
            self._sees_since = t
        self._asked = t
        stands, felt = executor.at_rest(t), bool(executor.contact)
        if felt and not self._felt and not stands:
            self._ran = True  # also on its way from something else, which counts already
        self._felt = felt
        if executor.active is self._leaving and not stands:
            certificate = planner.certify_leaving(executor.active.tail(begin), scene)
            if not certificate.certified:
                executor.brake(f"the way back is not free: {certificate.broken}")
            return True
        near = executor.contact
        if near or not (stands and stuck):
            self._near, self._room, self._looks_at = "", np.inf, 0.0
        elif t >= self._looks_at:
            self._near, self._room = planner.cramped(executor.active.at(begin), scene)
            self._looks_at = t + _LOOK_EVERY
        near = near or self._near
        unknown = bool(executor.contact) and stands and not planner.knows_touched(executor.active.at(begin), scene)
        blind = felt and not planner.params.backward
        due = self.due(t, touching=bool(near), stands=stands, unknown=unknown, blind=blind) and executor.settled
        due = due and t - self._sees_since >= _TOUCH_WAIT
        if not near:
            self._tried, self._refused, self._next_round = 0, "", 0.0
        if due and t >= self._next_round:
            return self._tries_a_way(t, begin, scene, near)
        return felt

    def _tries_a_way(self, t: float, begin: float, scene: Scene, near: str) -> bool:
        """Back off along the next of the ways, if it is free. Whether there was one, free or not; after the last they
        are left alone for a while. To look at them all takes several times as long as a planning tick may."""
        executor, planner = self._executor, self._planner
        ways = product(_PARTS, enumerate(self._ways(executor.active.coordinates[-1], scene, touching=self._felt)))
        for part, (k, way) in islice(ways, self._tried, None):
            self._tried += 1
            motion = self._slow(way, begin, part)
            if motion is None:
                continue
            # But for the way that it came, only those from whose end others can be planned, or that lead to there.
            cramped, room = planner.cramped(motion.at(motion.end_time), scene) if k > 0 else ("", np.inf)
            nearer = room < self._room + _MORE_ROOM
            certificate = None if cramped and nearer else planner.certify_leaving(motion, scene)
            if certificate is None or not certificate.certified:
                broken = certificate.broken if certificate is not None else f"where that ends, {cramped}"
                self._refused = self._refused or f"cannot back off: {broken}"
                return True
            executor.log("leaving", f"the robot moves away, along the way that it came where it can: {near}")
            proven = planner.margins.tracking_error
            executor.submit(motion, certificate, at_goal=False, proven=proven, leaving=True)
            self.went(motion)
            self._leaving = motion
            return True
        if self._refused:
            executor.log("refused", self._refused)
        self._tried, self._refused, self._next_round = 0, "", t + _NEXT_ROUND
        return self._felt

    def _ways(self, here: Array, scene: Scene, *, touching: bool) -> Iterator[Array]:
        """Rows (K, nv) of the ways that lead away, best first: the way that it came; where what stands there is only
        too near, a turn on the spot to either side, straight ahead, or straight back, unless it does not see where
        that leads, and what was not seen is no obstacle."""
        yield self.way(here)
        space = self._planner.robot.space
        if touching or not space.planar:
            return
        back = self._planner.params.backward or any(
            name.startswith(UNSEEN_LAYER) and not name.startswith((LOST_LAYER, STOOD_LAYER)) for name in scene.names
        )
        part = np.linspace(0.0, 1.0, _ASIDE_STEPS)
        for turn, ahead in ((_ASIDE_TURN, 0.0), (-_ASIDE_TURN, 0.0), (0.0, _RETREAT), (0.0, -_RETREAT))[: 3 + back]:
            rows = np.tile(here, (_ASIDE_STEPS, 1))
            rows[:, 2] += turn * part
            rows[:, :2] += np.outer(ahead * part, (np.cos(here[2]), np.sin(here[2])))
            yield rows

    def due(self, t: float, *, touching: bool, stands: bool, unknown: bool = False, blind: bool = False) -> bool:
        """Whether the robot, which touches something, known or not, or stands or not, and may see behind it or not, is
        to back off at the time ``t`` [s]."""
        if not touching:
            self._since, self._free, self._backs = None, True, False
            return False
        if self._free:
            self._free, self._ran = False, not stands
            if self._ran:
                self._touches.append(t)
        if not stands:
            self._since = None
            return False
        if self._since is None:
            self._since = t
        often = len(self._touches) == _MOST_TOUCHES and t - self._touches[0] < _TOUCHES_TIME
        wait = _BLIND_WAIT if blind else _UNKNOWN_WAIT if unknown else _TOUCH_WAIT
        return t - self._since >= wait and not often and (self._ran or not unknown)

    def motion(self, here: Array, begin: float) -> Trajectory | None:
        """A slow motion from the reference (nv,) at which the robot rests back along the way that it came; None where
        it came no way.

        Args:
            here: where it rests.
            begin: when the motion begins [s].
        """
        return self._slow(self.way(here), begin)

    def _slow(self, rows: Array, begin: float, part: float = 1.0) -> Trajectory | None:
        if len(rows) < 2:
            return None
        far = part * _RETREAT
        try:
            return self._planner.timer.easy.horizon(rows, distance=far, start_time=begin, speed=_RETREAT_SPEED)
        except ElasticStripsError:
            return None

    def way(self, here: Array) -> Array:
        """Rows (K, nv) from a reference (nv,) back along the way that the robot came, as far as that is kept."""
        rows = (row for row in reversed(self._came) if np.abs(row - here).max(initial=0.0) > _ROW_SPACING)
        return np.array([here, *rows])

    def went(self, motion: Trajectory) -> None:
        """Told that the robot backs off by a motion: the way from its end on was not free."""
        self._since, self._backs = None, True
        self._tried, self._refused = 0, ""
        if not self._ran:
            self._touches.append(motion.start_time)
        apart = [float(np.abs(row - motion.coordinates[-1]).max(initial=0.0)) for row in self._came]
        for _ in range(len(apart) - int(np.argmin(apart)) if apart else 0):
            self._came.pop()
