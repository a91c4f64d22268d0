"""Goals on the move: new goals at speed, goals passed without a stop, followed paths, gazes, poses of both hands; picks
are in :mod:`workshop.bench.picks`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from math import cos, hypot, pi, sin

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.control.controller import Controller
from elastic_strips.control.interfaces import Command, Measurement, RunState
from elastic_strips.control.itinerary import off_goal
from elastic_strips.control.params import DriveParams
from elastic_strips.control.record import DriveResult
from elastic_strips.errors import ElasticStripsError, InputError, ParameterError, nearest_name
from elastic_strips.planning import AllOf, BasePose, HandPose, find_goals
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Cylinder, Obstacle, Scene, World
from elastic_strips.sim.closed_loop import Simulation, simulation
from elastic_strips.sim.evaluation import evaluate
from elastic_strips.sim.jobs import cached, parallel_map
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.sim.scenarios.corridors import corridor_guide
from elastic_strips.strip import LookAt

from .drive import crossing, hall_world
from .measure import Figures, Note, head, percentiles, silent
from .picks import DRIVEN, FOAM, STANDING, measure_pick, summary

FLOW, STOP = "flow", "stop"
"""At a goal, or for a new one, the robot drives on; or it stops first."""
CASES: dict[str, tuple[str, ...]] = {
    "every": (FLOW, STOP),
    "patrol": (FLOW, STOP),
    "path": (FLOW,),
    "look": (FLOW,),
    "hands": (FLOW,),
    "picks": (FOAM, STANDING, DRIVEN),
}
"""What is measured, and in which ways."""
_REST_SPEED = 0.01  # [m/s, rad/s] a robot that is slower stands
_OVER = "time limit"  # begins the reason of a stop because the time is over
_GOAL_EVERY = 2.0  # [s] from one new goal to the next
_FROM_CRATES = 0.85  # [m] of the new goals from the hall's crates, at least
_PATROL_GOALS = 10
_WITHIN = 0.3  # [m] of the followed path
_HANDS = {
    "silvermate": ("hand_frame",),
    "tiago": ("hand_grasping_frame",),
    "pr2": ("l_gripper_tool_frame", "r_gripper_tool_frame"),
}
"""Frames of the hands, by robot; the first one's x axis looks, too."""
_APART = 0.2  # [m] of each hand from the middle between both
_AHEAD = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class _Task:
    """One drive."""

    case: str
    way: str
    robot: str
    base: str | None
    seed: int
    rate: float
    seconds: float
    moving: bool
    compute: str
    root: str | None


@dataclass(frozen=True, slots=True)
class _Driven:
    """A drive that has ended."""

    driven: Simulation[Controller]
    result: DriveResult

    @property
    def robot(self) -> RobotModel:
        return self.driven.robot

    def at(self, time: float) -> Array:
        """(nv,) the true coordinate row at a time [s]."""
        control = self.result.record.control
        return control.coordinates[min(int(np.searchsorted(control.time, time - 1e-9)), len(control.time) - 1)]


class _Restless(Controller):
    """Workspace: a controller that is given a new goal every two seconds, for as long as it is driven.

    Attributes:
        asked: time [s] and place of every goal.
    """

    def __init__(
        self, *args: object, draw: Callable[[], BasePose], until: float, stops: bool, **options: object
    ) -> None:
        super().__init__(*args, **options)  # type: ignore[arg-type]
        self.asked: list[tuple[float, BasePose]] = []
        self._draw, self._until, self._stops = draw, until, stops
        self._waiting: BasePose | None = None

    @property
    def ended(self) -> bool:
        """Never: another goal comes."""
        return False

    @property
    def halted(self) -> bool:
        """Whether it was to stop for something else than a new goal, and stands."""
        return super().halted and self._waiting is None

    @property
    def plans_next(self) -> bool:
        """Whether the next step needs a scene: also where it may go on from a stop."""
        return super().plans_next or self._waiting is not None

    def step(self, t: float, measurement: Measurement | None, scene: Scene | None, *, trouble: str = "") -> Command:
        """See :meth:`Controller.step`."""
        if t >= self._until - 1e-9:
            self._waiting = None
        elif t >= _GOAL_EVERY * (len(self.asked) + 1) - 1e-9:
            goal = self._draw()
            self.asked.append((t, goal))
            if self._stops:
                self._waiting = goal
                self.stop("for a new goal")
            else:
                self.retarget(goal)
        if self._waiting is not None and self.executor.at_rest(t):
            goal, self._waiting = self._waiting, None
            self.resume()
            self.retarget(goal)
        return super().step(t, measurement, scene, trouble=trouble)


