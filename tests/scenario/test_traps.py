"""bottleneck and dead-end: their measures, and that what looks only at what is near gets stuck in them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from coal_distances import coal_distances

from elastic_strips import RobotModel, Scene
from elastic_strips.io.obstacle_document import obstacle_documents
from elastic_strips.planning import straight_line
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.sim.scenarios.halls import DOOR_WIDTH
from workshop.study.comparison import Trial, attempt

Array = npt.NDArray[np.float64]
TRAPS = ("bottleneck", "dead-end")


def _box(scene: Scene, name: str) -> tuple[Array, Array]:
    """Lowest and highest corner (3,) [m] of a box that is not turned."""
    [part] = scene.obstacle(name).parts
    middle = scene.obstacle(name).pose[:3, 3]
    return middle - part.half_extents, middle + part.half_extents


@pytest.mark.parametrize("name", TRAPS)
def test_both_ends_are_free_and_the_straight_way_is_not(name: str, silvermate: RobotModel) -> None:
    """By 0.3 m and more at the ends."""
    problem = get_scenario(name)
    start, goal = problem.ends(silvermate)
    assert coal_distances(silvermate, problem.scene, np.array([start, goal])).min() > 0.3
    line = silvermate.space.from_coordinates(straight_line(silvermate, start, goal, spacing=0.05))
    lowest = coal_distances(silvermate, problem.scene, line).min(axis=(0, 1))
    met = {wall for wall, d in zip(problem.scene.names, lowest, strict=True) if d < 0.0}
    assert met == {"bottleneck": {"wall-right"}, "dead-end": {"back"}}[name]


def test_the_door_is_as_wide_as_it_says(silvermate: RobotModel) -> None:
    """0.75 m, its middle 0.3 m beside the line; the robot fits through with its base in that middle."""
    problem = get_scenario("bottleneck")
    assert f"{DOOR_WIDTH:g} m" in problem.summary
    right, left = _box(problem.scene, "wall-right")[1][1], _box(problem.scene, "wall-left")[0][1]
    assert left - right == pytest.approx(DOOR_WIDTH)
    assert 0.5 * (left + right) == pytest.approx(0.3)
    coordinates = np.tile(silvermate.space.to_coordinates(silvermate.home_q), (61, 1))
    coordinates[:, 0], coordinates[:, 1] = np.linspace(0.0, 6.0, 61), 0.3
    assert coal_distances(silvermate, problem.scene, silvermate.space.from_coordinates(coordinates)).min() > 0.03


def test_the_dead_end_is_as_deep_and_wide_as_it_says() -> None:
    """1.2 m by 1.8 m inside, about the line, open towards the start, and without a slit at its corners."""
    problem = get_scenario("dead-end")
    assert "1.2 m deep and 1.8 m wide" in problem.summary
    back, left, right = (_box(problem.scene, name) for name in ("back", "left", "right"))
    assert left[0][1] - right[1][1] == pytest.approx(1.8)
    assert left[0][1] + right[1][1] == pytest.approx(0.0)
    for side in (left, right):
        assert back[0][0] - side[0][0] == pytest.approx(1.2)
        assert side[1][0] >= back[0][0] - 1e-9
    assert back[0][1] <= right[0][1] + 1e-9
    assert back[1][1] >= left[1][1] - 1e-9
    assert problem.start.x < left[0][0] < back[1][0] < problem.goal.x


@pytest.mark.parametrize("name", TRAPS)
def test_a_seed_changes_nothing(name: str) -> None:
    """Nothing here is random."""
    a, b = get_scenario(name, seed=0), get_scenario(name, seed=7)
    assert obstacle_documents(a.scene) == obstacle_documents(b.scene)
    assert (a.seed, b.seed) == (0, 7)


@pytest.mark.parametrize("name", TRAPS)
def test_the_potential_field_gets_stuck_and_the_strip_does_not(name: str) -> None:
    """Without a contact, short of the walls; the strip, which is planned, arrives."""
    stuck = attempt(Trial(name, "apf", time_limit=10.0))
    assert not stuck.reached
    assert stuck.contacts == ()
    assert stuck.path < 3.5
    free = attempt(Trial(name, "strip"))
    assert free.reached
    assert free.contacts == ()
