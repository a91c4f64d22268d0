"""Malformed input ends with a typed error, or exit code 2 and one readable message, and leaves no file behind."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from call_cases import CallCase, call_cases
from command_cases import CommandCase, command_cases, result_cases
from malformed_case import FileCase
from urdf_cases import SOUND, SOUND_SRDF, srdf_cases, urdf_cases
from yaml_cases import SCENARIO, SCENE, scenario_cases, scene_cases

import elastic_strips as es
from elastic_strips.cli import main
from elastic_strips.errors import InputError

LONGEST = 1000
"""Most characters of a readable message."""

FILES = (*urdf_cases(), *srdf_cases(), *scene_cases(), *scenario_cases())
RESULTS = tuple(result_cases(SOUND))
CALLS = tuple(call_cases())
COMMANDS = tuple(command_cases())


def _ids(cases: tuple[Any, ...]) -> dict[str, Any]:
    return {"argvalues": cases, "ids": [case.name.replace(" ", "-") for case in cases]}


def _load(case: FileCase, path: Path) -> object:
    """Use the file as the API does."""
    return {
        "urdf": lambda: es.load_robot(path, base="omni"),
        "srdf": lambda: es.load_robot(path.parent / "small.urdf", base="omni", srdf=path),
        "scene": lambda: es.read_scene(path),
        "scenario": lambda: es.run_scenario(es.get_scenario(path)),
    }[case.name.split(":")[0]]()


def _arguments(case: FileCase, path: Path, out: Path) -> list[str] | None:
    """A command line that uses the file; None where no command does."""
    kind = case.name.split(":")[0]
    if kind == "scene":
        beside = path.parent / "around.yaml"
        beside.write_text(f"robot: silvermate\nscene: {path.name}\nstart: {{}}\ngoal: {{x: 4}}\n")
        path = beside
    output = ["--json", str(out / "kept.json")]
    return {
        "urdf": ["run", "case-1", "--robot", str(path), *output],
        "scene": ["run", str(path), *output],
        "scenario": ["run", str(path), *output, "--html", str(out / "page.html")],
        "result": ["view", str(path), "--html", str(out / "page.html")],
    }.get(kind)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """An output folder with an older result in it."""
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "kept.json").write_text('{"older": "result"}')
    return folder


def _tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# what may stand beside the message: click's usage, and what Coal prints about NaN and urdfdom about a shape it drops
_BESIDE = (
    "Usage: elastic-strips",
    "Try 'elastic-strips",
    "eigen: too many iterations",
    "Error:   ",
    "         at line ",
)


def _check_message(errors: str) -> str:
    """One message, for people; returns it."""
    lines = [line for line in errors.splitlines() if line.strip()]
    messages = [line for line in lines if not line.startswith(_BESIDE)]
    assert len(messages) == 1, errors[:2000]
    assert "Traceback" not in errors
    assert messages[0].lower().startswith("error: "), messages[0]
    assert messages[0][7:].strip()
    assert len(messages[0]) <= LONGEST
    return messages[0]


def _refused(arguments: list[str], folder: Path, capfd: pytest.CaptureFixture[str]) -> str:
    before = _tree(folder)
    capfd.readouterr()
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    printed = capfd.readouterr()
    assert ended.value.code == 2, (ended.value.code, printed)
    assert _tree(folder) == before
    return _check_message(printed.err)


@pytest.mark.parametrize("case", **_ids(FILES))
def test_a_malformed_file_raises_a_typed_error_that_names_the_fault(case: FileCase, tmp_path: Path) -> None:
    """The API's error has the right type and names file, element and value."""
    path = case.write(tmp_path)
    with pytest.raises(case.error) as raised:
        _load(case, path)
    message = str(raised.value)
    assert isinstance(raised.value, InputError)
    assert not [words for words in case.says if words not in message], message
    assert not case.names_file or path.stem in message, message
    assert len(message) <= LONGEST
    assert "\n" not in message


