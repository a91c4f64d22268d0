"""load_robot: a robot by name or from a URDF file."""

from __future__ import annotations

import logging
import math
import os
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypedDict

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.catalogue import find_robot, is_known, is_ours
from elastic_strips.errors import RobotError, nearest_name

from .coal_shapes import SIGNS, ShapeKind, convex_from_vertices, shape_of, support, vertices
from .collada import meant_turned, said_of_turned
from .cover import sticks_out
from .free_posture import free_posture
from .mimic import Following, with_followers
from .model import RobotModel, check_joint_names, reference_configuration
from .second_reader import differences
from .space import LIMIT_TOLERANCE, BaseKind
from .srdf import Srdf, read_srdf, within_limits
from .urdf import MAX_LENGTH, UrdfSource, pinocchio_geometry, pinocchio_model, read_urdf
from .xacro_file import expand_xacro

_log = logging.getLogger(__name__)
_MANY_JOINTS = 20  # more planned joints than these are warned about
_LARGE = 20.0  # [m] no part of a robot is longer; in a mesh of millimetres that is read as metres, one of 2 cm is
_LEVEL = 0.05  # how far the axis of a wheel is from level, as a sine; [m] by how much a caster's wheel may be higher
_LARGEST_RATIO = 1e6  # of a follower's speed and its leader's, or the other way round
_SHEET = 1e-4  # [m]: what is drawn thinner than this gets this thickness as a collision shape
_GROWN = 0.05  # [m] by which a piece of a drawn shape may reach out of it without a warning
_SELDOM_PLANNED = (
    "wheel", "caster", "roller", "finger", "thumb", "gripper", "knuckle", "palm", "jaw", "hand_", "index", "middle",
    "ring_", "pinky", "little", "head", "neck", "eye",
)  # fmt: skip
"""In the names of joints that an arm's motion can do without."""
_ROUND = 0.003  # [m] by how much a wheel may stick out farther on one side: its mesh has corners
_HOMES = ("home", "default", "half_sitting", "standing")


class LoadOptions(TypedDict, total=False):
    """What may be said of a robot besides its name and its base: the arguments of ``load_robot`` of these names."""

    joints: Iterable[str]
    group: str
    locked: Mapping[str, float]
    srdf: str | Path
    package_dirs: tuple[str | Path, ...]
    visual_as_collision: Collection[str] | str


