"""IO room, path names: what the name of a column says: a coordinate of a base, a joint, a time, a unit.

Names are taken apart into words; which words are those of bases, of others, of clocks and of units stands here.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection

import numpy as np

from elastic_strips.robot import RobotModel

TIMES = (
    "time", "times", "t", "ts", "time_from_start", "seconds", "sec", "secs", "timestamp", "stamp", "elapsed",
    "elapsed_time",
)  # fmt: skip
_CLOCKS = ("nanosec", "nsec", "nsecs", "nanosecs", "nanoseconds")
_OF_CLOCKS = {"header", "ros", "sim", "wall", "stamp", "time", "log", "recording", "rec", "elapsed", "unix", "field"}
MAX_NAME = 300  # characters
_MISSPELT = 0.85  # share of letters that a name and what it may mean have in common, as difflib counts
_NUMBERS = re.compile(r"\d+")
_COORDINATES = {
    **dict.fromkeys(("x", "px", "tx"), 0), **dict.fromkeys(("y", "py", "ty"), 1),
    **dict.fromkeys(("yaw", "theta", "heading", "th", "t", "phi", "psi", "rz", "orientation"), 2),
    **dict.fromkeys(("z", "pz", "tz", "roll", "pitch", "rx", "ry"), 3),
}  # fmt: skip
"""Column of a pose: x, y, yaw, or what has to be 0 of a base on the floor."""
_TURNS_OF = {"orientation", "rot", "rotation", "quaternion", "quat"}
_FILLERS = {*_TURNS_OF, "position", "pos", "trans", "translation", "joint", "axis"}
"""What a coordinate's name may have beside that of whose it is."""
_NAME = re.compile(r"[\w/.:\s~%][\w/.:\[\]\s~%-]*", re.ASCII)  # else it has a unit, or what is not known
_WORDS = re.compile(r"[A-Z]?[a-z]+\d*|[A-Z]+\d*(?![a-z])|\d+")
BASE_WORDS = {
    "base", "odom", "odometry", "position", "pos", "world", "virtual", "planar", "mobile", "root", "robot", "map",
    "chassis", "platform", "cart", "vehicle", "joint", "link", "footprint", "frame", "pose", "mobilebase",
    "floating", "state", "agv", "amr", "dummy",
}  # fmt: skip
OTHER_WORDS = {
    "goal", "target", "cmd", "twist", "command", "desired", "ref", "reference", "ee", "eef", "tcp", "tool", "hand",
    "gripper", "object", "obstacle", "camera", "error", "human", "person", "next", "previous", "wrist", "head",
    "neck", "torso", "waist", "arm", "leg", "foot",
}  # fmt: skip
UNITS: dict[str, tuple[str, float]] = {
    **dict.fromkeys(("rad", "radian", "radians"), ("angle", 1.0)),
    **dict.fromkeys(("deg", "degree", "degrees", "°"), ("angle", np.pi / 180.0)),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), ("length", 1.0)),
    **dict.fromkeys(("cm",), ("length", 1e-2)), **dict.fromkeys(("mm",), ("length", 1e-3)),
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), ("time", 1.0)), **dict.fromkeys(("ms",), ("time", 1e-3)),
    **dict.fromkeys(("us", "µs", "μs"), ("time", 1e-6)), **dict.fromkeys(("ns", "nsec"), ("time", 1e-9)),
}  # fmt: skip
"""Unit → what it is of, and how much of its SI unit it is."""
_BRACKETS = re.compile(r"(?P<stem>.*?)[\s_]*[\[(]\s*(?P<unit>[^\])\d]+?)\s*[\])]")
_SUFFIX = re.compile(rf"(?P<stem>.+)[_\s](?P<unit>{'|'.join(map(re.escape, UNITS))})", re.IGNORECASE)


def is_time(stem: str) -> bool:
    """Whether a name is that of times: ``t``, ``header.stamp``, ``sim_time``."""
    words = words_of(stem)
    if stem.lower() in TIMES or (len(words) == 1 and words[0] in _CLOCKS):
        return True
    last = ("time", "stamp", "timestamp", "sec", "secs", *_CLOCKS)
    return len(words) > 1 and words[-1] in last and set(words[:-1]) <= _OF_CLOCKS


