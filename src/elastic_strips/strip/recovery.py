"""Recovery: how a broken strip gives way: no farther than the intrusions require, and not through the robot's links."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.collision import ObstacleProximity, SelfProximity
from elastic_strips.robot import Kinematics

from .solver import System

_ROOM_BETWEEN_NODES = 0.02  # [m] beyond the clearance that a step is to give the nodes, for the way between them
_LEAST_STEP_SHARE = 0.25  # of a step is made in any case
_OWN_LINKS_ROOM = 0.004  # [m] beyond their clearance that the robot's own links keep, where they had it
_HELD_STIFFNESS, _NODES_ASIDE = (
    200.0,
    2,
)  # stiffness of joints that are not to move, and nodes aside of where they would do harm


@dataclass(frozen=True, slots=True)
class Intrusions:
    """Contacts that lie nearer to a strip's inner nodes than a step is to leave them.

    Attributes:
        node: (K,) nodes.
        rows: (K, nv) gradients of the distances there.
        missing: (K,) by how much the distances are to grow [m].
    """

    node: Indices
    rows: Array
    missing: Array

    @staticmethod
    def of(kin: Kinematics, obstacles: ObstacleProximity, clearance: float) -> Intrusions:
        """The intrusions of a strip that is to keep ``clearance`` [m]."""
        contacts, wanted = obstacles.contacts(), clearance + _ROOM_BETWEEN_NODES
        near = np.flatnonzero((contacts.distance < wanted) & (contacts.node > 0) & (contacts.node < kin.n - 1))
        node, joint = contacts.node[near], obstacles.bodies.joint[contacts.body[near]]
        rows = kin.directional(node, joint, contacts.witness[near], contacts.direction[near])
        return Intrusions(node, rows, wanted - contacts.distance[near])

    def share(self, delta: Array) -> float:
        """Part of a step (N, nv) after which, to first order, they are gone; the whole step where it is not enough."""
        gain = np.einsum("kj,kj->k", self.rows, delta[self.node])
        if np.any(gain < self.missing):
            return 1.0
        return float((self.missing / gain).max(initial=_LEAST_STEP_SHARE)) if len(gain) else 1.0


def own_distances_to_keep(pairs: SelfProximity, self_clearance: float) -> Array:
    """(N, S) distances [m] of the robot's own links that a step is not to go below: some room, or what they have."""
    return np.minimum(pairs.bound, np.minimum(self_clearance + _OWN_LINKS_ROOM, pairs.repulsion))


def hold_joints(system: System, base_nv: int, lost: Mask) -> Mask:
    """Make the joints stiff at and about the nodes ``lost`` (N,), so that the base gives way there; which those are."""
    about = np.convolve(lost, np.ones(2 * _NODES_ASIDE + 1))[_NODES_ASIDE:-_NODES_ASIDE] > 0.0
    joints = np.arange(base_nv, system.force.shape[1])
    system.diagonal[np.flatnonzero(about)[:, None], joints, joints] += _HELD_STIFFNESS
    return about
