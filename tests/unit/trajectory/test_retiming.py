"""Retiming: as fast as the limits allow, never faster, from where the robot is to where it is to go."""

from __future__ import annotations

import numpy as np
import pytest
from cases import each, each_robot, refused
from drivable import arcs, distance_from_strip, limits_of, most_used, motor_travel
from hypothesis import given, settings
from hypothesis import strategies as st

from elastic_strips.errors import ConfigurationError, ParameterError
from elastic_strips.planning import straight_line
from elastic_strips.robot import RobotModel
from elastic_strips.strip import Strip
from elastic_strips.strip.solver import project_rolling
from elastic_strips.trajectory import retiming
from elastic_strips.trajectory.limits import MotionLimits
from elastic_strips.trajectory.path import RetimingError
from elastic_strips.trajectory.retiming import Retimer, retime
from elastic_strips.trajectory.speed_profile import Profile
from elastic_strips.trajectory.trajectory import Trajectory

ROBOTS = ["silvermate", "tiago", "rover", "gantry"]


def sound(motion: Trajectory, limits: MotionLimits, *, speed: float = 1.0) -> None:
    """What every trajectory keeps."""
    used, changed = most_used(motion, limits)
    assert used <= speed * (1.0 + 1e-3) + 1e-9
    assert changed <= 1.0 + 1e-3 + 1e-9
    assert motion.at_rest_at_end
    assert not motion.a[-1].any()
    if limits.drive_dim == 2:
        assert np.abs(motion.steps[:, 1]).max() <= 1e-9
        assert not motion.v[:, 1].any()


def ends_at(motion: Trajectory, node: np.ndarray, within: float = 1e-3) -> bool:
    return bool(np.abs(motion.robot.space.difference(motion.coordinates[-1], node)).max() <= within)


def straight(robot: RobotModel, length: float = 4.0, **goal: float) -> np.ndarray:
    return straight_line(robot, robot.home(), robot.home(x=length, **goal), spacing=0.15)


def noisy(robot: RobotModel, seed: int) -> np.ndarray:
    nodes = arcs(robot, seed)
    if robot.space.planar:
        nodes[1:-1, :2] += 0.004 * np.random.default_rng(seed).normal(size=(len(nodes) - 2, 2))
    if robot.base_kind.value == "diff_drive":
        nodes, residual = project_rolling(robot.space, nodes)
        assert residual < 1e-8
    return nodes


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    name=st.sampled_from(ROBOTS),
    seed=st.integers(0, 10_000),
    rough=st.booleans(),
    speed=st.sampled_from([1.0, 0.4]),
)
def test_whole_strips(request, name, seed, rough, speed):
    robot = request.getfixturevalue(name)
    limits = limits_of(robot)
    nodes = noisy(robot, seed) if rough else arcs(robot, seed, step=0.1 + 1e-5 * seed)
    motion = retime(Strip.from_coordinates(robot, nodes), limits, speed=speed)
    sound(motion, limits, speed=speed)
    np.testing.assert_array_equal(motion.coordinates[0], nodes[0])
    assert ends_at(motion, nodes[-1], 2e-3)
    assert not motion.v[0].any()
    np.testing.assert_allclose(np.diff(motion.time), 0.01, atol=1e-12)
    assert max(most_used(motion, limits)) > 0.9 * speed, "it uses what there is"
    base, yaw, joints = distance_from_strip(robot, motion.coordinates[::5], nodes)
    assert base < 0.02
    assert max(yaw, joints) < 0.12


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    name=st.sampled_from(ROBOTS), seed=st.integers(0, 10_000), part=st.floats(0.05, 0.95), distance=st.floats(0.3, 1.5)
)
def test_going_on_from_a_state(request, name, seed, part, distance):
    """From any state of a motion, along the nodes ahead: no jump in velocity, no broken limit."""
    robot = request.getfixturevalue(name)
    limits = limits_of(robot)
    retimer = Retimer(robot, limits.scaled(1.0, 0.9))
    nodes = arcs(robot, seed)
    motion = retimer.horizon(nodes, distance=2.0)
    t = part * motion.duration
    state = motion.at(t)
    ahead = nodes_ahead(robot, state.coordinates, nodes)
    try:
        after = Retimer(robot, limits).horizon(
            ahead, state.v, a_start=state.a, distance=distance, start_time=t
        )  # fmt: skip
    except RetimingError:
        stop = retimer.brake(motion, t)
        assert stop.at_rest_at_end
        return
    sound(after, limits)
    np.testing.assert_array_equal(after.coordinates[0], state.coordinates)
    assert after.start_time == t
    np.testing.assert_allclose(np.diff(after.time), 0.01, atol=1e-9)
    jump = motor_travel(robot, limits, after.v[0] - state.v)
    assert (np.abs(jump) <= 1e-3 * limits.speed).all()


