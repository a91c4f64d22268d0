"""Sweeps: what a file may ask for, what a row says, and that no row is lost or twice."""

from __future__ import annotations

import csv
import errno
import fcntl
import json
import os
import warnings
from pathlib import Path

import pytest
from cases import each, refused
from odd_jobs import CLOCKED

from elastic_strips.errors import InputError, ParameterError
from elastic_strips.sim.scenarios import get_scenario, run_scenario
from elastic_strips.sim.scenarios.drive import drive_params
from elastic_strips.sim.sensors import sensor_file
from elastic_strips.sim.sweep import (
    Plot,
    Run,
    Sweep,
    SweepError,
    SweepStore,
    execute,
    plot_sweep,
    read_sweep,
    run_sweep,
)
from elastic_strips.sim.sweep.plot import plot_columns
from elastic_strips.sim.sweep.runs import Row, changed, empty

PLANS = """kind: plan
scenarios: [case-1, dead-end]
seeds: [3, 1]
grid:
  influence: [0.2, 0.3]
  k_r: [1, 2.5]
fixed: {k_c: 1.5, timeout: 5}
"""


def written(folder: Path, text: str = PLANS, name: str = "s.yaml") -> Sweep:
    path = folder / name
    path.write_text(text)
    return read_sweep(path)


def made(run: Run, **values: object) -> Row:
    """A row without having run anything."""
    row: Row = dict.fromkeys(Sweep(Path("x"), run.kind, ("case-1",)).columns()) | run.identity
    return row | {"wall_s": 0.25, "clearance_m": 0.1 * run.index, **values}  # type: ignore[dict-item]


# --- the file ----------------------------------------------------------------------------------------------------


def test_every_combination_is_a_run_once(tmp_path: Path) -> None:
    sweep = written(tmp_path)
    runs = sweep.runs()
    assert len(runs) == len(sweep) == 16
    assert [r.index for r in runs] == list(range(16))
    points = {(r.scenario, r.seed, *dict(r.values).items()) for r in runs}
    assert len(points) == 16
    assert runs[1].seed == 1  # seeds change fastest, in the order of the file
    assert all(dict(r.values)["k_c"] == 1.5 for r in runs)
    assert "k_c" not in sweep.columns()
    assert sweep.columns()["k_r"] is float


def test_seeds_may_be_a_range(tmp_path: Path) -> None:
    sweep = written(tmp_path, "kind: plan\nscenarios: [corridor]\nseeds: {first: 5, count: 3}\n")
    assert sweep.seeds == (5, 6, 7)


