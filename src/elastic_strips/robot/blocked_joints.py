"""Blocked joints: those whose own two links touch in much of their range, whatever the other joints do.

Two links that a joint joins are kept apart where they do not touch as they are drawn. Often that is how a file draws
them, a gap between two tubes, and not how the machine is; then every path that bends the joint further is refuted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .geometry import link_labels
from .value import RobotValue

_STEP = 0.05  # [rad] from one angle that is looked at to the next
_MUCH = 1.0 / 3.0  # of the range: as much has to be blocked to be worth a word


@dataclass(frozen=True, slots=True)
class BlockedJoint:
    """A joint of which much is blocked by the two links that it joins.

    Attributes:
        joint: its name.
        stated: its limits [rad].
        free: the part about the home posture in which the links do not touch [rad].
        links: the links that touch first.
    """

    joint: str
    stated: tuple[float, float]
    free: tuple[float, float]
    links: tuple[str, str]

    def __str__(self) -> str:
        (low, high), (one, two) = self.free, self.links
        return (
            f"free only from {low:.2g} to {high:.2g} rad, of {self.stated[0]:.3g} to {self.stated[1]:.3g}: beyond, "
            f"{one} touches {two}, to which it is joined"
        )


def blocked_joints(robot: RobotValue) -> list[BlockedJoint]:
    """The turning joints of which the two links that they join, where these are kept apart, block much.

    Joints whose links touch at home are left out: that is another trouble.
    """
    model, joined, labels = robot.model, _joined_pairs(robot), link_labels(robot.geometries)
    data, geometry = model.createData(), robot.collision_model.createData()
    found = []
    for column, name in enumerate(robot.joint_names, robot.space.base_nv):
        if name not in joined or not model.joints[model.getJointId(name)].shortname().startswith("JointModelR"):
            continue
        row = robot.space.to_coordinates(robot.home_q)
        home = float(row[column])
        low = max(float(robot.space.lower[column]), home - math.pi)
        high = min(float(robot.space.upper[column]), home + math.pi)
        free, hits = [], []
        for end in (low, high):
            angles = np.linspace(home, end, math.ceil(abs(end - home) / _STEP) + 2)
            last = home
            for row[column] in angles:
                q = robot.space.from_coordinates(row)
                pin.updateGeometryPlacements(model, data, robot.collision_model, geometry, q)
                hit = next((k for k in joined[name] if pin.computeCollision(robot.collision_model, geometry, k)), None)
                if hit is not None:
                    hits.append(hit)
                    break
                last = float(row[column])
            free.append(last)
        if hits and free[0] < free[1] and free[1] - free[0] < (1.0 - _MUCH) * (high - low):
            one, two = (labels[piece] for piece in robot.self_pairs[hits[0]].tolist()[::-1])
            found.append(BlockedJoint(name, (low, high), (free[0], free[1]), (one, two)))
    return found


def _joined_pairs(robot: RobotValue) -> dict[str, list[int]]:
    """Joint → numbers of the pairs of pieces that it alone joins, and that may touch."""
    joined: dict[str, list[int]] = {}
    for number, (i, k) in enumerate(robot.self_pairs.tolist()):
        if robot.self_apart[number] > 0.0:
            continue
        one, two = (set(robot.model.supports[robot.geometries[piece].joint].tolist()) for piece in (i, k))
        between = one ^ two
        if len(between) == 1:
            joined.setdefault(robot.model.names[between.pop()], []).append(number)
    return joined