def load_robot(
    name_or_path: str | Path,
    *,
    base: str | BaseKind | None = None,
    srdf: str | Path | None = None,
    control_points: Mapping[str, str | tuple[str, ArrayLike]] | None = None,
    joints: Iterable[str] | None = None,
    group: str | None = None,
    locked: Mapping[str, float] | None = None,
    package_dirs: tuple[str | Path, ...] = (),
    mappings: Mapping[str, str] | None = None,
    visual_as_collision: Collection[str] | str = (),
) -> RobotModel:
    """Load a robot by name (``"silvermate"``, ``"tiago"``, ``"panda"``, …: ``robot_names()``) or from a URDF file.

    A xacro file (``.xacro``; extra ``ros``) is expanded first. xacro evaluates expressions: open files you trust.

    What a file gets wrong without harm is mended or passed over, with a warning in the log: see ``docs/robots.md``.

    Args:
        name_or_path: a name, or a path that ends in ``.urdf`` or ``.xacro``, or holds a separator.
        base: ``"diff_drive"``, ``"omni"`` or ``"fixed"``; by default the named robot's own, and ``"diff_drive"`` for
            a file.
        srdf: SRDF file with the link pairs to ignore, named postures (``group_state``: see ``RobotModel.home`` and
            ``RobotModel.state``) and groups of joints; by default the named robot's own.
        control_points: name → frame, or name → (frame, offset [m]); by default the joints' origins and the hand.
        joints: the joints to plan; all others are held still at home, but for those that mimic a planned one: they
            follow it (``RobotModel.followers``), and their limits are its limits, too.
        group: an SRDF group of which the joints are planned, instead of ``joints``.
        locked: joint → value [rad or m] held still, besides what is held still anyway: what ``joints`` or ``group``
            do not name; without these wheels, casters, joints that others mimic unless they carry more than those (a
            lift is planned, a gripper held), and what is neither lift nor arm of TIAGo. Joints that mimic a locked one
            are held where that puts them, and what a locked one mimics is held where that puts it, unless they are
            given a value here.
        package_dirs: folders to search for ``package://`` meshes and for a xacro file's ``$(find …)``.
        mappings: arguments of a xacro file, by name.
        visual_as_collision: links whose visual shapes are taken as their collision shapes, meshes as convex hulls; or
            ``"missing"``: all that are drawn and have no collision shape, of which nothing is proven otherwise.

    Raises:
        RobotError: an unknown name, or one that several robots share; an unknown joint or group, or a joint that is
            both planned and locked, or locked though it follows a planned one; a fault in a file. The message names
            file, element and alternatives; the file is the expanded one of a xacro file.
        MissingExtraError: a xacro file, and xacro is not installed.
    """
    text = str(name_or_path)
    path = Path(text).expanduser()
    by_path = path.suffix.lower() in (".urdf", ".xml", ".xacro") or "/" in text or os.path.exists(path)
    if is_known(text) or not text or not by_path:
        known = find_robot(text)
        source = read_urdf(
            known.urdf, package_dirs=(*package_dirs, *known.package_dirs), visual_as_collision=visual_as_collision
        )
        kind, srdf = known.base if base is None else base, srdf or known.srdf
        home, hand, name = known.home, known.hand_frame, known.name
        if joints is None and group is None and known.planned is not None:
            joints = [joint for joint in known.planned if joint not in (locked or {})]
    else:
        urdf = expand_xacro(path, mappings, package_dirs) if path.suffix.lower() == ".xacro" else path
        source = read_urdf(urdf, package_dirs=package_dirs, visual_as_collision=visual_as_collision)
        kind, home, hand, name = (
            BaseKind.DIFF_DRIVE if base is None else base,
            {},
            None,
            path.stem.removesuffix(".urdf"),
        )
    if mappings and (is_known(text) or path.suffix.lower() != ".xacro"):
        raise RobotError(f"mappings={dict(mappings)!r} are arguments of a xacro file; {text!r} is none")
    kind = BaseKind.parse(kind)
    semantics = None if srdf is None else read_srdf(srdf, source)
    planned = _planned(source, semantics, joints, group, locked)
    try:
        model = pinocchio_model(source, planar=kind.planar)
        check_joint_names(model, locked or {}, "locked")
        wheels = _wheels(model, source)
        resting = _resting(model, source)
        names, held = frozenset(model.names[1:]) - {"root_joint"}, _with_leaders(source, locked or {})
        told, described = planned, (source, model)
        if planned is None:
            planned = names - resting - set(held)
        following = _following(source, planned, locked or {})
        unplanned = names - planned - set(following)
        model, source = _with_followers(model, source, following)
        collision = pinocchio_geometry(source, model, pin.COLLISION)
        turned = meant_turned(source.document, model, collision)
        _thicken(collision, source)
        _check_shapes(collision, source)
        drawn = _drawn(source, model)

        def still(home: Mapping[str, float]) -> dict[str, float]:
            return _still(source, unplanned, held, home)

        def build(home: Mapping[str, float]) -> RobotModel:
            values = still(home)
            return RobotModel.from_pinocchio(
                model, collision, partial(_visual, source, model),
                base=kind, name=name, locked=values,
                home={j: v for j, v in home.items() if j in planned},
                disabled_pairs=semantics.disabled if semantics is not None and semantics.disabled else None,
                enabled_pairs=() if semantics is None else semantics.enabled, followers=source.following(),
                control_points=control_points, hand_frame=hand,
                states=None if semantics is None else semantics.states,
                urdf_path=str(source.path), srdf_path=None if semantics is None else str(semantics.path),
                held=_why_held(source, values, locked or {}, wheels, told),
                groups=None if semantics is None else semantics.groups, drawn=drawn, description=source,
                round_wheels=rolling,
            )  # fmt: skip

        rolling = _round_wheels(model, collision, resting & source.continuous)
        robot = _at_home(build, still, home, semantics, source, resting)
        robot = replace(robot, bare_links=_bare(source, robot, drawn))
    except (ValueError, RuntimeError, IndexError) as error:  # a RobotError, or what Pinocchio and Coal throw
        said = " ".join(str(error).split())
        raise RobotError(said if str(source.path) in said else f"{source.path}: {said}") from None
    for joint, (leader, multiplier, offset) in source.followers.items():
        wanted = multiplier * robot.locked.get(leader, 0.0) + offset
        if abs(robot.locked.get(joint, wanted) - wanted) > LIMIT_TOLERANCE:
            why = "; it is locked" if joint in (locked or {}) else ", outside of its limits; it is held"
            _log.warning("%s: joint %r mimics %r, which puts it at %.6g%s at %.6g",
                         name, joint, leader, wanted, why, robot.locked[joint])  # fmt: skip
    _compare_states(name, semantics, robot.followers)
    if len(robot.joint_names) > _MANY_JOINTS:
        _log.warning("%s plans %d joints, which are many: slow to plan and to deform. %s",
                     name, len(robot.joint_names), _what_to_lock(robot))  # fmt: skip
    if robot.bare_links:
        _log.warning(
            "%s: %d links are drawn and have no collision shape, so nothing is proven of them: %s. "
            'visual_as_collision="missing" (--visual-as-collision missing) takes what is drawn',
            name, len(robot.bare_links), _all(robot.bare_links, 40),
        )  # fmt: skip
    if turned:
        _log.warning("%s: %s", name, said_of_turned(turned))
    _say_what_grew(robot, source.from_visual)
    if not is_ours(source.path):  # those are compared by the tests
        _say_what_differs(*described, name)
    return robot


