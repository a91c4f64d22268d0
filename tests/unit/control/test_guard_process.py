"""Guard process: a pilot's commands are driven as far as the scenes allow that come from the process that made it."""

from __future__ import annotations

import pickle
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from pretend import Machine, Piloted

from elastic_strips.control.guard import GuardParams
from elastic_strips.control.interfaces import RunState
from elastic_strips.control.process import guard_process
from elastic_strips.control.process.channel import put
from elastic_strips.control.process.guard_process import GuardProcess
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Scene, Voxels

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


def test_what_has_come_is_not_sent_again(jackal_box: RobotModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A map of many boxes that stands in every scene; and a scene that was lost is made up for by the next."""
    rng = np.random.default_rng(1)
    cells = Voxels(0.1 * rng.integers(0, 60, (500, 3)) + (4.0, 0.0, 0.05), (0.1, 0.1, 0.1), name="map")
    sizes: list[int] = []

    def sent(link: object, message: object) -> bool:
        if isinstance(message, tuple) and message[0] == "scene":
            sizes.append(len(pickle.dumps(message)))
            if len(sizes) in (3, 4):
                return True  # and lost
        return put(link, message)  # type: ignore[arg-type]

    monkeypatch.setattr(guard_process, "put", sent)
    with GuardProcess(jackal_box, jackal_box.home(), GuardParams()) as guard:
        guard.start(Piloted(jackal_box, tmp_path / "closed", fixes=True))
        guard.begin(time.monotonic())
        until(lambda: guard.see(Scene([cells, WALL], time=guard.now)))
        until(lambda: guard._status.scene == 1)
        for k in range(2, 12):
            thing = Box((0.1, 0.1, 0.1), at=(3.0, 0.1 * k, 0.5), name=f"thing-{k}")
            assert guard.see(Scene([cells, WALL, thing], time=guard.now))
            if k not in (3, 4):
                until(lambda k=k: guard._status.scene == k)
        until(lambda: guard.see(Scene([cells, WALL], time=guard.now)) and guard.reference(0.0).v[0] > 0.1)
    assert max(sizes[1:]) < 0.1 * sizes[0]
    assert not any("a message of the planner" in event.reason for event in guard.run.events)
