"""Itinerary: goals one after the other, how a base is turned where any heading will do, and where a goal is passed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import atan2, hypot
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError, GoalError
from elastic_strips.planning import AllOf, BasePose, Goal, HandPose, find_goals
from elastic_strips.planning.goals import by_name, is_goal_region
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.scene import Scene

from .params import Tolerance

if TYPE_CHECKING:
    from typing import TypeAlias

Goals: TypeAlias = "Goal | Sequence[Goal | Sequence[Goal]]"
"""A goal, or several, one after the other; each may be a list of goals of which any will do."""

_SAME_PLACE = 0.1  # [m] within which there is no way from one place to another


def goals_in_order(robot: RobotModel, given: Goals) -> list[Goal | Sequence[Goal]]:
    """The goals, one after the other; configurations (nq,) are checked.

    Raises:
        ConfigurationError: a configuration that is not valid, or no goal at all.
    """
    several = isinstance(given, np.ndarray) and given.ndim > 1
    if isinstance(given, Sequence) and not isinstance(given, (str, Mapping)):
        several = len(given) == 0 or is_goal_region(given)
    goals = list(cast("Sequence[Goal | Sequence[Goal]]", given)) if several else [cast("Goal", given)]
    if not goals:
        raise ConfigurationError("goal is an empty list")
    found = [(each, configuration_of(robot, each)) for each in goals]
    return [each if q is None else q for each, q in found]


def configuration_of(robot: RobotModel, goal: Goal | Sequence[Goal]) -> Array | None:
    """The configuration (nq,) that a goal is; None where it is something that several may reach.

    Raises:
        ConfigurationError: one that is not valid.
    """
    return None if is_goal_region(goal) else robot.check_q(cast("npt.ArrayLike", goal), what="goal")


def frames_of(goal: Goal | Sequence[Goal]) -> tuple[str, ...]:
    """The frames whose poses a goal is about, or the first of several that is about any; none where it is about the
    base or coordinates alone."""
    if isinstance(goal, Mapping):
        goal = by_name(cast("Mapping[str, object]", goal))
    if isinstance(goal, AllOf):
        return tuple(dict.fromkeys(hand.frame for hand in goal.hands))
    if isinstance(goal, HandPose):
        return (goal.frame,)
    if isinstance(goal, (Mapping, BasePose)) or not is_goal_region(goal):
        return ()
    return next((frames for frames in map(frames_of, cast("Sequence[Goal]", goal)) if frames), ())


def place_of(robot: RobotModel, goal: Goal | Sequence[Goal]) -> Array | None:
    """Place (2,) [m] of the floor at which a goal is, or the first of several: that of a hand, else of the base; None
    where coordinates or poses are asked for by name, or the base is fixed."""
    if not robot.space.planar:
        return None
    if isinstance(goal, AllOf):
        goal = [*goal.hands, *([] if goal.base is None else [goal.base])]
    if isinstance(goal, HandPose):
        return np.array(goal.position[:2])
    if isinstance(goal, BasePose):
        return np.array([goal.x, goal.y])
    if is_goal_region(goal):
        several = () if isinstance(goal, Mapping) else cast("Sequence[Goal]", goal)
        return next((place for place in (place_of(robot, each) for each in several) if place is not None), None)
    q = configuration_of(robot, goal)
    return None if q is None else robot.space.to_coordinates(q)[:2]


def hand_places(goal: Goal | Sequence[Goal]) -> Array:
    """(K, 3) places [m] at which a goal, or any of several, has a hand; a place counts once."""
    if isinstance(goal, Mapping):
        goal = by_name(cast("Mapping[str, object]", goal))
    if isinstance(goal, HandPose):
        return np.array([goal.position])
    several: Sequence[Goal] = ()
    if isinstance(goal, AllOf):
        several = goal.hands
    elif not isinstance(goal, (Mapping, BasePose)) and is_goal_region(goal):
        several = cast("Sequence[Goal]", goal)
    return np.unique(np.concatenate([np.zeros((0, 3)), *map(hand_places, several)]), axis=0)


def faced(robot: RobotModel, here: Array, goal: Goal | Sequence[Goal]) -> Goal | Sequence[Goal]:
    """A base pose of any heading, turned as the base arrives there; any other goal as it is.

    Then a differential drive need not turn at the goal, and goes on from there if it does not end there.

    Args:
        robot: the robot.
        here: (nv,) coordinate row from which it comes.
        goal: the goal.
    """
    if not isinstance(goal, BasePose) or goal.yaw is not None or robot.base_kind is not BaseKind.DIFF_DRIVE:
        return goal
    x, y = goal.x - float(here[0]), goal.y - float(here[1])
    return goal if hypot(x, y) < _SAME_PLACE else BasePose(goal.x, goal.y, atan2(y, x), goal.within)


def configurations(
    robot: RobotModel, scene: Scene, start: npt.ArrayLike, goals: Sequence[Goal | Sequence[Goal]]
) -> list[Array]:
    """Configurations (nq,) at goals, one after the other; of those of a pose, the one next to that before.

    Args:
        robot: the robot.
        scene: the obstacles.
        start: configuration (nq,) before the first.
        goals: the goals.

    Raises:
        GoalError: no configuration that is free reaches one of them.
    """
    found: list[Array] = [robot.check_q(start, what="start")]
    for goal in goals:
        q = configuration_of(robot, goal)
        if q is not None:
            found.append(q)
            continue
        here = robot.space.to_coordinates(found[-1])
        search = find_goals(robot, scene, found[-1], faced(robot, here, goal), count=1)
        if not len(search.configurations):
            search = find_goals(robot, scene, found[-1], goal, count=1)
        if not len(search.configurations):
            raise GoalError(f"goal {len(found)}: {search.reason}", search)
        found.append(search.configurations[0])
    return found[1:]


def off_goal(robot: RobotModel, rows: Array, goal: Array) -> Array:
    """(N, 3) how far coordinate rows (N, nv) are off a goal (nv,): the base [m], its heading [rad], and the joint that
    is furthest off [rad or m]."""
    off = np.abs(robot.space.difference(rows, np.broadcast_to(goal, rows.shape)))
    base = robot.space.base_nv
    out = np.zeros((len(rows), 3))
    if base:
        out[:, 0], out[:, 1] = np.hypot(off[:, 0], off[:, 1]), off[:, 2]
    out[:, 2] = off[:, base:].max(axis=1, initial=0.0)
    return out


def passed_at(robot: RobotModel, rows: Array, goal: Array, within: Tolerance) -> int | None:
    """Index of the row of a motion (N, nv) that is next to a goal (nv,), where that is within a tolerance, and the
    motion goes on from there; None where it is not."""
    most = np.array([within.position, within.yaw, within.joints])
    share = (off_goal(robot, rows, goal) / most).max(axis=1)
    nearest = int(share.argmin())
    return nearest if share[nearest] <= 1.0 and nearest < len(rows) - 1 else None
