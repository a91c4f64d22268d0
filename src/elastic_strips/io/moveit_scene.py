"""IO room, MoveIt scenes: the text files (``.scene``) that MoveIt and its RViz panel write, as scenes.

A file is a line with a name, then objects, then a line with ``.``. An object is ``* id``, its pose, the number of its
shapes, the shapes, and the number of its subframes with a name and a pose each. Older files have neither the object's
pose nor subframes. A shape is its kind, its sizes, its pose and a colour; a pose is x y z and qx qy qz qw.
"""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import InputError, SceneError, nearest_name
from elastic_strips.files import read_input_text
from elastic_strips.scene import Box, Cone, Cylinder, Mesh, Obstacle, Scene, Sphere
from elastic_strips.scene.quantities import pose_of, quaternion_of
from elastic_strips.validation import check_choice

from .point_cloud import LARGE_MESH, warn_of_units

_log = logging.getLogger(__name__)
MAX_BYTES = 20_000_000
_SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "cone": 2, "plane": 4}
_SHAPES: dict[str, Callable[..., Obstacle]] = {"sphere": Sphere, "cylinder": Cylinder, "cone": Cone}
PLANE_SIZE = (200.0, 200.0, 0.1)
"""Lengths [m] of the slab that stands for a plane."""
_LEAST_NORM = 0.5  # of a quaternion; one that is not quite of length 1 is normalised, as it was printed in few digits


def read_moveit_scene(path: str | os.PathLike[str], *, planes: str = "blocked") -> Scene:
    """Read the obstacles of a MoveIt scene file, of the newer format or the older one without poses of objects.

    Obstacles have the objects' names; those of an object of several shapes have a number after it. A plane has no
    end: it becomes a slab (`plane_slab`). Left out, with a warning in the log: colours and subframes. The file's frame
    is taken as the world.

    Args:
        path: the file.
        planes: ``"blocked"``, or ``"free"``: they are left out.

    Raises:
        SceneError: no such file, or one that does not fit the format; the message names file and line.
    """
    check_choice("planes", planes, ("blocked", "free"), SceneError)
    file = Path(path)
    return _Reader(file, read_input_text(file, "MoveIt scene", MAX_BYTES, SceneError), planes == "free").scene()


def plane_slab(coef: Array, pose: Array, name: str | None) -> Obstacle:
    """A plane as a slab of `PLANE_SIZE` behind it, about the point of it that is nearest to its pose's origin.

    Args:
        coef: (4,) a, b, c, d of a x + b y + c z + d = 0 in the frame of ``pose``; negative values are behind the plane.
        pose: (4, 4) pose [m].
        name: name of the obstacle.
    """
    length = float(np.linalg.norm(coef[:3]))
    normal = coef[:3] / length
    turn = np.eye(3)
    turn[:, 2] = normal
    turn[:, 0] = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    turn[:, 0] /= np.linalg.norm(turn[:, 0])
    turn[:, 1] = np.cross(normal, turn[:, 0])
    middle = -(coef[3] / length + 0.5 * PLANE_SIZE[2]) * normal
    at = pose[:3, :3] @ middle + pose[:3, 3]
    return Box(PLANE_SIZE, at=at, quat=quaternion_of(pose[:3, :3] @ turn), name=name)


