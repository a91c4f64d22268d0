"""Deformer: the control tick. Strip and scene in, certified strip and report out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.collision import Certificate, ProtectiveHulls
from elastic_strips.collision.strip_certificate import protective_hulls
from elastic_strips.errors import ParameterError
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.validation import check_type, named_arguments

from .constraint import AxisConstraint, ConstraintForce
from .followed import FollowedPath
from .forces import FORCES, Acting, repulsive_magnitude
from .params import DeformParams
from .recovery import Intrusions, hold_joints, own_distances_to_keep
from .report import SLIP_LIMIT, DeformReport, DeformStatus, StripForces, tick_status
from .resampling import kept_segments, node_spacing, resample
from .settling import Settler, TickPolicy, check_ending, run_ticks
from .solver import BandedSolver, System, project_rolling
from .strip import Strip
from .workspace import NodePredictor, PhaseClock, TickResult, Workspace

_STEP_LEVER = 0.4  # an angle counts at least so many metres a radian in the bound of a step
_JOINED_SPACING_SHARE = 0.6  # part of ``max_spacing`` up to which segments with much room about them are joined
_KEPT_ROUNDS = 8  # rounds of maintenance in which no node is removed again, where removing cost the certificate
_MOST_HOLDS = 2  # times that a step is solved again for the robot's own links
_SELF_REACH = 0.02  # distances between the robot's own links are exact below this [m], or further


class _Proof(Enum):
    """Whether the current nodes have a certificate, which an iteration does not lose without need.

    ``POSSIBLE``: no node is too near to anything, and what is between them is looked at where a step has lost it.
    """

    NONE = 0
    POSSIBLE = 1
    KNOWN = 2


@dataclass(frozen=True, slots=True, eq=False)
class _Request:
    """What is asked of a tick.

    Attributes:
        scene: the obstacles.
        policy: of whoever asks.
        detail: whether forces and protective hulls are wanted for the report.
        retry: whether half a step is tried where a whole one would lose the certificate.
    """

    scene: Scene
    policy: TickPolicy
    detail: bool = False
    retry: bool = True


_CONTROL = TickPolicy()


class Deformer(OneThread):
    """Deforms strips of one robot; owns mutable buffers, so one per thread.

    Give each report's strip back to the next :meth:`step`: then only what moved is recomputed. Forces act at the
    links' witness points, an update is one implicit step, and the rolling constraint holds exactly afterwards.

    Args:
        robot: the robot of the strips.
        params: parameters.
        constraint: a constraint that the strips are to satisfy as well. What it looks at is taken from each tick's
            scene, where the prediction has it when a node is reached.

    Attributes:
        workspace: what is known of the current nodes.
        constraint: the same with its switch ``active``, or None.
        path: path that the base is drawn to, or None.
        spacing_weight: (nv,) metric in which node spacing is measured [m²/m² or m²/rad²].

    Raises:
        ParameterError: ``params`` of another preset.
        RobotError: a constraint for a frame that the robot does not have.

    Examples:
        >>> robot = es.load_robot("silvermate")
        >>> pushed = es.Box((0.6, 0.6, 1.4), at=(1.5, 0.1, 0.7), motion=es.Twist(linear=(0.0, 0.2, 0.0)))
        >>> scene = es.Scene([pushed])
        >>> strip = es.plan(robot, scene, robot.home(x=-1.0), robot.home(x=4.0))
        >>> deformer = es.Deformer(robot)
        >>> report = deformer.settle(strip, scene)
        >>> for tick in range(5):  # with the newest snapshot of the scene
        ...     report = deformer.step(report.strip, scene.at(0.05 * tick))
        >>> report.certified
        True
    """

    @named_arguments
    def __init__(
        self, robot: RobotModel, params: DeformParams | None = None, *, constraint: AxisConstraint | None = None
    ) -> None:
        params = DeformParams() if params is None else params
        check_type("params", params, DeformParams, ParameterError)
        check_type("constraint", constraint, AxisConstraint, none=True)
        self_reach = max(params.self_influence, _SELF_REACH, 2.0 * params.self_clearance)
        self.workspace: Workspace = Workspace(
            robot,
            params,
            reach=params.influence,
            self_reach=self_reach,
            self_influence=params.self_influence,
            self_reach_eased=True,
        )
        self.share_with(self.workspace)
        self.robot: RobotModel = robot
        self.clock: PhaseClock = self.workspace.clock
        self._params: DeformParams = params
        self.constraint: ConstraintForce | None = None if constraint is None else ConstraintForce(robot, constraint)
        if self.constraint is not None:
            self.share_with(self.constraint)
        self.path: FollowedPath | None = None
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
        self._proof = _Proof.NONE
        self._scene: Scene | None = None
        self._trust = 1.0
        self._needed = 0  # rounds of maintenance that remove no node

    @property
    def params(self) -> DeformParams:
        """The parameters; other ones need another deformer, but for the clearances (:meth:`keep_clearance`)."""
        return self._params

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
        self._params = self.workspace.params = params

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
        asked = _Request(scene, _CONTROL, detail, retry)
        return self._tick(strip, asked, budget=budget, nodes=nodes, prediction=prediction)

    @exclusive
    def settle(
        self,
        strip: Strip,
        scene: Scene,
        *,
        max_ticks: int | None = None,
        until: str | Callable[[DeformReport], bool] = "rest",
        watch: Callable[[DeformReport], object] | None = None,
        detail: bool = False,
    ) -> DeformReport:
        """Ticks until the strip has converged, or is certified, or ``max_ticks`` are over.

        Until they converge, strips get no worse: no tick raises their energy, but for nodes that come or go, and what
        they had of clearance a stiff layer keeps. One that is certified when the ticks are over, and not converged, is
        ``DEFORMING``.

        Args:
            strip: where to start.
            scene: the obstacles, standing still.
            max_ticks: at most this many ticks; the parameter's value where None.
            until: ``"rest"``, or ``"certified"`` to stop at the first certified strip; or a function of a tick's report
                that says whether to stop.
            watch: called with the report of every tick.
            detail: as in :meth:`step`, for every report.

        Returns:
            The last tick's report, with ``ticks`` counted and ``timings`` summed; ``BROKEN`` where it ended without a
            certificate.

        Raises:
            ConfigurationError: the strip belongs to another robot.
            ParameterError: ``until`` or ``max_ticks`` outside its range.
        """
        limit, policy = check_ending(self.params, until, max_ticks, watch), _CONTROL
        if until == "rest":
            self.workspace.begin(strip, scene)
            policy = Settler(
                self.workspace,
                scene,
                self.params,
                stiffness=self._stiffness,
                spacing_weight=self.spacing_weight,
                rolling=self._rolling,
            )
        asked = _Request(scene, policy, detail)
        return run_ticks(lambda strip: self._tick(strip, asked), strip, limit=limit, until=until, watch=watch)

    @exclusive
    def certify(self, strip: Strip, scene: Scene) -> Certificate:
        """Certify a strip as it is, without moving it.

        Raises:
            ConfigurationError: the strip belongs to another robot.
        """
        self._proof, self._scene = _Proof.NONE, None
        self.workspace.begin(strip, scene)
        return self.workspace.certify(scene)

    @exclusive
    def assess(
        self, strip: Strip, scene: Scene, *, detail: bool = False, prediction: NodePredictor | None = None
    ) -> DeformReport:
        """Report on a strip as it is: certificate, clearance, hulls; nothing moves.

        Args:
            strip, scene, detail: as in :meth:`step`.
            prediction: where moving obstacles will be when the nodes are reached; as they stand where None.

        Raises:
            ConfigurationError: the strip belongs to another robot.
        """
        self.workspace.begin(strip, scene, prediction)
        if self.constraint is not None:
            self.constraint.see(scene, prediction)
        slip = float(strip.lateral_slip.max(initial=0.0)) if self._rolling else 0.0
        result = TickResult(self.workspace.certify(scene), slip, 0.0, {}, StripForces.none())
        return self._report(_Request(scene, _CONTROL, detail), result, 0)

    @exclusive
    def reset(self) -> None:
        """Forget all that is kept from tick to tick, as is needed after an exception."""
        self._proof, self._scene, self._trust, self._needed = _Proof.NONE, None, 1.0, 0
        self.workspace.reset()

    @exclusive
    def carry(self, strip: Strip, coordinates: Array, source: Indices) -> Strip:
        """A strip made of the last one's nodes and new ones; distances of the old nodes are carried over.

        Args:
            strip: the strip of the last report.
            coordinates: (M, nv) the new nodes.
            source: (M,) which node of ``strip`` each was; −1 for a new one.
        """
        self.workspace.check(strip)
        ends = self.robot.space.from_coordinates(coordinates[[0, -1]])
        for end in (0, -1):
            if source[end] >= 0:
                ends[end] = strip.q[source[end]]
        new = Strip.from_coordinates(self.robot, coordinates, ends=ends)
        self.workspace.carry(strip, new, source)
        return new

    # the parts of a tick

    def _tick(
        self,
        strip: Strip,
        asked: _Request,
        *,
        budget: float | None = None,
        nodes: bool = True,
        prediction: NodePredictor | None = None,
    ) -> DeformReport:
        work = self.workspace
        already, known = work.queries, work.holds(strip)
        work.begin(strip, asked.scene, prediction, budget=budget, to_move=True)
        if self.constraint is not None:
            self.constraint.see(asked.scene, prediction)
        self._proof = self._to_keep(strip, asked.scene, known)
        result = work.iterate(lambda: self._iterate(asked), budget)
        if nodes and (budget is None or self.clock.elapsed <= budget):
            result = self._resample(asked, result)
        return self._report(asked, result, work.queries - already)

    def _to_keep(self, strip: Strip, scene: Scene, known: bool) -> _Proof:
        """What is known of the certificate of a strip; ``known`` says that it is the last report's."""
        work, params = self.workspace, self.params
        if known and self._proof is _Proof.KNOWN:  # unless the scene has taken it already
            return _Proof.NONE if work.obstacles.nearer_than(params.clearance) else _Proof.KNOWN
        if known and (scene is self._scene or work.prediction is not None):
            return _Proof.NONE
        if float(strip.lateral_slip.max(initial=0.0)) > SLIP_LIMIT or work.obstacles.nearer_than(params.clearance):
            return _Proof.NONE
        return _Proof.NONE if work.self_pairs.nearer_than(params.self_clearance) else _Proof.POSSIBLE

    def _iterate(self, asked: _Request) -> TickResult:
        """One iteration; where the current nodes are proven, or may be, it does not lose the proof without need."""
        work, keep, policy, scene = self.workspace, self._proof is not _Proof.NONE, asked.policy, asked.scene
        before = work.coordinates.copy()
        if not keep:
            self._trust = 1.0
        forces = self._assemble(policy, detail=asked.detail)
        energies = dict(self._system.energies)
        if keep or not policy.gives_way:
            coordinates, slip = self._stepped(before, policy)
        else:
            coordinates, slip = self._given_way(before, policy)
        work.replace(coordinates, scene)
        coordinates, slip = policy.taken(before, coordinates, slip, energies, scene, lambda: self._energy(policy))
        moved = float(np.abs(coordinates - before).max(initial=0.0))
        result = TickResult(work.certify(scene), slip, moved, energies, forces)
        if keep and not _is_proven(result):
            result = self._shortened(before, coordinates, asked, result)
        else:
            self._trust = min(1.0, 2.0 * self._trust)
        self._proof = _Proof.KNOWN if _is_proven(result) else _Proof.NONE
        return result

    def _energy(self, policy: TickPolicy) -> float:
        """Potential of all forces at the current nodes."""
        self._assemble(policy)
        return sum(self._system.energies.values())

    def _given_way(self, before: Array, policy: TickPolicy) -> tuple[Array, float]:
        """A broken strip's step, with its rolling residual: where it would bring the robot's own links together it is
        solved again with the joints of those nodes stiff, so that the base gives way instead.

        Links meet by the joints alone, and beyond the self influence distance no force tells of it: an arm that an
        obstacle pushes would go through the body, and come back over many ticks.
        """
        work, b = self.workspace, self.robot.space.base_nv
        intrusions = Intrusions.of(work.kin, work.obstacles, self.params.clearance)
        coordinates, slip = self._stepped(before, policy, intrusions)
        pairs = work.self_pairs
        if b == 0 or len(pairs.pairs) == 0:
            return coordinates, slip
        least, held = own_distances_to_keep(pairs, self.params.self_clearance), np.zeros(len(before), dtype=bool)
        for _ in range(_MOST_HOLDS):
            work.try_joints(coordinates)
            lost = (pairs.bound < least).any(axis=1) & ~held
            if not lost.any():
                break
            held |= hold_joints(self._system, b, lost)
            coordinates, slip = self._stepped(before, policy, intrusions)
        return coordinates, slip

    def _assemble(self, policy: TickPolicy, *, detail: bool = False) -> StripForces:
        """Forces, matrix and energies at the current nodes, in the system; external forces, where they are wanted."""
        params, space, kin = self.params, self.robot.space, self.workspace.kin
        obstacles, n = self.workspace.obstacles, kin.n
        coordinates = kin.coordinates[:n]
        if self._system.force.shape[0] != n:
            self._system = System(n, space.nv)
        system = self._system
        system.clear()
        near, k_near = policy.stiff_layer(params)
        acting = Acting(
            params=params,
            space=space,
            kin=kin,
            coordinates=coordinates,
            v=space.difference(coordinates[:-1], coordinates[1:]),
            obstacles=obstacles,
            self_pairs=self.workspace.self_pairs,
            near=min(near, params.influence),
            k_near=k_near,
            stiffness=self._stiffness,
            k_posture=self._posture,
            posture=self._straight,
            constraint=self.constraint,
            path=self.path,
            further=policy.add_forces,
        )
        for force in FORCES:
            force(system, acting)
        forces = StripForces.none()
        if detail:
            contacts = obstacles.contacts()
            push = repulsive_magnitude(contacts.distance, params.k_r, params.influence)
            forces = StripForces(contacts.witness, push[:, None] * contacts.direction)
        self.clock.mark("forces")
        return forces

    def _stepped(
        self, coordinates: Array, policy: TickPolicy, intrusions: Intrusions | None = None
    ) -> tuple[Array, float]:
        """Where the system's step leads from nodes (N, nv), no farther than needed where something is in the strip; and
        the rolling residual [m]."""
        params, space = self.params, self.robot.space
        delta = self._solver.solve(self._system, policy.damping_factor * self._damping)
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
        ends = coordinates[:: len(coordinates) - 1]
        if len(self._line) != len(coordinates) or (self._line_ends != ends).any():
            part = np.linspace(0.0, 1.0, len(coordinates))
            self._line, self._line_ends = self.robot.space.interpolate(ends[:1], ends[1:], part), ends.copy()
        return self._line

    def _shortened(self, before: Array, coordinates: Array, asked: _Request, full: TickResult) -> TickResult:
        """A step must not lose the certificate where a shorter one, or none, keeps it; the next ones are shorter too.

        The strip does not count as converged then: ``moved`` stays that of the full step.
        """
        space, work, scene = self.robot.space, self.workspace, asked.scene
        self._trust = max(0.5 * self._trust, 0.05)
        if asked.retry:
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

    def _resample(self, asked: _Request, result: TickResult) -> TickResult:
        params, space, work, scene = self.params, self.robot.space, self.workspace, asked.scene
        self._needed = max(self._needed - 1, 0)
        proven = _is_proven(result)
        removes = asked.policy.removes_nodes and (self._needed == 0 or not proven)
        spacing = node_spacing(space, work.coordinates, self.spacing_weight)
        split = None if work.prediction else ~result.certificate.segments  # what moves on will be gone
        others = None if split is None else asked.policy.to_split(scene)
        if split is not None and others is not None:
            split |= others
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
        known = None
        if work.prediction is None:  # what moves on is elsewhere when other nodes are reached
            known = kept_segments(before, coordinates, source, result.certificate.segments)
        work.edit(coordinates, source, scene)
        edited = replace(result, certificate=work.certify(scene, known), slip=slip)
        if proven and not _is_proven(edited):  # the removed nodes were needed
            self._needed = _KEPT_ROUNDS
            work.replace(before, scene)
            return replace(result, certificate=work.certify(scene))
        asked.policy.resampled(source)
        return edited

    def _spare(self, spacing: Array) -> Mask | None:
        """(N,) nodes that a proven strip does not need: it was divided there while something was in its way, and there
        is more room about them now than their neighbours are apart."""
        joined = spacing[:-1] + spacing[1:]
        close = joined < _JOINED_SPACING_SHARE * self.params.max_spacing
        if not close.any():
            return None
        free = self.workspace.obstacles.clearance().min(axis=1, initial=np.inf) - self.params.clearance
        spare = np.zeros(len(free), dtype=bool)
        spare[1:-1] = close & (np.minimum(np.minimum(free[:-2], free[2:]), free[1:-1]) > joined)
        return spare

    def _hulls(self) -> ProtectiveHulls:
        work, cap = self.workspace, self.params.influence
        points = self.robot.control_point_set
        local = np.einsum("cji,cj->ci", self.robot.tree.align[points.joint], points.local)
        free = np.minimum(work.obstacles.clearance().min(axis=1), cap)
        world = work.kin.points(points.joint, local)
        return protective_hulls(world, np.repeat(free[:, None], len(points.names), axis=1), cap=cap)

    def _report(self, asked: _Request, result: TickResult, queries: int) -> DeformReport:
        hulls, wide = self._hulls() if asked.detail else None, ""
        rest = asked.policy.rests(result.moved < self.params.rest_step, result.energies)
        if rest:
            coordinates = self.workspace.coordinates
            spacing = float(node_spacing(self.robot.space, coordinates, self.spacing_weight).max())
            wide = _wide_spacing(spacing, len(coordinates), self.params)
            rest = not wide or len(coordinates) >= self.params.max_nodes  # else there are nodes to be put in
        status, reason = tick_status(result.certificate, rest, wide)
        if result.slip > SLIP_LIMIT:
            status = DeformStatus.BROKEN if rest else DeformStatus.DEFORMING
            reason = f"a segment slips sideways by {result.slip:.2e} m, more than {SLIP_LIMIT:g} m"
        report = self.workspace.report(
            DeformReport, asked.scene, result, queries, asked.detail, status=status, reason=reason, hulls=hulls
        )
        self._proof, self._scene = _Proof.KNOWN if _is_proven(result) else _Proof.NONE, asked.scene
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
