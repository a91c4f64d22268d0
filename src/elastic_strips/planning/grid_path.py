"""Paths over a grid: the cheapest one of the base among the obstacles seen from above, wide gaps before short paths.

The robot is a disc to the grid, as narrow as the narrowest gap it could pass; where it is wider, and whether it can
turn there, the relaxation and the certificate decide. So a path is an initial guess and not a proof.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import islice
from math import ceil, floor
from typing import TYPE_CHECKING, cast

import coal
import numpy as np

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.coal_shapes import supports
from elastic_strips.constants import GRID_MOVES, UPRIGHT_NORMAL
from elastic_strips.errors import ParameterError
from elastic_strips.native import kernel
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
_SMOOTHING_REACH = 4.0  # standard deviations up to which it takes in
MOST_CELLS = 400_000
"""Largest grid; with the kernel a path on it takes some 5 ms, without it 0.2 s."""
COMFORTABLE_CLEARANCE = 0.35
"""Clearance [m] beyond the inner disc above which more of it is worth nothing."""
_CELL_EDGE = 0.05  # [m] edge of a cell, where the grid is not too large
GRID_MARGIN = 3.0  # [m] a grid reaches so far beyond what it is about
_MOST_WALLS = 6  # that are named
_NEXT_TO = 0.4  # of the inner disc's radius: a base so far from where a way leads is next to it
_LARGEST_CELL = 0.5  # [m] a larger cell says nothing about where a robot passes


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class GridPath(Summary):
    """The result of a search on the grid.

    Attributes:
        points: (K, 2) waypoints of the base from start to goal [m], a cell apart; None where there is no path.
        reason: why there is no path; empty where there is one.
        walled_in: whether that is because no way leads out from about the goal, or the start, and what stands about it;
            empty where both are open.
    """

    points: Array | None
    reason: str
    walled_in: str = ""


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
    """The cheapest path of the base from start to goal on a grid, its corners rounded.

    A cell costs more the nearer an obstacle is; it is closed where the disc `PlanarFootprint.inner` does not
    fit. All obstacles that are not above the robot in its start posture, or on the floor below 2 cm, count.

    Args:
        robot: the robot; its base must move.
        scene: the obstacles, standing still.
        start, goal: configurations (nq,).
        box: low and high corner (2,) of the grid [m]; 3 m beyond start and goal where None.
        inner: radius [m] of the disc that has to fit, instead of the robot's.
        most_cells: largest size of the grid; where there would be more cells of 5 cm, they are larger.
        over: a function that says whether the time is over, asked until the search begins; then no path is found.

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
    owner = owner_map(scene, low, shape, resolution, footprint.height, over=over)
    clear = clearance_map(owner >= 0, resolution)
    if over():
        return GridPath(None, "the time ran out before the grid was searched")
    for axis, cells in enumerate(shape.tolist()):  # the outermost cells can lie outside by less than a cell
        middle = low[axis] + resolution * np.arange(cells)
        outside = (middle < low_in[axis]) | (middle > high_in[axis])
        np.moveaxis(clear, axis, 0)[outside] = 0.0
    inner = footprint.inner if inner is None else inner
    path = cheapest_path(clear, low, resolution, endpoints, inner=inner, comfort=COMFORTABLE_CLEARANCE)
    if path is None:
        (x, y), (u, w) = low, low + resolution * (shape - 1)
        where = f"within x {x:.1f} … {u:.1f} m, y {y:.1f} … {w:.1f} m"
        cells = _cells(endpoints, low, resolution, clear.shape)
        walled = _walled_in(clear, owner, cells, inner, resolution, scene.names)
        why = f": {walled}" if walled else ""
        return GridPath(None, f"no way for the base on a grid of {resolution:.3g} m {where}{why}", walled)
    return GridPath(smooth_path(path, resolution), "")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Ground:
    """Where the base gets to from the start, as far as a grid says.

    Attributes:
        near: (rows, columns) cells to which, or to next to which, a way leads.
        low: (2,) middle of the first cell [m].
        resolution: edge of a cell [m].
    """

    near: Mask
    low: Array
    resolution: float

    def reached(self, places: Array) -> Mask:
        """(N,) whether a way leads to places (N, 2) [m] of the base."""
        return self.near[tuple(_cells(places, self.low, self.resolution, self.near.shape).T)]


