"""Rays, and where they first meet convex bodies: closed forms of primitives, and planes of polyhedra.

The native kernel goes down a tree of the bodies' boxes with several rays at once. Its twin here asks all pairs of a ray
and a body's sphere: a function of a shape takes K rays (origin, direction) in the frames of K shapes and their sizes
(K, 3), and returns where they enter and where they leave [m along the ray]; a ray that misses enters at infinity.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import coal
import numpy as np

from elastic_strips.arrays import Array, Indices, by_rows
from elastic_strips.coal_shapes import SIGNS, ShapeKind, shape_of, support_points
from elastic_strips.hulls import convex_hull
from elastic_strips.native import kernel

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


_Interval = Callable[[Array, Array, Array], tuple[Array, Array]]
_Normal = Callable[[Array, Array], Array]
_LEAST_DIVISOR = 1e-14
_BOX, _SPHERE, _CYLINDER, _CAPSULE, _CONE, _POLYHEDRON = range(6)  # as the kernel numbers them
_MOST_PAIRS = 2_000_000  # of a body and a ray that the twin looks at together
_KINDS = {ShapeKind.CYLINDER: _CYLINDER, ShapeKind.CAPSULE: _CAPSULE, ShapeKind.CONE: _CONE}
_FIRST_PLANES = 40  # of a polyhedron that are put into an order
_PLANE_SLACK = 1e-7  # [m, and of a cosine] by which an origin, a direction has to be beyond a plane to count as that
_MANY_RAYS = 600  # from one origin, for which it pays to look first which bodies they may meet
_PLANE_DIGITS = 9  # to which planes of coplanar triangles are the same


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """A convex body in the frame of its own that rays are cast in, with its origin in the geometry's frame."""

    kind: int
    size: tuple[float, float, float]
    radius: float
    shift: Array
    planes: Array


