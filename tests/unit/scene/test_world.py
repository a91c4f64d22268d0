"""World: what exists when, snapshots that share what did not change, refusals that name what is wrong."""

import math
import pickle

import numpy as np
import pytest
from cases import each

from elastic_strips.errors import SceneError
from elastic_strips.scene import Box, Cylinder, Keyframes, Scene, Sphere, Twist, UnknownMotion, Voxels, World
from elastic_strips.scene import scene as scene_module


def items():
    return [
        Box((1, 1, 1), name="crate", at=(5, 5, 0.5)),
        Voxels(np.stack(np.meshgrid(*[np.arange(12) * 0.1] * 3), axis=-1).reshape(-1, 3), 0.1, name="shelf"),
        Cylinder(0.3, 1.8, name="person", at=(0, 0, 0.9), motion=Twist((0.5, 0, 0))),
        Sphere(0.2, name="ball", motion=Keyframes([0, 4, 8], [[0, 3, 1], [4, 3, 1], [0, 3, 1]], loop=True)),
    ]


def test_an_obstacle_exists_from_appears_on_until_vanishes():
    world = World(Scene(items()), {"person": 2.0, "crate": 2.0}, {"person": 6.0})
    for t, names in [
        (-1.0, ("shelf", "ball")),
        (math.nextafter(2.0, 0.0), ("shelf", "ball")),
        (2.0, ("crate", "shelf", "person", "ball")),
        (math.nextafter(6.0, 0.0), ("crate", "shelf", "person", "ball")),
        (6.0, ("crate", "shelf", "ball")),
        (1e6, ("crate", "shelf", "ball")),
    ]:
        assert world.at(t).names == names
        assert world.at(t).time == t
        assert tuple(n for n in world.scene.names if world.exists(n, t)) == names
    assert world.event_times == (2.0, 6.0)
    assert world.names_moving == ("person", "ball")


def test_poses_are_those_of_a_scene_made_anew():
    """In any order of times: snapshots derived from one another do not drift."""
    world = World(Scene(items(), time=1.0), {"person": 2.0}, {"ball": 7.0})
    rng = np.random.default_rng(5)
    for t in (*rng.uniform(-3, 12, 40).tolist(), *np.arange(0, 10, 0.3).tolist()):
        fresh = Scene([o for o in items() if world.exists(o.name, t)], time=t)
        snapshot = world.at(t)
        assert snapshot.names == fresh.names
        np.testing.assert_allclose(snapshot.table.translation, fresh.table.translation, atol=1e-12)
        np.testing.assert_allclose(snapshot.table.half_extents, fresh.table.half_extents, atol=1e-12)


def test_consecutive_snapshots_share_what_did_not_change():
    """The parts are the same objects, static obstacles too, and only the movers' rows count as changed."""
    world = World(Scene(items()), {"crate": 1.0})
    before = world.at(2.0)
    rows = len(before.table)
    after = world.at(2.01)
    assert after.table.parts is before.table.parts
    assert after.obstacle("shelf") is before.obstacle("shelf")
    changed = after.rows_changed_since(before)
    assert set(after.table.obstacle_index[changed]) == {after.names.index("person"), after.names.index("ball")}
    assert len(changed) == 2 < rows
    assert world.at(2.01) is after
    back = world.at(0.5)
    assert back.rows_changed_since(after) is None  # the crate is not there yet: another set of obstacles
    again = world.at(2.5)
    assert again.table.parts is after.table.parts  # the table of that set of obstacles was kept


def test_a_scene_alone_is_a_world():
    scene = Scene(items())
    world = World(scene)
    assert world.at(0.0).table is scene.table
    assert scene.stamp is None  # a map, which was made for no time in particular
    assert [world.at(t).stamp for t in (0.0, 3.0)] == [0.0, 3.0]
    assert world.at(3.0).names == scene.names
    assert world.event_times == ()


