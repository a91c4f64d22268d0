"""A start that touches slightly is left along growing distance; what is certified begins where the robot is free.

Distances are measured here by Pinocchio's own collision model with the obstacles in it.
"""

import json

import coal
import numpy as np
import pinocchio as pin
import pytest
from cases import each, refused

from elastic_strips.errors import ConfigurationError, ParameterError
from elastic_strips.planning import plan, plan_report
from elastic_strips.robot import BaseKind, load_robot
from elastic_strips.scene import Box, Mesh, Scene
from elastic_strips.strip import Deformer, DeformParams, OrientationConstraint

PARAMS = DeformParams(clearance=0.002, self_clearance=0.002)


def distances(robot, boxes, q):
    """(links, boxes) signed distances [m], and those of the self pairs, by Pinocchio."""
    model = robot.collision_model.clone()
    while len(model.collisionPairs):
        model.removeCollisionPair(model.collisionPairs[0])
    links = model.ngeoms
    for k, box in enumerate(boxes):
        pose = pin.SE3(box.pose[:3, :3], box.pose[:3, 3])
        added = model.addGeometryObject(pin.GeometryObject(f"box {k}", 0, 0, pose, coal.Box(*box.spec["size"])))
        for i in range(links):
            model.addCollisionPair(pin.CollisionPair(i, added))
    for i, k in robot.self_pairs:
        model.addCollisionPair(pin.CollisionPair(int(i), int(k)))
    data, geometry = robot.model.createData(), model.createData()
    pin.computeDistances(robot.model, data, model, geometry, q)
    return np.array([result.min_distance for result in geometry.distanceResults])


def front_of(robot, q):
    """Largest x [m] of any part of the robot, by its distance to a wall far ahead."""
    wall = Box((0.1, 10.0, 10.0), at=(10.05, 0, 0), name="far")
    return 10.0 - distances(robot, [wall], q)[: len(robot.geometries)].min()


def touching_wall(robot, q, depth):
    return Box((0.2, 6.0, 6.0), at=(front_of(robot, q) - depth + 0.1, 0, 0), name="wall")


def bent(panda):
    return panda.home(panda_joint2=0.6, panda_joint4=-1.4)


CASES = {
    "silvermate": ("silvermate", "diff_drive", lambda r: r.home(), lambda r: r.home(x=-1.0)),
    "silvermate omni": ("silvermate", "omni", lambda r: r.home(), lambda r: r.home(x=-1.0, y=0.5)),
    "panda": ("panda", None, bent, lambda r: r.home()),
    "tiago": ("tiago", None, lambda r: r.home(), lambda r: r.home(x=-0.8)),
}


@pytest.fixture(scope="module", params=CASES)
def case(request):
    name, base, start, goal = CASES[request.param]
    robot = load_robot(name, base=base)
    return robot, start(robot), goal(robot)


@pytest.mark.parametrize("depth", [0.002, 0.004])
def test_a_start_in_a_wall_is_left_and_certified_from_where_it_is_free(case, depth):
    robot, start, goal = case
    wall = touching_wall(robot, start, depth)
    scene = Scene([wall])
    report = plan_report(robot, scene, start, goal, params=PARAMS, start_depth=0.005, timeout=30.0)
    left = report.departure
    assert left is not None
    assert left.rest is not None, report.reason
    assert not report.certified
    assert not report.report.certified
    assert left.depth == pytest.approx(depth, abs=3e-4)
    assert left.contacts[0].two == "wall"
    # both parts, one after the other
    np.testing.assert_array_equal(report.strip.q[[0, -1]], [start, goal])
    np.testing.assert_array_equal(report.strip.q[: len(left.strip)][:-1], left.strip.q[:-1])
    np.testing.assert_allclose(left.rest.q[0], left.strip.q[-1], atol=1e-12)
    assert Deformer(robot, PARAMS).assess(left.rest, scene).certified
    assert not report.report.certificate.segments[: len(left.strip) - 2].all()
    # growing distance at the nodes, and nothing deeper than at the start between them
    measured = np.array([distances(robot, [wall], q) for q in left.strip.q])
    touched = measured[0] < 0.0
    assert touched.any()
    below = measured[:-1, touched] < PARAMS.clearance
    assert (np.diff(measured[:, touched], axis=0)[below] > -1e-6).all()
    assert measured[-1].min() > PARAMS.clearance
    fine = np.array([distances(robot, [wall], q) for q in left.strip.sample(5e-5)])
    assert (fine[:, touched] >= measured[0, touched] - left.tolerance).all()
    assert fine[:, ~touched].min() > 0.0
    if robot.base_kind is BaseKind.DIFF_DRIVE:
        assert left.strip.lateral_slip.max() <= 1e-9


def test_without_the_option_such_a_start_is_refused_and_the_option_is_named(case):
    robot, start, goal = case
    scene = Scene([touching_wall(robot, start, 0.003)])
    with refused(ConfigurationError, "start_depth"):
        plan_report(robot, scene, start, goal, params=PARAMS)
    with pytest.raises(ConfigurationError):
        plan(robot, scene, start, goal, params=PARAMS)