def _planned(
    source: UrdfSource, semantics: Srdf | None, joints: Iterable[str] | None, group: str | None,
    locked: Mapping[str, float] | None,
) -> frozenset[str] | None:  # fmt: skip
    """The joints to plan, or None where all are planned but those that are locked."""
    if joints is not None and group is not None:
        raise RobotError(f"joints={joints!r} and group={group!r} both say what is planned; give one of them")
    if group is not None:
        groups = {} if semantics is None else semantics.groups
        if group not in groups:
            where = "no SRDF is given" if semantics is None else str(semantics.path)
            raise RobotError(f"unknown group {group!r} ({where}){nearest_name(group, groups)}")
        joints = []
        for joint in groups[group]:
            if why := _cannot_lead(source, joint):
                _log.warning("group %r: joint %r is held still: %s", group, joint, why)
            else:
                joints.append(joint)
        if not joints:
            raise RobotError(f"group {group!r} of {semantics and semantics.path} has no joint that can be planned")
    if joints is None:
        return None
    if isinstance(joints, str):
        raise RobotError(f"joints={joints!r} is one text; give a list of joint names")
    movable = set(source.joint_limits) | set(source.continuous)
    planned, following = list(joints), source.following()
    for joint in planned:
        if joint not in movable:
            hint = " is fixed, floating or planar" if joint in source.joints else nearest_name(joint, movable)
            raise RobotError(f"joints: cannot plan {joint!r}{hint}")
        if why := _cannot_lead(source, joint):
            raise RobotError(f"joints: cannot plan {joint!r}: {why}. Hold it still (locked={{{joint!r}: …}}, --lock)")
        if joint in source.followers and following[joint].leader not in planned:
            leader = following[joint].leader
            raise RobotError(
                f"joints: cannot plan {joint!r} alone: it has to <mimic> {leader!r}. Plan that one, and it follows; or "
                f"hold that one still (locked={{{leader!r}: …}}, --lock), and it is held where that puts it"
            )
    planned = [joint for joint in planned if joint not in source.followers]
    both = sorted(set(planned) & set(locked or {}))
    if both:
        raise RobotError(f"joints that are to be planned and locked: {', '.join(both)}; name each in one of the two")
    return frozenset(planned)


