"""The progress bar: for people at a terminal, and for nobody else."""

from __future__ import annotations

import pytest

from elastic_strips.cli import options
from elastic_strips.cli.options import LateProgress


@pytest.mark.parametrize("terminal", [True, False])
def test_a_bar_is_drawn_in_a_terminal_only(
    terminal: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(options, "_PATIENCE", -1.0)
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
