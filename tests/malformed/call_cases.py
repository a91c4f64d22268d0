"""Wrong calls of the library."""

# ruff: noqa: E501 - tables: one case a line

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

import elastic_strips as es
from elastic_strips.errors import ConfigurationError, InputError, ParameterError, RobotError, ScenarioError, SceneError
from elastic_strips.sim.scenarios import get_scenario, run_scenario
from elastic_strips.strip.paper import PaperParams

Call = Callable[[es.RobotModel], Any]
_NAN, _INF = float("nan"), float("inf")


@dataclass(frozen=True, slots=True)
class CallCase:
    """One wrong call, given the Silvermate."""

    name: str
    call: Call
    error: type[InputError]
    says: tuple[str, ...]


def _with(q: np.ndarray, index: int, value: float) -> np.ndarray:
    q = q.copy()
    q[index] = value
    return q


_BOX = es.Box((1, 1, 1), at=(2, 3, 0.5), name="table")

_ROBOT: tuple[tuple[str, Call, type[InputError], tuple[str, ...]], ...] = (
    ("load_robot of an unknown name", lambda r: es.load_robot("tiagoo"), RobotError, ("'tiagoo'", "did you mean 'tiago'")),
    ("load_robot of nothing", lambda r: es.load_robot(""), RobotError, ("''",)),
    ("load_robot of a missing file", lambda r: es.load_robot("no/such.urdf"), RobotError, ("no/such.urdf",)),
    ("load_robot with a zero byte", lambda r: es.load_robot("a\0b.urdf"), RobotError, ("null",)),
    ("load_robot on an unknown base", lambda r: es.load_robot("silvermate", base="legs"), RobotError, ("'legs'",)),
    ("load_robot with an unknown locked joint", lambda r: es.load_robot("silvermate", locked={"elbow": 0.0}), RobotError,
     ("'elbow'",)),
    ("load_robot with a joint locked at NaN", lambda r: es.load_robot("silvermate", locked={"arm_1_joint": _NAN}), RobotError,
     ("'arm_1_joint'", "nan")),
    ("load_robot with a joint locked in words", lambda r: es.load_robot("silvermate", locked={"arm_1_joint": "up"}), RobotError,
     ("'arm_1_joint'", "'up'")),
    ("load_robot with a joint locked out of limits", lambda r: es.load_robot("silvermate", locked={"arm_1_joint": 9.0}),
     RobotError, ("'arm_1_joint' = 9", "limits")),
    ("load_robot with an unknown frame", lambda r: es.load_robot("silvermate", control_points={"tip": "nose"}), RobotError,
     ("'nose'",)),
    ("load_robot with a missing SRDF", lambda r: es.load_robot("silvermate", srdf="gone.srdf"), RobotError, ("gone.srdf",)),
    ("check_q of three numbers", lambda r: r.check_q(np.zeros(3)), ConfigurationError, ("(3,)", "11")),
    ("check_q of NaN", lambda r: r.check_q(_with(r.home_q, 5, _NAN)), ConfigurationError, ("q[5]", "nan")),
    ("check_q of infinity", lambda r: r.check_q(_with(r.home_q, 0, _INF)), ConfigurationError, ("q[0]", "inf")),
    ("check_q of a long heading", lambda r: r.check_q(_with(r.home_q, 2, 1.5)), ConfigurationError, ("(cos, sin)", "0.5")),
    ("check_q out of limits", lambda r: r.check_q(_with(r.home_q, 7, 2.3)), ConfigurationError, ("'arm_4_joint' = 2.3",)),
    ("check_q of a word", lambda r: r.check_q("home"), ConfigurationError, ("not an array",)),
    ("check_q of nothing", lambda r: r.check_q(None), ConfigurationError, ("q",)),
    ("check_q of a ragged list", lambda r: r.check_q([[1, 2], [3]]), ConfigurationError, ("not an array",)),
    ("check_q of three dimensions", lambda r: r.check_q(np.zeros((2, 2, 11))), ConfigurationError, ("(2, 2, 11)",)),
    ("home with an unknown joint", lambda r: r.home(arm_9_joint=0.0), ConfigurationError, ("'arm_9_joint'", "did you mean")),
    ("home out of limits", lambda r: r.home(arm_4_joint=9.0), ConfigurationError, ("'arm_4_joint' = 9",)),
    ("home at NaN", lambda r: r.home(x=_NAN), ConfigurationError, ("nan",)),
    ("strip of one node", lambda r: es.Strip(r, [r.home_q]), ConfigurationError, ("at least 2 nodes",)),
    ("strip of short nodes", lambda r: es.Strip(r, np.zeros((5, 4))), ConfigurationError, ("(5, 4)",)),
    ("strip with NaN", lambda r: es.Strip(r, [r.home_q, _with(r.home_q, 1, _NAN)]), ConfigurationError, ("[1, 1]", "nan")),
)  # fmt: skip

