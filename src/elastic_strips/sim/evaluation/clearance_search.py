"""Clearance search: least distance between a recorded motion of the robot and obstacles, at and between samples.

Branch and bound over time, for all pairs of a link and an obstacle's part at once. Between two moments with distances
d_a and d_b the distance of a pair is at least (d_a + d_b − w) / 2, where w bounds the displacements of both. Distances
are Coal's at Pinocchio's placements. It checks the results of proximity and certificate, so it shares no code with
them: not the kinematics, the culling, the motion bounds, or the queries to Coal.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from itertools import pairwise

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.robot import RobotModel
from elastic_strips.robot.geometry import LinkGeometry
from elastic_strips.scene import World
from elastic_strips.scene.parts import Part

_SIGNS = np.array(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0])).reshape(3, -1).T


class _Link:
    """A convex piece of the robot with its bounds.

    Attributes:
        name: name of the piece.
        joint: the joint that carries it.
        placement: (4, 4) its pose in the joint's frame.
        shape: Coal's shape.
        rounded: the same, a sphere as a capsule of no length.
        corners: (8, 3) corners of its box in the shape's frame [m].
        centre, radius: (3,) centre and radius of a sphere about it in the shape's frame [m].
        lever: (nv,) largest motion of any of its points for one unit of each velocity [m].
        turns: (nv,) how fast each velocity turns it: 1 for those that do, else 0, more where joints follow.
    """

    def __init__(self, robot: RobotModel, piece: LinkGeometry) -> None:
        self.name, self.joint, self.placement, self.shape = piece.name, piece.joint, piece.placement, piece.geometry
        self.rounded = coal.Capsule(self.shape.radius, 0.0) if isinstance(self.shape, coal.Sphere) else self.shape
        self.shape.computeLocalAABB()
        low, high = np.array(self.shape.aabb_local.min_), np.array(self.shape.aabb_local.max_)
        self.corners = low + _SIGNS * (high - low)
        self.centre, self.radius = np.array(self.shape.aabb_center), float(self.shape.aabb_radius)
        model = robot.model
        self.lever, self.turns = np.zeros(model.nv), np.zeros(model.nv)
        reach = float(np.linalg.norm(piece.placement[:3, :3] @ self.centre + piece.placement[:3, 3])) + self.radius
        joint = piece.joint
        while joint > 0:
            kind, i, k = model.joints[joint].shortname(), model.joints[joint].idx_v, model.joints[joint].idx_q
            multiplier, constant = 1.0, 0.0
            if kind == "JointModelMimic":  # it moves besides what it follows
                own = model.joints[joint].extract()
                multiplier, constant = float(own.scaling), float(own.offset)
            if kind == "JointModelPlanar":
                self.lever[i : i + 3], self.turns[i + 2] = (1.0, 1.0, reach), 1.0
            elif kind.startswith("JointModelP") or (kind == "JointModelMimic" and robot.tree.prismatic[joint]):
                self.lever[i] += abs(multiplier)
                limits = np.array([model.lowerPositionLimit[k], model.upperPositionLimit[k]])
                reach += float(np.abs(multiplier * limits + constant).max())
            else:
                self.lever[i] += abs(multiplier) * reach
                self.turns[i] += abs(multiplier)
            reach += float(np.linalg.norm(model.jointPlacements[joint].translation))
            joint = model.parents[joint]


class LinkMotion:
    """Workspace: poses of all links along recorded samples; between two of them the robot moves by ``pin.interpolate``.

    A *place* is a number in [0, T − 1]: a sample, or with a fraction a moment between two samples.

    Attributes:
        time: (T,) times [s].
        q: (T, nq) configurations.
        links: the robot's pieces (G).
        poses: (T, G, 4, 4) world poses of their shapes.
    """

    time: Array
    q: Array

    def __init__(self, robot: RobotModel, time: Array, coordinates: Array, more: Array) -> None:
        """Place the links at samples (T, nv), and at ``more`` times [s] between them."""
        self._model, self._data = robot.model, robot.model.createData()
        self.time, self.q = _with_samples(robot, time, coordinates, more)
        self.links: tuple[_Link, ...] = tuple(_Link(robot, piece) for piece in robot.geometries)
        self.poses: Array = self._poses()
        self._pace = self._travel()
        self._way = np.vstack((np.zeros((1, len(self.links))), np.cumsum(self._pace, axis=0)))
        self._placed: dict[tuple[int, float], coal.Transform3s] = {}

    def moment(self, place: float) -> float:
        """Time [s] of a place."""
        k = int(place)
        share = place - k
        return float(self.time[k] if share == 0.0 else (1.0 - share) * self.time[k] + share * self.time[k + 1])

    def travelled(self, begin: int, end: int) -> Array:
        """(G,) largest motion of any point of each link between two samples [m]."""
        return self._way[end] - self._way[begin]

    def moved(self, link: int, a: float, b: float) -> float:
        """Largest motion [m] of any point of a link from place ``a`` to ``b``: two samples, or within one interval."""
        if b - a >= 1.0:
            return float(self._way[int(b), link] - self._way[int(a), link])
        return 0.0 if a == b else (b - a) * float(self._pace[int(a), link])

    def pose(self, link: int, place: float) -> coal.Transform3s:
        """World pose of a link's shape at a place, for Coal."""
        known = self._placed.get((link, place))
        if known is None:
            known = self._placed[link, place] = transform(self._matrix(link, place))
        return known

    def _matrix(self, link: int, place: float) -> Array:
        k = int(place)
        if place == k:
            return self.poses[k, link]
        pin.forwardKinematics(
            self._model, self._data, pin.interpolate(self._model, self.q[k], self.q[k + 1], place - k)
        )
        piece = self.links[link]
        return self._data.oMi[piece.joint].homogeneous @ piece.placement

    def _poses(self) -> Array:
        used = sorted({link.joint for link in self.links})
        joints = np.empty((len(self.q), len(used), 4, 4))
        for row, q in zip(joints, self.q, strict=True):
            pin.forwardKinematics(self._model, self._data, q)
            for k, joint in enumerate(used):
                row[k] = self._data.oMi[joint].homogeneous
        of = [used.index(link.joint) for link in self.links]
        return joints[:, of] @ np.array([link.placement for link in self.links])

    def _travel(self) -> Array:
        """Most that any point of each link moves in each interval (T − 1, G) [m]; in a share of it, at most that share.

        With all velocities constant in an interval, α what the joints before a link turn it by in all and S what they
        move it at most, no point of it accelerates by more than 2 α S: it is never faster than its chord plus 1.5 α S.
        The longest chord is that of a corner of a box about the link, as the motion is affine in the point.
        """
        corners = np.array([link.corners for link in self.links])
        world = np.matmul(corners, np.swapaxes(self.poses[..., :3, :3], -1, -2)) + self.poses[..., None, :3, 3]
        chord = np.sqrt(np.square(np.diff(world, axis=0)).sum(axis=-1).max(axis=-1))
        v = np.abs([pin.difference(self._model, a, b) for a, b in pairwise(self.q)]).reshape(-1, self._model.nv)
        turned = v @ np.array([link.turns for link in self.links]).T
        moved = v @ np.array([link.lever for link in self.links]).T
        return chord + 1.5 * turned * moved


