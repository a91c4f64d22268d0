"""ROS trials: robot and node in processes of their own, driven over DDS while something goes wrong.

What the robot did is judged by the robot, from its true states; what was said about it, by the node's diagnostics.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.ros2.driver import close_node, load, open_node, quality
from elastic_strips.ros2.shared_memory import clear_left

from .measure import Figures, Note, head, silent
from .pilots import PILOTS
from .ros_ask import ask_for_goal, ask_for_path, call
from .ros_loopback import own_domain, ports, running, variables

_LENGTH = 6.0  # [m] of the corridor
_SWING = 0.25  # [m] to each side, of the path that is to be followed
_BEGIN, _END = 0.2, 2.5  # [s] after the robot was fast, between which something goes wrong
_LONGEST_START, _LONGEST_DRIVE, _LONGEST_END = 60.0, 60.0, 20.0  # [s]
_AFTER_REST = 2.0  # [s] in which it is seen whether the robot stays at rest, and what is said
_STANDS_FIRST = 4.0  # [s] in which a robot that must not move has to stand
_PILOT_TIME = 12.0  # [s]
_NODE = "from elastic_strips.cli import main\nif __name__ == '__main__':\n    main()\n"
_PROCESSES = ("node", "executor", "robot")
_SILENT = 4.0  # [s] for which odometry is away in trials where it comes back
_PAUSE = 3.0  # [s] for which nothing of robot and node runs, as where a computer is overloaded or sleeps
_LONGEST_LEFT = 5.0  # [s] until what is left of shared memory is removed: what is younger than 2 s is not
_MOVED = 0.01  # [m] more than a robot that must not move may
_BEFORE_IT_MOVED = 1.5  # [s] in which what is said may still be said when it drives
_MOST_TRIES = 3  # of a trial that the machine has disturbed
_TICKS = os.sysconf("SC_CLK_TCK")


class Trial(NamedTuple):
    """What one kind of trial is about.

    Attributes:
        act: what is done to the processes, or asked for, while the robot is fast; empty: nothing.
        fault: what goes wrong in what the robot says, one of ``ros_robot.FAULTS``; empty: nothing.
        told: further options of the robot, and
        params: parameters of the node.
        reaches: whether the robot has to reach its goal; else it has to come to rest.
        named: a regular expression, which what the diagnostics say has to match from then on, and not before; empty:
            there is nothing to say, or nobody left to say it.
        exits: the node's exit code.
        lasts: for how long what the robot says is wrong [s].
        near: how near it has to come to its goal, along and aside [m], by what it drives by: odometry, or localization.
    """

    act: str = ""
    fault: str = ""
    told: tuple[str, ...] = ()
    params: tuple[str, ...] = ()
    reaches: bool = False
    named: str = ""
    exits: int = 130
    lasts: float = math.inf
    near: float = 0.15


_MAP = ("--fix", "10"), ("fix:=pose", "world_frame:=map")
_CLOUD = ("--cloud",), ("clouds:=['points']",)
KINDS: dict[str, Trial] = {
    "drive": Trial(reaches=True),
    "depth": Trial(told=("--depth", "--magnified", "4"), params=("depths:=['depth/image']",), reaches=True),
    "path": Trial("path", "", *_MAP, reaches=True),
    "path_level": Trial("path", "", _MAP[0], (*_MAP[1], "level:=palm_link"), reaches=True),
    "guard": Trial("pilot", params=("mode:=guard",)),
    "node_killed": Trial("kill node", exits=-9),
    "executor_killed": Trial("kill executor", exits=3),
    "robot_killed": Trial("kill robot", named="'odom'.*'joint_states'"),
    "ctrl_c": Trial("interrupt"),
    "cancel": Trial("cancel", named="cancel"),
    "preempt": Trial("goal", reaches=True),
    "paused": Trial("pause", reaches=True),
    **{f"odom_{how}": Trial(fault=f"odom_{how}", named="'odom'|odom:") for how in ("lost", "late", "nan")},
    "odom_away": Trial(fault="odom_lost", lasts=_SILENT, reaches=True, named="'odom'|odom:"),
    **{f"joints_{how}": Trial(fault=f"joints_{how}", named="'joint_states'|joint_states:")
       for how in ("lost", "late", "nan")},
    **{f"scan_{how}": Trial(fault=f"scan_{how}", named="'scan'|scan:")
       for how in ("lost", "late", "nan", "old", "frame")},
    "odom_frame": Trial(fault="odom_frame", params=("odom_frame:=odom",), named="odom: the frame"),
    "cloud_lost": Trial("", "cloud_lost", *_CLOUD, named="'points'"),
    "clock": Trial(fault="clock", named="time stamp"),
    **{f"{topic}_{how}": Trial(fault=f"{topic}_{how}", reaches=True) for topic in ("odom", "joints", "scan")
       for how in ("shuffled", "twice")},
    "map_jump": Trial("resume", "map_jump", *_MAP, reaches=True, named="fixes are", near=0.55),
    "emergency": Trial(fault="emergency", params=("emergency:=emergency",), named="emergency"),
    "emergency_missing": Trial(fault="emergency_missing", params=("emergency:=emergency",), named="emergency"),
}  # fmt: skip
"""The kinds of trials."""
FAULTS = tuple(name for name in KINDS if name not in ("drive", "depth", "path", "path_level", "guard"))
"""Those in which something goes wrong."""


def bench_ros_trials(
    seeds: Sequence[int],
    step: Note = silent,
    *,
    kinds: Sequence[str] = FAULTS,
    odometry: float = 50.0,
    reliable: bool = False,
) -> Figures:
    """Trials of each kind in seeded corridors; what goes wrong does so at a random time while the robot is fast.

    Args:
        seeds: of corridors, slip, noise and times.
        step: called before each trial.
        kinds: kinds of `KINDS`.
        odometry: rate of odometry and joint states [Hz].
        reliable: whether the robot's sensors are reliable; else of best effort.

    Raises:
        MissingExtraError: rclpy is not installed.
    """
    load("rclpy")
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in the background; all who are started would have that
        signal.signal(signal.SIGINT, signal.default_int_handler)
    rows: list[Figures] = []
    told = ("--odometry", str(odometry), "--joint-states", str(odometry), "--reliable" if reliable else "--best-effort")
    with own_domain() as domain:
        for kind, seed in itertools.product(kinds, seeds):
            step(f"{kind}, seed {seed}")
            rows.append(_in_its_folder(domain, kind, int(seed), told))
            for _ in range(_MOST_TRIES - 1):
                if not rows[-1]["disturbed"]:
                    break
                step(f"{kind}, seed {seed}, again: the robot was not run for a while")
                rows[-1] = _in_its_folder(domain, kind, int(seed), told) | {"tries": rows[-1]["tries"] + 1}
    return head("ros_trials", kinds={kind: _summary([row for row in rows if row["kind"] == kind]) for kind in kinds},
                odometry_hz=odometry, reliable=reliable, rows=rows)  # fmt: skip


def _summary(rows: list[Figures]) -> Figures:
    """Of the trials of one kind."""

    def values(name: str) -> list[float]:
        return [row[name] for row in rows if row.get(name) is not None]

    gaps = [row["command_gaps_ms"] for row in rows if row.get("command_gaps_ms")]
    shares = {name: [row["processors"][name] for row in rows if name in row["processors"]] for name in _PROCESSES}
    return {
        "count": len(rows),
        "as_it_should": sum(row["as_it_should"] for row in rows),
        "made_anew": sum(row["tries"] - 1 for row in rows),
        "contacts_at_speed": sum(row.get("contacts_at_speed", 0) for row in rows),
        "longest_to_rest_s": max(values("to_rest_s"), default=None),
        "named": sum(values("named")) if values("named") else None,
        "left": sum(len(row["left"]) for row in rows),
        "median_s": float(np.median(values("drive_s"))) if values("drive_s") else None,
        "deviation_m": max(values("deviation_m"), default=None),
        "gaps_ms": [float(np.median([gap[0] for gap in gaps])), *(max(gap[k] for gap in gaps) for k in (1, 2))]
        if gaps
        else None,
        "processors": {name: round(float(np.mean(some)), 2) for name, some in shares.items() if some},
    }


def _in_its_folder(domain: int, kind: str, seed: int, told: Sequence[str]) -> Figures:
    """A trial with a folder of its own."""
    with tempfile.TemporaryDirectory(prefix="elastic-strips-") as folder:
        return _trial(Path(folder), domain, kind, seed, told)


def _trial(folder: Path, domain: int, kind: str, seed: int, told: Sequence[str]) -> Figures:
    """One trial; everything that it starts has ended after it."""
    before, trial = ports(domain), KINDS[kind]
    at = float(np.random.default_rng([seed, sum(map(ord, kind))]).uniform(_BEGIN, _END))
    with ExitStack() as stack:
        run = _Run(folder, domain, trial, seed, at, stack)
        trouble = run.go([*told, *trial.told])
    end = time.monotonic() + _LONGEST_LEFT
    while (left := [*sorted(ports(domain) - before), *running(folder)]) and time.monotonic() < end:
        clear_left()  # as the next node does, on its way out
        time.sleep(0.1)
    return run.figures(kind, trouble, left)


class _Run:
    """Workspace: one trial, from its start to its end."""

    def __init__(self, folder: Path, domain: int, trial: Trial, seed: int, at: float, stack: ExitStack) -> None:
        self._folder, self._trial, self._seed, self._at, self._stack = folder, trial, seed, at, stack
        self._frame = "map" if _MAP[1][1] in trial.params else "odom"
        self._environment = variables(folder, domain)
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._times: dict[str, list[tuple[float, float]]] = {}  # of each process: when [s], and its processor time [s]
        self._executor = 0
        self._said: list[tuple[float, str]] = []  # what diagnostics said, and when [s, monotonic]
        self._acted: float | None = None
        self._code: int | None = None
        self._stuck = ""  # what did not end
        self._end = _LENGTH
        self.seen: Figures = {}

    def go(self, told: list[str]) -> str:
        """Run it; what went wrong with the trial itself, or empty."""
        try:
            self._start_all(told)
            with self._listening():
                self._drive()
        except (TimeoutError, AssertionError) as error:
            return f"{error}; the node: {self._text('node')[-800:]}"
        finally:
            self._finish()
        return ""

    def _start_all(self, told: list[str]) -> None:
        trial, fault = self._trial, self._trial.fault
        faults = ["--fault", f"{fault}:{self._at:.3f}:{trial.lasts}"] if fault else []
        words = ["--seed", str(self._seed), "--length", str(_LENGTH), "--for", "150", *told, *faults]
        self._start("robot", "-m", "workshop", "ros-robot", *words, "--json", str(self._folder / "robot.json"))
        params = list(trial.params)
        if any(param.startswith("depths") for param in params):  # where its camera is, the robot says
            self._until("the robot is ready", lambda: "mounts:=" in self._text("robot"), _LONGEST_START)
            params.append(self._text("robot").split("; ")[1].splitlines()[0])
        (self._folder / "node.py").write_text(_NODE)
        goals = [] if trial.act in ("pilot", "cancel") else ["--goals", "2" if trial.act == "goal" else "1"]
        given = [word for param in params for word in ("-p", param)]
        self._start("node", str(self._folder / "node.py"), "ros2", *goals, "--ros-args", *given)

    def _start(self, name: str, *words: str) -> None:
        with (self._folder / f"{name}.txt").open("wb") as file:
            process = subprocess.Popen(
                [sys.executable, *words], stdout=file, stderr=file, env=self._environment, cwd=self._folder
            )
        self._processes[name] = process
        self._stack.callback(_end, process)

    def _text(self, name: str) -> str:
        path = self._folder / f"{name}.txt"
        return path.read_text(errors="replace") if path.exists() else ""

    @contextmanager
    def _listening(self) -> Iterator[None]:
        """A node of ours, which asks and hears; its variables are set before it is the first of this process."""
        before = dict(os.environ)
        os.environ.update(self._environment)
        self._context, self._node = open_node("trials")
        kind = load("diagnostic_msgs.msg").DiagnosticArray
        self._diagnostics = self._node.create_subscription(kind, "/diagnostics", lambda _: None, quality(10))
        try:
            yield
        finally:
            close_node(self._context, self._node)
            os.environ.clear()
            os.environ.update(before)

    def _drive(self) -> None:
        trial = self._trial
        if trial.act == "pilot":
            self._until("the guard is ready", lambda: "ready for commands" in self._text("node"), _LONGEST_START)
            kinds = [name for name in PILOTS if name != "wanderer"]
            spoilt = "--spoilt" if self._seed % 2 else "--clean"
            self._start("pilot", "-m", "workshop", "ros-pilot", "--seed", str(self._seed),
                        "--kind", kinds[self._seed % len(kinds)], "--for", str(_PILOT_TIME), spoilt)  # fmt: skip
            self._until("the pilot has ended", lambda: self._ended("pilot"), _LONGEST_DRIVE)
            return
        if trial.act == "path":
            self._until("the node is ready", lambda: "ready for goals" in self._text("node"), _LONGEST_START)
            ask_for_path(self._node, swinging_path(_LENGTH).tolist(), self._frame)
        else:
            self._until("the node is ready", lambda: "ready for goals" in self._text("node"), _LONGEST_START)
            ask_for_goal(self._node, [_LENGTH, 0.0, 0.0], frame=self._frame)
        if trial.fault == "emergency_missing":
            self._acted = time.monotonic()
            self._for(_STANDS_FIRST)
            return
        self._until("the robot is fast", lambda: "it moves fast" in self._text("robot"), _LONGEST_START)
        if trial.act not in ("", "path", "resume"):
            self._for(self._at)
            self._act(trial.act)
        if trial.act == "resume":
            self._until("the robot stands", lambda: "it stands again" in self._text("robot"), _LONGEST_DRIVE)
            self._for(_AFTER_REST)
            call(self._context, self._node, "resume")
        if trial.reaches:
            self._until("the goal is reached", lambda: self._ended("node"), _LONGEST_DRIVE)
        elif trial.act == "kill robot":
            self._for(2.0 * _AFTER_REST)
        else:
            self._until("the robot stands", lambda: "it stands again" in self._text("robot"), _LONGEST_END)
            self._for(_AFTER_REST)

    def _act(self, what: str) -> None:
        node = self._processes["node"]
        self._acted = time.monotonic()
        if what == "kill node":
            node.kill()
        elif what == "kill executor":
            if not self._executor:  # 0 would be all processes of this group
                raise TimeoutError("the executor's process was not found")
            os.kill(self._executor, signal.SIGKILL)
        elif what == "kill robot":
            self._processes["robot"].kill()
        elif what == "interrupt":
            node.send_signal(signal.SIGINT)
        elif what == "pause":
            numbers = [node.pid, self._processes["robot"].pid, *filter(None, (self._executor,))]
            for number in numbers:
                os.kill(number, signal.SIGSTOP)
            time.sleep(_PAUSE)
            for number in numbers:
                os.kill(number, signal.SIGCONT)
        elif what == "goal":
            self._end = 0.75 * _LENGTH
            ask_for_goal(self._node, [self._end, 0.0, 0.0], frame=self._frame)
        else:
            call(self._context, self._node, what)

    def _for(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        self._until("", lambda: time.monotonic() > end, math.inf)

    def _ended(self, name: str) -> bool:
        return self._processes[name].poll() is not None

    def _until(self, what: str, done: Callable[[], bool], seconds: float) -> None:
        """Hear and watch until something is done.

        Raises:
            TimeoutError: it has not happened in time.
        """
        end = time.monotonic() + seconds
        while not done():
            if time.monotonic() > end:
                raise TimeoutError(f"not within {seconds:g} s: {what}")
            self._hear()
            self._look_at_processes()
            time.sleep(0.02)

    def _hear(self) -> None:
        subscription = getattr(self, "_diagnostics", None)
        if subscription is None:
            return
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, False)
        for status in () if taken is None else taken[0].status:
            told = {entry.key: entry.value for entry in status.values}
            left_out = [key for key in told if key.startswith("dropped")]
            words = [status.message, told.get("last_fault", ""), told.get("goal", told.get("pilot", "")), *left_out]
            self._said.append((time.monotonic(), "; ".join(words)))

    def _look_at_processes(self) -> None:
        now = time.monotonic()
        for name in _PROCESSES:
            process = self._processes.get(name)
            number = self._executor if name == "executor" else process.pid if process is not None else 0
            used = _processor_time(number) if number else None
            if used is not None:
                self._times.setdefault(name, []).append((now, used))
        node = self._processes.get("node")
        if not self._executor and node is not None and "ready for" in self._text("node"):
            self._executor = _executor_of(node.pid)

    def _finish(self) -> None:
        """End the node as a user would, then the robot, which judges."""
        for name in ("node", "robot"):
            process = self._processes.get(name)
            if process is None:
                continue
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            try:
                code = process.wait(_LONGEST_END)
                self._code = code if name == "node" else self._code
            except subprocess.TimeoutExpired:
                self._stuck = f"the {name} did not end within {_LONGEST_END:g} s: {self._text(name)[-800:]}"
        path = self._folder / "robot.json"
        with suppress(OSError, ValueError):
            self.seen = json.loads(path.read_text())

    def figures(self, kind: str, trouble: str, left: list[str]) -> Figures:
        """What is to be said about it."""
        seen, trouble = self.seen, trouble or self._stuck
        found = judged(
            kind, seen, self._said, code=self._code, acted=self._acted, end=self._end, log=self._text("node"),
            trouble=trouble, left=left,
        )  # fmt: skip
        moved = seen.get("moved_until_s")
        return {
            "kind": kind,
            "seed": self._seed,
            "as_it_should": found.fine,
            "disturbed": found.disturbed,
            "tries": 1,
            "trouble": trouble,
            "exit_code": self._code,
            "at_s": self._at,
            "to_rest_s": found.to_rest,
            "drive_s": None if moved is None or seen["fast_from_s"] is None else moved - seen["moved_from_s"],
            "named": found.named,
            "log": "" if found.fine else self._text("node"),
            "said": found.said[-4:],
            "left": left,
            "processors": {name: _share(times) for name, times in self._times.items() if len(times) > 1},
            "deviation_m": _deviation(seen) if self._trial.act == "path" and seen else None,
            **{k: v for k, v in seen.items() if k not in ("way", "seed")},
        }


class Judged(NamedTuple):
    """What a trial came to.

    Attributes:
        fine: whether all of it is as it should be.
        to_rest: time from when something went wrong until the robot stood [s]; None where that is not the question.
        named: whether the diagnostics named it, from then on and not before; None where there is nothing to name.
        said: what they said from then on.
        disturbed: whether it says nothing, and has to be made anew: only what was named is not as it should be, and the
            computer did not run the robot for a while before something went wrong, so that its topics were silent then.
    """

    fine: bool
    to_rest: float | None
    named: bool | None
    said: list[str]
    disturbed: bool = False


def judged(
    kind: str,
    seen: Figures,
    said: Sequence[tuple[float, str]],
    *,
    code: int | None,
    acted: float | None,
    end: float,
    log: str,
    trouble: str,
    left: Sequence[str],
) -> Judged:
    """Judge a trial.

    Args:
        kind: one of `KINDS`.
        seen: what the robot tells at its end; empty where it was killed.
        said: when something was said by the diagnostics [s, monotonic], and what.
        code: the node's exit code.
        acted: when something was done to the processes [s, monotonic]; None where nothing was.
        end: where the goal is along the corridor [m].
        log: what the node printed.
        trouble: what went wrong with the trial itself.
        left: processes and files that are left.
    """
    trial = KINDS[kind]
    begin = seen.get("fault_at_s") if trial.fault else None
    if begin is None and acted is not None and seen:
        begin = acted - seen["began_monotonic_s"]
    until = seen.get("stood_from_s" if trial.act == "resume" else "moved_until_s")
    stops = not trial.reaches or trial.act == "resume"
    to_rest = None if begin is None or until is None or not stops else max(until - begin, 0.0)
    since = seen["began_monotonic_s"] + begin if seen and begin is not None else acted
    after = list(dict.fromkeys(text for t, text in said if since is None or t > since))
    before = [text for t, text in said if since is not None and t <= since]
    named = None
    if trial.named:
        named = any(re.search(trial.named, text) for text in after)
        named = named and not any(re.search(trial.named, text) for text in before)
    if trial.reaches:
        x, y = seen["at" if _MAP[0][0] in trial.told else "at_by_odometry"][:2] if seen else (math.nan, math.nan)
        done = abs(x - end) < trial.near and abs(y) < trial.near and code == 0
    else:
        rests = trial.act == "kill executor" or seen.get("last_command_was_rest")
        done = (trial.act == "kill robot" or bool(seen.get("at_rest") and rests)) and code == trial.exits
    moved = trial.fault == "emergency_missing" and (seen.get("path_m") or 0.0) > _MOVED
    wrong = bool(seen.get("contacts_at_speed")) or "Traceback" in log or bool(trouble or left) or moved
    fine = done and named is not False and not wrong
    moves = seen.get("moved_from_s") or 0.0
    silent = [t for t, _ in seen.get("not_run_s", ()) if begin is not None and moves - _BEFORE_IT_MOVED < t < begin]
    return Judged(fine, to_rest, named, after, bool(silent) and done and not wrong and named is False)


def swinging_path(length: float, count: int = 40) -> Array:
    """(count, 3) places of a base on its way along a corridor, once to the left and once to the right."""
    x = np.linspace(0.0, length, count)
    slope = 2.0 * math.pi * _SWING / length
    yaw = np.arctan(slope * np.cos(2.0 * math.pi * x / length))
    return np.column_stack((x, _SWING * np.sin(2.0 * math.pi * x / length), yaw))


def _deviation(seen: Figures) -> float:
    """How far the base truly was from the path that it was to follow, at most [m]."""
    path, way = swinging_path(_LENGTH, 3000)[:, :2], np.array(seen["way"])[:, :2]
    return max(float(np.hypot(*(path - place).T).min()) for place in way)


def _executor_of(node: int) -> int:
    """The process of the executor that a node has started."""
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, IndexError, ValueError):
            parent = int((place / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if parent == node and b"spawn_main" in (place / "cmdline").read_bytes():
                return int(place.name)
    return 0


def _processor_time(number: int) -> float | None:
    """Processor time of a process so far [s]; None where it has ended."""
    try:
        fields = Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()
    except (OSError, IndexError):
        return None
    return (int(fields[11]) + int(fields[12])) / _TICKS


def _share(times: list[tuple[float, float]]) -> float:
    """How much of a processor was used in the last ten seconds."""
    end, used = times[-1]
    begin, before = next(((t, x) for t, x in times if t > end - 10.0), times[0])
    return (used - before) / max(end - begin, 1e-3)


def _end(process: subprocess.Popen[bytes]) -> None:
    with suppress(ProcessLookupError):
        process.kill()
    process.wait()
