"""Collision geometry: the convex pieces contain the meshes of the URDF, the capsules contain the pieces."""

from __future__ import annotations

import subprocess
import sys

import coal
import numpy as np
import pinocchio as pin
import pytest
from brute_force import configuration, distance, link_poses, outside, random_coordinates, support
from cases import each, each_robot, refused
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import ConvexHull

from elastic_strips.catalogue import find_robot
from elastic_strips.coal_shapes import contains, convex_from_vertices, support_points, supports
from elastic_strips.errors import RobotError
from elastic_strips.robot import RobotModel
from elastic_strips.robot.geometry import bounding_capsule, convex_shapes, joined_pieces, piece_of

SHAPES = [
    coal.Box(0.2, 0.4, 0.6),
    coal.Sphere(0.3),
    coal.Cylinder(0.2, 0.5),
    coal.Capsule(0.1, 0.4),
    coal.Cone(0.25, 0.5),
    coal.Ellipsoid(0.1, 0.2, 0.3),
]


def surface_points(shape: coal.CollisionGeometry, rng: np.random.Generator, count: int = 300) -> np.ndarray:
    """Points (V, 3) of a shape: a mesh's vertices and triangles, a primitive's surface, in the shape's frame."""
    if isinstance(shape, coal.BVHModelBase):
        vertices = np.asarray(shape.vertices()).reshape(-1, 3)
        triangles = [shape.tri_indices(i) for i in range(min(shape.num_tris, 200))]
        faces = np.array([[t[0], t[1], t[2]] for t in triangles])
        weights = rng.dirichlet(np.ones(3), len(faces))
        inner = np.einsum("fk,fki->fi", weights, vertices[faces])
        low_high = vertices[np.unique(np.vstack([vertices.argmin(axis=0), vertices.argmax(axis=0)]))]
        return np.vstack((vertices[rng.integers(0, len(vertices), count)], inner, low_high))
    u = rng.normal(size=(count, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    if isinstance(shape, coal.Box):
        return u / np.abs(u).max(axis=1)[:, None] * np.asarray(shape.halfSide)
    if isinstance(shape, coal.Sphere):
        return u * shape.radius
    assert isinstance(shape, coal.Cylinder)
    ring = u[:, :2] / np.linalg.norm(u[:, :2], axis=1)[:, None] * shape.radius
    return np.column_stack((ring, np.sign(u[:, 2]) * shape.halfLength))


def test_supports_of_many_shapes_are_those_of_each(rng) -> None:
    """Of kinds in disorder, each along directions of its own."""
    shapes = [*SHAPES, convex_from_vertices(rng.normal(size=(12, 3)))] * 3
    shapes = [shapes[k] for k in rng.permutation(len(shapes))]
    n = rng.normal(size=(len(shapes), 7, 3))
    n /= np.linalg.norm(n, axis=2, keepdims=True)
    np.testing.assert_allclose(supports(shapes, n), [support(s, own) for s, own in zip(shapes, n, strict=True)])
    assert supports([], n[:0]).shape == (0, 7)


@pytest.mark.parametrize("name", ["silvermate", "tiago"])
def test_pieces_contain_the_urdfs_collision_geometry(name, request, rng):
    """The whole URDF with its meshes, placed by Pinocchio's full model, against the pieces of the reduced robot."""
    robot: RobotModel = request.getfixturevalue(name)
    known = find_robot(name)
    urdf, folders = known.urdf, known.package_dirs
    model = pin.buildModelFromUrdf(str(urdf), pin.JointModelPlanar())
    collision = pin.buildGeomFromUrdf(model, str(urdf), pin.COLLISION, package_dirs=[str(f) for f in folders])
    assert collision.ngeoms > 5
    for row in random_coordinates(robot, rng, 2):
        coordinates = dict(zip(robot.joint_names, row[3:], strict=True)) | dict(robot.locked)
        q = pin.neutral(model)
        q[:4] = row[0], row[1], np.cos(row[2]), np.sin(row[2])
        for i in range(2, model.njoints):
            joint, value = model.joints[i], coordinates[model.names[i]]
            q[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
        data = model.createData()
        pin.forwardKinematics(model, data, q)
        poses = link_poses(robot, configuration(robot, row))
        names = {robot.model.names[g.joint] for g in robot.geometries}
        for obj in collision.geometryObjects:
            T = (data.oMi[obj.parentJoint] * obj.placement).homogeneous
            world = surface_points(obj.geometry, rng) @ T[:3, :3].T + T[:3, 3]
            carrier = obj.parentJoint
            while model.names[carrier] in robot.locked:
                carrier = model.parents[carrier]
            assert model.names[carrier] in names, obj.name
            excess = np.full(len(world), np.inf)
            for link, pose in zip(robot.geometries, poses, strict=True):
                if robot.model.names[link.joint] == model.names[carrier]:
                    local = (world - pose[:3, 3]) @ pose[:3, :3]
                    excess = np.minimum(excess, outside(local, link.geometry))
            assert excess.max() <= 1e-6, obj.name


def test_pieces_name_all_links_that_they_cover(tiago):
    known = find_robot("tiago")
    urdf, folders = known.urdf, known.package_dirs
    model = pin.buildModelFromUrdf(str(urdf), pin.JointModelPlanar())
    collision = pin.buildGeomFromUrdf(model, str(urdf), pin.COLLISION, package_dirs=[str(f) for f in folders])
    wanted = {model.frames[obj.parentFrame].name for obj in collision.geometryObjects}
    assert {link for piece in tiago.geometries for link in piece.links} == wanted


@each_robot
def test_capsules_contain_their_pieces(robot, rng):
    for piece in robot.geometries:
        local = (
            np.asarray(piece.geometry.points())
            if isinstance(piece.geometry, coal.ConvexBase)
            else surface_points(piece.geometry, rng)
        )
        points = local @ piece.placement[:3, :3].T + piece.placement[:3, 3]
        a, b, r = piece.capsule.a, piece.capsule.b, piece.capsule.r
        way = b - a
        s = np.clip((points - a) @ way / max(way @ way, 1e-30), 0.0, 1.0)
        assert np.linalg.norm(points - (a + s[:, None] * way), axis=1).max() <= r + 1e-9, piece.name


@each("shape", SHAPES, ids=lambda s: type(s).__name__)
def test_support_points_contain_the_shape(shape, rng):
    n = rng.normal(size=(2000, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    points, radius = support_points(shape)
    assert ((n @ points.T).max(axis=1) + radius >= support(shape, n) - 1e-12).all()
    assert ((n @ points.T).max(axis=1) + radius <= 2.0 * support(shape, n) + 0.3).all()


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    points=arrays(float, st.tuples(st.integers(1, 25), st.just(3)), elements=st.floats(-2, 2, width=32)),
    scale=arrays(float, 3, elements=st.sampled_from([0.0, 1e-4, 0.1, 1.0])),
    radius=st.sampled_from([0.0, 0.05]),
)
def test_bounding_capsule_contains_any_points(points, scale, radius):
    points = points * scale
    capsule = bounding_capsule(points, radius)
    way = capsule.b - capsule.a
    s = np.clip((points - capsule.a) @ way / max(way @ way, 1e-30), 0.0, 1.0)
    far = np.linalg.norm(points - (capsule.a + s[:, None] * way), axis=1)
    assert far.max() + radius <= capsule.r + 1e-9
    spread = np.linalg.norm(points - points.mean(axis=0), axis=1).max()
    assert capsule.r <= spread + radius + 1e-6  # never worse than the sphere about the mean


def test_convex_from_vertices_is_the_hull(rng):
    points = rng.normal(size=(60, 3))
    shape = convex_from_vertices(points)
    assert outside(points, shape).max() <= 1e-9
    volume = ConvexHull(points).volume
    assert ConvexHull(np.asarray(shape.points())).volume == pytest.approx(volume, rel=1e-9)
    T = np.eye(4)
    T[:3, 3] = 10.0, 0.0, 0.0
    d = distance(shape, np.eye(4), coal.Sphere(0.5), T)[0]
    nearest = np.linalg.norm(points - [10, 0, 0], axis=1).min() - 0.5
    assert 0.0 < d <= nearest + 1e-9


@each(
    "points",
    [
        np.zeros((0, 3)),
        np.eye(3),
        np.tile([[1.0, 2.0, 3.0]], (20, 1)),
        np.c_[np.random.default_rng(0).normal(size=(20, 2)), np.zeros(20)],
        np.outer(np.linspace(0, 1, 9), [1.0, 2.0, 3.0]),
    ],
    ids=["none", "three", "one", "plane", "line"],
)
def test_flat_meshes_are_refused(points):
    with refused(RobotError, "arm: "):
        convex_from_vertices(points, name="arm")


@pytest.mark.parametrize("thickness", [1e-8, 1e-9])
def test_nearly_flat_meshes_do_not_crash(thickness):
    code = (
        "import numpy as np\n"
        "from elastic_strips.errors import RobotError\n"
        "from elastic_strips.coal_shapes import convex_from_vertices\n"
        "rng = np.random.default_rng(0)\n"
        f"points = np.c_[rng.uniform(0, 1, (30, 2)), rng.uniform(-1, 1, 30) * {thickness}]\n"
        "try:\n    convex_from_vertices(points)\nexcept RobotError:\n    pass\n"
    )
    done = subprocess.run([sys.executable, "-c", code], timeout=60, capture_output=True)
    assert done.returncode == 0


def test_vertices_that_are_not_finite_are_refused(rng):
    points = rng.normal(size=(20, 3))
    points[3, 1] = np.nan
    with refused(RobotError, "arm"):
        convex_from_vertices(points, name="arm")


def test_primitives_stay_primitives(silvermate):
    kinds = {type(p.geometry) for p in silvermate.geometries}
    assert kinds == {coal.Cylinder, coal.Box, coal.Sphere}


def mesh(points: np.ndarray) -> coal.CollisionGeometry:
    """A closed triangle mesh of the hull of ``points``, as Pinocchio loads it from a file."""
    hull = ConvexHull(points)
    bvh = coal.BVHModelOBBRSS()
    bvh.beginModel(len(hull.simplices), len(points))
    bvh.addVertices(points)
    bvh.addTriangles(hull.simplices.astype(np.int32))
    bvh.endModel()
    return bvh


def body(*shapes: tuple[coal.CollisionGeometry, tuple[float, float, float]]) -> list:
    """Pieces of a planar root that carries shapes at places."""
    model, geometry = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "root_joint")
    frame = model.addJointFrame(joint)
    for k, (shape, at) in enumerate(shapes):
        pose = pin.SE3(np.eye(3), np.array(at))
        geometry.addGeometryObject(pin.GeometryObject(f"s{k}", joint, frame, pose, shape))
    shapes = convex_shapes(model, geometry)
    return joined_pieces(shapes, np.ones((len(shapes), len(shapes)), dtype=bool))[0]


def test_a_mesh_inside_another_is_dropped_and_neighbours_are_joined(rng):
    big, small = rng.normal(size=(40, 3)), 0.05 * rng.normal(size=(20, 3))
    assert len(body((mesh(big), (0, 0, 0)), (mesh(small), (0, 0, 0)))) == 1
    cube = np.array(np.meshgrid([0, 1], [0, 1], [0, 1]), dtype=float).reshape(3, -1).T
    joined = body((mesh(cube), (0, 0, 0)), (mesh(cube), (1.0, 0, 0)))  # side by side: exactly one box
    assert len(joined) == 1
    corners = np.vstack((cube, cube + np.array([1.0, 0.0, 0.0])))
    assert outside(corners, joined[0].geometry).max() <= 1e-9
    apart = body((mesh(cube), (0, 0, 0)), (mesh(cube), (3.0, 0, 0)))
    assert len(apart) == 2


def test_pieces_have_names_of_their_own():
    """Whatever the links are called: hulls that are joined are called after one of their shapes."""
    ball = coal.Sphere(0.03)
    shapes = []
    for n in range(6):
        T = np.eye(4)
        T[0, 3] = 0.02 * n + (0.0 if n < 3 else 2.0)
        shapes.append(piece_of(f"arm+{n}_0", (f"arm+{n}",), 1, ball, T))
    pieces = joined_pieces(shapes, np.eye(6, dtype=bool))[0]
    assert len({piece.name for piece in pieces}) == len(pieces) == 2


def test_a_hull_contains_what_is_inside_and_nothing_else(rng: np.random.Generator) -> None:
    """Neither what is beside the box about it, nor what is in that box and not in the hull."""
    corners = rng.normal(size=(40, 3)) * (0.1, 0.2, 0.3)
    hull = convex_from_vertices(corners)
    planes = ConvexHull(corners).equations
    points = rng.uniform(1.3 * corners.min(axis=0), 1.3 * corners.max(axis=0), (400, 3))
    inside = (points @ planes[:, :3].T + planes[:, 3]).max(axis=1) <= 0.0
    boxed = ((points >= corners.min(axis=0)) & (points <= corners.max(axis=0))).all(axis=1)
    assert contains(hull, np.vstack((points[inside], corners)))
    for part in (~inside & boxed, ~boxed):
        assert part.sum() > 50
        assert not any(contains(hull, point[None]) for point in points[part])
