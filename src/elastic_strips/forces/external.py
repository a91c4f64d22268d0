"""External forces: repulsion from obstacles, at the links' witness points or at the paper's control points."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array, Indices

from ..proximity import Contacts, SelfContacts, SelfProximity
from ..robot import Kinematics
from .system import System


def repulsive_potential(distance: Array, k_r: float, influence: float) -> Array:
    """Eq. 2: V = ½ k_r (d_r − d)² inside the influence distance d_r, else 0."""
    return 0.5 * k_r * np.maximum(influence - distance, 0.0) ** 2


def repulsive_magnitude(distance: Array, k_r: float, influence: float) -> Array:
    """Eq. 3: |f| = k_r (d_r − d) inside the influence distance, else 0; it points away from the obstacle."""
    return k_r * np.maximum(influence - distance, 0.0)


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
) -> float:
    """Repulsion at the links' witness points: Eqs. 2–3 mapped by Eqs. 6–7, with a stiffer layer close to obstacles.

    V = Σ ½ k_r (d_r − d)₊² + ½ k_near (d_near − d)₊².

    Args:
        system: accumulates force and matrix.
        kin: kinematics of the nodes.
        contacts: pairs within the influence distance.
        joint: (G,) joint of each body.
        k_r, influence: gain and influence distance d_r [m].
        k_near, near: gain and distance [m] of the stiff layer.

    Returns:
        The potential V.
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
    return energy


def add_self_repulsion(
    system: System, kin: Kinematics, proximity: SelfProximity, contacts: SelfContacts, *, k_s: float
) -> float:
    """Repulsion between the robot's own links: V = Σ ½ k_s (d_s − d)₊², d_s the pair's repulsion distance.

    Returns:
        The potential V.
    """
    influence = proximity.repulsion[contacts.pair]
    gap = np.maximum(influence - contacts.distance, 0.0)
    energy = 0.5 * k_s * float((gap**2).sum())
    if len(contacts):
        joint = proximity.bodies.joint
        one, two = proximity.pairs[contacts.pair, 0], proximity.pairs[contacts.pair, 1]
        rows = kin.directional(contacts.node, joint[one], contacts.first, contacts.direction)
        rows = rows - kin.directional(contacts.node, joint[two], contacts.second, contacts.direction)
        system.add_rows(contacts.node, rows, k_s * gap, np.where(gap > 0.0, k_s, 0.0))
    system.energies["self_collision"] = energy
    return energy


def control_point_repulsion(contacts: Contacts, shape: tuple[int, int], *, k_r: float, influence: float) -> Array:
    """Eqs. 2–3 at the control points: the push (N, C, 3) from the *nearest* obstacle of each point.

    Args:
        contacts: pairs of control points and obstacles.
        shape: (N, C).
        k_r: repulsion gain.
        influence: the paper's safe distance d_r [m].
    """
    force = np.zeros((*shape, 3))
    if len(contacts) == 0:
        return force
    order = np.argsort(-contacts.distance, kind="stable")  # the nearest is written last
    push = repulsive_magnitude(contacts.distance, k_r, influence)[:, None] * contacts.direction
    force[contacts.node[order], contacts.body[order]] = push[order]
    return force


def map_to_joints(kin: Kinematics, joint: Indices, points: Array, force: Array) -> Array:
    """Eqs. 6–7: Γ = Σ_i J_iᵀ F_i of forces (N, C, 3) at control points (N, C, 3): generalised forces (N, nv)."""
    n = len(force)
    wrench = np.concatenate((force, np.cross(points, force)), axis=2)  # (N, C, 6) about the world origin
    mask = kin.tree.support[joint]  # (C, nv)
    return np.einsum("nvk,nck,cv->nv", kin.J[:n], wrench, mask)
