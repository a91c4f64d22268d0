"""Internal forces: the spacing-aware elastic force, the rolling penalty, and the paper's Eq. 4."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array

from ..robot import ConfigurationSpace
from ..robot.space import wrap_angle
from .system import System


def add_elastic(system: System, space: ConfigurationSpace, v: Array, weight: Array, name: str = "elastic") -> float:
    """Springs between neighbouring nodes: V = ½ Σ_j v_jᵀ diag(w) v_j with v_j = ``pin.difference(q_j, q_{j+1})``.

    Being quadratic in the spacing itself, it shortens the strip *and* spreads its nodes evenly, which Eq. 4 does not.
    A large weight of the base's v_y is the rolling penalty of a differential drive.

    Args:
        system: accumulates force and matrix.
        space: configuration space.
        v: (N−1, nv) segment tangents.
        weight: (nv,) stiffness of each tangent coordinate.
        name: key of the energy.

    Returns:
        The potential V.
    """
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
    system.energies[name] = system.energies.get(name, 0.0) + energy
    return energy


def add_rolling(system: System, space: ConfigurationSpace, v: Array, stiffness: float) -> float:
    """Penalty of sideways travel of a differential drive: V = ½ k Σ_j v_y,j² (the equality is enforced afterwards)."""
    weight = np.zeros(space.nv)
    weight[1] = stiffness
    return add_elastic(system, space, v, weight, name="rolling")


def contraction_force(points: Array, k_c: float) -> Array:
    """The paper's elastic force (Eq. 4) on every control point of every node.

    It has no potential: it pulls a point towards where its neighbours' spacing ratio d⁻/(d⁻+d⁺) puts it on the chord,
    and does not resist stretching along the strip.

    Args:
        points: (N, C, 3) control points [m].
        k_c: contraction gain.

    Returns:
        Forces (N, C, 3); zero at the two ends.
    """
    force = np.zeros_like(points)
    back = points[1:-1] - points[:-2]
    ahead = points[2:] - points[1:-1]
    d_back, d_ahead = np.linalg.norm(back, axis=2), np.linalg.norm(ahead, axis=2)
    total = d_back + d_ahead
    ratio = np.divide(d_back, total, out=np.full_like(total, 0.5), where=total > 0)
    force[1:-1] = k_c * (ratio[..., None] * (points[2:] - points[:-2]) - back)
    return force


def contraction_torque(yaw: Array, points: Array, k_c: float) -> Array:
    """Eq. 4 for the heading of the mobile, whose position vector in the paper is [x, y, φ].

    Args:
        yaw: (N,) headings [rad].
        points: (N, 3) the mobile's control point, whose spacing gives the ratio [m].
        k_c: contraction gain.

    Returns:
        Torques (N,); zero at the two ends.
    """
    torque = np.zeros_like(yaw)
    d_back = np.linalg.norm(points[1:-1] - points[:-2], axis=1)
    d_ahead = np.linalg.norm(points[2:] - points[1:-1], axis=1)
    total = d_back + d_ahead
    ratio = np.divide(d_back, total, out=np.full_like(total, 0.5), where=total > 0)
    back, ahead = wrap_angle(yaw[1:-1] - yaw[:-2]), wrap_angle(yaw[2:] - yaw[1:-1])
    torque[1:-1] = k_c * (ratio * (back + ahead) - back)
    return torque
