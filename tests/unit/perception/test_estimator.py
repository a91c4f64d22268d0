"""The estimator: scenes of readings, in order and in time, with the same objects where nothing changed; visibility."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cases import refused
from hypothesis import given, settings
from hypothesis import strategies as st
from ray_caster import box_segments, scan

from elastic_strips.errors import ParameterError
from elastic_strips.perception import LaserScan, RangeRing, SceneEstimator, SceneEstimatorParams
from elastic_strips.scene import Box, Scene, Voxels
from elastic_strips.sim.evaluation import seen_obstacles, visible_to

ORACLE = Path(__file__).parents[2] / "oracle"
WALKS_BY = """
import sys
from ray_caster import box_segments, scan
from elastic_strips.perception import SceneEstimator

estimator = SceneEstimator()
before = set(sys.modules)
for k in range(12):
    circles = [(2.0, -1.0 + 0.1 * k, 0.25)]
    estimator.update(scan((0, 0, 0), 0.1 * k, segments=box_segments(0, 0, 8, 6), circles=circles), (0, 0, 0))
assert estimator.movers
print(*sorted(set(sys.modules) - before))
"""
ROOM = box_segments(0, 0, 8, 6) + box_segments(2, 1, 0.5, 0.5)


def ring(time=0.0, ranges=(0.5,)):
    return RangeRing("ring", "sonar", time, np.array([np.eye(4)] * len(ranges)), np.array(ranges), 0.1, 0.05, 3.0)


def test_a_static_world_is_the_same_obstacles_from_scan_to_scan():
    estimator = SceneEstimator()
    for k in range(3):
        report = estimator.update(scan((0, 0, 0), 0.1 * k, segments=ROOM), (0, 0, 0))
    first = estimator.scene()
    assert first is estimator.scene()
    assert first.time == pytest.approx(0.2)
    assert (report.sensor, report.hits, report.nothing, report.no_answer) == ("laser", 361, 0, 0)
    assert report.movers == 0
    assert estimator.movers == ()
    estimator.update(scan((0, 0, 0), 0.3, segments=ROOM), (0, 0, 0))
    second = estimator.scene(0.35)
    assert second.time == pytest.approx(0.3)
    assert second.names == first.names
    assert all(a is b for a, b in zip(first, second, strict=True))
    assert all(isinstance(o, Voxels) for o in second)
    assert len(second.rows_changed_since(first)) == 0


def test_no_reading_waits_for_a_module_to_be_loaded():
    """What follows movers needs SciPy, which takes a second to load: not when the first of them walks by."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ORACLE), *sys.path])}
    done = subprocess.run(
        [sys.executable, "-c", WALKS_BY], env=environment, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout.strip()) == (0, ""), done.stderr


def test_the_scene_holds_the_walls_where_the_base_is_said_to_be():
    estimator = SceneEstimator()
    pose = (1.0, -0.5, 2.0)
    estimator.update(scan(pose, 0.0, segments=ROOM), pose)
    table = estimator.scene().table
    low, high = (table.center - table.half_extents).min(axis=0), (table.center + table.half_extents).max(axis=0)
    np.testing.assert_allclose(low, (-4.0, -3.0, 0.0), atol=0.06)
    assert high[1] == pytest.approx(3.0, abs=0.06)
    assert high[2] == pytest.approx(SceneEstimatorParams().height)


def test_rings_have_their_own_layer_that_the_laser_does_not_clear():
    estimator = SceneEstimator()
    estimator.update(ring(0.0), (0, 0, 0))
    for k in range(20):
        estimator.update(scan((0, 0, 0), 0.1 * k, segments=ROOM), (0, 0, 0))
    names = estimator.scene().names
    assert any(n.startswith("near-") for n in names)
    assert any(n.startswith("map-") for n in names)
    for k in range(10):
        estimator.update(ring(2.0 + 0.1 * k, (1.5,)), (0, 0, 0))
    assert not any(n.startswith("near-") for n in estimator.scene().names)


def test_unseen_space_is_blocked_only_where_the_parameters_say_so():
    reading = scan((0, 0, 0), segments=ROOM)
    for policy in ("free", "blocked"):
        estimator = SceneEstimator(SceneEstimatorParams(unseen=policy))
        estimator.update(reading, (0, 0, 0))
        assert any(n.startswith("unseen-") for n in estimator.scene().names) == (policy == "blocked")


