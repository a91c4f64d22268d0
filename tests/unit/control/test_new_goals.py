"""Goals while the robot drives: another one at speed, several without a stop, cancelled ones, other speeds."""

from __future__ import annotations

from concurrent.futures import Future
from contextlib import suppress
from itertools import islice

import numpy as np
import pytest
from brute_force import configuration, link_distances
from cases import each, refused
from simulated_time import planning_at_once

from elastic_strips import load_robot
from elastic_strips.control import Controller, DriveParams, RunState
from elastic_strips.control.itinerary import faced, goals_in_order, passed_at
from elastic_strips.control.joining import curves_onto, steered
from elastic_strips.control.params import Tolerance
from elastic_strips.errors import ConfigurationError, ParameterError
from elastic_strips.planning import BasePose, HandPose, straight_line
from elastic_strips.scene import UNSEEN_LAYER, Box, Cylinder, Scene, Twist
from elastic_strips.sim import KinematicPlant, simulation
from elastic_strips.strip.deformer import Deformer
from elastic_strips.trajectory import MotionLimits, Retimer, RetimingError
from elastic_strips.trajectory.trajectory import ReferenceState

DT = 0.01
PILLAR = Box((0.3, 0.3, 1.0), at=(2.0, 1.5, 0.5), name="pillar")
ROBOTS = ("silvermate", "tiago_omni", "panda")


@pytest.fixture(scope="module")
def panda():
    return load_robot("panda")


def ride(robot, goal, **options):
    """A controller whose plans are made at once, and a simulated robot at its start."""
    workers = options.pop("workers", None) or planning_at_once()
    controller = Controller(robot, robot.home(), goal, Scene([PILLAR]), workers=workers, **options)
    plant = KinematicPlant(robot, controller.limits, seed=1)
    plant.reset(robot.space.to_coordinates(robot.home()))
    return Ride(controller, plant)


class Later:
    """Workers that plan when they are told to."""

    def __init__(self):
        self.jobs = []

    def submit(self, run, *args):
        self.jobs.append((Future(), run, args))
        return self.jobs[-1][0]

    def work(self):
        while self.jobs:
            future, run, args = self.jobs.pop(0)
            future.set_result(run(*args))


class Ride:
    def __init__(self, controller, plant):
        self.controller, self.plant, self.k, self.measured = controller, plant, 0, None
        self.speeds, self.places, self.scene = [], [], Scene([PILLAR])

    def until(self, true, seconds=60.0):
        """Drive until something is true; whether it came to be."""
        for _ in range(round(seconds / DT)):
            command = self.controller.step(self.k * DT, self.measured, self.scene)
            self.measured = self.plant.step(command, DT)
            self.k += 1
            self.speeds.append(float(np.abs(self.controller.reference.v).max()))
            self.places.append(self.controller.reference.coordinates.copy())
            if true():
                return True
        return False

    def wait(self, seconds):
        self.until(lambda: False, seconds)


@each("name, goal, other", [
    ("silvermate", BasePose(4.0, 0.0), BasePose(4.0, 1.5)),
    ("silvermate", BasePose(4.0, 0.0), BasePose(1.5, -2.5)),
    ("tiago_omni", BasePose(4.0, 0.0), BasePose(0.0, -3.0)),
], ids=["aside", "behind", "sideways"])  # fmt: skip
def test_another_goal_at_speed_is_driven_to_without_a_stop(request, name, goal, other):
    robot = request.getfixturevalue(name)
    driven = ride(robot, goal)
    driven.wait(1.6)
    assert driven.speeds[-1] > 0.5
    driven.controller.retarget(other)
    begun = len(driven.speeds)
    assert driven.until(lambda: driven.controller.ended), driven.controller.reason
    assert min(driven.speeds[begun:-100]) > 1e-3
    assert not driven.controller.stops
    np.testing.assert_allclose(driven.plant.coordinates[:2], (other.x, other.y), atol=0.06)
    assert [goal.passed for goal in driven.controller.goals_reached] == [False]


