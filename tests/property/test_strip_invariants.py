"""What every tick keeps, whatever the scene and the start: ends, limits, order, drivability, honesty."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from brute_force import SHAPES, link_distances, make_obstacle, self_distances
from hypothesis import given, settings
from hypothesis import strategies as st

from elastic_strips.planning import straight_line
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import Deformer, DeformParams, DeformReport, DeformStatus, Strip
from elastic_strips.strip.paper import PaperDeformer, PaperParams
from elastic_strips.strip.resampling import node_spacing


def random_scene(rng: np.random.Generator, length: float) -> Scene:
    """A few obstacles along a way on the x axis; some stand on it."""
    obstacles = []
    for _ in range(rng.integers(0, 7)):
        x, y = rng.uniform(0.7, length - 0.7), rng.choice([-1, 1]) * rng.uniform(0.1, 1.2)
        shape = SHAPES[rng.integers(len(SHAPES))]
        obstacles.append(make_obstacle(shape, rng, (x, y, 0.0), (x + 0.01, y + 0.01, 1.3)))
    return Scene(obstacles)


def random_line(robot: RobotModel, rng: np.random.Generator, length: float) -> Strip:
    """A straight strip with other arm postures at its ends."""
    space = robot.space
    ends = []
    for k in (0, 1):
        coordinates = space.to_coordinates(robot.home_q)
        b = space.base_nv
        coordinates[b:] = np.clip(
            coordinates[b:] + 0.2 * rng.normal(size=space.nv - b), space.lower[b:], space.upper[b:]
        )
        if space.planar:
            coordinates[:3] = k * length, k * rng.uniform(-0.5, 0.5), k * rng.uniform(-1.5, 1.5)
        ends.append(space.from_coordinates(coordinates))
    rows = straight_line(robot, ends[0], ends[1], spacing=rng.uniform(0.08, 0.3))
    return Strip(robot, space.from_coordinates(np.clip(rows, space.lower, space.upper)))


def check(robot: RobotModel, start: Strip, scene: Scene, report: DeformReport, params: DeformParams) -> None:
    strip, space = report.strip, robot.space
    np.testing.assert_array_equal(strip.coordinates[[0, -1]], start.coordinates[[0, -1]])  # to the bit
    np.testing.assert_allclose(strip.q[[0, -1]], start.q[[0, -1]], rtol=0, atol=3e-16)  # cos and sin of the same angle
    robot.check_q(strip.q)
    coordinates = strip.coordinates
    assert (coordinates >= space.lower).all()
    assert (coordinates <= space.upper).all()
    assert np.isfinite(strip.q).all()
    v = np.array([pin.difference(robot.model, a, b) for a, b in zip(strip.q[:-1], strip.q[1:], strict=True)])
    if robot.base_kind is BaseKind.DIFF_DRIVE:
        slip = float(np.abs(v[:, 1]).max())
        assert slip <= 1e-6 or report.slip > 1e-6
        if report.slip <= 1e-6:
            assert abs(slip - report.slip) <= 1e-6
    certificate = report.certificate
    assert len(certificate.segments) == len(strip) - 1
    assert certificate.certified == (certificate.broken is None)
    assert certificate.certified == bool(certificate.segments.all())
    assert (certificate.states == 0).tolist() == certificate.segments.tolist()
    assert len(strip) <= max(params.max_nodes, len(start))
    assert (report.status is DeformStatus.SETTLED) <= report.certified
    assert report.reason
    if certificate.broken is not None:
        assert not certificate.segments[certificate.broken.segment]
    # what is certified is clear at both its nodes, measured by brute force at some of them
    ends = np.flatnonzero(certificate.segments)
    for j in ends[:: max(1, len(ends) // 3)]:
        for q in strip.q[j : j + 2]:
            if len(scene):
                assert link_distances(robot, scene, q).min() > params.clearance - 2e-5
            assert self_distances(robot, q).min() > params.self_clearance - 2e-5


@settings(max_examples=6, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1))
@pytest.mark.parametrize("name", ["silvermate", "tiago", "rover"])
def test_ticks_keep_ends_limits_and_drivability(name, request, seed):
    robot: RobotModel = request.getfixturevalue(name)
    rng = np.random.default_rng(seed)
    scene, params = random_scene(rng, 3.0), DeformParams(max_nodes=90)
    start = random_line(robot, rng, 3.0)
    deformer, strip = Deformer(robot, params), start
    for _ in range(4):
        report = deformer.step(strip, scene)
        check(robot, start, scene, report, params)
        strip = report.strip


@settings(max_examples=6, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1))
def test_maintenance_keeps_the_spacing(silvermate, seed):
    """After a tick no segment is longer than allowed, unless it was far too long, and order is kept along the way."""
    rng = np.random.default_rng(seed)
    params, scene = DeformParams(), random_scene(rng, 3.0)
    weight = Deformer(silvermate, params).spacing_weight
    deformer, strip = Deformer(silvermate, params), random_line(silvermate, rng, 3.0)
    for _ in range(5):
        before = node_spacing(silvermate.space, strip.coordinates, weight).max()
        strip = deformer.step(strip, scene).strip
        after = node_spacing(silvermate.space, strip.coordinates, weight)
        assert after.max() <= max(1.1 * params.max_spacing, 0.6 * before + params.max_step)
    assert len(strip) < params.max_nodes


@settings(max_examples=3, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1))
@pytest.mark.parametrize("name", ["silvermate", "tiago"])
def test_the_papers_preset_keeps_its_invariants(name, request, seed):
    robot: RobotModel = request.getfixturevalue(name)
    rng = np.random.default_rng(seed)
    params, scene = PaperParams(updates=3), random_scene(rng, 3.0)
    start = random_line(robot, rng, 3.0)
    deformer, strip = PaperDeformer(robot, params), start
    for _ in range(3):
        report = deformer.step(strip, scene)
        strip = report.strip
        assert len(strip) == len(start)
        np.testing.assert_array_equal(strip.coordinates[[0, -1]], start.coordinates[[0, -1]])
        robot.check_q(strip.q)
        assert report.heading_step <= params.transfer_tilt + 1e-12


@settings(max_examples=6, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1))
def test_settling_ends_in_a_state_that_says_what_it_is(silvermate, seed):
    rng = np.random.default_rng(seed)
    scene, params = random_scene(rng, 3.0), DeformParams(max_nodes=80, max_ticks=12)
    start = random_line(silvermate, rng, 3.0)
    report = Deformer(silvermate, params).settle(start, scene)
    check(silvermate, start, scene, report, params)
    assert (report.status is DeformStatus.BROKEN) == (not report.usable)
    assert report.status in (DeformStatus.SETTLED, DeformStatus.BROKEN, DeformStatus.DEFORMING)
    assert 1 <= report.ticks <= 12
    if report.status is DeformStatus.BROKEN:
        assert report.certificate.broken is not None or report.slip > 1e-6
