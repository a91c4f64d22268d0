"""URDF and SRDF files: every fault is a RobotError that names the file, the element and what would be valid."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.errors import RobotError
from elastic_strips.robot import load_robot

LIMIT = '<limit lower="-1" upper="1" velocity="1" effort="1"/>'
BOX = '<collision><geometry><box size="0.4 0.4 0.2"/></geometry></collision>'
BASE = f'<link name="base">{BOX}</link>'


def link(name: str = "arm", geometry: str = '<sphere radius="0.1"/>', more: str = "") -> str:
    return f'<link name="{name}">{more}<collision><geometry>{geometry}</geometry></collision></link>'


def joint(
    name: str = "hinge", parent: str = "base", child: str = "arm", kind: str = "revolute", more: str = LIMIT
) -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{more}</joint>'


def robot(*elements: str) -> str:
    return '<robot name="test">\n' + "\n".join(elements) + "\n</robot>"


GOOD = robot(BASE, link(), joint())


def write(folder: Path, content: str | bytes, name: str = "test.urdf") -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def said_of(path: Path, **options: object) -> str:
    """The message with which a file is refused; it begins with the file's name."""
    with pytest.raises(RobotError) as caught:
        load_robot(path, **options)
    assert str(caught.value).startswith(str(path)), caught.value
    return str(caught.value)


def test_the_good_file_is_good(tmp_path):
    loaded = load_robot(write(tmp_path, GOOD))
    assert (loaded.name, loaded.joint_names) == ("test", ("hinge",))
    assert loaded.urdf_path == str(tmp_path / "test.urdf")
    assert [g.links for g in loaded.geometries] == [("base",), ("arm",)]


