"""The kinematic plant: its motors against an integrated oracle, and every disturbance by itself."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from cases import each, each_robot, refused

from elastic_strips.control.interfaces import Command
from elastic_strips.errors import ParameterError
from elastic_strips.sim.plant import KinematicPlant, OdometryParams, PlantParams, speed_loop
from elastic_strips.trajectory.limits import MotionLimits

IDEAL = PlantParams.ideal()
LAGGED = replace(PlantParams(), slip=0.0, slip_noise=0.0, jitter=0.0, odometry=OdometryParams.ideal())


def limits_of(robot) -> MotionLimits:
    return MotionLimits.for_robot(robot, joint_speed=1.0)


def command(plant: KinematicPlant, drive, joints=0.0) -> Command:
    n = len(plant.limits.joint_speed)
    return Command(np.array(drive, dtype=float), np.broadcast_to(np.asarray(joints, dtype=float), n).copy())


@pytest.fixture
def quiet(silvermate) -> KinematicPlant:
    """Lag and limits only."""
    return KinematicPlant(silvermate, limits_of(silvermate), LAGGED)


def test_the_speed_loop_solves_its_equation(rng):
    """Against 20,000 small steps of Euler."""
    for _ in range(30):
        v, u = rng.uniform(-1.0, 1.0, 2)
        lag, push, h = rng.uniform(0.01, 0.1), rng.uniform(0.5, 10.0), rng.uniform(0.001, 0.3)
        speed, way, n = v, 0.0, 20_000
        for _ in range(n):
            change = min(max((u - speed) / lag, -push), push) * h / n
            way += (speed + 0.5 * change) * h / n
            speed += change
        got = speed_loop(v, u, lag, push, h)
        assert got[0] == pytest.approx(speed, abs=2e-4)
        assert got[1] == pytest.approx(way, abs=5e-5)


def test_a_speed_loop_without_lag_or_limit_jumps():
    assert speed_loop(0.2, 0.5, 0.0, math.inf, 0.1) == pytest.approx((0.5, 0.05))
    assert speed_loop(0.0, 1.0, 0.0, 2.0, 0.1) == pytest.approx((0.2, 0.01))


@each_robot
def test_exact_motors_drive_exact_arcs(robot, rng):
    plant = KinematicPlant(robot, limits_of(robot), IDEAL)
    k, n = plant.limits.drive_dim, len(robot.joint_names)
    coordinates = plant.coordinates
    first = robot.space.base_nv
    coordinates[first:] = 0.5 * (np.maximum(robot.space.lower, -3.0) + np.minimum(robot.space.upper, 3.0))[first:]
    plant.reset(coordinates)
    for _ in range(50):
        c = Command(0.5 * rng.standard_normal(k), 0.05 * rng.standard_normal(n))
        plant.step(c, 0.01)
        v = plant.limits.to_tangent(np.concatenate([c.drive, c.joints]))
        coordinates = robot.space.integrate(coordinates, 0.01 * v)
        assert plant.coordinates == pytest.approx(coordinates, abs=1e-12)
        assert plant.v == pytest.approx(v)
    assert plant.time == pytest.approx(0.5)


def test_no_motor_exceeds_its_hardware(silvermate):
    limits = limits_of(silvermate)
    plant = KinematicPlant(silvermate, limits, LAGGED)
    before, fastest, hardest = plant.v, 0.0, 0.0
    for _ in range(150):
        plant.step(command(plant, (9.0, 9.0)), 0.01)
        hardest = max(hardest, (plant.v[0] - before[0]) / 0.01)
        before, fastest = plant.v, max(fastest, plant.v[0])
    assert fastest == pytest.approx(1.1 * limits.drive_speed[0], rel=1e-3)
    assert hardest == pytest.approx(1.5 * limits.drive_acceleration[0], rel=1e-6)


def test_motors_lag_by_their_time_constant(quiet):
    for _ in range(100):
        quiet.step(command(quiet, (0.05, 0.05), 0.02), 0.01)
    assert quiet.v[0] == pytest.approx(0.05)
    # a ramp is followed late by the lag (and by half a step, for commands are held)
    for i in range(300):
        quiet.step(command(quiet, (0.05 + 0.002 * i,) * 2, 0.02 + 0.0005 * i), 0.01)
    assert quiet.v[0] == pytest.approx(0.05 + 0.2 * (2.99 + 0.01 - 0.04 - 0.005), abs=2e-4)
    assert quiet.v[3] == pytest.approx(0.02 + 0.05 * (2.99 + 0.01 - 0.03 - 0.005), abs=1e-4)


@pytest.mark.parametrize("speed", [0.03, 0.2, 1.0])
def test_a_zero_command_stops_in_the_time_that_is_stated(quiet, speed):
    while quiet.v[0] < speed - 1e-3:
        quiet.step(command(quiet, (speed, speed)), 0.01)
    v, lag = quiet.v[0], quiet.params.wheel_lag
    push = quiet.params.acceleration_margin * quiet.limits.drive_acceleration[0]
    knee = push * lag
    allowed = v / push - lag + lag * math.log(knee / 0.01) if v > knee else lag * math.log(v / 0.01)
    start, allowed = quiet.time, allowed + quiet.params.jitter
    while quiet.v[0] >= 0.01:
        quiet.step(command(quiet, (0.0, 0.0)), 0.001)
    assert 0.7 * allowed - 0.005 < quiet.time - start <= allowed + 0.001
    while quiet.v.any():
        quiet.step(command(quiet, (0.0, 0.0)), 0.01)
        assert quiet.time - start < allowed + 0.2
    coordinates = quiet.coordinates
    for _ in range(20):
        quiet.step(command(quiet, (0.0, 0.0)), 0.01)
    assert np.array_equal(quiet.coordinates, coordinates)


def test_from_a_slow_speed_rest_comes_within_three_tenths(silvermate):
    """With every disturbance."""
    for seed in range(20):
        plant = KinematicPlant(silvermate, limits_of(silvermate), seed=seed)
        while plant.v[0] < 0.2:
            plant.step(command(plant, (0.21, 0.21), 0.3), 0.01)
        for _ in range(30):
            plant.step(command(plant, (0.0, 0.0)), 0.01)
        assert np.abs(plant.v).max() < 0.001


def test_slip_is_bounded_wanders_and_is_not_seen_by_encoders(silvermate):
    params = replace(PlantParams(), slip_noise=0.0, jitter=0.0)
    limits, slips = limits_of(silvermate), []
    for seed in range(8):
        plant = KinematicPlant(silvermate, limits, params, seed)
        turned, driven = np.zeros(2), np.zeros(2)
        for _ in range(400):
            before = plant.coordinates
            m = plant.step(command(plant, (0.5, 0.6)), 0.01)
            way = limits.to_drive(silvermate.space.difference(before, plant.coordinates)[:3])
            turned, driven = turned + m.drive, driven + way
            slips.append(plant.slip)
        lost = 1.0 - driven / turned
        assert 1e-4 < np.abs(lost).max() <= 0.0201
    wandering = np.array(slips)
    assert np.abs(wandering).max() <= 0.02
    assert 0.006 < wandering.std() < 0.014
    assert np.abs(np.diff(wandering[:400], axis=0)).max() < 0.006  # slowly


def test_slip_also_jitters(silvermate):
    plant = KinematicPlant(silvermate, limits_of(silvermate), replace(IDEAL, slip_noise=0.01), 1)
    slips = []
    for _ in range(500):
        before = plant.coordinates[0]
        plant.step(command(plant, (0.5, 0.5)), 0.01)
        slips.append(1.0 - (plant.coordinates[0] - before) / 0.005)
    assert np.std(slips) == pytest.approx(0.01 / np.sqrt(2.0), rel=0.15)  # the mean of two wheels
    assert abs(np.mean(slips)) < 0.002
    assert abs(np.corrcoef(slips[1:], slips[:-1])[0, 1]) < 0.15


def test_the_motors_are_known_without_slip(silvermate):
    plant = KinematicPlant(silvermate, limits_of(silvermate), seed=4)
    for _ in range(150):
        plant.step(command(plant, (0.5, 0.4)), 0.01)
    assert plant.motors == pytest.approx([0.5, 0.4], abs=1e-6)
    assert plant.motors * (1.0 - plant.slip) == pytest.approx(plant.limits.to_drive(plant.v[:3]), abs=1e-12)
    assert np.abs(plant.slip).max() > 1e-4


def test_seeds_decide_everything(silvermate):
    def run(seed):
        plant = KinematicPlant(silvermate, limits_of(silvermate), seed=seed)
        out = [plant.step(command(plant, (0.5, 0.4), 0.1), 0.01) for _ in range(60)]
        return np.concatenate(
            [[*m.drive, *m.joints, *(() if m.pose is None else m.pose)] for m in out]
        ), plant.coordinates

    (one, at_one), (two, at_two), (other, at_other) = run(5), run(5), run(6)
    assert np.array_equal(one, two)
    assert np.array_equal(at_one, at_two)
    assert not np.allclose(one, other, rtol=0.0, atol=1e-6)
    assert np.abs(at_one - at_other).max() > 1e-5
    generator = np.random.default_rng(5)
    assert np.array_equal(run(generator)[0], one)


def test_a_command_arrives_late_by_at_most_the_jitter(silvermate):
    params = replace(IDEAL, jitter=0.002)
    ways = []
    for seed in range(100):
        plant = KinematicPlant(silvermate, limits_of(silvermate), params, seed)
        plant.step(command(plant, (1.0, 1.0)), 0.01)
        ways.append(plant.coordinates[0])
        plant.step(command(plant, (1.0, 1.0)), 0.01)
        there = plant.coordinates[0]
        assert there - ways[-1] == pytest.approx(0.01)
        plant.step(command(plant, (0.0, 0.0)), 0.01)
        assert 0.0 < plant.coordinates[0] - there <= 0.002  # the command before holds meanwhile
    assert 0.008 <= min(ways) < 0.0082
    assert 0.0098 < max(ways) <= 0.01


def test_encoder_noise_does_not_add_up(silvermate):
    params = replace(IDEAL, odometry=replace(OdometryParams.ideal(), encoder_noise=1e-3, joint_noise=1e-3))
    plant = KinematicPlant(silvermate, limits_of(silvermate), params, 1)
    turned, rough, joints = np.zeros(2), 0.0, 0.0
    for i in range(500):
        m = plant.step(command(plant, (0.2, 0.3)), 0.01)
        turned = turned + m.drive
        assert np.abs(turned - 0.01 * (i + 1) * np.array([0.2, 0.3])).max() <= 3e-3 + 1e-9
        rough = max(rough, np.abs(m.drive - (0.002, 0.003)).max())
        joints = max(joints, np.abs(m.joints - plant.coordinates[3:]).max())
    assert rough > 1e-3
    assert 2e-3 < joints <= 3e-3 + 1e-9


def test_fixes_are_late_true_and_bounded(silvermate):
    plant = KinematicPlant(silvermate, limits_of(silvermate), seed=2)
    truth, fixes = {0.0: plant.coordinates}, []
    for _ in range(1000):
        m = plant.step(command(plant, (0.4, 0.5)), 0.01)
        truth[round(plant.time, 3)] = plant.coordinates
        if m.pose is not None:
            fixes.append((m.time, m.pose_time, m.pose - truth[round(m.pose_time, 3)][:3]))
    arrival, at = np.array([f[0] for f in fixes]), np.array([f[1] for f in fixes])
    assert len(fixes) == 199  # 20 Hz; the last has not arrived
    assert arrival - at == pytest.approx(np.full(len(fixes), 0.02))
    assert np.diff(at) == pytest.approx(np.full(len(fixes) - 1, 0.05))
    error = np.array([f[2] for f in fixes])
    assert np.abs(error).max() <= 0.009 + 1e-12
    assert error.std(axis=0) == pytest.approx([0.003] * 3, rel=0.25)


def test_lost_odometry_says_so_and_comes_back(silvermate):
    plant = KinematicPlant(silvermate, limits_of(silvermate), IDEAL)
    lost, travel, fixes = [], 0.0, []
    for i in range(100):
        if i == 30:
            plant.lost_odometry(0.6)
        m = plant.step(command(plant, (0.5, 0.5)), 0.01)
        if m.drive is None:
            lost.append(round(m.time, 3))
            assert m.joints == pytest.approx(plant.coordinates[3:])
        else:
            travel += m.drive[0]
        if m.pose is not None:
            fixes.append(round(m.pose_time, 3))
    assert lost == pytest.approx(np.arange(31, 61) / 100.0)
    assert travel == pytest.approx(0.5 * 0.7)  # what was turned meanwhile is not told later
    assert fixes == pytest.approx([0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 1.0])


def test_fixes_on_their_way_are_lost_too(silvermate):
    params = replace(IDEAL, odometry=replace(OdometryParams.ideal(), fix_latency=0.05))
    plant, arrivals = KinematicPlant(silvermate, limits_of(silvermate), params), []
    for i in range(25):
        if i == 6:
            plant.lost_odometry(0.08)
        if plant.step(command(plant, (0.5, 0.5)), 0.01).pose is not None:
            arrivals.append(round(plant.time, 3))
    assert arrivals == [0.15, 0.2, 0.25]  # not that of 0.05, due at 0.1


def test_a_loss_told_again_and_again_goes_on(silvermate):
    """As a fault that is injected period by period."""
    plant = KinematicPlant(silvermate, limits_of(silvermate))
    for _ in range(20):
        plant.lost_odometry(plant.time + 0.01)
        assert plant.step(command(plant, (0.1, 0.1)), 0.01).drive is None
    assert plant.step(command(plant, (0.1, 0.1)), 0.01).drive is not None


def test_joints_stop_at_their_limits(silvermate):
    plant = KinematicPlant(silvermate, limits_of(silvermate), LAGGED)
    for _ in range(500):
        plant.step(command(plant, (0.0, 0.0), 1.0), 0.01)
    assert plant.coordinates[3:] == pytest.approx(silvermate.space.upper[3:])
    assert not plant.v[3:].any()


def test_a_fixed_base_measures_joints_alone(gantry):
    plant = KinematicPlant(gantry, limits_of(gantry), seed=1)
    for _ in range(30):
        m = plant.step(command(plant, (), 0.05), 0.01)
    assert m.drive.shape == (0,)
    assert m.pose is None
    assert m.joints == pytest.approx(plant.coordinates, abs=1e-3)
    assert not np.array_equal(m.joints, plant.coordinates)


def test_a_reset_starts_anew(silvermate):
    plant = KinematicPlant(silvermate, limits_of(silvermate), seed=1)
    coordinates = plant.coordinates + 0.1
    for _ in range(20):
        plant.step(command(plant, (0.5, 0.4), 0.2), 0.01)
    plant.lost_odometry(1e9)
    plant.reset(coordinates, 3.0)
    assert plant.time == 3.0
    assert np.array_equal(plant.coordinates, coordinates)
    assert not plant.v.any()
    m = plant.step(command(plant, (0.0, 0.0)), 0.01)
    assert m.drive is not None
    assert np.abs(m.drive).max() < 1e-3
    assert np.array_equal(plant.coordinates, coordinates)
    plant.close()


@pytest.mark.parametrize("drive", [(1.0,), (1.0, 1.0, 1.0), (np.nan, 0.0), (np.inf, 0.0)])
def test_wrong_commands_are_refused(quiet, drive):
    with refused(ParameterError, "command"):
        quiet.step(command(quiet, drive), 0.01)


def test_limits_of_another_robot_are_refused(silvermate, rover):
    with refused(ParameterError, "drive coordinates"):
        KinematicPlant(silvermate, limits_of(rover))


@each(
    "wrong",
    [{"wheel_lag": -0.1}, {"slip": 0.3}, {"jitter": np.nan}, {"speed_margin": 0.9}, {"slip_time": 0.0}],
)
def test_plant_parameters_are_checked(wrong):
    with pytest.raises(ParameterError, match=next(iter(wrong))):
        PlantParams(**wrong)


@each("wrong", [{"fix_noise": -1.0}, {"fix_period": 0.0}, {"fix_latency": np.inf}])
def test_sensor_parameters_are_checked(wrong):
    with pytest.raises(ParameterError, match=next(iter(wrong))):
        OdometryParams(**wrong)
