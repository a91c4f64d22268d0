"""Over ROS 2 for real: node and simulated robot in processes of their own, that share nothing but DDS."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import ros_environment

from elastic_strips.ros2.shared_memory import clear_left
from workshop.bench.ros_loopback import own_domain, ports, running, variables

ASK = ("-m", "workshop.bench.ros_ask")
HELD = ExitStack()  # until this process ends
DOMAIN = HELD.enter_context(own_domain())
LONGEST = 60.0  # [s] until something happens that is waited for
EXAMPLE = Path(__file__).parents[2] / "scripts" / "examples" / "18_ros_node.py"
NODE = "from elastic_strips.cli import main\nif __name__ == '__main__':\n    main()\n"


class Drive:
    """A robot and a node that drives it.

    Attributes:
        node, robot: their processes.
        result: what the robot has seen, once it has ended.
    """

    def __init__(
        self,
        python: Path,
        folder: Path,
        told: Sequence[str],
        params: Sequence[str],
        stack: ExitStack,
        *,
        example: bool = False,
    ) -> None:
        self.python, self.folder = python, folder
        self.environment = variables(folder, DOMAIN)
        (folder / "node.py").write_text(NODE)
        node = [str(EXAMPLE)] if example else [str(folder / "node.py"), "ros2", "--goals", "1"]
        self.result: dict[str, object] = {}
        self._stack = stack
        self.robot = self._start(stack, "robot", "-m", "workshop", "ros-robot", *told, "--json", str(folder / "r.json"))
        words = [word for param in params for word in ("-p", param)]
        self.node = self._start(stack, "node", *node, "--ros-args", *words)

    def _start(self, stack: ExitStack, name: str, *words: str | Path) -> subprocess.Popen[bytes]:
        with (self.folder / f"{name}.txt").open("wb") as file:
            process = subprocess.Popen(
                [self.python, *words], stdout=file, stderr=file, env=self.environment, cwd=self.folder
            )
        stack.callback(_end, process)
        return process

    def said(self, name: str) -> str:
        return (self.folder / f"{name}.txt").read_text()

    def ask(self, *what: str) -> str:
        return self.call(*ASK, *what)

    def begin(self, what: str) -> None:
        """Ask for something, and go on at once: on a busy machine the drive may be over when who asked has ended."""
        asking = self._start(self._stack, "ask", *ASK, what)
        self._stack.callback(asking.wait, LONGEST)  # a killed one would leave its ports in shared memory

    def call(self, *words: str | Path) -> str:
        """What another program of this environment prints."""
        done = subprocess.run(
            [self.python, *words], env=self.environment, cwd=self.folder, check=True, timeout=2.0 * LONGEST,
            stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        return done.stdout

    def until(self, name: str, text: str) -> None:
        end = time.monotonic() + LONGEST
        while text not in self.said(name):
            assert time.monotonic() < end, f"nothing like {text!r} in: {self.said('node')}\n{self.said('robot')}"
            time.sleep(0.02)

    def end_robot(self) -> None:
        self.robot.send_signal(signal.SIGINT)
        assert self.robot.wait(LONGEST) == 0, self.said("robot")
        self.result = json.loads((self.folder / "r.json").read_text())


def _end(process: subprocess.Popen[bytes]) -> None:
    with suppress(ProcessLookupError):
        process.kill()
    process.wait()


@pytest.fixture(scope="module")
def python() -> Path:
    found, why = ros_environment.python()
    if why:
        pytest.skip(why)
    return found


@contextmanager
def driven(
    python: Path,
    folder: Path,
    told: Sequence[str] = (),
    params: Sequence[str] = (),
    *,
    example: bool = False,
    killed: bool = False,
) -> Iterator[Drive]:
    before = ports(DOMAIN)
    with ExitStack() as stack:
        yield Drive(python, folder, told, params, stack, example=example)
    if killed:  # the robot has made ports of the dead anew, and the next start removes them
        time.sleep(2.5)
        clear_left()
    assert ports(DOMAIN) <= before
    assert running(folder) == []


def test_a_corridor_is_driven_over_dds(python: Path, tmp_path: Path):
    """By the example, with sensors of best effort at 50 Hz, as drivers have them."""
    with driven(python, tmp_path, ["--seed", "1", "--length", "3"], example=True) as drive:
        drive.ask("3,0,0")
        assert drive.node.wait(LONGEST) == 0, drive.said("node")
        drive.end_robot()
    assert "Traceback" not in drive.said("node")
    assert "the robot is at rest: reached" in drive.said("node")
    seen = drive.result
    assert seen["path_m"] > 2.5  # type: ignore[operator]
    assert (seen["contacts_at_speed"], seen["contacts_at_rest"]) == (0, 0)
    assert seen["top_speed_mps"] < 0.65, "0.6 of its speeds"  # type: ignore[operator]
    assert seen["at_rest"]
    assert seen["last_command_was_rest"]


def test_ctrl_c_at_speed_brings_the_robot_to_rest(python: Path, tmp_path: Path):
    """One with mass and contacts, on the way to where its hand is to be: so far that no slow machine sees it arrive."""
    plant = ["--plant", "mujoco"] if find_spec("mujoco") else []
    with driven(python, tmp_path, ["--seed", "1", "--length", "14", *plant], ["hand:=palm_link"]) as drive:
        drive.begin("hand:13,0,1")
        drive.until("robot", "it moves fast")
        drive.node.send_signal(signal.SIGINT)
        assert drive.node.wait(LONGEST) == 130, drive.said("node")
        drive.end_robot()
    assert "Traceback" not in drive.said("node")
    seen = drive.result
    assert seen["at_rest"]
    assert seen["last_command_was_rest"]
    assert seen["contacts_at_speed"] == 0
    assert 0.0 < seen["path_m"] < 11.0  # type: ignore[operator]


def test_a_killed_node_leaves_a_robot_at_rest_and_nothing_else(python: Path, tmp_path: Path):
    """The executor's process brings it to rest."""
    with driven(python, tmp_path, ["--seed", "1"], killed=True) as drive:
        drive.begin("6,0,0")
        drive.until("robot", "it moves fast")
        drive.node.kill()
        drive.node.wait()
        drive.until("robot", "it stands again")
        end = time.monotonic() + LONGEST
        while any("spawn_main" in line for line in running(tmp_path)):
            assert time.monotonic() < end, "the executor's process goes on"
            time.sleep(0.05)
        drive.end_robot()
    seen = drive.result
    assert seen["at_rest"]
    assert seen["contacts_at_speed"] == 0
    assert seen["last_command_was_rest"]


