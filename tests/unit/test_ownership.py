"""Workspaces are for one thread at a time: a second one is turned away, and the first one's answers stay right."""

from __future__ import annotations

import inspect
import json
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from importlib import import_module
from pkgutil import walk_packages
from threading import Event

import numpy as np
import pytest

from elastic_strips import collision, planning
from elastic_strips import robot as robots
from elastic_strips import strip as strips
from elastic_strips import trajectory as trajectories
from elastic_strips.collision import BodySet, MotionBounds, ObstacleProximity, SelfProximity
from elastic_strips.collision.bounds import Displacement
from elastic_strips.collision.motion_certificate import MotionCertifier
from elastic_strips.collision.narrowphase import Narrowphase
from elastic_strips.collision.strip_certificate import Certifier
from elastic_strips.control import EvasionParams
from elastic_strips.control.evasion import EvasivePlanner
from elastic_strips.errors import ElasticStripsError, ThreadError
from elastic_strips.native import twin
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.planning import straight_line
from elastic_strips.planning.homotopy.strip_set import StripSet
from elastic_strips.planning.keeper import StripKeeper
from elastic_strips.planning.validity import SatisfyingChecker, ValidityChecker
from elastic_strips.robot import Kinematics, PlanarFootprint, RobotModel
from elastic_strips.robot.inverse_kinematics import PoseSearch, PoseSolver, PoseTarget
from elastic_strips.scene import Box, Scene
from elastic_strips.strip import Deformer, OrientationConstraint, Strip
from elastic_strips.strip.constraint import ConstraintForce
from elastic_strips.strip.paper import PaperDeformer
from elastic_strips.trajectory import MotionLimits
from elastic_strips.trajectory.trajectory import TrajectoryCertifier

_HAMMER = """
import json, sys
from collections import Counter
from threading import Barrier, Thread
from elastic_strips.errors import ThreadError
from elastic_strips.native import kernel
from elastic_strips.planning import straight_line
from elastic_strips.robot import load_robot
from elastic_strips.scene import Box, Scene
from elastic_strips.strip import Deformer, Strip

robot = load_robot("silvermate")
deformer, said, begin = Deformer(robot), Counter(), Barrier(3)

def line(spacing):
    rows = straight_line(robot, robot.home(), robot.home(x=4.0), spacing=spacing)
    return Strip.from_coordinates(robot, rows)

def ask(name, strip, scene, step):
    begin.wait()
    for _ in range(150):
        try:
            answer = deformer.step(strip, scene) if step else deformer.certify(strip, scene)
            said[f"{name} {answer.certified}"] += 1
        except ThreadError:
            said["refused"] += 1

beside, across = (Scene([Box((0.4, 0.4, 1.0), at=(2.0, y, 0.5))]) for y in (3.0, 0.0))
threads = [Thread(target=ask, args=a) for a in (
    ("beside", line(0.5), beside, False), ("across", line(0.05), across, False), ("beside", line(0.2), beside, True))]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
after = deformer.certify(line(0.05), across).certified
print(json.dumps([said, after]))
"""


