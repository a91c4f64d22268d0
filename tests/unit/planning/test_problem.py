"""Planning ends in time, passes long walls, keeps what it was given, and says why where it fails."""

from __future__ import annotations

import logging
import threading
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.errors import ConfigurationError, InputError, ParameterError, RobotError, SceneError
from elastic_strips.planning import check_endpoints, ompl_path, plan, plan_report
from elastic_strips.planning import problem as deadlines
from elastic_strips.planning.grid_path import grid_frame
from elastic_strips.planning.problem import Region
from elastic_strips.robot import load_robot
from elastic_strips.scene import Box, Scene, Sphere
from elastic_strips.strip import Deformer, DeformParams, DeformStatus, Strip

several = partial(plan_report, count=3)


def wall(length, y=0.0, x=2.0, name="wall"):
    return Box((0.2, length, 1.5), at=(x, y, 0.75), name=name)


def beam(length, y, name):
    """Parallel to x, its right end at x = 2."""
    return Box((length, 0.2, 1.5), at=(2.0 - 0.5 * length, y, 0.75), name=name)


LONG = {
    "20 m": Scene([wall(20.0)]),
    "L": Scene([wall(12.0), beam(8.0, 6.0, "leg")]),
    "U": Scene([wall(8.0), beam(8.0, 4.0, "left"), beam(8.0, -4.0, "right")]),
}
SLIT = Scene([wall(9.7, 4.85 + 0.27, name="left"), wall(9.7, -4.85 - 0.27, name="right")])
"""A wall with a gap of 0.54 m on the line: on the grid the base's disc just passes, the robot does not."""


@pytest.fixture(scope="module", params=["diff_drive", "omni"])
def mover(request):
    return load_robot("silvermate", base=request.param)


@pytest.mark.parametrize("scene", LONG.values(), ids=LONG)
def test_long_walls_are_passed(mover, scene):
    start, goal = mover.home(), mover.home(x=4.0)
    report = plan_report(mover, scene, start, goal, timeout=60.0)
    assert report.certified, report.reason
    assert Deformer(mover).certify(report.strip, scene).certified
    assert report.strip.lateral_slip.max() <= 1e-6
    np.testing.assert_array_equal(report.strip.q[[0, -1]], [start, goal])


def test_where_the_base_fits_and_the_robot_does_not_it_goes_around(mover):
    report = plan_report(mover, SLIT, mover.home(), mover.home(x=4.0), timeout=60.0)
    assert report.certified, report.reason
    assert np.abs(report.strip.coordinates[:, 1]).max() > 5.0


def test_without_the_grid_the_boxes_of_ompl_widen(silvermate):
    region = Region(silvermate, LONG["20 m"], silvermate.home(), silvermate.home(x=4.0))
    boxes = list(region.boxes(3.0))
    assert boxes[0][1][1] == pytest.approx(3.0)
    assert boxes[-1][1][1] > 10.5, "the last one holds the wall and the way around it"
    for one, two in pairwise(boxes):
        assert (two[0] <= one[0]).all()
        assert (two[1] >= one[1]).all()


def test_the_base_keeps_to_the_bounds(mover):
    """The shorter way around leads left; only the right is allowed."""
    scene, start, goal = Scene([wall(8.0, y=-1.0)]), mover.home(), mover.home(x=4.0)
    bounds = ((-2.0, -9.0), (6.0, 2.0))
    free = plan_report(mover, scene, start, goal, timeout=60.0)
    kept = plan_report(mover, scene, start, goal, bounds=bounds, timeout=60.0)
    assert free.certified
    assert kept.certified, kept.reason
    assert free.strip.coordinates[:, 1].max() > 2.0
    path = mover.space.to_coordinates(kept.strip.sample(0.02))[:, :2]
    assert (path >= bounds[0]).all()
    assert (path <= bounds[1]).all()
    for found in plan_report(mover, scene, start, goal, bounds=bounds, count=3, timeout=60.0).alternatives:
        assert found.strip.coordinates[:, 1].max() <= 2.0


BAD_BOUNDS = [
    (((0, 0), (1, 1), (2, 2)), ParameterError, "must be"),
    ("all", ParameterError, "must be"),
    (((-1, -1), (np.inf, 1)), ParameterError, "finite"),
    (((5, -1), (-1, 1)), ParameterError, "must lie below"),
    (((-1, -1), (3, 1)), ConfigurationError, "goal: the base at x=4"),
]


