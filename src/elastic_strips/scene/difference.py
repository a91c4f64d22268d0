"""Difference: what a scene has that the one before it did not have, for another process that knows that one."""

from __future__ import annotations

from .obstacle import Obstacle
from .scene import Scene

SceneDifference = tuple[float | None, str, str, list[int | Obstacle]]
"""Stamp [s], what holds the scene up, what is odd about it, and its obstacles: the new ones, and places of others in
the scene before."""


def difference(scene: Scene, before: Scene | None) -> SceneDifference:
    """What is new in a scene; obstacles that are the same objects as before are told by their place alone."""
    known = {id(o): k for k, o in enumerate(before or ())}
    return scene.stamp, scene.held_up, scene.remark, [known.get(id(o), o) for o in scene]


def with_difference(before: Scene | None, new: SceneDifference) -> Scene:
    """The scene again, where the one ``before`` is known; what was there before are the same objects."""
    stamp, held_up, remark, things = new
    known = () if before is None else before.obstacles
    return Scene([known[o] if isinstance(o, int) else o for o in things], time=stamp, held_up=held_up, remark=remark)