def test_an_arm_takes_another_goal_while_it_moves(panda):
    there, back = panda.home().copy(), panda.home().copy()
    there[0] += 1.2
    back[0] -= 0.8
    driven = ride(panda, there)
    driven.wait(0.5)
    assert driven.speeds[-1] > 0.3
    driven.controller.retarget(back)
    assert driven.until(lambda: driven.controller.ended, 20.0), driven.controller.reason
    np.testing.assert_allclose(driven.plant.coordinates, panda.space.to_coordinates(back), atol=0.05)


def test_goals_on_one_line_are_passed_within_the_tolerance(silvermate):
    goals = [silvermate.home(x=x) for x in (1.5, 3.0, 4.5)]
    fast, slow = ride(silvermate, goals), ride(silvermate, goals, params=DriveParams(stop_at_goals=True))
    for driven in (fast, slow):
        assert driven.until(lambda d=driven: d.controller.ended), driven.controller.reason
    assert [goal.passed for goal in fast.controller.goals_reached] == [True, True, False]
    assert [goal.passed for goal in slow.controller.goals_reached] == [False, False, False]
    assert min(fast.speeds[50:-100]) > 0.3
    assert fast.k < 0.85 * slow.k
    for goal, q in zip(fast.controller.goals_reached, goals, strict=True):
        off = np.abs(np.array(fast.places) - silvermate.space.to_coordinates(q)).max(axis=1)
        assert off.min() < 0.03
        assert goal.position <= 0.05
        assert goal.yaw <= 0.05


@each("name", ["silvermate", "tiago_omni"])
def test_a_patrol_flows(request, name):
    robot = request.getfixturevalue(name)
    goals = [BasePose(2.0, -0.6), BasePose(4.0, -0.4), BasePose(5.2, 1.2), BasePose(4.0, 2.8)]
    driven = ride(robot, goals)
    assert driven.until(lambda: driven.controller.ended), driven.controller.reason
    assert [goal.passed for goal in driven.controller.goals_reached] == [True, True, True, False]
    assert min(driven.speeds[50:-150]) > 1e-3
    for goal in goals:
        assert np.hypot(*(np.array(driven.places)[:, :2] - (goal.x, goal.y)).T).min() < 0.06


def test_a_goal_that_is_turned_at_is_reached_with_its_heading(silvermate):
    goals = [silvermate.home(x=2.0, y=-0.5, yaw=2.5), silvermate.home(x=4.0)]
    driven = ride(silvermate, goals)
    assert driven.until(lambda: driven.controller.ended), driven.controller.reason
    off = np.array(driven.places)[:, :3] - (2.0, -0.5, 2.5)
    off[:, 2] = np.abs(np.sin(0.5 * off[:, 2]))
    assert (np.hypot(off[:, 0], off[:, 1]) + off[:, 2]).min() < 0.08


def test_every_kind_of_goal(tiago_omni):
    hand = HandPose("arm_tool_link", (1.2, 0.2, 0.9))
    driven = ride(
        tiago_omni, [BasePose(1.0, -0.5), {"x": 2.0, "y": 0.0}, [BasePose(9.0, 9.0), BasePose(3.0, -0.5)], hand]
    )
    assert driven.until(lambda: driven.controller.ended), driven.controller.reason
    assert len(driven.controller.goals_reached) == 4
    where = tiago_omni.frame_pose(driven.controller.goal_q, "arm_tool_link")[:3, 3]
    np.testing.assert_allclose(where, hand.position, atol=1e-3)


