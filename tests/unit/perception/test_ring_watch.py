"""Watched rings: a sonar that hears something where a camera and a laser see through says so, and nothing else does."""

from __future__ import annotations

import numpy as np
import pytest
from cases import each

from elastic_strips.errors import ParameterError
from elastic_strips.perception import SceneEstimator
from elastic_strips.perception.rays import Rays
from elastic_strips.scene import Box, Cylinder, Scene, Twist, World
from elastic_strips.sim import Fault
from elastic_strips.sim.faults import FaultPlan, FaultySensors
from elastic_strips.sim.sensors import SensorSuite
from elastic_strips.sim.sensors.obstacle_rays import ObstacleRays
from elastic_strips.sim.sensors.params import DepthParams, InfraredParams, LaserParams, SensorConfig, SonarParams

CAMERA = DepthParams(frame="head_frame", axis="x", tilt=0.35, field_of_view=1.5, columns=64, rows=48, range_max=5.0)
LASER, SONAR, INFRARED = LaserParams(rays=91), SonarParams(), InfraredParams()
DOOR = Box((0.04, 1.6, 2.0), at=(1.5, 0.0, 1.0), name="door")
WALLS = Scene(
    [
        Box((0.1, 8.0, 2.0), at=(4.2, 0.0, 1.0), name="end"),
        Box((8.0, 0.1, 2.0), at=(0.0, 2.2, 1.0), name="left"),
        Box((8.0, 0.1, 2.0), at=(0.0, -2.2, 1.0), name="right"),
    ]
)
AT_DOOR = np.stack(np.meshgrid(np.arange(1.3, 1.7, 0.02), np.arange(-0.4, 0.4, 0.02)), axis=-1).reshape(-1, 2)
LOW = Box((0.3, 0.6, 0.2), at=(1.6, 0.0, 0.1), name="step")  # below the laser's plane
BOARD = Box((0.3, 0.6, 0.06), at=(1.6, 0.0, 0.03), name="board")
WALKER = Cylinder(0.25, 1.7, at=(1.6, -1.5, 0.85), name="walker", motion=Twist(np.array([0.0, 0.8, 0.0])))


def heard(robot, scene, glass=(), sensors=(LASER, SONAR, CAMERA), until=2.5):
    """The estimator after a while before a scene, and what its scenes remarked, of a robot that drives on slowly."""
    suite = SensorSuite(robot, World(scene), SensorConfig(sensors=sensors), seed=3)
    suite.obstacles.make_of_glass(glass)
    estimator, found = SceneEstimator(robot=robot), []
    for k in range(round(until / 0.01)):
        t = 0.01 * k
        row = robot.space.to_coordinates(robot.home(x=0.1 * t))
        for reading in suite.observe(t, row):
            estimator.update(reading, (0.1 * reading.time, 0.0, 0.0))
        if estimator.times and k % 5 == 0:
            found.append(estimator.scene().remark)
    return estimator, [remark for remark in found if remark]


def test_what_a_sonar_hears_and_a_camera_sees_through_is_told_and_an_obstacle(silvermate):
    estimator, remarks = heard(silvermate, WALLS.with_obstacle(DOOR), glass={"door"})
    assert remarks
    assert all("'sonar'" in remark and "'camera'" in remark for remark in remarks)
    assert len(set(remarks)) <= 2, "one remark, and not another with each echo"
    assert not estimator.map.occupied(AT_DOOR).any(), "a laser sees through it"
    assert estimator.near.occupied(AT_DOOR).any()


@each(
    "more", [(), (DOOR,), (LOW,), (BOARD,), (WALKER,)], ids=["walls", "a door", "a step", "a board", "somebody walks"]
)
def test_nothing_is_remarked_where_all_see_the_same(silvermate, more):
    scene = WALLS
    for obstacle in more:
        scene = scene.with_obstacle(obstacle)
    assert not heard(silvermate, scene)[1]


@each(
    "sensors", [(LASER, CAMERA), (LASER, SONAR), (LASER, INFRARED, CAMERA)], ids=["no sonar", "no camera", "infrared"]
)
def test_glass_is_not_told_by_what_sees_through_it_alone(silvermate, sensors):
    """Without an image nothing tells what is above a laser's plane, or below; infrared light passes through glass."""
    estimator, remarks = heard(silvermate, WALLS.with_obstacle(DOOR), glass={"door"}, sensors=sensors)
    assert not remarks
    assert bool(estimator.near.occupied(AT_DOOR).any()) is (SONAR in sensors)


def test_light_passes_through_glass_and_sound_does_not(silvermate):
    rays = Rays(np.array([[0.0, 0.0, 0.5]]), np.array([[1.0, 0.0, 0.0]]))
    obstacles = ObstacleRays(World(WALLS.with_obstacle(DOOR).with_obstacle(WALKER)))
    assert set(obstacles.world.names_resting) == {"door", "end", "left", "right"}
    obstacles.make_of_glass({"door", "walker"})
    assert obstacles.glass == {"door"}, "what moves is none"
    for light, distance in ((True, 4.15), (False, 1.48)):
        np.testing.assert_allclose(obstacles.cast(0.0, rays, 9.0, light=light).distance, distance, atol=1e-6)
    obstacles.make_of_glass(())
    np.testing.assert_allclose(obstacles.cast(0.0, rays, 9.0).distance, 1.48, atol=1e-6)


@each("size", [0.3, 1.0])
def test_the_fault_makes_a_part_of_what_rests_of_glass_while_it_lasts(silvermate, size):
    inner = SensorSuite(silvermate, World(WALLS.with_obstacle(DOOR)), SensorConfig(sensors=(LASER,)), seed=3)
    suite = FaultySensors(inner, FaultPlan([Fault("glass", 0.1, 0.1, size)]), seed=3)
    count = []
    for t in (0.0, 0.15, 0.3):
        suite.observe(t, silvermate.space.to_coordinates(silvermate.home()))
        count.append(len(inner.obstacles.glass))
    assert count == [0, round(np.ceil(4 * size)), 0]


def test_glass_needs_simulated_sensors():
    from elastic_strips.sim.faults import FaultyPerception

    class Known:
        pass

    with pytest.raises(ParameterError, match="glass"):
        FaultyPerception(Known(), FaultPlan([Fault("glass", 0.0)]))  # type: ignore[arg-type]
