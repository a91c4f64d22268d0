"""PlanReport: the result of planning."""

from __future__ import annotations

from dataclasses import dataclass, field

from elastic_strips.scene import Scene
from elastic_strips.strip import Deformer, DeformParams, DeformReport, Strip
from elastic_strips.summary import Summary

from .homotopy.alternatives import Alternative
from .homotopy.classes import ObstacleCluster
from .leaving import Departure


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlanReport(Summary):
    """The result of planning an initial strip, and how it was found.

    Attributes:
        strip: the strip, from exactly the given start to exactly the given goal.
        initial: the strip that it was relaxed from.
            ``strip`` is certified if ``certified``; otherwise it is the best that was reached, as it is.
        certified: whether every segment is certified, and the base keeps to the bounds where there are any.
        method: ``"path"``, ``"line"``, ``"grid"``, ``"trees"`` (of the joints), ``"ompl"``, ``"straight"`` (of the
            hand), or ``"none"`` where nothing was certified.
        reason: what happened, in words; where nothing was certified, what was in the way last, and what to try.
        scene: the obstacles that were planned among.
        params: the parameters of the relaxation, with the clearances that were to be proven.
        relaxed: the last deformation report; None for a path that was certified as it was found. See :attr:`report`.
        attempts: number of planner calls; where several strips were wanted, number of paths that were relaxed.
        ticks: number of deformation ticks.
        seconds: from nothing to the first certified strip (or to giving up); all of it where several were asked for.
        timings: seconds by phase: line, planner, relaxation.
        alternatives: where several strips were wanted, the certified ones of different classes, the cheapest
            first; ``strip`` is that of the first.
        clusters: clusters of obstacles, to which the classes refer.
        walled_in: where nothing was certified and no way leads out from about the goal, or the start: what stands about
            it, in words; else empty.
        departure: the way out of a start that touches and may (``start_depth``): that part of the strip is not
            certified, so that ``certified`` is False; ``departure.rest`` is the certified strip that follows it, or
            None. ``departure`` is None for other starts.
    """

    strip: Strip
    initial: Strip
    certified: bool
    method: str
    reason: str
    scene: Scene
    params: DeformParams
    relaxed: DeformReport | None
    attempts: int
    ticks: int
    seconds: float
    timings: dict[str, float] = field(default_factory=dict)
    alternatives: tuple[Alternative, ...] = ()
    clusters: tuple[ObstacleCluster, ...] = ()
    departure: Departure | None = None
    walled_in: str = ""
    _assessed: list[DeformReport] = field(default_factory=list, init=False, repr=False)

    @property
    def report(self) -> DeformReport:
        """The last deformation report. Of a path that was certified as it was found, one is made at the first use: the
        forces of a strip, and its nodes' distances to the obstacles, are not needed for its proof."""
        if self.relaxed is not None:
            return self.relaxed
        if not self._assessed:
            self._assessed.append(Deformer(self.strip.robot, self.params).assess(self.strip, self.scene))
        return self._assessed[0]

    def _summary(self) -> dict[str, object]:
        several = {"costs": [round(a.cost, 3) for a in self.alternatives]} if self.alternatives else {}
        parts = {} if self.departure is None else {"rest certified": self.departure.rest is not None}
        return {
            "certified": self.certified,
            **parts,
            "method": self.method,
            "reason": self.reason,
            "robot": self.strip.robot.name,
            "nodes": len(self.strip),
            **several,
            "attempts": self.attempts,
            "ticks": self.ticks,
            "seconds": self.seconds,
        }

    def _measured(self) -> dict[str, object]:
        return {"clearance": f"{self.report.clearance:.3f} m"}
