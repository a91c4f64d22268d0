"""xacro in a process of its own, with bounds on its time and memory.

A xacro file is a program: an expression can ask for more digits than there is time, a macro can double itself thirty
times. The package ``xacro`` runs in a child that the system ends then, and this module is all that the child imports.
"""

from __future__ import annotations

import importlib
import io
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import BinaryIO

from elastic_strips.errors import RobotError, missing_extra
from elastic_strips.files import note_input, read_input
from elastic_strips.packages import package_of
from elastic_strips.summary import shortened

MAX_BYTES = 8_000_000
"""Of one file that describes a robot: xacro, URDF or SRDF."""
_MOST_EXPANDED_BYTES = 50_000_000  # of what they expand to
_PROCESSOR_TIME, _CLOCK_TIME = 3, 4.2  # [s] at most: a bomb is over within five seconds
_MOST_MEMORY = 1_500_000_000  # [bytes]
_CHILD = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from elastic_strips.xacro_process import run; run()"


def expanded(source: Path, mappings: Mapping[str, str], folders: Sequence[Path]) -> tuple[str, list[str]]:
    """The URDF that xacro makes of a file, and the lines of its messages.

    Args:
        source: the file.
        mappings: arguments by name.
        folders: folders in which packages lie.

    Raises:
        RobotError: xacro refuses the file, or needs too much time or memory.
        MissingExtraError: xacro is not installed.
    """
    try:
        importlib.import_module("xacro")
    except ModuleNotFoundError:
        raise missing_extra(f"the robot of {source.name}", "xacro") from None
    task = {"source": str(source), "mappings": dict(mappings), "folders": [str(f) for f in folders]}
    command = [sys.executable, "-c", _CHILD, json.dumps(sys.path)]
    try:
        ended = subprocess.run(command, input=json.dumps(task).encode(), capture_output=True, timeout=_CLOCK_TIME)
    except subprocess.TimeoutExpired:
        raise _too_much(source, f"is not done after {_CLOCK_TIME} s") from None
    except OSError as error:
        raise RobotError(f"{source}: xacro cannot be started: {error.strerror or error}") from None
    try:
        answer = json.loads(ended.stdout)
    except ValueError:  # it was ended
        if ended.returncode == -getattr(signal, "SIGXCPU", 0):
            raise _too_much(source, f"takes more than {_PROCESSOR_TIME} s of a processor") from None
        raise _too_much(source, f"ended its process (code {ended.returncode})") from None
    for file in answer["files"]:
        note_input(file)
    if "error" in answer:
        raise RobotError(answer["error"])
    return answer["document"], answer["said"]


def _too_much(source: Path, what: str) -> RobotError:
    return RobotError(
        f"{source}: xacro cannot expand it: it {what}; a file may take {_PROCESSOR_TIME} s and "
        f"{_MOST_MEMORY // 1_000_000} MB. Does a macro call itself, or an expression make something huge?"
    )


def run() -> None:
    """The child: answers on standard output what is asked on standard input."""
    _bound()
    task = json.loads(sys.stdin.buffer.read())
    files: list[str] = []
    answer: dict[str, object] = {"files": files}
    try:
        folders = [Path(folder) for folder in task["folders"]]
        answer["document"], answer["said"] = _expand(Path(task["source"]), task["mappings"], folders, files)
    except RobotError as error:
        answer["error"] = str(error)
    sys.stdout.buffer.write(json.dumps(answer).encode())


