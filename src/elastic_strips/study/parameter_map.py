"""Study room, parameter map: for which gains and safe distances the paper's strip reaches the target.

The paper concludes that safe distance, k_r and k_c have to be decided properly; here is what that means.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..robot import RobotModel
from ..sim.bench.measure import cached, parallel_map
from ..sim.scenarios import get_scenario
from .reactive import Outcome, paper_reactively

K_R = (0.05, 0.1, 0.2, 0.3, 0.5, 0.8)
K_C = (0.1, 0.3, 0.5, 0.7, 0.9)
SAFE = (0.4, 0.6, 0.8, 1.0, 1.5)
"""Gains, and safe distances [m], that are tried; the paper's own are among them."""


@dataclass(frozen=True, slots=True)
class Cell:
    """One run.

    Attributes:
        case: which case; k_r, k_c: gains; safe: distance d_r [m].
        outcome, reason: how it ended.
        clearance: least distance to an obstacle [m]; capped at 1.
    """

    case: str
    k_r: float
    k_c: float
    safe: float
    outcome: Outcome
    reason: str
    clearance: float


def parameter_map(
    case: str = "case-4",
    *,
    k_r: Sequence[float] = K_R,
    k_c: Sequence[float] = K_C,
    safe: Sequence[float] = SAFE,
    processes: int | None = None,
    step: Callable[[str], object] = lambda note: None,
) -> tuple[Cell, ...]:
    """Run a case with every combination; see :func:`paper_reactively`.

    Args:
        case: name of a scenario.
        k_r, k_c: gains; safe: safe distances [m].
        processes: how many; one for each core where None.
        step: called after every run with what it was.

    Returns:
        One cell a combination: by safe distance, then k_r, then k_c.

    Raises:
        ScenarioError: an unknown case.
        ParameterError: a gain or a safe distance is outside its range.
    """
    tasks = [(case, r, c, s) for s in safe for r in k_r for c in k_c]
    found: dict[tuple[float, float, float], Cell] = {}
    for result in parallel_map(_cell, tasks, processes):
        cell = Cell(**{**result, "outcome": Outcome(result["outcome"])})
        found[cell.k_r, cell.k_c, cell.safe] = cell
        step(f"k_r {cell.k_r:g}, k_c {cell.k_c:g}, safe distance {cell.safe:g} m")
    return tuple(found[task[1:]] for task in tasks)


def _cell(task: tuple[str, float, float, float]) -> dict[str, object]:
    case, k_r, k_c, safe = task
    scenario = get_scenario(case)
    robot: RobotModel = cached(f"paper {case}", lambda: scenario.load_robot(preset="paper"))
    run = paper_reactively(scenario, robot=robot, overrides={"k_r": k_r, "k_c": k_c, "influence": safe})
    return {
        "case": case, "k_r": k_r, "k_c": k_c, "safe": safe, "outcome": run.outcome.value, "reason": run.reason,
        "clearance": run.clearance,
    }  # fmt: skip
