"""PaperDeformer: the tick of the paper, Eqs. 2-9 at the control points; its parameters and its report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision import BodySet, Certificate, ObstacleProximity, ProtectiveHulls
from elastic_strips.collision.strip_certificate import protective_hulls
from elastic_strips.errors import ParameterError
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip.forces import repulsive_potential
from elastic_strips.strip.params import StripParams
from elastic_strips.strip.report import DeformReport, DeformStatus, StripForces, tick_status
from elastic_strips.strip.settling import check_ending, run_ticks
from elastic_strips.strip.strip import Strip
from elastic_strips.strip.workspace import PhaseClock, TickResult, Workspace
from elastic_strips.validation import Count, NonNegative, Positive, check_type

from .equations import control_point_repulsion, elastic_force, elastic_torque, explicit_step, map_to_joints

_LINK_REACH = 0.3  # links' distances to obstacles are exact below this [m]; the forces act on control points
_SELF_REACH = 0.03  # those to each other


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperParams(StripParams):
    """Parameters of :class:`PaperDeformer`; all lengths [m], angles [rad]. k_r and k_c are in the paper's Table 1.

    See :class:`~elastic_strips.strip.params.StripParams` for the others.

    Attributes:
        alpha: joints' rotation coefficient (Eq. 8).
        transfer_tilt: Table 2's number, which the paper does not define. Here a quarter of it is the mobile's rotation
            coefficient α_m (Eq. 9), and it bounds the turn |δφ| of one update [rad].
        mobile_only: whether only the mobile's control point moves, as in the paper's cases 1–6.
        self_margin: a node's joints are not updated where that would bring its own links nearer than this.
        updates: explicit updates in one tick.
    """

    preset: ClassVar[str] = "paper"
    influence: Positive = 1.5
    k_r: NonNegative = 0.3
    k_c: Positive = 0.5
    rest_step: NonNegative = 2e-4
    max_ticks: Count = 120
    alpha: NonNegative = 0.25
    transfer_tilt: NonNegative = np.pi / 3
    mobile_only: bool = False
    self_margin: NonNegative = 0.02
    updates: Count = 10


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PaperReport(DeformReport):
    """Result of one tick, or of :meth:`PaperDeformer.settle`. It always has the protective hulls, and they count.

    Attributes:
        heading_step: largest turn of the mobile in one update [rad]; after ``settle`` that of all ticks.
    """

    connectivity_counts: ClassVar[bool] = True
    heading_step: float = 0.0

    @property
    def usable(self) -> bool:
        """Whether the strip could be driven: certified and connected."""
        return self.certified and self.connected

    @property
    def failure(self) -> DeformStatus:
        """Status of a strip that is not usable at the end."""
        return DeformStatus.BROKEN if self.connected else DeformStatus.BLOCKED


class PaperDeformer(OneThread):
    """Deforms strips of one robot as the paper prints it; owns mutable buffers, so one per thread.

    The base moves in x and y independently (Eq. 9), and the number of nodes stays.

    Args:
        robot: the robot of the strips.
        params: parameters.

    Attributes:
        control_points: the points that forces act on.

    Raises:
        ParameterError: ``params`` of another preset, or ``mobile_only`` for a robot without a mobile or without a
            control point on its axis.
    """

    def __init__(self, robot: RobotModel, params: PaperParams | None = None) -> None:
        params = PaperParams() if params is None else params
        check_type("params", params, PaperParams, ParameterError)
        self.workspace: Workspace = Workspace(
            robot,
            params,
            reach=max(_LINK_REACH, 2.0 * params.clearance),
            self_reach=max(_SELF_REACH, params.self_margin, 2.0 * params.self_clearance),
            self_influence=0.0,
        )
        self.share_with(self.workspace)
        self.robot: RobotModel = robot
        self._params: PaperParams = params
        self.clock: PhaseClock = self.workspace.clock
        space = robot.space
        if params.mobile_only and not space.planar:
            raise ParameterError(f"mobile_only=True, but the base of {robot.name!r} is fixed")
        self.control_points = BodySet.control_points(robot)
        points = robot.control_point_set
        at_base = (points.joint == 1) & (np.abs(points.local[:, :2]).max(axis=1) < 1e-9) & space.planar
        self._mobile = int(np.argmax(at_base)) if at_base.any() else None
        if params.mobile_only:
            if self._mobile is None:
                raise ParameterError("mobile_only=True, but no control point lies on the axis of the base; add one")
            self.control_points: BodySet = self.control_points.only(self._mobile)
            self._mobile = 0
        self._proximity = ObstacleProximity(self.control_points, influence=params.influence, slack=1.0)
        self._alpha = np.full(space.nv, 0.0 if params.mobile_only else params.alpha)
        self._alpha[: space.base_nv] = 0.0
        self._self_floor = np.minimum(0.8 * self.workspace.self_home, params.self_margin)
        self._heading_step = 0.0

    @property
    def params(self) -> PaperParams:
        """The parameters; other ones need another deformer."""
        return self._params

    @exclusive
    def step(self, strip: Strip, scene: Scene, *, budget: float | None = None, detail: bool = False) -> PaperReport:
        """One control tick: deform the strip away from the obstacles and certify it; see :meth:`Deformer.step`."""
        work = self.workspace
        already = work.queries
        work.begin(strip, scene, budget=budget, to_move=True)
        result = work.iterate(lambda: self._iterate(scene), budget)
        return self._report(scene, result, work.queries - already, detail)

    @exclusive
    def settle(
        self,
        strip: Strip,
        scene: Scene,
        *,
        max_ticks: int | None = None,
        until: str | Callable[[PaperReport], bool] = "rest",
        watch: Callable[[PaperReport], object] | None = None,
        detail: bool = False,
    ) -> PaperReport:
        """Ticks until the strip has converged, or is certified, or ``max_ticks`` are over; see :meth:`Deformer.settle`.

        Returns:
            The last tick's report; ``BLOCKED`` where the protective hulls do not connect.
        """
        limit = check_ending(self.params, until, max_ticks, watch)
        return run_ticks(
            lambda strip: self.step(strip, scene, detail=detail),
            strip,
            limit=limit,
            until=until,
            watch=watch,
            joined=lambda one, former: replace(one, heading_step=max(one.heading_step, former.heading_step)),
        )

    @exclusive
    def certify(self, strip: Strip, scene: Scene) -> Certificate:
        """Certify a strip as it is, without moving it."""
        self.workspace.begin(strip, scene)
        return self.workspace.certify(scene)

    @exclusive
    def assess(self, strip: Strip, scene: Scene, *, detail: bool = False) -> PaperReport:
        """Report on a strip as it is: certificate, clearance, hulls; nothing moves."""
        certificate = self.certify(strip, scene)
        return self._report(scene, TickResult(certificate, 0.0, 0.0, {}, StripForces.none()), 0, detail)

    @exclusive
    def reset(self) -> None:
        """Forget all that is kept from tick to tick, as is needed after an exception."""
        self.workspace.reset()

    # the parts of a tick

    def _iterate(self, scene: Scene) -> TickResult:
        """The updates of one tick; the kinematics follow all but the last."""
        work, turn = self.workspace, 0.0
        coordinates, energies, forces = work.coordinates, dict[str, float](), StripForces.none()
        for k in range(self.params.updates):
            coordinates, energies, forces = self._update(work.kin, scene)
            turn = max(turn, self._heading_step)
            self.clock.mark("forces")
            if not self.params.mobile_only:
                coordinates = self._check_joint_angles(coordinates)
            if k < self.params.updates - 1:
                work.kin.update(coordinates)
                self.clock.mark("kinematics")
        self._heading_step = turn
        moved = work.move(coordinates, scene)
        return TickResult(work.certify(scene), 0.0, moved, energies, forces)

    def _update(self, kin: Kinematics, scene: Scene) -> tuple[Array, dict[str, float], StripForces]:
        """New coordinates (N, nv), energies and repulsive forces of one update from the nodes of ``kin``."""
        params, space = self.params, self.robot.space
        self._proximity.update(kin, scene)
        points = self._points(kin)
        contacts = self._proximity.contacts()
        repulsion = control_point_repulsion(contacts, points.shape[:2], k_r=params.k_r, influence=params.influence)
        force = repulsion + elastic_force(points, params.k_c)
        torque = map_to_joints(kin, self.control_points.joint, points, force)
        coordinates = kin.coordinates[: kin.n]
        if space.planar:
            torque[:, 2] += elastic_torque(coordinates[:, 2], coordinates[:, :2], params.k_c)
        mobile_force = np.zeros((kin.n, 3)) if self._mobile is None else force[:, self._mobile]
        delta = explicit_step(
            torque,
            mobile_force,
            planar=space.planar,
            alpha=self._alpha,
            transfer_tilt=params.transfer_tilt,
            yaw=coordinates[:, 2] if space.planar else np.zeros(kin.n),
        )
        self._heading_step = float(np.abs(delta[:, 2]).max(initial=0.0)) if space.planar else 0.0
        moved = space.integrate(coordinates, delta)
        if space.planar:  # Eq. 9 displaces along a straight line, not along the arc of a twist
            cos, sin = np.cos(coordinates[:, 2]), np.sin(coordinates[:, 2])
            moved[:, 0] = coordinates[:, 0] + cos * delta[:, 0] - sin * delta[:, 1]
            moved[:, 1] = coordinates[:, 1] + sin * delta[:, 0] + cos * delta[:, 1]
        np.clip(moved, space.lower, space.upper, out=moved)
        nearest = np.full(points.shape[:2], params.influence)
        np.minimum.at(nearest, (contacts.node, contacts.body), contacts.distance)
        energies = {"repulsion": float(repulsive_potential(nearest, params.k_r, params.influence).sum())}
        node, body = np.nonzero((repulsion**2).sum(axis=2) > 0.0)
        return moved, energies, StripForces(points[node, body], repulsion[node, body])

    def _check_joint_angles(self, coordinates: Array) -> Array:
        """The paper's *check of joint angles*: nodes whose own links would come too close keep their joints."""
        work, b = self.workspace, self.robot.space.base_nv
        previous = work.coordinates.copy()
        work.kin.update(coordinates)
        work.self_pairs.update(work.kin)
        close = (work.self_pairs.bound < self._self_floor).any(axis=1)
        if close.any():
            coordinates = coordinates.copy()
            coordinates[close, b:] = previous[close, b:]
        work.kin.update(previous)
        self.clock.mark("self-collision")
        return coordinates

    def _points(self, kin: Kinematics) -> Array:
        """Control points (N, C, 3) [m]."""
        return self.control_points.capsule_ends(kin)[:, :, 0]

    def _hulls(self, scene: Scene) -> ProtectiveHulls:
        """Protective hulls of the nodes, capped at the safe distance."""
        kin = self.workspace.kin
        self._proximity.update(kin, scene)
        return protective_hulls(self._points(kin), self._proximity.clearance(), cap=self.params.influence)

    def _report(self, scene: Scene, result: TickResult, queries: int, detail: bool) -> PaperReport:
        hulls = self._hulls(scene)
        rest = result.moved < self.params.rest_step
        status, reason = tick_status(result.certificate, rest)
        if not hulls.connected.all():
            status = DeformStatus.BLOCKED if rest else DeformStatus.DEFORMING
            j = int(np.argmin(hulls.overlap.min(axis=1)))
            gap = -float(hulls.overlap[j].min())
            reason = f"the protective hulls of nodes {j} and {j + 1} do not overlap: {gap:.2f} m are missing"
        report = self.workspace.report(
            PaperReport, scene, result, queries, detail, status=status, reason=reason, hulls=hulls
        )
        return replace(report, heading_step=self._heading_step)
