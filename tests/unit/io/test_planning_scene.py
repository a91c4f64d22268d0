"""MoveIt's planning scenes: what the robot holds, frames, operations, what is said and what is refused."""

from __future__ import annotations

import json
import logging

import numpy as np
import pytest
from cases import each, refused

import elastic_strips as es
from elastic_strips.errors import ConfigurationError, RobotError, SceneError
from elastic_strips.io import read_scene, read_scene_file
from elastic_strips.io.planning_message import load_message, planning_scene_of
from elastic_strips.io.planning_scene import PlanningScene
from elastic_strips.robot import RobotModel
from elastic_strips.scene.quantities import quaternion_of


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, quat: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)) -> dict:
    at, turn = {"x": x, "y": y, "z": z}, dict(zip("xyzw", quat, strict=True))
    return {"position": at, "orientation": turn}


def transform(parent: str, child: str, x: float) -> dict:
    turn = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    at = {"x": x, "y": 0.0, "z": 0.0}
    return {"header": {"frame_id": parent}, "child_frame_id": child, "transform": {"translation": at, "rotation": turn}}


def box(name: str, frame: str = "world", at: dict | None = None, **more: object) -> dict:
    shape = {"primitives": [{"type": 1, "dimensions": [0.2, 0.2, 0.2]}], "primitive_poses": [pose()]}
    return {"id": name, "header": {"frame_id": frame}, "pose": at or pose(), **shape, "operation": 0, **more}


def held(frame: str = "panda_hand", **more: object) -> dict:
    bar = {"primitives": [{"type": 1, "dimensions": [0.04, 0.6, 0.04]}], "primitive_poses": [pose(z=0.13)]}
    thing = {"id": "bar", "header": {"frame_id": frame}, "pose": pose(), **bar, "operation": 0}
    touch = ["panda_leftfinger", "panda_rightfinger", "nobody"]
    return {"link_name": "panda_hand", "object": thing, "touch_links": touch, "weight": 0.3, **more}


def write(folder, *objects: dict, attached: tuple[dict, ...] = (), name: str = "scene.json", **more: object):
    state = {"attached_collision_objects": list(attached), **more.pop("state", {})}
    document = {"robot_state": state, "world": {"collision_objects": list(objects)}, **more}
    path = folder / name
    path.write_text(json.dumps(document))
    return path


def read_planning_scene(path, **options: str) -> PlanningScene:
    return planning_scene_of(load_message(path), **options)


POST = pose(0.31, 0.33, 0.46)
"""Beside the hand of the Panda at home, where a bar in it ends."""


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return es.load_robot("panda")


def test_what_the_robot_holds_is_part_of_it(tmp_path, panda, caplog):
    """A bar in the hand hits what the hand alone passes."""
    path = write(tmp_path, box("post", at=POST), attached=(held(),))
    found = read_scene_file(path, robot=panda)
    scene = found.world.at(0.0)
    assert scene.names == ("post",)
    (thing,) = found.held[0].attached
    assert (thing.name, thing.link, thing.touch[0], thing.weight) == ("bar", "panda_hand", "panda_leftfinger", 0.3)
    q = panda.home()
    stands = [q, q]
    assert es.certify(panda, scene, stands).certified
    with caplog.at_level(logging.WARNING):
        whole = found.held_by(panda)
    assert "nobody" in caplog.text  # a link that the robot has not
    assert "bar" in {link for piece in whole.geometries for link in piece.links}
    answer = es.certify(whole, scene, stands)
    assert not answer.certified
    assert answer.broken is not None
    assert answer.broken.obstacle == "post"
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        assert read_scene(path).names == ("post",)
    assert "bar (at panda_hand)" in caplog.text


def test_what_is_held_may_be_given_in_another_frame(tmp_path, panda):
    """In the world, with the state that it is taken up in; or as an object of the world that is taken up."""
    q = panda.home()
    names = list(panda.joint_names)
    T = panda.frame_pose(q, "panda_hand")
    at = pose(*T[:3, 3].tolist(), quat=tuple(quaternion_of(T[:3, :3]).tolist()))
    state = {"joint_state": {"name": names, "position": q.tolist()}}
    usual = held()
    in_hand = read_planning_scene(write(tmp_path, attached=(usual,))).held_by(panda)
    placed = held("world")
    placed["object"]["pose"] = at
    in_world = read_planning_scene(write(tmp_path, box("table"), attached=(placed,), state=state)).held_by(panda)
    taken = {**usual["object"], "header": {"frame_id": "world"}, "pose": at}
    named = {**usual, "object": {"id": "bar", "header": {"frame_id": "world"}}}
    message = read_planning_scene(write(tmp_path, taken, attached=(named,), state=state))
    assert not message.scene.names
    for other in (in_world, message.held_by(panda)):
        for one, two in zip(in_hand.geometries, other.geometries, strict=True):
            np.testing.assert_allclose(one.placement, two.placement, atol=1e-9)
    with refused(RobotError, "robot_state"):
        read_planning_scene(write(tmp_path, box("table"), attached=(placed,))).held_by(panda)


