"""IO room, files: whole files or none."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any

from elastic_strips.errors import InputError


def check_writable(path: str | os.PathLike[str]) -> Path:
    """The path, if a file can be made there.

    Raises:
        InputError: it is a folder, or its folder is missing or not writable.
    """
    try:
        target = Path(path)
        target.exists()  # a name that the system refuses fails here
    except (OSError, TypeError, ValueError) as error:
        raise InputError(f"{path!s:.80}: is no file name: {getattr(error, 'strerror', None) or error}") from None
    if not target.name:
        raise InputError(f"{str(path)!r}: is no file name")
    if target.is_dir():
        raise InputError(f"{target}: is a folder; give the name of a file")
    if target.exists() and not target.is_file():  # it would be replaced by a file
        raise InputError(f"{target}: is a device or a pipe; give the name of a file")
    folder = target.parent
    if not folder.is_dir():
        raise InputError(f"{target}: there is no folder {folder}")
    if not os.access(folder, os.W_OK):
        raise InputError(f"{target}: the folder {folder} is not writable")
    return target


def write_json(path: str | os.PathLike[str], document: Any) -> Path:
    """Write a document as JSON: the whole file or none (NaN and infinity are refused).

    Raises:
        InputError: the file cannot be written, or the document is no JSON.
    """
    target = check_writable(path)
    try:
        text = json.dumps(document, indent=1, allow_nan=False) + "\n"
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{target}: what is to be written is no JSON: {error}") from None
    return write_whole(target, text.encode())


def write_whole(target: Path, data: bytes) -> Path:
    """Write a file that :func:`check_writable` has passed: all of it or nothing. One that is there keeps its mode.

    Raises:
        InputError: the file cannot be written.
    """
    name = None
    try:
        mode = target.stat().st_mode & 0o777 if target.exists() else 0o644
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name[:100]}.", suffix=".part")
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())  # else a crash could leave the new name with nothing behind it
        os.chmod(name, mode)
        os.replace(name, target)
        name = None
    except OSError as error:
        raise InputError(f"{target}: cannot write: {error.strerror or error}") from None
    finally:
        if name is not None:
            Path(name).unlink(missing_ok=True)
    return target