@settings(max_examples=15, deadline=None, derandomize=True)
@given(name=st.sampled_from(ROBOTS), seed=st.integers(0, 10_000), most=st.sampled_from([0.2, 0.7]))
def test_a_base_turns_no_faster_than_it_may(request, name, seed, most):
    robot = request.getfixturevalue(name)
    limits, nodes = limits_of(robot), arcs(robot, seed)
    free, slow = (Retimer(robot, limits, turn_speed=turn_speed) for turn_speed in (np.inf, most))
    motion = free.full(nodes)
    capped = slow.full(nodes)
    sound(capped, limits)
    assert ends_at(capped, nodes[-1], 2e-3)
    if not robot.space.base_nv:
        np.testing.assert_array_equal(capped.coordinates, motion.coordinates)
        return
    assert np.abs(capped.v[:, 2]).max() < 1.1 * most
    assert capped.duration > motion.duration or np.abs(motion.v[:, 2]).max() < 1.1 * most


def test_who_turns_too_fast_already_is_braked_to_what_it_may(silvermate):
    turning = [silvermate.space.to_coordinates(silvermate.home(yaw=yaw)) for yaw in np.linspace(0.0, 3.0, 16)]
    fast = Retimer(silvermate).full(turning)
    state = fast.at(0.4 * fast.duration)
    assert abs(state.v[2]) > 1.5
    ahead = nodes_ahead(silvermate, state.coordinates, np.array(turning))
    after = Retimer(silvermate, turn_speed=0.5).horizon(ahead, state.v, a_start=state.a, start_time=0.0)
    sound(after, MotionLimits.for_robot(silvermate))
    turn = np.abs(after.v[:, 2])
    assert turn[0] == pytest.approx(abs(state.v[2]), rel=1e-3)
    assert turn[after.time > 1.0].max() < 0.52
    with pytest.raises(ParameterError):
        Retimer(silvermate, turn_speed=0.0)


