"""Geometry: the picture's arrays equal what Pinocchio says."""

from __future__ import annotations

import pickle

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from cases import each

from elastic_strips.robot import load_robot
from elastic_strips.viewer import geometry


def as_matrices(rows):
    return np.swapaxes(np.asarray(rows).reshape(-1, 4, 4), -1, -2)


@pytest.fixture
def nodes(robot, rng):
    q = np.array([robot.home(x=x, y=y, yaw=yaw) for x, y, yaw in rng.uniform(-2, 2, (6, 3))])
    v = rng.uniform(-0.2, 0.2, (6, robot.nv))
    return np.array([pin.integrate(robot.model, a, b) for a, b in zip(q, v, strict=True)])


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def test_control_points_equal_the_robots(robot, nodes):
    poses = geometry.RobotPoses(robot)
    poses.update(robot.space.to_coordinates(nodes))
    expected = np.array([robot.control_points(q) for q in nodes])
    assert np.allclose(poses.points(), expected, atol=1e-9)


def test_bodies_are_where_pinocchio_has_the_visual_geometry(robot, nodes):
    """Compare the bounding box of every body with that of its vertices as Pinocchio places them."""
    bodies = geometry.robot_bodies(robot)
    poses = geometry.RobotPoses(robot)
    poses.update(robot.space.to_coordinates(nodes))
    matrices = poses.matrices([b.joint for b in bodies])
    data = robot.model.createData()
    visual = robot.visual_model.createData()
    for n, q in enumerate(nodes):
        pin.updateGeometryPlacements(robot.model, data, robot.visual_model, visual, q)
        for b, body in enumerate(bodies):
            T = as_matrices(matrices[n, b])[0]
            drawn = body.mesh.vertices @ T[:3, :3].T + T[:3, 3]
            expected = []
            for k, item in enumerate(robot.visual_model.geometryObjects):
                if item.parentJoint == body.joint and hasattr(item.geometry, "vertices"):
                    placed = visual.oMg[k]
                    expected.append(np.asarray(item.geometry.vertices()) @ placed.rotation.T + placed.translation)
            if len(expected) == sum(o.parentJoint == body.joint for o in robot.visual_model.geometryObjects):
                points = np.concatenate(expected)
                assert np.allclose(drawn.min(axis=0), points.min(axis=0), atol=1e-4)
                assert np.allclose(drawn.max(axis=0), points.max(axis=0), atol=1e-4)


@pytest.mark.parametrize(
    "visual, black", [("", False), ('<material name="k"><color rgba="0 0 0 1"/></material>', True)]
)
def test_only_what_is_black_is_drawn_black(tmp_path, visual, black):
    """The collision geometry, which has no colours, is drawn where a file has no visual one."""
    shape = '<geometry><box size="0.4 0.4 0.2"/></geometry>'
    visual = f"<visual>{shape}{visual}</visual>" if visual else ""
    file = tmp_path / "bare.urdf"
    file.write_text(f'<robot name="bare"><link name="base">{visual}<collision>{shape}</collision></link></robot>')
    robot = load_robot(file, base="omni")
    for one in (robot, pickle.loads(pickle.dumps(robot))):
        colors = np.concatenate([body.mesh.colors for body in geometry.robot_bodies(one)])
        assert colors.max() == 0.0 if black and one is robot else colors.min() > 0.2


def test_interpolated_equals_pinocchio(robot, nodes):
    at = np.arange(len(nodes), dtype=float)
    where = np.array([0.0, 0.3, 1.0, 2.7, 5.0])
    rows = geometry.interpolated(robot.space, robot.space.to_coordinates(nodes), at, where)
    for row, w in zip(rows, where, strict=True):
        i = min(int(w), len(nodes) - 2)
        expected = pin.interpolate(robot.model, nodes[i], nodes[i + 1], w - i)
        assert np.allclose(robot.space.from_coordinates(row), expected, atol=1e-9)


