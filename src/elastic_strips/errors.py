"""Errors: the one tree of typed errors that this library raises on purpose.

::

    ElasticStripsError
    ├── InputError (also a ValueError): an argument or a file is wrong
    │   ├── RobotError                 a robot description
    │   ├── SceneError                 an obstacle, a motion, a scene, their files
    │   ├── ScenarioError              a scenario, a drive problem, their files
    │   ├── ConfigurationError         a configuration of a robot
    │   │   └── GoalError              no configuration reaches a goal, or no free one
    │   ├── ParameterError             a parameter
    │   ├── RecordError                the record of a run (elastic_strips.control)
    │   ├── LaserLogError              a laser log (elastic_strips.io)
    │   └── BagError                   a bag of ROS messages (elastic_strips.io)
    ├── NumericalError (also a FloatingPointError): a computation ends without a number
    ├── ThreadError (also a RuntimeError): a workspace is used by two threads at once
    ├── MissingExtraError (also an ImportError): a package that only some uses need is not installed
    ├── PerceptionError                no scene can be made of the readings (elastic_strips.sim)
    ├── PlanningError                  plan(…, certified=True) found no certified strip
    └── RetimingError                  no timing of a path was found (elastic_strips.trajectory)

An *expected* failure (a blocked or broken strip) is never raised as an error of the input: it is a status on a report,
or, where there is nothing to report on, an error that is not an `InputError`.
"""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterable, Sequence
from importlib import metadata
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

_NUMBERS = re.compile(r"-?\d[\d.]*")


class ElasticStripsError(Exception):
    """Root of every error that this library raises on purpose.

    Examples:
        >>> robot = es.load_robot("silvermate")
        >>> crate = es.Box((1.0, 1.0, 1.0), at=(3.0, 0.0, 0.5), name="crate")
        >>> try:
        ...     es.plan(robot, es.Scene([crate]), robot.home(), robot.home(x=3.0))
        ... except es.ElasticStripsError as error:
        ...     print(type(error).__name__, "crate" in str(error))
        ConfigurationError True
    """


class InputError(ElasticStripsError, ValueError):
    """An argument or a file is wrong; the message names value, bound and alternatives.

    Examples:
        >>> try:
        ...     es.Sphere(-0.1)
        ... except es.InputError as error:  # it is a ValueError, too
        ...     print(error)
        Sphere radius=-0.1 must be a finite number of m ≥ 1e-06 and ≤ 1e+06
    """


class RobotError(InputError):
    """A robot description (URDF, SRDF, Pinocchio model) cannot be used."""


class SceneError(InputError):
    """An obstacle, a motion or a scene cannot be used."""


class ScenarioError(InputError):
    """A scenario name or a scenario file cannot be used."""


class ConfigurationError(InputError):
    """A configuration is not finite, not normalised, of the wrong size, out of limits or in collision."""


class GoalError(ConfigurationError):
    """No configuration reaches a goal, or all that do touch something; ``search`` has the result as data."""

    def __init__(self, message: str, search: object = None) -> None:
        super().__init__(message)
        self.search: object = search


class ParameterError(InputError):
    """A parameter is outside its range, or nothing takes one of that name."""


class NumericalError(ElasticStripsError, FloatingPointError):
    """A computation has no answer: a depth that Coal does not find, a step whose matrix is not positive definite."""


class ThreadError(ElasticStripsError, RuntimeError):
    """A thread called something that another one was using: a deformer, or whatever has buffers of its own."""


class PlanningError(ElasticStripsError):
    """No certified strip was found; ``report`` has what was tried, as data."""

    def __init__(self, message: str, report: object = None) -> None:
        super().__init__(message)
        self.report: object = report


class MissingExtraError(ElasticStripsError, ImportError):
    """A package that only some uses need is not installed; the message has the command that installs it."""


def missing_extra(user: str, package: str, extra: str | None = None) -> MissingExtraError:
    """The error that ``user`` needs a ``package`` of an ``extra`` of this library, or of no extra."""
    command = f"pip install {package}" if extra is None else install_command(extra)
    return MissingExtraError(f"{user} needs {package}, which is not installed: {command}")


def install_command(extra: str) -> str:
    """The command that installs an ``extra`` of this library from where it was installed itself (PEP 610).

    That is a folder, a repository or a file; without a record of it, an index of packages.
    """
    try:
        origin = json.loads(metadata.distribution("elastic-strips").read_text("direct_url.json") or "{}")
    except (metadata.PackageNotFoundError, OSError, ValueError):
        origin = {}
    url = str(origin.get("url", ""))
    if "dir_info" in origin:
        folder = url2pathname(urlsplit(url).path)
        if Path(folder).is_dir():
            return f"pip install {'-e ' if origin['dir_info'].get('editable') else ''}'{folder}[{extra}]'"
    elif url:
        source = f"{origin['vcs_info']['vcs']}+{url}" if "vcs_info" in origin else url
        return f"pip install 'elastic-strips[{extra}] @ {source}'"
    return f"pip install 'elastic-strips[{extra}]'"


def nearest_name(name: object, valid: Iterable[str]) -> str:
    """Say which of the ``valid`` names were meant: ``"; did you mean 'x'? Valid: …"`` for error messages."""
    names = sorted(str(v) for v in valid)
    alike = {n.lower(): n for n in reversed(names)}
    close = [alike[n] for n in difflib.get_close_matches(str(name).lower(), alike, n=1, cutoff=0.5)]
    hint = f"; did you mean {close[0]!r}?" if close else "."
    shown = ", ".join(n if len(n) <= 60 else n[:57] + "..." for n in names[:20]) + (", …" if len(names) > 20 else "")
    return f"{hint} Valid: {shown}." if names else f"{hint} There are none."


def listed(names: Sequence[str], most: int = 3, *, between: str = ", ") -> str:
    """The first few names, and how many more there are."""
    return between.join(names[:most]) + f" and {len(names) - most} more" * (len(names) > most)


def without_numbers(text: str) -> str:
    """A message with "…" for its numbers: what is said again and again of one kind differs in these alone."""
    return _NUMBERS.sub("…", text)


def plural(count: int, noun: str) -> str:
    """A number with its noun, as in "1 segment" and "2 segments"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"
