"""Seen replay: what sensors made of the world, beside the true one, while a recorded run is played."""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control.seen_rows import SEEN_SHAPES, SeenRows

from . import commands, geometry
from .commands import Command, Track
from .drawing_obstacles import estimated_look
from .geometry import Floats

PATH = "/map/seen"
_MOST_MOMENTS, _LEAST_MOMENTS = 48, 8
_MOST_SHAPES = 20_000  # in the page, each of which takes 64 bytes


def draw_seen(seen: SeenRows, times: Array, tracks: list[Track]) -> list[Command]:
    """What was seen at some moments between the first and the last of ``times`` (F,) [s], each shown until the next.

    What was there at the same moments is one object, however many shapes it has.
    """
    if not len(seen):
        return []
    first, last = _at_moments(seen, times)
    out: list[Command] = []
    shown = first < last  # of many, few are
    kinds = np.column_stack((first, last, seen.shape, seen.moves))[shown]
    spans, which = np.unique(kinds, axis=0, return_inverse=True)
    matrices = _matrices(seen)[shown]
    for k, (begin, end, shape, moves) in enumerate(spans.tolist()):
        path, these = f"{PATH}/{k}", matrices[which.ravel() == k]
        mesh = geometry.UNIT_MESHES[SEEN_SHAPES[int(shape)]]()
        out.append(commands.mesh(path, mesh, estimated_look(moves=bool(moves)), instances=len(these), cast=False))
        out.append(commands.instances(path, these))
        tracks.append(commands.visible_track(path, (times >= begin) & (times < end)))
    return out


def _at_moments(seen: SeenRows, times: Array) -> tuple[Array, Array]:
    """The moments (K,) [s] from which, and until which, each shape is shown; of as few moments as the page can hold.

    A shape that was there at none of them has the same moment twice.
    """
    looks = np.unique(np.concatenate(([times[0]], seen.begin[(seen.begin > times[0]) & (seen.begin < times[-1])])))
    count = min(len(looks), _MOST_MOMENTS)
    while True:
        moments = looks[np.unique(np.linspace(0, len(looks) - 1, count).round().astype(int))]
        first, last = np.searchsorted(moments, seen.begin), np.searchsorted(moments, seen.end)
        if np.sum(last > first) <= _MOST_SHAPES or count <= _LEAST_MOMENTS:
            ends = np.append(moments, np.inf)
            return ends[first], ends[last]
        count //= 2


def _matrices(seen: SeenRows) -> Floats:
    """(K, 16) where the unit meshes of the shapes are, and how large."""
    from scipy.spatial.transform import Rotation  # late: slow to import

    T = np.tile(np.eye(4), (len(seen), 1, 1))
    half = np.array([name != "box" for name in SEEN_SHAPES])[seen.shape]  # a unit sphere has radius 1, a box edges of 1
    factors = seen.size.copy()
    factors[half, :2] *= 0.5
    factors[np.array([name == "sphere" for name in SEEN_SHAPES])[seen.shape], 2] *= 0.5
    T[:, :3, :3] = Rotation.from_quat(seen.quaternion).as_matrix() * factors[:, None, :]
    T[:, :3, 3] = seen.position
    return commands.columns(T)
