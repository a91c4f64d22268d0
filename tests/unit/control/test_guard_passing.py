"""The guard where little is to be taken: by tracking errors, by the robot's own links, along walls."""

from __future__ import annotations

import math

import numpy as np
import pytest
from guarded_drive import DT, FAR, WALL, GuardedDrive

from elastic_strips.control import Desired, GuardOutcome, GuardParams
from elastic_strips.control.executor import MotionExecutor
from elastic_strips.control.params import DriveParams, ObstacleAssumptions
from elastic_strips.control.prediction import predict
from elastic_strips.robot import load_robot
from elastic_strips.scene import Box, Cylinder, Scene, Twist, World
from elastic_strips.sim.faults import Fault, FaultPlan, FaultyPlant
from elastic_strips.trajectory import MotionLimits, ReferenceState, TrajectoryCertifier
from elastic_strips.trajectory.holding import hold_and_brake

FINE = GuardParams(drive=DriveParams(tracking_error=0.018))
OUT = dict(zip([f"arm_{k}_joint" for k in range(1, 8)], (-0.53, 1.7, -0.52, 0.1, -1.12, 0.06, -0.05), strict=True))
"""The arm of a Silvermate 1.1 m out: at full speed wheels that slip bring it further off its reference than that."""


@pytest.fixture(scope="module")
def slider():
    return load_robot("silvermate", base="omni")


def side_wall(away: float) -> Box:
    """A wall to the left of a Silvermate that drives straight on from its home, at a distance [m]."""
    return Box((8.0, 0.2, 1.0), at=(0.0, 0.27 + away + 0.1, 0.5), name="side")


# tracking errors


def test_full_speed_passes_where_the_robot_is_further_off_than_the_least_error(silvermate):
    drive = GuardedDrive(silvermate, [FAR], silvermate.home(**OUT), FINE, seed=2).run(
        6.0, Desired(twist=[1.0, 0.0, 0.0])
    )
    assert drive.outcomes() == {GuardOutcome.PASSED}
    assert not drive.faults()
    executor = drive.guard.executor
    assert executor.proven > 0.018
    assert drive.answers[-1].clearance == pytest.approx(executor.proven + drive.guard.params.drive.margin)


def test_it_keeps_its_speed_along_a_wall_where_it_is_further_off_than_the_least_error(silvermate):
    start = silvermate.home(yaw=0.5 * math.pi - math.radians(40.0), **OUT)
    drive = GuardedDrive(silvermate, [WALL], start, FINE, seed=2).run(6.0, Desired(twist=[1.0, 0.0, 0.0]))
    rows = np.array(drive.rows)
    assert (rows[-1, 1] - rows[-200, 1]) / (199 * DT) > 0.8 * 0.95
    assert not drive.faults()
    assert not drive.evaluated().contacts


def test_what_is_driven_is_certified_with_the_error_that_it_is_proven_with(silvermate):
    start = silvermate.home(yaw=0.5 * math.pi - math.radians(40.0), **OUT)
    drive = GuardedDrive(silvermate, [WALL], start, FINE, seed=2)
    certifier, errors = TrajectoryCertifier(silvermate, clearance=0.018, self_clearance=0.004), set()
    for _ in range(400):
        drive.step(Desired(twist=[1.0, 0.0, 0.0]))
        executor, scene = drive.guard.executor, drive.see(0.0)
        errors.add(executor.proven)
        certificate = certifier.certify(
            executor.active, scene, predict(scene, ObstacleAssumptions()), clearance=executor.proven + 0.005 - 1e-4
        )
        assert certificate.certified, certificate.broken
    assert min(errors) == 0.018
    assert max(errors) > 0.018


def test_a_motion_that_ends_is_proven_with_the_error_that_is_due_where_there_is_room(silvermate, monkeypatch):
    for beside, proven in ((0.1, 0.06), (0.05, 0.02)):
        drive = GuardedDrive(silvermate, [side_wall(beside)]).run(1.0, Desired(twist=[0.9, 0.0, 0.0]))
        assert drive.guard.executor.proven == 0.02
        with monkeypatch.context() as patch:
            patch.setattr(MotionExecutor, "due_error", property(lambda _: 0.06))
            drive.run(0.1, None)
            assert drive.guard.executor.proven == proven
        assert drive.run(1.5, None).answers[-1].outcome is GuardOutcome.STOPPED
        assert not drive.faults()


def test_a_scene_that_leaves_less_room_lowers_the_error_that_is_proven(silvermate, monkeypatch):
    monkeypatch.setattr(MotionExecutor, "due_error", property(lambda _: 0.06))
    drive = GuardedDrive(silvermate, [FAR]).run(1.0, Desired(twist=[0.9, 0.0, 0.0]))
    executor = drive.guard.executor
    assert executor.proven == 0.06
    drive.world = World(Scene([side_wall(0.05)]))
    drive.run(0.06, None)
    assert executor.proven == 0.02
    assert not drive.run(1.5, None).evaluated().contacts


# the robot's own links


def test_links_that_never_touch_are_no_hindrance(tiago):
    """TIAGo's wrist is within 4 to 7 mm of its forearm in every posture; others have to keep 5."""
    names = {(tiago.geometries[i].name, tiago.geometries[k].name): n for n, (i, k) in enumerate(tiago.self_pairs)}
    assert tiago.self_apart[names["arm_5_link_0", "wrist_ft_link_0+1"]] > 0.0
    rates = np.zeros(len(tiago.joint_names))
    rates[tiago.joint_names.index("arm_6_joint")] = 0.5
    out = {"arm_1_joint": 1.68, "arm_2_joint": -0.09, "arm_3_joint": 0.13, "arm_4_joint": 0.54, "arm_5_joint": 0.14}
    start = tiago.home(**out, arm_6_joint=-0.6, arm_7_joint=-0.74)
    drive = GuardedDrive(tiago, [FAR], start=start).run(2.0, Desired(joints=rates))
    assert drive.outcomes() == {GuardOutcome.PASSED}


