"""IO room, scene files: YAML scenes and worlds in and out, and scenarios in; docs/scene-files.md describes them."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from elastic_strips.errors import InputError, ScenarioError, SceneError
from elastic_strips.files import atomic_write, check_writable
from elastic_strips.robot import LoadOptions
from elastic_strips.scene import Obstacle, Scene, World
from elastic_strips.validation import check_type

from .moveit_scene import read_moveit_scene
from .nav2_map import load_nav2_map
from .nodes import Node, Source, load_yaml
from .obstacle_document import obstacle_entries, obstacle_from_node
from .octomap import read_octomap

VERSION = 1
_BASES = ("diff_drive", "omni", "fixed")
_FOREIGN = {".scene": read_moveit_scene, ".bt": read_octomap, ".ot": read_octomap}
_CLOUDS = (".pcd", ".ply", ".xyz")
_ROBOTS = (".urdf", ".xacro")
_PRESETS = ("default", "paper")
_ROBOT_KEYS = ("name", "joints", "group", "locked", "srdf", "package_dirs", "visual_as_collision")
_SCENARIO_KEYS = (
    "version", "name", "description", "robot", "base", "preset", "params", "scene", "start", "goal", "seed",
)  # fmt: skip


def read_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene file: the obstacles that exist at the file's time.

    MoveIt's ``.scene`` files, OctoMap's ``.bt`` and ``.ot`` files, and the YAML files of Nav2's maps are read, too: as
    `read_moveit_scene`, `read_octomap` and `load_nav2_map` do.

    Raises:
        SceneError: The file cannot be read or does not fit the schema; the message names file, line and key.
    """
    world = read_world(path)
    return world.at(world.scene.time)


def read_world(path: str | os.PathLike[str]) -> World:
    """Read a scene file: all obstacles, and when they appear and vanish; or one of others, as `read_scene` does.

    Raises:
        SceneError: The file cannot be read or does not fit the schema; the message names file, line and key.
    """
    ending = Path(path).suffix.lower() if isinstance(path, (str, os.PathLike)) else ""
    if ending in _FOREIGN:
        return World(_FOREIGN[ending](path))
    if ending in _CLOUDS:
        shape = f"{{shape: points, file: {Path(path).name}, radius: …}}"
        raise SceneError(f"{path}: is a point cloud; a scene file takes it in, by a line 'obstacles: [{shape}]'")
    root = load_yaml(path)
    if not _is_map(root):
        return _world_from_node(root)
    try:
        return World(load_nav2_map(path))
    except ScenarioError as error:
        raise SceneError(str(error)) from None


def _is_map(root: Node) -> bool:
    """Whether a YAML file is one of Nav2's maps."""
    return isinstance(root.value, dict) and "image" in root.value


def _world_from_node(node: Node) -> World:
    """World of a mapping node, as a scene file or a scenario's ``scene`` holds it."""
    entries = node.mapping(("version", "time", "obstacles"), needed=("obstacles",), what="a scene")
    if "version" in entries:
        entries["version"].integer(low=VERSION, high=VERSION)
    time = entries["time"].number(low=-1e9, high=1e9, unit="s") if "time" in entries else 0.0
    obstacles: list[Obstacle] = []
    named: dict[str, int | None] = {}
    items = entries["obstacles"].items()
    for item in items:
        obstacle = obstacle_from_node(item)
        if obstacle.name is not None:
            if obstacle.name in named:
                taken = f"the name {obstacle.name!r} is taken by the obstacle in line {named[obstacle.name]}"
                item["name"].fail(f"{taken}; names must be unique")
            named[obstacle.name] = item["name"].line
        obstacles.append(obstacle)
    scene = node.checked(Scene, obstacles, time=time)
    spans = dict(zip(scene.names, (_span(item) for item in items), strict=True))
    appears = {name: span[0] for name, span in spans.items() if span[0] is not None}
    vanishes = {name: span[1] for name, span in spans.items() if span[1] is not None}
    return node.checked(World, scene, appears, vanishes)


def _span(node: Node) -> tuple[float | None, float | None]:
    """When an obstacle appears and vanishes [s]; None where the file does not state it."""
    entries = node.mapping()
    begin, end = (
        entries[key].number(low=-1e9, high=1e9, unit="s") if key in entries else None for key in ("appears", "vanishes")
    )
    if begin is not None and end is not None and not end > begin:
        entries["vanishes"].fail(f"is {end:g} s; it must be later than 'appears', {begin:g} s")
    return begin, end


