"""The paper's equations 2 to 9: forces on control points, and the displacements that they make."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array, Indices
from elastic_strips.collision.narrowphase import Contacts
from elastic_strips.robot import Kinematics
from elastic_strips.robot.space import wrap_angle
from elastic_strips.strip.forces import repulsive_magnitude


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


def elastic_force(points: Array, k_c: float) -> Array:
    """The paper's elastic force (Eq. 4) on every control point of every node.

    It has no potential: it pulls a point towards the place on the chord that the spacing ratio d⁻/(d⁻+d⁺) gives it,
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


def elastic_torque(yaw: Array, points: Array, k_c: float) -> Array:
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


def map_to_joints(kin: Kinematics, joint: Indices, points: Array, force: Array) -> Array:
    """Eqs. 6–7: generalised forces (N, nv) Γ = Σ_i J_iᵀ F_i of forces (N, C, 3) at control points (N, C, 3)."""
    n = len(force)
    wrench = np.concatenate((force, np.cross(points, force)), axis=2)  # (N, C, 6) about the world origin
    mask = kin.tree.support[joint]  # (C, M)
    return kin.tree.summed(np.einsum("nvk,nck,cv->nv", kin.J[:n], wrench, mask))


def explicit_step(
    torque: Array, mobile_force: Array, *, planar: bool, alpha: Array, transfer_tilt: float, yaw: Array
) -> Array:
    """Displacements (N, nv) by Eqs. 8–9: δθ = α τ, δx = f_x, δy = f_y, δφ = α_m τ_m; the ends stay.

    The paper does not define the *transfer tilt* of its Table 2. Here it is how readily the mobile turns: α_m is a
    quarter of it, it bounds the turn |δφ| of one update, and an update does not carry the heading further than it
    from those of the neighbouring nodes (the turn of one transfer, from posture to posture).

    Args:
        torque: (N, nv) generalised forces Γ (Eq. 7), the base's part in the base's own frame.
        mobile_force: (N, 3) force F_m at the mobile's control point, world frame.
        planar: whether the root moves.
        alpha: (nv,) rotation coefficients of the joints (the base's entries do not count).
        transfer_tilt: bound of |δφ| [rad]; a quarter of it is the rotation coefficient α_m of the mobile.
        yaw: (N,) headings, to turn the displacement into the base's frame.

    Returns:
        Tangent displacements (N, nv).
    """
    delta = alpha * torque
    if planar:
        cos, sin = np.cos(yaw), np.sin(yaw)
        delta[:, 0] = cos * mobile_force[:, 0] + sin * mobile_force[:, 1]
        delta[:, 1] = cos * mobile_force[:, 1] - sin * mobile_force[:, 0]
        turn = np.clip(0.25 * transfer_tilt * torque[:, 2], -transfer_tilt, transfer_tilt)
        back, ahead = wrap_angle(yaw[:-2] - yaw[1:-1]), wrap_angle(yaw[2:] - yaw[1:-1])
        least, most = np.maximum(back, ahead) - transfer_tilt, np.minimum(back, ahead) + transfer_tilt
        # where the neighbours are too far apart for both, the middle between them is the best there is
        middle = 0.5 * (least + most)
        turn[1:-1] = np.clip(turn[1:-1], np.minimum(least, middle), np.maximum(most, middle))
        delta[:, 2] = np.clip(turn, -transfer_tilt, transfer_tilt)
    delta[0] = delta[-1] = 0.0
    return delta