def ground_about(robot: RobotModel, scene: Scene, start: Array, places: Array) -> Ground | None:
    """Where the base gets to about places (K, 2) [m] from the start (nq,), by such a grid as :func:`grid_path`'s; None
    where its cells would be too large to say.

    Ways may lead around outside of a box that reaches 3 m beyond start and places.
    """
    from scipy.ndimage import distance_transform_edt, label  # late: slow to import

    here = robot.space.to_coordinates(start)[None, :2]
    low, shape, resolution = grid_frame(*box_about(np.vstack((here, places))), MOST_CELLS)
    footprint = PlanarFootprint.of(robot, start)
    if resolution > _NEXT_TO * footprint.inner:
        return None
    owner = owner_map(scene, low, shape, resolution, footprint.height)
    cells = _cells(here, low, resolution, owner.shape)
    cost = cell_cost(clearance_map(owner >= 0, resolution), footprint.inner, COMFORTABLE_CLEARANCE, cells, resolution)
    open_ = np.isfinite(cost)
    count_work(batches=1, cells=int(np.count_nonzero(open_)))
    regions = np.asarray(cast("tuple[Indices, int]", label(open_, np.ones((3, 3), dtype=bool)))[0])
    at_edge = np.unique(np.concatenate((regions[0], regions[-1], regions[:, 0], regions[:, -1])))
    own = regions[tuple(cells[0])]
    inside = np.isin(regions, at_edge[at_edge > 0]) if own in at_edge else regions == own
    near = resolution * np.asarray(distance_transform_edt(~inside)) <= _NEXT_TO * footprint.inner
    return Ground(near, low, resolution)


def _cells(points: Array, low: Array, resolution: float, shape: tuple[int, ...]) -> Indices:
    """The cells (K, 2) of positions (K, 2) [m]."""
    return np.clip(np.rint((points - low) / resolution).astype(int), 0, np.array(shape) - 1)


def _walled_in(
    clear: Array, owner: Indices, cells: Indices, inner: float, resolution: float, names: Sequence[str]
) -> str:
    """What stands about the goal, or about the start, where no way leads out to the edge of the grid's box.

    Args:
        clear: (rows, columns) distance of each cell's middle to the nearest obstacle [m]; 0 outside of the box.
        owner: (rows, columns) the obstacle that takes each cell, −1 where none does.
        cells: (2, 2) of start and goal.
        inner: clearance below which a cell is closed [m].
        resolution: edge of a cell [m].
        names: of the obstacles.
    """
    from scipy.ndimage import binary_dilation, distance_transform_edt, label  # late: slow to import

    around = np.ones((3, 3), dtype=bool)
    out = np.ones(np.array(clear.shape) + 2, dtype=bool)  # outside of the box
    out[1:-1, 1:-1] = (clear == 0.0) & (owner < 0)
    edge = binary_dilation(out, around)[1:-1, 1:-1]
    open_ = np.isfinite(cell_cost(clear, inner, COMFORTABLE_CLEARANCE, cells, resolution))
    regions = np.asarray(cast("tuple[Indices, int]", label(open_, around))[0])
    for what, cell in (("goal", cells[1]), ("start", cells[0])):
        inside = regions == regions[tuple(cell)]
        if (inside & edge).any():
            continue
        near = resolution * np.asarray(distance_transform_edt(~inside)) <= inner + 2.0 * resolution
        walls = [names[int(k)] for k in np.unique(owner[near & (owner >= 0)])]
        shown = ", ".join(walls[:_MOST_WALLS]) + (", …" if len(walls) > _MOST_WALLS else "")
        needed = f"{2.0 * inner:.2f} m on a grid of {resolution:.3g} m"
        return f"the {what} is walled in by {shown}: the base needs {needed} to pass"
    return ""


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
    cells = _cells(endpoints, low, resolution, clear.shape)
    route = cheapest_route(cell_cost(clear, inner, comfort, cells, resolution), cells)
    if route is None:
        return None
    path = low + resolution * route
    path[0], path[-1] = endpoints
    return path


