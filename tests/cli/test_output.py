"""What commands print: plain elsewhere than on a terminal, and for ``--json -`` nothing but JSON on standard output."""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess
from pathlib import Path

import pytest
from cases import each
from command_line import CALL

from elastic_strips import io, load_robot
from elastic_strips.cli import main
from elastic_strips.robot import robot_names
from elastic_strips.sim.scenarios import scenario_names

ESCAPE = re.compile(r"\x1b\[[0-9;]*m")


def _call(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code


def _on_a_terminal(*arguments: str, **environment: str) -> str:
    """What a command writes to a terminal of 100 columns."""
    ours, theirs = pty.openpty()
    env = {k: v for k, v in os.environ.items() if k != "NO_COLOR"}
    process = subprocess.Popen(
        [*CALL, *arguments], stdout=theirs, stderr=theirs, stdin=subprocess.DEVNULL,
        env={**env, "TERM": "xterm", "COLUMNS": "100", **environment},
    )  # fmt: skip
    os.close(theirs)
    written = b""
    try:
        while chunk := os.read(ours, 65536):
            written += chunk
    except OSError:  # the other end is closed
        pass
    finally:
        os.close(ours)
    process.wait(timeout=120)
    return written.decode().replace("\r\n", "\n")


def test_a_terminal_gets_colour_and_tables() -> None:
    text = _on_a_terminal("run", "case-3", "--preset", "paper")
    assert "\x1b[1;31mblocked\x1b[0m" in text
    assert "\x1b[32mcertified\x1b[0m" in _on_a_terminal("run", "case-1")
    assert "\x1b[1;31merror:\x1b[0m unknown scenario" in _on_a_terminal("run", "case-8")
    listed = _on_a_terminal("list")
    assert ESCAPE.search(listed)
    assert {*scenario_names()} <= set(ESCAPE.sub(" ", listed).split())


@pytest.mark.parametrize("quiet", [{"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_a_terminal_without_colour_gets_what_a_file_gets(
    quiet: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert _call("list") == 0
    plain = capsys.readouterr().out
    assert not ESCAPE.search(plain)
    assert _on_a_terminal("list", **quiet) == plain


def test_the_list_is_a_document(capsys: pytest.CaptureFixture[str]) -> None:
    assert _call("list", "--json", "-") == 0
    printed = capsys.readouterr()
    document = json.loads(printed.out)
    assert "silvermate" in printed.err
    assert [scenario["name"] for scenario in document["scenarios"]] == list(scenario_names())
    assert [robot["name"] for robot in document["robots"]] == list(robot_names())
    assert all(Path(robot["urdf"]).is_file() for robot in document["robots"])
    assert _call("list", "--robots", "--json", "-") == 0
    assert "scenarios" not in json.loads(capsys.readouterr().out)


def test_json_on_standard_output_is_alone_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a command says otherwise goes to standard error; a file named - is never made."""
    robot = load_robot("jackal-box")
    io.write_path(tmp_path / "path.csv", robot, [robot.home(x=x) for x in (0.0, 1.0)])
    (tmp_path / "scene.yaml").write_text("obstacles: []\n")
    (tmp_path / "short.yaml").write_text("robot: jackal-box\nstart: {}\ngoal: {x: 0.5}\nscene: {obstacles: []}\n")
    monkeypatch.chdir(tmp_path)
    for arguments, key, said in (
        (("run", "case-1", "--html", "page.html"), "certified", "case-1"),
        (("run", "case-3", "--preset", "paper"), "certified", "blocked"),
        (("drive", "short.yaml", "--compute", "free"), "reached", "reached"),
        (("certify", "path.csv", "--robot", "jackal-box", "--scene", "scene.yaml"), "verdict", "certified"),
    ):
        code = _call(*arguments, "--json", "-")
        printed = capsys.readouterr()
        document = json.loads(printed.out)
        assert key in document, arguments
        assert said in printed.err
        assert code == (3 if said == "blocked" else 0)
    assert {p.name for p in tmp_path.iterdir()} == {"page.html", "path.csv", "scene.yaml", "short.yaml"}


def test_wrong_input_leaves_standard_output_empty(capsys: pytest.CaptureFixture[str]) -> None:
    assert _call("run", "case-8", "--json", "-") == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "case-8" in printed.err


@each("words", ["run", "run case-1 --sed 3", "run case-1 --seed x", "run case-1 more", "no", "--no", "drag x.json"])
def test_every_error_looks_the_same(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    """One line; where a command is called wrongly, a second one that says where its help is."""
    assert _call(*words.split()) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    error, *more = printed.err.splitlines()
    assert re.match("error: [a-z'-]", error), error
    assert all(re.fullmatch(r"  elastic-strips( run)? --help .*", line) for line in more)
    assert len(more) == (words != "drag x.json")


@pytest.mark.parametrize("words", [()])
def test_a_group_without_a_command_shows_its_help(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert _call(*words) == 2
    printed = capsys.readouterr()
    assert (printed.out + printed.err).startswith("Usage: elastic-strips")
    assert "Commands:" in printed.out + printed.err


@pytest.mark.parametrize("words", [("list",), ("list", "--json", "-"), ("--help",)])
def test_output_that_nobody_takes_ends_a_command_without_a_traceback(words: tuple[str, ...]) -> None:
    """A reader that has gone, a full disk, a closed stream."""
    reader, writer = os.pipe()
    os.close(reader)
    full = os.open("/dev/full", os.O_WRONLY) if os.path.exists("/dev/full") else None
    try:
        gone = subprocess.run([*CALL, *words], stdout=writer, stderr=subprocess.PIPE, text=True)
        assert gone.returncode == 1
        assert "Error" not in gone.stderr
        if full is not None:
            done = subprocess.run([*CALL, *words], stdout=full, stderr=subprocess.PIPE, text=True)
            assert done.returncode == 2
            assert done.stderr.splitlines()[-1].startswith("error: standard output: cannot write: ")
            assert "Traceback" not in done.stderr
    finally:
        os.close(writer)
        if full is not None:
            os.close(full)
    closed = subprocess.run(["sh", "-c", '"$@" >&-', "sh", *CALL, *words], stderr=subprocess.PIPE, text=True)
    assert closed.returncode == 0, closed.stderr
    assert "Traceback" not in closed.stderr


def test_files_are_written_also_where_nobody_reads_what_is_printed(tmp_path: Path) -> None:
    """As by a drive whose report goes to ``head``: the files are named last."""
    files = [str(tmp_path / name) for name in ("result.json", "page.html")]
    reader, writer = os.pipe()
    os.close(reader)
    try:
        words = ("run", "case-1", "--json", files[0], "--html", files[1])
        gone = subprocess.run([*CALL, *words], stdout=writer, stderr=subprocess.PIPE, text=True)
    finally:
        os.close(writer)
    assert gone.returncode == 0, gone.stderr
    assert "Error" not in gone.stderr
    assert all(os.path.getsize(file) for file in files)


def test_a_working_folder_that_was_removed_is_said(tmp_path: Path) -> None:
    gone = 'mkdir "$0" && cd "$0" && rmdir "$0" && "$@"'
    for words, code in ((("list",), 0), (("run", "case-1"), 2), (("sweep", "../s.yaml"), 2)):
        done = subprocess.run(
            ["sh", "-c", gone, str(tmp_path / "gone"), *CALL, *words], stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert done.returncode == code, done.stderr
        assert "Traceback" not in done.stderr
        assert not code or "working folder" in done.stderr or "s.yaml" in done.stderr


def test_a_command_that_is_misspelt_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert _call("sweap") == 2
    assert "did you mean 'sweep'?" in capsys.readouterr().err
