"""The progress bar: for people at a terminal, and for nobody else."""

from __future__ import annotations

import pytest

from elastic_strips.cli import progress_bar
from elastic_strips.cli.progress_bar import LateProgress


@pytest.mark.parametrize("terminal", [True, False])
def test_a_bar_is_drawn_in_a_terminal_only(
    terminal: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress_bar, "PROGRESS_PERIOD", -1.0)
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
    monkeypatch.setattr(progress_bar, "perf_counter", lambda: next(now))
    with LateProgress("s", 100, lines=True) as bar:
        for note in ("", "1 with an error", "1 with an error", ""):
            bar.step(note)
    assert capsys.readouterr().err.splitlines() == [
        "s: 2 of 100, about 9 min 48 s left, 1 with an error",
        "s: 4 of 100, about 14 min 24 s left",
    ]


def test_a_label_is_no_markup(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(progress_bar, "PROGRESS_PERIOD", -1.0)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("FORCE_COLOR", "1")
    with LateProgress("s[/bold]", 2) as bar:
        bar.step("of [/red]")
    assert "s[/bold]" in capsys.readouterr().err


def test_a_way_has_a_length_and_the_rest_of_it_takes_a_while(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """... and begins again where another way is gone."""
    monkeypatch.setattr(progress_bar, "PROGRESS_PERIOD", -1.0)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "150")
    now = iter([0.0, 0.0, 10.0, 20.0, 30.0])
    monkeypatch.setattr(progress_bar, "perf_counter", lambda: next(now))
    shown: list[tuple[object, ...]] = []
    with LateProgress("driving") as bar:
        real = bar._show

        def show(now: float, done: float, total: float | None, said: str, note: str) -> None:
            shown.append((done, total, said, note))
            real(now, done, total, said, note)

        monkeypatch.setattr(bar, "_show", show)
        bar.come(8.0, 8.0, "m", "moving")
        bar.come(6.0, 8.0, "m", "moving")
        bar.come(9.0, 8.0, "m", "replanned")
        bar.come(3.0, 4.0, "m")
    assert shown == [
        (0.0, 8.0, "0.0 of 8.0 m", "moving"),
        (2.0, 8.0, "2.0 of 8.0 m", "about 30 s left, moving"),
        (0.0, 8.0, "0.0 of 8.0 m", "replanned"),
        (1.0, 4.0, "1.0 of 4.0 m", ""),
    ]
    assert "of 4.0 m" in capsys.readouterr().err
