"""Shared memory: what processes that were killed have left of FastDDS, which only removes its own where it ends."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

_FOLDER = Path("/dev/shm")
_PROCESSES = Path("/proc")
_FILE = re.compile(r"(?:sem\.)?(fastdds_(?:[0-9a-f]{16}|port\d{1,5}))(?:_[es]l|_mutex)?")
_NEW = 2.0  # [s] what is younger may belong to a process that is about to use it


def clear_left(folder: Path = _FOLDER) -> int:
    """Remove the segments and ports whose owner is dead: nobody holds the lock beside them; or, where that has gone,
    no process has them in its memory.

    Of the former ``fastdds shm clean`` does the same. Whoever lives may make the ports of the dead anew, to write to
    them, until it ends itself. What belongs to other users is left alone, and what is not FastDDS'.

    Returns:
        How many there were.
    """
    names = {found[1] for path in _entries(folder) if (found := _FILE.fullmatch(path.name)) is not None}
    if not names:
        return 0
    used = _used()
    return sum(_removed(folder, name, used=str(folder / name) in used) for name in sorted(names))


def _entries(folder: Path) -> Iterable[Path]:
    try:
        return list(folder.iterdir())
    except OSError:  # another system, with other files
        return ()


def _used() -> set[str]:
    """Paths of FastDDS' files that processes have in their memory, of those that may be looked at."""
    found: set[str] = set()
    for process in _PROCESSES.glob("[0-9]*"):
        with suppress(OSError):
            found.update(re.findall(r" (/\S*/fastdds_\w+)", (process / "maps").read_text(errors="replace")))
    return found


def _removed(folder: Path, name: str, *, used: bool) -> bool:
    """Whether something of this name was removed; whoever lives holds the lock of what it listens to."""
    import fcntl  # late: not every system has it

    files = [folder / each for each in (name, f"{name}_el", f"{name}_sl", f"sem.{name}_mutex")]
    files = [path for path in files if path.exists()]
    with suppress(OSError):
        if not files or time.time() - max(path.stat().st_ctime for path in files) < _NEW:
            return False
        locks = [os.open(path, os.O_RDONLY) for path in files if path.name.endswith(("_el", "_sl"))]
        try:
            if used and not locks:
                return False
            for lock in locks:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # an OSError where somebody lives
            for path in files:
                path.unlink(missing_ok=True)
            return True
        finally:
            for lock in locks:
                os.close(lock)
    return False