@each("bounds, error, message", BAD_BOUNDS)
def test_wrong_bounds_are_named(silvermate, bounds, error, message):
    for call in (plan, plan_report, several):
        with pytest.raises(error, match=message):
            call(silvermate, Scene([]), silvermate.home(), silvermate.home(x=4.0), bounds=bounds)


def test_a_fixed_base_has_no_bounds(gantry):
    with refused(ParameterError, "'gantry'"):
        plan(gantry, Scene([]), gantry.home(), gantry.home(bend=1.0), bounds=((0, 0), (1, 1)))


class SlowClock:
    """Each look at it takes a while, so that nothing is done between two of them that is not counted."""

    def __init__(self, step):
        self.now, self.step = 0.0, step

    def __call__(self):
        self.now += self.step
        return self.now


@pytest.mark.parametrize("call", [plan_report, several])
def test_nothing_goes_on_when_the_time_is_over(silvermate, call, monkeypatch):
    """By a clock that counts looks: after the time limit only what is under way is ended."""
    clock = SlowClock(0.02)
    monkeypatch.setattr(deadlines, "perf_counter", clock)
    steps = []
    step = Deformer.step
    monkeypatch.setattr(Deformer, "step", lambda *a, **k: (steps.append(clock.now), step(*a, **k))[1])
    scene = Scene([wall(8.0), Sphere(0.3, at=(300.0, 0.5, 0.3))])
    call(silvermate, scene, silvermate.home(), silvermate.home(x=600.0), timeout=1.0)
    assert all(at < 1.1 for at in steps)
    count = len(steps)
    call(silvermate, scene, silvermate.home(), silvermate.home(x=600.0), timeout=1e-3)
    assert len(steps) <= count + 1


def test_a_strip_has_no_more_nodes_than_it_may(mover):
    for x, scene, timeout in ((500.0, Scene([]), 60.0), (4.0, LONG["20 m"], 0.7)):
        for most in (4, 512):
            params = DeformParams(max_nodes=most)
            report = plan_report(mover, scene, mover.home(), mover.home(x, 0.0, 2.0), params=params, timeout=timeout)
            assert len(report.strip) <= most
            assert len(report.initial) <= most
            assert report.certified or len(scene), report.reason


def test_a_long_drive_past_an_obstacle_is_planned(mover):
    scene = Scene([Box((3.0, 3.0, 2.0), at=(100.0, 0.0, 1.0))])
    report = plan_report(mover, scene, mover.home(), mover.home(x=500.0), timeout=60.0)
    assert report.certified, report.reason
    assert Deformer(mover).certify(report.strip, scene).certified


@each("call", [plan, plan_report, several])
@each("x", [3e4, 1e8])
def test_a_goal_in_millimetres_is_refused_with_its_distance(silvermate, call, x):
    with pytest.raises(ConfigurationError, match=rf"goal is {x:.6g} m from start.*millimetres".replace("+", r"\+")):
        call(silvermate, Scene([]), silvermate.home(), silvermate.home(x=x), timeout=1.0)


def test_what_is_suspiciously_large_is_told(silvermate, caplog):
    ground = Box((2000.0, 2000.0, 0.1), at=(0.0, 0.0, -0.1), name="ground")
    with caplog.at_level(logging.WARNING, logger="elastic_strips"):
        check_endpoints(silvermate, Scene([ground]), silvermate.home(), silvermate.home(x=3.0), DeformParams())
        assert not caplog.records
        table = Box((1200.0, 800.0, 750.0), at=(3000.0, 0.0, 375.0), name="table")
        for _ in range(3):  # as often as a loop plans anew; it is said once
            check_endpoints(silvermate, Scene([table]), silvermate.home(), silvermate.home(x=437.5), DeformParams())
    said = [r.getMessage() for r in caplog.records]
    assert len(said) == 2
    assert any("obstacle 'table' is 1200 m × 800 m × 750 m large" in s for s in said)
    assert any("goal is 437.5 m from start" in s for s in said)


