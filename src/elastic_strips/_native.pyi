"""The native kernel: what C++ gives to Python. Classes keep the arrays that they are given and work on them in place.

Shapes of arrays are those of the attributes that they belong to: see `Kinematics`, `BodySet`, `CandidateParts`,
`ObstacleProximity`, `SelfProximity` and `System`. Arrays have to be contiguous and of their very type (float64, int64,
bool; states int8, triangles uint32): none is converted. Before anything is read or written, all sizes and all numbers
that count others are compared, and what is only read has to be finite: `TypeError` or `ValueError` where it does not
fit. What numbers parts belongs to one `Parts`, and no other is accepted with it. A workspace that another thread is in
raises `ThreadError`, and what has no answer `NumericalError`.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Indices, Mask

Proof = tuple[tuple[float, int, float, bool] | None, int, tuple[int, int]]
"""(place, pair, distance, certain) of the worst place, or None; configurations measured between nodes; and how many
distances were bounded, and how many measured."""

coal_version: str
interface: str
"""Of the headers that it was compiled with."""

constants: dict[str, float | tuple[float, ...] | tuple[tuple[int, int], ...]]
"""Of `elastic_strips.constants`, as it was compiled with."""

instructions: str
"""That spheres are looked at with: "avx512", "avx2" or "baseline"."""

class Solid:
    pass

def primitive(kind: str, size: Sequence[float], swept: float) -> Solid: ...
def convex(points: Array, triangles: npt.NDArray[np.uint32], swept: float) -> Solid: ...
def block(sides: Array, at: Array) -> Solid: ...
def spheres(solid: Solid, most: int, fine: float) -> list[tuple[float, float, float, float, float, int]]:
    """Centres, outer and inner radii [m], and the next sphere that is not below, of the spheres that hold a shape."""

class Tree:
    def __init__(
        self,
        planar: bool,
        parents: Indices,
        motion: Indices,
        prismatic: Mask,
        circular: Mask,
        support: Mask,
        offset: Array,
        coordinate: Indices,
        rate: Array,
        shift: Array,
    ) -> None: ...
    def place(self, coordinates: Array, T: Array, J: Array, jacobians: bool) -> None: ...

class Bodies:
    def __init__(
        self,
        tree: Tree,
        solids: Sequence[Solid],
        joint: Indices,
        rotation: Array,
        translation: Array,
        ends: Array,
        radius: Array,
        skin: float,
    ) -> None: ...

class Parts:
    def __init__(
        self,
        solids: Sequence[Solid | None],
        rotation: Array,
        translation: Array,
        box_center: Array,
        box_half: Array,
    ) -> None: ...
    def keep(self, former: Parts, source: Indices) -> None: ...

class Moving:
    def __init__(self, parts: Parts, shift: Array, uncertainty: Array, mover: Indices) -> None: ...

class Distances:
    def __init__(
        self,
        parts: Parts,
        bound: Array,
        since: Array,
        exact: Array,
        direction: Array,
        witness: Array,
        limit: Array,
        start: Indices,
        part: Indices,
        floor: Array,
    ) -> None: ...

def near_parts(
    center: Array,
    radius: Array,
    low: Array,
    high: Array,
    always: Mask,
    fresh: Mask,
    start: Indices,
    part: Indices,
    source: Indices,
    former: int,
) -> tuple[Indices, Indices, Indices]: ...

class Narrowphase:
    def __init__(self, bodies: Bodies) -> None: ...
    def query(
        self,
        T: Array,
        node: Indices,
        body: Indices,
        part: Indices,
        parts: Parts,
        shift: Array | None,
        distance: Array,
        direction: Array,
        witness: Array,
    ) -> None: ...
    def refine(
        self, T: Array, parts: Parts, moving: Moving | None, influence: float, distances: Distances
    ) -> tuple[int, int]: ...
    def follow(
        self,
        T: Array,
        coordinates: Array,
        influence: float,
        kept: Array,
        ends: Array,
        rotations: Array,
        cover_low: Array,
        cover_high: Array,
        cover: Indices,
        margin: Array,
        distances: Distances,
    ) -> list[int]: ...
    def certify(
        self,
        T: Array,
        J: Array,
        coordinates: Array,
        v: Array,
        parts: Parts,
        moving: Moving | None,
        radius: Array,
        approach: Array | None,
        distances: Distances,
        clearance: float,
        depth: int,
        states: npt.NDArray[np.int8],
    ) -> Proof: ...
    def prove(
        self,
        T: Array,
        coordinates: Array,
        v: Array,
        parts: Parts,
        moving: Moving | None,
        travel: Array,
        approach: Array | None,
        clearance: float,
        depth: int,
    ) -> Proof: ...

class SelfDistances:
    def __init__(
        self, bound: Array, since: Array, exact: Array, direction: Array, first: Array, second: Array, tolerance: float
    ) -> None: ...

class SelfPairs:
    def __init__(self, bodies: Bodies, pairs: Indices) -> None: ...
    def update(
        self, T: Array, coordinates: Array, before: Array, radius: Array, reach: Array, distances: SelfDistances
    ) -> tuple[int, int]: ...
    def certify(
        self,
        T: Array,
        coordinates: Array,
        v: Array,
        radius: Array,
        distances: SelfDistances,
        clearance: float,
        depth: int,
        states: npt.NDArray[np.int8],
    ) -> Proof: ...
    def prove(self, T: Array, coordinates: Array, v: Array, travel: Array, clearance: float, depth: int) -> Proof: ...

class System:
    def __init__(self, force: Array, diagonal: Array, upper: Array) -> None: ...
    def add_elastic(self, planar: bool, v: Array, weight: Array) -> float: ...
    def add_repulsion(
        self,
        narrow: Narrowphase,
        J: Array,
        distances: Distances,
        influence: float,
        k_r: float,
        near: float,
        k_near: float,
    ) -> float: ...
    def add_self_repulsion(
        self, pairs: SelfPairs, T: Array, J: Array, distances: SelfDistances, repulsion: Array, k_s: float
    ) -> float: ...
    def add_posture(self, coordinates: Array, target: Array, k_p: Array, circular: Mask) -> float: ...
    def solve(self, damping: Array, delta: Array) -> None: ...

def difference(planar: bool, circular: Mask, a: Array, b: Array, v: Array) -> None: ...
def integrate(planar: bool, circular: Mask, a: Array, v: Array, out: Array) -> None: ...
def project_rolling(coordinates: Array, iterations: int) -> tuple[float, int]: ...

class Validity:
    def __init__(
        self, bodies: Bodies, parts: Parts, self_pairs: Indices, radius: Array, margin: float, self_margin: float
    ) -> None: ...
    @property
    def checks(self) -> int: ...
    def valid(self, coordinates: Array) -> bool: ...
    def each(self, rows: Array, base: bool, states: npt.NDArray[np.int8]) -> None: ...
    def motion(self, a: Array, b: Array, step: float) -> bool: ...
    def chart(self, row: Array, unit: Array) -> Chart: ...
    def search(
        self,
        ends: Array,
        scale: Array,
        low: Array,
        high: Array,
        period: Array,
        seed: int,
        step: float,
        reach: float,
        checks: int,
        seconds: float,
        tries: int,
    ) -> list[float]: ...

class Chart:
    def motion(self, a: Sequence[float], b: Sequence[float], step: float) -> bool: ...

class SphereFilter:
    """Verdicts (N,) of rows (N, nv): 0 free, 1 touches for certain, 2 undecided; and how many pairs are undecided."""

    def __init__(
        self, bodies: Bodies, parts: Parts, self_pairs: Indices, margin: float, self_margin: float
    ) -> None: ...
    def look(self, rows: Array, verdict: npt.NDArray[np.int8]) -> int: ...

class PathProof:
    """States (N-1,) of the segments between rows (N, nv) with tangents v: 0 proven, 1 not; checks and queries."""

    def __init__(
        self, bodies: Bodies, parts: Parts, self_pairs: Indices, radius: Array, self_radius: Array
    ) -> None: ...
    def prove(
        self,
        rows: Array,
        v: Array,
        clearance: float,
        self_clearance: float,
        depth: int,
        all: bool,
        states: npt.NDArray[np.int8],
    ) -> tuple[int, int]: ...
    def least(self, rows: Array, v: Array, tolerance: float, most: float) -> tuple[float, int, int]: ...

def roll_out(
    start: Array,
    speed: Array,
    first: Array,
    second: Array,
    change: Array,
    rate: Array,
    twist: Array,
    done: Indices,
    pose: Array,
) -> None: ...
def near_discs(
    pose: Array, time: Array, discs: Array, size: Array, lookahead: float, far: float, out: Array
) -> None: ...
def possible_discs(
    pose: Array,
    time: Array,
    discs: Array,
    error: Array,
    middle: Array,
    half: Array,
    low: Array,
    high: Array,
    far: float,
    out: Array,
) -> None: ...
def standing_boxes(
    pose: Array,
    boxes: Array,
    middle: Array,
    half: Array,
    low: Array,
    high: Array,
    least: float,
    far: float,
    out: Array,
) -> None: ...
def travel_at(knots: Array, coefficients: Array, edges: Array, weights: Array | None, s: Array, out: Array) -> None: ...
def lead_base(
    yaw: Array,
    twist: Array,
    shape: Array,
    rate: Array,
    target: Array,
    width: float,
    lever: float,
    rolling: bool,
    largest: float,
    near: float,
    stalled: float,
    iterations: int,
    weights: Array,
) -> None: ...
def fastest(grid: Array, y1: Array, y2: Array, bound: Array, acceleration: Array, start: float, x: Array) -> bool: ...
def braked(grid: Array, y1: Array, y2: Array, acceleration: Array, start: float, part: float, x: Array) -> None: ...
def fill_outlines(
    owner: Indices, low: Array, resolution: float, whose: Indices, reach: Array, at: Array, around: Array
) -> None:
    """Owners (rows, columns) of the cells within half a cell of outlines (K): `whose` (K), how far each reaches (K, D)
    along unit vectors (D, 2) from its place (K, 2). D is a multiple of four; the first vector points along x."""

def clearance_map(taken: Mask, resolution: float, clear: Array) -> None:
    """Distances (rows, columns) to the nearest cell that is taken (rows, columns)."""

def cell_cost(clear: Array, inner: float, comfort: float, narrow: float, cost: Array) -> None:
    """Costs (rows, columns) of cells by their clearances (rows, columns): `narrow` at `inner`, infinite below."""

def cheapest_route(cost: Array, first: int, last: int) -> list[int]:
    """Numbers of the cells of the cheapest path, row by row; none where there is none. Costs (rows, columns) are
    infinite, or within 1e-100 and 1e100 and 10,000 times of each other."""

class RayBodies:
    """Convex bodies that rays are cast against; kinds are those of `elastic_strips.perception.rays`."""

    def __init__(self, kind: Indices, size: Array, start: Indices, planes: Array) -> None: ...
    def place(self, rotation: Array, translation: Array) -> None: ...
    def cast(
        self,
        origin: Array,
        direction: Array,
        reach: float,
        inside: float,
        distance: Array,
        normal: Array | None,
    ) -> None: ...

def fill_holes(ranges: npt.NDArray[np.float32], unit: float, widest: int, out: npt.NDArray[np.float32]) -> None:
    """Ranges (rows, columns) with narrow holes of lost ones filled in, as `filled` of
    `elastic_strips.perception.lost_pixels` has them."""

def count_cells(low: Indices, high: Indices) -> int:
    """Cells in boxes (B, 3) of a grid."""

def grid_boxes(
    low: Indices, high: Indices, cell: float, cells: Array, middles: Array, edges: Array, whole: Array
) -> None:
    """Middles (n, 3) of the cells of boxes (B, 3), the boxes' middles and edges (B, 3), and middle, half size and
    radius (7) of all, as `grid_solid` of `elastic_strips.scene.parts` has them."""

class VolumeMap:
    """Voxels about a robot; see `elastic_strips.perception.volume_map`."""

    def __init__(
        self, blocks: Indices, corner: Indices, cell: float, miss: int, floor: int, top: int, filled: int, emptied: int
    ) -> None: ...
    def roll(self, corner: Indices) -> None: ...
    def hit(self, points: Array, weight: npt.NDArray[np.int8], before: npt.NDArray[np.int8]) -> None: ...
    def carve(
        self,
        clear: npt.NDArray[np.float32],
        camera: bool,
        round: bool,
        scale: Array,
        middle: Array,
        rotation: Array,
        origin: Array,
        nearest: float,
        sure: float,
        exact: float,
    ) -> None: ...
    def look(self, points: Array, known: npt.NDArray[np.int8]) -> None: ...
    def grant(self, points: Array) -> None: ...
    def forget(self, points: Array) -> None: ...
    def changed(self, doubtful: bool) -> Indices: ...
    def boxes(self, block: Indices, doubtful: bool) -> Indices: ...
    def finer_boxes(self, block: Indices, doubtful: bool, fine: VolumeMap) -> Indices: ...
    def count(self, unseen: bool) -> int: ...
