"""Faults that are injected around a controller, to test that the robot comes to rest, and continues where it can.

They are wrappers around perception, sensors, plant and planning tick.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from elastic_strips.arrays import Array, Image
from elastic_strips.catalogue import FAULTS
from elastic_strips.control.controller import PlanTick
from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.control.params import DriveParams
from elastic_strips.control.strip_timer import PlanResult
from elastic_strips.errors import ParameterError
from elastic_strips.perception import DepthImage, RangeImage, Reading
from elastic_strips.scene import Scene, Twist, World
from elastic_strips.trajectory import Trajectory
from elastic_strips.validation import Bound, check_choice, check_fields, check_type, shown

from .perception import Perception, PerceptionError
from .plant import KinematicPlant, Plant
from .sensors import SensorSuite

_SLOW_TICK_LATENCIES = 10.0
_SIZES = {
    "slip": 0.5,
    "slip_left": 0.5,
    "slip_right": 0.5,
    "spin": 1.0,
    "localization_jump": 1.0,
    "localization_coarse": 1.0,
    "fix_drift": 0.03,
    "scene_late": 0.3,
    "scene_future": 1.0,
    "camera_tilted": 0.035,
    "camera_late": 0.3,
    "fog": 3.0,
    "glass": 0.5,
}
_ANGLES = ("camera_tilted",)
IMAGE_FAULTS = ("camera_dead", "camera_frozen", "camera_tilted", "camera_late", "fog")
"""Those that need a simulated camera or 3-D lidar."""
SENSOR_FAULTS = (*IMAGE_FAULTS, "glass")
"""Those that need simulated sensors."""
_SCATTERED = 0.5  # of the light that fog stops comes back
_SYNTAX = re.compile(r"(?P<kind>[\w-]+)(=(?P<size>[^@]+))?@(?P<start>[^:+]+)([:+](?P<duration>.+))?")
_COARSE_LOCALIZATION = (0.02, 0.01, 0.1, 0.1)  # [m], [rad], period and latency [s] of coarse localization
_OUTLIER_FIXES = (0.02, 0.3)  # part of its fixes that are off, and by how much [m]
_ROLLING_TIME = 1.0  # [s] time constant of the speed of a drive without power
_Seconds = Annotated[float, Bound(low=0.0, unit="s")]


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of a run.

    Attributes:
        kind: one of ``FAULTS``.
        start: when it begins [s].
        duration: how long it lasts [s].
        size: how large it is, where that has a meaning; None: the kind's own size.
    """

    kind: str
    start: _Seconds
    duration: _Seconds = 1.0
    size: Annotated[float, Bound(low=0.0)] | None = None

    def __post_init__(self) -> None:
        check_choice("Fault.kind", self.kind, FAULTS)
        check_fields(self, f"Fault({self.kind!r})")
        if self.size is not None and self.kind not in _SIZES:
            raise ParameterError(f"fault {self.kind!r} has no size; those that have one: {', '.join(_SIZES)}")
        object.__setattr__(self, "size", _SIZES.get(self.kind) if self.size is None else self.size)

    def active(self, t: float) -> bool:
        """Whether it is present at time ``t`` [s]."""
        return self.start <= t < self.start + self.duration

    @staticmethod
    def parse(text: str) -> Fault:
        """A fault from ``kind@start``, ``kind@start+duration`` or ``kind=size@start+duration``.

        A kind may be written with hyphens, a colon stands for the plus, and an angle may be in degrees: ``2deg``.

        Raises:
            ParameterError: anything else.
        """
        check_type("a fault", text, str)
        wanted = f"fault {text!r} must read kind[=size]@start[+duration], in seconds, say slip-left=0.5@4+2"
        found = _SYNTAX.fullmatch(text.strip())
        kind = text.partition("@")[0].partition("=")[0].strip().replace("-", "_")
        check_choice("fault", kind, FAULTS)
        if found is None:
            raise ParameterError(wanted)
        try:
            size = None if found["size"] is None else _size(kind, found["size"].strip())
            start, duration = float(found["start"]), float(found["duration"] or 1.0)
        except ValueError:
            raise ParameterError(wanted) from None
        return Fault(kind, start, duration, size)


