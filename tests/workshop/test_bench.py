"""``python -m workshop``: what its benchmarks print and write, and how they end."""

from __future__ import annotations

import json
import logging
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from cases import each
from command_line import interrupted

from elastic_strips import __version__
from workshop.bench import guard_passing
from workshop.cli.group import run_cli


def call(*arguments: object) -> int:
    """Exit code of a command line in this process."""
    with pytest.raises(SystemExit) as ended:
        run_cli([str(a) for a in arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code


def test_each_command_has_its_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("--help") == 0
    names = re.findall(r"^  ([a-z]+) +[A-Z]", capsys.readouterr().out.partition("Commands:")[2], re.MULTILINE)
    assert {"plan", "replan", "tick", "mbm", "peers", "drive", "disturb", "study"} <= set(names)
    for words in (*names, "study paper"):
        assert call(*words.split(), "-h") == 0
        assert f"Usage: python -m workshop {words}" in capsys.readouterr().out


def test_it_runs_in_a_checkout_and_is_no_part_of_the_package() -> None:
    checkout = Path(__file__).parents[2]
    done = subprocess.run(
        [sys.executable, "-m", "workshop", "--help"], cwd=checkout, capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("Usage: python -m workshop")
    assert (checkout / "workshop").is_dir()


@pytest.mark.parametrize("words", [(), ("study",)])
def test_a_group_without_a_command_shows_its_help(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert call(*words) == 2
    printed = capsys.readouterr()
    assert "Commands:" in printed.out + printed.err


def test_a_document_on_standard_output_is_all_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("plan", "--seeds", "1", "--json", "-") == 0
    printed = capsys.readouterr()
    assert "machine" in json.loads(printed.out)
    assert "clearance" in printed.err


@each(
    ("words", "says"),
    [
        (("barn",), ("barn/barn_worlds.json", "github.com/Daffan")),
        (("dynabarn",), ("dynabarn/dynabarn_worlds.json", "github.com/Daffan")),
        (("house",), ("house/house.json", "github.com/aws-robotics")),
        (("bridge",), ("bridge/bridge.json", "github.com/SYSU-STAR")),
        (("mbm",), ("mbm", "github.com/KavrakiLab")),
        (("looks",), ("mbm", "github.com/KavrakiLab")),
    ],
)
def test_data_that_is_not_there_is_said_with_where_it_comes_from(
    words: tuple[str, ...], says: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(*words, "--root", tmp_path) == 2
    printed = " ".join(capsys.readouterr().err.split())
    assert not [text for text in (str(tmp_path), *says) if text not in printed], printed


def test_a_robot_that_nobody_has_is_no_figure_of_a_benchmark(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("robots", "silvermat") == 2
    printed = capsys.readouterr()
    assert "did you mean 'silvermate'?" in printed.err
    assert printed.out == ""


@each(
    ("line", "says"),
    [
        ("study table", "'table'"), ("study paper case-1", "case-1"), ("study paper --quick --out", "--out"),
        ("study paper --quick --processes 0", "--processes"), ("study paper --quick --out {out}/kept", "File exists"),
        ("study paper --quick --out {out}/kept/study", "Not a directory"),
        ("study paper --quick --out /dev/null", "File exists"),
        ("study paper --quick --out {out}/" + "x" * 300, "File name too long"), ("jump", "'jump'"),
        ("plan --seeds 0", "0"), ("plan --seeds 1 --json {out}", "is a folder"), ("tick --ticks 5", "5"),
    ],
)  # fmt: skip
def test_wrong_input_is_said(line: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "kept").write_text("kept")
    assert call(*line.format(out=tmp_path).split()) == 2
    printed = capsys.readouterr()
    assert says in printed.err
    assert "Traceback" not in printed.err
    assert (tmp_path / "kept").read_text() == "kept"


def _bench(tmp_path: Path, *arguments: str) -> dict[str, Any]:
    path = tmp_path / "figures.json"
    assert call(*arguments, "--json", path) == 0
    figures = json.loads(path.read_text(encoding="utf-8"))
    assert figures["benchmark"] == arguments[0]
    named = arguments[arguments.index("--robot") + 1] if "--robot" in arguments else "silvermate"
    assert figures["robot"] == named
    assert figures["machine"]["elastic_strips"] == __version__
    return figures


def test_bench_plan(tmp_path: Path) -> None:
    """Two corridors: each is a row, and the summary is made of the rows."""
    figures = _bench(tmp_path, "plan", "--seeds", "2")
    assert [run["seed"] for run in figures["runs"]] == [0, 1]
    assert figures["certified"] == 1.0
    assert figures["failures"] == []
    times = [run["ms"] for run in figures["runs"]]
    assert figures["time_to_certified_ms"]["max"] == pytest.approx(max(times))
    assert figures["clearance_m"]["min"] == min(run["clearance_m"] for run in figures["runs"])
    for run in figures["runs"]:
        assert sum(run["phases_ms"].values()) <= run["ms"]


def test_bench_plan_of_another_scenario(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The clutter, with the grid first; an unknown scenario is wrong input."""
    figures = _bench(tmp_path, "plan", "--seeds", "2", "--scenario", "clutter", "--grid")
    assert (figures["scenario"], figures["grid"], figures["certified"]) == ("clutter", True, 1.0)
    soon = sum(run["certified"] and run["ms"] <= 2000.0 for run in figures["runs"]) / 2
    assert figures["certified_within_2_s"] == soon
    assert "2 seeds of clutter" in capsys.readouterr().out
    assert call("plan", "--seeds", "1", "--scenario", "cluter") == 2
    assert "clutter" in capsys.readouterr().err


def test_bench_replan(tmp_path: Path) -> None:
    """Up to four pushes on each of two corridors; the strip follows by about as much as it was pushed."""
    figures = _bench(tmp_path, "replan", "--seeds", "2")
    assert 2 <= figures["pushes"] == len(figures["runs"]) <= 8
    assert {run["seed"] for run in figures["runs"]} == {0, 1}
    assert all(run["ticks"] >= 1 and run["ms"] > 0 for run in figures["runs"])
    assert figures["certified"] == sum(run["certified"] for run in figures["runs"]) / len(figures["runs"])


def test_bench_replan_into_the_strip(tmp_path: Path) -> None:
    """What ticks do not mend is replanned."""
    figures = _bench(tmp_path, "replan", "--seeds", "2", "--into", "0.3")
    assert figures["into_m"] == 0.3
    assert figures["anew"] == sum(run["anew"] for run in figures["runs"]) > 0
    assert all(run["certified"] or run["reason"] for run in figures["runs"])


@pytest.mark.usefixtures("chromium")
def test_bench_page(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("workshop.bench.page._PAGE_SETTLING_TIME", 0.5)
    figures = _bench(tmp_path, "page", "--robot", "bridge-arm", "--obstacles", "3", "--movers", "1", "--for", "2")
    assert figures["ticks_per_s"] > 0.0 <= figures["pictures_per_s"]  # a busy machine draws none in so short a time
    assert figures["renderer"]
    assert "pictures a second" in capsys.readouterr().out


def test_bench_settle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A settled strip is certified and no nearer to anything; scenarios whose ends a robot cannot take are left out."""
    figures = _bench(tmp_path, "settle", "--seeds", "3")
    assert figures["strips"] == len(figures["runs"]) == 3
    assert figures["certified"] == 1.0
    assert figures["energy_rise"] == 0.0
    for run in figures["runs"]:
        assert run["clearance_after_m"] > run["clearance_before_m"] - 0.005
    assert "clearance lost" in capsys.readouterr().out
    assert call("settle", "--seeds", "1", "--robot", "bridge-arm", "--scenario", "clutter") == 0
    assert "0 strips" in capsys.readouterr().out


def test_a_bench_of_which_no_run_can_begin_says_so_once(capsys: pytest.CaptureFixture[str]) -> None:
    """The robot has no link for the laser: wrong input, and no table of failures."""
    assert call("drive", "--robot", "bridge-arm", "--sensors", "laser", "--seeds", "2", "--processes", "1") == 2
    captured = capsys.readouterr()
    assert captured.err.count("no link 'laser_frame'") == 1
    assert "reached" not in captured.out


@each(
    ("case", "options", "ways"),
    [
        ("every", ("--seconds", "5", "--rate", "50"), ["flow", "stop"]),
        ("patrol", ("--seconds", "12", "--rate", "50"), ["flow", "stop"]),
        ("path", ("--rate", "50"), ["flow"]),
        ("look", ("--rate", "50"), ["flow"]),
        ("hands", ("--rate", "50"), ["flow"]),
    ],
    ids=["every", "patrol", "path", "look", "hands"],
)
def test_bench_goals(
    case: str, options: tuple[str, ...], ways: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each way is a drive; what a case is about is among its figures, and the summary is made of the drives."""
    figures = _bench(tmp_path, "goals", "--case", case, "--seeds", "1", "--processes", "1", *options)
    assert (figures["case"], figures["compute"], figures["moving"]) == (case, "work", False)
    assert [run["way"] for run in figures["runs"]] == list(figures["ways"]) == ways
    for run in figures["runs"]:
        some = figures["ways"][run["way"]]
        assert run["contacts"] == []
        assert run["goals_missed"] == 0
        assert some["path_m"] == run["path_m"] > 1.0
    flow = figures["ways"]["flow"]
    if case == "every":
        assert flow["asked"] == 2
        assert flow["path_m"] > 1.05 * figures["ways"]["stop"]["path_m"]  # it drives on
    elif case == "patrol":
        assert flow["passed"] == flow["goals"] >= 3
        assert figures["ways"]["stop"]["passed"] == 0
    else:
        assert flow["reached"] == 1
        off = {"path": ("off_path_m", 0.3), "look": ("off_rad", 0.1), "hands": ("hands_off_m", 0.07)}[case]
        assert 0.0 < flow[off[0]] <= off[1]
    assert "contacts at speed" in capsys.readouterr().out


def test_bench_tick(tmp_path: Path) -> None:
    """Phases are parts of the tick; no --scaling, nothing else measured."""
    figures = _bench(tmp_path, "tick", "--ticks", "20", "--no-scaling")
    assert figures["ticks"] == 20
    assert figures["nodes"] == 64
    assert figures["obstacles"] == 32
    assert 0.0 < figures["phases_sum_ms"] <= 1.01 * figures["tick_mean_ms"]
    assert figures["every_pair"]["pairs_per_node"] > figures["links"] * figures["obstacles"]
    assert "nodes_scaling" not in figures


def test_bench_guard(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "guard.json"
    line = "guard --robot silvermate --base own --pilot rammer --method guard --method none --seeds 1 --time 4"
    assert call(*line.split(), "--processes", "1", "--json", file) == 0
    document = json.loads(file.read_text())
    guarded, alone = document["groups"]
    assert guarded["method"] == "guard"
    assert guarded["contacts_at_speed"] == 0
    assert guarded["path_m"] > 0.2
    assert alone["method"] == "none"
    assert alone["contacts_at_speed"] > 0
    assert {run["pilot"] for run in document["runs"]} == {"rammer"}
    assert "contacts at speed" in capsys.readouterr().out


def test_bench_guard_by_laser(tmp_path: Path) -> None:
    file = tmp_path / "guard.json"
    line = "guard --robot silvermate --base own --pilot rammer --sensors laser --compute work --seeds 1 --time 3"
    assert call(*line.split(), "--processes", "1", "--json", file) == 0
    (group,) = json.loads(file.read_text())["groups"]
    assert group["contacts_with_seen"] == 0
    assert group["path_m"] > 0.2


def test_bench_of_what_a_guard_passes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, value in {"_FREE_RUN": 0.5, "_WALL_RUN": 0.5, "_DOOR_END": 0.3}.items():
        monkeypatch.setattr(guard_passing, name, value)
    file = tmp_path / "passing.json"
    line = "guard --robot silvermate --base omni --passing --seeds 2"
    assert call(*line.split(), "--processes", "1", "--json", file) == 0
    (row,) = json.loads(file.read_text())["rows"]
    assert row["free_base"]["share"] == row["free_base"]["least_share"] == 1.0
    assert row["wall_60"]["contacts"] == 0
    assert row["wall_60"]["of_free"] == pytest.approx(1.0, abs=0.01)
    assert row["door_1.3"]["guard"]["time_s"] < 5.0
    assert "where nothing is near" in capsys.readouterr().out


def test_bench_robots(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A named robot and one of a folder, which is refused: both are rows of the table, put between a page's marks."""
    caplog.set_level(logging.ERROR)  # as the command line does in a process of its own
    (tmp_path / "bare").mkdir()
    (tmp_path / "bare/stick.urdf").write_text('<robot name="stick"><link name="base"/></robot>')
    odd = '<robot><link name="base"><collision><geometry><sphere radius="0.1"/></geometry></collision></link></robot>'
    (tmp_path / "bare/odd.urdf").write_text(odd)
    page = tmp_path / "page.md"
    page.write_text("# Robots\n\n<!-- table: python -m workshop robots -->\nold\n<!-- end of table -->\nafter\n")
    arguments = ("robots", "jackal-box", "--data", tmp_path / "bare", "--table", page, "--json", tmp_path / "r.json")
    assert call(*arguments) == 0
    figures = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))
    ours, odd_one, other = figures["robots"]
    assert len(odd_one["warnings"]) == 1, "a robot without a name is given one, and that is said"
    assert (ours["name"], ours["refused"], ours["plan"], ours["settle"]) == ("jackal-box", None, "certified", "settled")
    assert other["name"] == "bare/stick"
    assert "no collision geometry" in other["refused"]
    lines = page.read_text().splitlines()
    assert (lines[0], lines[-1]) == ("# Robots", "after")
    assert "old" not in lines
    assert [line.split(" | ")[0] for line in lines if line.startswith("| ")] == [
        "| robot",
        "| jackal-box",
        "| bare/odd",
        "| bare/stick",
    ]
    assert str(tmp_path) not in page.read_text()


def test_ctrl_c_in_a_benchmark_ends_with_130(tmp_path: Path) -> None:
    """The progress bar is taken away, and no figures are written."""
    ended = interrupted(
        ["plan", "--seeds", "10000", "--json", "f.json"], tmp_path, after=3.0, module="workshop.cli.group"
    )
    assert ended.returncode == 130, ended
    assert "Traceback" not in ended.stderr
    assert "interrupted" in ended.stderr
    assert list(tmp_path.iterdir()) == []
