"""Obstacle proximity equals brute force over all Coal pairs, and asks for hardly any of them."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pinocchio as pin
import pytest
from brute_force import SHAPES, configuration, link_distances, make_scene, random_coordinates, random_pose, scene_pieces
from cases import each, each_robot

from elastic_strips.collision import BodySet, ObstacleProximity, obstacles
from elastic_strips.collision.candidates import NodePrediction
from elastic_strips.collision.narrowphase import GJK_EXCESS
from elastic_strips.native import twin
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.scene import Box, Scene, Sphere, Voxels
from elastic_strips.strip import Deformer, Strip

INFLUENCE = 0.3
GJK_NOISE = 3e-6
"""What Coal itself scatters by when both shapes are expressed in another frame [m]."""


class Bench:
    """A robot's proximity next to brute force, through a history of strips and scenes."""

    def __init__(self, robot: RobotModel, scene: Scene, coordinates: np.ndarray, **options: float) -> None:
        self.robot, self.scene, self.coordinates = robot, scene, coordinates
        self.kin = Kinematics(robot.tree, 4)
        self.proximity = ObstacleProximity(BodySet.links(robot), influence=INFLUENCE, **options)

    def update(self) -> None:
        self.kin.update(self.coordinates)
        self.proximity.update(self.kin, self.scene)

    def truth(self) -> np.ndarray:
        """Distances (N, G, P) to all parts of the scene."""
        return np.array(
            [link_distances(self.robot, self.scene, configuration(self.robot, row)) for row in self.coordinates]
        )

    def check(self, *, tolerance: float = GJK_NOISE) -> int:
        """Compare bounds, exact distances, contacts and clearance with brute force; returns the number of contacts."""
        proximity, truth = self.proximity, self.truth()
        rows = proximity.candidates.rows
        inside = truth[:, :, rows]
        blocks = np.array([part.geometry is None for part in proximity.candidates.parts], dtype=bool)
        # Coal's tree stops at the first box of a block that penetrates: there the deepest one may lie deeper
        deep = blocks[None, None, :] & (inside <= 0.0)
        assert (proximity.bound <= inside + 1e-9)[~deep].all()
        assert (proximity.bound[deep] <= 1e-9).all()
        outside = np.delete(truth, rows, axis=2)
        assert outside.min(initial=np.inf) >= INFLUENCE - 1e-9
        contacts = proximity.contacts()
        found = np.zeros(inside.shape, dtype=bool)
        found[contacts.node, contacts.body, contacts.part] = True
        assert found[inside < INFLUENCE - tolerance].all(), "a pair within the influence distance is missing"
        assert not found[inside > INFLUENCE + tolerance].any()
        assert len(contacts) == found.sum()
        nearest = inside.min(initial=np.inf)
        if nearest < INFLUENCE:
            assert not proximity.nearer_than(nearest - tolerance)
            assert proximity.nearer_than(nearest + 2.0 * proximity.tolerance + tolerance)
        error = np.abs(contacts.distance - inside[found])
        assert error[~deep[found]].max(initial=0.0) <= tolerance
        assert (contacts.distance[deep[found]] <= tolerance).all()
        np.testing.assert_allclose(np.linalg.norm(contacts.direction, axis=1), 1.0, atol=1e-6)
        nearest = truth.min(axis=2, initial=np.inf)
        clearance = proximity.clearance()
        free = nearest > 0.0
        assert (clearance <= np.minimum(nearest, INFLUENCE) + 1e-9)[free].all()
        assert (clearance >= np.minimum(nearest, INFLUENCE) - 2.0 * (tolerance + GJK_EXCESS))[free].all()
        return len(contacts)


def start(robot: RobotModel, rng: np.random.Generator, *, nodes: int = 5, count: int = 18, **options: float) -> Bench:
    bench = Bench(robot, make_scene(rng, count), random_coordinates(robot, rng, nodes), **options)
    bench.update()
    return bench


def keep_what_is_near(patches: pytest.MonkeyPatch, *, always: int = 3) -> None:
    """As in scenes of very many parts: each body keeps those near it, and one floor for all others."""
    patches.setattr(obstacles, "_FEW_PAIRS", 0)
    patches.setattr(obstacles, "_ROOM", 0.06)
    patches.setattr(obstacles, "_MOST_ALWAYS", always)


