"""The estimator: exact where the sensors are, right about late fixes, wheels that slip, and losses."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from cases import each, each_robot
from motions import smooth_motion

from elastic_strips.control.estimation import EstimatorParams, StateEstimator
from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.errors import ParameterError
from elastic_strips.sim.plant import KinematicPlant, OdometryParams, PlantParams
from elastic_strips.trajectory.limits import MotionLimits

EXACT = replace(PlantParams(), slip=0.0, slip_noise=0.0, odometry=OdometryParams.ideal())


def limits_of(robot) -> MotionLimits:
    return MotionLimits.for_robot(robot, joint_speed=1.0)


def run(robot, plant, commands, estimator=None) -> tuple[np.ndarray, StateEstimator]:
    """Estimation errors (S, nv) in the true robot's frame."""
    estimator = StateEstimator(robot, plant.limits) if estimator is None else estimator
    estimator.reset(plant.coordinates, plant.time)
    errors = []
    for c in commands:
        estimate = estimator.update(plant.step(c, 0.01))
        errors.append(robot.space.difference(plant.coordinates, estimate))
    return np.array(errors), estimator


def curve(robot, count, drive=(0.5, 0.6), joints=0.1) -> list[Command]:
    n = len(robot.joint_names)
    return [Command(np.array(drive), np.full(n, joints * math.cos(0.01 * i))) for i in range(count)]


@each_robot
def test_exact_sensors_give_the_truth_on_every_kind_of_base(robot):
    limits = limits_of(robot)
    motion = smooth_motion(robot, limits, 4)
    y = limits.to_coordinates(motion.v)
    commands = [Command(row[: limits.drive_dim], row[limits.drive_dim :]) for row in y]
    errors, estimator = run(robot, KinematicPlant(robot, limits, EXACT), commands)
    # encoders tell the way of a period; that the base curved more at its begin than at its end they do not
    assert np.abs(errors).max() < 2e-5
    assert estimator.lost_for == 0.0


def test_a_late_fix_is_compared_with_the_past(silvermate):
    """At 1 m/s, a fix that is 0.1 s old and taken for new would pull the robot back by centimetres."""
    params = replace(EXACT, odometry=replace(OdometryParams.ideal(), fix_latency=0.1))
    estimator = StateEstimator(silvermate, limits_of(silvermate), EstimatorParams(fix_noise=1e-4, drift=0.1))
    plant = KinematicPlant(silvermate, limits_of(silvermate), params)
    errors, estimator = run(silvermate, plant, curve(silvermate, 300, (1.0, 0.9)), estimator)
    assert np.abs(errors[:, :3]).max() < 1e-3


def test_a_wrong_start_is_found_out(silvermate):
    limits = limits_of(silvermate)
    plant = KinematicPlant(silvermate, limits, seed=1)
    estimator = StateEstimator(silvermate, limits, EstimatorParams(drift=0.02))
    offset = np.zeros(silvermate.nv)
    offset[:3] = 0.05, -0.04, 0.1
    estimator.reset(silvermate.space.integrate(plant.coordinates, offset))
    for c in curve(silvermate, 300):
        estimate = estimator.update(plant.step(c, 0.01))
    assert np.abs(silvermate.space.difference(plant.coordinates, estimate)[:3]).max() < 0.01


def test_steady_slip_is_learned(silvermate):
    limits = limits_of(silvermate)

    def errors(sensors, seed) -> np.ndarray:
        params = replace(PlantParams(), slip_time=1e9, slip_noise=0.0, odometry=sensors)
        plant = KinematicPlant(silvermate, limits, params, seed)
        plant._wander = [0.02, -0.02]
        return run(silvermate, plant, curve(silvermate, 800, (0.8, 0.8)))[0]

    blind = errors(replace(OdometryParams(), fix_period=math.inf), 0)
    seen = np.concatenate([errors(OdometryParams(), seed)[-400:] for seed in range(5)])
    assert np.abs(blind[-1, :3]).max() > 0.3  # 4 % between the wheels over 6.4 m
    assert np.abs(seen[:, :2]).max() < 0.006
    assert np.abs(seen[:, 2]).max() < 0.008
    assert np.abs(seen[:, 2].mean()) < 1e-3


