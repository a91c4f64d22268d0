"""The moving corridor keeps its promises: where movers appear, how they move, and that they go."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cases import each

from elastic_strips.errors import ScenarioError
from elastic_strips.io import read_world, write_world
from elastic_strips.planning import plan_report
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Keyframes, Obstacle
from elastic_strips.sim.scenarios import Scenario, corridor_scene, get_scenario, moving_corridor
from elastic_strips.sim.scenarios.corridors import (
    APPEAR_DISTANCE,
    CORRIDOR_LENGTH,
    HALF_WIDTH,
    KEYFRAME_PERIOD,
    MOVER_ACCELERATION,
    MOVER_SPEEDS,
    MOVERS_GONE_TIME,
    REACTION_TIME,
    corridor_guide,
)

Make = Callable[[int], Scenario]
VARIANTS: dict[str, Make] = {
    "drawn": moving_corridor,
    "slow": lambda seed: moving_corridor(seed, count=8, speed=(0.2, 0.2)),
    "fast": lambda seed: moving_corridor(seed, count=8, speed=(1.5, 1.5)),
    "one": lambda seed: moving_corridor(seed, count=1),
}
SEEDS = range(12)


@pytest.fixture(scope="module", params=VARIANTS)
def problems(request: pytest.FixtureRequest) -> list[Scenario]:
    """Each variant, with all seeds."""
    return [VARIANTS[request.param](seed) for seed in SEEDS]


def _movers(problem: Scenario) -> list[tuple[Obstacle, Keyframes, float, float]]:
    """Each mover with its motion, and the times [s] at which it appears and vanishes."""
    world = problem.world
    found = []
    for name in world.names_moving:
        obstacle = world.scene.obstacle(name)
        assert isinstance(obstacle.motion, Keyframes)
        found.append((obstacle, obstacle.motion, world.appears.get(name, 0.0), world.vanishes[name]))
    return found


def _radius(obstacle: Obstacle) -> float:
    """Radius [m] of a circle about the origin that holds the obstacle seen from above."""
    if obstacle.shape == "box":
        return 0.5 * float(np.hypot(*obstacle.spec["size"][:2]))
    return float(obstacle.spec["radius"])


def test_speeds_and_accelerations_are_bounded(problems: list[Scenario]) -> None:
    """Between keyframes 0.1 s apart; and the speed class is the bound of all movers, of which one comes near it."""
    for problem in problems:
        assert problem.speed_class is not None
        assert MOVER_SPEEDS[0] <= problem.speed_class <= MOVER_SPEEDS[1]
        fastest = 0.0
        for _, motion, appears, vanishes in _movers(problem):
            np.testing.assert_allclose(np.diff(motion.times), KEYFRAME_PERIOD, atol=1e-9)
            velocity = np.diff(motion.positions, axis=0) / KEYFRAME_PERIOD
            speed = np.linalg.norm(velocity, axis=1)
            change = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / KEYFRAME_PERIOD
            assert change.max() <= MOVER_ACCELERATION + 1e-9
            assert speed.max() <= problem.speed_class + 1e-9
            assert np.ptp(motion.positions[:, 2]) == 0.0
            assert appears == pytest.approx(motion.times[0])  # it never stands still because its keyframes are over
            assert vanishes == pytest.approx(motion.times[-1])
            fastest = max(fastest, float(speed.max()))
        assert fastest >= 0.35 * problem.speed_class
        assert problem.world.speed_bound() == pytest.approx(fastest)


def test_nothing_appears_near_where_the_robot_can_be(problems: list[Scenario]) -> None:
    """From the beginning: far from the start. Later: as far from the whole corridor. The goal stays free too."""
    for problem in problems:
        for obstacle, motion, appears, _ in _movers(problem):
            x, y = motion.positions[0, :2]
            speed = np.linalg.norm(np.diff(motion.positions, axis=0), axis=1).max() / KEYFRAME_PERIOD
            apart = APPEAR_DISTANCE + REACTION_TIME * speed + _radius(obstacle)
            if appears == 0.0:
                assert np.hypot(x, y) >= apart - 1e-9
                assert np.hypot(x - CORRIDOR_LENGTH, y) >= 1.0 + _radius(obstacle)
            else:
                corner = np.clip((x, y), (-1.5, -HALF_WIDTH), (CORRIDOR_LENGTH + 1.5, HALF_WIDTH))
                assert np.hypot(x - corner[0], y - corner[1]) >= apart - 1e-9


def test_every_mover_comes_in_and_goes_out_again(problems: list[Scenario]) -> None:
    """So a robot that waits can pass in the end: nobody stays in the corridor, at its goal least of all."""
    for problem in problems:
        inside = 0
        for obstacle, motion, _, vanishes in _movers(problem):
            places = motion.positions[:, :2]
            inside += bool(((np.abs(places[:, 1]) < HALF_WIDTH) & (places[:, 0] > -1.5) & (places[:, 0] < 9.5)).any())
            assert vanishes <= MOVERS_GONE_TIME
            x, y = places[-1]
            assert max(abs(y) - HALF_WIDTH, -1.5 - x, x - CORRIDOR_LENGTH - 1.5) > _radius(obstacle)
        assert inside == len(problem.world.names_moving)
        assert problem.world.at(MOVERS_GONE_TIME).names == corridor_scene(problem.seed).names


def test_a_third_aims_at_where_the_robot_will_be(problems: list[Scenario]) -> None:
    """They come within half a metre of a robot that advances along the free way at 0.6 m/s in x."""
    for problem in problems:
        names = problem.world.names_moving
        aimed = [n for n in names if n.startswith(("crossing-", "head-on-"))]
        assert len(aimed) == max(1, round(len(names) / 3))
        guide = corridor_guide(problem.seed)
        for name in aimed:
            times = np.arange(0.0, 0.98 * CORRIDOR_LENGTH / 0.6, 0.05)
            robot = np.column_stack((0.6 * times, np.interp(0.6 * times, guide[:, 0], guide[:, 1])))
            there = [problem.world.exists(name, t) for t in times]
            places = np.array([problem.world.scene.obstacle(name).at(t).pose[:2, 3] for t in times])
            assert np.linalg.norm(places - robot, axis=1)[there].min() < 0.75


def test_the_seed_decides(tmp_path: Path) -> None:
    """The same seed gives the same world, another one another; the clutter is that of the corridor of that seed."""
    texts = []
    for k, seed in enumerate((3, 3, 4)):
        problem = get_scenario("moving-corridor", seed=seed)
        write_world(problem.world, tmp_path / f"{k}.yaml")
        texts.append((tmp_path / f"{k}.yaml").read_text(encoding="utf-8"))
        names = corridor_scene(seed).names
        assert problem.world.scene.names[: len(names)] == names
        assert set(problem.scene.names) == set(problem.world.at(0.0).names)
    assert texts[0] == texts[1] != texts[2]
    back = read_world(tmp_path / "2.yaml")
    assert back.at(7.3).names == problem.world.at(7.3).names


def test_kinds_and_numbers_vary() -> None:
    """Over many seeds: all counts, kinds, roles; some there from the beginning, some later; some hang above a base."""
    problems = [moving_corridor(seed) for seed in range(60)]
    assert {len(p.world.names_moving) for p in problems} == set(range(1, 9))
    names = [re.sub(r"-\d+$", "", name) for p in problems for name in p.world.names_moving]
    assert {n.split("-")[-1] for n in names} == {"person", "cart", "ball", "load"}
    assert {n.rsplit("-", 1)[0] for n in names if "-" in n} == {"crossing", "head-on"}
    late = [name in p.world.appears for p in problems for name in p.world.names_moving]
    assert 0.3 < np.mean(late) < 0.7
    for p in problems:
        for obstacle, motion, *_ in _movers(p):
            if "load" in str(obstacle.name):
                assert motion.positions[0, 2] - obstacle.spec["size"][2] / 2 > 0.8


@pytest.mark.parametrize("seed", range(4))
def test_the_beginning_can_be_planned(seed: int, silvermate: RobotModel) -> None:
    """What is there at time 0 leaves a way to the goal."""
    problem = moving_corridor(seed, count=8)
    report = plan_report(silvermate, problem.scene, *problem.ends(silvermate), seed=seed)
    assert report.certified, report.reason


BAD = [
    (lambda: moving_corridor(-1), "seed=-1 must be an integer"),
    (lambda: moving_corridor(True), "seed=True"),
    (lambda: moving_corridor(0, count=0), "count=0 must be an integer from 1 to 8"),
    (lambda: moving_corridor(0, count=9), "count=9"),
    (lambda: moving_corridor(0, count=2.5), r"count=2\.5"),
    (lambda: moving_corridor(0, speed=(0.1, 1.0)), r"speed=\(0\.1, 1\.0\) must be a range"),
    (lambda: moving_corridor(0, speed=(1.0, 0.5)), "must be a range"),
    (lambda: moving_corridor(0, speed=(1.0, 1.6)), "must be a range"),
    (lambda: moving_corridor(0, speed=(1.0, float("nan"))), "must be finite"),
    (lambda: moving_corridor(0, speed=1.0), "shape"),
]


@each("make, message", BAD)
def test_wrong_arguments_are_refused(make: Callable[[], Scenario], message: str) -> None:
    with pytest.raises(ScenarioError, match=f"moving-corridor: .*{message}"):
        make()
