"""``elastic-strips sweep``: what it prints and writes, its exit codes, and that it goes on after it was killed."""

from __future__ import annotations

import csv
import json
import os
import shlex
import subprocess
import time
from collections import Counter
from pathlib import Path

import odd_jobs
import pytest
from cases import each
from command_line import CALL, interrupted

from elastic_strips.cli import main
from elastic_strips.sim.sweep.runs import MEASURED

SMALL = "kind: plan\nscenarios: [case-1]\nseeds: {count: 3}\ngrid: {influence: [0.2, 0.3]}\n"
MANY = SMALL.replace("count: 3", "count: 6")
PAGE = Path(__file__).parents[2] / "docs" / "sweeps.md"


def call(*arguments: object) -> int:
    """Exit code of a command line in this process."""
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code


def rows(path: Path) -> list[dict[str, str]]:
    """Of a table, without what the clock has a part in."""
    with path.open(newline="") as stream:
        return [{k: v for k, v in row.items() if k not in odd_jobs.CLOCKED} for row in csv.DictReader(stream)]


def kept(folder: Path) -> int:
    journal = folder / "t.csv.journal"
    return max(0, journal.read_bytes().count(b"\n") - 1) if journal.exists() else 0


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.yaml").write_text(SMALL)
    return tmp_path


