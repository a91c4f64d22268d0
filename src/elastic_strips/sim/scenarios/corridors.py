"""Seeded corridors: 8 m of clutter that blocks the straight line of the whole body; with and without moving obstacles.

In the moving corridor obstacles appear, cross, come head-on and wander. They do not yield: they pass through the robot,
each other and static clutter. A robot that waits can pass in the end, as every mover leaves the corridor, by
`MOVERS_GONE_TIME` at the latest.

In the *courteous* corridor the same movers stop for a robot at rest in their path, and continue when it is gone.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.catalogue import SCENARIOS
from elastic_strips.errors import ScenarioError
from elastic_strips.io import PoseSpec
from elastic_strips.scene import (
    Box,
    Capsule,
    Cone,
    ConvexHull,
    Cylinder,
    Keyframes,
    Motion,
    Obstacle,
    PedestrianMotion,
    Scene,
    Sphere,
    World,
)
from elastic_strips.validation import check_array

from .scenario import Scenario

CORRIDOR_LENGTH = 8.0
"""Distance [m] from start to goal, along x."""
HALF_WIDTH = 2.0
"""Half the distance [m] between the two walls."""
_OBSTACLE_COUNT = 32  # walls included
_BLOCKER_COUNT = 4  # on the straight line
_PASSAGE_HALF_WIDTH = 0.56
"""Half width [m] kept free about the guide curve: base radius, arm and room to turn."""
_FREE_ENDS_RADIUS = 0.95  # radius [m] about start and goal kept free: robot and influence distance
_CURVE_STEPS = 400


def corridor_scene(seed: int = 0, *, obstacles: int = _OBSTACLE_COUNT) -> Scene:
    """Two walls and boxes, cylinders, capsules, cones, hulls and spheres, standing and hanging, from x = 0 to x = 8 m.

    A smooth random guide curve from start to goal is kept free, so that a path exists; some obstacles are on the
    straight line beside it. Start (0, 0) and goal (8, 0) have a free disc.

    Args:
        seed: seed of the generator.
        obstacles: number of obstacles, walls included.

    Raises:
        ScenarioError: fewer obstacles than walls and blockers.
    """
    if obstacles < 2 + _BLOCKER_COUNT:
        raise ScenarioError(
            f"corridor: obstacles={obstacles} must be at least {2 + _BLOCKER_COUNT}: "
            f"two walls, {_BLOCKER_COUNT} blockers"
        )
    rng = np.random.default_rng(seed)
    guide = _guide(rng)
    items: list[Obstacle] = [
        Box((CORRIDOR_LENGTH + 3.0, 0.1, 1.2), at=(CORRIDOR_LENGTH / 2, side * (HALF_WIDTH + 0.05), 0.6), name=name)
        for side, name in ((1.0, "wall-left"), (-1.0, "wall-right"))
    ]
    blockers = 0
    kinds = ("box", "cylinder", "capsule", "cone", "convex", "sphere", "hanging-box", "hanging-sphere")
    for _attempt in range(20_000):
        if len(items) == obstacles:
            return Scene(items)
        block = blockers < _BLOCKER_COUNT
        kind = kinds[int(rng.integers(6 if block else len(kinds)))]
        radius = float(rng.uniform(0.1, 0.28))
        x = float(rng.uniform(0.0, CORRIDOR_LENGTH)) if not block else float(rng.uniform(1.2, CORRIDOR_LENGTH - 1.2))
        y = float(rng.uniform(-0.12, 0.12)) if block else float(rng.uniform(-HALF_WIDTH, HALF_WIDTH))
        free = np.min(np.hypot(guide[:, 0] - x, guide[:, 1] - y))
        if (
            free < radius + _PASSAGE_HALF_WIDTH
            or min(np.hypot(x, y), np.hypot(x - CORRIDOR_LENGTH, y)) < radius + _FREE_ENDS_RADIUS
        ):
            continue
        items.append(_obstacle(kind, radius, x, y, rng, f"{kind}-{len(items)}"))
        blockers += block
    raise ScenarioError(f"corridor: seed {seed} found no room for {obstacles} obstacles; ask for fewer")


def corridor_guide(seed: int) -> Array:
    """The curve (K, 2) [m] from start to goal about which the corridor of that seed is free."""
    return _guide(np.random.default_rng(seed))


def _guide(rng: np.random.Generator) -> Array:
    """A smooth curve from start to goal that swings to both sides: (K, 2)."""
    x = np.linspace(0.0, CORRIDOR_LENGTH, _CURVE_STEPS)
    envelope = np.sin(np.pi * x / CORRIDOR_LENGTH) ** 0.5
    waves = rng.integers(1, 3)
    y = envelope * float(rng.uniform(0.95, 1.25)) * np.sin(np.pi * waves * x / CORRIDOR_LENGTH + rng.uniform(-0.3, 0.3))
    if rng.random() < 0.5:
        y = -y
    return np.column_stack((x, np.clip(y, -HALF_WIDTH + 0.62, HALF_WIDTH - 0.62)))


def _obstacle(kind: str, radius: float, x: float, y: float, rng: np.random.Generator, name: str) -> Obstacle:
    height = float(rng.uniform(0.35, 1.5))
    yaw = float(rng.uniform(-np.pi, np.pi))
    quat = (0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
    side = radius * np.sqrt(2.0)
    if kind == "box":
        return Box((side, side, height), at=(x, y, height / 2), quat=quat, name=name)
    if kind == "cylinder":
        return Cylinder(radius, height, at=(x, y, height / 2), name=name)
    if kind == "capsule":
        return Capsule(radius, height, at=(x, y, radius + height / 2), name=name)
    if kind == "cone":
        return Cone(radius, height, at=(x, y, height / 2), name=name)
    if kind == "convex":
        angle = np.sort(rng.uniform(0, 2 * np.pi, 5)) + np.arange(5) * 1e-3
        ring = radius * np.column_stack((np.cos(angle), np.sin(angle)))
        ring = np.vstack((ring, radius * np.array([[1, 0], [-0.5, 0.8], [-0.5, -0.8]])))
        low = np.column_stack((ring, np.full(len(ring), -height / 2)))
        high = np.column_stack((0.6 * ring, np.full(len(ring), height / 2)))
        return ConvexHull(np.vstack((low, high)), at=(x, y, height / 2), name=name)
    if kind == "sphere":
        return Sphere(radius, at=(x, y, radius), name=name)
    if kind == "hanging-box":
        return Box((side, side, 0.4), at=(x, y, float(rng.uniform(0.9, 1.5))), quat=quat, name=name)
    return Sphere(radius, at=(x, y, float(rng.uniform(0.8, 1.4))), name=name)


_TRACK_PIECES = 10
"""Pieces between two keyframes of such a track."""


def _smooth_stop(places: Array, frame: float, acceleration: float) -> Array:
    """A track (K, 2) with a stop at its end, and smooth: `_TRACK_PIECES` places a frame, each the mean over one frame.

    So the velocity changes in steps that are small beside what braking adds to them; no place moves by half a
    millimetre.
    """
    velocity = (places[-1] - places[-2]) / frame
    speed = float(np.hypot(*velocity))
    slower = speed - acceleration * frame * np.arange(1, math.ceil(speed / (acceleration * frame)))
    stop = places[-1] + frame * np.cumsum(np.outer(slower, velocity / speed), axis=0)
    first, last = 2.0 * places[0] - places[1], stop[-1] if len(stop) else places[-1]
    p = np.vstack((first, places, stop, last, last))
    i = np.arange(_TRACK_PIECES * (len(p) - 3) + 1)
    k = (i + _TRACK_PIECES // 2) // _TRACK_PIECES
    u = (i / _TRACK_PIECES - k)[:, None]
    bend = p[k + 2] - 2.0 * p[k + 1] + p[k]
    return p[k + 1] + 0.5 * u * (p[k + 2] - p[k]) + (0.5 * u * u + 0.125) * bend


MOVING = "moving-corridor"
COURTEOUS = "courteous-corridor"
"""The name of the corridor in which movers yield."""
MOVER_ACCELERATION = 0.4
"""Largest change of a mover's velocity [m/s²], in any direction."""
KEYFRAME_PERIOD = 0.1
"""Time between two keyframes of a mover [s]."""
COURTEOUS_SPEEDS = (0.2, 0.6)
"""Range of the speed class in that corridor [m/s]; faster movers can often not stop in time."""
YIELDING_ACCELERATION = 0.46
"""Largest acceleration of a mover that yields, its turns included [m/s²].

More than `MOVER_ACCELERATION`, so that it can brake in a turn, and a little less than the 0.5 m/s² that a robot
assumes.
"""
MOVERS_GONE_TIME = 60.0
"""Time [s] at which all movers are gone."""
_MOVER_COUNTS = (1, 8)
"""Smallest and largest number of movers."""
MOVER_SPEEDS = (0.2, 1.5)
"""Default range from which the speed class is drawn [m/s]."""
APPEAR_DISTANCE = 2.0
"""Least distance [m] at which a mover appears from where the robot can be, beside its travel in `REACTION_TIME`.

A collision with a mover that appears within the robot's stopping distance cannot be avoided. 2 m hold the reach of the
robot (0.8 m), its braking distance from 1 m/s at 1.2 m/s² (0.42 m) and its travel during sensing (0.2 s), and leave
0.58 m. Until it stands, 0.83 s later, the mover travels less than in `REACTION_TIME`.
"""
REACTION_TIME = 1.0
"""See `APPEAR_DISTANCE` [s]."""

