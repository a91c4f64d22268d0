"""Requests: what others ask of the robot, handed from their threads to the one that plans; and the goals' states."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control.controller import Controller
from elastic_strips.control.process import ExecutorProcess
from elastic_strips.errors import ElasticStripsError
from elastic_strips.planning import BasePose, HandPose
from elastic_strips.strip.followed import FollowedPath

_TOLD_WITHIN = 0.3  # [s] after a new goal the executor, in its process, may still say that the one before is reached
_GOALS = ("goal", "hand", "path")
_REPLACED = "another goal took its place"
_REMEMBERED = 100  # goals, of which it is known what has become of them


class GoalState(Enum):
    """What has become of the last goal."""

    NONE = "no goal"
    DRIVING = "driving"
    REACHED = "reached"
    CANCELLED = "cancelled"
    REFUSED = "refused"


class Request(NamedTuple):
    """One of ``"goal"`` and ``"path"``, with where to, and ``"hand"``, with the frame that is to be there; ``"speed"``
    with the part of it; or ``"cancel"``, ``"stop"``, ``"resume"``, with the reason. The number is that of a goal; where
    one is to be cancelled, 0 is any."""

    kind: str
    where: Array | None = None
    reason: str = ""
    number: int = 0


class Progress(NamedTuple):
    """How far the way to a goal still is.

    Attributes:
        number: of the goal.
        place: (3,) x, y [m], yaw [rad] of the base.
        distance: of its way along the strip [m].
        seconds: that this takes at least [s].
        speed: of the base [m/s].
    """

    number: int
    place: Array
    distance: float
    seconds: float
    speed: float


class Requests:
    """Workspace: takes requests in any thread, and does them in the one that plans.

    Args:
        within: largest distance [m] of the base from a path that it follows.
        posture: (n,) of the joints on it; None: as they are.

    Attributes:
        state: what has become of the goal that counts, and
        reason: why.
        number: of the last goal that was looked at. Each takes the place of those before it, unless it is refused.
        progress: how far it still is to the goal that counts; None where that is not known.
    """

    def __init__(self, within: float, posture: Array | None = None) -> None:
        self._within, self._posture = within, posture
        self._waiting: deque[Request] = deque(maxlen=100)
        self._changed = threading.Condition()
        self.state: GoalState = GoalState.NONE
        self.reason: str = ""
        self.number: int = 0
        self.progress: Progress | None = None
        self._newest = 0  # number of the last goal that was asked for
        self._present = 0  # of the one that counts
        self._over: dict[int, tuple[GoalState, str]] = {}  # goals of which it is known what has become, and that
        self._asked = -math.inf  # when the goal was given to the controller [s]

    def ask(self, request: Request) -> int:
        """Hand a request over, in any thread; the number of a goal."""
        with self._changed:
            if request.kind in _GOALS:
                self._newest += 1
                request = request._replace(number=self._newest)
            self._waiting.append(request)
        return request.number

    def do(self, controller: Controller, log: Callable[[str], object]) -> None:
        """Do what was asked for since the last call, and see what has become of the goal."""
        while self._waiting:
            request = self._waiting.popleft()
            try:
                self._do(controller, request)
            except ElasticStripsError as error:
                self._refuse(request.number if request.kind in _GOALS else 0, str(error))
                log(f"{request.kind} refused: {error}")
        told, keeper = controller.time > self._asked + _TOLD_WITHIN, controller.keeper
        if self.state is GoalState.DRIVING and told and controller.ended:
            self._end(GoalState.REACHED, controller.reason)
            log(f"reached: {controller.reason}")
        elif self.state is GoalState.DRIVING and keeper.gave_up and controller.executor.at_rest(controller.time):
            reason = keeper.no_way
            controller.cancel(reason)  # it is not to set out later, when nobody waits for that any more
            self._end(GoalState.REFUSED, reason)
            log(f"given up: {reason}")
        elif self.state is GoalState.CANCELLED and controller.halted:
            self._end(self.state, self.reason)

    def note_progress(self, controller: Controller) -> None:
        """See how far it still is, where the strip leads to the goal by now."""
        keeper = controller.keeper
        if (
            self.state is not GoalState.DRIVING
            or keeper.planning
            or keeper.next_path
            or not controller.robot.space.planar
        ):
            self.progress = None
            return
        rows, here, v = controller.strip.coordinates, controller.estimate[:3], controller.reference.v
        lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(rows[:, :2], axis=0).T))])
        passed = float(FollowedPath(rows[:, :2], 1.0).nearest(here[None, :2])[1][0])
        times = controller.planner.arrival(rows)
        self.progress = Progress(
            self._present,
            here.copy(),
            float(lengths[-1]) - passed,
            float(times[-1] - np.interp(passed, lengths, times)),
            math.hypot(float(v[0]), float(v[1])),
        )

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
        if request.kind in _GOALS:
            assert request.where is not None
            with self._changed:
                self.number = request.number
            if request.kind == "goal":
                x, y, yaw = request.where.tolist()
                controller.retarget(BasePose(x, y, yaw))
            elif request.kind == "hand":
                x, y, z, *turn = request.where.tolist()
                controller.retarget(HandPose(request.reason, (x, y, z), (turn[0], turn[1], turn[2], turn[3])))
            else:
                controller.follow(request.where, within=self._within, joints=self._posture)
            self._asked = controller.time
            self._begin(request)
        elif request.kind == "cancel":
            if self.state is GoalState.DRIVING and request.number in (0, self._present):
                controller.cancel(request.reason)
                with self._changed:
                    self.state, self.reason = GoalState.CANCELLED, request.reason
        elif request.kind == "stop":
            controller.stop(request.reason)
        elif request.kind == "resume":
            controller.resume()
        elif request.kind == "speed":
            assert request.where is not None
            controller.set_speed(float(request.where[0]))

    def _begin(self, request: Request) -> None:
        """A goal takes the place of the one that counted."""
        with self._changed:
            if self.state is GoalState.CANCELLED:
                self._remember(self._present, self.state, self.reason)
            elif self.state is GoalState.DRIVING:
                self._remember(self._present, GoalState.CANCELLED, _REPLACED)
            self._present, self.progress = request.number, None
            self.state, self.reason = GoalState.DRIVING, request.kind

    def _refuse(self, number: int, reason: str) -> None:
        """A goal is refused; the robot drives on to one that it has."""
        if not number:
            return
        with self._changed:
            self._remember(number, GoalState.REFUSED, reason)
            if self.state is not GoalState.DRIVING:
                self.state, self.reason, self._present = GoalState.REFUSED, reason, number

    def _end(self, state: GoalState, reason: str) -> None:
        with self._changed:
            self.state, self.reason = state, reason
            self._remember(self._present, state, reason)

    def _remember(self, number: int, state: GoalState, reason: str) -> None:
        self._over.setdefault(number, (state, reason))
        while len(self._over) > _REMEMBERED:
            self._over.pop(next(iter(self._over)))
        self._changed.notify_all()

    def _outcome(self, number: int) -> tuple[GoalState, str] | None:
        if number in self._over:
            return self._over[number]
        waits = number == self._present or number > self.number
        return None if waits else (GoalState.CANCELLED, _REPLACED)

    def close(self, reason: str) -> bool:
        """End all goals that are open, as nobody drives any more; whether there were any."""
        with self._changed:
            still = [n for n in range(self._present, self._newest + 1) if n and self._outcome(n) is None]
            for number in still:
                self._remember(number, GoalState.CANCELLED, reason)
        return bool(still)

    def outcome(self, number: int) -> tuple[GoalState, str] | None:
        """What has become of goal ``number``, and why; None while that is open: also one that is cancelled is over only
        when the robot stands. Of one that another has taken the place of, that it was cancelled."""
        with self._changed:
            return self._outcome(number)

    def wait(self, number: int, seconds: float) -> tuple[GoalState, str] | None:
        """What has become of goal ``number``, where that is known within some time [s]."""
        with self._changed:
            self._changed.wait_for(lambda: self._outcome(number) is not None, seconds)
            return self._outcome(number)
