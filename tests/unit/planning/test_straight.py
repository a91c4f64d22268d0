"""Straight motions of the hand: on the line and not turned, by Pinocchio; and the reason where they end."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from brute_force import link_distances
from cases import each, refused

from elastic_strips.errors import ConfigurationError, ParameterError, RobotError
from elastic_strips.planning import plan_straight
from elastic_strips.planning.straight import straight_lines
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.robot.inverse_kinematics import PoseSolver
from elastic_strips.scene import Box, Scene
from elastic_strips.strip import DeformParams

HAND = "panda_hand_tcp"


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return load_robot("panda")


@pytest.fixture(scope="module")
def start(panda) -> np.ndarray:
    q = panda.inverse_kinematics(HAND, (0.45, 0.1, 0.4), (1.0, 0.0, 0.0, 0.0), near=panda.home()).q
    assert q is not None
    return q


def hand(robot: RobotModel, q: np.ndarray, frame: str = HAND) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.model.getFrameId(frame)].copy()


@each("by", [(0.0, 0.0, -0.15), (0.1, 0.05, 0.1), (0.0, -0.3, 0.0)])
def test_the_hand_goes_straight_and_is_not_turned(panda, start, by):
    report = plan_straight(panda, Scene(), start, HAND, by)
    assert report.certified, report.reason
    np.testing.assert_array_equal(report.strip.q[0], start)
    first = hand(panda, start)
    way = np.asarray(by) / np.linalg.norm(by)
    last = -1.0
    for q in report.strip.q:
        placed = hand(panda, q)
        off = placed.translation - first.translation
        assert np.linalg.norm(off - (off @ way) * way) < 2e-5
        assert np.linalg.norm(pin.log3(first.rotation.T @ placed.rotation)) < 1e-4
        assert off @ way > last
        last = off @ way
    np.testing.assert_allclose(hand(panda, report.strip.q[-1]).translation - first.translation, by, atol=2e-5)
    for row in report.strip.sample(0.01):  # between the nodes, too
        off = hand(panda, panda.space.from_coordinates(row)).translation - first.translation
        assert np.linalg.norm(off - (off @ way) * way) < 1e-3


def test_a_base_stands_to_the_last_bit(silvermate):
    for yaw in np.linspace(-3.0, 3.0, 40):
        q = silvermate.home(0.3, -0.7, yaw)
        report = plan_straight(silvermate, Scene(), q, "hand_frame", (0.0, 0.0, 0.02))
        np.testing.assert_array_equal(report.strip.q[-1, :4], q[:4])


def test_many_lines_at_once_are_those_of_each(panda, start):
    solver = PoseSolver(panda, HAND)
    rows = panda.space.to_coordinates(np.stack([start, panda.home(), start]))
    offsets = np.array([(0.0, 0.0, -0.15), (0.05, 0.14, 0.0), (0.0, 0.0, 0.15)])
    offsets *= 0.15 / np.linalg.norm(offsets, axis=1)[:, None]
    lines, steps = straight_lines(solver, rows, offsets)
    for n in range(3):
        alone, own = straight_lines(solver, rows[n : n + 1], offsets[n : n + 1])
        assert own[0] == steps[n] > 0
        np.testing.assert_allclose(lines[n], alone[0], atol=1e-9)
    far, got = straight_lines(solver, rows, offsets * (1.0, 1.0, 20.0))
    assert got[0] < far.shape[1] - 1, "the arm ends"
    np.testing.assert_array_equal(far[0, got[0] :], np.tile(far[0, got[0]], (far.shape[1] - got[0], 1)))


def test_the_way_back_is_the_same_strip(panda, start):
    strip = plan_straight(panda, Scene(), start, HAND, (0.0, 0.0, -0.1)).strip
    back = strip.reversed()
    np.testing.assert_array_equal(back.q, strip.q[::-1])
    np.testing.assert_allclose(back.length, strip.length)


def test_what_is_in_the_way_is_named(panda, start):
    floor = Scene([Box((1.0, 1.0, 0.1), at=(0.5, 0.0, 0.2), name="table")])
    report = plan_straight(panda, floor, start, HAND, (0.0, 0.0, -0.3))
    assert not report.certified
    assert "table" in report.reason


def test_a_line_that_the_joints_do_not_have_ends_where_they_do(panda, start):
    report = plan_straight(panda, Scene(), start, HAND, (1.5, 0.0, 0.0))
    assert not report.certified
    assert "gets no further than" in report.reason
    reached = hand(panda, report.strip.q[-1]).translation - hand(panda, start).translation
    assert 0.05 < reached[0] < 0.6


def test_less_clearance_where_there_is_less(panda, start):
    """Down to 3 mm above a table's top: with what there is, and refused where more is asked for."""
    end = plan_straight(panda, Scene(), start, HAND, (0.0, 0.0, -0.1)).strip.q[-1]
    table = Box((0.2, 0.2, 0.1), at=(0.5, 0.1, 0.0), name="table")
    up = np.eye(4)
    up[:3, 3] = (0.5, 0.1, link_distances(panda, Scene([table]), end).min() - 0.003)
    scene = Scene([table.moved(up)])
    report = plan_straight(panda, scene, start, HAND, (0.0, 0.0, -0.1))
    assert report.certified, report.reason
    assert "proven with" in report.reason
    strict = plan_straight(panda, scene, start, HAND, (0.0, 0.0, -0.1), params=DeformParams(clearance=0.005))
    assert not strict.certified


