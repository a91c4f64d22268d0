"""Marks that tests get by what they do: found in what their code refers to, measured, and watched while they run."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from multiprocessing import util
from pathlib import Path
from types import CodeType, FunctionType, ModuleType

import pytest

TESTS = Path(__file__).parents[1]
_BY_FIXTURE = {"browser": "browser", "chromium": "browser", "wheel": "wheel", "served": "process", "live": "process"}
_PROGRAMS = {
    "subprocess",
    "multiprocessing",
    "MachineProcess",
    "ExecutorProcess",
    "GuardProcess",
    "make_realtime",
    "run_jobs",
}
"""Who refers to one of these starts processes."""
_MAY_START = ("process", "browser", "wheel", "notebook")
_UNITS = ("unit", "property")
_SLOW = TESTS / "slow.txt"
_LONG = 0.12  # [s] of a processor, all cases of a test together
_THOROUGH = TESTS / "thorough.txt"


def slow() -> set[str]:
    """The tests that were measured to be slow, as ``unit/room/test_file.py::test_name``."""
    return set(_SLOW.read_text(encoding="utf-8").split())


@cache
def thorough() -> dict[str, tuple[str, ...]]:
    """The tests that show more of what others show, and what stays without them: ``[case]`` of its own, or a test."""
    found: dict[str, tuple[str, ...]] = {}
    for line in _THOROUGH.read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            name, _, stays = line.partition(" keeps ")
            assert name not in found, f"{name} is listed twice"
            found[name] = tuple(re.findall(r"\[.*?\](?= \[|$)|[^\s\[]\S*", stays))
    return found


def kept_cases(item: pytest.Item) -> tuple[str, ...]:
    """The cases of a thorough test that stay without it; none where all of it goes, or stays."""
    kept = thorough().get(name_of(item.nodeid), ())
    return tuple(case[1:-1] for case in kept if case.startswith("["))


def _is_thorough(item: pytest.Function) -> bool:
    """Whether nothing of a test stays. Of one that goes through its cases by itself (``each``), some of them stay."""
    if name_of(item.nodeid) not in thorough():
        return False
    kept = kept_cases(item)
    callspec = getattr(item, "callspec", None)
    return not kept or (callspec is not None and callspec.id not in kept)


def check_kept(items: Iterable[pytest.Item]) -> None:
    """Raise an error where a case that is to stay is none of its test, so that the test would be left out unnoticed."""
    cases: dict[str, set[str]] = {}
    for item in items:
        callspec = getattr(item, "callspec", None)
        if callspec is not None and name_of(item.nodeid) in thorough():
            cases.setdefault(name_of(item.nodeid), set()).add(callspec.id)
    for name, found in cases.items():
        kept = {stays[1:-1] for stays in thorough()[name] if stays.startswith("[")}
        if len(found) > 1 and not kept <= found:  # of one alone somebody has asked for a case
            raise pytest.UsageError(f"tests/thorough.txt: {name} has no case {sorted(kept - found)}")


def measured(seconds: dict[str, float]) -> None:
    """Write down which of these tests are slow; what is known of others stays."""
    known = {name for name in slow() if name not in seconds}
    known |= {name for name, took in seconds.items() if took > _LONG}
    _SLOW.write_text("".join(f"{name}\n" for name in sorted(known)), encoding="utf-8")


def name_of(nodeid: str) -> str:
    """Of a test in the list of slow ones: without its cases."""
    return nodeid.split("[")[0].removeprefix("tests/")


def mark(item: pytest.Item, listed: set[str]) -> None:
    """Mark a test by its fixtures, by what its code refers to, and as slow or thorough where it is listed."""
    assert isinstance(item, pytest.Function)
    if name_of(item.nodeid) in listed:
        item.add_marker("slow")
    if _is_thorough(item):
        item.add_marker("thorough")
    for fixture, name in _BY_FIXTURE.items():
        if fixture in item.fixturenames:
            item.add_marker(name)
    definitions = item._fixtureinfo.name2fixturedefs  # pytest has no public way to a fixture's function
    functions = [item.function, *(d.func for many in definitions.values() for d in many)]
    if _PROGRAMS & _referred(tuple(functions)):
        item.add_marker("process")


@cache
def _referred(functions: tuple[object, ...]) -> set[str]:
    """Names of modules, classes and functions that these refer to, through functions and classes of the tests."""
    found: set[str] = set()
    seen: set[int] = set()
    todo = list(functions)
    while todo:
        one = inspect.unwrap(todo.pop())  # pyright: ignore[reportArgumentType]
        if id(one) in seen:
            continue
        seen.add(id(one))
        if isinstance(one, type):
            todo += [member for member in vars(one).values() if isinstance(member, FunctionType)]
        if not isinstance(one, FunctionType):
            continue
        for name in _names(one.__code__):
            value = one.__globals__.get(name)
            if isinstance(value, ModuleType):
                found.add(value.__name__.partition(".")[0])
            elif isinstance(value, (FunctionType, type)):
                found.add(value.__name__)
                if _is_ours(value.__module__):
                    todo.append(value)
    return found


@cache
def _is_ours(module: str) -> bool:
    """Whether a module is one of the tests'."""
    file = getattr(sys.modules.get(module), "__file__", None)
    return file is not None and TESTS in Path(file).parents


@cache
def _names(code: CodeType) -> set[str]:
    inner = [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    return set(code.co_names).union(*map(_names, inner))


_running: pytest.Item | None = None


@contextmanager
def guarded(item: pytest.Item) -> Iterator[None]:
    """While a unit runs that is not said to start processes, none can be started."""
    global _running
    _running = item if any(TESTS / folder in item.path.parents for folder in _UNITS) else None
    try:
        yield
    finally:
        _running = None


def _watch(event: str, arguments: tuple[object, ...]) -> None:
    if _running is None or event not in ("subprocess.Popen", "os.fork", "os.posix_spawn"):
        return
    program = Path(str(arguments[0])).name if arguments else "python"
    if program.startswith(("python", "chrom", "google-chrome", "bash")) and not _importing():
        _refuse(program)


def _importing() -> bool:
    """Whether a module is read just now: what some start then is started by whoever is first."""
    frame = sys._getframe()
    while frame is not None and not frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    return frame is not None


def _refuse(program: str) -> None:
    if _running is not None and not any(map(_running.get_closest_marker, _MAY_START)):
        raise RuntimeError(f"{_running.nodeid} starts {program}: it needs the mark 'process'")


def _spawned(path: object, *arguments: object) -> object:
    _refuse(str(path))
    return _spawn(path, *arguments)  # pyright: ignore[reportArgumentType, reportCallIssue]


_spawn, util.spawnv_passfds = util.spawnv_passfds, _spawned  # multiprocessing does not ask by an event
sys.addaudithook(_watch)
