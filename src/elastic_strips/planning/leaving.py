"""Leaving contact: a start that touches slightly is left along growing distance, until the robot is free.

A robot that stands 2 mm in a table by calibration, or in a floor by a scan's noise, has no certified path: the first
piece of any touches. But there may be a short motion along which each distance that is too small grows, and along
which nothing else comes too near. It is made of small steps, each the smallest motion by which all of these distances
grow, and then checked again from the robot's and the scene's shapes. Between two steps distances are bounded by how far
anything can have moved. This is not a certificate and never called one: the certified strip begins where the robot is
free.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, Document
from elastic_strips.coal_shapes import for_penetration
from elastic_strips.collision import BodySet, MotionBounds
from elastic_strips.constants import GJK_EXCESS
from elastic_strips.errors import ConfigurationError
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import Strip
from elastic_strips.strip.params import DeformParams
from elastic_strips.summary import Summary

MOST_DEPTH = 0.05
"""Depths [m] beyond this are not a slight contact."""

_LARGEST_STEP = 2.5e-4  # [m] that any point of the robot moves in a step, at most
_MOST_STEPS = 600
_FREE_MARGIN = 1e-3  # [m] more than is needed, where it counts as free: what is planned from there needs room
_DISTANCE_REACH = 0.02  # [m] beyond what is needed, that distances are known of
_DERIVATIVE_STEP = 1e-5  # [rad or m] of numerical derivatives
_MOST_HALVINGS = 5


@dataclass(frozen=True, slots=True)
class Contact(Summary):
    """Two things that touch, or are nearer than they may be, at the start.

    Attributes:
        one: a link of the robot.
        two: an obstacle, or another link.
        distance: their distance [m]; negative by the depth of penetration.
        needed: distance [m] that is required between them.
    """

    one: str
    two: str
    distance: float
    needed: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Departure(Summary):
    """The part of a plan that is not certified: how a start that touches is left.

    Attributes:
        strip: strip from the start to the first configuration where everything has the required distance.
        contacts: contacts at the start, the deepest first. At each node of the strip all these distances are
            larger than at the one before, until they are as large as required.
        depth: largest depth [m] at the start; 0 where things are too near and do not touch.
        tolerance: between two nodes nothing is nearer than at the nearer one of them by more than this [m]; so nothing
            is deeper than at the start by more. It is a bound, from how far anything can move between them.
        travel: bound [m] on how far any point of the robot moves along the strip.
        rest: the certified strip from where the robot is free to the goal; None where none was found.
    """

    strip: Strip
    contacts: tuple[Contact, ...]
    depth: float
    tolerance: float
    travel: float
    rest: Strip | None = None

    def _summary(self) -> dict[str, object]:
        return {"left": str(self), "nodes": len(self.strip), "rest certified": self.rest is not None}

    def __str__(self) -> str:
        first = self.contacts[0]
        more = f" and {len(self.contacts) - 1} more" if len(self.contacts) > 1 else ""
        where = f"{1e3 * self.depth:.1f} mm deep in" if self.depth > 0.0 else f"{1e3 * first.distance:.1f} mm from"
        return (
            f"not certified up to node {len(self.strip) - 1}: the start is left along growing distance "
            f"({first.one!r} is {where} {first.two!r}{more}; nothing gets deeper by more than "
            f"{1e3 * self.tolerance:.2f} mm between nodes)"
        )

    def document(self) -> Document:
        """The departure as plain data: lengths [m], and the nodes' coordinates from the start to where it is free."""
        return {
            "status": "left along growing distance",
            "rest": "not certified" if self.rest is None else "certified",
            "depth": self.depth,
            "tolerance": self.tolerance,
            "travel": self.travel,
            "contacts": [
                {"one": c.one, "two": c.two, "distance": c.distance, "needed": c.needed} for c in self.contacts
            ],
            "coordinates": self.strip.coordinates.tolist(),
        }


_Pair = tuple[int, int, int]
"""A body and, of the scene, a part and a box in it; or (body, body, −1) of the robot."""


