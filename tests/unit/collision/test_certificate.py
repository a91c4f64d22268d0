"""Certificates: what is proven, what is refused, and how a broken strip says where and why."""

from __future__ import annotations

from itertools import pairwise

import coal
import numpy as np
import pinocchio as pin
import pytest
from brute_force import configuration, link_distances, self_distances
from cases import each, each_robot

from elastic_strips.collision import BrokenSegment, SegmentState
from elastic_strips.collision.bounds import BodySet
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Cylinder, Points, Scene, Sphere, Voxels
from elastic_strips.strip import Deformer, DeformParams, Strip, strip_clearance
from elastic_strips.strip.paper import PaperDeformer, PaperParams


def drive(robot: RobotModel, *x: float, **joints: float) -> Strip:
    """Home postures along the x axis."""
    return Strip(robot, [robot.home(x=v, **joints) for v in x])


def certify(strip: Strip, scene: Scene, **params: float):
    return Deformer(strip.robot, DeformParams(**params)).certify(strip, scene)


@each_robot
def test_an_empty_scene_is_certified(robot):
    home = robot.home_q
    certificate = certify(Strip(robot, [home, home, home]), Scene([]))
    assert certificate.certified
    assert certificate.segments.tolist() == [True, True]
    assert certificate.broken is None
    assert certificate.clearance == DeformParams().clearance


@pytest.mark.parametrize("radius, size", [(0.1, 0.3), (0.004, 1.5)])
def test_an_obstacle_between_two_free_nodes_is_found(silvermate, radius, size):
    """The straight line goes through: both nodes are free, the segment is not."""
    scene = Scene([Cylinder(radius, size, at=(1.0, 0.0, size / 2), name="post")])
    strip = drive(silvermate, 0.0, 2.0, 4.0)
    assert min(link_distances(silvermate, scene, q).min() for q in strip.q) > 0.3
    certificate = certify(strip, scene)
    assert certificate.segments.tolist() == [False, True]
    assert not certificate.certified
    broken = certificate.broken
    assert isinstance(broken, BrokenSegment)
    assert (broken.segment, broken.obstacle, broken.kind, broken.certain) == (0, "post", "obstacle", True)
    assert broken.link in {g.name for g in silvermate.geometries}
    assert broken.clearance <= certificate.clearance
    link = broken.link.removesuffix("_0")
    assert link in {name for g in silvermate.geometries for name in g.links}
    how = f"is {-1e3 * broken.clearance:.1f} mm deep in" if broken.clearance < 0.0 else "comes within"
    assert str(broken).startswith(f"segment 0: {link} {how} ")
    assert certificate.states.tolist() == [SegmentState.COLLIDING, SegmentState.CERTIFIED]


def test_the_report_names_link_and_obstacle_and_its_distance(silvermate):
    """Only the hand is near something: the measured clearance is that of a configuration on the segment."""
    q = silvermate.home()
    hand = silvermate.control_points(q)[-1]
    scene = Scene(
        [Sphere(0.05, at=hand + np.array([1.0, 0.0, 0.0]), name="lamp"), Box((0.2, 0.2, 0.2), at=(0, 3, 0.2))]
    )
    strip = drive(silvermate, 0.0, 2.0)
    broken = certify(strip, scene).broken
    assert broken is not None
    assert broken.obstacle == "lamp"
    assert broken.link.split("_link")[0] in {"palm", "arm_7", "arm_6", "arm_5"}
    fractions = np.linspace(0.0, 1.0, 4001)
    g = [p.name for p in silvermate.geometries].index(broken.link)
    coordinates = silvermate.space.interpolate(strip.coordinates[:1], strip.coordinates[1:], fractions)
    found = [
        link_distances(silvermate, scene, configuration(silvermate, row))[g, 0] for row in coordinates[1500:2500:10]
    ]
    assert min(found) - 0.01 <= broken.clearance <= 0.005


def test_a_node_in_collision_breaks_both_its_segments(silvermate):
    scene = Scene([Box((0.2, 0.2, 0.5), at=(1.0, 0.0, 0.25), name="crate")])
    certificate = certify(drive(silvermate, -1.0, 0.0, 1.0, 2.0, 3.0), scene)
    assert certificate.segments.tolist() == [True, False, False, True]
    assert certificate.broken is not None
    assert certificate.broken.obstacle == "crate"
    assert certificate.broken.clearance < 0.0


