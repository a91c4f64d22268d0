"""Slip: what wheels explain, what they do not, and when fixes are believed again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from cases import each

from elastic_strips.control.estimation import StateEstimator
from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.control.slip import slip_bounds
from elastic_strips.sim.plant import KinematicPlant
from elastic_strips.trajectory import MotionLimits

DT = 0.01
Wrong = Callable[[float, np.ndarray], np.ndarray]


class Drive:
    """A plant that drives straight on, and an estimator that gets fixes that are off."""

    def __init__(self, robot, seed: int = 0) -> None:
        limits = MotionLimits.for_robot(robot, joint_speed=1.0)
        self.robot, self.plant, self.estimator = robot, KinematicPlant(robot, limits, seed=seed), None
        self.estimator = StateEstimator(robot, limits)
        self.estimator.reset(self.plant.coordinates)
        self.n = len(robot.joint_names)
        self.worst = 0.0

    def go(self, seconds: float, speed: float, wrong: Wrong = lambda t, pose: pose, *, lost=(0.0, 0.0)) -> list[float]:
        """Times at which fixes and odometry contradicted each other; it stands from then on."""
        said = []
        k = len(self.plant.limits.drive_speed)
        drive = np.full(2, speed) if k == 2 else np.array([speed, 0.0, 0.0])
        for _ in range(round(seconds / DT)):
            drive = 0.0 * drive if self.estimator.contradiction else drive
            self.plant.lost = [*lost, 0.0][:k]
            m = self.plant.step(Command(drive, np.zeros(self.n)), DT)
            if m.pose is not None:
                m = replace(m, pose=wrong(self.plant.time, m.pose))
            estimate = self.estimator.update(m)
            self.worst = max(self.worst, float(np.hypot(*(estimate - self.plant.coordinates)[:2])))
            if self.estimator.contradiction:
                said.append(self.plant.time)
        return said


def sideways(rate: float, begin: float) -> Wrong:
    """Fixes that drift along the world's y axis from a time on."""
    return lambda t, pose: pose + np.array([0.0, rate * max(t - begin, 0.0), 0.0])


@each("name, speed", [("silvermate", 0.8), ("silvermate", 0.3), ("silvermate", 0.0), ("tiago", 0.7), ("rover", 0.5)])
def test_fixes_that_drift_sideways_are_believed_no_longer(request, name, speed):
    for rate in (0.03, -0.05):
        drive = Drive(request.getfixturevalue(name))
        assert not drive.go(2.0, speed)
        said = drive.go(4.0, speed, sideways(rate, 2.0))
        assert said
        assert said[0] - 2.0 < 1.0
        assert said[-1] == drive.plant.time
        assert drive.worst < 0.06  # the fixes are 0.12 or 0.2 m off by then


def test_at_rest_no_drift_is_explained(silvermate):
    drive = Drive(silvermate)
    drive.go(1.0, 0.0)
    said = drive.go(4.0, 0.0, lambda t, pose: pose + np.array([0.03 * (t - 1.0), 0.0, 0.0]))
    assert said
    assert said[0] < 2.0


@each(
    "wrong, lost",
    [
        (lambda t, pose: pose, (0.0, 0.0)),
        (lambda t, pose: pose, (0.5, 0.0)),
        (lambda t, pose: pose, (0.0, 0.9)),
        (lambda t, pose: pose, (1.0, 1.0)),
        (lambda t, pose: pose + np.array([0.0, 1.0, 0.0]), (0.0, 0.0)),  # a jump has words of its own
        (lambda t, pose: pose + np.array([0.0, 0.0, 0.008]), (0.0, 0.0)),  # turned a little
    ],
)
def test_wheels_that_slip_and_fixes_that_jump_are_no_drift(silvermate, wrong, lost):
    for seed in range(2):
        drive = Drive(silvermate, seed)
        said = drive.go(1.0, 0.8) + drive.go(3.0, 0.8, wrong, lost=lost) + drive.go(2.0, 0.8) + drive.go(2.0, 0.0)
        assert not said


def test_a_drift_is_forgotten_where_fixes_agree_at_rest_or_somebody_says_so(silvermate):
    drive = Drive(silvermate)
    drive.go(1.0, 0.5)
    assert drive.go(3.0, 0.5, sideways(0.03, 1.0))
    stays = lambda t, pose: pose + np.array([0.0, 0.12, 0.0])  # noqa: E731
    assert drive.go(8.0, 0.0, stays)[-1] == drive.plant.time, "they agree with each other, but not with the wheels"
    assert drive.go(8.0, 0.0)[-1] < drive.plant.time - 2.0
    assert not drive.go(1.0, 0.5)
    assert np.hypot(*(drive.estimator._pose[:2] - drive.plant.coordinates[:2])) < 0.02
    assert drive.go(4.0, 0.5, sideways(0.03, drive.plant.time))
    drive.estimator.trust()
    drive.go(0.3, 0.0, stays)
    assert not drive.estimator.contradiction
    assert drive.estimator._pose[1] - drive.plant.coordinates[1] == pytest.approx(0.12, abs=0.02)


def test_wheels_shift_a_base_along_itself(silvermate):
    limits = MotionLimits.for_robot(silvermate)
    ahead = slip_bounds(limits, np.array([0.1, 0.2]), 0.01, 0.0)
    assert ahead[:2] == pytest.approx([0.2, 0.002])
    assert ahead[2] == pytest.approx(0.3 / limits.track)
    assert slip_bounds(limits, np.array([0.1, 0.2]), 0.01, 0.5)[1] == pytest.approx(0.102)
    every_way = slip_bounds(limits, np.array([0.1, 0.2, 0.0]), 0.0, 0.0)
    assert every_way[:2] == pytest.approx([0.1, 0.2])


def test_a_robot_without_fixes_has_no_contradiction(silvermate):
    estimator = StateEstimator(silvermate, MotionLimits.for_robot(silvermate))
    home = silvermate.space.to_coordinates(silvermate.home_q)
    estimator.reset(home)
    for k in range(1, 200):
        estimator.update(Measurement(DT * k, np.full(2, 0.005), home[3:]))
    estimator.trust()
    assert not estimator.contradiction
