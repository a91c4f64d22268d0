"""Checks of arguments: types and numbers. The messages name the value, its bound, and what is wanted."""

from __future__ import annotations

import inspect
import math
import numbers
import reprlib
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields, is_dataclass
from functools import cache, partial, wraps
from types import FunctionType, NoneType, UnionType
from typing import Annotated, Literal, TypeGuard, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import InputError, ParameterError, nearest_name

MAX_LENGTH = 1e6
"""Largest size or coordinate that is accepted [m]."""

MIN_LENGTH = 1e-6
"""Smallest size that is accepted [m], but for 0 where that means something; distances are accurate to about 3e-6 m."""

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


_Called = TypeVar("_Called", bound=Callable[..., object])


def named_arguments(called: _Called) -> _Called:
    """A function, or a class, that answers to a keyword which it does not have with the one that may have been meant.

    Its signature, its documentation and its type stay as they are. A call takes 0.2 µs longer. One that passes on what
    else it is given is left as it is.

    Raises:
        ParameterError: by the function, at a keyword that it does not have.
    """
    if isinstance(called, type):
        setattr(called, "__init__", named_arguments(called.__init__))  # noqa: B010 (pyright takes no plain assignment)
        return cast("_Called", called)
    parameters = inspect.signature(called).parameters.values()
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return called
    valid = frozenset(p.name for p in parameters if p.kind is not p.POSITIONAL_ONLY)
    function = cast("FunctionType", called)

    @wraps(function)
    def checked(*args: object, **named: object) -> object:
        if not named.keys() <= valid:
            what = type(args[0]).__name__ if function.__name__ == "__init__" else function.__name__
            name = next(name for name in named if name not in valid)
            raise ParameterError(f"{what}() has no argument {name!r}{nearest_name(name, valid - {'self'})}")
        return function(*args, **named)

    return cast("_Called", checked)


def check_type(
    what: str, value: object, kind: type, error: type[InputError] = ParameterError, *, none: bool = False
) -> None:
    """Check that the value is of this kind, or None where ``none`` allows it.

    Raises:
        error: it is of another kind; the message says which.
    """
    if isinstance(value, kind) or (none and value is None):
        return
    article = "an" if kind.__name__[0] in "AEIOU" else "a"
    raise error(f"{what} must be {article} {kind.__name__}{' or None' if none else ''}, not {_told(value)}")


def check_able(what: str, value: object, *methods: str) -> None:
    """Check that the value has these methods, or can be called if none is named. None passes: it stands for a default.

    Raises:
        ParameterError: it does not have them.
    """
    missing = [name for name in methods if not callable(getattr(value, name, None))]
    if value is None or (callable(value) if not methods else not missing):
        return
    wanted = f"have the method{'s' if len(missing) > 1 else ''} {', '.join(missing)}" if methods else "be a function"
    raise ParameterError(f"{what} must {wanted}; it is {_told(value)}")


def check_choice(what: str, value: object, valid: Iterable[str], error: type[InputError] = ParameterError) -> None:
    """Check that the value is one of the names.

    Raises:
        error: it is not; the message has the names.
    """
    names = tuple(valid)
    if not isinstance(value, str) or value not in names:
        raise error(f"{what}={shown(value)} is unknown{nearest_name(shown(value), names)}")


def _told(value: object) -> str:
    """A value's type and text, for callers who passed something else than they thought."""
    return "None" if value is None else f"{type(value).__name__}: {shown(value)}"


def check_number(
    what: str,
    value: object,
    *,
    low: float = -math.inf,
    high: float = math.inf,
    above: float = -math.inf,
    below: float = math.inf,
    unit: str = "",
    infinite: bool = False,
    error: type[InputError] = ParameterError,
) -> float:
    """A finite number in [low, high], larger than ``above`` and smaller than ``below``; True and False are not numbers.

    Args:
        what: its name, for the message; may be empty.
        value: what to check.
        low, high, above, below: bounds.
        unit: unit for the message.
        infinite: whether inf passes, too.
        error: type of the error.

    Raises:
        error: it is not; the message has name, value and bounds.
    """
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if infinite and isinstance(value, numbers.Real) and value == math.inf:
        return math.inf
    if not _is_finite(value) or not low <= value <= high or not above < value < below:
        signs = ((">", above), ("≥", low), ("<", below), ("≤", high))
        bounds = " and ".join(f"{sign} {bound:g}" for sign, bound in signs if math.isfinite(bound))
        wanted = " ".join(f"a finite number {unit and f'of {unit}'} {bounds} {'or inf' if infinite else ''}".split())
        raise error(f"{what}{what and '='}{shown(value)} must be {wanted}")
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
        value: something that numpy can turn into an array of numbers.
        shape: the wanted shape; None is any length of at least one.
        limit: bound of every entry's absolute value.
        error: type of the error.

    Raises:
        error: it is not one.
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
        # float by itself: an instance of it is told much faster than one of an abstract class
        return isinstance(value, (float, numbers.Real)) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # a whole number that no float can hold
        return False


