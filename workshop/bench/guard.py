"""Guard: hostile pilots, walls, doors, and a wide hall, with and without the guard; measured from the true states."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from time import thread_time
from typing import cast

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision import Certificate, Forecast
from elastic_strips.control import Controller, DriveParams, Guard, GuardedCommand, GuardOutcome, GuardParams, RunState
from elastic_strips.control.guard_proposal import NearPairs, Proposal, Proposer
from elastic_strips.control.interfaces import Command, Event, GoalReached, Measurement
from elastic_strips.control.params import LASER_ASSUMPTIONS, LASER_EASE
from elastic_strips.control.record import TickStatistics
from elastic_strips.errors import ParameterError
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Cylinder, Scene, Twist, World
from elastic_strips.sim.closed_loop import Simulation, simulation
from elastic_strips.sim.evaluation import evaluate
from elastic_strips.sim.evaluation.visibility import unseen_contacts
from elastic_strips.sim.faults import Fault
from elastic_strips.sim.jobs import parallel_map
from elastic_strips.sim.sensed_perception import SensorPerception
from elastic_strips.sim.sensors import SensorConfig
from elastic_strips.strip import Strip
from elastic_strips.trajectory import MotionLimits, ReferenceState, Trajectory

from .measure import Figures, Note, head, percentiles, silent
from .pilots import PILOTS, Pilot, Seen

METHODS = ("guard", "uncertified", "barrier-2", "barrier-1", "scaling", "none")
"""``uncertified``: the guard's programme without its certificate; ``barrier-γ``: a control barrier function of each
pair as the programme's bound, in 1/s; ``scaling``: slower in proportion to the distance; ``none``: commands as they
are. All have the guard's limits and its tracking."""
BASES = ("", "omni")
_SCALED_FROM, _SCALED_TO = 0.6, 0.05  # [m] beyond the clearance: full speed, and rest
_RUN = 15.0  # [s] of a hostile run
_ROOM = 5.0  # [m] half the side of the hall
_FREE_START = 0.9  # [m] between the robot's start and obstacles


# what does not certify


class _Believer:
    """In the certifier's place: believes everything."""

    def certify(self, trajectory: Trajectory, scene: Scene, forecast: Forecast, **_: float) -> Certificate:
        count = len(trajectory)
        return Certificate(0.0, np.ones(count, dtype=bool), np.zeros(count, dtype=np.int8), None, 0)


class _Barrier(Proposer):
    """Workspace: bounds of a control barrier function, ḋ ≥ −γ (d − c)."""

    gamma: float

    def propose(
        self, desired: Array, start: ReferenceState, pairs: NearPairs, *, hold: float, turns: bool = True
    ) -> Proposal:
        if not len(pairs.distance):
            return Proposal(desired, None)
        return self.nearest(desired, pairs, -self.gamma * (pairs.distance - pairs.need), turns=turns)


class _Scaling(Proposer):
    """Workspace: slower in proportion to the least distance."""

    def propose(
        self, desired: Array, start: ReferenceState, pairs: NearPairs, *, hold: float, turns: bool = True
    ) -> Proposal:
        if not pairs.outer:
            return Proposal(desired, None)
        room = pairs.distance[: pairs.outer] - pairs.need[: pairs.outer]
        share = float(np.clip((room.min() - _SCALED_TO) / (_SCALED_FROM - _SCALED_TO), 0.0, 1.0))
        return Proposal(desired * share, int(room.argmin()) if share < 1.0 else None)


class _Unbent(Proposer):
    """Workspace: bends nothing."""

    def propose(
        self, desired: Array, start: ReferenceState, pairs: NearPairs, *, hold: float, turns: bool = True
    ) -> Proposal:
        return Proposal(desired, None)


class PeerGuard(Guard):
    """Workspace: the guard's loop with another method in it, and without its certificate."""

    def __init__(self, method: str, robot: RobotModel, limits: MotionLimits, params: GuardParams, start: Array) -> None:
        super().__init__(robot, limits, params, start=start)
        self._certifier = cast("type", _Believer)()
        self._steering = None
        if method == "scaling":
            self._proposer.__class__ = _Scaling
        elif method == "none":
            self._proposer.__class__ = _Unbent
        elif method.startswith("barrier"):
            barrier = cast("_Barrier", self._proposer)
            barrier.__class__ = _Barrier
            barrier.gamma = float(method.split("-")[1])