def test_readings_out_of_order_and_scenes_of_the_past_are_refused():
    estimator = SceneEstimator()
    with refused(ParameterError, "reading"):
        estimator.scene()
    estimator.update(scan((0, 0, 0), 1.0, segments=ROOM), (0, 0, 0))
    with refused(ParameterError, "0.9"):
        estimator.update(scan((0, 0, 0), 0.9, segments=ROOM), (0, 0, 0))
    estimator.update(ring(0.95), (0, 0, 0))  # another sensor may be a little behind
    assert estimator.scene().time == 1.0
    estimator.update(ring(1.5), (0, 0, 0))  # and does not make up for a laser that is dead
    assert estimator.scene().time == 1.0
    assert estimator.times == {"laser": 1.0, "ring": 1.5}
    with refused(ParameterError, "1 s"):
        estimator.scene(0.5)
    with refused(ParameterError, "three"):
        estimator.update(scan((0, 0, 0), 1.1), "here")
    with refused(ParameterError, "finite"):
        estimator.update(ring(math.nan), (0, 0, 0))
    with refused(ParameterError, "1.5"):
        estimator.update(ring(1.4), (0, 0, 0))
    assert estimator.scene().time == 1.0


def test_a_scan_without_an_answer_changes_nothing_but_the_time():
    estimator = SceneEstimator()
    reading = scan((0, 0, 0), 0.0, segments=ROOM)
    estimator.update(reading, (0, 0, 0))
    before = estimator.scene()
    silent = LaserScan("laser", 0.1, reading.T_base_sensor, reading.angles, np.full(361, np.nan), 0.05, 10.0)
    report = estimator.update(silent, (0, 0, 0))
    assert report.no_answer == 361
    after = estimator.scene()
    assert after.time == pytest.approx(0.1)
    assert all(a is b for a, b in zip(before, after, strict=True))


ANY_RANGE = st.one_of(st.floats(0.05, 10.0), st.just(math.inf), st.just(math.nan), st.just(1.0))


@settings(max_examples=40, deadline=None)
@given(st.lists(st.lists(ANY_RANGE, min_size=12, max_size=12), min_size=1, max_size=6), st.floats(0.0, 0.5))
def test_no_readings_break_it(rounds, step):
    """Whatever the ranges: a scene of named, finite obstacles, and a report whose counts add up."""
    estimator = SceneEstimator(SceneEstimatorParams(unseen="blocked", unseen_radius=1.0))
    angles = np.linspace(-1.0, 1.0, 12)
    for k, ranges in enumerate(rounds):
        report = estimator.update(LaserScan("laser", step * k, np.eye(4), angles, ranges, 0.05, 10.0), (0.01 * k, 0, k))
        assert report.hits + report.nothing + report.no_answer == 12
        scene = estimator.scene()
        assert len(set(scene.names)) == len(scene)
        assert np.isfinite(scene.table.center).all()


def test_visibility_knows_height_field_of_view_and_range():
    reading = scan((0, 0, 0), fov=math.pi, height=0.3, reach=4.0, segments=box_segments(2, 0, 0.4, 0.4))
    points = [(1, 0, 0.3), (1, 0, 0.31), (1, 0, 0.4), (-1, 0, 0.3), (5, 0, 0.3), (0.1, 3, 0.3), (0.01, 0, 0.3)]
    assert visible_to(np.array(points), reading, (0, 0, 0)).tolist() == [True, True, False, False, False, True, False]
    assert visible_to(np.array(points), reading, (0, 0, math.pi)).tolist()[3]
    scene = Scene(
        [
            Box((0.4, 0.4, 1.0), at=(2, 0, 0.5), name="crate"),
            Box((1.0, 1.0, 0.1), at=(1.5, 1.5, 0.7), name="table-top"),
            Box((0.4, 0.4, 1.0), at=(-2, 0, 0.5), name="behind"),
            Box((0.4, 0.4, 1.0), at=(3, 0, 0.5), name="hidden"),
        ]
    )
    seen = {v.name: v for v in seen_obstacles(scene, reading, (0, 0, 0))}
    assert (seen["crate"].in_plane, seen["crate"].in_view, seen["crate"].hit) == (True, 1.0, True)
    assert (seen["table-top"].in_plane, seen["table-top"].in_view, seen["table-top"].hit) == (False, 0.0, False)
    assert seen["table-top"].low == pytest.approx(0.65)
    assert (seen["behind"].in_plane, seen["behind"].in_view, seen["behind"].hit) == (True, 0.0, False)
    assert (seen["hidden"].in_plane, seen["hidden"].in_view, seen["hidden"].hit) == (True, 1.0, False)
