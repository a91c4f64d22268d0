"""Server: a process of its own that sends the newest picture to every browser that connects, on the loopback only.

``ServerProcess`` runs this file as a script. The process knows neither robots nor scenes and needs no port besides the
browser's: page and commands arrive on standard input, and when that ends, because the parent closed it or died, the
process ends. An address that names another program's picture (``?id=``) is not answered with this one's.

A frame on standard input is a header (length of the key, length of the payload), the key and the payload. Key ``page``
carries the HTML; an empty key ends a batch; any other one is a command (see ``commands``).

Dragging in a page comes back as lines of JSON on standard output (see ``drag``). One page holds something at a time:
others that grab meanwhile are told so. A page of another origin is refused. No foreign page may show this one in a
frame, under which users would drag things that they do not see; a notebook of this machine may, by the address that
only this program knows.
"""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import json
import os
import secrets
import select
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable
from typing import IO, TYPE_CHECKING, BinaryIO, Protocol

if TYPE_CHECKING:
    from tornado.httputil import HTTPServerRequest
    from tornado.web import RequestHandler

Command = tuple[str, bytes]  # key, payload

_HEADER = struct.Struct(">IQ")
_HOST = "127.0.0.1"
_FIRST_PORT, _PORTS = 7000, 100  # so many are tried
_LONGEST_SERVER_START, _LONGEST_SEND = 20.0, 10  # longest waits [s]
_LONGEST_MESSAGE = 4096  # bytes of what a page says
_NOTEBOOKS = "'self' http://localhost:* http://127.0.0.1:* https://localhost:* https://127.0.0.1:* vscode-webview:"
"""Origins that may frame the page: those of notebooks on this machine."""


class CommandLog:
    """The commands that a picture consists of, without those that later ones made superfluous."""

    def __init__(self, *, deletions: bool = False) -> None:
        """Start empty.

        Args:
            deletions: Keep deletions as well: wanted when the receiver already has an older picture.
        """
        self._items: dict[str, bytes] = {}
        self._deletions = deletions

    def __len__(self) -> int:
        return len(self._items)

    def put(self, key: str, payload: bytes) -> None:
        """Add a command."""
        path, _, kind = key.partition("\0")
        if kind == "delete":
            for old in [k for k in self._items if k.split("\0")[0] == path or k.startswith(path + "/")]:
                del self._items[old]
            if not self._deletions:
                return
        elif kind == "object":
            self._items.pop(path + "\0instances", None)
        elif kind == "animation":  # after the objects that it moves
            self._items.pop(key, None)
        self._items[key] = payload

    def extend(self, items: Iterable[Command]) -> None:
        """Add many commands."""
        for key, payload in items:
            self.put(key, payload)

    def items(self) -> list[Command]:
        """Return keys and payloads in the order in which they have to be executed."""
        return list(self._items.items())

    def batch(self) -> bytes:
        """Return everything as one MessagePack array."""
        return b"\xdd" + struct.pack(">I", len(self._items)) + b"".join(self._items.values())

    def take(self) -> bytes:
        """Return everything as one MessagePack array, and start empty again."""
        data = self.batch()
        self._items.clear()
        return data


class ServerError(RuntimeError):
    """The server could not be started, or is gone."""


