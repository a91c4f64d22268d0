"""Mounting: the links that sensors sit on, and their poses, by Pinocchio's frames."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from brute_force import configuration, random_coordinates
from cases import refused

from elastic_strips.errors import ConfigurationError, RobotError
from elastic_strips.perception.own_body import Posture, SensorMount
from elastic_strips.sim.sensors import sensor_frames


def test_the_silvermate_has_its_sensors(silvermate):
    found = sensor_frames(silvermate)
    assert found["laser"] == ("laser_frame",)
    assert found["sonar"] == tuple(f"sonar_{k}_frame" for k in range(12))
    assert found["infrared"] == tuple(f"ir_{k}_frame" for k in range(6))


def test_another_robot_has_none(gantry):
    assert sensor_frames(gantry) == {"laser": (), "sonar": (), "infrared": ()}


def test_a_missing_link_is_named_with_those_there_are(gantry, silvermate):
    with refused(RobotError, "'laser_frame'"):
        SensorMount(Posture(gantry), ["laser_frame"])
    with refused(RobotError, "'sonar_1_frame'"):
        SensorMount(Posture(silvermate), ["sonar_1_fram"])


@pytest.mark.parametrize(
    "name, links", [("silvermate", ["laser_frame", "ir_5_frame", "arm_7_link"]), ("gantry", ["tip"])]
)
def test_poses_are_pinocchios(name, links, request):
    robot = request.getfixturevalue(name)
    posture = Posture(robot)
    mount = SensorMount(posture, links)
    data = robot.model.createData()
    for coordinates in random_coordinates(robot, np.random.default_rng(0), 4):
        posture.place(coordinates)
        pin.framesForwardKinematics(robot.model, data, configuration(robot, coordinates))
        world, base = mount.poses()
        T_world_base = data.oMi[1].homogeneous if robot.space.planar else np.eye(4)
        for k, link in enumerate(links):
            T = data.oMf[robot.model.getFrameId(link, pin.FrameType.BODY)].homogeneous
            np.testing.assert_allclose(world[k], T, atol=1e-12)
            np.testing.assert_allclose(T_world_base @ base[k], T, atol=1e-12)


@pytest.mark.parametrize("bad", [np.zeros(3), np.full(10, np.nan)])
def test_a_coordinate_row_that_is_none(silvermate, bad):
    with refused(ConfigurationError, "finite"):
        Posture(silvermate).place(bad)
