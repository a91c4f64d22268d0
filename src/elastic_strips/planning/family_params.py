"""Parameters of a family of strips, validated where they are made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import ParameterError


@dataclass(frozen=True, slots=True, kw_only=True)
class FamilyParams:
    """How many strips a family keeps, and when it changes over.

    Attributes:
        count: most strips, the current one included.
        margin: share by which another strip must be cheaper than the current one to be better.
        patience: so many times in a row another strip must have been found better before it is followed; and broken
            before it is dropped, or the current one planned anew.
        stem: how far ahead [m] it is looked where a strip leads, once the robot has gone as far since it was planned.
        part: a strip is dropped then that leads another way than a certified current one by more than this angle
            [rad]: the robot has passed where they part.
        plan_every: a planner is called at most once in so many ticks; 0 calls none.
        timeout: of a planner's call within a tick [s].
    """

    count: int = 3
    margin: float = 0.15
    patience: int = 5
    stem: float = 0.6
    part: float = 1.8
    plan_every: int = 50
    timeout: float = 0.5

    def __post_init__(self) -> None:
        for name, least in (("count", 1), ("patience", 1), ("plan_every", 0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
                raise ParameterError(f"{name}={value!r} must be an integer ≥ {least}")
        for name in ("margin", "stem", "part", "timeout"):
            value = getattr(self, name)
            number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
            if not number or not np.isfinite(value) or value < 0:
                raise ParameterError(f"{name}={value!r} must be a finite number ≥ 0")
        if self.margin >= 1.0:
            raise ParameterError(f"margin={self.margin!r} must be below 1: no strip costs nothing")
        if self.timeout == 0.0:
            raise ParameterError("timeout=0.0 must be > 0 s")
