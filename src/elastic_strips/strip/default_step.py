"""One iteration of the default preset: forces at witness points, implicit update, exact rolling constraint."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array

from ..proximity import ObstacleProximity, SelfProximity
from ..robot import BaseKind, Kinematics, RobotModel
from .constraint import TaskForce
from .forces import add_elastic, add_joint_limits, add_posture, add_repulsion, add_self_repulsion
from .params import DeformParams
from .report import ForceField, PhaseClock
from .rolling import project_rolling
from .solver import BandedSolver, System

_STEP_LEVER = 0.4  # an angle counts at least so many metres a radian in the bound of a step


class DefaultStep:
    """Workspace of the default preset's iteration."""

    def __init__(self, robot: RobotModel, params: DeformParams) -> None:
        self.robot, self.params = robot, params
        space = robot.space
        b = space.base_nv
        lever = np.ones(space.nv)
        lever[b:] = params.joint_lever
        sliding = robot.tree.prismatic[robot.tree.chart_index >= 0]
        lever[b:][sliding] = 1.0
        if b:
            lever[2] = params.yaw_lever
        self.step_lever = np.maximum(lever, _STEP_LEVER)
        self.spacing_weight = lever**2
        self.weight = params.k_c * self.spacing_weight
        self.damping = params.damping * self.spacing_weight
        self.rolling = robot.base_kind is BaseKind.DIFF_DRIVE
        if self.rolling:
            self.weight = self.weight.copy()
            self.weight[1] += params.rolling_stiffness
        self._posture = np.zeros(space.nv)
        self._posture[b:] = params.k_posture * self.spacing_weight[b:]
        self._solver = BandedSolver()
        self._system = System(0, space.nv)

    def iterate(
        self,
        kin: Kinematics,
        obstacles: ObstacleProximity,
        self_pairs: SelfProximity,
        clock: PhaseClock,
        trust: float = 1.0,
        task: TaskForce | None = None,
    ) -> tuple[Array, float, dict[str, float], ForceField]:
        """One step from the nodes of ``kin``: new chart (N, nv), rolling residual [m], energies, external forces.

        ``trust`` in (0, 1] shortens the bound of the step; ``task`` is what the strip is to keep to.
        """
        params, space = self.params, self.robot.space
        n = kin.n
        chart = kin.chart[:n]
        if self._system.force.shape[0] != n:
            self._system = System(n, space.nv)
        system = self._system
        system.clear()
        v = space.difference(chart[:-1], chart[1:])
        add_elastic(system, space, v, self.weight)
        contacts = obstacles.contacts()
        add_repulsion(
            system, kin, contacts, obstacles.bodies.joint,
            k_r=params.k_r, influence=params.influence, k_near=params.k_near, near=min(params.near, params.influence),
        )  # fmt: skip
        add_self_repulsion(system, kin, self_pairs, self_pairs.contacts(), k_s=params.k_self)
        add_joint_limits(system, space, chart, k_l=params.k_limit * params.joint_lever**2, margin=params.limit_margin)
        if task is not None:
            task.push(system, kin)
        if params.k_posture > 0.0:
            fraction = np.linspace(0.0, 1.0, n)
            target = space.interpolate(chart[:1], chart[-1:], fraction)
            add_posture(system, space, chart, target, k_p=self._posture)
        clock.mark("forces")
        delta = self._solver.solve(system, self.damping)
        largest = float(np.abs(delta * self.step_lever).max(initial=0.0))
        limit = trust * params.max_step
        if largest > limit:
            delta *= limit / largest
        clock.mark("solve")
        moved = self.finish(chart, delta)
        residual = 0.0
        if self.rolling:
            moved, residual = project_rolling(space, moved)
        clock.mark("rolling")
        push = params.k_r * (params.influence - contacts.distance)
        field = ForceField(contacts.witness, push[:, None] * contacts.direction)
        return moved, residual, dict(system.energies), field

    def finish(self, chart: Array, delta: Array) -> Array:
        """Integrate the displacements and keep every joint inside its limits."""
        moved = self.robot.space.integrate(chart, delta)
        return np.clip(moved, self.robot.space.lower, self.robot.space.upper, out=moved)
