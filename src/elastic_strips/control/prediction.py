"""Prediction: future positions of sensed obstacles, and bounds of their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision import Forecast
from elastic_strips.collision.candidates import NodePrediction
from elastic_strips.robot import ConfigurationSpace, RobotModel
from elastic_strips.scene import Scene, UnknownMotion
from elastic_strips.trajectory import MotionLimits
from elastic_strips.work import count_work

from .params import Margins, ObstacleAssumptions


def predict(scene: Scene, assumptions: ObstacleAssumptions, *, horizon: float = np.inf, sure: bool = False) -> Forecast:
    """Forecast of a scene's moving obstacles: constant velocities from its time on, with bounds of the errors.

    Args:
        scene: a sensed snapshot; obstacles without a motion stay where they are.
        assumptions: bounds of the errors.
        horizon: longest time after the snapshot [s].
        sure: whether to forecast the expected motion without bounds, for forces: a strip that avoids all possible
            positions would find no free space.
    """
    count_work(obstacles=len(scene))
    moving = [k for k, o in enumerate(scene) if o.motion is not None]
    m = len(moving)
    velocity, offset, speed, acceleration = np.zeros((m, 3)), np.zeros(m), np.zeros(m), np.zeros(m)
    for i, k in enumerate(moving):
        obstacle = scene.obstacles[k]
        if isinstance(obstacle.motion, UnknownMotion):
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


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """What a planning tick knows of the world, predicted once: strip, timer, evasion and certifier take it.

    Attributes:
        scene: sensed at ``scene.time``.
        possible: forecast of all that its moving obstacles may do.
        margins: what motions keep from them.
        assumptions: that the forecast was made with.
    """

    scene: Scene
    possible: Forecast
    margins: Margins
    assumptions: ObstacleAssumptions

    @classmethod
    def of(cls, scene: Scene, assumptions: ObstacleAssumptions, margins: Margins) -> Outlook:
        """The outlook of a sensed scene."""
        return cls(scene, predict(scene, assumptions), margins, assumptions)

    def expected(self, horizon: float) -> Forecast:
        """What moving obstacles that were seen are expected to do within a time [s], without bounds; for forces."""
        return predict(self.scene.seen, self.assumptions, horizon=horizon, sure=True)

    def allows(self, scene: Scene) -> bool:
        """Whether a later scene is one of those that this outlook allowed for, so that its certificates still hold."""
        return as_expected(scene, self.scene, self.possible, self.assumptions)

    def uncovered(self, scene: Scene) -> Scene:
        """What of a later scene a certificate that was made with this outlook says nothing of: all that moves, and what
        stands and is another object than any that stood in this outlook's scene."""
        known = set(map(id, self.scene.obstacles))
        left = [o for o in scene.obstacles if o.motion is not None or id(o) not in known]
        return scene if len(left) == len(scene) else Scene(left, time=scene.stamp)


def as_expected(scene: Scene, before: Scene, forecast: Forecast, assumptions: ObstacleAssumptions) -> bool:
    """Whether a scene is within the forecast of an earlier one, so that certificates made then still hold.

    Args:
        scene: sensed.
        before: sensed earlier, of the same obstacles by name.
        forecast: forecast of ``before``.
        assumptions: the assumptions that the forecast was made with.
    """
    age = scene.time - before.time
    if age < 0.0 or scene.names != before.names:
        return False
    count_work(obstacles=len(scene))
    moving = set(forecast.obstacles.tolist())
    for k, (now, then) in enumerate(zip(scene, before, strict=True)):
        if now is then and k not in moving:
            continue
        if now.solid is not then.solid:
            return False
        if k not in moving and (now.motion is not None or not np.array_equal(now.pose, then.pose)):
            return False
    apart = np.zeros(len(forecast))
    faster, known = np.zeros(len(forecast)), np.ones(len(forecast), dtype=bool)
    for m, k in enumerate(forecast.obstacles):
        now, then = scene.obstacles[k], before.obstacles[k]
        apart[m] = float(np.linalg.norm(now.pose[:3, 3] - then.pose[:3, 3] - age * forecast.velocity[m]))
        apart[m] += now.reach * float(np.linalg.norm(now.pose[:3, :3] - then.pose[:3, :3])) / np.sqrt(2.0)
        known[m] = not isinstance(then.motion, UnknownMotion)
        if known[m]:
            if isinstance(now.motion, UnknownMotion):
                return False
            faster[m] = float(np.linalg.norm(now.velocity()[0] - forecast.velocity[m]))
    uncertainty = forecast.offset + forecast.speed * age + 0.5 * forecast.acceleration * age * age
    # both snapshots have sensing errors, which add up in their difference
    slack = 2.0 * assumptions.velocity_error + forecast.acceleration * age
    return bool((apart <= uncertainty + assumptions.position_error).all() and (faster[known] <= slack[known]).all())


class ArrivalTimes:
    """Times at which the nodes of a strip are reached at three quarters of the largest speeds.

    Args:
        robot: the robot.
        limits: limits of its motors.
        turn_speed: how fast its base turns at most [rad/s].
    """

    space: ConfigurationSpace

    def __init__(self, robot: RobotModel, limits: MotionLimits, turn_speed: float = np.inf) -> None:
        self.space = space = robot.space
        pace = np.empty(space.nv)
        pace[space.base_nv :] = limits.joint_speed
        if limits.drive_dim == 2:
            top = float(limits.drive_speed.min())
            pace[:3] = top, top, 2.0 * top / limits.track
        elif limits.drive_dim == 3:
            pace[:3] = limits.drive_speed
        pace[2 : space.base_nv] = np.minimum(pace[2 : space.base_nv], turn_speed)
        self.pace: Array = 0.75 * pace  # (nv,) [m/s, rad/s]

    def __call__(self, coordinates: Array) -> Array:
        """(N,) times [s] from the first node of ``coordinates`` (N, nv) on."""
        v = self.space.difference(coordinates[:-1], coordinates[1:])
        return np.append(0.0, np.cumsum((np.abs(v) / self.pace).max(axis=1)))

    def prediction(self, forecast: Forecast, delay: float, coordinates: Array) -> NodePrediction:
        """The forecast at nodes ``coordinates`` (N, nv), the first reached ``delay`` [s] after the scene."""
        return forecast.predict(delay + self(coordinates))