def _resting(model: pin.Model, source: UrdfSource) -> frozenset[str]:
    """The joints that are held still where nothing is said of any.

    Of joints that others mimic, those that carry no more than these: grippers. A lift that carries an arm is planned.
    """
    wheels, following = _wheels(model, source), source.following()
    resting, movable = wheels | source.mimic, {*source.joint_limits, *source.continuous}
    held = set()
    for leader in {follower.leader for follower in following.values()} - wheels:
        own = [leader, *(name for name, follower in following.items() if follower.leader == leader)]
        ids = [model.getJointId(name) for name in own if model.existJointName(name)]
        carries = leader in movable and {model.names[k] for i in ids for k in model.subtrees[i]} - set(own) - resting
        why = _cannot_lead(source, leader)
        if carries and why:
            _log.warning("%s: joint %r is held still: %s", source.path, leader, why)
        if why or not carries:
            held.add(leader)
    resting = resting | held
    return frozenset(joint for joint in resting if model.existJointName(joint))


def _cannot_lead(source: UrdfSource, leader: str) -> str:
    """Why joints cannot follow a leader wherever it goes; empty where they can, or none has to."""
    low, high = source.joint_limits.get(leader, (-math.inf, math.inf))
    for name, (first, multiplier, constant) in source.following().items():
        if first != leader or multiplier == 0.0:
            continue
        if not (1.0 / _LARGEST_RATIO <= abs(multiplier) <= _LARGEST_RATIO and abs(constant) <= MAX_LENGTH):
            return f"{name!r} has to <mimic> it {multiplier:g} times plus {constant:g}: neither gear nor lift does that"
        if leader in source.continuous and not (name in source.continuous and multiplier == round(multiplier)):
            how = f"{multiplier:g} times" if name in source.continuous else "within limits"
            return f"it is continuous, and {name!r}, which has to <mimic> it {how}, would not go around with it"
        if name in source.joint_limits:
            least, most = sorted((limit - constant) / multiplier for limit in source.joint_limits[name])
            low, high = max(low, least), min(high, most)
            if low > high:
                return f"{name!r}, which has to <mimic> it, is within its own limits nowhere"
    return ""


def _with_leaders(source: UrdfSource, locked: Mapping[str, float]) -> dict[str, float]:
    """Locked values, with those that the locked joints' leaders have to have.

    Raises:
        RobotError: there are none, or they are outside of the leader's limits.
    """
    found: dict[str, float] = {}
    for first in locked:
        name, value = first, locked[first]
        while name in source.followers and source.followers[name][0] not in locked:
            leader, multiplier, constant = source.followers[name]
            where = f"locked: joint {first!r} at {locked[first]:.6g} mimics {leader!r}, which"
            if multiplier == 0.0 or leader not in {*source.joint_limits, *source.continuous}:
                if abs(value - constant) > LIMIT_TOLERANCE:
                    raise RobotError(f"{where} holds it at {constant:.6g}")
                break
            name, value = leader, (value - constant) / multiplier
            if not within_limits(value, source, leader):
                low, high = source.joint_limits[leader]
                raise RobotError(f"{where} would be at {value:.6g}, outside of its limits [{low:.6g}, {high:.6g}]")
            if abs(found.setdefault(leader, value) - value) > LIMIT_TOLERANCE:
                raise RobotError(f"{where} would be at {value:.6g} for it, and at {found[leader]:.6g} for another")
    return {**found, **locked}


