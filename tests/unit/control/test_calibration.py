"""calibrate: lag, dead time, slip, acceleration and noise that were put into a machine are found in its record."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from cases import refused

from elastic_strips.control import (
    Calibration,
    Command,
    DriveParams,
    EstimatorParams,
    Record,
    Recorder,
    RecordError,
    TrackingGains,
    calibrate,
)
from elastic_strips.control.calibration import Finding
from elastic_strips.control.motor_fit import fit_speed_loops
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Scene
from elastic_strips.sim import KinematicPlant, PlantParams, simulation
from elastic_strips.sim.plant import speed_loop
from elastic_strips.trajectory import MotionLimits

DT = 0.01


@dataclass
class Profile:
    """Commands that show much: speeds up and down, curves, and stops, for wheels and joints."""

    k: int
    n: int
    top: float = 0.5
    joint_top: float = 0.3

    def command(self, t: float) -> Command:
        if t > 11.8:
            return Command(np.zeros(self.k), np.zeros(self.n))
        stops = 0.0 if 4.0 < t < 5.2 or 8.0 < t < 8.8 else 1.0
        drive = self.top * stops * np.array([math.sin(0.8 * t + 0.1 * i) for i in range(self.k)])
        joints = self.joint_top * stops * np.array([math.sin(1.5 * t + i) for i in range(self.n)])
        return Command(drive, joints)


def driven(
    robot: RobotModel, params: PlantParams, *, limits: MotionLimits | None = None, lost: float = 0.0, delay: int = 0
) -> Record:
    """The record of 13 s of the profile; commands come late by ``delay`` periods, the reference is the truth."""
    limits = MotionLimits.for_robot(robot) if limits is None else limits
    plant, recorder = KinematicPlant(robot, limits, params, seed=5), Recorder(robot, Scene([]))
    plant.reset(robot.space.to_coordinates(robot.home_q))
    plant.lost = [lost] * limits.drive_dim
    profile = Profile(limits.drive_dim, len(robot.joint_names))
    measured = plant.coordinates[robot.space.base_nv :]
    for step in range(1300):
        command = profile.command(step * DT)
        estimate = plant.coordinates
        estimate[robot.space.base_nv :] = measured
        recorder.control(
            step * DT, coordinates=plant.coordinates, v=plant.v, reference=plant.coordinates, reference_v=plant.v,
            estimate=estimate, drive=command.drive, joints=command.joints, motors=plant.motors,
        )  # fmt: skip
        measured = plant.step(profile.command(max(step - delay, 0) * DT), DT).joints
    return recorder.finish()


def logged(record: Record, noise: float = 0.0) -> list[dict[str, object]]:
    """The same as an executor's log has it: no true state, six decimals."""
    rng, c = np.random.default_rng(1), record.control
    rows: list[dict[str, object]] = [{"t": 0.0, "event": "state", "reason": "moving"}]
    for k, t in enumerate(c.time.tolist()):
        estimate = c.estimate[k] + noise * rng.standard_normal(c.estimate.shape[1])
        rows.append(
            {
                "t": t, "sent": t, "took": 1e-4, "state": 0, "stop": False,
                "reference": np.round(c.reference[k], 6).tolist(), "reference_v": c.reference_v[k].tolist(),
                "estimate": np.round(estimate, 6).tolist(),
                "drive": c.drive[k].tolist(), "joints": c.joints[k].tolist(),
            }
        )  # fmt: skip
    return rows


def finding(found: Calibration, begins: str) -> Finding:
    return next(one for one in found.findings if one.what.startswith(begins))


def value(found: Calibration, begins: str) -> float:
    measured = finding(found, begins).measured
    assert measured is not None, begins
    return measured


def lead(found: Calibration, of: str) -> float:
    """Lag and dead time together, by which tracking leads [s]."""
    return value(found, f"lag of the {of}") + value(found, f"commands to the {of}")