def cheapest_route(cost: Array, ends: Indices) -> Indices | None:
    """Cells (K, 2) of the cheapest path from the first of two cells (2, 2) to the second; None where there is none.

    Args:
        cost: (rows, columns) cost of each cell per edge of a cell: positive, the largest at most 10,000 times the
            least; infinite where it is closed.
        ends: (2, 2) first and last cell.
    """
    count_work(batches=1, cells=int(np.count_nonzero(np.isfinite(cost))))
    first, last = (int(np.ravel_multi_index(tuple(end), cost.shape)) for end in ends)
    native = kernel()
    if native is None:
        route = _twin_route(cost, first, last)
    else:
        route = native.cheapest_route(np.ascontiguousarray(cost), first, last)
    return np.column_stack(np.unravel_index(route, cost.shape)) if route else None


def _twin_route(cost: Array, first: int, last: int) -> list[int]:
    """Numbers of the cells from the first to the last; empty where there is no path."""
    from scipy.sparse.csgraph import dijkstra  # late: slow to import

    if first == last:
        return [first]
    graph = cell_graph(cost)
    come = dijkstra(graph, indices=first)
    if not np.isfinite(come[last]):
        return []
    route = [last]
    while route[-1] != first:  # by the first of the moves that explain a cell's cost: the kernel goes the same way
        moves = slice(*graph.indptr[route[-1] : route[-1] + 2])
        before = graph.indices[moves]
        route.append(int(before[np.argmax(come[before] + graph.data[moves] == come[route[-1]])]))
    return route[::-1]


def clearance_map(taken: Mask, resolution: float) -> Array:
    """Distance (rows, columns) [m] of each cell's middle to the nearest cell that is taken."""
    native = kernel()
    if native is not None:
        clear = np.empty(taken.shape)
        native.clearance_map(np.ascontiguousarray(taken), resolution, clear)
        return clear
    from scipy.ndimage import distance_transform_edt  # late: slow to import

    if not taken.any():
        return np.full(taken.shape, np.inf)
    return resolution * np.asarray(distance_transform_edt(~taken))


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
    owner = np.full(tuple(shape), -1, dtype=np.int64)
    native, around = kernel(), np.ascontiguousarray(outline_directions()[:, :2])
    low = np.asarray(low, dtype=float)
    for whose, reach, at in _outlines(scene, low, low + resolution * (shape - 1), height, over):
        if native is not None:
            native.fill_outlines(owner, low, resolution, whose, reach, at, around)
            continue
        for obstacle, outline, place in zip(whose.tolist(), reach, at, strict=True):
            _fill(owner, obstacle, outline, place, low, resolution)
    return owner


def _outlines(
    scene: Scene, low: Array, high: Array, height: float, over: Callable[[], bool]
) -> Iterator[tuple[Indices, Array, Array]]:
    """Convex outlines of the obstacles over a box that are no higher than ``height`` [m], some at a time.

    Yields:
        the obstacles' indices (K,), how far [m] each outline reaches all around (K, DIRECTIONS), and from where (K, 2)
        [m]; first those of boxes, of which there may be very many, then the others.
    """
    table, around = scene.table, outline_directions()
    center, half = table.center, table.half_extents
    near = ((center - half)[:, :2] <= high).all(axis=1) & ((center + half)[:, :2] >= low).all(axis=1)
    near &= (center[:, 2] - half[:, 2] < height) & (center[:, 2] + half[:, 2] > DRIVEN_OVER_HEIGHT)
    rows = np.flatnonzero(near)
    boxes = np.fromiter((type(table.parts[row].geometry) is coal.Box for row in rows.tolist()), bool, len(rows))
    for some in np.split(rows[boxes], range(_OUTLINES_AT_ONCE, int(boxes.sum()), _OUTLINES_AT_ONCE)):
        if over():
            return
        reach = (np.abs(around @ table.rotation[some]) @ table.local_half[some, :, None])[..., 0]
        yield table.obstacle_index[some].astype(np.int64), reach, table.translation[some, :2]
    pieces = (
        (row, shape, shift)
        for row in rows[~boxes].tolist()
        for part in (table.parts[row],)
        for shape, shift in (part.boxes if part.geometry is None else ((part.geometry, _NO_SHIFT),))
    )
    while pieces_now := list(islice(pieces, _OUTLINES_AT_ONCE)):
        if over():
            return
        found, shapes, shifts = zip(*pieces_now, strict=True)
        of = np.array(found)
        rotation = table.rotation[of]
        at = table.translation[of] + (rotation @ np.array(shifts)[..., None])[..., 0]
        yield table.obstacle_index[of].astype(np.int64), supports(shapes, around @ rotation), at[:, :2].copy()


