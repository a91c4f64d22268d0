"""Joints that follow others (``<mimic>``): planned with their leader, or held with it, and never elsewhere."""

from __future__ import annotations

import io
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from brute_force import configuration, distance, random_coordinates
from cases import each, refused
from lxml import etree
from random_robots import random_robot

from elastic_strips.arrays import Array
from elastic_strips.collision import BodySet, MotionBounds
from elastic_strips.collision.path_certificate import certify
from elastic_strips.errors import ConfigurationError, ParameterError, RobotError
from elastic_strips.io.path_file import load_path
from elastic_strips.native import twin
from elastic_strips.robot import Kinematics, RobotModel, load_robot
from elastic_strips.scene import Box, Scene
from elastic_strips.strip import Deformer, Strip
from elastic_strips.trajectory import MotionLimits

SLIDES = '<axis xyz="0 0 1"/><limit lower="0" upper="0.5" velocity="0.2" effort="1"/>'
TURNS = '<axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/>'
AROUND = '<axis xyz="0 1 0"/>'


def joint(name: str, parent: str, child: str, kind: str = "prismatic", more: str = SLIDES, mimic: str = "") -> str:
    if mimic:
        mimic = f"<mimic {mimic}/>"
    return (
        f'<link name="{child}"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>'
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 0.2"/>'
        f"{more}{mimic}</joint>"
    )


def write(folder: Path, *joints: str) -> Path:
    path = folder / "bot.urdf"
    base = '<link name="base"><collision><geometry><box size="0.3 0.3 0.1"/></geometry></collision></link>'
    path.write_text(f'<robot name="bot">{base}{"".join(joints)}</robot>')
    return path


LIFT = (
    joint("lift", "base", "first"),
    joint("second", "first", "carriage", mimic='joint="lift" multiplier="0.5" offset="0.02"'),
    joint("elbow", "carriage", "arm", "revolute", TURNS),
)
GRIPPER = (
    joint("thumb", "arm", "left"),
    joint("finger", "arm", "right", mimic='joint="thumb" multiplier="2" offset="0.1"'),
    joint("tip", "right", "nail", mimic='joint="finger" multiplier="0.5"'),
)


class ByHand:
    """A file's robot in Pinocchio's and in yourdfpy's hands, all its joints free: followers are set here."""

    def __init__(self, path: Path) -> None:
        root = etree.parse(str(path)).getroot()
        self.mimics = {}
        for element in root.findall("joint"):
            for mimic in element.findall("mimic"):
                factor, offset = float(mimic.get("multiplier", "1")), float(mimic.get("offset", "0"))
                self.mimics[element.get("name")] = mimic.get("joint"), factor, offset
                element.remove(mimic)
        self.text = etree.tostring(root)
        self.model = pin.buildModelFromXML(self.text.decode())
        self.data = self.model.createData()

    def values(self, robot: RobotModel, row: Array) -> dict[str, float]:
        """Of all joints."""
        known = dict(zip(robot.joint_names, row[robot.space.base_nv :].tolist(), strict=True))
        free = {n: 0.0 for n in list(self.model.names)[1:] if n not in self.mimics} | dict(robot.locked) | known

        def value(name: str) -> float:
            if name not in self.mimics:
                return free[name]
            leader, factor, offset = self.mimics[name]
            return factor * value(leader) + offset

        return {name: value(name) for name in list(self.model.names)[1:]}

    def place(self, robot: RobotModel, row: Array) -> dict[str, Array]:
        """Poses (4, 4) of all links by Pinocchio."""
        q = pin.neutral(self.model)
        for name, value in self.values(robot, row).items():
            own = self.model.joints[self.model.getJointId(name)]
            q[own.idx_q : own.idx_q + own.nq] = (np.cos(value), np.sin(value)) if own.nq == 2 else value
        pin.framesForwardKinematics(self.model, self.data, q)
        base = np.eye(4)
        if robot.space.planar:
            c, s = np.cos(row[2]), np.sin(row[2])
            base[:2, :2], base[:2, 3] = [[c, -s], [s, c]], row[:2]
        return {
            frame.name: base @ self.data.oMf[i].homogeneous
            for i, frame in enumerate(self.model.frames) if frame.type == pin.FrameType.BODY
        }  # fmt: skip


