"""Scene room, table: all parts of a scene as arrays, ready for culling; cheap to derive for the next snapshot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from elastic_strips.scene.checks import Array
from elastic_strips.scene.obstacle import Obstacle
from elastic_strips.scene.parts import Part


@dataclass(frozen=True, slots=True, eq=False)
class PartTable:
    """Parts of all obstacles of a scene (P of them, obstacle by obstacle), world frame, read-only.

    Attributes:
        parts: The parts (P).
        obstacle_index: Index (P,) of each part's obstacle in the scene.
        offsets: Obstacle k owns the rows ``offsets[k]`` to ``offsets[k + 1]``; (K + 1,).
        rotation: Rotations of T_world_part (P, 3, 3).
        translation: Translations of T_world_part (P, 3) [m].
        center: Centres of the parts' world bounding boxes (P, 3) [m]; of their bounding spheres too.
        half_extents: Half sizes of the world bounding boxes (P, 3) [m].
        radius: Radii of the bounding spheres (P,) [m].
    """

    parts: tuple[Part, ...]
    obstacle_index: NDArray[np.int64]
    offsets: NDArray[np.int64]
    rotation: Array
    translation: Array
    center: Array
    half_extents: Array
    radius: Array
    _local_translation: Array  # (P, 3), in the obstacles' frames
    _local_center: Array
    _local_half: Array

    def __len__(self) -> int:
        return len(self.parts)


def build_table(obstacles: Sequence[Obstacle]) -> PartTable:
    """Table of ``obstacles`` from scratch."""
    solids = [o.solid for o in obstacles]
    counts = np.array([len(s.parts) for s in solids], dtype=np.int64)
    offsets = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(counts)])
    index = np.repeat(np.arange(len(solids)), counts)
    none = np.zeros((0, 3))
    local_translation = np.concatenate([none, *(s.translation for s in solids)])
    local_center = np.concatenate([none, *(s.center for s in solids)])
    local_half = np.concatenate([none, *(s.half_extents for s in solids)])
    radius = np.concatenate([np.zeros(0), *(s.radius for s in solids)])
    poses = np.array([o.pose for o in obstacles]).reshape(-1, 4, 4)[index]
    rotation, origin = np.ascontiguousarray(poses[:, :3, :3]), poses[:, :3, 3]
    translation = np.einsum("pij,pj->pi", rotation, local_translation) + origin
    center = np.einsum("pij,pj->pi", rotation, local_center) + origin
    half = np.minimum(np.einsum("pij,pj->pi", np.abs(rotation), local_half), radius[:, None])
    arrays = (index, offsets, rotation, translation, center, half, radius, local_translation, local_center, local_half)
    for array in arrays:
        array.flags.writeable = False
    return PartTable(tuple(chain.from_iterable(s.parts for s in solids)), *arrays)


def update_table(table: PartTable, obstacles: Sequence[Obstacle], changed: Sequence[int]) -> PartTable:
    """Table of ``obstacles``, which differ from those of ``table`` only in the poses of the ``changed`` ones."""
    rotation, translation = table.rotation.copy(), table.translation.copy()
    center, half = table.center.copy(), table.half_extents.copy()
    if len(changed) == 1:
        k = changed[0]
        pose = obstacles[k].pose
        turn, origin = pose[:3, :3], pose[:3, 3]
        rows = slice(int(table.offsets[k]), int(table.offsets[k + 1]))
        rotation[rows] = turn
        translation[rows] = table._local_translation[rows] @ turn.T + origin
        center[rows] = table._local_center[rows] @ turn.T + origin
        half[rows] = np.minimum(table._local_half[rows] @ np.abs(turn).T, table.radius[rows, None])
    else:
        poses = np.array([obstacles[k].pose for k in changed])
        number = np.full(len(table.offsets) - 1, -1)
        number[list(changed)] = np.arange(len(changed))
        which = number[table.obstacle_index]
        rows = np.flatnonzero(which >= 0)
        pose = poses[which[rows]]
        turn, origin = pose[:, :3, :3], pose[:, :3, 3]
        rotation[rows] = turn
        translation[rows] = np.einsum("pij,pj->pi", turn, table._local_translation[rows]) + origin
        center[rows] = np.einsum("pij,pj->pi", turn, table._local_center[rows]) + origin
        spread = np.einsum("pij,pj->pi", np.abs(turn), table._local_half[rows])
        half[rows] = np.minimum(spread, table.radius[rows, None])
    for array in (rotation, translation, center, half):
        array.flags.writeable = False
    return PartTable(
        table.parts,
        table.obstacle_index,
        table.offsets,
        rotation,
        translation,
        center,
        half,
        table.radius,
        table._local_translation,
        table._local_center,
        table._local_half,
    )
