"""The user's own robot on the command line and in scenario files: what is planned, what is held still, its files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cases import each

from elastic_strips.cli import main
from elastic_strips.errors import ConfigurationError, ScenarioError
from elastic_strips.robot import load_robot
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.sim.sweep import read_sweep, run_sweep
from elastic_strips.sim.sweep.store import SweepStore

BOX = '<geometry><box size="0.3 0.3 0.2"/></geometry>'
STL = "solid\n" + "".join(
    f"facet normal 0 0 1\nouter loop\n{''.join(f'vertex {p}{chr(10)}' for p in face)}endloop\nendfacet\n"
    for face in (("0 0 0", "0 .1 0", ".1 0 0"), ("0 0 0", ".1 0 0", "0 0 .1"), ("0 0 0", "0 0 .1", "0 .1 0"),
                 (".1 0 0", "0 .1 0", "0 0 .1"))
) + "endsolid\n"  # fmt: skip


def _joint(name: str, parent: str, kind: str = "revolute", more: str = "") -> str:
    limit = '<limit lower="-1" upper="1" velocity="1" effort="1"/>'
    return (
        f'<link name="{name}_l"><collision><geometry><mesh filename="package://parts/a.stl"/></geometry></collision>'
        f'</link><joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_l"/>'
        f'<origin xyz="0.2 0 0.3"/><axis xyz="0 1 0"/>{limit}{more}</joint>'
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A robot, its SRDF, its mesh where nobody looks for it, and a scenario beside them."""
    (tmp_path / "far" / "parts").mkdir(parents=True)
    (tmp_path / "far" / "parts" / "a.stl").write_text(STL)
    parts = [_joint("lift", "base"), _joint("elbow", "lift_l"), _joint("thumb", "elbow_l")]
    parts += [_joint("finger", "elbow_l", more='<mimic joint="thumb"/>'), _joint("drv", "base", "continuous")]
    text = f'<robot name="bot"><link name="base"><collision>{BOX}</collision></link>{"".join(parts)}</robot>'
    (tmp_path / "bot.urdf").write_text(text)
    group = '<group name="upper"><joint name="lift"/></group>'
    state = '<group_state name="home"><joint name="elbow" value="0.25"/></group_state>'
    (tmp_path / "bot.srdf").write_text(f'<robot name="bot">{group}{state}</robot>')
    (tmp_path / "free.yaml").write_text("robot: jackal-box\nscene: {obstacles: []}\nstart: {x: 0}\ngoal: {x: 0.4}\n")
    return tmp_path


def _own(folder: Path, robot: str) -> Path:
    """The scenario with another line about its robot."""
    file = folder / "own.yaml"
    file.write_text((folder / "free.yaml").read_text().replace("jackal-box", robot))
    return file


