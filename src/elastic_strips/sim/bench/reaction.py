"""Reaction benchmark: from the change of the scene to the first command that follows a new certified strip."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from elastic_strips.errors import ElasticStripsError
from elastic_strips.execution import Controller, DriveParams
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Cylinder, Scene, World

from ..closed_loop import Simulation
from ..perception import PerceptionParams
from ..scenarios import get_scenario, make_simulation
from .measure import machine, percentiles

_AHEAD = 1.8
"""Time [s] ahead on the way, where the obstacle is put."""
_RADIUS = 0.15
_HALF_WIDTH = 0.27
"""Of the base [m]: the obstacle reaches into the way of the base from its side."""


def bench_reaction(
    robot: RobotModel,
    seeds: Sequence[int],
    step: Callable[[str], object] = lambda note: None,
    *,
    depth: float = 0.1,
) -> dict[str, Any]:
    """Planning at 100 Hz: a post appears on the strip; ticks until a motion along a new certified strip is followed.

    The post stands beside the way and reaches ``depth`` [m] into what the base sweeps, left or right by seed; every
    other one is low (0.3 m), the rest as high as the robot.

    The scene is sensed without delay, so that the time is the planner's own. In ticks: from the tick that first sees
    the post to the one whose command follows the new motion. In milliseconds: those ticks, the last one up to the end
    of the computation by the wall clock.
    """
    rows = []
    for seed in seeds:
        step(f"seed {seed}")
        try:
            row = _once(robot, int(seed), depth)
        except ElasticStripsError as error:
            row = {"seed": int(seed), "error": str(error)}
        rows.append(row)
    good = [r for r in rows if "ticks" in r]
    return {
        "benchmark": "reaction",
        "machine": machine(),
        "robot": robot.name,
        "depth_m": depth,
        "count": len(rows),
        "reacted": len(good),
        "ticks": percentiles([r["ticks"] for r in good]),
        "ms": percentiles([r["ms"] for r in good]),
        "tick_ms": percentiles([r["tick_ms"] for r in good]),
        "runs": rows,
    }


def _once(robot: RobotModel, seed: int, depth: float) -> dict[str, Any]:
    params = replace(DriveParams(), plan_every=1, latency=1)
    scenario = get_scenario("corridor", seed=seed)
    options: dict[str, Any] = {
        "robot": robot,
        "seed": seed,
        "params": params,
        "perception": PerceptionParams(delay=0.0),
    }
    free = make_simulation(scenario, **options)
    track = free.run(time_limit=7.0).record.control
    appears = float(np.random.default_rng(seed).uniform(2.0, 4.0))
    k = min(int((appears + _AHEAD) / params.control_dt), len(track) - 1)
    x, y, yaw = track.reference[k, :3]
    side = (_HALF_WIDTH + _RADIUS - depth) * (1.0 if seed % 2 else -1.0)
    height = 0.3 if seed % 4 < 2 else 1.6
    at = (x - side * np.sin(yaw), y + side * np.cos(yaw), 0.5 * height)
    post = Cylinder(_RADIUS, height, at=at, name="post")
    world = World(Scene([*scenario.scene, post]), appears={"post": appears})
    seen: dict[str, Any] = {}

    def watch(driven: Simulation[Controller]) -> None:
        proposal = driven.controller.proposal
        if driven.time < appears or "ticks" in seen:
            return
        seen.setdefault("at", driven.time)
        if proposal is None or not proposal.accepted or not proposal.report.certified:
            return
        ticks = round((driven.time - seen["at"]) / params.control_dt) + params.latency
        last = driven.controller.statistics.seconds[-1]
        seen["ticks"] = ticks
        seen["tick_ms"] = 1e3 * last
        seen["ms"] = 1e3 * ((ticks - params.latency) * params.control_dt + last)
        driven.stop()

    driven = make_simulation(replace(scenario, scene=world.scene, timeline=world), **options, watch=watch)
    driven.run(time_limit=appears + 3.0)
    return {"seed": seed, "appears_s": appears, **{k: seen[k] for k in ("ticks", "ms", "tick_ms") if k in seen}}