_ASSUMED_PACE = 0.6  # [m/s] speed of the robot along x that is assumed by movers that aim at it
_GOAL_FREE = 1.0  # [m] between the goal and a mover that exists from the beginning
_WALL_OVERHANG = 1.5  # [m] length of the walls beyond start and goal
_GONE_DISTANCE = 0.6  # [m] between the corridor and a mover when it is gone
_MOST_ATTEMPTS = 2000

_Point = tuple[float, float]
_Target = Callable[[float, _Point], _Point]  # wanted velocity [m/s] at a time [s] and place [m]


@dataclass(frozen=True, slots=True)
class _Body:
    """Shape of a mover: its kind, its radius from above [m], and a function that makes it along a motion."""

    kind: str
    radius: float
    height: float  # of its origin [m]
    make: Callable[[str, Motion, tuple[float, float, float, float]], Obstacle]


@dataclass(frozen=True, slots=True)
class _Course:
    """Place and velocity at which a mover appears, and its wanted velocities."""

    begin: float
    start: _Point
    velocity: _Point
    target: _Target


def moving_corridor(
    seed: int = 0, count: int | None = None, speed: tuple[float, float] = MOVER_SPEEDS, *, yielding: bool = False
) -> Scenario:
    """The corridor of that seed with moving obstacles, called movers here.

    `Scenario.world` holds them, `Scenario.scene` those that exist at time 0.

    A third of the movers aim at the robot's place if it advances at 0.6 m/s: they cross its path, or come head-on and
    turn aside afterwards. The others wander. They are persons, carts, balls and hanging loads, the last at the height
    of the arm only. Each exists from the beginning, away from the start, or appears later, outside the corridor; see
    `APPEAR_DISTANCE`.

    Args:
        seed: Seed of the generator.
        count: Number of movers, 1 to 8; drawn at random where None.
        speed: Range [m/s] from which `Scenario.speed_class` is drawn, the bound of the movers' speeds.
        yielding: Whether the movers stop for a robot at rest. Then none vanishes, as the time at which it leaves is
            not known: it comes to rest outside.

    Raises:
        ScenarioError: A seed, count or speed outside its range.
    """
    _check(seed, count, speed)
    rng = np.random.default_rng([seed, 60])
    low, high = float(speed[0]), float(speed[1])
    fastest = float(rng.uniform(low, high))
    number = int(rng.integers(_MOVER_COUNTS[0], _MOVER_COUNTS[1] + 1))
    count = number if count is None else int(count)
    aimed = max(1, round(count / 3))
    guide = corridor_guide(seed)
    static = corridor_scene(seed)
    obstacles: list[Obstacle] = list(static)
    appears, vanishes = {}, {}
    for k in range(count):
        course = (("crossing", _crossing), ("head-on", _head_on))[int(rng.integers(2))] if k < aimed else ("", _wander)
        obstacle, begin, end = _mover(k, course, max(low, 0.5 * fastest), fastest, guide, rng, yielding)
        obstacles.append(obstacle)
        assert obstacle.name is not None
        if begin > 0.0:
            appears[obstacle.name] = begin
        if not yielding:
            vanishes[obstacle.name] = end
    world = World(Scene(obstacles), appears, vanishes)
    name, start, goal = COURTEOUS if yielding else MOVING, PoseSpec(0.0, 0.0, 0.0), PoseSpec(CORRIDOR_LENGTH, 0.0, 0.0)
    return Scenario(name, SCENARIOS[name], world.at(0.0), start, goal, seed=seed, timeline=world, speed_class=fastest)