def test_the_stated_accuracy_is_kept(silvermate, tiago, brief):
    """The figures of the class: 7 mm and 14 mrad."""
    for robot in (silvermate, tiago):
        limits = limits_of(robot)
        for seed in range(4 if brief else 12):
            motion = smooth_motion(robot, limits, seed, turn=seed % 3 == 0)
            y = limits.to_coordinates(motion.v)
            errors, _ = run(robot, KinematicPlant(robot, limits, seed=seed), [Command(r[:2], r[2:]) for r in y])
            assert np.hypot(errors[:, 0], errors[:, 1]).max() < 0.007
            assert np.abs(errors[:, 2]).max() < 0.014
            assert np.abs(errors[:, 3:]).max() <= 6e-4 + 1e-12


def test_fixes_are_worth_their_while(silvermate):
    limits = limits_of(silvermate)
    with_fixes, without = [], []
    for seed in range(6):
        for params, out in (
            (PlantParams(), with_fixes),
            (PlantParams(odometry=OdometryParams(fix_period=math.inf)), without),
        ):
            errors, _ = run(silvermate, KinematicPlant(silvermate, limits, params, seed), curve(silvermate, 800))
            out.append(np.hypot(errors[-1, 0], errors[-1, 1]))
    assert np.mean(without) > 5.0 * np.mean(with_fixes)


def test_a_loss_is_timed_until_a_fix_tells_of_after_it(silvermate):
    limits = limits_of(silvermate)
    plant, estimator = KinematicPlant(silvermate, limits, EXACT), StateEstimator(silvermate, limits)
    estimator.reset(plant.coordinates)
    latency = replace(EXACT, odometry=replace(OdometryParams.ideal(), fix_latency=0.02))
    plant = KinematicPlant(silvermate, limits, latency)
    lost = {}
    for i, c in enumerate(curve(silvermate, 100)):
        if i == 20:
            plant.lost_odometry(0.42)
        estimator.update(plant.step(c, 0.01))
        lost[round(plant.time, 3)] = estimator.lost_for
    assert lost[0.2] == 0.0
    assert lost[0.21] == pytest.approx(0.01)
    assert lost[0.42] == pytest.approx(0.22)
    # encoders are back at 0.43; the first fix after that is of 0.45 and comes at 0.47
    assert lost[0.46] == pytest.approx(0.26)
    assert lost[0.47] == 0.0
    assert lost[1.0] == 0.0


def test_a_fix_of_the_time_of_a_loss_does_not_end_it(silvermate):
    limits = limits_of(silvermate)
    estimator = StateEstimator(silvermate, limits)
    home = silvermate.space.to_coordinates(silvermate.home_q)
    estimator.reset(home)
    for i in range(1, 11):
        estimator.update(Measurement(0.01 * i, None, home[3:]))
    estimator.update(Measurement(0.11, np.zeros(2), home[3:], home[:3], 0.09))
    assert estimator.lost_for == pytest.approx(0.11)
    estimator.update(Measurement(0.12, np.zeros(2), home[3:], home[:3], 0.11))
    assert estimator.lost_for == 0.0


def test_the_heading_is_inferred_from_positions(silvermate):
    """Fixes whose yaw means nothing: driving straight with a wrong heading leads beside them."""
    limits = limits_of(silvermate)
    plant = KinematicPlant(silvermate, limits, EXACT)
    estimator = StateEstimator(silvermate, limits, EstimatorParams(fix_angle_noise=10.0, drift=0.05))
    start = plant.coordinates
    start[2] += 0.1
    estimator.reset(start)
    for c in curve(silvermate, 400, (0.6, 0.6)):
        m = plant.step(c, 0.01)
        estimate = estimator.update(m if m.pose is None else replace(m, pose=np.add(m.pose, (0.0, 0.0, 0.3))))
    assert estimate[2] == pytest.approx(plant.coordinates[2], abs=0.01)


def test_the_pose_is_found_again_after_a_loss(silvermate):
    limits = limits_of(silvermate)
    for seed in range(5):
        plant, estimator = KinematicPlant(silvermate, limits, seed=seed), StateEstimator(silvermate, limits)
        estimator.reset(plant.coordinates)
        worst = 0.0
        for i, c in enumerate(curve(silvermate, 300, (0.9, 0.7))):
            if i == 100:
                plant.lost_odometry(1.5)
            estimate = estimator.update(plant.step(c, 0.01))
            error = silvermate.space.difference(plant.coordinates, estimate)
            worst = max(worst, float(np.hypot(*error[:2])))
            if plant.time > 1.3 and estimator.lost_for == 0.0:
                assert np.hypot(*error[:2]) < 0.02
        assert worst > 0.2  # driven blindly for half a second
        assert np.hypot(*error[:2]) < 0.007


