"""Commands: rest means rest, curvature is kept, errors die out, on every kind of base."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cases import each, each_robot
from following import follow_trajectory
from motions import smooth_motion, trajectory_of

from elastic_strips.control.estimation import StateEstimator
from elastic_strips.control.interfaces import Command
from elastic_strips.control.tracking import TrackingController, TrackingGains
from elastic_strips.errors import ParameterError
from elastic_strips.sim.plant import KinematicPlant, PlantParams
from elastic_strips.trajectory.limits import MotionLimits
from elastic_strips.trajectory.trajectory import ReferenceState

EXACT = TrackingGains(wheel_lag=0.0, joint_lag=0.0, hold=0.005)
QUIET = replace(PlantParams(), slip=0.0, slip_noise=0.0, jitter=0.0, odometry=PlantParams.ideal().odometry)


def limits_of(robot) -> MotionLimits:
    return MotionLimits.for_robot(robot, joint_speed=1.0)


def state(robot, *, coordinates=None, v=None, a=None) -> ReferenceState:
    zero = np.zeros(robot.nv)
    home = robot.space.to_coordinates(robot.home_q)
    return ReferenceState(
        0.0, home if coordinates is None else coordinates, zero if v is None else v, zero if a is None else a
    )


def largest_error(robot, run) -> float:
    return float(np.abs(robot.space.difference(run.reference, run.truth)).max())


def drive(robot, trajectory, plant, *, offset=None, gains=None) -> np.ndarray:
    """Errors (S, nv) from truth to reference, in the robot's frame, with a start beside the reference's."""
    controller = TrackingController(robot, trajectory.limits, gains)
    start = trajectory.coordinates[0] if offset is None else robot.space.integrate(trajectory.coordinates[0], offset)
    plant.reset(start)
    errors = []
    for t in trajectory.time:
        reference = trajectory.at(t)
        errors.append(robot.space.difference(plant.coordinates, reference.coordinates))
        plant.step(controller.command(reference, plant.coordinates), 0.01)
    return np.array(errors)


@each_robot
def test_a_reference_at_rest_commands_exactly_zero_whatever_the_error(robot, rng):
    limits = limits_of(robot)
    controller = TrackingController(robot, limits)
    home = robot.space.to_coordinates(robot.home_q)
    for size in (1e-4, 0.01, 0.3):
        command = controller.command(state(robot), home + size * rng.standard_normal(robot.nv))
        assert command.drive.tolist() == [0.0] * limits.drive_dim
        assert command.joints.tolist() == [0.0] * len(robot.joint_names)


def test_a_robot_whose_reference_rests_stays_at_rest(silvermate):
    """Noise of encoders and fixes reaches the estimate, but no motor."""
    limits = limits_of(silvermate)
    plant, estimator = KinematicPlant(silvermate, limits, seed=3), StateEstimator(silvermate, limits)
    controller, coordinates = TrackingController(silvermate, limits), plant.coordinates
    estimator.reset(coordinates)
    estimates = []
    for _ in range(200):
        estimates.append(estimator.update(plant.step(controller.command(state(silvermate), plant.coordinates), 0.01)))
    assert np.array_equal(plant.coordinates, coordinates)
    assert not plant.v.any()
    assert np.ptp(np.array(estimates), axis=0).max() > 1e-4  # there was something to be unsettled by


def test_an_acceleration_from_rest_is_no_rest(silvermate):
    a = np.zeros(silvermate.nv)
    a[0] = 0.5
    command = TrackingController(silvermate, limits_of(silvermate)).command(
        state(silvermate, a=a), silvermate.space.to_coordinates(silvermate.home_q)
    )
    assert command.drive == pytest.approx([0.5 * 0.046] * 2)


def test_a_saturated_drive_keeps_its_curvature(silvermate):
    limits = limits_of(silvermate)
    controller = TrackingController(silvermate, limits)
    for forward, turn in ((1.5, 2.0), (-1.5, 2.0), (0.1, -9.0)):
        v = np.zeros(silvermate.nv)
        v[0], v[2] = forward, turn
        reference = state(silvermate, v=v)
        twist = limits.to_twist(controller.command(reference, reference.coordinates).drive)
        assert twist[2] / twist[0] == pytest.approx(turn / forward)
        rims = limits.to_drive(twist)
        assert np.abs(rims).max() == pytest.approx(1.1 * limits.drive_speed[0])


def test_joints_are_limited_one_by_one(silvermate):
    limits = limits_of(silvermate)
    v = np.zeros(silvermate.nv)
    v[3], v[4] = 50.0, 0.2
    reference = state(silvermate, v=v)
    command = TrackingController(silvermate, limits).command(reference, reference.coordinates)
    assert command.joints[0] == pytest.approx(1.1 * limits.joint_speed[0])
    assert command.joints[1] == pytest.approx(0.2)


@each_robot
def test_exact_motors_follow_every_kind_of_base(robot):
    limits = limits_of(robot)
    trajectory = smooth_motion(robot, limits, 1)
    plant = KinematicPlant(robot, limits, PlantParams.ideal())
    run = follow_trajectory(trajectory, plant, StateEstimator(robot, limits), TrackingController(robot, limits, EXACT))
    assert largest_error(robot, run) < 1e-3


@pytest.mark.parametrize("turn", [False, True])
def test_the_lag_of_the_motors_is_led(silvermate, turn):
    limits = limits_of(silvermate)
    trajectory = smooth_motion(silvermate, limits, 2, turn=turn)

    def error(gains) -> float:
        plant = KinematicPlant(silvermate, limits, QUIET)
        return largest_error(
            silvermate, follow_trajectory(trajectory, plant, StateEstimator(silvermate, limits), gains)
        )

    known = TrackingGains(hold=0.005)
    led = error(TrackingController(silvermate, limits, known))
    late = error(TrackingController(silvermate, limits, replace(known, wheel_lag=0.0, joint_lag=0.0)))
    assert led < 2e-3
    assert late > 5.0 * led


@pytest.mark.parametrize("forward", [0.5, -0.5])
def test_an_error_beside_the_way_dies_out_forwards_and_backwards(silvermate, forward):
    limits = limits_of(silvermate)
    speeds = np.zeros((600, 9))
    speeds[:, :2] = forward * np.minimum(np.arange(600) / 100.0, 1.0)[:, None]
    trajectory = trajectory_of(silvermate, limits, speeds)
    offset = np.zeros(silvermate.nv)
    offset[:3] = 0.03, 0.05, 0.1
    errors = drive(silvermate, trajectory, KinematicPlant(silvermate, limits, QUIET), offset=offset)
    assert np.abs(errors[0, :3]).min() > 0.02
    assert np.abs(errors[-1, :3]).max() < 2e-3


def test_an_omnidirectional_base_is_led_in_the_references_direction(rover):
    """With a wrong heading, the feed-forward is turned into the base's own frame."""
    limits = limits_of(rover)
    v = np.zeros(rover.nv)
    v[:2] = 0.3, 0.1
    reference = state(rover, v=v)
    estimate = reference.coordinates.copy()
    estimate[2] -= 0.5
    drive_to = TrackingController(rover, limits).command(reference, estimate).drive
    c, s = np.cos(estimate[2] - reference.coordinates[2]), np.sin(estimate[2] - reference.coordinates[2])
    assert np.array([[c, -s], [s, c]]) @ drive_to[:2] == pytest.approx(v[:2])


