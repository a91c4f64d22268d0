"""The log stream: what it writes, what survives a kill, and a disk that is full."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from cases import refused

from elastic_strips.control.process import log_stream
from elastic_strips.control.process.log_stream import LogStream, read_log
from elastic_strips.control.record import RecordError

_LOGS_UNTIL_KILLED = """
import sys, time
from elastic_strips.control.process.log_stream import LogStream
log = LogStream(sys.argv[1])
while True:
    log.row({"time": time.monotonic()})
    time.sleep(0.01)
"""


def wait_for(condition, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.02)


def test_rows_come_back(tmp_path: Path):
    speeds = np.array([0.12345678, np.nan, np.inf])
    with LogStream(tmp_path / "log") as log:
        log.row({"time": 0.1, "v": speeds, "n": np.int64(3), "in": {"why": "a — b", "x": [float("nan"), np.ones(2)]}})
        speeds[:] = 7.0  # it is written as it was
        log.row({"time": np.float64(0.2), "who": object})
    first, second = read_log(tmp_path / "log")
    assert first == {"time": 0.1, "v": [0.123457, None, None], "n": 3, "in": {"why": "a — b", "x": [None, [1.0, 1.0]]}}
    assert second == {"time": 0.2, "who": str(object)}
    assert log.trouble == ""
    assert log.lost == 0


def test_a_killed_process_leaves_its_log(tmp_path: Path):
    path = tmp_path / "log"
    process = subprocess.Popen([sys.executable, "-c", _LOGS_UNTIL_KILLED, str(path)])
    try:
        wait_for(lambda: path.exists() and path.stat().st_size > 2000)
        killed = time.monotonic()
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.wait(60.0)
    times = [float(str(row["time"])) for row in read_log(path)]
    assert times == sorted(times)
    assert len(times) > 10
    assert times[-1] > killed - 2.0


def test_a_torn_last_line_is_left_out_and_another_is_not(tmp_path: Path):
    path = tmp_path / "log"
    path.write_text('{"a":1}\n{"a":2}\n{"a":')
    assert read_log(path) == [{"a": 1}, {"a": 2}]
    path.write_text('{"a":1}\n{"a":\n{"a":3}\n')
    with refused(RecordError, "line 2"):
        read_log(path)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_raises_nothing_and_drops_the_oldest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(log_stream, "_RETRY_AFTER", 0.05)
    full = os.open("/dev/full", os.O_WRONLY)
    with LogStream(tmp_path / "log", capacity=10) as log:
        sound = os.dup(log._file)
        os.dup2(full, log._file)
        log.row({"n": 0})
        wait_for(lambda: "No space left" in log.trouble)
        for n in range(1, 31):
            log.row({"n": n})
        os.dup2(sound, log._file)  # there is space again
        wait_for(lambda: log.trouble == "20 rows are lost")
    assert [row["n"] for row in read_log(tmp_path / "log")] == [0, *range(21, 31)]
    assert log.trouble == "20 rows are lost"
    os.close(full)
    os.close(sound)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_what_is_never_written_is_counted():
    log = LogStream("/dev/full")
    for n in range(5):
        log.row({"n": n})
    log.close()
    assert log.lost == 5
    assert "No space left" in log.trouble


def test_a_value_that_cannot_be_shown_costs_one_row(tmp_path: Path):
    endless: list[object] = []
    endless.append(endless)
    with LogStream(tmp_path / "log") as log:
        log.row({"endless": endless})
        log.row({"n": 1})
    assert read_log(tmp_path / "log") == [{"n": 1}]
    assert log.lost == 1


def test_a_file_that_cannot_be_opened_is_named(tmp_path: Path):
    with refused(RecordError, "missing"):
        LogStream(tmp_path / "missing" / "log")
