"""Motion bounds: no point of a body travels further than they say, along ``pin.interpolate``."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from brute_force import configuration, random_coordinates
from cases import each, each_robot
from hypothesis import given, settings
from hypothesis import strategies as st

from elastic_strips.coal_shapes import support_points
from elastic_strips.collision import BodySet, MotionBounds
from elastic_strips.robot import Kinematics, RobotModel


def body_points(robot: RobotModel, rng: np.random.Generator, count: int = 12) -> list[np.ndarray]:
    """Points (K, 3) of each link in its joint's frame: extreme ones of its shape."""
    out = []
    for piece in robot.geometries:
        points, radius = support_points(piece.geometry)
        if isinstance(piece.geometry, coal.Cylinder):  # the ring of support points lies outside: take its own
            scale = np.array([piece.geometry.radius, piece.geometry.radius, 0.0]) / np.hypot(*points[0, :2])
            points = points * np.where([True, True, False], scale, 1.0)
        points = points[rng.integers(0, len(points), count)]
        u = rng.normal(size=(count, 3))
        points = points + radius * u / np.linalg.norm(u, axis=1)[:, None]
        out.append(points @ piece.placement[:3, :3].T + piece.placement[:3, 3])
    return out


def true_travel(
    robot: RobotModel, a: np.ndarray, b: np.ndarray, points: list[np.ndarray], steps: int = 25
) -> np.ndarray:
    """Length (G,) of the longest way of any of the points of each link, as a polygon along ``pin.interpolate``."""
    q_a, q_b = configuration(robot, a), configuration(robot, b)
    data, last = robot.model.createData(), None
    way = [np.zeros(len(p)) for p in points]
    for s in np.linspace(0.0, 1.0, steps):
        pin.forwardKinematics(robot.model, data, pin.interpolate(robot.model, q_a, q_b, s))
        now = []
        for piece, local in zip(robot.geometries, points, strict=True):
            T = data.oMi[piece.joint]
            now.append(local @ T.rotation.T + T.translation)
        if last is not None:
            for g in range(len(points)):
                way[g] += np.linalg.norm(now[g] - last[g], axis=1)
        last = now
    return np.array([w.max() for w in way])


def bounds_of(robot: RobotModel, a: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Static and tight bounds (G,) of one segment."""
    bodies = BodySet.links(robot)
    bounds, kin = MotionBounds(bodies), Kinematics(robot.tree, 2)
    kin.update(np.stack((a, robot.space.integrate(a, v))))
    g = np.arange(len(bodies))
    zero = np.zeros(len(bodies), dtype=int)
    return bounds.travel(v[None])[0], bounds.tight_travel(kin, zero, g, np.tile(v, (len(bodies), 1)))


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([1e-3, 0.1, 1.0]), sparse=st.booleans())
@pytest.mark.parametrize("name", ["silvermate", "tiago", "gantry", "rover"])
def test_no_point_travels_further(name, request, seed, size, sparse):
    robot, rng = request.getfixturevalue(name), np.random.default_rng(seed)
    a, other = random_coordinates(robot, rng, 2)
    v = size * robot.space.difference(a, other)
    if sparse:  # single joints: nothing to hide behind
        v *= rng.random(robot.nv) < 0.3
    b = robot.space.integrate(a, v)
    travel, tight = bounds_of(robot, a, v)
    truth = true_travel(robot, a, b, body_points(robot, rng))
    assert (truth <= tight + 1e-9).all()
    assert (tight <= travel + 1e-9).all()


@each_robot
def test_single_freedoms_are_bounded_closely(robot, rng):
    """One freedom at a time: a zero where it does not move the body, and nowhere absurdly loose."""
    bodies = BodySet.links(robot)
    bounds = MotionBounds(bodies)
    support = np.array([robot.tree.moving(joint) for joint in bodies.joint])
    loose = []
    for k in range(robot.nv):
        a = random_coordinates(robot, rng, 1)[0]
        v = np.zeros(robot.nv)
        v[k] = 0.05
        a = np.clip(a, robot.space.lower, robot.space.upper - v)
        travel, tight = bounds_of(robot, a, v)
        truth = true_travel(robot, a, robot.space.integrate(a, v), body_points(robot, rng, 60), steps=4)
        assert (truth <= tight + 1e-12).all()
        np.testing.assert_array_equal(travel[~support[:, k]], 0.0)
        np.testing.assert_array_equal(tight[~support[:, k]], 0.0)
        assert (travel[support[:, k]] > 0).all()
        loose += list(tight[support[:, k]] / np.maximum(truth[support[:, k]], 1e-3))
    assert np.median(loose) < 1.6
    assert bounds.radius.shape == (robot.nv, len(bodies))


@each("name", ["silvermate", "tiago", "gantry"])
def test_levers_that_grow_on_the_way(name, request):
    """An inner joint sweeps while an outer one unfolds the arm: the lever at the node is not the lever on the way."""
    robot, rng = request.getfixturevalue(name), np.random.default_rng(4)
    b, last = robot.space.base_nv, len(robot.geometries) - 1
    points = body_points(robot, rng)
    joints = np.arange(b, robot.nv)
    growth = 0.0
    for _ in range(60):
        inner, outer = np.sort(rng.choice(joints, 2, replace=False))
        starts = random_coordinates(robot, rng, 12)
        v = np.zeros((12, robot.nv))
        ends = random_coordinates(robot, rng, 12)
        moves = robot.space.difference(starts, ends)
        v[:, [inner, outer]] = moves[:, [inner, outer]]
        # the start from which the last link is nearest to the inner axis
        levers = [bounds_of(robot, a, np.eye(robot.nv)[inner])[1][last] for a in starts]
        k = int(np.argmin(levers))
        travel, tight = bounds_of(robot, starts[k], v[k])
        truth = true_travel(robot, starts[k], robot.space.integrate(starts[k], v[k]), points, steps=15)
        assert (truth <= tight + 1e-9).all()
        assert (truth <= travel + 1e-9).all()
        single = tight_without_growth(robot, starts[k], v[k])
        growth = max(growth, float((truth - single).max()))
    assert growth > 0.02 or name != "silvermate", "no case where the growth of the lever matters"


def tight_without_growth(robot: RobotModel, a: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Sum (G,) of the single joints' bounds at the start: too little where a lever grows."""
    return np.sum([bounds_of(robot, a, np.eye(robot.nv)[k] * v[k])[1] for k in np.flatnonzero(v)], axis=0)


def test_a_telescope_lengthens_the_lever_of_the_base():
    model, geometry = pin.Model(), pin.GeometryModel()
    root = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "root_joint")
    low, high, one = np.array([0.0]), np.array([2.0]), np.ones(1)
    tube = model.addJoint(root, pin.JointModelPX(), pin.SE3.Identity(), "tube", one, one, low, high)
    frame = model.addJointFrame(tube)
    geometry.addGeometryObject(pin.GeometryObject("ball", tube, frame, pin.SE3.Identity(), coal.Sphere(0.1)))
    robot = RobotModel.from_pinocchio(model, geometry)
    a = np.array([0.0, 0.0, 0.0, 2.0])
    travel, tight = bounds_of(robot, a, np.array([0.0, 0.0, 1.0, 0.0]))
    assert 2.1 <= tight[0] + 1e-9 <= travel[0] + 2e-9 < 2.3
    travel, _ = bounds_of(robot, a * 0.0, np.array([0.0, 0.0, 0.0, 0.7]))
    assert travel[0] == pytest.approx(0.7)


