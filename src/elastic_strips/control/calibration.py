"""Calibration: what the record of a drive says about the machine, beside what is assumed of it.

Where a record has the true state, as simulated ones have, everything is by that; the log of a real robot has estimates,
which show how the motors follow and what is measured at rest, and not how far the estimate itself is off.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision.bounds import Displacement
from elastic_strips.errors import RobotError
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.summary import Summary
from elastic_strips.trajectory import MotionLimits
from elastic_strips.trajectory.limits import sliding_joints
from elastic_strips.validation import check_type, named_arguments, shown

from .motor_fit import SpeedLoop, fit_speed_loops
from .params import DriveParams
from .record import DRIVE_NAMES, Record, RecordError

_FEWEST_ROWS = 50
_LAG_ROOM = 0.005  # [s] by which a lag may be longer than assumed before that is said
_ROOM = 1.1  # times by which other values may be larger: a drive is a sample
_WEAK = 0.95  # part of an acceleration's limit, below which a motor is weaker
_SLIP_WINDOW = 1.0  # [s] over which slip is taken
_SLIP_TRAVEL = 0.05  # [m or rad] of travel in it, below which it says nothing
_REST = 0.3  # [s] at rest from which on readings are compared
_MOST_LEFT, _MOST_LEFT_NOISY = 0.1, 0.35
"""Part of a motion that the motors' model may leave unexplained, of true speeds and of those of an estimate."""
_STANDS = 1e-6  # [m/s, rad/s] of a command to stand; [m, rad] by which its reference may change meanwhile


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was measured.

    Attributes:
        what: what it is, in words.
        unit: its unit; empty for a part.
        measured: its value, or None where the record does not show it.
        assumed: what is assumed; None where nothing is.
        field: where that is set.
        value: what to set there; None where it may stay.
        exceeds: whether what was measured is worse than what is assumed.
        note: more about it.
    """

    what: str
    unit: str
    measured: float | None
    assumed: float | None
    field: str = ""
    value: float | None = None
    exceeds: bool = False
    note: str = ""


@dataclass(frozen=True, slots=True, repr=False)
class Calibration(Summary):
    """The result of :func:`calibrate`.

    Attributes:
        findings: what was measured, beside what is assumed.
        seconds: duration of the drive [s].
        rows: number of its control rows.
        truth: whether it has the true state.
    """

    findings: tuple[Finding, ...]
    seconds: float
    rows: int
    truth: bool

    @property
    def exceeded(self) -> tuple[Finding, ...]:
        """The findings that are worse than what is assumed."""
        return tuple(finding for finding in self.findings if finding.exceeds)

    def _summary(self) -> dict[str, object]:
        return {"seconds": f"{self.seconds:.1f}", "truth": self.truth, "worse than assumed": len(self.exceeded)}


@named_arguments
def calibrate(
    record: Record | Sequence[Mapping[str, object]],
    robot: RobotModel,
    *,
    limits: MotionLimits | None = None,
    params: DriveParams | None = None,
) -> Calibration:
    """Measure a machine by the record of a drive.

    Args:
        record: a record, or the rows of an executor's log, as ``read_log`` gives them.
        robot: the robot that was driven.
        limits: limits that it was driven with; those of the robot where None.
        params: parameters that it was driven with.

    Raises:
        RecordError: the record is of another robot, has too few rows, or rows that do not fit.
    """
    check_type("robot", robot, RobotModel, RobotError)
    check_type("limits", limits, MotionLimits, none=True)
    check_type("params", params, DriveParams, none=True)
    if not isinstance(record, Record) and not (
        isinstance(record, (list, tuple)) and all(isinstance(row, Mapping) for row in record)
    ):
        raise RecordError(f"record={shown(record)} is neither a Record nor the rows of a log")
    params = DriveParams() if params is None else params
    limits = MotionLimits.for_robot(robot) if limits is None else limits
    drive = _recorded(record, robot) if isinstance(record, Record) else _logged(record, robot)
    if len(drive.time) < _FEWEST_ROWS:
        raise RecordError(f"the record has {len(drive.time)} control rows; at least {_FEWEST_ROWS} are needed")
    names = (*DRIVE_NAMES[robot.base_kind], *robot.joint_names)
    loops = _loops(drive, limits)
    k, noisy = limits.drive_dim, drive.true is None
    findings = [
        *_tracking(drive, robot, params),
        *_motors("the drive", "wheel_lag", loops[:k], names[:k], limits, robot, params, noisy),
        *_motors("the joints", "joint_lag", loops[k:], names[k:], limits, robot, params, noisy),
        *_slip(drive, robot, limits, params),
        *_noise(drive, robot, params),
    ]
    return Calibration(tuple(findings), float(drive.time[-1] - drive.time[0]), len(drive.time), drive.true is not None)


@dataclass(frozen=True, slots=True)
class _Drive:
    """Rows of a drive: what of them there is.

    Attributes:
        time: (T,) [s].
        reference, estimate: (T, nv) coordinate rows.
        command: (T, k + n) speeds that were commanded.
        true, v: (T, nv) true coordinate rows and velocities; None where they are not known.
        motors: (T, k) true speeds of the drive's motors; None where they are not known.
    """

    time: Array
    reference: Array
    estimate: Array
    command: Array
    true: Array | None
    v: Array | None
    motors: Array | None


def _recorded(record: Record, robot: RobotModel) -> _Drive:
    record.check_robot(robot)
    c = record.control
    command = np.hstack((c.drive, c.joints))
    known = np.isfinite(np.hstack((c.reference, c.estimate, command))).all(axis=1)
    motors = c.motors[known]
    return _Drive(
        c.time[known],
        c.reference[known],
        c.estimate[known],
        command[known],
        c.coordinates[known],
        c.v[known],
        motors if np.isfinite(motors).all() else None,
    )


def _logged(rows: Sequence[Mapping[str, object]], robot: RobotModel) -> _Drive:
    k = len(DRIVE_NAMES[robot.base_kind])
    widths = {"reference": robot.nv, "estimate": robot.nv, "drive": k, "joints": len(robot.joint_names)}
    times: list[float] = []
    columns: dict[str, list[Array]] = {name: [] for name in widths}
    for number, row in enumerate(rows):
        if "event" in row or not widths.keys() <= row.keys():
            continue
        try:
            values = {name: np.array(row[name], dtype=float) for name in widths}
            t = float(row["t"])  # type: ignore[arg-type]
        except (TypeError, ValueError):
            raise RecordError(f"row {number} of the log holds something that is not a number") from None
        except KeyError:
            raise RecordError(f"row {number} of the log has no time 't'") from None
        for name, width in widths.items():
            if values[name].shape != (width,):
                raise RecordError(
                    f"row {number} of the log has {values[name].size} numbers of {name}; those of {robot.name!r} are "
                    f"{width}: is it another robot's?"
                )
        if row.get("stop"):
            values["drive"], values["joints"] = np.zeros(k), np.zeros(widths["joints"])
        if not all(np.isfinite(one).all() for one in values.values()) or (times and not t > times[-1]):
            continue
        times.append(t)
        for name, one in values.items():
            columns[name].append(one)
    found = {name: np.array(some).reshape(len(times), widths[name]) for name, some in columns.items()}
    command = np.hstack((found["drive"], found["joints"]))
    return _Drive(np.array(times), found["reference"], found["estimate"], command, None, None, None)


# --- where it was ----------------------------------------------------------------------------------------------------


def _tracking(drive: _Drive, robot: RobotModel, params: DriveParams) -> list[Finding]:
    """How far any point of the robot was from its place by the planned motion."""
    apart, share = Displacement(robot), params.monitor.control_share
    seen = drive.estimate if drive.true is None else drive.true
    off = apart(seen, drive.reference)
    most, most_of, field = float(off.max()), params.tracking_error, "DriveParams.tracking_error"
    if drive.true is None:
        most_of *= share
        note = "by the estimate: what localization is off comes on top, and has the other part of the tracking error"
        field = "DriveParams.tracking_error × MonitorParams.control_share"
    else:
        note = "any point of the robot from its place by the planned motion"
    wanted = _rounded_up(_ROOM * most / (share if drive.true is None else 1.0), 0.001)
    found = [
        Finding("off the reference, 99 %", "m", float(np.percentile(off, 99.0)), None, note=note),
        Finding(
            "off the reference, largest", "m", most, most_of, field, wanted if most > most_of else None, most > most_of
        ),
    ]
    if drive.true is not None:
        lost = float(apart(drive.true, drive.estimate).max())
        rest = params.tracking_error * (1.0 - share)
        wanted = _rounded_up(_ROOM * lost / (1.0 - share), 0.001) if share < 1.0 else None
        found.append(
            Finding(
                "estimate off the truth, largest", "m", lost, rest,
                "DriveParams.tracking_error × (1 − MonitorParams.control_share)", wanted if lost > rest else None,
                lost > rest, "any point of the robot from where it is estimated to be",
            )
        )  # fmt: skip
    return found


# --- motors ----------------------------------------------------------------------------------------------------------


def _loops(drive: _Drive, limits: MotionLimits) -> list[SpeedLoop | None]:
    """What the motion of each coordinate shows: k of the drive, then n joints."""
    if drive.v is None:
        between = _between(drive.estimate, limits)
        speed = np.vstack((between / np.diff(drive.time)[:, None], np.zeros((1, between.shape[1]))))
        mean = True
    else:
        speed, mean = limits.to_coordinates(drive.v), False
        if drive.motors is not None:
            speed[:, : limits.drive_dim] = drive.motors
    return fit_speed_loops(drive.time, drive.command, speed, mean=mean)


def _between(rows: Array, limits: MotionLimits) -> Array:
    """(T − 1, k + n) travel of drive coordinates and joints from each row (T, nv) to the next."""
    change = np.diff(rows, axis=0)
    if limits.drive_dim:
        turn = np.remainder(change[:, 2] + np.pi, 2.0 * np.pi) - np.pi
        heading = rows[:-1, 2] + 0.5 * turn
        cos, sin = np.cos(heading), np.sin(heading)
        x, y = change[:, 0].copy(), change[:, 1].copy()
        change[:, 0], change[:, 1], change[:, 2] = cos * x + sin * y, cos * y - sin * x, turn
    return limits.to_coordinates(change)


def _motors(
    of: str,
    field: str,
    loops: Sequence[SpeedLoop | None],
    names: Sequence[str],
    limits: MotionLimits,
    robot: RobotModel,
    params: DriveParams,
    noisy: bool,
) -> list[Finding]:
    """Lag, dead time and greatest acceleration of the worst of some motors.

    Of smooth commands, lag and dead time are hard to tell apart, and the sum is what tracking leads by: it is compared.
    """
    if not loops:
        return []
    most_left = _MOST_LEFT_NOISY if noisy else _MOST_LEFT
    drives = field == "wheel_lag"
    accelerations = (limits.drive_acceleration if drives else limits.joint_acceleration).tolist()
    named = [one for one in zip(loops, names, accelerations, strict=True) if one[0] is not None]
    clear = [(loop, name, a) for loop, name, a in named if loop is not None and loop.left <= most_left]
    if not clear:
        why = "it does not move in the record" if not named else "its commands do not explain how it moves"
        return [Finding(f"lag of {of}", "s", None, getattr(params.gains, field), f"TrackingGains.{field}", note=why)]
    half = 0.5 * params.control_dt
    lag, dead = float(getattr(params.gains, field)), max(params.gains.hold - half, 0.0)
    slowest, name, _ = max(clear, key=lambda one: one[0].lag + one[0].dead)
    late = slowest.lag + slowest.dead > lag + dead + _LAG_ROOM
    fields = f"TrackingGains.{field}" + (", MonitorParams.wheel_lag" if drives else "")
    longer, later = (late and apart > 0.5 * _LAG_ROOM for apart in (slowest.lag - lag, slowest.dead - dead))
    value = _to(slowest.lag, 0.001) if longer else None
    held = _to(slowest.dead + half, 0.001) if later else None
    note = f"{name}; with the time below {1e3 * (slowest.lag + slowest.dead):.0f} ms, which counts"
    found = [
        Finding(f"lag of {of}", "s", slowest.lag, lag, fields, value, longer, note),
        Finding(
            f"commands to {of} act after", "s", slowest.dead, dead, "TrackingGains.hold", held,
            later, "hold has half a control period on top",
        ),
    ]  # fmt: skip
    loop, name, limit = min(clear, key=lambda one: (one[0].push or math.inf) / one[2])
    what, where = f"greatest acceleration of {of}", "drive_acceleration" if drives else "joint_acceleration"
    if loop.push is None:
        loop, name, limit = max(clear, key=lambda one: one[0].reached / one[2])
        had = "" if noisy else f" {name} had {loop.reached:.3g}, and"
        note = f"not at its limit:{had} more was not asked for. Brake once at full speed to see it"
        found.append(Finding(what, _unit(name, robot), None, limit, f"MotionLimits.{where}", note=note))
    else:
        weak = loop.push < _WEAK * limit
        note = f"{name}: more was asked for, and this came"
        value = math.floor(loop.push * 100.0 + 1e-6) / 100.0 if weak else None
        found.append(Finding(what, _unit(name, robot), loop.push, limit, f"MotionLimits.{where}", value, weak, note))
    return found


def _unit(name: str, robot: RobotModel) -> str:
    """Unit of a drive coordinate's or a joint's acceleration."""
    if name not in robot.joint_names:
        return "rad/s²" if name == "yaw" else "m/s²"
    return "m/s²" if sliding_joints(robot)[robot.joint_names.index(name)] else "rad/s²"


# --- wheels and readings ---------------------------------------------------------------------------------------------


def _slip(drive: _Drive, robot: RobotModel, limits: MotionLimits, params: DriveParams) -> list[Finding]:
    """What of the motors' travel is lost on the floor."""
    if not limits.drive_dim:
        return []
    assumed, field = params.sensing.slip, "EstimatorParams.slip"
    what = "slip of the drive, standard deviation"
    if drive.true is None or drive.motors is None:
        note = "the record has no true state" if drive.true is None else "the record has no speeds of the motors"
        return [Finding(what, "", None, assumed, field, note=note)]
    ground = _between(drive.true, limits)[:, : limits.drive_dim]
    turned = 0.5 * (drive.motors[1:] + drive.motors[:-1]) * np.diff(drive.time)[:, None]
    parts: list[list[float]] = [[] for _ in range(limits.drive_dim)]
    begin = 0
    for k in range(1, len(drive.time)):
        if drive.time[k] - drive.time[begin] < _SLIP_WINDOW:
            continue
        for i in range(limits.drive_dim):
            asked = float(turned[begin:k, i].sum())
            if abs(asked) >= _SLIP_TRAVEL and abs(asked) >= 0.8 * float(np.abs(turned[begin:k, i]).sum()):
                parts[i].append(1.0 - float(ground[begin:k, i].sum()) / asked)
        begin = k
    every = np.concatenate([np.array(some) for some in parts])
    if len(every) < 3:
        return [Finding(what, "", None, assumed, field, note="it drives too little in the record")]
    names = DRIVE_NAMES[robot.base_kind]
    steady = [(float(np.mean(some)), name) for some, name in zip(parts, names, strict=True) if some]
    mean, name = max(steady, key=lambda one: abs(one[0]))
    spread = float(np.sqrt(np.square(every).mean()))
    over = spread > _ROOM * 1.25 * assumed
    found = [
        Finding(
            what, "", spread, assumed, field, _rounded_up(spread, 0.001) if over else None, over,
            f"over {_SLIP_WINDOW:g} s, in {len(every)} such; largest {np.abs(every).max():.3f}",
        )
    ]  # fmt: skip
    odd = abs(mean) > 3.0 * assumed
    fixed = "MotionLimits.track, wheel_radius" if robot.base_kind is BaseKind.DIFF_DRIVE else "odometry's scale"
    found.append(
        Finding("slip that stays", "", mean, None, fixed if odd else "", None, odd, f"{name}, on the mean of the drive")
    )
    return found


