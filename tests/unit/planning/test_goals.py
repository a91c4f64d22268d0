"""Goals as people have them: what is found is there and free, what is not is said as data, and plans go there."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pinocchio as pin
import pytest
from brute_force import link_distances
from cases import each, refused

from elastic_strips.errors import ConfigurationError, GoalError, ParameterError
from elastic_strips.planning import BasePose, HandPose, check_endpoints, find_goals, plan_report
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.robot.inverse_kinematics import PoseSearch
from elastic_strips.scene import Box, Scene
from elastic_strips.strip import DeformParams

SCENE = Scene([Box((0.6, 0.6, 1.4), at=(1.5, 0.1, 0.7), name="crate")])


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return load_robot("panda")


def hand(robot: RobotModel, q: np.ndarray, frame: str = "hand_frame") -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.model.getFrameId(frame)].copy()


def test_a_heading_in_degrees_is_asked_about(silvermate):
    with refused(ParameterError, "yaw"):
        BasePose(4.0, 1.0, 90.0)
    with refused(ParameterError, "yaw"):
        find_goals(silvermate, SCENE, silvermate.home(), {"x": 4.0, "yaw": 90.0})
    assert BasePose(4.0, 1.0, -3.0 * np.pi).yaw == -3.0 * np.pi, "turns are counted"


def test_a_hand_far_away_brings_the_base(silvermate):
    start = silvermate.home(x=-1.0)
    search = find_goals(silvermate, SCENE, start, HandPose("hand_frame", (4.0, 1.0, 0.9), (0.0, 0.0, 0.0, 1.0)))
    assert len(search.configurations) > 1
    for q in search.configurations:
        placed = hand(silvermate, q)
        np.testing.assert_allclose(placed.translation, (4.0, 1.0, 0.9), atol=2e-4)
        assert np.linalg.norm(pin.log3(placed.rotation)) < 2e-3
        assert link_distances(silvermate, SCENE, q).min() > 0.0
        assert silvermate.self_collision(q) is None


def test_a_hand_nearby_leaves_the_base_where_it_is(silvermate):
    start = silvermate.home(x=-1.0)
    for q in find_goals(silvermate, SCENE, start, HandPose("hand_frame", (-0.7, -0.1, 0.9))).configurations:
        np.testing.assert_array_equal(q[:4], start[:4])
    far = find_goals(silvermate, SCENE, start, HandPose("hand_frame", (4.0, 1.0, 0.9)), base=False)
    assert len(far.configurations) == 0
    assert 3.0 < far.distance < 5.0


def all_about(robot: RobotModel, at: tuple[float, float, float]) -> list[HandPose]:
    """The hand held as at home, turned by any angle about the vertical."""
    here = hand(robot, robot.home()).rotation
    turns = [pin.rpy.rpyToMatrix(0.0, 0.0, yaw) @ here for yaw in np.arange(0.0, 6.2, 0.5)]
    return [HandPose("hand_frame", at, tuple(pin.Quaternion(R).coeffs())) for R in turns]


def test_where_the_arm_cannot_reach_it_is_not_asked(silvermate):
    """One round of each pose is enough: the first is with the base."""
    goals = all_about(silvermate, (6.0, 0.0, 0.95))
    search = find_goals(silvermate, Scene(), silvermate.home(), goals, rounds=len(goals), timeout=np.inf)
    assert len(search.configurations) > 0, search.reason


def test_where_the_arm_misses_the_nearest_of_many_goals_it_is_not_asked_for_all(silvermate, monkeypatch):
    """It is asked for eight, which are the last ones of the list, and gets there with the base, whichever it is."""
    goals = [HandPose("hand_frame", (x, 0.0, 0.95)) for x in np.linspace(1.4, 1.0, 40)]
    asked, by = Counter(), PoseSearch.round

    def counted(search, *, base):
        asked[base] += 1
        return by(search, base=base)

    monkeypatch.setattr(PoseSearch, "round", counted)
    search = find_goals(silvermate, Scene(), silvermate.home(), goals, timeout=np.inf, rounds=100)
    assert asked[False] == 8
    assert asked[True] == 32
    assert len(search.configurations) > 0
    asked.clear()
    here = [*goals, HandPose("hand_frame", (0.7, 0.0, 0.95))]
    found = find_goals(
        silvermate, Scene(), silvermate.home(), here, timeout=np.inf, rounds=100, count=60
    ).configurations
    assert (found[:, :4] == silvermate.home()[:4]).all(axis=1).any(), "it stays where it is"
    assert asked[False] > len(here), "one of the eight is within reach, so others may be"


def test_the_base_is_put_where_a_way_leads(silvermate):
    """The near side of the table is fenced in."""
    fence = [
        Box((0.05, 2.2, 0.3), at=(1.2, 0.0, 0.15), name="front"),
        Box((1.3, 0.05, 0.3), at=(1.825, 1.1, 0.15), name="left"),
        Box((1.3, 0.05, 0.3), at=(1.825, -1.1, 0.15), name="right"),
    ]
    table = Box((0.8, 2.4, 0.7), at=(2.8, 0.0, 0.35), name="table")
    goals = all_about(silvermate, (2.8, 0.0, 0.95))
    search = find_goals(silvermate, Scene([table, *fence]), silvermate.home(), goals, rounds=100, timeout=np.inf)
    assert len(search.configurations) > 1
    assert (search.configurations[:, 0] > 2.8).all()
    closed = Box((0.05, 2.2, 0.3), at=(4.6, 0.0, 0.15), name="back")
    sides = [Box((2.2, 0.05, 0.3), at=(3.5, y, 0.15)) for y in (1.1, -1.1)]
    shut = find_goals(
        silvermate, Scene([table, *fence, closed, *sides]), silvermate.home(), goals, rounds=100, timeout=np.inf
    )
    assert len(shut.configurations) > 0, "where no way leads anywhere, what is free is an answer"


def test_where_there_are_many_the_base_stands_all_about(silvermate):
    """Beside one another all of them may be where no way leads to: between the table and a wall."""
    table = Box((0.4, 0.4, 0.7), at=(3.0, 0.0, 0.35), name="table")
    goals = all_about(silvermate, (3.0, 0.0, 0.95))
    search = find_goals(silvermate, Scene([table]), silvermate.home(), goals, rounds=100, timeout=np.inf)
    rows = silvermate.space.to_coordinates(search.configurations)
    assert len(rows) == 6
    apart = np.hypot(*(rows[:, None, :2] - rows[None, :, :2]).transpose(2, 0, 1))
    assert apart[~np.eye(6, dtype=bool)].min() > 0.25
    away = np.linalg.norm(rows - silvermate.space.to_coordinates(silvermate.home()), axis=1)
    assert (np.diff(away) >= 0.0).all(), "the nearest first"


def test_what_is_found_keeps_the_clearances_that_are_asked_for(silvermate):
    params = DeformParams(clearance=0.02, self_clearance=0.03)
    goals = all_about(silvermate, (3.0, 1.0, 0.7))
    search = find_goals(
        silvermate, SCENE, silvermate.home(x=-1.0), goals, params=params, count=40, rounds=60, timeout=np.inf
    )
    assert len(search.configurations) == 40
    for q in search.configurations:
        check_endpoints(silvermate, SCENE, q, q, params)


def test_a_base_and_a_region_for_it(silvermate):
    start = silvermate.home(x=-1.0, joints={"arm_1_joint": 0.3})
    (q,) = find_goals(silvermate, SCENE, start, BasePose(4.0, 1.0, 0.5)).configurations
    np.testing.assert_allclose(silvermate.space.to_coordinates(q)[:3], (4.0, 1.0, 0.5))
    np.testing.assert_allclose(q[4:], start[4:], atol=1e-12)
    blocked = find_goals(silvermate, SCENE, start, BasePose(1.5, 0.1))
    assert len(blocked.configurations) == 0
    assert all(name.endswith("and crate") for name in blocked.touching)
    around = find_goals(silvermate, SCENE, start, BasePose(1.5, 0.1, within=(1.5, 1.5))).configurations
    assert len(around) > 1
    assert (np.abs(around[:, :2] - (1.5, 0.1)) <= 1.5).all()
    for q in around:
        assert link_distances(silvermate, SCENE, q).min() > 0.0


def test_some_joints_and_alternatives(silvermate):
    start = silvermate.home(x=-1.0, joints={"arm_1_joint": 0.2})
    (q,) = find_goals(silvermate, SCENE, start, {"x": 3.0, "arm_2_joint": 0.3}).configurations
    np.testing.assert_allclose(q, silvermate.home(x=3.0, joints={"arm_1_joint": 0.2, "arm_2_joint": 0.3}), atol=1e-12)
    goals = [BasePose(9.0, 0.0, 0.0), {"x": 3.0}, BasePose(1.5, 0.1, 0.0)]
    found = find_goals(silvermate, SCENE, start, goals).configurations
    np.testing.assert_allclose(found[:, 0], (3.0, 9.0))  # nearest first, and none in the crate
    none = find_goals(silvermate, SCENE, start, [BasePose(1.5, 0.1, 0.0), HandPose("hand_frame", (2.0, 0.0, 4.0))])
    assert len(none.configurations) == 0
    assert "crate" in none.reason
    assert "out of reach" in none.reason


def test_what_is_in_the_way_of_a_hand_is_named(panda):
    scene = Scene([Box((0.4, 0.4, 0.4), at=(0.5, 0.0, 0.5), name="crate")])
    search = find_goals(
        panda, scene, panda.home(joints={"panda_joint1": -1.5}), HandPose("panda_hand_tcp", (0.5, 0.0, 0.5))
    )
    assert len(search.configurations) == 0
    assert search.distance == 0.0
    assert any(name.endswith("and crate") for name in search.touching)
    assert "crate" in search.reason


def test_plans_go_to_goals(silvermate, panda):
    start = silvermate.home(x=-1.0)
    report = plan_report(silvermate, SCENE, start, HandPose("hand_frame", (4.0, 1.0, 0.9)))
    assert report.certified
    np.testing.assert_allclose(hand(silvermate, report.strip.q[-1]).translation, (4.0, 1.0, 0.9), atol=2e-4)
    assert "of the goal" in report.reason
    report = plan_report(panda, Scene(), panda.home(), [{"panda_joint1": 1.0}, {"panda_joint1": 9.0}][:1])
    assert report.strip.q[-1][0] == pytest.approx(1.0)
    with refused(GoalError, "reach") as error:
        plan_report(silvermate, SCENE, start, HandPose("hand_frame", (2.0, 0.0, 4.0)))
    assert error.value.search.distance > 1.0  # type: ignore[attr-defined]


def test_wrong_goals_are_refused(silvermate, panda):
    start = silvermate.home(x=-1.0)
    with refused(ConfigurationError, "'panda'"):
        find_goals(panda, Scene(), panda.home(), BasePose(1.0, 0.0))
    with refused(ConfigurationError, "'panda'"):
        find_goals(panda, Scene(), panda.home(), {"x": 1.0})
    with refused(ConfigurationError, "'arm_one'"):
        find_goals(silvermate, SCENE, start, {"arm_one": 1.0})
    with refused(ParameterError, "empty"):
        find_goals(silvermate, SCENE, start, [])
    with refused(ParameterError, "configuration"):
        find_goals(silvermate, SCENE, start, None)  # type: ignore[arg-type]
    with refused(ParameterError, "configuration"):
        find_goals(silvermate, SCENE, start, "the kitchen")  # type: ignore[arg-type]
    with refused(ParameterError, "negative"):
        BasePose(0.0, 0.0, within=(-1.0, 0.0))
    with refused(ParameterError, "length"):
        HandPose("hand_frame", (1.0, 0.0, 1.0), (0.0, 0.0, 0.0, 2.0))
    with refused(ConfigurationError, "limits"):
        find_goals(silvermate, SCENE, start, {"arm_1_joint": 99.0})


def test_grasps_from_all_about():
    """The point that the hand holds comes to where it is asked for, whichever way the hand is turned."""
    held, point = np.array((0.2, 0.01, -0.02)), np.array((1.0, -2.0, 0.5))
    rolls = [pin.rpy.rpyToMatrix(roll, 0.0, 0.0) for roll in (0.0, 1.5)]
    poses = HandPose.around("hand_frame", point, held=held, rotations=rolls, count=6)
    assert len({pose.position for pose in poses}) == len(poses) == 12
    headings = []
    for k, pose in enumerate(poses):
        R = pin.Quaternion(np.array(pose.orientation)).matrix()
        np.testing.assert_allclose(R @ held + pose.position, point, atol=1e-12)
        headings.append(np.arctan2(R[1, 0], R[0, 0]))
        assert R[2] == pytest.approx(rolls[k % 2][2], abs=1e-12)  # turned about the vertical alone
    np.testing.assert_allclose(np.diff(np.unwrap(headings[::2])), np.pi / 3.0, atol=1e-12)
    tilted = HandPose.around("hand_frame", point, rotations=np.eye(3), axis=(0.0, 2.0, 0.0), count=4)
    assert [pose.position for pose in tilted] == [tuple(point)] * 4
    np.testing.assert_allclose(
        pin.Quaternion(np.array(tilted[1].orientation)).matrix(), pin.rpy.rpyToMatrix(0.0, np.pi / 2, 0.0), atol=1e-12
    )


def test_grasps_from_above():
    """The hand that leads to what it holds comes from further up by each tilt, and holds it where it did."""
    held, point = np.array((0.2, 0.01, 0.0)), np.array((1.0, -2.0, 0.5))
    poses = HandPose.around("hand_frame", point, held=held, rotations=np.eye(3), count=3, tilts=(0.0, 0.5, np.pi / 2))
    assert len(poses) == 9
    for k, pose in enumerate(poses):
        lever = pin.Quaternion(np.array(pose.orientation)).matrix() @ held
        np.testing.assert_allclose(lever + pose.position, point, atol=1e-12)
        assert np.arcsin(-lever[2] / np.linalg.norm(held)) == pytest.approx((0.0, 0.5, np.pi / 2)[k % 3], abs=1e-6)
    level = HandPose.around("hand_frame", point, held=held, rotations=np.eye(3), count=3)
    assert poses[::3] == level


@each(
    ("wrong", "match"),
    [
        ({"tilts": (0.5,), "held": (0.0, 0.0, 0.0)}, "tilts"),
        ({"tilts": (0.5,), "held": (0.0, 0.0, 0.2)}, "tilts"),
        ({"tilts": 0.5}, "tilts"),
        ({"tilts": (np.nan,), "held": (0.2, 0.0, 0.0)}, "tilts"),
        ({"tilts": "down"}, "tilts"),
        ({"rotations": np.eye(4)}, "rotations"),
        ({"rotations": [1.0, 2.0]}, "rotations"),
        ({"held": (1.0, 2.0)}, "held"),
        ({"axis": (0.0, 0.0, 0.0)}, "axis"),
        ({"count": 0}, "count"),
    ],
)
def test_wrong_grasps_are_refused(wrong, match):
    with pytest.raises(ParameterError, match=match):
        HandPose.around("hand_frame", (0.0, 0.0, 0.0), **{"rotations": np.eye(3), **wrong})