def _size(kind: str, text: str) -> float:
    """The size of a fault; `ValueError` where the text is none."""
    if kind in _ANGLES and text.endswith("deg"):
        return math.radians(float(text.removesuffix("deg")))
    return float(text)


class FaultPlan:
    """The faults of a run, looked up by kind and time."""

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        if not isinstance(faults, Iterable) or isinstance(faults, (str, bytes)):
            raise ParameterError(f"faults={shown(faults)} must be a list of Faults")
        self.faults: tuple[Fault, ...] = tuple(faults)
        for fault in self.faults:
            check_type("a fault", fault, Fault)

    def active(self, kind: str, t: float) -> bool:
        """Whether a fault of that kind is present at time ``t`` [s]."""
        return any(f.kind == kind and f.active(t) for f in self.faults)

    def size(self, kind: str, t: float) -> float:
        """Size of a fault of that kind at time ``t`` [s]; 0 where there is none."""
        return max((f.size or 0.0 for f in self.faults if f.kind == kind and f.active(t)), default=0.0)

    def glass(self, world: World, seed: int) -> Callable[[float], tuple[str, ...]]:
        """Time [s] → names of the obstacles of a world that are of glass then: the first ones of those that rest, in an
        order by chance."""
        resting = world.names_resting
        order = tuple(resting[k] for k in np.random.default_rng(seed).permutation(len(resting)))
        return lambda t: order[: math.ceil(self.size("glass", t) * len(order))]


class FaultyPerception:
    """Workspace: a perception whose scenes are at times frozen, late, of the future, empty or invalid, or say nothing
    true of what moves; and whose simulated cameras fail, or see through what is of glass.

    Args:
        inner: the perception; where it has simulated sensors, they fail from now on as the faults say.
        faults: the faults and their times.
        seed: seed of the fog, and of what is of glass.

    Attributes:
        glass: time [s] → names of the obstacles that are of glass then; only where simulated sensors fail.

    Raises:
        ParameterError: faults of cameras, or glass, where there are none that could have them.
    """

    def __init__(self, inner: Perception, faults: FaultPlan, seed: int = 0) -> None:
        self._inner, self._faults = inner, faults
        wanted = [f.kind for f in faults.faults if f.kind in SENSOR_FAULTS]
        if wanted:
            suite = getattr(inner, "suite", None)
            of_images = next((kind for kind in wanted if kind in IMAGE_FAULTS), None)
            if not isinstance(suite, SensorSuite) or (of_images and not suite.imagers):
                what = "camera or 3-D lidar that could have it" if of_images else "sensor that could see through it"
                raise ParameterError(f"fault {of_images or wanted[0]!r}: there is no simulated {what}")
            sensors = FaultySensors(suite, faults, seed)
            setattr(inner, "suite", sensors)  # noqa: B010  # of a protocol
            self.glass = sensors.glass
        self._last: Scene | None = None

    def __getattr__(self, name: str) -> object:
        return getattr(self._inner, name)

    def sense(self, t: float) -> Scene:
        faults = self._faults
        if faults.active("nan_obstacle", t):
            raise PerceptionError("the sensed scene holds a pose that is not finite")
        if faults.active("sensing_exception", t):
            raise RuntimeError("injected sensing exception")
        if self._last is None or not faults.active("scene_frozen", t):
            self._last = self._inner.sense(t - faults.size("scene_late", t))
        if faults.active("scene_empty", t):
            return Scene([], time=self._last.time)
        ahead = faults.size("scene_future", t)
        if ahead:
            return Scene(self._last, time=self._last.time + ahead)
        if faults.active("scene_without_motion", t):
            return _as_if(self._last, 0.0)
        return _as_if(self._last, -1.0) if faults.active("scene_reversed", t) else self._last


