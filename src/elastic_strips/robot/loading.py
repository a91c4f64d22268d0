"""load_robot: a robot by name or from a URDF file."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypedDict

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.catalogue import KnownRobot, find_robot, is_known, is_ours
from elastic_strips.coal_shapes import ShapeKind, shape_of, vertices
from elastic_strips.errors import RobotError, listed, plural
from elastic_strips.validation import MAX_LENGTH, named_arguments

from .blocked_joints import blocked_joints
from .collada import meant_turned, said_of_turned
from .free_posture import free_posture
from .holes import bare_links, drawn_alone, say_what_grew, thicken
from .looking import swept
from .model import RobotModel
from .planned_joints import (
    compare_states,
    following_planned,
    held_still,
    planned_joints,
    quoted,
    resting_joints,
    what_to_lock,
    why_held,
    with_leaders,
    with_their_limits,
)
from .reduced import check_joint_names, reference_configuration
from .second_reader import differences
from .space import LIMIT_TOLERANCE, BaseKind
from .srdf import Srdf, read_srdf, within_limits
from .urdf import UrdfSource, pinocchio_geometry, pinocchio_model, read_urdf
from .wheels import round_wheels, wheel_joints
from .xacro_file import expand_xacro

_log = logging.getLogger(__name__)
_MOST_TURNED, _MOST_DEGREES = 4.0 * np.pi, 720.0  # a joint that turns further, and no further, may have degrees
_MANY_JOINTS = 20  # more planned joints than these are warned about
# No part of a robot is longer [m]; in a mesh of millimetres that is read as metres, one of 2 cm is.
_LARGEST_MESH = 20.0
_HOMES = ("home", "default", "half_sitting", "standing")


class LoadOptions(TypedDict, total=False):
    """Options of a robot besides its name and its base: the arguments of ``load_robot`` of these names."""

    joints: Iterable[str]
    group: str
    locked: Mapping[str, float]
    srdf: str | Path
    package_dirs: tuple[str | Path, ...]
    mappings: Mapping[str, str]
    visual_as_collision: Collection[str] | str
    looking: Iterable[str]


@named_arguments
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
    looking: Iterable[str] = (),
) -> RobotModel:
    """Load a robot by name (``"silvermate"``, ``"tiago"``, ``"panda"``, …: ``robot_names()``) or from a URDF file.

    A xacro file (``.xacro``; extra ``ros``) is expanded first. xacro evaluates expressions: open files you trust.

    Harmless faults of a file are mended or ignored, with a warning in the log: see ``docs/robots.md``.

    Args:
        name_or_path: a name, or a path that ends in ``.urdf`` or ``.xacro``, or holds a separator.
        base: ``"diff_drive"``, ``"omni"`` or ``"fixed"``; by default the named robot's own, and ``"diff_drive"`` for
            a file.
        srdf: SRDF file with the link pairs to ignore, named postures (``group_state``: see ``RobotModel.home`` and
            ``RobotModel.state``) and groups of joints; by default the named robot's own.
        control_points: name → frame, or name → (frame, offset [m]); by default the joints' origins and the hand.
        joints: the joints to plan; all others are held still at home, except those that mimic a planned one: they
            follow it (``RobotModel.followers``), and their limits are its limits, too.
        group: an SRDF group whose joints are planned, instead of ``joints``.
        locked: joint → value [rad or m] held still, besides the joints that are held anyway: those that ``joints`` or
            ``group`` does not name. Without these: wheels, casters, joints that others mimic unless they carry more
            than those (a lift is planned, a gripper held), and whatever is neither lift nor arm of TIAGo. Joints that
            mimic a locked one are held where that puts them, and the joint that a locked one mimics is held where that
            puts it, unless they are given a value here.
        package_dirs: folders to search for ``package://`` meshes and for a xacro file's ``$(find …)``.
        mappings: arguments of a xacro file, by name.
        visual_as_collision: links whose visual shapes are taken as their collision shapes, meshes as convex hulls; or
            ``"missing"``: all links that are drawn and have no collision shape. Otherwise nothing is proven about
            these.
        looking: joints with limits, as of a head's pan and tilt, that may turn at any time and are not planned. What
            hangs on them is as large as the space that it passes through, so that proofs hold wherever it looks; where
            it does, ``RobotModel.seeing`` is the robot for its sensors.

    Raises:
        RobotError: an unknown name, or a name that several robots share; an unknown joint or group; a joint that looks
            and is planned, or carries another one that does not look; a joint that is
            planned and locked, or locked though it follows a planned one; a fault in a file. The message names
            file, element and alternatives; of a xacro file it names the expanded file.
        MissingExtraError: the file is a xacro file, and xacro is not installed.

    Examples:
        >>> robot = es.load_robot("silvermate")  # or es.load_robot("my_robot.urdf", base="diff_drive")
        >>> robot.name, robot.base_kind.value, len(robot.joint_names)
        ('silvermate', 'diff_drive', 7)
    """
    known = _found(name_or_path, mappings, package_dirs)
    source = read_urdf(
        known.urdf, package_dirs=(*package_dirs, *known.package_dirs), visual_as_collision=visual_as_collision
    )
    if mappings and (is_known(str(name_or_path)) or not _is_xacro(name_or_path)):
        raise RobotError(f"mappings={dict(mappings)!r} are arguments of a xacro file; {str(name_or_path)!r} is none")
    kind = BaseKind.parse(known.base if base is None else base)
    semantics = None if (file := srdf or known.srdf) is None else read_srdf(file, source)
    if srdf is not None and semantics is not None:
        _say_whose(semantics, source)
    locked = locked or {}
    if joints is None and group is None and known.planned is not None:
        joints = [joint for joint in known.planned if joint not in locked]
    planned = planned_joints(source, semantics, joints, group, locked)
    eyes = tuple(dict.fromkeys((looking,) if isinstance(looking, str) else looking))
    try:
        made = _made(known, kind, source, semantics, planned, locked, control_points, eyes)
    except (ValueError, RuntimeError, IndexError) as error:  # a RobotError, or what Pinocchio and Coal throw
        said = " ".join(str(error).split())
        raise RobotError(said if str(source.path) in said else f"{source.path}: {said}") from None
    robot = made.robot
    _say_who_is_elsewhere(source, robot, locked)
    compare_states(robot.name, semantics, robot.followers)
    _say_what_is_remarkable(robot)
    if made.turned:
        _log.warning("%s: %s", robot.name, said_of_turned(made.turned))
    say_what_grew(robot, source.from_visual)
    if not is_ours(source.path):  # those are compared by the tests
        _say_what_differs(source, made.described, robot.name)
    return robot


def _say_whose(semantics: Srdf, source: UrdfSource) -> None:
    """Warn of an SRDF file that is another robot's."""
    if semantics.name not in ("", source.name):
        _log.warning(
            "%s is written for a robot that is called %.60r; this one is called %.60r: the pairs that it leaves out "
            "may be another robot's",
            semantics.path,
            semantics.name,
            source.name,
        )


