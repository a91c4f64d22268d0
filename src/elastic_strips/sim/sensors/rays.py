"""Rays, and their first intersections with primitive shapes in closed form.

Primitives are boxes, spheres, cylinders, capsules and cones: a function of a shape takes K rays (origin, direction) in
the frames of K shapes and their sizes (K, 3), and returns where they enter and where they leave [m along
the beam]; a beam that misses enters at infinity.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import coal
import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Indices
from elastic_strips.coal_shapes import ShapeKind, shape_of

_SPHERE_SLACK = 1e-6  # [m] bounding spheres are taken larger by this, so that rounding drops no touching pair


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Rays.

    Attributes:
        origin: (R, 3) origins [m]; (1, 3) for a common one.
        direction: (R, 3) of unit length.
    """

    origin: Array
    direction: Array

    def __len__(self) -> int:
        return len(self.direction)

    def moved(self, T: Array) -> Rays:
        """These rays, given in a frame with the pose ``T`` (4, 4), in the frame of that pose."""
        turn = T[:3, :3].T
        return Rays(self.origin @ turn + T[:3, 3], self.direction @ turn)

    def seen_from(self, rotation: Array, translation: Array) -> Rays:
        """These rays in the frame with this pose."""
        return Rays((self.origin - translation) @ rotation, self.direction @ rotation)

    def some(self, index: Indices) -> Rays:
        """The rays of these indices."""
        return Rays(self.origin if len(self.origin) == 1 else self.origin[index], self.direction[index])

    def near(self, center: Array, radius: Array, reach: float) -> tuple[Indices, Indices]:
        """Pairs (sphere, ray), spheres ascending, whose ray may hit the sphere within ``reach`` [m].

        Args:
            center: (P, 3) centres of the spheres [m].
            radius: (P,) their radii [m].
            reach: length of the rays [m].
        """
        middle = self.origin.mean(axis=0) if len(self.origin) > 1 else self.origin[0]
        c, o = center - middle, self.origin - middle  # coordinates stay small
        spread = math.sqrt(float(np.einsum("ij,ij->i", o, o).max()))
        close = np.flatnonzero(np.linalg.norm(c, axis=1) <= reach + radius + (spread + _SPHERE_SLACK))
        if len(close) == 0:
            return close, close
        c, r = c[close], (radius[close] + _SPHERE_SLACK)[:, None]
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
    """Workspace: the nearest hit of each of ``count`` rays.

    Args:
        count: number of rays.
        normals: whether the surfaces' normals are wanted.

    Attributes:
        distance: (count,) [m]; infinite without a hit.
        normal: (count, 3) outward normals at the hits, in the rays' frame; None if not wanted.
    """

    def __init__(self, count: int, *, normals: bool = False) -> None:
        self.distance: Array = np.full(count, np.inf)
        self.normal: Array | None = np.zeros((count, 3)) if normals else None

    def closer(self, ray: Indices, distance: Array) -> Indices:
        """Take hits that are closer than all before; returns the indices of these among the K.

        Args:
            ray: (K,) indices of rays, with repetitions.
            distance: (K,) [m]; infinite without a hit.
        """
        before = self.distance[ray]
        np.minimum.at(self.distance, ray, distance)
        if self.normal is None:
            return np.zeros(0, dtype=np.intp)
        return np.flatnonzero((distance < before) & (distance == self.distance[ray]))


_LEAST_DIVISOR = 1e-14
_BOX, _SPHERE, _CYLINDER, _CAPSULE, _CONE = range(5)


