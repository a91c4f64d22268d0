"""One run of a sweep: which parameters it may change, what it runs, and the row that results."""

from __future__ import annotations

import json
import math
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any, TypeAlias, cast

from elastic_strips.control import DriveParams, EvasionParams
from elastic_strips.errors import ElasticStripsError, ParameterError, nearest_name
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.sim.computing import Computing
from elastic_strips.sim.jobs import cached
from elastic_strips.sim.scenarios import Scenario, drive_document, drive_scenario, get_scenario, result_document
from elastic_strips.sim.scenarios.drive import PLANTS, drive_params
from elastic_strips.sim.scenarios.run import run_scenario
from elastic_strips.sim.sensors import named_sensors
from elastic_strips.strip import DeformParams
from elastic_strips.strip.paper import PaperParams
from elastic_strips.validation import check_choice, check_count, check_number, check_type, shown

Value: TypeAlias = "bool | int | float | str | tuple[float, ...]"
"""A value of a parameter."""
Row: TypeAlias = "dict[str, bool | int | float | str | None]"
"""A row of the table: column → value; values that do not exist are None."""

KINDS = ("plan", "drive")
MEASURED: Mapping[str, Mapping[str, type]] = {
    "plan": {
        "status": str,
        "certified": bool,
        "reason": str,
        "clearance_m": float,
        "length_m": float,
        "nodes": int,
        "ticks": int,
        "initial": str,
        "time_to_certified_ms": float,
        "tick_p50_ms": float,
        "tick_p95_ms": float,
        "passage": str,
        "max_lateral_slip_m": float,
    },
    "drive": {
        "state": str,
        "reached": bool,
        "reason": str,
        "collisions": int,
        "contacts_at_rest": int,
        "min_clearance_m": float,
        "time_s": float,
        "path_m": float,
        "stops": int,
        "replans": int,
        "ticks": int,
        "tick_p50_ms": float,
        "tick_p95_ms": float,
        "deadline_misses": int,
        "max_lateral_slip_m": float,
        "max_tracking_error_m": float,
    },
}
"""Kind → column → type of the measured value; docs/sweeps.md says what they mean."""
ENDS: Mapping[str, type] = {"error_type": str, "error": str, "wall_s": float}
"""The last columns of every kind."""


@dataclass(frozen=True, slots=True)
class Run:
    """One run; picklable.

    Attributes:
        index: its place in the sweep.
        kind: one of `KINDS`.
        scenario: name or file of the scenario, as the sweep's file has it.
        robot: name or file of the robot; the scenario's where None.
        preset: preset of the parameters, for plans; the scenario's where None.
        seed: seed of everything random.
        values: names of parameters, and their values.
        folder: the folder to which files are relative.
        axes: number of the first values that the sweep varies; they are columns.
    """

    index: int
    kind: str
    scenario: str
    robot: str | None
    preset: str | None
    seed: int
    values: tuple[tuple[str, Value], ...] = ()
    folder: str = ""
    axes: int = 0

    @property
    def identity(self) -> Row:
        """The columns that say which run this is."""
        row: Row = {"run": self.index, "scenario": self.scenario, "robot": self.robot}
        if self.kind == "plan":
            row["preset"] = self.preset
        row["seed"] = self.seed
        for name, value in self.values[: self.axes]:
            row[name] = json.dumps(value) if isinstance(value, tuple) else value
        return row

    def __str__(self) -> str:
        values = ", ".join(f"{n}={v if isinstance(v, str) else json.dumps(v)}" for n, v in self.values[: self.axes])
        who = " · ".join(word for word in (self.scenario, self.robot, self.preset) if word)
        return f"{who} · seed {self.seed}" + (f" · {values}" if values else "")


def execute(run: Run) -> Row:
    """Run it. Errors are in the row, in ``error_type`` and ``error``: nothing is raised."""
    began = perf_counter()
    row = empty(run)
    try:
        row |= _sound(_plan(run) if run.kind == "plan" else _drive(run))
    except Exception as error:
        row |= failed(error)
    row["wall_s"] = perf_counter() - began
    return row


