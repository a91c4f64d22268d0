"""``python -m workshop carve``: the map of images against surfaces that are known."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import click

from elastic_strips.cli import options, output
from elastic_strips.cli.output import row

from .bench_options import figures_option, house_option, times

if TYPE_CHECKING:
    from workshop.bench.measure import Figures


@click.command(short_help="Whether images call free what is not.")
@house_option(required=False)
@click.option("--poses", type=click.IntRange(1, 1000), default=12, show_default=True, help="Places to look about from.")
@click.option("--seed", type=options.SEED, default=0, show_default=True, help="Of the places and the noise.")
@click.option(
    "--hours", type=options.Finite(0.001, 1000), help="Take so many hours' images in instead, and watch the memory."
)
@click.option(
    "--cloud",
    "clouds",
    metavar="FILE",
    multiple=True,
    type=click.Path(exists=True, dir_okay=False),
    help="Recorded image of 640 x 480 depths as a point cloud, instead of the house; may be given several times.",
)
@click.option("--focal", type=options.Finite(10, 10_000), default=525.0, show_default=True, help="Of its camera [px].")
@figures_option
@click.pass_context
def carve(
    context: click.Context,
    root: str | None,
    poses: int,
    seed: int,
    hours: float | None,
    clouds: tuple[str, ...],
    focal: float,
    json_file: str | None,
) -> None:
    """Look about in a furnished house with TIAGo's head camera: how many voxels of its surfaces are called free.

    Times are those of the processor.
    """
    from elastic_strips.robot import load_robot
    from workshop.bench import carve as bench

    if clouds:
        with options.LateProgress("carving", len(clouds)) as bar:
            figures = bench.bench_cloud(clouds, bar.step, focal=focal, seed=seed)
        _held_out(figures)
        output.write_document("figures", json_file, figures)
        return
    if root is None:
        raise click.UsageError("--root DIR of the house or --cloud FILE has to be given", context)
    root = os.path.join(root, "house")
    robot = load_robot("tiago", base="diff_drive", looking=["head_1_joint", "head_2_joint"])
    if hours is not None:
        with options.LateProgress("carving") as bar:
            figures = bench.bench_long(root, robot, bar.step, hours=hours, seed=seed)
        rows = figures["rows"]
        warm, end = rows[max(len(rows) // 10, 1) - 1], rows[-1]
        output.say(f"{figures['frames']} images, {100 * figures['believed']:.1f} % of them believed")
        for name, unit in (("memory_mb", "MB"), ("voxels_alive", ""), ("obstacles", ""), ("python_objects", "")):
            row(name.replace("_", " "), f"{warm[name]:.0f} to {end[name]:.0f} {unit}".rstrip())
        row("time of each", f"{times(warm['frame_ms'])}; at the end {times(end['frame_ms'])}")
        output.write_document("figures", json_file, figures)
        return
    with options.LateProgress("carving", 6 * poses) as bar:
        figures = bench.bench_carve(root, robot, bar.step, poses=poses, seed=seed)
    output.say(f"{figures['poses']} places, {figures['images']} images each camera")
    for name, some in figures["settings"].items():
        wrong, seen = some["called_free"], some["reach_seen"]
        row(name, f"{wrong} of {some['surface_voxels']} voxels called free, {some['looked_at']} seen", wrong == 0)
        row("  reach seen", ", ".join(f"{100 * share:.1f} % by {what}" for what, share in seen.items()))
        row("  image", f"{times(some['frame_ms'])}; map alone {times(some['parts_ms']['map'])}")
    row("memory", f"{figures['memory_mb']:.0f} MB of the process")
    output.write_document("figures", json_file, figures)


def _held_out(figures: Figures) -> None:
    """Say how many points that were not shown lie where it is free."""
    output.say(f"{len(figures['clouds'])} clouds, {figures['draws']} poses each")
    for part, bands in figures["held_out"].items():
        for band, n in bands.items():
            if n["points"]:
                free, centre, before = (n[key] / n["points"] for key in ("free", "free_by_centre", "before"))
                row(
                    f"{part}, {band}",
                    f"{100 * free:.4f} % of {n['points']} called free, {100 * centre:.4f} % by middle pixels; "
                    f"{100 * before:.1f} % of points before them",
                    n["free"] == 0,
                )