class FaultySensors:
    """Workspace: a suite of sensors whose cameras and 3-D lidars are at times dead, frozen, tilted, late or in fog, in
    a world of which a part is at times of glass.

    Args:
        inner: the sensors.
        faults: the faults and their times.
        seed: seed of the fog, and of what is of glass.

    Attributes:
        glass: time [s] → names of the obstacles that are of glass then.
    """

    def __init__(self, inner: SensorSuite, faults: FaultPlan, seed: int = 0) -> None:
        self._inner, self._faults = inner, faults
        self._rng = np.random.default_rng(seed)
        self._past: dict[str, deque[DepthImage | RangeImage]] = {}  # as they truly were
        self._frozen: dict[str, Image] = {}
        self.glass = faults.glass(inner.obstacles.world, seed)

    def __getattr__(self, name: str) -> object:
        return getattr(self._inner, name)

    def observe(self, t: float, coordinates: Array) -> tuple[Reading, ...]:
        for imager in self._inner.imagers:
            imager.tilted = self._faults.size("camera_tilted", t)
        self._inner.obstacles.make_of_glass(self.glass(t))
        readings = (
            self._wrong(reading) if isinstance(reading, (DepthImage, RangeImage)) else reading
            for reading in self._inner.observe(t, coordinates)
        )
        return tuple(reading for reading in readings if reading is not None)

    def _wrong(self, image: DepthImage | RangeImage) -> DepthImage | RangeImage | None:
        """What comes in place of an image, of faults at its time; None where nothing does."""
        faults, name, t = self._faults, image.sensor, image.time
        past = self._past.setdefault(name, deque())
        past.append(image)
        late, ranges = faults.size("camera_late", t), image.ranges
        if late:
            ranges = min(past, key=lambda earlier: abs(earlier.time - (t - late))).ranges
        while len(past) > 1 and past[0].time < t - max((f.size or 0.0 for f in faults.faults), default=0.0) - 1.0:
            past.popleft()
        if faults.active("fog", t):
            ranges = self._fogged(ranges, image.directions(), faults.size("fog", t))
        if faults.active("camera_frozen", t):
            ranges = self._frozen.setdefault(name, ranges)
        else:
            self._frozen.pop(name, None)
        if faults.active("camera_dead", t):
            return None
        if ranges is image.ranges:
            return image
        return replace(image, depth=ranges) if isinstance(image, DepthImage) else replace(image, ranges=ranges)

    def _fogged(self, ranges: Image, directions: Array, visibility: float) -> Image:
        """Ranges of which those are short or lost whose light meets fog before."""
        stretch = np.linalg.norm(directions, axis=-1)
        met = self._rng.exponential(max(visibility, 1e-9), ranges.shape) / stretch
        back = self._rng.random(ranges.shape) < _SCATTERED
        return np.where(met < ranges, np.where(back, met, np.nan), ranges).astype(np.float32)


def _as_if(scene: Scene, part: float) -> Scene:
    """A scene in which the velocities are said to be this part of what they are, none where 0."""
    movers = [o for o in scene if o.motion is not None]
    wrong = [tuple(part * v for v in o.velocity()) for o in movers]
    said = [Twist(*twist) if part else None for twist in wrong]
    return scene.with_observations(o.observed(o.pose, motion) for o, motion in zip(movers, said, strict=True))


