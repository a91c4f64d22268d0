"""Hybrid control: the paper's three layers at work on one task."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy.typing as npt

from ...deform import AxisTask, DeformReport
from ...deform.task import TaskForce
from ...errors import ConfigurationError, ParameterError, RobotError
from ...planning import PlanReport
from ...robot import RobotModel
from ...scene import Scene
from ...strip import Strip
from ...validation import check_able, check_count, check_type, shown
from ..controller import Controller
from ..interfaces import Command, Measurement, RunState
from ..params import DriveParams
from ..replanning import Replanner, standing
from ..strip_timer import Proposal
from .sequencing import Facts, Order, SequencingLayer
from .tasks import Deliberation, DeliberativeLayer, DriveAndReach, DriveTo, ReachHand, Task

_LONGEST = 8
"""Attempts to resume come at most so many times as rarely as the first."""


class TaskState(str, Enum):
    """``KEPT``: every node keeps to the task. ``TRYING``: it pushes, and is not kept yet. ``SUSPENDED``: it does not
    push, so that the strip can do what the obstacles ask for."""

    KEPT = "kept"
    TRYING = "trying"
    SUSPENDED = "suspended"


@dataclass(frozen=True, slots=True)
class TaskEvent:
    """The state of a task from a time [s] on, and why."""

    time: float
    state: TaskState
    reason: str


class TaskWatch:
    """Workspace: switches a deformer's task off and on, tick by tick.

    With its task a certified strip stays certified, since no step may lose that; so an attempt to resume it risks
    nothing, and is simply made.

    Args:
        force: the deformer's task, ``deformer.task``.
        patience: so many ticks in a row a task may be missed, or the strip be broken, before it is suspended.
        retry: so many ticks after that it is tried again, and twice as many after every attempt in vain.

    Attributes:
        state, reason: of the task.
        events: how they changed.
    """

    def __init__(self, force: TaskForce, *, patience: int = 10, retry: int = 20) -> None:
        if not (patience >= 1 and retry >= 1):
            raise ParameterError(f"TaskWatch: patience={patience!r} and retry={retry!r} must be at least 1 tick")
        self.force, self.patience, self.retry = force, patience, retry
        self.state, self.reason = TaskState.TRYING, "the task begins"
        self.events: list[TaskEvent] = []
        self._missed = self._waited = 0
        self._wait = retry

    def update(self, t: float, report: DeformReport) -> TaskState:
        """Look at a tick's report and set the switch for the next one.

        Args:
            t: time [s].
            report: of the deformer that has the task.
        """
        errors = report.task_errors
        if errors is None:
            raise ParameterError("TaskWatch.update: the report is of a deformer without a task")
        if self.state is TaskState.SUSPENDED:
            self._waited += 1
            if self._waited >= self._wait and report.certified:
                self._enter(t, TaskState.TRYING, "the strip is certified: it is tried again")
            return self.state
        worst = int(errors.argmax())
        missed = bool(errors[worst] > self.force.task.tolerance)
        if not missed and report.certified:
            self._missed = 0
            if self.state is not TaskState.KEPT:
                self._wait = self.retry
                self._enter(t, TaskState.KEPT, f"every node is within {self.force.task.tolerance:g} rad")
            return self.state
        self._missed += 1
        if self._missed >= self.patience:
            reason = (
                f"node {worst} of {len(errors)} is {errors[worst]:.3f} rad off, {self.force.task.tolerance:g} allowed"
                if missed
                else f"the strip is broken: {report.certificate.broken}"
            )
            if self.state is TaskState.TRYING and any(e.state is TaskState.SUSPENDED for e in self.events):
                self._wait = min(2 * self._wait, _LONGEST * self.retry)
            self._enter(t, TaskState.SUSPENDED, reason)
        return self.state

    def _enter(self, t: float, state: TaskState, reason: str) -> None:
        self.state, self.reason = state, reason
        self.force.active = state is not TaskState.SUSPENDED
        self._missed = self._waited = 0
        self.events.append(TaskEvent(t, state, reason))


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


def deliberate(
    robot: RobotModel,
    start: npt.ArrayLike,
    task: Task,
    scene: Scene,
    *,
    params: DriveParams | None = None,
    seed: int = 0,
) -> Deliberation:
    """Divide a task into steps; where it cannot be done there are none, and the reason says why.

    Args:
        robot: the robot.
        start: configuration (nq,).
        task: what to do.
        scene: what is known of the obstacles.
        params: of the drive: goals keep a little more than its clearance.
        seed: of all that is sampled.
    """
    check_type("robot", robot, RobotModel, RobotError)
    check_type("params", params, DriveParams, none=True)
    check_count("seed", seed)
    if not isinstance(task, (DriveTo, ReachHand, DriveAndReach)):
        raise ParameterError(f"task must be a DriveTo, a ReachHand or a DriveAndReach, not {shown(task)}")
    layer = DeliberativeLayer(robot, seed=seed, margin=(params or DriveParams()).clearance + 0.01)
    return layer.divide(task, start, standing(scene))


class HybridControl(Controller):
    """Workspace: sequencing and reactive layer for the steps of a task; it takes steps as every :class:`Controller`.

    The deliberative layer divides the task (:func:`deliberate`); the sequencing layer has its steps done one after the
    other; the reactive layer, the controller with its strip and its supervisor, moves the robot. Each knows the next by
    a few calls only: steps and paths come down, facts and troubles go up.

    Args:
        robot: the robot.
        start: configuration (nq,).
        deliberation: what the deliberative layer made of the task; at least one step.
        scene: what is known before the robot sets out; nothing where None.
        keep: what the strip is to keep to meanwhile; suspended where that cannot be, and resumed.
        params: of the drive.
        seed: of the planner.
        look: called after every planning tick, with this control.
        **options: of the :class:`Controller`.

    Attributes:
        director: plans paths when the sequencing layer asks.
        sequencing: the layer.
        keeping: watches what is to be kept to, or None.
        orders: (time [s], order, reason) of the sequencing layer, wherever they changed.

    Raises:
        MissingExtraError: py_trees (extra ``control``) is not installed.
        ConfigurationError: there is no step, or start is not sound, or in collision.
    """

    def __init__(
        self,
        robot: RobotModel,
        start: npt.ArrayLike,
        deliberation: Deliberation,
        scene: Scene | None = None,
        *,
        keep: AxisTask | None = None,
        params: DriveParams | None = None,
        seed: int = 0,
        look: Callable[[HybridControl], object] | None = None,
        **options: Any,
    ) -> None:
        check_type("robot", robot, RobotModel, RobotError)
        check_type("keep", keep, AxisTask, none=True)
        check_type("params", params, DriveParams, none=True)
        check_able("look", look)
        if not deliberation.steps:
            raise ConfigurationError(f"the task has no steps: {deliberation.reason}")
        params = replace(params or DriveParams(), task=keep)
        self.deliberation, self.look = deliberation, look
        self.sequencing = SequencingLayer([str(s) for s in deliberation.steps], max_scene_age=params.max_scene_age)
        self.director = Director(robot, params, seed=seed, grid=robot.space.planar)
        goals = [s.q for s in deliberation.steps]
        super().__init__(robot, start, goals, scene, params=params, replanner=self.director, seed=seed, **options)
        force = self.pilot.deformer.task
        self.keeping = None if force is None else TaskWatch(force)
        self.orders: list[tuple[float, Order, str]] = []
        self._report: object = None

    def step(self, t: float, measurement: Measurement | None, scene: Scene | None, *, trouble: str = "") -> Command:
        """One control period, and after a planning tick the layers above have their turn: :meth:`Controller.step`."""
        command = super().step(t, measurement, scene, trouble=trouble)
        if self.tick is not None and self.tick.time == t:
            self._watch()
        return command

    def decide(self) -> Order:
        """What the sequencing layer makes of the facts."""
        reached = len(self.deliberation.steps) - 1 - len(self.goals)
        reached += self.state is RunState.REACHED
        facts = Facts(
            scene_age=self.time - self.scene.time,
            localized=self.estimator.lost_for <= 0.1,
            trouble=self.director.trouble,
            planning=self.director.pending,
            attempts=self.director.attempts,
            reached=reached,
        )
        order = self.sequencing.tick(facts)
        if not self.orders or self.orders[-1][1:] != (order, self.sequencing.reason):
            self.orders.append((self.time, order, self.sequencing.reason))
        return order

    def _watch(self) -> None:
        proposal = self.proposal
        if self.keeping is not None and proposal is not None and proposal.report is not self._report:
            self._report = proposal.report
            self.keeping.update(self.time, proposal.report)
        order = self.decide()
        if order is Order.ASK:
            self.director.ask()
        elif order is Order.GIVE_UP:
            self.stop()
        if self.look is not None:
            self.look(self)
