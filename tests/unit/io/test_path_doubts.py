"""What a path file says and the robot does not follow: it is doubted or refused, and never certified in silence."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.collision import Verdict, certify, prove
from elastic_strips.collision.proof import path_digest
from elastic_strips.errors import ConfigurationError, ParameterError
from elastic_strips.io import PathFile, load_path, read_world, write_path
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Scene, World
from elastic_strips.strip import Strip

ARM = tuple(f"panda_joint{k}" for k in range(1, 8))
HOME = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)
NOTHING = Scene([Box((0.1, 0.1, 0.1), at=(9.0, 9.0, 9.0), name="far")])


def _joint(name: str, kind: str, parent: str, child: str, at: str, axis: str = "0 0 1", limits: str = "-2 2") -> str:
    low, high = limits.split()
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{at}"/><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{axis}"/><limit lower="{low}" upper="{high}" effort="1" velocity="1"/></joint>'
    )


def _link(name: str, shape: str, turned: str = "0 0 0") -> str:
    return f'<link name="{name}"><collision><origin rpy="{turned}"/><geometry>{shape}</geometry></collision></link>'


@pytest.fixture(scope="module")
def cart_file(tmp_path_factory) -> Path:
    """A base with an arm's joint, a torso, a turntable, a gripper, a round wheel and a square one."""
    file = tmp_path_factory.mktemp("robot") / "cart.urdf"
    box = '<box size="{}"/>'.format
    parts = [
        _link("base", box("0.6 0.4 0.2")), _link("arm", box("0.1 0.1 0.4")), _link("top", box("0.1 0.1 0.1")),
        _link("table", box("0.2 0.1 0.02")), _link("finger", box("0.02 0.02 0.1")),
        _link("round", '<cylinder radius="0.1" length="0.05"/>', "1.5707963 0 0"), _link("square", box("0.2 0.05 0.2")),
        _joint("shoulder", "revolute", "base", "arm", "0 0 0.5"),
        _joint("torso", "prismatic", "base", "top", "-0.2 0 0.8", limits="0 0.5"),
        _joint("turntable", "continuous", "base", "table", "0.2 0 0.2"),
        _joint("gripper", "prismatic", "arm", "finger", "0 0 0.3", limits="0 0.05"),
        _joint("left_wheel", "continuous", "base", "round", "0 0.3 0", "0 1 0"),
        _joint("right_wheel", "continuous", "base", "square", "0 -0.3 0", "0 1 0"),
    ]  # fmt: skip
    file.write_text(f'<robot name="cart">{"".join(parts)}</robot>')
    return file


@pytest.fixture(scope="module")
def cart(cart_file) -> RobotModel:
    return load_robot(cart_file, base="omni", joints=["shoulder", "torso", "turntable"])


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return load_robot("panda", joints=ARM)


def table(folder: Path, header: str, *rows: str) -> Path:
    (folder / "p.csv").write_text("\n".join((header, *rows)) + "\n")
    return folder / "p.csv"


def message(folder: Path, document: object) -> Path:
    (folder / "p.json").write_text(json.dumps(document))
    return folder / "p.json"


def trajectory(names, rows, times=None) -> dict[str, object]:
    stamps = range(len(rows)) if times is None else times
    points = [{"positions": list(map(float, r)), "time_from_start": t} for r, t in zip(rows, stamps, strict=True)]
    return {"joint_names": list(names), "points": points}


def arm(value: float) -> list[float]:
    return [value, *HOME[1:]]


def transform(x=0.0, y=0.0, z=0.0, turn=(0.0, 0.0, 0.0, 1.0)) -> dict[str, object]:
    return {
        "translation": {"x": x, "y": y, "z": z}, "rotation": dict(zip("xyzw", turn, strict=True)),
    }  # fmt: skip


def moving(names, *points, times=None) -> dict[str, object]:
    stamps = range(len(points)) if times is None else times
    return {
        "joint_names": list(names),
        "points": [{"transforms": list(t), "time_from_start": s} for t, s in zip(points, stamps, strict=True)],
    }


def verdict(robot: RobotModel, path: PathFile, scene: Scene | World = NOTHING) -> Verdict:
    times = path.times if isinstance(scene, World) else None
    return certify(robot, scene, path, times=times, measure=False).verdict


# --- the base by its usual names -------------------------------------------------------------------------------------


@each(
    "names",
    [
        "x,y,yaw", "X,Y,Theta", "position/x,position/y,position/theta", "world_joint/x,world_joint/y,world_joint/theta",
        "virtual_joint/x,virtual_joint/y,virtual_joint/theta", "odom_x,odom_y,odom_t", "base_x,base_y,base_yaw",
        "base_x_joint,base_y_joint,base_theta_joint", "world_x_joint,world_y_joint,world_yaw_joint",
        "anything/x,anything/y,anything/theta", "myrobot_x_joint,myrobot_y_joint,myrobot_theta_joint",
        "base_joint.x,base_joint.y,base_joint.theta", '"x","y","yaw"', " x , y , yaw ", "x [m],y [m],yaw [rad]",
        "x,y,heading", "base_x_m,base_y_m,base_yaw_rad",
    ],
)  # fmt: skip
def test_a_base_is_found_by_its_usual_names(cart, tmp_path, names):
    read = load_path(table(tmp_path, f"{names},shoulder", "0,1,0.5,0.1", "2,1,0.7,0.2"), cart)
    rows = cart.space.to_coordinates(read.q)
    np.testing.assert_allclose(rows[:, :4], [[0, 1, 0.5, 0.1], [2, 1, 0.7, 0.2]], atol=1e-12)
    assert read.doubts == ()
    assert verdict(cart, read) is Verdict.CERTIFIED


@each(
    ("names", "row", "wanted"),
    [
        ("x,y,yaw_deg,shoulder_deg,torso", (1, 2, 90, 45, 0.1), (1, 2, np.pi / 2, np.pi / 4, 0.1)),
        ("x_mm,y [cm],yaw (deg),shoulder,torso_mm", (1000, 200, 90, 0.5, 100), (1, 2, np.pi / 2, 0.5, 0.1)),
        ("odom_x,odom_y,odom_t [degrees],shoulder [°],torso [m]", (1, 2, -90, 45, 0), (1, 2, -np.pi / 2, np.pi / 4, 0)),
    ],
)  # fmt: skip
def test_units_that_are_named_are_converted(cart, tmp_path, names, row, wanted):
    line = ",".join(map(str, row))
    read = load_path(table(tmp_path, names, line, line), cart)
    np.testing.assert_allclose(cart.space.to_coordinates(read.q)[0, :5], wanted, atol=1e-12)


def test_units_below_the_names_and_for_the_whole_file(cart, tmp_path):
    rows = ("0,0,0,45,0.1", "1,0,90,45,0.1")
    for read in (
        load_path(table(tmp_path, "x,y,yaw,shoulder,torso\nm,m,deg,deg,m", *rows), cart),
        load_path(table(tmp_path, "x,y,yaw,shoulder,torso", *rows), cart, angles="deg"),
    ):
        np.testing.assert_allclose(
            cart.space.to_coordinates(read.q)[1, :5], [1, 0, np.pi / 2, np.pi / 4, 0.1], atol=1e-12
        )


