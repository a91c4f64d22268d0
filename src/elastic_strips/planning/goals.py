"""Goals as people have them: a hand's pose, a base's, a few joints, a region, alternatives; and configurations there.

What reaches a goal is looked for near the start first, with the joints alone before the base, and must keep the
clearance. Where nothing does, a :class:`GoalSearch` says why, as data: how far out of reach, or what is touched.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError, GoalError, ParameterError
from elastic_strips.robot import RobotModel
from elastic_strips.robot.inverse_kinematics import PoseSearch, rotation_of
from elastic_strips.scene import Scene
from elastic_strips.strip import DeformParams
from elastic_strips.summary import Summary
from elastic_strips.validation import Checked, Finite, check_array, check_fields

from .problem import Deadline, nearest_things
from .validity import ValidityChecker

if TYPE_CHECKING:
    from typing import TypeAlias

_MARGIN = 0.02  # [m] that goals keep to obstacles where there is so much room
_LEAST = 1e-3  # [m] that they keep at least, where no clearance is given
_ENOUGH = 6  # configurations of a goal
_ROUNDS, _BASE_ROUNDS = 12, 24  # of 16 starts, with the joints alone and with the base
_ASKED = 24  # configurations that touch something, of which it is asked what
_YAWS, _PLACES = 16, 60  # tried, of a base whose yaw or place is free
_SECONDS = 2.0


@dataclass(frozen=True, slots=True)
class HandPose(Checked):
    """A frame of the robot at a pose in the world.

    Attributes:
        frame: its name.
        position: (3,) [m].
        orientation: quaternion (x, y, z, w), or None where it may be turned as it likes.
        within: (3,) it may be off by so much along the world's axes [m]: half the sides of a box.
    """

    frame: str
    position: tuple[float, float, float]
    orientation: tuple[float, float, float, float] | None = None
    within: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check_fields(self)
        check_array("HandPose.position", self.position, (3,))
        _check_box("HandPose.within", self.within, 3)
        if self.orientation is not None:
            rotation_of(self.orientation)

    def __str__(self) -> str:
        at = ", ".join(f"{v:g}" for v in self.position)
        turned = "" if self.orientation is None else ", turned as asked"
        return f"{self.frame!r} at ({at}) m{turned}"


@dataclass(frozen=True, slots=True)
class BasePose(Checked):
    """The base at a place of the floor, the joints as at the start.

    Attributes:
        x, y: [m].
        yaw: [rad], or None where it may stand as it likes.
        within: (2,) it may be off by so much along x and y [m].
    """

    x: Finite
    y: Finite
    yaw: Finite | None = None
    within: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_fields(self)
        _check_box("BasePose.within", self.within, 2)

    def __str__(self) -> str:
        return f"base at ({self.x:g}, {self.y:g}) m" + ("" if self.yaw is None else f", {self.yaw:g} rad")


Goal: TypeAlias = npt.ArrayLike | HandPose | BasePose | Mapping[str, float]
"""A configuration (nq,), a pose of hand or base, or some coordinates by name: ``x``, ``y``, ``yaw`` and joints."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class GoalSearch(Summary):
    """Configurations that reach a goal.

    Attributes:
        configurations: (K, nq), the nearest to the start first; none where ``reason`` says why.
        reason: what happened, in words.
        distance: by which a hand misses the goal at least [m]; 0 where it reaches it.
        angle: by which it is turned otherwise, then [rad].
        touching: what stands in the way of configurations that reach it, the most frequent first: "link and obstacle".
    """

    configurations: Array
    reason: str
    distance: float = 0.0
    angle: float = 0.0
    touching: tuple[str, ...] = ()

    def _summary(self) -> dict[str, object]:
        return {"configurations": len(self.configurations), "reason": self.reason}


def is_goal_region(goal: object) -> bool:
    """Whether a goal is something else than one configuration."""
    if isinstance(goal, (HandPose, BasePose, Mapping)):
        return True
    return isinstance(goal, Sequence) and not isinstance(goal, str) and (
        len(goal) == 0 or isinstance(goal[0], (HandPose, BasePose, Mapping, Sequence, np.ndarray))
    )  # fmt: skip


