"""A sweep as a picture: a column over another one, with a colour for each value of a third; extra ``study``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from elastic_strips.errors import missing_extra, nearest_name, plural
from elastic_strips.files import atomic_write, check_writable
from elastic_strips.validation import check_choice, shown

from .document import Plot, Sweep, SweepError
from .runs import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DEFAULT_Y = {"plan": "clearance_m", "drive": "time_s"}
_MOST_HUES = 10


def plot_sweep(sweep: Sweep, rows: Sequence[Row], path: str | os.PathLike[str], *, plot: Plot | None = None) -> Plot:
    """Draw rows of a sweep: the median over all seeds and everything else that varies, and the middle half about it.

    For a column of true and false the share of true is drawn.

    Args:
        sweep: the sweep of the rows.
        rows: rows of the runs that are done.
        path: the picture's file: PNG, or whatever else Matplotlib writes by the ending.
        plot: columns; those it leaves out come from the sweep's file, or else from what varies: x is the first
            parameter (or scenario, robot, preset, seed) with several values, hue the next one, y ``clearance_m`` of
            plans and ``time_s`` of drives.

    Returns:
        Plot: the columns that were drawn.

    Raises:
        SweepError: no row has a value of y, or the file has another ending.
        ParameterError: there is no such column.
        InputError: the file cannot be written.
        MissingExtraError: Matplotlib is not installed.
    """
    target = check_plot(path)
    from matplotlib.figure import Figure

    chosen = plot_columns(sweep, plot)
    x, y, hue = chosen.x or "seed", chosen.y or _DEFAULT_Y[sweep.kind], chosen.hue
    good = [row for row in rows if row[y] is not None and row[x] is not None]
    if not good:
        raise SweepError(f"{target}: nothing to draw: none of {len(rows)} rows has a {y}")
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.add_subplot()
    _draw(axes, good, Plot(x, y, hue))
    lost = len(rows) - len(good)
    title = f"{sweep.path.stem}: {plural(len(good), 'run')}" + (f", {lost} without {y}" if lost else "")
    axes.set_title(title, fontsize=10, parse_math=False)
    stream = BytesIO()
    figure.savefig(stream, format=target.suffix.lstrip(".").lower() or "png", dpi=120)
    atomic_write(target, stream.getvalue())
    return Plot(x, y, hue)


def _draw(axes: Axes, rows: Sequence[Row], plot: Plot) -> None:
    """Rows that have values of x and y."""
    x, y, hue = plot.x or "", plot.y or "", plot.hue
    hues = _values(rows, hue) if hue else [None]
    found, hues = len(hues), hues[:_MOST_HUES]
    places = _values(rows, x)
    numeric = all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in places)
    for k, value in enumerate(hues):
        mine = [row for row in rows if hue is None or row[hue] == value]
        at, middle, low, high = _summary(mine, x, y, places, numeric)
        label, color = None if hue is None else _label(hue, value), f"C{k}"
        if numeric:
            axes.fill_between(at, low, high, color=color, alpha=0.2, lw=0)
            axes.plot(at, middle, ".-", color=color, label=label)
        else:
            offset = (k - (len(hues) - 1) / 2) * 0.6 / len(hues)
            about = [np.subtract(middle, low), np.subtract(high, middle)]
            axes.errorbar(np.add(at, offset), middle, about, fmt="o", color=color, capsize=3, label=label)
    if not numeric:
        axes.set_xticks(range(len(places)), [str(v) for v in places], parse_math=False)
    axes.set_xlabel(x)
    axes.set_ylabel(f"part of the runs with {y}" if isinstance(rows[0][y], bool) else y)
    if hue is not None:
        legend = axes.legend(fontsize=8, title=f"the first {len(hues)} of {found}" if found > len(hues) else None)
        for text in legend.get_texts():
            text.set_parse_math(False)
    axes.grid(alpha=0.3)


def _label(hue: str, value: object) -> str:
    label = value if isinstance(value, str) else f"{hue} {value}"
    return f" {label}" if label.startswith("_") else label  # else Matplotlib leaves it out of the legend


def check_plot(path: str | os.PathLike[str]) -> Path:
    """The path, if a picture can be written there; to be called before hours are spent on the runs.

    Raises:
        SweepError: Matplotlib does not write files of such an ending.
        InputError: the file cannot be written.
        MissingExtraError: Matplotlib is not installed.
    """
    target = check_writable(path)
    try:
        from matplotlib.backend_bases import FigureCanvasBase
    except ImportError:
        raise missing_extra("the picture of a sweep", "matplotlib", "study") from None
    endings = [f".{ending}" for ending in FigureCanvasBase.get_supported_filetypes()]
    if (suffix := target.suffix.lower()) and suffix not in endings:
        raise SweepError(f"{target}: unknown ending {shown(suffix)} of a picture{nearest_name(suffix, endings)}")
    return target


def plot_columns(sweep: Sweep, plot: Plot | None = None) -> Plot:
    """The columns that are drawn; see :func:`plot_sweep`.

    Raises:
        ParameterError: there is no such column, or y is not a column of numbers.
    """
    wanted = plot or Plot()
    columns = sweep.columns()
    varied = [name for name, values in sweep.grid.items() if len(values) > 1]
    for name, values in (("scenario", sweep.scenarios), ("robot", sweep.robots), ("preset", sweep.presets)):
        if len(values) > 1:
            varied.append(name)
    x = wanted.x or sweep.plot.x or next((n for n in varied if n not in (wanted.hue, sweep.plot.hue)), "seed")
    y = wanted.y or sweep.plot.y or _DEFAULT_Y[sweep.kind]
    hue = wanted.hue or sweep.plot.hue or next((n for n in varied if n != x), None)
    check_choice("x", x, columns)
    check_choice("y", y, [name for name, kind in columns.items() if kind is not str])
    if hue is not None:
        check_choice("hue", hue, columns)
    return Plot(x, y, hue)


def _values(rows: Sequence[Row], column: str) -> list[bool | int | float | str]:
    """The values of a column, sorted where they are numbers, else as they come."""
    found = list(dict.fromkeys(value for row in rows if (value := row[column]) is not None))
    return found if any(isinstance(v, str) for v in found) else sorted(found, key=float)


def _summary(
    rows: Sequence[Row], x: str, y: str, places: Sequence[bool | int | float | str], numeric: bool
) -> tuple[list[float], list[float], list[float], list[float]]:
    """Places on the axis, and there: median, lower and upper quartile; of true and false the mean alone."""
    out: tuple[list[float], list[float], list[float], list[float]] = ([], [], [], [])
    for k, place in enumerate(places):
        values = [row[y] for row in rows if row[x] == place]
        if not values:
            continue
        numbers = np.array([float(v) for v in values if v is not None and not isinstance(v, str)])
        if isinstance(values[0], bool):
            figures = (numbers.mean(),) * 3
        else:
            figures = tuple(np.percentile(numbers, (50, 25, 75)))
        for entry, value in zip(out, (float(place) if numeric else float(k), *figures), strict=True):
            entry.append(float(value))
    return out
