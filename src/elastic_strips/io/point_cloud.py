"""IO room, point clouds: PLY, PCD, XYZ, NPY and CSV files as arrays of points, and scenes of them."""

from __future__ import annotations

import logging
import math
import os
import re
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.errors import SceneError, nearest_name
from elastic_strips.files import open_input, read_input
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene, Voxels
from elastic_strips.scene.parts import MAX_CENTERS
from elastic_strips.scene.quantities import check_points
from elastic_strips.summary import Summary
from elastic_strips.validation import MIN_LENGTH, check_number

from .npy_source import NpyError, read_npy

_log = logging.getLogger(__name__)
MAX_BYTES = 200_000_000
MAX_POINTS = 5_000_000
_MAX_LISTED_BYTES = 100_000_000  # of a file that lists points: .npy, .csv, .txt, .xyz
SUFFIXES = (".pcd", ".ply", ".txt", ".xyz")
LARGE_CLOUD = 100.0
"""Extent [m] above which a cloud is suspected to be in millimetres."""
LARGE_MESH = 10.0
"""The same for a mesh, which is one thing."""
_LEAST_MARGIN = 1e-6  # [m]
_MOST_OF_A_FIELD = 10_000  # numbers that one field of a PCD file may have
_FACES = re.compile(rb"^element\s+face\s+(\d{1,9})\s*$", re.MULTILINE)
_PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_PLY_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_ORIGIN = ["", "", "", "1", "", "", ""]  # a pose without its zeros
_NOT_FINITE = re.compile(rb"[-+]?(1\.#(IND|QNAN|SNAN|INF)\d*|nan\((ind|snan)\))", re.IGNORECASE)  # as Windows prints it
_PCD_TYPES = {(k, s): f"{t}{s}" for k, t in (("I", "i"), ("U", "u")) for s in (1, 2, 4, 8)} | {
    ("F", 4): "f4",
    ("F", 8): "f8",
}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PointCloud(Summary):
    """Points of a file.

    Attributes:
        points: (n, 3) in the file's frame, in metres, read-only; at least one.
        dropped: how many points of the file were left out: a coordinate was not finite.
    """

    points: Array
    dropped: int


