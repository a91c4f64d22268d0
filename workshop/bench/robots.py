"""Robots benchmark: load every robot, plan a small problem, settle the strip; a table of the results."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError, ElasticStripsError, ScenarioError
from elastic_strips.planning import check_endpoints, plan_report
from elastic_strips.robot import RobotModel, load_robot, robot_names
from elastic_strips.scene import Scene, Sphere
from elastic_strips.strip import Deformer, DeformParams, DeformReport, Strip

from .measure import Figures, Note, head, silent

_BASE_GOAL = (1.5, 0.2)
"""Goal of a moving base [m]."""
LARGEST_JOINT_MOTION = 0.6
"""Largest displacement of a joint [rad], or part of its range."""
_SPHERE_RADII = (0.1, 0.06, 0.03, 0.015)
"""Radii [m] of the sphere in the path, in order of preference; start and goal must be free."""
_LONGEST_SETTLING = 20.0
"""Longest time [s] that a strip gets to settle."""


@dataclass(frozen=True, slots=True)
class RobotCase:
    """A robot to test: its name, and arguments of ``load_robot``."""

    name: str
    source: str
    base: str | None = None
    srdf: str | None = None


def robot_cases(names: Sequence[str] = (), data: str | Path | None = None) -> list[RobotCase]:
    """The robots to try.

    Args:
        names: named robots; all robots where empty.
        data: folder whose URDFs are all tried as well, each with the SRDF of the same name beside it.

    Raises:
        ScenarioError: the folder holds no URDF.
    """
    cases = [RobotCase(name, name) for name in names or robot_names()]
    if data is None:
        return cases
    files = sorted(Path(data).rglob("*.urdf"))
    if not files:
        raise ScenarioError(f"{data}: holds no URDF")
    for file in files:
        srdf = file.with_suffix(".srdf")
        wheels = "wheel" in file.read_text(encoding="utf-8", errors="replace").lower()
        cases.append(
            RobotCase(
                f"{Path(data).name}/{file.stem}",
                str(file),
                "diff_drive" if wheels else "fixed",
                str(srdf) if srdf.is_file() else None,
            )
        )
    return cases


def bench_robots(cases: Sequence[RobotCase], step: Note = silent, *, timeout: float = 10.0) -> Figures:
    """Load each robot, plan from home to another posture with a sphere in the path, settle the strip.

    Args:
        cases: the robots.
        step: called after each with a note, for a progress bar.
        timeout: longest planning [s].
    """
    rows = []
    for case in cases:
        with _warnings() as warnings:
            row = _tried(case, timeout)
        row["warnings"] = list(warnings)
        rows.append(row)
        step(f"{case.name}: {row['refused'] or row['settle']}")
    return head("robots", timeout_s=timeout, robots=rows)


_BEGIN, _END = "<!-- table: python -m workshop robots -->\n", "<!-- end of table -->\n"


def with_table(page: str, table: str) -> str:
    """A page with the table between its two comments replaced; the table alone for another page."""
    before, begin, rest = page.partition(_BEGIN)
    _, end, after = rest.partition(_END)
    return f"{before}{_BEGIN}{table}{_END}{after}" if begin and end else table


def robots_table(figures: Figures) -> str:
    """The figures of :func:`bench_robots` as a Markdown table."""
    lines = [
        "| robot | base | joints planned | pieces | loads, ms | warnings | plan | settle |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in figures["robots"]:
        if row["refused"] is not None:
            lines.append(f"| {row['name']} | – | – | – | – | {len(row['warnings'])} | refused: {row['refused']} | – |")
            continue
        shown = [
            f"{row[k]}" + ("" if row[f"{k}_ms"] is None else f", {row[f'{k}_ms']:.0f} ms") for k in ("plan", "settle")
        ]
        cells = [row["name"], row["base"], row["joints"], row["pieces"], f"{row['load_ms']:.0f}", len(row["warnings"])]
        lines.append("| " + " | ".join(str(c) for c in [*cells, *shown]) + " |")
    return "\n".join(lines) + "\n"


def _tried(case: RobotCase, timeout: float) -> Figures:
    row: Figures = {"name": case.name, "refused": None, "plan": "–", "plan_ms": None, "settle": "–", "settle_ms": None}
    begin = perf_counter()
    try:
        robot = load_robot(case.source, base=case.base, srdf=case.srdf)
    except ElasticStripsError as error:
        said = str(error)  # without the file's path, which is this machine's
        return row | {"refused": said.split(": ", 1)[1] if "/" in said.split(": ", 1)[0] else said}
    row |= {
        "load_ms": 1e3 * (perf_counter() - begin),
        "base": robot.base_kind.value,
        "joints": len(robot.joint_names),
        "pieces": len(robot.geometries),
    }
    if robot.nv == 0:
        return row | {"plan": "nothing moves"}
    try:
        scene, goal = _small_problem(robot)
        report = plan_report(robot, scene, robot.home(), goal, timeout=timeout)
        row |= {"plan": "certified" if report.certified else report.reason, "plan_ms": 1e3 * report.seconds}
        if report.certified:
            row |= _settled(robot, report.strip, scene)
    except ConfigurationError as error:
        row["plan"] = str(error)
    return row


class _Impatient(Exception):
    """The time of a strip is over."""


def _settled(robot: RobotModel, strip: Strip, scene: Scene) -> Figures:
    begin, status = perf_counter(), "no tick"

    def watch(report: DeformReport) -> None:
        nonlocal status
        status = f"{report.status.value}, {'certified' if report.certified else 'not certified'}, still moving"
        if perf_counter() - begin > _LONGEST_SETTLING:
            raise _Impatient

    with suppress(_Impatient):
        settled = Deformer(robot).settle(strip, scene, watch=watch)
        status = settled.status.value
        if not settled.certified:
            status += f" ({settled.reason})"
    return {"settle": status, "settle_ms": 1e3 * (perf_counter() - begin)}


def _small_problem(robot: RobotModel, *, seed: int = 0) -> tuple[Scene, Array]:
    """A scene with a sphere in the path of the piece that moves most, and a goal (nq,), from home.

    Raises:
        ConfigurationError: home is not free, or no goal is found.
    """
    params, rng, space = DeformParams(), np.random.default_rng(seed), robot.space
    home = space.to_coordinates(robot.home())
    check_endpoints(robot, Scene([]), robot.home(), robot.home(), params)
    span = np.where(np.isfinite(space.upper - space.lower), space.upper - space.lower, 2.0 * np.pi)
    easy: tuple[Scene, Array] | None = None
    for _ in range(60):
        coordinates = home + rng.uniform(-1.0, 1.0, space.nv) * np.minimum(LARGEST_JOINT_MOTION, 0.4 * span)
        if space.planar:
            coordinates[:3] = (*_BASE_GOAL, 0.0)
        goal = space.from_coordinates(np.clip(coordinates, space.lower, space.upper))
        try:
            check_endpoints(robot, Scene([]), robot.home(), goal, params)
        except ConfigurationError:
            continue
        easy = easy or (Scene([]), goal)
        at = _passing(robot, robot.home(), goal)
        for radius in _SPHERE_RADII:
            scene = Scene([Sphere(radius, at=tuple(at), name="ball")])
            try:
                check_endpoints(robot, scene, robot.home(), goal, params)
            except ConfigurationError:
                continue
            return scene, goal
    if easy is None:
        raise ConfigurationError(f"{robot.name!r}: no goal near home is free")
    return easy


def _passing(robot: RobotModel, start: Array, goal: Array) -> Array:
    """Where (3,) the middle of the piece that moves furthest is half way."""
    centers = [_centers(robot, pin.interpolate(robot.model, start, goal, share)) for share in (0.0, 0.5, 1.0)]
    return centers[1][int(np.argmax(np.linalg.norm(centers[2] - centers[0], axis=1)))]


def _centers(robot: RobotModel, q: Array) -> Array:
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return np.array([data.oMi[p.joint].act(0.5 * (p.capsule.a + p.capsule.b)) for p in robot.geometries])


@contextmanager
def _warnings() -> Iterator[list[str]]:
    """The texts of the warnings that the library logs meanwhile."""
    texts: list[str] = []

    class Keep(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            texts.append(record.getMessage())

    handler = Keep(logging.WARNING)
    logger = logging.getLogger("elastic_strips")
    before = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.WARNING)  # and only kept: they are in the table
    logger.propagate = False
    try:
        yield texts
    finally:
        logger.setLevel(before[0])
        logger.propagate = before[1]
        logger.removeHandler(handler)