@each(
    "content, words",
    [
        (b"", "empty"),
        (b" \n\t ", "empty"),
        (b"hello", "not well-formed XML"),
        (GOOD[:-12], "not well-formed XML"),
        (GOOD.replace('"hinge"', '"hing\xff"').encode("latin-1"), "not well-formed XML"),
        (GOOD.replace("robot", "model"), "root element is <model>; a URDF file has <robot>"),
        ('<!DOCTYPE robot [<!ENTITY a "b">]>' + GOOD, "document type or entities"),
        ('<!DOCTYPE robot SYSTEM "http://127.0.0.1:1/x.dtd">' + GOOD, "document type"),
        (
            '<?xml version="1.0"?><!DOCTYPE lolz [<!ENTITY lol "lol"><!ENTITY lol2 "&lol;&lol;&lol;">]>'
            '<robot name="&lol2;"/>',
            "document type or entities",
        ),
        (('<!DOCTYPE robot [<!ENTITY a "b">]>' + GOOD).encode("utf-16"), "document type"),
        (robot(), "has no <link>"),
        (robot(BASE, "<link/>"), "a <link> has no name"),
        (robot(BASE, BASE), "<link> 'base' is defined twice"),
        (robot(BASE, link(), joint(), joint()), "<joint> 'hinge' is defined twice"),
        (robot(BASE, link("arm"), joint(child="harm")), "has unknown child link 'harm'; did you mean 'arm'"),
        (robot(BASE, link(), joint(parent="bse")), "joint 'hinge' has unknown parent link 'bse'; did you mean 'base'"),
        (robot(BASE, link(), '<joint name="hinge" type="fixed"><parent link="base"/></joint>'), "no <child link=…>"),
        (robot(BASE, link(), joint(), joint("other")), "link 'arm' is the child of two joints"),
        (robot(BASE, link()), "exactly one root link; found 2 (arm, base)"),
        (robot(BASE, link(), joint(), joint("back", "arm", "base")), "form a loop"),
        (robot(BASE, link(), link("c"), joint(), joint("x", "c", "c")), "loop through link 'c'"),
        (robot(BASE, link(), joint(kind="revolut")), "unknown type 'revolut'; did you mean 'revolute'"),
        (robot(BASE, link(), joint(more="")), "joint 'hinge' is revolute and has no <limit>"),
        (
            robot(BASE, link(), joint(more=LIMIT.replace('"1" velocity', '"-2" velocity'))),
            "joint 'hinge' has lower limit -1.0 above upper limit -2.0",
        ),
        (robot(BASE, link(), joint(more=LIMIT.replace("-1", "nan"))), "<limit lower='nan'> is not 1 finite number"),
        (robot(BASE, link(), joint(more=LIMIT.replace("-1", "low"))), "<limit lower='low'> is not 1 number"),
        (robot(BASE, link(), joint(more=LIMIT.replace("-1", "-1e999"))), "is not 1 finite number"),
        (robot(BASE, link(), joint(more=LIMIT.replace('effort="1"', 'effort="-1"'))), "effort limit -1.0; it must be"),
        (robot(BASE, link(), joint(more='<axis xyz="0 0 0"/>' + LIMIT)), "joint 'hinge' has the axis 0 0 0"),
        (robot(BASE, link(), joint(more='<axis xyz="0 1"/>' + LIMIT)), "<axis xyz='0 1'> is not 3 finite number"),
        (robot(BASE, link(), joint(more='<origin xyz="0 nan 0"/>' + LIMIT)), "<origin xyz='0 nan 0'>"),
        (robot(BASE, link(), joint(more='<origin rpy="0 0 inf"/>' + LIMIT)), "<origin rpy='0 0 inf'>"),
        (robot(BASE, link(geometry=""), joint()), "link 'arm' <collision> has no <geometry>"),
        (robot(BASE, link(geometry='<ball radius="1"/>'), joint()), "link 'arm' <collision> has unknown shape <ball>"),
        (robot(BASE, link(geometry='<sphere radius="-1"/>'), joint()), "has radius [-1.0]; it must be ≥ 0"),
        (robot(BASE, link(geometry='<sphere radius="1e-9"/>'), joint()), "it must be 0 or at least 1e-06"),
        (robot(BASE, link(geometry="<sphere/>"), joint()), "<sphere> has no attribute 'radius'"),
        (robot(BASE, link(geometry='<box size="1 1"/>'), joint()), "<box size='1 1'> is not 3 finite number"),
        (robot(BASE, link(geometry='<box size="1,1,1"/>'), joint()), "<box size='1,1,1'> is not 3 number"),
        (robot(BASE, link(geometry='<cylinder radius="1" length="-1"/>'), joint()), "has length [-1.0]"),
        (robot(BASE, link(geometry="<mesh/>"), joint()), "<mesh> without filename"),
        (robot(BASE, link(geometry='<mesh filename="no.stl"/>'), joint()), "<collision>: mesh 'no.stl' not found"),
        (robot(BASE, link(geometry='<mesh filename="package://a/b.stl"/>'), joint()), "'package://a/b.stl' not found"),
        (robot(BASE, link(geometry='<mesh filename="file:///no/no.stl"/>'), joint()), "not found"),
        (robot(BASE, link(geometry='<mesh filename="."/>'), joint()), "mesh '.' not found"),
        (robot(BASE, link(more="<inertial/>"), joint()), "link 'arm' has <inertial> without <mass>"),
        (robot(BASE, link(more='<inertial><mass value="-1"/></inertial>'), joint()), "has mass -1.0 kg"),
        (robot(BASE, link(more='<inertial><mass value="nan"/></inertial>'), joint()), "<mass value='nan'>"),
        (
            robot(BASE, link(more='<inertial><mass value="1"/><inertia ixx="-1"/></inertial>'), joint()),
            "ixx = -1.0; it must be",
        ),
        (robot(BASE, link(geometry='<capsule radius="-0.1" length="1"/>'), joint()), "has radius [-0.1]"),
        (robot(BASE, link(geometry='<capsule radius="0.1"/>'), joint()), "<capsule> has no attribute 'length'"),
    ],
)  # fmt: skip
def test_faulty_files_are_refused(tmp_path, content, words):
    assert words in said_of(write(tmp_path, content))


