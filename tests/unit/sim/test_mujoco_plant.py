"""The MuJoCo plant: it rolls as its wheels turn, holds its arm, follows motions, and tells what it runs into."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from cases import each, refused
from following import follow_trajectory
from motions import smooth_motion

pytest.importorskip("mujoco", reason="mujoco (extra sim) is not installed")

from elastic_strips.collision.bounds import Displacement
from elastic_strips.control.estimation import StateEstimator
from elastic_strips.control.interfaces import Command
from elastic_strips.control.tracking import TrackingController
from elastic_strips.errors import ParameterError
from elastic_strips.planning import plan
from elastic_strips.scene import (
    Box,
    Capsule,
    Cone,
    ConvexHull,
    Cylinder,
    Keyframes,
    Mesh,
    Scene,
    Sphere,
    Twist,
    Voxels,
    World,
)
from elastic_strips.sim.mujoco.model import LINK, ROLLING
from elastic_strips.sim.mujoco.plant import MujocoPlant
from elastic_strips.sim.plant import OdometryParams, PlantParams
from elastic_strips.sim.scenarios.corridors import corridor_scene
from elastic_strips.strip import Strip, strip_clearance
from elastic_strips.trajectory.limits import MotionLimits
from elastic_strips.trajectory.retiming import retime

EXACT = PlantParams(jitter=0.0, odometry=OdometryParams.ideal())


def limits_of(robot) -> MotionLimits:
    return MotionLimits.for_robot(robot)


def drive(plant, seconds, left=0.0, right=None, joints=0.0, ramp=0.5) -> np.ndarray:
    """Drive with constant speeds after a ramp; returns the rims' travel by the encoders."""
    n, travel = len(plant.limits.joint_speed), np.zeros(2)
    right = left if right is None else right
    for i in range(round(seconds / 0.01)):
        s = min(1.0, (i + 1) * 0.01 / ramp)
        travel = travel + plant.step(Command(s * np.array([left, right]), np.full(n, s * joints)), 0.01).drive
    return travel


@pytest.fixture(scope="module")
def plant(silvermate) -> MujocoPlant:
    """The Silvermate on an empty floor; exact sensors."""
    return MujocoPlant(silvermate, limits_of(silvermate), params=EXACT)


@pytest.fixture(params=["silvermate", "tiago"])
def machine(request) -> MujocoPlant:
    robot = request.getfixturevalue(request.param)
    return MujocoPlant(robot, limits_of(robot), params=EXACT)


def test_it_stands_and_holds_its_arm(machine):
    home = machine.robot.space.to_coordinates(machine.robot.home_q)
    machine.reset(home, 2.0)
    assert machine.time == 2.0
    assert machine.coordinates == pytest.approx(home, abs=1e-12)
    drive(machine, 2.0)
    assert machine.time == pytest.approx(4.0)
    assert machine.coordinates == pytest.approx(home, abs=1e-4)
    assert np.abs(machine.v).max() < 1e-4
    assert machine.contacts() == ()


def test_masses_are_the_descriptions(machine):
    inertias = machine.robot.model.inertias
    assert sum(machine._model.body_mass) == pytest.approx(sum(i.mass for i in inertias), rel=1e-6)


def test_it_drives_straight_as_far_as_its_wheels_turn(machine):
    machine.reset(machine.robot.space.to_coordinates(machine.robot.home_q))
    travel = drive(machine, 3.0, 0.4)
    assert machine.v[0] == pytest.approx(0.4, rel=0.02)
    assert machine.motors == pytest.approx([0.4, 0.4], rel=0.01)
    assert abs(machine.v[1]) < 0.002
    way = machine.coordinates[0] * np.cos(machine.coordinates[2]) + machine.coordinates[1] * np.sin(
        machine.coordinates[2]
    )
    assert way == pytest.approx(travel.mean(), rel=5e-3)
    assert travel == pytest.approx([0.4 * 2.75 - 0.4 * 0.04] * 2, rel=0.03)


