"""Forces on the joints alone: limits and posture."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array

from ..robot import ConfigurationSpace
from .system import System


def add_joint_limits(system: System, space: ConfigurationSpace, chart: Array, *, k_l: float, margin: float) -> float:
    """Push joints back that come within ``margin`` [rad or m] of a limit: V = Σ ½ k_l (margin − gap)₊².

    Returns:
        The potential V.
    """
    below = np.maximum(space.lower + margin - chart, 0.0)
    above = np.maximum(chart - space.upper + margin, 0.0)
    energy = 0.5 * k_l * float((below**2).sum() + (above**2).sum())
    if energy > 0.0:
        system.force += k_l * (below - above)
        index = np.arange(space.nv)
        system.diagonal[:, index, index] += k_l * ((below > 0).astype(float) + (above > 0))
    system.energies["joint_limits"] = energy
    return energy


def add_posture(system: System, space: ConfigurationSpace, chart: Array, target: Array, *, k_p: Array) -> float:
    """Pull the joints towards a posture: V = ½ Σ k_p (θ − θ*)².

    Args:
        system: accumulates force and matrix.
        space: configuration space.
        chart: (N, nv) nodes.
        target: (nv,) or (N, nv) posture; the base's entries do not count.
        k_p: (nv,) gains, zero for the base.

    Returns:
        The potential V.
    """
    b = space.base_nv
    off = np.zeros_like(chart)
    off[:, b:] = chart[:, b:] - np.broadcast_to(target, chart.shape)[:, b:]
    if space.circular.any():
        wrapped = np.arctan2(np.sin(off[:, b:]), np.cos(off[:, b:]))
        off[:, b:] = np.where(space.circular, wrapped, off[:, b:])
    energy = 0.5 * float((k_p * off**2).sum())
    system.force -= k_p * off
    index = np.arange(space.nv)
    system.diagonal[:, index, index] += k_p
    system.energies["posture"] = energy
    return energy
