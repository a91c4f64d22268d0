"""Laser logs: JSON lines, CSV and CARMEN lines become scans with poses; what is wrong is said with file and line."""

from __future__ import annotations

import json
import logging
import math

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.errors import InputError
from elastic_strips.io import LaserLogError, read_laser_log

ENTRY = {
    "stamp": 12.5,
    "angle_min": -0.5,
    "angle_increment": 0.5,
    "range_min": 0.1,
    "range_max": 8.0,
    "ranges": [1.5, None, 9.0],
    "pose": [1.0, 2.0, 0.3],
}
HEADER = "stamp,angle_min,angle_increment,range_min,range_max,x,y,yaw,ranges\n"
FLASER = "FLASER 4 1.0 2.0 81.9 0.0 5.0 6.0 0.5 4.0 6.0 0.5 976052857.3 host 0.7\n"


def write(folder, text):
    path = folder / "log.txt"
    path.write_text(text, encoding="utf-8")
    return path


def entry(**changes):
    return json.dumps({k: v for k, v in {**ENTRY, **changes}.items() if v != "gone"}) + "\n"


def test_json_lines(tmp_path):
    text = (
        "# made by hand\n"
        + entry()
        + "\n"
        + entry(stamp=13, pose="gone", mount=[0.2, 0.0, 0.3, math.pi], sensor="rear")
    )
    (first, pose), (second, no_pose) = read_laser_log(write(tmp_path, text), height=0.4)
    assert (first.sensor, first.time, first.range_min, first.range_max) == ("laser", 12.5, 0.1, 8.0)
    np.testing.assert_allclose(first.angles, [-0.5, 0.0, 0.5])
    np.testing.assert_array_equal(first.ranges, [1.5, np.nan, np.inf])
    np.testing.assert_array_equal(pose, [1.0, 2.0, 0.3])
    assert first.T_base_sensor[2, 3] == 0.4
    assert no_pose is None
    assert second.sensor == "rear"
    np.testing.assert_allclose(second.T_base_sensor @ [1, 0, 0, 1], [-0.8, 0.0, 0.3, 1.0], atol=1e-12)


def test_ranges_follow_rep_117_and_clockwise_scans_are_turned(tmp_path):
    """Infinity and what is beyond the range: nothing; NaN, −infinity and what is too near: no answer."""
    line = entry(ranges=[1.0, 2.0, 0.05, -math.inf, math.inf, math.nan, 8.0], angle_increment=-0.2, angle_min=0.6)
    ((scan, _),) = read_laser_log(write(tmp_path, line))
    np.testing.assert_array_equal(scan.ranges, [np.inf, np.nan, np.inf, np.nan, np.nan, 2.0, 1.0])
    np.testing.assert_allclose(scan.angles, np.linspace(-0.6, 0.6, 7), atol=1e-12)


def test_csv_with_and_without_poses(tmp_path):
    rows = "1.0,-0.5,0.5,0.1,8,1,2,0.3,1.5,,inf\n1.1,-0.5,0.5,0.1,8,1,2,0.3,1.5,2.5,nan\n"
    (first, pose), (second, _) = read_laser_log(write(tmp_path, HEADER + rows))
    np.testing.assert_array_equal(first.ranges, [1.5, np.nan, np.inf])
    np.testing.assert_array_equal(second.ranges, [1.5, 2.5, np.nan])
    np.testing.assert_array_equal(pose, [1.0, 2.0, 0.3])
    bare = "stamp,angle_min,angle_increment,range_min,range_max,ranges\n1,-0.5,0.5,0.1,8,1,2,3\n"
    ((scan, none),) = read_laser_log(write(tmp_path, bare))
    assert none is None
    assert len(scan.ranges) == 3


def test_carmen_flaser(tmp_path):
    text = "PARAM robot_width 0.5 1.0 host 0.1\nODOM 1 2 3 0 0 0 1.0 host 0.1\n" + FLASER
    ((scan, pose),) = read_laser_log(write(tmp_path, text), height=0.3)
    assert scan.time == 976052857.3
    np.testing.assert_allclose(scan.angles, -0.5 * math.pi + 0.25 * math.pi * np.arange(4))
    np.testing.assert_array_equal(scan.ranges, [1.0, 2.0, np.inf, np.nan])
    np.testing.assert_array_equal(pose, [5.0, 6.0, 0.5])
    np.testing.assert_array_equal(scan.T_base_sensor[:3, 3], [0, 0, 0.3])
    ((scan, pose),) = read_laser_log(write(tmp_path, text), carmen_pose="odometry")
    np.testing.assert_array_equal(pose, [4.0, 6.0, 0.5])
    np.testing.assert_allclose(scan.T_base_sensor[:2, 3], [math.cos(0.5), -math.sin(0.5)])
    odd = FLASER.replace("FLASER 4 1.0", "FLASER 5 1.0 1.0")
    assert read_laser_log(write(tmp_path, odd))[0][0].angles[-1] == pytest.approx(0.5 * math.pi)


