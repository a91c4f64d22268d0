"""Requests: what others ask of the robot, handed from their threads to the one that plans; and the goal's state."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

from elastic_strips.arrays import Array
from elastic_strips.control.controller import Controller
from elastic_strips.control.process import ExecutorProcess
from elastic_strips.errors import ElasticStripsError
from elastic_strips.planning import BasePose, HandPose

_TOLD_WITHIN = 0.3  # [s] after a new goal the executor, in its process, may still say that the one before is reached


class GoalState(Enum):
    """What has become of the last goal."""

    NONE = "no goal"
    DRIVING = "driving"
    REACHED = "reached"
    CANCELLED = "cancelled"
    REFUSED = "refused"


class Request(NamedTuple):
    """One of ``"goal"`` and ``"path"``, with where to, and ``"hand"``, with the frame that is to be there; ``"speed"``
    with the part of it; or ``"cancel"``, ``"stop"``, ``"resume"``, with the reason."""

    kind: str
    where: Array | None = None
    reason: str = ""


class Requests:
    """Workspace: takes requests in any thread, and does them in the one that plans.

    Args:
        within: largest distance [m] of the base from a path that it follows.
        posture: (n,) of the joints on it; None: as they are.

    Attributes:
        state: what has become of the last goal, and
        reason: why.
        number: of the last goal; each one takes the place of those before it.
    """

    def __init__(self, within: float, posture: Array | None = None) -> None:
        self._within, self._posture = within, posture
        self._waiting: deque[Request] = deque(maxlen=100)
        self._changed = threading.Condition()
        self.state: GoalState = GoalState.NONE
        self.reason: str = ""
        self.number: int = 0
        self._asked = -math.inf  # when the goal was given to the controller [s]

    def ask(self, request: Request) -> None:
        """Hand a request over; in any thread."""
        self._waiting.append(request)

    def do(self, controller: Controller, log: Callable[[str], object]) -> None:
        """Do what was asked for since the last call, and see what has become of the goal."""
        while self._waiting:
            request = self._waiting.popleft()
            try:
                self._do(controller, request)
            except ElasticStripsError as error:
                self._set(GoalState.REFUSED, str(error))
                log(f"{request.kind} refused: {error}")
        told = controller.time > self._asked + _TOLD_WITHIN
        if self.state is GoalState.DRIVING and told and controller.ended:
            self._set(GoalState.REACHED, controller.reason)
            log(f"reached: {controller.reason}")

    def command(self, guard: ExecutorProcess, log: Callable[[str], object]) -> None:
        """Stop and resume where a guard drives; goals are not for it."""
        while self._waiting:
            request = self._waiting.popleft()
            if request.kind == "stop":
                guard.stop(request.reason)
            elif request.kind == "resume":
                guard.resume()
            else:
                log(f"{request.kind} refused: the node guards commands of others; with mode:=drive it drives to goals")

    def _do(self, controller: Controller, request: Request) -> None:
        if request.kind in ("goal", "hand", "path"):
            assert request.where is not None
            with self._changed:
                self.number += 1
            if request.kind == "goal":
                x, y, yaw = request.where.tolist()
                controller.retarget(BasePose(x, y, yaw))
            elif request.kind == "hand":
                x, y, z, *turn = request.where.tolist()
                controller.retarget(HandPose(request.reason, (x, y, z), (turn[0], turn[1], turn[2], turn[3])))
            else:
                controller.follow(request.where, within=self._within, joints=self._posture)
            self._asked = controller.time
            self._set(GoalState.DRIVING, request.kind)
        elif request.kind == "cancel":
            if self.state is GoalState.DRIVING:
                controller.cancel(request.reason)
                self._set(GoalState.CANCELLED, request.reason)
        elif request.kind == "stop":
            controller.stop(request.reason)
        elif request.kind == "resume":
            controller.resume()
        elif request.kind == "speed":
            assert request.where is not None
            controller.set_speed(float(request.where[0]))

    def _set(self, state: GoalState, reason: str) -> None:
        with self._changed:
            self.state, self.reason = state, reason
            self._changed.notify_all()

    def wait(self, number: int, seconds: float) -> tuple[GoalState, str] | None:
        """What has become of goal ``number``, where that is known within some time [s]; of one that another has
        taken the place of, that it was cancelled."""
        with self._changed:
            self._changed.wait_for(lambda: self.number != number or self.state is not GoalState.DRIVING, seconds)
            if self.number > number:
                return GoalState.CANCELLED, "another goal took its place"
            return None if self.state is GoalState.DRIVING else (self.state, self.reason)
