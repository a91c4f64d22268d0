"""A study of proofs: what the checker takes is looked at every millimetre, and what was tampered with is handed to it.

Random robots, scenes and paths (as in ``attack.py``). Each proof that is made is written, checked as a file by the
command of :mod:`elastic_strips.proof_checker`, and the path walked with Coal. Some are then tampered with: what is said
of robot, scene or path (which the digests of the true ones catch), what is claimed, what is left out. Where an edit of
the claim is taken, the walk has to say that it is true.

    python tests/oracle/proof_study.py --proofs 100000 --tampered 10000
"""

from __future__ import annotations

import argparse
import contextlib
import io
import itertools
import json
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import numpy.typing as npt
from attack import Attack, Figures
from random_robots import random_urdf

from elastic_strips import proof_checker as checker
from elastic_strips.collision import prove
from elastic_strips.robot import load_robot
from elastic_strips.scene import Scene

Array = npt.NDArray[np.float64]
Parts = dict[str, Any]

_BASES = ("fixed", "omni", "diff_drive")
_COVER = ("segment", "pair", "span", "normal")


@dataclass
class Findings:
    """What was found."""

    proofs: int = 0
    unproven: int = 0
    refused: list[str] = field(default_factory=list)
    false: list[str] = field(default_factory=list)
    tampered: Counter[tuple[str, str]] = field(default_factory=Counter)
    taken: list[str] = field(default_factory=list)
    intervals: int = 0
    robots: int = 0
    walks: Figures = field(default_factory=Figures)
    seconds: float = 0.0

    def add(self, other: Findings) -> None:
        self.proofs += other.proofs
        self.unproven += other.unproven
        self.refused += other.refused
        self.false += other.false
        self.tampered += other.tampered
        self.taken += other.taken
        self.intervals += other.intervals
        self.robots += other.robots
        self.walks.add(other.walks)
        self.seconds += other.seconds

    @property
    def wrong(self) -> list[str]:
        return [*self.refused, *self.false, *self.taken]

    def table(self) -> str:
        rows = ["| tampered with | files | refused | taken, and true |", "|---|---|---|---|"]
        for name in sorted({n for n, _ in self.tampered}):
            refused, true = self.tampered[name, "refused"], self.tampered[name, "true"]
            rows.append(f"| {name} | {refused + true} | {refused} | {true} |")
        return "\n".join(rows) + (
            f"\n\n{self.proofs} proofs of {self.robots} robots taken ({self.intervals} intervals), "
            f"{len(self.refused)} refused by the checker, "
            f"{len(self.false)} of paths that touch; {self.unproven} paths have none; {self.walks.samples} samples; "
            f"{sum(self.tampered.values())} files tampered with, {len(self.taken)} taken that are not true; "
            f"{self.seconds:.0f} s of a core"
        )


def _shift_obstacle(rng: np.random.Generator, header: Parts, parts: Parts) -> None:
    """An obstacle stands elsewhere."""
    header["scene"][int(rng.integers(len(header["scene"])))]["translation"][int(rng.integers(3))] += rng.normal() * 0.1


def _drop_obstacle(rng: np.random.Generator, header: Parts, parts: Parts) -> None:
    """An obstacle is left out, with all that is said of it."""
    k, count = int(rng.integers(len(header["scene"]))), len(header["scene"])
    bodies = len(header["robot"]["bodies"])
    pair = parts["pair"]
    across = pair < bodies * count
    keep = ~(across & (pair % count == k))
    body, obstacle = pair // count, pair % count
    new = np.where(across, body * (count - 1) + obstacle - (obstacle > k), pair - bodies)
    for name in _COVER:
        parts[name] = (new if name == "pair" else parts[name])[keep]
    header["scene"].pop(k)


def _other_robot(rng: np.random.Generator, header: Parts, parts: Parts) -> None:
    """A link is longer, or a body thinner."""
    robot = header["robot"]
    joints = len(robot["joints"]) - robot["planar"]
    if joints and rng.random() < 0.5:
        joint = robot["joints"][int(rng.integers(robot["planar"], len(robot["joints"])))]
        joint["offset"][int(rng.integers(3))][3] += float(rng.normal() * 0.1)
    else:
        body = robot["bodies"][int(rng.integers(len(robot["bodies"])))]
        body["translation"][int(rng.integers(3))] += float(rng.normal() * 0.1)


def _drop_self_pair(rng: np.random.Generator, header: Parts, parts: Parts) -> None:
    """Two links may meet."""
    robot = header["robot"]
    k = int(rng.integers(len(robot["pairs"])))
    number = len(robot["bodies"]) * len(header["scene"]) + k
    pair = parts["pair"]
    keep = pair != number
    for name in _COVER:
        parts[name] = (pair - (pair > number) if name == "pair" else parts[name])[keep]
    robot["pairs"].pop(k)


