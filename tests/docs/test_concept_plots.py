"""The plots of the concepts are drawn by the code as it is, and the table about tuning says what it computes."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest
from cases import each

pyplot = pytest.importorskip("matplotlib.pyplot")

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images"
NAMES = ["touching", "strip", "motion-bound", "certificate", "braking", "ticks"]


@pytest.fixture(scope="module")
def plots() -> ModuleType:
    spec = importlib.util.spec_from_file_location("concept_plots", ROOT / "scripts" / "concept_plots.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_each_plot_is_there_and_small(plots: ModuleType) -> None:
    assert set(plots.PLOTS) == {*NAMES, "tuning"}
    for name in plots.PLOTS:
        assert (IMAGES / f"{name}.svg").stat().st_size < 100_000, name


@each("name", NAMES)
def test_a_plot_shows_what_its_page_says(name: str, plots: ModuleType) -> None:
    figure = plots.PLOTS[name]()
    titles = [axes.get_title("left") or axes.get_title() for axes in figure.axes]
    pyplot.close(figure)
    said = {
        "touching": ["TIAGo in cluttered corridors", "Arms reaching into shelves, boxes and cages"],
        "strip": ["a straight line: segment", "converged after"],
        "motion-bound": ["the whole segment: not decided", "halved: free"],
        "certificate": ["proved: 20 of 20", "refuted: segment"],
        "braking": [""],
        "ticks": ["tick 120", "tick 190", "tick 260"],
    }[name]
    assert len(titles) == len(said)
    assert all(title.startswith(what) for title, what in zip(titles, said, strict=True)), titles


def test_the_chart_of_the_front_page_has_the_figures_of_the_benchmarks(plots: ModuleType) -> None:
    touched = plots.touched()
    page = " ".join((ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8").split())
    for name, touch, count in (row for rows in touched.values() for row in rows):
        assert 0 <= touch <= count
        assert (f"{touch} of {count}" in page) or (touch == 0 and f"| {count} |" in page), name
    assert {row[1] for rows in touched.values() for row in rows if row[0].startswith("elastic_strips")} == {0}


@pytest.mark.parametrize("changes", [{"influence": 0.1}, {"k_c": 10.0}])
def test_the_table_about_tuning_is_right(changes: dict[str, float], plots: ModuleType) -> None:
    ((name, value),) = changes.items()
    page = (ROOT / "docs" / "tuning.md").read_text(encoding="utf-8")
    row = re.search(
        rf"^\| `{name}={value:g}` \| (\d+) of 10 \| ([\d.]+) m \| ([\d.]+) m \| ([\d.]+) \|", page, re.MULTILINE
    )
    assert row
    found = plots.tuned(**changes)
    assert found["certified"] == int(row[1])
    assert found["clearance"] == pytest.approx(float(row[2]), abs=0.02)
    assert found["least"] == pytest.approx(float(row[3]), abs=0.03)
    assert found["length"] == pytest.approx(float(row[4]), abs=0.15)
