"""Paths over a grid: the cheapest one of the base among the obstacles seen from above, wide gaps before short paths.

The robot is a disc to the grid, as narrow as the narrowest gap it could pass; where it is wider, and whether it can
turn there, the relaxation and the certificate decide. So a path is an initial guess and not a proof.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import ceil, floor
from typing import TYPE_CHECKING

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.coal_shapes import support
from elastic_strips.errors import ParameterError
from elastic_strips.robot import PlanarFootprint, RobotModel
from elastic_strips.robot.footprint import DIRECTIONS, outline_directions
from elastic_strips.scene import Scene
from elastic_strips.summary import Summary
from elastic_strips.work import count_work

if TYPE_CHECKING:
    from scipy.sparse import csr_array

DRIVEN_OVER_HEIGHT = 0.02  # [m] obstacles that lie lower are driven over
_NARROW_COST = 12.0  # cost of a cell at the narrowest clearance against one in the open
_SMOOTHING_WIDTH = 0.25  # standard deviation [m] of the filter that rounds the corners of the grid's path
MOST_CELLS = 400_000
"""Largest grid; searching it takes about a second."""
COMFORTABLE_CLEARANCE = 0.35
"""Clearance [m] beyond the inner disc above which more of it is worth nothing."""
_CELL_EDGE = 0.05  # [m] edge of a cell, where the grid is not too large
GRID_MARGIN = 3.0  # [m] a grid reaches so far beyond what it is about
_LARGEST_CELL = 0.5  # [m] a larger cell says nothing about where a robot passes
_MOST_FINE_CELLS = 5_000  # cells; where there are more, a coarse grid says where to search
_COARSE_CELLS = 3  # cells along the edge of a coarse one
_COARSE_CELLS_ASIDE = 2  # coarse cells aside of the coarse path that are searched
_GRID_MOVES = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))  # and back


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class GridPath(Summary):
    """The result of a search on the grid.

    Attributes:
        points: (K, 2) waypoints of the base from start to goal [m], a cell apart; None where there is no path.
        reason: why there is no path; empty where there is one.
    """

    points: Array | None
    reason: str


def grid_path(
    robot: RobotModel,
    scene: Scene,
    start: Array,
    goal: Array,
    *,
    box: tuple[Array, Array] | None = None,
    inner: float | None = None,
    most_cells: int = MOST_CELLS,
    over: Callable[[], bool] = lambda: False,
) -> GridPath:
    """A path of the base from start to goal, found on a grid by Dijkstra's algorithm, its corners rounded.

    A cell costs more the nearer an obstacle is; it is closed where the disc `PlanarFootprint.inner` does not
    fit. All obstacles that are not above the robot in its start posture, or on the floor below 2 cm, count.

    Args:
        robot: the robot; its base must move.
        scene: the obstacles, standing still.
        start, goal: configurations (nq,).
        box: low and high corner (2,) of the grid [m]; 3 m beyond start and goal where None.
        inner: radius [m] of the disc that has to fit, instead of the robot's.
        most_cells: largest size of the grid; where there would be more cells of 5 cm, they are larger.
        over: a function that says whether the time is over; then no path is found.

    Raises:
        ParameterError: the base is fixed.
    """
    if not robot.space.planar:
        raise ParameterError(f"grid_path: the base of {robot.name!r} is fixed; diff_drive or omni is needed")
    endpoints = robot.space.to_coordinates(np.stack((start, goal)))[:, :2]
    low_in, high_in = box_about(endpoints) if box is None else box
    low, shape, resolution = grid_frame(low_in, high_in, most_cells)
    if resolution > _LARGEST_CELL:
        size = resolution * (shape - 1)
        reason = f"an area of {size[0]:.0f} m × {size[1]:.0f} m is too large for a grid of {most_cells} cells"
        return GridPath(None, reason)
    footprint = PlanarFootprint.of(robot, start)
    clear = clearance_map(owner_map(scene, low, shape, resolution, footprint.height, over=over) >= 0, resolution)
    if over():
        return GridPath(None, "the time was over before the grid was searched")
    for axis, cells in enumerate(shape.tolist()):  # the outermost cells can lie outside by less than a cell
        middle = low[axis] + resolution * np.arange(cells)
        outside = (middle < low_in[axis]) | (middle > high_in[axis])
        np.moveaxis(clear, axis, 0)[outside] = 0.0
    inner = footprint.inner if inner is None else inner
    path = cheapest_path(clear, low, resolution, endpoints, inner=inner, comfort=COMFORTABLE_CLEARANCE)
    if path is None:
        (x, y), (u, w) = low, low + resolution * (shape - 1)
        where = f"within x {x:.1f} … {u:.1f} m, y {y:.1f} … {w:.1f} m"
        return GridPath(None, f"no way for the base on a grid of {resolution:.3g} m {where}")
    return GridPath(smooth_path(path, resolution), "")


def box_about(points: Array) -> tuple[Array, Array]:
    """Low and high corner (2,) [m] of a grid about positions (K, 2) of the base."""
    return points.min(axis=0) - GRID_MARGIN, points.max(axis=0) + GRID_MARGIN


def grid_frame(low: Array, high: Array, most_cells: int) -> tuple[Array, Indices, float]:
    """The grid that holds a box: middle (2,) of its first cell [m], its shape (2,), and the edge of its cells [m].

    Args:
        low, high: (2,) corners [m].
        most_cells: largest number of cells; their edge is a multiple of 5 cm where there would be more.
    """
    edge, most_cells = _CELL_EDGE, max(most_cells, 16)
    while True:
        first = np.floor(low / edge) * edge
        shape = np.ceil((high - first) / edge).astype(np.int64) + 1
        cells = float(shape[0]) * float(shape[1])
        if cells <= most_cells:
            return first, shape, edge
        times = edge / _CELL_EDGE
        edge = _CELL_EDGE * max(np.ceil(times * np.sqrt(cells / most_cells)), np.rint(times) + 1.0)


def cheapest_path(
    clear: Array, low: Array, resolution: float, endpoints: Array, *, inner: float, comfort: float
) -> Array | None:
    """Waypoints (K, 2) [m] of the cheapest path between two endpoints, a cell apart; None where there is none.

    Args:
        clear: (rows, columns) distance of each cell's middle to the nearest obstacle [m].
        low: (2,) middle of the first cell [m].
        resolution: edge of a cell [m].
        endpoints: (2, 2) start and goal [m].
        inner: clearance below which a cell is closed [m].
        comfort: clearance beyond ``inner`` above which more of it is worth nothing [m].
    """
    cells = np.clip(np.rint((endpoints - low) / resolution).astype(int), 0, np.array(clear.shape) - 1)
    cost = cell_cost(clear, inner, comfort, cells, resolution)
    about = _about_coarse_path(cost, cells) if cost.size > _MOST_FINE_CELLS else None
    route = None if about is None else _cheapest_route(np.where(about, cost, np.inf), cells)
    if route is None:
        route = _cheapest_route(cost, cells)
    if route is None:
        return None
    path = low + resolution * route
    path[0], path[-1] = endpoints
    return path


def _cheapest_route(cost: Array, ends: Indices) -> Indices | None:
    """Cells (K, 2) from the first of two ends (2, 2) to the second, or None."""
    from scipy.sparse.csgraph import dijkstra  # late: slow to import

    first, last = (int(np.ravel_multi_index(tuple(end), cost.shape)) for end in ends)
    _, before = dijkstra(cell_graph(cost), indices=first, return_predecessors=True)
    if first != last and before[last] < 0:
        return None
    route = [last]
    while route[-1] != first:
        route.append(int(before[route[-1]]))
    return np.column_stack(np.unravel_index(route[::-1], cost.shape))


def _about_coarse_path(cost: Array, ends: Indices) -> Mask | None:
    """Cells (rows, columns) about the cheapest path on a coarse grid, each cell of which costs what its best one does.

    So no gap is missed. Where the coarse path passes a gap that does not exist, there may be no path on its cells.
    """
    from scipy.ndimage import binary_dilation  # late: slow to import

    blocks = -(-np.array(cost.shape) // _COARSE_CELLS)
    padded = np.full(tuple(_COARSE_CELLS * blocks), np.inf)
    padded[: cost.shape[0], : cost.shape[1]] = cost
    route = _cheapest_route(
        padded.reshape(blocks[0], _COARSE_CELLS, blocks[1], _COARSE_CELLS).min(axis=(1, 3)), ends // _COARSE_CELLS
    )
    if route is None:
        return None
    about = np.zeros(tuple(blocks), dtype=np.bool_)
    about[route[:, 0], route[:, 1]] = True
    about = binary_dilation(about, np.ones((3, 3), dtype=np.bool_), iterations=_COARSE_CELLS_ASIDE)
    cells = np.asarray(about.repeat(_COARSE_CELLS, axis=0).repeat(_COARSE_CELLS, axis=1), dtype=np.bool_)
    return cells[: cost.shape[0], : cost.shape[1]]


def clearance_map(taken: Mask, resolution: float) -> Array:
    """Distance (rows, columns) [m] of each cell's middle to the nearest cell that is taken."""
    from scipy.ndimage import distance_transform_edt  # late: slow to import

    if not taken.any():
        return np.full(taken.shape, np.inf)
    return np.asarray(distance_transform_edt(~taken, sampling=resolution))


