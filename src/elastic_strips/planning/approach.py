"""Approaches: a drive to before a place that the hand is to reach, straight to it, and what it does from there."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError, ParameterError, RobotError
from elastic_strips.robot import RobotModel
from elastic_strips.robot.inverse_kinematics import PoseSolver
from elastic_strips.scene import Scene
from elastic_strips.strip import AxisConstraint, DeformParams
from elastic_strips.summary import Summary
from elastic_strips.validation import check_array, check_choice, check_number, named_arguments

from .goal_search import goal_configurations
from .goals import HandPose
from .leaving import MOST_DEPTH
from .plan import plan_report
from .problem import Deadline, PlanningProblem
from .report import PlanReport
from .straight import AXES, plan_straight

_MOST_CONFIGURATIONS = 24  # configurations that are tried, at most
_MOST_REASONS = 3  # reasons of each kind, at most
_UNTRIED = "the end of work or time"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ApproachReport(Summary):
    """How the hand gets to a place.

    Attributes:
        certified: whether there are both strips, and all motions after them, and all are certified, but for the way out
            of what touches at the place (``start_depth``): that is the ``departure`` of the first of ``then``.
        drive: plan of the strip to where the hand stands before the place; the last one that was tried, or None.
        reach: plan of the hand's straight motion from there to the place. If the last one that was tried is not
            certified, it is that of the motion back, or None.
        reason: what happened, in words.
        then: plans of the hand's motions after that, in their order; where the last configuration that was tried fails
            at one of them, that one is the last.
        failures: what configurations failed at, with their numbers: the reach, one of the motions after it, or the
            drive.
    """

    certified: bool
    drive: PlanReport | None
    reach: PlanReport | None
    reason: str
    then: tuple[PlanReport, ...] = ()
    failures: Mapping[str, int] = field(default_factory=dict)

    def _summary(self) -> dict[str, object]:
        return {"certified": self.certified, "reason": self.reason}


@named_arguments
def plan_approach(
    robot: RobotModel,
    scene: Scene,
    start: npt.ArrayLike,
    places: HandPose | Sequence[HandPose],
    by: npt.ArrayLike,
    *,
    axes: str = "hand",
    then: npt.ArrayLike = (),
    holding: RobotModel | Callable[[Array], RobotModel] | None = None,
    start_depth: float = 0.0,
    beyond: Scene | None = None,
    params: DeformParams | None = None,
    near: DeformParams | None = None,
    constraint: AxisConstraint | None = None,
    seed: int = 0,
    work: float = 10.0,
    timeout: float = math.inf,
) -> ApproachReport:
    """Plan a drive to a pose before a place, on any side that is free, the hand's straight way to the place, and what
    it is to do from there.

    The configuration at the place is one from which all of it can be done: that the hand gets there does not mean that
    it can lift anything.

    Args:
        robot: the robot, with what it holds.
        scene: the obstacles about the place, without what is to be grasped there.
        start: configuration (nq,).
        places: pose that the hand's frame is to reach, or several poses of the same frame of which any will do.
        by: (3,) the hand's straight motion to the place [m].
        axes: axes of that motion: the hand's own, as it is turned at the place (``"hand"``), or those of the
            ``"world"``.
        then: (3,) the hand's straight motion after that [m] in the world's axes, such as a lift; or several (K, 3), one
            after the other.
        holding: the robot with what it holds in these motions, or a function of the configuration (nq,) at the place
            that gives it, such as ``lambda q: robot.attached(can, frame, q=q)``; ``robot`` where None.
        start_depth: what touches at the place by at most this much [m], as a can on a table does, is left by the first
            of these motions along growing distance: see :func:`plan_straight`. That part is certified for ``robot``
            alone, without what it holds. With 0 such a configuration does not count.
        beyond: the obstacles while the robot drives, with what is to be grasped; those of ``scene`` where None.
        params: parameters of the drive, with the clearances to prove; as for :func:`plan_report` where None.
        near: parameters of the reach and of the motions after it; as for :func:`plan_straight` where None.
        constraint: constraint that the drive has to satisfy, as for :func:`plan_report`.
        seed: seed of random numbers.
        work: largest amount of computing for the drives' plans, as the time [s] that :mod:`elastic_strips.work` models
            for it, so that equal seeds give equal reports on every machine; exceeded by one plan at most.
        timeout: longest time [s], exceeded by one plan at most; reports may then depend on the machine.

    Raises:
        RobotError, SceneError: not a robot, or not a scene; an unknown frame; ``holding`` has other joints.
        ConfigurationError: the start is not valid, in collision or too close, or does not satisfy the constraint.
        GoalError: no configuration has the hand at a place, or every such configuration touches something.
        ParameterError: no places or places of several frames, unknown axes, ``by`` or ``then`` is not three numbers, or
            a start_depth, work or timeout outside its range.
    """
    goals, frame = _of_one_frame(places)
    check_choice("axes", axes, AXES)
    motion = check_array("by", by, (3,))
    after = _After(robot, scene, frame, then, holding, start_depth, near)
    solver = PoseSolver(robot, frame)
    beyond = scene if beyond is None else beyond
    deadline = PlanningProblem(  # refuses what is wrong with it
        robot, beyond, start, start, params=params, constraint=constraint, timeout=timeout, work=work
    ).deadline
    drive = reach = None
    done: tuple[PlanReport, ...] = ()
    reasons: dict[str, list[str]] = {}
    found = goal_configurations(
        robot, scene, start, goals, seed=seed, params=near, count=_MOST_CONFIGURATIONS, deadline=deadline
    )
    deadline = Deadline(deadline.time_left, work)
    for k, q in enumerate(found):
        if k and deadline.over():
            reasons.setdefault(_UNTRIED, []).extend(["not tried"] * (len(found) - k))
            break
        turn = solver.place(robot.space.to_coordinates(q)[None])[1][0]
        offset = turn @ motion if axes == "hand" else motion
        reach = plan_straight(robot, scene, q, frame, -offset, params=near)
        if not reach.certified:
            reasons.setdefault("the reach", []).append(reach.reason)
            continue
        done, failed = after.plans(q)
        if failed:
            reasons.setdefault(failed[0], []).append(failed[1])
            continue
        reach, before = _reversed(reach), reach.strip.q[-1]
        left, share = deadline.turn(len(found) - k)
        try:
            drive = plan_report(
                robot, beyond, start, before, params=params, constraint=constraint, seed=seed, work=share, timeout=left
            )
        except ConfigurationError as error:
            reasons.setdefault("the drive", []).append(f"before the place: {error}")
            continue
        if drive.certified:
            failed = f" (of those before it {_counted(reasons, why=False)})" if reasons else ""
            said = f"configuration {k + 1} of {len(found)}{failed}; {drive.reason}"
            return ApproachReport(True, drive, reach, said, done, {what: len(why) for what, why in reasons.items()})
        reasons.setdefault("the drive", []).append(drive.reason)
    said = f"none of {len(found)} configurations has a way to it: {_counted(reasons)}"
    return ApproachReport(False, drive, reach, said, done, {what: len(why) for what, why in reasons.items()})


class _After:
    """The hand's motions from the place on."""

    def __init__(
        self,
        robot: RobotModel,
        scene: Scene,
        frame: str,
        then: npt.ArrayLike,
        holding: RobotModel | Callable[[Array], RobotModel] | None,
        start_depth: float,
        params: DeformParams | None,
    ) -> None:
        given = np.asarray(then, dtype=object)
        count = len(given) if given.ndim == 2 else min(given.size, 1)
        shape = (3,) if given.ndim == 1 and given.size else (count, 3)
        rows = check_array("then", then, shape) if given.size else np.zeros((0, 3))
        self.motions: Array = rows.reshape(-1, 3)
        self.robot, self.scene, self.frame, self.holding, self.params = robot, scene, frame, holding, params
        self.start_depth: float = check_number("start_depth", start_depth, low=0.0, high=MOST_DEPTH, unit="m")
        if not (holding is None or isinstance(holding, RobotModel) or callable(holding)):
            raise ParameterError(
                f"holding is a {type(holding).__name__}; it must be a robot, a function of a configuration, or None"
            )
        if holding is not None and not len(self.motions):
            raise ParameterError("holding is for the motions of then=…, and there are none")

    def plans(self, q: Array) -> tuple[tuple[PlanReport, ...], tuple[str, str] | None]:
        """The plans from a configuration (nq,) at the place on; and the motion that fails, and why, or None."""
        plans: list[PlanReport] = []
        robot = self.robot
        for k, by in enumerate(self.motions):
            x, y, z = by
            what = f"then {k + 1} of {len(self.motions)}, by ({x:g}, {y:g}, {z:g}) m"
            if k == 0:
                try:
                    robot = self._held(q)
                except ConfigurationError as error:
                    return (), (what, str(error))
            depth = self.start_depth if k == 0 else 0.0
            plan = partial(plan_straight, scene=self.scene, start=q, frame=self.frame, by=by, params=self.params)
            report = plan(robot, start_depth=depth)
            plans.append(report)
            if report.departure is not None and report.departure.rest is not None:
                alone = plan(self.robot)
                if not alone.certified:
                    return tuple(plans), (what, f"what leaves contact is the robot itself: {alone.reason}")
            elif not report.certified:
                return tuple(plans), (what, report.reason)
            q = report.strip.q[-1]
        return tuple(plans), None

    def _held(self, q: Array) -> RobotModel:
        holding = self.robot if self.holding is None else self.holding
        held = holding if isinstance(holding, RobotModel) else holding(q)
        if not isinstance(held, RobotModel) or held.joint_names != self.robot.joint_names:
            what = f"the robot {held.name!r}" if isinstance(held, RobotModel) else f"a {type(held).__name__}"
            raise RobotError(
                f"holding gives {what}; it must be {self.robot.name!r} with what it holds, of the same joints"
            )
        return held


def _counted(reasons: Mapping[str, Sequence[str]], *, why: bool = True) -> str:
    """What configurations failed at, with their numbers, and the last reasons of each."""
    return "; ".join(
        f"{len(each)} failed at {what}" + (f" ({'; '.join(dict.fromkeys(each[-_MOST_REASONS:]))})" if why else "")
        for what, each in reasons.items()
    )


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