def test_a_mesh_that_is_not_found_says_how_it_is(tmp_path):
    said = said_of(write(tmp_path, robot(BASE, link(geometry='<mesh filename="package://my_robot/a.stl"/>'), joint())))
    assert f"searched {tmp_path}, " in said
    assert (
        "the folder that holds 'my_robot': package_dirs=[…], --package-dir on the command line, or ROS_PACKAGE_" in said
    )


def test_messages_give_the_line(tmp_path):
    path = write(tmp_path, robot(BASE, link(), joint(more="")))
    assert said_of(path).startswith(f"{path}:4: joint 'hinge'")


def test_paths_that_are_no_files(tmp_path):
    assert "is a folder, not a URDF file" in said_of(tmp_path / ".." / tmp_path.name)
    assert "cannot read the URDF file: No such file" in said_of(tmp_path / "missing.urdf")
    with refused(RobotError, "URDF"):
        load_robot("bad\0name.urdf")


def test_a_file_that_is_too_large(tmp_path, monkeypatch):
    monkeypatch.setattr("elastic_strips.robot.xml_file.MAX_BYTES", 100)
    assert "may have at most 100" in said_of(write(tmp_path, GOOD))


def test_a_file_that_cannot_be_read(tmp_path):
    path = write(tmp_path, GOOD)
    path.chmod(0)
    try:
        path.read_bytes()
    except PermissionError:
        assert "Permission denied" in said_of(path)
    else:
        pytest.skip("this user may read everything")


def test_a_damaged_mesh_is_not_quoted_in_full(tmp_path):
    """Assimp quotes what follows a number that it cannot read, up to the end of the file."""
    facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0 0.2 0\nvertex {} 0 0\nendloop\nendfacet\n"
    good = facet.format("0.2")
    (tmp_path / "mesh.stl").write_text("solid \n" + facet.format("0.\ufffd") + 40 * good + "endsolid\n")
    said = said_of(write(tmp_path, robot(BASE, link(geometry='<mesh filename="mesh.stl"/>'), joint())))
    assert "cannot read the geometry" in said
    assert len(said) < len(str(tmp_path)) + 400
    assert "\n" not in said


def test_joints_that_cannot_be_planned_name_themselves(tmp_path):
    path = write(tmp_path, robot(BASE, link(), joint(kind="floating", more="")))
    with refused(RobotError, "'hinge'"):
        load_robot(path)
    assert load_robot(path, locked={"hinge": 0.0}).joint_names == ()
    with refused(RobotError, "'hinge'"):
        load_robot(path, locked={"hinge": 0.3})


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_joint_without_one_value_that_mimics_or_is_mimicked_is_held_with_a_word(tmp_path, caplog, kind):
    more = f'{LIMIT}<mimic joint="{{}}"/>'
    hinge, tray = joint(more=more.format("tray")), joint("tray", "base", "tray", kind, more.format("hinge"))
    for pair, told in (
        ((hinge, joint("tray", "base", "tray", kind, "")), "hinge"),
        ((joint(more=LIMIT), tray), "tray"),
    ):
        caplog.clear()
        loaded = load_robot(write(tmp_path, robot(BASE, link(), link("tray"), *pair)), base="omni")
        assert told in loaded.locked
        assert any(told in record.getMessage() and "held" in record.getMessage() for record in caplog.records)
        assert "yourdfpy" not in caplog.text


def turning(name: str, parent: str, axis: str, at: str = "0 0 0", rpy: str = "0 0 0") -> str:
    """A continuous joint and its link."""
    more = f'<origin xyz="{at}" rpy="{rpy}"/><axis xyz="{axis}"/>'
    return link(f"{name}_link") + joint(name, parent, f"{name}_link", "continuous", more)


def gripper(mimic: str = '<mimic joint="thumb" multiplier="-2" offset="0.1"/>') -> str:
    return link("t") + link("f") + joint("thumb", "arm", "t") + joint("finger", "arm", "f", more=LIMIT + mimic)


