"""IO room, Nav2 maps: an occupancy map (YAML, and PGM, PNG or BMP) as a scene of voxels."""

from __future__ import annotations

import importlib
import io
import logging
import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from elastic_strips.arrays import Array, ArrayLike, Mask
from elastic_strips.errors import ScenarioError, missing_extra, plural
from elastic_strips.files import read_input
from elastic_strips.scene import Box, ConvexHull, Obstacle, Scene, Voxels
from elastic_strips.scene.parts import MAX_CENTERS
from elastic_strips.scene.quantities import check_pose, quaternion_of
from elastic_strips.validation import check_choice, check_number, shown

from .nodes import Node, load_yaml

_log = logging.getLogger(__name__)
_KEYS = ("image", "mode", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
MAX_BYTES = 100_000_000
_MAX_CELLS = 16_000_000
_COMMENT = re.compile(rb"#[^\r\n]*")
_MODES = ("trinary", "scale", "raw")
_FULL_OCCUPANCY = 100.0  # occupancy of a cell that is certainly occupied
WALL_HEIGHT = 3.0
"""Height [m] of a map's walls where neither it nor the robot is known: more than mobile manipulators reach."""
_OUTSIDE_EDGE = (
    20_000.0  # [m] to which a map's outside is filled: robots stay within 10 km of the origin; proofs take no more
)
_LEAST_MAP_EDGE = 2.0  # [m] of a map that is as large itself
_NARROWEST_GAP = 0.01  # [m] a gap between two maps that is narrower is none
_WHOLE_TURN = 2.0 * math.pi  # [rad]


@dataclass(frozen=True, slots=True, eq=False)
class MapArea:
    """The rectangle that a map shows.

    Attributes:
        T_world_map: pose (4, 4) of its lower left corner; it stands upright.
        size: (2,) its lengths along the map's x and y [m].
        low, high: heights between which its walls are [m].
    """

    T_world_map: Array
    size: Array
    low: float
    high: float

    def holds(self, points: ArrayLike) -> Mask:
        """Which points (N, 2) of the world [m] are inside, as booleans (N,)."""
        local = (np.asarray(points, dtype=float) - self.T_world_map[:2, 3]) @ self.T_world_map[:2, :2]
        return np.all((local >= 0.0) & (local <= self.size), axis=1)

    def corners(self) -> Array:
        """Its corners (4, 2) in the world [m], anticlockwise."""
        local = self.size * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        return local @ self.T_world_map[:2, :2].T + self.T_world_map[:2, 3]

    def edges(self) -> list[Obstacle]:
        """Four boxes around it, about 19 km wide: a robot that leaves the map, or was never on it, meets one."""
        return [
            self.block(f"outside-of-map-{name}", np.array([low, (low[0], high[1]), (high[0], low[1]), high]))
            for name, (low, high) in self.beyond().items()
        ]

    def beyond(self) -> dict[str, tuple[tuple[float, float], tuple[float, float]]]:
        """Low and high corners [m] of rectangles around it, in its own frame; like the sails of a windmill."""
        x, y = self.size.tolist()
        far = max(_OUTSIDE_EDGE - max(x, y), _LEAST_MAP_EDGE)
        return {
            "left": ((-far, -far), (0.0, y)),
            "right": ((x, 0.0), (x + far, y + far)),
            "lower": ((0.0, -far), (x + far, 0.0)),
            "upper": ((-far, y), (x, y + far)),
        }

    def block(self, name: str, outline: Array) -> Obstacle:
        """An obstacle as high as its walls over a convex outline (K, 2) in its own frame [m]."""
        low, high = outline.min(axis=0), outline.max(axis=0)
        middle, size = 0.5 * (low + high), high - low
        place = self.T_world_map @ (*middle, 0.5 * (self.low + self.high) - self.T_world_map[2, 3], 1.0)
        at, quat, height = place[:3], quaternion_of(self.T_world_map[:3, :3]), self.high - self.low
        if len(outline) == 4 == len(np.unique(outline, axis=0)) and ((outline == low) | (outline == high)).all():
            return Box((*size, height), at=at, quat=quat, name=name)
        ends = [np.column_stack((outline - middle, np.full(len(outline), z))) for z in (-0.5 * height, 0.5 * height)]
        return ConvexHull(np.vstack(ends), at=at, quat=quat, name=name)


def outside_of(areas: Sequence[MapArea]) -> list[Obstacle]:
    """Obstacles for everything that no map shows: four boxes around one map; what is left of them beside others."""
    first = areas[0]
    if len(areas) == 1:
        return first.edges()
    all_high = replace(first, low=min(area.low for area in areas), high=max(area.high for area in areas))
    found: list[Obstacle] = []
    for (x, y), (x_end, y_end) in first.beyond().values():
        outlines = [np.array([(x, y), (x_end, y), (x_end, y_end), (x, y_end)])]
        for area in areas[1:]:
            hole = (area.corners() - first.T_world_map[:2, 3]) @ first.T_world_map[:2, :2]
            outlines = [rest for outline in outlines for rest in _without(outline, hole)]
        found += [
            all_high.block(f"outside-of-map-{number}", outline)
            for number, outline in enumerate(outlines, len(found) + 1)
        ]
    return found


def _without(outline: Array, hole: Array) -> list[Array]:
    """What is left of a convex outline (K, 2) without a convex hole (M, 2), as convex outlines; anticlockwise."""
    found: list[Array] = []
    for start, end in zip(hole, np.roll(hole, -1, axis=0), strict=True):
        along = (end - start) / np.linalg.norm(end - start)
        outward = np.array([along[1], -along[0]])
        beyond, outline = (_clipped(outline, sign * outward, sign * float(outward @ start)) for sign in (1.0, -1.0))
        if _width(beyond) > _NARROWEST_GAP:
            found.append(beyond)
        if _width(outline) <= _NARROWEST_GAP:
            break
    return found


def _clipped(outline: Array, normal: Array, least: float) -> Array:
    """The part of a convex outline (K, 2) where ``normal`` · x ≥ ``least``."""
    kept: list[Array] = []
    depth = outline @ normal - least
    for k, (one, here) in enumerate(zip(outline, depth, strict=True)):
        two, there = outline[(k + 1) % len(outline)], depth[(k + 1) % len(outline)]
        if here >= 0.0:
            kept.append(one)
        if (here > 0.0 > there) or (here < 0.0 < there):
            kept.append(one + here / (here - there) * (two - one))
    return np.array(kept).reshape(-1, 2)


def _width(outline: Array) -> float:
    """How wide a convex outline (K, 2) is where it is narrowest [m]."""
    if len(outline) < 3:
        return 0.0
    along = np.roll(outline, -1, axis=0) - outline
    length = np.linalg.norm(along, axis=1)
    along = along[length > 1e-6] / length[length > 1e-6, None]
    if len(along) < 3:
        return 0.0
    normals = np.column_stack((-along[:, 1], along[:, 0]))
    return float(np.ptp(normals @ outline.T, axis=1).min())


def load_nav2_map(
    path: str | os.PathLike[str],
    *,
    unknown: str = "free",
    height: float = WALL_HEIGHT,
    lethal: float = _FULL_OCCUPANCY,
    low: float = 0.0,
    outside: str = "blocked",
) -> Scene:
    """A map in Nav2's format as a scene with one obstacle, ``map``: a box from the floor up for every occupied cell.

    A pixel of brightness b (of 255) has the occupancy p = (255 − b) / 255, or b / 255 where ``negate`` is set. A cell
    is occupied where p ≥ ``occupied_thresh``, else free where p ≤ ``free_thresh``. Between, mode ``trinary`` says that
    it is unknown, and ``scale`` has it from 0 to 100 in proportion. A pixel that is not opaque is unknown. In mode
    ``raw`` it is b itself up to 100, and unknown above. Nav2 before 2025 took opacity for one more colour in mode
    ``trinary``; cells that it took for occupied then are occupied here, too.

    Neighbouring boxes are merged. A map without an occupied cell gives no obstacle ``map``. A warning in the log says
    how many cells are left out that are unknown, or between free and occupied, and which keys are not known.

    A map says nothing about what is outside it: four boxes, ``outside-of-map-left``, ``-right``, ``-lower`` and
    ``-upper``, surround it, to about 19 km, so that nothing that leaves it or is beyond it is certified or planned.

    Args:
        path: The map's YAML file; it names the image, a PGM, PNG or BMP file. All but PGM need the extra ``ros``.
        unknown: How unknown cells count: ``"free"``, as in Nav2's planners by default, or ``"occupied"``.
        height: Height [m] up to which the boxes reach: as high as the robot's arm can get, or it passes over them.
        lethal: Occupancy in (0, 100] from which on a cell of mode ``scale`` or ``raw`` is occupied; by default the
            value that Nav2's static layer takes.
        low: Height [m] at which they begin.
        outside: ``"blocked"``, or ``"free"``, which leaves out the four boxes.

    Raises:
        MissingExtraError: The image is not a PGM file, and Pillow is not installed.
        ScenarioError: A file is missing, cannot be read, or does not fit; the message names file, line and key.
    """
    walls, area = read_map(path, unknown=unknown, height=height, lethal=lethal, low=low)
    check_choice("outside", outside, ("blocked", "free"), ScenarioError)
    return Scene([*walls, *(area.edges() if outside == "blocked" else ())])


def read_map(
    path: str | os.PathLike[str],
    *,
    unknown: str = "free",
    height: float = WALL_HEIGHT,
    lethal: float = _FULL_OCCUPANCY,
    low: float = 0.0,
    at: Array | None = None,
    name: str = "map",
) -> tuple[list[Obstacle], MapArea]:
    """The walls of a map, and the area that it shows; see `load_nav2_map`.

    Args:
        path, unknown, height, lethal, low: as for `load_nav2_map`; heights are the world's.
        at: pose (4, 4) of the map's frame in the world, upright.
        name: name of the obstacle.

    Raises:
        MissingExtraError, ScenarioError: as for `load_nav2_map`.
    """
    check_choice("unknown", unknown, ("free", "occupied"), ScenarioError)
    check_number("lethal", lethal, above=0.0, high=_FULL_OCCUPANCY, error=ScenarioError)
    check_number("height", height, unit="m", error=ScenarioError)
    check_number("low", low, unit="m", error=ScenarioError)
    root = load_yaml(path, error=ScenarioError)
    needed = ("image", "resolution", "origin", "occupied_thresh", "free_thresh")
    entries = root.mapping(needed=needed, what="a map")
    if others := sorted(entries.keys() - set(_KEYS)):  # Nav2 does not look at them
        _log.warning("%s: left out: the keys %s", root.source.path, ", ".join(shown(key) for key in others[:12]))
    mode = entries["mode"].text(valid=_MODES) if "mode" in entries else "trinary"
    negate = "negate" in entries and _flag(entries["negate"])
    resolution = entries["resolution"].number(low=1e-4, high=100.0)
    pose = _origin(entries["origin"])
    high, free = (entries[k].number(low=0.0, high=1.0, unit="") for k in ("occupied_thresh", "free_thresh"))
    if free > high:
        entries["free_thresh"].fail(f"is {free:g}; it must not exceed 'occupied_thresh', {high:g}")
    image, opacity = _read_image(entries["image"])
    occupancy = _occupancy(image, opacity, mode, negate, free, high)
    filled = _filled(occupancy, lethal, unknown, root.source.path)
    if np.count_nonzero(filled) > MAX_CENTERS:
        entries["image"].fail(f"{np.count_nonzero(filled)} cells are occupied; at most {MAX_CENTERS} are read")
    pose = entries["origin"].checked(_upright, pose if at is None else at @ pose)
    area = MapArea(pose, resolution * np.array(filled.shape[::-1], dtype=float), low, height)
    rows, columns = np.nonzero(filled[::-1])  # the first row of an image is its upper edge
    centers = np.column_stack(((columns + 0.5) * resolution, (rows + 0.5) * resolution, np.zeros(len(rows))))
    middle = pose[:3, 3].copy()
    middle[2] = 0.5 * (low + height)
    size = (resolution, resolution, height - low)

    def walls() -> list[Obstacle]:
        some = centers if len(rows) else np.zeros((1, 3))  # also where none are occupied the sizes are checked
        made = Voxels(some, size, at=middle, quat=quaternion_of(pose[:3, :3]), name=name)
        return [made] if len(rows) else []

    return root.checked(walls), area


def _origin(node: Node) -> Array:
    """Pose (4, 4) of a map's lower left corner in the map's frame."""
    x, y, yaw = node.vector(3).tolist()
    if abs(yaw) > _WHOLE_TURN:
        _log.warning(
            "%s: the origin's yaw is %g rad, more than a turn: it is in radians; %g degrees would be %.6g",
            node.source.path,
            yaw,
            yaw,
            math.radians(yaw),
        )
        yaw = math.remainder(yaw, _WHOLE_TURN)
    pose = np.eye(4)
    pose[:2, :2], pose[:2, 3] = ((math.cos(yaw), -math.sin(yaw)), (math.sin(yaw), math.cos(yaw))), (x, y)
    return pose


def _filled(occupancy: Array, lethal: float, unknown: str, path: Path) -> Mask:
    """Which cells (rows, columns) are obstacles; the log says how many that are not quite free are none."""
    filled = occupancy >= lethal
    partly, nothing = np.count_nonzero((occupancy > 0.0) & ~filled), np.isnan(occupancy)
    if unknown == "occupied":
        filled |= nothing
    left_out = ((np.count_nonzero(nothing & ~filled), "unknown"), (partly, "between free and occupied"))
    if any(count for count, _ in left_out):
        said = ", ".join(
            f"{plural(int(count), 'cell')} that {'is' if count == 1 else 'are'} {what}"
            for count, what in left_out
            if count
        )
        _log.warning("%s: left out: %s", path, said)
    return filled


def _upright(pose: Array) -> Array:
    """The pose of a map, checked."""
    pose = check_pose(pose)
    if abs(pose[2, 2] - 1.0) > 1e-9:
        raise ScenarioError("a map cannot be tilted: its walls stand upright, and its pose may only have a yaw")
    return pose


def _flag(node: Node) -> bool:
    """0 or 1, or a word for it."""
    return node.boolean() if isinstance(node.value, bool) else node.integer(low=0, high=1) == 1


def _occupancy(image: Array, opacity: Array | None, mode: str, negate: bool, low: float, high: float) -> Array:
    """Occupancy (rows, columns) from 0 to 100, and NaN where it is unknown."""
    if mode == "raw":
        value = np.rint(255.0 * image)
        return np.where(value <= _FULL_OCCUPANCY, value, np.nan)
    p = image if negate else 1.0 - image
    between = (
        np.full(p.shape, np.nan) if mode == "trinary" else np.rint(_FULL_OCCUPANCY * (p - low) / max(high - low, 1e-9))
    )
    value = np.where(p >= high, _FULL_OCCUPANCY, np.where(p <= low, 0.0, between))
    if opacity is None:
        return value
    value = np.where(opacity < 1.0, np.nan, value)
    if mode == "trinary":  # the mean of four colours, as it was
        mean = 0.75 * image + 0.25 * opacity
        value = np.where((mean if negate else 1.0 - mean) > high, _FULL_OCCUPANCY, value)
    return value


def _read_image(node: Node) -> tuple[Array, Array | None]:
    """Brightness and opacity (rows, columns) in [0, 1] of the image that a node names, relative to its own file."""
    file: Path = node.source.path.parent / node.text()
    data = node.checked(read_input, file, "map's image", MAX_BYTES, ScenarioError)
    if data[:2] in (b"P2", b"P5"):
        return _read_pgm(node, file, data), None
    if data[:4] != b"\x89PNG" and data[:2] != b"BM":
        node.fail(f"{file}: is not a PGM (P2 or P5), PNG or BMP image")
    try:
        pillow = importlib.import_module("PIL.Image")
    except ModuleNotFoundError:
        raise missing_extra(f"the map's image {file.name}", "pillow", "ros") from None
    try:
        with pillow.open(io.BytesIO(data), formats=("PNG", "BMP")) as picture:
            if not picture.width * picture.height <= _MAX_CELLS:
                node.fail(f"{file}: {picture.width} × {picture.height} pixels; at most {_MAX_CELLS} are read")
            if picture.mode.startswith("I"):  # 16 bits
                return np.clip(np.asarray(picture, dtype=np.float64) / 65535.0, 0.0, 1.0), None
            clear = "A" in picture.getbands() or "transparency" in picture.info
            pixels = np.asarray(picture.convert("RGBA" if clear else "RGB"), dtype=np.float32) / 255.0
    except ScenarioError:
        raise
    except Exception as error:  # Pillow's readers raise many kinds, all of them about damage
        node.fail(f"{file}: the image is damaged: {' '.join(str(error).split())[:200]}")
    return pixels[:, :, :3].mean(axis=2, dtype=np.float64), pixels[:, :, 3].astype(np.float64) if clear else None


def _read_pgm(node: Node, file: Path, data: bytes) -> Array:
    """Brightness (rows, columns) in [0, 1] of a PGM file (P2 or P5)."""
    numbers, at = [], 2
    while len(numbers) < 3:  # width, height, largest value; comments run from # to the end of the line
        while data[at : at + 1].isspace():
            at += 1
        if data[at : at + 1] == b"#":
            found = _COMMENT.match(data, at)
            at = len(data) if found is None else found.end()
            continue
        end = at
        while data[end : end + 1].isdigit():
            end += 1
        if end == at or end - at > 9:
            node.fail(f"{file}: the image's header is damaged")
        numbers.append(int(data[at:end]))
        at = end
    width, rows, top = numbers
    if not 0 < width * rows <= _MAX_CELLS or not 0 < top < 65536:
        node.fail(f"{file}: {width} × {rows} pixels up to {top} are not read; at most {_MAX_CELLS} pixels up to 65535")
    if data[:2] == b"P2":
        try:
            pixels = _numbers(_COMMENT.sub(b"", data[at:]), 0, width * rows)
        except ValueError:
            node.fail(f"{file}: the image holds something that is not a number")
    else:
        kind = np.dtype(np.uint8 if top < 256 else ">u2")
        body = data[_raster(data, at, width * rows * kind.itemsize) :]
        pixels = np.frombuffer(body, dtype=kind, count=min(len(body) // kind.itemsize, width * rows)).astype(np.float64)
    if len(pixels) < width * rows:
        node.fail(f"{file}: the image has {len(pixels)} pixels; {width} × {rows} = {width * rows} are needed")
    image = pixels[: width * rows].reshape(rows, width) / top
    if not (image.min() >= 0.0 and image.max() <= 1.0):
        node.fail(f"{file}: the image has pixels beyond its largest value, {top}")
    return image


def _raster(data: bytes, at: int, size: int) -> int:
    """Where the ``size`` bytes of a P5 file's pixels begin, whose header's last number ends at ``at``.

    After one blank, says the format. Some write two, as ends of lines are on Windows, or a comment: that is believed
    where all pixels fit behind it, and the header has such lines before, or the pixels end with the file.
    """
    blank, head, left = data[at : at + 2], data[:at], len(data) - at - 2
    if blank == b"\r\n" and left >= size and (b"\r\n" in head or (left == size and b"\r" not in head)):
        return at + 2
    comment = re.compile(rb"[ \t]*#[^\r\n]*(\r\n|\n|\r)").match(data, at)
    if comment is not None and (blank[:1] == b"#" or len(data) - comment.end() == size):
        return comment.end()
    return at + 1


def _numbers(data: bytes, at: int, most: int) -> Array:
    """At most this many numbers between blanks, from a place on; piece by piece: a word takes ten times its bytes."""
    parts, count = [np.empty(0)], 0
    while at < len(data) and count < most:
        end = min(at + 1_000_000, len(data))
        while end < len(data) and not data[end : end + 1].isspace():
            end += 1
        parts.append(np.array(data[at:end].split(), dtype=np.float64))
        count += len(parts[-1])
        at = end
    return np.concatenate(parts)[:most]
