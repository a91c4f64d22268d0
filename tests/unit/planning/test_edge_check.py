"""Edges of a path: what samples miss, the motion bound does not."""

from __future__ import annotations

import numpy as np

from elastic_strips.planning import ompl_path, straight_line
from elastic_strips.planning.ompl_planner import certify_path
from elastic_strips.planning.validity import ValidityChecker
from elastic_strips.scene import Box, Cylinder, Scene
from elastic_strips.strip import Deformer


def test_a_wire_between_two_samples_is_found(jackal_box) -> None:
    """A path whose nodes are all valid, with a thin plate between two of them."""
    start, goal = jackal_box.home(), jackal_box.home(x=4.0)
    coordinates = straight_line(jackal_box, start, goal, spacing=2.0)
    assert len(coordinates) == 5
    plate = Scene([Box((0.001, 2.0, 1.0), at=(1.5, 0.0, 0.5), name="plate")])
    valid = ValidityChecker(jackal_box, plate, margin=0.0)
    coordinates = coordinates[[0, 2, 4]]  # at 0, 2 and 4 m: half a robot is shorter than 0.5 m
    assert all(valid(q.copy()) for q in jackal_box.space.from_coordinates(coordinates))
    certificate = certify_path(Deformer(jackal_box), plate, coordinates)
    assert certificate.segments.tolist() == [False, True]
    assert certificate.broken is not None
    assert certificate.broken.obstacle == "plate"
    assert certify_path(Deformer(jackal_box), plate.without("plate"), coordinates).certified


def test_a_finer_path_checks_more(silvermate) -> None:
    scene = Scene([Cylinder(0.3, 1.5, at=(2.0, 0.0, 0.75))])
    checks = []
    for fineness in (1.0, 4.0):
        found = ompl_path(
            silvermate, scene, silvermate.home(), silvermate.home(x=4.0), seed=1, margin=0.03, timeout=60.0,
            fineness=fineness,
        )  # fmt: skip
        assert found.rows is not None
        checks.append(found.checks)
        assert np.isfinite(found.rows).all()
    assert checks[1] > 1.5 * checks[0]
