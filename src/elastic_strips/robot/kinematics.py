"""Batched kinematics: the placements and Jacobian columns of a whole strip, in preallocated arrays; control points.

One call of Pinocchio handles one configuration, and reading its results costs more than computing them. This twin walks
the same tree once for all nodes; tests prove it equal to ``pin.forwardKinematics`` and ``pin.computeJointJacobians``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, ArrayLike, Indices, Mask
from elastic_strips.errors import RobotError, nearest_name
from elastic_strips.native import kernel
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.summary import Summary
from elastic_strips.work import count_work

from .mimic import carrier_name, followers_of
from .space import ConfigurationSpace

if TYPE_CHECKING:
    from elastic_strips.native import _native


def _rotation_to_axis(axis: Array) -> Array:
    """A rotation (3, 3) whose third column is ``axis``."""
    z = axis / np.linalg.norm(axis)
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return np.column_stack((x, np.cross(z, x), z))


@dataclass(frozen=True, slots=True, repr=False)
class KinematicTree(Summary):
    """A Pinocchio model's joints as plain arrays, each joint's frame turned so that it moves about or along its z.

    A *motion* belongs to one joint (three to a planar root); a *coordinate* is what can be planned. A joint that
    follows another one has a motion of its own and the coordinate of its leader; without such joints motions are
    coordinates.

    Attributes:
        space: the configuration space.
        parents: (njoints,) parent joint index; 0 is the universe.
        offset: (njoints, 4, 4) placement of each aligned joint frame in its parent's aligned frame.
        align: (njoints, 3, 3) rotation from the aligned frame to Pinocchio's joint frame axes.
        prismatic: (njoints,) True for joints that slide.
        coordinate_index: (njoints,) coordinate column of each single-dof joint (−1 for universe and planar root).
        motion: (njoints,) motion of each single-dof joint (−1 likewise); those of joints further out are larger.
        support: (njoints, M) True where a motion moves the joint's body.
        coordinate: (M,) coordinate column of each motion.
        rate: (M,) how fast the motion is for each unit of its coordinate; 1 except for followers.
        shift: (M,) [rad or m] the motion at coordinate 0; 0 except for followers.
    """

    space: ConfigurationSpace
    parents: Indices
    offset: Array
    align: Array
    prismatic: Mask
    coordinate_index: Indices
    motion: Indices
    support: Mask
    coordinate: Indices
    rate: Array
    shift: Array

    @staticmethod
    def from_model(model: pin.Model, space: ConfigurationSpace) -> KinematicTree:
        """The tree of a Pinocchio model with this configuration space.

        Raises:
            RobotError: the batched kinematics differ from Pinocchio's.
        """
        n, motions = model.njoints, model.nvExtended
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        columns = np.asarray(data.J).reshape(6, motions)  # one-dimensional for nv = 1
        align = np.tile(np.eye(3), (n, 1, 1))
        prismatic = np.zeros(n, dtype=bool)
        coordinate_index, motion = np.full(n, -1, dtype=np.intp), np.full(n, -1, dtype=np.intp)
        support = np.zeros((n, motions), dtype=bool)
        coordinate, rate, shift = np.arange(motions), np.ones(motions), np.zeros(motions)
        following = followers_of(model)
        for i in range(1, n):
            joint = model.joints[i]
            m = joint.idx_vExtended
            support[i] = support[model.parents[i]]
            support[i, m : m + joint.nvExtended] = True
            if space.planar and i == 1:
                continue
            coordinate_index[i] = coordinate[m] = joint.idx_v
            motion[i] = m
            if model.names[i] in following:
                _, rate[m], shift[m] = following[model.names[i]]
                if rate[m] == 0.0:
                    raise RobotError(f"joint {model.names[i]!r} follows with a multiplier of 0: hold it still instead")
            column = data.oMi[i].actInv(pin.Motion(columns[:, m] / rate[m])).vector
            prismatic[i] = bool(np.linalg.norm(column[3:]) < 0.5)
            align[i] = _rotation_to_axis(column[:3] if prismatic[i] else column[3:])
        offset = np.tile(np.eye(4), (n, 1, 1))
        parents = np.asarray([model.parents[i] for i in range(n)], dtype=np.intp)
        for i in range(1, n):
            placement = model.jointPlacements[i]
            to_parent = align[parents[i]].T
            offset[i, :3, :3] = to_parent @ placement.rotation @ align[i]
            offset[i, :3, 3] = to_parent @ placement.translation
        tree = KinematicTree(
            space, parents, offset, align, prismatic, coordinate_index, motion, support, coordinate, rate, shift
        )
        tree._compare(model, data)
        return tree

    def _compare(self, model: pin.Model, data: pin.Data) -> None:
        """Compare once with what Pinocchio computes, on this very machine and for arrays of this size.

        All proofs rest on it, and NumPy has returned wrong values for single array sizes before.

        Raises:
            RobotError: they differ.
        """
        space = self.space
        low, high = np.maximum(space.lower, -np.pi), np.minimum(space.upper, np.pi)
        coordinates = np.random.default_rng(0).uniform(np.minimum(low, high), np.maximum(low, high), (4, space.nv))
        kin = Kinematics(self, len(coordinates))
        kin.update(coordinates)
        for n, q in enumerate(space.from_coordinates(coordinates)):
            pin.computeJointJacobians(model, data, q)
            placed = [
                (data.oMi[i] * pin.SE3(self.align[i], np.zeros(3))).homogeneous[:3] for i in range(1, model.njoints)
            ]
            off = max(
                float(np.abs(kin.T[1:, n] - np.reshape(placed, (-1, 3, 4))).max(initial=0.0)),
                float(np.abs(kin.J[n].T - np.reshape(data.J, (6, len(self.coordinate)))).max(initial=0.0)),
            )
            size = 1.0 + float(np.abs(kin.T[:, n]).max())
            if not off <= 1e-9 * size:
                raise RobotError(
                    f"the batched kinematics of {model.name!r} (nv {space.nv}) differ from Pinocchio's by {off:.3g}: "
                    f"nothing could be certified. Is NumPy {np.__version__} at fault? Try another version."
                )

    def native(self) -> _native.Tree | None:
        """The tree as the native kernel takes it, or None where there is none."""
        module = kernel()
        if module is None:
            return None
        space = self.space
        return module.Tree(
            space.planar,
            self.parents,
            self.motion,
            self.prismatic,
            space.circular,
            self.support,
            self.offset,
            self.coordinate,
            self.rate,
            self.shift,
        )

    @property
    def follows(self) -> bool:
        """Whether a joint follows another one."""
        return len(self.coordinate) > self.space.nv

    @property
    def multiplier(self) -> Array:
        """(njoints,) how fast each joint moves for each unit of its coordinate."""
        return np.append(self.rate, 1.0)[self.motion]

    @property
    def constant(self) -> Array:
        """(njoints,) [rad or m] value of each joint where its coordinate is 0."""
        return np.append(self.shift, 0.0)[self.motion]

    @property
    def sliding(self) -> Mask:
        """(J,) which planned joints slide, so that their coordinate is a length [m]."""
        single = self.coordinate_index >= 0
        _, leaders = np.unique(self.coordinate_index[single], return_index=True)  # before their followers
        return self.prismatic[single][leaders]

    def moving(self, joint: int) -> Mask:
        """(nv,) which coordinates move a joint's body."""
        return self.summed(self.support[joint].astype(float)) > 0.0

    def summed(self, motions: Array) -> Array:
        """Effects (…, M) of motions, each for a unit of its coordinate, by coordinates (…, nv)."""
        if not self.follows:
            return motions
        out = np.zeros((*motions.shape[:-1], self.space.nv))
        for m, k in enumerate(self.coordinate.tolist()):
            out[..., k] += motions[..., m]
        return out

    def to_motions(self, coordinates: Array) -> Array:
        """Motions (…, M) at coordinate rows (…, nv)."""
        return coordinates[..., self.coordinate] * self.rate + self.shift if self.follows else coordinates

    def to_aligned(self, joint: int, T_joint: Array) -> Array:
        """A placement (4, 4) given in Pinocchio's joint frame, expressed in the aligned frame."""
        out = np.array(T_joint, dtype=float)
        out[:3] = self.align[joint].T @ out[:3]
        return out


