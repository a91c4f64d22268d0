"""Settling: ticks until a strip has converged, and what only they need: on the way there a strip gets no worse."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.collision.strip_certificate import coordinate_clearance
from elastic_strips.scene import Scene
from elastic_strips.validation import check_able, check_choice, check_count

from .forces import add_pieces, add_stretch
from .params import DeformParams, StripParams
from .report import DeformStatus, R, settled_report
from .solver import System, project_rolling
from .strip import Strip
from .workspace import Workspace

_MOST_HALVINGS = 8  # of a step that raises the energy
_ROUNDING_OF_ENERGY = 1e-9  # part of the energy by which a step may raise it
_DAMPING_FACTOR = 0.02  # what a step may not do is seen before it is done
_STRETCH_GAIN, _TAUT_SHARE = 20.0, 0.75  # of segments beyond this part of ``max_spacing``
_STIFF_LAYER_GAIN, _STIFF_LAYER_ROOM = 250.0, 0.004  # [1]; what it adds [m] for the way between two nodes
_FLAT_TICKS, _FLAT_SHARE = 10, 5e-4  # converged: so many ticks that lower the energy by less than this part of it
_CLEARANCE_LOSS = 1e-3  # what a strip may lose of its clearance [m]
_FELT_SHARE = 0.98  # part of the influence distance up to which clearance is kept
Energies = Mapping[str, float]


class TickPolicy:
    """What a tick leaves to whoever asks for it; as it stands here, the control loop's answers.

    Attributes:
        damping_factor: of the damping of a step.
        gives_way: whether a strip without a certificate moves no farther than what is in it asks.
        removes_nodes: whether maintenance may remove nodes.
    """

    damping_factor: float = 1.0
    gives_way: bool = True
    removes_nodes: bool = True

    def add_forces(self, system: System, v: Array) -> None:
        """Add forces of its own to a system, for the segments' differences ``v`` (N−1, nv)."""

    def stiff_layer(self, params: DeformParams) -> tuple[float, float]:
        """Thickness [m] and gain of the stiff repulsive layer."""
        return params.near, params.k_near

    def taken(
        self,
        before: Array,
        after: Array,
        slip: float,
        energies: Energies,
        scene: Scene,
        energy_here: Callable[[], float],
    ) -> tuple[Array, float]:
        """The step that is made: coordinates (N, nv), which are the workspace's then, and the rolling residual [m].

        Args:
            before, after: the step that was solved for; the workspace is at ``after``.
            slip: rolling residual [m] of ``after``.
            energies: potentials by force at ``before``.
            scene: the obstacles.
            energy_here: evaluates the potential of all forces where the workspace is.
        """
        return after, slip

    def to_split(self, scene: Scene) -> Mask | None:
        """(N−1,) segments that need another node besides those without a certificate."""
        return None

    def resampled(self, source: Indices) -> None:
        """Told that the nodes are others now: node i was node ``source[i]`` before, −1 for a new one."""

    def rests(self, still: bool, energies: Energies) -> bool:
        """Whether the strip has converged.

        Args:
            still: whether the last iteration has moved it less than ``rest_step``.
            energies: potentials by force before that iteration.
        """
        return still


