"""IO room, Nav2 maps: an occupancy map (YAML, and PGM, PNG or BMP) as a scene of voxels."""

from __future__ import annotations

import importlib
import io
import logging
import math
import os
from pathlib import Path

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ScenarioError, missing_extra
from elastic_strips.files import read_input
from elastic_strips.scene import Scene, Voxels
from elastic_strips.scene.parts import MAX_CENTERS
from elastic_strips.validation import check_choice, check_number, shown

from .nodes import Node, load_yaml

_log = logging.getLogger(__name__)
_KEYS = ("image", "mode", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
MAX_BYTES = 100_000_000
_MAX_CELLS = 16_000_000
_MODES = ("trinary", "scale", "raw")
_FULL = 100.0  # occupancy of a cell that is certainly occupied


def load_nav2_map(
    path: str | os.PathLike[str], *, unknown: str = "free", height: float = 1.0, lethal: float = _FULL
) -> Scene:
    """A map in Nav2's format as a scene with one obstacle, ``map``: a box from the floor up for every occupied cell.

    A pixel of brightness b (of 255) has the occupancy p = (255 − b) / 255, or b / 255 where ``negate`` is set. A cell
    is occupied where p ≥ ``occupied_thresh``, else free where p ≤ ``free_thresh``. Between, mode ``trinary`` says that
    it is unknown, and ``scale`` has it from 0 to 100 in proportion. A pixel that is not opaque is unknown. In mode
    ``raw`` it is b itself up to 100, and unknown above. Nav2 before 2025 took opacity for one more colour in mode
    ``trinary``; what it had for occupied then is so, too.

    Neighbouring boxes are merged. A map without an occupied cell gives a scene without obstacles. A warning in the log
    says how many cells are left out that are unknown, or between free and occupied, and which keys are not known.

    Args:
        path: The map's YAML file; it names the image, a PGM, PNG or BMP file. All but PGM need the extra ``ros``.
        unknown: What unknown cells are: ``"free"``, as Nav2's planners take them by default, or ``"occupied"``.
        height: Of the boxes [m].
        lethal: Occupancy in (0, 100] from which on a cell of mode ``scale`` or ``raw`` is occupied; by default what
            Nav2's static layer takes.

    Raises:
        MissingExtraError: The image is no PGM file, and Pillow is not installed.
        ScenarioError: A file is missing, cannot be read, or does not fit; the message names file, line and key.
    """
    check_choice("unknown", unknown, ("free", "occupied"), ScenarioError)
    check_number("lethal", lethal, above=0.0, high=_FULL, error=ScenarioError)
    root = load_yaml(path, error=ScenarioError)
    needed = ("image", "resolution", "origin", "occupied_thresh", "free_thresh")
    entries = root.mapping(needed=needed, what="a map")
    if others := sorted(entries.keys() - set(_KEYS)):  # Nav2 does not look at them
        _log.warning("%s: left out: the keys %s", root.source.path, ", ".join(shown(key) for key in others[:12]))
    mode = entries["mode"].text(valid=_MODES) if "mode" in entries else "trinary"
    negate = "negate" in entries and _flag(entries["negate"])
    resolution = entries["resolution"].number(low=1e-4, high=100.0)
    x, y, yaw = entries["origin"].vector(3).tolist()
    high, low = (entries[k].number(low=0.0, high=1.0, unit="") for k in ("occupied_thresh", "free_thresh"))
    if low > high:
        entries["free_thresh"].fail(f"is {low:g}; it must not exceed 'occupied_thresh', {high:g}")
    image, opacity = _read_image(entries["image"])
    occupancy = _occupancy(image, opacity, mode, negate, low, high)
    filled = occupancy >= lethal
    partly, nothing = np.count_nonzero((occupancy > 0.0) & ~filled), np.isnan(occupancy)
    if unknown == "occupied":
        filled |= nothing
    left_out = ((np.count_nonzero(nothing & ~filled), "unknown"), (partly, "between free and occupied"))
    if any(count for count, _ in left_out):
        said = ", ".join(f"{count} cells that are {what}" for count, what in left_out if count)
        _log.warning("%s: left out: %s", root.source.path, said)
    if np.count_nonzero(filled) > MAX_CENTERS:
        entries["image"].fail(f"{np.count_nonzero(filled)} cells are occupied; at most {MAX_CENTERS} are read")
    rows, columns = np.nonzero(filled[::-1])  # the first row of an image is its upper edge
    if not len(rows):
        return Scene([])
    centers = np.column_stack(((columns + 0.5) * resolution, (rows + 0.5) * resolution, np.zeros(len(rows))))
    quat = (0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))
    size = (resolution, resolution, height)
    return root.checked(lambda: Scene([Voxels(centers, size, at=(x, y, 0.5 * height), quat=quat, name="map")]))