def test_it_coasts_for_a_moment(silvermate):
    limits = limits_of(silvermate)
    plant, estimator = KinematicPlant(silvermate, limits, EXACT), StateEstimator(silvermate, limits)
    for c in curve(silvermate, 100, (0.5, 0.5)):
        estimator.update(plant.step(c, 0.01))
    begin = plant.coordinates[0]
    plant.lost_odometry(9.0)
    ways = [estimator.update(plant.step(c, 0.01))[0] - begin for c in curve(silvermate, 20, (0.5, 0.5))]
    assert ways[4] == pytest.approx(0.025, abs=1e-4)
    assert ways[19] == pytest.approx(ways[4])


def test_fixes_that_are_too_old_are_left_out(silvermate):
    limits = limits_of(silvermate)
    estimator = StateEstimator(silvermate, limits, EstimatorParams(drift=1.0))
    home = silvermate.space.to_coordinates(silvermate.home_q)
    estimator.reset(home, 5.0)
    wrong = home[:3] + 1.0
    for pose_time in (4.0, 1.0):
        got = estimator.update(Measurement(6.0, np.zeros(2), home[3:], wrong, pose_time))
        assert got == pytest.approx(home)
    assert estimator.update(Measurement(6.1, np.zeros(2), home[3:], wrong, 5.9))[0] > 0.9
    # an older fix after a newer one
    now = estimator.update(Measurement(6.2, np.zeros(2), home[3:]))
    assert estimator.update(Measurement(6.3, np.zeros(2), home[3:], home[:3], 5.8)) == pytest.approx(now)


def test_a_fix_between_two_measurements_is_interpolated(silvermate):
    limits = limits_of(silvermate)
    estimator = StateEstimator(silvermate, limits, EstimatorParams(drift=10.0))
    home = silvermate.space.to_coordinates(silvermate.home_q)
    estimator.reset(home)
    for i in range(1, 11):  # 1 m/s; the fix is right
        fix = np.add(home[:3], (0.835, 0.0, 0.0)) if i == 10 else None
        got = estimator.update(Measurement(0.1 * i, np.full(2, 0.1), home[3:], fix, None if fix is None else 0.835))
    assert got[0] == pytest.approx(home[0] + 1.0, abs=1e-6)


def test_angles_run_on_and_fixes_may_wrap(silvermate):
    limits = limits_of(silvermate)
    plant, estimator = KinematicPlant(silvermate, limits, EXACT), StateEstimator(silvermate, limits)
    estimator.reset(plant.coordinates)
    for c in curve(silvermate, 800, (-0.3, 0.3)):
        m = plant.step(c, 0.01)
        pose = None if m.pose is None else np.array([*m.pose[:2], math.remainder(m.pose[2], 2.0 * math.pi)])
        estimate = estimator.update(replace(m, pose=pose))
    assert plant.coordinates[2] > 2.0 * math.pi
    assert estimate[2] == pytest.approx(plant.coordinates[2], abs=1e-3)


def test_its_own_doubt_is_of_the_size_of_its_errors(silvermate):
    limits = limits_of(silvermate)
    errors, last = [], []
    for seed in range(30):
        plant = KinematicPlant(silvermate, limits, seed=seed)
        e, estimator = run(silvermate, plant, curve(silvermate, 200 + seed))
        errors.append(e[-1])
        last.append((estimator.deviation(0.0), estimator.deviation(10.0) / 10.0))
    table = np.array(errors)
    position, heading = np.mean(last, axis=0)
    assert 0.4 < position / np.sqrt((table[:, :2] ** 2).mean(axis=0).max()) < 1.6
    assert 0.4 < heading / table[:, 2].std() < 1.6


