"""Static scenarios: a cluttered room (seeded), a side that closes, a narrow door, and a dead end.

In the last two, local methods get stuck, as the paper states.
"""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.catalogue import SCENARIOS
from elastic_strips.errors import ScenarioError
from elastic_strips.io import PoseSpec
from elastic_strips.scene import Box, Cylinder, Obstacle, Scene
from elastic_strips.scene.motion import Twist

from .scenario import Scenario

CLUTTER = "clutter"
CLUTTER_START, CLUTTER_GOAL = (0.0, -1.2), (6.0, 1.2)
"""Where the base starts and ends [m], on two sides of the room."""
CLUTTER_HALF_WIDTH = 2.3
"""Half the distance [m] between the walls."""
CLUTTER_GOAL_ARM = {
    "arm_1_joint": 0.61,
    "arm_2_joint": 0.25,
    "arm_3_joint": -0.58,
    "arm_4_joint": 1.53,
    "arm_5_joint": 0.46,
    "arm_6_joint": -0.36,
    "arm_7_joint": 0.55,
}
"""The arm at the goal: the hand forward, level, above the table [rad]."""
_BLOCKERS, _PILLARS, _TABLES, _SHELVES, _BEAMS = 3, 12, 6, 6, 2  # so many are tried of each kind
_FREE_RADII = {"pillar": 0.38, "table": 0.32, "shelf": 0.36}
"""Half width [m] that each kind leaves free about the guide curve."""
_DOOR_WIDTHS = (0.72, 0.95)  # least and largest width of the door [m]
_FREE_ENDS_RADIUS = 0.7  # radius [m] about start and goal that is left free, but for the table at the goal


def clutter(seed: int = 0) -> Scenario:
    """From one side of a room to a table on the other, with the hand above the table at the goal.

    A partition with a narrow door crosses the room. There are pillars, some of them on the straight line, tables and
    shelves at the heights of the arm, and beams above the robot. A smooth random curve is left free, so that a path
    exists for the base with the arm tucked.

    Args:
        seed: seed of the generator.

    Raises:
        ScenarioError: no room was found for the obstacles.
    """
    start, goal = PoseSpec(*CLUTTER_START, 0.0), PoseSpec(*CLUTTER_GOAL, 0.0, joints=CLUTTER_GOAL_ARM)
    return Scenario(CLUTTER, SCENARIOS[CLUTTER], clutter_scene(seed), start, goal, seed=seed)


def clutter_scene(seed: int) -> Scene:
    """The obstacles of :func:`clutter`."""
    rng = np.random.default_rng(seed)
    guide = _guide(rng)
    length, middle = CLUTTER_GOAL[0] + 3.0, 0.5 * CLUTTER_GOAL[0] + 0.3
    items: list[Obstacle] = [
        Box((length, 0.1, 1.6), at=(middle, side * (CLUTTER_HALF_WIDTH + 0.05), 0.8), name=name)
        for side, name in ((1.0, "wall-left"), (-1.0, "wall-right"))
    ]
    items += _table("goal-table", CLUTTER_GOAL[0] + 0.70, CLUTTER_GOAL[1], 0.0, (0.6, 1.0), 0.66)
    items += _partition(guide, rng)
    kinds = ["blocker"] * _BLOCKERS + ["table"] * _TABLES + ["shelf"] * _SHELVES + ["pillar"] * _PILLARS
    for number, kind in enumerate(kinds):
        items += _placed(kind, f"{kind}-{number}", guide, rng, seed)
    for number in range(_BEAMS):
        x = float(rng.uniform(0.5, CLUTTER_GOAL[0] - 0.5))
        items.append(
            Box((0.2, 2 * CLUTTER_HALF_WIDTH, 0.15), at=(x, 0.0, float(rng.uniform(1.6, 1.8))), name=f"beam-{number}")
        )
    return Scene(items)


