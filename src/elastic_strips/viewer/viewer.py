"""Viewer: pictures of robots, scenes and strips, live in the browser or as standalone HTML."""

from __future__ import annotations

import dataclasses
import logging
import os
import threading
import time
import webbrowser
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from elastic_strips.arrays import ArrayLike
from elastic_strips.control.record import Record
from elastic_strips.errors import InputError, RobotError, SceneError
from elastic_strips.files import atomic_write, check_writable
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import Strip
from elastic_strips.strip.report import DeformReport
from elastic_strips.validation import check_count, check_type, named_arguments, shown

from . import animation, commands, film
from .animation import Animated, RunReplay, StripAnimation
from .commands import Command, inline_frame, live_page, static_page
from .drag import Drag, Steer, parse, parse_steer
from .drawing import Drawing, Snapshot
from .sensed import Seen
from .server import CommandLog, ServerError, ServerProcess

_log = logging.getLogger(__name__)
_PICTURE_RATE = 30.0  # pictures per second
_LONGEST_FLUSH = 60.0  # [s]
_Job = Snapshot | StripAnimation | RunReplay


class Viewer:
    """Shows robots, scenes and strips, and never blocks the caller.

    ``show``, ``update`` and ``animate`` hand over the newest picture and return at once; a thread of the viewer's own
    draws it, and a process of its own serves it to browsers, on 127.0.0.1 only. If one of them dies, that is
    logged once, ``alive`` turns False and ``update`` does nothing any more; ``save_html`` still works. ``show``,
    ``animate`` and ``replay`` return the viewer itself.

    Examples:
        >>> robot = es.load_robot("silvermate")
        >>> with es.Viewer(server=False) as viewer:  # es.Viewer().show(...).wait() is live, in the browser
        ...     page = viewer.show(robot, es.Scene(), [robot.home(), robot.home(x=1.0)]).save_html("strip.html")
    """

    @named_arguments
    def __init__(
        self,
        *,
        port: int | None = None,
        open_browser: bool = False,
        server: bool = True,
        ghosts: int = 7,
        title: str = "elastic strip",
    ) -> None:
        """Start the viewer.

        Args:
            port: Port on 127.0.0.1; None takes the first free one from 7000 on.
            open_browser: Open the picture in the default browser.
            server: False only records, for ``save_html`` and notebooks.
            ghosts: Largest number of translucent robots along the strip.
            title: Headline of the picture.

        Raises:
            ParameterError: A port or a number of ghosts out of range.
        """
        if port is not None:
            check_count("port", port, low=1, high=65535)
        check_count("ghosts", ghosts, high=50)  # more stall browsers
        check_type("title", title, str)
        check_type("server", server, bool)
        check_type("open_browser", open_browser, bool)
        self._title = title
        self._drawing = Drawing(title=title, ghosts=ghosts)
        self._log = CommandLog()
        self._log_lock = threading.Lock()
        self._condition = threading.Condition()
        self._pending: _Job | None = None
        self._posted = self._drawn = 0
        self._scene = Scene()
        self._failed = self._lost = self._closed = False
        self._missed: Snapshot | None = None
        self._listener: Callable[[Drag], None] | None = None
        self._steered: Callable[[Steer], None] | None = None
        self._extra: list[Command] = []  # to be sent with the next picture
        self._server: ServerProcess | None = None
        if server:
            try:
                self._server = ServerProcess(port=port, page=live_page(title), heard=self._heard)
                _log.info("the viewer shows its picture at %s", self._server.url)
            except (ServerError, OSError) as error:
                self._lost = True
                _log.warning("the viewer could not start; planning goes on without live pictures: %s", error)
        self._thread = threading.Thread(target=self._work, name="elastic-strips viewer", daemon=True)
        self._thread.start()
        if open_browser and self._server is not None:
            webbrowser.open(self._server.url)

    @property
    def url(self) -> str | None:
        """Address of the live picture; None without a server."""
        return None if self._server is None else self._server.url

    @property
    def own_url(self) -> str | None:
        """Address of this picture alone: once it has ended, another one at the same port does not answer to it."""
        return None if self._server is None else f"{self._server.url}?id={self._server.id}"

    @property
    def server_pid(self) -> int | None:
        """Process id of the server; None without one."""
        return None if self._server is None else self._server.pid

    @property
    def alive(self) -> bool:
        """Whether pictures are still drawn (and served)."""
        return not (self._failed or self._lost or self._closed) and (self._server is None or self._server.alive)

    def show(self, robot: RobotModel, scene: Scene, strip_or_report: Animated) -> Viewer:
        """Show a strip, or a report with its certificate, forces and hulls, and turn the camera to it.

        Args:
            robot: The robot.
            scene: The obstacles.
            strip_or_report: A ``Strip``, a ``DeformReport``, a ``PathReport`` or configurations (N, nq).

        Raises:
            InputError: Something else, or in another order.
        """
        return self._play(animation.strip_animation(robot, scene, [strip_or_report], 1.0).snapshot(), scene)

    def update(
        self,
        report: DeformReport | Strip,
        scene: Scene | None = None,
        *,
        q: ArrayLike | None = None,
        goal: ArrayLike | None = None,
        motion: bool = False,
        tick: float | None = None,
        notes: Sequence[tuple[str, str]] = (),
        seen: Seen | None = None,
    ) -> None:
        """Show the newest report, at once; it takes microseconds, and a picture that is not drawn yet is left out.

        Args:
            report: A ``DeformReport`` or a ``Strip``.
            scene: The scene if it has changed.
            q: Configuration (nq,) where the robot is; at the strip's first node where None.
            goal: Configuration (nq,) at the goal; the strip's last node where None.
            motion: Whether a ``Strip`` is the motion that is driven, which was certified as a whole.
            tick: Time of a tick [s], to be shown; nothing is shown where None.
            notes: Further rows of the card: names and values.
            seen: What sensors see.

        Raises:
            InputError: Something other than a report or a strip, or than a scene.
        """
        if self._failed or self._closed:
            return
        check_type("scene", scene, Scene, SceneError, none=True)
        check_type("seen", seen, Seen, none=True)
        strip, about = animation.strip_and_report(report)
        if not isinstance(strip, Strip):
            raise InputError(f"update shows a report or a Strip, not {shown(report)}")
        if scene is not None:
            self._scene = scene
        job = Snapshot(
            strip.robot,
            self._scene,
            strip.q,
            about,
            q=q,
            goal=goal,
            motion=motion,
            live=True,
            tick=tick,
            notes=tuple(notes),
            seen=seen,
        )
        if self._lost:
            self._missed = job  # no browser gets it; save_html may
        else:
            self._post(job)

    def listen(
        self,
        listener: Callable[[Drag], None] | None,
        *,
        obstacles: bool = True,
        goal: bool = False,
        hand: bool = False,
    ) -> None:
        """Let things be grabbed in the page, and call ``listener`` when they are dragged; None ends that.

        Args:
            listener: called with each message, in a thread of the viewer's own; it must not block.
            obstacles: Whether obstacles can be grabbed.
            goal: Whether the ring at the goal can be grabbed.
            hand: Whether there is a ball at the hand of the goal, which can be grabbed.
        """
        self._listener, on = listener, listener is not None
        self._drawing.hand = hand and on
        with self._condition:
            self._extra.append(commands.draggable(obstacles=obstacles and on, goal=goal and on, hand=hand and on))
            self._condition.notify_all()

    def steered(self, listener: Callable[[Steer], None] | None, *, slides: bool = False) -> None:
        """Let somebody steer in the page, with keys and a stick, and call ``listener`` with it; None ends that.

        Args:
            listener: called about twenty times a second while somebody steers, and once when that ends, in a thread of
                the viewer's own; it must not block.
            slides: Whether the base can move sideways.
        """
        self._steered = listener
        with self._condition:
            self._extra.append(commands.steerable(on=listener is not None, slides=slides))
            self._condition.notify_all()

    def single(self, name: str) -> None:
        """Draw an obstacle as an object of its own from now on: quicker where it alone moves."""
        self._drawing.obstacles.singles.add(name)

    def animate(
        self,
        robot: RobotModel,
        scene: Scene,
        strips: Animated | Iterable[Animated],
        duration: float = 8.0,
        *,
        notes: Sequence[tuple[str, str]] = (),
    ) -> Viewer:
        """Play the robot driving along a strip; the page has buttons to stop and to go back.

        Args:
            robot: The robot.
            scene: The scene at the beginning; its moving obstacles move.
            strips: A strip, a report or a path (N, nq) to drive along; or a sequence of strips or reports, spread
                evenly over the duration, along which the strip gives way while the robot drives. Where the strips of
                a sequence begin at different configurations, these are where the robot is.
            duration: How long it takes [s].
            notes: Further rows of the card: names and values.

        Raises:
            InputError: Nothing to play, a duration out of range, or nodes of the wrong size.
        """
        return self._play(animation.strip_animation(robot, scene, strips, duration, notes), scene)

    def replay(
        self,
        robot: RobotModel,
        record: Record,
        *,
        speed: float = 1.0,
        begin: float | None = None,
        end: float | None = None,
    ) -> Viewer:
        """Play a recorded run: the robot, its base's and hand's paths, obstacles, the strip of the time, and events.

        Args:
            robot: The recorded robot, such as ``record_robot(record)``.
            record: Record of a run.
            speed: How many times as fast as the run.
            begin: Time of the record to begin with [s]; its first where None.
            end: Time to end with [s]; its last where None.

        Raises:
            InputError: Another robot, a speed out of range, or nothing between begin and end.
        """
        check_type("robot", robot, RobotModel, RobotError)
        check_type("record", record, Record)
        job = animation.run_replay(robot, record, speed=speed, begin=begin, end=end)
        return self._play(job, record.world.at(job.end))

    def html(self, *, coarse: bool = False) -> str:
        """Return the picture as a standalone page that needs neither a server nor a network.

        Args:
            coarse: Draw the robot with fewer triangles and leave out things that are hidden while something plays, as
                notebooks do, where many pages are in one file.
        """
        missed, self._missed = self._missed, None
        if missed is not None:
            self._post(missed)
        self._flush()
        with self._log_lock:
            items = dict(self._log.items())
        if coarse and self._drawing.robot is not None:
            items.update(self._drawing.robot_meshes(coarse=True))  # in the places of the fine ones
            items = {path: item for path, item in items.items() if not path.startswith(self._drawing.hidden)}
        log = CommandLog()
        log.extend(items.items())
        return static_page(self._title, log)

    def save_html(self, path: str | os.PathLike[str]) -> Path:
        """Write the picture as a standalone page; the file is written whole or not at all.

        Raises:
            InputError: The file cannot be written.
        """
        return atomic_write(check_writable(path), self.html().encode())

    def save_png(
        self, path: str | os.PathLike[str], *, size: tuple[int, int] = (1280, 720), time: float | None = None
    ) -> Path:
        """Draw the picture with a Chromium without a window.

        Args:
            path: PNG to write.
            size: Width and height [pixels].
            time: Moment of playing [s]; the first where None, the last where infinite.

        Raises:
            BrowserError: There is no Chromium.
            InputError: The file cannot be written.
        """
        return film.save_picture(self.html(), path, size=size, time=time)

    def save_film(self, path: str | os.PathLike[str], *, size: tuple[int, int] = (960, 540), fps: float = 20.0) -> Path:
        """Draw what plays, from beginning to end: .gif, .mp4 or .webm. It takes up to a second a picture.

        Args:
            path: File to write; its ending chooses the format.
            size: Width and height [pixels].
            fps: Pictures a second.

        Raises:
            BrowserError: There is no Chromium.
            MissingExtraError: The extra ``film`` is not installed.
            InputError: Nothing plays, another ending, or the file cannot be written.
        """
        return film.save_film(self.html(), path, size=size, fps=fps)

    def _repr_html_(self) -> str:
        return inline_frame(self.html(coarse=True))

    def wait(self) -> None:
        """Block until the viewer is closed, its server ends or the user presses Ctrl-C: for the end of a script."""
        try:
            while self._server is not None and self.alive:
                time.sleep(0.2)
        except KeyboardInterrupt:
            pass

    def close(self) -> None:
        """End the thread and the server; what was drawn can still be saved."""
        if self._closed:
            return
        self._flush(2.0)
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(2.0)
        if self._server is not None:
            self._server.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _play(self, job: _Job, scene: Scene) -> Viewer:
        self._scene = scene
        self._post(job)
        return self

    def _post(self, job: _Job) -> None:
        if self._failed or self._closed:
            return
        with self._condition:
            old = self._pending
            if isinstance(job, Snapshot) and isinstance(old, Snapshot) and old.frame and not job.frame:
                job = dataclasses.replace(job, frame=True)  # the camera move is not to be skipped
            self._pending = job
            self._posted += 1
            self._condition.notify_all()

    def _flush(self, timeout: float = _LONGEST_FLUSH) -> None:
        with self._condition:
            self._condition.wait_for(lambda: self._drawn >= self._posted or self._failed or self._closed, timeout)

    def _work(self) -> None:
        try:
            while self._turn():
                pass
        except Exception:
            self._failed = True
            _log.exception("the viewer cannot draw; planning goes on without pictures")
        finally:
            with self._condition:
                self._condition.notify_all()

    def _heard(self, line: bytes) -> None:
        drag, steer = parse(line), parse_steer(line)
        try:
            if drag is not None:
                if self._listener is not None:
                    self._listener(drag)
            elif steer is not None:
                if self._steered is not None:
                    self._steered(steer)
            else:
                _log.debug("a page sent a message that is not understood: %r", line[:200])
        except Exception:
            _log.exception("the listener to the pages failed")

    def _send(self, items: list[Command]) -> None:
        if self._server is None or self._lost:
            return
        try:
            if not self._server.alive:
                raise ServerError("the process has ended")
            if items:
                self._server.send(items)
        except ServerError as error:
            self._lost = True
            if not self._closed:
                _log.warning("the viewer has lost its server; planning goes on without live pictures: %s", error)

    def _draw(self, job: _Job) -> list[Command]:
        if isinstance(job, Snapshot):
            return self._drawing.draw(job)
        if isinstance(job, RunReplay):
            return animation.draw_run(self._drawing, job)
        return animation.draw_strips(self._drawing, job)

    def _turn(self) -> bool:
        """Draw what is pending; False at the end."""
        with self._condition:
            self._condition.wait_for(lambda: self._pending is not None or self._extra or self._closed, timeout=1.0)
            job, number, self._pending = self._pending, self._posted, None
            extra, self._extra = self._extra, []
            if self._closed:
                return False
        if job is None:
            self._send(extra)  # and look whether the server is there
            return True
        begin = time.monotonic()
        drawn = self._draw(job)
        with self._log_lock:
            self._log.extend(drawn)
        with self._condition:
            self._drawn = number
            self._condition.notify_all()
        self._send([*drawn, *extra])
        time.sleep(max(0.0, 1.0 / _PICTURE_RATE - (time.monotonic() - begin)))
        return True