def test_links_are_where_pinocchio_has_them_with_followers_set_by_hand(column, column_urdf, rng):
    other = ByHand(column_urdf)
    kin = Kinematics(column.tree, 6)
    rows = random_coordinates(column, rng, 6)
    kin.update(rows)
    for n, row in enumerate(rows):
        for link, pose in other.place(column, row).items():
            np.testing.assert_allclose(column.frame_pose(configuration(column, row), link), pose, atol=1e-12)
            frame = column.model.frames[column.model.getFrameId(link)]
            mine = kin.T[frame.parentJoint, n] @ column.tree.to_aligned(frame.parentJoint, frame.placement.homogeneous)
            np.testing.assert_allclose(mine, pose[:3], atol=1e-12)


def test_links_are_where_another_reader_has_them(column, column_urdf, rng):
    yourdfpy = pytest.importorskip("yourdfpy")
    other = ByHand(column_urdf)
    second = yourdfpy.URDF.load(io.BytesIO(other.text), load_meshes=False)
    for row in random_coordinates(column, rng, 4):
        row[:3] = 0.0
        second.update_cfg(other.values(column, row))
        for link in second.link_map:
            mine = column.frame_pose(configuration(column, row), link)
            np.testing.assert_allclose(mine, second.get_transform(link), atol=1e-12, err_msg=link)


@each("seed", range(12))
def test_random_robots_are_where_pinocchio_has_them(tmp_path, seed):
    rng = np.random.default_rng(seed)
    base = ("fixed", "omni")[seed % 2]
    robot = random_robot(rng, tmp_path, 3 + seed % 5, base, followers=True)
    other = ByHand(Path(str(robot.urdf_path)))
    assert robot.followers
    for row in random_coordinates(robot, rng, 3):
        for link, pose in other.place(robot, row).items():
            np.testing.assert_allclose(robot.frame_pose(configuration(robot, row), link), pose, atol=1e-9)


def test_what_is_certified_is_free_of_what_followers_do(column, column_urdf, rng):
    """Segments among boxes, walked along with the followers set by hand."""
    other, deformer = ByHand(column_urdf), Deformer(column)
    certified = refused = 0
    for _ in range(30):
        rows = random_coordinates(column, rng, 2)
        rows[1] = rows[0] + 0.4 * (rows[1] - rows[0])
        rows[1, :3] = rows[0, :3]
        at = rng.uniform((-0.6, -0.5, 0.2), (0.9, 0.5, 1.6), (3, 3))
        at[:, :2] += rows[0, :2]
        boxes = [Box((0.15, 0.15, 0.15), at=tuple(p)) for p in at]
        strip = Strip.from_coordinates(column, rows)
        said = deformer.certify(strip, Scene(boxes))
        if not said.certified:
            refused += 1
            continue
        certified += 1
        for s in np.linspace(0.0, 1.0, 60):
            placed = other.place(column, rows[0] + s * (rows[1] - rows[0]))
            for piece in column.geometries:
                frame = column.model.frames[column.model.getFrameId(piece.links[0])]
                pose = placed[piece.links[0]] @ np.linalg.inv(frame.placement.homogeneous) @ piece.placement
                for box in boxes:
                    assert distance(piece.geometry, pose, coal.Box(0.15, 0.15, 0.15), box.pose)[0] > 0.0
    assert certified >= 5
    assert refused >= 5


def test_a_leader_without_bodies_of_its_own_moves_its_followers_in_the_proof(tmp_path):
    """The lift's second stage alone reaches the shelf: the first stays below."""
    path = write(tmp_path, *LIFT)
    robot = load_robot(path, base="fixed", joints=["lift"])
    rows = [robot.home(lift=0.0), robot.home(lift=0.4)]
    top = 0.2 * 3 + 0.4 * 1.5 + 0.02  # the arm's middle at the end
    for height, free in ((top + 0.12, True), (top + 0.05, False), (top - 0.2, False)):
        scene = Scene([Box((0.4, 0.4, 0.02), at=(0.0, 0.0, height))])
        assert (certify(robot, scene, rows).verdict.value == "certified") is free