def bench_goals(
    robot: str,
    case: str,
    seeds: Sequence[int],
    step: Note = silent,
    *,
    base: str | None = None,
    rate: float = 100.0,
    seconds: float = 120.0,
    moving: bool = False,
    compute: str = "work",
    processes: int | None = 1,
    root: str | None = None,
) -> Figures:
    """Drive to goals that change, or are passed, and evaluate each drive from its true states.

    ``every``: a new goal every two seconds in a hall; ``patrol``: ten goals in a loop, with obstacles beside it; each
    once driving on and once with stops. ``path``: a path through a corridor, kept to within 0.3 m. ``look``: a drive
    through the hall on which a hand points at a place. ``hands``: all hands at poses over a table at once; of a robot
    with one hand, the hand and the base. ``picks``: a can on furniture is driven to, reached and lifted:
    planned on foam and standing on the furniture itself, and on foam planned for a drive and driven.

    Args:
        robot: name of the robot, or a URDF file.
        case: one of `CASES`.
        seeds: seeds of the drives.
        step: called after each finished drive.
        base: how the base moves; None: as the robot's own.
        rate: of the control loop [1/s].
        seconds: how long ``every`` drives, and the longest time of the others [s].
        moving: whether something moves beside what stands.
        compute: cost of computing; see :func:`~elastic_strips.sim.simulation`.
        processes: drives at once.
        root: folder of the house in which ``picks`` are; tables in an open room where None.

    Raises:
        ParameterError: an unknown case.
        InputError: no drive could begin, all for one reason.
    """
    if case not in CASES:
        raise ParameterError(f"case={case!r} is unknown{nearest_name(case, CASES)}")
    tasks = [
        _Task(case, way, robot, base, int(seed), rate, seconds, moving, compute, root)
        for seed in seeds
        for way in CASES[case]
    ]
    runs = []
    for run in parallel_map(_drive, tasks, processes):
        runs.append(run)
        step(f"{run['way']}, seed {run['seed']}: {run.get('error') or run.get('state') or run['reason']}")
    errors = {run.get("error") for run in runs}
    if len(errors) == 1 and (error := errors.pop()) is not None:
        raise InputError(f"none of {len(runs)} drives could begin: {error}")
    runs.sort(key=lambda r: (r["seed"], r["way"]))
    summed = summary if case == "picks" else _summary
    return {
        **head("goals", robot=robot, base=base, case=case, rate=rate, seconds=seconds, moving=moving, compute=compute),
        "ways": {way: summed([r for r in runs if r["way"] == way]) for way in CASES[case]},
        "runs": runs,
    }


def _drive(task: _Task) -> Figures:
    """One drive and its figures; a worker's task."""
    robot = cached(f"{task.robot} {task.base}", lambda: load_robot(task.robot, base=task.base))
    told: Figures = {"seed": task.seed, "way": task.way}
    try:
        return told | _DRIVES[task.case](task, robot)
    except ElasticStripsError as error:
        return told | {"error": f"{type(error).__name__}: {error}"}


def _run(
    task: _Task,
    robot: RobotModel,
    world: World,
    start: Array,
    goal: object,
    *,
    params: DriveParams | None = None,
    make: Callable[..., Controller] | None = None,
) -> _Driven:
    """Drive until the last goal is reached, or the time is over."""
    driven: Simulation[Controller] = simulation(
        robot,
        world,
        start,
        goal,  # type: ignore[arg-type]
        params=params,
        make=make,
        seed=task.seed,
        compute=task.compute,
    )
    driven.period = 1.0 / task.rate
    with driven.controller:
        return _Driven(driven, driven.run(time_limit=task.seconds))


