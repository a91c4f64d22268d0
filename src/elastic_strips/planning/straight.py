"""Straight motions of the hand: an approach or a retreat by the joints alone, without turning the hand."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Indices
from elastic_strips.errors import ConfigurationError
from elastic_strips.robot import RobotModel
from elastic_strips.robot.inverse_kinematics import PoseSolver, PoseTarget
from elastic_strips.scene import Scene
from elastic_strips.strip import Deformer, DeformParams, DeformStatus, Strip
from elastic_strips.validation import check_array, check_choice, check_number, named_arguments

from .leaving import MOST_DEPTH, joined, leave_along
from .problem import ARM, check_kinds, ease, nearest_things
from .report import PlanReport

AXES = ("hand", "world")
"""The axes in which a straight motion may be given."""
_HAND_STEP = 0.01  # [m] of the hand between two nodes
_ROUNDED = 1e-9  # of a step that a line may be longer by, from rounding
_LINE_TOLERANCE = 1e-5  # [m] that the hand may be off the line at a node
_LARGEST_JOINT_STEP = 0.3  # [rad or m] most that a joint may move between two nodes
_MOST_ITERATIONS = 15


@named_arguments
def plan_straight(
    robot: RobotModel,
    scene: Scene,
    start: npt.ArrayLike,
    frame: str,
    by: npt.ArrayLike,
    *,
    axes: str = "world",
    params: DeformParams | None = None,
    start_depth: float = 0.0,
) -> PlanReport:
    """A strip along which a frame of the robot moves straight and is not turned; the base stands.

    Between the nodes, which are 1 cm apart, the joints go straight, and so the frame is slightly off the line:
    a tenth of a millimetre where no joint turns fast. The way back from an approach is ``strip.reversed()``.

    Args:
        robot: the robot.
        scene: the obstacles.
        start: configuration (nq,).
        frame: name of the frame.
        by: (3,) how far it moves [m].
        axes: axes of that motion: those of the ``"world"``, or the hand's own (``"hand"``).
        params: parameters with the clearances to prove; where None, those of :func:`plan_report`, but no more than half
            of what both ends have, or the last where the start is left.
        start_depth: a start that touches by at most this much [m], as what stands on a table does, is left along the
            line if all that is too near gets farther all the way; as for :func:`plan_report`, the report's
            ``departure`` is that part, the report is not certified as a whole, and ``departure.rest`` is the certified
            strip from where everything is free.

    Returns:
        The report. It is not certified, and gives the reason, where the joints end before the line does or something is
        too near.

    Raises:
        RobotError, SceneError: not a robot, or not a scene; an unknown frame.
        ConfigurationError: the start is not valid.
        ParameterError: ``by`` is not three numbers, unknown axes, or a start_depth outside its range.
    """
    check_choice("axes", axes, AXES)
    start_depth = check_number("start_depth", start_depth, low=0.0, high=MOST_DEPTH, unit="m")
    began = perf_counter()
    check_kinds(robot, scene)
    offset = check_array("by", by, (3,))
    q = robot.check_q(start, what="start")
    here, solver = robot.space.to_coordinates(q), PoseSolver(robot, frame)
    if axes == "hand":
        offset = solver.place(here[None])[1][0] @ offset
    lines, steps = straight_lines(solver, here[None], offset[None])
    rows, left = lines[0, : max(int(steps[0]), 1) + 1], 0.0
    if steps[0] < lines.shape[1] - 1:
        left = float(np.linalg.norm(offset)) * (1.0 - float(steps[0]) / (lines.shape[1] - 1))
    ends = np.stack((q, robot.space.from_coordinates(rows[-1])))
    if robot.space.planar:  # to the last bit
        ends[1, :4] = q[:4]
    strip = Strip.from_coordinates(robot, rows, ends=ends)
    deformer = Deformer(robot, ARM if params is None else params)
    eased, departure, rest, why = "", None, strip, ""
    if params is None:
        nearest = nearest_things(deformer.workspace, robot, scene, (ends[0], ends[1]))
        eased = ease(deformer, [near for near in nearest if start_depth == 0.0 or near.what == "goal"])
    if start_depth > 0.0 and left == 0.0:
        try:
            departure, rest = leave_along(strip, scene, start_depth, deformer.params)
        except ConfigurationError as error:
            why = str(error)
    report = deformer.assess(rest, scene)
    length = float(np.linalg.norm(offset))
    reason = f"straight by {length:g} m"
    if left > 0.0:
        done = f"{length - left:.3g} m of {length:g} m"
        reason = f"{frame!r} gets no further than {done}: beyond that, joints would leave their limits or jump"
    elif why or not report.usable:
        reason = why or report.reason
    elif eased:
        reason = f"{reason}; {eased}"
    done = left == 0.0 and report.usable and not why
    if departure is not None:
        departure = replace(departure, rest=rest if done else None)
        said = "certified" if done else "not certified"
        reason = f"{departure}; {said} from node {len(departure.strip) - 1} on: {reason}"
        strip = joined(departure, rest)
        report = replace(deformer.assess(strip, scene), status=DeformStatus.BROKEN, reason=reason)
        done = False
    return PlanReport(
        strip,
        strip,
        done,
        "straight" if done or (departure is not None and departure.rest is not None) else "none",
        reason,
        scene,
        deformer.params,
        report,
        attempts=0,
        ticks=0,
        seconds=perf_counter() - began,
        departure=departure,
    )


def straight_lines(solver: PoseSolver, here: Array, offsets: Array) -> tuple[Array, Indices]:
    """Rows (N, K + 1, nv) along the lines of the solver's frame from configurations (N, nv), and how many of the K
    steps (N,) each gets on before the joints end or would jump; it stays there.

    Args:
        solver: of one frame.
        here: coordinate rows.
        offsets: (N, 3) how far each frame moves along the world's axes [m].
    """
    robot, space = solver.robot, solver.robot.space
    position, turn = (each.copy() for each in solver.place(here))
    count = max(1, int(np.ceil(np.linalg.norm(offsets, axis=1).max() / _HAND_STEP - _ROUNDED)))
    free, exact = np.ones(robot.nv), np.zeros(3)
    free[: space.base_nv] = 0.0
    rows, steps = np.repeat(here[:, None], count + 1, axis=1), np.zeros(len(here), dtype=int)
    going = np.arange(len(here))
    for k in range(1, count + 1):
        last = rows[going, k - 1]
        begin = last + (last - rows[going, k - 2] if k > 1 else 0.0)
        begin = np.clip(begin, space.lower, space.upper)
        target = PoseTarget(solver.frames[0], position[going] + k / count * offsets[going], turn[going], exact)
        found, size = solver.solve(begin, [target], free, _MOST_ITERATIONS, every=True)
        jump = np.abs(space.difference(last, found)).max(axis=1)
        good = (size <= _LINE_TOLERANCE) & (jump <= _LARGEST_JOINT_STEP)
        going = going[good]
        if len(going) == 0:
            break
        rows[going, k:] = found[good, None]
        steps[going] = k
    return rows, steps
