"""Planning ticks: a certified motion is followed for two of them, unless something is not as it was expected."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from cases import each

from elastic_strips.collision import BrokenSegment, Certificate
from elastic_strips.control import DriveParams, LocalPlanner, local_planner
from elastic_strips.control.strip_timer import PlanOutcome
from elastic_strips.planning import straight_line
from elastic_strips.scene import UNSEEN_LAYER, Box, Cylinder, Obstacle, Scene, Twist, UnknownMotion
from elastic_strips.strip import Strip
from elastic_strips.strip.followed import FollowedPath
from elastic_strips.trajectory import MotionLimits, RetimingError
from elastic_strips.trajectory.trajectory import stationary

PILLAR = Cylinder(0.2, 1.4, at=(2.6, -0.9, 0.7), name="pillar")
WALKER = Cylinder(0.25, 1.7, at=(2.0, -4.5, 0.85), name="walker", motion=Twist((0.0, 0.5, 0.0)))
PARAMS = DriveParams()
PERIOD = PARAMS.plan_every * PARAMS.control_dt


class Ride:
    """Ticks one after the other; what is proposed is held, as by a supervisor that takes it all."""

    def __init__(self, robot, scene: Scene, params: DriveParams = PARAMS) -> None:
        limits = MotionLimits.for_robot(robot)
        strip = Strip.from_coordinates(robot, straight_line(robot, robot.home(), robot.home(x=4.0), spacing=0.2))
        self.planner = LocalPlanner(robot, limits, params, strip)
        self.active = stationary(robot, limits, strip.coordinates[0], 0.0, 0.01)
        self.time, self.scene = 0.0, scene
        self.deformed: list[bool] = []
        step = self.planner.deformer.step

        def counted(*args, **kwargs):
            self._steps += 1
            return step(*args, **kwargs)

        self.planner.deformer.step = counted
        self._steps = 0

    def tick(self, scene: Scene | None = None):
        scene = self.scene.at(self.time) if scene is None else scene
        self._steps = 0
        result = self.planner.tick(self.time, scene, self.active, self.time + 0.02)
        self.deformed.append(self._steps > 0)
        if result.accepted:
            self.active = result.motion
        self.time += PERIOD
        return result


@pytest.mark.parametrize("obstacles", [[PILLAR], [PILLAR, WALKER]], ids=["still", "moving"])
def test_a_certified_motion_is_followed_for_two_ticks(silvermate, obstacles):
    ride = Ride(silvermate, Scene(obstacles))
    proposals = [ride.tick() for _ in range(12)]
    assert ride.deformed == [True, False] * 6
    for new, kept in zip(proposals[::2], proposals[1::2], strict=True):
        assert new.accepted
        assert kept.outcome is PlanOutcome.UNCHANGED
        assert kept.motion is new.motion
        # what is kept is indeed certified against the newer scene, and does not have to brake before the next
        assert ride.planner.certify(kept.motion.tail(ride.time), ride.scene.at(ride.time)).certified
    speeds = [p.motion.at(p.motion.start_time + 3 * PERIOD).v[0] for p in proposals[::2]]
    assert np.all(np.diff(speeds) >= -1e-6)  # it gathers speed and keeps it


@each("aside, yaw", list(itertools.product([1e-4, 0.004, 0.03, 0.045, 0.2], [0.0, 0.4, 3.0])))
def test_who_has_left_the_strip_at_its_end_still_arrives(silvermate, aside, yaw):
    """Beside the goal by less than nodes are apart: wheels cannot go there sideways, and have to turn, and back up."""
    ride = Ride(silvermate, Scene([WALKER]))
    row = silvermate.space.to_coordinates(silvermate.home(x=4.0, y=aside, yaw=yaw))
    ride.active = stationary(silvermate, ride.planner.limits, row, 0.0, 0.01)
    ride.planner.off_strip = True
    outcomes = []
    while PlanOutcome.ARRIVE not in outcomes and len(outcomes) < 300:
        outcomes.append(ride.tick().outcome)
    assert outcomes[-1] is PlanOutcome.ARRIVE


def test_a_motion_that_leads_nowhere_is_none(silvermate):
    """A strip of one segment that the wheels cannot follow: there is something to replan."""
    ride = Ride(silvermate, Scene([PILLAR]))
    here, goal = silvermate.home(x=4.0, y=0.04), silvermate.home(x=4.0)
    rows = silvermate.space.to_coordinates(np.stack((here, goal)))
    ride.planner.take(Strip.from_coordinates(silvermate, rows))
    ride.active = stationary(silvermate, ride.planner.limits, rows[0], 0.0, 0.01)
    result = ride.tick()
    assert result.outcome is PlanOutcome.NONE
    assert result.reason == "the motion along the strip leads nowhere"


@each("beside", [False, True])
def test_only_what_was_taken_at_speed_is_turned_to_at_speed(silvermate, beside, monkeypatch):
    """On its own strip, where no motion is found along it, a robot keeps to the one it has, comes to rest and turns
    there: among what comes in view it would leave a way that is free for one that is not."""
    ride = Ride(silvermate, Scene([PILLAR.observed(PILLAR.pose, None)]))
    for _ in range(24):
        ride.tick()
    here = ride.active.at(ride.time + 0.02)
    assert here.v[0] > 0.5
    away = here.coordinates + np.linspace(0.0, 2.0, 11)[:, None] * np.eye(len(here.coordinates))[1]
    away[1:, 2] = 0.5 * np.pi
    ride.planner.take(Strip.from_coordinates(silvermate, away), beside=beside)
    motion = ride.planner.timer.motion

    def none(*args, **options):
        return replace(motion(*args, **options), outcome=PlanOutcome.NONE, motion=None, certificate=None)

    monkeypatch.setattr(ride.planner.timer, "motion", none)
    assert (ride.tick().outcome is PlanOutcome.JOIN) is beside


def test_what_was_not_seen_ends_motions_and_does_not_push(silvermate):
    """Beside the strip and across it: the strip stays straight, and motions end before it."""
    across = Box((0.4, 8.0, 1.5), at=(2.5, 0.0, 0.75), name=f"{UNSEEN_LAYER}-6-0-0")
    beside = Box((1.0, 0.4, 1.5), at=(1.2, 0.55, 0.75), name=f"{UNSEEN_LAYER}-3-1-0")
    straight = Ride(silvermate, Scene([]))
    ride = Ride(silvermate, Scene([across, beside]))
    for _ in range(60):
        result = ride.tick()
        straight.tick()
        assert result.report.certified, "among what was seen"
        proven = ride.planner.certify(ride.active.tail(ride.time), ride.scene)
        assert proven.certified, proven.broken
        assert np.abs(ride.planner.strip.coordinates[:, 1]).max() < 0.02
    end = ride.active.coordinates[-1]
    assert 0.5 < end[0] < 2.3
    assert straight.active.coordinates[-1, 0] > 2.5


def test_a_motion_from_a_narrow_place_is_held_with_the_margin_that_it_was_proven_with(silvermate, monkeypatch):
    """The robot stands nearer to something than its margin; that other things change is no reason to brake."""
    ride = Ride(silvermate, Scene([]))
    row, margins = ride.planner.strip.coordinates[0], ride.planner.margins
    near = Box((0.5, 0.2, 1.0), at=(0.0, 0.0, 0.5), name="near")

    def apart(y: float) -> float:
        scene = Scene([near.moved(pose_at(y))])
        return ride.planner.deformer.assess(ride.planner.strip, scene).node_clearance

    low, high = 0.3, 1.2  # where its distance is between the tracking error and what the margin adds
    for _ in range(40):
        y = 0.5 * (low + high)
        low, high = (y, high) if apart(y) < margins.tracking_error + 0.5 * margins.margin else (low, y)
    held = Scene([near.moved(pose_at(high)), PILLAR])
    first = ride.tick(held)
    assert first.accepted, first.reason
    assert ride.planner._still(ride.active.at(0.0)).coordinates[0] == pytest.approx(row)
    motion = ride.planner.timer.motion

    def none(*args, **options):
        return replace(motion(*args, **options), outcome=PlanOutcome.NONE, motion=None, certificate=None)

    monkeypatch.setattr(ride.planner.timer, "motion", none)
    other = Box((0.1, 0.1, 0.1), at=(2.0, 4.0, 0.05), name="pillar")
    later = ride.tick(Scene([held.obstacle("near"), other]))
    assert later.outcome is PlanOutcome.UNCHANGED, later.reason


def pose_at(y: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = 0.0, y, 0.5
    return pose


def moved(scene: Scene, name: str, by: tuple[float, float, float]) -> Scene:
    pose = scene.obstacle(name).pose.copy()
    pose[:3, 3] += by
    return scene.moved(name, pose)


def faster(obstacle: Obstacle) -> Obstacle:
    return obstacle.observed(obstacle.pose, Twist((0.0, 0.9, 0.0)))


@each(
    "change",
    [
        pytest.param(lambda s: moved(s, "pillar", (0.0, 0.1, 0.0)), id="what stood has moved"),
        pytest.param(lambda s: moved(s, "walker", (0.0, 0.2, 0.0)), id="what moves is elsewhere"),
        pytest.param(lambda s: s.with_observations([faster(s.obstacle("walker"))]), id="what moves is faster"),
        pytest.param(
            lambda s: Scene([*s, Box((0.2, 0.2, 1.0), at=(3.0, 1.5, 0.5), name="new")], time=s.time), id="new"
        ),
        pytest.param(lambda s: Scene([s.obstacle("pillar")], time=s.time), id="gone"),
    ],
)
def test_what_is_not_as_expected_is_planned_for_at_once(silvermate, change):
    ride = Ride(silvermate, Scene([PILLAR, WALKER]))
    for _ in range(3):
        ride.tick()
    ride.tick(change(ride.scene.at(ride.time)))
    assert ride.deformed == [True, False, True, True]


def test_a_waiting_robot_tries_every_other_tick(silvermate):
    """Something near by may come at any time as fast as a person: no motion can be certified."""
    near = Cylinder(0.2, 1.7, at=(0.7, 0.1, 0.85), name="near", motion=UnknownMotion(1.5))
    ride = Ride(silvermate, Scene([near]))
    waiting = [ride.tick() for _ in range(13)][1:]
    assert not any(p.accepted for p in waiting)
    assert all(p.reason for p in waiting)
    assert [bool(p.timings) for p in waiting] == [False, True] * 6
    assert sum(ride.deformed[1:]) == 3
    gone = ride.tick(Scene([], time=ride.time))
    assert gone.accepted


def test_the_beginning_of_a_motion_past_somebody_is_certified(silvermate):
    """The longer a motion lasts, the nearer may somebody be by its end who stands beside it now."""
    person = Cylinder(0.25, 1.7, at=(1.2, 1.25, 0.85), name="person", motion=Twist((0.0, 0.0, 0.0)))
    pillar = Cylinder(0.25, 1.7, at=(1.2, 0.2, 0.85), name="person")
    planner = Ride(silvermate, Scene([person])).planner
    motion = planner.timer.easy.full(planner.strip.coordinates, start_time=0.1)
    for scene, begins in ((Scene([person]), True), (Scene([pillar]), False)):
        certificate = planner.certify(motion, scene)
        assert not certificate.certified
        found = planner.beginning(motion, certificate, scene)
        assert (found is not None) is begins, "what stands does not come nearer"
        if found is None:
            continue
        short, proof = found
        assert proof.certified
        assert planner.certify(short, scene).certified
        assert short.start_time == motion.start_time
        assert short.at_rest_at_end
        assert 0.02 < short.coordinates[-1, 0] < 0.5 * motion.coordinates[-1, 0]
        limits = planner.limits
        changes, times = np.abs(np.diff(short.v[:, 0])), np.diff(short.time)
        assert (changes <= 1.05 * float(limits.drive_acceleration[0]) * times + 1e-6).all()


def test_a_strip_that_stays_broken_is_not_pushed_on_at_full_size(silvermate, monkeypatch):
    """A wall across the way: it gets nodes for a few steps only."""
    wall = Scene([Box((0.2, 8.0, 1.5), at=(2.0, 0.0, 0.75), name="wall")])

    def most_nodes() -> int:
        ride, most = Ride(silvermate, wall), 0
        for _ in range(80):
            ride.tick()
            most = max(most, len(ride.planner.strip))
        assert not ride.planner.report.certified
        return most

    few = most_nodes()
    monkeypatch.setattr(local_planner, "BROKEN_STEPS", 10_000)
    assert few < 0.6 * most_nodes()


def test_a_strip_that_was_broken_recovers_where_the_way_is_free_again(silvermate):
    wall = Box((0.2, 8.0, 1.5), at=(2.0, 0.0, 0.75), name="wall")
    ride = Ride(silvermate, Scene([wall]))
    for _ in range(60):
        ride.tick()
    pose = np.eye(4)
    pose[:3, 3] = 2.0, 9.0, 0.75
    ride.scene = ride.scene.moved("wall", pose)
    for _ in range(40):
        result = ride.tick()
    assert ride.planner.report.certified
    assert result.accepted or result.outcome is PlanOutcome.UNCHANGED


def test_every_tick_is_planned_anew_where_asked_for(silvermate):
    params = DriveParams(motion_every=1)
    ride = Ride(silvermate, Scene([PILLAR, WALKER]), params)
    assert all(ride.tick().accepted for _ in range(6))
    assert ride.deformed == [True] * 6


def slow(ride: Ride, seconds: float = 0.008) -> Ride:
    """Whatever is measured takes so long [s] from now on."""
    clock = itertools.count()
    ride.planner.pace.meter = lambda: seconds * next(clock)
    return ride


@each("obstacles", [[PILLAR], [PILLAR, WALKER]])
def test_where_the_two_take_long_a_tick_has_the_strip_or_the_motion(silvermate, obstacles):
    ride = slow(Ride(silvermate, Scene(obstacles)))
    ticks = [(ride.tick(), ride.planner.prepared) for _ in range(13)]
    assert ticks[0][0].accepted  # nothing is known yet of how long it takes
    assert not ticks[0][1]
    assert not ticks[1][1]
    for k in range(2, 11, 3):  # the strip, the motion, and one in which the motion is kept
        assert ride.deformed[k : k + 3] == [True, False, False]
        (strip, prepared), (motion, after), (kept, _) = ticks[k : k + 3]
        assert prepared
        assert strip.outcome is PlanOutcome.UNCHANGED
        assert strip.report.certified
        assert not after
        assert motion.accepted, motion.reason
        assert len(motion.report.strip) <= len(strip.report.strip)  # along the one that was deformed
        assert kept.motion is motion.motion
    assert ride.planner.certify(ride.active.tail(ride.time), ride.scene.at(ride.time)).certified
    assert ride.active.at(ride.time).v[0] > 0.3


def test_a_refuted_motion_does_not_wait_for_the_strip(silvermate):
    """Somebody steps into the way in a tick that would have had the strip's step alone."""
    ride = slow(Ride(silvermate, Scene([PILLAR])))
    for _ in range(17):
        ride.tick()
    assert ride.deformed[-3:] == [True, False, False]
    robot = ride.active.at(ride.time + 0.02).coordinates[0]
    comer = Cylinder(0.25, 1.7, at=(robot + 0.5, -0.9, 0.85), name="comer", motion=Twist((0.0, 1.0, 0.0)))
    ride.scene = Scene([PILLAR, comer.observed(comer.pose, comer.motion)], time=ride.time)
    result = ride.tick()
    assert result.outcome in (PlanOutcome.BRAKE, PlanOutcome.EVADE, PlanOutcome.FOLLOW)
    assert not ride.planner.prepared
    assert not ride.deformed[-1]


