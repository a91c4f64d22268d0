"""Reports: the result of a tick, with the strip, its status and the reason, its certificate, and what it cost."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from typing import ClassVar, TypeVar

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision import Certificate, ProtectiveHulls
from elastic_strips.errors import listed, plural
from elastic_strips.scene import Scene
from elastic_strips.summary import Summary

from .strip import Strip, strip_clearance

SLIP_LIMIT = 1e-6
"""Sideways travel [m] of a segment above which a differential drive's strip is not drivable."""


class DeformStatus(str, Enum):
    """State of a strip after a tick.

    ``SETTLED``: certified and converged. ``DEFORMING``: not converged yet. ``BROKEN``: converged (or out of ticks)
    with a segment that has no certificate. ``BLOCKED``: the protective hulls do not connect (preset ``paper``).
    """

    SETTLED = "settled"
    DEFORMING = "deforming"
    BROKEN = "broken"
    BLOCKED = "blocked"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class StripForces(Summary):
    """External forces of the last update, to look at.

    Attributes:
        points: (K, 3) where they act [m].
        vectors: (K, 3) forces [gain · m].
    """

    points: Array
    vectors: Array

    @staticmethod
    def none() -> StripForces:
        """No force at all."""
        return StripForces(np.zeros((0, 3)), np.zeros((0, 3)))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DeformReport(Summary):
    """Result of one tick, or of :meth:`Deformer.settle`.

    Attributes:
        strip: the deformed strip.
        status, reason: its state, and why.
        certificate: proof of its clearance, segment by segment.
        node_clearance: lower bound of its nodes' distance to obstacles [m], capped at the influence distance; for
            control loops; :attr:`clearance` is that of the whole strip.
        scene: the obstacles of the report.
        energies: potential by force.
        timings: seconds by phase; they sum to ``seconds``.
        seconds: duration of the tick.
        iterations: inner iterations made.
        ticks: ticks made (more than one after ``settle``).
        moved: largest displacement of any base or joint in the last iteration [m or rad].
        slip: largest sideways travel |v_y| of a segment [m]; differential drives only.
        queries: exact distance queries made.
        forces: external forces; None where they were not requested.
        hulls: protective hulls; None where they were not requested.
        constraint_errors: (N,) angle [rad] by which each node misses the constraint; None where there is none.
        predicted: whether moving obstacles count where they will be when the nodes are reached; else as they stand.

    Examples:
        >>> robot = es.load_robot("silvermate")
        >>> scene = es.Scene([es.Box((0.6, 0.6, 1.4), at=(1.5, 0.1, 0.7))])
        >>> report = es.Deformer(robot).settle(es.plan(robot, scene, robot.home(x=-1.0), robot.home(x=4.0)), scene)
        >>> report.status.value, report.certified, report.clearance > 0.1
        ('settled', True, True)
    """

    connectivity_counts: ClassVar[bool] = False  # whether a strip whose protective hulls do not overlap is refused

    strip: Strip
    status: DeformStatus
    reason: str
    certificate: Certificate
    node_clearance: float
    scene: Scene
    energies: dict[str, float] = field(default_factory=dict)
    timings: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    iterations: int = 0
    ticks: int = 1
    moved: float = 0.0
    slip: float = 0.0
    queries: int = 0
    forces: StripForces | None = None
    hulls: ProtectiveHulls | None = None
    constraint_errors: Array | None = None
    predicted: bool = False
    _clearance: list[float] = field(default_factory=list, init=False, repr=False)

    def _summary(self) -> dict[str, object]:
        segments = self.certificate.segments
        return {
            "status": self.status.value,
            "reason": self.reason,
            "robot": self.strip.robot.name,
            "nodes": len(self.strip),
            "certified": f"{int(segments.sum())} of {plural(len(segments), 'segment')}",
            **({"as it stands": f"{listed(names)}, at {self.scene.time:g} s"} if (names := self.as_it_stands) else {}),
            "ticks": self.ticks,
        }

    def _measured(self) -> dict[str, object]:
        length = f"{self.strip.length:.3f} {'m' if self.strip.robot.space.planar else 'rad'}"
        return {"clearance": f"{self.clearance:.3f} m", "length": length, "time": f"{1e3 * self.seconds:.1f} ms"}

    @property
    def clearance(self) -> float:
        """Smallest distance [m] to obstacles anywhere on the strip, between its nodes too: :func:`strip_clearance`.

        Infinite without obstacles. Measured at the first use, which takes longer than a tick.
        """
        if not self._clearance:
            self._clearance.append(strip_clearance(self.strip, self.scene))
        return self._clearance[0]

    @property
    def certified(self) -> bool:
        """Whether every segment is certified."""
        return self.certificate.certified

    @property
    def as_it_stands(self) -> tuple[str, ...]:
        """Names of what moves and is taken as it stands at the scene's time: the certificate is of that moment. None
        where nothing moves, or where that was predicted."""
        return () if self.predicted else tuple(one.name or "" for one in self.scene if one.motion is not None)

    @property
    def connected(self) -> bool:
        """Whether all protective hulls overlap; True where they were not requested."""
        return self.hulls is None or bool(self.hulls.connected.all())

    @property
    def usable(self) -> bool:
        """Whether the strip could be driven: certified and drivable."""
        return self.certified and self.slip <= SLIP_LIMIT

    @property
    def failure(self) -> DeformStatus:
        """Status of a strip that is not usable at the end."""
        return DeformStatus.BROKEN


R = TypeVar("R", bound=DeformReport)


def tick_status(certificate: Certificate, rest: bool, wide: str = "") -> tuple[DeformStatus, str]:
    """Status and reason of a drivable strip after one tick.

    Args:
        certificate: the strip's certificate.
        rest: whether the strip has converged, which means that it has stopped moving.
        wide: a phrase that says how far apart the nodes are, if they are too far apart.
    """
    if not certificate.certified:
        return DeformStatus.BROKEN if rest else DeformStatus.DEFORMING, str(certificate.broken)
    if rest:
        return DeformStatus.SETTLED, f"certified and converged{wide}"
    return DeformStatus.DEFORMING, f"certified, not converged yet{wide}"


def settled_report(last: R, ticks: int, timings: dict[str, float], seconds: float, queries: int) -> R:
    """The report of all ticks: the last one's, with the counts, timings and seconds of all, and a final status."""
    status, reason = last.status, last.reason
    if status is DeformStatus.DEFORMING:
        if last.usable:
            reason = f"certified after {plural(ticks, 'tick')}, not converged yet"
        else:
            status, reason = last.failure, f"{reason} (after {plural(ticks, 'tick')})"
    return replace(
        last,
        status=status,
        reason=reason,
        timings=timings,
        seconds=seconds,
        iterations=ticks,
        ticks=ticks,
        queries=queries,
    )
