"""Study room, reactive: the paper's preset as the paper simulates it: each sampling time senses, deforms, moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from ..deform import Deformer, DeformParams
from ..planning import straight_line
from ..proximity import BodySet, ObstacleProximity
from ..robot import Kinematics, RobotModel
from ..robot.space import Array, Indices
from ..scenarios.scenario import Scenario
from ..scene import Scene
from ..strip import Strip

SPACING = 0.216
"""From posture to posture of the initial line [m]; 59 segments for its 12.7 m."""
_PATIENCE = 40  # sampling times at one place until it counts as blocked
_MOST = 400  # sampling times


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
        point: (x, y, z) of the obstacle's nearest point [m].
    """

    sample: int
    name: str
    robot: tuple[float, float]
    point: tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class ReactiveRun:
    """What came of a run.

    Attributes:
        scenario, params: what was run.
        robot: the robot.
        line: (N, 2) the original line of the mobile [m].
        chart: (T, nv) where the robot was at each sampling time.
        ahead: the strip in front of it at the end, chart rows (M, nv).
        seen: obstacles as they were sensed.
        outcome, reason: how it ended.
        clearance: least distance of any link to any obstacle, at the sampling times [m]; capped at 1.
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

    At every sampling time the obstacles within the safe distance of the robot become known, the postures ahead are
    deformed by all that are known (Eqs. 2 to 9), and the robot moves to the next posture, if the tunnel leads there.
    Contacts are looked for with all obstacles, known or not.

    Args:
        scenario: the problem.
        robot: another robot than the scenario's.
        overrides: further parameters.
    """
    robot = scenario.load_robot(preset="paper") if robot is None else robot
    params = DeformParams.for_preset("paper", **{**scenario.params.get("paper", {}), **(overrides or {})})
    start, goal = scenario.ends(robot)
    rows = straight_line(robot, start, goal, spacing=SPACING)
    if robot.space.planar:
        rows[:-1, 2] = rows[0, 2]  # Table 1: the direction of the initial robot
    line = rows[:, :2].copy()
    deformer, eyes = Deformer(robot, params), _Eyes(robot, max(params.influence, 1.0))
    most = 2 * len(rows)
    strip, known = Strip.from_chart(robot, rows), set[str]()
    way, seen, clearance, stood = [rows[0].copy()], list[Sighting](), np.inf, 0
    outcome, reason = Outcome.UNFINISHED, f"not there after {_MOST} sampling times"
    for sample in range(_MOST):
        here = strip.chart[0]
        near = eyes.look(scenario.scene, here)
        clearance = min(clearance, min((d for d, _ in near.values()), default=1.0))
        for name, (distance, point) in near.items():
            if distance <= 0.0:
                outcome, reason = Outcome.CONTACT, f"touches {name}"
            if name not in known and distance < params.influence:
                known.add(name)
                seen.append(Sighting(sample, name, (float(here[0]), float(here[1])), point))
        if outcome is Outcome.CONTACT:
            break
        if len(strip.chart) == 1 or (len(strip.chart) == 2 and stood >= _PATIENCE):
            break
        report = deformer.step(strip, Scene([o for o in scenario.scene if o.name in known]))
        strip = report.strip
        assert report.tunnel is not None
        gaps = np.flatnonzero(~report.tunnel.connected)
        if len(gaps) and gaps[0] == 0:
            strip = _bridged(strip, gaps, most)
            stood += 1
            if stood > _PATIENCE:
                overlap = float(report.tunnel.overlap[0].min())
                outcome = Outcome.BLOCKED
                reason = f"stands at ({here[0]:.2f}, {here[1]:.2f}) m: the next hulls are {-overlap:.2f} m apart"
                break
            continue
        stood = 0
        if len(strip.chart) == 2:
            way.append(strip.chart[1].copy())
            strip_end = eyes.look(scenario.scene, way[-1])
            clearance = min(clearance, min((d for d, _ in strip_end.values()), default=1.0))
            outcome, reason = Outcome.REACHED, f"at the target after {sample + 1} sampling times"
            break
        strip = Strip.from_chart(robot, strip.chart[1:], ends=strip.q[[1, -1]])
        way.append(strip.chart[0].copy())
    return ReactiveRun(
        scenario, params, robot, line, np.array(way), strip.chart.copy(), tuple(seen), outcome, reason,
        float(min(clearance, 1.0)),
    )  # fmt: skip


def _bridged(strip: Strip, gaps: Indices, most: int) -> Strip:
    """A strip with another posture in the middle of every gap that is longer than usual, up to so many of them."""
    space, chart = strip.robot.space, strip.chart
    v = space.difference(chart[gaps], chart[gaps + 1])
    wide = gaps[np.hypot(v[:, 0], v[:, 1]) > 2.0 * SPACING][: max(most - len(chart), 0)]
    if len(wide) == 0:
        return strip
    middle = space.integrate(chart[wide], 0.5 * space.difference(chart[wide], chart[wide + 1]))
    return Strip.from_chart(strip.robot, np.insert(chart, wide + 1, middle, axis=0), ends=strip.q[[0, -1]])


class _Eyes:
    """Workspace: nearest points of all obstacles as seen from a robot's links."""

    def __init__(self, robot: RobotModel, reach: float) -> None:
        self._kin = Kinematics(robot.tree, 1)
        self._obstacles = ObstacleProximity(BodySet.links(robot), influence=reach)

    def look(self, scene: Scene, chart: Array) -> dict[str, tuple[float, tuple[float, float, float]]]:
        """Obstacle → distance to the nearest link [m] and the nearest point of the obstacle, of those within reach."""
        self._kin.update(chart[None], jacobians=False)
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
