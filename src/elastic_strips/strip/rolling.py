"""The rolling constraint as an equality: Newton projection of a strip onto the drivable ones."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array

from ..robot import ConfigurationSpace

ROLLING_TOLERANCE = 1e-9
"""Largest sideways travel [m] of a segment that counts as none."""


def project_rolling(
    space: ConfigurationSpace,
    chart: Array,
    *,
    yaw_weight: float = 0.1,
    iterations: int = 12,
    tolerance: float = ROLLING_TOLERANCE,
) -> tuple[Array, float]:
    """Move the inner nodes' base poses, as little as possible, until every segment can be driven: v_y = 0.

    Each segment has one scalar constraint on its two nodes, so a Newton step is one scalar tridiagonal solve
    C M⁻¹ Cᵀ λ = −c with M = diag(1, 1, yaw_weight) per node.

    Args:
        space: configuration space with a planar root.
        chart: (N, nv) nodes; not changed.
        yaw_weight: cost of turning against moving [m²/rad²].
        iterations: most Newton steps.
        tolerance: residual to reach [m].

    Returns:
        The projected nodes, and the largest |v_y| [m] that is left (above ``tolerance`` if it did not converge).
    """
    from scipy.linalg.lapack import dptsv  # late: slow to import

    chart = chart.copy()
    base = chart[:, :3]
    plane = _plane()
    inverse_mass = np.array([1.0, 1.0, 1.0 / yaw_weight])
    residual = np.inf
    for iteration in range(iterations + 1):
        v = plane.difference(base[:-1], base[1:])
        c = v[:, 1]
        residual = float(np.abs(c).max(initial=0.0))
        if residual <= tolerance or iteration == iterations or len(chart) < 3 or not np.isfinite(residual):
            break
        first, second = plane.base_difference_jacobians(v)
        row_a, row_b = first[:, 1, :].copy(), second[:, 1, :].copy()
        row_a[0] = 0.0  # the end nodes do not move
        row_b[-1] = 0.0
        weighted_a, weighted_b = row_a * inverse_mass, row_b * inverse_mass
        diagonal = np.einsum("ij,ij->i", row_a, weighted_a) + np.einsum("ij,ij->i", row_b, weighted_b)
        diagonal += 1e-12
        off = np.einsum("ij,ij->i", row_b[:-1], weighted_a[1:])
        _, _, multiplier, info = dptsv(diagonal, off, -c)
        if info != 0:
            break
        step = np.zeros_like(base)
        step[:-1] += weighted_a * multiplier[:, None]
        step[1:] += weighted_b * multiplier[:, None]
        largest = float(np.abs(step).max())
        if largest > 0.5:
            step *= 0.5 / largest
        base[:] = plane.integrate(base, step)
    return chart, residual


def _plane() -> ConfigurationSpace:
    return _PLANE


_PLANE = ConfigurationSpace(
    nq=4,
    nv=3,
    planar=True,
    idx_q=np.zeros(0, dtype=np.intp),
    circular=np.zeros(0, dtype=bool),
    lower=np.full(3, -np.inf),
    upper=np.full(3, np.inf),
)
