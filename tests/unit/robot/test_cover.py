"""Links that are drawn and have no collision shape: who is told of them, and what can be taken instead."""

from __future__ import annotations

import pickle
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from cases import each, refused

import elastic_strips as es
from elastic_strips.coal_shapes import outside
from elastic_strips.errors import RobotError
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.robot.cover import sticks_out
from elastic_strips.robot.geometry import piece_of
from elastic_strips.scene import Box, Scene

BOX = '<geometry><box size="{}"/></geometry>'.format


def link(name: str, shape: str = "", drawn: str = "", at: str = "0 0 0") -> str:
    """A link with a collision shape and a drawn one, where they are given."""
    body = f'<origin xyz="{at}"/>'
    parts = (f"<{tag}>{body}{each}</{tag}>" for tag, each in (("visual", drawn), ("collision", shape)) if each)
    return f'<link name="{name}">{"".join(parts)}</link>'


def joint(child: str, parent: str, at: str = "0 0 0", kind: str = "revolute") -> str:
    return (
        f'<joint name="to_{child}" type="{kind}"><origin xyz="{at}"/><parent link="{parent}"/><child link="{child}"/>'
        '<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
    )


def write(folder: Path, *parts: str) -> Path:
    path = folder / "bare.urdf"
    path.write_text(f'<robot name="bare">{"".join(parts)}</robot>')
    return path


BASE = link("base", BOX("0.8 0.5 0.3"), BOX("0.8 0.5 0.3"), "0 0 0.15")
UPPER = link("upper", BOX("0.4 0.06 0.06"), BOX("0.4 0.06 0.06"), "0.2 0 0") + joint("upper", "base", "0 0 0.5")
FOREARM = link("forearm", "", BOX("0.6 0.06 0.06"), "0.3 0 0") + joint("forearm", "upper", "0.4 0 0")
POST = Scene([Box((0.05, 0.05, 1.0), at=(0.7, 0.0, 0.5), name="post")])


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    return write(tmp_path, BASE, UPPER, FOREARM)


def test_a_link_without_a_shape_is_told_everywhere(bare: Path, caplog: pytest.LogCaptureFixture) -> None:
    robot = load_robot(bare, base="omni")
    assert robot.bare_links == ("forearm",)
    assert "'forearm'" in caplog.text
    assert "forearm" in repr(robot)
    found = es.certify(robot, POST, [robot.home(), robot.home()])
    assert found.certified
    assert "forearm" in found.reason


def test_what_is_drawn_can_be_taken_instead(bare: Path, caplog: pytest.LogCaptureFixture) -> None:
    for given in ("missing", ["forearm"], ("forearm", "upper")):
        caplog.clear()
        robot = load_robot(bare, base="omni", visual_as_collision=given)
        assert robot.bare_links == ()
        assert "'forearm'" not in caplog.text
        found = es.certify(robot, POST, [robot.home(), robot.home()])
        assert not found.certified
        assert found.broken is not None
        assert found.broken.link.startswith("forearm")


@each("shape", ['<box size="0 0 0"/>', '<sphere radius="0.0"/>', '<capsule radius="0" length="0"/>'])
def test_a_shape_of_size_0_is_none(tmp_path: Path, shape: str) -> None:
    """What its warning advises has to help."""
    forearm = link("forearm", f"<geometry>{shape}</geometry>", BOX("0.6 0.06 0.06"), "0.3 0 0")
    path = write(tmp_path, BASE, UPPER, forearm, joint("forearm", "upper", "0.4 0 0"))
    assert load_robot(path, base="omni").bare_links == ("forearm",)
    robot = load_robot(path, base="omni", visual_as_collision="missing")
    assert robot.bare_links == ()
    assert not es.certify(robot, POST, [robot.home(), robot.home()]).certified


@each("given", [["fore_arm"], ["empty"], "forearm", ["base", ""], None, 5])
def test_links_that_have_nothing_to_take_are_refused(tmp_path: Path, given: list[str] | str) -> None:
    path = write(tmp_path, BASE, FOREARM, UPPER, link("empty"), joint("empty", "base", kind="fixed"))
    with refused(RobotError, "visual_as_collision"):
        load_robot(path, visual_as_collision=given)


