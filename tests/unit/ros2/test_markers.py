"""Markers: the numbers of lines and boxes, and the messages that are made of them."""

from __future__ import annotations

from types import SimpleNamespace as Fields

import numpy as np
import pinocchio as pin

import elastic_strips as es
from elastic_strips.robot import RobotModel
from elastic_strips.ros2.markers import Lines, NearBox, boxes_near, fill_markers, hand_places
from elastic_strips.scene import Voxels

HERE = np.array([1.0, 0.0])


def corners(box: NearBox) -> np.ndarray:
    """(8, 3) in the world."""
    signs = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
    return signs * box.size @ pin.Quaternion(*box.quat[[3, 0, 1, 2]]).toRotationMatrix().T + box.center


def test_boxes_are_about_what_is_near():
    turned = es.Box((2.0, 0.2, 1.0), at=(2.0, 0.5, 0.5), quat=(0.0, 0.0, np.sin(0.4), np.cos(0.4)), name="turned")
    ball = es.Sphere(0.3, at=(0.0, -1.0, 0.7), name="ball")
    far = es.Box((0.2, 0.2, 0.2), at=(20.0, 0.0, 0.1), name="far")
    found = {box.name: box for box in boxes_near(es.Scene([turned, far, ball]), HERE)}
    assert list(found) == ["turned", "ball"]
    np.testing.assert_allclose(found["turned"].size, (2.0, 0.2, 1.0))
    end = np.array([2.0 + np.cos(0.8), 0.5 + np.sin(0.8)])
    off = np.hypot(*(corners(found["turned"])[:, :2] - end).T)
    assert np.isclose(off.min(), 0.1, atol=1e-6)
    np.testing.assert_allclose(found["ball"].size, 0.6)
    np.testing.assert_allclose(found["ball"].center, (0.0, -1.0, 0.7))


def test_of_many_cells_the_nearest_are_shown_and_in_the_same_order():
    """Cells of a turned grid, of which no two are joined."""
    at = np.array([(0.5 * i, 0.5 * j, 0.05) for i in range(30) for j in range(30)])
    quat = (0.0, 0.0, np.sin(0.3), np.cos(0.3))
    grid = Voxels(at, (0.1, 0.1, 0.1), at=(-3.0, -5.0, 0.0), quat=quat, name="unseen-1")
    other = es.Box((0.1, 0.1, 0.1), at=(1.2, 0.0, 0.05), name="other")
    scene = es.Scene([grid, other])
    boxes = boxes_near(scene, HERE, most=40)
    assert len(boxes) == 40
    assert boxes[-1].name == "other", "in the order of the scene"
    c, s = np.cos(0.6), np.sin(0.6)
    places = at[:, :2] @ np.array([[c, s], [-s, c]]) + (-3.0, -5.0)
    gaps = np.sort(np.hypot(*(places - HERE).T))
    shown = np.array([np.hypot(*(box.center[:2] - HERE)) for box in boxes[:-1]])
    assert shown.max() < gaps[39] + 0.15
    again = boxes_near(scene, HERE, most=40)
    assert all(np.array_equal(a.center, b.center) for a, b in zip(boxes, again, strict=True))
    assert boxes_near(es.Scene([]), HERE) == []
    assert len(boxes_near(scene, HERE, far=1.0)) < 40


def test_a_thread_of_the_hand(silvermate: RobotModel):
    space = silvermate.space
    rows = space.to_coordinates(np.stack([silvermate.home(x=0.5, yaw=0.3), silvermate.state("reach")]))
    for frame in (None, "palm_link"):
        found, data = hand_places(silvermate, rows, frame), silvermate.model.createData()
        for q, place in zip(space.from_coordinates(rows), found, strict=True):
            pin.framesForwardKinematics(silvermate.model, data, q)
            at = data.oMf[silvermate.model.getFrameId(frame or "hand_frame")].translation
            np.testing.assert_allclose(place, at, atol=1e-9)


def test_an_arm_that_stands_has_no_path_of_a_base():
    arm = es.load_robot("panda")
    rows = arm.space.to_coordinates(np.stack([arm.home(), arm.home()]))
    assert [line.namespace for line in Lines(arm).strip(rows, certified=True)] == ["strip_hand"]


def marker() -> Fields:
    def xyz() -> Fields:
        return Fields(x=0.0, y=0.0, z=0.0)

    def time() -> Fields:
        return Fields(sec=0, nanosec=0)

    return Fields(
        header=Fields(frame_id="", stamp=time()), lifetime=time(), scale=xyz(), points=[],
        color=Fields(r=0.0, g=0.0, b=0.0, a=0.0),
        pose=Fields(position=xyz(), orientation=Fields(x=0.0, y=0.0, z=0.0, w=0.0)),
    )  # fmt: skip


def test_markers_are_numbered_in_their_namespaces_and_last_a_while(silvermate: RobotModel):
    rows = silvermate.space.to_coordinates(np.stack([silvermate.home(x=x) for x in (0.0, 0.5, 1.2)]))
    lines, message = Lines(silvermate), Fields(markers=[])
    scene = es.Scene(
        [
            es.Box((0.2, 0.3, 0.4), at=(1.0, 1.0, 0.2), name="table"),
            Voxels([(2.0, 0.0, 0.5)], (0.1, 0.1, 0.1), name="unseen-0"),
            es.Sphere(0.2, at=(2.0, 1.0, 0.2), name="ball"),
        ]
    )
    shown = [*lines.strip(rows, certified=False), *lines.motion(rows[:2]), *lines.motion(rows[:1])]
    fill_markers(message, (marker, Fields), shown, boxes_near(scene, HERE), "table", "map", 3_200_000_000)
    ids = [(one.ns, one.id) for one in message.markers]
    assert ids == [
        ("strip_base", 0), ("strip_hand", 0), ("motion_base", 0), ("motion_hand", 0),
        ("obstacles", 0), ("obstacles", 1), ("obstacles", 2),
    ]  # fmt: skip
    assert len(set(ids)) == len(ids)
    for one in message.markers:
        assert (one.header.frame_id, one.header.stamp.sec, one.header.stamp.nanosec) == ("map", 3, 200_000_000)
        assert 0.2 < one.lifetime.sec + 1e-9 * one.lifetime.nanosec < 2.0
        assert one.action == 0
        turn = one.pose.orientation
        assert np.isclose(turn.x**2 + turn.y**2 + turn.z**2 + turn.w**2, 1.0)
        assert 0.0 < one.color.a <= 1.0
    base, table, unseen, ball = message.markers[0], *message.markers[4:]
    assert base.type == 4, "LINE_STRIP"
    np.testing.assert_allclose([(p.x, p.y) for p in base.points], rows[:, :2])
    assert table.type == 1, "CUBE"
    assert (table.scale.x, table.scale.y, table.scale.z) == (0.2, 0.3, 0.4)
    colours = [(one.color.r, one.color.g, one.color.b) for one in (table, unseen, ball)]
    assert len(set(colours)) == 3, "what is in the way, what was not seen, and the rest"
    assert base.color.r > base.color.g, "it is not certified"
