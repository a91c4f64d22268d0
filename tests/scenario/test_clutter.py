"""The clutter: what its generator promises, and that it is planned."""

from __future__ import annotations

import numpy as np
from cases import each
from coal_distances import coal_distances

from elastic_strips import RobotModel
from elastic_strips.io.obstacle_document import obstacle_documents
from elastic_strips.planning import check_endpoints, plan_report, straight_line
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.sim.scenarios.halls import _guide, clutter_scene
from elastic_strips.strip import Deformer, DeformParams
from workshop.bench import bench_plan


@each("seed", range(8))
def test_a_room_is_what_the_generator_promises(seed: int, silvermate: RobotModel) -> None:
    """Obstacles at several heights, both ends free, the straight way blocked, the arm elsewhere at the goal."""
    problem = get_scenario("clutter", seed=seed)
    scene = problem.scene
    start, goal = problem.ends(silvermate)
    check_endpoints(silvermate, scene, start, goal, DeformParams(clearance=0.03))
    assert np.abs(goal[4:] - start[4:]).max() > 0.4
    assert start[1] < -1.0 < 1.0 < goal[1]
    kinds = {name.split("-")[0] for name in scene.names}
    assert {"wall", "goal", "blocker", "pillar", "table", "shelf", "beam", "partition"} <= kinds
    boards = [o.pose[2, 3] for o in scene if o.name.split("-")[0] in ("table", "shelf") and "post" not in o.name]
    assert min(boards) < 0.87 < 0.9 < max(boards)
    line = straight_line(silvermate, start, goal, spacing=0.05)
    along = coal_distances(silvermate, scene, silvermate.space.from_coordinates(line)).min(axis=(0, 1))
    lowest = dict(zip(scene.names, along, strict=True))
    assert min(lowest.values()) < 0.0
    assert all(lowest[name] > 0.05 for name in scene.names if name.startswith("beam"))
    hand = silvermate.control_points(goal)[-1]
    top = scene.obstacle("goal-table").pose[:3, 3]
    assert 0.0 < hand[2] - top[2] < 0.3
    assert (np.abs(hand[:2] - top[:2]) < [0.3, 0.5]).all()


def test_the_guide_curve_is_left_free() -> None:
    """Pillars keep 0.38 m beside their radius, boards 0.3 m less what lies between the points of their outline."""
    for seed in range(0, 40, 3):
        rng = np.random.default_rng(seed)
        guide = _guide(rng)
        for obstacle in clutter_scene(seed):
            kind = obstacle.name.split("-")[0]
            if kind not in ("pillar", "blocker", "table", "shelf"):
                continue
            local = (guide - obstacle.pose[:2, 3]) @ obstacle.pose[:2, :2]
            half = obstacle.parts[0].half_extents[:2]
            apart = np.linalg.norm(np.maximum(np.abs(local) - half, 0.0), axis=1).min()
            assert apart > 0.26, obstacle.name


def test_equal_seeds_give_equal_rooms() -> None:
    one, two, other = (obstacle_documents(get_scenario("clutter", seed=s).scene) for s in (4, 4, 5))
    assert one == two
    assert one != other


def test_rooms_are_planned(silvermate: RobotModel) -> None:
    """Five rooms by the benchmark, with the grid first; one of them certified anew and sampled."""
    figures = bench_plan(silvermate, 5, scenario="clutter", grid=True)
    assert (figures["scenario"], figures["grid"]) == ("clutter", True)
    assert figures["certified"] == 1.0, figures["failures"]
    assert 0.0 <= figures["certified_within_2_s"] <= 1.0
    assert {run["method"] for run in figures["runs"]} <= {"line", "grid", "ompl"}
    problem = get_scenario("clutter", seed=3)
    start, goal = problem.ends(silvermate)
    report = plan_report(silvermate, problem.scene, start, goal, grid=True)
    assert Deformer(silvermate).certify(report.strip, problem.scene).certified
    assert coal_distances(silvermate, problem.scene, report.strip.sample(0.05)).min() > 0.005 - 1e-5
    np.testing.assert_allclose(report.strip.q[[0, -1]], [start, goal], atol=1e-12)
