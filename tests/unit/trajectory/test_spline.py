"""Curves: smooth along their whole length, and inside the hull of what they follow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cases import each
from scipy.interpolate import BSpline

from elastic_strips.trajectory.path import SHAPES, Curve, greville, shapes


def example(rng: np.random.Generator, knots: int) -> tuple[Curve, np.ndarray]:
    places = np.concatenate([[0.0], np.cumsum(rng.uniform(0.04, 0.3, knots - 1))])
    control = rng.normal(size=(knots + 2, 3))
    return Curve.near(places, control), control


@each("knots", [2, 3, 4, 12])
def test_it_is_the_b_spline_of_its_control_points(rng, knots):
    curve, control = example(rng, knots)
    t = np.concatenate([[0.0] * 3, curve.knots, [curve.length] * 3])
    reference = BSpline(t, control, 3)
    s = np.linspace(0.0, curve.length, 301)
    for order, value in enumerate(curve(s)):
        expected = reference.derivative(order)(s) if order else reference(s)
        np.testing.assert_allclose(value, expected, atol=1e-9 * 100.0**order)
    np.testing.assert_allclose(greville(curve.knots), [t[i + 1 : i + 4].mean() for i in range(knots + 2)], atol=1e-14)


def test_a_straight_polyline_stays_straight(rng):
    knots = np.array([0.0, 0.1, 0.15, 0.4, 1.0])
    curve = Curve.near(knots, greville(knots)[:, None] * [2.0, -1.0])
    s = np.linspace(0.0, 1.0, 50)
    y, y1, y2 = curve(s)
    np.testing.assert_allclose(y, s[:, None] * [2.0, -1.0], atol=1e-14)
    np.testing.assert_allclose(y1, np.broadcast_to([2.0, -1.0], y1.shape), atol=1e-12)
    np.testing.assert_allclose(y2, 0.0, atol=1e-10)


def test_it_stays_in_the_hull_of_its_control_points(rng):
    curve, control = example(rng, 15)
    y, _, _ = curve(np.linspace(0.0, curve.length, 2000))
    assert (y <= control.max(axis=0) + 1e-12).all()
    assert (y >= control.min(axis=0) - 1e-12).all()


def shaped(rng: np.random.Generator) -> Curve:
    curve, _ = example(rng, 9)
    edges = curve.length * np.array([0.0, 0.3, 0.55, 1.0])
    return replace(curve, edges=edges, weights=rng.normal(size=(3, SHAPES, 3)))


def test_shapes_join_without_a_kink(rng):
    curve = shaped(rng)
    for edge in [*curve.edges[1:-1], *curve.knots[1:-1]]:
        before, after = (curve(np.array([edge + d])) for d in (-1e-9, 1e-9))
        for one, other, slack in zip(before, after, (1e-6, 1e-5, 1e-3), strict=True):
            np.testing.assert_allclose(one, other, atol=slack)


def test_the_derivatives_are_those_of_the_curve(rng):
    curve = shaped(rng)
    s, h = np.linspace(0.01, curve.length - 0.01, 200), 1e-5
    for order in (0, 1):
        slope = (curve(s + h)[order] - curve(s - h)[order]) / (2.0 * h)
        np.testing.assert_allclose(curve(s)[order + 1], slope, rtol=1e-4, atol=1e-3)


def test_only_steps_stay(rng):
    curve, _ = example(rng, 9)
    weights = rng.normal(size=(2, SHAPES, 3))
    shaped_curve = replace(curve, edges=curve.length * np.array([0.0, 0.5, 1.0]), weights=weights)
    end = shaped_curve(np.array([curve.length]))[0]
    np.testing.assert_allclose(end, curve(np.array([curve.length]))[0] + weights[:, :1].sum(axis=0), atol=1e-12)


def test_shapes_begin_and_end_flat():
    value, rate, bend = shapes(np.array([0.0, 1.0]))
    np.testing.assert_allclose(value, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose([rate, bend], 0.0, atol=1e-9)
    height = np.abs(shapes(np.linspace(0.0, 1.0, 1001))[0]).max(axis=0)
    np.testing.assert_allclose(height, 1.0, atol=0.06)