def test_own_shapes_give_way_to_what_is_drawn(tmp_path: Path) -> None:
    path = write(tmp_path, link("base", BOX("0.2 0.2 0.2"), BOX("1 1 0.1")))
    (piece,) = load_robot(path, visual_as_collision=["base"]).geometries
    np.testing.assert_allclose(2.0 * np.asarray(piece.geometry.halfSide), [1.0, 1.0, 0.1])


@each(
    "size, at, told",
    [
        ("0.1 0.1 0.1", "0 0 0.15", False),  # within the base
        ("0.1 0.1 0.1", "0 0 0.253", False),  # out of it by 3 mm
        ("0.1 0.1 0.1", "0 0 0.28", True),  # by 30 mm
        ("0.02 0.02 0.02", "0.6 0 0.15", True),
        ("1.2 0.1 0.1", "0 0 0.15", True),  # out at both ends
    ],
)
def test_what_another_link_of_the_same_body_covers_is_no_hole(tmp_path: Path, size: str, at: str, told: bool) -> None:
    plate = link("plate", "", BOX(size)) + joint("plate", "base", at, "fixed")
    robot = load_robot(write(tmp_path, BASE, plate), base="omni")
    assert robot.bare_links == (("plate",) if told else ())


def test_what_moves_within_another_link_is_a_hole(tmp_path: Path) -> None:
    """A drum in the base that turns with something: the base's shape is not its own."""
    drum = link("drum", "", BOX("0.1 0.1 0.1")) + joint("drum", "base", "0 0 0.15")
    path = write(tmp_path, BASE, drum)
    assert load_robot(path, base="omni").bare_links == ("drum",)
    assert load_robot(path, base="omni", locked={"to_drum": 0.0}).bare_links == ()


def test_frames_without_anything_to_draw_are_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write(tmp_path, BASE, link("tool"), joint("tool", "base", kind="fixed"))
    assert load_robot(path, base="omni").bare_links == ()
    assert not caplog.text


def test_a_drawing_that_cannot_be_read_counts_as_a_hole(tmp_path: Path) -> None:
    lost = link("hood", "", '<geometry><mesh filename="gone.stl"/></geometry>') + joint("hood", "base", kind="fixed")
    path = write(tmp_path, BASE, lost)
    assert load_robot(path, base="omni").bare_links == ("hood",)
    with refused(RobotError, "gone.stl"):
        load_robot(path, base="omni", visual_as_collision="missing")


def test_meshes_are_looked_at_as_well(tmp_path: Path) -> None:
    for name, size in (("small", 0.1), ("large", 0.5)):
        trimesh.creation.box((size,) * 3).export(tmp_path / f"{name}.stl")
    for name, told in (("small", ()), ("large", ("hood",))):
        mesh = f'<geometry><mesh filename="{name}.stl"/></geometry>'
        hood = link("hood", "", mesh) + joint("hood", "base", "0 0 0.15", "fixed")
        assert load_robot(write(tmp_path, BASE, hood), base="omni").bare_links == told


