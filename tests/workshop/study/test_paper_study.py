"""The study as a whole: what it writes, that every picture is linked, and what it refuses before it runs anything."""

from __future__ import annotations

import importlib
import re
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from cases import each

from elastic_strips.errors import InputError, ParameterError, ScenarioError
from elastic_strips.sim.scenarios.paper_cases import TABLE_2
from workshop.study import PaperStudy, paper_study, parameter_map
from workshop.study.simulation import Outcome

MODULE = importlib.import_module("workshop.study.paper_study")
"""The module, which the package's function of the same name hides."""


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> tuple[PaperStudy, list[str]]:
    """Case 4 alone, one trial, two cells; and the notes of its steps."""
    folder, notes = tmp_path_factory.mktemp("study"), list[str]()
    short = folder / "short.yaml"
    pole = "{shape: cylinder, name: pole, radius: 0.2, length: 1, at: [0.6, 1.2, 0.5]}"
    short.write_text(f"robot: silvermate\nstart: {{}}\ngoal: {{x: 1.2}}\nscene: {{obstacles: [{pole}]}}\n")
    with pytest.MonkeyPatch.context() as patch:
        cells = partial(parameter_map, k_r=[0.3], k_c=[0.5], safe=[0.8, 1.5])
        patch.setattr(MODULE, "parameter_map", cells)
        found = paper_study(
            folder / "new" / "out", cases=["case-4"], compared=[str(short)], methods=["apf"], processes=1,
            step=notes.append,
        )  # fmt: skip
    return found, notes


def _text(study: PaperStudy, name: str) -> str:
    return next(f for f in study.files if f.name == name).read_text(encoding="utf-8")


def test_every_picture_is_there_and_linked_once(study: tuple[PaperStudy, list[str]]) -> None:
    """In both reports; nothing else is in the folder, and what is returned is what is there."""
    found, _ = study
    pictures = ["fig-08-case-4.png", "parameter-map-case-4.png"]
    folder = found.report.parent
    assert sorted(p.name for p in folder.iterdir()) == sorted([*pictures, "paper.html", "paper.md"])
    assert {*found.files} == {*folder.iterdir()}
    assert re.findall(r"!\[[^\]]*\]\(([^)]*)\)", _text(found, "paper.md")) == pictures
    assert re.findall(r'<img src="([^"]*)"', _text(found, "paper.html")) == pictures
    for name in pictures:
        data = (folder / name).read_bytes()
        assert data.startswith(b"\x89PNG")
        assert len(data) > 5000


def test_the_report_says_what_was_found(study: tuple[PaperStudy, list[str]]) -> None:
    """The run's outcome and sightings, the trial's row, how many cells ended how, the paper's tables."""
    found, notes = study
    run, [row], text = found.runs["case-4"], found.rows, _text(found, "paper.md")
    assert found.as_the_paper_says
    assert run.outcome is Outcome.REACHED
    for detection in run.detections:
        x, y = (1e3 * v for v in detection.robot)
        assert f"{detection.name} is sensed from ({x:.0f}, {y:.0f})" in text
    assert f"no nearer to an obstacle than {1e3 * run.clearance:.0f} mm" in text
    assert f"| apf | yes | – | {1e3 * row.clearance:.0f} | {1e3 * row.path:.0f} | {row.time:.1f} |" in text
    assert [cell.outcome for cell in found.cells] == [Outcome.REACHED, Outcome.BLOCKED]
    assert "1 reached, 1 blocked." in text
    assert "| case-1 | π/6 | 1500 | 2100 |" in text
    assert "| case-6 | π/3 | 1000 | – |" in text
    assert notes[:2] == ["case-4, preset paper", "case-4, preset default"]
    assert len(notes) == 5


def test_another_end_than_the_papers_is_told() -> None:
    """Case 3 must not be reached."""
    reached = cast("Any", SimpleNamespace(outcome=Outcome.REACHED))
    assert PaperStudy({"case-4": reached}, (), (), ()).as_the_paper_says
    assert not PaperStudy({"case-3": reached}, (), (), ()).as_the_paper_says
    assert set(MODULE.EXPECTED) == set(MODULE.SAYS) == set(TABLE_2)


@each(
    "options, error, says",
    [
        ({"cases": ["case-8"]}, ScenarioError, "'case-8'"),
        ({"cases": ["bottleneck"]}, ScenarioError, "the paper has no case 'bottleneck'"),
        ({"compared": ["case-8"]}, ScenarioError, "'case-8'"),
        ({"methods": ["apv"]}, ParameterError, "'apv'"),
        ({"mapped": "case-8"}, ScenarioError, "'case-8'"),
    ],
)
def test_wrong_names_are_refused_before_anything_is_made(
    tmp_path: Path, options: dict[str, Any], error: type[InputError], says: str
) -> None:
    """No folder is made for them."""
    with pytest.raises(error, match=says):
        paper_study(tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_is_refused(tmp_path: Path) -> None:
    """It is a file, it is below one, it has no name, or what it is to hold is a folder."""
    file = tmp_path / "file"
    file.write_text("kept")
    (tmp_path / "taken" / "paper.md").mkdir(parents=True)
    for folder in (file, file / "below", "a\0b", tmp_path / "taken"):
        with pytest.raises(InputError):
            paper_study(folder)
    assert file.read_text() == "kept"