@each("names", ["x_deg,y,yaw,shoulder", "x,y,yaw_mm,shoulder", "x,y,yaw,shoulder [grad]"])
def test_a_unit_of_something_else_is_refused(cart, tmp_path, names):
    with pytest.raises(ConfigurationError):
        load_path(table(tmp_path, names, "0,0,0,0", "1,0,0,0"), cart)


def test_the_same_in_messages_and_in_a_crate(cart, tmp_path):
    """What was certified beside a crate that the base drives through."""
    crate = Scene([Box((0.6, 0.6, 1.0), at=(2.0, 0.0, 0.5), name="crate")])
    names = ["position/x", "position/y", "position/theta", "torso"]
    rows = [[x, 0.0, 0.0, 0.3] for x in (0.0, 2.0, 4.0)]
    read = load_path(message(tmp_path, trajectory(names, rows)), cart)
    assert verdict(cart, read, crate) is Verdict.REFUTED


@each("prefix", ["goal", "tool", "hand"])
def test_what_is_called_after_something_else_is_not_the_base(cart, tmp_path, prefix):
    names = ",".join(f"{prefix}_{k}" for k in ("x", "y", "yaw"))
    read = load_path(table(tmp_path, f"{names},shoulder", "0,0,0,0", "1,0,0,0"), cart)
    assert not cart.space.to_coordinates(read.q)[:, :3].any()
    assert len(read.doubts) == 2  # that column, and the base that is nowhere
    assert verdict(cart, read) is Verdict.UNKNOWN


def test_two_columns_of_one_coordinate(cart, tmp_path):
    header = "x,y,yaw,odom_x,shoulder"
    with refused(ConfigurationError, "odom_x"):
        load_path(table(tmp_path, header, "0,0,0,0,0", "1,0,0,1.2,0"), cart)
    assert load_path(table(tmp_path, header, "0,0,0,0,0", "1,0,0,1,0"), cart).doubts == ()
    found = load_path(table(tmp_path, header, "0,0,0,0,0", "1,0,0,1.2,0"), cart, ignore=["odom_x"])
    assert found.q[1, 0] == 1.0


# --- what is not followed --------------------------------------------------------------------------------------------


def test_a_base_that_is_nowhere_is_doubted(cart, cart_file, tmp_path):
    file = table(tmp_path, "shoulder,torso", "0,0.1", "0.5,0.1")
    read = load_path(file, cart)
    assert len(read.doubts) == 1
    assert verdict(cart, read) is Verdict.UNKNOWN
    placed = load_path(file, cart, base_at=(1.0, 2.0, 0.5))
    np.testing.assert_allclose(cart.space.to_coordinates(placed.q)[:, :3], [[1.0, 2.0, 0.5]] * 2)
    assert placed.doubts == ()
    assert verdict(cart, placed) is Verdict.CERTIFIED
    still = load_robot(cart_file, base="fixed", joints=["shoulder", "torso", "turntable"])
    assert load_path(file, still).doubts == ()


@each("names", ["x,y", "y,yaw", "yaw"])
def test_a_base_that_is_half_placed_is_doubted(cart, tmp_path, names):
    row = ",".join("0" for _ in names.split(","))
    file = table(tmp_path, f"{names},shoulder", f"{row},0", f"{row},0.5")
    assert len(load_path(file, cart).doubts) == 1
    assert load_path(file, cart, base_at=(1.0, 2.0, 0.5)).doubts == ()


@each("base_at", [(1.0, 2.0), (np.nan, 0.0, 0.0), (1e5, 0.0, 0.0), "abc", (0.0, 0.0, 1e17), (0.0, 0.0, 90.0)])
def test_a_place_that_is_none_is_refused(cart, tmp_path, base_at):
    with pytest.raises(ConfigurationError):
        load_path(table(tmp_path, "shoulder", "0", "1"), cart, base_at=base_at)


def test_a_base_is_placed_once(cart, panda, tmp_path):
    with pytest.raises(ConfigurationError):
        load_path(table(tmp_path, "x,y,yaw", "0,0,0", "1,0,0"), cart, base_at=(0.0, 0.0, 0.0))
    with pytest.raises(ConfigurationError):
        load_path(message(tmp_path, trajectory(ARM, [arm(0), arm(1)])), panda, base_at=(0.0, 0.0, 0.0))


def test_a_fixed_base_that_moves_in_the_file(cart_file, panda, tmp_path):
    still = load_robot(cart_file, base="fixed", joints=["shoulder", "torso", "turntable"])
    assert len(load_path(table(tmp_path, "x,y,yaw,shoulder", "0,0,0,0", "1,0,0,0"), still).doubts) == 1
    assert len(load_path(table(tmp_path, "x,y,yaw,shoulder", "1,0,0,0", "1,0,0,0"), still).doubts) == 1
    assert load_path(table(tmp_path, "x,y,yaw,shoulder", "0,0,0,0", "0,0,0,1"), still).doubts == ()
    document = {
        "joint_trajectory": trajectory(ARM, [arm(0), arm(1)]),
        "multi_dof_joint_trajectory": moving(["world_joint"], [transform()], [transform(x=1.0)]),
    }
    assert len(load_path(message(tmp_path, document), panda).doubts) == 1


@pytest.mark.parametrize("values", [("0.0", "0.04"), ("0.04", "0.04")])
def test_a_joint_that_is_held_otherwise(cart, cart_file, tmp_path, values):
    """It moves in the file, or it is elsewhere there."""
    file = table(tmp_path, "x,y,yaw,gripper", *(f"0,0,0,{v}" for v in values))
    read = load_path(file, cart)
    assert len(read.doubts) == 1
    assert "gripper" in read.doubts[0]
    assert verdict(cart, read) is Verdict.UNKNOWN
    planned = load_robot(cart_file, base="omni", joints=["shoulder", "gripper"])
    assert load_path(file, planned).doubts == ()
    held = load_robot(cart_file, base="omni", joints=["shoulder"], locked={"gripper": 0.04})
    assert bool(load_path(file, held).doubts) is (values[0] != values[1])
    asked = load_path(file, cart, ignore=["gripper"])
    assert asked.doubts == ()
    assert any("gripper" in note for note in asked.notes)


def test_a_joint_that_follows_another_may_be_in_the_file(tmp_path):
    """Both fingers of a gripper: where it is planned, the second one goes with the first."""
    robot = load_robot("panda", joints=["panda_joint1", "panda_finger_joint1"])
    names = "panda_joint1,panda_finger_joint1,panda_finger_joint2"
    assert load_path(table(tmp_path, names, "0,0.01,0.01", "0,0.03,0.03"), robot).doubts == ()
    assert len(load_path(table(tmp_path, names, "0,0.01,0.01", "0,0.03,0.01"), robot).doubts) == 1


def test_a_refuted_path_stays_refuted(cart, tmp_path):
    post = Scene([Box((0.1, 0.1, 1.0), at=(0.0, 0.0, 0.5), name="post")])
    read = load_path(table(tmp_path, "shoulder,gripper", "0,0", "1,0.04"), cart)
    assert len(read.doubts) == 2
    assert verdict(cart, read, post) is Verdict.REFUTED