def leave_contact(
    robot: RobotModel, scene: Scene, start: Array, depth: float, params: DeformParams
) -> Departure | None:
    """The way out of a start that touches by at most ``depth`` [m]; None where nothing is too near.

    Args:
        robot: the robot.
        scene: the obstacles, standing still.
        start: valid configuration (nq,).
        depth: largest depth [m] that may be left.
        params: parameters with the required clearances.

    Raises:
        ConfigurationError: something is deeper, or no motion leads out along growing distance; the message names the
            pair.
    """
    near = _Distances(robot, scene, params)
    rows = [robot.space.to_coordinates(start)]
    here = near.at(rows[0])
    contacts, tight = _contacts(near, here, depth)
    if not tight:
        return None
    first = contacts[0]
    for _ in range(_MOST_STEPS):
        if _free(near, here, tight):
            break
        found = _step(near, rows[-1], here, tight)
        if found is None:
            raise ConfigurationError(
                f"start touches ({first.one!r} is {-1e3 * first.distance:.1f} mm deep in {first.two!r}), and no small "
                f"motion leads out along growing distance: it ended {1e3 * near.moved(np.array(rows)).sum():.1f} mm on"
            )
        rows.append(found[0])
        here = found[1]
    else:
        raise ConfigurationError(f"start touches: {first.one!r} is not free of {first.two!r} after {_MOST_STEPS} steps")
    ends = np.stack((start, robot.space.from_coordinates(rows[-1])))
    return _departure(near, Strip.from_coordinates(robot, np.array(rows), ends=ends), contacts, tight)


def leave_along(strip: Strip, scene: Scene, depth: float, params: DeformParams) -> tuple[Departure | None, Strip]:
    """The beginning of a given strip as a way out of its start, which touches by at most ``depth`` [m]; and the rest of
    it, from the first place on that is free. The departure is None where nothing is too near at the start.

    Args:
        strip: along which the start is left, as it is.
        scene: the obstacles, standing still.
        depth: largest depth [m] that may be left.
        params: parameters with the required clearances.

    Raises:
        ConfigurationError: something is deeper, or does not get farther all the way until it is free, or something else
            comes too near meanwhile; the message names the pair.
    """
    robot, rows = strip.robot, strip.coordinates
    near, space = _Distances(robot, scene, params), robot.space
    here = near.at(rows[0])
    contacts, tight = _contacts(near, here, depth)
    if not tight:
        return None, strip
    out = [rows[0]]
    for k, way in enumerate(near.moved(rows)):
        v, parts = space.difference(rows[k : k + 1], rows[k + 1 : k + 2]), max(1, int(np.ceil(way / _LARGEST_STEP)))
        for j in range(1, parts + 1):
            out.append(space.integrate(rows[k : k + 1], j / parts * v)[0])
            if not _free(near, near.at(out[-1], list(tight)), tight):
                continue
            q = space.from_coordinates(out[-1])
            left = Strip.from_coordinates(robot, np.array(out), ends=np.stack((strip.q[0], q)))
            after = rows[k + 1 :] if j < parts else rows[k + 2 :]
            if len(after) == 0:
                break
            rest = Strip.from_coordinates(robot, np.vstack((out[-1:], after)), ends=np.stack((q, strip.q[-1])))
            return _departure(near, left, contacts, tight), rest
    first = contacts[0]
    raise ConfigurationError(f"start touches: {first.one!r} is not free of {first.two!r} where the way ends")


def _contacts(near: _Distances, here: dict[_Pair, float], depth: float) -> tuple[tuple[Contact, ...], set[_Pair]]:
    """What is too near at the start, the deepest first, and the pairs of it.

    Raises:
        ConfigurationError: something is deeper than ``depth`` [m].
    """
    tight = {pair: d for pair, d in here.items() if d <= near.needed(pair)}
    contacts = tuple(Contact(*near.names(p), d, near.needed(p)) for p, d in sorted(tight.items(), key=lambda e: e[1]))
    if contacts and -contacts[0].distance > depth:
        first = contacts[0]
        raise ConfigurationError(
            f"start is in collision: {first.one!r} is {-1e3 * first.distance:.1f} mm deep in {first.two!r}, more than "
            f"start_depth = {1e3 * depth:g} mm, which it may be to be left"
        )
    return contacts, set(tight)


def _free(near: _Distances, here: dict[_Pair, float], tight: set[_Pair]) -> bool:
    """Whether what was too near at the start is as far as needed, and a little more."""
    return all(d > near.needed(pair) + _FREE_MARGIN for pair, d in here.items() if pair in tight)


def _departure(near: _Distances, strip: Strip, contacts: tuple[Contact, ...], tight: set[_Pair]) -> Departure:
    tolerance, depth = _checked(near, strip, tight), max(0.0, -contacts[0].distance)
    return Departure(strip, contacts, depth, tolerance, float(near.moved(strip.coordinates).sum()))


