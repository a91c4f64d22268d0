"""The window: the few obstacle parts that can come near a strip, as flat arrays with oriented boxes.

Coal's broadphase returns to Python only the nearest object of a query (the pairs that its collecting callback
gathers have no Python converter), and the repulsive field needs all within the influence distance; so parts are
first culled by boxes here, in numpy, and what remains goes to Coal.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import coal
import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array

from ..scene import Scene
from ..scene.parts import Part


@dataclass(slots=True)
class Window:
    """Parts of a scene whose boxes come within ``margin`` of the boxes that the strip may use.

    Attributes:
        scene: the snapshot that it was made from.
        rows: (P,) rows of ``scene.table``, ascending.
        cover_low, cover_high: (N, 3) boxes about the nodes, grown; a node inside one needs no new window.
        parts: the P parts.
        rotation: (P, 3, 3), translation: (P, 3) world poses.
        box_center: (P, 3) centre of each part's box in the part's frame; box_half: (P, 3) its half sizes.
        transforms: Coal transforms of the poses.
        obstacle: (P,) obstacle index in the scene.
    """

    scene: Scene
    rows: npt.NDArray[np.intp]
    cover_low: Array
    cover_high: Array
    parts: list[Part] = field(default_factory=list)
    rotation: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))
    translation: Array = field(default_factory=lambda: np.zeros((0, 3)))
    box_center: Array = field(default_factory=lambda: np.zeros((0, 3)))
    box_half: Array = field(default_factory=lambda: np.zeros((0, 3)))
    transforms: list[Any] = field(default_factory=list)
    obstacle: npt.NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    @staticmethod
    def build(
        scene: Scene, low: Array, high: Array, slack: float, *, always: npt.NDArray[np.intp] | None = None
    ) -> Window:
        """Collect the parts near the boxes ``low``, ``high`` (N, 3) of the nodes, each grown by ``slack`` [m].

        The parts of the obstacles ``always`` are in it wherever they are.
        """
        low, high = low - slack, high + slack
        rows = _near_rows(scene, low, high)
        if always is not None and len(always):
            rows = np.union1d(rows, np.flatnonzero(np.isin(scene.table.obstacle_index, always)))
        window = Window(scene, rows, low, high)
        table = scene.table
        window.parts = [table.parts[r] for r in rows]
        window.rotation = table.rotation[rows].copy()
        window.translation = table.translation[rows].copy()
        window.obstacle = table.obstacle_index[rows]
        if len(rows):
            window.box_center = np.array([p.center - p.T_obstacle_part[:3, 3] for p in window.parts])
            window.box_half = np.array([p.half_extents for p in window.parts])
        window.transforms = [coal.Transform3s(r, t) for r, t in zip(window.rotation, window.translation, strict=True)]
        return window

    def __len__(self) -> int:
        return len(self.rows)

    def obstacle_name(self, part: int) -> str:
        """Name of the obstacle that a part belongs to."""
        return self.scene.names[int(self.obstacle[part])]

    def covered(self, low: Array, high: Array) -> npt.NDArray[np.bool_]:
        """(M,) whether each box (M, 3) lies in one of the window's boxes."""
        above = np.all(low[:, None] >= self.cover_low[None], axis=2)
        below = np.all(high[:, None] <= self.cover_high[None], axis=2)
        return np.asarray(np.any(above & below, axis=1), dtype=bool)

    def follow(self, scene: Scene) -> npt.NDArray[np.intp] | None:
        """Move to another snapshot of the same obstacles.

        Returns:
            The window's columns whose pose changed, or None where the window must be built anew: other obstacles, or
            one that came in from outside.
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
        for c in columns:
            self.transforms[c].setTransform(self.rotation[c], self.translation[c])
        self.scene = scene
        return columns

    def capsule_distance(self, ends: Array, radius: Array, part: npt.NDArray[np.intp]) -> Array:
        """Lower bounds (K,) [m] of the distances of capsules with ends (K, 2, 3) to the boxes of ``part`` (K,)."""
        one, two = ends[:, 0], ends[:, 1]
        along = two - one
        half = 0.5 * np.sqrt(np.einsum("ki,ki->k", along, along))
        return self.box_distance(0.5 * (one + two), part) - half - radius

    def box_distance(self, points: Array, part: npt.NDArray[np.intp] | slice) -> Array:
        """Distance [m] of world points (K, 3) to the oriented boxes of ``part`` (K,): 0 inside."""
        local = np.matmul((points - self.translation[part])[..., None, :], self.rotation[part])[..., 0, :]
        gap = np.abs(local - self.box_center[part]) - self.box_half[part]
        np.maximum(gap, 0.0, out=gap)
        return np.sqrt(np.einsum("...i,...i->...", gap, gap))


def _overlapping(table: Any, rows: npt.NDArray[np.intp], low: Array, high: Array) -> npt.NDArray[np.intp]:
    """Those ``rows`` whose box overlaps one of the boxes (N, 3)."""
    center, half = table.center[rows], table.half_extents[rows]
    part_low, part_high = center - half, center + half
    rows_in = ((part_low <= high.max(axis=0)) & (part_high >= low.min(axis=0))).all(axis=1)
    rows, part_low, part_high = rows[rows_in], part_low[rows_in], part_high[rows_in]
    keep = np.zeros(len(rows), dtype=bool)
    chunk = max(1, 2_000_000 // max(1, len(low)))
    for start in range(0, len(rows), chunk):
        s = slice(start, start + chunk)
        keep[s] = ((part_low[s, None] <= high[None]).all(axis=2) & (part_high[s, None] >= low[None]).all(axis=2)).any(
            axis=1
        )
    return rows[keep]


def _near_rows(scene: Scene, low: Array, high: Array) -> npt.NDArray[np.intp]:
    count = len(scene.table.parts)
    if count == 0 or len(low) == 0:
        return np.zeros(0, dtype=np.intp)
    return _overlapping(scene.table, np.arange(count), low, high)
