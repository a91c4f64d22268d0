"""The configuration space SE(2) × Rⁿ: base kinds, and batched twins of Pinocchio functions.

Pinocchio works on one configuration a call. A tick needs a whole strip at once, so the library holds configurations
in *coordinates*: one number per degree of freedom, ``[x, y, yaw, joints…]`` for a planar root and ``[joints…]`` for a
fixed one, with all arithmetic vectorised over the leading axes. Tests prove it
equal to ``pin.difference``, ``pin.integrate``, ``pin.interpolate`` and ``pin.dDifference``.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, Indices, Mask, by_rows
from elastic_strips.constants import SMALL_TURN
from elastic_strips.errors import RobotError, nearest_name
from elastic_strips.native import kernel
from elastic_strips.summary import Summary


class BaseKind(str, Enum):
    """How the root moves.

    ``DIFF_DRIVE``: planar, and the wheels allow no sideways velocity (v_y = 0 in the base's frame).
    ``OMNI``: planar without that constraint. ``FIXED``: it does not move.
    """

    DIFF_DRIVE = "diff_drive"
    OMNI = "omni"
    FIXED = "fixed"

    @property
    def planar(self) -> bool:
        """Whether the root moves in the plane."""
        return self is not BaseKind.FIXED

    @staticmethod
    def parse(value: str | BaseKind) -> BaseKind:
        """Read a base kind.

        Raises:
            RobotError: an unknown kind.
        """
        try:
            return BaseKind(value)
        except ValueError:
            names = [k.value for k in BaseKind]
            raise RobotError(f"base={value!r} is not a kind of base{nearest_name(value, names)}") from None


LIMIT_TOLERANCE = 1e-4
"""A joint value [rad or m] outside its limits by at most this is taken to the limit: files and programs round."""

UNLIMITED_SPEED = 1e6
"""A speed limit [rad/s or m/s] of a description that is larger means that there is none."""

MAX_TRAVEL = 1e4
"""Farthest [m] that a path may take a base from the origin, along x and along y."""


MOST_TURNS = 4.0 * np.pi
"""What turns farther [rad] may be meant in degrees."""


def beyond_turns(angle: float) -> str:
    """What is wrong with an angle [rad] that may be meant in degrees, to follow it; empty where it is not."""
    wrong = abs(angle) > MOST_TURNS
    return f"rad is beyond two turns; angles are in radians: math.radians({angle:g})" if wrong else ""


def is_follower(joint: pin.JointModel) -> bool:
    """Whether a joint of a Pinocchio model follows another one, and has no coordinate of its own."""
    return joint.shortname() == "JointModelMimic"


HALF_TURN = np.pi - 1e-5
"""A turn by more than this [rad] has two ways that are equally short."""


def nonzero(mask: Mask) -> tuple[Indices, ...]:
    """``np.nonzero`` of a mask with several axes and few true entries, several times as fast."""
    return np.unravel_index(np.flatnonzero(mask), mask.shape)


def rows_from(source: Indices) -> slice | Indices:
    """Rows to take over for nodes that were nodes ``source`` (M,); −1: a new node, whose row may hold anything.

    A slice where that is enough (the first nodes were passed, say), which copies nothing.
    """
    rows = np.maximum(source, 0)
    if len(rows) > 1 and source[0] < 0 < source[1]:
        rows[0] = source[1] - 1
    if len(rows) and (rows[1:] - rows[:-1] == 1).all():
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows


def wrap_angle(angle: Array) -> Array:
    """Wrap angles [rad] into (−π, π]."""
    return np.pi - np.mod(np.pi - angle, 2.0 * np.pi)


def _half_cot(theta: Array) -> Array:
    """(θ/2)·cot(θ/2), with its series near zero."""
    small = np.abs(theta) < SMALL_TURN
    half = np.where(small, 1.0, 0.5 * theta)
    return np.where(small, 1.0 - theta * theta / 12.0, half / np.tan(half))


@dataclass(frozen=True, slots=True, repr=False)
class ConfigurationSpace(Summary):
    """Layout of a planned model's configurations.

    Attributes:
        nq: size of a Pinocchio configuration.
        nv: size of a tangent vector, and of a coordinate row.
        planar: whether the first joint is ``JointModelPlanar`` (x, y, cos, sin → x, y, yaw).
        idx_q: (J,) index of each single-dof joint's (first) entry in q.
        circular: (J,) whether that joint stores (cos, sin), as continuous joints do.
        lower, upper: (nv,) coordinate limits; ±inf where there are none.
    """

    nq: int
    nv: int
    planar: bool
    idx_q: Indices
    circular: Mask
    lower: Array
    upper: Array

    @staticmethod
    def from_model(model: pin.Model) -> ConfigurationSpace:
        """Read the layout off a Pinocchio model whose joints are planar (root), revolute, continuous or prismatic.

        Raises:
            RobotError: a joint has more than one degree of freedom.
        """
        planar = model.njoints > 1 and model.joints[1].shortname() == "JointModelPlanar"
        first = 2 if planar else 1
        idx_q: list[int] = []
        circular: list[bool] = []
        lower, upper = [-np.inf] * (3 if planar else 0), [np.inf] * (3 if planar else 0)
        for i in range(first, model.njoints):
            joint = model.joints[i]
            if is_follower(joint):
                continue
            if joint.nv != 1 or joint.nq not in (1, 2):
                raise RobotError(
                    f"joint {model.names[i]!r} is a {joint.shortname()} with {joint.nv} degrees of freedom; planned "
                    "joints are revolute, continuous or prismatic. Lock it (locked={...}) or change its type."
                )
            idx_q.append(joint.idx_q)
            circular.append(joint.nq == 2)
            lower.append(-np.inf if joint.nq == 2 else float(model.lowerPositionLimit[joint.idx_q]))
            upper.append(np.inf if joint.nq == 2 else float(model.upperPositionLimit[joint.idx_q]))
        lo, up = np.asarray(lower, float), np.asarray(upper, float)
        lo.setflags(write=False)
        up.setflags(write=False)
        columns, turning = np.asarray(idx_q, dtype=np.intp), np.asarray(circular, dtype=bool)
        return ConfigurationSpace(model.nq, model.nv, planar, columns, turning, lo, up)

    @property
    def base_nv(self) -> int:
        """Number of the base's degrees of freedom: 3 for a planar root, else 0."""
        return 3 if self.planar else 0

    @property
    def turning(self) -> Mask:
        """(nv,) whether a coordinate is an angle that turns without end: the base's yaw, and circular joints."""
        base = np.array([False, False, True]) if self.planar else np.zeros(0, dtype=bool)
        return np.concatenate((base, self.circular))

    def to_coordinates(self, q: Array) -> Array:
        """Configurations (…, nq) to coordinate rows (…, nv)."""
        q = np.asarray(q, dtype=float)
        coordinates = np.empty((*q.shape[:-1], self.nv))
        b = self.base_nv
        if self.planar:
            coordinates[..., :2] = q[..., :2]
            coordinates[..., 2] = np.arctan2(q[..., 3], q[..., 2])
        if self.circular.any():
            angle = np.arctan2(q[..., np.minimum(self.idx_q + 1, self.nq - 1)], q[..., self.idx_q])
            coordinates[..., b:] = np.where(self.circular, angle, q[..., self.idx_q])
        else:
            coordinates[..., b:] = q[..., self.idx_q]
        return coordinates

    def from_coordinates(self, coordinates: Array) -> Array:
        """Coordinate rows (…, nv) to configurations (…, nq)."""
        coordinates = np.asarray(coordinates, dtype=float)
        q = np.empty((*coordinates.shape[:-1], self.nq))
        if self.planar:
            q[..., :2] = coordinates[..., :2]
            q[..., 2] = np.cos(coordinates[..., 2])
            q[..., 3] = np.sin(coordinates[..., 2])
        joints = coordinates[..., self.base_nv :]
        if self.circular.any():
            q[..., self.idx_q] = np.where(self.circular, np.cos(joints), joints)
            q[..., self.idx_q[self.circular] + 1] = np.sin(joints[..., self.circular])
        else:
            q[..., self.idx_q] = joints
        return q

    def difference(self, a: Array, b: Array) -> Array:
        """Tangent vectors (…, nv) that lead from coordinate rows ``a`` to ``b``: ``pin.difference``.

        The base part (v_x, v_y, ω) is the constant twist in the base's own frame (a screw arc) that takes unit time.
        """
        module = kernel()
        if module is not None and a.ndim == 2 and a.shape == b.shape:
            v = np.empty(a.shape)
            module.difference(self.planar, self.circular, *by_rows(a, b), v)
            return v
        v = np.subtract(b, a)
        n = self.base_nv
        if self.circular.any():
            v[..., n:] = np.where(self.circular, wrap_angle(v[..., n:]), v[..., n:])
        if self.planar:
            theta = wrap_angle(v[..., 2])
            cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
            tx = cos * v[..., 0] + sin * v[..., 1]
            ty = cos * v[..., 1] - sin * v[..., 0]
            alpha, half = _half_cot(theta), 0.5 * theta
            v[..., 0] = alpha * tx + half * ty
            v[..., 1] = alpha * ty - half * tx
            v[..., 2] = theta
        return v

    def integrate(self, a: Array, v: Array) -> Array:
        """Coordinate rows (…, nv) reached from ``a`` along tangent vectors ``v``: ``pin.integrate``."""
        module = kernel()
        if module is not None and a.ndim == 2 and a.shape == v.shape:
            out = np.empty(a.shape)
            module.integrate(self.planar, self.circular, *by_rows(a, v), out)
            return out
        out = np.add(a, v)
        if self.planar:
            theta = v[..., 2]
            small = np.abs(theta) < SMALL_TURN
            safe = np.where(small, 1.0, theta)
            s = np.where(small, 1.0 - theta * theta / 6.0, np.sin(safe) / safe)
            k = np.where(small, 0.5 * theta, (1.0 - np.cos(safe)) / safe)
            dx = s * v[..., 0] - k * v[..., 1]
            dy = k * v[..., 0] + s * v[..., 1]
            cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
            out[..., 0] = a[..., 0] + cos * dx - sin * dy
            out[..., 1] = a[..., 1] + sin * dx + cos * dy
        return out

    def interpolate(self, a: Array, b: Array, s: Array | float) -> Array:
        """Coordinate rows at the fraction ``s`` between ``a`` and ``b``: ``pin.interpolate`` (a screw arc of the base).

        The direction of a half turn is not defined (:meth:`half_turn`): this one turns by +π, and Pinocchio by whatever
        rounding makes of it.
        """
        return self.integrate(a, np.asarray(s, dtype=float)[..., None] * self.difference(a, b))

    def half_turn(self, v: Array) -> Mask:
        """(…) whether the base or a continuous joint turns by half a turn along tangent vectors ``v`` (…, nv).

        Between two such configurations there are two paths, and rounding decides which one Pinocchio takes; so nothing
        is certified on them. Within 1e-5 of π.
        """
        turned = np.abs(v[..., self.base_nv :][..., self.circular]).max(axis=-1, initial=0.0) >= HALF_TURN
        return turned | (np.abs(v[..., 2]) >= HALF_TURN) if self.planar else turned

    def base_difference_jacobians(self, v: Array) -> tuple[Array, Array]:
        """Base blocks (…, 3, 3) of ``pin.dDifference`` at base twists ``v`` (…, ≥3): wrt the first and the second.

        They are −Jl⁻¹ and Jr⁻¹ of SE(2); the joints' blocks are −I and I.
        """
        theta = v[..., 2]
        alpha, half = _half_cot(theta), 0.5 * theta
        small = np.abs(theta) < SMALL_TURN
        beta = np.where(small, theta / 12.0, (1.0 - alpha) / np.where(small, 1.0, theta))
        vx, vy = v[..., 0], v[..., 1]
        first = np.zeros((*theta.shape, 3, 3))
        second = np.zeros((*theta.shape, 3, 3))
        first[..., 0, 0] = first[..., 1, 1] = -alpha
        second[..., 0, 0] = second[..., 1, 1] = alpha
        first[..., 0, 1] = second[..., 0, 1] = -half
        first[..., 1, 0] = second[..., 1, 0] = half
        first[..., 0, 2] = -beta * vx + 0.5 * vy
        first[..., 1, 2] = -beta * vy - 0.5 * vx
        second[..., 0, 2] = beta * vx + 0.5 * vy
        second[..., 1, 2] = beta * vy - 0.5 * vx
        first[..., 2, 2] = -1.0
        second[..., 2, 2] = 1.0
        return first, second
