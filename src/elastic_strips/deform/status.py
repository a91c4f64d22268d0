"""Status of a strip after a tick, and after the last one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..tunnel import Certificate, Tunnel
from .params import DeformParams
from .report import DeformReport, DeformStatus

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
