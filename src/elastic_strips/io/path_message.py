"""IO room, path messages: the trajectories of a ROS message, one after the other, as one table of numbers.

JointTrajectory and MultiDOFJointTrajectory, and messages with some: RobotTrajectory, DisplayTrajectory, a plan's
response, a goal, lists of these. A start state (``trajectory_start``, ``start_state``) is the first row where the path
does not begin there, and says where the joints are that no trajectory names.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NoReturn

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError
from elastic_strips.robot.space import LIMIT_TOLERANCE

from .nodes import Node, Source, parse_yaml
from .path_columns import heading_of
from .path_names import MAX_NAME, of_something_else, words_of
from .path_table import RATES, PathTable

_STARTS = ("trajectory_start", "start_state")
_HALVES = ("joint_trajectory", "multi_dof_joint_trajectory")
_BASE_JOINT = re.compile(r"(?:.*[_/])?(?:base|world|virtual|planar|odom|position|mobile|root|map)\w*(?:/\w*)?", re.I)
_WORLDS = ("", "world", "map", "odom", "odom_combined")
"""Frames of a base's poses that count as the world."""
_UNREAD = {
    "poses", "pose", "position", "positions", "transforms", "waypoints", "path", "states", "base", "odom", "odometry",
    "gripper",
}  # fmt: skip
"""Words in keys of what says where something is; what else a message has is of no path."""
_SHAPES = {"primitive", "mesh", "plane", "subframe", "constraint", "constraints"}
_JOIN_TOLERANCE = 1e-3  # [rad or m] by which one trajectory may begin beside where the one before has ended
_MOST_DOCUMENTS = 100


@dataclass(slots=True)
class _Part:
    """One trajectory, or a start state: names, rows (N, C), times (N,) [s] or None, and the node of each row.

    ``heading`` is the name of the column that a quaternion became, if there is one: it knows no whole turns.
    """

    names: list[str]
    rows: Array
    times: Array | None
    nodes: list[Node]
    node: Node
    heading: str | None = None
    start: bool = False
    doubts: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    stamp: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Document(Source):
    """One of several documents of a file; ``before`` lines are in front of it."""

    before: int = 0

    def fail(self, message: str, line: int | None = None) -> NoReturn:
        Source.fail(self, message, None if line is None else line + self.before)


def parse_documents(text: str, source: Source) -> list[Node]:
    """The YAML documents of a file, as ``topic echo`` prints messages."""
    found, line = [], 0
    for part in re.split(r"^---[ \t]*$", text, flags=re.MULTILINE):
        if part.strip():
            if len(found) == _MOST_DOCUMENTS:
                source.fail(f"has more than {_MOST_DOCUMENTS} documents", line + 1)
            found.append(parse_yaml(part, _Document(source.path, source.error, before=line)))
        line += part.count("\n")
    return found or [parse_yaml("", source)]


@dataclass(slots=True)
class _Found:
    """What the documents have: its parts, and the lists beside them that are not read."""

    parts: list[_Part] = field(default_factory=list)
    unread: list[Node] = field(default_factory=list)


def message_table(roots: list[Node], source: Source, ignore: Collection[str] = ()) -> tuple[PathTable, tuple[str, ...]]:
    """All trajectories of some documents in their order; and what of ``ignore`` is no key of theirs.

    Raises:
        ConfigurationError: there is none, one does not begin where the one before has ended, or a pose of the base is
            not on the floor.
    """
    found = _look(roots)
    parts = found.parts
    trajectories = [part for part in parts if not part.start]
    if not trajectories:
        source.fail("has no JointTrajectory: a mapping with joint_names and points is needed")
    names = _all_names(parts)
    doubts = [doubt for part in parts for doubt in part.doubts] + _doubt_of_unread(found, ignore)
    timed = all(part.times is not None for part in trajectories)
    joined = _joined(parts, names, timed)
    several = len(trajectories) > 1
    keys = {_key(node) for node in found.unread}
    notes = [note for part in parts for note in part.notes]
    if several:
        notes.append(f"{len(trajectories)} trajectories, one after the other")
    if ignored := [name for name in ignore if name in keys]:
        notes.append(f"ignored, as requested: {', '.join(ignored)}")
    result = PathTable(
        source,
        names,
        _filled(np.array(joined.rows)),
        lambda k: (joined.nodes[k].key or "the document", joined.nodes[k].line),
        np.array(joined.times) if timed else None,
        from_start=True,
        metres=True,
        stamp=trajectories[0].stamp,
        start=frozenset(names).difference(_all_names(trajectories)),
        notes=tuple(dict.fromkeys(notes)),
        doubts=tuple(dict.fromkeys(doubts + joined.doubts)),
        time_doubts=("the file does not say when the trajectories after the first begin",) if timed and several else (),
    )
    return result, tuple(name for name in ignore if name not in keys)


