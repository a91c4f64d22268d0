"""Guard process: a pilot's commands are driven as far as the scenes allow that come from the process that made it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pretend import Machine, Piloted

from elastic_strips.control.guard import GuardParams
from elastic_strips.control.interfaces import RunState
from elastic_strips.control.process.guard_process import GuardProcess
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Scene

WALL = Box((0.2, 6.0, 1.5), at=(2.0, 0.0, 0.75), name="wall")


def until(true: Callable[[], object], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.01)


@contextmanager
def guarded(robot: RobotModel, machine: Machine) -> Iterator[tuple[GuardProcess, threading.Event]]:
    """A guard, and what ends that it sees."""
    blind, over = threading.Event(), threading.Event()

    def look(guard: GuardProcess) -> None:
        while not over.wait(0.03):
            if not blind.is_set():
                assert guard.see(Scene([WALL], time=guard.now))

    with GuardProcess(robot, robot.home(), GuardParams()) as guard:
        guard.start(machine)
        guard.begin(time.monotonic())
        thread = threading.Thread(target=look, args=(guard,))
        thread.start()
        try:
            yield guard, blind
        finally:
            over.set()
            thread.join()
    assert machine.ended.exists()


def test_a_pilot_is_stopped_before_a_wall(jackal_box: RobotModel, tmp_path: Path):
    with guarded(jackal_box, Piloted(jackal_box, tmp_path / "closed", fixes=True)) as (guard, _):
        until(lambda: guard.reference(0.0).v[0] > 0.4)
        until(lambda: guard.run.state is RunState.STOPPED and guard.settled)
        assert "wall" in guard.pilot
        assert 0.5 < guard.estimate[0] < 1.9
        assert any("another frame" in event.reason for event in guard.run.events), "what the driver left out"


def test_it_comes_to_rest_where_no_scene_comes_or_the_pilot_falls_silent(jackal_box: RobotModel, tmp_path: Path):
    machine = Piloted(jackal_box, tmp_path / "closed", fixes=True)
    with guarded(jackal_box, machine) as (guard, blind):
        until(lambda: guard.reference(0.0).v[0] > 0.3)
        blind.set()
        until(lambda: guard.run.state is RunState.STOPPED and guard.settled)
        assert "stale scene" in guard.run.reason
        blind.clear()
        until(lambda: guard.run.state is RunState.MOVING)
        guard.stop("enough")
        until(lambda: guard.run.state is RunState.STOPPED and guard.settled)
        assert guard.waits == "enough"
    machine.ends = 1.5
    machine.ended.unlink()
    with guarded(jackal_box, machine) as (guard, _):
        until(lambda: "the command is old" in guard.pilot)
        until(lambda: guard.settled)