@each(
    ("wrong", "says"),
    [
        ("kind: plane\nscenarios: [case-1]", (":1:", "kind", "did you mean 'plan'")),
        ("kind: plan", ("'scenarios' is missing",)),
        ("kind: plan\nscenarios: []", (":2:", "scenarios", "is empty")),
        ("kind: plan\nscenarios:\n  - case-1\n  - case-99", (":4:", "'case-99'", "did you mean 'case-")),
        ("kind: plan\nscenarios: [case-1, case-1]", (":2:", "scenarios[1]", "which the list has already")),
        ("kind: plan\nscenarios: [no/such.yaml]", (":2:", "such.yaml")),
        ("kind: plan\nscenarios: [case-1]\nrobots: [tiagp]", (":3:", "robots[0]", "did you mean 'tiago'")),
        ("kind: plan\nscenarios: [case-1]\nrobots: [a/b.urdf]", (":3:", "there is no URDF file")),
        ("kind: plan\nscenarios: [case-1]\npresets: [defualt]", (":3:", "did you mean 'default'")),
        ("kind: drive\nscenarios: [case-1]\npresets: [default]", (":3:", "a drive has no presets")),
        ("kind: plan\nscenarios: [case-1]\nseeds: {first: 0}", (":3:", "'count' is missing")),
        ("kind: plan\nscenarios: [case-1]\nseeds: [-1]", (":3:", "seeds[0]", "-1")),
        ("kind: plan\nscenarios: [case-1]\ngrid: {influense: [1]}", (":3:", "did you mean 'influence'")),
        ("kind: plan\nscenarios: [case-1]\ngrid:\n  k_r: [1]\nfixed:\n  k_r: 2", (":6:", "same parameter as 'k_r'")),
        ("kind: plan\nscenarios: [case-1]\ngrid: {k_r: [1]}\nfixed: {deform.k_r: 2}", (":4:", "the same parameter")),
        ("kind: plan\nscenarios: [case-1]\ngrid:\n  k_r: [1, -1]", (":4:", "grid.k_r[1]", "-1", "≥ 0")),
        ("kind: plan\nscenarios: [case-1]\nfixed:\n  timeout: 0", (":4:", "timeout", "> 0")),
        ("kind: plan\nscenarios: [case-1]\ngrid: {alpha: [0.1]}", (":3:", "'alpha'")),  # of preset paper alone
        ("kind: plan\nscenarios: [case-1]\nfixed: {evade: true}", (":3:", "unknown parameter 'evade' of a plan")),
        ("kind: drive\nscenarios: [case-1]\nfixed: {evasion.horizn: 1}", (":3:", "did you mean 'evasion.horizon'")),
        ("kind: drive\nscenarios: [case-1]\nfixed: {plant: mujocco}", (":3:", "did you mean 'mujoco'")),
        ("kind: drive\nscenarios: [case-1]\nfixed: {compute: fast}", (":3:", "compute='fast'")),
        ("kind: drive\nscenarios: [case-1]\nfixed: {margin: [a]}", (":3:", "must be a number")),
        ("kind: plan\nscenarios: [case-1]\ngrid: {k_r: [1, 2, 1.0]}", (":3:", "k_r[2]", "has already")),
        ("kind: drive\nscenarios: [case-1]\ngrid: {speeds: [[1, 0.5], [1.0, 0.5]]}", (":3:", "has already")),
        ("kind: drive\nscenarios: [case-1]\nfixed: {sensors: lasr}", (":3:", "sensors", "laser")),
        ("kind: drive\nscenarios: [case-1]\ngrid: {sensors: [all, no.yaml]}", (":3:", "sensors[1]", "no.yaml")),
        ("kind: drive\nscenarios: [case-1]\ngrid:\n  evasion.horizon: [1, 2]\nfixed: {evade: false}", (":4:", "evade")),
        ("kind: plan\nscenarios: [case-1]\nplot: {y: speed}", (":3:", "plot.y", "'speed'")),
        ("kind: plan\nscenarios: [case-1]\nseeds: {count: 900000}\ngrid: {k_r: [1, 2]}", ("1800000 runs", "1000000")),
        ("kind: plan\nscenarios: [case-1]\nsedes: [1]", (":3:", "did you mean 'seeds'")),
    ],
)  # fmt: skip
def test_what_cannot_be_meant_is_refused_with_its_line(wrong: str, says: tuple[str, ...], tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        written(tmp_path, wrong)
    assert not [words for words in ("s.yaml", *says) if words not in str(caught.value)], str(caught.value)


def test_a_value_that_some_combination_allows_is_not_refused(tmp_path: Path) -> None:
    """0.4 is too much clearance beside an influence of 0.3, the default, but not beside 0.5."""
    sweep = written(tmp_path, "kind: plan\nscenarios: [case-1]\ngrid: {influence: [0.3, 0.5], clearance: [0.1, 0.4]}")
    assert len(sweep) == 4
    row = execute(sweep.runs()[1])
    assert row["error_type"] == "ParameterError"
    assert "influence" in str(row["error"])


# --- a row -------------------------------------------------------------------------------------------------------


def test_a_plan_is_that_of_the_command() -> None:
    run = Run(4, "plan", "corridor", None, None, 2, (("influence", 0.25), ("deform.k_r", 2.0)), axes=1)
    row = execute(run)
    result = run_scenario(get_scenario("corridor", seed=2), seed=2, overrides={"influence": 0.25, "k_r": 2.0})
    assert row["clearance_m"] == result.clearance
    assert row["ticks"] == result.ticks
    assert (row["run"], row["scenario"], row["robot"], row["preset"], row["seed"]) == (
        4, "corridor", "silvermate", "default", 2,
    )  # fmt: skip
    assert row["influence"] == 0.25
    assert row["certified"] is True
    assert row["error_type"] is None


def test_a_run_that_fails_is_a_row_with_its_error(monkeypatch: pytest.MonkeyPatch) -> None:
    row = execute(Run(0, "plan", "case-1", "nobody", None, 0))
    assert row["error_type"] == "RobotError"
    assert "nobody" in str(row["error"])
    assert row["certified"] is None
    monkeypatch.setattr("elastic_strips.sim.sweep.runs.run_scenario", lambda *_, **__: 1 / 0)
    row = execute(Run(0, "plan", "case-1", None, None, 0))
    assert row["error_type"] == "ZeroDivisionError"
    assert "test_sweep.py:" in str(row["error"])  # nobody raised it on purpose: where it was


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_an_error_that_names_a_file_which_is_no_text_is_kept(suffix: str, tmp_path: Path) -> None:
    sweep, path = written(tmp_path), tmp_path / f"t{suffix}"
    row = execute(Run(0, "plan", "nowhere.yaml", None, None, 0, folder=os.fsdecode(b"x\xff")))
    assert "nowhere.yaml" in str(row["error"])
    with SweepStore(sweep, path) as store:
        store.add(made(sweep.runs()[0], error_type=row["error_type"], error=row["error"]))
    assert table(path)[0]["error"] == row["error"]


def test_a_drive_takes_parameters_of_every_part() -> None:
    scenario = get_scenario("case-1")
    values = {"deform.influence": 0.4, "evasion.horizon": 2.0, "assumptions.acceleration": 0.1, "margin": 0.01}
    params = changed(drive_params(scenario), values)
    assert params.deform.influence == 0.4
    assert params.evasion is not None
    assert (params.evasion.horizon, params.assumptions.acceleration, params.margin) == (2.0, 0.1, 0.01)
    assert params.deform.max_nodes == drive_params(scenario).deform.max_nodes
    with refused(ParameterError, "evade"):
        changed(drive_params(scenario, evade=False), {"evasion.horizon": 2.0})


def test_a_drive_is_a_row(tmp_path: Path) -> None:
    text = "kind: drive\nscenarios: [case-2]\ngrid: {influence: [0.4]}\nfixed: {compute: work, time_limit: 1.5}\n"
    row = execute(written(tmp_path, text).runs()[0])
    assert row["error"] is None
    assert 1.5 <= float(str(row["time_s"])) < 6.0  # it comes to rest after its time
    assert row["reached"] is False
    assert row["collisions"] == 0


@pytest.mark.parametrize(
    "text",
    [
        "kind: plan\nscenarios: [case-1]\npresets: [default, paper]\ngrid: {k_r: [1, 2.5]}\n",
        "kind: drive\nscenarios: [case-2]\ngrid: {speeds: [[1.0, 0.5]], compute: [work]}\nfixed: {time_limit: 0.5}\n",
    ],
)
def test_the_values_of_a_row_are_of_the_types_of_the_columns(text: str, tmp_path: Path) -> None:
    sweep = written(tmp_path, text)
    for run in sweep.runs()[::3]:
        row = execute(run)
        assert row["error"] is None
        assert list(row) == list(sweep.columns())
        for name, kind in sweep.columns().items():
            assert row[name] is None or isinstance(row[name], (int, float) if kind is float else kind), name


# --- the table ---------------------------------------------------------------------------------------------------


def filled(sweep: Sweep, path: Path, count: int) -> None:
    with SweepStore(sweep, path) as store:
        for run in store.todo()[:count]:
            store.add(made(run))


def table(path: Path) -> list[dict[str, object]]:
    if path.suffix == ".parquet":
        parquet = pytest.importorskip("pyarrow.parquet")
        return parquet.read_table(path).to_pylist()
    if path.suffix == ".jsonl":
        return [json.loads(line) for line in path.read_text().splitlines()]
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


@each("suffix", [".csv", ".parquet", ".jsonl"])
def test_rows_are_kept_and_the_rest_is_to_do(suffix: str, tmp_path: Path) -> None:
    sweep, path = written(tmp_path), tmp_path / f"t{suffix}"
    filled(sweep, path, 5)
    assert [int(str(row["run"])) for row in table(path)] == list(range(5))
    with SweepStore(sweep, path) as store:
        assert [run.index for run in store.todo()] == list(range(5, 16))
        for run in reversed(store.todo()):
            store.add(made(run, error_type="E", error='a "comma", and\nmore') if run.index == 7 else made(run))
        assert [run.index for run in store.todo(retry_failed=True)] == [7]
        store.add(made(sweep.runs()[2], error_type="E", error="late"))
        assert [row["run"] for row in store.failed] == [2, 7]
        store.add(made(sweep.runs()[2]))
        store.add(made(sweep.runs()[7]))
        assert not store.todo(retry_failed=True)
    rows = table(path)
    assert list(rows[0]) == list(sweep.columns())
    assert [int(str(row["run"])) for row in rows] == list(range(16))  # in order, none twice
    assert [float(str(row["k_r"])) for row in rows] == [dict(r.values)["k_r"] for r in sweep.runs()]
    if suffix == ".parquet":
        parquet = pytest.importorskip("pyarrow.parquet")
        assert parquet.read_schema(path).metadata[b"digest"].decode() == sweep.digest


@each("kept", [1, 30, 10_000])
def test_a_torn_last_line_is_run_again(kept: int, tmp_path: Path) -> None:
    """Whatever is left of the line that was being written when the process ended."""
    sweep, path = written(tmp_path), tmp_path / "t.csv"
    filled(sweep, path, 5)
    journal = tmp_path / "t.csv.journal"
    *whole, last = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(whole) + last[:-1][:kept])
    with SweepStore(sweep, path) as store:
        assert sorted(store.rows) == [0, 1, 2, 3]
        store.add(made(sweep.runs()[4]))
    assert journal.read_bytes() == b"".join(whole) + last
    journal.write_bytes(whole[0][:kept][:-1])  # the end came even before the first row
    path.unlink()
    with SweepStore(sweep, path) as store:
        assert not store.rows
        assert len(store.todo()) == 16


