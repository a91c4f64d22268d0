"""Rays against the obstacles of a simulated world: what rests is placed once, what moves at every cast."""

from __future__ import annotations

from collections.abc import Collection, Iterable

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
        self._still = frozenset(world.names_resting)
        self._moving: tuple[tuple[Part, ...], Indices, _PartBodies] = (), np.zeros(0, dtype=np.intp), _PartBodies([])
        self.glass: frozenset[str] = frozenset()
        self._resting, self._panes = self._placed(self._still), self._placed(self.glass)

    def make_of_glass(self, names: Collection[str]) -> None:
        """From now on light passes through these of the obstacles that rest, and through no others."""
        glass = self._still & frozenset(names)
        if glass == self.glass:
            return
        self.glass = glass
        self._resting, self._panes = self._placed(self._still - self.glass), self._placed(self.glass)

    def cast(self, t: float, rays: Rays, reach: float, *, normals: bool = False, light: bool = True) -> Nearest:
        """First hits of rays in the world frame, at time ``t`` [s].

        Args:
            t: the time [s].
            rays: rays to cast; one that begins inside an obstacle has the distance 0.
            reach: their length [m].
            normals: whether the normals of the surfaces are wanted.
            light: whether the rays pass through glass; sound does not.

        Returns:
            Distances are infinite beyond ``reach``.
        """
        scene, nearest = self.world.at(t), Nearest(len(rays), normals=normals)
        if self._moving[0] is not scene.table.parts:
            rows = self._rows(scene, frozenset(scene.names) - self._still)
            self._moving = scene.table.parts, rows, _PartBodies(scene.table.parts[k] for k in rows)
        _, rows, moving = self._moving
        moving.place(scene, rows)
        for bodies in (self._resting.bodies, moving.bodies, *(() if light else (self._panes.bodies,))):
            bodies.cast(rays, nearest, reach=reach, inside=0.0)
        return nearest

    def _placed(self, names: frozenset[str]) -> _PartBodies:
        """The parts of obstacles that rest, where they are."""
        scene = self.world.scene
        rows = self._rows(scene, names)
        bodies = _PartBodies(scene.table.parts[k] for k in rows)
        bodies.place(scene, rows)
        return bodies

    def _rows(self, scene: Scene, names: frozenset[str]) -> Indices:
        """The parts of a scene that are of obstacles of these names."""
        mine = np.array([name in names for name in scene.names], dtype=bool)
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
