"""Replanning: when a strip has to be replanned, and how; alternative strips.

What decides runs in the control loop, what plans beside it, one task after the other: requests go one way, values come
back.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from elastic_strips.errors import ConfigurationError, ElasticStripsError, GoalError, SceneError
from elastic_strips.planning import (
    Goal,
    PlanReport,
    StripSet,
    StripSetParams,
    StripSetReport,
    check_endpoints,
    plan_report,
)
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Obstacle, Scene
from elastic_strips.strip import DeformParams, Strip

from .itinerary import faced
from .params import DriveParams
from .regaining import plan_satisfying
from .strip_timer import PlanResult

_log = logging.getLogger(__name__)
_STATIC_SPEED = 0.05  # [m/s] slower obstacles count as static for a planner
_BLOCKING_SPEED = 0.3  # [m/s] slower obstacles block a path for other strips; faster ones have soon passed
_FIRST_TIMEOUT, _WAITING_TIMEOUT = 10.0, 4.0  # [s] of the first plan, and of those for which the robot waits
_ANY_WAY_TIMEOUT = 8.0  # [s] of a plan to a goal in any way to be there: these are looked for, too
_FAMILY_TIMEOUT = 2.0  # [s] of a plan of further strips
_BERTH_STEP, _MOST_BERTH = 0.2, 0.6
"""Additional distance [m] from obstacles that stand but can move: per further plan, and at most."""
_BACKWARD_ALLOWED, _BACKS_OUT = 0.25, 0.8
"""So far [m] a robot that sees only ahead may go backwards in all: strips give way by as much about a turn; and where a
plan without that came to nothing."""
_DRIVEN_ON = 4.0  # [s] for which a strip has to be whole while the robot moves, so that plans count anew from there
_FAMILY_EVERY = 5  # planning ticks from one tick of the other strips to the next


@dataclass(frozen=True, slots=True, eq=False)
class PlanRequest:
    """What a strip is planned for.

    Attributes:
        scene: the obstacles.
        start: configuration (nq,).
        goal: configuration (nq,), or any other goal.
        deform: parameters of the strip.
        path: waypoints (K, 2) [m] that are tried first, or None.
        attempt: how many plans have been made since a strip was last driven for a while.
        why: why the last strip is given up.
        unused: whether nobody has driven what was planned last.
        tries: how many first strips to a goal came to nothing before: other configurations are looked for then.
        otherwise: a goal to plan to where there is no way to that one.
    """

    scene: Scene
    start: npt.ArrayLike
    goal: Goal | Sequence[Goal]
    deform: DeformParams
    path: npt.ArrayLike | None = None
    attempt: int = 0
    why: str = ""
    unused: bool = False
    tries: int = 0
    otherwise: Goal | Sequence[Goal] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Replanned:
    """The outcome of replanning: the strip, or None, and the reason; whether there are no others to it."""

    strip: Strip | None
    reason: str
    lone: bool = False


class StripPlanner:
    """Plans strips among what stands, beside the control loop; moving obstacles are left to the deformation.

    Args:
        robot: the robot.
        params: parameters of the drive.
        seed: seed of the planner.
        grid: whether a path over a grid may be used.
    """

    def __init__(self, robot: RobotModel, params: DriveParams, *, seed: int, grid: bool) -> None:
        self.robot: RobotModel = robot
        self.params: DriveParams = params
        self.seed: int = seed
        self.grid: bool = grid

    def first(self, asked: PlanRequest) -> PlanReport:
        """Plan the first strip to a goal.

        Raises:
            ConfigurationError: start or goal is not valid, or in collision.
            GoalError: no configuration that is free reaches the goal.
        """
        here = self.robot.space.to_coordinates(self.robot.check_q(asked.start, what="start"))
        turned, seed = faced(self.robot, here, asked.goal), self.seed + asked.tries
        if turned is not asked.goal:
            with suppress(GoalError):  # turned like that, it touches something
                return self._planned(standing(asked.scene), replace(asked, goal=turned), seed, _FIRST_TIMEOUT)
        return self._planned(standing(asked.scene), asked, seed, _FIRST_TIMEOUT)

    def onward(self, asked: PlanRequest) -> PlanReport:
        """Plan a strip from one goal to the next, before the robot is there; see :meth:`first`."""
        return StripPlanner.first(self, asked)

    def another(self, asked: PlanRequest) -> Replanned:
        """Plan another strip.

        Obstacles that stand but can move are passed at a larger distance, or on another side, where there is room.
        """
        berth = min(_BERTH_STEP * asked.attempt, _MOST_BERTH)
        scene, still, reason = asked.scene, standing(asked.scene), ""
        mobile = [o for o in still if scene.obstacle(o.name or "").motion is not None] if berth else []
        widths = (berth, 0.5 * berth, 0.0) if mobile else (0.0,)
        seed = self.seed + asked.attempt + 1
        tries = [(width, asked, _WAITING_TIMEOUT / len(widths)) for width in widths]
        if asked.otherwise is not None:
            tries.append((0.0, replace(asked, goal=asked.otherwise), _ANY_WAY_TIMEOUT))
        for width, request, timeout in tries:
            around = Scene([*still, *(_around(o, width) for o in mobile)], time=still.time) if width else still
            try:
                report = self._planned(around, request, seed, timeout, line=False)
            except ElasticStripsError as error:
                reason = f"failed: {error}"
                continue
            if report.certified:
                return Replanned(report.strip, report.reason)
            reason = report.walled_in or report.reason
        return Replanned(None, reason)

    def _planned(self, scene: Scene, asked: PlanRequest, seed: int, timeout: float, *, line: bool = True) -> PlanReport:
        """A plan with the clearance that was asked for; from where the robot stands nearer to something than that, as
        one does that has braked, one with the tracking error alone.

        What was not seen counts as free, for it will be seen before the robot is there, or be in the way of its
        motions; in every second plan it is in the way from the beginning.
        """
        seen = scene.seen
        if len(seen) < len(scene) and asked.attempt % 2:  # looking did not help: around it
            timeout *= 0.5
            with suppress(ElasticStripsError):
                report = self._planned_among(scene, asked, seed, timeout, line=line)
                if report.certified:
                    return report
        return self._planned_among(seen, asked, seed, timeout, line=line)

    def _planned_among(
        self, scene: Scene, asked: PlanRequest, seed: int, timeout: float, *, line: bool = True
    ) -> PlanReport:
        """See :meth:`_planned`."""
        try:
            return self._satisfying(scene, asked, seed, timeout, line=line)
        except ConfigurationError as error:
            if not self._too_close(scene, asked.start, asked.deform):
                raise
            nearer = asked.deform.replaced(clearance=max(asked.deform.clearance - self.params.margin, 0.0))
            try:
                report = self._satisfying(scene, replace(asked, deform=nearer), seed, timeout, line=line)
            except ElasticStripsError:
                raise error from None
            if self._too_close(scene, report.strip.q[-1], asked.deform):
                raise
            return replace(report, reason=f"{report.reason}; with {1e3 * nearer.clearance:.0f} mm, as {error}")

    def _too_close(self, scene: Scene, q: npt.ArrayLike, deform: DeformParams) -> bool:
        """Whether a configuration is nearer to something than the strip is to be."""
        try:
            check_endpoints(self.robot, scene, q, q, deform)
        except ConfigurationError:
            return True
        return False

    def _satisfying(
        self, scene: Scene, asked: PlanRequest, seed: int, timeout: float, *, line: bool = True
    ) -> PlanReport:
        """A plan that satisfies the drive's constraint; where there is none, one that does not, and says so."""
        report = self._plan(scene, asked, seed, timeout, line=line)
        back = 0.0 if self.params.backward or not report.certified else _backed_up(report.strip)
        if back <= (_BACKS_OUT if asked.attempt else _BACKWARD_ALLOWED):
            return report
        why = f"the only way that was found leads {back:.2f} m backwards, where the robot does not see (backward=False)"
        return replace(report, certified=False, reason=why)

    def _plan(self, scene: Scene, asked: PlanRequest, seed: int, timeout: float, *, line: bool) -> PlanReport:
        """See :meth:`_satisfying`, whichever way it leads."""
        plan = partial(
            plan_report,
            self.robot,
            scene,
            seed=seed,
            params=asked.deform,
            path=asked.path,
            line=line,
            grid=self.grid,
            backward=self.params.backward,
        )
        constraint = self.params.constraint
        if constraint is None:
            return plan(asked.start, asked.goal, timeout=timeout)
        try:  # what moves is not among what stands, but is looked at where it is
            report = plan_satisfying(
                plan,
                self.robot,
                scene,
                asked.start,
                asked.goal,
                constraint.in_scene(asked.scene),
                params=asked.deform,
                timeout=0.5 * timeout,
            )
        except (ConfigurationError, SceneError) as error:  # start or goal does not satisfy it, or is wrong for both
            why = str(error)
        else:
            if report.certified:
                return report
            why = report.reason
        report = plan(asked.start, asked.goal, timeout=0.5 * timeout)
        return replace(report, reason=f"{report.reason}; it does not satisfy the constraint, for: {why}")


