"""Control room, hybrid control: the three layers of the paper's Fig. 1 at work on one task."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy.typing as npt

from ..deform import AxisTask
from ..errors import ConfigurationError, ParameterError, RobotError
from ..execution import Controller, DriveParams, DriveResult, PerceptionParams, RunState, Simulation, simulation
from ..execution.perception import Perceiver
from ..execution.replanning import standing
from ..robot import RobotModel
from ..scene import Scene, World
from ..summary import Summary
from ..validation import check_able, check_count, check_type, shown
from .deliberative import Deliberation, DeliberativeLayer
from .director import Director
from .sequencing import Facts, Order, SequencingLayer
from .task_watch import TaskEvent, TaskWatch
from .tasks import DriveAndReach, DriveTo, ReachHand, Task


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class HybridResult(Summary):
    """What became of a task.

    Attributes:
        done: whether all its steps were reached.
        reason: why it ended.
        deliberation: its steps.
        drive: what was driven, or None where the task could not be begun.
        orders: (time [s], order, reason) of the sequencing layer, wherever they changed.
        task_events: how a task that was to be kept to was suspended and resumed.
    """

    done: bool
    reason: str
    deliberation: Deliberation
    drive: DriveResult | None
    orders: tuple[tuple[float, Order, str], ...]
    task_events: tuple[TaskEvent, ...]


class HybridControl:
    """Workspace: deliberative, sequencing and reactive layer for one task.

    The deliberative layer divides the task; the sequencing layer has its steps done one after the other; the reactive
    layer, a :class:`~elastic_strips.execution.Controller` with its strip and its supervisor, moves the robot. Each
    knows the next by a few calls only: steps and paths come down, facts and troubles go up.

    Args:
        robot: the robot.
        world: the obstacles over time.
        start: configuration (nq,).
        task: what to do.
        keep: what the strip is to keep to meanwhile; suspended where that cannot be, and resumed.
        params: of the drive.
        perception: what tells all three layers about the world; see :func:`~elastic_strips.execution.simulation`.
        seed: of all that is sampled, and of the machine.
        watch: called after every planning tick, with this control.
        **options: of :func:`~elastic_strips.execution.simulation`.

    Attributes:
        deliberation: the task's steps.
        director: plans their paths when the sequencing layer asks.
        sequencing: the layer, or None where there is no step.
        simulation: of the reactive layer, or None where there is no step.
        keeping: watches what is to be kept to, or None.

    Raises:
        MissingExtraError: py_trees (extra ``control``) is not installed.
        ConfigurationError: start is not sound, or in collision.
    """

    def __init__(
        self,
        robot: RobotModel,
        world: World | Scene,
        start: npt.ArrayLike,
        task: Task,
        *,
        keep: AxisTask | None = None,
        params: DriveParams | None = None,
        perception: PerceptionParams | Perceiver | None = None,
        seed: int = 0,
        watch: Callable[[HybridControl], object] | None = None,
        **options: Any,
    ) -> None:
        check_type("robot", robot, RobotModel, RobotError)
        check_type("keep", keep, AxisTask, none=True)
        check_type("params", params, DriveParams, none=True)
        check_able("watch", watch)
        check_count("seed", seed)
        if not isinstance(task, (DriveTo, ReachHand, DriveAndReach)):
            raise ParameterError(f"task must be a DriveTo, a ReachHand or a DriveAndReach, not {shown(task)}")
        if not isinstance(perception, PerceptionParams):
            check_able("perception", perception, "known", "sense")
        self.robot, self.watch = robot, watch
        world = world if isinstance(world, World) else World(world)
        params = replace(params or DriveParams(), task=keep)
        layer = DeliberativeLayer(robot, seed=seed, margin=params.clearance + 0.01)
        seen = world.at(0.0) if perception is None or isinstance(perception, PerceptionParams) else perception.known()
        self.deliberation = layer.divide(task, start, standing(seen))
        self.director = Director(robot, params, seed=seed, grid=robot.space.planar)
        self.orders: list[tuple[float, Order, str]] = []
        self.sequencing: SequencingLayer | None = None
        self.simulation: Simulation[Controller] | None = None
        self.keeping: TaskWatch | None = None
        steps = self.deliberation.steps
        if not steps:
            return
        self.sequencing = SequencingLayer([str(s) for s in steps], max_scene_age=params.max_scene_age)
        try:
            self.simulation = simulation(
                robot, world, start, [s.q for s in steps], params=params, replanner=self.director, seed=seed,
                perception=perception, watch=self._look, **options,
            )  # fmt: skip
        except ConfigurationError as error:
            self.deliberation = replace(self.deliberation, steps=(), reason=str(error))
            return
        self._controller = self.simulation.controller
        force = self._controller.pilot.deformer.task
        self.keeping = None if force is None else TaskWatch(force)
        self._report: object = None

    def run(self, *, time_limit: float | None = None) -> HybridResult:
        """Do the task, or find out why not."""
        simulation, sequencing = self.simulation, self.sequencing
        if simulation is None or sequencing is None:
            return HybridResult(False, self.deliberation.reason, self.deliberation, None, (), ())
        drive = simulation.run(time_limit=time_limit)
        self._tick(sequencing)
        done = sequencing.order is Order.DONE
        reason = sequencing.reason if done or sequencing.order is Order.GIVE_UP else drive.reason
        events = () if self.keeping is None else tuple(self.keeping.events)
        return HybridResult(done, reason, self.deliberation, drive, tuple(self.orders), events)

    def _look(self, _: Simulation[Controller]) -> None:
        """After a planning tick of the reactive layer: the layers above it have their turn."""
        assert self.sequencing is not None
        controller = self._controller
        proposal = controller.proposal
        if self.keeping is not None and proposal is not None and proposal.report is not self._report:
            self._report = proposal.report
            self.keeping.update(controller.time, proposal.report)
        order = self._tick(self.sequencing)
        if order is Order.ASK:
            self.director.ask()
        elif order is Order.GIVE_UP:
            controller.stop()
        if self.watch is not None:
            self.watch(self)

    def _tick(self, sequencing: SequencingLayer) -> Order:
        controller = self._controller
        reached = len(self.deliberation.steps) - 1 - len(controller.goals)
        reached += controller.state is RunState.REACHED
        facts = Facts(
            scene_age=controller.time - controller.scene.time,
            localized=controller.estimator.lost_for <= 0.1,
            trouble=self.director.trouble,
            planning=self.director.pending,
            attempts=self.director.attempts,
            reached=reached,
        )
        order = sequencing.tick(facts)
        if not self.orders or self.orders[-1][1:] != (order, sequencing.reason):
            self.orders.append((controller.time, order, sequencing.reason))
        return order
