"""Scenario files: the documented example loads; wrong files name file, line and key."""

import json
import re
from pathlib import Path

import pytest
from cases import each, refused

from elastic_strips.errors import ScenarioError, SceneError
from elastic_strips.io import PoseSpec, read_scenario, read_world
from elastic_strips.sim.scenarios import get_scenario

DOCS = Path(__file__).parents[3] / "docs" / "scene-files.md"
SHORT = "robot: silvermate\nscene: {obstacles: []}\nstart: {x: 1}\ngoal: {}\n"


def read(tmp_path, text):
    path = tmp_path / "case.yaml"
    path.write_text(text, encoding="utf-8")
    return read_scenario(path)


def test_documented_example_loads(tmp_path):
    (text,) = re.findall(r"```yaml scenario\n(.*?)```", DOCS.read_text(encoding="utf-8"), flags=re.DOTALL)
    spec = read(tmp_path, text)
    assert (spec.name, spec.robot, spec.base, spec.preset) == ("table-and-cart", "silvermate", "diff_drive", "default")
    assert spec.params == {"influence": 0.35}
    assert spec.start == PoseSpec(x=-1.0)
    assert spec.goal == PoseSpec(x=6.0, y=0.5)
    assert spec.seed == 7
    assert spec.scene.names == ("table", "cart")
    assert spec.path == tmp_path / "case.yaml"


def test_defaults(tmp_path):
    spec = read(tmp_path, SHORT)
    assert (spec.name, spec.description, spec.base, spec.preset, spec.params, spec.seed) == (
        "case",
        "",
        None,
        None,
        {},
        0,
    )
    assert spec.start == PoseSpec(x=1.0)
    assert len(spec.scene) == 0


def test_joints(tmp_path):
    spec = read(tmp_path, SHORT.replace("{x: 1}", "{yaw: -1e-1, joints: {lift: 2e-1, elbow: -1}}"))
    assert spec.start == PoseSpec(yaw=-0.1, joints={"lift": 0.2, "elbow": -1.0})


def test_scene_and_urdf_files_are_relative_to_the_scenario(tmp_path, monkeypatch):
    (tmp_path / "world").mkdir()
    (tmp_path / "world" / "room.yaml").write_text("obstacles: [{shape: points, radius: 0.1, file: scan.csv}]")
    (tmp_path / "world" / "scan.csv").write_text("1,2,3\n")
    (tmp_path / "world" / "bot.urdf").write_text("<robot name='bot'/>")
    monkeypatch.chdir("/")
    text = SHORT.replace("{obstacles: []}", "world/room.yaml").replace("silvermate", "world/bot.urdf")
    spec = read(tmp_path, text)
    assert spec.scene.names == ("points-0",)
    assert spec.robot == str(tmp_path / "world" / "bot.urdf")


def test_a_scenario_holds_who_appears_later(tmp_path):
    """The scenario's scene is what exists at its time, its world holds the rest."""
    text = SHORT.replace("[]", "[{shape: sphere, radius: 1, appears: 2, at: [0, 0, 9]}, {shape: sphere, radius: 2}]")
    spec = read(tmp_path, text)
    assert spec.scene.names == ("sphere-1",)
    assert spec.world.at(2.0).names == ("sphere-0", "sphere-1")
    scenario = get_scenario(tmp_path / "case.yaml")
    assert scenario.scene.names == spec.scene.names
    assert scenario.world.at(2.0).names == ("sphere-0", "sphere-1")
    assert get_scenario("case-1").world.at(3.0).names == get_scenario("case-1").scene.names


BAD = [
    ("[]", 1, "must be a mapping of a scenario"),
    (SHORT.replace("robot", "robbot"), 1, "unknown key 'robbot' of a scenario; did you mean 'robot'"),
    (SHORT.replace("goal: {}\n", ""), 1, "'goal' is missing"),
    (SHORT.replace("silvermate", "5"), 1, "robot: must be a non-empty string"),
    (SHORT.replace("silvermate", "gone.urdf"), 1, "no URDF file"),
    (SHORT.replace("silvermate", "./gone"), 1, "no URDF file"),
    (SHORT + "base: diffdrive\n", 5, "base: unknown value 'diffdrive'; did you mean 'diff_drive'"),
    (SHORT + "preset: papers\n", 5, "did you mean 'paper'"),
    (SHORT + "params: [1]\n", 5, "mapping of names to numbers"),
    (SHORT + "params:\n  influence: true\n", 6, r"params\.influence: must be a number, not True"),
    (SHORT + "params:\n  influence: .nan\n", 6, "finite"),
    (SHORT + "seed: -1\n", 5, r"seed: is -1, outside \[0, 4294967295\]"),
    (SHORT + "seed: 1.5\n", 5, "integer"),
    (SHORT + "seed: true\n", 5, "integer"),
    (SHORT + "version: 3\n", 5, "version"),
    (SHORT + "name: ''\n", 5, "name"),
    (SHORT + "description: [a]\n", 5, "description"),
    (SHORT.replace("{x: 1}", "{x: one}"), 3, r"start\.x: must be a number, not 'one'"),
    (SHORT.replace("{x: 1}", "{z: 1}"), 3, "unknown key 'z' of a pose"),
    (SHORT.replace("{x: 1}", "[0, 0, 0]"), 3, "must be a mapping of a pose"),
    (SHORT.replace("{x: 1}", "{joints: {a: x}}"), 3, r"start\.joints\.a: must be a number"),
    (SHORT.replace("{x: 1}", "{x: 1e9}"), 3, "1000000000.0 must be .* ≤ 1e"),
    (
        SHORT.replace("{obstacles: []}", "{obstacles: [{shape: sphere}]}"),
        2,
        r"scene\.obstacles\[0\]: .*'radius' is missing",
    ),
    (SHORT.replace("{obstacles: []}", "5"), 2, "mapping of a scene"),
]


