"""Tracking bound: how far any point of the robot is from where its reference has it, measured over seeded runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision.bounds import BodySet
from elastic_strips.control.estimation import StateEstimator
from elastic_strips.control.tracking import TrackingController, TrackingGains
from elastic_strips.errors import ParameterError
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.trajectory import MotionLimits, Trajectory

from .plant import KinematicPlant, Plant, PlantParams

DEFAULT_TRACKING_ERROR = 0.02
"""How far [m] any point of the robot may be from its reference, with the default plant, gains and estimator.

Measured on planned and retimed corridors (Silvermate: 26, every other one ending with an outstretched arm; TIAGo: 13),
at all of the limits and at 95 % of the speeds and 75 % of the accelerations, 220 seeds each, 880 runs or 3.5 hours of
driving: half of all samples within 0.0029 m, 99 % within 0.0091 m, the largest 0.0179 m (Silvermate: 0.0169 m). It is
the slip of the wheels that makes it: without noise and slip 0.0014 m is left. What else a machine may do, largest of 60
runs: twice the slip 0.025 m, motors that lag half as long again or half as long as believed 0.025 m, fixes twice as
noisy 0.021 m. On the MuJoCo plant, largest of 30 runs: Silvermate 0.0203 m, TIAGo with wheels sped up by at most
0.8 m/s² 0.028 m.
"""


@dataclass(frozen=True, slots=True, eq=False)
class FollowedRun:
    """One drive along a trajectory, sampled at the end of every control period.

    Attributes:
        time: (S,) [s].
        reference, truth, estimate: (S, nv) chart rows.
    """

    time: Array
    reference: Array
    truth: Array
    estimate: Array


@dataclass(frozen=True, slots=True, eq=False)
class TrackingErrors:
    """Largest errors of each run (R runs), and those of all samples (S of them).

    Attributes:
        displacement: (R,) of any point of the robot between truth and reference at the same time [m].
        position: (R,) of the base's origin [m].
        heading: (R,) of the base [rad].
        joint: (R,) of any joint [rad or m].
        estimate_position: (R,) of the estimate of the base's origin [m].
        estimate_heading: (R,) of the estimate of the heading [rad].
        samples: (S,) displacements at all samples of all runs [m].
    """

    displacement: Array
    position: Array
    heading: Array
    joint: Array
    estimate_position: Array
    estimate_heading: Array
    samples: Array

    @property
    def max(self) -> float:
        """Largest displacement of all [m]."""
        return float(self.displacement.max(initial=0.0))

    def percentile(self, percent: float) -> float:
        """A percentile of the displacement at all samples [m]."""
        return float(np.percentile(self.samples, percent))


def follow_trajectory(
    trajectory: Trajectory,
    plant: Plant,
    estimator: StateEstimator,
    controller: TrackingController,
    *,
    dt: float = 0.01,
    after: float = 0.3,
) -> FollowedRun:
    """Drive a trajectory from its first sample to ``after`` [s] past its end, with a command every ``dt`` [s].

    Plant and estimator are reset to the trajectory's start.
    """
    start = trajectory.start_time
    plant.reset(trajectory.chart[0], start)
    estimator.reset(trajectory.chart[0], start)
    count = int(np.ceil((trajectory.duration + after) / dt - 1e-9))
    reference = np.empty((count + 1, trajectory.robot.nv))
    truth, estimates = np.empty_like(reference), np.empty_like(reference)
    time = start + dt * np.arange(count + 1, dtype=float)
    estimate = trajectory.chart[0]
    state = trajectory.at(start)
    reference[0] = truth[0] = estimates[0] = estimate
    for i in range(count):
        measurement = plant.step(controller.command(state, estimate), dt)
        estimate = estimator.update(measurement)
        state = trajectory.at(float(time[i + 1]))
        reference[i + 1], truth[i + 1], estimates[i + 1] = state.chart, plant.chart, estimate
    return FollowedRun(time, reference, truth, estimates)


class Displacement:
    """Bounds how far any point of the robot's bodies is between two configurations.

    A body lies within its capsule. A point of it is a point of the capsule's segment plus a vector of at most its
    radius r: between two poses it moves by at most the larger way of the segment's two ends, plus ``2 r sin(φ/2)``
    where φ is the angle between the poses. It is an upper bound, loose by at most that second part.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._bodies = BodySet.links(robot)
        self._one, self._two = Kinematics(robot.tree), Kinematics(robot.tree)

    def __call__(self, a: Array, b: Array) -> Array:
        """Bounds (S,) [m] between the chart rows ``a`` and ``b`` (S, nv)."""
        self._one.update(a, jacobians=False)
        self._two.update(b, jacobians=False)
        bodies = self._bodies
        ends = bodies.capsule_ends(self._two) - bodies.capsule_ends(self._one)  # (S, G, 2, 3)
        way = np.sqrt((ends**2).sum(axis=-1)).max(axis=-1)
        R_one, R_two = self._one.T[:, : self._one.n, :, :3], self._two.T[:, : self._two.n, :, :3]
        # 2 sin(φ/2) is the norm of R_two − R_one as a map: its Frobenius norm over √2
        turn = np.sqrt(((R_two - R_one) ** 2).sum(axis=(-2, -1)) * 0.5).T  # (S, njoints)
        return (way + bodies.radius * turn[:, bodies.joint]).max(axis=1, initial=0.0)


