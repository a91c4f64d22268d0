"""``elastic-strips doctor``: what is installed here, whether it works, and what to do where it does not.

It imports nothing that may be broken: a process of its own does, and if that dies the next one goes on.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib import metadata
from importlib.machinery import all_suffixes
from pathlib import Path

import click

from elastic_strips._version import __version__
from elastic_strips.catalogue import own_robots, robot_names
from elastic_strips.errors import RobotError, install_command, plural

from . import options, output

OK, NOTE, PROBLEM = "ok", "note", "problem"
""""ok": works; "note": only some uses need it; "problem": the core does not work."""
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_COLOURS = {OK: output.GOOD, NOTE: output.NOTE, PROBLEM: output.BAD}
_DISTRIBUTION = "elastic-strips"
_UNTRIED = ("dev", "docs", "notebooks")  # their packages are programs, or slow to import
_IMPORTED = tuple(all_suffixes())
_CHECK_TIMEOUT = 300.0  # [s] after which a process is taken for hung

_PROBE = """
import importlib, json, sys
given = json.loads(sys.argv[1])
sys.path[:] = given["path"]
for name in given["names"]:
    said = None
    try:
        importlib.import_module(name)
    except BaseException as error:
        said = " ".join(f"{type(error).__name__}: {error}".split())[:300]
    print("PROBED", json.dumps([name, said]), flush=True)
"""
_KERNEL = """
import json, sys
sys.path[:] = json.loads(sys.argv[1])["path"]
from elastic_strips.cli.doctor_command import compare_kernel
print("PROBED", json.dumps(compare_kernel()), flush=True)
"""

_ROBOT = """
import json, logging, sys
given = json.loads(sys.argv[1])
sys.path[:] = given["path"]
logging.disable(logging.CRITICAL)
from elastic_strips.errors import ElasticStripsError
from elastic_strips.robot import load_robot
try:
    card = load_robot(given["names"][0]).card()
    said = [["note", trouble] for trouble in card.troubles]
    said.append(["ok", f"{card.base}; elastic-strips robot {given['names'][0]} shows all"])
except ElasticStripsError as error:
    said = [["problem", str(error)]]
for each in said:
    print("PROBED", json.dumps(each), flush=True)