def test_pairs_count_the_joints_that_move_one_and_not_the_other(column):
    """The lift's stages move together with what they carry, and against the weight that balances them."""
    bodies = BodySet.links(column)
    index = {name.rsplit("_", 1)[0]: k for k, name in enumerate(bodies.names)}
    lift = column.space.base_nv + column.joint_names.index("lift")
    pairs = [
        ("foot", "stage"),
        ("stage", "top"),
        ("top", "upper"),
        ("foot", "top"),
        ("top", "weight"),
        ("foot", "weight"),
    ]
    radius = MotionBounds(bodies).pair_radius(np.array([(index[a], index[b]) for a, b in pairs]))
    np.testing.assert_allclose(radius[lift], [0.5, 1.0, 0.0, 1.5, 2.25, 0.75])


def test_both_kernels_bound_alike(column, rng):
    bodies = BodySet.links(column)
    rows = random_coordinates(column, rng, 5)
    scene = Scene([Box((0.2, 0.2, 0.2), at=(0.5, 0.1, 1.0))])
    strip = Strip.from_coordinates(column, rows[:1] + np.linspace(0.0, 1.0, 9)[:, None] * (rows[1] - rows[0]))
    with twin():
        plain = Deformer(column)
    native, (one, two) = Deformer(column), (strip, strip)
    for _ in range(3):
        one = native.step(one, scene).strip
        with twin():
            two = plain.step(two, scene).strip
        np.testing.assert_allclose(one.coordinates, two.coordinates, atol=1e-6)
    assert len(MotionBounds(bodies).radius) == column.nv


def test_followers_limit_their_leader(tmp_path):
    """A follower's limits and speed are its leader's, by the multiplier."""
    low = '<axis xyz="0 0 1"/><limit lower="-0.3" upper="0.1" velocity="0.1" effort="1"/>'
    path = write(
        tmp_path,
        joint("lift", "base", "a"),
        joint("down", "a", "b", more=low, mimic='joint="lift" multiplier="-2" offset="0.06"'),
    )
    robot = load_robot(path, base="fixed", joints=["lift"])
    assert (robot.space.lower[0], robot.space.upper[0]) == pytest.approx((0.0, 0.18))
    assert MotionLimits.for_robot(robot).joint_speed[0] == pytest.approx(0.05)
    with refused(ConfigurationError, "lift"):
        robot.home(lift=0.2)
    with refused(ConfigurationError, "'lift'"):
        robot.home(down=-0.1)


def test_a_leader_whose_followers_leave_nothing_is_refused(tmp_path):
    path = write(tmp_path, joint("lift", "base", "a"), joint("far", "a", "b", mimic='joint="lift" offset="3"'))
    with refused(RobotError, "'far'"):
        load_robot(path, base="fixed", joints=["lift"])
    assert load_robot(path, base="fixed").locked["far"] == 0.5
    carrying = joint("elbow", "b", "arm", "revolute", TURNS)
    path = write(
        tmp_path, joint("lift", "base", "a"), joint("far", "a", "b", mimic='joint="lift" offset="3"'), carrying
    )
    assert load_robot(path, base="fixed").joint_names == ("elbow",)


def test_lifts_are_planned_and_grippers_held_by_default(tmp_path):
    robot = load_robot(write(tmp_path, *LIFT, *GRIPPER), base="fixed")
    assert robot.joint_names == ("lift", "elbow")
    assert set(robot.followers) == {"second"}
    assert robot.locked == pytest.approx({"thumb": 0.0, "finger": 0.1, "tip": 0.05})


def test_a_leader_is_planned_where_it_is_named(tmp_path):
    path = write(tmp_path, *LIFT, *GRIPPER)
    robot = load_robot(path, base="fixed", joints=["elbow", "thumb"])
    assert set(robot.joint_names) == {"elbow", "thumb"}
    assert {n: tuple(f) for n, f in robot.followers.items()} == {
        "finger": ("thumb", 2.0, 0.1),
        "tip": ("thumb", 1.0, 0.05),
    }
    assert robot.locked == pytest.approx({"lift": 0.0, "second": 0.02})
    (tmp_path / "bot.srdf").write_text(
        '<robot name="bot"><group name="hand"><joint name="thumb"/><joint name="finger"/></group></robot>'
    )
    assert load_robot(path, base="fixed", srdf=tmp_path / "bot.srdf", group="hand").joint_names == ("thumb",)
    with refused(RobotError, "'thumb'"):
        load_robot(path, base="fixed", joints=["finger"])