# the loop


class Piloted:
    """Workspace: a pilot and what guards it, as a :class:`~elastic_strips.sim.Simulation` asks for a controller."""

    def __init__(
        self,
        robot: RobotModel,
        start: Array,
        pilot: Pilot,
        method: str,
        known: Scene,
        *,
        params: DriveParams,
        limits: MotionLimits,
        meter: Callable[[], float] | None = None,
        until: Callable[[Array], bool] | None = None,
        **_: object,
    ) -> None:
        own = GuardParams(drive=params, speed=params.speed_scale)
        self.guard: Guard = (
            Guard(robot, limits, own, start=start, events=None, meter=meter)
            if method == "guard"
            else PeerGuard(method, robot, limits, own, start)
        )
        self.robot, self.params, self.limits, self.pilot = robot, params, limits, pilot
        self.time = 0.0
        self.goal: Array = robot.space.to_coordinates(start)
        self.goals: list[Array] = []
        self.goals_reached: list[GoalReached] = []
        self.plan_tick: object = self.step  # faults of planning have nothing to act on
        self.tick: None = None
        self.result: None = None
        self.statistics: TickStatistics = TickStatistics()
        self.sensing_took: float = 0.0
        self.replans: int = 0
        self.times: list[float] = []  # [s] of the answers
        self.answers: list[GuardedCommand] = []
        self.wanted: list[bool] = []  # whether something was
        self.seconds: list[float] = []  # of the processor, of each step
        self._scene = known
        self._until = until
        self._meter, self._busy, self._last = meter, -1.0, Command.rest(limits)
        self._measured: Measurement | None = None  # in a period that was lost
        self._steps = 0
        self.strip: Strip = Strip.from_coordinates(robot, np.stack((self.goal, self.goal)))

    @property
    def plans_next(self) -> bool:
        """Whether a scene is sensed for the next step."""
        return self._steps % self.params.plan_every == 0

    @property
    def reference(self) -> ReferenceState:
        """State that the robot follows."""
        return self.guard.executor.reference(self.time)

    def ahead(self, seconds: float, step: float = 0.2) -> Array:
        """Coordinate rows (K, nv) that the present velocity leads through in so many seconds; for sensors that look."""
        state, space = self.reference, self.robot.space
        return np.array([space.integrate(state.coordinates, t * state.v) for t in np.arange(0.0, seconds + step, step)])

    @property
    def estimate(self) -> Array:
        """(nv,) estimated coordinate row."""
        return self.guard.executor.estimate

    @property
    def state(self) -> RunState:
        """State of the robot."""
        return self.guard.executor.run.state

    @property
    def reason(self) -> str:
        """Reason of the state."""
        return self.guard.executor.run.reason

    @property
    def events(self) -> list[Event]:
        """Events so far."""
        return self.guard.executor.run.events

    @property
    def stops(self) -> list[tuple[float, str]]:
        """Stops so far."""
        return self.guard.executor.run.stops

    @property
    def ended(self) -> bool:
        """Whether the pilot is where it wanted to be."""
        return self._until is not None and self._until(self.estimate)

    @property
    def halted(self) -> bool:
        """Whether the robot stands for good."""
        return self._steps > 0 and bool(self.guard.executor.waits) and self.guard.executor.at_rest(self.time)

    def stop(self, reason: str = "asked to stop") -> None:
        """Bring the robot to rest."""
        self.guard.stop(reason)

    def resume(self) -> None:
        """Go on."""
        self.guard.resume()

    def log(self, kind: str, reason: str) -> None:
        """Write down an event."""
        self.guard.executor.log(kind, reason)

    def warm_up(self) -> None:
        """Nothing is to be warmed up."""

    def step(self, t: float, measurement: Measurement | None, scene: Scene | None, *, trouble: str = "") -> Command:
        """One control period; those that the computing of the one before takes are lost."""
        self.time = t
        self._steps += 1
        if scene is not None and len(scene):
            self._scene = scene
        desired = self.pilot(Seen(t, self.estimate, self._scene))
        if self._measured is not None and measurement is not None:
            measurement = _together(self._measured, measurement)
        self._measured = None
        if t < self._busy - 1e-9:
            self._measured = measurement
            return self._last
        began, charged = thread_time(), 0.0 if self._meter is None else self._meter()
        answer = self.guard.step(t, measurement, scene, desired, trouble=trouble)
        self.seconds.append(thread_time() - began)
        self.times.append(t)
        took = 0.0 if self._meter is None else self._meter() - charged + self.sensing_took
        self.sensing_took, self._busy, self._last = 0.0, t + took, answer.command
        self.answers.append(answer)
        self.wanted.append(
            desired is not None
            and desired.finite
            and any(v is not None and bool(np.abs(v).max(initial=0.0) > 1e-3) for v in (desired.twist, desired.joints))
        )
        return answer.command


