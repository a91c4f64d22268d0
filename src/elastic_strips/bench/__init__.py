"""Benchmarks: planning, replanning and the tick, measured on this machine."""

from .plan import bench_plan
from .replan import bench_replan
from .tick import bench_tick

__all__ = ["bench_plan", "bench_replan", "bench_tick"]
