"""View options: the viewer that a command opens, the page that it writes."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

import click

from elastic_strips.errors import ElasticStripsError

if TYPE_CHECKING:
    from elastic_strips.viewer import Viewer

TITLE = "elastic strip"

browser_option = click.option(
    "--no-browser", is_flag=True, help="Print the address of the picture; do not open the default browser."
)


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