def write_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a scene file that `read_scene` reads back; an existing file is replaced in one step.

    Twists are written with their pose at time 0. Meshes that came from a file are written as that file's relative path.

    Raises:
        SceneError: A motion is neither a twist nor keyframes nor unknown, or the file cannot be written.
    """
    check_type("scene", scene, Scene, SceneError)
    _write(scene, {}, path)


def write_world(world: World, path: str | os.PathLike[str]) -> None:
    """Write a scene file that `read_world` reads back: all obstacles, and when they appear and vanish.

    Raises:
        SceneError: As for `write_scene`.
    """
    check_type("world", world, World, SceneError)
    spans: dict[str, dict[str, float]] = {name: {} for name in world.scene.names}
    for key, times in (("appears", world.appears), ("vanishes", world.vanishes)):
        for name, time in times.items():
            spans[name][key] = time
    _write(world.scene, spans, path)


def _write(scene: Scene, spans: dict[str, dict[str, float]], path: str | os.PathLike[str]) -> None:
    """Write the obstacles, each with further keys by its name."""
    try:
        target = check_writable(path)
        atomic_write(target, _document(scene, spans, target).encode())
    except InputError as error:
        raise SceneError(str(error)) from None


def _document(scene: Scene, spans: dict[str, dict[str, float]], target: Path) -> str:
    """The text of a scene file that is to stand at ``target``."""
    lines = [f"version: {VERSION}", f"time: {_text(scene.time)}", "obstacles:" if len(scene) else "obstacles: []"]
    for obstacle in scene:
        entries = obstacle_entries(obstacle, target.parent) | spans.get(obstacle.name or "", {})
        lines += [
            f"  {' ' if k else '-'} {key}: {_entry(key, value)}" for k, (key, value) in enumerate(entries.items())
        ]
    return "\n".join(lines) + "\n"


def _entry(key: str, value: object) -> str:
    """The value of an obstacle's key as text; words of the schema stand without quotes."""
    if key == "motion" and isinstance(value, dict):
        ((kind, motion),) = value.items()
        return f"{{{kind}: {_text(motion)}}}"
    return str(value) if key == "shape" else _text(value)


def _text(value: object) -> str:
    """JSON, which is YAML."""
    return json.dumps(value.tolist() if isinstance(value, np.ndarray) else value, ensure_ascii=False)


# Scenarios