def test_wheels_turn_where_they_are_round(cart, tiago, tmp_path):
    assert cart.round_wheels == {"left_wheel"}
    turned = load_path(table(tmp_path, "x,y,yaw,left_wheel", "0,0,0,0", "1,0,0,10"), cart)
    assert turned.doubts == ()
    assert any("left_wheel" in note for note in turned.notes)
    assert len(load_path(table(tmp_path, "x,y,yaw,right_wheel", "0,0,0,0", "1,0,0,10"), cart).doubts) == 1
    assert tiago.round_wheels == {"wheel_left_joint", "wheel_right_joint"}


@each("names", ["x,y,yaw,mast", "x,y,yaw,roof_joint", "x,y,yaw,hatch [deg]"])
def test_a_column_that_nobody_knows(cart, tmp_path, names):
    changes = load_path(table(tmp_path, names, "0,0,0,1", "1,0,0,2"), cart)
    assert len(changes.doubts) == 1
    assert verdict(cart, changes) is Verdict.UNKNOWN
    stays = load_path(table(tmp_path, names, "0,0,0,1", "1,0,0,1"), cart)
    assert stays.doubts == ()
    assert any(names.split(",")[3] in note for note in stays.notes)
    assert load_path(table(tmp_path, names, "0,0,0,1", "1,0,0,2"), cart, ignore=[names.split(",")[3]]).doubts == ()


@each("name", ["sholder", "shouldr", "Tursntable", "turntabel"])
def test_a_misspelt_joint_is_told_which_it_may_be(cart, tmp_path, name):
    """It stands at home instead, so what is certified would be another path."""
    path = load_path(table(tmp_path, f"x,y,yaw,{name}", "0,0,0,0.5", "1,0,0,0.5"), cart)
    assert len(path.doubts) == 1
    assert any(joint in path.doubts[0] for joint in ("shoulder", "turntable"))
    assert verdict(cart, path) is Verdict.UNKNOWN


def test_other_numbers_are_other_joints(panda, tmp_path):
    """A column of an eighth joint is no misspelt seventh; but where that has none it may stand for it, elsewhere."""
    names = ",".join([*ARM[:6], "panda_joint8"])
    home = panda.home()[6]
    for at, doubts in ((home, 0), (home + 0.1, 1)):
        row = ",".join(map(repr, [*HOME[:6], float(at)]))
        path = load_path(table(tmp_path, names, row, row), panda)
        assert len(path.doubts) == doubts
    assert load_path(table(tmp_path, names, row, row), panda, ignore="panda_joint8").doubts == ()


def test_what_is_ignored_has_to_be_there(cart, tmp_path):
    with refused(ConfigurationError, "mats"):
        load_path(table(tmp_path, "x,y,yaw,mast", "0,0,0,1", "1,0,0,2"), cart, ignore=["mats"])


@each(
    "names",
    [
        "shoulder_velocity,torso_effort,vx", "velocity/shoulder,shoulder_acc,omega",
        "gripper_effort,turntable/velocity,shoulder_current",
    ],
)  # fmt: skip
def test_rates_and_efforts_are_no_doubt(cart, tmp_path, names):
    read = load_path(table(tmp_path, f"index,x,y,yaw,{names}", "0,0,0,0,1,2,3", "1,1,0,0,4,5,6"), cart)
    assert read.doubts == ()


@each("name", ["x_current", "current_gripper", "base_x_temperature"])
def test_where_something_is_now_is_no_rate(cart, tmp_path, name):
    assert len(load_path(table(tmp_path, f"x,y,yaw,{name}", "0,0,0,0", "0,0,0,1"), cart).doubts) == 1


def test_arrays_that_are_left_out(cart, tmp_path):
    rows = np.array([[0.0, 0, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0], [2, 0, 0, 0, 0, 0]])
    np.savez(tmp_path / "a.npz", q=rows, qd=rows + 1.0, hand=np.array([0.0, 0.02, 0.04]))
    assert len(load_path(tmp_path / "a.npz", cart).doubts) == 1
    asked = load_path(tmp_path / "a.npz", cart, ignore=["hand"])
    assert asked.doubts == ()
    np.savez(tmp_path / "c.npz", q=rows.T, hand=np.array([0.0, 0.02, 0.04]))
    assert len(load_path(tmp_path / "c.npz", cart).doubts) == 1
    np.savez(tmp_path / "b.npz", q=rows, qd=rows + 1.0, hand=np.zeros((3, 5)))
    assert load_path(tmp_path / "b.npz", cart).doubts == ()


# --- several trajectories, start states ------------------------------------------------------------------------------


def _robot_trajectory(a: float, b: float) -> dict[str, object]:
    return {"joint_trajectory": trajectory(ARM, [arm(a), arm(b)])}


@each(
    "wrap",
    [
        lambda parts: {"trajectory": parts}, lambda parts: parts, lambda parts: {"trajectory_stages": parts},
        lambda parts: {"result": {"planned": {"trajectory": parts}}},
    ],
)  # fmt: skip
def test_all_trajectories_in_their_order(panda, tmp_path, wrap):
    document = wrap([_robot_trajectory(0.0, 0.5), _robot_trajectory(0.5, 2.0), _robot_trajectory(2.0, 1.0)])
    read = load_path(message(tmp_path, document), panda)
    np.testing.assert_allclose(read.q[:, 0], [0.0, 0.5, 0.5, 2.0, 2.0, 1.0])
    np.testing.assert_allclose(read.times, [0, 1, 1, 2, 2, 3])
    assert read.doubts == ()
    assert read.time_doubts
    wall = Scene([Box((0.8, 0.05, 1.2), at=(0.0, 0.35, 0.6), name="wall")])
    assert verdict(panda, read, wall) is Verdict.REFUTED
    first = load_path(message(tmp_path, wrap([_robot_trajectory(0.0, 0.5)])), panda)
    assert verdict(panda, first, wall) is Verdict.CERTIFIED


def test_documents_of_a_file_follow_each_other(panda, tmp_path):
    texts = [json.dumps(_robot_trajectory(a, b)) for a, b in ((0.0, 0.5), (0.5, 1.0))]
    (tmp_path / "p.yaml").write_text("---\n" + "\n---\n".join(texts) + "\n---\n")
    np.testing.assert_allclose(load_path(tmp_path / "p.yaml", panda).q[:, 0], [0.0, 0.5, 0.5, 1.0])


def test_trajectories_that_do_not_join_are_refused(panda, tmp_path):
    with refused(ConfigurationError, "panda_joint1"):
        load_path(message(tmp_path, [_robot_trajectory(0.0, 0.5), _robot_trajectory(0.9, 2.0)]), panda)
    read = load_path(message(tmp_path, [_robot_trajectory(0.0, 0.5), _robot_trajectory(0.5002, 2.0)]), panda)
    assert read.q[2, 0] == 0.5002  # the step between them is a part of the path


