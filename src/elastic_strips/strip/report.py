"""What a tick hands out: the strip, its status with the reason, its certificate, what it cost."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from time import perf_counter

import numpy as np

from elastic_strips.arrays import Array

from ..scene import Scene
from ..summary import Summary
from ..tunnel import Certificate, Tunnel
from .params import DeformParams
from .strip import Strip, strip_clearance


class PhaseClock:
    """Accounts time to phases; what passes between two marks belongs to the phase of the later mark."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        self.phases: dict[str, float] = {}
        self._begin = self._last = perf_counter()

    def mark(self, phase: str) -> None:
        """Account the time since the last mark to ``phase``."""
        now = perf_counter()
        self.phases[phase] = self.phases.get(phase, 0.0) + now - self._last
        self._last = now

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return perf_counter() - self._begin

    def total(self) -> float:
        """Sum of all phases [s]."""
        return sum(self.phases.values())


class DeformStatus(str, Enum):
    """State of a strip after a tick.

    ``SETTLED``: certified and at rest. ``DEFORMING``: still moving. ``BROKEN``: at rest (or out of ticks) with a
    segment that has no certificate. ``BLOCKED``: the tunnel's hulls do not connect (preset ``paper``).
    """

    SETTLED = "settled"
    DEFORMING = "deforming"
    BROKEN = "broken"
    BLOCKED = "blocked"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ForceField(Summary):
    """External forces of the last update, to look at.

    Attributes:
        points: (K, 3) where they act [m]; vectors: (K, 3) force [gain · m].
    """

    points: Array
    vectors: Array


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TickResult(Summary):
    """What the iterations of a tick came to: certificate, sideways slip [m], motion, energies, external forces."""

    certificate: Certificate
    slip: float
    moved: float
    energies: dict[str, float]
    field: ForceField


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DeformReport(Summary):
    """Result of one tick, or of :meth:`Deformer.settle`.

    Attributes:
        strip: the deformed strip.
        status, reason: what state it is in, and why.
        certificate: proof of its clearance, segment by segment.
        node_clearance: lower bound of its nodes' distance to obstacles [m], capped at the influence distance; of use in
            control loops. People are shown :attr:`clearance`, that of the whole strip.
        scene: the obstacles that it is about.
        energies: potential by force.
        timings: seconds by phase; they sum to ``seconds``.
        seconds: duration of the tick.
        iterations: inner iterations made.
        ticks: ticks made (more than one after ``settle``).
        moved: largest displacement of any base or joint in the last iteration [m or rad].
        slip: largest sideways travel |v_y| of a segment [m]; differential drives only.
        asked: exact distance queries made.
        forces: external forces, or None where they were not asked for.
        tunnel: protective hulls, or None where they were not asked for.
        connectivity_counts: whether the hulls must overlap for the strip to count; preset ``paper`` only.
        heading_step: largest turn of the mobile in one update [rad]; preset ``paper`` only.
        task_errors: (N,) angle [rad] by which each node misses the task; None where there is none.
    """

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
    asked: int = 0
    forces: ForceField | None = None
    tunnel: Tunnel | None = None
    connectivity_counts: bool = False
    heading_step: float = 0.0
    task_errors: Array | None = None
    _clearance: list[float] = field(default_factory=list, init=False, repr=False)

    def _summary(self) -> dict[str, object]:
        segments = self.certificate.segments
        return {
            "status": self.status.value, "reason": self.reason, "robot": self.strip.robot.name,
            "nodes": len(self.strip), "certified": f"{int(segments.sum())} of {len(segments)} segments",
            "ticks": self.ticks,
        }  # fmt: skip

    def _measured(self) -> dict[str, object]:
        length = f"{self.strip.length:.3f} {'m' if self.strip.robot.space.planar else 'rad'}"
        return {"clearance": f"{self.clearance:.3f} m", "length": length, "time": f"{1e3 * self.seconds:.1f} ms"}

    @property
    def clearance(self) -> float:
        """Smallest distance [m] to obstacles anywhere on the strip, between its nodes too: :func:`strip_clearance`.

        Infinite without obstacles. Measured when it is first asked for, which takes longer than a tick.
        """
        if not self._clearance:
            self._clearance.append(strip_clearance(self.strip, self.scene))
        return self._clearance[0]

    @property
    def certified(self) -> bool:
        """Whether every segment is certified."""
        return self.certificate.certified

    @property
    def connected(self) -> bool:
        """Whether all protective hulls overlap; True where they were not asked for."""
        return self.tunnel is None or bool(self.tunnel.connected.all())

    @property
    def usable(self) -> bool:
        """Whether the strip could be driven: certified, drivable, and connected where that counts."""
        return self.certified and self.slip <= 1e-6 and (self.connected or not self.connectivity_counts)


