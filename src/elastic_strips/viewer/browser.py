"""Browser: a Chromium without a window, which draws the viewer's pages for pictures and films."""

from __future__ import annotations

import asyncio
import base64
import json
import os
import shutil
import subprocess
import tempfile
import threading
import time
import urllib.request
from collections.abc import Coroutine
from pathlib import Path
from typing import Literal, TypeVar

from elastic_strips.arrays import Document
from elastic_strips.errors import ElasticStripsError

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--no-first-run",
    "--remote-debugging-port=0",
    "--remote-allow-origins=*",
)
_READY = """document.body !== null && document.readyState === "complete"
  && (!document.getElementById("meshcat-pane") || document.body.dataset.ready === "yes")"""
_LONGEST_BROWSER_START = 60.0  # [s]
_T = TypeVar("_T")


class BrowserError(ElasticStripsError):
    """There is no Chromium, it does not start, or it has ended; the input is not the cause."""


def find_browser() -> str | None:
    """Path of a Chromium: the environment's ``CHROMIUM``, or the first one on the path."""
    return next(filter(None, (shutil.which(name) for name in (os.environ.get("CHROMIUM", ""), *NAMES) if name)), None)


def need_browser() -> str:
    """Path of a Chromium.

    Raises:
        BrowserError: there is none.
    """
    path = find_browser()
    if path is None:
        raise BrowserError("there is no Chromium to draw with; on Debian: apt-get install chromium")
    return path


class Browser:
    """One page in a Chromium without a window; a context manager, used by one thread.

    Attributes:
        errors: errors that the page reported.
    """

    def __init__(self, *, size: tuple[int, int] = (1280, 720), patience: float = 60.0) -> None:
        """Start it.

        Args:
            size: width and height of the page, in pixels.
            patience: longest wait for a page or an answer [s].

        Raises:
            BrowserError: there is none, or it does not start.
        """
        self.errors: list[str] = []
        self._patience, self._number, self._pressed = patience, 0, False
        path = need_browser()
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        flags = [f"--window-size={size[0]},{size[1]}", f"--user-data-dir={self._profile.name}"]
        self._process = subprocess.Popen(
            [path, *_FLAGS, *flags, "about:blank"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self._loop = asyncio.new_event_loop()  # of its own: a notebook's runs already
        self._thread = threading.Thread(target=self._loop.run_forever, name="elastic-strips browser", daemon=True)
        self._thread.start()
        try:
            self._wait(self._connect(size))
        except BaseException:
            self.close()
            raise

    def open(self, page: str | os.PathLike[str], *, fine: bool = True) -> None:
        """Open an HTML file or an address, and wait until its picture is there.

        Args:
            page: the file or address to open.
            fine: whether it is drawn as with a graphics card, however long that takes.
        """
        address = os.fspath(page)
        if not address.startswith(("http://", "https://", "file://")):
            address = Path(address).resolve().as_uri()
        self._wait(self._open(address + ("#fine" if fine else "")))

    def evaluate(self, script: str) -> object:
        """The value of a JavaScript expression, or of its promise."""
        return self._wait(self._evaluate(script))

    def mouse(self, kind: Literal["press", "move", "release"], x: float, y: float) -> None:
        """Press, move or let go the left button at a place in the page [pixels]."""
        names = {"press": "mousePressed", "move": "mouseMoved", "release": "mouseReleased"}
        held = {"press": 1, "move": int(self._pressed), "release": 0}[kind]
        self._pressed = held == 1
        button = "none" if kind == "move" and not held else "left"
        self._wait(
            self._call(
                "Input.dispatchMouseEvent", type=names[kind], x=x, y=y, button=button, buttons=held, clickCount=1
            )
        )

    def picture(self) -> bytes:
        """The page as it looks now: a PNG."""
        answer = self._wait(self._call("Page.captureScreenshot", format="png"))
        return base64.b64decode(str(answer["data"]))

    def close(self) -> None:
        """End the browser."""
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5.0)
        if not self._loop.is_running():
            self._loop.close()
        self._profile.cleanup()

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _wait(self, job: Coroutine[object, object, _T]) -> _T:
        return asyncio.run_coroutine_threadsafe(job, self._loop).result()

    async def _connect(self, size: tuple[int, int]) -> None:
        from tornado.websocket import websocket_connect

        ports, end = Path(self._profile.name, "DevToolsActivePort"), time.monotonic() + _LONGEST_BROWSER_START
        while not (ports.is_file() and ports.read_text().strip()):
            if time.monotonic() > end or self._process.poll() is not None:
                raise BrowserError("the browser does not start")
            await asyncio.sleep(0.05)
        port = int(ports.read_text().split()[0])
        request = urllib.request.Request(f"http://127.0.0.1:{port}/json/new?about:blank", method="PUT")
        with urllib.request.urlopen(request, timeout=30) as answer:
            target = json.load(answer)["webSocketDebuggerUrl"]
        self._socket = await websocket_connect(target, max_message_size=1 << 28)
        await self._call("Runtime.enable")
        await self._call("Page.enable")
        width, height = size
        await self._call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
        )

    async def _open(self, address: str) -> None:
        await self._call("Page.navigate", url=address)
        end = time.monotonic() + self._patience
        while not await self._evaluate(f"location.href !== 'about:blank' && {_READY}"):
            if time.monotonic() > end:
                self.errors.append(f"the page was not ready after {self._patience:.0f} s")
                break
            await asyncio.sleep(0.1)

    async def _evaluate(self, expression: str) -> object:
        result = await self._call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in result:
            self.errors.append(str(result["exceptionDetails"]))
        return result["result"].get("value")

    async def _call(self, method: str, **params: object) -> Document:
        self._number += 1
        await self._socket.write_message(json.dumps({"id": self._number, "method": method, "params": params}))
        while True:
            text = await asyncio.wait_for(self._socket.read_message(), self._patience)
            if text is None:
                raise BrowserError("the browser has ended")
            message = json.loads(text)
            told = message.get("params", {})
            if message.get("method") == "Runtime.exceptionThrown":
                self.errors.append(told["exceptionDetails"].get("exception", {}).get("description", "exception"))
            elif message.get("method") == "Runtime.consoleAPICalled" and told["type"] == "error":
                self.errors.append(" ".join(str(a.get("value", a.get("description", ""))) for a in told["args"]))
            elif message.get("id") == self._number:
                if "error" in message:
                    raise BrowserError(f"{method}: {message['error']}")
                return message["result"]
