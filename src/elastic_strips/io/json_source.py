"""IO room, JSON source: a document with its path, whose entries are read with checks that name file and place."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from elastic_strips.errors import ScenarioError, SceneError
from elastic_strips.input_file import read_input_text
from elastic_strips.scene import checks

MAX_BYTES = 20_000_000


@dataclass(frozen=True, slots=True)
class Entry:
    """A value of a JSON document: ``place`` says where in ``path`` it stands, for messages."""

    path: Path
    place: str
    value: Any

    def fail(self, message: str) -> NoReturn:
        """Raise a `ScenarioError` that names file and place."""
        where = f"{self.path}: {self.place}: " if self.place else f"{self.path}: "
        raise ScenarioError(where + message)

    def __getitem__(self, key: str) -> Entry:
        """The entry of that key."""
        if not isinstance(self.value, dict):
            self.fail(f"must be an object, not {checks.shown(self.value)}")
        if key not in self.value:
            self.fail(f"the key {key!r} is missing; there are {', '.join(sorted(self.value)[:20]) or 'none'}")
        return Entry(self.path, f"{self.place}.{key}" if self.place else key, self.value[key])

    def __contains__(self, key: object) -> bool:
        return isinstance(self.value, dict) and key in self.value

    def __iter__(self) -> Iterator[Entry]:
        """The entries of a list."""
        if not isinstance(self.value, list):
            self.fail(f"must be a list, not {checks.shown(self.value)}")
        return (Entry(self.path, f"{self.place}[{k}]", value) for k, value in enumerate(self.value))

    def number(self, *, low: float = -1e6, high: float = 1e6, unit: str = "m") -> float:
        """A finite number in [low, high]."""
        try:
            return checks.number("the value", self.value, low=low, high=high, unit=unit)
        except SceneError as error:
            self.fail(str(error))

    def integer(self) -> int:
        """An integer."""
        if isinstance(self.value, bool) or not isinstance(self.value, int):
            self.fail(f"must be an integer, not {checks.shown(self.value)}")
        return self.value

    def text(self) -> str:
        """A non-empty string."""
        if not isinstance(self.value, str) or not self.value.strip():
            self.fail(f"must be a non-empty string, not {checks.shown(self.value)}")
        return self.value

    def array(self, *shape: int | None) -> NDArray[np.float64]:
        """A finite array of that shape; None is any length of at least one."""
        try:
            return checks.array("the value", self.value, shape)
        except SceneError as error:
            self.fail(str(error))


def read_json(path: str | os.PathLike[str], name: str) -> Entry:
    """Read a JSON file.

    Args:
        path: The file, or the folder that holds a file called ``name``.
        name: See ``path``.

    Raises:
        ScenarioError: The file is missing, cannot be read, or is no JSON.
    """
    file = Path(path)
    if os.path.isdir(file):
        file = file / name
    text = read_input_text(file, "JSON file", MAX_BYTES, ScenarioError)
    try:
        return Entry(file, "", json.loads(text))
    except (ValueError, RecursionError) as error:
        raise ScenarioError(f"{file}: is not JSON: {error}") from None


def entry_of_id(entries: Entry, number: int) -> Entry:
    """The object in a list whose ``id`` is ``number``.

    Raises:
        ScenarioError: None has that id; the message says which there are.
    """
    if isinstance(number, bool) or not isinstance(number, (int, np.integer)):
        raise ScenarioError(f"{entries.path}: id={checks.shown(number)} must be an integer")
    known = [(entry["id"].integer(), entry) for entry in entries]
    for one, entry in known:
        if one == number:
            return entry
    if not known:
        entries.fail("holds no world")
    ids = sorted(one for one, _ in known)
    below, above = [i for i in ids if i < number][-2:], [i for i in ids if i > number][:2]
    near = ", ".join(map(str, below + above))
    entries.fail(
        f"there is no world {number}; {len(ids)} worlds have ids from {ids[0]} to {ids[-1]}, next to it {near}"
    )
