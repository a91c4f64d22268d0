"""Trials: drives against the wall clock in which a process is killed, stopped or hung; measured from the true states.

The machine belongs to the process that measures. It starts a planner's process, and this one the executor's.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control.interfaces import RunState
from elastic_strips.control.process.child import end_process
from elastic_strips.control.process.log_stream import read_log
from elastic_strips.control.record import RecordError
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.sim.closed_loop import MACHINE, sensed_by
from elastic_strips.sim.evaluation import evaluate
from elastic_strips.sim.faults import Fault, FaultPlan
from elastic_strips.sim.machine_process import MachineDriver, MachineProcess, TrueState, faulty_plant
from elastic_strips.sim.plant import KinematicPlant, Plant
from elastic_strips.sim.scenarios import Scenario, get_scenario
from elastic_strips.sim.scenarios.drive import make_realtime
from elastic_strips.trajectory import MotionLimits

from .measure import Figures, Note, head, silent

_WRONG = {"fix_drift": 4.0, "scene_without_motion": 100.0, "scene_reversed": 100.0}
"""Faults of what is measured or seen, and their durations [s]."""
KINDS = ("planner_killed", "parent_killed", "planner_stopped", "planner_hung", "executor_killed", "disk_full", *_WRONG)
"""``parent_killed``: as the planner, while another process holds the executor's channel open; ``planner_stopped``: for
1 s; ``planner_hung``: a tick of 2 s; the last three are `FAULTS`, where the scene is concerned among movers."""
_GO_ON = ("planner_stopped", "planner_hung", "disk_full", *_WRONG)  # the robot reaches its goal
_WRONG_FROM = 2.0  # [s] at the earliest
_FAST_SPEED, _REST_SPEED = 0.3, 1e-3  # [m/s]
_DRIVE_TIME_LIMIT = 60.0  # [s] of one drive
_PLANNER_STOP, _PLANNER_HANG = 1.0, 2.0  # [s]
_LONGEST_STOPPING = 10.0  # [s] in which a robot comes to rest


def bench_trials(
    robot: str, seeds: Sequence[int], step: Note = silent, *, kinds: Sequence[str] | None = None
) -> Figures:
    """Each kind of failure in seeded corridors, at a random time while the robot moves fast.

    Args:
        robot: name or URDF file.
        seeds: seeds of corridors, noise and times.
        step: called after each trial.
        kinds: kinds of `KINDS`; all where None.
    """
    rows = []
    for kind in kinds or KINDS:
        for seed in seeds:
            step(f"{kind}, seed {seed}")
            rows.append(_trial(robot, kind, int(seed)))
    summary = {}
    for kind in kinds or KINDS:
        mine = [row for row in rows if row["disturbance"] == kind]
        stops = [row["seconds_to_rest"] for row in mine if row["seconds_to_rest"] is not None]
        summary[kind] = {
            "count": len(mine),
            "reached": float(np.mean([row["reached"] for row in mine])),
            "contacts_at_speed": sum(row["contacts_at_speed"] for row in mine),
            "at_rest": float(np.mean([row["at_rest"] for row in mine])),
            "longest_to_rest_s": max(stops, default=None),
            "named": float(np.mean([bool(row["faults_named"]) for row in mine])),
        }
    return head("trials", robot=robot, kinds=summary, rows=rows)


@dataclass(slots=True)
class _Drive:
    """What is seen of a drive.

    Attributes:
        truth: the robot's true states.
        begin: when it failed, as the trial is about [s]; None where it did not.
        first: number of the state then.
        stands: when the robot stood after that [s].
        said: faults, whether the goal is reached and the executor's process, as the planner has told at its end.
        rows: what the log has.
    """

    truth: list[TrueState] = field(default_factory=list)
    begin: float | None = None
    first: int = 0
    stands: float | None = None
    said: object = None
    rows: list[dict[str, object]] = field(default_factory=list)

    @property
    def metres_to_rest(self) -> float | None:
        """How far the robot went until it stood [m]."""
        if self.stands is None:
            return None
        xy = np.array([state.coordinates[:2] for state in self.truth[self.first :] if state.time <= self.stands])
        return float(np.hypot(*np.diff(xy, axis=0).T).sum())

    @property
    def log_age(self) -> float | None:
        """How old the log's last entry was as the robot failed [s]."""
        before = [t for t in (float(str(row["t"])) for row in self.rows) if self.begin is not None and t <= self.begin]
        return self.begin - before[-1] if before and self.begin is not None else None


def _trial(name: str, kind: str, seed: int) -> Figures:
    robot = load_robot(name)
    scenario = _scenario(kind, seed)
    drive = _driven(name, robot, robot.space.to_coordinates(scenario.ends(robot)[0]), kind, seed)
    faults, reached, born = drive.said if isinstance(drive.said, tuple) else ([], False, None)
    truth, begin = drive.truth, drive.begin
    times = np.array([state.time for state in truth])
    evaluation = evaluate(
        [times, np.array([s.coordinates for s in truth]), np.array([s.v for s in truth])], robot, scenario.world
    )
    named = [str(row["reason"]) for row in drive.rows if row.get("event") == "fault"] + faults
    return {
        "disturbance": kind,
        "seed": seed,
        "at_s": begin,
        "seconds_to_rest": None if begin is None or drive.stands is None else drive.stands - begin,
        "metres_to_rest": drive.metres_to_rest,
        "at_rest": bool(np.abs(truth[-1].v).max() < 0.01),
        "reached": bool(reached),
        "contacts_at_speed": len(evaluation.collisions),
        "contacts_at_rest": len(evaluation.rest_contacts),
        "log_age_s": drive.log_age,
        "faults_named": list(dict.fromkeys(named)),
        "started": born is not None or bool(drive.rows) or begin is not None,
    }