def test_what_cannot_be_held_is_refused(tmp_path, panda):
    with refused(SceneError, "'bar'"):
        read_planning_scene(write(tmp_path, attached=(held(object={"id": "bar"}),)))
    plane = {"id": "bar", "planes": [{"coef": [0, 0, 1, 0]}], "plane_poses": [pose()]}
    with refused(SceneError, "plane"):
        read_planning_scene(write(tmp_path, attached=(held(object=plane),)))
    with refused((RobotError, ConfigurationError), "gripper"):
        read_planning_scene(write(tmp_path, attached=(held("gripper", link_name="gripper"),))).held_by(panda)


def test_what_is_held_is_not_in_the_world_as_well(tmp_path):
    """As MoveIt has it, which takes an object of that name out of the world."""
    bar = {**held()["object"], "header": {"frame_id": "world"}, "pose": pose(3.0)}
    message = read_planning_scene(write(tmp_path, bar, box("table"), attached=(held(),)))
    assert message.scene.names == ("table",)
    assert [thing.name for thing in message.attached] == ["bar"]


@each("operation", [1, "\x01", 3])
def test_what_is_let_go_of_is_not_held(tmp_path, operation):
    thing = {**held()["object"], "operation": operation}
    with refused(SceneError, "bar"):
        read_planning_scene(write(tmp_path, attached=(held(object=thing),)))


def test_a_scene_in_a_frame_of_the_robot_stands_where_that_is(tmp_path, panda):
    """A frame that moves with the robot is not the world: it is where the robot stood, or is refused, or is said."""
    q = panda.home()
    T = panda.frame_pose(q, "panda_hand")
    path = write(tmp_path, box("a", "panda_hand", pose(z=0.3)), attached=(held("panda_link0"),), state={})
    with refused(SceneError, "panda_hand"):
        read_scene(path, robot=panda)
    found = read_scene_file(path, robot=panda, q=q)
    np.testing.assert_allclose(found.world.scene.obstacle("a").pose[:3, 3], (T @ [0, 0, 0.3, 1])[:3], atol=1e-9)
    said = read_scene(path, robot=panda, options={"at": (1.0, 2.0, 3.0)})
    np.testing.assert_allclose(said.obstacle("a").pose[:3, 3], [1, 2, 3.3], atol=1e-9)
    rooted = read_scene(write(tmp_path, box("a", "panda_link0", pose(1.0))), robot=panda)
    np.testing.assert_allclose(rooted.obstacle("a").pose[:3, 3], [1, 0, 0], atol=1e-9)


def test_frames_that_hang_on_each_other(tmp_path, caplog):
    """On a transform that is listed later, on an object, on a subframe of one; an unknown one is refused."""
    frames = [transform("shelf", "bin", 10.0), transform("map", "shelf", 100.0)]
    holder = box("holder", "bin", pose(1.0), subframe_names=["tip"], subframe_poses=[pose(y=5.0)])
    path = write(
        tmp_path, holder, box("on", "holder", pose(z=2.0)), box("at", "holder/tip", pose(z=3.0)), box("in", "/map"),
        fixed_frame_transforms=frames,
    )  # fmt: skip
    scene = read_scene(path)
    places = {o.name: o.pose[:3, 3].tolist() for o in scene}
    assert places == {"holder": [111, 0, 0], "on": [111, 0, 2], "at": [111, 5, 3], "in": [0, 0, 0]}
    with pytest.raises(SceneError, match=r"'gripper'.*collision_objects|collision_objects.*'gripper'"):
        read_scene(write(tmp_path, box("lost", "gripper"), fixed_frame_transforms=frames))
    with refused(SceneError, "'odom'"):
        read_scene(write(tmp_path, box("one", "map"), box("two", "odom")))
    ring = [transform("a", "b", 1.0), transform("b", "a", 1.0), transform("map", "c", 0.0)]
    with refused(SceneError, "itself"):
        read_scene(write(tmp_path, box("one", "map"), fixed_frame_transforms=ring))
    with caplog.at_level(logging.WARNING):
        read_scene(write(tmp_path, box("one", "base_link")))
    assert "base_link" in caplog.text


@pytest.mark.parametrize("bytes_as_text", [False, True])
def test_operations_are_done_one_after_the_other(tmp_path, bytes_as_text):
    """As ROS 1 prints a byte, and as ROS 2 does."""

    def does(number: int) -> dict:
        return {"operation": chr(number) if bytes_as_text else number}

    moved = {"id": "a", "header": {"frame_id": "world"}, "pose": pose(7.0), **does(3)}
    path = write(
        tmp_path, box("a", at=pose(1.0)), box("b", at=pose(2.0)), box("a", at=pose(4.0), **does(2)), moved,
        {"id": "b", **does(1)}, box("c", at=pose(5.0)), box("c", at=pose(6.0), **does(0)),
    )  # fmt: skip
    scene = read_scene(path)
    places = {o.name: o.pose[0, 3] for o in scene}
    assert places == {"a-1": pytest.approx(7.0), "a-2": pytest.approx(10.0), "c": pytest.approx(6.0)}
    with refused(SceneError, "'b'"):
        read_scene(write(tmp_path, {**moved, "id": "b"}))


