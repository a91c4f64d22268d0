"""Computing: the cost of a robot's computing in simulated time, and an executor whose results arrive when they would
have."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future, TimeoutError
from contextlib import nullcontext
from dataclasses import dataclass
from time import thread_time
from typing import Literal, ParamSpec, TypeVar

from elastic_strips.errors import ParameterError
from elastic_strips.validation import check_able, check_number, check_type, shown
from elastic_strips.work import bounded_by_work, counted

_P = ParamSpec("_P")
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Computing:
    """The cost of computing in simulated time.

    Attributes:
        label: ``"free"``: nothing. ``"work"``: the time that is modelled for the work that was counted
            (:mod:`elastic_strips.work`), the same on every processor. A factor > 0: this many times the processor time
            that the computing took here, on one thread.

    Raises:
        ParameterError: another label.
    """

    label: Literal["free", "work"] | float = "free"

    def __post_init__(self) -> None:
        if isinstance(self.label, str):
            if self.label not in ("free", "work"):
                raise _unknown(self.label)
            return
        try:
            factor = check_number("", self.label, above=0.0)
        except ParameterError:
            raise _unknown(self.label) from None
        object.__setattr__(self, "label", factor)

    @staticmethod
    def parse(given: str | float) -> Computing:
        """The cost that a text or a number means: ``"free"``, ``"work"``, or a factor such as ``"1"`` or 4.0.

        Raises:
            ParameterError: it means nothing; the message has the alternatives.
        """
        if not isinstance(given, str):
            return Computing(given)
        text = given.strip()
        if text == "free":
            return Computing("free")
        if text == "work":
            return Computing("work")
        try:
            return Computing(float(text))
        except (ValueError, ParameterError):  # ParameterError: the text is a number, but not a factor
            raise _unknown(given) from None

    def reading(self) -> float:
        """Simulated seconds [s] of the calling thread's computing so far, less what an executor charges apart."""
        if self.label == "free":
            return 0.0
        spent = counted().seconds if self.label == "work" else self.label * thread_time()
        return spent - _APART.seconds.get(self.label, 0.0)


def _unknown(given: object) -> ParameterError:
    return ParameterError(
        f"compute={shown(given)} must be 'free', 'work', or a finite factor > 0 of the measured processor time"
    )


class _Apart(threading.local):
    """Workspace: simulated seconds of the calling thread that are charged apart, by label."""

    def __init__(self) -> None:
        self.seconds: dict[str | float, float] = {}


_APART = _Apart()


class ChargedFuture(Future[_T]):
    """A result that exists at once, and arrives when simulated time has come to ``due``.

    Until then it counts as running, and waiting for it is an error: simulated time does not go on meanwhile. Callbacks
    and ``concurrent.futures.wait`` know of no simulated time.

    Attributes:
        due: simulated time [s] at which it arrives.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        super().__init__()
        self._clock = clock
        self.due: float = 0.0

    def done(self) -> bool:
        """Whether the simulated time has come."""
        return super().done() and self._clock() >= self.due

    def running(self) -> bool:
        """Whether the simulated time has not come yet."""
        return not self.done()

    def result(self, timeout: float | None = None) -> _T:
        """The result, or the exception of the task.

        Raises:
            TimeoutError: (of ``concurrent.futures``) it has not arrived yet; ``timeout`` is of no use.
        """
        self._check()
        return super().result()

    def exception(self, timeout: float | None = None) -> BaseException | None:
        """The exception of the task; None where it has a result.

        Raises:
            TimeoutError: as for :meth:`result`.
        """
        self._check()
        return super().exception()

    def _check(self) -> None:
        if not self.done():
            raise TimeoutError(f"the result arrives at {self.due:.3f} s of simulated time; it is {self._clock():.3f} s")


class ChargedExecutor(Executor):
    """Workspace: one simulated processor core that computes one task after the other.

    A task is computed at once, when it is submitted, and its result arrives when as much simulated time has passed as
    it costs, after all tasks before it. The meter of the thread that submits leaves the task's cost out. A task that
    another task submits comes before the result of the other.

    Args:
        computing: cost of tasks; with ``"free"`` they are done at once.
        clock: simulated time [s].

    Attributes:
        computing: may be replaced between tasks.
        busy_until: simulated time [s] at which the last task ends.
    """

    def __init__(self, computing: Computing, clock: Callable[[], float]) -> None:
        check_type("computing", computing, Computing)
        check_able("clock", clock)
        self.computing: Computing = computing
        self.clock: Callable[[], float] = clock
        self.busy_until: float = 0.0

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> ChargedFuture[_T]:
        """Compute ``fn`` of the arguments now; the result arrives later."""
        future: ChargedFuture[_T] = ChargedFuture(lambda: self.clock())  # it may be set later
        began = self.computing.reading()
        try:
            with bounded_by_work() if self.computing.label == "work" else nullcontext():
                future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        cost = self.computing.reading() - began
        apart, label = _APART.seconds, self.computing.label
        apart[label] = apart.get(label, 0.0) + cost
        self.busy_until = future.due = max(self.clock(), self.busy_until) + cost
        return future