def transform(T: Array) -> coal.Transform3s:
    """A homogeneous matrix (4, 4) for Coal."""
    return coal.Transform3s(np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3]))


def _with_samples(robot: RobotModel, time: Array, coordinates: Array, more: Array) -> tuple[Array, Array]:
    """Times (T',) and configurations (T', nq) with samples added at ``more`` times inside."""
    q = robot.space.from_coordinates(coordinates)
    times = np.union1d(time, more)
    if len(times) == len(time):
        return times, q
    rows = []
    for t in times.tolist():
        k = int(np.searchsorted(time, t, side="right")) - 1
        if t == time[k]:
            rows.append(q[k])
        else:
            share = float((t - time[k]) / (time[k + 1] - time[k]))
            rows.append(pin.interpolate(robot.model, q[k], q[k + 1], share))
    return times, np.array(rows)


_CONTACT_DISTANCE = 1e-5
"""Distances up to this [m] count as contact, by the accuracy of Coal."""
_SAMPLES_AT_ONCE = 32  # samples that are bounded at once
_FINEST_SHARE = 1e-6  # share of a sample interval that is not split any more, as where an obstacle jumps


@dataclass(frozen=True, slots=True)
class ClosestApproach:
    """A moment of a pair: time [s], place among the samples (a fraction is between two), link, obstacle, distance [m].

    A negative distance is a depth of penetration.
    """

    time: float
    place: float
    link: str
    obstacle: str
    distance: float