def _partition(guide: Array, rng: np.random.Generator) -> list[Obstacle]:
    """A wall across the room with one door, where the guide curve crosses it."""
    x = float(rng.uniform(2.4, 3.6))
    door, half = float(np.interp(x, guide[:, 0], guide[:, 1])), 0.5 * float(rng.uniform(*_DOOR_WIDTHS))
    items: list[Obstacle] = []
    for low, high, side in ((-CLUTTER_HALF_WIDTH, door - half, "right"), (door + half, CLUTTER_HALF_WIDTH, "left")):
        items.append(Box((0.1, high - low, 1.6), at=(x, 0.5 * (low + high), 0.8), name=f"partition-{side}"))
    return items


def _placed(kind: str, name: str, guide: Array, rng: np.random.Generator, seed: int) -> list[Obstacle]:
    """One piece of furniture that leaves the guide curve and the ends free."""
    ends = np.array([CLUTTER_START, CLUTTER_GOAL])
    for _attempt in range(5000):
        share = float(rng.uniform(0.2, 0.8))
        at = rng.uniform([0.0, -CLUTTER_HALF_WIDTH], [CLUTTER_GOAL[0], CLUTTER_HALF_WIDTH])
        yaw = float(rng.uniform(-np.pi, np.pi))
        size = rng.uniform([0.5, 0.35], [0.9, 0.6])
        radius, height = float(rng.uniform(0.08, 0.2)), float(rng.uniform(0.9, 1.6))
        if kind == "blocker":
            at = ends[0] + share * (ends[1] - ends[0]) + rng.uniform(-0.1, 0.1, 2)
        if kind in ("pillar", "blocker"):
            outline = at + np.zeros((1, 2))
            free = _FREE_RADII["pillar"] + radius
        else:
            outline = at + _frame(yaw, size)
            free = _FREE_RADII[kind]
        apart = np.linalg.norm(outline[:, None] - guide, axis=2).min()
        if apart < free or np.linalg.norm(outline[:, None] - ends, axis=2).min() < _FREE_ENDS_RADIUS + radius:
            continue
        if np.abs(outline[:, 1]).max() > CLUTTER_HALF_WIDTH + 0.3:
            continue
        x, y = float(at[0]), float(at[1])
        if kind == "table":
            return _table(name, x, y, yaw, tuple(size.tolist()), float(rng.uniform(0.65, 0.85)))
        if kind == "shelf":  # a board at the height of the shoulder, on a post
            z = float(rng.uniform(0.95, 1.2))
            return _table(name, x, y, yaw, tuple(size.tolist()), z)
        if rng.random() < 0.5:
            return [Cylinder(radius, height, at=(x, y, height / 2), name=name)]
        quat = (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
        side = radius * np.sqrt(2.0)
        return [Box((side, side, height), at=(x, y, height / 2), quat=quat, name=name)]
    raise ScenarioError(f"{CLUTTER}: seed {seed} found no room for {name}")


def _table(name: str, x: float, y: float, yaw: float, size: tuple[float, ...], top: float) -> list[Obstacle]:
    """A board 4 cm thick on one post."""
    quat = (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
    return [
        Box((size[0], size[1], 0.04), at=(x, y, top - 0.02), quat=quat, name=name),
        Cylinder(0.06, top - 0.04, at=(x, y, (top - 0.04) / 2), name=f"{name}-post"),
    ]


def _frame(yaw: float, size: Array) -> Array:
    """Points (K, 2) along the outline of a rectangle about the origin, and its middle."""
    s = np.linspace(-0.5, 0.5, 7)
    one, two = np.column_stack((s, np.full(7, 0.5))), np.column_stack((np.full(7, 0.5), s))
    points = np.vstack((one, -one, two, -two, np.zeros((1, 2)))) * size
    cos, sin = np.cos(yaw), np.sin(yaw)
    return points @ np.array([[cos, sin], [-sin, cos]])


def _guide(rng: np.random.Generator) -> Array:
    """A smooth curve (K, 2) from start to goal that swings to one side or both."""
    s = np.linspace(0.0, 1.0, 200)
    straight = np.array(CLUTTER_START) + s[:, None] * (np.array(CLUTTER_GOAL) - np.array(CLUTTER_START))
    swing = float(rng.uniform(0.7, 1.2)) * (1.0 if rng.random() < 0.5 else -1.0)
    waves = int(rng.integers(1, 3))
    straight[:, 1] += swing * np.sin(np.pi * s) ** 0.5 * np.sin(np.pi * waves * s + float(rng.uniform(-0.2, 0.2)))
    straight[:, 1] = np.clip(straight[:, 1], -CLUTTER_HALF_WIDTH + 0.6, CLUTTER_HALF_WIDTH - 0.6)
    straight[[0, -1]] = CLUTTER_START, CLUTTER_GOAL
    return straight


CLOSING = "closing-side"
_WALKING_SPEED = 0.2


def closing_side(seed: int = 0) -> Scenario:
    """A box in a hall 3.6 m wide, a little off the line; a cabinet slides into the wider side at 0.2 m/s.

    At the start both sides are open, the left one wider; after 6 s the gap there is too narrow for the base.

    Args:
        seed: not used.
    """
    obstacles: list[Obstacle] = [
        Box((9.0, 0.1, 1.4), at=(3.0, 1.85, 0.7), name="wall-left"),
        Box((9.0, 0.1, 1.4), at=(3.0, -1.85, 0.7), name="wall-right"),
        Box((0.7, 0.7, 1.4), at=(3.0, -0.15, 0.7), name="box"),
        Box((0.6, 0.8, 1.4), at=(3.0, 2.4, 0.7), name="cabinet", motion=Twist(np.array([0.0, -_WALKING_SPEED, 0.0]))),
    ]
    return _six_metres(CLOSING, obstacles, seed)


def _six_metres(name: str, obstacles: list[Obstacle], seed: int) -> Scenario:
    """Straight ahead from the origin to (6, 0) [m]."""
    start, goal = PoseSpec(0.0, 0.0, 0.0), PoseSpec(6.0, 0.0, 0.0)
    return Scenario(name, SCENARIOS[name], Scene(obstacles), start, goal, seed=seed)


BOTTLENECK, DEAD_END = "bottleneck", "dead-end"
DOOR_WIDTH = 0.75
"""Width of the bottleneck [m]; the Silvermate's base is 0.54 m wide."""
_WALL_LENGTH = 12.0  # [m] of wall on either side of the door: too long to drive around
_DEAD_END_DEPTH, _DEAD_END_WIDTH = 1.2, 1.8  # [m] of the dead end, inside
_WALL_HEIGHT, _WALL_THICKNESS = 1.2, 0.2  # [m]


def bottleneck(seed: int = 0) -> Scenario:
    """A wall across the path with a door, 0.3 m beside the line from start to goal.

    Args:
        seed: not used.
    """
    walls: list[Obstacle] = [
        _wall("wall-left", x=3.0, y=0.3 + 0.5 * (DOOR_WIDTH + _WALL_LENGTH), across=_WALL_LENGTH),
        _wall("wall-right", x=3.0, y=0.3 - 0.5 * (DOOR_WIDTH + _WALL_LENGTH), across=_WALL_LENGTH),
    ]
    return _six_metres(BOTTLENECK, walls, seed)


def dead_end(seed: int = 0) -> Scenario:
    """Three walls around the path, open towards the start: a local minimum of the distance to the goal.

    Args:
        seed: not used.
    """
    back = 3.2
    middle = back - 0.5 * (_WALL_THICKNESS + _DEAD_END_DEPTH)
    side = 0.5 * (_DEAD_END_WIDTH + _WALL_THICKNESS)
    walls: list[Obstacle] = [_wall("back", x=back, y=0.0, across=_DEAD_END_WIDTH + 2.0 * _WALL_THICKNESS)]
    for name, sign in (("left", 1.0), ("right", -1.0)):
        at = (middle, sign * side, 0.5 * _WALL_HEIGHT)
        walls.append(Box((_DEAD_END_DEPTH, _WALL_THICKNESS, _WALL_HEIGHT), at=at, name=name))
    return _six_metres(DEAD_END, walls, seed)


def _wall(name: str, *, x: float, y: float, across: float) -> Box:
    return Box((_WALL_THICKNESS, across, _WALL_HEIGHT), at=(x, y, 0.5 * _WALL_HEIGHT), name=name)
