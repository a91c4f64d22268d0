"""Resources: finds the robot descriptions that come with the package, and those of example-robot-data."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

from elastic_strips.errors import RobotError


def urdf_dir() -> Path:
    """Return the directory that holds the URDFs that come with elastic_strips.

    A wheel carries a copy inside the package; an editable install reads the checkout's top-level ``urdf/``.

    Raises:
        RobotError: Neither directory exists.
    """
    package = Path(__file__).resolve().parent
    tried = (package / "urdf", package.parents[1] / "urdf")
    for directory in tried:
        if directory.is_dir():
            return directory
    raise RobotError(
        f"the robot descriptions are missing: neither {tried[0]} (installed) nor {tried[1]} (checkout) is a directory; "
        "install the package again, or give the path of a URDF."
    )


@cache
def example_robot_data() -> Path | None:
    """Return the ``share`` folder that holds example-robot-data; None where the package is not installed."""
    import cmeel

    places = [Path(p) / "cmeel.prefix/share" for p in (*cmeel.__path__, *sys.path)]
    places += [Path(p).parent / "cmeel.prefix/share" for p in cmeel.__path__]
    return next((place for place in places if (place / "example-robot-data/robots").is_dir()), None)
