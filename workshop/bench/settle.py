"""Settling benchmark: gains and losses of a planned strip on its way to rest, and how long that takes."""

from __future__ import annotations

from itertools import pairwise
from time import perf_counter

from elastic_strips.errors import ConfigurationError
from elastic_strips.planning import plan_report
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.strip import Deformer, DeformReport, DeformStatus, Strip, strip_clearance

from .measure import Figures, Note, head, percentiles, silent

_FEW_TICKS = 60
"""Ticks within which a strip should be at rest."""
_UNFELT_CLEARANCE = 5e-3
"""Between two nodes a strip may be so much nearer [m] than at them, where nodes feel nothing."""
_CLEARANCE_LOSS = 1e-3
"""A strip that is nearer to something by more than this [m] has got worse."""


def bench_settle(robot: RobotModel, scenario: str, seeds: int, step: Note = silent) -> Figures:
    """Plan the problem of each seed, and settle its strip: clearance before and after, ticks, and the energy's rises.

    Problems whose start or goal is in collision with this robot, or that are not solved, are left out. Clearance is
    that of the strip between its nodes, too; it counts up to 5 mm below the influence distance, beyond which nothing
    is felt. The energy of two ticks compares where both have the same number of nodes.

    Args:
        robot: the robot.
        scenario: name of a seeded scenario.
        seeds: number of problems.
        step: called after each with a note, for a progress bar.
    """
    deformer, runs = Deformer(robot), []
    for seed in range(seeds):
        problem = get_scenario(scenario, seed=seed)
        try:
            plan = plan_report(robot, problem.scene, *problem.ends(robot), seed=seed)
        except ConfigurationError as error:  # the scenario's ends are not for every robot
            step(f"seed {seed}: {error}")
            continue
        step(f"seed {seed}: {plan.method}")
        if not plan.certified:
            continue
        runs.append({"seed": seed, **_settled(deformer, plan.strip, problem.scene)})
    count = max(len(runs), 1)
    lost = [r["clearance_before_m"] - r["clearance_after_m"] for r in runs]
    return {
        **head("settle", robot=robot.name, scenario=scenario),
        "base": robot.base_kind.value,
        "seeds": seeds,
        "strips": len(runs),
        "certified": sum(r["certified"] for r in runs) / count,
        "at_rest": sum(r["at_rest"] for r in runs) / count,
        "at_rest_soon": sum(r["at_rest"] and r["ticks"] <= _FEW_TICKS for r in runs) / count,
        "ticks": percentiles([r["ticks"] for r in runs]),
        "ms": percentiles([r["ms"] for r in runs]),
        "lost_m": percentiles([max(x, 0.0) for x in lost]),
        "worse": sum(x > _CLEARANCE_LOSS for x in lost) / count,
        "energy_rise": max((r["energy_rise"] for r in runs), default=0.0),
        "runs": runs,
    }


def _settled(deformer: Deformer, strip: Strip, scene: Scene) -> Figures:
    """What becomes of one strip."""
    energies: list[tuple[float, int]] = []

    def watch(report: DeformReport) -> None:
        energies.append((sum(report.energies.values()), len(report.strip)))

    began = perf_counter()
    report = deformer.settle(strip, scene, watch=watch)
    seconds = perf_counter() - began
    before, after = (
        min(float(strip_clearance(one, scene)), deformer.params.influence - _UNFELT_CLEARANCE)
        for one in (strip, report.strip)
    )
    # a tick's energy is that of the nodes it found, which the tick before had left
    found = [len(strip), *(count for _, count in energies)]
    rises = [
        (b[0] - a[0]) / max(a[0], 1e-9)
        for (a, b), (one, two) in zip(pairwise(energies), pairwise(found), strict=False)
        if one == two
    ]
    return {
        "status": report.status.value,
        "reason": report.reason,
        "certified": report.usable,
        "at_rest": report.status is DeformStatus.SETTLED,
        "ticks": report.ticks,
        "ms": 1e3 * seconds,
        "clearance_before_m": before,
        "clearance_after_m": after,
        "energy_rise": max(0.0, max(rises, default=0.0)),
        "nodes": (len(strip), len(report.strip)),
    }