def _say_what_is_remarkable(robot: RobotModel) -> None:
    """Warn of joints planned in a narrower range, of many joints, and of links about which nothing is proven."""
    for joint, span in robot.narrowed.items():
        _log.warning(
            "%s: joint %s is %s. Where that is meant, an SRDF says so (disable_collisions of the two)",
            robot.name,
            joint,
            span,
        )
    for joint, low, high in _turning(robot):
        if _MOST_TURNED < max(-low, high) <= _MOST_DEGREES:
            _log.warning(
                "%s: joint %s may turn from %g to %g rad, which is %.0f times around: are its limits in degrees?",
                robot.name,
                joint,
                low,
                high,
                (high - low) / (2.0 * np.pi),
            )
    for blocked in blocked_joints(robot):
        _log.warning(
            "%s: joint %s is %s. Where the two may touch, an SRDF says so (disable_collisions of the two)",
            robot.name,
            blocked.joint,
            blocked,
        )
    if len(robot.joint_names) > _MANY_JOINTS:
        _log.warning(
            "%s plans %d joints, which is many: planning and deforming will be slow. %s",
            robot.name,
            len(robot.joint_names),
            what_to_lock(robot),
        )
    if robot.bare_links:
        _log.warning(
            "%s: %s drawn without a collision shape, about which nothing is proven: %s. "
            'visual_as_collision="missing" (--visual-as-collision missing) takes the drawn shapes',
            robot.name,
            plural(len(robot.bare_links), "link"),
            quoted(robot.bare_links, 40),
        )


