"""The three layers together: tasks are done, broken strips lead to new paths, and hopeless ones are given up."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from elastic_strips.control import DriveParams
from elastic_strips.control.tasks import DriveTo, Order, ReachHand
from elastic_strips.scene import Box, Scene, UnknownMotion, World
from elastic_strips.sim import TaskSimulation, evaluate

SHELF = Box((0.5, 0.8, 0.05), at=(1.6, 0.0, 0.6), name="shelf")


def test_a_hand_reaches_what_is_far(silvermate):
    target = (1.5, 0.1, 0.85)
    task = TaskSimulation(silvermate, Scene([SHELF]), silvermate.home(), ReachHand(target), seed=2)
    result = task.run(time_limit=60.0)
    assert result.done, result.reason
    assert [order for _, order, _ in result.orders][-1] is Order.DONE
    assert result.drive is not None
    assert task.control is not None
    record = result.drive.record
    assert evaluate(record, silvermate).collisions == ()
    q = silvermate.space.from_coordinates(record.control.coordinates[-1:])[0]
    data = silvermate.model.createData()
    pin.forwardKinematics(silvermate.model, data, q)
    hand = pin.updateFramePlacement(silvermate.model, data, silvermate.model.getFrameId("hand_frame"))
    np.testing.assert_allclose(hand.translation, target, atol=0.03)
    assert "[✓]" in task.control.sequencing.drawing()


def test_a_way_that_closes_is_planned_anew(silvermate):
    """A box falls onto the strip, as wide as the way: the sequencing layer asks, and the other side is taken."""
    wall = Box((0.3, 3.0, 1.2), at=(2.0, -1.85, 0.6), name="wall")
    gate = Box((0.3, 2.4, 1.2), at=(2.0, 0.6, 0.6), name="gate")
    world = World(Scene([wall, gate]), appears={"gate": 1.0})
    task = TaskSimulation(silvermate, world, silvermate.home(), DriveTo(4.0, 0.0, 0.0), seed=1)
    result = task.run(time_limit=60.0)
    assert result.done, result.reason
    orders = [order for _, order, _ in result.orders]
    assert Order.REQUEST_PATH in orders
    assert orders.index(Order.REQUEST_PATH) < len(orders) - 1
    assert any("gate" in reason for _, order, reason in result.orders if order is Order.REQUEST_PATH)
    assert result.drive is not None
    assert result.drive.replans >= 1


def test_a_hopeless_task_is_given_up(silvermate):
    queue = Box((0.2, 6.0, 1.5), at=(2.0, 0.0, 0.75), name="queue", motion=UnknownMotion(0.1))
    walls = ((0.2, 6.0, -2.0, 0.0), (4.2, 0.2, 0.0, 3.0), (4.2, 0.2, 0.0, -3.0))
    room = [Box((a, b, 1.5), at=(x, y, 0.75)) for a, b, x, y in walls]
    params = DriveParams(replan_after=0.1, replan_time=0.1)
    world = World(Scene([queue, *room]), appears={"queue": 0.5})  # the first plan knows nothing of it
    task = TaskSimulation(silvermate, world, silvermate.home(), DriveTo(4.0, 0.0, 0.0), params=params, seed=1)
    assert task.control is not None
    task.control.sequencing._attempts = 1
    result = task.run(time_limit=30.0)
    assert not result.done
    assert "queue" in result.reason
    assert result.orders[-1][1] is Order.GIVE_UP


def test_a_task_without_steps_is_not_begun(silvermate):
    task = TaskSimulation(silvermate, Scene([]), silvermate.home(), ReachHand((0.0, 0.0, 9.0)))
    result = task.run()
    assert not result.done
    assert result.drive is None
    assert "out of reach" in result.reason