@pytest.mark.parametrize("end", [0, 1])
def test_a_colliding_end_breaks_the_only_segment(silvermate, end):
    scene = Scene([Box((0.2, 0.2, 0.5), at=(3.0 * end, 0.0, 0.25))])
    assert certify(drive(silvermate, 0.0, 3.0), scene).segments.tolist() == [False]


def test_self_collision_between_nodes_is_found(silvermate):
    """Two free postures whose straight joint-space way leads through the robot's own body."""
    rng, space = np.random.default_rng(2), silvermate.space
    home, found = space.to_coordinates(silvermate.home_q), 0
    pairs = {(silvermate.geometries[i].name, silvermate.geometries[k].name) for i, k in silvermate.self_pairs}

    def apart(row: np.ndarray) -> float:
        return float(self_distances(silvermate, configuration(silvermate, row)).min())

    for _ in range(4000):
        ends = np.tile(home, (2, 1))
        ends[:, 3:] = rng.uniform(space.lower[3:], space.upper[3:], (2, 7))
        if apart(ends[0]) < 0.01 or apart(ends[1]) < 0.01:
            continue
        middle = space.interpolate(ends[:1], ends[1:], np.linspace(0.2, 0.8, 7))
        if min(apart(row) for row in middle) > -0.005:
            continue
        certificate = certify(Strip.from_coordinates(silvermate, ends), Scene([]))
        assert not certificate.certified
        broken = certificate.broken
        assert broken is not None
        assert broken.kind == "self"
        assert (broken.link, broken.obstacle) in pairs
        found += 1
        if found == 5:
            return
    pytest.fail("no such postures were found")


def test_clearance_decides_to_a_tenth_of_a_millimetre(silvermate):
    """A wall alongside: certified against what it keeps, refused against more."""
    base = silvermate.geometries[0].geometry.radius
    for gap, clearance, expected in (
        (0.0203, 0.02, True),
        (0.0198, 0.02, False),
        (0.0053, 0.005, True),
        (0.0048, 0.005, False),
    ):
        wall = Scene([Box((9.0, 0.1, 0.3), at=(0.0, base + gap + 0.05, 0.15), name="wall")])
        certificate = certify(drive(silvermate, 0.0, 0.5, 1.0), wall, clearance=clearance)
        assert certificate.certified is expected, (gap, clearance)


def test_undecidable_is_unknown_and_not_safe(silvermate):
    """At the depth floor nothing is decided: with one halving a post beside a long segment stays open."""
    deformer = Deformer(silvermate)
    deformer.workspace.certifier.max_depth = 1
    scene = Scene([Cylinder(0.05, 0.5, at=(1.0, 0.45, 0.25), name="post")])
    certificate = deformer.certify(drive(silvermate, 0.0, 2.0), scene)
    assert not certificate.certified
    assert certificate.states.tolist() == [SegmentState.UNKNOWN]
    broken = certificate.broken
    assert broken is not None
    assert not broken.certain
    assert "could not be proven clear of post" in str(broken)
    deformer.workspace.certifier.max_depth = 12
    assert deformer.certify(drive(silvermate, 0.0, 2.0), scene).certified


def test_a_long_segment_does_not_overlook_what_lies_between(silvermate):
    """The window of near parts is collected about the nodes: far between them something may stand."""
    for x in (2.0, 10.0, 24.0):
        scene = Scene([Sphere(0.2, at=(x, 0.1, 0.2), name="ball")])
        assert not certify(drive(silvermate, 0.0, 25.0), scene).certified
    aside = Scene([Sphere(0.2, at=(10.0, 2.0, 0.2))])
    assert certify(drive(silvermate, *np.linspace(0.0, 25.0, 60)), aside).certified


def test_a_very_long_segment_is_looked_at_all_along(silvermate):
    for x, y, free in ((0.0, 1.5, True), (101.3, 1.5, True), (101.3, 0.1, False), (199.0, 0.3, False)):
        scene = Scene([Sphere(0.2, at=(x, y, 0.2))])
        certificate = certify(drive(silvermate, 0.0, 200.0), scene)
        assert certificate.certified is free, (x, y)
        assert (certificate.states == SegmentState.COLLIDING).all() == (not free)


