"""Computing in simulated time: what it costs, when results arrive, and that simulating the sensors costs nothing."""

from __future__ import annotations

from concurrent.futures import TimeoutError

import numpy as np
import pytest
from cases import each, refused

from elastic_strips.errors import ParameterError
from elastic_strips.planning.problem import Deadline
from elastic_strips.scene import Box, Scene, World
from elastic_strips.sim import computing
from elastic_strips.sim.computing import ChargedExecutor, Computing
from elastic_strips.sim.sensed_perception import SensorPerception
from elastic_strips.sim.sensors import SensorConfig
from elastic_strips.work import SECONDS_PER, Work, count_work, counted

PILLAR = Box((0.4, 0.4, 1.5), at=(1.5, 0.3, 0.75), name="pillar")


class Clock:
    """A clock that tests set; it stands for simulated time, or for the processor's."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    def compute(self, seconds: float, result: object = None) -> object:
        self.now += seconds
        return result


@pytest.fixture
def cpu(monkeypatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(computing, "thread_time", clock)
    return clock


@each("given, label", [("free", "free"), ("work", "work"), ("1", 1.0), (" 0.5 ", 0.5), (10, 10.0), (4.0, 4.0)])
def test_it_is_parsed(given, label):
    parsed = Computing.parse(given)
    assert parsed.label == label
    assert type(parsed.label) is type(label)
    assert Computing.parse(parsed.label) == parsed, "results keep the label"


@each("wrong", ["fre", "", "0", "-1", "nan", "inf", "1x", 0, -2.0, float("inf"), True, None, [1]])
def test_what_means_nothing_is_refused(wrong):
    with refused(ParameterError, "compute=", "'free'", "'work'"):
        Computing.parse(wrong)


def test_a_factor_charges_the_processor_time_of_this_thread(cpu):
    before = Computing(4.0).reading()
    cpu.compute(0.02)
    assert Computing(4.0).reading() - before == pytest.approx(0.08)


def test_a_real_thread_needs_time():
    before = Computing(1.0).reading()
    sum(range(200_000))
    assert Computing(1.0).reading() > before


def test_work_charges_what_is_counted_and_nothing_else(cpu):
    before = Computing("work").reading()
    cpu.compute(1.0)
    count_work(queries=10, cells=3)
    assert Computing("work").reading() - before == pytest.approx(Work(queries=10, cells=3).seconds)


def test_free_costs_nothing(cpu):
    cpu.compute(1.0)
    count_work(queries=10)
    assert Computing().reading() == 0.0


def test_results_arrive_one_after_the_other(cpu):
    clock = Clock()
    clock.now = 2.0
    core = ChargedExecutor(Computing(2.0), clock)
    one, two = core.submit(cpu.compute, 0.1, "one"), core.submit(cpu.compute, 0.05, "two")
    assert (one.due, two.due) == pytest.approx((2.2, 2.3))
    assert core.busy_until == two.due
    clock.now = 2.19
    assert not one.done()
    assert one.running()
    clock.now = one.due
    assert one.done()
    assert not one.running()
    assert one.result() == "one"
    assert not two.done()
    clock.now = 5.0
    assert two.result() == "two"
    assert core.submit(cpu.compute, 0.1).due == pytest.approx(5.2), "an idle core begins at once"


def test_a_result_is_not_to_be_had_before_it_arrives(cpu):
    future = ChargedExecutor(Computing(1.0), Clock()).submit(cpu.compute, 0.25)
    for ask in (future.result, future.exception):
        with refused(TimeoutError, "0.250", "0.000"):
            ask()
    assert not future.cancel()


def test_what_was_submitted_before_the_clock_was_set_arrives_by_that(cpu):
    """A controller may plan on as it is made, before there is a simulation."""
    workers = ChargedExecutor(Computing(1.0), lambda: 0.0)
    future = workers.submit(cpu.compute, 0.5)
    assert not future.done()
    workers.clock = lambda: 1.0
    assert future.done()


def test_exceptions_arrive_too(cpu):
    def fails() -> None:
        cpu.compute(0.1)
        raise RuntimeError("no path")

    clock = Clock()
    future = ChargedExecutor(Computing(1.0), clock).submit(fails)
    assert not future.done()
    clock.now = 1.0
    assert isinstance(future.exception(), RuntimeError)
    with refused(RuntimeError, "path"):
        future.result()


def test_free_results_are_there_at_once(cpu):
    clock = Clock()
    clock.now = 3.0
    core = ChargedExecutor(Computing("free"), clock)
    for _ in range(2):
        assert core.submit(cpu.compute, 1.0, "done").result() == "done"


@pytest.mark.parametrize("label, cost", [(2.0, 0.2), ("work", SECONDS_PER["batches"])])
def test_a_submitted_task_is_not_charged_to_who_submits_it(cpu, label, cost):
    def plan() -> None:
        cpu.compute(1.0)
        count_work(batches=7)

    priced = Computing(label)
    core = ChargedExecutor(priced, Clock())
    before = priced.reading()
    core.submit(plan)
    cpu.compute(0.1)
    count_work(batches=1)
    assert priced.reading() - before == pytest.approx(cost)


def test_a_task_of_a_task_is_charged_once(cpu):
    core = ChargedExecutor(Computing(1.0), Clock())

    def outer() -> None:
        core.submit(cpu.compute, 0.2)
        cpu.compute(0.1)

    assert core.submit(outer).due == pytest.approx(0.3)


def look(robot, label: str, *, casting: int = 0) -> tuple[float, Work]:
    """Cost of the scene after half a second of readings, whose simulation is so much work more, and all the work."""
    world, laser = World(Scene([PILLAR])), SensorConfig().only("laser")
    priced = Computing.parse(label)
    sensed = SensorPerception(robot, world, robot.home(), sensors=laser, computing=priced)
    sensed.known()
    before, row, observe = counted(), robot.space.to_coordinates(robot.home()), sensed.suite.observe

    def cast(t: float, coordinates: np.ndarray):
        count_work(checks=casting)
        return observe(t, coordinates)

    sensed.suite.observe = cast
    for t in np.arange(0.0, 0.5, 0.01).tolist():
        sensed.observe(t, row, row)
    sensed.sense(0.5)
    cost, work = sensed.cost, counted() - before
    sensed.sense(0.5)
    assert sensed.cost == 0.0, "the same scene again costs nothing"
    return cost, work


def test_processing_readings_is_charged_and_simulating_sensors_is_not(silvermate):
    cost, work = look(silvermate, "work")
    same, more = look(silvermate, "work", casting=1000)
    assert more.checks > work.checks
    assert cost == pytest.approx(same)
    assert cost >= SECONDS_PER["rays"] * work.rays > 0.0


def test_processing_is_free_where_computing_is(silvermate):
    assert look(silvermate, "free")[0] == 0.0


def test_limits_of_time_are_limits_of_work_where_work_is_what_computing_costs():
    """A plan that a busy machine ended early would lead elsewhere than on an idle one."""

    def search() -> tuple[bool, bool]:
        deadline = Deadline(0.5)
        idle = deadline.over()
        count_work(batches=1000)
        return idle, deadline.over()

    def measured() -> bool:
        return Deadline(1.0).of_work

    clock = Clock()
    found = ChargedExecutor(Computing("work"), clock).submit(search)
    timed = ChargedExecutor(Computing(1.0), clock).submit(measured)
    clock.now = 1e3
    assert found.result() == (False, True)
    assert timed.result() is False
    assert not measured()