WHEEL = turning("left_wheel_joint", "base", "0 1 0")


def test_what_is_not_an_arm_is_locked_by_default(tmp_path):
    """Wheels, and joints that mimic another together with those: the gripper stays a shape that it can have."""
    path = write(tmp_path, robot(BASE, link(), joint(), turning("dial", "base", "0 0 1"), WHEEL, gripper()))
    loaded = load_robot(path)
    assert loaded.joint_names == ("dial", "hinge")
    assert loaded.locked == {"left_wheel_joint": 0.0, "thumb": 0.0, "finger": 0.1}


@each(
    "locked, wanted",
    [
        ({}, {}),
        ({"thumb": 0.3}, {"thumb": 0.3, "finger": -0.5}),
        ({"thumb": 0.3, "finger": 0.2}, {"thumb": 0.3, "finger": 0.2}),
        ({"finger": 0.2}, {"finger": 0.2, "thumb": -0.05}),
        ({"hinge": 0.4}, {"hinge": 0.4}),
        ({"left_wheel_joint": 1.0}, {"left_wheel_joint": 1.0}),
    ],
)
def test_what_is_locked_is_locked_besides(tmp_path, locked, wanted):
    path = write(tmp_path, robot(BASE, link(), joint(), WHEEL, gripper()))
    found = load_robot(path, locked=locked).locked
    assert found == pytest.approx({"left_wheel_joint": 0.0, "thumb": 0.0, "finger": 0.1} | wanted)


def test_what_mimics_follows_along_a_chain_and_from_home(tmp_path):
    more = link("g") + joint("tip", "f", "g", more=LIMIT + '<mimic joint="finger" multiplier="0.5"/>')
    path = write(tmp_path, robot(BASE, link(), joint(), gripper(), more))
    assert load_robot(path, locked={"thumb": 0.3}).locked == {"thumb": 0.3, "finger": -0.5, "tip": -0.25}
    home = srdf(tmp_path, '<group_state name="home"><joint name="thumb" value="0.2"/></group_state>')
    found = load_robot(path, srdf=home)
    assert found.locked == pytest.approx({"thumb": 0.2, "finger": -0.3, "tip": -0.15})
    assert load_robot(path, srdf=home, joints=["hinge"]).locked == found.locked


def test_a_follower_beyond_its_limits_is_warned_about(tmp_path, caplog):
    path = write(tmp_path, robot(BASE, link(), joint(), gripper('<mimic joint="thumb" offset="3"/>')))
    assert load_robot(path).locked == {"thumb": 0.0, "finger": 1.0}
    assert "'finger' mimics 'thumb', which puts it at 3, outside its limits" in caplog.text


def test_a_joint_that_others_mimic_is_planned_with_them_where_it_is_named(tmp_path):
    path = write(tmp_path, robot(BASE, link(), joint(), gripper()))
    group = srdf(tmp_path, '<group name="hand"><joint name="thumb"/></group>',
                 '<group name="all"><joint name="hinge"/><joint name="thumb"/><joint name="finger"/></group>'
                 )  # fmt: skip
    three = {"joints": ["hinge", "thumb", "finger"]}
    for options in ({"joints": ["hinge", "thumb"]}, three, {"srdf": group, "group": "all"}):
        loaded = load_robot(path, **options)
        assert set(loaded.joint_names) == {"hinge", "thumb"}
        assert tuple(loaded.followers["finger"]) == ("thumb", -2.0, 0.1)
    assert load_robot(path, srdf=group, group="hand").joint_names == ("thumb",)
    with refused(RobotError, "'thumb'"):
        load_robot(path, joints=["hinge", "finger"])


def two_fingers(
    kind: str, names: tuple[str, str], limit: str = '<limit lower="0" upper="0.04" velocity="1" effort="1"/>'
):
    """A hand at the end of the arm, and two fingers on it that move each by itself."""
    hand = link("hand") + joint("mount", "arm", "hand", kind="fixed", more="")
    return hand + "".join(link(f"f{n}") + joint(n, "hand", f"f{n}", kind=kind, more=limit) for n in names)


