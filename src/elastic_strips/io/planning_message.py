"""IO room, planning messages: MoveIt's ``moveit_msgs/PlanningScene`` as ROS prints it (YAML) or sends it (JSON).

Objects have a frame, a pose in it, and shapes with poses in the object; older messages have no pose of the object. The
frame is the planning frame, one of ``fixed_frame_transforms``, another object, or a subframe ``object/name`` of one.
What the robot holds is no obstacle: it moves with a link of the robot, as `AttachedObject` says.
"""

from __future__ import annotations

import logging
import math
import os
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import SceneError, nearest_name
from elastic_strips.files import read_input_text
from elastic_strips.scene import Box, Cone, ConvexHull, Cylinder, Mesh, Obstacle, Scene, Sphere
from elastic_strips.scene.quantities import check_pose, pose_of, quaternion_of
from elastic_strips.validation import check_choice, shown

from .moveit_scene import plane_slab
from .nodes import MAX_YAML_BYTES, Node, Source, load_json, parse_yaml
from .octomap import octree_obstacles
from .planning_scene import USUAL_WORLDS, AttachedObject, PlanningScene
from .point_cloud import LARGE_MESH, warn_of_units

_log = logging.getLogger(__name__)
_WORLD_KEYS = ("collision_objects", "attached_collision_objects", "octomap")
_SCENE_KEYS = (
    "name", "robot_state", "robot_model_name", "fixed_frame_transforms", "allowed_collision_matrix", "link_padding",
    "link_scale", "object_colors", "world", "is_diff",
)  # fmt: skip
_OBJECT_KEYS = (
    "header", "pose", "id", "type", "primitives", "primitive_poses", "meshes", "mesh_poses", "planes", "plane_poses",
    "subframe_names", "subframe_poses", "frame_names", "named_frames", "connected_objects", "operation",
)  # fmt: skip
_ADD, _REMOVE, _APPEND, _MOVE = range(4)  # operations of a CollisionObject
_BOX, _SPHERE, _CYLINDER, _CONE, _PRISM = range(1, 6)  # types of a SolidPrimitive
_DIMENSIONS = {_BOX: 3, _SPHERE: 1, _CYLINDER: 2, _CONE: 2, _PRISM: 1}
_NORM_TOLERANCE = 1e-2  # of a quaternion, as it may have been printed in few digits
_EMPTY_NORM = 1e-9
_AFTER = re.compile(r"\n---\s*\Z")
_Make = Callable[..., Obstacle]


def is_planning_scene(root: Node) -> bool:
    """Whether a document is such a message, or its world alone, or the answer of a service that holds it."""
    value = root.value
    if isinstance(value, dict) and isinstance(value.get("scene"), dict):
        value = value["scene"]
    return isinstance(value, dict) and (
        isinstance(value.get("world"), dict) or "collision_objects" in value or "robot_model_name" in value
    )


def load_message(path: str | os.PathLike[str]) -> Node:
    """A JSON file, or a YAML file, which may end with the line ``---`` that ROS prints behind every message.

    Raises:
        SceneError: the file cannot be read, or holds several documents.
    """
    file = Path(path)
    if file.suffix.lower() == ".json":
        return load_json(file, what="planning scene", error=SceneError)
    text = read_input_text(file, "YAML file", MAX_YAML_BYTES, SceneError)
    return parse_yaml(_AFTER.sub("\n", text), Source(file))


def planning_scene_of(root: Node, *, planes: str = "blocked") -> PlanningScene:
    """A ``moveit_msgs/PlanningScene``, its world alone, or the answer of the service ``get_planning_scene``.

    Obstacles have the objects' names; those of an object of several shapes have a number after it. The planning
    frame counts as the world. A plane has no end: it becomes a slab (`plane_slab`). Not taken over are colours,
    allowed collisions, paddings and scales of links: a warning in the log says so.

    Args:
        root: the document, as `load_message` reads it.
        planes: ``"blocked"``, or ``"free"``: they are left out.

    Raises:
        SceneError: it does not fit; the message names file, line and key.
    """
    check_choice("planes", planes, ("blocked", "free"), SceneError)
    if isinstance(root.value, dict) and isinstance(root.value.get("scene"), dict):
        root = root["scene"]
    return _Reader(root, planes).read()


@dataclass(slots=True)
class _Object:
    """An object of the world so far."""

    pose: Array
    shapes: list[tuple[_Make, Array, Node]]
    subframes: dict[str, Array]


