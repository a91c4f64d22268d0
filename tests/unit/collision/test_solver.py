"""The way Coal is asked: as good as Coal at its own tolerances, and never nonsense after a hard question."""

from __future__ import annotations

import itertools

import coal
import numpy as np
import pytest

from elastic_strips.collision.narrowphase import PairSolver, ShapePair
from elastic_strips.robot.coal_shapes import sphere_as_capsule

SHAPES = {
    "point": coal.Sphere(1e-6),
    "sphere": coal.Sphere(0.05),
    "box": coal.Box(0.3, 0.4, 0.5),
    "capsule": coal.Capsule(0.05, 0.3),
    "cylinder": coal.Cylinder(0.3, 1.4),
    "drum": coal.Cylinder(0.2, 0.1),
    "cone": coal.Cone(0.2, 0.5),
}


@pytest.mark.parametrize("one, two", list(itertools.product(SHAPES, SHAPES)))
def test_never_worse_than_coal_itself(one, two, rng):
    """Random poses and such on a grid, where shapes touch in a point, an edge or a face."""
    solver, pair = PairSolver(), ShapePair.of(SHAPES[one], SHAPES[two])
    a, b = SHAPES[one], SHAPES[two]
    if {type(a), type(b)} == {coal.Sphere, coal.Cylinder}:
        a, b = sphere_as_capsule(a), sphere_as_capsule(b)
    for k in range(300):
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


@pytest.mark.parametrize("tolerance, tries", [(1e-7, 2), (5e-5, 3), (5e-3, 5)])
def test_a_depth_that_is_not_found_is_asked_for_with_less_demand(tolerance, tries):
    """Seen while driving: two cylinders for which Coal's own tolerance is not reached and −1.8e308 comes back."""
    stubborn = Stubborn(tolerance)
    pair = ShapePair(stubborn, stubborn, Stubborn(np.inf), ())
    assert PairSolver().ask(pair, coal.Transform3s(), coal.Transform3s()) == -0.05
    assert stubborn.asked == tries + 1


def test_a_depth_that_is_never_found_is_an_error():
    never = Stubborn(np.inf)
    with pytest.raises(FloatingPointError, match="no penetration depth"):
        PairSolver().ask(ShapePair(never, never, never, ()), coal.Transform3s(), coal.Transform3s())
