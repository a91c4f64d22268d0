"""Replanning: what stands and breaks the strip is planned around, what moves is waited for."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from brute_force import link_distances
from cases import each

from elastic_strips.collision import BrokenSegment
from elastic_strips.control import DriveParams
from elastic_strips.control.replanning import Replanner, SwitchingReplanner, standing
from elastic_strips.planning import BasePose, find_goals, plan_report
from elastic_strips.scene import Box, Cylinder, Scene, Twist
from elastic_strips.strip import LookAt, OrientationConstraint
from elastic_strips.strip.constraint import ConstraintForce

pytestmark = pytest.mark.usefixtures("own_time")

SCENE = Scene(
    [
        Box((0.3, 0.3, 1.0), at=(2.0, 0.0, 0.5), name="crate"),
        Cylinder(0.2, 1.6, at=(3.0, 0.0, 0.8), name="walker", motion=Twist((0.5, 0.0, 0.0))),
        Cylinder(0.2, 1.6, at=(4.0, 2.0, 0.8), name="idler", motion=Twist((0.01, 0.0, 0.0))),
    ]
)


def proposal(broken_by: str | None, *, accepted: bool):
    broken = None if broken_by is None else BrokenSegment(3, "base", broken_by, -0.1, "obstacle", True)
    return SimpleNamespace(
        accepted=accepted, reason="no motion", report=SimpleNamespace(certificate=SimpleNamespace(broken=broken))
    )


@pytest.fixture
def replanner(silvermate):
    return Replanner(silvermate, DriveParams(replan_after=0.5, replan_time=0.3), seed=0, grid=True)


def plan_anew(replanner, scene, start, goal):
    found = replanner.another(scene, start, goal)()
    replanner.take(found)
    return found.strip, found.reason


@each("taken, x", [(False, 5.0), (True, 3.5)])
def test_another_way_to_be_at_the_goal_is_looked_for_where_there_is_none_to_the_present_one(
    replanner, silvermate, taken, x
):
    """And only there: to look for others takes long."""
    scene = SCENE.with_obstacle(Box((0.4, 0.4, 0.8), at=(5.0, 0.0, 0.4), name="there")) if taken else SCENE
    goal, otherwise = silvermate.home(x=5.0), BasePose(3.5, -1.0, yaw=0.0)
    found = replanner.another(scene, silvermate.home(), goal, otherwise)()
    assert found.strip is not None, found.reason
    assert found.strip.coordinates[-1, 0] == pytest.approx(x)


def test_what_stands_stops_the_robot_and_is_planned_around(replanner, silvermate):
    seen = [replanner.watch(t, proposal("crate", accepted=True), SCENE, at_rest=False) for t in (0.0, 0.3)]
    assert seen == ["", ""]
    assert not replanner.halted
    reason = replanner.watch(0.6, proposal("crate", accepted=True), SCENE, at_rest=False)
    assert "crate" in reason, "it is planned around while the robot still brakes"
    assert replanner.halted
    assert replanner.pending
    assert replanner.due == pytest.approx(0.9)
    strip, text = plan_anew(replanner, SCENE, silvermate.home(), silvermate.home(x=5.0))
    assert strip is not None, text
    assert not replanner.halted


def test_what_moves_is_waited_for(replanner):
    for k in range(40):
        assert replanner.watch(0.1 * k, proposal("walker", accepted=True), SCENE, at_rest=False) == ""
    assert not replanner.halted


def test_a_strip_that_leads_nowhere_is_given_up_at_rest(replanner):
    assert replanner.watch(0.0, proposal(None, accepted=False), SCENE, at_rest=True) == ""
    assert replanner.watch(0.6, proposal(None, accepted=False), SCENE, at_rest=False) == ""
    replanner.watch(0.7, proposal(None, accepted=False), SCENE, at_rest=True)
    assert replanner.watch(1.3, proposal(None, accepted=False), SCENE, at_rest=True) == "no motion"


def test_a_strip_that_recovers_is_kept(replanner):
    replanner.watch(0.0, proposal("crate", accepted=True), SCENE, at_rest=False)
    replanner.watch(0.6, proposal("crate", accepted=True), SCENE, at_rest=False)
    assert replanner.halted
    replanner.watch(0.7, proposal(None, accepted=True), SCENE, at_rest=False)
    assert not replanner.halted
    assert replanner.watch(0.8, proposal("crate", accepted=True), SCENE, at_rest=True) == ""


def test_what_cannot_be_satisfied_does_not_stop_the_robot(silvermate):
    start, goal = silvermate.home(), silvermate.home(x=5.0)
    level = OrientationConstraint.from_configuration(silvermate, start, "hand_frame")
    replanner = Replanner(silvermate, DriveParams(constraint=level), seed=0, grid=True)
    strip, text = plan_anew(replanner, SCENE, start, goal)
    assert strip is not None
    assert "constraint" not in text
    assert ConstraintForce(silvermate, level).missed(strip) == ""
    tilted = silvermate.home(x=5.0, joints={"arm_6_joint": 1.0})
    strip, text = plan_anew(replanner, SCENE, start, tilted)
    assert strip is not None
    rows = strip.coordinates  # satisfied on the way: the joints turn where the base has arrived
    away = np.abs(rows[:, :3] - rows[-1, :3]).max(axis=1) > 0.01
    assert away.sum() > 5
    assert ConstraintForce(silvermate, level).errors_at(rows[away]).max() <= level.tolerance + 1e-9


@pytest.mark.parametrize("kind", [Replanner, SwitchingReplanner])
def test_what_moves_is_looked_at_where_it_is_and_what_is_not_there_is_said(silvermate, kind):
    """Planners leave out what moves."""
    look = LookAt(frame="hand_frame", axis=(1.0, 0.0, 0.0), at="walker")
    start, goal = (
        find_goals(silvermate, SCENE, silvermate.home(), BasePose(x, 0.0, 0.0), constraint=look).configurations[0]
        for x in (-1.0, 1.0)
    )
    first = kind(silvermate, DriveParams(constraint=look), seed=0, grid=True).first(SCENE, start, goal)()
    assert first.certified, first.reason
    seen = ConstraintForce(silvermate, look)
    seen.find(SCENE)
    assert seen.missed(first.strip) == ""
    nobody = LookAt(frame="hand_frame", axis=(1.0, 0.0, 0.0), at="nobody")
    first = kind(silvermate, DriveParams(constraint=nobody), seed=0, grid=True).first(SCENE, start, goal)()
    assert first.certified
    assert "nobody" in first.reason


def test_a_goal_in_collision_is_no_crash(replanner, silvermate):
    strip, text = plan_anew(replanner, SCENE, silvermate.home(), silvermate.home(x=2.0))
    assert strip is None
    assert "crate" in text


def test_only_what_stands_is_planned_with():
    still = standing(SCENE)
    assert still.names == ("crate", "idler")
    assert all(o.motion is None for o in still)


def test_who_stands_in_the_way_is_given_a_wider_berth_each_time(replanner, silvermate):
    scene = SCENE.without("crate").without("walker").moved("idler", pose_at(2.5, 0.05, 0.8))
    apart = []
    for _ in range(3):
        strip, text = plan_anew(replanner, scene, silvermate.home(), silvermate.home(x=5.0))
        assert strip is not None, text
        apart.append(min(link_distances(silvermate, scene, q).min() for q in strip.q))
    assert apart[1] > apart[0] + 0.1
    assert apart[2] > apart[1] + 0.1


def test_where_there_is_no_room_for_a_berth_the_way_is_as_narrow_as_before(replanner, silvermate):
    walls = [Box((60.0, 0.2, 1.0), at=(2.5, side * 0.65, 0.5), name=f"wall{side:+d}") for side in (-1, 1)]
    idler = SCENE.obstacle("idler").moved(pose_at(2.5, 0.5, 0.8))
    replanner.attempts = 3
    strip, text = plan_anew(replanner, Scene([*walls, idler]), silvermate.home(), silvermate.home(x=5.0))
    assert strip is not None, text


def pose_at(x: float, y: float, z: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def test_plans_count_anew_once_a_strip_was_driven_for_a_while(replanner, silvermate):
    """Else a robot that has replanned often on a long way waits longer and longer before it does so again."""
    for _ in range(3):
        plan_anew(replanner, SCENE, silvermate.home(), silvermate.home(x=5.0))

    def gives_up_after(t, moves):
        """[s] after which a broken strip is given up, where it was whole for ``moves`` seconds before."""
        for k in range(round(10 * moves)):
            assert not replanner.watch(t + 0.1 * k, proposal(None, accepted=True), SCENE, at_rest=False)
        begin = t + moves
        for k in range(200):
            if replanner.watch(begin + 0.1 * k, proposal("crate", accepted=False), SCENE, at_rest=True):
                return 0.1 * k
        raise AssertionError("it was never given up")

    assert gives_up_after(0.0, 1.0) > 1.9
    assert gives_up_after(100.0, 6.0) < 0.8
    assert replanner.count == 3


@pytest.mark.parametrize(("back", "backs_out"), [(0.5, True), (1.2, False)])
def test_who_sees_only_ahead_backs_out_where_there_is_no_other_way(silvermate, monkeypatch, back, backs_out):
    """Only after a plan has come to nothing for that, and not far."""
    found = plan_report(silvermate, Scene([]), silvermate.home(), silvermate.home(x=-back), backward=True)
    monkeypatch.setattr("elastic_strips.control.replanning.plan_report", lambda *_, **__: found)
    replanner = Replanner(silvermate, DriveParams(backward=False), seed=0, grid=True)
    ends = silvermate.home(), silvermate.home(x=-back)
    assert plan_anew(replanner, Scene([]), *ends)[0] is None
    strip, text = plan_anew(replanner, Scene([]), *ends)
    assert (strip is not None) is backs_out, text
