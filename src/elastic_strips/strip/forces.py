"""Forces of the default preset. Each adds force, matrix and potential to a :class:`System`; `FORCES` lists them all."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from elastic_strips.arrays import Array, Indices
from elastic_strips.collision import ObstacleProximity, SelfProximity
from elastic_strips.collision.narrowphase import Contacts
from elastic_strips.robot import ConfigurationSpace, Kinematics

from .constraint import ConstraintForce
from .followed import FollowedPath
from .params import DeformParams
from .solver import System


def repulsive_potential(distance: Array, k_r: float, influence: float) -> Array:
    """Eq. 2: V = ½ k_r (d_r − d)² inside the influence distance d_r, else 0."""
    return 0.5 * k_r * np.maximum(influence - distance, 0.0) ** 2


def repulsive_magnitude(distance: Array, k_r: float, influence: float) -> Array:
    """Eq. 3: |f| = k_r (d_r − d) inside the influence distance, else 0; it points away from the obstacle."""
    return k_r * np.maximum(influence - distance, 0.0)


def add_elastic(system: System, space: ConfigurationSpace, v: Array, weight: Array) -> None:
    """Springs between neighbouring nodes: V = ½ Σ_j v_jᵀ diag(w) v_j with v_j = ``pin.difference(q_j, q_{j+1})``.

    V is quadratic in the spacing itself, so it shortens the strip *and* spreads its nodes evenly, which Eq. 4 does not.
    A large weight of the base's v_y is the rolling penalty of a differential drive.

    Args:
        system: accumulates force and matrix.
        space: configuration space.
        v: (N−1, nv) segment tangents.
        weight: (nv,) stiffness of each tangent coordinate.
    """
    if system.native is not None:
        system.energies["elastic"] = system.native.add_elastic(space.planar, v, weight)
        return
    pull = v * weight
    energy = 0.5 * float(np.einsum("ij,ij->", pull, v))
    b = space.base_nv
    force, diagonal, upper = system.force, system.diagonal, system.upper
    if b:
        first, second = space.base_difference_jacobians(v)
        base = pull[:, :b, None]
        force[:-1, :b] -= np.matmul(first.transpose(0, 2, 1), base)[..., 0]
        force[1:, :b] -= np.matmul(second.transpose(0, 2, 1), base)[..., 0]
        w_first, w_second = weight[:b, None] * first, weight[:b, None] * second
        diagonal[:-1, :b, :b] += np.matmul(first.transpose(0, 2, 1), w_first)
        diagonal[1:, :b, :b] += np.matmul(second.transpose(0, 2, 1), w_second)
        upper[:, :b, :b] += np.matmul(first.transpose(0, 2, 1), w_second)
    force[:-1, b:] += pull[:, b:]
    force[1:, b:] -= pull[:, b:]
    index = np.arange(b, space.nv)
    diagonal[:-1, index, index] += weight[b:]
    diagonal[1:, index, index] += weight[b:]
    upper[:, index, index] -= weight[b:]
    system.energies["elastic"] = energy


def add_pieces(system: System, space: ConfigurationSpace, v: Array, weight: Array, pieces: Array) -> None:
    """Add what springs lack that are pieces of one spring: half of a spring is twice as stiff.

    So a node that is put in changes no force and no energy, and stays where it was put. With one more equal spring it
    would be drawn away, and another node put in again.

    Args:
        system, space, v, weight: as for :func:`add_elastic`, which has been called.
        pieces: (N−1,) into how many each segment's spring was divided.
    """
    for j in np.flatnonzero(pieces > 1.0).tolist():
        more = (pieces[j] - 1.0) * weight
        system.energies["elastic"] += 0.5 * float((more * v[j] * v[j]).sum())
        _add_segment(system, space, j, v[j], more, more)


def add_stretch(
    system: System,
    space: ConfigurationSpace,
    v: Array,
    weight: Array,
    *,
    stiffness: float,
    length: float | Array,
) -> None:
    """Springs of segments that are longer than they should be: V = ¼ k Σ_j (s_j² − s²)₊² / s², s_j² = v_jᵀ diag(w) v_j.

    Where obstacles push nodes apart along the strip, out of a door, they keep the nodes in it.

    Args:
        system, space, v: as for :func:`add_elastic`.
        weight: (nv,) metric of the spacing.
        stiffness: k.
        length: s [m], or (N−1,) lengths of the segments.
    """
    over = (v * v) @ weight / np.square(length) - 1.0
    long = np.flatnonzero(over > 0.0)
    taut = np.broadcast_to(length, over.shape)[long]
    system.energies["stretch"] = 0.25 * stiffness * float((taut**2 * over[long] ** 2).sum())
    for j in long.tolist():
        pull, stiff = stiffness * over[j] * weight, stiffness * (3.0 * over[j] + 2.0) * weight
        _add_segment(system, space, j, v[j], pull, stiff)


def _add_segment(system: System, space: ConfigurationSpace, j: int, v: Array, pull: Array, stiff: Array) -> None:
    """A spring of one segment with force −diag(pull) v and matrix diag(stiff)."""
    first, second = -np.eye(space.nv), np.eye(space.nv)
    b = space.base_nv
    if b:
        first[:b, :b], second[:b, :b] = (part[0] for part in space.base_difference_jacobians(v[None]))
    system.force[j] -= first.T @ (pull * v)
    system.force[j + 1] -= second.T @ (pull * v)
    system.diagonal[j] += first.T @ (stiff[:, None] * first)
    system.diagonal[j + 1] += second.T @ (stiff[:, None] * second)
    system.upper[j] += first.T @ (stiff[:, None] * second)


def add_repulsion(
    system: System,
    kin: Kinematics,
    contacts: Contacts,
    joint: Indices,
    *,
    k_r: float,
    influence: float,
    k_near: float = 0.0,
    near: float = 0.0,
) -> None:
    """Repulsion at the links' witness points: Eqs. 2–3 mapped by Eqs. 6–7, with a stiffer layer close to obstacles.

    V = Σ ½ k_r (d_r − d)₊² + ½ k_near (d_near − d)₊².

    Args:
        system: accumulates force and matrix.
        kin: kinematics of the nodes.
        contacts: pairs within the influence distance.
        joint: (G,) joint of each body.
        k_r, influence: gain and influence distance d_r [m].
        k_near, near: gain and distance [m] of the stiff layer.
    """
    distance = contacts.distance
    energy = float(repulsive_potential(distance, k_r, influence).sum())
    push = repulsive_magnitude(distance, k_r, influence)
    stiffness = np.where(push > 0.0, k_r, 0.0)
    if k_near > 0.0:
        energy += float(repulsive_potential(distance, k_near, near).sum())
        extra = repulsive_magnitude(distance, k_near, near)
        push = push + extra
        stiffness = stiffness + np.where(extra > 0.0, k_near, 0.0)
    if len(contacts):
        rows = kin.directional(contacts.node, joint[contacts.body], contacts.witness, contacts.direction)
        system.add_rows(contacts.node, rows, push, stiffness)
    system.energies["repulsion"] = energy


def add_obstacle_repulsion(
    system: System, kin: Kinematics, obstacles: ObstacleProximity, *, k_r: float, k_near: float, near: float
) -> None:
    """:func:`add_repulsion` of all that is within a proximity's influence distance."""
    influence = obstacles.influence
    if system.native is None or obstacles.narrow.native is None or obstacles.candidates is None:
        contacts, joint = obstacles.contacts(), obstacles.bodies.joint
        add_repulsion(system, kin, contacts, joint, k_r=k_r, influence=influence, k_near=k_near, near=near)
        return
    system.energies["repulsion"] = system.native.add_repulsion(
        obstacles.narrow.native.calls, kin.J, obstacles.arrays, influence, k_r, near, k_near
    )


