"""``certify`` of scenes of other programs: walls, the outside of maps, several files, what is held, clouds, poses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import elastic_strips as es
from elastic_strips.cli import main
from elastic_strips.io import write_path
from elastic_strips.robot import RobotModel
from elastic_strips.robot.reach import highest_reach

MAP = "image: m.pgm\nresolution: 0.1\norigin: [-3, -3, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"


def call(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["certify", *map(str, arguments)])
    assert isinstance(ended.value.code, int)
    return ended.value.code


@pytest.fixture
def folder(tmp_path: Path, silvermate: RobotModel) -> Path:
    """A map of 6 m × 6 m with a wall at x = 1.5 m … 1.6 m; paths that stay, that go through it, and that leave it."""
    pixels = np.full((60, 60), 254, np.uint8)
    pixels[:, 45] = 0
    (tmp_path / "m.pgm").write_bytes(b"P5\n60 60\n255\n" + pixels.tobytes())
    (tmp_path / "m.yaml").write_text(MAP)
    (tmp_path / "none.yaml").write_text("obstacles: []\n")
    paths = {"stays": [(-1.5, 0), (-1, 0.5)], "through": [(0, 0), (2.5, 0)], "leaves": [(-1, 0), (-1, 9)]}
    for name, places in {**paths, "off": [(9, 9), (9.5, 9)]}.items():
        write_path(tmp_path / f"{name}.csv", silvermate, [silvermate.home(x=x, y=y) for x, y in places])
    return tmp_path


def on(folder: Path, path: str, *scenes: str) -> list[object]:
    files = [word for scene in scenes for word in ("--scene", folder / scene)]
    return [folder / f"{path}.csv", "--robot", "silvermate", *files]


def test_what_leaves_the_map_is_not_certified(folder, capsys):
    assert call(*on(folder, "stays", "m.yaml")) == 0
    for path in ("through", "leaves", "off"):
        assert call(*on(folder, path, "m.yaml"), "--json", folder / "a.json") == 3, path
        assert json.loads((folder / "a.json").read_text())["verdict"] in ("refuted", "unknown")
    assert "outside" in capsys.readouterr().out
    for path in ("leaves", "off"):
        assert call(*on(folder, path, "m.yaml"), "--outside", "free") == 0


BOOM = """<robot name="boom">
<link name="base"><collision><geometry><box size="0.5 0.5 0.4"/></geometry></collision></link>
<link name="arm"><collision><origin xyz="0.5 0 0"/><geometry><box size="1 0.06 0.06"/></geometry></collision></link>
<joint name="pan" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 1.3"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>
"""


def test_an_arm_does_not_pass_over_the_walls_of_a_map(folder):
    """Walls were 1 m high: an arm at 1.3 m that is stretched over one of them was certified."""
    (folder / "boom.urdf").write_text(BOOM)
    robot = es.load_robot(folder / "boom.urdf", base="omni")
    write_path(folder / "over.csv", robot, [robot.home(x=1.0), robot.home(x=1.0, pan=0.3)])
    arguments = [folder / "over.csv", "--robot", folder / "boom.urdf", "--base", "omni", "--scene", folder / "m.yaml"]
    assert call(*arguments) == 3
    assert call(*arguments, "--high", 1.0) == 0
    assert call(*arguments, "--low", 1.4, "--high", 2.0) == 0
    scene = es.read_scene(folder / "m.yaml", robot=robot)
    top = float((scene.table.center + scene.table.half_extents)[:, 2].max())
    assert top == pytest.approx(highest_reach(robot))
    assert top >= 1.33


def test_several_scenes_are_one(folder, capsys):
    (folder / "box.scene").write_text("room\n* post\n1\nbox\n0.4 0.4 1\n-1.2 0.3 0.5\n0 0 0 1\n0 0 0 0\n.\n")
    assert call(*on(folder, "stays", "m.yaml", "box.scene")) == 3
    assert "post" in capsys.readouterr().out
    assert call(*on(folder, "stays", "box.scene"), "--at", "5,0,0,1.57") == 0
    assert call(*on(folder, "stays", "m.yaml", "box.scene"), "--at", "5,0,0") == 2
    assert "sources" in capsys.readouterr().err
    assert call(*on(folder, "stays", "box.scene"), "--at", "5,0") == 2
    assert call(*on(folder, "stays", "box.scene"), "--high", "1") == 2


def test_the_robots_own_points_are_left_out_of_a_cloud(folder, silvermate):
    (folder / "c.xyz").write_text("-1.5 0 0.2\n-1.5 0 0.01\n2.5 0 0.5\n")
    cloud = on(folder, "stays", "c.xyz")
    assert call(*cloud) == 2  # the size of its cells has to be said
    assert call(*cloud, "--voxel", 0.05) == 3
    assert call(*cloud, "--voxel", 0.05, "--own-points", 0.05) == 0


def test_what_the_robot_holds_counts(tmp_path, capsys):
    """A bar in the hand meets a post that the hand alone passes; it is said that it is held."""
    turn = {"x": 0, "y": 0, "z": 0, "w": 1}
    pose = {"position": {"x": 0, "y": 0, "z": 0.13}, "orientation": turn}
    bar = {"primitives": [{"type": 1, "dimensions": [0.04, 0.6, 0.04]}], "primitive_poses": [pose]}
    bar.update(id="bar", header={"frame_id": "panda_hand"})
    held = [{"link_name": "panda_hand", "touch_links": ["panda_leftfinger"], "object": bar}]
    place = {"position": {"x": 0.31, "y": 0.33, "z": 0.46}, "orientation": turn}
    post = {"primitives": [{"type": 1, "dimensions": [0.2, 0.2, 0.2]}], "primitive_poses": [place]}
    post.update(id="post", header={"frame_id": "world"})
    world = {"world": {"collision_objects": [post]}}
    (tmp_path / "free.json").write_text(json.dumps(world))
    (tmp_path / "held.json").write_text(json.dumps({**world, "robot_state": {"attached_collision_objects": held}}))
    panda = es.load_robot("panda")
    write_path(tmp_path / "p.csv", panda, [panda.home(), panda.home()])
    arguments = [tmp_path / "p.csv", "--robot", "panda", "--scene"]
    assert call(*arguments, tmp_path / "free.json") == 0
    capsys.readouterr()
    assert call(*arguments, tmp_path / "held.json") == 3
    out = capsys.readouterr().out
    assert "bar (at panda_hand)" in out
    held[0]["link_name"] = "hand"
    (tmp_path / "held.json").write_text(json.dumps({**world, "robot_state": {"attached_collision_objects": held}}))
    assert call(*arguments, tmp_path / "held.json") == 2