class _Reader:
    """Reads one message; keeps the frames that are known so far."""

    def __init__(self, root: Node, planes: str) -> None:
        self._root = root
        self._planes = planes
        self._objects: dict[str, _Object] = {}
        self._frames: dict[str, Array] = {}
        self._worlds: set[str] = set()
        self._dropped: list[str] = []

    def read(self) -> PlanningScene:
        entries = self._root.mapping(what="a planning scene")
        if "world" in entries:
            self._unknown(entries, _SCENE_KEYS)
            world = entries["world"].mapping(what="a world") if entries["world"].value is not None else {}
        else:
            world = {key: entries[key] for key in _WORLD_KEYS if key in entries}
            self._unknown(entries, (*_SCENE_KEYS, *_WORLD_KEYS))
        self._unknown(world, _WORLD_KEYS)
        self._read_frames(entries)
        state = entries["robot_state"].mapping(what="a robot's state") if _given(entries, "robot_state") else {}
        for node in _list(world, "collision_objects"):
            self._read_object(node)
        octomap = self._octomap(world["octomap"]) if _given(world, "octomap") else []
        attached = [
            self._attached(node) for holder in (state, world) for node in _list(holder, "attached_collision_objects")
        ]
        obstacles = [
            o for name, thing in self._objects.items() for o in self._made(name, thing, set(self._objects) - {name})
        ]
        taken = {o.name for o in obstacles}
        for one in octomap:
            name = one.name or "octomap"
            while name in taken:
                name += "'"
            obstacles.append(one.named(name))
        joints, base = _state(state)
        self._say(entries)
        frame = next(iter(sorted(self._worlds - {""})), "")
        return PlanningScene(self._root.checked(Scene, obstacles), tuple(attached), joints, base, frame)

    def _unknown(self, entries: Mapping[str, Node], known: Sequence[str]) -> None:
        self._dropped += [f"the key {shown(key)}" for key in entries if key not in known]

    def _say(self, entries: Mapping[str, Node]) -> None:
        """Warn about everything that is not taken over."""
        path = self._root.source.path
        if count := len(_list(entries, "object_colors")):
            self._dropped.append(f"{count} colours")
        if _given(entries, "is_diff") and entries["is_diff"].value is True:
            self._dropped.append("the contents of the scene to which this one is a difference (is_diff)")
        self._drop_changed_links(entries)
        if allowed := sorted(self._objects.keys() & _allowed_names(entries)):
            self._dropped.append(f"that something may touch {', '.join(allowed[:6])}: nothing may")
        if self._dropped:
            counts = Counter(self._dropped)  # in the order of the message
            said = ", ".join(what if n == 1 else f"{what} ({n} times)" for what, n in list(counts.items())[:20])
            _log.warning("%s: left out: %s", path, said)
        worlds = sorted(self._worlds - set(USUAL_WORLDS))
        if worlds:
            _log.warning("%s: the frame %s is taken as the world", path, ", ".join(worlds))

    def _drop_changed_links(self, entries: Mapping[str, Node]) -> None:
        """Links that are to be padded or scaled."""
        for key, usual in (("link_padding", 0.0), ("link_scale", 1.0)):
            what = key.removeprefix("link_")
            values = [node[what].finite() for node in _list(entries, key)]
            if beyond := [v for v in values if v != usual]:
                self._dropped.append(
                    f"the {what} of {len(beyond)} links, up to {max(beyond):g}"
                    + (" m: a clearance of as much holds as well" if what == "padding" else "")
                )

    # frames

    def _read_frames(self, entries: Mapping[str, Node]) -> None:
        """The frames that ``fixed_frame_transforms`` place in the planning frame."""
        found: dict[str, tuple[str, Array]] = {}
        for node in _list(entries, "fixed_frame_transforms"):
            child = _frame_name(node["child_frame_id"])
            found[child] = (_frame_of(node.mapping()), _pose(node["transform"], "translation", "rotation"))
        roots = sorted({parent for parent, _ in found.values()} - {c for c, (p, _) in found.items() if p != c})
        if len(set(roots) - {""}) > 1:
            self._root.fail(
                f"fixed_frame_transforms has several roots: {', '.join(roots)}; one planning frame is needed"
            )
        for child in found:
            T, frame, passed = np.eye(4), child, set[str]()
            while frame in found and frame not in passed:
                passed.add(frame)
                parent, step = found[frame]
                T = step @ T
                if parent == frame:
                    break
                frame = parent
            else:
                if frame in passed:
                    self._root.fail(f"fixed_frame_transforms: the frame {child!r} hangs on itself")
            self._frames[child] = T
        self._worlds |= set(roots)
        for root in roots:
            self._frames.setdefault(root, np.eye(4))

    def _in_world(self, frame: str) -> Array | None:
        """T_world_frame (4, 4), or None where it is not known."""
        if frame in self._objects:
            return self._objects[frame].pose
        owner, _, name = frame.rpartition("/")
        if owner in self._objects and name in self._objects[owner].subframes:
            return self._objects[owner].pose @ self._objects[owner].subframes[name]
        if frame in self._frames:
            return self._frames[frame]
        return np.eye(4) if not frame else None

    def _placed(self, node: Node, entries: Mapping[str, Node]) -> Array:
        """T_world_frame of the frame that a message's header names."""
        frame = _frame_of(entries)
        T = self._in_world(frame)
        if T is not None:
            return T
        if not self._worlds - {""}:  # the first frame that nothing places is the planning frame
            self._worlds.add(frame)
            self._frames[frame] = np.eye(4)
            return np.eye(4)
        known = [*self._frames, *self._objects]
        node.fail(
            f"is in the frame {shown(frame)}, and nothing says where that is in {', '.join(sorted(self._worlds))}: "
            f"no fixed_frame_transforms and no object has it{nearest_name(frame, known)}"
        )

    # objects

    def _read_object(self, node: Node) -> None:
        """Take an object of the world over, as its operation says."""
        entries = node.mapping(what="a collision object")
        self._unknown(entries, _OBJECT_KEYS)
        name = entries["id"].text() if "id" in entries else node.fail("the object has no 'id'")
        operation = _operation(entries)
        if operation == _REMOVE:
            self._objects.pop(name, None)
            return
        T = self._placed(node, entries) @ (_pose(entries["pose"]) if _given(entries, "pose") else np.eye(4))
        if operation == _MOVE:
            if name not in self._objects:
                node.fail(f"moves the object {shown(name)}, which the scene does not have")
            self._objects[name].pose = T
            return
        shapes, subframes = self._shapes(entries), self._subframes(entries)
        old = self._objects.get(name) if operation == _APPEND else None
        if old is not None:
            back = np.linalg.inv(old.pose) @ T
            old.shapes += [(make, back @ at, where) for make, at, where in shapes]
            old.subframes.update({key: back @ at for key, at in subframes.items()})
            return
        self._objects.pop(name, None)
        self._objects[name] = _Object(T, shapes, subframes)
        if not shapes:
            self._dropped.append("objects without shapes")

    def _subframes(self, entries: Mapping[str, Node]) -> dict[str, Array]:
        for names, poses in (("subframe_names", "subframe_poses"), ("frame_names", "named_frames")):
            given, placed = _list(entries, names), _list(entries, poses)
            if len(given) != len(placed):
                (given or placed)[0].fail(f"there are {len(given)} {names} and {len(placed)} {poses}")
            if given:
                return {name.text(): _pose(at) for name, at in zip(given, placed, strict=True)}
        return {}

    def _shapes(self, entries: Mapping[str, Node]) -> list[tuple[_Make, Array, Node]]:
        """What makes the shapes of an object, and their poses in it."""
        found: list[tuple[_Make, Array, Node]] = []
        for shapes, poses, make in (
            ("primitives", "primitive_poses", _primitive),
            ("meshes", "mesh_poses", _mesh),
            ("planes", "plane_poses", _plane),
        ):
            given, placed = _list(entries, shapes), _list(entries, poses)
            if len(placed) > len(given):
                placed[len(given)].fail(f"there are {len(placed)} {poses}, and {len(given)} {shapes}")
            if len(placed) < len(given):  # as MoveIt takes them
                self._dropped.append(f"{poses} that are missing: those {shapes} are at the object's own place")
            if shapes == "planes" and given and self._planes == "free":
                self._dropped += ["planes"] * len(given)
                continue
            for k, node in enumerate(given):
                found.append((make(node), _pose(placed[k]) if k < len(placed) else np.eye(4), node))
        return found

    def _made(self, name: str, thing: _Object, taken: set[str]) -> list[Obstacle]:
        """The obstacles of an object."""
        made: list[Obstacle] = []
        for k, (make, at, node) in enumerate(thing.shapes, 1):
            called = name if len(thing.shapes) == 1 else f"{name}-{k}"
            while called in taken:
                called += "'"
            T = thing.pose @ at
            made.append(node.checked(make, at=T[:3, 3], quat=quaternion_of(T[:3, :3]), name=called))
        return made

    def _octomap(self, node: Node) -> list[Obstacle]:
        """The obstacles of an octomap with its pose."""
        entries = node.mapping(what="an octomap")
        if not _given(entries, "octomap"):
            return []
        inner = entries["octomap"]
        tree = inner.mapping(what="an octomap")
        values = tree["data"].value if "data" in tree else None
        if not values:
            return []
        if not isinstance(values, list) or not all(
            isinstance(v, int) and not isinstance(v, bool) and -128 <= v <= 255 for v in values
        ):
            tree["data"].fail("must be a list of whole bytes; 'ros2 topic echo --full-length' prints all of them")
        data = (np.array(values, dtype=np.int64) & 255).astype(np.uint8).tobytes()
        T = self._placed(node, entries) @ (_pose(entries["origin"]) if _given(entries, "origin") else np.eye(4))
        return node.checked(
            octree_obstacles,
            data,
            str(node.source.path),
            binary=inner["binary"].boolean(),
            kind=inner["id"].text(),
            resolution=inner["resolution"].finite(),
            at=T,
        )

    def _attached(self, node: Node) -> AttachedObject:
        """What a link holds."""
        entries = node.mapping(needed=("link_name", "object"), what="an attached object")
        link, inner = entries["link_name"].text(), entries["object"]
        thing = inner.mapping(what="a collision object")
        self._unknown(thing, _OBJECT_KEYS)
        name = thing["id"].text() if "id" in thing else inner.fail("the object has no 'id'")
        if _operation(thing) in (_REMOVE, _MOVE):
            thing["operation"].fail(f"{shown(name)} is let go of, or moved: a scene after that is needed")
        shapes, frame = self._shapes(thing), _frame_of(thing)
        pose = _pose(thing["pose"]) if _given(thing, "pose") else np.eye(4)
        if not shapes and name in self._objects:  # one of the world's, which is taken up
            old = self._objects.pop(name)
            shapes, frame, pose = old.shapes, None, old.pose
        elif name in self._objects:  # it is taken up, as MoveIt has it: an object is in one place
            self._dropped.append(f"{shown(name)} of the world, which the robot holds")
            del self._objects[name]
        if frame is None:
            pass
        elif frame != link:
            T = np.eye(4) if frame in USUAL_WORLDS and frame not in self._frames else self._in_world(frame)
            frame, pose = (frame, pose) if T is None else (None, T @ pose)
        if not shapes:
            inner.fail(f"the attached object {shown(name)} has no shapes, and the world has no object of that name")
        if any(node.key.rpartition("[")[0].endswith("planes") for _, _, node in shapes):
            inner.fail(f"the attached object {shown(name)} is a plane, which has no end")
        made = self._made(name, _Object(pose, shapes, {}), set())
        touch = tuple(each.text() for each in _list(entries, "touch_links"))
        weight = max(entries["weight"].finite(), 0.0) if _given(entries, "weight") else 0.0
        return AttachedObject(name, link, touch, tuple(made), frame, weight)


