"""What a plan is asked: refused where it is of the wrong kind, unsound or too close to something."""

from __future__ import annotations

import logging
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array

from ..errors import ConfigurationError, ParameterError, RobotError, SceneError
from ..proximity import BodySet, MotionBounds, ObstacleProximity, SelfProximity
from ..robot import Kinematics, RobotModel
from ..scene import Scene
from ..strip import Deformer, DeformParams
from .deadline import Deadline

_log = logging.getLogger(__name__)
MOST_DISTANCE = 1000.0
"""Longest way [m] that is planned at once; what is longer is likely in millimetres."""
_FAR = 200.0  # [m] a goal farther away is told of
_HUGE, _THICK = 200.0, 1.0  # [m] an obstacle of such a size is told of, unless it is a wall or a floor


def check_problem(robot: RobotModel, scene: Scene) -> None:
    """Check that a robot is a robot and a scene a scene.

    Raises:
        RobotError, SceneError: one of them is something else.
    """
    if not isinstance(robot, RobotModel):
        raise RobotError(f"robot is a {type(robot).__name__}; it must be a RobotModel, as load_robot(...) gives it")
    if not isinstance(scene, Scene):
        raise SceneError(f"scene is a {type(scene).__name__}; it must be a Scene: Scene([...])")


def workspace(robot: RobotModel, scene: Scene, params: DeformParams | None, deformer: Deformer | None) -> Deformer:
    """The deformer that is given, or a new one, once all of these are of the right kind.

    Raises:
        RobotError, SceneError, ParameterError: one of them is something else.
    """
    check_problem(robot, scene)
    if deformer is None:
        return Deformer(robot, DeformParams() if params is None else params)
    if not isinstance(deformer, Deformer):
        raise ParameterError(f"deformer is a {type(deformer).__name__}; it must be a Deformer of the same robot")
    return deformer


def check_search(seed: int, timeout: float) -> Deadline:
    """Check a seed and a time limit [s]; returns when the time is over.

    Raises:
        ParameterError: one of them is outside its range.
    """
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise ParameterError(f"seed={seed!r} must be an integer ≥ 0")
    number = isinstance(timeout, (int, float, np.integer, np.floating)) and not isinstance(timeout, bool)
    if not number or not timeout > 0:
        raise ParameterError(f"timeout={timeout!r} must be a number > 0 of seconds")
    return Deadline(float(timeout))


def check_ends(
    robot: RobotModel, scene: Scene, start: npt.ArrayLike, goal: npt.ArrayLike, params: DeformParams
) -> tuple[Array, Array]:
    """Check start and goal: sound configurations (nq,) that keep the clearances of ``params``.

    What is suspiciously far away or large is told of in a warning: lengths are in metres.

    Raises:
        RobotError, SceneError: not a robot, or not a scene.
        ConfigurationError: names what is wrong: the entry, the pair that is too close and its distance, or how far the
            goal is away.
    """
    check_problem(robot, scene)
    ends = []
    for what, given in (("start", start), ("goal", goal)):
        q = robot.check_q(given, what=what)
        if q.ndim != 1:
            raise ConfigurationError(f"{what} has shape {q.shape}; it must be one configuration ({robot.nq},)")
        ends.append(q)
    if robot.space.planar:
        _check_distance(float(np.hypot(*(ends[1] - ends[0])[:2])), params)
    _warn_of_size(scene)
    bodies = BodySet.links(robot)
    kin = Kinematics(robot.tree, 2)
    kin.update(robot.space.to_chart(np.stack(ends)))
    obstacles = ObstacleProximity(bodies, influence=2.0 * params.clearance + 0.01)
    obstacles.update(kin, scene)
    reach = 2.0 * params.self_clearance + 0.01
    own = SelfProximity(bodies, robot.self_pairs, MotionBounds(bodies), influence=reach)
    own.update(kin)
    for node, what in enumerate(("start", "goal")):
        if obstacles.bound[node].size:
            body, part = np.unravel_index(int(np.argmin(obstacles.bound[node])), obstacles.bound.shape[1:])
            other = obstacles.obstacle_name(int(part))
            _refuse(what, obstacles.bound[node, body, part], params, "clearance", bodies.names[body], other)
        if own.bound[node].size:
            pair = int(np.argmin(own.bound[node]))
            one, two = (bodies.names[k] for k in own.pairs[pair])
            _refuse(what, own.bound[node, pair], params, "self_clearance", one, two)
    return ends[0], ends[1]


def _check_distance(distance: float, params: DeformParams) -> None:
    if distance > MOST_DISTANCE:
        raise ConfigurationError(
            f"goal is {distance:.6g} m from start, more than the {MOST_DISTANCE:g} m that are planned at once; lengths "
            "are in metres (are these millimetres?), and a longer way takes goals in between"
        )
    if distance > _FAR:
        _warn_once(
            f"goal is {distance:.6g} m from start: lengths are in metres; a strip has at most {params.max_nodes} nodes "
            "(max_nodes)"
        )


def _warn_of_size(scene: Scene) -> None:
    table = scene.table
    size = 2.0 * table.half_extents
    huge = (size.max(axis=1, initial=0.0) > _HUGE) & (size.min(axis=1, initial=np.inf) > _THICK)
    if huge.any():
        k = int(np.argmax(np.where(huge, size.max(axis=1), 0.0)))
        x, y, z = size[k]
        name = scene.names[int(table.obstacle_index[k])]
        _warn_once(f"obstacle {name!r} is {x:.6g} m × {y:.6g} m × {z:.6g} m large: lengths are in metres")


@lru_cache(maxsize=64)
def _warn_once(message: str) -> None:
    """Who plans anew at every tick need not hear it at every tick."""
    _log.warning("%s", message)


def _refuse(what: str, distance: float, params: DeformParams, bound: str, one: str, two: str) -> None:
    if distance < 0:
        raise ConfigurationError(f"{what} is in collision: {one!r} is {-distance * 1000:.1f} mm deep in {two!r}")
    clearance = float(getattr(params, bound))
    if distance <= clearance:
        raise ConfigurationError(
            f"{what} is too close: {one!r} is {distance * 1000:.1f} mm from {two!r}; more than "
            f"{clearance * 1000:.1f} mm ({bound}) are needed; "
            f"params=DeformParams({bound}=…) asks for less, down to 0"
        )
