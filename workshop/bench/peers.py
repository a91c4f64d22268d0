"""Peers benchmark: other planners on the same robot, shapes and scenes, each in an environment of its own.

The robot goes to them as a URDF of the same convex pieces that are planned with here, its base as three joints, with
an SRDF of the pairs that count; the scenes as boxes, balls, cylinders and meshes. A program of a few lines for each
(``_peer_programs``) reads that, plans, and writes the paths and what they took. What a path is worth is measured here.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import venv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TypedDict, cast
from xml.etree import ElementTree as xml

import numpy as np
import pinocchio as pin
import trimesh

from elastic_strips.arrays import Array
from elastic_strips.collision import certify
from elastic_strips.collision.proof import robot_statement, scene_statement
from elastic_strips.control.local_planner import BROKEN_STEPS
from elastic_strips.errors import ElasticStripsError, ParameterError
from elastic_strips.planning import plan_report
from elastic_strips.planning.joint_search import divided
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.strip import Deformer, Strip, displacement

from .measure import Figures, Note, head, percentiles, silent
from .plan import push_nearest, recover

PROGRAMS = Path(__file__).parent / "_peer_programs"
_OMPL_REQUIREMENTS = ("ompl>=2.0.1,<3", "coal>=3.0.3,<4", "pin>=4.1,<5")
REQUIREMENTS: dict[str, tuple[str, ...]] = {
    "ompl": _OMPL_REQUIREMENTS,
    "ompl_simplified": _OMPL_REQUIREMENTS,
    "roboplan": ("roboplan>=0.6,<0.8",),
    "mplib": ("mplib>=0.2.1,<0.3", "numpy<2"),
    "drake": ("drake>=1.51,<2",),
    "trajopt": ("tesseract-robotics>=0.5.1,<0.6",),
}
"""Packages that pip installs for each peer."""
_LIKE = {"ompl_simplified": "ompl"}  # the same program in the same environment, told to do more
OURS = "elastic_strips"
_BASE_JOINTS = ("base_x", "base_y", "base_yaw")
_BASE_DRIVING_MARGIN = 3.0  # [m] beyond start, goal and obstacles that a base may drive
_CONE_SIDES = 32  # of a cone as a mesh
_PEER_NODE_SPACING = 0.2  # [m or rad] between the nodes of a peer's path as a strip


@dataclass(frozen=True, slots=True)
class Problem:
    """A scene, and start and goal (2, nv) in it."""

    scene: Scene
    rows: Array  # (2, nv) start and goal


class Shape(TypedDict):
    """A shape as the peers' programs read it."""

    shape: str  # box, sphere, cylinder or mesh
    size: list[float]  # [m] edges; radius; radius and length; nothing
    pose: list[list[float]]  # (4, 4)
    mesh: str  # file of a mesh, else empty


class _StatedShape(TypedDict):
    """What is read here of a shape in a statement of :mod:`elastic_strips.collision.proof`."""

    kind: str
    sizes: list[float]
    points: list[list[float]]
    rotation: list[list[float]]
    translation: list[float]


class _StatedBody(_StatedShape):
    joint: int


class _StatedJoint(TypedDict):
    parent: int
    column: int
    slides: bool
    offset: list[list[float]]


class _StatedRobot(TypedDict):
    joints: list[_StatedJoint]
    bodies: list[_StatedBody]
    pairs: list[list[int]]


