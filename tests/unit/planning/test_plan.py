"""plan: what it returns is certified or says that it is not; wrong input is named; equal seeds give equal strips."""

from __future__ import annotations

import logging
from contextlib import nullcontext

import numpy as np
import pytest
from brute_force import link_distances, make_obstacle, self_distances
from cases import each, refused

from elastic_strips.collision.bounds import BodySet
from elastic_strips.errors import ConfigurationError, ParameterError
from elastic_strips.native import kernel, twin
from elastic_strips.planning import check_endpoints, ompl_path, plan, plan_report
from elastic_strips.planning.validity import ValidityChecker
from elastic_strips.robot import PlanarFootprint
from elastic_strips.scene import Box, Cylinder, Scene, Sphere, Voxels
from elastic_strips.strip import Deformer, DeformParams

# a wall with a door beside the line: the straight line does not relax through it
DOOR = Scene(
    [
        Box((0.2, 3.0, 1.5), at=(2.0, 0.6, 0.75), name="left"),
        Box((0.2, 3.0, 1.5), at=(2.0, -3.9, 0.75), name="right"),
    ]
)


@each("name", ["silvermate", "tiago", "rover"])
def test_an_empty_scene_needs_no_planner(name, request):
    robot = request.getfixturevalue(name)
    start, goal = robot.home(x=-1.0), robot.home(x=2.0, y=1.0, yaw=1.0)
    report = plan_report(robot, Scene([]), start, goal)
    assert (report.certified, report.method, report.attempts) == (True, "line", 0)
    np.testing.assert_allclose(report.strip.q[[0, -1]], [start, goal], atol=1e-15)
    assert report.strip.lateral_slip.max() <= 1e-9
    assert report.strip.length == pytest.approx(np.hypot(3.0, 1.0), rel=1e-3)
    strip = plan(robot, Scene([]), start, goal)
    np.testing.assert_array_equal(strip.q, report.strip.q)


def test_a_line_deep_in_an_obstacle_is_given_up_at_a_few_nodes_and_whole_where_nothing_else_is_found(silvermate):
    """The report of a search without a result has the line as it is, however little of it was looked at before."""
    scene = Scene([Box((2.0, 60.0, 2.0), at=(4.0, 0.0, 1.0), name="wall")])
    start, goal = silvermate.home(), silvermate.home(x=8.0)
    bounds = ((-2.0, -2.0), (10.0, 2.0))
    report = plan_report(silvermate, scene, start, goal, timeout=0.3, bounds=bounds)
    assert (report.certified, report.ticks) == (False, 0)
    assert "straight line: 1." in report.reason
    assert "m deep in an obstacle" in report.reason
    gaps = np.diff(silvermate.space.to_coordinates(report.strip.q)[:, 0])
    assert gaps.max() <= 0.14  # not the few
    assert report.report.certificate.broken is not None


def test_a_hole_that_the_base_fits_without_its_clearance_does_not_keep_the_grid_from_a_doorway_elsewhere(tiago):
    """The doorway is as wide as the base with its clearance, and narrower than the robot."""
    hole, door, at = 2.0 * PlanarFootprint.of(tiago, tiago.home()).inner + 0.01, 0.8, 6.0
    ends = (-8.0, -0.5 * hole, 0.5 * hole, at - 0.5 * door, at + 0.5 * door, 8.0)
    walls = [
        Box((0.2, b - a, 1.5), at=(0.0, 0.5 * (a + b), 0.75), name=f"wall{a}")
        for a, b in zip(ends[::2], ends[1::2], strict=True)
    ]
    walls += [Box((8.0, 0.2, 1.5), at=(0.0, y, 0.75), name=f"side{y}") for y in (-8.1, 8.1)]
    walls += [Box((0.2, 16.4, 1.5), at=(x, 0.0, 0.75), name=f"end{x}") for x in (-4.1, 4.1)]
    report = plan_report(tiago, Scene(walls), tiago.home(x=-2.0), tiago.home(x=2.0), timeout=60.0)
    assert (report.certified, report.method) == (True, "grid")
    assert report.strip.coordinates[:, 1].max() > at - 0.5 * door


def test_a_deformer_of_another_robot_is_refused(silvermate, tiago):
    with refused(ParameterError, "deformer", "'tiago'", "'silvermate'"):
        plan_report(silvermate, Scene([]), silvermate.home(), silvermate.home(x=1.0), deformer=Deformer(tiago))


def test_a_fixed_arm_plans(gantry):
    start, goal = gantry.home(bend=-1.0), gantry.home(bend=1.5, slide=0.2)
    report = plan_report(gantry, Scene([]), start, goal)
    assert report.certified
    np.testing.assert_allclose(report.strip.q[[0, -1]], [start, goal], atol=1e-15)


def test_a_line_beside_obstacles_relaxes(silvermate):
    scene = Scene([Box((0.3, 0.3, 1.0), at=(2.0, 0.5, 0.5))])
    report = plan_report(silvermate, scene, silvermate.home(), silvermate.home(x=4.0))
    assert (report.certified, report.method) == (True, "line")
    assert Deformer(silvermate).certify(report.strip, scene).certified


