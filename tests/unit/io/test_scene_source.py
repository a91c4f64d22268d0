"""Sources of scenes: several in one, poses, heights, clouds without the robot, units, maps and what is outside."""

from __future__ import annotations

import json
import logging
import math

import coal
import numpy as np
import pinocchio as pin
import pytest
from cases import each, refused

import elastic_strips as es
from elastic_strips.collision import prove
from elastic_strips.errors import ScenarioError, SceneError
from elastic_strips.io import (
    PointCloud,
    load_nav2_map,
    read_octomap,
    read_point_cloud,
    read_scenario,
    read_scene,
    read_scene_file,
    read_world,
    without_robot,
)
from elastic_strips.io.nav2_map import WALL_HEIGHT, MapArea, outside_of
from elastic_strips.robot.reach import highest_reach
from elastic_strips.sim.scenarios import get_scenario

MAP = "image: m.pgm\nresolution: 0.5\norigin: [-2, -2, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
TABLE = "room\n* table\n1\nbox\n1 1 1\n2 0 0.5\n0 0 0 1\n0 0 0 0\n.\n"


@pytest.fixture
def folder(tmp_path):
    """A map of 8 × 8 cells with a wall, a MoveIt scene, a cloud, and a scene file with something that moves."""
    pixels = np.full((8, 8), 254, np.uint8)
    pixels[:, 6] = 0
    (tmp_path / "m.pgm").write_bytes(b"P5\n8 8\n255\n" + pixels.tobytes())
    (tmp_path / "m.yaml").write_text(MAP)
    (tmp_path / "t.scene").write_text(TABLE)
    (tmp_path / "c.xyz").write_text("0 0 0.01\n1 0 0.5\n1 0 2.9\n")
    moves = "{shape: sphere, name: ball, radius: 0.2, at: [1, 0, 0], appears: 1, motion: {twist: {linear: [1, 0, 0]}}}"
    (tmp_path / "own.yaml").write_text(f"obstacles:\n- {moves}\n")
    return tmp_path


def top(scene: es.Scene, name: str = "map") -> float:
    rows = np.flatnonzero(scene.table.obstacle_index == scene.names.index(name))
    return float((scene.table.center + scene.table.half_extents)[rows, 2].max())


def test_several_sources_are_one_scene(folder):
    text = """sources:
- m.yaml
- {file: t.scene, at: [0, 1, 0]}
- {file: t.scene, at: [0, 2, 0], rpy: [0, 0, 0.3]}
- {file: c.xyz, voxel: 0.1, low: 0.1, high: 2.0}
- {file: own.yaml, at: [0, 0, 1, 1.5707963267948966]}
obstacles:
- {shape: box, name: map, size: [1, 1, 1]}
"""
    (folder / "all.yaml").write_text(text)
    world = read_world(folder / "all.yaml")
    names = world.scene.names
    assert names[:6] == ("map", "map-2", "table", "table-2", "cloud", "ball")
    assert len(names) == 10  # and the four boxes around the map
    assert world.scene.obstacle("table-2").pose[:3, 3] == pytest.approx([2 * math.cos(0.3), 2 + 2 * math.sin(0.3), 0.5])
    assert dict(world.appears) == {"ball": 1.0}
    assert world.at(2.0).obstacle("ball").pose[:3, 3] == pytest.approx([0.0, 3.0, 1.0])
    assert world.scene.obstacle("cloud").spec["centers"].shape == (1, 3)
    together = read_scene([folder / "m.yaml", folder / "t.scene"], options={"low": 0.2, "high": 1.0})
    assert together.names[:2] == ("map", "table")
    assert top(together) == pytest.approx(1.0)


