"""The paper's simulation of its preset: each sampling time senses, deforms and moves.

The paper concludes that safe distance, k_r and k_c have to be decided properly; :func:`parameter_map` shows their
effect.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from elastic_strips.arrays import Array, Indices
from elastic_strips.collision import BodySet, ObstacleProximity
from elastic_strips.errors import RobotError
from elastic_strips.planning import straight_line
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.sim.jobs import cached, parallel_map
from elastic_strips.sim.scenarios.registry import get_scenario
from elastic_strips.sim.scenarios.scenario import Scenario
from elastic_strips.strip import Strip
from elastic_strips.strip.paper import PaperDeformer, PaperParams
from elastic_strips.summary import Summary

POSTURE_SPACING = 0.216
"""From posture to posture of the initial line [m]; 59 segments for its 12.7 m."""
LONGEST_STEP = 0.4
"""Largest motion of the robot in a sampling time [m]: about two of these."""
_LONGEST_STAND = 40  # sampling times at one place until it counts as blocked
_MAX_SAMPLES = 400  # sampling times
_LARGEST_CLEARANCE = 1.0  # clearances are not measured beyond [m]
_CONTACT_CHECK_STEP = 0.05  # from one look for contacts to the next, while the robot moves [m]
_K_R = (0.05, 0.1, 0.2, 0.3, 0.5, 0.8)
_K_C = (0.1, 0.3, 0.5, 0.7, 0.9)
_SAFE_DISTANCES = (0.4, 0.6, 0.8, 1.0, 1.5)
"""Gains, and safe distances [m], that are tried; the paper's own are among them."""


class Outcome(str, Enum):
    """``REACHED`` the target; ``BLOCKED``: it stands before a gap between protective hulls; ``CONTACT``: it has touched
    an obstacle; ``UNFINISHED``: after all its sampling times."""

    REACHED = "reached"
    BLOCKED = "blocked"
    CONTACT = "contact"
    UNFINISHED = "unfinished"


@dataclass(frozen=True, slots=True)
class Detection:
    """An obstacle that came within the safe distance.

    Attributes:
        sample: sampling time.
        name: name of the obstacle.
        robot: (x, y) of the mobile then [m].
        point: (x, y, z) of the obstacle's point that is nearest to a control point [m].
        distance: distance between the two [m].
    """

    sample: int
    name: str
    robot: tuple[float, float]
    point: tuple[float, float, float]
    distance: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PaperRun(Summary):
    """Result of a run.

    Attributes:
        scenario, params: what was run.
        robot: the robot.
        line: (N, 2) the original line of the mobile [m].
        coordinates: (T, nv) coordinate rows of the robot at the sampling times.
        ahead: (M, nv) coordinate rows of the strip ahead of it at the end.
        detections: the detected obstacles.
        outcome, reason: outcome of the run, and why.
        clearance: least distance of any link to any obstacle, at and between the sampling times [m]; capped at 1.
    """

    scenario: Scenario
    params: PaperParams
    robot: RobotModel
    line: Array
    coordinates: Array
    ahead: Array
    detections: tuple[Detection, ...]
    outcome: Outcome
    reason: str
    clearance: float

    @property
    def length(self) -> float:
        """Length of the mobile's path [m]."""
        return float(np.hypot(*np.diff(self.coordinates[:, :2], axis=0).T).sum())


