"""Sweeps that are killed: how many rows are lost or twice, and what a run costs beside its computing.

A sweep of tiny plans is ended by ``kill -9`` at moments spread over it and begun again until it is complete, into CSV
and into Parquet; then one of two workers of a Dask cluster is killed in the middle of another. Overhead is of a sweep
that nobody disturbs, on two processes: their time for a run, beyond what the run says that it took.

``python tests/oracle/killed_sweeps.py --runs 500 --kills 3`` prints a line of JSON for each.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
from collections import Counter
from multiprocessing.process import BaseProcess
from pathlib import Path

import odd_jobs
import pyarrow.csv
import pyarrow.parquet
from command_line import CALL

ROOM = "robot: jackal-box\nstart: {}\ngoal: {x: 1}\nscene: {obstacles: []}\n"


def sweep(
    folder: Path, out: str, runs: int, kills: int = 0, where: tuple[str, ...] = ("--processes", "2"),
    victim: BaseProcess | None = None,
) -> dict[str, object]:  # fmt: skip
    """Run a sweep, killed so many times, or with a worker killed in its middle; count its rows."""
    (folder / "room.yaml").write_text(ROOM)
    (folder / "s.yaml").write_text(f"kind: plan\nscenarios: [room.yaml]\nseeds: {{count: {runs}}}\n")
    table, journal = folder / out, folder / f"{out}.journal"
    words = [*CALL, "sweep", str(folder / "s.yaml"), "--out", str(table), *where]

    def begin(until: int) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while process.poll() is None and (not journal.exists() or journal.read_bytes().count(b"\n") - 1 < until):
            time.sleep(0.001)
        return process

    for kill in range(1, kills + 1):
        process = begin(kill * runs // (kills + 1))
        process.kill()
        process.wait()
    began = time.perf_counter()
    process = begin(runs // 2)
    if victim is not None:
        victim.kill()
    assert process.wait() == 0
    seconds = time.perf_counter() - began
    kept = [json.loads(line) for line in journal.read_text().splitlines()[1:]]
    read = pyarrow.parquet.read_table(table) if table.suffix == ".parquet" else pyarrow.csv.read_csv(table)
    counts = Counter(row["run"] for row in kept)
    assert read["run"].to_pylist() == sorted(counts)
    return {
        "table": out, "runs": runs, "kills": kills, "lost": runs - len(counts), "twice": len(kept) - len(counts),
        "errors": sum(row["error"] is not None for row in kept), "last_s": round(seconds, 2),
        "run_ms": round(1e3 * sum(row["wall_s"] for row in kept) / runs, 2),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=500)
    parser.add_argument("--kills", type=int, default=3)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for out in ("killed.csv", "killed.parquet"):
            print(json.dumps(sweep(folder, out, given.runs, given.kills)), flush=True)
        with odd_jobs.cluster(folder) as (address, (_, worker, _other)):
            found = sweep(folder, "cluster.csv", given.runs, where=("--scheduler", address), victim=worker)
        print(json.dumps(found), flush=True)
        few, all_ = sweep(folder, "few.csv", 20), sweep(folder, "undisturbed.csv", given.runs)
        each = 2e3 * (float(str(all_["last_s"])) - float(str(few["last_s"]))) / (given.runs - 20)
        print(json.dumps({**all_, "overhead_ms": round(each - float(str(all_["run_ms"])), 2)}), flush=True)


if __name__ == "__main__":
    main()
