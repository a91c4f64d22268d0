"""Vantage: a robot that stands before what no sensor has seen turns, or backs off, to see it from elsewhere.

What it has looked at in vain counts as an obstacle, so that the strip goes around it. From who has kept it from going
on for long it goes back along its way, to let them by.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision import Certificate
from elastic_strips.errors import ElasticStripsError
from elastic_strips.scene import UNSEEN_LAYER, Obstacle, Scene
from elastic_strips.scene.obstacle import LOST_LAYER
from elastic_strips.trajectory import Trajectory

from .executor import ExecutorLink
from .local_planner import LocalPlanner
from .strip_timer import PlanOutcome, PlanResult

_WAIT = 1.5  # [s] at rest, after which it goes to look from elsewhere: before that, its head may see enough
_STAYS = 10.0  # [s] within which motions that begin and are refused in turn have led it nowhere …
_IN_TURN = 5  # motions that begin, one after the other is refused
_NOWHERE, _ELSEWHERE = 0.3, 1.0  # [m], [rad or m] … that is, not so far away with the base, or with a joint
_LOOK = 1.2  # [s] for which it stands there
_GIVES_WAY, _WAITS_THERE = 1.5, 4.0
"""How far [m] it goes back along its way from somebody who keeps it from going on for as long, and waits for as well;
and how long [s] it stands there. The second time in turn it is twice as far and as long, and so on …"""
_MOST_TIMES, _TIMES_WITHIN = 4, 60.0  # … up to so many times as far, each begun within this [s] of the last
_TURNS = (0.0, 0.7, -0.7, 1.4, -1.4, 2.2, -2.2)
"""Angles [rad] from the heading with which it was stopped, to which it turns one after the other …"""
_AWAY = 0.5  # … until it has come so far [m] from there
_AGAIN = 20.0  # [s] after the last of them, when it begins anew
_BACK, _BACK_TURN = 0.6, 0.5
"""How far [m] it backs off first, where it can, for what is at its feet is hidden by itself; and how far [rad] it turns
meanwhile at most: it is to see what is in its way, and soon."""
_STEP = 0.35  # [rad] from row to row of a turn
_SPEED = 0.5  # part of the speed of other motions
_GOES_ON_EVERY = 0.2  # [s] that it is looked on such a way whether it can go further
_HELD_UP = 4.0  # [s] for which it waits on such a way until somebody has gone by
_SAME = 0.03  # [m, rad] within which it has been there before
_THERE = 0.01  # [m, rad] of the end of a motion, within which the robot has come to it
_IN_VAIN = 2  # looks from about the same place, after which what was not seen is not looked at any more …
_ABOUT = 1.0  # [m] … from within which
_VAIN_FOR = 120.0  # [s] for which looks and what they did not show are remembered
_HIDDEN_LAYER = "hidden"  # in names, in place of `UNSEEN_LAYER`
_TO_LOOK, _TO_GIVE_WAY = "to the place from which it was to look", "back, to let somebody by,"
_TURN_WEIGHT = 0.3  # [m/rad] of turns, where it is looked how far it has come


class Vantage:
    """Workspace: where a robot looks from, where what no sensor has seen is in the way of its motions.

    Args:
        executor: takes the motions.
        planner: certifies them, among what was not seen as well.
        back: rows (K, nv) from the one at which the robot rests back along the way that it came.
        then: told when the robot has looked [s], and stands elsewhere than the strip begins.
    """

    def __init__(
        self,
        executor: ExecutorLink,
        planner: LocalPlanner,
        back: Callable[[Array], Array],
        then: Callable[[float], None],
    ) -> None:
        self._executor, self._planner, self._back, self._then = executor, planner, back, then
        self._since: float | None = None  # [s] when it stood before what was not seen
        self._stayed = 0.0, np.full(planner.robot.space.nv, np.inf)  # since when [s] it has stayed about which row
        self._refused = False  # whether what was not seen has kept it from a motion there
        self._unseen = ""  # what that was last
        self._met = False  # whether the last tick there found no motion along the strip because of something that moves
        self._begun = 0  # how many motions have begun there after one was refused
        self._accepted = False  # whether the last one was
        self._stays = False  # whether it is brought to rest there, to look from elsewhere or to be led around
        self._place, self._heading = np.full(2, np.inf), 0.0  # [m], [rad] where it first did
        self._tried = 0  # turns there, one a tick …
        self._tries = False  # … and whether the next is due
        self._met_mover = False  # whether something that moves has kept it from setting out there
        self._stand = _LOOK  # [s] for which it stands where the way ends
        self._aim = _TO_LOOK  # of that way
        self._motion: Trajectory | None = None  # to where it looks from, or the beginning of the way
        self._rows: Array = np.zeros((0, 0))  # (K, nv) of that way
        self._goes_on_at = -np.inf  # [s] when it is looked whether it can go further on that way
        self._came = -np.inf  # [s] when it came to rest on the way
        self._braked = False  # whether it was braked here, and not by what knows more: a bumper, a scene that is old
        self._gave_way = 0, -np.inf  # how often in turn, and when [s] it last did
        self._before_mover = False  # whether it did not set out there because of something that moves
        self._looks = False  # whether it is on such a way, or looks from its end
        self._until = -np.inf  # [s] until when it looks from there, or did
        self._looked: list[tuple[float, Array]] = []  # when [s], and from where [m], it has looked of late
        self._hidden: dict[str, float] = {}  # what it has not seen from there, and until when [s] that counts
        self._named: dict[str, tuple[Obstacle, Obstacle]] = {}  # as it came, and as it counts
        self._made: tuple[Scene, list[str], Scene] = (Scene(), [], Scene())  # with which of them it was made into what

    def scene(self, t: float, scene: Scene, *, no_way: bool) -> Scene:
        """A scene in which what was looked at in vain is an obstacle like others, for a while.

        Args:
            t: time [s].
            scene: the obstacles.
            no_way: whether there is no way around that: then it is looked at again.
        """
        if no_way:
            self._hidden.clear()
            self._looked.clear()
        names = [name for name, until in self._hidden.items() if t < until and name in scene]
        if not names:
            return scene
        given, hidden, made = self._made
        if scene is not given or names != hidden:
            made, before, self._named = scene, self._named, {}
            for name in names:
                obstacle = scene.obstacle(name)
                known = before.get(name)
                if known is None or known[0] is not obstacle:
                    known = obstacle, obstacle.named(f"{_HIDDEN_LAYER}{name.removeprefix(UNSEEN_LAYER)}")
                self._named[name] = known
                made = made.without(name).with_obstacle(known[1])
            self._made = scene, names, made
        return made

    def note(self, t: float, result: PlanResult, scene: Scene, *, stands: bool) -> None:
        """Take note of a planning tick: whether the robot stands before what was not seen, or gets nowhere.

        Args:
            t: time [s].
            result: of the tick.
            scene: the obstacles.
            stands: whether the robot does.
        """
        broken = None if result.accepted or result.certificate is None else result.certificate.broken
        unseen = "" if broken is None or not _stays_unseen(broken.obstacle) else broken.obstacle
        self._tries = False
        row, stayed = self._executor.estimate, self._stayed[1]
        here = row[:2]
        if np.hypot(*(here - stayed[:2])) > _NOWHERE or np.abs(row[3:] - stayed[3:]).max(initial=0.0) > _ELSEWHERE:
            self._stayed, self._refused, self._begun, self._met = (t, row.copy()), False, 0, False
        self._refused |= bool(unseen)
        self._unseen = unseen or self._unseen
        if broken is not None or result.outcome is PlanOutcome.EVADE:
            self._met = broken is None or scene.moves(broken.obstacle)
        self._begun += result.accepted and not self._accepted
        self._accepted = result.accepted
        stays = self._led_nowhere(t)
        if not stands or result.accepted or (broken is not None and not unseen):
            self._since = None
        elif unseen:
            self._since = t if self._since is None else self._since
        self._stays |= stays
        if unseen and (stands or stays) and self._vain(here) >= _IN_VAIN:
            self._hidden[unseen] = t + _VAIN_FOR

    def _led_nowhere(self, t: float) -> bool:
        """Whether the robot has stayed about one place for long, and what keeps it there may be seen, or let by."""
        return (self._refused or self._met or self._begun >= _IN_TURN) and t - self._stayed[0] > _STAYS

    def _vain(self, here: Array) -> int:
        """How often the robot has looked from about a place (2,)."""
        return sum(float(np.hypot(*(here - place))) < _ABOUT for _, place in self._looked)

    def looks(self, t: float, begin: float, scene: Scene, speed: float) -> bool:
        """Whether the robot goes to look from elsewhere, or looks from there.

        Args:
            t: time [s].
            begin: time [s] at which a motion that is planned now begins.
            scene: the obstacles.
            speed: part of the full speed with which it may go.
        """
        executor, stands = self._executor, self._executor.at_rest(t)
        self._stays |= stands and self._led_nowhere(t)  # also where nothing is planned
        if self._motion is not None and not stands:
            if executor.active is self._motion:
                refuted = self._planner.refuted(executor.active, scene, begin)
                if refuted:
                    self._braked = True
                    executor.brake(f"on the way {self._aim} {refuted}")
                elif t >= self._goes_on_at:
                    self._goes_on_at = t + _GOES_ON_EVERY
                    self._goes_on(begin, scene, _SPEED * speed)
            return True
        if self._motion is not None:
            self._came = t if self._came == -np.inf else self._came
            off = np.abs(executor.active.coordinates[-1] - self._motion.coordinates[-1]).max()
            left = self._left(executor.active.coordinates[-1])
            if (
                (off < _THERE or self._braked)
                and len(left) > 1
                and (
                    self._sets_out(left, begin, scene, _SPEED * speed)
                    or t - self._came < (_HELD_UP if self._before_mover else _LOOK)
                )
            ):
                return True
            self._motion, self._until, self._came = None, self._came + self._stand, -np.inf
        if t < self._until:
            return True
        if self._stays and not (stands and executor.settled):
            return True  # nothing is planned that would keep it going
        if self._looks:
            self._looks = False
            self._looked = [look for look in self._looked if t - look[0] < _VAIN_FOR]
            self._looked.append((t, executor.active.coordinates[-1, :2].copy()))
            self._then(t)
        waits = self._since is not None and t - self._since >= _WAIT
        if not (self._stays or waits or self._tries) or not (stands and executor.settled):
            return False
        if self._stays:
            sees_all, met = not (self._refused or waits), self._met
            self._stays, self._refused, self._begun, self._met = False, False, 0, False
            self._stayed = t, self._stayed[1]
            if met and self._gives_way(begin, scene, _SPEED * speed):
                return True
            if sees_all:  # it is led to and fro by what it sees: another strip, from where it stands
                self._executor.log("replanning", f"within {_STAYS:g} s its motions have led nowhere")
                self._then(t)
                return False
        here = executor.active.coordinates[-1]
        if not self._tries and (float(np.hypot(*(here[:2] - self._place))) > _AWAY or t - self._until > _AGAIN):
            self._place, self._heading, self._tried, self._met_mover = here[:2].copy(), float(here[2]), 0, False
        return self._goes(here, begin, scene, _SPEED * speed)

    def _gives_way(self, begin: float, scene: Scene, speed: float) -> bool:
        """Whether the robot sets out back along the way that it came, to let somebody by."""
        times, last = self._gave_way
        times = min(times + 1, _MOST_TIMES) if begin - last < _TIMES_WITHIN else 1
        rows = _without_loops(self._back(self._executor.active.coordinates[-1]), times * _GIVES_WAY)
        way = _lengths(rows)
        back = rows[: int(np.searchsorted(way, times * _GIVES_WAY)) + 1]
        if way[-1] < _NOWHERE or not self._sets_out(back, begin, scene, speed):
            return False
        self._gave_way = times, begin
        self._executor.log("yielding", f"for {_STAYS:g} s somebody has kept the robot from going on")
        self._looks, self._since, self._stand, self._aim = True, None, times * _WAITS_THERE, _TO_GIVE_WAY
        return True

    def _goes(self, here: Array, begin: float, scene: Scene, speed: float) -> bool:
        """Whether the robot sets out to look from elsewhere, or there are turns left that are not tried yet. To try
        them all takes several times as long as a planning tick may."""
        if self._tried < len(_TURNS):
            yaw = self._heading + _TURNS[self._tried]
            self._tried += 1
            for rows in (self._backed(here), here[None]):
                if self._sets_out(_turned(rows, yaw), begin, scene, speed):
                    self._executor.log("looking", "the robot goes to look from elsewhere at what is in its way")
                    self._looks, self._since, self._stand, self._aim = True, None, _LOOK, _TO_LOOK
                    self._tries = False
                    return True
                self._met_mover |= self._before_mover
        self._tries = self._tried < len(_TURNS)
        if not self._tries and self._since is not None and not self._met_mover:  # it can be seen from nowhere else
            self._hidden[self._unseen] = begin + _VAIN_FOR
        return self._tries

    def _goes_on(self, begin: float, scene: Scene, speed: float) -> None:
        """Go further than the motion that it is on, which is a beginning of the way, without a stop between them."""
        planner, state = self._planner, self._executor.active.at(begin)
        left = self._left(state.coordinates)
        if len(left) < 2 or np.abs(self._rows[-1] - self._executor.active.coordinates[-1]).max() < _THERE:
            return
        try:
            motion = planner.timer.easy.horizon(left, state.v, a_start=state.a, start_time=begin, speed=speed)
        except ElasticStripsError:
            return
        certificate = planner.certify(motion, scene)
        further = (motion, certificate) if certificate.certified else planner.beginning(motion, certificate, scene)
        if further is not None and further[0].end_time > self._executor.active.end_time + _GOES_ON_EVERY:
            self._submit(*further)

    def _left(self, here: Array) -> Array:
        """(K, nv) rows of the way to where it looks from that are left, from one (nv,) on it."""
        rows = self._rows
        off = np.hypot(*(rows[:, :2] - here[:2]).T) + _TURN_WEIGHT * np.abs(rows[:, 2] - here[2])
        return np.vstack((here, rows[int(off.argmin()) + 1 :]))

    def _sets_out(self, rows: Array, begin: float, scene: Scene, speed: float) -> bool:
        """Whether there is a certified motion along rows (K, nv), or a beginning of one, and the robot is on it."""
        planner = self._planner
        self._before_mover = False
        if len(rows) < 2 or not self._executor.settled:
            return False
        try:
            motion = planner.timer.easy.full(rows, start_time=begin, speed=speed)
        except ElasticStripsError:
            return False
        certificate = planner.certify(motion, scene)
        if not certificate.certified:
            begins = planner.beginning(motion, certificate, scene)
            if begins is None:
                self._before_mover = certificate.broken is not None and (
                    certificate.broken.obstacle.startswith(f"{LOST_LAYER}-") or scene.moves(certificate.broken.obstacle)
                )
                return False
            motion, certificate = begins
        self._submit(motion, certificate)
        self._rows, self._came, self._braked = rows, -np.inf, False
        return True

    def _submit(self, motion: Trajectory, certificate: Certificate) -> None:
        self._executor.submit(motion, certificate, at_goal=False, proven=self._planner.margins.tracking_error)
        self._motion = motion

    def _backed(self, here: Array) -> Array:
        """(K, nv) rows back along the way that the robot came, up to where it turned on the spot."""
        rows = _without_loops(self._back(here), _BACK)
        way = _lengths(rows)
        turned = np.flatnonzero((np.abs(rows[:, 2] - here[2]) > _BACK_TURN) | (way > _BACK))
        most = way[int(turned[0]) if len(turned) else -1]
        return rows[: int(np.searchsorted(way, most - _SAME)) + 1]


def _stays_unseen(obstacle: str) -> bool:
    """Whether an obstacle is what was not seen, and is so until it is looked at: not where somebody may be that nothing
    sees, for that is over soon, and who backs off from it backs off into what comes from behind."""
    return obstacle.startswith(f"{UNSEEN_LAYER}-") and not obstacle.startswith(f"{LOST_LAYER}-")


def _lengths(rows: Array) -> Array:
    """How far [m] the base has come at each of rows (K, nv) of a way."""
    return np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(rows[:, :2], axis=0).T))))


def _without_loops(rows: Array, most: float) -> Array:
    """Rows (K, nv) of a way without what leads back to where it has been before, up to a length of ``most`` [m]."""
    kept, way = [0], 0.0
    while kept[-1] < len(rows) - 1 and way <= most:
        again = np.flatnonzero(np.abs(rows - rows[kept[-1]]).max(axis=1) < _SAME)
        kept.append(max(int(again[-1]), kept[-1] + 1))
        way += float(np.hypot(*(rows[kept[-1], :2] - rows[kept[-2], :2])))
    return rows[kept]


def _turned(rows: Array, yaw: float) -> Array:
    """Rows (K, nv), and then a turn in place to a heading [rad]."""
    turn = yaw - float(rows[-1, 2])
    turned = np.repeat(rows[-1:], int(np.ceil(abs(turn) / _STEP)), axis=0)
    turned[:, 2] += np.linspace(0.0, turn, len(turned) + 1)[1:]
    return np.concatenate((rows, turned))
