"""Self pairs: every pair of links is looked at but those that a joint joins, an SRDF leaves out, or that always touch.

What is looked at is judged by the URDF's own shapes in Pinocchio and Coal, posture by posture.
"""

from __future__ import annotations

import itertools
import logging
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from brute_force import configuration, random_coordinates, self_distances
from cases import each, each_robot, refused

import elastic_strips as es
from elastic_strips.errors import RobotError
from elastic_strips.planning.validity import ValidityChecker
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.robot.geometry import collision_data
from elastic_strips.robot.least_distance import least_distance
from elastic_strips.robot.unchecked_pairs import WhyUnchecked, joints_of_links
from elastic_strips.scene import Scene

BASE = "0.8 0.5 0.3"


def box(size: str) -> str:
    return f'<box size="{size}"/>'


def link(name: str, shape: str = "", at: str = "0 0 0") -> str:
    body = f'<collision><origin xyz="{at}"/><geometry>{shape}</geometry></collision>' if shape else ""
    return f'<link name="{name}">{body}</link>'


def fixed(name: str, at: str, parent: str, child: str) -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="fixed"><origin xyz="{at}"/>{ends}</joint>'


def joint(
    name: str, at: str, parent: str, child: str, axis: str = "0 0 1", kind: str = "revolute", span=(-3, 3)
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{at}"/><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{axis}"/><limit lower="{span[0]}" upper="{span[1]}" effort="1" velocity="1"/></joint>'
    )


def write(folder: Path, *parts: str, name: str = "r.urdf") -> Path:
    path = folder / name
    path.write_text(f'<robot name="r">{"".join(parts)}</robot>')
    return path


UPPER = link("base", box("0.4 0.4 0.2")) + joint("shoulder", "0 0 0.15", "base", "upper")
UPPER += link("upper", box("0.06 0.06 0.34"), "0 0 0.17")
AXIS = "0 1 0"


@each(
    ("at", "span", "looked_at"),
    [
        ("0 0 0.36", (-2.4, 2.4), True),  # 2 cm apart while straight, and flat on each other at the end
        ("0 0 0.36", (-1.0, 1.0), False),  # it does not turn so far
        ("0 0 0.33", (-2.4, 2.4), False),  # always in each other, about the joint
        ("0 0 0.50", (-2.4, 2.4), False),  # never
    ],
)
def test_what_a_joint_folds_together_is_kept_apart(tmp_path: Path, at: str, span: tuple[float, float], looked_at: bool):
    fore = joint("elbow", at, "upper", "fore", AXIS, span=span) + link("fore", box("0.08 0.08 0.3"), "0 0 0.17")
    robot = load_robot(write(tmp_path, UPPER, fore), base="omni")
    unchecked = [pair for pair in robot.unchecked_pairs if pair.links == ("fore", "upper")]
    assert [pair.why for pair in unchecked] == ([] if looked_at else [WhyUnchecked.JOINED])
    straight, bent = robot.home(), robot.home(joints={"elbow": span[1]})
    assert robot.self_collision(straight) is None
    path = np.stack([straight, bent])
    assert es.certify(robot, Scene(), path).certified is not looked_at
    if looked_at:  # by the file's own shapes
        model = pin.buildModelFromUrdf(str(tmp_path / "r.urdf"))
        shapes = pin.buildGeomFromUrdf(model, str(tmp_path / "r.urdf"), pin.COLLISION)
        pin.updateGeometryPlacements(model, model.createData(), shapes, data := shapes.createData(), bent[-model.nq :])
        one, two = (shapes.getGeometryId(f"{name}_0") for name in ("upper", "fore"))
        at = [coal.Transform3s(data.oMg[k].rotation, data.oMg[k].translation) for k in (one, two)]
        boxes = [shapes.geometryObjects[k].geometry for k in (one, two)]
        assert coal.collide(boxes[0], at[0], boxes[1], at[1], coal.CollisionRequest(), coal.CollisionResult())
    told = load_robot(tmp_path / "r.urdf", base="omni", srdf=told_adjacent(tmp_path))
    assert any(pair.links == ("fore", "upper") for pair in told.unchecked_pairs), "somebody said so"


