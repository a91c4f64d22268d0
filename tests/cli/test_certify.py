"""``elastic-strips certify``: exit codes, what is printed and written, and errors that end with a message."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cases import each

from elastic_strips import proof_checker
from elastic_strips.cli import main
from elastic_strips.collision import certify
from elastic_strips.collision.proof import path_digest
from elastic_strips.io import load_path, read_scene, write_path
from elastic_strips.robot import RobotModel
from elastic_strips.viewer import Viewer

SCENE = "obstacles:\n  - {name: post, shape: box, size: [0.3, 0.3, 1.0], at: [2.0, 0.35, 0.5]}\n"
MOVES = """obstacles:
  - {name: ball, shape: sphere, radius: 0.3, at: [2, -2, 0.5], motion: {twist: {linear: [0, 1, 0]}}}
"""


def call(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["certify", *map(str, arguments)])
    assert isinstance(ended.value.code, int)
    return ended.value.code


@pytest.fixture
def folder(tmp_path: Path, silvermate: RobotModel) -> Path:
    """Scenes, a path through the post, and one beside it."""
    (tmp_path / "scene.yaml").write_text(SCENE)
    (tmp_path / "moves.yaml").write_text(MOVES)
    for name, y in (("through.csv", 0.0), ("beside.csv", -1.0)):
        write_path(tmp_path / name, silvermate, [silvermate.home(x=x, y=y) for x in np.linspace(0.0, 4.0, 17)])
    q = [silvermate.home(), silvermate.home(x=4.0)]
    write_path(tmp_path / "soon.json", silvermate, q, [0.0, 4.0])
    write_path(tmp_path / "late.json", silvermate, q, [6.0, 10.0])
    return tmp_path


def _robot(folder: Path, scene: str = "scene.yaml") -> list[object]:
    return ["--robot", "silvermate", "--scene", folder / scene]


def test_a_free_path_is_certified(folder, capsys):
    assert call(folder / "beside.csv", *_robot(folder), "--clearance", 0.1, "--json", folder / "a.json") == 0
    assert "certified: all 16 segments are proven" in capsys.readouterr().out
    answer = json.loads((folder / "a.json").read_text())
    assert answer["verdict"] == "certified"
    assert answer["least_clearance_m"] > 0.1
    assert answer["broken"] is None


def test_a_path_through_something_is_refuted(folder, capsys, silvermate):
    assert call(folder / "through.csv", *_robot(folder), "--json", folder / "a.json") == 3
    out = capsys.readouterr().out
    assert "refuted: segment" in out
    assert "deep in post" in out
    broken = json.loads((folder / "a.json").read_text())["broken"]
    assert broken["obstacle"] == "post"
    assert broken["distance_m"] < 0.0
    assert len(broken["q"]) == silvermate.nq


@each("size, answer", [([400, 400, 1000], 3), ([4, 4, 10], 0)])
def test_a_scene_in_millimetres_certifies_nothing(folder, size, answer):
    """A warning alone would not stop who looks at the exit code; what is far away and small may well be."""
    far = f"obstacles:\n  - {{name: post, shape: box, size: {size}, at: [3000, 350, 500]}}\n"
    (folder / "far.yaml").write_text(far)
    assert call(folder / "beside.csv", *_robot(folder, "far.yaml"), "--json", folder / "a.json") == answer
    assert (json.loads((folder / "a.json").read_text())["verdict"] == "certified") is (answer == 0)


@each("path", ["through.csv", "beside.csv"])
def test_a_path_is_drawn(folder, path):
    page = folder / "page.html"
    assert call(folder / path, *_robot(folder), "--html", page) == (3 if path == "through.csv" else 0)
    assert page.stat().st_size > 100_000


def test_the_repaired_path_is_drawn_where_one_is_written(folder, monkeypatch):
    shown, titles = [], []
    for name in ("show", "animate"):
        monkeypatch.setattr(Viewer, name, lambda self, robot, scene, report, name=name: shown.append((name, report)))
    for written in ([], ["--repair", folder / "free.csv"]):
        call(folder / "through.csv", *_robot(folder), *written, "--html", folder / "page.html")
        titles.append((folder / "page.html").read_text().split("<title>")[1].split("</title>")[0])
    assert "through.csv" in titles[0]
    assert "free.csv" in titles[1]
    (given_as, given), (repaired_as, repaired) = shown
    assert (given_as, given.status.value) == ("show", "refuted")
    assert (repaired_as, repaired.status.value) == ("animate", "certified")
    assert repaired.segments[1] > given.segments[1]


def test_it_is_pushed_free_and_proven_to_others(folder, capsys, silvermate):
    repaired, proof = folder / "free.csv", folder / "p.npz"
    arguments = [folder / "through.csv", *_robot(folder), "--clearance", 0.01]
    assert call(*arguments, "--repair", repaired, "--proof", proof, "--json", folder / "a.json") == 0
    assert "repaired: certified; moved by at most 0." in capsys.readouterr().out
    q = load_path(repaired, silvermate).q
    assert certify(silvermate, read_scene(folder / "scene.yaml"), q, clearance=0.01).certified
    answer = json.loads((folder / "a.json").read_text())
    assert answer["repair"]["certified"]
    least = certify(silvermate, read_scene(folder / "scene.yaml"), load_path(repaired, silvermate)).least
    assert answer["repair"]["least_m"] == pytest.approx(least, abs=1e-3)
    assert answer["repair"]["least_m"] > 0.0099
    assert answer["proof"]["path"] == path_digest(silvermate, load_path(repaired, silvermate), "arc")
    assert proof_checker.main([str(proof), "--path", answer["proof"]["path"]]) == 0
    said = capsys.readouterr().out.splitlines()[0]
    assert "PROVEN: clear by 0.01 m of obstacles" in said
    assert [what for what in ("robot", "scene", "path") if f"({what} " in said] == ["robot", "scene"], "not compared"
    assert proof_checker.main([str(proof), "--scene", "0" * 32]) == 3


def test_what_cannot_be_repaired_is_not_written(folder, monkeypatch, silvermate):
    shown = []
    monkeypatch.setattr(Viewer, "show", lambda self, robot, scene, report: shown.append(report))
    write_path(folder / "into.csv", silvermate, [silvermate.home(x=x) for x in (0.0, 1.0, 2.0)])
    assert (
        call(
            folder / "into.csv",
            *_robot(folder),
            "--repair",
            folder / "r.csv",
            "--json",
            folder / "a.json",
            "--html",
            folder / "page.html",
        )
        == 3
    )
    assert not (folder / "r.csv").exists()
    assert shown[0].segments[1] == 2, "the file's own path is drawn"
    assert not json.loads((folder / "a.json").read_text())["repair"]["certified"]
    assert json.loads((folder / "a.json").read_text())["repair"]["least_m"] is None


@each("name", ["pan", "shoulder_joint", "arm_1_joint"])
def test_a_joint_under_another_name_is_not_taken_to_be_at_home(folder, silvermate, name):
    """It is missing, then, and what stands for it is a column that nobody knows; that one may be at rest."""
    text = (folder / "beside.csv").read_text()
    assert "arm_1_joint" in text
    rows = [line.split(",") for line in text.split()]
    column = rows[0].index("arm_1_joint")
    for row in rows[1:]:
        row[column] = "0.7"
    rows[0][column] = name
    (folder / "other.csv").write_text("\n".join(",".join(row) for row in rows))
    own = name == "arm_1_joint"
    assert call(folder / "other.csv", *_robot(folder), "--json", folder / "a.json") == (0 if own else 3)
    assert json.loads((folder / "a.json").read_text())["verdict"] == ("certified" if own else "unknown")
    if not own:
        assert call(folder / "other.csv", *_robot(folder), "--ignore", name) == 0


def test_a_path_that_is_not_certified_has_no_proof(folder, capsys):
    assert call(folder / "through.csv", *_robot(folder), "--proof", folder / "p.npz") == 3
    assert "no proof" in capsys.readouterr().out
    assert not (folder / "p.npz").exists()


def test_times_count_where_something_moves(folder, capsys):
    assert call(folder / "soon.json", *_robot(folder, "moves.yaml")) == 3
    assert "ball" in capsys.readouterr().out
    assert call(folder / "late.json", *_robot(folder, "moves.yaml"), "--starts-at", 6) == 0
    assert call(folder / "late.json", *_robot(folder, "moves.yaml")) == 3  # how it comes to its first point is not said
    assert "certified" not in capsys.readouterr().out.splitlines()[-1]
    assert call(folder / "beside.csv", *_robot(folder, "moves.yaml")) == 2
    assert "ball" in capsys.readouterr().err
    assert (
        call(folder / "beside.csv", *_robot(folder, "moves.yaml"), "--scene-time", 0, "--json", folder / "a.json") == 0
    )
    assert any("ball" in note for note in json.loads((folder / "a.json").read_text())["notes"])
    assert call(folder / "soon.json", *_robot(folder, "moves.yaml"), "--scene-time", 2) == 3
    assert call(folder / "soon.json", *_robot(folder, "moves.yaml"), "--repair", folder / "r.csv") == 2
    assert not (folder / "r.csv").exists()


TURNS = """<robot name="turns"><link name="base"/>
  <link name="arm"><collision><origin xyz="0.4 0 0"/><geometry><box size="0.6 0.06 0.06"/></geometry></collision></link>
  <joint name="pan" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint></robot>
