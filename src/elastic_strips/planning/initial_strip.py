"""Initial strips: rows along a straight line or a path of the base, and how long they are relaxed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from time import perf_counter

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.errors import ParameterError, plural
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.robot.space import wrap_angle
from elastic_strips.strip import Strip
from elastic_strips.strip.report import DeformReport
from elastic_strips.strip.solver import project_rolling

from .grid_path import resample
from .ompl_planner import PathResult, ompl_path
from .problem import SEED_STRIDE, Deadline, PlanningProblem

_LARGEST_TURN = 0.35  # largest turn in place between two nodes [rad]
_SHORT_BACK = 0.3  # [m] that are no detour to be driven backwards


def straight_line(
    robot: RobotModel, start: Array, goal: Array, *, spacing: float, most: int | None = None, backward: bool = True
) -> Array:
    """Rows (N, nv) of the straight line from ``start`` to ``goal`` (configurations (nq,)).

    A differential drive turns in place towards the goal, drives straight (backwards where that turns less),
    and turns in place at the goal; the joints move evenly along the drive. Every segment can be driven exactly.

    Args:
        robot: the robot.
        start, goal: configurations (nq,).
        spacing: largest distance between the base poses of neighbouring nodes [m].
        most: largest number of rows, at least 4; if more would be needed, they are further apart.
        backward: whether it may drive backwards.
    """
    space = robot.space
    a, b = space.to_coordinates(start), space.to_coordinates(goal)
    offset = space.difference(a[None], b[None])[0]
    if robot.base_kind is BaseKind.DIFF_DRIVE and np.hypot(*(b[:2] - a[:2])) > 1e-9:
        rows = _turn_drive_turn(a, b, offset, spacing, most, backward)
    else:
        reach = np.abs(offset) * np.where(np.arange(space.nv) < space.base_nv, 1.0, 0.4)
        if space.planar:
            reach[0] = np.hypot(*(b[:2] - a[:2]))
        count = max(int(np.ceil(reach.max(initial=0.0) / spacing)), 4) + 1
        count = count if most is None else min(count, most)
        if space.planar:  # a straight base path, not the screw arc, for an omnidirectional base
            offset[:2] = b[:2] - a[:2]
            rows = a + np.linspace(0.0, 1.0, count)[:, None] * offset
        else:
            rows = space.interpolate(a[None], b[None], np.linspace(0.0, 1.0, count))
    rows[0], rows[-1] = a, b
    return rows


def _turn_drive_turn(a: Array, b: Array, offset: Array, spacing: float, most: int | None, may_back: bool) -> Array:
    drive = b[:2] - a[:2]
    length = float(np.hypot(*drive))
    heading = float(np.arctan2(drive[1], drive[0]))
    forward = abs(float(wrap_angle(np.array(heading - a[2])))) + abs(float(wrap_angle(np.array(b[2] - heading))))
    back = float(wrap_angle(np.array(heading + np.pi)))
    backward = abs(float(wrap_angle(np.array(back - a[2])))) + abs(float(wrap_angle(np.array(b[2] - back))))
    drive_yaw = heading if forward <= backward + 0.5 or not may_back else back
    turn_in = float(wrap_angle(np.array(drive_yaw - a[2])))
    turn_out = float(wrap_angle(np.array(b[2] - drive_yaw)))
    n_in = int(np.ceil(abs(turn_in) / _LARGEST_TURN - 1e-9))
    n_out = int(np.ceil(abs(turn_out) / _LARGEST_TURN - 1e-9))
    joints = np.abs(offset[3:]).max(initial=0.0)
    n_drive = max(int(np.ceil(max(length / spacing, 0.4 * joints / spacing))), 4)
    if most is not None:  # the drive needs one row, and so does a turn
        n_drive = max(min(n_drive, most - 1 - n_in - n_out), 1)
        n_in, n_out = (min(n, max((most - 1 - n_drive) // 2, 1)) for n in (n_in, n_out))
    rows = [a]
    rows += [_turned(a, a[2] + turn_in * k / n_in) for k in range(1, n_in + 1)]
    for k in range(1, n_drive + 1):
        s = k / n_drive
        row = a + s * offset
        row[:2] = a[:2] + s * drive
        row[2] = a[2] + turn_in
        rows.append(row)
    rows += [_turned(b, a[2] + turn_in + turn_out * k / n_out) for k in range(1, n_out + 1)]
    return np.array(rows)


def forward_rows(robot: RobotModel, rows: Array) -> Array:
    """Rows (M, nv) of the same places as rows (N, nv) of a differential drive, all of them driven forwards.

    Where the base went backwards, it turns in place first, and again after that. Short pieces stay, for turns need more
    room than they do.
    """
    back = robot.space.difference(rows[:-1], rows[1:])[:, 0] < 0.0
    ends = np.flatnonzero(np.diff(np.concatenate(([False], back, [False])).astype(int)))
    found, done = [], 0
    for first, last in ends.reshape(-1, 2).tolist():
        if float(np.hypot(*np.diff(rows[first : last + 1, :2], axis=0).T).sum()) < _SHORT_BACK:
            continue
        turns = np.linspace(0.0, np.pi, int(np.ceil(np.pi / _LARGEST_TURN)) + 1)
        turned = rows[first : last + 1].copy()
        turned[:, 2] += np.pi
        found += [rows[done : first + 1], *(_turned(rows[first], rows[first, 2] + turn)[None] for turn in turns[1:-1])]
        found += [turned, *(_turned(rows[last], rows[last, 2] + turn)[None] for turn in turns[-2:0:-1])]
        done = last
    return np.concatenate((*found, rows[done:]))


def _turned(row: Array, yaw: float) -> Array:
    out = row.copy()
    out[2] = yaw
    return out


_LARGEST_BEND = 1.0  # [rad] a heading that differs by less from the path's is bent into it, without a turn in place
_BEND_LENGTH = 0.8  # [m] over which it is bent
_LARGEST_FOLD_STEP = 0.3  # largest motion of a joint between two rows while the base stands [rad or m]


def waypoint_rows(robot: RobotModel, start: Array, goal: Array, path: npt.ArrayLike, *, spacing: float) -> Array:
    """Rows (N, nv) along waypoints of the base, from start to goal.

    A differential drive follows them forwards. Near an end the path is bent into its heading, or, where that differs
    much, the drive turns in place there. The joints move evenly along the path, and so does the heading of an
    omnidirectional base.

    Args:
        robot: the robot; its base must move.
        start, goal: configurations (nq,).
        path: waypoints (K, 2) [m], from the start's to the goal's position; or rows (K, nv), which stay as they
            are, except for their ends.
        spacing: distance between rows [m].

    Raises:
        ParameterError: the path is neither (K, 2) nor (K, nv), not finite, or has fewer than two rows; or a fixed base.
    """
    space = robot.space
    try:
        points = np.asarray(path, dtype=float)
    except (TypeError, ValueError):
        raise ParameterError(f"path={path!r:.80} must be an array of numbers, (K, 2) or (K, {space.nv})") from None
    if points.ndim != 2 or points.shape[1] not in (2, space.nv) or len(points) < 2:
        raise ParameterError(f"path has shape {points.shape}; it must be (K, 2) or (K, {space.nv}) with K ≥ 2")
    if not np.isfinite(points).all():
        raise ParameterError("path has entries that are not finite")
    if not space.planar:
        raise ParameterError(f"path: the base of {robot.name!r} is fixed, so that it follows no waypoints")
    endpoints = space.to_coordinates(np.stack((start, goal)))
    if points.shape[1] == space.nv:
        rows = points.copy()
        rows[0], rows[-1] = endpoints
        return rows
    points = np.vstack((endpoints[0, :2], points[1:-1], endpoints[1, :2]))
    if robot.base_kind is BaseKind.DIFF_DRIVE:
        points = _bent(points, float(endpoints[0, 2]))
        points = _bent(points[::-1], float(endpoints[1, 2]) + np.pi)[::-1]
    points = resample(points, spacing)
    share = np.linspace(0.0, 1.0, len(points))
    rows = endpoints[0] + share[:, None] * space.difference(endpoints[:1], endpoints[1:])
    rows[:, :2] = points
    if robot.base_kind is not BaseKind.DIFF_DRIVE:
        rows[0], rows[-1] = endpoints
        return rows
    steps = np.diff(points, axis=0)
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    middles = heading[:-1] + 0.5 * wrap_angle(np.diff(heading))
    rows[:, 2] = np.unwrap(np.concatenate([heading[:1], middles, heading[-1:]]))
    first = _turn(rows[0], float(endpoints[0, 2]))[::-1]
    last = _turn(rows[-1], float(endpoints[1, 2]))
    rows = np.vstack((first[:-1], rows, last[1:]))
    rows[0], rows[-1] = endpoints
    rows[:, 2] = np.unwrap(rows[:, 2])
    return rows


def tucked_rows(robot: RobotModel, start: Array, goal: Array, path: npt.ArrayLike, *, spacing: float) -> Array:
    """Rows (N, nv) along waypoints of the base, on which the robot drives in its home posture.

    It folds into that posture at the start and unfolds from it at the goal, while the base stands.

    Args:
        robot, start, goal, path, spacing: as in :func:`waypoint_rows`; ``path`` (K, 2).

    Raises:
        ParameterError: as :func:`waypoint_rows`.
    """
    space = robot.space
    endpoints = space.to_coordinates(np.stack((start, goal)))
    folded = endpoints.copy()
    folded[:, space.base_nv :] = space.to_coordinates(robot.home_q)[space.base_nv :]
    first, last = space.from_coordinates(folded)
    rows = waypoint_rows(robot, first, last, path, spacing=spacing)
    folded = rows[[0, -1]]
    moves = space.difference(endpoints, folded)
    moves[:, : space.base_nv] = 0.0
    stands = []
    for move, row in zip(moves, folded, strict=True):
        count = int(np.ceil(float(np.abs(move).max(initial=0.0)) / _LARGEST_FOLD_STEP - 1e-9))
        stands.append(row + (np.arange(count)[:, None] / max(count, 1) - 1.0) * move)  # from the end's posture on
    return np.vstack((stands[0], rows, stands[1][::-1]))


def _bent(points: Array, yaw: float) -> Array:
    """The path (K, 2), its beginning bent so that it starts with the heading ``yaw`` where they do not differ much."""
    fine = resample(points, 0.02)
    length = 0.02 * (len(fine) - 1)
    count = int(min(_BEND_LENGTH, 0.4 * length) / 0.02)
    if count < 3:
        return points
    chord = fine[count] - fine[0]
    if abs(float(wrap_angle(np.array(yaw - np.arctan2(chord[1], chord[0]))))) >= _LARGEST_BEND:
        return points
    reach = float(np.hypot(*chord))
    after = fine[count + 1] - fine[count]
    tangents = reach * np.array([np.cos(yaw), np.sin(yaw)]), reach * after / np.hypot(*after)
    s = np.linspace(0.0, 1.0, count + 1)[:, None]
    bow = (
        (2 * s**3 - 3 * s**2 + 1) * fine[0]
        + (s**3 - 2 * s**2 + s) * tangents[0]
        + (3 * s**2 - 2 * s**3) * fine[count]
        + (s**3 - s**2) * tangents[1]
    )
    return np.vstack((bow, fine[count + 1 :]))


def _turn(row: Array, yaw: float) -> Array:
    """Rows that turn in place from ``row`` to the heading ``yaw``; the row alone where that is a small bend."""
    turn = float(wrap_angle(np.array(yaw - row[2])))
    if abs(turn) < _LARGEST_BEND:
        return row[None]
    count = int(np.ceil(abs(turn) / _LARGEST_TURN)) + 1
    rows = np.repeat(row[None], count, axis=0)
    rows[:, 2] += np.linspace(0.0, turn, count)
    return rows


_LINE_TICKS = 6  # most that a straight line gets
_LINE_DEPTH = (-0.28, -0.15, -0.08, 0.0)  # a line whose nodes are deeper than this [m] after tick 0, 1, 2 … is given up
_LINE_LINKS, _LINE_SHARE = 4, 0.5  # an arm's line that touches with more links, or for longer, is given up
_LINE_STRIDE, _LINE_FEWEST = 8, 3  # every eighth node is looked at before the line is, where there are so many
_TUCKED_WITHIN = 0.05  # [rad or m] joints that differ by less from the home posture are in it
STUCK_TICKS = 6
"""Ticks in a row without becoming clearer after which a strip is given up; one that stays broken only grows nodes."""
_LEAST_GAIN_OF_CLEARANCE = 1e-3  # [m] by which it must get clearer to count
_MOST_TICKS = 30  # of a strip along a path, until it is certified
_EXTRA_TICKS = 4  # most ticks more of a certified strip that is still very near an obstacle
_NEAR_ARM = 2.0  # very near an arm's strip: this many times its clearance; in a shelf everything is within ``near``


def rows_along(problem: PlanningProblem, path: npt.ArrayLike, make: Callable[..., Array] = waypoint_rows) -> Array:
    """Rows (N, nv) along a path, by ``make``; further apart where there were more than a strip may have."""
    spacing, most = problem.spacing, problem.params.max_nodes
    for _ in range(7):
        rows = make(problem.robot, problem.start, problem.goal, path, spacing=spacing)
        if len(rows) <= most:
            return rows
        spacing *= 1.02 * len(rows) / most
    return rows[np.linspace(0, len(rows) - 1, most).round().astype(int)]  # turns and folds are too many


def path_rows(problem: PlanningProblem, path: Array) -> Iterator[tuple[Array, str]]:
    """Rows (N, nv) to relax along a path (K, 2) of the base, and how they differ from others.

    The joints move in step with the base; and, where start or goal is in another posture than home, the robot folds
    into its home posture for the drive.
    """
    robot = problem.robot
    yield rows_along(problem, path), ""
    joints = robot.space.to_coordinates(np.stack((robot.home_q, problem.start, problem.goal)))[:, robot.space.base_nv :]
    if np.abs(joints[1:] - joints[0]).max(initial=0.0) > _TUCKED_WITHIN:
        yield rows_along(problem, path, tucked_rows), " with the arm tucked"


def staged_rows(problem: PlanningProblem, path: Array, drive: Array, before: Array, after: Array) -> Array:
    """Rows (N, nv) of the joints where the base stands, along a path of the base, and of the joints again.

    Args:
        problem: start and goal, and how many nodes there may be.
        path: (K, 2) path of the base [m].
        drive: (2, nv) coordinates at its ends.
        before, after: rows from the start to the first of these, and from the last to the goal.
    """
    first, last = problem.robot.space.from_coordinates(drive)
    spacing, most = problem.spacing, problem.params.max_nodes - len(before) - len(after) + 2
    for _ in range(7):
        rows = waypoint_rows(problem.robot, first, last, path, spacing=spacing)
        if len(rows) <= most:
            break
        spacing *= 1.02 * len(rows) / max(most, 2)
    whole = np.vstack((before[:-1], rows, after[1:]))
    if len(whole) > problem.params.max_nodes:
        whole = whole[np.linspace(0, len(whole) - 1, problem.params.max_nodes).round().astype(int)]
    return whole


def line_strip(problem: PlanningProblem) -> Strip:
    """The straight line as a strip."""
    rows = straight_line(
        problem.robot,
        problem.start,
        problem.goal,
        spacing=problem.spacing,
        most=problem.params.max_nodes,
        backward=problem.backward,
    )
    return Strip.from_coordinates(problem.robot, problem.satisfying(rows), ends=problem.endpoints)


def path_strip(problem: PlanningProblem, rows: Array) -> Strip:
    """A planner's rows (N, nv) as a strip between start and goal; drivable for a differential drive."""
    if problem.robot.base_kind is BaseKind.DIFF_DRIVE:
        rows, _ = project_rolling(problem.robot.space, rows)
    return Strip.from_coordinates(problem.robot, problem.satisfying(rows), ends=problem.endpoints)