def add_self_repulsion(system: System, kin: Kinematics, proximity: SelfProximity, *, k_s: float) -> None:
    """Repulsion between the robot's own links: V = Σ ½ k_s (d_s − d)₊², d_s the pair's repulsion distance."""
    if system.native is not None and proximity.native is not None:
        system.energies["self_collision"] = system.native.add_self_repulsion(
            proximity.native.calls, kin.T, kin.J, proximity.arrays, proximity.repulsion, k_s
        )
        return
    contacts = proximity.contacts()
    gap = np.maximum(proximity.repulsion[contacts.pair] - contacts.distance, 0.0)
    energy = 0.5 * k_s * float((gap**2).sum())
    if len(contacts):
        joint = proximity.bodies.joint
        one, two = proximity.pairs[contacts.pair, 0], proximity.pairs[contacts.pair, 1]
        rows = kin.directional(contacts.node, joint[one], contacts.first, contacts.direction)
        rows = rows - kin.directional(contacts.node, joint[two], contacts.second, contacts.direction)
        system.add_rows(contacts.node, rows, k_s * gap, np.where(gap > 0.0, k_s, 0.0))
    system.energies["self_collision"] = energy


def add_joint_limits(
    system: System, space: ConfigurationSpace, coordinates: Array, *, k_l: float, margin: float
) -> None:
    """Push back joints that come within ``margin`` [rad or m] of a limit: V = Σ ½ k_l (margin − gap)₊²."""
    below, above = space.lower + margin - coordinates, coordinates - (space.upper - margin)
    system.energies["joint_limits"] = 0.0
    if max(below.max(initial=0.0), above.max(initial=0.0)) <= 0.0:
        return
    np.maximum(below, 0.0, out=below)
    np.maximum(above, 0.0, out=above)
    system.force += k_l * (below - above)
    index = np.arange(space.nv)
    system.diagonal[:, index, index] += k_l * ((below > 0).astype(float) + (above > 0))
    system.energies["joint_limits"] = 0.5 * k_l * float((below**2).sum() + (above**2).sum())


