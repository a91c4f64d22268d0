"""IO room, scene files: YAML scenes and worlds in and out, and scenarios in; docs/scene-files.md describes them."""

from __future__ import annotations

import json
import logging
import math
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import InputError, ScenarioError, SceneError
from elastic_strips.files import atomic_write, check_writable
from elastic_strips.robot import LoadOptions, RobotModel
from elastic_strips.robot.reach import highest_reach
from elastic_strips.scene import Obstacle, Scene, World
from elastic_strips.scene.quantities import pose_of
from elastic_strips.validation import check_type, named_arguments

from .nodes import Node, Source, load_yaml
from .obstacle_document import obstacle_entries, obstacle_from_node, quaternion_of_rpy, warn_of_degrees
from .scene_source import (
    MESSAGE,
    MOVEIT,
    OF_KIND,
    OWN,
    Reading,
    SceneFile,
    SceneOptions,
    bounded,
    check_options,
    joined,
    kind_of,
    placed,
    pose_from,
    read_foreign,
)

_log = logging.getLogger(__name__)
VERSION = 1
_MOST_FILES = 100  # of a scene
_SIZED = ("box", "sphere", "cylinder", "capsule", "cone")
_THICK_METRES, _LONG_METRES = 1.0, 100.0  # a scene in millimetres has hardly anything thinner, and something longer
_DEEPEST_INCLUDE = 8  # scene files that name each other
_BASES = ("diff_drive", "omni", "fixed")
_FOREIGN = (".scene", ".bt", ".ot", ".pcd", ".ply", ".xyz")
_ROBOTS = (".urdf", ".xacro")
_PRESETS = ("default", "paper")
_ROBOT_KEYS = (
    "name", "joints", "group", "locked", "srdf", "package_dirs", "mappings", "visual_as_collision", "looking",
)  # fmt: skip
_SCENARIO_KEYS = (
    "version", "name", "description", "robot", "base", "preset", "params", "scene", "start", "goal", "via", "seed",
)  # fmt: skip


@named_arguments
def read_scene(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    robot: RobotModel | None = None,
    q: Array | None = None,
    options: SceneOptions | None = None,
) -> Scene:
    """Read a scene file: the obstacles that exist at the file's time.

    Files of other programs are read, too: MoveIt's ``.scene`` and planning scenes (YAML, JSON), OctoMap's ``.bt`` and
    ``.ot``, the YAML files of Nav2's maps, and point clouds, where ``options`` has ``voxel``.

    Args:
        path: The file, or several, whose obstacles are one scene.
        robot: The robot that the scene is for: walls of maps become as high as it reaches; without it they are
            `WALL_HEIGHT` high.
        q: (nq,) Its configuration when clouds were seen.
        options: How files of other programs are read: see `SceneOptions`.

    Raises:
        SceneError: The file cannot be read or does not fit the schema; the message names file, line and key.

    Examples:
        >>> with open("room.yaml", "w") as file:
        ...     _ = file.write("obstacles: [{shape: box, size: [0.6, 0.6, 1.4], at: [1.5, 0.1, 0.7], name: shelf}]")
        >>> es.read_scene("room.yaml").names
        ('shelf',)
    """
    world = read_world(path, robot=robot, q=q, options=options)
    return world.at(world.scene.time) if world.names_moving or world.event_times else world.scene


@named_arguments
def read_world(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    robot: RobotModel | None = None,
    q: Array | None = None,
    options: SceneOptions | None = None,
) -> World:
    """Read a scene file: all obstacles, and when they appear and vanish; or one of others, as `read_scene` does.

    Objects that a robot holds in a planning scene are not obstacles, and are left out with a warning: `read_scene_file`
    has them.

    Args:
        path, robot, q, options: See `read_scene`.

    Raises:
        SceneError: The file cannot be read or does not fit the schema; the message names file, line and key.
    """
    found = read_scene_file(path, robot=robot, q=q, options=options)
    if found.held:
        names = ", ".join(found.held_names[:6])
        _log.warning("%s: left out: what the robot holds, %s; read_scene_file(…).held_by(robot) has it", path, names)
    return found.world


