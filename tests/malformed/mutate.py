"""Mutated inputs over all readers: each one is accepted, or refused by a typed error; nothing else, and in bounds.

``python tests/malformed/mutate.py --count 10000 --seed 1`` prints counts by reader and outcome, and what went wrong.
``--only K`` repeats one of them in this process, with its traceback. Input K of a seed is always the same; where
``--kind`` names one reader, it is input K of that reader.
"""

from __future__ import annotations

import argparse
import gc
import json
import logging
import multiprocessing
import os
import resource
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import chain
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from mutations import mutate
from seeds import Seed, seeds

from elastic_strips.errors import InputError

MEMORY = 1_000_000_000
"""Most memory [B] that one input may take beyond what the libraries hold."""
SECONDS = 60.0
"""Time after which an input counts as a hang [s]."""
BAD = ("raw exception", "hang", "crash", "too much memory")
OUTCOMES = ("accepted", "refused", *BAD)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of an input: one of `OUTCOMES`, what was said, seconds, and bytes at the peak."""

    index: int
    kind: str
    outcome: str
    said: str
    seconds: float
    memory: int


def attempt(found: tuple[Seed, ...], seed: int, index: int, folder: Path) -> Outcome:
    """Make one input, read it, and see what comes of it."""
    rng = np.random.default_rng([seed, index])
    weights = np.array([s.weight for s in found])
    chosen = found[int(rng.choice(len(found), p=weights / weights.sum()))]
    path = mutate(chosen, found, folder, rng)
    gc.collect()
    before = _reset_peak()
    begin = time.perf_counter()
    try:
        chosen.reader(path)
        outcome, said = "accepted", ""
    except InputError as error:
        outcome, said = "refused", f"{type(error).__name__}: {error}"
        if len(str(error)) > 1500 or "\n" in str(error):
            outcome, said = "raw exception", f"a message of {len(str(error))} characters or several lines: {said[:200]}"
    except MemoryError as error:
        outcome, said = "too much memory", _place(error)
    except Exception as error:
        outcome, said = "raw exception", _place(error)
    seconds = time.perf_counter() - begin
    memory = max(_peak() - before, 0)
    if memory > MEMORY:
        outcome = "too much memory"
    return Outcome(index, chosen.kind, outcome, said, seconds, memory)


def _place(error: BaseException) -> str:
    """Type, message and innermost place of ours."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [f for f in frames if "elastic_strips" in f.filename and "malformed" not in f.filename] or frames
    text = " ".join(str(error).split())[:120]
    return f"{type(error).__name__}: {text} ({Path(ours[-1].filename).name}:{ours[-1].lineno} {ours[-1].name})"


def _status(key: str) -> int:
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:  # no Linux
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(key))


