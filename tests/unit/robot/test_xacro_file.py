"""xacro files: the robot is that of the URDF which they expand to; arguments, packages, and what is refused."""

from __future__ import annotations

import getpass
import logging
import re
import subprocess
import sys
from pathlib import Path

import pytest
from cases import each, refused

import elastic_strips as es
from elastic_strips import xacro_process
from elastic_strips.errors import RobotError
from elastic_strips.robot.xacro_file import expand_xacro
from elastic_strips.trajectory import MotionLimits

pytest.importorskip("xacro")
pytestmark = pytest.mark.process

ARM = """<?xml version="1.0"?>
<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="segment" params="name parent length">
    <link name="${name}"><collision><origin xyz="0 0 ${length / 2}"/><geometry>
      <box size="0.05 0.05 ${length}"/></geometry></collision></link>
    <joint name="${name}_joint" type="revolute"><parent link="${parent}"/><child link="${name}"/>
      <origin xyz="0 0 0.3"/><axis xyz="0 1 0"/><limit lower="-${pi / 2}" upper="${pi / 2}" velocity="1.5" effort="9"/>
    </joint>
  </xacro:macro>
</robot>
"""
ROBOT = """<?xml version="1.0"?>
<robot name="made" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="length" default="0.3"/>
  <xacro:property name="length" value="$(arg length)"/>
  <xacro:include filename="{include}"/>
  <link name="base_link"><collision><geometry><box size="0.4 0.4 0.2"/></geometry></collision></link>
  <xacro:segment name="upper" parent="base_link" length="${{length}}"/>
  <xacro:segment name="lower" parent="upper" length="${{length}}"/>
</robot>
"""


def write(folder, include="arm.xacro"):
    (folder / "arm_description" / "urdf").mkdir(parents=True)
    (folder / "arm_description" / "urdf" / "arm.xacro").write_text(ARM)
    file = folder / "arm_description" / "urdf" / "robot.urdf.xacro"
    file.write_text(ROBOT.format(include=include))
    return file


@pytest.mark.parametrize("include", ["arm.xacro", "$(find arm_description)/urdf/arm.xacro"])
def test_a_xacro_file_is_the_robot_that_it_expands_to(tmp_path, include):
    robot = es.load_robot(write(tmp_path, include), base="fixed")
    assert robot.joint_names == ("upper_joint", "lower_joint")
    assert robot.name == "robot"
    same = es.load_robot(robot.urdf_path, base="fixed")  # the expanded file stands by itself
    assert (same.model.upperPositionLimit == robot.model.upperPositionLimit).all()
    assert robot.model.upperPositionLimit[0] == pytest.approx(1.5707963)
    assert MotionLimits.for_robot(robot).joint_speed[0] == 1.5


def test_arguments_change_the_robot(tmp_path):
    file = write(tmp_path)
    lengths = []
    for mappings in (None, {"length": "0.7"}):
        robot = es.load_robot(file, base="fixed", mappings=mappings)
        lengths.append(max(2.0 * g.geometry.halfSide[2] for g in robot.collision_model.geometryObjects))
    assert lengths == pytest.approx([0.3, 0.7])
    with refused(RobotError, "'panda'"):
        es.load_robot("panda", mappings={"length": "0.7"})


def test_meshes_are_found_from_the_xacro_file(tmp_path):
    file = write(tmp_path)
    mesh = tmp_path / "arm_description" / "meshes" / "wedge.stl"
    mesh.parent.mkdir()
    import trimesh

    trimesh.creation.box((0.1, 0.1, 0.1)).export(mesh)
    named = '<mesh filename="package://arm_description/meshes/wedge.stl"/>'
    file.write_text(file.read_text().replace('<box size="0.4 0.4 0.2"/>', named))
    robot = es.load_robot(file, base="fixed")
    assert str(mesh) in Path(robot.urdf_path).read_text()


def test_what_xacro_says_goes_to_the_log(tmp_path, caplog, capfd):
    file = write(tmp_path)
    file.write_text(file.read_text().replace("<xacro:include", "<xacro:include unknown='1'"))
    with caplog.at_level(logging.WARNING):
        es.load_robot(file, base="fixed")
    assert "unknown attribute" in caplog.text
    assert capfd.readouterr() == ("", "")


@each(
    ("before", "after", "says"),
    [
        ("arm.xacro", "gone.xacro", "gone.xacro"),
        ("arm.xacro", "$(find nowhere)/arm.xacro", "package 'nowhere' not found"),
        ("${length}", "${lenght}", "robot.urdf.xacro:7: xacro cannot expand it (macro 'segment'): name 'lenght'"),
        ("${length}", "${1 / 0}", "robot.urdf.xacro:7: xacro cannot expand it (macro 'segment'): division by zero"),
        ("</robot>", "", "xacro cannot expand it"),
        ("$(arg length)", "$(arg width)", "robot.urdf.xacro:4: "),
        ("<robot", "<!DOCTYPE robot><robot", "document type"),
    ],
)
def test_what_cannot_be_expanded_is_one_typed_error(tmp_path, capfd, before, after, says):
    file = write(tmp_path)
    file.write_text(file.read_text().replace(before, after))
    with refused(RobotError, "robot.urdf.xacro:") as caught:
        es.load_robot(file, base="fixed")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_an_error_in_a_macro_names_its_file_line_and_macro(tmp_path):
    file = write(tmp_path)
    macros = file.parent / "arm.xacro"
    macros.write_text(macros.read_text().replace("${length / 2}", "${lenght / 2}"))
    with refused(RobotError, "arm.xacro:4:", "'segment'", "'lenght'"):
        es.load_robot(file, base="fixed")


