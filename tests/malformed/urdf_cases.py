"""Malformed URDF and SRDF files, made by breaking one sound robot in one place each."""

# ruff: noqa: E501 - tables: one case a line

from __future__ import annotations

from collections.abc import Iterator

from malformed_case import Content, FileCase, folder, sparse

from elastic_strips.errors import RobotError

SOUND = """<?xml version="1.0"?>
<robot name="small">
  <link name="base">
    <inertial><mass value="5"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
    <collision><origin xyz="0 0 0.2" rpy="0 0 0"/><geometry><cylinder radius="0.2" length="0.4"/></geometry></collision>
  </link>
  <link name="arm">
    <collision><origin xyz="0.3 0 0"/><geometry><box size="0.5 0.06 0.06"/></geometry></collision>
  </link>
  <link name="tool"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/>
    <origin xyz="0 0 0.6" rpy="0 0 0"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="9"/></joint>
  <joint name="slide" type="prismatic"><parent link="arm"/><child link="tool"/>
    <origin xyz="0.6 0 0"/><axis xyz="1 0 0"/><limit lower="0" upper="0.2" velocity="1" effort="9"/></joint>
</robot>
"""
SOUND_SRDF = """<?xml version="1.0"?>
<robot name="small">
  <group_state name="home" group="all"><joint name="shoulder" value="0.3"/></group_state>
  <disable_collisions link1="base" link2="arm" reason="Adjacent"/>
</robot>
"""
_BOX = '<box size="0.5 0.06 0.06"/>'
_LIMIT = '<limit lower="-1" upper="1" velocity="1" effort="9"/>'
_BOMB = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 30))


def _mesh(name: str, extra: str = "") -> str:
    return SOUND.replace(_BOX, f'<mesh filename="{name}"{extra}/>')


def _shape(text: str) -> str:
    return SOUND.replace(_BOX, text)


def _stl(*triangles: str) -> str:
    facets = "".join(f"facet normal 0 0 1\nouter loop\n{t}endloop\nendfacet\n" for t in triangles)
    return f"solid s\n{facets}endsolid s\n"


def _triangle(*points: str) -> str:
    return "".join(f"vertex {p}\n" for p in points)


_FLAT = _stl(_triangle("0 0 0", "1 0 0", "0 1 0"), _triangle("1 0 0", "1 1 0", "0 1 0"))