@pytest.mark.parametrize("seed", [0, 3])
def test_the_planner_finds_the_door(silvermate, seed):
    start, goal = silvermate.home(), silvermate.home(x=4.0)
    report = plan_report(silvermate, DOOR, start, goal, seed=seed, timeout=60.0, grid=False)
    assert (report.certified, report.method) == (True, "ompl"), report.reason
    assert report.attempts >= 1
    assert Deformer(silvermate).certify(report.strip, DOOR).certified
    assert report.strip.lateral_slip.max() <= 1e-6
    np.testing.assert_allclose(report.strip.q[[0, -1]], [start, goal], atol=1e-15)
    assert min(link_distances(silvermate, DOOR, q).min() for q in report.strip.q) > 0.005 - 1e-5
    assert set(report.timings) == {"line", "planner", "relaxation"}
    assert sum(report.timings.values()) <= report.seconds


def test_equal_seeds_give_equal_strips(silvermate):
    start, goal = silvermate.home(), silvermate.home(x=4.0)
    for grid in (True, False):
        one, two = (plan_report(silvermate, DOOR, start, goal, seed=5, timeout=60.0, grid=grid).strip for _ in range(2))
        np.testing.assert_array_equal(one.q, two.q)


def test_other_seeds_give_other_paths(silvermate):
    start, goal = silvermate.home(), silvermate.home(x=4.0)
    paths = [ompl_path(silvermate, DOOR, start, goal, seed=seed, margin=0.02, timeout=60.0).rows for seed in (1, 2, 1)]
    assert all(p is not None for p in paths)
    np.testing.assert_array_equal(paths[0], paths[2])
    assert paths[0].shape != paths[1].shape or np.abs(paths[0] - paths[1]).max() > 1e-3


def test_what_cannot_be_reached_is_said_and_not_hidden(silvermate, caplog):
    """The goal is walled in: a strip comes back all the same, and everything says that it is broken."""
    cage = [
        Box((3.0, 0.2, 1.5), at=(6.0, y, 0.75), name=name) for y, name in ((1.2, "left wall"), (-1.2, "right wall"))
    ]
    cage += [
        Box((0.2, 2.6, 1.5), at=(x, 0.0, 0.75), name=name) for x, name in ((4.6, "front wall"), (7.4, "back wall"))
    ]
    scene, start, goal = Scene(cage), silvermate.home(), silvermate.home(x=6.0)
    with caplog.at_level(logging.WARNING, logger="elastic_strips"):
        report = plan_report(silvermate, scene, start, goal, timeout=1.5)
    assert not report.certified
    assert report.method == "none"
    assert "no certified strip" in report.reason
    assert any("no certified strip" in r.message for r in caplog.records)
    assert not Deformer(silvermate).certify(report.strip, scene).certified


@pytest.mark.parametrize("what", ["start", "goal"])
def test_ends_in_collision_name_the_pair(silvermate, what):
    scene = Scene([Box((0.4, 0.4, 1.0), at=(2.0, 0.0, 0.5), name="crate")])
    free, hit = silvermate.home(), silvermate.home(x=2.0)
    ends = (hit, free) if what == "start" else (free, hit)
    with pytest.raises(ConfigurationError, match=rf"{what} is in collision: '\w+' is [\d.]+ mm deep in 'crate'"):
        plan(silvermate, scene, *ends)


def test_ends_that_are_too_close_say_how_close(silvermate):
    base = silvermate.geometries[0].geometry.radius
    scene = Scene([Box((0.2, 0.2, 0.2), at=(base + 0.1 + 0.003, 0.0, 0.1), name="kerb")])
    with refused(ConfigurationError, "start", "'base_link'", "3.0", "'kerb'", "5.0"):
        plan(silvermate, scene, silvermate.home(), silvermate.home(x=-3.0), params=DeformParams())
    params = DeformParams(clearance=0.001)
    check_endpoints(silvermate, scene, silvermate.home(), silvermate.home(x=-3.0), params)


def test_ends_in_self_collision_name_both_links(silvermate, rng):
    space = silvermate.space
    for _ in range(400):
        coordinates = space.to_coordinates(silvermate.home_q)
        coordinates[3:] = rng.uniform(space.lower[3:], space.upper[3:])
        q = space.from_coordinates(coordinates)
        apart = self_distances(silvermate, q)
        if apart.min() < -0.01:
            break
    i, k = silvermate.self_pairs[int(np.argmin(apart))]
    names = BodySet.links(silvermate).labels[i], BodySet.links(silvermate).labels[k]
    with pytest.raises(ConfigurationError, match=rf"goal is in collision: '{names[0]}' is .* deep in '{names[1]}'"):
        plan(silvermate, Scene([]), silvermate.home(), q)


