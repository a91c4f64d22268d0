"""``elastic-strips view``: look at a scenario before running it, or at a result."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from ..errors import InputError
from ..io import check_writable
from ..planning import straight_line
from ..robot import load_robot, robot_names
from ..scenarios import FORMAT, FORMAT_VERSION, get_scenario
from ..scene import Box, Capsule, Cone, ConvexHull, Cylinder, Obstacle, Scene, Sphere
from ..strip import Strip


@click.command(short_help="Look at a scenario, or at a result of run --json.")
@click.argument("what", metavar="NAME|FILE.yaml|RESULT.json")
@click.option("--robot", metavar="NAME|FILE.urdf", help="Another robot than the scenario's.")
@click.option(
    "--base", type=click.Choice(["diff_drive", "omni", "fixed"]), help="How the base moves; the robot's own by default."
)
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=0, help="Seed of generated scenes.")
@click.option(
    "--html", "html_file", metavar="FILE", type=click.Path(), help="Write a standalone page instead of serving one."
)
def view(what: str, robot: str | None, base: str | None, seed: int, html_file: str | None) -> None:
    """Show a scenario with the straight strip from start to goal, or the strip of a result file, in the browser.

    The server listens on this machine only; Ctrl-C ends it.
    """
    from ..viewer import Viewer

    if html_file is not None:
        check_writable(html_file)
    if what.lower().endswith(".json"):
        model, scene, strip = _from_result(Path(what), robot)
    else:
        problem = get_scenario(what, seed=seed)
        model, scene = problem.load_robot(robot, base=base), problem.scene
        strip = Strip.from_chart(model, straight_line(model, *problem.ends(model), spacing=0.13))
    with Viewer(server=html_file is None, open_browser=html_file is None and sys.stdout.isatty()) as viewer:
        viewer.animate(model, scene, strip, duration=10.0)
        if html_file is not None:
            click.echo(f"page    {viewer.save_html(html_file)}")
            return
        click.echo(f"viewer  {viewer.url}  (Ctrl-C ends)")
        viewer.wait()


def _from_result(path: Path, robot: str | None) -> tuple[Any, Scene, Strip]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not JSON: {error}") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InputError(f"{path}: is no result of 'elastic-strips run --json' (format {FORMAT!r})")
    if document.get("version") != FORMAT_VERSION:
        raise InputError(f"{path}: format version {document.get('version')!r}; this program reads {FORMAT_VERSION}")
    try:
        name = robot or (document["robot"] if document["robot"] in robot_names() else document["urdf"])
        base, locked = document["base"], document["locked"]
        model = load_robot(name, base=base, locked=locked)
        scene = Scene([_obstacle(entry) for entry in document["obstacles"]])
        strip = Strip(model, document["strip"]["q"])
    except InputError as error:
        raise type(error)(f"{path}: {error}") from None
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        raise InputError(f"{path}: the result is damaged: {type(error).__name__}: {error}") from None
    return model, scene, strip


def _obstacle(entry: dict[str, Any]) -> Obstacle:
    place: dict[str, Any] = {"at": entry["pose"][:3], "quat": entry["pose"][3:], "name": entry["name"]}
    shape, size = entry["shape"], entry["size"]
    makers = {
        "box": lambda: Box(size, **place),
        "sphere": lambda: Sphere(*size, **place),
        "cylinder": lambda: Cylinder(*size, **place),
        "capsule": lambda: Capsule(*size, **place),
        "cone": lambda: Cone(*size, **place),
        "convex": lambda: ConvexHull(size, **place),
    }
    return makers[shape]()
