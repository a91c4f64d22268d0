"""Rejoining: a strip begins where the robot is now; the nodes that it has passed go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elastic_strips.arrays import Array, Indices

from ..robot import BaseKind
from ..strip import Deformer, DeformReport, Strip
from ..strip.report import SLIP_LIMIT
from ..strip.solver import project_rolling

_LEVER = 0.25  # [m/rad] how much a radian, of the base or a joint, counts against a metre
_NEAR = 0.03  # [m] a node that is so near the robot is left out


def parting_angle(one: Strip, other: Strip, ahead: float) -> float:
    """Angle [rad] between the directions in which two strips with the same start lead.

    A direction is that from the start to the place ``ahead`` [m] along the base's path, or to the strip's end where
    that is nearer. 0 for a fixed base.
    """
    if not one.robot.space.planar:
        return 0.0
    ways = []
    for strip in (one, other):
        xy = strip.chart[:, :2]
        along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))))
        at = min(ahead, float(along[-1]))
        ways.append(np.array([np.interp(at, along, xy[:, k]) for k in range(2)]) - xy[0])
    cross = float(ways[0][0] * ways[1][1] - ways[0][1] * ways[1][0])
    return abs(float(np.arctan2(cross, ways[0] @ ways[1])))


def rejoined(deformer: Deformer, report: DeformReport, chart: Array) -> DeformReport:
    """A report whose strip begins at the chart row (nv,) and goes on from the nearest point.

    What is certified is unknown until the next tick, for the first segment is new; the report stays the old one but for
    its strip.
    """
    strip = report.strip
    segment = _nearest(strip, chart)
    rest = strip.chart[segment + 1 :]
    first = chart.copy()
    if strip.robot.space.planar:
        first[2] += 2.0 * np.pi * np.rint((rest[0, 2] - first[2]) / (2.0 * np.pi))
    skip = int(len(rest) > 1 and np.linalg.norm(_weighed(strip, first[None], rest[:1])) < _NEAR)
    source = np.arange(segment + 1 + skip, len(strip))
    rows = np.vstack((first, rest[skip:]))
    if strip.robot.base_kind is BaseKind.DIFF_DRIVE:
        rows, slip = project_rolling(strip.robot.space, rows)
        if slip > SLIP_LIMIT:  # it cannot be driven; the next tick starts from nothing that is held
            ends = strip.robot.space.from_chart(rows[[0, -1]])
            ends[-1] = strip.q[-1]
            return replace(report, strip=Strip.from_chart(strip.robot, rows, ends=ends), slip=slip)
    known: Indices = np.concatenate(([-1], source)).astype(np.intp)
    return replace(report, strip=deformer.carry(strip, rows, known))


def _nearest(strip: Strip, chart: Array) -> int:
    """The segment nearest a chart row; chords instead of arcs."""
    nodes = strip.chart
    way = _weighed(strip, nodes[:-1], nodes[1:])
    to = _weighed(strip, nodes[:-1], np.broadcast_to(chart, nodes[:-1].shape))
    square = np.maximum((way * way).sum(axis=1), 1e-18)
    share = np.clip((way * to).sum(axis=1) / square, 0.0, 1.0)
    return int(np.argmin(np.linalg.norm(to - share[:, None] * way, axis=1)))


def _weighed(strip: Strip, a: Array, b: Array) -> Array:
    v = strip.robot.space.difference(a, b)
    base = 2 if strip.robot.space.planar else 0
    v[:, base:] *= _LEVER
    return v
