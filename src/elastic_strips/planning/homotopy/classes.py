"""Homotopy classes: on which sides of the obstacles a path of the base goes, and paths over a grid of each class.

A ray goes from a point of each obstacle upwards (towards +y) to infinity. The rays that a path crosses, in order and
with the sense of the crossing, form a word; a crossing and the next one back cancel. Two paths with the same ends have
the same reduced word if and only if one can be deformed into the other without passing over one of those points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Indices
from elastic_strips.errors import ParameterError
from elastic_strips.planning.grid_path import (
    COMFORTABLE_CLEARANCE,
    DRIVEN_OVER_HEIGHT,
    MOST_CELLS,
    box_about,
    cell_cost,
    cell_graph,
    clearance_map,
    grid_frame,
    owner_map,
    smooth_path,
)
from elastic_strips.robot import PlanarFootprint, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.summary import Summary
from elastic_strips.work import count_work

HomotopyClass = tuple[tuple[str, int], ...]
"""The crossings of a path: which cluster's ray, and +1 towards −x (the cluster on the left), −1 towards +x."""

_EIGHT = np.ones((3, 3), dtype=int)


@dataclass(frozen=True, slots=True, eq=False)
class ObstacleCluster:
    """Obstacles that the base cannot pass between.

    Attributes:
        name: name of the cluster, after its obstacles; unique among the clusters of a map.
        obstacles: names of the obstacles.
        at: (2,) a point [m] well inside it.
        area: area that the base's centre cannot enter [m²].
    """

    name: str
    obstacles: tuple[str, ...]
    at: Array
    area: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ClusterMap(Summary):
    """The clusters of a scene on a grid.

    Attributes:
        clusters: the clusters.
        labels: (rows, columns) 1 + index of the cluster that closes a cell to the base's centre, 0 where open.
        clear: (rows, columns) distance to the nearest obstacle, seen from above [m].
        low: (2,) middle of the first cell [m]; resolution: edge of a cell [m].
        inner: radius of the disc that the base at least needs [m].
    """

    clusters: tuple[ObstacleCluster, ...]
    labels: Indices
    clear: Array
    low: Array
    resolution: float
    inner: float


def cluster_map(
    robot: RobotModel,
    scene: Scene,
    points: npt.ArrayLike,
    *,
    box: tuple[Array, Array] | None = None,
    over: Callable[[], bool] = lambda: False,
) -> ClusterMap:
    """The clusters of a scene about ``points``, on a grid.

    Obstacles above the robot in its home posture, or on the floor below 2 cm, do not count: the robot passes under or
    over it.

    Args:
        robot: the robot; its base must move.
        scene: the obstacles, as they stand.
        points: (K, 2) positions of the base that the grid has to hold [m].
        box: low and high corner (2,) of the grid [m]; it holds the points, and reaches 3 m beyond them where None.
        over: a function that says whether the time is over; then there are no clusters.

    Raises:
        ParameterError: a fixed base, or points of another shape or not finite.
    """
    from scipy.ndimage import distance_transform_edt, label, maximum_position  # late: slow to import

    xy = _points(points, least=1)
    if not robot.space.planar:
        raise ParameterError(f"the base of {robot.name!r} is fixed; diff_drive or omni is needed for classes of paths")
    low, shape, resolution = grid_frame(*(box_about(xy) if box is None else box), MOST_CELLS)
    footprint = PlanarFootprint.of(robot, robot.home_q)
    inner, height = footprint.inner, footprint.height
    owner = owner_map(scene, low, shape, resolution, height, over=over)
    taken = owner >= 0
    labels = np.zeros(taken.shape, dtype=np.intp)
    if over() or not taken.any():
        return ClusterMap((), labels, np.full(taken.shape, np.inf), low, resolution, inner)
    clear = clearance_map(taken, resolution)
    closed = clear < inner
    count = int(np.asarray(label(closed, structure=_EIGHT, output=labels)))
    depth = np.asarray(distance_transform_edt(closed)) * taken  # the middle of an obstacle, not of a gap that is closed
    middles = maximum_position(depth, labels, np.arange(1, count + 1))
    areas = np.bincount(labels.ravel(), minlength=count + 1)[1:] * resolution**2
    found: list[ObstacleCluster] = []
    used: dict[str, int] = {}
    for k, cell in enumerate(middles, start=1):
        if over():
            found.clear()
            break
        whose = np.unique(owner[(labels == k) & taken])
        names = tuple(scene.names[int(i)] for i in whose)
        name = "+".join(names) if len(names) < 3 else f"{names[0]} and {len(names) - 1} more"
        used[name] = used.get(name, 0) + 1
        if used[name] > 1:  # pieces of one obstacle, far apart
            name = f"{name}#{used[name]}"
        shift = 1e-7 * k  # no two rays lie on each other
        at = low + resolution * np.asarray(cell, dtype=float) + np.array([shift, 0.0])
        found.append(ObstacleCluster(name, names, at, float(areas[k - 1])))
    return ClusterMap(tuple(found), labels, clear, low, resolution, inner)


