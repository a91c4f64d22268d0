"""The problem of a planner: robot, scene, start, goal, time and bounds; refused where something is not valid."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from time import perf_counter

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError, ParameterError, RobotError, SceneError
from elastic_strips.ownership import exclusive
from elastic_strips.robot import PlanarFootprint, RobotModel
from elastic_strips.robot.floor import below_floor
from elastic_strips.scene import Scene
from elastic_strips.strip import AxisConstraint, Strip
from elastic_strips.strip.constraint import ConstraintForce
from elastic_strips.strip.deformer import Deformer
from elastic_strips.strip.params import DeformParams
from elastic_strips.strip.report import DeformReport
from elastic_strips.strip.workspace import Workspace
from elastic_strips.validation import check_count
from elastic_strips.work import SECONDS_PER, seconds_counted, work_bounds

from .grid_path import DRIVEN_OVER_HEIGHT
from .leaving import MOST_DEPTH

_log = logging.getLogger(__name__)
_MOST_DISTANCE = 1000.0  # [m] longest path that is planned at once; what is longer is likely in millimetres
_FAR_GOAL = 200.0  # [m] a warning is logged for a goal farther away
_ENDLESS_SIZE = 4_000.0  # [m] there is no way round an obstacle of such a size, as stands for the outside of a map
_HUGE_SIZE = 200.0  # [m] a warning is logged for an obstacle of such a size,
_THICK_SIZE = 1.0  # [m] unless it is thinner, as a wall or a floor is
_PASSING_ROOM = 1.0  # [m] beyond the robot that it gets to pass the outermost obstacle
_LEAST_TURNING_ROOM = 2.0  # [m] about start and goal, to turn and to back up
SEED_STRIDE = 7919
"""Between the seeds of one attempt and of the next, so that attempts of neighbouring seeds differ."""
ARM = DeformParams(influence=0.1, near=0.04)
"""Default parameters of an arm's relaxation: in a shelf everything is within 0.3 m and need not all be measured."""
_LEAST_ROOM = 5e-4  # [m] of start and goal, below which no smaller clearance is asked for by itself
_LEAST_TURN_TIME = 0.1  # [s] of an attempt that takes turns with others
_ROUNDED_LOOKS = 1e-2  # that sums of work may be rounded by
_SLOWEST_MACHINE = 20.0  # times modelled time that real time may take
_SHARING_TURNS = 3  # most attempts among which what is left is divided
_AMPLE_ROOM = 0.02  # [m] of start and goal, of which, or of what they have, a path of the joints keeps half
_AMPLE_SELF_ROOM = 0.01  # [m] the same between the robot's own links
_FIRST_NODE_SPACING = 0.13  # [m] between the nodes of a first strip, at most

_Box = tuple[Array, Array]
"""Low and high corner (2,) of an upright box [m]."""


