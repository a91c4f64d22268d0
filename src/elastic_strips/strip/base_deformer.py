"""The common part of all presets' deformers: workspace of the tick, clock, reports, and the ticks of ``settle``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Generic

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.collision import (
    BodySet,
    Certificate,
    MotionBounds,
    ObstacleProximity,
    ProtectiveHulls,
    SelfProximity,
)
from elastic_strips.collision.candidates import NodePrediction
from elastic_strips.collision.strip_certificate import Certifier
from elastic_strips.errors import ConfigurationError, RobotError, SceneError
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.validation import check_able, check_choice, check_count, check_number, check_type

from .params import StripParams
from .report import DeformStatus, R, StripForces, settled_report
from .strip import Strip

NodePredictor = Callable[[Array], NodePrediction]
"""Says for nodes (N, nv) where moving obstacles will be when each of them is reached."""


class PhaseClock:
    """Accounts time to phases; the time between two marks belongs to the phase of the later mark."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Forget all phases and begin anew."""
        self.phases: dict[str, float] = {}
        self._begin = self._last = perf_counter()

    def mark(self, phase: str) -> None:
        """Account the time since the last mark to ``phase``."""
        now = perf_counter()
        self.phases[phase] = self.phases.get(phase, 0.0) + now - self._last
        self._last = now

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return perf_counter() - self._begin


@dataclass(frozen=True, slots=True, eq=False)
class TickResult:
    """The result of a tick's iterations; see :class:`DeformReport` for the attributes."""

    certificate: Certificate
    slip: float
    moved: float
    energies: dict[str, float]
    forces: StripForces
    iterations: int = 0