@each("text, line, message", BAD)
def test_a_wrong_file_names_file_line_and_key(tmp_path, text, line, message):
    with pytest.raises(ScenarioError, match=message) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path / 'case.yaml'}:{line}: ")


def test_trouble_in_the_scene_file_is_a_scenario_error_that_names_that_file(tmp_path):
    with refused(ScenarioError, "gone.yaml:"):
        read(tmp_path, SHORT.replace("{obstacles: []}", "gone.yaml"))
    (tmp_path / "room.yaml").write_text("obstacles:\n- shape: sphere\n  radius: -1\n")
    with refused(ScenarioError, "room.yaml:3:", "obstacles", "[0]"):
        read(tmp_path, SHORT.replace("{obstacles: []}", "room.yaml"))


MOVEIT = "room+\n* crate\n2 0 0\n0 0 0 1\n1\nbox\n1 1 1\n0 0 0.5\n0 0 0 1\n0.6 0.4 0.2 1\n0\n.\n"
MAP = "image: map.pgm\nresolution: 0.5\norigin: [0, 0, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.25\nnegate: 0\n"


def test_a_scenario_names_scenes_of_other_formats(tmp_path, caplog):
    """What is left out of them is said."""
    (tmp_path / "room.scene").write_text(MOVEIT)
    spec = read(tmp_path, SHORT.replace("{obstacles: []}", "room.scene"))
    assert spec.scene.names == ("crate",)
    assert "left out: 1 colours" in caplog.text
    (tmp_path / "map.pgm").write_bytes(b"P5\n2 1\n255\n\x00\xfe")
    (tmp_path / "map.yaml").write_text(MAP)
    spec = read(tmp_path, SHORT.replace("{obstacles: []}", "{file: map.yaml, outside: free}"))
    assert spec.scene.names == ("map",)
    assert read_world(tmp_path / "map.yaml").scene.names[0] == "map"


@each(
    "name, text, message",
    [
        ("room.scene", MOVEIT.replace("1 1 1", "1 one 1"), r"room\.scene:7: 'one'"),
        ("map.yaml", MAP.replace("0.5", "-1"), r"map\.yaml:2: resolution"),
        ("scan.pcd", "", r"scan\.pcd: .*\{shape: points, file: scan\.pcd, radius: …\}"),
    ],
)
def test_trouble_in_scenes_of_other_formats_is_a_scenario_error(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(ScenarioError, match=message):
        read(tmp_path, SHORT.replace("{obstacles: []}", name))
    with pytest.raises(SceneError, match=message):
        read_world(tmp_path / name)


@each(
    "name, text, message",
    [
        ("room.yaml", "version: 1\nobstacles: []\n", r"room\.yaml:2: .*a scene file.*'scene: room\.yaml'.*goal"),
        ("map.yaml", MAP, r"map\.yaml:1: .*a scene file.*'scene: map\.yaml'"),
        ("room.scene", MOVEIT, r"room\.scene: .*a scene file.*'scene: room\.scene'"),
        ("room.bt", "", r"a scene file.*'scene: room\.bt'"),
        ("bot.urdf", "<robot/>", r"bot\.urdf: .*a robot.*--robot"),
        ("bot.urdf.xacro", "<robot/>", r"a robot.*--robot"),
    ],
)
def test_files_of_other_kinds_are_told_from_scenarios(tmp_path, monkeypatch, name, text, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text(text)
    for given in (name, tmp_path / name):
        with pytest.raises(ScenarioError, match=message):
            get_scenario(given)
        with pytest.raises(ScenarioError, match=message):
            read_scenario(given)


@each(
    ("frame", "at", "known"),
    [
        ("world", "", True), ("panda_link0", "", True), ("panda_hand", "", False), ("camera_link", "", False),
        ("panda_hand", ", at: [1, 0, 0]", True), ("camera_link", ", at: [1, 0, 0]", True),
    ],
)  # fmt: skip
def test_a_scene_in_a_frame_of_nobody_or_of_what_moves_is_no_world(tmp_path, frame, at, known):
    place = {"position": {"x": 1.0, "y": 0.0, "z": 0.0}, "orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}}
    shape = {"primitives": [{"type": 1, "dimensions": [0.1, 0.1, 0.1]}], "primitive_poses": [place]}
    thing = {"id": "a", "header": {"frame_id": frame}, "pose": place, "operation": 0, **shape}
    (tmp_path / "scene.json").write_text(json.dumps({"world": {"collision_objects": [thing]}}))
    for scene in (f"{{file: scene.json{at}}}", f"{{sources: [{{file: scene.json{at}}}]}}"):
        text = "robot: panda\nbase: fixed\nstart: {}\ngoal: {joints: {panda_joint1: 0.5}}\nscene: "
        (tmp_path / "s.yaml").write_text(text + scene)
        scenario = get_scenario(str(tmp_path / "s.yaml"))
        if known:
            assert scenario.load_robot().name == "panda"
        else:
            with pytest.raises(ScenarioError, match=frame):
                scenario.load_robot()