@pytest.mark.parametrize("case", **_ids((*(c for c in FILES if not c.name.startswith("srdf")), *RESULTS)))
def test_a_malformed_file_ends_the_command_with_exit_code_2(
    case: FileCase, tmp_path: Path, out: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command line says the same in one message, and no output appears or changes."""
    monkeypatch.chdir(tmp_path)
    path = case.write(tmp_path)
    arguments = _arguments(case, path, out)
    assert arguments is not None
    message = _refused(arguments, out, capfd)
    assert not [words for words in case.says if words not in message], message
    assert not case.names_file or path.stem in message, message


@pytest.mark.parametrize("case", **_ids(CALLS))
def test_a_wrong_call_raises_a_typed_error_that_names_the_fault(case: CallCase, silvermate: es.RobotModel) -> None:
    """The library names the argument, its value and what would be valid."""
    with pytest.raises(case.error) as raised:
        case.call(silvermate)
    message = str(raised.value)
    assert not [words for words in case.says if words not in message], message
    assert len(message) <= LONGEST


def _filled(case: CommandCase, tmp_path: Path, out: Path) -> tuple[list[str], list[str]]:
    folder = tmp_path / "in"
    folder.mkdir()
    for name, content in case.beside.items():
        assert isinstance(content, str)
        (folder / name).write_text(content)
    places = {"{out}": str(out), "{in}": str(folder)}

    def fill(text: str) -> str:
        for mark, place in places.items():
            text = text.replace(mark, place)
        return text

    return [fill(a) for a in case.arguments], [fill(s) for s in case.says]


@pytest.mark.parametrize("case", **_ids(COMMANDS))
def test_a_wrong_command_line_ends_with_exit_code_2(
    case: CommandCase, tmp_path: Path, out: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wrong option names itself, its value and what would be valid; nothing is written."""
    monkeypatch.chdir(tmp_path)
    arguments, says = _filled(case, tmp_path, out)
    message = _refused(arguments, tmp_path, capfd)
    assert not [words for words in says if words not in message], message


_SAMPLE = (*FILES[2::30], *RESULTS[::13], *COMMANDS[::18])


@pytest.mark.parametrize("case", **_ids(_SAMPLE))
def test_a_process_of_its_own_behaves_the_same(case: FileCase | CommandCase, tmp_path: Path, out: Path) -> None:
    """A sample of all kinds through a real process: exit code, message, no hang, no file."""
    if isinstance(case, CommandCase):
        arguments, says = _filled(case, tmp_path, out)
    else:
        given = _arguments(case, case.write(tmp_path), out)
        if given is None:
            pytest.skip("no command reads an SRDF by itself")
        arguments, says = given, list(case.says)
    before = _tree(tmp_path)
    call = [sys.executable, "-c", "from elastic_strips.cli import main; main()", *arguments]
    ended = subprocess.run(call, capture_output=True, text=True, timeout=25, cwd=tmp_path, env=os.environ, check=False)
    assert ended.returncode == 2, ended
    message = _check_message(ended.stderr)
    assert not [words for words in says if words not in message], message
    assert _tree(tmp_path) == before


def test_there_are_at_least_200_different_inputs(tmp_path: Path) -> None:
    """Files count by what stands at their path and beside it, calls and commands by what they are."""
    inputs: set[Any] = set()
    for k, case in enumerate((*FILES, *RESULTS)):
        kind = case.name.split(":")[0]
        if callable(case.content):
            inputs.add((kind, case.name))
        else:
            folder = tmp_path / str(k)
            folder.mkdir()
            case.write(folder)
            regular = {name: content for name, content in case.beside.items() if isinstance(content, (str, bytes))}
            inputs.add((kind, case.content, tuple(sorted(regular.items()))))
    inputs |= {
        case.call.__code__.co_code + repr(case.call.__code__.co_consts).encode() + case.name.encode() for case in CALLS
    }
    inputs |= {case.arguments for case in COMMANDS}
    assert len(inputs) >= 200
    assert len(inputs) == len(FILES) + len(RESULTS) + len(CALLS) + len(COMMANDS)


def test_the_sound_originals_are_accepted(tmp_path: Path, out: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """What the malformed files were made from is fine: each of them fails for its one fault."""
    (tmp_path / "small.urdf").write_text(SOUND)
    (tmp_path / "small.srdf").write_text(SOUND_SRDF)
    (tmp_path / "scene.yaml").write_text(SCENE)
    (tmp_path / "scenario.yaml").write_text(SCENARIO)
    robot = es.load_robot(tmp_path / "small.urdf", base="omni", srdf=tmp_path / "small.srdf")
    assert robot.joint_names == ("shoulder", "slide")
    assert es.read_scene(tmp_path / "scene.yaml").names == ("table",)
    with pytest.raises(SystemExit) as ended:
        main(
            [
                "run",
                str(tmp_path / "scenario.yaml"),
                "--robot",
                str(tmp_path / "small.urdf"),
                "--json",
                str(out / "r.json"),
            ]
        )
    assert ended.value.code == 0
    with pytest.raises(SystemExit) as ended:
        main(["view", str(out / "r.json"), "--html", str(out / "page.html")])
    assert ended.value.code == 0
    assert (out / "page.html").stat().st_size > 100_000
    assert capfd.readouterr().err == ""


@pytest.mark.skipif(os.geteuid() == 0, reason="root can read and write everything")
def test_what_may_not_be_read_or_written_is_refused(
    tmp_path: Path, out: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Permissions are named, for inputs and for outputs."""
    path = tmp_path / "secret.urdf"
    path.write_text(SOUND)
    path.chmod(0)
    assert "Permission denied" in _refused(["run", "case-1", "--robot", str(path)], out, capfd)
    out.chmod(0o500)
    assert "not writable" in _refused(["run", "case-1", "--json", str(out / "r.json")], out, capfd)
    out.chmod(0o700)