SLIP_LIMIT = 1e-6
"""Sideways travel [m] of a segment above which a differential drive's strip is not drivable."""


def tick_status(
    certificate: Certificate, slip: float, rest: bool, tunnel: Tunnel | None, wide: str = ""
) -> tuple[DeformStatus, str]:
    """Status and reason after one tick.

    Args:
        certificate: of the strip.
        slip: largest sideways travel of a segment that is left [m].
        rest: whether the strip has stopped moving.
        tunnel: the hulls whose connectivity counts (preset ``paper``), or None.
        wide: how far apart the nodes are, where that is more than they should be.
    """
    if slip > SLIP_LIMIT:
        return _unless(
            rest, DeformStatus.BROKEN
        ), f"a segment slips sideways by {slip:.2e} m, more than {SLIP_LIMIT:g} m"
    if tunnel is not None and not tunnel.connected.all():
        j = int(np.argmin(tunnel.overlap.min(axis=1)))
        gap = -float(tunnel.overlap[j].min())
        reason = f"the protective hulls of nodes {j} and {j + 1} do not overlap: {gap:.2f} m are missing"
        return _unless(rest, DeformStatus.BLOCKED), reason
    if not certificate.certified:
        return _unless(rest, DeformStatus.BROKEN), str(certificate.broken)
    if rest:
        return DeformStatus.SETTLED, f"certified and at rest{wide}"
    return DeformStatus.DEFORMING, f"certified, still moving{wide}"


def wide_spacing(spacing: float, nodes: int, params: DeformParams) -> str:
    """How far apart nodes are, where that is more than ``max_spacing``; else ""."""
    if spacing <= params.max_spacing * (1.0 + 1e-6):
        return ""
    full = f", for there are max_nodes={params.max_nodes}" if nodes >= params.max_nodes else ""
    return f"; its nodes are up to {spacing:.3g} m apart, more than max_spacing={params.max_spacing:g} m{full}"


def _unless(rest: bool, final: DeformStatus) -> DeformStatus:
    return final if rest else DeformStatus.DEFORMING


def settled_report(
    last: DeformReport, ticks: int, timings: dict[str, float], seconds: float, asked: int, turn: float
) -> DeformReport:
    """The report of all ticks: the last one's, with counts and timings summed and a final status."""
    status, reason = last.status, last.reason
    if status is DeformStatus.DEFORMING:
        usable = last.certified and last.slip <= SLIP_LIMIT
        if usable and not (last.connectivity_counts and not last.connected):
            status, reason = DeformStatus.SETTLED, f"certified after {ticks} ticks, not yet at rest"
        else:
            blocked = last.connectivity_counts and not last.connected
            status = DeformStatus.BLOCKED if blocked else DeformStatus.BROKEN
            reason = f"{reason} (after {ticks} ticks)"
    return replace(
        last,
        status=status,
        reason=reason,
        timings=timings,
        seconds=seconds,
        iterations=ticks,
        ticks=ticks,
        asked=asked,
        heading_step=turn,
    )