class ServerProcess:
    """A running server process; used by one thread, except for ``alive`` and ``close``."""

    def __init__(self, *, port: int | None, page: str, heard: Callable[[bytes], None]) -> None:
        """Start the server and give it the page.

        Args:
            port: Port on 127.0.0.1; None takes a free one.
            page: HTML.
            heard: called with each line that a page sends, in a thread of its own.

        Raises:
            ServerError: It does not start, or the port is taken.
        """
        self.id: str = secrets.token_hex(4)
        ours, theirs = socket.socketpair()
        # Writes block in the kernel, without the interpreter's lock; one that waits too long fails.
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("ll", _LONGEST_SEND, 0))
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
        self._socket = ours
        try:
            self._process = subprocess.Popen(
                [sys.executable, __file__, str(port or 0), self.id],
                stdin=theirs.fileno(),
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C in a terminal or a notebook is not for the server
                bufsize=0,
            )
        except OSError as error:
            ours.close()
            raise ServerError(f"the server process does not start: {error}") from error
        finally:
            theirs.close()
        atexit.register(self.close)
        answer = self._process.stdout
        assert answer is not None
        ready, _, _ = select.select([answer], [], [], _LONGEST_SERVER_START)
        name, _, value = (answer.readline().decode().strip() if ready else "").partition("=")
        if name != "url":
            self.close()
            raise ServerError(f"the server does not start: {value or 'no answer'}")
        self.url = value
        self._ear = threading.Thread(target=_hear, args=(answer, heard), name="elastic-strips pages", daemon=True)
        self._ear.start()
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
            ServerError: The server is gone or does not read.
        """
        chunks = []
        for key, payload in commands:
            name = key.encode()
            chunks += [_HEADER.pack(len(name), len(payload)), name, payload]
        chunks.append(_HEADER.pack(0, 0))
        try:
            self._socket.sendall(b"".join(chunks))
        except BlockingIOError:
            raise ServerError(f"the server has not read for {_LONGEST_SEND} s") from None
        except OSError as error:
            raise ServerError(f"the server process is gone: {error}") from error

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
        ear = getattr(self, "_ear", None)
        if ear is not None and ear is not threading.current_thread():
            ear.join(2.0)
        if process.stdout is not None and (ear is None or not ear.is_alive()):
            process.stdout.close()


def _hear(stream: IO[bytes], heard: Callable[[bytes], None]) -> None:
    """Read lines until the process ends."""
    for line in iter(stream.readline, b""):
        heard(line)


# What the process runs


def _read(stream: BinaryIO, size: int) -> bytes:
    data = stream.read(size)
    if len(data) < size:
        raise EOFError
    return data


class _Page(Protocol):
    """A page in a browser: what it has not got yet, and a way to send it."""

    pending: CommandLog

    def push(self) -> None: ...


class _Picture:
    """What the pages show, which pages there are, and which of them holds something."""

    def __init__(self) -> None:
        self.page: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        self.log = CommandLog()
        self.clients: set[_Page] = set()
        self.holder: _Page | None = None

    def receive(self, frames: list[Command]) -> None:
        """Take a batch from the parent, and send it to every page."""
        for key, payload in frames:
            if key == "page":
                self.page.set_result(payload)
                continue
            self.log.put(key, payload)
            for client in self.clients:
                client.pending.put(key, payload)
        for client in self.clients:
            client.push()

    def heard(self, client: _Page, message: str | bytes) -> bool:
        """Tell the parent what a page says; False where it grabs something, or steers, while another one does."""
        try:
            line = json.loads(message)
            kind = line["type"]
        except (LookupError, TypeError, ValueError, RecursionError):
            return True
        if kind == "steer" and self.holder in (None, client):
            self.holder = client if any(line.get(name) for name in ("forward", "left", "turn")) else None
            _say(json.dumps(line))
            return True
        if kind == "grab" and self.holder is None:
            self.holder = client
        if self.holder is not client:
            return kind not in ("grab", "steer")
        if kind == "release":
            self.holder = None
        _say(json.dumps(line))
        return True

    def left(self, client: _Page) -> None:
        """Forget a page, which lets go of what it holds."""
        self.clients.discard(client)
        if self.holder is client:
            self.holder = None
            _say(json.dumps({"type": "release"}))


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def _local(request: HTTPServerRequest) -> bool:
    """Refuse requests to a foreign name that was made to point here."""
    return request.host.rsplit(":", 1)[0] in (_HOST, "localhost")


def _page_handler(picture: _Picture, own: str) -> type[RequestHandler]:
    """Answers with the page."""
    import tornado.web

    class Page(tornado.web.RequestHandler):
        def set_default_headers(self) -> None:
            self.set_header("Content-Security-Policy", "frame-ancestors 'none'")
            self.set_header("X-Frame-Options", "DENY")
            self.set_header("X-Content-Type-Options", "nosniff")

        async def get(self) -> None:
            if not _local(self.request):
                raise tornado.web.HTTPError(403)
            self.set_header("Cache-Control", "no-store")
            named = self.get_query_argument("id", "")
            if named:
                self.set_header("Content-Security-Policy", f"frame-ancestors {_NOTEBOOKS}")
                self.clear_header("X-Frame-Options")  # it knows no ports
            if named not in ("", own):  # a notebook's, of a program before this one
                self.set_status(404)
                self.finish("This live picture has ended: run its cell again.")
                return
            self.write(await picture.page)

    return Page


def _socket_handler(picture: _Picture) -> type[RequestHandler]:
    """Sends commands to a page, and hears what it says."""
    import tornado.web
    import tornado.websocket

    class Client(tornado.websocket.WebSocketHandler):
        pending: CommandLog
        task: asyncio.Future[None] | None = None
        refusal: asyncio.Future[None] | None = None
        sending = False

        def prepare(self) -> None:
            if not _local(self.request):
                raise tornado.web.HTTPError(403)

        def open(self, *_: str, **__: str) -> None:
            self.set_nodelay(True)
            self.pending = CommandLog(deletions=True)
            self.pending.extend(picture.log.items())
            picture.clients.add(self)
            self.push()

        def on_close(self) -> None:
            picture.left(self)

        def on_message(self, message: str | bytes) -> None:
            if not picture.heard(self, message):
                self.refusal = asyncio.ensure_future(self.refuse())

        async def refuse(self) -> None:
            with contextlib.suppress(tornado.websocket.WebSocketClosedError):
                await self.write_message("another page holds something")

        def push(self) -> None:
            if not self.sending and len(self.pending):
                self.sending = True
                self.task = asyncio.ensure_future(self.drain())

        async def drain(self) -> None:
            try:
                while len(self.pending):
                    await self.write_message(self.pending.take(), binary=True)
            except tornado.websocket.WebSocketClosedError:
                picture.clients.discard(self)
            finally:
                self.sending = False

    return Client


def _pump(loop: asyncio.AbstractEventLoop, receive: Callable[[list[Command]], None]) -> None:
    """Read batches from standard input until it ends, and with it the process."""
    stream = sys.stdin.buffer
    frames: list[Command] = []
    try:
        while True:
            key_size, size = _HEADER.unpack(_read(stream, _HEADER.size))
            name, payload = _read(stream, key_size).decode(), _read(stream, size)
            if name:
                frames.append((name, payload))
            else:
                loop.call_soon_threadsafe(receive, frames)
                frames = []
    finally:
        os._exit(0)


def _bound(port: int) -> list[socket.socket]:
    """Sockets at a port, or at the first free one where it is 0; the process ends where there is none."""
    import tornado.netutil

    problem: OSError | None = None
    for candidate in [port] if port else [*range(_FIRST_PORT, _FIRST_PORT + _PORTS), 0]:
        try:
            return tornado.netutil.bind_sockets(candidate, _HOST)
        except OSError as error:
            problem = error
    _say(f"error={problem}")
    os._exit(1)


async def _serve(port: int, own: str) -> None:
    """Serve until standard input ends."""
    import tornado.httpserver
    import tornado.web

    picture = _Picture()
    app = tornado.web.Application(
        [("/", _page_handler(picture, own)), ("/ws", _socket_handler(picture))],
        log_function=lambda _: None,
        websocket_max_message_size=_LONGEST_MESSAGE,
    )
    server = tornado.httpserver.HTTPServer(app)
    sockets = _bound(port)
    server.add_sockets(sockets)
    _say(f"url=http://{_HOST}:{sockets[0].getsockname()[1]}/")
    threading.Thread(target=_pump, args=(asyncio.get_running_loop(), picture.receive), daemon=True).start()
    parent = os.getppid()
    while os.getppid() == parent:  # a sibling may hold our standard input open
        await asyncio.sleep(1.0)
    os._exit(0)


if __name__ == "__main__":
    sys.path.pop(0)  # the modules next to this file are no top-level modules
    asyncio.run(_serve(int(sys.argv[1]), sys.argv[2]))