def test_a_strip_gives_way_while_the_robot_brakes(silvermate, monkeypatch):
    """A braked motion is refuted in every tick; the strip would never have its turn."""
    ride = slow(Ride(silvermate, Scene([PILLAR])))
    for _ in range(17):
        ride.tick()
    motion, planner = ride.planner.timer.motion, ride.planner

    def none(*args, **options):
        return replace(motion(*args, **options), outcome=PlanOutcome.NONE, motion=None, certificate=None)

    monkeypatch.setattr(planner.timer, "motion", none)
    planner.evasion = None
    robot = ride.active.at(ride.time + 0.02).coordinates[0]
    comer = Cylinder(0.25, 1.7, at=(robot + 0.5, -0.9, 0.85), name="comer", motion=Twist((0.0, 1.0, 0.0)))
    ride.scene = Scene([PILLAR, comer.observed(comer.pose, comer.motion)], time=ride.time)
    first = ride.tick()
    assert first.outcome is PlanOutcome.BRAKE
    ride.active = first.motion
    ride.scene = ride.scene.without("pillar")
    assert ride.active.at(ride.time + 0.02).v[0] > 0.1, "it still moves"
    ride.tick()
    assert ride.deformed[-1]


def test_a_new_strip_is_deformed_and_driven_in_one_tick(silvermate):
    """What was prepared was another one."""
    ride = slow(Ride(silvermate, Scene([PILLAR])))
    while not ride.planner.prepared:
        ride.tick()
    aside = ride.planner.strip.coordinates.copy()
    aside[:, 1] += 0.05
    ride.planner.take(Strip.from_coordinates(silvermate, aside), beside=True)
    ride.tick()
    assert ride.deformed[-1]
    assert not ride.planner.prepared


