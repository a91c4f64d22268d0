"""Image lag: by how much the images of a sensor that moves are older than they say, by what a laser sees."""

from __future__ import annotations

import math

import numpy as np

from elastic_strips.arrays import Array

from .displacement import ALIKE, SURE, reweighted

_LEAST_COMPARED = 10  # points
_LEAST_SPEED = 0.05  # [m/s] along the normals of what is compared, in the mean: nothing is told by less
_LONGEST_STEP = 0.5  # [s] between two images, after which it is not known how the sensor has moved
_ALL_OFF = 0.02  # [m] by which all points of an image may be off together
_BEFORE = 0.5  # [s] standard deviation of the lag of an image, a priori
_REMEMBERED = 0.3  # [s] after which an image counts e times less
_MOST = 0.1  # [s]


class ImageLag:
    """Workspace: the lag of a sensor's images behind their time stamps, from image to image.

    An image that is late shows all that stands where it would be if the sensor had been there already: displaced by as
    much as the sensor has moved meanwhile. A displacement of a few centimetres may have other causes; one that is the
    way of the same time from image to image does not.
    """

    def __init__(self) -> None:
        self._last: tuple[float, Array] | None = None
        self._moved: Array | None = None  # (4, 4), how the sensor has moved in the world since the last image
        self._step = 0.0  # [s] since then
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
        last, self._last, self._moved = self._last, (time, T_world_sensor), None
        if last is None or not 0.0 < time - last[0] <= _LONGEST_STEP:
            self._sum = self._weight = 0.0
            return
        self._step = time - last[0]
        self._moved = T_world_sensor @ np.linalg.inv(last[1])
        kept = math.exp(-self._step / _REMEMBERED)
        self._sum, self._weight = kept * self._sum, kept * self._weight

    def compare(self, points: Array, normals: Array, off: Array, sigma: Array) -> None:
        """Take in how points of that image are off what a laser sees.

        Args:
            points: (n, 3) in the world [m].
            normals: (n, 3) of the surfaces there.
            off: (n,) how far they are off along these [m].
            sigma: (n,) standard deviations [m].
        """
        if self._moved is None or len(points) < _LEAST_COMPARED:
            return
        R, p = self._moved[:3, :3], self._moved[:3, 3]
        speed = np.einsum("ij,ij->i", normals, points @ R.T + p - points) / self._step
        typical = math.sqrt(float(np.mean(speed * speed)))
        if typical < _LEAST_SPEED:
            return
        A, prior = (speed / sigma)[:, None], np.array([[_BEFORE**-2]])
        x, H = reweighted(A, off / sigma, prior, settled=0.0)
        lag, known = float(x[0]), float(H[0, 0])
        told = 1.0 / (ALIKE**2 / max(known, 1e-9) + (_ALL_OFF / typical) ** 2)
        self._sum, self._weight = self._sum + told * lag, self._weight + told
