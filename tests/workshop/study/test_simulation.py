"""The paper's preset, driven reactively: how the cases end, where obstacles are sensed, and how near the links come."""

from __future__ import annotations

from collections.abc import Callable

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin
import pytest
from cases import refused

from elastic_strips import RobotModel, Scene
from elastic_strips.errors import ParameterError, RobotError
from elastic_strips.io import PoseSpec
from elastic_strips.scene import Cylinder
from elastic_strips.sim.scenarios import Scenario, get_scenario
from workshop.study import PaperRun, simulate_paper
from workshop.study.simulation import LONGEST_STEP, Outcome

Array = npt.NDArray[np.float64]
Run = Callable[[str], PaperRun]
CASES = {f"case-{k}": Outcome.BLOCKED if k == 3 else Outcome.REACHED for k in range(1, 8)}
RADIUS, HEIGHT = 0.3, 1.3
"""Of the cases' cylinders [m]."""


@pytest.fixture(scope="module")
def run() -> Run:
    """Runs a case, once."""
    done: dict[str, PaperRun] = {}

    def result(name: str) -> PaperRun:
        if name not in done:
            done[name] = simulate_paper(get_scenario(name))
        return done[name]

    return result


def _problem(*obstacles: Cylinder, way: float = 2.0, **params: object) -> Scenario:
    """Along x, with only the mobile moving."""
    return Scenario(
        name="short", summary="", scene=Scene(obstacles), start=PoseSpec(0.0, 0.0, 0.0), goal=PoseSpec(way, 0.0, 0.0),
        params={"paper": {"mobile_only": True, **params}},
    )  # fmt: skip


def _pole(x: float, y: float = 0.0) -> Cylinder:
    return Cylinder(0.2, 1.0, at=(x, y, 0.5), name="pole")


def _to_cylinder(points: Array, centre: Array) -> float:
    """Distance [m] of the nearest of some points (K, 3) to an upright cylinder of the cases."""
    beside = np.maximum(np.hypot(*(points[:, :2] - centre[:2]).T) - RADIUS, 0.0)
    return float(np.hypot(beside, np.maximum(points[:, 2] - HEIGHT, 0.0)).min())


@pytest.mark.parametrize("name, outcome", CASES.items())
def test_a_case_ends_as_the_paper_says(run: Run, name: str, outcome: Outcome) -> None:
    """Case 3 stands before the gap, the others arrive; none touches anything."""
    result = run(name)
    assert result.outcome is outcome, result.reason
    assert result.clearance > 0.1
    np.testing.assert_allclose(result.coordinates[0, :2], [-3.0, -3.0], atol=1e-9)
    there = np.hypot(*(result.coordinates[-1, :2] - 6.0)) < 1e-9
    assert there == (outcome is Outcome.REACHED)
    assert (len(result.ahead) > 2) == (outcome is Outcome.BLOCKED)


@pytest.mark.parametrize("name", CASES)
def test_obstacles_are_sensed_from_the_control_points(run: Run, name: str) -> None:
    """Each at the first sampling time with P_m (case 7: any control point) within the safe distance of it."""
    result = run(name)
    robot, safe = result.robot, result.params.influence
    assert result.params.mobile_only == (name != "case-7")
    points = [np.asarray(robot.control_points(q)) for q in robot.space.from_coordinates(result.coordinates)]
    if name != "case-7":
        points = [p[:1] for p in points]
    assert {s.name for s in result.detections} == set(result.scenario.scene.names)
    for detection in result.detections:
        if detection.name == "shelf":
            continue
        centre = result.scenario.scene.obstacle(detection.name).pose[:3, 3]
        row = int(np.hypot(*(result.coordinates[:, :2] - detection.robot).T).argmin())
        np.testing.assert_allclose(result.coordinates[row, :2], detection.robot, atol=1e-9)
        assert _to_cylinder(points[row], centre) < safe
        assert all(_to_cylinder(p, centre) >= safe for p in points[:row])
        assert detection.distance == pytest.approx(_to_cylinder(points[row], centre), abs=1e-4)
        x, y, z = detection.point
        assert np.hypot(x - centre[0], y - centre[1]) == pytest.approx(RADIUS, abs=1e-3)
        assert -1e-6 <= z <= HEIGHT


@pytest.mark.parametrize("name", ["case-1", "case-2"])
def test_obstacle_2_is_sensed_where_the_text_says(run: Run, name: str) -> None:
    """About (−1500, −1500) mm, to one posture of the original line, and before obstacle 1."""
    first = run(name).detections[0]
    assert first.name == "obstacle-2"
    assert np.hypot(*(np.array(first.robot) + 1.5)) < 0.216


