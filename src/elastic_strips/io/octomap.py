"""IO room, OctoMap: octrees of OctoMap (``.bt`` and ``.ot``) as scenes of voxels.

Both formats are a text header, whose last line is ``data``, and the nodes depth first. ``.bt``: of each inner node two
bytes, two bits for each child: 0 unknown, 1 free, 2 occupied, 3 an inner node that follows; so of any kind of tree.
``.ot``: of each node its log-odds as a float (a ColorOcTree's then has three bytes of colour) and one byte, a bit for
each child that follows.
A child's number has one bit for x, y and z each; the tree has 16 levels, and its root's middle is the origin.
"""

from __future__ import annotations

import logging
import math
import os
from pathlib import Path
from typing import NoReturn

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.errors import InputError, SceneError
from elastic_strips.files import read_input
from elastic_strips.scene import Obstacle, Scene, Voxels
from elastic_strips.scene.parts import MAX_CENTERS
from elastic_strips.scene.quantities import check_pose, quaternion_of
from elastic_strips.validation import check_number

_log = logging.getLogger(__name__)
MAX_BYTES = 100_000_000
_MAX_NODES = 20_000_000
_TREE_LEVELS = 16
_LEAST_CELL, _LARGEST_CELL = 1e-4, 100.0  # [m] of a cell
_HEIGHT_SLACK = 1e-9  # [m] by which a cell has to be between two heights
_DEEPEST = 1 << 3 * _TREE_LEVELS  # codes from here on belong to the last level, which has no children
_HEADS = {b"# Octomap OcTree binary file": True, b"# Octomap OcTree file": False}
_COLOURS = {"OcTree": 0, "OcTreeStamped": 0, "ColorOcTree": 3}  # kinds of .ot files, and their bytes of colour
_Codes = npt.NDArray[np.int64]
"""Of nodes: a leading 1, then three bits for each level, from the root on."""
_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


def read_octomap(
    path: str | os.PathLike[str],
    *,
    occupied: float = 0.5,
    low: float | None = None,
    high: float | None = None,
    at: ArrayLike | None = None,
    name: str = "octomap",
) -> Scene:
    """Read the occupied space of an octree: one obstacle of voxels for each size of cells that it has.

    Unknown space counts as free; a warning in the log says how much of the map that is. Colours are left out.

    Args:
        path: the file; its first line says which format it has.
        occupied: probability from which on a cell of an ``.ot`` file is occupied; a ``.bt`` file says only whether.
        low, high: heights in the world [m] below and above which cells are left out: the floor under the robot, the
            ceiling. A cell that is partly between them stays, or its smallest cells that are.
        at: pose (4, 4) of the map's frame in the world.
        name: name of the obstacle; where there are several, the edge of their cells follows.

    Raises:
        SceneError: no such file, another or a damaged format, nothing occupied, more cells than a scene may hold.
        ParameterError: a probability outside (0, 1).
    """
    check_number("occupied", occupied, above=0.0, below=1.0)
    file = Path(path)
    data = read_input(file, "octree", MAX_BYTES, SceneError)
    binary, kind, size, resolution, begin = _header(file, data)
    log_odds = math.log(occupied / (1.0 - occupied))
    full, free, nodes = (
        _read_bt(file, data, begin, size) if binary else _read_ot(file, data, begin, size, _COLOURS[kind], log_odds)
    )
    if nodes != size:
        _fail(file, f"the tree has {nodes} nodes; its header says {size}")
    return Scene(_obstacles(str(file), full, free, resolution, low, high, at, name, not binary and _COLOURS[kind] > 0))


def octree_obstacles(
    data: bytes,
    where: str,
    *,
    binary: bool,
    kind: str,
    resolution: float,
    at: ArrayLike | None = None,
    name: str = "octomap",
) -> list[Obstacle]:
    """The occupied space of an octree in a message (``octomap_msgs/Octomap``), whose data have no header.

    Args:
        data: the nodes.
        where: its name in messages.
        binary: whether the data are as in a ``.bt`` file.
        kind: kind of the tree.
        resolution: edge of the smallest cells [m].
        at: pose (4, 4) of its frame in the world.
        name: as for `read_octomap`.

    Raises:
        SceneError: damaged data, or another kind of tree.
    """
    file = Path(where)
    if data[:10] == b"# Octomap ":  # as messages were before 2013
        binary, kind, _, resolution, begin = _header(file, data)
        data = data[begin:]
    check_number(f"{where}: resolution", resolution, low=_LEAST_CELL, high=_LARGEST_CELL, unit="m", error=SceneError)
    if kind not in _COLOURS and not binary:
        _fail(file, f"trees of the kind {kind[:40]!r} are not read; valid: {', '.join(_COLOURS)}")
    most = min(_MAX_NODES, len(data))  # a node has at least two bytes
    full, free, _ = _read_bt(file, data, 0, most) if binary else _read_ot(file, data, 0, most, _COLOURS[kind], 0.0)
    if not len(full):
        return []
    return _obstacles(where, full, free, resolution, None, None, at, name, False)


