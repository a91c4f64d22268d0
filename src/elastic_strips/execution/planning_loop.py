"""Execution room, planning loop: sense, give way, certify, and tell the supervisor; nothing that fails goes further."""

from __future__ import annotations

import logging

import numpy as np

from ..errors import ElasticStripsError
from ..robot.space import Array
from ..scene import Scene
from .faults import FaultPlan
from .perception import ContactError, Perceiver
from .pilot import Pilot
from .proposal import Proposal
from .replanning import Replanner
from .supervisor import Supervisor, standstill

_log = logging.getLogger(__name__)


class PlanningLoop:
    """Workspace: one planning tick after the other, each from a sensed scene to what the supervisor holds.

    Args:
        pilot: plans motions along the strip.
        supervisor: holds what is executed.
        perception: tells what is around.
        replanner: decides when a strip is planned anew, and does it.
        faults: what goes wrong on purpose.
        goal: configuration (nq,).

    Attributes:
        scene: the newest one that was sensed.
        proposal: what the last tick came to; None where it came to nothing.
        goal: may be changed while the robot stands.
    """

    def __init__(
        self,
        pilot: Pilot,
        supervisor: Supervisor,
        perception: Perceiver,
        replanner: Replanner,
        faults: FaultPlan,
        goal: Array,
    ) -> None:
        self.pilot, self.supervisor, self.perception, self.replanner = pilot, supervisor, perception, replanner
        self.robot, self.params, self.faults, self.goal = pilot.robot, pilot.params, faults, goal
        self.scene: Scene = perception.known()
        self.proposal: Proposal | None = None
        self._waiting: list[tuple[float, Proposal]] = []

    def tick(self, t: float, estimate: Array, lost_for: float) -> None:
        """One planning tick. Whatever fails in it: the held motion is driven to its end, and the reason is told.

        Args:
            t: time [s].
            estimate: (nv,) where the robot believes to be; lost_for: how long [s] it has not known.
        """
        supervisor = self.supervisor
        self.proposal = None
        try:
            self._plan(t, estimate, lost_for)
        except ContactError as error:
            supervisor.log(t, "fault", str(error))
            self._brake(f"{type(error).__name__}: {error}", t)
        except ElasticStripsError as error:
            supervisor.keep(f"{type(error).__name__}: {error}", t)
            supervisor.log(t, "fault", str(error))
        except Exception as error:
            _log.exception("planning tick failed")
            self.pilot.reset()
            supervisor.keep(f"planning failed: {type(error).__name__}: {error}", t)
            supervisor.log(t, "fault", f"planning exception: {type(error).__name__}: {error}")

    def hand_over(self, t: float) -> None:
        """Offer the supervisor what has been planned and is ready by now."""
        ready = [p for due, p in self._waiting if due <= t + 1e-9]
        self._waiting = [(due, p) for due, p in self._waiting if due > t + 1e-9]
        for proposal in ready:
            if proposal.motion is None or proposal.certificate is None:
                continue
            if proposal.motion.start_time < t - 1e-9:
                self.supervisor.log(t, "fault", "late tick")
            if proposal.emergency:
                self.supervisor.brake(proposal.motion, proposal.reason, t)
            else:
                self.supervisor.offer(proposal.motion, proposal.certificate, t, at_goal=proposal.at_goal)

    def _plan(self, t: float, estimate: Array, lost_for: float) -> None:
        params, supervisor = self.params, self.supervisor
        if self.faults.active("planning_exception", t):
            raise RuntimeError("planning exception put in on purpose")
        scene = self.perception.sense(t)
        age = t - scene.time
        if age > params.max_scene_age:
            supervisor.keep(f"stale scene: {age:.2f} s old, at most {params.max_scene_age:g} s", t)
            supervisor.log(t, "fault", "stale scene")
            return
        self.scene = scene
        if lost_for > 0.1:
            supervisor.keep("odometry lost", t)
            return
        waiting = self._replan(t)
        if (waiting and self.pilot.evasion is None) or self._rest_of_goal(t, scene):
            return
        begin = self._begin(t)
        at_rest = supervisor.at_rest(t)
        if at_rest and t >= supervisor.held.end_time + params.settle_time:
            supervisor.rebase(standstill(self.robot, self.pilot.limits, np.array(estimate), begin, params.control_dt))
        proposal = self.proposal = self.pilot.tick(t, scene, supervisor.held, begin)
        late = 10.0 * params.latency * params.control_dt if self.faults.active("slow_tick", t) else 0.0
        if late:
            supervisor.log(t, "fault", f"late tick: it is ready only after {late:.2f} s")
        due = "" if waiting else self.replanner.watch(t, proposal, scene, at_rest=at_rest)
        if due:
            supervisor.log(t, "replanning", due)
        if waiting and not proposal.evasive:
            return
        if proposal.emergency:
            self._waiting.append((t + late, proposal))
        elif self.replanner.halted and not proposal.evasive:
            supervisor.keep(f"the strip is broken: {proposal.report.certificate.broken}", t)
        elif proposal.accepted:
            self._waiting.append((t + late, proposal))
        elif proposal.kept:
            supervisor.confirm(t, proposal.reason)
        else:
            supervisor.keep(proposal.reason, t)

    def _begin(self, t: float) -> float:
        """When a motion begins that is planned now."""
        return t + self.params.latency * self.params.control_dt

    def _brake(self, reason: str, t: float) -> None:
        """Stop as soon as the machine can, on the way that is driven."""
        self._waiting.clear()
        self.supervisor.brake(self.pilot.onward.hard.brake(self.supervisor.held, self._begin(t)), reason, t)

    def _rest_of_goal(self, t: float, scene: Scene) -> bool:
        """Whether the held motion ends at the goal and is still certified: then nothing better can be planned."""
        supervisor = self.supervisor
        if not supervisor.at_goal or supervisor.at_rest(t):
            return supervisor.at_goal
        certificate = self.pilot.certify(supervisor.held.tail(self._begin(t)), scene)
        if certificate.certified:
            supervisor.confirm(t, "the motion ends at the goal")
        return certificate.certified

    def _replan(self, t: float) -> bool:
        """Plan anew where that is due; True while the robot stands for it."""
        replanner = self.replanner
        if not replanner.pending:
            return False
        if t >= replanner.due:
            q = self.robot.space.from_chart(self.supervisor.reference(t).chart)
            strip, reason = replanner.plan_anew(self.scene, q, self.goal)
            self.supervisor.log(t, "replanned", reason)
            if strip is not None:
                self.pilot.take(strip)
        return True
