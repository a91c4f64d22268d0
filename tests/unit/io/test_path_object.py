"""What planners hand over in Python: real objects of OMPL, and stand-ins with the attributes of the others' types.

Attributes were read from trajectory_msgs 5.5.1 (rclpy), moveit_py's RobotTrajectory, genpy's messages, vamp-planner
0.6.4, cuRobo's JointState of 0.7, roboplan 0.7.0 and drake 1.51.1; the types of trajectory_msgs, RoboPlan and Drake
were read in here as well.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.collision import Verdict, certify
from elastic_strips.errors import ConfigurationError
from elastic_strips.io import load_path
from elastic_strips.planning.ompl_planner import OMPL_LOCK, seed_ompl
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Scene
from elastic_strips.strip import repair

NAMES = tuple(f"panda_joint{k}" for k in range(1, 8))
NOTHING = Scene([Box((0.1, 0.1, 0.1), at=(9.0, 9.0, 9.0), name="far")])


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return load_robot("panda")


@pytest.fixture(scope="module")
def rows(panda) -> np.ndarray:
    """A path of three configurations, (3, 7)."""
    start = panda.home_q
    return np.array([start, start + 0.1, start + np.linspace(0.0, 0.3, 7)])


@pytest.fixture(scope="module")
def geared(tmp_path_factory) -> RobotModel:
    """A joint without limits, one with, a finger, and a finger that mimics it and is named beside it."""
    box = '<collision><geometry><box size="0.05 0.05 0.2"/></geometry></collision>'
    links = "".join(f'<link name="{name}">{box}</link>' for name in ("base", "a", "b", "f", "g"))

    def joint(name: str, kind: str, parent: str, child: str, z: float, more: str = "") -> str:
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><axis xyz="0 0 1"/>'
            f'<origin xyz="0 0 {z}"/><limit lower="-2" upper="2" effort="1" velocity="1"/>{more}</joint>'
        )

    joints = (
        joint("turn", "continuous", "base", "a", 0.4)
        + joint("lean", "revolute", "a", "b", 0.4)
        + joint("finger", "revolute", "b", "f", 0.4)
        + joint("other", "revolute", "b", "g", 0.8, '<mimic joint="finger"/>')
    )
    file = tmp_path_factory.mktemp("geared") / "geared.urdf"
    file.write_text(f'<robot name="geared">{links}{joints}</robot>')
    return load_robot(file, base="fixed", joints=["turn", "lean", "finger"])


class Tensor:
    """As torch's: numbers come out by ``detach().cpu().numpy()`` alone."""

    def __init__(self, values: np.ndarray) -> None:
        self._values = values

    def detach(self) -> Tensor:
        return self

    def cpu(self) -> Tensor:
        return self

    def numpy(self) -> np.ndarray:
        return self._values

    def __len__(self) -> int:
        raise TypeError("on another device")


class VampPath:
    """As vamp's: a length, and float32 configurations by number."""

    def __init__(self, rows: np.ndarray) -> None:
        self._rows = rows.astype(np.float32)

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, k: int) -> np.ndarray:
        return self._rows[k]


class RosMessage:
    """As rclpy's generated classes: fields in slots with an underscore, and their names by a method."""

    _fields: tuple[str, ...] = ()

    def __init__(self, **values: Any) -> None:
        for name in self._fields:
            setattr(self, f"_{name}", values[name])

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        return dict.fromkeys(cls._fields, "")

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name not in self._fields:
            raise AttributeError(name)
        return getattr(self, f"_{name}")


class JointTrajectory(RosMessage):
    _fields = ("header", "joint_names", "points")


class JointTrajectoryPoint(RosMessage):
    _fields = ("positions", "velocities", "time_from_start")


def ros(names, rows, velocities: bool = False) -> JointTrajectory:
    points = [
        JointTrajectoryPoint(
            positions=np.array(row),
            velocities=np.zeros(len(row) if velocities else 0),
            time_from_start=SimpleNamespace(sec=k, nanosec=0),
        )
        for k, row in enumerate(rows)
    ]
    header = SimpleNamespace(frame_id="", stamp=SimpleNamespace(sec=0, nanosec=0))
    return JointTrajectory(header=header, joint_names=list(names), points=points)