def read_scene_file(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    robot: RobotModel | None = None,
    q: Array | None = None,
    options: SceneOptions | None = None,
) -> SceneFile:
    """All that a scene's files say: the obstacles over time, what the robot holds, and the area that maps show.

    Args:
        path, robot, q, options: See `read_scene`.

    Raises:
        SceneError: As for `read_scene`.
    """
    paths = [path] if isinstance(path, (str, os.PathLike)) else list(path)
    if not paths:
        raise SceneError("no scene file is given")
    said = options or SceneOptions()
    reading = Reading(robot, q)
    kinds = [kind_of(Path(each)) for each in paths]
    for key in said:
        if len(paths) > 1 and (key == "at" or not any(key in OF_KIND[kind] for kind, _ in kinds)):
            check_options(kinds[0][0], cast("SceneOptions", {key: said[key]}), str(paths[0]))
            raise SceneError(
                f"{key!r} is of one file, and {len(paths)} are given: name them under 'sources' of a scene file"
            )
    found = _parts(paths, kinds, said, reading)
    if found.held and robot is not None:
        with suppress(InputError):  # it holds nothing that another robot holds
            held = found.held_by(robot)
            if highest_reach(held) > highest_reach(robot) or "own_points" in said:
                return _parts(paths, kinds, said, Reading(held, q))  # walls are as high as what it holds gets
    return found


def _parts(
    paths: Sequence[str | os.PathLike[str]],
    kinds: Sequence[tuple[str, Node | None]],
    said: SceneOptions,
    reading: Reading,
) -> SceneFile:
    """All files as one scene."""
    parts = []
    for each, (kind, root) in zip(paths, kinds, strict=True):
        own = said if len(paths) == 1 else {key: value for key, value in said.items() if key in OF_KIND[kind]}
        parts.append(_part(Path(each), kind, root, cast("SceneOptions", own), reading))
    if len(parts) == 1:
        return bounded(parts[0])
    return bounded(joined(parts, World(Scene([], time=parts[0].world.scene.stamp))))


def _part(path: Path, kind: str, root: Node | None, options: SceneOptions, reading: Reading) -> SceneFile:
    """One file of a scene."""
    here = os.path.realpath(path)
    if here in reading.within or len(reading.within) >= _DEEPEST_INCLUDE:
        chain = " → ".join(Path(name).name for name in (*reading.within, here))
        raise SceneError(f"{path}: scene files name each other: {chain}")
    reading.read.append(here)
    if len(reading.read) > _MOST_FILES:
        raise SceneError(f"{path}: the scene has more than {_MOST_FILES} files, which is the most that are read")
    inner = replace(reading, within=(*reading.within, here))
    if kind != OWN:
        found = read_foreign(path, kind, root, options, inner)
        if kind in (MOVEIT, MESSAGE):
            _warn_of_millimetres(path, found.world.scene)
        return found
    assert root is not None
    check_options(kind, options, str(path))
    found = _scene_from_node(root, inner)
    if "at" in options:
        if found.held or found.areas:
            raise SceneError(f"{path}: 'at' has to be given for its sources: maps or held objects are among them")
        found = replace(found, world=placed(found.world, pose_from(options["at"])))
    return found


def seem_millimetres(scene: Scene) -> str:
    """Why the lengths of a scene seem to be in millimetres: all that is in it is thick, and something as large as a
    street; empty where they do not."""
    lengths = [np.ravel(np.asarray(v, dtype=float)) for o in scene if o.shape in _SIZED for v in o.spec.values()]
    least, most = (f(np.concatenate(lengths)) if lengths else 0.0 for f in (np.min, np.max))
    if least < _THICK_METRES or most < _LONG_METRES:
        return ""
    return (
        f"nothing in it is thinner than {least:.4g} m, and something is {most:.4g} m large: lengths are in metres; are "
        "these millimetres?"
    )