@each(
    "kind, names, held",
    [
        ("prismatic", ("a", "b"), True),
        ("revolute", ("left_finger", "right_finger"), True),
        ("revolute", ("pan", "tilt"), False),  # whatever that is
    ],
)
def test_fingers_of_which_none_mimics_another_are_held(tmp_path, kind, names, held):
    path = write(tmp_path, robot(BASE, link(), joint(), two_fingers(kind, names)))
    loaded = load_robot(path)
    assert set(loaded.joint_names) == ({"hinge"} if held else {"hinge", *names})
    assert set(loaded.locked) == (set(names) if held else set())
    assert all(loaded.held[name] for name in loaded.locked)
    assert set(load_robot(path, joints=["hinge", *names]).joint_names) == {"hinge", *names}


def test_what_slides_far_or_alone_is_no_finger(tmp_path):
    long = '<limit lower="0" upper="0.4" velocity="1" effort="1"/>'
    lifts = write(tmp_path, robot(BASE, link(), joint(), two_fingers("prismatic", ("a", "b"), long)))
    assert set(load_robot(lifts).joint_names) == {"hinge", "a", "b"}
    on_base = "".join(
        link(f"l{n}") + joint(n, "base", f"l{n}", kind="prismatic", more=long.replace("0.4", "0.1")) for n in ("a", "b")
    )
    legs = write(tmp_path, robot(BASE, link(), joint(), on_base), "legs.urdf")
    assert set(load_robot(legs, base="omni").joint_names) == {"hinge", "a", "b"}


@each("span, warned", [(90.0, True), (9.0, False), (1e5, False)])
def test_limits_in_degrees_are_asked_about(tmp_path, caplog, span, warned):
    limit = f'<limit lower="{-span}" upper="{span}" velocity="1" effort="1"/>'
    load_robot(write(tmp_path, robot(BASE, link(), joint(more=limit))))
    assert ("hinge" in caplog.text and "degrees" in caplog.text) is warned


def test_joints_that_mimic_in_a_ring_are_refused(tmp_path):
    ring = link("t") + link("f") + "".join(
        joint(a, "arm", c, more=LIMIT + f'<mimic joint="{b}"/>') for a, b, c in (("x", "y", "t"), ("y", "x", "f"))
    )  # fmt: skip
    assert "<mimic> in a ring: x → y → x" in said_of(write(tmp_path, robot(BASE, link(), joint(), ring)))


FIXED = '<joint name="mount" type="fixed"><parent link="base"/><child link="box"/></joint>'
WHEELS = {
    "on the base": (turning("drv_l", "base", "0 1 0"), {"drv_l"}),
    "on a part of the base": (link("box") + FIXED + turning("drv_l", "box", "0 -1 0"), {"drv_l"}),
    "turned": (turning("drv", "base", "0 0 1", rpy="1.5708 0 0"), {"drv"}),
    "a caster": (turning("l", "base", "0 1 0") + turning("c", "base", "0 0 1") + turning("cw", "c_link", "0 1 0"),
                 {"l", "c", "cw"}),
    "steered ones": ("".join(turning(f"s{k}", "base", "0 0 1") + turning(f"r{k}", f"s{k}_link", "0 1 0") for k in "ab"),
                     {"sa", "ra", "sb", "rb"}),
    "an arm's own yaw": (turning("yaw", "base", "0 0 1") + turning("pitch", "yaw_link", "0 1 0")
                         + turning("next", "pitch_link", "0 1 0"), set()),
    "an arm's own pitch": (turning("pitch", "base", "0 1 0") + turning("next", "pitch_link", "0 1 0"), set()),
    "a head above wheels": (turning("l", "base", "0 1 0") + turning("pan", "base", "0 0 1", "0 0 1")
                            + turning("tilt", "pan_link", "0 1 0"), {"l"}),
    "a lone head": (turning("pan", "base", "0 0 1") + turning("tilt", "pan_link", "0 1 0"), set()),
}  # fmt: skip