def pose(x: float, y: float, yaw: float) -> SimpleNamespace:
    turn = SimpleNamespace(x=0.0, y=0.0, z=np.sin(yaw / 2.0), w=np.cos(yaw / 2.0))
    return SimpleNamespace(translation=SimpleNamespace(x=x, y=y, z=0.0), rotation=turn)


def ompl() -> tuple[Any, Any]:
    """OMPL's ``base`` and ``geometric``; a test's module that held them would make them count as leaked in the end."""
    from ompl import base, geometric

    return base, geometric


def geometric(space: Any, states: list[Any]) -> Any:
    ob, og = ompl()
    return og.PathGeometric(ob.SpaceInformation(space), states)


def reals(rows: np.ndarray) -> tuple[Any, list[Any]]:
    """A space of real vectors, and states in it."""
    ob, _ = ompl()
    space = ob.RealVectorStateSpace(rows.shape[1])
    bounds = ob.RealVectorBounds(rows.shape[1])
    bounds.setLow(-4.0)
    bounds.setHigh(4.0)
    space.setBounds(bounds)
    states = []
    for row in rows:
        state: Any = space.allocState()
        for k, value in enumerate(row):
            state[k] = float(value)
        states.append(state)
    return space, states


def handed_over(rows: np.ndarray) -> dict[str, tuple[Any, dict[str, Any]]]:
    """The same path by each, with the arguments that it takes; names in another order where they are given."""
    ob, _ = ompl()
    back, other = NAMES[::-1], rows[:, ::-1]
    space, states = reals(rows)
    joint_state = SimpleNamespace(position=Tensor(other[None]), joint_names=list(back))  # a batch of one
    motion = SimpleNamespace(
        success=Tensor(np.array([True])), interpolation_dt=0.5, get_interpolated_plan=lambda: joint_state
    )
    trajectory = SimpleNamespace(joint_trajectory=ros(back, other), multi_dof_joint_trajectory=ros((), ()))
    core = SimpleNamespace(get_robot_trajectory_msg=lambda: trajectory)
    return {
        "array": (rows, {}),
        "named array": (other, {"joint_names": back}),
        "list": (other.tolist(), {"joint_names": back}),
        "tensor": (Tensor(other), {"joint_names": back}),
        "JointTrajectory": (ros(back, other), {}),
        "RobotTrajectory": (trajectory, {}),
        "dictionary": ({"joint_names": back, "points": [{"positions": row} for row in other.tolist()]}, {}),
        "DisplayTrajectory": (SimpleNamespace(trajectory=[trajectory], trajectory_start=None), {}),
        "MoveItPy's response": (SimpleNamespace(trajectory=core, error_code=SimpleNamespace(val=1)), {}),
        "MoveGroupCommander": ((True, trajectory, 0.1, SimpleNamespace(val=1)), {}),
        "PathGeometric": (geometric(space, states), {"space": space}),
        "PathGeometric, its information": (geometric(space, states), {"space": ob.SpaceInformation(space)}),
        "VAMP's path": (VampPath(other), {"joint_names": back}),
        "VAMP's result": (SimpleNamespace(solved=True, path=VampPath(other)), {"joint_names": back}),
        "cuRobo's JointState": (joint_state, {}),
        "cuRobo's result": (motion, {}),
        "RoboPlan's JointPath": (SimpleNamespace(joint_names=list(back), positions=list(other)), {}),
        "Drake's": (
            SimpleNamespace(
                start_time=lambda: 1.0,
                end_time=lambda: 3.0,
                get_segment_times=lambda: [1.0, 2.0, 3.0],
                value=lambda t: np.array([[np.interp(t, (1.0, 2.0, 3.0), column)] for column in rows.T]),
            ),
            {"starts_at": 0.0},
        ),
    }


