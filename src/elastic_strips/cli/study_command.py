"""``elastic-strips study``: the paper's simulations run again, and the report of that."""

from __future__ import annotations

import click

from .progress import LateProgress


@click.group()
def study() -> None:
    """Studies that end in a report."""


@study.command(name="paper")
@click.option("--out", default="study", show_default=True, metavar="FOLDER", type=click.Path(), help="Where to.")
@click.option("--processes", type=click.IntRange(1, 256), help="How many runs at once; one for each core by default.")
@click.option("--quick", is_flag=True, help="Tables and figures alone: no comparison, no parameter map.")
def paper(out: str, processes: int | None, quick: bool) -> int:
    """Tables 1 and 2, Figs. 5 to 11, methods compared, and a map of the parameters: Markdown, HTML and pictures."""
    from ..study import paper_study  # it imports much that no other command needs

    options = {"compared": (), "mapped": ""} if quick else {}
    with LateProgress("study") as bar:
        found = paper_study(out, processes=processes, step=bar.step, **options)
    for case, run in found.runs.items():
        click.echo(f"{case:8} {run.outcome.value:10} {run.reason}")
    click.echo(f"report   {found.report}")
    return 0 if found.as_the_paper_says else 3
