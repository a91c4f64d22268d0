"""One step of implicit integration of the overdamped strip: (D + K) δ = Γ, by banded Cholesky."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array, Indices


class System:
    """Accumulates, for N nodes of nv degrees of freedom, forces Γ = −∇V and the Gauss–Newton matrix of V.

    Attributes:
        force: (N, nv) generalised forces in the nodes' tangents (base in its own frame).
        diagonal: (N, nv, nv) blocks; upper: (N−1, nv, nv) blocks that couple node j with j + 1.
        energies: potential of each force [J-like, unit gains].
    """

    def __init__(self, n: int, nv: int) -> None:
        self.force = np.zeros((n, nv))
        self.diagonal = np.zeros((n, nv, nv))
        self.upper = np.zeros((max(n - 1, 0), nv, nv))
        self.energies: dict[str, float] = {}

    def clear(self) -> None:
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


class BandedSolver:
    """Workspace: packs block tridiagonal systems of the inner nodes into LAPACK's band storage and solves them."""

    def __init__(self) -> None:
        self._band = np.zeros((0, 0))
        self._shape = (0, 0)

    def solve(self, system: System, damping: Array) -> Array:
        """Displacements (N, nv) of all nodes; those of the two ends are zero.

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
            raise FloatingPointError(f"the matrix of the step is not positive definite (LAPACK dpbsv: {info})")
        delta[1:-1] = solution.reshape(inner, nv)
        self._band[:] = 0.0
        return delta