@pytest.mark.parametrize("name", ["case-1", "case-7"])
def test_the_clearance_is_that_of_the_whole_way(run: Run, name: str) -> None:
    """By Coal at Pinocchio's placements, on the straight way between postures too."""
    result = run(name)
    a, b = result.coordinates[:-1, None], result.coordinates[1:, None]
    between = (a + np.linspace(0.0, 1.0, 41)[:, None] * (b - a)).reshape(-1, result.coordinates.shape[1])
    near = np.hypot(*(between[:, None, :2] - [o.pose[:2, 3] for o in result.scenario.scene]).T).min(axis=0) < 2.0
    assert result.clearance == pytest.approx(_clearance(result, between[near]), abs=0.02)
    assert _clearance(result, result.coordinates) >= result.clearance - 1e-6


def test_no_sampling_time_moves_further_than_said(run: Run) -> None:
    """Postures part where both obstacles push them; the robot does not jump over the gap without looking."""
    steps = np.hypot(*np.diff(run("case-1").coordinates[:, :2], axis=0).T)
    assert steps.max() <= LONGEST_STEP + 1e-9
    assert steps.max() > 0.9 * LONGEST_STEP, "there is such a gap in case 1"


def _clearance(result: PaperRun, coordinates: Array) -> float:
    robot = result.robot
    model = robot.collision_model.clone()
    model.removeAllCollisionPairs()
    links = len(model.geometryObjects)
    for obstacle in result.scenario.scene:
        [part] = obstacle.parts
        shape = part.geometry or coal.Box(*(2.0 * part.half_extents))
        pose = pin.SE3(obstacle.pose[:3, :3], obstacle.pose[:3, 3])
        index = model.addGeometryObject(pin.GeometryObject(obstacle.name, 0, 0, pose, shape))
        for link in range(links):
            model.addCollisionPair(pin.CollisionPair(link, index))
    data, geometry = robot.model.createData(), model.createData()
    lowest = np.inf
    for q in robot.space.from_coordinates(coordinates):
        pin.computeDistances(robot.model, data, model, geometry, q)
        lowest = min(lowest, min(r.min_distance for r in geometry.distanceResults))
    return lowest


def test_without_obstacles_the_way_is_the_line() -> None:
    """Nothing is sensed, nothing turns it aside, and the clearance is the largest that is measured."""
    result = simulate_paper(_problem())
    assert result.outcome is Outcome.REACHED
    assert result.detections == ()
    assert result.clearance == 1.0
    assert result.length == pytest.approx(2.0)
    np.testing.assert_allclose(result.coordinates[:, 1], 0.0, atol=1e-9)
    assert (np.diff(result.coordinates[:, 0]) > 0.0).all()


def test_a_safe_distance_within_the_base_ends_in_contact() -> None:
    """P_m would be 0.15 m from the pole: by then the base has touched it, though it is not sensed yet."""
    result = simulate_paper(_problem(_pole(1.2), influence=0.15))
    assert result.outcome is Outcome.CONTACT
    assert "pole" in result.reason
    assert result.clearance <= 0.0
    assert result.detections == ()
    assert result.coordinates[-1, 0] < 1.0


def test_a_start_in_contact_is_the_end() -> None:
    """No sampling time is simulated."""
    result = simulate_paper(_problem(_pole(0.2)))
    assert result.outcome is Outcome.CONTACT
    assert len(result.coordinates) == 1


def test_a_last_posture_that_cannot_be_reached_is_blocked() -> None:
    """A safe distance of 5 mm gives hulls of 5 mm, and the postures are 0.2 m apart: it stands, and says where."""
    result = simulate_paper(_problem(_pole(1.0, y=3.0), way=0.6, influence=0.0051))
    assert result.outcome is Outcome.BLOCKED
    assert "stands at (0.00, 0.00) m" in result.reason


def test_the_same_problem_gives_the_same_run(run: Run) -> None:
    """To the last bit."""
    again = simulate_paper(get_scenario("case-1"))
    np.testing.assert_array_equal(again.coordinates, run("case-1").coordinates)
    assert again.detections == run("case-1").detections


def test_wrong_input_is_refused(gantry: RobotModel) -> None:
    """A robot that cannot move its base, and parameters that are none."""
    with refused(RobotError, "fixed"):
        simulate_paper(_problem(), robot=gantry)
    with refused(ParameterError, "'k_q'"):
        simulate_paper(_problem(), overrides={"k_q": 1.0})
    with refused(ParameterError, "influence"):
        simulate_paper(_problem(), overrides={"influence": -1.0})