def test_a_journal_that_is_damaged_is_refused(tmp_path: Path) -> None:
    sweep, path = written(tmp_path), tmp_path / "t.csv"
    filled(sweep, path, 3)
    journal = tmp_path / "t.csv.journal"
    lines = journal.read_bytes().splitlines(keepends=True)
    for damage, says in (
        ([lines[0], b"\0" * 20 + b"\n"], "journal:2"),
        ([lines[0], lines[1], b'{"run": 3}\n'], "journal:3"),
        ([lines[0], lines[1].replace(b'"run": 0', b'"run": 99')], "journal:2"),
        ([lines[1]], "journal:1"),
        ([lines[0].replace(b'"version": 1', b'"version": 9')], "version 9"),
        ([lines[0].replace(b'"clearance_m"', b'"clearance"')], "with other columns"),
    ):
        journal.write_bytes(b"".join(damage))
        with pytest.raises(SweepError, match=says):
            SweepStore(sweep, path)
        assert journal.read_bytes() == b"".join(damage)


def test_the_table_of_another_sweep_is_refused_and_left_alone(tmp_path: Path) -> None:
    sweep, path = written(tmp_path), tmp_path / "t.csv"
    filled(sweep, path, 3)
    before = path.read_bytes()
    for old, new, says in (
        ("[3, 1]", "[3, 2]", "seeds was \\[3, 1\\], is \\[3, 2\\]"),
        ("k_c: 1.5", "k_c: 1.25", "fixed.k_c was 1.5, is 1.25"),
        ("[0.2, 0.3]", "[0.2]", "grid.influence was \\[0.2, 0.3\\], is \\[0.2\\]"),
        (", timeout: 5", "", "fixed.timeout was 5, is not given"),
        ("dead-end", "case-2", "scenarios was"),
    ):
        other = written(tmp_path, PLANS.replace(old, new), "other.yaml")
        with pytest.raises(SweepError, match=says):
            SweepStore(other, path)
    turned = PLANS.replace("  influence: [0.2, 0.3]\n  k_r: [1, 2.5]", "  k_r: [1, 2.5]\n  influence: [0.2, 0.3]")
    with refused(SweepError, "grid"):
        SweepStore(written(tmp_path, turned, "other.yaml"), path)
    assert path.read_bytes() == before
    same = written(tmp_path, PLANS.replace("k_r: [1, 2.5]", "k_r: [1.0, 2.5]") + "plot: {y: nodes}\n", "other.yaml")
    with SweepStore(same, path) as store:
        assert len(store.todo()) == 13