def owner_map(
    scene: Scene,
    low: Array,
    shape: Indices,
    resolution: float,
    height: float,
    *,
    over: Callable[[], bool] = lambda: False,
) -> Indices:
    """Index in the scene (rows, columns) of an obstacle that takes each cell, −1 where none does.

    Args:
        scene: the obstacles.
        low: (2,) middle of the first cell [m].
        shape: (2,) number of cells along x and y.
        resolution: edge of a cell [m].
        height: obstacles above this height [m] are left out.
        over: a function that says whether the time is over; then the other obstacles are left out.
    """
    table = scene.table
    owner = np.full(tuple(shape), -1, dtype=np.intp)
    around = outline_directions()
    center, half = table.center, table.half_extents
    high = low + resolution * (shape - 1)
    near = ((center - half)[:, :2] <= high).all(axis=1) & ((center + half)[:, :2] >= low).all(axis=1)
    near &= (center[:, 2] - half[:, 2] < height) & (center[:, 2] + half[:, 2] > DRIVEN_OVER_HEIGHT)
    for row in np.flatnonzero(near).tolist():
        if over():
            break
        part, rotation, at = table.parts[row], table.rotation[row], table.translation[row]
        whose = int(table.obstacle_index[row])
        local = around @ rotation
        if part.geometry is None:
            for box, shift in part.boxes:
                _fill(owner, whose, support(box, local), at + rotation @ np.asarray(shift), low, resolution)
        else:
            _fill(owner, whose, support(part.geometry, local), at, low, resolution)
    return owner