@each("always", [0, 3, 50])
def test_of_very_many_parts_only_those_near_a_body_are_kept(silvermate, always, monkeypatch):
    """The same contacts and bounds that hold, whoever moves: nodes, few obstacles or many of them."""
    rng = np.random.default_rng(3)
    everything = start(silvermate, rng, nodes=5, count=40)
    keep_what_is_near(monkeypatch, always=always)
    near = Bench(silvermate, everything.scene, everything.coordinates)
    near.update()
    for turn in range(3):
        for bench in (everything, near):
            bench.check(tolerance=bench.proximity.tolerance + GJK_NOISE)
        one, two = everything.proximity.contacts(), near.proximity.contacts()
        assert set(zip(one.node, one.body, one.part, strict=True)) ^ set(
            zip(two.node, two.body, two.part, strict=True)
        ) <= {
            at
            for c in (one, two)
            for at, d in zip(zip(c.node, c.body, c.part, strict=True), c.distance, strict=True)
            if d > INFLUENCE - 1e-3
        }
        assert len(one) > 10
        kept = np.isfinite(near.proximity.bound).all() and len(near.proximity._rows)
        assert 0 < kept < 0.8 * everything.proximity.bound.size
        step = 0.02 * rng.normal(size=everything.coordinates.shape)
        coordinates = silvermate.space.integrate(everything.coordinates, step)
        scene = everything.scene
        for name in rng.choice(scene.names, (1, 20)[turn % 2], replace=False).tolist():
            pose = scene.obstacle(name).pose.copy()
            pose[:3, 3] += 0.02 * rng.normal(size=3)
            scene = scene.moved(name, pose)
        for bench in (everything, near):
            bench.coordinates, bench.scene = coordinates, scene
            bench.update()


def test_far_parts_of_long_segments_are_not_forgotten(silvermate, monkeypatch):
    """A segment is certified by the bounds at both its ends: what is near to one alone must not be passed over."""
    rng, certified = np.random.default_rng(8), 0
    home = silvermate.space.to_coordinates(silvermate.home())
    for _ in range(16):
        goal = home.copy()
        goal[:3] += (rng.uniform(0.3, 2.0), rng.uniform(-0.2, 0.2), rng.uniform(-0.4, 0.4))
        rows = silvermate.space.interpolate(home[None], goal[None], np.linspace(0.0, 1.0, int(rng.integers(2, 6))))
        strip = Strip.from_coordinates(silvermate, rows)
        at = rng.uniform((-1.0, 0.34, 0.1), (3.0, 1.2, 1.2), (80, 3))
        at[:, 1] *= np.where(rng.random(80) < 0.5, -1.0, 1.0)
        scene = Scene([Box((0.1, 0.1, 0.1), at=p) for p in at])
        with monkeypatch.context() as patches:
            wanted = Deformer(silvermate).certify(strip, scene)
            keep_what_is_near(patches)
            found = Deformer(silvermate).certify(strip, scene)
            with twin():
                other = Deformer(silvermate).certify(strip, scene)
        np.testing.assert_array_equal(found.states, wanted.states)
        np.testing.assert_array_equal(other.states, wanted.states)
        certified += found.certified
    assert 2 < certified < 15


@each_robot
def test_equals_brute_force_on_every_shape(robot, brief):
    for seed in range(1 if brief else 3):
        rng = np.random.default_rng(seed)
        bench = start(robot, rng, nodes=6)
        assert {o.shape for o in bench.scene} == set(SHAPES)
        assert bench.check() > 25
        contacts = bench.proximity.contacts()
        assert (contacts.distance < 0).any()
        assert (contacts.distance > 0).any()