@each(
    "locked, wanted",
    [
        ({"finger": 0.3}, {"thumb": 0.1, "tip": 0.15}),
        ({"tip": 0.2}, {"thumb": 0.15, "finger": 0.4}),
        ({"tip": 0.2, "finger": 0.4}, {"thumb": 0.15}),
        ({"second": 0.12}, {"lift": 0.2}),
        ({"lift": 0.2}, {"second": 0.12}),
    ],
)
def test_what_a_locked_joint_mimics_is_held_where_that_puts_it(tmp_path, locked, wanted):
    robot = load_robot(write(tmp_path, *LIFT, *GRIPPER), base="fixed", locked=locked)
    assert {name: robot.locked[name] for name in [*locked, *wanted]} == pytest.approx({**locked, **wanted})
    assert not set(robot.joint_names) & set(robot.locked)


@each(
    "options, names",
    [
        ({"joints": ["lift"], "locked": {"second": 0.1}}, "'second'.*'lift'"),
        ({"joints": ["thumb"], "locked": {"tip": 0.1}}, "'tip'.*'thumb'"),
        ({"locked": {"finger": 0.05}}, "'finger'.*'thumb'"),
        ({"locked": {"finger": 0.3, "tip": 0.3, "second": 0.9}}, "'lift'"),
        ({"locked": {"tip": 0.1, "thumb": 0.2}}, "'tip'.*'finger'.*'thumb'"),  # which disagree on what is between them
    ],
)
def test_a_follower_is_not_locked_against_its_leader(tmp_path, options, names):
    with pytest.raises(RobotError, match=names):
        load_robot(write(tmp_path, *LIFT, *GRIPPER), base="fixed", **options)


def test_two_followers_that_want_their_leader_in_two_places_are_refused(tmp_path):
    more = joint("other", "arm", "third", mimic='joint="thumb"')
    path = write(tmp_path, *LIFT, *GRIPPER, more)
    with refused(RobotError, "'thumb'"):
        load_robot(path, base="fixed", locked={"finger": 0.3, "other": 0.3})
    assert load_robot(path, base="fixed", locked={"finger": 0.3, "other": 0.1}).locked["thumb"] == pytest.approx(0.1)


@each(
    "kind, more, multiplier",
    [("continuous", AROUND, 0.5), ("revolute", TURNS, 1.0), ("prismatic", SLIDES, 1.0)],
)
def test_a_continuous_leader_whose_followers_do_not_go_around_is_refused(tmp_path, caplog, kind, more, multiplier):
    """After a whole turn of it they would be elsewhere, and it is where it was."""
    follower = joint("dial", "base", "hand", kind, more, mimic=f'joint="turret" multiplier="{multiplier}"')
    arm = joint("elbow", "turning", "arm", "revolute", TURNS)
    path = write(tmp_path, joint("turret", "base", "turning", "continuous", AROUND), follower, arm)
    with refused(RobotError, "'turret'", "'dial'"):
        load_robot(path, base="fixed", joints=["turret", "elbow"])
    assert load_robot(path, base="fixed").joint_names == ("elbow",)
    assert "'turret'" in caplog.text


@each("numbers", ['multiplier="1e200"', 'multiplier="1e-200"', 'offset="1e20"'])
def test_absurd_multipliers_are_refused(tmp_path, numbers):
    path = write(tmp_path, joint("lift", "base", "a"), joint("far", "a", "b", mimic=f'joint="lift" {numbers}'))
    with refused(RobotError, "'far'"):
        load_robot(path, base="fixed", joints=["lift"])


def test_a_follower_with_multiplier_0_stays(tmp_path):
    path = write(
        tmp_path, joint("lift", "base", "a"), joint("still", "a", "b", mimic='joint="lift" multiplier="0" offset="0.2"')
    )
    robot = load_robot(path, base="fixed", joints=["lift"])
    assert not robot.followers
    assert robot.locked == {"still": 0.2}
    with refused(RobotError, "'still'"):
        load_robot(path, base="fixed", locked={"still": 0.3})