def _following(source: UrdfSource, planned: frozenset[str], locked: Mapping[str, float]) -> dict[str, Following]:
    """The joints that follow planned ones.

    Raises:
        RobotError: one of them is to be held still.
    """
    following = {name: f for name, f in source.following().items() if f.leader in planned and f.multiplier != 0.0}
    for name, follower in following.items():
        if name in locked:
            raise RobotError(
                f"locked: {name!r} follows {follower.leader!r}, which is planned: lock that one, or neither"
            )
    return following


def _with_followers(
    model: pin.Model, source: UrdfSource, following: Mapping[str, Following]
) -> tuple[pin.Model, UrdfSource]:
    """The model in which joints follow, and the description with the limits that they leave their leaders."""
    if not following:
        return model, source
    model, limits = with_followers(model, following), dict(source.joint_limits)
    for leader in {follower.leader for follower in following.values()} & set(limits):
        k = model.joints[model.getJointId(leader)].idx_q
        limits[leader] = float(model.lowerPositionLimit[k]), float(model.upperPositionLimit[k])
    return model, replace(source, joint_limits=limits)


def _compare_states(robot: str, semantics: Srdf | None, followers: Mapping[str, Following]) -> None:
    """Warn of states that have followers elsewhere than their leaders put them."""
    for state, values in ({} if semantics is None else semantics.states).items():
        for name, (leader, multiplier, constant) in followers.items():
            wanted = multiplier * values.get(leader, np.nan) + constant
            if name in values and abs(values[name] - wanted) > LIMIT_TOLERANCE:
                _log.warning("%s: state %r has %r at %.6g; it follows %r, which puts it at %.6g",
                             robot, state, name, values[name], leader, wanted)  # fmt: skip


def _still(
    source: UrdfSource, names: frozenset[str], locked: Mapping[str, float], home: Mapping[str, float]
) -> dict[str, float]:
    """Values of the joints that are held still: given ones, where those put what mimics them, and those of home."""

    def value(joint: str) -> float:
        if joint in locked:
            return locked[joint]
        if joint not in source.followers:
            return _clip(home.get(joint, 0.0), source, joint)
        leader, multiplier, offset = source.followers[joint]
        return _clip(multiplier * value(leader) + offset, source, joint)

    return {joint: value(joint) for joint in sorted(names - set(locked))} | dict(locked)


def _at_home(
    build: Callable[[Mapping[str, float]], RobotModel],
    still: Callable[[Mapping[str, float]], dict[str, float]],
    home: Mapping[str, float],
    semantics: Srdf | None,
    source: UrdfSource,
    resting: frozenset[str],
) -> RobotModel:
    """The robot with the first home posture in which it does not collide with itself, or one near the first of all."""
    first: RobotModel | None = None
    passed: list[str] = []
    made: dict[tuple[tuple[str, float], ...], RobotModel] = {}
    for what, values in _homes(home, semantics, source, resting):
        if not all(within_limits(value, source, joint) for joint, value in values.items()):
            passed.append(f"{what} is outside of the limits")
            continue
        held = tuple(sorted(still(values).items()))
        if held in made:  # only its home differs
            known = made[held].model
            q = reference_configuration(known, {j: v for j, v in values.items() if known.existJointName(j)})
            q.setflags(write=False)
            robot = replace(made[held], home_q=q)
        else:
            robot = made[held] = build(values)
        touching = robot.self_collision(robot.home_q)
        if touching is None:
            if passed:
                _log.warning("%s: %s; home is %s", robot.name, "; ".join(passed), what)
            return robot
        passed.append(f"in {what} {touching[0]!r} collides with {touching[1]!r}")
        first = first or robot
    assert first is not None
    free, touching = free_posture(first)
    if touching:
        _log.warning("%s: %s; home collides. No posture was found in which all links are apart: at best %s are in each "
                     "other", first.name, "; ".join(passed), touching)  # fmt: skip
        return first
    changed = np.flatnonzero(np.abs(first.space.to_coordinates(free) - first.space.to_coordinates(first.home_q)) > 1e-9)
    names = [first.joint_names[k - first.space.base_nv] for k in changed]
    _log.warning("%s: %s; home is that with other values of %s", first.name, "; ".join(passed), ", ".join(names))
    return replace(first, home_q=free)


