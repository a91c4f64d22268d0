"""Malformed input ends with a typed error, or exit code 2 and one readable message, and leaves no file behind."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bad_workers
import mutate
import pytest
from call_cases import call_cases
from command_cases import command_cases, result_cases
from malformed_case import FileCase, no_hang, special
from seeds import Seed, seeds
from urdf_cases import SOUND, SOUND_SRDF, srdf_cases, urdf_cases
from yaml_cases import SCENARIO, SCENE, scenario_cases, scene_cases

import elastic_strips as es
from elastic_strips.cli import main
from elastic_strips.cli.view_command import _from_result
from elastic_strips.errors import InputError
from elastic_strips.sim.scenarios import get_scenario, run_scenario

LONGEST = 1000
"""Most characters of a readable message."""

_READERS: dict[str, Callable[[Path], object]] = {
    "urdf": lambda path: es.load_robot(path, base="omni"),
    "srdf": lambda path: es.load_robot(path.parent / "small.urdf", base="omni", srdf=path),
    "scene": es.read_scene,
    "scenario": lambda path: run_scenario(get_scenario(path)),
    "result": lambda path: _from_result(path, str(path.parent / "small.urdf")),
}


def _check_all(cases: Iterable[Any], check: Callable[[int, Any], None]) -> None:
    """Check every case of a table; all that fail are told, by name."""
    failed = []
    for k, case in enumerate(cases):
        try:
            with no_hang():
                check(k, case)
        except Exception as error:
            failed.append(f"{case.name}: {type(error).__name__}: {str(error)[:500]}")
    assert not failed, "\n".join(failed)


def _check_error(error: InputError, kind: type[InputError], says: Iterable[str]) -> None:
    message = str(error)
    assert isinstance(error, kind), type(error)
    assert not [words for words in says if words not in message], message
    assert len(message) <= LONGEST
    assert "\n" not in message


@pytest.mark.parametrize(
    "cases",
    [urdf_cases, srdf_cases, scene_cases, scenario_cases, lambda: result_cases(SOUND)],
    ids=["urdf", "srdf", "scene", "scenario", "result"],
)
def test_a_malformed_file_raises_a_typed_error_that_names_the_fault(
    cases: Callable[[], Iterator[FileCase]], tmp_path: Path
) -> None:
    """The error has the right type and names file, element and value."""

    def check(k: int, case: FileCase) -> None:
        (tmp_path / str(k)).mkdir()
        path = case.write(tmp_path / str(k))
        with pytest.raises(InputError) as raised:
            _READERS[case.name.split(":")[0]](path)
        _check_error(raised.value, case.error, (*case.says, *([path.stem] if case.names_file else [])))

    _check_all(cases(), check)


def test_a_wrong_call_raises_a_typed_error_that_names_the_fault(silvermate: es.RobotModel) -> None:
    """The library names the argument, its value and what would be valid."""

    def check(_: int, case: Any) -> None:
        with pytest.raises(InputError) as raised:
            case.call(silvermate)
        _check_error(raised.value, case.error, case.says)

    _check_all(call_cases(), check)


def test_every_reader_takes_regular_files_only_within_its_size(tmp_path: Path) -> None:
    """FIFO, device, folder, nothing and a file of 300 MB, in place of every file of every kind: refused at once."""
    for k, seed in enumerate(seeds()):
        for kind in ("a FIFO", "endless", "a folder", "nothing", "too large"):
            folder = tmp_path / f"{k} {kind}"
            folder.mkdir()
            for name, content in seed.beside.items():
                (folder / name).write_bytes(content)
            special(kind, folder / seed.file)
            with no_hang(), pytest.raises(InputError) as raised:
                seed.reader(folder / seed.file)
            assert Path(seed.file).stem in str(raised.value), (seed.kind, kind)


def test_mutated_files_are_accepted_or_refused_by_a_typed_error(tmp_path: Path, brief: bool) -> None:
    """A few of what ``mutate.py`` makes by the thousand, here in this process; see docs/input-files.md."""
    found, outcomes = seeds(), []
    gc.collect()
    gc.freeze()  # what the whole session holds need not be looked at again before each input
    for k in range(18 if brief else 0, 36):  # among the first is one as large as may be, which takes seconds
        (tmp_path / str(k)).mkdir()
        with no_hang():
            outcomes.append(mutate.attempt(found, 5, k, tmp_path / str(k)))
    assert [o for o in outcomes if o.outcome in mutate.BAD] == []
    assert {o.outcome for o in outcomes} == {"accepted", "refused"}


def test_the_mutations_would_show_what_is_wrong_with_a_reader(tmp_path: Path) -> None:
    """A reader that raises what it likes, or takes too much memory, is told apart; a worker that dies or hangs, too."""

    def greedy(_: Path) -> None:
        assert bytearray(b"\1") * (mutate.MEMORY + 100_000_000)

    def silent(_: Path) -> None:
        raise KeyError("size")

    def outcome(reader: Callable[[Path], object]) -> str:
        found = (Seed("made", "x.txt", b"1 2 3", reader, {}),)
        folder = tmp_path / reader.__name__
        folder.mkdir()
        return mutate.attempt(found, 1, 0, folder).outcome

    assert outcome(silent) == "raw exception"
    if sys.platform == "linux":
        assert outcome(greedy) == "too much memory"


def test_an_input_that_hangs_or_ends_the_process_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """The processes here run no reader: one sleeps, one ends."""
    for worker, outcome in ((bad_workers.sleeps, "hang"), (bad_workers.ends, "crash")):
        monkeypatch.setattr(mutate, "_work", worker)
        assert [o.outcome for o in mutate.run(1, seed=1, seconds=1.0)] == [outcome]


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """An output folder with an older result in it."""
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "kept.json").write_text('{"older": "result"}')
    return folder


def _tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# what may stand beside the message: where help is, and what Coal prints about NaN and urdfdom about a shape it drops
_BESIDE = (
    "  elastic-strips",
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


# one of each kind of input, and how a command line names it
_COMMANDS = (
    ("urdf: link twice", ["run", "case-1", "--robot", "{file}", "--json", "{out}/kept.json"]),
    ("urdf: mesh garbage", ["drive", "case-1", "--robot", "{file}", "--record", "{out}/r.npz"]),
    ("scene: box that is NaN", ["run", "{around}", "--json", "{out}/kept.json", "--html", "{out}/page.html"]),
    ("scenario: with a misspelt key", ["run", "{file}", "--json", "{out}/kept.json"]),
    ("result: truncated", ["view", "{file}", "--html", "{out}/page.html"]),
)


@contextmanager
def _command(name: str, arguments: list[str], tmp_path: Path, out: Path) -> Iterator[tuple[list[str], FileCase]]:
    cases = {c.name: c for c in (*urdf_cases(), *scene_cases(), *scenario_cases(), *result_cases(SOUND))}
    case = cases[name]
    folder = tmp_path / name.replace(" ", "-").replace(":", "")
    folder.mkdir()
    path = case.write(folder)
    around = folder / "around.yaml"
    around.write_text(f"robot: silvermate\nscene: {path.name}\nstart: {{}}\ngoal: {{x: 4}}\n")
    places = {"{file}": str(path), "{around}": str(around)}
    with no_hang():
        yield [places.get(a, a.replace("{out}", str(out))) for a in arguments], case


def test_a_malformed_file_ends_the_command_with_exit_code_2(
    tmp_path: Path, out: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The command line says what the library says, in one message, and no output appears or changes."""
    for name, given in _COMMANDS:
        with _command(name, given, tmp_path, out) as (arguments, case):
            message = _refused(arguments, out, capfd)
        assert not [words for words in case.says if words not in message], message