def test_after_a_reset_nothing_is_taken_for_known(silvermate):
    ride = Ride(silvermate, Scene([PILLAR]))
    ride.tick()
    ride.planner.reset()
    assert ride.tick().accepted
    assert ride.deformed == [True, True]  # else the second would go on with what the first had certified


def test_it_brakes_at_once_where_the_held_motion_is_refuted(silvermate):
    """Somebody nobody knew of steps into the way: to drive the held motion to its end would take longer."""
    ride = Ride(silvermate, Scene([PILLAR]))
    for _ in range(16):
        ride.tick()
    active = ride.active
    at = ride.time + 0.02
    robot = active.at(at).coordinates[0]
    comer = Cylinder(0.25, 1.7, at=(robot + 0.5, -0.9, 0.85), name="comer", motion=Twist((0.0, 1.0, 0.0)))
    now = Scene([PILLAR, comer.observed(comer.pose, comer.motion)], time=ride.time)
    result = ride.tick(now)
    assert not result.accepted
    assert result.outcome is PlanOutcome.BRAKE
    assert "the held motion is no longer certified" in result.reason
    assert result.motion.start_time == pytest.approx(at)
    assert result.motion.end_time < active.end_time - 0.05
    np.testing.assert_allclose(result.motion.coordinates[0], active.at(at).coordinates, atol=1e-9)
    ride.active = result.motion
    again = ride.tick(now)  # it brakes as hard as it can already
    assert again.outcome is not PlanOutcome.BRAKE or again.motion.end_time > ride.active.end_time - 0.03


