"""Meshes: closed, outward, of the right size, and with normals that are smooth where they should be."""

from __future__ import annotations

import coal
import numpy as np
import pytest
from cases import each

from elastic_strips.viewer import geometry


def volume(mesh: geometry.MeshData) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, i]].astype(float) for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


@each(
    ("shape", "expected", "tolerance"),
    [
        (coal.Box(0.4, 0.6, 0.8), 0.192, 1e-5),
        (coal.Sphere(0.5), 4 / 3 * np.pi * 0.125, 0.05),
        (coal.Cylinder(0.3, 1.0), np.pi * 0.09, 0.02),
        (coal.Capsule(0.3, 1.0), np.pi * 0.09 + 4 / 3 * np.pi * 0.027, 0.05),
        (coal.Cone(0.3, 1.0), np.pi * 0.03, 0.02),
        (coal.Ellipsoid(0.2, 0.3, 0.4), 4 / 3 * np.pi * 0.024, 0.05),
    ],
)
def test_primitives_have_their_volume(shape, expected, tolerance):
    mesh = geometry.from_coal(shape)
    assert mesh is not None
    assert volume(mesh) == pytest.approx(expected, rel=tolerance)
    assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-5)


def test_primitives_stand_where_coal_has_them():
    for shape in (coal.Cylinder(0.3, 1.0), coal.Cone(0.3, 1.0), coal.Capsule(0.3, 1.0), coal.Box(0.2, 0.4, 0.6)):
        shape.computeLocalAABB()
        mesh = geometry.from_coal(shape)
        assert mesh is not None
        assert np.allclose(mesh.vertices.min(axis=0), shape.aabb_local.min_, atol=2e-3)
        assert np.allclose(mesh.vertices.max(axis=0), shape.aabb_local.max_, atol=2e-3)
    cone = geometry.cone()
    assert np.allclose(cone.vertices[cone.vertices[:, 2].argmax()], [0, 0, 0.5], atol=1e-6)  # apex up


def test_normals_are_sharp_on_a_box_and_smooth_on_a_sphere():
    box = geometry.box()
    assert len(box.vertices) == 24  # every corner once per side
    assert np.allclose(np.abs(box.normals).max(axis=1), 1.0)
    assert np.einsum("ij,ij->i", box.vertices, box.normals).min() > 0.4  # outward
    sphere = geometry.sphere()
    assert np.einsum("ij,ij->i", sphere.vertices, sphere.normals).min() > 0.98


def test_hull_of_a_coal_convex():
    points = coal.StdVec_Vec3s()
    points.extend([np.array(p, dtype=float) for p in ([0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1])])
    mesh = geometry.from_coal(coal.Convex.convexHull(points, True, "Qt"))
    assert mesh is not None
    assert volume(mesh) == pytest.approx(1 / 6, rel=1e-6)


def test_triangle_soup_of_a_mesh_file_becomes_one_surface():
    model = coal.BVHModelOBBRSS()
    box = geometry.box()
    model.beginModel(len(box.faces), len(box.vertices))
    for face in box.faces:
        model.addTriangle(*(box.vertices[i].astype(float) for i in face))
    model.endModel()
    mesh = geometry.from_coal(model)
    assert mesh is not None
    assert volume(mesh) == pytest.approx(1.0, rel=1e-5)


def test_what_has_no_surface_is_left_out():
    assert geometry.from_coal(coal.Plane(np.array([0.0, 0.0, 1.0]), 0.0)) is None


def test_merged_keeps_every_triangle_and_colour():
    red, blue = geometry.box().colored((1, 0, 0)), geometry.sphere().colored((0, 0, 1))
    both = geometry.merged([red, blue])
    assert len(both.faces) == len(red.faces) + len(blue.faces)
    assert both.colors is not None
    assert volume(both) == pytest.approx(volume(red) + volume(blue), rel=1e-6)
    assert geometry.merged([red, geometry.box()]).colors is None


def test_clustered_is_coarser_and_about_as_large():
    fine = geometry.sphere(96)
    coarse = geometry.clustered(fine, 0.15)
    assert len(coarse.faces) < len(fine.faces) / 4
    assert abs(volume(coarse)) == pytest.approx(volume(fine), rel=0.15)
    small = geometry.box().scaled((0.1, 0.1, 0.1)).transformed([[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1], [0, 0, 0, 1]])
    assert geometry.clustered(small, 10.0) is small  # nothing would be left


def test_linear_colours():
    assert geometry.linear("#ffffff") == pytest.approx((1, 1, 1))
    assert geometry.linear("#000000") == pytest.approx((0, 0, 0))
    assert geometry.linear((0.5, 0.5, 0.5))[0] == pytest.approx(0.2140, abs=1e-4)
