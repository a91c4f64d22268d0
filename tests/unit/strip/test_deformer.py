"""The tick: what it keeps, what it reports, and that its caches change nothing."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from brute_force import link_distances, self_distances
from cases import each, refused

from elastic_strips.errors import ConfigurationError, ParameterError
from elastic_strips.planning import straight_line
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Cylinder, Scene, Sphere
from elastic_strips.strip import Deformer, DeformParams, DeformStatus, Strip
from elastic_strips.strip.paper import PaperDeformer, PaperParams
from elastic_strips.strip.resampling import node_spacing

ASIDE = Scene([Box((0.4, 0.4, 1.0), at=(2.0, 0.5, 0.5), name="box"), Sphere(0.3, at=(3.2, -0.55, 0.6), name="ball")])

ROUND = Scene([Sphere(0.3, at=(1.3, 0.5, 0.3)), Sphere(0.25, at=(2.3, -0.45, 0.5)), Sphere(0.2, at=(3.0, 0.4, 1.0))])


def line(robot: RobotModel, length: float = 4.0, spacing: float = 0.13, **goal: float) -> Strip:
    start, end = robot.home(), robot.home(x=length, **goal)
    return Strip.from_coordinates(robot, straight_line(robot, start, end, spacing=spacing))


def again(strip: Strip) -> Strip:
    """The same nodes as another object: the deformer cannot know that it is its own strip."""
    return Strip.from_coordinates(strip.robot, strip.coordinates)


@each("name", ["silvermate", "tiago", "rover"])
def test_settling_beside_obstacles(name, request):
    robot = request.getfixturevalue(name)
    strip = line(robot)
    report = Deformer(robot).settle(strip, ASIDE)
    assert report.status is DeformStatus.SETTLED, report.reason
    assert report.certified
    assert report.usable
    assert report.clearance > DeformParams().clearance
    np.testing.assert_array_equal(report.strip.q[[0, -1]], strip.q[[0, -1]])
    assert report.strip.lateral_slip.max() <= 1e-6
    nearest = min(link_distances(robot, ASIDE, q).min() for q in report.strip.q)
    assert report.node_clearance <= nearest + 1e-9
    assert report.node_clearance >= min(nearest, 0.3) - 1e-3
    before = min(link_distances(robot, ASIDE, q).min() for q in strip.q)
    assert nearest > before + 0.02, "the strip did not give way"


def test_a_fixed_arm_settles(gantry):
    strip = Strip(gantry, [gantry.home(bend=b) for b in np.linspace(-1.0, 1.5, 12)])
    tip = gantry.control_points(strip.q[6])[-1]
    scene = Scene([Sphere(0.05, at=tip + np.array([0.0, 0.0, 0.22]))])
    report = Deformer(gantry).settle(strip, scene)
    assert report.certified, report.reason
    np.testing.assert_array_equal(report.strip.q[[0, -1]], strip.q[[0, -1]])


def test_reports_add_up(silvermate):
    report = Deformer(silvermate).step(line(silvermate), ASIDE)
    assert sum(report.timings.values()) == pytest.approx(report.seconds, rel=1e-9)
    assert {"kinematics", "proximity", "forces", "solve", "rolling", "certificate"} <= set(report.timings)
    assert all(t >= 0 for t in report.timings.values())
    assert set(report.energies) == {"elastic", "repulsion", "self_collision", "joint_limits", "posture"}
    assert all(np.isfinite(e) and e >= 0 for e in report.energies.values())
    assert report.iterations == 1
    assert report.ticks == 1
    assert report.queries > 0
    assert report.forces is None
    assert report.hulls is None


def test_details_are_given_when_asked_for(silvermate):
    report = Deformer(silvermate).step(line(silvermate), ASIDE, detail=True)
    assert report.forces is not None
    assert report.hulls is not None
    assert not report.connectivity_counts, "the viewer asks for it"
    assert report.forces.points.shape == report.forces.vectors.shape
    assert len(report.forces.points) > 5
    sizes = np.linalg.norm(report.forces.vectors, axis=1)
    assert (sizes > 0).all()
    assert (sizes <= 0.3 + 0.3).all()


def test_settle_counts_what_its_ticks_did(silvermate):
    seen = []
    report = Deformer(silvermate).settle(line(silvermate), ASIDE, watch=seen.append)
    assert report.ticks == len(seen) > 1
    assert report.seconds == pytest.approx(sum(r.seconds for r in seen))
    assert report.queries == sum(r.queries for r in seen)
    assert report.strip is seen[-1].strip
    assert all(r.status is DeformStatus.DEFORMING for r in seen[:-1])
    for before, after in pairwise(seen):
        assert before.timings is not after.timings


def test_settle_until_certified_stops_early(silvermate):
    deformer = Deformer(silvermate)
    rest = deformer.settle(line(silvermate), ASIDE)
    first = deformer.settle(line(silvermate), ASIDE, until="certified")
    assert first.certified
    assert first.ticks < rest.ticks
    assert rest.status is DeformStatus.SETTLED
    assert first.status is DeformStatus.DEFORMING
    one = deformer.settle(line(silvermate), ASIDE, max_ticks=1)
    assert one.ticks == 1


def test_a_blocked_corridor_is_broken_and_says_where(silvermate):
    """A wall across the whole way: no certificate, no exception, no silent collision."""
    wall = Scene([Box((0.1, 40.0, 2.0), at=(2.0, 0.0, 1.0), name="wall")])
    report = Deformer(silvermate, DeformParams(max_nodes=80)).settle(line(silvermate), wall, max_ticks=15)
    assert report.status is DeformStatus.BROKEN
    assert not report.certified
    assert report.certificate.broken is not None
    assert report.certificate.broken.obstacle == "wall"
    assert "wall" in report.reason
    assert not report.usable


def test_a_goal_in_collision_stays_and_is_reported(silvermate):
    scene = Scene([Box((0.3, 0.3, 1.0), at=(4.0, 0.0, 0.5), name="crate")])
    strip = line(silvermate)
    report = Deformer(silvermate).settle(strip, scene, max_ticks=5)
    assert report.status is DeformStatus.BROKEN
    np.testing.assert_array_equal(report.strip.q[-1], strip.q[-1])
    assert report.certificate.broken.segment == len(report.strip) - 2


def test_the_ends_keep_every_bit(silvermate):
    """Coordinates are angles: there and back again, cos and sin may lose their last bit."""
    deformer = Deformer(silvermate)
    for yaw in np.linspace(-3.0, 3.0, 25):
        strip = Strip(silvermate, [silvermate.home(yaw=yaw), silvermate.home(x=0.1, yaw=yaw), silvermate.home(x=1.0)])
        report = deformer.step(strip, ASIDE)
        np.testing.assert_array_equal(report.strip.q[[0, -1]], strip.q[[0, -1]])


def test_an_empty_scene_settles_a_line_where_it_is(silvermate):
    strip = line(silvermate)
    report = Deformer(silvermate).settle(strip, Scene([]))
    assert report.status is DeformStatus.SETTLED
    base = report.strip.coordinates[:, :2]
    assert np.abs(base[:, 1]).max() < 1e-6
    assert (np.diff(base[:, 0]) > 0).all()


def test_equal_inputs_give_equal_results(silvermate):
    results = []
    for _ in range(2):
        deformer, strip = Deformer(silvermate), line(silvermate)
        for _ in range(6):
            report = deformer.step(strip, ASIDE)
            strip = report.strip
        results.append(report)
    np.testing.assert_array_equal(results[0].strip.q, results[1].strip.q)
    np.testing.assert_array_equal(results[0].certificate.segments, results[1].certificate.segments)
    assert results[0].energies == results[1].energies
    assert results[0].queries == results[1].queries


@pytest.mark.parametrize("scene", [pytest.param(ASIDE, id="box and ball"), pytest.param(ROUND, id="balls")])
def test_the_fast_path_equals_the_slow_one(silvermate, scene):
    """With no tolerance for stale distances, a tick on what the last one left equals one that starts from nothing, but
    for how far the last steps went well."""
    deformer, strip = Deformer(silvermate), line(silvermate)
    deformer.workspace.obstacles.tolerance = deformer.workspace.self_pairs.tolerance = 0.0
    for _ in range(15):
        other = Deformer(silvermate)
        other._trust, other._needed = deformer._trust, deformer._needed
        report, fresh = deformer.step(again(strip), scene), other.step(again(strip), scene)
        assert len(report.strip) == len(fresh.strip)
        np.testing.assert_allclose(report.strip.q, fresh.strip.q, atol=1e-6)
        np.testing.assert_array_equal(report.certificate.segments, fresh.certificate.segments)
        assert report.energies == pytest.approx(fresh.energies, rel=1e-6, abs=1e-12)
        strip = report.strip


def test_the_tolerance_for_stale_distances_changes_little(silvermate):
    deformer, strip = Deformer(silvermate), line(silvermate)
    for _ in range(12):
        report = deformer.step(again(strip), ASIDE)
        fresh = Deformer(silvermate).step(again(strip), ASIDE)
        assert len(report.strip) == len(fresh.strip)
        np.testing.assert_allclose(report.strip.q, fresh.strip.q, atol=5e-3)
        strip = report.strip
    assert report.queries < 0.5 * fresh.queries, "nothing was saved"


def test_other_strips_in_between_leave_no_trace(silvermate):
    """Certifying or assessing another strip must not change what the next step starts from."""
    other = line(silvermate, y=1.0)
    reports = []
    for disturb in (False, True):
        deformer, strip = Deformer(silvermate), line(silvermate)
        for _ in range(5):
            report = deformer.step(again(strip), ASIDE)
            strip = report.strip
            if disturb:
                deformer.certify(other, ASIDE)
                deformer.assess(other, Scene([]))
                deformer.certify(other, ASIDE)
        reports.append(deformer.step(strip, ASIDE))
    np.testing.assert_allclose(reports[0].strip.q, reports[1].strip.q, atol=5e-3)
    assert np.abs(reports[1].strip.coordinates[:, 1]).max() < 0.6


def test_the_own_strip_after_another_ones_certificate(silvermate):
    """The very object of the last report, after the workspace held another strip."""
    deformer = Deformer(silvermate)
    report = deformer.step(line(silvermate), ASIDE)
    deformer.certify(line(silvermate, y=3.0), ASIDE)
    after = deformer.step(report.strip, ASIDE)
    assert np.abs(after.strip.coordinates[:, 1]).max() < 0.6


def test_a_certified_strip_stays_certified_where_nothing_moves(silvermate):
    deformer, strip, was = Deformer(silvermate), line(silvermate), False
    for _ in range(40):
        report = deformer.step(strip, ASIDE)
        assert report.certified or not was
        was, strip = report.certified, report.strip
    assert was


def test_no_step_is_shortened_where_the_scene_has_taken_the_strip(silvermate, monkeypatch):
    shortened = []
    monkeypatch.setattr(
        Deformer, "_shortened", lambda self, before, coordinates, scene, full: shortened.append(full) or full
    )
    deformer = Deformer(silvermate)
    report = deformer.settle(line(silvermate), Scene([]), until="certified")
    post = Cylinder(0.15, 1.0, at=(2.0, 0.1, 0.5), name="post")
    report = deformer.step(report.strip, Scene([post]))
    assert not report.certified
    assert report.moved > 0.0
    assert not shortened


def test_moving_obstacles_are_followed(silvermate):
    """A ball crosses the strip slowly: it stays certified, and every certificate is true at its nodes."""
    deformer, strip = Deformer(silvermate), line(silvermate)
    certified = 0
    for y in np.linspace(-1.2, -0.15, 40):
        pose = np.eye(4)
        pose[:3, 3] = 2.0, y, 0.3
        scene = Scene([Sphere(0.2, at=(2.0, -2.0, 0.3), name="ball")]).moved("ball", pose)
        report = deformer.step(strip, scene)
        strip = report.strip
        certified += report.certified
        if report.certified:
            assert min(link_distances(silvermate, scene, q).min() for q in strip.q) > 0.005 - 1e-5
    assert certified >= 35


def test_a_snapshot_is_followed_as_well_as_a_new_scene(silvermate):
    base = Scene([Sphere(0.2, at=(2.0, -0.8, 0.3), name="ball"), Box((0.2, 0.2, 1.0), at=(1.0, 0.7, 0.5))])
    strips = []
    for derived in (True, False):
        deformer, strip, scene = Deformer(silvermate), line(silvermate), base
        for y in np.linspace(-0.8, -0.4, 8):
            pose = np.eye(4)
            pose[:3, 3] = 2.0, y, 0.3
            scene = scene.moved("ball", pose)
            given = scene if derived else Scene(list(scene.obstacles))
            strip = deformer.step(again(strip), given).strip
        strips.append(strip)
    np.testing.assert_allclose(strips[0].q, strips[1].q, atol=5e-3)


def test_the_budget_makes_more_iterations(silvermate):
    deformer = Deformer(silvermate)
    one = deformer.step(line(silvermate), ASIDE)
    many = deformer.step(line(silvermate), ASIDE, budget=30.0)  # it comes to rest long before
    assert one.iterations == 1
    assert many.iterations > 1
    tiny = deformer.step(line(silvermate), ASIDE, budget=1e-9)
    assert tiny.iterations == 1


@each("budget", [0, -1.0, float("nan"), "fast", True])
def test_budgets_are_positive_numbers(silvermate, budget):
    with refused(ParameterError, "budget="):
        Deformer(silvermate).step(line(silvermate), ASIDE, budget=budget)


@each("options", [{"until": "never"}, {"max_ticks": 0}, {"max_ticks": -3}])
def test_settle_refuses(silvermate, options):
    with pytest.raises(ParameterError, match=next(iter(options))):
        Deformer(silvermate).settle(line(silvermate), ASIDE, **options)


def test_strips_of_other_robots_are_refused(silvermate, tiago):
    with refused(ConfigurationError, "'tiago'", "'silvermate'"):
        Deformer(silvermate).step(line(tiago), ASIDE)
    with pytest.raises(ConfigurationError):
        Deformer(silvermate).certify(line(tiago), ASIDE)


def test_two_nodes_are_a_strip(silvermate):
    strip = Strip(silvermate, [silvermate.home(), silvermate.home(x=0.1)])
    report = Deformer(silvermate).settle(strip, ASIDE)
    assert report.status is DeformStatus.SETTLED


def test_two_nodes_that_slip_are_a_report_and_no_exception(silvermate):
    strip = Strip(silvermate, [silvermate.home(), silvermate.home(x=0.1, y=0.05)])
    report = Deformer(silvermate).step(strip, Scene([]))
    assert not report.usable


def test_nodes_can_be_left_alone(silvermate):
    strip = line(silvermate, spacing=0.5)
    assert len(Deformer(silvermate).step(strip, ASIDE, nodes=False).strip) == len(strip)
    assert len(Deformer(silvermate).step(strip, ASIDE).strip) > len(strip)


def test_no_step_is_longer_than_its_bound(silvermate):
    params = DeformParams(max_step=0.02)
    scene = Scene([Cylinder(0.2, 1.0, at=(2.0, 0.1, 0.5))])
    deformer, strip = Deformer(silvermate, params), line(silvermate)
    for _ in range(5):
        report = deformer.step(strip, scene, nodes=False)
        moved = [pin.difference(silvermate.model, a, b) for a, b in zip(strip.q, report.strip.q, strict=True)]
        base = np.abs(np.array(moved)[:, :2]).max()
        assert base <= 3.0 * params.max_step, base  # the projection onto what can be driven comes on top
        assert report.moved >= base - 1e-9
        strip = report.strip


def test_a_report_cannot_be_changed(silvermate):
    report = Deformer(silvermate).step(line(silvermate), ASIDE)
    with pytest.raises(AttributeError):
        report.status = DeformStatus.SETTLED
    with refused(ValueError, "read-only"):
        report.strip.q[0] = 0.0


def test_old_strips_do_not_change(silvermate):
    deformer, strip, kept = Deformer(silvermate), line(silvermate), []
    for _ in range(4):
        report = deformer.step(strip, ASIDE)
        kept.append(
            (report.strip, report.strip.q.copy(), report.strip.coordinates.copy(), report.certificate.segments.copy())
        )
        strip = report.strip
    for old, q, coordinates, segments in kept:
        np.testing.assert_array_equal(old.q, q)
        np.testing.assert_array_equal(old.coordinates, coordinates)
        assert len(segments) == len(q) - 1


def test_the_papers_preset_keeps_its_nodes_and_ends(silvermate):
    deformer = PaperDeformer(silvermate, PaperParams(max_ticks=10))
    strip = line(silvermate, spacing=0.2)
    report = deformer.settle(strip, ASIDE)
    assert len(report.strip) == len(strip)
    np.testing.assert_array_equal(report.strip.q[[0, -1]], strip.q[[0, -1]])
    assert report.hulls is not None
    assert 0.0 < report.heading_step <= np.pi / 3 + 1e-12
    silvermate.check_q(report.strip.q)


def test_an_assessment_moves_nothing(silvermate):
    strip = line(silvermate)
    report = Deformer(silvermate).assess(strip, ASIDE)
    np.testing.assert_array_equal(report.strip.q, strip.q)
    assert report.iterations == 0
    assert report.moved == 0.0
    assert report.certificate.segments.tolist() == Deformer(silvermate).certify(strip, ASIDE).segments.tolist()


@each("base", ["diff_drive", "omni"])
@each("deformer", [Deformer, PaperDeformer])
def test_a_robot_that_is_a_base_and_nothing_else(tmp_path, base, deformer):
    """No joints and no self pairs: every array about them is empty."""
    path = tmp_path / "cart.urdf"
    shape = '<collision><geometry><cylinder radius="0.3" length="0.4"/></geometry></collision>'
    path.write_text(f'<robot name="cart"><link name="cart">{shape}</link></robot>')
    cart = load_robot(path, base=base)
    assert (cart.nv, len(cart.self_pairs)) == (3, 0)
    scene = Scene([Box((0.4, 0.4, 1.0), at=(2.0, 0.5, 0.5))])
    report = deformer(cart).settle(line(cart), scene)
    assert report.certified, report.reason
    assert np.abs(report.strip.coordinates[:, 1]).max() > 0.02


def test_the_papers_mobile_force_acts_at_the_base(silvermate):
    """A robot whose only control point is its hand: what pushes the hand must not displace the base like its own."""
    robot = load_robot("silvermate", control_points={"hand": "hand_frame"})
    hand = robot.control_points(robot.home())[0]
    q = [robot.home(x=x) for x in np.linspace(0.0, 2.0, 11)]
    scene = Scene([Sphere(0.1, at=(1.0 + hand[0], hand[1] + 0.3, hand[2]))])
    params = PaperParams(updates=1, influence=0.6)
    report = PaperDeformer(robot, params).step(Strip(robot, q), scene)
    np.testing.assert_allclose(report.strip.coordinates[:, :2], Strip(robot, q).coordinates[:, :2], atol=1e-9)


WHEELED_PAIR = """<robot name="pair">
  <link name="body"><collision><geometry><box size="{size} 0.2 0.2"/></geometry></collision></link>
  <link name="upper"><collision><origin xyz="0.2 0 0"/><geometry><box size="0.3 0.1 0.1"/></geometry></collision></link>
  <link name="lower"><collision><origin xyz="0.2 0 0"/><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="shoulder" type="revolute"><parent link="body"/><child link="upper"/><origin xyz="0 0 0.5"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.4 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
