"""Self proximity equals brute force over all pairs; segment distances equal dense sampling."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import configuration, distance, link_poses, random_coordinates, self_distances
from cases import each, each_robot
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from elastic_strips.collision import BodySet, MotionBounds, SelfProximity
from elastic_strips.collision.narrowphase import GJK_EXCESS
from elastic_strips.collision.self_distance import segment_distance
from elastic_strips.native import twin
from elastic_strips.robot import Kinematics, RobotModel

INFLUENCE = 0.08
ends = arrays(float, (6, 2, 3), elements=st.floats(-2, 2, width=32))


@settings(max_examples=200, deadline=None, derandomize=True)
@given(one=ends, two=ends)
def test_segment_distance_never_exceeds_the_truth(one, two):
    one[1, 1] = one[1, 0]  # a point
    two[2, 1] = two[2, 0]
    one[3, 1] = one[3, 0] + 2 * (two[3, 1] - two[3, 0])  # parallel
    found = segment_distance(one, two)
    s = np.linspace(0.0, 1.0, 60)
    p = one[:, :1] + s[None, :, None] * (one[:, 1:] - one[:, :1])
    q = two[:, :1] + s[None, :, None] * (two[:, 1:] - two[:, :1])
    sampled = np.linalg.norm(p[:, :, None] - q[:, None], axis=3).min(axis=(1, 2))
    length = np.linalg.norm(one[:, 1] - one[:, 0], axis=1) + np.linalg.norm(two[:, 1] - two[:, 0], axis=1)
    assert (found <= sampled + 1e-9).all()
    assert (found >= sampled - length / 59).all()


def make(robot: RobotModel, **options: float) -> SelfProximity:
    bodies = BodySet.links(robot)
    return SelfProximity(bodies, robot.self_pairs, MotionBounds(bodies), influence=INFLUENCE, **options)


def check(robot: RobotModel, proximity: SelfProximity, coordinates: np.ndarray, tolerance: float = 1e-6) -> int:
    truth = np.array([self_distances(robot, configuration(robot, row)) for row in coordinates])
    assert (proximity.bound <= truth + 1e-9).all()
    contacts = proximity.contacts()
    found = np.zeros(truth.shape, dtype=bool)
    found[contacts.node, contacts.pair] = True
    assert found[truth < INFLUENCE - tolerance].all()
    assert not found[truth > INFLUENCE + tolerance].any()
    np.testing.assert_allclose(contacts.distance, truth[found], atol=tolerance)
    return len(contacts)


@each_robot
def test_equals_brute_force(robot, rng):
    proximity, kin = make(robot), Kinematics(robot.tree, 8)
    total = 0
    for _ in range(4):
        coordinates = random_coordinates(robot, rng, 25)
        kin.update(coordinates)
        before = proximity.queries
        proximity.update(kin)
        assert proximity.queries - before < 0.6 * truth_size(robot, coordinates)
        total += check(robot, proximity, coordinates)
    assert total > 20


def truth_size(robot: RobotModel, coordinates: np.ndarray) -> int:
    return len(coordinates) * len(robot.self_pairs)


@each_robot
def test_bounds_hold_through_any_history(robot, rng):
    proximity, kin = make(robot), Kinematics(robot.tree, 8)
    coordinates = random_coordinates(robot, rng, 10)
    for turn in range(20):
        if turn % 4 == 3:
            source = np.array([0, 1, 2, -1, 4, 5, 6, 7, 9])
            new = robot.space.interpolate(coordinates[2], coordinates[4], 0.5)
            coordinates = np.array([new if i < 0 else coordinates[i] for i in source])
            coordinates = np.vstack((coordinates, random_coordinates(robot, rng, 1)))
            proximity.remap(np.r_[source, -1])
        else:
            step = rng.normal(size=coordinates.shape) * 10.0 ** rng.uniform(-6, -1.5)
            coordinates = np.clip(robot.space.integrate(coordinates, step), robot.space.lower, robot.space.upper)
        kin.update(coordinates)
        proximity.update(kin)
        check(robot, proximity, coordinates, tolerance=proximity.tolerance + 1e-6)


def test_what_did_not_move_is_not_asked(silvermate, rng):
    proximity, kin = make(silvermate), Kinematics(silvermate.tree, 8)
    coordinates = random_coordinates(silvermate, rng, 30)
    kin.update(coordinates)
    proximity.update(kin)
    before, bound = proximity.queries, proximity.bound.copy()
    coordinates[:, :3] += rng.normal(size=(30, 3))  # the base moves all links alike
    kin.update(coordinates)
    proximity.update(kin)
    assert proximity.queries == before
    np.testing.assert_array_equal(proximity.bound, bound)
    proximity.reset()
    proximity.update(kin)
    assert proximity.queries > before


@each("name", ["silvermate", "tiago", "rover"])
def test_witnesses_follow_the_base(name, request, rng):
    """The base moves all links alike: distances stay, but witness points and directions move in the world."""
    robot = request.getfixturevalue(name)
    proximity, kin = make(robot), Kinematics(robot.tree, 8)
    coordinates = random_coordinates(robot, rng, 60)
    kin.update(coordinates)
    proximity.update(kin)
    moved = coordinates.copy()
    moved[:, :3] += rng.normal(size=(60, 3))
    kin.update(moved)
    proximity.update(kin)
    fresh = make(robot)
    fresh.update(kin)
    kept, new = proximity.contacts(), fresh.contacts()
    assert len(kept) == len(new) > 10
    np.testing.assert_allclose(kept.distance, new.distance, atol=1e-6)
    joint = proximity.bodies.joint
    one = robot.self_pairs[kept.pair, 0]
    rows = kin.directional(kept.node, joint[one], kept.first, kept.direction)
    expected = kin.directional(new.node, joint[one], new.first, new.direction)
    np.testing.assert_allclose(rows, expected, atol=1e-2)


def test_repulsion_distances_limit_the_contacts(silvermate, rng):
    bodies = BodySet.links(silvermate)
    repulsion = rng.uniform(0.0, 2 * INFLUENCE, len(silvermate.self_pairs))
    proximity = SelfProximity(
        bodies, silvermate.self_pairs, MotionBounds(bodies), influence=INFLUENCE, repulsion=repulsion
    )
    coordinates, kin = random_coordinates(silvermate, rng, 60), Kinematics(silvermate.tree, 60)
    kin.update(coordinates)
    proximity.update(kin)
    truth = np.array([self_distances(silvermate, configuration(silvermate, row)) for row in coordinates])
    contacts = proximity.contacts()
    wanted = truth < np.minimum(repulsion, INFLUENCE)
    assert len(contacts) == wanted.sum() > 10
    assert wanted[contacts.node, contacts.pair].all()


@each_robot
def test_direction_moves_the_first_body_away(robot, rng):
    proximity, kin, step = make(robot), Kinematics(robot.tree, 8), 1e-4
    coordinates = random_coordinates(robot, rng, 80)
    kin.update(coordinates)
    proximity.update(kin)
    contacts, links = proximity.contacts(), robot.geometries
    checked = {True: 0, False: 0}
    for k in rng.permutation(len(contacts))[:80]:
        i, j = robot.self_pairs[contacts.pair[k]]
        poses = link_poses(robot, configuration(robot, coordinates[contacts.node[k]]))
        slope, kink, here = np.zeros(3), 0.0, contacts.distance[k]
        for axis in range(3):
            ahead, back = poses[i].copy(), poses[i].copy()
            ahead[axis, 3] += step
            back[axis, 3] -= step
            up = distance(links[i].geometry, ahead, links[j].geometry, poses[j])[0]
            down = distance(links[i].geometry, back, links[j].geometry, poses[j])[0]
            slope[axis], kink = (up - down) / (2 * step), max(kink, abs(up + down - 2 * here) / step)
        if kink > 1e-2:
            continue
        np.testing.assert_allclose(contacts.direction[k], slope, atol=3e-2)
        gap = contacts.first[k] - contacts.second[k]
        np.testing.assert_allclose(gap, here * contacts.direction[k], atol=1e-5)
        checked[bool(here < 0)] += 1
    assert checked[False] >= 3
    assert checked[True] >= 3


def test_query_gives_the_same_for_any_nodes(tiago, rng):
    proximity, kin = make(tiago), Kinematics(tiago.tree, 4)
    coordinates = random_coordinates(tiago, rng, 4)
    kin.update(coordinates, jacobians=False)
    node, pair = (a.ravel() for a in np.indices((4, len(tiago.self_pairs))))
    found = proximity.query(kin, node, pair)[0]
    truth = np.concatenate([self_distances(tiago, configuration(tiago, row)) for row in coordinates])
    np.testing.assert_allclose(found, truth, atol=1e-6)
    assert np.abs(found - truth).max() <= GJK_EXCESS


@pytest.mark.parametrize("name", ["tiago"])
def test_most_pairs_are_decided_by_their_capsules(name, request, rng):
    robot = request.getfixturevalue(name)
    proximity, kin = make(robot), Kinematics(robot.tree, 4)
    coordinates = random_coordinates(robot, rng, 100)
    kin.update(coordinates)
    proximity.update(kin)
    assert 0 < proximity.queries < 0.35 * truth_size(robot, coordinates)


def test_contacts_of_nodes_that_were_carried_over_are_where_they_were(silvermate, rng):
    """Before the new nodes are measured: a strip that lost its first nodes, and one that has more than before."""
    proximity, kin = make(silvermate), Kinematics(silvermate.tree, 8)
    coordinates = random_coordinates(silvermate, rng, 40)
    for source in (np.r_[-1, 11:40], np.r_[[-1] * 8, 3:40, -1], np.arange(39, -1, -1)):
        proximity.reset()
        kin.update(coordinates)
        proximity.update(kin)
        before = proximity.contacts()
        proximity.remap(source)
        after = proximity.contacts()
        assert len(after) > 5
        where = {(int(n), int(p)): k for k, (n, p) in enumerate(zip(before.node, before.pair, strict=True))}
        same = [where[int(source[n]), int(p)] for n, p in zip(after.node, after.pair, strict=True)]
        for name in ("distance", "direction", "first", "second"):
            np.testing.assert_array_equal(getattr(after, name), getattr(before, name)[same], err_msg=name)


@each_robot
def test_the_node_before_says_of_many_pairs_that_they_are_far_apart(robot, rng):
    """Bounds from node to node hold, save queries, and hide no pair that is near; the twin makes the same."""
    start, goal = random_coordinates(robot, rng, 2)
    rows = robot.space.interpolate(start[None], goal[None], np.linspace(0.0, 0.3, 60))
    proximity, kin = make(robot), Kinematics(robot.tree, 64)
    kin.update(rows)
    proximity.update(kin)
    check(robot, proximity, rows)
    alone, single = 0, Kinematics(robot.tree, 1)
    for k, row in enumerate(rows):
        one = make(robot)
        single.update(row[None])
        one.update(single)
        alone += one.queries
        near = one.exact[0] < INFLUENCE
        np.testing.assert_allclose(proximity.exact[k, near], one.exact[0, near], atol=1e-6)
        assert not (proximity.exact[k, ~near] < INFLUENCE).any()
    assert proximity.queries <= alone
    if alone > 500:
        assert proximity.queries < 0.95 * alone
    with twin():
        other = make(robot)
        other.update(kin)
    assert other.queries == proximity.queries
    np.testing.assert_allclose(other.bound, proximity.bound, atol=1e-9)
