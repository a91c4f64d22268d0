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
"""Of the headers that it was compiled with."""

constants: dict[str, float | tuple[float, ...]]
"""Of `elastic_strips.constants`, as it was compiled with."""

class Solid:
    pass

def primitive(kind: str, size: Sequence[float], swept: float) -> Solid: ...
def convex(points: Array, triangles: npt.NDArray[np.uint32], swept: float) -> Solid: ...
def block(sides: Array, at: Array) -> Solid: ...

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
        self, solids: Sequence[Solid], rotation: Array, translation: Array, box_center: Array, box_half: Array
    ) -> None: ...

class Moving:
    def __init__(self, parts: Parts, shift: Array, uncertainty: Array, mover: Indices) -> None: ...

class Distances:
    def __init__(
        self, parts: Parts, bound: Array, since: Array, exact: Array, direction: Array, witness: Array, limit: Array
    ) -> None: ...

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
        self, T: Array, coordinates: Array, before: Array, radius: Array, reach: float, distances: SelfDistances
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
    def __init__(self, bodies: Bodies, parts: Parts, self_pairs: Indices, radius: Array, margin: float) -> None: ...
    @property
    def checks(self) -> int: ...
    def valid(self, coordinates: Array) -> bool: ...
    def motion(self, a: Array, b: Array, step: float) -> bool: ...
    def chart(self, row: Array, unit: Array) -> Chart: ...

class Chart:
    def motion(self, a: Sequence[float], b: Sequence[float], step: float) -> bool: ...

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
