"""Sensing: what a plant's encoders and its localization say about the true state, with noise, latency and losses."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ParameterError
from elastic_strips.execution.measurement import Measurement

_SLACK = 1e-9  # [s] times that differ by less are the same


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorParams:
    """Errors of encoders and localization. All noise is Gaussian, cut off at three standard deviations.

    Attributes:
        encoder_noise: of a wheel's reading [m at the rim]; readings err, not increments, so it does not add up.
        joint_noise: of a joint encoder [rad or m].
        fix_period: between localization fixes [s]; infinite for none.
        fix_noise: of a fix's x and of its y [m].
        fix_angle_noise: of its yaw [rad].
        fix_latency: from the time that a fix tells of to its arrival [s].
    """

    encoder_noise: float = 5e-5
    joint_noise: float = 2e-4
    fix_period: float = 0.05
    fix_noise: float = 0.003
    fix_angle_noise: float = 0.003
    fix_latency: float = 0.02

    def __post_init__(self) -> None:
        """Check.

        Raises:
            ParameterError: a negative value, NaN, or a fix period of 0.
        """
        for f in fields(self):
            value = getattr(self, f.name)
            if not value >= 0.0 or (math.isinf(value) and f.name != "fix_period"):
                raise ParameterError(f"{f.name}={value!r} must be a finite number ≥ 0")
        if self.fix_period == 0.0:
            raise ParameterError("fix_period=0 must be positive; math.inf for no fixes")

    @staticmethod
    def ideal() -> SensorParams:
        """Exact readings; fixes come at once."""
        return SensorParams(encoder_noise=0.0, joint_noise=0.0, fix_noise=0.0, fix_angle_noise=0.0, fix_latency=0.0)


def standard_normals(rng: np.random.Generator, block: int = 1024) -> Iterator[float]:
    """Endless standard normal numbers cut off at ±3, drawn in blocks: a number costs as much as a list's next."""
    while True:
        yield from np.clip(rng.standard_normal(block), -3.0, 3.0).tolist()


class Sensors:
    """Turns true states into measurements; shared by all plants.

    Args:
        params: sizes of the errors.
        rng: source of the noise.
        count: (k, n) numbers of drive coordinates and joints.
    """

    def __init__(self, params: SensorParams, rng: np.random.Generator, count: tuple[int, int]) -> None:
        self.params = params
        self._rng = rng
        self._normal = standard_normals(rng)
        self._drives, self._joints = count
        self._lost_until = -math.inf
        self.reset(0.0, (0.0,) * self._drives)

    def reset(self, time: float, travel: Sequence[float]) -> None:
        """Start anew at a time [s] with the drive's travel (k,) so far; a loss of odometry is over."""
        self._reading = list(travel)
        self._next_fix = time + self.params.fix_period
        self._pending: deque[tuple[float, float, float, float]] = deque()
        self._lost_until = -math.inf

    def lose_odometry(self, until: float) -> None:
        """No encoder travel and no fix comes up to the time ``until`` [s]; fixes on their way are lost too."""
        self._lost_until = until
        self._pending.clear()

    def measure(
        self, time: float, travel: Sequence[float], joints: Array, pose: tuple[float, float, float] | None
    ) -> Measurement:
        """The measurement of a true state.

        Args:
            time: [s].
            travel: (k,) true travel of the drive coordinates since the reset, as the encoders turn [m or rad].
            joints: (n,) true joint positions.
            pose: true base pose x, y, yaw; None for a fixed base.
        """
        p, normal = self.params, self._normal
        noise = p.encoder_noise
        before, self._reading = self._reading, [s + noise * next(normal) for s in travel]
        if p.joint_noise > 0.0:
            white = self._rng.standard_normal(self._joints)
            joints = joints + p.joint_noise * np.minimum(np.maximum(white, -3.0), 3.0)
        else:
            joints = joints.copy()
        if pose is None:
            return Measurement(time, np.zeros(0), joints)
        if time <= self._lost_until + _SLACK:
            while self._next_fix <= time + _SLACK:
                self._next_fix += p.fix_period
            return Measurement(time, None, joints)
        drive = np.array([b - a for a, b in zip(before, self._reading, strict=True)])
        if time >= self._next_fix - _SLACK:
            while self._next_fix <= time + _SLACK:
                self._next_fix += p.fix_period
            x, y, yaw = pose
            self._pending.append(
                (
                    time,
                    x + p.fix_noise * next(normal),
                    y + p.fix_noise * next(normal),
                    yaw + p.fix_angle_noise * next(normal),
                )
            )
        if self._pending and self._pending[0][0] + p.fix_latency <= time + _SLACK:
            at, *fix = self._pending.popleft()
            return Measurement(time, drive, joints, np.array(fix), at)
        return Measurement(time, drive, joints)
