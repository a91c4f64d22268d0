"""A study of `certify`: paths of samplers and interpolations, and what a look at every millimetre of them says.

Paths are found as others find them: OMPL's RRTConnect with its own discrete check of motions, and straight motions of
the joints, accepted where samples are free (as for a waypoint interface) or taken as they are; each at four
resolutions. Then the path is walked in steps in which no point moves by more than a millimetre, and Coal is asked at
every step whether anything touches, and whether anything comes nearer than 5 mm. Nothing of the certificate is used
for that (see ``attack.py``).

    python tests/oracle/path_study.py --root FOLDER_WITH_MBM --stride 1
    python tests/oracle/path_study.py --ways 10000 --processes 2     # turns, worlds with timetables: way_study.py
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import cast

import numpy as np
import numpy.typing as npt

sys.path.append(str(Path(__file__).parents[2]))  # for the workshop, which is beside the package

from attack import Checker, Figures
from brute_force import link_distances, self_distances
from way_study import WAYS, WORLDS, study_ways

from elastic_strips.collision import Verdict, certify
from elastic_strips.errors import ConfigurationError
from elastic_strips.planning.ompl_planner import OMPL_LOCK, seed_ompl
from elastic_strips.planning.validity import ValidityChecker
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from workshop.reach_problems import MBM_ROBOTS, load_mbm

Array = npt.NDArray[np.float64]

RESOLUTIONS = (0.05, 0.02, 0.01, 0.005)
"""Between two samples of a motion, as parts of the joints' whole range (OMPL's default is 0.01)."""
KINDS = ("rrtconnect", "accepted line", "any line")
FREE = 5e-3
"""A path that keeps this distance [m] is to be certified."""
_TOUCH = 2e-5  # [m] what Coal's distances scatter by


@dataclass
class Findings:
    """Counts of paths by (kind, resolution, what)."""

    counts: Counter[tuple[str, float, str]] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    milliseconds: list[float] = field(default_factory=list)
    walks: Figures = field(default_factory=Figures)

    def total(self, what: str, kind: str | None = None, resolution: float | None = None) -> int:
        return sum(
            n for (k, r, w), n in self.counts.items()
            if w == what and kind in (None, k) and resolution in (None, r)
        )  # fmt: skip

    @property
    def false_alarms(self) -> float:
        """Share of the paths that keep 5 mm and were not certified."""
        free = self.total("clear")
        return self.total("alarm") / free if free else 0.0

    def add(self, other: Findings) -> None:
        self.counts.update(other.counts)
        self.wrong += other.wrong
        self.milliseconds += other.milliseconds
        self.walks.add(other.walks)

    def further(self) -> tuple[str, ...]:
        """What is counted of ways only."""
        return tuple(what for what in ("no way said", "proofs") if self.total(what))

    def table(self) -> str:
        names = ("paths", "touching", "certified", "refuted", "unknown", "missed", "clear", "alarm", *self.further())
        rows: list[tuple[str, ...]] = [("kind", "resolution", *names)]

        def row(kind: str | None, resolution: float | None) -> None:
            numbers = [self.total(n, kind, resolution) for n in names]
            if numbers[0]:
                rows.append((kind or "all", "all" if resolution is None else f"{resolution:g}", *map(str, numbers)))

        for kind in (*KINDS, *WAYS, *WORLDS):
            for resolution in RESOLUTIONS:
                row(kind, resolution)
            row(kind, None)
        row(None, None)
        text = "\n".join("| " + " | ".join(r) + " |" for r in rows)
        text = text.replace("\n", "\n" + "|---" * (len(names) + 2) + "|\n", 1)
        ms = np.percentile(self.milliseconds, (50, 95, 99)) if self.milliseconds else np.zeros(3)
        return text + (
            f"\n\nfalse alarms {100 * self.false_alarms:.2f} % of the paths that keep {1e3 * FREE:g} mm; certify took "
            f"p50 {ms[0]:.1f}, p95 {ms[1]:.1f}, p99 {ms[2]:.1f} ms; {self.walks.samples} samples, no point further "
            f"than {1e3 * self.walks.longest_step:.2f} mm from one to the next"
        )


class Study:
    """One robot's paths: finds, certifies and walks them."""

    def __init__(self, robot: RobotModel, findings: Findings) -> None:
        self.robot, self.findings = robot, findings
        self.checker = Checker(robot, findings.walks)
        self.low = np.clip(robot.space.lower, -np.pi, np.pi)
        self.high = np.clip(robot.space.upper, -np.pi, np.pi)
        self.extent = float(np.linalg.norm(self.high - self.low))

    def scene(self, name: str, scene: Scene, ends: Array, rng: np.random.Generator) -> None:
        """Study the paths of one scene; ``ends`` (2, nv) are the start and goal of its problem."""
        self.checker.take(scene, _TOUCH, _TOUCH, free=FREE - _TOUCH)
        valid = ValidityChecker(self.robot, scene, margin=0.0)
        if not (valid.at(ends[0]) and valid.at(ends[1])):
            return
        for resolution in RESOLUTIONS:
            for kind, path in self.paths(valid, ends, resolution, rng):
                self.judge(f"{name}, {kind} at {resolution:g}", kind, resolution, scene, path)

    def paths(
        self, valid: ValidityChecker, ends: Array, resolution: float, rng: np.random.Generator
    ) -> Iterator[tuple[str, Array]]:
        found = self.rrtconnect(valid, ends, resolution, int(rng.integers(1, 2**31)))
        if found is not None:
            yield "rrtconnect", found
        for _ in range(2):
            line = self.line(valid, ends, resolution, rng, accepted=True)
            if line is not None:
                yield "accepted line", line
        for _ in range(2):
            line = self.line(valid, ends, resolution, rng, accepted=False)
            if line is not None:
                yield "any line", line

    def rrtconnect(self, valid: ValidityChecker, ends: Array, resolution: float, seed: int) -> Array | None:
        """OMPL as it comes: states are checked, and motions at so many places."""
        from ompl import base as ob
        from ompl import geometric as og

        nv = self.robot.nv
        with OMPL_LOCK:
            seed_ompl(seed)
            space = ob.RealVectorStateSpace(nv)
            bounds = ob.RealVectorBounds(nv)
            for k in range(nv):
                bounds.setLow(k, float(min(self.low[k], *ends[:, k])))
                bounds.setHigh(k, float(max(self.high[k], *ends[:, k])))
            space.setBounds(bounds)
            setup = og.SimpleSetup(space)
            info = setup.getSpaceInformation()

            def row(state: ob.State) -> Array:
                return np.array(cast("ob.RealVectorStateType", state)[0:nv])

            setup.setStateValidityChecker(lambda state: valid.at(row(state)))
            info.setStateValidityCheckingResolution(resolution)
            first, last = (cast("ob.RealVectorStateType", space.allocState()) for _ in range(2))
            for state, end in ((first, ends[0]), (last, ends[1])):
                for k in range(nv):
                    state[k] = float(end[k])
            setup.setStartAndGoalStates(first, last, 1e-9)
            setup.setPlanner(og.RRTConnect(info))
            if not setup.solve(2.0) or not setup.haveExactSolutionPath():
                return None
            setup.simplifySolution(1.0)
            return np.array([row(state) for state in setup.getSolutionPath().getStates()])

    def line(
        self, valid: ValidityChecker, ends: Array, resolution: float, rng: np.random.Generator, *, accepted: bool
    ) -> Array | None:
        """A straight motion, waypoints as far apart as the resolution says; of a robot's way, not to anywhere."""
        step = resolution * self.extent
        for _ in range(30):
            one = ends[int(rng.integers(2))]
            two = np.clip(one + rng.normal(size=one.shape) * 10.0 ** rng.uniform(-0.8, 0.3), self.low, self.high)
            count = max(1, int(np.ceil(np.linalg.norm(two - one) / step)))
            rows = one + np.linspace(0.0, 1.0, count + 1)[:, None] * (two - one)
            if not accepted or all(valid.at(row) for row in rows):
                return rows
        return None

    def judge(self, name: str, kind: str, resolution: float, scene: Scene, rows: Array) -> None:
        """Certify a path, walk it, and note what both say."""

        def note(what: str) -> None:
            self.findings.counts[kind, resolution, what] += 1

        q = self.robot.space.from_coordinates(rows)
        began = perf_counter()
        found = certify(self.robot, scene, q, measure=False)
        self.findings.milliseconds.append(1e3 * (perf_counter() - began))
        touches = any(self.checker.overlaps(a, b) for a, b in pairwise(q))
        note("paths")
        note(found.verdict.value)
        if touches:
            note("touching")
            if found.certified:
                note("missed")
                self.findings.wrong.append(f"{name}: certified, and touches")
        elif not any(self.checker.overlaps(a, b, free=True) for a, b in pairwise(q)):
            note("clear")
            if not found.certified:
                note("alarm")
        if found.verdict is Verdict.REFUTED:
            assert found.q is not None
            nearest = link_distances(self.robot, scene, found.q).min(initial=np.inf)
            own = self_distances(self.robot, found.q).min(initial=np.inf)
            if min(nearest, own) > _TOUCH:
                self.findings.wrong.append(
                    f"{name}: refuted by a configuration that is free by {min(nearest, own):g} m"
                )