class Replanner:
    """Workspace: watches the strip in the control loop, and decides when to give it up for another one.

    It hands out the plans that are due, as functions to be run beside the loop, one after the other, and is told which
    of their results are used.

    Args:
        robot: the robot.
        params: of the drive.
        seed: of the planner.
        grid: whether a path over a grid may be used.
        planner: plans the strips; a :class:`StripPlanner` where None.

    Attributes:
        halted: whether the robot has to stop because static obstacles keep the strip broken.
        no_way: why the last plan found none; empty where it did, or the strip is whole again.
        pending: whether another plan is due, and not taken yet.
        due: time [s] from which on the plan may be used.
        count: number of plans after the first.
        attempts: number of those since a strip was last driven for a while.
        deform: parameters of the strips that are planned.
    """

    pending: bool
    halted: bool
    flows: bool = True
    """Whether the robot may go on from one goal to the next without a stop."""

    def __init__(
        self, robot: RobotModel, params: DriveParams, *, seed: int, grid: bool, planner: StripPlanner | None = None
    ) -> None:
        self.planner: StripPlanner = planner or StripPlanner(robot, params, seed=seed, grid=grid)
        self.params: DriveParams = params
        self.deform: DeformParams = params.strip
        self.halted = self.pending = False
        self.due: float = 0.0
        self.count: int = 0
        self.attempts: int = 0
        self._since: float | None = None
        self._whole_since = np.inf  # [s] since when the strip is whole, and the robot moves along it
        self.no_way: str = ""
        self._why = ""
        self._unused = False
        self._tries = 0  # first strips since the one that is followed

    def first(
        self, scene: Scene, start: npt.ArrayLike, goal: Goal | Sequence[Goal], *, path: npt.ArrayLike | None = None
    ) -> Callable[[], PlanReport]:
        """A function that plans the first strip to a goal; see :meth:`StripPlanner.first`.

        Args:
            scene: the obstacles.
            start: configuration (nq,).
            goal: configuration (nq,), or any other goal.
            path: waypoints (K, 2) [m] that are tried first.
        """
        self.pending, self.no_way = False, ""  # what was given up leads to another goal
        asked = PlanRequest(scene, start, goal, self.deform, path, tries=self._tries)
        self._tries += 1
        return partial(self.planner.first, asked)

    def begin(self, report: PlanReport) -> None:
        """Told of the first strip to a goal: it is followed from now on."""
        self._tries = 0

    def onward(self, scene: Scene, start: npt.ArrayLike, goal: Goal | Sequence[Goal]) -> Callable[[], PlanReport]:
        """A function that plans a strip from one goal to the next, before the robot is there; the present strip stays.

        Args:
            scene: the obstacles.
            start: configuration (nq,) at the one goal.
            goal: the next one.
        """
        return partial(self.planner.onward, PlanRequest(scene, start, goal, self.deform))

    def demand(self, at: float) -> None:
        """Have another strip planned, which may be used from the time ``at`` [s] on."""
        self.pending, self.due = True, at

    def watch(self, t: float, result: PlanResult, scene: Scene, *, at_rest: bool) -> str:
        """Check the strip of a tick.

        A strip that static obstacles keep broken is given up after a while, and the robot stops for it; so is one
        without a certified motion while the robot stands. Moving obstacles are waited for.

        Args:
            t: time [s].
            result: result of the tick.
            scene: the scene that it was planned with.
            at_rest: whether the robot stands.

        Returns:
            Why another strip is to be planned, or "".
        """
        broken = result.report.certificate.broken
        by_standing = broken is not None and not scene.moves(broken.obstacle)
        self._whole_since = np.inf if by_standing or at_rest or not result.accepted else min(self._whole_since, t)
        if t - self._whole_since > _DRIVEN_ON:
            self.attempts = 0
        if not by_standing and (result.accepted or not at_rest):
            self._since, self.halted, self.no_way = None, False, ""
            return ""
        if self._since is None:
            self._since = t
        if t - self._since <= self.params.replan_after * (1 + self.attempts):
            return ""
        self.halted = by_standing
        if not at_rest and not by_standing:
            return ""
        self._since, self.pending, self.due = None, True, t + self.params.replan_time
        self._why = f"the strip is broken: {broken}" if by_standing else result.reason
        return self._why

    def another(
        self,
        scene: Scene,
        start: npt.ArrayLike,
        goal: Goal | Sequence[Goal],
        otherwise: Goal | Sequence[Goal] | None = None,
    ) -> Callable[[], Replanned]:
        """A function that plans another strip; see :meth:`StripPlanner.another`.

        Args:
            scene: the obstacles.
            start: configuration (nq,).
            goal: configuration (nq,), or any other goal.
            otherwise: a goal to plan to where there is no way to that one, or None.
        """
        asked = PlanRequest(
            scene,
            start,
            goal,
            self.deform,
            attempt=self.attempts,
            why=self._why,
            unused=self._unused,
            otherwise=otherwise,
        )
        self.count += 1
        self.attempts += 1
        self._unused = False
        return partial(self.planner.another, asked)

    def take(self, found: Replanned) -> None:
        """Told that the plan that was due is there, and its strip, if it has one, is followed."""
        self.pending = False
        self._found(found)

    def discard(self, found: Replanned) -> None:
        """Told that a plan is not used, because the robot does not stand where it begins: it does not count."""
        self._found(found)
        self.count -= 1
        self.attempts = max(self.attempts - 1, 0)
        self._unused = True

    def _found(self, found: Replanned) -> None:
        self.no_way = "" if found.strip is not None else found.reason
        if found.strip is not None:
            self.halted = False

    def work_beside(self, scene: Scene, strip: Strip, submit: Callable[[Callable[[], object]], Future[object]]) -> None:
        """Have more computed beside the control loop, where there is more to compute; called in every tick.

        Args:
            scene: of the tick.
            strip: that is followed.
            submit: runs a function beside the control loop.
        """


