"""Server: a process of its own that hands the newest picture to every browser that asks, on the loopback only.

It is run as a script, knows neither robots nor scenes, and needs no port besides the browser's: pages and commands
arrive on standard input, and when that ends, because the parent closed it or died, the process ends.

A frame on standard input is a header (length of the key, length of the payload), the key and the payload. Key ``page``
carries the HTML; an empty key ends a batch; any other one is a command (see ``commands``).
"""

from __future__ import annotations

import asyncio
import os
import struct
import sys
import threading
from collections.abc import Iterable
from typing import Any, BinaryIO

HEADER = struct.Struct(">IQ")
HOST = "127.0.0.1"
FIRST_PORT, PORTS = 7000, 100


class Record:
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

    def extend(self, items: Iterable[tuple[str, bytes]]) -> None:
        """Add many commands."""
        for key, payload in items:
            self.put(key, payload)

    def items(self) -> list[tuple[str, bytes]]:
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


def _read(stream: BinaryIO, size: int) -> bytes:
    data = stream.read(size)
    if len(data) < size:
        raise EOFError
    return data


async def serve(port: int) -> None:
    """Serve until standard input ends."""
    import tornado.httpserver
    import tornado.netutil
    import tornado.web
    import tornado.websocket

    page: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
    record = Record()
    clients: set[Any] = set()

    def local(request: Any) -> bool:
        """Refuse requests that a foreign name was made to point here for."""
        return request.host.rsplit(":", 1)[0] in (HOST, "localhost")

    class Page(tornado.web.RequestHandler):
        async def get(self) -> None:
            if not local(self.request):
                raise tornado.web.HTTPError(403)
            self.set_header("Cache-Control", "no-store")
            self.write(await page)

    class Client(tornado.websocket.WebSocketHandler):
        pending: Record
        task: asyncio.Future[None] | None = None
        sending = False

        def prepare(self) -> None:
            if not local(self.request):
                raise tornado.web.HTTPError(403)

        def open(self, *_: str, **__: str) -> None:
            self.set_nodelay(True)
            self.pending = Record(deletions=True)
            self.pending.extend(record.items())
            clients.add(self)
            self.push()

        def on_close(self) -> None:
            clients.discard(self)

        def on_message(self, message: str | bytes) -> None:
            """Browsers have nothing to say."""

        def push(self) -> None:
            if not self.sending and len(self.pending):
                self.sending = True
                self.task = asyncio.ensure_future(self.drain())

        async def drain(self) -> None:
            try:
                while len(self.pending):
                    await self.write_message(self.pending.take(), binary=True)
            except tornado.websocket.WebSocketClosedError:
                clients.discard(self)
            finally:
                self.sending = False

    def receive(frames: list[tuple[str, bytes]]) -> None:
        for key, payload in frames:
            if key == "page":
                page.set_result(payload)
                continue
            record.put(key, payload)
            for client in clients:
                client.pending.put(key, payload)
        for client in clients:
            client.push()

    def pump(loop: asyncio.AbstractEventLoop) -> None:
        stream = sys.stdin.buffer
        frames: list[tuple[str, bytes]] = []
        try:
            while True:
                key_size, size = HEADER.unpack(_read(stream, HEADER.size))
                name, payload = _read(stream, key_size).decode(), _read(stream, size)
                if name:
                    frames.append((name, payload))
                else:
                    loop.call_soon_threadsafe(receive, frames)
                    frames = []
        finally:
            os._exit(0)

    app = tornado.web.Application([("/", Page), ("/ws", Client)], log_function=lambda _: None)
    server = tornado.httpserver.HTTPServer(app)
    wanted = [port] if port else [*range(FIRST_PORT, FIRST_PORT + PORTS), 0]
    sockets: list[Any] = []
    for candidate in wanted:
        try:
            sockets = tornado.netutil.bind_sockets(candidate, HOST)
            break
        except OSError as error:
            problem = error
    else:
        sys.stdout.write(f"error={problem}\n")
        sys.stdout.flush()
        os._exit(1)
    server.add_sockets(sockets)
    sys.stdout.write(f"url=http://{HOST}:{sockets[0].getsockname()[1]}/\n")
    sys.stdout.flush()
    threading.Thread(target=pump, args=(asyncio.get_running_loop(),), daemon=True).start()
    parent = os.getppid()
    while os.getppid() == parent:  # a sibling may hold our standard input open
        await asyncio.sleep(1.0)
    os._exit(0)


if __name__ == "__main__":
    sys.path.pop(0)  # the modules next to this file are no top-level modules
    asyncio.run(serve(int(sys.argv[1])))
