"""Obstacles: draws a scene with few objects, and of an obstacle that moved sends only where it is."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_strips.scene import Obstacle, Scene
from elastic_strips.viewer import bodies, commands
from elastic_strips.viewer.commands import Command
from elastic_strips.viewer.meshes import linear

_STILL, MOVING, _CLOUD = linear(0xC9A27E), linear(0xE07A3F), linear(0xA3ADB8)


class Obstacles:
    """What of a scene the browsers already have.

    Boxes, spheres, cylinders and cones that stand still are one object per shape, however many there are. Everything
    else, and what moves, is an object of its own.
    """

    def __init__(self) -> None:
        """Start without obstacles."""
        self._scene: Scene | None = None
        self._alone: frozenset[str] = frozenset()
        self._own: dict[str, tuple[Any, NDArray[np.float64] | None]] = {}
        self._shared: dict[str, NDArray[np.float32]] = {}

    def draw(self, scene: Scene, *, alone: frozenset[str] = frozenset()) -> list[Command]:
        """Return the commands that turn the picture of the last scene into that of this one.

        Obstacles named ``alone`` are objects of their own even if they stand still, so that they can be hidden.
        """
        if scene is self._scene and alone == self._alone:
            return []
        self._scene, self._alone = scene, alone
        out: list[Command] = []
        instances: dict[str, list[NDArray[np.float64]]] = defaultdict(list)
        seen: set[str] = set()
        moved: list[tuple[str, NDArray[np.float64]]] = []
        for obstacle in scene:
            single = obstacle.motion is not None or obstacle.name in alone
            unit = None if single else bodies.unit_shape(obstacle)
            if unit is not None:
                shape, factors = unit
                T = np.array(obstacle.pose)
                T[:3, :3] *= factors
                instances[shape].append(T)
                continue
            path = self.path(obstacle)
            parts, pose = self._own.get(path, (None, None))
            if parts is not obstacle.parts:
                mesh = bodies.obstacle_mesh(obstacle)
                if mesh is None:
                    continue
                color = MOVING if single else _STILL
                if not single and obstacle.shape in ("voxels", "points"):
                    color = _CLOUD
                out.append(commands.mesh(path, mesh, commands.material(color)))
            seen.add(path)
            if pose is None or not np.array_equal(pose, obstacle.pose):
                moved.append((path, np.asarray(obstacle.pose)))
            self._own[path] = (obstacle.parts, np.asarray(obstacle.pose))
        for path in [p for p in self._own if p not in seen]:
            del self._own[path]
            out.append(commands.delete(path))
        out += self._instances(instances)
        # One command per obstacle: the newest of each is remembered.
        out += [commands.transforms(path, [path], commands.columns(T[None])) for path, T in moved]
        return out

    @staticmethod
    def path(obstacle: Obstacle) -> str:
        """Where an obstacle is in the tree; its name may contain anything."""
        return "/obstacles/" + str(obstacle.name).replace("/", "\N{DIVISION SLASH}").replace("\0", "")

    def moving(self, scene: Scene) -> list[Obstacle]:
        """Obstacles that have an object of their own because they move."""
        return [o for o in scene if o.motion is not None and self.path(o) in self._own]

    def _instances(self, wanted: dict[str, list[NDArray[np.float64]]]) -> list[Command]:
        out: list[Command] = []
        for shape in {*wanted, *self._shared}:
            matrices = commands.columns(wanted[shape]) if wanted.get(shape) else np.zeros((0, 16), dtype=np.float32)
            path = f"/obstacles/all {shape}"
            if shape not in self._shared:
                mesh = bodies.unit_mesh(shape)
                out.append(commands.mesh(path, mesh, commands.material(_STILL), instances=len(matrices)))
            elif np.array_equal(matrices, self._shared[shape]):
                continue
            self._shared[shape] = matrices
            out.append(commands.instances(path, matrices))
        return out
