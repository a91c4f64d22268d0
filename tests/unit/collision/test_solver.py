"""The way Coal is asked: as good as Coal at its own tolerances, and never nonsense after a hard question."""

from __future__ import annotations

import itertools

import coal
import numpy as np
import pytest
from cases import each, refused

from elastic_strips.coal_shapes import convex_from_vertices, sphere_as_capsule
from elastic_strips.collision.narrowphase import PairSolver, ShapePair

SHAPES = {
    "point": coal.Sphere(1e-6),
    "sphere": coal.Sphere(0.05),
    "box": coal.Box(0.3, 0.4, 0.5),
    "capsule": coal.Capsule(0.05, 0.3),
    "cylinder": coal.Cylinder(0.3, 1.4),
    "drum": coal.Cylinder(0.2, 0.1),
    "cone": coal.Cone(0.2, 0.5),
}

CYLINDER = (
    [
        [-0.840130770851, -0.536834748604, -0.077386953423],
        [0.24904272234, -0.508559869098, 0.824223623777],
        [-0.481827780767, 0.673182970844, 0.560951582088],
    ],
    [-0.990021703946, -0.514777305874, -0.254785091645],
)
OTHER = (
    [
        [-0.825837568557, -0.219155553612, -0.519579785673],
        [-0.55920736384, 0.199554136159, 0.804652267112],
        [-0.072659717769, 0.955064914057, -0.287352702007],
    ],
    [-0.7758922737, -0.795366889989, -0.081852810423],
)


@each("one, two", list(itertools.product(SHAPES, SHAPES)))
def test_never_worse_than_coal_itself(one, two, rng, brief):
    """Random poses and such on a grid, where shapes touch in a point, an edge or a face."""
    solver, pair = PairSolver(), ShapePair.of(SHAPES[one], SHAPES[two])
    a, b = SHAPES[one], SHAPES[two]
    if {type(a), type(b)} == {coal.Sphere, coal.Cylinder}:
        a, b = sphere_as_capsule(a), sphere_as_capsule(b)
    for k in range(90 if brief else 300):
        at = rng.uniform(-0.6, 0.6, 3)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        if k % 3 == 0:
            at, turn = np.round(at, 1), np.eye(3)
        turn[:, 0] *= np.linalg.det(turn)
        poses = coal.Transform3s(turn, at), coal.Transform3s()
        d = solver.ask(pair, *poses)
        own = coal.DistanceResult()
        expected = coal.distance(a, poses[0], b, poses[1], coal.DistanceRequest(True), own)
        assert d == pytest.approx(expected, abs=1e-5 if expected > 0.0 else 1e-4)
        assert np.linalg.norm(solver.result.normal) == pytest.approx(1.0, abs=1e-6)


def test_a_sphere_inside_a_drum_leaves_through_the_lid():
    solver, pair = PairSolver(), ShapePair.of(SHAPES["sphere"], SHAPES["drum"])
    d = solver.ask(pair, coal.Transform3s(np.eye(3), np.array([0.0, 0.03, 0.02])), coal.Transform3s())
    assert d == pytest.approx(-0.03 - 0.05, abs=1e-6)
    np.testing.assert_allclose(solver.result.normal, [0.0, 0.0, -1.0], atol=1e-5)


class Stubborn:
    """A functor that fails, as Coal's do at times, below a tolerance of its solver for penetration."""

    def __init__(self, tolerance: float) -> None:
        self.tolerance, self.asked = tolerance, 0

    def __call__(self, one, two, request, result) -> float:
        self.asked += 1
        return -0.05 if request.epa_tolerance >= self.tolerance else -1.7976931348623157e308


@each("tolerance, tries", [(1e-7, 2), (5e-5, 3), (5e-3, 5)])
def test_a_depth_that_is_not_found_is_asked_for_with_less_demand(tolerance, tries):
    """Seen while driving: two cylinders for which Coal's own tolerance is not reached and −1.8e308 comes back."""
    stubborn = Stubborn(tolerance)
    pair = ShapePair.of(SHAPES["box"], SHAPES["box"])._replace(apart=stubborn, deep=stubborn, fine=Stubborn(np.inf))
    assert PairSolver().ask(pair, coal.Transform3s(), coal.Transform3s()) == -0.05
    assert stubborn.asked == tries + 1


def test_a_depth_that_is_never_found_is_an_error():
    never = Stubborn(np.inf)
    pair = ShapePair.of(SHAPES["box"], SHAPES["box"])._replace(apart=never, deep=never, fine=never)
    with refused(FloatingPointError, "depth"):
        PairSolver().ask(pair, coal.Transform3s(), coal.Transform3s())


def test_where_coal_errs_at_the_finest_tolerance():
    """Two thin cylinders 15.05 mm apart: asked for 1e-12, Coal says 1.7 mm, or that they penetrate, for some poses."""
    one, two = coal.Cylinder(0.0126689066, 0.108068692), coal.Cylinder(0.003, 0.9304797916)
    solver, pair = PairSolver(), ShapePair.of(one, two)
    turn, at = np.array(CYLINDER[0]), np.array(CYLINDER[1])
    other = coal.Transform3s(np.array(OTHER[0]), np.array(OTHER[1]))
    rng = np.random.default_rng(1)
    for _ in range(500):
        pose = coal.Transform3s(turn, at + 1e-9 * rng.normal(size=3))
        assert solver.ask(pair, pose, other) == pytest.approx(0.0150526, abs=1e-6)


class Liar:
    """A functor that says more than is true, with a normal or without."""

    def __init__(self, pair: ShapePair, normal: tuple[float, float, float] | None) -> None:
        self.pair, self.normal = pair, normal

    def __call__(self, one, two, request, result) -> float:
        d = self.pair.apart(one, two, request, result)
        if self.normal is not None:
            result.normal[:] = self.normal
        return d + 0.05


@each("normal", [None, (0.0, 1.0, 0.0), (3.0, 0.0, 0.0), (np.nan, np.nan, np.nan)])
@each("one, two", list(itertools.product(("sphere", "capsule", "drum", "cone", "box", "hull", "egg"), repeat=2)))
def test_more_than_the_supports_leave_is_not_believed(one, two, normal, rng):
    """Whatever a solver says, and whatever it says why; where all lie, nothing is left."""
    shapes = SHAPES | {
        "hull": convex_from_vertices(rng.normal(size=(20, 3)) * 0.2),
        "egg": coal.Ellipsoid(0.1, 0.2, 0.3),
    }
    shapes["drum"].setSweptSphereRadius(0.01)
    pair, solver = ShapePair.of(shapes[one], shapes[two]), PairSolver()
    liar = Liar(pair, normal)
    for _ in range(30):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turn[:, 0] *= np.linalg.det(turn)
        poses = coal.Transform3s(turn, np.array([1.5, *rng.uniform(-0.3, 0.3, 2)])), coal.Transform3s()
        true = solver.ask(pair, *poses)
        assert true > 0.0
        assert true - 1e-4 < solver.ask(pair._replace(apart=liar), *poses) < true + 1e-5
        assert 0.0 <= solver.ask(pair._replace(apart=liar, deep=liar), *poses) < true + 1e-5
    shapes["drum"].setSweptSphereRadius(0.0)