def bench_peers(
    robot: RobotModel,
    seeds: int,
    step: Note = silent,
    *,
    scenario: str = "corridor",
    peers: Sequence[str] = tuple(REQUIREMENTS),
    environments: str | os.PathLike[str],
    timeout: float = 10.0,
    pushes: int = 4,
    into: float = 0.035,
) -> Figures:
    """First paths, and paths again after an obstacle was pushed into them; of this library and of its peers.

    Every planner's own path is pushed into, by its nearest obstacle that start and goal do not need; the peers then
    replan, which is what they can do. Their paths are certified here, at clearance 0, as straight lines between
    their waypoints.

    Args:
        robot: the robot; with a base that may go sideways, since the peers know no wheels.
        seeds: number of problems.
        step: called after each piece of work with a note, for a progress bar.
        scenario: name of a seeded scenario.
        peers: names of ``REQUIREMENTS``.
        environments: folder for the peers' environments; made where it is missing.
        timeout: longest time for each path [s].
        pushes: number of pushes for each problem.
        into: how deep each obstacle is pushed [m].

    Raises:
        ParameterError: an unknown peer.
    """
    unknown = [name for name in peers if name not in REQUIREMENTS]
    if unknown:
        raise ParameterError(f"peers: no peer {unknown[0]!r}; there are {', '.join(REQUIREMENTS)}")
    problems = []
    for seed in range(seeds):
        found = get_scenario(scenario, seed=seed)
        problems.append(Problem(found.scene, robot.space.to_coordinates(np.array(found.ends(robot)))))
    rows = {OURS: _ours(robot, problems, pushes, into, timeout, step)}
    for name in peers:
        python, reason = environment(Path(environments), name)
        step(f"{name}: {reason or 'ready'}")
        if python is None:
            rows[name] = {"skipped": reason}
            continue
        rows[name] = _peer(robot, python, name, problems, pushes, into, timeout, step)
    return {
        **head("peers", robot=robot.name, scenario=scenario),
        "base": robot.base_kind.value,
        "seeds": seeds,
        "pushes": pushes,
        "into_m": into,
        "timeout_s": timeout,
        "planners": rows,
    }


def environment(folder: Path, name: str) -> tuple[Path | None, str]:
    """The Python of a peer's environment, made where it is missing; or None and why it cannot be."""
    home = folder / _LIKE.get(name, name)
    python, stamp = home / "bin" / "python", home / ".complete"
    wanted = " ".join(REQUIREMENTS[name])
    if stamp.is_file() and stamp.read_text(encoding="utf-8") == wanted:
        return python, ""
    try:
        venv.create(home, with_pip=True, clear=True)
        call = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *REQUIREMENTS[name]]
        ended = subprocess.run(call, capture_output=True, text=True, timeout=900, check=False)
    except (OSError, subprocess.SubprocessError) as error:
        return None, f"no environment: {error}"
    if ended.returncode != 0:
        lines = ended.stderr.strip().splitlines() or ["pip failed"]
        return None, f"does not install: {lines[-1]}"
    stamp.write_text(wanted, encoding="utf-8")
    return python, ""


# --- this library ----------------------------------------------------------------------------------------------------


def _ours(
    robot: RobotModel, problems: Sequence[Problem], pushes: int, into: float, timeout: float, step: Note
) -> Figures:
    first, again = [], []
    _first_plan(robot, problems[-1], timeout)  # not counted: the first one loads OMPL
    for problem in problems:
        strip, row = _first_plan(robot, problem, timeout)
        first.append(row)
        step(f"{OURS}: {row['ms']:.0f} ms")
        if strip is None:
            continue
        deformer, looker, scene = Deformer(robot), Deformer(robot), problem.scene
        deformer.step(strip, scene)
        for _ in range(pushes):
            pushed = push_nearest(looker, strip, scene, into)
            if pushed is None:
                break
            scene, before = pushed, strip
            seconds, _, last = recover(deformer, strip, scene, BROKEN_STEPS)
            strip, solved, reason = last.strip, last.certified, last.reason
            if not solved:
                plan = plan_report(robot, scene, strip.q[0], strip.q[-1], deformer=Deformer(robot), timeout=timeout)
                strip, solved, reason = plan.strip, plan.certified, plan.reason
                seconds += plan.seconds
            again.append(_judged(robot, scene, strip, 1e3 * seconds, solved, reason, before, "arc"))
            if not solved:
                break
    return _figures(first, again, {})


def _first_plan(robot: RobotModel, problem: Problem, timeout: float) -> tuple[Strip | None, Figures]:
    start, goal = robot.space.from_coordinates(problem.rows)
    began = perf_counter()
    plan = plan_report(robot, problem.scene, start, goal, deformer=Deformer(robot), timeout=timeout)
    ms = 1e3 * (perf_counter() - began)
    row = _judged(robot, problem.scene, plan.strip, ms, plan.certified, plan.reason, None, "arc")
    return (plan.strip if plan.certified else None), row


# --- the others ------------------------------------------------------------------------------------------------------


