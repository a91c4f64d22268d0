"""Plan: an initial strip, by the straight line where that relaxes to a certified strip, else by the grid or OMPL.

A given path comes first. The grid's path is tried with the joints in step and with the arm tucked; where that does not
fit, a path is tried on which the whole robot fits. The base is looked for in a box about start and goal, which widens
as attempts fail, or within given bounds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.errors import GoalError, ParameterError, PlanningError
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import AxisConstraint, Deformer, DeformParams, DeformReport, DeformStatus, Strip
from elastic_strips.strip.constraint import ConstraintForce
from elastic_strips.validation import check_count, check_number, named_arguments

from .goal_search import goal_configurations
from .goals import Goal, is_goal_region
from .homotopy.alternatives import AlternativesSearch
from .initial_strip import rows_along
from .leaving import MOST_DEPTH, Departure, joined, leave_contact
from .problem import ARM, Deadline, PlanningProblem, check_kinds, one_configuration, warn_of_floor
from .report import PlanReport
from .search import PlanSearch

_DETOUR_RATIO, _DETOUR_LENGTH = 3.0, 5.0  # a grid's path of more than 3 times the direct one and 5 m [m] waits for OMPL
_SHORTENING_SHARE, _LONGEST_SHORTENING = 0.25, 2.0  # of the time, and most [s], is OMPL's then


@named_arguments
def plan_report(
    robot: RobotModel,
    scene: Scene,
    start: npt.ArrayLike,
    goal: Goal | Sequence[Goal],
    *,
    count: int = 1,
    seed: int = 0,
    params: DeformParams | None = None,
    timeout: float = 10.0,
    work: float | None = None,
    bounds: npt.ArrayLike | None = None,
    deformer: Deformer | None = None,
    line: bool = True,
    path: npt.ArrayLike | None = None,
    grid: bool = True,
    backward: bool = True,
    constraint: AxisConstraint | None = None,
    start_depth: float = 0.0,
    watch: Callable[[DeformReport], object] | None = None,
) -> PlanReport:
    """Plan an initial strip, or several that pass the obstacles on different sides, and report how it went.

    Where several are wanted, the straight line, paths over a grid that differ in class, and paths of OMPL are
    relaxed until there are enough. A fixed base has one class only.

    Args:
        robot: the robot.
        scene: the obstacles, standing still.
        start: configuration (nq,).
        goal: configuration (nq,); or a :class:`HandPose`, a :class:`BasePose`, several of them at once
            (:class:`AllOf`), coordinates or poses by name, or a list of goals of which any will do: then
            :func:`find_goals` finds configurations, and they are planned to in turns, the nearest to the start first,
            until there is a plan.
        count: largest number of strips; with more than one they are the report's ``alternatives``.
        seed: seed of the planner's random numbers.
        params: parameters of the relaxation, with the clearances to prove. Where None, the default preset, which asks
            for no more clearance than half of what start and goal have (the reason says so), and looks less far about
            an arm.
        timeout: longest time [s] for everything; exceeded by at most a tick of the deformer or a step of OMPL.
        work: largest amount of computing for everything, as the time [s] that :mod:`elastic_strips.work` models for it;
            None where only time bounds it. With that and ``timeout=math.inf`` equal seeds give equal plans on every
            machine.
        bounds: corners ((x, y), (x, y)) [m] of a box that the base does not leave. Where None, the base is looked for
            about start and goal, ever wider as attempts fail.
        deformer: a workspace of the same robot to use again; its parameters count, not ``params``.
        line: whether to try the straight line at all.
        path: path to try first: waypoints (K, 2) of the base [m], or coordinate rows (K, nv), from start to goal.
        grid: whether to try a path of :func:`grid_path` before OMPL is asked; there is none for a fixed base.
        backward: whether a differential drive may go along the straight line backwards, where it turns less then. Paths
            over the grid always go forwards; those of OMPL, the last resort, may back up; without ``backward`` only
            where there is no room to turn.
        constraint: constraint that every configuration on the way, between the nodes too, satisfies within its
            tolerance: a hand that stays level (:class:`OrientationConstraint`), or a camera that looks at something
            (:class:`LookAt`); not together with a deformer, which has its own.
        start_depth: a start that touches by at most this much [m] is left along growing distance, and the planned and
            certified strip begins where the robot is free: see ``departure`` of the report, which is then not certified
            as a whole. With 0 such a start is refused. It is for one strip only, without a constraint.
        watch: called with every tick's report.

    Raises:
        RobotError, SceneError: not a robot, or not a scene; a constraint that names an obstacle that is not there.
        ConfigurationError: start or goal is not valid, in collision, too far away or outside the bounds, or does not
            satisfy the constraint; the message names the pair, or the distance.
        GoalError: no configuration reaches the goal, or every such configuration touches something.
        ParameterError: a count, seed, timeout, bounds or start_depth outside their range, or a path of another
            shape.

    Examples:
        >>> robot = es.load_robot("silvermate")
        >>> scene = es.Scene([es.Box((0.6, 0.6, 1.4), at=(1.5, 0.1, 0.7))])
        >>> report = es.plan_report(robot, scene, robot.home(x=-1.0), robot.home(x=4.0))
        >>> report.certified  # and report.reason says why it is not
        True
    """
    count = check_count("count", count, low=1)
    start_depth = check_number("start_depth", start_depth, low=0.0, high=MOST_DEPTH, unit="m")
    asked = deformer.params if isinstance(deformer, Deformer) else params
    plan_anew = partial(
        plan_report,
        robot,
        scene,
        count=count,
        seed=seed,
        params=params,
        bounds=bounds,
        deformer=deformer,
        line=line,
        path=path,
        grid=grid,
        backward=backward,
        constraint=constraint,
        watch=watch,
    )
    if start_depth > 0.0:
        if count > 1 or constraint is not None or (isinstance(deformer, Deformer) and deformer.constraint is not None):
            raise ParameterError(f"start_depth={start_depth:g} is for one strip (count=1) without a constraint")
        check_kinds(robot, scene)
        leaving = asked or (DeformParams() if robot.space.planar else ARM)
        departure = leave_contact(robot, scene, one_configuration(robot, start, "start"), start_depth, leaving)
        if departure is not None:
            report = plan_anew(departure.strip.q[-1], goal, timeout=timeout, work=work)
            return _after(report, departure, deformer or Deformer(robot, leaving))
    if is_goal_region(goal):
        deadline = Deadline(timeout, work)
        own = deformer.constraint if isinstance(deformer, Deformer) else None
        kept = constraint if own is None else own.constraint
        goals = goal_configurations(
            robot, scene, start, goal, seed=seed, params=asked, deadline=deadline, constraint=kept
        )
        goals = _satisfying(robot, scene, goals, kept)
        return _in_turns(partial(plan_anew, start), goals, deadline)
    problem = PlanningProblem(
        robot,
        scene,
        start,
        cast("npt.ArrayLike", goal),
        params=params,
        deformer=deformer,
        bounds=bounds,
        seed=seed,
        timeout=timeout,
        work=work,
        backward=backward,
        constraint=constraint,
    )
    if count > 1:
        report = _several(problem, count, line=line, path=path, grid=grid, watch=watch)
    else:
        report = _one(problem, line=line, path=path, grid=grid, watch=watch)
    warn_of_floor(robot, report.strip.coordinates)
    return report


def _in_turns(plan_to: Callable[..., PlanReport], goals: Array, deadline: Deadline) -> PlanReport:
    """Plan to configurations (K, nq), one after the other, which share the time or the work that is left."""
    report, k = None, 0
    for k, q in enumerate(goals):
        time_left, share = deadline.turn(len(goals) - k)
        report = plan_to(q, timeout=time_left, work=share) if deadline.of_work else plan_to(q, timeout=share)
        if report.certified or deadline.over():
            break
    assert report is not None  # a goal has at least one configuration
    return replace(report, reason=f"{report.reason}; to configuration {k + 1} of {len(goals)} of the goal")


def _one(
    problem: PlanningProblem,
    *,
    line: bool,
    path: npt.ArrayLike | None,
    grid: bool,
    watch: Callable[[DeformReport], object] | None,
) -> PlanReport:
    """One strip: by the given path, the line, the grid or joint space, then OMPL; the first of them that is usable."""
    search = PlanSearch(problem, watch)
    report = search.relaxed(rows_along(problem, path), "path", "given path") if path is not None else None
    if problem.region is None:
        if problem.constraint is not None or problem.robot.nv == 0:
            report = report or search.straight(line)
        report = report or search.of_the_joints()  # whose first look is at the straight line
        return report or search.failed()
    direct = float(np.hypot(*np.diff(problem.region.endpoints, axis=0)[0]))
    longest = _DETOUR_RATIO * direct + _DETOUR_LENGTH
    report = report or search.at_once(longest, line=line, grid=grid) or search.straight(line)
    if report is None and grid:
        report = search.over_the_grid(longest)
        if report is None and search.put_off:  # is there no shorter one that the base alone does not find?
            seconds = min(_SHORTENING_SHARE * problem.deadline.left, _LONGEST_SHORTENING)
            report = search.with_ompl(seconds) or search.over_the_grid(np.inf)
    return report or search.with_ompl() or search.failed()


def _after(report: PlanReport, departure: Departure, deformer: Deformer) -> PlanReport:
    """A plan from where the robot is free, with the way there before it: as a whole it is not certified."""
    first = len(departure.strip) - 1
    whole, initial = joined(departure, report.strip), joined(departure, report.initial)
    assessed = replace(deformer.assess(whole, report.scene), status=DeformStatus.BROKEN)
    left = replace(departure, rest=report.strip if report.certified else None)
    said = "certified" if report.certified else "not certified"
    reason = f"{left}; {said} from node {first} on: {report.reason}"
    return replace(
        report,
        strip=whole,
        initial=initial,
        certified=False,
        reason=reason,
        departure=left,
        relaxed=replace(assessed, reason=reason),
    )


def _satisfying(robot: RobotModel, scene: Scene, goals: Array, constraint: AxisConstraint | None) -> Array:
    """The configurations (K, nq) of a goal that satisfy a constraint, if there is one."""
    if constraint is None:
        return goals
    force = ConstraintForce(robot, constraint)
    force.find(scene)
    off = force.errors_at(robot.space.to_coordinates(goals))
    if off.min() > constraint.tolerance:
        raise GoalError(
            f"goal: none of its {len(goals)} configurations satisfies the constraint: {constraint.frame!r} is at least "
            f"{off.min():.3f} rad off, {constraint.tolerance:g} are allowed (tolerance); a HandPose may say how it is "
            "turned"
        )
    return goals[off <= constraint.tolerance]


def _several(
    problem: PlanningProblem,
    count: int,
    *,
    line: bool,
    path: npt.ArrayLike | None,
    grid: bool,
    watch: Callable[[DeformReport], object] | None,
) -> PlanReport:
    """Several strips that pass the obstacles on different sides."""
    given = None if path is None else rows_along(problem, path)
    search = AlternativesSearch(problem, count, line=line, given=given, grid=grid, watch=watch)
    search.run()
    found = search.alternatives
    if found:
        report, initial = found[0].report, search.initial[found[0].homotopy_class]
    else:
        assert search.best is not None  # the straight line at least was looked at
        report, initial = search.best
    return PlanReport(
        strip=report.strip,
        initial=initial,
        certified=bool(found),
        method=found[0].method if found else "none",
        reason=search.reason,
        scene=problem.scene,
        params=problem.params,
        relaxed=report,
        attempts=search.attempts,
        ticks=search.ticks,
        seconds=problem.deadline.spent,
        timings=search.timings,
        alternatives=found,
        clusters=search.clusters,
    )


@named_arguments
def plan(
    robot: RobotModel,
    scene: Scene,
    start: npt.ArrayLike,
    goal: Goal | Sequence[Goal],
    *,
    seed: int = 0,
    params: DeformParams | None = None,
    timeout: float = 10.0,
    bounds: npt.ArrayLike | None = None,
    constraint: AxisConstraint | None = None,
    start_depth: float = 0.0,
    certified: bool = False,
) -> Strip:
    """An initial strip from ``start`` to ``goal``: the straight line if it relaxes to a certified strip, else the
    grid's or OMPL's path.

    Where none of them gives a certified strip, the best one is returned *as it is*, a warning is logged, and every
    report on it says where it is broken; :func:`plan_report` has the details. With ``certified`` that is an error.

    Args:
        robot, scene, start, goal, seed, params, timeout, bounds, constraint, start_depth: as in :func:`plan_report`;
            the beginning of a strip from a start that touches is not certified, and every report on it says so.
        certified: whether nothing but a certified strip will do.

    Raises:
        RobotError, SceneError, ConfigurationError, GoalError, ParameterError: as :func:`plan_report`.
        PlanningError: with ``certified``, none was found; it has the report.

    Examples:
        >>> robot = es.load_robot("silvermate")
        >>> scene = es.Scene([es.Box((0.6, 0.6, 1.4), at=(1.5, 0.1, 0.7))])
        >>> strip = es.plan(robot, scene, start=robot.home(x=-1.0), goal=robot.home(x=4.0), certified=True)
        >>> by_hand = es.plan(robot, scene, robot.home(x=-1.0), es.HandPose("hand_frame", (3.0, 0.2, 0.8)))
    """
    report = plan_report(
        robot,
        scene,
        start,
        goal,
        seed=seed,
        params=params,
        timeout=timeout,
        bounds=bounds,
        constraint=constraint,
        start_depth=start_depth,
    )
    if certified and not report.certified:
        raise PlanningError(report.reason, report)
    return report.strip
