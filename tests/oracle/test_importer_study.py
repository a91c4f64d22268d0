"""A few random files of every format: nothing that they say is occupied is missing, and the study sees what is."""

from __future__ import annotations

import numpy as np
import pytest
from importer_study import FORMATS, depths, run

import elastic_strips as es
from elastic_strips.scene import Voxels

_SLOW = {"moveit": 3, "planning-scene": 4, "scene": 3, "sources": 2}  # they have meshes


@pytest.mark.parametrize("name", FORMATS)
def test_no_occupied_point_is_missed(name):
    count = run(name, _SLOW.get(name, 25), seed=11)
    assert not count.bad
    assert count.points > 50


def test_the_study_sees_what_is_missing():
    scene = es.Scene([es.Box((1, 1, 1)), Voxels([[3, 0, 0]], 0.2)])
    points = np.array([[0.4, 0.4, 0.4], [0.6, 0.0, 0.0], [3.05, 0, 0], [3.2, 0, 0]])
    np.testing.assert_allclose(depths(scene, points) > 1e-6, [False, True, False, True])
