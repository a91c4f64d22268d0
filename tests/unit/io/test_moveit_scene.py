"""MoveIt's scene files: both versions, what is left out, and what is no such file."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from cases import each, refused

import elastic_strips as es
from elastic_strips.errors import SceneError
from elastic_strips.io import read_moveit_scene
from elastic_strips.scene import Cone
from elastic_strips.scene.quantities import quaternion_of

HALF = 0.5**0.5


def text(scene: es.Scene, *, posed: bool = True, colour: str = "0 0 0 0") -> str:
    """The file that MoveIt would write: every obstacle half a metre along its object's x axis."""
    lines = ["made"]
    for obstacle in scene:
        lines.append(f"* {obstacle.name}")
        pose = obstacle.pose.copy()
        if posed:
            lines += ["-0.5 0 0", "0 0 0 1"]
            pose[0, 3] += 0.5
        spec = obstacle.spec
        lines += ["1", obstacle.shape]
        if obstacle.shape == "mesh":
            lines.append(f"{len(spec['vertices'])} {len(spec['faces'])}")
            lines += [" ".join(map(repr, row)) for row in spec["vertices"].tolist()]
            lines += [" ".join(str(int(i)) for i in row) for row in spec["faces"]]
        elif obstacle.shape == "box":
            lines.append(" ".join(map(repr, spec["size"].tolist())))
        else:
            lines.append(" ".join(repr(spec[key]) for key in ("radius", "length") if key in spec))
        lines += [" ".join(map(repr, pose[:3, 3].tolist()))]
        lines += [" ".join(map(repr, quaternion_of(pose[:3, :3]).tolist())), colour]
        lines += ["1", "grip", "0 0 1", "0 0 0 1"] if posed else []
    return "\n".join([*lines, "."]) + "\n"


@pytest.fixture
def scene() -> es.Scene:
    turned = (0.0, HALF, 0.0, HALF)
    corners = [[0, 0, 0], [0.4, 0, 0], [0, 0.4, 0], [0, 0, 0.4]]
    return es.Scene([
        es.Box((0.3, 0.4, 0.5), at=(1, 2, 0.3), quat=turned, name="table top"),
        es.Sphere(0.2, at=(1, -2, 0.3), name="ball"),
        es.Cylinder(0.1, 0.7, at=(3, 0, 0.3), quat=turned, name="can"),
        Cone(0.1, 0.6, at=(4, 0, 0.3), name="cone"),
        es.Mesh(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], at=(5, 1, 0), name="wedge"),
    ])  # fmt: skip


@pytest.mark.parametrize("posed", [True, False])
def test_a_scene_comes_back_with_its_shapes_and_places(tmp_path, scene, posed):
    file = tmp_path / "s.scene"
    file.write_text(text(scene, posed=posed))
    back = es.read_scene(file)
    assert back.names == scene.names
    for one, two in zip(scene, back, strict=True):
        assert one.shape == two.shape
        np.testing.assert_allclose(one.pose, two.pose, atol=1e-12)
        for key, value in one.spec.items():
            np.testing.assert_allclose(two.spec[key], value)


def test_what_is_left_out_is_said(tmp_path, caplog, scene):
    file = tmp_path / "s.scene"
    plane = (
        "* floor\n0 0 0\n0 0 0 1\n2\nplane\n0 0 1 0\n0 0 0\n0 0 0 1\n0 0 0 0\nbox\n1 1 1\n9 0 0\n0 0 0 1\n0 0 0 0\n0\n"
    )
    file.write_text(text(scene, colour="1 0 0 1").removesuffix(".\n") + plane + ".\n")
    with caplog.at_level(logging.WARNING):
        back = read_moveit_scene(file, planes="free")
    assert back.names == (*scene.names, "floor")
    assert "5 colours, 5 subframes, 1 planes" in caplog.text
    assert read_moveit_scene(file).names == (*scene.names, "floor-1", "floor-2")
    caplog.clear()
    file.write_text(text(scene, posed=False))
    read_moveit_scene(file)
    assert not caplog.text


def test_an_object_of_several_shapes_is_several_obstacles(tmp_path):
    file = tmp_path / "s.scene"
    shape = "sphere\n0.1\n{} 0 0\n0 0 0 1\n0 0 0 0\n"
    pair = "* pair\n0 0 1\n0 0 0 1\n2\n" + shape.format(1) + shape.format(2) + "0\n"
    file.write_text(f"x\n{pair}* pair-1\n0 0 0\n0 0 0 1\n1\n{shape.format(5)}0\n.\n")
    back = read_moveit_scene(file)
    assert back.names == ("pair-1'", "pair-2", "pair-1")
    np.testing.assert_allclose([o.pose[:3, 3] for o in back], [[1, 0, 1], [2, 0, 1], [5, 0, 0]])


@each(
    ("content", "says"),
    [
        ("", "empty"),
        ("name\n", "ends"),
        ("name\n* a\n1\nbox\n1 1\n0 0 0\n0 0 0 1\n0 0 0 0\n.\n", ":"),
        ("name\n* a\n1\nbxo\n1 1 1\n0 0 0\n0 0 0 1\n0 0 0 0\n.\n", "did you mean 'box'"),
        ("name\n* a\n1\nbox\n1 1 -1\n0 0 0\n0 0 0 1\n0 0 0 0\n.\n", ":4: Box size"),
        ("name\n* a\n1\nbox\n1 1 1\n0 0 0\n0 0 0 0\n0 0 0 0\n.\n", ":7: the quaternion"),
        ("name\n* a\n1\nmesh\n9999999 1\n0 0 0\n", "ends where a vertex"),
        ("name\n* a\nmany\n", "'many'"),
        ("name\n* a\n1\nsphere\nnan\n0 0 0\n0 0 0 1\n0 0 0 0\n.\n", "not finite"),
        ("name\n!\n", "'!'"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_line(tmp_path, content, says):
    file = tmp_path / "bad.scene"
    file.write_text(content)
    with refused(SceneError, "bad.scene:") as caught:
        es.read_scene(file)
    assert says in str(caught.value)


@each("sizes", ["0.03", "0.03 0.12 0.4"])
@each("posed", [True, False])
def test_a_size_that_is_missing_is_said_at_its_shape(tmp_path, posed, sizes):
    """Not far below, where the words no longer fit; sizes on several lines, which MoveIt reads too, are read."""
    at = "2 1 0.5\n0 0 0 1\n"
    shape = "1\ncylinder\n{}\n" + at + "0 0 0 0\n" + ("0\n" if posed else "")
    whole = "room\n" + "".join(f"* {name}\n" + (at if posed else "") + shape for name in ("cup", "can")) + ".\n"
    file = tmp_path / "room.scene"
    file.write_text(whole.format("0.03 0.12", sizes))
    line = whole.format("0.03 0.12", sizes).splitlines().index(sizes) + 1
    with pytest.raises(SceneError, match=rf"room\.scene:{line}: .*2 sizes of a cylinder.*; in line \d+: "):
        es.read_scene(file)
    file.write_text(whole.format("0.03\n0.12", "0.03 0.12"))
    assert es.read_scene(file).names == ("cup", "can")
