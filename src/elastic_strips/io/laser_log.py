"""IO room, laser logs: scans with poses from JSON lines, CSV or CARMEN logs; the content decides the format."""

from __future__ import annotations

import itertools
import json
import logging
import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from elastic_strips.arrays import Array, ArrayLike, Document
from elastic_strips.errors import InputError
from elastic_strips.files import open_input
from elastic_strips.perception import NO_ANSWER, NOTHING, LaserScan
from elastic_strips.validation import check_array, check_choice, check_number

from .nodes import Node, Source

_log = logging.getLogger(__name__)
MAX_BYTES = 200_000_000
_MAX_LINE = 2_000_000  # bytes
_MAX_SCANS = 200_000
_MAX_READINGS = 30_000_000
_WHOLE_TURN = 2.0 * math.pi + 1e-3  # of a whole turn as it is printed: Gazebo's lasers go from 0 to 6.28319
LoggedScan = tuple[LaserScan, Array | None]
"""A scan and the base's pose (3,): x [m], y [m], yaw [rad], read-only; None where the log has none."""

_NEEDED = ("stamp", "angle_min", "angle_increment", "range_min", "range_max", "ranges")
_POSE = ("x", "y", "yaw")
_OPTIONAL = (*_POSE, "pose", "sensor", "mount", "frame_id", "angle_max", "time_increment", "scan_time", "intensities")
_CARMEN_POSES = ("laser", "odometry")
_IGNORED = ("PARAM", "SYNC", "ODOM", "TRUEPOS", "NMEAGGA", "NMEARMC", "RLASER", "LASER3", "LASER4", "MARKER")


class LaserLogError(InputError):
    """A laser log cannot be read; the message names file and line."""


def read_laser_log(
    path: str | os.PathLike[str],
    *,
    carmen_pose: str = "laser",
    carmen_range_max: float = 80.0,
    height: float = 0.0,
    mount: ArrayLike | None = None,
) -> tuple[LoggedScan, ...]:
    """Read the scans of a log, in the file's order; docs/sensed-scenes.md describes the formats.

    Args:
        path: the file: JSON lines, CSV with a header, or a CARMEN log (FLASER, RAWLASER and ROBOTLASER lines;
            its other messages are ignored).
        carmen_pose: which pose of a CARMEN log counts: ``"laser"``, its (usually corrected) pose, which then also is
            the base's, or ``"odometry"``, the base's own; the difference of the two is then the laser's mount.
        carmen_range_max: range from which on nothing was hit [m], for FLASER lines, which do not state it.
        height: height of a laser over the floor [m], where the log does not state it.
        mount: (x, y, z, yaw) of the laser on the base [m, rad], where a log of JSON lines or CSV does not state it;
            without it the laser is taken to be at the base's origin, with a warning in the log.

    Returns:
        Each scan with the base's pose, see `LoggedScan`.

    Raises:
        LaserLogError: no such file, an unknown format, a line that does not fit, a log without scans.
    """
    check_choice("carmen_pose", carmen_pose, _CARMEN_POSES)
    check_number("carmen_range_max", carmen_range_max, above=0.0, unit="m")
    check_number("height", height, unit="m")
    usual = [0.0, 0.0, height, 0.0] if mount is None else check_array("mount", mount, (4,)).tolist()
    file = Path(path)
    unmounted = 0
    scans: list[LoggedScan] = []
    parse: Callable[[str], LoggedScan | None] | None = None
    readings, states = 0, False
    with open_input(file, "laser log", MAX_BYTES, LaserLogError) as (stream, _):
        for number, line in _lines(stream, file):
            if parse is None:
                parse = _reader(file, number, line, carmen_pose, carmen_range_max, height, usual)
                states = line.startswith(("{", "stamp,"))
                if line.startswith("stamp,"):
                    continue
            try:
                scan = parse(line)
            except (ValueError, IndexError, RecursionError, OverflowError) as error:
                raise LaserLogError(f"{file}:{number}: {str(error)[:500]}") from None
            if scan is None:
                continue
            scans.append(scan)
            unmounted += states and '"mount"' not in line
            readings += len(scan[0].ranges)
            if len(scans) > _MAX_SCANS or readings > _MAX_READINGS:
                most = f"{_MAX_SCANS} scans and {_MAX_READINGS} ranges"
                raise LaserLogError(f"{file}:{number}: the log holds more than {most}, which is the most that is read")
    if not scans:
        raise LaserLogError(f"{file}: the log holds no scans{': it is empty' if parse is None else ''}")
    if unmounted and mount is None:
        _log.warning(
            "%s: %d scans do not say where the laser is mounted: it is taken to be at the base's origin, %g m up",
            file,
            unmounted,
            height,
        )
    return tuple(scans)


