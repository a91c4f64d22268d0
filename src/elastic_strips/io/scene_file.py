"""IO room, scene files: YAML scenes and worlds in and out; docs/scene-files.md describes them."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np

from elastic_strips.errors import InputError, SceneError
from elastic_strips.files import atomic_write, check_writable
from elastic_strips.scene import Obstacle, Scene, World
from elastic_strips.validation import check_type

from .nodes import Node, load_yaml
from .obstacle_document import obstacle_entries, obstacle_from_node

VERSION = 1


def read_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene file: the obstacles that exist at the file's time.

    Raises:
        SceneError: The file cannot be read or does not fit the schema; the message names file, line and key.
    """
    return scene_from_node(load_yaml(path))


def read_world(path: str | os.PathLike[str]) -> World:
    """Read a scene file: all obstacles, and when they appear and vanish.

    Raises:
        SceneError: The file cannot be read or does not fit the schema; the message names file, line and key.
    """
    return world_from_node(load_yaml(path))


def scene_from_node(node: Node) -> Scene:
    """Scene of a mapping node, as a scene file or a scenario's ``scene`` holds it: what exists at its time.

    Paths in it are relative to the node's own file.
    """
    world = world_from_node(node)
    return world.at(world.scene.time)


def world_from_node(node: Node) -> World:
    """World of a mapping node, as a scene file or a scenario's ``scene`` holds it.

    Paths in it are relative to the node's own file.
    """
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
    """When an obstacle appears and vanishes [s]; None where the file does not say."""
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
    except SceneError:
        raise
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
