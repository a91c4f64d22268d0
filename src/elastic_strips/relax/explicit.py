"""Explicit update: the paper's Eqs. 8–9, displacements proportional to forces and torques."""

from __future__ import annotations

import numpy as np

from ..robot.space import Array


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

    The paper does not define the *transfer tilt* of its Table 2. Here it is the coefficient α_m, so that a larger one turns the
    mobile faster, and it bounds the turn |δφ| of one update.

    Args:
        torque: (N, nv) generalised forces Γ (Eq. 7), the base's part in the base's own frame.
        mobile_force: (N, 3) force F_m at the mobile's control point, world frame.
        planar: whether the root moves.
        alpha: (nv,) rotation coefficients of the joints (the base's entries do not count).
        transfer_tilt: rotation coefficient α_m of the mobile and bound of |δφ| [rad].
        yaw: (N,) headings, to turn the displacement into the base's frame.

    Returns:
        Tangent displacements (N, nv).
    """
    delta = alpha * torque
    if planar:
        cos, sin = np.cos(yaw), np.sin(yaw)
        delta[:, 0] = cos * mobile_force[:, 0] + sin * mobile_force[:, 1]
        delta[:, 1] = cos * mobile_force[:, 1] - sin * mobile_force[:, 0]
        delta[:, 2] = np.clip(transfer_tilt * torque[:, 2], -transfer_tilt, transfer_tilt)
    delta[0] = delta[-1] = 0.0
    return delta
