"""Properties of range sensors: their rays, reach, rate, latency and errors, checked; and their YAML file
(docs/sensors.md)."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, get_args, get_origin, get_type_hints

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ParameterError, nearest_name
from elastic_strips.io.nodes import Node, load_yaml
from elastic_strips.validation import Bound, Count, Fraction, check_choice, check_count, check_fields

_RingKind = Literal["sonar", "infrared"]
_MOST_RAYS = 100_000
_SHORTEST_PERIOD = 1e-3  # [s]
_Range = Annotated[float, Bound(low=0.0, high=1e3, unit="m")]
_Rate = Annotated[float, Bound(low=1e-3, high=1.0 / _SHORTEST_PERIOD, unit="Hz")]
_Latency = Annotated[float, Bound(low=0.0, high=10.0, unit="s")]
_Noise = Annotated[float, Bound(low=0.0, high=10.0, unit="m")]
_Turn = Annotated[float, Bound(low=0.0, high=2.0 * math.pi + 1e-9, unit="rad")]
_MOST_PIXELS = 2_000_000
_Columns = Annotated[int, Bound(low=2, high=_MOST_PIXELS)]
_Growth = Annotated[float, Bound(low=0.0, high=1.0, unit="1/m")]
_Elevation = Annotated[float, Bound(low=-0.5 * math.pi, high=0.5 * math.pi, unit="rad")]
_RightAngle = Annotated[float, Bound(low=0.0, high=0.5 * math.pi, unit="rad")]


def _where(params: RangeParams) -> str:
    return f"{type(params).__name__}({params.name!r})"


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeParams:
    """Common properties of all range sensors.

    Attributes:
        name: name of the sensor; its readings carry it.
        range_min, range_max: shortest and longest range that it can tell [m].
        rate: firings per second [Hz].
        latency: time from a measurement until it can be read [s].
        noise: standard deviation of a range [m]; Gaussian, cut off at three standard deviations.
        noise_ratio: growth of the standard deviation per metre of range [-].
        dropout: probability that a range is lost (``NO_ANSWER``), for each ray or sensor alone [-].
        near_reads_min: whether something nearer than ``range_min`` reads as ``range_min``, not as ``NO_ANSWER``.
    """

    name: str
    range_min: _Range
    range_max: _Range
    rate: _Rate
    latency: _Latency
    noise: _Noise
    noise_ratio: Fraction
    dropout: Fraction
    near_reads_min: bool

    def __post_init__(self) -> None:
        check_fields(self, _where(self))
        if not self.range_max > self.range_min:
            raise ParameterError(
                f"{_where(self)}.range_max={self.range_max!r} must exceed range_min={self.range_min!r} m"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserParams(RangeParams):
    """A planar laser range finder. The figures are those assumed of a small one of 10 m; see docs/sensors.md.

    Attributes:
        frame: link of the URDF whose xy plane the rays lie in; the middle one looks along x.
        field_of_view: angle between the first and the last ray [rad]; 2π leaves out the last one.
        rays: number of rays.
    """

    name: str = "laser"
    frame: str = "laser_frame"
    field_of_view: _Turn = math.pi
    rays: Annotated[int, Bound(low=1, high=_MOST_RAYS)] = 361
    range_min: _Range = 0.05
    range_max: _Range = 10.0
    rate: _Rate = 20.0
    latency: _Latency = 0.03
    noise: _Noise = 0.008
    noise_ratio: Fraction = 0.001
    dropout: Fraction = 0.005
    near_reads_min: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class RingParams(RangeParams):
    """A ring of single-range sensors: sonars or infrared distance sensors.

    Attributes:
        kind: ``"sonar"`` or ``"infrared"``.
        frames: links of the URDF, one for each sensor, which looks along its x axis; in order around the robot.
        half_angle: half angle of the cone that a sensor sees [rad].
        rays: rays in that cone; the nearest echo counts.
        max_incidence: angle between a ray and the normal of a surface beyond which the surface reflects it away [rad].
        crosstalk: probability that a sensor hears the echo of its neighbour in the group that fires with it [-].
        groups: sensor i fires in group i modulo ``groups``, one group a firing; each is asked ``rate / groups`` times a
            second.
    """

    kind: _RingKind
    frames: tuple[str, ...]
    half_angle: _RightAngle
    rays: Count
    max_incidence: _RightAngle
    crosstalk: Fraction
    groups: Count

    def __post_init__(self) -> None:
        if isinstance(self.frames, list):
            object.__setattr__(self, "frames", tuple(self.frames))
        RangeParams.__post_init__(self)
        if len(set(self.frames)) < len(self.frames):
            raise ParameterError(f"{_where(self)}.frames={self.frames!r} names a link twice")
        check_count(f"{_where(self)}.rays", self.rays, low=1, high=_MOST_RAYS // len(self.frames))
        check_count(f"{_where(self)}.groups", self.groups, low=1, high=len(self.frames))


@dataclass(frozen=True, slots=True, kw_only=True)
class SonarParams(RingParams):
    """A ring of sonars; the figures are those assumed of twelve small ones of 3 m."""

    name: str = "sonar"
    kind: _RingKind = "sonar"
    frames: tuple[str, ...] = tuple(f"sonar_{k}_frame" for k in range(12))
    half_angle: _RightAngle = 0.2617993877991494
    rays: Count = 31
    max_incidence: _RightAngle = 0.6
    crosstalk: Fraction = 0.01
    groups: Count = 3
    range_min: _Range = 0.15
    range_max: _Range = 3.0
    rate: _Rate = 15.0
    latency: _Latency = 0.03
    noise: _Noise = 0.01
    noise_ratio: Fraction = 0.01
    dropout: Fraction = 0.02
    near_reads_min: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class InfraredParams(RingParams):
    """Infrared distance sensors; the figures are those assumed of six triangulating ones of 0.8 m."""

    name: str = "infrared"
    kind: _RingKind = "infrared"
    frames: tuple[str, ...] = tuple(f"ir_{k}_frame" for k in range(6))
    half_angle: _RightAngle = 0.03
    rays: Count = 7
    max_incidence: _RightAngle = 1.4
    crosstalk: Fraction = 0.0
    groups: Count = 1
    range_min: _Range = 0.1
    range_max: _Range = 0.8
    rate: _Rate = 25.0
    latency: _Latency = 0.04
    noise: _Noise = 0.003
    noise_ratio: Fraction = 0.02
    dropout: Fraction = 0.005
    near_reads_min: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageParams(RangeParams):
    """What a depth camera and a 3-D lidar have in common; the first column of a row is the first that is seen.

    Attributes:
        frame: link of the URDF that it is fixed to.
        columns, rows: size of its images [px].
        noise_growth: growth of the standard deviation with the square of the range [1/m].
        edge_dropout: probability that a range is lost where a neighbour's differs by ``edge_step`` [-].
        edge_step: such a difference [m].
        max_incidence: angle between a ray and the normal of a surface beyond which nothing comes back [rad].
        bias: largest error that all ranges of a run have in common [m]; the same part of it every time …
        bias_ratio: … and what it grows by per metre of range [-].
        floor: whether the plane z = 0 is seen.
    """

    frame: str
    columns: _Columns
    rows: _Columns
    noise_growth: _Growth
    edge_dropout: Fraction
    edge_step: _Range
    max_incidence: _RightAngle
    bias: _Noise
    bias_ratio: Fraction
    floor: bool

    def __post_init__(self) -> None:
        RangeParams.__post_init__(self)
        check_count(f"{_where(self)}.rows", self.rows, low=2, high=max(_MOST_PIXELS // self.columns, 2))


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthParams(ImageParams):
    """A depth camera. The figures are those assumed of a small stereo or structured-light camera; see docs/sensors.md.

    Attributes:
        axis: axis of the link that it looks along: "z" of an optical frame, whose x is to the right, or "x" of a frame
            whose z is up.
        tilt: by how much it is turned downwards from there [rad].
        field_of_view: from the left border of an image to the right one [rad]; pixels are square.
    """

    name: str = "camera"
    frame: str = "head_frame"
    axis: Literal["x", "z"] = "z"
    tilt: Annotated[float, Bound(low=-0.5 * math.pi, high=0.5 * math.pi, unit="rad")] = 0.0
    field_of_view: Annotated[float, Bound(low=0.01, high=math.radians(150.0), unit="rad")] = 1.02
    columns: _Columns = 160
    rows: _Columns = 120
    range_min: _Range = 0.28
    range_max: _Range = 6.0
    rate: _Rate = 15.0
    latency: _Latency = 0.08
    noise: _Noise = 0.001
    noise_ratio: Fraction = 0.0
    noise_growth: _Growth = 0.0033
    dropout: Fraction = 0.01
    edge_dropout: Fraction = 0.5
    edge_step: _Range = 0.1
    max_incidence: _RightAngle = 1.396
    bias: _Noise = 0.002
    bias_ratio: Fraction = 0.003
    near_reads_min: bool = False
    floor: bool = True

    @property
    def T_frame_camera(self) -> Array:
        """(4, 4) pose of the camera on its link: z looks, x to the right, y down."""
        T = np.eye(4)
        if self.axis == "x":
            T[:3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
        c, s = math.cos(self.tilt), math.sin(self.tilt)
        T[:3, :3] = T[:3, :3] @ [[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]]  # z towards y, which is down
        return T


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarParams(ImageParams):
    """A lidar of many rays that turns about its z axis. The figures are those assumed of a small one of 40 m.

    Attributes:
        mast: how far it is above its link, along the link's z axis [m].
        elevation_min, elevation_max: elevations of the first and of the last row [rad].
        columns: rays in a turn, the first along −x.
    """

    name: str = "lidar"
    frame: str = "lidar_frame"
    mast: Annotated[float, Bound(low=0.0, high=3.0, unit="m")] = 0.0
    elevation_min: _Elevation = -0.122
    elevation_max: _Elevation = 0.908
    columns: _Columns = 512
    rows: _Columns = 40
    range_min: _Range = 0.1
    range_max: _Range = 40.0
    rate: _Rate = 10.0
    latency: _Latency = 0.1
    noise: _Noise = 0.007
    noise_ratio: Fraction = 0.0
    noise_growth: _Growth = 0.0
    dropout: Fraction = 0.01
    edge_dropout: Fraction = 0.05
    edge_step: _Range = 0.3
    max_incidence: _RightAngle = 1.484
    bias: _Noise = 0.01
    bias_ratio: Fraction = 0.0
    near_reads_min: bool = False
    floor: bool = True

    def __post_init__(self) -> None:
        ImageParams.__post_init__(self)
        if not self.elevation_max > self.elevation_min:
            raise ParameterError(
                f"{_where(self)}.elevation_max={self.elevation_max!r} must exceed "
                f"elevation_min={self.elevation_min!r} rad"
            )

    @property
    def T_frame_lidar(self) -> Array:
        """(4, 4) pose of the lidar on its link."""
        T = np.eye(4)
        T[2, 3] = self.mast
        return T


_SensorParams = LaserParams | RingParams | DepthParams | LidarParams


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorConfig:
    """The range sensors of a robot.

    Attributes:
        sensors: the sensors' parameters; no two have the same name. The default is the Silvermate's set.
        self_padding: by how much the links count as thicker than they are, when the robot decides whether a beam met
            itself [m].
    """

    sensors: tuple[_SensorParams, ...] = (LaserParams(), SonarParams(), InfraredParams())
    self_padding: Annotated[float, Bound(low=0.0, high=1.0, unit="m")] = 0.01

    def __post_init__(self) -> None:
        check_fields(self)
        object.__setattr__(self, "sensors", tuple(self.sensors))
        names: set[str] = set()
        for sensor in self.sensors:
            if not isinstance(sensor, _SensorParams):
                raise ParameterError(f"SensorConfig.sensors: {sensor!r} describes no sensor")
            if sensor.name in names:
                raise ParameterError(f"SensorConfig.sensors: two of them are named {sensor.name!r}; names are unique")
            names.add(sensor.name)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sensors."""
        return tuple(s.name for s in self.sensors)

    @property
    def required(self) -> tuple[str, ...]:
        """Names of the sensors that scenes rest on: all but the rings, which say nothing about what moves."""
        return tuple(s.name for s in self.sensors if not isinstance(s, RingParams))

    @property
    def oldest(self) -> float:
        """Largest age [s] of a reading of these that has come in time, or has been missed once."""
        return max((s.latency + 2.0 / s.rate for s in self.sensors if s.name in self.required), default=0.0)

    def only(self, *names: str) -> SensorConfig:
        """These sensors alone.

        Raises:
            ParameterError: there is no sensor of such a name.
        """
        for name in names:
            check_choice("sensor", name, self.names)
        return replace(self, sensors=tuple(s for s in self.sensors if s.name in names))


