"""Start and goal: refused where they are unsound or too close to something, with the pair and its distance."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..deform import DeformParams
from ..errors import ConfigurationError
from ..proximity import BodySet, MotionBounds, ObstacleProximity, SelfProximity
from ..robot import Kinematics, RobotModel
from ..robot.space import Array
from ..scene import Scene


def check_ends(
    robot: RobotModel, scene: Scene, start: npt.ArrayLike, goal: npt.ArrayLike, params: DeformParams
) -> tuple[Array, Array]:
    """Check start and goal: sound configurations (nq,) that keep the clearances of ``params``.

    Raises:
        ConfigurationError: names what is wrong: the entry, or the pair that is too close and its distance.
    """
    ends = []
    for what, given in (("start", start), ("goal", goal)):
        q = robot.check_q(given, what=what)
        if q.ndim != 1:
            raise ConfigurationError(f"{what} has shape {q.shape}; it must be one configuration ({robot.nq},)")
        ends.append(q)
    bodies = BodySet.links(robot)
    kin = Kinematics(robot.tree, 2)
    kin.update(robot.space.to_chart(np.stack(ends)))
    obstacles = ObstacleProximity(bodies, influence=2.0 * params.clearance + 0.01)
    obstacles.update(kin, scene)
    reach = 2.0 * params.self_clearance + 0.01
    own = SelfProximity(bodies, robot.self_pairs, MotionBounds(bodies), influence=reach)
    own.update(kin)
    for node, what in enumerate(("start", "goal")):
        if obstacles.bound[node].size:
            body, part = np.unravel_index(int(np.argmin(obstacles.bound[node])), obstacles.bound.shape[1:])
            other = obstacles.obstacle_name(int(part))
            _refuse(what, obstacles.bound[node, body, part], params.clearance, bodies.names[body], other)
        if own.bound[node].size:
            pair = int(np.argmin(own.bound[node]))
            one, two = (bodies.names[k] for k in own.pairs[pair])
            _refuse(what, own.bound[node, pair], params.self_clearance, one, two)
    return ends[0], ends[1]


def _refuse(what: str, distance: float, clearance: float, one: str, two: str) -> None:
    if distance < 0:
        raise ConfigurationError(f"{what} is in collision: {one!r} is {-distance * 1000:.1f} mm deep in {two!r}")
    if distance <= clearance:
        raise ConfigurationError(
            f"{what} is too close: {one!r} is {distance * 1000:.1f} mm from {two!r}; "
            f"more than {clearance * 1000:.1f} mm (clearance) are needed"
        )
