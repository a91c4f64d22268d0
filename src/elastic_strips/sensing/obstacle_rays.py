"""Sensing room, obstacle rays: where beams meet the obstacles of a scene as it is at one time.

Boxes, spheres, cylinders, capsules and cones are met by formulas. All other obstacles are triangles: those that never
move, appear or vanish share one tree of boxes, each other one has its own, in its frame, so that no tree is built anew
as it moves.
"""

from __future__ import annotations

import numpy as np

from ..robot.space import Array
from ..scene import Obstacle, Scene, World
from ..scene.parts import Part
from .primitives import Primitives, is_primitive
from .rays import Nearest, Rays
from .triangles import Corners, TriangleBody, joined, part_meshes


class ObstacleRays:
    """Workspace: the obstacles of a world as beams meet them.

    Args:
        world: where the obstacles are; what it holds is made ready here.

    Raises:
        MissingExtraError: an obstacle is a hull, a mesh, voxels or points, and Embree is not installed.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self._primitives: tuple[tuple[Part, ...], Primitives] = (), Primitives.of([])
        self._own: dict[str, TriangleBody] = {}
        made: dict[int, TriangleBody] = {}
        still: list[tuple[Array, list[Corners]]] = []
        for obstacle in world.scene:
            name, meshes = obstacle.name or "", _meshes(obstacle)
            if not meshes:
                continue
            if obstacle.motion is None and name not in world.appears and name not in world.vanishes:
                still.append((obstacle.pose, meshes))
                continue
            shape = id(obstacle.solid)  # copies share it, and the world keeps it
            if shape not in made:
                made[shape] = TriangleBody(meshes)
            self._own[name] = made[shape]
        self._still = joined(still) if still else None

    def cast(self, t: float, rays: Rays, reach: float, *, normals: bool = False) -> Nearest:
        """Where rays, given in the world, first meet an obstacle at time ``t`` [s].

        Args:
            t: the time.
            rays: the beams; one that begins inside an obstacle has the distance 0.
            reach: how far they go [m].
            normals: whether the normals of the surfaces are wanted.

        Returns:
            Distances are infinite beyond ``reach``.
        """
        scene, nearest = self.world.at(t), Nearest(len(rays), normals=normals)
        table = scene.table
        primitives = self._of(scene)
        rows = primitives.row
        primitives.cast(table.rotation[rows], table.translation[rows], rays, nearest, reach=reach, inside=0.0)
        if self._still is not None:
            self._still.cast(np.eye(4), rays, nearest, reach=reach, inside=0.0)
        for name, body in self._own.items():
            if name in scene:
                body.cast(scene.obstacle(name).pose, rays, nearest, reach=reach, inside=0.0)
        nearest.distance[nearest.distance > reach] = np.inf
        return nearest

    def _of(self, scene: Scene) -> Primitives:
        """The primitives among a scene's parts; made anew where other obstacles exist than the last time."""
        parts = scene.table.parts
        if self._primitives[0] is not parts:
            self._primitives = parts, Primitives.of([p.geometry for p in parts])
        return self._primitives[1]


def _meshes(obstacle: Obstacle) -> list[Corners]:
    """Triangles of an obstacle's parts that are no primitives, in its frame."""
    return [m for part in obstacle.parts if not is_primitive(part.geometry) for m in part_meshes(part)]