"""


@dataclass(frozen=True, slots=True)
class Check:
    """One line of the doctor.

    Attributes:
        name: what was checked.
        status: ``"ok"``, ``"note"`` or ``"problem"``.
        text: what was found, and what to do about it.
    """

    name: str
    status: str
    text: str


@click.command()
@options.robot_option(
    help="Check a robot as well: what is not proven about it, and where two readers of its URDF disagree."
)
@options.json_option("Write the findings.")
def doctor(robot: str | None, json_file: str | None) -> int:
    """Check this installation: versions, the native kernel, extras, robots, browser, folders and the machine.

    Each line is ok, a note (something that only some uses need), or a problem (the core does not work as it is).

    Exit code 0: no problem. 3: a problem.
    """
    checks: list[Check] = []
    with options.LateProgress("looking") as bar:
        for check in examine(robot):
            checks.append(check)
            bar.step(check.name)
    rows = [(check.name, (check.status, _COLOURS[check.status]), check.text) for check in checks]
    output.show(
        lambda: output.table(("", "", ""), rows),
        "\n".join(f"{check.status:<8} {check.name:<22} {check.text}" for check in checks),
    )
    problems = sum(check.status == PROBLEM for check in checks)
    count = "no problems" if not problems else plural(problems, "problem")
    output.say(output.verdict(count, not problems))
    document = {
        "format": "elastic-strips-doctor",
        "version": 1,
        "problems": problems,
        "checks": [asdict(c) for c in checks],
    }
    output.write_document("answer", json_file, document)
    return options.EXIT_DONE if not problems else options.EXIT_NOT_DONE


def examine(robot: str | None = None) -> Iterator[Check]:
    """Every check, one after the other; that of a robot where one is given."""
    yield Check(_DISTRIBUTION, OK, f"{__version__} in {Path(__file__).parents[1]}")
    yield Check("python", OK, f"{platform.python_version()}, {platform.platform()}, {sys.executable}")
    wanted, extras = _requirements()
    core = list(wanted)
    if not core:
        yield Check("packages", NOTE, f"{_DISTRIBUTION} is not installed as a package: what it needs is not known")
    tried = [name for extra, names in extras.items() if extra not in _UNTRIED for name in names]
    said = _import_all(
        [m for m in (_module(n) for n in dict.fromkeys([*core, *(n for n in tried if _version(n))])) if m]
    )
    broken = False
    for name in core:
        check = _package(name, wanted[name], said.get(_module(name)))
        broken |= check.status == PROBLEM
        yield check
    yield Check("native kernel", NOTE, "not checked: it needs something that is broken") if broken else _kernel()
    for extra, names in extras.items():
        yield _extra(extra, names, said)
    if robot is not None:
        yield from _one_robot(robot)
    yield from (look() for look in (_robots, _chromium, _working_folder, _temporary_folder, _port, _processors))


def compare_kernel() -> tuple[str, str]:
    """Status and text of the native kernel: a tick and the certificate by it and by NumPy, in one small scene."""
    import numpy as np

    from elastic_strips import native
    from elastic_strips.planning import straight_line
    from elastic_strips.robot import load_robot
    from elastic_strips.scene import Box, Scene, Sphere
    from elastic_strips.strip import Deformer, Strip

    if native.kernel() is None:
        return NOTE, f"{native.ABSENT}: NumPy computes, several times slower"
    robot = load_robot("silvermate")
    scene = Scene([Box((0.6, 0.6, 1.4), at=(1.5, 0.9, 0.7)), Sphere(0.25, at=(2.4, -0.8, 1.0))])
    line = straight_line(robot, robot.home(x=0.0), robot.home(x=4.0), spacing=0.13)
    strip = Strip.from_coordinates(robot, line)
    one = Deformer(robot).step(strip, scene)
    with native.twin():
        two = Deformer(robot).step(strip, scene)
    if len(one.strip) != len(two.strip) or one.certified != two.certified:
        return PROBLEM, "loaded, but contradicts NumPy: set ELASTIC_STRIPS_NATIVE=0, and reinstall elastic-strips"
    moved = float(np.abs(one.strip.coordinates - two.strip.coordinates).max())
    apart = abs(one.clearance - two.clearance)
    if not (moved < 1e-4 and apart < 1e-6):  # as far as Coal's iterations may end elsewhere
        return PROBLEM, (
            f"loaded, but differs from NumPy by {max(moved, apart):.1e} m: set ELASTIC_STRIPS_NATIVE=0, and install "
            "elastic-strips again"
        )
    return OK, f"loaded; a tick differs from NumPy's by {max(moved, apart):.0e}"


def _requirements() -> tuple[dict[str, str], dict[str, list[str]]]:
    """Distributions that the core needs, with their ranges of versions; names of those of each extra but ``dev``."""
    try:
        lines = metadata.requires(_DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        return {}, {}
    core: dict[str, str] = {}
    extras: dict[str, list[str]] = {}
    for line in lines:
        text, _, marker = line.partition(";")
        name = re.split(r"[^\w.-]", text.strip(), maxsplit=1)[0].lower()
        if "python_version" in marker:  # a bound for an old Python: its package is needed by another one
            continue
        found = re.search(r"""extra\s*==\s*['"]([\w.-]+)['"]""", marker)
        if found is None:
            core[name] = text.strip()[len(name) :].strip()
        elif found.group(1) != "dev":
            extras.setdefault(found.group(1), []).append(name)
    return core, extras


@cache
def _module(distribution: str) -> str:
    """The module that a package is imported by, as its list of files has it; empty where there is none."""
    usual = distribution.replace("-", "_")
    try:
        files = metadata.files(distribution)
    except metadata.PackageNotFoundError:
        files = None
    if files is None:
        return usual
    names: dict[str, None] = {}
    for file in files:
        parts = file.parts
        if "site-packages" in parts:  # in a folder that is on the path by itself
            parts = parts[parts.index("site-packages") + 1 :]
        name = parts[0].split(".")[0] if len(parts) == 1 else parts[0]
        if file.name.endswith(_IMPORTED) and name.isidentifier() and not name.startswith("_"):
            names[name] = None
    return usual if usual in names else next(iter(names), "")


def _version(distribution: str) -> str | None:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def _run(program: str, names: Sequence[str] = ()) -> tuple[list[tuple[str, str | None]], str]:
    """The output of a program in a process of its own, and how it ended if it did not end well."""
    given = json.dumps({"path": sys.path, "names": list(names)})
    try:
        done = subprocess.run(
            [sys.executable, "-c", program, given],
            capture_output=True,
            text=True,
            timeout=_CHECK_TIMEOUT,
            errors="replace",
        )
    except subprocess.TimeoutExpired:
        return [], f"hangs: no answer for {_CHECK_TIMEOUT:.0f} s"
    except OSError as error:
        return [], str(error)
    found = [json.loads(line[7:]) for line in done.stdout.splitlines() if line.startswith("PROBED ")]
    if done.returncode == 0:
        return found, ""
    last = (done.stderr.strip().splitlines() or [""])[-1][:300]
    how = f"by signal {-done.returncode}" if done.returncode < 0 else f"with exit code {done.returncode}"
    return found, f"ends the process {how}{': ' if last else ''}{last}"


