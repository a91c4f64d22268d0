"""The courteous corridor: the movers of the moving corridor, who stop for a robot that stands."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from elastic_strips.control.params import ObstacleAssumptions
from elastic_strips.io import read_record, write_record
from elastic_strips.scene import Keyframes, Obstacle, PedestrianMotion
from elastic_strips.sim.scenarios import DriveOutcome, drive_scenario, get_scenario, moving_corridor
from elastic_strips.sim.scenarios.corridors import (
    CORRIDOR_LENGTH,
    COURTEOUS_SPEEDS,
    HALF_WIDTH,
    MOVER_ACCELERATION,
    YIELDING_ACCELERATION,
)

SEED = 3
"""Somebody crosses there, finds the robot in the way, and waits."""


def _movers(world) -> list[tuple[Obstacle, PedestrianMotion]]:
    return [(o, o.motion) for o in world.scene if isinstance(o.motion, PedestrianMotion)]


def _acceleration(places: np.ndarray, step: float, span: int) -> float:
    velocity = np.diff(places, axis=0) / step
    return float(np.linalg.norm(velocity[span:] - velocity[:-span], axis=1).max() / (span * step))


@pytest.fixture(scope="module")
def outcome() -> DriveOutcome:
    return drive_scenario(get_scenario("courteous-corridor", seed=SEED))


def test_the_movers_are_those_of_the_moving_corridor() -> None:
    """Of that speed, if nobody stands in their way; to a millimetre, as their tracks are smooth."""
    for seed in range(8):
        plain, courteous = (
            moving_corridor(seed, speed=COURTEOUS_SPEEDS).world,
            get_scenario("courteous-corridor", seed=seed).world,
        )
        assert plain.scene.names == courteous.scene.names
        assert plain.appears == courteous.appears
        assert not courteous.vanishes
        for obstacle, _ in _movers(courteous):
            name = obstacle.name or ""
            other = plain.scene.obstacle(name)
            for t in np.arange(plain.appears.get(name, 0.0), plain.vanishes[name] - 0.1, 0.33):
                assert np.abs(obstacle.at(float(t)).pose - other.at(float(t)).pose).max() < 1e-3


def test_tracks_are_smooth_and_end_at_rest_outside() -> None:
    for seed in range(8):
        for obstacle, motion in _movers(get_scenario("courteous-corridor", seed=seed).world):
            track = motion.track
            assert isinstance(track, Keyframes)
            step = float(track.times[1] - track.times[0])
            assert _acceleration(track.positions, step, 1) <= MOVER_ACCELERATION + 1e-6
            last = np.linalg.norm(track.positions[-1] - track.positions[-2]) / step
            assert last <= MOVER_ACCELERATION * step + 1e-9
            x, y = track.positions[-1, :2]
            assert (
                max(abs(y) - HALF_WIDTH, -1.5 - x, x - CORRIDOR_LENGTH - 1.5)
                > 0.5 * obstacle.parts[0].half_extents[:2].max()
            )


def test_each_world_is_a_fresh_one() -> None:
    scenario = get_scenario("courteous-corridor", seed=SEED)
    for _, motion in _movers(scenario.world):
        motion.advance(1.0, 0.0)
    for _, motion in _movers(scenario.world):
        assert motion.place(5.0) == 5.0
    assert get_scenario("moving-corridor", seed=SEED).world.vanishes


def test_somebody_waits_and_nobody_is_run_over(outcome: DriveOutcome) -> None:
    """And all keep to the acceleration that the robot reckons with, in what they really did."""
    assert outcome.reached, outcome.result.reason
    assert not outcome.evaluation.contacts
    time = outcome.result.record.control.time
    world, late = outcome.result.record.world, 0.0
    for obstacle, motion in _movers(world):
        t = time[time >= world.appears.get(obstacle.name or "", 0.0)]
        places = np.array([obstacle.at(float(x)).pose[:3, 3] for x in t])
        assert _acceleration(places, 0.01, 10) <= ObstacleAssumptions().acceleration
        late = max(late, float(time[-1]) - motion.place(float(time[-1])))
    assert late > 1.0
    assert ObstacleAssumptions().acceleration > YIELDING_ACCELERATION


def test_equal_seeds_give_equal_runs(outcome: DriveOutcome) -> None:
    again = drive_scenario(get_scenario("courteous-corridor", seed=SEED), time_limit=6.0)
    one, two = outcome.result.record, again.result.record
    time = two.control.time[two.control.time < 6.0]
    assert len(time) > 100
    np.testing.assert_array_equal(one.control.coordinates[: len(time)], two.control.coordinates[: len(time)])
    for (_, a), (_, b) in zip(_movers(one.world), _movers(two.world), strict=True):
        assert [a.place(t) for t in time[::50]] == [b.place(t) for t in time[::50]]


def test_a_record_that_is_read_back_replays_what_they_did(outcome: DriveOutcome, tmp_path) -> None:
    record = outcome.result.record
    write_record(record, tmp_path / "run.npz")
    back = read_record(tmp_path / "run.npz")
    for obstacle, _ in _movers(record.world):
        for a, b in pairwise(record.control.time[::100]):
            t = float(0.5 * (a + b))
            there = back.world.scene.obstacle(obstacle.name or "").at(t).pose
            np.testing.assert_allclose(there, obstacle.at(t).pose, atol=1e-3)
