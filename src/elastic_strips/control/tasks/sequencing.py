"""Sequencing layer: a behaviour tree that orders the steps of a task, monitors them, and handles failure.

It does not decide on motion: the reactive layer below moves the robot. From the deliberative layer above it requests a
path where there is none that can be followed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING

from elastic_strips.errors import ParameterError, missing_extra, plural

if TYPE_CHECKING:
    from .tree import Tree

_Answer = tuple["bool | None", str]


class Order(str, Enum):
    """The next action: follow the strip, wait, request another path, or end."""

    FOLLOW = "follow"
    WAIT = "wait"
    REQUEST_PATH = "ask for a path"
    DONE = "done"
    GIVE_UP = "give up"


@dataclass(frozen=True, slots=True)
class Blackboard:
    """Inputs of the sequencing layer in a tick.

    Attributes:
        scene_age: age of the newest scene [s].
        localized: whether the robot is localized.
        trouble: why the strip cannot be followed; empty where it can.
        planning: whether a requested path is being planned.
        attempts: paths requested in this step so far.
        reached: number of reached steps.
    """

    scene_age: float = 0.0
    localized: bool = True
    trouble: str = ""
    planning: bool = False
    attempts: int = 0
    reached: int = 0


class SequencingLayer:
    """Workspace: the behaviour tree of a task with these steps.

    Args:
        steps: descriptions of the steps; at least one.
        max_scene_age: largest age [s] of a scene; the robot waits while it is older.
        max_attempts: paths that are requested in one step before the task is given up.

    Attributes:
        order, reason: order of the last tick, and why.

    Raises:
        ParameterError: no step, or no attempt.
        MissingExtraError: py_trees (extra ``control``) is not installed.
    """

    def __init__(self, steps: Sequence[str], *, max_scene_age: float = 0.2, max_attempts: int = 8) -> None:
        if not steps:
            raise ParameterError("SequencingLayer: steps is empty; a task without steps cannot be done")
        if max_attempts < 1:
            raise ParameterError(f"SequencingLayer: max_attempts={max_attempts!r} must be at least 1")
        self.order: Order = Order.WAIT
        self.reason: str = "not started"
        self._age, self._attempts = max_scene_age, max_attempts
        self._board = Blackboard()
        self._tree = self._build(steps)

    def tick(self, board: Blackboard) -> Order:
        """Take in the blackboard, and decide."""
        self._board = board
        ended = self._tree.tick()
        if ended:
            self.order, self.reason = Order.DONE, "all steps are done"
        elif ended is False:
            self.order = Order.GIVE_UP
        return self.order

    def drawing(self, *, unicode: bool = True) -> str:
        """The tree as text, with the state of every node in the last tick."""
        return self._tree.text(unicode=unicode)

    def dot(self) -> str:
        """The tree in the language of Graphviz; ``dot -Tsvg`` draws it."""
        return self._tree.dot()

    def _build(self, steps: Sequence[str]) -> Tree:
        try:
            from .tree import Tree
        except ImportError as error:
            raise missing_extra("the sequencing layer", "py_trees", "control") from error
        return Tree(
            [(name, partial(self._there, k)) for k, name in enumerate(steps)],
            [("scene is fresh", self._fresh), ("robot knows where it is", self._localized)],
            usable=self._usable,
            request=self._request,
            follow=self._follow,
        )

    # the leaves

    def _there(self, index: int) -> _Answer:
        done = self._board.reached > index
        return done, "done" if done else ""

    def _fresh(self) -> _Answer:
        age = self._board.scene_age
        return (True, "") if age <= self._age else self._wait(f"the scene is {age:.2f} s old")

    def _localized(self) -> _Answer:
        return (True, "") if self._board.localized else self._wait("odometry is lost")

    def _usable(self) -> _Answer:
        board = self._board
        return not board.trouble and not board.planning, board.trouble

    def _request(self) -> _Answer:
        board = self._board
        if board.planning:
            return self._wait("the deliberative layer is planning")
        if board.attempts >= self._attempts:
            self.reason = f"{plural(board.attempts, 'path')} could not be used: {board.trouble}"
            return False, self.reason
        self.order, self.reason = Order.REQUEST_PATH, board.trouble
        return None, board.trouble

    def _follow(self) -> _Answer:
        self.order, self.reason = Order.FOLLOW, "the strip is followed"
        return None, self.reason

    def _wait(self, reason: str) -> _Answer:
        self.order, self.reason = Order.WAIT, reason
        return None, reason
