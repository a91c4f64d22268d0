"""The machine process: a plant against the wall clock, seen through its driver; sums are checked, not times."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import TypeVar

import machine_user
import numpy as np
import pytest
from cases import refused

from elastic_strips.control.driver import COMMAND_TIMEOUT, Driver
from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.errors import ParameterError
from elastic_strips.robot import RobotModel
from elastic_strips.sim.faults import Fault, FaultPlan
from elastic_strips.sim.machine_process import MachineDriver, MachineProcess, TrueState, faulty_plant
from elastic_strips.sim.plant import KinematicPlant, OdometryParams, PlantParams
from elastic_strips.trajectory import MotionLimits

EXACT = replace(PlantParams(), slip=0.0, slip_noise=0.0, jitter=0.0, odometry=OdometryParams.ideal())
_Value = TypeVar("_Value")


def plant_of(robot: RobotModel, *faults: Fault) -> Callable[[], KinematicPlant]:
    make = partial(KinematicPlant, robot, MotionLimits.for_robot(robot), EXACT)
    return partial(faulty_plant, make, FaultPlan(faults)) if faults else make  # type: ignore[return-value]


def start_of(robot: RobotModel):
    return robot.space.to_coordinates(robot.home_q)


@pytest.fixture(scope="module")
def machine(jackal_box) -> Iterator[MachineProcess]:
    with MachineProcess(plant_of(jackal_box), start_of(jackal_box)) as machine:
        yield machine


@pytest.fixture
def driver(machine: MachineProcess) -> Iterator[MachineDriver]:
    driver = machine.driver()
    rows(machine, stands)
    until(lambda: driver.measure(machine.now))
    yield driver
    driver.close()


def until(found: Callable[[], _Value | None], seconds: float = 60.0) -> _Value:
    end = time.monotonic() + seconds
    while True:
        value = found()
        if value:
            return value
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.005)


def drive(machine: MachineProcess, driver: Driver, speed: float, until_true: Callable[[], object]) -> None:
    """Command a speed of both wheels until something is true."""

    def send() -> object:
        driver.send(machine.now, Command(np.full(2, speed), np.zeros(0)))
        return until_true()

    until(send)


def rows(machine: MachineProcess, enough: Callable[[list[TrueState]], object]) -> list[TrueState]:
    """True states until there are enough."""
    found: list[TrueState] = []

    def more() -> object:
        found.extend(machine.truth())
        return enough(found)

    until(more)
    return found


def moving(machine: MachineProcess) -> Callable[[], bool]:
    return lambda: any(state.motors.min() > 0.2 for state in machine.truth())


def stands(states: list[TrueState]) -> bool:
    return bool(states) and not states[-1].motors.any()


def test_it_drives_as_commanded_and_stands_after_the_timeout(machine: MachineProcess, driver: MachineDriver):
    drive(machine, driver, 0.3, moving(machine))
    states = rows(machine, stands)
    assert not states[-1].commanded
    last = max((s.time for s in states if s.commanded), default=0.0)
    slow = next(s.time for s in states if abs(s.motors).max() < 0.02)
    assert slow - last < 0.5  # by the machine's own clock
    assert np.allclose(np.diff([s.time for s in states]), machine.period)  # it follows the clock, step by step


def test_the_timeout_counts_from_the_command(machine: MachineProcess, driver: MachineDriver):
    for _ in range(30):
        driver.send(machine.now - 2.0 * COMMAND_TIMEOUT, Command(np.full(2, 0.3), np.zeros(0)))
        time.sleep(0.01)
    states = rows(machine, lambda found: len(found) > 40)
    assert not states[-1].commanded
    assert not any(s.motors.any() for s in states)


def measured_until(machine: MachineProcess, driver: MachineDriver, time: float) -> list[Measurement]:
    """What a driver measures, up to a pose that is newer than a time [s]."""
    got: list[Measurement] = []

    def newest() -> bool:
        measured = driver.measure(machine.now)
        if measured is not None:
            got.append(measured)
        return bool(got) and (got[-1].pose_time or 0.0) > time

    until(newest)
    return got


def test_a_reader_that_was_stopped_gets_the_sums_right(machine: MachineProcess, driver: MachineDriver):
    begin = rows(machine, stands)[-1]
    measured_until(machine, driver, begin.time)  # what was driven before
    drive(machine, driver, 0.3, lambda end=machine.now + 1.0: machine.now > end)  # it reads nothing meanwhile
    end = rows(machine, stands)[-1]
    got = measured_until(machine, driver, end.time)
    travel = sum(np.mean(m.drive) for m in got)
    assert travel == pytest.approx(np.linalg.norm(end.coordinates[:2] - begin.coordinates[:2]), abs=1e-6)
    assert travel > 0.1
    fixes = [m for m in got if m.pose is not None]
    assert fixes
    assert np.allclose(fixes[-1].pose, end.coordinates[:3], atol=1e-6)
    times = [m.pose_time for m in fixes]
    assert times == sorted(set(times)), "a fix comes once"


def test_a_stop_is_obeyed_whatever_the_speeds_say(machine: MachineProcess, driver: MachineDriver):
    drive(machine, driver, 0.3, moving(machine))
    braked: list[TrueState] = []

    def stop() -> bool:
        driver.send(machine.now, Command(np.full(2, 0.3), np.zeros(0), stop=True))
        braked.extend(machine.truth())
        return stands(braked)

    until(stop)


def test_contact_and_emergency_stop_are_felt(machine: MachineProcess, driver: MachineDriver):
    machine.touch("bumper")
    assert until(lambda: (m := driver.measure(machine.now)) and m.contact) == "bumper"
    machine.touch("")
    until(lambda: (m := driver.measure(machine.now)) and not m.contact)
    drive(machine, driver, 0.3, moving(machine))
    machine.press("red button")
    states: list[TrueState] = []

    def stopped() -> bool:
        states.extend(machine.truth())
        return stands(states)

    drive(machine, driver, 0.3, stopped)  # it stops without its driver
    assert until(lambda: (m := driver.measure(machine.now)) and m.emergency) == "red button"
    machine.press("")
    drive(machine, driver, 0.3, moving(machine))


def test_no_wrong_command_is_passed_on(machine: MachineProcess, driver: MachineDriver):
    for wrong in ([0.1, np.nan], [0.1], [0.1, np.inf]):
        with refused(ParameterError, "speeds"):
            driver.send(machine.now, Command(np.array(wrong), np.zeros(0)))


def test_a_killed_executor_leaves_a_robot_that_stops(machine: MachineProcess):
    process = multiprocessing.get_context("spawn").Process(
        target=machine_user.execute, args=(machine.driver(), machine.epoch), daemon=True
    )
    process.start()
    try:
        until(moving(machine))
    finally:
        process.kill()
    process.join(60.0)
    machine.truth()
    rows(machine, stands)


def test_two_machines_at_once_and_an_end(silvermate: RobotModel, machine: MachineProcess, driver: MachineDriver):
    first = silvermate.space.base_nv
    with MachineProcess(plant_of(silvermate), start_of(silvermate), period=0.01) as other:
        arm = other.driver()
        rates = np.zeros(silvermate.nv - first)
        rates[0] = 0.2

        def turned() -> bool:
            arm.send(other.now, Command(np.zeros(2), rates))
            return any(s.v[first] > 0.15 for s in other.truth())

        drive(machine, driver, 0.1, turned)
        moved = until(lambda: arm.measure(other.now))
        assert moved.joints.shape == rates.shape
        assert moved.joints[0] > start_of(silvermate)[first]
    assert not other.alive
    assert abs(other.truth()[-1].v).max() < 1e-2, "it comes to rest before it ends"
    arm.send(1.0, Command(np.zeros(2), rates))
    until(lambda: arm.measure(1.0) is None)
    arm.close()
    assert machine.alive


def test_faults_come_through(jackal_box: RobotModel):
    faults = [Fault(kind, 0.0, 1e6) for kind in ("nan_odometry", "localization_lost")]
    with MachineProcess(plant_of(jackal_box, *faults), start_of(jackal_box)) as machine:
        driver = machine.driver()
        measured = until(lambda: (m := driver.measure(machine.now)) and m.drive is not None and m)
        measured = until(lambda: driver.measure(machine.now))
        assert np.isnan(measured.drive).all()
        assert measured.pose is None


def test_a_sensor_that_throws_throws_in_the_driver(jackal_box: RobotModel):
    with MachineProcess(plant_of(jackal_box, Fault("driver_exception", 0.0, 1e6)), start_of(jackal_box)) as machine:
        driver = machine.driver()
        with pytest.raises(RuntimeError):
            until(lambda: driver.measure(machine.now))


def test_a_plant_that_cannot_be_made_is_named(jackal_box: RobotModel, silvermate: RobotModel):
    wrong = partial(KinematicPlant, jackal_box, MotionLimits.for_robot(silvermate))
    with refused(ParameterError, "limits"), MachineProcess(wrong, np.zeros(3)):
        pass
    with refused(ParameterError, "start"), MachineProcess(lambda: wrong(), np.zeros(3)):
        pass


def test_it_ends_where_its_parent_is_gone(jackal_box: RobotModel):
    here, there = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(
        target=machine_user.own, args=(plant_of(jackal_box), start_of(jackal_box), there)
    )
    process.start()
    there.close()
    pid = here.recv() if here.poll(120.0) else 0
    process.kill()
    process.join(60.0)
    assert pid

    def ended() -> bool:
        try:
            with open(f"/proc/{pid}/stat") as stat:
                return stat.read().rpartition(")")[2].split()[0] == "Z"
        except FileNotFoundError:
            return True

    until(ended)
