"""Conventions of the exact queries: the direction is the gradient of the distance, the witnesses lie on the shapes."""

from __future__ import annotations

import coal
import numpy as np
import pytest
from brute_force import (
    SHAPES,
    configuration,
    distance,
    link_poses,
    make_scene,
    outside,
    random_coordinates,
    support,
    transform,
)
from cases import each
from scipy.optimize import minimize

from elastic_strips.coal_shapes import convex_from_vertices
from elastic_strips.collision import BodySet, ObstacleProximity
from elastic_strips.collision.narrowphase import GJK_EXCESS
from elastic_strips.robot import Kinematics
from elastic_strips.scene import Box, Cylinder, Scene, Sphere

STEP = 1e-4


def part_shapes(scene: Scene, row: int) -> list[tuple[coal.CollisionGeometry, np.ndarray]]:
    """World shapes of a row of the scene's table."""
    table = scene.table
    part, T = table.parts[row], np.eye(4)
    T[:3, :3], T[:3, 3] = table.rotation[row], table.translation[row]
    if part.geometry is not None:
        return [(part.geometry, T)]
    out = []
    for box, at in part.boxes:
        shift = np.eye(4)
        shift[:3, 3] = at
        out.append((box, T @ shift))
    return out


def local(point: np.ndarray, T: np.ndarray) -> np.ndarray:
    """A world point as (1, 3) in the frame T."""
    return ((point - T[:3, 3]) @ T[:3, :3])[None]


def nearest(shape: coal.CollisionGeometry, T: np.ndarray, others: list) -> float:
    return min(distance(shape, T, other, T_other)[0] for other, T_other in others)


def gradient(shape: coal.CollisionGeometry, T: np.ndarray, others: list) -> tuple[np.ndarray, float]:
    """∂d/∂translation of a shape by central differences, and how much the one-sided slopes disagree (kinks)."""
    here, slope, kink = nearest(shape, T, others), np.zeros(3), 0.0
    for i in range(3):
        ahead, back = T.copy(), T.copy()
        ahead[i, 3] += STEP
        back[i, 3] -= STEP
        up, down = nearest(shape, ahead, others), nearest(shape, back, others)
        slope[i] = (up - down) / (2 * STEP)
        kink = max(kink, abs(up + down - 2 * here) / STEP)
    return slope, kink


@pytest.mark.parametrize("name", ["silvermate", "tiago", "gantry"])
def test_direction_is_the_gradient_and_witnesses_lie_on_both_shapes(name, request, brief):
    robot, rng = request.getfixturevalue(name), np.random.default_rng(8)
    seen: dict[tuple[str, bool], int] = {}
    for _ in range((20 if brief else 36) if name == "gantry" else 12):  # it seldom is in something
        scene = make_scene(rng, 18)
        coordinates = random_coordinates(robot, rng, 6)
        kin = Kinematics(robot.tree, 6)
        kin.update(coordinates)
        proximity = ObstacleProximity(BodySet.links(robot), influence=0.25)
        proximity.update(kin, scene)
        c = proximity.contacts()
        for k in rng.permutation(len(c))[:60].tolist():
            link = robot.geometries[c.body[k]].geometry
            T = link_poses(robot, configuration(robot, coordinates[c.node[k]]))[c.body[k]]
            row = int(proximity.candidates.rows[c.part[k]])
            others = part_shapes(scene, row)
            inside = c.distance[k] < 0
            if inside and len(others) > 1:
                continue  # of a block of boxes, the first that penetrates is reported
            slope, kink = gradient(link, T, others)
            if kink > 1e-2:
                continue  # two features are equally near
            np.testing.assert_allclose(c.direction[k], slope, atol=3e-2)
            # the witness lies on the robot, and going back by the distance leads onto the obstacle
            assert abs(outside(local(c.witness[k], T), link)[0]) < 1e-4
            there = c.witness[k] - c.distance[k] * c.direction[k]
            assert min(abs(outside(local(there, T_other), other)[0]) for other, T_other in others) < 1e-4
            key = (scene.obstacles[int(scene.table.obstacle_index[row])].shape, bool(inside))
            seen[key] = seen.get(key, 0) + 1
    assert len({shape for shape, _ in seen}) >= len(SHAPES) - (name == "gantry")
    assert sum(n for (_, inside), n in seen.items() if inside) >= 15


def test_signs_where_they_are_known(silvermate):
    """A sphere in front of the robot: the way out is backwards, whether it touches or not."""
    coordinates = silvermate.space.to_coordinates(silvermate.home())[None]
    kin = Kinematics(silvermate.tree, 1)
    kin.update(coordinates)
    for x, inside in ((0.55, False), (0.45, False), (0.32, True), (0.25, True)):
        proximity = ObstacleProximity(BodySet.links(silvermate), influence=0.4)
        proximity.update(kin, Scene([Sphere(0.1, at=(x, 0.0, 0.15))]))
        c = proximity.contacts()
        k = int(np.flatnonzero(c.body == 0)[0])
        assert (c.distance[k] < 0) is np.bool_(inside)
        assert c.direction[k] @ [-1.0, 0.0, 0.0] > 0.99