_SCENE: tuple[tuple[str, Call, type[InputError], tuple[str, ...]], ...] = (
    ("box of two lengths", lambda r: es.Box((1, 1)), SceneError, ("size", "(3,)")),
    ("box of negative size", lambda r: es.Box((1, 1, -1)), SceneError, ("-1.0",)),
    ("box in words", lambda r: es.Box("big"), SceneError, ("'big'",)),
    ("box that is not turned by a quaternion", lambda r: es.Box((1, 1, 1), quat=(0, 0, 0, 2)), SceneError, ("norm 2",)),
    ("sphere of NaN", lambda r: es.Sphere(_NAN), SceneError, ("nan",)),
    ("sphere of nothing", lambda r: es.Sphere(None), SceneError, ("None",)),
    ("sphere without a name", lambda r: es.Sphere(1.0, name=""), SceneError, ("''",)),
    ("cylinder of length 0", lambda r: es.Cylinder(0.1, 0.0), SceneError, ("length", "0")),
    ("capsule of infinite length", lambda r: es.Capsule(0.1, _INF), SceneError, ("inf",)),
    ("cone at NaN", lambda r: es.scene.Cone(0.1, 1.0, at=(0, _NAN, 0)), SceneError, ("at[1]",)),
    ("hull of a plane", lambda r: es.scene.ConvexHull(np.c_[np.eye(4)[:, :2], np.zeros(4)]), SceneError, ("flat",)),
    ("mesh from a missing file", lambda r: es.Mesh.from_file("gone.stl"), SceneError, ("gone.stl",)),
    ("voxels of nothing", lambda r: es.scene.Voxels(np.zeros((0, 3)), 0.1), SceneError, ("empty",)),
    ("points in the plane", lambda r: es.scene.Points(np.zeros((4, 2)), 0.1), SceneError, ("(4, 2)",)),
    ("twist of NaN", lambda r: es.Twist(linear=(_NAN, 0, 0)), SceneError, ("linear[0]",)),
    ("keyframes without times", lambda r: es.scene.Keyframes([], []), SceneError, ("empty",)),
    ("keyframes back in time", lambda r: es.scene.Keyframes([1, 0], np.zeros((2, 3))), SceneError, ("times[1] = 0",)),
    ("motion in words", lambda r: es.Box((1, 1, 1), motion="fast"), SceneError, ("'fast'",)),
    ("scene of numbers", lambda r: es.Scene([1]), SceneError, ("obstacle 0", "1")),
    ("scene of one obstacle without a list", lambda r: es.Scene(_BOX), SceneError, ("list",)),
    ("scene with a name twice", lambda r: es.Scene([_BOX, _BOX]), SceneError, ("'table'",)),
    ("scene at NaN", lambda r: es.Scene([_BOX]).at(_NAN), SceneError, ("nan",)),
    ("obstacle that is not there", lambda r: es.Scene([_BOX]).obstacle("tabel"), SceneError, ("'tabel'", "did you mean 'table'")),
    ("obstacle moved to no pose", lambda r: es.Scene([_BOX]).moved("table", 2 * np.eye(4)), SceneError, ("rigid",)),
    ("scene file that is missing", lambda r: es.read_scene("gone.yaml"), SceneError, ("gone.yaml",)),
    ("scene file to a missing folder", lambda r: es.write_scene(es.Scene([_BOX]), "no/such/scene.yaml"), InputError,
     ("no/such",)),
)  # fmt: skip

