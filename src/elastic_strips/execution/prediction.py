"""Execution room, prediction: where sensed obstacles will be, and how wrong that can be."""

from __future__ import annotations

import numpy as np

from ..proximity import Ahead, Forecast
from ..robot import RobotModel
from ..robot.space import Array
from ..scene import Scene, Unknown
from .params import ObstacleAssumptions


def predict(scene: Scene, assumptions: ObstacleAssumptions, *, horizon: float = np.inf, sure: bool = False) -> Forecast:
    """Constant velocities of a scene's moving obstacles from its time on.

    Args:
        scene: a sensed snapshot; obstacles without a motion stand for ever.
        assumptions: bounds of the errors.
        horizon: longest time after the snapshot [s].
        sure: leave the bounds out: the expected motion alone, for forces (a strip that gives way to all that is
            possible has nowhere to go).
    """
    moving = [k for k, o in enumerate(scene) if o.motion is not None]
    m = len(moving)
    velocity, offset, speed, acceleration = np.zeros((m, 3)), np.zeros(m), np.zeros(m), np.zeros(m)
    for i, k in enumerate(moving):
        obstacle = scene.obstacles[k]
        if isinstance(obstacle.motion, Unknown):
            speed[i] = obstacle.motion.max_speed
        else:
            linear, angular = obstacle.velocity()
            velocity[i] = linear
            speed[i] = assumptions.velocity_error + float(np.linalg.norm(angular)) * obstacle.reach
            acceleration[i] = assumptions.acceleration
        offset[i] = assumptions.position_error
    if sure:
        offset[:], speed[:], acceleration[:] = 0.0, 0.0, 0.0
    return Forecast(np.array(moving, dtype=np.intp), velocity, offset, speed, acceleration, horizon)


class ArrivalTimes:
    """When the nodes of a strip are reached at a usual pace.

    Args:
        robot: whose strip.
        pace: (nv,) usual speed of each degree of freedom [m/s, rad/s].
    """

    def __init__(self, robot: RobotModel, pace: Array) -> None:
        self.space, self.pace = robot.space, pace

    def __call__(self, chart: Array) -> Array:
        """(N,) times [s] from the first node of ``chart`` (N, nv) on."""
        v = self.space.difference(chart[:-1], chart[1:])
        return np.append(0.0, np.cumsum((np.abs(v) / self.pace).max(axis=1)))

    def foresight(self, forecast: Forecast, delay: float, chart: Array) -> Ahead:
        """The forecast at the nodes, the first of which is reached ``delay`` [s] after the snapshot."""
        return forecast.ahead(delay + self(chart))
