"""Robots as they come: files with trifles load with a warning, SRDFs of a whole family fit, names find their files."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from cases import each, refused
from scipy.spatial import ConvexHull

from elastic_strips.catalogue import find_robot, recorded_robot, robot_names
from elastic_strips.coal_shapes import convex_from_vertices
from elastic_strips.errors import ConfigurationError, RobotError
from elastic_strips.robot import load_robot
from elastic_strips.robot.reduced import carried_over, reduced_model

LIMIT = '<limit lower="-1.5" upper="1.5" velocity="1" effort="1"/>'


def link(name: str, geometry: str = '<sphere radius="0.05"/>', more: str = "") -> str:
    return f'<link name="{name}">{more}<collision><geometry>{geometry}</geometry></collision></link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", more: str = LIMIT) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.3 0 0.1"/><axis xyz="0 1 0"/>{more}</joint>'
    )


def write(folder: Path, text: str, name: str = "arm.urdf") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def chain(*more: str, base: str = "base") -> str:
    """base - shoulder - upper - elbow - lower - wrist - hand, and a grip beside the hand."""
    return (
        '<robot name="arm">' + link(base) + link("upper") + link("lower") + link("hand") + link("tip")
        + joint("shoulder", base, "upper") + joint("elbow", "upper", "lower") + joint("wrist", "lower", "hand")
        + joint("tip_joint", "hand", "tip", "fixed", "") + "".join(more) + "</robot>"
    )  # fmt: skip


def srdf(folder: Path, *elements: str) -> Path:
    return write(folder, '<robot name="arm">' + "".join(elements) + "</robot>", "arm.srdf")


def state(name: str, **values: object) -> str:
    joints = "".join(f'<joint name="{j}" value="{v}"/>' for j, v in values.items())
    return f'<group_state name="{name}" group="g">{joints}</group_state>'


@pytest.fixture
def warnings(caplog: pytest.LogCaptureFixture):
    def texts() -> list[str]:
        return [r.getMessage() for r in caplog.records if r.levelno >= logging.WARNING]

    caplog.set_level(logging.WARNING, logger="elastic_strips")
    return texts


# --- the file -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("base", ["fixed", "omni"])
def test_trifles_are_mended_and_said_once_with_names(tmp_path, base, warnings):
    """Nameless materials, a visual mesh that is missing, a mimic of nobody, −5e-20 kg m², a robot without a name."""
    sphere = '<geometry><sphere radius="0.1"/></geometry>'
    bad = [f"<visual>{sphere}<material/></visual>", '<visual><geometry><mesh filename="no.dae"/></geometry></visual>']
    inertia = '<inertia ixx="-5e-20" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    urdf = chain(
        link("finger", '<box size="0.1\t0.1\n0.1"/>', bad[0] + f'<inertial><mass value="1"/>{inertia}</inertial>'),
        link("thumb", more=bad[1]), joint("finger_joint", "hand", "finger"),
        joint("thumb_joint", "hand", "thumb", more=LIMIT + '<mimic joint="nobody"/>'),
    ).replace(' name="arm"', "", 1)  # fmt: skip
    robot = load_robot(write(tmp_path, urdf), base=base)
    assert robot.joint_names == ("shoulder", "elbow", "wrist", "finger_joint")
    assert {name for g in robot.geometries for name in g.links} == {
        "base",
        "upper",
        "lower",
        "hand",
        "tip",
        "finger",
        "thumb",
    }
    assert robot.visual_model.ngeoms == 1
    said = warnings()
    for words in (
        "<material> without a name",
        "cannot be read, not drawn: 'thumb'",
        "'thumb_joint'",
        "below 0 by rounding",
        "without a name, called: 'arm'",
    ):
        assert sum(words in text for text in said) == 1, (words, said)


def test_a_moment_of_inertia_below_0_is_still_refused(tmp_path):
    inertia = '<inertial><mass value="1"/><inertia ixx="-1e-3" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    with refused(RobotError, "ixx"):
        load_robot(write(tmp_path, chain(link("c", more=inertia), joint("cj", "hand", "c"))))


def test_a_collision_mesh_that_is_missing_is_refused(tmp_path):
    urdf = chain(link("c", '<mesh filename="package://gone/c.stl"/>'), joint("cj", "hand", "c"))
    with refused(RobotError, "found"):
        load_robot(write(tmp_path, urdf))


def test_a_package_url_without_a_package_is_found(tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes/c.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    urdf = chain(link("c", '<mesh filename="package:///meshes/c.obj"/>'), joint("cj", "hand", "c"))
    robot = load_robot(write(tmp_path, urdf))
    assert "c" in {name for g in robot.geometries for name in g.links}


def test_a_visual_mesh_that_is_damaged_is_noticed_when_it_is_drawn(tmp_path, warnings):
    """The collision geometry is drawn instead."""
    (tmp_path / "c.stl").write_bytes(b"no mesh at all, but some bytes of it")
    visual = '<visual><geometry><mesh filename="c.stl"/></geometry></visual>'
    robot = load_robot(write(tmp_path, chain(link("c", more=visual), joint("cj", "hand", "c"))))
    assert warnings() == []
    assert robot.visual_model.ngeoms == 6
    assert "collision geometry is drawn" in warnings()[0]


@each("base", ["fixed", "diff_drive"])
@each("locked", [{}, {"elbow": 0.4}, {"wrist": -0.3}])
def test_links_may_be_called_like_joints(tmp_path, base, locked):
    """Moving and fixed ones: all pieces sit where they do under names of their own."""
    plain = load_robot(write(tmp_path, chain()), base=base, locked=locked)
    text = chain()
    for old, new in (("upper", "shoulder"), ("lower", "elbow"), ("hand", "wrist"), ("tip", "tip_joint")):
        text = text.replace(f'link="{old}"', f'link="{new}"').replace(f'link name="{old}"', f'link name="{new}"')
    robot = load_robot(write(tmp_path, text), base=base, locked=locked)
    assert robot.joint_names == plain.joint_names
    assert [g.links for g in robot.geometries] == [("base",), ("shoulder",), ("elbow",), ("wrist",), ("tip_joint",)]
    for one, two in zip(robot.geometries, plain.geometries, strict=True):
        assert one.joint == two.joint
        np.testing.assert_allclose(one.placement, two.placement, atol=1e-15)


def test_the_reduced_geometry_is_that_of_pinocchio(tiago):
    """With a third of the joints held still at other values."""
    known = find_robot("tiago")
    model = pin.buildModelFromUrdf(str(known.urdf), pin.JointModelPlanar())
    shapes = pin.buildGeomFromUrdf(
        model, str(known.urdf), pin.COLLISION, package_dirs=[str(f) for f in known.package_dirs]
    )
    q, ids = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq)), list(range(2, model.njoints, 3))
    wanted_model, wanted = pin.buildReducedModel(model, shapes, ids, q)
    reduced = reduced_model(model, ids, q)
    assert list(reduced.names) == list(wanted_model.names)
    for one, two in zip(carried_over(model, reduced, shapes).geometryObjects, wanted.geometryObjects, strict=True):
        assert (one.name, one.parentJoint) == (two.name, two.parentJoint)
        assert reduced.frames[one.parentFrame].name == wanted_model.frames[two.parentFrame].name
        np.testing.assert_allclose(one.placement.homogeneous, two.placement.homogeneous, atol=1e-12)


@each("apexes", [[], [[0.0, 0.0, 0.4]], [[0.0, 0.0, 0.4], [0.0, 0.0, -0.3]]])
def test_a_hull_with_a_corner_of_many_neighbours_becomes_a_shape(apexes, rng):
    """A wheel with 600 corners a side, and cones: Coal takes them, all is inside, and distances are right."""
    turn = np.linspace(0.0, 2.0 * np.pi, 600, endpoint=False)
    ring = np.column_stack((0.3 * np.cos(turn), 0.3 * np.sin(turn), np.zeros(600)))
    points = np.vstack((ring, apexes)) if apexes else np.vstack((ring, ring + np.array([0, 0, 0.2])))
    shape = convex_from_vertices(points)
    hull = ConvexHull(np.asarray(shape.points()).reshape(-1, 3))
    assert (hull.equations[:, :3] @ points.T + hull.equations[:, 3:]).max() < 1e-9
    own = ConvexHull(points)
    assert (own.equations[:, :3] @ hull.points.T + own.equations[:, 3:]).max() < 2e-5
    for _ in range(50):
        to = rng.normal(size=3)
        at = 2.0 * to / np.linalg.norm(to)
        result = coal.DistanceResult()
        ball = coal.Transform3s(np.eye(3), at)
        distance = coal.distance(shape, coal.Transform3s(), coal.Sphere(0.1), ball, coal.DistanceRequest(True), result)
        normal = (at - result.getNearestPoint1()) / (distance + 0.1)
        assert (points @ normal).max() <= normal @ result.getNearestPoint1() + 1e-4


# --- the SRDF -----------------------------------------------------------------------------------------------------


def test_an_srdf_may_name_what_the_robot_has_not(tmp_path, warnings):
    """One warning for each kind, with the names; what it says about the rest holds."""
    path = write(tmp_path, chain())
    semantics = srdf(
        tmp_path, '<disable_collisions link1="base" link2="lower"/>', '<disable_collisions link1="eye" link2="lower"/>',
        '<virtual_joint name="world" type="floating" child_link="base"/>',
        state("ready", shoulder=0.3, toe=1, world="0 0 0 0 0 0 1"),
        '<group name="arm"><joint name="toe"/><joint name="elbow"/></group>',
    )  # fmt: skip
    robot = load_robot(path, base="fixed", srdf=semantics, group="arm")
    assert robot.joint_names == ("elbow",)
    assert robot.states == {"ready": {"shoulder": 0.3}}
    said = warnings()
    for words in (
        "links in <disable_collisions> that the robot does not have: 'eye'",
        "joints in <group_state> that the robot does not have: 'toe'",
        "joints in <group> that the robot does not have: 'toe'",
    ):
        assert sum(words in text for text in said) == 1, said
    assert not any("world" in text for text in said)


def test_named_states(tmp_path):
    """A state gives its joints, the rest is as at home; a cosine and a sine are an angle; a full turn is no error."""
    wide = '<limit lower="0.2" upper="6" velocity="1" effort="1"/>'
    path = write(
        tmp_path,
        chain(
            link("c"), link("d"), joint("dial", "hand", "c", "continuous", ""), joint("turn", "hand", "d", more=wide)
        ),
    )
    semantics = srdf(
        tmp_path, state("home", elbow=0.5), state("up", shoulder=-1.50004, dial="0 1", turn=-1.5), state("far", wrist=3)
    )
    robot = load_robot(path, base="omni", srdf=semantics)
    assert tuple(robot.states) == ("home", "up", "far")
    values = dict(zip(robot.joint_names, robot.space.to_coordinates(robot.state("up", 1.0, 2.0, 0.5))[3:], strict=True))
    assert values == pytest.approx(
        {"shoulder": -1.5, "elbow": 0.5, "wrist": 0.0, "dial": math.pi / 2, "turn": 2 * math.pi - 1.5}
    )
    np.testing.assert_allclose(robot.space.to_coordinates(robot.state("up", 1.0, 2.0, 0.5))[:3], [1.0, 2.0, 0.5])
    with refused(ConfigurationError, "state", "'upp'", "'up'"):
        robot.state("upp")
    with refused(ConfigurationError, "'wrist'"):
        robot.state("far")


@each(
    "states, home",
    [
        ((state("half_sitting", elbow=0.1), state("default", elbow=0.2)), 0.2),
        ((state("ready", elbow=0.3), state("half_sitting", elbow=0.1)), 0.1),
        ((state("ready", elbow=0.3),), 0.0),
        ((state("ready", shoulder=0, elbow=0.3, wrist=0),), 0.3),
        ((state("home", elbow=9), state("default", elbow=0.2)), 0.2),
    ],
)
def test_which_state_is_home(tmp_path, states, home):
    robot = load_robot(write(tmp_path, chain()), base="fixed", srdf=srdf(tmp_path, *states))
    assert dict(zip(robot.joint_names, robot.home_q, strict=True))["elbow"] == pytest.approx(home)


def test_home_does_not_collide_where_a_state_is_free(tmp_path, warnings):
    """With the elbow folded by 2.9 rad the hand is in the upper arm: the neutral posture takes over."""
    path = write(tmp_path, chain().replace('lower="-1.5" upper="1.5"', 'lower="-3" upper="3"'))
    pairs = '<disable_collisions link1="base" link2="tip"/>'
    robot = load_robot(path, base="fixed", srdf=srdf(tmp_path, state("home", elbow=2.9), pairs))
    folded = robot.home(elbow=2.9)
    assert robot.self_collision(folded) is not None
    assert robot.self_collision(robot.home()) is None
    np.testing.assert_allclose(robot.home_q, 0.0)
    (said,) = warnings()
    assert "in state 'home'" in said
    assert "home is the neutral posture" in said


# --- what is planned ----------------------------------------------------------------------------------------------

GROUPS = (
    '<group name="chain"><chain base_link="upper" tip_link="tip"/></group>'
    '<group name="links"><link name="upper"/><link name="tip"/></group>'
    '<group name="both"><group name="links"/><group name="chain"/></group>'
    '<group name="ring"><group name="ring"/><joint name="wrist"/></group>'
    '<group name="empty"/>'
)


@each(
    "group, planned",
    [
        ("chain", ("elbow", "wrist")),
        ("links", ("shoulder",)),
        ("both", ("shoulder", "elbow", "wrist")),
        ("ring", ("wrist",)),
    ],
)
def test_an_srdf_group_is_planned(tmp_path, group, planned):
    robot = load_robot(write(tmp_path, chain()), srdf=srdf(tmp_path, GROUPS, state("home", elbow=0.5)), group=group)
    assert robot.joint_names == planned
    assert robot.locked == {
        j: (0.5 if j == "elbow" else 0.0) for j in ("shoulder", "elbow", "wrist") if j not in planned
    }


def test_joints_to_plan(tmp_path):
    path = write(tmp_path, chain())
    assert load_robot(path, joints=["wrist", "shoulder"]).joint_names == ("shoulder", "wrist")
    robot = load_robot(path, joints=["wrist"], locked={"elbow": 0.7})
    assert robot.locked == {"elbow": 0.7, "shoulder": 0.0}
    for options, words in (
        ({"joints": ["wrist"], "locked": {"wrist": 0.1}}, "planned and locked: wrist"),
        ({"joints": ["rist"]}, "'rist'; did you mean 'wrist'"),
        ({"joints": ["tip_joint"]}, "'tip_joint' is fixed"),
        ({"joints": "wrist"}, "one text"),
        ({"joints": ["wrist"], "group": "g"}, "give one of them"),
        ({"group": "g"}, "no SRDF"),
        ({"group": "chian", "srdf": srdf(tmp_path, GROUPS)}, "did you mean 'chain'"),
        ({"group": "empty", "srdf": srdf(tmp_path, GROUPS)}, "no joint that can be planned"),
    ):
        with pytest.raises(RobotError, match=words):
            load_robot(path, **options)


def test_many_planned_joints_are_warned_about(tmp_path, warnings):
    more = "".join(link(f"l{k}") + joint(f"j{k}", f"l{k - 1}" if k else "hand", f"l{k}") for k in range(20))
    path = write(tmp_path, chain(more))
    disabled = "".join(f'<disable_collisions link1="l{k}" link2="hand"/>' for k in range(20))
    load_robot(path, srdf=srdf(tmp_path, disabled), joints=[f"j{k}" for k in range(20)])
    assert not any("plans" in text for text in warnings())
    load_robot(path, srdf=srdf(tmp_path, disabled))
    assert sum("plans 23 joints" in text for text in warnings()) == 1


def test_joint_values_outside_by_rounding_are_taken_to_the_limit(tmp_path):
    robot = load_robot(write(tmp_path, chain()), base="omni")
    high, low = robot.home(elbow=1.5), robot.home(shoulder=-1.5)
    near_high, near_low = high.copy(), low.copy()
    near_high[5] += 5e-5
    near_low[4] -= 5e-5
    np.testing.assert_array_equal(robot.check_q(near_high), high)
    np.testing.assert_array_equal(robot.check_q([near_high, near_low]), [high, low])
    np.testing.assert_array_equal(robot.home(elbow=1.50005), high)
    assert near_high[5] > 1.5  # the caller's own is left alone
    near_high[5] = 1.5002
    with refused(ConfigurationError, "limits"):
        robot.check_q(near_high)


# --- names --------------------------------------------------------------------------------------------------------


def test_robots_of_example_robot_data_by_name():
    assert find_robot("panda").base == "fixed"
    assert find_robot("tiago_pro").base == "omni"
    assert find_robot("panda").srdf.name == "panda.srdf"
    assert find_robot("anymal_c_simple").urdf.name == "anymal.urdf"
    assert find_robot("xarm").name == "xarm7"  # alone in its folder
    with refused(RobotError, "'anymal'", "anymal_b_simple", "anymal_c_simple"):
        load_robot("anymal")
    with refused(RobotError, "'panada'", "'panda'"):
        load_robot("panada")


def test_a_recorded_robot_is_not_mistaken_for_a_named_one(tmp_path):
    """A file of one's own may be called like a robot that has a name."""
    own, mine = str(find_robot("panda").urdf), write(tmp_path, chain(), "panda.urdf")
    assert recorded_robot("panda", own) == "panda"
    assert recorded_robot("panda", "/another/machine/panda.urdf") == "panda"
    assert recorded_robot("panda", str(mine)) == str(mine)
    assert recorded_robot("mine", str(mine)) == str(mine)


