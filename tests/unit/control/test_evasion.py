"""Evasion: manoeuvres that motors can do, a robot that gets out of the way, one that keeps still where none comes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cases import each
from drivable import limits_of, most_used

from elastic_strips.collision import Forecast
from elastic_strips.control import Controller, DriveParams
from elastic_strips.control.evasion import _LONGER_BY, EvasivePlanner, motion_to
from elastic_strips.control.lookahead import ObstacleLookahead
from elastic_strips.control.params import EvasionParams, Margins, ObstacleAssumptions
from elastic_strips.control.prediction import Outlook, predict
from elastic_strips.control.progress import reconnect
from elastic_strips.control.rollout import RollOuts, Targets, lattice
from elastic_strips.control.strip_timer import PlanOutcome
from elastic_strips.native import kernel, twin
from elastic_strips.planning import straight_line
from elastic_strips.robot import PlanarFootprint, RobotModel
from elastic_strips.scene import Box, Cylinder, Scene, Twist, World
from elastic_strips.sim import Simulation, evaluate, simulation
from elastic_strips.strip import Strip
from elastic_strips.trajectory.limits import MotionLimits
from elastic_strips.trajectory.trajectory import ReferenceState

PART = 0.9
GATE = [Box((0.2, 3.0, 1.0), at=(3.0, y, 0.5), name=f"gate-{y}") for y in (-1.5, 1.5)]


def limits_for(robot: RobotModel) -> MotionLimits:
    if robot.name.startswith("jackal"):
        return MotionLimits.for_robot(robot, wheel_speed=2.0, wheel_acceleration=2.0)
    return limits_of(robot)


def outlook(scene: Scene) -> Outlook:
    return Outlook.of(scene, ObstacleAssumptions(), Margins(tracking_error=0.03, margin=0.005))


def some_state(robot: RobotModel, limits: MotionLimits, seed: int) -> ReferenceState:
    """A state within the limits; joints in the middle of their range move slowly."""
    rng = np.random.default_rng(seed)
    y = rng.uniform(-0.7, 0.7, len(limits.speed)) * limits.speed
    y[limits.drive_dim :] *= 0.1
    coordinates = robot.space.to_coordinates(robot.home_q)
    coordinates[:3] = rng.normal(size=3)
    return ReferenceState(1.25, coordinates, limits.to_tangent(y), np.zeros(robot.nv))


@each("name", ["jackal_box", "silvermate", "tiago"])
def test_motions_keep_the_limits_roll_and_end_at_rest(name, request):
    robot = request.getfixturevalue(name)
    limits = limits_for(robot)
    made = 0
    for seed in range(4):
        start = some_state(robot, limits, seed)
        for target in lattice(limits).different[::3]:
            motion = motion_to(robot, limits, start, target, part=PART, duration=0.3, dt=0.02)
            if motion is None:
                continue
            made += 1
            speed, acceleration = most_used(motion, limits)
            assert speed <= 1.0 + 1e-9
            assert acceleration <= 1.0 + 1e-6
            assert np.abs(motion.steps[:, 1]).max() < 1e-12  # no sideways travel: exact arcs
            assert np.abs(motion.v[:, 1]).max() == 0.0
            assert motion.at_rest_at_end
            np.testing.assert_array_equal(motion.coordinates[0], start.coordinates)
            np.testing.assert_allclose(motion.v[0], start.v, atol=1e-12)
            assert motion.start_time == start.time
    assert made > 20


def test_rollouts_are_where_the_motions_are(jackal_box):
    limits = limits_for(jackal_box)
    start = some_state(jackal_box, limits, 1)
    kinds = lattice(limits).different
    _, poses, rest = RollOuts(limits, part=PART, dt=0.1).to_rest(start, kinds, np.full(len(kinds), 0.3))
    for target, pose, end in zip(kinds, poses, rest, strict=True):
        motion = motion_to(jackal_box, limits, start, target, part=PART, duration=0.3, dt=0.02)
        assert motion is not None
        assert motion.duration == pytest.approx(end, abs=0.03)
        np.testing.assert_allclose(pose[-1], motion.coordinates[-1], atol=0.05)


def some_rollouts(rolling: RollOuts, limits: MotionLimits, start: ReferenceState) -> list[np.ndarray]:
    """Of a whole lattice; of motions to rest, held for several times; and of one manoeuvre."""
    targets = lattice(limits)
    kinds = targets.different
    time, pose, rest = rolling.to_rest(start, kinds, np.linspace(0.0, 1.3, len(kinds)))
    return [rolling.poses(start, targets, horizon=3.0), time, pose, rest]


@pytest.mark.skipif(kernel() is None, reason="no native kernel")
@each("name", ["jackal_box", "silvermate", "rover"])
def test_rollouts_are_those_of_the_twin(name, request):
    robot = request.getfixturevalue(name)
    limits = limits_for(robot)
    native = RollOuts(limits, part=PART, dt=0.15)
    with twin():
        readable = RollOuts(limits, part=PART, dt=0.15)
    for seed in range(4):
        start = some_state(robot, limits, seed)
        both = zip(some_rollouts(native, limits, start), some_rollouts(readable, limits, start), strict=True)
        for mine, own in both:
            np.testing.assert_allclose(mine, own, rtol=0.0, atol=1e-12)


def test_rollouts_keep_the_limits_and_reach_their_targets(jackal_box):
    """Speeds of the base between poses: those of the first target, then of the second, and no change too fast."""
    limits, dt = limits_for(jackal_box), 0.05
    start = some_state(jackal_box, limits, 2)
    first, second = np.array([[0.9, 0.5]]), np.array([[-0.4, -0.4]])
    targets = Targets(first, second, np.array([1.5]), np.zeros(1, dtype=np.intp))
    pose = RollOuts(limits, part=PART, dt=dt).poses(start, targets, horizon=4.0)[0]
    step = np.diff(np.vstack([start.coordinates[:3], pose]), axis=0)
    turn = step[:, 2] / dt
    middle = pose[:, 2] - 0.5 * step[:, 2]
    speed = (np.cos(middle) * step[:, 0] + np.sin(middle) * step[:, 1]) / dt
    rims = limits.to_drive(np.column_stack([speed, 0.0 * speed, turn]))
    np.testing.assert_allclose(rims[round(1.5 / dt) - 1], first[0], atol=1e-9)
    np.testing.assert_allclose(rims[-1], second[0], atol=1e-9)
    assert (np.abs(np.diff(rims, axis=0)) <= PART * limits.drive_acceleration * dt + 1e-9).all()
    assert np.abs(np.cos(middle) * step[:, 1] - np.sin(middle) * step[:, 0]).max() < 1e-12


def test_manoeuvres_go_on_backing_off_in_a_turn_unless_they_may_not(jackal_box):
    limits = limits_for(jackal_box)
    for backward in (True, False):
        targets = lattice(limits, backward=backward)
        twist = limits.to_twist(targets.second)
        for side in (1.0, -1.0):
            turned = (twist[:, 0] < -0.1) & (side * twist[:, 2] > 0.1) & np.isfinite(targets.change)
            assert (turned & (targets.first > 0.1).all(axis=1)).any() == backward


def test_manoeuvres_turn_no_faster_than_they_may(jackal_box):
    limits = limits_for(jackal_box)
    fastest = []
    for turn_speed in (np.inf, 1.0):
        targets = lattice(limits, turn_speed=turn_speed)
        fastest.append(max(np.abs(limits.to_twist(rims)[:, 2]).max() for rims in (targets.first, targets.second)))
    assert fastest[1] < 1.0 + 1e-9 < 1.2 < fastest[0]


@pytest.fixture
def crowded(silvermate: RobotModel) -> tuple[EvasivePlanner, ReferenceState]:
    """A planner that has looked at what comes from several sides, between what stands."""
    limits = limits_for(silvermate)
    planner = EvasivePlanner(silvermate, limits, EvasionParams(), dt=0.02, hold=0.1)
    comers = [
        Cylinder(0.3, 1.2, at=(x, y, 0.6), name=f"comer-{k}", motion=Twist((vx, vy, 0.0)))
        for k, (x, y, vx, vy) in enumerate([(2.5, 0.2, -0.9, 0.0), (-0.6, -0.4, 0.0, 1.1)])
    ]
    walls = [Box((6.0, 0.2, 1.0), at=(0.0, y, 0.5), name=f"wall-{y}") for y in (-1.6, 1.9)]
    scene = Scene([*comers, *walls, Box((0.4, 0.4, 1.0), at=(1.5, -0.9, 0.5), name="post")])
    coordinates = silvermate.space.to_coordinates(silvermate.home())
    v = np.zeros(silvermate.nv)
    v[0] = 0.4
    start = ReferenceState(0.1, coordinates, v, np.zeros(silvermate.nv))
    strip = straight_line(silvermate, silvermate.home(), silvermate.home(x=6.0), spacing=0.2)
    assert planner.look(outlook(scene), start, strip)
    return planner, start


def test_shorter_ways_to_the_best_manoeuvre_lead_to_it(crowded):
    """What stands is asked for as few as will do, and longer times only where the shortest does not do."""
    planner, start = crowded
    free = np.column_stack(
        [planner._free(start, planner._kinds, np.full(len(planner._kinds), 0.1 + t), after=1.0) for t in _LONGER_BY]
    )
    np.testing.assert_array_equal(planner._held(start), np.where(free.any(axis=1), free.argmax(axis=1), -1))
    assert free[:, 0].any()
    assert (~free[:, 0] & free.any(axis=1)).any()
    assert not free.any(axis=1).all()
    pose = planner._rolling.poses(start, planner._lattice, horizon=3.0)
    cost = planner._risk(pose) + planner._to_go(pose[:, -1])
    risen = cost + planner._standing_risk(pose)
    assert (risen > cost).any()
    best = np.argsort(cost, kind="stable")[:60]
    for better in (np.inf, float(np.median(risen[best]))):
        expected = best[np.argsort(risen[best], kind="stable")]
        expected = expected[risen[expected] < better]
        assert list(planner._in_order(pose, cost, best, better)) == expected.tolist()


def test_separations_from_above(jackal_box):
    """Against what is plain to see: a disc ahead that comes, and a wall at the side."""
    footprint = PlanarFootprint(jackal_box)
    footprint.update(jackal_box.space.to_coordinates(jackal_box.home()))
    half = footprint.half[int(footprint.half[:, 0].argmax())]
    disc = Cylinder(0.5, 1.0, at=(3.0, 0.0, 0.5), name="disc", motion=Twist((-1.0, 0.0, 0.0)))
    wall = Box((8.0, 0.2, 1.0), at=(0.0, 1.5, 0.5), name="wall")
    scene = Scene([disc, wall])
    assumptions = ObstacleAssumptions(position_error=0.0, velocity_error=0.0, acceleration=0.5)
    lookahead = ObstacleLookahead(footprint, scene, predict(scene, assumptions), np.zeros(2), reach=3.0, horizon=3.0)
    assert lookahead.movers == 1
    pose, time = np.zeros((1, 2, 3)), np.array([0.0, 1.0])
    possible = lookahead.possible(pose, time)[0]
    assert possible[0] == pytest.approx(3.0 - 0.5 - half[0], abs=0.03)
    assert possible[1] == pytest.approx(possible[0] - 1.0 - 0.25, abs=1e-9)
    near = lookahead.near(pose, time, 0.5)[0]
    assert near[1] == pytest.approx(near[0] - 1.0, abs=1e-9)
    assert near[0] <= possible[0] - 0.5 + 1e-9
    assert 1.4 - half[1] - 0.1 < lookahead.from_standing(pose)[0, 0] <= 1.4 - half[1] + 1e-9


def test_a_mover_that_accelerates_is_looked_for_where_that_leads(jackal_box):
    """It brakes, turns round, and goes on; only what is expected changes, not what is possible."""
    footprint = PlanarFootprint(jackal_box)
    footprint.update(jackal_box.space.to_coordinates(jackal_box.home()))
    disc = Cylinder(0.2, 1.0, at=(5.0, 0.0, 0.5), name="disc", motion=Twist((0.3, 0.2, 0.0)))
    scene = Scene([disc])
    forecast, trend = predict(scene, ObstacleAssumptions()), np.array([[-0.5, 0.4, 0.0]])
    straight, bent = (
        ObstacleLookahead(footprint, scene, forecast, np.zeros(2), reach=6.0, horizon=3.0, trend=each)
        for each in (None, trend)
    )
    time = np.array([0.1, 0.5, 0.7, 1.0, 1.5, 2.0])
    pose = np.zeros((1, len(time), 3))
    for k, t in enumerate(time):
        held = min(t, 1.0)
        way = np.array([0.3, 0.2]) * t + trend[0, :2] * held * (t - 0.5 * held)
        pose[0, k, :2] = np.array([5.0, 0.0]) + way + np.array([0.0, 2.0])
    apart = bent.near(pose, time, 0.0)[0]
    np.testing.assert_allclose(apart, apart[1], atol=0.02)  # two straight courses follow the bend to some millimetres
    np.testing.assert_allclose(apart[[1, 3, 4, 5]], apart[1], atol=1e-9)
    assert np.ptp(straight.near(pose, time, 0.0)) > 0.3
    np.testing.assert_array_equal(bent.possible(pose, time), straight.possible(pose, time))
    np.testing.assert_allclose(bent.near(pose[:, ::-1], time[::-1], 0.0)[0], apart[::-1], atol=1e-12)


@pytest.mark.skipif(kernel() is None, reason="no native kernel")
def test_separations_are_those_of_the_twin(jackal_box, silvermate):
    rng, touched = np.random.default_rng(5), np.zeros(2)
    for robot in (jackal_box, silvermate):
        footprint = PlanarFootprint.of(robot, robot.home())
        for _ in range(10):
            movers = [
                Cylinder(
                    rng.uniform(0.1, 0.5), rng.uniform(0.3, 1.8), at=(*rng.uniform(-3, 3, 2), rng.uniform(0.2, 1.5)),
                    name=f"mover-{k}", motion=Twist((*rng.uniform(-1, 1, 2), 0.0)),
                )
                for k in range(6)
            ]  # fmt: skip
            still = []
            for k in range(8):
                half = 0.5 * rng.uniform(-np.pi, np.pi)
                still.append(
                    Box(
                        rng.uniform(0.1, 1.0, 3), at=(*rng.uniform(-3, 3, 2), rng.uniform(0, 1)), name=f"box-{k}",
                        quat=(0.0, 0.0, np.sin(half), np.cos(half)),
                    )
                )  # fmt: skip
            scene = Scene([*movers, *still])
            forecast = predict(scene, ObstacleAssumptions())
            arguments = footprint, scene, forecast, np.zeros(2)
            native = ObstacleLookahead(*arguments, reach=3.0, horizon=3.0)
            with twin():
                readable = ObstacleLookahead(*arguments, reach=3.0, horizon=3.0)
            pose, time = rng.uniform(-2, 2, (7, 9, 3)), np.linspace(0.0, 3.0, 9)
            for mine, own in (
                (native.near(pose, time, 0.5), readable.near(pose, time, 0.5)),
                (native.possible(pose, time), readable.possible(pose, time)),
                (native.possible(pose, time, 0.05), readable.possible(pose, time, 0.05)),
                (native.from_standing(pose), readable.from_standing(pose)),
                (native.from_standing(pose, 0.05), readable.from_standing(pose, 0.05)),
            ):
                np.testing.assert_allclose(mine, own, rtol=0.0, atol=1e-12)
            touched += np.array([(native.from_standing(pose) < 0.0).any(), (native.possible(pose, time) < 0.0).any()])
    assert (touched > 3).all(), "what is far from everything shows little"


def test_who_could_not_stop_before_a_mover_pays_for_it(jackal_box):
    """It crosses ahead: who drives fast towards its course cannot be certified to stop, who creeps or backs off can."""
    limits = limits_for(jackal_box)
    evasion = EvasivePlanner(jackal_box, limits, EvasionParams(), dt=0.02, hold=0.1)
    start = ReferenceState(0.0, jackal_box.space.to_coordinates(jackal_box.home()), np.zeros(3), np.zeros(3))
    comer = Cylinder(0.3, 1.0, at=(2.5, -1.5, 0.5), name="comer", motion=Twist((0.0, 1.0, 0.0)))
    strip = np.column_stack([np.linspace(0.0, 6.0, 31), np.zeros((31, 2))])
    assert evasion.look(outlook(Scene([comer])), start, strip)
    speed = np.array([1.9, 0.3, 0.0, -1.0])
    pose = np.zeros((len(speed), len(evasion.time), 3))
    pose[..., 0] = speed[:, None] * np.minimum(evasion.time, 0.75)  # all stop before they are touched
    moving = evasion.time[1:] < 0.76
    blocked = evasion._blocked(pose)
    assert blocked[0, moving].any()
    assert not blocked[1:, moving].any()
    risk = evasion._risk(pose)
    assert risk[0] - evasion.params.step > risk[1] >= risk[2] >= risk[3]
    far = Cylinder(0.3, 1.0, at=(2.5, 9.0, 0.5), name="far", motion=Twist((0.0, -0.1, 0.0)))
    assert not evasion.look(outlook(Scene([far])), start, strip) or not evasion._blocked(pose).any()


def test_what_comes_from_behind_counts_and_what_goes_away_does_not(jackal_box):
    """Of a robot that looks along x: somebody behind it, who walks up to it, by how near; nobody else."""
    pose = np.zeros((1, 1, 3))
    footprint = PlanarFootprint(jackal_box)
    footprint.update(jackal_box.space.to_coordinates(jackal_box.home()))

    def behind(x, y, vx, vy, yaw=0.0):
        comer = Cylinder(0.3, 1.0, at=(x, y, 0.5), name="comer", motion=Twist((vx, vy, 0.0)))
        scene = Scene([comer])
        seen = ObstacleLookahead(footprint, scene, outlook(scene).possible, np.zeros(2), reach=9.0, horizon=3.0)
        pose[..., 2] = yaw
        return float(seen.from_behind(pose, np.zeros(1), 4.0)[0, 0])

    near, far = behind(-1.0, 0.1, 0.5, 0.0), behind(-2.5, 0.1, 0.5, 0.0)
    assert 0.0 < far < near <= 1.0
    assert behind(-1.0, 0.1, -0.5, 0.0) == 0.0, "it goes away"
    assert behind(1.0, 0.1, -0.5, 0.0) == 0.0, "it is in sight"
    assert behind(1.0, 0.1, -0.5, 0.0, yaw=np.pi) > 0.5, "the robot has turned its back on it"
    assert behind(-1.0, 0.1, 0.5, 0.0) > behind(-1.0, 0.1, 0.4, 0.4) > 0.0, "it passes at a distance"


def test_who_sees_only_ahead_pays_for_turning_its_back_on_who_comes(jackal_box):
    start = ReferenceState(0.0, jackal_box.space.to_coordinates(jackal_box.home()), np.zeros(3), np.zeros(3))
    comer = Cylinder(0.3, 1.0, at=(2.5, 0.0, 0.5), name="comer", motion=Twist((-0.8, 0.0, 0.0)))
    strip = np.column_stack([np.zeros(31), np.linspace(0.0, 6.0, 31), np.full(31, 0.5 * np.pi)])
    more = {}
    for backward in (True, False):
        evasion = EvasivePlanner(
            jackal_box, limits_for(jackal_box), EvasionParams(), dt=0.02, hold=0.1, backward=backward
        )
        assert evasion.look(outlook(Scene([comer])), start, strip)
        rows = np.zeros((2, len(evasion.time), 3))
        rows[1, :, 2] = np.pi
        (risk, cost), (turned_risk, turned_cost) = evasion.cost(rows[0]), evasion.cost(rows[1])
        assert turned_risk == pytest.approx(risk, abs=0.5), "it is no reason to leave the strip"
        more[backward] = turned_cost - cost
    assert more[False] > more[True] + 0.5


def test_nothing_that_moves_nothing_to_evade(jackal_box):
    limits = limits_for(jackal_box)
    evasion = EvasivePlanner(jackal_box, limits, EvasionParams(), dt=0.02, hold=0.1)
    start = ReferenceState(0.0, jackal_box.space.to_coordinates(jackal_box.home()), np.zeros(3), np.zeros(3))
    scene = Scene(GATE)
    assert not evasion.look(outlook(scene), start, np.zeros((2, 3)))
    far = Scene([Cylinder(0.3, 1.0, at=(40.0, 0.0, 0.5), name="far", motion=Twist((1.0, 0.0, 0.0)))])
    assert not evasion.look(outlook(far), start, np.zeros((2, 3)))


def drive(robot, obstacles, *, evasion: EvasionParams | None, seconds: float, **options):
    """Drive to (6, 0); the runner, its proposals, and the evaluation."""
    proposals = []

    def watch(runner: Simulation[Controller]) -> None:
        if runner.controller.result is not None:
            proposals.append(runner.controller.result)

    runner = simulation(
        robot, World(Scene(obstacles)), robot.home(), robot.home(x=6.0), seed=3, limits=limits_for(robot),
        params=replace(DriveParams(), evasion=evasion), watch=watch, **options,
    )  # fmt: skip
    result = runner.run(time_limit=seconds)
    return runner, proposals, evaluate(result.record, robot, runner.world, runner.limits)


def test_a_still_scene_is_driven_as_without(jackal_box):
    post = Cylinder(0.3, 1.0, at=(3.0, 0.2, 0.5), name="post")
    runs = [drive(jackal_box, [post], evasion=e, seconds=20.0) for e in (EvasionParams(), None)]
    assert not any(p.outcome is PlanOutcome.EVADE for p in runs[0][1])
    coordinate_arrays = [run[0].recorder.finish().control.coordinates for run in runs]
    np.testing.assert_array_equal(*coordinate_arrays)


def test_it_evades_unless_told_otherwise():
    assert DriveParams().evasion == EvasionParams()


def test_gets_out_of_the_way_where_it_would_be_run_into(jackal_box):
    """It waits before a closed gate, and a cylinder comes along the gate."""
    gate = Box((0.2, 30.0, 1.0), at=(3.0, 0.0, 0.5), name="gate")
    comer = Cylinder(0.4, 1.0, at=(2.2, -6.0, 0.5), name="comer", motion=Twist((0.0, 1.0, 0.0)))
    start = jackal_box.home(x=1.0)
    strip = Strip.from_coordinates(jackal_box, straight_line(jackal_box, start, jackal_box.home(x=6.0), spacing=0.13))
    hit = {}
    for evasion in (EvasionParams(), None):
        proposals = []
        runner = simulation(
            jackal_box, World(Scene([gate, comer])), start, jackal_box.home(x=6.0), seed=3, strip=strip,
            limits=limits_for(jackal_box), params=replace(DriveParams(), evasion=evasion, replan_time=50.0),
            watch=lambda r, seen=proposals: seen.append(r.controller.result),
        )  # fmt: skip
        result = runner.run(time_limit=10.0)
        evaluation = evaluate(result.record, jackal_box, runner.world, runner.limits)
        hit[evasion is not None] = len(evaluation.contacts)
        accepted = [p for p in proposals if p is not None and p.accepted]
        assert all(p.certificate is not None and p.certificate.certified for p in accepted)
        assert all(p.motion is not None and p.motion.at_rest_at_end for p in accepted)
        assert any(p.outcome is PlanOutcome.EVADE for p in accepted) == (evasion is not None)
    assert hit[True] == 0 < hit[False]


def test_goes_back_to_the_strip(jackal_box):
    space = jackal_box.space
    goal = jackal_box.home(x=6.0)
    coordinates = straight_line(jackal_box, jackal_box.home(), goal, spacing=0.2)
    for here in ([1.0, 0.8, 0.3], [1.0, -1.2, 3.0], [-0.5, 0.2, -1.5], [5.9, 0.1, 0.0], [6.0, 0.0, 0.0]):
        rows, source = reconnect(space, coordinates, np.array(here), np.array([1.0, 1.0, 0.1]))
        assert len(rows) == len(source) >= 2
        np.testing.assert_array_equal(rows[0], here)
        np.testing.assert_array_equal(rows[-1], coordinates[-1])
        np.testing.assert_array_equal(rows[source >= 0], coordinates[source[source >= 0]])
        step = np.hypot(*np.diff(rows[:, :2], axis=0).T)
        assert step.max() < 0.35
        assert np.abs(np.diff(rows[:, 2])).max() < 1.6


def test_an_empty_forecast_is_no_lookahead(jackal_box):
    none = Forecast(np.zeros(0, dtype=np.intp), np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros(0))
    footprint = PlanarFootprint(jackal_box)
    footprint.update(jackal_box.space.to_coordinates(jackal_box.home()))
    lookahead = ObstacleLookahead(footprint, Scene(GATE), none, np.zeros(2), reach=5.0, horizon=3.0)
    assert lookahead.movers == 0
    assert (
        lookahead.possible(np.zeros((3, 2, 3)), np.zeros(2)) == lookahead.near(np.zeros((3, 2, 3)), np.zeros(2), 1.0)
    ).all()
