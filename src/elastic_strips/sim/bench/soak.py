"""Soak benchmark: one process drives to and fro among moving obstacles; memory and ticks are watched."""

from __future__ import annotations

import gc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from elastic_strips.deform import DeformParams
from elastic_strips.execution import Controller, DriveParams
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Cylinder, Keyframes, Obstacle, Scene, World

from ..closed_loop import Simulation, simulation
from .measure import machine, percentiles

_WINDOW = 120.0
"""Simulated time [s] that one row of figures stands for."""


def bench_soak(
    robot: RobotModel, hours: float = 1.0, step: Callable[[str], object] = lambda note: None, *, seed: int = 0
) -> dict[str, Any]:
    """Drive to and fro for ``hours`` of simulated time.

    Returns:
        Resident memory [MB] and percentiles of the ticks, window by window; ``growth`` is that of the memory from the
        end of the first tenth to the end.
    """
    world = _world(seed)
    ends = [robot.home(x=-3.5), robot.home(x=3.5)]
    rows: list[dict[str, Any]] = []
    params = DriveParams(deform=DeformParams(max_nodes=200), time_limit=3600.0 * hours)
    begin = {"tick": 0, "time": 0.0}
    legs = 0

    def watch(driven: Simulation[Controller]) -> None:
        nonlocal legs
        if driven.time - begin["time"] < _WINDOW:
            return
        seconds = driven.controller.statistics.seconds
        mine = 1e3 * np.array(seconds[int(begin["tick"]) :])
        begin.update(tick=len(seconds), time=driven.time)
        gc.collect()
        rows.append({"time_s": driven.time, "memory_mb": _resident(), "tick_ms": percentiles(mine)})
        step(f"{driven.time / 60:.0f} min, {rows[-1]['memory_mb']:.0f} MB")

    driven = simulation(robot, world, ends[0], ends[1], params=params, seed=seed, watch=watch, record=False)
    controller = driven.controller
    while driven.time < 3600.0 * hours:
        driven.run(time_limit=3600.0 * hours)
        legs += controller.supervisor.at_goal
        if not controller.supervisor.at_goal:
            break
        controller.retarget(ends[legs % 2])
    warm = rows[max(len(rows) // 10, 1) - 1] if rows else None
    return {
        "benchmark": "soak",
        "machine": machine(),
        "robot": robot.name,
        "hours": driven.time / 3600.0,
        "legs": legs,
        "stops": len(controller.stops),
        "memory_mb": {"warm": warm and warm["memory_mb"], "end": rows[-1]["memory_mb"] if rows else None},
        "growth": rows[-1]["memory_mb"] / warm["memory_mb"] - 1.0 if warm else None,
        "tick_ms_first_half": percentiles([r["tick_ms"]["p99"] for r in rows[: len(rows) // 2]]),
        "tick_ms_second_half": percentiles([r["tick_ms"]["p99"] for r in rows[len(rows) // 2 :]]),
        "windows": rows,
    }


def _world(seed: int) -> World:
    """A hall with pillars, and people who cross it on loops for ever."""
    rng = np.random.default_rng(seed)
    obstacles: list[Obstacle] = [
        Box((0.4, 0.4, 1.2), at=(x, y, 0.6)) for x, y in ((-2.0, 1.1), (-0.7, -1.0), (0.8, 1.2), (2.2, -1.1))
    ]
    for k in range(5):
        x, period = rng.uniform(-2.5, 2.5), rng.uniform(14.0, 22.0)
        t = np.arange(0.0, period + 0.05, 0.1) * (period / (np.ceil(period / 0.1) * 0.1))
        phase = 2.0 * np.pi * t / t[-1]
        track = np.column_stack([x + 0.4 * np.cos(phase), 3.2 * np.sin(phase), np.full_like(t, 0.85)])
        track[-1] = track[0]
        obstacles.append(Cylinder(0.25, 1.7, name=f"person-{k}", motion=Keyframes(t, track, loop=True)))
    return World(Scene(obstacles))


def _resident() -> float:
    """Resident memory of this process [MB]."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    import os

    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
