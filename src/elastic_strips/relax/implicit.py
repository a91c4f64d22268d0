"""Implicit update: one step of implicit integration of the overdamped strip, (D + K) δ = Γ, by banded Cholesky."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array

from ..forces import System


class BandedSolver:
    """Workspace: packs block tridiagonal systems of the inner nodes into LAPACK's band storage and solves them."""

    def __init__(self) -> None:
        self._band = np.zeros((0, 0))
        self._shape = (0, 0)

    def solve(self, system: System, damping: Array) -> Array:
        """Displacements (N, nv) of all nodes; the two end nodes stay where they are.

        Args:
            system: forces and blocks.
            damping: (nv,) positive diagonal D.

        Raises:
            FloatingPointError: the matrix is not positive definite (an infinite or NaN entry).
        """
        from scipy.linalg.lapack import dpbsv  # late: slow to import

        n, nv = system.force.shape
        inner = n - 2
        delta = np.zeros((n, nv))
        if inner <= 0:
            return delta
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
            raise FloatingPointError(f"the relaxation matrix is not positive definite (LAPACK dpbsv: {info})")
        delta[1:-1] = solution.reshape(inner, nv)
        self._band[:] = 0.0
        return delta