@each("rim", [0.2, -0.2])
def test_it_turns_in_place_as_its_wheels_turn(machine, rim):
    machine.reset(machine.robot.space.to_coordinates(machine.robot.home_q))
    travel = drive(machine, 8.0, -rim, rim)
    turned = (travel[1] - travel[0]) / machine.limits.track
    assert abs(turned) > 2.0 * np.pi  # the yaw runs on
    assert machine.coordinates[2] == pytest.approx(turned, rel=0.02)
    assert machine.v[2] == pytest.approx(2.0 * rim / machine.limits.track, rel=0.03)
    assert np.hypot(*machine.coordinates[:2]) < 0.03


def test_a_zero_command_stops_it(plant):
    plant.reset(plant.robot.space.to_coordinates(plant.robot.home_q))
    drive(plant, 1.0, 0.5)
    drive(plant, 0.5)
    assert np.abs(plant.v).max() < 0.01
    drive(plant, 0.5)
    assert np.abs(plant.v).max() < 1e-3


def test_joints_turn_as_they_are_told(machine):
    home = machine.robot.space.to_coordinates(machine.robot.home_q)
    machine.reset(home)
    drive(machine, 1.5, joints=0.05)
    lag = 0.25 + machine.params.joint_lag
    assert machine.coordinates[3:] - home[3:] == pytest.approx(np.full(len(home) - 3, 0.05 * (1.5 - lag)), abs=4e-3)
    assert machine.v[3:] == pytest.approx(np.full(len(home) - 3, 0.05), abs=5e-3)
    assert np.hypot(*machine.coordinates[:2]) < 2e-3


def test_joints_lag_as_the_parameters_say(silvermate):
    ways = []
    for lag in (0.03, 0.08):
        params = PlantParams(jitter=0.0, joint_lag=lag, odometry=OdometryParams.ideal())
        plant = MujocoPlant(silvermate, limits_of(silvermate), params=params)
        begin = plant.coordinates
        drive(plant, 1.0, joints=0.15)
        ways.append(plant.coordinates[3:] - begin[3:])
    assert ways[0] - ways[1] == pytest.approx(np.full(7, 0.05 * 0.15), abs=1.5e-3)


def test_it_starts_at_any_pose(plant, rng):
    home = plant.robot.space.to_coordinates(plant.robot.home_q)
    for yaw in (-3.0, 0.7, 9.0):
        home[:3] = 2.0, -1.0, yaw
        plant.reset(home)
        assert plant.coordinates == pytest.approx(home, abs=1e-9)
        drive(plant, 1.0, 0.3)
        way = plant.coordinates[:2] - home[:2]
        assert way @ (np.cos(yaw), np.sin(yaw)) == pytest.approx(np.hypot(*way), rel=1e-3)


def test_the_wheels_carry_most_of_the_weight(plant):
    """Else one of them would lift in a fast curve: the robot on four rigid points did."""
    import mujoco

    plant.reset(plant.robot.space.to_coordinates(plant.robot.home_q))
    drive(plant, 0.5)
    mujoco.mj_forward(plant._model, plant._data)
    force, load = np.zeros(6), {}
    for i in range(plant._data.ncon):
        mujoco.mj_contactForce(plant._model, plant._data, i, force)
        owner = plant._layout.owner[max(plant._data.contact[i].geom1, plant._data.contact[i].geom2)]
        load[owner] = load.get(owner, 0.0) + force[0]
    weight = 9.81 * plant._model.body_mass.sum()
    assert sum(load.values()) == pytest.approx(weight, rel=0.01)
    assert load["wheel_left_link"] + load["wheel_right_link"] > 0.8 * weight


def largest_displacement(robot, run) -> float:
    return float(Displacement(robot)(run.reference, run.truth).max())


@pytest.mark.parametrize("turn", [False, True])
def test_it_follows_motions(silvermate, turn):
    limits = limits_of(silvermate)
    runs = []
    for seed in range(3):
        plant = MujocoPlant(silvermate, limits, seed=seed)
        motion = smooth_motion(silvermate, limits, seed, turn=turn, seconds=5.0)
        runs.append(
            follow_trajectory(motion, plant, StateEstimator(silvermate, limits), TrackingController(silvermate, limits))
        )
        assert plant.contact_events == ()
    assert max(largest_displacement(silvermate, run) for run in runs) < 0.015  # 0.010 measured


