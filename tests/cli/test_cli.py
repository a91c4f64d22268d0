"""The command line: what it prints and writes, its exit codes, and how it ends when it is interrupted."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest
from command_line import CALL, interrupted

from elastic_strips import __version__
from elastic_strips.cli import main
from elastic_strips.cli.group import cli
from elastic_strips.cli.options import GoalText, JointValue
from elastic_strips.cli.scene_options import Pose
from elastic_strips.io import load_path
from elastic_strips.robot import load_robot, robot_names
from elastic_strips.sim.scenarios import scenario_names

DOCS = Path(__file__).parents[2] / "docs" / "result-format.md"
SHUT_IN = """robot: silvermate
start: {x: -3}
goal: {x: 3}
scene:
  obstacles:
    - {shape: box, name: north, size: [3, 0.1, 2], at: [3, 1.5, 1]}
    - {shape: box, name: south, size: [3, 0.1, 2], at: [3, -1.5, 1]}
    - {shape: box, name: east, size: [0.1, 3.1, 2], at: [4.5, 0, 1]}
    - {shape: box, name: west, size: [0.1, 3.1, 2], at: [1.5, 0, 1]}
"""
"""A goal within four walls."""


def call(*arguments: str) -> int:
    """Exit code of a command line in this process."""
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code


def _object(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("words", ["bench plan", "study paper", "drive case-1 --method vfh"])
def test_what_a_checkout_has_is_said(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(*words.split()) == 2
    assert "python -m workshop" in capsys.readouterr().err


def test_help_and_version(capsys: pytest.CaptureFixture[str]) -> None:
    """Help names every command and exit code; each command has its own."""
    assert call("--help") == 0
    text = capsys.readouterr().out
    for word in ("run", "view", "sweep", "list", "0 certified", "2 wrong input", "3 blocked", "130"):
        assert word in text
    for command in ("run", "view", "list", "sweep", "certify"):
        assert call(*command.split(), "-h") == 0
        assert f"Usage: elastic-strips {command}" in capsys.readouterr().out
    assert call("--version") == 0
    assert __version__ in capsys.readouterr().out


def test_every_number_has_a_unit() -> None:
    """... or it is a count, which its name or help says, or is said to be a multiple of something."""
    checked = 0
    for name in cli.list_commands(click.Context(cli)):
        command = cli.get_command(click.Context(cli), name)
        assert command is not None
        for option in command.params:
            if isinstance(option, click.Option) and _takes_a_measure(option.type):
                said = re.search(r"\[[^]]*\b(m|rad|s)\b[^]]*\]|\bmultiple of\b", option.help or "")
                assert said, (name, option.opts)
                checked += 1
    assert checked > 40


def _takes_a_measure(kind: click.ParamType[Any]) -> bool:
    """Whether it takes numbers that are no counts."""
    if isinstance(kind, click.Tuple):
        return any(map(_takes_a_measure, kind.types))
    return isinstance(kind, (type(click.FLOAT), JointValue, GoalText, Pose))


def test_help_says_which_names_may_be_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    """And what is taken then."""
    for words in _commands(cli):
        command: click.Command = cli
        for word in words:
            assert isinstance(command, click.Group)
            command = command.get_command(click.Context(command), word) or command
        arguments = [p for p in command.params if isinstance(p, click.Argument)]
        assert call(*words, "--help") == 0
        said = capsys.readouterr().out
        for argument in arguments:
            assert str(argument.metavar).startswith("[") is not argument.required, said
            assert argument.required or argument.nargs != 1 or str(argument.default) in said
    assert call("drag", "--help") == 0
    assert "drag [OPTIONS] [NAME|FILE.yaml]" in capsys.readouterr().out


def _commands(command: click.Command, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    yield words
    if isinstance(command, click.Group):
        for name in command.list_commands(click.Context(command)):
            found = command.get_command(click.Context(command), name)
            assert found is not None
            yield from _commands(found, (*words, name))


def test_help_stands_on_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    """No help points to a file of the checkout, which an installed wheel has not."""
    every = list(_commands(cli))
    assert len(every) > 8
    for words in every:
        assert call(*words, "--help") == 0
        text = capsys.readouterr().out
        assert not re.search(r"\b(docs|scripts|tests|shared|notebooks)/|README|CHANGELOG|[a-z]\.md\b", text), words


def test_list_names_everything(capsys: pytest.CaptureFixture[str]) -> None:
    """Scenarios, robots and presets, by the names that the options take."""
    assert call("list") == 0
    names = {line.split()[0] for line in capsys.readouterr().out.splitlines() if line.startswith("  ")}
    own = {"silvermate", "jackal-box", "bridge-arm", "tiago"}
    assert names == {*scenario_names(), *own, "and", "default", "paper"}
    assert call("list", "--robots") == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(robot_names())


def test_a_certified_run_ends_with_0(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The summary says so, the file holds it, the page shows it, and nothing else is left in the folder."""
    result, page = tmp_path / "r.json", tmp_path / "page.html"
    assert call("run", "case-7", "--json", result, "--html", page) == 0
    printed = capsys.readouterr()
    assert "certified" in printed.out
    assert str(result) in printed.out
    assert printed.err == ""
    assert _object(result)["certified"] is True
    assert page.read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype html")
    assert {p.name for p in tmp_path.iterdir()} == {"r.json", "page.html"}


