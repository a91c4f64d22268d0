"""The paper study: a report with tables and figures of the paper from own runs, and the paper's statements on them."""

from __future__ import annotations

import html
import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import InputError, ScenarioError, missing_extra, nearest_name
from elastic_strips.files import atomic_write, check_writable
from elastic_strips.sim.scenarios import drive_scenario, get_scenario
from elastic_strips.sim.scenarios.halls import BOTTLENECK, DEAD_END
from elastic_strips.sim.scenarios.paper_cases import TABLE_1, TABLE_2
from elastic_strips.summary import Summary

from .comparison import CASES, METHODS, TrialResult, check_methods, compare
from .simulation import LONGEST_STEP, MapCell, Outcome, PaperRun, parameter_map, simulate_paper

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FIGURES = dict(zip(TABLE_2, range(5, 12), strict=True))
SAYS = {
    "case-1": "The way changes slowly before obstacle 2, which is sensed about (−1500, −1500); the target is reached.",
    "case-2": "The same; the target is reached along the previous way.",
    "case-3": "It cannot pass: the interval is less than the safe distance.",
    "case-4": "With a safe distance of 800 mm it passes between the two easily.",
    "case-5": "It cannot pass between them either, but avoids both and arrives.",
    "case-6": "Among scattered obstacles the target is reached.",
    "case-7": "The whole robot: the manipulator's position changes while the mobile avoids.",
}
"""Statements of the paper on its figures, reworded."""
EXPECTED = {name: Outcome.BLOCKED if name == "case-3" else Outcome.REACHED for name in TABLE_2}
_MARKDOWN, _PAGE = "paper.md", "paper.html"
_FIGURE_DPI = 70  # [pixels per inch]
_STYLE = """
body { font: 15px/1.5 sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; color: #1a1a1a; }
table { border-collapse: collapse; margin: 1em 0; font-size: 13px; }
th, td { border: 1px solid #bbb; padding: 3px 8px; text-align: left; }
th { background: #eee; }
img { max-width: 100%; }
figcaption { font-size: 13px; color: #444; }
"""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PaperStudy(Summary):
    """Results of the study.

    Attributes:
        runs: case → run with preset ``paper``.
        rows: rows of the comparison.
        cells: cells of the parameter map.
        files: paths of the written files.
    """

    runs: dict[str, PaperRun]
    rows: tuple[TrialResult, ...]
    cells: tuple[MapCell, ...]
    files: tuple[Path, ...]

    @property
    def as_the_paper_says(self) -> bool:
        """Whether every case ended as stated in the paper."""
        return all(run.outcome is EXPECTED[case] for case, run in self.runs.items())

    @property
    def report(self) -> Path:
        """The report as Markdown."""
        return next(file for file in self.files if file.name == _MARKDOWN)


def paper_study(
    folder: str | Path,
    *,
    cases: Sequence[str] = tuple(TABLE_2),
    compared: Sequence[str] = CASES,
    methods: Sequence[str] = METHODS,
    mapped: str = "case-4",
    processes: int | None = None,
    step: Callable[[str], object] = lambda note: None,
) -> PaperStudy:
    """Run the study and write it as ``paper.md`` and ``paper.html`` with its pictures: at the end, all or nothing.

    Args:
        folder: the report's folder; made if it does not exist.
        cases: the cases of Figs. 5 to 11.
        compared, methods: cases and methods of the comparison; none where empty.
        mapped: the case of the parameter map; none where empty.
        processes: number of processes; one for each core where None.
        step: called after every run with its name.

    Raises:
        InputError: the folder cannot be written to.
        ScenarioError: an unknown case.
        ParameterError: an unknown method.
        MissingExtraError: matplotlib (extra ``study``) is not installed.
    """
    for case in cases:
        if case not in TABLE_2:
            raise ScenarioError(f"the paper has no case {case!r}{nearest_name(case, TABLE_2)}")
    for case in (*compared, *((mapped,) if mapped else ())):
        get_scenario(case)
    check_methods(methods)
    try:
        import matplotlib.figure  # noqa: F401 - before anything is run
    except ImportError as error:
        raise missing_extra("the study", "matplotlib", "study") from error
    document, files = Document("The paper's simulations, run again"), dict[str, bytes]()
    with _folder(folder) as out:
        _tables(document)
        runs = _figures(document, cases, files, step)
        rows = compare(compared, methods, processes=processes, step=step) if compared and methods else ()
        if rows:
            _comparison(document, rows)
        cells = parameter_map(mapped, processes=processes, step=step) if mapped else ()
        if cells:
            _map(document, mapped, cells, files)
        files |= {_MARKDOWN: document.markdown().encode(), _PAGE: document.page().encode()}
        written = _write(out, files)
    return PaperStudy(runs, rows, cells, tuple(written))


