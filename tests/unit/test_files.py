"""Files: regular ones up to their bound are read, whatever else stands at a path is one typed error, at once; and
files are written whole or not at all, whatever comes between."""

from __future__ import annotations

import errno
import os
import re
import socket
import stat
import tempfile
from pathlib import Path
from typing import Any

import pytest
from cases import each, refused

from elastic_strips import files
from elastic_strips.errors import InputError, SceneError
from elastic_strips.files import atomic_write, check_input, check_writable, read_input, read_input_text


def read(path: Path | str, limit: int = 100) -> bytes:
    return read_input(path, "map", limit, SceneError)


def test_a_file_and_a_link_to_one_are_read(tmp_path):
    (tmp_path / "a").write_bytes(b"\xef\xbb\xbfone")
    (tmp_path / "b").symlink_to("a")
    assert read(tmp_path / "b") == b"\xef\xbb\xbfone"
    assert read_input_text(tmp_path / "b", "map", 6, SceneError) == "one"
    assert check_input(tmp_path / "b", "map", 6, SceneError) == 6


def test_what_is_no_regular_file_is_named(tmp_path, monkeypatch):
    """None of them is opened for reading, which might never end."""
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "folder").mkdir()
    (tmp_path / "endless").symlink_to("/dev/zero")
    (tmp_path / "circle").symlink_to("circle")
    monkeypatch.chdir(tmp_path)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("socket")
        for name, said in (
            ("fifo", "fifo: is a FIFO, not a map"),
            ("folder", "folder: is a folder, not a map"),
            ("endless", "endless: is a device, not a map"),
            ("socket", "socket: is a socket, not a map"),
            ("circle", "circle: cannot read the map: Too many levels of symbolic links"),
            ("gone", "gone: cannot read the map: No such file"),
            ("a\0b", "cannot read the map: .*embedded null"),
            ("a\nb", r"a\\nb: cannot read the map: No such file"),
            (7, "7: cannot read the map: "),
        ):
            with pytest.raises(SceneError, match=said):
                read(name)


def test_a_file_that_may_be_meant_is_named(tmp_path):
    (tmp_path / "kitchen.yaml").write_text("x")
    with pytest.raises(SceneError, match="kitchen"):
        read(tmp_path / "kichen.yaml")
    with pytest.raises(SceneError) as caught:
        read(tmp_path / "hall.yaml")
    assert "kitchen" not in str(caught.value)


def test_a_fifo_that_takes_the_files_place_does_not_hang(tmp_path, monkeypatch):
    """The file is looked at again once it is open."""
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "file").write_text("x")
    regular = os.stat(tmp_path / "file")
    monkeypatch.setattr(files.os, "stat", lambda path: regular)
    with refused(SceneError, "FIFO"):
        read(tmp_path / "fifo")


def test_the_size_is_bounded_also_where_it_is_not_stated(tmp_path):
    (tmp_path / "a").write_bytes(b"x" * 101)
    with refused(SceneError, "101", "100"):
        read(tmp_path / "a")
    if Path("/proc/self/status").is_file():  # says that it has 0 bytes
        with refused(SceneError, "100"):
            read("/proc/self/status")


def test_text_that_is_not_utf8_is_refused_with_its_place(tmp_path):
    (tmp_path / "a").write_bytes(b"a: 1\nname: caf\xe9\n")
    with refused(SceneError, "map", "0xe9", "14"):
        read_input_text(tmp_path / "a", "map", 100, SceneError)