def pinocchio_lift() -> tuple[pin.Model, pin.GeometryModel]:
    """A lift as Pinocchio reads it with its mimics, and its shapes."""
    model = pin.Model()
    low, high, one = np.zeros(1), np.full(1, 0.5), np.ones(1)
    lift = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "lift", one, one, low, high)
    second = model.addJoint(lift, pin.JointModelPZ(), pin.SE3.Identity(), "second", one, one, low, high)
    elbow = model.addJoint(second, pin.JointModelRY(), pin.SE3.Identity(), "elbow", one, one, -one, one)
    for name in ("lift", "second", "elbow"):
        model.addJointFrame(model.getJointId(name))
    collision = pin.GeometryModel()
    for k, i in enumerate((lift, second, elbow)):
        pose = pin.SE3(np.eye(3), np.array([0.3 * k, 0.0, 0.0]))
        collision.addGeometryObject(pin.GeometryObject(f"body{k}", i, 0, pose, coal.Sphere(0.05)))
    return pin.transformJointIntoMimic(model, lift, second, 0.5, 0.1), collision


def test_pinocchios_own_mimics_follow():
    robot = RobotModel.from_pinocchio(*pinocchio_lift())
    assert robot.joint_names == ("lift", "elbow")
    assert tuple(robot.followers["second"]) == ("lift", 0.5, 0.1)
    kin = Kinematics(robot.tree, 1)
    kin.update(np.array([[0.2, 0.0]]))
    np.testing.assert_allclose(kin.T[3, 0, :, 3], [0.0, 0.0, 0.4], atol=1e-12)
    held = RobotModel.from_pinocchio(*pinocchio_lift(), locked={"lift": 0.2})
    assert held.locked == pytest.approx({"lift": 0.2, "second": 0.2})
    z = [piece.placement[2, 3] for piece in held.geometries]
    assert z[:2] == pytest.approx([0.2, 0.4])
    with refused(RobotError, "'second'"):
        RobotModel.from_pinocchio(*pinocchio_lift(), locked={"second": 0.2})
    with refused(RobotError, "'second'"):
        RobotModel.from_pinocchio(*pinocchio_lift(), home={"second": 0.4})


def test_robots_that_follow_otherwise_are_not_the_same(tmp_path):
    """Pinocchio's own comparison forgets by how much a joint follows."""
    robots = []
    for number, multiplier in enumerate((0.5, 0.4)):
        folder = tmp_path / str(number)
        folder.mkdir()
        second = joint("second", "first", "carriage", mimic=f'joint="lift" multiplier="{multiplier}"')
        robots.append(load_robot(write(folder, joint("lift", "base", "first"), second), base="fixed", joints=["lift"]))
    assert robots[0].same_as(robots[0])
    assert not robots[0].same_as(robots[1])


@each(
    "header, second, words",
    [
        ("lift,second", (0.07, 0.12), ""),
        ("second,lift", (0.1, 0.2), ""),
        ("lift,second", (0.07, 0.2), "second"),
        ("elbow,second", (0.07, 0.12), "second"),
    ],
)
def test_a_follower_in_a_path_file_is_where_its_leader_puts_it(tmp_path, header, second, words):
    robot = load_robot(write(tmp_path, *LIFT), base="fixed")
    first = (0.1, 0.2) if header != "second,lift" else (0.07, 0.12)
    file = tmp_path / "path.csv"
    file.write_text(header + "\n" + "\n".join(f"{a},{b}" for a, b in zip(first, second, strict=True)) + "\n")
    if words:
        assert any(words in doubt for doubt in load_path(file, robot).doubts)
        return
    found = load_path(file, robot)
    assert found.doubts == ()
    np.testing.assert_allclose(found.q[:, robot.joint_names.index("lift")], [0.1, 0.2])
    assert "second" not in "; ".join(found.notes)


def test_mujoco_drives_no_followers(column_urdf):
    pytest.importorskip("mujoco")
    from elastic_strips.sim.mujoco.plant import MujocoPlant

    robot = load_robot(column_urdf, base="diff_drive", joints=["lift", "shoulder"])
    with refused(ParameterError, "balance"):
        MujocoPlant(robot, MotionLimits.for_robot(robot, wheel_speed=1.0, track=0.4, wheel_radius=0.1))
