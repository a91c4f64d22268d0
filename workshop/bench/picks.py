"""Picks: a can on furniture is driven to, reached, taken hold of and lifted, from a start elsewhere."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, pi, sin

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.control.interfaces import RunState
from elastic_strips.control.params import DriveParams
from elastic_strips.errors import GoalError, ParameterError, ScenarioError, nearest_name
from elastic_strips.planning import HandPose, plan_approach
from elastic_strips.planning.approach import ApproachReport
from elastic_strips.planning.grid_path import grid_path
from elastic_strips.robot import PlanarFootprint, RobotModel
from elastic_strips.scene import Box, Cylinder, Scene, World
from elastic_strips.sim import PlantParams, drive_plan
from elastic_strips.sim.evaluation import evaluate
from elastic_strips.work import seconds_counted
from workshop.datasets import house_scene, load_house

from .measure import Figures, percentiles

FOAM, STANDING, DRIVEN = "foam", "standing", "driven"
"""The can is on foam, of which there is nothing in the scene; or it stands on the surface itself; or it is on foam, and
all is planned with what drives keep, and driven."""
_RADIUS, _HEIGHT = 0.03, 0.12  # of the can [m]
_FOAM = 0.015  # [m] thickness
_RAISED = 0.03  # [m] the can is held so far above its middle: as far below its top as its side is from its axis
_LIFT = (0.0, 0.0, 0.08)  # [m]
_APPROACH = 0.15  # [m]
_DEPTH = 0.002  # [m] that what stands may be in contact
_YAWS = 12
_TILTS = (0.0, pi / 6, pi / 3, pi / 2)  # [rad] of the hand: level, and down to straight from above
_FURNITURE = (
    "BalconyTable", "Bed", "Chair", "CoffeeTable", "CookingBench", "KitchenCabinet", "KitchenTable", "NightStand",
    "ReadingDesk", "ShoeRack", "Sofa", "TVCabinet", "Wardrobe",
)  # fmt: skip
"""Of the house, what people put things on: how the names begin."""
_LOW, _HIGH = 0.3, 1.2  # [m] heights of surfaces
_EDGE = 0.25  # [m] from the can to the edge of what it stands on, at most
_ABOVE = 0.15  # [m] of free space above the can
_AROUND = 0.01  # [m] of free space around it
_FREE_GROUND = 0.02  # [m] about the base, before the edge
_NEAR = 0.35  # [m] that free ground may be from the edge, at most
_HEAD = 1.2  # [m] height up to which the ground before the edge is free
_POST = 0.01  # [m] radius of what is put down beside the furniture to find its edge
_DIRECTIONS = 16
_TRIES = 3000


@dataclass(frozen=True, slots=True)
class _Hand:
    """How a hand holds a can.

    Attributes:
        frame: its frame, whose x axis leads to what is held.
        front: how far before the frame it ends, and a little more [m].
        aside: (2,) where its middle is along y and z [m].
        rolls: turns about x with which it holds an upright can [rad].
    """

    frame: str
    front: float
    aside: tuple[float, float]
    rolls: tuple[float, ...]


_HANDS = {
    "tiago": _Hand("arm_tool_link", 0.26, (0.02, 0.015), (0.5 * pi, -0.5 * pi)),
    "silvermate": _Hand("hand_frame", 0.075, (0.0, 0.0), (0.0, 0.5 * pi, pi, -0.5 * pi)),
    "fetch": _Hand("gripper_link", 0.08, (0.0, 0.0), (0.0, pi)),
}


@dataclass(frozen=True, slots=True)
class Pick:
    """A can to be picked up.

    Attributes:
        scene: what stands about it, without the can.
        can: the can.
        start: configuration (nq,) of the robot.
        on: name of what it is on.
    """

    scene: Scene
    can: Cylinder
    start: Array
    on: str

    @property
    def surface(self) -> float:
        """Height [m] of the can's bottom."""
        return float(self.can.pose[2, 3]) - 0.5 * _HEIGHT


def table_pick(robot: RobotModel, seed: int, *, gap: float = _FOAM) -> Pick:
    """A can on a table of 0.45 to 1.15 m in an open room, ``gap`` [m] above it."""
    rng = np.random.default_rng((seed, 17))
    height, depth = float(rng.uniform(0.45, 1.15)), float(rng.uniform(0.4, 0.8))
    x, y, turn = float(rng.uniform(2.5, 4.0)), float(rng.uniform(-1.0, 1.0)), float(rng.uniform(-0.6, 0.6))
    table = Box((depth, 1.2, height), at=(x, y, 0.5 * height), quat=_about_z(turn), name="table")
    from_edge = float(rng.uniform(0.05, _EDGE))
    at = table.pose @ (from_edge - 0.5 * depth, float(rng.uniform(-0.5, 0.5)), 0.0, 1.0)
    return Pick(Scene([table]), _can(at[0], at[1], height + gap), robot.home(), "table")


