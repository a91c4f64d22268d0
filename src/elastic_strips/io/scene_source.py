"""IO room, sources of scenes: files of other programs, read with options: a pose, heights, a grid.

A source is a map of Nav2, an octree, a point cloud, a scene of MoveIt, or a scene file of this library's own.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypedDict

import numpy as np

from elastic_strips.arrays import Array, ArrayLike, Indices
from elastic_strips.errors import ScenarioError, SceneError, nearest_name
from elastic_strips.robot import RobotModel
from elastic_strips.robot.reach import highest_reach
from elastic_strips.scene import Obstacle, Scene, World
from elastic_strips.scene.motion import Keyframes, Motion, Twist, UnknownMotion
from elastic_strips.scene.quantities import check_pose, pose_of, quaternion_of
from elastic_strips.summary import Summary
from elastic_strips.validation import check_array, check_choice, check_number, shown

from .moveit_scene import read_moveit_scene
from .nav2_map import WALL_HEIGHT, MapArea, outside_of, read_map
from .nodes import Node
from .obstacle_document import warn_of_degrees
from .octomap import read_octomap
from .planning_message import is_planning_scene, load_message, planning_scene_of
from .planning_scene import PlanningScene
from .point_cloud import PointCloud, cloud_scene, read_point_cloud, read_points, warn_of_dropped, without_robot

_log = logging.getLogger(__name__)
MAP, OCTREE, CLOUD = "a map", "an octree", "a cloud"
MOVEIT, MESSAGE, OWN = "a MoveIt scene", "a planning scene", "a scene file"
_SUFFIXES = {
    ".scene": MOVEIT, ".bt": OCTREE, ".ot": OCTREE,
    **dict.fromkeys((".pcd", ".ply", ".xyz", ".txt", ".csv", ".npy"), CLOUD),
}  # fmt: skip
_HALF_TURN_PRODUCT = 1e-6  # of the product of two quaternions, below which they are half a turn apart
_MESHES = (".stl", ".obj", ".dae")
_LISTED = (".csv", ".npy")
OF_KIND: Mapping[str, tuple[str, ...]] = {
    MAP: ("at", "low", "high", "unknown", "lethal", "outside"),
    OCTREE: ("at", "low", "high", "occupied"),
    CLOUD: ("at", "low", "high", "voxel", "scale", "min_points", "own_points"),
    MOVEIT: ("at", "planes"),
    MESSAGE: ("at", "planes"),
    OWN: ("at",),
}
"""The options of reading a source, by its kind."""


class SceneOptions(TypedDict, total=False):
    """How the files of other programs are read; each option is for some kinds only, see `OF_KIND`.

    Attributes:
        at: pose of the file's frame in the world: x, y, z; x, y, z, yaw; x, y, z, qx, qy, qz, qw; or a matrix (4, 4).
        low, high: heights in the world [m]: walls of a map are between them (by default from the floor to as high as
            the robot reaches, `WALL_HEIGHT` where it is not known); the parts of octrees and clouds beyond are left
            out.
        unknown: how a map's unknown cells count: ``"free"`` (default) or ``"occupied"``.
        lethal: occupancy from which on a map's cell is occupied, see `load_nav2_map`.
        outside: how space outside a map counts: ``"blocked"`` (default) or ``"free"``.
        occupied: probability from which on an octree's cell is occupied.
        voxel: edge of the grid's cells that a cloud becomes [m].
        scale: factor that makes a cloud's numbers metres.
        min_points: cells of a cloud with fewer points are left out.
        own_points: a cloud's points within this distance [m] of the robot, where it stands, are its own and left out.
        planes: how a MoveIt scene's planes count: ``"blocked"`` (default) or ``"free"``.
    """

    at: ArrayLike
    low: float
    high: float
    unknown: str
    lethal: float
    outside: str
    occupied: float
    voxel: float
    scale: float
    min_points: int
    own_points: float
    planes: str


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SceneFile(Summary):
    """Everything in a scene's files.

    Attributes:
        world: the obstacles, and when they appear and vanish.
        held: planning scenes with objects that the robot holds.
        areas: areas of the maps among the sources, if the outside of them does not count as free.
        assumed_height: height [m] that was assumed for walls of maps, because neither a file nor the robot gave one.
        unplaced: planning scenes whose frame was taken as the world, because no robot was known that may have it.
    """

    world: World
    held: tuple[PlanningScene, ...] = ()
    areas: tuple[MapArea, ...] = ()
    assumed_height: float | None = None
    unplaced: tuple[PlanningScene, ...] = ()

    @property
    def held_names(self) -> tuple[str, ...]:
        """The held objects, each with the link that holds it."""
        return tuple(f"{thing.name} (at {thing.link})" for scene in self.held for thing in scene.attached)

    def held_by(self, robot: RobotModel) -> RobotModel:
        """The robot with all that it holds; see `PlanningScene.held_by`.

        Raises:
            RobotError, ConfigurationError: as for `PlanningScene.held_by`.
        """
        for scene in self.held:
            robot = scene.held_by(robot)
        return robot

    def outside(self, points: ArrayLike) -> Indices:
        """Numbers of the points (N, 2) of the world [m] that no map shows; none where there is no map."""
        xy = np.asarray(points, dtype=float)
        inside = np.zeros(len(xy), dtype=bool)
        for area in self.areas:
            inside |= area.holds(xy)
        return np.flatnonzero(~inside) if self.areas else np.zeros(0, dtype=np.intp)


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """The context in which scenes are read.

    Attributes:
        robot: the robot as high as whose reach walls of maps have to be.
        q: (nq,) its configuration when clouds were seen.
        within: files being read that contain this one.
        read: all files of the scene so far.
    """

    robot: RobotModel | None = None
    q: Array | None = None
    within: tuple[str, ...] = ()
    read: list[str] = field(default_factory=list)


def kind_of(path: Path) -> tuple[str, Node | None]:
    """Kind of a file, and its document if it is YAML or JSON.

    Raises:
        SceneError: it cannot be read, or is of another kind.
    """
    suffix = path.suffix.lower()
    if suffix in _SUFFIXES:
        return _SUFFIXES[suffix], None
    if suffix in _MESHES:
        shape = f"{{shape: mesh, file: {path.name}}}"
        raise SceneError(f"{path}: is a mesh; a scene file takes it in, by a line 'obstacles: [{shape}]'")
    root = load_message(path)
    value = root.value
    if isinstance(value, dict) and "image" in value:
        return MAP, root
    return (MESSAGE if is_planning_scene(root) else OWN), root


def pose_from(at: ArrayLike) -> Array:
    """Pose (4, 4) of the option ``at`` of `SceneOptions`.

    Raises:
        SceneError: it has none of these forms.
    """
    if np.ndim(at) == 2:
        return check_pose(at)
    values = check_array("at", at, (None,), error=SceneError)
    if len(values) not in (3, 4, 7):
        raise SceneError(
            f"at has {len(values)} numbers; 3 (x, y, z), 4 (with the yaw) or 7 (with a quaternion qx, qy, qz, qw) are "
            "needed"
        )
    if len(values) == 4:
        warn_of_degrees("at: the yaw", float(values[3]))
    half = 0.5 * values[3] if len(values) == 4 else 0.0
    return pose_of(values[:3], values[3:] if len(values) == 7 else (0.0, 0.0, math.sin(half), math.cos(half)))


def check_options(kind: str, options: SceneOptions, where: str) -> None:
    """Refuse options that are not for a kind of source.

    Raises:
        SceneError: there is such an option, or an unknown choice.
    """
    for key in options:
        if key not in OF_KIND[kind]:
            whose = [other for other, keys in OF_KIND.items() if key in keys]
            if not whose:
                raise SceneError(
                    f"{where}: unknown option {shown(key)}{nearest_name(key, SceneOptions.__annotations__)}"
                )
            raise SceneError(f"{where}: is {kind}; {key!r} is for {', '.join(whose)}")
    for key in ("outside", "planes"):
        check_choice(key, options.get(key, "blocked"), ("blocked", "free"), SceneError)
    for key in ("low", "high", "own_points"):
        check_number(key, options.get(key, 0.0), unit="m", error=SceneError)


def read_foreign(path: Path, kind: str, root: Node | None, options: SceneOptions, reading: Reading) -> SceneFile:
    """The content of a file of another program; edges of maps are not among the obstacles yet.

    Raises:
        SceneError: it cannot be read.
        MissingExtraError: a map whose image is not a PGM file, and Pillow is not installed.
    """
    check_options(kind, options, str(path))
    pose = pose_from(options["at"]) if "at" in options else None
    if kind == MAP:
        return _map(path, options, pose, reading)
    if kind == OCTREE:
        scene = read_octomap(
            path, occupied=options.get("occupied", 0.5), low=options.get("low"), high=options.get("high"), at=pose
        )
        return SceneFile(World(scene))
    if kind == CLOUD:
        return SceneFile(World(_cloud(path, options, pose, reading)))
    planes = options.get("planes", "blocked")
    if kind == MOVEIT:
        return SceneFile(placed(World(read_moveit_scene(path, planes=planes)), pose))
    assert root is not None
    message = planning_scene_of(root, planes=planes)
    if pose is None and reading.robot is not None:
        pose = message.pose_of_frame(reading.robot, reading.q)
        if pose is not None and not np.array_equal(pose, np.eye(4)):
            _log.warning("%s: the robot has the frame %s: it is where the path begins", path, shown(message.frame))
    if pose is not None:
        message = replace(message, attached=message.attached_at(pose))
    unplaced = (message,) if pose is None and reading.robot is None else ()
    return SceneFile(placed(World(message.scene), pose), (message,) if message.attached else (), unplaced=unplaced)


def _map(path: Path, options: SceneOptions, pose: Array | None, reading: Reading) -> SceneFile:
    assumed = None
    if "high" in options:
        high = options["high"]
    elif reading.robot is not None:
        high = highest_reach(reading.robot)
    else:
        high = assumed = WALL_HEIGHT
    try:
        walls, area = read_map(
            path,
            unknown=options.get("unknown", "free"),
            lethal=options.get("lethal", 100.0),
            at=pose,
            low=options.get("low", 0.0),
            height=high,
        )
    except ScenarioError as error:
        raise SceneError(str(error)) from None
    areas = (area,) if options.get("outside", "blocked") == "blocked" else ()
    return SceneFile(World(Scene(walls)), areas=areas, assumed_height=assumed)


def _cloud(path: Path, options: SceneOptions, pose: Array | None, reading: Reading) -> Scene:
    if "voxel" not in options:
        source = f"{{file: {path.name}, voxel: …}}"
        shape = f"{{shape: points, file: {path.name}, radius: …}}"
        raise SceneError(
            f"{path}: is a point cloud; 'voxel' says how large the cells are that its points fill [m]; a scene file "
            f"takes it in by a line 'sources: [{source}]', or 'obstacles: [{shape}]'"
        )
    scale = check_number("scale", options.get("scale", 1.0), above=0.0, error=SceneError)
    if path.suffix.lower() in _LISTED:
        cloud = PointCloud(read_points(path, scale=scale), 0)
    else:
        cloud = read_point_cloud(path, scale=scale)
        warn_of_dropped(str(path), cloud)
    points = cloud.points if pose is None else cloud.points @ pose[:3, :3].T + pose[:3, 3]
    if "own_points" in options:
        if reading.robot is None or reading.q is None:
            raise SceneError(f"{path}: 'own_points' needs the robot and where it stood")
        points = without_robot(points, reading.robot, reading.q, options["own_points"]).points
    kept = points[(points[:, 2] >= options.get("low", -math.inf)) & (points[:, 2] <= options.get("high", math.inf))]
    if len(kept) < len(points):
        _log.warning("%s: left out: %d points outside low and high", path, len(points) - len(kept))
    if not len(kept):
        raise SceneError(f"{path}: nothing is left of {len(cloud.points)} points")
    return cloud_scene(kept, options["voxel"], min_points=options.get("min_points", 1))


def placed(world: World, pose: Array | None) -> World:
    """A world whose frame has the pose (4, 4).

    Raises:
        SceneError: a motion that cannot be moved.
    """
    if pose is None:
        return world
    obstacles = [
        o.moved(pose @ o.pose) if o.motion is None else o.observed(check_pose(pose @ o.pose), _turned(o, pose))
        for o in world.scene
    ]
    return World(Scene(obstacles, time=world.scene.stamp), world.appears, world.vanishes)


def _turned(obstacle: Obstacle, pose: Array) -> Motion:
    motion, turn = obstacle.motion, pose[:3, :3]
    if isinstance(motion, Twist):
        return Twist(linear=turn @ motion.linear, angular=turn @ motion.angular)
    if isinstance(motion, UnknownMotion):
        return motion
    if isinstance(motion, Keyframes):
        times, at, quats = motion.times, motion.positions @ turn.T + pose[:3, 3], motion.quats
        if quats is not None:  # else the obstacle keeps its own orientation
            half = np.flatnonzero(np.abs((quats[1:] * quats[:-1]).sum(axis=1)) < _HALF_TURN_PRODUCT)
            if len(half):  # which way round must not depend on rounding: a keyframe in the middle says it
                middle = quats[half] + quats[half + 1]
                middle /= np.linalg.norm(middle, axis=1)[:, None]
                quats = np.insert(quats, half + 1, middle, axis=0)
                at = np.insert(at, half + 1, 0.5 * (at[half] + at[half + 1]), axis=0)
                times = np.insert(times, half + 1, 0.5 * (times[half] + times[half + 1]))
            quats = _product(quaternion_of(turn), quats)
        return Keyframes(times, at, quats=quats, loop=motion.loop)
    raise SceneError(f"obstacle {obstacle.name!r}: a motion of type {type(motion).__name__} cannot be placed elsewhere")


def _product(first: Array, quats: Array) -> Array:
    """The quaternions (N, 4) of turns that are followed by the turn ``first`` (4,)."""
    v, w = first[:3], first[3]
    turned = w * quats[:, :3] + quats[:, 3:] * v + np.cross(v, quats[:, :3])
    return np.column_stack((turned, w * quats[:, 3] - quats[:, :3] @ v))


def joined(parts: Sequence[SceneFile], own: World) -> SceneFile:
    """All parts of a scene in one, the world's own obstacles first; names that are taken get a number."""
    obstacles = list(own.scene)
    appears, vanishes = dict(own.appears), dict(own.vanishes)
    taken = set(own.scene.names)
    for part in parts:
        for obstacle in part.world.scene:
            name = free = obstacle.name or obstacle.shape
            number = 1
            while free in taken:
                number += 1
                free = f"{name}-{number}"
            taken.add(free)
            obstacles.append(obstacle.named(free))
            for times, new in ((part.world.appears, appears), (part.world.vanishes, vanishes)):
                if name in times:
                    new[free] = times[name]
    heights = [part.assumed_height for part in parts if part.assumed_height is not None]
    return SceneFile(
        World(Scene(obstacles, time=own.scene.stamp), appears, vanishes),
        tuple(held for part in parts for held in part.held),
        tuple(area for part in parts for area in part.areas),
        min(heights, default=None),
        tuple(scene for part in parts for scene in part.unplaced),
    )


def bounded(found: SceneFile) -> SceneFile:
    """The same with obstacles that stand for the outside of its maps."""
    if not found.areas:
        return found
    world = joined([SceneFile(World(Scene(outside_of(found.areas))))], found.world).world
    return replace(found, world=world)
