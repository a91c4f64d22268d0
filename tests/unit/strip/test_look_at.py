"""An axis that points at a place: the force is a gradient, the bound between nodes is sound, obstacles are followed."""

from __future__ import annotations

import logging

import numpy as np
import pinocchio as pin
import pytest
from brute_force import random_coordinates
from cases import each, refused

from elastic_strips.collision.candidates import NodePrediction
from elastic_strips.errors import ParameterError, SceneError
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.scene import Box, Scene, Sphere
from elastic_strips.strip import AxisConstraint, Deformer, LookAt, OrientationConstraint, Strip
from elastic_strips.strip.constraint import ConstraintForce
from elastic_strips.strip.solver import System

LOOK = LookAt(frame="hand_frame", axis=(1.0, 0.2, -0.1), at=(1.5, 0.4, 0.9), gain=1.7)
BALL = Sphere(0.1, at=(3.0, 1.0, 0.5), name="ball")


def angles(robot: RobotModel, rows: np.ndarray, constraint: LookAt, places: np.ndarray) -> np.ndarray:
    """(N,) angle [rad] between axis and place at coordinate rows (N, nv), by Pinocchio."""
    model, data, out = robot.model, robot.model.createData(), []
    axis = np.array(constraint.axis) / np.linalg.norm(constraint.axis)
    for q, place in zip(robot.space.from_coordinates(rows), np.broadcast_to(places, (len(rows), 3)), strict=True):
        pin.forwardKinematics(model, data, q)
        T = pin.updateFramePlacement(model, data, model.getFrameId(constraint.frame))
        a, line = T.rotation @ axis, place - T.translation
        out.append(np.arctan2(np.linalg.norm(np.cross(a, line)), a @ line))
    return np.array(out)


def placed(robot: RobotModel, rows: np.ndarray) -> Kinematics:
    kin = Kinematics(robot.tree, len(rows))
    kin.update(rows)
    return kin


def test_the_force_is_the_gradient_and_its_matrix_the_derivatives(silvermate, rng):
    force, rows = ConstraintForce(silvermate, LOOK), random_coordinates(silvermate, rng, 4)
    system, h = System(*rows.shape), 1e-6
    force.push(system, placed(silvermate, rows))
    _, slopes = force.residual(placed(silvermate, rows))
    for node in range(4):
        for k in range(silvermate.nv):
            delta = np.zeros_like(rows)
            delta[node, k] = h
            values, offs = [], []
            for sign in (1.0, -1.0):
                kin = placed(silvermate, silvermate.space.integrate(rows, sign * delta))
                other = System(*rows.shape)
                force.push(other, kin)
                values.append(other.energies["constraint"])
                offs.append(force.residual(kin)[0][node])
            assert system.force[node, k] == pytest.approx(-(values[0] - values[1]) / (2 * h), abs=2e-6)
            np.testing.assert_allclose(slopes[node, :, k], (offs[0] - offs[1]) / (2 * h), atol=2e-6)
    assert np.linalg.eigvalsh(system.diagonal).min() > -1e-9
    assert np.abs(slopes[:, :, :2]).max() > 0.1, "where the base stands counts as well"


def test_the_error_is_the_angle_that_pinocchio_sees(silvermate, rng):
    rows = random_coordinates(silvermate, rng, 20)
    seen = angles(silvermate, rows, LOOK, np.array(LOOK.at))
    np.testing.assert_allclose(ConstraintForce(silvermate, LOOK).errors_at(rows), seen, atol=1e-7)


@each("far", [0.02, 0.3, 3.0])
def test_the_bound_holds_between_nodes_and_is_no_looser_than_it_need_be(silvermate, rng, far):
    """With the place next to the hand's way, too, where the direction turns fast."""
    tight = 0
    for _ in range(25):
        rows = random_coordinates(silvermate, rng, 3)
        rows[:, :2] = 0.5 * rng.uniform(-1.0, 1.0, (3, 2))
        rows[1:] = rows[:1] + 0.3 * silvermate.space.difference(rows[:1].repeat(2, 0), rows[1:])
        strip = Strip.from_coordinates(silvermate, rows)
        fine = silvermate.space.to_coordinates(strip.sample(0.002))
        kin = placed(silvermate, fine)
        way = force_of(silvermate, (0.0, 0.0, 0.0))._origins(kin)
        unit = rng.normal(size=3)
        place = way[rng.integers(len(way))] + far * unit / np.linalg.norm(unit)
        constraint = LookAt(frame="hand_frame", axis=(1.0, 0.2, -0.1), at=tuple(place.tolist()))
        bound, segment = ConstraintForce(silvermate, constraint).bound(strip)
        seen = float(angles(silvermate, fine, constraint, place).max())
        assert seen <= bound + 1e-9
        assert segment in (0, 1)
        tight += bound <= seen + 0.02
    assert tight >= (20 if far > 0.1 else 0)


def force_of(robot: RobotModel, at: tuple[float, float, float]) -> ConstraintForce:
    return ConstraintForce(robot, LookAt(frame="hand_frame", at=at))