def _noise(drive: _Drive, robot: RobotModel, params: DriveParams) -> list[Finding]:
    """Errors of the joints' encoders, and how readings wander while the robot stands."""
    first, found = robot.space.base_nv, []
    if drive.true is not None and len(robot.joint_names):
        noise = (drive.estimate - drive.true)[:, first:]
        noise = np.where(robot.space.turning[first:], np.remainder(noise + np.pi, 2.0 * np.pi) - np.pi, noise)
        worst = int(np.argmax(noise.std(axis=0)))
        found.append(
            Finding(
                "noise of the joints' encoders", "", float(noise[:, worst].std()), None, note=robot.joint_names[worst]
            )
        )
    standing = _standing(drive)
    if drive.true is None and standing:
        spread = np.sqrt(np.mean([np.var(drive.estimate[rows], axis=0) for rows in standing], axis=0))
        if first:
            assumed = params.sensing.fix_noise
            wide = float(np.hypot(*spread[:2]) / math.sqrt(2.0))
            over = wide > assumed
            found.append(
                Finding(
                    "the base's estimate at rest", "m", wide, assumed, "EstimatorParams.fix_noise",
                    _rounded_up(wide, 0.001) if over else None, over, "standard deviation of x and y",
                )
            )  # fmt: skip
        if len(robot.joint_names):
            worst = int(np.argmax(spread[first:]))
            found.append(
                Finding(
                    "the joints' readings at rest",
                    "",
                    float(spread[first + worst]),
                    None,
                    note=robot.joint_names[worst],
                )
            )
    return found


def _standing(drive: _Drive) -> list[slice]:
    """Rows while the robot was told to stand, and was to stand, without the time in which it comes to rest."""
    stays = np.abs(np.diff(drive.reference, axis=0)).max(axis=1, initial=0.0) <= _STANDS
    still = np.append(np.append(stays, True) & (np.abs(drive.command).max(axis=1, initial=0.0) <= _STANDS), False)
    found, begin = [], None
    for k, stands in enumerate(still):
        if stands and begin is None:
            begin = k
        elif not stands and begin is not None:
            rest = int(np.searchsorted(drive.time, drive.time[begin] + _REST))
            if k - rest >= 10:
                found.append(slice(rest, k))
            begin = None
    return found


def _rounded_up(value: float, unit: float) -> float:
    return round(math.ceil(value / unit - 1e-9) * unit, 6)


def _to(value: float, unit: float) -> float:
    return round(round(value / unit) * unit, 6)
