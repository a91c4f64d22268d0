"""IO room, scene writer: a `Scene` or a `World` as a YAML file that `read_scene` and `read_world` read back."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from elastic_strips.errors import InputError, SceneError
from elastic_strips.io.files import check_writable, write_whole
from elastic_strips.io.scene_file import VERSION
from elastic_strips.scene import Keyframes, Obstacle, Scene, Twist, Unknown, World, checks
from elastic_strips.validation import check_type


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
    spans: dict[str, dict[str, str]] = {name: {} for name in world.scene.names}
    for key, times in (("appears", world.appears), ("vanishes", world.vanishes)):
        for name, time in times.items():
            spans[name][key] = _text(time)
    _write(world.scene, spans, path)


def _write(scene: Scene, spans: dict[str, dict[str, str]], path: str | os.PathLike[str]) -> None:
    """Write the obstacles, each with further keys by its name."""
    try:
        target = check_writable(path)
        write_whole(target, _document(scene, spans, target).encode())
    except SceneError:
        raise
    except InputError as error:
        raise SceneError(str(error)) from None


def _document(scene: Scene, spans: dict[str, dict[str, str]], target: Path) -> str:
    """The text of a scene file that is to stand at ``target``."""
    lines = [f"version: {VERSION}", f"time: {_text(scene.time)}", "obstacles:" if len(scene) else "obstacles: []"]
    for obstacle in scene:
        entries = _entries(obstacle, target) | spans.get(obstacle.name or "", {})
        lines += [f"  {'-' if k == 0 else ' '} {key}: {value}" for k, (key, value) in enumerate(entries.items())]
    return "\n".join(lines) + "\n"


def _text(value: Any) -> str:
    """JSON, which is YAML."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return json.dumps(value, ensure_ascii=False)


def _entries(obstacle: Obstacle, target: Path) -> dict[str, str]:
    """Keys of an obstacle in a file, with their values as text."""
    motion, pose = obstacle.motion, obstacle.pose
    entries = {"name": _text(obstacle.name), "shape": obstacle.shape}
    spec = dict(obstacle.spec)
    if obstacle.shape == "mesh":
        origin, scale = spec.pop("path", None), spec.pop("scale", None)
        if origin is not None and os.path.isfile(origin):
            spec = {"file": os.path.relpath(os.path.abspath(origin), os.path.abspath(target.parent)), "scale": scale}
    entries.update({key: _text(value) for key, value in spec.items()})
    if isinstance(motion, Twist):
        pose = motion.pose(obstacle.anchor, -obstacle.anchor_time)
        entries["motion"] = (
            f"{{twist: {_text({'linear': motion.linear.tolist(), 'angular': motion.angular.tolist()})}}}"
        )
    elif isinstance(motion, Keyframes):
        frames: dict[str, Any] = {"times": motion.times.tolist(), "positions": motion.positions.tolist()}
        if motion.quats is not None:
            frames["quats"] = motion.quats.tolist()
        frames["loop"] = motion.loop
        entries["motion"] = f"{{keyframes: {_text(frames)}}}"
    elif isinstance(motion, Unknown):
        entries["motion"] = f"{{unknown: {_text({'max_speed': motion.max_speed})}}}"
    elif motion is not None:
        raise SceneError(
            f"obstacle {obstacle.name!r}: a motion of type {type(motion).__name__} cannot be written to a file"
        )
    if not isinstance(motion, Keyframes):
        entries["at"] = _text(pose[:3, 3])
    if not (isinstance(motion, Keyframes) and motion.quats is not None):
        entries["quat"] = _text(checks.quaternion_of(pose[:3, :3]))
    return entries
