"""Deformer: the control tick. Strip and scene in, certified strip and report out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from elastic_strips.arrays import Array, Indices

from ..errors import ConfigurationError, ParameterError, RobotError, SceneError
from ..robot import RobotModel
from ..scene import Scene
from ..tunnel import Certificate, Tunnel, protective_hulls
from ..validation import check_able, check_choice, check_count, check_number, check_type, shown
from .constraint import AxisTask, TaskForce
from .default_step import DefaultStep
from .paper.step import PaperStep
from .params import DeformParams
from .report import (
    SLIP_LIMIT,
    DeformReport,
    DeformStatus,
    ForceField,
    PhaseClock,
    TickResult,
    settled_report,
    tick_status,
    wide_spacing,
)
from .resampling import maintain, node_spacing
from .rolling import project_rolling
from .strip import Strip
from .workspace import Foresight, Workspace


class Deformer:
    """Deforms strips of one robot; owns mutable buffers, so one per thread.

    Give each report's strip back to the next :meth:`step`: then only what moved is computed anew.

    Args:
        robot: whose strips.
        params: parameters, or the name of a preset.
        task: what the strips are to keep to besides; default preset only.

    Attributes:
        task: the same with its switch ``active``, or None.

    Raises:
        ParameterError: an unknown preset, or a task for preset ``paper``.
        RobotError: a task for a frame that the robot does not have.
    """

    def __init__(
        self, robot: RobotModel, params: DeformParams | str = "default", *, task: AxisTask | None = None
    ) -> None:
        check_type("robot", robot, RobotModel, RobotError)
        check_type("task", task, AxisTask, none=True)
        if isinstance(params, str):
            params = DeformParams.for_preset(params)
        if not isinstance(params, DeformParams):
            raise ParameterError(f"params={shown(params)} is neither DeformParams nor the name of a preset")
        self.robot, self.params = robot, params
        self.clock = PhaseClock()
        self.workspace = Workspace(robot, params, self.clock)
        self._default = DefaultStep(robot, params)
        if task is not None and params.preset == "paper":
            raise ParameterError("preset='paper' knows no tasks: its forces are those of the paper")
        self.task = None if task is None else TaskForce(robot, task)
        self._paper = PaperStep(robot, params) if params.preset == "paper" else None
        self._certified = False
        self._scene: Scene | None = None
        self._trust = 1.0

    def step(
        self,
        strip: Strip,
        scene: Scene,
        *,
        budget: float | None = None,
        detail: bool = False,
        nodes: bool = True,
        foresight: Foresight | None = None,
    ) -> DeformReport:
        """One control tick: deform the strip away from the obstacles and certify it.

        Args:
            strip: the strip of the last report, or a new one of this robot.
            scene: snapshot of the obstacles.
            budget: time [s] to spend; iterations go on while another one fits, and it is exceeded by at most one.
                None makes exactly one iteration. Nodes are not maintained in a tick whose budget is already spent.
            detail: whether to add forces and protective hulls to the report, to look at.
            nodes: whether nodes may be inserted and removed.
            foresight: where moving obstacles will be when the nodes are reached; as they stand where None.

        Raises:
            ConfigurationError: the strip belongs to another robot.
            ParameterError: a budget that is not a positive number.
        """
        if budget is not None:
            check_number("budget", budget, above=0.0, unit="s")
        check_able("foresight", foresight)
        check_type("scene", scene, Scene, SceneError)
        self._check(strip)
        self.clock.start()
        work = self.workspace
        work.foresight = foresight
        asked = work.queries
        known = work.holds(strip)
        work.load(strip, scene, to_move=True)
        hold = self._paper is None and self._to_hold(strip, scene, known)
        iterations = 0
        while True:
            began = self.clock.elapsed
            result = self._iterate(scene, hold)
            hold = self._paper is None and _proven(result)
            iterations += 1
            spent = self.clock.elapsed - began
            rest = result.moved < self.params.rest_step
            if budget is None or self.clock.elapsed + spent > budget or (rest and result.certificate.certified):
                break
        in_time = budget is None or self.clock.elapsed <= budget
        if self._paper is None and nodes and in_time:
            result = self._maintain(scene, result)
        return self._report(scene, result, iterations, work.queries - asked, detail)

    def settle(
        self,
        strip: Strip,
        scene: Scene,
        *,
        max_ticks: int | None = None,
        until: str = "rest",
        watch: Callable[[DeformReport], object] | None = None,
        detail: bool = False,
    ) -> DeformReport:
        """Ticks until the strip is at rest, or certified, or ``max_ticks`` are over.

        Args:
            strip: where to start.
            scene: the obstacles, standing still.
            max_ticks: at most this many ticks; the parameter's value where None.
            until: ``"rest"``, or ``"certified"`` to stop at the first certified strip.
            watch: called with the report of every tick.
            detail: as in :meth:`step`, for the last report.

        Returns:
            The last tick's report, with ``ticks`` counted and ``timings`` summed; ``BROKEN`` (or ``BLOCKED``) where it
            ended without a certificate.

        Raises:
            ParameterError: ``until`` or ``max_ticks`` outside its range.
        """
        check_choice("until", until, ("rest", "certified"))
        limit = self.params.max_ticks if max_ticks is None else check_count("max_ticks", max_ticks, low=1)
        check_able("watch", watch)
        timings: dict[str, float] = {}
        seconds, asked, turn, ticks = 0.0, 0, 0.0, 0
        while True:
            report = self.step(strip, scene, detail=detail)
            strip, ticks = report.strip, ticks + 1
            seconds += report.seconds
            asked += report.asked
            turn = max(turn, report.heading_step)
            for phase, value in report.timings.items():
                timings[phase] = timings.get(phase, 0.0) + value
            if watch is not None:
                watch(report)
            done = until == "certified" and report.certified and report.usable
            if report.status is not DeformStatus.DEFORMING or done or ticks >= limit:
                return settled_report(report, ticks, timings, seconds, asked, turn)

    def certify(self, strip: Strip, scene: Scene) -> Certificate:
        """Certify a strip as it is, without moving it."""
        check_type("scene", scene, Scene, SceneError)
        self._check(strip)
        self.workspace.foresight = None
        self.workspace.load(strip, scene)
        self._certified, self._scene = False, None
        return self.workspace.certify(scene)

    def assess(
        self, strip: Strip, scene: Scene, *, detail: bool = False, foresight: Foresight | None = None
    ) -> DeformReport:
        """Report on a strip as it is: certificate, clearance, hulls; nothing moves."""
        check_type("scene", scene, Scene, SceneError)
        self._check(strip)
        check_able("foresight", foresight)
        self.clock.start()
        self.workspace.foresight = foresight
        self.workspace.load(strip, scene)
        certificate = self.workspace.certify(scene)
        slip = float(strip.lateral_slip.max(initial=0.0)) if self._paper is None else 0.0
        nothing = ForceField(np.zeros((0, 3)), np.zeros((0, 3)))
        return self._report(scene, TickResult(certificate, slip, 0.0, {}, nothing), 0, 0, detail)

    def reset(self) -> None:
        """Forget all that is kept from tick to tick; for after an exception."""
        self._certified, self._scene, self._trust = False, None, 1.0
        self.workspace.reset()

    @property
    def spacing_weight(self) -> Array:
        """(nv,) metric in which node spacing is measured [m²/m² or m²/rad²]."""
        return self._default.spacing_weight

    def carry(self, strip: Strip, chart: Array, source: Indices) -> Strip:
        """A strip made of the last one's nodes and new ones; what is known of the old nodes is kept.

        Args:
            strip: the strip of the last report.
            chart: (M, nv) the new nodes.
            source: (M,) which node of ``strip`` each was; −1 for a new one.
        """
        self._check(strip)
        ends = self.robot.space.from_chart(chart[[0, -1]])
        for end in (0, -1):
            if source[end] >= 0:
                ends[end] = strip.q[source[end]]
        new = Strip.from_chart(self.robot, chart, ends=ends)
        self.workspace.carry(strip, new, source)
        return new

    # the parts of a tick

    def _check(self, strip: Strip) -> None:
        check_type("strip", strip, Strip, ConfigurationError)
        if not self.robot.same_as(strip.robot):
            raise ConfigurationError(
                f"the strip is of robot {strip.robot.name!r} (nq {strip.robot.nq}), the deformer of "
                f"{self.robot.name!r} (nq {self.robot.nq}): they differ in joints, shapes or pairs of links"
            )

    def _to_hold(self, strip: Strip, scene: Scene, known: bool) -> bool:
        """Whether the strip has a certificate that must not be lost; ``known`` says that it is the last report's."""
        work = self.workspace
        if known and self._certified:
            return not work.obstacles.nearer_than(self.params.clearance)  # else the scene has taken it already
        if known and (scene is self._scene or work.foresight is not None):
            return False
        return float(strip.lateral_slip.max(initial=0.0)) <= SLIP_LIMIT and work.certify(scene).certified

    def _iterate(self, scene: Scene, hold: bool) -> TickResult:
        """One iteration; ``hold`` says that the current nodes came from a certified strip, which must not be lost."""
        work = self.workspace
        if self._paper is not None:
            chart, energies, field = self._paper.advance(work, scene)
            moved = work.move(chart, scene)
            return TickResult(work.certify(scene), 0.0, moved, energies, field)
        before = work.chart.copy()
        if not hold:
            self._trust = 1.0
        chart, slip, energies, field = self._default.iterate(
            work.kin, work.obstacles, work.self_pairs, self.clock, self._trust, self.task
        )
        moved = work.move(chart, scene)
        result = TickResult(work.certify(scene), slip, moved, energies, field)
        if hold and not _proven(result):
            return self._shorter(before, chart, scene, result)
        self._trust = min(1.0, 2.0 * self._trust)
        return result

    def _shorter(self, before: Array, chart: Array, scene: Scene, full: TickResult) -> TickResult:
        """A step must not lose the certificate where a shorter one, or none, keeps it; the next ones are shorter too.

        The strip does not count as at rest then: ``moved`` stays that of the full step.
        """
        space, work = self.robot.space, self.workspace
        for scale in (0.5, 0.0):
            self._trust = max(0.5 * self._trust, 0.05)
            nodes, slip = before, 0.0
            if scale > 0.0:
                nodes = space.integrate(before, scale * space.difference(before, chart))
                if self._default.rolling:
                    nodes, slip = project_rolling(space, nodes)
            work.move(nodes, scene)
            certificate = work.certify(scene)
            if certificate.certified and slip <= SLIP_LIMIT:
                return TickResult(certificate, slip, full.moved, full.energies, full.field)
        self._trust = 1.0
        work.move(chart, scene)  # nothing holds: the obstacle came too near, and the full step is the way out
        return full

    def _maintain(self, scene: Scene, result: TickResult) -> TickResult:
        params, space, work = self.params, self.robot.space, self.workspace
        edit = maintain(
            space,
            work.chart,
            weight=self._default.spacing_weight,
            max_spacing=params.max_spacing,
            min_spacing=params.min_spacing,
            split=None if work.foresight else ~result.certificate.segments,  # what moves on will be gone
            max_nodes=params.max_nodes,
        )
        self.clock.mark("maintenance")
        if edit is None:
            return result
        before, chart, slip = work.chart.copy(), edit.chart, result.slip
        if self._default.rolling:  # a node that went joins two arcs into one that must be drivable again
            chart, slip = project_rolling(space, chart)
        work.edit(edit, chart, scene)
        edited = TickResult(work.certify(scene), slip, result.moved, result.energies, result.field)
        if _proven(result) and not _proven(edited):  # the nodes that went were needed
            work.restore(before, scene)
            return replace(result, certificate=work.certify(scene))
        return edited

    def _tunnel(self, scene: Scene) -> Tunnel:
        work, cap = self.workspace, self.params.influence
        if self._paper is not None:
            return self._paper.tunnel(work.kin, scene)
        points = self.robot.control_point_set
        local = np.einsum("cji,cj->ci", self.robot.tree.align[points.joint], points.local)
        free = np.minimum(work.obstacles.clearance().min(axis=1), cap)
        world = work.kin.points(points.joint, local)
        return protective_hulls(world, np.repeat(free[:, None], len(points.names), axis=1), cap=cap)

    def _report(self, scene: Scene, result: TickResult, iterations: int, asked: int, detail: bool) -> DeformReport:
        paper = self._paper
        tunnel = self._tunnel(scene) if detail or paper is not None else None
        rest, wide = result.moved < self.params.rest_step, ""
        if paper is None and rest:
            work = self.workspace
            spacing = node_spacing(self.robot.space, work.chart, self._default.spacing_weight)
            wide = wide_spacing(float(spacing.max()), len(work.chart), self.params)
            rest = not wide or len(work.chart) >= self.params.max_nodes  # else there are nodes to be put in
        counted = tunnel if paper is not None else None
        status, reason = tick_status(result.certificate, result.slip, rest, counted, wide)
        reach = self.workspace.obstacles.influence
        clearance = float(self.workspace.obstacles.clearance().min(initial=reach))
        strip = self.workspace.strip()
        self._certified, self._scene = _proven(result), scene
        self.clock.mark("report")
        return DeformReport(
            strip=strip,
            status=status,
            reason=reason,
            certificate=result.certificate,
            node_clearance=clearance,
            scene=scene,
            energies=result.energies,
            timings=self.clock.phases,
            seconds=self.clock.total(),
            iterations=iterations,
            moved=result.moved,
            slip=result.slip,
            asked=asked,
            forces=result.field if detail else None,
            tunnel=tunnel,
            connectivity_counts=paper is not None,
            heading_step=paper.heading_step if paper is not None else 0.0,
            task_errors=None if self.task is None else self.task.errors(self.workspace.kin),
        )


def _proven(result: TickResult) -> bool:
    """Whether what a tick came to could be driven: certified, and drivable by the wheels."""
    return result.certificate.certified and result.slip <= SLIP_LIMIT
