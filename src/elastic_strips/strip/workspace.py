"""Workspace: what is known of the strip that a deformer works on; its clock, and what a tick came to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter
from weakref import WeakKeyDictionary

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.collision import (
    BodySet,
    Certificate,
    MotionBounds,
    ObstacleProximity,
    ProtectiveHulls,
    SelfProximity,
)
from elastic_strips.collision.candidates import NodePrediction
from elastic_strips.collision.native_side import MOST_HALVINGS, least_distance, proven_segments
from elastic_strips.collision.strip_certificate import Certifier
from elastic_strips.errors import ConfigurationError, RobotError, SceneError
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.validation import check_able, check_number, check_type

from .params import StripParams
from .report import DeformStatus, R, StripForces
from .strip import Strip

NodePredictor = Callable[[Array], NodePrediction]
"""Says for nodes (N, nv) where moving obstacles will be when each of them is reached."""


class PhaseClock:
    """Accounts time to phases; the time between two marks belongs to the phase of the later mark."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Forget all phases and begin anew."""
        self.phases: dict[str, float] = {}
        self._begin = self._last = perf_counter()

    def mark(self, phase: str) -> None:
        """Account the time since the last mark to ``phase``."""
        now = perf_counter()
        self.phases[phase] = self.phases.get(phase, 0.0) + now - self._last
        self._last = now

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return perf_counter() - self._begin


@dataclass(frozen=True, slots=True, eq=False)
class TickResult:
    """The result of a tick's iterations; see :class:`DeformReport` for the attributes."""

    certificate: Certificate
    slip: float
    moved: float
    energies: dict[str, float]
    forces: StripForces
    iterations: int = 0


_ROOM_TOLERANCE = 1e-4  # [m] of the distance at configurations that are only looked at
_HOME: WeakKeyDictionary[RobotModel, dict[tuple[int, float], tuple[Array, Array]]] = WeakKeyDictionary()


def _at_home(robot: RobotModel, pairs: Indices, bounds: MotionBounds, reach: float) -> tuple[Array, Array]:
    """Lower bounds (S,) of the self pairs' distances [m] at home, and these where they are exact; made once a robot."""
    known = _HOME.setdefault(robot, {})
    key = len(pairs), reach  # pairs are those below a distance: as many are the same
    if key not in known:
        home, kin = SelfProximity(bounds.bodies, pairs, bounds, influence=reach), Kinematics(robot.tree, 1)
        kin.update(robot.space.to_coordinates(robot.home_q)[None])
        home.update(kin)
        known[key] = home.bound[0].copy(), home.exact[0].copy()
        for values in known[key]:
            values.setflags(write=False)
    return known[key]


