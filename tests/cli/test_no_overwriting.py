"""No output of a command is a file that the same command reads, by whatever name and however it came to be read."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import trimesh
from cases import each
from PIL import Image

from elastic_strips.cli import main

URDF = """<robot name="cart">
  <link name="base"><visual><geometry><mesh filename="seen.stl"/></geometry></visual>
    <collision><geometry><mesh filename="hull.stl"/></geometry></collision></link>
  <link name="arm"><collision><geometry><box size="0.1 0.1 0.3"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.6"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
</robot>
"""
XACRO = """<robot name="cart" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="part.xacro"/></robot>
"""
SCENE = "obstacles:\n  - {name: post, shape: box, size: [0.3, 0.3, 1.0], at: [5.0, 0.35, 0.5]}\n"
MAP = "image: floor.png\nresolution: 0.1\norigin: [-3, -3, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
PATH = "base/x,base/y,base/yaw,turn\n0,0,0,0\n0.3,0,0,0.1\n"


def call(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main([*map(str, arguments)])
    assert isinstance(ended.value.code, int)
    return ended.value.code


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A robot with meshes, as URDF and xacro, a scene, a map with its image, a path, and a scenario that names all."""
    monkeypatch.chdir(tmp_path)
    for name in ("hull.stl", "seen.stl"):
        trimesh.creation.box((0.4, 0.3, 0.2)).export(tmp_path / name)
    body = URDF.removeprefix('<robot name="cart">\n').removesuffix("</robot>\n")
    Image.new("L", (60, 60), 254).save("floor.png")
    for name, text in (
        ("cart.urdf", URDF), ("cart.xacro", XACRO), ("scene.yaml", SCENE), ("floor.yaml", MAP), ("path.csv", PATH),
        ("part.xacro", f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro">{body}</robot>'),
        ("scenario.yaml", "robot: cart.urdf\nbase: omni\nstart: {x: 0}\ngoal: {x: 1}\nscene: scene.yaml\n"),
    ):  # fmt: skip
        Path(name).write_text(text)
    return tmp_path


def _refused(folder: Path, capsys: pytest.CaptureFixture[str], *arguments: object) -> None:
    """The command ends with a message, and every file is what it was."""
    before = {path: (path.read_bytes(), path.is_symlink()) for path in folder.rglob("*") if path.is_file()}
    assert call(*arguments) == 2
    said = capsys.readouterr().err
    assert "error:" in said
    assert "Traceback" not in said
    after = {path: (path.read_bytes(), path.is_symlink()) for path in folder.rglob("*") if path.is_file()}
    assert after == before


CERTIFY = ("certify", "path.csv", "--robot", "cart.urdf", "--scene", "scene.yaml")


@each("option", ["--json", "--repair", "--proof"])
@each("name", ["path.csv", "cart.urdf", "scene.yaml", "hull.stl", "seen.stl"])
def test_of_certify(folder, capsys, option, name):
    _refused(folder, capsys, *CERTIFY, option, name)


@pytest.mark.parametrize(
    "way", ["./x", "up and down", "absolute", "a link", "a link to a link", "a hard link", "a folder"]
)
@pytest.mark.parametrize("name", ["scene.yaml", "hull.stl"])
def test_other_names_of_the_same_file(folder, capsys, way, name):
    other = {
        "./x": f"./{name}", "up and down": f"../{folder.name}/{name}", "absolute": folder / name, "a link": "one",
        "a link to a link": "two", "a hard link": "three", "a folder": f"here/{name}",
    }[way]  # fmt: skip
    Path("one").symlink_to(name)
    Path("two").symlink_to("one")
    os.link(name, "three")
    Path("here").symlink_to(".")
    before = Path(name).read_bytes()
    assert call(*CERTIFY, "--json", other) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert Path(name).read_bytes() == before
    assert Path("one").is_symlink()


def test_an_input_by_a_link_is_not_overwritten_by_its_own_name(folder, capsys):
    Path("link.yaml").symlink_to("scene.yaml")
    arguments = ("certify", "path.csv", "--robot", "cart.urdf", "--scene", "link.yaml")
    _refused(folder, capsys, *arguments, "--json", "scene.yaml")


@pytest.mark.parametrize("name", ["floor.yaml", "floor.png"])
def test_the_image_of_a_map(folder, capsys, name):
    arguments = ("certify", "path.csv", "--robot", "cart.urdf", "--scene", "floor.yaml")
    _refused(folder, capsys, *arguments, "--json", name)


@each("name", ["cart.xacro", "part.xacro", "hull.stl"])
def test_what_a_xacro_file_includes(folder, capsys, name):
    pytest.importorskip("xacro")
    arguments = ("certify", "path.csv", "--robot", "cart.xacro", "--scene", "scene.yaml")
    _refused(folder, capsys, *arguments, "--json", name)


@pytest.mark.parametrize("name", ["scenario.yaml", "cart.urdf", "scene.yaml", "hull.stl", "seen.stl"])
@pytest.mark.parametrize("option", ["--json", "--html", "--trajectory"])
def test_of_run(folder, capsys, name, option):
    if option == "--trajectory":  # it has endings of its own
        Path("out.json").symlink_to(name)
        name = "out.json"
    _refused(folder, capsys, "run", "scenario.yaml", option, name)


@each("option", ["--json", "--record", "--html"])
def test_of_drive(folder, capsys, option):
    name = "scene.yaml"
    if option == "--record":
        Path("out.csv").symlink_to(name)
        name = "out.csv"
    _refused(folder, capsys, "drive", "scenario.yaml", "--time-limit", 0.2, option, name)


def test_of_a_sweep(folder, capsys):
    """Whose runs read the robot in processes of their own."""
    name = "hull.stl"
    Path("sweep.yaml").write_text("kind: plan\nscenarios: [scenario.yaml]\nseeds: [0]\n")
    before = Path(name).read_bytes()
    assert call("sweep", "sweep.yaml", "--json", name) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert Path(name).read_bytes() == before


def test_two_outputs_are_two_files(folder, capsys):
    Path("here").symlink_to(".")
    _refused(folder, capsys, *CERTIFY, "--json", "new.json", "--proof", "here/new.json")


def test_an_output_of_before_may_be_written_again(folder, capsys):
    for _ in range(2):
        assert call(*CERTIFY, "--json", "answer.json") == 0
    assert Path("answer.json").stat().st_size > 0


@pytest.mark.parametrize(
    "arguments",
    [
        CERTIFY,
        ("certify", "path.csv", "--robot", "cart.urdf", "--scene", "floor.yaml"),
        ("run", "scenario.yaml", "--trajectory", "t.json", "--html", "page.html"),
        ("drive", "scenario.yaml", "--time-limit", 0.2, "--record", "r.csv"),
    ],
    ids=["certify", "a map", "run", "drive"],
)
def test_they_do_their_work_where_every_output_has_a_name_of_its_own(folder, capsys, arguments):
    assert call(*arguments, "--json", "new.json") in (0, 3), capsys.readouterr().err
    assert Path("new.json").stat().st_size > 0
