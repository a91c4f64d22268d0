"""Checks of what callers hand in: types and numbers. The messages name the value, its bound, and what is wanted."""

from __future__ import annotations

import math
import numbers
from dataclasses import fields
from typing import Any, TypeVar

from .errors import InputError, ParameterError

_T = TypeVar("_T")


def shown(value: object, most: int = 80) -> str:
    """A value in an error message: on one line, and short."""
    text = " ".join(repr(value).split())
    return text if len(text) <= most else text[: most - 3] + "..."


def check_type(
    what: str, value: object, kind: type[_T], error: type[InputError] = ParameterError, *, hint: str = ""
) -> _T:
    """The value, if it is of that kind.

    Raises:
        error: it is not; the message says what it is instead.
    """
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        got = shown(value) if value is None else f"{type(value).__name__}: {shown(value)}"
        raise error(f"{what} must be {article} {kind.__name__}{hint}, not {got}")
    return value


def check_number(
    what: str, value: Any, *, low: float = -math.inf, high: float = math.inf, above: float = -math.inf, unit: str = ""
) -> float:
    """A finite number in [low, high], and larger than ``above``; True and False are none.

    Raises:
        ParameterError: it is not.
    """
    if not _is_finite(value) or not low <= value <= high or not value > above:
        bounds = [
            f"{sign} {bound:g}" for sign, bound in ((">", above), ("≥", low), ("≤", high)) if math.isfinite(bound)
        ]
        wanted = " ".join(["a finite number", unit and f"of {unit}", " and ".join(bounds)]).split()
        raise ParameterError(f"{what}={shown(value)} must be {' '.join(wanted)}")
    return float(value)


def _is_finite(value: Any) -> bool:
    try:
        return isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # a whole number that no float can hold
        return False


def check_count(what: str, value: Any, *, low: int = 0, high: int | None = None) -> int:
    """A whole number from ``low`` to ``high``; True and False are none.

    Raises:
        ParameterError: it is not.
    """
    good = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not good or value < low or (high is not None and value > high):
        upto = "" if high is None else f" and ≤ {high}"
        raise ParameterError(f"{what}={shown(value)} must be a whole number ≥ {low}{upto}")
    return int(value)


def check_numbers(owner: Any, *, zero: tuple[str, ...] = ()) -> None:
    """Every number of a dataclass is finite and > 0, or ≥ 0 where it is named in ``zero``; an ``int`` is whole.

    Raises:
        ParameterError: a value that is not; the message has the value and its bound.
    """
    for f in fields(owner):
        value, what = getattr(owner, f.name), f"{type(owner).__name__}.{f.name}"
        if f.type in ("int", int):
            check_count(what, value, low=0 if f.name in zero else 1)
        elif f.type in ("float", float):
            check_number(what, value, **({"low": 0.0} if f.name in zero else {"above": 0.0}))