@dataclass(frozen=True, slots=True)
class PoseSpec:
    """Where a robot stands and how it holds its joints; joints that are not named keep their home value.

    Attributes:
        x, y: Position of the base [m], world frame.
        yaw: Heading of the base [rad].
        joints: Joint values by name [rad or m].
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    joints: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ScenarioSpec:
    """Content of a scenario file.

    Attributes:
        name: Name of the scenario.
        description: One or more sentences, or "".
        robot: Name of a known robot, or the absolute path of a URDF file.
        robot_options: What else ``load_robot`` is to be told of it, by its arguments' names; paths are absolute.
        base: "diff_drive", "omni", "fixed", or None for the robot's own.
        preset: "default", "paper" or None.
        params: Overrides of parameters by name; not checked here.
        scene: What exists at the scene's time.
        world: All obstacles, and when they appear and vanish.
        start: Start of the strip.
        goal: Goal of the strip.
        seed: Seed of everything random.
        path: The file.
    """

    name: str
    description: str
    robot: str
    base: str | None
    preset: str | None
    params: Mapping[str, float]
    scene: Scene
    world: World
    start: PoseSpec
    goal: PoseSpec
    seed: int
    path: Path
    robot_options: LoadOptions = field(default_factory=LoadOptions)


def read_scenario(path: str | os.PathLike[str]) -> ScenarioSpec:
    """Read a scenario file.

    Raises:
        ScenarioError: The file, or the scene file that it names, cannot be read or does not fit the schema; the message
            names file, line and key.
    """
    root = _scenario_root(path)
    entries = root.mapping(_SCENARIO_KEYS, needed=("robot", "scene", "start", "goal"), what="a scenario")
    file = root.source.path
    if "version" in entries:
        entries["version"].integer(low=VERSION, high=VERSION)
    world = _world(entries["scene"])
    robot, options = _described(entries["robot"])
    return ScenarioSpec(
        name=entries["name"].text() if "name" in entries else file.stem,
        description=entries["description"].text() if "description" in entries else "",
        robot=robot,
        robot_options=options,
        base=entries["base"].text(valid=_BASES) if "base" in entries else None,
        preset=entries["preset"].text(valid=_PRESETS) if "preset" in entries else None,
        params=_numbers(entries["params"], high=1e12) if "params" in entries else {},
        scene=world.at(world.scene.time),
        world=world,
        start=_pose(entries["start"]),
        goal=_pose(entries["goal"]),
        seed=entries["seed"].integer(low=0, high=2**32 - 1) if "seed" in entries else 0,
        path=file,
    )


def _described(node: Node) -> tuple[str, LoadOptions]:
    """A robot's name or path, and what else is said of it where it is a mapping."""
    if not isinstance(node.value, dict):
        return _robot(node), LoadOptions()
    entries = node.mapping(_ROBOT_KEYS, needed=("name",), what="a robot")
    folder, options = node.source.path.parent, LoadOptions()
    if "joints" in entries:
        options["joints"] = tuple(item.text() for item in entries["joints"].items())
    if "group" in entries:
        options["group"] = entries["group"].text()
    if "locked" in entries:
        options["locked"] = _numbers(entries["locked"], high=1e6)
    if "srdf" in entries:
        options["srdf"] = str((folder / entries["srdf"].text()).absolute())
    if "package_dirs" in entries:
        names = (item.text() for item in entries["package_dirs"].items())
        options["package_dirs"] = tuple(str((folder / name).absolute()) for name in names)
    if "visual_as_collision" in entries:
        given = entries["visual_as_collision"]
        if isinstance(given.value, str):
            given.text(valid=("missing",))
            options["visual_as_collision"] = "missing"
        else:
            options["visual_as_collision"] = tuple(item.text() for item in given.items())
    return _robot(entries["name"]), options


def _scenario_root(path: str | os.PathLike[str]) -> Node:
    """The YAML of a scenario file; robots and scenes, which a scenario only names, are refused with what to do."""
    source = Source(Path(path), ScenarioError)
    name, ending = source.path.name, source.path.suffix.lower()
    this_is_a_scene = (
        "is a scene file, which a scenario names: write a YAML file with the lines "
        f"'scene: {name}', 'robot: …' (its name or its URDF file), 'start: {{x: 0}}' and 'goal: {{x: 4}}'"
    )
    if ending in _ROBOTS:
        source.fail(f"is a robot: give it by --robot {path}, or by a line 'robot: {name}' of a scenario file")
    if ending in _FOREIGN:
        source.fail(this_is_a_scene)
    root = load_yaml(path, error=ScenarioError)
    if isinstance(root.value, dict) and not root.value.keys() & {"scene", "robot", "start", "goal"}:
        for key in ("obstacles", "image"):
            if key in root.value:
                source.fail(this_is_a_scene, root[key].line)
    return root


def _robot(node: Node) -> str:
    """A robot's name as it is; a path to a URDF, relative to the file, as an absolute path."""
    robot = node.text()
    if not robot.lower().endswith((".urdf", ".xacro")) and "/" not in robot and "\\" not in robot:
        return robot
    path = (node.source.path.parent / robot).absolute()
    if not os.path.isfile(path):
        node.fail(f"there is no URDF file {path}")
    return str(path)


def _world(node: Node) -> World:
    if not isinstance(node.value, str):
        return _world_from_node(node)
    try:
        return read_world(node.source.path.parent / node.text())
    except SceneError as error:
        raise ScenarioError(str(error)) from None


def _pose(node: Node) -> PoseSpec:
    entries = node.mapping(("x", "y", "yaw", "joints"), what="a pose")
    yaw = entries["yaw"].number(low=-1e3 * math.pi, high=1e3 * math.pi, unit="rad") if "yaw" in entries else 0.0
    x, y = (entries[key].number() if key in entries else 0.0 for key in ("x", "y"))
    return PoseSpec(x=x, y=y, yaw=yaw, joints=_numbers(entries["joints"], high=1e6) if "joints" in entries else {})


def _numbers(node: Node, *, high: float) -> dict[str, float]:
    entries = node.mapping(what="names to numbers")
    return {key: entry.number(low=-high, high=high, unit="") for key, entry in entries.items()}
