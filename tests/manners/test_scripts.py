"""scripts/test: its exit code says what its checks found, with checks that only pretend."""

from __future__ import annotations

import re
import shutil
import subprocess
import venv
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
    for name in ("python", "ruff", "clang-format", "lint-imports", "pyright", "pytest"):
        end(tmp_path, name, 0)
    return tmp_path


def end(checkout: Path, check: str, code: int) -> None:
    path = checkout / ".venv" / "bin" / check
    path.write_text(f'#!/bin/sh\necho {check} has spoken: "$@"\nexit {code}\n')
    path.chmod(0o755)


def run(checkout: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([checkout / "scripts" / "test", *arguments], capture_output=True, text=True, timeout=60)


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


def test_the_quick_checks_are_ruff_and_the_quick_units(checkout: Path) -> None:
    end(checkout, "pyright", 3)
    done = run(checkout, "--quick", "-k", "viewer")
    assert done.returncode == 0, done.stderr
    spoken = dict(re.findall(r"^([a-z-]+) has spoken: (.*)$", done.stdout, re.MULTILINE))
    assert set(spoken) == {"ruff", "pytest"}
    assert {"slow", "process", "browser", "wheel"} <= set(re.findall(r"\w+", spoken["pytest"]))
    assert spoken["pytest"].endswith("-k viewer tests/unit tests/property")
    end(checkout, "pytest", 1)
    assert run(checkout, "--quick").returncode == 1


def test_a_copy_that_was_installed_over_the_checkout_is_noticed(tmp_path):
    """No edit would reach it."""
    checkout, source = tmp_path / "checkout", tmp_path / "checkout" / "src" / "elastic_strips"
    shutil.copytree(SCRIPTS, checkout / "scripts")
    source.mkdir(parents=True)
    (source / "__init__.py").touch()
    venv.create(checkout / ".venv", symlinks=True)
    packages = next((checkout / ".venv").glob("lib*/python*/site-packages"))

    def here() -> bool:
        call = 'source "$1" && installed_here'
        command = [shutil.which("bash") or "bash", "-c", call, "bash", str(checkout / "scripts" / "_setup.sh")]
        return subprocess.run(command, check=False).returncode == 0

    assert not here(), "nothing is installed"
    (packages / "editable.pth").write_text(f"{source.parent}\n")
    assert here()
    shutil.copytree(source, packages / "elastic_strips")
    assert not here()
