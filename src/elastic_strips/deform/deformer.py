"""Deformer: the control tick. Strip and scene in, certified strip and report out."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from ..errors import ConfigurationError, ParameterError
from ..maintenance import maintain
from ..proximity import BodySet, MotionBounds, ObstacleProximity, SelfProximity
from ..relax import project_rolling
from ..robot import Kinematics, RobotModel
from ..robot.space import Array
from ..scene import Scene
from ..strip import Strip
from ..tunnel import Certificate, Certifier, Tunnel, protective_hulls
from .clock import PhaseClock
from .default_step import DefaultStep
from .paper_step import PaperStep
from .params import DeformParams
from .report import DeformReport, DeformStatus, ForceField

_log = logging.getLogger(__name__)
SLIP_LIMIT = 1e-6
"""Sideways travel [m] of a segment above which a differential drive's strip is not drivable."""


class Deformer:
    """Workspace that deforms strips of one robot; one per thread.

    Give each report's strip back to the next :meth:`step`: then only what moved is computed anew.

    Args:
        robot: whose strips.
        params: parameters, or the name of a preset.
    """

    def __init__(self, robot: RobotModel, params: DeformParams | str = "default") -> None:
        if isinstance(params, str):
            params = DeformParams.for_preset(params)
        if not isinstance(params, DeformParams):
            raise ParameterError(f"params={params!r} is neither DeformParams nor the name of a preset")
        self.robot, self.params = robot, params
        self.bodies = BodySet.links(robot)
        self.bounds = MotionBounds(self.bodies)
        reach = params.influence if params.preset == "default" else 0.3
        self.kin = Kinematics(robot.tree, 64)
        self.obstacles = ObstacleProximity(self.bodies, influence=reach)
        self.self_pairs = self._self_proximity()
        self.certifier = Certifier(self.bodies, self.bounds, self.obstacles, self.self_pairs)
        self._default = DefaultStep(robot, params)
        self._paper = PaperStep(robot, params) if params.preset == "paper" else None
        self._strip: Strip | None = None
        self._held = False
        self._iteration = 0.0
        self._clock = PhaseClock()

    def _self_proximity(self) -> SelfProximity:
        """Self pairs, with repulsion that begins no further than 0.8 of what separates a pair at home by design."""
        params, pairs = self.params, self.robot.self_pairs
        reach = max(params.self_influence, params.self_margin, 2.0 * params.self_clearance)
        home = SelfProximity(self.bodies, pairs, self.bounds, influence=reach)
        kin = Kinematics(self.robot.tree, 1)
        kin.update(self.robot.space.to_chart(self.robot.home_q)[None])
        home.update(kin)
        self._self_floor = np.minimum(0.8 * home.bound[0], params.self_margin)
        repulsion = np.clip(0.8 * np.minimum(home.exact[0], reach), 0.0, params.self_influence)
        return SelfProximity(self.bodies, pairs, self.bounds, influence=reach, repulsion=repulsion)

    def step(
        self, strip: Strip, scene: Scene, *, budget: float | None = None, detail: bool = False, nodes: bool = True
    ) -> DeformReport:
        """One control tick: deform the strip away from the obstacles and certify it.

        Args:
            strip: the strip of the last report, or a new one of this robot.
            scene: snapshot of the obstacles.
            budget: time [s] to spend; iterations go on while another one fits, and it is exceeded by at most one.
                None makes exactly one iteration.
            detail: whether to add forces and protective hulls to the report, to look at.
            nodes: whether nodes may be inserted and removed.

        Raises:
            ConfigurationError: the strip belongs to another robot.
            ParameterError: a budget that is not a positive number.
        """
        if budget is not None and not (isinstance(budget, (int, float)) and budget > 0):
            raise ParameterError(f"budget={budget!r} must be a positive number of seconds, or None for one iteration")
        self._check(strip)
        clock = self._clock
        clock.start()
        asked = self.obstacles.narrow.queries + self.self_pairs.queries
        held = self._paper is None and strip is self._strip and self._held
        self._sync(strip, scene)
        self._strip = None  # until the report: an exception in between must not leave half a tick for the next
        iterations = 0
        while True:
            began = clock.elapsed
            before = self.kin.chart[: self.kin.n].copy()
            chart, residual, energies, field = self._iterate(scene)
            moved = self._accept(chart, scene)
            certificate = self._certify(scene)
            if held and not certificate.certified:
                certificate, residual, moved = self._hold(before, chart, scene, certificate, residual, moved)
            held = held and certificate.certified
            iterations += 1
            self._iteration = clock.elapsed - began
            rest = moved < self.params.rest_step
            if budget is None or clock.elapsed + self._iteration > budget or (rest and certificate.certified):
                break
        if self._paper is None and nodes:
            certificate, residual = self._maintain(scene, certificate, residual)
        return self._report(scene, certificate, residual, energies, field, moved, iterations, asked, detail)

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
        """
        if until not in ("rest", "certified"):
            raise ParameterError(f"until={until!r}; valid: 'rest', 'certified'")
        limit = self.params.max_ticks if max_ticks is None else max_ticks
        timings: dict[str, float] = {}
        seconds, asked, turn = 0.0, 0, 0.0
        report: DeformReport | None = None
        for tick in range(1, max(limit, 1) + 1):
            report = self.step(strip, scene, detail=detail)
            strip = report.strip
            seconds += report.seconds
            asked += report.asked
            turn = max(turn, report.heading_step)
            for phase, value in report.timings.items():
                timings[phase] = timings.get(phase, 0.0) + value
            if watch is not None:
                watch(report)
            done = report.moved < self.params.rest_step
            if done or (until == "certified" and report.certified and report.status is not DeformStatus.BLOCKED):
                break
        assert report is not None
        return self._final(report, scene, tick, timings, seconds, asked, turn)

    def certify(self, strip: Strip, scene: Scene) -> Certificate:
        """Certify a strip as it is, without moving it."""
        self._check(strip)
        self._sync(strip, scene)
        return self._certify(scene)

    def assess(self, strip: Strip, scene: Scene, *, detail: bool = False) -> DeformReport:
        """Report on a strip as it is: certificate, clearance, hulls; nothing moves."""
        self._check(strip)
        self._clock.start()
        self._sync(strip, scene)
        certificate = self._certify(scene)
        residual = float(strip.lateral_slip.max(initial=0.0)) if self._paper is None else 0.0
        return self._report(scene, certificate, residual, {}, ForceField(np.zeros((0, 3)), np.zeros((0, 3))), 0.0, 0, 0, detail)

    # the parts of a tick

    def _check(self, strip: Strip) -> None:
        if strip.robot is not self.robot and strip.robot.space.nq != self.robot.space.nq:
            raise ConfigurationError(
                f"the strip is of robot {strip.robot.name!r} (nq {strip.robot.nq}), the deformer of "
                f"{self.robot.name!r} (nq {self.robot.nq})"
            )

    def _sync(self, strip: Strip, scene: Scene) -> None:
        if strip is not self._strip:
            self.kin.update(strip.chart)
            self._strip, self._held = strip, False
        self._clock.mark("kinematics")
        self.obstacles.update(self.kin, scene)
        self._clock.mark("proximity")
        self.self_pairs.update(self.kin)
        self._clock.mark("self-collision")

    def _iterate(self, scene: Scene) -> tuple[Array, float, dict[str, float], ForceField]:
        if self._paper is not None:
            return self._paper_updates(self._paper, scene)
        return self._default.iterate(self.kin, self.obstacles, self.self_pairs, self._clock)

    def _paper_updates(
        self, paper: PaperStep, scene: Scene
    ) -> tuple[Array, float, dict[str, float], ForceField]:
        """The explicit updates of one tick; the last one is left to :meth:`_accept`."""
        turn = 0.0
        for k in range(self.params.updates):
            chart, energies, field = paper.iterate(self.kin, scene)
            turn = max(turn, paper.heading_step)
            self._clock.mark("forces")
            if not self.params.mobile_only:
                chart = self._check_joint_angles(chart)
            if k < self.params.updates - 1:
                self.kin.update(chart)
                self._clock.mark("kinematics")
        paper.heading_step = turn
        return chart, 0.0, energies, field

    def _check_joint_angles(self, chart: Array) -> Array:
        """The paper's *check of joint angles*: nodes whose own links would come too close keep their joints."""
        previous, b = self.kin.chart[: self.kin.n].copy(), self.robot.space.base_nv
        self.kin.update(chart)
        self.self_pairs.update(self.kin)
        close = (self.self_pairs.bound < self._self_floor).any(axis=1)
        if close.any():
            chart = chart.copy()
            chart[close, b:] = previous[close, b:]
        self.kin.update(previous)
        self._clock.mark("self-collision")
        return chart

    def _accept(self, chart: Array, scene: Scene) -> float:
        """Make the new nodes current; returns how far the fastest base or joint moved."""
        moved = float(np.abs(chart - self.kin.chart[: self.kin.n]).max(initial=0.0))
        self.kin.update(chart)
        self._clock.mark("kinematics")
        self.obstacles.update(self.kin, scene)
        self._clock.mark("proximity")
        self.self_pairs.update(self.kin)
        self._clock.mark("self-collision")
        return moved

    def _hold(
        self, before: Array, chart: Array, scene: Scene, certificate: Certificate, residual: float, moved: float
    ) -> tuple[Certificate, float, float]:
        """A step from a certified strip must not lose the certificate where a shorter one, or none, would keep it."""
        space = self.robot.space
        for scale in (0.5, 0.0):
            nodes, slip = before, 0.0
            if scale > 0.0:
                nodes = space.integrate(before, scale * space.difference(before, chart))
                if self._default.rolling:
                    nodes, slip = project_rolling(space, nodes)
            self._accept(nodes, scene)
            attempt = self._certify(scene)
            if attempt.certified and slip <= SLIP_LIMIT:
                return attempt, slip, scale * moved
        self._accept(chart, scene)  # nothing holds: the full step is the way out
        return certificate, residual, moved

    def _certify(self, scene: Scene) -> Certificate:
        chart = self.kin.chart[: self.kin.n]
        v = self.robot.space.difference(chart[:-1], chart[1:])
        certificate = self.certifier.certify(
            self.kin, v, clearance=self.params.clearance, self_clearance=self.params.self_clearance, scene=scene
        )
        self._clock.mark("certificate")
        return certificate

    def _maintain(self, scene: Scene, certificate: Certificate, residual: float) -> tuple[Certificate, float]:
        params, space = self.params, self.robot.space
        edit = maintain(
            space, self.kin.chart[: self.kin.n], weight=self._default.spacing_weight, max_spacing=params.max_spacing,
            min_spacing=params.min_spacing, split=~certificate.segments, max_nodes=params.max_nodes,
        )  # fmt: skip
        self._clock.mark("maintenance")
        if edit is None:
            return certificate, residual
        chart = edit.chart
        if edit.removed and self._default.rolling:
            chart, residual = project_rolling(space, chart)
        self.obstacles.remap(edit.source)
        self.self_pairs.remap(edit.source)
        self._clock.mark("maintenance")
        self._accept_edit(chart, scene)
        return self._certify(scene), residual

    def _accept_edit(self, chart: Array, scene: Scene) -> None:
        self.kin.update(chart)
        self._clock.mark("kinematics")
        self.obstacles.update(self.kin, scene)
        self._clock.mark("proximity")
        self.self_pairs.update(self.kin)
        self._clock.mark("self-collision")

    def _tunnel(self, scene: Scene) -> Tunnel:
        if self._paper is not None:
            return self._paper.tunnel(self.kin, scene)
        points = self.robot.control_point_set
        local = np.einsum("cji,cj->ci", self.robot.tree.align[points.joint], points.local)
        world = self.kin.points(points.joint, local)
        link = np.minimum(self.obstacles.clearance().min(axis=1), self.params.influence)
        return protective_hulls(world, np.repeat(link[:, None], len(points.names), axis=1), cap=self.params.influence)

    def _report(
        self, scene: Scene, certificate: Certificate, residual: float, energies: dict[str, float], field: ForceField,
        moved: float, iterations: int, asked: int, detail: bool,
    ) -> DeformReport:  # fmt: skip
        strip = Strip.from_chart(self.robot, self.kin.chart[: self.kin.n])
        self._strip = strip
        self._held = certificate.certified and residual <= SLIP_LIMIT
        rest = moved < self.params.rest_step
        tunnel = self._tunnel(scene) if detail or self._paper is not None else None
        status, reason = self._status(certificate, residual, rest, tunnel)
        queries = self.obstacles.narrow.queries + self.self_pairs.queries - asked
        clearance = float(self.obstacles.clearance().min(initial=self.obstacles.influence))
        self._clock.mark("report")
        return DeformReport(
            strip=strip, status=status, reason=reason, certificate=certificate, clearance=clearance, energies=energies,
            timings=self._clock.phases, seconds=self._clock.total(), iterations=iterations, moved=moved, asked=queries,
            forces=field if detail else None, tunnel=tunnel,
            heading_step=self._paper.heading_step if self._paper is not None else 0.0,
        )  # fmt: skip

    def _status(
        self, certificate: Certificate, residual: float, rest: bool, tunnel: Tunnel | None
    ) -> tuple[DeformStatus, str]:
        if residual > SLIP_LIMIT:
            return DeformStatus.DEFORMING, f"a segment slips sideways by {residual:.2e} m, more than {SLIP_LIMIT:g} m"
        if self._paper is not None and tunnel is not None and not tunnel.connected.all():
            j = int(np.argmin(tunnel.overlap.min(axis=1)))
            gap = -float(tunnel.overlap[j].min())
            status = DeformStatus.BLOCKED if rest else DeformStatus.DEFORMING
            return status, f"the protective hulls of nodes {j} and {j + 1} do not overlap: {gap:.2f} m are missing"
        if not certificate.certified:
            return (DeformStatus.BROKEN if rest else DeformStatus.DEFORMING), str(certificate.broken)
        if rest:
            return DeformStatus.SETTLED, "certified and at rest"
        return DeformStatus.DEFORMING, "certified, still moving"

    def _final(
        self, report: DeformReport, scene: Scene, ticks: int, timings: dict[str, float], seconds: float, asked: int, turn: float
    ) -> DeformReport:  # fmt: skip
        status, reason = report.status, report.reason
        if status is DeformStatus.DEFORMING:
            if report.certified and "slips" not in reason and "hulls" not in reason:
                status, reason = DeformStatus.SETTLED, f"certified after {ticks} ticks"
            elif "hulls" in reason:
                status = DeformStatus.BLOCKED
            else:
                status, reason = DeformStatus.BROKEN, f"{reason} (after {ticks} ticks)"
        return DeformReport(
            strip=report.strip, status=status, reason=reason, certificate=report.certificate, clearance=report.clearance,
            energies=report.energies, timings=timings, seconds=seconds, iterations=ticks, ticks=ticks, moved=report.moved,
            asked=asked, forces=report.forces, tunnel=report.tunnel, heading_step=turn,
        )  # fmt: skip