def _homes(
    home: Mapping[str, float], semantics: Srdf | None, source: UrdfSource, resting: frozenset[str]
) -> Iterator[tuple[str, Mapping[str, float]]]:
    """Postures that may be home, with what to call them, the likeliest first."""
    states = {} if semantics is None else semantics.states
    if home and "home" not in states:
        yield "its own home posture", home
    movable = (set(source.joint_limits) | set(source.continuous)) - resting
    whole = [name for name in states if movable <= set(states[name])]
    likely = list(dict.fromkeys([name for name in _HOMES if name in states] + whole))
    for name in likely:
        yield f"state {name!r}", {**home, **states[name]}
    yield "the neutral posture", {}
    for name in states:
        if name not in likely:
            yield f"state {name!r}", {**home, **states[name]}


def _wheels(model: pin.Model, source: UrdfSource) -> set[str]:
    """Continuous joints that are called wheel or caster, or are those of a base that moves by what hangs on them.

    A wheel turns about a level axis, hangs on the root link by fixed joints, and carries nothing that moves. A caster
    turns about an upright one and carries nothing but wheels, no higher than the others; without others there are
    two of them at least. So an arm's own first joint is neither, nor is the head that pans and tilts.
    """
    named = {j for j in source.continuous if any(word in j.lower() for word in ("wheel", "caster", "castor"))}
    if model.njoints < 2 or model.joints[1].shortname() != "JointModelPlanar":
        return named
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    upright = {i: abs(float(data.J[5, model.joints[i].idx_v])) for i in range(2, model.njoints)}  # z of its axis
    height = [float(pose.translation[2]) for pose in data.oMi]
    turning = {i for i in upright if model.names[i] in source.continuous}

    def carried(i: int) -> list[int]:
        return [k for k in model.subtrees[i] if k != i and model.names[k] not in source.mimic]

    rolling = {i for i in turning if upright[i] < _LEVEL and not carried(i)}
    wheels = {i for i in rolling if model.parents[i] == 1}
    casters = {
        i for i in turning
        if model.parents[i] == 1 and upright[i] > 1.0 - _LEVEL and carried(i) and rolling.issuperset(carried(i))
    }  # fmt: skip
    top = max((height[i] for i in wheels), default=float("inf") if len(casters) > 1 else -float("inf"))
    for i in casters:
        if max(height[k] for k in carried(i)) <= top + _LEVEL:
            wheels |= {i, *carried(i)}
    return named | {model.names[i] for i in wheels}


def _round_wheels(model: pin.Model, collision: pin.GeometryModel, wheels: Iterable[str]) -> frozenset[str]:
    """The joints whose collision shapes are bodies of revolution about their axes, within 3 mm."""
    round_, elevation = set(), np.linspace(-1.2, 1.2, 7)[:, None]
    turn = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    for name in wheels:
        i = model.getJointId(name)
        if model.joints[i].nv != 1 or len(model.subtrees[i]) > 1:  # what swivels carries its wheel about
            continue
        axis = np.asarray(model.joints[i].createData().S).ravel()[3:]
        side = np.linalg.svd(axis[None])[2][1:]
        flat = np.cos(turn)[:, None] * side[0] + np.sin(turn)[:, None] * side[1]
        directions = np.cos(elevation)[..., None] * flat + np.sin(elevation)[..., None] * axis
        shapes = [obj for obj in collision.geometryObjects if obj.parentJoint == i]
        if all(
            np.ptp(_extent(shape, directions.reshape(-1, 3)).reshape(directions.shape[:2]), axis=1).max() <= _ROUND
            for shape in shapes
        ):
            round_.add(name)
    return frozenset(round_)


