"""load_robot: a robot by name or from a URDF file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from ..errors import RobotError, nearest_name
from ..resources import urdf_dir
from .base import BaseKind
from .model import RobotModel, model_from_urdf
from .srdf import Srdf, read_srdf
from .urdf import UrdfSource, read_urdf
from .urdf_geometry import MAX_LENGTH


@dataclass(frozen=True, slots=True)
class KnownRobot:
    """A robot that can be loaded by its name; ``own`` names its files in ``urdf/`` if they come with the package."""

    summary: str
    base: BaseKind
    planned: tuple[str, ...] | None
    home: Mapping[str, float]
    hand_frame: str | None
    own: str | None = None

    def files(self, name: str) -> tuple[Path, Path | None, tuple[Path, ...]]:
        """URDF, SRDF and package folders."""
        if self.own is not None:
            folder = urdf_dir()
            srdf = folder / f"{self.own}.srdf"
            return folder / f"{self.own}.urdf", srdf if srdf.is_file() else None, (folder,)
        share = _example_robot_data()
        return share / "example-robot-data/robots/tiago_description/robots/tiago.urdf", None, (share,)


_TIAGO_HOME = {
    "torso_lift_joint": 0.15, "arm_1_joint": 0.2, "arm_2_joint": -1.34, "arm_3_joint": -0.2,
    "arm_4_joint": 1.94, "arm_5_joint": -1.57, "arm_6_joint": 0.6, "arm_7_joint": 0.0,
}  # fmt: skip

_KNOWN = {
    "silvermate": KnownRobot(
        "the paper's robot: round differential-drive base, 7-DOF arm",
        BaseKind.DIFF_DRIVE, None, {}, "hand_frame", "silvermate",
    ),
    "tiago": KnownRobot(
        "PAL Robotics' TIAGo of example-robot-data: differential drive, lift, 7-DOF arm",
        BaseKind.DIFF_DRIVE, tuple(_TIAGO_HOME), _TIAGO_HOME, "hand_palm_link",
    ),
    "jackal-box": KnownRobot(
        "a Jackal-sized box on two wheels, 0.508 x 0.43 m, no arm: differential drive",
        BaseKind.DIFF_DRIVE, None, {}, None, "jackal_box",
    ),
    "bridge-arm": KnownRobot(
        "a box on two wheels, 0.5 x 0.5 m, with a 6-DOF arm of the UR5's proportions: differential drive",
        BaseKind.DIFF_DRIVE, None, {}, "tool_frame", "bridge_arm",
    ),
}  # fmt: skip


def robot_names() -> tuple[str, ...]:
    """Names that :func:`load_robot` knows."""
    return tuple(_KNOWN)


def robot_summary(name: str) -> str:
    """One line about a named robot."""
    return _KNOWN[name].summary


def load_robot(
    name_or_path: str | Path,
    *,
    base: str | BaseKind | None = None,
    srdf: str | Path | None = None,
    control_points: Mapping[str, str | tuple[str, npt.ArrayLike]] | None = None,
    locked: Mapping[str, float] | None = None,
    package_dirs: tuple[str | Path, ...] = (),
) -> RobotModel:
    """Load a robot by name (``"silvermate"``, ``"tiago"``, ``"jackal-box"``, ``"bridge-arm"``) or from a URDF file.

    Args:
        name_or_path: a name, or a path that ends in ``.urdf`` or holds a separator.
        base: ``"diff_drive"``, ``"omni"`` or ``"fixed"``; by default the named robot's own, and ``"diff_drive"`` for
            a file.
        srdf: SRDF file with the link pairs to ignore and, as ``group_state`` named ``home``, the home posture.
        control_points: name → frame, or name → (frame, offset [m]); by default the joints' origins and the hand.
        locked: joint → value held still; by default the wheels (continuous joints named ``*wheel*`` or ``*caster*``)
            and mimic joints of a file, and what is neither lift nor arm of TIAGo. ``{}`` locks only what cannot be
            planned.
        package_dirs: folders to search for ``package://`` meshes.

    Raises:
        RobotError: unknown name, or a fault in a file; the message names file, element and alternatives.
    """
    text = str(name_or_path)
    if text in _KNOWN:
        return _load_named(text, base, srdf, control_points, locked, package_dirs)
    path = Path(text).expanduser()
    if not text or (path.suffix.lower() not in (".urdf", ".xml") and "/" not in text and not os.path.exists(path)):
        raise RobotError(f"unknown robot {text!r}{nearest_name(text, _KNOWN)} Or give the path of a URDF file.")
    kind = BaseKind.DIFF_DRIVE if base is None else BaseKind.parse(base)
    source = read_urdf(path, package_dirs=package_dirs)
    return _build(source, kind, srdf, control_points, locked, home={}, hand=None, name=path.stem)


def _load_named(
    name: str,
    base: str | BaseKind | None,
    srdf: str | Path | None,
    control_points: Mapping[str, str | tuple[str, npt.ArrayLike]] | None,
    locked: Mapping[str, float] | None,
    package_dirs: tuple[str | Path, ...],
) -> RobotModel:
    known = _KNOWN[name]
    urdf, own_srdf, folders = known.files(name)
    kind = known.base if base is None else BaseKind.parse(base)
    source = read_urdf(urdf, package_dirs=(*package_dirs, *folders))
    if locked is None and known.planned is not None:
        moving = _moving_joints(source)
        locked = {j: _clip(0.0, source, j) for j in sorted(moving - set(known.planned))}
    return _build(
        source, kind, srdf or own_srdf, control_points, locked, home=known.home, hand=known.hand_frame, name=name
    )


def _build(
    source: UrdfSource,
    kind: BaseKind,
    srdf: str | Path | None,
    control_points: Mapping[str, str | tuple[str, npt.ArrayLike]] | None,
    locked: Mapping[str, float] | None,
    *,
    home: Mapping[str, float],
    hand: str | None,
    name: str,
) -> RobotModel:
    semantics = None
    if srdf is not None:
        semantics = read_srdf(srdf, links=set(source.links), joints=set(source.joints))
        _check_states(semantics, source)
        home = {**home, **semantics.states.get("home", {})}
    try:
        model, collision, visual = model_from_urdf(source.path, kind, source.package_dirs)
        _check_shapes(collision, source)
        return _planned(model, collision, visual, source, kind, semantics, control_points, locked, home, hand, name)
    except (ValueError, RuntimeError, IndexError) as error:  # a RobotError, or what Pinocchio and Coal throw
        said = " ".join(str(error).split())
        raise RobotError(said if str(source.path) in said else f"{source.path}: {said}") from None


def _planned(
    model: pin.Model, collision: pin.GeometryModel, visual: pin.GeometryModel, source: UrdfSource, kind: BaseKind,
    semantics: Srdf | None, control_points: Mapping[str, str | tuple[str, npt.ArrayLike]] | None,
    locked: Mapping[str, float] | None, home: Mapping[str, float], hand: str | None, name: str,
) -> RobotModel:  # fmt: skip
    if locked is None:
        wheels = {j for j in source.continuous if "wheel" in j.lower() or "caster" in j.lower()}
        locked = {
            j: home.get(j, _clip(0.0, source, j)) for j in sorted(wheels | source.mimic) if model.existJointName(j)
        }
    home = {j: v for j, v in home.items() if j not in locked and model.existJointName(j)}
    return RobotModel.from_pinocchio(
        model, collision, visual,
        base=kind, name=name, locked=locked, home=home,
        disabled_pairs=None if semantics is None else semantics.disabled,
        control_points=control_points, hand_frame=hand,
        urdf_path=str(source.path), srdf_path=None if semantics is None else str(semantics.path),
    )  # fmt: skip


def _check_states(semantics: Srdf, source: UrdfSource) -> None:
    for state, values in semantics.states.items():
        for joint, value in values.items():
            low, high = source.joint_limits.get(joint, (-float("inf"), float("inf")))
            if not low - 1e-9 <= value <= high + 1e-9:
                raise RobotError(
                    f"{semantics.path}: <group_state> {state!r}: joint {joint!r} = {value:g} is outside its limits "
                    f"[{low:g}, {high:g}]"
                )


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
        if isinstance(shape.geometry, coal.BVHModelBase):
            what, vertices = f"collision mesh {shape.meshPath} of {shape.name!r}", shape.geometry.vertices()
            if not np.isfinite(vertices).all():
                raise RobotError(f"{what} has vertices that are not finite")
            if np.abs(vertices).max(initial=0.0) > MAX_LENGTH:
                raise RobotError(f"{what} reaches beyond {MAX_LENGTH:g} m")


def _moving_joints(source: UrdfSource) -> set[str]:
    return set(source.joint_limits) | set(source.continuous)


def _clip(value: float, source: UrdfSource, joint: str) -> float:
    low, high = source.joint_limits.get(joint, (-float("inf"), float("inf")))
    return min(max(value, low), high)


@cache
def _example_robot_data() -> Path:
    """The ``share`` folder that holds example-robot-data.

    Raises:
        RobotError: the package is not installed.
    """
    import sys

    import cmeel

    places = [Path(p) / "cmeel.prefix/share" for p in (*cmeel.__path__, *sys.path)]
    places += [Path(p).parent / "cmeel.prefix/share" for p in cmeel.__path__]
    for place in places:
        if (place / "example-robot-data/robots").is_dir():
            return place
    raise RobotError("the package example-robot-data is not installed: pip install example-robot-data")