def _backed_up(strip: Strip) -> float:
    """How far [m] the base goes backwards along a strip."""
    rows = strip.coordinates
    return float(-np.minimum(strip.robot.space.difference(rows[:-1], rows[1:])[:, 0], 0.0).sum())


def standing(scene: Scene, below: float = _STATIC_SPEED) -> Scene:
    """The scene without its moving obstacles: those slower than ``below`` [m/s], as static ones."""
    still = [o for o in scene if o.motion is None or np.linalg.norm(o.velocity()[0]) < below]
    return Scene([o.observed(o.pose, None) for o in still], time=scene.time)


def _around(obstacle: Obstacle, width: float) -> Obstacle:
    """An upright box about an obstacle, wider than it by ``width`` [m] on every side."""
    rotation, shift = obstacle.pose[:3, :3], obstacle.pose[:3, 3]
    centre = np.array([rotation @ part.center + shift for part in obstacle.parts])
    half = np.array([np.abs(rotation) @ part.half_extents for part in obstacle.parts])
    low, high = (centre - half).min(axis=0), (centre + half).max(axis=0)
    size = high - low + 2.0 * width * np.array([1.0, 1.0, 0.0])
    return Box(size, at=0.5 * (low + high), name=f"about {obstacle.name}")


class SwitchingPlanner(StripPlanner):
    """Workspace: keeps strips on different sides of the obstacles, and plans where none of them is free.

    Args:
        robot, params, seed, grid: as of :class:`StripPlanner`.
        family: parameters of the set of strips.

    Attributes:
        family: the strips; None before the first plan.
    """

    def __init__(
        self, robot: RobotModel, params: DriveParams, *, seed: int, grid: bool, family: StripSetParams | None = None
    ) -> None:
        super().__init__(robot, params, seed=seed, grid=grid)
        self.family: StripSet | None = None
        # planners are called at rest only, and a robot at rest can turn on the spot: no strip is left behind
        self._kept = replace(family or StripSetParams(), plan_every=0, divergence_angle=np.pi)
        self._change = ""

    def first(self, asked: PlanRequest) -> PlanReport:
        """Plan several strips and return the cheapest; where there are none, as :meth:`StripPlanner.first`."""
        first = super().first(asked)
        constraint = self.params.constraint
        try:
            constraint = None if constraint is None else constraint.in_scene(asked.scene)
        except SceneError:  # what is not there yet is looked at once it is
            constraint = None
        self.family = StripSet(
            self.robot,
            first.strip.q[-1],
            params=self._kept,
            deform=asked.deform,
            seed=self.seed,
            constraint=constraint,
        )
        try:
            found = self.family.plan(standing(asked.scene, _BLOCKING_SPEED), asked.start)
        except ConfigurationError:  # something slow blocks start or goal, and may go away
            return first
        best = found.best
        if best is None or not found.certified:
            return first
        reason = f"{found.events[0] if found.events else 'planned'}; {first.reason}"
        return replace(
            first,
            strip=best.strip,
            initial=best.strip,
            certified=True,
            method=best.method,
            reason=reason,
            relaxed=best.report,
        )

    def another(self, asked: PlanRequest) -> Replanned:
        """One of the other strips, or else another plan."""
        if self.family is not None:
            try:
                found = self._other(self.family, asked)
            except ElasticStripsError as error:
                return Replanned(None, f"failed: {error}")
            if found.best is not None:
                return Replanned(found.best.strip, found.events[-1])
        planned = super().another(asked)
        return replace(planned, lone=planned.strip is not None and self.family is not None)

    def _other(self, family: StripSet, asked: PlanRequest) -> StripSetReport:
        """The strip that was changed to last where nobody has driven it, or another one."""
        scene = standing(asked.scene, _BLOCKING_SPEED)
        if asked.unused:
            found = family.step(scene, asked.start, decide=False)
            if found.certified:
                return replace(found, events=(*found.events, self._change))
        found = family.leave(scene, asked.start, asked.why)
        self._change = found.events[-1]
        return found

    def step_others(self, scene: Scene, start: npt.ArrayLike, *, plan: bool) -> int:
        """Deform the strips, or plan others to the one that is driven; returns how many there are.

        Args:
            scene: the obstacles.
            start: configuration (nq,) of the robot.
            plan: whether others are planned.
        """
        if self.family is None:
            return 0
        still = standing(scene, _BLOCKING_SPEED)
        if plan:
            with suppress(ElasticStripsError):
                self.family.plan(still, start, timeout=_FAMILY_TIMEOUT)
        else:
            self.family.step(still, start, decide=False)
        return len(self.family)