class Deadline:
    """A point in time, ``seconds`` from now; or the point at which a thread has done ``work``, if that comes first.

    Work ends a search at the same place on every machine, whatever else runs there.

    Args:
        seconds: how far ahead it is [s]; of modelled time where that bounds all
            (:func:`elastic_strips.work.bounded_by_work`): then only a search that hangs is ended by real time.
        work: how much the calling thread may compute, as the time [s] that is modelled for it
            (:mod:`elastic_strips.work`); None where work has no bound.
    """

    def __init__(self, seconds: float, work: float | None = None) -> None:
        self._began = perf_counter()
        if work_bounds():
            work = seconds if work is None else min(work, seconds)
            seconds *= _SLOWEST_MACHINE
        self._end = self._began + seconds
        self._most = None if work is None else seconds_counted() + work

    @property
    def of_work(self) -> bool:
        """Whether work is bounded."""
        return self._most is not None

    @property
    def spent(self) -> float:
        """Time [s] since it was set."""
        return perf_counter() - self._began

    @property
    def time_left(self) -> float:
        """Time [s] that is left; negative where it is over."""
        return self._end - perf_counter()

    @property
    def left(self) -> float:
        """Time [s] that is left, or modelled time of the work that is left, if that is less; negative if it is over."""
        return self.time_left if self._most is None else min(self.time_left, self._most - seconds_counted())

    @property
    def looks_left(self) -> float:
        """Configurations that the work that is left lets a tree search look at; infinite where only time is bounded."""
        if self._most is None:
            return math.inf
        paid = (self._most - seconds_counted()) / SECONDS_PER["looks"]
        return max(math.floor(paid + _ROUNDED_LOOKS), 0.0)

    def over(self) -> bool:
        """Whether nothing is left."""
        return self.left <= 0.0

    def within(self, seconds: float) -> Deadline:
        """An earlier deadline, after this many seconds of work if that is bounded, else of time."""
        if self._most is None:
            return Deadline(min(seconds, self.left))
        return Deadline(self.time_left, min(seconds, self._most - seconds_counted()))

    @contextmanager
    def paused(self) -> Iterator[None]:
        """What is computed meanwhile does not count as work; time goes on."""
        before = seconds_counted()
        yield
        if self._most is not None:
            self._most += seconds_counted() - before

    def turn(self, waiting: int) -> tuple[float, float]:
        """For the next of so many attempts that take turns: the time [s] that is left, and its share of what is left.

        At most three share it, so that the first ones, which are the likeliest, get enough.
        """
        time, left = (max(s, _LEAST_TURN_TIME) for s in (self.time_left, self.left))
        return time, left / min(_SHARING_TURNS, waiting)


