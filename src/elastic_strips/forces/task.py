"""Forces of a task that the strip keeps to while it gives way: an axis of the robot held along a direction."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array

from ..robot import Kinematics
from .system import System


def add_axis_task(system: System, kin: Kinematics, joint: int, axis: Array, target: Array, *, k_t: float) -> float:
    """Turn an axis of a link towards a direction: V = Σ ½ k_t ‖a − t‖², a and t of unit length.

    Args:
        system: accumulates force and matrix.
        kin: kinematics of the nodes.
        joint: that carries the axis.
        axis: (3,) unit vector in the joint's aligned frame.
        target: (3,) unit vector in the world.
        k_t: gain.

    Returns:
        The potential V.
    """
    n = kin.n
    a = axis_in_world(kin, joint, axis)
    off = a - target
    turning = kin.J[:n, :, 3:] * kin.tree.support[joint][:, None]  # (N, nv, 3)
    rows = np.cross(turning, a[:, None, :]).transpose(0, 2, 1).reshape(3 * n, -1)  # ∂a/∂q, three rows a node
    energy = 0.5 * k_t * float((off**2).sum())
    system.add_rows(np.repeat(np.arange(n), 3), rows, -k_t * off.reshape(-1), np.full(3 * n, k_t))
    system.energies["task"] = energy
    return energy


def axis_in_world(kin: Kinematics, joint: int, axis: Array) -> Array:
    """(N, 3) an axis of a joint's aligned frame, in the world."""
    return kin.T[joint, : kin.n, :, :3] @ axis
