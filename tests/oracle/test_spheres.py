"""The spheres that hold a robot's links: from the definition, on points of their surfaces."""

from __future__ import annotations

import coal
import numpy as np
import pytest
from cases import each

from elastic_strips.arrays import Array
from elastic_strips.coal_shapes import ShapeKind, shape_of, vertices
from elastic_strips.collision.native_side import native_solid
from elastic_strips.native import kernel
from elastic_strips.robot import load_robot

POINTS = 3000  # of each surface
MOST_LEAVES = 64
ROUNDING = 1e-9  # [m] of these very computations


def directions(rng: np.random.Generator, count: int) -> Array:
    v = rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def surface(geometry: coal.CollisionGeometry, rng: np.random.Generator) -> Array:
    """Points of a shape's surface, its corners and edges among them."""
    kind, half = shape_of(geometry)
    swept, signs = geometry.getSweptSphereRadius(), np.array([-1.0, 1.0])
    if kind is ShapeKind.CONVEX:
        corners = vertices(geometry)
        triangles = np.array([[geometry.polygons(i)[k] for k in range(3)] for i in range(geometry.num_polygons)])
        weights = rng.dirichlet(np.full(3, 0.5), POINTS)
        inner = np.einsum("nk,nkc->nc", weights, corners[triangles[rng.integers(0, len(triangles), POINTS)]])
        points = np.concatenate([corners, inner])
    elif kind is ShapeKind.BOX:
        points = rng.uniform(-1.0, 1.0, (POINTS, 3))
        points[np.arange(POINTS), rng.integers(0, 3, POINTS)] = rng.choice(signs, POINTS)
        points[:100] = rng.choice(signs, (100, 3))
        points = points * half
    elif kind is ShapeKind.SPHERE:
        points = directions(rng, POINTS) * half[0]
    elif kind is ShapeKind.CAPSULE:
        out = directions(rng, POINTS)
        side = rng.random(POINTS) < 0.4
        out[side, 2] = 0.0
        points = half[0] * out / np.linalg.norm(out, axis=1)[:, None]
        points[:, 2] += half[1] * np.where(side, rng.uniform(-1.0, 1.0, POINTS), np.where(out[:, 2] < 0.0, -1.0, 1.0))
    elif kind is ShapeKind.CYLINDER:
        angle, cap = rng.uniform(-np.pi, np.pi, POINTS), rng.random(POINTS) < 0.3
        radius = half[0] * np.where(cap, np.sqrt(rng.random(POINTS)), 1.0)
        z = half[1] * np.where(cap | (rng.random(POINTS) < 0.3), rng.choice(signs, POINTS), rng.uniform(-1, 1, POINTS))
        points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])
    elif kind is ShapeKind.CONE:
        angle, part = rng.uniform(-np.pi, np.pi, POINTS), np.sqrt(rng.random(POINTS))
        part[:100] = 1.0
        points = np.column_stack(
            [half[0] * part * np.cos(angle), half[0] * part * np.sin(angle), half[1] * (1.0 - 2.0 * part)]
        )
    else:
        points = directions(rng, POINTS) * np.asarray(half)
    return points if swept == 0.0 else points + swept * directions(rng, len(points))


def spheres_of(geometry: coal.CollisionGeometry) -> Array:
    """(K, 6): centres, outer and inner radii, and the next sphere that is not below."""
    module = kernel()
    if module is None:
        pytest.skip("there is no kernel")
    return np.array(module.spheres(native_solid(module, geometry), MOST_LEAVES, 1e-3))


def check(geometry: coal.CollisionGeometry, rng: np.random.Generator) -> None:
    spheres, points = spheres_of(geometry), surface(geometry, rng)
    distance = np.linalg.norm(points[:, None] - spheres[None, :, :3], axis=2)
    held = distance <= spheres[:, 3] + ROUNDING
    below = spheres[:, 5].astype(int)
    leaves = below == np.arange(len(spheres)) + 1
    assert 0 < leaves.sum() <= MOST_LEAVES
    assert held[:, leaves].any(axis=1).all()
    # a part of the body is in each sphere: what no leaf outside of it holds is in it
    for k in np.flatnonzero(~leaves):
        outside = leaves.copy()
        outside[k : below[k]] = False
        alone = ~held[:, outside].any(axis=1)
        assert held[alone, k].all()
    within = spheres[:, 4] > 0.0
    if geometry.getSweptSphereRadius() == 0.0:  # else the points are within, too
        assert (distance[:, within] >= spheres[within, 4] - ROUNDING).all(), "an inner sphere sticks out"


@each("name", ["silvermate", "bridge-arm", "panda", "tiago"])
def test_spheres_hold_the_links_of_robots(name: str) -> None:
    rng = np.random.default_rng(1)
    for piece in load_robot(name).geometries:
        check(piece.geometry, rng)


def test_spheres_hold_shapes_of_every_kind() -> None:
    rng = np.random.default_rng(2)
    for _ in range(6):
        a, b, c = rng.uniform(0.01, 0.4, 3).tolist()
        for shape in (
            coal.Box(a, b, c), coal.Sphere(a), coal.Capsule(a, b), coal.Cylinder(a, b), coal.Cone(a, b),
            coal.Ellipsoid(a, b, c), coal.Box(a, 1e-4, c),
        ):  # fmt: skip
            check(shape, rng)
            shape.setSweptSphereRadius(0.03)
            check(shape, rng)
