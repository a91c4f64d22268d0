"""Clearance of the interpolated strip, not only of its nodes: branch and bound with the motion bound."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array

from ..proximity import BodySet, MotionBounds, ObstacleProximity
from ..robot import Kinematics, RobotModel
from ..robot.space import where_true
from ..scene import Scene

_REACHES = (0.3, 1.0, 3.0, 10.0, 100.0, 1e4)


def chart_clearance(robot: RobotModel, chart: Array, scene: Scene, *, tolerance: float = 1e-4) -> float:
    """Smallest distance [m] between robot and obstacles along interpolated nodes; negative in penetration.

    See :func:`elastic_strips.strip.strip_clearance`.

    Args:
        robot: the robot.
        chart: (N, nv) nodes.
        scene: the obstacles.
        tolerance: accuracy [m].
    """
    if len(scene) == 0:
        return float("inf")
    bodies, v = BodySet.links(robot), robot.space.difference(chart[:-1], chart[1:])
    bounds = MotionBounds(bodies)
    kin = Kinematics(bodies.tree, len(chart))
    kin.update(chart)
    for reach in _REACHES:
        proximity = ObstacleProximity(bodies, influence=reach)
        proximity.update(kin, scene)
        travel = bounds.travel(v)
        if proximity.bound.size == 0:
            continue
        lowest = float(proximity.bound.min(initial=reach))
        if lowest + 0.5 * float(travel.max(initial=0.0)) < reach or reach == _REACHES[-1]:
            return _refine(kin, v, bodies, bounds, proximity, tolerance)
    return _REACHES[-1]


def _refine(
    kin: Kinematics, v: Array, bodies: BodySet, bounds: MotionBounds, proximity: ObstacleProximity, tolerance: float
) -> float:
    space = bodies.tree.space
    bound = proximity.bound
    best = float(bound.min())  # found at a node: an upper bound of the answer (up to the GJK excess)
    travel = bounds.travel(v)
    low = 0.5 * (bound[:-1] + bound[1:] - travel[:, :, None])
    undefined = space.half_turn(v)
    best = min(best, float(low[undefined].min(initial=np.inf)))
    low[undefined] = np.inf
    segment, body, part = where_true(low < best - tolerance)
    tight = bounds.tight_travel(kin, segment, body, v[segment]) if len(segment) else np.zeros(0)
    d_low, d_high = bound[segment, body, part], bound[segment + 1, body, part]
    start, end = np.zeros(len(segment)), np.ones(len(segment))
    between = Kinematics(bodies.tree, 64)
    while len(segment):
        keep = 0.5 * (d_low + d_high - tight) < best - tolerance
        segment, body, part = segment[keep], body[keep], part[keep]
        d_low, d_high, tight, start, end = d_low[keep], d_high[keep], tight[keep], start[keep], end[keep]
        if len(segment) == 0:
            break
        middle = 0.5 * (start + end)
        key, inverse = np.unique(segment + 1j * middle, return_inverse=True)
        s = key.real.astype(np.intp)
        between.update(space.integrate(kin.chart[s], key.imag[:, None] * v[s]), jacobians=False)
        # a value is exact only where it matters: below what could still lower the answer
        d = proximity.measure(between, inverse, body, part, np.full(len(segment), best + 0.5 * float(tight.max())))
        best = min(best, float(d.min()))
        half = 0.5 * tight
        segment, body, part = np.r_[segment, segment], np.r_[body, body], np.r_[part, part]
        start, end = np.r_[start, middle], np.r_[middle, end]
        d_low, d_high, tight = np.r_[d_low, d], np.r_[d, d_high], np.r_[half, half]
    return best - tolerance
