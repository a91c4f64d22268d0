"""Hybrid control: the paper's three layers for one task."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

import numpy.typing as npt

from elastic_strips.control.controller import Controller, ControllerOptions
from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.control.params import DriveParams
from elastic_strips.control.replanning import Replanned, Replanner, standing
from elastic_strips.control.strip_timer import PlanOutcome, PlanResult
from elastic_strips.errors import ConfigurationError, ParameterError, RobotError
from elastic_strips.planning import PlanReport
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip.constraint import AxisConstraint, ConstraintForce
from elastic_strips.strip.report import DeformReport
from elastic_strips.validation import check_able, check_count, check_type, shown

from .sequencing import Blackboard, Order, SequencingLayer
from .tasks import DeliberativeLayer, DriveAndReach, DriveTo, ReachHand, Task, TaskPlan

if TYPE_CHECKING:
    from typing_extensions import Unpack

_MOST_RETRY_GROWTH = 8
"""Largest factor by which the time between attempts to resume grows."""


class ConstraintState(str, Enum):
    """``KEPT``: every node satisfies the constraint. ``TRYING``: its forces act, and it is not satisfied yet.
    ``SUSPENDED``: its forces are off, so that the strip can avoid obstacles."""

    KEPT = "kept"
    TRYING = "trying"
    SUSPENDED = "suspended"


@dataclass(frozen=True, slots=True)
class ConstraintEvent:
    """A change of a constraint's state at a time [s], and the reason."""

    time: float
    state: ConstraintState
    reason: str


class ConstraintMonitor:
    """Workspace: switches a deformer's constraint off and on, tick by tick.

    No step of a deformer loses the certificate of a strip, so that resuming the constraint is safe.

    Args:
        force: ``deformer.constraint``.
        patience: successive ticks in which the constraint may be violated, or the strip broken, before it is suspended.
        retry: ticks from then to the next attempt; twice as many after every failed one.

    Attributes:
        state, reason: state of the constraint, and why.
        events: their changes.
    """

    def __init__(self, force: ConstraintForce, *, patience: int = 10, retry: int = 20) -> None:
        if not (patience >= 1 and retry >= 1):
            raise ParameterError(
                f"ConstraintMonitor: patience={patience!r} and retry={retry!r} must be at least 1 tick"
            )
        self.force: ConstraintForce = force
        self.patience: int = patience
        self.retry: int = retry
        self.state: ConstraintState = ConstraintState.TRYING
        self.reason: str = "the task begins"
        self.events: list[ConstraintEvent] = []
        self._missed = self._waited = 0
        self._wait = retry

    def update(self, t: float, report: DeformReport) -> ConstraintState:
        """Switch the constraint for the next tick, by the report of this one.

        Args:
            t: time [s].
            report: the report of the deformer with the constraint.

        Raises:
            ParameterError: the report is of a deformer without a constraint.
        """
        errors = report.constraint_errors
        if errors is None:
            raise ParameterError("ConstraintMonitor.update: the report is of a deformer without a task")
        if self.state is ConstraintState.SUSPENDED:
            self._waited += 1
            if self._waited >= self._wait and report.certified:
                self._enter(t, ConstraintState.TRYING, "the strip is certified: it is tried again")
            return self.state
        worst = int(errors.argmax())
        missed = bool(errors[worst] > self.force.constraint.tolerance)
        if not missed and report.certified:
            self._missed = 0
            if self.state is not ConstraintState.KEPT:
                self._wait = self.retry
                self._enter(t, ConstraintState.KEPT, f"every node is within {self.force.constraint.tolerance:g} rad")
            return self.state
        self._missed += 1
        if self._missed >= self.patience:
            reason = (
                f"node {worst} of {len(errors)} is {errors[worst]:.3f} rad off, "
                f"{self.force.constraint.tolerance:g} allowed"
                if missed
                else f"the strip is broken: {report.certificate.broken}"
            )
            if self.state is ConstraintState.TRYING and any(e.state is ConstraintState.SUSPENDED for e in self.events):
                self._wait = min(2 * self._wait, _MOST_RETRY_GROWTH * self.retry)
            self._enter(t, ConstraintState.SUSPENDED, reason)
        return self.state

    def _enter(self, t: float, state: ConstraintState, reason: str) -> None:
        self.state, self.reason = state, reason
        self.force.active = state is not ConstraintState.SUSPENDED
        self._missed = self._waited = 0
        self.events.append(ConstraintEvent(t, state, reason))


class PathService(Replanner):
    """Workspace: a replanner that reports why a strip cannot be followed, and plans another one only on request.

    Attributes:
        trouble: why the strip cannot be followed; empty where it can.
        attempts: paths requested since the last goal.
    """

    flows = False  # the steps of a task are done one after the other

    def __init__(self, robot: RobotModel, params: DriveParams, *, seed: int, grid: bool) -> None:
        super().__init__(robot, params, seed=seed, grid=grid)
        self.trouble: str = ""
        self.attempts: int = 0
        self._requested = False

    def begin(self, report: PlanReport) -> None:
        """Told of the first path of a step; see :meth:`Replanner.begin`."""
        self.attempts, self._requested = 0, False
        self.trouble = "" if report.certified else report.reason

    def request(self) -> None:
        """Request another path."""
        self._requested = True

    def watch(self, t: float, result: PlanResult, scene: Scene, *, at_rest: bool) -> str:
        """Check a tick's strip; returns why another one is planned, once it has been requested, or ""."""
        found = super().watch(t, result, scene, at_rest=at_rest)
        self.pending = False
        if found:
            self.trouble = found
        elif result.accepted or result.outcome is PlanOutcome.UNCHANGED:
            self.trouble = ""
        if not self._requested:
            return ""
        self._requested = False
        self.demand(t + self.params.replan_time)
        return self.trouble

    def take(self, found: Replanned) -> None:
        """Told of another path; see :meth:`Replanner.take`."""
        super().take(found)
        self.attempts += 1
        self.trouble = "" if found.strip is not None else found.reason