@each("more, wheels", WHEELS.values(), ids=list(WHEELS))
def test_wheels_are_known_by_how_they_hang(tmp_path, more, wheels):
    path = write(tmp_path, robot(BASE, link(), joint(), more))
    loaded = load_robot(path, base="omni")
    assert set(loaded.locked) == wheels
    assert not load_robot(path, base="fixed").locked
    every = (*loaded.joint_names, *wheels)
    assert set(load_robot(path, joints=every).joint_names) == set(every)


def stl(triangles: np.ndarray) -> bytes:
    """A binary STL file of triangles (T, 3, 3)."""
    rows = [struct.pack("<12fH", 0, 0, 1, *np.ravel(t), 0) for t in triangles]
    return b"\0" * 80 + struct.pack("<I", len(rows)) + b"".join(rows)


CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
SOLID = CORNERS[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]]


def mesh_robot(folder: Path, content: bytes, attributes: str = "", suffix: str = "stl") -> Path:
    (folder / f"part.{suffix}").write_bytes(content)
    return write(folder, robot(BASE, link(geometry=f'<mesh filename="part.{suffix}" {attributes}/>'), joint()))


def test_meshes_are_found_beside_the_file_in_packages_and_absolutely(tmp_path):
    (tmp_path / "pkg" / "meshes").mkdir(parents=True)
    (tmp_path / "pkg" / "meshes" / "part.stl").write_bytes(stl(SOLID))
    where = tmp_path / "elsewhere"
    where.mkdir()
    for name in ("package://pkg/meshes/part.stl", f"file://{tmp_path}/pkg/meshes/part.stl"):
        path = write(where, robot(BASE, link(geometry=f'<mesh filename="{name}"/>'), joint()))
        loaded = load_robot(path, package_dirs=(tmp_path,))
        assert len(loaded.geometries[1].geometry.points()) == 4
    assert len(load_robot(mesh_robot(tmp_path, stl(SOLID))).geometries) == 2


def test_mesh_scale_applies(tmp_path):
    loaded = load_robot(mesh_robot(tmp_path, stl(SOLID), 'scale="0.5 -2 1"'))
    points = np.asarray(loaded.geometries[1].geometry.points())
    np.testing.assert_allclose(points.max(axis=0) - points.min(axis=0), [0.5, 2.0, 1.0], atol=1e-6)


def test_a_mesh_in_millimetres_is_warned_about(tmp_path, caplog):
    """Of 600 x 30 x 30 mm, read as metres; not one of 12 m."""
    load_robot(mesh_robot(tmp_path, stl(SOLID * [12.0, 1.0, 1.0])))
    assert not caplog.text
    path = mesh_robot(tmp_path, stl(SOLID * [600.0, 30.0, 30.0]))
    load_robot(path)
    assert f"mesh {tmp_path / 'part.stl'} of link 'arm' is 600 x 30 x 30 m large" in caplog.text
    assert 'scale="0.001 0.001 0.001"' in caplog.text
    caplog.clear()
    load_robot(mesh_robot(tmp_path, stl(SOLID * [600.0, 30.0, 30.0]), 'scale="0.001 0.001 0.001"'))
    assert not caplog.text
    visual = '<visual><geometry><mesh filename="part.stl"/></geometry></visual>'
    drawn = load_robot(write(tmp_path, robot(BASE, link(more=visual), joint())))
    assert not caplog.text  # it is not read yet
    assert drawn.visual_model.ngeoms == 1
    assert "of link 'arm' is 600 x 30 x 30 m large" in caplog.text