def test_a_motion_that_was_proved_is_not_given_up_while_all_is_as_expected(silvermate, monkeypatch):
    """A newer certificate may ask for more than the held motion's did: without a surprise that one is still a proof."""
    ride = Ride(silvermate, Scene([PILLAR, WALKER]))
    for _ in range(8):
        ride.tick()
    broken = BrokenSegment(0, "palm", "walker", -0.01, "obstacle", True)
    refused = Certificate(0.025, np.zeros(1, dtype=bool), np.zeros(1, dtype=np.int8), broken, 0)
    monkeypatch.setattr(ride.planner.timer.certifier, "certify", lambda *_, **__: refused)
    ride.tick()  # goes on without a look
    result = ride.tick()
    assert not result.accepted
    assert result.outcome is not PlanOutcome.BRAKE
    assert "not certified" in result.reason
    refuted = ride.tick(moved(ride.scene.at(ride.time), "walker", (0.0, 0.3, 0.0)))
    assert refuted.outcome is PlanOutcome.BRAKE


def test_a_held_motion_is_proven_again_among_what_is_new_or_moves(silvermate, monkeypatch, rng):
    """What stands as it stood is left out, and the verdict is that of a certificate among everything."""
    posts = [Box((0.1, 0.1, 1.0), at=(x, y, 0.5), name=f"{x}{y}") for x in range(6) for y in (-3.0, 3.0)]
    ride = Ride(silvermate, Scene([*posts, PILLAR, WALKER]))
    for _ in range(9):
        ride.tick()
    planner, known, ahead = ride.planner, [*posts, PILLAR], float(ride.active.coordinates[-1, 0])
    certify, asked, verdicts, begin = planner.timer.certifier.certify, [], [], ride.time + 0.02

    def counted(motion, scene, *args, **kwargs):
        asked.append(len(scene))
        return certify(motion, scene, *args, **kwargs)

    def refuted(scene: Scene) -> bool:
        asked.clear()
        monkeypatch.setattr(planner.timer.certifier, "certify", counted)
        reason = planner.refuted(ride.active, scene, begin)
        monkeypatch.setattr(planner.timer.certifier, "certify", certify)
        assert bool(reason) is not planner.certify(ride.active.tail(begin), scene).certified
        return bool(reason)

    walker = ride.scene.at(ride.time).obstacle("walker")
    for k in range(30):
        place = rng.uniform((ahead, -1.2), (ahead + 1.5, 1.2))
        new = Box((0.1, 0.1, 1.0), at=(*place, 0.5), name=f"new-{k % 3}")
        before, known = known, [*(o for o in known if o.name != new.name), new]
        verdicts.append(refuted(Scene([*known, walker], time=ride.time)))
        assert asked == [2], "the new one, and who walks"
        if verdicts[-1]:
            known = [o for o in before if o.name != new.name]
            assert not refuted(Scene([*known, walker], time=ride.time))
            assert asked == [len(known) + 1], "there was no proof any more: everything"
    assert {True, False} == set(verdicts)