class Workspace(OneThread):
    """Mutable state of a deformer: the current nodes and everything that is known about them.

    Args:
        robot: the robot of the strips.
        params: the parameters, for what is certified.
        clock: accounts the time to phases.
        reach: the links' distances to obstacles are exact below this [m].
        self_reach: their distances to each other are exact below this [m].
        self_influence: the robot's own links push each other apart below this [m]; links that are nearer by design push
            below 0.8 of their distance at home.

    Attributes:
        kin: kinematics of the nodes.
        obstacles: the links' distances to the scene.
        self_pairs: their distances to each other.
        self_home: (S,) lower bounds of the self pairs' distances [m] at the home configuration.
        most_self_clearance: largest clearance [m] between its own links that can be certified: pairs that are proven to
            keep more than that in every posture were left out.
        prediction: where moving obstacles will be, or None where they count as they stand.
    """

    def __init__(
        self,
        robot: RobotModel,
        params: StripParams,
        clock: PhaseClock,
        *,
        reach: float,
        self_reach: float,
        self_influence: float,
    ) -> None:
        self.robot: RobotModel = robot
        self.params: StripParams = params
        self.clock: PhaseClock = clock
        self.bodies: BodySet = BodySet.links(robot)
        self.bounds: MotionBounds = MotionBounds(self.bodies)
        self.kin: Kinematics = Kinematics(robot.tree, 64)
        self.obstacles: ObstacleProximity = ObstacleProximity(self.bodies, influence=reach)
        self.most_self_clearance: float = params.self_clearance
        pairs = robot.pairs_within(self.most_self_clearance)  # the others keep more of themselves
        home = SelfProximity(self.bodies, pairs, self.bounds, influence=self_reach)
        kin = Kinematics(robot.tree, 1)
        kin.update(robot.space.to_coordinates(robot.home_q)[None])
        home.update(kin)
        self.self_home: Array = home.bound[0].copy()
        repulsion = np.clip(0.8 * np.minimum(home.exact[0], self_reach), 0.0, self_influence)
        self.self_pairs: SelfProximity = SelfProximity(
            self.bodies, pairs, self.bounds, influence=self_reach, repulsion=repulsion
        )
        depth = params.certificate_depth
        self.certifier: Certifier = Certifier(
            self.bodies, self.bounds, self.obstacles, self.self_pairs, max_depth=depth
        )
        self.prediction: NodePredictor | None = None
        self._strip: Strip | None = None
        self._ends: Array | None = None  # configurations that stay fixed

    @property
    def coordinates(self) -> Array:
        """(N, nv) the current nodes (a view)."""
        return self.kin.coordinates[: self.kin.n]

    @property
    def queries(self) -> int:
        """Exact distance queries made so far."""
        return self.obstacles.narrow.queries + self.self_pairs.queries

    @exclusive
    def reset(self) -> None:
        """Forget all that is known."""
        self._strip = None
        self.obstacles.reset()
        self.self_pairs.reset()

    def holds(self, strip: Strip) -> bool:
        """Whether the current nodes belong to this very strip."""
        return strip is self._strip

    @exclusive
    def load(self, strip: Strip, scene: Scene, *, to_move: bool = False) -> None:
        """Make a strip current; cheap where it already is.

        Args:
            strip: the nodes.
            scene: the obstacles.
            to_move: the nodes are about to move, and everything is measured again then. With a prediction, and the same
                obstacles as before, the known distances are enough for the forces: what moves as predicted is where
                the prediction had it.
        """
        current = strip is self._strip
        if not current:
            self.kin.update(strip.coordinates)
        self._strip, self._ends = strip, strip.q[[0, -1]]
        if not (to_move and current and self.prediction is not None and self.obstacles.knows(scene)):
            self._distances(scene)

    @exclusive
    def carry(self, strip: Strip, new: Strip, source: Indices) -> None:
        """Make ``new`` current, whose node i was node ``source[i]`` of ``strip`` (−1: none); known distances stay."""
        if not self.holds(strip):
            return
        self.obstacles.remap(source)
        self.self_pairs.remap(source)
        self.kin.update(new.coordinates)
        self._strip, self._ends = new, new.q[[0, -1]]

    @exclusive
    def move(self, coordinates: Array, scene: Scene) -> float:
        """Move the nodes; returns how far the fastest base or joint moved [m or rad]."""
        moved = float(np.abs(coordinates - self.coordinates).max(initial=0.0))
        self.replace(coordinates, scene)
        return moved

    @exclusive
    def replace(self, coordinates: Array, scene: Scene) -> None:
        """Make nodes (N, nv) current, however many there were; all is measured again."""
        self._strip = None
        self.kin.update(coordinates)
        self._distances(scene)

    @exclusive
    def try_joints(self, coordinates: Array) -> None:
        """Make nodes (N, nv) current for the distances of the robot's own links alone; to be replaced."""
        self._strip = None
        self.kin.update(coordinates)
        self.clock.mark("kinematics")
        self.self_pairs.update(self.kin)
        self.clock.mark("self-collision")

    @exclusive
    def edit(self, coordinates: Array, source: Indices, scene: Scene) -> None:
        """Make nodes (N, nv) current, whose node i was node ``source[i]`` (−1: none), with what is known."""
        self.obstacles.remap(source)
        self.self_pairs.remap(source)
        self.clock.mark("maintenance")
        self.replace(coordinates, scene)

    def _distances(self, scene: Scene) -> None:
        self.clock.mark("kinematics")
        self.obstacles.update(self.kin, scene, None if self.prediction is None else self.prediction(self.coordinates))
        self.clock.mark("proximity")
        self.self_pairs.update(self.kin)
        self.clock.mark("self-collision")

    @exclusive
    def certify(self, scene: Scene, known: Mask | None = None) -> Certificate:
        """Certify the segments between the current nodes, except those (N−1,) that are known to be certified."""
        v = self.robot.space.difference(self.coordinates[:-1], self.coordinates[1:])
        params = self.params
        certificate = self.certifier.certify(
            self.kin, v, clearance=params.clearance, self_clearance=params.self_clearance, scene=scene,
            known=known,
        )  # fmt: skip
        self.clock.mark("certificate")
        return certificate

    @exclusive
    def strip(self) -> Strip:
        """The current nodes as a frozen strip, which stays current."""
        self._strip = Strip.from_coordinates(self.robot, self.coordinates, ends=self._ends)
        return self._strip


