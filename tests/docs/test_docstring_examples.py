"""What has its name at the top shows how it is used, and the examples do what they say."""

from __future__ import annotations

import doctest
import inspect
from functools import cache
from pathlib import Path

import pytest
from cases import each

import elastic_strips as es

NAMES = [name for name in es.__all__ if name != "__version__"]


@each("name", NAMES)
def test_the_examples_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = inspect.getdoc(getattr(es, name)) or ""
    monkeypatch.setattr(es, "load_robot", _robot, raising=False)
    examples = doctest.DocTestParser().get_doctest(text, {"es": es}, f"es.{name}", None, 0)
    assert examples.examples, "it has no example"
    said: list[str] = []
    assert not doctest.DocTestRunner().run(examples, out=said.append).failed, "".join(said)


_load = es.load_robot  # before it is replaced


@cache
def _robot(name: str) -> es.RobotModel:
    """Robots do not change, and loading one takes longer than most examples."""
    return _load(name)