def _given(entries: Mapping[str, Node], key: str) -> bool:
    return key in entries and entries[key].value is not None


def _list(entries: Mapping[str, Node], key: str) -> list[Node]:
    return entries[key].items() if _given(entries, key) else []


def _allowed_names(entries: Mapping[str, Node]) -> set[str]:
    """What the matrix of allowed collisions has an entry for."""
    if not _given(entries, "allowed_collision_matrix"):
        return set()
    matrix = entries["allowed_collision_matrix"].mapping()
    names = [*_list(matrix, "entry_names"), *_list(matrix, "default_entry_names")]
    return {name.value for name in names if isinstance(name.value, str)}


def _frame_name(node: Node) -> str:
    if not isinstance(node.value, str):
        node.fail(f"must be the name of a frame, not {node.kind}")
    return node.value.strip().lstrip("/")


def _frame_of(entries: Mapping[str, Node]) -> str:
    """The frame that a header names; "" where there is none."""
    header = entries["header"].mapping(what="a header") if _given(entries, "header") else {}
    return _frame_name(header["frame_id"]) if _given(header, "frame_id") else ""


def _numbers(node: Node, keys: str) -> Array:
    entries = node.mapping(needed=tuple(keys), what="numbers")
    return np.array([entries[key].number(low=-1e6, high=1e6, unit="") for key in keys])