def test_the_error_of_a_body_point_stays_below_three_standard_deviations(silvermate):
    """Of points up to 0.8 m from the base, at the end of 60 drives: one in a hundred may be beyond."""
    limits, beyond = limits_of(silvermate), []
    for seed in range(60):
        plant = KinematicPlant(silvermate, limits, seed=seed)
        errors, estimator = run(silvermate, plant, curve(silvermate, 100 + 3 * seed))
        x, y, turn = errors[-1][:3]
        for angle in np.linspace(0.0, 2.0 * np.pi, 12):
            off = np.array([x, y]) + 0.8 * turn * np.array([-np.sin(angle), np.cos(angle)])
            beyond.append(np.hypot(*off) > 3.0 * estimator.deviation(0.8))
    assert np.mean(beyond) < 0.03


@each("wrong", [{"slip": -0.1}, {"fix_noise": 0.0}, {"coast": np.inf}, {"slip_time": 0.0}])
def test_parameters_are_checked(wrong):
    with pytest.raises(ParameterError, match=next(iter(wrong))):
        EstimatorParams(**wrong)


def test_wheels_that_slip_are_found_out_and_followed(silvermate):
    """Half of the left wheel's travel is lost: the filter's own noise would take seconds to believe the fixes."""
    limits = limits_of(silvermate)
    for seed in range(3):
        plant, estimator = KinematicPlant(silvermate, limits, seed=seed), StateEstimator(silvermate, limits)
        estimator.reset(plant.coordinates)
        slipped = 0.0
        for k, c in enumerate(curve(silvermate, 300, (0.8, 0.8))):
            plant.lost = [0.5 if k >= 100 else 0.0, 0.0]
            estimate = estimator.update(plant.step(c, 0.01))
            slipped = max(slipped, estimator.slipped)
            assert estimator.doubt == ""
            off = silvermate.space.difference(plant.coordinates, estimate)
            assert np.hypot(*off[:2]) < 0.1
        assert slipped > 0.01


def test_a_fix_that_jumps_is_not_believed(silvermate):
    limits = limits_of(silvermate)
    plant, estimator = KinematicPlant(silvermate, limits), StateEstimator(silvermate, limits)
    estimator.reset(plant.coordinates)
    for k, c in enumerate(curve(silvermate, 400, (0.4, 0.4))):
        m = plant.step(c, 0.01)
        jumps = 100 <= k < 300 and m.pose is not None
        estimate = estimator.update(replace(m, pose=np.add(m.pose, (0.0, 1.0, 0.0))) if jumps else m)
        if 110 <= k < 300:
            assert "1.0 m" in estimator.doubt
        assert np.hypot(*silvermate.space.difference(plant.coordinates, estimate)[:2]) < 0.1
    assert estimator.doubt == ""
    assert np.hypot(*silvermate.space.difference(plant.coordinates, estimate)[:2]) < 0.01


@pytest.mark.parametrize(("push", "believed"), [(0.2, True), (1.0, False)])
def test_a_robot_that_stands_may_have_been_pushed(silvermate, push, believed):
    limits = limits_of(silvermate)
    estimator = StateEstimator(silvermate, limits)
    home = silvermate.space.to_coordinates(silvermate.home_q)
    estimator.reset(home)
    for k in range(1, 100):
        got = estimator.update(
            Measurement(0.05 * k, np.zeros(2), home[3:], np.add(home[:3], (push, 0.0, 0.0)), 0.05 * k)
        )
    assert got[0] == pytest.approx(home[0] + (push if believed else 0.0), abs=0.01)
    assert (estimator.doubt == "") == believed
    estimator.trust()
    for k in range(100, 110):
        got = estimator.update(
            Measurement(0.05 * k, np.zeros(2), home[3:], np.add(home[:3], (push, 0.0, 0.0)), 0.05 * k)
        )
    assert got[0] == pytest.approx(home[0] + push, abs=0.01), "somebody has looked"
    assert estimator.doubt == ""


def test_coarse_fixes_say_so(silvermate):
    limits = limits_of(silvermate)
    last = []
    for noise in (0.003, 0.02):
        rng, plant, estimator = (
            np.random.default_rng(0),
            KinematicPlant(silvermate, limits),
            StateEstimator(silvermate, limits),
        )
        estimator.reset(plant.coordinates)
        for c in curve(silvermate, 500):
            m = plant.step(c, 0.01)
            if m.pose is not None:
                off = rng.normal(size=3) * noise
                m = replace(m, pose=m.pose + off, pose_covariance=np.eye(3) * noise**2)
            estimator.update(m)
        last.append(estimator.deviation(0.0))
    assert last[1] > 2.0 * last[0]