@dataclass(slots=True)
class Document:
    """Workspace: a report that grows from top to bottom.

    Attributes:
        title: title of the report.
    """

    title: str
    _markdown: list[str] = field(default_factory=list)
    _html: list[str] = field(default_factory=list)

    def heading(self, text: str, level: int = 2) -> None:
        """A heading, from level 2 on; level 1 is the title's."""
        self._markdown.append(f"{'#' * level} {text}")
        self._html.append(f"<h{level}>{html.escape(text)}</h{level}>")

    def text(self, text: str) -> None:
        """A paragraph of plain text."""
        self._markdown.append(text)
        self._html.append(f"<p>{html.escape(text)}</p>")

    def table(self, head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
        """A table; every row has as many cells as the head."""
        lines = ["| " + " | ".join(map(_cell, head)) + " |", "|" + "---|" * len(head)]
        lines += ["| " + " | ".join(map(_cell, row)) + " |" for row in rows]
        self._markdown.append("\n".join(lines))
        cells = "".join(f"<th>{html.escape(cell)}</th>" for cell in head)
        body = "".join("<tr>" + "".join(f"<td>{html.escape(str(c))}</td>" for c in row) + "</tr>" for row in rows)
        self._html.append(f"<table><tr>{cells}</tr>{body}</table>")

    def picture(self, file: str, caption: str) -> None:
        """A picture beside the report."""
        self._markdown.append(f"![{caption}]({file})\n\n*{caption}*")
        source, text = html.escape(file, quote=True), html.escape(caption)
        self._html.append(f'<figure><img src="{source}" alt="{text}"><figcaption>{text}</figcaption></figure>')

    def markdown(self) -> str:
        """The report as Markdown."""
        return "\n\n".join([f"# {self.title}", *self._markdown]) + "\n"

    def page(self) -> str:
        """The report as HTML."""
        title = html.escape(self.title)
        head = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title><style>{_STYLE}</style>'
        return "\n".join([head, f"<h1>{title}</h1>", *self._html, "</html>", ""])


def _cell(content: object) -> str:
    """A cell of a Markdown table: one line, without the sign that separates cells."""
    return " ".join(str(content).split()).replace("|", "\\|")


def _write(out: Path, files: Mapping[str, bytes]) -> list[Path]:
    """Write all files or, where one cannot be written, no new one."""
    new: list[Path] = []
    try:
        for name, data in files.items():
            if not (out / name).exists():
                new.append(out / name)
            atomic_write(check_writable(out / name), data)
    except BaseException:
        for file in new:
            file.unlink(missing_ok=True)
        raise
    return [out / name for name in files]


@contextmanager
def _folder(name: str | Path) -> Iterator[Path]:
    """The folder to write to, made if it does not exist; removed if the study fails."""
    out = Path(name)
    try:
        made = [f for f in (out, *out.parents) if not f.exists()]
        out.mkdir(parents=True, exist_ok=True)
    except (OSError, TypeError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(f"cannot write the study to {str(name)!r:.500}: {why}") from None
    try:
        for file in (_MARKDOWN, _PAGE):
            check_writable(out / file)
        yield out
    except BaseException:
        with suppress(OSError):  # a folder with other files stays
            for there in made:
                there.rmdir()
        raise


def _tables(document: Document) -> None:
    document.text(
        "Made by `python -m workshop study paper`. Preset `paper` is Eqs. 2 to 9 as printed, driven reactively: at "
        "each sampling time the obstacles within the safe distance of P_m (of any control point in case 7) become "
        "known, "
        f"the postures ahead are deformed, and the robot moves to the next one, by {LONGEST_STEP:g} m at most. Preset "
        "`default` is driven in the closed loop, on wheels. Where the obstacles stand is our choice "
        "(docs/paper-map.md): the paper's figures are not at hand, only its text."
    )
    document.heading("Table 1: parameter values")
    document.table(
        ["", "value"],
        [
            ["initial position [mm]", "−3000, −3000"],
            ["target position [mm]", "6000, 6000"],
            ["direction of the initial robot", "π/6"],
            *([name, value] for name, value in TABLE_1.items()),
        ],
    )
    document.heading("Table 2: conditions")
    document.table(
        ["case", "transfer tilt [rad]", "safe distance [mm]", "between two obstacles [mm]"],
        [
            [name, f"π/{math.pi / tilt:.0f}", f"{1e3 * safe:.0f}", "–" if gap is None else f"{1e3 * gap:.0f}"]
            for name, (tilt, safe, gap) in TABLE_2.items()
        ],
    )


def _figures(
    document: Document, cases: Sequence[str], files: dict[str, bytes], step: Callable[[str], object]
) -> dict[str, PaperRun]:
    from matplotlib.figure import Figure

    from .figures import draw_drive, draw_paper_run

    runs: dict[str, PaperRun] = {}
    document.heading("Figs. 5 to 11")
    summary = []
    for case in cases:
        scenario = get_scenario(case)
        run = runs[case] = simulate_paper(scenario)
        step(f"{case}, preset paper")
        drive = drive_scenario(scenario, compute="1")
        step(f"{case}, preset default")
        figure = Figure(figsize=(13.0, 6.4), layout="constrained")
        left, right = figure.subplots(1, 2)
        draw_paper_run(left, run)
        left.set_title(f"{case}, preset paper: {run.outcome.value}", fontsize=9)
        record = drive.result.record
        draw_drive(right, drive.robot, scenario.scene, run.line, record.control.coordinates, arm=case == "case-7")
        driven = "reached" if drive.reached else "not reached"
        right.set_title(f"{case}, preset default: {driven} in {drive.evaluation.time_s:.1f} s", fontsize=9)
        name = f"fig-{_FIGURES[case]:02d}-{case}.png"
        files[name] = _png(figure)
        document.heading(f"Fig. {_FIGURES[case]}: {case}", 3)
        document.text(f"The paper: {SAYS[case]}")
        document.text(_outcome(run))
        document.picture(name, f"Fig. {_FIGURES[case]}: {case}; preset paper (left) and default (right)")
        summary.append(
            [
                case,
                run.outcome.value,
                _mm(run.clearance),
                _mm(run.length),
                driven,
                _mm(drive.evaluation.min_clearance_m),
                _mm(drive.evaluation.path_m),
                f"{drive.evaluation.time_s:.1f}",
            ]
        )
    document.heading("All cases", 3)
    document.table(
        ["case", "paper", "clearance [mm]", "way [mm]", "default", "clearance [mm]", "way [mm]", "time [s]"], summary
    )
    return runs


def _png(figure: Figure) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=_FIGURE_DPI)
    return stream.getvalue()


def _outcome(run: PaperRun) -> str:
    sensed = "; ".join(
        f"{s.name} is sensed from ({1e3 * s.robot[0]:.0f}, {1e3 * s.robot[1]:.0f})" for s in run.detections
    )
    return (
        f"Here: {run.outcome.value}, {run.reason}. {sensed or 'Nothing is sensed'}. The mobile leaves the original "
        f"line by up to {_mm(_deviation(run.line, run.coordinates[:, :2]))} mm, and the robot comes no nearer to an "
        f"obstacle than {_mm(run.clearance)} mm."
    )


def _deviation(line: Array, points: Array) -> float:
    """Largest distance [m] of points (K, 2) from the straight line between the ends of a line (N, 2)."""
    a, b = line[0], line[-1]
    along = np.clip((points - a) @ (b - a) / float((b - a) @ (b - a)), 0.0, 1.0)
    return float(np.hypot(*(points - (a + along[:, None] * (b - a))).T).max())


def _comparison(document: Document, rows: Sequence[TrialResult]) -> None:
    document.heading("Methods compared")
    document.text(
        "The same base on the same machine; the base methods and strip-sensed see what the simulated laser, sonars and "
        "infrared sensors read, strip knows the obstacles. Least clearance is of the whole robot, arm included, to "
        "which the base methods pay no attention. Roughness is the root mean square of the yaw acceleration."
    )
    document.table(
        [
            "case",
            "method",
            "reached",
            "touched",
            "clearance [mm]",
            "way [mm]",
            "time [s]",
            "turning [rad]",
            "roughness [rad/s²]",
            "ended",
        ],
        [
            [
                r.case,
                r.method,
                "yes" if r.reached else "no",
                ", ".join(r.contacts) or "–",
                _mm(r.clearance),
                _mm(r.path),
                f"{r.time:.1f}",
                f"{r.turning:.1f}",
                f"{r.roughness:.2f}" if math.isfinite(r.roughness) else "–",
                r.reason[:90],
            ]
            for r in rows
        ],
    )
    traps = [case for case in (BOTTLENECK, DEAD_END) if any(r.case == case for r in rows)]
    if traps:
        told = "; ".join(f"{case}: {_reached_by(rows, case)}" for case in traps)
        document.text(
            "The paper says of the methods before the strip that they do not get out of bottlenecks; a dead end is a "
            f"local minimum besides. Of those that were tried here: {told}."
        )


def _reached_by(rows: Sequence[TrialResult], case: str) -> str:
    """``"a and b reach the goal, c does not"``."""
    there = [r.method for r in rows if r.case == case and r.reached]
    not_there = [r.method for r in rows if r.case == case and not r.reached]
    return f"the goal is reached by {', '.join(there) or 'none'}, and not by {', '.join(not_there) or 'none'}"


def _map(document: Document, case: str, cells: Sequence[MapCell], files: dict[str, bytes]) -> None:
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure

    k_r, k_c, safe = (sorted({getattr(c, name) for c in cells}) for name in ("k_r", "k_c", "safe"))
    kinds = list(Outcome)
    colors = ["#4c956c", "#f2c14e", "#b3261e", "#888888"]
    figure = Figure(figsize=(2.6 * len(safe) + 1.2, 3.4), layout="constrained")
    axes = figure.subplots(1, len(safe), squeeze=False)
    for axis, distance in zip(axes[0], safe, strict=True):
        grid = np.array(
            [
                [next(kinds.index(c.outcome) for c in cells if (c.k_r, c.k_c, c.safe) == (r, k, distance)) for k in k_c]
                for r in k_r
            ]
        )
        axis.imshow(grid, cmap=ListedColormap(colors), vmin=-0.5, vmax=3.5, origin="lower", aspect="auto")
        axis.set_xticks(range(len(k_c)), [f"{k:g}" for k in k_c], fontsize=7)
        axis.set_yticks(range(len(k_r)), [f"{r:g}" for r in k_r], fontsize=7)
        axis.set_title(f"safe distance {1e3 * distance:.0f} mm", fontsize=8)
        axis.set_xlabel("k_c", fontsize=8)
    axes[0][0].set_ylabel("k_r", fontsize=8)
    for kind, color in zip(kinds, colors, strict=True):
        axes[0][-1].plot([], [], "s", color=color, label=kind.value)
    axes[0][-1].legend(fontsize=6, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    name = f"parameter-map-{case}.png"
    files[name] = _png(figure)
    document.heading("Parameters decided properly")
    counts = {kind.value: sum(c.outcome is kind for c in cells) for kind in kinds}
    told = ", ".join(f"{count} {kind}" for kind, count in counts.items() if count)
    document.text(
        f"{case} with every combination of {len(k_r)} values of k_r, {len(k_c)} of k_c and {len(safe)} safe distances: "
        f"{told}."
    )
    document.picture(name, f"Outcome of {case} by k_r, k_c and safe distance")


def _mm(metres: float) -> str:
    return "–" if not math.isfinite(metres) else f"{1e3 * metres:.0f}"