def empty(run: Run) -> Row:
    """A row in which nothing has been measured."""
    return {**run.identity, **dict.fromkeys(MEASURED[run.kind]), **dict.fromkeys(ENDS)}


def failed(error: BaseException) -> Row:
    """The columns that report an error; for one that was not raised on purpose also its place."""
    text = " ".join(str(error).split())[:500]
    if not isinstance(error, ElasticStripsError) and error.__traceback__ is not None:
        place = traceback.extract_tb(error.__traceback__)[-1]
        text += f" ({place.filename.rsplit('/', 1)[-1]}:{place.lineno})"
    return _sound({"error_type": type(error).__name__, "error": text.strip()})


def _sound(row: Row) -> Row:
    """What every table can hold: no infinity, and no bytes of a file's name that are no text."""
    clean = {k: v.encode(errors="backslashreplace").decode() for k, v in row.items() if isinstance(v, str)}
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()} | clean


def _problem(run: Run, base: str | None) -> tuple[Scenario, RobotModel]:
    """Scenario and robot; a worker loads a robot once."""
    scenario = get_scenario(located(run.scenario, run.folder), seed=run.seed)
    robot = None if run.robot is None else located(run.robot, run.folder)
    preset = run.preset or (scenario.preset if run.kind == "plan" else "default")
    key = f"sweep {robot or scenario.robot} {base or scenario.base} {preset} {scenario.robot_options}"
    return scenario, cached(key, lambda: scenario.load_robot(robot, preset, base))


def located(name: str, folder: str) -> str:
    """A file's name relative to a folder as a path; any other name as it is."""
    if name.lower().endswith((".yaml", ".yml", ".urdf")) or "/" in name:
        return str((Path(folder) / name).absolute())
    return name


def _plan(run: Run) -> Row:
    options, values = _split(run)
    scenario, robot = _problem(run, cast("str | None", options.pop("base", None)))
    result = run_scenario(scenario, robot=robot, preset=run.preset, seed=run.seed, overrides=values, **_any(options))
    found = cast("dict[str, Any]", result_document(result))
    return {"robot": run.robot or robot.name, "preset": found["preset"], **_picked(found, "plan")}


def _drive(run: Run) -> Row:
    options, values = _split(run)
    scenario, robot = _problem(run, cast("str | None", options.pop("base", None)))
    if isinstance(sensors := options.pop("sensors", None), str):
        options["sensors"] = named_sensors(located(sensors, run.folder), robot.name)
    options["compute"] = Computing.parse(cast("str | float", options.get("compute", "1"))).label
    if values:
        evade = options.pop("evade", True)
        config = cast("Any", options.get("sensors"))
        made = drive_params(scenario, evade=cast("bool", evade), sensors=config, robot=robot)
        options["params"] = changed(made, values)
    outcome = drive_scenario(scenario, robot=robot, seed=run.seed, **_any(options))
    found = cast("dict[str, Any]", drive_document(outcome))
    found |= {name: len(found[name]) for name in ("stops", "contacts_at_rest")}
    found["max_lateral_slip_m"] = found["max_lateral_slip"]
    return {"robot": run.robot or robot.name, **_picked(found, "drive")}


def _picked(found: dict[str, Any], kind: str) -> Row:
    flat = found | {f"tick_{p}_ms": found["tick_ms"][p] for p in ("p50", "p95")}
    return {name: flat[name] for name in MEASURED[kind]}


def _any(options: dict[str, object]) -> dict[str, Any]:
    return options


def _split(run: Run) -> tuple[dict[str, object], dict[str, object]]:
    """Options of the command, and parameters by their full names (`full_name`)."""
    options: dict[str, object] = {}
    values: dict[str, object] = {}
    for name, value in run.values:
        if name in OPTIONS[run.kind]:
            options[name] = value
        elif run.kind == "plan":
            values[name.removeprefix(_DEFORM)] = value
        else:
            values[full_name("drive", name)] = value
    return options, values