def _other_path(rng: np.random.Generator, header: Parts, parts: Parts) -> None:
    """A row of the path is another one."""
    rows = parts["rows"] = parts["rows"].copy()
    rows[int(rng.integers(len(rows))), int(rng.integers(rows.shape[1]))] += rng.normal() * 0.05


def _drop_interval(rng: np.random.Generator, header: Parts, parts: Parts) -> None:
    """Something is not proven."""
    k = int(rng.integers(len(parts["pair"])))
    for name in _COVER:
        parts[name] = np.delete(parts[name], k, axis=0)


def _edit_span(rng: np.random.Generator, header: Parts, parts: Parts) -> None:
    """An interval begins later or ends earlier than the next one begins."""
    span = parts["span"] = parts["span"].copy()
    k, e = int(rng.integers(len(span))), int(rng.integers(2))
    span[k, e] += (1 - 2 * e) * float(rng.uniform(0.01, 0.9)) * (span[k, 1] - span[k, 0])


def _swap_pair(rng: np.random.Generator, header: Parts, parts: Parts) -> None:
    """What is said of one pair is said of another."""
    pair = parts["pair"] = parts["pair"].copy()
    k = int(rng.integers(len(pair)))
    pair[k] = (pair[k] + 1 + int(rng.integers(max(int(pair.max()), 1)))) % (int(pair.max()) + 1)


def _turn_normal(rng: np.random.Generator, header: Parts, parts: Parts) -> None:
    """A direction is another one; along it there may be room too."""
    normal = parts["normal"] = parts["normal"].copy()
    normal[int(rng.integers(len(normal))), int(rng.integers(2))] = rng.normal(size=3)


def _other_way(rng: np.random.Generator, header: Parts, parts: Parts) -> None:
    """The rows are the same, and the robot goes another way between them."""
    header["way"] = str(rng.choice([way for way in ("values", "shortest", "arc") if way != header["way"]]))


def _wrapping(rng: np.random.Generator, header: Parts, parts: Parts) -> None:
    """A column of which values a whole turn apart are said to be one, or no longer."""
    circular = header["robot"]["circular"]
    k = int(rng.integers(len(circular)))
    circular[k] = not circular[k]


def _follower(rng: np.random.Generator, header: Parts, parts: Parts) -> None:
    """A joint follows its column by another part, or from elsewhere."""
    joint = header["robot"]["joints"][int(rng.integers(header["robot"]["planar"], len(header["robot"]["joints"])))]
    joint[str(rng.choice(["multiplier", "constant"]))] += float(rng.normal())


def _other_parent(rng: np.random.Generator, header: Parts, parts: Parts) -> None:
    """A joint stands on another one, or on the world, and no longer moves with the base."""
    joints = header["robot"]["joints"]
    k = int(rng.integers(1, len(joints)))
    joints[k]["parent"] = int(rng.choice([p for p in range(-1, k) if p != joints[k]["parent"]]))


def _text(rng: np.random.Generator, header: Parts, parts: Parts) -> None:
    """A number is text, or a truth value."""
    header["clearance"] = [str(header["clearance"]), True, None, [header["clearance"]]][int(rng.integers(4))]


def _far(rng: np.random.Generator, header: Parts, parts: Parts) -> None:
    """Numbers in which a metre is lost."""
    parts["rows"] = parts["rows"] + np.where(np.arange(parts["rows"].shape[1]) == 0, 10.0 ** rng.uniform(7, 17), 0.0)


def _larger_clearance(rng: np.random.Generator, header: Parts, parts: Parts) -> None:
    """More is claimed than was proven."""
    header["clearance"] += float(10.0 ** rng.uniform(-3, -0.5))


CAUGHT: tuple[Callable[[np.random.Generator, Parts, Parts], None], ...] = (
    _shift_obstacle, _drop_obstacle, _other_robot, _drop_self_pair, _other_path, _drop_interval, _edit_span,
    _swap_pair, _other_way, _wrapping, _follower, _other_parent, _text, _far,
)  # fmt: skip
"""Edits that are refused whatever they are: the digests, or the cover, are others."""
JUDGED = (_turn_normal, _larger_clearance)
"""Edits after which the proof may still hold, and then has to be true."""


