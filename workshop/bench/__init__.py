"""Benchmarks: planning, replanning, the tick, the closed loop and the live page, measured on this machine."""

from .drive import bench_disturb, bench_drive, bench_reaction, bench_soak
from .goals import bench_goals
from .page import bench_page
from .plan import bench_plan, bench_replan
from .problems import bench_bridge, bench_problems
from .robots import bench_robots
from .tick import bench_tick

__all__ = [
    "bench_bridge",
    "bench_drive",
    "bench_disturb",
    "bench_goals",
    "bench_page",
    "bench_plan",
    "bench_problems",
    "bench_reaction",
    "bench_replan",
    "bench_robots",
    "bench_soak",
    "bench_tick",
]
