"""Faults that are injected around a controller, to test that the robot comes to rest.

They are wrappers around perception, plant and planning tick.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated

from elastic_strips.control.controller import PlanTick
from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.control.strip_timer import PlanResult
from elastic_strips.errors import ParameterError
from elastic_strips.scene import Scene
from elastic_strips.trajectory import Trajectory
from elastic_strips.validation import Bound, check_choice, check_fields, check_type, shown

from .perception import Perception, PerceptionError
from .plant import Plant

FAULTS = {
    "scene_frozen": "the scene is not renewed",
    "scene_late": "the scene comes 0.3 s late",
    "nan_obstacle": "an obstacle's pose is not a number",
    "planning_exception": "the planning tick raises an exception",
    "slow_tick": "the planning tick takes ten times its budget",
    "lost_odometry": "neither wheel travel nor position is measured",
    "viewer_killed": "the viewer's process dies",
}
_SCENE_DELAY = 0.3
"""Lateness [s] of the fault ``scene_late``."""
_Seconds = Annotated[float, Bound(low=0.0, unit="s")]


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of a run.

    Attributes:
        kind: one of ``FAULTS``.
        start: when it begins [s].
        duration: how long it lasts [s].
    """

    kind: str
    start: _Seconds
    duration: _Seconds = 1.0

    def __post_init__(self) -> None:
        check_choice("Fault.kind", self.kind, FAULTS)
        check_fields(self, f"Fault({self.kind!r})")

    def active(self, t: float) -> bool:
        """Whether it is there at time ``t`` [s]."""
        return self.start <= t < self.start + self.duration

    @staticmethod
    def parse(text: str) -> Fault:
        """A fault from ``kind@start`` or ``kind@start:duration``.

        Raises:
            ParameterError: anything else.
        """
        check_type("a fault", text, str)
        kind, _, rest = text.partition("@")
        start, _, duration = rest.partition(":")
        try:
            return Fault(kind, float(start or 0.0), float(duration or 1.0))
        except ValueError as error:
            if isinstance(error, ParameterError):
                raise
            raise ParameterError(f"fault {text!r} must read kind@start or kind@start:duration, in seconds") from None


class FaultPlan:
    """The faults of a run, looked up by kind and time."""

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        if not isinstance(faults, Iterable) or isinstance(faults, (str, bytes)):
            raise ParameterError(f"faults={shown(faults)} must be a list of Faults")
        self.faults: tuple[Fault, ...] = tuple(faults)
        for fault in self.faults:
            check_type("a fault", fault, Fault)

    def active(self, kind: str, t: float) -> bool:
        """Whether a fault of that kind is there at time ``t`` [s]."""
        return any(f.kind == kind and f.active(t) for f in self.faults)


class FaultyPerception:
    """Workspace: a perception whose scenes are frozen, late or invalid at times; else the wrapped one."""

    def __init__(self, inner: Perception, faults: FaultPlan) -> None:
        self._inner, self._faults = inner, faults
        self._last: Scene | None = None

    def __getattr__(self, name: str) -> object:
        return getattr(self._inner, name)

    def sense(self, t: float) -> Scene:
        if self._faults.active("nan_obstacle", t):
            raise PerceptionError("the sensed scene holds a pose that is not finite")
        if self._last is None or not self._faults.active("scene_frozen", t):
            self._last = self._inner.sense(t - (_SCENE_DELAY if self._faults.active("scene_late", t) else 0.0))
        return self._last


class FaultyPlant:
    """Workspace: a plant whose odometry is lost at times; else the wrapped one."""

    def __init__(self, inner: Plant, faults: FaultPlan) -> None:
        self._inner, self._faults = inner, faults

    def __getattr__(self, name: str) -> object:
        return getattr(self._inner, name)

    def step(self, command: Command, dt: float) -> Measurement:
        if self._faults.active("lost_odometry", self._inner.time):
            self._inner.lost_odometry(self._inner.time + dt)
        return self._inner.step(command, dt)


def faulty_planning(plan_tick: PlanTick, faults: FaultPlan, *, slow: float) -> PlanTick:
    """The planning tick with exceptions, or with results that are late by ``slow`` [s], at times."""

    def faulty(now: float, scene: Scene, active: Trajectory, begin: float) -> PlanResult:
        if faults.active("planning_exception", now):
            raise RuntimeError("planning exception put in on purpose")
        result = plan_tick(now, scene, active, begin)
        return replace(result, late=slow) if faults.active("slow_tick", now) else result

    return faulty