def test_it_follows_motions_that_its_wheels_are_strong_enough_for(tiago):
    """6 N m per wheel: TIAGo cannot speed up its wheels by 1.2 m/s² in a turn."""
    limits = MotionLimits.for_robot(tiago, wheel_acceleration=0.8)
    plant = MujocoPlant(tiago, limits, seed=1)
    motion = smooth_motion(tiago, limits, 1, seconds=5.0)
    run = follow_trajectory(motion, plant, StateEstimator(tiago, limits), TrackingController(tiago, limits))
    assert largest_displacement(tiago, run) < 0.015


def test_it_drives_through_a_corridor_without_a_touch(silvermate):
    limits = limits_of(silvermate)
    scene = corridor_scene(4)
    strip = plan(silvermate, scene, silvermate.home(), silvermate.home(8.0), seed=4)
    motion = retime(strip, limits.scaled(0.95, 0.75))
    plant = MujocoPlant(silvermate, limits, scene, seed=4)
    run = follow_trajectory(motion, plant, StateEstimator(silvermate, limits), TrackingController(silvermate, limits))
    assert plant.contact_events == ()
    assert np.hypot(*(plant.coordinates[:2] - (8.0, 0.0))) < 0.05
    assert largest_displacement(silvermate, run) < 0.02


def test_it_runs_into_a_box_and_says_so(silvermate):
    box = Box((0.2, 2.0, 0.4), at=(0.8, 0.0, 0.2), name="crate")  # below the hand
    plant = MujocoPlant(silvermate, limits_of(silvermate), Scene([box]), EXACT)
    while plant.coordinates[0] < 0.3:
        drive(plant, 0.1, 0.4, ramp=0.01)
    assert plant.contacts() == plant.contact_events == ()
    drive(plant, 2.0, 0.4, ramp=0.01)
    now = {(t.link, t.other) for t in plant.contacts()}
    assert ("base_link", "crate") in now
    event = plant.contact_events[0]
    assert (event.link, event.other) == ("base_link", "crate")
    # the base's edge, 0.27 m before its middle, meets the box at 0.7 m
    assert 0.42 < plant.coordinates[0] < 0.44
    assert event.speed == pytest.approx(0.4, abs=0.03)
    assert 0.0 < event.depth < 0.02
    assert event.end == pytest.approx(plant.time)
    assert {e.other for e in plant.contact_events} == {"crate"}
    assert max(t.speed for t in plant.contacts()) < 0.1
    plant.reset(silvermate.space.to_coordinates(silvermate.home_q))
    assert plant.contact_events == plant.contacts() == ()


def test_contacts_of_one_pair_are_one_event_until_it_parts(silvermate):
    plant = MujocoPlant(silvermate, limits_of(silvermate), Scene([Sphere(0.2, at=(0.6, 0.0, 0.2), name="ball")]), EXACT)
    drive(plant, 1.0, 0.4)
    drive(plant, 1.0, -0.3)
    drive(plant, 1.5, 0.4)
    hits = [e for e in plant.contact_events if e.link == "base_link"]
    assert len(hits) == 2
    assert hits[0].end < hits[1].start - 0.5


SHAPES = {
    "box": Box((0.3, 0.2, 1.6), at=(0.8, 0.1, 0.8), quat=(0, 0, np.sin(0.4), np.cos(0.4))),
    "sphere": Sphere(0.3, at=(0.8, 0.1, 0.3)),
    "cylinder": Cylinder(0.2, 1.5, at=(0.8, 0.1, 0.75)),
    "lying cylinder": Cylinder(0.1, 1.0, at=(0.8, 0.0, 0.2), quat=(np.sin(0.6), 0.0, 0.0, np.cos(0.6))),
    "capsule": Capsule(0.15, 1.0, at=(0.8, -0.1, 0.65)),
    "cone": Cone(0.3, 1.2, at=(0.8, 0.1, 0.6)),
    "convex": ConvexHull([(0, 0, 0), (0.3, 0, 0), (0, 0.3, 0), (0, 0, 0.8), (0.2, 0.2, 0.5)], at=(0.7, 0.0, 0.0)),
    "mesh": Mesh(
        [(0, 0, 0), (0.3, 0, 0), (0, 0.3, 0), (0, 0, 0.8)],
        [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)],
        at=(0.7, -0.1, 0.0),
    ),
    "voxels": Voxels([(0.7, 0.0, 0.05), (0.8, 0.0, 0.05), (0.7, 0.1, 0.15), (0.7, 0.1, 0.25)], 0.1),
    "on an arm": Sphere(0.06, at=(0.85, -0.2, 0.85)),
}


