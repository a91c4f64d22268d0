"""Approaches: the hand drives to before a place and goes straight to it, both certified, or it says why not."""

from __future__ import annotations

from itertools import count

import numpy as np
import pinocchio as pin
import pytest
from brute_force import link_distances
from cases import refused

from elastic_strips.errors import ConfigurationError, GoalError, ParameterError, RobotError
from elastic_strips.planning import BasePose, HandPose, initial_strip, plan_approach, plan_straight, problem
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Cylinder, Scene
from elastic_strips.strip import Deformer, DeformParams, OrientationConstraint, Strip
from elastic_strips.strip.constraint import ConstraintForce

HAND = "hand_frame"
TABLE = Box((0.8, 1.2, 0.7), at=(2.8, 0.0, 0.35), name="table")
CRATE = Box((0.1, 0.1, 0.1), at=(2.6, 0.0, 0.8), name="crate")


def placed(robot: RobotModel, q: np.ndarray) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.model.getFrameId(HAND)].copy()


def turned(robot: RobotModel) -> list[np.ndarray]:
    """As at home, by any angle about the vertical."""
    here = placed(robot, robot.home()).rotation
    return [pin.rpy.rpyToMatrix(0.0, 0.0, yaw) @ here for yaw in np.arange(0.0, 6.2, 0.5)]


def places(robot: RobotModel, at: tuple[float, float, float]) -> list[HandPose]:
    return [HandPose(HAND, at, tuple(pin.Quaternion(R).coeffs())) for R in turned(robot)]


@pytest.mark.parametrize("axes", ["hand", "world"])
def test_the_hand_goes_straight_to_the_place(silvermate, axes):
    scene, at = Scene([TABLE]), (2.55, 0.0, 0.95)
    by = (
        np.array((0.0, 0.0, -0.1))
        if axes == "world"
        else placed(silvermate, silvermate.home()).rotation.T @ (0.1, 0, 0)
    )
    report = plan_approach(
        silvermate, scene, silvermate.home(), places(silvermate, at), by, axes=axes, beyond=scene.with_obstacle(CRATE)
    )  # fmt: skip
    assert report.certified, report.reason
    assert report.drive is not None
    assert report.reach is not None
    drive, reach = report.drive.strip, report.reach.strip
    np.testing.assert_array_equal(drive.q[0], silvermate.home())
    np.testing.assert_array_equal(drive.q[-1], reach.q[0])
    assert report.reach.report.strip is reach
    first, last = placed(silvermate, reach.q[0]), placed(silvermate, reach.q[-1])
    np.testing.assert_allclose(last.translation, at, atol=2e-4)
    way = last.translation - first.translation
    np.testing.assert_allclose(way, by if axes == "world" else last.rotation @ by, atol=3e-4)
    np.testing.assert_array_equal(reach.q[0, :4], reach.q[-1, :4])  # the base stands
    assert Deformer(silvermate, DeformParams()).certify(drive, scene.with_obstacle(CRATE)).certified
    for strip, world in ((drive, scene.with_obstacle(CRATE)), (reach, scene)):
        assert min(link_distances(silvermate, world, q).min() for q in strip.sample(0.1)) > 0.0


def test_a_drive_keeps_what_it_has_to(silvermate):
    start = silvermate.home()
    level = OrientationConstraint.from_configuration(silvermate, start, HAND)
    report = plan_approach(
        silvermate, Scene([TABLE]), start, places(silvermate, (2.55, 0.0, 0.95)), (0.0, 0.0, -0.1), axes="world",
        constraint=level,
    )  # fmt: skip
    assert report.certified, report.reason
    assert report.drive is not None
    assert ConstraintForce(silvermate, level).missed(report.drive.strip) == ""


def test_a_place_from_which_there_is_no_way_says_why(silvermate):
    lid = Box((1.6, 2.0, 0.05), at=(2.8, 0.0, 1.35), name="lid")  # from above there is no room
    report = plan_approach(
        silvermate, Scene([TABLE, lid]), silvermate.home(), places(silvermate, (2.55, 0.0, 0.95)), (0.0, 0.0, -0.5),
        axes="world",
    )  # fmt: skip
    assert not report.certified
    assert "configurations has a way to it: " in report.reason
    assert "lid" in report.reason or "gets no further than" in report.reason


