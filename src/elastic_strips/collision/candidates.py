"""Candidate parts: the few obstacle parts that can come near a strip, and where moving ones will be.

Coal's broadphase returns to Python only the nearest object of a query (the pairs that its collecting callback
gathers have no Python converter), and the repulsive field needs all parts within the influence distance; so parts are
first culled by boxes here, in numpy, and Coal is asked about the others.

A node that is reached at time t meets an obstacle that has moved by then. Seen from the obstacle, the robot is moved
the other way: so the distance at the node is measured with the robot shifted by minus the obstacle's displacement,
and lessened by how far the obstacle can be from where it is expected.
"""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.errors import ParameterError
from elastic_strips.scene import Scene
from elastic_strips.scene.parts import Part
from elastic_strips.scene.scene import PartTable
from elastic_strips.work import count_work

_MANY = 20_000  # pairs of parts and nodes that are not all looked at together
_ROUNDING = 1e-9  # [m] that a computed box may be too small by
_LONGEST_MOTION = 1e6  # [s] that an obstacle is followed


@dataclass(slots=True)
class CandidateParts:
    """Parts of a scene whose boxes come within ``margin`` of the boxes that the strip may use.

    Attributes:
        scene: the snapshot that it was made from.
        rows: (P,) rows of ``scene.table``, ascending.
        cover_low, cover_high: (N, 3) grown boxes about the nodes; a node inside one needs no other candidates.
        parts: the P parts.
        rotation: (P, 3, 3), translation: (P, 3) world poses.
        box_center: (P, 3) centre of each part's box in the part's frame; box_half: (P, 3) its half sizes.
        obstacle: (P,) obstacle index in the scene.
    """

    scene: Scene
    rows: Indices
    cover_low: Array
    cover_high: Array
    parts: list[Part]
    rotation: Array
    translation: Array
    box_center: Array
    box_half: Array
    obstacle: Indices
    _transforms: list[coal.Transform3s] | None = None

    @staticmethod
    def build(scene: Scene, low: Array, high: Array, slack: float, *, always: Indices | None = None) -> CandidateParts:
        """Collect the parts near the boxes ``low``, ``high`` (N, 3) of the nodes, each grown by ``slack`` [m].

        The parts of the obstacles ``always`` are included wherever they are.
        """
        low, high = low - slack, high + slack
        table = scene.table
        rows = np.zeros(0, dtype=np.intp)
        if len(table) and len(low):
            rows = _overlapping(table, np.arange(len(table)), low, high)
        if always is not None and len(always):
            rows = np.union1d(rows, np.flatnonzero(np.isin(table.obstacle_index, always)))
        parts = list(map(table.parts.__getitem__, rows.tolist()))
        return CandidateParts(
            scene,
            rows,
            low,
            high,
            parts,
            table.rotation[rows],
            table.translation[rows],
            table.local_center[rows] - table.local_translation[rows],
            table.local_half[rows],
            table.obstacle_index[rows],
        )

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def transforms(self) -> list[coal.Transform3s]:
        """The poses as Coal takes them."""
        if self._transforms is None:
            self._transforms = [coal.Transform3s(r, t) for r, t in zip(self.rotation, self.translation, strict=True)]
        return self._transforms

    def obstacle_name(self, part: int) -> str:
        """Name of the obstacle that a part belongs to."""
        return self.scene.names[int(self.obstacle[part])]

    def covered(self, low: Array, high: Array) -> Mask:
        """(M,) whether each box (M, 3) lies in one of the boxes that the nodes may use."""
        inside = np.ones((len(low), len(self.cover_low)), dtype=bool)
        for k in range(3):
            inside &= low[:, k, None] >= self.cover_low[:, k]
            inside &= high[:, k, None] <= self.cover_high[:, k]
        return np.asarray(inside.any(axis=1), dtype=bool)

    def follow(self, scene: Scene) -> Indices | None:
        """Move to another snapshot of the same obstacles.

        Returns:
            The columns whose pose changed, or None where candidates must be collected anew: there are other obstacles,
            or one that came in from outside.
        """
        changed = scene.rows_changed_since(self.scene)
        if changed is None:
            return None
        if len(changed) == 0:
            self.scene = scene
            return changed
        new = scene.table
        position = np.searchsorted(self.rows, changed)
        known = (
            (position < len(self.rows)) & (self.rows[np.minimum(position, len(self.rows) - 1)] == changed)
            if len(self.rows)
            else np.zeros(len(changed), dtype=bool)
        )
        outside = changed[~known]
        if len(outside) and len(_overlapping(new, outside, self.cover_low, self.cover_high)):
            return None
        columns = position[known]
        self.rotation[columns] = new.rotation[changed[known]]
        self.translation[columns] = new.translation[changed[known]]
        if self._transforms is not None:
            for c in columns:
                self._transforms[c].setTransform(self.rotation[c], self.translation[c])
        self.scene = scene
        return columns

    def boxes(self) -> tuple[Array, Array]:
        """Low and high corners (P, 3) [m] of world boxes that hold the parts' own boxes."""
        center = self.translation + np.matmul(self.rotation, self.box_center[:, :, None])[:, :, 0]
        half = np.matmul(np.abs(self.rotation), self.box_half[:, :, None])[:, :, 0] + _ROUNDING
        return center - half, center + half

    def capsule_distance(self, ends: Array, radius: Array, part: Indices, moved: tuple[Array, Array] | None) -> Array:
        """Lower bounds (K,) [m] of the distances of capsules with ends (K, 2, 3) to the boxes of ``part`` (K,).

        ``moved`` has shift (K, 3) and uncertainty (K,) of the parts [m], or is None where nothing moves.
        """
        count_work(pairs=len(part))
        if moved is not None:
            ends = ends - moved[0][:, None]
        one, two = ends[:, 0], ends[:, 1]
        along = two - one
        half = 0.5 * np.sqrt(np.einsum("ki,ki->k", along, along))
        distance = self.box_distance(0.5 * (one + two), part) - half - radius
        return distance if moved is None else distance - moved[1]

    def apart(
        self, center: Array, rotation: Array, half: Array, part: Indices, moved: tuple[Array, Array] | None
    ) -> Array:
        """Lower bounds (K,) [m] of the distances of boxes with centres (K, 3), rotations (K, 3, 3) and half sizes
        (K, 3) to the boxes of ``part`` (K,), as :meth:`capsule_distance`; −∞ where they may touch.

        Two boxes are at least as far apart as the boxes about them in any frame: in the world's and in the first's.
        """
        turn, own = self.rotation[part], np.matmul(np.swapaxes(rotation, 1, 2), self.rotation[part])
        between = self.translation[part] - center + np.matmul(turn, self.box_center[part][..., None])[..., 0]
        if moved is not None:
            between = between + moved[0]
        extent = np.matmul(np.abs(rotation), half[..., None])[..., 0]
        gaps = np.abs(between) - extent - np.matmul(np.abs(turn), self.box_half[part][..., None])[..., 0]
        inner = np.abs(np.matmul(between[:, None], rotation)[:, 0]) - half
        inner -= np.matmul(np.abs(own), self.box_half[part][..., None])[..., 0]
        apart = np.sqrt((np.maximum(np.stack((gaps, inner)), 0.0) ** 2).sum(axis=2)).max(axis=0)
        apart[apart <= 0.0] = -np.inf
        return apart if moved is None else apart - moved[1]

    def box_distance(self, points: Array, part: Indices | slice) -> Array:
        """Distance [m] of world points (K, 3) to the oriented boxes of ``part`` (K,): 0 inside."""
        local = np.matmul((points - self.translation[part])[..., None, :], self.rotation[part])[..., 0, :]
        gap = np.abs(local - self.box_center[part]) - self.box_half[part]
        np.maximum(gap, 0.0, out=gap)
        return np.sqrt(np.einsum("...i,...i->...", gap, gap))


