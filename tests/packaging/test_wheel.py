"""The wheel: holds the robots and the type marker, and works where the checkout cannot be seen."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest
import result_check

from elastic_strips import __version__

if sys.version_info >= (3, 11):
    import tomllib
else:
    tomllib = pytest.importorskip("tomli")

ROOT = Path(__file__).parents[2]

pytestmark = [
    pytest.mark.skipif(
        any(importlib.util.find_spec(name) is None for name in ("build", "scikit_build_core", "nanobind")),
        reason="build and scikit-build-core are not installed: pip install -e '.[dev]'",
    ),
]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this checkout."""
    out = tmp_path_factory.mktemp("dist")
    call = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(ROOT)]
    call.append("--config-setting=build-dir=src/native/cmake")  # the editable install's, whose object files are of use
    ended = subprocess.run(call, capture_output=True, text=True, timeout=240, check=False)
    assert ended.returncode == 0, ended.stdout[-2000:] + ended.stderr[-2000:]
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh environment with the wheel in it; the dependencies are those of this one, the library is not."""
    folder = tmp_path_factory.mktemp("fresh") / "venv"
    venv.create(folder, with_pip=False)
    python = folder / "bin" / "python"
    call = [
        sys.executable,
        "-m",
        "pip",
        "--python",
        str(python),
        "install",
        "--quiet",
        "--no-deps",
        "--no-index",
        str(wheel),
    ]
    subprocess.run(call, capture_output=True, text=True, timeout=120, check=True)
    (site,) = folder.glob("lib/python*/site-packages")
    # Paths named in a .pth file are added without reading the .pth files there, so no editable install comes along;
    # and behind the environment's own, so that where the library is installed plainly, the wheel's comes first.
    dependencies = [p for p in sys.path if "site-packages" in p]
    (site / "dependencies.pth").write_text("\n".join(dependencies) + "\n")
    return folder


def _clean() -> dict[str, str]:
    return {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}


def test_the_wheel_holds_what_it_needs(wheel: Path) -> None:
    """Robots, meshes, type marker, licence and metadata; no tests, no caches."""
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        (metadata,) = [archive.read(n).decode() for n in names if n.endswith(".dist-info/METADATA")]
        (entries,) = [archive.read(n).decode() for n in names if n.endswith(".dist-info/entry_points.txt")]
    robots = {str(p.relative_to(ROOT)) for p in (ROOT / "urdf").glob("*.?rdf")}
    meshes = {str(p.relative_to(ROOT)) for p in (ROOT / "urdf" / "meshes").glob("*.obj")}
    assert len(robots) >= 5
    assert meshes
    for name in ("py.typed", "__init__.py", "cli/group.py", *robots, *meshes):
        assert f"elastic_strips/{name}" in names
    sources = {f"elastic_strips/{p.relative_to(ROOT / 'src/elastic_strips')}" for p in (ROOT / "src").rglob("*.py")}
    assert sources == {n for n in names if n.endswith(".py")}, "programs beside the robots stay in the source"
    assert any(n.endswith("licenses/LICENSE") for n in names)
    assert any(n.endswith("licenses/NOTICES") for n in names), "of what is compiled in"
    assert not [n for n in names if "test" in n.lower() or "cache" in n.lower()]
    assert f"Version: {__version__}\n" in metadata
    assert "elastic-strips = elastic_strips.cli:main" in entries


def test_without_a_compiler_the_wheel_is_made_and_says_so(tmp_path: Path) -> None:
    """NumPy computes then, and whoever builds it is told; nothing that was compiled before gets in."""
    call = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path), str(ROOT)]
    call.append(f"--config-setting=build-dir={tmp_path / 'build'}")
    env = {**_clean(), "CC": "/no/compiler", "CXX": "/no/compiler"}
    ended = subprocess.run(call, capture_output=True, text=True, timeout=240, env=env, check=False)
    assert ended.returncode == 0, ended.stdout[-2000:] + ended.stderr[-2000:]
    (built,) = tmp_path.glob("*.whl")
    assert built.name.endswith("-py3-none-any.whl")
    with zipfile.ZipFile(built) as archive:
        names = archive.namelist()
    assert "elastic_strips/native.py" in names
    assert [name for name in names if name.endswith(".so")] == []
    with (ROOT / "pyproject.toml").open("rb") as file:
        (without,) = [o for o in tomllib.load(file)["tool"]["scikit-build"]["overrides"] if o["if"].get("failed")]
    assert without["messages"]["after-success"] in ended.stdout + ended.stderr


def test_the_installed_command_runs_outside_the_checkout(environment: Path, tmp_path: Path) -> None:
    """``elastic-strips run case-7`` with the installed robot; the result holds before the independent checker."""
    command = environment / "bin" / "elastic-strips"
    result = tmp_path / "r.json"
    call = [str(command), "run", "case-7", "--json", str(result)]
    ended = subprocess.run(call, capture_output=True, text=True, timeout=120, cwd=tmp_path, env=_clean(), check=False)
    assert ended.returncode == 0, ended
    document = json.loads(result.read_text(encoding="utf-8"))
    assert document["elastic_strips"] == __version__
    assert Path(document["urdf"]).is_relative_to(environment)
    assert result_check.check(document).faults == []


def test_the_installed_library_is_the_one_that_is_imported(environment: Path, tmp_path: Path) -> None:
    """Nothing of the checkout is on the path, and every package-level name imports."""
    program = (
        "import sys, elastic_strips as es\n"
        "assert es.__file__.startswith(sys.prefix), es.__file__\n"
        f"assert not [p for p in sys.path if p.startswith({str(ROOT / 'src')!r})], sys.path\n"
        "missing = [n for n in es.__all__ if not hasattr(es, n)]\n"
        "assert not missing, missing\n"
        "print(es.load_robot('silvermate').nq)\n"
    )
    call = [str(environment / "bin" / "python"), "-c", program]
    ended = subprocess.run(call, capture_output=True, text=True, timeout=120, cwd=tmp_path, env=_clean(), check=False)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.strip() == "11"


def test_the_types_of_the_public_surface_are_known(environment: Path, tmp_path: Path) -> None:
    """Checkers of users' programs see the types of nearly all names; nothing is left to be guessed but lazy loading."""
    path = os.pathsep.join([str(environment / "bin"), str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    call = [sys.executable, "-m", "pyright", "--verifytypes", "elastic_strips", "--ignoreexternal", "--outputjson"]
    call += ["--pythonpath", str(environment / "bin" / "python")]
    ended = subprocess.run(
        call, capture_output=True, text=True, timeout=300, cwd=tmp_path, env={**_clean(), "PATH": path}, check=False
    )
    completeness = json.loads(ended.stdout)["typeCompleteness"]
    counts = completeness["exportedSymbolCounts"]
    unknown = [s["name"] for s in completeness["symbols"] if s["isExported"] and not s["isTypeKnown"]]
    assert counts["withKnownType"] > 1000, completeness
    assert completeness["completenessScore"] > 0.985, unknown