def read_point_cloud(path: str | os.PathLike[str], *, scale: float = 1.0) -> PointCloud:
    """Read the points of a PLY (ASCII or binary), PCD (ASCII, binary or compressed) or XYZ file (.xyz, .txt).

    Of every point x, y and z are read, and the rest (colours, normals) is ignored; so is a PCD file's VIEWPOINT, with a
    warning in the log where it moves anything. XYZ files hold at least three numbers a line, between blanks, commas or
    semicolons; lines that begin with ``#`` or ``//`` are comments.

    Args:
        path: the file.
        scale: factor that makes its numbers metres.

    Raises:
        SceneError: no such file, another kind, damaged or cut off, no points; the message names file and line or byte.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        raise SceneError(f"{file}: point clouds of kind {suffix!r} are not read{nearest_name(suffix, SUFFIXES)}")
    check_number("scale", scale, above=0.0, error=SceneError)
    data = read_input(file, "point cloud", MAX_BYTES, SceneError)
    if not data:
        raise SceneError(f"{file}: the point cloud is empty")
    reader = {".ply": _ply, ".pcd": _pcd}.get(suffix, _xyz)
    try:
        with np.errstate(invalid="ignore"):  # there are bytes that signal as they are cast
            raw = reader(data)
    except ValueError as error:
        raise SceneError(f"{file}{str(error)[:500]}") from None
    if suffix == ".ply" and (faces := _FACES.search(data[:10_000])) and int(faces[1]):
        _log.warning("%s: left out: %d faces; only the vertices are points. A mesh is read as one", file, int(faces[1]))
    if suffix == ".pcd" and (viewpoint := _viewpoint(data)):
        _log.warning("%s: left out: VIEWPOINT %s; the points are taken as they stand", file, viewpoint)
    points = np.ascontiguousarray(raw, dtype=np.float64) * scale
    finite = np.isfinite(points).all(axis=1)
    points = points[finite]
    if not len(points):
        raise SceneError(f"{file}: the file holds no points ({len(raw)} are given, none of them finite)")
    points.flags.writeable = False
    warn_of_units(str(file), points, LARGE_CLOUD)
    return PointCloud(points, int(len(raw) - len(points)))


def read_points(path: str | os.PathLike[str], *, scale: float = 1.0) -> Array:
    """Points (n, 3) that a scene file refers to: all of a .npy, .csv, .txt or .xyz file, those of a .ply or .pcd file.

    Each line of text holds three numbers, between commas in a .csv file and else between blanks; what follows ``#`` is
    a comment. Points of a .ply or .pcd file that are not finite are left out, and counted in a warning; another file
    must have none.

    Args:
        path: the file.
        scale: factor that makes its numbers metres.

    Raises:
        SceneError: no such file, another kind, damaged, or its content does not fit.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    suffixes = (".npy", ".csv", ".txt", ".xyz", ".ply", ".pcd")
    if suffix not in suffixes:
        raise SceneError(f"{file}: files of kind {file.suffix!r} are not read{nearest_name(file.suffix, suffixes)}")
    if suffix in (".ply", ".pcd"):
        cloud = read_point_cloud(file, scale=scale)
        warn_of_dropped(str(file), cloud)
        return cloud.points
    if suffix == ".npy":
        with open_input(file, "file of points", _MAX_LISTED_BYTES, SceneError) as (stream, size):
            try:
                points = read_npy(stream, size, _MAX_LISTED_BYTES)
            except NpyError as problem:
                raise SceneError(f"{file}: the array {problem}") from None
        if points.shape[:1] > (MAX_CENTERS,):
            raise SceneError(f"{file}: the file has {len(points)} points; at most {MAX_CENTERS} are read")
    else:
        data = read_input(file, "file of points", _MAX_LISTED_BYTES, SceneError)
        comma = "," if suffix == ".csv" else None
        try:
            points = _listed(data, lambda text: text.partition("#")[0].split(comma, 3), "hold", MAX_CENTERS)
        except ValueError as error:
            raise SceneError(f"{file}{str(error)[:500]}") from None
        if not len(points):
            raise SceneError(f"{file}: the file holds no points")
    points = check_points(str(file), points, (None, 3))
    if scale != 1.0:
        points = check_points(str(file), points * scale, (None, 3))
    warn_of_units(str(file), points, LARGE_CLOUD)
    return points


def warn_of_dropped(what: str, cloud: PointCloud) -> None:
    """Say in the log how many points of a cloud were left out."""
    if cloud.dropped:
        _log.warning("%s: left out: %d points of %d", what, cloud.dropped, cloud.dropped + len(cloud.points))


def warn_of_units(what: str, points: Array, most: float) -> None:
    """Say in the log that points (n, 3) [m] reach further than ``most`` [m]: they may well be millimetres."""
    extent = float(np.ptp(points, axis=0).max())
    if extent > most:
        _log.warning(
            "%s: is %.4g m large: lengths are in metres; are these millimetres? scale: 0.001 makes %.4g m of it",
            what,
            extent,
            0.001 * extent,
        )