def _pose(node: Node, position: str = "position", orientation: str = "orientation") -> Array:
    """(4, 4) of a ``geometry_msgs`` pose or transform; an orientation of zeros is none, as MoveIt takes it."""
    entries = node.mapping(needed=(position, orientation), what="a pose")
    at, quat = _numbers(entries[position], "xyz"), _numbers(entries[orientation], "xyzw")
    norm = float(np.linalg.norm(quat))
    if norm < _EMPTY_NORM:
        quat, norm = np.array([0.0, 0.0, 0.0, 1.0]), 1.0
    if abs(norm - 1.0) > _NORM_TOLERANCE:
        entries[orientation].fail(f"the quaternion has length {norm:.6g}; it must have 1")
    return node.checked(pose_of, at, quat / norm)


def _operation(entries: Mapping[str, Node]) -> int:
    """What is done with an object: a byte, which ROS 2 prints as a character."""
    if not _given(entries, "operation"):
        return _ADD
    node = entries["operation"]
    if isinstance(node.value, str) and len(node.value) == 1:
        value = ord(node.value)
        return Node(value - 48 if value >= 48 else value, node.key, node.source).integer(low=_ADD, high=_MOVE)
    return node.integer(low=_ADD, high=_MOVE)


def _primitive(node: Node) -> _Make:
    entries = node.mapping(needed=("type", "dimensions"), what="a primitive")
    kind = entries["type"].integer(low=_BOX, high=_PRISM)
    sizes = entries["dimensions"].vector()
    if len(sizes) < _DIMENSIONS[kind]:
        entries["dimensions"].fail(f"has {len(sizes)} numbers; type {kind} has {_DIMENSIONS[kind]}")
    if kind == _BOX:
        return lambda **where: Box(sizes[:3], **where)
    if kind == _SPHERE:
        return lambda **where: Sphere(float(sizes[0]), **where)
    if kind == _PRISM:  # its hull, where it is not convex
        outline = np.array([_numbers(point, "xyz")[:2] for point in node["polygon"]["points"]]).reshape(-1, 2)
        half = 0.5 * float(sizes[0])
        corners = np.vstack([np.column_stack((outline, np.full(len(outline), z))) for z in (-half, half)])
        return lambda **where: ConvexHull(corners, **where)
    height, radius = float(sizes[0]), float(sizes[1])
    return lambda **where: (Cylinder if kind == _CYLINDER else Cone)(radius, height, **where)