def find_goals(
    robot: RobotModel,
    scene: Scene,
    start: npt.ArrayLike,
    goal: Goal | Sequence[Goal],
    *,
    count: int = _ENOUGH,
    seed: int = 0,
    params: DeformParams | None = None,
    timeout: float = _SECONDS,
    base: bool = True,
) -> GoalSearch:
    """Configurations that reach a goal and touch nothing, the nearest to the start first.

    Where possible they keep 2 cm to the obstacles, else the least clearance.

    Args:
        robot: the robot.
        scene: the obstacles.
        start: configuration (nq,).
        goal: a goal, or several of which any will do.
        count: so many configurations at most, of each goal.
        seed: of random starts.
        params: with the clearance to keep; 1 mm where None.
        timeout: longest search [s] of each goal.
        base: whether a base that can move may, for a hand's pose that is out of the arm's reach.

    Raises:
        RobotError: a frame that the robot does not have.
        ConfigurationError: the start, or a goal that is a configuration, is not sound; a goal for a base that is fixed.
        ParameterError: something that is no goal.
    """
    start = robot.check_q(start, what="start")
    several: Sequence[Goal] = goal if isinstance(goal, Sequence) and is_goal_region(goal) else [goal]  # type: ignore[list-item]
    if not several:
        raise ParameterError("goal is an empty list")
    searches = []
    for k, one in enumerate(several):
        search = _Candidates(robot, scene, start, params, np.random.default_rng((seed, k)), timeout)
        searches.append(search.found(one, count, base))
    rows = np.concatenate([each.configurations for each in searches])
    if len(searches) == 1:
        return searches[0]
    if len(rows) == 0:
        nearest = min(searches, key=lambda each: each.distance)
        reason = "; ".join(each.reason for each in searches)
        return GoalSearch(rows, reason, nearest.distance, nearest.angle, nearest.touching)
    order = np.argsort(_distance(robot, start, rows), kind="stable")
    return GoalSearch(rows[order], f"{len(rows)} configurations of {len(several)} goals")