def without_robot(points: ArrayLike | PointCloud, robot: RobotModel, q: ArrayLike, margin: float = 0.05) -> PointCloud:
    """A cloud without the points that a sensor saw on the robot itself; the log says how many there were.

    Args:
        points: (n, 3) points in the world [m], or a `PointCloud`.
        robot: the robot.
        q: (nq,) its configuration when they were seen.
        margin: points within this distance [m] of one of its shapes are its own.

    Returns:
        The others; those that are left out are counted in ``dropped``.

    Raises:
        SceneError: points of another shape or not finite, a negative margin.
        ConfigurationError: the configuration is not valid.
    """
    cloud = np.asarray(points.points if isinstance(points, PointCloud) else points)
    cloud = check_points("points", cloud, (None, 3)) if len(cloud) else np.empty((0, 3))
    check_number("margin", margin, low=0.0, unit="m", error=SceneError)
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.check_q(q))
    own = np.zeros(len(cloud), dtype=bool)
    ball = coal.Sphere(max(margin, _LEAST_MARGIN))
    here, request = coal.Transform3s(), coal.CollisionRequest()
    for piece in robot.geometries:
        T = data.oMi[piece.joint].homogeneous @ piece.placement
        box, center = piece.geometry.aabb_local, T[:3, 3]
        low, high = np.ravel(box.min_) - margin, np.ravel(box.max_) + margin
        rest = np.flatnonzero(~own)
        local = (cloud[rest] - center) @ T[:3, :3]
        near = ((local >= low) & (local <= high)).all(axis=1)
        for k, point in zip(rest[near].tolist(), local[near], strict=True):
            result = coal.CollisionResult()
            place = coal.Transform3s(np.eye(3), point)
            own[k] = coal.collide(piece.geometry, here, ball, place, request, result) > 0
    kept = np.ascontiguousarray(cloud[~own])
    kept.flags.writeable = False
    count = int(own.sum())
    if count:
        _log.warning("left out: %d of %d points, which are the robot's own (within %g m)", count, len(cloud), margin)
    return PointCloud(kept, count + (points.dropped if isinstance(points, PointCloud) else 0))


def cloud_scene(
    points: ArrayLike | PointCloud,
    voxel: float = 0.05,
    *,
    low: float | None = None,
    high: float | None = None,
    min_points: int = 1,
    name: str = "cloud",
    time: float = 0.0,
) -> Scene:
    """A scene with one obstacle: a voxel for every cell of a grid that holds points, merged where possible.

    Args:
        points: (n, 3) points in the world [m], or a `PointCloud`.
        voxel: edge of the cells [m]; the grid has its origin at the world's.
        low, high: heights [m] below and above which points are left out: the floor under the robot, the ceiling; None:
            all count.
        min_points: cells with fewer points are left out, as noise.
        name: name of the obstacle.
        time: time of the scene [s].

    Raises:
        SceneError: points of another shape or not finite, an edge that is not a length, or nothing left of the cloud.
    """
    cloud = np.asarray(points.points if isinstance(points, PointCloud) else points)
    check_points("points", cloud, (None, 3))
    check_number("voxel", voxel, low=MIN_LENGTH, unit="m", error=SceneError)
    keep = np.ones(len(cloud), dtype=bool)
    if low is not None:
        keep &= cloud[:, 2] >= low
    if high is not None:
        keep &= cloud[:, 2] <= high
    cells, counts = np.unique(np.floor(cloud[keep] / voxel).astype(np.int64), axis=0, return_counts=True)
    cells = cells[counts >= min_points]
    if not len(cells):
        raise SceneError(f"nothing is left of {len(cloud)} points: low={low}, high={high}, min_points={min_points}")
    return Scene([Voxels((cells + 0.5) * voxel, voxel, name=name)], time=time)


@dataclass(slots=True)
class _Element:
    """An element of a PLY file: so many rows of fields (name, type); ``lists`` where a field is a list."""

    name: str
    count: int
    fields: list[tuple[str, str]] = field(default_factory=list)
    lists: bool = False

    @property
    def size(self) -> int:
        """Bytes of all its rows, in a binary file."""
        return self.count * np.dtype([(f"{i}", code) for i, (_, code) in enumerate(self.fields)]).itemsize


