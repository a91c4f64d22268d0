"""Mover tracks: how moving obstacles have changed their velocities of late."""

from __future__ import annotations

from collections import deque

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.scene import Scene, UnknownMotion

from .prediction import Outlook

_CHANGE_TIME = 0.2  # [s] over which changes of velocity are measured
_LONGEST_GAP = 0.35  # [s] between two scenes; after a longer one a track begins anew
_PLAUSIBLE = 1.2  # times the assumed acceleration, with the noise of the velocities: more is another course


class MoverTracks:
    """Workspace: the stated velocities of moving obstacles, by name, from scene to scene.

    An obstacle whose motion is unknown has no track, and one that comes back after a gap begins anew.
    """

    def __init__(self) -> None:
        self._time = -np.inf
        self._tracks: dict[str, deque[tuple[float, Array]]] = {}  # name → times [s] and velocities (3,) [m/s]

    def take(self, scene: Scene) -> None:
        """Take in a sensed scene; one that is not newer says nothing."""
        if scene.time <= self._time:
            return
        before = self._tracks if scene.time - self._time <= _LONGEST_GAP else {}
        self._time, self._tracks = scene.time, {}
        for obstacle in scene:
            if obstacle.motion is None or isinstance(obstacle.motion, UnknownMotion) or not obstacle.name:
                continue
            track = self._tracks[obstacle.name] = before.get(obstacle.name) or deque()
            track.append((scene.time, obstacle.velocity()[0]))
            while len(track) > 1 and scene.time - track[1][0] >= _CHANGE_TIME:
                track.popleft()

    def trend(self, outlook: Outlook) -> Array:
        """(M, 3) accelerations [m/s²] with which the obstacles of an outlook's forecast change their velocities.

        It is 0 for those that have only just appeared, where errors of the sensed velocities may feign as much, and
        for those that have changed their velocities by more than is assumed: they have taken another course, and do not
        go on turning to it.
        """
        possible, names = outlook.possible, outlook.scene.names
        trend = np.zeros((len(possible), 3))
        for m, k in enumerate(possible.obstacles):
            track = self._tracks.get(names[k])
            if track is not None and len(track) > 1:
                (then, before), (now, velocity) = track[0], track[-1]
                trend[m] = (velocity - before) / max(now - then, _CHANGE_TIME)
        size = np.linalg.norm(trend, axis=1)
        feigned = 2.0 * outlook.assumptions.velocity_error / _CHANGE_TIME
        trend[(size < feigned) | (size > _PLAUSIBLE * possible.acceleration)] = 0.0
        return trend
