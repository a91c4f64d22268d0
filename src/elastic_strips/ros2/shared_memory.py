"""Shared memory: what processes that were killed have left of FastDDS, which only removes its own where it ends."""

from __future__ import annotations

import os
import re
import time
from contextlib import suppress
from pathlib import Path

_FOLDER = Path("/dev/shm")
_LOCK = re.compile(r"(fastdds_(?:[0-9a-f]{16}|port\d{1,5}))_[es]l")
_NEW = 2.0  # [s] a lock that is younger may belong to a process that is about to take it


def clear_left(folder: Path = _FOLDER) -> int:
    """Remove the segments and ports whose owner is dead: whoever lives holds a lock on a file beside each.

    As ``fastdds shm clean`` does. What belongs to other users is left alone, and what is not FastDDS'.

    Returns:
        How many there were.
    """
    try:
        import fcntl
    except ImportError:  # another system, with other files
        return 0
    found = 0
    for lock in folder.glob("fastdds_*_[es]l") if folder.is_dir() else ():
        name = _LOCK.fullmatch(lock.name)
        if name is None:
            continue
        with suppress(OSError), lock.open("rb") as file:
            if time.time() - os.fstat(file.fileno()).st_ctime < _NEW:
                continue
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # an OSError where somebody lives
            for each in (name[1], f"sem.{name[1]}_mutex", lock.name):
                (folder / each).unlink(missing_ok=True)
            found += 1
    return found