class PlanningProblem:
    """A checked planning problem.

    Args:
        robot: the robot.
        scene: the obstacles, as they stand.
        start, goal: configurations (nq,).
        params: parameters of the relaxation; where None, and there is no deformer, the default preset with no more
            clearance than half of what start and goal have, if that is more than 0.5 mm.
        deformer: a workspace of the same robot to use again; its parameters count, not ``params``.
        bounds: corners ((x, y), (x, y)) [m] of a box that the base does not leave, or None.
        seed: seed of random numbers.
        timeout: longest time for everything [s].
        work: largest amount of work for everything, in modelled seconds; None where that has no bound.
        backward: whether ways may lead backwards where there is room to turn.
        constraint: constraint that every configuration on the way satisfies, or None; not together with a deformer,
            which has its own.

    Attributes:
        constraint: the constraint as a force on strips, or None.
        endpoints: (2, nq) start and goal.
        region: region in which the base is looked for; None for a fixed base.
        deadline: end of time or work.
        spacing: distance between the nodes of a first strip [m].
        room, self_room: distances [m] of the robot from obstacles, and of its own links from each other, at the start
            or the goal, as far as a planner makes use of them.
        eased: a phrase that says how much less than the default clearance is asked for, and why; else empty.

    Raises:
        RobotError, SceneError: not a robot, or not a scene; a constraint that names an obstacle that is not there.
        ConfigurationError: start or goal is not valid, in collision, too far away or outside the bounds, or does not
            satisfy the constraint; names the pair, or the distance.
        ParameterError: a seed, timeout or bounds outside its range, something that is not a deformer of this robot, or
            a constraint together with a deformer.
    """

    start: Array
    goal: Array

    def __init__(
        self,
        robot: RobotModel,
        scene: Scene,
        start: npt.ArrayLike,
        goal: npt.ArrayLike,
        *,
        params: DeformParams | None = None,
        deformer: Deformer | None = None,
        bounds: npt.ArrayLike | None = None,
        seed: int = 0,
        timeout: float = 10.0,
        work: float | None = None,
        backward: bool = True,
        constraint: AxisConstraint | None = None,
    ) -> None:
        self.seed: int = check_count("seed", seed)
        self.backward: bool = backward
        seconds = _checked_seconds("timeout", timeout)
        most_work = None if work is None else _checked_seconds("work", work)
        self.deadline: Deadline = Deadline(seconds, most_work)
        check_kinds(robot, scene)
        if deformer is not None:
            _check_deformer(deformer, robot, constraint)
        self.robot: RobotModel = robot
        self.scene: Scene = scene
        own = DeformParams() if robot.space.planar else ARM
        self.deformer: Deformer = deformer or Deformer(robot, own if params is None else params, constraint=constraint)
        self.constraint: ConstraintForce | None = self.deformer.constraint
        if self.constraint is not None:
            self.constraint.find(scene)
        self.params: DeformParams = self.deformer.params
        self.start, self.goal = _checked_ends(robot, start, goal, self.params)
        self.endpoints: Array = np.stack((self.start, self.goal))
        room = self._room()
        nearest: list[Near] = []
        if room is None:
            nearest = nearest_things(self.deformer.workspace, robot, scene, (self.start, self.goal))
        self.eased: str = ""
        if params is None and deformer is None:
            self.eased = ease(self.deformer, nearest)
            self.params = self.deformer.params
        for near in nearest:
            near.check(self.params)
        ample = {"clearance": _AMPLE_ROOM if room is None else room, "self_clearance": _AMPLE_SELF_ROOM}
        self.room, self.self_room = (
            min((near.distance for near in nearest if near.bound == bound and near.distance < most), default=most)
            for bound, most in ample.items()
        )
        self.region: Region | None = Region(robot, scene, self.start, self.goal, bounds) if robot.space.planar else None
        if self.constraint is not None:
            self.constraint.check(self.endpoints, ("start", "goal"))
        if self.region is None and bounds is not None:
            raise ParameterError(f"bounds={bounds!r}: the base of {robot.name!r} is fixed; leave them out")
        self.spacing: float = min(_FIRST_NODE_SPACING, self.params.max_spacing)

    def _room(self) -> float | None:
        """Distance [m] of start and goal from obstacles, where it is enough, and ample between the robot's own links:
        so it is with most, and the spheres prove it."""
        _warn_of_size(self.scene)
        return self.deformer.workspace.room_at(
            self.robot.space.to_coordinates(self.endpoints),
            self.scene,
            clearance=self.params.clearance,
            self_clearance=max(_AMPLE_SELF_ROOM, self.params.self_clearance),
            most=_AMPLE_ROOM,
        )

    def satisfying(self, coordinates: Array) -> Array:
        """Rows (N, nv), the inner ones moved to where they satisfy the constraint if there is one."""
        if self.constraint is None:
            return coordinates
        return self.constraint.project_path(coordinates)

    def missed(self, report: DeformReport) -> str:
        """A phrase that says where a strip misses the constraint, and by how much; empty where it does not."""
        return "" if self.constraint is None else self.constraint.missed(report.strip)

    def aside(self, strip: Strip) -> float:
        """How far [m] the base leaves the caller's bounds on a strip; 0 without bounds."""
        return 0.0 if self.region is None else self.region.left_by(strip)

    def failure(self, report: DeformReport) -> str:
        """Why a relaxed strip is unusable; empty where it is certified, its base keeps to the bounds, and it satisfies
        the constraint if there is one."""
        if not report.usable:
            return report.reason
        missed = self.missed(report)
        if missed:
            return missed
        aside = self.aside(report.strip)
        return f"the base leaves the bounds by {aside:.3f} m" if aside > 0.0 else ""


def _checked_seconds(what: str, given: float) -> float:
    number = isinstance(given, (int, float, np.integer, np.floating)) and not isinstance(given, bool)
    if not number or not given > 0:
        raise ParameterError(f"{what}={given!r} must be a number > 0 of seconds")
    return float(given)


