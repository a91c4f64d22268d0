"""The progress bar: for people at a terminal, and for nobody else."""

from __future__ import annotations

import pytest

from elastic_strips.cli import options
from elastic_strips.cli.options import LateProgress


@pytest.mark.parametrize("terminal", [True, False])
def test_a_bar_is_drawn_in_a_terminal_only(
    terminal: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(options, "PROGRESS_PERIOD", -1.0)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    if terminal:
        monkeypatch.setenv("FORCE_COLOR", "1")
    else:
        monkeypatch.delenv("FORCE_COLOR", raising=False)
    with LateProgress("driving") as bar:
        for _ in range(3):
            bar.step("on the way")
    printed = capsys.readouterr()
    assert printed.out == ""
    assert ("driving" in printed.err) is terminal
    assert bool(printed.err) is terminal


def test_how_long_it_takes_is_said_in_lines_where_they_are_wanted(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("FORCE_COLOR", raising=False)
    now = iter([0.0, 8.0, 12.0, 15.0, 36.0])
    monkeypatch.setattr(options, "perf_counter", lambda: next(now))
    with LateProgress("s", 100, lines=True) as bar:
        for note in ("", "1 with an error", "1 with an error", ""):
            bar.step(note)
    assert capsys.readouterr().err.splitlines() == [
        "s: 2 of 100, about 9 min 48 s left, 1 with an error",
        "s: 4 of 100, about 14 min 24 s left",
    ]


def test_a_label_is_no_markup(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(options, "PROGRESS_PERIOD", -1.0)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("FORCE_COLOR", "1")
    with LateProgress("s[/bold]", 2) as bar:
        bar.step("of [/red]")
    assert "s[/bold]" in capsys.readouterr().err