def relax_path(
    problem: PlanningProblem,
    strip: Strip,
    *,
    stuck: int | None = None,
    over: Callable[[], bool] | None = None,
    watch: Callable[[DeformReport], object] | None = None,
) -> DeformReport:
    """Relax a strip until it is certified, and a few ticks more where it is still very near an obstacle.

    It is given up when it has converged, after 30 ticks, after ``stuck`` ticks in a row in which it got no clearer
    (None: never for that), or where ``over()`` is true; ``over`` is the problem's deadline where None.
    """
    deformer, scene, over = problem.deformer, problem.scene, over or problem.deadline.over
    clearest, since = -np.inf, 0

    def ended(report: DeformReport) -> bool:
        nonlocal clearest, since
        since = 0 if report.node_clearance > clearest + _LEAST_GAIN_OF_CLEARANCE else since + 1
        clearest = max(clearest, report.node_clearance)
        return (report.usable and not problem.missed(report)) or (stuck is not None and since >= stuck) or over()

    report = deformer.settle(strip, scene, max_ticks=_MOST_TICKS, until=ended, watch=watch)
    params = deformer.params
    enough = params.near if problem.region is not None else min(params.near, _NEAR_ARM * params.clearance)
    for _ in range(_EXTRA_TICKS):
        if not report.usable or report.node_clearance >= enough or over():
            break
        further = deformer.step(report.strip, scene)
        if watch is not None:
            watch(further)
        if not further.usable or further.node_clearance <= report.node_clearance or problem.missed(further):
            break
        report = replace(further, ticks=report.ticks + 1, reason=report.reason)
    return report


