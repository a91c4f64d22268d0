"""What goes with a release: pages that know pyproject.toml, and files that are named there."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
import yaml

from elastic_strips import __version__

if sys.version_info >= (3, 11):
    import tomllib
else:
    tomllib = pytest.importorskip("tomli")

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
EXTRAS: dict[str, list[str]] = PROJECT["project"]["optional-dependencies"]
CORE: list[str] = PROJECT["project"]["dependencies"]


def name_of(requirement: str) -> str:
    found = re.match(r"[\w.-]+", requirement)
    assert found is not None
    return re.sub(r"[-_.]+", "-", found[0]).lower()


def rows(page: str, heading: str) -> dict[str, list[str]]:
    """Cells of the table in a section, by the name in their first one, without its link."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    section = re.split(rf"^## {re.escape(heading)}$", text, flags=re.MULTILINE)[1].split("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")][2:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {re.sub(r"^\[(.*?)\]\(.*\)$", r"\1", row[0]).strip("`"): row[1:] for row in cells}


def test_each_dependency_has_a_licence() -> None:
    """Whoever adds a dependency runs scripts/licences --page."""
    uses: dict[str, set[str]] = {}
    for extra, lines in {"core": CORE, **EXTRAS, "build": PROJECT["build-system"]["requires"]}.items():
        for line in lines:
            uses.setdefault(name_of(line), set()).add(extra)
    listed = rows("licences.md", "What pyproject.toml names")
    assert {name: set(cells[0].split(", ")) for name, cells in listed.items()} == uses
    assert [name for name, cells in listed.items() if not cells[2] or "UNKNOWN" in cells[2]] == []
    along = rows("licences.md", "What comes along with the core")
    assert along
    assert [name for name, cells in along.items() if not cells[1] or "UNKNOWN" in cells[1]] == []


def test_the_oldest_versions_that_were_tried_are_those_that_are_allowed() -> None:
    """Whoever changes a bound runs scripts/versions --page."""
    tried = rows("versions.md", "Oldest and newest")
    assert {"tests passed", "tests failed"} <= tried.keys()
    for line in CORE:
        allowed, oldest, newest = tried[name_of(line)]
        bounds = line[len(name_of(line)) :].strip()
        least = re.match(r">=([\d.]+)", bounds)
        assert least is not None, f"{line}: a lower bound comes first"
        assert allowed == bounds
        assert numbers(oldest)[: len(numbers(least[1]))] == numbers(least[1]), line
        assert numbers(newest) >= numbers(oldest), line


def numbers(version: str) -> list[int]:
    return [int(part) for part in re.findall(r"\d+", version)]


def test_each_python_that_is_named_has_its_wheel() -> None:
    named = [c.rpartition(" ")[2] for c in PROJECT["project"]["classifiers"] if re.search(r":: 3\.\d+$", c)]
    assert named
    assert set(named) <= rows("versions.md", "Wheels").keys()


def test_the_changelog_is_short_and_the_release_has_its_day() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 150
    dated = re.search(rf"^## \[{re.escape(__version__)}\] - (\d{{4}}-\d{{2}}-\d{{2}})$", text, re.MULTILINE)
    assert dated is not None
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert cited["version"] == __version__
    assert str(cited["date-released"]) == dated[1]