_OUTLINES_AT_ONCE = 1_000  # that their directions take little memory
_NO_SHIFT = np.zeros(3)


@cache
def _half_planes() -> tuple[Indices, tuple[tuple[Mask, Array, Array], ...]]:
    """Directions towards x, y, -x, -y; and those that bound y from above, from below and not at all: their indices,
    the factor of their supports and the slope along x."""
    around, quarter = outline_directions(), DIRECTIONS // 4
    up, down = around[:, 1] > UPRIGHT_NORMAL, around[:, 1] < -UPRIGHT_NORMAL
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


def cell_cost(clear: Array, inner: float, comfort: float, endpoints: Indices, resolution: float) -> Array:
    """Cost of each cell per metre: 1 in the open, more near obstacles, infinite where the robot does not fit."""
    native = kernel()
    if native is not None:
        cost = np.empty(clear.shape)
        native.cell_cost(np.ascontiguousarray(clear, dtype=float), inner, comfort, _NARROW_COST, cost)
    else:
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
    steps = np.array([(sign * i, sign * j) for i, j in GRID_MOVES for sign in (1, -1)])
    at = (open_ // columns + 2) * (columns + 4) + open_ % columns + 2
    flat = padded.ravel()
    weight = flat[at[:, None] + steps @ (columns + 4, 1)]
    weight += flat[at, None]
    weight *= 0.5 * np.sqrt(np.square(steps).sum(axis=1))
    linked = np.isfinite(weight)
    pointers = np.zeros(cost.size + 1, dtype=np.int32)
    pointers[open_ + 1] = linked.sum(axis=1)
    to = open_.astype(np.int32)[:, None] + (steps @ (columns, 1)).astype(np.int32)
    return csr_array((weight[linked], to[linked], np.cumsum(pointers, dtype=np.int32)), shape=(cost.size, cost.size))


def smooth_path(path: Array, resolution: float) -> Array:
    """The path with even steps and rounded corners; its ends stay."""
    step = 0.5 * resolution
    even = resample(path, step)
    if len(even) < 4:
        return even
    line = np.linspace(even[0], even[-1], len(even))
    aside = even - line  # zero at both ends: an odd continuation keeps them
    width = _SMOOTHING_WIDTH / step
    reach = round(_SMOOTHING_REACH * width)
    weights = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / width))
    weights /= weights.sum()
    aside = np.vstack((-aside[:0:-1], aside, -aside[-2::-1]))
    middle = slice(len(even) - 1 + reach, 2 * len(even) - 1 + reach)
    rounded = line + np.column_stack([np.convolve(aside[:, k], weights)[middle] for k in range(2)])
    rounded[0], rounded[-1] = path[0], path[-1]
    return resample(rounded, resolution)


def resample(path: Array, step: float) -> Array:
    """Points at even distances, about ``step`` [m], along a polyline (K, 2); its ends stay."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    count = max(int(np.ceil(length[-1] / step)), 1) + 1
    at = np.linspace(0.0, length[-1], count)
    return np.column_stack([np.interp(at, length, path[:, k]) for k in range(2)])