def test_panda_stands_at_its_default_state():
    robot = load_robot("panda")
    assert robot.self_collision(robot.home()) is None
    np.testing.assert_array_equal(robot.home(), robot.state("default"))
    assert load_robot("panda", group="arm").nv == 7


NOTHING = "has no <link>|no collision geometry"
REFUSED = {"ur3", "TwoDofs", "human", "simple_humanoid_classical", "alexander_v1.lowerBodyOnly"}
"""Without a link, or without collision geometry."""
SLOW = {
    *("tiago", "tiago_no_hand", "tiago_dual", "tiago_pro", "g1_29dof_rev_1_0", "g1_29dof_with_hand_rev_1_0", "so101"),
    *("romeo", "romeo_small", "anymal-kinova", "b1-z1", "z1", "alex_nub_hands", "alex_psyonic_hands", "kinova", "iris"),
    *(
        "alex_sake_hands",
        "talos_full_v2_box",
        "talos_reduced",
        "talos_reduced_box",
        "talos_reduced_corrected",
        "solo12",
    ),
    *("hextilt_flying_arm_5", "icub", "anymal_b_simple", "solo", "ur3_robot", "laikago", "a1"),
    *("ur10_joint_limited_robot", "ur3_joint_limited_robot", "allegro_right_hand", "icub_reduced", "double_pendulum"),
}
"""More than a second to load, or the like of another; ``python -m workshop robots`` loads them all."""


NAMES = sorted(set(robot_names()) - SLOW)


@each("name", NAMES, ids=NAMES)
def test_the_robots_of_example_robot_data_load(name):
    """All but those without links or collision geometry; Centauro has a hull with a corner of too many neighbours."""
    if name in REFUSED:
        with pytest.raises(RobotError, match=NOTHING):
            load_robot(name)
    else:
        robot = load_robot(name)
        assert len(robot.geometries) > 0
        assert np.isfinite(robot.home()).all()
