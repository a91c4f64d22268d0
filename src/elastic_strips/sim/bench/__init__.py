"""Benchmarks: planning, replanning, the tick and the closed loop, measured on this machine."""

from .drive import bench_disturb, bench_drive, bench_reaction, bench_soak
from .plan import bench_plan, bench_replan
from .problems import bench_bridge, bench_problems
from .robots import bench_robots
from .tick import bench_tick

__all__ = [
    "bench_bridge",
    "bench_drive",
    "bench_disturb",
    "bench_plan",
    "bench_problems",
    "bench_reaction",
    "bench_replan",
    "bench_robots",
    "bench_soak",
    "bench_tick",
]
