"""Scenes: names, snapshots that share, and the table of parts against a reference made part by part."""

import math
import pickle
import sys

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.errors import InputError, SceneError
from elastic_strips.scene import UNSEEN_LAYER, Box, Cone, ConvexHull, Keyframes, Points, Scene, Sphere, Twist, Voxels
from elastic_strips.scene.difference import difference, with_difference


def test_what_is_made_of_a_scene_has_its_time():
    """A scene without a time is a map; what is made of it is one, too, until it is asked for at a time."""
    for time in (None, 0.0, 2.0):
        scene = Scene([Box((1, 1, 1), name="a"), Sphere(0.1, name="b")], time=time)
        made = scene.moved("a", np.eye(4)), scene.with_obstacle(Sphere(0.2)), scene.without("b")
        for other in (*made, pickle.loads(pickle.dumps(scene)), scene.with_observations([])):
            assert (other.stamp, other.time) == (time, time or 0.0)
        assert scene.at(0.0).stamp == 0.0


def random_pose(rng):
    quat = rng.normal(size=4)
    return np.array(Box((1, 1, 1), at=rng.uniform(-3, 3, 3), quat=quat / np.linalg.norm(quat)).pose)


def mixed(rng):
    cells = np.unique(rng.integers(0, 30, (400, 3)), axis=0) * 0.1
    scene = Scene(
        [
            Box((1, 2, 0.5), name="box", motion=Twist((0.3, 0, 0), (0, 0.4, 1))),
            Voxels(cells, 0.1, name="voxels"),
            ConvexHull(rng.normal((1, 2, 3), size=(30, 3)), name="hull"),
            Sphere(0.4, name="ball", motion=Keyframes([0, 2], [[0, 0, 0], [1, 2, 3]])),
            Points(rng.uniform(0, 2, (50, 3)), 0.02, name="cloud", motion=Twist((0, 0.1, 0), (1, 0, 0))),
            Cone(0.2, 0.7, name="cone"),
        ]
    )
    for name in scene.names:
        scene = scene.moved(name, random_pose(rng))
    return scene


def check_table(scene):
    """Compare the table with the world geometry of each part."""
    table, row = scene.table, 0
    for k, obstacle in enumerate(scene.obstacles):
        assert table.offsets[k] == row
        for part in obstacle.parts:
            T = obstacle.pose @ part.T_obstacle_part
            assert table.parts[row] is part
            assert table.obstacle_index[row] == k
            np.testing.assert_allclose(table.rotation[row], T[:3, :3], atol=1e-13)
            np.testing.assert_allclose(table.translation[row], T[:3, 3], atol=1e-12)
            np.testing.assert_allclose(
                table.center[row], obstacle.pose[:3, :3] @ part.center + obstacle.pose[:3, 3], atol=1e-12
            )
            assert table.radius[row] == part.radius
            corners = part.half_extents * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
            spread = np.minimum(np.abs(corners @ obstacle.pose[:3, :3].T).max(axis=0), part.radius)
            np.testing.assert_allclose(table.half_extents[row], spread, atol=1e-12)
            row += 1
    assert len(table) == row == table.offsets[-1]
    for array in (table.rotation, table.translation, table.center, table.half_extents, table.radius):
        assert len(array) == row
        assert not array.flags.writeable


def test_unnamed_obstacles_get_names_that_are_free():
    scene = Scene([Box((1, 1, 1)), Sphere(1), Box((1, 1, 1), name="box-3"), Box((1, 1, 1))])
    assert scene.names == ("box-0", "sphere-1", "box-3", "box-4")
    assert [o.name for o in scene] == list(scene.names)
    more = scene.with_obstacle(Box((1, 1, 1)))
    assert more.names[-1] == "box-5"
    assert more.without("box-0").with_obstacle(Box((1, 1, 1))).names[-1] == "box-6"


