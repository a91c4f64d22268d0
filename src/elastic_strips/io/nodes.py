"""IO room, nodes: the values of an input document (YAML or JSON) with their places, and typed access to them.

Of YAML only plain data is read: no tags, no aliases (so no alias bombs), no duplicate keys, one document, bounded size
and depth. Numbers are YAML 1.2's: ``1e-3`` is a number, ``yes`` a string.

Values that do not fit are refused with file, line (of YAML), key, value and bound.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn, TypeVar

import numpy as np
import yaml

from elastic_strips.arrays import Array
from elastic_strips.errors import InputError, ScenarioError, SceneError, nearest_name
from elastic_strips.files import read_input_text
from elastic_strips.validation import MAX_LENGTH, check_number, shown

MAX_YAML_BYTES = 50_000_000
MAX_JSON_BYTES = 20_000_000
MAX_NODES = 2_000_000
MAX_DEPTH = 32
_TOO_DEEP = f"the values are nested more than {MAX_DEPTH} deep"

T = TypeVar("T")
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_INT = re.compile(r"[-+]?[0-9]{1,18}\Z")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\Z")
_TAB = re.compile(r" *\t")
_WORDS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf", "+.Inf", "+.INF"), float("inf")),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), float("-inf")),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
}
_KINDS = {dict: "a mapping", list: "a list", str: "a string", bool: "true or false", int: "a number", float: "a number"}


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """Where nodes come from.

    Attributes:
        path: The file.
        error: Type of the errors about it.
        lines: Path of keys → line of the file, from 1; of a mapping's entry the line of its key. Empty for JSON.
    """

    path: Path
    error: type[InputError] = SceneError
    lines: dict[str, int] = field(default_factory=dict, repr=False)

    def fail(self, message: str, line: int | None = None) -> NoReturn:
        """Raise the source's error: ``file:line: message``."""
        message = message if len(message) <= 800 else message[:797] + "..."
        where = f"{self.path}" if line is None else f"{self.path}:{line}"
        problem = self.error(f"{where}: {message}")
        problem.__dict__["located"] = True
        raise problem


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """A value of an input document.

    Attributes:
        value: Plain data: None, bool, int, float, str, and lists and dicts of these.
        key: Path of keys that leads to the value, such as ``obstacles[2].size``; empty for the whole document.
        source: Where it comes from.
    """

    value: object
    key: str
    source: Source = field(repr=False)

    @property
    def line(self) -> int | None:
        """Line in the file, from 1; None where lines are not known."""
        return self.source.lines.get(self.key)

    @property
    def kind(self) -> str:
        """The node's value for messages, such as ``'abc' (a string)``."""
        if self.value is None:
            return "nothing"
        name = _KINDS[type(self.value)]
        return (
            f"{name} of {len(self.value)}" if isinstance(self.value, (dict, list)) else f"{shown(self.value)} ({name})"
        )

    def fail(self, message: str) -> NoReturn:
        """Raise the source's error: ``file:line: key: message``."""
        self.source.fail(f"{self.key}: {message}" if self.key else message, self.line)

    def checked(self, make: Callable[..., T], *args: object, **kwargs: object) -> T:
        """Call ``make``; an `InputError` without a place is raised again with the node's file, line and key."""
        try:
            return make(*args, **kwargs)
        except InputError as problem:
            if "located" in problem.__dict__:
                raise
            self.fail(str(problem))

    def __getitem__(self, key: str) -> Node:
        """The entry of that key, which must be there."""
        entries = self.mapping()
        if key not in entries:
            self.fail(f"the key {key!r} is missing; there are {', '.join(sorted(entries)[:20]) or 'none'}")
        return entries[key]

    def __iter__(self) -> Iterator[Node]:
        """The entries of a list."""
        return iter(self.items())

    def mapping(
        self, valid: Iterable[str] | None = None, *, needed: Iterable[str] = (), what: str = ""
    ) -> dict[str, Node]:
        """Entries of a mapping.

        Args:
            valid: The keys that it may have; None: any.
            needed: The keys that it must have.
            what: What the mapping describes, for messages.
        """
        of = f" of {what}" if what else ""
        if not isinstance(self.value, dict):
            self.fail(f"must be a mapping{of}, not {self.kind}")
        prefix = f"{self.key}." if self.key else ""
        entries = {key: Node(value, f"{prefix}{key}", self.source) for key, value in self.value.items()}
        if valid is not None:
            valid = tuple(valid)
            for key, entry in entries.items():
                if key not in valid:
                    where = entry.key if len(entry.key) <= 80 else entry.key[:77] + "..."
                    message = f"{where}: unknown key {shown(key)}{of}{nearest_name(key, valid)}"
                    self.source.fail(message, entry.line)
        for key in needed:
            if key not in entries or entries[key].value is None:
                self.fail(f"the key {key!r} is missing{of}")
        return entries

    def items(self) -> list[Node]:
        """Entries of a list."""
        if not isinstance(self.value, list):
            self.fail(f"must be a list, not {self.kind}")
        return [Node(value, f"{self.key}[{k}]", self.source) for k, value in enumerate(self.value)]

    def text(self, *, valid: Iterable[str] | None = None) -> str:
        """A non-empty string, one of ``valid`` if that is given."""
        if not isinstance(self.value, str) or not self.value.strip():
            self.fail(f"must be a non-empty string, not {self.kind}; quote it if it looks like a number")
        if valid is not None and self.value not in (choices := tuple(valid)):
            self.fail(f"unknown value {shown(self.value)}{nearest_name(self.value, choices)}")
        return self.value

    def boolean(self) -> bool:
        """True or false."""
        if not isinstance(self.value, bool):
            self.fail(f"must be true or false, not {self.kind}")
        return self.value

    def number(self, *, low: float = -MAX_LENGTH, high: float = MAX_LENGTH, unit: str = "m") -> float:
        """A finite number in [low, high]."""
        if not _is_number(self.value):
            self.fail(f"must be a number, not {self.kind}")
        return self.checked(check_number, "", self.value, low=low, high=high, unit=unit)

    def finite(self) -> float:
        """A finite number, without a unit."""
        return self.number(low=-math.inf, high=math.inf, unit="")

    def integer(self, *, low: int = -(2**53), high: int = 2**53) -> int:
        """An integer in [low, high]."""
        if isinstance(self.value, bool) or not isinstance(self.value, int):
            self.fail(f"must be an integer, not {self.kind}")
        if not low <= self.value <= high:
            self.fail(f"is {self.value}, outside [{low}, {high}]")
        return self.value

    def vector(self, count: int | None = None, *, limit: float = 1e12) -> Array:
        """A list of ``count`` numbers (None: at least one) within ±``limit``, as an array (n,)."""
        if not isinstance(self.value, list) or (len(self.value) != count if count is not None else not self.value):
            wanted = "at least one number" if count is None else f"{count} numbers"
            self.fail(f"must be a list of {wanted}, not {self.kind}")
        return np.array([entry.number(low=-limit, high=limit, unit="") for entry in self.items()])

    def rows(self, count: int, *, limit: float = math.inf) -> Array:
        """A non-empty list of lists of ``count`` finite numbers within ±``limit``, as an array (n, count)."""
        if not isinstance(self.value, list):
            self.fail(f"must be a list of lists of {count} numbers, not {self.kind}")
        if not self.value:
            self.fail(f"is empty; at least one list of {count} numbers is needed")
        for k, row in enumerate(self.value):
            if not isinstance(row, list) or len(row) != count or not all(map(_is_number, row)):
                self.items()[k].vector(count)  # which raises the error
        try:
            result = np.array(self.value, dtype=np.float64)
        except OverflowError:  # an integer that no float can hold
            result = np.full((len(self.value), count), np.nan)
        if not (np.isfinite(result) & (np.abs(result) <= limit)).all():
            for row in self.items():
                row.vector(count, limit=limit)
        return result