def _ply(data: bytes) -> Array:
    words, body, lines = _header(data, b"end_header", "PLY")
    if words[0] != ["ply"]:
        raise ValueError(":1: is not a PLY file: it must begin with 'ply'")
    order, elements = _ply_elements(words)
    before = 0  # bytes, or lines of a text, in front of the vertices
    for element in elements:
        if element.name == "vertex":
            if element.lists:
                raise ValueError(": the PLY file's vertices hold lists; they must hold single numbers")
            line = lines if order else lines + before
            return _table(data, body, element.fields, element.count, order, line, before)
        if element.lists and order:
            raise ValueError(
                f": the PLY file's element {element.name!r} before the vertices holds lists; put vertices first"
            )
        before += element.size if order else element.count
    raise ValueError(": the PLY file has no element 'vertex'")


def _ply_elements(words: list[list[str]]) -> tuple[str, list[_Element]]:
    """Byte order of a PLY file, empty for text, and its elements, by the words of its header's lines."""
    order: str | None = None
    elements: list[_Element] = []
    for k, line in enumerate(words[1:], start=2):
        if line[0] == "format" and len(line) >= 2 and line[1] in _PLY_FORMATS:
            order = _PLY_FORMATS[line[1]]
        elif line[0] == "element" and len(line) == 3 and line[2].isdecimal():
            elements.append(_Element(line[1], int(line[2])))
        elif line[0] == "property" and elements and len(line) == 5 and line[1] == "list":
            elements[-1].lists = True
        elif line[0] == "property" and elements and len(line) == 3 and line[1] in _PLY_TYPES:
            elements[-1].fields.append((line[2], _PLY_TYPES[line[1]]))
        elif line[0] not in ("comment", "obj_info", "end_header"):
            raise ValueError(f":{k}: not understood in a PLY header: {' '.join(line)[:60]!r}")
    if order is None:
        raise ValueError(f": the PLY header names no format; valid: {', '.join(_PLY_FORMATS)}")
    return order, elements


_PcdHead = dict[str, tuple[int, list[str]]]
"""Key of a PCD header → its line, and what stands behind it."""


def _pcd(data: bytes) -> Array:
    words, body, lines = _header(data, b"DATA", "PCD")
    head: _PcdHead = {w[0]: (k, w[1:]) for k, w in enumerate(words, 1) if w[0][0] != "#"}
    if "FIELDS" not in head and "COLUMNS" in head:  # before 0.6
        head["FIELDS"] = head["COLUMNS"]
    for key in ("FIELDS", "DATA"):
        if key not in head:
            raise ValueError(f": the PCD header has no line {key!r}")
    count, fields = _pcd_count(head), _pcd_fields(head)
    line, kind = head["DATA"]
    if kind == ["binary_compressed"]:
        return _columns(data, body, fields, count)
    if kind not in (["ascii"], ["binary"]):
        valid = "ascii, binary, binary_compressed"
        raise ValueError(f":{line}: PCD files with DATA {' '.join(kind)[:40]!r} are not read; valid: {valid}")
    return _table(data, body, fields, count, "" if kind == ["ascii"] else "<", lines, 0)


def _pcd_count(head: _PcdHead) -> int:
    """How many points a PCD file has, by its header: POINTS, or WIDTH times HEIGHT."""
    number = head.get("POINTS", (0, []))[1]
    if not number and "WIDTH" in head and "HEIGHT" in head:
        number = [str(int(_whole(head["WIDTH"])) * int(_whole(head["HEIGHT"])))]
    if len(number) != 1 or not number[0].isdecimal():
        raise ValueError(": the PCD header does not say how many POINTS there are")
    return int(number[0])