@dataclass(frozen=True, slots=True, eq=False)
class Primitives:
    """Primitive shapes, in the order of their kinds.

    Attributes:
        row: (P,) index of each among the given geometries.
        kind: (P,) ascending.
        size: (P, 3) half lengths of a box; else radius, half length along z, 0 [m].
        radius: (P,) radii of spheres about the shapes' origins that hold them [m].
    """

    row: Indices
    kind: npt.NDArray[np.intp]
    size: Array
    radius: Array

    @staticmethod
    def of(geometries: Sequence[coal.CollisionGeometry | None], padding: float = 0.0) -> Primitives:
        """The primitives among Coal geometries, each thicker by ``padding`` [m]; of cones only unpadded ones."""
        found = [(kind, k, size) for k, g in enumerate(geometries) for kind, size in _measured(g, padding)]
        found.sort()
        kind = np.array([f[0] for f in found], dtype=np.intp)
        size = np.array([f[2] for f in found]).reshape(-1, 3)
        radius = np.linalg.norm(size, axis=1)
        radius[kind == _CAPSULE] = size[kind == _CAPSULE, :2].sum(axis=1)
        return Primitives(np.array([f[1] for f in found], dtype=np.intp), kind, size, radius)

    def __len__(self) -> int:
        return len(self.kind)

    def cast(
        self, rotation: Array, translation: Array, rays: Rays, nearest: Nearest, *, reach: float, inside: float
    ) -> bool:
        """Intersect rays with these shapes.

        Args:
            rotation: (P, 3, 3) rotations of the shapes' frames in the rays' frame.
            translation: (P, 3) their origins [m].
            rays: rays to intersect.
            nearest: takes the hits.
            reach: length of the rays [m]; hits beyond may be left out.
            inside: distance [m] of a ray that begins inside a shape.

        Returns:
            Whether any ray came near any of them.
        """
        piece, ray = rays.near(translation, self.radius, reach)
        if len(piece) == 0:
            return False
        bounds = np.searchsorted(self.kind[piece], np.arange(len(_SHAPES) + 1))
        origins = rays.origin if len(rays.origin) > 1 else np.broadcast_to(rays.origin, rays.direction.shape)
        for (interval, normal), begin, end in zip(_SHAPES, bounds[:-1], bounds[1:], strict=True):
            if begin == end:
                continue
            p, r = piece[begin:end], ray[begin:end]
            turn, size = rotation[p], self.size[p]
            o = np.matmul((origins[r] - translation[p])[:, None, :], turn)[:, 0]
            d = np.matmul(rays.direction[r][:, None, :], turn)[:, 0]
            enter, leave = interval(o, d, size)
            distance = np.where(enter < 0.0, inside, enter)
            distance[~((leave >= 0.0) & (leave >= enter))] = np.inf
            won = nearest.closer(r, distance)
            if nearest.normal is not None and len(won):
                local = normal(o[won] + distance[won, None] * d[won], size[won])
                nearest.normal[r[won]] = np.matmul(turn[won], local[:, :, None])[..., 0]
        return True


def is_primitive(geometry: coal.CollisionGeometry | None, padding: float = 0.0) -> bool:
    """Whether a Coal geometry, made thicker by ``padding`` [m], is a primitive here."""
    return bool(_measured(geometry, padding))


def _measured(geometry: coal.CollisionGeometry | None, padding: float) -> list[tuple[int, tuple[float, float, float]]]:
    """Kind and size of a Coal geometry; empty if it is not a primitive."""
    kind, size = shape_of(geometry)
    if kind is ShapeKind.BOX:
        x, y, z = (h + padding for h in size)
        return [(_BOX, (x, y, z))]
    if kind is ShapeKind.SPHERE:
        return [(_SPHERE, (size[0] + padding, 0.0, 0.0))]
    number = {ShapeKind.CYLINDER: _CYLINDER, ShapeKind.CAPSULE: _CAPSULE, ShapeKind.CONE: _CONE}.get(kind)
    if number is None or (number == _CONE and padding > 0.0):  # a thicker cone would have another origin
        return []
    return [(number, (size[0] + padding, size[1] + (padding if number == _CYLINDER else 0.0), 0.0))]


def _slab(o: Array, d: Array, half: Array) -> tuple[Array, Array]:
    """Between the planes at ± half; arrays of any shape."""
    inverse = 1.0 / np.where(np.abs(d) < _LEAST_DIVISOR, np.copysign(_LEAST_DIVISOR, d), d)
    a, b = (-half - o) * inverse, (half - o) * inverse
    return np.minimum(a, b), np.maximum(a, b)


def _disc(o: Array, d: Array, radius: Array) -> tuple[Array, Array]:
    """Within a radius of the origin, in two or three dimensions: o, d (K, n)."""
    a, b = np.einsum("ij,ij->i", d, d), np.einsum("ij,ij->i", o, d)
    along = a > _LEAST_DIVISOR
    c = np.einsum("ij,ij->i", o, o) - radius * radius
    a = np.where(along, a, 1.0)
    foot = o - (b / a)[:, None] * d  # where the line is nearest; better than b² − a c, which cancels far away
    depth = (radius * radius - np.einsum("ij,ij->i", foot, foot)) / a
    hit = depth >= 0.0
    root = np.sqrt(np.where(hit, depth, 0.0))
    enter, leave = -b / a - root, -b / a + root
    still = ~along
    enter[~hit], leave[~hit] = np.inf, -np.inf
    enter[still] = np.where(c[still] <= 0.0, -np.inf, np.inf)
    leave[still] = np.where(c[still] <= 0.0, np.inf, -np.inf)
    return enter, leave


def _box(o: Array, d: Array, size: Array) -> tuple[Array, Array]:
    enter, leave = _slab(o, d, size)
    return enter.max(axis=1), leave.min(axis=1)


def _sphere(o: Array, d: Array, size: Array) -> tuple[Array, Array]:
    return _disc(o, d, size[:, 0])


