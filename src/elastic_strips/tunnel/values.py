"""Values of the tunnel room: what is known of a segment, where a strip is broken, and its certificate."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from ..summary import Summary

HALF_TURN = "half turn"


class SegmentState(int, Enum):
    """What is known of a segment."""

    CERTIFIED = 0
    UNKNOWN = 1
    COLLIDING = 2


@dataclass(frozen=True, slots=True)
class BrokenSegment:
    """Where and why a strip is not certified.

    Attributes:
        segment: index j of the segment between nodes j and j + 1.
        link: name of the robot's collision piece.
        obstacle: name of the obstacle, or of the other link for self-collision.
        clearance: smallest distance measured there [m]; below the required one, or too small to decide.
        kind: ``"obstacle"``, ``"self"``, or ``"half turn"`` where the segment's way is not defined.
        certain: True where a configuration below the required clearance was found, False where the depth floor was met.
    """

    segment: int
    link: str
    obstacle: str
    clearance: float
    kind: str
    certain: bool

    def __str__(self) -> str:
        if self.kind == HALF_TURN:
            return f"segment {self.segment}: {self.link} makes half a turn, and which way is not defined: add a node"
        what = "comes within" if self.certain else "could not be proven clear of"
        return f"segment {self.segment}: {self.link} {what} {self.obstacle} ({self.clearance * 1000:.1f} mm)"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Certificate(Summary):
    """Result of certifying a strip.

    Attributes:
        clearance: the distance [m] that was certified against.
        segments: (N−1,) True where certified.
        states: (N−1,) :class:`SegmentState` values.
        broken: the worst uncertified segment, or None.
        checks: number of configurations measured between nodes.
    """

    clearance: float
    segments: npt.NDArray[np.bool_]
    states: npt.NDArray[np.int8]
    broken: BrokenSegment | None
    checks: int

    def _summary(self) -> dict[str, object]:
        proven = f"{int(self.segments.sum())} of {len(self.segments)} segments"
        return {"certified": proven, "clearance": f"{self.clearance:g} m", "broken": str(self.broken)}

    @property
    def certified(self) -> bool:
        """Whether every segment is certified."""
        return bool(self.segments.all())
