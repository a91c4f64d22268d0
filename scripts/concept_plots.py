"""The plots of docs/concepts.md and docs/tuning.md, computed by the library, and the chart of the front page, whose
numbers are those of docs/benchmarks.md; scripts/figures draws them.

Each function returns a figure of matplotlib (extra ``study``). Lengths are in metres, angles in radians.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import matplotlib

matplotlib.use("svg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import elastic_strips as es
from elastic_strips.collision import BodySet, Certificate, MotionBounds, ObstacleProximity
from elastic_strips.robot import Kinematics
from elastic_strips.sim import simulation
from elastic_strips.sim.scenarios import get_scenario, run_scenario
from elastic_strips.trajectory import Retimer
from workshop.study.figures import Outline, draw_scene

FREE, BROKEN, LINE, ROBOT, LINK = "#1b8a5a", "#b3261e", "#8a8f98", "#3b6ea5", "#d9822b"
plt.rcParams.update({"svg.hashsalt": "elastic_strips", "font.size": 9, "axes.spines.top": False})
plt.rcParams.update({"axes.spines.right": False, "legend.frameon": False, "figure.constrained_layout.use": True})


def from_above(axes: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    """A frame [m] for what ``draw_scene`` draws in millimetres."""
    axes.set(xlim=np.multiply(1e3, x), ylim=np.multiply(1e3, y), aspect="equal", xticks=[], yticks=[])
    for side in axes.spines.values():
        side.set_visible(False)


def draw_strip(axes: Axes, strip: es.Strip, proof: Certificate, *, apart: float = 0.35, width: float = 2.4) -> None:
    """The base's path, green where a segment is certified; the robot's outline and arm, so far [m] apart."""
    place, outline = 1e3 * strip.coordinates[:, :2], Outline(strip.robot)
    travelled, drawn = np.concatenate(([0.0], np.hypot(*np.diff(place, axis=0).T).cumsum())), -np.inf
    for row, way in zip(strip.coordinates, travelled / 1e3, strict=True):
        if way < drawn + apart:
            continue
        drawn = way
        axes.fill(*(1e3 * outline.base(row)).T, facecolor=ROBOT, edgecolor=ROBOT, alpha=0.12, lw=0.7)
        axes.plot(*(1e3 * outline.arm(row)).T, color=LINK, lw=0.9, alpha=0.7)
    for k in range(len(strip) - 1):
        axes.plot(*place[k : k + 2].T, "-", color=FREE if proof.segments[k] else BROKEN, lw=width)
    axes.plot(*place.T, ".", color="k", ms=3)


def strip() -> Figure:
    """A line through an obstacle's influence, and the converged strip."""
    robot = es.load_robot("silvermate")
    scene = es.Scene(
        [es.Box((0.6, 0.6, 1.4), at=(1.5, 0.75, 0.7), name="box"), es.Sphere(0.25, at=(3.0, -0.35, 1.0), name="ball")]
    )
    line = es.Strip(robot, [robot.home(x=x) for x in np.linspace(0.0, 4.5, 24)])
    report = es.Deformer(robot, es.DeformParams(influence=0.35)).settle(line, scene)
    figure, axes = plt.subplots(2, 1, figsize=(7.0, 4.4))
    before = es.Deformer(robot).certify(line, scene)
    for one, what, proof, title in (
        (axes[0], line, before, f"a straight line: {before.broken or 'certified'}"),
        (
            axes[1],
            report.strip,
            report.certificate,
            f"converged after {report.ticks} ticks: {report.clearance:.2f} m of clearance",
        ),
    ):
        draw_scene(one, scene)
        draw_strip(one, what, proof)
        from_above(one, (-0.45, 5.0), (-0.95, 1.15))
        one.set_title(title, fontsize=9, loc="left")
    return figure


