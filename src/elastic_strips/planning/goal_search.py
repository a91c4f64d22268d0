"""The search for configurations that reach a goal, near the start first, with the joints alone before the base.

They must keep the clearance. Where none is found, a :class:`GoalSearch` says why, as data: how far out of reach, or
what is touched.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil
from operator import itemgetter
from typing import cast

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.errors import ConfigurationError, GoalError, ParameterError, plural
from elastic_strips.robot import RobotModel
from elastic_strips.robot.inverse_kinematics import PoseSearch, PoseTarget
from elastic_strips.scene import Scene
from elastic_strips.strip import AxisConstraint, Deformer, DeformParams
from elastic_strips.strip.constraint import ConstraintForce
from elastic_strips.summary import Summary
from elastic_strips.validation import check_array, check_count, named_arguments

from .goals import AllOf, BasePose, Goal, HandPose, by_name, is_goal_region, refuse_several_frames
from .grid_path import Ground, ground_about
from .problem import Deadline, nearest_things
from .validity import ValidityChecker

_GOAL_MARGIN = 0.03  # [m] that goals keep to obstacles where there is so much room
_LEAST_GOAL_MARGIN = 1e-3  # [m] that they keep at least, where no clearance is given
_ENOUGH_CONFIGURATIONS = 6  # configurations of a goal
_JOINT_ROUNDS, _BASE_ROUNDS = 12, 24  # of 16 starts, with the joints alone and with the base
_POSTURE_ROUNDS = 4  # of 16 starts, of the joints at a base's place where a constraint asks for them
_MOST_ASKED = 24  # configurations that touch something, of which it is asked what
_LEAST_OF_A_GOAL = 2  # configurations of each goal that are tried before more are looked for
_APART_COUNT = 4  # configurations that no way leads to end a search as one with room does
_ROUNDS_IN_ALL = 400  # where work is bounded
_YAWS_TRIED, _PLACES_TRIED = 16, 60  # tried, of a base whose yaw or place is free
_HOPELESS_ROUNDS, _HOPELESS_MISS = 2, 0.05  # rounds after which joints that miss by more [m] are left for the base
_NEAREST = 8  # of many goals; where the joints alone miss each of these, they are not asked to reach those further away
_MOST_GOALS_NAMED = 3  # goals that are named where none is reached
_ELSEWHERE = 0.3  # [m] from all that are chosen, from which on a base stands elsewhere
_LONGEST_GOAL_SEARCH = 2.0  # [s]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class GoalSearch(Summary):
    """Configurations that reach a goal.

    Attributes:
        configurations: (K, nq), the nearest to the start first; where there are none, ``reason`` says why.
        reason: what happened, in words.
        distance: least distance by which a hand misses the goal [m]; 0 where it reaches it.
        angle: angle by which it is turned differently there [rad].
        misses: by how far each of the goal's frames misses its pose, (distance [m], angle [rad]) by name, where it is
            out of reach; of several frames ``distance`` and ``angle`` are the largest.
        touching: what is in the way of configurations that reach the goal, the most frequent first: "link and
            obstacle".
    """

    configurations: Array
    reason: str
    distance: float = 0.0
    angle: float = 0.0
    misses: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    touching: tuple[str, ...] = ()

    def _summary(self) -> dict[str, object]:
        return {"configurations": len(self.configurations), "reason": self.reason}


@named_arguments
def find_goals(
    robot: RobotModel,
    scene: Scene,
    start: npt.ArrayLike,
    goal: Goal | Sequence[Goal],
    *,
    count: int = _ENOUGH_CONFIGURATIONS,
    seed: int = 0,
    params: DeformParams | None = None,
    timeout: float = _LONGEST_GOAL_SEARCH,
    rounds: int | None = None,
    base: bool = True,
    constraint: AxisConstraint | None = None,
) -> GoalSearch:
    """Configurations that reach a goal and touch nothing, the nearest to the start first.

    Where possible they keep 3 cm from the obstacles, otherwise the least clearance. Where more are found than asked
    for, the nearest is among them, and of the others those in which the base stands far from these: where no way leads
    to one of them, one may lead to another.

    Args:
        robot: the robot.
        scene: the obstacles.
        start: configuration (nq,).
        goal: a goal, or several of which any will do; HandPoses in a list are of one frame.
        count: largest number of configurations.
        seed: seed of random starts.
        params: parameters with the clearances to keep; where None, 1 mm from obstacles.
        timeout: longest search [s].
        rounds: largest number of rounds of 16 starts each, for all goals together; None where only time bounds them.
            With that and ``timeout=math.inf`` the search ends alike on every machine. Each goal has one at least.
        base: whether a base that can move may be moved for a hand's pose that is out of the arm's reach.
        constraint: what the configurations satisfy besides: with poses of hands all joints see to it, with one of the
            base those that move the constraint's frame. What is stated by itself, joint by joint, has to satisfy it.

    Raises:
        SceneError: a constraint that names an obstacle that is not there.
        RobotError: a frame that the robot does not have.
        ConfigurationError: the start, or a goal that is a configuration, is not valid; a goal for a base that is fixed.
        ParameterError: something that is not a goal; a list of poses of different frames.
    """
    most = None if rounds is None else check_count("rounds", rounds, low=1)
    finder = _Finder(robot, scene, start, goal, seed=seed, params=params, base=base, constraint=constraint)
    finder.look(count, Deadline(timeout), most)
    return finder.result(count)


class _Source:
    """Configurations of one goal, a few at a time, divided into those that have room, those that have less, those to
    whose place no way of the base is known, and others.

    Attributes:
        free, narrow, apart, touching: coordinate rows (nv,).
        found: whether there was one that is free, or has less room.
        in_vain: whether the joints alone have missed the goal by far, as far as they have tried.
    """

    def __init__(self, search: _Finder, goal: Goal, rng: np.random.Generator) -> None:
        self.goal: Goal = by_name(cast("Mapping[str, object]", goal)) if isinstance(goal, Mapping) else goal
        self.rng = rng
        self.free: list[Array] = []
        self.narrow: list[Array] = []
        self.apart: list[Array] = []
        self.touching: list[Array] = []
        self.found: bool = False
        self.in_vain: bool = False
        self.hand: PoseSearch | None = None
        self._search: _Finder = search
        self._rows: Iterator[Sequence[Array] | Array] = self._batches()

    def round(self) -> bool:
        """Look at some more; False where there are none."""
        rows = next(self._rows, None)
        if rows is None:
            return False
        for row in rows:
            if not self._search.tight.at(row):
                self.touching.append(row)
            elif not self._search.gets_to(row[None])[0]:
                self.apart.append(row)
            else:
                (self.free if self._search.wide.at(row) else self.narrow).append(row)
                self.found = True
        return True

    @property
    def missed(self) -> float:
        """Distance [m] by which a hand misses the goal; 0 where it reaches it."""
        return 0.0 if self.touching or self.hand is None else self.hand.distance

    @property
    def said(self) -> str:
        """The goal in words."""
        if isinstance(self.goal, Mapping):
            return ", ".join(f"{k} = {v:g}" for k, v in self.goal.items())
        return str(self.goal) if isinstance(self.goal, (HandPose, BasePose, AllOf)) else "the configuration"

    def _batches(self) -> Iterator[Sequence[Array] | Array]:
        robot, goal = self._search.robot, self.goal
        if isinstance(goal, HandPose):
            return self._hands((goal,), None)
        if isinstance(goal, AllOf):
            return self._stood(goal.base) if goal.base and not goal.hands else self._hands(goal.hands, goal.base)
        if isinstance(goal, BasePose):
            return self._stood(goal)
        if isinstance(goal, Mapping):
            return iter([[self._named(cast("Mapping[str, float]", goal))]])
        try:
            q = robot.check_q(goal, what="goal")
        except ConfigurationError:
            if np.asarray(goal, dtype=object).ndim == 0:
                kinds = (
                    "a configuration, HandPose, BasePose, AllOf of these, joints or poses by name, or a list of them"
                )
                raise ParameterError(f"goal is a {type(goal).__name__}; it must be {kinds}") from None
            raise
        return iter([[robot.space.to_coordinates(q)]])

    def _hands(self, hands: Sequence[HandPose], base: BasePose | None) -> Iterator[Array]:
        """By the joints alone, and with the base, where it may move and nothing is found without."""
        robot, near = self._search.robot, self._search.start
        targets = [PoseTarget.of(hand.frame, hand.position, hand.orientation, hand.within) for hand in hands]
        moves, stands = robot.space.planar and self._search.base, True
        if base is not None:
            rows = next(self._bases(base))  # refuses a base that is fixed
            near = robot.space.from_coordinates(np.array(rows))[0]
            moves = base.yaw is None or any(base.within)
            stands = not moves
            if moves:
                targets.append(_target_of_base(robot, base))
        promising, also = self._search.promising, self._search.force
        self.hand = hand = PoseSearch(robot, targets, near=near, rng=self.rng, also=also, promising=promising)
        if moves and hand.out_of_reach:
            stands, self.in_vain = False, True

        def rounds() -> Iterator[Array]:
            for k in range(_JOINT_ROUNDS if stands else 0):
                if moves and self.found and k > 0:
                    if not self._search.further:
                        return
                    break
                hopeless = k >= _HOPELESS_ROUNDS and self.in_vain if k else self._search.too_far(self)
                if moves and hopeless:
                    break
                rows = hand.round(base=False)
                self.in_vain = hand.distance > _HOPELESS_MISS
                yield rows
            for _ in range(_BASE_ROUNDS if moves and (self._search.further or not self.free) else 0):
                self._search.look_about()
                yield hand.round(base=True)

        return rounds()

    def _named(self, goal: Mapping[str, float]) -> Array:
        """The coordinate row of some coordinates by name, the others as at the start."""
        robot, here = self._search.robot, self._search.here
        at = {name: goal[name] for name in ("x", "y", "yaw") if name in goal}
        if at and not robot.space.planar:
            raise ConfigurationError(f"goal: the base of {robot.name!r} is fixed; {', '.join(at)} cannot be set")
        joints = {name: value for name, value in goal.items() if name not in at}
        b = robot.space.base_nv
        named = robot.space.to_coordinates(robot.home(joints=joints))
        row = here.copy()
        for k, name in enumerate(("x", "y", "yaw")):
            if name in at:
                row[k] = check_array(f"goal[{name!r}]", [at[name]], (1,))[0]
        for name in joints:
            k = b + robot.joint_names.index(name)
            row[k] = named[k]
        return row

    def _stood(self, goal: BasePose) -> Iterator[Sequence[Array] | Array]:
        """At the base's places, with the joints as at the start, or as a constraint asks for them."""
        robot, force = self._search.robot, self._search.force
        if force is None:
            return self._bases(goal)

        def rounds() -> Iterator[Array]:
            for (row,) in self._bases(goal):
                near = robot.space.from_coordinates(row[None])[0]
                self.hand = PoseSearch(robot, [], near=near, rng=self.rng, also=force)
                for _ in range(_POSTURE_ROUNDS):
                    if self.free:
                        break
                    yield self.hand.round(base=False)

        return rounds()

    def _bases(self, goal: BasePose) -> Iterator[list[Array]]:
        """The middle of the place first, the yaw next to the start's first."""
        here = self._search.here
        if not self._search.robot.space.planar:
            raise ConfigurationError(
                f"goal: the base of {self._search.robot.name!r} is fixed; it cannot stand elsewhere"
            )
        half = np.asarray(goal.within)
        places = [np.zeros(2)]
        if half.any():
            places += list(self.rng.uniform(-half, half, (_PLACES_TRIED, 2)))
        turns = np.zeros(1)
        if goal.yaw is None:
            turns = np.array(sorted(np.linspace(-np.pi, np.pi, _YAWS_TRIED, endpoint=False), key=abs))

        def at(place: Array, turn: float) -> Array:
            row = here.copy()
            row[:2] = np.array((goal.x, goal.y)) + place
            row[2] = here[2] + turn if goal.yaw is None else goal.yaw
            return row

        return ([at(place, float(turn))] for place in places for turn in turns)