# Names and values


_DEFORM = "deform."
_Check: TypeAlias = Callable[[object], object]
OPTIONS: Mapping[str, Mapping[str, _Check]] = {
    "plan": {
        "base": lambda v: check_choice("base", v, [k.value for k in BaseKind]),
        "timeout": lambda v: check_number("timeout", v, above=0.0, unit="s"),
    },
    "drive": {
        "base": lambda v: check_choice("base", v, [k.value for k in BaseKind]),
        "plant": lambda v: check_choice("plant", v, PLANTS),
        "sensors": lambda v: check_type("sensors", v, str),
        "evade": lambda v: check_type("evade", v, bool),
        "alternatives": lambda v: check_count("alternatives", v, low=1, high=8),
        "level": lambda v: check_type("level", v, str),
        "compute": lambda v: Computing.parse(cast("str | float", v)),
        "time_limit": lambda v: check_number("time_limit", v, above=0.0, unit="s"),
    },
}
"""Kind → options of its command that a sweep may set → what checks a value."""


def full_name(kind: str, name: str) -> str:
    """An option's name as it is; a parameter's name with the dataclass that holds it: ``influence`` is
    ``deform.influence``.

    Raises:
        ParameterError: there is no such name.
    """
    if name in OPTIONS[kind]:
        return name
    deform = {f.name for f in fields(DeformParams)} | (
        {f.name for f in fields(PaperParams)} if kind == "plan" else set()
    )
    known = {_DEFORM + n for n in deform} | (_names(DriveParams()) if kind == "drive" else set())
    if name in known:
        return name
    if _DEFORM + name in known:
        return _DEFORM + name
    valid = {*OPTIONS[kind], *(known if "." in name else {n.removeprefix(_DEFORM) for n in known})}
    raise ParameterError(f"unknown parameter {shown(name)} of a {kind}{nearest_name(name, valid)}")


def _names(params: object, prefix: str = "") -> set[str]:
    """Dotted names of all parameters in a dataclass and in those that it holds."""
    names: set[str] = set()
    for entry in fields(cast("Any", params)):
        value = getattr(params, entry.name)
        if is_dataclass(value):
            names |= _names(value, f"{prefix}{entry.name}.")
        elif value is not None:
            names.add(prefix + entry.name)
    return names


def changed(params: DriveParams, values: Mapping[str, object]) -> DriveParams:
    """Parameters of a drive with some replaced, by their dotted names.

    Raises:
        ParameterError: a value is outside its range, or is for evasion where the robot does not evade.
    """
    parts: dict[str, dict[str, object]] = {}
    for name, value in values.items():
        part, _, leaf = name.rpartition(".")
        parts.setdefault(part, {})[leaf] = value
    whole = parts.pop("", {})
    for part, inner in parts.items():
        old = getattr(params, part)
        if old is None:
            raise ParameterError(f"{part}.{next(iter(inner))} has no meaning where {part} is off (evade: false)")
        whole[part] = replace(old, **_any(inner))
    return replace(params, **_any(whole))


def check_values(kind: str, preset: str | None, values: Mapping[str, Value]) -> None:
    """Check that these values are possible together.

    Raises:
        ParameterError: one is outside its range, or unknown in the preset.
    """
    inner: dict[str, object] = {}
    options = {name: value for name, value in values.items() if name in OPTIONS[kind]}
    for name, value in values.items():
        if name in options:
            OPTIONS[kind][name](value)
        else:
            inner[full_name(kind, name)] = value
    if kind == "drive":
        changed(DriveParams(evasion=None if options.get("evade") is False else EvasionParams()), inner)
    else:
        made = PaperParams() if preset == "paper" else DeformParams()
        made.replaced(**{name.removeprefix(_DEFORM): value for name, value in inner.items()})
