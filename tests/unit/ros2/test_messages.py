"""Messages of ROS 2 by their fields alone: what they say, what is wrong with them, and back."""

from __future__ import annotations

import math
from array import array
from types import SimpleNamespace as Fields

import numpy as np
import pytest
from cases import each

from elastic_strips.perception.readings import NO_ANSWER, NOTHING
from elastic_strips.ros2 import MessageError
from elastic_strips.ros2.messages import (
    check_frame,
    covariance_of,
    depth_image,
    ending_at_rest,
    fill_path,
    fill_polygon,
    fill_pose,
    fill_stamp,
    fill_trajectory,
    fill_twist,
    joints_of,
    laser_scan,
    map_obstacles,
    nanoseconds,
    path_of,
    place_of,
    planar_pose,
    transform_of,
    twist_of,
)
from elastic_strips.scene import Obstacle

NAN = math.nan


def header(frame: str = "odom") -> Fields:
    return Fields(frame_id=frame, stamp=Fields(sec=0, nanosec=0))


def pose(x: float = 0.0, y: float = 0.0, turn: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)) -> Fields:
    keys = ("x", "y", "z", "w")
    return Fields(position=Fields(x=x, y=y, z=0.0), orientation=Fields(**dict(zip(keys, turn, strict=True))))


def scan(**changes: object) -> Fields:
    usual = {"angle_min": -0.2, "angle_increment": 0.1, "range_min": 0.1, "range_max": 5.0, "ranges": [1.0, 2.0, 9.0]}
    return Fields(header=header("laser_frame"), **{**usual, **changes})


def camera(kind: str = "16UC1", **changes: object) -> tuple[Fields, Fields]:
    rows = np.array([[0, 500, 1000], [2000, 9000, 300]], dtype="<u2")
    data = {"16UC1": rows, "32FC1": rows.astype("<f4") / 1000.0}.get(kind, rows)
    image = {"encoding": kind, "height": 2, "width": 3, "step": data.strides[0], "is_bigendian": 0}
    image["data"] = array("B", data.tobytes())
    info = Fields(height=2, width=3, k=[2.0, 0.0, 1.0, 0.0, 2.5, 0.5, 0.0, 0.0, 1.0])
    return Fields(**{**image, **changes}), info


def test_a_stamp_keeps_its_nanoseconds():
    stamp = Fields(sec=0, nanosec=0)
    fill_stamp(stamp, 1_795_780_381_653_366_989)
    assert nanoseconds(stamp) == 1_795_780_381_653_366_989


def transform(parent: str, child: str, stamp: int, x: float, turn: tuple[float, float, float, float]) -> Fields:
    placed = pose(x, -1.0, turn)
    place = Fields(translation=placed.position, rotation=placed.orientation)
    head = Fields(frame_id=parent, stamp=Fields(sec=stamp, nanosec=0))
    return Fields(header=head, child_frame_id=child, transform=place)


def test_the_newest_transform_between_two_frames():
    left = (0.0, 0.0, math.sin(0.25 * math.pi), math.cos(0.25 * math.pi))
    message = Fields(
        transforms=[
            transform("odom", "base_link", 9, 7.0, left),
            transform("/map", "odom", 3, 2.0, left),
            transform("map", "odom", 2, 1.0, left),
            transform("odom", "map", 8, 5.0, left),
        ]
    )
    found = transform_of(message, "map", "/odom")
    assert found is not None
    assert found.stamp == 3_000_000_000
    np.testing.assert_allclose(found.pose, (2.0, -1.0, 0.5 * math.pi))
    assert transform_of(message, "map", "base_link") is None
    assert transform_of(Fields(transforms=[]), "map", "odom") is None


@each("x, turn", [(NAN, (0.0, 0.0, 0.0, 1.0)), (0.0, (0.0, 0.0, 0.0, 0.0)), (0.0, (0.5, 0.0, 0.0, math.sqrt(0.75)))])
def test_a_transform_that_is_none_is_refused(x: float, turn: tuple[float, float, float, float]):
    with pytest.raises(MessageError):
        transform_of(Fields(transforms=[transform("map", "odom", 1, x, turn)]), "map", "odom")


def test_a_place_has_heading_and_covariance_of_the_base():
    turned = pose(1.0, 2.0, (0.0, 0.0, math.sin(0.25 * math.pi), math.cos(0.25 * math.pi)))
    values = np.zeros((6, 6))
    values[0, 0], values[1, 1], values[5, 5] = 4.0, 1.0, 0.25
    place = place_of(Fields(pose=Fields(pose=turned, covariance=values.ravel().tolist())))
    np.testing.assert_allclose(place.pose, [1.0, 2.0, 0.5 * math.pi])
    assert place.covariance is not None
    np.testing.assert_allclose(np.diag(place.covariance), [1.0, 4.0, 0.25], atol=1e-12)  # ahead is along y