def test_a_path_is_read_as_it_is_handed_over(panda, rows):
    for name, (given, arguments) in handed_over(rows).items():
        path = load_path(given, panda, **arguments)
        np.testing.assert_allclose(path.q, rows, atol=1e-6, err_msg=name)
        assert path.doubts == (), name
        assert certify(panda, NOTHING, path).certified, name


def test_times_come_along(panda, rows):
    given = handed_over(rows)
    for name, times in (("JointTrajectory", [0, 1, 2]), ("cuRobo's result", [0, 0.5, 1]), ("Drake's", [0, 1, 2])):
        path = load_path(given[name][0], panda, **given[name][1])
        np.testing.assert_allclose(path.times, times)
    np.testing.assert_allclose(load_path(rows, panda, times=Tensor(np.arange(3.0))).times, [0, 1, 2])
    planned = SimpleNamespace(joint_names=NAMES, positions=list(rows), times=[0.0, 0.3, 0.9], velocities=list(rows))
    timed = load_path(planned, panda)
    np.testing.assert_allclose(timed.times, [0.0, 0.3, 0.9])
    assert timed.rates
    with refused(ConfigurationError, "times="):
        load_path(ros(NAMES, rows), panda, times=[0, 1, 2])


def test_ompl_plans_and_its_setup_is_handed_over(panda):
    ob, og = ompl()
    goal = panda.home(panda_joint1=1.0)
    space, (start, end) = reals(np.array([panda.home_q, goal]))
    bounds = ob.RealVectorBounds(7)
    for k in range(7):
        bounds.setLow(k, float(panda.space.lower[k]))
        bounds.setHigh(k, float(panda.space.upper[k]))
    space.setBounds(bounds)
    setup: Any = og.SimpleSetup(space)
    setup.setStateValidityChecker(lambda state: True)
    setup.setPlanner(og.RRTConnect(setup.getSpaceInformation()))
    with refused(ConfigurationError, "none"):
        load_path(setup, panda)
    setup.setStartAndGoalStates(start, end)
    with OMPL_LOCK:
        seed_ompl(0)
        assert setup.solve(10.0)
    path = load_path(setup, panda)
    np.testing.assert_allclose(path.q[[0, -1]], [panda.home_q, goal])
    assert certify(panda, NOTHING, path).certified


def test_states_of_a_base_and_joints(silvermate):
    ob, _ = ompl()
    plane: Any = ob.SE2StateSpace()
    joints = ob.RealVectorStateSpace(silvermate.nv - 3)
    space: Any = ob.CompoundStateSpace()
    space.addSubspace(plane, 1.0)
    space.addSubspace(joints, 1.0)
    states, home = [], silvermate.space.to_coordinates(silvermate.home_q)
    for x in (0.0, 1.0):
        state: Any = space.allocState()
        state[0].setX(x)
        state[0].setY(0.5)
        state[0].setYaw(0.0)
        for k in range(silvermate.nv - 3):
            state[1][k] = float(home[3 + k])
        states.append(state)
    path = load_path(geometric(space, states), silvermate, space=space)
    np.testing.assert_allclose(path.q, [silvermate.home(x=x, y=0.5) for x in (0.0, 1.0)])
    assert certify(silvermate, NOTHING, path, interpolation="line").certified


def test_what_ompl_has_and_cannot_be_read(panda, silvermate, rows):
    ob, og = ompl()
    space, states = reals(rows)
    with refused(ConfigurationError, "space="):
        load_path(geometric(space, states), panda)  # a state does not know where it ends
    with refused(ConfigurationError, "no states"):
        load_path(og.PathGeometric(ob.SpaceInformation(space)), panda, space=space)
    turns: Any = ob.SO3StateSpace()
    with refused(ConfigurationError, "SO3"):
        load_path(geometric(turns, [turns.allocState()] * 2), panda, space=turns)
    car: Any = ob.DubinsStateSpace(1.0)
    ends = []
    for x in (0.0, 1.0):
        state: Any = car.allocState()
        state.setX(x)
        state.setY(0.0)
        state.setYaw(0.0)
        ends.append(state)
    path = load_path(geometric(car, ends), silvermate, space=car)
    assert "Dubins" in path.doubts[0]
    assert certify(silvermate, NOTHING, path).verdict is Verdict.UNKNOWN


