"""The guard: anybody's commands in a simulated plant; what is driven is certified, whatever is asked for."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cases import each, refused
from guarded_drive import DT, FAR, WALL, GuardedDrive
from simulated_time import planning_at_once

from elastic_strips.control import Controller, Desired, Guard, GuardOutcome, GuardParams, RunState
from elastic_strips.control.params import ObstacleAssumptions
from elastic_strips.control.prediction import predict
from elastic_strips.errors import ConfigurationError, ParameterError
from elastic_strips.robot import load_robot
from elastic_strips.scene import Box, Cylinder, Scene, Twist, World
from elastic_strips.sim import KinematicPlant
from elastic_strips.sim.closed_loop import MACHINE
from elastic_strips.trajectory import MotionLimits, ReferenceState, TrajectoryCertifier
from elastic_strips.trajectory.holding import fastest_towards, hold_and_brake


@pytest.fixture(scope="module")
def slider():
    return load_robot("silvermate", base="omni")


@pytest.fixture(scope="module")
def arm():
    return load_robot("panda")


def hostile(robot, limits, rng):
    """Everything at its limits, another way every now and then, with silence and nonsense in between."""
    count, until, now = len(limits.joint_speed), -1.0, None

    def pilot(t):
        nonlocal until, now
        if t >= until:
            until = t + rng.uniform(0.05, 0.7)
            twist = rng.integers(-1, 2, 3) * np.array([1.0, 1.0, 2.0])
            joints = rng.integers(-1, 2, count) * limits.joint_speed
            if rng.random() < 0.1:
                twist[0] = math.nan
            base = robot.space.base_nv
            now = None if rng.random() < 0.1 else Desired(twist=twist if base else None, joints=joints)
        return now

    return pilot


# the candidate motion


@each("name", ["silvermate", "slider", "arm"])
def test_a_held_motion_keeps_the_limits_ends_at_rest_and_continues(name, request):
    robot = request.getfixturevalue(name)
    limits, rng = MotionLimits.for_robot(robot), np.random.default_rng(2)
    for _ in range(20):
        now = rng.uniform(-1.0, 1.0, len(limits.speed)) * limits.speed
        start = ReferenceState(
            3.0, robot.space.to_coordinates(robot.home_q), limits.to_tangent(now), np.zeros(robot.nv)
        )
        wanted = rng.uniform(-1.0, 1.0, len(now)) * limits.speed
        motion = hold_and_brake(robot, limits, start, wanted, part=0.8, hold=0.02)
        y = limits.to_coordinates(motion.v)
        change = np.diff(y, axis=0) / np.diff(motion.time)[:, None]
        assert motion.at_rest_at_end
        assert motion.start_time == 3.0
        np.testing.assert_allclose(motion.v[0], start.v, atol=1e-12)
        assert (np.abs(change) <= 0.8 * limits.acceleration * (1 + 1e-6)).all()
        assert (np.abs(y) <= limits.speed * (1 + 1e-9)).all()


def test_each_joint_brakes_by_itself_and_the_base_on_its_arc(silvermate):
    limits = MotionLimits.for_robot(silvermate)
    speed = np.concatenate(([1.0, 0.5], limits.joint_speed * np.linspace(0.1, 1.0, 7)))
    start = ReferenceState(
        0.0, silvermate.space.to_coordinates(silvermate.home_q), limits.to_tangent(speed), np.zeros(10)
    )
    motion = hold_and_brake(silvermate, limits, start, speed, part=0.8, hold=0.02)
    y = limits.to_coordinates(motion.v)
    moving = y[:, 0] > 1e-9
    np.testing.assert_allclose(y[moving, 1] / y[moving, 0], 0.5, atol=1e-9)
    stands = [motion.time[np.flatnonzero(y[:, j] > 1e-9)[-1]] for j in (2, 8)]
    assert stands[0] < 0.5 * stands[1]


def test_a_joint_that_goes_as_fast_as_it_may_stops_at_its_stop():
    gap, now, change, hold = 0.3, 0.0, 3.0, 0.02
    for _ in range(200):
        speed = float(np.clip(fastest_towards(np.array([gap]), np.array([now]), np.array([change]), hold)[0], 0.0, 2.0))
        top = float(np.clip(speed, now - change * hold, now + change * hold))
        after = now + 0.5 * (top - now)  # a period of a hold of two
        gap, now = gap - 0.5 * (now + after) * 0.5 * hold, after
        assert gap >= -0.5 * change * hold * hold
    assert gap < 0.01


# what passes


@each("name", ["silvermate", "slider", "arm"])
def test_all_of_a_command_passes_where_nothing_is_near(name, request):
    robot = request.getfixturevalue(name)
    drive = GuardedDrive(robot, [FAR])
    joints = np.zeros(len(drive.guard.limits.joint_speed))
    joints[0] = 0.2
    drive.run(1.0, Desired(twist=[0.5, 0.0, 0.3] if robot.space.base_nv else None, joints=joints))
    assert drive.outcomes() == {GuardOutcome.PASSED}
    assert {answer.share for answer in drive.answers} == {1.0}
    base = robot.space.base_nv
    np.testing.assert_allclose(drive.plant.v[base], 0.2, atol=0.02)
    if base:
        np.testing.assert_allclose(drive.plant.v[:3], (0.5, 0.0, 0.3), atol=0.03)


def test_commands_beyond_the_motors_keep_their_curvature(silvermate):
    drive = GuardedDrive(silvermate, [FAR]).run(1.5, Desired(twist=[5.0, 0.0, 5.0]))
    assert drive.outcomes() == {GuardOutcome.PASSED}
    v = drive.answers[-1].passed
    assert v[0] == pytest.approx(v[2])
    assert (np.abs(drive.guard.limits.to_drive(v[:3])) <= drive.guard.limits.drive_speed + 1e-9).all()


def test_a_hand_moves_as_it_is_told(silvermate):
    twist = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    drive = GuardedDrive(silvermate, [FAR], start=silvermate.home(yaw=1.0))
    kin = [drive.plant.coordinates]
    drive.run(0.5, Desired(hand=twist, frame="palm_link"))
    kin.append(drive.plant.coordinates)
    import pinocchio as pin

    at = []
    for row in kin:
        data = silvermate.model.createData()
        pin.framesForwardKinematics(silvermate.model, data, silvermate.space.from_coordinates(row))
        at.append(data.oMf[silvermate.model.getFrameId("palm_link")].translation.copy())
    moved = at[1] - at[0]
    assert moved[2] > 0.02
    assert np.abs(moved[:2]).max() < 0.3 * moved[2]


# what does not pass


@each("name", ["silvermate", "slider"])
def test_at_a_wall_it_stops_at_the_clearance_and_says_why(name, request):
    robot = request.getfixturevalue(name)
    drive = GuardedDrive(robot, [WALL]).run(4.0, Desired(twist=[1.0, 0.0, 0.0]))
    last = drive.answers[-1]
    assert np.abs(drive.plant.v).max() < 0.01
    assert last.obstacle == "wall"
    assert last.link
    assert last.share < 0.01
    assert last.outcome in (GuardOutcome.STOPPED, GuardOutcome.SLOWED, GuardOutcome.BENT)
    assert drive.guard.params.drive.clearance <= last.distance < 0.035
    assert 0.0 < drive.evaluated().min_clearance_m < 0.05
    assert max(np.abs(v[0]) for v in drive.speeds) > 0.8  # it was fast on the way


@each("name, angle", [("silvermate", 20.0), ("silvermate", 60.0), ("slider", 40.0), ("slider", 60.0)])
def test_it_goes_on_along_a_wall(name, angle, request):
    robot, a = request.getfixturevalue(name), math.radians(angle)
    slides = name == "slider"
    start = robot.home() if slides else robot.home(yaw=0.5 * math.pi - a)
    twist = [math.sin(a), math.cos(a), 0.0] if slides else [1.0, 0.0, 0.0]
    drive = GuardedDrive(robot, [WALL], start=start).run(5.0, Desired(twist=twist))
    rows = np.array(drive.rows)
    late = (rows[-1, 1] - rows[-150, 1]) / 1.5
    wanted = 0.95 * math.cos(a) if slides else 0.95
    assert late > (0.9 if slides else 0.7) * wanted
    assert not drive.evaluated().contacts
    assert GuardOutcome.BENT in drive.outcomes() or GuardOutcome.SLOWED in drive.outcomes()


def test_beside_a_wall_it_is_not_steered_round_and_round_for_who_passes(silvermate):
    """A command straight ahead at a wall is turned along that; who passes is braked for, as elsewhere."""
    wall = Box((8.0, 0.15, 1.0), at=(3.0, 1.7, 0.5), name="wall")
    walker = Cylinder(0.25, 1.7, at=(3.6, -1.8, 0.85), name="walker", motion=Twist((0.0, 0.5, 0.0)))
    drive = GuardedDrive(silvermate, [wall, walker], start=silvermate.home(x=1.2, y=0.1, yaw=1.1))
    drive.run(7.0, Desired(twist=[1.0, 0.0, 0.0]))
    yaw = np.array(drive.rows)[:, 2]
    assert yaw.min() < 0.5  # along the wall
    assert yaw.min() > -1.0  # and not away from it
    assert not drive.evaluated().collisions


def test_a_drive_that_is_not_steered_stops_at_the_wall(silvermate):
    start = silvermate.home(yaw=0.5 * math.pi - math.radians(60.0))
    drive = GuardedDrive(silvermate, [WALL], start=start, params=GuardParams(steer=False))
    drive.run(4.0, Desired(twist=[1.0, 0.0, 0.0]))
    assert np.abs(drive.plant.v[:3]).max() < 0.02


@each("name, seed", [("silvermate", 0), ("silvermate", 1), ("slider", 2), ("arm", 3)])
def test_hostile_pilots_touch_nothing_and_every_motion_is_certified(name, seed, request, brief):
    robot, rng = request.getfixturevalue(name), np.random.default_rng(seed)
    things = [Box((0.3, 0.3, h), at=(x, y, 0.5 * h), name=f"thing {k}") for k, (x, y, h) in enumerate(
        [(1.0, 0.3, 0.9), (-1.0, 0.2, 1.4), (0.2, 1.1, 0.6), (0.1, -1.0, 1.5)]
    )]  # fmt: skip
    things.append(Cylinder(0.2, 1.7, at=(3.0, 0.6, 0.85), name="walker", motion=Twist(np.array([-0.5, 0.0, 0.0]))))
    drive = GuardedDrive(robot, World(Scene(things)))
    certifier = TrajectoryCertifier(robot, clearance=0.0249, self_clearance=0.00499)
    pilot, checked = hostile(robot, drive.guard.limits, rng), 0
    for _ in range(350 if brief else 500):
        before = drive.guard.executor.active
        answer = drive.step(pilot(drive.k * DT))
        motion = drive.guard.executor.active
        assert motion.at_rest_at_end
        if motion is not before and drive.k % 10 == 0 and answer.clearance > 0.0249:
            still = Scene([o for o in drive.see(0.0) if o.motion is None])
            certificate = certifier.certify(
                motion, still, predict(still, ObstacleAssumptions()), clearance=answer.clearance - 1e-4
            )
            assert certificate.certified, certificate.broken
            checked += 1
    assert checked > 10
    assert not drive.evaluated().collisions
    assert max(np.abs(v).max() for v in drive.speeds) > 0.3


def test_the_robot_stands_when_somebody_walks_into_it(slider):
    walker = Cylinder(0.2, 1.7, at=(2.5, 0.0, 0.85), name="walker", motion=Twist(np.array([-0.8, 0.0, 0.0])))
    drive = GuardedDrive(slider, World(Scene([walker]))).run(4.0, Desired(twist=[1.0, 0.0, 0.0]))
    found = drive.evaluated()
    assert found.rest_contacts  # it was run into
    assert not found.collisions


@each("nothing", [None, Desired(twist=[math.nan, 0.0, 0.0]), Desired(twist=[1.0, 0.0, 0.0], time=-1.0)])
def test_silence_nonsense_and_old_commands_are_rest(nothing, silvermate):
    drive = GuardedDrive(silvermate, [FAR]).run(1.0, Desired(twist=[0.6, 0.0, 0.0]))
    assert drive.plant.v[0] > 0.5
    answer = drive.step(nothing)
    assert answer.outcome is GuardOutcome.BRAKING
    assert answer.reason
    assert answer.share == 0.0
    assert 0.0 < answer.stops_in < 1.0
    drive.run(1.0, nothing)
    assert not [event for event in drive.guard.executor.run.events if event.kind == "fault"]
    assert np.abs(drive.plant.v).max() < 0.01
    assert drive.answers[-1].outcome is GuardOutcome.STOPPED


def test_without_new_scenes_it_comes_to_rest(silvermate):
    drive = GuardedDrive(silvermate, [FAR]).run(1.0, Desired(twist=[0.6, 0.0, 0.0]))
    drive.run(1.5, Desired(twist=[0.6, 0.0, 0.0]), sees=False)
    assert np.abs(drive.plant.v).max() < 0.01
    assert "scene" in drive.answers[-1].reason


def test_what_a_scene_remarks_is_written_down(silvermate):
    drive = GuardedDrive(silvermate, [FAR]).run(0.5, Desired(twist=[0.6, 0.0, 0.0]))
    assert not drive.faults()
    t = drive.k * DT
    drive.guard.step(
        t, drive.measurement, Scene([FAR], time=t, remark="a sonar hears glass"), Desired(twist=[0.6, 0.0, 0.0])
    )
    assert drive.faults() == ["a sonar hears glass"]


def test_nothing_jumps_when_it_lets_go(slider):
    drive = GuardedDrive(slider, [Box((0.2, 2.0, 1.5), at=(1.3, 0.2, 0.75), name="short wall")])
    drive.run(4.0, Desired(twist=[0.7, 0.7, 0.0]))  # along it, and past its end
    assert GuardOutcome.BENT in drive.outcomes()
    assert drive.answers[-1].outcome is GuardOutcome.PASSED
    v = np.array(drive.speeds)[:, :2]
    most = drive.guard.limits.drive_acceleration[:2] * DT
    assert (np.abs(np.diff(v, axis=0)) <= 1.3 * most).all()


def test_it_leaves_its_clearance_slowly_and_not_inwards(slider):
    home = slider.space.to_coordinates(slider.home_q)
    probe = GuardedDrive(slider, [WALL])
    probe.run(4.0, Desired(twist=[1.0, 0.0, 0.0]))  # as near as it goes
    touching = float(probe.plant.coordinates[0])
    inside = home.copy()
    inside[0] = touching + 0.012
    for twist, out in (([-1.0, 0.0, 0.0], True), ([1.0, 0.0, 0.0], False)):
        drive = GuardedDrive(slider, [WALL], start=slider.space.from_coordinates(inside))
        drive.run(0.15, Desired(twist=twist))
        assert min(answer.clearance for answer in drive.answers) < 0.02
        assert np.abs(drive.plant.v[0]) < 0.15
        drive.run(2.0, Desired(twist=twist))
        moved = float(drive.plant.coordinates[0]) - inside[0]
        assert (moved < -0.5) if out else (moved < 0.003)
        assert not drive.evaluated().contacts


def test_a_joint_at_its_stop_stays_there_and_is_named(arm):
    drive = GuardedDrive(arm, [FAR])
    base, rates = arm.space.base_nv, np.zeros(len(drive.guard.limits.joint_speed))
    rates[-1] = drive.guard.limits.joint_speed[-1]
    drive.run(8.0, Desired(joints=rates))
    upper = arm.space.upper[base:]
    assert (np.array(drive.rows)[:, base:] <= upper + 2e-3).all()
    name = arm.joint_names[-1]
    assert name in {answer.link for answer in drive.answers}
    assert drive.answers[-1].outcome is GuardOutcome.STOPPED
    assert drive.plant.coordinates[-1] > upper[-1] - 0.02


def test_few_events_are_written(silvermate):
    drive = GuardedDrive(silvermate, [WALL]).run(6.0, Desired(twist=[1.0, 0.0, 0.1]))
    events = drive.guard.executor.run.events
    assert 0 < len(events) < 40
    assert any(event.kind == "guard" for event in events)


# for policies, and with a controller


def test_an_action_of_a_policy_is_made_safe(silvermate):
    guard, plant = Guard(silvermate), KinematicPlant(silvermate, MotionLimits.for_robot(silvermate), MACHINE, seed=0)
    plant.reset(silvermate.space.to_coordinates(silvermate.home_q))
    measurement, action = None, np.zeros(silvermate.nv)
    action[0] = 1.0
    for k in range(300):
        safe = guard.safe(action, k * DT, measurement, Scene([WALL], time=k * DT))
        assert safe.shape == (silvermate.nv,)
        measurement = plant.step(guard.last.command, DT)
    assert np.abs(safe).max() < 0.05
    assert guard.last.obstacle == "wall"
    with refused(ParameterError, "(3,)"):
        guard.safe(np.zeros(3), 4.0, measurement, None)


def test_a_controllers_robot_is_taken_over_and_handed_back_in_motion(silvermate):
    controller = Controller(
        silvermate, silvermate.home(), silvermate.home(x=3.0), Scene([FAR]), workers=planning_at_once()
    )
    drive = GuardedDrive(silvermate, [FAR], guard=Guard(silvermate))

    def follow(seconds):
        for _ in range(round(seconds / DT)):
            drive.note(controller.step(drive.k * DT, drive.measurement, drive.see(drive.k * DT)))

    follow(1.0)
    assert drive.plant.v[0] > 0.4
    drive.guard.take_over(controller)
    drive.run(0.8, Desired(twist=[0.5, 0.0, 0.8]))
    assert drive.guard.executor is controller.executor
    assert abs(drive.plant.coordinates[2]) > 0.2
    assert drive.plant.v[0] > 0.3
    drive.guard.hand_back()
    assert controller.planner.off_strip  # it joins its strip from beside
    follow(12.0)
    assert controller.state is RunState.REACHED, controller.reason
    speeds = np.array(drive.speeds)[:, 0]
    assert np.abs(np.diff(speeds)).max() < 0.03  # through both
    assert not [event for event in controller.events if event.kind == "unproven"]


def test_only_a_controller_of_this_robot_is_taken_over(silvermate, bridge_arm):
    guard = Guard(silvermate)
    other = Controller(bridge_arm, bridge_arm.home(), bridge_arm.home(x=1.0))
    with refused(ConfigurationError, "bridge-arm"):
        guard.take_over(other)
    with refused(ConfigurationError, "hand_back"):
        guard.hand_back()


def test_wrong_commands_are_refused(silvermate, arm):
    guard = Guard(silvermate)
    with refused(ParameterError, "twist"):
        Guard(arm).step(0.0, None, None, Desired(twist=[1.0, 0.0, 0.0]))
    with refused(ParameterError, "(2,)"):
        Desired(twist=[1.0, 0.0])
    with refused(ParameterError, "frame"):
        Desired(hand=np.zeros(6))
    with refused(ParameterError, "3 velocities"):
        guard.step(0.0, None, None, Desired(joints=np.zeros(3)))
    with refused(ParameterError, "palm_lnk"):
        guard.step(0.0, None, None, Desired(hand=np.zeros(6), frame="palm_lnk"))
    with refused(ParameterError, "hold=0"):
        GuardParams(hold=0)


def test_a_guard_that_fails_brakes_and_goes_on(silvermate, monkeypatch):
    drive = GuardedDrive(silvermate, [FAR]).run(0.6, Desired(twist=[0.5, 0.0, 0.0]))
    with monkeypatch.context() as broken:
        broken.setattr(TrajectoryCertifier, "certify", lambda *_, **__: 1 / 0)
        answer = drive.step(Desired(twist=[0.5, 0.0, 0.0]))
        assert answer.outcome is GuardOutcome.BRAKING
        assert "ZeroDivisionError" in answer.reason
        drive.run(1.0, Desired(twist=[0.5, 0.0, 0.0]))
        assert np.abs(drive.plant.v).max() < 0.01
    drive.run(0.5, Desired(twist=[0.5, 0.0, 0.0]))
    assert drive.answers[-1].outcome is GuardOutcome.PASSED


def test_a_robot_without_joints_is_guarded(jackal_box):
    drive = GuardedDrive(jackal_box, [WALL]).run(3.0, Desired(twist=[1.0, 0.0, 0.0]))
    assert drive.answers[-1].obstacle == "wall"
    assert not drive.evaluated().contacts


def test_it_stops_and_resumes(silvermate):
    drive = GuardedDrive(silvermate, [FAR]).run(0.5, Desired(twist=[0.5, 0.0, 0.0]))
    drive.guard.stop("lunch")
    drive.run(1.0, Desired(twist=[0.5, 0.0, 0.0]))
    assert drive.answers[-1].outcome is GuardOutcome.STOPPED
    assert drive.answers[-1].reason == "lunch"
    drive.guard.resume()
    drive.run(0.5, Desired(twist=[0.5, 0.0, 0.0]))
    assert drive.answers[-1].outcome is GuardOutcome.PASSED