class PathSearch:
    """Base of searches for certified strips: it relaxes the line and paths, and times that by phase."""

    def __init__(self, problem: PlanningProblem, watch: Callable[[DeformReport], object] | None) -> None:
        self.problem: PlanningProblem = problem
        self.watch: Callable[[DeformReport], object] | None = watch
        self.timings: dict[str, float] = {"line": 0.0, "planner": 0.0, "relaxation": 0.0}
        self.ticks = self.attempts = 0

    @contextmanager
    def timed(self, phase: str) -> Iterator[None]:
        """Account the time that a block takes to a phase."""
        began = perf_counter()
        yield
        self.timings[phase] += perf_counter() - began

    def hopeless(self, line: Strip) -> str:
        """Why relaxing the straight line would not help; empty where it may.

        Nodes of a base that are deep in an obstacle come out on both sides of it. A line of an arm relaxes where some
        links touch something for some of the way, and not each other, which hardly any force tells of.
        """
        planar, work = self.problem.robot.space.planar, self.problem.deformer.workspace
        nodes = line.coordinates[:: _LINE_STRIDE if planar else 1]
        if planar and len(nodes) < _LINE_FEWEST:
            return ""
        with self.timed("line"):
            work.prediction = None
            work.replace(nodes, self.problem.scene)
        if planar:
            depth = -work.obstacles.least_clearance()
            return f"{depth:.2f} m deep in an obstacle" if depth > -_LINE_DEPTH[0] else ""
        if (work.self_pairs.bound < 0.0).any():
            return "the robot touches itself on the way"
        touching = work.obstacles.clearance() < 0.0
        links, share = int(touching.any(axis=0).sum()), float(touching.any(axis=1).mean())
        if links > _LINE_LINKS or share > _LINE_SHARE:
            touch = "touches" if links == 1 else "touch"
            return f"{plural(links, 'link')} {touch} something, for {100 * share:.0f} % of the way"
        return ""

    def relax_line(self, strip: Strip, relax: bool) -> DeformReport:
        """A few ticks of the straight line, or none; it is given up where nodes stay deep inside an obstacle."""
        deformer, scene = self.problem.deformer, self.problem.scene
        with self.timed("line"):
            report = deformer.assess(strip, scene)
            for tick in range(1, _LINE_TICKS + 1 if relax else 1):
                deep = report.node_clearance < _LINE_DEPTH[min(tick, len(_LINE_DEPTH)) - 1]
                done = report.usable and not self.problem.missed(report)
                if done or deep or self.problem.deadline.over():
                    break  # deep: nodes on both sides of an obstacle, which more ticks would not bring together
                step = deformer.step(report.strip, scene, nodes=tick > 3)
                report = replace(step, ticks=tick)
                if self.watch is not None:
                    self.watch(step)
        return report

    def relax_rows(
        self, rows: Array, stuck: int | None, over: Callable[[], bool] | None = None
    ) -> tuple[Strip, DeformReport]:
        """The strip of rows (N, nv) along a path, and the report of :func:`relax_path` on it."""
        with self.timed("relaxation"):
            strip = path_strip(self.problem, rows)
            return strip, relax_path(self.problem, strip, stuck=stuck, over=over, watch=self.watch)

    def ompl(
        self,
        attempt: int,
        margin: float,
        timeout: float,
        box: tuple[Array, Array] | None,
        deadline: Deadline,
        fineness: float = 1.0,
    ) -> PathResult:
        """A path of OMPL, a different one for each ``attempt``; for the rest see :func:`ompl_path`."""
        problem = self.problem
        with self.timed("planner"):
            return ompl_path(
                problem.robot,
                problem.scene,
                problem.start,
                problem.goal,
                seed=problem.seed + SEED_STRIDE * attempt,
                margin=margin,
                timeout=timeout,
                spacing=problem.spacing,
                box=box,
                fineness=fineness,
                most=problem.params.max_nodes,
                deadline=deadline,
            )
