"""Motion watch: what moves otherwise than its scene says counts as of unknown motion; what is only noisy does not."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from cases import each

from elastic_strips.control.monitor import SceneMonitor
from elastic_strips.control.motion_watch import MotionWatch
from elastic_strips.control.params import MonitorParams, ObstacleAssumptions
from elastic_strips.scene import Box, Cylinder, Motion, Obstacle, Scene, Twist, UnknownMotion

DT = 0.05
ASSUMED = ObstacleAssumptions()
ROOM = [Box((0.4, 0.4, 1.0), at=(0.7 * k, 3.0, 0.5), name=f"crate {k}") for k in range(5)]
Seen = Callable[[float], Iterable[Obstacle]]


def watch(seen: Seen, seconds: float = 3.0, begin: float = 0.0, watcher: MotionWatch | None = None):
    """What is said, with its time, and the last scene."""
    watcher = MotionWatch(MonitorParams(), ASSUMED) if watcher is None else watcher
    said, checked = [], Scene([])
    for k in range(round(seconds / DT)):
        t = begin + k * DT
        scene = Scene([o.moved(o.pose, time=t) for o in (*ROOM, *seen(t))], time=t)
        checked, found = watcher.checked(t, scene)
        said += [(t, reason) for reason in found]
        assert checked.names == scene.names
    return said, checked, watcher


def mover(velocity, told: Motion | None, *, stops: float = np.inf) -> Seen:
    way = np.array([*velocity, 0.0])
    return lambda t: [Cylinder(0.3, 1.6, at=np.array([0.0, 0.0, 0.8]) + way * min(t, stops), name="mover", motion=told)]


@each("told, hinted", [(True, False), (False, True)])
def test_a_place_that_is_taken_on_twice_is_hinted_at(told, hinted):
    """A scene takes obstacles on from the time at which they are said to have been where they are."""

    def walker(t: float) -> list[Obstacle]:
        pose = {"at": (0.8 * t - 2.0, 0.0, 0.8), "motion": Twist((0.8, 0.0, 0.0)), "name": "walker"}
        return [Cylinder(0.3, 1.6, **pose, **({"time": t} if told else {}))]

    watcher, said = MotionWatch(MonitorParams(), ASSUMED), []
    for k in range(40):
        scene = Scene([*ROOM, *walker(k * DT)], time=k * DT)
        said += watcher.checked(k * DT, scene)[1]
    assert bool(said) is hinted
    assert all("time=" in reason for reason in said)
    wrong, _, _ = watch(mover((0.8, 0.0), Twist((0.3, 0.0, 0.0))))
    assert not any("time=" in reason for _, reason in wrong)


@each(
    "velocity, told",
    [
        ((0.5, 0.0), None),
        ((0.0, 1.5), None),
        ((0.05, 0.0), None),
        ((0.5, 0.3), Twist((-0.5, -0.3, 0.0))),
        ((1.2, 0.0), Twist((-1.2, 0.0, 0.0))),
        ((0.8, 0.0), Twist((0.3, 0.0, 0.0))),
        ((1.0, 0.0), UnknownMotion(0.2)),
    ],
)
def test_what_moves_otherwise_is_named_once_and_counts_as_unknown(velocity, told):
    said, checked, _ = watch(mover(velocity, told))
    assert len(said) == 1
    time, reason = said[0]
    assert time <= 1.0
    assert "'mover'" in reason
    motion = checked.obstacle("mover").motion
    assert isinstance(motion, UnknownMotion)
    speed = float(np.hypot(*velocity))
    assert speed <= motion.max_speed <= max(speed + 1.0, 1.0)
    assert all(o.motion is None for o in checked if o.name != "mover")


def test_a_beam_that_turns_and_is_said_to_stand_is_named():
    def beam(t: float) -> list[Obstacle]:
        half = 0.25 * t
        return [Box((2.0, 0.1, 0.1), at=(0.0, 0.0, 0.5), quat=(0.0, 0.0, np.sin(half), np.cos(half)), name="beam")]

    said, checked, _ = watch(beam)
    assert len(said) == 1
    assert isinstance(checked.obstacle("beam").motion, UnknownMotion)


def test_who_agrees_again_is_trusted_again():
    said, checked, watcher = watch(mover((0.5, 0.0), None, stops=2.0), 3.0)
    assert said
    assert checked.obstacle("mover").motion is not None
    said, checked, _ = watch(mover((0.5, 0.0), None, stops=2.0), 3.0, 3.0, watcher)
    assert not said
    assert checked.obstacle("mover").motion is None


def noise(rng: np.random.Generator, most: float) -> np.ndarray:
    error = rng.normal(size=3)
    return error / np.linalg.norm(error) * most


def truthful(t: float, rng: np.random.Generator) -> list[Obstacle]:
    """Movers within the assumptions: errors of place and velocity, and an acceleration."""
    place = np.array([0.6 * t + 0.24 * t * t, -0.5 * t, 0.8]) + noise(rng, ASSUMED.position_error)
    velocity = np.array([0.6 + 0.48 * t, -0.5, 0.0]) + noise(rng, ASSUMED.velocity_error)
    still = np.array([-2.0, 0.0, 0.5]) + noise(rng, ASSUMED.position_error)
    return [
        Cylinder(0.3, 1.6, at=place, name="walker", motion=Twist(velocity)),
        Box((0.4, 0.4, 1.0), at=still, name="still"),
    ]


def renamed(t: float, rng: np.random.Generator) -> list[Obstacle]:
    """The same things in another order each time, by names of the order."""
    order = rng.permutation(12)
    return [Box((0.3, 0.3, 1.0), at=(0.35 * k, -2.0, 0.5), name=f"cluster-{i}") for i, k in enumerate(order)]


def shifted(t: float, rng: np.random.Generator) -> list[Obstacle]:
    """One at the front goes, so that all others are called by the number before."""
    first = int(t / 0.5)
    return [Box((0.05, 0.05, 1.0), at=(0.09 * (first + i), -2.0, 0.5), name=f"cluster-{i}") for i in range(20 - first)]


def segmented(t: float, rng: np.random.Generator) -> list[Obstacle]:
    """A wall of which another part is seen each time."""
    low, high = -rng.uniform(0.5, 1.0), rng.uniform(0.5, 1.0)
    return [Box((high - low, 0.1, 1.0), at=(0.5 * (low + high), -2.0, 0.5), name="wall")]


@each("seen", [truthful, renamed, shifted, segmented])
def test_noise_names_and_segments_are_no_motion(seen):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        said, checked, _ = watch(lambda t, rng=rng: seen(t, rng))
        assert not said
        assert not any(isinstance(o.motion, UnknownMotion) for o in checked)


def test_what_is_put_elsewhere_is_no_mover():
    def put(t: float) -> list[Obstacle]:
        return [Box((0.4, 0.4, 1.0), at=(0.0 if t < 1.0 else 1.5 if t < 2.0 else 1.55, 0.0, 0.5), name="chair")]

    assert not watch(put)[0]


def test_scenes_that_are_no_newer_say_nothing_new():
    watcher = MotionWatch(MonitorParams(), ASSUMED)
    for k in range(20):  # a map that is published again and again, each time with another place
        scene = Scene([Box((0.4, 0.4, 1.0), at=(0.02 * k, 0.0, 0.5), name="box")], time=1.0)
        assert watcher.checked(1.0 + DT * k, scene) == (scene, ())
    assert watcher.checked(2.0, scene)[0] is scene


def test_the_monitor_of_scenes_has_one():
    monitor = SceneMonitor(MonitorParams(), ASSUMED)
    assert watch(mover((0.5, 0.0), None), watcher=monitor.motions)[0]


def test_obstacles_come_and_go():
    def seen(t: float) -> list[Obstacle]:
        some = [Box((0.2, 0.2, 1.0), at=(k, -3.0, 0.5), name=f"b{k}") for k in range(int(10 * t) % 7)]
        return [*some, *mover((0.4, 0.0), None)(t)] if t < 2.0 else some

    said, checked, _ = watch(seen)
    assert [("'mover'" in reason) for _, reason in said] == [True]
    assert "mover" not in checked