def test_a_deeper_start_and_a_goal_that_touches_are_refused(case):
    robot, start, goal = case
    scene = Scene([touching_wall(robot, start, 0.004)])
    with refused(ConfigurationError, "wall"):
        plan_report(robot, scene, start, goal, params=PARAMS, start_depth=0.002)
    with refused(ConfigurationError, "goal"):
        plan_report(robot, scene, goal, start, params=PARAMS, start_depth=0.01)


def test_a_start_that_is_free_has_no_departure(case):
    robot, start, goal = case
    report = plan_report(robot, Scene([]), start, goal, start_depth=0.005)
    assert report.departure is None
    assert report.certified, report.reason


def test_a_corner_is_left_away_from_both_of_its_walls():
    robot = load_robot("silvermate", base="omni")
    start = robot.home()
    front = touching_wall(robot, start, 0.002)
    side = Box((6.0, 0.2, 6.0), at=(0, -9.0, 0), name="side")
    y = 9.0 - 0.1 - distances(robot, [side], start)[: len(robot.geometries)].min()
    side = Box((6.0, 0.2, 6.0), at=(0, -y + 0.003 - 0.1, 0), name="side")
    walls = [front, side]
    report = plan_report(robot, Scene(walls), start, robot.home(x=-1, y=1), params=PARAMS, start_depth=0.005)
    assert report.departure is not None
    assert {c.two for c in report.departure.contacts} == {"wall", "side"}
    assert report.departure.rest is not None
    assert distances(robot, walls, report.departure.rest.q[0]).min() > PARAMS.clearance


def test_between_two_walls_that_both_touch_there_is_no_way_out():
    """A box that turns comes deeper into both."""
    robot = load_robot("jackal-box")
    start = robot.home()
    back = front_of(robot, robot.home(yaw=np.pi))
    walls = [
        touching_wall(robot, start, 0.002),
        Box((0.2, 9.0, 9.0), at=(-back + 0.002 - 0.1, 0, 0), name="back"),
    ]
    with refused(ConfigurationError, "wall"):
        plan_report(robot, Scene(walls), start, robot.home(x=20.0), params=PARAMS, start_depth=0.005)


def test_a_floor_of_a_scan_is_left_too():
    """The hand of an arm in a mesh, whose noise it touches with several pieces."""
    robot = load_robot("panda")
    start = bent(robot)
    low = Box((9, 9, 0.1), at=(0, 0, -10.05), name="far")
    hand = [i for i, piece in enumerate(robot.geometries) if piece.joint == max(p.joint for p in robot.geometries)]
    z = distances(robot, [low], start)[hand].min() - 10.0
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, start)
    x = data.oMi[robot.geometries[hand[0]].joint].translation[0]
    grid = np.stack(np.meshgrid(np.linspace(-0.15, 0.15, 12), np.linspace(-0.15, 0.15, 12)), axis=-1).reshape(-1, 2)
    heights = np.random.default_rng(0).uniform(-0.001, 0.0, len(grid))
    top = np.column_stack((grid[:, 0] + x, grid[:, 1], z + 0.003 + heights))
    index = np.arange(144).reshape(12, 12)
    a, b, c, d = (index[i : 11 + i, k : 11 + k].ravel() for i, k in ((0, 0), (0, 1), (1, 1), (1, 0)))
    table = Mesh(top, np.vstack((np.column_stack((a, b, c)), np.column_stack((a, c, d)))), name="table")
    report = plan_report(robot, Scene([table]), start, robot.home(), params=PARAMS, start_depth=0.02, timeout=30.0)
    assert report.departure is not None
    assert report.departure.rest is not None, report.reason


def test_links_that_touch_each_other_are_left():
    robot = load_robot("panda")
    rng = np.random.default_rng(0)
    for _ in range(3000):
        q = rng.uniform(robot.space.lower, robot.space.upper)
        depth = -distances(robot, [], q).min()
        if 0.0005 < depth < 0.004:
            break
    else:
        pytest.skip("no posture that touches slightly")
    report = plan_report(robot, Scene([]), q, robot.home(), params=PARAMS, start_depth=0.005, timeout=30.0)
    assert report.departure is not None
    assert distances(robot, [], report.departure.strip.q[-1]).min() > PARAMS.self_clearance
    assert not report.certified


def test_the_document_has_both_parts(case):
    robot, start, goal = case
    scene = Scene([touching_wall(robot, start, 0.003)])
    report = plan_report(robot, scene, start, goal, params=PARAMS, start_depth=0.005, timeout=30.0)
    document = json.loads(json.dumps(report.departure.document()))
    assert document["rest"] == "certified"
    assert document["depth"] == pytest.approx(0.003, abs=3e-4)
    assert np.shape(document["coordinates"]) == (len(report.departure.strip), robot.nv)


@each("value", [-0.001, 0.2, float("nan"), "deep", True])
def test_a_depth_out_of_its_range_is_refused(value):
    robot = load_robot("silvermate")
    with refused(ParameterError, "start_depth"):
        plan_report(robot, Scene([]), robot.home(), robot.home(x=1), start_depth=value)


def test_it_is_for_one_strip_without_a_constraint():
    robot = load_robot("panda")
    level = OrientationConstraint(frame="panda_hand", direction=(0, 0, -1), tolerance=0.5)
    for options in ({"count": 2}, {"constraint": level}):
        with refused(ParameterError, "start_depth"):
            plan_report(robot, Scene([]), robot.home(), robot.home(), start_depth=0.005, **options)
