"""Execution room, proposal: what a planning tick came to."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..deform import DeformReport
from ..tunnel import Certificate
from .trajectory import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """What a planning tick came to.

    Attributes:
        motion, certificate: the certified motion, or the last one that was tried; None where there is none.
        accepted: whether the certificate holds.
        kept: whether the held motion is the best there is, and still certified: then ``motion`` is what is left of it.
        at_goal: whether the motion ends at the goal.
        reason: why there is no certified motion, or "".
        report: of the strip's tick.
        speed: fraction of full speed that the motion was planned for.
        timings: seconds by phase.
        evasive: whether the motion leaves the strip, to get out of the way of what moves.
        emergency: whether the motion, which needs no certificate, brakes on the way of the held one: the scene is not
            what that one's certificate allowed for, and it is no longer certified.
        late: so much later [s] than its tick it is ready.
    """

    motion: Trajectory | None
    certificate: Certificate | None
    accepted: bool
    kept: bool
    at_goal: bool
    reason: str
    report: DeformReport
    speed: float
    timings: dict[str, float] = field(default_factory=dict)
    evasive: bool = False
    emergency: bool = False
    late: float = 0.0
