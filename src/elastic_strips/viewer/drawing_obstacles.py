"""Drawing of obstacles: of a scene, and of one that was estimated, and only what changed of them."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from elastic_strips.arrays import Array, Document
from elastic_strips.scene import UNSEEN_LAYER, Obstacle, Scene
from elastic_strips.scene.parts import Part

from . import commands, geometry
from .commands import Command
from .geometry import Floats, linear

_KINDS = {  # of obstacles: what they are called, and their colour
    "standing": ("obstacle", "#c9a27e"),
    "moving": ("moving obstacle", "#e07a3f"),
    "points": ("sensed points", "#a3adb8"),
    "voxels": ("voxel map", "#8f9db0"),
    "unseen": ("not seen yet", "#8a5fb0"),
    "estimated": ("moving obstacle, as estimated", "#1f9c8c"),
}
MOVING_COLOR = _KINDS["moving"][1]
_STANDING, MOVING = linear(_KINDS["standing"][1]), linear(MOVING_COLOR)
_PREDICTED_TIMES, _MOST_MOVING = ((0.5, 0.35), (1.0, 0.2)), 40  # [s] and how opaque predictions are; of so many movers
_CLOUDS = {"voxels": "map", "points": "sensed"}  # shapes of what sensors saw, and where they are in the tree
_UNSEEN_OPACITY, _ESTIMATED_OPACITY = 0.06, 0.4
NONE = np.zeros((0, 16), dtype=np.float32)


class ObstacleDrawing:
    """The parts of a scene that the browsers already have.

    Boxes, spheres, cylinders and cones that stand still are one object per shape, however many there are. Everything
    else, and what moves, is an object of its own. What was not seen, by its name, can be looked through.
    """

    def __init__(self, *, estimated: bool = False) -> None:
        """Start without obstacles.

        Args:
            estimated: They are shown beside the true ones: as objects of their own, which can be looked through.
        """
        self._estimated = estimated
        self._scene: Scene | None = None
        self._alone: frozenset[str] = frozenset()
        self._own: dict[str, tuple[tuple[Part, ...], Array]] = {}
        self._shared: dict[str, Floats] = {}
        self._seen: set[str] = set()  # kinds of things
        self._predicted: set[str] = set()  # paths of predictions
        self.singles: set[str] = set()  # names of what is an object of its own because it is dragged

    def legend(self) -> list[list[str]]:
        """The meaning of the obstacles' colours."""
        entries = [[name, color] for kind, (name, color) in _KINDS.items() if kind in self._seen]
        if self._predicted:
            entries.append(["where it will be in 0.5 and 1 s", f"color-mix(in srgb, {MOVING_COLOR} 35%, white)"])
        return entries

    def draw(self, scene: Scene, *, alone: frozenset[str] = frozenset()) -> list[Command]:
        """Return the commands that turn the picture of the last scene into that of this one.

        Obstacles named ``alone`` are objects of their own even if they stand still, so that they can be hidden.
        """
        alone = alone | self.singles
        if scene is self._scene and alone == self._alone:
            return []
        self._scene, self._alone = scene, alone
        self._seen.clear()
        titles: dict[str, list[str]] = defaultdict(list)
        out: list[Command] = []
        instances: dict[str, list[Array]] = defaultdict(list)
        seen: set[str] = set()
        moved: list[tuple[str, Array]] = []
        for obstacle in scene:
            unseen = _is_unseen(obstacle)
            single = self._estimated or unseen or obstacle.motion is not None or obstacle.name in alone
            unit = None if single else geometry.unit_shape(obstacle)
            if unit is not None:
                shape, factors = unit
                T = np.array(obstacle.pose)
                T[:3, :3] *= factors
                instances[shape].append(T)
                titles[shape].append(str(obstacle.name))
                self._seen.add("standing")
                continue
            path = self.path(obstacle)
            parts, pose = self._own.get(path, (None, None))
            still = obstacle.motion is None and (obstacle.name in self.singles or obstacle.name not in alone)
            kind = "moving" if not still else obstacle.shape if obstacle.shape in _CLOUDS else "standing"
            kind = UNSEEN_LAYER if unseen else "estimated" if self._estimated and kind == "moving" else kind
            self._seen.add(kind)
            if parts is not obstacle.parts:
                mesh = geometry.obstacle_mesh(obstacle)
                if mesh is None:
                    continue
                out.append(
                    commands.mesh(
                        path, mesh, _look(kind, estimated=self._estimated), cast=not (self._estimated or unseen)
                    )
                )
                out.append(commands.names(path, [path], [str(obstacle.name)]))
            seen.add(path)
            if pose is None or not np.array_equal(pose, obstacle.pose):
                moved.append((path, np.asarray(obstacle.pose)))
            self._own[path] = (obstacle.parts, np.asarray(obstacle.pose))
        for path in [p for p in self._own if p not in seen]:
            del self._own[path]
            out.append(commands.delete(path))
        out += self._instances(instances, titles)
        # One command per obstacle: the newest of each is remembered.
        out += [commands.transforms(path, [path], commands.columns(T[None])) for path, T in moved]
        return out

    def predictions(self, scene: Scene) -> list[Command]:
        """Draw where obstacles that move will be soon, if they go on as their motions say."""
        out, seen = [], set()
        for obstacle in self.moving(scene)[:_MOST_MOVING]:
            for k, (ahead, opacity) in enumerate(_PREDICTED_TIMES):
                path = f"/predictions/{k}/{self.path(obstacle).rsplit('/', 1)[1]}"
                seen.add(path)
                if path not in self._predicted:
                    mesh = geometry.obstacle_mesh(obstacle)
                    assert mesh is not None  # it is drawn itself
                    out.append(
                        commands.mesh(path, mesh, commands.material(MOVING, opacity=opacity, hides=False), cast=False)
                    )
                T = commands.columns(np.asarray(obstacle.at(scene.time + ahead).pose)[None])
                out.append(commands.transforms(path, [path], T))
        out += [commands.delete(path) for path in self._predicted - seen]
        self._predicted = seen
        return out

    def path(self, obstacle: Obstacle) -> str:
        """Where an obstacle is in the tree; its name may contain anything."""
        branch = _CLOUDS.get(obstacle.shape, "map" if self._estimated else "obstacles")
        branch = UNSEEN_LAYER if _is_unseen(obstacle) else branch
        inner = "estimated " if self._estimated else ""
        return f"/{branch}/{inner}" + str(obstacle.name).replace("/", "\N{DIVISION SLASH}").replace("\0", "")

    def moving(self, scene: Scene) -> list[Obstacle]:
        """Obstacles that have an object of their own because they move."""
        return [o for o in scene if o.motion is not None and self.path(o) in self._own]

    def _instances(self, wanted: dict[str, list[Array]], titles: dict[str, list[str]]) -> list[Command]:
        out: list[Command] = []
        for shape in {*wanted, *self._shared}:
            matrices = commands.columns(wanted[shape]) if wanted.get(shape) else NONE
            path = f"/obstacles/all {shape}"
            if shape not in self._shared:
                mesh = geometry.UNIT_MESHES[shape]()
                out.append(commands.mesh(path, mesh, commands.material(_STANDING), instances=len(matrices)))
            elif np.array_equal(matrices, self._shared[shape]):
                continue
            self._shared[shape] = matrices
            out.append(commands.instances(path, matrices, names=titles[shape]))
        return out


def _look(kind: str, *, estimated: bool) -> Document:
    opacity = _UNSEEN_OPACITY if kind == UNSEEN_LAYER else _ESTIMATED_OPACITY if estimated else 1.0
    lit = kind != UNSEEN_LAYER
    look = commands.material(linear(_KINDS[kind][1]), opacity=opacity, hides=opacity == 1.0, lit=lit)
    return look if lit else look | {"side": 0}  # its outside alone: much of it lies in a row


def estimated_look(*, moves: bool) -> Document:
    """The look of what sensors made of the world: of what moves, or of what stands."""
    return _look("estimated" if moves else "voxels", estimated=True)


def estimated_legend() -> list[list[str]]:
    """The meaning of these two colours."""
    return [list(_KINDS["voxels"]), list(_KINDS["estimated"])]


def _is_unseen(obstacle: Obstacle) -> bool:
    return str(obstacle.name).startswith(UNSEEN_LAYER)