@each("values", ([0.0] * 36, [NAN] * 36, [1e9 * (k % 7 == 0) for k in range(36)], [1.0] * 9))
def test_a_covariance_that_says_nothing_is_none(values: list[float]):
    assert covariance_of(values, 0.0) is None


@each("wrong",
    (
        pose(NAN), pose(0.0, 0.0, (0.0, 0.0, 0.0, 0.0)), pose(0.0, 0.0, (0.0, 0.0, 0.0, 2.0)),
        pose(0.0, 0.0, (math.sin(0.2), 0.0, 0.0, math.cos(0.2))),
    )
)  # fmt: skip
def test_a_pose_that_cannot_be_is_refused(wrong: Fields):
    with pytest.raises(MessageError):
        planar_pose(wrong)


def test_frames_are_compared_without_their_slash():
    check_frame(Fields(header=header("/odom")), "odom")
    check_frame(Fields(header=header("whatever")), "")
    with pytest.raises(MessageError, match="map"):
        check_frame(Fields(header=header()), "map")


def test_joints_come_by_name():
    assert joints_of(Fields(name=["a", "b"], position=array("d", [1.0, 2.0]))) == {"a": 1.0, "b": 2.0}
    assert joints_of(Fields(name=["wheel"], position=[])) == {}


@each("case", (([1.0], "1 positions"), ([1.0, NAN], "'b'")))
def test_joints_that_do_not_fit_are_refused(case: tuple[list[float], str]):
    with pytest.raises(MessageError, match=case[1]):
        joints_of(Fields(name=["a", "b"], position=case[0]))


def test_a_scan_says_where_nothing_is():
    found = laser_scan(scan(), "scan", 1.5, np.eye(4))
    assert (found.sensor, found.time) == ("scan", 1.5)
    np.testing.assert_array_equal(found.ranges, [1.0, 2.0, NOTHING])


@each("wrong",
    (
        scan(ranges=[NAN] * 3), scan(ranges=[1.0]), scan(range_max=NAN), scan(angle_increment=0.0),
        scan(angle_increment=4.0), scan(range_min=6.0),
    )
)  # fmt: skip
def test_a_scan_that_cannot_be_is_refused(wrong: Fields):
    with pytest.raises(MessageError):
        laser_scan(wrong, "scan", 0.0, np.eye(4))


@each("kind", ("16UC1", "32FC1"))
def test_depths_come_in_millimetres_or_metres(kind: str):
    image, info = camera(kind)
    found = depth_image(image, info, "depth", 2.0, np.eye(4), (0.4, 5.0))
    expected = [[NO_ANSWER, 0.5, 1.0], [2.0, NOTHING, NO_ANSWER]]
    np.testing.assert_allclose(found.depth, expected, rtol=1e-6)
    assert (found.focal, found.center) == ((2.0, 2.5), (1.0, 0.5))


def test_squares_of_many_pixels_become_one_each():
    """What is nearest in them; no answer where most of them have none. What one of them sees is at the same place."""
    depth = np.full((5, 6), 3.0, "<f4")
    depth[0, 1], depth[1, 4], depth[1, 5] = 1.0, np.nan, 0.1  # half of a square: what the others see
    depth[2:4, 0:2], depth[3, 1] = np.nan, 2.0
    depth[2:4, 2:4] = 9.0
    image = Fields(header=header("optical"), height=5, width=6, encoding="32FC1", step=24, is_bigendian=0)
    image.data = array("B", depth.tobytes())
    info = Fields(height=5, width=6, k=[4.0, 0.0, 2.5, 0.0, 4.0, 2.0, 0.0, 0.0, 1.0])
    found = depth_image(image, info, "depth", 2.0, np.eye(4), (0.4, 5.0), most=8)
    np.testing.assert_allclose(found.depth, [[1.0, 3.0, 3.0], [NO_ANSWER, NOTHING, 3.0]])
    assert found.focal == (2.0, 2.0)
    assert found.center == (1.0, 0.75)
    whole = depth_image(image, info, "depth", 2.0, np.eye(4), (0.4, 5.0), most=30)
    assert whole.depth.shape == (5, 6)


def test_rows_of_an_image_may_be_padded_and_of_the_other_order():
    image, info = camera()
    rows = np.frombuffer(bytes(image.data), "<u2").reshape(2, 3).astype(">u2")
    padded = np.zeros((2, 4), ">u2")
    padded[:, :3] = rows
    image.data, image.step, image.is_bigendian = array("B", padded.tobytes()), 8, 1
    found = depth_image(image, info, "depth", 2.0, np.eye(4), (0.4, 5.0))
    np.testing.assert_allclose(found.depth[1, 0], 2.0, rtol=1e-6)


