"""Path files: each format gives the same configurations; names decide, not order; what is wrong is named."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.errors import ConfigurationError
from elastic_strips.io import load_path, write_path
from elastic_strips.robot import RobotModel, load_robot

NAMES = ("panda_joint1", "panda_joint2", "panda_joint3", "panda_joint4", "panda_joint5", "panda_joint6", "panda_joint7")


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return load_robot("panda", joints=NAMES)


@pytest.fixture(scope="module")
def rows(panda) -> np.ndarray:
    home = panda.space.to_coordinates(panda.home_q)
    return home + 0.2 * np.arange(4)[:, None] * np.array([1.0, 0.5, -1.0, 0.3, 1.0, -0.4, 0.2])


def _document(rows, names=NAMES, stamp=lambda k: {"sec": k, "nanosec": 500_000_000}):
    points = [{"positions": row.tolist(), "time_from_start": stamp(k)} for k, row in enumerate(rows)]
    return {"joint_names": list(names), "points": points}


def test_what_is_written_is_read(panda, rows, tmp_path):
    q = panda.space.from_coordinates(rows)
    for name, times in (
        ("a.csv", None),
        ("b.csv", np.arange(4) * 0.7),
        ("c.json", None),
        ("d.json", np.arange(4) * 0.7),
    ):
        read = load_path(write_path(tmp_path / name, panda, q, times), panda)
        np.testing.assert_array_equal(read.q, q)
        assert (read.times is None) == (times is None)
        if times is not None:
            np.testing.assert_allclose(read.times, times, atol=1e-12)


def test_a_joint_trajectory_in_any_order_and_wrapping(panda, rows, tmp_path):
    order = [3, 0, 6, 1, 2, 5, 4]
    shuffled = _document(rows[:, order], [NAMES[k] for k in order])
    (tmp_path / "a.json").write_text(json.dumps({"trajectory": [{"joint_trajectory": shuffled}]}))
    read = load_path(tmp_path / "a.json", panda)
    np.testing.assert_allclose(panda.space.to_coordinates(read.q), rows, atol=1e-12)
    np.testing.assert_allclose(read.times, np.arange(4) + 0.5)
    assert read.notes == ()


def test_what_moveit_prints(panda, rows, tmp_path):
    lines = ["joint_trajectory:", "  joint_names:", *(f"  - {name}" for name in NAMES), "  points:"]
    for k, row in enumerate(rows):
        lines += [
            f"  - positions: [{', '.join(map(repr, row.tolist()))}]",
            "    velocities: []",
            "    time_from_start:",
            f"      secs: {k}",
            "      nsecs: 0",
        ]
    (tmp_path / "a.yaml").write_text("\n".join(lines) + "\n---\n")
    read = load_path(tmp_path / "a.yaml", panda)
    np.testing.assert_allclose(panda.space.to_coordinates(read.q), rows, atol=1e-12)
    np.testing.assert_allclose(read.times, np.arange(4))


def test_what_ompl_prints(panda, rows, tmp_path):
    (tmp_path / "matrix.txt").write_text("\n".join(" ".join(map(repr, row.tolist())) for row in rows) + "\n\n")
    states = "\n".join(f"RealVectorState [{' '.join(map(repr, row.tolist()))}]" for row in rows)
    (tmp_path / "print.txt").write_text(f"Geometric path with 4 states\n{states}\n\n")
    for name in ("matrix.txt", "print.txt"):
        read = load_path(tmp_path / name, panda)
        np.testing.assert_allclose(panda.space.to_coordinates(read.q), rows, atol=1e-12)
        assert read.notes == ("columns without names: taken in the robot's order",)


_PRINTS = """
from ompl import base as ob
from ompl import geometric as og
space = ob.CompoundStateSpace()
for part, size in ((ob.SE2StateSpace(), 2), (ob.RealVectorStateSpace({joints}), {joints})):
    bounds = ob.RealVectorBounds(size)
    bounds.setLow(-5.0)
    bounds.setHigh(5.0)
    part.setBounds(bounds)
    space.addSubspace(part, 1.0)
