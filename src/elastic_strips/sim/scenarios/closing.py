"""closing-side: a strip passes a box on one side, and a cabinet slides in there; the way on the other side stays."""

from __future__ import annotations

import numpy as np

from elastic_strips.io import PoseSpec
from elastic_strips.named import SCENARIOS
from elastic_strips.scene import Box, Scene
from elastic_strips.scene.motion import Twist

from .scenario import Scenario

NAME = "closing-side"
CLOSED = 6.0
"""Time [s] from which the first side is closed."""
_SPEED = 0.2


def closing_side(seed: int = 0) -> Scenario:
    """A box in a hall 3.6 m wide, a little off the line; a cabinet slides into the wider side at 0.2 m/s.

    At the start both sides are open, the left one wider; after 6 s the gap there is too narrow for the base.

    Args:
        seed: not used; nothing here is random.
    """
    scene = Scene(
        [
            Box((9.0, 0.1, 1.4), at=(3.0, 1.85, 0.7), name="wall-left"),
            Box((9.0, 0.1, 1.4), at=(3.0, -1.85, 0.7), name="wall-right"),
            Box((0.7, 0.7, 1.4), at=(3.0, -0.15, 0.7), name="box"),
            Box((0.6, 0.8, 1.4), at=(3.0, 2.4, 0.7), name="cabinet", motion=Twist(np.array([0.0, -_SPEED, 0.0]))),
        ]
    )
    return Scenario(
        name=NAME,
        summary=SCENARIOS[NAME],
        scene=scene,
        start=PoseSpec(0.0, 0.0, 0.0),
        goal=PoseSpec(6.0, 0.0, 0.0),
        seed=seed,
    )