def _warn_of_millimetres(path: Path, scene: Scene) -> None:
    if doubt := seem_millimetres(scene):
        _log.warning("%s: %s", path, doubt)


def _scene_from_node(node: Node, reading: Reading) -> SceneFile:
    """What a mapping node says, as a scene file or a scenario's ``scene`` holds it; no boxes around maps yet."""
    if not node.key and isinstance(node.value, dict) and node.value.keys() & {"robot", "start", "goal"}:
        given = node.value.get("scene")
        own = not isinstance(given, str) or given == node.source.path.name
        its = "what follows 'scene:', as a file of its own" if own else repr(given)
        node.source.fail(f"is a scenario file, which 'run', 'drag' and 'drive' take; give its scene here: {its}")
    entries = node.mapping(("version", "time", "obstacles", "sources"), what="a scene")
    for key in ("obstacles", "sources"):
        if key in entries and entries[key].value is None:
            entries[key].fail("nothing follows; write [] where there are none")
    if not ("obstacles" in entries or "sources" in entries):
        node.fail("a scene needs the key 'obstacles', or 'sources', files that hold some")
    if "version" in entries:
        entries["version"].integer(low=VERSION, high=VERSION)
    time = entries["time"].number(low=-1e9, high=1e9, unit="s") if "time" in entries else None
    obstacles: list[Obstacle] = []
    named: dict[str, int | None] = {}
    items = entries["obstacles"].items() if "obstacles" in entries else []
    for item in items:
        obstacle = obstacle_from_node(item)
        if obstacle.name is not None:
            if obstacle.name in named:
                taken = f"the name {obstacle.name!r} is taken by the obstacle in line {named[obstacle.name]}"
                item["name"].fail(f"{taken}; names must be unique")
            named[obstacle.name] = item["name"].line
        obstacles.append(obstacle)
    scene = node.checked(Scene, obstacles, time=time)
    _warn_of_millimetres(node.source.path, scene)
    spans = dict(zip(scene.names, (_span(item) for item in items), strict=True))
    appears = {name: span[0] for name, span in spans.items() if span[0] is not None}
    vanishes = {name: span[1] for name, span in spans.items() if span[1] is not None}
    world = node.checked(World, scene, appears, vanishes)
    if "sources" not in entries:
        return SceneFile(world)
    parts = [_source(item, reading) for item in entries["sources"].items()]
    return entries["sources"].checked(joined, parts, world)


def _source(node: Node, reading: Reading) -> SceneFile:
    """What one of a scene's sources says: the name of a file, or a mapping with it and how it is read."""
    options = SceneOptions()
    file = node
    if isinstance(node.value, dict):
        entries = node.mapping(
            ("file", "quat", "rpy", *SceneOptions.__annotations__), needed=("file",), what="a source"
        )
        file = entries.pop("file")
        options = _options(entries)
    path = node.source.path.parent / file.text()

    def read() -> SceneFile:
        kind, root = kind_of(path)
        return _part(path, kind, root, options, reading)

    return node.checked(read)


def _options(entries: dict[str, Node]) -> SceneOptions:
    """How a source is read."""
    options = SceneOptions()
    if "rpy" in entries and "quat" in entries:
        entries["rpy"].fail("the orientation is given twice: by 'rpy' and by 'quat'")
    turn = next((entries[key] for key in ("rpy", "quat") if key in entries), None)
    if turn is not None:
        place = entries["at"].vector(3) if "at" in entries else (0.0, 0.0, 0.0)
        quat = turn.vector(4) if turn.key.endswith("quat") else quaternion_of_rpy(*turn.vector(3).tolist())
        if turn.key.endswith("rpy"):
            warn_of_degrees(f"{turn.source.path}: {turn.key}", *turn.vector(3).tolist())
        options["at"] = turn.checked(pose_of, place, quat)
    elif "at" in entries:
        options["at"] = entries["at"].checked(pose_from, entries["at"].vector())
    for key in ("low", "high", "lethal", "occupied", "voxel", "scale", "own_points"):
        if key in entries:
            options[key] = entries[key].number(unit="")
    for key in ("unknown", "outside", "planes"):
        if key in entries:
            options[key] = entries[key].text()
    if "min_points" in entries:
        options["min_points"] = entries["min_points"].integer(low=1)
    return options