def test_a_scenario_file_that_was_changed_makes_another_sweep(tmp_path: Path) -> None:
    scene = "robot: jackal-box\nscene: {obstacles: []}\nstart: {}\ngoal: {x: 1}\n"
    (tmp_path / "room.yaml").write_text(scene)
    text = "kind: plan\nscenarios: [room.yaml]\n"
    sweep = written(tmp_path, text)
    with SweepStore(sweep, tmp_path / "t.csv") as store:
        store.add(execute(sweep.runs()[0]))
        assert store.rows[0]["certified"] is True
    (tmp_path / "room.yaml").write_text(scene.replace("x: 1", "x: 2"))
    with refused(SweepError, "files.room.yaml"):
        SweepStore(written(tmp_path, text), tmp_path / "t.csv")


def test_a_file_of_sensors_that_was_changed_makes_another_sweep(tmp_path: Path) -> None:
    (tmp_path / "eyes.yaml").write_text(sensor_file().read_text())
    text = "kind: drive\nscenarios: [case-1]\nfixed: {sensors: eyes.yaml}\n"
    with SweepStore(written(tmp_path, text), tmp_path / "t.csv") as store:
        store.add(empty(store.sweep.runs()[0]))
    (tmp_path / "eyes.yaml").write_text(sensor_file().read_text() + "\n")
    with refused(SweepError, "files.eyes.yaml"):
        SweepStore(written(tmp_path, text), tmp_path / "t.csv")


