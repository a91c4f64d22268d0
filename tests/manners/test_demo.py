"""``scripts/demo`` where nobody watches: it runs, writes, says where, and ends."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """The scripts of this checkout with an environment that is set up already: this one."""
    folder = tmp_path / "checkout"
    shutil.copytree(ROOT / "scripts", folder / "scripts")
    setup = folder / "scripts" / "_setup.sh"
    setup.write_text(setup.read_text() + "\nsetup_venv() { :; }\n")
    programs = folder / ".venv" / "bin"
    programs.mkdir(parents=True)
    for name, call in (("elastic-strips", "-m elastic_strips"), ("python", "")):
        (programs / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" {call} "$@"\n')
        (programs / name).chmod(0o755)
    return folder


def _demo(checkout: Path, *arguments: str, **changes: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **changes}
    environment.pop("DISPLAY", None)
    return subprocess.run(
        [shutil.which("bash") or "bash", str(checkout / "scripts" / "demo"), *arguments], stdin=subprocess.DEVNULL,
        capture_output=True, text=True, timeout=200, cwd=checkout, env=environment,
    )  # fmt: skip


def test_without_a_terminal_and_a_browser_it_writes_the_page_and_ends(checkout, tmp_path):
    """The tools that it needs are there, and no Chromium."""
    tools = tmp_path / "tools"
    tools.mkdir()
    for name in ("dirname", "basename"):
        (tools / name).symlink_to(shutil.which(name) or name)
    done = _demo(checkout, "case-1", PATH=str(tools), CHROMIUM="")
    assert done.returncode == 0, done.stderr
    page = checkout / "elastic-strips-case-1.html"
    assert page.stat().st_size > 100_000
    assert f"The page is {page}" in done.stdout
    assert "apt-get install chromium" in done.stdout
    assert "viewer " not in done.stdout


def test_with_a_browser_it_writes_a_picture_too(checkout):
    """Who draws is told what and where; that a real browser does it is shown with the viewer's tests."""
    draw = "import pathlib, sys; page, picture = map(pathlib.Path, sys.argv[1:3])\n"
    (checkout / "scripts" / "screenshot").write_text(draw + "picture.write_text(str(page.stat().st_size))\n")
    done = _demo(checkout, "case-1", CHROMIUM=sys.executable)
    assert done.returncode == 0, done.stderr
    page, picture = (checkout / f"elastic-strips-case-1.{kind}" for kind in ("html", "png"))
    assert int(picture.read_text()) == page.stat().st_size
    assert f"The picture is {picture}" in done.stdout


def test_wrong_input_is_no_success(checkout):
    assert _demo(checkout, "case-99").returncode == 2
