"""What the commands of ``elastic-strips bench`` have in common: options, and how times are written."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import click

from . import options

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


def root_option(what: str) -> Callable[[_F], _F]:
    """``--root``: the folder of published data; ``what`` is in it, and where it comes from."""
    return click.option(
        "--root", required=True, metavar="DIR", type=click.Path(exists=True, file_okay=False),
        help=f"Folder that holds {what}",
    )  # fmt: skip


def times(figure: dict[str, float | None]) -> str:
    """Percentiles [ms] as a text."""
    if figure["p50"] is None:
        return "-"
    return ", ".join(f"{p} {figure[p]:.2f}" for p in ("p50", "p95", "p99")) + " ms"
