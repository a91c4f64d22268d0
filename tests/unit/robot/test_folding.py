"""How far a joint bends: it is planned as far as its links' shapes allow, where it would lay one along the other; where
the two are kept apart, and touch in much of its range, that is said."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from cases import each, refused

from elastic_strips import load_robot
from elastic_strips.errors import ConfigurationError
from elastic_strips.io import load_path
from elastic_strips.robot import RobotModel
from elastic_strips.robot.blocked_joints import blocked_joints

ROD = '<cylinder radius="0.05" length="0.4"/>'
BAR = '<box size="0.1 0.1 0.4"/>'
GAP = 0.04  # [m] between the two rods, at their joint: the corner of one turns into the end of the other
FREE = math.asin(GAP / 0.05)  # [rad]


def arm(folder: Path, upper: str = ROD, fore: str = ROD, *, at: str = "0 0 0.4", span: float = 3.0) -> Path:
    """A base, and two links of 0.4 m end to end."""

    def link(name: str, shape: str, z: float) -> str:
        origin = f'<origin xyz="0 0 {z}"/>'
        return f'<link name="{name}"><collision>{origin}<geometry>{shape}</geometry></collision></link>'

    def joint(name: str, parent: str, child: str, at: str, span: float) -> str:
        return (
            f'<joint name="{name}" type="revolute"><origin xyz="{at}"/><parent link="{parent}"/><child link="{child}"/>'
            f'<axis xyz="0 1 0"/><limit lower="{-span}" upper="{span}" effort="1" velocity="1"/></joint>'
        )

    parts = [link("base", '<box size="0.4 0.4 0.2"/>', 0.0), link("upper", upper, 0.2), link("fore", fore, 0.2)]
    parts += [joint("shoulder", "base", "upper", "0 0 0.2", 1.0), joint("elbow", "upper", "fore", at, span)]
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="arm">{"".join(parts)}</robot>')
    return path


def span_of(robot: RobotModel) -> tuple[float, float]:
    k = robot.joint_names.index("elbow") - len(robot.joint_names)
    return float(robot.space.lower[k]), float(robot.space.upper[k])


def folded_along(urdf: Path, angle: float) -> float:
    """How far from the elbow the links are in each other [m], by trimesh and Pinocchio alone, of their cylinders."""
    model = pin.buildModelFromUrdf(str(urdf))
    data, q = model.createData(), pin.neutral(model)
    q[model.joints[model.getJointId("elbow")].idx_q] = angle
    pin.framesForwardKinematics(model, data, q)
    rod = trimesh.creation.cylinder(0.05, 0.4, sections=64)
    middle = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.2]))
    upper, fore = (data.oMf[model.getFrameId(name)] * middle for name in ("upper", "fore"))
    inside = trimesh.sample.volume_mesh(rod, 20_000)
    points = inside @ fore.rotation.T + fore.translation
    local = (points - upper.translation) @ upper.rotation
    hit = points[rod.contains(local)]
    elbow = data.oMi[model.getJointId("elbow")].translation
    return float(np.linalg.norm(hit - elbow, axis=1).max(initial=0.0))


def test_an_elbow_is_planned_until_its_links_lie_along_each_other(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    path = arm(tmp_path)
    with caplog.at_level(logging.WARNING, logger="elastic_strips"):
        robot = load_robot(path, base="omni")
    low, high = span_of(robot)
    assert low == pytest.approx(-high, abs=0.2)
    assert any("elbow" in record.getMessage() for record in caplog.records)
    assert folded_along(path, high - 0.15) < 0.4 / 3.0 < folded_along(path, high + 0.25)
    assert set(robot.narrowed) == {"elbow"}
    with refused(ConfigurationError, robot.narrowed["elbow"]):
        robot.home(joints={"elbow": 2.9})
    with refused(ConfigurationError, robot.narrowed["elbow"]):
        load_path(np.array([[0.0], [2.9]]), robot, joint_names=["elbow"], base_at=(0.0, 0.0, 0.0))
    troubles = robot.card().troubles
    assert len(troubles) == 1
    assert "elbow" in troubles[0]


@each(
    "changed",
    [
        {"span": 1.7},  # it does not fold
        {"at": "0 0.12 0.4"},  # beside each other
        {"fore": '<cylinder radius="0.05" length="0.1"/>'},  # too short to be folded
        {"fore": '<mesh filename="rod.stl"/>'},
    ],
)
def test_what_does_not_fold_keeps_its_range(tmp_path: Path, changed: dict[str, object]):
    trimesh.creation.cylinder(0.05, 0.4).export(tmp_path / "rod.stl")
    robot = load_robot(arm(tmp_path, **changed), base="omni")  # type: ignore[arg-type]
    span = float(changed.get("span", 3.0))  # type: ignore[arg-type]
    assert span_of(robot) == pytest.approx((-span, span))
    assert not robot.narrowed


@each(
    "said",
    [
        '<disable_collisions link1="upper" link2="fore" reason="Adjacent"/>',
        '<group name="all"><joint name="elbow"/></group>'
        '<group_state name="packed" group="all"><joint name="elbow" value="2.9"/></group_state>',
    ],
)
def test_what_somebody_has_said_of_it_counts(tmp_path: Path, said: str):
    srdf = tmp_path / "arm.srdf"
    srdf.write_text(f'<robot name="arm">{said}</robot>')
    robot = load_robot(arm(tmp_path), base="omni", srdf=srdf)
    assert span_of(robot) == pytest.approx((-3.0, 3.0))


def test_boxes_fold_as_well(tmp_path: Path):
    low, high = span_of(load_robot(arm(tmp_path, BAR, BAR), base="omni"))
    assert 2.0 < high < 2.95
    assert -2.95 < low < -2.0


def test_a_joint_without_limits_of_its_own_may_be_folded_as_well(tmp_path: Path):
    """Pinocchio's models may have them very far away."""
    path = str(arm(tmp_path))
    model = pin.buildModelFromUrdf(path, pin.JointModelPlanar())
    shapes = pin.buildGeomFromUrdf(model, path, pin.COLLISION)
    k = model.joints[model.getJointId("elbow")].idx_q
    for far in (100.0, 1e9, np.inf):
        model.lowerPositionLimit[k], model.upperPositionLimit[k] = -far, far
        robot = RobotModel.from_pinocchio(model, shapes)
        assert span_of(robot) == pytest.approx(span_of(load_robot(path, base="omni")), abs=0.11)