_KINDS: dict[str, type[LaserParams | SonarParams | InfraredParams | DepthParams | LidarParams]] = {
    "laser": LaserParams,
    "sonar": SonarParams,
    "infrared": InfraredParams,
    "depth": DepthParams,
    "lidar": LidarParams,
}


_MORE: dict[str, tuple[ImageParams | LaserParams, ...]] = {
    "silvermate": (
        DepthParams(name="head-camera", frame="head_frame", axis="x", tilt=0.35, field_of_view=1.5),
        LidarParams(name="mast-lidar", frame="head_frame", mast=0.35, elevation_min=-0.908, elevation_max=0.122),
        LaserParams(name="rear-laser", frame="sonar_6_frame"),
    ),
    "tiago": (DepthParams(name="head-camera", frame="xtion_depth_optical_frame"),),
    "fetch": (DepthParams(name="head-camera", frame="head_camera_depth_optical_frame"),),
}
"""What robots may have besides. It is not in their files: who drives by ``"all"`` need not pay for it."""


def sensor_file(robot: str = "silvermate") -> Path:
    """The file of a robot's range sensors that comes with the library: one to copy and to change.

    Args:
        robot: name of the robot; a robot without a file gets the Silvermate's.
    """
    own = Path(__file__).with_name(f"{Path(robot).stem}_sensors.yaml")
    return own if own.is_file() else own.with_name("silvermate_sensors.yaml")


