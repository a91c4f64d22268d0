"""Classes of base paths: the same for what can be deformed into one another, another one on another side."""

from __future__ import annotations

import numpy as np
from cases import refused
from hypothesis import given, settings
from hypothesis import strategies as st

from elastic_strips.errors import ParameterError
from elastic_strips.planning.homotopy.classes import ObstacleCluster, cluster_map, homotopy_class, separating_obstacles
from elastic_strips.scene import Box, Cylinder, Scene, Sphere, Voxels

AT = {"a": (1.0, 0.3), "b": (2.0, -0.4), "c": (2.0, 0.9), "d": (3.1, 0.1)}
POINTS = tuple(ObstacleCluster(name, (name,), np.array(at) + 1e-7 * k, 0.3) for k, (name, at) in enumerate(AT.items()))
ENDS = np.array([[-0.5, 0.0], [4.5, 0.0]])
CLEAR = 0.12
"""Radius [m] about each point that the paths of these tests keep out of."""


def over(names: str) -> np.ndarray:
    """A path that passes the points of these names on their left side (above), the others below them."""
    columns = sorted({at[0] for at in AT.values()})
    rows = []
    for x in columns:
        above = [y for name, (u, y) in AT.items() if u == x and name in names]
        below = [y for name, (u, y) in AT.items() if u == x and name not in names]
        low, high = max(above, default=-2.0), min(below, default=2.0)
        assert low < high
        rows.append((x, 0.5 * (low + high)))
    return np.vstack((ENDS[0], rows, ENDS[1]))


def wiggled(path: np.ndarray, rng: np.random.Generator, *, steps: int) -> np.ndarray:
    """A path that is shaken in small steps, each of which is taken back where it comes too near a point."""
    share = np.linspace(0.0, 1.0, 60)
    length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))))
    path = np.column_stack([np.interp(share * length[-1], length, path[:, k]) for k in range(2)])
    points = np.array([c.at for c in POINTS])
    for _ in range(steps):
        k = int(rng.integers(1, len(path) - 1))
        width = rng.uniform(1.0, 8.0)
        move = rng.normal(0.0, 0.04, 2) * np.exp(-0.5 * ((np.arange(60) - k) / width) ** 2)[:, None]
        move[[0, -1]] = 0.0
        new = path + move
        fine = np.vstack([new[:-1] + t * (new[1:] - new[:-1]) for t in np.linspace(0.0, 1.0, 8)])
        if np.linalg.norm(fine[:, None] - points, axis=2).min() > CLEAR and np.abs(move).max() < CLEAR:
            path = new
    return path


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**20), st.sampled_from(["", "a", "ab", "b", "bc", "abcd", "bd"]))
def test_a_deformation_keeps_the_class(seed: int, names: str) -> None:
    """A path that is shaken without passing over a point stays in its class; the other classes are others."""
    path = over(names)
    shaken = wiggled(path, np.random.default_rng(seed), steps=150)
    word = homotopy_class(path, POINTS)
    assert homotopy_class(shaken, POINTS) == word
    assert {name for name, _ in word} == set(names)
    for other in ("", "a", "ab", "b", "bc", "abcd", "bd"):
        assert (homotopy_class(over(other), POINTS) == word) == (other == names)


def test_the_shaken_paths_were_really_shaken() -> None:
    path = over("ab")
    shaken = wiggled(path, np.random.default_rng(0), steps=150)
    assert np.abs(shaken[:, 1] - np.interp(shaken[:, 0], path[:, 0], path[:, 1])).max() > 0.1


def test_there_and_back_cancels_and_loops_count() -> None:
    """A detour above a point and back is no class of its own; a loop around it is, each turn of it."""
    point = POINTS[:1]
    below = np.array([[0.0, 0.0], [2.0, 0.0]])
    assert homotopy_class(below, point) == ()
    assert homotopy_class([[0, 0], [0.5, 1], [2, 1], [0.5, 1], [0.5, 0], [2, 0]], point) == ()
    loop = [[0, 0], [2, 0], [2, 1], [0.5, 1], [0.5, 0]]
    assert homotopy_class([*loop, [2, 0]], point) == (("a", 1),)
    assert homotopy_class([*loop, *loop[1:], [2, 0]], point) == (("a", 1), ("a", 1))
    assert homotopy_class([[2, 1], [0, 1]], point) == (("a", 1),)
    assert homotopy_class([[0, 1], [2, 1]], point) == (("a", -1),)