def test_a_process_of_its_own_behaves_the_same(tmp_path: Path, out: Path) -> None:
    """Exit code, message, no file; a shell sees nothing else."""
    with _command(*_COMMANDS[3], tmp_path, out) as (arguments, case):
        before = _tree(tmp_path)
        call = [sys.executable, "-c", "from elastic_strips.cli import main; main()", *arguments]
        ended = subprocess.run(call, capture_output=True, text=True, cwd=tmp_path, env=os.environ, check=False)
    assert ended.returncode == 2, ended
    message = _check_message(ended.stderr)
    assert not [words for words in case.says if words not in message], message
    assert _tree(tmp_path) == before


def test_a_wrong_command_line_ends_with_exit_code_2(
    tmp_path: Path, out: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wrong option names itself, its value and what would be valid; nothing is written."""
    monkeypatch.chdir(tmp_path)

    def check(k: int, case: Any) -> None:
        folder = tmp_path / "in" / str(k)
        folder.mkdir(parents=True)
        for name, content in case.beside.items():
            (folder / name).write_text(content)

        def fill(text: str) -> str:
            return text.replace("{out}", str(out)).replace("{in}", str(folder))

        message = _refused([fill(a) for a in case.arguments], tmp_path, capfd)
        assert not [words for words in map(fill, case.says) if words not in message], message

    _check_all(command_cases(), check)


def test_the_sound_originals_are_accepted(tmp_path: Path, out: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """What the malformed files were made from is fine: each of them fails for its one fault."""
    (tmp_path / "small.urdf").write_text(SOUND)
    (tmp_path / "small.srdf").write_text(SOUND_SRDF)
    (tmp_path / "scene.yaml").write_text(SCENE)
    (tmp_path / "scenario.yaml").write_text(SCENARIO)
    robot = es.load_robot(tmp_path / "small.urdf", base="omni", srdf=tmp_path / "small.srdf")
    assert robot.joint_names == ("shoulder", "slide")
    assert es.read_scene(tmp_path / "scene.yaml").names == ("table",)
    files = [str(tmp_path / "scenario.yaml"), "--robot", str(tmp_path / "small.urdf")]
    for arguments in (
        ["run", *files, "--json", str(out / "r.json")],
        ["view", str(out / "r.json"), "--html", str(out / "page.html")],
    ):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
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
