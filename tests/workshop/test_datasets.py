"""BARN, DynaBARN and bridge files: small ones made here load everywhere, the true ones where they are."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from brute_force import link_distances
from cases import each, refused
from shared_data import shared_data

from elastic_strips.errors import ParameterError, RobotError, ScenarioError
from elastic_strips.robot import load_robot
from elastic_strips.scene import Box, Cylinder
from workshop.datasets import barn_ids, dynabarn_ids, load_barn, load_bridge, load_dynabarn, load_house

BARN = {
    "cylinder_radius": 0.075, "cylinder_length": 1.0, "cylinder_center_z": 0.0, "goal_tolerance": 1.0, "timeout": 100.0,
    "worlds": [
        {
            "id": 6, "start": [-2.25, 3.0, 1.57], "goal": [-2.25, 13.0], "cylinders_xy": [[-1.0, 5.0], [-3.0, 6.5]],
            "path": [[-2.25, 3.0], [-2.25, 3.0], [-2.0, 8.0], [-2.0, 8.0], [-3.0, 9.0]], "path_length": 10.5,
        },
        {
            "id": 2, "start": [0, 0, 0], "goal": [4, 4], "cylinders_xy": [[2, 1]], "path": [[0, 0], [0, 0]],
            "path_length": 6.0,
        },
    ],
}  # fmt: skip
DYNABARN = {
    "cylinder_radius": 0.5, "cylinder_length": 1.0, "cylinder_center_z": 0.0, "goal_tolerance": 1.0, "timeout": 100.0,
    "worlds": [
        {
            "id": 3, "start": [11, 0, 3.14], "goal": [-9, 0], "difficulty": "easy",
            "walls": [{"name": "back", "pose": [-10.0, 0.0, 0.5, 0.0, 0.0, 1.0], "size": [0.5, 20.0, 1.0]}],
            "obstacles": [
                {"name": "disc", "period": 20.0, "keyframes": [[0, -8, -10], [10, 0, -4], [20, 8, 10]]},
                {"name": "round", "period": 4.0, "keyframes": [[0, 1, 1], [2, 3, 1], [4, 1, 1]]},
            ],
        }
    ],
}  # fmt: skip
BRIDGE = {
    "robot": {"max_joint_acc": 3.14},
    "start": {"xy": [-2, 1.5], "yaw_deg": 0, "arm_deg": [0, -90, 110, 0, -110, 0]},
    "goals": [{"xy": [2, 1.5], "yaw_deg": 0}, {"xy": [-2, 1.5], "yaw_deg": 180}],
    "boxes": [{"name": "deck", "size": [0.6, 1.5, 0.1], "position": [0.0, 0.0, 0.75]}],
}


@pytest.fixture
def folder(tmp_path):
    """A folder with the three files."""
    for name, document in (("barn_worlds", BARN), ("dynabarn_worlds", DYNABARN), ("bridge", BRIDGE)):
        (tmp_path / f"{name}.json").write_text(json.dumps(document), encoding="utf-8")
    return tmp_path


def test_a_barn_world(folder):
    """Every cylinder with its true shape; the path without repeated points; the goal's heading is the path's."""
    assert barn_ids(folder) == barn_ids(folder / "barn_worlds.json") == (2, 6)
    problem = load_barn(folder, 6)
    assert (problem.name, problem.robot, problem.heading_free) == ("barn-6", "jackal-box", True)
    assert (problem.goal_tolerance, problem.timeout, problem.path_length) == (1.0, 100.0, 10.5)
    assert (problem.start.x, problem.start.y, problem.start.yaw) == (-2.25, 3.0, 1.57)
    (goal,) = problem.goals
    assert (goal.x, goal.y) == (-2.25, 13.0)
    assert goal.yaw == pytest.approx(3 * math.pi / 4)
    np.testing.assert_array_equal(problem.path, [[-2.25, 3.0], [-2.0, 8.0], [-3.0, 9.0]])
    assert not problem.path.flags.writeable
    scene = problem.world.at(5.0)
    assert [type(o) for o in scene] == [Cylinder, Cylinder]
    for obstacle, at in zip(scene, BARN["worlds"][0]["cylinders_xy"], strict=True):
        assert obstacle.spec == {"radius": 0.075, "length": 1.0}
        np.testing.assert_array_equal(obstacle.pose[:3, 3], (*at, 0.0))
    assert load_barn(folder, 2).goals[0].yaw == pytest.approx(math.pi / 4)  # a path of one point says nothing


def test_a_dynabarn_world(folder):
    """Discs follow their keyframes by straight pieces and start anew after their period; walls stand where they are."""
    assert dynabarn_ids(folder) == (3,)
    problem = load_dynabarn(folder, 3)
    assert (problem.difficulty, problem.robot, problem.path) == ("easy", "jackal-box", None)
    assert (problem.goals[0].x, problem.goals[0].y, abs(problem.goals[0].yaw)) == (-9.0, 0.0, math.pi)
    world = problem.world
    assert world.names_moving == ("disc", "round")
    for t, at in [(0, (-8, -10)), (5, (-4, -7)), (15, (4, 3)), (20, (-8, -10)), (45, (-4, -7))]:
        disc = world.at(t).obstacle("disc")
        np.testing.assert_allclose(disc.pose[:3, 3], (*at, 0.0), atol=1e-12)
        assert disc.spec == {"radius": 0.5, "length": 1.0}
    assert world.speed_bound("disc", start=1, end=19) == pytest.approx(math.hypot(8, 14) / 10)
    assert world.speed_bound("disc", start=19, end=21) == math.inf  # it is back at once
    assert world.speed_bound("round", start=3, end=7) == pytest.approx(1.0)
    wall = world.at(0).obstacle("back")
    assert isinstance(wall, Box)
    np.testing.assert_array_equal(wall.spec["size"], (0.5, 20.0, 1.0))
    assert math.atan2(wall.pose[1, 0], wall.pose[0, 0]) == pytest.approx(1.0)
    later = load_dynabarn(folder, 3, begin=15.0).world
    for t in (0.0, 2.0, 4.9, 5.1, 30.0):
        for name in world.names_moving:
            now, then = later.at(t).obstacle(name), world.at(t + 15.0).obstacle(name)
            np.testing.assert_allclose(now.pose, then.pose, atol=1e-9)
    with refused(ParameterError, "begin=-1"):
        load_dynabarn(folder, 3, begin=-1.0)


def test_the_bridge(folder):
    """Boxes as they are; the arm's six angles at start and goals, in radians, by the robot's joint names."""
    problem = load_bridge(folder)
    assert problem.world.at(0).names == ("deck",)
    assert [round(math.degrees(v)) for v in problem.start.joints.values()] == [0, -90, 110, 0, -110, 0]
    assert [(g.x, g.y, round(math.degrees(g.yaw))) for g in problem.goals] == [(2, 1.5, 0), (-2, 1.5, 180)]
    assert all(goal.joints == problem.start.joints for goal in problem.goals)
    assert not problem.heading_free
    assert problem.limits == {"joint_acceleration": 3.14}


def _changed(document, *keys_and_value):
    """A copy of a document with one entry replaced, or deleted where the value is ...."""
    *keys, value = keys_and_value
    copy = json.loads(json.dumps(document))
    inner = copy
    for key in keys[:-1]:
        inner = inner[key]
    if value is ...:
        del inner[keys[-1]]
    else:
        inner[keys[-1]] = value
    return copy


BAD = [
    (lambda p: load_barn(p, 7), BARN, r"no world 7; 2 worlds have ids from 2 to 6, next to it 2, 6"),
    (lambda p: load_barn(p, 1), BARN, r"no world 1; 2 worlds have ids from 2 to 6, next to it 2"),
    (lambda p: load_barn(p, True), BARN, "id=True must be an integer"),
    (lambda p: load_barn(p, 2), {"worlds": []}, "the key 'cylinder_radius' is missing|holds no world"),
    (lambda p: load_barn(p, 2), [], r"must be a mapping, not a list of 0"),
    (lambda p: load_barn(p, 2), {**BARN, "worlds": 5}, "worlds: must be a list, not 5"),
    (lambda p: load_barn(p, 6), _changed(BARN, "worlds", 0, "start", [0, 0]), r"\[0\]\.start: .*list of 3 numbers"),
    (lambda p: load_barn(p, 6), _changed(BARN, "worlds", 0, "cylinders_xy", [[0, None]]), r"\[0\]\[1\]: .*not nothing"),
    (lambda p: load_barn(p, 6), _changed(BARN, "worlds", 0, "goal", [0, 1e9]), r"goal\[1\]: 1000000000.0 must be"),
    (lambda p: load_barn(p, 6), _changed(BARN, "worlds", 0, "goal", ...), "'goal' is missing; there are cylinders_xy"),
    (lambda p: load_barn(p, 6), _changed(BARN, "timeout", "long"), "timeout: must be a number, not 'long'"),
    (lambda p: load_barn(p, 6), _changed(BARN, "cylinder_radius", 0), r"cylinder_radius: 0 must be .* ≥ 0.001"),
    (lambda p: load_barn(p, 6), _changed(BARN, "worlds", 0, "id", "six"), r"worlds\[0\]\.id: must be an integer"),
    (lambda p: barn_ids(p), DYNABARN["worlds"], "must be a mapping"),
    (
        lambda p: load_dynabarn(p, 3),
        _changed(DYNABARN, "worlds", 0, "obstacles", 0, "period", 19.0),
        r"obstacles\[0\]: the period is 19.0 s, but the keyframes last 20 s",
    ),
    (
        lambda p: load_dynabarn(p, 3),
        _changed(DYNABARN, "worlds", 0, "obstacles", 1, "keyframes", [[0, 1, 1], [0, 2, 2], [4, 1, 1]]),
        r"obstacles\[1\]: .*increase strictly",
    ),
    (lambda p: load_dynabarn(p, 3), _changed(DYNABARN, "worlds", 0, "obstacles", 1, "name", "disc"), "both named"),
    (lambda p: load_dynabarn(p, 3), _changed(DYNABARN, "worlds", 0, "walls", 0, "pose", 3, 0.1), "stand upright"),
    (lambda p: load_dynabarn(p, 3), _changed(DYNABARN, "worlds", 0, "walls", 0, "size", 1, 0), r"walls\[0\]: Box size"),
    (lambda p: load_dynabarn(p, 3), _changed(DYNABARN, "worlds", 0, "difficulty", 3), "must be a non-empty string"),
    (lambda p: load_bridge(p), _changed(BRIDGE, "start", "arm_deg", [0, 1]), r"start\.arm_deg: .*list of 6 numbers"),
    (lambda p: load_bridge(p), _changed(BRIDGE, "goals", []), "goals: is empty"),
    (lambda p: load_bridge(p), _changed(BRIDGE, "robot", "max_joint_acc", 0), r"max_joint_acc: 0 must be"),
    (lambda p: load_bridge(p), _changed(BRIDGE, "goals", 1, "yaw_deg", "back"), r"goals\[1\]\.yaw_deg: .*number"),
    (lambda p: load_bridge(p), _changed(BRIDGE, "boxes", 0, "size", [0, 1, 1]), r"boxes\[0\]: Box size"),
]  # fmt: skip


@each("load, document, message", BAD)
def test_a_wrong_file_names_file_and_place(tmp_path, load, document, message):
    path = tmp_path / "made.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(ScenarioError, match=message) as caught:
        load(path)
    assert str(caught.value).startswith(str(path))


@each("content", [b"", b"{", b"[" * 100_000, b"NaN,"])
def test_what_is_no_json_is_refused(tmp_path, content):
    (tmp_path / "barn_worlds.json").write_bytes(content)
    with refused(ScenarioError, "barn_worlds.json:"):
        load_barn(tmp_path, 0)


def test_a_missing_file_is_named(tmp_path):
    for load in (lambda p: load_barn(p, 0), lambda p: load_dynabarn(p, 0), load_bridge):
        with refused(ScenarioError, "gone.json:"):
            load(tmp_path / "gone.json")
        with refused(ScenarioError, ".json"):
            load(tmp_path)


def test_the_true_barn_worlds_load():
    """150 worlds with the ids that their source states; every one of the official test set."""
    path = shared_data("barn", "barn_worlds.json")
    ids = barn_ids(path)
    assert len(ids) == 150
    assert {i % 6 for i in ids} == {0, 1, 2}
    official = [i for i in ids if i % 6 == 0]
    assert len(official) == 50
    for i in official[::10]:
        problem = load_barn(path, i)
        assert len(problem.world.scene) > 150
        assert problem.path is not None
        assert np.linalg.norm(problem.path[-1] - (problem.goals[0].x, problem.goals[0].y)) < 1e-9


def test_the_true_dynabarn_worlds_load():
    """40 arenas; the discs' speeds are those that their source states."""
    path = shared_data("dynabarn", "dynabarn_worlds.json")
    ids = dynabarn_ids(path)
    assert len(ids) == 40
    for i in ids:
        problem = load_dynabarn(path, i)
        assert 5 <= len(problem.world.names_moving) <= 24
        for name in problem.world.names_moving:
            speed = problem.world.speed_bound(name, start=0.0, end=1.0)
            assert 0.49 <= speed <= 1.95 or speed == math.inf