def tracking_errors(robot: RobotModel, runs: Iterable[FollowedRun]) -> TrackingErrors:
    """Errors of followed runs."""
    measure, space = Displacement(robot), robot.space
    first = space.base_nv
    rows: list[list[float]] = []
    samples: list[Array] = []
    for run in runs:
        bound = measure(run.reference, run.truth)
        off = space.difference(run.reference, run.truth)
        seen = space.difference(run.truth, run.estimate)
        position = [_length(run.reference, run.truth, first), _length(run.truth, run.estimate, first)]
        angle = [float(np.abs(d[:, 2]).max(initial=0.0)) if first else 0.0 for d in (off, seen)]
        joint = float(np.abs(off[:, first:]).max(initial=0.0))
        rows.append([float(bound.max()), position[0], angle[0], joint, position[1], angle[1]])
        samples.append(bound)
    table = np.array(rows).reshape(-1, 6)
    displacement, position, heading, joint, seen_position, seen_heading = table.T.copy()
    every = np.concatenate([np.zeros(0), *samples])
    return TrackingErrors(displacement, position, heading, joint, seen_position, seen_heading, every)


def _length(a: Array, b: Array, first: int) -> float:
    return float(np.hypot(b[:, 0] - a[:, 0], b[:, 1] - a[:, 1]).max(initial=0.0)) if first else 0.0


def measure_tracking(
    robot: RobotModel,
    limits: MotionLimits,
    trajectories: Sequence[Trajectory],
    params: PlantParams | None = None,
    seeds: Iterable[int] = range(200),
    *,
    gains: TrackingGains | None = None,
    dt: float = 0.01,
) -> TrackingErrors:
    """Drive trajectories on the kinematic plant and measure how far any point of the robot is off its reference.

    Args:
        robot: the robot.
        limits: what the trajectories are planned with.
        trajectories: run i drives trajectory i modulo their number.
        params: of the plant.
        seeds: one run each.
        gains: of the tracking controller.
        dt: control period [s].

    Raises:
        ParameterError: no trajectory.
    """
    if not trajectories:
        raise ParameterError("measure_tracking needs at least one trajectory")
    controller, estimator = TrackingController(robot, limits, gains), StateEstimator(robot, limits)

    def runs() -> Iterable[FollowedRun]:
        for i, seed in enumerate(seeds):
            plant = KinematicPlant(robot, limits, params, seed)
            yield follow_trajectory(trajectories[i % len(trajectories)], plant, estimator, controller, dt=dt)

    return tracking_errors(robot, runs())