def test_the_rest_of_the_arm_moves_on_where_one_link_is_near_the_body(silvermate):
    rates = np.array([0.0, -0.3, 0.0, 0.0, 0.0, 0.0, 0.3])
    drive = GuardedDrive(silvermate, [FAR]).run(4.0, Desired(twist=[0.3, 0.0, 0.0], joints=rates))
    moved = drive.rows[-1] - drive.rows[0]
    assert drive.answers[-1].link.startswith("body_link")
    assert drive.answers[-1].obstacle.startswith("arm")
    assert abs(drive.speeds[-1][4]) < 0.02
    assert moved[9] > 0.9 * 0.3 * 3.9
    assert moved[0] > 0.9 * 0.3 * 3.7
    assert not drive.evaluated().contacts


def test_what_is_proposed_keeps_to_the_motors_speeds(tiago):
    """However little a joint parts a pair that is too near, it is not asked for more than it can do."""
    rng, limits = np.random.default_rng(4), MotionLimits.for_robot(tiago)
    drive = GuardedDrive(tiago, [FAR])
    top = 0.95 * np.concatenate((limits.drive_speed, limits.joint_speed)) + 1e-9
    for _ in range(25):
        rates = limits.joint_speed * rng.integers(-1, 2, len(limits.joint_speed))
        drive.run(0.2, Desired(twist=[1.0, 0.0, float(rng.uniform(-2.0, 2.0))], joints=rates))
    for answer in drive.answers:
        assert (np.abs(limits.to_coordinates(answer.passed)) <= top).all()
        assert answer.link or answer.outcome is GuardOutcome.PASSED, answer.reason


# a base that slides


def test_each_axis_of_a_base_that_slides_brakes_by_itself_where_it_is_to(slider):
    limits = MotionLimits.for_robot(slider)
    speed = np.zeros(len(limits.speed))
    speed[:2] = 0.3, 0.9
    start = ReferenceState(0.0, slider.space.to_coordinates(slider.home_q), limits.to_tangent(speed), np.zeros(10))
    together, apart = (
        hold_and_brake(slider, limits, start, speed, part=0.8, hold=0.02, together=way) for way in (True, False)
    )
    for motion in (together, apart):
        assert motion.at_rest_at_end
        change = np.diff(limits.to_coordinates(motion.v), axis=0) / np.diff(motion.time)[:, None]
        assert (np.abs(change) <= 0.8 * limits.acceleration * (1 + 1e-6)).all()
    assert together.end_time == pytest.approx(apart.end_time)
    way = [motion.coordinates[-1] - start.coordinates for motion in (together, apart)]
    assert way[0][0] == pytest.approx(way[0][1] / 3.0, abs=1e-6)
    assert way[1][1] == pytest.approx(way[0][1], abs=1e-6)
    assert way[1][0] == pytest.approx(0.02 * 0.3 + 0.5 * 0.3**2 / (0.8 * limits.drive_acceleration[0]), abs=1e-3)


def test_a_wall_takes_nothing_of_the_speed_along_it(slider):
    a = math.radians(60.0)
    ways = [
        GuardedDrive(slider, [thing]).run(4.0, Desired(twist=[math.sin(a), math.cos(a), 0.0])).rows[-1]
        for thing in (WALL, FAR)
    ]
    assert ways[0][1] > 0.99 * ways[1][1]
    assert ways[0][0] < 1.5 < ways[1][0]


# what is sensed


def test_what_moves_and_is_said_to_stand_is_found_out(silvermate):
    walker = Cylinder(0.2, 1.7, at=(3.0, 1.5, 0.85), name="walker", motion=Twist(np.array([0.0, -0.4, 0.0])))
    drive = GuardedDrive(silvermate, World(Scene([walker])))
    see = drive.see
    drive.see = lambda t: Scene([o.observed(o.pose, None) for o in see(t)], time=t)  # type: ignore[method-assign]
    drive.run(2.0, Desired(twist=[0.1, 0.0, 0.0]))
    assert any("walker" in fault for fault in drive.faults())


def test_a_motor_that_goes_on_slowly_is_cut_off(silvermate, brief):
    """At 0.06 m/s no difference from what is expected is large, and the robot would roll on for as long as it lasts."""
    for kind in ("amplifier_holds",) if brief else ("amplifier_holds", "amplifier_dead"):
        drive = GuardedDrive(silvermate, [FAR])
        faults = FaultPlan([Fault(kind, start=1.0, duration=2.5)])
        drive.plant = FaultyPlant(drive.plant, faults)  # type: ignore[assignment]
        drive.run(1.0, Desired(twist=[0.06, 0.0, 0.0]))
        before = drive.rows[-1][0]
        drive.run(2.0, None)
        assert any("stand" in fault for fault in drive.faults())
        assert drive.rows[-1][0] - before < 0.04
        assert drive.speeds[-1][0] == 0.0
        drive.run(2.5, Desired(twist=[0.06, 0.0, 0.0]))
        assert drive.speeds[-1][0] > 0.05  # it goes on once the motors obey