def test_a_macro_that_calls_itself_is_named_once(tmp_path):
    file = tmp_path / "endless.xacro"
    file.write_text(
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="again"><xacro:again/>'
        "</xacro:macro><xacro:again/></robot>"
    )
    with refused(RobotError, "endless") as caught:
        es.load_robot(file, base="fixed")
    assert str(caught.value).count("macro 'again'") <= 2
    assert len(str(caught.value)) < 1000


def test_a_package_that_is_not_found_is_said_once(tmp_path):
    with pytest.raises(RobotError) as caught:
        es.load_robot(write(tmp_path, "$(find nowhere)/arm.xacro"), base="fixed")
    assert str(caught.value).count("package 'nowhere' not found") == 1
    assert "<class" not in str(caught.value)
    assert "robot.urdf.xacro:5: " in str(caught.value)


def test_included_files_are_regular_and_no_larger_than_the_first(tmp_path):
    """Others would be waited for, or fill the memory; one that is missing may be optional."""
    file = write(tmp_path)
    part = file.parent / "arm.xacro"
    part.unlink()
    with part.open("wb") as stream:
        stream.truncate(9_000_000)
    with refused(RobotError, "arm.xacro:"):
        es.load_robot(file, base="fixed")
    text = ROBOT.format(include="arm.xacro").replace("<xacro:include", "<xacro:include optional='true'")
    part.unlink()
    file.write_text(re.sub(r"  <xacro:segment.*\n", "", text))
    assert es.load_robot(file, base="omni").joint_names == ()


_DOUBLING = (
    "".join(f'<xacro:macro name="m{k}"><xacro:m{k + 1}/><xacro:m{k + 1}/></xacro:macro>' for k in range(30))
    + '<xacro:macro name="m30"><link name="l"/></xacro:macro><xacro:m0/>'
)

_GROWING = (
    "<xacro:property name='p0' value='aaaaaaaaaa'/>"
    + "".join(f"<xacro:property name='p{k}' value='{('${p' + str(k - 1) + '}') * 10}'/>" for k in range(1, 12))
    + "<link name='${p11}'/>"
)


@pytest.mark.parametrize(
    "bomb",
    [
        '<link name="${9**9**9}"/>',
        '<link name="${len(str(9**9**8))}"/>',
        "<link name=\"${'a' * 10**10}\"/>",
        '<link name="${[[0] * 10**5] * 10**6}"/>',
        '<link name="${sum(1 for a in range(10**6) for b in range(10**6))}"/>',
        '<link name="' + "${" + "(" * 5000 + "1" + ")" * 5000 + "}" + '"/>',
        _GROWING,
        _DOUBLING,
    ],
    ids=["power", "digits", "text", "lists", "loop", "brackets", "properties", "macros"],
)
def test_a_bomb_ends_in_a_typed_error_and_takes_no_memory_here(tmp_path, bomb, monkeypatch):
    """The child is ended by the processor time and memory that it may take, whatever this machine is busy with.

    It may take less here than elsewhere; what that is, is asked below.
    """
    less = "run.__globals__.update(_PROCESSOR_TIME=1, _MOST_MEMORY=500_000_000); run()"
    assert xacro_process._CHILD.endswith("; run()")
    monkeypatch.setattr(xacro_process, "_CHILD", xacro_process._CHILD.removesuffix("run()") + less)
    file = tmp_path / "bomb.xacro"
    file.write_text(f'<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{bomb}</robot>')
    with refused(RobotError, "bomb.xacro"):
        expand_xacro(file)


def test_what_the_child_may_take_is_bounded():
    """The bounds that make a bomb end are in force where the system has them."""
    resource = pytest.importorskip("resource")
    code = (
        "from elastic_strips import xacro_process as x; x._bound(); import resource as r;"
        "print(r.getrlimit(r.RLIMIT_CPU)[0], r.getrlimit(r.RLIMIT_AS)[0])"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True)
    seconds, memory = (int(word) for word in ended.stdout.split())
    assert 0 < seconds <= 5
    if sys.platform == "linux":
        assert 0 < memory <= 2_000_000_000
    assert resource.getrlimit(resource.RLIMIT_CPU)[0] != seconds, "this process is not bounded"


@each("kind", ["writable by all", "writable by a group", "a link", "a file"])
def test_a_folder_that_others_may_write_is_not_used(tmp_path, monkeypatch, kind):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    usual = tmp_path / f"elastic-strips-{getpass.getuser()}"
    if kind == "a link":
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        usual.symlink_to(tmp_path / "elsewhere")
    elif kind == "a file":
        usual.write_text("")
    else:
        usual.mkdir()
        usual.chmod(0o777 if kind == "writable by all" else 0o770)
    (tmp_path / "robot").mkdir()
    made = expand_xacro(write(tmp_path / "robot"))
    assert made.parent != usual
    assert made.resolve().parent not in (usual.resolve(), tmp_path / "elsewhere")
    assert made.parent.stat().st_mode & 0o077 == 0


def test_the_folder_is_used_again_where_it_is_ones_own(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    (tmp_path / "robot").mkdir()
    file = write(tmp_path / "robot")
    made = expand_xacro(file)
    assert made == expand_xacro(file)
    assert made.parent == tmp_path / f"elastic-strips-{getpass.getuser()}"


@each(
    ("mappings", "named"), [({}, "length"), ({"length": "0.7"}, None), ({"length": "0.7", "lenght": "0.9"}, "lenght")]
)
def test_arguments_that_nobody_gave_or_asked_for_are_said(tmp_path, caplog, mappings, named):
    with caplog.at_level(logging.WARNING):
        expand_xacro(write(tmp_path), mappings)
    assert (named in caplog.text) if named else not caplog.text