</robot>"""


def test_a_strip_of_another_shape_is_refused(tmp_path):
    """Kinematics alone do not make a robot: the narrow one's proof says nothing of the wide one."""
    robots = []
    for size in (0.2, 0.9):
        path = tmp_path / f"pair_{size}.urdf"
        path.write_text(WHEELED_PAIR.format(size=size))
        robots.append(load_robot(path, base="omni"))
    narrow, wide = robots
    strip = Strip(wide, [wide.home(), wide.home(y=1.0)])
    deformer = Deformer(narrow)
    for call in (deformer.step, deformer.settle, deformer.certify, deformer.assess):
        with refused(ConfigurationError, "shapes"):
            call(strip, Scene([]))
    again = load_robot(tmp_path / "pair_0.2.urdf", base="omni")
    assert deformer.certify(Strip(again, [again.home(), again.home(y=1.0)]), Scene([])).certified


def test_a_fresh_deformer_does_not_lose_the_certificate_of_what_it_is_given():
    """Baxter at home has its elbows near its shoulders: a first step into the forces' balance pushes them together."""
    baxter = load_robot("baxter", base="omni")
    scene = Scene([Box((0.3, 0.3, 0.3), at=(2.0, 1.6, 0.5))])
    strip = line(baxter, 2.0, y=0.5)
    assert Deformer(baxter).certify(strip, scene).certified
    deformer = Deformer(baxter)
    for _ in range(5):
        report = deformer.step(strip, scene)
        assert report.certified, report.reason
        strip = report.strip
    assert report.moved > 0.0


