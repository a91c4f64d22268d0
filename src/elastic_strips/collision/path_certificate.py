"""The certificate of a path from anywhere: proven clear all along, refuted with a configuration that shows it, or open.

The way between two configurations is part of a path. A planner that looks at configurations some way apart can
miss something between them; a certificate cannot (:mod:`elastic_strips.collision.certificate`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise
from time import perf_counter

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Mask
from elastic_strips.errors import ParameterError, RobotError, SceneError, listed
from elastic_strips.robot import BaseKind, Kinematics, RobotModel
from elastic_strips.robot.floor import below_floor
from elastic_strips.scene import Obstacle, Scene, UnknownMotion, World
from elastic_strips.scene.motion import MAX_SPEED
from elastic_strips.summary import Summary
from elastic_strips.validation import check_array, check_choice, check_number, check_type, named_arguments

from .bounds import BodySet, MotionBounds
from .certificate import BrokenSegment, half_turn
from .native_side import proven_segments
from .obstacles import ObstacleProximity
from .path_rows import INTERPOLATIONS, Arcs, PathLike, as_arcs, path_rows
from .self_distance import SelfProximity
from .strip_certificate import Certifier, coordinate_clearance

_EXACT_DISTANCE = 0.05  # [m] distances are exact below this, or twice the clearance
_MOST_HALVINGS = 20  # of a segment
_SEGMENTS_AT_ONCE = 256
_BROKEN_SAMPLES = 129  # configurations of a broken segment that are looked at for the deepest
_SLIP_SHARE = 0.1  # sideways travel of a base on wheels, of the travel ahead, that files and their rounding may have
_SLIP_UNSAID = 0.05  # [m] of such travel in all that is not worth a word
_MOST_BROKEN_SEEN = 8  # broken segments that are looked at for one that refutes
_LEAST_MOTION = 1e-4  # [m] of an obstacle, below which a piece of time is not divided further
_LEAST_TIME = 1e-6  # [s] of such a piece
_LEAST_TOLERANCE = 1e-4  # [m] of the least distance that is measured


class Verdict(str, Enum):
    """What is known about a path."""

    CERTIFIED = "certified"
    REFUTED = "refuted"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PathCertificate(Summary):
    """The result of :func:`certify`.

    Attributes:
        verdict: certified; refuted, if a configuration was found that does not keep the clearance; or unknown.
        clearance: distance [m] from obstacles that was to be proven.
        self_clearance: distance [m] between the robot's own links that was to be proven.
        least: smallest distance [m] from obstacles along the whole path; the true one is at most 0.1 mm larger. None
            where it was not requested, or where obstacles move.
        segments: numbers of the segments that are not certified.
        broken: the worst of these segments, with the pair of link and obstacle; None where there is none.
        q: (nq,) a configuration on that segment that does not keep the clearance; None where none was found.
        place: where ``q`` is on the segment, from 0 to 1; time: when it is reached [s], if the path has times.
        distance: distance [m] of that pair at ``q``; negative by the depth of penetration.
        reason: all of this in words, and what would decide an unknown answer.
        notes: what was assumed: what was noted as the path was read, which way it turns, at which time moving
            obstacles were taken.
        seconds: duration [s].
    """

    verdict: Verdict
    clearance: float
    self_clearance: float
    least: float | None
    segments: tuple[int, ...]
    broken: BrokenSegment | None
    q: Array | None
    place: float | None
    time: float | None
    distance: float | None
    reason: str
    notes: tuple[str, ...]
    seconds: float

    @property
    def certified(self) -> bool:
        """Whether the whole path keeps the clearances."""
        return self.verdict is Verdict.CERTIFIED

    def _summary(self) -> dict[str, object]:
        return {"verdict": self.verdict.value, "clearance": f"{self.clearance:g} m", "reason": self.reason}


@named_arguments
def certify(
    robot: RobotModel,
    scene: Scene | World,
    path: PathLike,
    *,
    clearance: float = 0.0,
    self_clearance: float = 0.0,
    interpolation: str = "arc",
    times: npt.ArrayLike | None = None,
    measure: bool = True,
) -> PathCertificate:
    """Prove that a path keeps its clearances, or show where it does not.

    Args:
        robot: the robot.
        scene: the obstacles. With ``times`` they move, and those of a world appear and vanish. Without, a scene is
            taken as it stands, and the answer says so if something in it moves; a world that changes is refused.
        path: configurations (N, nq), coordinate rows (N, nv), a strip, or a path of `load_path`, whose doubts count.
            Configurations have (cos, sin) of a yaw and of joints without limits; rows have their values. Between two of
            them joints go linearly.
        clearance: distance to obstacles [m] to prove; 0 proves that nothing touches.
        self_clearance: distance between the robot's own links [m] to prove.
        interpolation: ``"arc"``: the base goes along the tangent of SE(2), on an arc, as wheels do and as strips have
            them; ``"line"``: x, y and yaw go linearly, as in OMPL's SE(2) and most files. With both, angles go the
            shorter way, and values that change by more than half a turn are *unknown*. ``"values"``: all go linearly,
            angles by their values, whole turns too; *unknown* for configurations, which have no values. ``"shortest"``:
            all go linearly, angles the shorter way, whatever their values. Half a turn is *unknown* where the values do
            not say which.
        times: (N,) when each configuration is reached [s], not decreasing.
        measure: whether to measure the least distance along a certified path.

    Raises:
        RobotError, SceneError: not a robot, or neither a scene nor a world.
        ConfigurationError: a path of another shape, or less than two configurations, or outside the joints' limits.
        ParameterError: a clearance below 0, an unknown interpolation, times that do not fit, or no times where the
            world changes with the time.

    Examples:
        >>> robot = es.load_robot("silvermate")
        >>> scene = es.Scene([es.Box((0.4, 0.4, 1.0), at=(2.0, 0.0, 0.5), name="crate")])
        >>> path = [robot.home(x=x) for x in (0.0, 1.0, 2.0, 3.0)]
        >>> found = es.certify(robot, scene, path)
        >>> found.verdict.value, found.broken.obstacle
        ('refuted', 'crate')
        >>> es.certify(robot, es.Scene(), path).certified
        True
    """
    began = perf_counter()
    check_type("robot", robot, RobotModel, RobotError)
    if not isinstance(scene, (Scene, World)):
        raise SceneError(f"scene is a {type(scene).__name__}; it must be a Scene, or a World and a path with times")
    check_number("clearance", clearance, low=0.0, unit="m")
    check_number("self_clearance", self_clearance, low=0.0, unit="m")
    check_choice("interpolation", interpolation, INTERPOLATIONS)
    given = path_rows(robot, path)
    arcs = as_arcs(robot, given, interpolation)
    when = None if times is None else _checked_times(times, len(given.rows))
    standing, changing, notes = _apart(scene, when)
    work = _Work(robot, clearance, self_clearance, arcs)
    work.standing(standing)
    if changing is not None and when is not None:
        work.changing(when[0] + np.interp(arcs.whole, np.arange(len(when)), when - when[0]), *changing)
    least = None
    if measure and changing is None and not arcs.unknown:
        least = coordinate_clearance(robot, arcs.rows, standing, tolerance=_LEAST_TOLERANCE)
    varies = changes(scene if isinstance(scene, World) else World(scene))
    if when is not None and varies:
        notes = (*notes, f"from {when[0]:g} s to {when[-1]:g} s, and for no time before or after")
    if getattr(path, "rates", False):
        notes = (*notes, "straight from configuration to configuration; splines by the file's velocities leave that")
    said = (*((arcs.way,) if arcs.way else ()), *notes, *_sideways(robot, given.rows))
    found = work.result(when, least, said, began)
    if found.certified and not len(scene.scene if isinstance(scene, World) else scene):
        found = replace(found, reason=f"{found.reason}; the scene has no obstacles")
    if found.certified and (still := getattr(path, "at_home", ())):
        found = replace(found, reason=f"{found.reason}; with {listed(tuple(still))} at home, as the path does not say")
    if found.certified and (below := below_floor(robot, arcs.rows)):
        found = replace(found, reason=f"{found.reason}; {below}")
    if found.certified and robot.unproven:
        found = replace(found, reason=f"{found.reason}; {robot.unproven}")
    found = replace(found, notes=(*getattr(path, "notes", ()), *found.notes))
    time_doubts = getattr(path, "time_doubts", ()) if when is not None and varies else ()
    return _doubted(found, [*getattr(path, "doubts", ()), *time_doubts])


def _sideways(robot: RobotModel, rows: Array) -> tuple[str, ...]:
    """A note about a path that wheels cannot follow, whether or not it is free; empty where they can.

    It compares the arc from each configuration to the next: the only way between them that wheels may have.
    """
    if robot.base_kind is not BaseKind.DIFF_DRIVE:
        return ()
    v = robot.space.difference(rows[:-1], rows[1:])
    aside = np.where(np.abs(v[:, 1]) > _SLIP_SHARE * np.abs(v[:, 0]), np.abs(v[:, 1]), 0.0)
    if aside.sum() <= _SLIP_UNSAID:
        return ()
    most = f"{_mm(float(aside.sum()))} in all, most in segment {int(aside.argmax())}"
    return (f"the base goes sideways, {most}: the wheels of a differential drive cannot follow (base omni?)",)


def _doubted(found: PathCertificate, doubts: list[str]) -> PathCertificate:
    """The answer of a path with doubts: what is certified of it is unknown of the robot, which may not follow it."""
    if not doubts or not found.certified:
        return found
    reason = f"{'; '.join(doubts)}. Of what was looked at, {found.reason}"
    return replace(found, verdict=Verdict.UNKNOWN, reason=reason)


def _checked_times(times: npt.ArrayLike, count: int) -> Array:
    when = check_array("times", times, (count,))
    if (np.diff(when) < 0.0).any():
        raise ParameterError("times must not decrease")
    return when


def changes(world: World) -> tuple[str, ...]:
    """Names of obstacles that change with time: those that move, appear or vanish."""
    return tuple(dict.fromkeys((*world.names_moving, *world.appears, *world.vanishes)))


def _apart(
    scene: Scene | World, when: Array | None
) -> tuple[Scene, tuple[World, tuple[Obstacle, ...]] | None, tuple[str, ...]]:
    """The obstacles that stand still all along; the world and the names of its other obstacles; a note about them."""
    if isinstance(scene, Scene):
        moving = [o.name or "" for o in scene if o.motion is not None]
        if when is None:
            return scene, None, (f"{listed(moving)} as it stands at {scene.time:g} s",) if moving else ()
        if not moving:
            return scene, None, ()
        scene = World(scene)
    names = changes(scene)
    if not names:
        return scene.scene, None, ()
    first = listed(names)
    if when is None:
        raise ParameterError(f"times= are needed: the scene changes with time ({first})")
    if when[0] == when[-1]:
        raise ParameterError(f"times are all {when[0]:g} s, and the scene changes with time ({first})")
    standing, changing = [], []
    for obstacle in scene.scene:
        begin, end = (
            d.get(obstacle.name or "", far) for d, far in ((scene.appears, -np.inf), (scene.vanishes, np.inf))
        )
        if begin > when[-1] or end <= when[0]:
            continue
        all_along = obstacle.motion is None and begin <= when[0] and end > when[-1]
        (standing if all_along else changing).append(obstacle)
    return Scene(standing, time=scene.scene.time), (scene, tuple(changing)) if changing else None, ()


@dataclass(frozen=True, slots=True)
class _Broken:
    """A segment of the refined path, the place on it, what is not proven there, and among which obstacles."""

    j: int
    place: float
    segment: BrokenSegment
    scene: Scene | World
    time: float = 0.0  # [s] at the place; 0 where all stands still

    @property
    def order(self) -> tuple[bool, float]:
        """Certain ones come first, then the nearest."""
        return not self.segment.certain, self.segment.clearance


@dataclass(frozen=True, slots=True)
class _Tools:
    """Workspaces that measure and certify."""

    obstacles: ObstacleProximity
    itself: SelfProximity
    certifier: Certifier
    kin: Kinematics


class _Work:
    """Workspace of one call: what has been found broken so far."""

    def __init__(self, robot: RobotModel, clearance: float, self_clearance: float, arcs: Arcs) -> None:
        self.robot, self.clearance, self.self_clearance = robot, clearance, self_clearance
        self.arcs, self.rows = arcs, arcs.rows
        self.needed = clearance + arcs.bow
        self.bodies = BodySet.links(robot)
        self.bounds = MotionBounds(self.bodies)
        self.broken: list[_Broken] = []
        self.bad: set[int] = set()
        self._tools: dict[tuple[float, bool], _Tools] = {}

    def _with(self, reach: float, *, itself: bool) -> _Tools:
        """Workspaces in which distances are exact below ``reach`` [m], with or without the robot's own pairs."""
        reach = _EXACT_DISTANCE if 2.0 * reach <= _EXACT_DISTANCE else float(2.0 ** np.ceil(np.log2(2.0 * reach)))
        key = (reach, itself)
        if key not in self._tools:
            obstacles = ObstacleProximity(self.bodies, influence=reach)
            pairs = self.robot.pairs_within(self.self_clearance) if itself else self.robot.self_pairs[:0]
            own = SelfProximity(
                self.bodies, pairs, self.bounds, influence=max(_EXACT_DISTANCE, 2.0 * self.self_clearance)
            )
            certifier = Certifier(self.bodies, self.bounds, obstacles, own, max_depth=_MOST_HALVINGS)
            self._tools[key] = _Tools(obstacles, own, certifier, Kinematics(self.robot.tree, _SEGMENTS_AT_ONCE + 1))
        return self._tools[key]

    def standing(self, scene: Scene) -> None:
        """Certify all segments among obstacles that stand still."""
        proven = self._proven(scene)
        for first in range(0, len(self.rows) - 1, _SEGMENTS_AT_ONCE):
            chunk = slice(first, first + _SEGMENTS_AT_ONCE)
            if proven[chunk].all():
                continue
            tools = self._with(self.needed, itself=True)
            part = self.rows[first : first + _SEGMENTS_AT_ONCE + 1]
            states, broken = self._certified(tools, part, self.arcs.known[chunk], scene, self.needed, proven[chunk])
            self.bad.update((first + np.flatnonzero(states)).tolist())
            if broken is not None:
                self.broken.append(_Broken(first + broken.segment, 0.5, broken, scene))

    def _proven(self, scene: Scene) -> Mask:
        """Segments that the spheres of the links prove; most of them, and in a fraction of the time."""
        v = self.robot.space.difference(self.rows[:-1], self.rows[1:])
        sure = self.arcs.known & ~self.robot.space.half_turn(v)
        found = proven_segments(
            self.bounds,
            scene,
            self.robot.pairs_within(self.self_clearance),
            self.rows,
            v,
            clearance=self.needed,
            self_clearance=self.self_clearance,
        )
        return sure & found if found is not None else np.zeros(len(v), dtype=bool)

    def _certified(
        self,
        tools: _Tools,
        rows: Array,
        known: Mask,
        scene: Scene,
        clearance: float,
        proven: Mask | None = None,
    ) -> tuple[npt.NDArray[np.int8], BrokenSegment | None]:
        """States of the segments between rows, and the worst broken one; without a known way only the ends count."""
        kin, v = tools.kin, self.robot.space.difference(rows[:-1], rows[1:])
        v[~known] = 0.0
        kin.update(rows)
        tools.obstacles.update(kin, scene)
        tools.itself.update(kin)
        found = tools.certifier.certify(
            kin, v, clearance=clearance, self_clearance=self.self_clearance, scene=scene, known=proven
        )
        return found.states, found.broken

    def changing(self, when: Array, world: World, obstacles: tuple[Obstacle, ...]) -> None:
        """Certify all segments among obstacles that change with time, in pieces of time in which nothing moves far.

        Time is divided where something appears or vanishes, so that all through a piece the same obstacles are there.
        """
        last = len(when) - 2
        for j in np.flatnonzero(self.arcs.known).tolist():
            begin, end = float(when[j]), float(when[j + 1])
            moments = [begin, *(e for e in world.event_times if begin < e < end), end]
            shares = [0.0, *((e - begin) / (end - begin) for e in moments[1:-1]), 1.0]
            cuts = list(zip(moments, shares, strict=True))
            pieces = [*pairwise(cuts), *([(cuts[-1], cuts[-1])] if j == last else [])]  # what appears at the very end
            # who is there at an event is so until the next one, and these may have no number between them
            todo = [
                (*piece, tuple(o for o in obstacles if world.exists(o.name or "", piece[0][0]))) for piece in pieces
            ]
            while todo:
                one, two, there = todo.pop()
                (t0, low), (t1, high) = one, two
                ends = self.robot.space.interpolate(self.rows[j][None], self.rows[j + 1][None], np.array([low, high]))
                open_, broken = self._open(ends, there, world, t0, t1)
                middle = 0.5 * (t0 + t1), 0.5 * (low + high)
                if broken is not None:
                    moment = max(t0, min(middle[0], float(np.nextafter(t1, t0))))  # before what vanishes is gone
                    self.bad.add(j)
                    self.broken.append(_Broken(j, middle[1], broken, world, moment))
                    break
                if open_:
                    todo += [(middle, two, open_), (one, middle, open_)]

    def _open(
        self, ends: Array, there: tuple[Obstacle, ...], world: World, t0: float, t1: float
    ) -> tuple[tuple[Obstacle, ...], BrokenSegment | None]:
        """Obstacles that may be too near in a piece of time, or what is broken where it is too short to be divided."""
        known = tuple(o for o in there if not isinstance(o.motion, UnknownMotion))
        open_, broken = self._open_known(ends, known, world, t0, t1)
        if broken is not None:
            return (), broken
        for obstacle in there:
            if isinstance(obstacle.motion, UnknownMotion):
                margin = away(obstacle, world.scene.time, t0, t1)
                broken = self._broken_among(ends, (obstacle,), 0.5 * (t0 + t1), margin)
                if broken is None:
                    continue
                if obstacle.motion.max_speed * (t1 - t0) < _LEAST_MOTION or t1 - t0 < _LEAST_TIME:
                    return (), broken if margin == 0.0 else replace(broken, certain=False)
                open_ = (*open_, obstacle)
        return open_, None

    def _open_known(
        self, ends: Array, known: tuple[Obstacle, ...], world: World, t0: float, t1: float
    ) -> tuple[tuple[Obstacle, ...], BrokenSegment | None]:
        """The same among obstacles whose motion is known."""
        if not known:
            return (), None
        half = 0.5 * (t1 - t0)
        shift = max(world.speed_bound(o.name, start=t0, end=t1) for o in known) * half if half else 0.0
        shortest = t1 - t0 < _LEAST_TIME
        if not np.isfinite(shift):  # a loop jumps: it is on one side of the jump or on the other
            if not shortest:
                return known, None
            far = MAX_SPEED * (1.0 + max(o.reach for o in known)) * (t1 - t0)
            sides = (self._broken_among(ends, known, t, far) for t in (t0, t1))
            return (), next((broken for broken in sides if broken is not None), None)
        if shift >= _EXACT_DISTANCE and not shortest:
            return known, None
        broken = self._broken_among(ends, known, 0.5 * (t0 + t1), shift)
        if broken is not None and (shift < _LEAST_MOTION or shortest):
            return (), broken
        return (known if broken is not None else ()), None

    def _broken_among(
        self, ends: Array, obstacles: tuple[Obstacle, ...], t: float, margin: float
    ) -> BrokenSegment | None:
        """The broken place where these obstacles are within ``margin`` [m] of where they are at ``t``."""
        needed = self.needed + margin
        known = np.ones(1, dtype=bool)
        tools = self._with(needed, itself=False)
        states, broken = self._certified(tools, ends, known, Scene([o.at(t) for o in obstacles], time=t), needed)
        assert broken is not None or not states.any()
        return broken

    def result(self, when: Array | None, least: float | None, notes: tuple[str, ...], began: float) -> PathCertificate:
        """The verdict; where something is broken, the configuration that shows it best."""
        whole, unknown = self.arcs.whole, self.arcs.unknown
        segments = tuple(sorted({int(whole[j]) for j in self.bad} | set(unknown)))
        assumed = "".join(f"; {note}" for note in notes)

        def answer(
            verdict: Verdict, reason: str, broken: BrokenSegment | None, found: _Found | None, place: float = 0.0
        ) -> PathCertificate:
            shown = found if verdict is Verdict.REFUTED else None
            time = None if when is None or shown is None else float(np.interp(place, np.arange(len(when)), when))
            return PathCertificate(
                verdict,
                self.clearance,
                self.self_clearance,
                least,
                segments,
                broken,
                q=None if shown is None else self.robot.space.from_coordinates(shown.row),
                place=None if shown is None or broken is None else place - broken.segment,
                time=time,
                distance=None if shown is None else shown.distance,
                reason=reason + assumed,
                notes=notes,
                seconds=perf_counter() - began,
            )

        if not segments:
            said = (
                ""
                if least is None
                else f", {_mm(least)} at the nearest place"
                if np.isfinite(least)
                else ", with nothing near"
            )
            return answer(Verdict.CERTIFIED, f"{_every(int(whole[-1]))} proven{said}", None, None)
        others = (
            ""
            if len(segments) < 2
            else f"; {len(segments) - 1} more {'is' if len(segments) == 2 else 'are'} not certified"
        )
        worst, found = self._worst(when)
        if unknown and (found is None or not found.certain):
            j, why = next(iter(unknown.items()))
            return answer(Verdict.UNKNOWN, f"segment {j}: {why}{others}", half_turn(self.bodies, j), None)
        assert worst is not None
        assert found is not None
        j = worst.j
        place = whole[j] + (whole[j + 1] - whole[j]) * found.place
        segment = min(int(place), int(whole[-1]) - 1)
        broken = BrokenSegment(
            segment, found.link, found.other, found.distance, found.kind, found.certain, found.labels
        )
        if not found.certain:
            why = _undecided(found, worst.scene)
            return answer(Verdict.UNKNOWN, f"segment {segment}: {why}{others}", broken, found)
        one, two = found.labels
        required = self.self_clearance if found.kind == "self" else self.clearance
        deep = f"{_mm(-found.distance)} deep in {two}"
        if found.distance >= 0.0:
            deep = f"{_mm(found.distance)} from {two}, nearer than the {_mm(required)} to be kept"
        reason = f"segment {segment}, {place - segment:.3f} of the way along it: {one} is {deep}{others}"
        return answer(Verdict.REFUTED, reason, broken, found, place)

    def _worst(self, when: Array | None) -> tuple[_Broken | None, _Found | None]:
        """What is broken worst, and the worst configuration there; None where nothing is broken."""
        self.broken.sort(key=lambda entry: entry.order)
        worst, found = None, None
        for entry in self.broken[:_MOST_BROKEN_SEEN]:
            deepest = self._deepest(entry, when)
            if found is None or deepest.order < found.order:
                worst, found = entry, deepest
            if deepest.certain:
                break
        return worst, found

    def _deepest(self, broken: _Broken, when: Array | None) -> _Found:
        """The worst configuration of a segment of the refined path, among many."""
        j, scene = broken.j, broken.scene
        moments = None if when is None else np.interp(self.arcs.whole[j : j + 2], np.arange(len(when)), when)
        even = np.linspace(0.0, 1.0, _BROKEN_SAMPLES)
        part = np.sort(np.append(even, broken.place))  # where something may be for a moment only
        best: _Found | None = None
        for _ in range(3):  # ever closer about the worst so far
            if not self.arcs.known[j]:
                part, samples = np.array([0.0, 1.0]), self.rows[j : j + 2]
            else:
                samples = self.robot.space.interpolate(self.rows[j][None], self.rows[j + 1][None], part)
                if self.arcs.bow:  # the path itself is a line
                    samples[:, :2] = self.rows[j, :2] + part[:, None] * (self.rows[j + 1, :2] - self.rows[j, :2])
            if isinstance(scene, Scene):
                pieces = [(slice(None), scene, {})]
            else:
                assert moments is not None
                pieces = []
                moment = np.where(part == broken.place, broken.time, np.interp(part, (0.0, 1.0), moments))
                for k, t in enumerate(moment.tolist()):
                    among = scene.at(t)
                    apart = {
                        o.name: away(o, scene.scene.time, t, t) for o in among if isinstance(o.motion, UnknownMotion)
                    }
                    pieces.append((slice(k, k + 1), among, apart))
            for k, obstacles, margins in pieces:
                found = self._worst_of(samples[k], part[k], obstacles, margins)
                if best is None or found.order < best.order:
                    best = found
            step = (part[-1] - part[0]) / (_BROKEN_SAMPLES - 1)
            assert best is not None
            part = np.linspace(max(best.place - step, 0.0), min(best.place + step, 1.0), _BROKEN_SAMPLES)
        assert best is not None
        return best

    def _worst_of(self, samples: Array, part: Array, scene: Scene, margins: dict[str | None, float]) -> _Found:
        kin = Kinematics(self.robot.tree, len(samples))
        kin.update(samples)
        tools = self._with(self.needed + max(margins.values(), default=0.0), itself=True)
        obstacles, itself = tools.obstacles, tools.itself
        obstacles.reset()
        itself.reset()
        obstacles.update(kin, scene)
        itself.update(kin)
        found: list[_Found] = []

        def note(
            k: int,
            distance: float,
            needed: float,
            margin: float,
            kind: str,
            names: tuple[str, str],
            labels: tuple[str, str],
        ) -> None:
            certain, spare = distance + margin <= needed, distance - margin - needed
            found.append(
                _Found(float(part[k]), samples[k].copy(), *names, labels, distance, margin, kind, spare, certain)
            )

        if obstacles.exact.size:
            parts = [obstacles.obstacle_name(c) for c in range(obstacles.exact.shape[2])]
            margin = np.array([margins.get(name, 0.0) for name in parts])
            for at in {int(np.argmin(obstacles.exact + sign * margin)) for sign in (1.0, -1.0)}:
                k, g, c = (int(i) for i in np.unravel_index(at, obstacles.exact.shape))
                link, label = self.bodies.names[g], self.bodies.labels[g]
                distance = float(obstacles.exact[k, g, c])
                note(k, distance, self.clearance, float(margin[c]), "obstacle", (link, parts[c]), (label, parts[c]))
        if itself.exact.size:
            k, s = (int(i) for i in np.unravel_index(int(np.argmin(itself.exact)), itself.exact.shape))
            one, two = (int(i) for i in itself.pairs[s])
            names, labels = ((of[one], of[two]) for of in (self.bodies.names, self.bodies.labels))
            note(k, float(itself.exact[k, s]), self.self_clearance, 0.0, "self", names, labels)
        if not found:
            return _Found(float(part[0]), samples[0].copy(), "", "", ("", ""), np.inf, 0.0, "obstacle", np.inf, False)
        return min(found, key=lambda one: one.order)


