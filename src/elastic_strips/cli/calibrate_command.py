"""``elastic-strips calibrate``: what a drive's record says about the machine, beside what is assumed of it."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import click

from . import options, output

if TYPE_CHECKING:
    from elastic_strips.control.calibration import Finding


@click.command()
@click.argument("record", metavar="RECORD.npz|LOG.jsonl", type=options.FILE)
@options.robot_option(help="The robot of a log. For a record: where its robot's file is now.")
@options.base_option("For a log: how the base moves; the robot's own by default.")
@click.option(
    "--tracking-error",
    type=options.Finite(0.001, 1.0),
    metavar="M",
    help="DriveParams.tracking_error of the drive [m]; its default if not given.",
)
@options.limit_options
@options.json_option("Write the findings.")
def calibrate(
    record: str,
    robot: str | None,
    base: str | None,
    tracking_error: float | None,
    limits: options.GivenLimits,
    json_file: str | None,
) -> int:
    """Measure a machine from the record of a drive, and say which parameters to set.

    RECORD is a record of "drive --record", or a log of a robot's executor ("drive --log", or of a robot that speaks
    ROS 2). A log has no true state, so it shows neither how far the estimate is off nor how much the wheels slip. The
    more the robot does in it, the more it shows: drive straight and in curves, at full speed, move every joint, and
    stop once at full speed.

    Exit code 0: nothing is worse than assumed. 2: wrong input. 3: something is; set the parameters that are named.
    """
    from elastic_strips.control import DriveParams
    from elastic_strips.control.calibration import calibrate as measure
    from elastic_strips.control.process import read_log
    from elastic_strips.io import read_record, record_robot
    from elastic_strips.robot import load_robot

    options.check_outputs(record, json_file)
    params = DriveParams()
    if tracking_error is not None:
        params = replace(params, tracking_error=tracking_error)
    if record.lower().endswith(".jsonl"):
        if robot is None:
            raise click.UsageError(f"{record} is a log, which does not name its robot: give --robot NAME|FILE.urdf")
        rows, model = read_log(record), load_robot(robot, base=base)
    else:
        if base is not None:
            raise click.UsageError("--base is only for a log; a record says how its base moves")
        rows = read_record(record)
        model = record_robot(rows, robot)
    found = measure(rows, model, limits=limits.of(model), params=params)
    by = "by the true state" if found.truth else "by the estimate alone"
    output.say((model.name, output.NAME), f": {found.seconds:.1f} s, {found.rows} rows, {by}")
    for finding in found.findings:
        output.row(finding.what, _said(finding), None if finding.assumed is None else not finding.exceeds)
    output.write_document(
        "findings",
        json_file,
        {
            "robot": model.name,
            "record": record,
            "seconds": found.seconds,
            "rows": found.rows,
            "truth": found.truth,
            "exceeded": len(found.exceeded),
            "findings": [asdict(finding) for finding in found.findings],
        },
    )
    return options.EXIT_NOT_DONE if found.exceeded else options.EXIT_DONE


def _said(finding: Finding) -> str:
    """A finding in a line."""
    unit = f" {finding.unit}" if finding.unit else ""
    said = "not shown" if finding.measured is None else f"{finding.measured:.4g}{unit}"
    if finding.assumed is not None:
        said += f", assumed {finding.assumed:.4g}{unit}"
    if finding.value is not None and finding.exceeds:
        said += f": set {finding.field} to {finding.value:g}"
    elif finding.exceeds:
        said += f": see {finding.field}"
    return f"{said} ({finding.note})" if finding.note else said
