"""IO room, path tables: what a file holds of a path, before and after it is known what that is of a robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, NoReturn

from elastic_strips.arrays import Array

from .nodes import Source

Angles = Literal["rad", "deg"]
RATES = "the file has velocities or accelerations"
"""Stands among a reader's notes for ``PathFile.rates``."""
BASE_NAMES = ("x", "y", "yaw")


@dataclass(frozen=True, slots=True, eq=False)
class PathTable:
    """The content of a file, before its columns are assigned to a robot.

    Attributes:
        source: the file.
        names: (C,) names of the columns, or None.
        rows: (N, C) numbers.
        place: name of row ``k`` in messages, and its line if that is known.
        times: (N,) times [s], or None.
        units: (C,) units of the columns from a line below the names; empty without such a line.
        from_start: whether times are counted from when the robot sets off, as in a JointTrajectory.
        metres: whether lengths are in metres, as in messages of ROS.
        stamp: when it sets off, in the file's own time [s].
        start: names for which the file has only a start state.
        notes, doubts, time_doubts: the reader's own, as for ``PathFile``.
    """

    source: Source
    names: tuple[str, ...] | None
    rows: Array
    place: Callable[[int], tuple[str, int | None]]
    times: Array | None = None
    units: tuple[str, ...] = ()
    from_start: bool = False
    metres: bool = False
    stamp: float = 0.0
    start: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    time_doubts: tuple[str, ...] = ()

    def fail(self, row: int, message: str) -> NoReturn:
        """Raise the source's error about a row."""
        label, line = self.place(row)
        self.source.fail(f"{label}: {message}", line)


@dataclass(slots=True)
class PlacedPath:
    """Coordinates of a robot, and findings on the way.

    Attributes:
        coordinates: (N, nv), as in the file: angles are not wrapped.
        valued: whether the file has values of angles, and not their (cos, sin).
        times: (N,) times [s], or None.
        from_start: as for `PathTable`.
        clock: name of the column that has the times, where nothing says in which unit; else empty.
        notes, doubts, time_doubts, held, at_home: as for ``PathFile``.
    """

    coordinates: Array
    times: Array | None
    from_start: bool
    notes: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    time_doubts: list[str] = field(default_factory=list)
    valued: bool = True
    clock: str = ""
    held: dict[str, float] = field(default_factory=dict)
    at_home: dict[str, float] = field(default_factory=dict)
