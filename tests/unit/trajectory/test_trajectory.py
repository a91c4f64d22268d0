"""Trajectory: a frozen motion whose references lie on the arcs that are certified."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from brute_force import configuration
from cases import each, each_robot, refused
from drivable import arcs, limits_of, motor_travel

from elastic_strips.errors import ParameterError
from elastic_strips.trajectory.retiming import Retimer
from elastic_strips.trajectory.trajectory import Trajectory


def motion_of(robot) -> Trajectory:
    return Retimer(robot, limits_of(robot)).horizon(arcs(robot, 5), distance=1.5, start_time=3.0)


@each_robot
def test_references_lie_on_the_arcs(robot, rng):
    motion = motion_of(robot)
    for t in rng.uniform(motion.start_time, motion.end_time, 20):
        i = int(np.searchsorted(motion.time, t, side="right")) - 1
        s = (t - motion.time[i]) / (motion.time[i + 1] - motion.time[i])
        state = motion.at(t)
        assert state.time == t
        expected = pin.interpolate(robot.model, motion.q[i], motion.q[i + 1], s)
        np.testing.assert_allclose(configuration(robot, state.coordinates), expected, atol=1e-12)
        np.testing.assert_allclose(state.v, (1 - s) * motion.v[i] + s * motion.v[i + 1], atol=1e-12)
        np.testing.assert_allclose(state.a, (1 - s) * motion.a[i] + s * motion.a[i + 1], atol=1e-12)


@each_robot
def test_before_the_start_and_after_the_end(robot):
    motion = motion_of(robot)
    before, after = motion.at(motion.start_time - 1.0), motion.at(motion.end_time + 1.0)
    np.testing.assert_array_equal(before.coordinates, motion.coordinates[0])
    np.testing.assert_array_equal(before.a, motion.a[0])
    assert before.a.any()
    np.testing.assert_array_equal(after.coordinates, motion.coordinates[-1])
    assert not after.v.any()
    assert not after.a.any()
    assert after.time == motion.end_time + 1.0
    np.testing.assert_array_equal(motion.at(motion.time[7]).coordinates, motion.coordinates[7])


@each_robot
def test_who_interpolates_the_values_goes_the_way_of_the_references(robot):
    """Also where a yaw was given wrapped: the values of two samples are less than half a turn apart."""
    motion = motion_of(robot)
    turning = motion.robot.space.turning
    wrapped = motion.coordinates.copy()
    shift = np.pi - motion.coordinates[len(motion) // 2]  # so that the angles pass over half a turn on the way
    wrapped[:, turning] = np.mod(wrapped + shift + np.pi, 2.0 * np.pi)[:, turning] - np.pi
    again = replace(motion, coordinates=wrapped)
    assert (np.abs(np.diff(again.coordinates[:, turning], axis=0)) < np.pi).all()
    for t in np.linspace(again.start_time, again.end_time, 50):
        values = [np.interp(t, again.time, column) for column in again.coordinates[:, turning].T]
        np.testing.assert_allclose(again.at(float(t)).coordinates[turning], values, atol=1e-9)


@each_robot
def test_many_references_at_once(robot):
    motion = motion_of(robot)
    times = np.linspace(motion.start_time - 0.5, motion.end_time + 0.5, 40)
    expected = [motion.at(float(t)).coordinates for t in times]
    np.testing.assert_allclose(motion.coordinates_at(times), expected, rtol=0.0, atol=1e-12)
    early = motion.tail(motion.start_time + 0.3 * (motion.time[1] - motion.time[0]))
    np.testing.assert_allclose(early.coordinates_at(early.time), early.coordinates, rtol=0.0, atol=1e-12)


@each_robot
def test_what_a_tail_keeps(robot, rng):
    motion = motion_of(robot)
    t = motion.start_time + 0.4 * motion.duration
    tail = motion.tail(t)
    assert tail.start_time == t
    assert tail.end_time == motion.end_time
    for later in rng.uniform(t, motion.end_time, 10):
        one, other = motion.at(later), tail.at(later)
        np.testing.assert_allclose(other.coordinates, one.coordinates, atol=1e-12)
        np.testing.assert_allclose(other.v, one.v, atol=1e-12)
    assert motion.tail(motion.start_time - 1.0) is motion
    np.testing.assert_array_equal(motion.tail(motion.time[9]).coordinates, motion.coordinates[9:])
    early = motion.tail(motion.time[9] - 1e-12)
    assert len(early) == len(motion) - 9
    np.testing.assert_allclose(early.coordinates, motion.coordinates[9:], atol=1e-12)
    assert len(motion.tail(motion.end_time - 1e-12)) == 2
    over = motion.tail(motion.end_time + 5.0)
    assert over.at_rest_at_end
    np.testing.assert_array_equal(over.coordinates, np.stack([motion.coordinates[-1]] * 2))
    assert not over.v.any()


@each_robot
def test_the_samples_as_a_strip(robot):
    motion = motion_of(robot)
    strip = motion.strip()
    assert strip.robot is robot
    np.testing.assert_array_equal(strip.coordinates, motion.coordinates)
    np.testing.assert_array_equal(strip.q, motion.q)


@each_robot
def test_speeds_of_base_and_wheels(robot):
    motion = motion_of(robot)
    assert len(motion) == len(motion.time)
    limits = motion.limits
    np.testing.assert_allclose(limits.to_coordinates(motion.v), motor_travel(robot, limits, motion.v), atol=1e-14)
    if limits.drive_dim == 2:
        assert (motion.v[:, 0] >= 0.0).all()


def test_backwards_is_negative(silvermate):
    limits = limits_of(silvermate)
    nodes = np.tile(silvermate.space.to_coordinates(silvermate.home_q), (6, 1))
    nodes[:, 0] = -0.2 * np.arange(6)
    motion = Retimer(silvermate, limits).full(nodes)
    assert motion.v[:, 0].min() < -0.5
    assert motion.v[:, 0].max() <= 0.0


@each_robot
def test_it_is_a_frozen_copy(robot, silvermate):
    motion = motion_of(robot)
    for name in ("time", "coordinates", "v", "a", "q", "steps"):
        with refused(ValueError, "read-only"):
            getattr(motion, name)[0] = 0.0
    rows = np.zeros((3, silvermate.nv))
    own = Trajectory(silvermate, limits_of(silvermate), np.arange(3.0), rows, rows, rows)
    rows[1] = 7.0
    assert not own.coordinates.any()


@each_robot
def test_rest_at_the_end(robot, silvermate):
    motion = motion_of(robot)
    assert motion.at_rest_at_end
    rows = np.zeros((3, silvermate.nv))
    assert not Trajectory(silvermate, limits_of(silvermate), np.arange(3.0), rows, rows + 1e-3, rows).at_rest_at_end


@each(
    "change, match",
    [
        ({"time": [0.0]}, "at least 2 samples"),
        ({"time": [0.0, 1.0, 1.0]}, "ascending"),
        ({"time": [0.0, 2.0, 1.0]}, "ascending"),
        ({"time": [0.0, 1.0, np.inf]}, "time.*finite"),
        ({"coordinates": np.zeros((3, 4))}, "coordinates of .* shape"),
        ({"v": np.zeros((2, 10))}, "v of .* shape"),
        ({"a": np.full((3, 10), np.nan)}, "a of .* finite"),
    ],
)
def test_wrong_samples(silvermate, change, match):
    fields = {"time": np.arange(3.0), "coordinates": np.zeros((3, 10)), "v": np.zeros((3, 10)), "a": np.zeros((3, 10))}
    with pytest.raises(ParameterError, match=match):
        Trajectory(robot=silvermate, limits=limits_of(silvermate), **{**fields, **change})
