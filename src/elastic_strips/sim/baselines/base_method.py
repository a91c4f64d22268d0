"""What the base methods share: limits of the base, their command, and the interface that all of them have.

All of them steer the *base*: a disc on the floor that rolls as a differential drive. The arm is tucked in or ignored;
what it reaches is none of their business.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

from elastic_strips.arrays import Array
from elastic_strips.errors import ParameterError
from elastic_strips.execution.limits import MotionLimits
from elastic_strips.perception import Reading
from elastic_strips.validation import check_numbers

Status = Literal["moving", "arrived", "blocked"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseLimits:
    """The base that a method steers.

    Attributes:
        radius: of a circle about the base's origin that holds the base [m]; 0.27 holds the Silvermate's.
        max_speed: largest speed forwards [m/s]; no method drives backwards.
        max_turn: largest yaw rate [rad/s].
        acceleration: largest change of the speed [m/s²], speeding up as well as braking.
        turn_acceleration: largest change of the yaw rate [rad/s²].
    """

    radius: float = 0.27
    max_speed: float = 0.6
    max_turn: float = 1.5
    acceleration: float = 0.8
    turn_acceleration: float = 3.0

    def __post_init__(self) -> None:
        check_numbers(self)

    @staticmethod
    def of(motion: MotionLimits, *, radius: float = 0.27, max_speed: float = 0.6, max_turn: float = 1.5) -> BaseLimits:
        """What the wheels of a differential drive allow, at most ``max_speed`` [m/s] and ``max_turn`` [rad/s].

        Speed and yaw rate are bounded by themselves: both at once may ask more of a rim than it can do; whoever drives
        the wheels scales them alike then.

        Raises:
            ParameterError: no differential drive, or a value out of range.
        """
        if motion.drive_dim != 2:
            raise ParameterError(f"BaseLimits.of: {motion.drive_dim} drive coordinates; a differential drive has 2")
        speed, change = float(motion.drive_speed.min()), float(motion.drive_acceleration.min())
        arm = 0.5 * motion.track
        return BaseLimits(
            radius=radius,
            max_speed=min(max_speed, speed),
            max_turn=min(max_turn, speed / arm),
            acceleration=change,
            turn_acceleration=change / arm,
        )


@dataclass(frozen=True, slots=True)
class BaseCommand:
    """What the base is told to do.

    Attributes:
        v: speed forwards [m/s].
        omega: yaw rate [rad/s].
        status: ``"moving"``; ``"arrived"``: at the goal, at rest; ``"blocked"``: no way is known, or for some time the
            base came no nearer. A blocked method goes on trying.
        reason: why, in words; may be empty.
    """

    v: float
    omega: float
    status: Status
    reason: str = ""


@runtime_checkable
class BaseMethod(Protocol):
    """A method that steers a base to a goal among obstacles that its sensors see."""

    name: str

    def reset(self) -> None:
        """Forget all that was sensed and done."""
        ...

    def update(self, reading: Reading, pose: Array) -> None:
        """Take in a reading.

        Args:
            reading: of any sensor.
            pose: (3,) estimated x, y [m], yaw [rad] of the base when it was measured.
        """
        ...

    def command(self, t: float, pose: Array, velocity: Array, goal: Array) -> BaseCommand:
        """What to do now.

        Args:
            t: time [s]; it must not go back.
            pose: (3,) estimated x, y [m], yaw [rad].
            velocity: (2,) estimated speed [m/s] and yaw rate [rad/s].
            goal: (3,) x, y [m], yaw [rad]; a yaw of nan: any.
        """
        ...