def test_the_speed_bound_counts_only_who_exists():
    fast = Sphere(0.1, name="fast", motion=Twist((3, 0, 0)))
    jumping = Sphere(0.1, name="jumping", motion=Keyframes([0, 10], [[0, 0, 0], [5, 0, 0]], loop=True))
    world = World(Scene([*items(), fast, jumping]), {"fast": 5.0}, {"fast": 6.0, "jumping": 4.0})
    assert world.speed_bound(start=1, end=2) == pytest.approx(1.0)
    assert world.speed_bound(start=4.5, end=5.5) == pytest.approx(3.0)
    assert world.speed_bound(start=6.5) == pytest.approx(1.0)
    assert world.speed_bound("person") == pytest.approx(0.5)
    assert world.speed_bound("crate") == 0.0
    assert world.speed_bound("jumping", start=1, end=3) == pytest.approx(0.5)
    assert world.speed_bound() == math.inf
    assert World(Scene([])).speed_bound() == 0.0


def test_a_world_is_immutable_and_pickles():
    world = World(Scene(items()), {"crate": 1.0}, {"person": 3.0})
    with pytest.raises(AttributeError):
        world.appears = {}
    with pytest.raises(TypeError):
        world.appears["ball"] = 2.0
    world.at(2.0)
    back = pickle.loads(pickle.dumps(world))
    assert (dict(back.appears), dict(back.vanishes)) == ({"crate": 1.0}, {"person": 3.0})
    assert back.at(3.5).names == world.at(3.5).names


def test_an_unknown_motion_keeps_its_snapshot():
    """Nothing is known to have moved, so nothing is measured again."""
    world = World(Scene([*items(), Sphere(0.3, name="seen", at=(1, 2, 0.3), motion=UnknownMotion(1.5))]))
    one, two = world.at(1.0), world.at(2.0)
    assert two.obstacle("seen") is one.obstacle("seen")
    assert "seen" in world.names_moving
    assert world.speed_bound("seen") == 1.5


BAD = [
    (lambda: World(items()), "needs a Scene"),
    (lambda: World(Scene(items()), {"persn": 1.0}), r"appears: no obstacle 'persn'.*did you mean 'person'"),
    (lambda: World(Scene(items()), {}, {"bal": 1.0}), r"vanishes: no obstacle 'bal'.*did you mean 'ball'"),
    (lambda: World(Scene(items()), {"person": math.nan}), "appears of 'person'=nan must be a finite"),
    (lambda: World(Scene(items()), {}, {"person": math.inf}), "vanishes of 'person'=inf must be a finite"),
    (lambda: World(Scene(items()), {"person": True}), "must be a finite number"),
    (lambda: World(Scene(items()), {"person": 2.0}, {"person": 2.0}), "'person' vanishes at 2 s.*later.*2 s"),
    (lambda: World(Scene(items()), [("person", 2.0)]), "must be a mapping"),
    (lambda: World(Scene(items())).at(math.nan), "time=nan must be a finite"),
    (lambda: World(Scene(items())).at("now"), "time='now' must be a finite number"),
    (lambda: World(Scene(items())).exists("cart", 0), "no obstacle 'cart' in the world"),
    (lambda: World(Scene(items())).speed_bound("crat"), "did you mean 'crate'"),
    (lambda: World(Scene(items())).speed_bound(start=2, end=1), "start <= end"),
]


@each("make, message", BAD)
def test_bad_worlds_are_refused(make, message):
    with pytest.raises(SceneError, match=message):
        make()


def test_what_is_sensed_of_a_world_shares_its_tables(monkeypatch):
    """Of a long run one table is made from nothing; the others differ from it in what moves."""
    made = []
    build = scene_module._build_table
    monkeypatch.setattr(scene_module, "_build_table", lambda obstacles: made.append(1) or build(obstacles))
    walker = Cylinder(0.2, 1.6, at=(0.0, 1.0, 0.8), name="walker", motion=Twist((0.5, 0.0, 0.0)))
    world = World(Scene([Box((1.0, 1.0, 1.0), at=(3.0, 0.0, 0.5), name="box"), walker]))
    for k in range(20):
        scene = world.at(0.05 * k)
        pose = np.array(scene.obstacle("walker").pose)
        pose[0, 3] += 0.01
        sensed = scene.with_observations([scene.obstacle("walker").observed(pose, Twist((0.5, 0.0, 0.0)))])
        assert sensed.table.translation[1, 0] == pytest.approx(0.5 * 0.05 * k + 0.01)
    assert len(made) == 1
