"""Goals as people state them: a pose of a hand, of two, of the base, a few joints, alternatives; configurations there.

Configurations are looked for near the start first, with the joints alone before the base, and must keep the
clearance. Where none is found, a :class:`GoalSearch` says why, as data: how far out of reach, or what is touched.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError, GoalError, ParameterError
from elastic_strips.robot import RobotModel
from elastic_strips.robot.inverse_kinematics import PoseSearch, PoseTarget, rotation_of
from elastic_strips.scene import Scene
from elastic_strips.strip import AxisConstraint, Deformer, DeformParams
from elastic_strips.strip.constraint import ConstraintForce
from elastic_strips.summary import Summary
from elastic_strips.validation import Checked, Finite, check_array, check_count, check_fields, named_arguments

from .problem import Deadline, nearest_things
from .validity import ValidityChecker

if TYPE_CHECKING:
    from typing import TypeAlias

_GOAL_MARGIN = 0.03  # [m] that goals keep to obstacles where there is so much room
_LEAST_GOAL_MARGIN = 1e-3  # [m] that they keep at least, where no clearance is given
_ENOUGH_CONFIGURATIONS = 6  # configurations of a goal
_JOINT_ROUNDS, _BASE_ROUNDS = 12, 24  # of 16 starts, with the joints alone and with the base
_POSTURE_ROUNDS = 4  # of 16 starts, of the joints at a base's place where a constraint asks for them
_MOST_ASKED = 24  # configurations that touch something, of which it is asked what
_ROUNDS_IN_ALL = 400  # where work is bounded
_YAWS_TRIED, _PLACES_TRIED = 16, 60  # tried, of a base whose yaw or place is free
_HOPELESS_ROUNDS, _HOPELESS_MISS = 2, 0.05  # rounds after which joints that miss by more [m] are left for the base
_MOST_GOALS_NAMED = 3  # goals that are named where none is reached
_LONGEST_GOAL_SEARCH = 2.0  # [s]


@dataclass(frozen=True, slots=True)
class HandPose(Checked):
    """A frame of the robot at a pose in the world.

    Attributes:
        frame: name of the frame.
        position: (3,) its position [m].
        orientation: quaternion (x, y, z, w), or None where any orientation will do.
        within: (3,) how far it may be off along the world's axes [m]: half the sides of a box.
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

    @staticmethod
    def around(
        frame: str,
        point: npt.ArrayLike,
        *,
        held: npt.ArrayLike = (0.0, 0.0, 0.0),
        rotations: npt.ArrayLike,
        axis: npt.ArrayLike = (0.0, 0.0, 1.0),
        count: int = 12,
    ) -> list[HandPose]:
        """Poses of a frame with which a hand holds a point from all sides of an axis: grasps of round things.

        Args:
            frame: name of the frame.
            point: (3,) point in the world [m].
            held: (3,) place in the frame where the hand holds it [m].
            rotations: (K, 3, 3) or (3, 3) first rotations of the frame.
            axis: (3,) axis in the world about which each of them is turned.
            count: number of even angles of these turns.

        Raises:
            ParameterError: an array of another shape, an axis without length, a count below 1.
        """
        place, hold = check_array("point", point, (3,)), check_array("held", held, (3,))
        count, about = check_count("count", count, low=1), check_array("axis", axis, (3,))
        first = np.asarray(rotations, dtype=float)
        first = check_array("rotations", first, (3, 3) if first.ndim == 2 else (len(first), 3, 3))
        length = float(np.linalg.norm(about))
        if length < 1e-9:
            raise ParameterError(f"axis={about.tolist()} has no length")
        out = []
        for angle in np.arange(count) * 2.0 * np.pi / count:
            turn = pin.exp3(about / length * angle)
            for rotation in first.reshape(-1, 3, 3):
                R = turn @ rotation
                x, y, z = (place - R @ hold).tolist()
                qx, qy, qz, qw = pin.Quaternion(R).coeffs().tolist()
                out.append(HandPose(frame, (x, y, z), (qx, qy, qz, qw)))
        return out

    def __str__(self) -> str:
        at = ", ".join(f"{v:g}" for v in self.position)
        turned = "" if self.orientation is None else ", turned as asked"
        return f"{self.frame!r} at ({at}) m{turned}"


