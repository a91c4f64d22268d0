"""repair: a path through an obstacle comes out certified, with its ends where they were; how far it moved is said."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import link_distances

from elastic_strips.collision import certify
from elastic_strips.scene import Box, Scene
from elastic_strips.strip import Strip, displacement, repair


def test_a_path_is_pushed_free(silvermate):
    scene = Scene([Box((0.3, 0.3, 1.0), at=(2.0, 0.35, 0.5), name="post")])
    q = np.array([silvermate.home(x=x) for x in np.linspace(0.0, 4.0, 25)])
    assert not certify(silvermate, scene, q).certified
    report = repair(silvermate, scene, q)
    assert report.certified, report.reason
    assert 0.01 < report.moved < 1.0
    assert certify(silvermate, scene, report.strip, clearance=0.005).certified
    assert min(link_distances(silvermate, scene, p).min() for p in report.strip.sample(0.02)) > 0.0
    np.testing.assert_array_equal(report.strip.q[[0, -1]], q[[0, -1]])


def test_what_was_pushed_far_is_relaxed(tiago_omni):
    """Half a metre deep in a shelf it is pushed to and fro; certified at first, it went more than twice as far."""
    scene = Scene([Box((0.9, 0.8, 1.2), at=(2.0, 0.18, 0.6), name="shelf")])
    report = repair(tiago_omni, scene, [tiago_omni.home(), tiago_omni.home(x=4.0)])
    assert report.certified
    assert certify(tiago_omni, scene, report.strip).certified
    assert report.relaxed
    base = report.strip.coordinates[:, :2]
    assert np.linalg.norm(np.diff(base, axis=0), axis=1).sum() < 1.3 * 4.0


def test_what_is_free_stays(silvermate):
    strip = Strip(silvermate, [silvermate.home(), silvermate.home(x=1.0)])
    report = repair(silvermate, Scene([]), strip)
    assert report.certified
    assert report.moved == 0.0
    assert not report.relaxed


def test_what_cannot_be_mended_says_why(silvermate):
    wall = Scene([Box((0.2, 30.0, 2.0), at=(2.0, 0.0, 1.0), name="wall")])
    report = repair(silvermate, wall, [silvermate.home(x=x) for x in np.linspace(0.0, 4.0, 25)], max_ticks=4)
    assert not report.certified
    assert report.reason


def test_displacement_is_that_of_the_farthest_point(silvermate):
    one = Strip(silvermate, [silvermate.home(), silvermate.home(x=1.0)])
    two = Strip(silvermate, [silvermate.home(y=0.2), silvermate.home(x=1.0, y=0.1)])
    assert displacement(one, two) == pytest.approx(0.2)
    three = Strip(silvermate, [silvermate.home(), silvermate.home(x=0.3), silvermate.home(x=1.0)])
    assert displacement(one, three) == pytest.approx(0.0, abs=1e-9)