@each("tail", ["0 ", "2 7 8 ", ""])
@each("axis", ["", "0.4 "])
def test_carmen_robotlaser_and_rawlaser(tmp_path, tail, axis):
    """With and without remissions and turn axis: writers differ."""
    head = "LASER1 0 -1.5 3.0 0.5 20.0 0.01 0 3 1.0 25.0 2.0 "
    text = f"ROBOT{head}{tail}5 6 0.5 4 6 0.5 0.1 0.2 0.3 0.4 {axis}99.5 host 0.7\nRAW{head}{tail}98.5 host 0.6\n"
    (robot, pose), (raw, none) = read_laser_log(write(tmp_path, text))
    np.testing.assert_allclose(robot.angles, [-1.5, -1.0, -0.5])
    np.testing.assert_array_equal(robot.ranges, [1.0, np.inf, 2.0])
    np.testing.assert_array_equal(pose, [5.0, 6.0, 0.5])
    assert (robot.time, raw.time, none) == (99.5, 98.5, None)
    assert robot.range_max == 20.0


BAD = [
    ("", "holds no scans: it is empty"),
    ("# only this\n", "is empty"),
    ("PARAM a b 1 host 2\n", "holds no scans"),
    ("12 13 14\n", r"log\.txt:1: neither a JSON object"),
    (entry() + "{\n", r"log\.txt:2: no JSON object: .* at column"),
    (entry() + "[1]\n", r"log\.txt:2: no JSON object|log\.txt:2: scan: must be a mapping"),
    (entry(ranges="gone"), "the key 'ranges' is missing"),
    (entry(rangs=[1]), "unknown key 'rangs'"),
    (entry(ranges=5), "ranges: must be a list"),
    (entry(ranges=[1.0, "far"]), r"ranges\[1\]: must be a number, not 'far'"),
    (entry(ranges=[1.0]), "has 1 ranges; at least 2"),
    (entry(stamp=True), "stamp: must be a number"),
    (entry(stamp=math.nan), "stamp: nan must be a finite number"),
    (entry(pose=[1.0, 2.0]), "pose: must be a list of 3 numbers"),
    (entry(x=1.0), "a pose is given by 'pose', or by all of 'x', 'y' and 'yaw'"),
    (entry(range_min=9.0), "range_min=9 must be at least 0 and less than range_max=8"),
    (entry(angle_increment=4.0), "make no scan of at most one turn"),
    (entry(angle_increment=0), "angle_increment=0"),
    (entry(sensor=3), "sensor: must be a non-empty string, not 3"),
    ("stamp,angle_min,ranges\n1,2,3\n", r"log\.txt:1: the header must hold stamp, angle_min, angle_increment"),
    ("stamp,colour,ranges\n", r"log\.txt:1: the header must hold"),
    (HEADER + "1.0,-0.5,0.5,0.1,8,1,2\n", r"log\.txt:2: has 7 columns; 8 and the ranges are needed"),
    (HEADER + "1.0,-0.5,0.5,0.1,8,1,2,0,1,far\n", r"log\.txt:2: ranges: must be a number, not 'far'"),
    (HEADER, "holds no scans"),
    (
        FLASER + FLASER.replace("FLASER 4", "FLASER 9"),
        r"log\.txt:2: FLASER with 9 readings has 14 fields; 19 are needed",
    ),
    (
        FLASER.replace("FLASER 4", "FLASER four"),
        "number of readings must be a whole number from 1 to 100000, not 'four'",
    ),
    (FLASER.replace("5.0", "x"), "pose: must be a number, not 'x'"),
    ("FLASER\n", "number of readings must be"),
    ("RAWLASER1 0 -1.5\n", "RAWLASER1 has 2 fields; at least 8"),
    ("RAWLASER1 0 -1.5 3 0.5 20 0.01 0 9 1 2\n", "RAWLASER1 with 9 readings ends too early"),
    ("ROBOTLASER1 0 -1.5 3 0.5 20 0.01 0 2 1 2 0 1 2 3\n", "ends too early"),
    (FLASER + "laser 1 2\n", r"log\.txt:2: 'laser'"),
]


@each("text, message", BAD)
def test_a_wrong_log_names_file_and_line(tmp_path, text, message):
    with pytest.raises(LaserLogError, match=message):
        read_laser_log(write(tmp_path, text))


def test_missing_and_binary_files_and_wrong_arguments(tmp_path):
    with refused(LaserLogError, "gone.log:"):
        read_laser_log(tmp_path / "gone.log")
    with refused(LaserLogError, "folder"):
        read_laser_log(tmp_path)
    (tmp_path / "log.txt").write_bytes(b"FLASER \xff\xfe")
    with refused(LaserLogError, "log.txt:1:"):
        read_laser_log(tmp_path / "log.txt")
    path = write(tmp_path, FLASER)
    with refused(InputError, "carmen_pose='truth'"):
        read_laser_log(path, carmen_pose="truth")
    with refused(InputError, "carmen_range_max"):
        read_laser_log(path, carmen_range_max=0.0)


@pytest.mark.parametrize("mount", [None, (0.2, -0.1, 0.4, 0.5)])
def test_a_mount_that_is_not_stated_is_said_or_given(tmp_path, caplog, mount):
    lines = "".join(
        json.dumps(
            {"stamp": k, "angle_min": 0, "angle_increment": 0.1, "range_min": 0, "range_max": 8, "ranges": [1, 2], **m}
        )
        + "\n"
        for k, m in enumerate(({}, {"mount": [1, 2, 3, 0]}))
    )
    with caplog.at_level(logging.WARNING):
        (first, _), (second, _) = read_laser_log(write(tmp_path, lines), mount=mount)
    np.testing.assert_allclose(first.T_base_sensor[:3, 3], (0, 0, 0) if mount is None else mount[:3])
    np.testing.assert_allclose(second.T_base_sensor[:3, 3], [1, 2, 3])
    assert ("1 scans" in caplog.text) == (mount is None)