def _check_deformer(deformer: Deformer, robot: RobotModel, constraint: AxisConstraint | None) -> None:
    if not isinstance(deformer, Deformer):
        raise ParameterError(f"deformer is a {type(deformer).__name__}; it must be a Deformer of the same robot")
    if not robot.same_as(deformer.robot):
        raise ParameterError(f"deformer is of robot {deformer.robot.name!r}; it must be of {robot.name!r}")
    if constraint is not None:
        raise ParameterError("constraint: a deformer brings its own: Deformer(robot, params, constraint=…)")


def check_kinds(robot: RobotModel, scene: Scene) -> None:
    if not isinstance(robot, RobotModel):
        raise RobotError(f"robot is a {type(robot).__name__}; it must be a RobotModel, as load_robot(...) gives it")
    if not isinstance(scene, Scene):
        raise SceneError(f"scene is a {type(scene).__name__}; it must be a Scene: Scene([...])")


def check_endpoints(
    robot: RobotModel,
    scene: Scene,
    start: npt.ArrayLike,
    goal: npt.ArrayLike,
    params: DeformParams,
    deformer: Deformer | None = None,
) -> tuple[Array, Array]:
    """Check start and goal: valid configurations (nq,) that keep the clearances of ``params``.

    A warning is logged for very far goals and very large obstacles: lengths are in metres.

    Args:
        robot: the robot.
        scene: the obstacles, as they stand.
        start, goal: configurations (nq,).
        params: parameters with the clearances to keep.
        deformer: a workspace of the robot to use again, where this is asked often; its contents are lost.

    Returns:
        Start and goal as arrays.

    Raises:
        RobotError, SceneError: not a robot, or not a scene.
        ConfigurationError: the message names the fault: the entry, the pair that is too close and its distance, or how
            far the goal is away.
    """
    check_kinds(robot, scene)
    ends = _checked_ends(robot, start, goal, params)
    for near in nearest_things((deformer or Deformer(robot, params)).workspace, robot, scene, ends):
        near.check(params)
    return ends


def _checked_ends(
    robot: RobotModel, start: npt.ArrayLike, goal: npt.ArrayLike, params: DeformParams
) -> tuple[Array, Array]:
    ends = [one_configuration(robot, given, what) for what, given in (("start", start), ("goal", goal))]
    if robot.space.planar:
        _check_distance(float(np.hypot(*(ends[1] - ends[0])[:2])), params)
    return ends[0], ends[1]


def one_configuration(robot: RobotModel, given: npt.ArrayLike, what: str) -> Array:
    """A valid configuration (nq,).

    Raises:
        ConfigurationError: it is not valid, or there are several.
    """
    q = robot.check_q(given, what=what)
    if q.ndim != 1:
        raise ConfigurationError(f"{what} has shape {q.shape}; it must be one configuration ({robot.nq},)")
    return q


@dataclass(frozen=True, slots=True)
class Near:
    """The nearest pair at the start or goal: a link and an obstacle, or two links (``bound`` is ``self_clearance``)."""

    what: str
    bound: str
    distance: float
    one: str
    two: str

    def check(self, params: DeformParams) -> None:
        """Refuse a pair that touches, or is nearer than the parameters allow."""
        clearance = float(getattr(params, self.bound))
        if self.distance < 0:
            slight = self.what == "start" and -self.distance < MOST_DEPTH
            way = "; start_depth=… [m] of plan has such a start left (run --start-depth)" if slight else ""
            raise ConfigurationError(
                f"{self.what} is in collision: {self.one!r} is {-self.distance * 1000:.1f} mm deep in {self.two!r}{way}"
            )
        if self.distance <= clearance:
            raise ConfigurationError(
                f"{self.what} is too close: {self.one!r} is {self.distance * 1000:.1f} mm from {self.two!r}; more than "
                f"{clearance * 1000:.1f} mm ({self.bound}) are needed; "
                f"params=DeformParams({self.bound}=…) asks for less, down to 0"
            )


