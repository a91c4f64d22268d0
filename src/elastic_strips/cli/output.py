"""Output of commands: plain text; on a capable terminal, colour and tables; and JSON, which with ``--json -`` is alone
on standard output."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TextIO, TypeAlias

import click

from elastic_strips.files import json_text, write_json

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

# rich is imported where it is used: elsewhere than on a terminal nobody needs it, and the doctor works without.
Part: TypeAlias = "str | tuple[str, str]"
"""Text, or text and rich's name of its style."""
GOOD, BAD, NOTE, NAME = "green", "bold red", "yellow", "cyan"
STDOUT = "-"
"""The name of a ``--json`` file that means standard output."""
_TAKEN, _WRITES = f"{__name__}.taken", f"{__name__}.writes"


def leave_stdout_to_json(ctx: click.Context) -> None:
    """From here on, text goes to standard error."""
    ctx.meta[_TAKEN] = True


def write_also_unread(ctx: click.Context) -> None:
    """From here on, a reader that goes does not end the command: it has files to write."""
    ctx.meta[_WRITES] = True


def leave_stdout() -> None:
    """Discard pending output, and what comes: Python would try to write it once more at its end, and complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.__stdout__.fileno() if sys.__stdout__ is not None else 1)


def verdict(text: str, good: bool) -> Part:
    """Text in the colour of a success, or of a failure."""
    return text, GOOD if good else BAD


def say(*parts: Part, err: bool = False) -> None:
    """A line of text, on standard output unless that is taken by JSON, or ``err``."""
    stream = _stream(err)
    if (console := _console(stream)) is None:
        _echo("".join(part if isinstance(part, str) else part[0] for part in parts), stream)
        return
    from rich.text import Text

    console.print(Text.assemble(*parts), soft_wrap=True)


def row(label: str, text: str, good: bool | None = None) -> None:
    """An indented line: a label, and what there is of it; ``good`` colours it as a success or a failure."""
    say("  ", (f"{label:<22}", NAME), " ", text if good is None else verdict(text, good))


def show(make: Callable[[], RenderableType], plain: str, after: str = "") -> None:
    """On a terminal the rich object that ``make`` returns, and a line after it; elsewhere plain text with that line."""
    stream = _stream(False)
    if (console := _console(stream)) is None:
        _echo(plain, stream)
    else:
        console.print(make())
        if after:
            console.print(after, markup=False, soft_wrap=True)


def table(columns: Sequence[str], rows: Sequence[Sequence[Part]], *, title: str = "") -> RenderableType:
    """A table of rich's, for `show`; without a head where no column has a name."""
    from rich.box import SIMPLE
    from rich.table import Table
    from rich.text import Text

    made = Table(box=SIMPLE, title=title or None, title_justify="left", title_style="bold", pad_edge=False)
    made.show_header = any(columns)
    for k, column in enumerate(columns):
        made.add_column(column, no_wrap=k == 0, overflow="fold", style=NAME if k == 0 else None)
    for cells in rows:
        made.add_row(*(Text(cell) if isinstance(cell, str) else Text(*cell) for cell in cells))
    return made


def markdown(text: str) -> RenderableType:
    """Markdown, for `show`."""
    from rich.markdown import Markdown

    return Markdown(text)


def write_document(label: str, file: str | None, document: object) -> None:
    """Write the JSON of ``--json``: into a file, which is then named, to standard output where it is ``-``, or not.

    Raises:
        InputError: the file cannot be written.
    """
    if file == STDOUT:
        _echo(json_text(document, "standard output"), sys.stdout, nl=False)
    elif file is not None:
        say(f"{label:<7} {write_json(file, document)}")


def in_colour(stream: TextIO) -> bool:
    """Whether a stream is a terminal that takes colour: NO_COLOR is not set, and it is not dumb."""
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") in ("dumb", "unknown"):
        return False
    return bool(os.environ.get("FORCE_COLOR")) or stream.isatty()


def _echo(text: str, stream: TextIO, *, nl: bool = True) -> None:
    try:
        click.echo(text, file=stream, nl=nl)
    except BrokenPipeError:
        context = click.get_current_context(silent=True)
        if stream is not sys.stdout or context is None or _WRITES not in context.meta:
            raise
        leave_stdout()


def _stream(err: bool) -> TextIO:
    context = click.get_current_context(silent=True)
    return sys.stderr if err or (context is not None and _TAKEN in context.meta) else sys.stdout


def _console(stream: TextIO) -> Console | None:
    if not in_colour(stream):
        return None
    try:
        from rich.console import Console
    except ImportError:  # colour is not worth an error
        return None
    return Console(file=stream, force_terminal=True, highlight=False)