def house_pick(root: str | os.PathLike[str], robot: RobotModel, seed: int, *, gap: float = _FOAM) -> Pick:
    """A can on furniture of the house, ``gap`` [m] above it, at most 0.25 m from an edge beside which the ground is
    free for the base and can be driven to from the start.

    Raises:
        ScenarioError: the data are missing or faulty, or no such place is found.
        RobotError: a fixed base.
    """
    begin = load_house(root, robot, seed).start
    start = robot.home(begin.x, begin.y, begin.yaw)
    scene, inside = house_scene(root)
    probe, faces = _Probe(scene), _faces(scene)
    names = sorted(faces)
    rng = np.random.default_rng((seed, 29))
    radius = PlanarFootprint.of(robot, start).inner + _FREE_GROUND
    for _ in range(_TRIES):
        name = names[int(rng.integers(len(names)))]
        face = faces[name][int(rng.integers(len(faces[name])))]
        x, y = rng.uniform(face.min(axis=0), face.max(axis=0))[:2].tolist()
        z = float(face[:, 2].max())
        if not _supported(face[:, :2], (x, y)):
            continue
        column = _HEIGHT + _ABOVE
        if probe.touches(_RADIUS + _AROUND, column - 0.002, (x, y, z + 0.002 + 0.5 * column)):
            continue
        stand = _ground(probe, (x, y, z), radius, inside)
        if stand is None:
            continue
        there = robot.home(*stand)
        if grid_path(robot, scene, start, there, box=(inside[0], inside[1])).points is not None:
            return Pick(scene, _can(x, y, z + gap), start, name)
    raise ScenarioError(f"{os.fspath(root)}: no place for a can among {_TRIES}")


def _can(x: float, y: float, bottom: float) -> Cylinder:
    return Cylinder(_RADIUS, _HEIGHT, at=(x, y, bottom + 0.5 * _HEIGHT), name="can")


def _about_z(angle: float) -> tuple[float, float, float, float]:
    return 0.0, 0.0, sin(0.5 * angle), cos(0.5 * angle)


def _faces(scene: Scene) -> dict[str, list[Array]]:
    """Corners (K, 3) of the level top faces of the furniture's pieces, in order around, by what they are part of."""
    from scipy.spatial import ConvexHull, QhullError  # late: slow to import

    faces: dict[str, list[Array]] = {}
    for obstacle in scene:
        vertices = np.asarray(obstacle.spec["vertices"])
        top = vertices[vertices[:, 2] > vertices[:, 2].max() - 1e-3]
        if not (str(obstacle.name).startswith(_FURNITURE) and _LOW < top[0, 2] < _HIGH and len(top) > 2):
            continue
        try:
            around = ConvexHull(top[:, :2]).vertices
        except QhullError:
            continue
        faces.setdefault(str(obstacle.name).rpartition("-")[0], []).append(top[around])
    return faces


def _supported(corners: Array, place: tuple[float, float]) -> bool:
    """Whether all of the can is over a convex face (K, 2)."""
    along = np.roll(corners, -1, axis=0) - corners
    off = np.asarray(place) - corners
    inwards = (along[:, 0] * off[:, 1] - along[:, 1] * off[:, 0]) / np.maximum(np.hypot(*along.T), 1e-9)
    return bool(inwards.min() > _RADIUS)


def _ground(
    probe: _Probe, at: tuple[float, float, float], radius: float, inside: Array
) -> tuple[float, float, float] | None:
    """Place and yaw of a base before the nearest edge of what carries a can; None where there is no room."""
    x, y, z = at
    found: list[tuple[float, float, float, float]] = []
    for angle in np.arange(_DIRECTIONS) * 2.0 * pi / _DIRECTIONS:
        out = np.array((cos(angle), sin(angle)))
        for away in np.arange(_RADIUS, _EDGE, _POST):
            px, py = (x, y) + away * out
            if probe.touches(_POST, z - 0.06, (px, py, 0.5 * z)):
                continue
            for off in np.arange(away, away + _NEAR, 0.05):
                bx, by = ((x, y) + (off + radius) * out).tolist()
                within = (inside[0] < (bx, by)).all() and (inside[1] > (bx, by)).all()
                if within and not probe.touches(radius, _HEAD - 0.03, (bx, by, 0.03 + 0.5 * (_HEAD - 0.03))):
                    found.append((float(off), bx, by, float(angle) + pi))
                    break
            break
    return min(found)[1:] if found else None


class _Probe:
    """Whether upright cylinders touch anything of a scene."""

    def __init__(self, scene: Scene) -> None:
        self._table = scene.table

    def touches(self, radius: float, height: float, at: tuple[float, float, float]) -> bool:
        """Whether a cylinder with its middle at a place does."""
        table, place = self._table, np.asarray(at)
        half = np.array((radius, radius, 0.5 * height))
        near = (np.abs(table.center - place) <= table.half_extents + half).all(axis=1)
        cylinder, pose = coal.Cylinder(radius, height), coal.Transform3s(np.eye(3), place)
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        for k in np.flatnonzero(near):
            part = coal.Transform3s(np.asarray(table.rotation[k]), np.asarray(table.translation[k]))
            result.clear()
            if coal.collide(cylinder, pose, table.parts[k].geometry, part, request, result):
                return True
        return False


