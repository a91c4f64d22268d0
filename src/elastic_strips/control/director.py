"""Control room, director: plans paths for the reactive layer, when the sequencing layer says so."""

from __future__ import annotations

import numpy.typing as npt

from ..execution.proposal import Proposal
from ..execution.replanning import Replanner
from ..planning import PlanReport
from ..scene import Scene
from ..strip import Strip


class Director(Replanner):
    """Workspace: a replanner that finds out what is wrong with a strip, and waits to be asked for another.

    Attributes:
        trouble: why the strip cannot be followed; empty where it can.
        attempts: paths asked for since the last goal.
    """

    def __init__(self, *args: object, **options: object) -> None:
        super().__init__(*args, **options)  # type: ignore[arg-type]
        self.trouble, self.attempts = "", 0
        self._asked = False

    def plan(
        self, scene: Scene, start: npt.ArrayLike, goal: npt.ArrayLike, *, path: npt.ArrayLike | None = None
    ) -> PlanReport:
        """The first path of a step; see :meth:`Replanner.plan`."""
        report = super().plan(scene, start, goal, path=path)
        self.attempts, self._asked = 0, False
        self.trouble = "" if report.certified else report.reason
        return report

    def ask(self) -> None:
        """Another path is wanted."""
        self._asked = True

    def watch(self, t: float, proposal: Proposal, scene: Scene, *, at_rest: bool) -> str:
        """Look at a tick's strip; returns why another one is planned, once that has been asked for, or ""."""
        found = super().watch(t, proposal, scene, at_rest=at_rest)
        self.pending = False
        if found:
            self.trouble = found
        elif proposal.accepted or proposal.kept:
            self.trouble = ""
        if not self._asked:
            return ""
        self._asked, self.pending, self.due = False, True, t + self.params.replan_time
        return self.trouble

    def plan_anew(self, scene: Scene, start: npt.ArrayLike, goal: npt.ArrayLike) -> tuple[Strip | None, str]:
        """Another path; see :meth:`Replanner.plan_anew`."""
        strip, reason = super().plan_anew(scene, start, goal)
        self.attempts += 1
        self.trouble = "" if strip is not None else reason
        return strip, reason
