"""A flat world of circles and walls: exact rays, exact motion of a differential drive, and a loop that closes them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from elastic_strips.perception import LaserScan, RangeRing
from workshop.baselines import GoalParams

LASER = np.radians(np.linspace(-135.0, 135.0, 137))
SONARS = np.radians(np.arange(0.0, 360.0, 22.5))


@dataclass
class World:
    """Circles (x, y, r) and walls (x0, y0, x1, y1) [m]."""

    circles: list = field(default_factory=list)
    walls: list = field(default_factory=list)

    def cast(self, start, bearing):
        """Ranges (R,) of rays from starts (R, 2); inf where they meet nothing."""
        start = np.atleast_2d(start)
        along = np.stack((np.cos(bearing), np.sin(bearing)), axis=-1)
        best = np.full(len(along), np.inf)
        for x, y, r in self.circles:
            to = np.array([x, y]) - start
            half = (to * along).sum(axis=1)
            under = half**2 - (to**2).sum(axis=1) + r * r
            s = half - np.sqrt(np.maximum(under, 0.0))
            best = np.where((under >= 0.0) & (s > 0.0), np.minimum(best, s), best)
        for x0, y0, x1, y1 in self.walls:
            edge, to = np.array([x1 - x0, y1 - y0]), np.array([x0, y0]) - start
            det = along[:, 1] * edge[0] - along[:, 0] * edge[1]
            with np.errstate(divide="ignore", invalid="ignore"):
                s = (to[:, 1] * edge[0] - to[:, 0] * edge[1]) / det
                u = (along[:, 0] * to[:, 1] - along[:, 1] * to[:, 0]) / det
            met = (np.abs(det) > 1e-12) & (s > 0.0) & (u >= 0.0) & (u <= 1.0)
            best = np.where(met, np.minimum(best, s), best)
        return best

    def clearance(self, point, radius):
        """Distance of a disc from everything [m]; negative in contact."""
        p = np.asarray(point, dtype=float)[:2]
        found = [np.inf]
        found += [math.hypot(p[0] - x, p[1] - y) - r for x, y, r in self.circles]
        for x0, y0, x1, y1 in self.walls:
            a, edge = np.array([x0, y0]), np.array([x1 - x0, y1 - y0])
            u = np.clip((p - a) @ edge / (edge @ edge), 0.0, 1.0)
            found.append(float(np.linalg.norm(p - a - u * edge)))
        return min(found) - radius


def scan(world, pose, t=0.0, reach=6.0, angles=LASER, at=(0.1, 0.0, 0.0)):
    """A laser scan in a world."""
    T = placed(*at)
    x, y, yaw = moved(pose, at)
    ranges = world.cast(np.tile([x, y], (len(angles), 1)), yaw + angles)
    return LaserScan("laser", t, T, angles, np.where(ranges <= reach, ranges, np.inf), 0.02, reach)


def ring(world, pose, t=0.0, reach=3.0, bearings=SONARS, radius=0.2, half_angle=0.2):
    """A round of sonars in a world: the nearest of seven rays of each cone."""
    rays = np.linspace(-half_angle, half_angle, 7)
    places = [(radius * math.cos(b), radius * math.sin(b), b) for b in bearings]
    starts = np.array([moved(pose, p) for p in places])
    bearing = (starts[:, 2:] + rays).ravel()
    ranges = world.cast(np.repeat(starts[:, :2], len(rays), axis=0), bearing).reshape(-1, len(rays)).min(axis=1)
    T = np.stack([placed(*p) for p in places])
    return RangeRing("sonars", "sonar", t, T, np.where(ranges <= reach, ranges, np.inf), half_angle, 0.02, reach)


def placed(x, y, yaw):
    """(4, 4) pose in the plane."""
    T = np.eye(4)
    T[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    T[:2, 3] = x, y
    return T


def moved(pose, by):
    """The pose ``by`` in the frame of ``pose``."""
    x, y, yaw = pose
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([x + c * by[0] - s * by[1], y + s * by[0] + c * by[1], yaw + by[2]])


def arc(pose, v, omega, dt):
    """Where a constant speed and yaw rate lead to: an exact arc."""
    turn = omega * dt
    if abs(turn) < 1e-9:
        return moved(pose, (v * dt, 0.0, turn))
    return moved(pose, (v * math.sin(turn) / omega, v * (1.0 - math.cos(turn)) / omega, turn))


@dataclass
class Run:
    """What came of a drive: poses (N, 3), commands, least clearance [m]."""

    poses: np.ndarray
    commands: list
    clearance: float

    @property
    def arrived(self):
        return self.commands[-1].status == "arrived"

    @property
    def blocked(self):
        return any(c.status == "blocked" for c in self.commands)


def drive(method, world, start, goal, *, seconds=20.0, rate=15.0, radius=0.27, until_blocked=False):
    """Close the loop: sense, command, move; until arrived or the time is up, or until the method says "blocked"."""
    pose, velocity, dt = np.array(start, dtype=float), np.zeros(2), 1.0 / rate
    goal = np.array(goal, dtype=float)
    poses, commands, clearance = [pose], [], world.clearance(pose, radius)
    for k in range(int(seconds * rate)):
        t = k * dt
        method.update(scan(world, pose, t), pose)
        method.update(ring(world, pose, t), pose)
        command = method.command(t, pose, velocity, goal)
        commands.append(command)
        if command.status == "arrived" or (until_blocked and command.status == "blocked"):
            break
        pose = arc(pose, command.v, command.omega, dt)
        velocity = np.array([command.v, command.omega])
        poses.append(pose)
        clearance = min(clearance, world.clearance(pose, radius))
    return Run(np.array(poses), commands, clearance)


def patience(start, goal, params=None):
    """Time [s] after which a base that does not arrive is blocked, however it swings.

    The way that remains, at first the one from start to goal, can shorten only so often by what counts as progress.
    """
    params = GoalParams() if params is None else params
    return params.patience * (2.0 + math.dist(start[:2], goal[:2]) / params.progress)


def door(gap, x=2.5, side=3.0):
    """A thin wall across the way at ``x`` with a door of width ``gap`` in its middle."""
    return World(walls=[(x, -side, x, -0.5 * gap), (x, 0.5 * gap, x, side)])


def trap(depth=1.2, width=1.6, x=2.5):
    """A U that opens towards the start."""
    h = 0.5 * width
    return World(walls=[(x, -h, x, h), (x - depth, -h, x, -h), (x - depth, h, x, h)])