def _obstacles(
    where: str,
    full: _Codes,
    free: _Codes,
    resolution: float,
    low: float | None,
    high: float | None,
    at: ArrayLike | None,
    name: str,
    colours: bool,
) -> list[Obstacle]:
    """Obstacles of the occupied leaves; a warning says what is left out."""
    pose = np.eye(4) if at is None else check_pose(at)
    cells, left_out = _cells(full, resolution), 0
    known = cells + _cells(free, resolution)
    if low is not None or high is not None:
        bottom, top = -math.inf if low is None else low, math.inf if high is None else high
        cells, left_out = _between(cells, resolution, pose[2], bottom, top)
    obstacles: list[Obstacle] = []
    quat, place = quaternion_of(pose[:3, :3]), pose[:3, 3]
    for edge, centers in cells:
        called = name if len(cells) == 1 else f"{name}-{edge:g}"
        try:
            obstacles.append(Voxels(centers, edge, at=place, quat=quat, name=called))
        except InputError as error:
            raise SceneError(f"{where}: {error}") from None
    if not obstacles:
        raise SceneError(
            f"{where}: nothing in the map is occupied ({left_out} cells are outside low={low} and high={high})"
        )
    unknown = _unknown(known)
    dropped = [f"{unknown:.3g} m³ of unknown space, which counts as free"] if unknown > 0.0 else []
    dropped += [f"{left_out} occupied cells outside low={low} and high={high}"] if left_out else []
    dropped += [f"{len(full) + len(free)} colours"] if colours else []
    if dropped:
        _log.warning("%s: left out: %s", where, ", ".join(dropped))
    return obstacles


def _between(
    cells: list[tuple[float, Array]], resolution: float, height: Array, low: float, high: float
) -> tuple[list[tuple[float, Array]], int]:
    """The cells of which something is between two heights, and how many are left out.

    Cells that are only partly between are divided, down to the smallest.

    Args:
        cells: edges and middles, the smallest first.
        resolution: edge of the smallest [m].
        height: (4,) row of the pose that gives a point's height in the world.
        low, high: the two heights [m].
    """
    kept: dict[float, list[Array]] = {}
    left_out = 0
    for edge, todo in reversed(cells):
        while True:
            spread = 0.5 * edge * float(np.abs(height[:3]).sum())
            middle = todo @ height[:3] + height[3]
            inside = (middle + spread > low + _HEIGHT_SLACK) & (middle - spread < high - _HEIGHT_SLACK)
            whole = inside & (middle - spread >= low) & (middle + spread <= high)
            left_out += int((~inside).sum())
            if edge < 1.5 * resolution:
                whole = inside
            kept.setdefault(edge, []).append(todo[whole])
            divided = todo[inside & ~whole]
            if not len(divided):
                break
            if 8 * len(divided) > MAX_CENTERS:
                raise SceneError(f"more than {MAX_CENTERS} cells are partly between low={low} and high={high}")
            edge *= 0.5
            todo = (divided[:, None] + 0.5 * edge * _CORNERS).reshape(-1, 3)
    found = [(edge, np.concatenate(parts)) for edge, parts in sorted(kept.items())]
    return [(edge, centers) for edge, centers in found if len(centers)], left_out


def _header(file: Path, data: bytes) -> tuple[bool, str, int, float, int]:
    """Whether it is a ``.bt`` file; kind of tree, number of nodes, least edge of cells [m], place of the data."""
    first = data[:100].split(b"\n", 1)[0].strip()
    if first not in _HEADS:
        begin = " or ".join(repr(head.decode()) for head in _HEADS)
        _fail(file, f"is not an octree of OctoMap: it must begin with {begin}, not {first[:40]!r}")
    entries: dict[str, str] = {}
    at = 0
    while at < len(data) and len(entries) < 100:
        end = data.find(b"\n", at, at + 1000)
        if end < 0:
            break
        words = data[at:end].decode("ascii", "replace").split()
        at = end + 1
        if words == ["data"]:
            kind, size, res = (entries.get(key, "") for key in ("id", "size", "res"))
            kind = "OcTree" if _HEADS[first] or kind == "1" else kind  # 1: as OctoMap once called it
            if kind not in _COLOURS:
                _fail(file, f"trees of the kind {kind[:40]!r} are not read; valid: {', '.join(_COLOURS)}")
            if not (size.isascii() and size.isdecimal()) or not int(size[:12]) <= _MAX_NODES or len(size) > 12:
                _fail(file, f"the header's size is {size[:40]!r}; a whole number up to {_MAX_NODES} is needed")
            try:
                resolution = float(res)
            except ValueError:
                resolution = math.nan
            if not _LEAST_CELL <= resolution <= _LARGEST_CELL:
                _fail(
                    file,
                    f"the header's res is {res[:40]!r}; an edge of {_LEAST_CELL:g} … {_LARGEST_CELL:g} m is needed",
                )
            return _HEADS[first], kind, int(size), resolution, at
        if words and not words[0].startswith("#"):
            entries[words[0]] = " ".join(words[1:])
    _fail(file, "the header has no line 'data'")