def test_other_joints_keep_where_they_were_left(cart, tmp_path):
    """A torso, then an arm; each trajectory names what it moves."""
    base = [["x", "y", "yaw"], [[0, 0, 0], [1, 0, 0]]]
    document = [trajectory(*base), trajectory(["torso"], [[0.1], [0.4]]), trajectory(["shoulder"], [[0.0], [0.7]])]
    rows = cart.space.to_coordinates(load_path(message(tmp_path, document), cart).q)
    np.testing.assert_allclose(rows[:, 4], [0.1, 0.1, 0.1, 0.4, 0.4, 0.4])
    np.testing.assert_allclose(rows[:, 0], [0, 1, 1, 1, 1, 1])
    np.testing.assert_allclose(rows[:, 3], [0, 0, 0, 0, 0, 0.7])


def _started(names, values, *parts, base=None, attached=()) -> dict[str, object]:
    start: dict[str, object] = {"joint_state": {"name": list(names), "position": list(values)}}
    if base is not None:
        start["multi_dof_joint_state"] = {"joint_names": ["world_joint"], "transforms": [base]}
    if attached:
        start["attached_collision_objects"] = list(attached)
    return {"trajectory_start": start, "trajectory": list(parts)}


def test_the_start_state_says_where_the_others_are(cart, tmp_path):
    part = {"joint_trajectory": trajectory(["shoulder"], [[0.0], [0.5]])}
    where = transform(1.0, 2.0, turn=(0, 0, 1.0, 0.0))
    names, values = ("shoulder", "torso", "turntable", "gripper", "left_wheel"), (0.0, 0.3, 1.0, 0.0, 3.0)
    read = load_path(message(tmp_path, _started(names, values, part, base=where)), cart)
    rows = cart.space.to_coordinates(read.q)
    np.testing.assert_allclose(rows, [[1, 2, np.pi, 0, 0.3, 1.0], [1, 2, np.pi, 0.5, 0.3, 1.0]], atol=1e-12)
    assert read.doubts == ()
    assert any("torso" in note for note in read.notes)
    open_ = load_path(message(tmp_path, _started(names, (0.0, 0.3, 1.0, 0.04, 3.0), part, base=where)), cart)
    assert len(open_.doubts) == 1  # the gripper is elsewhere than here


def test_a_start_state_beside_the_path_is_a_part_of_it(panda, tmp_path):
    read = load_path(message(tmp_path, _started(ARM, arm(-0.4), _robot_trajectory(0.0, 0.5))), panda)
    np.testing.assert_allclose(read.q[:, 0], [-0.4, 0.0, 0.5])
    same = load_path(message(tmp_path, _started(ARM, arm(0.0), _robot_trajectory(0.0, 0.5))), panda)
    assert len(same.q) == 2
    late = {"joint_trajectory": trajectory(ARM, [arm(0.0), arm(0.5)], times=[2.0, 3.0])}
    early = load_path(message(tmp_path, _started(ARM, arm(-0.4), late)), panda)
    np.testing.assert_allclose(early.times, [0.0, 2.0, 3.0])
    assert early.doubts == early.time_doubts == ()
    partly = load_path(message(tmp_path, _started(ARM[:3], arm(0.3)[:3], late)), panda)
    assert partly.q[0, 0] == 0.3
    assert partly.doubts


def test_what_the_robot_carries_in_the_file_is_doubted(panda, tmp_path):
    carried = _started(ARM, arm(0.0), _robot_trajectory(0.0, 0.5), attached=[{"object": {"id": "cup"}}])
    assert len(load_path(message(tmp_path, carried), panda).doubts) == 1


# --- poses of the base -----------------------------------------------------------------------------------------------


def _driven(*transforms, names=("world_joint",)) -> dict[str, object]:
    return {
        "joint_trajectory": trajectory(["torso"], [[0.1]] * len(transforms)),
        "multi_dof_joint_trajectory": moving(names, *([t] if isinstance(t, dict) else t for t in transforms)),
    }


def test_quaternions_are_normalised(cart, tmp_path):
    for length in (0.9995, 1.0, 1.0005):
        part = length * np.sqrt(0.5)
        read = load_path(message(tmp_path, _driven(transform(), transform(turn=(0, 0, part, part)))), cart)
        assert cart.space.to_coordinates(read.q)[1, 2] == pytest.approx(np.pi / 2, abs=1e-12)


def test_a_turn_goes_the_way_of_its_quaternions(cart, tmp_path):
    """They know no whole turns: 3.0, then 3.3 rad, and the negative of a quaternion is the same turn."""
    turns = [(0, 0, np.sin(a / 2) * s, np.cos(a / 2) * s) for a, s in ((3.0, 1), (3.3, 1), (3.5, -1), (3.0, 1))]
    read = load_path(message(tmp_path, _driven(*(transform(turn=t) for t in turns))), cart)
    found = cart.space.to_coordinates(read.q)[:, 2]
    np.testing.assert_allclose(np.unwrap(found), [3.0, 3.3, 3.5, 3.0], atol=1e-9)


@each(
    "bad",
    [
        transform(turn=(0, 0, 0, 0)), transform(turn=(0, 0, 1.4142, 1.4142)), transform(turn=(0, 0, 0.7, 0.7)),
        transform(turn=(1, 0, 0, 0)), transform(turn=(0.1, 0, 0, np.sqrt(0.99))), transform(turn=(0, 0.6, 0.8, 0)),
        transform(z=0.1), transform(z=-0.002), transform(turn=(0, 0, float("nan"), 1)), transform(x=1e9),
        transform(x=2e4),
    ],
)  # fmt: skip
def test_a_base_that_does_not_stand_on_the_floor_is_refused(cart, tmp_path, bad):
    with pytest.raises(ConfigurationError):
        load_path(message(tmp_path, _driven(transform(), bad)), cart)


def test_the_names_say_which_transform_is_the_base(cart, tmp_path):
    def crate(x):
        return transform(x=x, z=0.7, turn=(0.6, 0.0, 0.8, 0.0))

    names = ["object_joint", "world_joint"]
    stays = load_path(
        message(tmp_path, _driven([crate(0), transform()], [crate(0), transform(x=2.0)], names=names)), cart
    )
    np.testing.assert_allclose(stays.q[:, 0], [0.0, 2.0])
    assert stays.doubts == ()
    moves = _driven([crate(0), transform()], [crate(1), transform(x=2.0)], names=names)
    assert len(load_path(message(tmp_path, moves), cart).doubts) == 1
    other = load_path(message(tmp_path, _driven(crate(0), crate(1), names=["object_joint"])), cart)
    assert len(other.doubts) == 2  # what moves there, and the base that is nowhere
    with pytest.raises(ConfigurationError):
        load_path(message(tmp_path, _driven([crate(0)], [crate(0)], names=names)), cart)
    with pytest.raises(ConfigurationError):
        load_path(message(tmp_path, _driven(*[[transform()] * 2] * 2, names=["world_joint", "base_joint"])), cart)


def test_a_base_without_joints_and_other_times(cart, tmp_path):
    alone = {"joint_trajectory": trajectory([], []), "multi_dof_joint_trajectory": moving(
        ["world_joint"], [transform()], [transform(x=1.0)]
    )}  # fmt: skip
    np.testing.assert_allclose(load_path(message(tmp_path, alone), cart).q[:, 0], [0.0, 1.0])
    both = _driven(transform(), transform(x=1.0))
    both["multi_dof_joint_trajectory"] = moving(["world_joint"], [transform()], [transform(x=1.0)], times=[0.0, 5.0])
    with pytest.raises(ConfigurationError):
        load_path(message(tmp_path, both), cart)