def test_a_sweep_and_its_picture(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("sweep", "s.yaml", "--dry-run") == 0
    listed = capsys.readouterr().out.splitlines()
    assert listed[0] == "s: 6 runs"
    assert len(listed) == 7
    assert "case-1 · seed 1 · influence=0.3" in listed[5]
    assert [p.name for p in folder.iterdir()] == ["s.yaml"]
    assert call("sweep", "s.yaml", "--processes", 2, "--plot", "p.png", "--x", "seed") == 0
    printed = capsys.readouterr().out
    assert "table   s.csv  (6 rows, 0 with an error)" in printed
    assert "clearance_m over seed, influence in colours" in printed
    assert (folder / "p.png").read_bytes().startswith(b"\x89PNG")
    assert len(rows(folder / "s.csv")) == 6
    before = (folder / "s.csv.journal").read_bytes()
    assert call("sweep", "s.yaml") == 0
    assert "6 done before, 0 to go" in capsys.readouterr().out
    assert (folder / "s.csv.journal").read_bytes() == before


def test_a_run_that_fails_ends_nothing(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """... but the exit code says so, and it can be run again."""
    (folder / "room.yaml").write_text(
        "robot: jackal-box\nscene: {obstacles: [{shape: sphere, radius: 1}]}\nstart: {}\ngoal: {x: 3}\n"
    )
    (folder / "s.yaml").write_text("kind: plan\nscenarios: [room.yaml, case-1]\n")
    for again in ((), ("--retry-failed",)):
        assert call("sweep", "s.yaml", "--processes", 1, *again) == 3
        printed = capsys.readouterr().out
        assert "2 rows, 1 with an error" in printed
        assert "run 0, room.yaml, seed 0: ConfigurationError" in printed
    assert [row["error_type"] for row in rows(folder / "s.csv")] == ["ConfigurationError", ""]
    assert len((folder / "s.csv.journal").read_text().splitlines()) == 4


@each(
    ("arguments", "says"),
    [
        (("nowhere.yaml",), "nowhere.yaml"),
        (("s.yaml", "--out", "t.xls"), ".parquet"),
        (("s.yaml", "--out", "s.yaml"), "named twice"),
        (("s.yaml", "--plot", "p.png", "--y", "speed"), "'speed'"),
        (("s.yaml", "--y", "nodes"), "--plot"),
        (("s.yaml", "--processes", "2", "--scheduler", "tcp://127.0.0.1:9"), "--processes"),
        (("s.yaml", "--processes", "0"), "--processes"),
        (("s.yaml", "--out", ""), "file name"),
        (("s.yaml", "--plot", "p.xyz"), "unknown ending '.xyz'"),
        (("s.yaml", "--json", "s.csv.journal"), "named twice"),
        (("s.yaml", "--scheduler", "here"), "no Dask scheduler"),
    ],
)
def test_wrong_input_leaves_nothing(
    arguments: tuple[str, ...], says: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("sweep", *arguments) == 2
    printed = capsys.readouterr()
    assert says in printed.err
    assert "Traceback" not in printed.err
    assert [p.name for p in folder.iterdir()] == ["s.yaml"]


def test_the_answer_is_a_document(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "s.yaml").write_text("kind: plan\nscenarios: [case-1]\ngrid: {k_r: [1, 2]}\nfixed: {timeout: 5}\n")
    assert call("sweep", "s.yaml", "--dry-run", "--json", "-") == 0
    printed = capsys.readouterr()
    listed = json.loads(printed.out)["listed"]
    assert [run["k_r"] for run in listed] == [1, 2]
    assert "s: 2 runs" in printed.err
    (folder / "s.yaml").write_text("kind: plan\nscenarios: [case-1]\ngrid: {k_r: [1, 2]}\nrobots: [panda]\n")
    assert call("sweep", "s.yaml", "--processes", 1, "--json", "a.json") == 3
    document = json.loads((folder / "a.json").read_text())
    assert (document["runs"], document["rows"], document["table"]) == (2, 2, "s.csv")
    assert document["sweep"]["grid"] == {"k_r": [1, 2]}
    assert [(row["run"], row["k_r"], row["robot"]) for row in document["failed"]] == [(0, 1, "panda"), (1, 2, "panda")]
    assert all(row["error"] for row in document["failed"])


def test_a_full_disk_is_said_and_nothing_is_lost(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By a limit on the size of files: the journal reaches it in the middle of a row."""
    limited = "import resource, sys; sys.dont_write_bytecode = True; "  # half a module's would be believed later
    limited += "resource.setrlimit(resource.RLIMIT_FSIZE, (2600, 2600)); "
    command = [CALL[0], "-c", limited + CALL[2], "sweep", "s.yaml", "--processes", "1"]
    ended = subprocess.run(command, capture_output=True, text=True, env=os.environ)
    assert ended.returncode == 2, ended
    assert "s.csv.journal: cannot write: " in ended.stderr
    assert "of 6 runs are kept" in ended.stderr
    whole = (folder / "s.csv.journal").read_bytes()
    assert whole.endswith(b"}\n")
    assert len(rows(folder / "s.csv")) == whole.count(b"\n") - 1 > 0
    assert call("sweep", "s.yaml", "--processes", 1) == 0
    assert (folder / "s.csv.journal").read_bytes().startswith(whole)
    assert [row["run"] for row in rows(folder / "s.csv")] == list("012345")


# --- interrupted -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, str]]:
    """The rows of a sweep that nobody disturbs."""
    folder = tmp_path_factory.mktemp("undisturbed")
    (folder / "s.yaml").write_text(MANY)
    assert call("sweep", folder / "s.yaml", "--out", folder / "t.csv", "--processes", 1) == 0
    return rows(folder / "t.csv")


def check_whole(folder: Path, undisturbed: list[dict[str, str]]) -> None:
    assert rows(folder / "t.csv") == undisturbed
    lines = (folder / "t.csv.journal").read_text().splitlines()
    assert len(lines) == 1 + len(undisturbed)  # nothing was run twice


def test_ctrl_c_says_how_to_go_on(folder: Path, undisturbed: list[dict[str, str]]) -> None:
    (folder / "s.yaml").write_text(MANY)
    arguments = ["sweep", "s.yaml", "--out", "t.csv", "--processes", "2", "--plot", "a plot.png", "--x", "seed",
                 "--retry-failed"]  # fmt: skip
    ended = interrupted(arguments, folder, until=lambda: kept(folder) >= 3)
    assert ended.returncode == 130, ended
    assert "Traceback" not in ended.stderr
    assert "interrupted; " in ended.stderr
    again = ended.stderr.strip().splitlines()[-1].strip()
    assert again == shlex.join(["elastic-strips", *arguments])
    assert len(rows(folder / "t.csv")) == kept(folder)  # the table is there, too
    assert call(*shlex.split(again)[1:]) == 0
    check_whole(folder, undisturbed)


def test_kill_9_loses_no_row_and_repeats_none(folder: Path, undisturbed: list[dict[str, str]], brief: bool) -> None:
    (folder / "s.yaml").write_text(MANY)
    arguments = ["sweep", "s.yaml", "--out", "t.csv", "--processes", "2"]
    for count in (3,) if brief else (2, 6):
        process = subprocess.Popen([*CALL, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while kept(folder) < count and process.poll() is None:
            time.sleep(0.01)
        process.kill()
        process.wait()
    assert call(*arguments) == 0
    check_whole(folder, undisturbed)


def test_a_cluster_whose_worker_is_killed(folder: Path, undisturbed: list[dict[str, str]]) -> None:
    (folder / "s.yaml").write_text(MANY)
    with odd_jobs.cluster(folder) as (address, (_, worker, _other)):
        arguments = ["sweep", "s.yaml", "--out", "t.csv", "--scheduler", address]
        process = subprocess.Popen([*CALL, *arguments], stdout=subprocess.DEVNULL, env=os.environ)
        while kept(folder) < 3 and process.poll() is None:
            time.sleep(0.01)
        worker.kill()
        assert process.wait(timeout=120) == 0
    check_whole(folder, undisturbed)


def test_a_cluster_whose_scheduler_is_killed(folder: Path) -> None:
    """It is said with how to go on, and without Dask's tracebacks."""
    (folder / "s.yaml").write_text(SMALL.replace("count: 3", "count: 12"))
    with odd_jobs.cluster(folder, 1) as (address, (scheduler, _)):
        arguments = ["sweep", "s.yaml", "--out", "t.csv", "--scheduler", address]
        process = subprocess.Popen([*CALL, *arguments], stderr=subprocess.PIPE, text=True, env=os.environ)
        while kept(folder) < 2 and process.poll() is None:
            time.sleep(0.001)
        scheduler.kill()
        _, said = process.communicate(timeout=120)
    assert process.returncode == 3, said
    assert "Traceback" not in said
    assert f"error: the scheduler at {address} ended" in said
    assert said.splitlines()[-1].strip() == shlex.join(["elastic-strips", *arguments])
    assert call(*arguments[:-2], "--processes", 1) == 0
    assert [row["run"] for row in rows(folder / "t.csv")] == [str(k) for k in range(24)]
    assert kept(folder) == 24


def test_the_page_names_every_column() -> None:
    words = Counter(PAGE.read_text(encoding="utf-8").replace("`", " ").replace(",", " ").split())
    for kind, columns in MEASURED.items():
        assert [name for name in columns if name not in words] == [], kind
