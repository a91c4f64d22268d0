"""Study room, reactive: the paper's preset as the paper simulates it: each sampling time senses, deforms, moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from elastic_strips.arrays import Array, Indices

from ..deform import Deformer, DeformParams
from ..deform.paper_step import PaperStep
from ..errors import RobotError
from ..planning import straight_line
from ..proximity import BodySet, ObstacleProximity
from ..robot import Kinematics, RobotModel
from ..scene import Scene
from ..sim.scenarios.scenario import Scenario
from ..strip import Strip
from ..summary import Summary

SPACING = 0.216
"""From posture to posture of the initial line [m]; 59 segments for its 12.7 m."""
LONGEST_STEP = 0.4
"""Most that the robot moves in a sampling time [m]: about two of these."""
_PATIENCE = 40  # sampling times at one place until it counts as blocked
_MOST = 400  # sampling times
_CAP = 1.0  # clearances are not measured beyond [m]
_BETWEEN = 0.05  # from one look for contacts to the next, while the robot moves [m]


class Outcome(str, Enum):
    """``REACHED`` the target; ``BLOCKED``: it stands before a gap of the tunnel; ``CONTACT``: it has touched an
    obstacle; ``UNFINISHED``: after all its sampling times."""

    REACHED = "reached"
    BLOCKED = "blocked"
    CONTACT = "contact"
    UNFINISHED = "unfinished"


@dataclass(frozen=True, slots=True)
class Sighting:
    """An obstacle that came within the safe distance.

    Attributes:
        sample: sampling time.
        name: of the obstacle.
        robot: (x, y) of the mobile then [m].
        point: (x, y, z) of the obstacle's point that is nearest to a control point [m].
        distance: between the two [m].
    """

    sample: int
    name: str
    robot: tuple[float, float]
    point: tuple[float, float, float]
    distance: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ReactiveRun(Summary):
    """What came of a run.

    Attributes:
        scenario, params: what was run.
        robot: the robot.
        line: (N, 2) the original line of the mobile [m].
        chart: (T, nv) where the robot was at each sampling time.
        ahead: the strip in front of it at the end, chart rows (M, nv).
        seen: obstacles as they were sensed.
        outcome, reason: how it ended.
        clearance: least distance of any link to any obstacle, at and between the sampling times [m]; capped at 1.
    """

    scenario: Scenario
    params: DeformParams
    robot: RobotModel
    line: Array
    chart: Array
    ahead: Array
    seen: tuple[Sighting, ...]
    outcome: Outcome
    reason: str
    clearance: float

    @property
    def length(self) -> float:
        """Way of the mobile [m]."""
        return float(np.hypot(*np.diff(self.chart[:, :2], axis=0).T).sum())


def paper_reactively(
    scenario: Scenario, *, robot: RobotModel | None = None, overrides: Mapping[str, Any] | None = None
) -> ReactiveRun:
    """Run a scenario with preset ``paper``, reactively.

    At every sampling time the obstacles within the safe distance of P_m become known, of any control point where the
    whole robot moves. The postures ahead are deformed by all that are known (Eqs. 2 to 9), and the robot moves to the
    next posture, if the tunnel leads there, by `LONGEST_STEP` at most. Contacts are looked for with all links and all
    obstacles, known or not, at the postures and on the straight way between them. Obstacles stand where they are at the
    scenario's time.

    Args:
        scenario: the problem.
        robot: another robot than the scenario's.
        overrides: further parameters.

    Raises:
        RobotError: the robot's base is fixed.
        ParameterError: a parameter is unknown or outside its range.
    """
    robot = scenario.load_robot(preset="paper") if robot is None else robot
    if not robot.space.planar:
        raise RobotError(f"the base of {robot.name!r} is fixed; the paper's strip is of a mobile")
    params = DeformParams.for_preset("paper", **{**scenario.params.get("paper", {}), **(overrides or {})})
    start, goal = scenario.ends(robot)
    rows = straight_line(robot, start, goal, spacing=SPACING)
    rows[:-1, 2] = rows[0, 2]  # Table 1: the direction of the initial robot
    line = rows[:, :2].copy()
    deformer, points = Deformer(robot, params), PaperStep(robot, params).bodies
    eyes, skin = _Nearest(robot, points, params.influence), _Nearest(robot, BodySet.links(robot), _CAP)
    most = 2 * len(rows)
    strip, known = Strip.from_chart(robot, rows), set[str]()
    way, moved, there = [rows[0].copy()], rows[:1], False
    seen, clearance, stood = list[Sighting](), _CAP, 0
    outcome, reason = Outcome.UNFINISHED, f"not there after {_MOST} sampling times"
    for sample in range(_MOST):
        links = skin.look(scenario.scene, moved)
        clearance = min([clearance, *(d for d, _ in links.values())])
        touched = [name for name, (d, _) in links.items() if d <= 0.0]
        if touched:
            outcome, reason = Outcome.CONTACT, f"touches {', '.join(touched)}"
            break
        if there:
            outcome, reason = Outcome.REACHED, f"at the target after {sample} sampling times"
            break
        here = strip.chart[0]
        for name, (distance, point) in eyes.look(scenario.scene, here[None]).items():
            if name not in known:
                known.add(name)
                seen.append(Sighting(sample, name, (float(here[0]), float(here[1])), point, distance))
        report = deformer.step(strip, Scene([o for o in scenario.scene if o.name in known]))
        strip = report.strip
        assert report.tunnel is not None
        gaps = np.flatnonzero(~report.tunnel.connected)
        if len(gaps) and gaps[0] == 0:
            strip, moved = _bridged(strip, gaps, most), strip.chart[:1]
            stood += 1
            if stood > _PATIENCE:
                apart = max(-float(report.tunnel.overlap[0].min()), 0.0)
                outcome = Outcome.BLOCKED
                reason = f"stands at ({here[0]:.2f}, {here[1]:.2f}) m: the next hulls are {apart:.2f} m apart"
                break
            continue
        stood, moved = 0, _between(robot, *strip.chart[:2])
        part = moved[: round(LONGEST_STEP / _BETWEEN)]  # postures part where they are pushed; the robot does not jump
        whole, moved = len(part) == len(moved), part
        way.append(moved[-1])
        there = whole and len(strip.chart) == 2
        if not there:
            ahead = np.vstack((moved[-1:], strip.chart[2 if whole else 1 :]))
            strip = Strip.from_chart(robot, ahead, ends=np.vstack((robot.space.from_chart(moved[-1:]), strip.q[-1:])))
    return ReactiveRun(
        scenario, params, robot, line, np.array(way), strip.chart.copy(), tuple(seen), outcome, reason, float(clearance)
    )


def _between(robot: RobotModel, a: Array, b: Array) -> Array:
    """(K, nv) the straight way from one chart row to the next, without the first of the two."""
    v = robot.space.difference(a[None], b[None])[0]
    v[:2] = b[:2] - a[:2]  # not the arc of a twist
    count = max(int(np.ceil(max(np.hypot(*v[:2]), 0.5 * np.abs(v[2:]).max()) / _BETWEEN)), 1)
    rows = a + np.linspace(0.0, 1.0, count + 1)[1:, None] * v
    rows[-1] = b
    return rows


def _bridged(strip: Strip, gaps: Indices, most: int) -> Strip:
    """A strip with another posture in the middle of every gap that is longer than usual, up to so many of them."""
    space, chart = strip.robot.space, strip.chart
    v = space.difference(chart[gaps], chart[gaps + 1])
    wide = gaps[np.hypot(v[:, 0], v[:, 1]) > 2.0 * SPACING][: max(most - len(chart), 0)]
    if len(wide) == 0:
        return strip
    middle = space.integrate(chart[wide], 0.5 * space.difference(chart[wide], chart[wide + 1]))
    return Strip.from_chart(strip.robot, np.insert(chart, wide + 1, middle, axis=0), ends=strip.q[[0, -1]])


class _Nearest:
    """Workspace: the points of all obstacles that are nearest to some bodies of a robot.

    Args:
        robot: the robot.
        bodies: its links, or its control points.
        reach: what is farther away than this [m] is not seen.
    """

    def __init__(self, robot: RobotModel, bodies: BodySet, reach: float) -> None:
        self._kin = Kinematics(robot.tree, 1)
        self._obstacles = ObstacleProximity(bodies, influence=reach)

    def look(self, scene: Scene, chart: Array) -> dict[str, tuple[float, tuple[float, float, float]]]:
        """Obstacle → distance to the nearest body [m] and the obstacle's nearest point [m], over chart rows (K, nv)."""
        self._kin.update(chart, jacobians=False)
        self._obstacles.update(self._kin, scene)
        contacts = self._obstacles.contacts()
        found: dict[str, tuple[float, tuple[float, float, float]]] = {}
        for k in np.argsort(contacts.distance).tolist():
            name = self._obstacles.obstacle_name(int(contacts.part[k]))
            if name not in found:
                d = float(contacts.distance[k])
                x, y, z = (contacts.witness[k] - d * contacts.direction[k]).tolist()
                found[name] = (d, (x, y, z))
        return found
