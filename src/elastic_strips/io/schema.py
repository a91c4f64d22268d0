"""IO room, schema: typed access to YAML nodes; what does not fit is refused with file, line, key, value and bound."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from elastic_strips.errors import InputError, nearest_name
from elastic_strips.io.yaml_source import Node
from elastic_strips.scene import checks

T = TypeVar("T")
_KINDS = {dict: "a mapping", list: "a list", str: "a string", bool: "true or false", int: "a number", float: "a number"}


def kind(node: Node) -> str:
    """What a node holds, for messages, such as ``the string 'abc'``."""
    value = node.value
    if value is None:
        return "nothing"
    if isinstance(value, (dict, list)):
        return f"{_KINDS[type(value)]} of {len(value)}"
    return f"{checks.shown(value)} ({_KINDS[type(value)]})"


def mapping(node: Node, valid: Iterable[str], *, needed: Iterable[str] = (), what: str = "") -> dict[str, Node]:
    """Entries of a mapping whose keys all are ``valid`` and hold all ``needed`` ones."""
    if not isinstance(node.value, dict):
        node.fail(f"must be a mapping{_of(what)}, not {kind(node)}")
    valid = tuple(valid)
    for key, entry in node.value.items():
        if key not in valid:
            where = f"{node.key}.{key}" if node.key else key
            where = where if len(where) <= 80 else where[:77] + "..."
            node.source.fail(
                f"{where}: unknown key {checks.shown(key)}{_of(what)}{nearest_name(key, valid)}", entry.line
            )
    for key in needed:
        if key not in node.value or node.value[key].value is None:
            node.fail(f"the key {key!r} is missing{_of(what)}")
    return node.value


def items(node: Node) -> list[Node]:
    """Entries of a list."""
    if not isinstance(node.value, list):
        node.fail(f"must be a list, not {kind(node)}")
    return node.value


def string(node: Node, *, valid: Iterable[str] | None = None) -> str:
    """A non-empty string, one of ``valid`` if that is given."""
    if not isinstance(node.value, str) or not node.value.strip():
        node.fail(f"must be a non-empty string, not {kind(node)}; quote it if it looks like a number")
    if valid is not None:
        choices = tuple(valid)
        if node.value not in choices:
            node.fail(f"unknown value {checks.shown(node.value)}{nearest_name(node.value, choices)}")
    return node.value


def boolean(node: Node) -> bool:
    """True or false."""
    if not isinstance(node.value, bool):
        node.fail(f"must be true or false, not {kind(node)}")
    return node.value


def number(node: Node, *, low: float = -1e6, high: float = 1e6, unit: str = "m") -> float:
    """A finite number in [low, high]."""
    _numeric(node)
    return checked(node, lambda v: checks.number("the value", v, low=low, high=high, unit=unit), node.value)


def integer(node: Node, *, low: int, high: int) -> int:
    """An integer in [low, high]."""
    if isinstance(node.value, bool) or not isinstance(node.value, int):
        node.fail(f"must be an integer, not {kind(node)}")
    if not low <= node.value <= high:
        node.fail(f"is {node.value}, outside [{low}, {high}]")
    return node.value


def vector(node: Node, count: int | None) -> NDArray[np.float64]:
    """A list of ``count`` finite numbers (None: at least one)."""
    entries = items(node)
    if (count is None and not entries) or (count is not None and len(entries) != count):
        node.fail(
            f"must be a list of {'at least one number' if count is None else f'{count} numbers'}, not {kind(node)}"
        )
    return np.array([number(entry, low=-1e12, high=1e12, unit="") for entry in entries])


def rows(node: Node, count: int) -> NDArray[np.float64]:
    """A non-empty list of lists of ``count`` finite numbers, as an array (n, count)."""
    entries = items(node)
    if not entries:
        node.fail(f"is empty; at least one list of {count} numbers is needed")
    flat = []
    for entry in entries:
        cells = entry.value
        if not isinstance(cells, list) or len(cells) != count:
            entry.fail(f"must be a list of {count} numbers, not {kind(entry)}")
        for cell in cells:
            if type(cell.value) not in (int, float):
                _numeric(cell)
            flat.append(cell.value)
    try:
        result = np.array(flat, dtype=np.float64).reshape(-1, count)
    except OverflowError:
        result = np.full((len(entries), count), np.inf)
    bad = np.argwhere(~np.isfinite(result))
    if len(bad):
        i, j = bad[0]
        entries[i].value[j].fail(f"must be finite, not {kind(entries[i].value[j])}")
    return result


def checked(node: Node, make: Callable[..., T], *args: Any, **kwargs: Any) -> T:
    """Call ``make``; an `InputError` without a place is raised again with the node's file, line and key."""
    try:
        return make(*args, **kwargs)
    except InputError as problem:
        if "located" in problem.__dict__:
            raise
        node.fail(str(problem))


def _numeric(node: Node) -> None:
    if isinstance(node.value, bool) or not isinstance(node.value, (int, float)):
        node.fail(f"must be a number, not {kind(node)}")


def _of(what: str) -> str:
    return f" of {what}" if what else ""
