"""``elastic-strips view``: look at a scenario before running it, at a result, or at a recorded drive."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from elastic_strips.catalogue import recorded_robot
from elastic_strips.errors import InputError, RobotError

from . import options

if TYPE_CHECKING:
    from elastic_strips.control import Record
    from elastic_strips.robot import RobotModel
    from elastic_strips.scene import Scene
    from elastic_strips.strip import Strip
    from elastic_strips.viewer import Viewer


_TAKES = {"a scenario": ("--base", "--seed"), "a result": (), "a record": ("--speed", "--begin", "--end")}
_ELSEWHERE = {
    ".csv": "a path, or the rows of a record without its world: 'elastic-strips certify {} --robot … --scene … --view' "
    "shows a path, and 'elastic-strips view' the .npz file of a record",
    ".urdf": "a robot: 'elastic-strips robot {}' says what is known of it, also with --html and --png",
}
_ELSEWHERE[".xacro"] = _ELSEWHERE[".urdf"]
_KINDS = {".json": "a result", ".npz": "a record"}


@click.command()
@click.argument("what", metavar="NAME|FILE.yaml|RESULT.json|RECORD.npz", type=options.SCENARIO)
@options.robot_option(
    help="A robot other than the scenario's. For a result or a record: where its robot's file is now."
)
@options.base_option("For a scenario: how the base moves; the robot's own by default.")
@click.option("--seed", type=options.SEED, help="For a scenario: seed of generated scenes.  [default: 0]")
@click.option(
    "--speed",
    type=options.Finite(1e-3, 1e3),
    help="For a record: speed of the replay, as a multiple of the true one.  [default: 1]",
)
@click.option("--begin", type=options.Finite(0.0), help="For a record: time at which the replay begins [s].")
@click.option("--end", type=options.Finite(0.0), help="For a record: time at which the replay ends [s].")
@options.html_option("Write a standalone page instead of serving one.")
@options.picture_options
@options.browser_option
def view(
    what: str,
    robot: str | None,
    base: str | None,
    seed: int | None,
    speed: float | None,
    begin: float | None,
    end: float | None,
    html_file: str | None,
    png_file: str | None,
    film_file: str | None,
    no_browser: bool,
) -> None:
    """Show in the browser: a scenario with the straight strip from start to goal, the strip of a result file, or a
    recorded drive, replayed.

    The server listens on this machine only; Ctrl-C ends it.
    """
    from elastic_strips.planning import straight_line
    from elastic_strips.sim.scenarios import get_scenario
    from elastic_strips.strip import Strip

    options.check_outputs(what, html_file, png_file, film_file)
    suffix = Path(what).suffix.lower()
    if suffix in _ELSEWHERE:
        raise InputError(f"{what} is {_ELSEWHERE[suffix].format(what)}")
    kind = _KINDS.get(suffix, "a scenario")
    given = {"--base": base, "--seed": seed, "--speed": speed, "--begin": begin, "--end": end}
    for option, value in given.items():
        if value is not None and option not in _TAKES[kind]:
            raise click.UsageError(f"{option} is not for {kind}; {what} is one")
    title = options.TITLE
    if kind == "a record":
        record, model = _from_record(Path(what), robot)
        title = str(record.metadata.get("scenario") or Path(what).stem)

        def draw(viewer: Viewer) -> None:
            viewer.replay(model, record, speed=1.0 if speed is None else speed, begin=begin, end=end)
    else:
        if kind == "a result":
            model, scene, strip = _from_result(Path(what), robot)
            title = Path(what).stem
        else:
            problem = get_scenario(what, seed=seed or 0)
            title = problem.name
            model, scene = problem.load_robot(robot, base=base), problem.scene
            strip = Strip.from_coordinates(model, straight_line(model, *problem.ends(model), spacing=0.13))

        def draw(viewer: Viewer) -> None:
            viewer.animate(model, scene, strip, duration=10.0)

    if html_file or png_file or film_file:
        end_of_record = math.inf if kind == "a record" and begin is None else None  # as in the picture of its drive
        options.write_pictures(draw, html_file, png_file, film_file, title=title, moment=end_of_record)
    else:
        options.serve(draw, no_browser=no_browser, title=title)


def _from_record(path: Path, robot: str | None) -> tuple[Record, RobotModel]:
    from elastic_strips.io import read_record, record_robot

    record = read_record(path)
    try:
        return record, record_robot(record, robot)
    except InputError as error:
        hint = "; --robot FILE.urdf names it" if isinstance(error, RobotError) and robot is None else ""
        raise type(error)(f"{path}: {error}{hint}") from None


def _from_result(path: Path, robot: str | None) -> tuple[RobotModel, Scene, Strip]:
    from elastic_strips.io.nodes import load_json
    from elastic_strips.io.obstacle_document import obstacle_from_piece
    from elastic_strips.robot import load_robot
    from elastic_strips.scene import Scene
    from elastic_strips.sim.scenarios.drive import DRIVE_FORMAT
    from elastic_strips.sim.scenarios.run import FORMAT, FORMAT_VERSION
    from elastic_strips.strip import Strip

    document = load_json(path, what="result", error=InputError).value
    if isinstance(document, dict) and document.get("format") == DRIVE_FORMAT:
        raise InputError(
            f"{path}: holds the figures of a drive, but not its motion; 'elastic-strips drive --record' writes that"
        )
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InputError(f"{path}: is not a result of 'elastic-strips run --json' (format {FORMAT!r})")
    if document.get("version") != FORMAT_VERSION:
        raise InputError(f"{path}: format version {document.get('version')!r}; this program reads {FORMAT_VERSION}")
    try:
        name = robot or recorded_robot(document["robot"], document["urdf"])
        if name is None:
            raise RobotError(f"the result names no URDF of {document['robot']!r}")
        model = load_robot(
            name, base=document["base"], joints=document["strip"].get("joint_names"), locked=document["locked"]
        )
        scene = Scene([obstacle_from_piece(piece) for piece in document["obstacles"]])
        strip = Strip(model, document["strip"]["q"])
    except InputError as error:
        raise type(error)(f"{path}: {error}") from None
    except (AttributeError, LookupError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{path}: the result is damaged: {type(error).__name__}: {error}") from None
    return model, scene, strip
