"""The native kernel computes what the NumPy code computes: on random robots, in random scenes, in every part."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
import twins
from cases import each_robot, refused
from numpy.testing import assert_allclose

from elastic_strips.arrays import Array
from elastic_strips.collision import BodySet, MotionBounds, SelfProximity
from elastic_strips.native import kernel, twin
from elastic_strips.planning import HandPose, find_goals
from elastic_strips.planning.problem import Deadline
from elastic_strips.planning.tree_search import TreeSpace, search_by_trees
from elastic_strips.planning.validity import ValidityChecker
from elastic_strips.robot import Kinematics, RobotModel, load_robot
from elastic_strips.scene import Box, Scene, Sphere, Voxels
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.strip.forces import add_elastic, add_posture, add_self_repulsion
from elastic_strips.strip.solver import BandedSolver, System, project_rolling
from elastic_strips.work import SECONDS_PER

pytestmark = pytest.mark.skipif(kernel() is None, reason="the native kernel is not compiled here")


@pytest.mark.parametrize("seed", range(14))
def test_ticks_and_certificates_are_those_of_the_twin(seed: int) -> None:
    """Robots of 3 to 16 degrees of freedom and all kinds of bases, one after the other."""
    figures = twins.run(3 * seed + seed % 3, strips=2, ticks=5, motions=4)
    assert figures.different == []
    assert figures.ticks > 5
    assert figures.motions > 1


def test_the_comparison_sees_a_kernel_that_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    """A twin whose distances are a micrometre too large is found out."""
    from elastic_strips.collision import narrowphase

    exact = narrowphase.PairSolver.ask
    monkeypatch.setattr(narrowphase.PairSolver, "ask", lambda self, *given: exact(self, *given) + 1e-6)
    figures = twins.Figures()
    for seed in range(12):
        figures.add(twins.run(seed))
        if figures.different:
            break
    assert figures.different


def _systems(robot: RobotModel, n: int) -> tuple[System, System]:
    native = System(n, robot.nv)
    with twin():
        return native, System(n, robot.nv)


def _same(native: System, plain: System) -> None:
    for name in ("force", "diagonal", "upper"):
        assert_allclose(getattr(native, name), getattr(plain, name), atol=1e-12, err_msg=name)
    assert native.energies.keys() == plain.energies.keys()
    for name, energy in plain.energies.items():
        assert native.energies[name] == pytest.approx(energy, abs=1e-12, rel=1e-12), name


@each_robot
def test_a_step_is_that_of_the_twin(robot: RobotModel) -> None:
    """Springs, posture, the solve and the rolling projection."""
    rng, space, n = np.random.default_rng(5), robot.space, 12
    rows = np.cumsum(0.1 * rng.normal(size=(n, space.nv)), axis=0)
    native, plain = _systems(robot, n)
    weight, gain = rng.uniform(0.5, 2.0, space.nv), rng.uniform(0.0, 1.0, space.nv)
    gain[: space.base_nv] = 0.0
    v = space.difference(rows[:-1], rows[1:])
    with twin():
        assert_allclose(v, space.difference(rows[:-1], rows[1:]), atol=1e-13)
        assert_allclose(rows[1:], space.integrate(rows[:-1], v), atol=1e-12)
    assert_allclose(rows[1:], space.integrate(rows[:-1], v), atol=1e-12)
    node, row = np.sort(rng.integers(0, n, 40)), rng.normal(size=(40, space.nv))
    for system in (native, plain):
        add_elastic(system, space, v, weight)
        add_posture(system, space, rows, rows[0], k_p=gain)
        system.add_rows(node, row, np.linspace(0.1, 1.0, 40), np.linspace(0.0, 2.0, 40))
    _same(native, plain)
    damping = np.full(space.nv, 0.3)
    solver = BandedSolver()
    assert_allclose(solver.solve(native, damping), solver.solve(plain, damping), atol=1e-10)
    if space.planar:
        moved, left = project_rolling(space, rows)
        with twin():
            other, rest = project_rolling(space, rows)
        assert_allclose(moved, other, atol=1e-9)
        assert left == pytest.approx(rest, abs=1e-9)


@each_robot
def test_own_links_push_each_other_as_in_the_twin(robot: RobotModel) -> None:
    rng, n = np.random.default_rng(8), 40
    bodies, reach = BodySet.links(robot), 0.2
    repulsion = rng.uniform(0.3 * reach, reach, len(robot.self_pairs))
    low, high = np.maximum(robot.space.lower, -2.0), np.minimum(robot.space.upper, 2.0)
    kin = Kinematics(robot.tree, n + 3)
    kin.update(rng.uniform(low, high, (n, robot.nv)))
    proximity = SelfProximity(bodies, robot.self_pairs, MotionBounds(bodies), influence=reach, repulsion=repulsion)
    proximity.update(kin)
    native, plain = _systems(robot, n)
    for system in (native, plain):
        add_self_repulsion(system, kin, proximity, k_s=5.0)
    _same(native, plain)
    assert native.energies["self_collision"] > 0.01 or not len(robot.self_pairs)


def test_a_matrix_that_is_not_positive_is_refused(silvermate: RobotModel) -> None:
    for system in _systems(silvermate, 5):
        system.diagonal[2, 1, 1] = np.nan
        with pytest.raises(FloatingPointError):
            BandedSolver().solve(system, np.ones(silvermate.nv))


def test_the_planner_accepts_the_same_configurations(silvermate: RobotModel) -> None:
    scene, space = get_scenario("corridor", seed=0).scene, silvermate.space
    checker = ValidityChecker(silvermate, scene, margin=0.03)
    with twin():
        other = ValidityChecker(silvermate, scene, margin=0.03)
    rng = np.random.default_rng(3)
    low, high = np.maximum(space.lower, -2.5).copy(), np.minimum(space.upper, 2.5).copy()
    low[:2], high[:2] = (-1.0, -2.0), (8.0, 2.0)
    rows = rng.uniform(low, high, (600, space.nv))
    rows[::2, 3:] = space.to_coordinates(silvermate.home_q)[3:]
    accepted = [checker.at(row) for row in rows]
    assert accepted == [other.at(row) for row in rows]
    assert 50 < sum(accepted) < 550


def test_the_planner_accepts_the_same_motions() -> None:
    """What separated two shapes last, and what hit last, must not change an answer; nor must the planner's chart."""
    robot = load_robot("panda")
    rng = np.random.default_rng(5)
    low, high = robot.space.lower, robot.space.upper
    accepted = 0
    for _ in range(4):
        scene = Scene(
            [Box(rng.uniform(0.1, 0.4, 3), at=rng.uniform((-0.6, -0.7, 0.0), (0.7, 0.7, 0.9))) for _ in range(4)]
            + [Sphere(0.1, at=rng.uniform((-0.6, -0.7, 0.0), (0.7, 0.7, 0.9))), Voxels([[0.5, 0.5, 0.5]], 0.1)]
        )
        native = ValidityChecker(robot, scene, margin=0.01)
        with twin():
            plain = ValidityChecker(robot, scene, margin=0.01)
        home = robot.space.to_coordinates(robot.home_q)
        rows = np.clip(home + 0.5 * rng.normal(size=(120, robot.nv)), low, high)
        said = [native.motion(a, b, 0.1) for a, b in pairwise(rows)]
        assert said == [plain.motion(a, b, 0.1) for a, b in pairwise(rows)]
        unit = rng.uniform(0.5, 2.0, robot.nv)
        charts = native.in_chart(home, unit), plain.in_chart(home, unit)
        for a, b in pairwise((rows[:40] / unit).tolist()):
            assert charts[0](a, b, 0.1) == charts[1](a, b, 0.1)
        assert native.checks == plain.checks
        accepted += sum(said)
        with refused(ValueError, "size"):
            charts[0]([0.0], [0.0], 0.1)
    assert 20 < accepted < 460