def test_cancelled_it_comes_to_rest_and_takes_another_goal(silvermate):
    driven = ride(silvermate, [silvermate.home(x=2.0), silvermate.home(x=4.0)])
    driven.wait(1.0)
    driven.controller.cancel("nobody is there")
    assert not driven.controller.halted
    assert driven.until(lambda: driven.controller.halted, 5.0)
    assert driven.controller.state is RunState.STOPPED
    assert "nobody is there" in driven.controller.reason
    assert not driven.controller.ended
    stood = driven.plant.coordinates[0]
    driven.wait(1.0)
    assert driven.plant.coordinates[0] == pytest.approx(stood, abs=0.01)
    driven.controller.retarget(silvermate.home(x=0.5))
    assert driven.until(lambda: driven.controller.ended), driven.controller.reason


@each("latency", [2, 7])
def test_where_it_stands_too_near_to_plan_it_first_goes_back_the_way_it_came(silvermate, latency):
    """Within the tracking error of something no motion is certified: it may have been pushed there. So it is where
    planning takes longer than from one tick to the next."""
    driven = ride(silvermate, silvermate.home(x=6.0), params=DriveParams(latency=latency))
    driven.wait(1.6)
    driven.controller.stop()
    driven.wait(2.0)
    rests, planner = driven.controller.reference, driven.controller.planner

    def wall(ahead):
        at = (float(rests.coordinates[0]) + ahead, 0.0, 0.5)
        return Scene([PILLAR, Box((0.1, 3.0, 1.0), at=at, name="wall")])

    near, far = 0.4, 1.5
    while far - near > 1e-4:
        middle = 0.5 * (near + far)
        near, far = (middle, far) if planner.cramped(rests, wall(middle))[0] else (near, middle)
    driven.scene = wall(near - 0.008)
    driven.controller.resume()
    driven.controller.retarget(silvermate.home(y=-1.0))
    assert driven.until(lambda: driven.controller.ended, 40.0), driven.controller.reason
    assert [event for event in driven.controller.events if event.kind == "leaving" and "wall" in event.reason]
    assert max(place[0] for place in driven.places[360:]) < rests.coordinates[0] + 0.003


@each("why", ["reached", "cancelled", "speed"])
def test_where_it_is_to_stand_it_stays_however_near_something_is(silvermate, why):
    driven = ride(silvermate, silvermate.home(x=1.5))
    if why == "reached":
        assert driven.until(lambda: driven.controller.ended), driven.controller.reason
    else:
        driven.wait(1.2)
        {"cancelled": driven.controller.cancel, "speed": lambda: driven.controller.set_speed(0.0)}[why]()
        driven.wait(2.0)
    stands = driven.plant.coordinates[0]
    near = Box((0.1, 3.0, 1.0), at=(stands + 0.4, 0.0, 0.5), name="wall")
    driven.scene = Scene([PILLAR, near])
    driven.wait(3.0)
    assert driven.controller.planner.cramped(driven.controller.reference, driven.scene)[0]
    assert abs(driven.plant.coordinates[0] - stands) < 0.01
    assert not [event for event in driven.controller.events if event.kind == "leaving"]


def test_whoever_comes_too_near_is_not_backed_away_from(silvermate):
    """Somebody who walks into a robot that stands would be touched at speed."""
    driven = ride(silvermate, silvermate.home(x=6.0))
    state, planner = driven.controller.reference, driven.controller.planner
    for motion in (None, Twist((0.0, 0.1, 0.0))):
        scene = Scene([Box((0.4, 0.4, 1.0), at=(0.45, 0.0, 0.5), name="somebody", motion=motion)], time=0.0)
        assert bool(planner.cramped(state, scene)[0]) == (motion is None)


@each("beside, left", [(False, False), (True, True)])
def test_where_somebody_may_be_that_nothing_sees_is_waited_for(silvermate, beside, left):
    """It is over soon, and no reason to go where nothing looks; what stands there besides is."""
    driven = ride(silvermate, silvermate.home(x=6.0))
    state, planner = driven.controller.reference, driven.controller.planner
    obstacles = [Box((0.4, 0.4, 1.0), at=(0.45, 0.0, 0.5), name="unseen-track-3")]
    if beside:
        obstacles.append(Box((0.4, 0.4, 1.0), at=(0.5, 0.0, 0.5), name="crate"))
    assert bool(planner.cramped(state, Scene(obstacles))[0]) is left


