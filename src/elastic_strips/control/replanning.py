"""Replanning: when a strip has to be planned anew, and how; alternative strips."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt

from elastic_strips.errors import ConfigurationError, ElasticStripsError
from elastic_strips.planning import PlanReport, StripSet, StripSetParams, StripSetReport, plan_report
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Obstacle, Scene
from elastic_strips.strip import DeformParams, Strip

from .params import DriveParams
from .strip_timer import PlanResult

_STANDING = 0.05
"""Obstacles slower than this [m/s] count as static for a planner."""
_FIRST_TIMEOUT, _TIMEOUT = 10.0, 4.0  # [s] of the first plan, and of those while the robot waits
_BERTH, _MOST_BERTH = 0.2, 0.6
"""Additional distance [m] from obstacles that stand but can move: per further plan, and at most."""


class Replanner:
    """Workspace: watches the strip, decides when to give it up, and plans another one.

    Args:
        robot: the robot.
        params: parameters of the drive.
        seed: seed of the planner.
        grid: whether a path over a grid may be used.

    Attributes:
        halted: whether the robot has to stop because static obstacles keep the strip broken.
        pending: whether another plan is due; the caller resets it when it has the plan.
        due: time [s] from which on the plan may be used.
        count: number of plans after the first.
        submit: runs functions with their arguments beside the control loop, one after the other; the caller sets it.
    """

    pending: bool
    halted: bool
    submit: Callable[..., Future[object]] | None = None

    def __init__(self, robot: RobotModel, params: DriveParams, *, seed: int, grid: bool) -> None:
        self.robot: RobotModel = robot
        self.params: DriveParams = params
        self.seed: int = seed
        self.grid: bool = grid
        self.deform: DeformParams = params.strip
        self.halted = self.pending = False
        self.due: float = 0.0
        self.count: int = 0
        self._since: float | None = None

    def plan(
        self, scene: Scene, start: npt.ArrayLike, goal: npt.ArrayLike, *, path: npt.ArrayLike | None = None
    ) -> PlanReport:
        """Plan a strip among the static obstacles; moving ones are left to its deformation.

        Args:
            scene: the obstacles.
            start, goal: configurations (nq,).
            path: waypoints (K, 2) [m] that are tried first.

        Raises:
            ConfigurationError: start or goal is not valid, or in collision.
        """
        return self._planned(standing(scene), start, goal, self.seed, _FIRST_TIMEOUT, path=path)

    def _planned(
        self, scene: Scene, start: npt.ArrayLike, goal: npt.ArrayLike, seed: int, timeout: float, *,
        path: npt.ArrayLike | None = None, line: bool = True,
    ) -> PlanReport:  # fmt: skip
        """A plan that satisfies the drive's constraint; where there is none, one that does not, and says so."""
        plan = partial(
            plan_report, self.robot, scene, start, goal, seed=seed, params=self.deform, path=path, line=line,
            grid=self.grid, backward=self.params.backward,
        )  # fmt: skip
        constraint = self.params.constraint
        if constraint is None:
            return plan(timeout=timeout)
        try:
            report = plan(timeout=0.5 * timeout, constraint=constraint)
        except ConfigurationError as error:  # start or goal does not satisfy it, or is wrong for both
            why = str(error)
        else:
            if report.certified:
                return report
            why = report.reason
        report = plan(timeout=0.5 * timeout)
        return replace(report, reason=f"{report.reason}; it does not satisfy the constraint, for: {why}")

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
        by_standing = broken is not None and not _moves(scene, broken.obstacle)
        if not by_standing and (result.accepted or not at_rest):
            self._since, self.halted = None, False
            return ""
        if self._since is None:
            self._since = t
        if t - self._since <= self.params.replan_after * (1 + self.count):
            return ""
        self.halted = by_standing
        if not at_rest and not by_standing:
            return ""
        self._since, self.pending, self.due = None, True, t + self.params.replan_time
        return f"the strip is broken: {broken}" if by_standing else result.reason

    def plan_anew(self, scene: Scene, start: npt.ArrayLike, goal: npt.ArrayLike) -> tuple[Strip | None, str]:
        """Plan another strip.

        Obstacles that stand but can move are passed at a larger distance, or on another side, where there is room.

        Args:
            scene: the obstacles.
            start, goal: configurations (nq,).

        Returns:
            The strip, or None, and the reason.
        """
        berth = min(_BERTH * self.count, _MOST_BERTH)
        self.count += 1
        still, reason = standing(scene), ""
        mobile = [o for o in still if scene.obstacle(o.name or "").motion is not None] if berth else []
        widths = (berth, 0.5 * berth, 0.0) if mobile else (0.0,)
        for width in widths:
            around = Scene([*still, *(_around(o, width) for o in mobile)], time=still.time) if width else still
            try:
                report = self._planned(around, start, goal, self.seed + self.count, _TIMEOUT / len(widths), line=False)
            except ElasticStripsError as error:
                reason = f"failed: {error}"
                continue
            if report.certified:
                self.halted = False
                return report.strip, report.reason
            reason = report.reason
        return None, reason

    def discard(self) -> None:
        """Forget the last plan: the robot does not stand where it begins, so it is not used and does not count."""
        self.count -= 1


