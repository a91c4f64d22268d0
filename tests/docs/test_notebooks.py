"""Notebooks run from top to bottom, are kept without outputs, import what their extra brings, and show small pages."""

from __future__ import annotations

import ast
import importlib.util
import re
import sys
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import pytest
from cases import each, refused

if sys.version_info >= (3, 11):
    import tomllib
else:
    tomllib = pytest.importorskip("tomli")

for _needed in ("nbformat", "nbclient", "ipykernel", "ipywidgets", "matplotlib", "mkdocs"):
    if importlib.util.find_spec(_needed) is None:
        pytest.skip(f"{_needed} is not installed", allow_module_level=True)

sys.modules.setdefault("rfc3987_syntax", None)  # pyright: ignore[reportArgumentType] # see scripts/site_notebooks.py

if TYPE_CHECKING:
    from nbformat import NotebookNode

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
PAGE = 500_000  # bytes of the largest page: a notebook has several
TEXT = 60_000  # characters of a page of the site, without what stands in files beside it
ALONE = ("02_drag_an_obstacle", "04_your_own_robot")  # leave a strip that lives, and a log that says all
LINES = 1400  # characters of a Markdown cell: two or three sentences, and what they are about


@pytest.fixture(scope="module")
def site_notebooks() -> ModuleType:
    """The hook of the site. What it imports takes seconds, and is not waited for where tests are only collected."""
    spec = importlib.util.spec_from_file_location("site_notebooks", ROOT / "scripts" / "site_notebooks.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def kernel(site_notebooks: ModuleType) -> Iterator[object]:
    """One for nearly all: that each imports what all import took a third of the time."""
    with site_notebooks.Kernel() as kernel:
        yield kernel


def _code(path: Path) -> str:
    import nbformat

    notebook = nbformat.read(path, as_version=4)
    return "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "code")


def test_they_are_a_numbered_series() -> None:
    import nbformat

    assert [path.name[:2] for path in NOTEBOOKS] == [f"{k:02d}" for k in range(1, len(NOTEBOOKS) + 1)]
    assert len(NOTEBOOKS) >= 10
    for path in NOTEBOOKS:
        title = nbformat.read(path, as_version=4).cells[0].source.splitlines()[0]
        assert title.startswith(f"# {int(path.name[:2])} · ")


@each("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_outputs_are_stripped(path: Path) -> None:
    import nbformat

    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert notebook.metadata.kernelspec.name == "python3"
    assert "widgets" not in notebook.metadata
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.outputs == []
            assert cell.execution_count is None
        else:
            assert len(cell.source) <= LINES


def test_their_extra_brings_what_they_import() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    required = project["dependencies"] + project["optional-dependencies"]["notebooks"]
    brought = {re.split(r"[\[<>=;! ]", line)[0].lower().replace("_", "-") for line in required}
    brought |= {"elastic-strips", "ipython"}  # IPython comes with ipykernel
    homes = packages_distributions() | {"pinocchio": ["pin"]}  # which is in a folder of its own
    for path in NOTEBOOKS:
        for node in ast.walk(ast.parse(_code(path))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in {name.split(".")[0] for name in names} - set(sys.stdlib_module_names):
                found = {home.lower().replace("_", "-") for home in homes.get(name, [name])}
                assert found & brought, f"{path.name} imports {name}, which the extra 'notebooks' does not bring"


@pytest.mark.notebook
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebook_runs_and_makes_a_page(path: Path, site_notebooks: ModuleType, kernel: object) -> None:
    # where the site has not done it, and nothing has changed that it rests on
    notebook = site_notebooks.executed(path, None if path.stem in ALONE else kernel)
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    for output in outputs:
        assert output.output_type != "error"
        assert "Traceback" not in output.get("text", "")
    pages = [len(output.data["text/html"]) for output in outputs if "text/html" in output.get("data", {})]
    print(f"{path.stem}: pages of {[round(1e-3 * page) for page in pages]} kB")  # pytest -rP shows it
    assert max(pages, default=0) <= PAGE
    text, files = site_notebooks.page(notebook, path.stem)
    assert len(text) <= TEXT
    assert files, "shows no picture"
    for name, data in files.items():
        assert name in text
        assert len(data) <= PAGE
    shown = re.sub(r"^``````.*?^``````$", "", text, flags=re.MULTILINE | re.DOTALL)  # without code and what was printed
    assert not re.search(r"<(script|link)\b|127\.0\.0\.1:\d", shown)  # what loads something, or a server that is gone


def notebook_of(*outputs: NotebookNode) -> NotebookNode:
    import nbformat

    title, code = nbformat.v4.new_markdown_cell("# 1 · Title"), nbformat.v4.new_code_cell("do()", outputs=list(outputs))
    return nbformat.v4.new_notebook(cells=[title, code])


def test_a_page_has_all_that_a_notebook_shows(site_notebooks: ModuleType) -> None:
    import nbformat

    def shown(data: dict[str, str]) -> NotebookNode:
        return nbformat.v4.new_output("display_data", data)

    def said(text: str) -> NotebookNode:
        return nbformat.v4.new_output("stream", text=text)

    text, files = site_notebooks.page(
        notebook_of(
            said("one\n"), said("two `````\n"), shown({"text/plain": "three"}), shown({"image/png": "AAAA"}),
            shown({"text/html": '<iframe srcdoc="<title>a &lt; b</title>" style="">'}),
            shown({"text/html": '<iframe src="http://127.0.0.1:7000/"></iframe>'}),
            shown({"text/html": "<table></table>", "text/plain": "a table"}),
            shown({site_notebooks.WIDGET: "{}", "text/plain": "VBox(…)"}),
        ),
        "page",
    )  # fmt: skip
    assert "``````python\ndo()\n``````" in text
    assert "one\ntwo `````\n``````" in text
    assert "three" in text
    assert "![1 · Title](page-1.png)" in text
    assert 'src="page-2.html" title="a < b" loading="lazy"' in text
    assert files == {"page-1.png": b"\0\0\0", "page-2.html": b"<title>a < b</title>"}
    assert "<table></table>" in text
    assert "7000" not in text
    assert "VBox" not in text
    assert text.count("run the notebook") == 2


def test_an_output_that_no_page_shows_is_said(site_notebooks: ModuleType) -> None:
    import nbformat

    with refused(ValueError, "page", "'error'"):
        site_notebooks.page(notebook_of(nbformat.v4.new_output("error", ename="E", evalue="", traceback=[])), "page")


def test_outputs_are_kept_until_something_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, site_notebooks: ModuleType
) -> None:
    import nbformat

    monkeypatch.setattr(site_notebooks, "KEPT", tmp_path / "kept")
    path = tmp_path / "one.ipynb"
    nbformat.write(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("import uuid\nuuid.uuid4().hex")]), path)

    def output() -> str:
        return site_notebooks.executed(path).cells[0].outputs[0].data["text/plain"]

    first = output()
    assert output() == first
    monkeypatch.setattr(site_notebooks, "_code", lambda: b"other code")
    assert (second := output()) != first
    path.write_text(path.read_text(encoding="utf-8").replace(".hex", ".hex.upper()"), encoding="utf-8")
    assert output() not in (first, second)


def test_what_is_not_installed_is_said(monkeypatch: pytest.MonkeyPatch, site_notebooks: ModuleType) -> None:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.exceptions import PluginError
    from mkdocs.structure.files import Files

    def missing(path: Path) -> None:
        raise ModuleNotFoundError("No module named 'nbclient'")

    monkeypatch.setattr(site_notebooks, "_kept", lambda path: None)
    monkeypatch.setattr(site_notebooks, "executed", missing)
    config = MkDocsConfig()
    config.extra = {"notebooks": "*"}
    with refused(PluginError, "01_ten_lines.ipynb", "nbclient", "[docs,notebooks]"):
        site_notebooks.on_files(Files([]), config)
