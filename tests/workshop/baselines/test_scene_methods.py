"""Methods for a base that are shown the obstacles: the dynamic window, and ORCA where its package is installed."""

from __future__ import annotations

import importlib.util
import sys

import numpy as np
import pytest
from cases import refused

from elastic_strips.errors import MissingExtraError, ParameterError
from elastic_strips.scene import Box, Cylinder, Keyframes, Scene, Sphere, Twist
from elastic_strips.sim import evaluate
from elastic_strips.sim.sensors import SensorConfig
from workshop.baselines import (
    BaseLimits,
    DynamicWindow,
    DynamicWindowParams,
    SceneFromAbove,
    base_simulation,
    make_scene_method,
)
from workshop.baselines.dynamic_window import admissible, arcs

LIMITS = BaseLimits(radius=0.3, max_speed=1.0, max_turn=2.0, acceleration=1.0, turn_acceleration=4.0)
PILLAR = Cylinder(0.3, 1.3, at=(2.0, 0.05, 0.65), name="pillar")
GOAL = np.array([4.0, 0.0, 0.0])
HAS_ORCA = importlib.util.find_spec("pyrvo") is not None
needs_orca = pytest.mark.skipif(not HAS_ORCA, reason="pyrvo is not installed: pip install pyrvo")


def test_a_scene_from_above() -> None:
    walker = Cylinder(0.2, 1.7, at=(1.0, 2.0, 0.85), motion=Twist(linear=(0.5, -0.5, 0.0)))
    cart = Box((0.6, 0.8, 1.0), at=(5.0, 0.0, 0.5), motion=Twist(linear=(1.0, 0.0, 0.0)))
    quarter = np.sqrt(0.5)
    wall = Box((2.0, 0.2, 1.0), at=(0.0, -3.0, 0.5), quat=(0.0, 0.0, quarter, quarter))
    seen = SceneFromAbove.of(Scene([walker, cart, wall, Sphere(0.1, at=(0.0, 0.0, 0.5))], time=1.0).at(1.0))
    np.testing.assert_allclose(seen.center, [[1.5, 1.5], [6.0, 0.0], [0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(seen.radius, [0.2, 0.5, 0.1])
    np.testing.assert_allclose(seen.centers_at(3.0), [[2.5, 0.5], [8.0, 0.0], [0.0, 0.0]], atol=1e-12)
    assert len(seen.polygons) == 1
    points = np.array([[0.0, -3.0], [1.1, -3.0], [0.1 + 0.3, -2.0 + 0.4]])
    np.testing.assert_allclose(seen.from_polygons(points), [0.0, 1.0, 0.5], atol=1e-12)
    assert np.isinf(SceneFromAbove.of(Scene([])).from_polygons(points)).all()


def test_arcs_are_where_a_base_goes() -> None:
    """A quarter of a circle of 1 m to the left, a straight line, and a turn in place."""
    pairs = np.array([[1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    at = arcs(np.array([1.0, 2.0, np.pi / 2]), pairs, np.array([np.pi / 2]))[:, 0]
    np.testing.assert_allclose(at, [[0.0, 3.0], [1.0, 2.0 + np.pi / 2], [1.0, 2.0]], atol=1e-12)


def test_admissible_is_what_stops_in_time() -> None:
    pairs = np.array([[0.9, 0.0], [1.1, 0.0], [0.1, 1.9], [0.1, 2.1]])
    assert admissible(pairs, np.full(4, 0.5), LIMITS).tolist() == [True, False, True, False]


def test_the_window_is_what_is_reached_soon() -> None:
    pairs = DynamicWindow(LIMITS).window(np.array([0.9, -1.5]))
    np.testing.assert_allclose([pairs.min(axis=0), pairs.max(axis=0)], [[0.65, -2.0], [1.0, -0.5]])


def test_what_moves_counts_where_it_will_be_if_that_is_asked_for() -> None:
    """Someone crosses ahead, and is gone when the base arrives; someone comes at it from far away."""
    gone = Cylinder(0.2, 1.0, at=(1.5, 0.0, 0.5), motion=Twist(linear=(0.0, 1.5, 0.0)))
    coming = Cylinder(0.2, 1.0, at=(5.0, 0.0, 0.5), motion=Twist(linear=(-1.5, 0.0, 0.0)))
    ahead, far = np.array([[1.0, 0.0]]), LIMITS.max_speed * DynamicWindowParams().horizon
    cases = ((gone, False, False), (gone, True, True), (coming, False, True), (coming, True, False))
    for obstacle, predicts, free in cases:
        method = DynamicWindow(LIMITS, DynamicWindowParams(predicts=predicts))
        method.see(Scene([obstacle]))
        assert (float(method.distance(0.0, np.zeros(3), ahead)[0]) == far) == free


def test_it_brakes_where_nothing_is_admissible() -> None:
    method = DynamicWindow(LIMITS)
    method.see(Scene([Box((0.2, 4.0, 1.0), at=(0.45, 0.0, 0.5))]))
    command = method.command(0.0, np.zeros(3), np.array([0.8, 0.0]), GOAL)
    assert (command.status, command.v < 0.8) == ("blocked", True)


@pytest.mark.parametrize("method", ["dwa", "dwa-predicting", pytest.param("orca", marks=needs_orca)])
def test_it_drives_around_what_stands_and_what_moves(silvermate, method) -> None:
    """As published the dynamic window knows nothing of what moves: it meets nobody here."""
    walker = Cylinder(0.25, 1.7, name="walker", motion=Keyframes([0.0, 8.0], [[3.0, 3.0, 0.85], [3.0, -3.0, 0.85]]))
    scene = Scene([PILLAR] if method == "dwa" else [PILLAR, walker])
    driven = base_simulation(silvermate, scene, silvermate.home(), silvermate.home(x=4.0), method, seed=3)
    result = driven.run(time_limit=30.0)
    assert result.reached, result.reason
    assert not evaluate(result.record, silvermate, driven.world).collisions


@needs_orca
def test_orca_goes_on_where_nothing_is_and_turns_away_from_what_comes() -> None:
    method = make_scene_method("orca", LIMITS)
    free = method.command(0.0, np.zeros(3), np.array([1.0, 0.0]), GOAL)
    assert (free.v, free.omega) == pytest.approx((1.0, 0.0), abs=1e-6)
    method.see(Scene([Cylinder(0.3, 1.0, at=(2.5, 0.1, 0.5), motion=Twist(linear=(-1.0, 0.0, 0.0)))]))
    assert method.command(0.05, np.zeros(3), np.array([1.0, 0.0]), GOAL).omega < -0.1


def test_a_package_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrvo", None)
    with refused(MissingExtraError, "pip install pyrvo"):
        make_scene_method("orca", LIMITS)


def test_wrong_input_is_refused(silvermate) -> None:
    with refused(ParameterError, "dwb"):
        make_scene_method("dwb", LIMITS)
    with refused(ParameterError, "laser"):
        ends = silvermate.home(), silvermate.home(x=1.0)
        base_simulation(silvermate, Scene([]), *ends, "dwa", sensors=SensorConfig().only("laser"))
