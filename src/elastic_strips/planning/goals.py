"""Goals as people state them: a pose of a hand, of two, of the base, a few joints, alternatives."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.errors import ParameterError
from elastic_strips.robot.inverse_kinematics import rotation_of
from elastic_strips.robot.space import beyond_turns
from elastic_strips.validation import Checked, Finite, check_array, check_count, check_fields

if TYPE_CHECKING:
    from typing import TypeAlias


_LEAST_LEVER = 1e-3  # [rad] by which what is held is off the axis, at least, that there is a way to tilt


@dataclass(frozen=True, slots=True)
class HandPose(Checked):
    """A frame of the robot at a pose in the world.

    Attributes:
        frame: name of the frame.
        position: (3,) its position [m].
        orientation: quaternion (x, y, z, w), or None where any orientation will do.
        within: (3,) how far it may be off along the world's axes [m]: half the sides of a box.

    Examples:
        >>> anywhere = es.HandPose("hand_frame", (3.0, 0.2, 0.8))
        >>> level = es.HandPose("hand_frame", (3.0, 0.2, 0.8), (0.0, 0.0, 0.0, 1.0), within=(0.05, 0.05, 0.0))
        >>> robot = es.load_robot("silvermate")
        >>> strip = es.plan(robot, es.Scene(), robot.home(), anywhere)
        >>> bool(abs(robot.frame_pose(strip.q[-1], "hand_frame")[:3, 3] - anywhere.position).max() < 1e-3)
        True
    """

    frame: str
    position: tuple[float, float, float]
    orientation: tuple[float, float, float, float] | None = None
    within: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check_fields(self)
        check_array("HandPose.position", self.position, (3,))
        _check_box("HandPose.within", self.within, 3)
        if self.orientation is not None:
            rotation_of(self.orientation)

    @staticmethod
    def around(
        frame: str,
        point: npt.ArrayLike,
        *,
        held: npt.ArrayLike = (0.0, 0.0, 0.0),
        rotations: npt.ArrayLike,
        axis: npt.ArrayLike = (0.0, 0.0, 1.0),
        count: int = 12,
        tilts: npt.ArrayLike = (0.0,),
    ) -> list[HandPose]:
        """Poses of a frame with which a hand holds a point from all sides of an axis: grasps of round things.

        Args:
            frame: name of the frame.
            point: (3,) point in the world [m].
            held: (3,) place in the frame where the hand holds it [m].
            rotations: (K, 3, 3) or (3, 3) first rotations of the frame.
            axis: (3,) axis in the world about which each of them is turned.
            count: number of even angles of these turns.
            tilts: (T,) by how much the hand comes from further up the axis than by its first rotation [rad]: level and
                from above where they are (0, π/2) and the first rotation holds it level. It is tilted about the point,
                in the plane of the axis and of ``held``.

        Raises:
            ParameterError: an array of another shape, an axis without length, a count below 1; tilts of a hand that
                holds the point at its frame's origin, or up or down the axis from there.
        """
        place, hold = check_array("point", point, (3,)), check_array("held", held, (3,))
        count, about = check_count("count", count, low=1), check_array("axis", axis, (3,))
        first = np.asarray(rotations, dtype=float)
        first = check_array("rotations", first, (3, 3) if first.ndim == 2 else (len(first), 3, 3))
        length = float(np.linalg.norm(about))
        if length < 1e-9:
            raise ParameterError(f"axis={about.tolist()} has no length")
        angles = check_array("tilts", tilts, (None,))
        about = about / length
        tilted = [_tilted(R, about, hold, tilt) for tilt in angles.tolist() for R in first.reshape(-1, 3, 3)]
        out = []
        for angle in np.arange(count) * 2.0 * np.pi / count:
            turn = pin.exp3(about * angle)
            for rotation in tilted:
                R = turn @ rotation
                x, y, z = (place - R @ hold).tolist()
                qx, qy, qz, qw = pin.Quaternion(R).coeffs().tolist()
                out.append(HandPose(frame, (x, y, z), (qx, qy, qz, qw)))
        return out

    def __str__(self) -> str:
        at = ", ".join(f"{v:g}" for v in self.position)
        turned = "" if self.orientation is None else ", turned as asked"
        return f"{self.frame!r} at ({at}) m{turned}"


def _tilted(rotation: Array, axis: Array, held: Array, tilt: float) -> Array:
    """A rotation (3, 3), tilted so that the line to what is held leads further down the axis [rad].

    Raises:
        ParameterError: there is no such line, or it leads along the axis.
    """
    if tilt == 0.0:
        return rotation
    sideways = np.cross(axis, rotation @ held)
    size = float(np.linalg.norm(sideways))
    if size < _LEAST_LEVER * float(np.linalg.norm(held)) or size == 0.0:
        raise ParameterError(
            f"tilts: held={held.tolist()} leads along the axis, or nowhere: there is no side to tilt to"
        )
    return pin.exp3(tilt / size * sideways) @ rotation


@dataclass(frozen=True, slots=True)
class BasePose(Checked):
    """The base at a place of the floor, the joints as at the start.

    Attributes:
        x, y: place in the world [m].
        yaw: heading [rad], or None where any will do.
        within: (2,) how far it may be off along x and y [m].

    Examples:
        >>> facing_the_door = es.BasePose(4.0, 1.0, yaw=1.57)
        >>> robot = es.load_robot("silvermate")
        >>> strip = es.plan(robot, es.Scene(), robot.home(), es.BasePose(4.0, 1.0))  # with any heading
        >>> strip.q[-1, :2].round(3).tolist()
        [4.0, 1.0]
    """

    x: Finite
    y: Finite
    yaw: Finite | None = None
    within: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_fields(self)
        _check_box("BasePose.within", self.within, 2)
        if self.yaw is not None and (said := beyond_turns(self.yaw)):
            raise ParameterError(f"BasePose(...): yaw={self.yaw!r} {said}")

    def __str__(self) -> str:
        return f"base at ({self.x:g}, {self.y:g}) m" + ("" if self.yaw is None else f", {self.yaw:g} rad")


@dataclass(frozen=True, slots=True, init=False)
class AllOf:
    """Several poses at once: of two hands, or of a hand and the base.

    Attributes:
        goals: what is to be reached together: poses of different frames, and one of the base at most.

    Raises:
        ParameterError: no goals, something else than poses, or two of them for one frame or for the base.
    """

    goals: tuple[HandPose | BasePose, ...]

    def __init__(self, *goals: HandPose | BasePose) -> None:
        object.__setattr__(self, "goals", goals)
        if not goals:
            raise ParameterError("AllOf() is empty: it takes HandPoses of different frames, and one BasePose at most")
        for goal in goals:
            if not isinstance(goal, (HandPose, BasePose)):
                raise ParameterError(f"AllOf takes HandPoses and one BasePose, not a {type(goal).__name__}")
        for what, count in Counter(_moved(goal) for goal in goals).items():
            if count > 1:
                raise ParameterError(
                    f"AllOf has {count} poses of {what}, which can be at one place only; goals of which any will do "
                    "are a list"
                )

    @property
    def hands(self) -> tuple[HandPose, ...]:
        """The poses of frames."""
        return tuple(goal for goal in self.goals if isinstance(goal, HandPose))

    @property
    def base(self) -> BasePose | None:
        """The pose of the base, if there is one."""
        return next((goal for goal in self.goals if isinstance(goal, BasePose)), None)

    def __str__(self) -> str:
        return " and ".join(map(str, self.goals))


def _moved(goal: HandPose | BasePose) -> str:
    return f"frame {goal.frame!r}" if isinstance(goal, HandPose) else "the base"


Goal: TypeAlias = npt.ArrayLike | HandPose | BasePose | AllOf | Mapping[str, HandPose | npt.ArrayLike]
"""A configuration (nq,); a pose of a hand or the base, or several at once (:class:`AllOf`); some coordinates by name:
``x``, ``y``, ``yaw`` and joints; or poses by frame, at once too: a :class:`HandPose`, a position (3,) or a pose
(4, 4)."""


def is_goal_region(goal: object) -> bool:
    """Whether a goal is something other than one configuration."""
    if isinstance(goal, (HandPose, BasePose, AllOf, Mapping)):
        return True
    return (
        isinstance(goal, Sequence)
        and not isinstance(goal, str)
        and (len(goal) == 0 or isinstance(goal[0], (HandPose, BasePose, AllOf, Mapping, Sequence, np.ndarray)))
    )


def by_name(goal: Mapping[str, object]) -> AllOf | Mapping[str, float]:
    """What a mapping means: coordinates by name, or poses by frame.

    Raises:
        ParameterError: it has both, a pose that is none, or is of another frame, or a yaw that must be in degrees.
    """
    numbers = {name for name, value in goal.items() if not isinstance(value, HandPose) and np.ndim(value) == 0}  # type: ignore[arg-type]
    if len(numbers) == len(goal):
        if isinstance(yaw := goal.get("yaw"), (int, float)) and (said := beyond_turns(yaw)):
            raise ParameterError(f"goal: yaw={yaw!r} {said}")
        return goal  # type: ignore[return-value]
    if numbers:
        raise ParameterError(
            f"goal has coordinates ({', '.join(sorted(numbers))}) and poses of frames "
            f"({', '.join(sorted(set(goal) - numbers))}) in one mapping; "
            "poses together are AllOf(HandPose(…), BasePose(…))"
        )
    return AllOf(*(_pose_of(frame, value) for frame, value in goal.items()))


def _pose_of(frame: str, value: object) -> HandPose:
    if isinstance(value, HandPose):
        if value.frame != frame:
            raise ParameterError(f"goal[{frame!r}] is a pose of another frame, {value.frame!r}")
        return value
    given = np.asarray(value, dtype=object)
    if given.shape == (3,):
        x, y, z = check_array(f"goal[{frame!r}]", value, (3,)).tolist()  # type: ignore[arg-type]
        return HandPose(frame, (x, y, z))
    if given.shape != (4, 4):
        raise ParameterError(
            f"goal[{frame!r}] has shape {given.shape}; a HandPose, a position (3,) or a pose (4, 4) is one"
        )
    pose = check_array(f"goal[{frame!r}]", value, (4, 4))  # type: ignore[arg-type]
    x, y, z = pose[:3, 3].tolist()
    qx, qy, qz, qw = pin.Quaternion(rotation_of(pose[:3, :3], f"goal[{frame!r}]")).coeffs().tolist()
    return HandPose(frame, (x, y, z), (qx, qy, qz, qw))


def refuse_several_frames(goals: Sequence[Goal]) -> None:
    """Refuse a list of poses of different frames: whether any or all of them are meant is not clear.

    Raises:
        ParameterError: it is one.
    """
    frames = list(dict.fromkeys(goal.frame for goal in goals if isinstance(goal, HandPose)))
    if len(frames) > 1:
        raise ParameterError(
            f"goal is a list of poses of different frames ({', '.join(map(repr, frames))}), and of a list any one will "
            "do: AllOf(HandPose(…), HandPose(…)) has them all reached at once; where one of them is enough, the list "
            "is to have AllOf(HandPose(…)) of each"
        )


def _check_box(what: str, value: Sequence[float], count: int) -> None:
    if (check_array(what, value, (count,)) < 0.0).any():
        raise ParameterError(f"{what}={tuple(value)!r} must not be negative")
