"""Approaches: a drive to a pose before a place that the hand is to reach, and from there straight to it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy.typing as npt

from elastic_strips.errors import ConfigurationError, ParameterError
from elastic_strips.robot import RobotModel
from elastic_strips.robot.inverse_kinematics import PoseSolver
from elastic_strips.scene import Scene
from elastic_strips.strip import DeformParams, OrientationConstraint
from elastic_strips.summary import Summary
from elastic_strips.validation import check_array, check_choice

from .goals import HandPose, goal_configurations
from .plan import plan_report
from .problem import Deadline, PlanningProblem
from .report import PlanReport
from .straight import AXES, plan_straight

_MOST_CONFIGURATIONS = 24  # configurations that are tried, at most
_MOST_REASONS = 3  # reasons, at most


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ApproachReport(Summary):
    """How the hand gets to a place.

    Attributes:
        certified: whether there are both strips, and both are certified.
        drive: plan of the strip to where the hand stands before the place; the last one that was tried, or None.
        reach: plan of the hand's straight motion from there to the place. If the last one that was tried is not
            certified, it is that of the motion back, or None.
        reason: what happened, in words.
    """

    certified: bool
    drive: PlanReport | None
    reach: PlanReport | None
    reason: str

    def _summary(self) -> dict[str, object]:
        return {"certified": self.certified, "reason": self.reason}


def plan_approach(
    robot: RobotModel,
    scene: Scene,
    start: npt.ArrayLike,
    places: HandPose | Sequence[HandPose],
    by: npt.ArrayLike,
    *,
    axes: str = "hand",
    beyond: Scene | None = None,
    params: DeformParams | None = None,
    near: DeformParams | None = None,
    constraint: OrientationConstraint | None = None,
    seed: int = 0,
    work: float = 10.0,
    timeout: float = math.inf,
) -> ApproachReport:
    """Plan a drive to a pose before a place, on any side that is free, and the hand's straight way to the place.

    Args:
        robot: the robot, with what it holds.
        scene: the obstacles about the place, without what is to be grasped there.
        start: configuration (nq,).
        places: pose that the hand's frame is to reach, or several poses of the same frame of which any will do.
        by: (3,) the hand's straight motion to the place [m].
        axes: axes of that motion: the hand's own, as it is turned at the place (``"hand"``), or those of the
            ``"world"``.
        beyond: the obstacles while the robot drives, with what is to be grasped; those of ``scene`` where None.
        params: parameters of the drive, with the clearances to prove; as for :func:`plan_report` where None.
        near: parameters of the reach; as for :func:`plan_straight` where None.
        constraint: constraint that the drive has to satisfy, as for :func:`plan_report`.
        seed: seed of random numbers.
        work: largest amount of computing for the drives' plans, as the time [s] that :mod:`elastic_strips.work` models
            for it, so that equal seeds give equal reports on every machine; exceeded by one plan at most.
        timeout: longest time [s], exceeded by one plan at most; reports may then depend on the machine.

    Raises:
        RobotError, SceneError: not a robot, or not a scene; an unknown frame.
        ConfigurationError: the start is not valid, in collision or too close, or does not satisfy the constraint.
        GoalError: no configuration has the hand at a place, or every such configuration touches something.
        ParameterError: no places or places of several frames, unknown axes, ``by`` is not three numbers, or a work or
            timeout that is not positive.
    """
    goals, frame = _of_one_frame(places)
    check_choice("axes", axes, AXES)
    motion = check_array("by", by, (3,))
    solver = PoseSolver(robot, frame)
    beyond = scene if beyond is None else beyond
    deadline = PlanningProblem(  # refuses what is wrong with it
        robot, beyond, start, start, params=params, constraint=constraint, timeout=timeout, work=work
    ).deadline
    drive = reach = None
    reasons: list[str] = []
    found = goal_configurations(
        robot, scene, start, goals, seed=seed, params=near, count=_MOST_CONFIGURATIONS, deadline=deadline
    )
    deadline = Deadline(deadline.time_left, work)
    for k, q in enumerate(found):
        if k and deadline.over():
            reasons.append("no work or time is left")
            break
        turn = solver.place(robot.space.to_coordinates(q)[None])[1][0]
        offset = turn @ motion if axes == "hand" else motion
        reach = plan_straight(robot, scene, q, frame, -offset, params=near)
        if not reach.certified:
            reasons.append(reach.reason)
            continue
        reach, before = _reversed(reach), reach.strip.q[-1]
        left, share = deadline.turn(len(found) - k)
        try:
            drive = plan_report(
                robot, beyond, start, before, params=params, constraint=constraint, seed=seed, work=share, timeout=left
            )
        except ConfigurationError as error:
            reasons.append(f"before the place: {error}")
            continue
        if drive.certified:
            return ApproachReport(True, drive, reach, f"configuration {k + 1} of {len(found)}; {drive.reason}")
        reasons.append(drive.reason)
    said = "; ".join(dict.fromkeys(reasons[-_MOST_REASONS:]))
    return ApproachReport(False, drive, reach, f"none of {len(found)} configurations has a way to it: {said}")


def _of_one_frame(places: HandPose | Sequence[HandPose]) -> tuple[list[HandPose], str]:
    goals = [places] if isinstance(places, HandPose) else list(places)
    frames = {goal.frame for goal in goals if isinstance(goal, HandPose)}
    if len(frames) != 1 or not all(isinstance(goal, HandPose) for goal in goals):
        raise ParameterError("places must be HandPoses of one frame, at least one")
    return goals, frames.pop()


def _reversed(away: PlanReport) -> PlanReport:
    """The plan of the motion to the place, from that of the motion away from it."""
    there = away.strip.reversed()
    return replace(away, strip=there, initial=there, relaxed=replace(away.report, strip=there))