def _overlapping(table: PartTable, rows: Indices, low: Array, high: Array) -> Indices:
    """Those ``rows`` whose box overlaps one of the boxes (N, 3)."""
    center, half = table.center[rows], table.half_extents[rows]
    part_low, part_high = center - half, center + half
    rows_in = ((part_low <= high.max(axis=0)) & (part_high >= low.min(axis=0))).all(axis=1)
    rows, part_low, part_high = rows[rows_in], part_low[rows_in], part_high[rows_in]
    keep = np.zeros(len(rows), dtype=bool)
    for nodes in (slice(None, None, 8), slice(None)) if len(rows) * len(low) > _MANY else (slice(None),):
        # boxes of neighbours have most parts in common: some of them find most of what all find
        left, some_low, some_high = np.flatnonzero(~keep), low[nodes], high[nodes]
        chunk = max(1, 2_000_000 // max(1, len(some_low)))
        for start in range(0, len(left), chunk):
            s = left[start : start + chunk]
            overlap = np.ones((len(s), len(some_low)), dtype=bool)
            for k in range(3):
                overlap &= part_low[s, k, None] <= some_high[:, k]
                overlap &= part_high[s, k, None] >= some_low[:, k]
            keep[s] = overlap.any(axis=1)
    return rows[keep]


@dataclass(frozen=True, slots=True, eq=False)
class NodePrediction:
    """A forecast at the times of N nodes, for M obstacles.

    Attributes:
        obstacles: (M,) indices in the scene.
        shift: (N, M, 3) displacement [m] of each obstacle since the snapshot.
        uncertainty: (N, M) how far [m] it can be from there.
        ignored: (N,) nodes that are reached too late for a forecast; moving obstacles do not count there.
    """

    obstacles: Indices
    shift: Array
    uncertainty: Array
    ignored: Mask

    def travel(self) -> Array:
        """(N−1, M) bound [m] on how far the obstacles' surfaces come from node to node: motion and uncertainty."""
        step = np.sqrt((np.diff(self.shift, axis=0) ** 2).sum(axis=2))
        return step + np.abs(np.diff(self.uncertainty, axis=0))

    def between(self, place: Array, obstacle: Indices) -> tuple[Array, Array]:
        """Shift (K, 3) and uncertainty (K,) at places; uncertainty is convex in time, so that this bounds it."""
        segment = np.minimum(place.astype(np.intp), len(self.shift) - 2)
        fraction = place - segment
        f, radius = fraction[:, None], self.uncertainty
        shift = (1.0 - f) * self.shift[segment, obstacle] + f * self.shift[segment + 1, obstacle]
        return shift, (1.0 - fraction) * radius[segment, obstacle] + fraction * radius[segment + 1, obstacle]


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """Constant velocities of some obstacles from a snapshot on, and bounds of their errors.

    At time t after the snapshot obstacle m is expected at its pose, moved by ``velocity[m]·t``; no point of it is
    further from there than ``offset[m] + speed[m]·|t| + ½·acceleration[m]·t²``. The same bounds hold before it (t < 0):
    a motion may have begun when the scene was still older.

    Attributes:
        obstacles: (M,) indices in the scene of the forecast.
        velocity: (M, 3) expected velocity [m/s], world frame.
        offset: (M,) error of the pose [m]; speed: (M,) error of the velocity [m/s], or the bound of an unknown motion;
            acceleration: (M,) largest acceleration [m/s²].
        horizon: longest time [s] after the snapshot for which it holds; beyond it moving obstacles are ignored.
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

    def predict(self, times: Array) -> NodePrediction:
        """The forecast at node times (N,) [s] after the snapshot; negative ones are before it."""
        t = np.clip(times, -_LONGEST_MOTION, min(self.horizon, _LONGEST_MOTION))[:, None]
        uncertainty = self.offset + self.speed * np.abs(t) + 0.5 * self.acceleration * t * t
        return NodePrediction(self.obstacles, self.velocity[None] * t[:, :, None], uncertainty, times > self.horizon)


class MovingParts:
    """Workspace: which columns of the candidates belong to a forecast's obstacles, and how they have moved.

    Attributes:
        prediction: the forecast at the nodes, or None.
        always: obstacle indices that the candidates hold wherever they are.
        columns: (P,) whether a column moves.
        mover: (P,) which of the forecast's obstacles a column belongs to; −1 for what stands.
    """

    def __init__(self) -> None:
        self.prediction: NodePrediction | None = None
        self.always: Indices = np.zeros(0, dtype=np.intp)
        self.columns: Mask = np.zeros(0, dtype=bool)
        self.mover: Indices = np.zeros(0, dtype=np.intp)
        self._rotation: Array = np.zeros((0, 3, 3))
        self._translation: Array = np.zeros((0, 3))

    def known(self, prediction: NodePrediction) -> bool:
        """Whether the candidates hold all the forecast's obstacles; if not, the next ones will."""
        if set(prediction.obstacles.tolist()) <= set(self.always.tolist()):
            return True
        self.always = prediction.obstacles
        return False

    def remap(self, source: Indices | slice) -> None:
        """Carry the last forecast over to nodes that were nodes ``source`` of it."""
        a = self.prediction
        if a is not None:
            self.prediction = NodePrediction(a.obstacles, a.shift[source], a.uncertainty[source], a.ignored[source])

    def begin(self, prediction: NodePrediction | None, candidates: CandidateParts) -> None:
        """Take a forecast for candidates about which nothing is known yet."""
        self.prediction = prediction if prediction is not None and len(prediction.obstacles) else None
        lookup = np.full(len(candidates.scene), -1, dtype=np.intp)
        if self.prediction is not None:
            lookup[self.prediction.obstacles] = np.arange(len(self.prediction.obstacles))
        self.mover = lookup[candidates.obstacle]
        self.columns = self.mover >= 0
        self._rotation, self._translation = candidates.rotation.copy(), candidates.translation.copy()

    def advance(
        self, prediction: NodePrediction | None, candidates: CandidateParts, changed: Indices
    ) -> tuple[Indices, Array, Array] | None:
        """Take the next forecast for the same candidates and as many nodes.

        Args:
            prediction: the forecast, or None where nothing moves.
            candidates: with the new snapshot.
            changed: the columns whose pose differs from that in the last snapshot.

        Returns:
            Columns (C,), how far (N, C) [m] any point of each has moved as seen from a node, and by how much (N, C)
            its uncertainty has risen; None where nothing moved.
        """
        before, former, mover = self.prediction, self.columns, self.mover
        rotation, translation = self._rotation, self._translation
        if before is None and (prediction is None or not len(prediction.obstacles)):
            columns, shift, risen = changed, np.zeros((1, 1, 3)), np.zeros((1, 1))
            rotation, translation = rotation[columns], translation[columns]
            self._rotation[columns], self._translation[columns] = (
                candidates.rotation[columns],
                candidates.translation[columns],
            )
        else:
            self.begin(prediction, candidates)
            moved = former | self.columns
            moved[changed] = True
            columns = np.flatnonzero(moved)
            shift, uncertainty = _of_columns(self.prediction, self.mover[columns])
            shift_before, uncertainty_before = _of_columns(before, mover[columns])
            shift, risen = shift - shift_before, uncertainty - uncertainty_before
            rotation, translation = rotation[columns], translation[columns]
        if len(columns) == 0:
            return None
        step = shift + (candidates.translation[columns] - translation)
        turn = candidates.rotation[columns] - rotation
        center, half = candidates.box_center[columns], candidates.box_half[columns]
        reach = np.sqrt(np.einsum("ci,ci->c", center, center)) + np.sqrt(np.einsum("ci,ci->c", half, half))
        travel = np.sqrt(np.einsum("nci,nci->nc", step, step))
        travel += reach * np.sqrt(0.5 * np.einsum("cij,cij->c", turn, turn))
        return columns, travel, risen

    def travel(self) -> Array | None:
        """(N−1, P) bound [m] on how far parts come towards the robot from node to node; None where nothing moves."""
        if self.prediction is None:
            return None
        # by rows, as the kernel reads it
        return np.ascontiguousarray(np.where(self.columns, self.prediction.travel()[:, self.mover], 0.0))

    def displaced(self, node: Indices, part: Indices) -> tuple[Array, Array] | None:
        """Shift (K, 3) and uncertainty (K,) of parts at nodes; None where nothing moves."""
        if self.prediction is None:
            return None
        mover = self.mover[part]
        return _with_still(mover, self.prediction.shift[node, mover], self.prediction.uncertainty[node, mover])

    def between(self, place: Array, part: Indices) -> tuple[Array, Array] | None:
        """Shift (K, 3) and uncertainty (K,) of parts at places, which are node numbers with fractions."""
        if self.prediction is None:
            return None
        mover = self.mover[part]
        return _with_still(mover, *self.prediction.between(place, mover))


def _of_columns(prediction: NodePrediction | None, mover: Indices) -> tuple[Array, Array]:
    """Shift (N, C, 3) and uncertainty (N, C) of columns, zero where ``mover`` is −1; N is 1 where nothing moves."""
    if prediction is None:
        return np.zeros((1, len(mover), 3)), np.zeros((1, len(mover)))
    return _with_still(mover, prediction.shift[:, mover], prediction.uncertainty[:, mover])


def _with_still(mover: Indices, shift: Array, uncertainty: Array) -> tuple[Array, Array]:
    """Shift (…, K, 3) and uncertainty (…, K), set to zero where ``mover`` (K,) is −1, as for parts that stand."""
    still = mover < 0
    shift[..., still, :], uncertainty[..., still] = 0.0, 0.0
    return shift, uncertainty
