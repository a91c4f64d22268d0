"""bottleneck and dead-end: where methods that look only at what is near get stuck, as the paper says of them."""

from __future__ import annotations

from elastic_strips.io import PoseSpec
from elastic_strips.named import SCENARIOS
from elastic_strips.scene import Box, Obstacle, Scene

from .scenario import Scenario

BOTTLENECK, DEAD_END = "bottleneck", "dead-end"
DOOR = 0.75
"""Width of the bottleneck [m]; the Silvermate's base is 0.54 m wide."""
_HALL = 12.0  # [m] of wall on either side of the door: nobody finds a way around it
_DEPTH, _WIDTH = 1.2, 1.8  # [m] of the dead end, inside
_HEIGHT, _THICK = 1.2, 0.2  # [m]


def bottleneck(seed: int = 0) -> Scenario:
    """A wall across the way with a door, 0.3 m beside the line from start to goal.

    Args:
        seed: not used; nothing here is random.
    """
    return Scenario(
        name=BOTTLENECK,
        summary=SCENARIOS[BOTTLENECK],
        scene=Scene(
            [
                _wall("wall-left", x=3.0, y=0.3 + 0.5 * (DOOR + _HALL), across=_HALL),
                _wall("wall-right", x=3.0, y=0.3 - 0.5 * (DOOR + _HALL), across=_HALL),
            ]
        ),
        start=PoseSpec(0.0, 0.0, 0.0),
        goal=PoseSpec(6.0, 0.0, 0.0),
        seed=seed,
    )


def dead_end(seed: int = 0) -> Scenario:
    """Three walls around the way, open towards the start: the nearest point to the goal is a trap.

    Args:
        seed: not used; nothing here is random.
    """
    back = 3.2
    middle = back - 0.5 * (_THICK + _DEPTH)
    side = 0.5 * (_WIDTH + _THICK)
    walls: list[Obstacle] = [_wall("back", x=back, y=0.0, across=_WIDTH + 2.0 * _THICK)]
    for name, sign in (("left", 1.0), ("right", -1.0)):
        at = (middle, sign * side, 0.5 * _HEIGHT)
        walls.append(Box((_DEPTH, _THICK, _HEIGHT), at=at, name=name))
    return Scenario(
        name=DEAD_END,
        summary=SCENARIOS[DEAD_END],
        scene=Scene(walls),
        start=PoseSpec(0.0, 0.0, 0.0),
        goal=PoseSpec(6.0, 0.0, 0.0),
        seed=seed,
    )


def _wall(name: str, *, x: float, y: float, across: float) -> Box:
    return Box((_THICK, across, _HEIGHT), at=(x, y, 0.5 * _HEIGHT), name=name)
