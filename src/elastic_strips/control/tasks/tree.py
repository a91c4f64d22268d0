"""Tree: the sequencing layer's behaviour tree; the only file that imports py_trees."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from py_trees import display
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Selector
from py_trees.composites import Sequence as All

_Check = Callable[[], tuple["bool | None", str]]
"""Whether a condition holds or an action is done (None: it goes on), and a feedback message."""


class _Leaf(Behaviour):
    """A condition or an action that is evaluated in every tick."""

    def __init__(self, name: str, check: _Check) -> None:
        super().__init__(name)
        self._check = check

    def update(self) -> Status:
        """Evaluate."""
        holds, self.feedback_message = self._check()
        return Status.RUNNING if holds is None else Status.SUCCESS if holds else Status.FAILURE

    def terminate(self, new_status: Status) -> None:
        """Clear the message of an action that has been interrupted."""
        if new_status is Status.INVALID:
            self.feedback_message = ""


class Tree:
    """The steps in sequence: each is done where the robot is there, else the robot goes there.

    Args:
        steps: name of each step, in order, and the condition that the robot is there.
        conditions: names and conditions that have to hold before the strip can be followed.
        usable: condition that there is a strip to follow.
        request: action where there is no such strip.
        follow: action where there is one.
    """

    def __init__(
        self,
        steps: Sequence[tuple[str, _Check]],
        conditions: Sequence[tuple[str, _Check]],
        *,
        usable: _Check,
        request: _Check,
        follow: _Check,
    ) -> None:
        self.root = All("task", memory=True)
        for number, (name, there) in enumerate(steps, 1):
            strip = Selector("a strip to follow", memory=False)
            strip.add_children([_Leaf("strip is usable", usable), _Leaf("ask the deliberative layer", request)])
            go = All("go there", memory=False)
            go.add_children([_Leaf(*condition) for condition in conditions])
            go.add_children([strip, _Leaf("follow the strip", follow)])
            both = Selector(f"{number}. {name}", memory=False)
            both.add_children([_Leaf("is there", there), go])
            self.root.add_child(both)

    def tick(self) -> bool | None:
        """Tick the root once; True where all is done, False where it has failed, None where it goes on."""
        self.root.tick_once()
        return {Status.SUCCESS: True, Status.FAILURE: False}.get(self.root.status)

    def text(self, *, unicode: bool) -> str:
        """The tree with the state of every node in the last tick."""
        draw = display.unicode_tree if unicode else display.ascii_tree
        return draw(self.root, show_status=True)

    def dot(self) -> str:
        """The tree in the language of Graphviz."""
        return display.dot_tree(self.root).to_string()