def test_a_blocked_run_ends_with_3_and_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Case 3 of the paper: no certificate is claimed, the reason is printed and written."""
    assert call("run", "case-3", "--preset", "paper", "--json", tmp_path / "r.json") == 3
    document = _object(tmp_path / "r.json")
    assert document["status"] == "blocked"
    assert document["certified"] is False
    assert document["reason"] in capsys.readouterr().out


def test_where_there_is_no_way_the_run_ends_with_3(tmp_path: Path) -> None:
    """A goal within walls: the best strip is written, and where it is broken."""
    (tmp_path / "walls.yaml").write_text(SHUT_IN)
    assert call("run", tmp_path / "walls.yaml", "--timeout", "0.5", "--json", tmp_path / "r.json") == 3
    document = _object(tmp_path / "r.json")
    assert document["certified"] is False
    assert document["time_to_certified_ms"] is None
    assert not all(document["segments"])
    broken = document["broken"]
    assert broken["obstacle"] in {"north", "south", "east", "west"}
    assert document["segments"][broken["segment"]] is False
    _check_types(document)


def test_a_start_that_touches_is_left_where_that_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The palm is 2.1 mm in a wall: refused, or left; then the result has both parts, and is not certified."""
    scenario, result = tmp_path / "touch.yaml", tmp_path / "r.json"
    scenario.write_text(
        "robot: silvermate\nbase: diff_drive\nstart: {x: 0}\ngoal: {x: -2}\nscene:\n  obstacles:\n"
        "    - {shape: box, name: wall, size: [0.2, 3, 3], at: [0.438, 0, 0]}\n"
    )
    assert call("run", str(scenario)) == 2
    assert "--start-depth" in capsys.readouterr().err
    assert call("run", str(scenario), "--start-depth", "0.001") == 2
    assert call("run", str(scenario), "--start-depth", "0.01", "--json", str(result)) == 3
    document = _object(result)
    assert document["certified"] is False
    assert document["status"] == "departed"
    assert all(document["segments"])
    left = document["departure"]
    assert left["rest"] == "certified"
    assert [contact["two"] for contact in left["contacts"]] == ["wall"] * len(left["contacts"])
    assert left["depth"] == pytest.approx(0.0021, abs=3e-4)


def test_without_obstacles_there_is_no_clearance(tmp_path: Path) -> None:
    """Infinity is no number of JSON: null."""
    (tmp_path / "empty.yaml").write_text("robot: silvermate\nstart: {}\ngoal: {x: 2}\nscene: {obstacles: []}\n")
    assert call("run", tmp_path / "empty.yaml", "--json", tmp_path / "r.json") == 0
    document = _object(tmp_path / "r.json")
    assert document["clearance_m"] is None
    assert document["obstacles"] == []
    _check_types(document)


def test_a_run_writes_its_trajectory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "t.json"
    assert call("run", "case-1", "--trajectory", target) == 0
    assert f"trajectory  {target}" in capsys.readouterr().out
    robot = load_robot("silvermate")
    path = load_path(target, robot)
    assert path.times is not None
    assert path.times[-1] > 5.0
    assert call("run", "case-3", "--preset", "paper", "--trajectory", tmp_path / "u.csv") == 3  # blocked
    assert "no trajectory: the strip is not certified" in capsys.readouterr().out
    assert call("run", "case-1", "--trajectory", tmp_path / "t.xml") == 2
    assert "Valid: .csv, .json, .mcap, .npz." in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [target]