def _import_all(modules: Sequence[str]) -> dict[str, str | None]:
    """Module → what its import said, or None where it went well."""
    said: dict[str, str | None] = {}
    while left := [name for name in modules if name not in said]:
        found, ended = _run(_PROBE, left)
        said.update(found)
        if len(found) < len(left):
            said[left[len(found)]] = ended or "says nothing"
    return said


def _package(name: str, wanted: str, said: str | None) -> Check:
    version = _version(name)
    if version and not _within(version, wanted):
        return Check(name, PROBLEM, f"{version}, and {wanted} is needed: pip install '{name}{wanted}'")
    if said is None and (version is not None or _module(name)):
        return Check(name, OK, version or "installed, without a version")
    install = f"pip install --force-reinstall {name}" if version else f"pip install {name}"
    if name == "example-robot-data":  # only its robots need it
        return Check(name, NOTE, f"not installed: {install}")
    return Check(name, PROBLEM, f"{version or 'not installed'}: {said}: {install}")


def _within(version: str, wanted: str) -> bool:
    """Whether a version is in a range, if ``packaging`` is installed, which the core does not need."""
    try:
        from packaging.specifiers import SpecifierSet

        return SpecifierSet(wanted).contains(version, prereleases=True)
    except (ImportError, ValueError):
        return True


def _kernel() -> Check:
    found, ended = _run(_KERNEL)
    if not found:
        return Check("native kernel", PROBLEM, f"{ended}; ELASTIC_STRIPS_NATIVE=0 turns it off")
    status, text = found[0]
    return Check("native kernel", status, text or "")


def _one_robot(name: str) -> list[Check]:
    """What a robot's card reports."""
    found, ended = _run(_ROBOT, [name])
    if not found:
        return [Check(f"robot {name}", PROBLEM, ended)]
    return [Check(f"robot {name}", str(status), text or "") for status, text in found]


def _extra(extra: str, names: Sequence[str], said: dict[str, str | None]) -> Check:
    missing = [name for name in names if _version(name) is None]
    if missing:
        return Check(f"extra {extra}", NOTE, f"{', '.join(missing)} missing: {install_command(extra)}")
    for name in names:
        if text := said.get(_module(name)):
            return Check(f"extra {extra}", NOTE, f"{name} is broken: {text}: pip install --force-reinstall {name}")
    return Check(f"extra {extra}", OK, ", ".join(f"{name} {_version(name)}" for name in names))


def _robots() -> Check:
    try:
        count, own = len(robot_names()), own_robots()
    except RobotError as error:
        return Check("robots", PROBLEM, str(error))
    if "tiago" not in own:
        return Check("robots", NOTE, f"{', '.join(own)}; no others without example-robot-data")
    return Check("robots", OK, f"{', '.join(own)}, and {count - len(own)} more of example-robot-data")


def _chromium() -> Check:
    """For pictures of pages, by scripts and tests; the viewer takes any browser."""
    for name in (os.environ.get("CHROMIUM", ""), *BROWSERS):
        if name and (place := shutil.which(name)):
            return Check("chromium", OK, place)
    return Check(
        "chromium",
        NOTE,
        "not found: pages open in any browser, but there are no pictures of them (Debian: apt-get install chromium)",
    )


def _writes(folder: str) -> str:
    """Why no file can be written into a folder; empty where one can."""
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"x")
    except OSError as error:
        return error.strerror or str(error)
    return ""


def _working_folder() -> Check:
    said = _writes(".")
    name = os.getcwd() if not said else "."
    return Check("working folder", NOTE if said else OK, f"{name}: not writable: {said}" if said else name)


def _temporary_folder() -> Check:
    try:
        folder = tempfile.gettempdir()
    except OSError as error:
        return Check("temporary folder", NOTE, str(error))
    free = shutil.disk_usage(folder).free / 1e9
    return Check("temporary folder", OK, f"{folder}, {free:.1f} GB free")


def _port() -> Check:
    try:
        with socket.create_server(("127.0.0.1", 0)) as server:
            return Check("loopback port", OK, f"free, such as {server.getsockname()[1]}")
    except OSError as error:
        return Check("loopback port", NOTE, f"none is available, so there is no live viewer; --html works: {error}")


def _processors() -> Check:
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    busy = load > count
    text = f"{count} for this process, load {load:.1f}" + (
        ": measured times will be those of a busy machine" if busy else ""
    )
    return Check("processors", NOTE if busy else OK, text)