def single_obstacles(robot: RobotModel, scene: Scene) -> tuple[ObstacleCluster, ...]:
    """Each obstacle that counts as a cluster of its own, at its middle: to say where it is, not for classes."""
    table, height = scene.table, PlanarFootprint.of(robot, robot.home_q).height
    found = []
    for k, name in enumerate(scene.names):
        rows = slice(int(table.offsets[k]), int(table.offsets[k + 1]))
        low, high = table.center[rows] - table.half_extents[rows], table.center[rows] + table.half_extents[rows]
        if len(low) and low[:, 2].min() < height and high[:, 2].max() > DRIVEN_OVER_HEIGHT:
            corner, other = low.min(axis=0)[:2], high.max(axis=0)[:2]
            found.append(ObstacleCluster(name, (name,), 0.5 * (corner + other), float(np.prod(other - corner))))
    return tuple(found)


def homotopy_class(path_xy: npt.ArrayLike, clusters: Sequence[ObstacleCluster]) -> HomotopyClass:
    """The class of a path (K, 2) of the base [m]: the reduced word of its crossings.

    Compare it only with classes of paths that have the same ends, among the same clusters.

    Raises:
        ParameterError: a path of another shape, not finite, or of fewer than two points.
    """
    path = _points(path_xy, least=2)
    if not clusters:
        return ()
    at = np.array([c.at for c in clusters])
    beyond = path[:, :1] >= at[:, 0]  # (K, C)
    step, which = np.nonzero(beyond[:-1] != beyond[1:])
    a, b = path[step], path[step + 1]
    share = (at[which, 0] - a[:, 0]) / (b[:, 0] - a[:, 0])
    above = a[:, 1] + share * (b[:, 1] - a[:, 1]) > at[which, 1]
    step, which, share = step[above], which[above], share[above]
    word: list[tuple[str, int]] = []
    for k in np.lexsort((share, step)).tolist():
        cluster = int(which[k])
        name, sense = clusters[cluster].name, -1 if beyond[step[k] + 1, cluster] else 1
        if word and word[-1] == (name, -sense):
            word.pop()
        else:
            word.append((name, sense))
    return tuple(word)


def separating_obstacles(
    one: npt.ArrayLike, other: npt.ArrayLike, clusters: Sequence[ObstacleCluster]
) -> dict[str, str]:
    """Clusters between two paths (K, 2) [m] with the same ends, the largest first, and on which side ``one`` passes.

    Returns:
        cluster → ``"left"`` or ``"right"``, seen along the path; the other path passes on the other side. A cluster
        that the paths together surround more than once, or in both senses, counts by its total.
    """
    a, b = _points(one, least=2), _points(other, least=2)
    loop = np.vstack((a, b[::-1], a[:1]))
    sides = {}
    for cluster in sorted(clusters, key=lambda c: -c.area):
        offset = loop - cluster.at
        angle = np.arctan2(offset[:, 1], offset[:, 0])
        turns = np.rint(np.sum(np.remainder(np.diff(angle) + np.pi, 2 * np.pi) - np.pi) / (2 * np.pi))
        if turns:
            sides[cluster.name] = "right" if turns > 0 else "left"
    return sides


def _points(values: npt.ArrayLike, *, least: int) -> Array:
    points = np.asarray(values, dtype=float)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < least or not np.isfinite(points).all():
        raise ParameterError(f"a path of the base is (K, 2) with K ≥ {least}, finite; got shape {points.shape}")
    return points


@dataclass(frozen=True, slots=True, eq=False)
class HomotopyPath:
    """A path of the base from start to goal, of one class.

    Attributes:
        points: (K, 2) waypoints [m].
        cost: its cost on the grid, in metres of open floor.
        homotopy_class: its class among the clusters of the map.
    """

    points: Array
    cost: float
    homotopy_class: HomotopyClass