class Workspace(OneThread):
    """Mutable state of a deformer: the current nodes and everything that is known about them.

    Args:
        robot: whose strips.
        params: what is certified.
        reach: the links' distances to obstacles are exact below this [m]; self_reach: those to each other.
        self_reach_eased: whether those to each other need not be exact but where they push, or are near the clearance.
        self_influence: the robot's own links push each other apart below this [m], those that are nearer by design
            below 0.8 of their distance at home.

    Attributes:
        clock: accounts the time of a tick to phases.
        kin: kinematics of the nodes.
        obstacles: the links' distances to the scene.
        self_pairs: their distances to each other.
        self_home: (S,) lower bounds of the self pairs' distances [m] at the home configuration.
        most_self_clearance: largest clearance [m] between its own links that can be certified: pairs that are proven to
            keep more than that in every posture were left out.
        prediction: where moving obstacles will be, or None where they count as they stand.
    """

    def __init__(
        self,
        robot: RobotModel,
        params: StripParams,
        *,
        reach: float,
        self_reach: float,
        self_influence: float,
        self_reach_eased: bool = False,
    ) -> None:
        check_type("robot", robot, RobotModel, RobotError)
        self.robot: RobotModel = robot
        self.params: StripParams = params
        self.clock: PhaseClock = PhaseClock()
        self.bodies: BodySet = BodySet.links(robot)
        self.bounds: MotionBounds = MotionBounds(self.bodies)
        self.kin: Kinematics = Kinematics(robot.tree, 64)
        self.obstacles: ObstacleProximity = ObstacleProximity(self.bodies, influence=reach)
        self.most_self_clearance: float = params.self_clearance
        pairs = robot.pairs_within(self.most_self_clearance)  # the others keep more of themselves
        at_home, exact = _at_home(robot, pairs, self.bounds, self_reach)
        self.self_home: Array = at_home
        repulsion = np.clip(0.8 * np.minimum(exact, self_reach), 0.0, self_influence)
        self.self_pairs: SelfProximity = SelfProximity(
            self.bodies,
            pairs,
            self.bounds,
            influence=self_reach,
            repulsion=repulsion,
            reach=np.maximum(repulsion, 2.0 * params.self_clearance) if self_reach_eased else None,
        )
        depth = params.certificate_depth
        self.certifier: Certifier = Certifier(
            self.bodies, self.bounds, self.obstacles, self.self_pairs, max_depth=depth
        )
        self.prediction: NodePredictor | None = None
        self._strip: Strip | None = None
        self._ends: Array | None = None  # configurations that stay fixed

    @property
    def coordinates(self) -> Array:
        """(N, nv) the current nodes (a view)."""
        return self.kin.coordinates[: self.kin.n]

    @property
    def queries(self) -> int:
        """Exact distance queries made so far."""
        return self.obstacles.narrow.queries + self.self_pairs.queries

    @exclusive
    def reset(self) -> None:
        """Forget all that is known."""
        self._strip = None
        self.obstacles.reset()
        self.self_pairs.reset()

    def holds(self, strip: Strip) -> bool:
        """Whether the current nodes belong to this very strip."""
        return strip is self._strip

    @exclusive
    def load(self, strip: Strip, scene: Scene, *, to_move: bool = False) -> None:
        """Make a strip current; cheap where it already is.

        Args:
            strip: the nodes.
            scene: the obstacles.
            to_move: the nodes are about to move, and everything is measured again then. With a prediction, and the same
                obstacles as before, the known distances are enough for the forces: what moves as predicted is where
                the prediction had it.
        """
        current = strip is self._strip
        if not current:
            self.kin.update(strip.coordinates)
        self._strip, self._ends = strip, strip.q[[0, -1]]
        if not (to_move and current and self.prediction is not None and self.obstacles.knows(scene)):
            self._distances(scene)

    @exclusive
    def carry(self, strip: Strip, new: Strip, source: Indices) -> None:
        """Make ``new`` current, whose node i was node ``source[i]`` of ``strip`` (−1: none); known distances stay."""
        if not self.holds(strip):
            return
        self.obstacles.remap(source)
        self.self_pairs.remap(source)
        self.kin.update(new.coordinates)
        self._strip, self._ends = new, new.q[[0, -1]]

    @exclusive
    def move(self, coordinates: Array, scene: Scene) -> float:
        """Move the nodes; returns how far the fastest base or joint moved [m or rad]."""
        moved = float(np.abs(coordinates - self.coordinates).max(initial=0.0))
        self.replace(coordinates, scene)
        return moved

    @exclusive
    def replace(self, coordinates: Array, scene: Scene) -> None:
        """Make nodes (N, nv) current, however many there were; all is measured again."""
        self._strip = None
        self.kin.update(coordinates)
        self._distances(scene)

    @exclusive
    def try_joints(self, coordinates: Array) -> None:
        """Make nodes (N, nv) current for the distances of the robot's own links alone; to be replaced."""
        self._strip = None
        self.kin.update(coordinates)
        self.clock.mark("kinematics")
        self.self_pairs.update(self.kin)
        self.clock.mark("self-collision")

    @exclusive
    def edit(self, coordinates: Array, source: Indices, scene: Scene) -> None:
        """Make nodes (N, nv) current, whose node i was node ``source[i]`` (−1: none), with what is known."""
        self.obstacles.remap(source)
        self.self_pairs.remap(source)
        self.clock.mark("maintenance")
        self.replace(coordinates, scene)

    def _distances(self, scene: Scene) -> None:
        self.clock.mark("kinematics")
        self.obstacles.update(self.kin, scene, None if self.prediction is None else self.prediction(self.coordinates))
        self.clock.mark("proximity")
        self.self_pairs.update(self.kin)
        self.clock.mark("self-collision")

    @exclusive
    def certify(self, scene: Scene, known: Mask | None = None) -> Certificate:
        """Certify the segments between the current nodes, except those (N−1,) that are known to be certified."""
        v = self.robot.space.difference(self.coordinates[:-1], self.coordinates[1:])
        params = self.params
        certificate = self.certifier.certify(
            self.kin,
            v,
            clearance=params.clearance,
            self_clearance=params.self_clearance,
            scene=scene,
            known=known,
        )
        self.clock.mark("certificate")
        return certificate

    def proves(self, strip: Strip, scene: Scene) -> bool:
        """Whether spheres about the links prove all of a strip, which does not become current. False says nothing."""
        v = self.robot.space.difference(strip.coordinates[:-1], strip.coordinates[1:])
        if self.robot.space.half_turn(v).any():
            return False
        return self._proves(strip.coordinates, v, scene, self.params.clearance, self.params.self_clearance)

    def room_at(
        self, coordinates: Array, scene: Scene, *, clearance: float, self_clearance: float, most: float
    ) -> float | None:
        """The least distance [m] of configurations (N, nv) to obstacles, or ``most``, where spheres prove that they
        keep both clearances [m]; None says nothing. They do not become current."""
        rows, v = np.concatenate((coordinates, coordinates[-1:])), np.zeros_like(coordinates)
        if not self._proves(rows, v, scene, clearance, self_clearance):
            return None
        return least_distance(self.bounds, scene, rows, v, tolerance=_ROOM_TOLERANCE, most=most)

    def _proves(self, rows: Array, v: Array, scene: Scene, clearance: float, self_clearance: float) -> bool:
        proven = proven_segments(
            self.bounds,
            scene,
            self.self_pairs.pairs,
            rows,
            v,
            clearance=clearance,
            self_clearance=self_clearance,
            depth=min(MOST_HALVINGS, self.params.certificate_depth - 1),  # what it proves, :meth:`certify` does
            all=True,
        )
        return proven is not None and bool(proven.all())

    @exclusive
    def strip(self) -> Strip:
        """The current nodes as a frozen strip, which stays current."""
        self._strip = Strip.from_coordinates(self.robot, self.coordinates, ends=self._ends)
        return self._strip

    # the frame of a tick

    def check(self, strip: Strip) -> None:
        """Check that a strip is of this robot.

        Raises:
            ConfigurationError: it belongs to another one.
        """
        check_type("strip", strip, Strip, ConfigurationError)
        if not self.robot.same_as(strip.robot):
            raise ConfigurationError(
                f"the strip is of robot {strip.robot.name!r} (nq {strip.robot.nq}), the deformer of "
                f"{self.robot.name!r} (nq {self.robot.nq}): they differ in joints, shapes or pairs of links"
            )

    @exclusive
    def begin(
        self,
        strip: Strip,
        scene: Scene,
        prediction: NodePredictor | None = None,
        *,
        budget: float | None = None,
        to_move: bool = False,
    ) -> None:
        """Check what a tick is given, start the clock and make the strip current; see :meth:`load`.

        Raises:
            ConfigurationError: the strip belongs to another robot.
            ParameterError: a budget that is not a positive number.
        """
        if budget is not None:
            check_number("budget", budget, above=0.0, unit="s")
        check_able("prediction", prediction)
        check_type("scene", scene, Scene, SceneError)
        self.check(strip)
        self.clock.start()
        self.prediction = prediction
        self.load(strip, scene, to_move=to_move)

    def iterate(self, iteration: Callable[[], TickResult], budget: float | None) -> TickResult:
        """Iterations of one tick: one without a budget [s], else until it is spent or the strip has converged."""
        count = 0
        while True:
            began = self.clock.elapsed
            result = iteration()
            count += 1
            spent = self.clock.elapsed - began
            done = result.moved < self.params.rest_step and result.certificate.certified
            if budget is None or self.clock.elapsed + spent > budget or done:
                return replace(result, iterations=count)

    def report(
        self,
        kind: type[R],
        scene: Scene,
        result: TickResult,
        queries: int,
        detail: bool,
        *,
        status: DeformStatus,
        reason: str,
        hulls: ProtectiveHulls | None,
    ) -> R:
        """A report of the kind that a deformer makes, with what all of them have."""
        clearance = self.obstacles.least_clearance()
        strip = self.strip()
        self.clock.mark("report")
        return kind(
            strip=strip,
            status=status,
            reason=reason,
            scene=scene,
            certificate=result.certificate,
            node_clearance=clearance,
            energies=result.energies,
            timings=self.clock.phases,
            seconds=sum(self.clock.phases.values()),
            iterations=result.iterations,
            moved=result.moved,
            slip=result.slip,
            queries=queries,
            forces=result.forces if detail else None,
            hulls=hulls,
            predicted=self.prediction is not None,
        )