def told_adjacent(folder: Path, one: str = "upper", two: str = "fore") -> Path:
    """An SRDF that says of two links that they may be in each other."""
    path = folder / "r.srdf"
    path.write_text(f'<robot name="r"><disable_collisions link1="{one}" link2="{two}" reason="Adjacent"/></robot>')
    return path


def mast(folder: Path, *more: str) -> Path:
    """A base with a mast, and an arm that turns into it."""
    return write(
        folder, link("base", box(BASE), "0 0 0.15"), link("mast", box("0.08 0.08 1.2")),
        fixed("m", "-0.2 0.3 0.9", "base", "mast"), link("arm", box("0.5 0.06 0.06"), "0.3 0 0"),
        joint("pan", "0.2 0 0.6", "base", "arm"), *more,
    )  # fmt: skip


INTO = float(np.arctan2(0.3, -0.4))


def reasons(robot: RobotModel) -> dict[tuple[str, str], WhyUnchecked]:
    return {pair.links: pair.why for pair in robot.unchecked_pairs}


def certified(robot: RobotModel, *rows: np.ndarray) -> bool:
    return es.certify(robot, es.Scene([]), list(rows)).certified


@each("base", ["omni", "diff_drive", "fixed"])
def test_what_is_fixed_to_a_joints_parent_is_looked_at(tmp_path, base):
    robot = load_robot(mast(tmp_path), base=base)
    found = es.certify(robot, es.Scene([]), [robot.home(), robot.home(pan=INTO)])
    assert found.verdict.value == "refuted"
    assert found.broken is not None
    assert {found.broken.link, found.broken.obstacle} == {"mast_0", "arm_0"}
    assert reasons(robot) == {("base", "mast"): WhyUnchecked.JOINED, ("arm", "base"): WhyUnchecked.JOINED}


def test_a_camera_on_a_mast_on_a_plate_is_looked_at_too(tmp_path):
    """Two fixed joints away, and a battery beside: the kind, not the case."""
    more = (
        link("camera", box("0.1 0.2 0.1")), fixed("c", "0 -0.1 -0.3", "mast", "camera"),
        link("battery", box("0.2 0.2 0.2")), fixed("b", "-0.25 -0.1 0.55", "base", "battery"),
    )  # fmt: skip
    robot = load_robot(mast(tmp_path, *more), base="omni")
    kept = {frozenset((robot.geometries[i].links[0], robot.geometries[k].links[0])) for i, k in robot.self_pairs}
    assert {frozenset(("arm", "camera")), frozenset(("arm", "battery")), frozenset(("arm", "mast"))} <= kept


def three_links(folder: Path) -> Path:
    """A boom on a column on a turntable: it meets the base where the middle joint is half turned."""
    return write(
        folder, link("base", box("0.4 0.4 0.4")), link("table", box("0.1 0.1 0.3")),
        joint("turn", "0 0 0.36", "base", "table"), link("boom", box("0.1 0.1 0.8"), "0 0 0.4"),
        joint("lean", "0 0 0.16", "table", "boom", axis="0 1 0"),
    )  # fmt: skip


def test_holding_a_joint_certifies_nothing_that_was_refuted(tmp_path):
    path, told = three_links(tmp_path), told_adjacent(tmp_path, "table", "boom")
    robot = load_robot(path, base="fixed", srdf=told)
    held = load_robot(path, base="fixed", srdf=told, locked={"turn": 0.0})
    a, b = ({"lean": value} for value in (0.0, 2.6))
    assert not certified(robot, robot.home(joints=a), robot.home(joints=b))
    assert not certified(held, held.home(joints=a), held.home(joints=b))
    assert ("base", "boom") not in reasons(held)


def test_links_that_held_joints_bring_together_collide_for_ever(tmp_path, caplog):
    with caplog.at_level(logging.WARNING, logger="elastic_strips"):
        robot = load_robot(three_links(tmp_path), base="omni", locked={"turn": 0.0, "lean": 2.6})
    assert robot.self_collision(robot.home_q) is not None
    assert not certified(robot, robot.home(), robot.home(x=1.0))
    assert any("boom" in record.getMessage() for record in caplog.records)
    free = load_robot(three_links(tmp_path), base="omni", locked={"turn": 0.0, "lean": 0.5})
    assert certified(free, free.home(), free.home(x=1.0))


