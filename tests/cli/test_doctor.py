"""The doctor: what it finds here, and that nothing which is broken keeps it from saying so."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from command_line import CALL

from elastic_strips import native
from elastic_strips.cli import doctor_command
from elastic_strips.cli.doctor_command import NOTE, OK, PROBLEM, Check, compare_kernel
from elastic_strips.errors import install_command

URDF = """<robot name="r"><link name="base"><collision><geometry><box size="0.5 0.4 0.2"/></geometry></collision></link>
<link name="arm"><visual><geometry><box size="0.4 0.1 0.1"/></geometry></visual></link>
<joint name="yaw" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.5"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="2"/></joint></robot>"""
"""Nothing is proven about its arm, which is only drawn."""


def _doctor(folder: Path, *arguments: str, **packages: str) -> tuple[int, dict[str, Any], dict[str, dict[str, str]]]:
    """Exit code, document and its checks by name; with some modules replaced by others."""
    for name, text in packages.items():
        (folder / f"{name}.py").write_text(text)
    path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [*CALL, "doctor", "--json", "-", *arguments], capture_output=True, text=True, timeout=240, cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert "Traceback" not in done.stderr, done.stderr
    document = json.loads(done.stdout)
    return done.returncode, document, {check["name"]: check for check in document["checks"]}


def test_where_everything_works_there_is_no_problem(tmp_path: Path) -> None:
    (tmp_path / "r.urdf").write_text(URDF)
    code, document, checks = _doctor(tmp_path, "--robot", "r.urdf")
    assert code == 0, document
    assert document["problems"] == 0
    assert {check["status"] for check in checks.values()} <= {OK, NOTE}
    assert not [check for check in checks.values() if "is broken" in check["text"]]
    for name in ("python", "pin", "coal", "ompl", "numpy", "native kernel", "extra sim", "robots", "chromium",
                 "working folder", "temporary folder", "loopback port", "processors"):  # fmt: skip
        assert name in checks
    assert "extra dev" not in checks
    assert "silvermate" in checks["robots"]["text"]
    of_robot = [check for check in document["checks"] if check["name"] == "robot r.urdf"]
    assert [check["status"] for check in of_robot].count(NOTE) == 1
    assert any("arm" in check["text"] for check in of_robot)


def test_a_package_is_imported_by_its_modules_name() -> None:
    """Which is not its distribution's: pip calls PIL pillow, and yaml pyyaml."""
    known = {"pillow": "PIL", "pyyaml": "yaml", "pin": "pinocchio", "u-msgpack-python": "umsgpack", "numpy": "numpy",
             "rosbags": "rosbags", "py_trees": "py_trees", "coal": "coal", "example-robot-data": ""}  # fmt: skip
    for distribution, module in known.items():
        if doctor_command._version(distribution) is not None:
            assert doctor_command._module(distribution) == module
    assert doctor_command._module("no-such-package") == "no_such_package"
    needed = {re.split(r"[^\w.-]", text)[0] for text in metadata.requires("elastic-strips") or ()}
    modules = {name: doctor_command._module(name) for name in needed if doctor_command._version(name) is not None}
    assert not {name: module for name, module in modules.items() if module and find_spec(module) is None}


def test_what_is_broken_is_a_line_each(tmp_path: Path) -> None:
    """One package that raises, one that kills whoever imports it, one that only colours, and one of an extra."""
    code, document, checks = _doctor(
        tmp_path, lxml="raise ImportError('libxml2.so.2: cannot open it')", coal="import os; os.abort()",
        rich="raise ImportError('no rich')", mujoco="raise RuntimeError('no such GPU')",
    )  # fmt: skip
    assert code == 3
    broken = {name for name, check in checks.items() if check["status"] == PROBLEM}
    assert {"lxml", "coal", "rich"} <= broken <= {"lxml", "coal", "rich", "pin", "yourdfpy"}, document
    assert "libxml2.so.2" in checks["lxml"]["text"]
    assert "signal" in checks["coal"]["text"]
    assert checks["native kernel"]["status"] == NOTE
    assert checks["numpy"]["status"] == OK, "what comes after the one that died is looked at all the same"
    if "missing" not in checks["extra sim"]["text"]:
        assert "no such GPU" in checks["extra sim"]["text"]
    assert checks["extra sim"]["status"] == NOTE


def test_a_kernel_that_computes_something_else_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    if native.kernel() is None:
        pytest.skip("the native kernel is not compiled here")
    assert compare_kernel()[0] == OK
    from elastic_strips.collision import narrowphase

    exact = narrowphase.PairSolver.ask
    monkeypatch.setattr(narrowphase.PairSolver, "ask", lambda self, *given: exact(self, *given) + 1e-3)
    status, text = compare_kernel()
    assert status == PROBLEM
    assert "ELASTIC_STRIPS_NATIVE=0" in text
    with native.twin():
        assert compare_kernel()[0] == NOTE


def test_what_is_missing_or_of_another_version_has_its_command(monkeypatch: pytest.MonkeyPatch) -> None:
    versions: dict[str, str | None] = {"one": "1.0", "other": None, "pin": "3.9"}
    monkeypatch.setattr(doctor_command, "_version", versions.get)
    assert doctor_command._extra("most", ["one", "other"], {}) == Check(
        "extra most", NOTE, f"other missing: {install_command('most')}"
    )
    assert doctor_command._extra("most", ["one"], {"one": None}).status == OK
    assert doctor_command._package("other", "", "ModuleNotFoundError: other").status == PROBLEM
    assert doctor_command._package("one", "", None).status == OK
    pytest.importorskip("packaging")
    assert "pip install 'pin>=4.1,<5'" in doctor_command._package("pin", ">=4.1,<5", None).text


def test_folders_and_ports_that_cannot_be_had_are_notes(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(doctor_command.tempfile, "TemporaryFile", refuse)
    monkeypatch.setattr(doctor_command.socket, "create_server", refuse)
    assert doctor_command._working_folder().status == NOTE
    assert "Permission denied" in doctor_command._working_folder().text
    assert doctor_command._port().status == NOTE
    monkeypatch.setenv("CHROMIUM", sys.executable)
    assert doctor_command._chromium() == Check("chromium", OK, sys.executable)
