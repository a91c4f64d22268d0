"""The tracking bound: a displacement that no point of the robot exceeds, and what runs on the plant stay below."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from cases import each_robot
from following import follow_trajectory
from motions import smooth_motion

from elastic_strips.coal_shapes import support_points
from elastic_strips.collision.bounds import Displacement
from elastic_strips.control import DriveParams
from elastic_strips.control.estimation import StateEstimator
from elastic_strips.control.tracking import TrackingController, TrackingGains
from elastic_strips.planning import plan
from elastic_strips.sim.plant import KinematicPlant, PlantParams
from elastic_strips.sim.scenarios.corridors import corridor_scene
from elastic_strips.trajectory.limits import MotionLimits
from elastic_strips.trajectory.retiming import retime

TRACKING_ERROR = DriveParams().tracking_error


def limits_of(robot) -> MotionLimits:
    return MotionLimits.for_robot(robot, joint_speed=1.0)


def displacements(robot, limits, motions, seeds, *, params=None, gains=None) -> np.ndarray:
    """Bounds [m] at all samples of runs on the kinematic plant; run i drives motion i modulo their number."""
    measure, controller = Displacement(robot), TrackingController(robot, limits, gains)
    runs = [
        follow_trajectory(
            motions[seed % len(motions)],
            KinematicPlant(robot, limits, params, seed),
            StateEstimator(robot, limits),
            controller,
        )
        for seed in range(seeds)
    ]
    return np.concatenate([measure(run.reference, run.truth) for run in runs])


def body_points(robot, coordinates, rng) -> np.ndarray:
    """World positions of the same points of the robot's collision shapes, by Pinocchio."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.space.from_coordinates(coordinates))
    points = []
    for piece in robot.geometries:
        corners, radius = support_points(piece.geometry)
        directions = rng.standard_normal((len(corners), 3))
        corners = corners + radius * directions / np.linalg.norm(directions, axis=1, keepdims=True)
        T = data.oMi[piece.joint].homogeneous @ piece.placement
        # corners of a cylinder's polygon lie outside it: a point well inside the hull is one of the shape for certain
        points.append((0.98 * corners) @ T[:3, :3].T + T[:3, 3])
    return np.vstack(points)


@each_robot
def test_no_point_moves_further_than_the_bound(robot, rng):
    measure = Displacement(robot)
    home = robot.space.to_coordinates(robot.home_q)
    for size in (1e-3, 0.02, 0.2):
        a = home + 0.1 * rng.standard_normal((20, robot.nv))
        b = robot.space.integrate(a, size * rng.standard_normal((20, robot.nv)))
        bounds = measure(a, b)
        for one, two, bound in zip(a, b, bounds, strict=True):
            seed = int(rng.integers(1 << 30))
            moved = body_points(robot, one, np.random.default_rng(seed))
            moved -= body_points(robot, two, np.random.default_rng(seed))
            truth = np.linalg.norm(moved, axis=1).max()
            assert truth <= bound + 1e-9
            assert bound <= 2.0 * truth


def test_a_pure_translation_is_exact(silvermate):
    a = silvermate.space.to_coordinates(silvermate.home_q)[None]
    b = a.copy()
    b[0, :2] += 0.03, 0.04
    assert Displacement(silvermate)(a, b) == pytest.approx([0.05])
    assert Displacement(silvermate)(a, a) == pytest.approx([0.0])


@pytest.mark.parametrize("name", ["silvermate", "tiago"])
def test_the_default_holds_for_smooth_motions_of_the_plant(name, request):
    robot = request.getfixturevalue(name)
    limits = limits_of(robot)
    motions = [smooth_motion(robot, limits, seed, turn=seed % 3 == 0, seconds=5.0) for seed in range(6)]
    errors = displacements(robot, limits, motions, 12)
    assert errors.max() <= TRACKING_ERROR
    assert np.median(errors) < 0.3 * TRACKING_ERROR
    assert errors.max() > 1e-3  # something was measured


def test_the_default_holds_for_planned_and_retimed_corridors(silvermate):
    limits = MotionLimits.for_robot(silvermate)
    motions = []
    for seed in (1, 3):
        strip = plan(silvermate, corridor_scene(seed), silvermate.home(), silvermate.home(8.0), seed=seed)
        motions.append(retime(strip, limits))
    errors = displacements(silvermate, limits, motions, 6)
    assert errors.max() <= TRACKING_ERROR
    assert min(m.duration for m in motions) > 8.0


def test_a_bad_controller_is_found_out(silvermate):
    limits = limits_of(silvermate)
    motions = [smooth_motion(silvermate, limits, 1)]
    bad = TrackingGains(along=0.0, across=0.0, heading=0.0, joint=0.0)
    errors = displacements(silvermate, limits, motions, 3, gains=bad)
    assert errors.max() > TRACKING_ERROR


def test_the_joints_of_a_fixed_base_count(gantry):
    limits = limits_of(gantry)
    params = replace(PlantParams(), joint_lag=0.05)  # the controller believes 0.03
    errors = displacements(gantry, limits, [smooth_motion(gantry, limits, 1)], 2, params=params)
    assert errors.max() > 1e-3