class ClearanceSearch:
    """Workspace: a motion among obstacles, and its measured exact distances.

    Attributes:
        motion: the robot's motion, with samples added where obstacles appear or vanish.
        queries: number of exact distances measured so far.
    """

    def __init__(self, robot: RobotModel, time: Array, coordinates: Array, world: World) -> None:
        """Place the robot at times (T,) [s], strictly ascending, and coordinates (T, nv); bound all distances."""
        self.queries: int = 0
        self._world, self._obstacles = world, tuple(world.scene)
        self._parts = [part for o in self._obstacles for part in o.parts]
        self._owner = np.repeat(np.arange(len(self._obstacles)), [len(o.parts) for o in self._obstacles]).astype(int)
        self._request, self._result = coal.DistanceRequest(True), coal.DistanceResult()
        self._known: dict[tuple[int, int, float], float] = {}
        self._poses: dict[tuple[int, float], Array] = {}
        self._boxes: dict[int, tuple[Array, Array]] = {}
        events = np.array([t for t in world.event_times if time[0] < t < time[-1]])
        self.motion: LinkMotion = LinkMotion(robot, time, coordinates, events)
        time = self.motion.time
        last = len(time) - 1
        cuts = sorted({0, last, *range(0, last, _SAMPLES_AT_ONCE), *np.searchsorted(time, events).tolist()})
        self._blocks = np.array(list(pairwise(cuts)) or [(0, 0)])
        self._lower = self._bounds(np.array(cuts))

    def closest(self, accuracy: float) -> ClosestApproach | None:
        """The moment of least distance, to within ``accuracy`` [m]; None if no obstacle existed meanwhile.

        Whether anything touched is settled to `_CONTACT_DISTANCE`, however coarse the accuracy.
        """
        best, where = np.inf, None

        def settled(bound: float) -> bool:
            return bound >= best - accuracy and (bound > _CONTACT_DISTANCE or best <= _CONTACT_DISTANCE)

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

    def contacts(self) -> list[ClosestApproach]:
        """All samples at which a pair touches, and a moment of each contact between two samples; in order of time."""
        found: dict[tuple[int, int, float], ClosestApproach] = {}
        for block, g, p in np.argwhere(self._lower <= _CONTACT_DISTANCE).tolist():
            first, last = self._blocks[block].tolist()
            stack: list[tuple[float, float]] = [(float(first), float(last))]
            while stack:
                a, b = stack.pop()
                d, e = self.distance(g, p, a), self.distance(g, p, b)
                for u, x in ((a, d), (b, e)):
                    if x <= _CONTACT_DISTANCE:
                        found[g, p, u] = self._approach(g, p, u)
                middle = _middle(a, b)
                known = b - a <= 1.0 and min(d, e) <= _CONTACT_DISTANCE  # that they touch in this interval
                if middle is not None and not known and 0.5 * (d + e - self._moved(g, p, a, b)) <= _CONTACT_DISTANCE:
                    stack += [(middle, b), (a, middle)]
        return sorted(found.values(), key=lambda c: (c.time, c.distance))

    def distance(self, link: int, part: int, place: float) -> float:
        """Signed distance [m] of a link and a part at a place of the motion."""
        key = (link, part, place)
        known = self._known.get(key)
        if known is None:
            T = self._pose(int(self._owner[part]), place) @ self._parts[part].T_obstacle_part
            known = self._known[key] = self._measure(self.motion.links[link], self.motion.pose(link, place), part, T)
        return known

    def _measure(self, link: _Link, at: coal.Transform3s, part: int, T: Array) -> float:
        members = self._parts[part]
        if members.geometry is not None:
            return self._exact(link, at, members.geometry, T)
        if part not in self._boxes:
            half = [np.array(shape.aabb_local.max_) for shape, _ in members.boxes]
            self._boxes[part] = np.array([offset for _, offset in members.boxes]), np.array(half)
        offsets, half = self._boxes[part]
        # the nearest member of a block, in order of the distance from a sphere about the link
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

    def _exact(self, link: _Link, at: coal.Transform3s, other: coal.CollisionGeometry, T: Array) -> float:
        shape = link.shape
        if isinstance(other, coal.Cylinder):
            shape = link.rounded  # Coal's closed form for a sphere and a cylinder ignores the caps
        elif isinstance(other, coal.Sphere) and isinstance(shape, coal.Cylinder):
            other = coal.Capsule(other.radius, 0.0)
        self.queries += 1
        self._result.clear()  # an older, smaller distance would stay
        return float(coal.distance(shape, at, other, transform(T), self._request, self._result))

    def _approach(self, g: int, p: int, u: float) -> ClosestApproach:
        name = str(self._obstacles[self._owner[p]].name)
        return ClosestApproach(self.motion.moment(u), u, self.motion.links[g].name, name, self.distance(g, p, u))

    def _pose(self, k: int, u: float) -> Array:
        """Pose (4, 4) of an obstacle at a place, also at the moment when it vanishes."""
        obstacle = self._obstacles[k]
        if obstacle.motion is None:
            return obstacle.pose
        pose = self._poses.get((k, u))
        if pose is None:
            pose = self._poses[k, u] = obstacle.at(self.motion.moment(u)).pose
        return pose

    def _moved(self, g: int, p: int, a: float, b: float) -> float:
        """Bound of the displacement of link and part between two places [m]."""
        return self.motion.moved(g, a, b) + self._obstacle_moved(int(self._owner[p]), a, b)

    def _obstacle_moved(self, k: int, a: float, b: float) -> float:
        obstacle = self._obstacles[k]
        if obstacle.motion is None or obstacle.motion.still or a == b:
            return 0.0
        begin, end = self.motion.moment(a), self.motion.moment(b)
        return obstacle.speed_bound(start=begin, end=end) * (end - begin)

    def _bounds(self, cuts: Indices) -> Array:
        """Lower bounds (B, G, P) [m] of the distances in each block; infinite where the obstacle does not exist."""
        motion, links = self.motion, self.motion.links
        first, last = self._blocks.T
        apart = np.empty((len(cuts), len(links), len(self._parts)))
        rotation, translation = motion.poses[cuts][..., :3, :3], motion.poses[cuts][..., :3, 3]
        centre = np.matmul(rotation, np.array([link.centre for link in links])[..., None])[..., 0] + translation
        radius = np.array([link.radius for link in links])
        for p, part in enumerate(self._parts):
            apart[..., p] = _apart(centre, self._obstacle_poses(int(self._owner[p]), cuts), part) - radius
        places = np.searchsorted(cuts, first), np.searchsorted(cuts, last)
        own = np.array([motion.travelled(a, b) for a, b in self._blocks])
        way = np.array([[self._obstacle_moved(k, a, b) for k in range(len(self._obstacles))] for a, b in self._blocks])
        there = np.array([self._exists(k, first, last) for k in range(len(self._obstacles))]).reshape(-1, len(first)).T
        moved = own[:, :, None] + way.reshape(len(first), -1)[:, None, self._owner]
        lower = 0.5 * (apart[places[0]] + apart[places[1]] - moved)
        return np.where(there[:, None, self._owner], lower, np.inf)

    def _obstacle_poses(self, k: int, cuts: Indices) -> Array:
        """Poses (1 or cuts, 4, 4) of an obstacle."""
        if self._obstacles[k].motion is None:
            return self._obstacles[k].pose[None]
        return np.array([self._pose(k, float(u)) for u in cuts])

    def _exists(self, k: int, first: Indices, last: Indices) -> Mask:
        name, time = str(self._obstacles[k].name), self.motion.time
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
    """The middle of two places, at a sample where there is one; None below the finest resolution."""
    if b - a > 1.0:
        return float((int(a) + int(b)) // 2)
    return 0.5 * (a + b) if b - a > _FINEST_SHARE else None