def test_taking_out_a_node_does_not_lose_the_certificate(tmp_path):
    """A node that crowds its neighbours may be the one that leads around something."""
    path = tmp_path / "ball.urdf"
    path.write_text(
        '<robot name="ball"><link name="ball"><collision><geometry><sphere radius="0.1"/></geometry></collision>'
        "</link></robot>"
    )
    ball = load_robot(path, base="omni")
    post = Scene([Cylinder(0.05, 1.0, at=(0.2, -0.05, 0.0), name="post")])
    strip = Strip(ball, [ball.home(), ball.home(x=0.2, y=0.2), ball.home(x=0.4)])
    params = DeformParams(influence=0.01, min_spacing=0.65, max_spacing=0.7, k_c=1e-6)
    deformer = Deformer(ball, params)
    assert deformer.certify(strip, post).certified
    assert not deformer.certify(Strip(ball, strip.q[[0, 2]]), post).certified
    report = deformer.step(strip, post)
    assert report.certified, report.reason
    for _ in range(10):  # what was needed is not taken out again at once
        report = deformer.step(report.strip, Scene([]))
    assert len(report.strip) == 2, "nothing stood in the way, and the node stayed"


def test_nodes_that_something_in_the_way_brought_go_again_when_it_has_gone(silvermate):
    """A strip that was divided finely is as coarse again as it needs to be, and certified all the time."""
    deformer, strip = Deformer(silvermate), line(silvermate)
    few = len(deformer.settle(strip, Scene([])).strip)
    rows = line(silvermate).coordinates
    fine = silvermate.space.interpolate(rows[:1], rows[-1:], np.linspace(0.0, 1.0, 12 * len(rows)))
    post = Scene([Cylinder(0.2, 1.5, at=(float(rows[-1, 0]) / 2, 0.9, 0.75), name="post")])
    strip = Strip.from_coordinates(silvermate, fine)
    for _ in range(30):
        report = deformer.step(strip, post)
        strip = report.strip
        assert report.certified
    assert len(strip) <= 2 * few + 2
    spacing = node_spacing(silvermate.space, strip.coordinates, deformer.spacing_weight)
    assert spacing.max() <= deformer.params.max_spacing * (1.0 + 1e-6)