@each("column", ["z", "base_z", "roll", "pitch"])
def test_columns_off_the_floor_are_refused(cart, tmp_path, column):
    with pytest.raises(ConfigurationError, match=column):
        load_path(table(tmp_path, f"x,y,yaw,{column}", "0,0,0,0", "1,0,0,0.5"), cart)
    assert load_path(table(tmp_path, f"x,y,yaw,{column}", "0,0,0,0", "1,0,0,0"), cart).doubts == ()


# --- times -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def world(tmp_path) -> World:
    (tmp_path / "cart.yaml").write_text(
        "obstacles:\n  - {shape: box, name: cart, size: [0.4, 0.4, 1.0], at: [9.0, 0.0, 0.5], "
        "motion: {twist: {linear: [-0.1, 0.0, 0.0]}}}\n"
    )
    return read_world(tmp_path / "cart.yaml")


def settled(robot: RobotModel, path: PathFile, world: World) -> bool:
    """Whether the path is called certified; it may be unknown, or its times refused."""
    try:
        return verdict(robot, path, world) is Verdict.CERTIFIED
    except ParameterError:
        return False


@pytest.mark.parametrize("times", [(0, 0, 0), (3, 3, 3), (0, 1, 1), (5, 6, 7)])
def test_times_that_say_little_where_something_moves(panda, world, tmp_path, times):
    rows = [arm(0.0), arm(0.4), arm(0.8)]
    read = load_path(message(tmp_path, trajectory(ARM, rows, times)), panda)
    assert read.doubts or read.time_doubts
    assert not settled(panda, read, world)
    lines = [",".join(map(str, (t, *row))) for t, row in zip(times, rows, strict=True)]
    csv = table(tmp_path, ",".join(("time", *ARM)), *lines)
    assert not settled(panda, load_path(csv, panda), world)
    assert settled(panda, load_path(message(tmp_path, trajectory(ARM, rows)), panda), world)


@each(
    "column, times, asked",
    [
        ("time", (0, 4500, 9000), True),
        ("time_ms", (0, 4500, 9000), False),
        ("time_s", (0, 4500, 9000), False),
        ("seconds", (0, 4500, 9000), False),
        ("time", (0, 4.5, 9), False),
        ("time", (0, 30, 59), False),  # slow, and soon over
    ],
)
def test_times_that_may_be_in_milliseconds_are_asked_about(panda, tmp_path, column, times, asked):
    rows = [arm(0.0), arm(0.3), arm(0.5)]
    lines = [",".join(map(str, (t, *row))) for t, row in zip(times, rows, strict=True)]
    read = load_path(table(tmp_path, ",".join((column, *ARM)), *lines), panda)
    assert bool(read.time_doubts) is asked
    assert not read.doubts
    assert read.times[-1] == pytest.approx(times[-1] * (1e-3 if column == "time_ms" else 1.0))


def test_a_first_point_that_is_reached_later(panda, world, tmp_path):
    """The robot goes there from where it is, and the file does not say from where: of what stands still, too."""
    file = message(tmp_path, trajectory(ARM, [arm(0.0), arm(0.4)], [2.0, 3.0]))
    assert verdict(panda, load_path(file, panda)) is Verdict.UNKNOWN
    said = load_path(file, panda, starts_at=7.5)
    np.testing.assert_allclose(said.times, [7.5, 8.5])
    assert verdict(panda, said) is verdict(panda, said, world) is Verdict.CERTIFIED


def test_times_of_a_log_count_where_something_moves(panda, world, tmp_path):
    """Seconds since that robot was switched on: by then everything has left here."""
    rows = [f"{1e5 + k},{','.join(map(str, arm(0.4 * k)))}" for k in range(3)]
    read = load_path(table(tmp_path, ",".join(("timestamp", *ARM)), *rows), panda)
    assert read.doubts == ()
    assert verdict(panda, read, world) is Verdict.UNKNOWN


@each(("name", "unit"), [("time_ms", 1e-3), ("t [ms]", 1e-3), ("time (ns)", 1e-9), ("%time", 1e-9)])
def test_times_in_other_units(panda, tmp_path, name, unit):
    rows = [",".join(map(str, (round(k / unit), *arm(0.1 * k)))) for k in range(3)]
    np.testing.assert_allclose(load_path(table(tmp_path, ",".join((name, *ARM)), *rows), panda).times, [0, 1, 2])


@each("times", [(0, 2, 1), (3, 2, 1), (0, float("nan"), 1), (0, 1, 1e18)])
def test_times_that_fall_name_the_row(panda, tmp_path, times):
    rows = [",".join(map(str, (t, *arm(0.1 * k)))) for k, t in enumerate(times)]
    with refused(ConfigurationError, "p.csv"):
        load_path(table(tmp_path, ",".join(("time", *ARM)), *rows), panda)
    if times == (0, 2, 1):
        with refused(ConfigurationError, "p.csv:4:"):
            load_path(table(tmp_path, ",".join(("time", *ARM)), *rows), panda)


# --- bounds, limits, degrees -----------------------------------------------------------------------------------------


@each("row", ["1e35,0,0,0", "0,-1e6,0,0", "0,10001,0,0", "0,0,1e17,0"])
def test_far_coordinates_are_refused(cart, tmp_path, row):
    with refused(ConfigurationError, "p.csv:3:"):
        load_path(table(tmp_path, "x,y,yaw,shoulder", "0,0,0,0", row), cart)


@each("x", [1e35, -1e6, 10_001.0])
def test_far_configurations_are_refused(cart, x):
    q = np.array([cart.home(), cart.home()])
    q[1, 0] = x
    with pytest.raises(ConfigurationError):
        cart.check_q(q)
    with pytest.raises(ConfigurationError):
        certify(cart, NOTHING, q)
    assert cart.home(x=9999.0)[0] == 9999.0


def test_what_files_round_is_taken_to_the_limit(cart, tmp_path):
    read = load_path(table(tmp_path, "x,y,yaw,shoulder", "0,0,0,0", "0,0,0,2.00005"), cart)
    assert cart.space.to_coordinates(read.q)[1, 3] == 2.0
    assert any("shoulder" in note for note in read.notes)
    with refused(ConfigurationError, "p.csv:3:", "shoulder"):
        load_path(table(tmp_path, "x,y,yaw,shoulder", "0,0,0,0", "0,0,0,2.001"), cart)


@each(("values", "asked"), [(("0", "90"), True), (("-45", "30"), True), (("0", "2.5"), False)])
def test_degrees_are_asked_for(cart, tmp_path, values, asked):
    file = table(tmp_path, "x,y,yaw,shoulder", *(f"0,0,0,{v}" for v in values))
    with pytest.raises(ConfigurationError) as caught:
        load_path(file, cart)
    assert ("--angles" in str(caught.value)) is asked
    if asked:
        found = cart.space.to_coordinates(load_path(file, cart, angles="deg").q)[:, 3]
        np.testing.assert_allclose(found, np.radians([float(v) for v in values]))


