"""The source archive: whatever builds, tests and explains the project, and nothing that was made from it."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

pytestmark = [
    pytest.mark.wheel,
    pytest.mark.skipif(
        any(importlib.util.find_spec(name) is None for name in ("build", "scikit_build_core")),
        reason="build and scikit-build-core are not installed: pip install -e '.[dev]'",
    ),
]


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """The files in the source archive of this checkout."""
    out = tmp_path_factory.mktemp("sdist")
    call = [sys.executable, "-m", "build", "--sdist", "--no-isolation", "--outdir", str(out), str(ROOT)]
    ended = subprocess.run(call, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 0, ended.stdout[-2000:] + ended.stderr[-2000:]
    (archive,) = out.glob("*.tar.gz")
    with tarfile.open(archive) as tar:
        return {name.partition("/")[2] for name in tar.getnames()}


def test_it_holds_what_builds_and_tests_the_project(names: set[str]) -> None:
    wanted = {
        "pyproject.toml",
        "LICENSE",
        "NOTICES",
        "README.md",
        "SECURITY.md",
        "CHANGELOG.md",
        "CITATION.cff",
        "mkdocs.yml",
    }
    wanted |= {"src/native/cmake/CMakeLists.txt", "tests/conftest.py", "scripts/test", "workshop/__init__.py"}
    assert sorted(wanted - names) == []


def test_it_holds_nothing_that_was_compiled(names: set[str]) -> None:
    """A module that was compiled in this checkout would get into the wheels of other versions of Python."""
    assert sorted(name for name in names if re.search(r"\.(so|pyd|dylib|pyc|o|whl)$", name)) == []
