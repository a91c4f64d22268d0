"""Executor process: whatever planning, driver or disk do, the robot comes to rest, and what was told says why."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pretend
import pytest
from pretend import Machine, certificate_of, set_off, straight

from elastic_strips.control.interfaces import RunState
from elastic_strips.control.process import executor_process
from elastic_strips.control.process.channel import ChannelClosedError, channel, put, take
from elastic_strips.control.process.executor_process import ExecutorProcess
from elastic_strips.control.process.log_stream import read_log
from elastic_strips.errors import ConfigurationError
from elastic_strips.robot import RobotModel

FAR = 6.0  # [m]


def until(true: Callable[[], object], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.01)


def ended(pid: int) -> bool:
    """Whether a process is over; one that nobody waits for stays as a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def says(executor: ExecutorProcess, text: str) -> bool:
    return any(text in event.reason for event in list(executor.run.events))


def stands(executor: ExecutorProcess) -> bool:
    return executor.run.state is RunState.STOPPED and executor.settled


@contextmanager
def started(robot: RobotModel, machine: Machine, log: Path | str) -> Iterator[ExecutorProcess]:
    with ExecutorProcess(robot, robot.home(), robot.home(x=FAR), log=log) as executor:
        executor.start(machine)
        executor.begin(time.monotonic())
        yield executor
    assert ended(executor.pid)


@pytest.fixture
def machine(jackal_box: RobotModel, tmp_path: Path) -> Machine:
    return Machine(jackal_box, tmp_path / "closed", fixes=True)


@pytest.fixture
def executor(jackal_box: RobotModel, machine: Machine, tmp_path: Path) -> Iterator[ExecutorProcess]:
    with started(jackal_box, machine, tmp_path / "log.jsonl") as executor:
        yield executor
    assert machine.ended.exists()


def test_it_follows_what_it_is_given_and_refuses_garbage(executor: ExecutorProcess, tmp_path: Path):
    motion = straight(executor.robot, FAR, 1e6)
    samples = (motion.time, motion.coordinates, motion.v, motion.a)
    good, nan = certificate_of(motion), np.full_like(motion.v, np.nan)
    for garbage in (
        "nonsense", ("fly",), ("submit",), ("submit", 1, samples[:2], good, True, 0.02, False),
        ("submit", 2, (motion.time, nan, motion.v, motion.a), good, True, 0.02, False),
        ("submit", 3, (motion.time, motion.coordinates[:, :2], motion.v, motion.a), good, True, 0.02, False),
        ("submit", 4, samples, "a certificate", True, 0.02, False), ("submit", 5, samples, good, True, np.nan, False),
        ("anchor", 6, nan), ("hold", 1, "why", -1.0), ("retarget", [1.0], executor.params.tolerance), ("retarget", nan),
        ("brake",),
    ):  # fmt: skip
        put(executor._link, garbage)
    executor._link.send(b"no pickle")
    until(lambda: says(executor, "a message of the planner: "))
    set_off(executor, FAR)
    executor.brake("enough")
    until(lambda: stands(executor))
    assert executor.run.stops[-1][1] == "enough"
    rows = read_log(tmp_path / "log.jsonl")
    reasons = [str(row["reason"]) for row in rows if "event" in row]
    for word in ("'fly'", "certificate", "proven", "goal", "not enough values"):
        assert any("a message of the planner" in reason and word in reason for reason in reasons), (word, reasons)
    assert all("took" in row for row in rows if "event" not in row)