def _figures(done: _Driven) -> Figures:
    """What every drive has: contacts, rests, and how far off the goals were that were called reached."""
    driven, result, robot = done.driven, done.result, done.robot
    control = result.record.control
    evaluation = evaluate(result.record, robot, driven.world, driven.limits)
    standing = (np.abs(control.v).max(axis=1) < _REST_SPEED) & (control.state != int(RunState.REACHED))
    moves = np.abs(control.reference_v).max(axis=1) > 1e-6
    stops = [(time, reason) for time, reason in result.stops if not reason.startswith(_OVER)]
    since, longest = _longest(control.time, standing)
    params, tolerance = driven.params, driven.controller.tolerance
    off = np.array([off_goal(robot, done.at(g.time)[None], g.goal)[0] for g in result.goals]).reshape(-1, 3)
    most = np.array([tolerance.position, tolerance.yaw, tolerance.joints]) + params.tracking_error
    return {
        "state": result.state.label,
        "reason": result.reason,
        "reached": result.state is RunState.REACHED,
        "time_s": evaluation.time_s,
        "path_m": evaluation.path_m,
        "rests": int((moves[:-1] & ~moves[1:]).sum()),
        "rest_s": evaluation.rest_s,
        "stops": [[time, reason] for time, reason in stops],
        "longest_stand_s": longest,
        "longest_stand_at_s": since,
        "contacts": evaluation.as_dict()["collisions"],
        "contacts_standing": sum(c.obstacle not in driven.world.names_moving for c in evaluation.collisions),
        "contacts_at_rest": len(evaluation.rest_contacts),
        "min_clearance_m": evaluation.min_clearance_m if evaluation.closest else None,
        "goals": len(result.goals),
        "passed": sum(g.passed for g in result.goals),
        "goals_off_m": float(off[:, 0].max(initial=0.0)),
        "goals_off_rad": float(off[:, 1].max(initial=0.0)),
        "goals_missed": int((off > most).any(axis=1).sum()),
        "late_ticks": result.statistics.misses,
        "tick_ms": percentiles(result.statistics.seconds, scale=1e3),
        "faults": dict(Counter(event.reason for event in result.events if event.kind == "fault").most_common(5)),
    }


