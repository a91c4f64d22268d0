"""Pedestrians stop for a robot that stands, not for one that moves, and never brake harder than they may."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import configuration, link_distances
from cases import each

from elastic_strips.control.interfaces import Command
from elastic_strips.errors import ParameterError
from elastic_strips.scene import Box, Cylinder, Keyframes, PedestrianMotion, Scene, World
from elastic_strips.sim import KinematicPlant, PerceptionError, PerceptionParams, PlantParams, evaluate, simulation
from elastic_strips.sim.pedestrians import Pedestrians, YieldingPolicy, _Mover
from elastic_strips.trajectory import MotionLimits

DT = 0.01
LIMIT = 0.48


def walker(speed: float = 1.0, y: float = 0.0, height: float = 0.85, ahead: float = 6.0) -> World:
    """A person who comes along −x, towards a robot at the origin, and goes on beyond it."""
    ends = [[ahead, y, height], [-ahead, y, height]]
    motion = PedestrianMotion(Keyframes([0.0, 2 * ahead / speed], ends), LIMIT)
    return World(Scene([Cylinder(0.25, 1.7, name="walker", motion=motion)]))


def watch(robot, world: World, seconds: float, speed=lambda t: 0.0, shift=lambda t: 0.0, policy=None) -> np.ndarray:
    """Places (T, 3) of the walker while the robot is at the origin, shifted along y, and moves at ``speed``."""
    pedestrians = Pedestrians(robot, world, policy)
    coordinates, v, places = robot.space.to_coordinates(robot.home_q), np.zeros(robot.nv), []
    for k in range(round(seconds / DT)):
        t = k * DT
        v[0], coordinates[1] = speed(t), shift(t)
        pedestrians.step(t, coordinates, v)
        places.append(world.at(t).obstacle("walker").pose[:3, 3])
    return np.array(places)


def gap(robot, world: World, t: float) -> float:
    return float(link_distances(robot, world.scene.at(t), configuration(robot, _home(robot))).min())


def _home(robot) -> np.ndarray:
    return robot.space.to_coordinates(robot.home_q)


def acceleration(places: np.ndarray) -> float:
    velocity = np.diff(places, axis=0) / DT
    return float(np.linalg.norm(velocity[5:] - velocity[:-5], axis=1).max() / (5 * DT))


@each("speed", [0.3, 1.0, 1.5])
def test_stops_before_a_robot_that_stands(silvermate, speed):
    world = walker(speed)
    places = watch(silvermate, world, 6.0 / speed + 4.0, policy=YieldingPolicy(room=0.0))
    assert np.linalg.norm(places[-1] - places[-50]) < 1e-9
    assert 0.2 < gap(silvermate, world, 6.0 / speed + 4.0) < 0.5
    assert 0.3 < acceleration(places) <= LIMIT + 0.02


def test_does_not_stop_for_a_robot_that_moves(silvermate):
    places = watch(silvermate, walker(), 12.0, speed=lambda t: 0.05)
    assert acceleration(places) < 1e-6
    assert places[-1, 0] < -5.0


def test_does_not_stop_for_a_robot_that_is_not_in_its_way(silvermate):
    assert watch(silvermate, walker(y=1.5), 12.0)[-1, 0] < -5.0


@pytest.mark.parametrize("height, stops", [(0.3, True), (3.0, False)])
def test_heights_count(silvermate, height, stops):
    """What hangs above the robot passes."""
    motion = PedestrianMotion(Keyframes([0.0, 12.0], [[6, 0, height], [-6, 0, height]]), LIMIT)
    world = World(Scene([Box((0.5, 0.3, 0.3), name="walker", motion=motion)]))
    assert bool(watch(silvermate, world, 12.0)[-1, 0] > 0.0) is stops


def test_goes_on_when_the_robot_is_gone(silvermate):
    world = walker()
    places = watch(silvermate, world, 30.0, shift=lambda t: 0.0 if t < 10.0 else 3.0)
    assert places[999, 0] > 0.5
    assert places[-1, 0] < -5.0
    assert acceleration(places[places[:, 0] > -5.0]) <= LIMIT + 0.02  # the track itself ends at once


def test_steps_back_from_a_robot_that_stays(silvermate):
    places = watch(silvermate, walker(), 20.0)
    assert places[-1, 0] > places[:, 0].min() + 0.3
    assert np.linalg.norm(places[-1] - places[-200]) < 1e-6  # and waits there
    assert acceleration(places) <= LIMIT + 0.02


def test_one_that_cannot_stop_in_time_brakes_as_it_can(silvermate):
    """The robot stands from 5 s on only, with the walker at 1 m/s 1 m before its middle."""
    world = walker()
    places = watch(silvermate, world, 7.0, speed=lambda t: 0.3 if t < 5.0 else 0.0)
    assert gap(silvermate, world, 6.5) < 0.0
    pace = np.linalg.norm(np.diff(places, axis=0), axis=1) / DT
    assert pace[499] == pytest.approx(1.0)
    assert pace[600] == pytest.approx(1.0 - LIMIT * 0.8, abs=0.05)


def test_a_turn_and_braking_together_stay_within_the_bound(silvermate):
    """On a circle at 0.8 m/s, 0.4 m/s² inwards, that the robot stands on."""
    angle = np.linspace(0.0, 1.7 * np.pi, 1200)
    circle = np.column_stack((1.6 * (1 - np.cos(angle)), 1.6 * np.sin(angle), np.full(len(angle), 0.85)))
    motion = PedestrianMotion(Keyframes(angle / 0.5, circle), LIMIT)
    world = World(Scene([Cylinder(0.25, 1.7, name="walker", motion=motion)]))
    pedestrians, coordinates = Pedestrians(silvermate, world), _home(silvermate)
    coordinates[:2] = 3.2, 0.0
    places = []
    for k in range(1200):
        pedestrians.step(k * DT, coordinates, np.zeros(silvermate.nv))
        places.append(world.at(k * DT).obstacle("walker").pose[:3, 3])
    assert motion.rate(11.9) < 1.0
    assert motion.place(11.9) < 6.0
    assert 0.42 < acceleration(np.array(places)) <= 0.5


def test_where_its_track_brakes_harder_than_it_may_its_clock_runs_no_faster_than_others():
    times = np.arange(0.0, 2.05, 0.1)
    way = np.where(times < 1.0, 2.0 * times, 2.0 + np.minimum(2.0 * (times - 1.0) - 5.0 * (times - 1.0) ** 2, 0.2))
    way = np.maximum.accumulate(way)
    track = Keyframes(times, np.column_stack((way, 0.0 * way, np.full(len(way), 0.85))))
    person = Cylinder(0.25, 1.7, motion=PedestrianMotion(track, acceleration=2.0), name="person")
    mover = _Mover(person, person.motion)
    changed = [mover._towards(1.0, place, rate, 0.1) for place in np.linspace(0.8, 1.4, 61) for rate in (0.9, 0.99)]
    assert max(changed) <= 1.0
    free = [rate + 0.1 * mover._changes(place, rate)[0] for place in np.linspace(0.8, 1.4, 61) for rate in (0.9, 0.99)]
    assert max(free) > 1.0, "this is not the case that it is about"


def test_making_the_workspace_begins_anew(silvermate):
    world = walker()
    one = watch(silvermate, world, 8.0)
    np.testing.assert_array_equal(one, watch(silvermate, world, 8.0))


class Blind:
    """A perception that has seen the world once, and nothing since: a robot does not set out on that."""

    contact = ""

    def __init__(self, world):
        self.params, self._world = PerceptionParams(), world

    def known(self):
        return self._world.at(0.0)

    def observe(self, t, coordinates, estimate):
        pass

    def sense(self, t):
        raise PerceptionError("nothing to be seen")


def test_the_loop_asks_them_and_the_record_keeps_what_they_did(silvermate):
    """A robot that has nowhere to go stands; the walker stops; a second run does not change the first one's record."""
    world = walker()
    limits = MotionLimits.for_robot(silvermate)
    records = []
    for _ in range(2):
        plant = KinematicPlant(silvermate, limits, PlantParams.ideal(), seed=0)
        standing = simulation(
            silvermate, world, silvermate.home(), silvermate.home(x=-3.0), plant=plant, perception=Blind(world), seed=1
        )
        records.append(standing.run(time_limit=8.0).record)
    first, second = (evaluate(r, silvermate) for r in records)
    assert first.min_clearance_m == second.min_clearance_m > 0.15
    assert records[0].world is not records[1].world
    times = records[0].control.time
    dense = min(gap(silvermate, records[0].world, float(t)) for t in times[::5])
    assert abs(first.min_clearance_m - dense) <= first.accuracy_m + 1e-4


