"""Deformer: the control tick. Strip and scene in, certified strip and report out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.collision import Certificate, ProtectiveHulls
from elastic_strips.collision.strip_certificate import coordinate_clearance, protective_hulls
from elastic_strips.errors import ParameterError
from elastic_strips.ownership import exclusive
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.validation import check_type

from .base_deformer import BaseDeformer, NodePredictor, TickResult
from .constraint import ConstraintForce, OrientationConstraint
from .forces import (
    add_elastic,
    add_joint_limits,
    add_obstacle_repulsion,
    add_pieces,
    add_posture,
    add_self_repulsion,
    add_stretch,
    repulsive_magnitude,
)
from .params import DeformParams
from .recovery import Intrusions, hold_joints, own_distances_to_keep
from .report import SLIP_LIMIT, DeformReport, DeformStatus, StripForces, tick_status
from .resampling import kept_segments, node_spacing, resample
from .solver import BandedSolver, System, project_rolling
from .strip import Strip

_STEP_LEVER = 0.4  # an angle counts at least so many metres a radian in the bound of a step
_SPARE = 0.6  # part of ``max_spacing`` up to which segments with much room about them are joined
_NEEDED_FOR = 8  # rounds of maintenance in which no node is removed again, where removing cost the certificate
_HALVINGS, _SAME = 8, 1e-9  # of a step that raises the energy in ``settle``, and by how much it may for rounding
_BOLD = 0.02  # of the damping, in ``settle``: what a step may not do there is seen before it is done
_STRETCH, _TAUT = 20.0, 0.75  # gain of segments beyond this part of ``max_spacing``, in ``settle``
_FIRM, _ROOM = 250.0, 0.004  # gain of the stiff layer in ``settle``, and what it adds [m] for the way between two nodes
_FLAT, _SLIGHT = 10, 5e-4  # at rest in ``settle``: so many ticks that lower the energy by less than this part of it
_LOSS = 1e-3  # what a strip may lose of its clearance [m] in ``settle``
_FELT = 0.98  # part of the influence distance up to which clearance is kept in ``settle``
_HOLDS = 2  # times that a step is solved again for the robot's own links
_SELF_REACH = 0.02  # distances between the robot's own links are exact below this [m], or further


class Deformer(BaseDeformer[DeformReport]):
    """Deforms strips of one robot; owns mutable buffers, so one per thread.

    Give each report's strip back to the next :meth:`step`: then only what moved is computed anew. Forces act at the
    links' witness points, an update is one implicit step, and the rolling constraint holds exactly afterwards.

    Args:
        robot: the robot of the strips.
        params: parameters.
        constraint: a constraint that the strips are to satisfy as well.

    Attributes:
        constraint: the force of the constraint, with its switch ``active``, or None.
        spacing_weight: (nv,) metric in which node spacing is measured [m²/m² or m²/rad²].

    Raises:
        ParameterError: ``params`` of another preset.
        RobotError: a constraint for a frame that the robot does not have.
    """

    def __init__(
        self, robot: RobotModel, params: DeformParams | None = None, *, constraint: OrientationConstraint | None = None
    ) -> None:
        params = DeformParams() if params is None else params
        check_type("params", params, DeformParams, ParameterError)
        check_type("constraint", constraint, OrientationConstraint, none=True)
        self_reach = max(params.self_influence, _SELF_REACH, 2.0 * params.self_clearance)
        super().__init__(
            robot, params, reach=params.influence, self_reach=self_reach, self_influence=params.self_influence
        )
        self.params: DeformParams = params
        self.constraint: ConstraintForce | None = None if constraint is None else ConstraintForce(robot, constraint)
        space = robot.space
        b = space.base_nv
        lever = np.ones(space.nv)
        lever[b:] = params.joint_lever
        lever[b:][robot.tree.sliding] = 1.0
        if b:
            lever[2] = params.yaw_lever
        self.spacing_weight: Array = lever**2
        self._step_lever = np.maximum(lever, _STEP_LEVER)
        self._stiffness = params.k_c * self.spacing_weight
        self._damping = params.damping * self.spacing_weight
        self._rolling = robot.base_kind is BaseKind.DIFF_DRIVE
        if self._rolling:
            self._stiffness[1] += params.rolling_stiffness
        self._posture = np.zeros(space.nv)
        self._posture[b:] = params.k_posture * self.spacing_weight[b:]
        self._line, self._line_ends = np.zeros((0, space.nv)), np.zeros((2, space.nv))
        self._solver = BandedSolver()
        self._system = System(0, space.nv)
        self._proven: bool | None = False  # whether the current nodes could be driven; None where they may be
        self._scene: Scene | None = None
        self._trust = 1.0
        self._floor = 0.0  # clearance [m] that ``settle`` began with
        self._kept = 0.0  # clearance [m] that ``settle`` keeps between nodes, too
        self._dips = False  # whether it is not kept yet
        self._pieces = np.ones(0)  # (N−1,) into how many ``settle`` has divided each segment
        self._fallen: list[float] = []  # energies in ``settle`` since nodes came
        self._needed = 0  # rounds of maintenance that remove no node
        self._detail = False  # whether forces are wanted for the report
        self._retries = True  # whether half a step is tried

    @exclusive
    def keep_clearance(self, clearance: float, self_clearance: float | None = None) -> None:
        """Keep another clearance [m] to obstacles from now on, and if given another one between the robot's own links.

        Raises:
            ParameterError: a clearance is negative, or not below the influence distance; or that of the own links is
                larger than the one that the deformer was made for.
        """
        own = self.params.self_clearance if self_clearance is None else self_clearance
        params = self.params.replaced(clearance=clearance, self_clearance=own)
        most = self.workspace.most_self_clearance
        if params.self_clearance > most:
            raise ParameterError(
                f"self_clearance={own:g} m is more than the {most:g} m that this deformer was made for; "
                "make another one"
            )
        self.params = self.workspace.params = params

    @exclusive
    def step(
        self,
        strip: Strip,
        scene: Scene,
        *,
        budget: float | None = None,
        detail: bool = False,
        nodes: bool = True,
        retry: bool = True,
        prediction: NodePredictor | None = None,
    ) -> DeformReport:
        """One control tick: deform the strip away from the obstacles and certify it.

        Args:
            strip: the strip of the last report, or a new one of this robot.
            scene: snapshot of the obstacles.
            budget: time [s] to spend; iterations go on while another one fits, and it is exceeded by at most one.
                None makes exactly one iteration. Nodes are not resampled in a tick whose budget is already spent.
            detail: whether to add forces and protective hulls to the report, to look at.
            nodes: whether nodes may be inserted and removed.
            retry: whether half a step is tried where a full one would lose the certificate; otherwise the strip stays,
                and the next tick's step is the shorter one.
            prediction: where moving obstacles will be when the nodes are reached; where None, they count as they stand.

        Raises:
            ConfigurationError: the strip belongs to another robot.
            ParameterError: a budget that is not a positive number.
        """
        work = self.workspace
        already, known = work.queries, work.holds(strip)
        self._detail, self._retries = detail, retry
        self._load(strip, scene, prediction, budget=budget, to_move=True)
        self._proven = self._to_keep(strip, scene, known)
        result = self._iterations(scene, budget)
        if nodes and (budget is None or self.clock.elapsed <= budget):
            result = self._resample(scene, result)
        return self._report(scene, result, work.queries - already, detail)

    @exclusive
    def certify(self, strip: Strip, scene: Scene) -> Certificate:
        """Certify a strip as it is, without moving it."""
        self._proven, self._scene = False, None
        return super().certify(strip, scene)

    @exclusive
    def reset(self) -> None:
        """Forget all that is kept from tick to tick, as is needed after an exception."""
        self._proven, self._scene, self._trust, self._needed = False, None, 1.0, 0
        super().reset()

    @exclusive
    def carry(self, strip: Strip, coordinates: Array, source: Indices) -> Strip:
        """A strip made of the last one's nodes and new ones; distances of the old nodes are carried over.

        Args:
            strip: the strip of the last report.
            coordinates: (M, nv) the new nodes.
            source: (M,) which node of ``strip`` each was; −1 for a new one.
        """
        self._check(strip)
        ends = self.robot.space.from_coordinates(coordinates[[0, -1]])
        for end in (0, -1):
            if source[end] >= 0:
                ends[end] = strip.q[source[end]]
        new = Strip.from_coordinates(self.robot, coordinates, ends=ends)
        self.workspace.carry(strip, new, source)
        return new

    # the parts of a tick

    def _begin(self, strip: Strip, scene: Scene) -> None:
        """What lies between the strip and the obstacles must not become less: the stiff layer at the nodes is that
        thick, and where the strip comes nearer between two of them, another is put in."""
        self._load(strip, scene)
        work = self.workspace
        self._floor = max(work.obstacles.least_clearance(), 0.0) + _ROOM
        has = coordinate_clearance(self.robot, work.coordinates, scene, tolerance=_LOSS / 5.0)
        self._kept = min(has, _FELT * self.params.influence) - _LOSS
        self._pieces = np.ones(len(strip) - 1)
        self._fallen = []

    def _nearer(self, scene: Scene) -> Mask:
        """(N−1,) segments on which the strip may be nearer to obstacles than ``settle`` is to keep."""
        params, work = self.params, self.workspace
        if self._kept <= params.clearance:
            return np.zeros(len(work.coordinates) - 1, dtype=bool)
        v = self.robot.space.difference(work.coordinates[:-1], work.coordinates[1:])
        found = work.certifier.certify(
            work.kin, v, clearance=self._kept, self_clearance=params.self_clearance, scene=scene
        )
        return ~found.segments

    def _to_keep(self, strip: Strip, scene: Scene, known: bool) -> bool | None:
        """Whether the strip has a certificate that must not be lost; None where it may have one: no node is too near
        to anything, and what is between them is looked at where the step has lost it. ``known`` says that it is the
        last report's strip."""
        work, params = self.workspace, self.params
        if known and self._proven:
            return not work.obstacles.nearer_than(params.clearance)  # else the scene has taken it already
        if known and (scene is self._scene or work.prediction is not None):
            return False
        if float(strip.lateral_slip.max(initial=0.0)) > SLIP_LIMIT or work.obstacles.nearer_than(params.clearance):
            return False
        return False if work.self_pairs.nearer_than(params.self_clearance) else None

    def _iterate(self, scene: Scene) -> TickResult:
        """One iteration; where the current nodes are proven, or may be, it does not lose the proof without need."""
        work, keep = self.workspace, self._proven is not False
        before = work.coordinates.copy()
        if not keep:
            self._trust = 1.0
        if keep or self._descends:
            coordinates, slip, energies, forces = self._update()
        else:
            intrusions = Intrusions.of(work.kin, work.obstacles, self.params.clearance)
            coordinates, slip, energies, forces = self._update(intrusions)
            coordinates, slip = self._apart(before, intrusions, coordinates, slip)
        moved = float(np.abs(coordinates - before).max(initial=0.0))
        work.replace(coordinates, scene)
        if self._descends:
            coordinates, slip = self._lower(before, coordinates, slip, sum(energies.values()), scene)
            moved = float(np.abs(coordinates - before).max(initial=0.0))
        result = TickResult(work.certify(scene), slip, moved, energies, forces)
        if keep and not _is_proven(result):
            result = self._shortened(before, coordinates, scene, result)
        else:
            self._trust = min(1.0, 2.0 * self._trust)
        self._proven = _is_proven(result)
        return result

    def _apart(self, before: Array, intrusions: Intrusions, coordinates: Array, slip: float) -> tuple[Array, float]:
        """A broken strip's step, with its rolling residual: where it would bring the robot's own links together it is
        solved again with the joints of those nodes stiff, so that the base gives way instead.

        Links meet by the joints alone, and beyond the self influence distance no force tells of it: an arm that an
        obstacle pushes would go through the body, and come back over many ticks.
        """
        work, b = self.workspace, self.robot.space.base_nv
        pairs = work.self_pairs
        if b == 0 or len(pairs.pairs) == 0:
            return coordinates, slip
        least, held = own_distances_to_keep(pairs, self.params.self_clearance), np.zeros(len(before), dtype=bool)
        for _ in range(_HOLDS):
            work.try_joints(coordinates)
            lost = (pairs.bound < least).any(axis=1) & ~held
            if not lost.any():
                break
            held |= hold_joints(self._system, b, lost)
            coordinates, slip = self._stepped(before, intrusions)
        return coordinates, slip

    def _lower(
        self, before: Array, coordinates: Array, slip: float, energy: float, scene: Scene
    ) -> tuple[Array, float]:
        """As much of a step as does not raise the energy, with its rolling residual; none where nothing does."""
        space, work = self.robot.space, self.workspace
        part, way = 1.0, space.difference(before, coordinates)
        for _ in range(_HALVINGS):
            self._assemble()
            if sum(self._system.energies.values()) <= energy + _SAME * max(energy, 1.0):
                return coordinates, slip
            part *= 0.5
            coordinates, slip = space.integrate(before, part * way), 0.0
            np.clip(coordinates, space.lower, space.upper, out=coordinates)
            if self._rolling:
                coordinates, slip = project_rolling(space, coordinates)
            work.replace(coordinates, scene)
        work.replace(before, scene)
        return before, 0.0

    def _assemble(self) -> StripForces:
        """Forces, matrix and energies at the current nodes, in the system; external forces, to look at."""
        params, space, kin = self.params, self.robot.space, self.workspace.kin
        obstacles, self_pairs = self.workspace.obstacles, self.workspace.self_pairs
        n = kin.n
        coordinates = kin.coordinates[:n]
        if self._system.force.shape[0] != n:
            self._system = System(n, space.nv)
        system = self._system
        system.clear()
        v = space.difference(coordinates[:-1], coordinates[1:])
        add_elastic(system, space, v, self._stiffness)
        near, k_near = params.near, params.k_near
        if self._descends:
            add_pieces(system, space, v, self._stiffness, self._pieces**1.5)
            taut = _TAUT * params.max_spacing
            add_stretch(system, space, v, self.spacing_weight, stiffness=_STRETCH, length=taut)
            near, k_near = max(near, self._floor), max(k_near, _FIRM)
        near = min(near, params.influence)
        add_obstacle_repulsion(system, kin, obstacles, k_r=params.k_r, k_near=k_near, near=near)
        forces = StripForces.none()
        if self._detail:
            contacts = obstacles.contacts()
            push = repulsive_magnitude(contacts.distance, params.k_r, params.influence)
            forces = StripForces(contacts.witness, push[:, None] * contacts.direction)
        add_self_repulsion(system, kin, self_pairs, k_s=params.k_self)
        add_joint_limits(
            system, space, coordinates, k_l=params.k_limit * params.joint_lever**2, margin=params.limit_margin
        )
        if self.constraint is not None:
            self.constraint.push(system, kin)
        if params.k_posture > 0.0:
            add_posture(system, space, coordinates, self._straight(coordinates), k_p=self._posture)
        self.clock.mark("forces")
        return forces

    def _update(self, intrusions: Intrusions | None = None) -> tuple[Array, float, dict[str, float], StripForces]:
        """Where the forces move the nodes: coordinates (N, nv), rolling residual [m], energies, external forces."""
        forces = self._assemble()
        moved, residual = self._stepped(self.workspace.coordinates, intrusions)
        return moved, residual, dict(self._system.energies), forces

    def _stepped(self, coordinates: Array, intrusions: Intrusions | None) -> tuple[Array, float]:
        """Where the system's step leads from nodes (N, nv), no farther than needed where something is in the strip; and
        the rolling residual [m]."""
        params, space = self.params, self.robot.space
        delta = self._solver.solve(self._system, _BOLD * self._damping if self._descends else self._damping)
        largest = float(np.abs(delta * self._step_lever).max(initial=0.0))
        limit = self._trust * params.max_step
        if largest > limit:
            delta *= limit / largest
        if intrusions is not None:
            delta *= intrusions.share(delta)
        self.clock.mark("solve")
        moved = space.integrate(coordinates, delta)
        np.clip(moved, space.lower, space.upper, out=moved)
        residual = 0.0
        if self._rolling:
            moved, residual = project_rolling(space, moved)
        self.clock.mark("rolling")
        return moved, residual

    def _straight(self, coordinates: Array) -> Array:
        """(N, nv) as many nodes on the straight line between the ends."""
        ends = coordinates[[0, -1]]
        if len(self._line) != len(coordinates) or not np.array_equal(self._line_ends, ends):
            part = np.linspace(0.0, 1.0, len(coordinates))
            self._line, self._line_ends = self.robot.space.interpolate(ends[:1], ends[1:], part), ends
        return self._line

    def _shortened(self, before: Array, coordinates: Array, scene: Scene, full: TickResult) -> TickResult:
        """A step must not lose the certificate where a shorter one, or none, keeps it; the next ones are shorter too.

        The strip does not count as at rest then: ``moved`` stays that of the full step.
        """
        space, work = self.robot.space, self.workspace
        self._trust = max(0.5 * self._trust, 0.05)
        if self._retries:
            half, slip = space.integrate(before, 0.5 * space.difference(before, coordinates)), 0.0
            if self._rolling:
                half, slip = project_rolling(space, half)
            work.replace(half, scene)
            certificate = work.certify(scene)
            if certificate.certified and slip <= SLIP_LIMIT:
                return replace(full, certificate=certificate, slip=slip)
            self._trust = max(0.5 * self._trust, 0.05)
        work.replace(before, scene)
        stays = work.certify(scene)
        if stays.certified:
            return replace(full, certificate=stays, slip=0.0)
        self._trust = 1.0
        work.replace(coordinates, scene)  # the obstacle came too near: the full step leads away
        return full

    def _resample(self, scene: Scene, result: TickResult) -> TickResult:
        params, space, work = self.params, self.robot.space, self.workspace
        self._needed = max(self._needed - 1, 0)
        proven = _is_proven(result)
        removes = not self._descends and (self._needed == 0 or not proven)  # who goes would be needed again
        spacing = node_spacing(space, work.coordinates, self.spacing_weight)
        split = None if work.prediction else ~result.certificate.segments  # what moves on will be gone
        self._dips = False
        if split is not None and self._descends:
            nearer = self._nearer(scene)
            self._dips = bool(nearer.any())
            split |= nearer
        edit = resample(
            space,
            work.coordinates,
            spacing,
            max_spacing=params.max_spacing,
            min_spacing=params.min_spacing if removes else 0.0,
            split=split,
            spare=self._spare(spacing) if removes and proven else None,
            max_nodes=params.max_nodes,
        )
        self.clock.mark("maintenance")
        if edit is None:
            return result
        before, slip = work.coordinates.copy(), result.slip
        coordinates, source = edit
        if self._rolling:  # a removed node joins two arcs into one that must be drivable again
            coordinates, slip = project_rolling(space, coordinates)
        if self._descends:
            old = np.maximum.accumulate(source)[:-1]  # which segment each was a part of
            self._fallen = []
            self._pieces = (self._pieces * np.bincount(old, minlength=len(self._pieces)))[old]
        known = None
        if work.prediction is None:  # what moves on is elsewhere when other nodes are reached
            known = kept_segments(before, coordinates, source, result.certificate.segments)
        work.edit(coordinates, source, scene)
        edited = replace(result, certificate=work.certify(scene, known), slip=slip)
        if proven and not _is_proven(edited):  # the removed nodes were needed
            self._needed = _NEEDED_FOR
            work.replace(before, scene)
            return replace(result, certificate=work.certify(scene))
        return edited

    def _spare(self, spacing: Array) -> Mask | None:
        """(N,) nodes that a proven strip does not need: it was divided there while something was in its way, and there
        is more room about them now than their neighbours are apart."""
        joined = spacing[:-1] + spacing[1:]
        close = joined < _SPARE * self.params.max_spacing
        if not close.any():
            return None
        free = self.workspace.obstacles.clearance().min(axis=1, initial=np.inf) - self.params.clearance
        spare = np.zeros(len(free), dtype=bool)
        spare[1:-1] = close & (np.minimum(np.minimum(free[:-2], free[2:]), free[1:-1]) > joined)
        return spare

    def _flat(self, energy: float) -> bool:
        """Whether the energy has all but ceased to fall: where obstacles' faces meet, steps go to and fro for long."""
        self._fallen.append(energy)
        return len(self._fallen) > _FLAT and self._fallen[-1 - _FLAT] - energy < _SLIGHT * energy

    def _hulls(self) -> ProtectiveHulls:
        work, cap = self.workspace, self.params.influence
        points = self.robot.control_point_set
        local = np.einsum("cji,cj->ci", self.robot.tree.align[points.joint], points.local)
        free = np.minimum(work.obstacles.clearance().min(axis=1), cap)
        world = work.kin.points(points.joint, local)
        return protective_hulls(world, np.repeat(free[:, None], len(points.names), axis=1), cap=cap)

    def _report(self, scene: Scene, result: TickResult, queries: int, detail: bool) -> DeformReport:
        hulls = self._hulls() if detail else None
        rest, wide = result.moved < self.params.rest_step, ""
        if self._descends:
            rest = not self._dips and (rest or self._flat(sum(result.energies.values())))
        if rest:
            coordinates = self.workspace.coordinates
            spacing = float(node_spacing(self.robot.space, coordinates, self.spacing_weight).max())
            wide = _wide_spacing(spacing, len(coordinates), self.params)
            rest = not wide or len(coordinates) >= self.params.max_nodes  # else there are nodes to be put in
        status, reason = tick_status(result.certificate, rest, wide)
        if result.slip > SLIP_LIMIT:
            status = DeformStatus.BROKEN if rest else DeformStatus.DEFORMING
            reason = f"a segment slips sideways by {result.slip:.2e} m, more than {SLIP_LIMIT:g} m"
        report = self._reported(DeformReport, scene, result, queries, detail, status=status, reason=reason, hulls=hulls)
        self._proven, self._scene = _is_proven(result), scene
        if self.constraint is None:
            return report
        return replace(report, constraint_errors=self.constraint.errors(self.workspace.kin))


def _is_proven(result: TickResult) -> bool:
    """Whether the result of a tick could be driven: certified, and drivable by the wheels."""
    return result.certificate.certified and result.slip <= SLIP_LIMIT


def _wide_spacing(spacing: float, nodes: int, params: DeformParams) -> str:
    """A phrase that says how far apart nodes are, if that is more than ``max_spacing``; else ""."""
    if spacing <= params.max_spacing * (1.0 + 1e-6):
        return ""
    full = f", because there are max_nodes={params.max_nodes}" if nodes >= params.max_nodes else ""
    return f"; its nodes are up to {spacing:.3g} m apart, more than max_spacing={params.max_spacing:g} m{full}"