@each("shape", list(SHAPES))
def test_every_shape_is_touched_where_the_planner_has_it(silvermate, shape):
    scene = Scene([SHAPES[shape].named("thing")])
    plant = MujocoPlant(silvermate, limits_of(silvermate), scene, EXACT)
    coordinates = silvermate.space.to_coordinates(silvermate.home_q)
    if shape == "on an arm":
        coordinates[3:] = 0.61, 0.25, -0.58, 1.53, 0.46, -0.36, 0.55
    plant.reset(coordinates)
    command = Command(np.array([0.08, 0.08]), np.zeros(7))
    while not plant.contact_events and plant.time < 10.0:
        before = plant.coordinates
        plant.step(command, 0.01)
    assert plant.contact_events, "it drove through"
    assert plant.contact_events[0].other == "thing"

    def clearance(coordinates) -> float:
        return strip_clearance(Strip.from_coordinates(silvermate, np.vstack([coordinates, coordinates])), scene)

    assert abs(clearance(before)) < 2.5e-3


def test_moving_obstacles_move_and_hit_a_robot_at_rest(silvermate):
    ball = Sphere(0.15, at=(1.2, 0.0, 0.2), motion=Twist(linear=(-0.5, 0.0, 0.0)), name="ball")
    plant = MujocoPlant(silvermate, limits_of(silvermate), Scene([ball]), EXACT)
    drive(plant, 2.0)
    event = plant.contact_events[0]
    # the gap of 1.2 − 0.27 − 0.15 m, less a little where the sphere is lower than its middle
    assert event.start == pytest.approx(0.78 / 0.5, abs=0.02)
    assert event.speed < 0.05
    assert plant.coordinates[0] < -0.05  # pushed


def test_keyframes_turn_their_obstacle(silvermate):
    turn = (0.0, 0.0, np.sin(np.pi / 4), np.cos(np.pi / 4))
    bar = Box(
        (1.2, 0.1, 0.5), at=(0.6, 1.2, 0.3), name="bar",
        motion=Keyframes([0.0, 1.0], [(0.6, 1.2, 0.3), (0.6, 0.9, 0.3)], quats=[(0, 0, 0, 1), turn]),
    )  # fmt: skip
    scene = Scene([bar])
    plant = MujocoPlant(silvermate, limits_of(silvermate), scene, EXACT)
    drive(plant, 1.2)
    g = plant._layout.obstacle_geoms["bar"][0]
    T = scene.at(1.2).obstacle("bar").pose
    assert plant._data.geom_xpos[g] == pytest.approx(T[:3, 3], abs=1e-6)
    assert plant._data.geom_xmat[g].reshape(3, 3) == pytest.approx(T[:3, :3], abs=1e-6)


def test_what_appears_and_vanishes_is_there_in_between(silvermate):
    scene = Scene(
        [Box((0.2, 2.0, 0.4), at=(0.8, 0.0, 0.2), name="door"), Box((0.1, 0.1, 0.1), at=(5, 5, 5), name="far")]
    )
    world = World(scene, appears={"door": 3.0}, vanishes={"door": 5.0})
    late = MujocoPlant(silvermate, limits_of(silvermate), world, EXACT)
    drive(late, 2.5, 0.2)
    assert late.coordinates[0] > 0.43
    assert late.contact_events == ()
    late.reset(silvermate.space.to_coordinates(silvermate.home_q), 3.0)
    drive(late, 3.0, 0.5)
    held = [e for e in late.contact_events if e.link == "base_link"]
    assert len(held) == 1
    assert held[0].end == pytest.approx(5.0, abs=0.011)
    assert late.coordinates[0] > 0.6  # through the open door