def _all_names(parts: Sequence[_Part]) -> tuple[str, ...]:
    """The names of several parts, each once."""
    return tuple(dict.fromkeys(name for part in parts for name in part.names))


def _doubt_of_unread(found: _Found, ignore: Collection[str]) -> list[str]:
    """One doubt where lists that are not read, and not in ``ignore``, say where something is; else none."""
    unread = [node for node in found.unread if _key(node) not in ignore]
    if any(part.heading for part in found.parts):  # the same once more, as write_trajectory has it
        unread = [node for node in unread if not _same_drive(node, found.parts)]
    if not unread:
        return []
    shown = ", ".join(node.key for node in unread[:5])
    return [
        f"the file says more about where something is, which is not read: {shown}. "
        f"Make it a trajectory, or say that it does not matter (--ignore {_key(unread[0])}, ignore=)"
    ]


@dataclass(slots=True)
class _Joined:
    """Trajectories one after the other: a row (C,) for each configuration, its node and its time [s]."""

    rows: list[Array] = field(default_factory=list)
    nodes: list[Node] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)

    def clear(self) -> None:
        """Begin anew."""
        for done in (self.rows, self.nodes, self.times):
            done.clear()


def _joined(parts: Sequence[_Part], names: Sequence[str], timed: bool) -> _Joined:
    """The parts in their order; each begins where the one before has ended.

    Raises:
        ConfigurationError: one does not.
    """
    column = {name: k for k, name in enumerate(names)}
    now = np.full(len(names), np.nan)
    done, clock = _Joined(), 0.0
    for part in parts:
        rows = _whole_rows(part, column, now)
        gap = np.nan_to_num(np.abs(rows[0] - now))
        if parts[0].start and len(done.rows) == 1:
            unknown = [name for name in part.names if np.isnan(now[column[name]])]
            _leave_start(done, part, unknown, gap.max(initial=0.0) <= LIMIT_TOLERANCE)
        elif done.rows and gap.max(initial=0.0) > _JOIN_TOLERANCE:
            worst = int(gap.argmax())
            part.node.fail(
                f"begins with {names[worst]} at {rows[0, worst]:.6g}, and the one before ends at "
                f"{now[worst]:.6g}; trajectories of one file follow each other"
            )
        done.rows += list(rows)
        done.nodes += part.nodes
        if timed:
            stamps = np.zeros(1) if part.times is None else part.times
            done.times += (clock + stamps).tolist()
            clock = done.times[-1]
        now = rows[-1].copy()
    return done


def _whole_rows(part: _Part, column: Mapping[str, int], now: Array) -> Array:
    """Rows (N, C) of a part in which what it does not name stays where it is ``now`` (C,), and headings have turns."""
    rows = np.tile(now, (len(part.rows), 1))
    rows[:, [column[name] for name in part.names]] = part.rows
    if part.heading is not None:
        k = column[part.heading]
        before = rows[0, k] if np.isnan(now[k]) else now[k]
        rows[:, k] = np.unwrap(np.concatenate(([before], rows[:, k])))[1:]
    return rows


def _leave_start(done: _Joined, part: _Part, unknown: Sequence[str], there: bool) -> None:
    """Go from the start state to the first trajectory: the start state is no row where the path begins ``there``.

    ``unknown`` are the joints of the trajectory of which the start state says nothing.
    """
    if there and (unknown or part.times is None or part.times[0] == 0.0):
        done.clear()
    elif unknown:
        done.doubts.append(f"the start state is not where the path begins, and has no {', '.join(unknown[:8])}")