@each(
    "content, attributes, suffix",
    [
        (b"", "", "stl"),
        (b"this is no mesh at all, not even nearly", "", "stl"),
        (stl(SOLID)[:-20], "", "stl"),
        (stl(SOLID[:1]), "", "stl"),
        (stl(SOLID[:0]), "", "stl"),
        (b"\0" * 80 + struct.pack("<I", 4_000_000_000) + b"x" * 60, "", "stl"),
        (stl(SOLID), 'scale="0 1 1"', "stl"),
        (stl(SOLID), 'scale="-1 0 1"', "stl"),
        (stl(SOLID), 'scale="nan 1 1"', "stl"),
        (stl(SOLID), 'scale="1 1"', "stl"),
        (b"v 0 0 0\nv 1 0 0\nf 1 2 9\n", "", "obj"),
        (b"<COLLADA/>", "", "dae"),
    ],
)
def test_bad_meshes_are_refused(tmp_path, content, attributes, suffix):
    assert "part" in said_of(mesh_robot(tmp_path, content, attributes, suffix)) or "scale" in attributes


def test_a_flat_mesh_is_refused_by_name(tmp_path):
    with refused(RobotError, "part.stl"):
        load_robot(mesh_robot(tmp_path, stl(SOLID * [1, 1, 0])))


def test_a_mesh_that_is_not_finite_is_refused(tmp_path):
    bad = SOLID.copy()
    bad[0, 0, 0] = np.nan
    with refused(RobotError, "part"):
        load_robot(mesh_robot(tmp_path, stl(bad)))


def test_a_mesh_with_huge_vertices_does_not_crash(tmp_path):
    path = mesh_robot(tmp_path, stl(np.vstack((SOLID, SOLID[:1] * 3e38))))
    code = (
        "import sys\n"
        "from elastic_strips.errors import RobotError\n"
        "from elastic_strips.robot import load_robot\n"
        "try:\n    load_robot(sys.argv[1])\nexcept RobotError:\n    pass\n"
    )
    assert subprocess.run([sys.executable, "-c", code, str(path)], timeout=60, capture_output=True).returncode == 0


GREY = '<material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>'
HARMLESS = {
    "material twice": (robot(GREY, GREY, BASE, link(), joint()), "materials that are defined more than once"),
    "material without color": (robot('<material name="grey"/>', BASE, link(), joint()), "materials without a color"),
    "color of 255": (robot(GREY.replace("0.5", "255"), BASE, link(), joint()), "materials without a color"),
    "no effort": (GOOD.replace(' effort="1"', ""), "joints with a <limit> without effort, taken as unknown: 'hinge'"),
    "no velocity": (GOOD.replace(' velocity="1"', ""), "joints with a <limit> without velocity"),
    "axis without xyz": (robot(BASE, link(), joint(more=LIMIT + "<axis/>")), "joints with an <axis> without xyz"),
    "version": (GOOD.replace('name="test"', 'name="test" version="2"'), "version of URDF that is not known"),
    "blanks": (GOOD.replace('"1"', '" 1 "'), None),
    "limit of a fixed joint": (
        robot(BASE, link(), joint(), link("c"), joint("f", "arm", "c", "fixed", "<limit/>")),
        None,
    ),
    "safety": (robot(BASE, link(), joint(more=LIMIT + "<safety_controller/>")), None),
    "calibration": (robot(BASE, link(), joint(more=LIMIT + '<calibration rising="x"/>')), None),
    "dynamics": (robot(BASE, link(), joint(more=LIMIT + "<dynamics/>")), None),
}  # fmt: skip


@each("content, said", HARMLESS.values(), ids=HARMLESS)
def test_what_urdfdom_refuses_without_need_is_mended(tmp_path, caplog, capfd, content, said):
    """And urdfdom has nothing to say on standard error, where no log sees it."""
    assert load_robot(write(tmp_path, content)).joint_names == ("hinge",)
    assert (said or "") in caplog.text
    assert bool(said) == bool(caplog.text)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "more, words",
    [
        (LIMIT + '<dynamics damping="x"/>', "joint 'hinge': <dynamics damping='x'> is not 1 number"),
        (LIMIT.replace('lower="-1"', 'lower="x"'), "joint 'hinge': <limit lower='x'> is not 1 number"),
    ],
)
def test_what_urdfdom_refuses_has_a_line_and_a_cause(tmp_path, capfd, more, words):
    path = write(tmp_path, robot(BASE, link(), joint(kind="continuous", more=more)))
    assert said_of(path).startswith(f"{path}:4: {words}")
    assert capfd.readouterr().err == ""