def _scenario(kind: str, seed: int) -> Scenario:
    return get_scenario("moving-corridor" if kind.startswith("scene") else "corridor", seed=seed)


def _delay(seed: int) -> float:
    """Time [s] from when the robot is fast, or may be wrong, until it fails."""
    return float(np.random.default_rng(seed).uniform(0.0, 5.0))


def _faults(kind: str, seed: int) -> list[Fault]:
    """What is measured or seen wrongly, and when."""
    return [Fault(kind, _WRONG_FROM + _delay(seed), _WRONG[kind])] if kind in _WRONG else []


def _driven(name: str, robot: RobotModel, start: Array, kind: str, seed: int) -> _Drive:
    """One drive, by a planner's process of its own."""
    delay = _delay(seed)
    drive = _Drive()
    with tempfile.TemporaryDirectory(prefix="elastic-strips-") as folder:
        log = Path("/dev/full") if kind == "disk_full" else Path(folder) / "log.jsonl"
        make: Callable[[], Plant] = partial(KinematicPlant, robot, MotionLimits.for_robot(robot), MACHINE, seed=seed)
        if kind in _WRONG:
            make = partial(faulty_plant, make, FaultPlan(_faults(kind, seed)), seed)
        here, there = multiprocessing.Pipe()
        with MachineProcess(make, start, paused=True) as machine:
            planner = multiprocessing.get_context("spawn").Process(
                target=_plan, args=(machine.driver(), name, kind, seed, str(log), there)
            )
            planner.start()
            there.close()
            try:
                _watch(drive, machine, planner.pid or 0, kind, delay, here)
            finally:
                with suppress(OSError):
                    os.kill(planner.pid or 0, signal.SIGCONT)
                drive.said = here.recv() if here.poll(0.0) and planner.is_alive() else None
                end_process(planner, 20.0)
            if drive.said is None:
                with suppress(EOFError, OSError):
                    drive.said = here.recv() if here.poll(0.0) else None
        drive.truth += machine.truth()
        with suppress(RecordError):
            drive.rows = read_log(log)
    return drive


def _watch(drive: _Drive, machine: MachineProcess, planner: int, kind: str, delay: float, told: Connection) -> None:
    """Follow a drive, and do what the trial is about while the robot is fast, ``delay`` [s] after it first was."""
    if not told.poll(120.0):
        return
    executor, epoch = told.recv()
    machine.begin(epoch)
    moved = np.inf
    while machine.now < _DRIVE_TIME_LIMIT and machine.alive:
        time.sleep(0.005)
        new = machine.truth()
        drive.truth += new
        fast = any(abs(state.v[0]) > _FAST_SPEED for state in new)
        if fast and moved == np.inf:
            moved = machine.now
        if drive.begin is None and fast and machine.now > moved + delay:
            drive.begin, drive.first = machine.now, len(drive.truth) - 1
            _inject(kind, planner, executor, told)
        if drive.begin is not None and drive.stands is None:
            still = (s.time for s in new if s.time > drive.begin and np.abs(s.v).max() < _REST_SPEED)
            drive.stands = next(still, None)
        if _is_over(drive, kind in _GO_ON, machine, told):
            break


def _is_over(drive: _Drive, goes_on: bool, machine: MachineProcess, told: Connection) -> bool:
    """Whether the planner has come to an end, or has failed so that the robot only comes to rest, and that has."""
    if drive.begin is None or goes_on:
        return told.poll(0.0)
    return drive.stands is not None or machine.now > drive.begin + _LONGEST_STOPPING


def _inject(kind: str, planner: int, executor: int, told: Connection) -> None:
    if kind in ("planner_killed", "parent_killed"):
        os.kill(planner, signal.SIGKILL)
    elif kind == "executor_killed":
        os.kill(executor, signal.SIGKILL)
    elif kind == "planner_stopped":
        os.kill(planner, signal.SIGSTOP)
        time.sleep(_PLANNER_STOP)
        os.kill(planner, signal.SIGCONT)
    elif kind == "planner_hung":
        told.send("hang")


def _plan(driver: MachineDriver, name: str, kind: str, seed: int, log: str, owner: Connection) -> None:
    """The planner's process: drives the corridor, and tells what was named and whether it is there."""
    faults = _faults(kind, seed)
    driven = make_realtime(_scenario(kind, seed), robot=load_robot(name), seed=seed, log=log, faults=faults)
    controller, executor = driven.controller, driven.executor
    with executor, controller:
        executor.start(driver)
        if kind == "parent_killed":
            _hold_open()
        controller.warm_up()
        epoch = time.monotonic() + 0.1
        owner.send((executor.pid, epoch))
        executor.begin(epoch)
        time.sleep(0.1)
        while not controller.ended and executor.now < _DRIVE_TIME_LIMIT and controller.state is not RunState.FAILED:
            t = executor.now
            sensed, trouble = sensed_by(driven.perception, t)
            controller.plan(t, sensed, trouble=trouble)  # type: ignore[arg-type]
            if owner.poll(0.0):
                owner.recv()
                time.sleep(_PLANNER_HANG)
            time.sleep(max(0.0, t + 0.05 - executor.now))
        named = [event.reason for event in controller.events if event.kind == "fault"]
        owner.send((named, controller.state is RunState.REACHED, executor.pid))


def _hold_open() -> None:
    """A process that has the executor's channel open, too, and outlives this one for a while."""
    if os.fork() == 0:
        time.sleep(_DRIVE_TIME_LIMIT)
        os._exit(0)