def test_what_is_no_table_of_a_sweep_is_never_written_over(tmp_path: Path) -> None:
    sweep, path = written(tmp_path), tmp_path / "t.csv"
    path.write_text("mine\n")
    with refused(SweepError, "overwritten"):
        SweepStore(sweep, path)
    assert path.read_text() == "mine\n"
    for name in ("t.xls", "t"):
        with refused(SweepError, "ending"):
            SweepStore(sweep, tmp_path / name)


def test_a_row_of_another_version_is_refused_and_not_kept(tmp_path: Path) -> None:
    sweep, path = written(tmp_path), tmp_path / "t.csv"
    with SweepStore(sweep, path) as store:
        for wrong in (made(sweep.runs()[0], torque=1.0), {"run": 0}):
            with refused(SweepError, "version"):
                store.add(wrong)
        store.add(made(sweep.runs()[1]))
    assert [row["run"] for row in table(path)] == ["1"]
    with SweepStore(sweep, path) as store:
        assert list(store.rows) == [1]


def test_one_process_writes_at_a_time_and_nothing_stays_of_nothing(tmp_path: Path) -> None:
    sweep, path = written(tmp_path), tmp_path / "t.csv"
    with SweepStore(sweep, path), refused(SweepError, "process"):
        SweepStore(sweep, path)
    assert {p.name for p in tmp_path.iterdir()} == {"s.yaml"}