@pytest.mark.parametrize("lag, delay", [(0.02, 3), (0.04, 0), (0.09, 3)])
def test_a_speed_loop_is_found_in_its_motion(lag, delay):
    """Speeds: lag within 1 ms, dead time within 2 ms; noisy mean speeds: their sum within 5 ms."""
    rng, count = np.random.default_rng(2), 1200
    t = DT * np.arange(count)
    u = np.clip(np.cumsum(rng.normal(0.0, 0.02, count)), -0.6, 0.6)
    u[500:600] = 0.0
    v, way = [0.0], [0.0]
    for k in range(count - 1):
        speed, step = speed_loop(v[-1], u[max(k - delay, 0)], lag, math.inf, DT)
        v.append(speed)
        way.append(way[-1] + step)
    (found,) = fit_speed_loops(t, u[:, None], np.array(v)[:, None], mean=False)
    assert found is not None
    assert found.lag == pytest.approx(lag, abs=1e-3)
    assert found.dead == pytest.approx(delay * DT, abs=2.1e-3)
    assert found.push is None
    noisy = np.array(way) + 2e-4 * rng.standard_normal(count)
    (again,) = fit_speed_loops(t, u[:, None], np.append(np.diff(noisy) / DT, 0.0)[:, None], mean=True)
    assert again is not None
    assert again.lag + again.dead == pytest.approx(lag + delay * DT, abs=5e-3)


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return load_robot("panda")


@pytest.mark.parametrize("name", ["silvermate", "silvermate, omni", "panda"])
def test_what_was_assumed_is_found(name, silvermate, panda):
    robots = {"silvermate": silvermate, "panda": panda}
    robot = robots[name] if name in robots else load_robot("silvermate", base="omni")
    found = calibrate(driven(robot, PlantParams(slip=0.0, slip_noise=0.0)), robot)
    gains = TrackingGains()
    if robot.space.planar:
        assert lead(found, "drive") == pytest.approx(gains.wheel_lag + 0.001, abs=3e-3)
        assert value(found, "slip of the drive") < 2e-3
    assert lead(found, "joints") == pytest.approx(gains.joint_lag + 0.001, abs=3e-3)
    assert value(found, "noise of the joints' encoders") == pytest.approx(2e-4, rel=0.1)
    assert value(found, "off the reference, largest") == pytest.approx(0.0, abs=1e-9)
    assert not any(one.exceeds for one in found.findings if "acceleration" not in one.what)


def test_a_longer_lag_is_found_and_said(silvermate):
    found = calibrate(driven(silvermate, PlantParams(wheel_lag=0.1, joint_lag=0.07)), silvermate)
    assert lead(found, "drive") == pytest.approx(0.101, abs=4e-3)
    assert lead(found, "joints") == pytest.approx(0.071, abs=4e-3)
    lag = finding(found, "lag of the drive")
    assert lag.exceeds
    assert "TrackingGains.wheel_lag" in lag.field
    assert lag.value is not None
    known = DriveParams(gains=TrackingGains(headroom=1.0, wheel_lag=0.1, joint_lag=0.07))
    again = calibrate(driven(silvermate, PlantParams(wheel_lag=0.1, joint_lag=0.07)), silvermate, params=known)
    assert not finding(again, "lag of the drive").exceeds


def test_commands_that_come_late_are_found(silvermate):
    found = calibrate(driven(silvermate, PlantParams(jitter=0.0), delay=4), silvermate)
    assert lead(found, "drive") == pytest.approx(0.08, abs=4e-3)
    assert finding(found, "commands to the drive").exceeds


def test_a_steady_slip_is_found(silvermate):
    lost = -0.06
    record = driven(silvermate, PlantParams(slip=0.0, slip_noise=0.0), lost=lost)
    found = calibrate(record, silvermate)
    assert value(found, "slip that stays") == pytest.approx(lost, abs=5e-3)
    assert value(found, "slip of the drive") == pytest.approx(abs(lost), abs=5e-3)
    slip = finding(found, "slip of the drive")
    assert slip.exceeds
    assert slip.value == pytest.approx(abs(lost), abs=6e-3)
    known = DriveParams(sensing=EstimatorParams(slip=0.08))
    assert not finding(calibrate(record, silvermate, params=known), "slip of the drive").exceeds


def test_a_slip_that_wanders_is_found(silvermate):
    """Between ±6 %, half of that its standard deviation; over windows of as long as it lasts it is a little less."""
    found = calibrate(driven(silvermate, PlantParams(slip=0.06)), silvermate)
    assert 0.4 * 0.03 < value(found, "slip of the drive") < 1.3 * 0.03
    assert finding(found, "slip of the drive").exceeds


