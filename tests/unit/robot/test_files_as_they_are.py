"""URDF files as people have them: capsules, shapes of size 0, packages that are called otherwise than their folder,
inches, and other encodings than UTF-8."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from cases import each, refused

from elastic_strips.errors import RobotError
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.robot.second_reader import differences, shape_differences
from elastic_strips.robot.urdf import pinocchio_geometry, pinocchio_model, read_urdf
from elastic_strips.trajectory import MotionLimits

HEAD = '<?xml version="1.0"?>'
BOX = '<collision><geometry><box size="0.4 0.4 0.2"/></geometry></collision>'


def one(shape: str, *, origin: str = "0 0 0", name: str = "arm", tag: str = "collision") -> str:
    """A robot of a base and a link with one shape."""
    inner = f'<{tag}><origin xyz="{origin}" rpy="0.1 0.2 0.3"/><geometry>{shape}</geometry></{tag}>'
    return (
        f'<robot name="r"><link name="base">{BOX}</link><link name="{name}">{inner}</link>'
        f'<joint name="turn" type="revolute"><parent link="base"/><child link="{name}"/><origin xyz="0 0 0.7"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )


def load(folder: Path, content: str | bytes, **options: object) -> RobotModel:
    path = folder / "robot.urdf"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return load_robot(path, base="fixed", **options)


def arm(robot: RobotModel) -> coal.CollisionGeometry | None:
    return next((p.geometry for p in robot.geometries if "arm" in p.links), None)


def agrees(robot: RobotModel) -> bool:
    """Whether yourdfpy reads the same."""
    source = read_urdf(robot.urdf_path)
    model = pinocchio_model(source)
    shapes = pinocchio_geometry(source, model, pin.COLLISION)
    return not differences(source, model) and not shape_differences(source, model, shapes)


@each("radius, length", [(0.1, 0.5), (0.05, 1.2), (0.3, 0.01)])
def test_a_capsule_is_one(tmp_path: Path, radius: float, length: float) -> None:
    """Its length is that between the caps, as in SDF and in Coal."""
    robot = load(tmp_path, one(f'<capsule radius="{radius}" length="{length}"/>', origin="0.2 0 0"))
    shape = arm(robot)
    assert isinstance(shape, coal.Capsule)
    assert (shape.radius, 2.0 * shape.halfLength) == pytest.approx((radius, length))
    assert agrees(robot)
    drawn = load(tmp_path, one(f'<capsule radius="{radius}" length="{length}"/>', tag="visual"))
    assert drawn.bare_links == ("arm",)
    assert isinstance(drawn.visual_model.geometryObjects[0].geometry, coal.Capsule)
    taken = load(tmp_path, one(f'<capsule radius="{radius}" length="{length}"/>', tag="visual"),
                 visual_as_collision="missing")  # fmt: skip
    assert isinstance(arm(taken), coal.Capsule)


def test_capsules_and_cylinders_of_one_link_are_told_apart(tmp_path: Path) -> None:
    shapes = ('<cylinder radius="0.1" length="0.4"/>', '<capsule radius="0.1" length="0.4"/>', '<box size="1 1 0.1"/>')
    body = "".join(f"<collision><geometry>{shape}</geometry></collision>" for shape in shapes)
    robot = load(tmp_path, f'<robot name="r"><link name="arm">{body}</link></robot>')
    assert [type(p.geometry) for p in robot.geometries] == [coal.Cylinder, coal.Capsule, coal.Box]


def test_a_capsule_without_a_length_is_a_ball(tmp_path: Path) -> None:
    robot = load(tmp_path, one('<capsule radius="0.1" length="0"/>'))
    shape = arm(robot)
    assert isinstance(shape, coal.Sphere)
    assert shape.radius == pytest.approx(0.1)
    assert agrees(robot)


@each(
    "shape", ['<box size="0 0 0"/>', '<sphere radius="0"/>', '<cylinder radius="0" length="0"/>',
              '<capsule radius="0.0" length="0"/>', '<box size="0.0 0 -0.0"/>'],
)  # fmt: skip
@each("tag", ["collision", "visual"])
def test_a_shape_of_size_0_is_left_out_with_a_warning(
    tmp_path: Path, shape: str, tag: str, caplog: pytest.LogCaptureFixture
) -> None:
    robot = load(tmp_path, one(shape, tag=tag))
    assert arm(robot) is None
    assert robot.bare_links == ()
    assert "'arm'" in caplog.text
    assert tag == "visual" or agrees(robot)


@each(
    "shape", ['<box size="0.5 0.5 0"/>', '<box size="0.5 0 0"/>', '<cylinder radius="0.3" length="0"/>',
              '<cylinder radius="0" length="0.4"/>', '<capsule radius="0" length="0.4"/>'],
)  # fmt: skip
def test_a_plate_or_a_rod_without_thickness_is_there(
    tmp_path: Path, shape: str, caplog: pytest.LogCaptureFixture
) -> None:
    """One can run into it: leaving it out would be a hole."""
    robot = load(tmp_path, one(shape))
    found = arm(robot)
    assert found is not None
    found.computeLocalAABB()
    sides = np.sort(np.asarray(found.aabb_local.max_ - found.aabb_local.min_))
    assert sides[0] <= 3e-4
    assert sides[-1] >= 0.4
    assert "'arm'" in caplog.text
    assert agrees(robot)


def package(folder: Path, name: str, mesh: str = "box.stl") -> None:
    """A folder that is a ROS package of a name, with a mesh of 0.2 m."""
    import trimesh

    (folder / "meshes").mkdir(parents=True)
    (folder / "package.xml").write_text(f'<?xml version="1.0"?><package format="3"><name> {name} </name></package>')
    trimesh.creation.box((0.2, 0.2, 0.2)).export(folder / "meshes" / mesh)


MESH = '<mesh filename="package://my_robot/meshes/box.stl"/>'


@each("place", ["around", "beside", "given", "above"])
def test_a_package_is_known_by_its_package_xml(tmp_path: Path, place: str) -> None:
    folder, options = tmp_path / "checkout-main" / "urdf", {}
    folder.mkdir(parents=True)
    if place == "around":
        package(tmp_path / "checkout-main", "my_robot")
    elif place == "beside":
        package(tmp_path / "checkout-main" / "descr", "my_robot")
    elif place == "above":
        package(tmp_path / "other-checkout", "my_robot")
    else:
        package(tmp_path / "far" / "away" / "robot-ros2", "my_robot")
        options = {"package_dirs": (str(tmp_path / "far" / "away"),)}
    package(tmp_path / "wrong", "your_robot")
    robot = load(folder, one(MESH), **options)
    assert arm(robot) is not None


def test_package_files_that_are_no_xml_name_nothing(tmp_path: Path) -> None:
    package(tmp_path / "a", "my_robot")
    (tmp_path / "a" / "package.xml").write_text("<package><name>my_robot")
    with refused(RobotError, "my_robot"):
        load(tmp_path, one(MESH))


DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2020-01-01T00:00:00</created><modified>2020-01-01T00:00:00</modified>{asset}</asset>
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="pa" count="12">0 0 0 10 0 0 0 20 0 0 0 30
</float_array><technique_common><accessor source="#pa" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/><p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles>
</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s"><node id="n">
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


@each(
    "asset, scale, metre",
    [
        ('<unit meter="0.0254" name="inch"/>', "", 0.0254),
        ('<unit name="centimeter" meter="0.01"/><up_axis>Y_UP</up_axis>', "", 0.01),
        ('<unit meter="0.001"/>', ' scale="2 2 2"', 0.002),
        ('<unit meter="1"/>', "", 1.0),
        ("", ' scale="0.1 0.1 0.1"', 0.1),
        ('<unit meter="nonsense"/>', "", 1.0),
    ],
)
@each("tag", ["collision", "visual"])
def test_a_collada_file_is_as_large_as_its_unit_says(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, asset: str, scale: str, metre: float, tag: str
) -> None:
    (tmp_path / "part.dae").write_text(DAE.format(asset=asset))
    robot = load(tmp_path, one(f'<mesh filename="part.dae"{scale}/>', tag=tag))
    geometry = (robot.shapes if tag == "collision" else robot.visual_model).geometryObjects
    shape = next(item.geometry for item in geometry if item.name == "arm_0")
    points = np.array(shape.vertices())
    np.testing.assert_allclose(np.ptp(points, axis=0), metre * np.array([10.0, 20.0, 30.0]), rtol=1e-6)
    assert ("nonsense" in caplog.text) == ("nonsense" in asset)
    if tag == "collision" and "nonsense" not in asset:
        assert agrees(robot)


@each(
    "axis, centre, told",
    [("Y_UP", "3 -8 5", True), ("Y_UP", "3 5 8", False), ("Y_UP", "0 0 0", False), ("Z_UP", "3 -8 5", False),
     ("", "3 -8 5", False)],
)  # fmt: skip
def test_meshes_that_were_meant_to_be_turned_are_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, axis: str, centre: str, told: bool
) -> None:
    """The file is of 10 x 20 x 30 m; y up would make of it 10 x 30 x 20 m, to the other side of y = 0."""
    (tmp_path / "part.dae").write_text(DAE.format(asset=f"<up_axis>{axis}</up_axis>" if axis else ""))
    mass = (
        f'<inertial><origin xyz="{centre}"/><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    text = (
        one('<mesh filename="part.dae"/>')
        .replace('rpy="0.1 0.2 0.3"', "")
        .replace("<collision>", mass + "<collision>", 2)
    )
    robot = load(tmp_path, text)
    assert any("Y_UP" in record.getMessage() for record in caplog.records) == told
    assert any("Y_UP" in trouble for trouble in robot.card().troubles) == told


@each(
    "encoding, declared, name",
    [
        ("latin-1", "ISO-8859-1", "Kübel"),
        ("cp1252", "windows-1252", "arm–1"),
        ("utf-16", "UTF-16", "アーム"),
        ("utf-16", "", "Kübel"),  # its mark says so
        ("utf-8-sig", "utf-8", "Kübel"),
        ("utf-8", "", "Kübel"),
        ("shift_jis", "Shift_JIS", "アーム"),
        ("latin-1", "latin-1", "Kübel"),  # a name that Python knows and libxml2 does not
    ],
)
def test_a_file_is_decoded_as_it_declares(tmp_path: Path, encoding: str, declared: str, name: str) -> None:
    head = f'<?xml version="1.0" encoding="{declared}"?>' if declared else HEAD
    text = head + one('<sphere radius="0.1"/>', name=name)
    robot = load(tmp_path, text.encode(encoding))
    assert {link for piece in robot.geometries for link in piece.links} == {"base", name}
    assert agrees(robot)


@pytest.mark.process
def test_xacro_files_are_decoded_as_they_declare(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    text = '<?xml version="1.0" encoding="ISO-8859-1"?>' + one('<sphere radius="${0.1}"/>', name="Kübel").replace(
        "<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" '
    )
    path = tmp_path / "robot.urdf.xacro"
    path.write_bytes(text.encode("latin-1"))
    robot = load_robot(path, base="fixed")
    assert "Kübel" in {link for piece in robot.geometries for link in piece.links}


def rover(*wheels: tuple[str, str, str, float]) -> str:
    """A base with wheels: (joint, parent, place, radius), about y; a parent that is a swivel turns about z."""
    parts = [f'<link name="base">{BOX}</link>']
    for name, parent, at, radius in wheels:
        axis = "0 0 1" if "swivel" in name or "fork" in name else "0 1 0"
        shape = f'<origin rpy="1.5708 0 0"/><geometry><cylinder radius="{radius}" length="0.04"/></geometry>'
        parts.append(
            f'<link name="{name}_link"><collision>{shape}</collision></link><joint name="{name}" type="continuous">'
            f'<parent link="{parent}"/><child link="{name}_link"/><origin xyz="{at}"/><axis xyz="{axis}"/>'
            '<limit effort="1" velocity="10"/></joint>'
        )
    return f'<robot name="rover">{"".join(parts)}</robot>'


DRIVEN = (("left_wheel", "base", "0 0.2 0.1", 0.1), ("right_wheel", "base", "0 -0.2 0.1", 0.1))


@each(
    "casters",
    [
        (
            ("front_left_caster_wheel", "base", "0.3 0.1 0.03", 0.03),
            ("front_right_caster_wheel", "base", "0.3 -0.1 0.03", 0.03),
        ),
        (("castor_wheel_l", "base", "-0.3 0.15 0.05", 0.05), ("castor_wheel_r", "base", "-0.3 -0.15 0.05", 0.05)),
        (
            ("fork_l", "base", "0.3 0.1 0.1", 0.01),
            ("fork_r", "base", "0.3 -0.1 0.1", 0.01),
            ("support_wheel_l", "fork_l_link", "0 0 -0.05", 0.05),
            ("support_wheel_r", "fork_r_link", "0 0 -0.05", 0.05),
        ),
    ],
)  # fmt: skip
def test_casters_that_are_named_wheels_do_not_drive(
    tmp_path: Path, casters: tuple[tuple[str, str, str, float], ...]
) -> None:
    path = tmp_path / "rover.urdf"
    path.write_text(rover(*DRIVEN, *casters))
    robot = load_robot(path, base="diff_drive")
    limits = MotionLimits.for_robot(robot)
    assert (limits.track, limits.wheel_radius) == pytest.approx((0.4, 0.1))
    assert robot.joint_names == ()


def test_casters_alone_are_asked_about_as_before(tmp_path: Path) -> None:
    path = tmp_path / "rover.urdf"
    path.write_text(rover(*[(f"caster_{name}", *rest) for name, *rest in DRIVEN]))
    assert MotionLimits.for_robot(load_robot(path, base="diff_drive")).track == pytest.approx(0.4)
