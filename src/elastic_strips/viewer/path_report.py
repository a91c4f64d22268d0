"""What is drawn of a path that was looked at, as a deformer's report is of a strip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision import Certificate, PathCertificate, SegmentState, Verdict
from elastic_strips.robot import RobotModel
from elastic_strips.strip import Strip


@dataclass(frozen=True, slots=True)
class PathReport:
    """A path, and whether it is certified.

    Attributes:
        strip: the path's configurations.
        status, reason: the verdict, and why.
        certificate: segment by segment.
        clearance: smallest distance [m] from obstacles; NaN where that is not known.
        q: (nq,) a configuration that does not keep the clearance; None where none was found.
        place: where that is on the worst segment, from 0 to 1.
    """

    connectivity_counts: ClassVar[bool] = False
    as_it_stands: ClassVar[tuple[str, ...]] = ()  # what moves is in the reason
    forces: ClassVar[None] = None
    hulls: ClassVar[None] = None

    strip: Strip
    status: Verdict
    reason: str
    certificate: Certificate
    clearance: float
    q: Array | None
    place: float | None

    @property
    def node_clearance(self) -> float:
        """The clearance, of which that of the nodes is not told apart."""
        return self.clearance

    @staticmethod
    def of(robot: RobotModel, q: Array, found: PathCertificate) -> PathReport:
        """That of a path's configurations (N, nq), and the answer about it."""
        segments = np.full(max(len(q) - 1, 0), found.certified or bool(found.segments))
        segments[list(found.segments)] = False
        states = np.where(segments, SegmentState.CERTIFIED, SegmentState.UNKNOWN).astype(np.int8)
        certificate = Certificate(found.clearance, segments, states, found.broken, 0)
        least = np.nan if found.least is None else found.least
        return PathReport(Strip(robot, q), found.verdict, found.reason, certificate, least, found.q, found.place)
