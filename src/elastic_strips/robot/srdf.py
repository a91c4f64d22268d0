"""SRDF: the self-collision pairs to ignore and the named postures."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import RobotError, nearest_name
from .xml_source import read_xml


@dataclass(frozen=True, slots=True)
class Srdf:
    """What an SRDF file says that planning uses.

    Attributes:
        path: the file.
        disabled: unordered link pairs whose collisions are ignored.
        states: posture name → joint → value [rad or m].
    """

    path: Path
    disabled: frozenset[frozenset[str]] = frozenset()
    states: dict[str, dict[str, float]] = field(default_factory=dict)


def read_srdf(path: str | Path, *, links: set[str], joints: set[str]) -> Srdf:
    """Read an SRDF file against the links and joints of its robot.

    Raises:
        RobotError: unreadable, malformed, or it names a link or joint that the robot has not.
    """
    source = Path(path)
    root = read_xml(source, root="robot", kind="SRDF")
    disabled: set[frozenset[str]] = set()
    for element in root.iter("disable_collisions"):
        pair = []
        for key in ("link1", "link2"):
            name = element.get(key)
            if name is None:
                raise RobotError(f"{source}:{element.sourceline}: <disable_collisions> has no attribute {key!r}")
            if name not in links:
                hint = nearest_name(name, links)
                raise RobotError(
                    f"{source}:{element.sourceline}: <disable_collisions> names unknown link {name!r}{hint}"
                )
            pair.append(name)
        disabled.add(frozenset(pair))
    states: dict[str, dict[str, float]] = {}
    for element in root.iter("group_state"):
        name = element.get("name")
        if not name:
            raise RobotError(f"{source}:{element.sourceline}: <group_state> has no name")
        values = states.setdefault(name, {})
        for joint in element.iter("joint"):
            key, text = joint.get("name"), joint.get("value")
            if key not in joints:
                hint = nearest_name(key, joints)
                raise RobotError(
                    f"{source}:{joint.sourceline}: <group_state> {name!r} names unknown joint {key!r}{hint}"
                )
            try:
                value = float(text or "")
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise RobotError(
                    f"{source}:{joint.sourceline}: joint {key!r} of {name!r} has value {text!r}, not a number"
                )
            values[str(key)] = value
    return Srdf(source, frozenset(disabled), states)