def _bound() -> None:
    """The system ends this process where it takes too much; Ctrl-C is for its parent."""
    with suppress(ValueError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        import resource
    except ImportError:  # Windows: its parent waits no longer than `_CLOCK_TIME`
        return
    for kind, most in (("RLIMIT_CPU", _PROCESSOR_TIME), ("RLIMIT_AS", _MOST_MEMORY), ("RLIMIT_CORE", 0)):
        with suppress(AttributeError, ValueError, OSError):  # macOS bounds no address space
            number = getattr(resource, kind)
            _, hard = resource.getrlimit(number)
            bound = most if hard == resource.RLIM_INFINITY else min(most, hard)
            resource.setrlimit(number, (bound, hard))


def _expand(source: Path, mappings: dict[str, str], folders: list[Path], files: list[str]) -> tuple[str, list[str]]:
    """The document and what xacro says; all files that are opened are added to ``files``."""
    xacro = importlib.import_module("xacro")
    arguments = importlib.import_module("xacro.substitution_args")
    said, given = io.StringIO(), _Arguments(mappings)
    with redirect_stderr(said), redirect_stdout(said):
        arguments._eval_find = arguments._eval_dict["find"] = _finder(folders, arguments._eval_find)
        vars(xacro)["open"] = _opener(files)
        try:
            document: bytes = xacro.process_file(str(source), mappings=given, verbosity=1).toxml(encoding="utf-8")
        except Exception as error:  # of xacro, expat, what an expression raises, what an include cannot open
            macros = [(m.body.getAttribute("name"), m.history[-1][-1]) for m in reversed(xacro.macrostack or [])]
            stack = dict.fromkeys(str(f) for f in [*(f for _, f in macros), *reversed(xacro.filestack or [])] if f)
            where = _place(error, tuple(stack)) or next(iter(stack), str(source))
            within = list(dict.fromkeys(f"macro {name!r}" for name, _ in macros))[:4]  # one that calls itself: once
            if where.removeprefix(str(source))[:1] not in ("", ":"):
                within.append(f"of {source}")
            inside = f" ({', '.join(within)})" if within else ""
            raise RobotError(f"{where}: xacro cannot expand it{inside}: {_words(error)}") from None
    if len(document) > _MOST_EXPANDED_BYTES:
        raise RobotError(f"{source}: xacro makes {len(document)} bytes of it; at most {_MOST_EXPANDED_BYTES} are read")
    lines = filter(None, (line.strip() for line in said.getvalue().splitlines()[:20]))
    return document.decode(), [shortened(line, 300) for line in (*lines, *_assumed(mappings, given))]


class _Arguments(dict[str, str]):
    """Arguments of a file, and which of them it has asked for; xacro adds those that it has defaults of."""

    def __init__(self, given: Mapping[str, str]) -> None:
        super().__init__(given)
        self.asked: set[object] = set()

    def __contains__(self, name: object) -> bool:
        self.asked.add(name)
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.asked.add(name)
        return super().__getitem__(name)


def _assumed(mappings: Mapping[str, str], arguments: _Arguments) -> list[str]:
    """Notes about arguments that nobody gave, and about those that the file does not use: it may be another robot."""
    said = []
    defaults = [f"{name} = {value!r}" for name, value in arguments.items() if name not in mappings]
    if defaults:
        others = "--xacro-arg NAME=VALUE, mappings= give others"
        said.append(f"arguments at their defaults ({others}): {', '.join(defaults)}")
    unasked = [name for name in mappings if name not in arguments.asked]
    if unasked:
        valid = ", ".join(sorted(map(str, arguments.asked))) or "none"
        said.append(f"mappings that the file asks nowhere for: {', '.join(unasked)}; it asks for {valid}")
    return said


def _opener(files: list[str]) -> Callable[[str], BinaryIO]:
    """What opens a file for xacro: a regular one, of a size that is accepted; xacro itself says that there is none."""

    def opened(path: str) -> BinaryIO:
        if not os.path.exists(path):
            return open(path, "rb")
        files.append(os.path.abspath(path))
        return io.BytesIO(read_input(path, "xacro file", MAX_BYTES, RobotError))

    return opened


class _NoPackage(LookupError):
    """What ``$(find package)`` names is nowhere."""

    def __init__(self, package: str, searched: str) -> None:
        super().__init__(f"package {package!r} not found (searched {searched}, …)")
        self.package = package


def _finder(folders: list[Path], usual: Callable[[str], str]) -> Callable[[str], str]:
    """What resolves ``$(find package)``: in these folders first, then as xacro does where ROS is installed."""

    def find(package: str) -> str:
        found = next((f / package for f in folders if os.path.isdir(f / package)), None)
        found = found or package_of(package, folders)
        if found is not None:
            return str(found)
        try:
            return usual(package)
        except ModuleNotFoundError:  # without ROS
            searched = ", ".join(str(f) for f in folders[:4])
            raise _NoPackage(package, searched) from None

    return find


def _words(error: Exception) -> str:
    """What an error says, on one line, or what it is where it says nothing."""
    inner, said = getattr(error, "exc", None), str(error)
    if inner is not None and said.count(str(inner)) > 1:  # xacro's own words are the inner error's once more
        said = f"{inner} {getattr(error, 'suffix', None) or ''}"
    return shortened(" ".join(said.split()), 300) or type(error).__name__


def _place(error: Exception, files: tuple[str, ...]) -> str:
    """``file:line`` where the first of the files has what cannot be evaluated, or nothing: xacro knows no lines."""
    sought = re.search(r"when evaluating expression '(.*)'", str(error), re.DOTALL)
    wanted = f"${{{sought[1]}}}" if sought else ""
    while (inner := getattr(error, "exc", None)) is not None:
        error = inner
    if isinstance(error, _NoPackage):
        wanted = f"$(find {error.package})"
    elif type(error).__name__ == "ArgException":  # of xacro.substitution_args
        wanted = f"$(arg {error})"
    for file in files if wanted else ():
        try:
            text = Path(file).read_text(encoding="utf-8", errors="replace")
        except OSError:
            continue
        if wanted in text:
            return f"{file}:{text[: text.index(wanted)].count(chr(10)) + 1}"
    return ""
