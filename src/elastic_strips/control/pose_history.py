"""Pose history: where a base believed to be, so that a late reading finds the pose it was taken at."""

from __future__ import annotations

from collections import deque

import numpy as np

from elastic_strips.arrays import Array

_KEPT = 200


class PoseHistory:
    """Workspace: the last estimates of a base's pose."""

    def __init__(self) -> None:
        self._entries: deque[tuple[float, Array]] = deque(maxlen=_KEPT)

    def add(self, t: float, estimate: Array) -> None:
        """The base believes at ``t`` [s] to be at the x, y [m], yaw [rad] with which a chart row (nv,) begins."""
        self._entries.append((t, np.array(estimate[:3])))

    def at(self, t: float) -> Array:
        """(3,) the pose of the estimate that is nearest in time."""
        return min(self._entries, key=lambda entry: abs(entry[0] - t))[1]

    def velocity(self, over: int) -> Array:
        """(2,) speed [m/s] and yaw rate [rad/s] over the last so many estimates."""
        (t0, a), (t1, b) = self._entries[max(-over, -len(self._entries))], self._entries[-1]
        if t1 <= t0:
            return np.zeros(2)
        forward = np.array([np.cos(b[2]), np.sin(b[2])]) @ (b[:2] - a[:2])
        return np.array([forward, np.remainder(b[2] - a[2] + np.pi, 2.0 * np.pi) - np.pi]) / (t1 - t0)
