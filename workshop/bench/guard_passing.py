"""What a guard passes on: far from everything, along walls, through doors; measured from the true states."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.control import Desired, DriveParams, GuardOutcome, GuardParams
from elastic_strips.control.guard_proposal import Proposer
from elastic_strips.control.params import ObstacleAssumptions
from elastic_strips.control.prediction import Outlook
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Scene
from elastic_strips.trajectory import MotionLimits, ReferenceState

from .guard import BASES, limits_of, load, simulated
from .measure import Figures, Note, head, silent
from .pilots import Seen, drive_towards, wanderer

_WALL_GAP, _WALL_RUN = 1.5, 8.0  # [m], [s] of a run along a wall
_ROOMY = 0.08  # [m] between links that are far from each other
_FREE_RUN = 20.0  # [s]
_DOOR_END = 4.0  # [m] where somebody is through the door
WALL_ANGLES = (20.0, 40.0, 60.0)


def bench_passing(
    robots: Sequence[str], seeds: Sequence[int] = (0,), step: Note = silent, *, bases: Sequence[str] = BASES
) -> Figures:
    """What passes where nothing is near, along walls, and through doors, beside what is asked for.

    Args:
        robots: names or URDF files.
        seeds: of the machine and what is sensed; shares and speeds are means over them, doors of the first one.
        step: called after each run.
        bases: as for :func:`~workshop.bench.guard.bench_guard`.
    """
    rows = []
    for name in robots:
        for base in bases:
            robot = load(name, base)
            limits = limits_of(robot)
            row: Figures = {"robot": name, "base": base or robot.base_kind.value}
            step(f"{name} {base}: nothing near")
            row |= _free(robot, limits, seeds)
            for angle in WALL_ANGLES:
                step(f"{name} {base}: a wall at {angle:g}°")
                row[f"wall_{angle:g}"] = _along_wall(robot, angle, seeds)
            for width in (1.0, 1.3):
                step(f"{name} {base}: a door of {width:g} m")
                row[f"door_{width:g}"] = {
                    m: _through_door(robot, width, m, seeds[0]) for m in ("guard", "none", "scaling")
                }
            rows.append(row)
    return {**head("passing", robots=list(robots)), "rows": rows}


def _roomy(robot: RobotModel, limits: MotionLimits) -> Array:
    """A configuration (nq,) whose arm is far from its stops and from the robot's own links."""
    rng, base = np.random.default_rng(5), robot.space.base_nv
    look = Proposer(robot, limits, self_clearance=0.005, part=0.8, reach=0.1, self_reach=_ROOMY)
    row = robot.space.to_coordinates(robot.home_q)
    low, high = np.maximum(robot.space.lower[base:], -3.0), np.minimum(robot.space.upper[base:], 3.0)
    margins = DriveParams().margins
    nothing = Outlook.of(Scene([]), ObstacleAssumptions(), margins)
    best, most = row, -1.0
    for _ in range(2000):
        posture = row.copy()
        posture[base:] = low + (high - low) * rng.uniform(0.3, 0.7, len(low))
        state = ReferenceState(0.0, posture, np.zeros(robot.nv), np.zeros(robot.nv))
        room = float(look.look(state, nothing, settle=0.0, clearance=margins.clearance).distance.min(initial=_ROOMY))
        if room > most:
            best, most = posture, room
        if most >= _ROOMY:
            break
    return robot.space.from_coordinates(best)


def _free(robot: RobotModel, limits: MotionLimits, seeds: Sequence[int]) -> Figures:
    """Shares of base and whole commands that pass in a wide hall, the arm in the air or at home, moving to and fro."""
    out = {}
    scene = Scene([Box((0.2, 40.0, 2.0), at=(30.0, 0.0, 1.0), name="wall")])
    base = robot.space.base_nv
    for what, start in (("base", robot.home_q), ("whole", _roomy(robot, limits)), ("whole_at_home", robot.home_q)):
        if what == "base" and not base:
            continue
        at = robot.space.to_coordinates(start)[base:]
        shares, passed, causes = [], [], Counter[str]()
        for seed in seeds:
            pilot = _Worker(robot, limits, at if what != "base" else None)
            piloted, _, figures = simulated(robot, scene, start, pilot, "guard", seed=seed, time=_FREE_RUN)
            answers = [a for a, t in zip(piloted.answers, piloted.times, strict=True) if t < _FREE_RUN]
            shares.append(figures["share"])
            passed += [a.outcome is GuardOutcome.PASSED for a in answers]
            causes.update(f"{a.link} – {a.obstacle}" if a.link else a.reason for a in answers if a.reason)
        out[f"free_{what}"] = {
            "share": float(np.mean(shares)),
            "least_share": min(shares),
            "passed": float(np.mean(passed)),
            "causes": causes.most_common(3),
        }
    return out