@pytest.mark.parametrize("header", ["x,y,yaw,turntable", "x,y,turntable,yaw"])
def test_degrees_of_what_has_no_limits_are_doubted(cart, tmp_path, header):
    rows = [f"0,0,0,{10 * k}" for k in range(5)]
    file = table(tmp_path, header, *rows)
    assert len(load_path(file, cart).doubts) == 1
    assert load_path(file, cart, angles="rad").doubts == load_path(file, cart, angles="deg").doubts == ()
    assert load_path(table(tmp_path, header.replace("yaw", "yaw_rad").replace("table", "table_rad"), *rows), cart)


# --- tables as people write them -------------------------------------------------------------------------------------


@each(
    "text",
    [
        "\ufeffx,y,yaw,shoulder\n0,0,0,0\n1,0,0,0.5\n",
        '"x";"y";"yaw";"shoulder"\n0;0;0;0\n1;0;0;0,5\n',
        "x,y,yaw,shoulder,\n0,0,0,0,\n1,0,0,0.5,\n",
        "# x y yaw shoulder\n0 0 0 0\n1 0 0 0.5\n",
        "# made by hand\nx\ty\tyaw\tshoulder\r\n0\t0\t0\t0\r\n1\t0\t0\t0.5\r\n",
        ",x,y,yaw,shoulder\n0,0,0,0,0\n1,1,0,0,0.5\n",
    ],
)
def test_tables_as_people_write_them(cart, tmp_path, text):
    (tmp_path / "p.csv").write_text(text, newline="")
    read = load_path(tmp_path / "p.csv", cart)
    np.testing.assert_allclose(cart.space.to_coordinates(read.q)[:, [0, 3]], [[0, 0], [1, 0.5]])
    assert read.doubts == ()


@each(
    "text",
    [
        "x,y,yaw,yaw\n0,0,0,0\n1,0,0,0\n", "x,y,yaw,shoulder,shoulder_deg\n0,0,0,0,0\n1,0,0,0,0\n",
        "x,y,yaw,mast,mast\n0,0,0,0,0\n1,0,0,0,0\n", "x;y;yaw\n0,5;0.5;0\n1;0;0\n", "x;y;yaw\n0,5;0;0\n1;0.5;0\n",
        "x,y,yaw\n0,,0\n1,0,0\n", "x,y,yaw\n0,1_0,0\n1,0,0\n", "0,1,2,3,4,5\n0,0,0,0,0,0\n0,0,0,0,0,0\n",
        "x,y,yaw\n0,0,0,7\n1,0,0\n", ";;;\n;;;\n", "x,y,yaw\n0,0,१\n1,0,0\n", 'x,y,yaw\n"0,0,0\n1,0,0\n',
    ],
)  # fmt: skip
def test_tables_that_are_none_are_refused(cart, tmp_path, text):
    (tmp_path / "p.csv").write_text(text)
    with refused(ConfigurationError, "p.csv"):
        load_path(tmp_path / "p.csv", cart)


def test_a_key_that_is_given_twice_is_refused(panda, tmp_path):
    one, two = (json.dumps(trajectory(ARM, [arm(a), arm(a + 0.1)])) for a in (0.0, 1.0))
    (tmp_path / "p.json").write_text(f'{{"joint_trajectory": {one}, "joint_trajectory": {two}}}')
    with refused(ConfigurationError, "joint_trajectory"):
        load_path(tmp_path / "p.json", panda)


def test_what_is_written_has_no_doubts(cart, tmp_path):
    q = [cart.home(x=1.0), cart.home(x=2.0, yaw=1.0)]
    for name in ("a.csv", "a.json"):
        read = load_path(write_path(tmp_path / name, cart, q, [0.0, 1.0]), cart)
        assert read.doubts == read.time_doubts == read.notes == ()


def test_a_jump_of_more_than_half_a_turn_is_said(cart, tmp_path):
    read = load_path(table(tmp_path, "x,y,yaw,turntable", "0,0,0,3", "0,0,0,-3"), cart)
    assert any("turntable" in note for note in read.notes)
    back = load_path(table(tmp_path, "x,y,yaw,turntable", "0,0,0,3", "0,0,0,0"), cart)
    assert not any("turntable" in note for note in back.notes)


def test_an_archive_of_a_later_format_is_refused(cart, tmp_path):
    np.savez(tmp_path / "a.npz", q=np.zeros((3, 6)))
    data = bytearray((tmp_path / "a.npz").read_bytes())
    data[data.index(b"PK\1\2") + 6] = 215  # the version that is needed to unpack it
    (tmp_path / "a.npz").write_bytes(data)
    with refused(ConfigurationError, "a.npz"):
        load_path(tmp_path / "a.npz", cart)


# --- what is nearly known, and what lies beside the path -------------------------------------------------------------


@each(
    "names",
    [
        "baseX,baseY,baseYaw", "base::x,base::y,base::yaw", "base-x,base-y,base-yaw", "base[x],base[y],base[yaw]",
        "x_base,y_base,theta_base", "base_px,base_py,base_yaw", "tx,ty,rz", "base_trans_x,base_trans_y,base_rot_yaw",
        "root_x_axis_joint,root_y_axis_joint,root_z_rotation_joint", "v/trans_x,v/trans_y,v/rot_z",
        "robot1/base/x,robot1/base/y,robot1/base/theta", "x,y,psi",
    ],
)  # fmt: skip
def test_a_base_is_found_by_less_usual_names(cart, cart_file, tmp_path, names):
    file = table(tmp_path, f"{names},shoulder", "0,1,0.5,0.1", "2,1,0.7,0.2")
    np.testing.assert_allclose(
        cart.space.to_coordinates(load_path(file, cart).q)[:, :4], [[0, 1, 0.5, 0.1], [2, 1, 0.7, 0.2]], atol=1e-12
    )
    still = load_robot(cart_file, base="fixed", joints=["shoulder", "torso", "turntable"])
    stays = load_path(table(tmp_path, f"{names},shoulder", "2,1,0.7,0.1", "2,1,0.7,0.2"), still)
    assert verdict(still, stays) is Verdict.UNKNOWN


@each("name", ["yaw [°]", "yaw_deg", "yaw (deg)"])
def test_a_unit_of_other_letters_is_heeded(cart, tmp_path, name):
    read = load_path(table(tmp_path, f"x,y,{name}", "0,0,0", "0,0,90"), cart)
    assert cart.space.to_coordinates(read.q)[1, 2] == pytest.approx(np.pi / 2)


@each("name", ["-x", "x*1000", "x [1e-3 m]", "x_in"])
def test_what_is_done_to_a_coordinate_is_not_overlooked(cart, tmp_path, name):
    assert verdict(cart, load_path(table(tmp_path, f"{name},y,yaw", "0,0,0", "4,0,0"), cart)) is Verdict.UNKNOWN


