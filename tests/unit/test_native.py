"""Which of the two kernels computes, and what is said of it."""

from __future__ import annotations

import logging
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import coal
import pytest

from elastic_strips import constants, native
from elastic_strips.robot import Kinematics, RobotModel

_ASK = "from elastic_strips.native import kernel; print(kernel() is None)"


def test_it_can_be_turned_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ELASTIC_STRIPS_NATIVE", "0")
    ended = subprocess.run([sys.executable, "-c", _ASK], capture_output=True, text=True, timeout=120, check=True)
    assert ended.stdout.strip() == "True"
    assert ended.stderr == "", "who turned it off knows"


def test_without_a_compiled_part_the_twin_computes_and_says_so(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "elastic_strips._native", None)  # as if it were not there
    monkeypatch.delattr("elastic_strips._native", raising=False)
    with caplog.at_level(logging.WARNING):
        assert native._load()[0] is None
    (record,) = caplog.records
    assert "several times slower" in record.getMessage()


def test_one_that_was_compiled_for_another_coal_is_not_used(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    other = ModuleType("elastic_strips._native")
    other.coal_version = "2.9.9"  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "elastic_strips._native", other)
    monkeypatch.setattr("elastic_strips._native", other, raising=False)
    with caplog.at_level(logging.WARNING):
        assert native._load()[0] is None
    assert "2.9.9" in caplog.text
    assert coal.__version__ in caplog.text


def test_one_of_older_sources_is_not_used(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    older = ModuleType("elastic_strips._native")
    older.coal_version = coal.__version__  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "elastic_strips._native", older)
    monkeypatch.setattr("elastic_strips._native", older, raising=False)
    with caplog.at_level(logging.WARNING):
        module, why = native._load()
    assert module is None
    assert why
    assert len(caplog.records) == 1, "it is said, once"


@pytest.mark.parametrize("change", ["another value", "one is missing", "other functions"])
def test_one_of_other_sources_is_not_used(monkeypatch: pytest.MonkeyPatch, change: str) -> None:
    if native.kernel() is None:
        pytest.skip("there is no kernel")
    from elastic_strips import _native

    other = ModuleType("elastic_strips._native")
    other.coal_version, other.interface = coal.__version__, _native.interface  # type: ignore[attr-defined]
    other.constants = dict(_native.constants)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "elastic_strips._native", other)
    monkeypatch.setattr("elastic_strips._native", other, raising=False)
    assert native._load()[0] is other
    if change == "another value":
        other.constants["GJK_EXCESS"] *= 2.0
    elif change == "one is missing":
        del other.constants["GJK_EXCESS"]
    else:
        other.interface = "of other stubs"  # type: ignore[attr-defined]
    module, why = native._load()
    assert module is None
    assert ("GJK_EXCESS" in why) == (change != "other functions")


def test_both_have_the_same_constants() -> None:
    if native.kernel() is None:
        pytest.skip("there is no kernel")
    from elastic_strips import _native

    assert {name for name in vars(constants) if name.isupper()} == set(_native.constants)


def test_a_file_that_is_no_kernel_is_not_used(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("missing.so", "text.txt"):
        monkeypatch.setenv("ELASTIC_STRIPS_NATIVE", str(tmp_path / name))
        assert native._load()[0] is None


def test_what_is_made_inside_twin_computes_in_numpy(silvermate: RobotModel) -> None:
    with native.twin():
        assert native.kernel() is None
        assert Kinematics(silvermate.tree).native is None
    if native.kernel() is not None:
        assert Kinematics(silvermate.tree).native is not None