def test_what_changes_with_time_is_said_and_trajectories_are_certified_by_their_times(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    moves = "{name: ball, shape: sphere, radius: 0.3, at: [2, -2, 0.5], motion: {twist: {linear: [0, 1, 0]}}}"
    (tmp_path / "moves.yaml").write_text(
        f"robot: jackal-box\nscene: {{obstacles: [{moves}]}}\nstart: {{x: 0}}\ngoal: {{x: 4}}\n"
    )
    # as it stands at 0 s, the ball is beside the way; it comes as the robot does
    assert call("run", tmp_path / "moves.yaml", "--json", tmp_path / "m.json") == 0
    assert json.loads((tmp_path / "m.json").read_text())["changes_with_time"] == ["ball"]
    assert "ball" in capsys.readouterr().out
    assert call("run", tmp_path / "moves.yaml", "--trajectory", tmp_path / "m.csv") == 3
    assert not (tmp_path / "m.csv").exists()


def test_the_same_seed_gives_the_same_strip(tmp_path: Path) -> None:
    """Planner included; another seed gives another scene."""
    for name, seed in (("a", "2"), ("b", "2"), ("c", "3")):
        assert call("run", "corridor", "--seed", seed, "--json", tmp_path / f"{name}.json") == 0
    a, b, c = (_object(tmp_path / f"{name}.json") for name in "abc")
    assert a["strip"] == b["strip"]
    assert a["seed"] == 2
    assert a["obstacles"] != c["obstacles"]


# --- the documented format ---------------------------------------------------------------------------------------


def _documented() -> dict[str, str]:
    """Key → type, from the table of fields."""
    text = DOCS.read_text(encoding="utf-8")
    table = text[text.index("## Fields") : text.index("`strip` holds")]
    return {key: kind.strip() for key, kind in re.findall(r"^\| `(\w+)` \| ([^|]+) \|", table, flags=re.MULTILINE)}


_TYPES: dict[str, tuple[type, ...]] = {
    "string": (str,),
    "integer": (int,),
    "number": (int, float),
    "boolean": (bool,),
    "object": (dict,),
    "null": (type(None),),
}


def _check_types(document: dict[str, Any]) -> None:
    """Exactly the documented keys, each of its documented type."""
    documented = _documented()
    assert set(document) == set(documented)
    for key, kind in documented.items():
        value = document[key]
        if kind.startswith("list of "):
            entry = {"list of booleans": bool, "list of objects": dict, "list of strings": str}[kind.split(",")[0]]
            assert isinstance(value, list), key
            assert all(type(item) is entry for item in value), key
            continue
        allowed = tuple(t for word in kind.split(" or ") for t in _TYPES[word])
        assert isinstance(value, allowed), (key, value, kind)
        assert isinstance(value, bool) == (kind == "boolean"), key


@pytest.mark.parametrize("arguments", [("case-7",), ("case-3", "--preset", "paper"), ("case-1", "--robot", "tiago")])
def test_the_result_has_the_documented_fields(arguments: tuple[str, ...], tmp_path: Path) -> None:
    """The table of docs/result-format.md is what the program writes."""
    call("run", *arguments, "--json", tmp_path / "r.json")
    document = _object(tmp_path / "r.json")
    _check_types(document)
    assert document["format"] == "elastic-strips-result"
    assert document["version"] == 1
    assert document["nodes"] == len(document["strip"]["q"]) == len(document["segments"]) + 1
    assert set(document["strip"]) == {"joint_names", "q"}
    assert set(document["tick_ms"]) == {"p50", "p95", "p99"}
    assert all(set(entry) == {"name", "shape", "size", "pose"} for entry in document["obstacles"])
    assert Path(document["urdf"]).is_file()


def test_the_documented_check_works(tmp_path: Path) -> None:
    """The program in docs/result-format.md runs as printed and finds the stated clearance."""
    (program,) = re.findall(r"```python result check\n(.*?)```", DOCS.read_text(encoding="utf-8"), flags=re.DOTALL)
    call("run", "case-7", "--json", tmp_path / "r.json")
    ended = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "r.json")],
        capture_output=True,
        text=True,
        timeout=240,
        check=True,
    )
    stated, sampled = map(float, re.findall(r"-?\d+\.\d+", ended.stdout))
    assert stated == pytest.approx(_object(tmp_path / "r.json")["clearance_m"], abs=1e-4)
    assert stated - 1e-4 <= sampled <= stated + 5e-3


