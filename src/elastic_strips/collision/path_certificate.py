"""The certificate of a path from anywhere: proven clear all along, refuted with a configuration that shows it, or open.

What lies between two configurations of a path is part of it. A planner that looks at configurations some way apart can
miss what lies between them; a certificate cannot (:mod:`elastic_strips.collision.certificate`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from time import perf_counter
from typing import Protocol

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError, ParameterError, RobotError, SceneError
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.scene import Scene, World
from elastic_strips.summary import Summary
from elastic_strips.validation import check_array, check_choice, check_number, check_type

from .bounds import BodySet, MotionBounds
from .certificate import BrokenSegment
from .obstacles import ObstacleProximity
from .self_distance import SelfProximity
from .strip_certificate import Certifier, coordinate_clearance

INTERPOLATIONS = ("arc", "line")
_REACH = 0.05  # [m] distances are exact below this, or twice the clearance
_DEPTH = 20  # most halvings of a segment
_CHUNK = 256  # segments at once
_SAMPLES = 129  # configurations of a broken segment that are looked at for the deepest
_BOW = 1e-4  # [m] by which arcs may leave the line that they stand for
_LEAST_MOTION = 1e-4  # [m] of an obstacle, below which a piece of time is not divided further
_LEAST_TIME = 1e-6  # [s]
_TOLERANCE = 1e-4  # [m] of the clearance that is measured


class HasConfigurations(Protocol):
    """A path that knows its configurations, such as a strip.

    It may also have ``doubts``, reasons why these are not, or not all of, what the robot will do, and ``time_doubts``,
    the same of its times: a `PathFile` has. Such a path is not called certified.
    """

    @property
    def q(self) -> Array:
        """(N, nq) configurations."""
        ...


class Verdict(str, Enum):
    """What is known of a path."""

    CERTIFIED = "certified"
    REFUTED = "refuted"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PathCertificate(Summary):
    """What :func:`certify` found.

    Attributes:
        verdict: certified; refuted, where a configuration was found that does not keep the clearance; or unknown.
        clearance: distance [m] that was to be proven; self_clearance: of the robot's own links.
        least: smallest distance [m] from obstacles along the whole path, at most 0.1 mm above what is said here; None
            where it was not asked for, or where obstacles move.
        segments: numbers of the segments that are not certified.
        broken: the worst of them, with the pair of link and obstacle; None where there is none.
        q: (nq,) a configuration on it that does not keep the clearance; None where none was found.
        place: where on the segment that is, from 0 to 1; time: when [s], where the path is timed.
        distance: of that pair at ``q`` [m]; below 0 by how deep it is.
        reason: all of it for people, and what would decide what is unknown.
        seconds: that it took.
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
    seconds: float

    @property
    def certified(self) -> bool:
        """Whether the whole path keeps the clearances."""
        return self.verdict is Verdict.CERTIFIED

    def _summary(self) -> dict[str, object]:
        return {"verdict": self.verdict.value, "clearance": f"{self.clearance:g} m", "reason": self.reason}


