"""The two robots of the benchmark problems are what these state; one without joints works throughout."""

from __future__ import annotations

import logging

import coal
import numpy as np
import pinocchio as pin
import pytest
from cases import each, refused
from shared_data import shared_data

from elastic_strips.catalogue import find_robot, is_ours
from elastic_strips.errors import ConfigurationError
from elastic_strips.planning import check_endpoints, plan_report
from elastic_strips.robot import load_robot, robot_names
from elastic_strips.scene import Box, Cylinder, Scene
from elastic_strips.sim.scenarios import get_scenario, run_scenario
from elastic_strips.strip import Deformer, DeformStatus
from elastic_strips.viewer import Viewer
from workshop.datasets import load_bridge

BRIDGE_HEIGHT = 0.70
DUCKED = {"shoulder_lift_joint": -0.35, "elbow_joint": 0.35}
"""A posture that passes under the bridge."""


def _top(robot, q) -> float:
    """Highest point [m] of a robot's collision shapes: as far as a ceiling can come down."""
    data, geometry = robot.model.createData(), robot.collision_model.createData()
    pin.updateGeometryPlacements(robot.model, data, robot.collision_model, geometry, q)
    ceiling = coal.Box(20.0, 20.0, 1.0)
    lowest = np.inf
    for shape, pose in zip(robot.collision_model.geometryObjects, geometry.oMg, strict=True):
        at = coal.Transform3s(np.eye(3), np.array([0.0, 0.0, 10.0]))
        where = coal.Transform3s(pose.rotation, pose.translation)
        gap = coal.distance(ceiling, at, shape.geometry, where, coal.DistanceRequest(), coal.DistanceResult())
        lowest = min(lowest, gap)
    return 9.5 - lowest


@each("name", [name for name in robot_names() if is_ours(find_robot(name).urdf)])
def test_the_project_s_own_robots_have_nothing_to_warn_of(name, caplog):
    """Neither at load nor on the card: each link that is drawn has its shape, and home is free."""
    with caplog.at_level(logging.WARNING, logger="elastic_strips"):
        robot = load_robot(name)
        card = robot.card()
    assert not caplog.records, caplog.text
    assert not robot.bare_links
    assert not robot.unproven
    assert robot.self_collision(robot.home_q) is None
    assert not card.troubles


def _collision_sizes(robot) -> list[tuple[float, ...]]:
    return [tuple(2.0 * g.geometry.halfSide) for g in robot.geometries if isinstance(g.geometry, coal.Box)]


def test_the_jackal_box_has_the_stated_size_and_no_joints(jackal_box):
    assert (jackal_box.nq, jackal_box.nv, jackal_box.joint_names) == (4, 3, ())
    np.testing.assert_allclose(_collision_sizes(jackal_box), [(0.508, 0.43, 0.248)])
    assert _top(jackal_box, jackal_box.home_q) == pytest.approx(0.25, abs=1e-5)
    assert len(jackal_box.self_pairs) == 0
    with refused(ConfigurationError, "none"):
        jackal_box.home(joints={"arm": 1.0})


@pytest.mark.parametrize("base", ["diff_drive", "omni"])
def test_a_robot_without_joints_plans_deforms_and_is_drawn(base, tmp_path):
    robot = load_robot("jackal-box", base=base)
    scene = Scene([Cylinder(0.2, 1.0, at=(1.5, 0.05, 0)), Box((0.3, 1, 1), at=(3, 0.6, 0.5))])
    start, goal = robot.home(), robot.home(5.0, 0.3, 1.0)
    report = plan_report(robot, scene, start, goal)
    assert report.certified, report.reason
    np.testing.assert_allclose(report.strip.q[[0, -1]], [start, goal], atol=1e-15)
    deformer = Deformer(robot)
    settled = deformer.settle(report.strip, scene)
    assert settled.status is DeformStatus.SETTLED, settled.reason
    moved = scene.moved(scene.names[0], np.array([[1, 0, 0, 1.5], [0, 1, 0, 0.1], [0, 0, 1, 0], [0, 0, 0, 1.0]]))
    assert deformer.step(settled.strip, moved, detail=True).certified
    page = Viewer(server=False).show(robot, scene, settled).save_html(tmp_path / "strip.html")
    assert page.stat().st_size > 100_000
    with refused(ConfigurationError, "'base_link'", "'cylinder-0'"):
        check_endpoints(robot, scene, robot.home(x=1.5), goal, deformer.params)


