"""Telling: what diagnostics say of a frame that is to stay level."""

from __future__ import annotations

import numpy as np

from elastic_strips.robot import RobotModel
from elastic_strips.ros2.telling import tilt_of
from elastic_strips.strip.constraint import ConstraintForce, OrientationConstraint


def test_a_tilt_is_told_and_said_beyond_its_tolerance(silvermate: RobotModel) -> None:
    home = silvermate.home()
    level = ConstraintForce(silvermate, OrientationConstraint.from_configuration(silvermate, home, "palm_link"))
    axis = silvermate.frame_pose(home, "palm_link")[:3, :3] @ level.constraint.axis
    told = []
    for bend in (0.0, 0.05, 0.3):
        row = silvermate.space.to_coordinates(home)
        row[-2] += bend
        turned = silvermate.frame_pose(silvermate.space.from_coordinates(row), "palm_link")[:3, :3]
        tilt, said = tilt_of(level, row)
        between = np.arccos(np.clip(axis @ (turned @ level.constraint.axis), -1.0, 1.0))
        assert np.isclose(tilt, between, atol=1e-6)
        assert bool(said) == (tilt > level.constraint.tolerance)
        told.append(said)
    assert told[0] == ""
    assert "palm_link" in told[-1]
