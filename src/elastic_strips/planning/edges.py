"""Edges of a planner's path: proven by the motion bound, where the planner itself has only looked at samples."""

from __future__ import annotations

from ..deform import Deformer
from ..relax import project_rolling
from ..robot import BaseKind
from ..robot.space import Array
from ..scene import Scene
from ..strip import Strip
from ..tunnel import Certificate


def certify_path(deformer: Deformer, scene: Scene, chart: Array) -> Certificate:
    """The certificate of a path as it is, edge by edge, with the clearances of the deformer's parameters.

    A differential drive's waypoints are first moved, as little as possible, until wheels can follow them.

    Args:
        deformer: a workspace of the robot; what it knows of other strips is lost.
        scene: the obstacles.
        chart: waypoints (N, nv).
    """
    robot = deformer.robot
    if robot.base_kind is BaseKind.DIFF_DRIVE:
        chart, _ = project_rolling(robot.space, chart)
    return deformer.certify(Strip.from_chart(robot, chart), scene)