def test_the_robot_never_touches_itself(silvermate):
    """An arm that is turned into the body goes through it; nothing but obstacles and the floor is physical."""
    plant = MujocoPlant(silvermate, limits_of(silvermate), params=EXACT)
    coordinates = plant.coordinates
    coordinates[3:] = 0.0, -0.6, 0.0, 2.0, 0.0, 0.0, 0.0
    plant.reset(coordinates)
    drive(plant, 0.3)
    assert plant.coordinates == pytest.approx(coordinates, abs=1e-3)
    assert plant.contact_events == ()
    layout = plant._layout
    mine = np.isin(layout.kind, (LINK, ROLLING))
    bits, with_bits = plant._model.geom_contype[mine], plant._model.geom_conaffinity[mine]
    assert not (bits[:, None] & with_bits).any()


def test_the_arm_touches_the_floor(tiago):
    plant = MujocoPlant(tiago, limits_of(tiago), params=EXACT)
    coordinates = plant.coordinates
    coordinates[3:] = 0.35, 2.28, -1.5, 0.1, 0.16, 0.0, 0.0, 0.0  # hanging, the lift up
    plant.reset(coordinates)
    lower = Command(np.zeros(2), np.array([-0.07, *np.zeros(7)]))
    for _ in range(100):
        plant.step(lower, 0.01)
    assert plant.contact_events == ()
    for _ in range(350):
        plant.step(lower, 0.01)
    events = plant.contact_events
    assert events
    assert {e.other for e in events} == {"floor"}


def test_sensors_are_those_of_the_kinematic_plant(silvermate):
    plant = MujocoPlant(silvermate, limits_of(silvermate), seed=3)
    truth, fixes, lost = {}, [], []
    for i in range(100):
        if i == 60:
            plant.lost_odometry(0.8)
        m = plant.step(Command(np.array([0.3, 0.2]), np.zeros(7)), 0.01)
        truth[round(plant.time, 3)] = plant.coordinates
        lost.append(m.drive is None)
        assert m.joints == pytest.approx(plant.coordinates[3:], abs=7e-4)
        if m.pose is not None:
            fixes.append(m.pose - truth[round(m.pose_time, 3)][:3])
            assert m.time - m.pose_time == pytest.approx(0.02)
    assert sum(lost) == 20
    assert len(fixes) > 12
    assert 1e-3 < np.abs(fixes).max() <= 0.009 + 1e-12


def test_a_seed_decides_everything(silvermate):
    def run(seed):
        plant = MujocoPlant(silvermate, limits_of(silvermate), seed=seed)
        out = [plant.step(Command(np.array([0.4, 0.3]), np.full(7, 0.1)), 0.01).drive for _ in range(40)]
        return np.concatenate([np.ravel(out), plant.coordinates])

    assert np.array_equal(run(1), run(1))
    assert not np.array_equal(run(1), run(2))


def test_wrong_commands_and_periods_are_refused(plant):
    with refused(ParameterError, "command"):
        plant.step(Command(np.zeros(3), np.zeros(7)), 0.01)
    with refused(ParameterError, "command"):
        plant.step(Command(np.array([0.0, np.nan]), np.zeros(7)), 0.01)
    with refused(ParameterError, "step"):
        plant.step(Command(np.zeros(2), np.zeros(7)), 0.0031)


def test_other_bases_are_refused(rover, silvermate, monkeypatch):
    limits = MotionLimits.for_robot(rover, joint_speed=1.0)
    with monkeypatch.context() as without, refused(ParameterError, "KinematicPlant"):
        without.setitem(sys.modules, "mujoco", None)  # nobody has to install it to hear that
        MujocoPlant(rover, limits)
    with refused(ParameterError, "timestep"):
        MujocoPlant(silvermate, limits_of(silvermate), timestep=0.05)
    narrow = MotionLimits.for_robot(silvermate, track=0.2)
    with refused(ParameterError, "track"):
        MujocoPlant(silvermate, narrow)