def _pcd_fields(head: _PcdHead) -> list[tuple[str, str]]:
    """Names and types of the numbers that each point of a PCD file has; before 0.6 there is no SIZE and no TYPE."""
    fields_line, names = head["FIELDS"]
    (size_line, sizes), (type_line, types), (_, counts) = (
        head.get(key, (fields_line, [usual] * len(names)))
        for key, usual in (("SIZE", "4"), ("TYPE", "F"), ("COUNT", "1"))
    )
    if not len(names) == len(counts) == len(sizes) == len(types):
        raise ValueError(f":{size_line}: FIELDS, SIZE, TYPE and COUNT of a PCD file must have equally many entries")
    fields: list[tuple[str, str]] = []
    for name, size, letter, count in zip(names, sizes, types, counts, strict=True):
        code = _PCD_TYPES.get((letter, int(size) if size.isdecimal() else 0))
        if code is None or not count.isdecimal() or not 1 <= int(count) <= _MOST_OF_A_FIELD:
            raise ValueError(f":{type_line}: field {name!r} of type {letter!r}, size {size!r} is not understood")
        fields += [(name if i == 0 else f"{name}[{i}]", code) for i in range(int(count))]
    return fields


def _viewpoint(data: bytes) -> str:
    """Position and quaternion (w first) of a sensor that is not at the origin; else nothing."""
    words, _, _ = _header(data, b"DATA", "PCD")
    given = next((w[1:] for w in words if w[0] == "VIEWPOINT"), [])
    return "" if [word.strip("+-0.") for word in given] in ([], _ORIGIN) else " ".join(given)[:100]


def _columns(data: bytes, body: int, fields: list[tuple[str, str]], count: int) -> Array:
    """x, y, z (count, 3) of a compressed PCD file: two sizes, then the packed fields, one after the other."""
    places = _places(fields, count)
    sizes = [np.dtype(code).itemsize for _, code in fields]
    needed = count * sum(sizes)
    packed, unpacked = (int.from_bytes(data[body + at : body + at + 4], "little") for at in (0, 4))
    if unpacked != needed:
        raise ValueError(f": byte {body}: {unpacked} bytes are packed; {count} points have {needed}")
    if len(data) < body + 8 + packed:
        raise ValueError(f": byte {len(data)}: the file ends; {packed} packed bytes begin at byte {body + 8}")
    if needed > MAX_BYTES:
        raise ValueError(f": the points have {needed} bytes unpacked; at most {MAX_BYTES} are read")
    table = _lzf(data[body + 8 : body + 8 + packed], needed)
    columns = [
        np.frombuffer(table, "<" + fields[i][1], count, count * sum(sizes[:i])).astype(np.float64) for i in places
    ]
    return np.column_stack(columns).reshape(-1, 3)


def _lzf(data: bytes, size: int) -> bytearray:
    """What LZF packed: runs of up to 32 bytes as they are, and copies of up to 264 bytes from at most 8192 before."""
    out, at = bytearray(), 0
    try:
        while at < len(data) and len(out) < size:
            token = data[at]
            if token < 32:
                out += data[at + 1 : at + 2 + token]
                at += 2 + token
                continue
            length, at = token >> 5, at + 1
            if length == 7:
                length, at = 7 + data[at], at + 1
            start = len(out) - ((token & 31) << 8) - data[at] - 1
            at, length = at + 1, length + 2
            if start < 0:
                break
            piece = out[start : start + length]
            while len(piece) < length:  # it overlaps what it makes: a pattern that repeats
                piece += piece[: length - len(piece)]
            out += piece
    except IndexError:
        pass
    if len(out) != size or at > len(data):
        raise ValueError(f": the packed points are damaged after {len(out)} of {size} bytes")
    return out


def _xyz(data: bytes) -> Array:
    def words(text: str) -> list[str]:
        comment = text.startswith(("#", "//"))
        return [] if comment else text.replace(",", " ").replace(";", " ").split(None, 3)[:3]

    return _listed(data, words, "begin with", MAX_POINTS)


