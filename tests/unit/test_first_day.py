"""What is typed wrongly on the first day is refused with what may have been meant."""

from __future__ import annotations

import copy
import pickle

import pytest
from cases import each, refused

from elastic_strips import DeformParams, plan
from elastic_strips.control import DriveParams
from elastic_strips.errors import ConfigurationError, ParameterError, PlanningError
from elastic_strips.scene import Box, Scene


@each(
    "make, name",
    [
        (lambda: DriveParams(speed_scale=2.0), "speed_scale"),
        (lambda: DriveParams(acceleration_scale=1.5), "acceleration_scale"),
        (lambda: DeformParams(influence=30.0), "influence"),
        (lambda: DeformParams(influnce=0.3), "influence"),  # pyright: ignore[reportCallIssue]
        (lambda: DriveParams(speedscale=0.5), "speed_scale"),  # pyright: ignore[reportCallIssue]
        (lambda: DeformParams().replaced(influnce=0.3), "influence"),
    ],
)
def test_parameters_out_of_range_and_of_wrong_names(make, name):
    with refused(ParameterError, name):
        make()


def test_parameters_are_copied_and_pickled_as_before():
    for params in (DriveParams(speed_scale=0.5), DeformParams(influence=0.2)):
        assert copy.deepcopy(params) == pickle.loads(pickle.dumps(params)) == params


@each("yaw", [90.0, -45.0])
def test_a_yaw_in_degrees(silvermate, yaw):
    with refused(ConfigurationError, "radians"):
        silvermate.home(yaw=yaw)


def test_a_plan_that_has_to_be_certified(silvermate):
    walls = [Box((0.1, 4.0, 2.0), at=(x, 0.0, 1.0)) for x in (-1.2, 1.2)]
    walls += [Box((4.0, 0.1, 2.0), at=(0.0, y, 1.0)) for y in (-1.2, 1.2)]
    start, goal = silvermate.home(), silvermate.home(x=3.0)
    with pytest.raises(PlanningError) as failed:
        plan(silvermate, Scene(walls), start, goal, timeout=1.0, certified=True)
    assert not failed.value.report.certified
    assert plan(silvermate, Scene([]), start, goal, certified=True).q.shape[1] == silvermate.nq