@each("changes", ({"encoding": "rgb8"}, {"data": array("B", [0] * 5)}, {"height": 3}, {"width": 0}))
def test_an_image_that_cannot_be_is_refused(changes: dict[str, object]):
    image, info = camera()
    image.__dict__.update(changes)
    with pytest.raises(MessageError):
        depth_image(image, info, "depth", 0.0, np.eye(4), (0.4, 5.0))


def test_a_camera_needs_a_focal_length():
    image, info = camera()
    info.k = [0.0] * 9
    with pytest.raises(MessageError, match="focal"):
        depth_image(image, info, "depth", 0.0, np.eye(4), (0.4, 5.0))


def grid(data: list[int], **changes: object) -> Fields:
    usual = {"height": 2, "width": 3, "resolution": 0.5, "origin": pose(1.0, -1.0)}
    return Fields(info=Fields(**{**usual, **changes}), data=array("b", data))


def test_a_map_has_a_box_for_each_occupied_cell():
    (found,) = map_obstacles(grid([0, 0, 100, -1, 50, 0]))
    (part,), middle = found.parts, _middle(found)
    np.testing.assert_allclose(middle[:2], [2.25, -0.75])
    np.testing.assert_allclose(part.half_extents[:2], 0.25)
    assert middle[2] == pytest.approx(part.half_extents[2]), "it stands on the floor"
    assert len(map_obstacles(grid([0] * 6))) == 0
    assert len(map_obstacles(grid([-1] * 6), unknown="occupied")) == 1


def _middle(obstacle: Obstacle) -> np.ndarray:
    """Of its only part, in the world."""
    return (np.asarray(obstacle.pose) @ [*obstacle.parts[0].center, 1.0])[:3]


def test_a_turned_map_turns_its_cells():
    turned = pose(0.0, 0.0, (0.0, 0.0, math.sin(0.25 * math.pi), math.cos(0.25 * math.pi)))
    (found,) = map_obstacles(grid([0, 0, 100, 0, 0, 0], origin=turned))
    np.testing.assert_allclose(_middle(found)[:2], [-0.25, 1.25], atol=1e-9)


@each("wrong", (grid([0] * 5), grid([0] * 6, resolution=NAN), grid([0] * 6, resolution=0.0)))
def test_a_map_that_does_not_fit_is_refused(wrong: Fields):
    with pytest.raises(MessageError):
        map_obstacles(wrong)


def test_a_path_goes_there_and_back():
    path = Fields(header=header(), poses=[])
    places = np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 0.4], [2.0, 0.5, -3.0]])
    fill_path(path, lambda: Fields(header=header(), pose=pose()), places, "map", 5)
    np.testing.assert_allclose(path_of(path, "map"), places, atol=1e-12)
    with pytest.raises(MessageError, match="odom"):
        path_of(path, "odom")
    path.poses = path.poses[:1]
    with pytest.raises(MessageError, match="1 poses"):
        path_of(path)


def test_a_velocity_goes_there_and_back():
    twist = Fields(linear=Fields(x=0.0, y=0.0, z=0.0), angular=Fields(x=0.0, y=0.0, z=0.0))
    fill_twist(twist, [0.5, -0.1, 0.3])
    np.testing.assert_array_equal(twist_of(twist), [0.5, -0.1, 0.3])
    twist.linear.x = NAN
    with pytest.raises(MessageError):
        twist_of(twist)
    there = pose()
    fill_pose(there, [1.0, 2.0, -2.5])
    np.testing.assert_allclose(planar_pose(there), [1.0, 2.0, -2.5])


def test_an_arms_trajectory_ends_at_rest_within_its_acceleration():
    q, rates, most = np.array([0.1, -0.2]), np.array([0.5, -1.0]), np.array([2.0, 4.0])
    points = ending_at_rest(q, rates, most, 0.1)
    np.testing.assert_allclose(points[0].positions, q + 0.1 * rates)
    np.testing.assert_array_equal(points[-1].velocities, 0.0)
    brake = points[1].time - points[0].time
    assert (np.abs(rates) <= most * brake + 1e-12).all()
    np.testing.assert_allclose(points[1].positions - points[0].positions, 0.5 * rates * brake)
    message = Fields(joint_names=[], points=[])
    make = lambda: Fields(time_from_start=Fields(sec=0, nanosec=0), positions=[], velocities=[])  # noqa: E731
    fill_trajectory(message, make, ("a", "b"), points)
    assert message.joint_names == ["a", "b"]
    assert nanoseconds(message.points[0].time_from_start) == 100_000_000


def test_a_polygon_has_the_corners():
    polygon = Fields(points=[])
    fill_polygon(polygon, lambda: Fields(x=0.0, y=0.0, z=0.0), [[0.0, 1.0], [2.0, 3.0]])
    assert [(p.x, p.y) for p in polygon.points] == [(0.0, 1.0), (2.0, 3.0)]