class BaseDeformer(OneThread, ABC, Generic[R]):
    """Deforms strips of one robot; owns mutable buffers, so one per thread.

    Args:
        robot: the robot of the strips.
        params: parameters of the preset.
        **reaches: the distances ``reach``, … of :class:`Workspace`.
    """

    def __init__(self, robot: RobotModel, params: StripParams, **reaches: float) -> None:
        check_type("robot", robot, RobotModel, RobotError)
        self.robot = robot
        self.clock: PhaseClock = PhaseClock()
        self.workspace: Workspace = Workspace(robot, params, self.clock, **reaches)
        self.share_with(self.workspace)
        self._rest_step, self._max_ticks = params.rest_step, params.max_ticks
        self._rolling = False  # whether wheels have to follow the strip
        self._descends = False  # whether an iteration must not raise the energy

    @exclusive
    def step(self, strip: Strip, scene: Scene, *, budget: float | None = None, detail: bool = False) -> R:
        """One control tick: deform the strip away from the obstacles and certify it.

        Args:
            strip: the strip of the last report, or a new one of this robot.
            scene: snapshot of the obstacles.
            budget: time [s] to spend; iterations go on while another one fits, and it is exceeded by at most one.
                None makes exactly one iteration.
            detail: whether to add forces and protective hulls to the report, to look at.

        Raises:
            ConfigurationError: the strip belongs to another robot.
            ParameterError: a budget that is not a positive number.
        """
        already = self.workspace.queries
        self._load(strip, scene, budget=budget, to_move=True)
        result = self._iterations(scene, budget)
        return self._report(scene, result, self.workspace.queries - already, detail)

    @abstractmethod
    def _iterate(self, scene: Scene) -> TickResult:
        """One iteration from the current nodes."""

    @abstractmethod
    def _report(self, scene: Scene, result: TickResult, queries: int, detail: bool) -> R:
        """The report of a tick that made this many exact distance queries."""

    @exclusive
    def settle(
        self,
        strip: Strip,
        scene: Scene,
        *,
        max_ticks: int | None = None,
        until: str | Callable[[R], bool] = "rest",
        watch: Callable[[R], object] | None = None,
        detail: bool = False,
    ) -> R:
        """Ticks until the strip is at rest, or certified, or ``max_ticks`` are over.

        On the way to rest the default preset's strips get no worse: no tick raises their energy, except by nodes that
        come or go, and a stiff layer keeps the clearance that they had. A strip that is certified when the ticks are
        over, but not at rest, is ``DEFORMING``.

        Args:
            strip: where to start.
            scene: the obstacles, standing still.
            max_ticks: at most this many ticks; the parameter's value where None.
            until: ``"rest"``, or ``"certified"`` to stop at the first certified strip; or a function of a tick's report
                that says whether to stop.
            watch: called with the report of every tick.
            detail: as in :meth:`step`, for the last report.

        Returns:
            The last tick's report, with ``ticks`` counted and ``timings`` summed; ``BROKEN`` (or ``BLOCKED``) where it
            ended without a certificate.

        Raises:
            ParameterError: ``until`` or ``max_ticks`` outside its range.
        """
        if not callable(until):
            check_choice("until", until, ("rest", "certified"))
        limit = self._max_ticks if max_ticks is None else check_count("max_ticks", max_ticks, low=1)
        check_able("watch", watch)
        timings: dict[str, float] = {}
        seconds, queries, ticks = 0.0, 0, 0
        last: R | None = None
        self._descends = until == "rest"
        try:
            if self._descends:
                self._begin(strip, scene)
            while True:
                report = self.step(strip, scene, detail=detail)
                strip, ticks = report.strip, ticks + 1
                seconds += report.seconds
                queries += report.queries
                for phase, value in report.timings.items():
                    timings[phase] = timings.get(phase, 0.0) + value
                if watch is not None:
                    watch(report)
                done = until(report) if callable(until) else until == "certified" and report.usable
                last = report if last is None else self._with_former(report, last)
                if report.status is not DeformStatus.DEFORMING or done or ticks >= limit:
                    return settled_report(last, ticks, timings, seconds, queries)
        finally:
            self._descends = False

    def _begin(self, strip: Strip, scene: Scene) -> None:
        """Prepare ``settle`` before its first tick on the way to rest."""

    def _with_former(self, report: R, former: R) -> R:
        """A tick's report in ``settle``, with the figures that it takes over from all ticks before."""
        return report

    @exclusive
    def certify(self, strip: Strip, scene: Scene) -> Certificate:
        """Certify a strip as it is, without moving it.

        Raises:
            ConfigurationError: the strip belongs to another robot.
        """
        self._load(strip, scene)
        return self.workspace.certify(scene)

    @exclusive
    def assess(self, strip: Strip, scene: Scene, *, detail: bool = False, prediction: NodePredictor | None = None) -> R:
        """Report on a strip as it is: certificate, clearance, hulls; nothing moves.

        Args:
            strip, scene, detail: as in :meth:`step`.
            prediction: where moving obstacles will be when the nodes are reached; where None, they count as they stand.
        """
        self._load(strip, scene, prediction)
        slip = float(strip.lateral_slip.max(initial=0.0)) if self._rolling else 0.0
        result = TickResult(self.workspace.certify(scene), slip, 0.0, {}, StripForces.none())
        return self._report(scene, result, 0, detail)

    @exclusive
    def reset(self) -> None:
        """Forget all that is kept from tick to tick, as is needed after an exception."""
        self.workspace.reset()

    # the parts of a tick

    def _load(
        self, strip: Strip, scene: Scene, prediction: NodePredictor | None = None, *,
        budget: float | None = None, to_move: bool = False,
    ) -> None:  # fmt: skip
        """Check the arguments of a tick, start the clock and make the strip current."""
        if budget is not None:
            check_number("budget", budget, above=0.0, unit="s")
        check_able("prediction", prediction)
        check_type("scene", scene, Scene, SceneError)
        self._check(strip)
        self.clock.start()
        self.workspace.prediction = prediction
        self.workspace.load(strip, scene, to_move=to_move)

    def _check(self, strip: Strip) -> None:
        check_type("strip", strip, Strip, ConfigurationError)
        if not self.robot.same_as(strip.robot):
            raise ConfigurationError(
                f"the strip is of robot {strip.robot.name!r} (nq {strip.robot.nq}), the deformer of "
                f"{self.robot.name!r} (nq {self.robot.nq}): they differ in joints, shapes or pairs of links"
            )

    def _iterations(self, scene: Scene, budget: float | None) -> TickResult:
        """Iterations of one tick: one without a budget, otherwise until it is spent or the strip is at rest."""
        count = 0
        while True:
            began = self.clock.elapsed
            result = self._iterate(scene)
            count += 1
            spent = self.clock.elapsed - began
            done = result.moved < self._rest_step and result.certificate.certified
            if budget is None or self.clock.elapsed + spent > budget or done:
                return replace(result, iterations=count)

    def _reported(
        self, kind: type[R], scene: Scene, result: TickResult, queries: int, detail: bool, *,
        status: DeformStatus, reason: str, hulls: ProtectiveHulls | None,
    ) -> R:  # fmt: skip
        """A report with the fields that all presets have in common."""
        clearance = self.workspace.obstacles.least_clearance()
        strip = self.workspace.strip()
        self.clock.mark("report")
        return kind(
            strip=strip, status=status, reason=reason, scene=scene, certificate=result.certificate,
            node_clearance=clearance, energies=result.energies, timings=self.clock.phases,
            seconds=sum(self.clock.phases.values()), iterations=result.iterations, moved=result.moved,
            slip=result.slip, queries=queries, forces=result.forces if detail else None, hulls=hulls,
        )  # fmt: skip
