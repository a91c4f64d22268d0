"""IO room, path checks: whether the values and times of a placed path are ones that the robot can have."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from elastic_strips.arrays import Array, Mask
from elastic_strips.robot import RobotModel
from elastic_strips.robot.space import LIMIT_TOLERANCE, MAX_TRAVEL, MOST_TURNS

from .path_table import BASE_NAMES, Angles, PathTable, PlacedPath

MAX_ANGLE = 1e4
"""Largest yaw, or value of a joint without limits [rad]."""
_LATEST_TIME = 1e10  # [s] after 1970 in seconds is less, in milliseconds more
_SAME_TIME = 1e-9  # [s]
_LONG, _SLOWLY = 60.0, 0.01  # [s], [m/s or rad/s] what takes as long and is never faster may be in milliseconds
_WIDEST_PATH = 500.0  # [m] what goes farther, of a file that names no unit, may be in millimetres


def angular_coordinates(robot: RobotModel) -> Mask:
    """(nv,) whether a coordinate is an angle."""
    base = [False, False, True] if robot.space.planar else []
    model = robot.model
    kinds = [model.joints[i].shortname() for i in range(1, model.njoints) if model.nvs[i]]
    return np.array([*base, *(not kind.startswith("JointModelP") for kind in kinds[bool(base) :])], dtype=bool)


def check_values(
    table: PathTable, robot: RobotModel, placed: PlacedPath, units: dict[int, str | None], angles: Angles | None
) -> None:
    """Values within bounds and limits; what is beyond these by what files round is taken to the limit."""
    values, space, angular = placed.coordinates, robot.space, angular_coordinates(robot)
    names = (*BASE_NAMES[: space.base_nv], *robot.joint_names)
    unnamed = np.array([units.get(k) is None for k in range(space.nv)], dtype=bool)
    unsaid = unnamed & (angles is None)
    endless = np.isinf(space.upper) & angular
    _check_unlimited(table, values, np.isinf(space.upper) & ~angular, MAX_TRAVEL, "m", names)
    _check_unlimited(table, values, endless, MAX_ANGLE, "rad", names)
    excess = _rounded_beyond(table, values, robot, angular, unsaid, names)
    clipped = np.flatnonzero((excess > 0.0).any(axis=0))
    if len(clipped):
        named = ", ".join(f"{names[i]} by {excess[:, i].max():.2g}" for i in clipped)
        placed.notes.append(f"taken to the limit: {named}")
        placed.coordinates = np.clip(values, space.lower, space.upper)
    jumps = np.flatnonzero((np.abs(np.diff(values, axis=0)) > np.pi + LIMIT_TOLERANCE).any(axis=0) & endless)
    if len(jumps):
        named = ", ".join(names[i] for i in jumps)
        placed.notes.append(f"changes by more than half a turn from one configuration to the next: {named}")
    wide = float(np.ptp(values[:, :2], axis=0).max()) if space.planar else 0.0
    if wide > _WIDEST_PATH and not table.metres and unnamed[:2].any():
        placed.doubts.append(
            f"millimetres? The base goes {wide:.6g} m, and the file names no unit. Name it (x_m, y_m or x_mm, y_mm)"
        )
    turning = [names[i] for i in np.flatnonzero(endless & unsaid) if np.abs(values[:, i]).max() > MOST_TURNS]
    if turning:
        placed.doubts.append(
            f"degrees? More than two turns: {', '.join(turning)}, and the file names no unit. Name it in the column "
            f"({turning[0]}_deg or {turning[0]}_rad), or for all angles of the file (--angles rad or deg, angles=)"
        )


def _check_unlimited(
    table: PathTable, values: Array, which: Mask, bound: float, unit: str, names: Sequence[str]
) -> None:
    """Refuse a value of a coordinate without limits that is farther from 0 than a bound."""
    beyond = np.argwhere((np.abs(values) > bound) & which)
    if len(beyond):
        k, column = (int(i) for i in beyond[0])
        table.fail(k, f"{names[column]} = {values[k, column]:.6g}, beyond ±{bound:g} {unit}")


def _rounded_beyond(
    table: PathTable, values: Array, robot: RobotModel, angular: Mask, unsaid: Mask, names: Sequence[str]
) -> Array:
    """By how much values are outside their limits, (N, nv), which is refused where it is more than files round.

    A hint is given where they may be in another unit, which is ``unsaid`` in the file.
    """
    space = robot.space
    excess = np.maximum(space.lower - values, values - space.upper)
    outside = excess > LIMIT_TOLERANCE
    if not outside.any():
        return excess
    k, column = (int(i) for i in np.argwhere(outside)[0])
    if angular[column]:
        unit, kind, scale, most = "rad", angular, np.pi / 180.0, 2.0 * np.pi
        ask = (
            f"Are these degrees? Name the unit in the column ({names[column]}_deg), or for all angles of the file "
            "(--angles deg, angles='deg')"
        )
    else:
        unit, kind, scale, most = "m", ~angular, 1e-3, 2.0
        ask = f"Are these millimetres? Name the unit ({names[column]}_mm)"
    these = outside.any(axis=0) & kind & unsaid  # all that are wrong have to fit, scaled
    scaled = values[:, these] * scale
    fits = ((scaled >= space.lower[these]) & (scaled <= space.upper[these])).all()
    why = f"; {robot.narrowed[names[column]]}" if names[column] in robot.narrowed else ""
    hint = f". {ask}" if these[column] and fits and np.abs(values[:, these]).max() > most else ""
    table.fail(
        k,
        f"joint {names[column]!r} = {values[k, column]:.6g} is outside its limits [{space.lower[column]:.6g}, "
        f"{space.upper[column]:.6g}] by {excess[k, column]:.3g} {unit}; up to {LIMIT_TOLERANCE:g} is taken to the "
        f"limit{why}{hint}",
    )


def check_times(table: PathTable, placed: PlacedPath, starts_at: float | None) -> None:
    """Times that do not fall; what they do not say is a doubt where something moves."""
    times = placed.times
    if times is None:
        if starts_at is not None:
            table.source.fail(f"has no times; starts_at={starts_at:g} (--starts-at) says when those begin")
        return
    if len(times) != len(table.rows) or not (np.abs(times) <= _LATEST_TIME).all():
        table.source.fail(
            f"has {len(times)} times for {len(table.rows)} configurations, or they are not within ±{_LATEST_TIME:g} s; "
            "name the unit of nanoseconds (time_ns)"
        )
    step = np.diff(times)
    if (step < 0.0).any():
        k = int(np.argmax(step < 0.0))
        table.fail(k + 1, f"the times decrease, from {times[k]:.9g} s to {times[k + 1]:.9g} s")
    moved = np.abs(np.diff(placed.coordinates, axis=0)).max(axis=1, initial=0.0) > LIMIT_TOLERANCE
    leap = moved & (step == 0.0)
    if not step.any():
        placed.time_doubts.append(f"all times are {times[0]:.9g} s: they do not say when the robot is where")
    elif leap.any():
        k = int(np.argmax(leap))
        label, line = table.place(k + 1)
        where = label if line is None else f"line {line}"
        placed.time_doubts.append(f"{where}: the robot is at two places at {times[k]:.9g} s")
    fastest = float((np.abs(np.diff(placed.coordinates, axis=0)) / np.maximum(step, _SAME_TIME)[:, None]).max())
    if placed.clock and step.any() and times[-1] - times[0] > _LONG and 0.0 < fastest < _SLOWLY:
        placed.time_doubts.append(
            f"milliseconds? The path takes {times[-1] - times[0]:.6g} s, never faster than {fastest:.2g} m/s or rad/s, "
            f"and the file names no unit of time. Name it ({placed.clock}_ms or {placed.clock}_s)"
        )
    if starts_at is not None:
        placed.times = times - times[0] + starts_at
        placed.notes.append(f"the path begins at {starts_at:g} s, as requested")
    elif abs(times[0]) > _SAME_TIME:
        said = (
            f"the first configuration is reached at {times[0]:.9g} s, and the file does not say from where; begin it "
            "at 0 s, or say when the robot is there (--starts-at SECONDS, starts_at=)"
        )
        (placed.doubts if placed.from_start else placed.time_doubts).append(said)
    elif abs(table.stamp) > _SAME_TIME:
        placed.time_doubts.append(
            f"the header's stamp is {table.stamp:.9g} s, which may be when the robot sets off; say when that is "
            "(--starts-at SECONDS, starts_at=)"
        )