def test_closed_fingers_are_listed_and_do_not_collide(tmp_path):
    finger = box("0.02 0.02 0.06")
    path = write(
        tmp_path, link("base", box("0.3 0.3 0.3")), link("arm", box("0.05 0.05 0.3"), "0 0 0.25"),
        joint("lean", "0 0 0.2", "base", "arm", axis="0 1 0", span=(-1, 1)),
        link("left", finger, "0 0.01 0"), link("right", finger, "0 -0.01 0"),
        joint("open", "0 0 0.45", "arm", "left", axis="0 1 0", kind="prismatic", span=(0, 0.05)),
        joint("open_too", "0 0 0.45", "arm", "right", axis="0 -1 0", kind="prismatic", span=(0, 0.05)),
    )  # fmt: skip
    robot = load_robot(path, base="fixed", locked={"open": 0.0, "open_too": 0.0})
    assert robot.self_collision(robot.home_q) is None
    assert reasons(robot)["left", "right"] is WhyUnchecked.HELD
    planned = load_robot(path, base="fixed", joints=["lean", "open", "open_too"])
    assert ("left", "right") not in reasons(planned)


def test_pairs_that_always_touch_are_left_out_and_listed(tmp_path):
    """A hub about an axis, between links that no joint joins."""
    path = write(
        tmp_path, link("base", box("0.4 0.4 0.1")), link("pad"), fixed("p", "0 0 0.05", "base", "pad"),
        link("post", '<cylinder radius="0.05" length="0.3"/>', "0 0 0.1"), joint("spin", "0 0 0", "pad", "post"),
        link("boom", box("0.3 0.04 0.04"), "0.2 0 0"), joint("lift", "0 0 0.25", "post", "boom", axis="0 1 0"),
    )  # fmt: skip
    robot = load_robot(path, base="fixed", srdf=told_adjacent(tmp_path, "post", "boom"))
    assert reasons(robot)["base", "post"] is WhyUnchecked.ALWAYS
    assert ("base", "boom") not in reasons(robot)
    assert robot.self_collision(robot.home(lift=1.5)) is not None


def in_a_bracket(folder: Path, span: tuple[float, float] = (-1.2, 1.2)) -> Path:
    """A boom on a hub in a bracket like a U, whose hull holds it in each posture; at 0.55 rad it meets a side."""
    sides = [trimesh.creation.box((0.6, 0.02, 0.2)).apply_translation((0.3, y, 0.0)) for y in (-0.2, 0.2)]
    back = trimesh.creation.box((0.02, 0.42, 0.2)).apply_translation((-0.01, 0.0, 0.0))
    trimesh.util.concatenate([*sides, back]).export(folder / "bracket.stl")
    return write(
        folder, link("bracket", f'<mesh filename="{folder / "bracket.stl"}"/>'), link("hub"),
        fixed("h", "0.1 0 0", "bracket", "hub"), link("turret"), joint("pan", "0 0 0", "hub", "turret", span=span),
        link("boom", box("0.4 0.03 0.03"), "0.2 0 0"), fixed("b", "0 0 0", "turret", "boom"),
    )  # fmt: skip


def test_a_hull_does_not_hide_what_meshes_do(tmp_path, caplog):
    with caplog.at_level(logging.WARNING, logger="elastic_strips"):
        robot = load_robot(in_a_bracket(tmp_path), base="fixed")
    assert ("boom", "bracket") not in reasons(robot)
    assert not [record for record in caplog.records if record.name.endswith("unchecked_pairs")]
    assert certified(robot, robot.home(pan=-0.2), robot.home(pan=0.2))
    found = es.certify(robot, es.Scene([]), [robot.home(), robot.home(pan=0.6)])
    assert found.verdict.value == "refuted"
    shapes = [g for g in robot.geometries if "bracket" in g.links]
    assert 1 < len(shapes) <= 4
    assert len({g.name for g in shapes}) == len(shapes)