class SwitchingReplanner(Replanner):
    """Workspace: a replanner whose planner keeps strips on different sides of the obstacles and deforms them, too.

    The robot follows the cheapest. When its strip is given up and the robot stands, it follows the cheapest of the
    others that is certified from there; where there is none, another one is planned.

    Args:
        robot, params, seed, grid: as of :class:`Replanner`.
        family: parameters of the set of strips.
    """

    flows = False  # its strips lead to one goal

    def __init__(
        self, robot: RobotModel, params: DriveParams, *, seed: int, grid: bool, family: StripSetParams | None = None
    ) -> None:
        others = SwitchingPlanner(robot, params, seed=seed, grid=grid, family=family)
        super().__init__(robot, params, seed=seed, grid=grid, planner=others)
        self._others = others
        self._strips = 0  # how many there were at the last count
        self._ticks = 0
        self._lone = False  # whether there are no others to the one that was planned
        self._beside: Future[object] | None = None  # the step of the family that runs beside the ticks

    def watch(self, t: float, result: PlanResult, scene: Scene, *, at_rest: bool) -> str:
        """See :meth:`Replanner.watch`."""
        due = super().watch(t, result, scene, at_rest=at_rest)
        if due and self._strips > 1:
            self.due = t  # another strip is there already
        return due

    def work_beside(self, scene: Scene, strip: Strip, submit: Callable[[Callable[[], object]], Future[object]]) -> None:
        """About every fifth tick the other strips are deformed, or planned where there are none."""
        self._ticks += 1
        if self._beside is not None and self._beside.done():
            error = self._beside.exception()
            if error is not None:  # the present result stays valid
                _log.warning("the other ways were not deformed: %s", error)
            else:
                self._strips = int(str(self._beside.result()))
            self._beside = None
        if (self._lone or self._ticks % _FAMILY_EVERY == 0) and not self.pending and self._beside is None:
            self._beside = submit(partial(self._others.step_others, scene, strip.q[0], plan=self._lone))
            self._lone = False

    def take(self, found: Replanned) -> None:
        """See :meth:`Replanner.take`; others to the strip are planned once it is driven."""
        super().take(found)
        self._lone = found.lone