def _flag(node: Node) -> bool:
    """0 or 1, or a word for it."""
    return node.boolean() if isinstance(node.value, bool) else node.integer(low=0, high=1) == 1


def _occupancy(image: Array, opacity: Array | None, mode: str, negate: bool, low: float, high: float) -> Array:
    """Occupancy (rows, columns) from 0 to 100, and NaN where it is unknown."""
    if mode == "raw":
        value = np.rint(255.0 * image)
        return np.where(value <= _FULL, value, np.nan)
    p = image if negate else 1.0 - image
    between = np.full(p.shape, np.nan) if mode == "trinary" else np.rint(_FULL * (p - low) / max(high - low, 1e-9))
    value = np.where(p >= high, _FULL, np.where(p <= low, 0.0, between))
    if opacity is None:
        return value
    value = np.where(opacity < 1.0, np.nan, value)
    if mode == "trinary":  # the mean of four colours, as it was
        mean = 0.75 * image + 0.25 * opacity
        value = np.where((mean if negate else 1.0 - mean) > high, _FULL, value)
    return value


def _read_image(node: Node) -> tuple[Array, Array | None]:
    """Brightness and opacity (rows, columns) in [0, 1] of the image that a node names, relative to its own file."""
    file: Path = node.source.path.parent / node.text()
    data = node.checked(read_input, file, "map's image", MAX_BYTES, ScenarioError)
    if data[:2] in (b"P2", b"P5"):
        return _read_pgm(node, file, data), None
    if data[:4] != b"\x89PNG" and data[:2] != b"BM":
        node.fail(f"{file}: is no PGM (P2 or P5), PNG or BMP image")
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
            end = data.find(b"\n", at)
            at = len(data) if end < 0 else end
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
            pixels = _numbers(data, at, width * rows)
        except ValueError:
            node.fail(f"{file}: the image holds something that is no number")
    else:
        kind = np.dtype(np.uint8 if top < 256 else ">u2")
        body = data[at + 1 :]
        pixels = np.frombuffer(body, dtype=kind, count=min(len(body) // kind.itemsize, width * rows)).astype(np.float64)
    if len(pixels) < width * rows:
        node.fail(f"{file}: the image has {len(pixels)} pixels; {width} × {rows} = {width * rows} are needed")
    image = pixels[: width * rows].reshape(rows, width) / top
    if not (image.min() >= 0.0 and image.max() <= 1.0):
        node.fail(f"{file}: the image has pixels beyond its largest value, {top}")
    return image


def _numbers(data: bytes, at: int, most: int) -> Array:
    """At most so many numbers between blanks, from a place on; piece by piece, for a word takes ten times its bytes."""
    parts, count = [np.empty(0)], 0
    while at < len(data) and count < most:
        end = min(at + 1_000_000, len(data))
        while end < len(data) and not data[end : end + 1].isspace():
            end += 1
        parts.append(np.array(data[at:end].split(), dtype=np.float64))
        count += len(parts[-1])
        at = end
    return np.concatenate(parts)[:most]
