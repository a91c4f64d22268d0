"""The docs site builds without a warning, has every public name, leads only to what is there, and needs no network."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest
from cases import each

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "src" / "elastic_strips"
ROOMS = sorted(".".join(path.parent.relative_to(PACKAGE.parent).parts) for path in PACKAGE.glob("*/**/__init__.py"))
SHOWN = "02_drag_an_obstacle"
"""The notebook that the site executes here, unless its outputs are kept; test_notebooks.py executes the others."""
LOADED = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src", "video": "src"}
"""Attributes whose address a browser loads by itself."""


class Page(HTMLParser):
    """What a page has: places (ids), links, and what a browser loads for it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids, self.links, self.loaded = set[str](), set[str](), set[str]()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = {name: value for name, value in attrs if value}
        self.ids |= {found[name] for name in ("id", "name") if name in found}
        if tag == "a" and "href" in found:
            self.links.add(found["href"])
        if (where := LOADED.get(tag)) in found and found.get("rel") != "canonical":
            self.loaded.add(found[where])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as strictly as everywhere."""
    target = tmp_path_factory.mktemp("docs") / "site"
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", target],
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=240,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1", "NOTEBOOKS": SHOWN},
    )
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return target


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}


def lost(path: Path, page: Page, pages: dict[Path, Page]) -> list[str]:
    """The links and files of a page that lead nowhere."""
    found = []
    for target in sorted(page.links | page.loaded):
        if re.match(r"[a-z]+:", target) or path.name == "404.html":  # that page is shown anywhere, by a server
            continue
        name, _, anchor = unquote(target).partition("#")
        there = (path.parent / name).resolve() if name else path
        there = there / "index.html" if there.is_dir() else there
        if not there.is_file() or (anchor and there in pages and anchor not in pages[there].ids):
            found.append(target)
    return found


def test_links_and_anchors_lead_somewhere(pages: dict[Path, Page]) -> None:
    assert len(pages) > 60
    assert sum(len(page.links) for page in pages.values()) > 2000
    assert {path.name: found for path, page in pages.items() if (found := lost(path, page, pages))} == {}


def test_a_link_that_leads_nowhere_is_noticed(site: Path, pages: dict[Path, Page]) -> None:
    path = site / "index.html"
    page = Page('<a href="nowhere.html">a</a><a href="concepts.html#nowhere">b</a><a href="concepts.html#strip">c</a>')
    assert lost(path, page, pages) == ["concepts.html#nowhere", "nowhere.html"]


def test_nothing_is_loaded_from_elsewhere(pages: dict[Path, Page]) -> None:
    assert [(path.name, at) for path, page in pages.items() for at in page.loaded if re.match(r"\w*:?//", at)] == []


@each("document", ["README.md", "CONTRIBUTING.md", "urdf/README.md"])
def test_anchors_that_pages_outside_of_the_site_name_are_there(
    document: str, site: Path, pages: dict[Path, Page]
) -> None:
    text = (ROOT / document).read_text(encoding="utf-8")
    for name, anchor in re.findall(r"\]\(docs/([\w/-]+)\.md#([\w-]+)\)", text):
        assert anchor in pages[site / f"{name}.html"].ids, f"{document}: {name}.md#{anchor}"


@each("room", ROOMS)
def test_every_public_name_has_its_entry(room: str, site: Path, pages: dict[Path, Page]) -> None:
    names = getattr(importlib.import_module(room), "__all__", [])
    if names:
        page = pages[site / "api" / f"{room.partition('.')[2]}.html"]
        assert [name for name in names if f"{room}.{name}" not in page.ids] == []


def test_names_at_the_top_lead_to_their_entries(site: Path, pages: dict[Path, Page]) -> None:
    linked = {
        link.rpartition(".")[2] for link in pages[site / "api" / "index.html"].links if "#elastic_strips." in link
    }
    assert set(importlib.import_module("elastic_strips").__all__) - {"__version__"} <= linked


def test_inherited_attributes_are_told(site: Path) -> None:
    page = (site / "api" / "strip.html").read_text(encoding="utf-8")
    entry = page[
        page.index('id="elastic_strips.strip.DeformParams"') : page.index('id="elastic_strips.strip.DeformReport"')
    ]
    assert "distance that the certificate proves" in entry


def test_docstrings_have_no_markup_left(site: Path) -> None:
    for path in sorted((site / "api").glob("*.html")):
        assert not re.search(r":(?:class|meth|func|mod):", path.read_text(encoding="utf-8")), path.name


def test_examples_are_shown(site: Path) -> None:
    for path in sorted((ROOT / "scripts" / "examples").glob("*.py")):
        assert (site / "examples" / f"{path.stem}.html").is_file(), path.name


def test_notebooks_are_shown(site: Path, pages: dict[Path, Page]) -> None:
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        assert path.name in pages[site / "notebooks" / f"{path.stem}.html"].links
        assert (site / "notebooks" / path.name).read_bytes() == path.read_bytes()
    page = site / "notebooks" / f"{SHOWN}.html"
    text = page.read_text(encoding="utf-8")
    assert "certified True" in text  # what it printed
    assert text.count("run the notebook to have it") == 2  # what is live
    assert f"{SHOWN}-1.html" in pages[page].loaded
    assert 'id="es-data"' in (site / "notebooks" / f"{SHOWN}-1.html").read_text(encoding="utf-8")


def test_the_site_stays_small(site: Path) -> None:
    assert sum(path.stat().st_size for path in site.rglob("*") if path.is_file()) < 30e6
    for path in site.rglob("*.html"):
        assert path.stat().st_size < 1e6, path.name


def test_the_number_on_the_front_page_is_that_of_the_readme() -> None:
    row = re.search(r"^\| one tick .*$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert row
    median, _, rarely = re.findall(r"[\d.]+ ms", row[0])
    front = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert re.findall(r"[\d.]+ ms", front) == [median, rarely]


def test_search_finds_in_a_page_from_the_disk(site: Path, chromium: str) -> None:
    address = f"{(site / 'index.html').as_uri()}?q=influence"
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=20000", "--dump-dom"]
    done = subprocess.run([chromium, *flags, address], capture_output=True, text=True, timeout=120)
    assert re.search(r"\d+ matching documents", done.stdout)
    assert "tuning.html?h=influence" in done.stdout