@exclusive
def nearest_things(work: Workspace, robot: RobotModel, scene: Scene, ends: tuple[Array, Array]) -> list[Near]:
    """The nearest obstacle and the nearest two links at start and goal, measured in a deformer's workspace."""
    _warn_of_size(scene)
    work.prediction = None
    work.replace(robot.space.to_coordinates(np.stack(ends)), scene)
    obstacles, own, found = work.obstacles, work.self_pairs, []
    bodies, bound = work.bodies, obstacles.bound
    for node, what in enumerate(("start", "goal")):
        if bound[node].size:
            body, part = divmod(int(np.argmin(bound[node])), bound.shape[2])
            other = obstacles.obstacle_name(part)
            found.append(Near(what, "clearance", float(bound[node, body, part]), bodies.labels[body], other))
        if own.bound[node].size:
            pair = int(np.argmin(own.bound[node]))
            one, two = (bodies.labels[k] for k in own.pairs[pair])
            found.append(Near(what, "self_clearance", float(own.bound[node, pair]), one, two))
    return found


def ease(deformer: Deformer, nearest: list[Near]) -> str:
    """Ask for no more clearance than half of what start and goal have; the text says so where that is less."""
    least, said = {"clearance": deformer.params.clearance, "self_clearance": deformer.params.self_clearance}, []
    for near in sorted(nearest, key=lambda near: near.distance):
        if _LEAST_ROOM < near.distance <= least[near.bound]:
            least[near.bound] = 0.5 * near.distance
            said.append(
                f"proven with {1e3 * least[near.bound]:.2g} mm, as at the {near.what} {near.one!r} is "
                f"{1e3 * near.distance:.2g} mm from {near.two!r}"
            )
    if said:
        deformer.keep_clearance(**least)
    return "; ".join(said)


def _check_distance(distance: float, params: DeformParams) -> None:
    if distance > _MOST_DISTANCE:
        raise ConfigurationError(
            f"goal is {distance:.6g} m from start, more than the {_MOST_DISTANCE:g} m that are planned at once; "
            "lengths are in metres (are these millimetres?), and a longer way takes goals in between"
        )
    if distance > _FAR_GOAL:
        _warn_once(
            f"goal is {distance:.6g} m from start: lengths are in metres; a strip has at most {params.max_nodes} nodes "
            "(max_nodes)"
        )


def _warn_of_size(scene: Scene) -> None:
    table = scene.table
    if table.half_extents.max(initial=0.0) <= 0.5 * _HUGE_SIZE:
        return
    size = 2.0 * table.half_extents
    huge = (size.max(axis=1, initial=0.0) > _HUGE_SIZE) & (size.min(axis=1, initial=np.inf) > _THICK_SIZE)
    if huge.any():
        k = int(np.argmax(np.where(huge, size.max(axis=1), 0.0)))
        x, y, z = size[k]
        name = scene.names[int(table.obstacle_index[k])]
        if name.startswith("outside-of-map"):  # it is made so, and is the largest there is
            return
        _warn_once(f"obstacle {name!r} is {x:.6g} m × {y:.6g} m × {z:.6g} m large: lengths are in metres")


def warn_of_floor(robot: RobotModel, rows: Array) -> None:
    """Say in the log, once for each link, that rows (N, nv) of a plan lead it into the floor."""
    below = below_floor(robot, rows)
    if below is not None:
        _warn_once(
            f"{robot.name}: {below.link} is planned below the floor on which the robot stands ({below.height}): "
            "the floor is an obstacle only where the scene has one"
        )


@lru_cache(maxsize=64)
def _warn_once(message: str) -> None:
    """Log a warning once: a planner may be called at every tick."""
    _log.warning("%s", message)


