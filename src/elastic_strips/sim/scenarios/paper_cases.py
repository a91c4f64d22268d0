"""The paper's seven simulated cases, in metres, from its Tables 1 and 2.

The paper gives the obstacles' places in figures only. Here they are chosen so that its text holds: two round obstacles
on both sides of the line from (−3, −3) to (6, 6), Table 2's distance apart, staggered along the line, and in cases 1, 2
and 7 obstacle 2 comes within the safe distance at (−1.5, −1.5).
"""

from __future__ import annotations

import numpy as np

from elastic_strips.catalogue import SCENARIOS
from elastic_strips.io import PoseSpec
from elastic_strips.scene import Box, Cylinder, Obstacle, Scene

from .scenario import Scenario

OBSTACLE_RADIUS = 0.3
"""Radius of the two obstacles [m]."""
_OBSTACLE_HEIGHT = 1.3  # [m]
_STAGGER_OFFSET = 0.2  # [m]
_CASE_START = (-3.0, -3.0, np.pi / 6)  # [m, m, rad]
_CASE_GOAL = (6.0, 6.0, np.pi / 4)  # [m, m, rad]
_SENSED_PLACE = (-1.5, -1.5)
_SHELF_ALONG = 3.6
_SHELF_EDGE = 0.28  # from the straight line [m]: the base (0.27) passes, the arm on the right does not
_WAY = np.array([1.0, 1.0]) / np.sqrt(2.0)
_LEFT = np.array([-1.0, 1.0]) / np.sqrt(2.0)

TABLE_1 = {"k_r": 0.3, "k_c": 0.5}
TABLE_2: dict[str, tuple[float, float, float | None]] = {
    "case-1": (np.pi / 6, 1.5, 2.1),
    "case-2": (np.pi / 3, 1.5, 2.1),
    "case-3": (np.pi / 3, 1.5, 1.0),
    "case-4": (np.pi / 3, 0.8, 1.0),
    "case-5": (np.pi / 3, 1.5, 0.1),
    "case-6": (np.pi / 3, 1.0, None),
    "case-7": (np.pi / 3, 1.5, 2.1),
}
"""Case → transfer tilt [rad], safe distance [m], distance between the two obstacles [m]."""


def paper_case(name: str) -> Scenario:
    """One of ``case-1`` … ``case-7``."""
    tilt, safe, gap = TABLE_2[name]
    return Scenario(
        name=name,
        summary=SCENARIOS[name],
        scene=Scene(_obstacles(name, gap)),
        start=PoseSpec(*_CASE_START),
        goal=PoseSpec(*_CASE_GOAL),
        params={"paper": {**TABLE_1, "influence": safe, "transfer_tilt": tilt, "mobile_only": name != "case-7"}},
        gap=None if gap is None else ("obstacle-1", "obstacle-2"),
    )


def _obstacles(name: str, gap: float | None) -> list[Obstacle]:
    if gap is None:
        return [
            Cylinder(
                OBSTACLE_RADIUS,
                _OBSTACLE_HEIGHT,
                at=(*(s * _WAY + w * _LEFT), _OBSTACLE_HEIGHT / 2),
                name=f"obstacle-{k + 1}",
            )
            for k, (s, w) in enumerate([(-1.6, 0.9), (0.3, -1.0), (1.9, 1.05), (3.7, -0.95), (5.4, 1.1), (6.3, -1.2)])
        ]
    apart = gap + 2 * OBSTACLE_RADIUS
    side = 0.5 * np.sqrt(apart**2 - _STAGGER_OFFSET**2)
    first = _near_obstacle()
    pair = []
    for label, along, across in (("obstacle-1", first + _STAGGER_OFFSET, side), ("obstacle-2", first, -side)):
        at = along * _WAY + across * _LEFT
        pair.append(Cylinder(OBSTACLE_RADIUS, _OBSTACLE_HEIGHT, at=(at[0], at[1], _OBSTACLE_HEIGHT / 2), name=label))
    if name == "case-7":
        at = _SHELF_ALONG * _WAY - (_SHELF_EDGE + 0.25) * _LEFT
        turn = (0.0, 0.0, np.sin(np.pi / 8), np.cos(np.pi / 8))
        pair.append(Box((0.5, 0.5, 0.5), at=(at[0], at[1], 0.85), quat=turn, name="shelf"))
    return pair


def _near_obstacle() -> float:
    """Distance of obstacle 2 along the line so that, with the gap of case 1, it is sensed at (−1.5, −1.5)."""
    side = 0.5 * np.sqrt((2.1 + 2 * OBSTACLE_RADIUS) ** 2 - _STAGGER_OFFSET**2)
    reach = TABLE_2["case-1"][1] + OBSTACLE_RADIUS
    return float(np.dot(_SENSED_PLACE, _WAY) + np.sqrt(reach**2 - side**2))