def deliberate(
    robot: RobotModel,
    start: npt.ArrayLike,
    task: Task,
    scene: Scene,
    *,
    params: DriveParams | None = None,
    seed: int = 0,
) -> TaskPlan:
    """Decompose a task into steps.

    Args:
        robot: the robot.
        start: configuration (nq,).
        task: the task to do.
        scene: known obstacles; moving ones are ignored.
        params: parameters of the drive: goals keep a little more than its clearance.
        seed: seed of the search for goals.

    Returns:
        The plan; without steps where the task cannot be done, with the reason.

    Raises:
        ParameterError: not a task.
    """
    check_type("robot", robot, RobotModel, RobotError)
    check_type("params", params, DriveParams, none=True)
    check_count("seed", seed)
    if not isinstance(task, (DriveTo, ReachHand, DriveAndReach)):
        raise ParameterError(f"task must be a DriveTo, a ReachHand or a DriveAndReach, not {shown(task)}")
    layer = DeliberativeLayer(robot, seed=seed, margin=(params or DriveParams()).clearance + 0.01)
    return layer.decompose(task, start, standing(scene))


class HybridControl(Controller):
    """Workspace: a :class:`Controller` with a sequencing layer, for the steps of a task.

    The deliberative layer decomposes the task (:func:`deliberate`); the sequencing layer orders its steps; the reactive
    layer, the controller with its strip and its supervisor, moves the robot. Steps and paths are passed down, the
    blackboard up.

    Args:
        robot: the robot.
        start: configuration (nq,).
        plan: plan of the deliberative layer; at least one step.
        scene: obstacles known before the first step; none where None.
        keep: constraint on the strip; suspended while it cannot be satisfied.
        params: parameters of the drive.
        seed: seed of the planner.
        look: called after every planning tick, with this control.
        **options: of the :class:`Controller`: limits, strip, path, workers, meter, events.

    Attributes:
        paths: plans paths when the sequencing layer requests them.
        sequencing: the layer.
        constraint_monitor: monitor of the constraint, or None.
        orders: (time [s], order, reason) of the sequencing layer, at every change.

    Raises:
        MissingExtraError: py_trees (extra ``control``) is not installed.
        ConfigurationError: there is no step, or start is not valid, or in collision.
    """

    def __init__(
        self,
        robot: RobotModel,
        start: npt.ArrayLike,
        plan: TaskPlan,
        scene: Scene | None = None,
        *,
        keep: AxisConstraint | None = None,
        params: DriveParams | None = None,
        seed: int = 0,
        look: Callable[[HybridControl], object] | None = None,
        **options: Unpack[ControllerOptions],
    ) -> None:
        check_type("robot", robot, RobotModel, RobotError)
        check_type("keep", keep, AxisConstraint, none=True)
        check_type("params", params, DriveParams, none=True)
        check_able("look", look)
        if not plan.steps:
            raise ConfigurationError(f"the task has no steps: {plan.reason}")
        params = replace(params or DriveParams(), constraint=keep)
        self.look = look
        self.sequencing: SequencingLayer = SequencingLayer(
            [str(s) for s in plan.steps], max_scene_age=params.max_scene_age
        )
        self.paths: PathService = PathService(robot, params, seed=seed, grid=robot.space.planar)
        goals = [s.q for s in plan.steps]
        super().__init__(robot, start, goals, scene, params=params, replanner=self.paths, seed=seed, **options)
        force = self.planner.deformer.constraint
        self.constraint_monitor: ConstraintMonitor | None = None if force is None else ConstraintMonitor(force)
        self.orders: list[tuple[float, Order, str]] = []
        self._report: object = None

    def step(self, t: float, measurement: Measurement | None, scene: Scene | None, *, trouble: str = "") -> Command:
        """One control period, as :meth:`Controller.step`; the layers above run after every planning tick."""
        command = super().step(t, measurement, scene, trouble=trouble)
        self._watch()
        return command

    def plan(self, t: float, scene: Scene | None, *, trouble: str = "") -> None:
        """One planning tick, as :meth:`Controller.plan`, and the layers above."""
        super().plan(t, scene, trouble=trouble)
        self._watch()

    def decide(self) -> Order:
        """Tick the sequencing layer with the present blackboard."""
        board = Blackboard(
            scene_age=self.time - self.scene.time,
            localized=self.executor.lost_for <= 0.1,
            trouble=self.paths.trouble,
            planning=self.paths.pending,
            attempts=self.paths.attempts,
            reached=self.reached,
        )
        order = self.sequencing.tick(board)
        if not self.orders or self.orders[-1][1:] != (order, self.sequencing.reason):
            self.orders.append((self.time, order, self.sequencing.reason))
        return order

    def _watch(self) -> None:
        if self.tick is None or self.tick.time != self.time:
            return
        report = None if self.result is None else self.result.report
        if self.constraint_monitor is not None and report is not None and report is not self._report:
            self._report = report
            self.constraint_monitor.update(self.time, report)
        order = self.decide()
        if order is Order.REQUEST_PATH:
            self.paths.request()
        elif order is Order.GIVE_UP:
            self.stop()
        if self.look is not None:
            self.look(self)
