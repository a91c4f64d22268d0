"""Tracks: movers are found with their velocities and keep their names; walls never move."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cases import each
from ray_caster import box_segments, scan

from elastic_strips.perception import SceneEstimator, SceneEstimatorParams
from elastic_strips.perception.clusters import Cluster
from elastic_strips.perception.tracking import Tracker
from elastic_strips.scene import Twist, UnknownMotion

ROOM = box_segments(4, 0, 12, 8) + box_segments(5, 2, 1.0, 0.6, 0.3) + box_segments(2, -2.5, 0.5, 0.5)


def drive(estimator, seconds, circles_at, *, pose_at=lambda t: (0, 0, 0), noise=0.01, pose_noise=0.0, seed=0, **world):
    """Feed scans at 10 Hz; yields (time, movers)."""
    rng = np.random.default_rng(seed)
    for k in range(round(seconds * 10) + 1):
        t = 0.1 * k
        pose = np.array(pose_at(t), dtype=float)
        reading = scan(pose, t, circles=circles_at(t), noise=noise, rng=rng, **{"segments": ROOM, **world})
        estimator.update(reading, pose + rng.normal(0, 1, 3) * pose_noise * np.array([1, 1, 0.5]))
        yield t, estimator.movers


@each("speed", [0.3, 0.7, 1.1, 1.5])
@each("way", [(0.0, 1.0), (-1.0, 0.0), (1.0, 0.0), (0.7, -0.7)])
def test_a_lone_mover_has_its_velocity_after_a_second(speed, way):
    """Across, towards and away from the sensor; one mover, one name, and errors as small as their sigmas say."""
    v = speed * np.array(way)
    start = np.array([3.2, 0.0]) - v * 0.9
    names = set()
    for t, movers in drive(SceneEstimator(), 1.8, lambda t: [(*(start + v * t), 0.25)]):
        names |= {m.name for m in movers}
        if t > 0.99:
            (mover,) = movers
            error = np.hypot(*(mover.velocity - v))
            assert error < 0.15
            assert error < 3.5 * mover.velocity_sigma
            assert np.hypot(*(mover.position - start - v * t)) < 0.06
            assert mover.radius == pytest.approx(0.25 + 0.03, abs=0.05)
    assert len(names) == 1


@pytest.mark.parametrize("yaw", [0.0, 0.6])
def test_a_box_that_drives_is_a_mover_that_holds_it(yaw):
    """A cart of 0.7 × 0.45 m across the view: its cylinder holds what is seen of it, and goes its way."""
    found, estimator, rng = 0, SceneEstimator(), np.random.default_rng(0)
    for k in range(25):
        t, y = 0.1 * k, -1.2 + 0.08 * k
        cart = box_segments(3.0, y, 0.45, 0.7, yaw)
        estimator.update(scan((0, 0, 0), t, segments=ROOM + cart, noise=0.01, rng=rng), (0, 0, 0))
        if t > 1.2:
            (mover,) = estimator.movers
            assert np.hypot(*(mover.velocity - (0.0, 0.8))) < 0.2
            corners = np.array([(s[0], s[1]) for s in cart])
            near = corners[corners[:, 0] < 3.0]
            assert np.hypot(*(near - mover.position).T).max() < mover.radius + 0.03
            found += 1
    assert found > 10


def test_two_that_cross_keep_their_names():
    """Their ways cross 0.8 m behind one another; the far one is hidden for a while."""
    ways = {"near": ((2.5, -1.5), (0.0, 0.9)), "far": ((3.6, 1.6), (0.0, -0.9))}

    def at(t):
        return [(p[0] + v[0] * t, p[1] + v[1] * t, 0.22) for p, v in ways.values()]

    known: dict[str, set[str]] = {"near": set(), "far": set()}
    for t, movers in drive(SceneEstimator(), 3.2, at):
        if t > 0.9:
            assert len(movers) == 2
            for mover in movers:
                who = min(ways, key=lambda w: abs(mover.position[0] - ways[w][0][0]))
                known[who].add(mover.name)
                assert mover.velocity[1] * ways[who][1][1] > 0.0
    assert [len(names) for names in known.values()] == [1, 1]


@each("seed", range(3))
def test_a_driving_robot_among_walls_sees_nothing_move(seed):
    """Ten seconds with noise of ranges and pose, past corners, thin poles and a gap through which a wall is seen."""
    gap = [(3.0, 1.0, 3.0, 3.9), (3.0, -0.2, 3.0, 0.4), (3.0, -3.9, 3.0, -0.8)]
    estimator = SceneEstimator()

    def pose_at(t):
        return 0.25 * t - 1.2, 0.4 * math.sin(0.8 * t), 0.5 * math.sin(0.6 * t)

    steps = drive(
        estimator,
        10.0,
        lambda t: [(1.6, 1.9, 0.05), (0.9, -1.2, 0.2)],
        pose_at=pose_at,
        pose_noise=0.01,
        seed=seed,
        segments=ROOM + gap,
    )
    for t, movers in steps:
        assert not movers, f"{movers} at {t:g} s"
    assert estimator.report.tracks > 0


def test_a_mover_that_stops_goes_back_into_the_map_and_leaves_nothing_behind():
    estimator = SceneEstimator()
    moved = False
    for t, movers in drive(estimator, 6.0, lambda t: [(2.5, -1.0 + min(t, 1.8), 0.25)]):
        if movers and not moved:  # from the first scan on its traces are gone, also those that nobody has seen through
            trace = np.array([[2.28 + d, -1.0 + y] for y in np.arange(0.0, t + 0.15, 0.04) for d in (0, 0.04, 0.08)])
            assert not estimator.map.occupied(trace).any()
        moved |= bool(movers)
        if 1.2 < t < 1.75:
            assert not estimator.map.occupied(movers[0].position[None] + [[0.0, -0.9]]).any()
    assert moved
    assert not estimator.movers
    assert estimator.map.occupied(np.array([[2.26, 0.8]])).all()
    assert not estimator.map.occupied(np.array([[2.26, y] for y in (-1.0, -0.5, 0.0, 0.3)])).any()


@pytest.mark.parametrize("stays", [True, False])
def test_who_stands_where_one_walks_may_have_gone_while_nothing_looks(stays):
    """It stands from 1.8 s on. The robot looks elsewhere from 6 to 11 s; what never moved stays what it was."""
    estimator = SceneEstimator(SceneEstimatorParams(stood_time=3.0))
    front, crate = np.array([[2.26, 0.8]]), np.array([[1.76, -2.5]])  # of it, and of what stands in the room

    def at(t):
        return [(2.5, -1.0 + min(t, 1.8), 0.25)] if stays or t < 6.0 else []

    def layers(places):
        points = np.column_stack((places, [0.5]))
        scene = estimator.scene()
        obstacles = {name: scene.obstacle(name) for name in scene.names}
        return {
            name.rstrip("-0123456789")
            for name, o in obstacles.items()
            for part in o.parts
            for box, where in part.boxes
            if (np.abs(points - o.pose[:3, 3] - where) <= np.asarray(box.halfSide) + 1e-9).all()
        }

    found = {}
    for t, _ in drive(estimator, 13.0, at, pose_at=lambda t: (0.0, 0.0, math.pi if 6.0 < t < 11.0 else 0.0)):
        found[round(t, 1)] = layers(front), layers(crate)
    assert "map" in found[6.0][0]
    assert found[10.9][0] == {"unseen-stood"}
    assert ("map" in found[13.0][0]) == stays
    assert stays or not found[13.0][0]
    assert all(found[t][1] == {"map"} for t in (6.0, 10.9, 13.0))


def test_who_has_come_to_rest_may_set_off_again_for_a_while():
    """It brakes at 0.5 m/s², stands from 2 s on, and sets off at 7 s: somebody who is known to move."""

    def y(t: float) -> float:
        s = min(t, 2.0)
        return -1.0 + s - 0.25 * s * s + 0.2 * max(t - 7.0, 0.0) ** 2

    def at(t):
        return [(2.5, y(t), 0.25)]

    estimator = SceneEstimator(SceneEstimatorParams(recent_motion_time=8.0))
    rested, moving = {}, {}
    for t, movers in drive(estimator, 9.0, at):
        rested[round(t, 1)], moving[round(t, 1)] = estimator.possibly_moving, movers
    for t in (5.0, 6.0, 6.9):
        (thing,) = rested[t]
        assert not moving[t]
        assert thing.obstacle.motion.max_speed == 0.2
        assert np.hypot(*(thing.position - (2.5, y(t)))) < 0.06
    assert len({m.name for found in (rested, moving) for t in found for m in found[t]}) == 1
    assert all(isinstance(moving[t][0].obstacle.motion, Twist) for t in (2.0, 8.5, 9.0))
    assert thing.name in estimator.scene()
    estimator = SceneEstimator(SceneEstimatorParams(recent_motion_time=1.0))
    assert not any(estimator.possibly_moving for t, _ in drive(estimator, 6.9, at) if t > 6.0)
    assert estimator.map.occupied(np.array([[2.26, y(6.9)]])).all()


def test_who_comes_out_from_behind_something_may_move_at_once():
    """A crate hides it; scans saw through where it is now, long before its velocity can be known."""
    crate = box_segments(1.6, 0.9, 0.8, 0.8)

    def at(t):
        return [(2.6, 1.3 - max(t - 1.0, 0.0) * 1.0, 0.25)]

    estimator = SceneEstimator()
    first: dict[str, float] = {}
    for t, movers in drive(estimator, 2.6, at, segments=ROOM + crate):
        for kind, found in (("possible", estimator.possibly_moving), ("mover", movers)):
            for m in found:
                if np.hypot(*(m.position - at(t)[0][:2])) < 0.4:
                    first.setdefault(kind, t)
    assert first["possible"] <= first["mover"] - 0.2
    assert estimator.scene().obstacle(movers[0].name).motion is not None


@each("seed", range(3))
def test_who_comes_out_of_a_wall_may_move_at_once(seed):
    """At first a scan sees no gap between them and the wall: as through a narrow door, or where they walk along it."""
    estimator, out = SceneEstimator(), None
    wall = [(-3.0, -1.5, 6.0, -1.5), (6.0, -1.5, 6.0, 3.0), (6.0, 3.0, -3.0, 3.0)]
    for t, movers in drive(estimator, 1.2, lambda t: [(2.0, -2.8 + 1.2 * t, 0.3)], segments=wall, seed=seed):
        known = [*movers, *estimator.possibly_moving]
        if t < 0.8:
            assert not known, "nothing is out yet"
        elif known:
            out = t if out is None else out
            assert all(np.hypot(*(each.position - (2.0, -2.8 + 1.2 * t))) < 0.4 for each in known)
    assert out is not None
    assert out < 1.15, "its middle has come out"


@each("seed", range(3))
def test_in_a_standing_room_nothing_may_move(seed):
    """A robot drives and turns among walls and boxes, with noise in its ranges and its pose."""
    rng = np.random.default_rng(seed)
    spin, step = rng.uniform(-0.7, 0.7), rng.uniform(0.1, 0.5)
    estimator = SceneEstimator()
    posts = [(1.5, -1.0, 0.06), (3.0, 1.5, 0.2), (-1.0, 2.0, 0.3)]
    for _ in drive(estimator, 5.0, lambda t: posts, pose_at=lambda t: (step * t, 0.1 * t, spin * t), pose_noise=0.005,
                   seed=seed):  # fmt: skip
        assert not estimator.possibly_moving


def test_what_is_seen_through_is_lost_and_what_is_hidden_is_foreseen():
    params = SceneEstimatorParams(coast_time=1.0)
    screen = [(1.0, -0.3, 1.0, 0.3)]
    estimator = SceneEstimator(params)
    before = None
    for t, movers in drive(estimator, 3.0, lambda t: [(2.5, -1.5 + 0.8 * t, 0.2)], segments=ROOM + screen):
        if 1.2 < t < 1.9:
            assert len(movers) == 1
        if t > 1.55 and movers and movers[0].seen < t - 0.25:  # behind the screen
            before = before or movers[0].position_sigma
            assert abs(movers[0].position[1] - (-1.5 + 0.8 * t)) < 0.15
    assert before is not None
    estimator = SceneEstimator(params)
    last = None
    for t, movers in drive(estimator, 3.0, lambda t: [(2.5, -1.0 + 0.8 * t, 0.2)] if t < 1.5 else []):
        if movers:
            last = t
    assert last is not None
    assert 1.45 < last < 1.5 + 0.1 * params.lost_misses + 0.01


class SeenThrough:
    """A reading that sees through everything, or through nothing."""

    def __init__(self, time, *, all_of_it):
        self.time, self._all = time, all_of_it

    def beyond(self, points, margin, heights):
        return np.full(len(points), self._all), np.full(len(points), not self._all)


@pytest.mark.parametrize("laser_sees_it", [False, True])
def test_a_laser_that_was_once_taken_to_see_a_thing_does_not_miss_it_for_ever(laser_sees_it):
    """A load that hangs comes up to a camera, until it is too near to be seen: a laser below it sees through its place
    all the time. Of what the laser has seen until then, that says that it is gone."""
    params = SceneEstimatorParams()
    tracker = Tracker(params)
    for k in range(34):
        t, x = 0.05 * k, 3.0 - 0.04 * k
        front = np.column_stack([np.full(9, x), np.linspace(-0.2, 0.2, 9)])
        cluster = Cluster(front, np.zeros(2), covered=(False, False), displaced=True)
        gone = k >= 30
        tracker.update(SeenThrough(t, all_of_it=False), [] if gone else [cluster], "camera")
        once = k == 10 or (laser_sees_it and not gone)
        tracker.update(SeenThrough(t + 0.01, all_of_it=True), [cluster] if once else [], "laser")
        assert len(tracker.movers) == 1 or k < 15 or (laser_sees_it and gone), k
    assert len(tracker.movers) == (0 if laser_sees_it else 1)
    for k in range(34, 34 + round(params.coast_time / 0.05) + 2):
        tracker.update(SeenThrough(0.05 * k, all_of_it=False), [], "camera")
    assert not tracker.movers, "what nobody sees any more is not expected for ever"


def test_what_hangs_over_a_post_that_a_laser_sees_standing_is_followed_by_itself():
    """A load comes along above a post: in the camera's images it is where the post's track is, from above."""
    tracker = Tracker(SceneEstimatorParams())
    post = Cluster(front_of(2.0, 0.0, 0.15), np.zeros(2), covered=(False, False))
    for k in range(30):
        tracker.update(SeenThrough(0.05 * k, all_of_it=False), [post], "laser")
    for k in range(30, 38):
        t, y = 0.05 * k, 0.25 - 0.05 * (k - 30)
        load = np.column_stack([np.full(9, 1.95), y + np.linspace(-0.15, 0.15, 9)])
        tracker.update(
            SeenThrough(t, all_of_it=False),
            [Cluster(load, np.zeros(2), covered=(True, True), displaced=True)],
            "camera",
        )
        tracker.update(SeenThrough(t + 0.01, all_of_it=False), [post], "laser")
        moving = [*tracker.movers, *tracker.possibly_moving]
        assert len(moving) == 1, "from the first image on, and the post never"
        assert np.hypot(*(moving[0].position - (1.95, y))) < 0.2, k
        motion = moving[0].obstacle.motion
        assert motion.max_speed > 0.9 if isinstance(motion, UnknownMotion) else moving[0].velocity[1] < -0.6, k


def test_what_is_covered_does_not_take_its_neighbours_place():
    """Of three posts in a row the first is not seen any more, and somebody is seen beside the last: each of the others
    is still itself, and who came is somebody else."""
    tracker = Tracker(SceneEstimatorParams())

    def shown(*places):
        return [Cluster(front_of(2.0, y, 0.15)[:8], np.zeros(2), covered=(True, True)) for y in places]

    for k in range(30):
        tracker.update(SeenThrough(0.05 * k, all_of_it=False), shown(-0.3, 0.0, 0.3), "laser")
    names = {track.name: track.p for track in tracker._tracks}
    assert len(names) == 3
    tracker.update(SeenThrough(1.5, all_of_it=False), shown(0.0, 0.3, 0.6), "laser")
    assert len(tracker) == 4
    for track in tracker._tracks:
        assert track.name not in names or np.hypot(*(track.p - names[track.name])) < 0.05


@each("turn", [1.0, -1.0])
def test_what_leaves_the_view_is_still_where_it_goes(turn):
    """Less and less of it is seen, up to the border: its middle is not the middle of that, and it has not slowed."""
    tracker, border = Tracker(SceneEstimatorParams()), 0.5
    for k in range(40):
        t = 0.05 * k
        y = 0.6 * t
        front = np.column_stack([np.full(33, 1.4), y + np.linspace(-0.24, 0.24, 33)])
        front = front[np.arctan2(front[:, 1], front[:, 0]) < border]
        if len(front) < 8:
            break
        covered = (False, len(front) < 33) if turn > 0.0 else (len(front) < 33, False)
        points = front if turn > 0.0 else front[::-1] * (1.0, -1.0)
        tracker.update(SeenThrough(t, all_of_it=False), [Cluster(points, np.zeros(2), covered, displaced=True)])
        if k > 10:
            (mover,) = tracker.movers
            assert abs(mover.position[1] * turn - y) < 0.08, len(front)
            assert abs(mover.velocity[1] * turn - 0.6) < 0.12, len(front)
    assert 20 < k < 39


@pytest.mark.parametrize("times", [1, 2, 5])
def test_what_creeps_may_move_between_the_images_that_show_it(times):
    """It fills a new voxel now and then, and is slower than what counts as a mover: the images between say nothing."""
    params = SceneEstimatorParams()
    tracker = Tracker(params)
    possible = {}
    for k in range(80):
        x = 2.0 - 0.01 * k
        front = np.column_stack([np.full(9, x), np.linspace(-0.2, 0.2, 9)])
        shown = k <= 1 or (k % 5 == 0 and k // 5 < times + 1)
        cluster = Cluster(front, np.zeros(2), covered=(False, False), displaced=shown and k > 1)
        tracker.update(SeenThrough(0.1 * k, all_of_it=False), [cluster] if shown else [], "camera")
        assert not tracker.movers
        possible[k] = tracker.possibly_moving
    last = 5 * times
    over = last + round(params.motion_onset_time / 0.1) + 1
    assert possible[last]
    assert all(bool(possible[k]) == (times > 1) for k in range(over, last + 15))
    assert all(0.0 < thing.obstacle.motion.max_speed <= 0.5 for thing in possible[last + 10])
    assert not possible[last + round(params.rest_time / 0.1) + 1]


def front_of(x: float, y: float, radius: float) -> np.ndarray:
    """Points of a round thing's side that is seen from the origin's side of it, at x ≥ 0."""
    turn = np.linspace(-1.3, 1.3, 25) + math.pi + math.atan2(y, x)
    return np.column_stack([x + radius * np.cos(turn[::-1]), y + radius * np.sin(turn[::-1])])[::-1]


def test_what_is_where_a_mover_should_be_and_does_not_move_like_it_is_followed_anew():
    """The first images of what comes out of a gap show more of it each time, and so a motion to the side that it
    does not have. While it is within what it was taken to be, it had been called a part of that."""
    tracker, born = Tracker(SceneEstimatorParams()), 6
    for k in range(born + 8):
        t = 0.05 * k
        x, y = (2.5 + 1.0 * t, 2.0) if k < born else (2.65, 1.75 - 0.8 * (t - 0.05 * born))
        shown = front_of(x, y, 0.45 if k < born else 0.23)
        tracker.update(SeenThrough(t, all_of_it=False), [Cluster(shown, np.zeros(2), (False, False), displaced=True)])
        if k == born - 1:
            (first,) = tracker.moving
        assert len(tracker) == (1 if k < born else 2), k
    assert np.hypot(*(first.p - (x, y))) < first.radius + 0.5
    others = [track for track in tracker.moving if track is not first]
    assert others
    assert np.hypot(*(others[0].p - (x, y))) < 0.1
    assert np.hypot(*(others[0].v - (0.0, -0.8))) < 0.3


def test_what_does_not_go_where_it_is_expected_has_no_known_velocity():
    """A cart comes out from behind something: more and more of it is seen, and the middle of that runs to the side.
    Once all of it is seen, it comes nearer, and is aside from where it was expected again and again."""
    tracker, whole = Tracker(SceneEstimatorParams()), 9
    known: list[tuple[int, float]] = []
    for k in range(60):
        t = 0.05 * k
        length, y = min(0.1 * (k + 1), 0.1 * whole), 2.5 - 0.7 * max(t - 0.05 * whole, 0.0)
        front = np.column_stack([np.linspace(2.5, 2.5 - length, 9), np.full(9, y)])
        tracker.update(SeenThrough(t, all_of_it=False), [Cluster(front, np.zeros(2), (True, True), displaced=True)])
        for mover in tracker.movers:
            if k > whole + 3 and isinstance(mover.obstacle.motion, Twist):
                known.append((k, float(np.hypot(*(mover.velocity - (0.0, -0.7))))))
    assert known, "in the end it is known"
    assert max(error for _, error in known) < 0.5, known
    assert known[-1][1] < 0.2


@each("height, top", [(0.4, 2.0), (1.5, 2.0), (2.3, 2.3)])
def test_who_moves_is_as_tall_as_people_whatever_a_scan_says_of_what_stands(height, top):
    """An arm above the plane of the scan runs into people, too; images leave them out of their map."""
    estimator = SceneEstimator(SceneEstimatorParams(height=height))
    seen = 0
    for t, movers in drive(estimator, 1.5, lambda t: [(3.0, -0.6 + 0.8 * t, 0.25)]):
        for mover in movers:
            person = estimator.scene(t).obstacle(mover.name)
            low, high = (person.pose[2, 3] + sign * 0.5 * person.spec["length"] for sign in (-1.0, 1.0))
            assert (low, high) == pytest.approx((0.0, top))
            seen += 1
    assert seen > 5


def test_a_mover_keeps_solid_and_name_and_moves_on_in_the_scene():
    estimator = SceneEstimator()
    solids = []
    for t, movers in drive(estimator, 2.5, lambda t: [(2.5, -1.2 + 0.8 * t, 0.25)]):
        if not movers:
            continue
        scene = estimator.scene()
        obstacle = scene.obstacle(movers[0].name)
        solids.append(obstacle.solid)
        assert scene.time == t
        assert isinstance(obstacle.motion, Twist)
        np.testing.assert_allclose(obstacle.pose[:2, 3], movers[0].position)
        later = scene.at(t + 1.0).obstacle(movers[0].name)
        np.testing.assert_allclose(later.pose[:2, 3], movers[0].position + movers[0].velocity, atol=1e-9)
    assert len(solids) > 10
    assert len({id(s) for s in solids}) <= 3
    assert solids[-1] is solids[-2]


def test_the_same_readings_give_the_same_tracks():
    def run():
        estimator = SceneEstimator()
        for _ in drive(estimator, 1.5, lambda t: [(2.5, t - 1.0, 0.2), (3.5, 1.0 - t, 0.2)]):
            pass
        return [(m.name, m.position.tolist(), m.velocity.tolist()) for m in estimator.movers]

    assert run() == run()
    assert len(run()) == 2
