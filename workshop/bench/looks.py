"""What spheres about the links decide: configurations among shelves, boxes and cages, by them and by exact shapes."""

from __future__ import annotations

import os
from time import thread_time

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Mask
from elastic_strips.collision import BodySet, MotionBounds
from elastic_strips.collision.native_side import native_solid, scene_parts
from elastic_strips.errors import ParameterError
from elastic_strips.native import kernel, twin
from elastic_strips.planning.validity import ValidityChecker
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from workshop.reach_problems import load_mbm

from .measure import Figures, Note, head, silent

_MARGIN, _SELF_MARGIN = 0.005, 0.001  # [m]
_OFF_THE_LINE = 0.15  # [rad or m] that configurations scatter about the line from start to goal
_MOST_LEAVES, _FINE = 64, 1e-3  # of the trees of spheres; [m] what sticks out by less is not divided


def bench_looks(
    root: str | os.PathLike[str], robot: str, step: Note = silent, *, stride: int = 4, each: int = 60, seed: int = 0
) -> Figures:
    """Look at configurations near the line from start to goal, and at random ones, of every so many problems.

    Args:
        root: folder with ``mbm``.
        robot: ``"fetch"`` or ``"panda"``.
        step: called after each problem with a note, for a progress bar.
        stride: only every problem of this number.
        each: configurations of either sort in each problem.
        seed: of the configurations.

    Raises:
        ScenarioError, RobotError: the data are missing or faulty.
        ParameterError: there is no native kernel.
    """
    module = kernel()
    if module is None:
        raise ParameterError("looks: spheres are looked at by the native kernel, and there is none")
    model, problems = load_mbm(root, robot)
    rng, bounds = np.random.default_rng(seed), MotionBounds(BodySet.links(model))
    space, counts, wrong = model.space, {}, 0
    seconds, looked = {"spheres": 0.0, "with shapes": 0.0, "shapes alone": 0.0}, [0, 0]
    for problem in problems[::stride]:
        start, goal = (space.to_coordinates(q) for q in problem.ends(model))
        low, high = np.clip(space.lower, -np.pi, np.pi), np.clip(space.upper, -np.pi, np.pi)
        line = start + rng.random((each, 1)) * (goal - start) + _OFF_THE_LINE * rng.normal(size=(each, space.nv))
        line = np.clip(line, space.lower, space.upper)
        for kind, rows in ((problem.kind, line), ("anywhere", low + rng.random((each, space.nv)) * (high - low))):
            verdict, spent = _verdicts(bounds, model, problem.scene, rows)
            clear, exact, others = _clear(bounds, model, problem.scene, rows)
            wrong += int(((verdict == 0) & ~exact).sum() + ((verdict == 1) & exact).sum() + (clear != exact).sum())
            counts.setdefault(kind, np.zeros(3, dtype=int))
            counts[kind] += np.bincount(verdict, minlength=3)[:3]
            looked[0] += int(exact.sum())
            looked[1] += int((~exact).sum())
            for name, value in zip(seconds, (spent, *others), strict=True):
                seconds[name] += value
        step(problem.name)
    total = sum(looked)
    leaves = [_leaves(native_solid(module, piece.geometry)) for piece in model.geometries]
    return {
        **head("looks", robot=robot),
        "instructions": module.instructions,
        "configurations": {"valid": looked[0], "invalid": looked[1]},
        "wrong": wrong,
        "leaves": {"of a link": float(np.mean(leaves)), "of all": int(sum(leaves)), "links": len(leaves)},
        "us_each": {name: 1e6 * value / total for name, value in seconds.items()},
        "shares": {
            kind: dict(zip(("free", "touching", "undecided"), (count / count.sum()).tolist(), strict=True))
            for kind, count in counts.items()
        },
    }


def _leaves(solid: object) -> int:
    module = kernel()
    assert module is not None
    spheres = np.array(module.spheres(solid, _MOST_LEAVES, _FINE))
    return int((spheres[:, 5] == np.arange(len(spheres)) + 1).sum())


def _verdicts(bounds: MotionBounds, model: RobotModel, scene: Scene, rows: Array) -> tuple[npt.NDArray[np.int8], float]:
    """Verdicts (N,) of the spheres alone, 0 free, 1 touching and 2 undecided, and the seconds that they took."""
    module, parts = kernel(), scene_parts(scene)
    assert module is not None
    pairs = np.ascontiguousarray(model.pairs_within(_SELF_MARGIN), dtype=np.intp)
    spheres = module.SphereFilter(bounds.bodies.native(), parts, pairs, _MARGIN, _SELF_MARGIN)
    verdict, began = np.zeros(len(rows), dtype=np.int8), thread_time()
    spheres.look(rows, verdict)
    return verdict, thread_time() - began


def _clear(bounds: MotionBounds, model: RobotModel, scene: Scene, rows: Array) -> tuple[Mask, Mask, list[float]]:
    """Whether each row is valid, by spheres and then shapes, and by shapes alone; and the seconds of both."""
    checkers = [ValidityChecker(model, scene, margin=_MARGIN, self_margin=_SELF_MARGIN, bounds=bounds)]
    with twin():
        checkers.append(ValidityChecker(model, scene, margin=_MARGIN, self_margin=_SELF_MARGIN))
    results, seconds = [], []
    for valid in checkers:
        began = thread_time()
        results.append(valid.each(rows))
        seconds.append(thread_time() - began)
    return results[0], results[1], seconds
