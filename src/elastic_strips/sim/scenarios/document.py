"""The result document of a run: what ``elastic-strips run --json`` writes; docs/result-format.md describes it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from elastic_strips._version import __version__
from elastic_strips.io import obstacle_documents
from elastic_strips.robot import BaseKind
from elastic_strips.tunnel import BrokenSegment
from elastic_strips.validation import check_type

from .run import RunResult

FORMAT = "elastic-strips-result"
FORMAT_VERSION = 1


def result_document(result: RunResult) -> dict[str, Any]:
    """A run as plain values, ready for JSON. Lengths in metres, angles in radians."""
    check_type("result", result, RunResult)
    report, robot, strip = result.report, result.robot, result.report.strip
    paper = result.params.preset == "paper"
    base = BaseKind.OMNI if paper and robot.base_kind is BaseKind.DIFF_DRIVE else robot.base_kind
    ticks = 1e3 * result.tick_seconds
    return {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "elastic_strips": __version__,
        "scenario": result.scenario.name,
        "preset": result.params.preset,
        "robot": robot.name,
        "seed": result.seed,
        "status": report.status.value,
        "reason": result.reason,
        "certified": result.certified,
        "segments": [bool(s) for s in report.certificate.segments],
        "certified_clearance_m": result.params.clearance,
        "clearance_m": float(result.clearance) if np.isfinite(result.clearance) else None,
        "max_lateral_slip_m": float(strip.lateral_slip.max(initial=0.0)) if base is BaseKind.DIFF_DRIVE else 0.0,
        "length_m": strip.length,
        "nodes": len(strip),
        "ticks": result.ticks,
        "initial": result.method,
        "time_to_certified_ms": None if result.time_to_certified is None else 1e3 * result.time_to_certified,
        "tick_ms": {f"p{p}": float(np.percentile(ticks, p)) if len(ticks) else None for p in (50, 95, 99)},
        "passage": result.passage,
        "max_heading_step_rad": report.heading_step if paper else None,
        "broken": None if result.certified or report.certificate.broken is None else _broken(report.certificate.broken),
        "base": base.value,
        "strip": {"joint_names": list(robot.joint_names), "q": strip.q.tolist()},
        "locked": {name: float(value) for name, value in robot.locked.items()},
        "obstacles": obstacle_documents(result.scenario.scene),
        "urdf": None if robot.urdf_path is None else str(Path(robot.urdf_path).absolute()),
        "params": result.params.as_dict(),
    }


def _broken(broken: BrokenSegment) -> dict[str, Any]:
    return {
        "segment": broken.segment,
        "link": broken.link,
        "obstacle": broken.obstacle,
        "clearance": broken.clearance,
        "kind": broken.kind,
        "certain": broken.certain,
    }
