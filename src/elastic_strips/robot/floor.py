"""The floor under a base that moves: no obstacle, but something into which a path had better not lead an arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.coal_shapes import support

from .geometry import LinkGeometry, link_labels
from .kinematics import Kinematics
from .value import RobotValue

_SLACK = 2e-3  # [m] by which a link may be below the floor without a word
_BETWEEN = np.linspace(0.0, 1.0, 5)[:-1]  # places of a segment that are looked at
_MOST_ROWS = 4000  # that are looked at


@dataclass(frozen=True, slots=True)
class BelowFloor:
    """A link below the floor.

    Attributes:
        link: its name.
        depth: how far below it is at most [m], of what was looked at.
        level: height of the floor [m].
    """

    link: str
    depth: float
    level: float

    @property
    def height(self) -> str:
        """Where the floor is, for people."""
        return f"z = {round(self.level, 3) + 0.0:g} m"  # no −0

    def __str__(self) -> str:
        return (
            f"{self.link} is up to {self.depth:.3f} m below the floor on which the robot stands ({self.height}), which "
            "is an obstacle only where the scene has one"
        )


def below_floor(robot: RobotValue, rows: Array) -> BelowFloor | None:
    """The link that is furthest below the floor on coordinate rows (N, nv), or between them; None where none is, and
    of a robot whose base is fixed.

    The floor is as high as the robot's lowest point at home: wheels, or feet.
    """
    space, pieces = robot.space, robot.geometries
    if not space.planar or not len(rows):
        return None
    arm = [k for k, piece in enumerate(pieces) if piece.joint > 1]  # what the base carries keeps its height
    kin = Kinematics(robot.tree, 1)
    kin.update(space.to_coordinates(robot.home_q)[None], jacobians=False)
    level = min(float(_lowest(*_height(robot, kin, piece), piece).min()) for piece in pieces)
    if len(rows) > 1:
        steps = np.diff(rows, axis=0)
        between = (rows[:-1, None] + _BETWEEN[None, :, None] * steps[:, None]).reshape(-1, rows.shape[1])
        rows = np.vstack((between, rows[-1:]))
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _MOST_ROWS)).astype(int))]
    kin = Kinematics(robot.tree, len(rows))
    kin.update(rows, jacobians=False)
    deepest, link = level - _SLACK, ""
    for k in arm:
        piece = pieces[k]
        up, height = _height(robot, kin, piece)
        ends = np.minimum(up @ piece.capsule.a, up @ piece.capsule.b) + height
        near = ends - piece.capsule.r < deepest  # the capsule contains it
        if near.any():
            low = float(_lowest(up[near], height[near], piece).min())
            if low < deepest:
                deepest, link = low, link_labels(pieces)[k]
    return BelowFloor(link, level - deepest, level) if link else None


def _height(robot: RobotValue, kin: Kinematics, piece: LinkGeometry) -> tuple[Array, Array]:
    """The world's z axis in the frame of a piece's joint (N, 3), and how high that frame is (N,) [m]."""
    T = kin.T[piece.joint, : kin.n]
    return T[:, 2, :3] @ robot.tree.align[piece.joint].T, T[:, 2, 3]


def _lowest(up: Array, height: Array, piece: LinkGeometry) -> Array:
    """Heights (N,) [m] of the lowest point of a piece, whose joint is at heights (N,) [m] and has the world's z axis at
    ``up`` (N, 3)."""
    placement = np.asarray(piece.placement)
    return up @ placement[:3, 3] + height - support(piece.geometry, -up @ placement[:3, :3])
