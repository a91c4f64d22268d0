"""Trouble: where a strip is broken or blocked, so that a picture can point at it."""

from __future__ import annotations

from typing import Any

import numpy as np

from elastic_strips.robot import RobotModel
from elastic_strips.viewer.geometry import Doubles, Poses


def trouble_spot(robot: RobotModel, report: Any, chart: Doubles, poses: Poses) -> Doubles | None:
    """Where (3,) [m] the worst segment is: between the hulls that do not connect, or at the link that is not clear.

    Args:
        robot: the robot.
        report: about the strip, or None.
        chart: (N, nv) the strip's nodes.
        poses: of the robot; left at the worst segment.

    Returns:
        The place, or None where nothing is known to be wrong.
    """
    tunnel = getattr(report, "tunnel", None)
    if tunnel is not None and getattr(report, "connectivity_counts", False) and not tunnel.connected.all():
        j, c = np.unravel_index(int(np.argmin(tunnel.overlap)), tunnel.overlap.shape)
        return 0.5 * (tunnel.points[j, c] + tunnel.points[j + 1, c])
    broken = getattr(getattr(report, "certificate", None), "broken", None)
    if broken is None or not 0 <= broken.segment < len(chart) - 1:
        return None
    ends = chart[broken.segment : broken.segment + 2]
    poses.update(robot.space.interpolate(ends[:1], ends[1:], np.array([0.5])))
    piece = next((piece for piece in robot.geometries if piece.name == broken.link), None)
    if piece is None:
        return poses.points()[0, 0]
    middle = np.eye(4)
    middle[:3, 3] = 0.5 * (piece.capsule.a + piece.capsule.b)
    there = poses.matrices([piece.joint])[0, 0].reshape(4, 4).T @ robot.tree.to_aligned(piece.joint, middle)
    return np.asarray(there[:3, 3], dtype=float)