class _Candidates:
    """Search of one goal's configurations."""

    def __init__(
        self, robot: RobotModel, scene: Scene, start: Array, params: DeformParams | None, rng: np.random.Generator,
        timeout: float,
    ) -> None:  # fmt: skip
        self.robot, self.scene, self.start, self.params, self.rng = robot, scene, start, params or DeformParams(), rng
        self.here: Array = robot.space.to_coordinates(start)
        self.deadline = Deadline(timeout)
        clearance = _LEAST if params is None else params.clearance
        self.wide = ValidityChecker(robot, scene, margin=max(_MARGIN, clearance))
        self.tight = ValidityChecker(robot, scene, margin=clearance, bounds=self.wide.bounds)

    def found(self, goal: Goal, count: int, base: bool) -> GoalSearch:
        """Configurations of a goal."""
        if isinstance(goal, HandPose):
            return self._hand(goal, count, base)
        if isinstance(goal, BasePose):
            return self._sorted(goal, self._base_rows(goal), count)
        if isinstance(goal, Mapping):
            return self._sorted(goal, iter([self._named(goal)]), count)
        try:
            q = self.robot.check_q(goal, what="goal")
        except ConfigurationError:
            if np.asarray(goal, dtype=object).ndim == 0:
                kinds = "a configuration, HandPose, BasePose, joints by name, or a list of them"
                raise ParameterError(f"goal is a {type(goal).__name__}; it must be {kinds}") from None
            raise
        return GoalSearch(q[None], "a configuration")

    def _named(self, goal: Mapping[str, float]) -> Array:
        """The coordinate row of some coordinates by name, the others as at the start."""
        at = {name: goal[name] for name in ("x", "y", "yaw") if name in goal}
        if at and not self.robot.space.planar:
            raise ConfigurationError(f"goal: the base of {self.robot.name!r} is fixed; {', '.join(at)} cannot be set")
        joints = {name: value for name, value in goal.items() if name not in at}
        b = self.robot.space.base_nv
        named = self.robot.space.to_coordinates(self.robot.home(joints=joints))
        row = self.here.copy()
        for k, name in enumerate(("x", "y", "yaw")):
            if name in at:
                row[k] = check_array(f"goal[{name!r}]", [at[name]], (1,))[0]
        for name in joints:
            k = b + self.robot.joint_names.index(name)
            row[k] = named[k]
        return row

    def _base_rows(self, goal: BasePose) -> Iterator[Array]:
        """Rows of a base pose: the middle of the place first, the yaw next to the start's first."""
        if not self.robot.space.planar:
            raise ConfigurationError(f"goal: the base of {self.robot.name!r} is fixed; it cannot stand elsewhere")
        half = np.asarray(goal.within)
        places = [np.zeros(2)]
        if half.any():
            places += list(self.rng.uniform(-half, half, (_PLACES, 2)))
        turns = np.zeros(1)
        if goal.yaw is None:
            turns = np.array(sorted(np.linspace(-np.pi, np.pi, _YAWS, endpoint=False), key=abs))
        for place in places:
            for turn in turns:
                row = self.here.copy()
                row[:2] = np.array((goal.x, goal.y)) + place
                row[2] = self.here[2] + turn if goal.yaw is None else goal.yaw
                yield row

    def _hand(self, goal: HandPose, count: int, moves: bool) -> GoalSearch:
        """Configurations with the hand at a pose: by the joints alone, or where none is, with the base as well."""
        search = PoseSearch(
            self.robot, goal.frame, goal.position, goal.orientation, near=self.start, within=goal.within,
            rng=self.rng,
        )  # fmt: skip
        touching: list[Array] = []
        for base in (False, True) if moves and self.robot.space.planar else (False,):
            kept: list[Array] = []
            narrow: list[Array] = []
            for _ in range(_BASE_ROUNDS if base else _ROUNDS):
                for row in search.round(base=base):
                    if not self.tight.at(row):
                        touching.append(row)
                    elif self.wide.at(row):
                        kept.append(row)
                    else:
                        narrow.append(row)
                if len(kept) >= count or self.deadline.over():
                    break
            if kept or narrow:
                return self._result(goal, kept or narrow, count)
        if touching:
            return self._in_the_way(goal, touching)
        none = np.zeros((0, self.robot.nq))
        return GoalSearch(none, f"{goal}: {search.missed()}", search.distance, search.angle)

    def _sorted(self, goal: Goal, rows: Iterator[Array], count: int) -> GoalSearch:
        """Those of the rows that touch nothing."""
        kept: list[Array] = []
        narrow: list[Array] = []
        touching: list[Array] = []
        for row in rows:
            if not self.tight.at(row):
                touching.append(row)
            else:
                (kept if self.wide.at(row) else narrow).append(row)
            if len(kept) >= count:
                break
        if kept or narrow:
            return self._result(goal, kept or narrow, count)
        return self._in_the_way(goal, touching)

    def _result(self, goal: Goal, rows: list[Array], count: int) -> GoalSearch:
        found = self.robot.space.from_coordinates(np.array(rows))
        if self.robot.space.planar:  # one that did not move stands exactly where it stood
            still = np.abs(found[:, :4] - self.start[:4]).max(axis=1) < 1e-9
            found[still, :4] = self.start[:4]
        order = np.argsort(_distance(self.robot, self.start, found), kind="stable")[:count]
        return GoalSearch(found[order], f"{_said(goal)}: {len(order)} configurations")

    def _in_the_way(self, goal: Goal, rows: list[Array]) -> GoalSearch:
        """What the rows touch, which all reach the goal."""
        counted: Counter[str] = Counter()
        for row in rows[:_ASKED]:
            q = self.robot.space.from_coordinates(row)
            near = min(
                nearest_things(self.robot, self.scene, (q, q), self.params, self.wide.bounds), key=lambda n: n.distance
            )
            counted[f"{near.one} and {near.two}"] += 1
        touching = tuple(name for name, _ in counted.most_common())
        each = "the only configuration there touches" if len(rows) == 1 else f"all {len(rows)} that were found touch"
        return GoalSearch(
            np.zeros((0, self.robot.nq)),
            f"{_said(goal)}: {each} something: {'; '.join(touching[:3])}",
            touching=touching,
        )


def goal_configurations(
    robot: RobotModel, scene: Scene, start: npt.ArrayLike, goal: Goal | Sequence[Goal], *, seed: int,
    params: DeformParams | None,
) -> Array:  # fmt: skip
    """Configurations (K, nq) of a goal, to be planned to one after the other.

    Raises:
        GoalError: none is free; the message says why, and ``search`` of the error has it as data.
    """
    search = find_goals(robot, scene, start, goal, seed=seed, params=params)
    if len(search.configurations) == 0:
        raise GoalError(f"goal: {search.reason}", search)
    return search.configurations


def _distance(robot: RobotModel, start: Array, found: Array) -> Array:
    space = robot.space
    rows = space.to_coordinates(found)
    return np.linalg.norm(space.difference(np.tile(space.to_coordinates(start), (len(rows), 1)), rows), axis=1)


def _said(goal: Goal) -> str:
    return ", ".join(f"{k} = {v:g}" for k, v in goal.items()) if isinstance(goal, Mapping) else str(goal)


def _check_box(what: str, value: Sequence[float], count: int) -> None:
    if (check_array(what, value, (count,)) < 0.0).any():
        raise ParameterError(f"{what}={tuple(value)!r} must not be negative")
