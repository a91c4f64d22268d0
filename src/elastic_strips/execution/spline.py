"""Curves: smooth splines along a polyline, and local shapes on top that bring the base back to where it should be."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..robot.space import Array

# Powers of u in [0, 1], ascending: a step from 0 to 1, a bump, a bump that changes its sign; the bumps at most about 1
# high. First and second derivatives vanish at both ends, so a piece that has them joins its neighbours smoothly.
_SHAPES = np.array(
    [
        [0.0, 0.0, 0.0, 10.0, -15.0, 6.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 64.0, -192.0, 192.0, -64.0, 0.0],
        [0.0, 0.0, 0.0, -256.0, 1280.0, -2304.0, 1792.0, -512.0],
    ]
)
_SLOPES = _SHAPES[:, 1:] * np.arange(1, _SHAPES.shape[1])
_BENDS = _SLOPES[:, 1:] * np.arange(1, _SLOPES.shape[1])
SHAPES = len(_SHAPES)


def shapes(u: Array) -> tuple[Array, Array, Array]:
    """(G, SHAPES) values at ``u`` (G,) in [0, 1] of the step, the bump and the odd bump, and two derivatives by u."""
    powers = np.vander(u, _SHAPES.shape[1], increasing=True)
    return powers @ _SHAPES.T, powers[:, :-1] @ _SLOPES.T, powers[:, :-2] @ _BENDS.T


def greville(knots: Array) -> Array:
    """(K + 2,) places of the control points of :meth:`Curve.near` over ``knots`` (K,)."""
    t = np.concatenate([[knots[0]] * 2, knots, [knots[-1]] * 2])
    return (t[:-2] + t[1:-1] + t[2:]) / 3.0


@dataclass(frozen=True, eq=False)
class Curve:
    """A twice continuously differentiable curve y(s), s in [0, length].

    Attributes:
        knots: (K,) ascending from 0.
        coefficients: (4, K−1, m) of the pieces, for powers 0 to 3 of s − knot.
        edges: (W + 1,) ends of the windows that have shapes, ascending from 0 to the length.
        weights: (W, SHAPES, m) of the shapes in each; None where there are none.
    """

    knots: Array
    coefficients: Array
    edges: Array
    weights: Array | None = None

    @staticmethod
    def near(knots: Array, control: Array) -> Curve:
        """The cubic spline with the control points (K + 2, m) at the places :func:`greville` of its knots (K,), K ≥ 2.

        With control points of a polyline this is Schoenberg's variation-diminishing spline: it meets both ends in the
        polyline's direction, reproduces straight parts and never leaves the convex hull of the control points; so it
        neither overshoots a joint's range nor swings, as a spline through the points would.
        """
        t = np.concatenate([[knots[0]] * 3, knots, [knots[-1]] * 3])
        h = (knots[1:] - knots[:-1])[:, None]
        first = 3.0 * (control[1:] - control[:-1]) / (t[4:-1] - t[1:-4])[:, None]  # control points of y′ (K + 1)
        bend = 2.0 * (first[1:] - first[:-1]) / (t[4:-2] - t[2:-4])[:, None]  # y″ at the knots (K)
        slope = np.empty_like(bend)  # y′ at the knots
        slope[0], slope[-1] = first[0], first[-1]
        slope[1:-1] = (h[1:] * first[1:-2] + h[:-1] * first[2:-1]) / (h[1:] + h[:-1])
        rise = h * (slope[:-1] + h * (2.0 * bend[:-1] + bend[1:]) / 6.0)
        value = control[0] + np.concatenate([np.zeros((1, control.shape[1])), np.cumsum(rise[:-1], axis=0)])
        cubic = (bend[1:] - bend[:-1]) / (6.0 * h)
        return Curve(knots, np.stack([value, slope[:-1], 0.5 * bend[:-1], cubic]), knots[[0, -1]])

    @property
    def length(self) -> float:
        return float(self.knots[-1])

    def __call__(self, s: Array) -> tuple[Array, Array, Array]:
        """y, y′ and y″ (G, m) at ``s`` (G,)."""
        i = np.searchsorted(self.knots[1:-1], s, side="right")
        x = (s - self.knots[i])[:, None]
        c0, c1, c2, c3 = self.coefficients[:, i]
        y = c0 + x * (c1 + x * (c2 + x * c3))
        y1 = c1 + x * (2.0 * c2 + 3.0 * x * c3)
        y2 = 2.0 * c2 + 6.0 * x * c3
        if self.weights is not None:
            j, u = self.windows(s)
            weight, width = self.weights[j], (self.edges[1:] - self.edges[:-1])[j, None]
            before = np.cumsum(self.weights[:, 0], axis=0) - self.weights[:, 0]  # a step stays
            value, rate, bend = (shape[:, None] for shape in shapes(u))
            y += before[j] + (value @ weight)[:, 0]
            y1 += (rate @ weight)[:, 0] / width
            y2 += (bend @ weight)[:, 0] / (width * width)
        return y, y1, y2

    def windows(self, s: Array) -> tuple[npt.NDArray[np.intp], Array]:
        """The window that each of ``s`` (G,) is in, and where in it, from 0 to 1."""
        j = np.searchsorted(self.edges[1:-1], s, side="right")
        return j, (s - self.edges[j]) / (self.edges[j + 1] - self.edges[j])

    def shaped(self, edges: Array, weights: Array) -> Curve:
        """The same spline with shapes in windows."""
        return replace(self, edges=edges, weights=weights)