def _read_bt(file: Path, data: bytes, at: int, size: int) -> tuple[_Codes, _Codes, int]:
    """Codes of the occupied and the free leaves, and the number of nodes."""
    if size == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64), 0
    records = np.frombuffer(data, "<u2", count=min((len(data) - at) // 2, size), offset=at)
    pairs = np.stack([(records >> 2 * child) & 3 for child in range(8)], axis=1).astype(np.uint8)
    inner = np.packbits(pairs == 3, axis=1, bitorder="little")[:, 0]
    codes = _depth_first(file, inner.tolist())
    pairs = pairs[: len(codes)]
    children = (codes[:, None] << 3) | np.arange(8)
    return children[pairs == 2], children[pairs == 1], 1 + int((pairs > 0).sum())


def _read_ot(file: Path, data: bytes, at: int, size: int, colours: int, threshold: float) -> tuple[_Codes, _Codes, int]:
    """As `_read_bt`."""
    if size == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64), 0
    kind = np.dtype([("value", "<f4"), ("colour", "u1", (colours,)), ("children", "u1")])
    records = np.frombuffer(data, kind, count=min((len(data) - at) // kind.itemsize, size), offset=at)
    codes = _depth_first(file, records["children"].tolist())
    records = records[: len(codes)]
    if not np.isfinite(records["value"]).all():
        _fail(file, "a node's log-odds are not finite")
    leaves, full = records["children"] == 0, records["value"] >= threshold
    return codes[leaves & full], codes[leaves & ~full], len(codes)


_CHILDREN = [[child for child in range(7, -1, -1) if mask >> child & 1] for mask in range(256)]


def _depth_first(file: Path, masks: list[int]) -> _Codes:
    """Codes of nodes that follow each other depth first, each with the mask of the children that follow it."""
    codes: list[int] = []
    todo = [1]
    for mask in masks:
        if not todo:
            break
        code = todo.pop()
        codes.append(code)
        if mask:
            if code >= _DEEPEST:
                _fail(file, f"node {len(codes)} is deeper than {_TREE_LEVELS} levels")
            code <<= 3
            todo += [code | child for child in _CHILDREN[mask]]
    if todo:
        _fail(file, f"the file ends after {len(codes)} nodes with others missing")
    return np.array(codes, np.int64)


def _cells(codes: _Codes, resolution: float) -> list[tuple[float, Array]]:
    """Edge [m] and middles (n, 3) of leaves, by levels, the finest first."""
    level = (np.frexp(codes.astype(np.float64))[1] - 1) // 3  # exact: codes have fewer bits than a float
    found: list[tuple[float, Array]] = []
    for depth in np.unique(level)[::-1].tolist():
        of_level = codes[level == depth]
        key = np.zeros((len(of_level), 3), np.int64)
        for bit in range(depth):
            key |= ((of_level[:, None] >> (3 * bit + np.arange(3))) & 1) << bit
        edge = resolution * 2.0 ** (_TREE_LEVELS - depth)
        found.append((edge, (key + 0.5 - 0.5 * 2.0**depth) * edge))
    return found


def _unknown(known: list[tuple[float, Array]]) -> float:
    """Volume [m³] inside of the box around all that is known, of which nothing is known."""
    low = np.min([centers.min(axis=0) - 0.5 * edge for edge, centers in known], axis=0)
    high = np.max([centers.max(axis=0) + 0.5 * edge for edge, centers in known], axis=0)
    volume = float(np.prod(high - low))
    unknown = volume - sum(len(centers) * edge**3 for edge, centers in known)
    return unknown if unknown > 1e-9 * volume else 0.0


def _fail(file: Path, message: str) -> NoReturn:
    raise SceneError(f"{file}: {message}")