class FaultyPlant:
    """Workspace: a plant whose wheels slip, whose motors disobey, and whose measurements are wrong, at times.

    Args:
        inner: the plant.
        faults: the faults and their times.
        seed: seed of the noise of coarse localization.

    Raises:
        ParameterError: wheels that slip, on a plant without slip.
    """

    def __init__(self, inner: Plant, faults: FaultPlan, seed: int = 0) -> None:
        self._inner, self._faults = inner, faults
        self._rng = np.random.default_rng(seed)
        self._held: Command | None = None
        self._unread: Array | float = 0.0  # travel of measurements that did not arrive
        self._fixes: deque[tuple[float, Array]] = deque()  # coarse ones that are under way: times, poses
        self._next_fix = -math.inf
        self._drift = np.zeros(3)  # [m] of fixes from the truth
        if any(f.kind.startswith(("slip", "spin")) for f in faults.faults) and not isinstance(inner, KinematicPlant):
            raise ParameterError("wheel slip can be injected on the kinematic plant only")

    def __getattr__(self, name: str) -> object:
        return getattr(self._inner, name)

    def step(self, command: Command, dt: float) -> Measurement:
        t, inner, faults = self._inner.time, self._inner, self._faults
        if faults.active("lost_odometry", t):
            inner.lost_odometry(t + dt)
        if isinstance(inner, KinematicPlant):
            every = max(faults.size("slip", t), faults.size("spin", t))
            sides = ("slip_left", "slip_right") if len(inner.motors) == 2 else ()
            inner.lost = [
                max(every, *(faults.size(side, t) for side in sides[i : i + 1])) for i in range(len(inner.motors))
            ]
        measurement = inner.step(self._obeyed(command, t, dt), dt)
        if measurement.drive is not None:
            measurement = replace(measurement, drive=measurement.drive + self._unread)
        if faults.active("driver_exception", t):
            self._unread = 0.0 if measurement.drive is None else measurement.drive
            raise RuntimeError("injected driver exception")
        self._unread = 0.0
        drift, yaw = faults.size("fix_drift", t), float(inner.coordinates[2]) if inner.robot.space.base_nv else 0.0
        sideways = np.array([-math.sin(yaw), math.cos(yaw), 0.0])
        self._drift = self._drift + drift * dt * sideways if drift else np.zeros(3)
        return self._misread(measurement, t)

    def _obeyed(self, command: Command, t: float, dt: float) -> Command:
        """The command that the motors obey. A safe stop cuts their power and brakes, whatever the amplifier does."""
        if not self._faults.active("amplifier_holds", t):
            self._held = command
        if command.stop:
            return command
        if self._faults.active("amplifier_dead", t):
            return Command(self._inner.motors * math.exp(-dt / _ROLLING_TIME), np.zeros_like(command.joints))
        return self._held or command

    def _misread(self, measurement: Measurement, t: float) -> Measurement:
        faults, nan = self._faults, np.nan
        if faults.active("nan_odometry", t) and measurement.drive is not None:
            measurement = replace(measurement, drive=np.full_like(measurement.drive, nan))
        if faults.active("nan_joints", t):
            measurement = replace(measurement, joints=np.full_like(measurement.joints, nan))
        if faults.active("localization_lost", t):
            return replace(measurement, pose=None, pose_time=None)
        coarse = faults.size("localization_coarse", t)
        if coarse and self._inner.robot.space.base_nv:
            return self._coarse(measurement, coarse)
        if measurement.pose is None:
            return measurement
        if faults.active("nan_fix", t):
            return replace(measurement, pose=np.full(3, nan))
        jump = faults.size("localization_jump", t)
        return replace(measurement, pose=measurement.pose + np.array([0.6 * jump, 0.8 * jump, 0.0]) + self._drift)

    def _coarse(self, measurement: Measurement, scale: float) -> Measurement:
        """A measurement with fixes that are less exact, rarer and later, and that say so."""
        off, turn, period, latency = _COARSE_LOCALIZATION
        t = measurement.time
        if t >= self._next_fix:
            noise = np.clip(self._rng.standard_normal(3), -3.0, 3.0) * scale * np.array([off, off, turn])
            if self._rng.random() < _OUTLIER_FIXES[0]:
                way = self._rng.uniform(0.0, 2.0 * np.pi)
                noise[:2] += _OUTLIER_FIXES[1] * np.array([np.cos(way), np.sin(way)])
            self._fixes.append((t, self._inner.coordinates[:3] + noise))
            self._next_fix = t + period
        if not self._fixes or self._fixes[0][0] + latency > t:
            return replace(measurement, pose=None, pose_time=None)
        at, pose = self._fixes.popleft()
        covariance = np.diag(np.square(scale * np.array([off, off, turn])))
        return replace(measurement, pose=pose, pose_time=at, pose_covariance=covariance)


def faulty_planning(
    plan_tick: PlanTick, faults: FaultPlan, params: DriveParams, *, wait: Callable[[float], object] | None = None
) -> PlanTick:
    """The planning tick, at times with exceptions, or with results that are late by ten of the drive's latencies.

    Where time is real, ``wait`` lets it pass.
    """
    slow = _SLOW_TICK_LATENCIES * params.latency * params.control_dt

    def faulty(now: float, scene: Scene, active: Trajectory, begin: float) -> PlanResult:
        if faults.active("planning_exception", now):
            raise RuntimeError("injected planning exception")
        result = plan_tick(now, scene, active, begin)
        if not faults.active("slow_tick", now):
            return result
        if wait is not None:
            wait(slow)
        return replace(result, late=slow)

    return faulty