def test_the_ends_are_those_that_were_given(mover):
    """Bit for bit, headings of not quite unit length included; by line, grid and OMPL."""
    start, goal = mover.home(x=-0.3, yaw=0.7), mover.home(x=4.1, y=0.1, yaw=2.1)
    start[2] *= 1.0 + 5e-7
    goal[2:4] *= 1.0 - 3e-7
    for scene, grid in ((Scene([]), True), (LONG["20 m"], True), (Scene([wall(3.0)]), False)):
        report = plan_report(mover, scene, start, goal, grid=grid, timeout=60.0)
        assert report.certified, report.reason
        for strip in (report.strip, report.initial):
            np.testing.assert_array_equal(strip.q[[0, -1]], [start, goal])
    for found in several(mover, Scene([wall(3.0)]), start, goal, timeout=60.0).alternatives:
        np.testing.assert_array_equal(found.strip.q[[0, -1]], [start, goal])


def test_threads_do_not_change_what_a_seed_gives(silvermate):
    scene = Scene([wall(3.0)])
    start, goal = silvermate.home(), silvermate.home(x=4.0)

    def path():
        return ompl_path(silvermate, scene, start, goal, seed=5, margin=0.04, timeout=60.0).rows

    alone, found = path(), []
    threads = [threading.Thread(target=lambda: found.append(path())) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 3
    for coordinates in found:
        np.testing.assert_array_equal(coordinates, alone)


def test_a_failed_plan_says_what_is_in_the_way_and_what_to_try(silvermate):
    cage = [wall(4.0, x=5.0, name="front"), wall(4.0, x=9.0, name="back")]
    cage += [Box((4.0, 0.2, 1.5), at=(7.0, y, 0.75), name="side") for y in (2.0,)]
    cage += [Box((4.0, 0.2, 1.5), at=(7.0, -2.0, 0.75), name="other side")]
    report = plan_report(silvermate, Scene(cage), silvermate.home(), silvermate.home(x=7.0), timeout=1.5)
    assert not report.certified
    broken = report.report.certificate.broken
    assert broken is not None
    assert report.report.status is DeformStatus.BROKEN or report.report.ticks
    for word in ("no way for the base", "last in the way", " mm deep in ", "timeout", "bounds=", "clearance", "seed"):
        assert word in report.reason, word
    assert any(name in report.reason for name in ("front", "back", "side"))


def test_strips_with_wide_spacing_have_not_converged(mover):
    """Two nodes 50 m apart are divided until they are near; 500 m apart until there are as many as there may be."""
    for length, most in ((50.0, 512), (500.0, 512)):
        strip = Strip(mover, [mover.home(), mover.home(x=length)])
        report = Deformer(mover, DeformParams(max_nodes=most)).settle(strip, Scene([]))
        spacing = np.abs(report.strip.velocities[:, 0]).max()
        assert report.status is DeformStatus.SETTLED
        assert report.ticks > 1
        if length == 50.0:
            assert spacing <= 0.2 * (1 + 1e-6)
            assert "max_nodes" not in report.reason
        else:
            assert len(report.strip) == most
            assert "max_nodes=512" in report.reason
    report = Deformer(mover).step(Strip(mover, [mover.home(), mover.home(x=50.0)]), Scene([]))
    assert report.status is DeformStatus.DEFORMING
    assert "apart, more than max_spacing" in report.reason


def test_the_clearance_to_prove_may_be_given(silvermate):
    """3 mm and 0.1 mm from a kerb: planned with a smaller clearance, of which the message speaks."""
    base = silvermate.geometries[0].geometry.radius
    start, goal = silvermate.home(), silvermate.home(x=-3.0)
    for gap, clearance in ((3e-3, 1e-3), (1e-4, 0.0)):
        scene = Scene([Box((0.2, 0.2, 0.2), at=(base + 0.1 + gap, 0.0, 0.1), name="kerb")])
        with refused(ConfigurationError, "DeformParams", "(clearance=…)"):
            plan(silvermate, scene, start, goal, params=DeformParams())
        if gap > 5e-4:  # who states none gets half of what there is
            eased = plan_report(silvermate, scene, start, goal, timeout=60.0)
            assert eased.certified, eased.reason
            assert "proven with 1.5 mm" in eased.reason
        else:
            with refused(ConfigurationError, "close"):
                plan(silvermate, scene, start, goal)
        report = plan_report(silvermate, scene, start, goal, params=DeformParams(clearance=clearance), timeout=60.0)
        assert report.certified, report.reason
        around = Scene([*scene, wall(8.0)])  # not by the line alone
        report = plan_report(
            silvermate, around, start, silvermate.home(x=4.0), params=DeformParams(clearance=clearance), timeout=60.0
        )
        assert report.certified, report.reason


@each("deep", [0.0, 1e-6, 1e-3])
def test_what_touches_is_refused_at_any_clearance(silvermate, deep):
    base = silvermate.geometries[0].geometry.radius
    scene = Scene([Box((0.2, 0.2, 0.2), at=(base + 0.1 - deep, 0.0, 0.1), name="kerb")])
    params = DeformParams(clearance=0.0, self_clearance=0.0)
    start, goal = silvermate.home(), silvermate.home(x=-3.0)
    with refused(ConfigurationError, "kerb"):
        plan(silvermate, scene, start, goal, params=params)
    strip = Strip(silvermate, [start, silvermate.home(x=-1.0), goal])
    certificate = Deformer(silvermate, params).certify(strip, scene)
    assert not certificate.segments[0]
    assert certificate.segments[1]


def test_links_that_touch_are_refused_at_any_clearance(silvermate):
    """The arm is bent until its links just touch: never certified, a little further apart certified."""
    params = DeformParams(clearance=0.0, self_clearance=0.0)
    deformer = Deformer(silvermate, params)
    lower, upper = silvermate.space.lower, silvermate.space.upper
    rng = np.random.default_rng(3)
    home = silvermate.space.to_coordinates(silvermate.home_q)

    def certified(row):
        q = silvermate.space.from_coordinates(row)
        return deformer.certify(Strip(silvermate, [q, q]), Scene([])).certified

    for _ in range(200):
        hit = home.copy()
        hit[3:] = rng.uniform(lower[3:], upper[3:])
        if not certified(hit):
            break
    free, folded = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (free + folded)
        free, folded = (middle, folded) if certified(home + middle * (hit - home)) else (free, middle)
    row = home + free * (hit - home)
    touching = silvermate.space.from_coordinates(row)
    from brute_force import self_distances

    assert 0.0 < self_distances(silvermate, touching).min() < 1e-4
    with pytest.raises(ConfigurationError, match=r"self_clearance=…|deep"):
        plan(silvermate, Scene([]), silvermate.home(), touching)
    assert plan_report(silvermate, Scene([]), silvermate.home(), touching, params=params, timeout=60.0).certified


KINDS = [
    (lambda r, f: f(r, [Sphere(0.1, at=(2, 2, 1))], r.home(), r.home(1.0)), SceneError, "scene is a list"),
    (lambda r, f: f(Scene([]), r, r.home(), r.home(1.0)), RobotError, "robot is a Scene"),
    (lambda r, f: f(r, Scene([]), r.home(), Scene([])), ConfigurationError, "goal"),
    (lambda r, f: f(r, Scene([]), None, r.home()), ConfigurationError, "start"),
    (lambda r, f: f(r, Scene([]), r.home(), r.home(1.0), timeout="5"), ParameterError, "timeout='5'"),
    (lambda r, f: f(r, Scene([]), r.home(), r.home(1.0), timeout=True), ParameterError, "timeout=True"),
    (lambda r, f: f(r, Scene([]), r.home(), r.home(1.0), seed="1"), ParameterError, "seed='1'"),
    (lambda r, f: f(r, Scene([]), r.home(), r.home(1.0), params={}), ParameterError, "params must be a DeformParams"),
]


@each("call, error, message", KINDS)
def test_wrong_kinds_of_arguments_are_named(silvermate, call, error, message):
    for planner in (plan, plan_report, several):
        with pytest.raises(error, match=message):
            call(silvermate, planner)
    with refused(InputError, "deformer"):
        plan_report(silvermate, Scene([]), silvermate.home(), silvermate.home(1.0), deformer="x")
    with refused(InputError, "path='x'"):
        plan_report(silvermate, Scene([]), silvermate.home(), silvermate.home(1.0), path="x")


@each("size, most", [((8.0, 6.0), 400_000), ((700.0, 700.0), 400_000), ((3.0, 3.0), 50), ((1e4, 0.1), 0)])
def test_a_grid_has_no_more_cells_than_it_may(size, most):
    low = np.array([-1.3, 0.7])
    first, shape, edge = grid_frame(low, low + size, most)
    assert np.prod(shape) <= max(most, 16)
    assert (first <= low).all()
    assert (first + edge * (shape - 1) >= low + size - 1e-9).all()
    assert edge / 0.05 == pytest.approx(np.rint(edge / 0.05))