def study_mbm(root: Path, names: tuple[str, ...], findings: Findings, *, first: int, stride: int, seed: int) -> None:
    """Study paths among MotionBenchMaker's scenes."""
    for name in names:
        robot, problems = load_mbm(root, name)
        study = Study(robot, findings)
        chosen = problems[first::stride]
        for k, problem in enumerate(chosen):
            try:
                ends = robot.space.to_coordinates(np.array(problem.ends(robot)))
            except ConfigurationError:
                continue
            study.scene(
                f"{name} {problem.name}", problem.scene, ends, np.random.default_rng((seed, first + k * stride))
            )
            if (k + 1) % 20 == 0:
                done = f"{findings.total('paths')} paths, {len(findings.wrong)} wrong"
                print(f"{name}: {k + 1}/{len(chosen)}, {done}", file=sys.stderr, flush=True)


def ways(paths: int, seed: int, *, kinds: tuple[str, ...] = (*WAYS, *WORLDS)) -> Findings:
    """So many paths that turn, and worlds that change."""
    findings = Findings()
    study_ways(paths, seed, findings, kinds)
    return findings


def all_ways(paths: int, seed: int, processes: int, *, each: int = 225) -> Findings:
    """The same, by several processes."""
    total = Findings()
    works = [(min(each, paths - k), 1000 * seed + k // each) for k in range(0, paths, each)]
    if processes <= 1:
        for work in works:
            total.add(ways(*work))
        return total
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for done in as_completed([pool.submit(ways, *work) for work in works]):
            total.add(done.result())
            print(f"{total.total('paths')} paths, {len(total.wrong)} wrong", file=sys.stderr, flush=True)
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--root", type=Path, help="folder with mbm")
    parser.add_argument("--ways", type=int, default=0, help="paths that turn, and worlds that change")
    parser.add_argument("--processes", type=int, default=1, help="for --ways")
    parser.add_argument("--robots", nargs="+", choices=MBM_ROBOTS, default=MBM_ROBOTS)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--stride", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    findings = Findings()
    if given.root is not None:
        study_mbm(
            given.root, tuple(given.robots), findings, first=given.first, stride=given.stride, seed=given.seed
        )  # fmt: skip
    findings.add(all_ways(given.ways, given.seed, given.processes))
    for line in findings.wrong[:50]:
        print(line)
    print(findings.table())
    sys.exit(bool(findings.wrong))


if __name__ == "__main__":
    main()