def test_turning_in_place_with_the_arm_out_is_proven(tiago):
    """The hand's arc leads far out of the boxes about the two ends; what is nowhere near it must not count."""
    out = {"arm_1_joint": 1.5, "arm_2_joint": 0.0, "arm_4_joint": 0.0}
    strip = Strip(tiago, [tiago.home(joints=out), tiago.home(yaw=3.1, joints=out)])
    assert certify(strip, Scene([Sphere(0.2, at=(500.0, 0.0, 0.2))])).certified
    hand = tiago.control_points(Strip(tiago, strip.q).sample(0.01)[155])[-1]
    on_the_arc = Scene([Sphere(0.05, at=hand), Sphere(0.2, at=(500.0, 0.0, 0.2))])
    assert not certify(strip, on_the_arc).certified


@each("yaw", [np.pi, -np.pi])
@each("at", [0.0, 1.0, -2.5])
def test_nothing_is_proven_of_half_a_turn(rover, yaw, at):
    """Rounding decides which way Pinocchio turns: there is no one interpolant to certify."""
    strip = Strip(rover, [rover.home(yaw=at), rover.home(x=0.5, yaw=at + yaw)])
    certificate = certify(strip, Scene([]))
    assert certificate.states.tolist() == [SegmentState.UNKNOWN]
    assert certificate.broken is not None
    assert "half a turn" in str(certificate.broken)
    settled = Deformer(rover).settle(strip, Scene([]))  # which puts a node between
    assert settled.certified
    for a, b in pairwise(settled.strip.q):
        ours = rover.space.interpolate(*rover.space.to_coordinates(np.stack((a, b)))[:, None], np.array([0.3]))
        np.testing.assert_allclose(
            rover.space.from_coordinates(ours)[0], pin.interpolate(rover.model, a, b, 0.3), atol=1e-9
        )


def test_nothing_is_proven_of_half_a_turn_of_a_joint():
    model = pin.Model()
    model.addJoint(0, pin.JointModelRUBZ(), pin.SE3.Identity(), "spin")
    collision = pin.GeometryModel()
    collision.addGeometryObject(pin.GeometryObject("ball", 1, 0, pin.SE3.Identity(), coal.Sphere(0.1)))
    spinner = RobotModel.from_pinocchio(model, collision)
    for spins, proven in (((0.0, np.pi), False), ((1.0, 1.0 - np.pi), False), ((0.0, 1.0, np.pi), True)):
        certificate = certify(Strip(spinner, [spinner.home(spin=s) for s in spins]), Scene([]))
        assert certificate.certified is proven, spins
        assert proven or "half a turn" in str(certificate.broken)


def test_the_clearance_of_half_a_turn_counts_both_ways(rover):
    strip = Strip(rover, [rover.home(), rover.home(x=0.6, yaw=np.pi)])
    for y in (0.5, -0.5):
        scene = Scene([Sphere(0.1, at=(0.3, y, 0.1))])
        there = min(
            link_distances(rover, scene, q).min()
            for between in ([0.3, 0.35, np.pi / 2], [0.3, -0.35, -np.pi / 2])
            for a, b in pairwise([strip.q[0], rover.home(*between), strip.q[1]])
            for q in (pin.interpolate(rover.model, a, b, s) for s in np.linspace(0, 1, 50))
        )
        assert strip_clearance(strip, scene) <= there


def test_a_node_just_outside_the_clearance_is_not_called_colliding(silvermate):
    """Bounds that are stale by less than the tolerance are made exact before a node is given up."""
    deformer = Deformer(silvermate, DeformParams(clearance=0.05))
    strip = drive(silvermate, 0.0, 0.1, 0.2)
    wall = Scene([Box((0.2, 2.0, 0.3), at=(0.75, 0.0, 0.15), name="wall")])
    deformer.certify(strip, wall)
    free = float(deformer.workspace.obstacles.clearance().min())
    scene = Scene([Box((0.2, 2.0, 0.3), at=(0.75 + 0.05 + 1e-4 - free, 0.0, 0.15), name="wall")])
    assert deformer.certify(strip, scene).certified
    coordinates = strip.coordinates.copy()
    coordinates[:, 1] += 2.5e-4  # along the wall
    assert deformer.certify(Strip.from_coordinates(silvermate, coordinates), scene).certified