def test_the_order_of_crossings_counts() -> None:
    """A loop around two points one after the other is not the one the other way about, though the counts are equal."""
    a, b = POINTS[0], POINTS[3]
    x, y = ("a", -1), ("d", -1)
    one = [[0, 0], [0, 2], [1.5, 2], [1.5, -1], [0.5, -1], [0.5, -2], [4, -2]]
    assert homotopy_class(one, (a, b)) == (x,)
    both = [[0, 2], [4, 2]]
    assert homotopy_class(both, (a, b)) == (x, y)
    assert homotopy_class(both[::-1], (a, b)) == (("d", 1), ("a", 1))


def test_points_on_one_line_are_told_apart() -> None:
    """b and c stand on one line along y: above both, between them, and below both."""
    words = [homotopy_class([[1.5, y], [2.5, y]], POINTS) for y in (2.0, 0.3, -1.0)]
    assert [{name for name, _ in word} for word in words] == [{"b", "c"}, {"b"}, set()]


def test_sides_are_told_as_seen_along_the_way() -> None:
    above, below = over("a"), over("")
    assert separating_obstacles(above, below, POINTS) == {"a": "left"}
    assert separating_obstacles(below, above, POINTS) == {"a": "right"}
    assert separating_obstacles(above[::-1], below[::-1], POINTS) == {"a": "right"}
    assert separating_obstacles(above, above, POINTS) == {}
    assert set(separating_obstacles(over("abcd"), below, POINTS)) == set("abcd")


def test_what_the_base_cannot_pass_between_is_one(silvermate) -> None:
    """Two boxes with a gap a little narrower, and a little wider, than the base."""
    base = 2 * 0.27
    for gap, names in ((base - 0.08, {"one+two"}), (base + 0.12, {"one", "two"})):
        boxes = [Box((0.4, 0.4, 1.0), at=(2.0, s * (0.2 + gap / 2), 0.5), name=n) for s, n in ((1, "one"), (-1, "two"))]
        clusters = cluster_map(silvermate, Scene(boxes), [[0.0, 0.0], [4.0, 0.0]]).clusters
        assert {c.name for c in clusters} == names, gap
    assert clusters[0].obstacles in (("one",), ("two",))
    assert all(c.area > 0.16 for c in clusters)
    for c in clusters:  # the point is inside the obstacle
        assert np.abs(c.at - Scene(boxes).obstacle(c.name).pose[:2, 3]).max() <= 0.2


def test_what_is_above_or_under_the_robot_does_not_count(silvermate) -> None:
    ends = [[0.0, 0.0], [4.0, 0.0]]
    things = [
        (Box((0.4, 0.4, 0.2), at=(2.0, 0.0, 1.7), name="lamp"), 0),
        (Box((0.4, 0.4, 0.01), at=(2.0, 0.0, 0.005), name="mat"), 0),
        (Box((0.4, 0.4, 0.2), at=(2.0, 0.0, 1.3), name="low lamp"), 1),
        (Sphere(0.1, at=(2.0, 0.0, 0.1), name="ball"), 1),
        (Cylinder(0.1, 1.0, at=(12.0, 0.0, 0.5), name="far away"), 0),
    ]
    for thing, count in things:
        assert len(cluster_map(silvermate, Scene([thing]), ends).clusters) == count, thing.name


def test_pieces_of_one_obstacle_that_are_apart_have_names_of_their_own(silvermate) -> None:
    cells = np.array([[1.0, 0.0, 0.5], [3.0, 0.0, 0.5]])
    found = cluster_map(silvermate, Scene([Voxels(cells, 0.1, name="cloud")]), [[0.0, 0.0], [4.0, 0.0]])
    assert [c.name for c in found.clusters] == ["cloud", "cloud#2"]


def test_wrong_input_is_named(silvermate, gantry) -> None:
    with refused(ParameterError, "(K, 2)", "(1, 2)"):
        homotopy_class([[0.0, 0.0]], POINTS)
    with refused(ParameterError, "finite"):
        homotopy_class([[0.0, 0.0], [np.nan, 0.0]], POINTS)
    with refused(ParameterError, "fixed"):
        cluster_map(gantry, Scene([]), [[0.0, 0.0]])
