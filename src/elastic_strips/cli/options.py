"""What several commands have in common: options, the progress bar, and the viewer that they open."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, TypeVar

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from elastic_strips.errors import ElasticStripsError, InputError
from elastic_strips.files import check_writable

if TYPE_CHECKING:
    from elastic_strips.sim.sensors import SensorConfig
    from elastic_strips.viewer import Viewer

EXIT_DONE, EXIT_NOT_DONE = 0, 3
"""Exit codes: certified or reached; or not."""
SEED = click.IntRange(0, 2**31 - 1)
TITLE = "elastic strip"
"""Headline of a picture."""
_PATIENCE = 2.0
_F = TypeVar("_F", bound=Callable[..., object])


class OutputFile(click.Path):
    """A file that can be written."""

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        check_writable(value)
        return value


class Finite(click.FloatRange):
    """A finite number, within a range where one is given; click's own ranges let NaN through."""

    def convert(self, value: float, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{number} is not a finite number.", param, ctx)
        return number


def robot_option(default: str | None = None, help: str = "The robot.") -> Callable[[_F], _F]:
    """``--robot``."""
    return click.option("--robot", default=default, show_default=True, metavar="NAME|FILE.urdf", help=help)


def base_option(help: str = "How the base moves; the robot's own by default.") -> Callable[[_F], _F]:
    """``--base``."""
    return click.option("--base", type=click.Choice(["diff_drive", "omni", "fixed"]), help=help)


def json_option(help: str) -> Callable[[_F], _F]:
    """``--json``: a file that can be written, or None."""
    return click.option("--json", "json_file", metavar="FILE", type=OutputFile(), help=help)


def html_option(help: str) -> Callable[[_F], _F]:
    """``--html``: the name of a page, or None."""
    return click.option("--html", "html_file", metavar="FILE", type=click.Path(), help=help)


processes_option = click.option(
    "--processes", type=click.IntRange(1, 256), help="How many runs at once; one for each core by default."
)
compute_option = click.option(
    "--compute", metavar="FACTOR|work|free",
    help="What computing costs in simulated time: so many times the processor time that it takes here [default: 1]; "
    "work: the time that is modelled for the work that was counted, alike everywhere; free: nothing.",
)  # fmt: skip
evade_option = click.option(
    "--evade/--no-evade",
    default=None,
    help="Leave the strip where something moving comes [default], or only brake and wait.",
)
sensors_option = click.option(
    "--sensors", metavar="NAMES|FILE.yaml",
    help="Drive by what the robot's simulated sensors see, not by the scene: all, or some by name (laser,sonar), of "
    "the Silvermate's, or TIAGo's laser; or those of a file (docs/sensors.md).",
)  # fmt: skip

level_option = click.option(
    "--level", metavar="FRAME", default="",
    help="A frame of the robot that stays as level as it is at the start: a tray, or a hand with a cup.",
)  # fmt: skip

browser_option = click.option(
    "--no-browser", is_flag=True, help="Print the address of the picture; do not open the default browser."
)


def sensors_of(text: str | None, robot: str) -> SensorConfig | None:
    """The sensors that the option names, of a robot that is named; None where it was not given.

    Raises:
        ParameterError: no such sensor, or a file that is none of sensors.
    """
    if text is None:
        return None
    from elastic_strips.sim.sensors import named_sensors  # for those alone who drive by sensors

    return named_sensors(text, robot)


def check_outputs(scenario: str, *files: str | None) -> None:
    """Check that every output can be written, and none would overwrite the scenario or another output.

    Raises:
        InputError: a file that cannot be written, or that is named twice.
    """
    taken = {Path(scenario).absolute()}
    for name in files:
        if name is None:
            continue
        path = check_writable(name).absolute()
        if path in taken:
            raise InputError(f"{name}: is named twice; each output needs a file of its own")
        taken.add(path)


class LateProgress:
    """Context manager: call :meth:`step` often; after two seconds a bar is drawn on standard error, if that is a
    terminal.

    Args:
        label: what is being done.
        total: number of steps, or None where it is not known.
    """

    def __init__(self, label: str, total: int | None = None) -> None:
        self._label, self._total = label, total
        self._console = Console(stderr=True)
        self._progress: Progress | None = None
        self._count = 0

    def __enter__(self) -> LateProgress:
        self._begin = perf_counter()
        return self

    def step(self, note: str = "") -> None:
        """One step is done; ``note`` is shown beside the bar."""
        self._count += 1
        if self._progress is None and self._console.is_terminal and perf_counter() - self._begin > _PATIENCE:
            columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
                       TextColumn("{task.fields[note]}"))  # fmt: skip
            self._progress = Progress(*columns, console=self._console, transient=True)
            self._task = self._progress.add_task(self._label, total=self._total, note=note)
            self._progress.start()
        if self._progress is not None:
            self._progress.update(self._task, completed=self._count, note=note)

    def __exit__(self, *_: object) -> None:
        if self._progress is not None:
            self._progress.stop()


class ViewerFailure(ElasticStripsError):
    """There is no picture, through no fault of the input."""


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


def write_page(draw: Callable[[Viewer], object], file: str, *, title: str = TITLE) -> None:
    """Write what ``draw`` shows as a standalone page.

    Raises:
        ViewerFailure: it cannot be drawn.
        InputError: the file cannot be written.
    """
    from elastic_strips.viewer import Viewer

    with Viewer(server=False, title=title) as viewer:
        draw(viewer)
        page = viewer.save_html(file)
        if not viewer.alive:
            raise ViewerFailure(f"{page}: the picture could not be drawn; the page is not complete")
    click.echo(f"page    {page}")


def serve(draw: Callable[[Viewer], object], *, no_browser: bool, title: str = TITLE) -> None:
    """Serve what ``draw`` shows on this machine until Ctrl-C.

    Raises:
        ViewerFailure: the server does not start.
    """
    with open_viewer(no_browser=no_browser, title=title) as viewer:
        draw(viewer)
        click.echo(f"viewer  {viewer.url}  (Ctrl-C ends)")
        viewer.wait()
