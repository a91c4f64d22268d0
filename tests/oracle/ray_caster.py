"""An exact ray caster in the plane, for tests of sensing: circles and segments, nothing else."""

from __future__ import annotations

import math

import numpy as np

from elastic_strips.perception import LaserScan


def box_segments(x, y, length, width, yaw=0.0):
    """The four sides of a rectangle about (x, y)."""
    c, s = math.cos(yaw), math.sin(yaw)
    local = [(-length, -width), (length, -width), (length, width), (-length, width)]
    corners = [(x + 0.5 * (c * a - s * b), y + 0.5 * (s * a + c * b)) for a, b in local]
    return [(*corners[k], *corners[(k + 1) % 4]) for k in range(4)]


def cast(origin, bearing, circles=(), segments=(), range_max=10.0):
    """(R,) ranges along ``bearing`` (R,) to circles (x, y, r) and segments (x0, y0, x1, y1); ∞ beyond range_max."""
    d = np.stack((np.cos(bearing), np.sin(bearing)), axis=1)
    best = np.full(len(bearing), np.inf)
    for x, y, r in circles:
        to = np.array([x - origin[0], y - origin[1]])
        along = d @ to
        inside = r * r - (to @ to - along**2)
        with np.errstate(invalid="ignore"):
            t = along - np.sqrt(inside)
        good = (inside >= 0.0) & (t > 0.0)
        best = np.where(good, np.minimum(best, np.where(good, t, np.inf)), best)
    for x0, y0, x1, y1 in segments:
        ex, ey, px, py = x1 - x0, y1 - y0, x0 - origin[0], y0 - origin[1]
        det = d[:, 0] * -ey + d[:, 1] * ex
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            t = (px * -ey + py * ex) / det
            s = (d[:, 0] * py - d[:, 1] * px) / det
        good = (np.abs(det) > 1e-12) & (s >= 0.0) & (s <= 1.0) & (t > 0.0)
        best = np.where(good, np.minimum(best, np.where(good, t, np.inf)), best)
    return np.where(best <= range_max, best, np.inf)


def scan(
    pose,
    time=0.0,
    *,
    circles=(),
    segments=(),
    fov=1.5 * math.pi,
    rays=361,
    noise=0.0,
    rng=None,
    height=0.25,
    reach=10.0,
):
    """A scan of a laser at the base's origin, ``height`` over the floor."""
    angles = np.linspace(-0.5 * fov, 0.5 * fov, rays)
    ranges = cast(pose[:2], pose[2] + angles, circles, segments, reach)
    if noise:
        ranges = ranges + rng.normal(0.0, noise, len(ranges))
    T = np.eye(4)
    T[2, 3] = height
    return LaserScan("laser", time, T, angles, ranges, 0.05, reach)
