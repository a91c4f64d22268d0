"""Image lag: images that are older than they say are told from those that are on time, as long as the sensor moves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cases import each

from elastic_strips.perception.image_lag import ImageLag

PERIOD, SIGMA = 0.07, 0.02


def sensor(t: float, speed: float, rate: float = 0.0) -> np.ndarray:
    """A sensor that drives along x, and turns about the vertical meanwhile."""
    c, s = math.cos(rate * t), math.sin(rate * t)
    T = np.eye(4)
    T[:2, :2], T[0, 3] = [[c, -s], [s, c]], speed * t
    return T


def looking_about(t: float) -> np.ndarray:
    """A sensor that stands, and turns to and fro."""
    return sensor(1.0, 0.0, 0.4 * math.sin(5.0 * t))


def seen(lag: ImageLag, walls, lateness: float, *, images=12, at=None, speed=0.5, rate=0.0, bias=0.0, seed=0) -> None:
    """Points of images on walls (point, normal), displaced as those of a late image are: they were measured from where
    the sensor was then, and are put where it is said to be."""
    rng = np.random.default_rng(seed)
    at = at or (lambda t: sensor(t, speed, rate))
    for k in range(images):
        t = PERIOD * k
        T = at(t)
        moved = T @ np.linalg.inv(at(t - lateness))
        lag.come(t, T)
        points, normals, off = [], [], []
        for wall, normal in walls:
            along = np.cross(normal, (0.0, 0.0, 1.0))
            on = np.asarray(wall) + np.outer(rng.uniform(-1.0, 1.0, 20), along)
            there = on @ moved[:3, :3].T + moved[:3, 3]
            points.append(there)
            normals.append(np.broadcast_to(normal, there.shape))
            off.append((there - on) @ np.asarray(normal) + bias + rng.normal(0.0, SIGMA, len(there)))
        lag.compare(np.vstack(points), np.vstack(normals), np.concatenate(off), np.full(20 * len(walls), SIGMA))


AHEAD, BESIDE = ((4.0, 0.0, 1.0), (-1.0, 0.0, 0.0)), ((0.0, 2.0, 1.0), (0.0, -1.0, 0.0))


@each("speed, rate, lateness", [(0.5, 0.0, 0.3), (0.5, 0.3, 0.3), (-0.4, 0.0, 0.4), (0.6, 0.0, -0.3)])
def test_late_images_are_told_from_those_on_time(speed, rate, lateness):
    late, on_time = ImageLag(), ImageLag()
    seen(late, [AHEAD, BESIDE], lateness, speed=speed, rate=rate)
    seen(on_time, [AHEAD, BESIDE], 0.0, speed=speed, rate=rate)
    assert late.large
    assert late.seconds == pytest.approx(lateness, abs=0.08)
    assert not on_time.large
    assert abs(on_time.seconds) < 0.05


@each("lateness", [0.0, 0.2, 0.3])
def test_so_are_those_of_a_sensor_that_had_moved_otherwise_by_then(lateness):
    late = ImageLag()
    seen(late, [AHEAD, BESIDE], lateness, images=40, at=looking_about)
    assert late.large is (lateness > 0.0)
    assert late.seconds == pytest.approx(lateness, abs=0.04)


@each("walls, speed, bias", [([BESIDE], 0.5, 0.0), ([AHEAD, BESIDE], 0.0, 0.0), ([AHEAD, BESIDE], 0.02, 0.0),
                             ([AHEAD, BESIDE], 0.5, 0.04)])  # fmt: skip
def test_nothing_is_said_where_nothing_tells_the_time(walls, speed, bias):
    """Along walls, at rest, and by a small shift that has another cause."""
    lag = ImageLag()
    seen(lag, walls, 0.3 if not bias else 0.0, speed=speed, bias=bias)
    assert not lag.large


def test_what_was_late_is_forgotten_when_images_are_on_time_again():
    lag = ImageLag()
    seen(lag, [AHEAD], 0.3)
    assert lag.large
    lag.come(100.0, np.eye(4))  # after a pause nothing is known
    assert not lag.large
    seen(lag, [AHEAD], 0.3)
    for k in range(30):
        T = sensor(1.0 + PERIOD * k, 0.5)
        lag.come(1.0 + PERIOD * k, T)
        on = np.column_stack((np.full(20, 4.0), np.linspace(-1.0, 1.0, 20), np.ones(20)))
        lag.compare(on, np.broadcast_to(AHEAD[1], on.shape), np.zeros(20), np.full(20, SIGMA))
    assert not lag.large
