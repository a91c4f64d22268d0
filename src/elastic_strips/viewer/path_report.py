"""What is drawn of a path that was looked at, as a deformer's report is of a strip."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision import Certificate, PathCertificate, SegmentState, Verdict
from elastic_strips.collision.path_rows import PathLike, as_arcs, path_rows
from elastic_strips.robot import RobotModel
from elastic_strips.strip import Strip

_BOW = 2e-3  # [m] by which the drawn base may leave the path
_STEP = 0.2  # [m or rad] from one drawn configuration to the next
_MOST_DRAWN = 3000


@dataclass(frozen=True, slots=True)
class PathReport:
    """A path, and whether it is certified.

    Attributes:
        strip: the path as it goes: its configurations, and as many between them as it takes to draw it.
        status, reason: the verdict, and why.
        certificate: piece by piece of what is drawn.
        segments: how many of the path's own segments are certified, and how many there are.
        clearance: smallest distance [m] from obstacles; NaN where that is not known.
        q: (nq,) a configuration that does not keep the clearance; None where none was found.
        place: where that is on the worst piece, from 0 to 1.
    """

    connectivity_counts: ClassVar[bool] = False
    as_it_stands: ClassVar[tuple[str, ...]] = ()  # what moves is in the reason
    forces: ClassVar[None] = None
    hulls: ClassVar[None] = None

    strip: Strip
    status: Verdict
    reason: str
    certificate: Certificate
    segments: tuple[int, int]
    clearance: float
    q: Array | None
    place: float | None

    @property
    def node_clearance(self) -> float:
        """The clearance, of which that of the nodes is not told apart."""
        return self.clearance

    @staticmethod
    def of(robot: RobotModel, path: PathLike, found: PathCertificate, *, interpolation: str = "line") -> PathReport:
        """That of a path, such as configurations (N, nq), and the answer about it.

        Args:
            robot: the robot.
            path: what was certified.
            found: the answer.
            interpolation: how the path goes between two configurations, as it was certified.
        """
        arcs = as_arcs(robot, path_rows(robot, path), interpolation, bow=_BOW)
        rows, whole, space = arcs.rows, arcs.whole, robot.space
        way = np.abs(space.difference(rows[:-1], rows[1:])).max(axis=1, initial=0.0)
        count = np.maximum(np.ceil(way / max(_STEP, float(way.sum()) / _MOST_DRAWN)), 1.0).astype(int)
        parts = [np.arange(n) / n for n in count.tolist()]
        ends = zip(rows[:-1], rows[1:], parts, strict=True)
        drawn = np.vstack([*(space.interpolate(a[None], b[None], part) for a, b, part in ends), rows[-1:]])
        at = np.concatenate(
            [*(whole[k] + part * (whole[k + 1] - whole[k]) for k, part in enumerate(parts)), whole[-1:]]
        )
        given = max(round(float(whole[-1])), 0)
        proven = np.full(given, found.certified or bool(found.segments))
        proven[list(found.segments)] = False
        pieces = proven[np.minimum(at[:-1].astype(int), given - 1)] if given else np.zeros(0, dtype=bool)
        states = np.where(pieces, SegmentState.CERTIFIED, SegmentState.UNKNOWN).astype(np.int8)
        broken, place = found.broken, found.place
        if broken is not None and len(pieces):
            worst = broken.segment + (0.5 if place is None else place)
            k = int(np.clip(np.searchsorted(at, worst, side="right") - 1, 0, len(pieces) - 1))
            broken = replace(broken, segment=k)
            place = None if place is None else float(np.clip((worst - at[k]) / (at[k + 1] - at[k]), 0.0, 1.0))
        certificate = Certificate(found.clearance, pieces, states, broken, 0)
        least = np.nan if found.least is None else found.least
        strip = Strip.from_coordinates(robot, drawn)
        proven_of = int(proven.sum()), given
        return PathReport(strip, found.verdict, found.reason, certificate, proven_of, least, found.q, place)
