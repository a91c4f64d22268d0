"""``elastic-strips robot``: the card on the terminal, as JSON and as a page; what options and files say of shapes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from elastic_strips.cli.group import cli
from elastic_strips.errors import ParameterError
from elastic_strips.io.scene_file import read_scenario
from elastic_strips.robot import load_robot
from elastic_strips.trajectory import MotionLimits

URDF = """<robot name="r"><link name="base"><collision><geometry><box size="0.5 0.4 0.2"/></geometry></collision></link>
<link name="arm"><visual><geometry><box size="0.4 0.1 0.1"/></geometry></visual></link>
<joint name="yaw" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.5"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="2"/></joint></robot>"""
BARE = "Links that are drawn and have no collision shape"


@pytest.fixture
def urdf(tmp_path: Path) -> str:
    path = tmp_path / "r.urdf"
    path.write_text(URDF)
    return str(path)


def run(*arguments: str) -> Result:
    return CliRunner().invoke(cli, list(arguments))


def tables(file: Path) -> dict[str, list[dict[str, str]]]:
    return {table["title"]: table["rows"] for table in json.loads(file.read_text())["tables"]}


def test_the_card_is_said_and_written(urdf: str, tmp_path: Path) -> None:
    page, document = tmp_path / "card.html", tmp_path / "card.json"
    done = run("robot", urdf, "--base", "omni", "--html", str(page), "--json", str(document))
    assert done.exit_code == 0, done.output
    assert BARE in done.output
    found = tables(document)
    assert found[BARE] == [{"link": "arm"}]
    assert found["Joints that are planned"][0]["joint"] == "yaw"
    assert {row["by"].partition(":")[0] for row in found["Speeds and accelerations"]} == {"URDF", "assumed"}
    given = run("robot", urdf, "--base", "omni", "--base-speed", "0.4,0.4,0.8", "--json", str(document))
    assert given.exit_code == 0, given.output
    assert "option" in {row["by"] for row in tables(document)["Speeds and accelerations"]}
    text = page.read_text()
    assert "<iframe" in text
    assert BARE in text
    assert "http://" not in text.split("<iframe")[0]


def test_what_is_not_known_of_wheels_is_said_whole(urdf: str) -> None:
    """With the remedy, which a narrow column would cut."""
    done = run("robot", urdf)
    assert done.exit_code == 0, done.output
    line = next(line for line in done.output.splitlines() if line.startswith("Speeds and accelerations"))
    with pytest.raises(ParameterError) as found:
        MotionLimits.for_robot(load_robot(urdf), joint_speed={"yaw": 1.0})
    assert str(found.value) in line


def test_options_change_it(urdf: str, tmp_path: Path) -> None:
    document = tmp_path / "card.json"
    done = run("robot", urdf, "--base", "omni", "--visual-as-collision", "missing", "--joint-speed", "yaw=0.5",
               "--json", str(document))  # fmt: skip
    assert done.exit_code == 0, done.output
    found = tables(document)
    assert found[BARE] == []
    assert {"what": "speed of yaw", "value": "0.5 rad/s", "by": "option"} in found["Speeds and accelerations"]


def test_a_robot_by_name_and_wheels_that_are_not_known(urdf: str) -> None:
    done = run("robot", "silvermate")
    assert done.exit_code == 0, done.output
    assert "track" in done.output
    done = run("robot", urdf, "--base", "diff_drive")
    assert done.exit_code == 0, done.output
    assert "not known" in done.output


def test_wrong_names_end_without_a_traceback(urdf: str) -> None:
    for arguments in (["nobody"], [urdf, "--visual-as-collision", "amr"], [urdf, "--lock", "arm=x"]):
        done = run("robot", *arguments)
        assert done.exit_code != 0
    both = run("robot", urdf, "--visual-as-collision", "missing", "--visual-as-collision", "arm")
    assert both.exit_code == 2


def test_no_output_replaces_the_robot(urdf: str) -> None:
    assert run("robot", urdf, "--json", urdf).exit_code != 0
    assert Path(urdf).read_text() == URDF


def test_a_certificate_names_what_it_does_not_speak_of(urdf: str, tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text("obstacles: []\n")
    (tmp_path / "path.csv").write_text("yaw\n0\n0.5\n")
    answer = tmp_path / "answer.json"
    done = run("certify", str(tmp_path / "path.csv"), "--robot", urdf, "--base", "fixed", "--scene",
               str(tmp_path / "scene.yaml"), "--json", str(answer))  # fmt: skip
    assert done.exit_code == 0, done.output
    document = json.loads(answer.read_text())
    assert document["links_without_shape"] == ["arm"]
    assert "arm" in document["reason"]


@pytest.mark.parametrize("given, bare", [("missing", ()), ("[arm]", ()), (None, ("arm",))])
def test_scenario_files_say_it_too(urdf: str, tmp_path: Path, given: str | None, bare: tuple[str, ...]) -> None:
    more = "" if given is None else f", visual_as_collision: {given}"
    file = tmp_path / "s.yaml"
    file.write_text(f"robot: {{name: r.urdf{more}}}\nscene: {{obstacles: []}}\nstart: {{}}\ngoal: {{x: 1}}\n")
    spec = read_scenario(file)
    assert load_robot(spec.robot, base="omni", **spec.robot_options).bare_links == bare
