"""Every named scenario with every preset gives what its table says; corridors are what their generator promises."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pinocchio as pin
import pytest
import result_check
from cases import each
from coal_distances import coal_distances

from elastic_strips import RobotModel
from elastic_strips.catalogue import PRESETS
from elastic_strips.io.obstacle_document import obstacle_documents
from elastic_strips.planning import straight_line
from elastic_strips.sim.scenarios import RunResult, get_scenario, result_document, run_scenario, scenario_names
from elastic_strips.strip import DeformStatus

Array = npt.NDArray[np.float64]
Run = Callable[..., RunResult]
INFLUENCE = 0.3
"""Influence distance of the default preset [m]."""
ROOMS = "corridor", "moving-corridor", "courteous-corridor", "clutter", "closing-side", "bottleneck", "dead-end"
"""Not the paper's. Strips of many nodes that are certified soon and come to rest late: fewer ticks say as much."""


@dataclass(frozen=True, slots=True)
class Row:
    """What a scenario must give with a preset: its status, and on which side of the two obstacles it passes."""

    status: DeformStatus
    passing_side: str | None = None


_SETTLED, _BLOCKED = DeformStatus.SETTLED, DeformStatus.BLOCKED
_MOVING = DeformStatus.DEFORMING  # certified, and not at rest when its ticks are over
TABLE: dict[tuple[str, str], Row] = {
    ("case-1", "default"): Row(_SETTLED, "between"),
    ("case-2", "default"): Row(_SETTLED, "between"),
    ("case-3", "default"): Row(_SETTLED, "between"),
    ("case-4", "default"): Row(_SETTLED, "between"),
    ("case-5", "default"): Row(_SETTLED, "around"),
    ("case-6", "default"): Row(_SETTLED),
    ("case-7", "default"): Row(_SETTLED, "between"),
    ("corridor", "default"): Row(_SETTLED),
    ("clutter", "default"): Row(_SETTLED),
    ("closing-side", "default"): Row(_SETTLED),
    ("bottleneck", "default"): Row(_SETTLED),
    ("dead-end", "default"): Row(_SETTLED),
    ("moving-corridor", "default"): Row(_SETTLED),
    ("courteous-corridor", "default"): Row(_SETTLED),
    ("case-1", "paper"): Row(_SETTLED, "between"),
    ("case-2", "paper"): Row(_SETTLED, "between"),
    ("case-3", "paper"): Row(_BLOCKED, "between"),
    ("case-4", "paper"): Row(_SETTLED, "between"),
    ("case-5", "paper"): Row(_SETTLED, "around"),
    ("case-6", "paper"): Row(_SETTLED),
    ("case-7", "paper"): Row(_MOVING, "between"),
}


@pytest.fixture(scope="module")
def run() -> Run:
    """Runs a scenario with a preset, once."""
    done: dict[tuple[str, str], RunResult] = {}

    def result(name: str, preset: str) -> RunResult:
        if (name, preset) not in done:
            fewer = {"max_ticks": 100} if name in ROOMS else None
            done[name, preset] = run_scenario(get_scenario(name), preset=preset, overrides=fewer)
        return done[name, preset]

    return result


def test_the_table_covers_the_registry() -> None:
    """A new scenario needs its row; those that are not the paper's have none for the paper's preset."""
    without = {(name, "paper") for name in ROOMS}
    assert set(TABLE) == {(n, p) for n in scenario_names() for p in PRESETS} - without


@pytest.mark.parametrize("name, preset", TABLE)
def test_a_scenario_gives_what_its_row_says(run: Run, name: str, preset: str) -> None:
    """Status, certificate and passage."""
    row, result = TABLE[name, preset], run(name, preset)
    assert result.report.status is row.status, result.reason
    assert result.certified is (row.status is not _BLOCKED)
    assert result.clearance > result.params.clearance
    if row.passing_side == "around":
        assert result.method in ("grid", "ompl")
    assert row.passing_side is None or (result.passing_side or "").startswith(row.passing_side)
    if result.certified:
        assert result.report.certificate.segments.all()
        assert result.time_to_certified is not None


@pytest.mark.parametrize("name", ["case-1", "case-2"])
def test_far_from_the_obstacles_the_strip_lies_on_the_original_line(run: Run, name: str) -> None:
    """Cases 1 and 2: pushed aside beside the obstacles, back on the line from (−3, −3) to (6, 6) away from them."""
    result = run(name, "paper")
    xy = result.report.strip.q[:, :2]
    aside = np.abs(xy[:, 0] - xy[:, 1]) / np.sqrt(2.0)
    centres = np.array([obstacle.pose[:2, 3] for obstacle in result.scenario.scene])
    apart = np.linalg.norm(xy[:, None] - centres, axis=2).min(axis=1)
    assert aside.max() > 0.07
    assert apart[aside.argmax()] < 2.5
    assert (apart > 4.0).sum() > 10
    assert aside[apart > 4.0].max() < 0.03
    assert aside[[0, -1]].max() < 1e-9


