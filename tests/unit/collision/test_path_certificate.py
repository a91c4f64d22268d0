"""certify: its verdict against dense sampling by brute force; what refutes a path is shown; wrong input is named."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from brute_force import link_distances, self_distances
from cases import each, refused

from elastic_strips.collision import Verdict, certify
from elastic_strips.errors import ConfigurationError, ParameterError, SceneError
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Cylinder, Scene, Sphere, Twist, World
from elastic_strips.strip import Strip


@pytest.fixture(scope="module")
def panda() -> RobotModel:
    return load_robot("panda")


def _shelf(rng: np.random.Generator) -> Scene:
    def at(low, high):
        return rng.uniform(low, high)

    return Scene(
        [
            *(
                Box(at(0.1, 0.4) * np.ones(3), at=at((-0.6, -0.7, 0.1), (0.7, 0.7, 0.9)), name=f"b{k}")
                for k in range(3)
            ),
            *(Sphere(at(0.05, 0.15), at=at((-0.7, -0.7, 0.2), (0.7, 0.7, 1.0)), name=f"s{k}") for k in range(2)),
            Cylinder(0.06, 0.8, at=at((-0.7, -0.7, 0.2), (0.7, 0.7, 0.8)), name="c"),
        ]
    )


def _least(robot: RobotModel, scene: Scene, rows: np.ndarray, interpolate, itself: bool = True) -> float:
    """The smallest distance along a path, at very many configurations on it, by Pinocchio and Coal alone."""
    least = np.inf
    for a, b in pairwise(rows):
        for t in np.linspace(0.0, 1.0, 81):
            q = robot.space.from_coordinates(interpolate(a, b, t))
            least = min(least, link_distances(robot, scene, q).min())
            least = min(least, self_distances(robot, q).min()) if itself else least
    return float(least)


@pytest.mark.parametrize("seed", range(3))
def test_the_verdict_is_that_of_dense_sampling(panda, seed):
    rng = np.random.default_rng(seed)
    low, high = panda.space.lower, panda.space.upper
    for _ in range(4):
        scene = _shelf(rng)
        first = rng.uniform(0.8 * low + 0.2 * high, 0.2 * low + 0.8 * high)
        rows = np.clip(first + np.cumsum(rng.normal(0.0, 0.25, (4, panda.nv)), axis=0), low, high)
        found = certify(panda, scene, panda.space.from_coordinates(rows))
        truth = _least(panda, scene, rows, lambda a, b, t: a + t * (b - a))
        if found.certified:
            assert truth > 0.0
        elif truth > 5e-3:
            pytest.fail(f"a path with {truth:.4f} m of room is {found}")
        if found.verdict is Verdict.REFUTED:
            assert min(link_distances(panda, scene, found.q).min(), self_distances(panda, found.q).min()) <= 1e-6
            assert found.segments
            assert 0.0 <= found.place <= 1.0


def test_what_lies_between_waypoints_is_seen(panda):
    """Both ends are free, and all waypoints a planner may look at; a thin plate stands between them."""
    a, b = panda.home(panda_joint1=-1.0), panda.home(panda_joint1=1.0)
    plate = Scene([Box((0.6, 0.004, 0.6), at=(0.5, 0.0, 0.5), name="plate")])
    found = certify(panda, plate, [a, b])
    assert found.verdict is Verdict.REFUTED
    assert "plate" in found.reason
    assert found.broken.obstacle == "plate"
    assert found.distance < 0.0
    assert link_distances(panda, plate, found.q).min() == pytest.approx(found.distance, abs=1e-4)
    assert certify(panda, plate, [a, panda.home(panda_joint1=-0.85)]).certified


def test_the_clearance_is_proven_and_measured(panda):
    a, b = panda.home(panda_joint1=-0.6), panda.home(panda_joint1=0.6)
    scene = Scene([Box((0.1, 2.0, 0.1), at=(0.9, 0.0, 0.6), name="bar")])
    free = certify(panda, scene, [a, b])
    assert free.certified
    assert free.least > 0.02
    assert certify(panda, scene, [a, b], clearance=free.least - 1e-3).certified
    tight = certify(panda, scene, [a, b], clearance=free.least + 2e-3)
    assert tight.verdict is Verdict.REFUTED
    assert tight.distance == pytest.approx(free.least, abs=2e-3)
    assert certify(panda, scene, [a, b], measure=False).least is None


def test_a_strip_and_an_array_are_alike(silvermate):
    scene = Scene([Box((0.4, 0.4, 1.0), at=(2.0, 1.2, 0.5))])
    strip = Strip(silvermate, [silvermate.home(), silvermate.home(x=2.0), silvermate.home(x=4.0)])
    assert certify(silvermate, scene, strip).least == certify(silvermate, scene, strip.q).least


@each("seed", range(4))
def test_lines_of_a_base_are_not_its_arcs(seed):
    """x, y and yaw that go linearly: sampled so, by brute force; arcs of the same configurations go elsewhere."""
    robot = load_robot("silvermate", base="omni")
    rng = np.random.default_rng(seed)
    rows = np.tile(robot.space.to_coordinates(robot.home_q), (3, 1))
    rows[:, :3] = [[0.0, 0.0, 0.0], [2.0, 0.0, 2.2], [3.0, 1.0, 0.5]]
    scene = Scene([Sphere(0.2, at=(*rng.uniform((0.0, -1.2), (3.0, 1.4)), 0.5), name=f"s{k}") for k in range(2)])
    found = certify(robot, scene, robot.space.from_coordinates(rows), interpolation="line")
    truth = _least(robot, scene, rows, lambda a, b, t: a + t * (b - a), itself=False)
    assert found.certified == (truth > 1e-3) or abs(truth) < 1e-3
    if found.certified:
        assert found.least == pytest.approx(truth, abs=6e-3)  # the samples miss the nearest place by a little
        assert found.least <= truth + 2e-4


def test_a_timed_path_meets_what_moves(silvermate):
    """A ball crosses the way: it is met by who drives at once, and has gone for who waits."""
    ball = Sphere(0.3, at=(2.0, -2.0, 0.5), name="ball", motion=Twist(linear=(0.0, 1.0, 0.0)))
    world, q = World(Scene([ball])), np.array([silvermate.home(), silvermate.home(x=4.0)])
    met = certify(silvermate, world, q, times=[0.0, 4.0])
    assert met.verdict is Verdict.REFUTED
    assert met.broken.obstacle == "ball"
    assert 1.0 < met.time < 3.0
    assert link_distances(silvermate, world.at(met.time), met.q).min() <= 1e-6
    assert certify(silvermate, world, q, times=[6.0, 10.0]).certified
    slow = certify(silvermate, world, [q[0], q[0], q[1]], times=[0.0, 5.0, 9.0])
    assert slow.certified
    with refused(ParameterError, "times="):
        certify(silvermate, world, q)


def test_half_a_turn_is_unknown(silvermate):
    found = certify(silvermate, Scene([]), [silvermate.home(), silvermate.home(x=1.0, yaw=np.pi)])
    assert found.verdict is Verdict.UNKNOWN
    assert "half a turn" in found.reason


def test_wrong_input_is_named(panda, silvermate):
    home = panda.home()
    with refused(ConfigurationError, "configurations"):
        certify(panda, Scene([]), [home])
    with refused(ConfigurationError, "path"):
        certify(panda, Scene([]), [home[:-1], home[:-1]])
    with refused(ParameterError, "interpolation"):
        certify(panda, Scene([]), [home, home], interpolation="spline")
    with refused(ParameterError, "times"):
        certify(panda, Scene([]), [home, home], times=[1.0, 0.0])
    with refused(ParameterError, "clearance"):
        certify(panda, Scene([]), [home, home], clearance=-1.0)
    with refused(SceneError, "Scene"):
        certify(panda, [Box((1, 1, 1))], [home, home])
    outside = home.copy()
    outside[0] = 99.0
    with refused(ConfigurationError, "panda_joint1"):
        certify(panda, Scene([]), [home, outside])
