"""The benchmark of inverse kinematics counts what Pinocchio finds reached, for both."""

from __future__ import annotations

from cases import refused

from elastic_strips.errors import RobotError
from elastic_strips.robot import load_robot
from workshop.bench.inverse_kinematics import bench_inverse_kinematics


def test_more_is_reached_than_with_one_start():
    notes: list[str] = []
    figures = bench_inverse_kinematics(load_robot("panda"), "panda_hand_tcp", notes.append, poses=25)
    assert len(notes) == 25
    assert figures["reached"] == 1.0
    assert 0.0 < figures["one_start"]["reached"] < 1.0
    assert figures["position_m"] < 1e-3
    with refused(RobotError, "frame"):
        bench_inverse_kinematics(load_robot("panda"), "thumb")
