"""Options of the user's own robot: which joints are planned, which are held still, and where files are."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING

import click

from elastic_strips.catalogue import is_known
from elastic_strips.errors import RobotError, listed, plural

from . import output
from .options import Finite, JointValue

if TYPE_CHECKING:
    from elastic_strips.robot import LoadOptions, RobotModel
    from elastic_strips.sim.scenarios import Scenario

_ROBOTS_NAMED = 12  # in a message


_OPTIONS = (
    click.option("--joints", metavar="NAMES", help="Plan these joints, separated by commas, and no others."),
    click.option(
        "--lock",
        multiple=True,
        metavar="NAME=VALUE",
        type=JointValue(Finite()),
        help="A joint to hold still [rad or m], together with the joints that mimic it; wheels, and grippers that "
        "mimic, are held still anyway. May be repeated.",
    ),
    click.option(
        "--srdf",
        metavar="FILE",
        type=click.Path(),
        help="The SRDF file, with link pairs to ignore, a home posture and groups of joints.",
    ),
    click.option(
        "--package-dir",
        multiple=True,
        metavar="DIR",
        type=click.Path(file_okay=False, exists=True),
        help="A folder in which package:// meshes of a robot's file are looked for. May be repeated.",
    ),
    click.option(
        "--xacro-arg",
        multiple=True,
        metavar="NAME=VALUE",
        help="An argument of the robot's xacro file, as after xacro's :=. May be repeated.",
    ),
    click.option(
        "--visual-as-collision",
        multiple=True,
        metavar="LINK|missing",
        help="A link whose visual shapes are taken as its collision shapes; missing: every link without collision "
        "shapes. May be repeated.",
    ),
    click.option(
        "--looking",
        metavar="NAMES",
        help="Joints that are not planned and may turn at any time, such as those of a head, separated by commas: what "
        "hangs on them counts as all the space that it passes through, and a depth camera of --sensors looks around "
        "with them.",
    ),
)


def robot_options(command: Callable[..., int]) -> Callable[..., int]:
    """``--joints``, ``--lock``, ``--srdf``, ``--package-dir``, ``--xacro-arg``, ``--visual-as-collision`` and
    ``--looking``, as one argument ``described`` for ``load_robot``."""

    @wraps(command)
    def with_options(
        *,
        joints: str | None,
        lock: tuple[tuple[str, float], ...],
        srdf: str | None,
        package_dir: tuple[str, ...],
        xacro_arg: tuple[str, ...],
        visual_as_collision: tuple[str, ...],
        looking: str | None,
        **others: object,
    ) -> int:
        described: LoadOptions = {}
        if joints is not None:
            described["joints"] = [name.strip() for name in joints.split(",") if name.strip()]
        if lock:
            described["locked"] = dict(lock)
        if srdf is not None:
            described["srdf"] = srdf
        if package_dir:
            described["package_dirs"] = package_dir
        if xacro_arg:
            for given in xacro_arg:
                if not given.partition("=")[0].strip(": ") or "=" not in given:
                    raise click.UsageError(f"--xacro-arg {given!r} must be NAME=VALUE, such as --xacro-arg arm=true")
            parts = (given.partition("=") for given in xacro_arg)
            described["mappings"] = {name.strip(": "): value for name, _, value in parts}
        if visual_as_collision:
            missing = "missing" in visual_as_collision
            if missing and len(visual_as_collision) > 1:
                raise click.UsageError("--visual-as-collision missing means all such links; name no others besides")
            described["visual_as_collision"] = "missing" if missing else visual_as_collision
        if looking is not None:
            described["looking"] = [name.strip() for name in looking.split(",") if name.strip()]
        return command(described=described, **others)

    for option in reversed(_OPTIONS):
        with_options = option(with_options)
    return with_options


def load_robot(
    problem: Scenario, robot: str | None, described: LoadOptions, preset: str | None = None, base: str | None = None
) -> RobotModel:
    """The scenario's robot, or another one; for a robot from a file it prints what is planned, and what is not.

    Raises:
        RobotError: unknown robot, or an error in its files.
    """
    model = problem.load_robot(robot, preset, base, described)
    if described or not is_known(robot or problem.robot):
        joints = model.joint_names
        output.say(
            f"{model.name} plans {plural(len(joints), 'joint')}: {_list(joints)}; "
            + (f"following: {_list(tuple(model.followers))}; " if model.followers else "")
            + f"locked: {_list(tuple(model.locked))}"
            + (f"; {model.unproven}" if model.unproven else "")
        )
        say_assumed_base(model, named=bool(is_known(robot or problem.robot) or base or problem.base))
    return model


def say_assumed_base(robot: RobotModel, *, named: bool) -> None:
    """Note how a robot's base moves, where nobody has said so."""
    if not named and robot.base_kind.value == "diff_drive":
        output.say(("note:", output.NOTE), f" {_assumed_base(robot)}")


def _assumed_base(robot: RobotModel) -> str:
    said = f"the base of {robot.name} is taken to move as by a differential drive (--base diff_drive, omni or fixed)"
    try:
        return f"{said}, with the wheels of {robot.wheels.joints[0]} and {robot.wheels.joints[1]}"
    except RobotError as error:
        return f"{said}, but {error}"


def _list(names: tuple[str, ...]) -> str:
    return listed(names, _ROBOTS_NAMED) or "none"
