"""The linear system of a relaxation step: forces on the nodes and the block tridiagonal matrix of their potentials."""

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
