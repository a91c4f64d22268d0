"""The native kernel against its twin: the same ticks and certificates of random robots in random scenes, by both.

What is plain arithmetic (kinematics, the step's matrix) has to agree to 1e-12. Coal's iterations end where a bound is
met, and a pose that differs in its sixteenth digit may take one more: distances of what is apart agree to 1e-9, and
where the nodes go, pushed at points that a flat contact hardly determines, to 1e-4 a tick. Depths of penetration are
as good as Coal's solver for them: two answers that agree to 1e-4 count, and nobody drives there; where nodes go then
says nothing. What a certificate says has to be the same, but where a distance is within 1e-8 of what is required.

``python tests/oracle/twins.py --ticks 100000`` compares for as long as it takes.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from attack import _obstacle as random_obstacle
from random_robots import random_robot

from elastic_strips.arrays import Array
from elastic_strips.collision import BodySet, BrokenSegment, Certificate, MotionBounds
from elastic_strips.collision.candidates import NodePrediction
from elastic_strips.collision.motion_certificate import MotionCertifier
from elastic_strips.native import kernel, twin
from elastic_strips.robot import ConfigurationSpace, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import Deformer, DeformReport, Strip
from elastic_strips.strip.solver import project_rolling

PLAIN = 1e-12
DISTANCE = 1e-9
DEPTH = 1e-3
MOVED = 1e-4
_UNDECIDED = 1e-8
_BASES = ("diff_drive", "omni", "fixed")
_LOW, _HIGH = np.array([-2.0, -2.0, -0.3]), np.array([2.0, 2.0, 1.5])
_CLEARANCE = 0.02


@dataclass
class Figures:
    """What was compared, the largest differences, and what should have been the same and was not."""

    ticks: int = 0
    apart: int = 0
    motions: int = 0
    largest: dict[str, float] = field(default_factory=dict)
    undecided: int = 0
    different: list[str] = field(default_factory=list)

    def note(self, what: str, difference: float, allowed: float, where: str) -> None:
        self.largest[what] = max(self.largest.get(what, 0.0), difference)
        if not difference <= allowed:
            self.different.append(f"{where}: {what} differs by {difference:.3g}")

    def add(self, other: Figures) -> None:
        self.ticks += other.ticks
        self.apart += other.apart
        self.motions += other.motions
        self.undecided += other.undecided
        self.different += other.different
        for what, difference in other.largest.items():
            self.largest[what] = max(self.largest.get(what, 0.0), difference)


def _difference(a: object, b: object) -> float:
    """Largest absolute difference; infinities of the same sign are equal."""
    one, two = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    if one.shape != two.shape:
        return float("inf")
    apart = np.where(one == two, 0.0, np.abs(one - two))
    return float(np.max(apart, initial=0.0))


def _compare_certificates(figures: Figures, one: Certificate, two: Certificate, where: str) -> bool:
    """Whether both say the same; a distance that is within rounding of the required one may be decided either way."""
    if one.broken is not None and two.broken is not None:
        _compare_worst(figures, one.broken, two.broken, where)
    if np.array_equal(one.states, two.states):
        return True
    worst = [c.broken.clearance for c in (one, two) if c.broken is not None]
    if worst and min(abs(d - _CLEARANCE) for d in worst) < _UNDECIDED:
        figures.undecided += 1
    else:
        figures.different.append(f"{where}: states differ: {one.broken} / {two.broken}")
    return False


def _compare_worst(figures: Figures, one: BrokenSegment, two: BrokenSegment, where: str) -> None:
    deep = min(one.clearance, two.clearance) < 0.0
    what, allowed = ("depth", DEPTH) if deep else ("broken clearance", DISTANCE)
    figures.note(what, _difference(one.clearance, two.clearance), allowed, where)


def _apart(deformer: Deformer, strip: Strip, scene: Scene) -> bool:
    """Whether nothing penetrates at the nodes."""
    deformer.assess(strip, scene)
    work = deformer.workspace
    return min(work.obstacles.exact.min(initial=1.0), work.self_pairs.exact.min(initial=1.0)) > 0.0


def _step(deformer: Deformer, strip: Strip, scene: Scene) -> DeformReport | None:
    """A tick; None where Coal finds no depth."""
    try:
        return deformer.step(strip, scene)
    except FloatingPointError:
        deformer.reset()
        return None


def _endpoints(space: ConfigurationSpace, rng: np.random.Generator, apart: float) -> tuple[Array, Array]:
    """Two random coordinate rows (nv,) within the limits."""
    low, high = np.maximum(space.lower, -3.0), np.minimum(space.upper, 3.0)
    start = np.clip(rng.uniform(-1.5, 1.5, space.nv), low, high)
    return start, np.clip(start + apart * rng.normal(size=space.nv), low, high)


def compare_ticks(figures: Figures, robot: RobotModel, rng: np.random.Generator, ticks: int, where: str) -> None:
    """Ticks of a strip among random obstacles, one of which moves.

    Each has its own strip, which it has known since the tick before: a direction that was measured a little elsewhere
    counts for a while, and who measures anew goes elsewhere by so much. Where shapes penetrated, both go on from the
    same nodes and know nothing of them. Certificates are of the same nodes, by deformers that see those alone.
    """
    space = robot.space
    start, goal = _endpoints(space, rng, 1.0)
    rows = space.interpolate(start[None], goal[None], np.linspace(0.0, 1.0, int(rng.integers(3, 40))))
    scene = Scene([random_obstacle(rng, _LOW, _HIGH) for _ in range(int(rng.integers(1, 12)))])
    if robot.base_kind.value == "diff_drive":
        rows, residual = project_rolling(space, rows)
        with twin():
            figures.note("rolling", _difference(residual, project_rolling(space, rows)[1]), 1e-6, where)
    native, judge = Deformer(robot), Deformer(robot)
    with twin():
        plain, other_judge = Deformer(robot), Deformer(robot)
    strip = mine = Strip.from_coordinates(robot, rows)
    looker, apart_for = Deformer(robot), 0
    for tick in range(ticks):
        here = f"{where}, tick {tick}"
        try:
            apart = _apart(looker, strip, scene)
        except FloatingPointError:
            return
        one = _step(native, strip, scene)
        with twin():
            two = _step(plain, mine, scene)
        if one is None or two is None:
            return
        figures.ticks += 1
        kin, other = native.workspace.kin, plain.workspace.kin
        if kin.n == other.n and np.array_equal(kin.coordinates[: kin.n], other.coordinates[: kin.n]):
            figures.note("placements", _difference(kin.T[:, : kin.n], other.T[:, : kin.n]), PLAIN, here)
            figures.note("Jacobians", _difference(kin.J[: kin.n], other.J[: kin.n]), PLAIN, here)
        try:
            said = judge.certify(one.strip, scene)
            with twin():
                answer = other_judge.certify(one.strip, scene)
        except FloatingPointError:
            return
        _compare_certificates(figures, said, answer, here)
        if apart:
            figures.apart += 1
            apart_for += 1  # what one tick adds, the next ones carry on
            figures.note("nodes", _difference(one.strip.coordinates, two.strip.coordinates), apart_for * MOVED, here)
        strip, mine = one.strip, two.strip
        if not apart or len(strip) != len(mine):
            native.reset()
            plain.reset()
            mine, apart_for = strip, 0
        if tick % 3 == 2:
            name = str(rng.choice(scene.names))
            pose = scene.obstacle(name).pose.copy()
            pose[:3, 3] += 0.05 * rng.normal(size=3)
            scene = scene.moved(name, pose)
        if tick % 4 == 3:  # one goes, another comes
            gone, new = str(rng.choice(scene.names)), random_obstacle(rng, _LOW, _HIGH)
            scene = scene.without(gone).with_obstacle(new.named(f"new{tick}"))


def compare_motions(figures: Figures, robot: RobotModel, rng: np.random.Generator, count: int, where: str) -> None:
    """Certificates of timed motions among obstacles that move meanwhile."""
    space = robot.space
    bodies = BodySet.links(robot)
    bounds = MotionBounds(bodies)
    native = MotionCertifier(bodies, bounds, robot.self_pairs)
    with twin():
        plain = MotionCertifier(bodies, bounds, robot.self_pairs)
    for k in range(count):
        n = int(rng.integers(2, 50))
        start, goal = _endpoints(space, rng, 0.5)
        rows = space.interpolate(start[None], goal[None], np.linspace(0.0, 1.0, n))
        v = space.difference(rows[:-1], rows[1:])
        scene = Scene([random_obstacle(rng, _LOW, _HIGH) for _ in range(int(rng.integers(1, 8)))])
        movers = np.flatnonzero(rng.random(len(scene)) < 0.4)
        times = np.linspace(0.0, 2.0, n)[:, None]
        prediction = NodePrediction(
            movers,
            rng.normal(size=(1, len(movers), 3)) * times[:, :, None],
            rng.uniform(0.0, 0.1, len(movers)) + 0.1 * np.repeat(times, len(movers), axis=1),
            np.zeros(n, dtype=bool),
        )
        given = {"clearance": _CLEARANCE, "self_clearance": 0.005}
        try:
            one = native.certify(rows, v, scene, prediction, **given)
            with twin():
                two = plain.certify(rows, v, scene, prediction, **given)
        except FloatingPointError:
            native.reset()
            plain.reset()
            continue
        figures.motions += 1
        if one.certified != two.certified:
            worst = [c.broken.clearance for c in (one, two) if c.broken is not None]
            if abs(worst[0] - _CLEARANCE) < _UNDECIDED:
                figures.undecided += 1
            else:
                figures.different.append(f"{where}, motion {k}: {one.broken} / {two.broken}")
        elif one.broken is not None and two.broken is not None:
            _compare_worst(figures, one.broken, two.broken, f"{where}, motion {k}")


def run(seed: int, *, strips: int = 3, ticks: int = 6, motions: int = 5) -> Figures:
    """Compare on one random robot of 3 to 16 degrees of freedom."""
    assert kernel() is not None, "there is no native kernel here"
    rng, figures = np.random.default_rng(seed), Figures()
    base, nv = _BASES[seed % 3], 3 + (seed // 3) % 14
    with tempfile.TemporaryDirectory() as folder:
        joints, followers = nv - (0 if base == "fixed" else 3), seed % 2 == 1
        robot = random_robot(rng, Path(folder), joints, base, followers=followers)
    for k in range(strips):
        compare_ticks(figures, robot, rng, ticks, f"seed {seed}, strip {k}")
    compare_motions(figures, robot, rng, motions, f"seed {seed}")
    return figures


def run_all(seeds: Sequence[int], ticks: int, processes: int) -> Figures:
    """Compare on robots of these seeds until so many ticks and motions were compared."""
    total = Figures()
    quiet = {"initializer": logging.disable, "initargs": (logging.WARNING,)}  # in the workers alone
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn"), **quiet) as pool:
        for k, part in enumerate(pool.map(run, seeds, chunksize=4)):
            total.add(part)
            if (k + 1) % 200 == 0:
                print(f"{total.ticks} ticks, {total.motions} motions", file=sys.stderr, flush=True)
            if total.ticks + total.motions >= ticks:
                pool.shutdown(cancel_futures=True)
                break
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--ticks", type=int, default=2000, help="ticks and motions to compare")
    parser.add_argument("--seed", type=int, default=0, help="of the first robot")
    parser.add_argument("--processes", type=int, default=min(2, os.cpu_count() or 1))
    given = parser.parse_args()
    figures = run_all(range(given.seed, given.seed + max(1, given.ticks)), given.ticks, given.processes)
    for line in figures.different[:50]:
        print(line)
    print(f"{figures.ticks} ticks ({figures.apart} without penetration), {figures.motions} motions")
    print(f"{len(figures.different)} different")
    print(f"{figures.undecided} decided either way, within {_UNDECIDED:g} m of what is required")
    for what, difference in sorted(figures.largest.items()):
        print(f"  {what:20} {difference:.3g}")
    sys.exit(bool(figures.different))


if __name__ == "__main__":
    main()