# name, content, what the message says
_DOCUMENTS: tuple[tuple[str, Content, str], ...] = (
    ("empty", "", "is empty"),
    ("truncated in the middle", SOUND[: len(SOUND) // 2], "not well-formed"),
    ("truncated in an attribute", SOUND[: SOUND.index("cylinder radius") + 12], "not well-formed"),
    ("mismatched tags", SOUND.replace("</link>", "</lonk>", 1), "not well-formed"),
    ("attribute without quotes", SOUND.replace('name="small"', "name=small"), "not well-formed"),
    ("attribute twice", SOUND.replace('name="small"', 'name="small" name="s"'), "not well-formed"),
    ("two root elements", SOUND + "<robot/>", "not well-formed"),
    ("unknown entity", SOUND.replace('"small"', '"&small;"'), "not well-formed"),
    ("character that XML forbids", SOUND.replace('"small"', '"&#0;"'), "not well-formed"),
    ("binary garbage", bytes(range(256)) * 8, "not well-formed"),
    ("Latin-1 without saying so", SOUND.replace("small", "kübel").encode("latin-1"), "not well-formed"),
    ("UTF-16 where the header says UTF-8", SOUND.replace("?>", ' encoding="UTF-8"?>').encode("utf-16"), "declares utf-8"),
    ("Latin-1 where the header says UTF-8", SOUND.replace("?>", ' encoding="UTF-8"?>').replace("small", "kübel").encode("latin-1"), "not well-formed"),
    ("an encoding that nobody knows", SOUND.replace("?>", ' encoding="klingon"?>'), "not well-formed"),
    ("UTF-16 without a mark", SOUND.encode("utf-16-le"), "not UTF-8"),
    ("JSON", '{"robot": {"links": []}}', "not well-formed"),
    ("an SDF model", "<sdf version='1.7'><model name='m'/></sdf>", "<sdf>"),
    ("unexpanded xacro", "<robot xmlns:xacro='x'><xacro:include filename='a.xacro'/></robot>", "no <link>"),
    ("DOCTYPE", SOUND.replace("<robot", "<!DOCTYPE robot>\n<robot"), "document type"),
    ("entity bomb", f"<!DOCTYPE r [<!ENTITY e0 'boom'>{_BOMB}]><robot name='&e29;'/>", "document type"),
    ("file of the system as an entity",
     "<!DOCTYPE r [<!ENTITY x SYSTEM 'file:///etc/passwd'>]><robot name='r'><link name='&x;'/></robot>", "document type"),
    ("document type in UTF-16", "<!DOCTYPE r [<!ENTITY x 'y'>]><robot name='&x;'/>".encode("utf-16"), "document type"),
    ("nested 10000 deep", "<robot name='r'>" + "<a>" * 10_000 + "</a>" * 10_000 + "</robot>", "not well-formed"),
    ("an attribute of 7 MB", f"<robot name='{'x' * 7_000_000}'><link name='a'/></robot>", "7000000 characters"),
    ("600 shapes", SOUND.replace("</link>", "<collision><geometry><sphere radius='1'/></geometry></collision>" * 600 + "</link>", 1), "at most 500"),
    ("9 MB", sparse(9_000_000), "at most 8000000"),
)  # fmt: skip

# name, replaced text, by what, what the message says
_EDITS: tuple[tuple[str, str, str, tuple[str, ...]], ...] = (
    ("link twice", 'link name="tool"', 'link name="arm"', ("'arm'", "twice")),
    ("joint twice", 'joint name="slide"', 'joint name="shoulder"', ("'shoulder'", "twice")),
    ("link without a name", '<link name="tool">', "<link>", ("<link>", "no name")),
    ("joint without a name", 'joint name="slide"', "joint", ("<joint>", "no name")),
    ("joint without a type", 'name="slide" type="prismatic"', 'name="slide"', ("'slide'", "type None")),
    ("joint of an unknown type", '"prismatic"', '"prismatik"', ("'prismatik'", "did you mean 'prismatic'")),
    ("joint without a parent", '<parent link="arm"/>', "", ("'slide'", "<parent")),
    ("joint without a child", '<child link="tool"/>', "", ("'slide'", "<child")),
    ("parent without a link", '<parent link="arm"/>', "<parent/>", ("'slide'", "<parent")),
    ("unknown parent", '<parent link="arm"/>', '<parent link="amr"/>', ("'amr'", "did you mean 'arm'")),
    ("unknown child", '<child link="tool"/>', '<child link="tol"/>', ("'tol'", "did you mean 'tool'")),
    ("two roots", "</robot>", '<link name="lost"/></robot>', ("2 (base, lost)", "one root")),
    ("loop of all links", "</robot>", '<joint name="back" type="fixed"><parent link="tool"/><child link="base"/></joint></robot>',
     ("loop",)),
    ("link that is its own parent", '<parent link="arm"/><child link="tool"/>', '<parent link="tool"/><child link="tool"/>',
     ("'tool'", "loop")),
    ("loop beside the tree", "</robot>",
     '<link name="a"/><link name="b"/><joint name="ab" type="fixed"><parent link="a"/><child link="b"/></joint>'
     '<joint name="ba" type="fixed"><parent link="b"/><child link="a"/></joint></robot>', ("loop",)),
    ("child of two joints", "</robot>", '<joint name="two" type="fixed"><parent link="base"/><child link="tool"/></joint></robot>',
     ("'tool'", "two joints")),
    ("floating joint", 'type="prismatic"', 'type="floating"', ("'slide'", "FreeFlyer")),
    ("planar joint", 'type="prismatic"', 'type="planar"', ("'slide'", "JointModelPlanar")),
    ("joint called root_joint", 'joint name="slide"', 'joint name="root_joint"', ("root_joint",)),
    ("inertial without an inertia", '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>', "",
     ("'base'", "without <inertia>")),
    ("inertia of one moment", '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>', '<inertia ixx="1"/>',
     ("'base'", "'ixy'")),
    ("number that only Python reads", '<sphere radius="0.05"/>', '<sphere radius="0_1.0"/>', ("'tool'", "'0_1.0'")),
    ("no limit", _LIMIT, "", ("'shoulder'", "no <limit>")),
    ("lower above upper", 'lower="-1" upper="1"', 'lower="1" upper="-1"', ("'shoulder'", "lower limit 1.0 above")),
    ("limit that is NaN", 'lower="-1"', 'lower="nan"', ("'shoulder'", "nan")),
    ("limit that is infinite", 'upper="1"', 'upper="inf"', ("'shoulder'", "inf")),
    ("limit that is a word", 'upper="1"', 'upper="one"', ("'shoulder'", "'one'")),
    ("limit with a comma", 'upper="1"', 'upper="1,5"', ("'shoulder'", "'1,5'")),
    ("limit of two numbers", 'upper="1"', 'upper="1 2"', ("'shoulder'", "'1 2'")),
    ("negative velocity limit", 'velocity="1"', 'velocity="-1"', ("'shoulder'", "velocity limit -1.0")),
    ("negative effort limit", 'effort="9"', 'effort="-9"', ("'shoulder'", "effort limit -9.0")),
    ("axis of zeros", '<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', ("'shoulder'", "axis 0 0 0")),
    ("axis that cannot be normalised", '<axis xyz="0 0 1"/>', '<axis xyz="0 0 1e300"/>', ("'shoulder'", "1e300", "1e+06")),
    ("limits whose difference overflows", 'lower="-1"', 'lower="-1e308"', ("'shoulder'", "-1e308")),
    ("axis that is NaN", '<axis xyz="0 0 1"/>', '<axis xyz="0 nan 1"/>', ("'shoulder'", "nan")),
    ("origin that is NaN", 'xyz="0 0 0.6"', 'xyz="0 0 nan"', ("'shoulder'", "0 0 nan")),
    ("origin that overflows", 'xyz="0 0 0.6"', 'xyz="0 0 1e400"', ("'shoulder'", "1e400")),
    ("origin that is absurdly far", 'xyz="0 0 0.6"', 'xyz="0 0 1e300"', ("'shoulder'", "1e300")),
    ("origin with degrees", 'xyz="0 0 0.6" rpy="0 0 0"', 'xyz="0 0 0.6" rpy="0 0 90°"', ("'shoulder'", "90°")),
    ("origin of a shape that is infinite", 'xyz="0.3 0 0"', 'xyz="-inf 0 0"', ("'arm'", "-inf")),
    ("mimics itself", _LIMIT, _LIMIT + '<mimic joint="shoulder"/>', ("'shoulder'", "mimic")),
    ("mimics by NaN", _LIMIT, _LIMIT + '<mimic joint="slide" multiplier="nan"/>', ("'shoulder'", "nan")),
    ("inertial without a mass", '<mass value="5"/>', "", ("'base'", "<mass>")),
    ("negative mass", 'mass value="5"', 'mass value="-5"', ("'base'", "-5.0 kg")),
    ("mass that is NaN", 'mass value="5"', 'mass value="nan"', ("'base'", "nan")),
    ("mass without a value", '<mass value="5"/>', "<mass/>", ("'base'", "'value'")),
    ("negative moment of inertia", 'ixx="1"', 'ixx="-1"', ("'base'", "ixx = -1.0")),
    ("inertia that is infinite", 'ixy="0"', 'ixy="inf"', ("'base'", "inf")),
    ("collision without geometry", f"<geometry>{_BOX}</geometry>", "", ("'arm'", "no <geometry>")),
    ("geometry that is empty", f"<geometry>{_BOX}</geometry>", "<geometry/>", ("'arm'", "no <geometry>")),
    ("two shapes in one geometry", _BOX, _BOX + '<sphere radius="1"/>', ("'arm'", "<sphere>")),
    ("a number of 100000 digits", 'xyz="0 0 0.6"', f'xyz="0 0 {"9" * 100_000}"', ("<origin>", "at most 500")),
)  # fmt: skip

# name, shape in place of the arm's box, what the message says
_SHAPES: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("unknown shape", '<boks size="1 1 1"/>', ("<boks>", "did you mean 'box'")),
    ("box without a size", "<box/>", ("'arm'", "'size'")),
    ("box of two lengths", '<box size="1 1"/>', ("'arm'", "'1 1'")),
    ("box of negative size", '<box size="1 -1 1"/>', ("'arm'", "-1.0")),
    ("box that is NaN", '<box size="1 nan 1"/>', ("'arm'", "nan")),
    ("box that is too big", '<box size="1 1 1e300"/>', ("'arm'", "1e300")),
    ("box that is too small", '<box size="1 1 1e-300"/>', ("'arm'", "1e-300")),
    ("sphere of negative radius", '<sphere radius="-0.1"/>', ("'arm'", "-0.1")),
    ("sphere of a negligible radius", '<sphere radius="1e-9"/>', ("'arm'", "radius")),
    ("sphere with a diameter", '<sphere diameter="1"/>', ("'arm'", "'radius'")),
    ("cylinder without a length", '<cylinder radius="1"/>', ("'arm'", "'length'")),
    ("cylinder of infinite radius", '<cylinder radius="inf" length="2"/>', ("'arm'", "inf")),
    ("capsule of negative radius", '<capsule radius="-1" length="2"/>', ("'arm'", "radius")),
    ("capsule without a length", '<capsule radius="1"/>', ("'arm'", "'length'")),
    ("mesh without a file", "<mesh/>", ("'arm'", "filename")),
)  # fmt: skip

# name, mesh element's attributes, further files, what the message says
_MESHES: tuple[tuple[str, str, str, dict[str, Content], tuple[str, ...]], ...] = (
    ("missing", "gone.stl", "", {}, ("'gone.stl'", "not found")),
    ("missing package", "package://nobody/gone.stl", "", {}, ("'package://nobody/gone.stl'", "not found")),
    ("missing by file URL", "file:///no/such/gone.stl", "", {}, ("'file:///no/such/gone.stl'", "not found")),
    ("on the network", "http://localhost:9/a.stl", "", {}, ("'http://localhost:9/a.stl'", "not found")),
    ("a folder", "m.stl", "", {"m.stl": folder}, ("'m.stl'", "not found")),
    ("empty", "m.stl", "", {"m.stl": b""}, ("m.stl", "empty")),
    ("garbage", "m.stl", "", {"m.stl": bytes(range(256)) * 9}, ("m.stl",)),
    ("truncated", "m.stl", "", {"m.stl": b"\0" * 80 + (1000).to_bytes(4, "little") + b"\0" * 100}, ("m.stl",)),
    ("of a kind nobody reads", "m.txt", "", {"m.txt": "a mesh, believe me"}, ("m.txt",)),
    ("flat", "m.stl", "", {"m.stl": _FLAT}, ("m.stl",)),
    ("a single triangle", "m.stl", "", {"m.stl": _stl(_triangle("0 0 0", "1 0 0", "0 1 0"))}, ("m.stl",)),
    ("without triangles", "m.stl", "", {"m.stl": "solid s\nendsolid s\n"}, ("m.stl",)),
    ("with vertices that are NaN", "m.stl", "",
     {"m.stl": _stl(_triangle("0 0 0", "1 0 0", "0 nan 0"), _triangle("0 0 0", "1 0 0", "0 0 1"))}, ("m.stl",)),
    ("larger than the sky", "m.stl", "",
     {"m.stl": _stl(_triangle("0 0 0", "1 0 0", "0 1 0"), _triangle("0 0 0", "1 0 0", "0 0 3e38"))}, ("m.stl", "beyond")),
    ("of scale 0", "m.stl", ' scale="1 0 1"', {"m.stl": _FLAT}, ("'arm'", "scale")),
    ("of scale NaN", "m.stl", ' scale="1 nan 1"', {"m.stl": _FLAT}, ("'arm'", "1 nan 1")),
    ("of one scale", "m.stl", ' scale="0.001"', {"m.stl": _FLAT}, ("'arm'", "'0.001'")),
)  # fmt: skip

_SRDF: tuple[tuple[str, Content, tuple[str, ...]], ...] = (
    ("empty", "", ("is empty",)),
    ("truncated", SOUND_SRDF[:100], ("not well-formed",)),
    ("wrong root", SOUND_SRDF.replace("robot", "semantic"), ("<semantic>",)),
    ("DOCTYPE", SOUND_SRDF.replace("<robot", "<!DOCTYPE robot><robot"), ("document type",)),
    ("pair of one link", SOUND_SRDF.replace(' link2="arm"', ""), ("disable_collisions", "'link2'")),
    ("state without a name", SOUND_SRDF.replace('name="home" ', ""), ("group_state", "no name")),
    ("state of NaN", SOUND_SRDF.replace('"0.3"', '"nan"'), ("'shoulder'", "'nan'")),
    ("state in words", SOUND_SRDF.replace('"0.3"', '"up"'), ("'shoulder'", "'up'")),
    ("state without a value", SOUND_SRDF.replace(' value="0.3"', ""), ("'shoulder'", "None")),
)  # fmt: skip


def urdf_cases() -> Iterator[FileCase]:
    """Every malformed URDF."""

    def case(name: str, content: Content, says: tuple[str, ...], beside: dict[str, Content] | None = None) -> FileCase:
        return FileCase(f"urdf: {name}", "bad.urdf", content, RobotError, says, beside or {})

    for name, content, says in _DOCUMENTS:
        yield case(name, content, (says,))
    for name, old, new, words in _EDITS:
        assert SOUND.count(old) >= 1, name
        yield case(name, SOUND.replace(old, new, 1), words)
    for name, shape, words in _SHAPES:
        yield case(name, _shape(shape), words)
    for name, file, extra, beside, words in _MESHES:
        yield case(f"mesh {name}", _mesh(file, extra), words, beside)
    bare = SOUND
    while "<collision>" in bare:
        bare = bare[: bare.index("<collision>")] + bare[bare.index("</collision>") + len("</collision>") :]
    yield case("no collision geometry", bare, ("no collision geometry",))


def srdf_cases() -> Iterator[FileCase]:
    """Every malformed SRDF, for the sound robot."""
    for name, content, says in _SRDF:
        yield FileCase(f"srdf: {name}", "bad.srdf", content, RobotError, says, {"small.urdf": SOUND})
