"""The document of a drive: what ``elastic-strips drive --json`` writes; docs/drive-format.md describes it."""

from __future__ import annotations

from typing import Any

import numpy as np

from elastic_strips._version import __version__
from elastic_strips.validation import check_type

from .drive import DriveOutcome

DRIVE_FORMAT = "elastic-strips-drive"
DRIVE_FORMAT_VERSION = 1


def drive_document(outcome: DriveOutcome) -> dict[str, Any]:
    """A drive as plain values, ready for JSON. Lengths in metres, angles in radians, times in seconds."""
    check_type("outcome", outcome, DriveOutcome)
    result, verdict = outcome.result, outcome.verdict
    judged = verdict.as_dict()
    return {
        "format": DRIVE_FORMAT,
        "version": DRIVE_FORMAT_VERSION,
        "elastic_strips": __version__,
        "scenario": outcome.scenario.name,
        "robot": outcome.robot.name,
        "plant": outcome.plant,
        "method": outcome.method,
        "sensors": list(outcome.sensors),
        "seed": outcome.seed,
        "state": result.state.name.lower(),
        "reason": result.reason,
        "reached": outcome.reached,
        "collisions": len(verdict.collisions),
        "contacts": judged["collisions"],
        "unseen_contacts": list(outcome.unseen),
        "contacts_at_rest": judged["rest_contacts"],
        "physical_contacts": list(outcome.physical_contacts),
        "min_clearance_m": judged["min_clearance_m"],
        "time_s": verdict.time_s,
        "path_m": verdict.path_m,
        "stops": [{"time_s": time, "reason": reason} for time, reason in result.stops],
        "replans": result.replans,
        "tick_ms": {k: _number(v) for k, v in result.statistics.percentiles().items()},
        "ticks": len(result.statistics.seconds),
        "deadline_misses": result.statistics.misses,
        "max_lateral_slip": verdict.max_lateral_slip_m,
        "limit_excess": judged["excess"],
        "max_tracking_error_m": outcome.tracking_error,
        "protective_separation_m": outcome.separation,
        "events": [{"time_s": e.time, "kind": e.kind, "reason": e.reason} for e in result.events],
        "wall_s": result.seconds,
    }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