class _Distances:
    """Distances of all that is near, asked of Coal one by one, and how far things may move."""

    def __init__(self, robot: RobotModel, scene: Scene, params: DeformParams) -> None:
        self.robot, self.scene, self.table = robot, scene, scene.table
        self.clearance, self.own = params.clearance, params.self_clearance
        self.bodies = BodySet.links(robot)
        self.bounds = MotionBounds(self.bodies)
        self._data = robot.model.createData()
        self._request, self._result = coal.DistanceRequest(True), coal.DistanceResult()
        self._reach = np.linalg.norm(self.bodies.ends[:, 0] - self.bodies.ends[:, 1], axis=1) / 2 + self.bodies.radius

    def needed(self, pair: _Pair) -> float:
        """Distance [m] that is required."""
        return self.own if pair[2] < 0 else self.clearance

    def names(self, pair: _Pair) -> tuple[str, str]:
        """The link, and the obstacle or other link."""
        labels = self.bodies.labels
        if pair[2] < 0:
            return labels[pair[0]], labels[pair[1]]
        return labels[pair[0]], self.scene.names[int(self.table.obstacle_index[pair[1]])]

    def moved(self, rows: Array) -> Array:
        """Bounds (N − 1,) [m] on how far any point moves between rows (N, nv)."""
        return self.bounds.travel(self.robot.space.difference(rows[:-1], rows[1:])).max(axis=1, initial=0.0)

    def at(self, row: Array, only: list[_Pair] | None = None) -> dict[_Pair, float]:
        """Distances [m] at coordinates (nv,) of all pairs that are near, or of some."""
        robot, model = self.robot, self.robot.model
        pin.forwardKinematics(model, self._data, robot.space.from_coordinates(row[None])[0])
        poses = []
        for piece in robot.geometries:
            T = self._data.oMi[piece.joint].homogeneous @ piece.placement
            poses.append(coal.Transform3s(T[:3, :3], T[:3, 3]))
        middle = np.array(
            [self._data.oMi[piece.joint].act(0.5 * (piece.capsule.a + piece.capsule.b)) for piece in robot.geometries]
        )
        found = {}
        for pair in self._near(middle) if only is None else only:
            one = robot.geometries[pair[0]].geometry
            if pair[2] < 0:
                two, other = robot.geometries[pair[1]].geometry, poses[pair[1]]
            else:
                two, other = self._part(pair[1], pair[2])
            first, second = for_penetration(one, two)
            self._result.clear()
            distance = coal.distance(first, poses[pair[0]], second, other, self._request, self._result)
            found[pair] = float(distance) - GJK_EXCESS
        return found

    def _part(self, part: int, box: int) -> tuple[coal.CollisionGeometry, coal.Transform3s]:
        table = self.table
        rotation, translation, shape = table.rotation[part], table.translation[part], table.parts[part]
        if shape.geometry is not None:
            return shape.geometry, coal.Transform3s(np.asarray(rotation), np.asarray(translation))
        geometry, at = shape.boxes[box]
        return geometry, coal.Transform3s(np.asarray(rotation), translation + rotation @ np.asarray(at))

    def _near(self, middle: Array) -> Iterator[_Pair]:
        """Pairs that may be near enough to matter, by balls and boxes about them."""
        table, reach = self.table, self._reach + self.clearance + _DISTANCE_REACH
        if len(table.parts):
            apart = np.abs(middle[:, None] - table.center[None]) - table.half_extents[None]
            gap = np.linalg.norm(np.maximum(apart, 0.0), axis=2)  # (bodies, parts)
            for body, part in np.argwhere(gap <= reach[:, None]):
                shape = table.parts[part]
                if shape.geometry is not None:
                    yield int(body), int(part), 0
                    continue
                for k, (box, at) in enumerate(shape.boxes):
                    center = table.translation[part] + table.rotation[part] @ np.asarray(at)
                    size = float(np.linalg.norm(np.asarray(box.halfSide)))
                    if np.linalg.norm(middle[body] - center) <= reach[body] + size:
                        yield int(body), int(part), k
        for one, two in self.robot.self_pairs:
            between = np.linalg.norm(middle[one] - middle[two])
            if between <= self._reach[one] + self._reach[two] + self.own + _DISTANCE_REACH:
                yield int(one), int(two), -1