"""


def test_which_way_an_angle_goes_is_asked_for_and_proven(folder, capsys):
    (folder / "turns.urdf").write_text(TURNS)
    (folder / "post.yaml").write_text(
        "obstacles:\n  - {shape: box, name: post, size: [0.1, 0.1, 1], at: [0.55, 0, 0]}\n"
    )
    (folder / "long.csv").write_text("pan\n3.0\n-3.0\n")
    (folder / "turn.csv").write_text("pan\n0.5\n5.5\n")
    robot = ["--robot", folder / "turns.urdf", "--base", "fixed", "--scene", folder / "post.yaml"]
    for file, by_values in (("long.csv", 3), ("turn.csv", 0)):
        proof = folder / f"{file}.npz"
        assert call(folder / file, *robot, "--json", folder / "a.json", "--proof", proof) == 3
        answer = json.loads((folder / "a.json").read_text())
        assert answer["verdict"] == "unknown"
        assert answer["interpolation"] == "line"
        assert not proof.exists()
        assert call(folder / file, *robot, "--interpolation", "values", "--proof", proof) == by_values
        capsys.readouterr()
        if by_values == 0:
            name = proof_checker.path_digest(np.loadtxt(folder / file, skiprows=1, ndmin=2), "values")
            assert proof_checker.main([str(proof), "--path", name]) == 0
    assert call(folder / "long.csv", *robot, "--interpolation", "shortest", "--json", folder / "a.json") == 0
    assert any("pan" in note for note in json.loads((folder / "a.json").read_text())["notes"])


def test_what_appears_is_seen_from_the_command(folder):
    late = SCENE.replace("at: [2.0, 0.35, 0.5]", "at: [2.0, 0.0, 0.5], appears: 1.0")
    (folder / "late.yaml").write_text(late)
    assert call(folder / "soon.json", *_robot(folder, "late.yaml")) == 3
    assert call(folder / "through.csv", *_robot(folder, "late.yaml")) == 2  # it has no times
    assert call(folder / "through.csv", *_robot(folder, "late.yaml"), "--scene-time", 0.5) == 0
    assert call(folder / "soon.json", *_robot(folder, "late.yaml"), "--scene-time", 1.5) == 3


def test_a_base_goes_on_lines_or_arcs(folder, capsys, silvermate):
    """A quarter turn on the way: the arc bulges aside, over the place where the post is."""
    write_path(folder / "turn.csv", silvermate, [silvermate.home(), silvermate.home(x=4.0, yaw=2.6)])
    verdicts = {kind: call(folder / "turn.csv", *_robot(folder), "--interpolation", kind) for kind in ("line", "arc")}
    assert set(verdicts.values()) <= {0, 3}
    out = capsys.readouterr().out.splitlines()
    assert out[0] != out[1]


def test_a_path_that_is_not_all_of_the_file_is_unknown(folder, capsys, silvermate):
    """The base is nowhere in the file: the answer says what settles it, and nothing is written."""
    joints = ",".join(silvermate.joint_names)
    row = ",".join(map(str, silvermate.space.to_coordinates(silvermate.home_q)[3:]))
    (folder / "arm.csv").write_text(f"{joints}\n{row}\n{row}\n")
    arguments = [folder / "arm.csv", *_robot(folder)]
    written = ["--repair", folder / "r.csv", "--proof", folder / "p.npz", "--json", folder / "a.json"]
    assert call(*arguments, *written) == 3
    assert "--base-at" in capsys.readouterr().out
    answer = json.loads((folder / "a.json").read_text())
    assert answer["verdict"] == "unknown"
    assert len(answer["doubts"]) == 1
    assert not (folder / "r.csv").exists()
    assert not (folder / "p.npz").exists()
    assert call(*arguments, "--base-at", "-1,0,0.5") == 0
    assert call(*arguments, "--base-at", "2,0.35,0") == 3
    assert call(*arguments, "--base", "fixed") == 0
    assert call(*arguments, "--base-at", "2e4,0,0") == 2
    assert call(*arguments, "--base-at", -1, 0, 0.5) == 2


def test_a_unit_is_asked_for_in_the_line_of_the_answer(folder, capsys):
    """What follows from millimetres that are read as metres is no answer that somebody should read first."""
    (folder / "mm.csv").write_text("x,y,yaw\n0,0,0\n4000,0,0\n")
    assert call(folder / "mm.csv", *_robot(folder), "--json", folder / "a.json") == 3
    answer = json.loads((folder / "a.json").read_text())
    (line,) = (line for line in capsys.readouterr().out.splitlines() if "mm.csv:" in line)
    assert line.index(answer["doubts"][0]) < line.index(answer["reason"])


@each("options, said", [((), True), (("--base", "diff_drive"), False), (("--base", "omni"), False)])
def test_how_a_base_is_taken_to_move_is_said(folder, capsys, options, said):
    """Of a robot from a file, whose base goes, where nobody has said it."""
    (folder / "turns.urdf").write_text(TURNS)
    (folder / "goes.csv").write_text("x,y,yaw,pan\n0,-2,0,0\n1,-2,0,0\n")
    (folder / "stands.csv").write_text("x,y,yaw,pan\n0,-2,0,0\n0,-2,0,1\n")
    for file, goes in (("goes.csv", True), ("stands.csv", False)):
        assert call(folder / file, "--robot", folder / "turns.urdf", "--scene", folder / "scene.yaml", *options) == 0
        assert ("diff_drive" in capsys.readouterr().out) is (said and goes)


def test_which_way_an_angle_turns_is_said_where_its_values_leave_two(folder):
    """A yaw that turns by less than half a turn goes one way only."""
    for turn, said in ((1.0, False), (4.0, True)):
        (folder / "turn.csv").write_text(f"x,y,yaw\n0,-2,0\n0,-2,{turn}\n")
        arguments = [folder / "turn.csv", *_robot(folder), "--interpolation", "values", "--json", folder / "a.json"]
        assert call(*arguments) == 0
        notes = json.loads((folder / "a.json").read_text())["notes"]
        assert any("yaw" in note for note in notes) is said


def test_angles_and_columns_that_do_not_matter(folder, silvermate):
    (folder / "deg.csv").write_text("x,y,yaw,lamp\n0,-2,0,0\n1,-2,90,1\n")
    arguments = [folder / "deg.csv", *_robot(folder)]
    assert call(*arguments) == 3
    assert call(*arguments, "--ignore", "lamp") == 3  # degrees?
    assert call(*arguments, "--ignore", "lamp", "--angles", "deg") == 0
    assert call(*arguments, "--ignore", "lump", "--angles", "deg") == 2


@each(
    ("arguments", "message"),
    [
        (["missing.csv", "--robot", "silvermate", "--scene", "scene.yaml"], "cannot read the path file"),
        (["beside.csv", "--robot", "silvermate", "--scene", "missing.yaml"], "missing.yaml"),
        (["beside.csv", "--robot", "nobody", "--scene", "scene.yaml"], "nobody"),
        (["scene.yaml", "--robot", "silvermate", "--scene", "scene.yaml"], "no JointTrajectory"),
        (["beside.csv", "--robot", "panda", "--scene", "scene.yaml"], "panda"),
        (["beside.csv", "--robot", "silvermate", "--scene", "scene.yaml", "--clearance", "-1"], "clearance"),
        (["beside.csv", "--robot", "silvermate", "--scene", "scene.yaml", "--json", "no/a.json"], "no folder"),
        (["beside.csv", "--robot", "silvermate"], "--scene"),
    ],
)
def test_wrong_input_ends_with_a_message(folder, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(folder)
    assert call(*arguments) == 2
    err = capsys.readouterr().err
    assert message in err
    assert "Traceback" not in err


def test_the_answer_says_what_it_is_of(folder, capsys, silvermate):
    (folder / "empty.yaml").write_text("obstacles: []\n")
    assert call(folder / "beside.csv", *_robot(folder, "empty.yaml"), "--json", folder / "a.json") == 0
    answer = json.loads((folder / "a.json").read_text())
    assert answer["path"] == str(folder / "beside.csv")
    assert answer["scene"] == [str(folder / "empty.yaml")]
    assert answer["obstacles"] == 0
    assert "no obstacles" in answer["reason"]
    assert answer["held_still"] == pytest.approx(dict(silvermate.locked))
    said = capsys.readouterr().out
    assert all(joint in said for joint in answer["held_and_not_in_path"][:3])
    left_out = silvermate.unchecked_pairs
    assert [(tuple(pair["links"]), pair["why"]) for pair in answer["not_kept_apart"]] == [
        (pair.links, pair.why.value) for pair in left_out
    ]
    assert left_out
    assert f"{len(left_out)} pairs" in said