def test_what_is_not_taken_over_is_said(tmp_path, caplog):
    matrix = {"entry_names": ["floor", "panda_link0"], "entry_values": [{"enabled": [True, True]}] * 2}
    path = write(
        tmp_path, box("floor"), allowed_collision_matrix=matrix, is_diff=True, object_colors=[{"id": "floor"}],
        link_padding=[{"link_name": "panda_hand", "padding": 0.02}], link_scale=[{"link_name": "x", "scale": 1.0}],
        surprise=[1],
    )  # fmt: skip
    with caplog.at_level(logging.WARNING):
        read_scene(path)
    for what in ("floor", "is_diff", "1 colours", "0.02", "surprise"):
        assert what in caplog.text
    assert "scale" not in caplog.text
    caplog.clear()
    usual = {"default_entry_names": ["lamp", ["no", "name"]], "default_entry_values": [True, True]}
    with caplog.at_level(logging.WARNING):
        read_scene(write(tmp_path, box("lamp"), allowed_collision_matrix=usual))
    assert "lamp" in caplog.text


def test_the_answer_of_a_service_and_a_world_alone(tmp_path):
    whole = json.loads(write(tmp_path, box("a")).read_text())
    for document in (whole, {"scene": whole}, whole["world"]):
        for text, name in ((json.dumps(document), "s.json"), (json.dumps(document) + "\n---\n", "s.yaml")):
            (tmp_path / name).write_text(text)
            assert read_scene(tmp_path / name).names == ("a",)


BAD = [
    (box("a", primitives=[{"type": 7, "dimensions": [1]}]), "type"),
    (box("a", primitives=[{"type": 3, "dimensions": [1]}]), "dimensions"),
    (box("a", primitives=[{"type": 1, "dimensions": [1, 1, "..."]}]), "dimensions"),
    (box("a", primitives=[{"type": 1, "dimensions": [1, 0, 1]}]), "size"),
    (box("a", pose=pose(quat=(0, 0, 0, 2))), "orientation"),
    (box("a", pose=pose(quat=(0, 0, 0, float("nan")))), "orientation"),
    (box("a", primitive_poses=[pose(), pose()]), "primitive_poses"),
    (box("a", operation=9), "operation"),
    (box("", operation=0), "id"),
    ({"header": {"frame_id": "world"}}, "id"),
    (box("a", meshes=[{"vertices": [], "triangles": []}], mesh_poses=[pose()]), "meshes"),
    (box("a", planes=[{"coef": [0, 0, 0, 1]}], plane_poses=[pose()]), "coef"),
    (box("a", subframe_names=["x"], subframe_poses=[]), "subframe"),
]


@each(("thing", "key"), BAD)
def test_what_does_not_fit_is_refused_with_its_key(tmp_path, thing, key):
    with pytest.raises(SceneError, match=rf"scene\.json: .*{key}"):
        read_scene(write(tmp_path, thing))


def test_an_octomap_of_a_message_is_whole_or_refused(tmp_path):
    path = write(tmp_path, box("a"))
    document = json.loads(path.read_text())
    tree = {"header": {"frame_id": ""}, "binary": True, "id": "OcTree", "resolution": 0.1, "data": [2, 0]}
    document["world"]["octomap"] = {"header": {"frame_id": "world"}, "origin": pose(1.0), "octomap": tree}
    path.write_text(json.dumps(document))
    scene = read_scene(path)
    assert scene.names == ("a", "octomap")
    tree["data"] = [2, 0, "..."]  # what ROS 2 prints of long arrays
    path.write_text(json.dumps(document))
    with refused(SceneError, "full-length"):
        read_scene(path)
    for key in ("binary", "id", "resolution"):
        document["world"]["octomap"]["octomap"] = {k: v for k, v in {**tree, "data": [2, 0]}.items() if k != key}
        path.write_text(json.dumps(document))
        with pytest.raises(SceneError, match=f"'{key}' is missing"):
            read_scene(path)
    document["world"]["octomap"]["octomap"] = tree
    tree["data"] = [3, 0, 1]
    path.write_text(json.dumps(document))
    with pytest.raises(SceneError, match="ends after"):
        read_scene(path)


@each(("frame", "known"), [("camera_link", False), ("odom", True), ("robot1/map", True)])
def test_a_frame_that_is_nowhere_is_refused_of_a_robot(tmp_path, panda, frame, known):
    path = write(tmp_path, box("a", frame, pose(1.0)))
    if known:
        assert len(read_scene(path, robot=panda)) == 1
    else:
        with pytest.raises(SceneError, match=frame):
            read_scene(path, robot=panda)
    placed = read_scene(path, robot=panda, options={"at": (0.0, 2.0, 0.0)})
    np.testing.assert_allclose(placed.obstacle("a").pose[:3, 3], [1, 2, 0], atol=1e-9)
