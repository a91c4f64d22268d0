"""Tree: leaves and shape of the sequencing layer's behaviour tree; the only file that knows py_trees."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from py_trees import display
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Selector
from py_trees.composites import Sequence as All

_Question = Callable[[], tuple["bool | None", str]]
"""Whether something holds (None: not yet), and what is going on."""


class _Leaf(Behaviour):
    """A question that is asked anew in every tick."""

    def __init__(self, name: str, question: _Question) -> None:
        super().__init__(name)
        self._question = question

    def update(self) -> Status:
        """Ask."""
        holds, self.feedback_message = self._question()
        return Status.RUNNING if holds is None else Status.SUCCESS if holds else Status.FAILURE

    def terminate(self, new_status: Status) -> None:
        """Forget what went on where it no longer does."""
        if new_status is Status.INVALID:
            self.feedback_message = ""


class Tree:
    """The steps one after the other: each is done where the robot is there, else it goes there.

    Args:
        steps: name of each, in their order, and the question whether the robot is there.
        conditions: name and question of what has to hold before the strip can be followed.
        usable: whether there is a strip to follow.
        ask: what is done where there is none.
        follow: what is done where there is one.
    """

    def __init__(
        self,
        steps: Sequence[tuple[str, _Question]],
        conditions: Sequence[tuple[str, _Question]],
        *,
        usable: _Question,
        ask: _Question,
        follow: _Question,
    ) -> None:
        self.root = All("task", memory=True)
        for number, (name, there) in enumerate(steps, 1):
            strip = Selector("a strip to follow", memory=False)
            strip.add_children([_Leaf("strip is usable", usable), _Leaf("ask the deliberative layer", ask)])
            go = All("go there", memory=False)
            go.add_children([_Leaf(*condition) for condition in conditions])
            go.add_children([strip, _Leaf("follow the strip", follow)])
            both = Selector(f"{number}. {name}", memory=False)
            both.add_children([_Leaf("is there", there), go])
            self.root.add_child(both)

    def tick(self) -> bool | None:
        """One tick from the root: True where all is done, False where it has failed, None where it goes on."""
        self.root.tick_once()
        return {Status.SUCCESS: True, Status.FAILURE: False}.get(self.root.status)

    def text(self, *, unicode: bool) -> str:
        """The tree with the state of every node in the last tick."""
        draw = display.unicode_tree if unicode else display.ascii_tree
        return draw(self.root, show_status=True)

    def dot(self) -> str:
        """The tree in Graphviz' language."""
        return display.dot_tree(self.root).to_string()
