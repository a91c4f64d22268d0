"""Task watch: a task that cannot be kept is suspended, and taken up again as soon as it can."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from ...deform import DeformReport
from ...deform.task import TaskForce
from ...errors import ParameterError

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