def _key(node: Node) -> str:
    """The last name of a node's place."""
    return re.sub(r"(\[\d+\])+$", "", node.key).rsplit(".", 1)[-1]


def _same_drive(node: Node, parts: list[_Part]) -> bool:
    """Whether a list of poses is where the trajectories have the base."""
    driven = np.vstack([part.rows[:, :2] for part in parts if part.heading and not part.start] or [np.empty((0, 2))])
    if _key(node) != "poses" or len(node.items()) != len(driven):
        return False
    for pose, (x, y) in zip(node.items(), driven.tolist(), strict=True):
        inner = pose.mapping().get("pose", pose) if isinstance(pose.value, dict) else pose
        at = inner.value.get("position") if isinstance(inner.value, dict) else None
        if not isinstance(at, dict) or not (at.get("x") == x and at.get("y") == y):
            return False
    return True


def _filled(table: Array) -> Array:
    """A joint is, before the first trajectory that names it, where that begins."""
    for column in table.T:
        known = np.flatnonzero(np.isfinite(column))
        if len(known):
            column[: known[0]] = column[known[0]]
    return table


def _look(roots: Sequence[Node]) -> _Found:
    """Start states and trajectories in the order of the documents; a message's start state before its trajectories."""
    found = _Found()
    todo = list(reversed(roots))
    while todo:
        node = todo.pop()
        if isinstance(node.value, list):
            todo += [entry for entry in reversed(node.items()) if isinstance(entry.value, (list, dict))]
        elif isinstance(node.value, dict):
            entries = node.mapping()
            used = _take_parts(node, entries, found)
            for key, entry in reversed(entries.items()):
                if key in used or not isinstance(entry.value, (list, dict)) or _SHAPES.intersection(words_of(key)):
                    continue
                if _says_where(key) and _is_told(entry.value):
                    found.unread.append(entry)
                else:
                    todo.append(entry)
    return found


def _take_parts(node: Node, entries: Mapping[str, Node], found: _Found) -> Collection[str]:
    """Take a message's own trajectory, or else its start states; and which of its keys that used."""
    halves = [_inner(entries, half) for half in _HALVES]
    if any(halves):
        found.parts += _robot_trajectory(node, *halves)
        return _HALVES
    points = entries["points"].value if "points" in entries else None
    if isinstance(points, list) and "joint_names" in entries:
        poses = any(isinstance(p, dict) and "transforms" in p for p in points)
        found.parts += _robot_trajectory(node, *((None, node) if poses else (node, None)))
        return "points", "joint_names"
    for state in (_inner(entries, key) for key in _STARTS):
        if state is not None:
            found.parts += _robot_state(state)
    return _STARTS


def _inner(entries: Mapping[str, Node], key: str) -> Node | None:
    """The mapping under a key; None where there is none."""
    return entries[key] if key in entries and isinstance(entries[key].value, dict) else None


def _says_where(key: str) -> bool:
    """Whether a key's name says that it tells where the robot, or its gripper, is."""
    words = set(words_of(key))
    return bool(words & _UNREAD) and ("gripper" in words or not of_something_else(key))


def _is_told(value: list[object] | dict[str, object]) -> bool:
    """Whether a value is a place that is not 0, or a list of places or numbers."""
    if isinstance(value, dict):
        inner = value.get("pose", value)
        place = inner.get("position", inner) if isinstance(inner, dict) else None
        return isinstance(place, dict) and {"x", "y"} <= set(place) and any(place.values())
    return any(
        isinstance(entry, (int, float))
        or (isinstance(entry, dict) and bool({"pose", "position", "translation", "x"} & set(entry)))
        or (isinstance(entry, list) and any(isinstance(number, (int, float)) for number in entry))
        for entry in value
    )