def test_motors_that_are_weak_are_found(silvermate):
    """The profile stops at once from 0.5 m/s, which asks for more than any of these has."""
    share, limits = 0.4, MotionLimits.for_robot(silvermate)
    weak = replace(
        limits,
        drive_acceleration=share * limits.drive_acceleration,
        joint_acceleration=share * limits.joint_acceleration,
    )
    record = driven(silvermate, PlantParams(acceleration_margin=1.0), limits=weak)
    for rows in (record, logged(record)):
        found = calibrate(rows, silvermate)
        drive = finding(found, "greatest acceleration of the drive")
        assert drive.measured == pytest.approx(
            share * limits.drive_acceleration[0], rel=0.05 if rows is record else 0.2
        )
        assert drive.exceeds
        assert drive.assumed == limits.drive_acceleration[0]


def test_strong_motors_are_not_blamed(silvermate):
    limits = MotionLimits.for_robot(silvermate)
    found = calibrate(driven(silvermate, PlantParams(acceleration_margin=1.5)), silvermate)
    drive = finding(found, "greatest acceleration of the drive")
    assert drive.measured is None or drive.measured == pytest.approx(1.5 * limits.drive_acceleration[0], rel=0.05)
    assert not drive.exceeds


def test_a_log_without_truth_shows_what_it_can(silvermate):
    record = driven(silvermate, PlantParams(wheel_lag=0.1, slip=0.0, slip_noise=0.0))
    found = calibrate(logged(record, noise=2e-4), silvermate)
    assert not found.truth
    assert lead(found, "drive") == pytest.approx(0.101, abs=0.01)
    assert finding(found, "lag of the drive").exceeds
    assert finding(found, "slip of the drive").measured is None
    assert value(found, "the base's estimate at rest") == pytest.approx(2e-4, rel=0.3)
    assert not any(one.what.startswith("estimate off the truth") for one in found.findings)


def test_the_tracking_error_is_the_evaluations(silvermate):
    run = simulation(silvermate, Scene([]), silvermate.home(), silvermate.home(x=2.0, y=0.5, yaw=0.8), seed=2).run()
    found = calibrate(run.record, silvermate)
    off = value(found, "off the reference, largest")
    assert 0.0 < off <= DriveParams().tracking_error
    assert value(found, "off the reference, 99 %") <= off
    tight = calibrate(run.record, silvermate, params=DriveParams(tracking_error=0.5 * off))
    most = finding(tight, "off the reference, largest")
    assert most.exceeds
    assert most.value is not None
    assert most.value >= off
    assert most in tight.exceeded


def test_the_parameters_that_are_named_are_taken(silvermate):
    """A machine with a longer lag is followed more closely by a controller that knows it."""

    def off(params: DriveParams) -> float:
        plant = KinematicPlant(silvermate, MotionLimits.for_robot(silvermate), PlantParams(wheel_lag=0.12), seed=1)
        goal = silvermate.home(x=2.0, y=0.6, yaw=0.9)
        run = simulation(silvermate, Scene([]), silvermate.home(), goal, plant=plant, params=params, seed=1).run()
        return value(calibrate(run.record, silvermate, params=params), "off the reference, largest")

    monitor = replace(DriveParams().monitor, wheel_lag=0.12)
    told = DriveParams(gains=TrackingGains(headroom=1.0, wheel_lag=0.12), monitor=monitor)
    assert off(told) < 0.7 * off(DriveParams())


def test_records_that_do_not_fit(silvermate, tiago, panda):
    record = driven(silvermate, PlantParams())
    with refused(RecordError, "tiago"):
        calibrate(record, tiago)
    with refused(RecordError, "reference"):
        calibrate(logged(record), panda)
    with refused(RecordError, "at least"):
        calibrate(logged(record)[:20], silvermate)
    with refused(RecordError, "row 1"):
        calibrate([{"event": "x"}, {**logged(record)[1], "drive": "fast"}], silvermate)
    still = logged(record)[-90:]
    found = calibrate(still, silvermate)
    assert finding(found, "lag of the drive").measured is None