def test_a_place_that_the_hand_goes_through_is_not_looked_at(silvermate):
    rows = silvermate.space.to_coordinates(np.stack([silvermate.home(), silvermate.home(x=0.5)]))
    first, last = force_of(silvermate, (0.0, 0.0, 0.0))._origins(placed(silvermate, rows))
    x, y, z = (0.5 * (first + last)).tolist()
    ahead = OrientationConstraint.from_configuration(silvermate, silvermate.home(), "hand_frame", direction=(1, 0, 0))
    force = ConstraintForce(silvermate, LookAt(frame="hand_frame", axis=ahead.axis, at=(x, y, z)))
    before = Strip(silvermate, np.stack([silvermate.home(), silvermate.home(x=0.2)]))
    assert force.bound(before)[0] < 0.02, "straight ahead of it, and not there yet"
    assert force.bound(Strip.from_coordinates(silvermate, rows))[0] == pytest.approx(np.pi), "and behind it then"
    x, y, z = first.tolist()
    at_it = ConstraintForce(silvermate, LookAt(frame="hand_frame", at=(x, y, z)))
    np.testing.assert_allclose(at_it.errors_at(rows[:1]), np.pi)
    off, slopes = at_it.residual(placed(silvermate, rows[:1]))
    assert np.isfinite(off).all()
    assert np.isfinite(slopes).all()


def test_an_obstacle_is_looked_at_where_it_is_in_the_scene(silvermate, rng):
    look = LookAt(frame="hand_frame", axis=LOOK.axis, at="ball")
    force, rows = ConstraintForce(silvermate, look), random_coordinates(silvermate, rng, 6)
    np.testing.assert_array_equal(force.errors_at(rows), np.pi)  # nobody has seen it
    system = System(*rows.shape)
    force.push(system, placed(silvermate, rows))
    assert not system.force.any()
    force.see(Scene([BALL]))
    here = BALL.pose[:3, 3]
    np.testing.assert_allclose(force.errors_at(rows), angles(silvermate, rows, look, here), atol=1e-7)
    force.see(Scene([Box((1.0, 1.0, 1.0), at=(9.0, 0.0, 0.0))]))  # it is gone: its last place counts
    np.testing.assert_allclose(force.errors_at(rows), angles(silvermate, rows, look, here), atol=1e-7)
    shift = rng.uniform(-1.0, 1.0, (6, 2, 3))

    def prediction(coordinates: np.ndarray) -> NodePrediction:
        assert len(coordinates) == 6
        return NodePrediction(np.array([0, 1]), shift, np.zeros((6, 2)), np.zeros(6, dtype=bool))

    force.see(Scene([Sphere(0.1, at=(1.0, 0.0, 0.0), name="other"), BALL]), prediction)
    seen = angles(silvermate, rows, look, here + shift[:, 1])
    np.testing.assert_allclose(force.errors_at(rows), seen, atol=1e-7)
    told = here + shift[:, 0]
    np.testing.assert_allclose(force.errors_at(rows, told), angles(silvermate, rows, look, told), atol=1e-7)


def test_a_deformer_takes_it_from_the_scene_of_each_tick(silvermate):
    look = LookAt(frame="hand_frame", axis=(1.0, 0.0, 0.0), at="ball", tolerance=0.05)
    deformer = Deformer(silvermate, constraint=look)
    strip = Strip(silvermate, np.stack([silvermate.home(x=x) for x in np.linspace(0.0, 3.0, 16)]))
    for y in (2.0, -2.0):
        scene = Scene([BALL.observed(BALL.pose, None)]).moved("ball", pin.SE3(np.eye(3), np.array((6.0, y, 1.0))))
        report = deformer.settle(strip, scene, max_ticks=60)
        errors = angles(silvermate, report.strip.coordinates, look, np.array((6.0, y, 1.0)))
        assert report.constraint_errors is not None
        np.testing.assert_allclose(report.constraint_errors, errors, atol=1e-6)
        before = angles(silvermate, strip.coordinates, look, np.array((6.0, y, 1.0)))
        assert np.median(errors) < 0.5 * np.median(before)


def test_what_is_not_there_is_said(silvermate, caplog):
    look = LookAt(frame="hand_frame", at="bal")
    with refused(SceneError, "ball"):
        look.in_scene(Scene([BALL]))
    with refused(SceneError, "ball"):
        ConstraintForce(silvermate, look).find(Scene([BALL]))
    assert LookAt(frame="hand_frame", at="ball").in_scene(Scene([BALL])) == LookAt(
        frame="hand_frame", at=(3.0, 1.0, 0.5)
    )
    force = ConstraintForce(silvermate, look)
    with caplog.at_level(logging.WARNING):
        force.see(Scene([BALL]))
        force.see(Scene([BALL]))
    assert len(caplog.records) == 1
    assert LOOK.in_scene(Scene()) is LOOK
    level = OrientationConstraint(frame="hand_frame")
    assert level.place(Scene()) is None
    assert level.in_scene(Scene()) is level


@each(
    "values",
    [{"at": (0.0, np.nan, 1.0)}, {"at": (0.0, 1.0)}, {"at": " "}, {"axis": (0.0, 0.0, 0.0)}, {"tolerance": 0.0}],
    ids=str,
)
def test_wrong_ones_are_refused(values):
    with pytest.raises(ParameterError, match=next(iter(values))):
        LookAt(**{"frame": "hand_frame", "at": (1.0, 0.0, 0.0), **values})


def test_a_constraint_without_a_target_is_none(silvermate):
    with refused(ParameterError, "LookAt"):
        Deformer(silvermate, constraint=AxisConstraint(frame="hand_frame"))