def test_a_hull_that_hides_more_than_pieces_can_tell_is_listed(tmp_path, caplog):
    """A boom 3 mm from the sides of its slot: pieces of the slot would not let it be."""
    sides = [trimesh.creation.box((0.6, 0.05, 0.2)).apply_translation((0.3, y, 0.0)) for y in (-0.043, 0.043)]
    rings = [trimesh.creation.annulus(0.018, 0.05, 0.3)]
    trimesh.util.concatenate([*sides, *rings]).export(tmp_path / "slot.stl")
    path = write(
        tmp_path, link("slot", f'<mesh filename="{tmp_path / "slot.stl"}"/>'), link("hub"),
        fixed("h", "0 0 0", "slot", "hub"), link("turret"), joint("roll", "0 0 0", "hub", "turret"),
        link("pin", '<cylinder radius="0.015" length="0.3"/>'), fixed("b", "0 0 0", "turret", "pin"),
    )  # fmt: skip
    with caplog.at_level(logging.WARNING, logger="elastic_strips"):
        robot = load_robot(path, base="fixed")
    if ("pin", "slot") in reasons(robot):
        (pair,) = (pair for pair in robot.unchecked_pairs if pair.links == ("pin", "slot"))
        assert pair.note
        assert [record for record in caplog.records if "slot" in record.getMessage()]
        assert [g.name for g in robot.geometries if "slot" in g.links] == ["slot_0"]
    else:
        assert robot.self_collision(robot.home_q) is None


def in_a_housing(folder: Path, housing: trimesh.Geometry, inner: str) -> Path:
    """Something that slides by 5 cm in a housing, with an arm on it that is far off."""
    housing.export(folder / "housing.stl")
    return write(
        folder, link("housing", f'<mesh filename="{folder / "housing.stl"}"/>'), link("rail"),
        fixed("f", "0 0 0", "housing", "rail"), link("inner", inner),
        joint("slide", "0 0 0", "rail", "inner", axis="1 0 0", kind="prismatic", span=(-0.05, 0.6)),
        link("arm", box("0.3 0.02 0.02"), "0.15 0 0"), joint("turn", "0 0 0.5", "inner", "arm"),
    )  # fmt: skip


def drawn_from_both_sides(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, np.vstack((mesh.faces, mesh.faces[:, ::-1])), process=False)