def _peer(
    robot: RobotModel,
    python: Path,
    name: str,
    problems: Sequence[Problem],
    pushes: int,
    into: float,
    timeout: float,
    step: Note,
) -> Figures:
    looker = Deformer(robot)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        joints = export_robot(out, robot, problems)
        try:
            told, paths = asked(python, name, out, joints, problems, timeout)
        except ElasticStripsError as error:
            return {"skipped": str(error)}
        step(f"{name}: {len(problems)} first paths")
        strips: list[Strip | None] = []
        first, again = [], []
        for problem, (rows, ms, reason) in zip(problems, paths, strict=True):
            strip = None if rows is None else _as_strip(robot, rows)
            strips.append(strip)
            first.append(_judged(robot, problem.scene, rows, ms, rows is not None, reason, None, "line"))
        current = list(problems)
        for push in range(pushes):
            moved: list[tuple[int, Problem, Strip]] = []
            for k, strip in enumerate(strips):
                scene = None if strip is None else push_nearest(looker, strip, current[k].scene, into)
                if strip is not None and scene is not None:
                    moved.append((k, Problem(scene, current[k].rows), strip))
            if not moved:
                break
            try:
                _, paths = asked(python, name, out, joints, [p for _, p, _ in moved], timeout)
            except ElasticStripsError as error:
                told["stopped"] = str(error)
                break
            strips = [None] * len(problems)
            for (k, problem, before), (rows, ms, reason) in zip(moved, paths, strict=True):
                strips[k] = None if rows is None else _as_strip(robot, rows)
                current[k] = problem
                again.append(_judged(robot, problem.scene, rows, ms, rows is not None, reason, before, "line"))
            step(f"{name}: push {push + 1}")
    return _figures(first, again, told)


def asked(
    python: Path, name: str, folder: Path, joints: list[str], problems: Sequence[Problem], timeout: float
) -> tuple[Figures, list[tuple[Array | None, float, str]]]:
    """What a peer's program says of itself; and of each problem the path (N, nv) or None, the time [ms], the reason.

    Raises:
        ParameterError: it failed.
    """
    document = {
        "joints": joints,
        "timeout": timeout,
        "problems": [
            {
                "start": p.rows[0].tolist(),
                "goal": p.rows[1].tolist(),
                "obstacles": obstacles(folder, f"s{k}", scene_statement(p.scene)),
            }
            for k, p in enumerate(problems)
        ],
    }
    (folder / "problems.json").write_text(json.dumps(document), encoding="utf-8")
    answer = folder / "answer.json"
    answer.unlink(missing_ok=True)
    environ = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    call = [str(python), str(PROGRAMS / f"{_LIKE.get(name, name)}_peer.py"), str(folder), name]
    limit = 120.0 + 2.0 * timeout * (len(problems) + 1)
    try:
        ended = subprocess.run(call, capture_output=True, text=True, timeout=limit, check=False, env=environ)
    except subprocess.TimeoutExpired:
        raise ParameterError(f"{name}: no answer within {limit:.0f} s") from None
    if not answer.is_file():
        lines = ended.stderr.strip().splitlines() or [f"ended with {ended.returncode} and no answer"]
        raise ParameterError(f"{name}: {lines[-1][:300]}")
    told = json.loads(answer.read_text(encoding="utf-8"))
    paths = [
        (None if run["path"] is None else np.array(run["path"], dtype=float), float(run["ms"]), str(run["reason"]))
        for run in told.pop("runs")
    ]
    return told, paths


def _as_strip(robot: RobotModel, rows: Array) -> Strip:
    limited = np.clip(divided(rows, _PEER_NODE_SPACING), robot.space.lower, robot.space.upper)
    return Strip.from_coordinates(robot, limited)


# --- what a path is worth --------------------------------------------------------------------------------------------


def _judged(
    robot: RobotModel,
    scene: Scene,
    path: Strip | Array | None,
    ms: float,
    solved: bool,
    reason: str,
    before: Strip | None,
    interpolation: str,
) -> Figures:
    row: Figures = {"ms": ms, "solved": solved, "reason": reason}
    if not solved or path is None:
        return row
    if isinstance(path, Strip):
        strip, q = path, path.q
    else:
        q = robot.space.from_coordinates(np.clip(path, robot.space.lower, robot.space.upper))
        strip = _as_strip(robot, path)
    found = certify(robot, scene, q, interpolation=interpolation)
    return {
        **row,
        "verdict": found.verdict.value,
        "finding": "" if found.certified else found.reason,
        "clearance_m": found.least if found.least is None or np.isfinite(found.least) else None,
        "length": float(np.linalg.norm(np.diff(strip.coordinates, axis=0), axis=1).sum()),
        "jump_m": None if before is None else displacement(before, strip),
    }


