"""IO room, scenario files: robot, scene, start and goal from YAML; the schema is documented in docs/scene-files.md."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from elastic_strips.errors import ScenarioError
from elastic_strips.scene import Scene, World

from .nodes import Node, load_yaml
from .scene_file import VERSION, world_from_node

_BASES = ("diff_drive", "omni", "fixed")
_PRESETS = ("default", "paper")


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
    """What a scenario file says.

    Attributes:
        name: Name of the scenario.
        description: One or more sentences, or "".
        robot: Name of a known robot, or the absolute path of a URDF file.
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


_KEYS = (
    "version",
    "name",
    "description",
    "robot",
    "base",
    "preset",
    "params",
    "scene",
    "start",
    "goal",
    "seed",
)


def read_scenario(path: str | os.PathLike[str]) -> ScenarioSpec:
    """Read a scenario file.

    Raises:
        ScenarioError: The file, or the scene file that it names, cannot be read or does not fit the schema; the message
            names file, line and key.
    """
    root = load_yaml(path, error=ScenarioError)
    entries = root.mapping(_KEYS, needed=("robot", "scene", "start", "goal"), what="a scenario")
    file = root.source.path
    if "version" in entries:
        entries["version"].integer(low=VERSION, high=VERSION)
    world = _world(entries["scene"])
    return ScenarioSpec(
        name=entries["name"].text() if "name" in entries else file.stem,
        description=entries["description"].text() if "description" in entries else "",
        robot=_robot(entries["robot"]),
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


def _robot(node: Node) -> str:
    """A robot's name as it is; a path to a URDF, relative to the file, as an absolute path."""
    robot = node.text()
    if not robot.lower().endswith(".urdf") and "/" not in robot and "\\" not in robot:
        return robot
    path = (node.source.path.parent / robot).absolute()
    if not os.path.isfile(path):
        node.fail(f"there is no URDF file {path}")
    return str(path)


def _world(node: Node) -> World:
    if not isinstance(node.value, str):
        return world_from_node(node)
    return world_from_node(load_yaml(node.source.path.parent / node.text(), error=ScenarioError))


def _pose(node: Node) -> PoseSpec:
    entries = node.mapping(("x", "y", "yaw", "joints"), what="a pose")
    yaw = entries["yaw"].number(low=-1e3 * math.pi, high=1e3 * math.pi, unit="rad") if "yaw" in entries else 0.0
    x, y = (entries[key].number() if key in entries else 0.0 for key in ("x", "y"))
    return PoseSpec(x=x, y=y, yaw=yaw, joints=_numbers(entries["joints"], high=1e6) if "joints" in entries else {})


def _numbers(node: Node, *, high: float) -> dict[str, float]:
    entries = node.mapping(what="names to numbers")
    return {key: entry.number(low=-high, high=high, unit="") for key, entry in entries.items()}