def simulate_paper(
    scenario: Scenario, *, robot: RobotModel | None = None, overrides: Mapping[str, object] | None = None
) -> PaperRun:
    """Run a scenario with preset ``paper``, reactively.

    At every sampling time the obstacles within the safe distance of P_m become known, of any control point where the
    whole robot moves. The postures ahead are deformed by all that are known (Eqs. 2 to 9), and the robot moves to the
    next posture, if its protective hulls connect, by `LONGEST_STEP` at most. Contacts are looked for with all links and
    all obstacles, known or not, at the postures and on the straight line between them. Obstacles stand where they are
    at the scenario's time.

    Args:
        scenario: the problem.
        robot: a robot other than the scenario's.
        overrides: further parameters.

    Raises:
        RobotError: the robot's base is fixed.
        ParameterError: a parameter is unknown or outside its range.
    """
    # In one piece: the paper's loop, to be read from top to bottom.
    robot = scenario.load_robot(preset="paper") if robot is None else robot
    if not robot.space.planar:
        raise RobotError(f"the base of {robot.name!r} is fixed; the paper's strip is of a mobile")
    params = PaperParams().replaced(**{**scenario.params.get("paper", {}), **(overrides or {})})
    start, goal = scenario.ends(robot)
    rows = straight_line(robot, start, goal, spacing=POSTURE_SPACING)
    rows[:-1, 2] = rows[0, 2]  # Table 1: the direction of the initial robot
    line = rows[:, :2].copy()
    deformer = PaperDeformer(robot, params)
    sensors = _NearestPoints(robot, deformer.control_points, params.influence)
    links = _NearestPoints(robot, BodySet.links(robot), _LARGEST_CLEARANCE)
    max_nodes = 2 * len(rows)
    strip = Strip.from_coordinates(robot, rows)
    path, moved, arrived = [rows[0].copy()], rows[:1], False
    detections, clearance, standing = list[Detection](), _LARGEST_CLEARANCE, 0
    outcome, reason = Outcome.UNFINISHED, f"not there after {_MAX_SAMPLES} sampling times"
    for sample in range(_MAX_SAMPLES):
        distances = links.nearest(scenario.scene, moved)
        clearance = min([clearance, *(d for d, _ in distances.values())])
        touched = [name for name, (d, _) in distances.items() if d <= 0.0]
        if touched:
            outcome, reason = Outcome.CONTACT, f"touches {', '.join(touched)}"
            break
        if arrived:
            outcome, reason = Outcome.REACHED, f"at the target after {sample} sampling times"
            break
        here = strip.coordinates[0]
        detections += _detected(sensors.nearest(scenario.scene, here[None]), detections, sample, here)
        known = {detection.name for detection in detections}
        report = deformer.step(strip, Scene([o for o in scenario.scene if o.name in known]))
        strip = report.strip
        assert report.hulls is not None
        gaps = np.flatnonzero(~report.hulls.connected)
        if len(gaps) and gaps[0] == 0:
            strip, moved = _bridged(strip, gaps, max_nodes), strip.coordinates[:1]
            standing += 1
            if standing > _LONGEST_STAND:
                apart = max(-float(report.hulls.overlap[0].min()), 0.0)
                outcome = Outcome.BLOCKED
                reason = f"stands at ({here[0]:.2f}, {here[1]:.2f}) m: the next hulls are {apart:.2f} m apart"
                break
            continue
        way = _between(robot, *strip.coordinates[:2])
        most = round(LONGEST_STEP / _CONTACT_CHECK_STEP)  # pushed postures may be far apart; the robot does not jump
        standing, moved = 0, way[:most]
        path.append(moved[-1])
        arrived = len(way) <= most and len(strip.coordinates) == 2
        if not arrived:
            strip = _from_there(strip, moved[-1:], passed=2 if len(way) <= most else 1)
    ahead = strip.coordinates.copy()
    return PaperRun(
        scenario, params, robot, line, np.array(path), ahead, tuple(detections), outcome, reason, float(clearance)
    )


def _detected(
    nearest: Mapping[str, tuple[float, tuple[float, float, float]]],
    before: list[Detection],
    sample: int,
    here: Array,
) -> list[Detection]:
    """The obstacles that were not detected ``before``."""
    known, robot = {detection.name for detection in before}, (float(here[0]), float(here[1]))
    return [
        Detection(sample, name, robot, point, distance)
        for name, (distance, point) in nearest.items()
        if name not in known
    ]


def _from_there(strip: Strip, row: Array, passed: int) -> Strip:
    """The rest of a strip, from a coordinate row (1, nv) on; so many of its postures are behind that."""
    q = strip.robot.space.from_coordinates(row)
    ahead = np.vstack((row, strip.coordinates[passed:]))
    return Strip.from_coordinates(strip.robot, ahead, ends=np.vstack((q, strip.q[-1:])))


