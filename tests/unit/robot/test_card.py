"""A robot's card: what it says, and that it says all of it."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import pinocchio as pin
import pytest
from cases import refused

from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.robot.card import CardSection, RobotCard

URDF = """<robot name="r">
<link name="base"><collision><geometry><box size="0.5 0.4 0.2"/></geometry></collision></link>
<link name="lift"><collision><geometry><box size="0.1 0.1 0.5"/></geometry></collision></link>
<link name="arm"><visual><geometry><box size="0.4 0.1 0.1"/></geometry></visual></link>
<link name="wheel"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="thumb"><collision><geometry><sphere radius="0.02"/></geometry></collision></link>
<link name="finger"><collision><geometry><sphere radius="0.02"/></geometry></collision></link>
<link name="camera"/>
<joint name="up" type="prismatic"><parent link="base"/><child link="lift"/><origin xyz="0 0 0.6"/><axis xyz="0 0 1"/>
<limit lower="0" upper="0.4" effort="1" velocity="0.2"/></joint>
<joint name="yaw" type="continuous"><parent link="lift"/><child link="arm"/><axis xyz="0 0 1"/></joint>
<joint name="front_wheel" type="continuous"><parent link="base"/><child link="wheel"/><axis xyz="0 1 0"/></joint>
<joint name="close" type="revolute"><parent link="arm"/><child link="thumb"/><origin xyz="0.4 0 0"/><axis xyz="0 0 1"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint>
<joint name="follow" type="revolute"><parent link="arm"/><child link="finger"/><origin xyz="0.4 0.1 0"/>
<axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1" velocity="1"/><mimic joint="close"/></joint>
<joint name="eye" type="fixed"><parent link="arm"/><child link="camera"/><origin xyz="0.2 0 0.1"/></joint>
</robot>"""
SRDF = """<robot name="r"><group name="body"><joint name="up"/><joint name="yaw"/></group>
<group_state name="ready" group="body"><joint name="up" value="0.2"/></group_state></robot>"""


@pytest.fixture
def robot(tmp_path: Path) -> RobotModel:
    (tmp_path / "r.urdf").write_text(URDF)
    (tmp_path / "r.srdf").write_text(SRDF)
    return load_robot(tmp_path / "r.urdf", srdf=tmp_path / "r.srdf", base="omni", locked={"yaw": 0.5})


def rows(card: RobotCard, title: str) -> dict[str, tuple[str, ...]]:
    return {row[0]: row for row in card.section(title).rows}


def test_every_joint_is_on_it_with_its_reason(robot: RobotModel) -> None:
    card = robot.card()
    planned, held = rows(card, "Joints that are planned"), rows(card, "Joints that are held still")
    assert set(planned) == set(robot.joint_names)
    assert set(held) == set(robot.locked) == set(robot.held)
    assert "0 … 0.4 m" in planned["up"]
    assert held["yaw"][1] == "0.5"
    assert len({held[name][2] for name in ("yaw", "front_wheel", "follow")}) == 3
    assert "close" in held["follow"][2]


def test_shapes_links_frames_states_and_groups_are_on_it(robot: RobotModel) -> None:
    card = robot.card()
    assert {row[0] for row in card.section("Convex pieces").rows} == {p.name for p in robot.geometries}
    assert all(row[4] == "0 mm" for row in card.section("Convex pieces").rows)
    assert card.section("Links that are drawn and have no collision shape").rows == (("arm",),)
    assert any("arm" in trouble for trouble in card.troubles)
    frames = rows(card, "Frames")
    assert frames["camera"][3] == "no collision shape"
    assert "ready" in rows(card, "Named states")
    assert "body" in rows(card, "Groups")
    pairs = card.section("Links that are not kept apart")
    assert len(pairs.rows) == len(robot.unchecked_pairs)


def test_all_of_it_is_in_every_form(robot: RobotModel) -> None:
    card = robot.card()
    document = json.loads(json.dumps(card.document(), allow_nan=False))
    assert [table["title"] for table in document["tables"]] == list(card.titles)
    for text in (card.text(), card.html()):
        assert all(title in text for title in card.titles)
        assert all(name in text for name in (*robot.joint_names, *robot.locked))
    with refused(KeyError, "Frames"):
        card.section("Wheels")
    more = card.with_section(CardSection("Wheels", ("what",), (("<b>",),)), after=card.titles[0])
    assert more.titles[1] == "Wheels"
    assert "<b>" not in more.html()


def test_a_difference_between_readers_is_a_trouble(robot: RobotModel) -> None:
    path = Path(robot.urdf_path or "")
    path.write_text(URDF.replace('xyz="0.2 0 0.1"', 'xyz="0.2 0 0.2"'))  # the file has changed since it was read
    card = robot.card()
    assert any("'camera'" in trouble for trouble in card.troubles)


def test_robots_without_files_have_a_card_as_well(robot: RobotModel) -> None:
    copy = pickle.loads(pickle.dumps(robot)).card()
    assert copy.section("Convex pieces").rows
    model = pin.buildModelFromXML(URDF)
    made = RobotModel.from_pinocchio(model, pin.buildGeomFromUrdfString(model, URDF, pin.COLLISION))
    assert set(rows(made.card(), "Joints that are planned")) == set(made.joint_names)


def test_how_far_hulls_reach_is_said_of_real_robots() -> None:
    card = load_robot("panda").card()
    reach = [float(row[4].removesuffix(" mm")) for row in card.section("Convex pieces").rows]
    assert len(reach) == len(load_robot("panda").geometries)
    assert reach == sorted(reach, reverse=True)
    assert 1.0 < reach[0] < 200.0
    assert not card.section("What another reader (yourdfpy) finds otherwise").rows
