"""A yielding motion: its clock, its velocity against finite differences, its bound against samples, copies, pickles."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.errors import SceneError
from elastic_strips.scene import Box, Keyframes, PedestrianMotion, Scene, Sphere, Twist, World

EYE = np.eye(4)
TRACK = Keyframes([0.0, 2.0, 4.0, 6.0], [[0, 0, 0], [2, 0, 0], [2, 1, 0], [2, 1, 0]])


def history(*steps: tuple[float, float], track: Keyframes = TRACK) -> PedestrianMotion:
    motion = PedestrianMotion(track)
    for t, rate in steps:
        motion.advance(t, rate)
    return motion


def test_nobody_in_the_way_is_the_track_itself():
    motion = PedestrianMotion(TRACK)
    for t in np.linspace(-1.0, 8.0, 50):
        np.testing.assert_array_equal(motion.pose(EYE, t), TRACK.pose(EYE, t))
        np.testing.assert_array_equal(motion.velocity(EYE, t)[0], TRACK.velocity(EYE, t)[0])


def test_the_clock_runs_as_it_was_told():
    motion = history((1.0, 0.5), (2.0, 0.0), (3.0, -0.5), (4.0, 1.0))
    for t, place in ((-1.0, -1.0), (0.5, 0.5), (1.5, 1.25), (2.5, 1.5), (3.5, 1.25), (4.0, 1.0), (7.0, 4.0)):
        assert motion.place(t) == pytest.approx(place)
        np.testing.assert_allclose(motion.pose(EYE, t), TRACK.pose(EYE, place), atol=1e-12)
    assert [motion.rate(t) for t in (1.0, 2.0, 3.0, 9.0)] == [0.5, 0.0, -0.5, 1.0]


def test_what_has_been_does_not_change():
    motion = history((1.0, 0.5))
    before = [motion.place(t) for t in np.linspace(-1.0, 3.0, 41)]
    motion.advance(3.0, 0.0)
    assert [motion.place(t) for t in np.linspace(-1.0, 3.0, 41)] == before
    assert motion.place(9.0) == motion.place(3.0)
    with refused(SceneError, "changed"):
        motion.advance(2.9, 1.0)
    motion.reset()
    assert motion.place(2.5) == 2.5


def test_the_velocity_is_the_derivative_of_the_place():
    motion = history((0.5, 0.7), (1.5, 0.2), (2.5, -0.4), (3.5, 0.9))
    for t in (0.2, 0.9, 1.9, 3.0, 4.2, 5.1):
        numeric = (motion.pose(EYE, t + 1e-6) - motion.pose(EYE, t - 1e-6))[:3, 3] / 2e-6
        np.testing.assert_allclose(motion.velocity(EYE, t)[0], numeric, atol=1e-6)


def test_the_bound_holds_between_samples_and_is_no_larger_than_needed(rng):
    """Of random histories: no chord is faster than the bound, and where nobody yields, it is the track's own."""
    loose = 0
    for _ in range(40):
        times = np.cumsum(rng.uniform(0.05, 0.6, 12))
        motion = history(*zip(times.tolist(), rng.uniform(-1.0, 1.0, 12).tolist(), strict=True))
        a, b = np.sort(rng.uniform(-0.5, times[-1], 2)).tolist()
        t = np.linspace(a, b, 400)
        places = np.array([motion.pose(EYE, float(x))[:3, 3] for x in t])
        fastest = np.linalg.norm(np.diff(places, axis=0), axis=1).max() / (t[1] - t[0])
        bound = motion.speed_bound(0.3, start=a, end=b)
        assert fastest <= bound + 1e-6
        loose += bound > 1.3 * fastest
    assert loose < 30
    assert PedestrianMotion(TRACK).speed_bound(0.1) == TRACK.speed_bound(0.1)
    assert history((0.5, 0.0), (1.0, 1.0)).speed_bound(0.1, start=0.6, end=0.9) == 0.0


def test_the_bound_of_the_future_holds_whatever_is_decided():
    motion = history((0.5, 0.0))
    promised = motion.speed_bound(0.0, start=1.0, end=2.0)
    motion.advance(1.5, 1.0)
    assert np.linalg.norm(motion.velocity(EYE, 1.6)[0]) == 1.0 <= promised


def test_copies_of_a_world_go_their_own_ways():
    world = World(Scene([Box((1, 1, 1), at=(9, 0, 0)), Sphere(0.2, name="who", motion=history((1.0, 0.0)))]))
    kept, afresh = world.copied(), world.copied(history=False)
    for other in (kept, pickle.loads(pickle.dumps(world))):
        for t in (0.3, 1.0, 4.0):
            np.testing.assert_array_equal(other.at(t).obstacle("who").pose, world.scene.obstacle("who").at(t).pose)
    motion = world.scene.obstacle("who").motion
    assert isinstance(motion, PedestrianMotion)
    motion.advance(5.0, 1.0)
    assert kept.scene.obstacle("who").at(6.0).pose[0, 3] == pytest.approx(1.0)
    assert world.scene.obstacle("who").at(6.0).pose[0, 3] == pytest.approx(2.0)
    assert afresh.scene.obstacle("who").at(2.0).pose[0, 3] == pytest.approx(2.0)
    still = World(Scene([Sphere(0.2)]))
    assert still.copied() is still


@each(
    "make, message",
    [
        (lambda: PedestrianMotion(Twist()), "needs Keyframes"),  # type: ignore[arg-type]
        (lambda: PedestrianMotion(Keyframes([0, 1], [[0, 0, 0], [1, 0, 0]], loop=True)), "jumps"),
        (lambda: PedestrianMotion(TRACK, 0.0), "positive"),
        (lambda: history((1.0, 1.1)), "must lie in"),
        (lambda: PedestrianMotion(TRACK).speed_bound(0.1, start=2.0, end=1.0), "start <= end"),
    ],
)
def test_wrong_arguments_are_refused(make, message):
    with pytest.raises(SceneError, match=message):
        make()