def test_the_same_query_twice_gives_the_same_answer(silvermate, rng):
    """Result objects are reused: nothing of the last pair may stay in them."""
    scene = Scene([Box((0.3, 0.3, 0.3), at=(0.6, 0.1, 0.5)), Cylinder(0.1, 0.5, at=(-0.5, 0.3, 0.5))])
    coordinates = random_coordinates(silvermate, rng, 4)
    kin = Kinematics(silvermate.tree, 4)
    kin.update(coordinates)
    proximity = ObstacleProximity(BodySet.links(silvermate), influence=5.0)
    proximity.update(kin, scene)
    first = proximity.contacts()
    proximity.reset()
    proximity.update(kin, scene)
    second = proximity.contacts()
    for name in ("node", "body", "part", "distance", "direction", "witness"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert len(first) == 4 * 2 * len(silvermate.geometries)


@each("size", [1.0, 10.0, 100.0])
def test_coal_over_reports_by_less_than_its_allowance(size, rng, brief):
    """The allowance that every bound subtracts, against cylinders above a slab, whose distance is known exactly."""
    assert over_report(size, rng, 1500 if brief else 6000) < GJK_EXCESS


def over_report(size: float, rng: np.random.Generator, count: int = 6000) -> float:
    """Largest excess [m] of Coal's distance of a cylinder above a slab of ``size`` [m]."""
    slab, worst = coal.Box(size, size, 1.0), 0.0
    request, result = coal.DistanceRequest(True), coal.DistanceResult()
    for _ in range(count):
        r, h, gap = rng.uniform(0.03, 0.3), rng.uniform(0.05, 1.0), 10.0 ** rng.uniform(-4, -0.5)
        T = np.eye(4)
        T[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        T[:3, 0] *= np.sign(np.linalg.det(T[:3, :3]))
        reach = 0.5 * h * abs(T[2, 2]) + r * np.sqrt(max(0.0, 1.0 - T[2, 2] ** 2))
        T[:3, 3] = *(rng.uniform(-0.45, 0.45, 2) * size * (size > 2.0)), 0.5 + gap + reach
        if size <= 2.0 and r + h > 0.5 * size:
            continue  # it would overhang
        result.clear()
        d = coal.distance(coal.Cylinder(r, h), transform(T), slab, transform(np.eye(4)), request, result)
        worst = max(worst, d - gap)
    return worst


def test_coals_distances_against_support_functions(rng):
    """Not by Coal at all: the distance of convex shapes is the largest gap between their supports in any direction."""
    hulls = [convex_from_vertices(rng.normal(size=(14, 3)) * 0.2) for _ in range(3)]
    links = [coal.Cylinder(0.1, 0.4), coal.Sphere(0.08), coal.Box(0.3, 0.2, 0.1), hulls[0]]
    others = [coal.Box(0.5, 0.3, 0.2), coal.Sphere(0.2), coal.Cylinder(0.2, 0.6), coal.Capsule(0.1, 0.5)]
    others += [coal.Cone(0.2, 0.5), *hulls[1:]]
    starts = rng.normal(size=(300, 3))
    for _ in range(70):
        one, two = links[rng.integers(len(links))], others[rng.integers(len(others))]
        A, B = (np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(2))
        A[:, 0] *= np.linalg.det(A)
        B[:, 0] *= np.linalg.det(B)
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        reach = support(one, (way @ A)[None])[0] + support(two, (-way @ B)[None])[0]
        shift = way * (reach + 10.0 ** rng.uniform(-4, -1))

        def gap(n: np.ndarray, one=one, two=two, A=A, B=B, shift=shift) -> np.ndarray:
            n = n / np.linalg.norm(n, axis=1)[:, None]
            return n @ shift - support(one, n @ A) - support(two, -n @ B)

        best = starts[int(np.argmax(gap(starts)))]
        for _ in range(3):
            best = minimize(lambda x: -gap(x[None])[0], best, method="Nelder-Mead", options={"xatol": 1e-10}).x
        T_one, T_two = np.eye(4), np.eye(4)
        T_one[:3, :3], T_two[:3, :3], T_two[:3, 3] = A, B, shift
        expected = float(gap(best[None])[0])
        assert expected > 0.0
        assert distance(one, T_one, two, T_two)[0] == pytest.approx(expected, abs=GJK_EXCESS)


def test_control_points_inside_a_cylinder(silvermate):
    """The way out of a flat drum is through its lid, not through its side."""
    drum = Scene([Cylinder(1.0, 0.2, at=(0.0, 0.0, 0.05))])
    kin = Kinematics(silvermate.tree, 1)
    kin.update(silvermate.space.to_coordinates(silvermate.home())[None])
    proximity = ObstacleProximity(BodySet.control_points(silvermate), influence=1.0)
    proximity.update(kin, drum)
    c = proximity.contacts()
    base = int(np.flatnonzero(c.body == 0)[0])
    assert c.distance[base] == pytest.approx(-0.05, abs=1e-5)
    np.testing.assert_allclose(c.direction[base], [0.0, 0.0, -1.0], atol=1e-5)