def standing(scene: Scene, below: float = _STANDING) -> Scene:
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


def _moves(scene: Scene, name: str) -> bool:
    return name in scene and scene.obstacle(name).motion is not None


_log = logging.getLogger(__name__)
_SLOW = 0.3
"""Obstacles slower than this [m/s] block a path; faster ones have soon passed."""
_FAMILY_TIMEOUT = 2.0
_EVERY = 5  # planning ticks from one tick of the family to the next


class SwitchingReplanner(Replanner):
    """Workspace: a replanner that keeps strips on different sides of the obstacles and deforms them side by side.

    The robot follows the cheapest. When its strip is given up and the robot stands, it follows the cheapest of the
    others that is certified from there; where there is none, another one is planned.

    Args:
        robot, params, seed, grid: as for :class:`Replanner`.
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
        self._ticks, self._why, self._change = 0, "", ""
        self._discarded = False  # whether nobody has driven the strip that was changed to last
        self._lone = False  # whether there are no others to the one that was planned
        self._beside: Future[object] | None = None  # the step of the family that runs beside the ticks

    def plan(
        self, scene: Scene, start: npt.ArrayLike, goal: npt.ArrayLike, *, path: npt.ArrayLike | None = None
    ) -> PlanReport:
        """Plan several strips and return the cheapest; where there are none, plan as :meth:`Replanner.plan` does."""
        first = super().plan(scene, start, goal, path=path)
        self.family = StripSet(
            self.robot, goal, params=self._kept, deform=self.deform, seed=self.seed, constraint=self.params.constraint
        )
        try:
            found = self.family.plan(standing(scene, _SLOW), start)
        except ConfigurationError:  # something slow blocks start or goal, and may go away
            return first
        best = found.best
        if best is None or not found.certified:
            return first
        reason = f"{found.events[0] if found.events else 'planned'}; {first.reason}"
        return replace(
            first, strip=best.strip, initial=best.strip, certified=True, method=best.method, reason=reason,
            report=best.report,
        )  # fmt: skip

    def watch(self, t: float, result: PlanResult, scene: Scene, *, at_rest: bool) -> str:
        """See :meth:`Replanner.watch`; about every fifth tick the other strips are deformed beside the ticks, too."""
        self._ticks += 1
        if self._beside is not None and self._beside.done():
            error, self._beside = self._beside.exception(), None
            if error is not None:  # the present result stays valid
                _log.warning("the other ways were not deformed: %s", error)
        due = (self._lone or self._ticks % _EVERY == 0) and not self.pending
        if due and self.submit is not None and self._beside is None:
            work = self._plan_others if self._lone else self._deform_others
            self._lone = False
            self._beside = self.submit(work, standing(scene, _SLOW), result.report.strip.q[0])
        due = super().watch(t, result, scene, at_rest=at_rest)
        if due:
            self._why = due
            if self.family is not None and len(self.family) > 1:
                self.due = t  # another strip is there already
        return due

    def _deform_others(self, scene: Scene, start: npt.ArrayLike) -> None:
        if self.family is not None:
            self.family.step(scene, start, decide=False)

    def _plan_others(self, scene: Scene, start: npt.ArrayLike) -> None:
        if self.family is not None:
            with suppress(ElasticStripsError):
                self.family.plan(scene, start, timeout=_FAMILY_TIMEOUT)

    def plan_anew(self, scene: Scene, start: npt.ArrayLike, goal: npt.ArrayLike) -> tuple[Strip | None, str]:
        """One of the other strips, or else another plan; others to that one are planned once it is driven."""
        if self.family is not None:
            try:
                found = self._another(self.family, standing(scene, _SLOW), start)
            except ElasticStripsError as error:
                self.count += 1
                return None, f"failed: {error}"
            if found.best is not None:
                self.halted = False
                self.count += 1
                return found.best.strip, found.events[-1]
        strip, reason = super().plan_anew(scene, start, goal)
        self._lone = strip is not None and self.family is not None
        return strip, reason

    def _another(self, family: StripSet, scene: Scene, start: npt.ArrayLike) -> StripSetReport:
        """The strip that was changed to last where nobody has driven it, or another one."""
        if self._discarded:
            self._discarded = False
            found = family.step(scene, start, decide=False)
            if found.certified:
                return replace(found, events=(*found.events, self._change))
        found = family.leave(scene, start, self._why)
        self._change = found.events[-1]
        return found

    def discard(self) -> None:
        """Forget the last plan, which is not used; see :meth:`Replanner.discard`."""
        super().discard()
        self._discarded = True