def certify(
    robot: RobotModel,
    scene: Scene | World,
    path: npt.ArrayLike | HasConfigurations,
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
        scene: the obstacles; a world's move with the time, for a path with ``times``.
        path: configurations (N, nq), a strip, or what `load_path` returns, whose doubts count. Between two of them
            joints go linearly.
        clearance: distance to obstacles [m] to prove; 0 proves that nothing touches.
        self_clearance: distance of the robot's own links [m] to prove.
        interpolation: ``"arc"``: the base goes along the tangent of SE(2), on an arc, as wheels do and as strips have
            it; ``"line"``: x, y and yaw go linearly, as OMPL's SE(2) and most files have it.
        times: (N,) when each configuration is reached [s], not decreasing.
        measure: whether to measure the least distance along a certified path.

    Raises:
        RobotError, SceneError: not a robot, or no scene or world.
        ConfigurationError: a path of another shape, or less than two configurations, or outside the joints' limits.
        ParameterError: a clearance below 0, an unknown interpolation, or times that do not fit.
    """
    began = perf_counter()
    check_type("robot", robot, RobotModel, RobotError)
    if not isinstance(scene, (Scene, World)):
        raise SceneError(f"scene is a {type(scene).__name__}; it must be a Scene, or a World and a path with times")
    check_number("clearance", clearance, low=0.0, unit="m")
    check_number("self_clearance", self_clearance, low=0.0, unit="m")
    check_choice("interpolation", interpolation, INTERPOLATIONS)
    q = robot.check_q(path.q if hasattr(path, "q") else path, what="path")  # type: ignore[union-attr]
    if q.ndim != 2 or len(q) < 2:
        raise ConfigurationError(f"path has shape {q.shape}; at least two configurations (N, {robot.nq}) are needed")
    rows, whole, bow = as_arcs(robot, robot.space.to_coordinates(q), interpolation)
    when = None if times is None else _checked_times(times, len(q))
    if isinstance(scene, World) and scene.names_moving and when is None:
        raise ParameterError(f"times= are needed: {', '.join(scene.names_moving[:3])} move")
    work = _Work(robot, clearance, self_clearance, bow)
    standing, movers = _apart(scene, when)
    work.standing(rows, standing)
    if movers is not None and when is not None:
        work.moving(rows, when[0] + np.interp(whole, np.arange(len(when)), when - when[0]), movers)
    least = coordinate_clearance(robot, rows, standing, tolerance=_TOLERANCE) if measure and movers is None else None
    found = work.result(rows, whole, when, least, began)
    if found.certified and robot.unproven:
        found = replace(found, reason=f"{found.reason}; {robot.unproven}")
    doubts = [*getattr(path, "doubts", ()), *(getattr(path, "time_doubts", ()) if movers is not None else ())]
    return _doubted(found, doubts)


def _doubted(found: PathCertificate, doubts: list[str]) -> PathCertificate:
    """What is certified of a path that may not be what the robot does is unknown of the robot."""
    if not doubts or not found.certified:
        return found
    reason = f"{'; '.join(doubts)}. Of what was looked at, {found.reason}"
    return replace(found, verdict=Verdict.UNKNOWN, reason=reason)


def as_arcs(robot: RobotModel, rows: Array, interpolation: str) -> tuple[Array, Array, float]:
    """A path's rows (N, nv) as arcs.

    Returns:
        Rows (M, nv) between which the base goes on arcs; the segment and the place on it of each, as one number; and
        how far [m] the arcs may leave the path: 0 where they are the path.
    """
    whole = np.arange(len(rows), dtype=float)
    if interpolation == "arc" or not robot.space.planar:
        return rows, whole, 0.0
    v = np.diff(rows, axis=0)
    v[:, 2] = np.pi - np.mod(np.pi - v[:, 2], 2.0 * np.pi)
    length, turn = np.hypot(v[:, 0], v[:, 1]), np.abs(v[:, 2])
    # an arc of constant speed leaves its chord by no more than an eighth of its acceleration, speed times turn; the
    # speed is at most pi/2 times the chord for turns below half a circle
    pieces = np.maximum(np.ceil(np.sqrt(np.pi / 16.0 * length * turn / _BOW)), np.ceil(turn / 1.5)).astype(int)
    out, place = [], []
    for j, count in enumerate(np.maximum(pieces, 1).tolist()):
        t = np.arange(count) / count
        out.append(rows[j] + t[:, None] * v[j])
        place.append(j + t)
        # joints that turn without end go the short way, as along the tangent
        tangent = robot.space.interpolate(rows[j][None], rows[j + 1][None], t)
        out[-1][:, 3:] = tangent[:, 3:]
    return np.vstack((*out, rows[-1:])), np.concatenate((*place, whole[-1:])), _BOW


def _checked_times(times: npt.ArrayLike, count: int) -> Array:
    when = check_array("times", times, (count,))
    if (np.diff(when) < 0.0).any():
        raise ParameterError("times must not decrease")
    return when


def _apart(scene: Scene | World, when: Array | None) -> tuple[Scene, World | None]:
    """What stands still, and the world where something moves."""
    if isinstance(scene, Scene):
        return scene, None
    first = scene.at(float(when[0]) if when is not None else 0.0)
    moving = set(scene.names_moving)
    if not moving:
        return first, None
    return Scene([o for o in first if o.name not in moving]), scene


class _Work:
    """Workspace of one call: what was broken so far."""

    def __init__(self, robot: RobotModel, clearance: float, self_clearance: float, bow: float) -> None:
        self.robot, self.clearance, self.self_clearance, self.bow = robot, clearance, self_clearance, bow
        self.bodies = BodySet.links(robot)
        self.bounds = MotionBounds(self.bodies)
        self.broken: list[tuple[float, BrokenSegment, Scene | World]] = []  # where on the path, what, and among what
        self.bad: set[int] = set()
        self._tools: tuple[ObstacleProximity, SelfProximity, Certifier, Kinematics] | None = None

    def _certifier(self) -> tuple[ObstacleProximity, SelfProximity, Certifier, Kinematics]:
        if self._tools is None:
            reach, own = (max(_REACH, 2.0 * c) for c in (self.clearance + self.bow, self.self_clearance))
            obstacles = ObstacleProximity(self.bodies, influence=reach)
            itself = SelfProximity(self.bodies, self.robot.self_pairs, self.bounds, influence=own)
            certifier = Certifier(self.bodies, self.bounds, obstacles, itself, max_depth=_DEPTH)
            self._tools = obstacles, itself, certifier, Kinematics(self.robot.tree, _CHUNK + 1)
        return self._tools

    def standing(self, rows: Array, scene: Scene) -> None:
        """Certify all segments among obstacles that stand still."""
        for first, states, broken in self._certified(rows, scene, self.clearance + self.bow):
            self.bad.update((first + np.flatnonzero(states)).tolist())
            if broken is not None:
                self.broken.append((first + broken.segment, broken, scene))

    def _certified(
        self, rows: Array, scene: Scene, clearance: float
    ) -> Iterator[tuple[int, npt.NDArray[np.int8], BrokenSegment | None]]:
        """First segment, states, and the worst broken segment, of pieces of the path."""
        obstacles, itself, certifier, kin = self._certifier()
        for first in range(0, len(rows) - 1, _CHUNK):
            part = rows[first : first + _CHUNK + 1]
            kin.update(part)
            obstacles.update(kin, scene)
            itself.update(kin)
            v = self.robot.space.difference(part[:-1], part[1:])
            found = certifier.certify(kin, v, clearance=clearance, self_clearance=self.self_clearance, scene=scene)
            yield first, found.states, found.broken

    def moving(self, rows: Array, when: Array, world: World) -> None:
        """Certify all segments among what moves: in pieces of time in which nothing moves far."""
        names = world.names_moving
        for j in range(len(rows) - 1):
            todo = [(0.0, 1.0)]
            while todo:
                low, high = todo.pop()
                t0, t1 = (when[j] + part * (when[j + 1] - when[j]) for part in (low, high))
                at = world.at(0.5 * (t0 + t1))
                present = [o for o in at if o.name in names]
                if not present:
                    continue
                shift = max(world.speed_bound(o.name, start=t0, end=t1) for o in present) * 0.5 * (t1 - t0)
                scene = Scene(present, time=at.time)
                ends = self.robot.space.interpolate(rows[j][None], rows[j + 1][None], np.array([low, high]))
                if shift < _REACH or not np.isfinite(shift):
                    needed = self.clearance + self.bow + (shift if np.isfinite(shift) else 0.0)
                    _, states, broken = next(self._certified(ends, scene, needed))
                    if not states.any() and np.isfinite(shift):
                        continue
                    if shift < _LEAST_MOTION or t1 - t0 < _LEAST_TIME:
                        assert broken is not None
                        self.bad.add(j)
                        self.broken.append((j + 0.5 * (low + high), broken, world))
                        break
                middle = 0.5 * (low + high)
                todo += [(middle, high), (low, middle)]

    def result(
        self, rows: Array, whole: Array, when: Array | None, least: float | None, began: float
    ) -> PathCertificate:
        """The verdict; where something is broken, the configuration that shows it best."""
        segments = tuple(sorted({int(whole[j]) for j in self.bad}))
        shared = {"clearance": self.clearance, "self_clearance": self.self_clearance, "least": least}
        if not self.bad:
            said = "" if least is None else f", {_mm(least)} at the nearest" if np.isfinite(least) else ", nothing near"
            reason = f"all {len(whole[whole % 1.0 == 0.0]) - 1} segments are proven{said}"
            return PathCertificate(
                Verdict.CERTIFIED, **shared, segments=(), broken=None, q=None, place=None, time=None, distance=None,
                reason=reason, seconds=perf_counter() - began,
            )  # fmt: skip
        self.broken.sort(key=lambda entry: (not entry[1].certain, entry[1].clearance))
        at, worst, scene = self.broken[0]
        j = int(at)
        moments = None if when is None else np.interp(whole[j : j + 2], np.arange(len(when)), when)
        found = self._deepest(rows[j : j + 2], scene, moments)
        place = whole[j] + (whole[j + 1] - whole[j]) * found.place
        segment = min(int(place), int(whole[-1]) - 1)
        time = None if when is None else float(np.interp(place, np.arange(len(when)), when))
        broken = BrokenSegment(
            segment, found.link, found.other, found.distance, found.kind, found.certain, found.labels
        )
        one, two = found.labels
        others = f"; {len(segments) - 1} more segments are not certified" if len(segments) > 1 else ""
        if not found.certain:
            undefined = worst.kind == "half turn"
            why = (
                f"segment {segment}: {one} and {two} come as near as {_mm(found.distance)}, too near "
                "to the clearance to decide: prove a smaller clearance, or look at the path in smaller pieces"
            )
            return PathCertificate(
                Verdict.UNKNOWN, **shared, segments=segments, broken=worst if undefined else broken, q=None,
                place=None, time=None, distance=None, reason=(str(worst) if undefined else why) + others,
                seconds=perf_counter() - began,
            )  # fmt: skip
        deep = f"{_mm(-found.distance)} deep in" if found.distance < 0.0 else f"{_mm(found.distance)} from"
        reason = f"segment {segment}, at {place - segment:.3f} of it: {one} is {deep} {two}{others}"
        return PathCertificate(
            Verdict.REFUTED, **shared, segments=segments, broken=broken, q=self.robot.space.from_coordinates(found.row),
            place=place - segment, time=time, distance=found.distance, reason=reason, seconds=perf_counter() - began,
        )  # fmt: skip

    def _deepest(self, rows: Array, scene: Scene | World, moments: Array | None) -> _Found:
        """The worst configuration of one segment (2, nv), among many; its ends are reached at ``moments`` (2,) [s]."""
        part = np.linspace(0.0, 1.0, _SAMPLES)
        best: _Found | None = None
        for _ in range(3):  # ever closer about the worst so far
            samples = self.robot.space.interpolate(rows[:1], rows[1:], part)
            if isinstance(scene, Scene):
                pieces = [(slice(None), scene)]
            else:
                assert moments is not None
                when = np.interp(part, (0.0, 1.0), moments).tolist()
                pieces = [(slice(k, k + 1), scene.at(t)) for k, t in enumerate(when)]
            for k, obstacles in pieces:
                found = self._worst_of(samples[k], part[k], obstacles)
                if best is None or found.spare < best.spare:
                    best = found
            step = part[1] - part[0]
            assert best is not None
            part = np.linspace(max(best.place - step, 0.0), min(best.place + step, 1.0), _SAMPLES)
        assert best is not None
        return best

    def _worst_of(self, samples: Array, part: Array, scene: Scene) -> _Found:
        kin = Kinematics(self.robot.tree, len(samples))
        kin.update(samples)
        obstacles, itself, _, _ = self._certifier()
        obstacles.reset()
        itself.reset()
        obstacles.update(kin, scene)
        itself.update(kin)
        distance, link, other, k, kind, labels = np.inf, "", "", 0, "obstacle", ("", "")
        if obstacles.exact.size:
            at = int(np.argmin(obstacles.exact))
            k, g, c = (int(i) for i in np.unravel_index(at, obstacles.exact.shape))
            distance, link, other = float(obstacles.exact[k, g, c]), self.bodies.names[g], obstacles.obstacle_name(c)
            labels = self.bodies.labels[g], other
        spare, needed = distance - self.clearance, self.clearance
        if itself.exact.size:
            at = int(np.argmin(itself.exact))
            n, s = (int(i) for i in np.unravel_index(at, itself.exact.shape))
            own = float(itself.exact[n, s])
            if own - self.self_clearance < spare:
                one, two = (int(i) for i in itself.pairs[s])
                distance, link, other, k, kind = own, self.bodies.names[one], self.bodies.names[two], n, "self"
                labels = self.bodies.labels[one], self.bodies.labels[two]
                spare, needed = own - self.self_clearance, self.self_clearance
        return _Found(float(part[k]), samples[k].copy(), link, other, labels, distance, kind, spare, distance <= needed)


@dataclass(frozen=True, slots=True)
class _Found:
    """The worst of some configurations: its place, row, pair and distance, and whether that is too near for sure."""

    place: float
    row: Array
    link: str
    other: str
    labels: tuple[str, str]
    distance: float
    kind: str
    spare: float
    certain: bool


def _mm(distance: float) -> str:
    return f"{1e3 * distance:.1f} mm" if abs(distance) < 0.1 else f"{distance:.3f} m"
