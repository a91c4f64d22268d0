"""Sensing room, readings: what range sensors say, as frozen values; measured or simulated makes no difference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import ParameterError
from ..robot.space import Array, Mask
from ..summary import Summary

NOTHING = np.inf
"""A range at which nothing is, as far as the sensor reaches."""
NO_ANSWER = np.nan
"""A range of which nothing is known: dropped out, or the robot itself is in the way."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LaserScan(Summary):
    """One scan of a planar laser range finder.

    Attributes:
        sensor: name of the sensor.
        time: when it was measured [s].
        T_base_sensor: (4, 4) pose of the sensor in the base's frame when it was measured.
        angles: (R,) directions of the rays in the sensor's xy plane, from its x axis, ascending [rad].
        ranges: (R,) [m]; ``NOTHING`` where nothing is within ``range_max``, ``NO_ANSWER`` where nothing is known.
        range_min, range_max: shortest and longest range that the sensor can tell [m].
    """

    sensor: str
    time: float
    T_base_sensor: Array
    angles: Array
    ranges: Array
    range_min: float
    range_max: float

    def __post_init__(self) -> None:
        _freeze(self, "T_base_sensor", (4, 4))
        _freeze(self, "angles", (-1,))
        _freeze(self, "ranges", self.angles.shape)

    @property
    def hits(self) -> Mask:
        """(R,) whether a ray met something."""
        return np.isfinite(self.ranges)

    def points(self) -> Array:
        """(H, 3) where rays met something, in the base's frame [m]."""
        at = self.hits
        r, a = self.ranges[at], self.angles[at]
        local = np.stack((r * np.cos(a), r * np.sin(a), np.zeros_like(r)), axis=1)
        return local @ self.T_base_sensor[:3, :3].T + self.T_base_sensor[:3, 3]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RangeRing(Summary):
    """One round of a ring of single-range sensors: sonars, or infrared distance sensors.

    Attributes:
        sensor: name of the ring.
        kind: ``"sonar"`` or ``"infrared"``.
        time: when it was measured [s].
        T_base_sensor: (S, 4, 4) poses of the sensors in the base's frame; each looks along its x axis.
        ranges: (S,) [m]; ``NOTHING`` where nothing is within ``range_max``, ``NO_ANSWER`` where nothing is known.
        half_angle: of the cone that a sensor sees [rad]; the range does not say where in it something is.
        range_min, range_max: shortest and longest range that a sensor can tell [m].
    """

    sensor: str
    kind: str
    time: float
    T_base_sensor: Array
    ranges: Array
    half_angle: float
    range_min: float
    range_max: float

    def __post_init__(self) -> None:
        if self.kind not in ("sonar", "infrared"):
            raise ParameterError(f"RangeRing.kind={self.kind!r} is neither 'sonar' nor 'infrared'")
        _freeze(self, "T_base_sensor", (-1, 4, 4))
        _freeze(self, "ranges", self.T_base_sensor.shape[:1])

    @property
    def hits(self) -> Mask:
        """(S,) whether a sensor sees something."""
        return np.isfinite(self.ranges)

    def points(self) -> Array:
        """(H, 3) on the axes of the sensors that see something, at their ranges, in the base's frame [m]."""
        at = self.hits
        T = self.T_base_sensor[at]
        return T[:, :3, 3] + self.ranges[at, None] * T[:, :3, 0]


Reading = LaserScan | RangeRing


def _freeze(reading: LaserScan | RangeRing, name: str, shape: tuple[int, ...]) -> None:
    """Keep a field as a read-only array of floats of this shape (−1: any)."""
    array = np.array(getattr(reading, name), dtype=float)
    if array.ndim != len(shape) or any(n not in (-1, m) for n, m in zip(shape, array.shape, strict=True)):
        raise ParameterError(f"{type(reading).__name__}.{name} has shape {array.shape}; it needs {shape}")
    array.flags.writeable = False
    object.__setattr__(reading, name, array)