def load_yaml(path: str | os.PathLike[str], *, error: type[InputError] = SceneError) -> Node:
    """Read one YAML file.

    Args:
        path: The file.
        error: Type of the error that is raised about the file or its content.

    Returns:
        The root node.
    """
    source = Source(Path(path), error)
    return parse_yaml(read_input_text(source.path, "YAML file", MAX_YAML_BYTES, error), source)


def load_json(
    path: str | os.PathLike[str], name: str = "", *, what: str = "JSON file", error: type[InputError] = ScenarioError
) -> Node:
    """Read one JSON file.

    Args:
        path: The file, or the folder that holds a file called ``name``.
        name: See ``path``.
        what: Name of the file in messages.
        error: Type of the error that is raised about the file or its content.

    Returns:
        The root node; its lines are not known.
    """
    source = Source(Path(path, name) if os.path.isdir(path) else Path(path), error)
    text = read_input_text(source.path, what, MAX_JSON_BYTES, error)
    try:
        return Node(json.loads(text, object_pairs_hook=_unique), "", source)
    except (ValueError, RecursionError) as problem:
        source.fail(f"is not JSON: {problem}")


def _unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """A mapping of JSON, whose keys have to differ."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"the key {shown(next(key for key in keys if keys.count(key) > 1))} is given twice")
    return found


def parse_yaml(text: str, source: Source) -> Node:
    """Parse YAML ``text`` that came from ``source``."""
    try:
        return Node(_data(yaml.parse(text, Loader=_LOADER), source), "", source)
    except yaml.MarkedYAMLError as problem:
        mark = problem.problem_mark or problem.context_mark
        line = None if mark is None else mark.line + 1
        if "nesting depth" in str(problem.problem):  # the parser reads ahead, and newer ones have a bound of their own
            source.fail(_TOO_DEEP, line)
        if line is not None and any(map(_TAB.match, text.splitlines()[line - 1 : line])):
            source.fail("not valid YAML: a tab; use spaces to indent", line)
        said = ", ".join(s for s in (problem.context, problem.problem) if s)
        source.fail(f"not valid YAML: {said}", line)
    except yaml.YAMLError as problem:  # characters that YAML forbids
        source.fail(f"not valid YAML: {' '.join(str(problem).split())}")


@dataclass(slots=True)
class _Collection:
    """A list or dict that is being read."""

    value: list[object] | dict[str, object]
    key: str
    pending: tuple[str, int] | None = None  # key and line of the dict's entry whose value comes next

    def take(self, value: object, line: int) -> tuple[str, int]:
        """Add the next value, which begins in a line; its key, and the line where that begins."""
        if isinstance(self.value, list):
            key = f"{self.key}[{len(self.value)}]"
            self.value.append(value)
            return key, line
        assert self.pending is not None
        name, line = self.pending
        self.value[name], self.pending = value, None
        return f"{self.key}.{name}" if self.key else name, line


def _data(events: Iterable[object], source: Source) -> object:
    """Build the data from the event stream, and the source's lines; no recursion, so no depth of nesting can hurt."""
    stack: list[_Collection] = []
    root: list[object] = []
    count = 0
    for event in events:
        if isinstance(event, (yaml.SequenceEndEvent, yaml.MappingEndEvent)):
            stack.pop()
            continue
        if isinstance(event, yaml.DocumentStartEvent) and root:
            source.fail("a second document begins here; one is allowed", event.start_mark.line + 1)
        if not isinstance(event, yaml.NodeEvent):
            continue
        line = event.start_mark.line + 1
        count += 1
        if count > MAX_NODES:
            source.fail(f"the file holds more than {MAX_NODES} values", line)
        _refuse_references(event, source, line)
        top = stack[-1] if stack else None
        if top is not None and isinstance(top.value, dict) and top.pending is None:
            top.pending = _key(event, top, source, line)
            continue
        if isinstance(event, yaml.ScalarEvent):
            value = _scalar(event.value) if event.implicit[0] else event.value
        else:
            value = [] if isinstance(event, yaml.SequenceStartEvent) else {}
        if top is None:
            key = ""
            root.append(value)
        else:
            key, line = top.take(value, line)
        source.lines[key] = line
        if isinstance(value, (list, dict)):
            stack.append(_Collection(value, key))
            if len(stack) > MAX_DEPTH:
                source.fail(_TOO_DEEP, event.start_mark.line + 1)
    if not root:
        source.fail("the file is empty")
    return root[0]


def _refuse_references(event: yaml.NodeEvent, source: Source, line: int) -> None:
    """Aliases and tags make more of a document than what is written in it."""
    if isinstance(event, yaml.AliasEvent):
        source.fail(f"alias *{event.anchor}: aliases are not allowed; write the value out", line)
    tag = getattr(event, "tag", None)
    if tag is not None:
        source.fail(f"tag {tag}: tags are not allowed", line)


def _key(event: yaml.NodeEvent, owner: _Collection, source: Source, line: int) -> tuple[str, int]:
    if not isinstance(event, yaml.ScalarEvent):
        source.fail("a key must be a word, not a list or a mapping", line)
    key = event.value
    if key in owner.value:
        first = source.lines[f"{owner.key}.{key}" if owner.key else key]
        source.fail(f"key {key!r} is given twice (first in line {first})", line)
    return key, line


def _scalar(text: str) -> object:
    """Value of a plain (unquoted) scalar."""
    if text in _WORDS:
        return _WORDS[text]
    if _INT.match(text):
        return int(text)
    if _FLOAT.match(text):
        return float(text)
    return text


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
