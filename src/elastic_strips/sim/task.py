"""Task simulation: the three layers do a task in a simulated world."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from elastic_strips.arrays import ArrayLike
from elastic_strips.control import DriveParams, DriveResult
from elastic_strips.control.tasks import HybridControl, Order, Task, TaskPlan, deliberate
from elastic_strips.control.tasks.hybrid import ConstraintEvent
from elastic_strips.errors import ConfigurationError
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene, World
from elastic_strips.strip import AxisConstraint
from elastic_strips.summary import Summary
from elastic_strips.validation import check_able

from .closed_loop import Simulation, simulation
from .perception import Perception, PerceptionParams


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TaskResult(Summary):
    """Result of a task.

    Attributes:
        done: whether all steps were reached.
        reason: why it ended.
        deliberation: its steps.
        drive: result of the drive; None where the task could not be started.
        orders: (time [s], order, reason) of the sequencing layer, at every change.
        task_events: suspensions and resumptions of the constraint.
    """

    done: bool
    reason: str
    deliberation: TaskPlan
    drive: DriveResult | None
    orders: tuple[tuple[float, Order, str], ...]
    task_events: tuple[ConstraintEvent, ...]


class TaskSimulation:
    """Workspace: a task in a world.

    Args:
        robot: the robot.
        world: the obstacles over time.
        start: configuration (nq,).
        task: the task to do.
        keep: constraint on the strip.
        params: parameters of the drive.
        perception: perception for all three layers; see :func:`simulation`.
        seed: seed of the search for goals, the plans, the plant and the perception.
        look: called after every planning tick, with the :class:`HybridControl`.
        **options: as for :func:`simulation`.

    Attributes:
        deliberation: the task's steps.
        control: sequencing and reactive layer; None where the task cannot be started.
        simulation: the simulation of it, or None.

    Raises:
        MissingExtraError: py_trees (extra ``control``) is not installed.
    """

    def __init__(
        self,
        robot: RobotModel,
        world: World | Scene,
        start: ArrayLike,
        task: Task,
        *,
        keep: AxisConstraint | None = None,
        params: DriveParams | None = None,
        perception: PerceptionParams | Perception | None = None,
        seed: int = 0,
        look: Callable[[HybridControl], object] | None = None,
        **options: object,
    ) -> None:
        if not isinstance(perception, PerceptionParams):
            check_able("perception", perception, "known", "sense")
        world = world if isinstance(world, World) else World(world)
        seen = world.at(0.0) if perception is None or isinstance(perception, PerceptionParams) else perception.known()
        self.deliberation = deliberate(robot, start, task, seen, params=params, seed=seed)
        self.control: HybridControl | None = None
        self.simulation: Simulation[HybridControl] | None = None
        if not self.deliberation.steps:
            return

        begin: Callable[..., Simulation[HybridControl]] = simulation
        try:
            self.simulation = begin(
                robot,
                world,
                start,
                self.deliberation.steps[-1].q,
                params=params,
                perception=perception,
                seed=seed,
                make=partial(HybridControl, robot, start, self.deliberation, keep=keep, look=look),
                **options,
            )
        except ConfigurationError as error:
            self.deliberation: TaskPlan = replace(self.deliberation, steps=(), reason=str(error))
            return
        self.control = self.simulation.controller

    def run(self, *, time_limit: float | None = None) -> TaskResult:
        """Do the task, for at most ``time_limit`` [s]; where None, that of the drive's parameters."""
        control = self.control
        if self.simulation is None or control is None:
            return TaskResult(False, self.deliberation.reason, self.deliberation, None, (), ())
        drive = self.simulation.run(time_limit=time_limit)
        order = control.decide()
        reason = control.sequencing.reason if order in (Order.DONE, Order.GIVE_UP) else drive.reason
        events = () if control.constraint_monitor is None else tuple(control.constraint_monitor.events)
        return TaskResult(order is Order.DONE, reason, self.deliberation, drive, tuple(control.orders), events)