def named_sensors(text: str, robot: str) -> SensorConfig:
    """The sensors that a text names, for a robot by name: a YAML file, or names as ``"laser,head-camera"``.

    ``"all"`` is all of the robot's file. Not in the file are ``"head-camera"``, a depth camera on the head of the
    Silvermate, TIAGo and Fetch; ``"mast-lidar"``, a lidar above the Silvermate's head, which hides nothing from it; and
    ``"rear-laser"``, a second planar one at its back.

    Raises:
        ParameterError: no such sensor, or a file that does not describe sensors.
    """
    if text.endswith((".yaml", ".yml")):
        return read_sensors(text)
    config = read_sensors(sensor_file(robot))
    every = (*config.sensors, *_MORE.get(Path(robot).stem, ()))
    valid = [sensor.name for sensor in every]
    names = [name.strip() for name in text.split(",")]
    for name in names:
        check_choice(f"sensors of {robot!r}: name", name, ("all", *valid))
    if "all" in names:
        names += config.names
    return replace(config, sensors=every).only(*(name for name in names if name != "all"))


def read_sensors(path: str | os.PathLike[str] | None = None) -> SensorConfig:
    """The range sensors that a YAML file describes.

    Args:
        path: the file; None for the Silvermate's.

    Returns:
        The sensors in the order of the file; values that it leaves out are those of `LaserParams`, `SonarParams` and
        `InfraredParams`.

    Raises:
        ParameterError: the file cannot be read, a key is unknown, a value is of another kind or out of bounds; the
            message names file, line, key, value and bound.
    """
    root = load_yaml(sensor_file() if path is None else path, error=ParameterError)
    entries = root.mapping(("sensors", "self_padding"), needed=("sensors",), what="a sensor file")
    named = entries["sensors"].mapping(what="names to sensors")
    values: dict[str, object] = {"sensors": tuple(_sensor(name, node) for name, node in named.items())}
    if "self_padding" in entries:
        values["self_padding"] = entries["self_padding"].number()
    return root.checked(SensorConfig, **values)


def _sensor(name: str, node: Node) -> _SensorParams:
    kind = node.mapping().get("kind")
    if kind is None:
        node.fail(f"the key 'kind' is missing{nearest_name('kind', _KINDS)}")
    make = _KINDS[kind.text(valid=_KINDS)]
    known = {name: kind for name, kind in get_type_hints(make).items() if name != "name"}
    entries = node.mapping(("kind", *known), what=f"a {kind.value}")
    values: dict[str, object] = {"name": name}
    for key, entry in entries.items():
        if key != "kind":
            values[key] = _value(known[key], entry)
    return node.checked(make, **values)


def _value(kind: object, node: Node) -> object:
    """What a node holds, as the field of that type needs it."""
    if kind is str:
        return node.text()
    if kind is bool:
        return node.boolean()
    if kind is int:
        return node.integer(low=0, high=1_000_000)
    if get_origin(kind) is Literal:
        return node.text(valid=get_args(kind))
    if get_origin(kind) is Annotated and get_args(kind)[0] is int:
        return node.integer(low=0, high=1_000_000)
    if get_origin(kind) is tuple:
        return tuple(entry.text() for entry in node)
    return node.number(unit="")
