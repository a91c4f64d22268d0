"""Protective hulls: spheres of free space about the control points, and whether neighbours overlap."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from elastic_strips.collision.strip_certificate import protective_hulls
from elastic_strips.scene import Box, Scene, Sphere
from elastic_strips.strip import Deformer, Strip
from elastic_strips.strip.paper import PaperDeformer


def test_radii_are_capped_and_never_negative():
    points = np.zeros((3, 2, 3))
    hulls = protective_hulls(points, np.array([[0.2, 5.0], [-0.3, 0.1], [1.5, 1.6]]), cap=1.5)
    np.testing.assert_array_equal(hulls.radius, [[0.2, 1.5], [0.0, 0.1], [1.5, 1.5]])


def test_overlap_is_what_two_spheres_share_on_the_line_between_them():
    points = np.zeros((3, 2, 3))
    points[1, :, 0], points[2, :, 0] = 1.0, 1.5
    hulls = protective_hulls(points, np.array([[0.6, 0.3], [0.6, 0.3], [0.1, 0.3]]), cap=2.0)
    np.testing.assert_allclose(hulls.overlap, [[0.2, -0.4], [0.2, 0.1]])
    assert hulls.connected.tolist() == [False, True]


def test_touching_hulls_are_not_connected():
    points = np.array([[[0.0, 0, 0]], [[1.0, 0, 0]]])
    assert not protective_hulls(points, np.array([[0.5], [0.5]]), cap=1.0).connected.any()


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    points=arrays(float, (4, 3, 3), elements=st.floats(-2, 2, width=32)),
    distance=arrays(float, (4, 3), elements=st.floats(-1, 3, width=32)),
)
def test_hulls_are_consistent(points, distance):
    hulls = protective_hulls(points, distance, cap=1.5)
    assert (hulls.radius >= 0).all()
    assert (hulls.radius <= 1.5).all()
    for j in range(3):
        for c in range(3):
            gap = np.linalg.norm(points[j + 1, c] - points[j, c])
            np.testing.assert_allclose(hulls.overlap[j, c], hulls.radius[j, c] + hulls.radius[j + 1, c] - gap)


def test_the_papers_hulls_are_free_space(silvermate, rng):
    """No point of a hull lies in an obstacle."""
    scene = Scene([Sphere(0.3, at=(1.0, 0.9, 0.4)), Box((0.3, 0.3, 1.0), at=(2.0, -0.9, 0.5))])
    strip = Strip(silvermate, [silvermate.home(x=x) for x in np.linspace(0, 3, 13)])
    report = PaperDeformer(silvermate).step(strip, scene, detail=True)
    hulls = report.hulls
    assert hulls is not None
    assert hulls.points.shape == (13, 9, 3)
    for n in (0, 5, 12):
        np.testing.assert_allclose(hulls.points[n], silvermate.control_points(report.strip.q[n]), atol=1e-9)
    u = rng.normal(size=(200, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    inside = hulls.points[:, :, None] + (hulls.radius[:, :, None, None] - 1e-4) * u
    assert (np.linalg.norm(inside - [1.0, 0.9, 0.4], axis=-1) > 0.3).all()
    assert not (np.abs(inside - [2.0, -0.9, 0.5]) < [0.15, 0.15, 0.5]).all(axis=-1).any()
    assert hulls.radius.max() > 0.5


def test_the_default_presets_hulls_are_free_of_obstacles(silvermate):
    scene = Scene([Box((0.3, 0.3, 1.0), at=(1.0, 0.7, 0.5))])
    strip = Strip(silvermate, [silvermate.home(x=x) for x in np.linspace(0, 2, 9)])
    report = Deformer(silvermate).assess(strip, scene, detail=True)
    hulls = report.hulls
    assert hulls is not None
    gap = np.maximum(np.abs(hulls.points - [1.0, 0.7, 0.5]) - [0.15, 0.15, 0.5], 0.0)
    assert (hulls.radius <= np.linalg.norm(gap, axis=2) + 1e-9).all()
    assert Deformer(silvermate).assess(strip, scene).hulls is None