class Study:
    """One random robot's proofs."""

    def __init__(self, seed: int, findings: Findings, folder: Path) -> None:
        self.rng, self.findings, self.file = np.random.default_rng(seed), findings, folder / "proof.npz"
        base, nv = _BASES[seed % 3], 3 + (seed // 3) % 14
        robot = load_robot(random_urdf(self.rng, folder, nv - (0 if base == "fixed" else 3)), base=base)
        self.attack = Attack(robot, self.rng, findings.walks, f"seed {seed}")
        self.name = f"seed {seed}, {base}, nv {nv}"

    def run(self, proofs: int, tampered: float) -> None:
        """So many proofs in all, a share of them tampered with once; fewer where hardly a path is free."""
        done = tried = 0
        while self.findings.proofs < proofs and tried < min(4 * proofs, 100 + 40 * done):
            scene = self.attack.scene(int(self.rng.integers(1, 5)))
            for _ in range(10):
                done += self.one(scene, tampered)
                tried += 1
        self.findings.robots += 1

    def one(self, scene: Scene, tampered: float) -> bool:
        rng, findings, walker = self.rng, self.findings, self.attack.checker
        clearance = float(rng.choice([1e-3, 5e-3, 2e-2]))
        strip = self.attack.chain(int(rng.integers(1, 4)))
        robot = strip.robot
        proof = prove(robot, scene, strip, clearance=clearance, self_clearance=1e-3)
        if proof is None:
            findings.unproven += 1
            return False
        header, parts = json.loads(json.dumps(proof.header)), {
            "rows": proof.rows, "segment": proof.segment, "pair": proof.pair, "span": proof.span,
            "normal": proof.normal,
        }  # fmt: skip
        if self.command(header, parts, proof.digests) != 0:
            findings.refused.append(f"{self.name}: refused")
        walker.take(scene, clearance, 1e-3)
        if any(walker.overlaps(a, b) for a, b in pairwise(strip.q)):
            findings.false.append(f"{self.name}: taken, and touches")
        findings.proofs += 1
        findings.intervals += len(proof.span)
        if rng.random() < tampered:
            self.tamper(scene, strip.q, header, parts, proof.digests)
        return True

    def command(self, header: Parts, parts: Parts, digests: dict[str, str]) -> int:
        """The checker's command on a file, told which robot, scene and path are meant."""
        np.savez(self.file, header=np.array(json.dumps(header)), **parts)
        arguments = [str(self.file), *(part for k, v in digests.items() for part in (f"--{k}", v))]
        with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(out):
            try:
                return checker.main(arguments)
            except (TypeError, ValueError):  # it was taken, and cannot be printed
                return 0

    def tamper(self, scene: Scene, q: Array, header: Parts, parts: Parts, digests: dict[str, str]) -> None:
        rng, findings = self.rng, self.findings
        joints = len(header["robot"]["joints"]) - header["robot"]["planar"]
        possible = {
            _drop_self_pair: bool(header["robot"]["pairs"]), _swap_pair: bool(parts["pair"].max() > 0),
            _follower: joints > 0, _other_parent: len(header["robot"]["joints"]) > 1,
        }  # fmt: skip
        edits = [e for e in (*CAUGHT, *JUDGED) if possible.get(e, True)]
        edit = edits[int(rng.integers(len(edits)))]
        edit(rng, header, parts)
        name = edit.__name__[1:].replace("_", " ")
        if self.command(header, parts, digests) == 3:
            findings.tampered[name, "refused"] += 1
            return
        findings.tampered[name, "true"] += 1
        if edit in CAUGHT:
            findings.taken.append(f"{self.name}: {name}")
            return
        walker = self.attack.checker
        walker.take(scene, header["clearance"], header["self_clearance"])
        if any(walker.overlaps(a, b) for a, b in pairwise(q)):
            findings.taken.append(f"{self.name}: {name}, and touches")


def run_robot(seed: int, proofs: int, tampered: float) -> Findings:
    """So many proofs, of which a share is tampered with: of one robot, and of others where it is hardly ever free."""
    began, findings = process_time(), Findings()
    with tempfile.TemporaryDirectory() as folder:
        for again in itertools.count():
            Study(seed + 10**6 * again, findings, Path(folder)).run(proofs, tampered)
            if findings.proofs >= proofs:
                break
    findings.seconds = process_time() - began
    return findings


def run_all(proofs: int, tampered: int, seed: int, processes: int = 1, *, each: int = 1000) -> Findings:
    """So many proofs of as many robots as it takes, and about so many files tampered with."""
    total = Findings()
    works = [(1000 * seed + k, min(each, proofs), tampered / proofs) for k in range(max(1, -(-proofs // each)))]
    if processes <= 1:
        for work in works:
            total.add(run_robot(*work))
        return total
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for k, ended in enumerate(as_completed([pool.submit(run_robot, *work) for work in works])):
            total.add(ended.result())
            if (k + 1) % 5 == 0:
                print(f"{total.proofs} proofs, {len(total.wrong)} wrong", file=sys.stderr, flush=True)
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--proofs", type=int, default=1000)
    parser.add_argument("--tampered", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--each", type=int, default=1000, help="proofs a robot")
    parser.add_argument("--processes", type=int, default=min(2, os.cpu_count() or 1))
    given = parser.parse_args()
    findings = run_all(given.proofs, given.tampered, given.seed, given.processes, each=given.each)
    for line in findings.wrong[:50]:
        print(line)
    print(findings.table())
    sys.exit(bool(findings.wrong))


if __name__ == "__main__":
    main()