def test_large_clearances_are_checked_at_the_ends(silvermate):
    """Clearances beyond the default influence distance, of obstacles and between links."""
    base = silvermate.geometries[0].geometry.radius
    scene = Scene([Box((0.2, 4.0, 1.0), at=(-base - 0.1 - 0.4, 0.0, 0.5), name="wall")])
    with refused(ConfigurationError, "wall"):
        check_endpoints(
            silvermate, scene, silvermate.home(), silvermate.home(x=3.0), DeformParams(clearance=0.45, influence=0.6)
        )
    check_endpoints(
        silvermate, scene, silvermate.home(), silvermate.home(x=3.0), DeformParams(clearance=0.35, influence=0.6)
    )
    nearest = self_distances(silvermate, silvermate.home()).min()
    for margin, fine in ((nearest - 1e-3, True), (nearest + 1e-3, False)):
        params = DeformParams(self_clearance=float(margin))
        if fine:
            check_endpoints(silvermate, Scene([]), silvermate.home(), silvermate.home(x=3.0), params)
        else:
            with refused(ConfigurationError, "close"):
                check_endpoints(silvermate, Scene([]), silvermate.home(), silvermate.home(x=3.0), params)


@each(
    "options, message",
    [
        ({"seed": -1}, "seed=-1 must be a whole number"),
        ({"seed": 1.5}, "seed=1.5"),
        ({"seed": True}, "seed=True"),
        ({"timeout": 0.0}, "timeout=0.0"),
        ({"timeout": float("nan")}, "timeout=nan"),
    ],
)
def test_wrong_options_are_named(silvermate, options, message):
    with pytest.raises(ParameterError, match=message):
        plan(silvermate, Scene([]), silvermate.home(), silvermate.home(x=1.0), **options)


def test_wrong_configurations_are_named(silvermate):
    with refused(ConfigurationError, "goal", "(3,)"):
        plan(silvermate, Scene([]), silvermate.home(), [1.0, 2.0, 3.0])
    with refused(ConfigurationError, "start", "(2, 11)"):
        plan(silvermate, Scene([]), np.stack([silvermate.home()] * 2), silvermate.home())
    bad = silvermate.home()
    bad[5] = np.nan
    with refused(ConfigurationError, "start", "[5]"):
        plan(silvermate, Scene([]), bad, silvermate.home())
    bad[5] = 2.3
    with refused(ConfigurationError, "goal", "'arm_2_joint'", "2.3", "[-0.6, 2.2]"):
        plan(silvermate, Scene([]), silvermate.home(), bad)
    with refused(ParameterError, "fineness=0"):
        ompl_path(silvermate, Scene([]), silvermate.home(), bad, seed=0, margin=0.02, timeout=1.0, fineness=0.0)


@each("native", [False, True], ids=["twin", "native"])
@each("many", [False, True], ids=["few parts", "many parts"])
def test_validity_equals_brute_force(silvermate, rng, many, native):
    """Without the native kernel there are two ways of asking: links paired with parts in Pinocchio, and one Coal tree
    for many parts."""
    if native and kernel() is None:
        pytest.skip("the native kernel is not compiled here")
    scene = Scene([make_obstacle(s, rng, (-1, -1, 0), (1, 1, 1.2)) for s in ("box", "cone", "convex", "sphere")])
    if many:
        cells = np.unique(rng.integers(0, 14, (700, 3)), axis=0) * 0.1 - 0.7
        scene = scene.with_obstacle(Voxels(cells * [1, 1, 0.3] + [0, 0, 1.3], 0.04))
    margin = 0.03
    with nullcontext() if native else twin():
        valid = ValidityChecker(silvermate, scene, margin=margin)
    assert native == (valid.native is not None)
    if not native:
        assert (valid._manager is not None) is many
    space, results = silvermate.space, []
    for _ in range(25 if many else 150):
        coordinates = space.to_coordinates(silvermate.home_q)
        coordinates[:3] = rng.uniform([-2, -2, -3], [2, 2, 3])
        coordinates[3:] = np.clip(coordinates[3:] + 0.4 * rng.normal(size=7), space.lower[3:], space.upper[3:])
        q = space.from_coordinates(coordinates)
        nearest, own = link_distances(silvermate, scene, q).min(), self_distances(silvermate, q).min()
        if abs(nearest - margin) < 1e-4 or abs(own) < 1e-4:
            continue
        assert valid(q) is bool(nearest > margin and own > 0.0), (nearest, own)
        results.append(valid(q))
    assert 3 < sum(results) < len(results) - 3


def test_a_path_keeps_its_margin_at_its_nodes(silvermate):
    scene = Scene([Cylinder(0.3, 1.5, at=(2.0, 0.0, 0.75)), Sphere(0.3, at=(3.0, 1.0, 0.5))])
    start, goal = silvermate.home(), silvermate.home(x=4.0)
    found = ompl_path(silvermate, scene, start, goal, seed=0, margin=0.04, timeout=60.0)
    assert found.rows is not None, found.reason
    q = silvermate.space.from_coordinates(found.rows)
    np.testing.assert_allclose(q[[0, -1]], [start, goal], atol=1e-12)
    assert min(link_distances(silvermate, scene, row).min() for row in q) > 0.01
    assert found.checks > 0
    blocked = ompl_path(silvermate, scene, start, silvermate.home(x=2.0), seed=0, margin=0.04, timeout=1.0)
    assert blocked.rows is None
    assert "goal is nearer than 0.040 m" in blocked.reason