def test_turning_and_backward_arcs_are_swept(silvermate):
    """The hand's sweep while the base turns, and the screw arc instead of the chord."""
    q = silvermate.home()
    hand = silvermate.control_points(q)[-1]
    angle = 0.5 * (np.arctan2(hand[1], hand[0]) + np.arctan2(hand[1], hand[0]) + 1.2)
    at = np.hypot(hand[0], hand[1]) * np.array([np.cos(angle), np.sin(angle)])
    scene = Scene([Sphere(0.05, at=(*at, hand[2]), name="lamp")])
    turn = Strip(silvermate, [silvermate.home(), silvermate.home(yaw=1.2)])
    broken = certify(turn, scene).broken
    assert broken is not None
    assert broken.obstacle == "lamp"
    # a half circle of radius 0.35 m: the post on the arc is hit, the one at its centre is not
    arc = Strip(silvermate, [silvermate.home(), silvermate.home(x=0.0, y=0.7, yaw=np.pi - 1e-3)])
    on_arc = Scene([Cylinder(0.01, 0.15, at=(0.35, 0.35, 0.075), name="post")])
    at_centre = Scene([Cylinder(0.01, 0.15, at=(0.0, 0.35, 0.075), name="post")])
    assert not certify(arc, on_arc).certified
    assert certify(arc, at_centre).certified


def test_blocks_of_boxes_are_obstacles_too(silvermate):
    scene = Scene([Voxels([(1.0, 0.0, 0.1)], 0.02, name="crumb"), Points([(3.0, 0.0, 0.1)], 0.005, name="dust")])
    certificate = certify(drive(silvermate, 0.0, 2.0, 4.0, 6.0), scene)
    assert certificate.segments.tolist() == [False, False, True]


def test_the_certificate_after_a_deformation_is_the_one_of_a_fresh_workspace(silvermate):
    """Stale bounds within a step's tolerance must not certify more than fresh ones."""
    scene = Scene([Box((0.4, 0.4, 1.0), at=(2.0, 0.45, 0.5)), Cylinder(0.1, 1.0, at=(1.0, -0.5, 0.5))])
    strip = drive(silvermate, *np.linspace(0.0, 4.0, 25))
    deformer = Deformer(silvermate)
    for _ in range(8):
        report = deformer.step(strip, scene)
        strip = report.strip
        fresh = certify(strip, scene)
        disagree = report.certificate.segments & ~fresh.segments
        assert not disagree.any()


def test_what_is_known_is_not_looked_at_again(silvermate):
    """With and without the kernel: the rest is decided as ever, and what is said to be known stays certified."""
    scene = Scene([Box((0.4, 0.4, 1.0), at=(2.0, 0.45, 0.5)), Cylinder(0.1, 1.0, at=(4.0, 0.0, 0.5))])
    strip = drive(silvermate, *np.linspace(0.0, 6.0, 13))
    work = Deformer(silvermate).workspace
    work.load(strip, scene)
    whole = work.certify(scene)
    assert 0 < whole.segments.sum() < len(strip) - 1
    some = whole.segments & (np.arange(len(strip) - 1) % 2 == 0)
    work.load(strip, scene)
    part = work.certify(scene, some)
    np.testing.assert_array_equal(part.segments, whole.segments)
    np.testing.assert_array_equal(part.states, whole.states)
    assert part.broken == whole.broken
    between = Scene([Cylinder(0.05, 0.5, at=(3.0, 0.0, 0.25), name="post")])
    strip = drive(silvermate, 0.0, 2.0, 4.0, 6.0)
    work.load(strip, between)
    assert work.certify(between).segments.tolist() == [True, False, True]
    assert work.certify(between, np.array([True, True, False])).certified


def test_a_clearance_beyond_the_paper_presets_reach(silvermate):
    """The paper preset measures links up to 0.3 m: a larger clearance must not be certified from what was not seen."""
    deformer = PaperDeformer(silvermate, PaperParams(clearance=0.5))
    base = silvermate.geometries[0].geometry.radius
    wall = Scene([Box((30.0, 0.1, 1.0), at=(0.0, base + 0.05 + 0.76, 0.5), name="wall")])
    for y in (0.0, 0.1, 0.2, 0.3):
        strip = Strip(silvermate, [silvermate.home(x=x, y=y) for x in np.linspace(0.0, 2.0, 12)])
        certificate = deformer.certify(strip, wall)
        nearest = min(link_distances(silvermate, wall, q).min() for q in strip.q)
        assert certificate.certified is bool(nearest > 0.5), (y, nearest)


