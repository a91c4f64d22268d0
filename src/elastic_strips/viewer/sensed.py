"""What sensors see, beside the true scene: points and pictures of the newest images, their views, and what was made of
them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.perception.readings import DepthImage, RangeImage, Reading, pose_matrix
from elastic_strips.scene import Scene

from . import commands
from .commands import Command
from .drawing_obstacles import ObstacleDrawing
from .geometry import linear

_MOST_POINTS = 5000  # of all sensors
_MOST_PIXELS = 20_000  # of a picture
_PERIOD = 0.2  # [s] from one picture of a sensor to the next, and from one map to the next
_POINTS, _VIEWS, _GAZE = "#1672b8", "#5b7fa6", "#c2257a"
_VIEW_LENGTH = 1.5  # [m] along its axis, of a view that is drawn: whole ones go through everything
_SAME_TIME = 1e-6  # [s]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seen:
    """What sensors see, to be shown.

    Attributes:
        readings: the newest of each sensor, with the base's pose (x [m], y [m], yaw [rad]) when it was measured.
        scene: the scene that was made of them.
        target: (3,) what a camera is turned to [m], or None.
    """

    readings: tuple[tuple[Reading, ArrayLike], ...] = ()
    scene: Scene | None = None
    target: ArrayLike | None = None


class SeenDrawing:
    """Workspace: what the browsers already have of it; used by one thread."""

    def __init__(self) -> None:
        """Start with nothing."""
        self._obstacles = ObstacleDrawing(estimated=True)
        self._drawn: tuple[Reading, ...] = ()
        self._target: ArrayLike | None = None
        self._pictures: dict[str, float] = {}
        self._map = -np.inf  # time of the scene that is drawn

    def legend(self) -> list[list[str]]:
        """The meaning of its colours."""
        entries = [["what sensors see", _POINTS]] if self._drawn else []
        entries += [["what the camera looks at", _GAZE]] if self._target is not None else []
        return entries + self._obstacles.legend()

    def draw(self, seen: Seen | None) -> list[Command]:
        """The commands that bring the picture up to date; nothing for what is as it was."""
        seen = seen or Seen()
        out: list[Command] = []
        readings = tuple(reading for reading, _ in seen.readings)
        changed = [id(reading) for reading in readings] != [id(reading) for reading in self._drawn]
        if changed or seen.target is not self._target:
            out += _views(seen)
        if changed:
            out.append(commands.points("/sensed/points", _places(seen), linear(_POINTS)))
            out += self._inset(readings)
        self._drawn, self._target = readings, seen.target
        scene = seen.scene or Scene()
        if seen.scene is None or not 0.0 <= scene.time - self._map < _PERIOD - _SAME_TIME:
            out += self._obstacles.draw(scene)
            self._map = -np.inf if seen.scene is None else scene.time
        return out

    def _inset(self, readings: Iterable[Reading]) -> list[Command]:
        out, there = [], set()
        for reading in readings:
            if not isinstance(reading, (DepthImage, RangeImage)):
                continue
            there.add(reading.sensor)
            if not 0.0 <= reading.time - self._pictures.get(reading.sensor, -np.inf) < _PERIOD - _SAME_TIME:
                self._pictures[reading.sensor] = reading.time
                out.append(commands.depth(reading.sensor, *_picture(reading)))
        for name in set(self._pictures) - there:
            del self._pictures[name]
            out.append(commands.depth(name, np.zeros((0, 0), dtype=np.uint8), 0.0, 0.0))
        return out


def _reach(image: DepthImage | RangeImage) -> tuple[float, float]:
    if isinstance(image, DepthImage):
        return image.depth_min, image.depth_max
    return image.range_min, image.range_max


def _picture(image: DepthImage | RangeImage) -> tuple[npt.NDArray[np.uint8], float, float]:
    """Bytes (H, W) of an image as one looks along it, and the ranges [m] that 1 and 254 stand for.

    0 is no answer, and 255 is nothing.
    """
    ranges, (near, far) = image.ranges, _reach(image)
    every = max(1, int(np.ceil(np.sqrt(ranges.size / _MOST_PIXELS))))
    ranges = ranges[::every, ::every]
    if isinstance(image, RangeImage):  # angles grow to the left and upwards
        columns, rows = (-1 if last > first else 1 for first, last in (image.azimuth, image.elevation))
        ranges = ranges[::rows, ::columns]
        far = min(far, 10.0)  # of 40 m nothing near could be told apart
    known = np.where(np.isfinite(ranges), ranges, 0.0)
    levels = 1.0 + 253.0 * np.clip((known - near) / max(far - near, 1e-9), 0.0, 1.0)
    levels[np.isnan(ranges)], levels[np.isposinf(ranges)] = 0.0, 255.0
    return np.rint(levels).astype(np.uint8), near, far


def _places(seen: Seen) -> Array:
    """Where the readings met something (n, 3) [m]: evenly, at most so many of all of them."""
    found = []
    share = _MOST_POINTS // max(len(seen.readings), 1)
    for reading, pose in seen.readings:
        points = reading.points()
        points = points[:: max(1, -(-len(points) // share))]
        T = pose_matrix(pose)
        found.append(points @ T[:3, :3].T + T[:3, 3])
    return np.concatenate(found) if found else np.zeros((0, 3))


def _views(seen: Seen) -> list[Command]:
    """The edges of what cameras look at, and a line from the first of them to what it is turned to."""
    edges, gaze = [], []
    for reading, pose in seen.readings:
        if not isinstance(reading, DepthImage):
            continue
        T = pose_matrix(pose) @ reading.T_base_sensor
        rows, columns = np.array(reading.depth.shape) - 0.5
        pixels = np.array([[-0.5, -0.5], [columns, -0.5], [columns, rows], [-0.5, rows]])
        corners = np.column_stack(((pixels - reading.center) / reading.focal, np.ones(4))) * min(
            reading.depth_max, _VIEW_LENGTH
        )
        corners = corners @ T[:3, :3].T + T[:3, 3]
        for k in range(4):
            edges += [(T[:3, 3], corners[k]), (corners[k], corners[(k + 1) % 4])]
        if seen.target is not None and not gaze:
            gaze.append((T[:3, 3], np.asarray(seen.target, dtype=float)))
    return [
        commands.lines("/views/edges", np.reshape(edges, (-1, 2, 3)), linear(_VIEWS)),
        commands.lines("/views/gaze", np.reshape(gaze, (-1, 2, 3)), linear(_GAZE)),
    ]