def test_bad_scenes_are_refused():
    with refused(SceneError, "'a'"):
        Scene([Box((1, 1, 1), name="a"), Sphere(1, name="a")])
    with refused(SceneError, "already"):
        Scene([Box((1, 1, 1), name="a")]).with_obstacle(Sphere(1, name="a"))
    with refused(SceneError, "obstacle"):
        Scene(["box"])
    with refused(SceneError, "list"):
        Scene(Box((1, 1, 1)))
    with refused(SceneError, "list"):
        Scene(5)
    with refused(SceneError, "time"):
        Scene([], time=math.nan)
    with refused(SceneError, "obstacle"):
        Scene([]).with_obstacle("box")


@each("name", ["tabel", 5, None, []])
def test_unknown_name_offers_the_nearest(name):
    scene = Scene([Box((1, 1, 1), name="table")])
    with refused(SceneError, "table"):
        scene.moved(name, np.eye(4))
    with refused(SceneError, "table"):
        scene.without(name)
    with refused(SceneError, "table"):
        scene.obstacle(name)


def test_scene_is_immutable():
    scene = Scene([Sphere(1)])
    with refused(AttributeError, "immutable"):
        scene.time = 3.0
    with refused(AttributeError, "immutable"):
        del scene.names


def test_snapshots_share_what_did_not_change():
    scene = mixed(np.random.default_rng(0))
    moved = scene.moved("hull", np.eye(4))
    assert [a is b for a, b in zip(scene, moved, strict=True)] == [True, True, False, True, True, True]
    later = scene.at(1.0)
    assert later.time == 1.0
    assert [a is b for a, b in zip(scene, later, strict=True)] == [False, True, True, False, False, True]
    assert scene.time == 0.0
    assert scene.without("box").obstacles == scene.obstacles[1:]
    assert scene.with_obstacle(Sphere(1)).obstacles[:6] == scene.obstacles
    assert "hull" in scene
    assert scene.obstacles[0] in scene
    assert len(scene) == 6


def test_table_agrees_with_the_parts():
    check_table(mixed(np.random.default_rng(1)))
    check_table(Scene([]))
    assert len(Scene([]).table) == 0


def test_table_of_derived_snapshots_agrees_and_leaves_the_old_one_alone():
    rng = np.random.default_rng(2)
    scene = mixed(rng)
    before = scene.table.center.copy()
    one = scene.moved("voxels", random_pose(rng))
    check_table(one)
    two = (
        one.moved("cone", random_pose(rng)).moved("hull", random_pose(rng)).moved("cone", random_pose(rng))
    )  # no table between
    check_table(two)
    check_table(two.at(0.7))
    check_table(two.at(0.7).moved("box", random_pose(rng)).at(1.9))
    check_table(two.without("voxels"))
    check_table(two.without("voxels").with_obstacle(Sphere(0.3)).moved("cone", random_pose(rng)))
    np.testing.assert_array_equal(scene.table.center, before)
    assert scene.table is scene.table
    assert Scene([Sphere(1)]).at(4.0).time == 4.0


def test_derived_table_is_updated_and_not_rebuilt(monkeypatch):
    scene = mixed(np.random.default_rng(3))
    assert scene.table is not None

    def fail(obstacles):
        raise AssertionError("the table was rebuilt")

    assert len(Scene(scene.obstacles).without("box").with_obstacle(Sphere(1)).table) == len(scene.table)
    monkeypatch.setattr("elastic_strips.scene.scene._build_table", fail)
    assert len(scene.moved("box", np.eye(4)).moved("cone", np.eye(4)).at(1.0).table) == len(scene.table)
    assert len(scene.moved("cone", np.eye(4)).without("box").table) == len(scene.table) - 1
    with refused(AssertionError, "rebuilt"):
        _ = Scene(scene.obstacles).without("box").table


