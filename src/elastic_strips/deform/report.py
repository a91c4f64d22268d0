"""What a tick hands out: the strip, its status with the reason, its certificate and what it cost."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from ..robot.space import Array
from ..scene import Scene
from ..strip import Strip
from ..summary import Summary
from ..tunnel import Certificate, Tunnel, strip_clearance


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
