"""Study room, document: headings, text, tables and pictures, written as Markdown and as a page of HTML."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass, field

_STYLE = """
body { font: 15px/1.5 sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; color: #1a1a1a; }
table { border-collapse: collapse; margin: 1em 0; font-size: 13px; }
th, td { border: 1px solid #bbb; padding: 3px 8px; text-align: left; }
th { background: #eee; }
img { max-width: 100%; }
figcaption { font-size: 13px; color: #444; }
"""


@dataclass(slots=True)
class Document:
    """Workspace: a report that grows from top to bottom.

    Attributes:
        title: of the report.
    """

    title: str
    _markdown: list[str] = field(default_factory=list)
    _html: list[str] = field(default_factory=list)

    def heading(self, text: str, level: int = 2) -> None:
        """A heading, from level 2 on; level 1 is the title's."""
        self._markdown.append(f"{'#' * level} {text}")
        self._html.append(f"<h{level}>{html.escape(text)}</h{level}>")

    def text(self, text: str) -> None:
        """A paragraph of plain text."""
        self._markdown.append(text)
        self._html.append(f"<p>{html.escape(text)}</p>")

    def table(self, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
        """A table; every row has as many cells as the head."""
        lines = ["| " + " | ".join(map(_cell, head)) + " |", "|" + "---|" * len(head)]
        lines += ["| " + " | ".join(map(_cell, row)) + " |" for row in rows]
        self._markdown.append("\n".join(lines))
        cells = "".join(f"<th>{html.escape(cell)}</th>" for cell in head)
        body = "".join("<tr>" + "".join(f"<td>{html.escape(str(c))}</td>" for c in row) + "</tr>" for row in rows)
        self._html.append(f"<table><tr>{cells}</tr>{body}</table>")

    def picture(self, file: str, caption: str) -> None:
        """A picture beside the report."""
        self._markdown.append(f"![{caption}]({file})\n\n*{caption}*")
        source, text = html.escape(file, quote=True), html.escape(caption)
        self._html.append(f'<figure><img src="{source}" alt="{text}"><figcaption>{text}</figcaption></figure>')

    def markdown(self) -> str:
        """The report as Markdown."""
        return "\n\n".join([f"# {self.title}", *self._markdown]) + "\n"

    def page(self) -> str:
        """The report as HTML."""
        title = html.escape(self.title)
        head = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title><style>{_STYLE}</style>'
        return "\n".join([head, f"<h1>{title}</h1>", *self._html, "</html>", ""])


def _cell(content: object) -> str:
    """What stands in a Markdown table: one line, without the sign that parts the cells."""
    return " ".join(str(content).split()).replace("|", "\\|")