def _span(node: Node) -> tuple[float | None, float | None]:
    """When an obstacle appears and vanishes [s]; None where the file does not state it."""
    entries = node.mapping()
    begin, end = (
        entries[key].number(low=-1e9, high=1e9, unit="s") if key in entries else None for key in ("appears", "vanishes")
    )
    if begin is not None and end is not None and not end > begin:
        entries["vanishes"].fail(f"is {end:g} s; it must be later than 'appears', {begin:g} s")
    return begin, end


@named_arguments
def write_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a scene file that `read_scene` reads back; an existing file is replaced in one step.

    Twists are written with their pose at time 0. Meshes that came from a file are written as that file's relative path.

    Raises:
        SceneError: A motion is neither a twist nor keyframes nor unknown, or the file cannot be written.

    Examples:
        >>> es.write_scene(es.Scene([es.Sphere(0.25, at=(2.4, 0.8, 1.0), name="lamp")]), "room.yaml")
        >>> es.read_scene("room.yaml").names
        ('lamp',)
    """
    check_type("scene", scene, Scene, SceneError)
    _write(scene, {}, path)


@named_arguments
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
    time = [] if scene.stamp is None else [f"time: {_text(scene.stamp)}"]
    lines = [f"version: {VERSION}", *time, "obstacles:" if len(scene) else "obstacles: []"]
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
        any_yaw: Whether any heading will do, with the joints as they are: a place on the way.
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    joints: Mapping[str, float] = field(default_factory=dict)
    any_yaw: bool = False


@dataclass(frozen=True, slots=True)
class HandSpec:
    """Where a frame of the robot is to be.

    Attributes:
        frame: Name of the frame.
        at: Its position in the world [m].
        turned: Its orientation (x, y, z, w), or None where any will do.
        within: How far it may be off along each axis [m].
    """

    frame: str
    at: tuple[float, float, float]
    turned: tuple[float, float, float, float] | None = None
    within: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class ScenarioSpec:
    """Content of a scenario file.

    Attributes:
        name: Name of the scenario.
        description: One or more sentences, or "".
        robot: Name of a known robot, or the absolute path of a URDF file.
        robot_options: Further arguments of ``load_robot`` by name; paths are absolute.
        base: "diff_drive", "omni", "fixed", or None for the robot's own.
        preset: "default", "paper" or None.
        params: Overrides of parameters by name; not checked here.
        scene: The obstacles that exist at the scene's time.
        world: All obstacles, and when they appear and vanish.
        start: Start of the strip.
        goal: Goal of the strip.
        via: Goals of a drive on the way there, one after the other.
        seed: Seed of everything random.
        path: The file.
        source: Everything in the scene's files.
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
    goal: PoseSpec | HandSpec
    seed: int
    path: Path
    via: tuple[PoseSpec | HandSpec, ...] = ()
    robot_options: LoadOptions = field(default_factory=LoadOptions)
    source: SceneFile | None = None


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
    found = _scene(entries["scene"])
    robot, options = _described(entries["robot"])
    return ScenarioSpec(
        name=entries["name"].text() if "name" in entries else file.stem,
        description=entries["description"].text() if "description" in entries else "",
        robot=robot,
        robot_options=options,
        base=entries["base"].text(valid=_BASES) if "base" in entries else None,
        preset=entries["preset"].text(valid=_PRESETS) if "preset" in entries else None,
        params=_numbers(entries["params"], high=1e12) if "params" in entries else {},
        scene=found.world.at(found.world.scene.time),
        world=found.world,
        start=_pose_on(entries["start"], found),
        goal=_goal_on(entries["goal"], found),
        via=tuple(_goal_on(item, found, on_the_way=True) for item in entries["via"].items())
        if "via" in entries
        else (),
        seed=entries["seed"].integer(low=0, high=2**32 - 1) if "seed" in entries else 0,
        path=file,
        source=found,
    )


