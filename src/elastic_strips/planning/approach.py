"""Approaches: a drive to before a place that the hand is to reach, straight to it, and what it does from there."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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

from .goal_search import goal_turns
from .goals import HandPose
from .leaving import MOST_DEPTH
from .plan import plan_report
from .problem import PlanningProblem
from .report import PlanReport
from .straight import AXES, plan_straight, straight_lines
from .validity import ValidityChecker

_WANTED = 24  # configurations that are looked for before the first is tried
_MOST_CONFIGURATIONS, _MOST_PLANNED = 400, 32  # that are looked at, and from which motions are planned in vain, at most
_TOGETHER = 16  # configurations that are looked at together
_MOST_REASONS = 3  # reasons of each kind, at most
_QUICK_DRIVE, _QUICK_SHARE = 0.5, 0.3  # [s] of work that a drive gets at first, and the part of all work for such
_REACH, _DRIVE = "the reach", "the drive"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ApproachReport(Summary):
    """How the hand gets to a place.

    Attributes:
        certified: whether there are both strips, and all motions after them, and all are certified, but for the way out
            of what touches at the place (``start_depth``): that is the ``departure`` of the first of ``then``.
        drive: plan of the strip to where the hand stands before the place; the last one that was tried, or None.
        reach: plan of the hand's straight motion from there to the place. If the last one that was planned is not
            certified, it is that of the motion back, or None.
        reason: what happened, in words.
        then: plans of the hand's motions after that, in their order; where the last configuration from which they were
            planned fails at one of them, that one is the last.
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
    it can lift anything. Of each of the places configurations are looked for where a way of the base leads; they are
    tried in turns, first with little work for the drive, and while none will do more are looked for. Among furniture
    many places are needed, from around and from above (:meth:`HandPose.around`).

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
    beyond = scene if beyond is None else beyond
    deadline = PlanningProblem(  # refuses what is wrong with it
        robot, beyond, start, start, params=params, constraint=constraint, timeout=timeout, work=work
    ).deadline
    plan_drive = partial(plan_report, robot, beyond, start, params=params, constraint=constraint, seed=seed)
    enough = (1.0 - _QUICK_SHARE) * deadline.left
    reasons: dict[str, list[str]] = {}
    report = ApproachReport(False, None, None, "")
    put_off: list[tuple[int, ApproachReport]] = []  # with the drive's place among the reasons
    tried = in_vain = 0

    def finished(report: ApproachReport) -> ApproachReport:
        said = f"none of {tried} configurations has a way to it: {_counted(reasons)}"
        if report.certified:
            assert report.drive is not None
            others = f" (of {tried} {_counted(reasons, why=False)})" if any(reasons.values()) else ""
            said = f"from a configuration all of it can be done{others}; {report.drive.reason}"
        return replace(report, reason=said, failures={what: len(why) for what, why in reasons.items() if why})

    look = _Look(robot, scene, beyond, frame, motion, axes, after, near, params)
    turns = goal_turns(robot, scene, start, goals, seed=seed, params=near, count=_WANTED, deadline=deadline)
    for q, offset, hopeless in look.at_each(turns):
        if tried == _MOST_CONFIGURATIONS or in_vain == _MOST_PLANNED or (tried and deadline.over()):
            break
        if put_off and deadline.left < enough:
            break
        tried += 1
        if hopeless and len(reasons.get(hopeless, ())) >= _MOST_REASONS:
            reasons[hopeless].append("")
            continue
        away = plan_straight(robot, scene, q, frame, -offset, params=near)
        if not away.certified:
            in_vain += 1
            report = replace(report, reach=away)
            reasons.setdefault(_REACH, []).append(away.reason)
            continue
        done, failed = after.plans(q)
        report = replace(report, reach=_reversed(away), then=done)
        if failed:
            in_vain += 1
            reasons.setdefault(failed[0], []).append(failed[1])
            continue
        time, most = deadline.turn(1)
        try:
            report = replace(report, drive=plan_drive(away.strip.q[-1], work=min(_QUICK_DRIVE, most), timeout=time))
        except ConfigurationError as error:
            reasons.setdefault(_DRIVE, []).append(f"before the place: {error}")
            continue
        assert report.drive is not None
        if report.drive.certified:
            return finished(replace(report, certified=True))
        reasons.setdefault(_DRIVE, []).append(report.drive.reason)
        put_off.append((len(reasons[_DRIVE]) - 1, report))
    for k, (n, before) in enumerate(put_off):
        if deadline.over():
            break
        time, most = deadline.turn(len(put_off) - k)
        assert before.reach is not None
        report = replace(before, drive=plan_drive(before.reach.strip.q[0], work=most, timeout=time))
        assert report.drive is not None
        if report.drive.certified:
            del reasons[_DRIVE][n]
            return finished(replace(report, certified=True))
        reasons[_DRIVE][n] = report.drive.reason
    return finished(report)


