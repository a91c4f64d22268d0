"""Link: starts the server process and feeds it; every trouble with it is a LinkError, nothing blocks for long."""

from __future__ import annotations

import atexit
import select
import socket
import struct
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from elastic_strips.viewer.commands import Command
from elastic_strips.viewer.server import HEADER

_START, _SEND = 20.0, 10  # [s]


class LinkError(RuntimeError):
    """The server could not be started, or is gone."""


class Link:
    """A running server process; used by one thread, except for ``alive`` and ``close``."""

    def __init__(self, *, port: int | None, page: str) -> None:
        """Start the server and give it the page.

        Args:
            port: Port on 127.0.0.1; None takes a free one.
            page: HTML.

        Raises:
            LinkError: It does not start, or the port is taken.
        """
        script = Path(__file__).with_name("server.py")
        ours, theirs = socket.socketpair()
        # Writes block in the kernel, without the interpreter's lock; one that waits too long fails.
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("ll", _SEND, 0))
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
        self._socket = ours
        try:
            self._process = subprocess.Popen(
                [sys.executable, str(script), str(port or 0)],
                stdin=theirs.fileno(),
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C in a terminal or a notebook is not for the server
                bufsize=0,
            )
        except OSError as error:
            ours.close()
            raise LinkError(f"the server process does not start: {error}") from error
        finally:
            theirs.close()
        atexit.register(self.close)
        line = self._line()
        name, _, value = line.partition("=")
        if name != "url":
            self.close()
            raise LinkError(f"the server does not start: {value or 'no answer'}")
        self.url = value
        self.send([("page", page.encode())])

    @property
    def alive(self) -> bool:
        """Whether the server process runs."""
        return self._process.poll() is None

    @property
    def pid(self) -> int:
        """Process id of the server."""
        return self._process.pid

    def send(self, commands: Iterable[Command]) -> None:
        """Send one batch of commands.

        Raises:
            LinkError: The server is gone or does not read.
        """
        chunks = []
        for key, payload in commands:
            name = key.encode()
            chunks += [HEADER.pack(len(name), len(payload)), name, payload]
        chunks.append(HEADER.pack(0, 0))
        try:
            self._socket.sendall(b"".join(chunks))
        except BlockingIOError:
            raise LinkError(f"the server has not read for {_SEND} s") from None
        except OSError as error:
            raise LinkError(f"the server process is gone: {error}") from error

    def close(self) -> None:
        """End the server process."""
        atexit.unregister(self.close)
        process = self._process
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(2.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._socket.close()
        if process.stdout is not None:
            process.stdout.close()

    def _line(self) -> str:
        assert self._process.stdout is not None
        ready, _, _ = select.select([self._process.stdout], [], [], _START)
        return self._process.stdout.readline().decode().strip() if ready else ""