def _check(seed: int, count: int | None, speed: tuple[float, float]) -> None:
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise ScenarioError(f"{MOVING}: seed={seed!r} must be an integer ≥ 0")
    whole = isinstance(count, (int, np.integer)) and not isinstance(count, bool)
    if count is not None and not (whole and _MOVER_COUNTS[0] <= count <= _MOVER_COUNTS[1]):
        raise ScenarioError(
            f"{MOVING}: count={count!r} must be an integer from {_MOVER_COUNTS[0]} to {_MOVER_COUNTS[1]}"
        )
    try:
        low, high = check_array("speed", speed, (2,)).tolist()
    except ValueError as error:
        raise ScenarioError(f"{MOVING}: {error}") from None
    if not MOVER_SPEEDS[0] <= low <= high <= MOVER_SPEEDS[1]:
        raise ScenarioError(f"{MOVING}: speed={speed!r} must be a range [low, high] within {MOVER_SPEEDS} m/s")


def _mover(
    k: int,
    course: tuple[str, Callable[[float, _Body, Array, np.random.Generator], _Course | None]],
    low: float,
    high: float,
    guide: Array,
    rng: np.random.Generator,
    yielding: bool,
) -> tuple[Obstacle, float, float]:
    """An obstacle, and the times [s] at which it appears and vanishes; courses are drawn until one is allowed."""
    role, draw = course
    for _attempt in range(_MOST_ATTEMPTS):
        body, top = _body(rng), float(rng.uniform(low, high))
        plan = draw(top, body, guide, rng)
        track = None if plan is None or not _far(plan, body.radius, top, guide) else _track(plan, body.radius)
        if plan is None or track is None:
            continue
        frame = KEYFRAME_PERIOD
        if yielding:
            track, frame = _smooth_stop(track, KEYFRAME_PERIOD, MOVER_ACCELERATION), KEYFRAME_PERIOD / _TRACK_PIECES
        times = plan.begin + frame * np.arange(len(track))
        half = 0.5 * math.atan2(plan.velocity[1], plan.velocity[0])
        motion = Keyframes(times, np.column_stack((track, np.full(len(track), body.height))))
        motion = PedestrianMotion(motion, YIELDING_ACCELERATION) if yielding else motion
        name = f"{role}-{body.kind}-{k}" if role else f"{body.kind}-{k}"
        return body.make(name, motion, (0.0, 0.0, math.sin(half), math.cos(half))), plan.begin, float(times[-1])
    raise ScenarioError(f"{MOVING}: found no course for moving obstacle {k} of at most {high:g} m/s; try another seed")