def test_two_simulations_of_one_world_do_not_touch_each_other(silvermate):
    """In the first one somebody stops the walker; in the second one, and in the world itself, it goes on."""
    world = walker()
    first, second = (
        simulation(silvermate, world, silvermate.home(), silvermate.home(x=-3.0), seed=1) for _ in range(2)
    )
    first.world.scene.obstacle("walker").motion.advance(0.5, 0.0)
    second.run(time_limit=1.0)
    places = [each.at(1.0).obstacle("walker").pose[0, 3] for each in (first.world, second.world, world)]
    assert places == pytest.approx([5.5, 5.0, 5.0])


def test_mujoco_carries_them_as_their_clocks_say(silvermate):
    """The body of the walker is where its history has it, and so has its velocity."""
    pytest.importorskip("mujoco", reason="mujoco (extra sim) is not installed")
    from elastic_strips.sim.mujoco.plant import MujocoPlant

    world = walker()
    plant = MujocoPlant(silvermate, MotionLimits.for_robot(silvermate), world, PlantParams.ideal(), seed=0)
    plant.reset(_home(silvermate))
    pedestrians = Pedestrians(silvermate, world)
    still = Command(np.zeros(2), np.zeros(len(silvermate.joint_names)))
    carried = []
    for k in range(700):
        pedestrians.step(k * DT, plant.coordinates, plant.v)
        plant.step(still, DT)
        carried.append(np.array(plant._data.mocap_pos[0]))
    times = np.arange(1, 701) * DT - plant.timestep  # it is carried before each step of the simulation
    expected = np.array([world.scene.obstacle("walker").at(float(t)).pose[:3, 3] for t in times])
    np.testing.assert_allclose(carried, expected, atol=1e-9)
    speeds = np.linalg.norm(np.diff(carried, axis=0), axis=1) / DT
    assert speeds.max() == pytest.approx(1.0)
    assert speeds[-1] < 0.5
    assert not plant.contact_events
    plant.close()


@each("wrong", [{"distance": -1.0}, {"room": 2.0}, {"pace": 1.5}, {"look": 0.0}])
def test_wrong_courtesy_is_refused(wrong):
    with pytest.raises(ParameterError):
        YieldingPolicy(**wrong)
