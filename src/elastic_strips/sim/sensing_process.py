"""Sensing process: simulated sensors, and the scenes that are made of their readings, beside planning.

The machine's states are handed on to it as they come. What sensors measured then is looked at as soon as it is known
where the robot is thought to have been. Of readings that have come meanwhile only the newest of each sensor is looked
at, as by a driver that keeps one; where the process is far behind, sensors do not measure at all what it would be too
late for. Scenes come back as they are made, and what was in the last one is not sent again.
"""

from __future__ import annotations

import gc
import pickle
import select
import signal
import socket
import threading
import weakref
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from itertools import islice
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import NamedTuple, cast

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control.process.channel import ChannelClosedError, channel, put, take
from elastic_strips.control.process.child import (
    LONGEST_PROCESS_START,
    NOTHING_HEARD,
    end_process,
    orphaned,
    start_process,
)
from elastic_strips.errors import ConfigurationError, ElasticStripsError
from elastic_strips.perception import Reading
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene, World
from elastic_strips.scene.difference import SceneDifference, difference, with_difference

from .faults import FaultPlan, FaultyPerception
from .machine_process import TrueState
from .pedestrians import Pedestrians
from .perception import Perception, PerceptionError, PerceptionParams
from .sensed_perception import LOOK_AHEAD, SensorPerception
from .sensors import SensorConfig

SENSING_TIME = 0.1
"""Time [s] in which a reading is handed on, looked at and handed back, on a processor that is not idle."""

_BUFFER = 1 << 20  # [bytes] of the channel to the process
_AT_ONCE = 50  # states in one message
_MOST_WAITING_STATES = 20_000  # states that wait for the process, at most
_LONGEST_UNKNOWN = 0.2  # [s] for which it is waited until it is known where the robot was; then it is where it was last
_LONGEST_BEHIND = 0.1  # [s]; what was to be measured before that is left out
_SCENE_PERIODS = 0.045, 0.1
"""Time [s] from scene to scene at least, for nobody plans more often, and at most, though nothing new was measured:
faults begin and end."""
_KEPT_ESTIMATES = 100
_LONGEST_END = 5.0  # [s]


class SensedWorld(NamedTuple):
    """What is simulated in the process: the arguments of its :class:`SensorPerception`."""

    robot: RobotModel
    world: World
    start: Array
    sensors: SensorConfig
    seed: int
    faults: FaultPlan


class _News(NamedTuple):
    """What the process says."""

    time: float  # [s] of the newest state that it has seen
    scene: SceneDifference | None  # against the one that was sent last
    trouble: str  # why there is none
    readings: dict[str, tuple[Reading, Array]]  # new ones
    target: Array | None  # what a camera is turned to
    contact: str
    looked_at: dict[str, int]