def add_posture(system: System, space: ConfigurationSpace, coordinates: Array, target: Array, *, k_p: Array) -> None:
    """Pull the joints towards a posture: V = ½ Σ k_p (θ − θ*)².

    Args:
        system: accumulates force and matrix.
        space: configuration space.
        coordinates: (N, nv) nodes.
        target: (nv,) or (N, nv) posture; the base's entries do not count.
        k_p: (nv,) gains, zero for the base.
    """
    b = space.base_nv
    if target.shape != coordinates.shape:
        target = np.broadcast_to(target, coordinates.shape)
    if system.native is not None:
        target = np.ascontiguousarray(target)
        system.energies["posture"] = system.native.add_posture(coordinates, target, k_p, space.circular)
        return
    off = np.zeros_like(coordinates)
    off[:, b:] = coordinates[:, b:] - target[:, b:]
    if space.circular.any():
        wrapped = np.arctan2(np.sin(off[:, b:]), np.cos(off[:, b:]))
        off[:, b:] = np.where(space.circular, wrapped, off[:, b:])
    energy = 0.5 * float((k_p * off**2).sum())
    system.force -= k_p * off
    index = np.arange(space.nv)
    system.diagonal[:, index, index] += k_p
    system.energies["posture"] = energy


class Acting(NamedTuple):
    """What forces act on in one update, and how.

    Attributes:
        params: with the gains.
        space: configuration space.
        kin: kinematics of the nodes.
        coordinates: (N, nv) nodes.
        v: (N−1, nv) segment tangents.
        obstacles, self_pairs: what is near the links.
        near, k_near: distance [m] and gain of the stiff layer about obstacles.
        stiffness: (nv,) of the springs between nodes.
        k_posture: (nv,) gains of the posture, zero for the base.
        posture: makes (N, nv) the posture of nodes.
        constraint: what the strip is to satisfy besides, or None.
        path: path that the base keeps to, or None.
        further: adds forces of whoever asks for the tick, for the segment tangents ``v``.
    """

    params: DeformParams
    space: ConfigurationSpace
    kin: Kinematics
    coordinates: Array
    v: Array
    obstacles: ObstacleProximity
    self_pairs: SelfProximity
    near: float
    k_near: float
    stiffness: Array
    k_posture: Array
    posture: Callable[[Array], Array]
    constraint: ConstraintForce | None
    path: FollowedPath | None
    further: Callable[[System, Array], None]


def _elastic(system: System, at: Acting) -> None:
    add_elastic(system, at.space, at.v, at.stiffness)


def _further(system: System, at: Acting) -> None:
    at.further(system, at.v)


def _obstacle_repulsion(system: System, at: Acting) -> None:
    add_obstacle_repulsion(system, at.kin, at.obstacles, k_r=at.params.k_r, k_near=at.k_near, near=at.near)


def _self_repulsion(system: System, at: Acting) -> None:
    add_self_repulsion(system, at.kin, at.self_pairs, k_s=at.params.k_self)


def _joint_limits(system: System, at: Acting) -> None:
    gain = at.params.k_limit * at.params.joint_lever**2
    add_joint_limits(system, at.space, at.coordinates, k_l=gain, margin=at.params.limit_margin)


def _constraint(system: System, at: Acting) -> None:
    if at.constraint is not None:
        at.constraint.push(system, at.kin)


def _path(system: System, at: Acting) -> None:
    if at.path is not None:
        at.path.push(system, at.coordinates)


def _posture(system: System, at: Acting) -> None:
    if at.params.k_posture > 0.0:
        add_posture(system, at.space, at.coordinates, at.posture(at.coordinates), k_p=at.k_posture)


FORCES: tuple[Callable[[System, Acting], None], ...] = (
    _elastic,
    _further,
    _obstacle_repulsion,
    _self_repulsion,
    _joint_limits,
    _constraint,
    _path,
    _posture,
)
"""All forces of an update, in the order in which they are added up."""