SILENT = {
    "number with underscore": link(geometry='<sphere radius="1_0"/>'),
    "line break in a vector": link(geometry='<box size="1\n1 1"/>'),
    "digits of another script": link(geometry='<sphere radius="\u0661"/>'),
    "inertial without inertia": link(more='<inertial><mass value="1"/></inertial>'),
    "incomplete inertia": link(more='<inertial><mass value="1"/><inertia ixx="1"/></inertial>'),
    "inertial origin": link(
        more='<inertial><origin xyz="nan 0 0"/><mass value="1"/>'
        '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    ),
    "material without name": link(more='<visual><geometry><sphere radius="1"/></geometry><material/></visual>'),
}


@each("element", SILENT.values(), ids=SILENT)
def test_no_collision_shape_is_lost_in_silence(tmp_path, element):
    """What urdfdom cannot parse it leaves out: such a link would pass through everything, certified."""
    path = write(tmp_path, robot(BASE, element, joint()))
    try:
        loaded = load_robot(path)
    except RobotError:
        return
    assert {link for g in loaded.geometries for link in g.links} == {"base", "arm"}


@pytest.mark.parametrize("name", ["hinge", "universe"])
def test_a_link_may_have_the_name_of_a_joint(tmp_path, name):
    loaded = load_robot(write(tmp_path, robot(BASE, link(name), joint(child=name))))
    assert [g.links for g in loaded.geometries] == [("base",), (name,)]


def srdf(folder: Path, *elements: str) -> Path:
    return write(folder, robot(*elements), "test.srdf")


def test_srdf_pairs_and_home(tmp_path):
    path = write(tmp_path, robot(BASE, link(), link("c"), joint(), joint("next", "arm", "c")))
    plain = load_robot(path)
    semantics = srdf(
        tmp_path,
        '<group_state name="home" group="g"><joint name="next" value="0.5"/></group_state>',
        '<disable_collisions link1="c" link2="base" reason="Never"/>',
    )
    loaded = load_robot(path, srdf=semantics)
    assert loaded.home_q[5] == 0.5
    assert plain.home_q[5] == 0.0
    assert len(loaded.self_pairs) == 0
    assert loaded.srdf_path == str(semantics)


@each(
    "element, words",
    [
        ('<disable_collisions link1="base"/>', "<disable_collisions> has no attribute 'link2'"),
        ('<group_state group="g"/>', "<group_state> has no name"),
        ('<group_state name="home"><joint name="hinge" value="x"/></group_state>', "has value 'x', not a number"),
        ('<group_state name="home"><joint name="hinge" value="nan"/></group_state>', "has value 'nan', not a number"),
        ('<group_state name="home"><joint name="hinge"/></group_state>', "has value None, not a number"),
    ],
)
def test_faulty_srdf_files_are_refused(tmp_path, element, words):
    path = write(tmp_path, GOOD)
    semantics = srdf(tmp_path, element)
    with pytest.raises(RobotError) as caught:
        load_robot(path, srdf=semantics)
    assert str(caught.value).startswith(f"{semantics}:2: ")
    assert words in str(caught.value)


@each("content, words", [(b"", "empty"), (b"<a/>", "root element is <a>"), (b"<robot", "not well-formed")])
def test_srdf_files_that_are_none(tmp_path, content, words):
    path = write(tmp_path, GOOD)
    with pytest.raises(RobotError, match=words):
        load_robot(path, srdf=write(tmp_path, content, "test.srdf"))
    with refused(RobotError, "SRDF"):
        load_robot(path, srdf=tmp_path / "none.srdf")