def _body(rng: np.random.Generator) -> _Body:
    kind = ("person", "cart", "ball", "load")[int(rng.choice(4, p=(0.4, 0.25, 0.1, 0.25)))]
    a, b, c = rng.random(3)
    if kind == "person":
        radius, tall = 0.2 + 0.1 * a, 1.5 + 0.35 * b
        return _Body(kind, radius, tall / 2, lambda n, m, q: Cylinder(radius, tall, name=n, motion=m))
    if kind == "ball":
        radius = 0.2 + 0.15 * a
        return _Body(kind, radius, radius, lambda n, m, q: Sphere(radius, name=n, motion=m))
    size = (0.6 + 0.4 * a, 0.4 + 0.2 * b, 0.8 + 0.3 * c) if kind == "cart" else (0.3 + 0.2 * a, 0.3 + 0.2 * b, 0.3)
    height = size[2] / 2 if kind == "cart" else 1.0 + 0.35 * c
    return _Body(kind, 0.5 * math.hypot(*size[:2]), height, lambda n, m, q: Box(size, quat=q, name=n, motion=m))


def _far(course: _Course, radius: float, top: float, guide: Array) -> bool:
    """Whether a mover appears far enough from where the robot can be then, and at time 0 beside the guide curve."""
    x, y = course.start
    apart = APPEAR_DISTANCE + REACTION_TIME * top + radius
    if course.begin > 0.0:  # the robot may be anywhere in the corridor
        return (
            math.hypot(
                max(-_WALL_OVERHANG - x, x - CORRIDOR_LENGTH - _WALL_OVERHANG, 0.0), max(abs(y) - HALF_WIDTH, 0.0)
            )
            >= apart
        )
    free = math.hypot(x - CORRIDOR_LENGTH, y) >= _GOAL_FREE + radius
    aside = float(np.hypot(guide[:, 0] - x, guide[:, 1] - y).min()) >= _PASSAGE_HALF_WIDTH + radius
    return math.hypot(x, y) >= apart and free and aside


