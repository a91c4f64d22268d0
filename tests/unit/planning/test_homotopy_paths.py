"""Ways over a grid: each of another class, the cheapest first, free of obstacles."""

from __future__ import annotations

import numpy as np

from elastic_strips.planning import grid_path
from elastic_strips.planning.homotopy.classes import _heights, _summed, cluster_map, homotopy_class, homotopy_paths
from elastic_strips.scene import Box, Cylinder, Scene

PILLARS = Scene([Cylinder(0.2, 1.4, at=(x, y, 0.7)) for x, y in ((1.5, 0.1), (3.0, -0.9), (3.0, 0.8), (4.5, 0.0))])


def test_each_way_is_of_another_class_and_the_grid_s_is_the_cheapest(silvermate) -> None:
    start, goal = silvermate.home(), silvermate.home(x=6.0)
    ways = homotopy_paths(silvermate, PILLARS, start, goal, count=8)
    assert len(ways) >= 5
    assert len({w.homotopy_class for w in ways}) == len(ways)
    assert [w.cost for w in ways] == sorted(w.cost for w in ways)
    clusters = cluster_map(silvermate, PILLARS, [[0.0, 0.0], [6.0, 0.0]]).clusters
    assert len(clusters) == 4
    best = grid_path(silvermate, PILLARS, start, goal).points
    assert best is not None
    cheap = [w.homotopy_class for w in ways if w.cost <= (1.0 + 1e-9) * ways[0].cost]
    assert homotopy_class(best, clusters) in cheap
    assert len(cheap) < len(ways)
    centres = np.array([o.pose[:2, 3] for o in PILLARS])
    for way in ways:
        np.testing.assert_allclose(way.points[[0, -1]], [[0, 0], [6, 0]], atol=1e-12)
        assert np.linalg.norm(np.diff(way.points, axis=0), axis=1).max() < 0.15
        assert homotopy_class(way.points, clusters) == way.homotopy_class
        assert np.linalg.norm(way.points[:, None] - centres, axis=2).min() > 0.2


def test_all_sides_of_two_pillars_are_found(silvermate) -> None:
    """One after the other, on the line: left or right of each."""
    scene = Scene([Cylinder(0.2, 1.4, at=(x, 0.0, 0.7)) for x in (2.0, 4.0)])
    ways = homotopy_paths(silvermate, scene, silvermate.home(), silvermate.home(x=6.0), count=4)
    sides = {tuple(sorted(name for name, _ in w.homotopy_class)) for w in ways}
    assert sides == {(), ("cylinder-0",), ("cylinder-1",), ("cylinder-0", "cylinder-1")}


def test_crossings_along_a_tree_equal_those_of_its_paths(silvermate, rng) -> None:
    """Random paths over a grid, knight's moves too, against the words of the same paths."""
    scene = Scene([Cylinder(0.1, 1.4, at=(*at, 0.7)) for at in ((0.0, 0.2), (1.3, -0.7), (1.3, 0.8), (2.6, 0.1))])
    ends = np.array([[0.0, 0.0], [2.6, 0.0]])
    field = cluster_map(silvermate, scene, ends, box=(ends[0] - 1.0, ends[1] + 1.0))
    heights, shape = _heights(field), field.labels.shape
    at = [np.rint((c.at - field.low) / 0.05).astype(int) for c in field.clusters]
    numbers = {c.name: int(heights[i, j + 1] - heights[i, j]) for c, (i, j) in zip(field.clusters, at, strict=True)}
    moves = [(a * i, b * j) for i, j in ((0, 1), (1, 0), (1, 1), (1, 2), (2, 1)) for a in (-1, 1) for b in (-1, 1)]
    jumps = ((-1, 0), (1, 1)), ((1, 1), (-1, 0)), ((-1, 0), (1, -1)), ((1, -1), (-1, 0))
    for foot in at:  # knight's moves just above and below a ray's foot
        for jump in jumps:
            cells = [foot + np.array(offset) for offset in jump]
            one, two = (int(np.ravel_multi_index(tuple(cell), shape)) for cell in cells)
            before = np.full(shape[0] * shape[1], -9999)
            before[two] = one
            word = homotopy_class(field.low + 0.05 * np.array(cells), field.clusters)
            assert _summed(before, heights)[two] == sum(sense * numbers[name] for name, sense in word)
    crossed = 0
    for _ in range(80):
        drift = rng.normal(size=2)  # paths that get somewhere
        path = [np.array([rng.integers(0, n) for n in shape])]
        for _ in range(80):
            new = path[-1] + max((moves[int(k)] for k in rng.integers(len(moves), size=2)), key=drift.dot)
            fits = (new >= 0).all() and (new < shape).all()
            if fits and not any((new == p).all() for p in [*path, *at]):
                path.append(new)
        index = np.array([int(np.ravel_multi_index(tuple(p), shape)) for p in path])
        before = np.full(shape[0] * shape[1], -9999)
        before[index[1:]] = index[:-1]
        if len(path) < 2:
            continue
        word = homotopy_class(field.low + 0.05 * np.array(path), field.clusters)
        assert _summed(before, heights)[index[-1]] == sum(sense * numbers[name] for name, sense in word)
        crossed += bool(word)
    assert len(numbers) == 4
    assert crossed > 15


def test_no_way_and_no_obstacle(silvermate) -> None:
    start, goal = silvermate.home(), silvermate.home(x=4.0)
    only = homotopy_paths(silvermate, Scene([]), start, goal, count=3)
    assert [w.homotopy_class for w in only] == [()]
    walls = [Box((0.2, 12.0, 1.4), at=(2.0, 0.0, 0.7), name="across")]
    assert homotopy_paths(silvermate, Scene(walls), start, goal, count=3) == ()
