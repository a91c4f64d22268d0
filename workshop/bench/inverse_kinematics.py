"""Inverse kinematics benchmark: poses of random configurations, reached again; beside one start of the usual loop."""

from __future__ import annotations

from time import perf_counter

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.robot import RobotModel
from elastic_strips.robot.inverse_kinematics import PoseSolver

from .measure import Figures, Note, head, percentiles, silent

_POSITION, _ANGLE = 1e-3, 1e-2  # [m], [rad] that count as reached, by Pinocchio
_UNLIMITED_RANGE = 3.0  # [rad or m] of random coordinates without limits
_LOOP, _GAIN, _DAMPING = 1000, 0.3, 1e-6  # of the usual loop


def bench_inverse_kinematics(
    robot: RobotModel, frame: str, step: Note = silent, *, poses: int = 1000, seed: int = 0
) -> Figures:
    """Reach poses of a frame, made of random configurations, from the robot's home.

    Whether a pose is reached is measured with Pinocchio, and so are the joint limits. The usual loop, a single start of
    damped steps by Pinocchio's Jacobian that is clipped to the limits, goes through the same poses.

    Args:
        robot: the robot.
        frame: name of its frame.
        step: called after each with a note, for a progress bar.
        poses: number of poses.
        seed: seed of the configurations.

    Raises:
        RobotError: an unknown frame.
    """
    PoseSolver(robot, frame)  # refuses what is no frame
    rng, space = np.random.default_rng(seed), robot.space
    low, high = np.maximum(space.lower, -_UNLIMITED_RANGE), np.minimum(space.upper, _UNLIMITED_RANGE)
    data, index = robot.model.createData(), robot.model.getFrameId(frame)
    ours, loop, off, angle = [], [], [], []
    for k in range(poses):
        target = _pose(robot, data, index, space.from_coordinates(rng.uniform(low, high)))
        began = perf_counter()
        q = robot.inverse_kinematics(frame, target.translation, target.rotation, seed=k).q
        seconds = perf_counter() - began
        if q is not None:
            missed = pin.log6(target.actInv(_pose(robot, data, index, robot.check_q(q))))
            off.append(float(np.linalg.norm(missed.linear)))
            angle.append(float(np.linalg.norm(missed.angular)))
        reached = q is not None and off[-1] <= _POSITION and angle[-1] <= _ANGLE
        ours.append((reached, 1e3 * seconds))
        began = perf_counter()
        reached = _usual(robot, data, index, target)
        loop.append((reached, 1e3 * (perf_counter() - began)))
        step(f"pose {k}")
    return {
        **head("inverse_kinematics", robot=robot.name, base=robot.base_kind.value, frame=frame),
        "poses": poses,
        "seed": seed,
        **_share(ours),
        "position_m": max(off, default=None),
        "angle_rad": max(angle, default=None),
        "one_start": _share(loop),
    }


def _share(runs: list[tuple[bool, float]]) -> Figures:
    reached = sum(good for good, _ in runs) / max(len(runs), 1)
    return {"reached": reached, "ms": percentiles([ms for _, ms in runs])}


def _pose(robot: RobotModel, data: pin.Data, index: int, q: Array) -> pin.SE3:
    pin.forwardKinematics(robot.model, data, q)
    return pin.updateFramePlacement(robot.model, data, index).copy()


def _usual(robot: RobotModel, data: pin.Data, index: int, target: pin.SE3) -> bool:
    """Whether one start from home, in steps of damped least squares, reaches the target."""
    space, q = robot.space, robot.home_q.copy()
    for _ in range(_LOOP):
        missed = pin.log6(_pose(robot, data, index, q).actInv(target))
        if np.linalg.norm(missed.linear) <= _POSITION and np.linalg.norm(missed.angular) <= _ANGLE:
            return True
        J = pin.computeFrameJacobian(robot.model, data, q, index, pin.LOCAL)
        v = J.T @ np.linalg.solve(J @ J.T + _DAMPING * np.eye(6), missed.vector)
        q = pin.integrate(robot.model, q, _GAIN * v)
        q = space.from_coordinates(np.clip(space.to_coordinates(q), space.lower, space.upper))
    return False