def _reset_peak() -> int:
    """Forget the peak of the resident memory; returns what is resident now [B]."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return _status("VmHWM:")
    return _status("VmRSS:")


def _peak() -> int:
    return _status("VmHWM:")


def _of(kind: str | None) -> tuple[Seed, ...]:
    """The seeds of a reader, or all."""
    return tuple(one for one in seeds() if kind in (None, one.kind))


def _work(pipe: Connection, seed: int, kind: str | None) -> None:
    """A worker: a memory limit, no output, one input after another."""
    logging.disable(logging.CRITICAL)
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    found = _of(kind)
    for one in found:  # the sound ones: they must be accepted, and load whatever is loaded late
        folder = Path(tempfile.mkdtemp())
        for name, content in {**one.beside, one.file: one.content}.items():
            (folder / name).write_bytes(content)
        try:
            one.reader(folder / one.file)
        except Exception as error:
            pipe.send({"broken": f"{one.kind} {one.file}: {_place(error)}"})
            return
        finally:
            shutil.rmtree(folder)
    gc.collect()
    gc.freeze()  # so that to collect before each input is quick
    limit = _status("VmData:") + MEMORY + 300_000_000  # beyond it allocation fails; before it the peak counts
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    pipe.send({"ready": True})
    while (index := pipe.recv()) is not None:
        folder = Path(tempfile.mkdtemp())
        try:
            pipe.send(asdict(attempt(found, seed, index, folder)))
        finally:
            shutil.rmtree(folder, ignore_errors=True)


class _Worker:
    """A process, and what it is busy with."""

    def __init__(self, seed: int, kind: str | None) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs, seed, kind), daemon=True)
        self.process.start()
        theirs.close()
        self.index: int | None = None
        self.ready = False
        self.since = time.monotonic()

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()


def run(
    count: int, seed: int, workers: int = 1, seconds: float = SECONDS, kind: str | None = None
) -> Iterator[Outcome]:  # fmt: skip
    """Outcomes of so many inputs, of one reader or of all, as they come."""
    todo: Iterator[int] = iter(range(count))
    team = [_Worker(seed, kind) for _ in range(workers)]
    kinds = _kinds(seed, kind)
    try:
        while team:
            wait([w.pipe for w in team], timeout=1.0)
            for worker in list(team):
                answer: dict[str, Any] | None = None
                late = time.monotonic() - worker.since > (seconds if worker.ready else 300.0)
                try:
                    if worker.pipe.poll():
                        answer = worker.pipe.recv()
                        if "broken" in answer:
                            raise RuntimeError(f"a sound input is refused: {answer['broken']}")
                    elif not late:
                        continue
                except (EOFError, ConnectionError):
                    pass
                if answer is None:  # it ended, or does not end
                    if worker.index is None:
                        raise RuntimeError("a worker ended before its first input")
                    what = "hang" if late else "crash"
                    if not late:
                        worker.process.join(5.0)
                    code = worker.process.exitcode
                    worker.end()
                    yield Outcome(
                        worker.index, kinds(worker.index), what, f"exit code {code}", seconds if late else 0.0, 0
                    )
                    team.remove(worker)
                    spare = next(todo, None)
                    if spare is not None:
                        todo = chain([spare], todo)
                        team.append(_Worker(seed, kind))
                    continue
                if worker.ready:
                    yield Outcome(**answer)
                worker.ready = True
                worker.index = next(todo, None)
                worker.since = time.monotonic()
                if worker.index is None:
                    worker.end()
                    team.remove(worker)
                else:
                    worker.pipe.send(worker.index)
    finally:
        for worker in team:
            worker.end()


def _kinds(seed: int, kind: str | None) -> Any:
    found = _of(kind)
    weights = np.array([s.weight for s in found])
    weights /= weights.sum()
    return lambda index: found[int(np.random.default_rng([seed, index]).choice(len(found), p=weights))].kind


def table(outcomes: list[Outcome]) -> str:
    """Counts by reader and outcome, with the longest time and the highest peak."""
    by_kind: dict[str, list[Outcome]] = defaultdict(list)
    for one in outcomes:
        by_kind[one.kind].append(one)
    rows = [("reader", "inputs", *OUTCOMES, "longest [s]", "peak [MB]")]
    for kind, ones in [*sorted(by_kind.items()), ("all", outcomes)]:
        counts = Counter(one.outcome for one in ones)
        rows.append(
            (
                kind,
                str(len(ones)),
                *(str(counts[o]) for o in OUTCOMES),
                f"{max((o.seconds for o in ones), default=0.0):.1f}",
                f"{max((o.memory for o in ones), default=0) / 1e6:.0f}",
            )
        )
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = ["| " + " | ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) + " |" for row in rows]
    lines.insert(1, "|" + "|".join("-" * (w + 2) for w in widths) + "|")
    return "\n".join(lines)


def main() -> int:
    """Run, print the table; 1 where something went wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=max((os.cpu_count() or 1) - 1, 1))
    parser.add_argument("--kind", choices=sorted({one.kind for one in seeds()}), help="the inputs of one reader")
    parser.add_argument("--only", type=int, help="repeat one input in this process; --keep FOLDER keeps its files")
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--json", type=Path, help="write all outcomes")
    given = parser.parse_args()
    if given.only is not None:
        found = _of(given.kind)
        folder = given.keep or Path(tempfile.mkdtemp())
        folder.mkdir(exist_ok=True)
        rng = np.random.default_rng([given.seed, given.only])
        weights = np.array([s.weight for s in found])
        chosen = found[int(rng.choice(len(found), p=weights / weights.sum()))]
        path = mutate(chosen, found, folder, rng)
        print(chosen.kind, path, flush=True)
        chosen.reader(path)
        print("accepted")
        return 0
    begin, outcomes = time.monotonic(), []
    for one in run(given.count, given.seed, given.workers, kind=given.kind):
        outcomes.append(one)
        if one.outcome in BAD:
            print(f"{one.index}: {one.kind}: {one.outcome}: {one.said}", flush=True)
    print(table(outcomes))
    print(f"{len(outcomes)} inputs, seed {given.seed}, in {time.monotonic() - begin:.0f} s")
    if given.json:
        given.json.write_text(json.dumps([asdict(o) for o in outcomes]))
    return int(any(o.outcome in BAD for o in outcomes))


if __name__ == "__main__":
    sys.exit(main())