class Kinematics(OneThread):
    """Workspace: aligned joint placements and world Jacobian columns of many nodes.

    Args:
        tree: the robot's tree, ``RobotModel.tree``.
        capacity: number of nodes to make room for; it grows where there are more.

    Attributes (valid for the first ``n`` nodes after :meth:`update`):
        T: (njoints, capacity, 3, 4) world placements of the aligned joint frames; T[0] is the identity.
        J: (capacity, M, 6) world spatial Jacobian columns of all motions as rows, [linear, angular] at the world
            origin, each for a unit of its coordinate: ``data.J.T``.
        coordinates: (capacity, nv) the configurations.
    """

    coordinates: Array

    def __init__(self, tree: KinematicTree, capacity: int = 64) -> None:
        self.tree = tree
        self.n: int = 0
        self.native: _native.Tree | None = tree.native()
        self._allocate(capacity)

    def _allocate(self, capacity: int) -> None:
        n, nv, motions = len(self.tree.parents), self.tree.space.nv, len(self.tree.coordinate)
        self.capacity = capacity
        self.T = np.zeros((n, capacity, 3, 4))
        self.T[:, :, 0, 0] = self.T[:, :, 1, 1] = self.T[:, :, 2, 2] = 1.0
        self.J = np.zeros((capacity, motions, 6))
        self.coordinates = np.zeros((capacity, nv))
        if self.tree.space.planar:
            self.J[:, 2, 5] = 1.0

    @exclusive
    def update(self, coordinates: Array, *, jacobians: bool = True) -> None:
        """Compute placements (and Jacobian columns) of the coordinate rows (N, nv)."""
        n = len(coordinates)
        if n > self.capacity:
            self._allocate(max(n, 2 * self.capacity))
        self.n = n
        self.coordinates[:n] = coordinates
        tree, T = self.tree, self.T
        if n > 1:  # a single one, as in every control step, takes a tenth of the time
            count_work(batches=1)
        if self.native is not None:
            self.native.place(self.coordinates[:n], T, self.J, jacobians)
            return
        motions = tree.to_motions(coordinates)
        cos, sin = np.cos(motions), np.sin(motions)
        for i in range(1, len(tree.parents)):
            k = tree.motion[i]
            parent = T[tree.parents[i], :n]
            if k < 0:
                base = T[i, :n]
                base[:, 0, 0] = base[:, 1, 1] = cos[:, 2]
                base[:, 1, 0] = sin[:, 2]
                base[:, 0, 1] = -sin[:, 2]
                base[:, :2, 3] = coordinates[:, :2]
                base[:, 2, 3] = 0.0
                continue
            frame = parent.reshape(3 * n, 4) @ tree.offset[i]
            frame = frame.reshape(n, 3, 4)
            out = T[i, :n]
            if tree.prismatic[i]:
                out[:] = frame
                out[:, :, 3] += frame[:, :, 2] * motions[:, k, None]
            else:
                c, s = cos[:, k, None], sin[:, k, None]
                x, y = frame[:, :, 0], frame[:, :, 1]
                out[:, :, 0] = c * x + s * y
                out[:, :, 1] = c * y - s * x
                out[:, :, 2:] = frame[:, :, 2:]
        if jacobians:
            self._columns(n)

    def _columns(self, n: int) -> None:
        tree, T, J = self.tree, self.T, self.J
        if tree.space.planar:
            base = T[1, :n]
            J[:n, 0, :2] = base[:, :2, 0]
            J[:n, 1, :2] = base[:, :2, 1]
            J[:n, 2, 0] = base[:, 1, 3]
            J[:n, 2, 1] = -base[:, 0, 3]
        single = np.flatnonzero(tree.coordinate_index >= 0)
        if len(single) == 0:
            return
        frames = T[single, :n]
        axis, origin = frames[..., 2], frames[..., 3]
        moment = np.empty_like(axis)  # origin × axis
        moment[..., 0] = origin[..., 1] * axis[..., 2] - origin[..., 2] * axis[..., 1]
        moment[..., 1] = origin[..., 2] * axis[..., 0] - origin[..., 0] * axis[..., 2]
        moment[..., 2] = origin[..., 0] * axis[..., 1] - origin[..., 1] * axis[..., 0]
        columns = tree.motion[single]
        sliding = tree.prismatic[single]
        if sliding.any():
            linear = np.where(sliding[:, None, None], axis, moment)
            angular = np.where(sliding[:, None, None], 0.0, axis)
        else:
            linear, angular = moment, axis
        J[:n, columns, :3] = linear.transpose(1, 0, 2)
        J[:n, columns, 3:] = angular.transpose(1, 0, 2)
        if tree.follows:
            J[:n] *= tree.rate[:, None]

    def columns(self, joint: int) -> Array:
        """(n, nv, 6) what each coordinate does to a joint's body: its Jacobian columns as rows, at the world origin."""
        J = self.J[: self.n] * self.tree.support[joint][None, :, None]
        return self.tree.summed(J.transpose(0, 2, 1)).transpose(0, 2, 1) if self.tree.follows else J

    def points(self, joints: Indices, local: Array) -> Array:
        """World positions (N, P, 3) of points fixed to aligned joint frames: ``joints`` (P,), ``local`` (P, 3)."""
        frames = self.T[joints, : self.n]
        out = np.matmul(frames[..., :3], local[:, None, :, None])[..., 0] + frames[..., 3]
        return out.transpose(1, 0, 2)

    def directional(self, node: Indices, joint: Indices, point: Array, direction: Array) -> Array:
        """Rows nᵀJ (K, nv) of LOCAL_WORLD_ALIGNED point Jacobians: how fast points move along directions.

        Args:
            node: (K,) nodes.
            joint: (K,) Pinocchio joint that carries each point.
            point: (K, 3) world positions [m].
            direction: (K, 3) directions n, world frame.
        """
        wrench = np.empty((len(node), 6, 1))
        wrench[:, :3, 0] = direction
        wrench[:, 3, 0] = point[:, 1] * direction[:, 2] - point[:, 2] * direction[:, 1]
        wrench[:, 4, 0] = point[:, 2] * direction[:, 0] - point[:, 0] * direction[:, 2]
        wrench[:, 5, 0] = point[:, 0] * direction[:, 1] - point[:, 1] * direction[:, 0]
        return self.tree.summed(np.matmul(self.J[node], wrench)[..., 0] * self.tree.support[joint])


