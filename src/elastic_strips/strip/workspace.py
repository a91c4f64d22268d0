"""Workspace of a tick: kinematics, distances and certificate of one strip, kept from tick to tick."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from elastic_strips.arrays import Array, Indices

from ..proximity import Ahead, BodySet, MotionBounds, ObstacleProximity, SelfProximity
from ..robot import Kinematics, RobotModel
from ..scene import Scene
from ..tunnel import Certificate, Certifier
from .params import DeformParams
from .report import PhaseClock
from .resampling import Edit
from .strip import Strip

Foresight = Callable[[Array], Ahead]
"""Says for nodes (N, nv) where moving obstacles will be when each of them is reached."""

PAPER_LINK_REACH = 0.3
"""Links' distances are exact below this [m] in the paper preset, whose forces act on control points."""


class Workspace:
    """Mutable state of a :class:`Deformer`: the current nodes and everything that is known about them.

    Attributes:
        kin: kinematics of the nodes.
        obstacles: the links' distances to the scene; self_pairs: to each other.
        self_floor: (S,) distances [m] below which the paper preset does not update joints.
        clock: accounts the time to phases.
        foresight: where moving obstacles will be, or None where they count as they stand.
    """

    def __init__(self, robot: RobotModel, params: DeformParams, clock: PhaseClock) -> None:
        self.robot, self.params, self.clock = robot, params, clock
        self.bodies = BodySet.links(robot)
        self.bounds = MotionBounds(self.bodies)
        self.kin = Kinematics(robot.tree, 64)
        reach = params.influence if params.preset == "default" else max(PAPER_LINK_REACH, 2.0 * params.clearance)
        self.obstacles = ObstacleProximity(self.bodies, influence=reach)
        self.self_pairs, self.self_floor = self._self_proximity()
        depth = params.certificate_depth
        self.certifier = Certifier(self.bodies, self.bounds, self.obstacles, self.self_pairs, max_depth=depth)
        self.foresight: Foresight | None = None
        self._strip: Strip | None = None
        self._ends: Array | None = None  # configurations that stay fixed

    def _self_proximity(self) -> tuple[SelfProximity, Array]:
        """Self pairs, with repulsion that begins no further than 0.8 of what separates a pair at home by design."""
        params, pairs = self.params, self.robot.self_pairs
        reach = max(params.self_influence, params.self_margin, 2.0 * params.self_clearance)
        home = SelfProximity(self.bodies, pairs, self.bounds, influence=reach)
        kin = Kinematics(self.robot.tree, 1)
        kin.update(self.robot.space.to_chart(self.robot.home_q)[None])
        home.update(kin)
        floor = np.minimum(0.8 * home.bound[0], params.self_margin)
        repulsion = np.clip(0.8 * np.minimum(home.exact[0], reach), 0.0, params.self_influence)
        return SelfProximity(self.bodies, pairs, self.bounds, influence=reach, repulsion=repulsion), floor

    @property
    def chart(self) -> Array:
        """(N, nv) the current nodes (a view)."""
        return self.kin.chart[: self.kin.n]

    @property
    def queries(self) -> int:
        """Exact distance queries made so far."""
        return self.obstacles.narrow.queries + self.self_pairs.queries

    def reset(self) -> None:
        """Forget all that is known."""
        self._strip = None
        self.obstacles.reset()
        self.self_pairs.reset()

    def holds(self, strip: Strip) -> bool:
        """Whether the current nodes are those of this very strip."""
        return strip is self._strip

    def load(self, strip: Strip, scene: Scene, *, to_move: bool = False) -> None:
        """Make a strip current; cheap where it already is.

        Args:
            strip: the nodes.
            scene: the obstacles.
            to_move: the nodes are about to move, and all is measured again then. With foresight, and the same obstacles
                as before, the distances that are known do for the forces: what moves as it was foreseen is where it was
                reckoned with.
        """
        current = strip is self._strip
        if not current:
            self.kin.update(strip.chart)
        self._strip, self._ends = strip, strip.q[[0, -1]]
        if not (to_move and current and self.foresight is not None and self.obstacles.knows(scene)):
            self._distances(scene)

    def carry(self, strip: Strip, new: Strip, source: Indices) -> None:
        """Make ``new`` current, whose node i was node ``source[i]`` of ``strip`` (−1: none), keeping what is known."""
        if not self.holds(strip):
            return
        self.obstacles.remap(source)
        self.self_pairs.remap(source)
        self.kin.update(new.chart)
        self._strip, self._ends = new, new.q[[0, -1]]

    def move(self, chart: Array, scene: Scene) -> float:
        """Move the nodes; returns how far the fastest base or joint moved [m or rad]."""
        moved = float(np.abs(chart - self.chart).max(initial=0.0))
        self._strip = None
        self.kin.update(chart)
        self._distances(scene)
        return moved

    def restore(self, chart: Array, scene: Scene) -> None:
        """Go back to nodes (N, nv), however many there were; all is measured again."""
        self._strip = None
        self.kin.update(chart)
        self._distances(scene)

    def edit(self, edit: Edit, chart: Array, scene: Scene) -> None:
        """Insert and remove nodes."""
        self._strip = None
        self.obstacles.remap(edit.source)
        self.self_pairs.remap(edit.source)
        self.clock.mark("maintenance")
        self.kin.update(chart)
        self._distances(scene)

    def _distances(self, scene: Scene) -> None:
        self.clock.mark("kinematics")
        self.obstacles.update(self.kin, scene, None if self.foresight is None else self.foresight(self.chart))
        self.clock.mark("proximity")
        self.self_pairs.update(self.kin)
        self.clock.mark("self-collision")

    def certify(self, scene: Scene) -> Certificate:
        """Certify the segments between the current nodes."""
        v = self.robot.space.difference(self.chart[:-1], self.chart[1:])
        params = self.params
        certificate = self.certifier.certify(
            self.kin, v, clearance=params.clearance, self_clearance=params.self_clearance, scene=scene
        )
        self.clock.mark("certificate")
        return certificate

    def strip(self) -> Strip:
        """The current nodes as a frozen strip, which stays current."""
        self._strip = Strip.from_chart(self.robot, self.chart, ends=self._ends)
        return self._strip
