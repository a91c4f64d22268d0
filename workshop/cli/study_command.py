"""``python -m workshop study``: studies that end in a report."""

from __future__ import annotations

import click

from elastic_strips.cli import options, output


@click.group()
def study() -> None:
    """Studies that end in a report."""


@study.command(name="paper", short_help="The paper's tables and figures, methods compared, and a parameter map.")
@click.option("--out", default="study", show_default=True, metavar="FOLDER", type=click.Path(), help="Where to.")
@options.processes_option
@click.option("--quick", is_flag=True, help="Tables and figures alone: no comparison, no parameter map.")
@options.json_option("Write how the cases ended.")
def paper(out: str, processes: int | None, quick: bool, json_file: str | None) -> int:
    """Tables 1 and 2, Figs. 5 to 11, methods compared, and a map of the parameters: Markdown, HTML and pictures."""
    from workshop.study import paper_study
    from workshop.study.simulation import Outcome

    less = {"compared": (), "mapped": ""} if quick else {}
    with options.LateProgress("study") as bar:
        found = paper_study(out, processes=processes, step=bar.step, **less)
    for case, run in found.runs.items():
        good = run.outcome is Outcome.REACHED
        output.say(f"{case:8} ", output.verdict(f"{run.outcome.value:10}", good), f" {run.reason}")
    output.say(f"report   {found.report}")
    document = {
        "format": "elastic-strips-study",
        "version": 1,
        "as_the_paper_says": found.as_the_paper_says,
        "cases": [
            {
                "case": case,
                "outcome": run.outcome.value,
                "reason": run.reason,
                "length_m": run.length,
                "clearance_m": run.clearance,
            }
            for case, run in found.runs.items()
        ],
        "files": [str(file) for file in found.files],
    }
    output.write_document("answer", json_file, document)
    return options.EXIT_DONE if found.as_the_paper_says else options.EXIT_NOT_DONE