@pytest.mark.parametrize("native", ["0", "1"])
def test_threads_that_hammer_one_deformer_are_refused_and_told_nothing_false(native: str) -> None:
    """In a process of its own: it ended in false certificates and a segmentation fault."""
    ended = subprocess.run(
        [sys.executable, "-c", _HAMMER], capture_output=True, text=True, timeout=600,
        env={**os.environ, "ELASTIC_STRIPS_NATIVE": native},
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr[-2000:]
    said, after = json.loads(ended.stdout.splitlines()[-1])
    assert set(said) <= {"beside True", "across False", "refused"}, said
    assert said.get("refused", 0) > 0, "the threads have never met"
    assert said.get("beside True", 0) + said.get("across False", 0) > 0
    assert after is False


@pytest.fixture
def strip(silvermate: RobotModel) -> Strip:
    rows = straight_line(silvermate, silvermate.home(), silvermate.home(x=2.0), spacing=0.2)
    return Strip.from_coordinates(silvermate, rows)


@pytest.mark.parametrize("kind", [Deformer, PaperDeformer])
def test_another_thread_is_refused_while_one_settles_and_may_go_on_then(silvermate, strip, kind) -> None:
    deformer, scene = kind(silvermate), Scene([Box((0.4, 0.4, 1.0), at=(1.0, 0.8, 0.5), name="box")])
    wanted = kind(silvermate).settle(strip, scene, max_ticks=3)
    inside, done = Event(), Event()

    def watch(_: object) -> None:
        inside.set()
        assert done.wait(60.0)

    with ThreadPoolExecutor(1) as pool:
        settled = pool.submit(deformer.settle, strip, scene, max_ticks=3, watch=watch)
        assert inside.wait(60.0)
        for ask in (deformer.step, deformer.certify, deformer.assess, deformer.settle):
            with pytest.raises(ThreadError, match=kind.__name__):
                ask(strip, scene)
        with pytest.raises(ThreadError):
            deformer.reset()
        done.set()
        report = settled.result()
    np.testing.assert_array_equal(report.strip.q, wanted.strip.q)
    assert report.certificate.certified == wanted.certificate.certified
    assert deformer.certify(report.strip, scene).certified == wanted.certificate.certified  # handed on: this thread's


def test_who_is_inside_may_ask_again(silvermate: RobotModel, strip: Strip) -> None:
    deformer, scene, said = Deformer(silvermate), Scene(), []
    deformer.settle(strip, scene, max_ticks=2, watch=lambda r: said.append(deformer.certify(r.strip, scene).certified))
    assert said
    assert all(said)


def _workspaces(robot: RobotModel) -> list[OneThread]:
    bodies = BodySet.links(robot)
    bounds = MotionBounds(bodies)
    obstacles = ObstacleProximity(bodies, influence=0.3)
    own = SelfProximity(bodies, robot.self_pairs, bounds, influence=0.1)
    level = ConstraintForce(robot, OrientationConstraint.from_configuration(robot, robot.home(), "hand_frame"))
    rng = np.random.default_rng(0)
    strip = Strip(robot, np.array([robot.home(), robot.home(x=1.0)]))
    return [
        Deformer(robot), PaperDeformer(robot), Kinematics(robot.tree), Narrowphase(bodies), obstacles, own,
        Certifier(bodies, bounds, obstacles, own), MotionCertifier(bodies, bounds, robot.self_pairs),
        TrajectoryCertifier(robot, clearance=0.05, self_clearance=0.01), StripSet(robot, robot.home(x=2.0)),
        Deformer(robot).workspace, ValidityChecker(robot, Scene(), margin=0.0),
        SatisfyingChecker(ValidityChecker(robot, Scene(), margin=0.0), level), level, Displacement(robot),
        PlanarFootprint(robot), PoseSolver(robot, "hand_frame"),
        PoseSearch(robot, [PoseTarget("hand_frame", np.ones(3), None, np.zeros(3))], near=None, rng=rng),
        EvasivePlanner(robot, MotionLimits.for_robot(robot), EvasionParams(), dt=0.1, hold=0.1),
        StripKeeper(robot, Scene(), strip, params=None, period=0.05),
    ]  # fmt: skip


@contextmanager
def _another_inside(workspace: OneThread) -> Iterator[None]:
    """Another thread is inside a workspace meanwhile."""
    inside, done = Event(), Event()

    def stay(_: OneThread) -> None:
        inside.set()
        assert done.wait(60.0)

    with ThreadPoolExecutor(1) as pool:
        staying = pool.submit(exclusive(stay), workspace)
        assert inside.wait(60.0)
        try:
            yield
        finally:
            done.set()
        staying.result()


def test_every_workspace_turns_a_second_thread_away(silvermate: RobotModel) -> None:
    for workspace in _workspaces(silvermate):
        names = {
            name for kind in type(workspace).__mro__ for name, method in vars(kind).items()
            if getattr(method, "__code__", None) is _ALONE
        }  # fmt: skip
        assert names, type(workspace).__name__
        with _another_inside(workspace):
            for name in sorted(names):
                method: Callable[..., object] = getattr(workspace, name)
                with pytest.raises(ThreadError, match=f"{type(workspace).__name__}.{name}"):
                    method()


_PARTS = {
    *("MovingParts", "PairSolver", "Bisection", "_Tools", "SampledPostures", "_Work", "AlternativesSearch", "Settler"),
    *("NativeNarrowphase", "NativeSelfPairs"),
}
"""They live in a guarded workspace, or within one call."""


def test_no_workspace_of_the_kernel_s_rooms_is_left_open() -> None:
    found = {
        name: kind
        for room in (collision, planning, robots, strips, trajectories)
        for _, module, _ in walk_packages(room.__path__, f"{room.__name__}.")
        for name, kind in vars(import_module(module)).items()
        if inspect.isclass(kind) and kind.__module__ == module and (kind.__doc__ or "").startswith("Workspace")
    }
    assert {"ValidityChecker", "Certifier", "Kinematics", "PlanarFootprint", *_PARTS} <= set(found)
    assert {name for name, kind in found.items() if not issubclass(kind, OneThread)} == _PARTS


def test_a_deformer_s_nodes_are_not_replaced_from_without_while_it_deforms(silvermate: RobotModel) -> None:
    """Between two of its parts nobody is inside of any, and what is certified would be the other thread's nodes."""
    deformer, rows = Deformer(silvermate), silvermate.space.to_coordinates(silvermate.home_q)[None]
    for one, other in ((deformer, deformer.workspace), (deformer.workspace, deformer)):
        with _another_inside(one), pytest.raises(ThreadError):
            other.reset()
    with _another_inside(deformer), pytest.raises(ThreadError):
        deformer.workspace.replace(rows, Scene())
    deformer.workspace.replace(rows, Scene())


@pytest.mark.parametrize("native", [True, False])
def test_each_chart_of_a_checker_stays_its_own(silvermate: RobotModel, native: bool) -> None:
    """A second one, another thread's perhaps, had taken the first one's place: a motion was asked of elsewhere."""
    scene = Scene([Box((0.4, 0.4, 1.0), at=(2.0, 0.0, 0.5))])
    with nullcontext() if native else twin():
        checker = ValidityChecker(silvermate, scene, margin=0.0)
    rows = [silvermate.space.to_coordinates(silvermate.home(x=x)[None])[0] for x in (0.0, 2.0)]
    unit = np.ones(len(silvermate.joint_names))
    free, blocked = (checker.in_chart(row, unit) for row in rows)
    state = rows[0][-len(unit) :].tolist()
    for _ in range(2):
        assert free(state, state, 0.05)
        assert not blocked(state, state, 0.05)


class _Counter(OneThread):
    @exclusive
    def fail(self) -> None:
        raise KeyError("as it may be")


_ALONE = _Counter.fail.__code__


def test_who_fails_inside_is_out_again() -> None:
    counter = _Counter()
    with pytest.raises(KeyError):
        counter.fail()
    with ThreadPoolExecutor(1) as pool, pytest.raises(KeyError):
        pool.submit(counter.fail).result()


def test_it_is_one_of_the_library_s_errors_and_no_fault_of_the_input() -> None:
    assert issubclass(ThreadError, ElasticStripsError)
    assert issubclass(ThreadError, RuntimeError)
    assert not issubclass(ThreadError, ValueError)


def test_a_copy_is_a_workspace_of_its_own(silvermate: RobotModel) -> None:
    with twin():
        kin = Kinematics(silvermate.tree, 4)
    rows = silvermate.space.to_coordinates(silvermate.home_q)[None]
    copy = pickle.loads(pickle.dumps(kin))
    with _another_inside(kin):
        copy.update(rows)
        with pytest.raises(ThreadError):
            kin.update(rows)
    kin.update(rows)
