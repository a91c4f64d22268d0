"""Files are written whole or not at all, whatever comes between."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path
from typing import Any

import pytest

from elastic_strips.errors import InputError
from elastic_strips.io.files import write_whole


def _raise(error: BaseException) -> Any:
    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


def test_a_file_keeps_its_mode(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    assert write_whole(target, b"one") == target
    assert stat.S_IMODE(target.stat().st_mode) == 0o644
    target.chmod(0o600)
    write_whole(target, b"two")
    assert stat.S_IMODE(target.stat().st_mode) == 0o600
    assert target.read_bytes() == b"two"


@pytest.mark.parametrize("place", [(os, "replace"), (os, "fsync"), (tempfile, "mkstemp")])
@pytest.mark.parametrize(
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
        write_whole(target, b"new")
    assert target.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.txt"]