_PLANNING: tuple[tuple[str, Call, type[InputError], tuple[str, ...]], ...] = (
    ("parameters of another preset", lambda r: es.Deformer(r, PaperParams()), ParameterError, ("PaperParams",)),
    ("unknown parameter", lambda r: PaperParams().replaced(reach=1), ParameterError, ("'reach'",)),
    ("negative parameter", lambda r: es.DeformParams(k_r=-1.0), ParameterError, ("k_r=-1.0",)),
    ("parameter that is NaN", lambda r: es.DeformParams(influence=_NAN), ParameterError, ("influence=nan",)),
    ("parameter in words", lambda r: es.DeformParams(influence="far"), ParameterError, ("influence='far'",)),
    ("parameter that is true", lambda r: es.DeformParams(k_c=True), ParameterError, ("k_c=True",)),
    ("clearance below 0", lambda r: es.DeformParams(clearance=-0.1), ParameterError, ("clearance=-0.1",)),
    ("switch that is a number", lambda r: PaperParams(mobile_only=1), ParameterError, ("mobile_only=1",)),
    ("deformer of an unknown preset", lambda r: es.Deformer(r, "fast"), ParameterError, ("'fast'",)),
    ("deformer of a number", lambda r: es.Deformer(r, 3), ParameterError, ("3",)),
    ("step with a negative budget", lambda r: es.Deformer(r).step(_strip(r), es.Scene([]), budget=-1.0), ParameterError,
     ("budget=-1.0",)),
    ("step that lasts NaN", lambda r: es.Deformer(r).step(_strip(r), es.Scene([]), budget=_NAN), ParameterError, ("budget=nan",)),
    ("settle until Christmas", lambda r: es.Deformer(r).settle(_strip(r), es.Scene([]), until="Christmas"), ParameterError,
     ("'Christmas'",)),
    ("plan from NaN", lambda r: es.plan(r, es.Scene([]), _with(r.home_q, 0, _NAN), r.home_q), ConfigurationError, ("start", "nan")),
    ("plan to a short goal", lambda r: es.plan(r, es.Scene([]), r.home_q, [1, 2]), ConfigurationError, ("goal", "(2,)")),
    ("plan from two starts", lambda r: es.plan(r, es.Scene([]), [r.home_q] * 2, r.home_q), ConfigurationError, ("start", "(2, 11)")),
    ("plan from within an obstacle", lambda r: es.plan(r, es.Scene([_BOX]), r.home(2, 3), r.home()), ConfigurationError,
     ("start", "'table'", "mm deep")),
    ("plan to within an obstacle", lambda r: es.plan(r, es.Scene([_BOX]), r.home(), r.home(2, 3)), ConfigurationError,
     ("goal", "'table'", "mm deep")),
    ("plan with a negative seed", lambda r: es.plan(r, es.Scene([]), r.home(), r.home(1), seed=-1), ParameterError, ("seed=-1",)),
    ("plan with half a seed", lambda r: es.plan(r, es.Scene([]), r.home(), r.home(1), seed=0.5), ParameterError, ("seed=0.5",)),
    ("plan in no time", lambda r: es.plan(r, es.Scene([]), r.home(), r.home(1), timeout=0.0), ParameterError, ("timeout=0.0",)),
    ("plan for NaN seconds", lambda r: es.plan(r, es.Scene([]), r.home(), r.home(1), timeout=_NAN), ParameterError,
     ("timeout=nan",)),
    ("unknown scenario", lambda r: get_scenario("case-9"), ScenarioError, ("'case-9'", "did you mean")),
    ("scenario without a name", lambda r: get_scenario(""), ScenarioError, ("''",)),
    ("scenario file that is missing", lambda r: get_scenario("gone.yaml"), ScenarioError, ("gone.yaml",)),
    ("corridor of a negative seed", lambda r: get_scenario("corridor", seed=-1), ScenarioError, ("seed", "-1")),
    ("corridor of half a seed", lambda r: get_scenario("corridor", seed=0.5), ScenarioError, ("seed", "0.5")),
    ("scenario by an unknown preset", lambda r: run_scenario(get_scenario("case-1"), preset="fast"), ParameterError,
     ("'fast'",)),
    ("scenario with an unknown parameter", lambda r: run_scenario(get_scenario("case-1"), overrides={"reach": 1}),
     ParameterError, ("'reach'", "case-1")),
    ("scenario with half a tick", lambda r: run_scenario(get_scenario("case-1"), overrides={"max_ticks": 0.5}),
     ParameterError, ("max_ticks=0.5",)),
    ("scenario for an unknown robot", lambda r: get_scenario("case-1").load_robot("nobody"), RobotError, ("'nobody'",)),
)  # fmt: skip


def _strip(robot: es.RobotModel) -> es.Strip:
    return es.Strip(robot, [robot.home(), robot.home(0.1), robot.home(0.2)])


def call_cases() -> Iterator[CallCase]:
    """Every wrong call."""
    for case in (*_ROBOT, *_SCENE, *_PLANNING):
        yield CallCase(*case)