def test_the_base_counts_its_way_once(silvermate):
    """Driving straight moves every point by exactly the distance driven."""
    a = silvermate.space.to_coordinates(silvermate.home())
    v = np.zeros(10)
    v[:2] = 0.3, 0.4
    travel, tight = bounds_of(silvermate, a, v)
    np.testing.assert_allclose(travel, 0.5)
    np.testing.assert_allclose(tight, 0.5)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([0.02, 0.3, 1.0]))
@pytest.mark.parametrize("name", ["silvermate", "tiago", "gantry"])
def test_pair_distances_change_no_more_than_their_bound(name, request, seed, size):
    """The distance between two links changes at most by what the joints between them move."""
    from brute_force import self_distances

    robot, rng = request.getfixturevalue(name), np.random.default_rng(seed)
    a, other = random_coordinates(robot, rng, 2)
    v = size * robot.space.difference(a, other)
    bodies = BodySet.links(robot)
    radius = MotionBounds(bodies).pair_radius(robot.self_pairs)
    one = self_distances(robot, configuration(robot, a))
    two = self_distances(robot, configuration(robot, robot.space.integrate(a, v)))
    assert (np.abs(two - one) <= np.abs(v) @ radius + 3e-6).all()


def test_base_motion_changes_no_pair(silvermate):
    radius = MotionBounds(BodySet.links(silvermate)).pair_radius(silvermate.self_pairs)
    np.testing.assert_array_equal(radius[:3], 0.0)
    assert (radius.sum(axis=0) > 0).all()


@each_robot
def test_bodies_lie_in_their_capsules(robot, rng):
    """The capsules on which all bounds rest, in the world."""
    bodies, kin = BodySet.links(robot), Kinematics(robot.tree, 3)
    coordinates = random_coordinates(robot, rng, 3)
    kin.update(coordinates)
    ends = bodies.capsule_ends(kin)
    data = robot.model.createData()
    for n, row in enumerate(coordinates):
        pin.forwardKinematics(robot.model, data, configuration(robot, row))
        for g, points in enumerate(body_points(robot, rng)):
            T = data.oMi[robot.geometries[g].joint]
            world = points @ T.rotation.T + T.translation
            a, way = ends[n, g, 0], ends[n, g, 1] - ends[n, g, 0]
            s = np.clip((world - a) @ way / max(way @ way, 1e-30), 0.0, 1.0)
            assert np.linalg.norm(world - a - s[:, None] * way, axis=1).max() <= bodies.radius[g] + 1e-9
    rotation, translation = bodies.placements(kin, np.array([2]), np.array([0]))
    data_pose = data.oMi[robot.geometries[0].joint].homogeneous @ robot.geometries[0].placement
    np.testing.assert_allclose(rotation[0], data_pose[:3, :3], atol=1e-12)
    np.testing.assert_allclose(translation[0], data_pose[:3, 3], atol=1e-12)
