"""Realtime benchmark: how evenly commands come against the wall clock, while planning takes all the time there is."""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control.controller import Controller
from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.control.params import DriveParams
from elastic_strips.control.process.child import end_process, start_process
from elastic_strips.control.process.executor_process import ExecutorProcess
from elastic_strips.control.process.log_stream import read_log
from elastic_strips.control.process.priority import raise_priority
from elastic_strips.control.record import DriveResult
from elastic_strips.robot import RobotModel
from elastic_strips.sim.closed_loop import MACHINE, Simulation, prepare, simulation
from elastic_strips.sim.evaluation import evaluate
from elastic_strips.sim.perception import NoisyGroundTruth, PerceptionParams
from elastic_strips.sim.plant import KinematicPlant
from elastic_strips.sim.realtime import RealtimeSimulation
from elastic_strips.strip.params import DeformParams
from elastic_strips.trajectory import MotionLimits

from .drive import hall_world
from .measure import Figures, Note, head, silent

_BURST_GAP = 0.005  # [s] commands that follow each other faster come in a burst
_STALL_GAP = 0.005  # [s] a witness that sleeps for 1 ms, and longer than this, was stopped
_SHORTEST_LEG = 5.0  # [s] no leg takes less
_Stalls = list[tuple[float, float]]  # from, to [s]


def bench_realtime(
    robot: RobotModel, minutes: float = 10.0, step: Note = silent, *, inline: bool = False, seed: int = 0
) -> Figures:
    """Drive back and forth among movers, against the wall clock; planning is eager: it never waits.

    A witness, a process of its own with the same priority, does nothing but notice when it is not served. Where it
    stood still at the same time, a gap is taken for one of the whole computer: a virtual machine that was paused.

    Args:
        robot: the robot.
        minutes: duration.
        step: called now and then.
        inline: control and planning in one thread instead, as with ``Simulation(realtime=True)``.
        seed: seed of movers, plant and noise.

    Returns:
        Figures: gaps between commands and durations of control steps [ms], legs, stops, contacts at speed.
    """
    ends = [robot.home(x=-3.5), robot.home(x=3.5)]
    goals = np.stack([ends[(k + 1) % 2] for k in range(max(2, round(60.0 * minutes / _SHORTEST_LEG)))])
    params = DriveParams(deform=DeformParams(max_nodes=200), time_limit=60.0 * minutes, replan_time=0.0)
    told = [0.0]

    def watch(driven: Simulation[Controller]) -> None:
        if driven.time >= told[0] + 5.0:
            told[0] = driven.time
            step(f"{driven.time / 60.0:.1f} min, {driven.controller.reached} legs")

    with tempfile.TemporaryDirectory(prefix="elastic-strips-") as folder, _witness() as stalls:
        log = Path(folder) / "log.jsonl"
        make = _inline if inline else partial(_processes, log=log)
        driven, sent = make(robot, goals, ends[0], params, seed, watch)
        steal = _steal()
        result = driven.run()
        steal = _steal() - steal
        took: list[float] = []
        epoch, priority = 0.0, "ordinary priority"
        if isinstance(driven, RealtimeSimulation):
            rows = [row for row in read_log(log) if "event" not in row]
            epoch, priority = driven.executor.epoch, driven.executor.priority
            sent = [float(str(row["sent"])) for row in rows]
            took = [float(str(row["took"])) for row in rows]
    evaluation = evaluate(result.record, robot)
    return {
        **head("realtime", robot=robot.name),
        "mode": "one thread" if inline else "processes",
        "priority": priority,
        "seconds": driven.time,
        **_gap_figures(np.array(sent) + epoch, stalls, params.control_dt),
        "step_ms": _percentiles(took),
        "tick_ms": result.statistics.percentiles(),
        "ticks": len(result.statistics.seconds),
        "legs": driven.controller.reached,
        "state": result.state.label,
        "stops": [[time_, reason] for time_, reason in result.stops],
        "contacts_at_speed": len(evaluation.collisions),
        "contacts_at_rest": len(evaluation.rest_contacts),
        "min_clearance_m": evaluation.min_clearance_m,
        "faults": _counted(result),
        "steal_s": steal,
    }