def test_every_shape_is_met_separated_and_penetrating(silvermate):
    rng, met = np.random.default_rng(5), set()
    for _ in range(6):
        bench = start(silvermate, rng, nodes=8)
        contacts = bench.proximity.contacts()
        parts = bench.proximity.candidates.obstacle[contacts.part]
        met |= {(bench.scene.obstacles[k].shape, d < 0) for k, d in zip(parts, contacts.distance, strict=True)}
    assert met == {(shape, inside) for shape in SHAPES for inside in (True, False)}


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize("name", ["silvermate", "rover"])
def test_bounds_hold_through_any_history(name, many, request, monkeypatch):
    """Small node motions, obstacle motions, insertion and removal, long moves: the bound is never above the truth."""
    if many:
        keep_what_is_near(monkeypatch)
    robot, rng = request.getfixturevalue(name), np.random.default_rng(11)
    bench = start(robot, rng, nodes=5, count=14, slack=0.25)
    tolerance = bench.proximity.tolerance + 1e-6
    rebuilt, windows = 0, bench.proximity.candidates
    for turn in range(18):
        kind = turn % 6
        n = len(bench.coordinates)
        step = rng.normal(size=bench.coordinates.shape) * 10.0 ** rng.uniform(-6, -2.5)
        if kind in (0, 1):  # all nodes, a little
            bench.coordinates = robot.space.integrate(bench.coordinates, step)
        elif kind == 2:  # one node
            bench.coordinates = bench.coordinates.copy()
            bench.coordinates[rng.integers(n)] = robot.space.integrate(bench.coordinates, 30 * step)[0]
        elif kind == 3:  # obstacles move, one from far away
            for name_ in rng.choice(bench.scene.names, 2, replace=False):
                at, quat = random_pose(rng, (-1.5, -1.5, 0.0), (1.5, 1.5, 1.5))
                pose = pin.XYZQUATToSE3(np.r_[at, quat]).homogeneous
                bench.scene = bench.scene.moved(str(name_), pose)
        elif kind == 4:  # a node comes in, another goes
            new = robot.space.interpolate(bench.coordinates[1], bench.coordinates[2], 0.5)
            keep = [i for i in range(n) if i != 3]
            rows = [bench.coordinates[i] for i in keep]
            rows.insert(2, new)
            source = [*keep[:2], -1, *keep[2:]]
            bench.proximity.remap(np.array(source))
            bench.coordinates = np.array(rows)
        else:  # far away: the window is collected anew
            side = 2.0 * (turn % 4)
            bench.coordinates = random_coordinates(robot, rng, n, low=(-1.0 - side, -1.0), high=(1.0 - side, 1.0))
        bench.update()
        rebuilt += bench.proximity.candidates is not windows
        windows = bench.proximity.candidates
        bench.check(tolerance=tolerance)
    assert 3 <= rebuilt < 18


@each("name", ["silvermate", "tiago", "rover"])
def test_bounds_of_exact_pairs_survive_large_moves(name, request):
    """With an influence distance of almost nothing no pair is asked again: the bounds live on their drift alone."""
    robot, rng = request.getfixturevalue(name), np.random.default_rng(3)
    for _ in range(6):
        scene = make_scene(rng, 12, shapes=SHAPES[:6])
        coordinates = random_coordinates(robot, rng, 6)
        kin = Kinematics(robot.tree, 6)
        proximity = ObstacleProximity(BodySet.links(robot), influence=1e-6, slack=5.0)
        kin.update(coordinates)
        proximity.update(kin, scene)
        pairs = proximity.bound.size
        proximity.refine_at(kin, np.arange(pairs), np.full(pairs, 1e3))
        step = rng.normal(size=coordinates.shape) * rng.uniform(0.01, 0.3)
        step[:, : robot.space.base_nv] *= rng.random((6, robot.space.base_nv)) < 0.3
        coordinates = np.clip(robot.space.integrate(coordinates, step), robot.space.lower, robot.space.upper)
        kin.update(coordinates)
        asked = proximity.narrow.queries
        proximity.update(kin, scene)
        truth = np.array([link_distances(robot, scene, configuration(robot, row)) for row in coordinates])
        assert (proximity.bound <= truth[:, :, proximity.candidates.rows] + GJK_NOISE).all()
        assert proximity.narrow.queries - asked < 0.7 * pairs


def test_scenes_come_and_go(silvermate, rng):
    bench = start(silvermate, rng, nodes=3, count=9)
    scene = bench.scene
    for other in (scene.without(scene.names[0]), scene.with_obstacle(Sphere(0.2, at=(0, 0, 0.8))), Scene([]), scene):
        bench.scene = other
        bench.update()
        bench.check()
    bench.proximity.reset()
    bench.update()
    bench.check()