def test_a_heading_error_dies_out_while_turning_in_place(silvermate):
    """The gain of the heading does not vanish with the forward speed."""
    limits = limits_of(silvermate)
    speeds = np.zeros((300, 9))
    speeds[:, 0], speeds[:, 1] = -0.1, 0.1
    offset = np.zeros(silvermate.nv)
    offset[0], offset[2] = 0.02, 0.2
    errors = drive(
        silvermate, trajectory_of(silvermate, limits, speeds), KinematicPlant(silvermate, limits, QUIET), offset=offset
    )
    assert np.abs(errors[-1, 2]) < 1e-3


@each_robot
def test_a_jump_of_the_estimate_is_no_jerk(robot):
    """Feedback is bounded: at most 0.25 m/s, 1 rad/s and 0.5 per joint beside the feed-forward."""
    limits = limits_of(robot)
    controller = TrackingController(robot, limits)
    v = 0.1 * np.ones(robot.nv)
    if limits.drive_dim == 2:
        v[1] = 0.0
    reference = state(robot, v=v)
    off = reference.coordinates.copy()
    off[:2] += 3.0
    off[3:] += 3.0
    there, beside = controller.command(reference, reference.coordinates), controller.command(reference, off)
    change = limits.to_twist(beside.drive - there.drive)
    if limits.drive_dim:
        assert np.hypot(*change[:2]) <= 0.25 + 1e-9
        assert abs(change[2]) <= 1.0 + 1e-9
        assert np.abs(change).max() > 0.1
    assert np.abs(beside.joints - there.joints).max() <= 0.5 + 1e-9


def test_a_continuous_joint_goes_the_short_way(rover):
    limits = limits_of(rover)
    k = int(np.flatnonzero(rover.space.circular)[0])
    v = np.zeros(rover.nv)
    v[3] = 0.1
    reference = state(rover, v=v)
    estimate = reference.coordinates.copy()
    estimate[3 + k] += 2.0 * np.pi - 0.01
    command = TrackingController(rover, limits).command(reference, estimate)
    assert command.joints[k] == pytest.approx(0.1)


@each("wrong", [{"along": -1.0}, {"hold": np.nan}, {"headroom": 0.9}, {"most_base": np.inf}])
def test_gains_are_checked(wrong):
    with pytest.raises(ParameterError, match=next(iter(wrong))):
        TrackingGains(**wrong)


def test_rest_is_a_command_of_zeros(rover):
    rest = Command.rest(limits_of(rover))
    assert rest.drive.tolist() == [0.0] * 3
    assert rest.joints.tolist() == [0.0] * len(rover.joint_names)
