"""Keeper: a strip that is kept certified while the world changes: deformed, and replanned where it stays broken."""

from __future__ import annotations

import logging
import time
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from elastic_strips.errors import ConfigurationError, ElasticStripsError
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import Deformer, DeformParams, DeformReport, DeformStatus, Strip

from .plan import plan_report
from .problem import check_endpoints
from .report import PlanReport

_log = logging.getLogger(__name__)
_BROKEN_BEFORE_SEARCH = 0.4  # [s]
_BETWEEN_SEARCHES, _LONGEST_SEARCH = 1.0, 1.0  # [s]
_STRETCHED = 1.4  # how many times as long as before a strip is that something carries along, so that a path is planned
_SHORTER = 0.8  # of its length, at most: only then that path is taken


class StripKeeper(OneThread):
    """Workspace: keeps one strip, tick by tick.

    Where the strip stays broken for 0.4 s a path is replanned, in another thread, and taken where it is certified in
    the scene of that moment and leads to the same goal. So it is where the strip has become much longer, as somebody
    who walks carries it along, and the path is much shorter. While start or goal touches something the strip waits.

    It is no `Controller`: nothing moves along the strip, and nobody has to stop for it.

    Args:
        robot: whose strip it is.
        scene: the obstacles.
        strip: to begin with.
        params: the deformer's.
        period: between two ticks [s]; half of it may be spent on a broken strip.

    Attributes:
        report: the newest tick's.
        replans: how many planned paths were taken.
    """

    def __init__(
        self, robot: RobotModel, scene: Scene, strip: Strip, *, params: DeformParams | None, period: float
    ) -> None:
        self.robot: RobotModel = robot
        self.replans: int = 0
        self._params, self._period = params, period
        self._deformer, self._ends = Deformer(robot, params), Deformer(robot, params)
        self.report: DeformReport = self._deformer.step(strip, scene)
        self._broken_since: float | None = None
        self._length = strip.length  # [m] as it began, or when a path was planned last
        self._searched = -np.inf
        self._search: Future[PlanReport] | None = None
        self._searches = ThreadPoolExecutor(1, thread_name_prefix="elastic-strips search")

    @property
    def searching(self) -> bool:
        """Whether a path is being planned."""
        return self._search is not None

    def close(self) -> None:
        """Look for no more paths."""
        self._searches.shutdown(wait=False, cancel_futures=True)

    @exclusive
    def taken(self, scene: Scene) -> Strip | None:
        """The path that was planned, where the goal has not moved since and it is certified in this scene."""
        if self._search is None or not self._search.done():
            return None
        search, self._search = self._search, None
        try:
            strip = search.result().strip
        except ElasticStripsError as error:  # say start or goal touch something: the report says so as well
            _log.debug("no path: %s", error)
            return None
        if not np.array_equal(strip.q[-1], self.report.strip.q[-1]):
            return None
        if self.report.certified and strip.length > _SHORTER * self.report.strip.length:
            return None
        if not self._deformer.certify(strip, scene).certified:
            return None
        self.replans += 1
        self._length = strip.length
        return strip

    @exclusive
    def tick(self, now: float, strip: Strip, scene: Scene) -> DeformReport:
        """Deform a strip, and have another one planned where it stays broken.

        Args:
            now: time [s].
            strip: that of the last report, or what became of it.
            scene: the obstacles.
        """
        certified = self.report.certified
        held = None if certified else self._held_by_its_ends(strip, scene)
        if held is not None:
            self.report = held
        else:
            budget = None if certified else 0.5 * self._period
            self.report = self._deformer.step(strip, scene, budget=budget, detail=True)
            self._look_for_path(now, scene)
        return self.report

    def _held_by_its_ends(self, strip: Strip, scene: Scene) -> DeformReport | None:
        """Where its start or goal touches something nothing helps but to move either: the strip stays as it is."""
        begin = time.perf_counter()
        try:
            check_endpoints(self.robot, scene, strip.q[0], strip.q[-1], self._deformer.params, self._ends)
        except ConfigurationError as error:
            certificate = self._deformer.certify(strip, scene)
            clearance, seconds = self._deformer.workspace.obstacles.least_clearance(), time.perf_counter() - begin
            return DeformReport(strip, DeformStatus.BROKEN, str(error), certificate, clearance, scene, seconds=seconds)
        return None

    def _look_for_path(self, now: float, scene: Scene) -> None:
        """Replan where the strip stays broken, or is carried along."""
        if self.report.certified:
            self._broken_since, needed = None, self.report.strip.length > _STRETCHED * self._length
        else:
            self._broken_since = now if self._broken_since is None else self._broken_since
            needed = now - self._broken_since >= _BROKEN_BEFORE_SEARCH
        if needed and now - self._searched >= _BETWEEN_SEARCHES and self._search is None:
            self._searched, self._length = now, max(self._length, self.report.strip.length)
            q = self.report.strip.q
            self._search = self._searches.submit(
                plan_report, self.robot, scene, q[0], q[-1], params=self._params, timeout=_LONGEST_SEARCH
            )