def test_an_obstacle_that_comes_in_from_far_away_is_seen(silvermate):
    scene = Scene([Box((0.2, 0.2, 0.2), at=(50, 0, 0.5), name="comet"), Box((0.2, 0.2, 0.2), at=(1, 0, 0.5))])
    bench = Bench(silvermate, scene, silvermate.space.to_coordinates(silvermate.home())[None])
    bench.update()
    assert len(bench.proximity.candidates) == 1
    pose = np.eye(4)
    pose[:3, 3] = 0.45, 0.0, 0.5
    bench.scene = scene.moved("comet", pose)
    bench.update()
    assert bench.check() > 0
    names = {bench.proximity.obstacle_name(int(p)) for p in bench.proximity.contacts().part}
    assert "comet" in names
    bench.scene = bench.scene.moved("comet", scene.obstacle("comet").pose)
    bench.update()
    bench.check()


def test_moving_back_and_forth_leaves_no_trace(silvermate, rng):
    """Drift is charged for motion, not for time: a thousand updates without motion change nothing."""
    bench = start(silvermate, rng)
    bound, asked = bench.proximity.bound.copy(), bench.proximity.narrow.queries
    for _ in range(20):
        bench.update()
    np.testing.assert_array_equal(bench.proximity.bound, bound)
    assert bench.proximity.narrow.queries == asked


def corridor(count: int) -> Scene:
    """Obstacles along 8 m, on both sides of the way and above it."""
    rng = np.random.default_rng(2)
    return make_scene(rng, count, low=(-1.0, -2.5, 0.0), high=(9.0, 2.5, 1.5), shapes=SHAPES[:6])


def test_hardly_any_pair_is_asked(silvermate):
    """The proof that the culling works: queries against the number of node–link–part triples."""
    home = silvermate.space.to_coordinates(silvermate.home())
    coordinates = np.tile(home, (60, 1))
    coordinates[:, 0] = np.linspace(0.0, 8.0, 60)
    bench = Bench(silvermate, corridor(120), coordinates)
    bench.update()
    pairs = 60 * len(silvermate.geometries) * 120
    first = bench.proximity.narrow.queries
    contacts = len(bench.proximity.contacts())
    assert contacts > 100
    assert first < 0.03 * pairs, (first, pairs)
    assert first < 8 * contacts, (first, contacts)
    bench.coordinates = coordinates.copy()
    bench.coordinates[30, 1] += 0.01  # one node moves: only its pairs are asked again
    bench.update()
    second = bench.proximity.narrow.queries - first
    assert 0 < second < 4 * first / 60, (second, first)
    bench.check(tolerance=1.1e-4)


@each("native", [True, False])
def test_what_boxes_keep_apart_is_not_asked(silvermate, native):
    """In front of the flat front of the base, whose capsule reaches further than it."""
    home = silvermate.space.to_coordinates(silvermate.home())[None]
    with nullcontext() if native else twin():
        bench = Bench(silvermate, Scene([Box((0.1, 0.4, 0.2), at=(2.0, 0.0, 0.1), name="crate")]), home)
        bench.update()
        front = 2.0 - 0.05 - bench.truth()[0, :, 0].min()  # [m] where the base ends
        pose = np.eye(4)
        pose[:3, 3] = front + INFLUENCE + 0.06, 0.0, 0.1
        bench.scene = bench.scene.moved("crate", pose)
        bench.update()
        candidates, bodies = bench.proximity.candidates, bench.proximity.bodies
        part = np.zeros(len(bodies), dtype=np.intp)
        capsules = candidates.capsule_distance(bodies.capsule_ends(bench.kin)[0], bodies.radius, part, None)
        assert capsules.min() < INFLUENCE
        assert bench.proximity.narrow.queries == 0
        assert bench.proximity.bound.min() >= INFLUENCE
        bench.check()


@each("native", [True, False])
def test_control_points_are_measured_as_links_are(silvermate, native):
    """Their shapes are made where the bodies are, and nobody has asked them for their boxes yet."""
    coordinates = silvermate.space.to_coordinates(silvermate.home())[None]
    points = silvermate.control_points(silvermate.home())
    ball = Sphere(0.05, at=tuple(points[-1] + [0.2, 0.0, 0.0]), name="ball")
    with nullcontext() if native else twin():
        bodies = BodySet.control_points(silvermate)
        proximity, kin = ObstacleProximity(bodies, influence=INFLUENCE), Kinematics(silvermate.tree, 1)
        kin.update(coordinates)
        proximity.update(kin, Scene([ball]))
        contacts = proximity.contacts()
    assert np.isfinite(bodies.boxes[1]).all()
    truth = np.linalg.norm(points - ball.pose[:3, 3], axis=1) - 0.05
    assert set(contacts.body.tolist()) == set(np.flatnonzero(truth < INFLUENCE).tolist())
    np.testing.assert_allclose(contacts.distance, truth[contacts.body], atol=1e-4)


