"""Summaries of values: one short line in a terminal, a compact table in a notebook; never the arrays themselves."""

from __future__ import annotations

import html
from collections.abc import Mapping
from dataclasses import fields

_LINE_LENGTH, _VALUE_LENGTH = 240, 60  # characters


class Summary:
    """Base of values that are too large to be written out. A subclass that is a dataclass has ``repr=False``."""

    __slots__ = ()

    def _summary(self) -> Mapping[str, object]:
        """Values of the summary by name: the fields of the dataclass unless a subclass returns others."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.repr}  # type: ignore[arg-type]

    def _measured(self) -> Mapping[str, object]:
        """Further rows of a table, which take time to find out."""
        return {}

    def __repr__(self) -> str:
        text = ", ".join(f"{name}={_brief(value)}" for name, value in self._summary().items())
        return f"{type(self).__name__}({shortened(text)})"

    def _repr_html_(self) -> str:
        rows = {**self._summary(), **self._measured()}
        return table(type(self).__name__, {name: _brief(v, 4 * _VALUE_LENGTH) for name, v in rows.items()})


def table(title: str, rows: Mapping[str, str]) -> str:
    """A table with a headline: name and value in each row, all of it escaped."""
    cells = "".join(
        f'<tr><th style="text-align:left">{html.escape(name.replace("_", " "))}</th>'
        f'<td style="text-align:left">{html.escape(value)}</td></tr>'
        for name, value in rows.items()
    )
    return f"<table><caption><b>{html.escape(title)}</b></caption><tbody>{cells}</tbody></table>"


def _brief(value: object, most: int = _VALUE_LENGTH) -> str:
    if getattr(value, "ndim", 0):  # an array
        return f"<{' × '.join(map(str, getattr(value, 'shape', ())))} numbers>"
    if isinstance(value, str):
        return shortened(str.__str__(getattr(value, "value", value)), most)
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (Mapping, tuple, list, set, frozenset)) and len(value) > 8:
        return f"<{len(value)} entries>"
    return shortened(" ".join(repr(value).split()), most)


def shortened(text: str, most: int = _LINE_LENGTH) -> str:
    """A text shortened to a number of characters."""
    return text if len(text) <= most else text[: most - 1] + "…"