def test_it_does_not_back_off_to_where_somebody_comes(silvermate):
    """Whoever may come as near as its clearance meanwhile is not what it leaves, however near that is."""
    driven = ride(silvermate, silvermate.home(x=6.0))
    driven.wait(2.0)
    planner, begin = driven.controller.planner, driven.controller.reference
    motion = driven.controller.executor.active.tail(begin.time)
    ahead = begin.coordinates[0]
    wall = Box((0.1, 0.1, 1.0), at=(ahead - 0.4, 0.0, 0.5), name="wall")
    refuted = []
    for far in np.linspace(0.4, 3.0, 27):
        somebody = Cylinder(0.25, 1.7, at=(ahead + far, 0.0, 0.85), name="somebody", motion=Twist((-0.3, 0.0, 0.0)))
        among = Scene([wall, somebody], time=begin.time)
        refuted.append(not planner.certify_leaving(motion, among).certified)
        alone = planner.certify(motion, among.without("wall")).certified
        assert refuted[-1] or alone, f"{far:.1f} m ahead"
    assert refuted[0]
    assert not refuted[-1]


@each("off, next_off, moves, free", [(1.1, 1.1, False, True), (1.1, 1.1, True, False), (0.4, 1.1, False, True),
                                     (0.4, 0.5, False, False)])  # fmt: skip
def test_a_wall_of_several_obstacles_is_left_like_one(silvermate, off, next_off, moves, free):
    """The robot stands a little too near to it, and drives along it: the next part of it is as near. Nearer than what
    it may be off its path nothing may come, and what may move keeps all of the distance."""
    driven = ride(silvermate, silvermate.home(x=6.0))
    driven.wait(2.0)
    planner, begin = driven.controller.planner, driven.controller.reference
    motion = driven.controller.executor.active.tail(begin.time)
    (first, last), error = motion.coordinates[[0, -1], 0], planner.margins.tracking_error
    assert last - first > 0.3
    face = Box((0.1, 0.1, 3.0), at=(first, 1.0, 1.5))
    beside = float(link_distances(silvermate, Scene([face]), configuration(silvermate, begin.coordinates)).min())
    assert 1.1 * error < planner.margins.clearance

    def part(name, x0, x1, near, **how):
        at = (0.5 * (x0 + x1), 1.0 - beside + near, 1.5)
        return Box((x1 - x0, 0.1, 3.0), at=at, name=name, **how)

    middle = first + 0.5 * (last - first)
    end = last + 1.0
    motions = {"motion": Twist((0.0, 0.0, 0.0))} if moves else {}
    near = part("map-0-0", first - 1.0, middle, off * error)
    scene = Scene([near, part("map-1-0", middle, end, next_off * error, **motions)], time=begin.time)
    assert planner.cramped(begin, Scene([near], time=begin.time))[0]
    assert not planner.certify(motion, scene).certified
    assert planner.certify_leaving(motion, scene).certified is free


@each("stop", ["stop", "cancel", "speed"])
def test_what_appears_while_it_comes_to_rest_is_looked_at(silvermate, stop):
    """Whatever is said to it, the motion that it ends on was certified for another scene."""
    ends = []
    for seen in (False, True):
        driven = ride(silvermate, silvermate.home(x=6.0))
        driven.wait(1.6)
        {"stop": driven.controller.stop, "cancel": driven.controller.cancel,
         "speed": lambda d=driven: d.controller.set_speed(0.0)}[stop]()  # fmt: skip
        if seen:
            wall = Box((0.1, 3.0, 1.0), at=(driven.places[-1][0] + 0.85, 0.0, 0.5), name="wall")
            driven.scene = Scene([PILLAR, wall])
        driven.wait(2.0)
        assert driven.speeds[-1] == 0.0
        ends.append(driven.plant.coordinates[0])
        assert seen == any("wall" in event.reason for event in driven.controller.events)
    assert ends[1] < ends[0] - 0.02


