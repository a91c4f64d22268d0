"""Options of how the files of a scene are read: poses, heights, and unknown space."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING

import click

from elastic_strips.errors import plural

from . import options

SCENE_FILES = (
    "The obstacles: .yaml, such as obstacles: [{shape: box, size: [1, 1, 2], at: [2, 0, 1]}]; MoveIt's .scene, or a "
    "PlanningScene (.yaml, .json); OctoMap's .bt or .ot; a Nav2 map's .yaml; a point cloud with --voxel. May be "
    "repeated."
)
_HEIGHT = options.Finite(-1000.0, 1000.0)
_LENGTH = options.Finite(0.0, 100.0, min_open=True)


if TYPE_CHECKING:
    _PoseType = click.ParamType[tuple[float, ...]]
else:  # of click 8.1 it cannot be told of what
    _PoseType = click.ParamType


class Pose(_PoseType):
    """Numbers with commas: x,y,z; x,y,z,yaw; x,y,z,qx,qy,qz,qw; or as many as ``counts`` says."""

    name = "pose"

    def __init__(self, *counts: int) -> None:
        self.counts: tuple[int, ...] = counts or (3, 4, 7)

    def convert(
        self, value: str | tuple[float, ...], param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
        number = options.Finite()
        found = tuple(float(number(word.strip(), param, ctx)) for word in value.split(","))
        if len(found) not in self.counts:
            *some, last = map(str, self.counts)
            wanted = f"{', '.join(some)} or {last}" if some else last
            self.fail(f"{value!r} has {plural(len(found), 'number')}; {wanted} with commas are needed", param, ctx)
        return found


_OPTIONS = (
    click.option(
        "--at",
        metavar="POSE",
        type=Pose(),
        help="Where the scene file's frame is in the world: x,y,z or x,y,z,yaw or x,y,z,qx,qy,qz,qw [m, rad].",
    ),
    click.option(
        "--low",
        metavar="Z",
        type=_HEIGHT,
        help="Where a map's walls begin [m]; what is below, such as the floor, is left out of octrees and clouds.",
    ),
    click.option(
        "--high",
        metavar="Z",
        type=_HEIGHT,
        help="How high a map's walls are [m], by default as high as the robot reaches; what is above is left out "
        "of octrees and clouds.",
    ),
    click.option(
        "--unknown",
        type=click.Choice(["free", "occupied"]),
        help="What a map's unknown cells count as.  [default: free]",
    ),
    click.option(
        "--outside",
        type=click.Choice(["blocked", "free"]),
        help="What the space outside a map counts as.  [default: blocked]",
    ),
    click.option("--voxel", metavar="M", type=_LENGTH, help="Edge length of the cells that a point cloud fills [m]."),
    click.option(
        "--own-points",
        metavar="M",
        type=options.Finite(0.0, 10.0),
        help="Points of a cloud within this distance [m] of the robot, where PATH begins, are taken for the robot and "
        "left out.",
    ),
    click.option(
        "--planes", type=click.Choice(["blocked", "free"]), help="What MoveIt's planes count as.  [default: blocked]"
    ),
)
_READING = ("at", "low", "high", "unknown", "outside", "voxel", "own_points", "planes")
"""What they are called in `SceneOptions`, too."""


def scene_options(command: Callable[..., int]) -> Callable[..., int]:
    """``--at``, ``--low``, ``--high`` and others, as one argument ``reading`` for ``read_scene_file``."""

    @wraps(command)
    def with_options(**given: object) -> int:
        reading = {name: value for name in _READING if (value := given.pop(name)) is not None}
        return command(reading=reading, **given)

    for option in reversed(_OPTIONS):
        with_options = option(with_options)
    return with_options
