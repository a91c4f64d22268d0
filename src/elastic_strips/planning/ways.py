"""Ways over a grid that differ in class: of every class that two cheapest ways, joined, can have, the cheapest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..robot import RobotModel
from ..robot.space import Array, Indices
from ..scene import Scene
from .grid_path import cell_cost, cell_graph, smooth_way
from .homotopy import BaseClass, ComponentMap, base_class, component_map


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """A way of the base from start to goal.

    Attributes:
        points: (K, 2) waypoints [m]; cost: the grid's, in metres of open floor.
        base_class: its class among the components of the map.
    """

    points: Array
    cost: float
    base_class: BaseClass


def distinct_ways(
    robot: RobotModel,
    scene: Scene,
    start: Array,
    goal: Array,
    *,
    count: int,
    field: ComponentMap | None = None,
    comfort: float = 0.35,
) -> tuple[Way, ...]:
    """At most ``count`` ways of different classes, the cheapest of each class found, cheapest first.

    One search from the start and one from the goal give the cheapest way to any cell and on from any cell; with the
    crossings summed up along both trees, it is known which ways those are. So every way is found that is a cheapest way
    to some cell and a cheapest way on from there or from one of its neighbours.

    Args:
        robot: the robot; its base must move.
        scene: the obstacles, standing still.
        start, goal: configurations (nq,).
        count: so many at most.
        field: the components of the scene, about start and goal; found where None.
        comfort: as in :func:`grid_path`.
    """
    from scipy.sparse.csgraph import dijkstra  # late: slow to import

    ends = robot.space.to_chart(np.stack((start, goal)))[:, :2]
    field = component_map(robot, scene, ends) if field is None else field
    resolution = field.resolution
    shape = np.array(field.clear.shape)
    cells = np.clip(np.rint((ends - field.low) / resolution).astype(int), 0, shape - 1)
    cost = cell_cost(field.clear, field.inner, comfort, cells, resolution)
    graph = cell_graph(cost)
    first, last = (int(np.ravel_multi_index(tuple(end), cost.shape)) for end in cells)
    come, before = dijkstra(graph, directed=False, indices=[first, last], return_predecessors=True)
    if not np.isfinite(come[0, last]):
        return ()
    heights = _heights(field)
    sums = [_summed(tree, heights) for tree in before]
    edges = graph.tocoo()
    one, two, own = (np.asarray(k, dtype=np.intp) for k in (*edges.coords, np.arange(cost.size)))
    there, onward = np.concatenate((one, two, own)), np.concatenate((two, one, own))
    step = np.concatenate((edges.data, edges.data, np.zeros(cost.size)))
    reached = sums[0][there] + _crossings(there, onward, heights)
    use = np.isfinite(come[0, there] + come[1, onward]) & ((reached != sums[0][onward]) | (step == 0.0))
    there, onward, step, reached = there[use], onward[use], step[use], reached[use]
    total = come[0, there] + step + come[1, onward]
    order = np.argsort(total, kind="stable")
    _, best = np.unique((reached - sums[1][onward])[order], return_index=True)
    found: list[Way] = []
    for k in order[np.sort(best)[:count]].tolist():
        route = _joined(int(there[k]), int(onward[k]), before[0], before[1])
        points = field.low + resolution * np.column_stack(np.unravel_index(route, cost.shape)).astype(float)
        points[0], points[-1] = ends
        word = base_class(points, field.components)
        found.append(Way(smooth_way(points, resolution), float(total[k]) * resolution, word))
    return tuple(found)


def _heights(field: ComponentMap) -> Indices:
    """Sums (rows, columns + 1) of random numbers, one for each component, over those below a point of a grid line."""
    rows, columns = field.labels.shape
    heights = np.zeros((rows, columns + 1), dtype=np.int64)
    draws = np.random.default_rng(0).integers(1, 2**48, len(field.components))
    for component, draw in zip(field.components, draws, strict=True):
        i, j = np.rint((component.at - field.low) / field.resolution).astype(int)
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
    """(cells,) for each cell the signed sum of the numbers of the rays that the tree's way to it crosses.

    Equal sums mean equal numbers of crossings of each ray, but for a chance that does not matter.
    """
    cell = np.arange(len(before))
    before = np.where(before < 0, cell, before)
    value = _crossings(before, cell, heights)
    while (before != before[before]).any():
        value = value + value[before]
        before = before[before]
    return value


def _joined(there: int, onward: int, from_start: Indices, from_goal: Indices) -> list[int]:
    """Cells of the cheapest way to one cell and on from another; what it would go there and back is left out."""
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