def away(obstacle: Obstacle, seen: float, t0: float, t1: float) -> float:
    """How far [m] an obstacle of unknown motion may be, between ``t0`` and ``t1`` [s], from where it was ``seen`` [s].

    It was where it is at the scene's time, or at the time for which a sensor or a caller placed it.
    """
    assert isinstance(obstacle.motion, UnknownMotion)
    since = max(abs(t - at) for t in (t0, t1) for at in {seen, obstacle.anchor_time or seen})
    return obstacle.motion.max_speed * since


@dataclass(frozen=True, slots=True)
class _Found:
    """The worst of some configurations: its place, row, pair and distance, and whether that is too near for sure.

    Obstacles of unknown motion may be ``margin`` [m] away from where they were measured.
    """

    place: float
    row: Array
    link: str
    other: str
    labels: tuple[str, str]
    distance: float
    margin: float
    kind: str
    spare: float
    certain: bool

    @property
    def order(self) -> tuple[bool, float]:
        """Certain ones come first, then those with the least to spare."""
        return not self.certain, self.spare


def _undecided(found: _Found, scene: Scene | World) -> str:
    """Why a configuration neither keeps the clearance nor refutes it."""
    one, two = found.labels
    if found.margin > 0.0:
        seen = scene.time if isinstance(scene, Scene) else scene.scene.time
        return (
            f"{one} comes as near as {_mm(found.distance)} to where {two} was at {seen:g} s, "
            f"which may have moved by {_mm(found.margin)} since"
        )
    return (
        f"{one} and {two} come as near as {_mm(found.distance)}, too close to the clearance to decide: "
        "prove a smaller clearance, or look at the path in smaller pieces"
    )


def _every(segments: int) -> str:
    return "the only segment is" if segments == 1 else f"all {segments} segments are"


def _mm(distance: float) -> str:
    return f"{round(1e3 * distance, 1) + 0.0:.1f} mm" if abs(distance) < 0.1 else f"{distance:.3f} m"  # no −0.0