def test_an_elbow_whose_links_touch_in_much_of_its_range_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    with caplog.at_level(logging.WARNING, logger="elastic_strips"):
        robot = load_robot(arm(tmp_path, at=f"0 0 {0.4 + GAP}"), base="omni")
    (blocked,) = blocked_joints(robot)
    assert blocked.joint == "elbow"
    assert blocked.free == pytest.approx((-FREE, FREE), abs=0.07)
    assert set(blocked.links) == {"upper", "fore"}
    (said,) = (record.getMessage() for record in caplog.records if str(blocked) in record.getMessage())
    assert "elbow" in said
    assert str(blocked) in "".join(robot.card().troubles)
    limits = {row[0]: row[3] for row in robot.card().section("Joints that are planned").rows}
    assert f"{blocked.free[1]:.2g}" in limits["elbow"]  # beside the joint's limits, too
    assert not any(character.isdigit() for character in limits["shoulder"])
    elbow = robot.joint_names.index("elbow") + robot.space.base_nv
    for angle, free in ((blocked.free[1] - 0.01, True), (blocked.free[1] + 0.1, False)):
        row = robot.space.to_coordinates(robot.home_q)
        row[elbow] = angle
        assert (robot.self_collision(robot.space.from_coordinates(row)) is None) is free


@each(
    "changed",
    [
        {"at": "0 0 0.5"},  # apart far enough: it folds nearly all the way
        {"at": f"0 0 {0.4 + GAP}", "span": 1.2},  # little of so short a range
        {"at": f"0 0 {0.4 + GAP}", "upper": BAR, "fore": '<sphere radius="0.05"/>'},
        {},  # drawn into each other: not kept apart
    ],
)
def test_of_what_can_bend_nothing_is_said(tmp_path: Path, changed: dict[str, object]):
    assert not blocked_joints(load_robot(arm(tmp_path, **changed), base="omni"))  # type: ignore[arg-type]


def test_where_an_srdf_says_that_they_may_touch_nothing_is_said(tmp_path: Path):
    srdf = tmp_path / "arm.srdf"
    srdf.write_text('<robot name="arm"><disable_collisions link1="upper" link2="fore" reason="Adjacent"/></robot>')
    assert not blocked_joints(load_robot(arm(tmp_path, at=f"0 0 {0.4 + GAP}"), base="omni", srdf=srdf))


def test_one_way_of_it_may_be_blocked_alone(tmp_path: Path):
    """A bar that hangs in front of the upper one, and touches it when it turns one way."""
    robot = load_robot(arm(tmp_path, BAR, BAR, at="0.11 0 0.2"), base="omni")
    (blocked,) = blocked_joints(robot)
    low, high = blocked.free
    assert (low == pytest.approx(-3.0) and high < 2.9) or (high == pytest.approx(3.0) and low > -2.9)