def _mesh(node: Node) -> _Make:
    entries = node.mapping(needed=("vertices", "triangles"), what="a mesh")
    points = np.array([_numbers(vertex, "xyz") for vertex in entries["vertices"]]).reshape(-1, 3)
    faces = np.array([triangle["vertex_indices"].vector(3) for triangle in entries["triangles"]]).reshape(-1, 3)
    if not len(points) or not len(faces):
        node.fail(f"the mesh has {len(points)} vertices and {len(faces)} triangles")
    warn_of_units(f"{node.source.path}: {node.key}", points, LARGE_MESH)
    return lambda **where: Mesh(points, faces, **where)


def _plane(node: Node) -> _Make:
    coef = node["coef"].vector(4)
    if not np.linalg.norm(coef[:3]) > 0.0:
        node["coef"].fail("a plane's normal must not be 0")
    return lambda at, quat, name: plane_slab(coef, pose_of(at, quat), name)


def _state(state: Mapping[str, Node]) -> tuple[dict[str, float], tuple[float, float, float] | None]:
    """Joint values by name, and x, y, yaw of the one joint that has more than one degree of freedom."""
    joints: dict[str, float] = {}
    if _given(state, "joint_state"):
        entries = state["joint_state"].mapping(what="a joint state")
        names, values = _list(entries, "name"), _list(entries, "position")
        if len(names) == len(values):
            joints = {n.text(): v.finite() for n, v in zip(names, values, strict=True)}
    base = None
    if _given(state, "multi_dof_joint_state"):
        moves = _list(state["multi_dof_joint_state"].mapping(what="a joint state"), "transforms")
        if len(moves) == 1:
            T = check_pose(_pose(moves[0], "translation", "rotation"))
            base = float(T[0, 3]), float(T[1, 3]), math.atan2(T[1, 0], T[0, 0])
    return joints, base