def test_how_busy_a_machine_is_changes_nothing(silvermate, monkeypatch):
    """Time goes a second further whenever anybody looks, or none at all."""
    box = Box((0.4, 0.8, 1.2), at=(1.2, 0.0, 0.6), name="box")  # the straight line is not free
    found = []
    for step in (0.0, 1.0):
        clock = count(0.0, step)
        for module in (problem, initial_strip):
            monkeypatch.setattr(module, "perf_counter", lambda clock=clock: next(clock))
        report = plan_approach(
            silvermate, Scene([TABLE, box]), silvermate.home(), places(silvermate, (2.55, 0.0, 0.95)),
            (0.0, 0.0, -0.1), axes="world",
        )  # fmt: skip
        assert report.certified, report.reason
        assert report.drive is not None
        assert report.reach is not None
        found.append((report.drive.strip.q, report.reach.strip.q, report.reason))
    for one, two in zip(*found, strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("then", [(-0.3, 0.0, 0.0), [(0.0, 0.0, 0.08), (0.0, -0.4, 0.0)]], ids=str)
def test_the_configuration_is_one_from_which_the_hand_can_go_on(silvermate, then):
    scene, start, at = Scene([TABLE]), silvermate.home(), places(silvermate, (2.55, 0.0, 0.95))
    by = (0.0, 0.0, -0.1)
    without = plan_approach(silvermate, scene, start, at, by, axes="world")
    assert without.reach is not None
    motions, q = np.atleast_2d(then), without.reach.strip.q[-1]
    went = []
    for motion in motions:
        went.append(plan_straight(silvermate, scene, q, HAND, motion))
        q = went[-1].strip.q[-1]
    assert not all(report.certified for report in went), "the first that gets there does not get on"
    report = plan_approach(silvermate, scene, start, at, by, axes="world", then=then)
    assert report.certified, report.reason
    assert report.reach is not None
    assert len(report.then) == len(motions)
    assert sum(report.failures.values()) >= 1
    assert sum("then" in what for what in report.failures) == 1
    q = report.reach.strip.q[-1]
    for motion, plan in zip(motions, report.then, strict=True):
        assert plan.certified
        np.testing.assert_array_equal(plan.strip.q[0], q)
        assert min(link_distances(silvermate, scene, row).min() for row in plan.strip.sample(0.1)) > 0.0
        way = placed(silvermate, plan.strip.q[-1]).translation - placed(silvermate, q).translation
        np.testing.assert_allclose(way, motion, atol=3e-4)
        q = plan.strip.q[-1]


def test_where_no_configuration_can_go_on_it_says_how_many_could_not(silvermate):
    report = plan_approach(
        silvermate, Scene([TABLE]), silvermate.home(), places(silvermate, (2.55, 0.0, 0.95)), (0.0, 0.0, -0.1),
        axes="world", then=[(0.0, 0.0, 0.05), (0.0, 0.0, 0.65)],
    )  # fmt: skip
    assert not report.certified
    (what,) = (what for what in report.failures if "2 of 2" in what)
    assert f"{report.failures[what]} failed at {what}" in report.reason
    assert len(report.then) == 2
    assert report.then[0].certified
    assert not report.then[1].certified


def test_more_configurations_are_looked_for_where_those_that_were_found_cannot_go_on(silvermate):
    report = plan_approach(
        silvermate, Scene([TABLE]), silvermate.home(x=2.0), places(silvermate, (2.55, 0.0, 0.95)), (0.0, 0.0, -0.1),
        axes="world", then=(0.0, 0.5, 0.0), beyond=Scene(),
    )  # fmt: skip
    assert report.certified, report.reason


def test_it_goes_to_the_side_to_which_a_way_leads(silvermate):
    """And does not spend its work on drives to the other one, which is fenced in."""
    fence = [
        Box((0.05, 2.2, 0.3), at=(1.2, 0.0, 0.15), name="front"),
        Box((1.3, 0.05, 0.3), at=(1.825, 1.1, 0.15), name="left"),
        Box((1.3, 0.05, 0.3), at=(1.825, -1.1, 0.15), name="right"),
    ]
    scene = Scene([Box((0.8, 2.4, 0.7), at=(2.8, 0.0, 0.35), name="table"), *fence])
    report = plan_approach(
        silvermate, scene, silvermate.home(), places(silvermate, (2.8, 0.0, 0.95)), (0.0, 0.0, -0.1), axes="world",
        work=1.0,
    )  # fmt: skip
    assert report.certified, report.reason
    assert report.drive is not None
    assert report.drive.strip.q[-1][0] > 2.8


def standing_can(gap: float) -> Cylinder:
    """On the table, by a gap [m], about where the hand of :func:`places` holds."""
    return Cylinder(0.03, 0.12, at=(2.55, 0.0, 0.7 + 0.06 + gap), name="can")


def test_what_stands_on_the_table_is_lifted_out_of_contact_or_refused(silvermate):
    scene, start, at = Scene([TABLE]), silvermate.home(), places(silvermate, (2.55, 0.0, 0.95))

    def approach(gap: float, depth: float):
        def laden(q: np.ndarray) -> RobotModel:
            return silvermate.attached(standing_can(gap), HAND, q=q, mass=0.4)

        return plan_approach(
            silvermate, scene, start, at, (0.0, 0.0, -0.1), axes="world", then=[(0.0, 0.0, 0.08), (-0.05, 0.0, 0.0)],
            holding=laden, start_depth=depth,
        )  # fmt: skip

    free = approach(0.02, 0.0)
    assert free.certified, free.reason
    assert all(plan.certified and "can" in str(plan.strip.robot.geometries[-1].name) for plan in free.then)
    touching = approach(0.0, 0.0)
    assert not touching.certified
    assert "can" in touching.reason
    assert "table" in touching.reason
    left = approach(0.0, 0.002)
    assert left.certified, left.reason
    lift, back = left.then
    assert back.certified
    assert not lift.certified, "of contact nothing is certified"
    assert lift.departure is not None
    assert lift.departure.rest is not None
    assert [(contact.one, contact.two) for contact in lift.departure.contacts] == [("can", "table")]
    laden = lift.strip.robot
    heights = [link_distances(laden, scene, q)[-1].min() for q in lift.departure.strip.q]
    assert (np.diff(heights[1:]) > 0.0).all(), "the can gets farther from the table, step by step"
    assert min(link_distances(laden, scene, q).min() for q in lift.departure.rest.sample(0.1)) > 0.0
    alone = Strip(silvermate, lift.strip.q)
    assert Deformer(silvermate, lift.params).certify(alone, scene).certified, "the robot itself is, from end to end"
    deep = approach(-0.005, 0.002)
    assert not deep.certified
    assert "start_depth" in deep.reason


def test_what_was_set_down_stays_there(silvermate):
    """The hand goes away without it."""
    scene, start = Scene([TABLE]), silvermate.home()
    can = Cylinder(0.03, 0.12, at=(0.0, 0.0, -0.16), name="can")
    laden = silvermate.attached(can, HAND)
    report = plan_approach(
        laden, scene, start, places(silvermate, (2.55, 0.0, 0.97)), (0.0, 0.0, -0.1), axes="world",
        then=(0.0, 0.0, 0.1), holding=silvermate,
    )  # fmt: skip
    assert report.certified, report.reason
    assert report.reach is not None
    assert len(report.reach.strip.robot.geometries) > len(report.then[0].strip.robot.geometries)


def test_what_the_hand_cannot_hold_there_is_a_failure_of_that_configuration(silvermate):
    def laden(q: np.ndarray) -> RobotModel:
        board = Box((3.0, 3.0, 0.05), at=(2.55, 0.0, 0.4), name="board")  # through the robot, wherever it stands
        return silvermate.attached(board, HAND, q=q)

    report = plan_approach(
        silvermate, Scene([TABLE]), silvermate.home(), places(silvermate, (2.55, 0.0, 0.95))[:1], (0.0, 0.0, -0.1),
        axes="world", then=(0.0, 0.0, 0.08), holding=laden,
    )  # fmt: skip
    assert not report.certified
    assert "board" in report.reason


def test_wrong_motions_are_refused(silvermate, bridge_arm):
    one, by = HandPose(HAND, (2.0, 0.0, 0.9)), (0.1, 0.0, 0.0)
    scene, start = Scene([]), silvermate.home()
    for wrong in ((0.0, 0.1), [(0.0, 0.0, 0.1), (0.0, 0.1)], (0.0, np.nan, 0.0), "up", [[[0.0, 0.0, 0.1]]]):
        with refused(ParameterError, "then"):
            plan_approach(silvermate, scene, start, one, by, then=wrong)  # type: ignore[arg-type]
    with refused(ParameterError, "holding"):
        plan_approach(silvermate, scene, start, one, by, then=(0.0, 0.0, 0.1), holding="can")  # type: ignore[arg-type]
    with refused(ParameterError, "holding"):
        plan_approach(silvermate, scene, start, one, by, holding=silvermate)
    with refused(ParameterError, "start_depth"):
        plan_approach(silvermate, scene, start, one, by, then=(0.0, 0.0, 0.1), start_depth=0.5)
    with refused(RobotError, "holding", "'bridge-arm'"):
        plan_approach(silvermate, scene, start, one, by, then=(0.0, 0.0, 0.1), holding=bridge_arm)


def test_wrong_input_is_refused(silvermate):
    scene, start, by = Scene([]), silvermate.home(), (0.1, 0.0, 0.0)
    one = HandPose(HAND, (2.0, 0.0, 0.9))
    with refused(ParameterError, "HandPoses"):
        plan_approach(silvermate, scene, start, [], by)
    with refused(ParameterError, "HandPoses"):
        plan_approach(silvermate, scene, start, [one, HandPose("base_link", (0.0, 0.0, 0.0))], by)
    with refused(ParameterError, "HandPoses"):
        plan_approach(silvermate, scene, start, [one, BasePose(1.0, 0.0)], by)  # type: ignore[list-item]
    with refused(ParameterError, "axes='tool'"):
        plan_approach(silvermate, scene, start, one, by, axes="tool")
    with refused(ParameterError, "by"):
        plan_approach(silvermate, scene, start, one, (0.1, 0.0))
    with refused(ParameterError, "work=0.0"):
        plan_approach(silvermate, scene, start, one, by, work=0.0)
    with refused(ParameterError, "timeout=nan"):
        plan_approach(silvermate, scene, start, one, by, timeout=np.nan)
    with pytest.raises(RobotError, match="did you mean"):
        plan_approach(silvermate, scene, start, HandPose("hand_fram", (2.0, 0.0, 0.9)), by)
    with refused(ConfigurationError, "start"):
        plan_approach(silvermate, scene, start, one, by, beyond=Scene([Box((1.0, 1.0, 1.0), at=(0.0, 0.0, 0.5))]))
    with refused(GoalError, "reach"):
        plan_approach(silvermate, scene, start, HandPose(HAND, (2.0, 0.0, 9.0)), by)
