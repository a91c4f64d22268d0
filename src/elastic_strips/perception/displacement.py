"""Displacement: by how much the points of an image are turned and shifted all together, and the robust fit of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask

from .readings import DepthImage, RangeImage
from .volume_map import VolumeMapParams

_MOST_TILTED = 0.007  # [rad] against the floor
_MOST_TURNED = 0.05  # [rad] against what was seen before
MOST_SHIFTED = 0.1  # [m]
SURE = 3.0  # standard deviations
_LEAST_COMPARED = 60  # points
_AGREEING = 0.6  # of them have to agree with the displacement that is found
ALIKE = 2.0  # times as unsure as if the errors of neighbouring pixels had nothing in common
PIXELS = 0.01  # [m] by which a point is off its surface because pixels are not points

_ROUNDS = 6  # of a fit
_SETTLED = 1e-5  # [m, rad] a fit that changes by less is done
_FLOOR_BEFORE = (0.3, 0.3, 1e-6, 1e-6, 1e-6, 0.02)  # [rad, m] standard deviations of what the floor tells, a priori
_NEIGHBOURS = (3, 4)  # rows or columns of the points that are looked at, from one to another
_NEIGHBOURS_TELL = 0.63  # part of the least tilt that counts, which has to be between neighbours, too
_NEIGHBOUR_ROUNDS = (4, 10)  # of their fit: until edges count nothing, and all
_EDGE = 3.0  # times the median of what is left, from which on a difference is that of an edge
_LEAST_SIGMA = 0.002  # [m] of a range

_ACROSS = 32  # points along an image's rows and columns
_FLOOR = (0.05, 0.06)  # [m], and part of the range, up to which what lies flat is taken to be the floor
_UPRIGHT = 0.9  # cosine between a flat surface's normal and the vertical
_FACING = 0.35  # least cosine between a surface's normal and the ray
_ONE_SURFACE = (0.05, 0.05)  # [m], and part of the range, by which neighbours on one surface differ


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """Points (n, 3) of an image in the world [m], the normals (n, 3) of the surfaces there, standard deviations (n,)
    [m], and the row and column (n, 2) of each in the grid of those that were looked at."""

    points: Array
    normals: Array
    sigma: Array
    cells: Indices

    def some(self, which: Mask) -> Surfaces:
        return Surfaces(self.points[which], self.normals[which], self.sigma[which], self.cells[which])

    def floor(self, T_world_sensor: Array) -> Mask:
        """Which of the points (n,) may be of the floor."""
        away = np.linalg.norm(self.points - T_world_sensor[:3, 3], axis=1)
        return (self.normals[:, 2] > _UPRIGHT) & (np.abs(self.points[:, 2]) < _FLOOR[0] + _FLOOR[1] * away)


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """The turn and shift that bring points best to where they were; the turn (3,) is a rotation vector [rad], and the
    shift raises them by some of its length [m]."""

    turn: Array
    compared: int
    turned: float
    shifted: float
    turned_sigma: float
    shifted_sigma: float
    agreeing: float
    raised: float = 0.0
    least: int = _LEAST_COMPARED

    @property
    def judges(self) -> bool:
        """Whether it says something."""
        return self.compared >= self.least and self.agreeing >= _AGREEING

    @property
    def large(self) -> bool:
        """Whether it is larger than errors are."""
        return self.judges and (self.turned > self.most_turned or self.shifted > self.most_shifted)

    @property
    def most_turned(self) -> float:
        """By how much what is in its place looks turned at most [rad]."""
        return _MOST_TURNED + SURE * self.turned_sigma

    @property
    def most_shifted(self) -> float:
        """By how much it looks shifted at most [m]."""
        return MOST_SHIFTED + SURE * self.shifted_sigma

    @property
    def least_tilt(self) -> float:
        """By how much a level floor looks tilted at most [rad]."""
        return _MOST_TILTED + SURE * self.turned_sigma

    @property
    def tilted(self) -> bool:
        """Whether it is more than that."""
        return self.judges and self.turned > self.least_tilt


UNKNOWN = Displacement(np.zeros(3), 0, 0.0, 0.0, math.inf, math.inf, 0.0)
Weight = Callable[[Array, int], Array]
"""How much equations (n,) count that are off by so many standard deviations, in a round of a fit."""


def find_surfaces(image: DepthImage | RangeImage, T_world_sensor: Array, params: VolumeMapParams) -> Surfaces:
    """Some points of an image with their surfaces.

    Args:
        image: without the robot and what moves.
        T_world_sensor: (4, 4) pose of the sensor when it was taken.
        params: how exact ranges are.
    """
    rows, columns = image.ranges.shape
    apart = 2 if min(rows, columns) >= 60 else 1
    if rows <= 2 * apart or columns <= 2 * apart:
        return Surfaces(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2), dtype=np.intp))
    r = np.arange(apart, rows - apart, max(1, rows // _ACROSS))[:, None]
    c = np.arange(apart, columns - apart, max(1, columns // _ACROSS))
    ranges = np.where(np.isfinite(image.ranges), image.ranges, np.nan).astype(float)
    directions = image.directions()

    def at(dr: int, dc: int) -> Array:
        return directions[r + dr, c + dc] * ranges[r + dr, c + dc][..., None]

    here = at(0, 0)
    along, down = at(0, apart) - at(0, -apart), at(apart, 0) - at(-apart, 0)
    normal = np.cross(along, down)
    with np.errstate(invalid="ignore", divide="ignore"):
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        away = np.linalg.norm(here, axis=-1)
        cosine = np.einsum("ijk,ijk->ij", normal, here) / away
        near = ranges[r, c]
        widest = _ONE_SURFACE[0] + _ONE_SURFACE[1] * near
        flat = np.ones(near.shape, dtype=bool)
        for dr, dc in ((0, apart), (0, -apart), (apart, 0), (-apart, 0)):
            flat &= np.abs(ranges[r + dr, c + dc] - near) < widest
        good = flat & (np.abs(cosine) > _FACING) & (near <= params.range_max)
    R, p = T_world_sensor[:3, :3], T_world_sensor[:3, 3]
    normals = -np.sign(cosine[good])[:, None] * normal[good] @ R.T
    return Surfaces(here[good] @ R.T + p, normals, params.sigma(near[good]), np.argwhere(good))


def fit_displacement(
    arms: Array,
    normals: Array,
    off: Array,
    sigma: Array,
    before: tuple[float, ...],
    least: int = _LEAST_COMPARED,
) -> Displacement:
    """The turn and shift that explain best how far points are off along normals, by weighted least squares.

    Args:
        arms: (n, 3) the points, from the sensor [m].
        normals: (n, 3) unit vectors.
        off: (n,) how far off they are [m].
        sigma: (n,) their standard deviations [m].
        before: (6,) standard deviations of turn and shift, a priori [rad, m].
        least: how many points have to be compared.
    """
    n = len(off)
    if n < least:
        return replace(UNKNOWN, compared=n)
    sigma = np.hypot(sigma, PIXELS)
    A = np.hstack((np.cross(arms, normals), normals)) / sigma[:, None]
    b = off / sigma
    prior = np.diag(1.0 / np.square(before))
    x, H = reweighted(A, b, prior)
    left = np.abs(b - A @ x)
    covariance = np.linalg.inv(H / ALIKE**2 + prior)
    turned, shifted = float(np.linalg.norm(x[:3])), float(np.linalg.norm(x[3:]))
    u, w = x[:3] / max(turned, 1e-12), x[3:] / max(shifted, 1e-12)
    return Displacement(
        x[:3],
        n,
        turned,
        shifted,
        math.sqrt(float(u @ covariance[:3, :3] @ u)),
        math.sqrt(float(w @ covariance[3:, 3:] @ w)),
        float((left < SURE).mean()),
        abs(float(x[5])),
        least,
    )


def fit_floor(floor: Surfaces, T_world_sensor: Array, bias: float) -> Displacement:
    """By how much surfaces of a level floor are displaced from it.

    Args:
        floor: what may be of it.
        T_world_sensor: (4, 4) pose of the sensor when it was taken.
        bias: error [m] that all ranges may have in common.
    """
    up = np.broadcast_to([0.0, 0.0, 1.0], floor.points.shape)
    sigma = np.hypot(floor.sigma, bias)
    found = fit_displacement(floor.points - T_world_sensor[:3, 3], up, floor.points[:, 2], sigma, _FLOOR_BEFORE)
    if found.tilted and _between_neighbours(floor, found.turn / found.turned) < _NEIGHBOURS_TELL * found.least_tilt:
        return UNKNOWN  # a board or a step, as level as the floor
    return found


def _between_neighbours(floor: Surfaces, axis: Array) -> float:
    """By how much the floor is tilted about an axis (3,) between points that are near each other [rad].

    Something level that lies on it makes it look tilted all together. Between neighbours it does so at its edges alone,
    and those do not count.
    """
    size = int(floor.cells.max()) + 1
    at = np.full((size, size), -1)
    at[tuple(floor.cells.T)] = np.arange(len(floor.points))
    pairs = [(at[:-k].ravel(), at[k:].ravel()) for k in _NEIGHBOURS]
    pairs += [(at[:, :-k].ravel(), at[:, k:].ravel()) for k in _NEIGHBOURS]
    one, two = np.hstack([np.stack(pair)[:, (pair[0] >= 0) & (pair[1] >= 0)] for pair in pairs])
    if len(one) < _LEAST_COMPARED:
        return 0.0
    along = floor.points[two] - floor.points[one]
    sigma = np.sqrt(floor.sigma[one] ** 2 + floor.sigma[two] ** 2 + _LEAST_SIGMA**2)
    A = np.column_stack((along[:, 1], -along[:, 0])) / sigma[:, None]  # turns about the world's x and y
    x, _ = reweighted(A, along[:, 2] / sigma, np.eye(2), _without_edges, _NEIGHBOUR_ROUNDS[1], settled=0.0)
    return float(x @ axis[:2])


def reweighted(
    A: Array,
    b: Array,
    prior: Array,
    weight: Weight | None = None,
    rounds: int = _ROUNDS,
    settled: float = _SETTLED,
) -> tuple[Array, Array]:
    """The x (k,) for which Ax is nearest to b where most agree, by iteratively reweighted least squares.

    Args:
        A: (n, k) equations, in standard deviations.
        b: (n,) what they should give.
        prior: (k, k) inverse covariance of x, a priori.
        weight: how much an equation counts; without one, less and less the further it is off.
        rounds: at most.
        settled: a round that changes x by less is the last.

    Returns:
        x, and the inverse covariance (k, k) that the equations give it.
    """
    weight = _less_and_less if weight is None else weight
    x = np.zeros(A.shape[1])
    H = np.zeros_like(prior)
    for k in range(rounds):
        weighted = (A * weight(np.abs(b - A @ x), k)[:, None]).T
        H = weighted @ A
        last, x = x, np.linalg.solve(H + prior, weighted @ b)
        if float(np.abs(x - last).max()) < settled:
            break
    return x, H


def _less_and_less(left: Array, _round: int) -> Array:
    scale = max(1.5 * _median(left), 1.0)
    return 1.0 / (1.0 + np.square(left / (2.0 * scale)))


def _without_edges(left: Array, k: int) -> Array:
    off = np.square(left / (_EDGE * max(_median(left), 1e-12)))
    return 1.0 / (1.0 + off) if k < _NEIGHBOUR_ROUNDS[0] else np.square(np.maximum(1.0 - off, 0.0))


def _median(values: Array) -> float:
    """As of NumPy, whose own takes ten times as long for a few hundred values (n)."""
    k = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, k)[k])
    return 0.5 * float(np.partition(values, (k - 1, k))[k - 1 : k + 1].sum())
