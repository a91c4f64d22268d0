"""The report's document: Markdown and HTML of the same content, with nothing that breaks either."""

from __future__ import annotations

from html.parser import HTMLParser

from workshop.study.paper_study import Document


class _Reader(HTMLParser):
    """Texts by tag, and the sources of pictures."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[tuple[str, str]] = []
        self.sources: list[str | None] = []
        self._open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._open.append(tag)
        if tag == "img":
            self.sources.append(dict(attrs)["src"])

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.texts.append((self._open[-1], data))


def _document() -> Document:
    document = Document("A < B & C")
    document.heading("Part")
    document.heading("Smaller part", 3)
    document.text("x < y | z")
    document.table(["a", "b|c"], [[1, "two\nlines"], ["p|q", "<i>"]])
    document.picture("way & back.png", "the way")
    return document


def test_the_markdown_has_every_piece_in_order() -> None:
    """Headings by level, a table whose cells stay on one line, a picture with its caption."""
    lines = [line for line in _document().markdown().splitlines() if line]
    assert lines == [
        "# A < B & C",
        "## Part",
        "### Smaller part",
        "x < y | z",
        "| a | b\\|c |",
        "|---|---|",
        "| 1 | two lines |",
        "| p\\|q | <i> |",
        "![the way](way & back.png)",
        "*the way*",
    ]


def test_the_page_says_the_same() -> None:
    """What a browser reads is what was given, signs of HTML included."""
    reader = _Reader()
    page = _document().page()
    reader.feed(page)
    assert page.startswith("<!doctype html>")
    pieces = [
        ("title", "A < B & C"), ("h1", "A < B & C"), ("h2", "Part"), ("h3", "Smaller part"), ("p", "x < y | z"),
        ("th", "b|c"), ("td", "p|q"), ("td", "<i>"), ("figcaption", "the way"),
    ]  # fmt: skip
    assert [piece for piece in pieces if piece not in reader.texts] == []
    assert reader.sources == ["way & back.png"]