def test_a_fixed_base_without_joints_has_nothing_to_plan():
    robot = load_robot("jackal-box", base="fixed")
    assert robot.nv == 0
    report = plan_report(robot, Scene([]), robot.home(), robot.home())
    assert report.certified
    assert np.all(report.strip.length == 0.0)


@each("preset", ["default", "paper"])
@each("name", ["jackal-box", "bridge-arm"])
def test_they_run_the_paper_case(name, preset):
    problem = get_scenario("case-7")
    result = run_scenario(problem, robot=problem.load_robot(name, preset), preset=preset)
    assert result.certified, result.reason


def test_the_bridge_arm_is_what_its_problem_states(bridge_arm):
    """Base, wheels and speed; six joints; the start posture is home, sticks up, and a ducked one passes below."""
    np.testing.assert_allclose(_collision_sizes(bridge_arm), [(0.5, 0.5, 0.248)])
    assert len(bridge_arm.joint_names) == 6
    np.testing.assert_allclose(np.degrees(bridge_arm.home_q[4:]), (0, -90, 110, 0, -110, 0), atol=1e-6)
    np.testing.assert_allclose(bridge_arm.model.velocityLimit[-6:], 1.57)
    limit = bridge_arm.model.upperPositionLimit[-6:]
    np.testing.assert_allclose(limit, -bridge_arm.model.lowerPositionLimit[-6:])
    assert _top(bridge_arm, bridge_arm.home_q) > BRIDGE_HEIGHT + 0.1
    ducked = bridge_arm.home(joints=DUCKED)
    assert _top(bridge_arm, ducked) < BRIDGE_HEIGHT - 0.05
    check_endpoints(bridge_arm, Scene([]), bridge_arm.home(), ducked, Deformer(bridge_arm).params)


def test_pairs_that_the_srdf_leaves_out_never_come_nearer(bridge_arm, rng):
    """The two pairs that are not adjacent keep the distance that the file states, in any posture."""
    robot, pairs = (
        bridge_arm,
        [("forearm_link_0", "wrist_2_link_0", 0.008), ("wrist_1_link_0", "wrist_3_link_0", 0.015)],
    )
    tested = {frozenset((robot.geometries[i].name, robot.geometries[k].name)) for i, k in robot.self_pairs}
    data, model = robot.model.createData(), robot.collision_model
    geometry = model.createData()
    index = {g.name: k for k, g in enumerate(model.geometryObjects)}
    for one, two, least in pairs:
        assert frozenset((one, two)) not in tested
        for _ in range(300):
            q = robot.home_q.copy()
            q[4:] = rng.uniform(robot.model.lowerPositionLimit[4:], robot.model.upperPositionLimit[4:])
            pin.updateGeometryPlacements(robot.model, data, model, geometry, q)
            poses = [geometry.oMg[index[name]] for name in (one, two)]
            where = [coal.Transform3s(p.rotation, p.translation) for p in poses]
            shapes = [model.geometryObjects[index[name]].geometry for name in (one, two)]
            request, result = coal.DistanceRequest(), coal.DistanceResult()
            assert coal.distance(shapes[0], where[0], shapes[1], where[1], request, result) >= least - 1e-5


@pytest.mark.parametrize("leg", [0, 1])
def test_the_bridge_arm_ducks_under_the_bridge(leg, bridge_arm):
    """Both legs give a certified strip; below the deck the arm is lower than at its ends, which stick up above it."""
    problem = load_bridge(shared_data("bridge"))
    scene, ends = problem.world.at(0.0), problem.configurations(bridge_arm)
    report = plan_report(bridge_arm, scene, ends[leg], ends[leg + 1], timeout=60.0)
    assert report.certified, report.reason
    q = report.strip.sample(0.02)
    below = q[(np.abs(q[:, 0] - 0.025) < 0.2) & (np.abs(q[:, 1] - 0.025) < 0.4)]
    assert len(below) > 3
    assert np.abs(below[:, 4:] - ends[leg][4:]).max(axis=1).min() > 0.3
    assert min(_top(bridge_arm, end) for end in ends) > BRIDGE_HEIGHT
    assert Deformer(bridge_arm).certify(report.strip, scene).certified