def test_a_hull_that_grows_much_is_warned_about(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """An L of two bars: its hull fills the corner."""
    bars = [trimesh.creation.box((1.0, 0.1, 0.1)), trimesh.creation.box((0.1, 1.0, 0.1))]
    bars[0].apply_translation((0.5, 0.0, 0.0))
    bars[1].apply_translation((0.0, 0.5, 0.0))
    trimesh.util.concatenate(bars).export(tmp_path / "angle.stl")
    mesh = '<geometry><mesh filename="angle.stl"/></geometry>'
    path = write(tmp_path, BASE, link("angle", "", mesh), joint("angle", "base", "0 0 0.5"))
    robot = load_robot(path, base="omni", visual_as_collision="missing")
    assert "angle_0" in caplog.text
    piece = next(p for p in robot.geometries if p.links == ("angle",))
    assert robot.shapes is not None
    assert 0.3 < sticks_out(robot.model, robot.shapes, piece) <= 0.475 + 1e-6  # in the middle of the hypotenuse
    base = next(p for p in robot.geometries if p.links == ("base",))
    assert sticks_out(robot.model, robot.shapes, base) < 1e-6


@pytest.mark.parametrize(
    "shape", ['<cylinder radius="0.2" length="0.3"/>', '<sphere radius="0.2"/>', '<box size="1 2 3"/>']
)
def test_a_shape_that_is_its_own_piece_does_not_reach_out_of_itself(tmp_path: Path, shape: str) -> None:
    robot = load_robot(write(tmp_path, link("base", f"<geometry>{shape}</geometry>")), base="omni")
    (piece,) = robot.geometries
    assert robot.shapes is not None
    assert sticks_out(robot.model, robot.shapes, piece) < 1e-9
    larger = piece_of("larger", ("base",), piece.joint, coal.Cylinder(1.5, 4.0), np.eye(4))
    assert sticks_out(robot.model, robot.shapes, larger) > 0.4, "it is looked at where it is"


@pytest.mark.parametrize("closed, least, most", [(True, 0.0, 0.06), (False, 0.1, 0.6)])
def test_what_is_within_a_mesh_does_not_reach_out_of_it(
    tmp_path: Path, closed: bool, least: float, most: float
) -> None:
    """A piece of 20 cm in the middle of a mesh, which is hollow to Coal; it does where the mesh has no lid."""
    mesh = trimesh.creation.box((1.0, 1.0, 0.6))
    if not closed:
        mesh.update_faces(mesh.face_normals[:, 2] < 0.5)
    mesh.export(tmp_path / "block.stl")
    path = write(tmp_path, link("base", '<geometry><mesh filename="block.stl"/></geometry>'))
    robot = load_robot(path, base="omni")
    inner = piece_of("inner", ("base",), robot.geometries[0].joint, coal.Box(0.2, 0.2, 0.2), np.eye(4))
    assert robot.shapes is not None
    assert least <= sticks_out(robot.model, robot.shapes, inner) <= most


def test_models_of_pinocchio_are_told_of_as_well(bare: Path) -> None:
    model = pin.buildModelFromUrdf(str(bare), pin.JointModelPlanar())
    collision, visual = (pin.buildGeomFromUrdf(model, str(bare), kind) for kind in (pin.COLLISION, pin.VISUAL))
    assert RobotModel.from_pinocchio(model, collision, visual).bare_links == ("forearm",)
    assert RobotModel.from_pinocchio(model, visual, visual).bare_links == ()


def test_a_copy_from_another_process_knows_it(bare: Path) -> None:
    copy = pickle.loads(pickle.dumps(load_robot(bare, base="omni")))
    assert copy.bare_links == ("forearm",)
    assert copy.card().section("Links that are drawn and have no collision shape").rows == (("forearm",),)


def test_many_joints_are_said_to_be_many_with_what_to_lock(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    def chain(names: list[str], parent: str) -> str:
        parts = ""
        for name in names:
            parts += link(name, BOX("0.1 0.02 0.02"), at="0.1 0 0") + joint(name, parent, "0.2 0 0")
            parent = name
        return parts

    arm = chain([f"arm_{k}" for k in range(10)], "base")
    fingers = "".join(chain([f"finger_{f}_{k}" for k in range(3)], "arm_9") for f in range(4))
    robot = load_robot(write(tmp_path, BASE, arm, fingers), base="omni")
    assert len(robot.joint_names) == 22
    said = next(r.getMessage() for r in caplog.records if "22 joints" in r.getMessage())
    assert "'to_finger_0_0'" in said
    assert "'to_arm_3'" not in said
    odd = "".join(chain([f"d{f}{k}" for k in range(3)], "arm_9") for f in range(4))
    caplog.clear()
    load_robot(write(tmp_path, BASE, arm, odd), base="omni")
    assert "'to_d00'" in caplog.text
    assert "'to_arm_3'" not in caplog.text


@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_a_sheet_that_is_drawn_can_be_taken(tmp_path: Path, tilt: float) -> None:
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    sheet.apply_transform(trimesh.transformations.rotation_matrix(tilt, [1, 0, 0]))
    sheet.export(tmp_path / "sheet.stl")
    mesh = '<geometry><mesh filename="sheet.stl"/></geometry>'
    path = write(tmp_path, BASE, link("sail", "", mesh), joint("sail", "base", "0 0 1"))
    piece = next(p for p in load_robot(path, visual_as_collision="missing").geometries if p.links == ("sail",))
    assert (outside(piece.geometry, np.asarray(sheet.vertices)) <= 1e-6).all()
    assert np.ptp(np.array(piece.geometry.points()), axis=0).min() <= 1.0 * np.sin(tilt) + 2e-4