class SensingProcess:
    """Workspace: a :class:`SensorPerception` in a process of its own; a :class:`Perception` for who plans.

    It begins at once, and ends with :meth:`close`, or with whoever began it.

    Args:
        sensed: what is simulated.

    Attributes:
        params: the sensors' delay.
        sensors: their parameters.
        newest: sensor → its newest reading, and the base's estimated pose then.
        sensed: the newest scene.
        target: (3,) what a camera is turned to [m], or None.
        contact: description of a felt contact; empty without one.
        looked_at: sensor → how many of its readings were looked at since time 0.
        glass: time [s] → names of the obstacles that are of glass then.

    Raises:
        ElasticStripsError: as for :class:`SensorPerception`.
        ConfigurationError: the process does not start; the message says why.
    """

    def __init__(self, sensed: SensedWorld) -> None:
        self.sensors: SensorConfig = sensed.sensors
        self.glass = sensed.faults.glass(sensed.world, sensed.seed)
        self._link, child = channel(_BUFFER)
        self._news, sender = Pipe(duplex=False)
        process: SpawnProcess | None = None
        first: object = NOTHING_HEARD
        try:
            process = start_process(_run, (child, sender), tuple(sensed), name="sensing")
            child.close()
            sender.close()
            if self._news.poll(LONGEST_PROCESS_START):
                with suppress(EOFError):
                    first = self._news.recv()
        except Exception as error:  # what cannot be sent to a process
            first = f"{type(error).__name__}: {error}"
        finally:
            child.close()
            sender.close()
        if not isinstance(first, tuple):
            self._link.close()
            self._news.close()
            if process is not None:
                end_process(process, 0.0)
            if isinstance(first, ElasticStripsError):
                raise first
            raise ConfigurationError(f"the process of the sensors does not start: {first}")
        assert process is not None
        self.params: PerceptionParams = first[0]
        self._gazes: bool = first[1]
        self.sensed: Scene = first[2]
        self.newest: dict[str, tuple[Reading, Array]] = first[3]
        self.contact: str = first[4]
        self.target: Array | None = None
        self.looked_at: dict[str, int] = {}
        self._known, self._trouble, self._gone_by = self.sensed, "", ""
        self._ahead: Callable[[float], Array] | None = None
        self._rows: Array | None = None
        self._waiting: deque[TrueState] = deque(maxlen=_MOST_WAITING_STATES)
        self._process = process
        self._listener = threading.Thread(target=_listen, args=(weakref.ref(self), self._news), daemon=True)
        self._listener.start()
        self._ended = weakref.finalize(self, _end, process, self._link)

    def close(self) -> None:
        """End the process."""
        self._ended()
        self._listener.join()

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid or 0

    def known(self) -> Scene:
        """The scene that was sensed from the start."""
        return self._known

    def observe(self, t: float, coordinates: Array, estimate: Array) -> None:
        """Nothing to do: the process is fed."""

    def attend(self, ahead: Callable[[float], Array]) -> None:
        """As for :class:`SensorPerception`."""
        self._ahead = ahead

    def feed(self, states: list[TrueState], known: tuple[float, Array]) -> None:
        """Hand on the machine's states, and the robot's estimated coordinate row (nv,) with its time [s]; in one thread
        at a time."""
        self._waiting += states
        some = tuple(islice(self._waiting, _AT_ONCE))
        if put(self._link, (some, known, self._rows)):
            for _ in some:
                self._waiting.popleft()

    def sense(self, t: float) -> Scene:
        """The newest scene.

        Raises:
            PerceptionError: there is none, or the process is gone.
        """
        if self._gazes and self._ahead is not None:
            self._rows = self._ahead(LOOK_AHEAD)
        if not self._listener.is_alive():
            raise PerceptionError(f"the process of the sensors is gone{self._gone_by}")
        if self._trouble:
            raise PerceptionError(self._trouble)
        return self.sensed

    def _take(self, news: _News) -> None:
        """In the listener's thread."""
        self.newest = self.newest | news.readings
        self.target, self.contact, self.looked_at = news.target, news.contact, news.looked_at
        if news.scene is not None:
            self.sensed = with_difference(self.sensed, news.scene)
        self._trouble = news.trouble


def _listen(to: weakref.ref[SensingProcess], news: Connection) -> None:
    """The thread that takes what the process says, so that this never waits."""
    with news:
        while True:
            try:
                said = news.recv()
            except (EOFError, OSError):
                return
            process = to()
            if process is None:
                return
            if isinstance(said, str):
                process._gone_by = f": {said}"
            else:
                process._take(_News(*said))
            del process


def _end(process: SpawnProcess, link: socket.socket) -> None:
    link.close()
    end_process(process, _LONGEST_END)