def _robot_trajectory(node: Node, joints: Node | None, base: Node | None) -> Iterator[_Part]:
    """A RobotTrajectory: its joints' and its base's trajectory at the same times."""
    halves = [part for part in (joints and _joint_part(joints), base and _base_part(base)) if part]
    if not halves:
        return
    if len(halves) == 2:
        one, two = halves
        if len(one.rows) != len(two.rows):
            two.node.fail(f"has {len(two.rows)} points, the joints' trajectory {len(one.rows)}")
        if one.times is not None and two.times is not None and np.abs(one.times - two.times).max() > 1e-6:
            k = int(np.abs(one.times - two.times).argmax())
            two.nodes[k].fail(f"is at {two.times[k]:.9g} s, and the joints' point at {one.times[k]:.9g} s")
        times = two.times if one.times is None else one.times
        rows = np.hstack((two.rows, one.rows))
        yield _Part(
            [*two.names, *one.names],
            rows,
            times,
            one.nodes,
            node,
            two.heading,
            doubts=two.doubts,
            notes=(*one.notes, *two.notes),
            stamp=one.stamp or two.stamp,
        )
    else:
        yield halves[0]


def _joint_part(node: Node) -> _Part | None:
    """A JointTrajectory; None where it has no points."""
    names, points = _names(node), node["points"].items()
    if not points or not names:
        return None
    rows = np.array([p["positions"].vector(len(names)) for p in points])
    rates = any(p.value.get(key) for p in points for key in ("velocities", "accelerations"))
    return _Part(names, rows, _times(points), points, node, notes=(RATES,) if rates else (), stamp=_stamp(node))


def _stamp(node: Node) -> float:
    """Stamp of a message's header [s]; 0 where there is none."""
    header = _inner(node.mapping(), "header")
    stamp = None if header is None else header.value.get("stamp")
    if header is None or not isinstance(stamp, (dict, int, float)) or not stamp:
        return 0.0
    return _seconds(header["stamp"], most=1e10)


def _names(node: Node) -> list[str]:
    names = [entry.text() for entry in node["joint_names"].items()]
    twice = sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
    if twice:
        node["joint_names"].fail(f"names a joint twice: {', '.join(twice)[:200]}")
    longest = max(names, key=len, default="")
    if len(longest) > MAX_NAME:
        node["joint_names"].fail(f"has a name of {len(longest)} characters; at most {MAX_NAME} are read")
    return names


def _base_part(node: Node) -> _Part | None:
    """A MultiDOFJointTrajectory: the transform of the base, by its joint's name."""
    points = node["points"].items()
    if not points:
        return None
    names = _names(node)
    transforms = [_transforms(p["transforms"], names) for p in points]
    base = _base_of(node, names)
    doubts = [
        f"the transform of {name} changes, and {name} is not taken for the base's joint"
        for k, name in enumerate(names)
        if k != base and any(_numbers(t[k]) != _numbers(transforms[0][k]) for t in transforms)
    ]
    if not doubts and base is None:
        doubts += _placed_elsewhere(transforms[0], names)
    notes = []
    header = _inner(node.mapping(), "header")
    frame = "" if header is None else str(header.value.get("frame_id") or "").strip("/")
    if base is not None and frame.rsplit("/", 1)[-1] not in _WORLDS:
        doubts.append(
            f"the base's poses are in the frame {frame!r}, and nothing says where that is; of the world they are in "
            f"{', '.join(_WORLDS[1:])}"
        )
    elif base is not None and "odom" in frame:
        notes.append(f"the base's poses are in the frame {frame!r}, which is taken for the world")
    rows = np.array([[] if base is None else _planar(t[base]) for t in transforms])
    own = [] if base is None else _pose_names(names[base])
    return _Part(
        own,
        rows,
        _times(points),
        points,
        node,
        own[2] if own else None,
        doubts=tuple(doubts),
        notes=tuple(notes),
        stamp=_stamp(node),
    )


def _pose_names(joint: str) -> list[str]:
    """What MoveIt calls the variables of a base's joint."""
    return [f"{joint}/x", f"{joint}/y", f"{joint}/theta"]


def _transforms(node: Node, names: list[str]) -> list[Node]:
    found = node.items()
    if len(found) != len(names):
        node.fail(f"has {len(found)} transforms for {len(names)} joint_names")
    return found


def _base_of(node: Node, names: list[str]) -> int | None:
    """Which of the joints is the base's."""
    found = [k for k, name in enumerate(names) if _BASE_JOINT.fullmatch(name)]
    if len(found) > 1:
        node["joint_names"].fail(f"has several joints that may be the base's: {', '.join(names[k] for k in found)}")
    if not found and len(names) == 1 and not of_something_else(names[0]):
        return 0  # a robot has one joint that is no number
    return found[0] if found else None


