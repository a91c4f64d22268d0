"""Trajectory files: what is written reads back, to the last bit or as far as the format goes; in ROS' field names."""

from __future__ import annotations

import json

import numpy as np
import pytest
from cases import each, refused

import elastic_strips as es
from elastic_strips.errors import InputError, MissingExtraError
from elastic_strips.io import load_path, trajectory_columns, trajectory_document, trajectory_frame, write_trajectory
from elastic_strips.trajectory import retime


@pytest.fixture(scope="module", params=["silvermate", "jackal-box", "panda"])
def trajectory(request):
    """A base with an arm, a base alone, an arm alone; the base turns more than half a turn."""
    robot = es.load_robot(request.param)
    rows = np.tile(robot.space.to_coordinates(robot.home_q), (30, 1))
    k = np.arange(30)
    if robot.space.planar:
        turn = 0.12 * k
        rows[:, :3] = np.column_stack((np.sin(turn), 1.0 - np.cos(turn), turn))
    if len(robot.joint_names):
        rows[:, -1] += 0.001 * k
    return retime(es.Strip.from_coordinates(robot, rows))


@each(("suffix", "loss"), [(".csv", 0.0), (".npz", 0.0), (".json", 1e-9)])
def test_a_trajectory_comes_back(tmp_path, trajectory, suffix, loss):
    back = load_path(write_trajectory(tmp_path / f"t{suffix}", trajectory), trajectory.robot)
    assert np.abs(back.q - trajectory.q).max() <= loss  # of a quaternion's sine and cosine
    assert np.abs(back.times - trajectory.time).max() <= loss  # whole nanoseconds
    assert back.notes == (("velocities and accelerations are left out",) if suffix == ".csv" else ())


def test_a_trajectory_goes_through_memory(trajectory):
    """... as dictionaries: whole turns stay, and the rates are those of the positions."""
    robot, given = trajectory.robot, trajectory.joint_trajectory()
    back = load_path(given, robot)
    assert (back.rows == trajectory.coordinates).all()
    assert np.abs(back.times - (trajectory.time - trajectory.time[0])).max() == 0.0
    assert not back.doubts
    assert es.certify(robot, es.Scene(), back, interpolation="line", measure=False).certified
    assert json.loads(json.dumps(given)) == given
    q, v, a = (np.array([p[key] for p in given["points"]]) for key in ("positions", "velocities", "accelerations"))
    dt = np.diff(back.times)[:, None]
    for rows, rates in ((q, v), (v, a)):
        error = np.abs(np.diff(rows, axis=0) / dt - 0.5 * (rates[1:] + rates[:-1]))
        assert np.median(error, axis=0).max() < 1e-3 + 1e-2 * np.abs(rates).max()


def test_an_npz_file_holds_the_arrays_and_no_other(tmp_path, trajectory):
    with np.load(write_trajectory(tmp_path / "t.npz", trajectory)) as found:
        assert set(found.files) == {"time", "joint_names", "positions", "velocities", "accelerations"}
        np.testing.assert_array_equal(found["velocities"], trajectory.v)
        np.testing.assert_array_equal(found["accelerations"], trajectory.a)


def test_all_that_is_known_is_in_the_columns(trajectory):
    columns, robot = trajectory_columns(trajectory), trajectory.robot
    assert len(columns) == 1 + 3 * robot.nv
    for name in robot.joint_names[-1:]:
        np.testing.assert_array_equal(columns[name], trajectory.coordinates[:, -1])
        np.testing.assert_array_equal(columns[f"{name}_rate"], trajectory.v[:, -1])
        np.testing.assert_array_equal(columns[f"{name}_acceleration"], trajectory.a[:, -1])
    if robot.space.planar:
        np.testing.assert_array_equal(columns["omega"], trajectory.v[:, 2])
    assert np.abs(trajectory.v).max() > 0.0


def test_the_table_has_the_columns(trajectory, monkeypatch):
    pandas = pytest.importorskip("pandas")
    frame = trajectory_frame(trajectory)
    assert isinstance(frame, pandas.DataFrame)
    assert list(frame.columns) == list(trajectory_columns(trajectory))
    assert (frame["time"] == trajectory.time).all()
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with refused(MissingExtraError, "pandas"):
        trajectory_frame(trajectory)


def test_json_has_the_fields_of_ros(tmp_path, trajectory):
    """Every field of the messages, and no other; where rosbags is, its definitions say which."""
    document = json.loads(write_trajectory(tmp_path / "t.json", trajectory, frame="odom").read_text())
    assert document == trajectory_document(trajectory, frame="odom")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)

    def check(kind: str, value: dict) -> None:
        fields = dict(store.fielddefs[kind][1])
        assert value.keys() == fields.keys(), kind
        for name, (node, of) in fields.items():
            if node == 2:
                check(of, value[name])
            elif node == 4 and of[0][0] == 2:
                for each in value[name][:2]:
                    check(of[0][1], each)

    check("trajectory_msgs/msg/JointTrajectory", document["joint_trajectory"])
    if trajectory.robot.space.planar:
        check("trajectory_msgs/msg/MultiDOFJointTrajectory", document["multi_dof_joint_trajectory"])
        check("nav_msgs/msg/Path", document["path"])
        assert document["path"]["header"]["frame_id"] == "odom"
    else:
        assert document.keys() == {"joint_trajectory"}


def test_another_ending_is_refused_before_anything_is_written(tmp_path, trajectory):
    with refused(InputError, "'.jsn'", "'.json'"):
        write_trajectory(tmp_path / "t.jsn", trajectory)
    with refused(InputError, "Trajectory"):
        write_trajectory(tmp_path / "t.json", trajectory.strip())
    with refused(InputError, "folder"):
        write_trajectory(tmp_path / "gone" / "t.csv", trajectory)
    assert not list(tmp_path.iterdir())