def test_ompls_dimensions_may_have_names(panda, rows):
    space, states = reals(rows[:, ::-1])
    for k, name in enumerate(NAMES[::-1]):
        space.setDimensionName(k, name)
    np.testing.assert_allclose(load_path(geometric(space, states), panda, space=space).q, rows)


def test_a_curve_is_taken_as_straight_pieces_near_it(panda, rows):
    def value(t: float) -> np.ndarray:
        return (rows[0] + 0.3 * np.sin(t) * np.arange(7) / 7.0)[:, None]

    curve = SimpleNamespace(start_time=lambda: 0.0, end_time=lambda: 3.0, value=value)
    path = load_path(curve, panda, joint_names=NAMES)
    assert path.rates
    between = [np.interp(t, path.times, column) for t in (0.777,) for column in path.q.T]
    np.testing.assert_allclose(between, value(0.777)[:, 0], atol=1e-4)
    found = certify(panda, NOTHING, path)
    assert any("pieces" in note for note in found.notes)
    jump = SimpleNamespace(start_time=lambda: 0.0, end_time=lambda: 1.0, value=lambda t: rows[int(t > 0.3)][:, None])
    with refused(ConfigurationError, "jumps"):
        load_path(jump, panda)


def test_roboplan_gives_cos_and_sin_of_what_has_no_limits_and_nothing_of_what_mimics(geared):
    """Four names and four numbers, and they are not each other's: turn has two of them, and other none."""
    names = ["turn", "lean", "finger", "other"]
    turns = np.array([[3.0, 0.1, 0.2], [3.4, 0.5, 0.3]])
    positions = [np.array([np.cos(t), np.sin(t), lean, finger]) for t, lean, finger in turns]
    path = load_path(SimpleNamespace(joint_names=names, positions=positions), geared)
    assert path.rows is not None
    np.testing.assert_allclose(np.diff(path.rows, axis=0), np.diff(turns, axis=0), atol=1e-12)
    assert path.doubts == ()
    assert certify(geared, NOTHING, path, interpolation="values").certified
    plain = load_path(SimpleNamespace(joint_names=names[:3], positions=turns.tolist()), geared)
    np.testing.assert_allclose(plain.rows, turns)
    with refused(ConfigurationError, "7 numbers for 4 joints"):
        load_path(SimpleNamespace(joint_names=names, positions=np.zeros((2, 7))), geared)


def test_joints_that_do_not_fit_are_named(panda, geared, rows):
    missing = load_path(rows[:, :5], panda, joint_names=NAMES[:5])
    assert "panda_joint6" in missing.notes[0]
    assert "panda_joint7" in missing.notes[0]
    assert certify(panda, NOTHING, missing).notes[0] == missing.notes[0]
    other = load_path(rows, panda, joint_names=(*NAMES[:6], "elbow"))
    found = certify(panda, NOTHING, other)
    assert found.verdict is Verdict.UNKNOWN
    assert "elbow" in found.reason
    with refused(ConfigurationError, "elbow", "panda_joint1"):
        load_path(rows[:, :1], panda, joint_names=["elbow"])
    with refused(ConfigurationError, "panda_joint1"):
        load_path(rows[:, :2], panda, joint_names=["panda_joint1", "panda_joint1"])
    apart = load_path(
        np.array([[0.0, 0.1, 0.2, 0.3], [0.1, 0.1, 0.2, 0.2]]), geared, joint_names=["turn", "lean", "finger", "other"]
    )
    assert "other" in apart.doubts[0]  # which mimics the finger, and is not there