def test_it_drives_as_slowly_as_it_is_told(silvermate):
    driven = ride(silvermate, silvermate.home(x=6.0))
    driven.wait(1.5)
    driven.controller.set_speed(0.4)
    driven.wait(1.5)
    top = float(driven.controller.limits.drive_speed.max())
    assert max(driven.speeds[-50:]) <= 0.4 * top + 0.01
    driven.controller.set_speed(0.0)
    driven.wait(2.0)
    assert driven.speeds[-1] == 0.0
    assert "speed" in driven.controller.reason
    driven.controller.set_speed(1.0)
    assert driven.until(lambda: driven.controller.ended), driven.controller.reason
    assert max(driven.speeds[-400:]) > 0.7 * top
    for wrong in (-0.1, 1.5, float("nan")):
        with refused(ParameterError, repr(wrong)):
            driven.controller.set_speed(wrong)


def test_a_new_goal_that_nobody_can_reach_stops_it_and_says_why(silvermate):
    driven = ride(silvermate, silvermate.home(x=6.0))
    driven.wait(1.5)
    driven.controller.retarget(BasePose(2.0, 1.5))
    assert driven.until(lambda: driven.controller.executor.at_rest(driven.controller.time), 5.0)
    driven.wait(0.2)
    assert driven.controller.state is RunState.STOPPED
    assert "pillar" in driven.controller.reason
    assert not driven.controller.goals_reached


def test_the_goal_before_is_never_called_reached(silvermate):
    """The active motion ends there when another goal comes, and the plan to that one takes its time."""
    later = Later()
    driven = ride(silvermate, silvermate.home(x=1.5), workers=later)
    controller = driven.controller
    assert driven.until(lambda: controller.executor.at_goal, 5.0)
    controller.retarget(silvermate.home(x=3.0))
    assert driven.until(lambda: controller.executor.at_rest(controller.time), 5.0)
    driven.wait(0.5)
    assert controller.state is not RunState.REACHED
    assert not controller.goals_reached
    later.work()
    assert driven.until(lambda: bool(later.jobs) or controller.ended, 5.0)
    later.work()  # once more, from where it stands
    assert driven.until(lambda: controller.ended, 20.0), controller.reason
    assert driven.plant.coordinates[0] == pytest.approx(3.0, abs=0.06)


def test_another_goal_in_the_moment_in_which_one_is_passed(silvermate):
    """The motion goes on to the next of the goals that there were, while the plan to the new one takes its time."""
    later = Later()
    driven = ride(silvermate, [silvermate.home(x=1.5), silvermate.home(x=3.0)], workers=later)
    controller = driven.controller
    assert driven.until(lambda: bool(later.jobs), 5.0)
    later.work()
    assert driven.until(lambda: 1.5 - controller.reference.coordinates[0] < 0.08, 10.0)
    controller.retarget(BasePose(3.0, 1.0))
    assert driven.until(lambda: controller.reference.coordinates[0] > 1.6, 2.0), "it drives on"
    later.work()
    assert driven.until(lambda: controller.ended, 30.0), controller.reason
    assert [event.reason for event in controller.events if event.kind == "fault"] == []
    assert len(controller.goals_reached) == 1
    np.testing.assert_allclose(driven.plant.coordinates[:2], (3.0, 1.0), atol=0.06)


def test_a_drive_has_what_it_reached(silvermate):
    goals = [silvermate.home(x=1.5), silvermate.home(x=3.0)]
    result = simulation(silvermate, Scene([]), silvermate.home(), goals, seed=1).run()
    assert [goal.passed for goal in result.goals] == [True, False]
    np.testing.assert_allclose(result.record.goal, silvermate.space.to_coordinates(goals[-1]))


