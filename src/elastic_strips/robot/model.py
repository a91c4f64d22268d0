"""RobotModel: the frozen value that every other room plans with."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from ..errors import ConfigurationError, RobotError, nearest_name
from .base import BaseKind
from .control_points import ControlPoints, default_control_points, find_frame, parse_control_points
from .geometry import LinkGeometry, link_geometries
from .kinematics import KinematicTree
from .self_pairs import self_pairs
from .space import Array, ConfigurationSpace


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A robot ready for planning: locked joints are gone, every collision shape is convex.

    Attributes:
        name: the robot's name.
        base_kind: how the root moves.
        model: planned Pinocchio model; joint 1 is a ``JointModelPlanar`` unless the base is fixed.
        collision_model: convex collision geometry with the self-collision pairs to check.
        visual_model: visual geometry.
        space: configuration space (charts, difference, integrate, interpolate).
        tree: the model's joints as arrays.
        geometries: the convex pieces, in the order of ``collision_model.geometryObjects``.
        self_pairs: (S, 2) index pairs of ``geometries`` that must not touch.
        control_point_set: the control points.
        home_q: (nq,) posture at the origin.
        locked: values of the joints that planning holds still [rad or m].
        urdf_path, srdf_path: files, where there are any.
    """

    name: str
    base_kind: BaseKind
    model: pin.Model
    collision_model: pin.GeometryModel
    visual_model: pin.GeometryModel
    space: ConfigurationSpace
    tree: KinematicTree
    geometries: tuple[LinkGeometry, ...]
    self_pairs: npt.NDArray[np.intp]
    control_point_set: ControlPoints
    home_q: Array
    locked: Mapping[str, float] = field(default_factory=dict)
    urdf_path: str | None = None
    srdf_path: str | None = None

    @property
    def nq(self) -> int:
        return self.space.nq

    @property
    def nv(self) -> int:
        return self.space.nv

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Planned joints without the root."""
        return tuple(self.model.names[i] for i in range(2 if self.space.planar else 1, self.model.njoints))

    @property
    def control_point_names(self) -> tuple[str, ...]:
        return self.control_point_set.names

    def home(
        self,
        x: float = 0.0,
        y: float = 0.0,
        yaw: float = 0.0,
        joints: Mapping[str, float] | None = None,
        **more: float,
    ) -> Array:
        """The home posture at a base pose, with single joints overridden: a configuration (nq,).

        Args:
            x, y, yaw: base pose [m, m, rad]; must be 0 for a fixed base.
            joints: joint name → value [rad or m].
            **more: further joints by name; one called ``x``, ``y`` or ``yaw`` is set through ``joints``.

        Raises:
            ConfigurationError: an unknown joint, a value that is not finite or outside its limits.
        """
        chart = self.space.to_chart(self.home_q)
        if joints is not None and not isinstance(joints, Mapping):
            raise ConfigurationError(f"home(...): joints={joints!r} must be a mapping from joint names to values")
        named = {**(joints or {}), **more}
        for name, value in [("x", x), ("y", y), ("yaw", yaw), *named.items()]:
            if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
                raise ConfigurationError(f"home(...): {name}={value!r} is not a number")
        if self.space.planar:
            chart[:3] = (x, y, yaw)
        elif (x, y, yaw) != (0.0, 0.0, 0.0):
            raise ConfigurationError(f"the base of {self.name!r} is fixed; x={x}, y={y}, yaw={yaw} must be 0")
        for name, value in named.items():
            if name not in self.joint_names:
                raise ConfigurationError(f"{self.name!r} plans no joint {name!r}{nearest_name(name, self.joint_names)}")
            chart[self.space.base_nv + self.joint_names.index(name)] = value
        return self.check_q(self.space.from_chart(chart), what="home(...)")

    def check_q(self, q: npt.ArrayLike, *, what: str = "q", limits: bool = True) -> Array:
        """Check a configuration (nq,) or a stack of them (N, nq); returns a float copy.

        Raises:
            ConfigurationError: wrong size, not finite, (cos, sin) not of unit length, or outside the joint limits.
        """
        try:
            array = np.array(q, dtype=float)
        except (TypeError, ValueError):
            raise ConfigurationError(f"{what} is not an array of numbers") from None
        if array.ndim not in (1, 2) or array.shape[-1] != self.nq:
            layout = "x, y, cos yaw, sin yaw, joints" if self.space.planar else "joints"
            raise ConfigurationError(f"{what} has shape {array.shape}; {self.name!r} wants (…, {self.nq}): {layout}")
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            at = tuple(int(i) for i in bad[0])
            raise ConfigurationError(f"{what}{list(at)} = {array[at]} is not finite")
        pairs = [2] if self.space.planar else []
        pairs += [int(i) for i in self.space.idx_q[self.space.circular]]
        for i in pairs:
            norm = np.hypot(array[..., i], array[..., i + 1])
            worst = float(np.abs(norm - 1.0).max(initial=0.0))
            if worst > 1e-6:
                raise ConfigurationError(
                    f"{what}: the length of the pair (cos, sin) at {i}, {i + 1} is off by {worst:.3g}; it must be 1"
                )
        if limits:
            chart = self.space.to_chart(array)
            outside = (chart < self.space.lower - 1e-9) | (chart > self.space.upper + 1e-9)
            if outside.any():
                index = tuple(int(i) for i in np.argwhere(outside)[0])
                k = index[-1]
                name = self.joint_names[k - self.space.base_nv]
                raise ConfigurationError(
                    f"{what}: joint {name!r} = {chart[index]:.6g} is outside its limits "
                    f"[{self.space.lower[k]:.6g}, {self.space.upper[k]:.6g}]"
                )
        return array

    def control_points(self, q: npt.ArrayLike) -> Array:
        """World positions (C, 3) [m] of the control points at a configuration (nq,)."""
        data = self.model.createData()
        pin.forwardKinematics(self.model, data, self.check_q(q, limits=False))
        points = self.control_point_set
        return np.array([data.oMi[int(j)].act(p) for j, p in zip(points.joint, points.local, strict=True)])

    @staticmethod
    def from_pinocchio(
        model: pin.Model,
        collision_model: pin.GeometryModel,
        visual_model: pin.GeometryModel | None = None,
        *,
        base: str | BaseKind | None = None,
        name: str | None = None,
        locked: Mapping[str, float] | None = None,
        home: Mapping[str, float] | None = None,
        disabled_pairs: Iterable[Iterable[str]] | None = None,
        control_points: Mapping[str, str | tuple[str, npt.ArrayLike]] | None = None,
        hand_frame: str | None = None,
        urdf_path: str | None = None,
        srdf_path: str | None = None,
    ) -> RobotModel:
        """Make a robot of Pinocchio models that already exist; they are not changed.

        Args:
            model: a model whose joint 1 is ``JointModelPlanar``, or one with a fixed base.
            collision_model: its collision geometry.
            visual_model: its visual geometry; the collision geometry where None.
            base: base kind; None means omni for a planar root and fixed otherwise.
            name: the robot's name; the model's where None.
            locked: joint → value of joints to hold still.
            home: joint → value of the home posture; the rest is neutral, within limits.
            disabled_pairs: pairs of link names whose collisions are ignored; None derives them by sampling.
            control_points: name → frame, or name → (frame, offset); None puts them at the joints.
            hand_frame: frame of the last default control point.

        Raises:
            RobotError: an unknown joint or frame, or a base kind that the root joint cannot be.
        """
        planar = model.njoints > 1 and model.joints[1].shortname() == "JointModelPlanar"
        kind = BaseKind.parse(base) if base is not None else (BaseKind.OMNI if planar else BaseKind.FIXED)
        if kind.planar != planar:
            root = "a planar root" if planar else "no planar root"
            raise RobotError(f"base={kind.value!r}, but the model has {root} (joint 1)")
        if planar and not model.jointPlacements[1].isIdentity(1e-12):
            raise RobotError("the planar root joint must sit at the origin of the world (identity placement)")
        collision_model = _with_frames(model, collision_model)
        visual = collision_model if visual_model is None else _with_frames(model, visual_model)
        values = dict(locked or {})
        _check_joint_names(model, values, "locked")
        _check_joint_names(model, home or {}, "home")
        reference = _reference_configuration(model, {**(home or {}), **values})
        ids = [model.getJointId(n) for n in values]
        reduced, (collision, visual) = pin.buildReducedModel(model, [collision_model, visual], ids, reference)
        space = ConfigurationSpace.from_model(reduced)
        pieces = tuple(link_geometries(reduced, collision))
        if not pieces:
            raise RobotError(f"robot {name or model.name!r} has no collision geometry, so nothing could be certified")
        q_home = _reference_configuration(reduced, dict(home or {}))
        pairs = self_pairs(reduced, pieces, q_home, disabled_pairs)
        convex = pin.GeometryModel()
        for piece in pieces:
            pose = pin.SE3(piece.placement[:3, :3], piece.placement[:3, 3])
            frame = find_frame(reduced, piece.links[0]) or 0
            convex.addGeometryObject(pin.GeometryObject(piece.name, piece.joint, frame, pose, piece.geometry))
        for i, k in pairs:
            convex.addCollisionPair(pin.CollisionPair(int(i), int(k)))
        points = (
            parse_control_points(reduced, control_points)
            if control_points is not None
            else default_control_points(reduced, planar, hand_frame)
        )
        q_home.setflags(write=False)
        return RobotModel(
            name=name or model.name or "robot",
            base_kind=kind,
            model=reduced,
            collision_model=convex,
            visual_model=visual,
            space=space,
            tree=KinematicTree.from_model(reduced, space),
            geometries=pieces,
            self_pairs=pairs,
            control_point_set=points,
            home_q=q_home,
            locked=values,
            urdf_path=urdf_path,
            srdf_path=srdf_path,
        )


def _with_frames(model: pin.Model, geometry: pin.GeometryModel) -> pin.GeometryModel:
    """A geometry model whose objects all have a parent frame: ``buildReducedModel`` ends the process without."""
    if all(obj.parentFrame < model.nframes for obj in geometry.geometryObjects):
        return geometry
    own = geometry.copy()
    for obj in own.geometryObjects:
        if obj.parentFrame >= model.nframes:
            joints = [i for i, f in enumerate(model.frames) if f.parentJoint == obj.parentJoint]
            obj.parentFrame = joints[0] if joints else 0
    return own


def _check_joint_names(model: pin.Model, values: Mapping[str, float], what: str) -> None:
    names = list(model.names)[1:]
    for joint, value in values.items():
        if joint not in names or joint == "root_joint":
            raise RobotError(
                f"{what}: unknown joint {joint!r}{nearest_name(joint, [n for n in names if n != 'root_joint'])}"
            )
        if not isinstance(value, (int, float)) or isinstance(value, bool) or not np.isfinite(value):
            raise RobotError(f"{what}: joint {joint!r} has value {value!r}; it must be a finite number [rad or m]")


def _reference_configuration(model: pin.Model, values: Mapping[str, float]) -> Array:
    """The neutral configuration moved inside the limits, with some joints set."""
    q = pin.neutral(model)
    for i in range(1, model.njoints):
        joint, name = model.joints[i], model.names[i]
        if joint.nv != 1:
            continue
        if joint.nq == 2:
            angle = float(values.get(name, 0.0))
            q[joint.idx_q : joint.idx_q + 2] = np.cos(angle), np.sin(angle)
            continue
        low, high = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        value = float(values.get(name, min(max(0.0, low), high)))
        if name in values and not low - 1e-9 <= value <= high + 1e-9:
            raise RobotError(f"joint {name!r} = {value:.6g} is outside its limits [{low:.6g}, {high:.6g}]")
        q[joint.idx_q] = min(max(value, low), high)
    return q


def model_from_urdf(
    path: str | Path, kind: BaseKind, package_dirs: tuple[str, ...]
) -> tuple[pin.Model, pin.GeometryModel, pin.GeometryModel]:
    """Build Pinocchio's models from a checked URDF file.

    Args:
        path: the file.
        kind: base kind.
        package_dirs: folders to search for meshes.

    Raises:
        RobotError: Pinocchio or Coal refuse it, in their words.
    """
    try:
        model = (
            pin.buildModelFromUrdf(str(path), pin.JointModelPlanar())
            if kind.planar
            else pin.buildModelFromUrdf(str(path))
        )
        collision = pin.buildGeomFromUrdf(model, str(path), pin.COLLISION, package_dirs=list(package_dirs))
        visual = pin.buildGeomFromUrdf(model, str(path), pin.VISUAL, package_dirs=list(package_dirs))
    except Exception as error:  # C++ exceptions arrive as ValueError, RuntimeError, IndexError …
        said = " ".join(str(error).split())[:300]
        raise RobotError(f"{path}: Pinocchio cannot build the model: {said}") from None
    for obj in collision.geometryObjects:
        if isinstance(obj.geometry, coal.BVHModelBase) and obj.geometry.num_vertices < 4:
            raise RobotError(f"{path}: collision mesh {obj.meshPath} of {obj.name!r} has fewer than 4 vertices")
    return model, collision, visual