def _listed(data: bytes, words: Callable[[str], list[str]], verb: str, most: int) -> Array:
    """Points (n, 3) of lines of text, each of which has three ``words`` or holds nothing."""
    values = array("d")
    for k, line in enumerate(_rows(data.removeprefix(b"\xef\xbb\xbf"), 0), start=1):
        text = line.decode("utf-8", "replace").strip()
        split = words(text)
        if not "".join(split).strip():
            continue
        try:
            x, y, z = split
            values.extend((float(x), float(y), float(z)))
        except ValueError:
            raise ValueError(f":{k}: must {verb} three numbers, not {text[:60]!r}") from None
        if len(values) > 3 * most:
            raise ValueError(f":{k}: the file has more than {most} points, which is the most that is read")
    return np.array(values).reshape(-1, 3)


def _rows(data: bytes, at: int) -> Iterator[bytes]:
    """The lines from byte ``at`` on, one after another: together they would take many times the file's size."""
    while at < len(data):
        end = data.find(b"\n", at)
        end = len(data) if end < 0 else end
        yield data[at:end]
        at = end + 1


def _header(data: bytes, last: bytes, kind: str) -> tuple[list[list[str]], int, int]:
    """Words of a header's lines up to the one that begins with ``last``, where its data begin, and its lines."""
    words, at = [], 0
    while len(words) < 1000:
        end = data.find(b"\n", at)
        if end < 0:
            break
        line = data[at:end]
        at = end + 1
        split = line.decode("ascii", "replace").split()
        words.append(split or ["#"])
        if line.strip().startswith(last):
            words = [w if w != ["#"] or kind == "PCD" else ["comment"] for w in words]
            return words, at, len(words)
    raise ValueError(f": is not a {kind} file, or its header is cut off: it has no line {last.decode()!r}")


def _table(
    data: bytes, body: int, fields: list[tuple[str, str]], count: int, order: str, line: int, skip: int
) -> Array:
    """x, y, z (count, 3) of rows of ``fields``, ``skip`` rows or bytes on; text where there is no byte ``order``."""
    places = _places(fields, count)
    if order:
        kind = np.dtype([(f"{i}", order + code) for i, (_, code) in enumerate(fields)])
        start, needed = body + skip, count * kind.itemsize
        if len(data) - start < needed:
            raise ValueError(
                f": byte {len(data)}: the file ends; {count} points need {needed} bytes from byte {start} on"
            )
        table = np.frombuffer(data, dtype=kind, count=count, offset=start)
        return np.column_stack([table[f"{i}"].astype(np.float64) for i in places]).reshape(-1, 3)
    values, done = np.empty((count, 3)), 0
    for number, row in enumerate(islice(_rows(data, body), skip, None), start=line + 1):
        if done == count:
            break
        if not (words := row.split(None, len(fields))):
            continue
        try:
            if len(words) < len(fields):
                raise ValueError
            values[done] = [_float(words[i]) for i in places]
        except ValueError:
            text = row[:60].decode("utf-8", "replace")
            raise ValueError(f":{number}: must hold {len(fields)} numbers, not {text!r}") from None
        done += 1
    if done < count:
        raise ValueError(f":{line + done}: the file ends after {done} of {count} points")
    return values


def _float(word: bytes) -> float:
    try:
        return float(word)
    except ValueError:
        if _NOT_FINITE.fullmatch(word):
            return math.nan
        raise


def _places(fields: list[tuple[str, str]], count: int) -> list[int]:
    """Which fields x, y and z are."""
    if count > MAX_POINTS:
        raise ValueError(f": the file has {count} points; at most {MAX_POINTS} are read")
    names = [name for name, _ in fields]
    for axis in "xyz":
        if axis not in names:
            raise ValueError(f": the points have no {axis!r}; they have {', '.join(names) or 'nothing'}")
        if names.count(axis) > 1:
            raise ValueError(f": the points have {axis!r} twice")
    return [names.index(axis) for axis in "xyz"]


def _whole(entry: tuple[int, list[str]]) -> str:
    number, words = entry
    if len(words) != 1 or not words[0].isdecimal():
        raise ValueError(f":{number}: must be one whole number, not {' '.join(words)[:40]!r}")
    return words[0]