@pytest.mark.parametrize("name", ["silvermate", "tiago"])
def test_both_say_which_rows_are_valid_and_where_the_base_is_clear(name: str) -> None:
    robot, rng = load_robot(name), np.random.default_rng(4)
    space = robot.space
    for _ in range(3):
        boxes = [Box(rng.uniform(0.1, 0.5, 3), at=rng.uniform((-1, -1, 0.1), (1, 1, 1.4))) for _ in range(6)]
        scene = Scene([*boxes, Voxels(rng.uniform(-1.0, 1.0, (9, 3)), 0.1)])
        rows = space.to_coordinates(robot.home_q) + rng.normal(scale=0.4, size=(40, space.nv))
        rows[:, 3:] = np.clip(rows[:, 3:], space.lower[3:], space.upper[3:])
        native = ValidityChecker(robot, scene, margin=0.02, self_margin=0.004)
        with twin():
            plain = ValidityChecker(robot, scene, margin=0.02, self_margin=0.004)
        for base in (False, True):
            valid = native.each(rows, base=base)
            np.testing.assert_array_equal(valid, plain.each(rows, base=base))
            assert valid.any()
            assert not valid.all()
        np.testing.assert_array_equal(native.each(rows), [native.at(row) for row in rows])
        assert (native.each(rows, base=True) >= native.each(rows)).all()