def test_the_axes_of_the_hand(panda, start):
    """The hand looks down here: forwards for it is down."""
    own = plan_straight(panda, Scene(), start, HAND, (0.0, 0.0, 0.1), axes="hand")
    world = plan_straight(panda, Scene(), start, HAND, hand(panda, start).rotation @ (0.0, 0.0, 0.1))
    np.testing.assert_allclose(own.strip.q, world.strip.q, atol=1e-12)
    moved = hand(panda, own.strip.q[-1]).translation - hand(panda, start).translation
    np.testing.assert_allclose(moved, (0.0, 0.0, -0.1), atol=2e-5)


def test_wrong_input_is_refused(panda, start):
    with refused(ParameterError, "axes"):
        plan_straight(panda, Scene(), start, HAND, (0.0, 0.0, 0.1), axes="base")
    with refused(RobotError, "frame"):
        plan_straight(panda, Scene(), start, "hand", (0.0, 0.0, 0.1))
    with refused(ParameterError, "by"):
        plan_straight(panda, Scene(), start, HAND, (0.0, 0.1))
    with refused(ConfigurationError, "start"):
        plan_straight(panda, Scene(), start[:3], HAND, (0.0, 0.0, 0.1))


def on_a_table(panda: RobotModel, start: np.ndarray, gap: float) -> tuple[RobotModel, Scene]:
    """The arm with a block in its hand that stands a gap [m] above a table."""
    block = Box((0.05, 0.05, 0.1), at=(0.45, 0.1, 0.33), name="block")
    laden = panda.attached(block, HAND, q=start, touch=("panda_hand", "panda_leftfinger", "panda_rightfinger"))
    return laden, Scene([Box((0.5, 0.5, 0.2), at=(0.55, 0.1, 0.18 - gap), name="table")])


@each("gap", [-0.002, 0.0, 0.0005])
def test_what_stands_on_a_table_is_lifted_along_growing_distance(panda, start, gap):
    laden, scene = on_a_table(panda, start, gap)
    params = DeformParams(clearance=0.003)
    assert not plan_straight(laden, scene, start, HAND, (0.0, 0.0, 0.06), params=params).certified
    report = plan_straight(laden, scene, start, HAND, (0.0, 0.0, 0.06), params=params, start_depth=0.003)
    assert not report.certified
    departure = report.departure
    assert departure is not None, report.reason
    assert departure.rest is not None
    np.testing.assert_array_equal(departure.strip.q[0], start)
    np.testing.assert_array_equal(departure.rest.q[0], departure.strip.q[-1])
    assert departure.depth == pytest.approx(max(0.0, -gap), abs=1e-4)
    height = [hand(panda, q).translation[2] for q in departure.strip.q]
    assert (np.diff(height) > 0.0).all()
    assert 0.002 < height[-1] - height[0] < 0.012
    for q in departure.strip.q[::5]:  # on the line, too
        np.testing.assert_allclose(hand(panda, q).translation[:2], hand(panda, start).translation[:2], atol=1e-3)
    for q in departure.rest.sample(0.05):
        assert link_distances(laden, scene, panda.space.from_coordinates(q)).min() > 0.003


def test_what_is_pressed_down_or_goes_along_is_not_left(panda, start):
    laden, scene = on_a_table(panda, start, 0.0)
    params = DeformParams(clearance=0.003)
    for by in ((0.0, 0.0, -0.02), (0.03, 0.0, 0.0)):
        report = plan_straight(laden, scene, start, HAND, by, params=params, start_depth=0.003)
        assert not report.certified
        assert report.departure is None
        assert "block" in report.reason
    laden, scene = on_a_table(panda, start, -0.008)
    deep = plan_straight(laden, scene, start, HAND, (0.0, 0.0, 0.06), params=params, start_depth=0.003)
    assert deep.departure is None
    assert "start_depth" in deep.reason
    free = plan_straight(panda, scene, start, HAND, (0.0, 0.0, 0.06), params=params, start_depth=0.003)
    assert free.certified, "nothing touches: nothing is left"
    assert free.departure is None
