"""Stamps on the executor's clock, and where the robot was between its messages."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cases import each

from elastic_strips.ros2 import MessageError
from elastic_strips.ros2.stamps import StampClock, StampedRows, read_together

NOW = 1_795_780_381_000_000_000  # [ns]


def clock() -> StampClock:
    made = StampClock(0.5)
    made.epoch = 100.0
    return made


def test_two_clocks_are_read_at_the_same_time():
    """Something comes between them twice, and it is as long as between two messages."""
    t, waits = 10.0, iter([0.03, 0.0, 0.0, 0.02, 0.0])

    def monotonic() -> float:
        nonlocal t
        t += 1e-6
        return t

    def ros() -> int:
        nonlocal t
        found = round(1e9 * (t + 100.0))
        t += next(waits)
        return found

    now, read = read_together(ros, monotonic)
    assert 1e-9 * now - read == pytest.approx(100.0, abs=1e-5)
    waits = iter([0.03, 0.01, 0.02, 0.04, 0.05])
    now, read = read_together(ros, monotonic)
    assert 1e-9 * now - read == pytest.approx(100.0, abs=0.006), "the best of five"


@each("age", (0.0, 0.02, 0.4))
def test_a_stamp_is_so_old_on_either_clock(age: float):
    assert clock().time(NOW - round(1e9 * age), NOW, 103.0) == pytest.approx(3.0 - age)


def test_a_stamp_that_is_a_little_ahead_is_now():
    assert clock().time(NOW + 5_000_000, NOW, 103.0) == pytest.approx(3.0)


@each("age", (-5.0, -0.02, 0.6, 5.0))
def test_a_stamp_that_is_far_from_now_is_refused(age: float):
    with pytest.raises(MessageError, match=f"{abs(age):.3g}"):
        clock().time(NOW - round(1e9 * age), NOW, 103.0)


def test_a_stamp_that_says_until_when_something_holds_is_now():
    assert clock().time(NOW + 900_000_000, NOW, 103.0, ahead=1.0) == pytest.approx(3.0)
    with pytest.raises(MessageError, match=r"1\.1"):
        clock().time(NOW + 1_100_000_000, NOW, 103.0, ahead=1.0)


def test_the_epoch_is_learnt_from_the_call_that_was_least_late():
    made = StampClock(0.5)
    for k, late in enumerate((0.003, 0.0002, 0.004)):
        made.tick(0.01 * k, 100.0 + 0.01 * k + late)
    assert made.epoch == pytest.approx(100.0002)


def rows(times: list[float], gap: float = 0.5) -> StampedRows:
    made = StampedRows(turns=(2,), gap=gap)
    for t in times:
        made.add(t, np.array([t, 2.0 * t, 3.0 + t]))
    return made


def test_a_row_is_interpolated_by_the_shorter_turn():
    made = StampedRows(turns=(2,))
    made.add(0.0, np.array([0.0, 0.0, 3.1]))
    made.add(0.1, np.array([1.0, 2.0, -3.1]))
    half = made.at(0.05)
    np.testing.assert_allclose(half[:2], [0.5, 1.0])
    assert abs(math.remainder(half[2] - math.pi, 2.0 * math.pi)) < 1e-9
    np.testing.assert_allclose(made.at(0.1), [1.0, 2.0, -3.1])


@each("t", (-0.1, 0.31, 0.2))
def test_what_is_too_old_too_new_or_in_a_gap_is_refused(t: float):
    made = rows([0.0, 0.1, 0.3], gap=0.15)
    with pytest.raises(MessageError, match="nothing is known"):
        made.at(t)


@each("t", (0.1, 0.05))
def test_a_message_twice_or_out_of_order_is_refused(t: float):
    with pytest.raises(MessageError, match="comes after"):
        rows([0.0, 0.1]).add(t, np.zeros(3))


def test_old_rows_are_forgotten_and_the_period_is_their_median():
    made = rows([0.02 * k for k in range(200)])
    assert made.oldest > 1.9
    assert made.period == pytest.approx(0.02)
    assert rows([0.0, 0.1]).period == math.inf