class _Worker:
    """Workspace: drives about smoothly, and moves its arm to and fro about a posture (n,), or not at all."""

    def __init__(self, robot: RobotModel, limits: MotionLimits, posture: Array | None) -> None:
        rng = np.random.default_rng(3)
        count = len(limits.joint_speed)
        self._rate, self._phase = rng.uniform(0.5, 1.5, count), rng.uniform(0.0, 6.0, count)
        self._wander = wanderer(robot, limits, np.random.default_rng(1))
        self._posture, self._top, self._base = posture, 0.9 * limits.joint_speed, robot.space.base_nv
        self._size = np.where(robot.tree.sliding, 0.02, 0.25)

    def __call__(self, seen: Seen) -> Desired:
        wander = self._wander(seen)
        assert wander is not None
        twist, joints = wander.twist if self._base else None, None
        if self._posture is not None:
            aim = self._posture + self._size * np.sin(self._rate * seen.time + self._phase) * min(seen.time, 1.0)
            joints = np.clip(2.0 * (aim - seen.coordinates[self._base :]), -self._top, self._top)
        return Desired(twist=twist, joints=joints)


def _along_wall(robot: RobotModel, angle: float, seeds: Sequence[int]) -> Figures:
    """Speed along a wall that is driven at askew, as a part of what is commanded along it: from rest on, and in the
    second half; for a base that slides also as a part of what it drives from rest on where no wall is."""
    a, omni = math.radians(angle), robot.base_kind.value == "omni"
    start = robot.home(yaw=0.0 if omni else 0.5 * math.pi - a)
    twist = np.array([math.sin(a), math.cos(a), 0.0]) if omni else np.array([1.0, 0.0, 0.0])
    wall = Box((0.2, 60.0, 1.5), at=(_WALL_GAP + 0.1, 10.0, 0.75), name="wall")
    far = Box((0.2, 60.0, 1.5), at=(60.0, 10.0, 0.75), name="wall")
    runs: list[tuple[float, float]] = []
    free: list[tuple[float, float]] = []
    contacts = stops = 0
    for seed in seeds:
        for thing, out in ((wall, runs), (far, free))[: 2 if omni else 1]:
            _, driven, figures = simulated(
                robot, Scene([thing]), start, lambda _: Desired(twist=twist), "guard", seed=seed, time=_WALL_RUN
            )
            contacts, stops = contacts + figures["contacts_at_speed"], stops + figures["outcomes"]["braking"]
            rows = driven.recorder.finish().control
            at = rows.time <= _WALL_RUN
            y, t = rows.coordinates[at, 1], rows.time[at]
            top = GuardParams().speed * float(driven.limits.drive_speed[0])
            top /= max(top, *np.abs(twist[:2])) if omni else 1.0  # of what is commanded
            late, along = t >= 0.5 * _WALL_RUN, float(top * twist[1]) if omni else top
            whole = float((y[-1] - y[0]) / (t[-1] - t[0]))
            out.append((whole / along, float((y[late][-1] - y[late][0]) / (t[late][-1] - t[late][0])) / along))
    whole, settled = np.mean(runs, axis=0).tolist()
    return {
        "whole": whole,
        "settled": settled,
        "least_settled": min(run[1] for run in runs),
        "of_free": whole / float(np.mean(free, axis=0)[0]) if omni else None,
        "contacts": contacts,
        "braking": stops,
    }


def _through_door(robot: RobotModel, width: float, method: str, seed: int) -> Figures:
    """Time [s] of somebody who drives through a door to a place 4 m ahead."""
    posts = [
        Box((0.2, 4.0, 2.0), at=(2.0, side * (2.0 + 0.5 * width), 1.0), name=f"post {side:+.0f}") for side in (-1, 1)
    ]
    limits = limits_of(robot)

    def pilot(seen: Seen) -> Desired | None:
        x, y, yaw = seen.coordinates[:3]
        if x > _DOOR_END:
            return None
        if limits.drive_dim == 3:
            return Desired(twist=np.array([1.0, -y, -yaw]))
        return Desired(twist=drive_towards(robot, limits, seen.coordinates, np.array([max(x + 0.8, 1.0), 0.0])))

    start = robot.home(y=0.3)
    _, driven, figures = simulated(
        robot, Scene(posts), start, pilot, method, seed=seed, time=25.0, until=lambda at: bool(at[0] > _DOOR_END)
    )
    rows = driven.recorder.finish().control
    there = np.flatnonzero(rows.coordinates[:, 0] > _DOOR_END)
    return {
        "time_s": float(rows.time[there[0]]) if len(there) else None,
        "contacts": figures["contacts_at_speed"],
        "share": figures["share"],
    }