@each("known", [False, True])
def test_scenes_that_grow_and_shrink_are_those_made_at_once(known):
    """Names, places and tables, to the last digit, whether the table was there before or not."""
    rng = np.random.default_rng(5)
    scene = mixed(rng)
    for turn in range(12):
        if known:
            assert scene.table is not None
        if turn % 3 == 2:
            scene = scene.without(str(rng.choice(scene.names)))
        else:
            name = f"new{turn}" if turn % 2 else None
            quat = rng.normal(size=4)
            new = Box((0.1, 0.2, 0.3), at=rng.uniform(-3, 3, 3), quat=quat / np.linalg.norm(quat), name=name)
            scene = scene.with_obstacle(new)
        whole = Scene(scene.obstacles)
        check_table(scene)
        assert scene.names == whole.names == tuple(o.name for o in scene)
        assert [scene.obstacle(n) is o for n, o in zip(scene.names, scene, strict=True)] == [True] * len(scene)
        for field in ("obstacle_index", "offsets", "rotation", "translation", "center", "half_extents", "radius"):
            np.testing.assert_array_equal(getattr(scene.table, field), getattr(whole.table, field))
        assert scene.table.parts == whole.table.parts
        assert scene.rows_changed_since(whole) is not None


def test_scenes_of_the_same_nameless_obstacles_name_the_same_copies():
    boxes = [Box((1, 1, 1), at=(k, 0, 0)) for k in range(5)]
    one, two = Scene(boxes), Scene(boxes)
    assert [a is b for a, b in zip(one, two, strict=True)] == [True] * 5
    assert Scene(boxes[1:]).names == ("box-0", "box-1", "box-2", "box-3")
    assert one.names == ("box-0", "box-1", "box-2", "box-3", "box-4")
    assert pickle.loads(pickle.dumps(boxes[0])).named("box-0") is not one.obstacles[0]


def test_world_box_of_a_turned_part_holds_its_points():
    rng = np.random.default_rng(4)
    points = rng.normal(size=(60, 3))
    scene = Scene([ConvexHull(points, name="hull"), Sphere(0.5)]).moved("hull", random_pose(rng))
    pose = scene.obstacle("hull").pose
    world = points @ pose[:3, :3].T + pose[:3, 3]
    assert (np.abs(world - scene.table.center[0]) <= scene.table.half_extents[0] + 1e-12).all()
    np.testing.assert_allclose(scene.table.half_extents[1], 0.5)


def test_moving_obstacles_follow_the_time_of_the_scene():
    ball = Sphere(0.1, at=(1, 0, 0), motion=Twist((1, 0, 0)))
    scene = Scene([ball], time=3.0)
    assert scene.obstacles[0].pose[0, 3] == pytest.approx(4)
    assert scene.at(5).at(1).obstacles[0].pose[0, 3] == pytest.approx(2)
    assert scene.with_obstacle(ball.named("late")).obstacle("late").pose[0, 3] == pytest.approx(4)
    pose = np.eye(4)
    pose[:3, 3] = 10, 0, 0
    moved = scene.moved("sphere-0", pose)
    assert moved.obstacles[0].pose[0, 3] == 10
    assert moved.at(5).obstacles[0].pose[0, 3] == pytest.approx(12)


def test_moved_takes_an_se3():
    pin = pytest.importorskip("pinocchio")
    placement = pin.SE3.Random()
    moved = Scene([Sphere(1, name="a")]).moved("a", placement)
    np.testing.assert_allclose(moved.obstacle("a").pose, placement.homogeneous)


def test_pickling_keeps_the_snapshot():
    scene = mixed(np.random.default_rng(5)).at(0.4)
    copy = pickle.loads(pickle.dumps(scene))
    assert copy.names == scene.names
    assert copy.time == scene.time
    np.testing.assert_array_equal(copy.table.center, scene.table.center)
    np.testing.assert_allclose(copy.at(1.0).table.center, scene.at(1.0).table.center)


def test_a_difference_leaves_out_what_was_there_before():
    rng = np.random.default_rng(6)
    before = Scene(mixed(rng), time=1.0)
    ball = Sphere(0.2, at=(1.0, 0.0, 0.3), name="new")
    after = Scene([*before.obstacles[1:], ball], time=1.5, held_up="a camera is late", remark="a sonar hears glass")
    told = pickle.loads(pickle.dumps(difference(after, before)))
    places = [o for o in told[3] if isinstance(o, int)]
    assert places == [k for k, o in enumerate(before) if k > 0 and o.motion is None], "what moves is elsewhere by now"
    there = pickle.loads(pickle.dumps(before))
    again = with_difference(there, told)
    assert (again.names, again.time, again.stamp) == (after.names, 1.5, 1.5)
    assert (again.held_up, again.remark) == (after.held_up, after.remark)
    same, changed = pickle.loads(pickle.dumps(after)).without("new"), after.at(2.0)
    assert (same.held_up, same.remark) == (after.held_up, after.remark)
    assert (changed.held_up, changed.remark) == ("", ""), "of another time nothing is said"
    still = [k for k, o in enumerate(again) if o.motion is None and o.name != "new"]
    assert all(again.obstacles[k] is there.obstacle(again.names[k]) for k in still), "the same objects as before"
    assert with_difference(None, difference(after, None)).names == after.names


