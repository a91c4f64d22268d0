"""A disk that is full is a typed error about the file, whatever writes it, and leaves nothing behind."""

from __future__ import annotations

import errno
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from cases import each, refused

import elastic_strips as es
from elastic_strips.control import Recorder
from elastic_strips.errors import InputError
from elastic_strips.files import atomic_write, write_json
from elastic_strips.io import write_bag, write_path, write_record, write_scene
from elastic_strips.io.trajectory_file import write_trajectory
from elastic_strips.scene import Box, Scene, World
from elastic_strips.trajectory import retime
from elastic_strips.viewer import Viewer

resource = pytest.importorskip("resource")


@contextmanager
def _little_room(most: int = 200) -> Iterator[None]:
    """No file of this process, nor of one that it starts, gets more than so many bytes: what the system says of it is
    what it says of a full disk, by another number."""
    before, wrote = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, before[1]))
    sys.dont_write_bytecode = True  # half a module's would be believed later
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = wrote


@pytest.fixture(scope="module")
def trajectory(silvermate):
    rows = [silvermate.home(x, 0.0, 0.0) for x in np.arange(0, 2.1, 0.1)]
    return retime(es.Strip(silvermate, rows))


@pytest.fixture(scope="module")
def record():
    robot = es.load_robot("jackal-box")
    recorder = Recorder(robot, World(Scene([Box((1, 1, 1), at=(0, 3, 0.5), name="table")])))
    for k in range(50):
        row = np.array([0.01 * k, 0.0, 0.0])
        recorder.control(0.01 * k, coordinates=row, v=0 * row, reference=row)
    return recorder.finish()


def _many() -> Scene:
    return Scene([Box((1, 1, 1), at=(0, k, 0.5), name=f"box {k}") for k in range(30)])


def _page(path: Path, strip: es.Strip) -> None:
    with Viewer(server=False) as viewer:
        viewer.show(strip.robot, _many(), strip).save_html(path)


def _proof(path: Path, robot: es.RobotModel) -> None:
    rows = robot.space.to_coordinates(np.array([robot.home(x=x) for x in (0.0, 0.2)]))
    proof = es.collision.prove(
        robot, Scene([Box((1, 1, 1), at=(0, 9, 0.5))]), rows, clearance=0.05, self_clearance=0.005
    )
    assert proof is not None
    proof.save(path)


WRITERS: dict[str, Callable[..., object]] = {
    "t.npz": lambda path, t, r: write_trajectory(path, t),
    "t.csv": lambda path, t, r: write_trajectory(path, t),
    "t.json": lambda path, t, r: write_trajectory(path, t),
    "p.csv": lambda path, t, r: write_path(path, t.robot, t.strip().q),
    "p.json": lambda path, t, r: write_path(path, t.robot, t.strip().q),
    "r.npz": lambda path, t, r: write_record(r, path),
    "r.csv": lambda path, t, r: write_record(r, path),
    "s.yaml": lambda path, t, r: write_scene(_many(), path),
    "d.json": lambda path, t, r: write_json(path, {"rows": list(range(1000))}),
    "x.bin": lambda path, t, r: atomic_write(path, bytes(10_000)),
    "page.html": lambda path, t, r: _page(path, t.strip()),
    "proof.npz": lambda path, t, r: _proof(path, t.robot),
    "b.mcap": lambda path, t, r: (pytest.importorskip("rosbags"), write_bag(path, t)),
}


@each("there", [False, True], ids=["new", "there before"])
@each("name", WRITERS)
def test_nothing_is_left_of_a_file_that_found_no_room(tmp_path, monkeypatch, trajectory, record, name, there):
    target, scratch = tmp_path / "out" / name, tmp_path / "scratch"
    target.parent.mkdir()
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    if there:
        target.write_bytes(b"of before")
    with pytest.raises(InputError, match=name), _little_room():
        WRITERS[name](target, trajectory, record)
    assert list(target.parent.iterdir()) == ([target] if there else [])
    assert list(scratch.iterdir()) == []
    if there:
        assert target.read_bytes() == b"of before"
    WRITERS[name](target, trajectory, record)  # it was the room
    assert target.stat().st_size > 200


@each("when", ["open", "write", "close"])
def test_a_bag_that_finds_the_disk_full(tmp_path, monkeypatch, trajectory, when):
    """As rosbags meets it, at any moment."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(rosbag2.Writer, when, full)
    with refused(InputError, "b.mcap"):
        write_bag(tmp_path / "b.mcap", trajectory)
    assert list(tmp_path.iterdir()) == []