def _lines(stream: BinaryIO, file: Path) -> Iterator[tuple[int, str]]:
    """Number and text of the lines that hold something, without comments."""
    for number in itertools.count(1):
        data = stream.readline(_MAX_LINE + 1)
        if not data:
            return
        if len(data) > _MAX_LINE:
            raise LaserLogError(f"{file}:{number}: the line has more than {_MAX_LINE} bytes, the most that is read")
        try:
            line = data.decode("utf-8-sig" if number == 1 else "utf-8").strip()
        except UnicodeDecodeError as error:
            raise LaserLogError(
                f"{file}:{number}: byte {error.start} of the line is not UTF-8; a log is a text file"
            ) from None
        if line and not line.startswith("#"):
            yield number, line


def _reader(
    file: Path, number: int, first: str, carmen_pose: str, carmen_range_max: float, height: float, usual: list[float]
) -> Callable[[str], LoggedScan | None]:
    """The reader of a log's lines, chosen by the first line."""
    if first.startswith("{"):
        return lambda line: _json(line, usual)
    if first.startswith("stamp,"):
        columns = [c.strip() for c in first.split(",")]
        valid = set(_NEEDED) <= set(columns) <= {*_NEEDED, *_POSE}
        if not valid or columns[-1] != "ranges" or len(set(columns)) != len(columns):
            needed = ", ".join(_NEEDED[:-1])
            raise LaserLogError(
                f"{file}:{number}: the header must hold {needed}, may hold x, y, yaw, and ends with ranges"
            )
        return lambda line: _csv(line, columns, usual)
    if first.split()[0].isupper():
        return lambda line: _carmen(line, carmen_pose, carmen_range_max, height)
    raise LaserLogError(
        f"{file}:{number}: neither a JSON object, nor the header of a CSV log ('stamp,…'), nor a message of a "
        f"CARMEN log: {first[:40]!r}"
    )


def _json(line: str, usual: list[float]) -> LoggedScan:
    try:
        entry = json.loads(line)
    except json.JSONDecodeError as error:
        raise ValueError(f"no JSON object: {error.msg} at column {error.colno}") from None
    return _logged(entry, usual)


def _csv(line: str, columns: list[str], usual: list[float]) -> LoggedScan:
    cells = [c.strip() for c in line.split(",")]
    if len(cells) < len(columns):
        raise ValueError(f"has {len(cells)} columns; {len(columns) - 1} and the ranges are needed")
    entry: Document = {key: _float(cell, key) for key, cell in zip(columns[:-1], cells, strict=False)}
    entry["ranges"] = [_float(c, "ranges", finite=False) if c else None for c in cells[len(columns) - 1 :]]
    return _logged(entry, usual)


def _logged(entry: object, usual: list[float]) -> LoggedScan:
    """The scan and pose of a line that is a JSON object, or a row of a table."""
    entries = Node(entry, "", Source(Path("scan"))).mapping((*_NEEDED, *_OPTIONAL), needed=_NEEDED)
    numbers = {key: entries[key].finite() for key in _NEEDED[:-1]}
    ranges = [math.nan if r.value is None else _float(r.value, r.key, finite=False) for r in entries["ranges"].items()]
    parts = [entries[key].number(low=-math.inf, high=math.inf) for key in _POSE if key in entries]
    if parts and (len(parts) < 3 or "pose" in entries):
        raise ValueError("a pose is given by 'pose', or by all of 'x', 'y' and 'yaw'")
    pose = entries["pose"].vector(3, limit=math.inf).tolist() if "pose" in entries else parts or None
    mount = entries["mount"].vector(4, limit=math.inf).tolist() if "mount" in entries else usual
    name = entries.get("sensor", entries.get("frame_id"))
    return _scan("laser" if name is None else name.text(), numbers, ranges, mount), _pose(pose)


@dataclass(frozen=True, slots=True)
class _CarmenScan:
    """What a message of a CARMEN log holds: poses (6) of laser and base, or None, and the range [m] of nothing."""

    head: dict[str, float]
    ranges: list[float]
    poses: list[float] | None
    range_max: float


def _carmen(line: str, which: str, range_max: float, height: float) -> LoggedScan | None:
    kind, *rest = line.split()
    if kind == "FLASER":
        found = _flaser(rest, range_max)
    elif kind[:-1] in ("RAWLASER", "ROBOTLASER") and kind[-1] in "12345":
        found = _newer_laser(kind, rest)
    elif kind in _IGNORED or (kind.isupper() and not kind.startswith(("FLASER", "RAWLASER", "ROBOTLASER"))):
        return None
    else:
        raise ValueError(f"{kind[:40]!r} is not a message of a CARMEN log")
    mount, pose = [0.0, 0.0, height, 0.0], None
    if found.poses is not None:
        (lx, ly, la), pose = found.poses[:3], found.poses[:3] if which == "laser" else found.poses[3:]
        if which == "odometry":
            x, y, a = pose
            c, s = math.cos(a), math.sin(a)
            mount = [c * (lx - x) + s * (ly - y), c * (ly - y) - s * (lx - x), height, la - a]
    head = {**found.head, "range_min": 0.0, "range_max": found.range_max}
    return _scan(kind.lower(), head, found.ranges, mount), _pose(pose)