def _figures(first: list[Figures], again: list[Figures], told: Figures) -> Figures:
    def of(rows: list[Figures]) -> Figures:
        solved = [r for r in rows if r["solved"]]
        clear = [r["clearance_m"] for r in solved if r["clearance_m"] is not None]
        jumps = [r["jump_m"] for r in solved if r["jump_m"] is not None]
        return {
            "count": len(rows),
            "solved": len(solved),
            "ms": percentiles([r["ms"] for r in solved]),
            "certified": sum(r["verdict"] == "certified" for r in solved),
            "touching": sum(r["verdict"] == "refuted" for r in solved),
            "length": percentiles([r["length"] for r in solved]),
            "clearance_m": {"min": min(clear, default=None), "p50": float(np.median(clear)) if clear else None},
            "jump_m": percentiles(jumps),
            "runs": rows,
        }

    return {**told, "first": of(first), "again": of(again)}


# --- the robot and the scenes for others -----------------------------------------------------------------------------


def export_robot(folder: Path, robot: RobotModel, problems: Sequence[Problem]) -> list[str]:
    """Write ``robot.urdf``, ``robot.srdf`` and their meshes; names of the joints, in the order of the coordinates.

    Raises:
        RobotError: a shape that cannot be given in numbers.
    """
    stated = cast("_StatedRobot", robot_statement(robot))
    low, high = robot.space.lower.copy(), robot.space.upper.copy()
    ends = np.concatenate([p.rows for p in problems])
    wide = ~(np.isfinite(low) & np.isfinite(high))
    low[wide] = np.minimum(-np.pi, ends.min(axis=0) - _BASE_DRIVING_MARGIN)[wide]
    high[wide] = np.maximum(np.pi, ends.max(axis=0) + _BASE_DRIVING_MARGIN)[wide]
    root = xml.Element("robot", name=robot.name.replace(" ", "_"))
    xml.SubElement(root, "link", name="ground")
    names = [""] * robot.nv
    frames: list[str] = []
    for i, joint in enumerate(stated["joints"]):
        parent = "ground" if joint["parent"] < 0 else frames[joint["parent"]]
        offset = np.array(joint["offset"])
        if joint["column"] < 0:
            for k, (name, axis) in enumerate(zip(_BASE_JOINTS, ("1 0 0", "0 1 0", "0 0 1"), strict=True)):
                child = f"link_{name}"
                kind = "revolute" if k == 2 else "prismatic"
                _joint(root, name, kind, parent, child, axis, np.eye(3, 4), low[k], high[k])
                names[k], parent = name, child
            frames.append(parent)
            continue
        column = joint["column"]
        names[column] = robot.joint_names[column - robot.space.base_nv]
        kind, child = "prismatic" if joint["slides"] else "revolute", f"link_{i}"
        _joint(root, names[column], kind, parent, child, "0 0 1", offset, low[column], high[column])
        frames.append(child)
    (folder / "meshes").mkdir()
    bodies = []
    for k, body in enumerate(stated["bodies"]):  # a link each: of two links, some bodies may touch and others not
        bodies.append(f"body_{k}")
        joint = xml.SubElement(root, "joint", name=f"of_{bodies[-1]}", type="fixed")
        xml.SubElement(joint, "origin", _origin(np.eye(3), np.zeros(3)))
        xml.SubElement(joint, "parent", link="ground" if body["joint"] < 0 else frames[body["joint"]])
        xml.SubElement(joint, "child", link=bodies[-1])
        link = xml.SubElement(root, "link", name=bodies[-1])
        for shape in obstacles(folder, f"robot{k}", [body]):
            _collision(link, shape)
    _write(root, folder / "robot.urdf")
    _srdf(folder / "robot.srdf", root, names, bodies, stated["pairs"])
    return names


def _joint(
    root: xml.Element, name: str, kind: str, parent: str, child: str, axis: str, offset: Array, low: float, high: float
) -> None:
    joint = xml.SubElement(root, "joint", name=name, type=kind)
    xml.SubElement(joint, "origin", _origin(offset[:, :3], offset[:, 3]))
    xml.SubElement(joint, "parent", link=parent)
    xml.SubElement(joint, "child", link=child)
    xml.SubElement(joint, "axis", xyz=axis)
    xml.SubElement(joint, "limit", lower=f"{low:.17g}", upper=f"{high:.17g}", velocity="1", effort="100")
    xml.SubElement(root, "link", name=child)


