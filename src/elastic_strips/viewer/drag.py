"""Drag: messages of a page while an obstacle, or the goal, is held with the mouse, or while somebody steers."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from elastic_strips.arrays import Array

_DRAG_KINDS = ("grab", "drag", "release")
_FARTHEST_PLACE, _LONGEST_NAME = 1e3, 1000  # [m], characters of a name


@dataclass(frozen=True, slots=True)
class Drag:
    """One message: something is grabbed, has been dragged since then, or is let go.

    Attributes:
        kind: which of these.
        name: name of the obstacle; None for the goal.
        hand: whether the goal is the hand's, and not the base's.
        shift: (3,) displacement since it was grabbed [m], world frame.
        turn: turn about the vertical through its own origin since it was grabbed [rad].
    """

    kind: Literal["grab", "drag", "release"]
    name: str | None
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: float = 0.0
    hand: bool = False

    def applied(self, pose: Array) -> Array:
        """The place to which ``pose`` (4, 4) [m], at which it was grabbed, is dragged."""
        c, s = math.cos(self.turn), math.sin(self.turn)
        moved = np.array(pose, dtype=float)
        moved[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ moved[:3, :3]
        moved[:3, 3] += self.shift
        return moved


def base_pose(row: Array) -> Array:
    """Pose (4, 4) of a planar base at a coordinate row (nv,)."""
    x, y, yaw = map(float, row[:3])
    return Drag("drag", None, (x, y, 0.0), yaw).applied(np.eye(4))


def parse(line: bytes) -> Drag | None:
    """Read a message; None where it is not one, since any program on this machine may write to the page's server."""
    try:
        data = json.loads(line)
        kind, name, hand = data["type"], data.get("name"), data.get("hand", False)
        shift, turn = tuple(float(x) for x in data.get("shift", (0, 0, 0))), float(data.get("turn", 0))
    except (AttributeError, LookupError, TypeError, ValueError, RecursionError, OverflowError):
        return None
    if kind not in _DRAG_KINDS or not (name is None or (isinstance(name, str) and len(name) <= _LONGEST_NAME)):
        return None
    if (
        not isinstance(hand, bool) or len(shift) != 3 or not all(abs(x) <= _FARTHEST_PLACE for x in (*shift, turn))
    ):  # NaN neither
        return None
    return Drag(kind, name, shift, turn, hand)


@dataclass(frozen=True, slots=True)
class Steer:
    """What somebody steers with keys, or with the stick in the page: parts of the largest speeds, from −1 to 1.

    Attributes:
        forward, left: of the base in its own frame.
        turn: to the left.
    """

    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0


def parse_steer(line: bytes) -> Steer | None:
    """Read a message of somebody who steers; None where it is not one."""
    try:
        data = json.loads(line)
        kind, values = data["type"], [float(data[name]) for name in ("forward", "left", "turn")]
    except (AttributeError, LookupError, TypeError, ValueError, RecursionError, OverflowError):
        return None
    return Steer(*values) if kind == "steer" and all(-1.0 <= x <= 1.0 for x in values) else None  # NaN neither