def _turning(robot: RobotModel) -> Iterator[tuple[str, float, float]]:
    """The planned joints that turn within limits, with these [rad]."""
    for column, joint in enumerate(robot.joint_names, robot.space.base_nv):
        if robot.model.joints[robot.model.getJointId(joint)].shortname().startswith("JointModelR"):
            yield joint, float(robot.space.lower[column]), float(robot.space.upper[column])


def _is_xacro(name_or_path: str | Path) -> bool:
    return Path(name_or_path).suffix.lower() == ".xacro"


def _found(
    name_or_path: str | Path, mappings: Mapping[str, str] | None, package_dirs: tuple[str | Path, ...]
) -> KnownRobot:
    """A robot of the catalogue; or what is known of one by its file alone, of which xacro is expanded."""
    text = str(name_or_path)
    path = Path(text).expanduser()
    by_path = path.suffix.lower() in (".urdf", ".xml", ".xacro") or "/" in text or os.path.exists(path)
    if is_known(text) or not text or not by_path:
        return find_robot(text)
    urdf = expand_xacro(path, mappings, package_dirs) if _is_xacro(path) else path
    return KnownRobot(path.stem.removesuffix(".urdf"), "", BaseKind.DIFF_DRIVE, urdf)


@dataclass(frozen=True, slots=True)
class _Made:
    """A robot, the links whose meshes may have been meant turned, and the model as the file describes it."""

    robot: RobotModel
    turned: tuple[str, ...]
    described: pin.Model


def _made(
    known: KnownRobot,
    kind: BaseKind,
    source: UrdfSource,
    semantics: Srdf | None,
    told: frozenset[str] | None,
    locked: Mapping[str, float],
    control_points: Mapping[str, str | tuple[str, ArrayLike]] | None,
    looking: tuple[str, ...] = (),
) -> _Made:
    """The robot of a description; ``told`` are the joints to plan, None all that do not rest."""
    model = described = pinocchio_model(source, planar=kind.planar)
    check_joint_names(model, locked, "locked")
    wheels, resting = wheel_joints(model, source), resting_joints(model, source)
    names, held = frozenset(model.names[1:]) - {"root_joint"}, with_leaders(source, locked)
    check_joint_names(model, dict.fromkeys(looking, 0.0), "looking")
    if both := sorted(set(looking) & (told or frozenset())):
        raise RobotError(f"joints that are to be planned and to look: {', '.join(both)}; name each in one of the two")
    planned = (names - resting - set(held) if told is None else told) - set(looking)
    following = following_planned(source, planned, locked)
    unplanned = names - planned - set(following)
    model, source = with_their_limits(model, source, following)
    collision, turned = _collision(source, model)
    whole, collision = collision, swept(model, collision, looking) if looking else collision
    drawn = drawn_alone(source, model)
    rolling = round_wheels(model, collision, resting & source.continuous)
    still = partial(held_still, source, unplanned, held)

    def build(home: Mapping[str, float], looks: bool = False) -> RobotModel:
        values = still(home)
        home = {**home, **{j: values.pop(j) for j in looking if looks}}
        return RobotModel.from_pinocchio(
            model,
            whole if looks else collision,
            partial(_visual, source, model),
            base=kind,
            name=known.name,
            locked=values,
            home={j: v for j, v in home.items() if j in planned or j not in values},
            disabled_pairs=semantics.disabled if semantics is not None and semantics.disabled else None,
            enabled_pairs=() if semantics is None else semantics.enabled,
            followers=source.following(),
            control_points=control_points,
            hand_frame=known.hand_frame,
            states=None if semantics is None else semantics.states,
            urdf_path=str(source.path),
            srdf_path=None if semantics is None else str(semantics.path),
            held=why_held(source, values, locked, wheels, told),
            groups=None if semantics is None else semantics.groups,
            drawn=drawn,
            description=source,
            round_wheels=rolling,
        )

    robot = _at_home(build, still, known.home, semantics, source, resting)
    if looking:
        home = dict(
            zip(
                robot.joint_names, robot.space.to_coordinates(robot.home_q)[robot.space.base_nv :].tolist(), strict=True
            )
        )
        held = {**robot.held, **dict.fromkeys(looking, "it looks about")}
        robot = replace(robot, looking=looking, eyes=build(home, looks=True), held=held)
    return _Made(replace(robot, bare_links=bare_links(source, robot, drawn)), turned, described)