class _Look:
    """A look at what the hand is to do, for many configurations at once, before any of it is planned."""

    def __init__(
        self,
        robot: RobotModel,
        scene: Scene,
        beyond: Scene,
        frame: str,
        motion: Array,
        axes: str,
        after: _After,
        near: DeformParams | None,
        params: DeformParams | None,
    ) -> None:
        self._robot, self._motion, self._axes, self._after = robot, motion, axes, after
        self._solver = PoseSolver(robot, frame)
        self._valid, self._before = (
            ValidityChecker(robot, world, margin=margin, self_margin=own)
            for world, margin, own in ((scene, *_clearances(near)), (beyond, *_clearances(params)))
        )

    def at_each(self, turns: Iterable[Array]) -> Iterator[tuple[Array, Array, str]]:
        """Each configuration (nq,), the hand's motion to there (3,) in the world, and what cannot be planned from
        there, or empty."""
        for found in turns:
            for k in range(0, len(found), _TOGETHER):
                some = found[k : k + _TOGETHER]
                offsets, failed = self._some(some)
                for n, q in enumerate(some):
                    yield q, offsets[n], failed[n]

    def _some(self, q: Array) -> tuple[Array, list[str]]:
        """Motions (N, 3) to configurations (N, nq), and what fails there."""
        rows, solver = self._robot.space.to_coordinates(q), self._solver
        turn = solver.place(rows)[1].copy()
        offsets = turn @ self._motion if self._axes == "hand" else np.tile(self._motion, (len(q), 1))
        failed = [""] * len(q)
        for k, by in enumerate((None, *self._after.motions)):
            going = np.array([n for n in range(len(q)) if not failed[n]], dtype=int)
            if len(going) == 0:
                break
            way = -offsets[going] if by is None else np.tile(by, (len(going), 1))
            lines, steps = straight_lines(solver, rows[going], way)
            most, what = lines.shape[1] - 1, _REACH if by is None else self._after.name(k - 1)
            for n, line, got in zip(going.tolist(), lines, steps.tolist(), strict=True):
                if got < most or (by is None and not self._valid.each(line).all()):
                    failed[n] = what
                elif by is None and not self._before.at(line[-1]):
                    failed[n] = _DRIVE
            if by is not None:
                rows[going] = lines[:, -1]
        self._valid.count()
        self._before.count()
        return offsets, failed


def _clearances(params: DeformParams | None) -> tuple[float, float]:
    """What has to be kept to obstacles and between the robot's own links, at least [m]."""
    return (0.0, 0.0) if params is None else (params.clearance, params.self_clearance)


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

    def name(self, k: int) -> str:
        """A motion in words."""
        x, y, z = self.motions[k]
        return f"then {k + 1} of {len(self.motions)}, by ({x:g}, {y:g}, {z:g}) m"

    def plans(self, q: Array) -> tuple[tuple[PlanReport, ...], tuple[str, str] | None]:
        """The plans from a configuration (nq,) at the place on; and the motion that fails, and why, or None."""
        plans: list[PlanReport] = []
        robot = self.robot
        for k, by in enumerate(self.motions):
            what = self.name(k)
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
    said = []
    for what, each in reasons.items():
        if not each:
            continue
        last = dict.fromkeys([reason for reason in each if reason][-_MOST_REASONS:])
        said.append(f"{len(each)} failed at {what}" + (f" ({'; '.join(last)})" if why else ""))
    return "; ".join(said)


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
