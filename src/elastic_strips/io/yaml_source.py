"""IO room, YAML source: reads a YAML file into nodes that know their line, so that every complaint can name it.

Only plain data is read: no tags, no aliases (so no alias bombs), no duplicate keys, one document, bounded size and
depth. Numbers are YAML 1.2's: ``1e-3`` is a number, ``yes`` a string.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import yaml

from elastic_strips.errors import InputError, SceneError
from elastic_strips.input_file import read_input_text

MAX_BYTES = 50_000_000
MAX_NODES = 2_000_000
MAX_DEPTH = 32

_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_INT = re.compile(r"[-+]?[0-9]{1,18}\Z")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\Z")
_WORDS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf", "+.Inf", "+.INF"), float("inf")),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), float("-inf")),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
}


@dataclass(frozen=True, slots=True)
class Source:
    """Where nodes come from: the file, and the type of error that complaints about it raise."""

    path: Path
    error: type[InputError] = SceneError

    def fail(self, message: str, line: int | None = None) -> NoReturn:
        """Raise the source's error: ``file:line: message``."""
        message = message if len(message) <= 800 else message[:797] + "..."
        where = f"{self.path}" if line is None else f"{self.path}:{line}"
        problem = self.error(f"{where}: {message}")
        problem.__dict__["located"] = True
        raise problem


@dataclass(slots=True)
class Node:
    """A value of a YAML file: a scalar, a list of nodes or a dict of nodes by key.

    Attributes:
        value: None, bool, int, float, str, list[Node] or dict[str, Node].
        line: Line in the file, from 1; of a dict's entry the line of its key.
        key: Path of keys that leads to the value, such as ``obstacles[2].size``; empty for the whole document.
        source: The file.
    """

    value: Any
    line: int
    key: str
    source: Source = field(repr=False)

    def fail(self, message: str) -> NoReturn:
        """Raise the source's error: ``file:line: key: message``."""
        self.source.fail(f"{self.key}: {message}" if self.key else message, self.line)


def load_yaml(path: str | os.PathLike[str], *, error: type[InputError] = SceneError) -> Node:
    """Read one YAML file.

    Args:
        path: The file.
        error: Type of the error that is raised about the file or its content.

    Returns:
        The root node.
    """
    source = Source(Path(path), error)
    return parse_yaml(read_input_text(source.path, "YAML file", MAX_BYTES, error), source)


def parse_yaml(text: str, source: Source) -> Node:
    """Parse YAML ``text`` that came from ``source``."""
    try:
        return _tree(yaml.parse(text, Loader=_LOADER), source)
    except yaml.MarkedYAMLError as problem:
        mark = problem.problem_mark or problem.context_mark
        said = ", ".join(s for s in (problem.context, problem.problem) if s)
        source.fail(f"not valid YAML: {said}", None if mark is None else mark.line + 1)
    except yaml.YAMLError as problem:  # characters that YAML forbids
        source.fail(f"not valid YAML: {' '.join(str(problem).split())}")


@dataclass(slots=True)
class _Open:
    """A list or dict that is being read."""

    node: Node
    pending: tuple[str, int] | None = None  # key and line of the dict's entry whose value comes next


def _tree(events: Any, source: Source) -> Node:
    """Build the nodes from the event stream; no recursion, so no depth of nesting can hurt."""
    stack: list[_Open] = []
    root: Node | None = None
    count = 0
    for event in events:
        if isinstance(event, (yaml.SequenceEndEvent, yaml.MappingEndEvent)):
            stack.pop()
            continue
        if isinstance(event, yaml.DocumentStartEvent) and root is not None:
            source.fail("a second document begins here; one is allowed", event.start_mark.line + 1)
        if not isinstance(event, yaml.NodeEvent):
            continue
        line = event.start_mark.line + 1
        count += 1
        if count > MAX_NODES:
            source.fail(f"the file holds more than {MAX_NODES} values", line)
        if isinstance(event, yaml.AliasEvent):
            source.fail(f"alias *{event.anchor}: aliases are not allowed; write the value out", line)
        tag = getattr(event, "tag", None)
        if tag is not None:
            source.fail(f"tag {tag}: tags are not allowed", line)
        top = stack[-1] if stack else None
        if top is not None and isinstance(top.node.value, dict) and top.pending is None:
            top.pending = _key(event, top.node, source, line)
            continue
        node = Node(None, line, "", source)
        if top is None:
            root = node
        elif isinstance(top.node.value, list):
            node.key = f"{top.node.key}[{len(top.node.value)}]"
            top.node.value.append(node)
        else:
            assert top.pending is not None
            key, node.line = top.pending
            node.key = f"{top.node.key}.{key}" if top.node.key else key
            top.node.value[key] = node
            top.pending = None
        if isinstance(event, yaml.ScalarEvent):
            node.value = _scalar(event.value) if event.implicit[0] else event.value
            continue
        node.value = [] if isinstance(event, yaml.SequenceStartEvent) else {}
        stack.append(_Open(node))
        if len(stack) > MAX_DEPTH:
            source.fail(f"the values are nested more than {MAX_DEPTH} deep", line)
    if root is None:
        source.fail("the file is empty")
    return root


def _key(event: Any, owner: Node, source: Source, line: int) -> tuple[str, int]:
    if not isinstance(event, yaml.ScalarEvent):
        source.fail("a key must be a word, not a list or a mapping", line)
    key = event.value
    if key in owner.value:
        source.fail(f"key {key!r} is given twice (first in line {owner.value[key].line})", line)
    return key, line


def _scalar(text: str) -> Any:
    """Value of a plain (unquoted) scalar."""
    if text in _WORDS:
        return _WORDS[text]
    if _INT.match(text):
        return int(text)
    if _FLOAT.match(text):
        return float(text)
    return text
