"""Rays against the obstacles of a simulated world: what rests is placed once, what moves at every cast."""

from __future__ import annotations

from collections.abc import Iterable

import coal
import numpy as np

from elastic_strips.arrays import Array, Indices
from elastic_strips.perception.rays import Nearest, RayBodies, Rays
from elastic_strips.scene import Scene, World
from elastic_strips.scene.parts import Part


class ObstacleRays:
    """Workspace: the obstacles of a world, to cast rays against.

    Args:
        world: the obstacles over time.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self._still = {
            o.name for o in world.scene if o.motion is None and o.name not in (*world.appears, *world.vanishes)
        }
        rows = self._rows(world.scene, still=True)
        self._resting = _PartBodies(world.scene.table.parts[k] for k in rows)
        self._resting.place(world.scene, rows)
        self._moving: tuple[tuple[Part, ...], Indices, _PartBodies] = (), rows[:0], _PartBodies([])

    def cast(self, t: float, rays: Rays, reach: float, *, normals: bool = False) -> Nearest:
        """First hits of rays in the world frame, at time ``t`` [s].

        Args:
            t: the time [s].
            rays: rays to cast; one that begins inside an obstacle has the distance 0.
            reach: their length [m].
            normals: whether the normals of the surfaces are wanted.

        Returns:
            Distances are infinite beyond ``reach``.
        """
        scene, nearest = self.world.at(t), Nearest(len(rays), normals=normals)
        if self._moving[0] is not scene.table.parts:
            rows = self._rows(scene, still=False)
            self._moving = scene.table.parts, rows, _PartBodies(scene.table.parts[k] for k in rows)
        _, rows, moving = self._moving
        moving.place(scene, rows)
        for bodies in (self._resting.bodies, moving.bodies):
            bodies.cast(rays, nearest, reach=reach, inside=0.0)
        return nearest

    def _rows(self, scene: Scene, *, still: bool) -> Indices:
        """The parts of a scene that are of obstacles that rest, or of the others."""
        mine = np.array([(o.name in self._still) == still for o in scene], dtype=bool)
        return np.flatnonzero(mine[scene.table.obstacle_index])


class _PartBodies:
    """Parts of obstacles as bodies: a block's boxes are bodies each."""

    def __init__(self, parts: Iterable[Part]) -> None:
        geometries: list[coal.CollisionGeometry] = []
        shift: list[Array] = []
        part: list[int] = []
        for k, each in enumerate(parts):
            members = each.boxes if each.geometry is None else ((each.geometry, np.zeros(3)),)
            geometries += [geometry for geometry, _ in members]
            shift += [at for _, at in members]
            part += [k] * len(members)
        self.bodies = RayBodies(geometries)
        self._shift, self._part = np.array(shift).reshape(-1, 3), np.array(part, dtype=np.intp)

    def place(self, scene: Scene, rows: Indices) -> None:
        """Put them where these rows of the scene's table are."""
        at = rows[self._part]
        rotation = scene.table.rotation[at]
        turned = np.matmul(rotation, self._shift[:, :, None])[:, :, 0]
        self.bodies.place(rotation, scene.table.translation[at] + turned)