@dataclass(frozen=True, slots=True)
class BasePose(Checked):
    """The base at a place of the floor, the joints as at the start.

    Attributes:
        x, y: place in the world [m].
        yaw: heading [rad], or None where any will do.
        within: (2,) how far it may be off along x and y [m].
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


@dataclass(frozen=True, slots=True, init=False)
class AllOf:
    """Several poses at once: of two hands, or of a hand and the base.

    Attributes:
        goals: what is to be reached together: poses of different frames, and one of the base at most.

    Raises:
        ParameterError: no goals, something else than poses, or two of them for one frame or for the base.
    """

    goals: tuple[HandPose | BasePose, ...]

    def __init__(self, *goals: HandPose | BasePose) -> None:
        object.__setattr__(self, "goals", goals)
        if not goals:
            raise ParameterError("AllOf() is empty: it takes HandPoses of different frames, and one BasePose at most")
        for goal in goals:
            if not isinstance(goal, (HandPose, BasePose)):
                raise ParameterError(f"AllOf takes HandPoses and one BasePose, not a {type(goal).__name__}")
        for what, count in Counter(_moved(goal) for goal in goals).items():
            if count > 1:
                raise ParameterError(
                    f"AllOf has {count} poses of {what}, which can be at one place only; goals of which any will do "
                    "are a list"
                )

    @property
    def hands(self) -> tuple[HandPose, ...]:
        """The poses of frames."""
        return tuple(goal for goal in self.goals if isinstance(goal, HandPose))

    @property
    def base(self) -> BasePose | None:
        """The pose of the base, if there is one."""
        return next((goal for goal in self.goals if isinstance(goal, BasePose)), None)

    def __str__(self) -> str:
        return " and ".join(map(str, self.goals))


def _moved(goal: HandPose | BasePose) -> str:
    return f"frame {goal.frame!r}" if isinstance(goal, HandPose) else "the base"


Goal: TypeAlias = npt.ArrayLike | HandPose | BasePose | AllOf | Mapping[str, HandPose | npt.ArrayLike]
"""A configuration (nq,); a pose of a hand or the base, or several at once (:class:`AllOf`); some coordinates by name:
``x``, ``y``, ``yaw`` and joints; or poses by frame, at once too: a :class:`HandPose`, a position (3,) or a pose
(4, 4)."""


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


def is_goal_region(goal: object) -> bool:
    """Whether a goal is something other than one configuration."""
    if isinstance(goal, (HandPose, BasePose, AllOf, Mapping)):
        return True
    return (
        isinstance(goal, Sequence)
        and not isinstance(goal, str)
        and (len(goal) == 0 or isinstance(goal[0], (HandPose, BasePose, AllOf, Mapping, Sequence, np.ndarray)))
    )


def _by_name(goal: Mapping[str, object]) -> AllOf | Mapping[str, float]:
    """What a mapping means: coordinates by name, or poses by frame.

    Raises:
        ParameterError: it has both, or a pose that is none, or is of another frame.
    """
    numbers = {name for name, value in goal.items() if not isinstance(value, HandPose) and np.ndim(value) == 0}  # type: ignore[arg-type]
    if len(numbers) == len(goal):
        return goal  # type: ignore[return-value]
    if numbers:
        raise ParameterError(
            f"goal has coordinates ({', '.join(sorted(numbers))}) and poses of frames "
            f"({', '.join(sorted(set(goal) - numbers))}) in one mapping; "
            "poses together are AllOf(HandPose(…), BasePose(…))"
        )
    return AllOf(*(_pose_of(frame, value) for frame, value in goal.items()))


def _pose_of(frame: str, value: object) -> HandPose:
    if isinstance(value, HandPose):
        if value.frame != frame:
            raise ParameterError(f"goal[{frame!r}] is a pose of another frame, {value.frame!r}")
        return value
    given = np.asarray(value, dtype=object)
    if given.shape == (3,):
        x, y, z = check_array(f"goal[{frame!r}]", value, (3,)).tolist()  # type: ignore[arg-type]
        return HandPose(frame, (x, y, z))
    if given.shape != (4, 4):
        raise ParameterError(
            f"goal[{frame!r}] has shape {given.shape}; a HandPose, a position (3,) or a pose (4, 4) is one"
        )
    pose = check_array(f"goal[{frame!r}]", value, (4, 4))  # type: ignore[arg-type]
    x, y, z = pose[:3, 3].tolist()
    qx, qy, qz, qw = pin.Quaternion(rotation_of(pose[:3, :3], f"goal[{frame!r}]")).coeffs().tolist()
    return HandPose(frame, (x, y, z), (qx, qy, qz, qw))


def _of_several_frames(goals: Sequence[Goal]) -> None:
    """Refuse a list of poses of different frames: whether any or all of them are meant is not clear.

    Raises:
        ParameterError: it is one.
    """
    frames = list(dict.fromkeys(goal.frame for goal in goals if isinstance(goal, HandPose)))
    if len(frames) > 1:
        raise ParameterError(
            f"goal is a list of poses of different frames ({', '.join(map(repr, frames))}), and of a list any one will "
            "do: AllOf(HandPose(…), HandPose(…)) has them all reached at once; where one of them is enough, the list "
            "is to have AllOf(HandPose(…)) of each"
        )


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

    Where possible they keep 3 cm from the obstacles, otherwise the least clearance.

    Args:
        robot: the robot.
        scene: the obstacles.
        start: configuration (nq,).
        goal: a goal, or several of which any will do; HandPoses in a list are of one frame.
        count: largest number of configurations.
        seed: seed of random starts.
        params: parameters with the clearance to keep; 1 mm where None.
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
    start = robot.check_q(start, what="start")
    several: Sequence[Goal] = goal if isinstance(goal, Sequence) and is_goal_region(goal) else [goal]  # type: ignore[list-item]
    if not several:
        raise ParameterError("goal is an empty list")
    _of_several_frames(several)
    force = None if constraint is None else ConstraintForce(robot, constraint)
    search = _Search(robot, scene, start, params, base, force)
    sources = [_Source(search, one, np.random.default_rng((seed, k))) for k, one in enumerate(several)]
    most = None if rounds is None else check_count("rounds", rounds, low=1)
    deadline, going, done = Deadline(timeout), list(sources), 0
    while going and sum(len(source.free) for source in sources) < count:
        done += len(going)
        going = [source for source in going if source.round() and not deadline.over()]
        if most is not None and done >= most:
            break
    return search.result(sources, count)


class _Source:
    """Configurations of one goal, a few at a time, divided into those that have room, those that have less, and others.

    Attributes:
        free, narrow, touching: coordinate rows (nv,).
    """

    def __init__(self, search: _Search, goal: Goal, rng: np.random.Generator) -> None:
        self.goal: Goal = _by_name(cast("Mapping[str, object]", goal)) if isinstance(goal, Mapping) else goal
        self.rng = rng
        self.free: list[Array] = []
        self.narrow: list[Array] = []
        self.touching: list[Array] = []
        self.hand: PoseSearch | None = None
        self._search: _Search = search
        self._rows: Iterator[Sequence[Array] | Array] = self._batches()

    def round(self) -> bool:
        """Look at some more; False where there are none."""
        rows = next(self._rows, None)
        if rows is None:
            return False
        for row in rows:
            if not self._search.tight.at(row):
                self.touching.append(row)
            else:
                (self.free if self._search.wide.at(row) else self.narrow).append(row)
        return True

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
        self.hand = hand = PoseSearch(robot, targets, near=near, rng=self.rng, also=self._search.force)

        def rounds() -> Iterator[Array]:
            for k in range(_JOINT_ROUNDS if stands else 0):
                if moves and (self.free or self.narrow) and k > 0:
                    return
                if moves and k >= _HOPELESS_ROUNDS and hand.distance > _HOPELESS_MISS:
                    break
                yield hand.round(base=False)
            for _ in range(_BASE_ROUNDS if moves and not self.free else 0):
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


class _Search:
    """What configurations of goals are measured against, and what becomes of them."""

    def __init__(
        self,
        robot: RobotModel,
        scene: Scene,
        start: Array,
        params: DeformParams | None,
        base: bool,
        force: ConstraintForce | None,
    ) -> None:
        self.robot, self.scene, self.start, self.base, self.force = robot, scene, start, base, force
        if force is not None:
            force.find(scene)
        self.params: DeformParams = params or DeformParams()
        self.here: Array = robot.space.to_coordinates(start)
        clearance = _LEAST_GOAL_MARGIN if params is None else params.clearance
        self.wide = ValidityChecker(robot, scene, margin=max(_GOAL_MARGIN, clearance))
        self.tight = ValidityChecker(robot, scene, margin=clearance, bounds=self.wide.bounds)

    def result(self, sources: Sequence[_Source], count: int) -> GoalSearch:
        """The nearest to the start of what was found, or why nothing was."""
        rows = [row for source in sources for row in source.free] or [
            row for source in sources for row in source.narrow
        ]
        if not rows:
            failures = [self._failure(source) for source in sources]
            if len(failures) == 1:
                return failures[0]
            nearest = min(failures, key=lambda each: each.distance)
            reasons = "; ".join(each.reason for each in failures[:_MOST_GOALS_NAMED])
            more = f"; and {len(failures) - _MOST_GOALS_NAMED} more" if len(failures) > _MOST_GOALS_NAMED else ""
            return replace(nearest, reason=reasons + more)
        found = self.robot.space.from_coordinates(np.array(rows))
        if self.robot.space.planar:  # one that did not move stands exactly where it stood
            still = np.abs(found[:, :4] - self.start[:4]).max(axis=1) < 1e-9
            found[still, :4] = self.start[:4]
        space = self.robot.space
        here = np.tile(self.here, (len(found), 1))
        apart = np.linalg.norm(space.difference(here, space.to_coordinates(found)), axis=1)
        order = np.argsort(apart, kind="stable")[:count]
        goals = sources[0].said if len(sources) == 1 else f"any of {len(sources)} goals"
        return GoalSearch(found[order], f"{goals}: {len(order)} configurations")

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
        each = "the only configuration" if len(source.touching) == 1 else f"all {len(source.touching)} that were found"
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


def _target_of_base(robot: RobotModel, base: BasePose) -> PoseTarget:
    """The base's place as a target of the frame of its joint, whose height does not count."""
    turn = None if base.yaw is None else pin.rpy.rpyToMatrix(0.0, 0.0, base.yaw)
    within = np.array((*base.within, np.inf))
    return PoseTarget(robot.model.names[1], np.array((base.x, base.y, 0.0)), turn, within)


def _check_box(what: str, value: Sequence[float], count: int) -> None:
    if (check_array(what, value, (count,)) < 0.0).any():
        raise ParameterError(f"{what}={tuple(value)!r} must not be negative")