def test_a_moved_obstacle_is_asked_alone(silvermate):
    coordinates = np.tile(silvermate.space.to_coordinates(silvermate.home()), (20, 1))
    coordinates[:, 0] = np.linspace(0.0, 2.0, 20)
    scene = corridor(60).with_obstacle(Sphere(0.1, at=(1.0, 0.6, 0.3), name="ball"))
    bench = Bench(silvermate, scene, coordinates)
    bench.update()
    asked = bench.proximity.narrow.queries
    pose = np.eye(4)
    pose[:3, 3] = 1.0, 0.55, 0.3
    bench.scene = scene.moved("ball", pose)
    bench.update()
    assert 0 < bench.proximity.narrow.queries - asked <= 20 * len(silvermate.geometries)
    bench.check(tolerance=1.1e-4)


def test_blocks_of_boxes_give_the_nearest_box(silvermate, rng):
    cells = np.unique(rng.integers(0, 25, (1500, 3)), axis=0) * 0.05
    scene = Scene([Voxels(cells, 0.05, at=(0.45, -0.6, 0.1), quat=(0, 0, 0.6, 0.8))])
    bench = Bench(silvermate, scene, random_coordinates(silvermate, rng, 6, low=(-0.6, -0.6), high=(0.3, 0.3)))
    bench.update()
    assert len(scene_pieces(scene)) > 300
    assert bench.check() > 50


def test_blocks_give_the_deepest_box():
    import coal

    from elastic_strips.robot.loading import load_robot

    robot = load_robot("silvermate")
    cells = np.array([[x, y, z] for x in range(8) for y in range(8) for z in range(3)]) * 0.05
    cells = cells[(cells.sum(axis=1) * 100).astype(int) % 2 == 0]
    scene = Scene([Voxels(cells, 0.05, at=(-0.2, -0.2, 0.1))])
    bench = Bench(robot, scene, robot.space.to_coordinates(robot.home())[None])
    bench.update()
    truth, found = bench.truth()[0], bench.proximity.exact[0]
    deep = truth[:, bench.proximity.candidates.rows] < -0.01
    assert deep.any()
    assert isinstance(scene.obstacles[0].parts[0].boxes[0][0], coal.Box)
    np.testing.assert_allclose(found[deep], truth[:, bench.proximity.candidates.rows][deep], atol=1e-5)


def test_control_points_are_measured_as_points(silvermate, rng):
    scene = Scene([Sphere(0.3, at=(0.9, 0.1, 0.9)), Box((0.4, 0.4, 1.0), at=(-0.8, 0.0, 0.5))])
    coordinates = random_coordinates(silvermate, rng, 8)
    kin = Kinematics(silvermate.tree, 8)
    kin.update(coordinates)
    proximity = ObstacleProximity(BodySet.control_points(silvermate), influence=1.5, slack=1.0)
    proximity.update(kin, scene)
    contacts = proximity.contacts()
    assert len(contacts) > 50
    for n, g, p, d in zip(contacts.node, contacts.body, contacts.part, contacts.distance, strict=True):
        point = silvermate.control_points(configuration(silvermate, coordinates[n]))[g]
        if proximity.obstacle_name(int(p)).startswith("sphere"):
            expected = np.linalg.norm(point - [0.9, 0.1, 0.9]) - 0.3
        else:
            gap = np.abs(point - [-0.8, 0.0, 0.5]) - [0.2, 0.2, 0.5]
            expected = np.linalg.norm(np.maximum(gap, 0.0)) + min(gap.max(), 0.0)
        assert d == pytest.approx(expected, abs=1e-9)


def test_many_scenes_do_not_mix_up_their_blocks(silvermate):
    """Parts are told apart by identity; what is forgotten must be forgotten everywhere."""
    coordinates = silvermate.space.to_coordinates(silvermate.home())[None]
    kin = Kinematics(silvermate.tree, 1)
    kin.update(coordinates)
    proximity = ObstacleProximity(BodySet.links(silvermate), influence=INFLUENCE)
    rng = np.random.default_rng(3)
    for turn in range(60):
        if turn == 30:  # as after very many scenes
            proximity.narrow._functors.update({(-1, k): None for k in range(200_001)})
        size = rng.uniform(0.05, 0.3)
        scene = Scene([Voxels(np.zeros((1, 3)), size, at=(0.65, 0.0, 0.5))])
        proximity.update(kin, scene)
        truth = link_distances(silvermate, scene, silvermate.home())
        near = truth < INFLUENCE
        np.testing.assert_allclose(proximity.exact[0][near], truth[near], atol=1e-6)


