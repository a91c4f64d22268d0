"""scripts/test: its exit code says what its checks found, with checks that only pretend."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    (tmp_path / "scripts").mkdir()
    shutil.copy(SCRIPTS / "test", tmp_path / "scripts" / "test")
    (tmp_path / "scripts" / "_setup.sh").write_text(
        f"ROOT={tmp_path}\nVENV=$ROOT/.venv\nsetup_venv() {{ :; }}\nsetup_chromium() {{ :; }}\n"
        'say() { printf "==> %s\\n" "$*"; }\ndie() { printf "error: %s\\n" "$*" >&2; exit 1; }\n'
    )
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    for name in ("ruff", "clang-format", "lint-imports", "pyright", "pytest"):
        end(tmp_path, name, 0)
    return tmp_path


def end(checkout: Path, check: str, code: int) -> None:
    path = checkout / ".venv" / "bin" / check
    path.write_text(f"#!/bin/sh\necho {check} has spoken\nexit {code}\n")
    path.chmod(0o755)


def run(checkout: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([checkout / "scripts" / "test"], capture_output=True, text=True, timeout=60)


def test_all_that_passes_ends_with_0(checkout: Path) -> None:
    done = run(checkout)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("==> All checks passed\n")


@pytest.mark.parametrize("check", ["ruff", "clang-format", "lint-imports", "pyright", "pytest"])
def test_what_fails_is_named_and_the_others_are_run(checkout: Path, check: str) -> None:
    end(checkout, check, 3)
    done = run(checkout)
    assert done.returncode == 1
    assert "All checks passed" not in done.stdout
    assert "error: something to mend: " + check in done.stderr
    for name in ("ruff", "clang-format", "lint-imports", "pyright", "pytest"):
        assert f"{name} has spoken" in done.stdout
