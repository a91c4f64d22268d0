"""Checks of what callers hand in: types and numbers. The messages name the value, its bound, and what is wanted."""

from __future__ import annotations

import math
import numbers
import reprlib
from collections.abc import Iterable
from dataclasses import fields
from typing import Any

from .errors import InputError, ParameterError, nearest_name

_SHORT = reprlib.Repr()  # of a list of a million entries the first ones alone
_SHORT.maxlevel = 4
_SHORT.maxlist = _SHORT.maxtuple = _SHORT.maxdict = _SHORT.maxset = _SHORT.maxfrozenset = _SHORT.maxarray = 40
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 100


def shown(value: object, most: int = 80) -> str:
    """A value in an error message: on one line, and short."""
    try:
        text = " ".join(_SHORT.repr(value).split())
    except Exception:  # a value that cannot even say what it is
        text = f"<{type(value).__name__}>"
    return text if len(text) <= most else text[: most - 3] + "..."


def check_type(
    what: str, value: object, kind: type, error: type[InputError] = ParameterError, *, none: bool = False
) -> None:
    """The value is of that kind, or None where ``none`` says that it may be.

    Raises:
        error: it is not; the message says what it is instead.
    """
    if isinstance(value, kind) or (none and value is None):
        return
    article = "an" if kind.__name__[0] in "AEIOU" else "a"
    raise error(f"{what} must be {article} {kind.__name__}{' or None' if none else ''}, not {_told(value)}")


def check_able(what: str, value: object, *methods: str, error: type[InputError] = ParameterError) -> None:
    """The value has these methods; where none is named, it can be called. None passes: it stands for a default.

    Raises:
        error: it has not.
    """
    missing = [name for name in methods if not callable(getattr(value, name, None))]
    if value is None or (callable(value) if not methods else not missing):
        return
    wanted = f"have the method{'s' if len(missing) > 1 else ''} {', '.join(missing)}" if methods else "be a function"
    raise error(f"{what} must {wanted}; it is {_told(value)}")


def check_choice(what: str, value: object, valid: Iterable[str], error: type[InputError] = ParameterError) -> None:
    """The value is one of the names.

    Raises:
        error: it is not; the message has the names.
    """
    names = tuple(valid)
    if not isinstance(value, str) or value not in names:
        raise error(f"{what}={shown(value)} is unknown{nearest_name(shown(value), names)}")


def _told(value: object) -> str:
    """What a value is, for those who handed in another one than they thought."""
    return "None" if value is None else f"{type(value).__name__}: {shown(value)}"


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
    number = int(value) if isinstance(value, numbers.Integral) and not isinstance(value, bool) else None
    if number is None or number < low or (high is not None and number > high):
        upto = "" if high is None else f" and ≤ {high}"
        raise ParameterError(f"{what}={shown(value)} must be a whole number ≥ {low}{upto}")
    return number


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
            check_number(what, value, low=0.0, above=-math.inf if f.name in zero else 0.0)