@dataclass(frozen=True, slots=True)
class ControlPoints:
    """Points fixed to the robot's bodies.

    Attributes:
        names: (C,) names; the first is the base's for a planar root.
        joint: (C,) Pinocchio joint index that carries each point.
        local: (C, 3) position in that joint's frame [m].
    """

    names: tuple[str, ...]
    joint: Indices
    local: Array


def find_frame(model: pin.Model, name: str) -> int | None:
    """Index of a frame by name; a link's where a joint has the same name."""
    found = [i for i, frame in enumerate(model.frames) if frame.name == name]
    bodies = [i for i in found if model.frames[i].type == pin.FrameType.BODY]
    return (bodies or found or [None])[0]


def default_control_points(model: pin.Model, planar: bool, hand_frame: str | None = None) -> ControlPoints:
    """P_m at the base, one point at every joint's origin, and the hand; points that always coincide are one point."""
    first = 2 if planar else 1
    points = [("P_m", 1, np.zeros(3))] if planar else []
    names = list(model.names)
    moved = [i for i in range(first, model.njoints) if carrier_name(names[i]) not in names]
    points += [(f"P_{k}", i, np.zeros(3)) for k, i in enumerate(moved, 1)]
    hand = None if hand_frame is None else find_frame(model, hand_frame)
    if hand is not None:
        frame = model.frames[hand]
        carrier, at = int(frame.parentJoint), np.array(frame.placement.translation)
        if np.linalg.norm(at) > 1e-6 or carrier != points[-1][1]:
            points.append(("P_hand", carrier, at))
    return _control_points(points)