def _extent(shape: pin.GeometryObject, directions: Array) -> Array:
    """How far a shape extends along directions (K, 3) from its joint [m]."""
    local = directions @ shape.placement.rotation
    if shape_of(shape.geometry)[0] is ShapeKind.MESH and not len(vertices(shape.geometry)):
        return np.zeros(len(directions))
    few = np.array_split(local, len(local) // 8)  # a mesh of a million corners has as many numbers for each direction
    return np.concatenate([support(shape.geometry, d) for d in few]) + directions @ shape.placement.translation


def _check_shapes(collision: pin.GeometryModel, source: UrdfSource) -> None:
    """Every collision shape of the file arrived (urdfdom drops what it cannot parse), with finite vertices."""
    names = {shape.name for shape in collision.geometryObjects}
    for link, count in source.collisions.items():
        missing = [k for k in range(count) if f"{link}_{k}" not in names]
        if missing:
            raise RobotError(
                f"link {link!r}: Pinocchio did not read <collision> {missing[0]}; look for an element of it that is "
                "not strict URDF (numbers, <inertial> without <inertia>, <material> without a name, …)"
            )
    for shape in collision.geometryObjects:
        if shape_of(shape.geometry)[0] is ShapeKind.MESH:
            what, points = f"collision mesh {shape.meshPath} of {shape.name!r}", vertices(shape.geometry)
            if not np.isfinite(points).all():
                raise RobotError(f"{what} has vertices that are not finite")
            if np.abs(points).max(initial=0.0) > MAX_LENGTH:
                raise RobotError(f"{what} reaches beyond {MAX_LENGTH:g} m")
            if len(points):
                _check_size(shape, points)


def _visual(source: UrdfSource, model: pin.Model) -> pin.GeometryModel:
    """The visual geometry of a file."""
    geometry = pinocchio_geometry(source, model, pin.VISUAL)
    for shape in geometry.geometryObjects:
        if shape_of(shape.geometry)[0] is ShapeKind.MESH:
            _check_size(shape, vertices(shape.geometry))
    return geometry


def _check_size(shape: pin.GeometryObject, points: Array) -> None:
    """Warn of a mesh that was meant in millimetres."""
    size = np.ptp(points, axis=0)
    if size.max() > _LARGE:
        x, y, z = (f"{length:.3g}" for length in size)
        _log.warning(
            'mesh %s of link %r is %s x %s x %s m large; if its file is in millimetres, give <mesh scale="0.001 0.001 '
            '0.001">', shape.meshPath, shape.name.rsplit("_", 1)[0], x, y, z,
        )  # fmt: skip


def _all(names: tuple[str, ...], most: int = 4) -> str:
    return ", ".join(map(repr, names[:most])) + (f" and {len(names) - most} more" if len(names) > most else "")


def _drawn(source: UrdfSource, model: pin.Model) -> pin.GeometryModel | None:
    """Visual geometry of the links that have no collision shape; None where it cannot be read."""
    try:
        return pinocchio_geometry(source, model, pin.VISUAL, only=source.bare)
    except RobotError as error:
        _log.warning("%s", error)
        return None


def _bare(source: UrdfSource, robot: RobotModel, drawn: pin.GeometryModel | None) -> tuple[str, ...]:
    """The links that are drawn and not covered: of what cannot be read nobody knows that it is."""
    if drawn is None:
        return source.bare
    return tuple(link for link in source.bare if link in robot.bare_links or link in source.undrawn)


def _thicken(collision: pin.GeometryModel, source: UrdfSource) -> None:
    """What is drawn may be a sheet, which has no hull: as a collision shape it is the box about it, 0.1 mm thick."""
    for shape in collision.geometryObjects:
        if shape.name.rsplit("_", 1)[0] in source.from_visual and shape_of(shape.geometry)[0] is ShapeKind.MESH:
            points = vertices(shape.geometry)
            if not len(points) or not np.isfinite(points).all():
                continue  # which is refused
            thin = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1]
            if np.ptp(points @ thin) < _SHEET:
                half = np.maximum(0.5 * np.ptp(points, axis=0), 0.5 * _SHEET)
                middle = 0.5 * (points.max(axis=0) + points.min(axis=0))
                shape.geometry = convex_from_vertices(middle + SIGNS * half, name=shape.name)