def test_a_journal_that_goes_away_before_it_is_locked_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another process that has run nothing removes it in just that moment."""
    sweep, path = written(tmp_path), tmp_path / "t.csv"
    calls = []

    def flock(stream: int, how: int) -> None:
        calls.append(stream)
        if len(calls) == 1:
            store.journal.unlink()

    store = SweepStore.__new__(SweepStore)
    store.path, store.journal = path, tmp_path / "t.csv.journal"
    monkeypatch.setattr(fcntl, "flock", flock)
    stream = store._opened()
    try:
        assert len(calls) == 2
        assert os.path.samestat(os.fstat(stream), os.stat(store.journal))
    finally:
        os.close(stream)
    store.journal.unlink()

    def no_locks(stream: int, how: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    with refused(SweepError, "No locks available"):
        SweepStore(sweep, path)


def test_what_ended_a_sweep_is_not_hidden_by_what_came_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    sweep, path = written(tmp_path), tmp_path / "t.csv"

    def full(*_: object) -> None:
        raise InputError("t.csv: cannot write: No space left on device")

    monkeypatch.setattr("elastic_strips.sim.sweep.store.atomic_write", full)
    store = SweepStore(sweep, path)
    store.add(made(sweep.runs()[0]))
    store.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert "No space left" in caplog.text
    with refused(InputError, "No space left"), SweepStore(sweep, path) as store:
        assert len(store.rows) == 1


@pytest.mark.process
def test_a_sweep_in_two_halves_is_the_sweep(tmp_path: Path) -> None:
    """Apart from what the clock has a part in."""
    sweep = written(tmp_path, "kind: plan\nscenarios: [case-1]\nseeds: [0, 1]\ngrid: {influence: [0.2, 0.3]}\n")
    with SweepStore(sweep, tmp_path / "halves.csv") as store:
        jobs = run_sweep(store, processes=2)
        for _ in range(2):
            next(jobs)
        jobs.close()
    with SweepStore(sweep, tmp_path / "halves.csv") as store:
        assert len(list(run_sweep(store, processes=1))) == 2
        assert not list(run_sweep(store))
        halves = store.rows
    for run in sweep.runs():
        for name, value in execute(run).items():
            assert name in CLOCKED or halves[run.index][name] == value, name
    assert len((tmp_path / "halves.csv.journal").read_text().splitlines()) == 5


# --- the picture -------------------------------------------------------------------------------------------------


def test_what_is_drawn_is_what_varies(tmp_path: Path) -> None:
    sweep = written(tmp_path)
    assert plot_columns(sweep) == Plot("influence", "clearance_m", "k_r")
    assert plot_columns(sweep, Plot(x="scenario")) == Plot("scenario", "clearance_m", "influence")
    assert plot_columns(sweep, Plot(hue="influence")).x == "k_r"
    chosen = written(tmp_path, PLANS + "plot: {x: k_r, y: certified, hue: scenario}\n")
    assert plot_columns(chosen) == Plot("k_r", "certified", "scenario")
    bare = written(tmp_path, "kind: drive\nscenarios: [case-1]\nseeds: [1, 2]\n")
    assert plot_columns(bare) == Plot("seed", "time_s", None)
    for wrong in (Plot(x="influense"), Plot(y="reason"), Plot(hue="speed")):
        with pytest.raises(ParameterError):
            plot_columns(sweep, wrong)


@each("plot", [Plot(), Plot(x="scenario"), Plot(y="certified", hue="preset")])
def test_a_picture_is_drawn(plot: Plot, tmp_path: Path) -> None:
    sweep = written(tmp_path)
    rows = [made(run, certified=run.index % 3 > 0, preset="default") for run in sweep.runs()]
    rows[2] |= {"clearance_m": None, "certified": None}
    plot_sweep(sweep, rows, tmp_path / "p.png", plot=plot)
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
    with refused(SweepError, "draw"):
        plot_sweep(sweep, rows[2:3], tmp_path / "q.png", plot=plot)
    with refused(SweepError, "q.xyz"):
        plot_sweep(sweep, rows, tmp_path / "q.xyz", plot=plot)
    assert not os.path.exists(tmp_path / "q.png")


@pytest.mark.parametrize("plot", [Plot(x="scenario"), Plot(x="k_r", hue="scenario")])
def test_names_in_a_picture_are_no_formulas(plot: Plot, tmp_path: Path) -> None:
    names = [r"_a$\foo$.yaml", r"b$\frac{.yaml$"]
    sweep = Sweep(tmp_path / r"s $\bar{$.yaml", "plan", tuple(names), grid={"k_r": (1, 2)})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plot_sweep(sweep, [made(run, preset="default") for run in sweep.runs()], tmp_path / "p.png", plot=plot)
    assert (tmp_path / "p.png").exists()
