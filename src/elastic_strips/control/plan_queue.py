"""Plan queue: plans that are computed beside the control loop, one after the other."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor as Workers
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Lock
from time import perf_counter
from typing import TypeVar

_Planned = TypeVar("_Planned")


class PlanQueue:
    """Runs plans while the control loop goes on, one after the other, whoever runs them.

    Args:
        workers: run them; a thread of its own, which starts with the first plan, where None.

    Attributes:
        submitting: time [s] that handing over has taken so far: some workers compute at once.
    """

    def __init__(self, workers: Workers | None) -> None:
        self.submitting: float = 0.0
        self._workers = workers
        self._own: ThreadPoolExecutor | None = None
        self._turn = Lock()

    def submit(self, plan: Callable[[], _Planned]) -> Future[_Planned]:
        """Have a plan computed."""
        if self._workers is None:
            self._workers = self._own = ThreadPoolExecutor(1, thread_name_prefix="planner")
        began = perf_counter()
        planned = self._workers.submit(self._in_turn, plan)
        self.submitting += perf_counter() - began
        return planned

    def close(self) -> None:
        """End the own thread; a running plan is waited for."""
        if self._own is not None:
            self._own.shutdown()

    def _in_turn(self, plan: Callable[[], _Planned]) -> _Planned:
        with self._turn:
            return plan()
