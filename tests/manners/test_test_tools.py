"""The tools of the tests: they fail where they should, and what is listed is there."""

from __future__ import annotations

import re
import subprocess
import sys
from types import SimpleNamespace
from typing import cast

import marks
import numpy as np
import process_state
import pytest
from cases import each, refused

NOBODY = cast("pytest.FixtureRequest", None)


def test_all_cases_are_tried_and_those_that_fail_are_named() -> None:
    tried: list[int] = []

    @each("x", [1, 2, 3, 4])
    def check(x: int) -> None:
        tried.append(x)
        assert x % 2, f"{x} is even"

    with pytest.raises(AssertionError) as caught:
        check(request=NOBODY)
    assert tried == [1, 2, 3, 4]
    assert re.findall(r"\[x=(\d)\]", str(caught.value)) == ["2", "4"]


def test_a_case_that_is_left_out_hides_no_other() -> None:
    @each("x", [1, 2])
    def check(x: int) -> None:
        if x == 1:
            pytest.skip("not here")
        raise ValueError("wrong")

    with pytest.raises(AssertionError, match="1 of 2"):
        check(request=NOBODY)


def test_an_error_has_to_name_what_is_wrong() -> None:
    with refused(ValueError, "radius=0"):
        raise ValueError("radius=0 is no radius")
    with pytest.raises(AssertionError), refused(ValueError, "radius=0"):
        raise ValueError("speed=0 is no speed")
    with pytest.raises(KeyError), refused(ValueError, "radius=0"):
        raise KeyError("radius=0")
    with pytest.raises(pytest.fail.Exception), refused(ValueError, "radius=0"):
        pass


def test_what_is_listed_as_slow_is_there() -> None:
    for name in marks.slow():
        file, _, test = name.partition("::")
        text = (marks.TESTS / file).read_text(encoding="utf-8")
        assert f"\ndef {test}(" in text, f"{name} is gone: pytest --write-slow measures anew"


def test_of_what_is_thorough_something_stays() -> None:
    """What is listed is there, and so is what stays of it: cases of its own, or tests that are not listed."""
    assert marks.thorough()
    for name, stays in marks.thorough().items():
        file, _, test = name.partition("::")
        text = (marks.TESTS / file).read_text(encoding="utf-8")
        assert f"\ndef {test}(" in text, f"{name} is gone"
        assert stays, f"{name}: nothing stays of what it shows"
        for other in stays:
            if other.startswith("["):
                continue
            at, _, sibling = (other if "::" in other else f"{file}::{other}").partition("::")
            assert f"\ndef {sibling}(" in (marks.TESTS / at).read_text(encoding="utf-8"), f"{name} keeps {other}"
            rest = marks.thorough().get(f"{at}::{sibling}", ("[",))
            assert rest[0].startswith("["), f"{name} keeps {other}, which is left out as well"


def test_who_starts_a_process_is_marked_and_nobody_else_can(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert request.node.get_closest_marker("process") is not None, "found by way of what _runs calls"
    assert _runs() == 0
    nobody = SimpleNamespace(nodeid="a test", get_closest_marker=lambda name: None)
    monkeypatch.setattr(marks, "_running", nobody)
    with pytest.raises(RuntimeError, match="process"):
        _runs()


def _runs() -> int:
    return subprocess.run([sys.executable, "-c", ""], timeout=120).returncode


def test_what_is_left_set_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    before = process_state.settings()
    monkeypatch.setenv("ELASTIC_STRIPS_LEFT", "1")
    with np.printoptions(precision=3):
        changed = process_state.changed(before)
    assert [one.partition(":")[0] for one in changed] == ["environment", "print options of NumPy"]
    monkeypatch.undo()
    assert process_state.changed(before) == []