def test_the_true_bridge_loads(bridge_arm):
    """The robot that its file states can stand at start and goals."""
    problem = load_bridge(shared_data("bridge"))
    assert len(problem.world.scene) == 9
    configurations = problem.configurations(bridge_arm)
    np.testing.assert_allclose(configurations[0][4:], bridge_arm.home_q[4:], atol=1e-8)
    assert len(configurations) == 3


def test_the_true_house_gives_a_pair_for_each_seed(silvermate):
    """The same pair for the same seed; the robot stands free at both ends, by Pinocchio's own distances."""
    path = shared_data("house")
    problem, again, other = (load_house(path, silvermate, seed) for seed in (3, 3, 4))
    assert len(problem.world.scene) == 571
    assert (problem.start, problem.goals) == (again.start, again.goals)
    assert problem.start != other.start
    start, goal = problem.configurations(silvermate)
    assert np.hypot(*(goal[:2] - start[:2])) >= 3.0
    for q in (start, goal):
        assert link_distances(silvermate, problem.world.scene, q).min() >= 0.05 - 1e-4


def test_a_pair_of_the_house_is_not_on_two_sides_of_a_wall(silvermate, tmp_path):
    """Where a wall without a door goes through the ground, start and goal are on the same side of it."""
    corners = [[x, y, z] for x in (-0.1, 0.1) for y in (-4.0, 4.0) for z in (0.0, 1.0)]
    (tmp_path / "house.json").write_text(
        json.dumps({"inside": [[-4, -4], [4, 4]], "obstacles": [{"name": "wall", "vertices": corners}]})
    )
    for seed in range(8):
        problem = load_house(tmp_path, silvermate, seed)
        assert problem.start.x * problem.goals[0].x > 0.0


def test_a_house_needs_a_robot_that_moves(tmp_path):
    with refused(RobotError, "base", "'silvermate'", "fixed"):
        load_house(tmp_path, load_robot("silvermate", base="fixed"), 0)


def test_a_house_without_room_says_so(silvermate, tmp_path):
    corners = [[x, y, z] for x in (-9.0, 9.0) for y in (-9.0, 9.0) for z in (0.0, 1.0)]
    block = {"name": "block", "vertices": corners}
    (tmp_path / "house.json").write_text(json.dumps({"inside": [[-4, -4], [4, 4]], "obstacles": [block]}))
    with refused(ScenarioError, "'silvermate'"):
        load_house(tmp_path, silvermate, 0)
