"""Bubbles: discs in which a round base is free, their forces, and chains of them. Source: see :mod:`.elastic_band`."""

from __future__ import annotations

import numpy as np

from ..robot.space import Array


class FreeDistance:
    """ρ(b): how far a round base at b is from the nearest sensed point.

    Args:
        points: (P, 2) sensed points [m].
        radius: of the base [m].
        most: where nothing is near, ρ is this [m].
    """

    def __init__(self, points: Array, radius: float, most: float) -> None:
        from scipy.spatial import cKDTree  # late: slow to import

        self._tree = cKDTree(points) if len(points) else None
        self._radius, self.most = radius, most

    def __call__(self, at: Array) -> Array:
        """(…,) ρ [m] at points (…, 2); negative where the base would overlap a point."""
        if self._tree is None:
            return np.full(at.shape[:-1], self.most)
        distance, _ = self._tree.query(at, distance_upper_bound=self.most + self._radius)
        return np.minimum(distance - self._radius, self.most)

    def gradient(self, at: Array, step: Array) -> Array:
        """(N, 2) ∂ρ/∂b at points (N, 2) by central differences over ``step`` (N,) [m]."""
        h = step[:, None]
        x, y = h * np.array([1.0, 0.0]), h * np.array([0.0, 1.0])
        ahead, behind, left, right = self(np.stack((at + x, at - x, at + y, at - y)))
        return np.stack((ahead - behind, left - right), axis=1) / (2.0 * h)


def contraction_force(chain: Array, gain: float) -> Array:
    """(N − 2, 2) k_c ((b₋ − b)/|b₋ − b| + (b₊ − b)/|b₊ − b|) on the inner bubbles of a chain (N, 2)."""
    step = np.diff(chain, axis=0)
    unit = step / np.maximum(np.hypot(step[:, 0], step[:, 1]), 1e-9)[:, None]
    return gain * (unit[1:] - unit[:-1])


def repulsion_force(free: FreeDistance, centers: Array, rho: Array, gain: float, influence: float) -> Array:
    """(M, 2) k_r (ρ0 − ρ) ∂ρ/∂b where ρ < ρ0, else zero: minus the gradient of ½ k_r (ρ0 − ρ)².

    The gradient is taken over the bubble's own size, so that in the middle of a gap it vanishes.
    """
    force = np.zeros_like(centers)
    near = rho < influence
    if near.any():
        slope = free.gradient(centers[near], np.maximum(rho[near], 0.02))
        force[near] = gain * (influence - rho[near])[:, None] * slope
    return force


def without_tangent(force: Array, chain: Array) -> Array:
    """(N − 2, 2) f − (f·e) e, e along b₋ − b₊: forces on the inner bubbles that do not push them along the chain."""
    along = chain[:-2] - chain[2:]
    square = np.maximum((along**2).sum(axis=1), 1e-12)
    return force - ((force * along).sum(axis=1) / square)[:, None] * along


def relaxed(chain: Array, free: FreeDistance, *, contraction: float, repulsion: float, influence: float) -> Array:
    """The chain (N, 2) after one step along its forces; its ends stay.

    A bubble moves by its size times its force. Ours: a neighbour that is nearer bounds the step instead of the size,
    and no step is longer than half of that; else small bubbles among large ones would swing.
    """
    if len(chain) < 3:
        return chain
    rho = free(chain[1:-1])
    force = contraction_force(chain, contraction) + repulsion_force(free, chain[1:-1], rho, repulsion, influence)
    force = without_tangent(force, chain)
    gap = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    scale = np.minimum(np.maximum(rho, 0.05), np.minimum(gap[1:], gap[:-1]))
    size = np.linalg.norm(force, axis=1)
    move = scale * np.minimum(1.0, 0.5 / np.maximum(size, 1e-12))
    out = chain.copy()
    out[1:-1] += move[:, None] * force
    return out


def connected(chain: Array, free: FreeDistance, *, least: float, overlap: float, most: int) -> Array | None:
    """The chain with bubbles put in where neighbours do not overlap; None where it is broken.

    It is broken where a bubble (but for the first, where the base is) is smaller than ``least``, or where it would
    need more than ``most`` bubbles.

    Args:
        chain: (N, 2) centers [m].
        free: ρ.
        least: smallest bubble [m].
        overlap: neighbours are at most this times the sum of their sizes apart; < 1.
        most: largest number of bubbles.
    """
    rho = free(chain)
    while True:
        if (rho[1:] < least).any():
            return None
        size = np.maximum(rho, least)
        gap = np.linalg.norm(np.diff(chain, axis=0), axis=1)
        wide = np.flatnonzero(gap > overlap * (size[1:] + size[:-1]))
        if not len(wide):
            return chain
        if len(chain) + len(wide) > most:
            return None
        middles = 0.5 * (chain[wide] + chain[wide + 1])
        rho = np.insert(rho, wide + 1, free(middles))
        chain = np.insert(chain, wide + 1, middles, axis=0)


def thinned(chain: Array, free: FreeDistance, *, least: float, overlap: float) -> Array:
    """The chain without the bubbles whose neighbours overlap without them."""
    if len(chain) < 3:
        return chain
    size = np.maximum(free(chain), least).tolist()
    points = chain.tolist()
    kept = [0]
    for i in range(1, len(points) - 1):
        (x0, y0), (x1, y1) = points[kept[-1]], points[i + 1]
        if (x1 - x0) ** 2 + (y1 - y0) ** 2 > (overlap * (size[kept[-1]] + size[i + 1])) ** 2:
            kept.append(i)
    return chain[[*kept, len(points) - 1]]