def _goal_on(node: Node, found: SceneFile, *, on_the_way: bool = False) -> PoseSpec | HandSpec:
    """A pose of the base, which has to be on the map where there is one, or of the hand."""
    if isinstance(node.value, dict) and "hand" in node.value:
        entries = node.mapping(("hand", "at", "turned", "within"), needed=("hand", "at"), what="a pose of a hand")
        x, y, z = entries["at"].vector(3).tolist()
        turned = within = None
        if "turned" in entries:
            a, b, c, w = entries["turned"].vector(4).tolist()
            turned = a, b, c, w
        if "within" in entries:
            p, q, r = entries["within"].vector(3).tolist()
            within = p, q, r
        return HandSpec(entries["hand"].text(), (x, y, z), turned, within or (0.0, 0.0, 0.0))
    pose = _pose_on(node, found)
    free = on_the_way and isinstance(node.value, dict) and not node.value.keys() & {"yaw", "joints"}
    return replace(pose, any_yaw=free)


def _pose_on(node: Node, found: SceneFile) -> PoseSpec:
    """A pose, which has to be on the map where there is one."""
    pose = _pose(node)
    if len(found.outside([(pose.x, pose.y)])):
        node.fail(
            f"({pose.x:g}, {pose.y:g}) is outside the map, where all is unknown; 'outside: free' allows it all the same"
        )
    return pose


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
    if "mappings" in entries:
        options["mappings"] = {name: _argument(item) for name, item in entries["mappings"].mapping().items()}
    if "visual_as_collision" in entries:
        given = entries["visual_as_collision"]
        if isinstance(given.value, str):
            given.text(valid=("missing",))
            options["visual_as_collision"] = "missing"
        else:
            options["visual_as_collision"] = tuple(item.text() for item in given.items())
    if "looking" in entries:
        options["looking"] = tuple(item.text() for item in entries["looking"].items())
    return _robot(entries["name"]), options


def _argument(node: Node) -> str:
    """An argument of a xacro file, which is text there: true and numbers as they are written in such files."""
    if isinstance(node.value, bool):
        return str(node.value).lower()
    return f"{node.number():.12g}" if isinstance(node.value, (int, float)) else node.text()


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


def _scene(node: Node) -> SceneFile:
    """What a scenario's ``scene`` says: a scene, a file, a file with how it is read, or a list of these."""
    reading = Reading()
    if isinstance(node.value, list):
        parts = [_source(item, reading) for item in node.items()]
        return bounded(node.checked(joined, parts, World(Scene([]))))
    if not isinstance(node.value, str) and not (isinstance(node.value, dict) and "file" in node.value):
        return bounded(_scene_from_node(node, reading))
    try:
        return bounded(_source(node, reading))
    except SceneError as error:
        raise ScenarioError(str(error)) from None


def _pose(node: Node) -> PoseSpec:
    entries = node.mapping(("x", "y", "yaw", "joints"), what="a pose")
    yaw = entries["yaw"].number(low=-1e3 * math.pi, high=1e3 * math.pi, unit="rad") if "yaw" in entries else 0.0
    warn_of_degrees(f"{node.source.path}: {node.key}.yaw", yaw)
    x, y = (entries[key].number() if key in entries else 0.0 for key in ("x", "y"))
    return PoseSpec(x=x, y=y, yaw=yaw, joints=_numbers(entries["joints"], high=1e6) if "joints" in entries else {})


def _numbers(node: Node, *, high: float) -> dict[str, float]:
    entries = node.mapping(what="names to numbers")
    return {key: entry.number(low=-high, high=high, unit="") for key, entry in entries.items()}