def test_goals_in_order(silvermate):
    q = silvermate.home(x=1.0)
    assert len(goals_in_order(silvermate, q)) == len(goals_in_order(silvermate, q.tolist())) == 1
    assert len(goals_in_order(silvermate, np.stack([q, q, q]))) == 3
    place = BasePose(1.0, 0.0)
    assert goals_in_order(silvermate, place) == [place]
    assert goals_in_order(silvermate, [place, [place, place]]) == [place, [place, place]]
    with refused(ConfigurationError, "empty"):
        goals_in_order(silvermate, [])
    with pytest.raises(ConfigurationError):
        goals_in_order(silvermate, [place, [1.0, 2.0]])


def test_any_heading_is_that_of_arrival(silvermate, tiago_omni):
    here = silvermate.space.to_coordinates(silvermate.home())
    turned = faced(silvermate, here, BasePose(0.0, -2.0))
    assert isinstance(turned, BasePose)
    assert turned.yaw == pytest.approx(-0.5 * np.pi)
    for goal in (BasePose(0.0, -2.0, 1.0), BasePose(0.01, 0.0), silvermate.home(x=1.0)):
        assert faced(silvermate, here, goal) is goal
    other = tiago_omni.space.to_coordinates(tiago_omni.home())
    assert faced(tiago_omni, other, BasePose(0.0, -2.0)) == BasePose(0.0, -2.0)


def test_where_a_goal_is_passed(silvermate):
    goal = silvermate.space.to_coordinates(silvermate.home(x=1.0))
    rows = np.tile(goal, (21, 1))
    rows[:, 0] = np.linspace(0.0, 2.0, 21)
    assert passed_at(silvermate, rows, goal, Tolerance()) == 10
    assert passed_at(silvermate, rows[:11], goal, Tolerance()) is None, "it ends there"
    rows[:, 2] = 0.3
    assert passed_at(silvermate, rows, goal, Tolerance()) is None
    assert passed_at(silvermate, rows, goal, Tolerance(yaw=np.inf)) == 10