def test_clearance_along_the_strip(silvermate):
    """Between the nodes the strip is nearer than at them."""
    base = silvermate.geometries[0].geometry.radius
    scene = Scene([Cylinder(0.1, 0.3, at=(1.0, 0.7, 0.15))])
    strip = drive(silvermate, 0.0, 2.0)
    value = strip_clearance(strip, scene)
    assert value == pytest.approx(0.7 - 0.1 - base, abs=2e-4)
    assert value <= 0.7 - 0.1 - base
    through = Scene([Cylinder(0.1, 0.3, at=(1.0, 0.2, 0.15))])
    assert strip_clearance(strip, through) < -0.05
    assert strip_clearance(strip, Scene([])) == np.inf
    far = Scene([Sphere(0.5, at=(0.0, 20.0, 0.5))])
    coordinates = strip.robot.space.interpolate(strip.coordinates[:1], strip.coordinates[1:], np.linspace(0, 1, 41))
    truth = min(link_distances(silvermate, far, configuration(silvermate, row)).min() for row in coordinates)
    assert strip_clearance(strip, far) == pytest.approx(truth, abs=1e-3)


def test_clearance_of_a_strip_far_from_everything(silvermate):
    assert strip_clearance(drive(silvermate, 0.0, 1.0), Scene([Sphere(0.5, at=(900.0, 0.0, 0.0))])) > 90.0


@each_robot
def test_clearance_equals_dense_sampling(robot, rng):
    from brute_force import make_scene, random_coordinates

    for _ in range(2):
        scene = make_scene(rng, 6)
        coordinates = random_coordinates(robot, rng, 1)
        step = rng.normal(size=(2, robot.nv)) * 0.1
        for v in step:
            coordinates = np.vstack((coordinates, robot.space.integrate(coordinates[-1], v)))
        coordinates = np.clip(coordinates, robot.space.lower, robot.space.upper)
        strip = Strip.from_coordinates(robot, coordinates)
        rows = np.vstack(
            [robot.space.interpolate(a[None], b[None], np.linspace(0, 1, 40)) for a, b in pairwise(coordinates)]
        )
        truth = min(link_distances(robot, scene, configuration(robot, row)).min() for row in rows)
        value = strip_clearance(strip, scene)
        assert value <= truth + 1e-6
        assert value >= truth - 0.01


@each(
    "clearance, certain, says",
    [
        (-0.2124, True, "segment 3: base_link is 212.4 mm deep in shelf-1"),
        (0.012, True, "segment 3: base_link comes within 12.0 mm of shelf-1"),
        (0.012, False, "segment 3: base_link could not be proven clear of shelf-1 (12.0 mm)"),
    ],
)
def test_a_broken_segment_is_said_in_words(clearance, certain, says):
    """With the names that a URDF has, where they are known."""
    broken = BrokenSegment(3, "base_link_0", "shelf-1", clearance, "obstacle", certain, ("base_link", "shelf-1"))
    assert str(broken) == says
    plain = BrokenSegment(3, "base_link_0", "shelf-1", clearance, "obstacle", certain)
    assert str(plain) == says.replace("base_link", "base_link_0")


@each("y, says", [(0.3, False), (0.59, True)])
def test_what_was_to_be_kept_is_said_where_nothing_touches(silvermate, y, says):
    """A post beside the way: in it, or 1 or 2 cm from it where 5 cm are asked for."""
    certificate = certify(drive(silvermate, 0.0, 2.0), Scene([Box((0.2, 0.6, 1.0), at=(1.0, y, 0.5))]), clearance=0.05)
    broken = certificate.broken
    assert broken is not None
    assert broken.required == 0.05
    assert ("50 mm" in str(broken)) is says
    assert (broken.clearance > 0.0) is says


def test_messages_name_the_links_of_the_urdf(gantry):
    """A link of several pieces keeps their names, as does a hull of several links."""
    labels = dict(zip(BodySet.links(gantry).names, BodySet.links(gantry).labels, strict=True))
    assert labels["rail_0"] == "rail"
    assert labels["finger_0"] == "finger_0"
    assert labels["finger_1"] == "finger_1"
    assert all(label == name for name, label in labels.items() if "+" in name)
