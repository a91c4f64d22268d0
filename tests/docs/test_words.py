"""The words of documents, messages and help texts: spelled as in a dictionary, and one name for one thing."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import click
import pytest

from elastic_strips.cli.group import cli
from elastic_strips.errors import plural

ROOT = Path(__file__).resolve().parents[2]
SOURCES = [s for room in ("src/elastic_strips", "workshop", "scripts") for s in sorted((ROOT / room).rglob("*.py"))]
LOGS = {"decisions.md", "log.md", "reworded.md"}  # what was written at its time stays as it was written
DOCUMENTS = [ROOT / "README.md", *(d for d in sorted((ROOT / "docs").glob("*.md")) if d.name not in LOGS)]
ODD = {  # what nobody says, and what is said instead
    r"\bplan(s|ned|ning)? anew\b": "replan, replanned",
    r"\banybody's\b": "of any planner, of others",
    r"\bcertified and at rest\b|\bnot yet at rest\b|\bstrip is at rest\b|\bstrip at rest\b": "converged, for strips",
    r"\btunnel\b(?! of Brock|\* of Brock)": "protective hulls, or motion bound",
    r"\bas was asked\b": "as requested",
    r"\bwas asked for\b.*\bof what\b": "commanded",
    r"\bMay be given again\b": "May be repeated",
    r"\bthe time was over\b": "the time ran out",
    r"\bcomputing (is )?charged\b": "computing costs simulated time",
    r"\bknown to \{[^}]*\} mm, of\b|\bknown to \d+ mm, of\b": "known to within",
    r"\bclearance of the nodes\b": "clearance at the nodes",
    r"\bPush it free\b": "a sentence that says what is pushed",
    r"\bis of a command that is named with it\b": "was measured with the command",
    r"\bthat were found would touch\b(?<!configurations that were found would touch)": "all configurations that …",
    r"\bbluntly\b": "nothing",
    r"\bput in on purpose\b": "injected",
    r"\b(by|at|so far|comes|are) so (much|many|far) \[": "by this much",
    r"\b1 (segments|goals|stops|ticks|runs|links|configurations)\b|\ball 1\b": "the singular",
    r"\bthe very convex\b": "the same convex",
    r"\bheld against\b": "compared with",
    r"\bthrow\b.*\bat will\b|\bscattered at will\b|\bturn at will\b": "at any time, at random",
}
PATTERN = re.compile("|".join(f"(?P<odd{k}>{odd})" for k, odd in enumerate(ODD)))


def odd_forms(text: str) -> list[str]:
    """The odd forms in a text, each with what is said instead."""
    better = list(ODD.values())
    found = []
    for match in PATTERN.finditer(" ".join(text.split())):
        k = next(int(name[3:]) for name, value in match.groupdict().items() if name.startswith("odd") and value)
        found.append(f"{match.group()!r}: say {better[k]!r}")
    return found


def texts_of(path: Path) -> list[tuple[int, str]]:
    """Line and text of every string of a Python file, formatted ones with their braces; docstrings, too."""
    nodes = [
        n for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if type(n) in (ast.Constant, ast.JoinedStr)
    ]
    inner = {id(part) for node in nodes if isinstance(node, ast.JoinedStr) for part in node.values}
    found = []
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inner:
            found.append((node.lineno, node.value))
        elif isinstance(node, ast.JoinedStr):
            found.append((node.lineno, ast.unparse(node)))
    return found


def helps(command: click.Command, context: click.Context) -> list[tuple[str, str]]:
    """Name and help text of a command and of all below it."""
    found = [(context.command_path, command.get_help(context))]
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            found += helps(below, click.Context(below, info_name=name, parent=context, **below.context_settings))
    return found


def test_documents_have_no_odd_forms() -> None:
    found = {d.name: odd for d in DOCUMENTS if (odd := odd_forms(d.read_text(encoding="utf-8")))}
    assert not found


def test_messages_have_no_odd_forms() -> None:
    found = [(s.name, line, odd) for s in SOURCES for line, text in texts_of(s) if (odd := odd_forms(text))]
    assert not found


def test_help_texts_have_no_odd_forms_and_are_sentences() -> None:
    found = helps(cli, click.Context(cli, info_name="elastic-strips", **cli.context_settings))  # click keeps its -h
    assert len(found) > 10
    assert not {name: odd for name, text in found if (odd := odd_forms(text))}
    for command in (
        cli,
        *(cli.get_command(click.Context(cli), name) for name in cli.list_commands(click.Context(cli))),
    ):
        for parameter in command.params if command is not None else ():
            if isinstance(parameter, click.Option) and parameter.help and not parameter.hidden:
                said = re.sub(r"\s*\[(default|never)[^\]]*\]$", "", parameter.help)
                assert said[0].isupper() or not said[0].isalpha() or said.startswith("x "), parameter.help
                assert said.endswith("."), parameter.help


@pytest.mark.parametrize(
    "text",
    [
        "the strip is planned anew",
        "31 mm off the reference, known to 9 mm, of 20 mm",
        "Every figure is of a command that is named with it",
        "all 56 that were found would touch something",
        "all 1 segments are proven",
        "A joint. May be given again.",
    ],
)
def test_odd_forms_are_found(text: str) -> None:
    assert odd_forms(text)


@pytest.mark.parametrize(
    "text", ["all 56 configurations that were found would touch", "the elastic tunnel of Brock", "11 stops"]
)
def test_what_is_said_well_is_left(text: str) -> None:
    assert not odd_forms(text)


def test_one_is_singular() -> None:
    assert [plural(count, "stop") for count in (0, 1, 2)] == ["0 stops", "1 stop", "2 stops"]


def test_everything_is_spelled_right(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    speller = pytest.importorskip("codespell_lib")
    monkeypatch.chdir(ROOT)  # whose pyproject.toml has the words that are right here
    wrong = speller.main(
        "README.md", "CONTRIBUTING.md", "docs", "src/elastic_strips", "workshop", "scripts", "notebooks"
    )
    assert wrong == 0, capsys.readouterr().out
