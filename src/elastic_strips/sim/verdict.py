"""Sim room, verdict: what the judge found out about a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..summary import Summary
from .sweep import Approach

REST_SPEED = 0.01
"""A robot is at rest while none of its control points is faster [m/s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """A time during which the robot and one obstacle touched, with gaps of no more than 0.25 s.

    Attributes:
        time, end: its first and last moment [s].
        link: the link that went deepest; obstacle: what was touched.
        depth: deepest penetration [m] among the recorded samples (and moments between them that were looked at).
        speed: largest speed of any of the robot's control points from the sample before to the one after it [m/s].
    """

    time: float
    end: float
    link: str
    obstacle: str
    depth: float
    speed: float

    @property
    def at_rest(self) -> bool:
        """Whether the robot stood: the obstacle came to it."""
        return self.speed <= REST_SPEED


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Verdict(Summary):
    """What a run did.

    Attributes:
        min_clearance_m: least distance of the robot to an obstacle, at a moment that was measured; at most
            ``accuracy_m`` above the least at any time; negative in penetration, infinite without obstacles.
        accuracy_m: see there.
        closest: that moment, with link and obstacle; None without obstacles.
        contacts: all of them in the order of time, those of a robot at rest among them.
        max_lateral_slip_m: most sideways travel between two successive reference samples that do not both stand still;
            differential drives only.
        excess: by how much a limit was exceeded at most, relative to it, by name; 0 where it was kept. ``drive`` is
            of the motors where the record has them, else over the ground; ``joints`` of the true speeds; each also as
            ``*_acceleration``; ``command_*`` are commands. Empty without limits.
        path_m: length of the base's true path; of the joints' path [rad] for a fixed base.
        time_s: between the first and the last sample.
        rest_s: of it at rest, see `REST_SPEED`.
        reached: whether the last sample is at the goal; None without a goal.
        reached_s: from when on the robot was at the goal until the end, since the first sample; None if it was not.
        asked: exact distances that were measured.
    """

    min_clearance_m: float
    accuracy_m: float
    closest: Approach | None
    contacts: tuple[Contact, ...]
    max_lateral_slip_m: float
    excess: Mapping[str, float] = field(default_factory=dict)
    path_m: float
    time_s: float
    rest_s: float
    reached: bool | None
    reached_s: float | None
    asked: int

    @property
    def collisions(self) -> tuple[Contact, ...]:
        """Contacts into which the robot moved, or during which it moved."""
        return tuple(c for c in self.contacts if not c.at_rest)

    @property
    def rest_contacts(self) -> tuple[Contact, ...]:
        """Contacts during which the robot stood."""
        return tuple(c for c in self.contacts if c.at_rest)

    def as_dict(self) -> dict[str, Any]:
        """Plain values, ready for JSON; None for a clearance without obstacles."""
        names = ("max_lateral_slip_m", "path_m", "time_s", "rest_s", "reached", "reached_s", "accuracy_m", "asked")
        closest = self.closest
        return {
            "min_clearance_m": None if closest is None else self.min_clearance_m,
            "closest": None if closest is None else [closest.time, closest.link, closest.obstacle],
            "collisions": [_contact(c) for c in self.collisions],
            "rest_contacts": [_contact(c) for c in self.rest_contacts],
            "excess": dict(self.excess),
            **{name: getattr(self, name) for name in names},
        }


def _contact(c: Contact) -> dict[str, Any]:
    return {
        "time": c.time,
        "end": c.end,
        "link": c.link,
        "obstacle": c.obstacle,
        "depth_m": c.depth,
        "speed_mps": c.speed,
    }
