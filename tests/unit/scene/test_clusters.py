"""Clusters: merging keeps the union of the boxes exactly, drops duplicates, and is fast."""

import pickle

import numpy as np
import pytest
from cases import each
from hypothesis import given, settings
from hypothesis import strategies as st

from elastic_strips.native import twin
from elastic_strips.scene import Points, Voxels
from elastic_strips.scene.parts import BLOCK_EDGE, grid_solid, merge_cells, merged_boxes

cells_lists = st.lists(st.tuples(*[st.integers(-6, 6)] * 3), min_size=1, max_size=120)


def fill(low, high):
    """Unit cells of integer boxes, one entry per cell and box."""
    cells = []
    for a, b in zip(low, high, strict=True):
        cells += [(x, y, z) for x in range(a[0], b[0]) for y in range(a[1], b[1]) for z in range(a[2], b[2])]
    return cells


@settings(max_examples=100, deadline=None)
@given(cells_lists, st.integers(1, 5))
def test_merged_cells_tile_the_same_cells_once(cells, span):
    unique = sorted(set(cells))
    low, high = merge_cells(np.array(unique), np.full(3, span))
    assert sorted(fill(low.tolist(), high.tolist())) == unique
    assert (low // span == (high - 1) // span).all()


@settings(max_examples=40, deadline=None)
@given(cells_lists, st.floats(0.02, 0.7), st.floats(-50, 50))
def test_union_of_voxels_is_unchanged(cells, size, shift):
    centers = np.array(cells) * size + shift
    low, high, _ = merged_boxes(centers, np.full(3, size))
    origin = centers[0] - 0.5 * size
    low, high = (low - origin) / size, (high - origin) / size
    np.testing.assert_allclose(low, np.rint(low), atol=1e-6)
    np.testing.assert_allclose(high, np.rint(high), atol=1e-6)
    found = fill(np.rint(low).astype(int).tolist(), np.rint(high).astype(int).tolist())
    wanted = {tuple(c) for c in np.rint((centers - centers[0]) / size).astype(int).tolist()}
    assert sorted(found) == sorted(wanted)


def boxes_of(obstacle):
    shifts = np.array([shift for part in obstacle.parts for _, shift in part.boxes])
    halves = np.array([box.halfSide for part in obstacle.parts for box, _ in part.boxes])
    return shifts - halves, shifts + halves


def test_a_full_block_is_one_box_and_blocks_are_cells_of_space():
    cells = np.stack(np.meshgrid(*[np.arange(18)] * 3), -1).reshape(-1, 3)
    voxels = Voxels(cells * 0.05 + 0.025, 0.05)
    assert len(voxels.parts) == 8
    assert [len(part.boxes) for part in voxels.parts] == [1] * 8
    for part in voxels.parts:
        assert part.geometry is None
        np.testing.assert_allclose(part.half_extents, BLOCK_EDGE / 2)
    low, high = boxes_of(voxels)
    assert np.prod(high - low, axis=1).sum() == pytest.approx(0.9**3)


def test_duplicates_and_small_noise_snap_to_the_grid_and_stay_covered():
    rng = np.random.default_rng(0)
    cells = np.unique(rng.integers(0, 12, (300, 3)), axis=0)
    centers = np.repeat(cells * 0.1 + 3.07, 2, axis=0) + rng.uniform(-4e-5, 4e-5, (2 * len(cells), 3))
    low, high, _ = merged_boxes(centers, np.full(3, 0.1))
    assert len(low) < len(cells)
    for c in centers:
        for corner in (c - 0.05, c + 0.05, c):
            assert ((corner >= low - 1e-12) & (corner <= high + 1e-12)).all(axis=1).any()
    assert np.prod(high - low, axis=1).sum() < len(cells) * 0.1**3 * 1.01


def test_centres_off_the_grid_stay_as_they_are():
    rng = np.random.default_rng(1)
    centers = rng.uniform(0, 2, (200, 3))
    low, high, _ = merged_boxes(np.vstack([centers, centers[:50]]), np.full(3, 0.1))
    assert len(low) == 200
    np.testing.assert_allclose((low + high) / 2, centers)
    np.testing.assert_allclose(high - low, 0.1)


def test_points_are_boxes_of_their_diameter():
    points = np.array([[0, 0, 0], [0.013, 0.5, 0.2], [1.7, 0.2, 0.3]])
    low, high = boxes_of(Points(points, 0.02))
    np.testing.assert_allclose(high - low, 0.04)
    for p in points:
        assert ((p - 0.02 >= low - 1e-12) & (p + 0.02 <= high + 1e-12)).all(axis=1).any()


def test_voxels_larger_than_a_block_and_of_three_edges():
    big = Voxels([[0, 0, 0], [2, 0, 0], [4, 0, 0]], 2.0)
    assert sum(len(part.boxes) for part in big.parts) == 3
    slabs = Voxels([[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0], [0.1, 0.2, 0]], (0.1, 0.2, 0.3))
    low, high = boxes_of(slabs)
    assert np.prod(high - low, axis=1).sum() == pytest.approx(4 * 0.1 * 0.2 * 0.3)


@each("kind", ["grid", "sparse", "loose"])
def test_sixty_thousand_voxels_share_their_boxes(kind):
    rng = np.random.default_rng(2)
    centers = {
        "grid": lambda: np.stack(np.meshgrid(*[np.arange(39)] * 3), -1).reshape(-1, 3) * 0.05,
        "sparse": lambda: rng.integers(0, 200, (60_000, 3)) * 0.05,
        "loose": lambda: rng.uniform(0, 10, (60_000, 3)),
    }[kind]()
    voxels = Voxels(centers, 0.05)
    assert sum(len(part.boxes) for part in voxels.parts) <= len(np.unique(centers, axis=0))
    assert len({id(box) for part in voxels.parts for box, _ in part.boxes}) < 2000  # equal boxes are shared


SHIFTED = np.eye(4)
SHIFTED[:3, 3] = 0.5, 0.1, 0.0


def grid(rng, count=12):
    low = rng.integers(-9, 9, (count, 3))
    return low, low + rng.integers(1, 4, (count, 3))


def test_boxes_of_a_grid_are_as_of_their_cells():
    """Middles, edges and the ball about all, from the definition; the kernel and its twin."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        low, high = grid(rng)
        solid, cells = grid_solid(low, high, 0.025)
        with twin():
            other, others = grid_solid(low, high, 0.025)
        np.testing.assert_allclose(cells, (np.array(fill(low.tolist(), high.tolist())) + 0.5) * 0.025, atol=1e-12)
        np.testing.assert_allclose(others, cells, atol=1e-12)
        np.testing.assert_allclose(other.rows, solid.rows, atol=1e-12)
        (part,), (same,) = solid.parts, other.parts
        np.testing.assert_allclose(same.sizes, part.sizes, atol=1e-12)
        np.testing.assert_allclose(part.middles - 0.5 * part.sizes, 0.025 * low, atol=1e-11)
        np.testing.assert_allclose(part.middles + 0.5 * part.sizes, 0.025 * high, atol=1e-11)
        far = np.linalg.norm(np.abs(part.middles - part.center) + 0.5 * part.sizes, axis=1).max()
        assert part.radius >= far - 1e-12
        np.testing.assert_allclose(2.0 * np.array([box.halfSide for box, _ in part.boxes]), part.sizes)


def test_boxes_of_a_grid_are_the_same_in_another_process():
    low, high = grid(np.random.default_rng(4))
    voxels = Voxels.of_boxes(low, high, 0.05, "seen")
    for one in (voxels, voxels.named("other"), voxels.moved(SHIFTED)):
        copy = pickle.loads(pickle.dumps(one))
        assert copy.name == one.name
        np.testing.assert_array_equal(copy.pose, one.pose)
        np.testing.assert_array_equal(copy.spec["centers"], one.spec["centers"])
        np.testing.assert_array_equal(copy.parts[0].middles, one.parts[0].middles)
        np.testing.assert_array_equal(copy.parts[0].sizes, one.parts[0].sizes)
    assert len(pickle.dumps(voxels)) < len(pickle.dumps(voxels.named("other")))
