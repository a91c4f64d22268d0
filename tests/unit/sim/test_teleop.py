"""Teleoperation: somebody drives a simulated robot through the guard."""

from __future__ import annotations

import numpy as np

from elastic_strips.cli.teleop_command import _Hands
from elastic_strips.control import Desired, GuardOutcome
from elastic_strips.scene import Box, Scene
from elastic_strips.sim.teleop import Teleop
from elastic_strips.trajectory import MotionLimits
from elastic_strips.viewer.drag import Steer

WALL = Box((0.2, 4.0, 1.5), at=(1.4, 0.0, 0.75), name="wall")


def test_a_robot_is_driven_to_a_wall_and_touches_nothing(silvermate):
    session = Teleop(silvermate, Scene([WALL]), silvermate.home_q)
    for _ in range(250):
        answer = session.step(Desired(twist=[1.0, 0.0, 0.0]))
    assert answer.obstacle == "wall"
    assert session.coordinates[0] > 0.5
    found = session.evaluate()
    assert not found.contacts
    assert found.path_m > 0.5
    assert session.time == 2.5


def test_nobody_steers_and_it_stays(silvermate):
    session = Teleop(silvermate, Scene([WALL]), silvermate.home_q)
    for _ in range(20):
        answer = session.step(None)
    assert answer.outcome is GuardOutcome.STOPPED
    np.testing.assert_allclose(session.coordinates, silvermate.space.to_coordinates(silvermate.home_q))


def test_what_is_steered_is_a_command_that_grows_old(silvermate, monkeypatch):
    import elastic_strips.cli.teleop_command as command

    clock = [10.0]
    monkeypatch.setattr(command.time, "monotonic", lambda: clock[0])
    hands = _Hands(MotionLimits.for_robot(silvermate))
    assert hands.desired(1.0) is None
    hands.hear(Steer(forward=0.5, left=1.0))
    clock[0] = 10.5
    desired = hands.desired(3.0)
    np.testing.assert_allclose(desired.twist, (0.5, 0.0, 0.0))  # it cannot slide
    assert desired.time == 2.5
    hands.hear(Steer())
    assert hands.desired(3.0).time is None  # to rest is never too old