def _together(one: Measurement, other: Measurement) -> Measurement:
    """Two measurements that follow each other as one."""
    drive = None if one.drive is None or other.drive is None else one.drive + other.drive
    if other.pose is not None:
        return replace(other, drive=drive)
    return replace(other, drive=drive, pose=one.pose, pose_time=one.pose_time)


@dataclass(frozen=True, slots=True)
class _Task:
    """A run."""

    robot: str
    base: str
    pilot: str
    method: str
    seed: int
    obstacles: int
    moving: bool
    fault: str = ""
    plant: str = "kinematic"
    time: float = _RUN
    compute: str = "free"
    sensors: SensorConfig | None = None


def load(robot: str, base: str) -> RobotModel:
    """A robot, with another base where one is named."""
    return load_robot(robot, base=base) if base else load_robot(robot)


def limits_of(robot: RobotModel) -> MotionLimits:
    """The limits of a robot; a differential drive whose file states no wheels gets those of a Fetch."""
    try:
        return MotionLimits.for_robot(robot)
    except ParameterError:
        return MotionLimits.for_robot(robot, wheel_speed=1.0, track=0.375, wheel_radius=0.06)


def _turned(rng: np.random.Generator) -> tuple[float, float, float, float]:
    """A random turn about z, as a quaternion."""
    half = float(rng.uniform(0.0, math.pi))
    return 0.0, 0.0, math.sin(half), math.cos(half)


def hall(rng: np.random.Generator, obstacles: int, *, moving: bool) -> World:
    """A hall with walls and things of all heights in it; a quarter of them move, straight on at up to 1 m/s."""
    side, things = _ROOM, []
    for k, (x, y) in enumerate(((side, 0.0), (-side, 0.0), (0.0, side), (0.0, -side))):
        size = (0.2, 2.0 * side, 2.0) if y == 0.0 else (2.0 * side, 0.2, 2.0)
        things.append(Box(size, at=(x, y, 1.0), name=f"wall {k}"))
    movers = obstacles // 4 if moving else 0
    while len(things) < 4 + obstacles - movers:
        x, y = rng.uniform(-side + 0.3, side - 0.3, 2)
        size, name = rng.uniform(0.15, 0.8, 3), f"thing {len(things)}"
        if math.hypot(x, y) < _FREE_START + 0.7 * float(size[:2].max()):
            continue
        kind = int(rng.integers(4))
        if kind == 0:
            things.append(Cylinder(0.4 * size[0], 2.0 * size[1], at=(x, y, size[1]), name=name))
        elif kind == 1:  # a board at the height of an arm
            at = (x, y, float(rng.uniform(0.5, 1.3)))
            things.append(Box((size[0], size[1], 0.05), at=at, quat=_turned(rng), name=name))
        else:
            high = float(rng.uniform(0.3, 1.6))
            things.append(Box((size[0], size[1], high), at=(x, y, 0.5 * high), quat=_turned(rng), name=name))
    for k in range(movers):
        angle, speed = float(rng.uniform(0.0, 2.0 * math.pi)), float(rng.uniform(0.2, 1.0))
        passed = float(rng.uniform(-2.5, 2.5))
        way = np.array([math.cos(angle), math.sin(angle)])
        at = -way * float(rng.uniform(2.0, 8.0)) + passed * np.array([-way[1], way[0]])
        motion = Twist(np.array([*(speed * way), 0.0]))
        things.append(Cylinder(0.2, 1.7, at=(*at, 0.85), name=f"mover {k}", motion=motion))
    return World(Scene(things))