def grasps(robot: RobotModel, can: Cylinder) -> list[HandPose]:
    """From all around and from above.

    Raises:
        ParameterError: the robot's hand is not known.
    """
    return hand_poses(robot, can.pose[:3, 3] + (0.0, 0.0, _RAISED), before=_RADIUS)


def hand_poses(robot: RobotModel, place: Array, *, before: float) -> list[HandPose]:
    """Poses of the hand that end ``before`` [m] a place (3,) of the world, from all around and from above.

    Raises:
        ParameterError: the robot's hand is not known.
    """
    hand = _hand_of(robot)
    return HandPose.around(
        hand.frame,
        place,
        held=(hand.front + before, *hand.aside),
        rotations=[pin.rpy.rpyToMatrix(roll, 0.0, 0.0) for roll in hand.rolls],
        tilts=_TILTS,
        count=_YAWS,
    )


def _hand_of(robot: RobotModel) -> _Hand:
    if robot.name not in _HANDS:
        raise ParameterError(f"the hand of {robot.name!r} is not known{nearest_name(robot.name, _HANDS)}")
    return _HANDS[robot.name]


def plan_pick(robot: RobotModel, pick: Pick, way: str, seed: int) -> ApproachReport:
    """The drive, the reach and the lift of a pick.

    Raises:
        GoalError: no configuration has the hand at the can.
    """
    hand, driven = _hand_of(robot), way == DRIVEN
    return plan_approach(
        robot,
        pick.scene,
        pick.start,
        grasps(robot, pick.can),
        (_APPROACH, 0.0, 0.0),
        then=_LIFT,
        holding=lambda q: robot.attached(pick.can, hand.frame, q=q, mass=0.4),
        start_depth=_DEPTH if way == STANDING else 0.0,
        beyond=pick.scene.with_obstacle(pick.can),
        params=DriveParams().strip if driven else None,
        near=DriveParams.standing().strip if driven else None,
        seed=seed,
    )


def measure_pick(robot: RobotModel, way: str, seed: int, root: str | None, compute: str) -> Figures:
    """Plan a pick, in the house or, without its folder, on a table of an open room; and drive it where that is asked
    for."""
    gap = 0.0 if way == STANDING else _FOAM
    pick = table_pick(robot, seed, gap=gap) if root is None else house_pick(root, robot, seed, gap=gap)
    told: Figures = {"on": pick.on, "height_m": pick.surface}
    before = seconds_counted()
    try:
        report = plan_pick(robot, pick, way, seed)
    except GoalError as error:
        told |= {"certified": False, "reason": str(error), "failures": {"the search": 1}}
        return told | {"work_s": seconds_counted() - before}
    told |= {"certified": report.certified, "reason": report.reason, "failures": dict(report.failures)}
    told |= {"work_s": seconds_counted() - before}
    return told | (_driven(pick, report, seed, compute) if way == DRIVEN and report.certified else {})


def _driven(pick: Pick, report: ApproachReport, seed: int, compute: str) -> Figures:
    """The parts driven one after the other, each from where its plan begins, and their contacts in truth."""
    assert report.drive is not None
    assert report.reach is not None
    far, near, closely = DriveParams(), DriveParams.standing(), PlantParams.seen_closely()
    legs = (
        (report.drive, pick.scene.with_obstacle(pick.can), far, PlantParams()),
        (report.reach, pick.scene, near, closely),
        (report.then[0], pick.scene, near, closely),
    )
    states, contacts = [], 0
    for plan, scene, params, plant in legs:
        result, _ = drive_plan(plan, scene, params, plant=plant, seed=seed, compute=compute)
        judged = evaluate(result.record, plan.strip.robot, World(scene))
        contacts += len(judged.collisions) + len(judged.rest_contacts)
        states.append(result.state)
    return {"reached": all(state is RunState.REACHED for state in states), "contacts": contacts}


def summary(runs: Sequence[Figures]) -> Figures:
    """Figures of some picks."""
    done = [run for run in runs if "error" not in run]
    driven = [run for run in done if "reached" in run]
    failures: Counter[str] = Counter()
    for run in done:
        failures.update(run["failures"])
    figures: Figures = {
        "count": len(runs),
        "certified": sum(run["certified"] for run in done),
        "work_s": percentiles([run["work_s"] for run in done]),
        "failures": dict(failures),
        "errors": [run["error"] for run in runs if "error" in run],
    }
    if driven:
        figures["reached"] = sum(run["reached"] for run in driven)
        figures["contacts"] = sum(run["contacts"] for run in driven)
    return figures