def test_the_blocked_strip_of_case_3_never_collides(run: Run) -> None:
    """Every node of every strip on the way keeps clear of the obstacles, by Pinocchio and Coal alone."""
    result = run("case-3", "paper")
    robot = result_check.load(result_document(result))
    assert len(result.frames) > 10
    lowest = np.inf
    for strip in result.frames[::3] + result.frames[-1:]:
        for q in strip.q:
            pin.computeDistances(robot.model, robot.data, robot.geometry, robot.geometry_data, q)
            lowest = min(lowest, min(r.min_distance for r in robot.geometry_data.distanceResults))
    assert lowest > 0.0
    broken = result_document(result)["reason"]
    assert "do not overlap" in broken


def test_the_arm_reconfigures_in_case_7(run: Run) -> None:
    """Some joint leaves the straight strip's posture by more than 0.1 rad; in case 1 none does."""
    for preset in PRESETS:
        result = run("case-7", preset)
        assert np.abs(result.report.strip.q[:, 4:] - result.scenario.ends(result.robot)[0][4:]).max() > 0.1
    still = run("case-1", "paper")
    assert np.abs(still.report.strip.q[:, 4:] - still.scenario.ends(still.robot)[0][4:]).max() < 1e-9


def test_the_transfer_tilt_shows(run: Run) -> None:
    """Cases 1 and 2 differ in nothing but it: same way, other headings, twice as large turns in an update."""
    one, two = run("case-1", "paper"), run("case-2", "paper")
    steps = [result_document(result)["max_heading_step_rad"] for result in (one, two)]
    assert steps[1] > 1.5 * steps[0] > 0.0
    a, b = one.report.strip.q, two.report.strip.q
    assert a.shape == b.shape
    np.testing.assert_allclose(a[:, :2], b[:, :2], atol=1e-9)
    turned = np.angle((b[:, 2] + 1j * b[:, 3]) / (a[:, 2] + 1j * a[:, 3]))
    assert np.abs(turned).max() > 0.02


def _straight(robot: RobotModel, name: str, spacing: float, seed: int = 0) -> Array:
    problem = get_scenario(name, seed=seed)
    return robot.space.from_coordinates(straight_line(robot, *problem.ends(robot), spacing=spacing))


def test_the_straight_line_of_case_7_hits_the_shelf_with_the_arm_alone(silvermate: RobotModel) -> None:
    """The base passes the shelf, links of the arm do not, and the two round obstacles are missed."""
    scene = get_scenario("case-7").scene
    d = coal_distances(silvermate, scene, _straight(silvermate, "case-7", 0.02)).min(axis=0)
    shelf = scene.names.index("shelf")
    arm = np.array([piece.joint > 1 for piece in silvermate.geometries])
    assert d[arm, shelf].min() < 0.0
    assert d[~arm, shelf].min() > 0.0
    assert np.delete(d, shelf, axis=1).min() > 0.0


@each("seed", range(21))
def test_a_corridor_is_what_the_generator_promises(seed: int, silvermate: RobotModel, tiago: RobotModel) -> None:
    """32 obstacles of mixed shapes, three or more in the straight sweep, both ends free; same seed, same scene."""
    problem = get_scenario("corridor", seed=seed)
    scene = problem.scene
    assert len(scene) == 32
    assert len({obstacle.shape for obstacle in scene}) >= 5
    assert obstacle_documents(get_scenario("corridor", seed=seed).scene) == obstacle_documents(scene)
    assert obstacle_documents(get_scenario("corridor", seed=seed + 1).scene) != obstacle_documents(scene)
    for robot in (silvermate, tiago):
        start, goal = problem.ends(robot)
        ends = coal_distances(robot, scene, np.array([start, goal]))
        assert ends.min() >= INFLUENCE, (robot.name, scene.names[int(ends.min(axis=(0, 1)).argmin())])
        sweep = coal_distances(robot, scene, _straight(robot, "corridor", 0.08, seed))
        assert (sweep.min(axis=(0, 1)) < 0.0).sum() >= 3, robot.name


@pytest.mark.parametrize("name", ["corridor", "case-7"])
def test_tiago_is_certified_too(name: str, tiago: RobotModel) -> None:
    """A robot from elsewhere, at another posture, through the same scenes."""
    result = run_scenario(get_scenario(name), robot=tiago)
    assert result.certified, result.reason
    assert result.clearance > 0.05
    assert result.report.strip.lateral_slip.max() <= 1e-6