def _placed_elsewhere(transforms: list[Node], names: list[str]) -> list[str]:
    """What to say of joints with a pose that nobody reads, where that is not none."""
    there = [_numbers(node) for node in transforms]
    return [
        f"the transform of {name} is not looked at, and {name} is not taken for the base's joint"
        for name, at in zip(names, there, strict=True)
        if any(abs(value) > LIMIT_TOLERANCE for key, value in at.items() if key != "rotation.w")
    ]


def _robot_state(node: Node) -> Iterator[_Part]:
    """A RobotState: where joints and base are at the start."""
    entries = {key: entry for key, entry in node.mapping().items() if entry.value}
    names: list[str] = []
    row: list[float] = []
    doubts: tuple[str, ...] = ()
    heading = None
    if "joint_state" in entries:
        names, row = _joint_state(entries["joint_state"])
    if "multi_dof_joint_state" in entries:
        own, pose, doubts = _base_state(entries["multi_dof_joint_state"], names)
        names, row, heading = [*own, *names], [*pose, *row], own[2] if own else None
    if "attached_collision_objects" in entries:
        doubts += (
            "the file's start state has objects that the robot carries (attached_collision_objects), and they are not "
            "looked at: give the robot what it holds (RobotModel.attached)",
        )
    if names or doubts:
        yield _Part(names, np.array([row]).reshape(1, len(names)), None, [node], node, heading, True, doubts)


def _joint_state(state: Node) -> tuple[list[str], list[float]]:
    """Names and positions of a JointState."""
    names = [entry.text() for entry in state["name"].items()] if "name" in state.mapping() else []
    if len(set(names)) < len(names):
        state["name"].fail("names a joint twice")
    return names, state["position"].vector(len(names)).tolist() if names else []


def _base_state(state: Node, taken: Collection[str]) -> tuple[list[str], list[float], tuple[str, ...]]:
    """Names and values of the base of a MultiDOFJointState, none where one of the names is ``taken``; and doubts."""
    joints = _names(state) if "joint_names" in state.mapping() else []
    if not joints:
        return [], [], ()
    base = _base_of(state, joints)
    if base is None:
        return [], [], tuple(_placed_elsewhere(_transforms(state["transforms"], joints), joints))
    own = _pose_names(joints[base])
    if not set(own).isdisjoint(taken):
        return [], [], ()
    return own, _planar(_transforms(state["transforms"], joints)[base]), ()


def _times(points: list[Node]) -> Array | None:
    if not any(isinstance(p.value, dict) and "time_from_start" in p.value for p in points):
        return None
    return np.array([_seconds(p["time_from_start"]) for p in points])


def _seconds(node: Node, most: float = 1e9) -> float:
    """A duration, or a time, as a number, or as ROS writes it."""
    if not isinstance(node.value, dict):
        return node.number(low=0.0, high=most, unit="s")
    whole = next((k for k in ("sec", "secs") if k in node.value), None)
    part = next((k for k in ("nanosec", "nsecs", "nsec") if k in node.value), None)
    if whole is None:
        node.fail("has neither sec nor secs")
    return node[whole].number(low=0.0, high=most, unit="s") + (
        1e-9 * node[part].number(low=0.0, high=1e9, unit="ns") if part else 0.0
    )


def _numbers(node: Node) -> Mapping[str, float]:
    """The seven numbers of a transform."""
    at, turn = node["translation"], node["rotation"]
    shift = {f"translation.{k}": at[k].number() for k in "xyz"}
    return shift | {f"rotation.{k}": turn[k].number(low=-1e6, high=1e6, unit="") for k in "xyzw"}


def _planar(node: Node) -> list[float]:
    """x, y and yaw of a transform of a base that stands upright on the floor."""
    found = _numbers(node)
    try:
        yaw = heading_of(np.array([found[f"rotation.{k}"] for k in "xyzw"]))
    except ConfigurationError as problem:
        node["rotation"].fail(str(problem))
    height = found["translation.z"]
    if abs(height) > LIMIT_TOLERANCE:
        node["translation"].fail(f"has z = {height:.6g} m; the base stands on the floor, within {LIMIT_TOLERANCE:g} m")
    return [found["translation.x"], found["translation.y"], yaw]