def _flaser(rest: list[str], range_max: float) -> _CarmenScan:
    """The words after ``FLASER``: count, readings, poses of laser and base, times."""
    count = _count(rest[0] if rest else "", "the number of readings")
    if len(rest) < 1 + count + 9:
        raise ValueError(f"FLASER with {count} readings has {len(rest)} fields; {1 + count + 9} are needed")
    step = math.pi / (count - 1 if count % 2 else count)
    ranges = [_float(w, "range") for w in rest[1 : 1 + count]]
    poses = [_float(w, "pose") for w in rest[1 + count : 7 + count]]
    head = {"stamp": _float(rest[7 + count], "ipc_timestamp"), "angle_min": -0.5 * math.pi, "angle_increment": step}
    return _CarmenScan(head, ranges, poses, range_max)


def _newer_laser(kind: str, rest: list[str]) -> _CarmenScan:
    """The words after ``RAWLASER…`` or ``ROBOTLASER…``: the laser's own numbers, readings, remissions, poses, times."""
    if len(rest) < 8:
        raise ValueError(f"{kind} has {len(rest)} fields; at least 8 and the readings are needed")
    start, _, step, range_max = (_float(w, "field") for w in rest[1:5])
    count = _count(rest[7], "the number of readings")
    ranges = [_float(w, "range") for w in rest[8 : 8 + count]]
    after = rest[8 + count :]
    poses = None
    if kind[:-1] == "ROBOTLASER":
        if len(after) not in (13, 14) or (len(after) == 14 and after[0] == "0"):  # newer logs hold remissions
            after = after[1 + _count(after[0] if after else "", "the number of remissions", low=0) :]
        poses = [_float(w, "pose") for w in after[:6]]
    if len(ranges) < count or len(after) < 3 or (poses is not None and len(after) < 13):
        raise ValueError(f"{kind} with {count} readings ends too early, with {len(rest)} fields")
    head = {"stamp": _float(after[-3], "timestamp"), "angle_min": start, "angle_increment": step}
    return _CarmenScan(head, ranges, poses, range_max)


def _scan(sensor: str, head: dict[str, float], ranges: list[float], mount: list[float]) -> LaserScan:
    """The scan of a line."""
    x, y, z, yaw = mount
    c, s = math.cos(yaw), math.sin(yaw)
    T = np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, z], [0.0, 0.0, 0.0, 1.0]])
    return scan_of(sensor, head, ranges, T)


def scan_of(sensor: str, head: dict[str, float], ranges: ArrayLike, T_base_sensor: Array) -> LaserScan:
    """A scan of the values of ROS' message; ranges as in REP 117: beyond ``range_max`` nothing, too near no answer.

    Raises:
        ValueError: the numbers do not make a scan.
    """
    r = np.array(ranges, dtype=float)
    if len(r) < 2:
        raise ValueError(f"a scan has {len(r)} ranges; at least 2 are needed")
    low, high, step = head["range_min"], head["range_max"], head["angle_increment"]
    if not 0.0 <= low < high:
        raise ValueError(f"range_min={low:g} must be at least 0 and less than range_max={high:g}")
    if not 0.0 < abs(step) * (len(r) - 1) <= _WHOLE_TURN:
        raise ValueError(f"angle_increment={step:g}: {len(r)} rays of that step make no scan of at most one turn")
    if not math.isfinite(head["angle_min"]):
        raise ValueError(f"angle_min={head['angle_min']:g} must be finite")
    angles = np.linspace(head["angle_min"], head["angle_min"] + step * (len(r) - 1), len(r))
    with np.errstate(invalid="ignore"):
        r = np.where(r >= high, NOTHING, np.where((r < low) | (r <= 0.0), NO_ANSWER, r))
    if step < 0.0:  # clockwise
        r, angles = r[::-1], angles[::-1]
    return LaserScan(sensor, head["stamp"], T_base_sensor, angles, r, low, high)


def _pose(values: list[float] | None) -> Array | None:
    return None if values is None else check_array("pose", values, (3,))


def _count(word: str, what: str, low: int = 1) -> int:
    if not word.isdecimal() or not low <= int(word) <= 100_000:
        raise ValueError(f"{what} must be a whole number from {low} to 100000, not {word[:40]!r}")
    return int(word)


def _float(value: object, what: str, *, finite: bool = True) -> float:
    try:
        number = float(value) if isinstance(value, (str, int, float)) and not isinstance(value, bool) else None
    except ValueError:
        number = None
    if number is None:
        raise ValueError(f"{what}: must be a number, not {str(value)[:40]!r}")
    if finite and not math.isfinite(number):
        raise ValueError(f"{what}: must be finite, not {number:g}")
    return number