class _Sensing:
    """Workspace: the sensors in their process."""

    def __init__(self, robot: RobotModel, perception: Perception, pedestrians: Pedestrians, news: Connection) -> None:
        self.planar = robot.space.planar
        self.perception, self.pedestrians, self.news = perception, pedestrians, news
        self.sensors = cast("SensorPerception", perception)  # faults are wrapped about it
        self.states: deque[TrueState] = deque()
        self.past: deque[tuple[float, Array]] = deque(maxlen=_KEPT_ESTIMATES)
        self.rows: Array = np.zeros((0, robot.nv))  # through which the robot comes next
        self.sent: Scene | None = None
        self.told, self.looked, self.new = -np.inf, -np.inf, False  # when [s]; whether something was seen since
        self.now: tuple[float, Array] = -np.inf, np.zeros(0)  # [s] of the last state, and where the robot was then
        self.said: dict[str, tuple[Reading, Array]] = {}
        self.contact = perception.contact
        self.sensors.attend(lambda _: self.rows)

    def run(self, link: socket.socket) -> None:
        """Until who plans is gone."""
        while not orphaned():
            select.select([link], [], [], 0.5)
            for message in take(link):
                self.hear(*cast("tuple[tuple[TrueState, ...], tuple[float, Array], Array | None]", message))
            self.measure()
            self.look()

    def hear(self, states: tuple[TrueState, ...], known: tuple[float, Array], rows: Array | None) -> None:
        self.states += states
        if not self.past or known[0] > self.past[-1][0]:
            self.past.append(known)
        self.rows = self.rows if rows is None else rows

    def row_at(self, t: float) -> Array:
        """The estimated coordinate row (nv,) at a time [s]."""
        after = next((k for k, (time, _) in enumerate(self.past) if time >= t), len(self.past) - 1)
        (t0, a), (t1, b) = self.past[max(after - 1, 0)], self.past[after]
        step = b - a
        if self.planar:
            step[2] = np.remainder(step[2] + np.pi, 2.0 * np.pi) - np.pi
        return np.asarray(a + np.clip((t - t0) / max(t1 - t0, 1e-9), 0.0, 1.0) * step)

    def measure(self) -> None:
        """Let the sensors measure at states of which it is known by now where the robot was thought to be."""
        if not (self.states and self.past):
            return
        until = max(self.past[-1][0], self.states[-1].time - _LONGEST_UNKNOWN)
        while self.states and self.states[0].time <= until:
            state = self.states.popleft()
            row = self.row_at(state.time)
            if state.time > until - _LONGEST_BEHIND:
                self.sensors.measure(state.time, state.coordinates, row)
            self.pedestrians.step(state.time, state.coordinates, state.v)
            self.now = state.time, row

    def look(self) -> None:
        """Look at what was measured, and say what was seen where it is time to."""
        t, row = self.now
        if t == self.looked:
            return
        self.looked = t
        self.new = self.sensors.work(t, row, newest=True) or self.new
        least, most = (self.told + period for period in _SCENE_PERIODS)
        if self.perception.contact != self.contact or t > (least if self.new else most):
            self.tell(t)

    def tell(self, t: float) -> None:
        scene, trouble, self.told, self.new = None, "", t, False
        try:
            scene = self.perception.sense(t)
        except Exception as error:  # a fault, maybe one that is injected: the robot has to come to rest
            trouble = str(error) if isinstance(error, PerceptionError) else f"{type(error).__name__}: {error}"
        self.contact = self.perception.contact
        seen = dict(self.sensors.newest)
        fresh = {name: each for name, each in seen.items() if self.said.get(name, (None,))[0] is not each[0]}
        new = None if scene is None else difference(scene, self.sent)
        told = _News(t, new, trouble, fresh, self.sensors.target, self.contact, dict(self.sensors.looked_at))
        self.news.send(tuple(told))
        self.said = seen
        if scene is not None:  # which may be empty
            self.sent = scene


def _run(
    link: socket.socket,
    news: Connection,
    robot: RobotModel,
    world: World,
    start: Array,
    sensors: SensorConfig,
    seed: int,
    faults: FaultPlan,
) -> None:
    """The process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for planning, which lets the robot come to rest
    try:
        pedestrians = Pedestrians(robot, world)
        inner = SensorPerception(robot, world, start, sensors=sensors, seed=seed)
        perception = cast("Perception", FaultyPerception(inner, faults, seed) if faults.faults else inner)
        first = perception.known()
        news.send((inner.params, inner.gaze is not None, first, inner.newest, perception.contact))
    except Exception as error:
        known = isinstance(error, ElasticStripsError) and _pickles(error)
        news.send(error if known else f"{type(error).__name__}: {error}")
        return
    import scipy.ndimage  # what moves is grouped by it: not to be imported when it is needed first
    import scipy.optimize  # noqa: F401

    gc.freeze()  # what is there now stays
    inner.looked_at.clear()
    sensing = _Sensing(robot, perception, pedestrians, news)
    sensing.sent = first
    with suppress(ChannelClosedError, BrokenPipeError):
        try:
            sensing.run(link)
        except (ChannelClosedError, BrokenPipeError):
            raise
        except Exception as error:
            news.send(f"{type(error).__name__}: {error}")
            raise  # with its traceback on standard error


def _pickles(error: Exception) -> bool:
    """Whether an error arrives in another process as it is."""
    try:
        return type(pickle.loads(pickle.dumps(error))) is type(error)
    except Exception:
        return False