_UPRIGHT_NORMAL = 1e-9  # a half plane whose normal has a smaller part along y bounds x alone


@cache
def _half_planes() -> tuple[Indices, tuple[tuple[Mask, Array, Array], ...]]:
    """Directions towards x, y, -x, -y; and those that bound y from above, from below and not at all: their indices,
    the factor of their supports and the slope along x."""
    around, quarter = outline_directions(), DIRECTIONS // 4
    up, down = around[:, 1] > _UPRIGHT_NORMAL, around[:, 1] < -_UPRIGHT_NORMAL
    sides = []
    for which, scale in ((up, around[:, 1]), (down, around[:, 1]), (~(up | down), np.ones(DIRECTIONS))):
        sides.append((which, 1.0 / scale[which, None], around[which, :1] / scale[which, None]))
    return quarter * np.arange(4), tuple(sides)


def _fill(owner: Indices, whose: int, reach: Array, at: Array, low: Array, resolution: float) -> None:
    """Give the cells within half a cell of an outline, with the supports ``reach`` about ``at``, to ``whose``."""
    axes, sides = _half_planes()
    reach = reach + 0.5 * resolution
    right, upper, left, lower = reach[axes].tolist()
    x0, y0 = (at[:2] - low).tolist()
    i, last = max(ceil((x0 - left) / resolution), 0), min(floor((x0 + right) / resolution), owner.shape[0] - 1)
    j, top = max(ceil((y0 - lower) / resolution), 0), min(floor((y0 + upper) / resolution), owner.shape[1] - 1)
    if last < i or top < j:
        return
    x, y = resolution * np.arange(i, last + 1) - x0, resolution * np.arange(j, top + 1) - y0
    above, below, upright = (reach[which, None] * factor - slope * x for which, factor, slope in sides)
    inside = (y >= below.max(axis=0)[:, None]) & (y <= above.min(axis=0)[:, None])
    if len(upright):
        inside &= (upright >= 0.0).all(axis=0)[:, None]
    owner[i : last + 1, j : top + 1][inside] = whose