class _Finder:
    """Looks for configurations that reach a goal, and for more of them; see :func:`find_goals`.

    Args:
        further: whether to look with the base, too, where the joints alone find some.

    Attributes:
        going: the goals for which there is more to look at.
        rounds: number of rounds so far.
    """

    def __init__(
        self,
        robot: RobotModel,
        scene: Scene,
        start: npt.ArrayLike,
        goal: Goal | Sequence[Goal],
        *,
        seed: int,
        params: DeformParams | None,
        base: bool = True,
        constraint: AxisConstraint | None = None,
        further: bool = False,
    ) -> None:
        self.start: Array = robot.check_q(start, what="start")
        several: Sequence[Goal] = goal if isinstance(goal, Sequence) and is_goal_region(goal) else [goal]  # type: ignore[list-item]
        if not several:
            raise ParameterError("goal is an empty list")
        refuse_several_frames(several)
        self.robot, self.scene, self.base, self.further = robot, scene, base, further
        self.force: ConstraintForce | None = None if constraint is None else ConstraintForce(robot, constraint)
        if self.force is not None:
            self.force.find(scene)
        self.params: DeformParams = params or DeformParams()
        self.here: Array = robot.space.to_coordinates(self.start)
        clearance, own = (_LEAST_GOAL_MARGIN, 0.0) if params is None else (params.clearance, params.self_clearance)
        self.wide = ValidityChecker(robot, scene, margin=max(_GOAL_MARGIN, clearance), self_margin=own)
        self.tight = ValidityChecker(robot, scene, margin=clearance, self_margin=own, bounds=self.wide.bounds)
        self._sources = [_Source(self, one, np.random.default_rng((seed, k))) for k, one in enumerate(several)]
        self.going = sorted(self._sources, key=self._away)  # the nearest first
        self._nearest = self.going[:_NEAREST]
        self.rounds: int = 0
        self._looked = False
        self._left: list[tuple[tuple[bool, int, int, float], Array]] = []
        self._ground: Ground | None = None

    def _away(self, source: _Source) -> float:
        """How far a goal's hands are from the base [m]; 0 where it is none of hands."""
        off = [np.asarray(hand.position)[:2] - self.here[:2] for hand in _hands_of(source.goal)]
        return max((float(np.hypot(*each)) for each in off), default=0.0) if self.robot.space.planar else 0.0

    def too_far(self, source: _Source) -> bool:
        """Whether a goal is further away than the nearest ones, and the joints alone have missed each of these."""
        return source not in self._nearest and all(near.in_vain for near in self._nearest)

    def look_about(self) -> None:
        """Find out where the base gets to about the goals, once."""
        if self._looked:
            return
        self._looked = True
        hands = [hand for source in self._sources for hand in _hands_of(source.goal)]
        places = np.array([hand.position[:2] for hand in hands])
        self._ground = ground_about(self.robot, self.scene, self.start, places)

    def gets_to(self, rows: Array) -> Mask:
        """Whether a way of the base leads to rows (N, nv), as far as that is known."""
        return np.ones(len(rows), dtype=bool) if self._ground is None else self._ground.reached(rows[:, :2])

    def promising(self, rows: Array) -> Mask:
        """Rows (N, nv) whose base is clear where a way leads to."""
        there = self.gets_to(rows)
        there[there] = self.tight.each(rows[there], base=True)
        return there

    def look(self, count: int, deadline: Deadline, rounds: int | None) -> None:
        """Look until there are so many configurations with room, or the time or so many rounds are over; of those to
        whose place no way is known, four count as one."""
        while self.going and sum(len(s.free) + len(s.apart) / _APART_COUNT for s in self._sources) < count:
            if rounds is not None and self.rounds >= rounds:
                self.going = []
                return
            self.rounds += len(self.going)
            self.going = [source for source in self.going if source.round() and not deadline.over()]

    def result(self, count: int) -> GoalSearch:
        """The nearest to the start of what was found, or why nothing was."""
        sources = self._sources
        rows = [row for source in sources for row in source.free]
        rows = rows or [row for source in sources for row in source.narrow]
        rows = rows or [row for source in sources for row in source.apart]
        if not rows:
            return self._nothing()
        goals = sources[0].said if len(sources) == 1 else f"any of {len(sources)} goals"
        order = np.argsort(self._distances(rows), kind="stable")
        found = self._configurations([rows[k] for k in order[self._spread(np.array(rows)[order], count)]])
        return GoalSearch(found, f"{goals}: {plural(len(found), 'configuration')}")

    def _spread(self, rows: Array, count: int) -> Indices:
        """Which of some rows (N, nv), the nearest first: that one, those whose base is the furthest from all that are
        chosen, as long as it stands elsewhere, and the nearest of the others."""
        if not self.robot.space.planar or len(rows) <= count:
            return np.arange(min(len(rows), count))
        chosen, apart = [0], np.hypot(*(rows[:, :2] - rows[0, :2]).T)
        while len(chosen) < count and apart.max() >= _ELSEWHERE:
            k = int(np.argmax(apart))
            chosen.append(k)
            apart = np.minimum(apart, np.hypot(*(rows[:, :2] - rows[k, :2]).T))
        left = np.setdiff1d(np.arange(len(rows)), chosen)[: count - len(chosen)]
        return np.sort(np.concatenate((chosen, left)).astype(np.intp))

    def taken(self, most: int) -> Array:
        """What was found since the last time (K, nq), to be tried in this order: of each goal one after the other,
        those with room before those with less. Those to whose place no way is known, and more than ``most`` of a goal,
        are left until nothing more is looked for."""
        for source in self._sources:
            for apart, ways in ((False, (source.free, source.narrow)), (True, (source.apart,))):
                rank = 0
                for room, some in enumerate(ways):
                    far = self._distances(some)
                    for k in np.argsort(far, kind="stable").tolist():
                        self._left.append(((apart, rank, room, float(far[k])), some[k]))
                        rank += 1
            source.free, source.narrow, source.apart = [], [], []
        self._left.sort(key=itemgetter(0))
        now = [row for (apart, rank, *_), row in self._left if not self.going or (rank < most and not apart)]
        self._left = self._left[len(now) :]
        return self._configurations(now)

    def _distances(self, rows: Sequence[Array]) -> Array:
        """Distance of each of some rows (K, nv) from the start."""
        here = np.tile(self.here, (len(rows), 1))
        apart = self.robot.space.difference(here, np.array(rows).reshape(-1, self.robot.nv))
        return np.linalg.norm(apart, axis=1)

    def _configurations(self, rows: Sequence[Array]) -> Array:
        """Configurations (K, nq) of some rows (K, nv)."""
        found = self.robot.space.from_coordinates(np.array(rows).reshape(-1, self.robot.nv))
        if self.robot.space.planar:  # one that did not move stands exactly where it stood
            still = np.abs(found[:, :4] - self.start[:4]).max(axis=1) < 1e-9
            found[still, :4] = self.start[:4]
        return found

    def _nothing(self) -> GoalSearch:
        """Why nothing was found: of several goals of the first, and as data of the one that is missed the least."""
        sources = self._sources
        nearest = min(sources, key=lambda source: source.missed)
        if len(sources) == 1:
            return self._failure(nearest)
        reasons = "; ".join(self._failure(source).reason for source in sources[:_MOST_GOALS_NAMED])
        more = f"; and {len(sources) - _MOST_GOALS_NAMED} more" if len(sources) > _MOST_GOALS_NAMED else ""
        return replace(self._failure(nearest), reason=reasons + more)

    def _failure(self, source: _Source) -> GoalSearch:
        """Why a goal has no configuration that is free: it is out of reach, or something is in the way."""
        none = np.zeros((0, self.robot.nq))
        if not source.touching:
            assert source.hand is not None
            hand = source.hand
            return GoalSearch(none, f"{source.said}: {hand.missed()}", hand.distance, hand.angle, hand.by_frame())
        counted: Counter[str] = Counter()
        work = Deformer(self.robot, self.params).workspace
        for row in source.touching[:_MOST_ASKED]:
            q = self.robot.space.from_coordinates(row)
            near = nearest_things(work, self.robot, self.scene, (q, q))
            worst = min(near, key=lambda each: each.distance)
            counted[f"{worst.one} and {worst.two}"] += 1
        touching = tuple(name for name, _ in counted.most_common())
        each = (
            "the only configuration that was found"
            if len(source.touching) == 1
            else f"all {len(source.touching)} configurations that were found"
        )
        reason = f"{source.said}: {each} would touch something: {'; '.join(touching[:3])}"
        return GoalSearch(none, reason, touching=touching)