class RayBodies:
    """Workspace: convex bodies that rays are cast against.

    Args:
        geometries: Coal geometries; round ones that are no primitives are polyhedra that hold them.
        padding: by how much each is made thicker [m]; cones and polyhedra by at least that.
    """

    def __init__(self, geometries: Iterable[coal.CollisionGeometry], padding: float = 0.0) -> None:
        self._take([_body(geometry, padding) for geometry in geometries])

    def _take(self, bodies: list[_Body]) -> None:
        self._bodies = bodies
        self._kind = np.array([b.kind for b in bodies], dtype=np.intp)
        self._size = np.array([b.size for b in bodies]).reshape(-1, 3)
        self._radius = np.array([b.radius for b in bodies])
        self._shift = np.array([b.shift for b in bodies]).reshape(-1, 3)
        self._start = np.concatenate(([0], np.cumsum([len(b.planes) for b in bodies]))).astype(np.intp)
        self._planes = np.concatenate((np.zeros((0, 4)), *(b.planes for b in bodies)))
        self._rotation, self._translation = np.zeros((len(bodies), 3, 3)), np.zeros((len(bodies), 3))
        native = kernel()
        self._native = native.RayBodies(self._kind, self._size, self._start, self._planes) if native else None

    def __len__(self) -> int:
        return len(self._kind)

    def place(self, rotation: Array, translation: Array) -> None:
        """Put the geometries' frames where they are in the frame of the rays.

        Args:
            rotation: (P, 3, 3).
            translation: (P, 3) [m].
        """
        self._put(rotation, translation + np.matmul(rotation, self._shift[:, :, None])[:, :, 0])

    def _put(self, rotation: Array, translation: Array) -> None:
        self._rotation, self._translation = rotation, translation
        if self._native is not None:
            self._native.place(*by_rows(rotation, translation))

    def cast(self, rays: Rays, nearest: Nearest, *, reach: float, inside: float) -> None:
        """Intersect rays with these bodies.

        Args:
            rays: rays to intersect.
            nearest: takes the hits.
            reach: length of the rays [m]; what is beyond is not met.
            inside: distance [m] of a ray that begins inside a body; infinite where such a body is passed over.
        """
        bodies = self
        if len(rays.origin) == 1 and len(rays) >= _MANY_RAYS and math.isinf(inside) and len(self._planes):
            bodies = self._before(rays)
        bodies._cast(rays, nearest, reach, inside)

    def _cast(self, rays: Rays, nearest: Nearest, reach: float, inside: float) -> None:
        if self._native is not None:
            origin, direction = by_rows(rays.origin, rays.direction)
            self._native.cast(origin, direction, reach, inside, nearest.distance, nearest.normal)
            return
        some = max(1, _MOST_PAIRS // max(len(self), 1))
        for first in range(0, len(rays), some):
            part = np.arange(first, min(first + some, len(rays)))
            piece, ray = rays.some(part).near(self._translation, self._radius, reach)
            self._meet(piece, part[ray], rays, nearest, reach, inside)

    def _before(self, rays: Rays) -> RayBodies:
        """Those of these bodies that rays from a common origin may meet from outside; they meet the same as of all.

        What is left out are polyhedra that the origin is in, as in a camera's housing, and those with a plane that the
        origin is outside of and from which all rays lead away: else every ray would be asked about every plane. Where
        not all rays do, such planes come first: the rays that do are done with the body.
        """
        axis = rays.direction.mean(axis=0)
        axis /= max(float(np.linalg.norm(axis)), _LEAST_DIVISOR)
        cosine = float((rays.direction @ axis).min())  # of the cone about all rays
        sine = math.sqrt(max(1.0 - cosine * cosine, 0.0)) if cosine > 0.0 else math.inf
        of, turn = np.repeat(np.arange(len(self)), np.diff(self._start)), self._rotation
        normal = self._planes[:, :3]
        origin = np.matmul((rays.origin - self._translation)[:, None, :], turn)[:, 0]
        height = np.einsum("ij,ij->i", normal, origin[of]) - self._planes[:, 3]
        along = np.einsum("ij,ij->i", normal, (axis @ turn)[of])
        before = height > _PLANE_SLACK
        met = self._kind != _POLYHEDRON
        met[of[height >= -_PLANE_SLACK]] = True
        met[of[before & (along > sine + _PLANE_SLACK)]] = False
        order = np.lexsort((np.where(before & (along > 0.0), -along, 1.0), of))
        kept = np.flatnonzero(met)
        bodies = RayBodies(())
        bodies._take(
            [
                replace(self._bodies[p], planes=self._planes[order[self._start[p] : self._start[p + 1]]])
                for p in kept.tolist()
            ]
        )
        bodies._put(self._rotation[kept], self._translation[kept])
        return bodies

    def _meet(self, piece: Indices, ray: Indices, rays: Rays, nearest: Nearest, reach: float, inside: float) -> None:
        """The twin: pairs of a body and a ray."""
        origins = rays.origin if len(rays.origin) > 1 else np.broadcast_to(rays.origin, rays.direction.shape)
        for interval, normal, p, r in self._by_kind(piece, ray):
            turn, size = self._rotation[p], self._size[p]
            o = np.matmul((origins[r] - self._translation[p])[:, None, :], turn)[:, 0]
            d = np.matmul(rays.direction[r][:, None, :], turn)[:, 0]
            enter, leave = interval(o, d, size)
            distance = np.where(enter < 0.0, inside, enter)
            distance[~((leave >= 0.0) & (leave >= enter) & (distance <= reach))] = np.inf
            won = nearest.closer(r, distance)
            if nearest.normal is not None and len(won):
                local = normal(o[won] + distance[won, None] * d[won], size[won])
                nearest.normal[r[won]] = np.matmul(turn[won], local[:, :, None])[..., 0]

    def _by_kind(self, piece: Indices, ray: Indices) -> Iterator[tuple[_Interval, _Normal, Indices, Indices]]:
        """Functions of a shape, and the pairs that they are for; polyhedra one after the other."""
        kinds = self._kind[piece]
        for kind, (interval, normal) in enumerate(_SHAPES):
            at = np.flatnonzero(kinds == kind)
            if len(at):
                yield interval, normal, piece[at], ray[at]
        at = np.flatnonzero(kinds == _POLYHEDRON)
        for body in np.unique(piece[at]):
            mine = at[piece[at] == body]
            planes = self._bodies[body].planes
            yield _polyhedron(planes), _polyhedron_normal(planes), piece[mine], ray[mine]


def _body(geometry: coal.CollisionGeometry, padding: float) -> _Body:
    """A Coal geometry, thicker by a padding [m]."""
    kind, size = shape_of(geometry)
    none, here = np.zeros((0, 4)), np.zeros(3)
    if kind is ShapeKind.BOX:
        x, y, z = (h + padding for h in size)
        return _Body(_BOX, (x, y, z), math.hypot(x, y, z), here, none)
    if kind is ShapeKind.SPHERE:
        return _Body(_SPHERE, (size[0] + padding, 0.0, 0.0), size[0] + padding, here, none)
    if kind in _KINDS and not (kind is ShapeKind.CONE and padding > 0.0):  # a thicker cone would have another origin
        radius, half = size[0] + padding, size[1] + (padding if kind is ShapeKind.CYLINDER else 0.0)
        about = radius + half if kind is ShapeKind.CAPSULE else math.hypot(radius, half)
        return _Body(_KINDS[kind], (radius, half, 0.0), about, here, none)
    points, swept = support_points(geometry)
    if swept + padding > 0.0:
        points = (points[:, None] + (swept + padding) * SIGNS).reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    shift = 0.5 * (low + high)
    corners = points - shift
    planes = np.unique(convex_hull(corners).equations.round(_PLANE_DIGITS), axis=0)
    planes[:, :3] /= np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    planes = planes[_spread(planes[:, :3])]
    planes[:, 3] = (corners @ planes[:, :3].T).max(axis=0)  # rounded normals, but no corner outside
    x, y, z = (0.5 * (high - low)).tolist()
    radius = float(np.linalg.norm(corners, axis=1).max())
    return _Body(_POLYHEDRON, (x, y, z), radius, shift, planes)


def _spread(normals: Array) -> Indices:
    """An order (F,) of planes in which the first ones look all around: a ray that misses a body is soon done."""
    order = np.arange(len(normals))
    nearest = np.full(len(normals), -np.inf)  # cosine to those chosen
    for k in range(min(_FIRST_PLANES, len(normals))):
        at = k + int(np.argmin(nearest[order[k:]]))
        order[[k, at]] = order[[at, k]]
        nearest = np.maximum(nearest, normals @ normals[order[k]])
    return order


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


def _polyhedron(planes: Array) -> _Interval:
    """Inside all of its planes (F, 4): n·x ≤ d."""

    def interval(o: Array, d: Array, size: Array) -> tuple[Array, Array]:
        height, speed = o @ planes[:, :3].T - planes[:, 3], d @ planes[:, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            at = -height / speed
        enter = np.where(speed < 0.0, at, -np.inf).max(axis=1)
        leave = np.where(speed > 0.0, at, np.inf).min(axis=1)
        beside = ((speed == 0.0) & (height > 0.0)).any(axis=1) | ~(enter <= leave)
        enter[beside], leave[beside] = np.inf, -np.inf
        return enter, leave

    return interval


def _polyhedron_normal(planes: Array) -> _Normal:
    return lambda p, size: planes[np.argmax(p @ planes[:, :3].T - planes[:, 3], axis=1), :3]


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


_SHAPES: tuple[tuple[_Interval, _Normal], ...] = (
    (_box, _box_normal),
    (_sphere, _sphere_normal),
    (_cylinder, _cylinder_normal),
    (_capsule, _capsule_normal),
    (_cone, _cone_normal),
)
