"""What is read from URDF files, against yourdfpy, which shares no code with Pinocchio: where the links are, what the
joints may do, and that the pieces hold the collision geometry."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import trimesh
import yourdfpy
from brute_force import configuration, link_poses, outside, random_coordinates
from lxml import etree
from shared_data import shared_data

from elastic_strips.arrays import Array
from elastic_strips.catalogue import find_robot, robot_names
from elastic_strips.errors import RobotError
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.robot.second_reader import differences, shape_differences
from elastic_strips.robot.urdf import pinocchio_geometry, pinocchio_model, read_urdf

KNOWN = {"simple_humanoid"}  # Pinocchio's own <collision_checking> makes a capsule of its cylinder
OWN = ["silvermate", "jackal-box", "bridge-arm"]
OTHERS = ["tiago", "panda", "hyq", "baxter", "ur5_gripper", "mbm/fetch/fetch.urdf", "mbm/panda/panda.urdf"]


class SecondReader:
    """A robot as it is read here and by yourdfpy, with everything that follows another joint free: here it is held."""

    def __init__(self, name: str) -> None:
        if name.endswith(".urdf"):
            self.file, folders = shared_data(*Path(name).parts), []
            self.robot: RobotModel = load_robot(self.file)
        else:
            self.file, folders = Path(find_robot(name).urdf), [Path(f) for f in find_robot(name).package_dirs]
            self.robot = load_robot(name)
        self.folders = [*folders, *self.file.parents]
        document = etree.parse(str(self.file))
        for joint in document.getroot().findall("joint"):
            for follower in joint.findall("mimic"):
                joint.remove(follower)
        # what is named in it is looked for here, without yourdfpy's help
        self.second = yourdfpy.URDF.load(io.BytesIO(etree.tostring(document)), load_meshes=False)

    def place(self, row: Array) -> dict[str, Array]:
        """Poses (4, 4) of all links by yourdfpy, at coordinates of the robot."""
        first = self.robot.space.base_nv
        values = dict(zip(self.robot.joint_names, row[first:], strict=True)) | dict(self.robot.locked)
        self.second.update_cfg({name: values[name] for name in self.second.actuated_joint_names})
        base = np.eye(4)
        if first:
            base[:2, :2] = [[np.cos(row[2]), -np.sin(row[2])], [np.sin(row[2]), np.cos(row[2])]]
            base[:2, 3] = row[:2]
        return {link: base @ self.second.get_transform(link) for link in self.second.link_map}

    def points(self, geometry: Any) -> Array:
        """Corners (V, 3), and points of what is round, in the shape's frame."""
        turn = np.linspace(0.0, 2.0 * np.pi, 24)
        ring = np.column_stack((np.cos(turn), np.sin(turn), np.zeros(24)))
        if geometry.box is not None:
            return np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3) * geometry.box.size
        if geometry.cylinder is not None:
            up = np.array([0.0, 0.0, geometry.cylinder.length / 2])
            return np.vstack((geometry.cylinder.radius * ring + up, geometry.cylinder.radius * ring - up))
        if geometry.sphere is not None:
            return geometry.sphere.radius * np.vstack((ring, ring[:, [2, 0, 1]], ring[:, [1, 2, 0]]))
        name = geometry.mesh.filename.removeprefix("package://").removeprefix("file://")
        mesh = trimesh.load(next(f / name for f in self.folders if (f / name).is_file()), force="mesh")
        some = np.asarray(mesh.vertices)[:: max(1, len(mesh.vertices) // 1000)]
        return some * (1.0 if geometry.mesh.scale is None else np.asarray(geometry.mesh.scale))


@pytest.fixture(scope="module", params=[*OWN, *OTHERS])
def twice(request: pytest.FixtureRequest) -> SecondReader:
    return SecondReader(request.param)


def test_links_are_where_another_reader_has_them(twice: SecondReader, rng: np.random.Generator) -> None:
    for row in random_coordinates(twice.robot, rng, 3):
        for link, pose in twice.place(row).items():
            mine = twice.robot.frame_pose(configuration(twice.robot, row), link)
            np.testing.assert_allclose(mine, pose, atol=1e-9, err_msg=link)


def test_joints_may_do_what_another_reader_allows(twice: SecondReader) -> None:
    robot = twice.robot
    for k, name in enumerate(robot.joint_names, robot.space.base_nv):
        joint, index = twice.second.joint_map[name], robot.model.getJointId(name)
        if joint.type != "continuous":
            assert robot.space.lower[k] == pytest.approx(joint.limit.lower, abs=1e-12), name
            assert robot.space.upper[k] == pytest.approx(joint.limit.upper, abs=1e-12), name
        if joint.limit is not None and joint.limit.velocity is not None:
            velocity = robot.model.velocityLimit[robot.model.joints[index].idx_v]
            assert velocity == pytest.approx(joint.limit.velocity), name


def test_pieces_hold_the_collision_geometry_of_another_reader(twice: SecondReader, rng: np.random.Generator) -> None:
    robot, shapes = twice.robot, 0
    for row in random_coordinates(robot, rng, 2):
        poses, mine = twice.place(row), link_poses(robot, configuration(robot, row))
        for name, link in twice.second.link_map.items():
            pieces = [(p, T) for p, T in zip(robot.geometries, mine, strict=True) if name in p.links]
            for shape in link.collisions:
                T = poses[name] @ (np.eye(4) if shape.origin is None else shape.origin)
                world = twice.points(shape.geometry) @ T[:3, :3].T + T[:3, 3]
                excess = [outside((world - P[:3, 3]) @ P[:3, :3], piece.geometry) for piece, P in pieces]
                assert pieces, f"nothing covers {name}"
                assert np.min(excess, axis=0).max() <= 1e-6, name
                shapes += 1
    assert shapes


@pytest.mark.parametrize("name", [*robot_names(), "mbm/fetch/fetch.urdf", "mbm/panda/panda.urdf"])
def test_the_second_reader_finds_nothing_in_correct_files(name: str) -> None:
    """What `load_robot` and the card compare, over all robots that there are: no false difference."""
    if name.endswith(".urdf"):
        file, folders = shared_data(*Path(name).parts), ()
    else:
        file, folders = find_robot(name).urdf, find_robot(name).package_dirs
    try:
        source = read_urdf(file, package_dirs=folders)
    except RobotError:  # the file of example-robot-data that has no link
        pytest.skip(f"{name} is refused")
    model = pinocchio_model(source)
    assert differences(source, model) == ()
    found = shape_differences(source, model, pinocchio_geometry(source, model, pin.COLLISION))
    assert found is not None
    assert bool(found) == (name in KNOWN), found
