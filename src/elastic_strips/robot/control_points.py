"""Control points: P_m at the base and P_1 … P_n at the joints and the hand, as in the paper's Fig. 4."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from elastic_strips.arrays import Array

from ..errors import RobotError, nearest_name


@dataclass(frozen=True, slots=True)
class ControlPoints:
    """Points fixed to the robot's bodies.

    Attributes:
        names: (C,) names; the first is the base's for a planar root.
        joint: (C,) Pinocchio joint index that carries each point.
        local: (C, 3) position in that joint's frame [m].
    """

    names: tuple[str, ...]
    joint: npt.NDArray[np.intp]
    local: Array


def find_frame(model: pin.Model, name: str) -> int | None:
    """Index of a frame by name; a link's where a joint has the same name."""
    found = [i for i, frame in enumerate(model.frames) if frame.name == name]
    bodies = [i for i in found if model.frames[i].type == pin.FrameType.BODY]
    return (bodies or found or [None])[0]


def default_control_points(model: pin.Model, planar: bool, hand_frame: str | None = None) -> ControlPoints:
    """P_m at the base, one point at every joint's origin, and the hand; points that coincide always are one point."""
    names: list[str] = []
    joint: list[int] = []
    local: list[Array] = []
    if planar:
        names.append("P_m")
        joint.append(1)
        local.append(np.zeros(3))
    first = 2 if planar else 1
    for i in range(first, model.njoints):
        names.append(f"P_{i - first + 1}")
        joint.append(i)
        local.append(np.zeros(3))
    hand = None if hand_frame is None else find_frame(model, hand_frame)
    if hand is not None:
        frame = model.frames[hand]
        carrier = int(frame.parentJoint)
        if np.linalg.norm(frame.placement.translation) > 1e-6 or carrier != joint[-1]:
            names.append("P_hand")
            joint.append(carrier)
            local.append(np.array(frame.placement.translation))
    return ControlPoints(tuple(names), np.asarray(joint, dtype=np.intp), np.asarray(local, dtype=float).reshape(-1, 3))


def parse_control_points(model: pin.Model, given: Mapping[str, str | tuple[str, npt.ArrayLike]]) -> ControlPoints:
    """Control points given by the user: name → frame name, or name → (frame name, offset (3,) [m]).

    Raises:
        RobotError: an unknown frame, or an offset that is not three finite numbers.
    """
    names, joint, local = [], [], []
    frames = [f.name for f in model.frames]
    if not given:
        raise RobotError("control_points is empty; give at least one, or None for the default")
    for name, value in given.items():
        frame_name, offset = (value, np.zeros(3)) if isinstance(value, str) else value
        if frame_name not in frames:
            raise RobotError(f"control point {name!r}: unknown frame {frame_name!r}{nearest_name(frame_name, frames)}")
        point = np.asarray(offset, dtype=float)
        if point.shape != (3,) or not np.all(np.isfinite(point)):
            raise RobotError(f"control point {name!r}: offset {offset!r} is not three finite numbers [m]")
        frame = model.frames[find_frame(model, frame_name) or 0]
        names.append(name)
        joint.append(int(frame.parentJoint))
        local.append(frame.placement.act(point))
    return ControlPoints(tuple(names), np.asarray(joint, dtype=np.intp), np.asarray(local, dtype=float))