def simulated(
    robot: RobotModel,
    world: World | Scene,
    start: Array,
    pilot: Pilot,
    method: str,
    *,
    seed: int,
    time: float,
    plant: str = "kinematic",
    compute: str = "free",
    faults: Iterable[Fault] = (),
    sensors: SensorConfig | None = None,
    until: Callable[[Array], bool] | None = None,
) -> tuple[Piloted, Simulation[Controller], Figures]:
    """A run, and what its true states say."""

    def make(known: Scene, **options: object) -> Controller:
        piloted = Piloted(robot, start, pilot, method, known, until=until, **options)  # type: ignore[arg-type]
        return cast("Controller", piloted)

    machine = None
    if plant == "mujoco":
        from elastic_strips.sim.mujoco.plant import MujocoPlant

        assert isinstance(world, World)
        machine = MujocoPlant(robot, limits_of(robot), world, seed=seed)
    params, senses = None, None
    if sensors is not None:
        assert isinstance(world, World)
        params = DriveParams(assumptions=LASER_ASSUMPTIONS, speed_scale=LASER_EASE)
        senses = SensorPerception(robot, world, start, sensors=sensors, seed=seed)
    driven = simulation(
        robot,
        world,
        start,
        start,
        limits=limits_of(robot),
        params=params,
        perception=senses,
        make=make,
        seed=seed,
        faults=faults,
        plant=machine,
        compute=compute,
    )
    result = driven.run(time_limit=time)
    piloted = cast("Piloted", driven.controller)
    found = evaluate(result.record, robot, driven.world, driven.limits)
    glass = getattr(driven.perception, "glass", None)
    unseen = () if sensors is None else unseen_contacts(result.record, found, robot, driven.world, sensors, glass=glass)
    rows = result.record.control
    off = np.abs(rows.v).max(axis=1)
    answers = [a for a, t in zip(piloted.answers, piloted.times, strict=True) if t < time]  # after that it is stopped
    shares = [a.share for a, wanted in zip(answers, piloted.wanted, strict=False) if wanted]
    figures = {
        "contacts_at_speed": len(found.collisions),
        "contacts_with_seen": sum(contact not in unseen for contact in found.collisions),
        "contacts": found.as_dict()["collisions"],
        "contacts_at_rest": len(found.rest_contacts),
        "min_clearance_m": found.min_clearance_m if found.closest else None,
        "share": float(np.mean(shares)) if shares else None,
        "path_m": found.path_m,
        "time_s": found.time_s,
        "events": len(result.events),
        "unproven": sum(e.kind == "unproven" for e in result.events),
        "faults": sorted({e.reason for e in result.events if e.kind == "fault"})[:5],
        "outcomes": {o.value: sum(a.outcome is o for a in answers) for o in GuardOutcome},
        "tries": float(np.mean([a.tries for a in answers])),
        "moving": float((off > 0.02).mean()),
        "at_rest_at_end": bool(off[-1] < 0.01),
        "step_ms": [1e3 * s for s in piloted.seconds],
    }
    driven.plant.close()
    return piloted, driven, figures


