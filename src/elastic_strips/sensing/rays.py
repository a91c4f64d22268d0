"""Sensing room, rays: beams in space, and where each of them first meets something."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..robot.space import Array, Indices

_SLACK = 1e-6  # [m] bounding spheres are taken larger by this, so that rounding drops no touching pair


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Beams.

    Attributes:
        origin: (R, 3) where they begin [m]; (1, 3) where all begin at one point.
        direction: (R, 3) of unit length.
    """

    origin: Array
    direction: Array

    def __len__(self) -> int:
        return len(self.direction)

    def moved(self, T: Array) -> Rays:
        """Those of a frame, given in another one in which the frame has the pose ``T`` (4, 4)."""
        turn = T[:3, :3].T
        return Rays(self.origin @ turn + T[:3, 3], self.direction @ turn)

    def seen_from(self, rotation: Array, translation: Array) -> Rays:
        """These rays in the frame that has this pose."""
        return Rays((self.origin - translation) @ rotation, self.direction @ rotation)

    def some(self, index: Indices) -> Rays:
        """Those of these indices."""
        return Rays(self.origin if len(self.origin) == 1 else self.origin[index], self.direction[index])

    def near(self, center: Array, radius: Array, reach: float) -> tuple[Indices, Indices]:
        """Pairs (sphere, ray), spheres ascending, whose ray may meet the sphere within ``reach`` [m].

        Args:
            center: (P, 3) centres of the spheres [m].
            radius: (P,) their radii [m].
            reach: length of the rays [m].
        """
        middle = self.origin.mean(axis=0) if len(self.origin) > 1 else self.origin[0]
        c, o = center - middle, self.origin - middle  # coordinates stay small
        spread = math.sqrt(float(np.einsum("ij,ij->i", o, o).max()))
        close = np.flatnonzero(np.linalg.norm(c, axis=1) <= reach + radius + (spread + _SLACK))
        if len(close) == 0:
            return close, close
        c, r = c[close], (radius[close] + _SLACK)[:, None]
        along = c @ self.direction.T
        square = np.einsum("ij,ij->i", c, c)[:, None]
        if len(o) > 1:
            along -= np.einsum("ij,ij->i", o, self.direction)
            square = square - 2.0 * (c @ o.T) + np.einsum("ij,ij->i", o, o)
        ahead = np.maximum(along, 0.0)
        meets = (square - ahead * (2.0 * along - ahead) <= r * r) & (along <= reach + r)
        sphere, ray = np.divmod(np.flatnonzero(meets), len(self.direction))
        return close[sphere], ray


class Nearest:
    """Workspace: for each of ``count`` rays the nearest thing that it meets.

    Args:
        count: number of rays.
        normals: whether the surfaces' normals are wanted.

    Attributes:
        distance: (count,) [m]; infinite where a ray meets nothing.
        normal: (count, 3) outward normals where rays meet something, in the rays' frame; None if not wanted.
    """

    def __init__(self, count: int, *, normals: bool = False) -> None:
        self.distance = np.full(count, np.inf)
        self.normal = np.zeros((count, 3)) if normals else None

    def closer(self, ray: Indices, distance: Array) -> Indices:
        """Take what is closer than everything so far, and say which of these it is.

        Args:
            ray: (K,) rays, each as often as it meets something.
            distance: (K,) where [m]; infinite where it does not.
        """
        before = self.distance[ray]
        np.minimum.at(self.distance, ray, distance)
        if self.normal is None:
            return np.zeros(0, dtype=np.intp)
        return np.flatnonzero((distance < before) & (distance == self.distance[ray]))
