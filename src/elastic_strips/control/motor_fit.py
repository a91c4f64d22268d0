"""Motors as their motion shows them: the lag, the dead time and the greatest acceleration of a speed loop.

A speed v follows commands u by ``dv/dt = clip((u(t − dead) − v)/lag, ±push)``. The three are found by trying: motions
of many candidates are simulated from the commands, ever more closely about the best.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array

_PARTS = 5  # of a control period, in which motions are simulated
_MOST_ROWS = 2000
_LEAST_SPEED = 0.02  # [m/s, rad/s] of a coordinate that moves
_BETTER = 1.5  # times by which the error without a push has to be larger than with one, for that to be believed
_SIGNIFICANT = 30.0  # the same of noisy speeds, by the errors' sum in units of what is left
_AT_PUSH, _FEWEST = 0.97, 3  # part of the push, and rows at it without which it does not show
_NOISY_ROWS = 5  # over which accelerations are taken where speeds are not exact


@dataclass(frozen=True, slots=True)
class SpeedLoop:
    """What a motor's motion shows.

    Attributes:
        lag: time constant [s].
        dead: time [s] until a command acts.
        push: greatest acceleration [m/s² or rad/s²] that it has; None where it was never at it.
        reached: greatest acceleration [m/s² or rad/s²] that it had.
        left: part of the motion that all of this does not explain.
    """

    lag: float
    dead: float
    push: float | None
    reached: float
    left: float


def fit_speed_loops(time: Array, command: Array, speed: Array, *, mean: bool) -> list[SpeedLoop | None]:
    """Fit speed loops to the motions of m motors; None for one that does not move.

    Args:
        time: (T,) of the rows [s], ascending.
        command: (T, m) speeds that are commanded from each row on.
        speed: (T, m) at the rows; or, where they are ``mean`` speeds, from each row to the next, the last unused.
        mean: whether speeds are means, and noisy.
    """
    found: list[SpeedLoop | None] = [None] * command.shape[1]
    if len(time) < 2 * _NOISY_ROWS:
        return found
    rows = _most_excited(command)
    time, command, speed = time[rows], command[rows], speed[rows]
    moves = np.minimum(np.abs(command).max(axis=0), np.abs(speed).max(axis=0)) >= _LEAST_SPEED
    columns = np.flatnonzero(moves).tolist()
    if columns:
        for column, loop in zip(columns, _fitted(time, command[:, columns], speed[:, columns], mean), strict=True):
            found[column] = loop
    return found


def _fitted(time: Array, command: Array, speed: Array, mean: bool) -> list[SpeedLoop]:
    step = float(np.median(np.diff(time))) / _PARTS
    grid = _Grid.of(time, command, step)
    over = _NOISY_ROWS if mean else 1
    change = np.abs(speed[over:-1] - speed[: -over - 1]) / (time[over:-1] - time[: -over - 1])[:, None]
    reached = np.maximum(change.max(axis=0), 1e-6)
    m = len(reached)

    def tried(lags: Array, deads: npt.NDArray[np.int64], pushes: Array) -> _Tried:
        """All combinations of the values (m, …) of each motor."""
        shape = (m, lags.shape[1], deads.shape[1], pushes.shape[1])
        lag = np.broadcast_to(lags[:, :, None, None], shape).reshape(m, -1)
        dead = np.broadcast_to(deads[:, None, :, None], shape).reshape(m, -1)
        push = np.broadcast_to(pushes[:, None, None, :], shape).reshape(m, -1)
        return _Tried(grid.errors(lag, dead, push, speed, mean), lag, dead, push)

    shares = np.geomspace(0.06, 1.0, 8) if mean else np.array([0.9, 1.0, 1.1])
    free = np.full((m, 1), np.inf)
    now = tried(
        np.tile(np.geomspace(0.004, 0.4, 16), (m, 1)),
        np.tile(np.array([0, 2, 5, 10, 20, 30]), (m, 1)),
        np.hstack((free, reached[:, None] * shares)),
    )
    each = np.arange(m)
    for spread, shift, wide in ((1.3, 4, 1.3), (1.2, 2, 1.1), (1.08, 1, 1.04), (1.02, 1, 1.015)):
        best = now.errors.argmin(axis=1)
        push = np.where(np.isinf(now.push[each, best]), reached, now.push[each, best])
        now = tried(
            now.lag[each, best][:, None] * np.geomspace(1.0 / spread, spread, 9),
            np.maximum(now.dead[each, best][:, None] + np.arange(-shift, shift + 1), 0),
            np.hstack((free, push[:, None] * np.geomspace(1.0 / wide, wide, 5))),
        )
    best = now.errors.argmin(axis=1)
    unlimited = np.where(np.isinf(now.push), now.errors, np.inf).argmin(axis=1)
    gain = now.errors[each, unlimited] / np.maximum(now.errors[each, best], 1e-15) - 1.0
    pushes = gain * len(speed) > _SIGNIFICANT if mean else gain > _BETTER - 1.0
    push = now.push[each, best]
    model = grid.simulated(now.lag[each, best][:, None], now.dead[each, best][:, None], push[:, None], speed, mean)
    pushed = np.abs(np.diff(model[:, :, 0], axis=0)) / np.diff(time)[: len(model) - 1, None] > _AT_PUSH * push
    limited = pushes & (np.count_nonzero(pushed, axis=0) >= _FEWEST)
    chosen = np.where(pushes, best, unlimited)
    left = np.sqrt(now.errors[each, chosen] / np.maximum(np.square(speed).mean(axis=0), 1e-12))
    return [
        SpeedLoop(
            float(now.lag[i, chosen[i]]),
            float(now.dead[i, chosen[i]]) * step,
            float(push[i]) if limited[i] else None,
            float(reached[i]),
            float(left[i]),
        )
        for i in range(m)
    ]


def _most_excited(command: Array) -> slice:
    """The rows, or so many of them as are looked at, where commands change most."""
    if len(command) <= _MOST_ROWS:
        return slice(None)
    step = np.abs(np.diff(command, axis=0)) / np.maximum(np.abs(command).max(axis=0), _LEAST_SPEED)
    change = np.concatenate(([0.0], np.cumsum(step.sum(axis=1))))
    begin = int(np.argmax(change[_MOST_ROWS:] - change[:-_MOST_ROWS]))
    return slice(begin, begin + _MOST_ROWS)


@dataclass(frozen=True, slots=True)
class _Tried:
    """Candidates (m, C) of m motors, and the mean square (m, C) of what each leaves unexplained."""

    errors: Array
    lag: Array
    dead: npt.NDArray[np.int64]
    push: Array


@dataclass(frozen=True, slots=True)
class _Grid:
    """Commands (S, m) at even steps [s], and the number of the step at each row."""

    time: Array
    command: Array
    rows: npt.NDArray[np.int64]
    step: float

    @staticmethod
    def of(time: Array, command: Array, step: float) -> _Grid:
        rows = np.rint((time - time[0]) / step).astype(np.int64)
        held = np.searchsorted(rows, np.arange(rows[-1]), side="right") - 1
        return _Grid(time, command[held], rows, step)

    def errors(self, lag: Array, dead: npt.NDArray[np.int64], push: Array, speed: Array, mean: bool) -> Array:
        """(m, C) mean square by which candidates differ from speeds (T, m)."""
        total, count = np.zeros(lag.shape), 0
        for k, model in self._run(lag, dead, push, speed, mean):
            total += np.square(model - speed[k][:, None])
            count += 1
        return total / max(count, 1)

    def simulated(self, lag: Array, dead: npt.NDArray[np.int64], push: Array, speed: Array, mean: bool) -> Array:
        """(T, m, C) speeds of candidates at the rows, or (T − 1, m, C) means from each row to the next."""
        return np.array([model for _, model in self._run(lag, dead, push, speed, mean)])

    def _run(
        self, lag: Array, dead: npt.NDArray[np.int64], push: Array, speed: Array, mean: bool
    ) -> Iterator[tuple[int, Array]]:
        """Number and speeds (m, C) of each row; of means, those from it to the next."""
        share, most = 1.0 - np.exp(-self.step / lag), push * self.step
        limited = bool(np.isfinite(most).any())
        longest, motor = int(dead.max(initial=0)), np.arange(lag.shape[0])[:, None]
        padded, at = np.concatenate((np.tile(self.command[:1], (longest, 1)), self.command)), longest - dead
        v, way = np.broadcast_to(speed[0][:, None], lag.shape), np.zeros(lag.shape)
        if not mean:
            yield 0, v
        for k, row in enumerate(np.searchsorted(self.rows, np.arange(1, len(self.command) + 1)).tolist()):
            gap = (padded[k + at, motor] - v) * share
            if limited:
                gap = np.minimum(np.maximum(gap, -most), most)
            way = way + (v + 0.5 * gap)
            v = v + gap
            if self.rows[row] != k + 1:
                continue
            if mean:
                yield row - 1, way * (self.step / (self.time[row] - self.time[row - 1]))
                way = np.zeros(lag.shape)
            else:
                yield row, v
