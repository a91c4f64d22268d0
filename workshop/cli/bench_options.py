"""What the commands of the workshop have in common: options, and how times are written."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TypeVar

import click

from elastic_strips.cli import options

METHOD = options.LateChoice("workshop.baselines", "DRIVE_METHODS")
"""Names of what steers."""
BASE_METHOD = options.LateChoice("workshop.baselines", "BASE_METHODS")
_F = TypeVar("_F", bound=Callable[..., object])


def figures_option(command: _F) -> _F:
    """``--json`` of the figures."""
    return options.json_option("Write all figures.")(command)


def runs_option(command: _F) -> _F:
    """``--json`` of the figures and of every run."""
    return options.json_option("Write all figures and runs.")(command)


def seeds_option(default: int, help: str, most: int = 100_000) -> Callable[[_F], _F]:
    """``--seeds``: how many."""
    return click.option("--seeds", type=click.IntRange(1, most), default=default, show_default=True, help=help)


def scenario_option(default: str, help: str = "A seeded scenario.") -> Callable[[_F], _F]:
    """``--scenario``."""
    return click.option(
        "--scenario", type=options.SEEDED, default=default, show_default=True, metavar="NAME", help=help
    )


class _DataFolder(click.Path):
    """A folder with published data; where the data is not, what it is and where it comes from is said."""

    def __init__(self, needed: str, about: str) -> None:
        super().__init__(exists=True, file_okay=False)
        self._needed, self._about = needed, about

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        folder = str(super().convert(value, param, ctx))
        if not os.path.exists(os.path.join(folder, self._needed)):
            self.fail(f"{folder!r} has no {self._needed}: {self._about}", param, ctx)
        return folder


def root_option(needed: str, about: str, *, required: bool = True) -> Callable[[_F], _F]:
    """``--root``: the folder of published data; what has to be in it, and where that comes from."""
    return click.option(
        "--root",
        required=required,
        metavar="DIR",
        type=_DataFolder(needed, about),
        help=f"Folder that holds {needed}: {about}",
    )


def house_option(*, required: bool = True) -> Callable[[_F], _F]:
    """``--root`` of the furnished house."""
    return root_option(
        "house/house.json",
        "AWS RoboMaker's small house (github.com/aws-robotics/aws-robomaker-small-house-world) as convex pieces; "
        "workshop.datasets reads it.",
        required=required,
    )


def times(figure: dict[str, float | None]) -> str:
    """Percentiles [ms] as a text."""
    if figure["p50"] is None:
        return "-"
    return ", ".join(f"{p} {figure[p]:.2f}" for p in ("p50", "p95", "p99")) + " ms"