def _say_what_grew(robot: RobotModel, links: tuple[str, ...]) -> None:
    """Warn of the pieces of some links that reach far out of the shapes that they stand for."""
    assert robot.shapes is not None
    for piece in robot.geometries if links else ():
        far = sticks_out(robot.model, robot.shapes, piece) if set(piece.links) & set(links) else 0.0
        if far > _GROWN:
            _log.warning("%s: the convex piece %r of what is drawn reaches %.0f mm out of it, so more is refused than "
                         "need be", robot.name, piece.name, 1e3 * far)  # fmt: skip


def _say_what_differs(source: UrdfSource, model: pin.Model, name: str) -> None:
    """Warn of what another reader finds otherwise in the file."""
    found = differences(source, model)
    if found:
        more = f"; and {len(found) - 6} more" if len(found) > 6 else ""
        _log.warning("%s: yourdfpy reads the file otherwise: %s%s", name, "; ".join(found[:6]), more)


def _what_to_lock(robot: RobotModel) -> str:
    """Which of a robot's many joints may rather be held still."""
    names, model = robot.joint_names, robot.model
    ends = [name for name in names if any(word in name.lower() for word in _SELDOM_PLANNED)]
    if not ends:  # what branches off several times from one body at the end of a chain, as fingers do
        first = model.njoints - len(names)
        leaves = {i: [k for k in model.subtrees[i] if k != i] for i in range(first, model.njoints)}
        chains = [i for i, inner in leaves.items() if len(inner) <= 3 and all(len(leaves[k]) <= 3 for k in inner)]
        parents = Counter(model.parents[i] for i in chains if model.parents[i] not in chains)
        roots = [i for i in chains if parents.get(model.parents[i], 0) >= 3 and model.parents[i] >= first]
        ends = [model.names[k] for i in roots for k in (i, *leaves[i])]
    said = f"Name those to plan with joints=[…]{' or group=…' if robot.groups else ''}, or hold some still: "
    if ends:
        return f"{said}locked={{{', '.join(f'{name!r}: {0.0:g}' for name in ends[:12])}{', …' * (len(ends) > 12)}}}"
    if robot.groups:
        return f"{said}the SRDF's groups are {_all(tuple(robot.groups), 12)}"
    return f"{said}locked={{…}}, of {_all(names, 40)}"


def _why_held(
    source: UrdfSource, still: Mapping[str, float], locked: Mapping[str, float], wheels: set[str],
    planned: frozenset[str] | None,
) -> dict[str, str]:  # fmt: skip
    """Why each joint that is held still is."""

    def why(joint: str) -> str:
        if joint in locked:
            return "locked by who loads it"
        if joint in wheels:
            return "a wheel or a caster"
        if joint in source.followers:
            return f"mimics {source.followers[joint][0]}"
        if joint in source.mimic:
            return "mimics a joint that is not there"
        if followers := [name for name, follower in source.following().items() if follower.leader == joint]:
            return f"mimicked by {', '.join(followers)}"
        return "not among the joints to plan" if planned is not None else "held still"

    return {joint: why(joint) for joint in still}


def _clip(value: float, source: UrdfSource, joint: str) -> float:
    low, high = source.joint_limits.get(joint, (-float("inf"), float("inf")))
    return min(max(value, low), high)