def _longest(time: Array, holds: np.ndarray) -> tuple[float, float]:
    """When the longest time begins during which something holds [s], and its duration [s]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], holds, [False]]).astype(int)))
    spans = [(float(time[b - 1] - time[a]), float(time[a])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    longest, since = max(spans, default=(0.0, 0.0))
    return since, longest


def _every(task: _Task, robot: RobotModel) -> Figures:
    """A new goal every two seconds; how much nearer to its goal the robot has come each time."""
    world = hall_world(task.seed)
    crates = [o for o in world.at(0.0) if o.motion is None]
    rng = np.random.default_rng(task.seed)

    def draw() -> BasePose:
        while True:
            x, y = rng.uniform(-3.5, 3.5), rng.uniform(-2.6, 2.6)
            if all(hypot(x - crate.pose[0, 3], y - crate.pose[1, 3]) > _FROM_CRATES for crate in crates):
                return BasePose(float(x), float(y))

    start, first = robot.home(x=-3.5), draw()
    make = partial(_Restless, robot, start, first, draw=draw, until=task.seconds, stops=task.way == STOP)
    done = _run(task, robot, world if task.moving else World(Scene(crates)), start, first, make=make)
    controller = done.driven.controller
    assert isinstance(controller, _Restless)
    end = float(done.result.record.control.time[-1])
    until = [time for time, _ in controller.asked[1:]] + [min(end, task.seconds)]
    nearer = [
        _from(done, begin, goal) - _from(done, over, goal)
        for (begin, goal), over in zip(controller.asked, until, strict=True)
    ]
    asked = [(0.0, first), *controller.asked]
    astray = [_from(done, g.time, [goal for t, goal in asked if t <= g.time][-1]) for g in done.result.goals]
    return _figures(done) | {
        "progress_m": float(sum(nearer)),
        "asked": len(nearer),
        "astray_m": max(astray, default=0.0),
    }


def _from(done: _Driven, time: float, goal: BasePose) -> float:
    """Distance [m] of the base from a goal at a time [s]."""
    x, y = done.at(time)[:2]
    return hypot(x - goal.x, y - goal.y)


def _patrol(task: _Task, robot: RobotModel) -> Figures:
    """Ten goals one after the other, in a loop about the middle, with obstacles beside."""
    rng = np.random.default_rng(task.seed)
    angles = np.linspace(-0.5 * pi, 1.5 * pi, _PATROL_GOALS, endpoint=False) + rng.uniform(-0.15, 0.15, _PATROL_GOALS)
    sizes = rng.uniform(0.85, 1.15, _PATROL_GOALS)
    places = [(3.2 * s * cos(a), 2.4 * s * sin(a)) for a, s in zip(angles, sizes, strict=True)]
    start = (places[0][0] - 1.5, places[0][1])
    around = np.array([start, *places])
    beside = _beside(rng, around, count=8)
    walkers = [crossing(f"person-{k}", rng.uniform(-2.5, 2.5), rng.uniform(14.0, 22.0), 4.0) for k in range(3)]
    world = World(Scene([*beside, *(walkers if task.moving else ())]))
    done = _run(
        task,
        robot,
        world,
        robot.home(x=start[0], y=start[1]),
        [BasePose(x, y) for x, y in places],
        params=DriveParams(stop_at_goals=task.way == STOP),
    )
    return _figures(done)


def _beside(rng: np.random.Generator, way: Array, count: int) -> list[Obstacle]:
    """Boxes and posts at random places, none of them nearer to a way (K, 2) than a robot needs."""
    made: list[Obstacle] = []
    while len(made) < count:
        x, y, radius = rng.uniform(-4.5, 4.5), rng.uniform(-3.8, 3.8), rng.uniform(0.12, 0.3)
        if not 0.65 + radius < float(_off_path(way, np.array([[x, y]]))[0]) < 2.0:
            continue
        at, height = (float(x), float(y)), float(rng.uniform(0.3, 1.6))
        name = f"crate-{len(made)}"
        if rng.random() < 0.5:
            made.append(Box((1.4 * radius, 1.4 * radius, height), at=(*at, height / 2), name=name))
        else:
            made.append(Cylinder(float(radius), height, at=(*at, height / 2), name=name))
    return made


def _off_path(path: Array, xy: Array) -> Array:
    """(N,) distance [m] of places (N, 2) from lines between points (K, 2)."""
    nearest = np.full(len(xy), np.inf)
    for a, b in pairwise(path):
        part = np.clip((xy - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-12), 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(xy - a - part[:, None] * (b - a), axis=1))
    return nearest


def _path(task: _Task, robot: RobotModel) -> Figures:
    """A path about which the corridor is free, followed; what crosses it is waited for."""
    scenario = get_scenario("moving-corridor" if task.moving else "corridor", seed=task.seed)
    path, start = corridor_guide(task.seed)[::8], scenario.ends(robot)[0]
    path = np.vstack([path, corridor_guide(task.seed)[-1:]])

    def make(scene: Scene, **options: object) -> Controller:
        controller = Controller(robot, start, start, scene, **options)  # type: ignore[arg-type]
        controller.follow(path, within=_WITHIN)
        return controller

    done = _run(task, robot, scenario.world, start, start, make=make)
    rows = done.result.record.control.coordinates
    off = _off_path(path, rows[:, :2])
    waits = [event for event in done.result.events if event.kind == "waiting"]
    return _figures(done) | {
        "off_path_m": float(off.max()),
        "from_end_m": hypot(*(rows[-1, :2] - path[-1])),
        "waits": [[event.time, event.reason] for event in waits],
    }


def _look(task: _Task, robot: RobotModel) -> Figures:
    """A drive through the hall with a hand that points at a place beside it; the largest angle, by Pinocchio alone."""
    rng = np.random.default_rng(task.seed)
    world = hall_world(task.seed)
    if not task.moving:
        world = World(Scene([o for o in world.at(0.0) if o.motion is None]))
    x, y, z = rng.uniform(-2.0, 2.0), rng.choice([-1.0, 1.0]) * rng.uniform(2.6, 4.0), rng.uniform(0.5, 1.3)
    look = LookAt(frame=_hands_of(robot)[0], axis=(1.0, 0.0, 0.0), at=(float(x), float(y), float(z)))
    scene = world.at(0.0)
    begin = find_goals(robot, scene, robot.home(x=-3.5), BasePose(-3.5, 0.0, 0.0), constraint=look)
    start = begin.configurations[0] if len(begin.configurations) else None
    if start is None:
        raise InputError(f"the hand cannot look at it from the start: {begin.reason}")
    end = find_goals(robot, scene, start, BasePose(3.5, 0.0, 0.0), constraint=look)
    if not len(end.configurations):
        raise InputError(f"the hand cannot look at it from the goal: {end.reason}")
    done = _run(task, robot, world, start, end.configurations[0], params=DriveParams(constraint=look))
    angles = _angles(robot, done.result.record.control.coordinates, look)
    return _figures(done) | {
        "off_rad": float(angles.max()),
        "tolerance_rad": look.tolerance,
        "within": float((angles <= look.tolerance).mean()),
    }


def _angles(robot: RobotModel, rows: Array, look: LookAt) -> Array:
    """(N,) angle [rad] between a frame's axis and the line to its place at coordinate rows (N, nv)."""
    data, out = robot.model.createData(), np.empty(len(rows))
    axis, place = np.array(look.axis) / np.linalg.norm(look.axis), np.array(look.at, dtype=float)
    for k, q in enumerate(robot.space.from_coordinates(rows)):
        pin.forwardKinematics(robot.model, data, q)
        T = pin.updateFramePlacement(robot.model, data, robot.model.getFrameId(look.frame))
        a, line = T.rotation @ axis, place - T.translation
        out[k] = np.arctan2(np.linalg.norm(np.cross(a, line)), a @ line)
    return out


