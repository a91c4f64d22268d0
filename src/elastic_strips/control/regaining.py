"""Regaining: plans that satisfy a constraint from a start, or to a goal, that misses it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from elastic_strips.errors import ConfigurationError
from elastic_strips.planning import BasePose, Goal, PlanReport, find_goals
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import AxisConstraint, DeformParams, Strip
from elastic_strips.strip.constraint import ConstraintForce

from .itinerary import configuration_of

_POSTURES = 3  # that are tried at most
_TURN_SHARE = 0.25  # of the time, for each turn of the joints


def plan_satisfying(
    plan: Callable[..., PlanReport],
    robot: RobotModel,
    scene: Scene,
    start: npt.ArrayLike,
    goal: Goal | Sequence[Goal],
    constraint: AxisConstraint,
    *,
    params: DeformParams,
    timeout: float,
) -> PlanReport:
    """A plan that satisfies a constraint from one end to the other; where an end does not, the joints turn while the
    base stands there, to a posture that does, or from it, and only that turn misses it.

    Args:
        plan: of start and goal, plans among what stands; takes ``timeout`` and ``constraint``.
        robot: the robot.
        scene: what stands.
        start: configuration (nq,).
        goal: configuration (nq,), or any other goal.
        constraint: to satisfy; a place that is looked at is fixed.
        params: of the strip.
        timeout: longest time [s].

    Raises:
        ConfigurationError: an end is not valid, or no posture there satisfies the constraint.
        GoalError: no configuration reaches the goal.
        SceneError: there is no such obstacle.
    """
    force = ConstraintForce(robot, constraint)
    force.find(scene)

    def turned(q: npt.ArrayLike, what: str, *, back: bool) -> tuple[npt.ArrayLike, PlanReport | None]:
        row = robot.space.to_coordinates(robot.check_q(q, what=what))
        off = float(force.errors_at(row[None])[0])
        if off <= constraint.tolerance or not robot.space.planar:  # a plan refuses it, with the angle
            return q, None
        stand = BasePose(*row[:3].tolist())
        found = find_goals(robot, scene, q, stand, constraint=constraint, params=params, count=_POSTURES)
        for posture in found.configurations:
            turn = plan(*((posture, q) if back else (q, posture)), timeout=_TURN_SHARE * timeout)
            if turn.certified:
                return posture, turn
        raise ConfigurationError(f"{what} is {off:.3f} rad off, and the joints do not turn to it there: {found.reason}")

    begin, first = turned(start, "start", back=False)
    goal_q = configuration_of(robot, goal)
    end, last = (goal, None) if goal_q is None else turned(goal_q, "goal", back=True)
    report = plan(begin, end, timeout=timeout, constraint=constraint)
    turns = [each for each in (first, last) if each is not None]
    if not turns or not report.certified:
        return report
    parts = [each.strip for each in (first, report, last) if each is not None]
    rows = np.vstack([parts[0].coordinates, *(part.coordinates[1:] for part in parts[1:])])
    whole = Strip.from_coordinates(robot, rows, ends=np.stack([parts[0].q[0], parts[-1].q[-1]]))
    where = " and ".join(name for name, each in (("start", first), ("goal", last)) if each is not None)
    return replace(
        report, strip=whole, initial=whole, relaxed=None, reason=f"{report.reason}; the joints turn at {where}"
    )