def _processes(
    robot: RobotModel, goals: Array, start: Array, params: DriveParams, seed: int, watch: object, *, log: Path
) -> tuple[Simulation[Controller], list[float]]:
    limits = MotionLimits.for_robot(robot)
    world, machine, rng = prepare(robot, hall_world(seed), limits, None, seed)
    senses = NoisyGroundTruth(world, params.assumptions, PerceptionParams(), rng)
    executor = ExecutorProcess(robot, start, goals[0], params=params, limits=limits, log=log)
    controller = Controller(
        robot,
        start,
        goals,
        senses.known(),
        params=params,
        limits=limits,
        seed=seed,
        executor=executor,
        meter=time.monotonic,
    )
    machine.reset(robot.space.to_coordinates(start))
    make = partial(KinematicPlant, robot, limits, MACHINE, seed=seed)
    return RealtimeSimulation(
        controller,
        executor,
        world,
        make,
        machine,
        senses,
        watch=watch,  # type: ignore[arg-type]
        log=log,
        eager=True,
    ), []


def _inline(
    robot: RobotModel, goals: Array, start: Array, params: DriveParams, seed: int, watch: object
) -> tuple[Simulation[Controller], list[float]]:
    driven = simulation(
        robot,
        hall_world(seed),
        start,
        goals,
        params=params,
        seed=seed,
        watch=watch,  # type: ignore[arg-type]
        realtime=True,
    )
    sent: list[float] = []
    advance = driven.plant.step

    def timed(command: Command, dt: float) -> Measurement:
        sent.append(time.monotonic())
        return advance(command, dt)

    driven.plant.step = timed  # type: ignore[method-assign]
    return driven, sent


def _gap_figures(sent: Array, stalls: _Stalls, dt: float) -> Figures:
    """Figures of the gaps between commands at times ``sent`` [s], while the witness was stopped at ``stalls``."""
    gaps = np.diff(sent)
    paused = np.zeros(len(gaps), dtype=bool)
    for begin, end in stalls:
        paused |= (sent[:-1] < end) & (sent[1:] > begin)
    late = gaps > 2.0 * dt
    return {
        "commands": len(sent),
        "gap_ms": _percentiles(gaps),
        "gap_unpaused_ms": _percentiles(gaps[~paused]),
        "bursts": float((gaps < _BURST_GAP).mean()) if len(gaps) else None,
        "late": int(late.sum()),
        "late_paused": int((late & paused).sum()),
        "paused_s": float(sum(end - begin for begin, end in stalls)),
        "longest_pause_ms": 1e3 * max((end - begin for begin, end in stalls), default=0.0),
    }


def _percentiles(seconds: Sequence[float] | Array) -> Figures:
    values = 1e3 * np.asarray(seconds, dtype=float)
    names = {"p50": 50.0, "p99": 99.0, "p99_9": 99.9, "max": 100.0}
    return {name: float(np.percentile(values, p)) if len(values) else None for name, p in names.items()}


def _counted(result: DriveResult) -> dict[str, int]:
    """How often each fault was told, without its numbers."""
    found: dict[str, int] = {}
    for event in result.events:
        if event.kind == "fault":
            name = "".join("#" if c.isdigit() else c for c in event.reason)[:60]
            found[name] = found.get(name, 0) + 1
    return found


def _steal() -> float:
    """Time [s] that the host has taken from all processors so far; 0 where it is not told."""
    try:
        fields = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()
        return float(fields[8]) / 100.0
    except (OSError, IndexError, ValueError):
        return 0.0


@contextmanager
def _witness() -> Iterator[_Stalls]:
    """A process that notices when it is not served; the list is filled at the end."""
    here, there = multiprocessing.Pipe()
    stalls: _Stalls = []
    process = start_process(_notice, (there,), (), name="witness")
    there.close()
    try:
        if here.poll(60.0):
            here.recv()
        yield stalls
    finally:
        try:
            here.send("end")
            stalls += here.recv() if here.poll(10.0) else []
        except (OSError, EOFError):
            pass
        end_process(process, 5.0)


def _notice(told: Connection) -> None:
    """The witness's process."""
    raise_priority()
    told.send("ready")
    stalls: _Stalls = []
    before = time.monotonic()
    while not told.poll():
        time.sleep(0.001)
        now = time.monotonic()
        if now - before > _STALL_GAP:
            stalls.append((before, now))
        before = now
    told.send(stalls)