def _step(
    near: _Distances, row: Array, here: dict[_Pair, float], tight: set[_Pair]
) -> tuple[Array, dict[_Pair, float]] | None:
    """The next row, with its distances: all that is too near is farther, and nothing else is too near."""
    space = near.robot.space
    watched = [p for p, d in here.items() if d <= near.needed(p) + _FREE_MARGIN + 4.0 * _LARGEST_STEP]
    wanted = np.array([1.0 if p in tight and here[p] <= near.needed(p) + _FREE_MARGIN else 0.0 for p in watched])
    slopes = np.zeros((len(watched), space.nv))
    free = np.ones(space.nv, dtype=bool)
    if near.robot.base_kind is BaseKind.DIFF_DRIVE:
        free[1] = False
    base = np.array([here[p] for p in watched])
    for i in np.flatnonzero(free):
        v = np.zeros(space.nv)
        sign = -1.0 if i >= space.base_nv and row[i] + _DERIVATIVE_STEP > space.upper[i] else 1.0
        v[i] = sign * _DERIVATIVE_STEP
        moved = near.at(space.integrate(row[None], v[None])[0], watched)
        slopes[:, i] = sign * (np.array([moved[p] for p in watched]) - base) / _DERIVATIVE_STEP
    lever = near.bounds.travel(np.eye(space.nv)).max(axis=1)  # a unit of each coordinate moves a point so far at most
    scale = np.where(free, 1.0 / np.maximum(lever, 1e-3), 0.0)
    rows, least = [slopes * scale], [wanted]
    for bound, sign in ((space.lower, 1.0), (space.upper, -1.0)):
        at_end = np.flatnonzero(np.isfinite(bound) & (sign * (row - bound) < 1e-3))
        at_end = at_end[at_end >= space.base_nv]
        rows.append(sign * np.eye(space.nv)[at_end])
        least.append(np.zeros(len(at_end)))
    direction = _least_motion(np.vstack(rows), np.concatenate(least))
    if direction is None:
        return None
    v = direction * scale
    v *= _LARGEST_STEP / float(near.bounds.travel(v[None]).max())
    for _ in range(_MOST_HALVINGS):
        new = space.integrate(row[None], v[None])[0]
        if (new[space.base_nv :] >= space.lower[space.base_nv :]).all() and (
            new[space.base_nv :] <= space.upper[space.base_nv :]
        ).all():
            there = near.at(new)
            if all(_allowed(near, p, here.get(p), d, tight) for p, d in there.items()):
                return new, there
        v *= 0.5
    return None


def _allowed(near: _Distances, pair: _Pair, before: float | None, distance: float, tight: set[_Pair]) -> bool:
    """Whether a distance may be so after a step: it has grown where it is too small, else it stays large enough."""
    if pair in tight and before is not None and before <= near.needed(pair) + _FREE_MARGIN:
        return distance > before
    return distance > near.needed(pair) + _LARGEST_STEP


def _least_motion(slopes: Array, least: Array) -> Array | None:
    """The smallest v (n,) with ``slopes`` (K, n) · v ≥ ``least`` (K,); None where there is none (Lawson and Hanson)."""
    from scipy.optimize import nnls  # late: slow to import

    n = slopes.shape[1]
    target = np.zeros(n + 1)
    target[n] = 1.0
    matrix = np.vstack((slopes.T, least))
    weights, _ = nnls(matrix, target)
    rest = matrix @ weights - target
    if -rest[n] < 1e-9 or np.linalg.norm(rest) < 1e-9:
        return None
    v = -rest[:n] / rest[n]
    return v if np.linalg.norm(v) > 0.0 else None


def _checked(near: _Distances, strip: Strip, tight: set[_Pair]) -> float:
    """The tolerance [m] of a way out, with all distances measured again from its nodes.

    Raises:
        ConfigurationError: a distance that is too small does not grow, or another one becomes too small.
    """
    rows = strip.coordinates
    half = 0.5 * near.moved(rows)
    twice = 2.0 * half  # both links of a pair may move
    last = near.at(rows[0])
    for k in range(1, len(rows)):
        there = near.at(rows[k])
        for pair, distance in there.items():
            before = last.get(pair, np.inf)
            slack = (twice if pair[2] < 0 else half)[k - 1]
            grows = pair in tight and (distance > before or before > near.needed(pair) + _FREE_MARGIN)
            if not grows and min(before, distance) - slack <= near.needed(pair):
                one, two = near.names(pair)
                raise ConfigurationError(f"start touches, and on the way out {one!r} comes too near to {two!r}")
        last = there
    return float(twice.max()) + GJK_EXCESS


def joined(departure: Departure, rest: Strip) -> Strip:
    """The way out and what follows, as one strip."""
    rows = np.vstack((departure.strip.coordinates[:-1], rest.coordinates))
    return Strip.from_coordinates(rest.robot, rows, ends=np.stack((departure.strip.q[0], rest.q[-1])))