class _Reader:
    """A cursor over the words of a file, which knows its line."""

    def __init__(self, file: Path, text: str, planes_free: bool) -> None:
        self._file = file
        self._planes_free = planes_free
        self._lines = text.splitlines()
        self._at = 1  # lines taken; the first is the scene's name
        self._words: list[str] = []  # of the current line that are left, the next one last
        self._dropped: dict[str, int] = {}
        self._doubt: tuple[int, str] | None = None  # line of sizes of this object that are not one line, and what of
        self._posed = self._has_poses()

    def scene(self) -> Scene:
        """All of the file."""
        objects: dict[str, list[tuple[Callable[..., Obstacle], Array, int]]] = {}
        while (marker := self._word("'*' or '.'")) != ".":
            if marker != "*":
                self._fail(f"must be '* name' of an object, or '.' at the end, not {marker[:40]!r}")
            name = " ".join(reversed(self._words))
            self._words = []
            if not name:
                self._fail("the object has no name")
            shapes = objects.setdefault(name, [])
            self._doubt = None
            pose = self._pose() if self._posed else np.eye(4)
            for _ in range(self._count("the number of shapes")):
                line = self._at + 1  # where the shape begins
                make = self._shape()
                at = pose @ self._pose()
                if any(self._numbers(4, "a colour")):
                    self._drop("colours")
                if make is not None:
                    shapes.append((make, at, line))
            for _ in range(self._count("the number of subframes") if self._posed else 0):
                self._word("a subframe's name")
                self._pose()
                self._drop("subframes")
        names = set(objects)
        obstacles: list[Obstacle] = []
        for name, shapes in objects.items():
            for k, (make, at, line) in enumerate(shapes, 1):
                called = name
                if len(shapes) > 1:
                    called = f"{name}-{k}"
                    while called in names:
                        called += "'"
                    names.add(called)
                try:
                    obstacles.append(make(at=at[:3, 3], quat=quaternion_of(at[:3, :3]), name=called))
                except InputError as error:
                    raise SceneError(f"{self._file}:{line}: {error}") from None
        if self._dropped:
            said = ", ".join(f"{count} {what}" for what, count in self._dropped.items())
            _log.warning("%s: left out: %s", self._file, said)
        return Scene(obstacles)

    def _has_poses(self) -> bool:
        """Whether objects have poses: then the line after the first object's name holds several numbers."""
        if not self._lines:
            self._at = 0
            self._fail("the file is empty")
        rest = iter(self._lines[1:])
        first = next((line for line in rest if line.lstrip().startswith("*")), None)
        return first is not None and len(next((line for line in rest if line.strip()), "").split()) > 1

    def _shape(self) -> Callable[..., Obstacle] | None:
        """A function that makes a shape of its place and name; None where the shape is left out."""
        kind = self._word("a shape")
        if kind == "mesh":
            vertices, triangles = (self._count(f"the number of {what}") for what in ("vertices", "triangles"))
            points = np.array(self._numbers(3 * vertices, "a vertex")).reshape(-1, 3)
            faces = np.array(self._numbers(3 * triangles, "a triangle")).reshape(-1, 3)
            if len(points):
                warn_of_units(f"{self._file}:{self._at}: the mesh", points, LARGE_MESH)
            return lambda **where: Mesh(points, faces, **where)
        if kind not in _SIZES:
            self._fail(f"shapes of the kind {kind[:40]!r} are not read{nearest_name(kind[:40], [*_SIZES, 'mesh'])}")
        line = self._at if self._words else self._at + 1
        sizes = self._numbers(_SIZES[kind], f"sizes of a {kind}")
        if self._words or self._at > line:  # one is missing or too many, if what follows does not fit either
            self._doubt = line, f"the {_SIZES[kind]} sizes of a {kind} are not one line"
        if kind == "plane":
            if self._planes_free:
                self._drop("planes")
                return None
            if not any(sizes[:3]):
                self._fail("a plane's normal must not be 0")
            return lambda at, quat, name: plane_slab(np.array(sizes), pose_of(at, quat), name)
        if kind == "box":
            return lambda **where: Box(sizes, **where)
        return lambda **where: _SHAPES[kind](*sizes, **where)

    def _pose(self) -> Array:
        """(4, 4) of a position and a quaternion."""
        at, quat = self._numbers(3, "a position"), np.array(self._numbers(4, "a quaternion"))
        norm = float(np.linalg.norm(quat))
        if not _LEAST_NORM < norm < 1.0 / _LEAST_NORM:
            self._fail(f"the quaternion has length {norm:.3g}; it must have 1")
        try:
            return pose_of(at, quat / norm)
        except InputError as error:
            self._fail(str(error))

    def _numbers(self, count: int, what: str) -> list[float]:
        values: list[float] = []
        for _ in range(count):
            word = self._word(what)
            try:
                values.append(float(word))
            except ValueError:
                self._fail(f"{word[:40]!r} in {what} is not a number")
            if not math.isfinite(values[-1]):
                self._fail(f"{word[:40]!r} in {what} is not finite")
        return values

    def _count(self, what: str) -> int:
        word = self._word(what)
        if not (word.isascii() and word.isdecimal()) or len(word) > 7:
            self._fail(f"{what} must be a whole number below 10000000, not {word[:40]!r}")
        return int(word)

    def _word(self, what: str) -> str:
        while not self._words:
            if self._at >= len(self._lines):
                self._fail(f"the file ends where {what} is needed; it ends with '.' alone on a line")
            self._words = self._lines[self._at].split()[::-1]
            self._at += 1
        return self._words.pop()

    def _drop(self, what: str) -> None:
        self._dropped[what] = self._dropped.get(what, 0) + 1

    def _fail(self, message: str) -> NoReturn:
        line = max(self._at, 1)
        if self._doubt is not None:
            line, message = self._doubt[0], f"{self._doubt[1]}; in line {line}: {message}"
        raise SceneError(f"{self._file}:{line}: {message}")
