"""Solver of a step: (D + K) δ = Γ by banded Cholesky, and the rolling constraint v_y = 0 by Newton projection."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from elastic_strips.arrays import Array, Indices
from elastic_strips.constants import ROLLING_LARGEST_STEP, ROLLING_TOLERANCE, ROLLING_YAW_WEIGHT
from elastic_strips.errors import NumericalError
from elastic_strips.native import kernel
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import ConfigurationSpace
from elastic_strips.work import count_work

if TYPE_CHECKING:
    from elastic_strips.native import _native

_PLANE = ConfigurationSpace(
    nq=4,
    nv=3,
    planar=True,
    idx_q=np.zeros(0, dtype=np.intp),
    circular=np.zeros(0, dtype=bool),
    lower=np.full(3, -np.inf),
    upper=np.full(3, np.inf),
)


class System:
    """Accumulates, for N nodes of nv degrees of freedom, forces Γ = −∇V and the Gauss–Newton matrix of V.

    Attributes:
        force: (N, nv) generalised forces in the nodes' tangents (base in its own frame).
        diagonal: (N, nv, nv) blocks; upper: (N−1, nv, nv) blocks that couple node j with j + 1.
        energies: potential of each force [J-like, unit gains].
    """

    def __init__(self, n: int, nv: int) -> None:
        self.force: Array = np.zeros((n, nv))
        self.diagonal: Array = np.zeros((n, nv, nv))
        self.upper: Array = np.zeros((max(n - 1, 0), nv, nv))
        self.energies: dict[str, float] = {}
        module = kernel()
        self.native: _native.System | None = None
        if module is not None:
            self.native = module.System(self.force, self.diagonal, self.upper)

    def clear(self) -> None:
        """Set everything to zero."""
        self.force[:] = 0.0
        self.diagonal[:] = 0.0
        self.upper[:] = 0.0
        self.energies = {}

    def add_rows(self, node: Indices, rows: Array, force: Array, stiffness: Array) -> None:
        """Add scalar residuals that each touch one node.

        Args:
            node: (K,) node of each residual, ascending.
            rows: (K, nv) gradient of the measured quantity (a distance, an angle).
            force: (K,) force along ``rows``.
            stiffness: (K,) second derivative of the potential.
        """
        if len(node) == 0:
            return
        starts = np.flatnonzero(np.r_[True, node[1:] != node[:-1]])
        touched = node[starts]
        self.force[touched] += np.add.reduceat(force[:, None] * rows, starts, axis=0)
        outer = (stiffness[:, None] * rows)[:, :, None] * rows[:, None, :]
        self.diagonal[touched] += np.add.reduceat(outer.reshape(len(node), -1), starts, axis=0).reshape(
            len(touched), *self.diagonal.shape[1:]
        )


class BandedSolver(OneThread):
    """Workspace: packs block tridiagonal systems of the inner nodes into LAPACK's band storage and solves them."""

    def __init__(self) -> None:
        self._band = np.zeros((0, 0))
        self._shape = (0, 0)

    @exclusive
    def solve(self, system: System, damping: Array) -> Array:
        """Displacements (N, nv) of all nodes; those of the two ends are zero.

        Args:
            system: forces and blocks.
            damping: (nv,) positive diagonal D.

        Raises:
            NumericalError: the matrix is not positive definite (an infinite or NaN entry).
        """
        n, nv = system.force.shape
        inner = n - 2
        delta = np.zeros((n, nv))
        if inner <= 0:
            return delta
        if system.native is not None:
            system.native.solve(damping, delta)
            return delta
        from scipy.linalg.lapack import dpbsv  # late: slow to import

        width = 2 * nv
        if self._shape != (inner, nv):
            self._shape = (inner, nv)
            self._band = np.zeros((inner * nv, width))
        band = self._band.reshape(inner, nv, width)
        diagonal = system.diagonal[1:-1]
        upper = system.upper[1:-1]
        for b in range(nv):
            band[:, b, : nv - b] = diagonal[:, b, b:]
            band[:, b, 0] += damping[b]
            band[:-1, b, nv - b : width - b] = upper[:, b, :]
            band[-1, b, nv - b :] = 0.0
        _, solution, info = dpbsv(self._band.T, system.force[1:-1].reshape(-1), lower=1, overwrite_ab=1)
        if info != 0 or not np.isfinite(diagonal).all() or not np.isfinite(solution).all():
            raise NumericalError(f"the matrix of the step is not positive definite (LAPACK dpbsv: {info})")
        delta[1:-1] = solution.reshape(inner, nv)
        self._band[:] = 0.0
        return delta


def project_rolling(space: ConfigurationSpace, coordinates: Array, *, iterations: int = 12) -> tuple[Array, float]:
    """Move the inner nodes' base poses, as little as possible, until every segment can be driven: v_y = 0.

    Each segment has one scalar constraint on its two nodes, so a Newton step is one scalar tridiagonal solve
    C M⁻¹ Cᵀ λ = −c with M = diag(1, 1, w) per node, w the cost of turning.

    Args:
        space: configuration space with a planar root.
        coordinates: (N, nv) nodes; not changed.
        iterations: most Newton steps.

    Returns:
        The projected nodes, and the largest |v_y| [m] that is left (above 1e-9 m if it did not converge).
    """
    coordinates = coordinates.copy()
    module = kernel()
    if module is not None:
        residual, iteration = module.project_rolling(coordinates, iterations)
        count_work(batches=iteration + 1)
        return coordinates, residual
    from scipy.linalg.lapack import dptsv  # late: slow to import

    base, plane = coordinates[:, :3], _PLANE
    inverse_mass = np.array([1.0, 1.0, 1.0 / ROLLING_YAW_WEIGHT])
    residual, iteration = np.inf, 0
    for iteration in range(iterations + 1):
        v = plane.difference(base[:-1], base[1:])
        c = v[:, 1]
        residual = float(np.abs(c).max(initial=0.0))
        if (
            residual <= ROLLING_TOLERANCE
            or iteration == iterations
            or len(coordinates) < 3
            or not np.isfinite(residual)
        ):
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
        if largest > ROLLING_LARGEST_STEP:
            step *= ROLLING_LARGEST_STEP / largest
        base[:] = plane.integrate(base, step)
    count_work(batches=iteration + 1)
    return coordinates, residual