def test_a_low_ceiling_does_not_press_an_arm_into_itself(bridge_arm):
    """The robot's own links push back harder than what presses them together."""
    folded = (2.05, -0.06, -2.8, -2.0, 0.06, 0.6)
    coordinates = np.zeros((12, bridge_arm.nv))
    coordinates[:, 0], coordinates[:, 3:] = np.linspace(0.0, 1.2, 12), folded
    scene = Scene([Box((6, 6, 0.1), at=(0, 0, 0.62))])
    deformer = Deformer(bridge_arm, DeformParams(clearance=0.025))
    strip = Strip.from_coordinates(bridge_arm, coordinates)
    for _ in range(60):
        report = deformer.step(strip, scene)
        strip = report.strip
    assert report.certified, report.reason
    assert min(self_distances(bridge_arm, q).min() for q in strip.q[1:-1]) > 0.004


def test_a_clearance_that_was_eased_can_be_had_again_and_no_more_than_the_deformer_was_made_for(silvermate):
    """Pairs that are proven to keep what it was made for are left out, whatever it keeps in between."""
    deformer = Deformer(silvermate, DeformParams(self_clearance=4e-3))
    deformer.keep_clearance(0.02, 5e-4)
    deformer.keep_clearance(0.03)
    assert deformer.params.self_clearance == 5e-4
    for own in (4.1e-3, float("inf")):
        with pytest.raises(ParameterError):
            deformer.keep_clearance(0.03, own)
    assert deformer.params.self_clearance == 5e-4  # what is refused changes nothing
    deformer.keep_clearance(0.01, 4e-3)
    line = Strip.from_coordinates(
        silvermate, straight_line(silvermate, silvermate.home(), silvermate.home(x=1.0), spacing=0.25)
    )
    fresh = Deformer(silvermate, DeformParams(clearance=0.01, self_clearance=4e-3))
    assert deformer.params == fresh.params
    assert deformer.certify(line, Scene([])).certified == fresh.certify(line, Scene([])).certified is True
