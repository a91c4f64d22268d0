"""Wrong types, swapped arguments: the typed error that the README promises, short, and never an AttributeError."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from cases import refused

import elastic_strips as es
from elastic_strips.control import DriveParams, calibrate
from elastic_strips.control.tasks import DriveAndReach, DriveTo, ReachHand
from elastic_strips.errors import InputError
from elastic_strips.files import write_json
from elastic_strips.io import load_path, write_record
from elastic_strips.perception import SceneEstimator
from elastic_strips.sim import Fault, TaskSimulation, evaluate, simulation
from elastic_strips.sim.scenarios import (
    drive_document,
    drive_scenario,
    get_scenario,
    make_simulation,
    result_document,
    run_scenario,
)
from elastic_strips.sim.sensors import SensorSuite
from elastic_strips.strip import repair, strip_clearance
from elastic_strips.trajectory import MotionLimits, Retimer

WRONG = ("x", None, 3, 2.5, True, object(), [], {}, b"x", np.zeros(3))


@pytest.fixture(scope="module")
def sound(silvermate) -> dict[str, tuple[Callable[..., Any], dict[str, Any]]]:
    """Calls by name, each with sound arguments."""
    robot, scene, case = (
        silvermate,
        es.Scene([es.Box((1, 1, 1), at=(9, 9, 0.5), name="box")]),
        get_scenario("case-1"),
    )
    strip = es.Strip(robot, [robot.home(), robot.home(0.1), robot.home(0.2)])
    deformer = es.Deformer(robot)
    on = {"strip": strip, "scene": scene}
    viewer = es.Viewer(server=False)
    return {
        "Deformer": (es.Deformer, {"robot": robot, "params": es.DeformParams(), "constraint": None}),
        "step": (deformer.step, {**on, "budget": None, "prediction": None}),
        "settle": (deformer.settle, {**on, "max_ticks": 1, "until": "rest", "watch": None}),
        "certify": (deformer.certify, on),
        "assess": (deformer.assess, on),
        "Strip": (es.Strip, {"robot": robot, "q": strip.q}),
        "sample": (strip.sample, {"step": 0.1}),
        "strip_clearance": (strip_clearance, {**on, "tolerance": 1e-3}),
        "Scene": (es.Scene, {"obstacles": [], "time": 0.0}),
        "World": (es.World, {"scene": scene, "appears": {}}),
        "Sphere": (es.Sphere, {"radius": 1.0, "at": (0, 0, 0)}),
        "write_scene": (es.write_scene, {"scene": scene, "path": "a.yaml"}),
        "write_world": (es.io.write_world, {"world": es.World(scene), "path": "b.yaml"}),
        "write_json": (write_json, {"document": {}, "path": "c.json"}),
        "get_scenario": (get_scenario, {"name_or_path": "case-1", "seed": 0}),
        "run_scenario": (
            run_scenario, {"scenario": case, "robot": robot, "preset": "default", "seed": 0, "watch": None}
        ),
        "result_document": (result_document, {"result": None}),
        "drive_document": (drive_document, {"outcome": None}),
        "drive_scenario": (drive_scenario, {"scenario": case, "method": "strip", "robot": robot, "plant": "kinematic"}),
        "make_simulation": (
            make_simulation, {"scenario": case, "robot": robot, "seed": 0, "params": None, "sensors": None}
        ),
        "simulation": (
            simulation,
            {
                "robot": robot, "world": scene, "start": robot.home(), "goal": robot.home(0.2), "params": None,
                "limits": None, "plant": None, "perception": None, "replanner": None, "faults": (), "seed": 0,
                "watch": None,
            },
        ),
        "TaskSimulation": (
            TaskSimulation,
            {"robot": robot, "world": scene, "start": robot.home(), "task": DriveTo(0.2, 0.0, 0.0), "params": None},
        ),
        "DriveTo": (DriveTo, {"x": 0.0, "y": 0.0, "yaw": 0.0}),
        "ReachHand": (ReachHand, {"position": (1, 0, 1)}),
        "DriveAndReach": (DriveAndReach, {"drive": DriveTo(0, 0, 0), "reach": ReachHand((1, 0, 1))}),
        "DriveParams": (DriveParams, {"deform": es.DeformParams(), "speeds": (1.0,), "margin": 0.1, "plan_every": 2}),
        "DeformParams": (es.DeformParams, {"influence": 1.0, "max_ticks": 2}),
        "MotionLimits": (MotionLimits.for_robot, {"robot": robot}),
        "Retimer": (Retimer, {"robot": robot, "limits": None}),
        "evaluate": (evaluate, {"run": "nothing", "robot": robot}),
        "write_record": (write_record, {"record": None, "path": "e.npz"}),
        "load_path": (
            load_path,
            {
                "path": strip.q, "robot": robot, "joint_names": None, "times": None, "space": None, "base_at": None,
                "angles": None, "ignore": (), "starts_at": None,
            },
        ),
        "repair": (repair, {"robot": robot, "scene": scene, "path": strip, "params": None, "max_ticks": 3}),
        "calibrate": (calibrate, {"record": (), "robot": robot, "limits": None, "params": None}),
        "SceneEstimator": (SceneEstimator, {"params": None}),
        "Fault": (Fault.parse, {"text": "scene_frozen@2"}),
        "SensorSuite": (SensorSuite, {"robot": robot, "world": es.World(scene), "config": None, "seed": 0}),
        "Viewer": (es.Viewer, {"server": False, "ghosts": 3, "port": None, "title": "t"}),
        "show": (viewer.show, {"robot": robot, "scene": scene, "strip_or_report": strip}),
        "update": (viewer.update, {"report": strip, "scene": scene}),
        "animate": (viewer.animate, {"robot": robot, "scene": scene, "strips": strip, "duration": 1.0}),
        "save_html": (viewer.save_html, {"path": "d.html"}),
    }  # fmt: skip


SLOW = {("run_scenario", "robot"), ("simulation", "goal")}  # what is right takes long, and is shown elsewhere


def test_a_wrong_type_is_a_wrong_input(sound, silvermate, tmp_path, monkeypatch):
    """Each argument of each call in turn: what is not taken is refused in one short sentence."""
    monkeypatch.chdir(tmp_path)
    found, refused = [], 0
    for name, (call, arguments) in sound.items():
        others = [v for v in arguments.values() if isinstance(v, (es.RobotModel, es.Scene, es.Strip))]
        for key, value in arguments.items():
            for wrong in (*WRONG, silvermate, *others):
                if wrong is value or (value is None and wrong is None) or (name, key) in SLOW:
                    continue
                if name in ("run_scenario", "drive_scenario", "make_simulation") and any(
                    wrong is v for v in _taken(key)
                ):
                    continue
                try:
                    call(**{**arguments, key: wrong})
                except InputError as error:
                    refused += 1
                    if len(str(error)) > 600 or "\n" in str(error):
                        found.append((name, key, "long", str(error)[:80]))
                except Exception as error:
                    found.append((name, key, repr(wrong)[:40], f"{type(error).__name__}: {error}"[:100]))
    assert found == []
    assert refused > 500


def _taken(key: str) -> tuple[object, ...]:
    """What is right after all, and would be run."""
    return {"robot": (None,), "preset": (None,), "seed": (None, 3)}.get(key, ())


def test_the_message_says_what_it_is_instead(silvermate):
    scene = es.Scene()
    with refused(InputError, "robot"):
        es.Viewer(server=False).show(scene, silvermate, silvermate)  # type: ignore[arg-type]
    with refused(InputError, "scene"):
        es.Deformer(silvermate).settle(es.Strip(silvermate, [silvermate.home(), silvermate.home(0.1)]), None)  # type: ignore[arg-type]
    strip = es.Strip(silvermate, [silvermate.home(), silvermate.home(0.1)])
    with refused(InputError, "max_ticks=2.5"):
        es.Deformer(silvermate).settle(strip, scene, max_ticks=2.5)  # type: ignore[arg-type]