def test_silence_of_planning_brakes_and_it_is_heard_again(
    executor: ExecutorProcess, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    set_off(executor, FAR)
    with monkeypatch.context() as silent:
        silent.setattr(executor_process, "put", lambda *_: True)
        until(lambda: stands(executor))
    assert says(executor, "from the planner")
    until(lambda: says(executor, "the planner is heard again"))
    rows = read_log(tmp_path / "log.jsonl")
    brakes = next(row for row in rows if "from the planner" in str(row.get("reason")))
    assert float(executor.estimate[0]) < FAR - 0.5
    assert float(str(brakes["t"])) < float(str(rows[-1]["t"]))
    set_off(executor, FAR)


def test_a_failing_driver_is_named_and_outlived(jackal_box: RobotModel, machine: Machine, tmp_path: Path):
    machine.wrong = {"measure": (1.0, 20), "nan": (4.0, 20), "send": (4.5, 20)}
    with started(jackal_box, machine, tmp_path / "log.jsonl") as executor:
        set_off(executor, FAR)
        until(lambda: executor.recoveries > 0)
        until(lambda: says(executor, "no answer from the motors"))
        assert says(executor, "driver exception: OSError: no answer from the wheels")
        until(lambda: says(executor, "no usable measurement"))
        until(lambda: not executor.waits)
        set_off(executor, FAR)
    assert machine.ended.exists()


def test_a_full_disk_is_named_and_the_drive_goes_on(jackal_box: RobotModel, machine: Machine):
    with started(jackal_box, machine, "/dev/full") as executor:
        set_off(executor, FAR)
        until(lambda: says(executor, "cannot be written: No space left"))
        told = executor.reference(0.0).time
        until(lambda: executor.reference(0.0).time > told + 0.5)
    assert machine.ended.exists()


@pytest.mark.parametrize("stopped", [False, True])
def test_a_killed_planner_leaves_a_robot_at_rest(
    jackal_box: RobotModel, machine: Machine, tmp_path: Path, stopped: bool
):
    log = tmp_path / "log.jsonl"
    here, there = multiprocessing.Pipe()
    planner = multiprocessing.get_context("spawn").Process(
        target=pretend.plan, args=(jackal_box, machine, log, there)
    )  # no daemon, which has no children
    planner.start()
    there.close()
    assert here.poll(120.0)
    pid = here.recv()

    def rows() -> list[dict[str, object]]:
        return [row for row in read_log(log) if "event" not in row]

    try:
        until(lambda: any(row["reference_v"][0] > 0.4 for row in rows()))  # type: ignore[index]
        if stopped:
            os.kill(planner.pid or 0, signal.SIGSTOP)
            until(lambda: rows()[-1]["reference_v"][0] == 0.0)  # type: ignore[index]
            os.kill(planner.pid or 0, signal.SIGCONT)
            until(lambda: any(row.get("reason") == "the planner is heard again" for row in read_log(log)))
    finally:
        planner.kill()
        planner.join()
    until(lambda: ended(pid))
    assert machine.ended.exists()
    reasons = [str(row.get("reason")) for row in read_log(log)]
    assert "the planner's process is gone" in reasons
    if stopped:  # a busy machine may be silent for a while otherwise, too
        assert any("from the planner" in reason for reason in reasons)
    assert rows()[-1]["reference_v"] == [0.0, 0.0, 0.0]
    assert rows()[-1]["drive"] == [0.0, 0.0]


def test_a_killed_executor_is_named(jackal_box: RobotModel, machine: Machine, tmp_path: Path):
    with started(jackal_box, machine, tmp_path / "log.jsonl") as executor:
        set_off(executor, FAR)
        os.kill(executor.pid, signal.SIGKILL)
        until(lambda: executor.run.state is RunState.FAILED)
        assert executor.waits == executor.run.reason == "the executor's process is gone"
        executor.stop("asked to stop")
        assert executor.run.state is RunState.FAILED
    assert read_log(tmp_path / "log.jsonl")


def test_planning_that_hangs_is_named_and_refutes_no_motion(executor: ExecutorProcess):
    set_off(executor, FAR)
    executor.planned()  # and then no more, while its heartbeats go on
    until(lambda: says(executor, "the planner hangs"))
    executor.planned()
    until(lambda: says(executor, "plans again"))
    until(lambda: executor.run.state is RunState.REACHED or stands(executor))  # a machine's pauses may brake it
    brakes = [event.reason for event in executor.run.events if event.kind in ("braked", "state")]
    assert not any("hangs" in reason for reason in brakes), "nothing refuted its motion"


def test_one_that_died_before_it_began_is_named(jackal_box: RobotModel, machine: Machine, tmp_path: Path):
    with ExecutorProcess(jackal_box, jackal_box.home(), jackal_box.home(x=FAR)) as executor:
        executor.start(machine)
        os.kill(executor.pid, signal.SIGKILL)
        executor.begin(time.monotonic())
        until(lambda: executor.run.state is RunState.FAILED)


def test_asked_to_terminate_it_comes_to_rest(executor: ExecutorProcess, machine: Machine):
    set_off(executor, FAR)
    os.kill(executor.pid, signal.SIGINT)  # is for planning
    os.kill(executor.pid, signal.SIGTERM)
    until(machine.ended.exists)
    until(lambda: not executor.reference(0.0).v.any())


def test_what_does_not_start_says_why(jackal_box: RobotModel, tmp_path: Path):
    def process(log: Path | None = None) -> ExecutorProcess:
        return ExecutorProcess(jackal_box, jackal_box.home(), jackal_box.home(x=FAR), log=log)

    closed, before = tmp_path / "closed", multiprocessing.active_children()
    for executor, machine, why in (
        (process(), pretend.Unsendable(jackal_box, closed), "a serial port stays where it is"),
        (process(), pretend.Unmakeable(jackal_box, closed), "ended at once"),
        (process(tmp_path / "no" / "log"), Machine(jackal_box, closed), "cannot write the log"),
    ):
        with executor, pytest.raises(ConfigurationError, match=why):
            executor.start(machine)
    assert closed.exists(), "a driver that was received is closed"
    assert set(multiprocessing.active_children()) <= set(before)
    with process() as executor:
        pass


def test_a_channel_keeps_the_order_and_drops_what_does_not_fit():
    one, other = channel(1 << 14)
    sent = 0
    while put(one, (sent, b"x" * 500)):
        sent += 1
    assert sent > 0
    assert [message[0] for message in take(other)] == list(range(sent))  # type: ignore[index]
    put(one, "last")
    put(other, "unread")
    one.close()
    taken = take(other)
    assert next(taken) == "last", "what was sent before the end comes"
    with pytest.raises(ChannelClosedError):
        next(taken)
    assert not put(other, "nobody hears it")
    other.close()


def test_what_is_said_before_it_runs_is_heard(jackal_box: RobotModel, machine: Machine, tmp_path: Path):
    with ExecutorProcess(jackal_box, jackal_box.home(), jackal_box.home(x=FAR), log=tmp_path / "l.jsonl") as executor:
        executor.stop("Ctrl-C while it starts")
        executor.start(machine)
        executor.begin(time.monotonic())
        until(lambda: executor.waits == "Ctrl-C while it starts")


def test_a_program_that_starts_it_when_it_is_read_is_told_so(tmp_path: Path):
    """The process reads the program again, and would start another one: it ends at once, without its task read."""
    program = tmp_path / "program.py"
    program.write_text(
        "import elastic_strips as es\n"
        "from elastic_strips.control.process.executor_process import ExecutorProcess\n"
        "robot = es.load_robot('silvermate')\n"
        "ExecutorProcess(robot, robot.home(), robot.home(x=1.0)).start(None)\n"
    )
    source = str(Path(executor_process.__file__).parents[3])
    ended = subprocess.run(
        [sys.executable, str(program)], capture_output=True, text=True, timeout=100.0,
        env=os.environ | {"PYTHONPATH": source}, check=False,
    )  # fmt: skip
    assert ended.returncode == 1
    assert "it ended at once" in ended.stderr.splitlines()[-1]
    assert "__name__" in ended.stderr.splitlines()[-1]


def test_a_driver_is_opened_before_time_begins(jackal_box: RobotModel, tmp_path: Path):
    machine, log = pretend.Opened(jackal_box, tmp_path / "closed"), tmp_path / "log.jsonl"
    with ExecutorProcess(jackal_box, jackal_box.home(), jackal_box.home(x=FAR), log=log) as executor:
        executor.start(machine)
        assert (tmp_path / "closed.opened").exists()
        executor.begin(time.monotonic())
        until(lambda: executor._status.time > 0.05)
    assert machine.ended.exists()


def test_a_driver_that_cannot_be_opened_is_named(jackal_box: RobotModel, tmp_path: Path):
    machine = pretend.Opened(jackal_box, tmp_path / "closed")
    machine.missing = "no bus can0"
    with (
        ExecutorProcess(jackal_box, jackal_box.home(), jackal_box.home(x=FAR)) as executor,
        pytest.raises(ConfigurationError, match="can0"),
    ):
        executor.start(machine)
    assert machine.ended.exists()
