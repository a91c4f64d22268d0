"""Sensing room, range finder: a planar laser scan of a world, as a device with errors reports it."""

from __future__ import annotations

import math

import numpy as np

from .errors_of_range import measured
from .mounting import Mount, Posture
from .obstacle_rays import ObstacleRays
from .own_body import OwnBody
from .params import LaserParams
from .rays import Rays
from .readings import NO_ANSWER, LaserScan


class LaserRangefinder:
    """Workspace: one laser range finder on a robot.

    Args:
        params: of the device.
        posture: of the robot; whoever asks for a scan has placed it.
        obstacles: of the world.
        rng: source of noise and dropouts.
        self_padding: of the links that move before the laser [m].

    Raises:
        RobotError: the robot has no such link.
    """

    def __init__(
        self,
        params: LaserParams,
        posture: Posture,
        obstacles: ObstacleRays,
        rng: np.random.Generator,
        self_padding: float,
    ) -> None:
        self.params, self._obstacles, self._rng = params, obstacles, rng
        self._mount = Mount(posture, (params.frame,))
        half, full = 0.5 * params.field_of_view, params.field_of_view >= 2.0 * math.pi - 1e-9
        self.angles = np.linspace(-half, half, params.rays, endpoint=not full) if params.rays > 1 else np.zeros(1)
        fan = np.stack((np.cos(self.angles), np.sin(self.angles), np.zeros(params.rays)), axis=1)
        self._local = Rays(np.zeros((1, 3)), fan)
        joint = np.full(params.rays, self._mount.joint[0])
        self._own = OwnBody(posture, joint, self._local.moved(self._mount.T_joint_sensor[0]), self_padding)

    def measure(self, t: float) -> LaserScan:
        """The scan at time ``t`` [s] from where the robot was placed.

        A beam that meets the robot before an obstacle says ``NO_ANSWER``.
        """
        p = self.params
        T_world_sensor, T_base_sensor = self._mount.poses()
        rays = self._local.moved(T_world_sensor[0])
        distance = self._obstacles.cast(t, rays, p.range_max).distance
        own = self._own.distances(rays, p.range_max)
        distance[np.isfinite(own) & (own <= distance)] = NO_ANSWER
        ranges = measured(distance, p, self._rng)
        return LaserScan(p.name, t, T_base_sensor[0], self.angles, ranges, p.range_min, p.range_max)
