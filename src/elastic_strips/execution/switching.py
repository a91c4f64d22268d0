"""Execution room, switching: other ways are kept at hand, and one of them is followed where the strip is given up."""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ..errors import ConfigurationError, ElasticStripsError
from ..planning import FamilyParams, PlanReport, StripFamily
from ..robot import RobotModel
from ..scene import Scene
from ..strip import Strip
from .params import DriveParams
from .proposal import Proposal
from .replanning import Replanner

_log = logging.getLogger(__name__)
_SLOW = 0.3
"""What is slower than this [m/s] counts, where it is, as closing a way; what is faster has soon passed."""
_TIMEOUT = 2.0
_EVERY = 5  # planning ticks from one tick of the family to the next


class SwitchingReplanner(Replanner):
    """Workspace: a replanner that keeps strips on different sides of the obstacles and deforms them side by side.

    The robot follows the cheapest. When its strip is given up and the robot stands, the cheapest of the others that is
    certified from there is followed; only where there is none, a planner is asked.

    Args:
        robot, params, seed, grid: as of :class:`Replanner`.
        family: of the strips that are kept.

    Attributes:
        family: the strips, or None before the first plan.
    """

    def __init__(
        self, robot: RobotModel, params: DriveParams, *, seed: int, grid: bool, family: FamilyParams | None = None
    ) -> None:
        super().__init__(robot, params, seed=seed, grid=grid)
        self.family: StripFamily | None = None
        # planners are called at rest only; who stands can turn on the spot, so that no other way is left behind
        self._kept = replace(family or FamilyParams(), plan_every=0, part=np.pi)
        self._ticks, self._why = 0, ""

    def plan(
        self, scene: Scene, start: npt.ArrayLike, goal: npt.ArrayLike, *, path: npt.ArrayLike | None = None
    ) -> PlanReport:
        """The cheapest of several strips; one as of :meth:`Replanner.plan` where there are none.

        Raises:
            ConfigurationError: start or goal is not sound, or in collision.
        """
        first = super().plan(scene, start, goal, path=path)
        self.family = StripFamily(self.robot, goal, params=self.deform, family=self._kept, seed=self.seed)
        try:
            found = self.family.plan(slow(scene), start)
        except ConfigurationError:  # something slow stands in start or goal, and may go away
            return first
        best = found.best
        if best is None or not found.certified:
            return first
        reason = f"{found.events[0] if found.events else 'planned'}; {first.reason}"
        return replace(
            first, strip=best.strip, initial=best.strip, certified=True, method=best.method, reason=reason,
            report=best.report,
        )  # fmt: skip

    def watch(self, t: float, proposal: Proposal, scene: Scene, *, at_rest: bool) -> str:
        """See :meth:`Replanner.watch`; in every fifth tick the family has one of its own."""
        self._ticks += 1
        if self.family is not None and self._ticks % _EVERY == 0 and not self.pending:
            try:
                self.family.step(slow(scene), proposal.report.strip.q[0], decide=False)
            except ElasticStripsError as error:  # no reason to lose what was proposed
                _log.warning("the other ways were not deformed: %s", error)
        due = super().watch(t, proposal, scene, at_rest=at_rest)
        if due:
            self._why = due
            if self.family is not None and len(self.family) > 1:
                self.due = t  # another strip is there already
        return due

    def plan_anew(self, scene: Scene, start: npt.ArrayLike, goal: npt.ArrayLike) -> tuple[Strip | None, str]:
        """One of the other strips, or else another plan."""
        family, why = self.family, self._why
        if family is not None:
            try:
                found = family.leave(slow(scene), start, why)
            except ElasticStripsError as error:
                return None, f"failed: {error}"
            if found.best is not None:
                self.halted = False
                self.count += 1
                return found.best.strip, found.events[-1]
        strip, reason = super().plan_anew(scene, start, goal)
        if strip is not None and family is not None:
            with suppress(ElasticStripsError):  # for the next time; what is followed now is the planner's
                family.plan(slow(scene), start, timeout=_TIMEOUT)
        return strip, reason


def slow(scene: Scene) -> Scene:
    """What stands or moves slowly, as if it stood."""
    still = [o for o in scene if o.motion is None or np.linalg.norm(o.velocity()[0]) < _SLOW]
    return Scene([o.sensed(o.pose, None) for o in still], time=scene.time)
