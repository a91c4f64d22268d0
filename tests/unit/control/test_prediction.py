"""Prediction and perception: what is assumed of obstacles, and that what is sensed keeps to it."""

from __future__ import annotations

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.control import DriveParams, ObstacleAssumptions
from elastic_strips.control.prediction import ArrivalTimes, as_expected, predict
from elastic_strips.errors import ParameterError
from elastic_strips.scene import Box, Cylinder, Keyframes, Scene, Sphere, Twist, UnknownMotion, World
from elastic_strips.sim import Fault, PerceptionError, PerceptionParams
from elastic_strips.sim.faults import FaultPlan, FaultyPerception
from elastic_strips.sim.perception import NoisyGroundTruth
from elastic_strips.trajectory import MotionLimits

ASSUMED = ObstacleAssumptions(position_error=0.01, velocity_error=0.05, acceleration=0.4, max_speed=2.0)


def curve(seed: int) -> Keyframes:
    """A track whose acceleration stays below what is assumed."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 10.0, 401)
    v = rng.uniform(-0.8, 0.8, 2)
    phase = rng.uniform(0, 6)
    x = v[0] * t + 0.3 * np.sin(0.9 * t + phase)
    y = v[1] * t + 0.3 * np.cos(0.9 * t + phase)
    return Keyframes(t, np.column_stack([x, y, np.full_like(t, 0.8)]))


def test_an_obstacle_is_within_what_is_predicted():
    checked = 0
    for seed in range(10):
        world = World(Scene([Cylinder(0.2, 1.6, motion=curve(seed), name="walker"), Box((1, 1, 1), at=(5, 5, 0.5))]))
        sense = NoisyGroundTruth(world, ASSUMED, PerceptionParams(), np.random.default_rng(seed))
        for now in (1.0, 3.3, 6.0):
            scene = sense.sense(now)
            assert scene.time == pytest.approx(now - 0.05)
            forecast = predict(scene, ASSUMED)
            assert forecast.obstacles.tolist() == [0]
            for ahead in np.linspace(0.05, 2.0, 9):
                t = np.array([now + ahead - scene.time])
                expected = forecast.predict(t)
                where = scene.obstacle("walker").pose[:3, 3] + expected.shift[0, 0]
                truth = world.at(now + ahead).obstacle("walker").pose[:3, 3]
                assert np.linalg.norm(truth - where) <= expected.uncertainty[0, 0] + 1e-9
                checked += 1
    assert checked == 270


def test_kinds_of_motion():
    scene = Scene(
        [
            Sphere(0.2, at=(1, 0, 0.5), name="still"),
            Sphere(0.2, at=(2, 0, 0.5), name="steady", motion=Twist((0.5, 0.0, 0.0))),
            Sphere(0.2, at=(3, 0, 0.5), name="unknown", motion=UnknownMotion(0.7)),
            Box((0.6, 0.2, 0.4), at=(4, 0, 0.5), name="turning", motion=Twist(angular=(0.0, 0.0, 1.0))),
        ]
    )
    forecast = predict(scene, ASSUMED)
    assert forecast.obstacles.tolist() == [1, 2, 3]
    np.testing.assert_allclose(forecast.velocity, [[0.5, 0, 0], [0, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(forecast.offset, 0.01)
    reach = scene.obstacle("turning").reach
    np.testing.assert_allclose(forecast.speed, [0.05, 0.7, 0.05 + reach])
    np.testing.assert_allclose(forecast.acceleration, [0.4, 0.0, 0.4])
    expected = predict(scene, ASSUMED, sure=True, horizon=2.0)
    assert not np.concatenate([expected.offset, expected.speed, expected.acceleration]).any()
    assert expected.predict(np.array([1.9, 2.1])).ignored.tolist() == [False, True]


def test_the_future_is_not_sensed():
    """Of a track only position and velocity come through."""
    world = World(Scene([Cylinder(0.2, 1.6, motion=curve(1), name="walker")]))
    seen = NoisyGroundTruth(world, ASSUMED, PerceptionParams(), np.random.default_rng(0)).sense(2.0)
    motion = seen.obstacle("walker").motion
    assert isinstance(motion, Twist)
    truth = world.at(1.95).obstacle("walker")
    assert 0.0 < np.linalg.norm(seen.obstacle("walker").pose[:3, 3] - truth.pose[:3, 3]) <= 0.01
    assert 0.0 < np.linalg.norm(motion.linear - truth.velocity()[0]) <= 0.05


def test_faults_of_perception():
    world = World(Scene([Cylinder(0.2, 1.6, motion=Twist((1.0, 0.0, 0.0)), name="walker")]))
    faults = FaultPlan(
        [Fault("scene_frozen", 1.0, 0.5), Fault("scene_late", 2.0, 0.5), Fault("nan_obstacle", 3.0, 0.5)]
    )
    inner = NoisyGroundTruth(world, ASSUMED, PerceptionParams(delay=0.1), np.random.default_rng(0))
    sense = FaultyPerception(inner, faults)
    assert sense.sense(0.9).time == pytest.approx(0.8)
    assert sense.sense(1.4).time == pytest.approx(0.8)  # it says how old it is
    assert sense.sense(1.5).time == pytest.approx(1.4)
    assert sense.sense(2.2).time == pytest.approx(1.8)
    with refused(PerceptionError, "finite"):
        sense.sense(3.2)
    assert sense.sense(3.6).time == pytest.approx(3.5)


def test_appearing_obstacles_are_seen_when_they_exist():
    world = World(Scene([Sphere(0.2, name="ball", motion=Twist((0.1, 0, 0)))]), appears={"ball": 1.0})
    sense = NoisyGroundTruth(world, ASSUMED, PerceptionParams(delay=0.1), np.random.default_rng(0))
    assert len(sense.sense(1.05)) == 0
    assert sense.sense(1.15).names == ("ball",)


@each(
    "text, message",
    [
        ("scene_frozn@2", "did you mean 'scene_frozen'"),
        ("scene_late@soon", "must read kind"),
        ("scene_late@-1", "start=-1.0 must be a finite number of s ≥ 0"),
        ("scene_late@1:nan", "duration=nan"),
    ],
)
def test_faults_are_parsed(text, message):
    assert Fault.parse("scene_late@2.5:0.3") == Fault("scene_late", 2.5, 0.3)
    assert Fault.parse("camera-tilted=2deg@5+3") == Fault("camera_tilted", 5.0, 3.0, np.radians(2.0))
    assert Fault.parse("slow_tick@2") == Fault("slow_tick", 2.0, 1.0)
    with pytest.raises(ParameterError, match=message):
        Fault.parse(text)


@each(
    "values, message",
    [
        ({"control_dt": 0.0}, "control_dt=0.0 must be a finite number > 0"),
        ({"plan_every": 2.5}, "plan_every=2.5 must be a whole number"),
        ({"speeds": (1.0, 0.0)}, "must be a finite number > 0 and ≤ 1"),
        ({"tracking_error": float("nan")}, "tracking_error=nan"),
    ],
)
def test_parameters_are_checked(values, message):
    with pytest.raises(ParameterError, match=message):
        DriveParams(**values)
    with refused(ParameterError, "acceleration=-1"):
        ObstacleAssumptions(acceleration=-1)
    with refused(ParameterError, "noise=2"):
        PerceptionParams(noise=2)


def test_arrival_times(silvermate):
    arrival = ArrivalTimes(silvermate, MotionLimits.for_robot(silvermate))
    arrival.pace[:] = 0.5
    coordinates = np.repeat(silvermate.space.to_coordinates(silvermate.home())[None], 3, axis=0)
    coordinates[1:, 0] = 1.0
    coordinates[2, 4] += 0.25
    np.testing.assert_allclose(arrival(coordinates), [0.0, 2.0, 2.5])


def test_what_keeps_to_the_assumptions_is_as_expected():
    """Snapshots of one track a planning tick apart, sensed with noise; but not of one that turns at once."""
    verdicts = []
    for seed in range(20):
        obstacles = [Sphere(0.2, name="a", motion=curve(seed)), Box((0.3, 0.3, 1.0), at=(5.0, 0.0, 0.5), name="b")]
        rng = np.random.default_rng(seed)
        seen = NoisyGroundTruth(World(Scene(obstacles)), ASSUMED, PerceptionParams(), rng)
        for t in np.arange(0.5, 4.0, 0.37):
            one, two = seen.sense(float(t)), seen.sense(float(t) + 0.05)
            verdicts.append(as_expected(two, one, predict(one, ASSUMED), ASSUMED))
            assert not as_expected(one, two, predict(two, ASSUMED), ASSUMED)  # older, not newer
            pose = two.obstacle("a").pose
            turned = two.with_observations(
                [two.obstacle("a").observed(pose, Twist(two.obstacle("a").velocity()[0] + 0.3))]
            )
            assert not as_expected(turned, one, predict(one, ASSUMED), ASSUMED)
            away = pose.copy()
            away[0, 3] += 0.06
            assert not as_expected(two.moved("a", away), one, predict(one, ASSUMED), ASSUMED)
            grown = Scene([two.obstacle("a"), Box((0.4, 0.3, 1.0), at=(5.0, 0.0, 0.5), name="b")], time=two.time)
            assert not as_expected(grown, one, predict(one, ASSUMED), ASSUMED)
    assert all(verdicts)
    assert len(verdicts) > 100
