"""The file of a sweep: what to run, with which parameters and seeds; read and checked before anything begins."""

from __future__ import annotations

import hashlib
import itertools
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from elastic_strips.arrays import Document
from elastic_strips.catalogue import PRESETS, find_robot
from elastic_strips.errors import InputError
from elastic_strips.files import read_input
from elastic_strips.io.nodes import MAX_YAML_BYTES, Node, load_yaml
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.sim.sensors import named_sensors

from .runs import ENDS, KINDS, MEASURED, Run, Value, check_values, full_name, located

SWEEP_VERSION = 1
MAX_RUNS = 1_000_000
MAX_SEED = 2**31 - 1
_KEYS = ("version", "kind", "scenarios", "robots", "presets", "seeds", "grid", "fixed", "plot")
_COMBINATIONS_TRIED = 2000
"""Combinations that are tried before a value counts as impossible."""


class SweepError(InputError):
    """The file of a sweep cannot be used, or an output belongs to something else."""


@dataclass(frozen=True, slots=True)
class Plot:
    """The columns that are drawn; None: chosen by what varies.

    Attributes:
        x, y, hue: names of columns.
    """

    x: str | None = None
    y: str | None = None
    hue: str | None = None


@dataclass(frozen=True, slots=True)
class Sweep:
    """Everything that a sweep runs.

    Attributes:
        path: its file.
        kind: ``"plan"``, as ``elastic-strips run`` does it, or ``"drive"``, as ``elastic-strips drive`` does.
        scenarios: names, or files relative to the sweep's.
        robots: names or URDF files; None: the scenario's.
        presets: presets of the parameters, for plans; None: the scenario's.
        seeds: seeds of everything random.
        grid: parameter → its values; every combination is run.
        fixed: parameter → its value in every run.
        plot: the columns that are drawn.
        files: name of each file that the sweep names → SHA-256 of its content.
    """

    path: Path
    kind: str
    scenarios: tuple[str, ...]
    robots: tuple[str | None, ...] = (None,)
    presets: tuple[str | None, ...] = (None,)
    seeds: tuple[int, ...] = (0,)
    grid: Mapping[str, tuple[Value, ...]] = field(default_factory=dict)
    fixed: Mapping[str, Value] = field(default_factory=dict)
    plot: Plot = Plot()
    files: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of runs."""
        count = len(self.scenarios) * len(self.robots) * len(self.presets) * len(self.seeds)
        for values in self.grid.values():
            count *= len(values)
        return count

    def runs(self) -> tuple[Run, ...]:
        """All runs; seeds change fastest, then the last parameter."""
        axes, fixed, folder = tuple(self.grid), tuple(self.fixed.items()), str(self.path.parent.absolute())
        every = itertools.product(
            self.scenarios, self.robots, self.presets, itertools.product(*self.grid.values()), self.seeds
        )
        return tuple(
            Run(
                k,
                self.kind,
                scenario,
                robot,
                preset,
                seed,
                (*zip(axes, point, strict=True), *fixed),
                folder,
                len(axes),
            )
            for k, (scenario, robot, preset, point, seed) in enumerate(every)
        )

    def columns(self) -> dict[str, type]:
        """Column of the table → type of its values."""
        columns: dict[str, type] = {"run": int, "scenario": str, "robot": str}
        if self.kind == "plan":
            columns["preset"] = str
        columns["seed"] = int
        for name, values in self.grid.items():
            kinds = {type(v) for v in values}
            columns[name] = kinds.pop() if len(kinds) == 1 else float if kinds == {int, float} else str
            if columns[name] is tuple:
                columns[name] = str
        return {**columns, **MEASURED[self.kind], **ENDS}

    def document(self) -> Document:
        """What identifies the sweep, as plain values: everything except path and plot."""
        return {
            "kind": self.kind,
            "scenarios": list(self.scenarios),
            "robots": list(self.robots),
            "presets": list(self.presets),
            "seeds": list(self.seeds),
            "grid": {name: [_plain(v) for v in values] for name, values in self.grid.items()},
            "fixed": {name: _plain(value) for name, value in self.fixed.items()},
            "files": dict(self.files),
        }

    @property
    def digest(self) -> str:
        """SHA-256 of the document."""
        return hashlib.sha256(json.dumps(self.document()).encode()).hexdigest()


def _plain(value: Value) -> object:
    return list(value) if isinstance(value, tuple) else value


def read_sweep(path: str | os.PathLike[str]) -> Sweep:
    """Read the file of a sweep (docs/sweeps.md).

    Raises:
        SweepError: the file cannot be read or does not fit the schema; the message names file, line and key.
        ScenarioError: a scenario file that it names has an error.
    """
    root = load_yaml(path, error=SweepError)
    entries = root.mapping(_KEYS, needed=("kind", "scenarios"), what="a sweep")
    if "version" in entries:
        entries["version"].integer(low=SWEEP_VERSION, high=SWEEP_VERSION)
    kind = entries["kind"].text(valid=KINDS)
    folder = str(root.source.path.parent.absolute())
    scenarios = _scenarios(entries["scenarios"], folder)
    robots = _robots(entries["robots"], folder) if "robots" in entries else [None]
    presets = _presets(entries["presets"], kind) if "presets" in entries else [None]
    seeds = _seeds(entries["seeds"]) if "seeds" in entries else (0,)
    fixed_nodes = entries["fixed"].mapping(what="fixed parameters") if "fixed" in entries else {}
    grid_nodes = entries["grid"].mapping(what="parameters to lists of values") if "grid" in entries else {}
    _check_names(kind, [*grid_nodes.items(), *fixed_nodes.items()])
    fixed = {name: _value(node) for name, node in fixed_nodes.items()}
    grid = {name: tuple(_value(n) for n in _listed(node)) for name, node in grid_nodes.items()}
    sensor_nodes = _sensor_nodes(grid_nodes, fixed_nodes)
    _check_sensors(sensor_nodes, scenarios, robots, folder)
    files = _digests([*scenarios, *filter(None, robots), *(node.text() for node in sensor_nodes)], folder)
    plot = _plot(entries["plot"]) if "plot" in entries else Plot()
    sweep = Sweep(
        root.source.path, kind, tuple(scenarios), tuple(robots), tuple(presets), seeds, grid, fixed, plot, files
    )
    if len(sweep) > MAX_RUNS:
        root.fail(f"the sweep has {len(sweep)} runs; it may have at most {MAX_RUNS}")
    _check_values(sweep, grid_nodes, fixed_nodes)
    if "plot" in entries:
        _check_columns(entries["plot"], sweep)
    return sweep


def _listed(node: Node) -> list[Node]:
    """Entries of a list that holds something, and nothing twice."""
    found = node.items()
    if not found:
        node.fail("is empty; at least one entry is needed")
    seen: set[object] = set()
    for entry in found:
        value = _hashable(entry.value)
        if value in seen:
            entry.fail(f"is {entry.kind}, which the list has already")
        seen.add(value)
    return found


def _hashable(value: object) -> object:
    """Something that is equal where values are: 1 is 1.0, and is not true."""
    if isinstance(value, list):
        return tuple(map(_hashable, value))
    return repr(value) if isinstance(value, dict) else (isinstance(value, bool), value)


def _scenarios(node: Node, folder: str) -> list[str]:
    names = [entry.text() for entry in _listed(node)]
    for entry, name in zip(node.items(), names, strict=True):
        entry.checked(get_scenario, located(name, folder))
    return names


def _robots(node: Node, folder: str) -> list[str]:
    return [_robot(entry, folder) for entry in _listed(node)]


def _robot(node: Node, folder: str) -> str:
    name = node.text()
    path = located(name, folder)
    if path == name:
        node.checked(find_robot, name)
    elif not os.path.isfile(path):
        node.fail(f"there is no URDF file {path}")
    return name


def _presets(node: Node, kind: str) -> list[str]:
    if kind != "plan":
        node.fail("a drive has no presets; leave them out, or use kind: plan")
    return [entry.text(valid=PRESETS) for entry in _listed(node)]


def _seeds(node: Node) -> tuple[int, ...]:
    """A list of seeds, or ``{first: 0, count: 20}``."""
    if not isinstance(node.value, dict):
        return tuple(entry.integer(low=0, high=MAX_SEED) for entry in _listed(node))
    entries = node.mapping(("first", "count"), needed=("count",), what="seeds")
    first = entries["first"].integer(low=0, high=MAX_SEED) if "first" in entries else 0
    count = entries["count"].integer(low=1, high=min(MAX_RUNS, MAX_SEED - first + 1))
    return tuple(range(first, first + count))


def _value(node: Node) -> Value:
    if isinstance(node.value, (bool, int, str)):
        return node.value
    if isinstance(node.value, float):
        return node.finite()
    if isinstance(node.value, list):
        return tuple(entry.finite() for entry in _listed(node))
    node.fail(f"must be a number, true or false, a word or a list of numbers, not {node.kind}")


def _sensor_nodes(grid: Mapping[str, Node], fixed: Mapping[str, Node]) -> list[Node]:
    if "sensors" in grid:
        return grid["sensors"].items()
    return [fixed["sensors"]] if "sensors" in fixed else []


def _check_sensors(nodes: Sequence[Node], scenarios: Sequence[str], robots: Sequence[str | None], folder: str) -> None:
    """Check that of all sensors that are named at least one of the robots has such."""
    if nodes:
        owners = [robot or get_scenario(located(name, folder)).robot for name in scenarios for robot in robots]
        for node in nodes:
            _check_some_has(node, owners, folder)


def _check_some_has(node: Node, robots: list[str], folder: str) -> None:
    first: InputError | None = None
    for robot in dict.fromkeys(robots):
        try:
            named_sensors(located(node.text(), folder), robot)
            return
        except InputError as error:
            first = first or error
    node.fail(str(first))


def _check_names(kind: str, parameters: Sequence[tuple[str, Node]]) -> None:
    """Check that every parameter is known and named once, and that none has the name of another column."""
    seen: dict[str, str] = {}
    taken = {"run", "scenario", "robot", "preset", "seed", *MEASURED[kind], *ENDS}
    for name, node in parameters:
        full = node.checked(full_name, kind, name)
        if full in seen:
            node.fail(f"is the same parameter as {seen[full]!r}, which is given, too")
        if name in taken:
            node.fail(f"is called as a column of the result; write {full!r}")
        seen[full] = name


def _check_values(sweep: Sweep, grid: Mapping[str, Node], fixed: Mapping[str, Node]) -> None:
    """Check that every value is possible with some of the others; an impossible combination is a row with an error."""
    for preset in sweep.presets:
        for name, node in grid.items():
            for value, entry in zip(sweep.grid[name], node.items(), strict=True):
                axes = [(value,) if n == name else values for n, values in sweep.grid.items()]
                _check_some(sweep, preset, axes, entry)
        if not grid and fixed:
            _check_some(sweep, preset, [], next(iter(fixed.values())))


def _check_some(sweep: Sweep, preset: str | None, axes: list[tuple[Value, ...]], node: Node) -> None:
    """Check that some combination is possible; else the first one's error, at a fixed value if that alone is wrong."""
    first: InputError | None = None
    for point in itertools.islice(itertools.product(*axes), _COMBINATIONS_TRIED):
        try:
            check_values(sweep.kind, preset, {**sweep.fixed, **dict(zip(sweep.grid, point, strict=True))})
            return
        except InputError as error:
            first = first or error
    node.fail(str(first))


def _plot(node: Node) -> Plot:
    entries = node.mapping(("x", "y", "hue"), what="a plot")
    return Plot(**{key: entry.text() for key, entry in entries.items()})


def _check_columns(node: Node, sweep: Sweep) -> None:
    """Check that what is drawn are columns of the sweep's table."""
    for key in ("x", "y", "hue"):
        if getattr(sweep.plot, key) is not None:
            node[key].text(valid=sweep.columns())


def _digests(named: Sequence[str], folder: str) -> dict[str, str]:
    """SHA-256 of what those names stand for that are files."""
    return {name: _sha256(Path(located(name, folder))) for name in named if located(name, folder) != name}


def _sha256(path: Path) -> str:
    return hashlib.sha256(read_input(path, "file of a sweep", MAX_YAML_BYTES, SweepError)).hexdigest()
