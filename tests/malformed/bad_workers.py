"""Workers that read nothing: in a file of their own, since a new process must be able to import them."""

from __future__ import annotations

import os
import time
from multiprocessing.connection import Connection


def sleeps(pipe: Connection, _: int, __: str | None) -> None:
    pipe.send({"ready": True})
    time.sleep(600.0)


def ends(pipe: Connection, _: int, __: str | None) -> None:
    pipe.send({"ready": True})
    pipe.recv()
    os._exit(3)
