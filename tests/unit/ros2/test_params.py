"""Parameters that name a posture of the arm: by a name, or by positions of joints."""

from __future__ import annotations

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.errors import ConfigurationError, ParameterError
from elastic_strips.robot import RobotModel
from elastic_strips.ros2 import Ros2Params
from elastic_strips.ros2.params import posture_of


def given(robot: RobotModel, *told: str) -> np.ndarray:
    found = posture_of(robot, told)
    assert found is not None
    return found


def joints(robot: RobotModel, q: np.ndarray) -> np.ndarray:
    return robot.space.to_coordinates(q)[robot.space.base_nv :]


def test_a_posture_has_a_name_or_positions(silvermate: RobotModel, tiago: RobotModel):
    home = joints(silvermate, silvermate.home())
    assert posture_of(silvermate, None) is None
    np.testing.assert_allclose(given(silvermate, "home"), home)
    np.testing.assert_allclose(given(silvermate, "reach"), joints(silvermate, silvermate.state("reach")))
    told = given(silvermate, "arm_1_joint:0.4", "arm_7_joint:-0.2")
    np.testing.assert_allclose(told, [0.4, *home[1:6], -0.2])
    np.testing.assert_allclose(given(tiago, "home"), joints(tiago, tiago.home()))


@each(
    ("told", "error"),
    [
        (("rech",), ConfigurationError),
        (("arm_9_joint:0.1",), ConfigurationError),
        (("arm_1_joint:99",), ConfigurationError),
        (("arm_1_joint:left",), ParameterError),
        (("home", "reach"), ParameterError),
    ],
)
def test_what_is_no_posture_is_refused(told: tuple[str, ...], error: type[Exception], silvermate: RobotModel):
    with pytest.raises(error):
        posture_of(silvermate, told)


def test_an_arm_that_is_not_commanded_takes_no_posture():
    with refused(ParameterError, "path_posture"):
        Ros2Params(arm="none", path_posture=("home",))
    with refused(ParameterError, "level"):
        Ros2Params(arm="none", level="palm_link")
    with refused(ParameterError, "guard"):
        Ros2Params(mode="guard", level="palm_link")
    assert Ros2Params(level="palm_link").level == "palm_link"


def test_fixes_come_from_one_place_and_transforms_are_between_named_frames():
    assert Ros2Params().fixes == ""
    assert Ros2Params(fix="amcl_pose").fixes == "amcl_pose"
    assert Ros2Params(fix_from_tf=True, world_frame="map", odom_frame="odom").fixes == "/tf"
    with refused(ParameterError, "world_frame"):
        Ros2Params(fix_from_tf=True, odom_frame="odom")
    with refused(ParameterError, "fix_from_tf"):
        Ros2Params(fix_from_tf=True, world_frame="map", odom_frame="odom", fix="amcl_pose")
