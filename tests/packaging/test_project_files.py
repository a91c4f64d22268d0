"""What a stranger reads first: the changelog knows the version, the citation is one, and what they name is there."""

from __future__ import annotations

import re
from pathlib import Path

import yaml
from cases import each

from elastic_strips import __version__

ROOT = Path(__file__).parents[2]
SECTION = re.compile(r"^## \[(.+?)\](?: - (\d{4}-\d{2}-\d{2}))?$", re.MULTILINE)
KINDS = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}


def test_the_changelog_goes_by_version() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    versions = [version for version, _ in SECTION.findall(text)]
    assert versions[0] == "Unreleased"
    released = [tuple(int(part) for part in version.split(".")) for version in versions[1:]]
    assert released == sorted(set(released), reverse=True)
    assert __version__ in versions
    assert set(re.findall(r"^### (.+)$", text, re.MULTILINE)) <= KINDS


def test_it_can_be_cited() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert cited["cff-version"] == "1.2.0"
    assert {"message", "title", "authors", "license", "type"} <= cited.keys()
    for reference in cited["references"]:
        assert {"authors", "title", "type", "year"} <= reference.keys()


PAGES = ["README.md", "CONTRIBUTING.md", *(f"docs/{path.name}" for path in sorted((ROOT / "docs").glob("*.md")))]


@each("page", PAGES)
def test_paths_that_are_named_are_there(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    folders = "scripts|tests|docs|notebooks|urdf"
    rooms = "|".join(sorted(path.name for path in (ROOT / "src" / "elastic_strips").iterdir() if path.is_dir()))
    named = set(re.findall(rf"\b(?:{folders})/[\w./-]*\w", text))
    named |= {f"src/elastic_strips/{path}" for path in re.findall(rf"`((?:{rooms})/[\w/]+\.py)`", text)}
    assert named or page.startswith("docs/")
    assert [path for path in sorted(named) if not (ROOT / path).exists()] == []
