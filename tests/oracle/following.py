"""Driving a trajectory on a plant, for tests of tracking and of machines."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from elastic_strips.control.estimation import StateEstimator
from elastic_strips.control.tracking import TrackingController
from elastic_strips.sim.plant import Plant
from elastic_strips.trajectory import Trajectory


class FollowedRun(NamedTuple):
    """One drive, sampled at the end of every control period: times (S,) [s], coordinate rows (S, nv)."""

    time: np.ndarray
    reference: np.ndarray
    truth: np.ndarray
    estimate: np.ndarray


def follow_trajectory(
    trajectory: Trajectory,
    plant: Plant,
    estimator: StateEstimator,
    controller: TrackingController,
    *,
    dt: float = 0.01,
    after: float = 0.3,
) -> FollowedRun:
    """Drive a trajectory from its first sample to ``after`` [s] past its end, with a command every ``dt`` [s]."""
    start = trajectory.start_time
    plant.reset(trajectory.coordinates[0], start)
    estimator.reset(trajectory.coordinates[0], start)
    count = int(np.ceil((trajectory.duration + after) / dt - 1e-9))
    time = start + dt * np.arange(count + 1, dtype=float)
    estimate, state = trajectory.coordinates[0], trajectory.at(start)
    rows = [(estimate, estimate, estimate)]
    for t in time[1:].tolist():
        measurement = plant.step(controller.command(state, estimate), dt)
        estimate = estimator.update(measurement)
        state = trajectory.at(t)
        rows.append((state.coordinates, plant.coordinates, estimate))
    return FollowedRun(time, *np.array(rows).transpose(1, 0, 2))
