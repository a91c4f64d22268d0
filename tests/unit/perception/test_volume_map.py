"""Volume map: what is called free is free, the kernel is as its twin, windows roll, boxes fill the obstacles."""

from __future__ import annotations

import itertools
import math
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from cases import each, refused
from free_way import outside_scene

from elastic_strips.errors import ParameterError
from elastic_strips.native import kernel, twin
from elastic_strips.perception import DepthImage, RangeImage, SceneEstimatorParams
from elastic_strips.perception.image_movers import ImageView, moving_clusters
from elastic_strips.perception.lost_movers import LostMovers
from elastic_strips.perception.lost_pixels import StillImages, _filled, filled
from elastic_strips.perception.readings import camera_directions, turning_directions
from elastic_strips.perception.tracking import Tracker
from elastic_strips.perception.volume_map import VolumeMap, VolumeMapParams
from elastic_strips.scene import Box, Capsule, Cylinder, Scene, Sphere

SMALL = VolumeMapParams(
    length=8.0, height=2.0, range_max=5.0, thinnest=0.055, unseen_radius=0.7
)  # the images are coarse
EIGHTHS = np.stack(np.meshgrid(*[(0.25, 0.75)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)  # middles, of a voxel
LOOKS = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # of a camera that looks along x
ROOM = Scene(
    [
        Box((0.1, 6.0, 1.6), at=(2.6, 0.0, 0.8)),
        Box((0.8, 1.2, 0.06), at=(1.7, 0.4, 0.75)),
        Cylinder(0.03, 0.7, at=(1.4, -0.1, 0.35)),
        Sphere(0.2, at=(1.6, -0.8, 1.1)),
        Capsule(0.05, 0.6, at=(1.3, 0.9, 1.3), quat=(0.5, 0.5, 0.5, 0.5)),
    ]
)


def pose(x=0.0, y=0.0, z=1.0, yaw=0.0, tilt=0.0) -> np.ndarray:
    c, s, ct, st = math.cos(yaw), math.sin(yaw), math.cos(tilt), math.sin(tilt)
    T = np.eye(4)
    T[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ [[ct, 0, st], [0, 1, 0], [-st, 0, ct]]
    T[:3, 3] = x, y, z
    return T


_MET: dict[tuple[int, bytes, bytes], tuple[Scene, np.ndarray]] = {}


def met(scene: Scene, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """What is asked again and again is marched once."""
    key = (id(scene), origin.tobytes(), directions.tobytes())
    if key not in _MET:
        _MET[key] = scene, marched(scene, origin, directions, 9.0)  # kept with its scene: no other gets that id
    return _MET[key][1].copy()


def marched(scene: Scene, origin: np.ndarray, directions: np.ndarray, reach: float) -> np.ndarray:
    """Where unit rays meet a scene or the floor, by walking along them: nothing is shared with the package's rays."""
    at = np.zeros(len(directions))
    for _ in range(100):
        points = origin + at[:, None] * directions
        step = np.minimum(outside_scene(points, scene), points[:, 2])
        at = np.where(at < reach, at + np.maximum(0.9 * step, 0.0), at)
    return np.where(at >= reach, np.inf, at)


def depth_image(scene: Scene, T: np.ndarray, rows=54, columns=72, focal=50.0, noise=None) -> DepthImage:
    center = 0.5 * (columns - 1), 0.5 * (rows - 1)
    d = camera_directions(rows, columns, (focal, focal), center).reshape(-1, 3)
    T = T @ np.block([[LOOKS, np.zeros((3, 1))], [np.zeros((1, 3)), 1.0]])
    stretch = np.linalg.norm(d, axis=1)
    depth = met(scene, T[:3, 3], (d / stretch[:, None]) @ T[:3, :3].T) / stretch
    if noise is not None:
        there = np.where(np.isfinite(depth), depth, 0.0)
        depth = depth + np.clip(noise.standard_normal(depth.shape), -3, 3) * SMALL.sigma(there)
        depth[noise.random(depth.shape) < 0.02] = np.nan
    depth[depth > 8.0] = np.inf
    return DepthImage("camera", 0.0, T, depth.reshape(rows, columns), (focal, focal), center, 0.2, 8.0)


def range_image(scene: Scene, T: np.ndarray, rows=56, columns=280) -> RangeImage:
    azimuth, elevation = (-math.pi, math.pi - 2.0 * math.pi / columns), (-0.6, 0.5)
    d = turning_directions(rows, columns, azimuth, elevation).reshape(-1, 3)
    ranges = met(scene, T[:3, 3], d @ T[:3, :3].T).reshape(rows, columns)
    return RangeImage("lidar", 0.0, T, ranges, azimuth, elevation, 0.1, 12.0)


VIEWS = [pose(), pose(0.2, 0.5, 1.3, -0.3, 0.5), pose(-0.4, -0.6, 0.8, 0.25, 0.1), pose(0.1, 0.0, 1.2, 0.0, 0.9)]
PLACES = (
    np.stack(np.meshgrid(np.arange(-20, 80), np.arange(-60, 60), np.arange(40), indexing="ij"), axis=-1).reshape(-1, 3)
    + 0.5
)


def touched_by(scene: Scene, cells: np.ndarray, cell: float) -> np.ndarray:
    """Cells that surely hold some of a scene: a point of a fine grid in them is inside."""
    cells = cells[outside_scene(cells * cell, scene) < 0.9 * cell]  # half a voxel's diagonal: no others can
    steps = (np.arange(4) + 0.5) / 4 - 0.5
    inner = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    points = (cells[:, None] + inner).reshape(-1, 3) * cell
    return (outside_scene(points, scene) < 0.0).reshape(-1, len(inner)).any(axis=1)


@each("make, hole", list(itertools.product([depth_image, range_image], [0.0, 0.1])))
def test_nothing_of_the_world_is_called_free(make, hole):
    params = replace(SMALL, hole=hole)
    volume, rng = VolumeMap(params), np.random.default_rng(1)
    for T in VIEWS:
        image = make(ROOM, T, noise=rng) if make is depth_image else make(ROOM, T)
        volume.add(image, np.eye(4))
    known = volume.known(PLACES * params.cell)
    free = PLACES[known == 0]
    assert len(free) > 5000
    assert outside_scene(free * params.cell, ROOM).min() < 0.15  # some of it is near
    assert not touched_by(ROOM, free, params.cell).any()


def test_what_is_seen_is_an_obstacle_and_goes_when_it_has_gone():
    volume = VolumeMap(SMALL)
    for _ in range(3):
        volume.add(depth_image(ROOM, VIEWS[0]), np.eye(4))
    first = volume.obstacles()
    scene = Scene(first)
    on_wall, on_sphere = np.array([[2.56, -0.3, 1.0]]), np.array([[1.42, -0.8, 1.1]])
    for point in (on_wall, on_sphere):
        assert outside_scene(point, scene)[0] < SMALL.cell
    empty = Scene([o for o in ROOM if o.shape != "sphere"])
    for _ in range(10):
        volume.add(depth_image(empty, VIEWS[0]), np.eye(4))
    after = volume.obstacles()
    assert outside_scene(on_sphere, Scene(after))[0] > 0.15
    kept = {id(o) for o in first} & {id(o) for o in after}
    assert len(kept) > 0.5 * len(after)  # blocks in which nothing changed


def test_what_was_met_from_afar_and_is_not_met_from_nearby_is_no_obstacle():
    """From 3.4 m the points of a wall are noisy by 4 cm, and make it thick; from 0.8 m it is as thick as its voxels."""
    rng, volume = np.random.default_rng(5), VolumeMap(SMALL)
    wall = Scene([Box((0.1, 6.0, 1.6), at=(2.625, 0.0, 0.8))])
    y, z = (side.ravel() for side in np.meshgrid(np.arange(-0.275, 0.3, 0.05), [0.925, 0.975]))
    surface = np.column_stack((np.full(len(y), 2.575), y, z))
    before = np.concatenate([surface - [off, 0.0, 0.0] for off in (0.1, 0.15, 0.2)])
    for _ in range(40):
        volume.add(depth_image(wall, pose(-0.8), noise=rng), np.eye(4))
    thick = int((volume.known(before) == 1).sum())
    assert thick > 3
    for _ in range(40):
        volume.add(depth_image(wall, pose(1.75), noise=rng), np.eye(4))
    assert not (volume.known(before) == 1).any()
    assert (volume.known(surface) == 1).all()


def test_what_comes_where_it_was_free_has_moved():
    volume = VolumeMap(SMALL)
    for _ in range(3):
        image = depth_image(ROOM, VIEWS[0])
        assert not volume.seen_by(image, np.eye(4)).fresh.any()
        volume.add(image, np.eye(4))
    visitor = Cylinder(0.2, 1.4, at=(1.0, 0.2, 0.7))
    image = depth_image(Scene([*ROOM, visitor]), VIEWS[0])
    seen = volume.seen_by(image, np.eye(4))
    moved = np.zeros(image.depth.shape, dtype=bool)
    moved[seen.pixels] = seen.fresh
    new = image.depth < depth_image(ROOM, VIEWS[0]).depth - 0.1
    assert moved[new].mean() > 0.5
    assert not moved[~new].any()


@each("make", [VolumeMap, "twin"])
def test_who_comes_where_only_thin_things_could_be_is_seen_to_move(make):
    """Pixels too far apart to call anything free: it is in doubt what is there, but it is none of people."""
    with twin() if make == "twin" else nullcontext():
        volume = VolumeMap(replace(SMALL, thinnest=0.01))
        wall, person = Box((0.1, 9.0, 2.4), at=(3.6, 0.0, 1.2)), Cylinder(0.25, 1.7, at=(2.0, 0.3, 0.85))
        for _ in range(2):
            volume.add(depth_image(Scene([wall]), pose()), np.eye(4))
        place = np.array([[1.9, 0.3, 1.0]])
        assert volume.known(place) == [-1]
        assert volume.doubtful(place).all()
        seen = volume.seen_by(depth_image(Scene([wall, person]), pose()), np.eye(4))
        near = np.hypot(*(seen.points[:, :2] - person.pose[:2, 3]).T) < 0.3
        assert seen.fresh[near].mean() > 0.8
        assert not seen.fresh[~near].any()


def test_what_is_forgotten_was_not_seen_and_is_no_obstacle():
    volume = VolumeMap(SMALL)
    image = depth_image(ROOM, VIEWS[0])
    for _ in range(3):
        volume.add(image, np.eye(4))
    points = volume.seen_by(image, np.eye(4)).points
    assert (volume.known(points) == 1).any()
    volume.forget(points)
    assert (volume.known(points) == -1).all()


@each("unseen", ["free", "blocked"])
def test_what_has_come_may_have_gone_when_nothing_looks(unseen):
    """A crate comes before a wall, and the camera looks elsewhere; what had always been there stays what it was."""
    volume = VolumeMap(replace(SMALL, unseen=unseen, stood_time=3.0, ground=0.02))
    wall, crate = Box((0.1, 6.0, 1.6), at=(2.6, 0.0, 0.8)), Box((0.3, 0.3, 0.5), at=(1.4, 0.0, 0.25))
    T, away = pose(z=1.0, tilt=0.3), pose(z=1.0, yaw=math.pi)
    front, of_wall = np.array([[1.27, 0.0, 0.4]]), np.array([[2.57, 0.6, 0.6]])

    def look(scene: Scene, T: np.ndarray, *times: float) -> None:
        for t in times:
            volume.add(replace(depth_image(scene, T), time=t), np.eye(4))

    floor = Box((12.0, 12.0, 0.1), at=(0.0, 0.0, -0.05))
    empty, full = Scene([floor, wall]), Scene([floor, wall, crate])
    face = np.stack(np.meshgrid([1.27], np.arange(-0.175, 0.2, 0.05), np.arange(0.075, 0.5, 0.05)), axis=-1).reshape(
        -1, 3
    )
    look(empty, T, 0.0, 0.1, 0.2, 0.3, 0.4)
    assert volume.known(front) == 0
    look(full, T, 1.0, 1.1, 1.2, 1.3, 1.4)
    assert volume.known(front) == volume.known(of_wall) == 1
    assert (volume.known(face[face[:, 2] < 0.1]) == 1).any(), "where it stands on the floor"
    look(full, away, 4.0, 4.3)
    assert volume.known(front) == 1
    look(full, away, 4.5, 9.0)
    assert volume.known(front) == (-1 if unseen == "blocked" else 1)
    assert (volume.known(face) == 1).any() == (unseen == "free"), face[volume.known(face) == 1]
    assert volume.known(of_wall) == 1
    comes, goes = [0.1 * k for k in range(6)], [1.0 + 0.1 * k for k in range(12)]
    for begin in (10.0, 13.0):  # the second time it comes where it was free
        look(full, T, *(begin + t for t in comes))
        assert volume.known(front) == 1
        look(empty, T, *(begin + t for t in goes))
        assert volume.known(front) == 0
    look(empty, away, 20.0, 21.0)
    assert volume.known(front) == 0, "what was seen to be free again stays so"


def test_ignored_pixels_free_and_hit_nothing():
    volume = VolumeMap(SMALL)
    image = depth_image(ROOM, VIEWS[0])
    volume.add(image, np.eye(4), ignored=np.ones(len(volume.seen_by(image, np.eye(4)).points), dtype=bool))
    occupied, unseen = volume.counts
    assert occupied == 0
    assert unseen < VolumeMap(SMALL).counts[1] - 1000


@pytest.mark.skipif(kernel() is None, reason="there is no native kernel to compare")
@each("make", [depth_image, range_image])
def test_the_kernel_and_its_twin_know_the_same(make, brief):
    rng = np.random.default_rng(3)
    maps = []
    for other in (False, True):
        with twin() if other else nullcontext():
            maps.append(VolumeMap(SMALL))
    views = [*VIEWS, VIEWS[1]]
    for k in (0, 1, 3) if brief else range(len(views)):
        image = make(ROOM, views[k])
        base = pose(z=0.0, yaw=float(rng.uniform(-0.5, 0.5)))
        base[:2, 3] = (0.45 * k, -0.3 * k) if k > 2 else (0.0, 0.0)
        answers = []
        for volume in maps:
            volume.center(*base[:2, 3])
            moved = volume.seen_by(image, base).fresh
            volume.add(image, base)
            volume.forget(volume.seen_by(image, base).points[::5])
            solids = sorted(
                (o.name, [(tuple(b.halfSide), tuple(at)) for p in o.parts for b, at in p.boxes])
                for o in (*volume.obstacles(), *volume.in_doubt(float(base[0, 3]), 0.3))
            )
            answers.append((moved, volume.known(PLACES * SMALL.cell + base[:3, 3]), volume.counts, solids))
        one, two = answers
        np.testing.assert_array_equal(one[0], two[0])
        np.testing.assert_array_equal(one[1], two[1])
        assert one[2:] == two[2:]


def test_the_window_forgets_what_leaves_it():
    volume = VolumeMap(SMALL)
    volume.add(depth_image(ROOM, VIEWS[0]), np.eye(4))
    assert volume.obstacles()
    volume.center(30.0, 0.0)
    assert volume.obstacles() == []
    assert volume.counts[0] == 0
    assert (volume.known(PLACES * SMALL.cell) == -1).all()


@each("fine_range", [0.0, 1.5])
def test_boxes_fill_the_voxels_and_do_not_overlap(fine_range):
    params = replace(SMALL, fine_range=fine_range)
    volume = VolumeMap(params)
    for T in VIEWS:
        for _ in range(4):  # where rays end for the first times, only what the same image frees stays free
            volume.add(depth_image(ROOM, T), np.eye(4))
    low, high = (
        np.concatenate([[at + s * b.halfSide for b, at in p.boxes] for o in volume.obstacles() for p in o.parts])
        for s in (-1.0, 1.0)
    )
    cell = 0.5 * params.cell
    places = ((2 * (PLACES - 0.5)[:, None] + 2.0 * EIGHTHS) * cell).reshape(-1, 3)
    full = places[volume.known(places) == 1]
    inside = np.array([((place > low) & (place < high)).all(axis=1).sum() for place in full])
    assert (inside == 1).all()
    filled_up, whole = (high - low).prod(axis=1).sum() / cell**3, 8 * volume.counts[0]
    if fine_range:
        assert 0.3 * whole < filled_up < whole - 10
        assert filled_up == pytest.approx(len(full), rel=0.02)  # some were full before, and nearly are
    else:
        assert filled_up == pytest.approx(whole)


def facing(volume: VolumeMap, far: float, times: int, *, yaw: float = 0.0, t: float = 0.0) -> None:
    """A wall across the view, so far away, is looked at so often."""
    T = pose(x=0.0, z=1.0, yaw=yaw)
    T[:3, :3] = T[:3, :3] @ LOOKS
    depth = np.full((90, 120), far, dtype=np.float32)
    for _ in range(times):
        volume.add(DepthImage("eye", t, T, depth, (104.0, 104.0), (59.5, 44.5), 0.1, 5.0), np.eye(4))


EXACT = replace(SMALL, noise=0.0, noise_growth=0.0, bias=1e-3)
BEHIND = np.array([[1.2375, 0.05 * k + 0.0125, 1.0125] for k in range(-3, 4)])  # in the voxels of a wall at 1.21 m


@each("fine_range, found", [(0.0, 1), (1.5, 1)])
def test_what_has_come_takes_all_of_its_voxels(fine_range, found):
    """Not only the half of them in which rays ended, though the other half was free before."""
    volume = VolumeMap(replace(EXACT, fine_range=fine_range))
    facing(volume, 2.0, 3)
    assert (volume.known(BEHIND) == 0).all()
    facing(volume, 1.21, 1)
    assert (volume.known(BEHIND) == found).all()


def test_what_has_come_back_before_its_voxels_were_free_again_takes_all_of_them():
    """Each look through it makes it less of an obstacle; finer voxels in which it did not end are free at once."""
    for looks in range(12):
        volume = VolumeMap(EXACT)
        for far, times in ((2.0, 3), (1.21, 4), (2.0, looks), (1.21, 2)):
            facing(volume, far, times)
        assert (volume.known(BEHIND) == 1).all(), f"after {looks} looks through it"


@each("yaw", [0.0, math.pi])
def test_of_what_has_come_and_may_have_gone_only_what_was_seen_through_is_free(yaw):
    side = np.array([math.cos(yaw), math.cos(yaw), 1.0])
    behind, before = BEHIND * side, (BEHIND - (0.025, 0.0, 0.0)) * side
    volume = VolumeMap(replace(EXACT, unseen="blocked", stood_time=3.0))
    facing(volume, 2.0, 3, yaw=yaw)
    facing(volume, 1.24, 6, yaw=yaw, t=1.0)
    assert (volume.known(behind) == 1).all()
    facing(volume, math.nan, 1, yaw=yaw, t=5.0)
    assert (volume.known(behind) == -1).all()
    assert (volume.known(before) == 0).all()


def test_near_by_half_of_a_voxel_is_free_where_the_rest_is_not():
    before = BEHIND - (0.025, 0.0, 0.0)
    for fine_range, free in ((0.0, False), (1.5, True)):
        volume = VolumeMap(replace(EXACT, fine_range=fine_range))
        facing(volume, 1.24, 3)
        assert (volume.known(BEHIND) == 1).all()
        assert ((volume.known(before) == 0) == free).all()
    occupied = boxes_volume(volume)
    volume.center(4.4, 0.0)  # it is out of the window of finer voxels, and as it was without those
    assert boxes_volume(volume) > 1.2 * occupied
    assert (volume.known(before) == 1).all()


def boxes_volume(volume: VolumeMap) -> float:
    return sum(8.0 * float(b.halfSide.prod()) for o in volume.obstacles() for p in o.parts for b, _ in p.boxes)


def holed(*lost: tuple[slice | int, ...], far: float = 2.0) -> np.ndarray:
    """Ranges all at one distance, but for lost pixels."""
    ranges = np.full((60, 70), far, dtype=np.float32)
    for at in lost:
        ranges[at] = np.nan
    return ranges


def test_a_lost_pixel_is_as_far_as_what_is_beside_it_and_no_further_than_it_hides_something():
    ranges = holed((30, 40))
    assert filled(ranges, 5.0)[30, 40] == 2.0
    np.testing.assert_array_equal(np.delete(filled(ranges, 5.0).ravel(), 30 * 70 + 40), np.float32(2.0))
    far = holed((30, 40), far=np.inf)  # from pixel to pixel beside it are two: what it hides begins at half of the unit
    assert filled(far, 5.0)[30, 40] == 2.5
    assert filled(ranges, 3.0)[30, 40] == 1.5
    assert np.isnan(filled(ranges, 0.0)[30, 40])


def test_the_kernel_and_its_twin_fill_the_same_holes(rng):
    for shape in ((60, 70), (40, 31), (1, 30), (3, 2)):
        ranges = rng.uniform(0.5, 6.0, shape).astype(np.float32)
        ranges[rng.random(shape) < 0.05] = np.inf
        ranges[rng.random(shape) < 0.1] = np.nan
        for _ in range(12):
            (i, j), (di, dj) = rng.integers(0, shape), rng.integers(1, 16, 2)
            ranges[i : i + di, j : j + dj] = np.nan
        for unit in (0.5, 5.0, 30.0):
            np.testing.assert_array_equal(filled(ranges, unit), _filled(ranges, unit))


@each("width", [8.0, 11.0, 15.0])
@each("turn", [0.0, 0.4, 0.25 * math.pi, 0.9])
def test_a_wide_hole_is_not_seen_through_at_its_corners_either(width, turn):
    """A board without an answer: runs across its corners are short, but it is there."""
    u, v = np.meshgrid(np.arange(80) - 39.3, np.arange(100) - 49.8, indexing="ij")
    across, along = math.cos(turn) * u + math.sin(turn) * v, math.cos(turn) * v - math.sin(turn) * u
    board = (np.abs(across) < 0.5 * width) & (np.abs(along) < 25.0)
    out = filled(np.where(board, np.nan, 2.0), 10.0)[board]
    assert out.max() <= 10.0 / (width - 1.0)
    assert out.min() > 0.5 * 10.0 / width


@each("thick", [0.05, 0.07, 0.09])
@each("away", [0.7, 1.2, 2.0])
def test_a_board_without_an_answer_is_not_called_free(thick, away):
    """A shelf at the very height of the camera: of its front nothing comes back, above and below one sees the wall."""
    params = VolumeMapParams(length=8.0, height=2.0)
    board, wall = Box((0.3, 0.5, thick), at=(away + 0.15, 0.05, 1.0)), Box((0.1, 6.0, 2.4), at=(3.6, 0.0, 1.2))
    volume, scene = VolumeMap(params), Scene([wall])
    for T in (pose(), pose(0.05, 0.1, 1.0, 0.1), pose(-0.1, -0.2, 1.0, -0.1)):
        image = depth_image(scene, T, 96, 128, 115.0)
        before = depth_image(Scene([board]), T, 96, 128, 115.0).depth < 3.0
        assert before.any()
        for _ in range(2):
            volume.add(replace(image, depth=np.where(before, np.nan, image.depth)), np.eye(4))
    assert (volume.known(PLACES * params.cell) == 0).sum() > 5000
    x, y, z = np.meshgrid(*[np.linspace(-0.49, 0.49, n) for n in (30, 40, 7)], indexing="ij")
    inside = np.column_stack([at.ravel() for at in (x, y, z)]) * (0.3, 0.5, thick) + board.pose[:3, 3]
    assert not (volume.known(inside) == 0).any()


@each("shift", [0.0, 0.02])
def test_who_stands_still_sees_through_pixels_that_are_lost_now_and_then(shift, rng):
    """Half of all pixels are lost in each image. From one place all of them answer, one after the other."""
    wall = Scene([Box((0.1, 9.0, 2.4), at=(4.0, 0.0, 1.2))])
    volume = VolumeMap(VolumeMapParams(length=10.0, height=2.0))
    for k in range(8):
        image = depth_image(wall, pose(shift * k), 96, 128, 115.0)
        lost = rng.random(image.depth.shape) < 0.5
        volume.add(replace(image, time=0.066 * k, depth=np.where(lost, np.nan, image.depth)), np.eye(4))
    y, z = (side.ravel() for side in np.meshgrid(np.arange(-0.475, 0.5, 0.05), np.arange(0.775, 1.2, 0.05)))
    free = volume.known(np.column_stack((np.full(len(y), 2.225), y, z))) == 0
    if shift:
        assert free.mean() < 0.3
    else:
        assert free.mean() > 0.95


def in_black(at: tuple[float, float], t: float, others: list[Box]) -> DepthImage:
    """An image of a wall and others, before which somebody stands at (x, y), of whom nothing comes back."""
    there = Scene([Cylinder(0.2, 1.7, at=(*at, 0.85))])
    wall = Box((0.1, 9.0, 2.4), at=(4.0, 0.0, 1.2))
    image = depth_image(Scene([wall, *others]), pose(), 96, 128, 115.0)
    before = depth_image(there, pose(), 96, 128, 115.0).depth < np.minimum(image.depth, 3.9)
    return replace(image, time=t, depth=np.where(before, np.nan, image.depth))


def within(at: tuple[float, float]) -> np.ndarray:
    """Points in somebody who stands at (x, y)."""
    x, y, z = np.meshgrid(np.linspace(-0.13, 0.13, 7), np.linspace(-0.13, 0.13, 7), np.linspace(0.7, 1.3, 13))
    return np.column_stack([x.ravel() + at[0], y.ravel() + at[1], z.ravel()])


def test_who_stands_behind_a_door_and_answers_nothing_is_not_seen_through_when_it_opens():
    door, volume = Box((0.05, 1.2, 2.0), at=(1.2, 0.0, 1.0)), VolumeMap(VolumeMapParams(length=10.0, height=2.0))
    for k in range(16):
        volume.add(in_black((2.0, 0.1), 0.066 * k, [door] if k < 4 else []), np.eye(4))
        assert not (volume.known(within((2.0, 0.1))) == 0).any()
    assert (volume.known(within((2.0, 0.75))) == 0).all()


def test_who_walks_into_what_was_seen_and_answers_nothing_frees_nothing_that_was_not_free():
    """What a pixel answered before that counts for a while: so nothing is free but what was, when it was last seen."""
    before, volume = (VolumeMap(VolumeMapParams(length=10.0, height=2.0)) for _ in range(2))
    for k in range(24):
        if k < 4:
            before.add(in_black((9.0, 0.0), 0.066 * k, []), np.eye(4))
        at = (2.0, max(1.5 - 0.066 * k, 0.0))
        volume.add(in_black(at, 0.066 * k, []), np.eye(4))
        free = volume.known(PLACES[::7] * 0.05) == 0
        assert not (free & (before.known(PLACES[::7] * 0.05) != 0)).any()
    behind = np.column_stack([np.full(9, 3.0), np.zeros(9), np.linspace(0.8, 1.2, 9)])
    assert (volume.known(behind) == 0).all()  # as it was before


def test_of_what_a_lost_pixel_answered_lately_the_nearest_counts():
    still, T = StillImages(0.5), np.eye(4)
    image = depth_image(Scene([]), pose(), 4, 6)

    def shown(t, depth, T=T):
        return still.filled(replace(image, time=t, depth=np.full((4, 6), depth, dtype=np.float32)), T)

    assert (shown(0.0, 3.0) == 3.0).all()
    assert (shown(0.1, 0.8) == np.float32(0.8)).all()
    assert (shown(0.2, 2.0) == 2.0).all()  # who answers is believed
    assert (shown(0.3, np.nan) == np.float32(0.8)).all()
    assert (shown(0.65, np.nan) == 2.0).all()  # the nearer one is too long ago
    T = np.array(T)
    T[0, 3] = 0.01
    assert np.isnan(shown(0.66, np.nan, T)).all()  # it has moved


@each("turned", [False, True])
def test_a_hole_is_seen_through_to_where_something_wider_fits_into_it(turned):
    """A stripe, five from pixel to pixel: what is nearer than a fifth of the unit would be seen beside it."""
    stripe = (slice(None), slice(30, 34))
    for far in (3.0, np.inf):
        out = filled(holed(stripe[::-1] if turned else stripe, far=far)[:60, :60], 5.0)
        hole = out[30:34, 10:50] if turned else out[10:50, 30:34]
        assert (hole <= 1.0).all()  # at the least
        assert (hole > 0.95).all()
    out = filled(holed(stripe[::-1] if turned else stripe, far=0.8)[:60, :60], 5.0)
    assert (out == np.float32(0.8)).all()  # no further than its border


def test_a_hole_between_near_and_far_is_as_near_as_its_nearer_border():
    ranges = holed((slice(None), slice(30, 32)))
    ranges[:, :30] = 0.7
    assert (filled(ranges, 20.0)[25:35, 30:32] == np.float32(0.7)).all()
    assert (filled(ranges[:, ::-1], 20.0)[25:35, 38:40] == np.float32(0.7)).all()


def test_what_is_too_wide_or_has_one_border_only_stays_lost():
    wide = holed((slice(10, 50), slice(10, 50)))
    assert np.isnan(filled(wide, 1e3)[30, 30])
    assert np.isnan(filled(holed((slice(None), slice(0, 3))), 1e3)[30, :3]).all()
    assert np.isnan(filled(holed((slice(None), slice(None))), 1e3)).all()


@each(
    "wrong, named",
    [
        ({"length": 500.0}, "length"),
        ({"cell": 0.0}, "cell"),
        ({"occupied": 2.0}, "occupied"),
        ({"hole": -0.01}, "hole"),
    ],
)
def test_wrong_parameters_are_refused(wrong, named):
    with refused(ParameterError, named):
        VolumeMapParams(**wrong)


WALL = Box((0.1, 6.0, 1.6), at=(2.6, 0.0, 0.8), name="wall")
STILL = Box((0.2, 0.3, 1.4), at=(1.2, 0.55, 0.7), name="post")
PARAMS = SceneEstimatorParams()


def view(image) -> ImageView:
    return ImageView(image, image.T_base_sensor)


@each("covered", [False, True])
def test_what_something_nearer_covers_goes_on_behind_it(covered):
    volume, post = VolumeMap(SMALL), [STILL] if covered else []
    for _ in range(8):
        volume.add(depth_image(Scene([WALL, *post]), VIEWS[0]), np.eye(4))
    image = depth_image(Scene([WALL, *post, Box((0.3, 0.6, 1.4), at=(2.0, 0.6, 0.7))]), VIEWS[0])
    seen = volume.seen_by(image, np.eye(4))
    (cluster,) = moving_clusters(seen.points, seen.fresh, seen.standing, view(image), PARAMS)
    assert cluster.hidden == covered
    assert len(cluster.solid) > len(cluster.points)


@each("wall", [0.0, 1.0, 4.0])
def test_what_has_come_is_seen_beside_what_is_not_known_to_stand(wall):
    """Such as a wall that nothing has looked at before: with it, it would be too large for anything that moves."""
    y, z = np.meshgrid(np.arange(-0.3, 0.3 + wall, 0.04), np.arange(0.2, 1.2, 0.04))
    points = np.column_stack((np.full(y.size, 2.0), y.ravel(), z.ravel()))
    come = points[:, 1] < 0.3
    image = depth_image(Scene([WALL]), VIEWS[0])
    nothing = np.zeros(len(points), dtype=bool)
    (cluster,) = moving_clusters(points, come, nothing, view(image), PARAMS)
    assert cluster.extent <= PARAMS.max_mover_size
    assert {*map(tuple, points[come])} <= {*map(tuple, cluster.solid)}
    assert not moving_clusters(points, nothing, nothing, view(image), PARAMS)


def test_the_traces_of_what_moves_leave_the_voxels_and_what_stands_stays():
    """A person sets off to one side; what was noted of it before it was known to move is not seen any more."""
    volume, tracker = VolumeMap(SMALL), Tracker(PARAMS)
    still = Scene([WALL, STILL])
    for _ in range(8):
        volume.add(depth_image(still, VIEWS[0]), np.eye(4))
    before, traced = np.zeros((0, 3)), np.zeros((0, 3))
    for k in range(12):
        person = Cylinder(0.2, 1.5, at=(1.6, -0.1 - 0.05 * k, 0.75))
        image = replace(depth_image(Scene([WALL, STILL, person]), VIEWS[0]), time=0.1 * k)
        seen = volume.seen_by(image, np.eye(4))
        tracker.update(view(image), moving_clusters(seen.points, seen.fresh, seen.standing, view(image), PARAMS), "eye")
        ignored = tracker.of_movers(seen.points[:, :2])
        volume.add(image, np.eye(4), seen, ignored)
        traces = tracker.traces()
        if len(traces) and not len(traced):
            before, traced = traces, traces[volume.known(traces) == 1]
        volume.forget(traces)
    assert len(traced) > 20
    assert not (volume.known(before) == 1).any()
    (mover,) = tracker.movers
    assert np.hypot(*(mover.velocity - (0.0, -0.5))) < 0.15
    stands = volume.seen_by(depth_image(still, VIEWS[0]), np.eye(4)).points
    on_post = stands[outside_scene(stands, Scene([STILL])) < 0.01]
    assert (volume.known(on_post) == 1).mean() > 0.9


@each("low, high, gone", [(0.0, 0.5, False), (1.4, 1.8, False), (0.0, 0.5, True), (1.4, 1.8, True)])
def test_what_comes_out_of_the_view_is_not_seen_through_below_or_above_it(low, high, gone):
    """A cart comes under a camera's view, and a load over it: the image sees past where either is, not through it. One
    that is taken away in plain view is not expected any longer."""
    volume, tracker, lost = VolumeMap(SMALL), Tracker(PARAMS), LostMovers(PARAMS)
    for _ in range(8):
        volume.add(depth_image(Scene([WALL]), VIEWS[0], columns=24), np.eye(4))
    seen_last = False
    for k in range(34):
        x = 2.2 - 0.06 * k
        there = x > 1.2 or not gone
        thing = [Box((0.3, 0.3, high - low), at=(x, 0.0, 0.5 * (low + high)))] if there else []
        image = replace(depth_image(Scene([WALL, *thing]), VIEWS[0], columns=24), time=0.1 * k)
        seen = volume.seen_by(image, np.eye(4))
        clusters = moving_clusters(seen.points, seen.fresh, seen.standing, view(image), PARAMS)
        tracker.update(view(image), clusters, "eye")
        lost.update(tracker.moving, tracker.lost, view(image), "eye", lambda places: np.zeros(len(places), dtype=bool))
        volume.add(image, np.eye(4), seen, tracker.of_movers(seen.points[:, :2]))
        seen_last = bool(clusters)
        if 1.25 < x < 1.5:
            assert tracker.movers
    assert not seen_last
    assert bool(tracker.movers) != gone
    assert bool(lost.obstacles()) != gone