def nodes_ahead(robot: RobotModel, coordinates: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """The state, then the nodes after the nearest segment."""
    v = robot.space.difference(nodes[:-1], nodes[1:])
    middle = robot.space.integrate(nodes[:-1], 0.5 * v)
    gap = robot.space.difference(np.broadcast_to(coordinates, middle.shape).copy(), middle)
    return np.vstack([coordinates, nodes[int(np.argmin((gap**2).sum(axis=1))) + 1 :]])


@each("name", ["silvermate", "tiago", "rover"])
def test_replanning_all_the_way(name, request):
    """Ten times a second, 1 m ahead, with a reserve of acceleration: it gets there, about as fast as in one go."""
    robot = request.getfixturevalue(name)
    limits = limits_of(robot)
    easy, full = Retimer(robot, limits.scaled(1.0, 0.9)), Retimer(robot, limits)
    failed = tried = 0
    for seed in range(3):
        nodes = arcs(robot, seed)
        motion = easy.horizon(nodes, distance=1.0)
        t, driven = 0.0, [motion.coordinates[0]]
        while not ends_at(motion, nodes[-1], 2e-3):
            t = round(t + 0.1, 9)
            state = motion.at(t)
            driven.append(state.coordinates)
            ahead = nodes_ahead(robot, state.coordinates, nodes)
            tried += 1
            for retimer in (easy, full):
                try:
                    new = retimer.horizon(ahead, state.v, a_start=state.a, distance=1.0, start_time=t)
                except RetimingError:
                    continue
                jump = motor_travel(robot, limits, new.v[0] - state.v)
                assert (np.abs(jump) <= 1e-3 * limits.speed).all()
                sound(new, limits)
                motion = new
                break
            else:
                failed += 1
            assert t < 60.0
        whole = easy.full(nodes)
        assert motion.end_time < 1.1 * whole.end_time + 0.2
        assert distance_from_strip(robot, np.array(driven), nodes)[0] < 0.02
    assert failed < 0.05 * tried


@each_robot
def test_a_horizon_ends_at_its_distance(robot):
    limits = limits_of(robot)
    nodes = arcs(robot, 2)
    motion = Retimer(robot, limits).horizon(nodes, distance=0.2)
    sound(motion, limits)
    retimer = Retimer(robot, limits)
    travel = motor_travel(robot, limits, motion.steps) * retimer.weight
    assert np.linalg.norm(travel, axis=1).sum() == pytest.approx(0.2, rel=0.02)
    assert distance_from_strip(robot, motion.coordinates[-1:], nodes)[0] < 1e-3


def test_it_goes_farther_where_it_cannot_stop(silvermate, monkeypatch):
    tried, honest = [], retiming.fastest
    monkeypatch.setattr(retiming, "fastest", lambda *arguments: tried.append(1) or honest(*arguments))
    limits = limits_of(silvermate)
    nodes = straight(silvermate)
    v = np.zeros(10)
    v[0] = 0.9
    motion = Retimer(silvermate).horizon(nodes, v, distance=0.05)
    sound(motion, limits)
    needed = 0.9**2 / 2.4
    assert needed <= motion.coordinates[-1, 0] <= 1.35 * needed
    assert len(tried) <= 2, "it begins with the way that it takes to brake"
    np.testing.assert_allclose(motion.v[0], v, atol=1e-12)
    with refused(RetimingError, "0.33"):
        Retimer(silvermate).horizon(straight(silvermate, 0.3), v)


def test_a_start_faster_than_asked_is_braked(silvermate, tiago):
    for robot in (silvermate, tiago):
        limits = limits_of(robot)
        retimer = Retimer(robot, limits)
        nodes = arcs(robot, 4)
        motion = retimer.horizon(nodes)
        t = float(motion.time[int(np.argmax(motion.v[:, 0]))])
        state = motion.at(t)
        assert state.v[0] > 0.8
        slower = retimer.horizon(
            nodes_ahead(robot, state.coordinates, nodes), state.v, a_start=state.a, speed=0.4, start_time=t
        )
        sound(slower, limits)
        np.testing.assert_allclose(slower.v[0], state.v, atol=1e-3)
        rims = np.abs(limits.to_drive(slower.v[:, :3])).max(axis=1)
        late = slower.time > t + 2.0 * (rims[0] - 0.4) / 1.2
        assert late.any()
        assert rims[late].max() <= 0.4 * 1.001
        assert rims.max() <= rims[0] + 1e-3


def test_a_cusp_ends_a_horizon_and_is_passed_by_the_whole(silvermate):
    limits = limits_of(silvermate)
    nodes = arcs(silvermate, 1, nodes=20)
    back = nodes[-1:].repeat(8, axis=0)
    v = np.zeros((8, 10))
    v[:, 0], v[:, 2] = -0.12 * np.arange(1, 9), 0.05 * np.arange(1, 9)
    nodes = np.vstack([nodes, silvermate.space.integrate(back, v)])
    motion = Retimer(silvermate).horizon(nodes)
    sound(motion, limits)
    assert ends_at(motion, nodes[19])
    whole = Retimer(silvermate).full(nodes)
    sound(whole, limits)
    assert ends_at(whole, nodes[-1])
    rest = np.flatnonzero(~whole.v.any(axis=1))
    assert len(rest) == 3, "start, cusp, end"
    assert np.abs(silvermate.space.difference(whole.coordinates[rest[1]], nodes[19])).max() < 1e-3
    assert (whole.v[: rest[1], 0] >= 0.0).all()
    assert (whole.v[rest[1] :, 0] <= 0.0).all()


def test_turning_in_place_and_driving(silvermate):
    limits = limits_of(silvermate)
    goal = silvermate.home(x=1.0, y=1.0, yaw=-1.0)
    nodes = straight_line(silvermate, silvermate.home(), goal, spacing=0.15)
    motion = Retimer(silvermate).full(nodes)
    sound(motion, limits)
    assert ends_at(motion, nodes[-1])
    assert len(np.flatnonzero(~motion.v.any(axis=1))) == 4
    first = Retimer(silvermate).horizon(nodes)
    assert np.abs(first.v[:, 0]).max() < 1e-9, "in place"
    assert first.coordinates[-1, 2] == pytest.approx(np.pi / 4, abs=1e-6)
    assert np.abs(first.limits.to_drive(first.v[:, :3])).max() > 0.4


@each_robot
def test_joints_only(robot):
    limits = limits_of(robot)
    nodes = np.tile(robot.space.to_coordinates(robot.home_q), (6, 1))
    first = robot.space.base_nv
    nodes[:, first:] = nodes[:, first:] + np.linspace(0.0, 0.1, 6)[:, None]
    motion = Retimer(robot, limits).full(nodes)
    sound(motion, limits)
    assert ends_at(motion, nodes[-1], 1e-9)
    np.testing.assert_array_equal(
        motion.coordinates[:, :first], np.broadcast_to(nodes[0, :first], (len(motion), first))
    )


@each_robot
def test_duplicate_nodes_change_nothing(robot):
    """toppra would add a stop at each."""
    limits = limits_of(robot)
    nodes = arcs(robot, 2, nodes=15)
    plain = Retimer(robot, limits).full(nodes)
    doubled = Retimer(robot, limits).full(np.repeat(nodes, [3, 1, 2, 2, *[1] * 9, 2, 3], axis=0))
    np.testing.assert_allclose(doubled.coordinates, plain.coordinates, atol=1e-9)
    assert len(np.flatnonzero(~doubled.v.any(axis=1))) == len(np.flatnonzero(~plain.v.any(axis=1)))


@each_robot
def test_standing_still(robot):
    limits = limits_of(robot)
    node = robot.space.to_coordinates(robot.home_q)
    for nodes in (node[None], np.stack([node] * 4)):
        for motion in (Retimer(robot, limits).horizon(nodes, start_time=5.0), Retimer(robot, limits).full(nodes)):
            assert motion.at_rest_at_end
            assert not motion.v.any()
            np.testing.assert_array_equal(motion.coordinates, np.stack([node] * 2))
            assert motion.duration == pytest.approx(0.01)
        moving = np.zeros(robot.nv)
        moving[-1] = 0.1
        with refused(RetimingError, "0 m"):
            Retimer(robot, limits).horizon(nodes, moving)


def test_very_short_ways(silvermate):
    for length in (1e-5, 1e-3, 0.02):
        nodes = straight(silvermate, length)
        motion = Retimer(silvermate).full(nodes)
        sound(motion, limits_of(silvermate))
        assert ends_at(motion, nodes[-1], 1e-9)
        assert motion.duration < 2.1 * np.sqrt(length / 1.2) + 0.02


def test_dense_nodes(silvermate):
    """The samples of a motion, a centimetre apart and less, are a strip like any other."""
    motion = Retimer(silvermate).full(arcs(silvermate, 6))
    again = retime(motion.strip())
    sound(again, limits_of(silvermate))
    assert ends_at(again, motion.coordinates[-1])
    assert distance_from_strip(silvermate, again.coordinates[::7], motion.coordinates)[0] < 0.01


def test_yaw_may_pass_pi(silvermate):
    nodes = arcs(silvermate, 2)
    nodes[:, 2] += 3.0
    nodes[:, :2] = nodes[:, :2] @ np.array([[np.cos(3.0), np.sin(3.0)], [-np.sin(3.0), np.cos(3.0)]])
    wrapped = nodes.copy()
    wrapped[:, 2] = (wrapped[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    assert (np.abs(np.diff(wrapped[:, 2])) > 3.0).any()
    one, other = Retimer(silvermate).full(nodes), Retimer(silvermate).full(wrapped)
    np.testing.assert_allclose(other.coordinates, one.coordinates, atol=1e-9)
    assert np.abs(np.diff(other.coordinates[:, 2])).max() < 0.1


@each(
    "arguments, error, match",
    [
        ({"coordinates": np.zeros((3, 4))}, ConfigurationError, r"\(n, 10\)"),
        ({"coordinates": np.zeros((0, 10))}, ConfigurationError, "empty"),
        ({"coordinates": np.full((3, 10), np.nan)}, ConfigurationError, r"\[0, 0\] is nan"),
        ({"v_start": np.zeros(3)}, ParameterError, "v_start"),
        ({"v_start": np.full(10, np.inf)}, ParameterError, "v_start"),
        ({"a_start": np.full(10, np.nan)}, ParameterError, "a_start"),
        ({"v_start": [0.3, 0.1, *[0.0] * 8]}, ParameterError, "sideways"),
        ({"v_start": [1.2, 0.0, *[0.0] * 8]}, RetimingError, "the limit is 1"),
        ({"v_start": [-0.5, 0.0, *[0.0] * 8]}, RetimingError, "75°"),
        ({"distance": 0.0}, ParameterError, "distance"),
        ({"distance": float("nan")}, ParameterError, "distance"),
        ({"start_time": float("inf")}, ParameterError, "start_time"),
        ({"speed": 0.0}, ParameterError, "speed"),
        ({"speed": 1.5}, ParameterError, "speed"),
    ],
)
def test_wrong_arguments(silvermate, arguments, error, match):
    nodes = arguments.pop("coordinates", straight(silvermate))
    with pytest.raises(error, match=match):
        Retimer(silvermate).horizon(nodes, **arguments)


def test_wrong_limits(silvermate, tiago, gantry):
    with refused(ParameterError, "2 drive coordinates", "8 joints"):
        Retimer(silvermate, limits_of(tiago))
    with refused(ParameterError, "dt"):
        Retimer(silvermate, dt=0.5)


def test_a_profile_that_breaks_a_limit_is_never_returned(silvermate, monkeypatch):
    """The last line of defence: were the solver wrong by 2 %, nothing would come back."""
    honest = retiming.fastest

    def hasty(*arguments):
        profile = honest(*arguments)
        return Profile.of(profile.grid, 1.4 * profile.x)

    nodes = arcs(silvermate, 3)
    monkeypatch.setattr(retiming, "fastest", hasty)
    with refused(RetimingError, "limit"):
        Retimer(silvermate).horizon(nodes)
    monkeypatch.setattr(retiming, "fastest", lambda *arguments: None)
    with refused(RetimingError, "profile"):
        Retimer(silvermate).horizon(nodes)


def test_a_tighter_margin_saves_a_profile_that_exceeds(silvermate, monkeypatch):
    """Where the first try is a little too fast, the next ones are slower; one of them is returned."""
    honest, tried = retiming.fastest, []

    def hasty(grid, y1, y2, bound, acceleration, start):
        tried.append(float(acceleration[0]))
        profile = honest(grid, y1, y2, bound, acceleration, start)
        return Profile.of(profile.grid, 1.06 * profile.x)

    monkeypatch.setattr(retiming, "fastest", hasty)
    motion = Retimer(silvermate).horizon(arcs(silvermate, 3))
    assert len(tried) > 1
    assert tried == sorted(tried, reverse=True)
    sound(motion, limits_of(silvermate))


def test_who_does_not_insist_tries_the_plain_curve_alone(silvermate, monkeypatch):
    """Where the robot cannot brake on it, others are tried, but not by who has another way to plan."""
    tried = {True: 0, False: 0}
    v = np.zeros(10)
    v[0] = 0.3
    for insist in tried:

        def none(*_, insist: bool = insist) -> None:
            tried[insist] += 1

        monkeypatch.setattr(retiming, "fastest", none)
        with refused(RetimingError, "profile"):
            Retimer(silvermate).horizon(straight(silvermate), v, distance=1.0, insist=insist)
    assert tried[False] == 1 < tried[True]