def _both_paths(robot: RobotModel, scene: Scene, ends: Array, space: TreeSpace, seed: int) -> tuple[int, int]:
    """Corners and checks of the path by trees, the same with the kernel and without; no corners where there is none."""
    native = ValidityChecker(robot, scene, margin=0.01)
    with twin():
        plain = ValidityChecker(robot, scene, margin=0.01)
    if not (native.at(ends[0]) and native.at(ends[1])):
        return 0, 0
    paths = []
    for valid in (native, plain):
        before, deadline = valid.checks, Deadline(math.inf, 6000 * SECONDS_PER["looks"])
        path = search_by_trees(valid, ends, space, seed=seed, deadline=deadline, tries=20)
        paths.append((path, valid.checks - before))
    (one, checks), (two, others) = paths
    assert checks == others
    assert (one is None) == (two is None)
    if one is None or two is None:
        return 0, checks
    np.testing.assert_array_equal(one, two)
    return len(one), checks


def test_trees_find_the_same_path() -> None:
    robot = load_robot("panda")
    rng = np.random.default_rng(11)
    space, corners = robot.space, []
    home = space.to_coordinates(robot.home_q)
    for seed in range(20):
        boxes = [Box(rng.uniform(0.1, 0.3, 3), at=rng.uniform((0.2, -0.6, 0.1), (0.7, 0.6, 0.8))) for _ in range(5)]
        ends = np.clip(home + rng.normal(size=(2, robot.nv)), space.lower, space.upper)
        scale = rng.uniform(0.3, 0.6, robot.nv)
        period = np.where(rng.random(robot.nv) < 0.3, 2.0 * np.pi, 0.0)  # as joints that turn without an end
        trees = TreeSpace(scale, space.lower * scale, space.upper * scale, period * scale, 0.6, 0.1)
        corners.append(_both_paths(robot, Scene(boxes), ends, trees, seed)[0])
    assert sum(count > 2 for count in corners) > 1


def test_two_searches_that_race_give_the_same_path_as_one_after_the_other() -> None:
    robot, boxes = load_robot("panda"), []
    for y in (-0.3, 0.3):  # two boxes that are open towards the arm and away from it
        boxes += [Box((0.3, 0.02, 0.4), at=(0.6, y + side, 0.45)) for side in (-0.17, 0.17)]
        boxes += [Box((0.3, 0.36, 0.02), at=(0.6, y, height)) for height in (0.25, 0.67)]
    scene, home, space = Scene(boxes), robot.home_q, robot.space
    goals = [HandPose("panda_hand_tcp", (0.55, y, 0.45)) for y in (-0.3, 0.3)]
    ends = space.to_coordinates(np.stack([find_goals(robot, scene, home, goal).configurations[0] for goal in goals]))
    scale = np.full(robot.nv, 0.5)
    trees = TreeSpace(scale, space.lower * scale, space.upper * scale, np.zeros(robot.nv), 0.6, 0.1)
    found = [_both_paths(robot, scene, ends, trees, seed) for seed in range(6)]
    assert sum(count > 2 and checks > 2500 for count, checks in found) > 1


def test_arrays_that_could_not_be_written_to_are_refused() -> None:
    """A copy would be written to instead, and lost."""
    module = kernel()
    assert module is not None
    strided = np.zeros((8, 6))[:, ::2]
    with pytest.raises(TypeError):
        module.project_rolling(strided, 5)