def turned_either_way(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    faces = mesh.faces.copy()
    faces[::3] = faces[::3, ::-1]
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


BODY = trimesh.creation.box((0.3, 0.3, 0.3))


@each("housing", [BODY, drawn_from_both_sides(BODY), turned_either_way(BODY)])
def test_what_is_held_within_a_mesh_collides(tmp_path, housing):
    """However the triangles of the mesh are turned, and if it is the second body of the other that is inside."""
    bodies = [trimesh.creation.icosphere(1, 0.03).apply_translation((0.0, y, 0.0)) for y in (-0.8, 0.0)]
    trimesh.util.concatenate(bodies).export(tmp_path / "balls.stl")
    path = in_a_housing(tmp_path, housing, f'<mesh filename="{tmp_path / "balls.stl"}"/>')
    robot = load_robot(path, base="fixed", locked={"slide": 0.0})
    assert ("housing", "inner") not in reasons(robot)
    assert robot.self_collision(robot.home_q) is not None


def test_what_is_held_near_a_mesh_does_not_collide(tmp_path):
    """A plate 1.2 mm from either side of its slot, whose hull holds it."""
    sides = [trimesh.creation.box((0.3, 0.02, 0.2)).apply_translation((0.0, y, 0.0)) for y in (-0.0232, 0.0232)]
    end = trimesh.creation.box((0.02, 0.0664, 0.2)).apply_translation((-0.2, 0.0, 0.0))
    path = in_a_housing(tmp_path, trimesh.util.concatenate([*sides, end]), box("0.2 0.024 0.05"))
    robot = load_robot(path, base="fixed", locked={"slide": 0.0})
    assert robot.self_collision(robot.home_q) is None
    assert reasons(robot)["housing", "inner"] is WhyUnchecked.HELD


def test_an_open_bowl_does_not_hide_what_moves_in_it(tmp_path):
    """A ball that never leaves the hull of a bowl without thickness, and meets its side."""
    bowl = trimesh.creation.icosphere(3, 0.3)
    bowl.update_faces(bowl.triangles_center[:, 2] < 0.15)
    path = in_a_housing(tmp_path, bowl, '<sphere radius="0.03"/>')
    path.write_text(path.read_text().replace('upper="0.6"', 'upper="0.28"'))
    robot = load_robot(path, base="fixed")
    assert ("housing", "inner") not in reasons(robot)
    assert robot.self_collision(robot.home()) is None
    assert robot.self_collision(robot.home(slide=0.275)) is not None


def test_a_pair_that_nearly_always_touches_is_said(tmp_path, caplog):
    """A pin that leaves its socket only at the end of its travel."""
    path = write(
        tmp_path, link("base", box("0.2 0.2 1.0")), link("rail"), fixed("r", "0 0 0", "base", "rail"),
        link("pin", box("0.05 0.05 0.1")), joint("out", "0 0 0", "rail", "pin", kind="prismatic", span=(0, 0.5505)),
    )  # fmt: skip
    with caplog.at_level(logging.WARNING, logger="elastic_strips"):
        robot = load_robot(path, base="fixed")
    said = [record for record in caplog.records if "pin" in record.getMessage() and "base" in record.getMessage()]
    assert said or ("base", "pin") in reasons(robot)


# --- the SRDF -----------------------------------------------------------------------------------------------------


def srdf(folder: Path, text: str) -> Path:
    path = folder / "r.srdf"
    path.write_text(f'<robot name="r">{text}</robot>')
    return path


def test_an_srdf_leaves_pairs_out_and_its_reason_is_kept(tmp_path):
    text = '<disable_collisions link1="mast" link2="arm" reason="Never"/>'
    robot = load_robot(mast(tmp_path), base="omni", srdf=srdf(tmp_path, text))
    (pair,) = (pair for pair in robot.unchecked_pairs if pair.links == ("arm", "mast"))
    assert (pair.why, pair.note) == (WhyUnchecked.SRDF, "Never")
    assert certified(robot, robot.home(), robot.home(pan=INTO))


@each("text, left", [
    ('<disable_default_collisions link="arm"/>', True),
    ('<disable_default_collisions link="mast"/>', True),
    ('<disable_default_collisions link="arm"/><enable_collisions link1="arm" link2="mast"/>', False),
    ('<enable_collisions link1="arm" link2="mast"/><disable_collisions link1="arm" link2="mast"/>', True),
])  # fmt: skip
def test_defaults_of_an_srdf_count(tmp_path, text, left):
    robot = load_robot(mast(tmp_path), base="omni", srdf=srdf(tmp_path, text))
    assert (reasons(robot).get(("arm", "mast")) is WhyUnchecked.SRDF) is left


def test_a_pair_that_an_srdf_asks_for_is_looked_at_though_a_joint_joins_it(tmp_path):
    path = write(
        tmp_path, link("base", box("0.4 0.4 0.2")), link("arm", box("0.6 0.05 0.05"), "0.35 0 0"),
        joint("lean", "0 0 0.12", "base", "arm", axis="0 1 0"),
    )  # fmt: skip
    plain = load_robot(path, base="fixed")  # it lies on its base, as it is at first
    asked = load_robot(path, base="fixed", srdf=srdf(tmp_path, '<enable_collisions link1="arm" link2="base"/>'))
    assert (len(plain.self_pairs), len(asked.self_pairs)) == (0, 1)
    assert certified(asked, asked.home(lean=-0.3), asked.home(lean=-0.6))
    assert not certified(asked, asked.home(lean=-0.3), asked.home(lean=0.0))


@each("name", ["r", "", "another_one"])
def test_an_srdf_of_another_robot_is_said(tmp_path, caplog, name):
    """Links of the same names may be other links."""
    path = srdf(tmp_path, '<disable_collisions link1="arm" link2="mast"/>')
    path.write_text(path.read_text().replace('name="r"', f'name="{name}"'))
    load_robot(mast(tmp_path), base="omni", srdf=path)
    assert ("is written for a robot" in caplog.text) == (name == "another_one")


def test_elements_of_an_srdf_that_are_not_known_are_said(tmp_path, caplog):
    with caplog.at_level(logging.WARNING, logger="elastic_strips"):
        load_robot(mast(tmp_path), base="omni", srdf=srdf(tmp_path, '<forbid_collisions link1="arm"/>'))
    assert any("forbid_collisions" in record.getMessage() for record in caplog.records)


# --- robots as they come, against their own meshes ----------------------------------------------------------------


def test_boxes_that_coal_misses_without_contacts_are_found(monkeypatch: pytest.MonkeyPatch):
    """The thumb is 5.6 and 10 mm deep in the palm: Coal's collision test says so only where contacts are asked for."""
    hand = load_robot("allegro_right_hand", base="fixed")
    joints = ("12.0", "13.0", "14.0")
    monkeypatch.setattr("elastic_strips.planning.validity.kernel", lambda: None)
    twin = ValidityChecker(hand, Scene([]), margin=0.0)
    for thumb in ((0.8909997658867356, 0.7553371766562801, 0.9229633769812406), (0.52971804, 0.71739673, 0.19528353)):
        q = hand.home(**{f"joint_{name}": value for name, value in zip(joints, thumb, strict=True)})
        assert hand.self_collision(q) is not None
        assert not twin(q)


def mesh_touches(robot: RobotModel, path: str, dirs: list[str], rng: np.random.Generator, count: int) -> set[frozenset]:
    """Pairs of links whose own shapes meet in random postures that the robot calls free: Pinocchio and Coal alone."""
    model = pin.buildModelFromUrdf(path)
    geometry = pin.buildGeomFromUrdf(model, path, pin.COLLISION, dirs)
    for i, k in itertools.combinations(range(geometry.ngeoms), 2):
        if geometry.geometryObjects[i].parentFrame != geometry.geometryObjects[k].parentFrame:
            geometry.addCollisionPair(pin.CollisionPair(i, k))
    data, found = model.createData(), collision_data(geometry)
    names = [model.frames[obj.parentFrame].name for obj in geometry.geometryObjects]
    touching = set()
    for row in random_coordinates(robot, rng, count):
        q = configuration(robot, row)
        if robot.self_collision(q) is not None:
            continue
        full = pin.neutral(model)
        values = dict(zip(robot.joint_names, row[robot.space.base_nv :], strict=True)) | dict(robot.locked)
        for name, value in values.items():
            if model.existJointName(name):
                at = model.joints[model.getJointId(name)]
                full[at.idx_q : at.idx_q + at.nq] = value if at.nq == 1 else (np.cos(value), np.sin(value))
        pin.computeCollisions(model, data, geometry, found, full, False)
        touching |= {
            frozenset((names[pair.first], names[pair.second]))
            for pair, result in zip(geometry.collisionPairs, found.collisionResults, strict=True)
            if result.isCollision()
        }
    return touching


@pytest.mark.parametrize("name, held", [
    ("kinova", {}), ("kinova", {"j2s6s200_joint_1": 0.0}), ("panda", {}), ("panda", {"panda_joint7": 0.8}),
    ("tiago_no_hand", {}), ("tiago_no_hand", {"arm_1_joint": 0.2}), ("talos_left_arm", {}),
    ("talos_left_arm", {"arm_left_3_joint": 0.0}),
])  # fmt: skip
def test_what_touches_in_a_free_posture_is_a_listed_pair(name, held, rng):
    from elastic_strips.catalogue import find_robot

    known = find_robot(name)
    robot = load_robot(name, base="fixed", locked=held)
    listed = {frozenset(pair.links) for pair in robot.unchecked_pairs}
    free = mesh_touches(robot, str(known.urdf), [str(d) for d in known.package_dirs], rng, 60)
    assert free <= listed, [sorted(pair) for pair in free - listed]


# --- the pairs themselves -----------------------------------------------------------------------------------------


@each_robot
def test_pairs_are_of_different_moving_bodies(robot):
    pairs = [tuple(int(x) for x in p) for p in robot.self_pairs]
    assert len(set(pairs)) == len(pairs) > 0
    for i, k in pairs:
        assert i < k
        assert robot.geometries[i].joint != robot.geometries[k].joint


@each_robot
def test_every_pair_is_either_looked_at_or_listed(robot):
    """No pair of links is neither: pieces of one joint apart, which never move to each other."""
    looked_at = {
        frozenset((one, two))
        for i, k in robot.self_pairs
        for one in robot.geometries[i].links
        for two in robot.geometries[k].links
    }
    listed = {frozenset(pair.links) for pair in robot.unchecked_pairs}
    for one, two in itertools.combinations(robot.geometries, 2):
        if one.joint != two.joint:
            for pair in itertools.product(one.links, two.links):
                assert frozenset(pair) in looked_at | listed, pair


@each_robot
def test_home_is_free_of_self_collision(robot):
    assert self_distances(robot, robot.home_q).min() > 0.001


def test_where_home_collides_one_near_it_is_taken(tmp_path, caplog):
    path = write(
        tmp_path, link("base", box("0.4 0.4 0.4")), link("table", box("0.1 0.1 0.3")),
        joint("turn", "0 0 0.36", "base", "table"), link("boom", box("0.1 0.1 0.8"), "0 0 -0.4"),
        joint("lean", "0 0 0.16", "table", "boom", axis="0 1 0"),
    )  # fmt: skip
    with caplog.at_level(logging.WARNING, logger="elastic_strips"):
        robot = load_robot(path, base="fixed")
    assert robot.self_collision(robot.home_q) is None
    assert robot.home_q[0] == 0.0  # the other joint has nothing to do with it
    assert any("lean" in record.getMessage() for record in caplog.records)
    assert np.array_equal(robot.home_q, load_robot(path, base="fixed").home_q)


def lever(folder: Path, *posts: tuple[str, str, str]) -> RobotModel:
    """A lever that turns by 0 to 1.2 rad past posts: name, size, place."""
    more = [part for name, size, at in posts for part in (link(name, box(size)), fixed(f"f_{name}", at, "base", name))]
    return load_robot(
        write(
            folder, link("base", box("0.1 0.1 0.1"), "0 0 -0.1"), link("lever", box("0.6 0.04 0.04"), "0.3 0 0"),
            joint("turn", "0 0 0", "base", "lever", span=(0, 1.2)), *more,
        ),
        base="fixed",
    )  # fmt: skip


def test_a_home_that_is_free_only_beyond_something_deeper_is_found(tmp_path):
    """The lever touches the near end of the wall, and is free where it has gone through it."""
    robot = lever(tmp_path, ("wall", "0.1 0.39 0.2", "0.3 0.205 0"))
    assert robot.self_collision(robot.home_q) is None
    assert robot.home_q[0] > 1.0


def test_where_no_home_is_free_the_card_says_what_is_in_the_way(tmp_path, caplog):
    """One post is left behind at 0.5 rad, and the other one is reached before."""
    with caplog.at_level(logging.WARNING, logger="elastic_strips"):
        robot = lever(tmp_path, ("near", "0.05 0.3 0.2", "0.5 0.09 0"), ("far", "0.1 0.6 0.2", "0.2 0.41 0"))
    assert robot.self_collision(robot.home_q) is not None
    assert robot.home_q[0] == 0.0
    said = [record.getMessage() for record in caplog.records]
    for told in (said, robot.card().troubles):
        assert any("'lever_0'" in text and ("'near_0'" in text or "'far_0'" in text) for text in told), told


@pytest.mark.parametrize("name", ["allegro_left_hand", "alex_nub_hands"])
def test_robots_as_they_come_have_a_free_home(name):
    robot = load_robot(name)
    assert robot.self_collision(robot.home_q) is None


def test_the_description_counts_what_is_not_looked_at(silvermate):
    assert str(len(silvermate.unchecked_pairs)) in repr(silvermate)


def test_neighbours_are_the_urdfs_own(tmp_path):
    model = pin.buildModelFromUrdf(str(mast(tmp_path)))
    assert joints_of_links(model) == {frozenset(("base", "mast")): "m", frozenset(("base", "arm")): "pan"}
    reduced = pin.buildReducedModel(model, [model.getJointId("pan")], pin.neutral(model))
    assert joints_of_links(reduced) == {frozenset(("base", "mast")): "m"}  # Pinocchio forgets it; both are one body


def test_what_is_held_lists_what_may_touch_it():
    panda = load_robot("panda")
    load = es.Box((0.05, 0.05, 0.1), at=(0.0, 0.0, 0.12), name="load")
    held = panda.attached(load, "panda_hand", touch=("panda_link6",))
    added = {pair.links: pair.why for pair in held.unchecked_pairs[len(panda.unchecked_pairs) :]}
    assert added == {("load", "panda_link6"): WhyUnchecked.ALLOWED}


# --- a second root ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("with_shape", [True, False])
def test_joints_that_hang_on_the_world_beside_a_moving_base_are_refused(with_shape):
    """Its links do not move with the base, and self pairs count the joints alone."""
    model, geometry = pin.Model(), pin.GeometryModel()
    root = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "root_joint")
    gate = model.addJoint(
        0, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([2.0, 0.0, 0.0])), "gate",
        np.ones(1), np.ones(1), np.array([-1.0]), np.array([1.0]),
    )  # fmt: skip
    frames = {j: model.addJointFrame(j) for j in (root, gate)}
    for name, j in [("body", root), ("bar", gate)] if with_shape else [("body", root)]:
        geometry.addGeometryObject(pin.GeometryObject(name, j, frames[j], pin.SE3.Identity(), coal.Box(1.0, 0.2, 0.2)))
    with refused(RobotError, "gate"):
        RobotModel.from_pinocchio(model, geometry, base="omni")