def _track(course: _Course, radius: float) -> Array | None:
    """Places (K, 2) [m] at the keyframes, until it has left the corridor; None where it does not enter or not leave."""
    (x, y), (vx, vy) = course.start, course.velocity
    places, entered = [(x, y)], False
    step = MOVER_ACCELERATION * KEYFRAME_PERIOD
    for k in range(round((MOVERS_GONE_TIME - course.begin) / KEYFRAME_PERIOD)):
        wx, wy = course.target(course.begin + KEYFRAME_PERIOD * k, (x, y))
        change = math.hypot(wx - vx, wy - vy)
        share = min(1.0, step / change) if change > 0.0 else 0.0
        vx, vy = vx + share * (wx - vx), vy + share * (wy - vy)
        x, y = x + KEYFRAME_PERIOD * vx, y + KEYFRAME_PERIOD * vy
        places.append((x, y))
        gap = max(abs(y) - HALF_WIDTH, -_WALL_OVERHANG - x, x - CORRIDOR_LENGTH - _WALL_OVERHANG)
        entered = entered or gap < 0.0
        if entered and gap > radius + _GONE_DISTANCE:
            return np.array(places)
    return None


def _crossing(top: float, body: _Body, guide: Array, rng: np.random.Generator) -> _Course:
    """Straight across the robot's path to its place then; afterwards a little aside and out."""
    meet = float(rng.uniform(3.0, 12.0))
    begin = 0.0 if rng.random() < 0.5 else round(float(rng.uniform(0.5, 0.7 * meet)), 1)
    aim = _on_way(_ASSUMED_PACE * meet + float(rng.uniform(-0.4, 0.4)), guide, float(rng.uniform(-0.3, 0.3)))
    angle = (0.5 if rng.random() < 0.5 else -0.5) * math.pi + float(rng.uniform(-0.6, 0.6))
    velocity = (top * math.cos(angle), top * math.sin(angle))
    start = (aim[0] - velocity[0] * (meet - begin), aim[1] - velocity[1] * (meet - begin))
    later = _polar(float(rng.uniform(0.6, 1.0)) * top, angle + float(rng.uniform(-0.5, 0.5)))
    return _Course(begin, start, velocity, lambda t, at: velocity if t < meet else later)


