"""Braking: the same way, as little of it as the motors allow."""

from __future__ import annotations

import numpy as np
from cases import each
from drivable import arcs, limits_of, most_used

from elastic_strips.trajectory.retiming import Retimer
from elastic_strips.trajectory.trajectory import Trajectory, stationary


def distance_from_way(stop: Trajectory, way: Trajectory) -> float:
    """Largest difference in any coordinate between the stop's samples and the nearest point of the way."""
    space = way.robot.space
    s = np.linspace(0.0, 1.0, 101)[:, None]
    worst = 0.0
    for row in stop.coordinates:
        gap = np.abs(space.difference(way.coordinates, np.broadcast_to(row, way.coordinates.shape).copy())).max(axis=1)
        i = int(np.argmin(gap))
        near = [space.integrate(np.repeat(way.coordinates[k][None], 101, axis=0), s * way.steps[k]) for k in (i - 1, i)
                if 0 <= k < len(way.steps)]  # fmt: skip
        dense = np.vstack(near)
        gap = np.abs(space.difference(dense, np.broadcast_to(row, dense.shape).copy())).max(axis=1)
        worst = max(worst, float(gap.min()))
    return worst


@each("name", ["silvermate", "tiago", "rover", "gantry"])
def test_a_stop_on_the_way(name, request):
    robot = request.getfixturevalue(name)
    limits = limits_of(robot)
    retimer = Retimer(robot, limits)
    shorter = 0
    for seed in range(4):
        way = retimer.full(arcs(robot, seed), start_time=2.0)
        for t in np.linspace(way.start_time + 0.03, way.end_time - 0.03, 5):
            stop = retimer.brake(way, t)
            state = way.at(t)
            assert stop.start_time == t
            np.testing.assert_array_equal(stop.coordinates[0], state.coordinates)
            np.testing.assert_allclose(stop.v[0], state.v, atol=1e-12)
            assert stop.at_rest_at_end
            assert stop.duration <= way.end_time - t + 1e-9
            if len(stop) != len(way.tail(t)):  # which has a first step of any length, evenly driven
                assert max(most_used(stop, limits)) <= 1.001 + 1e-9
            assert distance_from_way(stop, way) < 1e-4
            if limits.drive_dim == 2:
                assert np.abs(stop.steps[:, 1]).max() < 1e-9
            shorter += stop.duration < 0.7 * (way.end_time - t)
    assert shorter > 5


def test_as_short_as_the_motors_allow(silvermate):
    nodes = np.tile(silvermate.space.to_coordinates(silvermate.home_q), (20, 1))
    nodes[:, 0] = 0.2 * np.arange(20)
    retimer = Retimer(silvermate)
    way = retimer.full(nodes)
    t = 0.5 * way.end_time
    speed = way.at(t).v[0]
    assert speed > 0.9
    stop = retimer.brake(way, t)
    exact = speed**2 / (2.0 * 1.2)
    assert exact <= stop.coordinates[-1, 0] - stop.coordinates[0, 0] <= 1.04 * exact
    harder = Retimer(silvermate, way.limits.scaled(1.0, 2.0)).brake(way, t)
    assert 0.5 * exact <= harder.coordinates[-1, 0] - harder.coordinates[0, 0] <= 0.54 * exact
    np.testing.assert_allclose(harder.limits.drive_acceleration, 2.4)


def test_nothing_left_to_brake(silvermate):
    retimer = Retimer(silvermate)
    way = retimer.full(arcs(silvermate, 1), start_time=1.0)
    over = retimer.brake(way, way.end_time + 1.0)
    assert over.at_rest_at_end
    np.testing.assert_array_equal(over.coordinates[-1], way.coordinates[-1])
    early = retimer.brake(way, 0.0)
    assert early.start_time == way.start_time
    np.testing.assert_array_equal(early.coordinates[0], way.coordinates[0])
    assert np.abs(early.coordinates[-1] - way.coordinates[0]).max() < 0.01
    late = retimer.brake(way, way.end_time - 0.05)
    assert late.at_rest_at_end
    assert late.end_time <= way.end_time + 1e-9


def test_who_stands_or_is_about_to_has_nothing_to_brake(silvermate):
    """At any time, also just beside a sample; a stop that is braked again is what is left of it."""
    retimer = Retimer(silvermate, dt=0.02)
    nodes = np.tile(silvermate.space.to_coordinates(silvermate.home_q), (6, 1))
    still = stationary(silvermate, retimer.limits, nodes[0], 1.0, 0.01)
    for t in (0.0, 1.0, 1.005, 1.01, 5.0):
        stop = retimer.brake(still, t)
        assert stop.at_rest_at_end
        np.testing.assert_array_equal(stop.coordinates[-1], nodes[0])
    nodes[:, 0] = 0.2 * np.arange(6)
    way = retimer.horizon(nodes, start_time=0.1)
    stop = retimer.brake(way, 0.9)
    for motion in (way, stop):
        some = np.union1d(motion.time[::5], motion.time[-8:])  # towards the end there is little left
        for t in np.concatenate([some - 1e-9, some, some + 1e-9]).tolist():
            again = retimer.brake(motion, t)
            assert again.at_rest_at_end
            assert again.end_time <= max(motion.end_time, t + 0.02) + 1e-9