def cell_cost(clear: Array, inner: float, comfort: float, endpoints: Array, resolution: float) -> Array:
    """Cost of each cell per metre: 1 in the open, more near obstacles, infinite where the robot does not fit."""
    spare = np.clip((clear - inner) / comfort, 0.0, 1.0)
    cost = 1.0 + (_NARROW_COST - 1.0) * (1.0 - spare) ** 2
    cost[clear < inner] = np.inf
    reach = int(np.ceil(inner / resolution))
    for i, j in endpoints:  # start and goal are known to be free; the map is coarse
        window = (slice(max(i - reach, 0), i + reach + 1), slice(max(j - reach, 0), j + reach + 1))
        closed = ~np.isfinite(cost[window]) & (clear[window] > 0.0)
        cost[window] = np.where(closed, 4.0 * _NARROW_COST, cost[window])
    return cost


def cell_graph(cost: Array) -> csr_array:
    """Costs of the moves from each cell (rows, columns) to its neighbours, as a sparse matrix; a cell may be closed."""
    from scipy.sparse import csr_array  # late: slow to import

    rows, columns = cost.shape
    padded = np.full((rows + 4, columns + 4), np.inf)
    padded[2:-2, 2:-2] = cost
    open_ = np.flatnonzero(np.isfinite(cost))
    count_work(batches=1, cells=len(open_))
    steps = np.array(_GRID_MOVES + tuple((-i, -j) for i, j in _GRID_MOVES))
    at = (open_ // columns + 2) * (columns + 4) + open_ % columns + 2
    flat = padded.ravel()
    weight = flat[at[:, None] + steps @ (columns + 4, 1)]
    weight += flat[at, None]
    weight *= 0.5 * np.hypot(*steps.T)
    linked = np.isfinite(weight)
    pointers = np.zeros(cost.size + 1, dtype=np.int32)
    pointers[open_ + 1] = linked.sum(axis=1)
    to = open_.astype(np.int32)[:, None] + (steps @ (columns, 1)).astype(np.int32)
    return csr_array((weight[linked], to[linked], np.cumsum(pointers, dtype=np.int32)), shape=(cost.size, cost.size))


def smooth_path(path: Array, resolution: float) -> Array:
    """The path with even steps and rounded corners; its ends stay."""
    from scipy.ndimage import gaussian_filter1d  # late: slow to import

    step = 0.5 * resolution
    even = resample(path, step)
    if len(even) < 4:
        return even
    aside = even - np.linspace(even[0], even[-1], len(even))  # zero at both ends: an odd continuation keeps them
    rounded = gaussian_filter1d(
        np.vstack((-aside[:0:-1], aside, -aside[-2::-1])), _SMOOTHING_WIDTH / step, axis=0, mode="nearest"
    )
    result = rounded[len(even) - 1 : 2 * len(even) - 1] + np.linspace(even[0], even[-1], len(even))
    result[0], result[-1] = path[0], path[-1]
    return resample(result, resolution)


def resample(path: Array, step: float) -> Array:
    """Points at even distances, about ``step`` [m], along a polyline (K, 2); its ends stay."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    count = max(int(np.ceil(length[-1] / step)), 1) + 1
    at = np.linspace(0.0, length[-1], count)
    return np.column_stack([np.interp(at, length, path[:, k]) for k in range(2)])