def _origin(rotation: Array, translation: Array) -> dict[str, str]:
    rpy = pin.rpy.matrixToRpy(np.asarray(rotation))
    return {"xyz": " ".join(f"{v:.17g}" for v in translation), "rpy": " ".join(f"{v:.17g}" for v in rpy)}


def _collision(link: xml.Element, shape: Shape) -> None:
    collision = xml.SubElement(link, "collision")
    pose = np.array(shape["pose"])
    xml.SubElement(collision, "origin", _origin(pose[:3, :3], pose[:3, 3]))
    geometry, size = xml.SubElement(collision, "geometry"), [f"{v:.17g}" for v in shape["size"]]
    if shape["shape"] == "box":
        xml.SubElement(geometry, "box", size=" ".join(size))
    elif shape["shape"] == "sphere":
        xml.SubElement(geometry, "sphere", radius=size[0])
    elif shape["shape"] == "cylinder":
        xml.SubElement(geometry, "cylinder", radius=size[0], length=size[1])
    else:
        xml.SubElement(geometry, "mesh", filename=f"package://{shape['mesh']}")


def _srdf(file: Path, urdf: xml.Element, joints: list[str], bodies: list[str], pairs: list[list[int]]) -> None:
    """All pairs of links are off but those of bodies that count."""
    root = xml.Element("robot", name=urdf.get("name", ""))
    group = xml.SubElement(root, "group", name="all")
    for name in joints:
        xml.SubElement(group, "joint", name=name)
    on = {frozenset((bodies[i], bodies[k])) for i, k in pairs}
    links = [str(link.get("name")) for link in urdf.iter("link")]
    for i, one in enumerate(links):
        for two in links[:i]:
            if frozenset((one, two)) not in on:
                xml.SubElement(root, "disable_collisions", link1=one, link2=two, reason="Never")
    _write(root, file)


def _write(root: xml.Element, file: Path) -> None:
    file.write_bytes(xml.tostring(root, encoding="utf-8", xml_declaration=True))


def obstacles(folder: Path, name: str, stated: Sequence[Mapping[str, object]]) -> list[Shape]:
    """Shapes as boxes (edges), spheres (radius), cylinders (radius, length) and meshes (file), with their poses."""
    out: list[Shape] = []
    for k, part in enumerate(cast("Sequence[_StatedShape]", stated)):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = part["rotation"], part["translation"]
        kind, sizes = part["kind"], part["sizes"]

        def put(shape: str, size: list[float], at: Array = pose, mesh: str = "") -> None:
            out.append({"shape": shape, "size": size, "pose": at.tolist(), "mesh": mesh})

        if kind == "box":
            put("box", [2.0 * s for s in sizes])
        elif kind == "sphere":
            put("sphere", [sizes[0]])
        elif kind in ("cylinder", "capsule"):
            put("cylinder", [sizes[0], 2.0 * sizes[1]])
            for side in (-1.0, 1.0) if kind == "capsule" else ():
                end = pose.copy()
                end[:3, 3] += side * sizes[1] * pose[:3, 2]
                put("sphere", [sizes[0]], end)
        else:
            put("mesh", [], mesh=_mesh(folder, f"{name}_{k}", _corners(part)))
    return out


def _corners(part: _StatedShape) -> Array:
    """Points whose hull is the shape: of what is round, one about it."""
    if part["kind"] == "convex":
        return np.array(part["points"]).reshape(-1, 3)
    if part["kind"] == "cone":
        radius, half = part["sizes"]
        angle = 2.0 * np.pi * np.arange(_CONE_SIDES) / _CONE_SIDES
        ring = radius / np.cos(np.pi / _CONE_SIDES) * np.stack((np.cos(angle), np.sin(angle)), axis=1)
        return np.vstack((np.column_stack((ring, np.full(_CONE_SIDES, -half))), (0.0, 0.0, half)))
    ball = trimesh.creation.icosphere(subdivisions=3).vertices
    return np.asarray(ball) * np.array(part["sizes"]) / 0.99


def _mesh(folder: Path, name: str, points: Array) -> str:
    hull = trimesh.convex.convex_hull(points)
    data = hull.export(file_type="stl")
    assert isinstance(data, bytes)
    for suffix in (".stl", ".stl.convex.stl"):  # the second is what mplib looks for
        (folder / "meshes" / f"{name}{suffix}").write_bytes(data)
    return f"meshes/{name}.stl"
