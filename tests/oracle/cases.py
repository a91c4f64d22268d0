"""Many cases in one test, and what an error has to name."""

from __future__ import annotations

import copy
import functools
import inspect
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager

import marks
import pytest

Test = Callable[..., None]
ROBOTS = ("silvermate", "tiago", "gantry", "rover", "column")
"""Fixtures of ``conftest.py``: every kind of base and of joint."""


def each(
    names: str | Sequence[str],
    values: Iterable[object],
    *,
    ids: Sequence[str] | Callable[[object], object] | None = None,
) -> Callable[[Test], Test]:
    """As ``pytest.mark.parametrize``, in one test: all cases are tried, and those that fail are named together.

    Every case has a folder, patches and a generator of its own, and captured output and log that begin empty.
    """
    keys = [name.strip() for name in names.split(",")] if isinstance(names, str) else list(names)
    cases: list[tuple[str, dict[str, object]]] = []
    for k, value in enumerate(values):
        label = ids[k] if isinstance(ids, Sequence) else None
        if isinstance(value, type(pytest.param())):
            row, label = tuple(value.values), value.id
        else:
            row = (value,) if len(keys) == 1 else tuple(value)  # pyright: ignore[reportArgumentType]
        assert len(row) == len(keys), f"{row} is no case of {keys}"
        named = [f"{key}={_short(ids(one) if callable(ids) else one)}" for key, one in zip(keys, row, strict=True)]
        cases.append((label or ", ".join(named), dict(zip(keys, row, strict=True))))
    assert cases, "no case"
    return lambda test: _looped(test, keys, lambda _: cases)


def each_robot(test: Test) -> Test:
    """The test with every robot of ``conftest.py``, one after the other; see :func:`each`."""
    return _looped(test, ["robot"], lambda request: [(n, {"robot": request.getfixturevalue(n)}) for n in ROBOTS])


def _looped(
    test: Test, keys: list[str], cases: Callable[[pytest.FixtureRequest], list[tuple[str, dict[str, object]]]]
) -> Test:
    signature = inspect.signature(test)
    kept = [p for p in signature.parameters.values() if p.name not in keys]
    asks = "request" in signature.parameters

    @functools.wraps(test)
    def all_of_them(request: pytest.FixtureRequest, **fixtures: object) -> None:
        if "tmp_path" in fixtures:
            definitions = request.node._fixtureinfo.name2fixturedefs  # pyright: ignore[reportAttributeAccessIssue]
            sharing = [name for name, found in definitions.items() if "tmp_path" in found[-1].argnames]
            assert not sharing, f"{sharing} share the folder that each case has to itself: parametrize this test"
        found = _of_these(request, cases(request))
        failed: list[tuple[str, BaseException]] = []
        skipped: list[pytest.skip.Exception] = []
        if asks:
            fixtures["request"] = request
        for k, (label, arguments) in enumerate(found):
            with _fresh(fixtures, k) as own:
                try:
                    test(**own, **arguments)
                except pytest.skip.Exception as reason:
                    skipped.append(reason)
                except (Exception, pytest.fail.Exception) as error:
                    failed.append((label, error))
        if failed:
            lines = [f"[{label}] {type(error).__name__}: {str(error)[:2000]}" for label, error in failed]
            raise AssertionError(f"{len(failed)} of {len(found)} cases fail:\n" + "\n".join(lines)) from failed[0][1]
        if len(skipped) == len(found):
            raise skipped[0]

    parameters = kept if asks else [inspect.Parameter("request", inspect.Parameter.POSITIONAL_OR_KEYWORD), *kept]
    all_of_them.__signature__ = signature.replace(parameters=parameters)  # pyright: ignore[reportAttributeAccessIssue]
    return all_of_them


Case = tuple[str, dict[str, object]]


def _of_these(request: pytest.FixtureRequest | None, found: list[Case]) -> list[Case]:
    """All of the cases; those that stay of a thorough test, where only they were asked for."""
    if request is None or not request.config.getoption("brief"):
        return found
    kept = marks.kept_cases(request.node)
    missing = set(kept) - {label for label, _ in found}
    assert not missing, f"tests/thorough.txt keeps {missing}, which are no cases of {[label for label, _ in found]}"
    return [case for case in found if case[0] in kept] if kept else found


@contextmanager
def _fresh(fixtures: dict[str, object], k: int) -> Iterator[dict[str, object]]:
    """What a case is not to find as the one before it left it."""
    own = dict(fixtures)
    with pytest.MonkeyPatch.context() as patches:
        if "monkeypatch" in own:
            own["monkeypatch"] = patches
        if "tmp_path" in own:
            own["tmp_path"] = own["tmp_path"] / f"case-{k}"
            own["tmp_path"].mkdir()
        if "rng" in own:
            own["rng"] = copy.deepcopy(own["rng"])
        for name, forget in (("capsys", "readouterr"), ("capfd", "readouterr"), ("caplog", "clear")):
            if name in own:
                getattr(own[name], forget)()
        yield own


def _short(value: object) -> str:
    text = getattr(value, "__name__", "") or repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


@contextmanager
def refused(error: type[Exception], *named: object) -> Iterator[pytest.ExceptionInfo[Exception]]:
    """What is done inside raises this error, and its message names each of these values or keys, in any words."""
    with pytest.raises(error) as caught:
        yield caught
    names(caught.value, *named)


def names(error: BaseException, *named: object) -> None:
    """Assert that an error's message names each of these."""
    said = str(error)
    missing = [one for one in named if str(one) not in said]
    assert not missing, f"{missing} not in: {said}"