def states(robot, count):
    """Velocities of a robot at home, and strips to somewhere else."""
    rng, limits, home = np.random.default_rng(7), MotionLimits.for_robot(robot), robot.home()
    for _ in range(count):
        rate = rng.uniform(-0.5, 0.5, limits.drive_dim + len(limits.joint_speed)) * limits.speed
        if limits.drive_dim == 2:
            rate = np.concatenate([rng.uniform(0.2, 0.9) * (1.0 + rng.uniform(-0.1, 0.1, 2)), 0.0 * rate[2:]])
        elif limits.drive_dim:
            rate[3:] = 0.0
        else:
            rate *= 0.3
        goal = home.copy()
        if limits.drive_dim:
            goal = robot.home(*rng.uniform(-3.0, 3.0, 2), rng.uniform(-3.0, 3.0))
        else:
            goal[: len(goal) // 2] += rng.uniform(-1.5, 1.5, len(goal) // 2)
        goal = robot.space.from_coordinates(
            np.clip(robot.space.to_coordinates(goal), robot.space.lower, robot.space.upper)
        )
        rows = (
            robot.space.to_coordinates(straight_line(robot, home, goal, spacing=0.15))
            if False
            else straight_line(robot, home, goal, spacing=0.15)
        )
        yield limits, robot.space.to_coordinates(home), limits.to_tangent(rate), np.asarray(rows)


@each("name", ROBOTS)
def test_motions_that_turn_towards_a_strip_keep_the_limits_and_end_at_rest(request, name):
    robot = request.getfixturevalue(name)
    weight = Deformer(robot, DriveParams().strip).spacing_weight
    for limits, here, v, rows in states(robot, 20):
        start = ReferenceState(3.0, here, v, np.zeros(robot.nv))
        motion = steered(robot, limits, start, rows, weight, hold=0.4, dt=0.02)
        if motion is None:  # a joint would have left its range
            assert not limits.drive_dim
            continue
        assert motion.start_time == 3.0
        assert motion.at_rest_at_end
        np.testing.assert_allclose(motion.coordinates[0], here)
        np.testing.assert_allclose(motion.v[0], v, atol=1e-12)
        rates = limits.to_coordinates(motion.v)
        change = np.abs(np.diff(rates, axis=0)) / np.diff(motion.time)[:, None]
        assert (change <= limits.acceleration * 1.001).all()
        if limits.drive_dim == 2:
            assert not motion.v[:, 1].any(), "no wheel slides"


@each("name", ROBOTS)
def test_curves_begin_with_the_velocity_and_end_on_the_strip(request, name):
    robot = request.getfixturevalue(name)
    space, weight = robot.space, Deformer(robot, DriveParams().strip).spacing_weight
    timed = found = 0
    for limits, here, v, rows in states(robot, 40):
        retimer = Retimer(robot, limits, dt=0.02)
        curves = list(islice(curves_onto(robot, limits, here, v, rows, weight), 4))
        found += bool(curves)
        drivable = False
        for curve, rest in curves:
            np.testing.assert_allclose(curve[0], here, atol=1e-9)
            np.testing.assert_allclose(space.difference(curve[-1], rest[0]), 0.0, atol=1e-9)
            np.testing.assert_allclose(space.difference(rest[-1], rows[-1]), 0.0, atol=1e-9)
            way, along = limits.to_coordinates(space.difference(here, curve[1])), limits.to_coordinates(v)
            assert way @ along > 0.9 * np.linalg.norm(way) * np.linalg.norm(along)
            with suppress(RetimingError):
                retimer.horizon(np.vstack([curve, rest[1:]]), v, distance=1.0)
                drivable = True
        timed += drivable
    assert found >= 10
    assert timed >= 0.6 * found


def test_a_goal_that_turns_out_to_be_taken_is_reached_another_way(silvermate):
    drive = ride(silvermate, HandPose("hand_frame", (3.0, 0.0, 0.9)), seed=1)
    first = drive.controller.goal_q.copy()
    taken = Box((0.2, 0.2, 0.4), at=(float(first[0]), float(first[1]), 0.2), name="taken")
    assert drive.until(lambda: drive.places[-1][0] > 0.2)
    drive.scene = Scene([PILLAR, taken])  # where the base was to stand
    assert drive.until(lambda: drive.controller.ended)
    hand = silvermate.frame_pose(drive.controller.goal_q, "hand_frame")[:3, 3]
    assert np.allclose(hand, (3.0, 0.0, 0.9), atol=0.02)
    assert np.hypot(*(drive.controller.goal_q[:2] - first[:2])) > 0.2


def test_what_was_not_seen_is_planned_through_and_not_driven_through(silvermate, brief):
    unseen = Box((0.4, 12.0, 1.5), at=(2.0, 0.0, 0.75), name=f"{UNSEEN_LAYER}-5-0-0")  # there is no way around
    drive = ride(silvermate, silvermate.home(4.0, 0.0, 0.0))
    drive.scene = Scene([unseen])
    drive.wait(6.0 if brief else 12.0)
    assert not drive.controller.ended
    assert 0.5 < drive.places[-1][0] < 1.8
    drive.scene = Scene([])  # it was looked at
    assert drive.until(lambda: drive.controller.ended)


def test_a_goal_that_is_taken_in_every_way_is_waited_for(silvermate):
    drive = ride(silvermate, HandPose("hand_frame", (3.0, 0.0, 0.9)), seed=1)
    assert drive.until(lambda: drive.places[-1][0] > 0.2)
    drive.scene = Scene([PILLAR, Box((0.3, 0.3, 0.3), at=(3.0, 0.0, 0.9), name="taken")])  # where the hand is to be
    assert not drive.until(lambda: drive.controller.ended, 8.0)
    assert drive.controller.replans + sum(e.kind == "replanned" for e in drive.controller.events) > 0
    drive.scene = Scene([PILLAR])
    assert drive.until(lambda: drive.controller.ended)


def test_it_looks_at_its_goal_from_where_that_is_in_sight(silvermate):
    """Something seems to stand where the hand is to be, and a wall before it: what is behind that is not seen from the
    nearest place about it."""
    hand = HandPose("hand_frame", (3.2, 0.0, 0.9))
    drive = ride(silvermate, hand, seed=1)
    taken = Box((0.3, 0.3, 0.3), at=(3.2, 0.0, 0.9), name="taken")
    wall = Box((0.1, 1.4, 1.8), at=(2.6, 0.0, 0.9), name="wall")
    unseen = Box((0.1, 0.1, 0.1), at=(3.2, 0.0, 1.3), name=f"{UNSEEN_LAYER}-8-0-3")  # sensors see what is free
    drive.scene = Scene([PILLAR, taken, wall, unseen])
    assert drive.until(lambda: any(e.kind == "looking" for e in drive.controller.events), 30.0)
    assert drive.controller.keeper.looks
    x, y = drive.controller.keeper.goal[:2]
    assert 1.0 < np.hypot(x - 3.2, y) < 1.6
    crossing = np.array([y, 0.0]) @ np.array([(3.2 - 2.6), 0.0]) / (3.2 - x) if x < 2.6 else np.inf
    assert abs(crossing) > 0.7, "the wall is not between the two"


def test_who_has_looked_from_all_places_in_vain_does_so_again_later(silvermate):
    """What is in the way may go, and what hid it, too."""
    drive = ride(silvermate, HandPose("hand_frame", (3.2, 0.0, 0.9)), seed=1)
    taken = Box((0.3, 0.3, 0.3), at=(3.2, 0.0, 0.9), name="taken")
    unseen = Box((0.1, 0.1, 0.1), at=(3.2, 0.0, 1.3), name=f"{UNSEEN_LAYER}-8-0-3")
    drive.scene = Scene([PILLAR, taken, unseen])

    places: list[tuple[float, np.ndarray]] = []

    def note():
        keeper = drive.controller.keeper
        if keeper.looks and not (places and np.array_equal(places[-1][1], keeper.goal)):
            places.append((drive.k * DT, keeper.goal))
        return False

    drive.until(note, 100.0)
    times = np.array([t for t, _ in places])
    pauses = np.flatnonzero(np.diff(times) > 20.0)  # no place is tried
    assert len(pauses) >= 1
    assert pauses[0] >= 1, "it has looked from several before"
    assert len(times) - 1 - pauses[0] >= 2, "and looks from several after"


def test_where_no_way_leads_to_one_way_to_be_there_one_to_another_is_planned(silvermate):
    """A low wall comes up around where the base was to stand; the hand reaches its goal from beside that, too."""
    hand = HandPose("hand_frame", (4.0, 0.0, 0.8))
    controller = Controller(silvermate, silvermate.home(), hand, Scene([], time=0.0), workers=planning_at_once())
    x, y = controller.goal[:2]
    walls = [Box((1.5, 0.1, 0.3), at=(x, y + side * 0.7, 0.15), name=f"along{side:+d}") for side in (-1, 1)]
    walls += [Box((0.1, 1.5, 0.3), at=(x + side * 0.7, y, 0.15), name=f"across{side:+d}") for side in (-1, 1)]
    plant = KinematicPlant(silvermate, controller.limits, seed=1)
    plant.reset(silvermate.space.to_coordinates(silvermate.home()))
    measured = None
    for k in range(6000):
        scene = Scene(walls if k > 50 else [], time=k * DT)
        measured = plant.step(controller.step(k * DT, measured, scene), DT)
        if controller.ended:
            break
    assert controller.ended, controller.reason
    assert np.abs(plant.coordinates[:2] - (x, y)).max() > 0.7, "outside the walls"
    assert controller.reached == 1