def test_a_file_without_permission(tmp_path, monkeypatch):
    (tmp_path / "a").write_text("x")

    def deny(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(files.os, "open", deny)  # root may read everything
    with refused(SceneError, "Permission denied"):
        read(tmp_path / "a")


def _raise(error: BaseException) -> Any:
    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


def test_a_file_keeps_its_mode(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    assert atomic_write(target, b"one") == target
    assert stat.S_IMODE(target.stat().st_mode) == 0o644
    target.chmod(0o600)
    atomic_write(target, b"two")
    assert stat.S_IMODE(target.stat().st_mode) == 0o600
    assert target.read_bytes() == b"two"


@each("place", [(os, "replace"), (os, "fsync"), (tempfile, "mkstemp")])
@each(
    "error, raised, message",
    [
        (OSError(28, "No space left on device"), InputError, "cannot write: No space left"),
        (OSError("something else"), InputError, "cannot write: something else"),
        (KeyboardInterrupt(), KeyboardInterrupt, None),
    ],
)
def test_nothing_is_left_of_a_file_that_could_not_be_written(
    place: tuple[Any, str], error: BaseException, raised: type[BaseException], message: str | None, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    target = tmp_path / "a.txt"
    target.write_bytes(b"old")
    monkeypatch.setattr(*place, _raise(error))
    with pytest.raises(raised, match=message):
        atomic_write(target, b"new")
    assert target.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.txt"]


def _names_of_one_file(tmp_path):
    """A file that was read, and all the names that lead to it."""
    source = tmp_path / "in" / "scene.yaml"
    source.parent.mkdir()
    source.write_text("of the user")
    (tmp_path / "link.yaml").symlink_to(source)
    (tmp_path / "further.yaml").symlink_to("link.yaml")
    os.link(source, tmp_path / "hard.yaml")
    (tmp_path / "folder").symlink_to("in")
    names = [
        source, tmp_path / "in" / ".." / "in" / "scene.yaml", tmp_path / "link.yaml", tmp_path / "further.yaml",
        tmp_path / "hard.yaml", tmp_path / "folder" / "scene.yaml", Path(os.path.relpath(source)),
    ]  # fmt: skip
    return source, names


def test_a_command_overwrites_nothing_that_it_has_read_by_whatever_name(tmp_path):
    source, names = _names_of_one_file(tmp_path)
    for used in (source, tmp_path / "further.yaml", tmp_path / "hard.yaml"):
        with files.command_files():
            read(used)
            for name in names:
                for write in (check_writable, lambda target: atomic_write(target, b"of the program")):
                    with pytest.raises(InputError, match=re.escape(str(name))):
                        write(name)
            atomic_write(tmp_path / "out.json", b"1")
    assert source.read_text() == (tmp_path / "hard.yaml").read_text() == "of the user"
    assert (tmp_path / "link.yaml").is_symlink()


def test_what_a_command_has_written_it_may_read_and_write_again(tmp_path):
    target = tmp_path / "table.csv"
    target.write_bytes(b"0")
    with files.command_files():
        for k in range(3):
            atomic_write(check_writable(target), b"%d" % k)
            assert read(target) == b"%d" % k
    assert read(target) == b"2"


def test_a_library_s_user_may_write_what_he_has_read(tmp_path):
    target = tmp_path / "scene.yaml"
    target.write_bytes(b"0")
    with files.command_files():
        read(target)
        with files.command_files():
            read(target)
        with pytest.raises(InputError):
            atomic_write(target, b"1")
    read(target)
    assert atomic_write(target, b"1").read_bytes() == b"1"


def test_files_that_others_read_by_name_count(tmp_path):
    target = tmp_path / "colours.mtl"
    target.write_bytes(b"0")
    with files.command_files():
        files.note_input(target)
        files.note_input(tmp_path / "gone")
        with pytest.raises(InputError):
            check_writable(target)


@each("number", [errno.ENOSPC, errno.EDQUOT, errno.EIO])
def test_a_scratch_folder_without_room_is_the_files_error(tmp_path, number):
    kept = []

    def write() -> None:
        with files.scratch_folder(tmp_path / "film.mp4") as folder:
            kept.append(folder)
            (folder / "half").write_bytes(b"0")
            raise OSError(number, os.strerror(number))

    with refused(InputError, "film.mp4"):
        write()
    assert not kept[0].exists()
    assert list(tmp_path.iterdir()) == []