@each("last", ["[0, 0, 1, 0]", "[0, 0, -1, 0]", "[0, 0.6, 0, 0.8]"])
@each("yaw", [math.pi / 2, -2.0, 3.1])
def test_keyframes_are_turned_with_their_frame(folder, last, yaw):
    """Also where they turn by half a turn, which way round only their signs say."""
    frames = f"{{times: [0, 2], positions: [[1, 0, 0], [3, 0, 0]], quats: [[0, 0, 0, 1], {last}]}}"
    thing = f"{{shape: box, name: b, size: [1, 2, 3], motion: {{keyframes: {frames}}}}}"
    (folder / "k.yaml").write_text(f"obstacles:\n- {thing}\n")
    plain, turned = (read_world(folder / "k.yaml", options=o) for o in ({}, {"at": (1, 0, 0, yaw)}))
    c, s = math.cos(yaw), math.sin(yaw)
    place = np.array([[c, -s, 0, 1], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    for t in (0.0, 0.7, 1.9):
        one, two = plain.at(t).obstacle("b").pose, turned.at(t).obstacle("b").pose
        np.testing.assert_allclose(two, place @ one, atol=1e-9)


def test_scene_files_that_name_each_other_are_refused(folder):
    (folder / "a.yaml").write_text("sources: [b.yaml]\n")
    (folder / "b.yaml").write_text("sources: [a.yaml]\n")
    with refused(SceneError, "a.yaml", "b.yaml"):
        read_scene(folder / "a.yaml")


def test_no_scene_has_files_without_end(folder):
    """Few lines that name each other's files many times."""
    for k in range(6):
        (folder / f"n{k}.yaml").write_text("sources:\n" + f"- n{k + 1}.yaml\n" * 9)
    (folder / "n6.yaml").write_text("obstacles: []\n")
    with refused(SceneError, "100"):
        read_scene(folder / "n0.yaml")


@each(
    ("entry", "what"),
    [
        ("{file: t.scene, low: 1}", "low"),
        ("{file: m.yaml, voxel: 1}", "voxel"),
        ("{file: m.yaml, rpy: [0.1, 0, 0]}", "tilted"),
        ("{file: m.yaml, unknown: wall}", "wall"),
        ("{file: m.yaml, outside: wall}", "wall"),
        ("{file: m.yaml, low: 2, high: 1}", "size"),
        ("{file: c.xyz}", "voxel"),
        ("{file: c.xyz, voxel: 0.1, low: 5}", "nothing is left"),
        ("{file: c.xyz, voxel: 0.1, own_points: 0.1}", "own_points"),
        ("{file: c.xyz, voxel: 0.1, at: [1, 2]}", "at"),
        ("{file: c.xyz, voxel: 0.1, quat: [1, 2, 3, 4]}", "quat"),
        ("{file: t.scene, high_: 1}", "high_"),
        ("{at: [0, 0, 0]}", "file"),
        ("gone.scene", "gone"),
        ("5", "5"),
    ],
)
def test_what_does_not_fit_a_source_is_refused_with_its_line(folder, entry, what):
    (folder / "s.yaml").write_text(f"sources:\n- t.scene\n- {entry}\n")
    with refused(SceneError, "s.yaml:3:") as caught:
        read_scene(folder / "s.yaml")
    assert what in str(caught.value)


def test_options_of_several_files_have_to_be_of_one_of_them(folder):
    for options in ({"at": (1, 2, 3)}, {"occupied": 0.5}):
        with pytest.raises(SceneError, match=next(iter(options))):
            read_scene([folder / "m.yaml", folder / "t.scene"], options=options)
    with refused(SceneError, "hihg"):
        read_scene(folder / "m.yaml", options={"hihg": 1.0})


# Walls


def test_walls_are_as_high_as_the_robot_reaches(folder, tiago):
    assert top(read_scene(folder / "m.yaml")) == pytest.approx(WALL_HEIGHT)
    assert top(read_scene(folder / "m.yaml", robot=tiago)) == pytest.approx(highest_reach(tiago))
    assert top(read_scene(folder / "m.yaml", robot=tiago, options={"high": 0.4})) == pytest.approx(0.4)
    assert highest_reach(tiago) > 1.2


@each("name", ["tiago", "silvermate", "panda", "jackal-box"])
def test_no_configuration_is_higher_than_the_reach(name):
    robot = es.load_robot(name)
    rng = np.random.default_rng(3)
    low, high = np.maximum(robot.space.lower, -np.pi), np.minimum(robot.space.upper, np.pi)
    reach, most = highest_reach(robot), 0.0
    for _ in range(300):
        q = robot.space.from_coordinates(rng.uniform(low, high))
        data = robot.model.createData()
        pin.forwardKinematics(robot.model, data, q)
        for piece in robot.geometries:
            T = data.oMi[piece.joint].homogeneous @ piece.placement
            box = piece.geometry.aabb_local
            most = max(most, float((T[:3, :3] @ (0.5 * (np.ravel(box.min_) + np.ravel(box.max_))) + T[:3, 3])[2]))
    assert most <= reach
    assert reach < 2.0 * most + 0.5  # no idle bound


def test_a_robot_that_reaches_over_the_walls_is_refused_unless_they_are_said(folder):
    link = '<link name="{}"><collision><origin xyz="{} 0 0"/><geometry><box size="{}"/></geometry></collision></link>'
    tall = '<robot name="tall">' + link.format("base", 0, "1 1 0.2") + link.format("arm", 2, "4 0.1 0.1")
    tall += '<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.5"/>'
    tall += '<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>'
    (folder / "tall.urdf").write_text(tall)
    text = "robot: tall.urdf\nbase: omni\nscene: SCENE\nstart: {x: -1}\ngoal: {x: 0}\n"
    (folder / "s.yaml").write_text(text.replace("SCENE", "m.yaml"))
    problem = get_scenario(folder / "s.yaml")
    with refused(ScenarioError, "tall", "high"):
        problem.load_robot()
    (folder / "s.yaml").write_text(text.replace("SCENE", "{file: m.yaml, high: 5}"))
    problem = get_scenario(folder / "s.yaml")
    assert problem.load_robot().name == "tall"
    assert top(problem.scene) == pytest.approx(5.0)


@pytest.mark.parametrize("where", ["start: {x: -9}\ngoal: {x: 0}", "start: {x: -1}\ngoal: {x: 1, y: 2.3}"])
def test_a_start_or_goal_that_no_map_shows_is_refused(folder, where):
    for scene in ("m.yaml", "{file: m.yaml}", "[m.yaml, t.scene]", "{sources: [m.yaml]}"):
        (folder / "s.yaml").write_text(f"robot: jackal-box\nscene: {scene}\n{where}\n")
        with refused(ScenarioError, "s.yaml:"):
            read_scenario(folder / "s.yaml")
    (folder / "s.yaml").write_text(f"robot: jackal-box\nscene: {{file: m.yaml, outside: free}}\n{where}\n")
    assert read_scenario(folder / "s.yaml").scene.names == ("map",)


def test_walls_are_as_high_as_what_the_robot_holds_gets(folder):
    """A pole in the hand reaches over walls that are as high as the hand."""
    placed = {"position": {"x": 0, "y": 0, "z": 1.0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
    pole = {"primitives": [{"type": 1, "dimensions": [0.04, 0.04, 1.6]}], "primitive_poses": [placed]}
    thing = {"link_name": "panda_hand", "object": {"id": "pole", "header": {"frame_id": "panda_hand"}, **pole}}
    state = {"attached_collision_objects": [thing]}
    (folder / "held.json").write_text(json.dumps({"robot_state": state, "world": {"collision_objects": []}}))
    robot = es.load_robot("panda")
    for paths in ([folder / "m.yaml", folder / "held.json"], [folder / "held.json", folder / "m.yaml"]):
        found = read_scene_file(paths, robot=robot)
        reach = highest_reach(found.held_by(robot))
        assert reach > highest_reach(robot) + 0.5
        assert top(found.world.scene) >= reach - 1e-9


def test_two_maps_do_not_block_each_other(folder):
    (folder / "all.yaml").write_text("sources: [m.yaml, {file: m.yaml, at: [4, 0, 0]}]\n")
    found = read_scene_file(folder / "all.yaml")
    assert found.world.scene.names[:2] == ("map", "map-2")
    assert found.outside([(0, 0), (5, 0), (7, 0), (0, 2.1)]).tolist() == [2, 3]
    assert not inside(found.world.scene, [(-1, 0, 1), (2, 0, 1), (4.5, 0, 1)]).any()


def inside(scene: es.Scene, points) -> np.ndarray:
    """Which points [m] are in something, by Coal."""
    table, found = scene.table, np.zeros(len(points), dtype=bool)
    for part, R, at in zip(table.parts, table.rotation, table.translation, strict=True):
        for shape, shift in part.boxes if part.geometry is None else [(part.geometry, np.zeros(3))]:
            here = coal.Transform3s(np.asarray(R), at + R @ np.asarray(shift))
            for k, point in enumerate(np.asarray(points, dtype=float)):
                there = coal.Transform3s(np.eye(3), point)
                found[k] |= (
                    coal.collide(shape, here, coal.Sphere(1e-6), there, coal.CollisionRequest(), coal.CollisionResult())
                    > 0
                )
    return found


@each("count", [1, 2, 4])
def test_what_no_map_shows_is_filled_near_and_far(count):
    """Points anywhere are in one of the obstacles exactly where they are on no map; robots stay within 10 km."""
    rng = np.random.default_rng(count)
    areas = []
    for _ in range(count):
        pose = np.eye(4)
        angle = rng.uniform(-4.0, 4.0)
        pose[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
        pose[:2, 3] = rng.uniform(-8.0, 8.0, 2) + 1000.0 * rng.integers(0, 2)
        areas.append(MapArea(pose, rng.uniform(3.0, 30.0, 2), 0.0, 2.0))
    scene = es.Scene(outside_of(areas))
    near = areas[0].T_world_map[:2, 3] + rng.uniform(-40.0, 40.0, (150, 2))
    xy = np.vstack((near, rng.uniform(-1e4, 1e4, (40, 2))))
    held = np.any([area.holds(xy) for area in areas], axis=0)
    clear = np.all([~edge_of(area, xy) for area in areas], axis=0)
    found = inside(scene, np.column_stack((xy, rng.uniform(0.1, 1.9, len(xy)))))
    assert (found[clear] == ~held[clear]).all()
    assert held[clear].any()


def edge_of(area: MapArea, xy: np.ndarray) -> np.ndarray:
    """Which points are within 2 cm of its edge: gaps of 1 cm between maps are filled, or not."""
    local = (xy - area.T_world_map[:2, 3]) @ area.T_world_map[:2, :2]
    return np.abs(np.column_stack((local, local - area.size))).min(axis=1) < 0.02


@each("at", [(30.0, 0.0), (4.5, 0.0), (-9000.0, 4000.0)])
@each("kept", [["m.yaml"], ["m.yaml", "far.yaml"]])
def test_a_path_that_is_nowhere_on_a_map_is_not_certified(folder, at, kept):
    """Of the scene alone, too; between two maps that do not touch; and there is no proof of it."""
    (folder / "far.yaml").write_text("sources: [{file: m.yaml, at: [20, 0, 0]}]\n")
    robot = es.load_robot("jackal-box")
    scene = read_scene([folder / name for name in kept], robot=robot)
    (x, y), still = at, es.certify(robot, scene, [robot.home(-0.9, 0.0, 0.0), robot.home(-0.6, 0.0, 0.0)])
    assert still.certified
    path = [robot.home(x, y, 0.0), robot.home(x + 0.4, y, 0.0)]
    assert not es.certify(robot, scene, path).certified
    assert prove(robot, scene, path) is None


def test_a_name_that_an_edge_has_is_no_reason_to_leave_it_out(folder):
    post = "{shape: sphere, name: outside-of-map-left, radius: 0.1, at: [0, 0, 1]}"
    (folder / "all.yaml").write_text(f"sources: [m.yaml]\nobstacles: [{post}]\n")
    scene = read_scene(folder / "all.yaml")
    assert inside(scene, [(0, 0, 1), (-2.5, 0, 1), (5, 0, 1), (0, -3, 1), (0, 3, 1)]).all()


# Octrees


def test_cells_that_are_partly_between_two_heights_stay(tmp_path):
    """A large leaf is divided; of what reaches above the floor nothing is lost, at any pose of the map."""
    edge, depth = 0.8, 13  # 8 cells of 0.1 m
    way = [7] + [0] * (depth - 1)
    nodes = b"".join(np.float32(0.5).tobytes() + bytes([1 << child]) for child in way)
    data = f"# Octomap OcTree file\nid OcTree\nsize {depth + 1}\nres 0.1\ndata\n".encode() + nodes
    (tmp_path / "m.ot").write_bytes(data + np.float32(2.0).tobytes() + b"\0")
    assert [o.spec["size"].tolist() for o in read_octomap(tmp_path / "m.ot")] == [[edge] * 3]
    rng = np.random.default_rng(1)
    for angle in (0.0, 0.6):
        c, s = math.cos(angle), math.sin(angle)
        pose = np.array([[1, 0, 0, 3.0], [0, c, -s, 0.0], [0, s, c, -0.35], [0, 0, 0, 1]])
        scene = read_octomap(tmp_path / "m.ot", low=0.0, high=0.25, at=pose)
        points = rng.uniform(0.0, edge, (2000, 3)) @ pose[:3, :3].T + pose[:3, 3]
        inside = (points[:, 2] > 0.0) & (points[:, 2] < 0.25)
        held = np.zeros(len(points), dtype=bool)
        for obstacle in scene:
            local = (points - obstacle.pose[:3, 3]) @ obstacle.pose[:3, :3]
            half = 0.5 * obstacle.spec["size"] + 1e-9
            held |= (np.abs(local[:, None] - obstacle.spec["centers"]) <= half).all(axis=2).any(axis=1)
        assert inside.any()
        assert held[inside].all()
        assert not held[(points[:, 2] < -0.2) | (points[:, 2] > 0.45)].any()


# Clouds


def test_the_robots_own_points_are_taken_out(tiago, caplog):
    """Points on its shapes go, one that is further away than the margin stays; the count is kept and said."""
    q = tiago.home(x=1.0, yaw=0.5)
    ground = np.array([[1.0, 0.0, 0.15]])  # in the base
    away = np.array([[3.0, 0.0, 0.3], [1.0, 2.0, 0.5]])
    with caplog.at_level(logging.WARNING):
        cloud = without_robot(PointCloud(np.vstack((ground, away)), 4), tiago, q, 0.05)
    np.testing.assert_array_equal(cloud.points, away)
    assert cloud.dropped == 5
    assert "1 of 3 points" in caplog.text
    wide = without_robot(np.vstack((ground, away)), tiago, q, 5.0)
    assert len(wide.points) == 0
    with refused(SceneError, "margin"):
        without_robot(away, tiago, q, -1.0)


def test_points_that_are_none_and_millimetres_are_said(tmp_path, caplog):
    head = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 1\nPOINTS 3\nDATA ascii\n"
    (tmp_path / "c.pcd").write_text(head + "0 0 0\nnan 0 0\n900 400 100\n")
    (tmp_path / "s.yaml").write_text("obstacles: [{shape: points, radius: 0.05, file: c.pcd}]\n")
    with caplog.at_level(logging.WARNING):
        read_scene(tmp_path / "s.yaml")
    assert "1 points of 3" in caplog.text
    assert "millimetres" in caplog.text
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        read_point_cloud(tmp_path / "c.pcd", scale=0.001)
    assert "millimetres" not in caplog.text


def test_the_faces_of_a_cloud_are_said(tmp_path, caplog):
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    points = "end_header\n0 0 0\n1 0 0\n0 1 0\n"
    for faces in ("", "element face 1\nproperty list uchar int vertex_indices\n"):
        caplog.clear()
        (tmp_path / "c.ply").write_text(head + faces + points + ("3 0 1 2\n" if faces else ""))
        with caplog.at_level(logging.WARNING):
            assert len(read_point_cloud(tmp_path / "c.ply").points) == 3
        assert ("1 faces" in caplog.text) == bool(faces)


def test_a_mesh_in_millimetres_is_said(tmp_path, caplog):
    corners = "v 0 0 0\nv 60 0 0\nv 0 60 0\nv 0 0 60\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "cup.obj").write_text(corners)
    for scale, said in ((1.0, True), (0.001, False)):
        caplog.clear()
        (tmp_path / "s.yaml").write_text(f"obstacles: [{{shape: mesh, file: cup.obj, scale: {scale}}}]\n")
        with caplog.at_level(logging.WARNING):
            read_scene(tmp_path / "s.yaml")
        assert ("millimetres" in caplog.text) == said


def test_a_map_at_a_pose_is_where_it_says(folder):
    scene = read_scene(folder / "m.yaml", options={"at": (1, 2, 0.5, math.pi / 2), "high": 1.0, "outside": "free"})
    plain = load_nav2_map(folder / "m.yaml", height=1.0, outside="free")
    turn = np.array([[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 0], [0, 0, 0, 1.0]])  # heights stay the world's
    np.testing.assert_allclose(scene.obstacle("map").pose, turn @ plain.obstacle("map").pose, atol=1e-9)


@each(
    ("sizes", "said"),
    [([[400, 400, 20], [1200, 800, 700]], True), ([[0.4, 0.4, 0.02], [200, 200, 0.1]], False), ([[3, 2, 1.5]], False)],
)
@each("kind", ["yaml", "scene"])
def test_obstacles_in_millimetres_are_said(tmp_path, caplog, sizes, said, kind):
    file = tmp_path / f"a.{kind}"
    if kind == "yaml":
        file.write_text("obstacles:\n" + "".join(f"  - {{shape: box, size: {size}}}\n" for size in sizes))
    else:
        boxes = "".join(
            f"* b{k}\n1\nbox\n{' '.join(map(str, s))}\n0 0 0\n0 0 0 1\n0 0 0 0\n" for k, s in enumerate(sizes)
        )
        file.write_text(f"s\n{boxes}.\n")
    es.read_scene(file)
    assert ("millimetres" in caplog.text) == said


@each(
    "text",
    [
        "obstacles: [{{shape: box, size: [1, 1, 1], rpy: [0, 0, {}]}}]",
        "sources: [{{file: b.yaml, rpy: [{}, 0, 0]}}]",
        "sources: [{{file: b.yaml, at: [1, 0, 0, {}]}}]",
    ],
)
def test_poses_in_degrees_are_said(tmp_path, caplog, text):
    (tmp_path / "b.yaml").write_text("obstacles: [{shape: box, size: [1, 1, 1]}]")
    for angle, said in ((-3.1, False), (90, True)):
        (tmp_path / "a.yaml").write_text(text.format(angle))
        assert len(es.read_scene(tmp_path / "a.yaml")) == 1
        assert ("degrees" in caplog.text) == said