def check_count(what: str, value: object, *, low: int = 0, high: int | None = None) -> int:
    """A whole number from ``low`` to ``high``; True and False are not numbers.

    Raises:
        ParameterError: it is not.
    """
    number = int(value) if isinstance(value, (int, numbers.Integral)) and not isinstance(value, bool) else None
    if number is None or number < low or (high is not None and number > high):
        upto = "" if high is None else f" and ≤ {high}"
        raise ParameterError(f"{what}={shown(value)} must be a whole number ≥ {low}{upto}")
    return number


@dataclass(frozen=True, slots=True, kw_only=True)
class Bound:
    """Bounds of a number of a dataclass, given in its annotation: ``Annotated[float, Bound(low=1.0, unit="m")]``.

    Attributes:
        low, high: least and largest value.
        above, below: bounds that are not themselves allowed.
        unit: unit for the message.
        infinite: whether inf is a value, too.
    """

    low: float = -math.inf
    high: float = math.inf
    above: float = -math.inf
    below: float = math.inf
    unit: str = ""
    infinite: bool = False


Finite = Annotated[float, Bound()]
Positive = Annotated[float, Bound(above=0.0)]
NonNegative = Annotated[float, Bound(low=0.0)]
Fraction = Annotated[float, Bound(low=0.0, high=1.0)]
Count = Annotated[int, Bound(low=1)]
Whole = Annotated[int, Bound(low=0)]  # a count that may be 0

_Rule = Callable[[str, object], object]


def check_fields(owner: object, what: str = "") -> None:
    """Check that every field of a dataclass is what its annotation says; called by ``__post_init__``.

    Every number says its `Bound`: a plain ``float`` or ``int`` is a `TypeError` of whoever wrote the class. An ``int``
    is whole, a ``Literal`` one of its names, a ``str`` not blank; values of ``bool`` and of dataclasses are of that
    type; ``X | None`` may be None; ``tuple[X, ...]`` has one entry at least. Fields of other types are not checked.

    Args:
        owner: the dataclass' instance.
        what: its name in messages; that of its class if there is none.

    Raises:
        ParameterError: a value does not fit; the message names class, field, value and bound.
    """
    what = what or type(owner).__name__
    for name, rule in _rules(type(owner)):
        rule(f"{what}.{name}", getattr(owner, name))


_Kind = TypeVar("_Kind", bound="Checked")


class Checked:
    """Base of parameters: a dataclass whose fields are checked when it is made, see :func:`check_fields`."""

    __slots__ = ()

    def __new__(cls: type[_Kind], *_: object, **named: object) -> _Kind:
        """Refuse what is no field, with the name that may have been meant.

        Raises:
            ParameterError: an unknown name.
        """
        valid = [f.name for f in fields(cls) if f.init]  # type: ignore[arg-type]
        for name in named:
            if name not in valid:
                raise ParameterError(f"{cls.__name__} has no parameter {name!r}{nearest_name(name, valid)}")
        return object.__new__(cls)

    def __post_init__(self) -> None:
        check_fields(self)


@cache
def _rules(kind: type) -> tuple[tuple[str, _Rule], ...]:
    """Names of a dataclass' fields that are checked, and how."""
    rules = ((name, _rule(hint)) for name, hint in get_type_hints(kind, include_extras=True).items())
    return tuple((name, rule) for name, rule in rules if rule is not None)


def _rule(hint: object, none: bool = False) -> _Rule | None:
    """How a value of an annotated type is checked; ``none``: it may be None. None where nothing is said about it."""
    origin, args = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        given = [arg for arg in args if arg is not NoneType]
        return _rule(given[0], none=True) if len(given) == 1 else None
    if hint in (float, int):
        raise TypeError(f"a number that check_fields checks has to say its Bound; {hint} says none")
    rule: _Rule | None = None
    if origin is Annotated and isinstance(args[1], Bound):
        bound, top = args[1], args[1].high
        if args[0] is float:
            rule = partial(check_number, **asdict(bound))
        else:
            rule = partial(check_count, low=int(max(0.0, bound.low)), high=None if top == math.inf else int(top))
    elif origin is Literal:
        rule = partial(check_choice, valid=args)
    elif origin is tuple and args[1:] == (...,):
        entry = _rule(args[0])
        rule = None if entry is None else partial(_check_entries, entry)
    elif hint is str:
        rule = _check_text
    elif hint is bool:
        rule = _check_bool
    elif isinstance(hint, type) and is_dataclass(hint):
        return partial(check_type, kind=hint, none=none)
    return partial(_unless_none, rule) if none and rule is not None else rule


def _check_bool(what: str, value: object) -> None:
    if not isinstance(value, bool):
        raise ParameterError(f"{what}={shown(value)} must be True or False")


def _check_text(what: str, value: object) -> None:
    if not isinstance(value, str) or not value.strip():
        raise ParameterError(f"{what}={shown(value)} must be a text that is not blank")


def _check_entries(rule: _Rule, what: str, value: object) -> None:
    if not isinstance(value, tuple) or not value:
        raise ParameterError(f"{what}={shown(value)} must be a tuple of one entry at least")
    for k, entry in enumerate(value):
        rule(f"{what}[{k}]", entry)


def _unless_none(rule: _Rule, what: str, value: object) -> None:
    if value is not None:
        rule(what, value)