def is_unit(text: str) -> bool:
    """Whether a cell below a name is a unit that is known."""
    return text.strip().strip("[]()").strip().lower() in UNITS


def known_name(name: str, robot: RobotModel) -> bool:
    """Whether a name is one of the robot's, with or without a unit."""
    own = {*robot.joint_names, *robot.locked}
    return any(stem in own or pose_of(stem) for stem, _ in readings_of(clean_name(name)))


def words_of(name: str) -> list[str]:
    """A name's words: ``robot1/baseX`` has robot1, base and x."""
    return [word.lower() for word in _WORDS.findall(name)]


def pose_of(stem: str) -> tuple[str, int] | None:
    """Whose coordinate a name says, and which; None where it is no coordinate of a pose."""
    words = words_of(stem)
    if len(words) == 2 and words[0] in _COORDINATES and words[1] == "base":
        words.reverse()
    while len(words) > 1 and words[-1] in ("joint", "axis"):
        words.pop()
    number = _COORDINATES.get(words[-1]) if words and _NAME.fullmatch(stem) else None
    if words[-2:] in (["z", "rotation"], ["rot", "z"], ["rotation", "z"]):
        number = 2
    elif len(words) > 1 and number in (0, 1) and words[-2] in _TURNS_OF:
        number = 3
    if number is None or words == ["t"]:
        return None
    return " ".join(word for word in words[:-1] if word not in _FILLERS and word not in "xyz"), number


def quaternion_part(name: str) -> tuple[str, str] | None:
    """Whose quaternion a name says, and which of x, y, z and w of it."""
    words = words_of(name)
    last = words[-1] if words else ""
    if not (last in ("qx", "qy", "qz", "qw") or (len(last) == 1 and last in "xyzw" and _TURNS_OF & set(words))):
        return None
    return " ".join(word for word in words[:-1] if word not in _FILLERS), last[-1]


def namesake(name: str, joints: Collection[str]) -> str:
    """The joint that a name may mean which is not quite its own: in another namespace, other letters, with a word more,
    or misspelt.

    Empty where there is none.
    """
    words, numbers = words_of(name), _NUMBERS.findall(name)
    best = ""
    for joint in joints:
        own = words_of(joint)
        within = any(words[k : k + len(own)] == own for k in range(len(words) - len(own) + 1))
        ending = len(words) < len(own) and own[-len(words) :] == words
        if words and own and (within or ending) and len(joint) > len(best):
            best = joint
    if best:
        return best
    alike = {joint.lower(): joint for joint in joints if _NUMBERS.findall(joint) == numbers}  # joint_1 is not joint_2
    found = difflib.get_close_matches(name.lower(), alike, n=1, cutoff=_MISSPELT)
    return alike[found[0]] if found else ""


def of_robot(name: str, robot: RobotModel) -> bool:
    """Whether a name may be that of a joint of the robot, or of its base."""
    found = pose_of(name)
    own = {*robot.joint_names, *robot.locked, *robot.followers}
    return bool(namesake(name, own)) or (found is not None and set(found[0].split()) <= BASE_WORDS)


def of_base(name: str) -> bool:
    """Whether a name is made of the words by which bases go."""
    words = set(words_of(name))
    return bool(words) and words <= BASE_WORDS


def of_something_else(name: str) -> bool:
    """Whether a name says that it is of a goal, a tool, an object …, and so not of the base."""
    return bool(set(words_of(name)) & OTHER_WORDS)


def clean_name(name: str) -> str:
    return str(name).strip().strip("\"'").strip().removeprefix("%").strip()


def readings_of(name: str) -> list[tuple[str, str | None]]:
    """A name as it stands, and without the unit at its end."""
    readings: list[tuple[str, str | None]] = [(name, None)]
    for pattern in (_BRACKETS, _SUFFIX) if len(name) <= MAX_NAME else ():  # they take long where there is much
        match = pattern.fullmatch(name)
        if match is not None and match["stem"].strip():
            readings.append((match["stem"].strip(), match["unit"].strip()))
    return readings


def clock_of(name: str) -> tuple[str, bool]:
    """What a column of times is of; and whether it has the nanoseconds of those alone."""
    words = words_of(name)
    fine = words[-1] in _CLOCKS
    return " ".join(words[:-1] if fine or words[-1] in ("sec", "secs") else words), fine