def test_a_base_is_placed(silvermate):
    joints = silvermate.space.to_coordinates(silvermate.home_q)[3:]
    rows = np.array([joints, joints])
    path = load_path(rows, silvermate, joint_names=silvermate.joint_names)
    assert certify(silvermate, NOTHING, path).verdict is Verdict.UNKNOWN
    placed = load_path(rows, silvermate, joint_names=silvermate.joint_names, base_at=(1.0, 0.0, 0.5))
    assert certify(silvermate, NOTHING, placed).certified
    np.testing.assert_allclose(placed.q[0], silvermate.home(x=1.0, yaw=0.5))
    driven = SimpleNamespace(
        joint_trajectory=ros(silvermate.joint_names, rows),
        multi_dof_joint_trajectory=SimpleNamespace(
            header=SimpleNamespace(frame_id="map"),
            joint_names=["world_joint"],
            points=[
                SimpleNamespace(
                    transforms=[pose(float(k), 0.0, 0.0)], time_from_start=SimpleNamespace(sec=k, nanosec=0)
                )
                for k in range(2)
            ],
        ),
    )
    np.testing.assert_allclose(load_path(driven, silvermate).q, [silvermate.home(x=x) for x in (0.0, 1.0)], atol=1e-9)


def not_found() -> list[Any]:
    """What planners hand over where they have found none."""
    return [
        None,
        (False, ros((), ()), 0.1, SimpleNamespace(val=-1)),
        SimpleNamespace(solved=False, path=VampPath(np.zeros((0, 7)))),
        SimpleNamespace(success=Tensor(np.array([False])), get_interpolated_plan=lambda: None),
        SimpleNamespace(trajectory=None, error_code=SimpleNamespace(val=99999)),
    ]


@each("k", range(5))
def test_no_path_is_no_path(panda, k):
    with refused(ConfigurationError, "none"):
        load_path(not_found()[k], panda)


@each("wrong", [5, object(), [], "nowhere.csv", {}, {"a": 1}, b"x", ["a", "b"], [[1, 2], [3]], (True,), [object()]])
def test_what_is_no_path_is_refused(panda, wrong):
    with refused(ConfigurationError):
        load_path(wrong, panda)


def test_arguments_that_do_not_fit(panda, rows):
    with refused(ConfigurationError, "2 paths"):
        load_path(np.array([rows, rows]), panda)
    with refused(ConfigurationError, "7 columns for 6 names"):
        load_path(rows, panda, joint_names=NAMES[:6])
    with refused(ConfigurationError, "joint_names"):
        load_path(ros(NAMES, rows), panda, joint_names=NAMES[::-1])
    with refused(ConfigurationError, "joint_names='abc'"):
        load_path(rows, panda, joint_names="abc")
    with refused(ConfigurationError, "load_path"):
        certify(panda, NOTHING, ros(NAMES, rows))


def test_a_path_that_is_handed_over_is_repaired(panda):
    ends = np.array([panda.home(panda_joint1=-0.9), panda.home(panda_joint1=0.9)])
    path = load_path(ends[:, ::-1], panda, joint_names=NAMES[::-1])
    post = Scene([Box((0.04, 0.04, 0.6), at=(0.3, 0.0, 0.3), name="post")])
    found = certify(panda, post, path)
    assert found.verdict is Verdict.REFUTED
    mended = repair(panda, post, path)
    assert mended.certified, mended.reason
    assert mended.moved > 0.01
    np.testing.assert_allclose(mended.strip.q[[0, -1]], ends)


def test_a_repaired_path_with_doubts_is_not_called_certified(panda, rows):
    doubted = load_path(rows, panda, joint_names=(*NAMES[:6], "elbow"))
    mended = repair(panda, NOTHING, doubted)
    assert not mended.certified
    assert "elbow" in mended.reason


def test_a_whole_turn_is_repaired_as_one(geared):
    """By (cos, sin) its ends are one configuration."""
    turns = np.array([[0.0, 0.0, 0.0], [2.0 * np.pi, 0.0, 0.0]])
    path = load_path(turns, geared, joint_names=geared.joint_names)
    strip = repair(geared, NOTHING, path).strip
    assert np.abs(strip.velocities[:, 0]).sum() == pytest.approx(2.0 * np.pi)