def calls(action):
    """Python calls that an action makes: a measure of its work that no busy machine changes."""
    count = 0

    def note(frame, event, argument):
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(note)
    try:
        action()
    finally:
        sys.setprofile(None)
    return count


def test_moving_one_of_many_costs_what_moving_one_of_few_does():
    """No loop over parts: the number of calls does not depend on how many stand still."""
    rng = np.random.default_rng(6)
    small = Scene([Box((0.3, 0.3, 0.3), at=rng.uniform(-3, 3, 3), name=f"b{k}") for k in range(4)])
    pose = random_pose(rng)
    assert small.table is not None
    cells = np.stack(np.meshgrid(np.arange(200), np.arange(30), np.arange(10), indexing="ij"), -1).reshape(-1, 3)
    large = Scene([Voxels(cells * 0.05, 0.05), *(Box((0.3, 0.3, 0.3), name=f"b{k}") for k in range(10))])
    assert large.table is not None
    few, many = (calls(lambda scene=scene: scene.moved("b3", pose).table) for scene in (small, large))
    assert 0 < many <= few + 5


@each("unseen", [(), (0, 1), (2,), (1, 3), (0, 4), (0, 1, 2, 3, 4)])
def test_what_was_seen_has_the_same_parts_as_if_it_were_alone(unseen):
    made = [
        Box((0.1, 0.2, 0.3), at=(k, 0.5 * k, 1.0), name=f"{UNSEEN_LAYER if k in unseen else 'box'}-{k}")
        for k in range(5)
    ]
    scene = Scene(made, time=2.0)
    kept = [o for k, o in enumerate(made) if k not in unseen]
    alone, seen = Scene(kept, time=2.0), scene.seen
    assert seen.obstacles == tuple(kept)
    assert (seen is scene) == (not unseen)
    assert seen.seen is seen
    assert (seen.names, seen.time) == (alone.names, 2.0)
    for name in ("obstacle_index", "offsets", "rotation", "translation", "center", "half_extents", "radius"):
        np.testing.assert_array_equal(getattr(seen.table, name), getattr(alone.table, name))
    assert seen.table.parts == alone.table.parts


def test_an_obstacle_is_where_it_was_seen_at_the_time_at_which_it_was():
    walk = Twist((0.5, 0.0, 0.0), (0.0, 0.0, 0.2))
    seen = Box((0.4, 0.4, 1.0), at=(2.0, 1.0, 0.5), name="cart", motion=walk, time=10.0)
    np.testing.assert_array_equal(Scene([seen], time=10.0).obstacle("cart").pose, seen.pose)
    later = Scene([seen], time=12.0).obstacle("cart")
    np.testing.assert_allclose(later.pose[:3, 3], (3.0, 1.0, 0.5))
    of_old = Box((0.4, 0.4, 1.0), at=(2.0, 1.0, 0.5), name="cart", motion=walk)
    np.testing.assert_allclose(Scene([seen], time=12.0).obstacle("cart").pose, of_old.at(2.0).pose, atol=1e-12)
    copy = pickle.loads(pickle.dumps(seen))
    np.testing.assert_allclose(copy.at(11.0).pose, seen.at(11.0).pose)
    with pytest.raises(SceneError):
        Box((0.4, 0.4, 1.0), name="cart", motion=Keyframes((0.0, 1.0), ((0.0, 0.0, 0.5), (1.0, 0.0, 0.5))), time=3.0)
    with pytest.raises(InputError):
        Box((0.4, 0.4, 1.0), name="cart", motion=walk, time=float("nan"))
