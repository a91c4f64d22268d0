"""How Coal is asked for one distance: to the last digits when separated, as exactly as it can when penetrating.

With Coal's own tolerance of 1e-6 m a distance between round shapes is good to 1e-6 m but its normal only to 1e-3. A
tighter one costs a fifth more and gives normals good to 1e-5. The solver for penetration (EPA) does not always reach
a tighter tolerance and then returns nonsense: its answer counts only where it agrees with the one at Coal's own.
"""

from __future__ import annotations

from typing import NamedTuple

import coal

_TOLERANCE = 1e-12
_AGREEMENT = 1e-4
_FAILED = -1e100
"""Coal says −1.8e308 where its solver for penetration does not converge."""


def distance_request(*, fine_apart: bool = False, fine_deep: bool = False) -> coal.DistanceRequest:
    """A request for a signed distance with witness points and normal, at Coal's own tolerances or at fine ones."""
    request = coal.DistanceRequest(True)
    if fine_apart:
        request.gjk_tolerance = _TOLERANCE
    if fine_deep:
        request.epa_tolerance = _TOLERANCE
    return request


class ShapePair(NamedTuple):
    """Coal's functors for two shapes: ``apart`` to begin with; ``deep`` and ``fine`` once they penetrate.

    They are three because a functor that failed at a fine tolerance may go on failing at any. ``shapes`` are kept
    because a functor does not keep what it was made of.
    """

    apart: coal.ComputeDistance
    deep: coal.ComputeDistance
    fine: coal.ComputeDistance
    shapes: tuple[coal.CollisionGeometry, ...]

    @staticmethod
    def of(one: coal.CollisionGeometry, two: coal.CollisionGeometry) -> ShapePair:
        shapes = one, two
        if {type(one), type(two)} == {coal.Sphere, coal.Cylinder}:
            # Coal's closed form for these two forgets the cylinder's caps once the sphere's centre is inside
            shapes = rounded(one), rounded(two)
        deep, fine = (coal.ComputeDistance(*shapes) for _ in range(2))
        return ShapePair(coal.ComputeDistance(one, two), deep, fine, (one, two, *shapes))


def rounded(geometry: coal.CollisionGeometry) -> coal.CollisionGeometry:
    """A sphere as a capsule of no length, which keeps out of Coal's closed forms for spheres; others as they are."""
    return coal.Capsule(geometry.radius, 0.0) if isinstance(geometry, coal.Sphere) else geometry


class PairSolver:
    """Workspace: requests and one result object."""

    def __init__(self) -> None:
        self.result = coal.DistanceResult()
        self._apart = distance_request(fine_apart=True)
        self._deep = distance_request()
        self._fine = distance_request(fine_apart=True, fine_deep=True)
        self._coarse = []
        for tolerance in (1e-4, 1e-3, 1e-2, 0.1):
            request = distance_request()
            request.epa_tolerance = tolerance
            self._coarse.append(request)

    def ask(self, pair: ShapePair, one: coal.Transform3s, two: coal.Transform3s) -> float:
        """Signed distance [m]; ``result`` then holds the normal and the witness points."""
        result = self.result
        result.clear()
        d = pair.apart(one, two, self._apart, result)
        return d if d > 0.0 else self._penetration(pair, one, two)

    def _penetration(self, pair: ShapePair, one: coal.Transform3s, two: coal.Transform3s) -> float:
        result = self.result
        result.clear()
        deep = pair.deep(one, two, self._deep, result)
        result.clear()
        fine = pair.fine(one, two, self._fine, result)
        if fine > _FAILED and abs(fine - deep) < _AGREEMENT:
            return fine
        for request in (self._deep, *self._coarse):  # even Coal's own tolerance is not always reached
            result.clear()
            deep = pair.deep(one, two, request, result)
            if deep > _FAILED:
                return deep
        raise FloatingPointError("Coal finds no penetration depth of two shapes at any tolerance")
