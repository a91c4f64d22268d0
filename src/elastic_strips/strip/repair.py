"""Repair: a path from anywhere as a strip, which gives way to the obstacles until it is certified."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision import BodySet
from elastic_strips.collision.path_rows import PathLike, as_arcs, path_rows
from elastic_strips.errors import RobotError, SceneError
from elastic_strips.robot import BaseKind, Kinematics, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.summary import Summary
from elastic_strips.validation import check_count, check_type, named_arguments

from .deformer import Deformer
from .params import DeformParams
from .report import DeformReport
from .solver import project_rolling
from .strip import Strip

_COMPARED_PLACES = 200  # of the path, where two are compared
_BOW = 2e-3  # [m] by which a base on arcs may leave the lines of a path
_SPACING = 0.2  # [m or rad] between two nodes of a path's strip
_ROUGH = 1.2  # times as far as the given one goes a path that is certified, and still to be relaxed
_RELAXED_TICKS = 4  # from one look at how far it goes to the next: no more is to be lost of it than need be


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RepairReport(Summary):
    """The result of :func:`repair`.

    Attributes:
        strip: the repaired path, or the best that was reached; its ends are those of the path.
        certified: whether it is certified.
        moved: largest displacement [m] of any control point, at the same share of the path.
        report: report of the last tick.
        reason: why it is not certified, or empty.
        relaxed: whether it went much farther once it was certified, and was relaxed: between its ends it may have lost
            what was particular to the given path.
    """

    strip: Strip
    certified: bool
    moved: float
    report: DeformReport
    reason: str
    relaxed: bool

    def _summary(self) -> dict[str, object]:
        return {"certified": self.certified, "moved": f"{self.moved:.3f} m", "reason": self.reason}


@named_arguments
def repair(
    robot: RobotModel,
    scene: Scene,
    path: PathLike,
    *,
    params: DeformParams | None = None,
    max_ticks: int = 60,
) -> RepairReport:
    """Push a path free of the obstacles.

    Args:
        robot: the robot.
        scene: the obstacles, standing still.
        path: a strip, configurations (N, nq), coordinate rows (N, nv), or a path of `load_path`, which is not called
            certified where it has doubts. Rows go linearly, by their values. Between configurations that are far apart
            it gets nodes. A differential drive's are first moved, as little as possible, until wheels can follow them.
        params: parameters of the deformation; the default preset where None.
        max_ticks: largest number of ticks until it is certified; while a control point goes a fifth farther than before
            then, at most as many again relax it, with the certificate.

    Raises:
        RobotError, SceneError: not a robot, or not a scene.
        ConfigurationError: the path does not fit the robot.
        ParameterError: ``max_ticks`` below 1.
    """
    check_type("robot", robot, RobotModel, RobotError)
    check_type("scene", scene, Scene, SceneError)
    check_type("params", params, DeformParams, none=True)
    check_count("max_ticks", max_ticks, low=1)
    params = DeformParams() if params is None else params
    before = _as_strip(robot, path, params.max_nodes)
    start = before
    if robot.base_kind is BaseKind.DIFF_DRIVE and float(before.lateral_slip.max(initial=0.0)) > 0.0:
        rows, _ = project_rolling(robot.space, before.coordinates)
        start = Strip.from_coordinates(robot, rows, ends=before.q[[0, -1]])
    deformer = Deformer(robot, params)
    report, ticks, relaxed = deformer.assess(start, scene), 0, False
    if not report.usable:
        report = deformer.settle(start, scene, max_ticks=max_ticks, until="certified")
        rough = _ROUGH * _way(before)
        while report.usable and ticks < max_ticks and _way(report.strip) > rough:
            smoother = deformer.settle(report.strip, scene, max_ticks=_RELAXED_TICKS)
            ticks += _RELAXED_TICKS
            if not smoother.usable:
                break
            report, relaxed = smoother, True
    reasons = [*getattr(path, "doubts", ()), *([] if report.usable else [report.reason])]
    return RepairReport(
        report.strip, not reasons, displacement(before, report.strip), report, "; ".join(reasons), relaxed
    )


def _as_strip(robot: RobotModel, path: PathLike, most: int) -> Strip:
    """A path as a strip: what lies between two of its configurations gets nodes, which can give way.

    ``most`` is the largest number of nodes, as long as the path itself has no more.
    """
    if isinstance(path, Strip):
        return path
    given, space = path_rows(robot, path), robot.space
    rows = as_arcs(robot, given, "values" if given.stated else "arc", bow=_BOW).rows
    length = np.linalg.norm(space.difference(rows[:-1], rows[1:]), axis=1)
    spacing = max(_SPACING, float(length.sum()) / max(most - len(rows), 1))
    count = np.maximum(np.ceil(length / spacing - 1e-9), 1).astype(int)
    nodes = [
        space.interpolate(one[None], two[None], np.arange(n) / n)
        for one, two, n in zip(rows[:-1], rows[1:], count.tolist(), strict=True)
    ]
    q = getattr(path, "q", None)
    ends = space.from_coordinates(rows[[0, -1]]) if q is None and given.stated else np.asarray(path if q is None else q)
    return Strip.from_coordinates(robot, np.vstack([*nodes, rows[-1:]]), ends=ends[[0, -1]])


def displacement(one: Strip, two: Strip) -> float:
    """Largest displacement [m] of any control point between two strips of a robot.

    They are compared at the same node, or at the same share of the way where the numbers of nodes differ.
    """
    a, b = _points(one), _points(two)
    if len(a) != len(b):
        count = max(len(a), len(b), _COMPARED_PLACES)
        a, b = _resampled(a, count), _resampled(b, count)
    return float(np.linalg.norm(a - b, axis=2).max())


def _way(strip: Strip) -> float:
    """How far that control point goes that goes farthest [m]."""
    return float(np.linalg.norm(np.diff(_points(strip), axis=0), axis=2).sum(axis=0).max(initial=0.0))


def _points(strip: Strip) -> Array:
    kin = Kinematics(strip.robot.tree, len(strip))
    kin.update(strip.coordinates, jacobians=False)
    return BodySet.control_points(strip.robot).capsule_ends(kin)[:, :, 0]


def _resampled(points: Array, count: int) -> Array:
    """Control points (count, C, 3) at even shares of the way of the farthest of them."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1)
    along = np.r_[0.0, np.cumsum(steps)]
    along = along / along[-1] if along[-1] > 0 else np.linspace(0, 1, len(points))
    at = np.linspace(0, 1, count)
    flat = points.reshape(len(points), -1)
    return np.column_stack([np.interp(at, along, c) for c in flat.T]).reshape(count, *points.shape[1:])
