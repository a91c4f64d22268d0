"""Inverse kinematics: what is found is there by Pinocchio, within limits; what is not found is far away, and said."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from cases import each, refused

from elastic_strips.errors import ConfigurationError, ParameterError, RobotError
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.robot.inverse_kinematics import PoseSolver, PoseTarget, _rotation_vectors


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return load_robot("panda")


def placement(robot: RobotModel, q: np.ndarray, frame: str) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.model.getFrameId(frame)].copy()


def random_q(robot: RobotModel, rng: np.random.Generator) -> np.ndarray:
    space = robot.space
    return space.from_coordinates(rng.uniform(np.maximum(space.lower, -3.0), np.minimum(space.upper, 3.0)))


@each("name, frame", [("panda", "panda_hand_tcp"), ("silvermate", "hand_frame"), ("ur5_robot", "tool0")])
def test_poses_that_can_be_reached_are_reached(name, frame, rng):
    """Whatever configuration a pose was made of: another may be found, with the frame where it was."""
    robot = load_robot(name)
    for k in range(25):
        wanted = placement(robot, random_q(robot, rng), frame)
        result = robot.inverse_kinematics(frame, wanted.translation, wanted.rotation, seed=k)
        assert result.q is not None, result.reason
        robot.check_q(result.q)  # within limits
        off = pin.log6(wanted.actInv(placement(robot, result.q, frame)))
        assert np.linalg.norm(off.linear) < 2e-4
        assert np.linalg.norm(off.angular) < 2e-3


def test_a_place_alone_and_a_box_about_it(panda):
    at, half = np.array([0.4, 0.2, 0.5]), np.array([0.05, 0.0, 0.1])
    q = panda.inverse_kinematics("panda_hand_tcp", at).q
    assert np.linalg.norm(placement(panda, q, "panda_hand_tcp").translation - at) < 2e-4
    q = panda.inverse_kinematics("panda_hand_tcp", at, within=half).q
    assert (np.abs(placement(panda, q, "panda_hand_tcp").translation - at) <= half + 2e-4).all()


def test_solutions_differ_and_the_nearest_comes_first(panda):
    near = panda.home()
    result = panda.inverse_kinematics("panda_hand_tcp", (0.4, 0.2, 0.5), (1.0, 0.0, 0.0, 0.0), near=near, count=5)
    assert len(result.solutions) >= 5
    np.testing.assert_array_equal(result.q, result.solutions[0])
    apart = np.linalg.norm(result.solutions - near, axis=1)
    assert (np.diff(apart) >= -1e-9).all()
    gaps = np.abs(result.solutions[:, None] - result.solutions[None]).max(axis=2)
    assert gaps[~np.eye(len(gaps), dtype=bool)].min() > 1e-3


def test_the_base_stands_where_it_may_not_move(silvermate):
    near = silvermate.home(x=1.0, y=2.0, yaw=0.5)
    target = placement(silvermate, silvermate.home(x=1.0, y=2.0, yaw=0.5, joints={"arm_1_joint": 0.4}), "hand_frame")
    result = silvermate.inverse_kinematics("hand_frame", target.translation, near=near, base=False)
    np.testing.assert_array_equal(result.q[:4], near[:4])
    far = silvermate.inverse_kinematics("hand_frame", (9.0, 9.0, 0.9), near=near, base=False)
    assert far.q is None
    assert silvermate.inverse_kinematics("hand_frame", (9.0, 9.0, 0.9), near=near).q is not None


def test_what_is_out_of_reach_is_measured(panda):
    """Straight up, nothing is nearer than the longest that the arm can be."""
    result = panda.inverse_kinematics("panda_hand_tcp", (0.0, 0.0, 3.0))
    assert result.q is None
    assert len(result.solutions) == 0
    heights = [
        placement(panda, random_q(panda, np.random.default_rng(k)), "panda_hand_tcp").translation[2] for k in range(500)
    ]
    assert 1.0 < result.distance < 3.0 - max(heights)
    assert "out of reach" in result.reason


def test_no_posture_reaches_further_than_the_arm_is_long(rng, panda, silvermate, request):
    for robot, frame in (
        (panda, "panda_hand_tcp"), (silvermate, "hand_frame"), (request.getfixturevalue("tiago"), "arm_tool_link"),
    ):  # fmt: skip
        solver = PoseSolver(robot, frame)
        rows = rng.uniform(solver.lower, solver.upper, (500, robot.nv))
        rows[:, : robot.space.base_nv] = 0.0
        far = np.linalg.norm(solver.place(rows)[0], axis=1).max()
        assert far <= solver.reaches[0] < 2.0 * far


def test_each_row_may_have_a_target_of_its_own(silvermate, rng):
    solver, space = PoseSolver(silvermate, "hand_frame"), silvermate.space
    begin = np.tile(space.to_coordinates(silvermate.home()), (5, 1))
    wanted = begin.copy()
    wanted[:, space.base_nv :] += rng.uniform(-0.2, 0.2, (5, space.nv - space.base_nv))
    at, turn = (each.copy() for each in solver.place(wanted))
    target = PoseTarget("hand_frame", at, turn, np.zeros(3))
    found, size = solver.solve(begin, [target], np.ones(space.nv), every=True)
    assert size.max() < 1e-5
    placed, turned = solver.place(found)
    np.testing.assert_allclose(placed, at, atol=1e-5)
    np.testing.assert_allclose(turned, turn, atol=1e-4)


def test_jacobians_are_the_slopes_of_the_error(silvermate, rng):
    solver, space, h = PoseSolver(silvermate, "hand_frame"), silvermate.space, 1e-6
    row = np.clip(rng.normal(size=space.nv), np.maximum(space.lower, -3.0), np.minimum(space.upper, 3.0))
    at, R = (each[0].copy() for each in solver.place(row[None]))
    solver.place(row[None])
    J = solver._jacobians(1, [True])[0]
    for k in range(space.nv):
        step = h * np.eye(space.nv)[k]
        up, low = space.integrate(row[None], step[None]), space.integrate(row[None], -step[None])
        (p, Rp), (m, Rm) = ((a[0].copy(), b[0].copy()) for a, b in (solver.place(up), solver.place(low)))
        np.testing.assert_allclose(J[:3, k], (p - m) / (2.0 * h), atol=1e-6)
        np.testing.assert_allclose(J[3:, k] / 0.3, pin.log3(Rp @ Rm.T) / (2.0 * h), atol=1e-6)
    assert np.isfinite(at).all()
    assert np.isfinite(R).all()


def test_rotation_vectors_are_pinocchios(rng):
    axes = rng.normal(size=(60, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    angles = np.r_[np.zeros(5), rng.uniform(0.0, 3.1, 50), np.full(5, np.pi)]
    R = np.array([pin.exp3(a * w) for a, w in zip(angles, axes, strict=True)])
    found = _rotation_vectors(R)
    np.testing.assert_allclose(found[:55], (angles[:, None] * axes)[:55], atol=1e-6)
    np.testing.assert_allclose(np.abs((found[55:] * axes[55:]).sum(axis=1)), np.pi, atol=1e-4)  # either way around


def test_wrong_targets_are_refused(panda, silvermate):
    with refused(RobotError, "'panda_hand_tcp'"):
        panda.inverse_kinematics("panda_hand_tpc", (0.4, 0.0, 0.5))
    with refused(RobotError, "move"):
        panda.inverse_kinematics("panda_link0", (0.4, 0.0, 0.5))
    with refused(ParameterError, "position"):
        panda.inverse_kinematics("panda_hand_tcp", (0.4, np.nan, 0.5))
    with refused(ParameterError, "length"):
        panda.inverse_kinematics("panda_hand_tcp", (0.4, 0.0, 0.5), (0.0, 0.0, 0.0, 2.0))
    with refused(ParameterError, "rotation"):
        panda.inverse_kinematics("panda_hand_tcp", (0.4, 0.0, 0.5), 2.0 * np.eye(3))
    with refused(ParameterError, "within"):
        panda.inverse_kinematics("panda_hand_tcp", (0.4, 0.0, 0.5), within=(0.1, -0.1, 0.0))
    with refused(ParameterError, "count"):
        panda.inverse_kinematics("panda_hand_tcp", (0.4, 0.0, 0.5), count=0)
    with refused(ConfigurationError, "near"):
        silvermate.inverse_kinematics("hand_frame", (0.4, 0.0, 0.5), near=[0.0])