class Settler(TickPolicy):
    """Workspace: the policy of ``settle``: no tick raises the energy, and what there was of clearance is kept.

    The stiff layer at the nodes is as thick as the strip's clearance was, and where the strip comes nearer to obstacles
    between two nodes, another one is put in.

    Args:
        work: the deformer's, at the strip's nodes.
        scene: the obstacles, standing still.
        params: of the deformer.
        stiffness: (nv,) of the elastic force; spacing_weight: (nv,) metric of the node spacing.
        rolling: whether wheels have to follow the strip.
    """

    damping_factor = _DAMPING_FACTOR
    gives_way = False
    removes_nodes = False  # who goes would be needed again

    def __init__(
        self,
        work: Workspace,
        scene: Scene,
        params: DeformParams,
        *,
        stiffness: Array,
        spacing_weight: Array,
        rolling: bool,
    ) -> None:
        self._work, self._params, self._space = work, params, work.robot.space
        self._stiffness, self._spacing_weight, self._rolling = stiffness, spacing_weight, rolling
        self._layer = max(work.obstacles.least_clearance(), 0.0) + _STIFF_LAYER_ROOM
        has = coordinate_clearance(work.robot, work.coordinates, scene, tolerance=_CLEARANCE_LOSS / 5.0)
        self._kept = min(has, _FELT_SHARE * params.influence) - _CLEARANCE_LOSS  # clearance [m], between nodes, too
        self._pieces = np.ones(len(work.coordinates) - 1)  # into how many each segment has been divided
        self._dips = False  # whether it is nearer somewhere than it is to keep
        self._energies: list[float] = []  # of the ticks since nodes came

    def add_forces(self, system: System, v: Array) -> None:
        """Divided segments pull no more than they did whole, and long ones do not become longer."""
        add_pieces(system, self._space, v, self._stiffness, self._pieces**1.5)
        taut = _TAUT_SHARE * self._params.max_spacing
        add_stretch(system, self._space, v, self._spacing_weight, stiffness=_STRETCH_GAIN, length=taut)

    def stiff_layer(self, params: DeformParams) -> tuple[float, float]:
        """As thick as the clearance was."""
        return max(params.near, self._layer), max(params.k_near, _STIFF_LAYER_GAIN)

    def taken(
        self,
        before: Array,
        after: Array,
        slip: float,
        energies: Energies,
        scene: Scene,
        energy_here: Callable[[], float],
    ) -> tuple[Array, float]:
        """As much of a step as does not raise the energy; none where nothing does."""
        space, work = self._space, self._work
        part, way, energy = 1.0, space.difference(before, after), sum(energies.values())
        for _ in range(_MOST_HALVINGS):
            if energy_here() <= energy + _ROUNDING_OF_ENERGY * max(energy, 1.0):
                return after, slip
            part *= 0.5
            after, slip = space.integrate(before, part * way), 0.0
            np.clip(after, space.lower, space.upper, out=after)
            if self._rolling:
                after, slip = project_rolling(space, after)
            work.replace(after, scene)
        work.replace(before, scene)
        return before, 0.0

    def to_split(self, scene: Scene) -> Mask | None:
        """Segments on which the strip may be nearer to obstacles than it is to keep."""
        params, work = self._params, self._work
        nearer: Mask = np.zeros(len(work.coordinates) - 1, dtype=bool)
        if self._kept > params.clearance:
            v = self._space.difference(work.coordinates[:-1], work.coordinates[1:])
            nearer = ~work.certifier.certify(
                work.kin, v, clearance=self._kept, self_clearance=params.self_clearance, scene=scene
            ).segments
        self._dips = bool(nearer.any())
        return nearer

    def resampled(self, source: Indices) -> None:
        """Each piece of a divided segment counts as one of so many."""
        old = np.maximum.accumulate(source)[:-1]  # which segment each was a part of
        self._energies = []
        self._pieces = (self._pieces * np.bincount(old, minlength=len(self._pieces)))[old]

    def rests(self, still: bool, energies: Energies) -> bool:
        """Also where the energy has all but ceased to fall: where obstacles' faces meet, steps go to and fro."""
        return not self._dips and (still or self._flat(sum(energies.values())))

    def _flat(self, energy: float) -> bool:
        self._energies.append(energy)
        if len(self._energies) <= _FLAT_TICKS:
            return False
        return self._energies[-1 - _FLAT_TICKS] - energy < _FLAT_SHARE * energy


def check_ending(
    params: StripParams, until: str | Callable[[R], bool], max_ticks: int | None, watch: Callable[[R], object] | None
) -> int:
    """Check what ``settle`` is given; returns the most ticks that it makes.

    Raises:
        ParameterError: ``until`` or ``max_ticks`` outside its range.
    """
    if not callable(until):
        check_choice("until", until, ("rest", "certified"))
    check_able("watch", watch)
    return params.max_ticks if max_ticks is None else check_count("max_ticks", max_ticks, low=1)


def run_ticks(
    tick: Callable[[Strip], R],
    strip: Strip,
    *,
    limit: int,
    until: str | Callable[[R], bool],
    watch: Callable[[R], object] | None,
    joined: Callable[[R, R], R] | None = None,
) -> R:
    """Ticks until the strip has converged, or ``until`` says so, or ``limit`` of them are over; the report of all.

    Args:
        tick: one tick of a strip.
        strip: where to start.
        limit, until, watch: as checked by :func:`check_ending`.
        joined: a tick's report with what it is to have of the one of all ticks before.
    """
    timings: dict[str, float] = {}
    seconds, queries, ticks = 0.0, 0, 0
    last: R | None = None
    while True:
        report = tick(strip)
        strip, ticks = report.strip, ticks + 1
        seconds += report.seconds
        queries += report.queries
        for phase, value in report.timings.items():
            timings[phase] = timings.get(phase, 0.0) + value
        if watch is not None:
            watch(report)
        done = until(report) if callable(until) else until == "certified" and report.usable
        last = report if last is None or joined is None else joined(report, last)
        if report.status is not DeformStatus.DEFORMING or done or ticks >= limit:
            return settled_report(last, ticks, timings, seconds, queries)