def test_old_scenes_are_not_kept_for_ever(silvermate):
    """A sensor makes new blocks every tick: the workspace must not grow without end."""
    kin = Kinematics(silvermate.tree, 1)
    kin.update(silvermate.space.to_coordinates(silvermate.home())[None])
    proximity = ObstacleProximity(BodySet.links(silvermate), influence=INFLUENCE)
    for turn in range(1500):
        proximity.update(kin, Scene([Voxels(np.zeros((1, 3)), 0.1, at=(0.5 + 1e-5 * turn, 0.0, 0.5))]))
    assert len(proximity.narrow._blocks) < 10


def test_what_stands_where_it_stood_is_not_asked_again_when_others_come_and_go(silvermate, rng):
    bench = start(silvermate, rng, nodes=6, count=16)
    every = bench.proximity.narrow.queries
    for turn in range(6):
        name = bench.scene.names[turn]
        shape = bench.scene.obstacle(name)
        bench.scene = bench.scene.without(name)
        bench.update()
        bench.check()
        if turn % 2:
            bench.scene = bench.scene.with_obstacle(shape)  # the same again, at the end of the table
            bench.update()
            bench.check()
    assert every > 60
    assert bench.proximity.narrow.queries - every < 0.5 * every, "three came back, of sixteen"


@pytest.mark.parametrize("name", ["silvermate", "rover"])
def test_bounds_hold_while_obstacles_are_exchanged_moved_and_forecast(name, request):
    """Against a proximity that starts from nothing each time: what it carries over is never above the truth."""
    robot, rng = request.getfixturevalue(name), np.random.default_rng(5)
    bench = start(robot, rng, nodes=5, count=12, slack=0.25)
    kept = bench.proximity
    contacts = 0
    for turn in range(60):
        scene, names = bench.scene, list(bench.scene.names)
        change = turn % 5
        if change == 0:
            scene = scene.without(str(rng.choice(names)))
        elif change in (1, 2):
            fresh = make_scene(rng, 1).obstacles[0].named(f"new{turn}")
            scene = Scene([fresh, *scene]) if change == 1 else scene.with_obstacle(fresh)
        elif change == 3:  # another solid under the same name
            other = make_scene(rng, 1).obstacles[0].named(names[0])
            scene = scene.without(names[0]).with_obstacle(other)
        if change > 2:
            pose = scene.obstacle(names[1]).pose.copy()
            pose[:3, 3] += rng.normal(size=3) * 0.3
            scene = scene.moved(names[1], pose)
        bench.scene = scene
        bench.coordinates = robot.space.integrate(
            bench.coordinates, rng.normal(size=bench.coordinates.shape) * 10.0 ** rng.uniform(-6, -2)
        )
        prediction = None
        if turn % 3:
            n, movers = len(bench.coordinates), rng.choice(len(scene), 2, replace=False)
            shift = np.cumsum(rng.normal(size=(n, 2, 3)) * 0.05, axis=0)
            prediction = NodePrediction(np.sort(movers), shift, rng.uniform(0.0, 0.05, (n, 2)), rng.random(n) < 0.1)
        bench.kin.update(bench.coordinates)
        kept.update(bench.kin, scene, prediction)
        fresh = ObstacleProximity(BodySet.links(robot), influence=INFLUENCE, slack=0.25)
        fresh.update(bench.kin, scene, prediction)
        _, mine, its = np.intersect1d(kept.candidates.rows, fresh.candidates.rows, return_indices=True)
        near = fresh.exact[:, :, its] < INFLUENCE - 0.01
        bound, exact = kept.bound[:, :, mine], fresh.exact[:, :, its]
        assert (bound <= exact + GJK_NOISE)[exact < np.inf].all(), turn
        assert near.sum() == (fresh.exact < INFLUENCE - 0.01).sum(), "a part that is near is no candidate"
        np.testing.assert_allclose(kept.exact[:, :, mine][near], exact[near], atol=3e-3)
        contacts += int(near.sum())
    assert contacts > 300
