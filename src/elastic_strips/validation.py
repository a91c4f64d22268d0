"""Checks of what callers hand in: types and numbers. The messages name the value, its bound, and what is wanted."""

from __future__ import annotations

import math
import numbers
import reprlib
from collections.abc import Iterable
from dataclasses import fields
from typing import TypeGuard

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import InputError, ParameterError, nearest_name

_SHORT = reprlib.Repr()  # of a list of a million entries the first ones alone
_SHORT.maxlevel = 4
_SHORT.maxlist = _SHORT.maxtuple = _SHORT.maxdict = _SHORT.maxset = _SHORT.maxfrozenset = _SHORT.maxarray = 40
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 100


def shown(value: object) -> str:
    """A value in an error message: on one line, and short."""
    try:
        text = " ".join(_SHORT.repr(value).split())
    except Exception:  # a value that cannot even say what it is
        text = f"<{type(value).__name__}>"
    return text if len(text) <= 80 else text[:77] + "..."


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


def check_able(what: str, value: object, *methods: str) -> None:
    """The value has these methods; where none is named, it can be called. None passes: it stands for a default.

    Raises:
        ParameterError: it has not.
    """
    missing = [name for name in methods if not callable(getattr(value, name, None))]
    if value is None or (callable(value) if not methods else not missing):
        return
    wanted = f"have the method{'s' if len(missing) > 1 else ''} {', '.join(missing)}" if methods else "be a function"
    raise ParameterError(f"{what} must {wanted}; it is {_told(value)}")


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
    what: str,
    value: object,
    *,
    low: float = -math.inf,
    high: float = math.inf,
    above: float = -math.inf,
    unit: str = "",
    error: type[InputError] = ParameterError,
) -> float:
    """A finite number in [low, high], and larger than ``above``; True and False are none.

    Raises:
        error: it is not; the message has the value, after its name ``what`` if it has one.
    """
    if getattr(value, "shape", None) == ():  # an array of no dimensions
        value = value[()]  # type: ignore[index]
    if not _is_finite(value) or not low <= value <= high or not value > above:
        bounds = [
            f"{sign} {bound:g}" for sign, bound in ((">", above), ("≥", low), ("≤", high)) if math.isfinite(bound)
        ]
        wanted = " ".join(["a finite number", unit and f"of {unit}", " and ".join(bounds)]).split()
        raise error(f"{what}{what and '='}{shown(value)} must be {' '.join(wanted)}")
    return float(value)


def check_array(
    what: str,
    value: object,
    shape: tuple[int | None, ...],
    *,
    limit: float = math.inf,
    error: type[InputError] = ParameterError,
) -> Array:
    """A read-only copy of an array of finite numbers.

    Args:
        what: its name, for the message.
        value: what numpy can turn into an array of numbers.
        shape: wanted; None is any length of at least one.
        limit: bound of every entry's absolute value.
        error: type of the error.

    Raises:
        error: it is none.
    """
    wanted = "(" + ", ".join("n" if n is None else str(n) for n in shape) + ("," if len(shape) == 1 else "") + ")"
    try:
        raw = np.asarray(value)
    except ValueError:
        raise error(f"{what} must be an array of shape {wanted}, not {shown(value)}") from None
    if raw.dtype.kind not in "fiu" or _holds_bool(value):
        raise error(f"{what} must hold numbers (shape {wanted}), not {shown(value)}")
    if raw.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, raw.shape, strict=True)):
        raise error(f"{what} must have the shape {wanted}, not {raw.shape}: {shown(value)}")
    if raw.size == 0:
        raise error(f"{what} is empty; at least one entry is needed")
    result = np.array(raw, dtype=np.float64)
    bad = ~(np.isfinite(result) & (np.abs(result) <= limit))
    if bad.any():
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        raise error(f"{what}{list(where)} is {result[where]:g}; it must be finite and within ±{limit:g}")
    result.flags.writeable = False
    return result


def _holds_bool(value: object) -> bool:
    """Numpy turns ``[True, 1.0]`` into floats; say whether a short sequence holds a bool."""
    if not isinstance(value, (list, tuple)):
        return False
    rows = (v if isinstance(v, (list, tuple)) else (v,) for v in value)
    return any(isinstance(entry, bool) for row in rows for entry in row)


def _is_finite(value: object) -> TypeGuard[float]:
    try:
        return isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # a whole number that no float can hold
        return False


def check_count(what: str, value: object, *, low: int = 0, high: int | None = None) -> int:
    """A whole number from ``low`` to ``high``; True and False are none.

    Raises:
        ParameterError: it is not.
    """
    number = int(value) if isinstance(value, numbers.Integral) and not isinstance(value, bool) else None
    if number is None or number < low or (high is not None and number > high):
        upto = "" if high is None else f" and ≤ {high}"
        raise ParameterError(f"{what}={shown(value)} must be a whole number ≥ {low}{upto}")
    return number


def check_numbers(owner: object, *, zero: tuple[str, ...] = ()) -> None:
    """Every number of a dataclass is finite and > 0, or ≥ 0 where it is named in ``zero``; an ``int`` is whole.

    Raises:
        ParameterError: a value that is not; the message has the value and its bound.
    """
    for f in fields(owner):  # type: ignore[arg-type]
        value, what = getattr(owner, f.name), f"{type(owner).__name__}.{f.name}"
        if f.type in ("int", int):
            check_count(what, value, low=0 if f.name in zero else 1)
        elif f.type in ("float", float):
            check_number(what, value, low=0.0, above=-math.inf if f.name in zero else 0.0)