def test_a_goal_gives_way_to_another_and_a_stop_can_be_taken_back(python: Path, tmp_path: Path):
    """All of it asked for at speed, over topics and services."""
    with driven(python, tmp_path, ["--seed", "2"]) as drive:
        drive.begin("6,0,0")
        drive.until("robot", "it moves fast")
        drive.ask("4,0,0", "stop")
        drive.until("robot", "it stands again")
        assert drive.node.poll() is None, "a robot that was stopped waits"
        shown = {name for _, name, _ in json.loads(drive.ask("markers"))}
        assert shown >= {"strip_base", "strip_hand", "obstacles"}
        assert drive.ask("speed:0.9", "speed:0.5", "resume").split() == ["False", "True"], "it was started with 0.6"
        assert drive.node.wait(LONGEST) == 0, drive.said("node")
        drive.end_robot()
    x, y, _ = drive.result["at"]  # type: ignore[misc]
    assert abs(x - 4.0) + abs(y) < 0.5, "by odometry that slips"
    assert drive.result["contacts_at_speed"] == 0


def test_somebody_elses_velocities_are_guarded(python: Path, tmp_path: Path):
    """Full speed at pillars and walls, mixed with what is no command; and the footprint that others are told."""
    with driven(python, tmp_path, ["--seed", "4"], ["mode:=guard"]) as drive:
        drive.until("node", "ready for commands")
        frame, corners = json.loads(drive.ask("footprint"))
        markers = json.loads(drive.ask("markers"))
        drive.call("-m", "workshop", "ros-pilot", "--seed", "4", "--for", "6", "--spoilt")
        drive.node.send_signal(signal.SIGINT)
        assert drive.node.wait(LONGEST) == 130, drive.said("node")
        drive.end_robot()
    assert "Traceback" not in drive.said("node")
    assert "left out: cmd_vel_in" in drive.said("node")
    seen = drive.result
    assert seen["path_m"] > 0.5  # type: ignore[operator]
    assert seen["contacts_at_speed"] == 0
    assert seen["at_rest"]
    assert seen["last_command_was_rest"]
    assert {frame for frame, *_ in markers} == {"odom"}
    assert {name for _, name, _ in markers} == {"obstacles"}, "it stood, and has no strip"
    assert len({(name, number) for _, name, number in markers}) == len(markers)
    assert frame == "base_link"
    x, y = np.array(corners).T
    area = 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    assert 0.2 < area < 0.35


def test_what_a_paused_robot_hears_holds_only_from_then_on(python: Path, tmp_path: Path):
    """The simulated robot makes up the time in which its computer ran nothing: with what it had been told before."""
    environment, result = variables(tmp_path, DOMAIN), tmp_path / "r.json"
    topics = ("-r", "cmd_vel_in:=cmd_vel", "-r", "joint_velocities_in:=arm_velocity_controller/commands")
    calls = (
        ("ros-robot", "--seed", "1", "--arm", "velocity", "--json", str(result)),
        ("ros-pilot", "--seed", "1", "--for", "60", "--ros-args", *topics),
    )
    with ExitStack() as stack:
        robot, pilot = (
            subprocess.Popen(
                [python, "-m", "workshop", *words], env=environment, cwd=tmp_path, text=True,
                stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            ) for words in calls
        )  # fmt: skip
        for process in (robot, pilot):
            stack.callback(_end, process)
        assert robot.stderr
        assert any("it moves fast" in line for line in robot.stderr)
        for _ in range(3):  # where nothing of DDS ran before the steps were made up, one shows nothing
            time.sleep(0.3)
            robot.send_signal(signal.SIGSTOP)
            time.sleep(1.5)
            robot.send_signal(signal.SIGCONT)
        time.sleep(0.3)
        robot.send_signal(signal.SIGINT)
        pilot.send_signal(signal.SIGINT)
        assert robot.wait(LONGEST) == 0
        pilot.wait(LONGEST)
    way = np.array(json.loads(result.read_text())["way"])
    moves = np.abs(np.diff(way, axis=0)).max(axis=1) > 1e-4
    assert np.sum(~moves[np.argmax(moves) :]) >= 12, "it was told nothing for three times 1.5 s"
