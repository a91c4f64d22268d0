"""Proximity room, forecast: where moving obstacles will be when each node of a strip is reached, and how surely.

A node that is reached at time t meets an obstacle that has moved by then. Seen from the obstacle, the robot is moved
the other way: so the distance at the node is measured with the robot shifted by minus the obstacle's displacement,
and lessened by how far the obstacle can be from where it is expected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask

from ..errors import ParameterError
from .window import Window

_LONGEST = 1e6  # [s]


@dataclass(frozen=True, slots=True, eq=False)
class Ahead:
    """A forecast at the times of N nodes, for M obstacles.

    Attributes:
        obstacles: (M,) indices in the scene.
        shift: (N, M, 3) displacement [m] of each obstacle since the snapshot.
        growth: (N, M) how far [m] it can be from there.
        ignored: (N,) nodes that are reached too late to say anything; moving obstacles do not count there.
    """

    obstacles: Indices
    shift: Array
    growth: Array
    ignored: Mask

    def travel(self) -> Array:
        """(N−1, M) bound [m] on how far the obstacles' surfaces come from node to node: motion and growth."""
        step = np.sqrt((np.diff(self.shift, axis=0) ** 2).sum(axis=2))
        return step + np.abs(np.diff(self.growth, axis=0))

    def between(self, place: Array, obstacle: Indices) -> tuple[Array, Array]:
        """Shift (K, 3) and growth (K,) at places; growth is convex in time, so that this bounds it."""
        segment = np.minimum(place.astype(np.intp), len(self.shift) - 2)
        fraction = place - segment
        f = fraction[:, None]
        shift = (1.0 - f) * self.shift[segment, obstacle] + f * self.shift[segment + 1, obstacle]
        growth = (1.0 - fraction) * self.growth[segment, obstacle] + fraction * self.growth[segment + 1, obstacle]
        return shift, growth


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """Constant velocities of some obstacles from a snapshot on, and bounds of how wrong they can be.

    At time t after the snapshot obstacle m is expected at its pose, moved by ``velocity[m]·t``; no point of it is
    further from there than ``offset[m] + speed[m]·|t| + ½·acceleration[m]·t²``. The same bounds hold before it (t < 0):
    a motion may have begun when the scene was still older.

    Attributes:
        obstacles: (M,) indices in the scene that it belongs to.
        velocity: (M, 3) expected velocity [m/s], world frame.
        offset: (M,) error of the pose [m]; speed: (M,) of the velocity [m/s], or the bound of an unknown motion;
            acceleration: (M,) largest acceleration [m/s²].
        horizon: longest time [s] after the snapshot that it speaks of; moving obstacles are ignored beyond.
    """

    obstacles: Indices
    velocity: Array
    offset: Array
    speed: Array
    acceleration: Array
    horizon: float = np.inf

    def __post_init__(self) -> None:
        m = len(self.obstacles)
        for name, shape in (("velocity", (m, 3)), ("offset", (m,)), ("speed", (m,)), ("acceleration", (m,))):
            value = getattr(self, name)
            if value.shape != shape:
                raise ParameterError(f"Forecast: {name} has shape {value.shape}; {m} obstacles need {shape}")
            if not np.isfinite(value).all():
                raise ParameterError(f"Forecast: {name} holds a value that is not finite")
            if name != "velocity" and (value < 0.0).any():
                raise ParameterError(f"Forecast: {name} holds {value.min():g}; it must be ≥ 0")

    def __len__(self) -> int:
        return len(self.obstacles)

    def ahead(self, times: Array) -> Ahead:
        """The forecast at node times (N,) [s] after the snapshot; negative ones are before it."""
        t = np.clip(times, -_LONGEST, min(self.horizon, _LONGEST))[:, None]
        growth = self.offset + self.speed * np.abs(t) + 0.5 * self.acceleration * t * t
        return Ahead(self.obstacles, self.velocity[None] * t[:, :, None], growth, times > self.horizon)


