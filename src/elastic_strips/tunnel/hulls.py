"""Protective hulls: the free space that a node is known to own, and the paper's connectivity test on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array

from ..summary import Summary


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Tunnel(Summary):
    """Protective hulls of a strip: spheres about its control points (Brock and Khatib's tunnel).

    Attributes:
        points: (N, C, 3) control points [m].
        radius: (N, C) free distance of each, capped at the safe distance [m].
        overlap: (N−1, C) how much neighbouring hulls overlap [m]; negative where there is a gap.
    """

    points: Array
    radius: Array
    overlap: Array

    @property
    def connected(self) -> npt.NDArray[np.bool_]:
        """(N−1,) whether all hulls of a node overlap those of the next."""
        return np.asarray(np.all(self.overlap > 0.0, axis=1), dtype=bool)


def protective_hulls(points: Array, distance: Array, *, cap: float) -> Tunnel:
    """Hulls of control points (N, C, 3) with free distances (N, C), capped at ``cap`` [m], the safe distance.

    Two neighbours are connected where their spheres overlap: then a point can go from one to the other inside free
    space.
    """
    radius = np.clip(distance, 0.0, cap)
    spacing = np.linalg.norm(points[1:] - points[:-1], axis=2)
    return Tunnel(points, radius, radius[1:] + radius[:-1] - spacing)
