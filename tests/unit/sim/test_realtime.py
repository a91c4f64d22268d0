"""Drives against the wall clock: a drive ends well, and comes to rest whatever dies; nothing is left behind."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from elastic_strips.control.interfaces import RunState
from elastic_strips.control.process.log_stream import read_log
from elastic_strips.errors import ConfigurationError, InputError, RobotError
from elastic_strips.io.scene_file import PoseSpec
from elastic_strips.robot import load_robot
from elastic_strips.scene import Box, Cylinder, Keyframes, PedestrianMotion, Scene, Sphere, World
from elastic_strips.scene.difference import with_difference
from elastic_strips.sim.faults import Fault, FaultPlan, FaultyPerception
from elastic_strips.sim.machine_process import TrueState
from elastic_strips.sim.pedestrians import Pedestrians
from elastic_strips.sim.perception import PerceptionError
from elastic_strips.sim.realtime import RealtimeSimulation
from elastic_strips.sim.scenarios import Scenario
from elastic_strips.sim.scenarios.drive import driven_to_its_end, make_realtime
from elastic_strips.sim.sensed_perception import SensorPerception
from elastic_strips.sim.sensing_process import SensedWorld, SensingProcess, _News, _Sensing
from elastic_strips.sim.sensors import SensorConfig
from elastic_strips.sim.sensors.params import named_sensors

FLOOR = Scenario("floor", "empty", Scene([]), PoseSpec(), PoseSpec(3.0), robot="jackal-box")
WALLED = Scenario(
    "walled", "empty", Scene([Box((4.0, 0.1, 0.8), at=(1.5, 1.2, 0.4))]), PoseSpec(), PoseSpec(3.0), robot="jackal-box"
)


@pytest.fixture
def laser() -> SensorConfig:
    return named_sensors("laser", "jackal-box")


@pytest.fixture(autouse=True)
def nothing_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    before = multiprocessing.active_children()
    yield
    assert set(multiprocessing.active_children()) <= set(before)
    assert list(tmp_path.glob("elastic-strips-*")) == []


def when_fast(act: Callable[[RealtimeSimulation], object]) -> Callable[[RealtimeSimulation], None]:
    """A watcher that does something once, when the robot moves."""
    done: list[bool] = []

    def watch(driven: RealtimeSimulation) -> None:
        if not done and driven.plant.v[0] > 0.3:
            done.append(True)
            act(driven)

    return watch


def named(driven: RealtimeSimulation, text: str) -> bool:
    return any(text in event.reason for event in driven.controller.events)


def test_a_drive_reaches_its_goal_and_is_recorded():
    driven = make_realtime(FLOOR)
    result = driven.run()
    assert result.reached
    assert result.compute == "realtime"
    rows = result.record.control
    assert np.abs(rows.coordinates[-1, 0] - 3.0) < 0.05
    assert np.nanmax(rows.v[:, 0]) > 0.3
    assert np.isfinite(rows.reference[rows.v[:, 0] > 0.3]).mean() > 0.5, "the log is found again in the record"
    assert np.abs(rows.v[-1]).max() < 0.01


def test_the_emergency_stop_is_obeyed(tmp_path: Path):
    pressed: list[bool] = []

    def press(driven: RealtimeSimulation) -> None:
        assert driven.machine is not None
        driven.machine.press("red button")
        pressed.append(True)

    fast = when_fast(press)

    def watch(driven: RealtimeSimulation) -> None:
        fast(driven)
        if pressed and np.abs(driven.plant.v).max() < 1e-3:
            driven.stop()

    result = make_realtime(FLOOR, watch=watch, log=tmp_path / "log").run()
    assert pressed
    assert not result.reached
    rows = result.record.control
    assert np.abs(rows.v[-1]).max() < 0.01
    assert rows.coordinates[-1, 0] < 2.0
    assert any("red button" in str(row.get("reason")) for row in read_log(tmp_path / "log"))


def test_a_killed_executor_leaves_a_machine_that_stops():
    driven = make_realtime(FLOOR, watch=when_fast(lambda driven: os.kill(driven.executor.pid, signal.SIGKILL)))
    result = driven.run()
    assert result.state is RunState.FAILED
    assert named(driven, "the executor's process is gone")
    rows = result.record.control
    assert rows.v[:, 0].max() > 0.3
    assert np.abs(rows.v[-1]).max() < 0.01
    assert rows.coordinates[-1, 0] < 2.5


def test_a_killed_machine_ends_the_drive():
    def kill(driven: RealtimeSimulation) -> None:
        assert driven.machine is not None
        os.kill(driven.machine.pid or 0, signal.SIGKILL)

    driven = make_realtime(FLOOR, watch=when_fast(kill))
    result = driven.run()
    assert not result.reached
    assert named(driven, "the machine's process is gone") or named(driven, "no usable measurement")


def test_a_log_that_cannot_be_read_costs_no_record():
    driven = make_realtime(FLOOR, log="/dev/full")
    result = driven.run()
    assert result.reached
    assert named(driven, "cannot be written")
    assert result.record.control.coordinates[-1, 0] > 2.9


def test_a_planner_that_throws_leaves_nothing_behind():
    def fail(t: float) -> None:
        raise KeyboardInterrupt

    driven = make_realtime(FLOOR)
    driven.perception.sense = fail  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        driven.run()


def test_a_robot_with_sensors_reaches_its_goal(laser: SensorConfig):
    driven = make_realtime(WALLED, sensors=laser)
    assert isinstance(driven.perception, SensingProcess)
    seen: list[Scene] = []

    def watch(driven: RealtimeSimulation) -> None:
        seen.append(driven.perception.sense(driven.time))

    driven.watch = watch  # type: ignore[assignment]
    outcome = driven_to_its_end(driven, WALLED, None)
    assert outcome.reached
    assert outcome.sensors == laser.names
    assert driven.perception.newest["laser"][0].time > 1.0
    assert driven.perception.looked_at["laser"] > 10
    walls = [o for o in seen[-1] if (o.name or "").startswith("map-")]
    assert walls, "what was sensed in the other process has come"
    before = {id(o) for scene in seen for o in scene}
    assert len(before) < sum(len(scene) for scene in seen) / 2, "what was there before is not sent again"


def test_a_robot_whose_sensors_are_killed_stops(laser: SensorConfig):
    driven = make_realtime(
        WALLED, sensors=laser, watch=when_fast(lambda driven: os.kill(driven.perception.pid, signal.SIGKILL))
    )
    result = driven.run(time_limit=6.0)
    assert not result.reached
    assert named(driven, "the process of the sensors is gone")
    rows = result.record.control
    assert rows.v[:, 0].max() > 0.3
    assert np.abs(rows.v[-1]).max() < 0.01
    assert rows.coordinates[-1, 0] < 2.5


def test_sensors_that_fail_say_why(laser: SensorConfig):
    robot = load_robot(WALLED.robot)
    start = robot.space.from_coordinates(np.zeros(robot.nv))
    sensing = SensingProcess(SensedWorld(robot, WALLED.world, start, laser, 0, FaultPlan()))
    other = np.zeros(robot.nv + 1)
    for k in range(20):
        with suppress(OSError):
            sensing.feed([TrueState(0.1 * k, other, other, np.zeros(2), True)], (0.1 * k, np.zeros(robot.nv)))
    sensing._listener.join(60.0)
    with pytest.raises(PerceptionError, match=r"\w+Error: "):
        sensing.sense(0.0)
    sensing.close()


def test_the_sensors_process_tells_what_is_of_glass(laser: SensorConfig):
    """The same that its sensors see through, for who judges a drive."""
    robot, faults = load_robot(WALLED.robot), FaultPlan([Fault("glass", 1.0, 1.0, 0.5)])
    world = World(Scene([Box((0.1, 0.1, 0.8), at=(3.0, 0.5 * k, 0.4), name=f"post-{k}") for k in range(-3, 3)]))
    start = robot.space.from_coordinates(np.zeros(robot.nv))
    inside = FaultyPerception(SensorPerception(robot, world, start, sensors=laser, seed=5), faults, 5)
    sensing = SensingProcess(SensedWorld(robot, world, start, laser, 5, faults))
    sensing.close()
    assert [len(sensing.glass(t)) for t in (0.5, 1.5, 2.5)] == [0, 3, 0]
    assert sensing.glass(1.5) == inside.glass(1.5)


def test_sensors_that_cannot_be_are_refused_as_they_are(laser: SensorConfig):
    lost = SensorConfig(sensors=tuple(replace(sensor, frame="nowhere") for sensor in laser.sensors))
    with pytest.raises(RobotError):
        make_realtime(WALLED, sensors=lost)


def test_what_cannot_be_made_leaves_nothing_behind(laser: SensorConfig):
    inside = replace(WALLED, scene=Scene([Box((1.0, 1.0, 0.8), at=(0.0, 0.0, 0.4))]))
    with pytest.raises(ConfigurationError):
        make_realtime(inside)
    with pytest.raises(InputError):
        make_realtime(WALLED, sensors=laser, watch=3)  # type: ignore[arg-type]


def test_a_scene_that_becomes_empty_is_told_so():
    """And what comes after it is told against that."""
    box, ball = Box((1.0, 1.0, 1.0), name="box"), Sphere(0.3, name="ball")
    scenes = [Scene([box]), Scene([ball, box]), Scene([]), Scene([ball]), Scene([box, ball])]
    told: list[tuple[object, ...]] = []

    class Sensed:
        contact, target = "", None
        newest: ClassVar[dict[str, object]] = {}
        looked_at: ClassVar[dict[str, int]] = {}

        def attend(self, ahead: object) -> None: ...

        def sense(self, t: float) -> Scene:
            return scenes[int(t)]

    news = SimpleNamespace(send=told.append)
    sensing = _Sensing(load_robot("jackal-box"), Sensed(), None, news)  # type: ignore[arg-type]
    known: Scene | None = None
    for k, scene in enumerate(scenes):
        sensing.tell(float(k))
        known = with_difference(known, _News(*told[-1]).scene)  # type: ignore[arg-type]
        assert known.names == scene.names


def test_people_are_where_the_machine_has_them():
    """The process of the sensors lets them go on by itself: from the same states, however these come to it."""
    robot = load_robot("jackal-box")
    ways = Keyframes([0.0, 6.0], [[3.0, 0.0, 0.85], [-3.0, 0.0, 0.85]])
    machines, other = (
        World(Scene([Cylinder(0.25, 1.7, name="walker", motion=PedestrianMotion(ways, 0.48))])) for _ in range(2)
    )
    people, seen = Pedestrians(robot, machines), Pedestrians(robot, other)
    perception = SimpleNamespace(contact="", attend=lambda _: None, measure=lambda *_: None)
    sensing = _Sensing(robot, perception, seen, SimpleNamespace())  # type: ignore[arg-type]
    rng, some, places = np.random.default_rng(0), [], []
    for k in range(500):
        t, v = 0.01 * k, np.zeros(robot.nv)
        v[0] = 0.5 if 250 < k < 320 else 0.0  # it stands, moves for a moment, and stands again
        row = np.full(robot.nv, 0.0)
        people.step(t, row, v)
        some.append(TrueState(t, row, v, np.zeros(2), True))
        if rng.random() < 0.2:
            sensing.hear(tuple(some), (t - 0.015, row), None)
            sensing.measure()
            some.clear()
            assert t - sensing.now[0] <= 0.025
            then, own = (world.at(sensing.now[0]).obstacle("walker").pose[0, 3] for world in (machines, other))
            assert own == pytest.approx(then, abs=1e-9)
            places.append(own)
    assert min(np.abs(np.diff(places))) < 1e-6, "it has waited"
    assert max(np.abs(np.diff(places))) > 0.005, "and gone"


def test_sensors_that_never_run_leave_nothing_behind(laser: SensorConfig):
    driven = make_realtime(WALLED, sensors=laser)
    driven.controller.close()
    assert any(child.name == "sensing" for child in multiprocessing.active_children())
    del driven
    gc.collect()


def test_one_that_never_runs_leaves_nothing_behind():
    driven = make_realtime(FLOOR)
    assert driven.log.exists()
    driven.controller.close()
    log = driven.log
    del driven
    gc.collect()
    assert not log.exists()
