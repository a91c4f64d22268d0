"""``elastic-strips bench``: many runs and their figures."""

from __future__ import annotations

import click

from . import bench_driving as driving
from . import bench_planning as planning


@click.group()
def bench() -> None:
    """Measure on this machine. The figures are percentiles; on a shared machine trust the ratios."""


for _command in (
    planning.plan, planning.replan, planning.tick, planning.settle, planning.ik, planning.robots, planning.mbm,
    planning.peers, driving.drive, driving.disturb, driving.faults, driving.reaction, driving.soak, driving.realtime,
    driving.trials, driving.barn, driving.dynabarn, driving.bridge, driving.house, planning.page,
):  # fmt: skip
    bench.add_command(_command)
