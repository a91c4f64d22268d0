"""Sensors room, suite: all range sensors of a robot in a simulated world, each at its rate and with its latency."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ParameterError, RobotError, SceneError
from elastic_strips.perception.readings import Reading
from elastic_strips.robot import RobotModel
from elastic_strips.scene import World
from elastic_strips.validation import check_count, check_type

from .devices import LaserRangefinder, SensorRing
from .mounting import Posture
from .params import LaserParams, SensorConfig
from .rays import ObstacleRays

_SLACK = 1e-9  # [s] times that differ by less are the same


@dataclass(slots=True)
class _Clocked:
    """A sensor and when it fires: at whole periods after the start."""

    device: LaserRangefinder | SensorRing
    period: float
    due: float = 0.0


class SensorSuite:
    """Workspace: what a robot's range sensors read of a world.

    Args:
        robot: that carries them.
        world: of obstacles.
        config: what the sensors are like.
        seed: of noise, dropouts and crosstalk, or a source of random numbers; each sensor draws from a stream of its
            own.
        time: at which the sensors begin [s].

    Raises:
        RobotError: the robot has not the links that the sensors sit on.
        MissingExtraError: the extra ``sensing`` is needed for the shapes there are, and not installed.
    """

    def __init__(
        self,
        robot: RobotModel,
        world: World,
        config: SensorConfig | None = None,
        *,
        seed: int | np.random.Generator = 0,
        time: float = 0.0,
    ) -> None:
        check_type("robot", robot, RobotModel, RobotError)
        check_type("world", world, World, SceneError)
        check_type("config", config, SensorConfig, none=True)
        if not isinstance(seed, np.random.Generator):
            check_count("seed", seed)
        self.config = SensorConfig() if config is None else config
        self._posture = Posture(robot)
        obstacles = ObstacleRays(world)
        streams = np.random.default_rng(seed).spawn(len(self.config.sensors))
        self._sensors: list[_Clocked] = []
        for params, rng in zip(self.config.sensors, streams, strict=True):
            make = LaserRangefinder if isinstance(params, LaserParams) else SensorRing
            device = make(params, self._posture, obstacles, rng, self.config.self_padding)  # type: ignore[arg-type]
            self._sensors.append(_Clocked(device, 1.0 / params.rate))
        self.reset(time)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sensors."""
        return self.config.names

    def reset(self, t: float) -> None:
        """Begin at ``t`` [s]: all sensors fire then, and readings on their way are lost. The noise goes on.

        Raises:
            ParameterError: the time is not finite.
        """
        self._start = self._now = _finite(t)
        self._pending: list[tuple[float, int, float, Reading]] = []  # time, sensor, arrival, reading
        for sensor in self._sensors:
            sensor.due = self._start
            if isinstance(sensor.device, SensorRing):
                sensor.device.restart()

    def observe(self, t: float, chart: Array) -> tuple[Reading, ...]:
        """The readings that can be read at ``t`` [s] and could not before, in the order of their times.

        To be called at every step of the control: a sensor fires at the first call at or after each of its times, once
        if several have passed.

        Args:
            t: the time, not before that of the last call.
            chart: (nv,) the robot's true chart row then.

        Raises:
            ParameterError: the time is not finite, or goes back.
            ConfigurationError: the chart row has another size, or is not finite.
        """
        now = _finite(t)
        if now < self._now - _SLACK:
            raise ParameterError(f"observe at t={now!r} s after t={self._now!r} s; time must not go back: reset first")
        self._now = now
        due = [k for k, sensor in enumerate(self._sensors) if now >= sensor.due - _SLACK]
        if due:
            self._posture.place(chart)
        for k in due:
            sensor = self._sensors[k]
            reading = sensor.device.measure(now)
            self._pending.append((now, k, now + sensor.device.params.latency, reading))
            passed = math.floor((now - self._start + _SLACK) / sensor.period)
            sensor.due = self._start + (passed + 1) * sensor.period
        ready = [entry for entry in self._pending if entry[2] <= now + _SLACK]
        if not ready:
            return ()
        self._pending = [entry for entry in self._pending if entry[2] > now + _SLACK]
        return tuple(entry[3] for entry in sorted(ready, key=lambda e: e[:2]))


def _finite(t: float) -> float:
    number = isinstance(t, (int, float, np.integer, np.floating)) and not isinstance(t, bool)
    if not number or not math.isfinite(t):
        raise ParameterError(f"t={t!r} must be a finite time [s]")
    return float(t)
