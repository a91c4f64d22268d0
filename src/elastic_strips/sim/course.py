"""Sim room, course: where every link of the robot was, and how far it can have travelled between two moments.

Part of the judge: by Pinocchio alone, without the batched kinematics and the motion bounds that plans are made with.
"""

from __future__ import annotations

from itertools import pairwise

import coal
import numpy as np
import pinocchio as pin

from ..robot import LinkGeometry, RobotModel
from ..robot.space import Array

_SIGNS = np.array(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0])).reshape(3, -1).T


class Link:
    """A convex piece of the robot with what bounds it.

    Attributes:
        name: of the piece; joint: that carries it; placement: (4, 4) in the joint's frame.
        shape: Coal's; rounded: the same, a sphere as a capsule of no length.
        corners: (8, 3) of its box; centre (3,), radius [m]: of a sphere about it; all in the shape's frame.
        lever: (nv,) most that any of its points moves for one unit of each velocity [m].
        turns: (nv,) 1 for the velocities that turn it, else 0.
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
            kind, i = model.joints[joint].shortname(), model.joints[joint].idx_v
            if kind == "JointModelPlanar":
                self.lever[i : i + 3], self.turns[i + 2] = (1.0, 1.0, reach), 1.0
            elif kind.startswith("JointModelP"):
                self.lever[i] = 1.0
                k = model.joints[joint].idx_q
                reach += max(abs(model.lowerPositionLimit[k]), abs(model.upperPositionLimit[k]))
            else:
                self.lever[i], self.turns[i] = reach, 1.0
            reach += float(np.linalg.norm(model.jointPlacements[joint].translation))
            joint = model.parents[joint]


class Course:
    """Workspace: poses of all links along recorded samples; between two of them the robot moves by ``pin.interpolate``.

    A *place* is a number in [0, T − 1]: a sample, or with a fraction a moment between two samples.

    Attributes:
        time: (T,) [s].
        q: (T, nq) configurations.
        links: the robot's pieces (G).
        poses: (T, G, 4, 4) world poses of their shapes.
    """

    def __init__(self, robot: RobotModel, time: Array, chart: Array, more: Array) -> None:
        """Place the links at samples (T, nv), and at ``more`` times [s] between them."""
        self._model, self._data = robot.model, robot.model.createData()
        self.time, self.q = _with_samples(robot, time, chart, more)
        self.links = tuple(Link(robot, piece) for piece in robot.geometries)
        self.poses = self._poses()
        self._pace = self._travel()
        self._way = np.vstack((np.zeros((1, len(self.links))), np.cumsum(self._pace, axis=0)))
        self._placed: dict[tuple[int, float], coal.Transform3s] = {}

    def moment(self, place: float) -> float:
        """Time [s] of a place."""
        k = int(place)
        share = place - k
        return float(self.time[k] if share == 0.0 else (1.0 - share) * self.time[k] + share * self.time[k + 1])

    def travelled(self, begin: int, end: int) -> Array:
        """Most that any point of each link (G,) moved between two samples [m]."""
        return self._way[end] - self._way[begin]

    def moved(self, link: int, a: float, b: float) -> float:
        """Most that any point of a link moved from place ``a`` to ``b`` [m]: two samples, or within one interval."""
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


def _with_samples(robot: RobotModel, time: Array, chart: Array, more: Array) -> tuple[Array, Array]:
    """Times (T',) and configurations (T', nq) with samples added at ``more`` times inside."""
    q = robot.space.from_chart(chart)
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
