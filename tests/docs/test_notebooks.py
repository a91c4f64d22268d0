"""Notebooks run from top to bottom, are kept without outputs, import what their extra brings, and show small pages."""

from __future__ import annotations

import ast
import os
import re
import sys
import time
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    tomllib = pytest.importorskip("tomli")

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")
pytest.importorskip("ipywidgets")
pytest.importorskip("matplotlib")

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
PAGE = 500_000  # bytes of the largest page: a notebook has several
LINES = 1400  # characters of a Markdown cell: two or three sentences, and what they are about


def _code(path: Path) -> str:
    notebook = nbformat.read(path, as_version=4)
    return "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "code")


def test_they_are_a_numbered_series() -> None:
    assert [path.name[:2] for path in NOTEBOOKS] == [f"{k:02d}" for k in range(1, len(NOTEBOOKS) + 1)]
    assert len(NOTEBOOKS) >= 10
    for path in NOTEBOOKS:
        title = nbformat.read(path, as_version=4).cells[0].source.splitlines()[0]
        assert title.startswith(f"# {int(path.name[:2])} · ")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_outputs_are_stripped(path: Path) -> None:
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
@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import elastic_strips

    source = str(Path(elastic_strips.__file__).resolve().parents[1])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(p for p in (source, os.environ.get("PYTHONPATH", "")) if p))
    notebook = nbformat.read(path, as_version=4)
    client = nbclient.NotebookClient(
        notebook, timeout=240, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    )
    began = time.monotonic()
    client.execute()
    seconds = time.monotonic() - began
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    for output in outputs:
        assert output.output_type != "error"
        assert "Traceback" not in output.get("text", "")
    pages = [len(output.data["text/html"]) for output in outputs if "text/html" in output.get("data", {})]
    print(f"{path.stem}: {seconds:.1f} s, pages of {[round(1e-3 * page) for page in pages]} kB")  # pytest -rP shows it
    assert max(pages, default=0) <= PAGE