def _hands_of(robot: RobotModel) -> tuple[str, ...]:
    """The frames of the robot's hands."""
    if robot.name not in _HANDS:
        raise ParameterError(f"the hands of {robot.name!r} are not known{nearest_name(robot.name, _HANDS)}")
    return _HANDS[robot.name]


def _hands(task: _Task, robot: RobotModel) -> Figures:
    """All hands at poses over a table at once, behind pillars; how far each misses its pose in truth."""
    rng = np.random.default_rng(task.seed)
    x, y = float(rng.uniform(3.0, 4.0)), float(rng.uniform(-1.0, 1.0))
    pillars = [
        Cylinder(0.15, 1.5, at=(float(rng.uniform(1.1, 1.6)), side * float(rng.uniform(0.0, 0.9)), 0.75), name=name)
        for side, name in ((1.0, "pillar-left"), (-1.0, "pillar-right"))
    ]
    table = Box((0.6, 1.4, 0.7), at=(x, y, 0.35), name="table")
    walkers = [crossing("person", -1.2, 15.0, 2.5)] if task.moving else []
    frames, edge = _hands_of(robot), x - 0.15
    if len(frames) == 2:
        sides = zip(frames, (1.0, -1.0), strict=True)
        goal = AllOf(*(HandPose(frame, (edge, y + side * _APART, 0.85), _AHEAD) for frame, side in sides))
    else:
        goal = AllOf(HandPose(frames[0], (edge, y, 0.9)), BasePose(x - 0.85, y, within=(0.1, 0.3)))
    done = _run(task, robot, World(Scene([table, *pillars, *walkers])), robot.home(), goal)
    data, q = robot.model.createData(), robot.space.from_coordinates(done.result.record.control.coordinates[-1])
    pin.framesForwardKinematics(robot.model, data, q)
    misses = [
        float(np.linalg.norm(data.oMf[robot.model.getFrameId(hand.frame)].translation - hand.position))
        for hand in goal.hands
    ]
    return _figures(done) | {"hands_off_m": misses}


def _pick(task: _Task, robot: RobotModel) -> Figures:
    return measure_pick(robot, task.way, task.seed, task.root, task.compute)


_DRIVES: dict[str, Callable[[_Task, RobotModel], Figures]] = {
    "every": _every,
    "patrol": _patrol,
    "path": _path,
    "look": _look,
    "hands": _hands,
    "picks": _pick,
}


def _summary(runs: list[Figures]) -> Figures:
    """Figures of some drives."""
    done = [r for r in runs if "error" not in r]
    stops = Counter(reason for r in done for _, reason in r["stops"])
    waits = Counter(reason.partition(":")[0] for r in done for _, reason in r.get("waits", ()))
    figures: Figures = {
        "count": len(runs),
        "reached": sum(r["reached"] for r in done),
        "contacts": sum(len(r["contacts"]) for r in done),
        "contacts_standing": sum(r["contacts_standing"] for r in done),
        "goals": sum(r["goals"] for r in done),
        "passed": sum(r["passed"] for r in done),
        "goals_missed": sum(r["goals_missed"] for r in done),
        "goals_off_m": max((r["goals_off_m"] for r in done), default=0.0),
        "rests": sum(r["rests"] for r in done),
        "time_s": sum(r["time_s"] for r in done),
        "path_m": sum(r["path_m"] for r in done),
        "rest_s": sum(r["rest_s"] for r in done),
        "stops": sum(stops.values()),
        "stop_reasons": dict(stops.most_common(10)),
        "longest_stand_s": max((r["longest_stand_s"] for r in done), default=0.0),
        "waits": dict(waits.most_common(10)),
        "tick_ms_p99": percentiles([r["tick_ms"]["p99"] for r in done if r["tick_ms"]["p99"] is not None]),
        "errors": [r["error"] for r in runs if "error" in r],
    }
    for name in ("progress_m", "asked"):
        if any(name in r for r in done):
            figures[name] = sum(r[name] for r in done)
    for name in ("astray_m", "off_path_m", "from_end_m", "off_rad"):
        if any(name in r for r in done):
            figures[name] = max(r[name] for r in done)
    if any("hands_off_m" in r for r in done):
        misses = [miss for r in done if r["reached"] for miss in r["hands_off_m"]]
        figures["hands_off_m"] = max(misses, default=float("nan"))
    if any("within" in r for r in done):
        figures["within"] = float(np.mean([r["within"] for r in done]))
    return figures
