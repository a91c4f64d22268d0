"""An axis held along a direction: its force is the gradient of its potential, and it has the right zero."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from brute_force import random_coordinates
from cases import each, refused

from elastic_strips.errors import ParameterError, RobotError
from elastic_strips.robot import Kinematics
from elastic_strips.strip import OrientationConstraint, Strip
from elastic_strips.strip.constraint import ConstraintForce
from elastic_strips.strip.solver import System

LEVEL = OrientationConstraint(frame="hand_frame", axis=(0.3, -0.2, 2.0), direction=(0.0, 0.5, 1.0), gain=1.7)


def potential(force: ConstraintForce, kin: Kinematics, coordinates: np.ndarray) -> float:
    kin.update(coordinates)
    system = System(*coordinates.shape)
    force.push(system, kin)
    return system.energies["constraint"]


def test_the_force_is_the_gradient(silvermate, rng):
    force, kin = ConstraintForce(silvermate, LEVEL), Kinematics(silvermate.tree, 4)
    coordinates = random_coordinates(silvermate, rng, 4)
    kin.update(coordinates)
    system = System(*coordinates.shape)
    force.push(system, kin)
    h = 1e-6
    for node in range(4):
        for k in range(silvermate.nv):
            delta = np.zeros_like(coordinates)
            delta[node, k] = h
            up = potential(force, kin, silvermate.space.integrate(coordinates, delta))
            down = potential(force, kin, silvermate.space.integrate(coordinates, -delta))
            assert system.force[node, k] == pytest.approx(-(up - down) / (2 * h), abs=1e-6)
    assert np.linalg.eigvalsh(system.diagonal).min() > -1e-9


def test_the_error_is_the_angle_that_pinocchio_sees(silvermate, rng):
    force, kin = ConstraintForce(silvermate, LEVEL), Kinematics(silvermate.tree, 5)
    coordinates = random_coordinates(silvermate, rng, 5)
    kin.update(coordinates)
    model, data = silvermate.model, silvermate.model.createData()
    axis, direction = np.array(LEVEL.axis), np.array(LEVEL.direction)
    for q, error in zip(silvermate.space.from_coordinates(coordinates), force.errors(kin), strict=True):
        pin.forwardKinematics(model, data, q)
        a = pin.updateFramePlacement(model, data, model.getFrameId("hand_frame")).rotation @ axis
        cos = a @ direction / np.linalg.norm(a) / np.linalg.norm(direction)
        assert error == pytest.approx(np.arccos(cos), abs=1e-7)


def test_a_frame_is_kept_as_it_is(silvermate):
    q = silvermate.home(yaw=0.7)
    force = ConstraintForce(
        silvermate, OrientationConstraint.from_configuration(silvermate, q, "hand_frame", tolerance=0.2)
    )
    assert force.constraint.tolerance == 0.2
    kin = Kinematics(silvermate.tree, 2)
    turned = silvermate.home(x=1.0, yaw=-2.0)  # turning about the direction is free
    kin.update(silvermate.space.to_coordinates(np.stack((q, turned))))
    np.testing.assert_allclose(force.errors(kin), 0.0, atol=1e-8)
    assert potential(force, kin, kin.coordinates[:2].copy()) == pytest.approx(0.0, abs=1e-12)


def test_what_is_switched_off_does_not_push(silvermate, rng):
    force, kin = ConstraintForce(silvermate, LEVEL), Kinematics(silvermate.tree, 3)
    force.active = False
    coordinates = random_coordinates(silvermate, rng, 3)
    kin.update(coordinates)
    system = System(*coordinates.shape)
    force.push(system, kin)
    assert not system.force.any()
    assert not system.diagonal.any()


@each(
    "values",
    [
        {"axis": (0.0, 0.0, 0.0)},
        {"direction": (0.0, np.nan, 1.0)},
        {"tolerance": 0.0},
        {"tolerance": 4.0},
        {"gain": 0.0},
    ],
    ids=str,
)
def test_wrong_tasks_are_refused(values):
    with pytest.raises(ParameterError, match=next(iter(values))):
        OrientationConstraint(frame="hand_frame", **values)


def test_unknown_frames_are_named(silvermate):
    with refused(RobotError, "hand_fram"):
        ConstraintForce(silvermate, OrientationConstraint(frame="hand_fram"))
    with refused(RobotError, "hand_fram"):
        OrientationConstraint.from_configuration(silvermate, silvermate.home(), "hand_fram")


def test_rows_are_projected_by_the_joints_alone(silvermate, rng):
    constraint = OrientationConstraint(frame="hand_frame", tolerance=0.05)
    force = ConstraintForce(silvermate, constraint)
    home = silvermate.space.to_coordinates(silvermate.home())
    rows = home + np.r_[np.full(3, 1.0), np.full(silvermate.nv - 3, 0.4)] * rng.uniform(-1.0, 1.0, (20, silvermate.nv))
    rows, off = force.project(np.vstack((rows, home)))
    assert off.max() < 0.05
    kin = Kinematics(silvermate.tree, len(rows))
    kin.update(rows)
    np.testing.assert_allclose(force.errors(kin), off, atol=1e-12)
    space = silvermate.space
    assert (rows >= space.lower).all()
    assert (rows <= space.upper).all()
    again, _ = force.project(rows)
    np.testing.assert_array_equal(again, rows)  # what satisfies it stays


def test_where_steps_end_before_it_is_satisfied_the_error_is_that_of_the_rows(silvermate, rng):
    up = OrientationConstraint.from_configuration(silvermate, silvermate.home(), "hand_frame")
    force = ConstraintForce(
        silvermate, OrientationConstraint(frame="hand_frame", axis=up.axis, direction=(0.0, 0.3, -1.0))
    )
    home = silvermate.space.to_coordinates(silvermate.home())
    rows = home + np.r_[np.zeros(3), np.full(silvermate.nv - 3, 0.2)] * rng.uniform(-1.0, 1.0, (10, silvermate.nv))
    rows, off = force.project(rows, steps=2)
    np.testing.assert_allclose(force.errors_at(rows), off, atol=1e-12)
    assert off.min() > force.constraint.tolerance, "two steps are too few to turn the hand over"


@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (0.3, 1.0, 0.2)])
def test_the_bound_holds_between_nodes_too(silvermate, rng, direction):
    force = ConstraintForce(silvermate, OrientationConstraint(frame="hand_frame", direction=direction))
    for _ in range(20):
        strip = Strip.from_coordinates(silvermate, random_coordinates(silvermate, rng, 3))
        bound, segment = force.bound(strip)
        fine = silvermate.space.to_coordinates(strip.sample(0.02))
        kin = Kinematics(silvermate.tree, len(fine))
        kin.update(fine)
        seen = float(force.errors(kin).max())
        assert seen <= bound + 1e-9
        assert bound <= seen + 0.05
        assert segment in (0, 1)


def test_turning_on_the_spot_keeps_a_level_hand_level(silvermate):
    force = ConstraintForce(
        silvermate, OrientationConstraint.from_configuration(silvermate, silvermate.home(), "hand_frame")
    )
    strip = Strip(silvermate, np.stack((silvermate.home(), silvermate.home(yaw=3.0))))
    assert force.bound(strip)[0] < 1e-6
    assert force.missed(strip) == ""
