"""The second reader: what yourdfpy finds otherwise is said, and nothing else is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from cases import each

from elastic_strips.robot import load_robot, loading
from elastic_strips.robot.second_reader import differences, shape_differences
from elastic_strips.robot.urdf import UrdfSource, pinocchio_geometry, pinocchio_model, read_urdf

LIMIT = '<limit lower="-1" upper="2" effort="1" velocity="3"/>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", more: str = "", axis: str = "0 1 0") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.1 0.2 0.3" rpy="0.4 -0.5 0.6"/><axis xyz="{axis}"/>{LIMIT}{more}</joint>'
    )


def link(name: str, shape: str) -> str:
    return (
        f'<link name="{name}"><collision><origin xyz="0.05 0 0" rpy="0 0.3 0"/><geometry>{shape}</geometry>'
        "</collision></link>"
    )


ROBOT = (
    '<robot name="r">'
    + link("base", '<box size="0.4 0.3 0.2"/>')
    + link("a", '<cylinder radius="0.05" length="0.3"/>')
    + link("b", '<sphere radius="0.1"/>')
    + link("c", '<capsule radius="0.03" length="0.1"/>')
    + link("d", '<box size="0.1 0.1 0"/>')
    + joint("ja", "base", "a")
    + joint("jb", "a", "b", "prismatic")
    + joint("jc", "b", "c", more='<mimic joint="ja" multiplier="-0.5" offset="0.1"/>')
    + joint("jd", "c", "d", "continuous", '<mimic joint="jc" multiplier="2"/>')
    + "</robot>"
)


def read(folder: Path, content: str = ROBOT) -> tuple[UrdfSource, pin.Model]:
    path = folder / "twice.urdf"
    path.write_text(content)
    source = read_urdf(path)
    return source, pinocchio_model(source)


def test_a_correct_file_is_read_alike(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    source, model = read(tmp_path)
    assert differences(source, model) == ()
    assert shape_differences(source, model, pinocchio_geometry(source, model, pin.COLLISION)) == ()
    caplog.clear()
    load_robot(source.path, base="omni")
    assert "yourdfpy" not in caplog.text


def moved(model: pin.Model) -> None:
    model.jointPlacements[2] = model.jointPlacements[2] * pin.SE3(np.eye(3), np.array([0.0, 0.001, 0.0]))


def turned(model: pin.Model) -> None:
    model.jointPlacements[1] = model.jointPlacements[1] * pin.SE3(pin.rpy.rpyToMatrix(1e-4, 0.0, 0.0), np.zeros(3))


def narrowed(model: pin.Model) -> None:
    model.upperPositionLimit[model.joints[model.getJointId("jb")].idx_q] = 1.9


def hurried(model: pin.Model) -> None:
    model.velocityLimit[model.joints[model.getJointId("ja")].idx_v] = 4.0


@each("change, named", [(moved, "'b'"), (turned, "'a'"), (narrowed, "'jb'"), (hurried, "'ja'")])
def test_a_first_reader_that_errs_is_found_out(
    tmp_path: Path, change: Callable[[pin.Model], None], named: str, monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    source, model = read(tmp_path)
    change(model)
    (said,) = differences(source, model)
    assert named in said

    def erring(source: UrdfSource, *, planar: bool = False) -> pin.Model:
        model = pinocchio_model(source)
        change(model)
        return model

    monkeypatch.setattr(loading, "pinocchio_model", erring)
    load_robot(source.path, base="fixed")
    assert any("yourdfpy" in r.getMessage() and named in r.getMessage() for r in caplog.records)


@each(
    "followers",
    [
        {},
        {"jc": ("ja", -0.5, 0.1)},
        {"jc": ("ja", 0.5, 0.1), "jd": ("jc", 2.0, 0.0)},
        {"jc": ("jb", -0.5, 0.1), "jd": ("jc", 2.0, 0.0)},
        {"jc": ("ja", -0.5, 0.0), "jd": ("jc", 2.0, 0.0)},
    ],
)
def test_mimics_that_are_read_otherwise_are_found(
    tmp_path: Path, followers: dict[str, tuple[str, float, float]]
) -> None:
    source, model = read(tmp_path)
    wrong = dataclasses.replace(source, followers=followers)
    assert any("mimics" in said for said in differences(wrong, model))


@each(
    "link, shape, place",
    [
        ("base", coal.Box(0.4, 0.3, 0.25), None),
        ("a", coal.Cylinder(0.06, 0.3), None),
        ("a", coal.Capsule(0.05, 0.3), None),
        ("b", None, pin.SE3(np.eye(3), np.array([0.05, 0.001, 0.0]))),
        ("c", coal.Capsule(0.03, 0.12), None),
    ],
)
def test_shapes_that_are_read_otherwise_are_found(
    tmp_path: Path, link: str, shape: coal.CollisionGeometry | None, place: pin.SE3 | None
) -> None:
    source, model = read(tmp_path)
    shapes = pinocchio_geometry(source, model, pin.COLLISION)
    item = next(item for item in shapes.geometryObjects if item.name == f"{link}_0")
    if shape is not None:
        item.geometry = shape
    if place is not None:
        item.placement = item.placement * place
    (said,) = shape_differences(source, model, shapes)
    assert f"'{link}_0'" in said


def test_meshes_that_are_read_otherwise_are_found(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((0.2, 0.3, 0.4)).export(tmp_path / "part.stl")
    source, model = read(
        tmp_path, f'<robot name="r">{link("base", "<mesh filename=" + chr(34) + "part.stl" + chr(34) + "/>")}</robot>'
    )
    shapes = pinocchio_geometry(source, model, pin.COLLISION)
    assert shape_differences(source, model, shapes) == ()
    trimesh.creation.box((0.2, 0.3, 0.41)).export(tmp_path / "part.stl")
    (said,) = shape_differences(source, model, shapes)
    assert "part.stl" in said


def test_what_a_file_leaves_open_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A sliding joint along an axis of length 2: one reader slides by its value, the other by twice that."""
    source, _ = read(tmp_path, ROBOT.replace("</robot>", "") + link("e", '<sphere radius="0.1"/>')
                     + joint("je", "base", "e", "prismatic", axis="0 0 2") + "</robot>")  # fmt: skip
    load_robot(source.path, base="fixed")
    assert any("yourdfpy" in r.getMessage() and "'e'" in r.getMessage() for r in caplog.records)


def test_a_file_that_yourdfpy_does_not_read_is_no_difference(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")

    def refuses(*given: object, **named: object) -> None:
        raise ValueError("not this one")

    source, _ = read(tmp_path)
    monkeypatch.setattr(yourdfpy.URDF, "load", refuses)
    robot = load_robot(source.path, base="fixed")
    assert not [r for r in caplog.records if r.name.endswith("loading")]
    assert "not read" in robot.card().section("What another reader (yourdfpy) finds otherwise").note
