"""Followed path: a path of the base that a strip keeps to, within a distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.errors import ParameterError
from elastic_strips.validation import check_array, check_number

from .solver import System

_FREE_SHARE = 0.5
"""Part of the distance within which nothing draws the strip back."""
_GAIN = 20.0
"""With which it is drawn back beyond that, beside ``DeformParams.k_r``."""
_ARC = 0.5 * np.pi
"""An arc of less than half a turn is at most this many times as long as its chord."""


@dataclass(frozen=True, slots=True, eq=False)
class FollowedPath:
    """A path of the base, and how far it may be off.

    Attributes:
        points: (K, 2) waypoints [m], K ≥ 2, joined by straight lines.
        within: largest distance [m] of the base's origin from it.

    Raises:
        ParameterError: points of another shape, or not finite; a distance that is not positive.
    """

    points: Array
    within: float

    def __init__(self, points: npt.ArrayLike, within: float) -> None:
        checked = check_array("path", points, (None, 2))
        if len(checked) < 2:
            raise ParameterError(f"path has {len(checked)} points; at least 2 are needed")
        checked.setflags(write=False)
        object.__setattr__(self, "points", checked)
        object.__setattr__(self, "within", check_number("within", within, above=0.0, unit="m"))

    def nearest(self, xy: Array) -> tuple[Array, Array]:
        """(N, 2) points of the path next to places (N, 2) [m], and the lengths (N,) of the path there."""
        a, way = self.points[:-1], np.diff(self.points, axis=0)
        square = np.maximum((way * way).sum(axis=1), 1e-18)
        part = np.clip(((xy[:, None, :] - a) * way).sum(axis=2) / square, 0.0, 1.0)
        at = a + part[..., None] * way
        k = np.square(xy[:, None, :] - at).sum(axis=2).argmin(axis=1)
        each, size = np.arange(len(xy)), np.sqrt(square)
        passed = np.concatenate([[0.0], np.cumsum(size)[:-1]])
        return at[each, k], passed[k] + part[each, k] * size[k]

    def off(self, xy: Array) -> Array:
        """(N,) distance [m] of places (N, 2) from the path."""
        return np.hypot(*(xy - self.nearest(xy)[0]).T)

    def ahead(self, length: float) -> Array:
        """(L, 2) the rest of the path from a length [m] on."""
        passed = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.points, axis=0).T))])
        k = int(np.searchsorted(passed, length, side="right"))
        if k >= len(passed):
            return self.points[-1:]
        part = (length - passed[k - 1]) / max(float(passed[k] - passed[k - 1]), 1e-9) if k else 0.0
        first = self.points[k - 1] + part * (self.points[k] - self.points[k - 1]) if k else self.points[0]
        return np.vstack([first, self.points[k:]])

    def bound(self, poses: Array) -> Array:
        """(N−1,) bound [m] of the distance from the path on straight lines and arcs between poses (N, 3) x, y [m] and
        yaw [rad] that are less than half a turn apart.

        A point of the chord is no further from the line between the places of the path that are next to its ends than
        the further end is. The path between these two is no further from that line than the half width of an ellipse
        about them; the arc is no further from its chord than in its middle. Where that path is long, the way to the
        nearer end, which is half of the arc at most, says more.
        """
        xy, (at, passed) = poses[:, :2], self.nearest(poses[:, :2])
        off, chord = np.hypot(*(xy - at).T), np.hypot(*np.diff(xy, axis=0).T)
        turn = np.abs(np.remainder(np.diff(poses[:, 2]) + np.pi, 2.0 * np.pi) - np.pi)
        between = np.square(np.diff(passed)) - np.square(np.diff(at, axis=0)).sum(axis=1)
        near = np.maximum(off[:-1], off[1:]) + 0.5 * np.sqrt(np.maximum(between, 0.0))
        near += 0.5 * chord * np.tan(0.25 * turn)
        return np.minimum(near, 0.5 * (off[:-1] + off[1:] + _ARC * chord))

    def push(self, system: System, coordinates: Array) -> None:
        """Add force and matrix of V = Σ ½ k (d − d₀)² over nodes (N, nv) that are further off than a part d₀ of the
        distance."""
        to, _ = self.nearest(coordinates[:, :2])
        out = coordinates[:, :2] - to
        off = np.hypot(out[:, 0], out[:, 1])
        beyond = np.flatnonzero(off > _FREE_SHARE * self.within)
        if not len(beyond):
            return
        away, yaw = out[beyond] / off[beyond, None], coordinates[beyond, 2]
        rows = np.zeros((len(beyond), coordinates.shape[1]))
        rows[:, 0] = np.cos(yaw) * away[:, 0] + np.sin(yaw) * away[:, 1]
        rows[:, 1] = np.cos(yaw) * away[:, 1] - np.sin(yaw) * away[:, 0]
        excess = off[beyond] - _FREE_SHARE * self.within
        system.add_rows(beyond, rows, -_GAIN * excess, np.full(len(beyond), _GAIN))
        system.energies["path"] = 0.5 * _GAIN * float((excess**2).sum())
