"""Explicit update: the paper's Eqs. 8–9, displacements proportional to forces and torques."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array

from ..robot.space import wrap_angle


def explicit_step(
    torque: Array,
    mobile_force: Array,
    *,
    planar: bool,
    alpha: Array,
    transfer_tilt: float,
    yaw: Array,
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