def goal_configurations(
    robot: RobotModel,
    scene: Scene,
    start: npt.ArrayLike,
    goal: Goal | Sequence[Goal],
    *,
    seed: int,
    params: DeformParams | None,
    deadline: Deadline,
    count: int = _ENOUGH_CONFIGURATIONS,
    constraint: AxisConstraint | None = None,
) -> Array:
    """Configurations (K, nq) of a goal, to be planned to one after the other; looked for in a few seconds, or rounds
    where the deadline bounds work.

    Raises:
        GoalError: none is free; the message says why, and the error's ``search`` has it as data.
    """
    timeout, rounds = (deadline.time_left, _ROUNDS_IN_ALL) if deadline.of_work else (_LONGEST_GOAL_SEARCH, None)
    search = find_goals(
        robot,
        scene,
        start,
        goal,
        count=count,
        seed=seed,
        params=params,
        timeout=timeout,
        rounds=rounds,
        constraint=constraint,
    )
    if len(search.configurations) == 0:
        raise GoalError(f"goal: {search.reason}", search)
    return search.configurations


def goal_turns(
    robot: RobotModel,
    scene: Scene,
    start: npt.ArrayLike,
    goal: Goal | Sequence[Goal],
    *,
    seed: int,
    params: DeformParams | None,
    count: int,
    deadline: Deadline,
) -> Iterator[Array]:
    """Configurations (K, nq) of a goal of which not every one will do, to be tried in their order, some at a time:
    there is a search for ``count`` with room, and for as many more each time. The base is moved, too, where the joints
    alone get there. What the search computes does not count as work of the deadline; it ends after some rounds.

    Raises:
        GoalError: none is free; as for :func:`goal_configurations`.
    """
    with deadline.paused():
        finder, first = _Finder(robot, scene, start, goal, seed=seed, params=params, further=True), True
    several = len(goal) if isinstance(goal, Sequence) and is_goal_region(goal) else 1
    most = max(_LEAST_OF_A_GOAL, ceil(count / several))
    while finder.going:
        with deadline.paused():
            finder.look(count, Deadline(deadline.time_left), _ROUNDS_IN_ALL)
        if first:
            search = finder.result(1)
            if len(search.configurations) == 0:
                raise GoalError(f"goal: {search.reason}", search)
        first = False
        rows = finder.taken(most)
        if len(rows):
            yield rows


def _hands_of(goal: Goal) -> tuple[HandPose, ...]:
    """The poses of hands of a goal."""
    if isinstance(goal, HandPose):
        return (goal,)
    return goal.hands if isinstance(goal, AllOf) else ()


def _target_of_base(robot: RobotModel, base: BasePose) -> PoseTarget:
    """The base's place as a target of the frame of its joint, whose height does not count."""
    turn = None if base.yaw is None else pin.rpy.rpyToMatrix(0.0, 0.0, base.yaw)
    within = np.array((*base.within, np.inf))
    return PoseTarget(robot.model.names[1], np.array((base.x, base.y, 0.0)), turn, within)