def _collision(source: UrdfSource, model: pin.Model) -> tuple[pin.GeometryModel, tuple[str, ...]]:
    """The collision geometry of a file, and the links whose meshes may have been meant turned."""
    collision = pinocchio_geometry(source, model, pin.COLLISION)
    turned = meant_turned(source.document, model, collision)
    thicken(collision, source)
    _check_shapes(collision, source)
    return collision, turned


def _say_who_is_elsewhere(source: UrdfSource, robot: RobotModel, locked: Mapping[str, float]) -> None:
    """Warn of joints that mimic another one and are held elsewhere than that puts them."""
    for joint, (leader, multiplier, offset) in source.followers.items():
        wanted = multiplier * robot.locked.get(leader, 0.0) + offset
        if abs(robot.locked.get(joint, wanted) - wanted) > LIMIT_TOLERANCE:
            why = "; it is locked" if joint in locked else ", outside its limits; it is held"
            _log.warning(
                "%s: joint %r mimics %r, which puts it at %.6g%s at %.6g",
                robot.name,
                joint,
                leader,
                wanted,
                why,
                robot.locked[joint],
            )


def _at_home(
    build: Callable[[Mapping[str, float]], RobotModel],
    still: Callable[[Mapping[str, float]], dict[str, float]],
    home: Mapping[str, float],
    semantics: Srdf | None,
    source: UrdfSource,
    resting: frozenset[str],
) -> RobotModel:
    """The robot with the first home posture in which it does not collide with itself, or one near the very first."""
    first: RobotModel | None = None
    passed: list[str] = []
    made: dict[tuple[tuple[str, float], ...], RobotModel] = {}
    for what, values in _homes(home, semantics, source, resting):
        if not all(within_limits(value, source, joint) for joint, value in values.items()):
            passed.append(f"{what} is outside the limits")
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
        _log.warning(
            "%s: %s; home collides. No posture was found in which all links are apart: at best %s are in each other",
            first.name,
            "; ".join(passed),
            touching,
        )
        return first
    changed = np.flatnonzero(np.abs(first.space.to_coordinates(free) - first.space.to_coordinates(first.home_q)) > 1e-9)
    names = [first.joint_names[k - first.space.base_nv] for k in changed]
    _log.warning("%s: %s; home is that with other values of %s", first.name, "; ".join(passed), ", ".join(names))
    return replace(first, home_q=free)


def _homes(
    home: Mapping[str, float], semantics: Srdf | None, source: UrdfSource, resting: frozenset[str]
) -> Iterator[tuple[str, Mapping[str, float]]]:
    """Postures that may be home and their names, the likeliest first."""
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
    """Warn about a mesh that was meant in millimetres."""
    size = np.ptp(points, axis=0)
    if size.max() > _LARGEST_MESH:
        x, y, z = (f"{length:.3g}" for length in size)
        _log.warning(
            'mesh %s of link %r is %s x %s x %s m large; if its file is in millimetres, give <mesh scale="0.001 0.001 '
            '0.001">',
            shape.meshPath,
            shape.name.rsplit("_", 1)[0],
            x,
            y,
            z,
        )


def _say_what_differs(source: UrdfSource, model: pin.Model, name: str) -> None:
    """Warn about what another reader reads differently in the file."""
    found = differences(source, model)
    if found:
        _log.warning("%s: yourdfpy reads the file differently: %s", name, listed(found, 6, between="; "))