# --- distances that are proven once -------------------------------------------------------------------------------


def two_links(limit: float) -> RobotModel:
    """A base post and a bar two joints away that reaches the post only when both joints turn far."""
    model, geometry = pin.Model(), pin.GeometryModel()
    root = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "root_joint")
    ids, parent = [root], root
    for name, x in (("a", 0.3), ("b", 0.3)):
        parent = model.addJoint(
            parent, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])), name,
            np.ones(1), np.ones(1), np.array([-limit]), np.array([limit]),
        )  # fmt: skip
        ids.append(parent)
    frames = [model.addJointFrame(i) for i in ids]
    post, bar = coal.Sphere(0.1), coal.Box(0.3, 0.05, 0.05)
    at = pin.SE3(np.eye(3), np.array([0.15, 0.0, 0.0]))
    geometry.addGeometryObject(pin.GeometryObject("post", root, frames[0], pin.SE3.Identity(), post))
    geometry.addGeometryObject(pin.GeometryObject("bar", ids[2], frames[2], at, bar))
    return RobotModel.from_pinocchio(model, geometry, base="omni", disabled_pairs=[])


@each("limit, never", [(0.5, True), (1.0, True), (2.9, False)])
def test_a_least_distance_is_a_proof(limit, never, rng):
    robot = two_links(limit)
    rows = random_coordinates(robot, rng, 4000)
    smallest = min(self_distances(robot, configuration(robot, row))[0] for row in rows)
    assert bool(smallest > 0.0) is never
    proven = least_distance(robot.model, robot.geometries, 0, 1)
    assert (proven > 0.0) is never
    assert proven <= max(smallest, 0.0)
    assert len(robot.pairs_within(0.0)) == (0 if never else 1)
    assert len(robot.pairs_within(1.0)) == 1


def test_too_few_cells_are_no_proof():
    robot = two_links(1.4)
    assert least_distance(robot.model, robot.geometries, 0, 1) > 0.0
    assert least_distance(robot.model, robot.geometries, 0, 1, cells=0) == 0.0


def test_a_larger_self_clearance_asks_for_more_pairs(tiago):
    """A pair that is proven to keep 3 mm is no proof of 50."""
    assert (tiago.self_apart > 0.0).any()
    assert len(tiago.pairs_within(1e3)) == len(tiago.self_pairs) > len(tiago.pairs_within(0.0))
    least = float(tiago.self_apart[tiago.self_apart > 0.0].min())
    assert len(tiago.pairs_within(least)) > len(tiago.pairs_within(0.99 * least))


def test_certificates_of_the_own_links_count_every_pair_that_may_come_nearer():
    """The bar of ``two_links`` is proven to keep away, but not as far as is asked."""
    robot = two_links(0.5)
    rows = [robot.home(), robot.home(a=0.5, b=0.5)]
    near = float(min(self_distances(robot, row)[0] for row in rows))
    assert es.certify(robot, es.Scene([]), rows, self_clearance=0.0).certified
    assert not es.certify(robot, es.Scene([]), rows, self_clearance=1.1 * near).certified
