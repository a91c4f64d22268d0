"""What killed processes have left of FastDDS is removed, and nothing of those that live, or of others."""

from __future__ import annotations

import fcntl
import mmap
import os
import time
from pathlib import Path

import pytest

from elastic_strips.ros2 import shared_memory
from elastic_strips.ros2.shared_memory import clear_left

DEAD = ("fastdds_0123456789abcdef", "fastdds_0123456789abcdef_el", "fastdds_port7001", "fastdds_port7001_el",
        "sem.fastdds_port7001_mutex", "fastdds_port7003", "sem.fastdds_port7003_mutex")  # fmt: skip
MAPPED = ("fastdds_port7004", "sem.fastdds_port7004_mutex")
LIVING = ("fastdds_fedcba9876543210", "fastdds_fedcba9876543210_el", "fastdds_port7000", "fastdds_port7000_sl",
          "sem.fastdds_port7000_mutex")  # fmt: skip
OTHERS = ("fastdds_notes_el", "something_el", "fastdds_port70000001_el")


def test_only_what_nobody_holds_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for name in (*DEAD, *LIVING, *MAPPED, *OTHERS):
        (tmp_path / name).write_bytes(bytes(16))
    assert clear_left(tmp_path) == 0, "they are new"
    later = time.time() + 60.0
    monkeypatch.setattr(shared_memory.time, "time", lambda: later)
    with (
        (tmp_path / LIVING[1]).open("rb") as own,
        (tmp_path / LIVING[3]).open("rb") as shared,
        (tmp_path / MAPPED[0]).open("r+b") as file,
        mmap.mmap(file.fileno(), 16),
    ):
        fcntl.flock(own, fcntl.LOCK_EX)
        fcntl.flock(shared, fcntl.LOCK_SH)
        assert clear_left(tmp_path) == 3
        assert set(os.listdir(tmp_path)) == {*LIVING, *MAPPED, *OTHERS}
    assert clear_left(tmp_path / "nothing") == 0


def test_what_somebody_else_removes_meanwhile_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / DEAD[0]).write_bytes(b"")
    monkeypatch.setattr(Path, "exists", lambda _: False)
    assert clear_left(tmp_path) == 0