def _hostile(task: _Task) -> Figures:
    robot, rng = load(task.robot, task.base), np.random.default_rng((task.seed, 7))
    limits = limits_of(robot)
    pilot = PILOTS[task.pilot](robot, limits, rng)
    world = hall(np.random.default_rng(task.seed), task.obstacles, moving=task.moving)
    faults = [Fault.parse(f"{task.fault}@{rng.uniform(2.0, 0.6 * task.time):.2f}")] if task.fault else []
    _, _, figures = simulated(
        robot,
        world,
        robot.home_q,
        pilot,
        task.method,
        seed=task.seed,
        time=task.time,
        plant=task.plant,
        compute=task.compute,
        faults=faults,
        sensors=task.sensors,
    )
    named = ("robot", "base", "pilot", "method", "seed", "obstacles", "moving", "fault", "plant", "compute")
    return {name: getattr(task, name) for name in named} | {"moves": figures.pop("moving")} | figures


def bench_guard(
    robots: Sequence[str],
    seeds: Sequence[int],
    step: Note = silent,
    *,
    bases: Sequence[str] = BASES,
    pilots: Sequence[str] | None = None,
    methods: Sequence[str] = ("guard",),
    obstacles: Sequence[int] = (20,),
    fault: str = "",
    plant: str = "kinematic",
    time: float = _RUN,
    compute: str = "free",
    sensors: SensorConfig | None = None,
    processes: int | None = None,
) -> Figures:
    """Pilots in a hall, with still and with moving obstacles.

    Args:
        robots: names or URDF files.
        seeds: seeds of halls, pilots and noise.
        step: called after each run.
        bases: ``""``: the robot's own base; ``"omni"``: one that slides.
        pilots: of `PILOTS`; all where None.
        methods: of `METHODS`.
        obstacles: numbers of obstacles; a quarter of them moves in every second seed.
        fault: kind of fault that is put into each run; none where empty.
        plant: the machine, ``"kinematic"`` or ``"mujoco"``.
        time: length of a run [s].
        compute: cost of computing; periods that a step takes too long are lost. As for
            :func:`~elastic_strips.sim.simulation`.
        sensors: what the robot knows its scene by; the scene itself, noisy and late, where None.
        processes: runs at once.
    """
    tasks = [
        _Task(robot, base, pilot, method, int(seed), count, seed % 2 == 1, fault, plant, time, compute, sensors)
        for robot in robots
        for base in bases
        for pilot in pilots or PILOTS
        for method in methods
        for count in obstacles
        for seed in seeds
    ]
    runs = []
    for run in parallel_map(_hostile, tasks, processes):
        runs.append(run)
        step(f"{run['pilot']}, {run['method']}, seed {run['seed']}: {run['contacts_at_speed']} contacts")
    groups = []
    for robot in robots:
        for base in bases:
            for method in methods:
                for count in obstacles:
                    mine = [
                        r
                        for r in runs
                        if (r["robot"], r["base"], r["method"], r["obstacles"]) == (robot, base, method, count)
                    ]
                    groups.append({"robot": robot, "base": base, "method": method, "obstacles": count} | _summary(mine))
    for run in runs:
        run["step_ms"] = percentiles(run["step_ms"])
    return {**head("guard", robots=list(robots)), "groups": groups, "runs": runs}


def _summary(runs: list[Figures]) -> Figures:
    shares = [r["share"] for r in runs if r["share"] is not None]
    near = [r["min_clearance_m"] for r in runs if r["min_clearance_m"] is not None]
    return {
        "count": len(runs),
        "contacts_at_speed": sum(r["contacts_at_speed"] for r in runs),
        "contacts_with_seen": sum(r["contacts_with_seen"] for r in runs),
        "runs_with_contacts": sum(r["contacts_at_speed"] > 0 for r in runs),
        "contacts_at_rest": sum(r["contacts_at_rest"] for r in runs),
        "least_clearance_m": min(near, default=None),
        "share": float(np.mean(shares)) if shares else None,
        "path_m": float(np.mean([r["path_m"] for r in runs])),
        "moves": float(np.mean([r["moves"] for r in runs])),
        "unproven": sum(r["unproven"] for r in runs),
        "events": float(np.mean([r["events"] for r in runs])),
        "tries": float(np.mean([r["tries"] for r in runs])),
        "at_rest_at_end": float(np.mean([r["at_rest_at_end"] for r in runs])),
        "step_ms": percentiles([ms for r in runs for ms in r["step_ms"]]),
    }