def _between(robot: RobotModel, a: Array, b: Array) -> Array:
    """(K, nv) the straight line from one coordinate row to the next, without the first of the two."""
    v = robot.space.difference(a[None], b[None])[0]
    v[:2] = b[:2] - a[:2]  # not the arc of a twist
    count = max(int(np.ceil(max(np.hypot(*v[:2]), 0.5 * np.abs(v[2:]).max()) / _CONTACT_CHECK_STEP)), 1)
    rows = a + np.linspace(0.0, 1.0, count + 1)[1:, None] * v
    rows[-1] = b
    return rows


def _bridged(strip: Strip, gaps: Indices, max_nodes: int) -> Strip:
    """A strip with another posture in the middle of every gap that is longer than usual, up to so many of them."""
    space, coordinates = strip.robot.space, strip.coordinates
    v = space.difference(coordinates[gaps], coordinates[gaps + 1])
    wide = gaps[np.hypot(v[:, 0], v[:, 1]) > 2.0 * POSTURE_SPACING][: max(max_nodes - len(coordinates), 0)]
    if len(wide) == 0:
        return strip
    middle = space.integrate(coordinates[wide], 0.5 * space.difference(coordinates[wide], coordinates[wide + 1]))
    return Strip.from_coordinates(strip.robot, np.insert(coordinates, wide + 1, middle, axis=0), ends=strip.q[[0, -1]])


class _NearestPoints:
    """Workspace: the points of all obstacles, within a reach [m], that are nearest to some bodies of a robot."""

    def __init__(self, robot: RobotModel, bodies: BodySet, reach: float) -> None:
        self._kin = Kinematics(robot.tree, 1)
        self._obstacles = ObstacleProximity(bodies, influence=reach)

    def nearest(self, scene: Scene, coordinates: Array) -> dict[str, tuple[float, tuple[float, float, float]]]:
        """Obstacle → distance to the nearest body [m] and its nearest point [m], over coordinates (K, nv)."""
        self._kin.update(coordinates, jacobians=False)
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


@dataclass(frozen=True, slots=True)
class MapCell:
    """One run.

    Attributes:
        case: name of the scenario.
        k_r, k_c: gains.
        safe: safe distance d_r [m].
        outcome, reason: outcome of the run, and why.
        clearance: least distance to an obstacle [m]; capped at 1.
    """

    case: str
    k_r: float
    k_c: float
    safe: float
    outcome: Outcome
    reason: str
    clearance: float


def parameter_map(
    case: str = "case-4",
    *,
    k_r: Sequence[float] = _K_R,
    k_c: Sequence[float] = _K_C,
    safe: Sequence[float] = _SAFE_DISTANCES,
    processes: int | None = None,
    step: Callable[[str], object] = lambda note: None,
) -> tuple[MapCell, ...]:
    """Run a case with every combination; see :func:`simulate_paper`.

    Args:
        case: name of a scenario.
        k_r, k_c: gains.
        safe: safe distances [m].
        processes: number of processes; one for each core where None.
        step: called after every run with its parameters.

    Returns:
        One cell a combination: by safe distance, then k_r, then k_c.

    Raises:
        ScenarioError: an unknown case.
        ParameterError: a gain or a safe distance is outside its range.
    """
    tasks = [(case, r, c, s) for s in safe for r in k_r for c in k_c]
    found: dict[tuple[float, float, float], MapCell] = {}
    for cell in parallel_map(_cell, tasks, processes):
        found[cell.k_r, cell.k_c, cell.safe] = cell
        step(f"k_r {cell.k_r:g}, k_c {cell.k_c:g}, safe distance {cell.safe:g} m")
    return tuple(found[task[1:]] for task in tasks)


def _cell(task: tuple[str, float, float, float]) -> MapCell:
    case, k_r, k_c, safe = task
    scenario = get_scenario(case)
    robot: RobotModel = cached(f"paper {case}", lambda: scenario.load_robot(preset="paper"))
    run = simulate_paper(scenario, robot=robot, overrides={"k_r": k_r, "k_c": k_c, "influence": safe})
    return MapCell(case, k_r, k_c, safe, run.outcome, run.reason, run.clearance)
