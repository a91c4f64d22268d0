"""Live: what is moved gets there, the strip gives way and stays certified, and what a page says is checked."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.errors import ConfigurationError, ParameterError, SceneError
from elastic_strips.planning import plan
from elastic_strips.robot import load_robot
from elastic_strips.scene import Box, Cylinder, Scene, Sphere, Twist
from elastic_strips.viewer import Drag, LiveStrip, Viewer
from elastic_strips.viewer.drag import Steer, parse, parse_steer


@pytest.fixture(scope="module")
def robot():
    return load_robot("bridge-arm")


@pytest.fixture(scope="module")
def scene():
    return Scene([Box((0.6, 0.6, 1.4), at=(1.5, 1.3, 0.7), name="shelf"), Sphere(0.2, at=(2.5, 2.0, 1.0), name="lamp")])


@pytest.fixture(scope="module")
def strip(robot, scene):
    return plan(robot, scene, robot.home(x=-1.0), robot.home(x=4.0))


def wait(condition, patience=60.0):
    """Until something holds; a busy machine may take its time."""
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, "it never comes"
        time.sleep(0.01)


def test_an_obstacle_that_is_moved_gets_there_and_the_strip_gives_way(robot, scene, strip):
    before = np.abs(strip.coordinates[:, 1]).max()
    with LiveStrip(robot, scene, strip) as live:
        live.move("shelf", (1.5, 0.3, 0.7))
        wait(lambda: live.scene.obstacle("shelf").pose[1, 3] == 0.3 and live.report.certified)
        assert np.abs(live.report.strip.coordinates[:, 1]).max() > before + 0.2
        assert live.report.node_clearance > 0.0
        live.move("shelf", np.array(scene.obstacle("shelf").pose))
        wait(lambda: live.scene.obstacle("shelf").pose[1, 3] == 1.3)
    assert not live.alive


def test_what_is_moved_goes_no_faster_than_it_may(robot, scene, strip):
    with LiveStrip(robot, scene, strip, speed=0.5, rate=100.0) as live:
        first = live.ticks
        live.move("lamp", (2.5, 3.0, 1.0))
        wait(lambda: live.scene.obstacle("lamp").pose[1, 3] == 3.0)
        assert live.ticks - first >= 1.0 / (0.5 * 0.01) - 1


def test_the_goal_moves_and_the_joints_of_it_stay(robot, scene, strip):
    with LiveStrip(robot, scene, strip) as live:
        live.move_goal(3.5, -0.6, 0.4)
        wait(lambda: np.allclose(live.report.strip.coordinates[-1, :3], (3.5, -0.6, 0.4)) and live.report.certified)
        np.testing.assert_allclose(live.report.strip.coordinates[-1, 3:], strip.coordinates[-1, 3:], atol=1e-12)
        np.testing.assert_array_equal(live.report.strip.q[0], strip.q[0])


def test_a_strip_that_stays_broken_is_planned_anew(robot):
    wall = Scene([Box((0.2, 3.0, 1.4), at=(1.5, 3.5, 0.7), name="wall")])
    strip = plan(robot, wall, robot.home(x=-1.0), robot.home(x=4.0))
    with LiveStrip(robot, wall, strip, speed=100.0, rate=100.0) as live:
        live.move("wall", (1.5, 0.0, 0.7))  # in one step across the strip
        wait(lambda: live.scene.obstacle("wall").pose[1, 3] == 0.0)
        wait(lambda: live.report.certified)
        assert live.replans >= 1


def test_a_search_that_fails_does_not_end_it(robot, monkeypatch):
    def fail(*_, **__):
        raise SceneError("no")

    monkeypatch.setattr("elastic_strips.planning.keeper.plan_report", fail)
    wall = Scene([Box((0.2, 3.0, 1.4), at=(1.5, 3.5, 0.7), name="wall")])
    strip = plan(robot, wall, robot.home(x=-1.0), robot.home(x=4.0))
    with LiveStrip(robot, wall, strip, speed=100.0, rate=100.0, thread=False) as live:
        live.move("wall", (1.5, 0.0, 0.7))
        for _ in range(60):  # it is broken after the first, and looked for a path after 0.4 s
            live.tick()
        wait(lambda: not live._keeper.searching or live._keeper._search.done())
        live.tick()
        assert live._keeper._searched > 0.0
        assert live.replans == 0
        assert live.alive


@each("name", ["bridge-arm", "panda", "silvermate"])
def test_the_goals_hand_moves_by_the_joints_alone(name):
    robot = load_robot(name)
    goal = robot.home(x=1.0) if robot.space.planar else robot.home() + 0.6 * np.eye(robot.nq)[0]
    strip = plan(robot, Scene(), robot.home(), goal)
    with LiveStrip(robot, Scene(), strip, thread=False) as live:
        hand = live._hands[1].pose(live.report.strip.coordinates[-1])
        base = live.report.strip.coordinates[-1, : robot.space.base_nv].copy()
        wanted = hand.copy()
        wanted[:3, 3] += (-0.03, 0.02, -0.04)
        live.move_hand(wanted)
        for _ in range(400):
            live.tick()
            if live._goal is None and live._hand_goal is None and live.report.certified:
                break
        moved = live._hands[1].pose(live.report.strip.coordinates[-1])
        assert np.linalg.norm(moved[:3, 3] - wanted[:3, 3]) < 0.5 * np.linalg.norm(hand[:3, 3] - wanted[:3, 3])
        np.testing.assert_allclose(live.report.strip.coordinates[-1, : robot.space.base_nv], base, atol=1e-9)
        assert live.report.certified
        live.move_hand(hand[:3, 3] + 100.0)  # as far as it reaches, and no farther
        for _ in range(50):
            live.tick()
        coordinates = live.report.strip.coordinates
        assert (coordinates >= robot.space.lower - 1e-9).all()
        assert (coordinates <= robot.space.upper + 1e-9).all()


@pytest.mark.parametrize(("what", "x"), [("start", -1.0), ("goal", 4.0)])
def test_an_end_in_an_obstacle_is_said_and_the_strip_waits(robot, scene, strip, what, x):
    with LiveStrip(robot, scene, strip, thread=False) as live:
        live.move("shelf", (x, 0.0, 0.7))
        while live.scene.obstacle("shelf").pose[0, 3] != x:
            live.tick()
        held = live.tick().strip
        for _ in range(5):
            report = live.tick()
            assert not report.certified
            assert report.reason.startswith(f"{what} is in collision")
            assert report.node_clearance < 0.0
            np.testing.assert_array_equal(report.strip.q, held.q)
        live.move("shelf", (x, 2.5, 0.7))
        for _ in range(1000):
            if live.tick().certified and live.scene.obstacle("shelf").pose[1, 3] == 2.5:
                break
        assert live.report.certified


def test_what_moves_by_itself_stays_where_it_is_put(robot, scene, strip):
    walker = Cylinder(0.2, 1.7, at=(3.0, 4.0, 0.85), name="walker", motion=Twist(linear=(0.05, 0.0, 0.0)))
    with LiveStrip(robot, scene.with_obstacle(walker), strip) as live:
        wait(lambda: live.scene.obstacle("walker").pose[0, 3] > 3.0)
        live.move("walker", (2.0, 4.0, 0.85))
        wait(lambda: live.scene.obstacle("walker").pose[0, 3] == 2.0)
        assert live.scene.obstacle("walker").motion is None


def test_what_has_settled_is_not_drawn_again_and_again(robot, scene, strip, monkeypatch):
    drawn = []
    with Viewer(server=False) as viewer:
        monkeypatch.setattr(viewer, "update", lambda report, *_, **__: drawn.append(report))
        live = LiveStrip(robot, scene, strip, viewer=viewer, thread=False)
        for _ in range(300):
            live.tick()
        settled = len(drawn)
        for _ in range(50):
            live.tick()
        assert len(drawn) == settled > 0
        live.move(scene.names[0], scene.obstacle(scene.names[0]).pose[:3, 3] + np.array([0.1, 0.0, 0.0]))
        live.tick()
        assert len(drawn) > settled
        live.close()


def test_wrong_input_names_what_is_wrong(robot, scene, strip):
    with LiveStrip(robot, scene, strip) as live:
        with refused(SceneError, "shelf"):
            live.move("shelv", (0, 0, 0))
        with refused(ParameterError, "at"):
            live.move("shelf", (0, 0))
        with refused(ParameterError, "yaw"):
            live.move_goal(0.0, 0.0, float("nan"))
    with refused(ParameterError, "rate"):
        LiveStrip(robot, scene, strip, rate=0.0)
    arm = load_robot("panda")
    line = plan(arm, Scene(), arm.home(), arm.home() + 0.1 * np.eye(arm.nq)[0])
    with LiveStrip(arm, Scene(), line) as live, refused(ConfigurationError, "fixed"):
        live.move_goal(1.0, 0.0)


@each(
    "line",
    [
        b"", b"{", b"[]", b"null", b'"x"', b'{"type": 3}', b'{"type": "drag", "shift": [1, 2]}', b"\xff\xfe",
        b'{"type": "drag", "shift": [1, 2, NaN]}', b'{"type": "drag", "shift": [1, 2, 1e9]}',
        b'{"type": "drag", "turn": Infinity}', b'{"type": "drag", "name": 7}', b'{"type": "open"}',
        b'{"type": "drag", "name": "' + 2000 * b"x" + b'"}', b'{"type": "drag", "shift": "abc"}',
        b"[" * 100_000,
    ],
)  # fmt: skip
def test_what_is_no_message_is_none(line):
    assert parse(line) is None


def test_a_message_is_read_and_applied():
    drag = parse(json.dumps({"type": "drag", "name": "a", "shift": [1, 0, 2], "turn": np.pi / 2}).encode())
    assert drag == Drag("drag", "a", (1.0, 0.0, 2.0), np.pi / 2)
    pose = np.eye(4)
    pose[:3, 3] = (5.0, 6.0, 7.0)
    moved = drag.applied(pose)
    np.testing.assert_allclose(moved[:3, 3], (6.0, 6.0, 9.0))
    np.testing.assert_allclose(moved[:3, :3] @ (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), atol=1e-12)
    assert parse(b'{"type": "grab"}') == Drag("grab", None)


@each(
    "line",
    [
        b"", b"{", b"[]", b'{"type": "steer"}', b'{"type": "steer", "forward": 2, "left": 0, "turn": 0}',
        b'{"type": "steer", "forward": NaN, "left": 0, "turn": 0}',
        b'{"type": "drag", "forward": 0, "left": 0, "turn": 0}',
    ],
)  # fmt: skip
def test_what_is_not_steered_is_none(line):
    assert parse_steer(line) is None


def test_what_is_steered_is_read():
    assert parse_steer(b'{"type": "steer", "forward": 1, "left": 0, "turn": -0.5}') == Steer(1.0, 0.0, -0.5)