def test_what_cannot_stop_in_time_is_not_tried_at_lower_speeds(silvermate, monkeypatch):
    """The same velocity at the start has to be braked on the same path."""
    ride = Ride(silvermate, Scene([PILLAR]))
    for _ in range(6):
        ride.tick()
    tried = []

    def none(*_, speed: float, **__):
        tried.append(speed)
        raise RetimingError("no room to brake")

    for retimer in (ride.planner.timer.easy, ride.planner.timer.hard):
        monkeypatch.setattr(retimer, "horizon", none)
    result = ride.tick()
    assert result.outcome not in (PlanOutcome.FOLLOW, PlanOutcome.ARRIVE)
    assert "no room to brake" in result.reason
    assert len(tried) > 1
    assert set(tried) <= {1.0, PARAMS.speed_scale}


def test_a_robot_that_has_stopped_at_the_border_of_its_path_goes_on(silvermate):
    """Motions keep the margin to the border, too: else nothing is left to a robot that stops a little beyond."""
    ride, off = Ride(silvermate, Scene([])), PARAMS.tracking_error + 0.4 * PARAMS.margin
    path = FollowedPath([(0.0, off - 0.3), (4.0, off - 0.3)], 0.3)
    ride.planner.keep_to(path)
    stands = ride.planner.certify(ride.active, ride.scene)
    assert stands.broken is not None
    assert stands.broken.kind == "path"
    for _ in range(8):
        ride.tick()
    moved = ride.active.coordinates[:, :2]
    assert np.linalg.norm(moved[-1]) > 0.1
    assert path.off(moved).max() <= 0.3 - PARAMS.tracking_error


@each("known", [3, 6, 9])
def test_a_strip_that_was_certified_with_other_nodes_is_joined_at_speed(silvermate, known):
    """While a robot waits, nodes go and come that the certificate of the last tick does not know."""
    ride = Ride(silvermate, Scene([]))
    report = ride.tick().report
    nodes = report.strip.coordinates[-7:]
    segments = np.ones(known, dtype=bool)
    segments[-1] = False
    certificate = replace(report.certificate, segments=segments)
    other = replace(report, strip=Strip.from_coordinates(silvermate, nodes), certificate=certificate)
    new = max(6 - known, 0)
    assert local_planner._proven(other).tolist() == [False] * new + [True] * (5 - new) + [False]