@each(
    ("name", "value"),
    [
        ("Shoulder", 1.0), ("robot1/shoulder", 1.0), ("shoulder_position", 1.0), ("shoulder.pos", 1.0),
        ("ShoulderPan", 1.0), ("Gripper", 0.04), ("ns/gripper", 0.04), ("gripper_width", 0.04),
    ],
)  # fmt: skip
def test_a_joint_that_is_called_otherwise_is_doubted(cart, tmp_path, name, value):
    """It does not change, and is not where the robot has it: home, or where it is held."""
    read = load_path(table(tmp_path, f"x,y,yaw,{name}", f"0,0,0,{value}", f"1,0,0,{value}"), cart)
    assert verdict(cart, read) is Verdict.UNKNOWN
    assert name in read.doubts[0]
    assert load_path(table(tmp_path, f"x,y,yaw,{name}", "0,0,0,0", "1,0,0,0"), cart).doubts == ()
    beside = table(tmp_path, f"x,y,yaw,{name},shoulder,gripper", f"0,0,0,{value},0,0", f"1,0,0,{value},0,0")
    assert load_path(beside, cart).doubts == ()


def test_quaternions_in_columns_are_headings(cart, cart_file, tmp_path):
    names, part = "x,y,z,qx,qy,qz,qw", np.sqrt(0.5)
    good = table(tmp_path, names, "0,1,0,0,0,0,1", f"2,1,0,0,0,{part},{part}", f"2,1,0,0,0,{-part},{-part}")
    found = cart.space.to_coordinates(load_path(good, cart).q)[:, :3]
    np.testing.assert_allclose(found, [[0, 1, 0], [2, 1, np.pi / 2], [2, 1, np.pi / 2]], atol=1e-9)
    order = table(tmp_path, "base.orientation.w,base.orientation.z,x,y", f"{part},{part},0,1", f"{part},{part},2,1")
    np.testing.assert_allclose(cart.space.to_coordinates(load_path(order, cart).q)[:, 2], np.pi / 2, atol=1e-9)
    for bad in ("0,0,0,0,0,0,0", "0,0,0,1,0,0,0", "0,0,0,0,0,1,1", "0,0,0.3,0,0,0,1", "0,0,0,0.1,0,0,0.99499"):
        with refused(ConfigurationError, "p.csv:3:"):
            load_path(table(tmp_path, names, "0,0,0,0,0,0,1", bad), cart)
    still = load_robot(cart_file, base="fixed", joints=["shoulder"])
    turned = table(tmp_path, "qz,qw,shoulder", f"{part},{part},0", f"{part},{part},1")
    assert verdict(still, load_path(turned, still)) is Verdict.UNKNOWN
    with pytest.raises(ConfigurationError):
        load_path(table(tmp_path, "x,y,yaw,qz,qw", f"0,0,0,{part},{part}", f"1,0,0,{part},{part}"), cart)


@each("names", ["sec,nanosec", "secs,nsecs", "header.stamp.sec,header.stamp.nanosec"])
def test_times_in_two_columns(cart, tmp_path, names):
    rows = ("0,0,0,0,0", "0,900000000,1,0,0", "1,100000000,2,0,0")
    read = load_path(table(tmp_path, f"{names},x,y,yaw", *rows), cart)
    np.testing.assert_allclose(read.times, [0.0, 0.9, 1.1])
    assert read.doubts == read.time_doubts == ()


def test_two_clocks_that_go_otherwise(cart, world, tmp_path):
    same = load_path(table(tmp_path, "time,ros_time,x,y,yaw", "0,170,0,0,0", "1,171,1,0,0", "2,172,2,0,0"), cart)
    assert settled(cart, same, world)
    other = load_path(table(tmp_path, "time,stamp,x,y,yaw", "0,0,0,0,0", "1,50,1,0,0", "2,90,2,0,0"), cart)
    assert not settled(cart, other, world)
    assert verdict(cart, other) is Verdict.CERTIFIED


def test_a_stamp_later_than_0_counts_where_something_moves(panda, world, tmp_path):
    header = {"header": {"stamp": {"sec": 5, "nanosec": 0}, "frame_id": "map"}}
    file = message(tmp_path, {**header, **trajectory(ARM, [arm(0.0), arm(0.4)])})
    assert not settled(panda, load_path(file, panda), world)
    assert verdict(panda, load_path(file, panda)) is Verdict.CERTIFIED
    assert settled(panda, load_path(file, panda, starts_at=5.0), world)


def test_the_frame_of_a_base_and_its_one_joint(cart, panda, tmp_path):
    def driven(frame, name="world_joint"):
        base = {"header": {"frame_id": frame}, **moving([name], [transform()], [transform(x=1.0)])}
        return load_path(message(tmp_path, {"multi_dof_joint_trajectory": base}), cart)

    assert all(driven(frame).doubts == () for frame in ("", "map", "/world", "robot1/odom"))
    assert verdict(cart, driven("camera")) is verdict(cart, driven("base_link")) is Verdict.UNKNOWN
    np.testing.assert_allclose(driven("map", "wobbly").q[:, 0], [0.0, 1.0])  # no other can be meant
    for name, pose in (("wobbly", transform(x=2.0)), ("tool_joint", transform(turn=(0, 0, 1, 0)))):
        document = {
            "joint_trajectory": trajectory(ARM, [arm(0), arm(1)]),
            "multi_dof_joint_trajectory": moving([name], [pose], [pose]),
        }
        assert verdict(panda, load_path(message(tmp_path, document), panda)) is Verdict.UNKNOWN


@each(
    "beside",
    [
        {"path": {"poses": [{"pose": {"position": {"x": x, "y": 0.0}}} for x in (0, 4)]}},
        {"states": [{"name": ["gripper"], "position": [0.04]}]}, {"base_path": [[0, 0, 0], [4, 0, 0]]},
        {"robot_pose": {"position": {"x": 2.0, "y": 0.0, "z": 0.0}}}, {"base_pose": {"x": 2.0, "y": 0.0, "yaw": 0.0}},
    ],
)  # fmt: skip
def test_what_a_message_says_beside_its_trajectories(panda, tmp_path, beside):
    document = {"joint_trajectory": trajectory(ARM, [arm(0), arm(1)])}
    file = message(tmp_path, {"all": [document, beside]})
    read = load_path(file, panda)
    assert verdict(panda, read) is Verdict.UNKNOWN
    key = {"path": "poses"}.get(next(iter(beside)), next(iter(beside)))
    assert load_path(file, panda, ignore=[key]).doubts == ()


