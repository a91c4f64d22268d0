"""Sim room, sweep: how near a robot that really moved came to obstacles that really moved, at all times between.

Branch and bound over time, for all pairs of a link and an obstacle's part at once. Between two moments at which a pair
is d_a and d_b apart it cannot come nearer than (d_a + d_b − w) / 2, where w bounds what both travelled in between.
Distances are Coal's at Pinocchio's placements. This room judges what proximity and certificate promised, so it shares
no code with them: not the culling, not the motion bounds, not the way Coal is asked.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import coal
import numpy as np

from ..robot import RobotModel
from ..robot.space import Array, Indices, Mask
from ..scene import Part, World
from .course import Course, Link, transform

TOUCH = 1e-5
"""Nearer than this [m] counts as touching: Coal may see shapes that touch this far apart."""
_BLOCK = 32  # samples that are bounded at once
_FINEST = 1e-6  # share of a sample interval that is not split any more, as where an obstacle jumps


@dataclass(frozen=True, slots=True)
class Approach:
    """A moment of a pair: time [s], place among the samples (a fraction is between two), link, obstacle, distance [m].

    A negative distance is a depth of penetration.
    """

    time: float
    place: float
    link: str
    obstacle: str
    distance: float


class Sweep:
    """Workspace: a motion among obstacles, and the exact distances that were asked for.

    Attributes:
        course: the robot's motion, with samples added where obstacles appear or vanish.
        asked: exact distances measured so far.
    """

    def __init__(self, robot: RobotModel, time: Array, chart: Array, world: World) -> None:
        """Place the robot at times (T,) [s], strictly ascending, and chart rows (T, nv), and bound all distances."""
        self.asked = 0
        self._world, self._obstacles = world, tuple(world.scene)
        self._parts = [part for o in self._obstacles for part in o.parts]
        self._owner = np.repeat(np.arange(len(self._obstacles)), [len(o.parts) for o in self._obstacles]).astype(int)
        self._request, self._result = coal.DistanceRequest(True), coal.DistanceResult()
        self._known: dict[tuple[int, int, float], float] = {}
        self._poses: dict[tuple[int, float], Array] = {}
        self._boxes: dict[int, tuple[Array, Array]] = {}
        events = np.array([t for t in world.event_times if time[0] < t < time[-1]])
        self.course = Course(robot, time, chart, events)
        time = self.course.time
        last = len(time) - 1
        cuts = sorted({0, last, *range(0, last, _BLOCK), *np.searchsorted(time, events).tolist()})
        self._blocks = np.array(list(pairwise(cuts)) or [(0, 0)])
        self._lower = self._bounds(np.array(cuts))

    def closest(self, accuracy: float) -> Approach | None:
        """The moment of least distance, to within ``accuracy`` [m]; None if no obstacle existed meanwhile.

        Whether anything touched is settled to `TOUCH`, however coarse the accuracy.
        """
        best, where = np.inf, None

        def settled(bound: float) -> bool:
            return bound >= best - accuracy and (bound > TOUCH or best <= TOUCH)

        order = np.argsort(self._lower, axis=None)
        bounds = self._lower.ravel()[order]
        count = int(np.searchsorted(bounds, np.inf))
        blocks, links, parts = np.unravel_index(order[:count], self._lower.shape)
        heap: list[tuple[float, int, int, float, float]] = []
        at = 0
        while at < count or heap:
            if heap and (at == count or heap[0][0] <= bounds[at]):
                bound, g, p, a, b = heapq.heappop(heap)
            else:
                bound, g, p = float(bounds[at]), int(links[at]), int(parts[at])
                a, b = map(float, self._blocks[blocks[at]])
                at += 1
            if settled(bound):
                break
            middle = _middle(a, b)
            places = (a, b) if middle is None else (a, middle, b)
            distances = [self.distance(g, p, u) for u in places]
            for u, d in zip(places, distances, strict=True):
                if d < best:
                    best, where = d, (g, p, u)
            for (u, d), (w, e) in pairwise(zip(places, distances, strict=True)):
                least = 0.5 * (d + e - self._moved(g, p, u, w))
                if middle is not None and not settled(least):
                    heapq.heappush(heap, (least, g, p, u, w))
        return None if where is None else self._approach(*where)

    def contacts(self) -> list[Approach]:
        """All samples at which a pair touches, and a moment of each contact between two samples; in order of time."""
        found: dict[tuple[int, int, float], Approach] = {}
        for block, g, p in np.argwhere(self._lower <= TOUCH).tolist():
            first, last = self._blocks[block].tolist()
            stack: list[tuple[float, float]] = [(float(first), float(last))]
            while stack:
                a, b = stack.pop()
                d, e = self.distance(g, p, a), self.distance(g, p, b)
                for u, x in ((a, d), (b, e)):
                    if x <= TOUCH:
                        found[g, p, u] = self._approach(g, p, u)
                middle = _middle(a, b)
                known = b - a <= 1.0 and min(d, e) <= TOUCH  # that they touch in this interval
                if middle is not None and not known and 0.5 * (d + e - self._moved(g, p, a, b)) <= TOUCH:
                    stack += [(middle, b), (a, middle)]
        return sorted(found.values(), key=lambda c: (c.time, c.distance))

    def distance(self, link: int, part: int, place: float) -> float:
        """Signed distance [m] of a link and a part at a place of the course."""
        key = (link, part, place)
        known = self._known.get(key)
        if known is None:
            T = self._pose(int(self._owner[part]), place) @ self._parts[part].T_obstacle_part
            known = self._known[key] = self._ask(self.course.links[link], self.course.pose(link, place), part, T)
        return known

    def _ask(self, link: Link, at: coal.Transform3s, part: int, T: Array) -> float:
        members = self._parts[part]
        if members.geometry is not None:
            return self._exact(link, at, members.geometry, T)
        if part not in self._boxes:
            half = [np.array(shape.aabb_local.max_) for shape, _ in members.boxes]
            self._boxes[part] = np.array([offset for _, offset in members.boxes]), np.array(half)
        offsets, half = self._boxes[part]
        # the nearest member of a block: those first that a sphere about the link says may be it
        centre = (at.getRotation() @ link.centre + at.getTranslation() - T[:3, 3]) @ T[:3, :3]
        apart = _outside(np.abs(centre - offsets) - half) - link.radius
        best = np.inf
        for i in np.argsort(apart).tolist():
            if apart[i] >= best:
                break
            pose = T.copy()
            pose[:3, 3] += T[:3, :3] @ offsets[i]
            best = min(best, self._exact(link, at, members.boxes[i][0], pose))
        return best

    def _exact(self, link: Link, at: coal.Transform3s, other: Any, T: Array) -> float:
        shape = link.shape
        if isinstance(other, coal.Cylinder):
            shape = link.rounded  # Coal's closed form for a sphere and a cylinder forgets the caps
        elif isinstance(other, coal.Sphere) and isinstance(shape, coal.Cylinder):
            other = coal.Capsule(other.radius, 0.0)
        self.asked += 1
        self._result.clear()  # an older, smaller distance would stay
        return float(coal.distance(shape, at, other, transform(T), self._request, self._result))

    def _approach(self, g: int, p: int, u: float) -> Approach:
        name = str(self._obstacles[self._owner[p]].name)
        return Approach(self.course.moment(u), u, self.course.links[g].name, name, self.distance(g, p, u))

    def _pose(self, k: int, u: float) -> Array:
        """Pose (4, 4) of an obstacle at a place, also at the moment when it vanishes."""
        obstacle = self._obstacles[k]
        if obstacle.motion is None:
            return obstacle.pose
        pose = self._poses.get((k, u))
        if pose is None:
            pose = self._poses[k, u] = obstacle.at(self.course.moment(u)).pose
        return pose

    def _moved(self, g: int, p: int, a: float, b: float) -> float:
        """Most that any points of link and part travelled between two places [m]."""
        return self.course.moved(g, a, b) + self._obstacle_moved(int(self._owner[p]), a, b)

    def _obstacle_moved(self, k: int, a: float, b: float) -> float:
        obstacle = self._obstacles[k]
        if obstacle.motion is None or obstacle.motion.still or a == b:
            return 0.0
        begin, end = self.course.moment(a), self.course.moment(b)
        return obstacle.speed_bound(start=begin, end=end) * (end - begin)

    def _bounds(self, cuts: Indices) -> Array:
        """Lower bounds (B, G, P) [m] of the distances in each block; infinite where the obstacle does not exist."""
        course, links = self.course, self.course.links
        first, last = self._blocks.T
        apart = np.empty((len(cuts), len(links), len(self._parts)))
        rotation, translation = course.poses[cuts][..., :3, :3], course.poses[cuts][..., :3, 3]
        centre = np.matmul(rotation, np.array([link.centre for link in links])[..., None])[..., 0] + translation
        radius = np.array([link.radius for link in links])
        for p, part in enumerate(self._parts):
            apart[..., p] = _apart(centre, self._course_of(int(self._owner[p]), cuts), part) - radius
        places = np.searchsorted(cuts, first), np.searchsorted(cuts, last)
        own = np.array([course.travelled(a, b) for a, b in self._blocks])
        way = np.array([[self._obstacle_moved(k, a, b) for k in range(len(self._obstacles))] for a, b in self._blocks])
        there = np.array([self._exists(k, first, last) for k in range(len(self._obstacles))]).reshape(-1, len(first)).T
        moved = own[:, :, None] + way.reshape(len(first), -1)[:, None, self._owner]
        lower = 0.5 * (apart[places[0]] + apart[places[1]] - moved)
        return np.where(there[:, None, self._owner], lower, np.inf)

    def _course_of(self, k: int, cuts: Indices) -> Array:
        """Poses (1 or cuts, 4, 4) of an obstacle."""
        if self._obstacles[k].motion is None:
            return self._obstacles[k].pose[None]
        return np.array([self._pose(k, float(u)) for u in cuts])

    def _exists(self, k: int, first: Indices, last: Indices) -> Mask:
        name, time = str(self._obstacles[k].name), self.course.time
        begin, end = self._world.appears.get(name, -np.inf), self._world.vanishes.get(name, np.inf)
        return (begin <= time[first]) & (time[first] < end) & (time[last] <= end)


def _apart(centre: Array, T: Array, part: Part) -> Array:
    """Signed distances (B, G) [m] of points (B, G, 3) from a part's bounding box."""
    local = np.matmul(centre - T[:, None, :3, 3], T[:, :3, :3]) - part.center
    return _outside(np.abs(local) - part.half_extents)


def _outside(beyond: Array) -> Array:
    """Signed distances (…) from a box of points that are ``beyond`` (…, 3) each pair of its faces; all in metres."""
    return np.sqrt(np.square(np.maximum(beyond, 0.0)).sum(axis=-1)) + np.minimum(beyond.max(axis=-1), 0.0)


def _middle(a: float, b: float) -> float | None:
    """A place in the middle, a sample as long as there is one; None where it is not worth while."""
    if b - a > 1.0:
        return float((int(a) + int(b)) // 2)
    return 0.5 * (a + b) if b - a > _FINEST else None
