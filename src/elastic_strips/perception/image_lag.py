"""Image lag: by how much the images of a sensor that moves are older than they say, by what a laser sees."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from elastic_strips.arrays import Array

from .displacement import ALIKE, SURE, reweighted

_LEAST_COMPARED = 10  # points
_LEAST_SPEED = 0.05  # [m/s] along the normals of what is compared, in the mean: nothing is told by less
_LONGEST_STEP = 0.5  # [s] between two images, after which it is not known how the sensor has moved
_BEFORE = 0.5  # [s] standard deviation of the lag of an image, a priori
_ALL_OFF = 0.02  # [m] by which all points of an image may be off together
_REMEMBERED = 0.3  # [s] after which an image counts e times less
_MOST = 0.07  # [s]
_POSES_FOR = 0.7  # [s]
_FURTHEST = 0.6  # [s] of a lag that is looked for
_ROUNDS = 3


class ImageLag:
    """Workspace: the lag of a sensor's images behind their time stamps, from image to image.

    An image that is late shows all that stands where it would be if the sensor had been there already: displaced by as
    much as the sensor has moved meanwhile. A displacement of a few centimetres may have other causes; one that is the
    way of the same time from image to image does not.
    """

    def __init__(self) -> None:
        self._poses: deque[tuple[float, Array]] = deque()  # the last ones: time [s] and (4, 4)
        self._T_sensor_world = np.eye(4)  # of the newest one
        self._sum = self._weight = 0.0

    @property
    def seconds(self) -> float:
        """The lag [s]; negative where images are of later than they say."""
        return self._sum / self._weight if self._weight else 0.0

    @property
    def large(self) -> bool:
        """Whether it is larger than errors are."""
        return bool(self._weight) and abs(self.seconds) > _MOST + SURE / math.sqrt(self._weight)

    def come(self, time: float, T_world_sensor: Array) -> None:
        """An image has come.

        Args:
            time: of its stamp [s].
            T_world_sensor: (4, 4) where the sensor was then.
        """
        poses = self._poses
        step = time - poses[-1][0] if poses else 0.0
        if 0.0 < step <= _LONGEST_STEP:
            kept = math.exp(-step / _REMEMBERED)
            self._sum, self._weight = kept * self._sum, kept * self._weight
        else:
            poses.clear()
            self._sum = self._weight = 0.0
        poses.append((time, T_world_sensor))
        self._T_sensor_world = np.linalg.inv(T_world_sensor)
        while time - poses[0][0] > _POSES_FOR:
            poses.popleft()

    def compare(self, points: Array, normals: Array, off: Array, sigma: Array) -> None:
        """Take in how points of that image are off what a laser sees.

        Args:
            points: (n, 3) in the world [m].
            normals: (n, 3) of the surfaces there.
            off: (n,) how far they are off along these [m].
            sigma: (n,) standard deviations [m].
        """
        if len(self._poses) < 2 or len(points) < _LEAST_COMPARED:
            return
        prior, half = np.array([[_BEFORE**-2]]), 0.5 * (self._poses[-1][0] - self._poses[-2][0])
        lag, typical, known = self.seconds, 0.0, 0.0
        for _ in range(_ROUNDS):  # it may have moved otherwise then
            less, by, more = (self._displaced(points, normals, lag + d) for d in (-half, 0.0, half))
            speed = (more - less) / (2.0 * half)
            typical = math.sqrt(float(np.mean(speed * speed)))
            if typical < _LEAST_SPEED:
                return
            x, H = reweighted((speed / sigma)[:, None], (off - by + speed * lag) / sigma, prior, settled=0.0)
            lag, known = float(np.clip(x[0], -_FURTHEST, _FURTHEST)), float(H[0, 0])
        told = 1.0 / (ALIKE**2 / max(known, 1e-9) + (_ALL_OFF / typical) ** 2)
        self._sum, self._weight = self._sum + told * lag, self._weight + told

    def _displaced(self, points: Array, normals: Array, lag: float) -> Array:
        """How far (n,) points are off along normals where the newest image is late by this [s]."""
        late = self._pose(lag) @ self._T_sensor_world
        return np.einsum("ij,ij->i", normals, points - points @ late[:3, :3].T - late[:3, 3])

    def _pose(self, ago: float) -> Array:
        """Where the sensor was (4, 4) that long [s] before the newest image, between the poses that are known, and as
        it moved there before and after them."""
        poses, at = self._poses, self._poses[-1][0] - ago
        k = len(poses) - 2
        while k > 0 and poses[k][0] > at:
            k -= 1
        (begin, one), (end, two) = poses[k], poses[k + 1]
        part = (at - begin) / (end - begin)
        return (1.0 - part) * one + part * two