def parse_control_points(model: pin.Model, given: Mapping[str, str | tuple[str, ArrayLike]]) -> ControlPoints:
    """Control points given by the user: name → frame name, or name → (frame name, offset (3,) [m]).

    Raises:
        RobotError: an unknown frame, or an offset that is not three finite numbers.
    """
    points = []
    frames = [f.name for f in model.frames]
    if not given:
        raise RobotError("control_points is empty; give at least one, or None for the default")
    for name, value in given.items():
        frame_name, offset = (value, np.zeros(3)) if isinstance(value, str) else value
        if frame_name not in frames:
            raise RobotError(f"control point {name!r}: unknown frame {frame_name!r}{nearest_name(frame_name, frames)}")
        point = np.asarray(offset, dtype=float)
        if point.shape != (3,) or not np.all(np.isfinite(point)):
            raise RobotError(f"control point {name!r}: offset {offset!r} is not three finite numbers [m]")
        frame = model.frames[find_frame(model, frame_name) or 0]
        points.append((name, int(frame.parentJoint), frame.placement.act(point)))
    return _control_points(points)


def _control_points(points: Sequence[tuple[str, int, Array]]) -> ControlPoints:
    joint = np.array([joint for _, joint, _ in points], dtype=np.intp)
    local = np.array([local for _, _, local in points], dtype=float).reshape(-1, 3)
    return ControlPoints(tuple(name for name, _, _ in points), joint, local)