def test_between_maps_the_unit_axis_onto_the_segment(rng):
    starts, ends = rng.normal(size=(2, 20, 3))
    ends[0] = starts[0]  # of no length
    ends[1] = starts[1] + [0, 0, 1]
    T = as_matrices(geometry.between(starts, ends, 0.1))
    assert np.isfinite(T).all()
    assert np.allclose(T[:, :3, 3], starts, atol=1e-6)
    assert np.allclose(T[:, :3, 2] + T[:, :3, 3], ends, atol=2e-6)
    assert np.allclose(np.linalg.norm(T[:, :3, 0], axis=1), 0.1, atol=1e-6)
    assert np.linalg.det(T[1:, :3, :3]).min() > 0


def test_arrows_leave_out_what_is_nothing():
    vectors = np.array([[0, 0, 10], [0, 0, 0], [0, 0, 0.01], [np.nan, 0, 0]])
    assert len(geometry.arrows(np.zeros((4, 3)), vectors)) == 1
    assert len(geometry.arrows(np.zeros((0, 3)), np.zeros((0, 3)))) == 0
    assert len(geometry.arrows(np.zeros((2, 3)), np.zeros((2, 3)))) == 0


def test_ribbon_follows_the_arc(robot):
    q = np.array([robot.home(), robot.home(x=1.0, y=1.0, yaw=np.pi / 2)])
    band = geometry.ribbon(robot.space, robot.space.to_coordinates(q), np.ones((1, 3)))
    assert band is not None
    middle = (band.vertices[0::2] + band.vertices[1::2]) / 2
    assert np.allclose(np.linalg.norm(middle[:, :2] - [0.0, 1.0], axis=1), 1.0, atol=1e-6)  # a quarter circle
    assert geometry.ribbon(robot.space, robot.space.to_coordinates(q[:1]), np.ones((0, 3))) is None
    assert geometry.ribbon(robot.space, robot.space.to_coordinates(q[[0, 0]]), np.ones((1, 3))) is None


@each("count", [1, 2, 7])
@each("nodes", [1, 2, 3, 8, 200])
def test_spaced_ends_with_the_goal(count, nodes):
    points = np.zeros((nodes, 2, 3))
    points[:, :, 0] = np.linspace(0, 1, nodes)[:, None] ** 2
    chosen = geometry.spaced(points, count)
    assert len(chosen) <= count
    assert chosen == sorted(set(chosen))
    assert not chosen or chosen[-1] == nodes - 1
    assert 0 not in chosen  # there stands the robot itself


@pytest.mark.parametrize("spread", [1, 10**9])
def test_distinct_rows_are_those_that_numpy_finds(spread):
    rows = spread * np.random.default_rng(0).integers(-5, 5, (3000, 3))
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    found = geometry._distinct(rows)
    np.testing.assert_array_equal(found[0], first)
    np.testing.assert_array_equal(found[1], inverse.reshape(-1))


@each("shape", ['<box size="0.6 0.06 0.06"/>', '<sphere radius="0.2"/>', '<mesh filename="flat.stl"/>'])
def test_links_that_no_collision_shape_covers_are_hatched(tmp_path, shape):
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    flat.export(tmp_path / "flat.stl")
    box = '<geometry><box size="0.4 0.4 0.4"/></geometry>'
    (tmp_path / "r.urdf").write_text(
        f'<robot name="r"><link name="base"><visual>{box}</visual><collision>{box}</collision></link>'
        f'<link name="arm"><visual><geometry>{shape}</geometry></visual></link>'
        '<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    stripes = np.array(geometry.linear(geometry.BARE), dtype=np.float32)

    def share(**options) -> dict[int, float]:
        bodies = geometry.robot_bodies(load_robot(tmp_path / "r.urdf", base="fixed", **options))
        return {b.joint: float(np.isclose(b.mesh.colors, stripes, atol=1e-6).all(axis=1).mean()) for b in bodies}

    base, arm = share().values()
    assert base == 0.0
    assert 0.2 < arm < 0.8
    if "flat" not in shape:  # which has no hull
        assert set(share(visual_as_collision="missing").values()) == {0.0}