def test_what_was_mended_in_a_file_is_said(tmp_path: Path) -> None:
    (tmp_path / "odd.urdf").write_text(
        '<robot><link name="base"><collision><geometry><sphere radius="0.1"/></geometry></collision></link></robot>'
    )
    ended = subprocess.run(
        [*CALL, "run", "case-1", "--robot", "odd.urdf", "--base", "omni"],
        capture_output=True, text=True, cwd=tmp_path, timeout=240,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    assert re.fullmatch(r"warning: .*robot without a name, called: 'odd'\s*", ended.stderr)


# --- view --------------------------------------------------------------------------------------------------------


def test_view_writes_a_page_of_a_scenario_and_of_a_result(tmp_path: Path) -> None:
    """Before a run: the straight strip; after it: the strip of the file, which the page's data tells apart."""
    before, after = tmp_path / "before.html", tmp_path / "after.html"
    assert call("view", "case-5", "--html", before) == 0
    assert call("run", "case-5", "--json", tmp_path / "r.json") == 0
    assert call("view", tmp_path / "r.json", "--html", after) == 0
    pages = [p.read_text(encoding="utf-8") for p in (before, after)]
    assert all(page.lstrip().lower().startswith("<!doctype html") for page in pages)
    assert pages[0] != pages[1]


# --- interrupted -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("after", [0.5, 2.5])
def test_ctrl_c_while_planning_ends_with_130(tmp_path: Path, after: float) -> None:
    """One word on standard error, no traceback, no file, the older result untouched."""
    (tmp_path / "walls.yaml").write_text(SHUT_IN)
    (tmp_path / "r.json").write_text("older")
    ended = interrupted(
        ["run", "walls.yaml", "--timeout", "60", "--json", "r.json", "--html", "p.html"], tmp_path, after=after
    )
    assert ended.returncode == 130, ended
    assert "Traceback" not in ended.stderr
    assert ended.stderr.strip().splitlines()[-1] == "interrupted"
    assert {p.name for p in tmp_path.iterdir()} == {"walls.yaml", "r.json"}
    assert (tmp_path / "r.json").read_text() == "older"


def test_ctrl_c_during_a_late_import_is_not_lost(tmp_path: Path) -> None:
    """In a callback of the interpreter, as imports have them, an exception is printed and forgotten."""
    (tmp_path / "late.py").write_text(
        "import os, signal, weakref\n"
        "class Thing: pass\n"
        "thing = Thing()\n"
        "watch = weakref.ref(thing, lambda _: os.kill(os.getpid(), signal.SIGINT))\n"
        "del thing\n"
    )
    program = (
        "import signal, time\n"
        "from elastic_strips.cli import unlost_interrupts\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "try:\n"
        "    with unlost_interrupts():\n"
        "        import late\n"
        "        time.sleep(20)\n"
        "except KeyboardInterrupt:\n"
        "    print('heard')\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert ended.stdout == "heard\n", ended.stderr


def test_ctrl_c_is_heard_where_the_command_line_is_called_while_a_module_is_imported(tmp_path: Path) -> None:
    (tmp_path / "caller.py").write_text(
        "import os, signal, time\n"
        "import elastic_strips.cli.group as group\n"
        "from elastic_strips.cli import main\n"
        "def interrupted(arguments):\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    time.sleep(20)\n"
        "group.run_cli = interrupted\n"
        "main([])\n"
    )
    program = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); import caller"
    ended = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert ended.returncode == 130, ended
    assert ended.stderr == "interrupted\n"


def test_ctrl_c_closes_the_viewer(tmp_path: Path) -> None:
    """The viewer listens on this machine until Ctrl-C, which is its proper end."""
    ended = interrupted(["view", "case-1"], tmp_path, printed="127.0.0.1", after=0.3)
    assert ended.returncode in (0, 130), ended
    assert "Traceback" not in ended.stderr


def test_a_reader_that_goes_away_is_no_error(tmp_path: Path) -> None:
    """``elastic-strips list | head -0``: no traceback."""
    process = subprocess.Popen(
        [*CALL, "list"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path, env=os.environ
    )
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    assert process.wait(timeout=120) in (0, 1, 120)
    errors = process.stderr.read().decode()
    process.stderr.close()
    assert "Traceback" not in errors