def _head_on(top: float, body: _Body, guide: Array, rng: np.random.Generator) -> _Course | None:
    """From beyond the goal towards the robot; some time after they have met it turns aside and leaves.

    None where the robot would be at its goal before.
    """
    begin = 0.0 if rng.random() < 0.5 else round(float(rng.uniform(0.5, 5.0)), 1)
    near = _GOAL_FREE + 0.2 if begin == 0.0 else _WALL_OVERHANG + APPEAR_DISTANCE + REACTION_TIME * top
    x = CORRIDOR_LENGTH + near + body.radius + float(rng.uniform(0.0, 2.0))
    start = (x, float(rng.uniform(-0.6, 0.6)))
    meet = (x + top * begin) / (top + _ASSUMED_PACE)
    if _ASSUMED_PACE * meet > CORRIDOR_LENGTH - 0.5:
        return None
    aim = _on_way(_ASSUMED_PACE * meet, guide, 0.0)
    way = math.hypot(aim[0] - start[0], aim[1] - start[1])
    velocity = (top * (aim[0] - start[0]) / way, top * (aim[1] - start[1]) / way)
    turn = meet + float(rng.uniform(0.5, 2.0))
    aside = _polar(top, (0.5 if rng.random() < 0.5 else -0.5) * math.pi)
    return _Course(begin, start, velocity, lambda t, at: velocity if t < turn else aside)


def _wander(top: float, body: _Body, guide: Array, rng: np.random.Generator) -> _Course:
    """To random places at changing speed, with rests of a few seconds; after a while out by the nearer side."""
    begin = 0.0 if rng.random() < 0.5 else round(float(rng.uniform(0.5, 8.0)), 1)
    start = (float(rng.uniform(-1.0, CORRIDOR_LENGTH + 1.0)), float(rng.uniform(-HALF_WIDTH, HALF_WIDTH)))
    if begin > 0.0:
        outside = HALF_WIDTH + APPEAR_DISTANCE + REACTION_TIME * top + body.radius + float(rng.uniform(0.0, 1.0))
        start = (start[0], math.copysign(outside, start[1]))
    leave = begin + float(rng.uniform(12.0, 28.0))
    changes = np.cumsum(rng.uniform(2.0, 5.0, 12)) + begin
    places = np.column_stack((rng.uniform(0.5, CORRIDOR_LENGTH - 0.5, 13), rng.uniform(-1.5, 1.5, 13)))
    paces = top * np.where(rng.random(13) < 0.2, 0.0, rng.uniform(0.4, 1.0, 13))
    paces[0] = max(paces[0], 0.4 * top)

    def target(t: float, at: _Point) -> _Point:
        if t >= leave:
            return 0.0, math.copysign(top, at[1])
        k = int(np.searchsorted(changes, t, side="right"))
        dx, dy = places[k, 0] - at[0], places[k, 1] - at[1]
        way = math.hypot(dx, dy)
        pace = min(float(paces[k]), way)  # slower at the place
        return (pace * dx / way, pace * dy / way) if way > 1e-6 else (0.0, 0.0)

    return _Course(begin, start, target(begin, start), target)


def _on_way(x: float, guide: Array, aside: float) -> _Point:
    """A point of the guide curve, at ``x`` or the nearest one away from start and goal."""
    x = min(max(x, 1.0), CORRIDOR_LENGTH - 1.0)
    return x, float(np.interp(x, guide[:, 0], guide[:, 1])) + aside


def _polar(length: float, angle: float) -> _Point:
    return length * math.cos(angle), length * math.sin(angle)
