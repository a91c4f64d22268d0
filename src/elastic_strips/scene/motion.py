"""Scene room, motion: how an obstacle moves with time, and how fast any of its points can get.

Motions that are known: `Twist` here, `Keyframes` in `elastic_strips.scene.keyframes`; one that is not: `Unknown`. One
that depends on what others do: `Yielding` in `elastic_strips.scene.yielding`.
"""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from elastic_strips.errors import SceneError
from elastic_strips.scene import checks
from elastic_strips.scene.checks import Array

MAX_SPEED = 1e4
"""Largest linear [m/s] or angular [rad/s] speed that is accepted."""


class Motion(abc.ABC):
    """A rigid motion in the world frame; immutable, but for `Yielding`, whose future is not written yet."""

    __slots__ = ()

    @property
    def relative(self) -> bool:
        """Whether the motion starts from the obstacle's pose (true) or gives absolute poses (false)."""
        return True

    @property
    def still(self) -> bool:
        """Whether `pose` gives back the pose that it is given: an obstacle stays as it is from snapshot to snapshot."""
        return False

    @abc.abstractmethod
    def pose(self, initial_pose: Array, t: float) -> Array:
        """Pose (4, 4) at time ``t`` [s] of an obstacle that has ``initial_pose`` (4, 4) at time 0."""

    @abc.abstractmethod
    def velocity(self, initial_pose: Array, t: float) -> tuple[Array, Array]:
        """Velocity of the obstacle's origin (3,) [m/s] and angular velocity (3,) [rad/s] at ``t`` [s], world frame.

        Where the velocity jumps, it is that from ``t`` on (the right-sided derivative of `pose`).
        """

    @abc.abstractmethod
    def speed_bound(self, radius: float, *, start: float | None = None, end: float | None = None) -> float:
        """Largest speed [m/s] of any point that is at most ``radius`` [m] away from the obstacle's origin.

        Args:
            radius: Distance from the obstacle's origin [m].
            start: Begin of the interval of time that is asked about [s]; ``None`` is minus infinity.
            end: End of the interval [s]; ``None`` is plus infinity.
        """


@dataclass(frozen=True, slots=True, eq=False)
class Twist(Motion):
    """A constant velocity: the origin moves at ``linear``, the orientation turns about it at ``angular``.

    Args:
        linear: Velocity of the obstacle's origin [m/s], world frame.
        angular: Angular velocity [rad/s], world frame; the orientation at t is exp(angular t) times the one at 0.
    """

    linear: Array = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    angular: Array = (0.0, 0.0, 0.0)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        for key in ("linear", "angular"):
            object.__setattr__(self, key, checks.array(f"Twist {key}", getattr(self, key), (3,), limit=MAX_SPEED))

    def pose(self, initial_pose: Array, t: float) -> Array:
        """Pose (4, 4) at time ``t`` [s]; see `Motion.pose`."""
        result = np.array(initial_pose, dtype=np.float64)
        result[:3, 3] += self.linear * t
        rate = math.sqrt(float(self.angular @ self.angular))
        if rate > 0.0 and t != 0.0:
            result[:3, :3] = _axis_rotation(self.angular / rate, rate * t) @ result[:3, :3]
        return result

    def velocity(self, initial_pose: Array, t: float) -> tuple[Array, Array]:
        """``linear`` and ``angular``, at all times; see `Motion.velocity`."""
        return self.linear, self.angular

    def speed_bound(self, radius: float, *, start: float | None = None, end: float | None = None) -> float:
        """Largest speed [m/s] of a point within ``radius`` [m] of the origin; the same at all times."""
        return float(np.linalg.norm(self.linear) + np.linalg.norm(self.angular) * check_radius(radius))

    def __reduce__(self) -> tuple[Any, ...]:
        return Twist, (self.linear, self.angular)


@dataclass(frozen=True, slots=True, eq=False)
class Unknown(Motion):
    """A motion of which nothing is known but a bound of its speed; what a sensor makes of an obstacle it sees once.

    As far as is known the obstacle stays where it is: `pose` is its last pose and `velocity` is 0, but any of its
    points may be up to ``max_speed`` times the elapsed time away from there.

    Args:
        max_speed: Largest speed of any point of the obstacle [m/s].
    """

    max_speed: float

    def __post_init__(self) -> None:
        speed = checks.number("Unknown max_speed", self.max_speed, low=0.0, high=MAX_SPEED, unit="m/s")
        object.__setattr__(self, "max_speed", speed)

    @property
    def still(self) -> bool:
        """True: as far as is known."""
        return True

    def pose(self, initial_pose: Array, t: float) -> Array:
        """A copy of ``initial_pose`` (4, 4), at all times."""
        return np.array(initial_pose, dtype=np.float64)

    def velocity(self, initial_pose: Array, t: float) -> tuple[Array, Array]:
        """Zeros (3,) and (3,): no direction is known."""
        return np.zeros(3), np.zeros(3)

    def speed_bound(self, radius: float, *, start: float | None = None, end: float | None = None) -> float:
        """``max_speed`` [m/s], whatever the ``radius``."""
        check_radius(radius)
        return self.max_speed


def check_motion(value: Any) -> Motion | None:
    """Check that ``value`` is a `Motion` or None."""
    if value is not None and not isinstance(value, Motion):
        raise SceneError(f"motion must be a Twist, Keyframes, Unknown, Yielding or None, not {checks.shown(value)}")
    return value


def check_radius(value: float) -> float:
    """Check a distance from an obstacle's origin [m]."""
    radius = float(value)
    if not radius >= 0.0:
        raise SceneError(f"radius is {radius:g} m; it must be at least 0")
    return radius


def _axis_rotation(axis: Array, angle: float) -> Array:
    """Rotation matrix (3, 3) about the unit ``axis`` by ``angle`` [rad]."""
    half = 0.5 * math.remainder(angle, 2.0 * math.pi)
    return checks.rotation_of(np.append(axis * math.sin(half), math.cos(half)))
