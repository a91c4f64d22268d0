"""One update of the paper's strip: Eqs. 2–9 as printed, at the control points."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array

from ...errors import ParameterError
from ...proximity import BodySet, ObstacleProximity
from ...robot import Kinematics, RobotModel
from ...scene import Scene
from ...tunnel import Tunnel, protective_hulls
from ..forces import repulsive_potential
from ..params import DeformParams
from ..report import ForceField
from ..workspace import Workspace
from .equations import contraction_force, contraction_torque, control_point_repulsion, explicit_step, map_to_joints


class PaperStep:
    """Workspace of the paper preset's update."""

    def __init__(self, robot: RobotModel, params: DeformParams) -> None:
        self.robot, self.params = robot, params
        space = robot.space
        if params.mobile_only and not space.planar:
            raise ParameterError(f"mobile_only=True, but the base of {robot.name!r} is fixed")
        self.bodies = BodySet.control_points(robot)
        points = robot.control_point_set
        at_base = (points.joint == 1) & (np.abs(points.local[:, :2]).max(axis=1) < 1e-9) & space.planar
        self.mobile = int(np.argmax(at_base)) if at_base.any() else None
        if params.mobile_only:
            if self.mobile is None:
                raise ParameterError("mobile_only=True, but no control point lies on the axis of the base; add one")
            self.bodies = self.bodies.only(self.mobile)
            self.mobile = 0
        self.proximity = ObstacleProximity(self.bodies, influence=params.influence, slack=1.0)
        self.alpha = np.full(space.nv, 0.0 if params.mobile_only else params.alpha)
        self.alpha[: space.base_nv] = 0.0
        self.heading_step = 0.0

    def iterate(self, kin: Kinematics, scene: Scene) -> tuple[Array, dict[str, float], ForceField]:
        """New chart (N, nv), energies and repulsive forces of one update from the nodes of ``kin``."""
        params, space = self.params, self.robot.space
        self.proximity.update(kin, scene)
        points = self.points(kin)
        contacts = self.proximity.contacts()
        repulsion = control_point_repulsion(contacts, points.shape[:2], k_r=params.k_r, influence=params.influence)
        force = repulsion + contraction_force(points, params.k_c)
        torque = map_to_joints(kin, self.bodies.joint, points, force)
        chart = kin.chart[: kin.n]
        if space.planar:
            torque[:, 2] += contraction_torque(chart[:, 2], chart[:, :2], params.k_c)
        mobile_force = np.zeros((kin.n, 3)) if self.mobile is None else force[:, self.mobile]
        delta = explicit_step(
            torque,
            mobile_force,
            planar=space.planar,
            alpha=self.alpha,
            transfer_tilt=params.transfer_tilt,
            yaw=chart[:, 2] if space.planar else np.zeros(kin.n),
        )
        self.heading_step = float(np.abs(delta[:, 2]).max(initial=0.0)) if space.planar else 0.0
        moved = space.integrate(chart, delta)
        if space.planar:  # Eq. 9 displaces along a straight line, not along the arc of a twist
            cos, sin = np.cos(chart[:, 2]), np.sin(chart[:, 2])
            moved[:, 0] = chart[:, 0] + cos * delta[:, 0] - sin * delta[:, 1]
            moved[:, 1] = chart[:, 1] + sin * delta[:, 0] + cos * delta[:, 1]
        np.clip(moved, space.lower, space.upper, out=moved)
        nearest = np.full(points.shape[:2], params.influence)
        np.minimum.at(nearest, (contacts.node, contacts.body), contacts.distance)
        energies = {"repulsion": float(repulsive_potential(nearest, params.k_r, params.influence).sum())}
        node, body = np.nonzero((repulsion**2).sum(axis=2) > 0.0)
        return moved, energies, ForceField(points[node, body], repulsion[node, body])

    def advance(self, work: Workspace, scene: Scene) -> tuple[Array, dict[str, float], ForceField]:
        """The updates of one tick; the workspace's kinematics follow all but the last."""
        turn = 0.0
        energies: dict[str, float] = {}
        field = ForceField(np.zeros((0, 3)), np.zeros((0, 3)))
        chart = work.chart
        for k in range(self.params.updates):
            chart, energies, field = self.iterate(work.kin, scene)
            turn = max(turn, self.heading_step)
            work.clock.mark("forces")
            if not self.params.mobile_only:
                chart = self._check_joint_angles(work, chart)
            if k < self.params.updates - 1:
                work.kin.update(chart)
                work.clock.mark("kinematics")
        self.heading_step = turn
        return chart, energies, field

    def _check_joint_angles(self, work: Workspace, chart: Array) -> Array:
        """The paper's *check of joint angles*: nodes whose own links would come too close keep their joints."""
        previous, b = work.chart.copy(), self.robot.space.base_nv
        work.kin.update(chart)
        work.self_pairs.update(work.kin)
        close = (work.self_pairs.bound < work.self_floor).any(axis=1)
        if close.any():
            chart = chart.copy()
            chart[close, b:] = previous[close, b:]
        work.kin.update(previous)
        work.clock.mark("self-collision")
        return chart

    def points(self, kin: Kinematics) -> Array:
        """Control points (N, C, 3) [m]."""
        return self.bodies.capsule_ends(kin)[:, :, 0]

    def tunnel(self, kin: Kinematics, scene: Scene) -> Tunnel:
        """Protective hulls of the nodes, capped at the safe distance."""
        self.proximity.update(kin, scene)
        return protective_hulls(self.points(kin), self.proximity.clearance(), cap=self.params.influence)
