"""The parameter map: what known cells say, in the order that was asked for, on however many processes."""

from __future__ import annotations

from functools import partial

from cases import refused

from elastic_strips.errors import ParameterError, ScenarioError
from elastic_strips.sim.scenarios import get_scenario
from workshop.study import parameter_map, simulate_paper
from workshop.study.simulation import Outcome


def test_known_cells_of_case_4() -> None:
    """With the paper's gains it passes at 0.8 m as case 4 does, and not at 1.5 m as case 3 does not."""
    near, far = parameter_map("case-4", k_r=[0.3], k_c=[0.5], safe=[0.8, 1.5], processes=1)
    assert (near.safe, near.outcome) == (0.8, Outcome.REACHED)
    assert (far.safe, far.outcome) == (1.5, Outcome.BLOCKED)
    run = simulate_paper(get_scenario("case-4"))
    assert (near.reason, near.clearance) == (run.reason, run.clearance)


def test_processes_change_nothing() -> None:
    """Each cell is that of its own parameters, by safe distance, then k_r; within the base it ends in contact."""
    notes: list[str] = []
    cells = partial(parameter_map, "case-5", k_r=[0.3, 0.1], k_c=[0.5], safe=[0.2, 0.25])
    alone = cells(processes=1, step=notes.append)
    assert cells(processes=2) == alone
    assert [(c.safe, c.k_r) for c in alone] == [(0.2, 0.3), (0.2, 0.1), (0.25, 0.3), (0.25, 0.1)]
    assert all(c.outcome is Outcome.CONTACT and c.clearance <= 0.0 for c in alone)
    assert notes == [f"k_r {c.k_r:g}, k_c 0.5, safe distance {c.safe:g} m" for c in alone]


def test_wrong_input_is_refused() -> None:
    """An unknown case, and a safe distance that is none."""
    with refused(ScenarioError, "'case-8'"):
        parameter_map("case-8", processes=1)
    with refused(ParameterError, "influence"):
        parameter_map(k_r=[0.3], k_c=[0.5], safe=[-1.0], processes=1)