class Movers:
    """Workspace: which columns of a window belong to the obstacles of a forecast, and how they moved since the last.

    Attributes:
        ahead: the forecast at the nodes, or None.
        always: obstacle indices that the window holds wherever they are.
        columns: (P,) whether a column moves.
    """

    def __init__(self) -> None:
        self.ahead: Ahead | None = None
        self.always: Indices = np.zeros(0, dtype=np.intp)
        self.columns: Mask = np.zeros(0, dtype=bool)
        self._mover: Indices = np.zeros(0, dtype=np.intp)
        self._rotation: Array = np.zeros((0, 3, 3))
        self._translation: Array = np.zeros((0, 3))

    def known(self, ahead: Ahead) -> bool:
        """Whether the window holds all the forecast's obstacles; if not, the next one will."""
        if np.isin(ahead.obstacles, self.always).all():
            return True
        self.always = ahead.obstacles
        return False

    def remap(self, source: Indices) -> None:
        """Carry the last forecast over to nodes (N,) that were nodes ``source`` of it."""
        a = self.ahead
        if a is not None:
            self.ahead = Ahead(a.obstacles, a.shift[source], a.growth[source], a.ignored[source])

    def begin(self, ahead: Ahead | None, window: Window) -> None:
        """Take a forecast for a window of which nothing is known yet."""
        self.ahead = ahead if ahead is not None and len(ahead.obstacles) else None
        lookup = np.full(len(window.scene), -1, dtype=np.intp)
        if self.ahead is not None:
            lookup[self.ahead.obstacles] = np.arange(len(self.ahead.obstacles))
        self._mover = lookup[window.obstacle]
        self.columns = self._mover >= 0
        self._rotation, self._translation = window.rotation.copy(), window.translation.copy()

    def advance(self, ahead: Ahead | None, window: Window, changed: Indices) -> tuple[Indices, Array, Array] | None:
        """Take the next forecast for the same window and as many nodes.

        Args:
            ahead: the forecast, or None where nothing moves.
            window: with the new snapshot.
            changed: its columns whose pose is another than in the last.

        Returns:
            Columns (C,), how far (N, C) [m] any point of each has moved as seen from a node, and by how much (N, C)
            its growth has risen; None where nothing moved.
        """
        before, former, mover = self.ahead, self.columns, self._mover
        rotation, translation = self._rotation, self._translation
        self.begin(ahead, window)
        moved = former | self.columns
        moved[changed] = True
        columns = np.flatnonzero(moved)
        if len(columns) == 0:
            return None
        shift, growth = _of_columns(self.ahead, self._mover[columns])
        shift_before, growth_before = _of_columns(before, mover[columns])
        step = shift - shift_before
        step += window.translation[columns] - translation[columns]
        turn = window.rotation[columns] - rotation[columns]
        reach = np.linalg.norm(window.box_center[columns], axis=1) + np.linalg.norm(window.box_half[columns], axis=1)
        way = np.sqrt(np.einsum("nci,nci->nc", step, step))
        way += reach * np.sqrt(0.5 * np.einsum("cij,cij->c", turn, turn))
        return columns, way, growth - growth_before

    def travel(self) -> Array | None:
        """(N−1, P) bound [m] on how far parts come towards the robot from node to node; None where nothing moves."""
        if self.ahead is None:
            return None
        return np.where(self.columns, self.ahead.travel()[:, self._mover], 0.0)

    def displaced(self, node: Indices, part: Indices) -> tuple[Array, Array] | None:
        """Shift (K, 3) and growth (K,) of parts at nodes; None where nothing moves."""
        if self.ahead is None:
            return None
        mover = self._mover[part]
        return self._still(mover, self.ahead.shift[node, mover], self.ahead.growth[node, mover])

    def between(self, place: Array, part: Indices) -> tuple[Array, Array] | None:
        """Shift (K, 3) and growth (K,) of parts at places, node numbers with fractions; None where nothing moves."""
        if self.ahead is None:
            return None
        mover = self._mover[part]
        return self._still(mover, *self.ahead.between(place, mover))

    @staticmethod
    def _still(mover: Indices, shift: Array, growth: Array) -> tuple[Array, Array]:
        shift[mover < 0], growth[mover < 0] = 0.0, 0.0
        return shift, growth


def _of_columns(ahead: Ahead | None, mover: Indices) -> tuple[Array, Array]:
    """Shift (N, C, 3) and growth (N, C) of columns, zero where ``mover`` is −1; N is 1 where nothing moves."""
    if ahead is None:
        return np.zeros((1, len(mover), 3)), np.zeros((1, len(mover)))
    still = mover < 0
    shift, growth = ahead.shift[:, mover], ahead.growth[:, mover]
    if still.any():
        shift[:, still], growth[:, still] = 0.0, 0.0
    return shift, growth
