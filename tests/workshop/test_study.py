"""``python -m workshop study``: what it prints and writes, and its exit codes."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest

import elastic_strips
import workshop.study
from workshop.cli.group import run_cli
from workshop.study import PaperStudy, paper_study, simulate_paper
from workshop.study.simulation import Outcome


def _call(*arguments: object) -> int:
    """Exit code of a command line in this process."""
    with pytest.raises(SystemExit) as ended:
        run_cli([str(a) for a in arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code


def test_a_quick_study(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """One line a case, then the report, which has neither comparison nor map."""
    monkeypatch.setattr(workshop.study, "paper_study", partial(paper_study, cases=["case-2"]))
    assert _call("study", "paper", "--quick", "--out", tmp_path / "out") == 0
    printed = capsys.readouterr()
    first, last = printed.out.splitlines()
    assert first.split()[:2] == ["case-2", "reached"]
    assert last.split() == ["report", str(tmp_path / "out" / "paper.md")]
    assert printed.err == ""
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"fig-06-case-2.png", "paper.html", "paper.md"}
    report = (tmp_path / "out" / "paper.md").read_text(encoding="utf-8")
    assert "Methods compared" not in report
    assert "Parameters decided" not in report


def test_what_the_options_ask_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Another end than the paper's is exit code 3; all is compared and mapped unless it is to be quick."""
    asked: list[dict[str, object]] = []
    run = simulate_paper(elastic_strips.sim.scenarios.get_scenario("case-4"))
    assert run.outcome is Outcome.REACHED

    def study(folder: str, **options: object) -> PaperStudy:
        asked.append(options)
        return PaperStudy({"case-3": run}, (), (), (tmp_path / "paper.md",))

    monkeypatch.setattr(workshop.study, "paper_study", study)
    assert _call("study", "paper", "--processes", "2", "--json", tmp_path / "answer.json") == 3
    answer = json.loads((tmp_path / "answer.json").read_text())
    assert not answer["as_the_paper_says"]
    assert [(case["case"], case["outcome"]) for case in answer["cases"]] == [("case-3", "reached")]
    assert answer["files"] == [str(tmp_path / "paper.md")]
    assert _call("study", "paper", "--quick") == 3
    assert asked[0]["processes"] == 2
    assert not {"compared", "mapped"} & set(asked[0])
    assert asked[1]["processes"] is None
    assert (asked[1]["compared"], asked[1]["mapped"]) == ((), "")


def test_a_folder_that_cannot_be_is_wrong_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One line that says so, before anything is run."""
    (tmp_path / "file").write_text("")
    assert _call("study", "paper", "--quick", "--out", tmp_path / "file") == 2
    error = capsys.readouterr().err
    assert error.startswith("error: cannot write the study to")
    assert error.count("\n") == 1


def test_a_study_that_is_not_finished_leaves_no_folder(tmp_path: Path) -> None:
    """Neither a half-filled one nor an empty one; an older study stays as it is."""

    def stop(note: str) -> None:
        raise KeyboardInterrupt

    older = tmp_path / "older"
    older.mkdir()
    (older / "paper.md").write_text("of last year")
    for folder in (tmp_path / "new" / "study", older):
        with pytest.raises(KeyboardInterrupt):
            paper_study(folder, cases=["case-2"], compared=(), mapped="", step=stop)
    assert [p.relative_to(tmp_path).as_posix() for p in sorted(tmp_path.rglob("*"))] == ["older", "older/paper.md"]
    assert (older / "paper.md").read_text() == "of last year"