def motion_bound() -> Figure:
    """Distance of a link along a segment, and what the motion bound leaves of it from both ends."""
    robot = es.load_robot("silvermate")
    bodies = BodySet.links(robot)
    scene = es.Scene([es.Sphere(0.15, at=(0.85, -0.58, 0.8), name="ball")])
    ends = np.array([robot.space.to_coordinates(robot.home()), robot.space.to_coordinates(robot.home(x=1.0, yaw=0.3))])
    s = np.linspace(0.0, 1.0, 65)
    q = np.array([robot.space.interpolate(ends[:1], ends[1:], np.array([k]))[0] for k in s])
    near, kin = ObstacleProximity(bodies, influence=10.0), Kinematics(robot.tree, len(s))
    kin.update(q)
    near.update(kin, scene)
    distance = near.exact[:, :, 0]
    link = int(np.argmin(distance.min(axis=0)))
    travel = float(MotionBounds(bodies).travel(robot.space.difference(ends[:1], ends[1:]))[0, link])
    figure, axes = plt.subplots(1, 2, figsize=(7.0, 2.7), sharey=True)
    for one, halve in ((axes[0], False), (axes[1], True)):
        pieces, decided, asked = [(0, len(s) - 1)], True, 0
        while pieces:
            first, last = pieces.pop()
            a, b, way = distance[first, link], distance[last, link], travel * (s[last] - s[first])
            free, asked = a + b > way, asked + 1
            one.plot(s[[first, last]], [a, b], "o", color="k", ms=4)
            if halve and not free:
                middle = (first + last) // 2
                pieces += [(first, middle), (middle, last)]
                continue
            here, t = slice(first, last + 1), np.linspace(0.0, 1.0, last - first + 1)
            bound = np.maximum(a - way * t, b - way * (1.0 - t))
            colour, decided = FREE if free else BROKEN, decided and free
            one.fill_between(s[here], bound, distance[here, link], color=colour, alpha=0.15, lw=0)
            one.plot(s[here], bound, color=colour, lw=1.4)
        one.plot(s, distance[:, link], color="k", lw=1.4, label="distance (measured at the dots)")
        one.axhline(0.0, color=LINE, lw=0.8)
        one.set_xlabel("along the segment")
        one.set_title(
            f"halved: free, {asked} pieces asked" if decided else "the whole segment: not decided", fontsize=9
        )
    axes[0].set_ylabel(f"{bodies.names[link]} to the ball [m]")
    axes[1].legend(fontsize=8)
    return figure


def certificate() -> Figure:
    """The same strip, once proved and once refuted."""
    robot = es.load_robot("silvermate")
    line = es.Strip(robot, [robot.home(x=x) for x in np.linspace(0.0, 4.0, 21)])
    figure, axes = plt.subplots(2, 1, figsize=(7.0, 3.9))
    for one, y in zip(axes, (0.55, 0.2), strict=True):
        scene = es.Scene([es.Sphere(0.15, at=(2.0, y, 0.5), name="ball")])
        proof = es.Deformer(robot, es.DeformParams(clearance=0.02)).certify(line, scene)
        draw_scene(one, scene)
        draw_strip(one, line, proof)
        from_above(one, (-0.45, 4.5), (-0.42, 0.75))
        said = f"proved: {proof.segments.sum()} of {len(proof.segments)} segments keep 20 mm"
        one.set_title(f"refuted: {proof.broken}" if proof.broken else said, fontsize=9, loc="left")
    return figure