class Region:
    """Boxes of the plane in which the base is looked for.

    Without bounds a box about start and goal is widened until it holds all obstacles and a path around them.

    Args:
        robot: the robot; its base must move.
        scene: the obstacles.
        start, goal: configurations (nq,).
        bounds: low and high corner ((x, y), (x, y)) [m] of a box that the base does not leave.

    Attributes:
        given: the caller's bounds, or None.
        cover: the box beyond which there is nothing to pass; the bounds where they are given.
        folded: radius [m] of the disc about the base that holds the robot in the smaller of the postures at the start
            and at home.

    Raises:
        ParameterError: bounds of another shape, not finite, or empty.
        ConfigurationError: start or goal is outside the bounds.
    """

    def __init__(
        self, robot: RobotModel, scene: Scene, start: Array, goal: Array, bounds: npt.ArrayLike | None = None
    ) -> None:
        self.endpoints: Array = robot.space.to_coordinates(np.stack((start, goal)))[:, :2]
        self.given: _Box | None = None if bounds is None else _checked_bounds(bounds, self.endpoints)
        cover = self._cover(robot, scene, start, goal)
        self.cover: _Box = cover if self.given is None else self.given

    def _cover(self, robot: RobotModel, scene: Scene, start: Array, goal: Array) -> _Box:
        footprint, postures = PlanarFootprint(robot), []
        for row in robot.space.to_coordinates(np.stack((start, goal, robot.home_q))):
            footprint.update(row)
            postures.append((footprint.outer, footprint.height))
        self.folded: float = min(postures[0][0], postures[2][0])
        outer, height = np.max(postures, axis=0)
        table = scene.table
        low, high = table.center - table.half_extents, table.center + table.half_extents
        counts = (
            (low[:, 2] < height)
            & (high[:, 2] > DRIVEN_OVER_HEIGHT)
            & ((high - low).max(axis=1, initial=0.0) < _ENDLESS_SIZE)
        )
        least, room = max(_LEAST_TURNING_ROOM, outer + _PASSING_ROOM), outer + _PASSING_ROOM
        corners = np.vstack(
            (self.endpoints - least, self.endpoints + least, low[counts, :2] - room, high[counts, :2] + room)
        )
        return np.min(corners, axis=0), np.max(corners, axis=0)

    def box(self, widen: float) -> _Box:
        """The box that reaches ``widen`` [m] beyond start and goal, no further than any obstacle; or the bounds."""
        low, high = self.cover
        if self.given is None:
            low = np.maximum(low, self.endpoints.min(axis=0) - widen)
            high = np.minimum(high, self.endpoints.max(axis=0) + widen)
        return low, high

    def boxes(self, widen: float) -> Iterator[_Box]:
        """Boxes that reach ``widen`` [m] beyond start and goal, then twice as far, until one holds everything."""
        while True:
            low, high = self.box(widen)
            yield low, high
            if np.array_equal(low, self.cover[0]) and np.array_equal(high, self.cover[1]):
                return
            widen *= 2.0

    def left_by(self, strip: Strip) -> float:
        """How far [m] the base leaves the caller's bounds on a strip; 0 without bounds."""
        if self.given is None:
            return 0.0
        low, high = self.given
        path = strip.robot.space.to_coordinates(strip.sample(0.1))[:, :2]
        return float(max((low - path).max(), (path - high).max(), 0.0))


def _checked_bounds(bounds: npt.ArrayLike, endpoints: Array) -> _Box:
    try:
        corners = np.array(bounds, dtype=float)
    except (TypeError, ValueError):
        corners = np.zeros(0)
    if corners.shape != (2, 2) or not np.isfinite(corners).all():
        raise ParameterError(f"bounds={bounds!r} must be ((x, y), (x, y)): two corners of finite numbers [m]")
    low, high = corners[0], corners[1]
    if not (low < high).all():
        raise ParameterError(f"bounds={bounds!r}: the first corner must lie below the second in x and y")
    for what, at in zip(("start", "goal"), endpoints, strict=True):
        if (at < low).any() or (at > high).any():
            raise ConfigurationError(
                f"{what}: the base at x={at[0]:.6g}, y={at[1]:.6g} m is outside bounds={corners.tolist()}"
            )
    return low, high