def homotopy_paths(
    robot: RobotModel, scene: Scene, start: Array, goal: Array, *, count: int, clusters: ClusterMap | None = None
) -> tuple[HomotopyPath, ...]:
    """At most ``count`` paths of different classes, the cheapest of each class found, cheapest first.

    One search from the start and one from the goal give the cheapest path to any cell and on from any cell; with the
    crossings summed up along both trees, their classes are known. So every path is found that is a cheapest one to some
    cell and a cheapest one on from there or from one of its neighbours.

    Args:
        robot: the robot; its base must move.
        scene: the obstacles, standing still.
        start, goal: configurations (nq,).
        count: largest number of paths.
        clusters: clusters of the scene, about start and goal; found where None.
    """
    from scipy.sparse.csgraph import dijkstra  # late: slow to import

    endpoints = robot.space.to_coordinates(np.stack((start, goal)))[:, :2]
    clusters = cluster_map(robot, scene, endpoints) if clusters is None else clusters
    resolution = clusters.resolution
    shape = np.array(clusters.clear.shape)
    cells = np.clip(np.rint((endpoints - clusters.low) / resolution).astype(int), 0, shape - 1)
    cost = cell_cost(clusters.clear, clusters.inner, COMFORTABLE_CLEARANCE, cells, resolution)
    graph = cell_graph(cost)
    count_work(batches=1, moves=graph.nnz)
    first, last = (int(np.ravel_multi_index(tuple(end), cost.shape)) for end in cells)
    come, before = dijkstra(graph, indices=[first, last], return_predecessors=True)
    if not np.isfinite(come[0, last]):
        return ()
    heights = _heights(clusters)
    sums = [_summed(tree, heights) for tree in before]
    edges = graph.tocoo()
    one, two, own = (np.asarray(k, dtype=np.intp) for k in (*edges.coords, np.arange(cost.size)))
    there, onward = np.concatenate((one, own)), np.concatenate((two, own))
    step = np.concatenate((edges.data, np.zeros(cost.size)))
    reached = sums[0][there] + _crossings(there, onward, heights)
    use = np.isfinite(come[0, there] + come[1, onward]) & ((reached != sums[0][onward]) | (step == 0.0))
    there, onward, step, reached = there[use], onward[use], step[use], reached[use]
    total = come[0, there] + step + come[1, onward]
    order = np.argsort(total, kind="stable")
    _, best = np.unique((reached - sums[1][onward])[order], return_index=True)
    found: list[HomotopyPath] = []
    for k in order[np.sort(best)[:count]].tolist():
        route = _joined(int(there[k]), int(onward[k]), before[0], before[1])
        points = clusters.low + resolution * np.column_stack(np.unravel_index(route, cost.shape)).astype(float)
        points[0], points[-1] = endpoints
        word = homotopy_class(points, clusters.clusters)
        found.append(HomotopyPath(smooth_path(points, resolution), float(total[k]) * resolution, word))
    return tuple(found)


def _heights(clusters: ClusterMap) -> Indices:
    """Sums (rows, columns + 1) of random numbers, one for each cluster, over those below a point of a grid line."""
    rows, columns = clusters.labels.shape
    heights = np.zeros((rows, columns + 1), dtype=np.int64)
    draws = np.random.default_rng(0).integers(1, 2**48, len(clusters.clusters))
    for cluster, draw in zip(clusters.clusters, draws, strict=True):
        i, j = np.rint((cluster.at - clusters.low) / clusters.resolution).astype(int)
        heights[i, j + 1 :] += draw
    return heights


def _crossings(a: Indices, b: Indices, heights: Indices) -> Indices:
    """(K,) signed sums of the numbers of the rays that moves from cells ``a`` (K,) to cells ``b`` (K,) cross."""
    columns = heights.shape[1] - 1
    i, j = np.divmod(a, columns)
    u, w = np.divmod(b, columns)
    back = u < i
    left, right = np.where(back, u, i), np.where(back, i, u)
    y, y_right = np.where(back, w, j), np.where(back, j, w)
    value = np.where(right > left, heights[left, y], 0)  # the ray stands just beyond the left cell's middle
    middle = np.minimum(left + 1, len(heights) - 1)
    value += np.where(right > left + 1, heights[middle, -((y + y_right) // -2)], 0)
    return np.where(back, value, -value)


def _summed(before: Indices, heights: Indices) -> Indices:
    """(cells,) for each cell the signed sum of the numbers of the rays that the tree's path to it crosses.

    Equal sums mean equal numbers of crossings of each ray, except by a negligible chance.
    """
    cell = np.arange(len(before))
    before = np.where(before < 0, cell, before)
    value = _crossings(before, cell, heights)
    while (before != before[before]).any():
        value = value + value[before]
        before = before[before]
    return value


def _joined(there: int, onward: int, from_start: Indices, from_goal: Indices) -> list[int]:
    """Cells of the cheapest path to one cell and on from another; what it would go there and back is left out."""
    back = [there]
    while from_start[back[-1]] >= 0:
        back.append(int(from_start[back[-1]]))
    route: list[int] = back[::-1]
    ahead = [onward] if onward != there else []
    while from_goal[onward] >= 0:
        onward = int(from_goal[onward])
        ahead.append(onward)
    for cell in ahead:
        if len(route) > 1 and route[-2] == cell:
            route.pop()
        else:
            route.append(cell)
    return route
