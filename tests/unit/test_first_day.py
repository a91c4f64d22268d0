"""What is typed wrongly on the first day is refused with what may have been meant."""

from __future__ import annotations

import copy
import inspect
import pickle

import pytest
from cases import each, refused

import elastic_strips as es
from elastic_strips import DeformParams, plan
from elastic_strips.control import DriveParams, EvasionParams
from elastic_strips.errors import ConfigurationError, ParameterError, PlanningError
from elastic_strips.scene import Box, Scene
from elastic_strips.sim import simulation
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.trajectory import MotionLimits

SCENE = Scene([])


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


@each(
    "call, name",
    [
        (lambda robot: es.plan(robot, SCENE, robot.home(), robot.home(x=1.0), tiemout=3), "timeout"),
        (lambda robot: es.load_robot("tiago", bsae="omni"), "base"),
        (lambda robot: es.Controller(robot, robot.home(), robot.home(), parms=None), "params"),
        (lambda robot: simulation(robot, SCENE, robot.home(), robot.home(), parms=None), "params"),
        (lambda robot: MotionLimits.for_robot(robot, whel_speed=1.0), "wheel_speed"),
        (lambda robot: es.Deformer(robot, parms=None), "params"),
        (lambda robot: es.certify(robot, SCENE, [robot.home()], claerance=0.1), "clearance"),
        (lambda robot: Scene([], tme=0.0), "time"),
        (lambda robot: Box((1.0, 1.0, 1.0), nmae="box"), "name"),
        (lambda robot: es.Cylinder(0.1, 1.0, nmae="post"), "name"),
        (lambda robot: es.Twist(liner=(0.1, 0.0, 0.0)), "linear"),
        (lambda robot: es.Measurement(0.0, None, [], pose_tiem=1.0), "pose_time"),
        (lambda robot: EvasionParams(horison=3.0), "horizon"),
        (lambda robot: get_scenario("corridor", sede=1), "seed"),
    ],
)
def test_a_keyword_that_no_function_has(silvermate, call, name):
    with refused(ParameterError, repr(name)):
        call(silvermate)


@pytest.mark.parametrize("name", [name for name in es.__all__ if name.islower() and not name.startswith("_")])
def test_every_function_of_the_package_says_which_keywords_it_has(name):
    with refused(ParameterError, "qqq"):
        getattr(es, name)(qqq=1)


def test_signatures_and_types_are_as_they_were_written(silvermate):
    assert list(inspect.signature(es.Controller).parameters)[:4] == ["robot", "start", "goal", "scene"]
    assert inspect.signature(es.plan).parameters["seed"].default == 0
    assert es.plan.__doc__
    with pytest.raises(TypeError):
        es.plan(silvermate)  # what is missing is Python's own error
    for value in (es.Twist((0.1, 0.0, 0.0)), Box((1.0, 1.0, 1.0), name="box")):
        assert type(pickle.loads(pickle.dumps(value))) is type(copy.deepcopy(value)) is type(value)
    assert pickle.loads(pickle.dumps(es.load_robot)) is es.load_robot


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