space.setup()
path = og.PathGeometric(ob.SpaceInformation(space))
for row in {rows}:
    state = space.allocState()
    state[0].setX(row[0])
    state[0].setY(row[1])
    state[0].setYaw(row[2])
    for k, value in enumerate(row[3:]):
        state[1][k] = value
    path.append(state)
path.{method}()
"""


@pytest.mark.parametrize("method", ["print", "printAsMatrix"])
def test_ompl_itself(tmp_path, method):
    """What OMPL prints today, not what we think it prints; of a base and its joints."""
    robot = load_robot("silvermate", base="omni")
    wanted = np.tile(robot.space.to_coordinates(robot.home_q), (3, 1))
    wanted[:, :3] = [[0.0, 0.0, 0.1], [0.5, -0.25, 0.2], [1.0, 0.125, 0.3]]
    script = _PRINTS.format(joints=robot.nv - 3, rows=wanted.tolist(), method=method)
    printed = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    (tmp_path / "path.txt").write_text(printed)
    read = load_path(tmp_path / "path.txt", robot)
    np.testing.assert_allclose(robot.space.to_coordinates(read.q), wanted, atol=1e-4)  # it prints six digits


def test_samples_of_toppra_and_drake(panda, rows, tmp_path):
    times = np.linspace(0.0, 1.5, 4)
    np.savez(tmp_path / "toppra.npz", ts=times, qs=rows)
    np.savez(tmp_path / "drake.npz", t=times, q=rows.T)  # a column for each sample
    np.savez_compressed(tmp_path / "named.npz", positions=rows[:, ::-1], joint_names=np.array(NAMES[::-1]), times=times)
    np.save(tmp_path / "plain.npy", rows)
    for name in ("toppra.npz", "drake.npz", "named.npz", "plain.npy"):
        read = load_path(tmp_path / name, panda)
        np.testing.assert_allclose(panda.space.to_coordinates(read.q), rows, atol=1e-12)
        if name != "plain.npy":
            np.testing.assert_allclose(read.times, times)


def test_what_the_robot_does_not_plan_is_left_out_with_a_note(panda, rows, tmp_path):
    text = "time;gripper;" + ";".join(NAMES[:6]) + "\n"
    text += "\n".join(";".join(map(repr, [float(k), 0.04, *row[:6].tolist()])) for k, row in enumerate(rows))
    (tmp_path / "a.csv").write_text("# from somewhere\n" + text)
    read = load_path(tmp_path / "a.csv", panda)
    np.testing.assert_allclose(panda.space.to_coordinates(read.q)[:, :6], rows[:, :6])
    assert len(read.notes) == 2
    assert "gripper" in read.notes[0]
    assert "panda_joint7" in read.notes[1]


def test_a_gripper_that_is_held_otherwise_is_said(rows, tmp_path):
    """The proof is of the gripper as it is held, with both fingers."""
    fingers = ("panda_finger_joint1", "panda_finger_joint2")
    file = tmp_path / "path.json"
    held = np.column_stack((rows, np.full((4, 2), 0.03)))
    file.write_text(json.dumps(_document(held, (*NAMES, *fingers), stamp=float)))
    (doubt,) = load_path(file, load_robot("panda")).doubts
    assert "panda_finger_joint1 at 0.001, in the file 0.03; panda_finger_joint2 at 0.001, in the file 0.03" in doubt
    as_there = load_path(file, load_robot("panda", locked={"panda_finger_joint1": 0.03}))
    assert as_there.doubts == ()
    assert len(as_there.notes) == 1


def test_a_moving_base_has_names_too(tmp_path):
    robot = load_robot("silvermate")
    transforms = [
        {
            "transforms": [
                {"translation": {"x": x, "y": 0.5, "z": 0.0}, "rotation": {"x": 0, "y": 0, "z": 0.6, "w": 0.8}}
            ]
        }
        for x in (0.0, 1.0)
    ]
    home = robot.space.to_coordinates(robot.home_q)[3:].tolist()
    document = {
        "joint_trajectory": {"joint_names": list(robot.joint_names), "points": [{"positions": home}] * 2},
        "multi_dof_joint_trajectory": {"joint_names": ["base"], "points": transforms},
    }
    (tmp_path / "a.json").write_text(json.dumps(document))
    coordinates = robot.space.to_coordinates(load_path(tmp_path / "a.json", robot).q)
    np.testing.assert_allclose(
        coordinates[:, :3], [[0.0, 0.5, 2 * np.arctan2(0.6, 0.8)], [1.0, 0.5, 1.2870022]], atol=1e-6
    )


WRONG = {
    "empty.csv": ("", "is empty"),
    "one.csv": (",".join(NAMES) + "\n" + ",".join("0" * 7), "has 1 configuration"),
    "few.csv": ("0,1\n0,1\n", "2 columns without names.*panda_joint1"),
    "ragged.csv": ("0,0,0,-1,0,1,0\n0,0\n", ":2: has 2 columns, not 7"),
    "word.csv": ("0,0,0,-1,0,1,0\n0,0,0,-1,zero,1,0\n", ":2: 'zero' is not a number"),
    "nan.csv": ("0,0,0,-1,0,1,0\n0,0,0,-1,nan,1,0\n", "not finite"),
    "far.csv": ("0,0,0,-1,0,1,0\n99,0,0,-1,0,1,0\n", "panda_joint1"),
    "other.csv": ("a,b\n0,1\n0,1\n", "names a, b; 'panda.*' plans panda_joint1"),
    "twice.csv": (f"{NAMES[0]},{NAMES[0]}\n0,1\n0,1\n", "names a joint twice"),
    "back.csv": (f"time,{NAMES[0]}\n1,0\n0,0\n", "decrease"),
    "none.json": ("{}", "no JointTrajectory"),
    "bad.json": ("{", "not JSON"),
    "none.yaml": ("points: []\njoint_names: []\n", "no JointTrajectory"),
    "short.json": (json.dumps({"joint_names": list(NAMES), "points": [{"positions": [0.0]}] * 2}), "7 numbers"),
    "states.txt": ("Geometric path with 3 states\nRealVectorState [1 2]\n", "no 3 states"),
    "junk.npz": ("junk", "path file"),
    "junk.npy": ("junk", "path file"),
}


@each("name", WRONG)
def test_what_is_wrong_is_named(panda, tmp_path, name):
    text, message = WRONG[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigurationError, match=message) as caught:
        load_path(tmp_path / name, panda)
    assert name in str(caught.value)


def test_arrays_of_another_kind_are_refused(panda, tmp_path):
    np.savez(tmp_path / "a.npz", speed=np.zeros((3, 7)))
    with refused(ConfigurationError, "speed"):
        load_path(tmp_path / "a.npz", panda)
    np.savez(tmp_path / "b.npz", q=np.zeros(7))
    with refused(ConfigurationError, "rows"):
        load_path(tmp_path / "b.npz", panda)
    np.savez(tmp_path / "c.npz", q=np.zeros((3, 0)), joint_names=np.array(NAMES))
    with refused(ConfigurationError, "0 columns", "7 names"):
        load_path(tmp_path / "c.npz", panda)
    with refused(ConfigurationError, "path file"):
        load_path(tmp_path / "missing.csv", panda)


def test_a_long_list_is_looked_through_once(panda, tmp_path):
    """Half a million numbers that are no trajectory: what takes their square would not end."""
    (tmp_path / "p.json").write_text(json.dumps({"obstacles": [1] * 500_000}))
    with refused(ConfigurationError, "JointTrajectory"):
        load_path(tmp_path / "p.json", panda)
