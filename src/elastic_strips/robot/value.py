"""RobotValue: a robot as data, and what follows from that alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, ArrayLike, Indices
from elastic_strips.errors import ConfigurationError, RobotError, listed, nearest_name, plural
from elastic_strips.summary import Summary

from .geometry import LinkGeometry, collision_data
from .kinematics import ControlPoints, KinematicTree, find_frame
from .mimic import Following, carrier_name, followers_of, repaired
from .space import LIMIT_TOLERANCE, MAX_TRAVEL, BaseKind, ConfigurationSpace, beyond_turns
from .unchecked_pairs import UncheckedPair, counted
from .urdf import UrdfSource, read_urdf
from .wheels import DrivenWheels, driven_wheels

_IN_SI = 2.0 * np.pi  # what is larger may be meant in degrees or millimetres
_LINKS_NAMED = 8  # of the links without a shape, in a sentence


@dataclass(frozen=True, eq=False, repr=False)
class RobotValue(Summary):
    """A robot as a value. :class:`.RobotModel` adds what is made of it: inverse kinematics, what it holds, its card.

    Attributes:
        name: the robot's name.
        base_kind: how the root moves.
        model: planned Pinocchio model; joint 1 is a ``JointModelPlanar`` unless the base is fixed.
        collision_model: convex collision geometry with the self-collision pairs to check.
        space: configuration space (coordinates, difference, integrate, interpolate).
        tree: the model's joints as arrays.
        geometries: the convex pieces, in the order of ``collision_model.geometryObjects``.
        self_pairs: (S, 2) index pairs of ``geometries`` that must not touch.
        self_apart: (S,) distances [m] that they are proven to keep in every posture within the limits; 0 where
            nothing is; see :meth:`pairs_within`.
        unchecked_pairs: pairs of links whose collisions with each other are not looked at, and why.
        control_point_set: the control points.
        home_q: (nq,) posture at the origin.
        visual: makes the visual geometry; read ``visual_model``.
        locked: values of the joints that planning holds still [rad or m].
        states: named postures, joint → value [rad or m]; see :meth:`state`.
        urdf_path, srdf_path: files, where there are any.
        bare_links: links that are drawn and that no collision shape covers: nothing is proven of them.
        held: why each of ``locked`` is held still.
        groups: the SRDF's groups of joints.
        shapes: the collision geometry as it is described, on ``model``, before it became ``geometries``.
        description: the URDF file as it was read, where there is one. A copy from another process has neither.
        round_wheels: wheels among the locked joints that look the same however far they have turned.
        narrowed: joint → the range that its links' shapes allow, and why, where that is less than the stated one.
        looking: locked joints that may turn at any time, to look around: what hangs on them is as large as the space
            that it passes through.
        eyes: the same robot, with these as joints like the others; read ``RobotModel.seeing``.
    """

    name: str
    base_kind: BaseKind
    model: pin.Model
    collision_model: pin.GeometryModel
    space: ConfigurationSpace
    tree: KinematicTree
    geometries: tuple[LinkGeometry, ...]
    self_pairs: Indices
    self_apart: Array
    unchecked_pairs: tuple[UncheckedPair, ...]
    control_point_set: ControlPoints
    home_q: Array
    visual: Callable[[], pin.GeometryModel]
    locked: Mapping[str, float] = field(default_factory=dict)
    states: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    urdf_path: str | None = None
    srdf_path: str | None = None
    bare_links: tuple[str, ...] = ()
    held: Mapping[str, str] = field(default_factory=dict)
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    shapes: pin.GeometryModel | None = None
    description: UrdfSource | None = None
    round_wheels: frozenset[str] = frozenset()
    narrowed: Mapping[str, str] = field(default_factory=dict)
    looking: tuple[str, ...] = ()
    eyes: RobotValue | None = None

    def __getstate__(self) -> dict[str, object]:  # without a closure, and meshes that are not planned with
        left = ("visual", "shapes", "description")
        state = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in left}
        if self.base_kind is BaseKind.DIFF_DRIVE:
            with suppress(RobotError):  # the copy says it, when it is asked
                state["wheels"] = self.wheels
        return state

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state, visual=lambda: self.collision_model, shapes=None, description=None)
        repaired(self.model, self.tree.prismatic, self.tree.align[:, :, 2])
        for array in (self.home_q, self.self_pairs, self.self_apart, self.space.lower, self.space.upper):
            array.setflags(write=False)
        shapes = [piece.geometry for piece in self.geometries]
        for shape in (*shapes, *(obj.geometry for obj in self.collision_model.geometryObjects)):
            shape.computeLocalAABB()

    def _summary(self) -> dict[str, object]:
        following = {"following": _counted(tuple(self.followers))} if self.followers else {}
        return {
            "name": self.name,
            "base": self.base_kind.value,
            "joints": _counted(self.joint_names),
            **following,
            "locked": _counted(tuple(self.locked)),
            "pieces": len(self.geometries),
            "self_pairs": len(self.self_pairs),
            **({"links_without_shape": _counted(self.bare_links)} if self.bare_links else {}),
            "unchecked_pairs": _counted_reasons(self.unchecked_pairs),
        }

    @property
    def nq(self) -> int:
        """Size of a configuration."""
        return self.space.nq

    @property
    def nv(self) -> int:
        """Number of degrees of freedom."""
        return self.space.nv

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Planned joints without the root, and without those that follow one of them."""
        names, counts = self.model.names, self.model.nvs
        return tuple(names[i] for i in range(2 if self.space.planar else 1, self.model.njoints) if counts[i])

    @cached_property
    def followers(self) -> Mapping[str, Following]:
        """The joints that follow a planned one (``<mimic>``): name → (leader, multiplier, constant [rad or m])."""
        return {name: f for name, f in followers_of(self.model).items() if name != carrier_name(f.leader)}

    @cached_property
    def wheels(self) -> DrivenWheels:
        """The driven wheels that the robot's description has.

        Raises:
            RobotError: the robot is not made of a URDF file, or that has no such pair of wheels.
        """
        if self.urdf_path is None:
            raise RobotError(f"robot {self.name!r} was not made of a URDF file, so its wheels are unknown")
        return driven_wheels(self.description or read_urdf(self.urdf_path), self.locked)

    @cached_property
    def visual_model(self) -> pin.GeometryModel:
        """Visual geometry; read at the first use, since it takes most of the time that a URDF takes to load.

        It is the collision geometry where there is none, or where it cannot be read (a warning).
        """
        return self.visual()

    @property
    def unproven(self) -> str:
        """What no proof of this robot covers, in words that follow a verdict; empty where it covers everything."""
        bare = self.bare_links
        if not bare:
            return ""
        links = plural(len(bare), "link")
        return f"nothing is proven about {links} without a collision shape: {listed(bare, _LINKS_NAMED)}"

    def same_as(self, other: RobotValue) -> bool:
        """Whether another robot moves alike and has the same shape, so that a proof for one holds for the other."""
        if self is other:
            return True
        return (
            self.model == other.model
            and np.array_equal(self.tree.rate, other.tree.rate)  # Pinocchio does not compare them
            and np.array_equal(self.tree.shift, other.tree.shift)
            and self.base_kind is other.base_kind
            and np.array_equal(self.self_pairs, other.self_pairs)
            and len(self.geometries) == len(other.geometries)
            and all(
                a.joint == b.joint and np.array_equal(a.placement, b.placement) and a.geometry == b.geometry
                for a, b in zip(self.geometries, other.geometries, strict=True)
            )
        )

    def home(
        self,
        x: float = 0.0,
        y: float = 0.0,
        yaw: float = 0.0,
        joints: Mapping[str, float] | None = None,
        **more: float,
    ) -> Array:
        """The home posture at a base pose, with single joints overridden: a configuration (nq,).

        Home is, in this order, the named robot's own, the SRDF's state ``home``, ``default``, ``half_sitting`` or
        ``standing``, a state that gives all joints, the neutral posture (0, or the nearest limit), any other state: the
        first of these that is within the limits and in which the robot does not collide with itself. A warning says
        which ones were passed over.

        Args:
            x, y, yaw: base pose [m, m, rad]; must be 0 for a fixed base.
            joints: joint name → value [rad or m].
            **more: further joints by name; one called ``x``, ``y`` or ``yaw`` is set through ``joints``.

        Raises:
            ConfigurationError: an unknown joint, a value that is not finite or outside its limits.
        """
        coordinates = self.space.to_coordinates(self.home_q)
        if joints is not None and not isinstance(joints, Mapping):
            raise ConfigurationError(f"home(...): joints={joints!r} must be a mapping from joint names to values")
        named = {**(joints or {}), **more}
        for name, value in [("x", x), ("y", y), ("yaw", yaw), *named.items()]:
            if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
                raise ConfigurationError(f"home(...): {name}={value!r} is not a number")
        if said := beyond_turns(yaw):
            raise ConfigurationError(f"home(...): yaw={yaw!r} {said}")
        if self.space.planar:
            coordinates[:3] = (x, y, yaw)
        elif (x, y, yaw) != (0.0, 0.0, 0.0):
            raise ConfigurationError(f"the base of {self.name!r} is fixed; x={x}, y={y}, yaw={yaw} must be 0")
        for name, value in named.items():
            if name in self.followers:
                leader, multiplier, constant = self.followers[name]
                raise ConfigurationError(
                    f"joint {name!r} of {self.name!r} follows {leader!r} ({multiplier:g} times its value plus "
                    f"{constant:g}); give that one's value"
                )
            if name in self.locked:
                raise ConfigurationError(
                    f"{self.name!r} plans no joint {name!r}, held at {self.locked[name]:g}; else load the robot with "
                    f"locked={{{name!r}: {value:g}}}, in a scenario 'robot: {{name: …, locked: {{{name}: {value:g}}}}}'"
                )
            if name not in self.joint_names:
                raise ConfigurationError(f"{self.name!r} plans no joint {name!r}{nearest_name(name, self.joint_names)}")
            coordinates[self.space.base_nv + self.joint_names.index(name)] = value
        return self.check_q(self.space.from_coordinates(coordinates), what="home(...)")

    def state(self, name: str, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> Array:
        """A named posture (an SRDF's ``group_state``) at a base pose: a configuration (nq,).

        Joints that the state does not name are as at home; locked ones stay as they are locked.

        Args:
            name: one of ``states``.
            x, y, yaw: base pose [m, m, rad]; must be 0 for a fixed base.

        Raises:
            ConfigurationError: an unknown name, or a value that is outside the joint's limits.
        """
        if name not in self.states:
            raise ConfigurationError(f"{self.name!r} has no state {name!r}{nearest_name(name, self.states)}")
        planned = {j: v for j, v in self.states[name].items() if j in self.joint_names}
        return self.home(x, y, yaw, joints=planned)

    def check_q(self, q: ArrayLike, *, what: str = "q", limits: bool = True) -> Array:
        """Check a configuration (nq,) or a stack of them (N, nq); returns a float copy.

        A joint outside its limits by at most 1e-4 rad (or m) is taken to the limit: the rounding of files and other
        programs is not a fault.

        Args:
            q: base x, y [m], cos yaw, sin yaw (planar base), then joints [rad or m]; continuous joints as (cos, sin).
            what: its name in messages.
            limits: whether joints have to be within their limits.

        Raises:
            ConfigurationError: wrong size, not finite, (cos, sin) not of unit length, outside the joint limits, or a
                stack whose base goes farther than 10 km from the origin.
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
        if self.space.planar and array.ndim == 2 and not (np.abs(array[:, :2]) <= MAX_TRAVEL).all():
            at = tuple(int(i) for i in np.argwhere(np.abs(array[:, :2]) > MAX_TRAVEL)[0])
            raise ConfigurationError(
                f"{what}: the base's {'xy'[at[-1]]} = {array[at]:.6g} m; it stays within {MAX_TRAVEL:g} m of the origin"
            )
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
            coordinates = self.space.to_coordinates(array)
            beyond = np.maximum(self.space.lower - coordinates, coordinates - self.space.upper)
            outside = beyond > LIMIT_TOLERANCE
            if outside.any():
                index = tuple(int(i) for i in np.argwhere(outside)[0])
                k = index[-1]
                name = self.joint_names[k - self.space.base_nv]
                slides = bool(self.tree.prismatic[self.model.getJointId(name)])
                raise ConfigurationError(
                    f"{what}: joint {name!r} = {coordinates[index]:.6g} is outside its limits "
                    f"{_limits(float(coordinates[index]), self.space.lower[k], self.space.upper[k], slides=slides)}"
                    f"{f'; {why}' if (why := self.narrowed.get(name)) else ''}"
                )
            for k in np.flatnonzero((np.atleast_2d(beyond) > 0.0).any(axis=0)):
                i = int(self.space.idx_q[k - self.space.base_nv])
                array[..., i] = np.clip(array[..., i], self.space.lower[k], self.space.upper[k])
        return array

    def pairs_within(self, distance: float) -> Indices:
        """The self pairs (S', 2) that are not proven to stay further apart than this [m] in every posture."""
        return self.self_pairs[self.self_apart <= distance]

    def self_collision(self, q: ArrayLike) -> tuple[str, str] | None:
        """Names of two pieces of the robot that touch at a configuration (nq,), or None.

        Raises:
            ConfigurationError: an unsound configuration; limits do not count.
        """
        data, geometry = self.model.createData(), collision_data(self.collision_model)
        q = self.check_q(q, limits=False)
        if not pin.computeCollisions(self.model, data, self.collision_model, geometry, q, True):
            return None
        hit = next(k for k, result in enumerate(geometry.collisionResults) if result.isCollision())
        i, k = self.self_pairs[hit]
        return self.geometries[i].name, self.geometries[k].name

    def frame_pose(self, q: ArrayLike, frame: str) -> Array:
        """Pose (4, 4) in the world of one of the robot's frames at a configuration (nq,).

        Raises:
            RobotError: an unknown frame.
            ConfigurationError: an unsound configuration; limits do not count.
        """
        index = find_frame(self.model, frame)
        if index is None:
            names = [f.name for f in self.model.frames]
            raise RobotError(f"{self.name!r} has no frame {frame!r}{nearest_name(frame, names)}")
        data = self.model.createData()
        pin.forwardKinematics(self.model, data, self.check_q(q, limits=False))
        return np.array(pin.updateFramePlacement(self.model, data, index).homogeneous)

    def control_points(self, q: ArrayLike) -> Array:
        """World positions (C, 3) [m] of the control points at a configuration (nq,)."""
        data = self.model.createData()
        pin.forwardKinematics(self.model, data, self.check_q(q, limits=False))
        points = self.control_point_set
        return np.array([data.oMi[int(j)].act(p) for j, p in zip(points.joint, points.local, strict=True)])


def _limits(value: float, low: float, high: float, *, slides: bool) -> str:
    """Limits that a value is outside of, with their unit; and whether it may be meant in another one."""
    scale, unit, other = (1e-3, "m", "mm") if slides else (np.pi / 180.0, "rad", "degrees")
    meant = value * scale
    hint = f"; {value:.6g} {other} are {meant:.6g} {unit}" if low <= meant <= high and abs(value) > _IN_SI else ""
    return f"[{low:.6g}, {high:.6g}] {unit}{hint}"


def _counted(names: tuple[str, ...]) -> str:
    """How many, and which."""
    return f"{len(names)}" + (f": {listed(names)}" if names else "")


def _counted_reasons(pairs: tuple[UncheckedPair, ...]) -> str:
    """How many pairs are not checked, by reason."""
    return f"{len(pairs)}" + (f": {counted(pairs)}" if pairs else "")