def _cylinder(o: Array, d: Array, size: Array) -> tuple[Array, Array]:
    enter, leave = _disc(o[:, :2], d[:, :2], size[:, 0])
    low, high = _slab(o[:, 2], d[:, 2], size[:, 1])
    return _both(enter, leave, low, high)


def _capsule(o: Array, d: Array, size: Array) -> tuple[Array, Array]:
    enter, leave = _cylinder(o, d, size)
    for sign in (-1.0, 1.0):
        end = o.copy()
        end[:, 2] -= sign * size[:, 1]
        first, last = _disc(end, d, size[:, 0])
        enter, leave = np.minimum(enter, first), np.maximum(leave, last)
    return enter, leave


def _cone(o: Array, d: Array, size: Array) -> tuple[Array, Array]:
    """ρ ≤ k w, where w is the depth below the apex: the borders that a ray crosses, side (twice) and base."""
    r, half = size[:, 0], size[:, 1]
    k = r / (2.0 * half)
    w, dw = half - o[:, 2], -d[:, 2]
    a = d[:, 0] ** 2 + d[:, 1] ** 2 - (k * dw) ** 2
    b = o[:, 0] * d[:, 0] + o[:, 1] * d[:, 1] - k * k * w * dw
    c = o[:, 0] ** 2 + o[:, 1] ** 2 - (k * w) ** 2
    straight = np.abs(a) < 1e-12  # parallel to the side
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    real = (b * b - a * c >= 0.0) | straight
    big = -(b + np.copysign(root, b))  # the root that does not cancel
    t1 = big / np.where(straight, 1.0, a)
    t2 = c / np.where(np.abs(big) < _LEAST_DIVISOR, _LEAST_DIVISOR, big)
    t3 = (2.0 * half - w) / np.where(np.abs(dw) < _LEAST_DIVISOR, np.copysign(_LEAST_DIVISOR, dw), dw)
    enter, leave = np.full(len(o), np.inf), np.full(len(o), -np.inf)
    for t, side in ((t1, real & ~straight), (t2, real)):
        at = w + t * dw
        good = side & (at >= -1e-12) & (at <= 2.0 * half + 1e-12)
        enter, leave = np.where(good, np.minimum(enter, t), enter), np.where(good, np.maximum(leave, t), leave)
    rim = np.hypot(o[:, 0] + t3 * d[:, 0], o[:, 1] + t3 * d[:, 1]) <= r
    return np.where(rim, np.minimum(enter, t3), enter), np.where(rim, np.maximum(leave, t3), leave)


def _both(enter: Array, leave: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Intersection of two intervals; an empty one enters at infinity."""
    enter, leave = np.maximum(enter, low), np.minimum(leave, high)
    none = ~(enter <= leave)
    enter[none], leave[none] = np.inf, -np.inf
    return enter, leave


def _unit(v: Array) -> Array:
    return v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), _LEAST_DIVISOR)


def _box_normal(p: Array, size: Array) -> Array:
    axis = np.argmin(size - np.abs(p), axis=1)
    out = np.zeros_like(p)
    rows = np.arange(len(p))
    out[rows, axis] = np.sign(p[rows, axis])
    return out


def _sphere_normal(p: Array, size: Array) -> Array:
    return _unit(p)


def _cylinder_normal(p: Array, size: Array) -> Array:
    side = p * (1.0, 1.0, 0.0)
    cap = size[:, 1] - np.abs(p[:, 2]) < size[:, 0] - np.hypot(p[:, 0], p[:, 1])
    return _unit(np.where(cap[:, None], p * (0.0, 0.0, 1.0), side))


def _capsule_normal(p: Array, size: Array) -> Array:
    out = p.copy()
    out[:, 2] -= np.clip(p[:, 2], -size[:, 1], size[:, 1])
    return _unit(out)


def _cone_normal(p: Array, size: Array) -> Array:
    r, half = size[:, 0], size[:, 1]
    rho = np.hypot(p[:, 0], p[:, 1])
    slope = np.hypot(r, 2.0 * half)
    to_side = (r * (half - p[:, 2]) / (2.0 * half) - rho) * 2.0 * half / slope
    side = _unit(p * (1.0, 1.0, 0.0)) * (2.0 * half / slope)[:, None]
    side[:, 2] = r / slope
    base = (p[:, 2] + half < to_side)[:, None]
    return np.where(base, np.array([0.0, 0.0, -1.0]), _unit(side))  # at the apex the side has no direction of its own


_Interval = Callable[[Array, Array, Array], tuple[Array, Array]]
_SHAPES: tuple[tuple[_Interval, Callable[[Array, Array], Array]], ...] = (
    (_box, _box_normal),
    (_sphere, _sphere_normal),
    (_cylinder, _cylinder_normal),
    (_capsule, _capsule_normal),
    (_cone, _cone_normal),
)
