"""IO room, record tables: a record's control rows under column names, for people, spreadsheets and pandas."""

from __future__ import annotations

import csv
import importlib
import io
from itertools import chain
from typing import Any

import numpy as np

from elastic_strips.errors import missing_extra
from elastic_strips.execution.record import Record

UNITS = {
    "time": "s",
    "chart": "m, m, rad (base); rad or m (joints)",
    "velocity": "m/s, m/s, rad/s (base, in its own frame); rad/s or m/s (joints)",
    "drive": "m/s (rad/s for an omnidirectional base's yaw)",
    "tick_ms": "ms",
    "clearance": "m",
    "position": "m, world",
    "quaternion": "x, y, z, w, world",
}


def chart_columns(record: Record, prefix: str = "") -> tuple[str, ...]:
    """Names of the columns of a chart row (nv): x, y, yaw of a base that moves, then the joints."""
    base = ("x", "y", "yaw") if record.drive_names else ()
    return tuple(prefix + name for name in (*base, *record.joint_names))


def velocity_columns(record: Record, prefix: str = "") -> tuple[str, ...]:
    """Names of the columns of a velocity (nv)."""
    base = ("vx", "vy", "omega") if record.drive_names else ()
    return tuple(prefix + name for name in (*base, *(f"{joint}_rate" for joint in record.joint_names)))


def control_columns(record: Record) -> tuple[str, ...]:
    """Names of all columns of a control row, in the order of a CSV file."""
    return (
        "time",
        "state",
        *chart_columns(record),
        *velocity_columns(record),
        *chart_columns(record, "reference_"),
        *velocity_columns(record, "reference_"),
        *chart_columns(record, "estimate_"),
        *(f"command_{name}" for name in record.drive_names),
        *(f"command_{name}_rate" for name in record.joint_names),
        *(f"motor_{name}" for name in record.drive_names),
    )


def record_columns(record: Record) -> dict[str, Any]:
    """The control rows by column name: arrays (T,); ``state`` holds names."""
    rows = record.control
    arrays = (rows.chart, rows.v, rows.reference, rows.reference_v, rows.estimate, rows.drive, rows.joints, rows.motors)
    columns = [rows.time, np.array(record.states)[rows.state], *chain.from_iterable(array.T for array in arrays)]
    return dict(zip(control_columns(record), columns, strict=True))


def record_frame(record: Record) -> Any:
    """The control rows as a ``pandas.DataFrame``.

    Raises:
        MissingExtraError: pandas is not installed.
    """
    try:
        pandas = importlib.import_module("pandas")
    except ModuleNotFoundError:
        raise missing_extra("record_frame (record_columns gives plain arrays)", "pandas") from None
    return pandas.DataFrame(record_columns(record))


def record_csv(record: Record) -> str:
    """The control rows as CSV: a line of column names, numbers that read back to the last bit, nothing for NaN."""
    columns = record_columns(record)
    states = columns.pop("state")
    numbers = np.column_stack(list(columns.values())).tolist()
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(control_columns(record))
    for (time, *rest), state in zip(numbers, states, strict=True):
        writer.writerow([repr(time), state, *("" if x != x else repr(x) for x in rest)])
    return stream.getvalue()