def _call(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code


def test_it_says_what_it_plans_and_what_not(folder, capsys):
    robot = ("--robot", folder / "bot.urdf", "--package-dir", folder / "far")
    assert _call("run", folder / "free.yaml", *robot) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "bot plans 2 joints: lift, elbow; locked: drv, finger, thumb"
    assert _call("run", folder / "free.yaml") == 0
    assert "locked" not in capsys.readouterr().out  # it is known by its name
    more = ("--joints", "lift, drv", "--lock", "thumb=0.5", "--srdf", folder / "bot.srdf")
    assert _call("run", folder / "free.yaml", *robot, *more, "--json", "-") == 0
    captured = capsys.readouterr()
    assert "bot plans 2 joints: drv, lift; locked: " in captured.err
    assert json.loads(captured.out)["locked"] == {"elbow": 0.25, "thumb": 0.5, "finger": 0.5}


@each("command", ["run", "drive", "drag"])
@each(
    "more, words",
    [
        (["--joints", "lft"], "cannot plan 'lft'; did you mean 'lift'"),
        (["--joints", "finger"], "cannot plan 'finger' alone: it has to <mimic> 'thumb'"),
        (["--joints", "lift,thumb", "--lock", "finger=0.1"], "'finger' follows 'thumb'"),
        (["--lock", "lift"], "'lift' has to be NAME=VALUE"),
        (["--lock", "lift=nan"], "nan is not a finite number"),
        (["--lock", "lft=0"], "unknown joint 'lft'; did you mean 'lift'"),
        (["--package-dir", "nowhere"], "'nowhere' does not exist"),
        (["--srdf", "no.srdf"], "cannot read the SRDF file"),
        ([], "Name the folder that holds 'parts': package_dirs=[…], --package-dir"),
    ],
)
def test_wrong_options_end_with_a_message(folder, capsys, command, more, words):
    place = [] if not more or "nowhere" in more else ["--package-dir", folder / "far"]
    assert _call(command, folder / "free.yaml", "--robot", folder / "bot.urdf", *place, *more) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert words in said
    assert "Traceback" not in said


def test_a_scenario_file_says_the_same(folder, capsys):
    keys = "{name: bot.urdf, package_dirs: [far], srdf: bot.srdf, joints: [lift], locked: {thumb: 0.5}}"
    scenario = get_scenario(_own(folder, keys))
    robot = scenario.load_robot()
    assert robot.joint_names == ("lift",)
    assert robot.locked == {"drv": 0.0, "elbow": 0.25, "finger": 0.5, "thumb": 0.5}
    assert scenario.load_robot("jackal-box").name == "jackal-box"  # what is said is of its own robot
    assert scenario.load_robot(options={"joints": ["elbow"]}).joint_names == ("elbow",)
    group = get_scenario(_own(folder, "{name: bot.urdf, package_dirs: [far], srdf: bot.srdf, group: upper}"))
    assert group.load_robot().joint_names == ("lift",)
    assert _call("run", folder / "own.yaml") == 0
    assert "bot plans 1 joint: lift; locked: " in capsys.readouterr().out


def test_joints_that_it_does_not_plan_are_refused(folder, capsys, caplog):
    """Also where none of those that are named is one of its own; a robot that is not the scenario's is at home."""
    keys = "{name: bot.urdf, package_dirs: [far], srdf: bot.srdf, joints: [lift]}"
    for end, joints in (("start", "{elbw: 0.1}"), ("goal", "{lift: 0.1, elbw: 0.2}"), ("start", "{thumb: 0.2}")):
        file = _own(folder, keys)
        x = "x: 0.4" if end == "goal" else "x: 0"
        file.write_text(file.read_text().replace(f"{end}: {{{x}", f"{end}: {{{x}, joints: {joints}"))
        scenario = get_scenario(file)
        with pytest.raises(ConfigurationError, match="thumb" if "thumb" in joints else "elbw"):
            scenario.ends(scenario.load_robot())
        assert _call("run", file) == 2
    assert "Traceback" not in capsys.readouterr().err
    file = _own(folder, "silvermate")
    file.write_text(file.read_text().replace("{x: 0}", "{x: 0, joints: {arm_1_joint: 0.4}}"))
    other = load_robot("jackal-box")
    assert get_scenario(file).start_of(other).tolist() == other.home().tolist()
    assert "arm_1_joint" in caplog.text


def test_a_base_that_is_assumed_is_said(folder, capsys):
    robot = ("--robot", folder / "bot.urdf", "--package-dir", folder / "far")
    assert _call("run", folder / "free.yaml", *robot) == 0
    assert "--base" in capsys.readouterr().out
    assert _call("run", folder / "free.yaml", *robot, "--base", "omni") == 0
    assert _call("run", folder / "free.yaml") == 0
    assert "--base" not in capsys.readouterr().out
    assert _call("robot", folder / "bot.urdf", "--package-dir", folder / "far") == 0
    assert "--base" in capsys.readouterr().out
    assert _call("robot", "silvermate") == 0
    assert "--base" not in capsys.readouterr().out


def test_arguments_of_xacro_files_are_given(folder, capsys):
    robot = ("--robot", folder / "bot.urdf", "--package-dir", folder / "far")
    (folder / "bot.urdf.xacro").write_text((folder / "bot.urdf").read_text())
    keys = "{name: bot.urdf.xacro, mappings: {arm: true, fingers: 2, tool: cup}}"
    scenario = get_scenario(_own(folder, keys))
    assert scenario.robot_options["mappings"] == {"arm": "true", "fingers": "2", "tool": "cup"}
    assert _call("run", folder / "free.yaml", *robot, "--xacro-arg", "arm=true") == 2
    assert "mappings" in capsys.readouterr().err  # of a file that is none
    assert _call("run", folder / "free.yaml", *robot, "--xacro-arg", "arm") == 2
    assert "NAME=VALUE" in capsys.readouterr().err


@each(
    "robot, words",
    [
        ("{joints: [lift]}", "'name'"),
        ("{name: bot.urdf, lock: {}}", "'lock'"),
        ("{name: bot.urdf, joints: lift}", "list"),
        ("{name: bot.urdf, locked: {thumb: open}}", "thumb"),
    ],
)
def test_wrong_keys_are_refused(folder, robot, words):
    with pytest.raises(ScenarioError, match=words):
        get_scenario(_own(folder, robot))


def test_a_sweep_takes_what_scenarios_say(folder):
    _own(folder, "{name: bot.urdf, package_dirs: [far], joints: [lift]}")
    (folder / "sweep.yaml").write_text("scenarios: [own.yaml]\nkind: plan\n")
    with SweepStore(read_sweep(folder / "sweep.yaml"), folder / "table.csv") as store:
        rows = list(run_sweep(store, processes=1))
    assert [row["error"] for row in rows] == [None]
