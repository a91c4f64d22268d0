"""Gaze: where a camera on joints that look had best look: at what will be passed through and has not been seen."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, ArrayLike, Indices, Mask
from elastic_strips.coal_shapes import outside, support_points
from elastic_strips.errors import RobotError
from elastic_strips.robot import RobotModel
from elastic_strips.robot.geometry import LinkGeometry
from elastic_strips.robot.kinematics import find_frame
from elastic_strips.validation import Checked, Count, Fraction, NonNegative, Positive

from .own_body import OwnBodies, Posture
from .rays import Nearest, Rays
from .volume_map import VolumeMap

_LATTICE = 0.08  # [m] between the points that stand for a body
_MOST_TARGETS = 1500
_CELL = 0.1  # [m] within which places are looked at together
_BLIND_LOOKS = 4  # looks in vain that one counts as in which nothing was seen at all
_ARRIVED = 0.2  # [rad or m] so near to where they are to be the joints are there
_AROUND_WORTH, _AGAIN_WORTH = 5e-4, 2.5e-4
"""What one point about the robot, and one of the way that has been seen before, is worth, where a whole row that is
come through now is worth 1."""
_OWN_MARGIN = 0.03  # [m] by which the robot's bodies are thought thicker, as in its images (`BodyMask`)
_LOWEST, _LAYER, _ABOVE = 0.2, 0.2, 0.2  # [m] of what is looked at about the robot, from layer to layer, and above it


@dataclass(frozen=True, slots=True, kw_only=True)
class GazeParams(Checked):
    """How a camera looks about.

    Attributes:
        ahead: what is passed through later than this counts less, by 1/e [s].
        dwell: how long it looks at one place at least [s].
        turning: what a second of turning costs, as a part of what the best view shows.
        margin: part of the picture at each of its borders that does not count.
        steps: postures that are tried, along each joint.
        forget: looks in vain count for this long [s].
        seeing: after a look that showed nothing it looks for this long [s] where it saw something last.
        around: what has not been seen is looked at up to this distance [m] where nothing is to be passed through.
    """

    ahead: Positive = 1.0
    dwell: NonNegative = 0.2
    turning: NonNegative = 0.3
    margin: Fraction = 0.08
    steps: Count = 13
    forget: Positive = 8.0
    seeing: NonNegative = 1.0
    around: Positive = 1.4


class Gaze:
    """Workspace: chooses the values of a robot's joints that look. One per camera.

    What is in doubt of a row that is come through counts together as much as all of it would: a motion is stopped by
    the last point that was not seen as by a hundred. What the robot itself hides now is not looked at.

    Args:
        robot: the robot; it has joints that look (``load_robot(…, looking=…)``).
        frame: link of the camera.
        T_frame_camera: (4, 4) pose of the camera on it: z looks, x to the right, y down.
        field_of_view: of a picture's width and of its height [rad].
        reach: from which distance to which the camera sees [m].
        params: how it looks about.

    Attributes:
        target: what it looks at, (3,) [m] in the world; None before the first look.
        wanted: (L,) values of the joints that look.

    Raises:
        RobotError: no joint of the robot looks, they do not carry the camera, or there is no such link.
    """

    def __init__(
        self,
        robot: RobotModel,
        frame: str,
        T_frame_camera: Array,
        field_of_view: tuple[float, float],
        reach: tuple[float, float],
        params: GazeParams | None = None,
    ) -> None:
        if not robot.looking:
            raise RobotError(f"no joint of {robot.name!r} looks: load_robot(…, looking=[…])")
        self.params: GazeParams = params or GazeParams()
        self._robot, self._reach = robot, reach
        self._slopes = np.tan(0.5 * np.array(field_of_view)) * (1.0 - 2.0 * self.params.margin)
        self._posture = Posture(robot)
        seeing = robot.seeing
        joints = [seeing.model.getJointId(name) for name in robot.looking]
        index = find_frame(seeing.model, frame)
        if index is None or seeing.model.frames[index].parentJoint not in joints:
            raise RobotError(f"{frame!r} is no link of {robot.name!r} that {', '.join(robot.looking)} carry")
        first = min(joints)
        self._k: Indices = np.array([seeing.model.joints[j].idx_v for j in joints])
        k = self._k
        self.lower: Array = seeing.space.lower[k]
        self.upper: Array = seeing.space.upper[k]
        speed = seeing.model.velocityLimit[k]
        self.speed: Array = np.where(speed > 0.0, speed, 1.0)  # where the description has none
        self._anchor = robot.model.getJointId(seeing.model.names[seeing.model.parents[first]])
        ranges = [np.linspace(low, high, self.params.steps) for low, high in zip(self.lower, self.upper, strict=True)]
        self._values: Array = np.array(list(itertools.product(*ranges)))
        self._T_anchor_camera = self._cameras(seeing, k, index, seeing.model.parents[first]) @ T_frame_camera
        self._bodies = [(p.joint, _lattice(p)) for p in robot.geometries]
        carried = [p for p in seeing.geometries if set(joints) & set(seeing.model.supports[p.joint])]
        head = {link for p in carried for link in p.links}
        self._hiding = OwnBodies([p for p in robot.geometries if not head & set(p.links)], _OWN_MARGIN)
        self.wanted: Array = np.array([robot.locked[name] for name in robot.looking])
        self.target: Array | None = None
        self._since = -math.inf
        self._vain: dict[tuple[int, int, int], tuple[int, float]] = {}  # looks at a voxel, and the time of the last
        self._looked: list[tuple[int, int, int]] = []  # voxels that it looks at
        self._saw: Array | None = None  # values of the joints where it saw something last

    def _cameras(self, seeing: RobotModel, k: Indices, frame: int, anchor: int) -> Array:
        """(G, 4, 4) poses of the camera's link, in the frame of the joint that carries the head."""
        data, row = seeing.model.createData(), seeing.space.to_coordinates(seeing.home_q)
        poses = []
        for values in self._values:
            row[k] = values
            pin.forwardKinematics(seeing.model, data, seeing.space.from_coordinates(row))
            placed = pin.updateFramePlacement(seeing.model, data, frame)
            poses.append((data.oMi[anchor].inverse() * placed).homogeneous)
        return np.array(poses)

    def note(self, t: float, q: ArrayLike, *, blind: bool) -> None:
        """An image has come. Who sees nothing, such as before a wall nearer than the camera sees, looks where it last
        saw something, and does not look there again soon.

        Args:
            t: time [s].
            q: (nq,) configuration at exposure, with the joints that look.
            blind: whether the image says nothing.
        """
        values = self._robot.seeing.space.to_coordinates(np.asarray(q, dtype=float))[self._k]
        if not blind:
            self._saw = values
        elif self._looked and np.abs(values - self.wanted).max() <= _ARRIVED:
            self._count(t, self._looked, _BLIND_LOOKS)
            self._looked = []
            if self._saw is not None:
                self.wanted, self._since, self.target = self._saw, t + self.params.seeing - self.params.dwell, None

    def _count(self, t: float, voxels: Sequence[tuple[int, int, int]], looks: int) -> None:
        """Count looks at voxels."""
        for key in voxels:
            self._vain[key] = (self._vain.get(key, (0, t))[0] + looks, t)

    def look(self, t: float, row: Array, ahead: Array, values: Array, volume: VolumeMap, step: float = 0.2) -> Array:
        """Where the joints that look are to go.

        Args:
            t: time [s].
            row: (nv,) coordinate row of the robot now.
            ahead: (K, nv) rows that it will come through, the next one first; may be empty.
            values: (L,) where the joints that look are now [rad or m].
            volume: what has been seen.
            step: time from row to row [s].

        Returns:
            Their values (L,), within their limits.
        """
        p = self.params
        if t - self._since < p.dwell or (np.abs(values - self.wanted).max() > 0.05 and t - self._since < 4.0 * p.dwell):
            return self.wanted
        self._posture.place(row)
        T = self._posture.T_world_joint[self._anchor] @ self._T_anchor_camera
        targets, weights = self._targets(t, row, ahead, volume, step)
        seen_past = ~self._hidden(row, T[int(np.abs(self._values - values).sum(axis=1).argmin()), :3, 3], targets)
        targets, weights = targets[seen_past], weights[seen_past]
        if not len(targets):
            self._since = t
            return self.wanted
        local = np.einsum("gji,gnj->gni", T[:, :3, :3], targets[None] - T[:, None, :3, 3])
        z = local[..., 2]
        seen = (z > self._reach[0]) & (z < self._reach[1])
        with np.errstate(divide="ignore", invalid="ignore"):
            seen &= (np.abs(local[..., 0]) < z * self._slopes[0]) & (np.abs(local[..., 1]) < z * self._slopes[1])
        turn = (np.abs(self._values - values) / self.speed).max(axis=1)
        gain = seen @ weights
        best = int(np.argmax(gain - p.turning * float(gain.max()) * turn))
        self.wanted, self._since = self._values[best], t
        inside = seen[best]
        if inside.any():
            self.target = np.average(targets[inside], axis=0, weights=weights[inside] + 1e-12)
            self._looked = [(v[0], v[1], v[2]) for v in np.floor(targets[inside] / _CELL).astype(int).tolist()]
            self._count(t, self._looked, 1)
        return self.wanted

    def _hidden(self, row: Array, eye: Array, points: Array) -> Mask:
        """(n,) whether the robot, at a coordinate row (nv,), hides points (n, 3) from a camera at ``eye`` (3,) [m]."""
        way = points - eye
        far = np.linalg.norm(way, axis=1)
        nearest = Nearest(len(points))
        if len(points):
            self._posture.place(row)
            rays = Rays(eye[None], way / np.maximum(far, 1e-9)[:, None])
            self._hiding.cast(self._posture.T_world_joint, rays, nearest, float(far.max()))
        return np.asarray(nearest.distance < far)

    def _targets(self, t: float, row: Array, ahead: Array, volume: VolumeMap, step: float) -> tuple[Array, Array]:
        """Points (n, 3) that are to be seen and how much that is worth (n,): first of all what is passed through."""
        p = self.params
        self._vain = {voxel: look for voxel, look in self._vain.items() if t - look[1] < p.forget}
        clouds = [self._cloud(ahead[k]) for k in range(len(ahead))]
        some = np.concatenate([np.zeros((0, 3)), *clouds])
        of = np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds])  # the row that comes through a point
        new = volume.doubtful(some) & (some[:, 2] > volume.params.low)
        some, of = some[new], of[new]
        worth = np.exp(-of * step / p.ahead)
        x, y = (float(row[0]), float(row[1])) if self._robot.space.planar else (0.0, 0.0)
        flat = np.arange(-p.around, p.around + 1e-9, 0.2)
        heights = np.arange(_LOWEST, float(self._cloud(row)[:, 2].max()) + _ABOVE, _LAYER)
        grid = np.stack(np.meshgrid(x + flat, y + flat, heights, indexing="ij"), axis=-1).reshape(-1, 3)
        grid = grid[volume.doubtful(grid) & (np.hypot(grid[:, 0] - x, grid[:, 1] - y) <= p.around)]
        some = np.concatenate((some, grid))
        worth = np.concatenate((worth, np.full(len(grid), _AROUND_WORTH)))
        if self._robot.space.planar:  # the way is looked at again, for something may have come
            some = np.concatenate((some, np.column_stack((ahead[:, :2], np.full(len(ahead), 0.6)))))
            worth = np.concatenate((worth, np.full(len(ahead), _AGAIN_WORTH)))
        of = np.concatenate((of, np.arange(len(ahead), len(ahead) + len(some) - len(of))))  # the others: each alone
        order = np.argsort(-worth, kind="stable")
        some, worth, of = some[order], worth[order], of[order]
        voxels, first = np.unique(np.floor(some / _CELL).astype(int), axis=0, return_index=True)
        some, worth, of = some[first], worth[first], of[first]
        looks = np.array([self._vain.get((v[0], v[1], v[2]), (0, 0.0))[0] for v in voxels.tolist()])
        left = 1.0 / (1.0 + looks) ** 3  # of what it is worth, after looks in vain
        total, most = np.bincount(of, left), np.zeros(int(of.max(initial=-1)) + 1)
        np.maximum.at(most, of, left)
        worth = worth * left / total[of] * most[of]
        order = np.argsort(-worth, kind="stable")[:_MOST_TARGETS]
        return some[order], worth[order]

    def _cloud(self, row: Array) -> Array:
        """(n, 3) points in the robot and next to it at a coordinate row (nv,) [m]."""
        self._posture.place(row)
        T = self._posture.T_world_joint
        return np.concatenate([points @ T[j, :3, :3].T + T[j, :3, 3] for j, points in self._bodies])


def _lattice(piece: LinkGeometry) -> Array:
    """Points (n, 3) of a grid in a piece and next to it, in its joint's frame; at least its middle."""
    corners, radius = support_points(piece.geometry)
    low, high = corners.min(axis=0) - radius, corners.max(axis=0) + radius
    axes = [np.linspace(a, b, max(2, math.ceil((b - a) / _LATTICE) + 1)) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    points = np.vstack((points[outside(piece.geometry, points) < 0.5 * _LATTICE], 0.5 * (low + high)))
    return points @ piece.placement[:3, :3].T + piece.placement[:3, 3]
