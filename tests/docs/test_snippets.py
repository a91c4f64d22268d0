"""Documents keep their word: their Python runs, their commands parse, their links lead somewhere."""

from __future__ import annotations

import pkgutil
import re
import shlex
import sys
from pathlib import Path

import click
import pytest
from cases import each

from elastic_strips.cli import main
from elastic_strips.cli.group import cli

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(\w[^\n]*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
RESULT = "python result check"
"""Blocks marked so are scripts whose argument is a result of ``run --json``."""
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")


def blocks(document: Path, language: str) -> list[tuple[int, str]]:
    """Line and text of each fenced block whose first line is ```language."""
    text = document.read_text(encoding="utf-8")
    return [
        (text.count("\n", 0, match.start(2)) + 1, match.group(2))
        for match in BLOCK.finditer(text)
        if match.group(1).strip() == language
    ]


def commands() -> list[pytest.param]:
    """Every ``elastic-strips`` command of the documents' bash blocks."""
    found = []
    for document in DOCUMENTS:
        for line, text in blocks(document, "bash"):
            for offset, row in enumerate(text.splitlines()):
                words = shlex.split(row, comments=True)
                if words[:1] == ["elastic-strips"]:
                    found.append(pytest.param(words[1:], id=f"{document.name}:{line + offset}"))
    return found


@pytest.mark.parametrize("document", [d for d in DOCUMENTS if blocks(d, "python")], ids=lambda d: d.name)
def test_python_blocks_run_in_order(document: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {"__name__": "__snippet__"}
    for line, text in blocks(document, "python"):
        exec(compile("\n" * (line - 1) + text, str(document), "exec"), namespace)


@pytest.mark.parametrize("document", [d for d in DOCUMENTS if blocks(d, RESULT)], ids=lambda d: d.name)
def test_scripts_that_check_a_result(document: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "result.json"
    with pytest.raises(SystemExit) as ended:
        main(["run", "case-1", "--json", str(target)])
    assert ended.value.code == 0
    monkeypatch.setattr(sys, "argv", ["check", str(target)])
    for line, text in blocks(document, RESULT):
        exec(compile("\n" * (line - 1) + text, str(document), "exec"), {"__name__": "__main__"})


def test_the_readme_has_the_ten_line_program() -> None:
    _, program = blocks(ROOT / "README.md", "python")[0]
    statements = [row for row in program.splitlines() if row.strip()]
    assert len(statements) <= 10
    assert {"es.load_robot", "es.Scene", "es.plan", "es.Deformer", ".settle", "es.Viewer"} <= set(
        re.findall(r"es\.\w+|\.settle", program)
    )


@each("words", commands())
def test_commands_parse(words: list[str]) -> None:
    command: click.Command = cli
    context: click.Context | None = None
    name = "elastic-strips"
    while isinstance(command, click.Group):
        context = command.make_context(name, list(words), parent=context)
        rest = [*context._protected_args, *context.args]
        found, command, words = command.resolve_command(context, rest)
        assert found is not None
        assert command is not None
        name = found
    command.make_context(name, list(words), parent=context)


def test_there_are_commands() -> None:
    assert len(commands()) >= 5


@each("document", [*DOCUMENTS, ROOT / "urdf" / "README.md"], ids=lambda d: str(d.relative_to(ROOT)))
def test_links_lead_somewhere(document: Path) -> None:
    for target in LINK.findall(BLOCK.sub("", document.read_text(encoding="utf-8"))):
        if "://" not in target:
            assert (document.parent / target).exists(), f"{document.name}: {target} does not exist"


def test_pictures_are_small() -> None:
    pictures = sorted((ROOT / "docs" / "images").glob("*.png"))
    assert pictures
    for picture in pictures:
        assert picture.stat().st_size < 250_000, picture.name


def test_pictures_of_the_gallery_are_small() -> None:
    sizes = {picture.name: picture.stat().st_size for picture in (ROOT / "docs" / "images").glob("*.webp")}
    assert sizes.pop("drag.webp") < 3e6
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert set(sizes) == set(re.findall(r"\(images/([\w-]+\.webp)\)", page))
    assert max(sizes.values()) < 300_000
    assert sum(sizes.values()) < 2.5e6


@pytest.mark.parametrize("document", ["design.md", "decisions.md"])
def test_named_code_exists(document: str) -> None:
    """Every `room.name` that these pages point to is there; test_paper_map.py does that for the paper's map."""
    text = (ROOT / "docs" / document).read_text(encoding="utf-8")
    rooms = {p.stem for p in (ROOT / "src" / "elastic_strips").iterdir() if not p.name.startswith("_")}
    names = {name for name in re.findall(r"`([a-z_]+(?:\.\w+)+)", text) if name.split(".")[0] in rooms}
    for name in names:
        if not name.endswith(".py"):
            pkgutil.resolve_name(f"elastic_strips.{name}")
