"""The common parts of several commands: options, what is checked before they begin, and the viewer that they open."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click
from click.shell_completion import CompletionItem

from elastic_strips.catalogue import FAULTS, PLANTS, PRESETS, SCENARIOS, find_robot, robot_names
from elastic_strips.errors import ElasticStripsError, InputError
from elastic_strips.files import check_writable

from . import output
from .progress_bar import LateProgress as LateProgress

if TYPE_CHECKING:
    from elastic_strips.robot import RobotModel
    from elastic_strips.sim.sensors import SensorConfig
    from elastic_strips.trajectory import MotionLimits
    from elastic_strips.viewer import Viewer

    _TextType, _ValueType = click.ParamType[str], click.ParamType[tuple[str, float]]
else:  # of click 8.1 it cannot be told of what
    _TextType = _ValueType = click.ParamType

EXIT_DONE, EXIT_NOT_DONE = 0, 3
"""Exit codes: certified or reached; or not."""
TITLE = "elastic strip"
"""Headline of a picture."""
_F = TypeVar("_F", bound=Callable[..., object])


class GoalText(click.ParamType):
    """A goal: X,Y[,YAW] of the base [m, rad], or FRAME@X,Y,Z of a frame of the robot [m]."""

    name = "X,Y[,YAW]|FRAME@X,Y,Z"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> object:
        frame, at, rest = str(value).rpartition("@")
        try:
            numbers = [float(text) for text in rest.split(",")]
        except ValueError:
            numbers = []
        if not all(map(math.isfinite, numbers)) or len(numbers) not in ((3,) if at else (2, 3)):
            self.fail(f"{value!r} must be {self.name}, numbers in m and rad", param, ctx)
        from elastic_strips.planning import BasePose, HandPose

        if at:
            x, y, z = numbers
            return HandPose(frame, (x, y, z))
        return BasePose(numbers[0], numbers[1], numbers[2] if len(numbers) > 2 else None)


class OutputFile(click.Path):
    """A file that can be written."""

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        check_writable(value)
        return value


class PictureFile(OutputFile):
    """A file that can be written and whose ending is one of those given; checked before anything is planned."""

    def __init__(self, *endings: str) -> None:
        super().__init__()
        self.endings = endings

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if os.path.splitext(value)[1].lower() not in self.endings:
            self.fail(f"{value!r} has to end in {', '.join(self.endings)}", param, ctx)
        return super().convert(value, param, ctx)


class JsonFile(OutputFile):
    """A file that can be written, or ``-`` for standard output, which then carries nothing else."""

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if value != output.STDOUT:
            return super().convert(value, param, ctx)
        if ctx is not None:
            output.leave_stdout_to_json(ctx)
        return value


class Whole(click.IntRange):
    """An integer within a range; click would call what it is not a valid "integer range"."""

    name = "integer"


class Finite(click.FloatRange):
    """A finite number, within a range where one is given; click's own ranges let NaN through."""

    name = "number"

    def convert(self, value: float, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{number} is not a finite number.", param, ctx)
        return number


SEED = Whole(0, 2**31 - 1)
_POSITIVE = Finite(0.0, min_open=True)


class BaseSpeed(_ValueType):
    """``X,Y,YAW``: three numbers above 0."""

    name = "speeds"

    def convert(
        self, value: str | tuple[float, ...], param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
        found = tuple(float(_POSITIVE(word.strip(), param, ctx)) for word in value.split(","))
        if len(found) != 3:
            self.fail(f"{value!r} is not X,Y,YAW: three numbers with commas, such as 0.4,0.4,0.8", param, ctx)
        return found


class JointValue(_ValueType):
    """``NAME=VALUE``: a joint and a number.

    Args:
        number: type of the number.
    """

    name = "text"

    def __init__(self, number: Finite) -> None:
        self._number = number

    def convert(
        self, value: str | tuple[str, float], param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, float]:
        if isinstance(value, tuple):
            return value
        name, found, number = value.rpartition("=")
        if not found or not name.strip():
            self.fail(f"{value!r} has to be NAME=VALUE, such as arm_5_joint=0.2", param, ctx)
        return name.strip(), float(self._number(number, param, ctx))


class LateChoice(_TextType):
    """One of the names that a module has; it is imported when they are asked for.

    Args:
        module: module of the names.
        name: name in a tuple, a mapping or an enumeration of names.
    """

    name = "choice"

    def __init__(self, module: str, name: str) -> None:
        self._module, self._name = module, name

    @property
    def choice(self) -> click.Choice[str]:
        """The same with its names."""
        names = getattr(import_module(self._module), self._name)
        return click.Choice([getattr(name, "value", name) for name in names])

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if ctx is not None and ctx.resilient_parsing:  # a shell completes another word
            return value
        return self.choice.convert(value, param, ctx)

    def get_metavar(self, *given: object, **named: object) -> str | None:
        return self.choice.get_metavar(*given, **named)  # type: ignore[arg-type] # of click 8.1, or of 8.2

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        return self.choice.shell_complete(ctx, param, incomplete)


class KnownName(_TextType):
    """A name that the catalogue has, or a file; a shell completes both.

    Args:
        names: gives names, and a line about each where there is one.
    """

    name = "text"

    def __init__(self, names: Callable[[], Mapping[str, str]], *, files: bool = True) -> None:
        self._names, self._files = names, files

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        found = [CompletionItem(name, help=help) for name, help in self._names().items() if name.startswith(incomplete)]
        return [*found, CompletionItem(incomplete, type="file")] if self._files else found


def _robot_names() -> dict[str, str]:
    return {name: find_robot(name).summary for name in robot_names()}


def _fault_kinds() -> dict[str, str]:
    return {kind.replace("_", "-"): what for kind, what in FAULTS.items()}


SCENARIO = KnownName(lambda: SCENARIOS)
SEEDED = KnownName(lambda: {name: text for name, text in SCENARIOS.items() if "(seeded" in text}, files=False)
ROBOT = KnownName(_robot_names)
ROBOT_FILES = "NAME|FILE.urdf|FILE.xacro"
FILE = KnownName(dict)
FAULT = KnownName(lambda: {f"{kind}@": what for kind, what in _fault_kinds().items()}, files=False)
FAULT_KIND = KnownName(_fault_kinds, files=False)
PLANT, PRESET = click.Choice(list(PLANTS)), click.Choice(list(PRESETS))
BASE = click.Choice(["diff_drive", "omni", "fixed"])


def robot_option(default: str | None = None, help: str = "The robot.") -> Callable[[_F], _F]:
    """``--robot``."""
    return click.option("--robot", type=ROBOT, default=default, show_default=True, metavar=ROBOT_FILES, help=help)


def base_option(
    help: str = "How the base moves; the robot's own by default, and diff_drive for a file.",
) -> Callable[[_F], _F]:
    """``--base``."""
    return click.option("--base", type=BASE, help=help)


@dataclass(frozen=True, slots=True)
class GivenLimits:
    """Limits of a robot from the command line, as for ``MotionLimits.for_robot``."""

    joint_speed: Mapping[str, float]
    wheel_speed: float | None
    track: float | None
    wheel_radius: float | None
    base_speed: tuple[float, ...] | None = None

    def __bool__(self) -> bool:
        return bool(self.joint_speed) or any((self.wheel_speed, self.track, self.wheel_radius, self.base_speed))

    def of(self, robot: RobotModel) -> MotionLimits:
        """All limits of a robot.

        Raises:
            ParameterError: a limit that is neither given nor stated by the robot's description, or of another robot.
        """
        from elastic_strips.trajectory import MotionLimits
        from elastic_strips.trajectory.limits import BASE_SPEED

        if robot.base_kind.value != "diff_drive" and any((self.wheel_speed, self.track, self.wheel_radius)):
            raise click.UsageError(
                f"--wheel-speed, --track and --wheel-radius are for a diff_drive base; that of {robot.name!r} is "
                f"{robot.base_kind.value}{': --base-speed says how fast it is' * (robot.base_kind.value == 'omni')}"
            )
        if self.base_speed is not None and robot.base_kind.value != "omni":
            wheels = ": --wheel-speed says how fast its wheels are" * (robot.base_kind.value == "diff_drive")
            raise click.UsageError(
                f"--base-speed is for an omni base; that of {robot.name!r} is {robot.base_kind.value}{wheels}"
            )
        return MotionLimits.for_robot(
            robot,
            joint_speed=self.joint_speed,
            wheel_speed=self.wheel_speed,
            track=self.track,
            wheel_radius=self.wheel_radius,
            base_speed=self.base_speed or BASE_SPEED,
        )


def limit_options(command: Callable[..., int]) -> Callable[..., int]:
    """``--joint-speed``, ``--wheel-speed``, ``--track``, ``--wheel-radius`` and ``--base-speed``, as one argument
    ``limits``."""

    @wraps(command)
    def with_limits(
        *,
        joint_speed: tuple[tuple[str, float], ...],
        wheel_speed: float | None,
        track: float | None,
        wheel_radius: float | None,
        base_speed: tuple[float, ...] | None,
        **others: object,
    ) -> int:
        given = GivenLimits(dict(joint_speed), wheel_speed, track, wheel_radius, base_speed)
        return command(limits=given, **others)

    with_limits = click.option(
        "--base-speed",
        type=BaseSpeed(),
        metavar="X,Y,YAW",
        help="Largest speeds of an omnidirectional base [m/s, m/s, rad/s]; 1,1,1.5 by default.",
    )(with_limits)

    for name, help in (
        ("--wheel-radius", "Radius of the driven wheels [m]; the URDF's by default."),
        ("--track", "Distance between the driven wheels [m]; the URDF's by default."),
        ("--wheel-speed", "Largest speed of a driven wheel's rim [m/s]; the URDF's by default."),
    ):
        with_limits = click.option(name, type=_POSITIVE, metavar="VALUE", help=help)(with_limits)
    return click.option(
        "--joint-speed",
        multiple=True,
        type=JointValue(_POSITIVE),
        metavar="NAME=VALUE",
        help="Largest speed of a joint [rad/s or m/s]; the URDF's by default. May be repeated.",
    )(with_limits)


def json_option(help: str) -> Callable[[_F], _F]:
    """``--json``: a file that can be written, ``-`` or None; for ``output.write_document``."""
    help = help.removesuffix(".") + " as JSON; - writes to standard output, and all other text goes to standard error."
    return click.option("--json", "json_file", metavar="FILE|-", type=JsonFile(), help=help)


def html_option(help: str) -> Callable[[_F], _F]:
    """``--html``: the name of a page, or None."""
    return click.option("--html", "html_file", metavar="FILE", type=click.Path(), help=help)


def picture_options(command: _F) -> _F:
    """``--png`` and ``--film``: names of a picture and a film, or None."""
    png = click.option(
        "--png", "png_file", metavar="FILE.png", type=PictureFile(".png"), help="Write a picture (needs Chromium)."
    )
    film = click.option(
        "--film",
        "film_file",
        metavar="FILE.gif|.mp4|.webm",
        type=PictureFile(".gif", ".mp4", ".webm"),
        help="Write a film (needs Chromium and the extra 'film').",
    )
    return png(film(command))


processes_option = click.option(
    "--processes", type=Whole(1, 256), help="How many runs to do at once; by default one per core."
)
compute_option = click.option(
    "--compute",
    metavar="FACTOR|work|free",
    help="What computing costs in simulated time. FACTOR: this many times the processor time that it takes here "
    "[default: 1]; work: a time modelled from the counted work, the same on every machine; free: nothing.",
)
evade_option = click.option(
    "--evade/--no-evade",
    default=None,
    help="Leave the strip to evade what moves towards the robot [default], or only brake and wait.",
)
goals_option = click.option(
    "--goal",
    "goals",
    multiple=True,
    type=GoalText(),
    help="A goal in place of the scenario's [m, rad]: of the base, with any heading if none is given, or of a frame "
    "of the robot. May be repeated for a drive: one after the other, without a stop where the way leads on.",
)
sensors_option = click.option(
    "--sensors",
    metavar="NAMES|FILE.yaml",
    help="Drive by what the robot's simulated sensors see, not by the true scene: names (laser,sonar; all; "
    "head-camera: the depth camera on the head of the Silvermate, TIAGo and Fetch; mast-lidar: a lidar above the "
    "Silvermate's; rear-laser: a second laser at its back), or a file of sensors, as "
    "elastic_strips.sim.sensors reads it.",
)

level_option = click.option(
    "--level",
    metavar="FRAME",
    default="",
    help="Keep this frame of the robot as level as it is at the start, such as a tray or a hand with a cup.",
)

browser_option = click.option(
    "--no-browser", is_flag=True, help="Print the address of the picture; do not open the default browser."
)


def sensors_of(text: str | None, robot: str) -> SensorConfig | None:
    """The sensors that the option names, of a robot that is named; None where it was not given.

    Raises:
        ParameterError: no such sensor, or a file that does not describe sensors.
    """
    if text is None:
        return None
    from elastic_strips.sim.sensors import named_sensors  # for those alone who drive by sensors

    return named_sensors(text, robot)


def check_outputs(scenario: str, *files: str | None) -> None:
    """Check that every output can be written, and none would overwrite another output, the scenario or another file
    that the command was given, by whatever name. They are written also where nobody reads what the command prints.

    Raises:
        InputError: a file that cannot be written, or that is named twice.
        BrowserError, MissingExtraError: a picture or a film, and nothing that draws it.
    """
    os.getcwd()  # names are of the working folder: where that was removed it is said at once
    context = click.get_current_context(silent=True)
    named = _texts(context.params) if context is not None else []
    for name in files:  # what is left is no output
        if name in named:
            named.remove(name)
    taken = [scenario, *(name for name in named if os.path.isfile(name))]
    for name in files:
        if name is None or name == output.STDOUT:
            continue
        if any(_same(name, other) for other in taken):
            raise InputError(f"{name}: is named twice; each output needs a file of its own")
        check_writable(name)
        taken.append(name)
    if context is not None:
        _check_pictures(context.params.get("png_file"), context.params.get("film_file"))
        if any(name is not None and name != output.STDOUT for name in files):
            output.write_also_unread(context)


def _check_pictures(png_file: str | None, film_file: str | None) -> None:
    """Check that there is what draws a picture and a film, before there is something to draw.

    Raises:
        BrowserError: there is no Chromium.
        MissingExtraError: the packages that write films are not installed.
    """
    if png_file is not None or film_file is not None:
        from elastic_strips.viewer.browser import need_browser

        need_browser()
    if film_file is not None:
        from elastic_strips.viewer.film import check_film

        check_film(film_file)


def _texts(value: object) -> list[str]:
    """All texts and paths in the values of a command's parameters: some of them may be files."""
    if isinstance(value, (str, Path)):
        return [str(value)]
    if isinstance(value, Mapping):
        return [text for each in value.values() for text in _texts(each)]
    return [text for each in value for text in _texts(each)] if isinstance(value, (tuple, list)) else []


def _same(one: str, two: str) -> bool:
    """Whether two names are of one file, or would be."""
    try:
        return os.path.samefile(one, two)
    except FileNotFoundError:  # one of them is not there yet
        return os.path.realpath(one) == os.path.realpath(two)
    except (OSError, ValueError):  # no file name
        return False


class ViewerFailure(ElasticStripsError):
    """There is no picture, and the input is not the cause."""


def open_viewer(*, no_browser: bool, title: str = TITLE) -> Viewer:
    """A live viewer; where standard output is a terminal, the default browser opens it.

    Raises:
        ViewerFailure: its server does not start.
    """
    from elastic_strips.viewer import Viewer  # not before something is shown: listing scenarios need not wait for it

    viewer = Viewer(title=title, open_browser=not no_browser and sys.stdout.isatty())
    if viewer.url is None:
        viewer.close()
        raise ViewerFailure("the viewer's server does not start (elastic-strips -v says why); --html writes a page")
    return viewer


def write_pictures(
    draw: Callable[[Viewer], object],
    html_file: str | None,
    png_file: str | None,
    film_file: str | None,
    *,
    title: str = TITLE,
    moment: float | None = None,
) -> None:
    """Write what ``draw`` shows as a standalone page, a picture and a film, as far as they are wanted.

    The picture is of a ``moment`` of what plays [s]: the first where None, the last where infinite.

    Raises:
        ViewerFailure: it cannot be drawn.
        BrowserError: there is no Chromium for picture and film.
        MissingExtraError: the packages that write films are not installed.
        InputError: a file cannot be written.
    """
    if html_file is None and png_file is None and film_file is None:
        return
    from elastic_strips.viewer import Viewer

    with Viewer(server=False, title=title) as viewer:
        draw(viewer)
        viewer.html()
        if not viewer.alive:
            raise ViewerFailure("the picture could not be drawn (elastic-strips -v says why)")
        if html_file is not None:
            output.say(f"page    {viewer.save_html(html_file)}")
        if png_file is not None:
            output.say(f"picture {viewer.save_png(png_file, time=moment)}")
        if film_file is not None:
            output.say(f"film    {viewer.save_film(film_file)}")


def serve(draw: Callable[[Viewer], object], *, no_browser: bool, title: str = TITLE) -> None:
    """Serve the picture of ``draw`` on this machine until Ctrl-C.

    Raises:
        ViewerFailure: the server does not start.
    """
    with open_viewer(no_browser=no_browser, title=title) as viewer:
        draw(viewer)
        output.say(f"viewer  {viewer.url}  (Ctrl-C ends)")
        viewer.wait()