def braking() -> Figure:
    """Speeds of the motions that were active one after the other: each ends at rest."""
    robot = es.load_robot("silvermate")
    crate = es.Box((0.4, 0.4, 1.0), at=(2.2, 0.75, 0.5), name="crate")
    motions = {}
    driven = simulation(
        robot,
        es.Scene([crate]),
        robot.home(),
        robot.home(x=4.0),
        seed=1,
        watch=lambda it: motions.setdefault(it.controller.executor.active.end_time, it.controller.executor.active),
    )
    record = driven.run().record
    figure, axes = plt.subplots(figsize=(7.0, 2.9))
    for k, motion in enumerate(list(motions.values())[::9]):
        axes.plot(motion.time, motion.v[:, 0], color=LINE, lw=0.8, label=None if k else "a motion that was proven")
        axes.plot(motion.end_time, 0.0, "o", color=FREE, ms=4, label=None if k else "its stop")
    picked = list(motions.values())[len(motions) // 3]
    hard = Retimer(robot).brake(picked, picked.start_time + 0.2)
    axes.plot(hard.time, hard.v[:, 0], color=BROKEN, lw=1.4, label="braked as hard as the motors can")
    axes.plot(record.control.time, record.control.v[:, 0], color="k", lw=1.6, label="driven")
    axes.set(xlabel="time [s]", ylabel="speed of the base [m/s]", ylim=(-0.02, None))
    axes.legend(fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, columnspacing=1.0)
    return figure


def ticks() -> Figure:
    """A strip gives way to somebody who walks across, tick by tick."""
    robot = es.load_robot("silvermate")
    person = es.Cylinder(0.25, 1.7, at=(2.5, -1.7, 0.85), name="person", motion=es.Twist(linear=(0.0, 0.5, 0.0)))
    scene, deformer = es.Scene([person]), es.Deformer(robot)
    strip = es.plan(robot, es.Scene([]), start=robot.home(), goal=robot.home(x=5.0))
    figure, axes = plt.subplots(1, 3, figsize=(7.0, 1.7))
    shown = {120: axes[0], 190: axes[1], 260: axes[2]}
    for tick in range(261):
        report = deformer.step(strip, scene.at(0.02 * tick))
        strip = report.strip
        if tick in shown:
            one = shown[tick]
            draw_scene(one, scene.at(0.02 * tick))
            draw_strip(one, strip, report.certificate, apart=0.5, width=1.6)
            from_above(one, (-0.4, 5.4), (-1.0, 2.1))
            one.set_title(f"tick {tick}, {0.02 * tick:.1f} s", fontsize=9)
    return figure


def tuned(**changes: float) -> dict[str, float]:
    """Medians over ten corridors, converged: what the parameters do."""
    rows = []
    for seed in range(10):
        run = run_scenario(get_scenario("corridor", seed=seed), overrides=changes)
        rows.append(
            (run.report.clearance, run.report.strip.length, run.report.ticks, len(run.report.strip), run.certified)
        )
    clearance, length, settled, nodes, certified = np.array(rows, dtype=float).T
    return {
        "certified": int(certified.sum()),
        "clearance": float(np.median(clearance)),
        "least": float(clearance.min()),
        "length": float(np.median(length)),
        "ticks": float(np.median(settled)),
        "nodes": float(np.median(nodes)),
    }


TUNED: dict[str, tuple[float, ...]] = {
    "influence": (0.1, 0.2, 0.3, 0.5, 0.8),
    "k_r": (0.1, 0.3, 1.0, 3.0, 10.0),
    "k_c": (0.1, 0.3, 1.0, 3.0, 10.0),
}
"""Values that docs/tuning.md compares, of each parameter by itself."""


def tuning() -> Figure:
    """Clearance and length against the parameters, each by itself; prints the table of docs/tuning.md."""
    figure, axes = plt.subplots(1, 3, figsize=(7.0, 2.4), sharey=True)
    print("| changed | certified | clearance, median | least | length | ticks | nodes |\n|---|---|---|---|---|---|---|")
    for one, (name, values) in zip(axes, TUNED.items(), strict=True):
        found = [tuned(**{name: value}) for value in values]
        for value, row in zip(values, found, strict=True):
            print(
                f"| `{name}={value:g}` | {row['certified']} of 10 | {row['clearance']:.2f} m | {row['least']:.2f} m "
                f"| {row['length']:.2f} | {row['ticks']:.0f} | {row['nodes']:.0f} |"
            )
        one.plot(range(len(values)), [row["clearance"] for row in found], "o-", color=FREE, label="median")
        one.plot(range(len(values)), [row["least"] for row in found], "o--", color=LINE, ms=3, label="least of ten")
        one.set_xticks(range(len(values)), [f"{value:g}" for value in values])
        one.set_xlabel(name + (" [m]" if name == "influence" else ""))
    axes[0].set(ylabel="clearance once settled [m]", ylim=(0.0, None))
    axes[0].legend(fontsize=8)
    return figure


BENCHMARKS = Path(__file__).resolve().parent.parent / "docs" / "benchmarks.md"
ON_BOTH = "#757d87"
"""A grey that can be read on white and on black."""
PEERS = {  # in the chart's order: what a row of the benchmarks' table begins with, and what the chart calls it
    "here, certified": "elastic_strips",
    "RoboPlan": "RoboPlan 0.7.0, RRT-Connect",
    "TrajOpt": "TrajOpt (tesseract 0.5.1)",
    "Drake": "Drake 1.51.1, trajectory optimization",
    "OMPL": "OMPL 2.0.1, RRT-Connect",
    "the same, simplified": "OMPL 2.0.1, RRT-Connect, simplified",
    "MPlib": "MPlib 0.2.1",
}


def touched() -> dict[str, list[tuple[str, int, int]]]:
    """By task: planner, how many of its paths touch something, and of how many, as docs/benchmarks.md has them."""
    page = BENCHMARKS.read_text(encoding="utf-8")
    peers = []
    for begins, name in PEERS.items():
        row = re.search(rf"^\| {re.escape(begins)}[^\n]*?\| (\d+) of (\d+) \| [\d.]+ m \|$", page, re.MULTILINE)
        assert row is not None, f"the table of docs/benchmarks.md has no row {begins!r}"
        peers.append((name, int(row[1]), int(row[2])))
    text = " ".join(page.split())
    found = re.search(r"(\d+) of (\d+) of the Panda's paths and (\d+) of (\d+) of the Fetch's touch", text)
    assert found is not None
    reached = []
    for robot, k in (("Panda", 1), ("Fetch", 3)):
        row = re.search(rf"^\| {robot} \| \d+ \| (\d+) \(", page, re.MULTILINE)
        assert row is not None, f"the table of docs/benchmarks.md has no row {robot!r}"
        reached.append((f"elastic_strips, {robot}", 0, int(row[1])))
        reached.append((f"VAMP 0.6.4, {robot}", int(found[k]), int(found[k + 1])))
    return {"TIAGo in cluttered corridors": peers, "Arms reaching into shelves, boxes and cages": reached}


def touching() -> Figure:
    """The share of paths that touch something, by planner."""
    tasks = touched()
    figure, axes = plt.subplots(
        len(tasks), 1, figsize=(7.6, 4.0), sharex=True, height_ratios=[len(rows) for rows in tasks.values()]
    )
    figure.patch.set_alpha(0.0)
    for one, (task, rows) in zip(axes, tasks.items(), strict=True):
        one.patch.set_alpha(0.0)
        for k, (name, touch, count) in enumerate(rows):
            colour = FREE if name.startswith("elastic_strips") else "#d1603d"
            one.barh(k, 100.0 * touch / count, color=colour, height=0.62)
            one.plot(0.0, k, "|", color=colour, ms=11, mew=3)
            one.text(
                100.0 * touch / count + 1.5, k, f"{touch} of {count}", va="center", color=ON_BOTH, fontsize=9.5,
                fontweight="bold" if colour == FREE else "normal",
            )  # fmt: skip
        one.set_yticks(range(len(rows)), [name for name, _, _ in rows], fontsize=9.5)
        one.set_title(task, fontsize=10, loc="left", color=ON_BOTH, fontweight="bold")
        one.set(xlim=(0.0, 100.0), ylim=(len(rows) - 0.4, -0.6))
        one.tick_params(colors=ON_BOTH, length=0)
        for label in one.get_yticklabels():
            label.set_fontweight("bold" if label.get_text().startswith("elastic_strips") else "normal")
        for side in one.spines.values():
            side.set_visible(False)
    axes[-1].set_xticks(range(0, 101, 25), [f"{share} %" for share in range(0, 101, 25)])
    axes[-1].set_xlabel("paths that touch something", color=ON_BOTH)
    return figure


PLOTS: dict[str, Callable[[], Figure]] = {
    "touching": touching,
    "strip": strip,
    "motion-bound": motion_bound,
    "certificate": certificate,
    "braking": braking,
    "ticks": ticks,
    "tuning": tuning,
}
