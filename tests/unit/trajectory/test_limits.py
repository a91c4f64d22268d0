"""Motion limits: what the descriptions say, and what a motor's limits mean for the body."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from cases import each, refused
from drivable import limits_of

from elastic_strips.errors import ParameterError
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.trajectory.limits import MotionLimits

WHEELED = """<robot name="cart">
  <link name="base"><collision><geometry><box size="0.5 0.4 0.2"/></geometry></collision></link>
  {wheels}
  <link name="mast"><collision><geometry><box size="0.05 0.05 0.5"/></geometry></collision></link>
  <joint name="mast_joint" type="prismatic"><parent link="base"/><child link="mast"/><origin xyz="0 0 0.4"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="0.5" velocity="0.2" effort="10"/></joint>
</robot>"""
WHEEL = """<link name="{name}_link"><collision><origin rpy="1.5708 0 0"/><geometry>{shape}</geometry></collision></link>
  <joint name="{name}_joint" type="continuous"><parent link="base"/><child link="{name}_link"/>
    <origin xyz="{x} {y} 0.1"/><axis xyz="{axis}"/>{limit}</joint>"""


def cart(folder: Path, wheels: list[dict[str, str]]) -> RobotModel:
    usual = {"x": "0", "axis": "0 1 0", "limit": '<limit velocity="9" effort="5"/>'}
    usual["shape"] = '<cylinder radius="0.1" length="0.04"/>'
    path = folder / "cart.urdf"
    path.write_text(WHEELED.format(wheels="\n".join(WHEEL.format(**{**usual, **wheel}) for wheel in wheels)))
    return load_robot(path)


PAIR = [{"name": "wheel_left", "y": "0.25"}, {"name": "wheel_right", "y": "-0.25"}]


def test_silvermate(silvermate):
    limits = MotionLimits.for_robot(silvermate)
    assert limits.track == pytest.approx(0.4, abs=1e-12)
    assert limits.wheel_radius == pytest.approx(0.08)
    np.testing.assert_allclose(limits.drive_speed, [1.0, 1.0])
    np.testing.assert_allclose(limits.drive_acceleration, [1.2, 1.2])
    np.testing.assert_allclose(limits.joint_speed, [1.6, 1.6, 2.0, 2.0, 2.6, 2.6, 2.6])
    np.testing.assert_allclose(limits.joint_acceleration, 4.0)


def test_tiago(tiago):
    """Its wheels' joints are not planned, and their axes point along y only through the joints' placements."""
    limits = MotionLimits.for_robot(tiago, wheel_acceleration=0.9)
    assert limits.track == pytest.approx(0.4044)
    assert limits.wheel_radius == pytest.approx(0.0985)
    np.testing.assert_allclose(limits.drive_speed, 10.152284264 * 0.0985)
    np.testing.assert_allclose(limits.drive_acceleration, 0.9)
    assert limits.joint_speed[0] == pytest.approx(0.07)
    assert limits.joint_acceleration[0] == 1.0, "the lift slides"
    np.testing.assert_allclose(limits.joint_acceleration[1:], 4.0)


def test_omnidirectional_and_fixed_bases(rover, gantry):
    limits = limits_of(rover)
    assert (limits.drive_dim, limits.track, limits.wheel_radius) == (3, 0.0, 0.0)
    np.testing.assert_array_equal(limits.drive_speed, [1.0, 1.0, 1.5])
    np.testing.assert_array_equal(limits.drive_acceleration, [1.2, 1.2, 3.0])
    given = MotionLimits.for_robot(
        rover, joint_speed=0.5, base_speed=(2.0, 0.5, 1.0), base_acceleration=(1.0, 1.0, 1.0)
    )
    np.testing.assert_array_equal(given.drive_speed, [2.0, 0.5, 1.0])
    np.testing.assert_array_equal(given.joint_speed, 0.5)
    with refused(ParameterError, "entries"):
        MotionLimits.for_robot(rover, joint_speed=0.5, base_speed=(1.0, 1.0))
    fixed = limits_of(gantry)
    assert fixed.drive_dim == 0
    assert fixed.to_drive(np.zeros((5, 0))).shape == (5, 0)
    np.testing.assert_array_equal(fixed.to_tangent(np.arange(4.0)), np.arange(4.0))


def test_a_robot_without_joints(jackal_box):
    limits = MotionLimits.for_robot(jackal_box)
    assert limits.joint_speed.shape == (0,)
    np.testing.assert_array_equal(limits.speed, limits.drive_speed)


def test_a_rim_travels_what_its_wheel_rolls(silvermate, rng):
    """Along an arc: the length of the way of the point where a wheel stands, with the sign of its direction."""
    limits = MotionLimits.for_robot(silvermate)
    for _ in range(10):
        twist = np.array([rng.uniform(-1.0, 1.0), 0.0, rng.uniform(-2.0, 2.0)])
        v = np.zeros((2001, silvermate.nv))
        v[:, :3] = np.linspace(0.0, 1.0, 2001)[:, None] * twist
        rows = silvermate.space.integrate(np.zeros_like(v), v)
        for side, travel in zip((1.0, -1.0), limits.to_drive(twist), strict=True):
            place = rows[:, :2] + side * 0.2 * np.stack([-np.sin(rows[:, 2]), np.cos(rows[:, 2])], axis=1)
            steps = np.diff(place, axis=0)
            ahead = np.sign(steps[1000] @ [np.cos(rows[1000, 2]), np.sin(rows[1000, 2])])
            assert travel == pytest.approx(ahead * np.linalg.norm(steps, axis=1).sum(), abs=1e-6)


def test_drive_and_twist_are_inverse(silvermate, rover, rng):
    for limits, k in ((limits_of(silvermate), 2), (limits_of(rover), 3)):
        drive = rng.normal(size=(4, 5, k))
        np.testing.assert_allclose(limits.to_drive(limits.to_twist(drive)), drive, atol=1e-14)
        y = rng.normal(size=(6, k + len(limits.joint_speed)))
        np.testing.assert_allclose(limits.to_coordinates(limits.to_tangent(y)), y, atol=1e-14)
        np.testing.assert_array_equal(limits.to_tangent(y)[:, 3:], y[:, k:])


def test_scaled_and_frozen(silvermate):
    limits = MotionLimits.for_robot(silvermate)
    easy = limits.scaled(0.5, 0.25)
    np.testing.assert_allclose(easy.speed, 0.5 * limits.speed)
    np.testing.assert_allclose(easy.acceleration, 0.25 * limits.acceleration)
    assert (easy.track, easy.wheel_radius) == (limits.track, limits.wheel_radius)
    with refused(ValueError, "read-only"):
        limits.joint_speed[0] = 9.0
    with refused(ParameterError, "drive_speed"):
        limits.scaled(0.0, 1.0)


def test_given_wheels_need_no_description(silvermate, gantry_urdf):
    bare = RobotModel.from_pinocchio(silvermate.model, silvermate.collision_model, base="diff_drive")
    with refused(ParameterError, "wheel_speed=", "track=", "wheel_radius="):
        MotionLimits.for_robot(bare)
    limits = MotionLimits.for_robot(bare, wheel_speed=0.7, track=0.5, wheel_radius=0.1)
    np.testing.assert_allclose(limits.drive_speed, 0.7)
    assert limits.track == 0.5
    wheelless = load_robot(gantry_urdf, base="diff_drive")
    with refused(ParameterError, "*wheel*"):
        MotionLimits.for_robot(wheelless, joint_speed=1.0)


def test_wheels_of_a_description(tmp_path):
    limits = MotionLimits.for_robot(cart(tmp_path, PAIR))
    assert (limits.track, limits.wheel_radius) == (0.5, 0.1)
    np.testing.assert_allclose(limits.drive_speed, 0.9)
    assert limits.joint_acceleration.tolist() == [1.0]
    four = [
        {**wheel, "name": wheel["name"] + end, "x": x} for wheel in PAIR for end, x in (("_a", "0.2"), ("_b", "-0.2"))
    ]
    assert MotionLimits.for_robot(cart(tmp_path, four)).track == 0.5
    uneven = [PAIR[0], {**PAIR[1], "limit": '<limit velocity="7" effort="5"/>'}]
    np.testing.assert_allclose(MotionLimits.for_robot(cart(tmp_path, uneven)).drive_speed, 0.7)


def test_wheels_that_are_not_called_so(tmp_path):
    called = [{**wheel, "name": f"drivewhl_{side}_joint"} for wheel, side in zip(PAIR, "lr", strict=True)]
    limits = MotionLimits.for_robot(cart(tmp_path, called))
    assert (limits.track, limits.wheel_radius) == (0.5, 0.1)
    np.testing.assert_allclose(limits.drive_speed, 0.9)


def test_the_radius_of_a_mesh(tmp_path):
    trimesh.creation.cylinder(radius=0.12, height=0.03).export(tmp_path / "tyre.stl")
    mesh = '<mesh filename="tyre.stl" scale="0.5 0.5 0.5"/>'
    assert MotionLimits.for_robot(cart(tmp_path, [{**w, "shape": mesh} for w in PAIR])).wheel_radius == pytest.approx(
        0.06
    )


@each(
    "wheels, match",
    [
        ([PAIR[0]], "no two continuous"),
        ([PAIR[0], {**PAIR[1], "y": "-0.2"}], "no two continuous"),
        ([{**w, "axis": "1 0 0"} for w in PAIR], "no two continuous"),
        ([{**w, "limit": ""} for w in PAIR], "wheel_speed="),
        ([PAIR[0], {**PAIR[1], "shape": '<cylinder radius="0.2" length="0.04"/>'}], "radii"),
        ([{**w, "shape": '<box size="0.2 0.2 0.04"/>'} for w in PAIR], "radii"),
        ([*PAIR, {"name": "wheel_c", "y": "0.4"}, {"name": "wheel_d", "y": "-0.4"}], "several different pairs"),
    ],
)
def test_wheels_that_leave_a_doubt_are_asked_for(tmp_path, wheels, match):
    robot = cart(tmp_path, wheels)
    with pytest.raises(ParameterError, match=match):
        MotionLimits.for_robot(robot)
    assert MotionLimits.for_robot(robot, wheel_speed=1.0, track=0.5, wheel_radius=0.1).track == 0.5


def test_joints_without_a_speed_are_asked_for(gantry):
    with refused(ParameterError, "'spin'", "joint_speed="):
        MotionLimits.for_robot(gantry)
    limits = MotionLimits.for_robot(gantry, joint_speed={"spin": 3.0}, joint_acceleration={"bend": 7.0})
    np.testing.assert_array_equal(limits.joint_speed, [3.0 if n == "spin" else 1.0 for n in gantry.joint_names])
    expected = {"slide": 1.0, "bend": 7.0}
    np.testing.assert_array_equal(limits.joint_acceleration, [expected.get(n, 4.0) for n in gantry.joint_names])


def test_all_that_states_no_speed_is_named_at_once(tmp_path):
    """With what to write into the URDF, the arguments, and the options of the command line."""
    robot = cart(tmp_path, [{**w, "limit": ""} for w in PAIR])
    text = Path(robot.urdf_path).read_text().replace(' velocity="0.2"', ' velocity="1e9"')
    Path(robot.urdf_path).write_text(text)
    with pytest.raises(ParameterError) as problem:
        MotionLimits.for_robot(load_robot(robot.urdf_path))
    said = str(problem.value)
    for part in ("'mast_joint'", "'wheel_left_joint'", "'wheel_right_joint'", '<limit effort="…" velocity="…"/>',
                 "joint_speed={'mast_joint': …}", "wheel_speed=…",
                 "--joint-speed mast_joint=…", "--wheel-speed …"):  # fmt: skip
        assert part in said, said
    with pytest.raises(ParameterError) as problem:
        MotionLimits.for_robot(load_robot(robot.urdf_path), joint_speed={"mast_joint": 0.2})
    assert "mast_joint" not in str(problem.value)
    with pytest.raises(ParameterError) as problem:
        MotionLimits.for_robot(load_robot(robot.urdf_path), wheel_speed=0.5)
    assert "wheel" not in str(problem.value)


@each(
    "arguments, match",
    [
        ({"joint_speed": {"spim": 1.0}}, "did you mean 'spin'"),
        ({"joint_speed": float("nan")}, "joint_speed"),
        ({"joint_speed": -1.0}, "> 0"),
        ({"joint_speed": True}, "a finite number"),
        ({"joint_speed": 1.0, "joint_acceleration": {"bend": 0.0}}, "joint_acceleration"),
        ({"joint_speed": 1.0, "prismatic_acceleration": -1.0}, "joint_acceleration"),
    ],
)
def test_wrong_arguments(gantry, arguments, match):
    with pytest.raises(ParameterError, match=match):
        MotionLimits.for_robot(gantry, **arguments)


@each(
    "change, match",
    [
        ({"track": 0.0}, "track"),
        ({"wheel_radius": float("nan")}, "wheel_radius"),
        ({"drive_speed": [1.0]}, "drive"),
        ({"drive_acceleration": [1.0]}, "acceleration"),
        ({"joint_acceleration": [1.0]}, "joint"),
        ({"joint_speed": [[1.0]]}, "shape"),
        ({"joint_speed": ["fast"]}, "numbers"),
        ({"drive_speed": [1.0, np.inf]}, "finite"),
    ],
)
def test_limits_check_themselves(silvermate, change, match):
    limits = MotionLimits.for_robot(silvermate)
    fields = {name: getattr(limits, name) for name in MotionLimits.__dataclass_fields__}
    with pytest.raises(ParameterError, match=match):
        MotionLimits(**{**fields, **change})