def test_names_and_numbers_in_further_arrays(cart, cart_file, tmp_path):
    rows = np.array([[0.0, 0, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0], [2, 0, 0, 0, 0, 0]])
    order = [3, 1, 2, 0, 4, 5]
    names = np.array(["x", "y", "yaw", "shoulder", "torso", "turntable"])[order]

    def read(robot=cart, **arrays):
        np.savez(tmp_path / "a.npz", **arrays)
        return load_path(tmp_path / "a.npz", robot)

    for key in ("joint_names", "names", "columns"):
        np.testing.assert_allclose(read(q=rows[:, order], **{key: names}).q[:, 0], [0, 1, 2])
    for beside in (
        {"gripper": np.full(3, 0.04)}, {"gripper": np.array(0.04)}, {"base_pose": np.array([2.0, 0.0])},
        {"waypoints": np.ones((7, 6))},
    ):  # fmt: skip
        assert verdict(cart, read(q=rows, **beside)) is Verdict.UNKNOWN
    np.testing.assert_allclose(read(q=rows, time_ns=np.array([0, 10**9, 2 * 10**9])).times, [0, 1, 2])
    assert read(q=rows, dt=np.array(0.1), gripper=np.zeros(3), x=rows[:, 0], cost=np.ones(2)).doubts == ()
    with pytest.raises(ConfigurationError):
        read(q=rows, x=rows[:, 0] + 1.0)
    turned = np.column_stack((rows[:, :2], np.ones(3), np.zeros((3, 3)), np.ones(3), np.zeros(3)))
    assert read(q=turned, Shoulder=np.ones(3)).doubts  # (cos, sin), which have no names
    still = load_robot(cart_file, base="fixed", joints=["shoulder", "torso", "turntable"])
    assert read(still, q=rows[:, 3:], base=np.array([2.0, 0.0])).doubts


def test_lengths_that_may_be_millimetres_are_doubted(cart, tmp_path):
    rows = ("0,0,0", "4000,0,0")
    assert len(load_path(table(tmp_path, "x,y,yaw", *rows), cart).doubts) == 1
    assert load_path(table(tmp_path, "x_m,y_m,yaw", *rows), cart).doubts == ()
    assert load_path(table(tmp_path, "x_mm,y_mm,yaw", *rows), cart).q[1, 0] == 4.0
    assert load_path(message(tmp_path, trajectory(("x", "y", "yaw"), [[0, 0, 0], [4000, 0, 0]])), cart).doubts == ()


@each(
    ("joints", "locked"),
    [
        (["shoulder", "torso", "turntable"], {"gripper": 0.03}),  # the file was compared with that gripper
        (["shoulder", "torso", "gripper"], {}),  # as many columns, of another joint
        (["shoulder", "torso", "turntable", "gripper"], {}),
    ],
)
@each("ask", [certify, prove, lambda robot, scene, path: path_digest(robot, path)])
def test_a_path_that_was_read_for_another_robot_is_refused(cart_file, cart, tmp_path, joints, locked, ask):
    other = load_robot(cart_file, base="omni", joints=joints, locked=locked)
    (tmp_path / "p.csv").write_text("x,y,yaw,shoulder,torso,gripper\n0,0,0,0,0.1,0.03\n1,0,0,0,0.1,0.03\n")
    path = load_path(tmp_path / "p.csv", other)
    assert ask(other, NOTHING, path)
    with pytest.raises(ConfigurationError, match=r"gripper|turntable"):
        ask(cart, NOTHING, path)


def test_what_is_the_same_robot_loaded_twice_or_with_a_load_takes_the_path(cart_file, cart, tmp_path):
    (tmp_path / "p.csv").write_text("x,y,yaw,shoulder\n0,0,0,0\n1,0,0,0\n")
    path = load_path(tmp_path / "p.csv", cart)
    again = load_robot(cart_file, base="omni", joints=["shoulder", "torso", "turntable"])
    for robot in (again, again.attached(Box((0.1, 0.1, 0.1), at=(0.0, 0.0, 0.4)), "arm")):
        assert certify(robot, NOTHING, path).certified


def test_a_strip_of_other_joints_is_refused(cart_file, cart):
    other = load_robot(cart_file, base="omni", joints=["shoulder", "turntable", "torso", "gripper"], locked={})
    few = load_robot(cart_file, base="omni", joints=["shoulder", "gripper", "turntable"])
    assert few.nq == cart.nq
    for robot in (few, other):
        with pytest.raises(ConfigurationError):
            certify(cart, NOTHING, Strip(robot, np.tile(robot.home_q, (2, 1))))


def test_joints_that_are_held_and_not_named_are_known(cart, tmp_path):
    (tmp_path / "p.csv").write_text("x,y,yaw,shoulder\n0,0,0,0\n1,0,0,0\n")
    held = load_path(tmp_path / "p.csv", cart).held
    assert set(held) == {"gripper", "right_wheel"}  # the left one is round
    (tmp_path / "p.csv").write_text("x,y,yaw,shoulder,gripper_mm,right_wheel\n0,0,0,0,0,0\n1,0,0,0,0,0\n")
    assert not load_path(tmp_path / "p.csv", cart).held


def test_the_answer_says_which_joints_are_at_home_as_the_path_does_not_say(cart, tmp_path):
    def of(columns: str, row: str) -> tuple[dict[str, float], str]:
        (tmp_path / "p.csv").write_text(f"{columns}\n0,0,0,{row}\n1,0,0,{row}\n")
        path = load_path(tmp_path / "p.csv", cart)
        found = certify(cart, NOTHING, path)
        assert found.certified
        return dict(path.at_home), found.reason

    still, said = of("x,y,yaw,shoulder", "0")
    assert set(still) == set(cart.joint_names) - {"shoulder"}
    assert all(name in said for name in list(still)[:3])
    still, said = of("x,y,yaw," + ",".join(cart.joint_names), ",".join("0" for _ in cart.joint_names))
    assert still == {}
    assert not any(name in said for name in cart.joint_names)


@each("kind", ["csv", "json", "npz"])
def test_velocities_are_said_to_be_left_out(panda, tmp_path, kind):
    """Who executes them goes by splines, and those leave the lines that are proven."""
    said = []
    for rates in (False, True):
        file = tmp_path / f"{rates}.{kind}"
        if kind == "csv":
            names = [*ARM, *(f"{name}_velocity" for name in ARM)][: 14 if rates else 7]
            row = ",".join(map(str, [*HOME, *[0.5] * 7][: len(names)]))
            file.write_text(f"{','.join(names)}\n{row}\n{row}\n")
        elif kind == "json":
            point = {"positions": HOME} | ({"velocities": [0.5] * 7} if rates else {"velocities": []})
            file.write_text(json.dumps({"joint_names": ARM, "points": [point, point]}))
        else:
            arrays = {"positions": np.tile(HOME, (2, 1)), "joint_names": np.array(ARM)}
            if rates:
                np.savez(
                    file,
                    velocities=np.full((2, 7), 0.5),
                    positions=arrays["positions"],
                    joint_names=arrays["joint_names"],
                )
            else:
                np.savez(file, positions=arrays["positions"], joint_names=arrays["joint_names"])
        path = load_path(file, panda)
        assert path.rates == rates
        said.append("splines" in certify(panda, NOTHING, path).reason)
    assert said == [False, True]


def test_a_column_that_moves_and_is_nearly_a_joints_asks_for_that(cart, tmp_path):
    (tmp_path / "p.csv").write_text("x,y,yaw,shuolde,turntable\n0,0,0,0,0\n1,0,0,0.5,0\n")
    (doubt,) = load_path(tmp_path / "p.csv", cart).doubts
    assert "'shoulder'" in doubt
    (tmp_path / "p.csv").write_text("x,y,yaw,lamp,turntable\n0,0,0,0,0\n1,0,0,0.5,0\n")
    (doubt,) = load_path(tmp_path / "p.csv", cart).doubts
    assert "lamp" in doubt
    assert not any(name in doubt for name in cart.joint_names)
