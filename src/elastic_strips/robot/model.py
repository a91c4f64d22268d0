"""RobotModel: the frozen value that every other room plans with."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, ArrayLike, Indices
from elastic_strips.errors import ConfigurationError, RobotError, nearest_name
from elastic_strips.summary import Summary

from .cover import uncovered
from .geometry import LinkGeometry
from .kinematics import ControlPoints, KinematicTree, default_control_points, find_frame, parse_control_points
from .mimic import Following, carrier_name, followers_of, repaired
from .self_pairs import PairRules, UncheckedPair, pieces_and_pairs
from .space import LIMIT_TOLERANCE, MAX_TRAVEL, BaseKind, ConfigurationSpace

if TYPE_CHECKING:
    from .card import RobotCard
    from .holding import HeldShape
    from .inverse_kinematics import ReachResult
    from .urdf import UrdfSource

_log = logging.getLogger(__name__)

_NAMED = 8  # names in a sentence
_LONGEST_SLIDE = 1e3
"""Range [m] to either side of a sliding joint without limits."""


@dataclass(frozen=True, eq=False, repr=False)
class RobotModel(Summary):
    """A robot ready for planning: locked joints are gone, every collision shape is convex.

    It can be pickled, to be sent to another process; the copy draws its collision geometry.

    Attributes:
        name: the robot's name.
        base_kind: how the root moves.
        model: planned Pinocchio model; joint 1 is a ``JointModelPlanar`` unless the base is fixed.
        collision_model: convex collision geometry with the self-collision pairs to check.
        space: configuration space (coordinates, difference, integrate, interpolate).
        tree: the model's joints as arrays.
        geometries: the convex pieces, in the order of ``collision_model.geometryObjects``.
        self_pairs: (S, 2) index pairs of ``geometries`` that must not touch.
        self_apart: (S,) distances [m] that these pairs are proven to keep in every posture within the limits; 0 where
            none is proven; see :meth:`pairs_within`.
        unchecked_pairs: pairs of links whose collisions with each other are not checked, and why.
        control_point_set: the control points.
        home_q: (nq,) posture at the origin.
        visual: a function that makes the visual geometry; read ``visual_model``.
        locked: values of the joints that planning holds still [rad or m].
        states: named postures, joint → value [rad or m]; see :meth:`state`.
        urdf_path, srdf_path: its files, or None.
        bare_links: links that are drawn and that no collision shape covers: nothing is proven about them.
        held: the reason why each joint of ``locked`` is held still.
        groups: the SRDF's groups of joints.
        shapes: the collision geometry on ``model`` as the file describes it, before it became ``geometries``.
        description: the URDF file as it was read, or None. A copy from another process has neither this nor ``shapes``.
        round_wheels: wheels among the locked joints that look the same however far they have turned.
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

    def __getstate__(self) -> dict[str, object]:  # without a closure, and meshes that are not planned with
        left = ("visual", "shapes", "description")
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name not in left}

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
            "name": self.name, "base": self.base_kind.value, "joints": _counted(self.joint_names), **following,
            "locked": _counted(tuple(self.locked)), "pieces": len(self.geometries), "self_pairs": len(self.self_pairs),
            **({"links_without_shape": _counted(self.bare_links)} if self.bare_links else {}),
            "unchecked_pairs": _counted_reasons(self.unchecked_pairs),
        }  # fmt: skip

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
        names = ", ".join(bare[:_NAMED]) + (f" and {len(bare) - _NAMED} more" if len(bare) > _NAMED else "")
        return f"nothing is proven about {len(bare)} link{'s' * (len(bare) > 1)} without a collision shape: {names}"

    def same_as(self, other: RobotModel) -> bool:
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
                raise ConfigurationError(
                    f"{what}: joint {name!r} = {coordinates[index]:.6g} is outside its limits "
                    f"[{self.space.lower[k]:.6g}, {self.space.upper[k]:.6g}]"
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
        data, geometry = self.model.createData(), self.collision_model.createData()
        q = self.check_q(q, limits=False)
        if not pin.computeCollisions(self.model, data, self.collision_model, geometry, q, True):
            return None
        hit = next(k for k, result in enumerate(geometry.collisionResults) if result.isCollision())
        i, k = self.self_pairs[hit]
        return self.geometries[i].name, self.geometries[k].name

    def inverse_kinematics(
        self,
        frame: str,
        position: ArrayLike,
        orientation: ArrayLike | None = None,
        *,
        near: ArrayLike | None = None,
        base: bool = True,
        within: ArrayLike = (0.0, 0.0, 0.0),
        count: int = 1,
        seed: int = 0,
    ) -> ReachResult:
        """Configurations that bring a frame to a pose; see :func:`.inverse_kinematics.inverse_kinematics`."""
        from .inverse_kinematics import inverse_kinematics  # it needs this class

        return inverse_kinematics(
            self, frame, position, orientation, near=near, base=base, within=within, count=count, seed=seed
        )

    def attached(
        self,
        shape: HeldShape,
        frame: str,
        *,
        q: ArrayLike | None = None,
        touch: Collection[str] = (),
        mass: float = 0.0,
        name: str | None = None,
    ) -> RobotModel:
        """The robot with an obstacle's shape that one of its frames carries; see :func:`.holding.attached`."""
        from .holding import attached  # it needs this class

        return attached(self, shape, frame, q=q, touch=touch, mass=mass, name=name)

    def card(self) -> RobotCard:
        """What is known about the robot, what is assumed and what is not checked; see :class:`.card.RobotCard`.

        It reads the meshes and the URDF a second time, which may take seconds.
        """
        from .card import robot_card  # it needs this class

        return robot_card(self)

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

    @staticmethod
    def from_pinocchio(
        model: pin.Model,
        collision_model: pin.GeometryModel,
        visual_model: pin.GeometryModel | Callable[[], pin.GeometryModel] | None = None,
        *,
        base: str | BaseKind | None = None,
        name: str | None = None,
        locked: Mapping[str, float] | None = None,
        home: Mapping[str, float] | None = None,
        disabled_pairs: Mapping[frozenset[str], str] | Iterable[Iterable[str]] | None = None,
        enabled_pairs: Iterable[Iterable[str]] = (),
        followers: Mapping[str, tuple[str, float, float]] | None = None,
        control_points: Mapping[str, str | tuple[str, ArrayLike]] | None = None,
        hand_frame: str | None = None,
        states: Mapping[str, Mapping[str, float]] | None = None,
        urdf_path: str | None = None,
        srdf_path: str | None = None,
        held: Mapping[str, str] | None = None,
        groups: Mapping[str, tuple[str, ...]] | None = None,
        drawn: pin.GeometryModel | None = None,
        description: UrdfSource | None = None,
        round_wheels: Collection[str] = (),
    ) -> RobotModel:
        """Make a robot of Pinocchio models that already exist; they are not changed.

        Args:
            model: a model whose joint 1 is ``JointModelPlanar``, or one with a fixed base. Sliding joints without
                limits get ±1 km. Joints that follow another (``JointModelMimic``) move with it; they have no limits of
                their own, so those of their leaders have to be as narrow as theirs.
            collision_model: its collision geometry.
            visual_model: its visual geometry, or a function that makes it; the collision geometry where None.
            base: base kind; None means omni for a planar root and fixed otherwise.
            name: the robot's name; the model's where None.
            locked: joint → value of a joint to hold still; joints that follow one of them are held where that puts
                them.
            home: joint → value of the home posture; the rest is neutral, within limits.
            disabled_pairs: pairs of link names whose collisions are not checked, besides those that one joint joins
                and those that touch in every sampled posture; a mapping gives the reason of each.
            enabled_pairs: pairs that are checked, though a joint joins them.
            followers: joint → (joint that it mimics, multiplier, offset [rad or m]), for the sampled postures.
            control_points: name → frame, or name → (frame, offset); None puts them at the joints.
            hand_frame: frame of the last default control point.
            states: named postures for :meth:`state`: name → joint → value [rad or m].
            urdf_path, srdf_path: files that the models were made of, for callers that need more than the models.
            held: joint → why it is locked.
            groups: the SRDF's groups of joints.
            drawn: visual geometry of the links without a collision shape; where None, that of ``visual_model`` if it
                is not a function.
            description: the URDF file as it was read.
            round_wheels: joints that do not change the robot's shape; those that are not locked are ignored.

        Raises:
            RobotError: an unknown joint or frame, a base kind that the root joint cannot be, joints or geometry that
                hang on the world beside a base that moves, or a joint that follows another one and is locked, is
                elsewhere at home, or cannot go around with it.
        """
        planar = model.njoints > 1 and model.joints[1].shortname() == "JointModelPlanar"
        kind = BaseKind.parse(base) if base is not None else (BaseKind.OMNI if planar else BaseKind.FIXED)
        if kind.planar != planar:
            root = "a planar root" if planar else "no planar root"
            raise RobotError(f"base={kind.value!r}, but the model has {root} (joint 1)")
        if planar and not model.jointPlacements[1].isIdentity(1e-12):
            raise RobotError("the planar root joint must sit at the origin of the world (identity placement)")
        values = dict(locked or {})
        check_joint_names(model, values, "locked")
        check_joint_names(model, home or {}, "home")
        reference = reference_configuration(model, {**(home or {}), **values})
        held_too = _followers_held(model, values, home or {})
        values |= held_too
        ids = [model.getJointId(n) for n in values]
        reduced = _reduced(model, ids, reference)
        _bound_sliders(reduced)
        collision = _carried_over(model, reduced, collision_model)
        space = ConfigurationSpace.from_model(reduced)
        if not collision.ngeoms:
            raise RobotError(f"robot {name or model.name!r} has no collision geometry, so nothing could be certified")
        told = disabled_pairs is not None
        reasons = disabled_pairs if isinstance(disabled_pairs, Mapping) else dict.fromkeys(disabled_pairs or (), "")
        rules = PairRules(
            {frozenset(pair): str(reason) for pair, reason in reasons.items()},
            frozenset(map(frozenset, enabled_pairs)), told, dict(followers or {}),
        )  # fmt: skip
        made = pieces_and_pairs(model, collision_model, reduced, collision, rules)
        pieces, pairs = made.pieces, made.pairs
        if planar:
            _refuse_other_roots(reduced, pieces)
        _check_wrapping(reduced)
        q_home = reference_configuration(reduced, dict(home or {}))
        if drawn is None and visual_model is not None and not callable(visual_model):
            drawn = _without_shapes(visual_model, collision_model)
        bare = () if drawn is None else uncovered(reduced, _carried_over(model, reduced, drawn), pieces)
        convex = pin.GeometryModel()
        for piece in pieces:
            pose = pin.SE3(piece.placement[:3, :3], piece.placement[:3, 3])
            frame = find_frame(reduced, piece.links[0]) or 0
            convex.addGeometryObject(pin.GeometryObject(piece.name, piece.joint, frame, pose, piece.geometry))
        for i, k in pairs:
            convex.addCollisionPair(pin.CollisionPair(int(i), int(k)))

        def visual() -> pin.GeometryModel:
            try:
                given = visual_model() if callable(visual_model) else visual_model
            except Exception as error:  # whatever Pinocchio and Coal throw; a picture is all that it is for
                said = " ".join(str(error).split())
                _log.warning("%s: the collision geometry is drawn: %s", name or model.name, said)
                given = None
            return collision if given is None else _carried_over(model, reduced, given)

        if control_points is None:
            points = default_control_points(reduced, planar, hand_frame)
        else:
            points = parse_control_points(reduced, control_points)
        for array in (q_home, pairs, made.apart):
            array.setflags(write=False)
        return RobotModel(
            name=name or model.name or "robot",
            base_kind=kind,
            model=reduced,
            collision_model=convex,
            space=space,
            tree=KinematicTree.from_model(reduced, space),
            geometries=pieces,
            self_pairs=pairs,
            self_apart=made.apart,
            unchecked_pairs=made.unchecked,
            control_point_set=points,
            home_q=q_home,
            visual=visual,
            locked=values,
            states={k: dict(v) for k, v in (states or {}).items()},
            urdf_path=urdf_path,
            srdf_path=srdf_path,
            bare_links=bare,
            held=dict(held or {}),
            groups=dict(groups or {}),
            shapes=collision,
            description=description,
            round_wheels=frozenset(round_wheels) & frozenset(values),
        )


def _without_shapes(visual: pin.GeometryModel, collision: pin.GeometryModel) -> pin.GeometryModel:
    """The visual geometry of frames that have no collision geometry."""
    shaped = {obj.parentFrame for obj in collision.geometryObjects}
    out = pin.GeometryModel()
    for obj in visual.geometryObjects:
        if obj.parentFrame not in shaped:
            out.addGeometryObject(obj)
    return out


def _counted(names: tuple[str, ...]) -> str:
    """How many, and which."""
    return f"{len(names)}" + (f": {', '.join(names)}" if names else "")


def _followers_held(model: pin.Model, locked: Mapping[str, float], home: Mapping[str, float]) -> dict[str, float]:
    """Followers of joints that are locked, where those put them.

    Raises:
        RobotError: a follower that is to be locked, or to be elsewhere at home than where its leader puts it.
    """
    held = {}
    for name, (leader, multiplier, constant) in followers_of(model).items():
        if name in locked:
            raise RobotError(f"locked: {name!r} follows {leader!r}: lock that one, or neither")
        if leader in locked:
            held[name] = multiplier * locked[leader] + constant
        elif name in home and not abs(home[name] - multiplier * home.get(leader, np.nan) - constant) <= LIMIT_TOLERANCE:
            raise RobotError(f"home: {name!r} = {home[name]:.6g} is not where {leader!r}, which it follows, puts it")
    return held


def _check_wrapping(model: pin.Model) -> None:
    """Check that a whole turn of a continuous joint leaves its followers where they were."""
    for name, (leader, multiplier, _) in followers_of(model).items():
        if model.joints[model.getJointId(leader)].nq == 2 and multiplier != round(multiplier):
            raise RobotError(
                f"joint {name!r} follows {leader!r}, which is continuous, {multiplier:g} times: it would be elsewhere "
                f"after a whole turn. Give {leader!r} limits, or lock it"
            )


def _counted_reasons(pairs: tuple[UncheckedPair, ...]) -> str:
    """How many pairs are not checked, by reason."""
    count = Counter(pair.why.value for pair in pairs)
    return f"{len(pairs)}" + (f": {'; '.join(f'{n} as {why}' for why, n in count.items())}" if pairs else "")


def _bound_sliders(model: pin.Model) -> None:
    """Give sliding joints without limits wide ones: how far a link can be from a joint before it must be known."""
    for i in range(1, model.njoints):
        kind, k = model.joints[i].shortname(), model.joints[i].idx_q
        if kind.startswith("JointModelP") and kind != "JointModelPlanar":
            model.lowerPositionLimit[k] = max(model.lowerPositionLimit[k], -_LONGEST_SLIDE)
            model.upperPositionLimit[k] = min(model.upperPositionLimit[k], _LONGEST_SLIDE)


def _refuse_other_roots(model: pin.Model, pieces: tuple[LinkGeometry, ...]) -> None:
    """Refuse geometry that does not move with a moving base: the base's motion would not count against it."""
    fixed = [p.name for p in pieces if p.joint == 0]
    if fixed:
        raise RobotError(
            f"collision geometry fixed to the world (joint 0): {', '.join(map(repr, fixed[:10]))}"
            f"{', …' if len(fixed) > 10 else ''}. The base moves, so this is not part of the robot: take it out of "
            "collision_model and give it to the Scene as an obstacle"
        )
    roots = [model.names[i] for i in range(2, model.njoints) if model.parents[i] == 0]
    if roots:
        raise RobotError(
            f"joints that hang on the world beside the planar root: {', '.join(map(repr, roots[:10]))}"
            f"{', …' if len(roots) > 10 else ''}. The base does not carry them, so they are another robot: give "
            "it a model of its own, or hang them on the base"
        )


def _reduced(model: pin.Model, ids: list[int], reference: Array) -> pin.Model:
    """The model with joints held still.

    ``pin.buildReducedModel`` looks frames up by name, which fails where a link is called like a joint: so such links
    are called otherwise for as long as that takes.
    """
    kinds: dict[str, set[pin.FrameType]] = {}
    for frame in model.frames:
        kinds.setdefault(frame.name, set()).add(frame.type)
    twice = {f"{name} (link)": name for name, types in kinds.items() if len(types) > 1}
    if not twice:
        return pin.buildReducedModel(model, ids, reference)
    own = model.copy()
    for frame in own.frames:
        if frame.type == pin.FrameType.BODY and f"{frame.name} (link)" in twice:
            frame.name = f"{frame.name} (link)"
    reduced = pin.buildReducedModel(own, ids, reference)
    for frame in reduced.frames:
        frame.name = twice.get(frame.name, frame.name)
    return reduced


def _carried_over(model: pin.Model, reduced: pin.Model, geometry: pin.GeometryModel) -> pin.GeometryModel:
    """The geometry of a model on its reduced model.

    ``pin.buildReducedModel`` does it too, but looks frames up by name alone, which fails where a link is called like
    its joint, and ends the process where an object has no frame.
    """
    bodies = {f.name: i for i, f in reversed(list(enumerate(reduced.frames))) if f.type == pin.FrameType.BODY}
    fixed = {f.name: f for f in reduced.frames if f.type == pin.FrameType.FIXED_JOINT}
    frames, names = list(model.frames), list(model.names)
    joints = {name: i for i, name in enumerate(reduced.names)}
    out = pin.GeometryModel()
    for obj in geometry.geometryObjects:
        own, joint = obj.copy(), names[obj.parentJoint]
        if joint in joints:
            own.parentJoint = joints[joint]
        else:  # locked: what is left of it is a frame
            own.parentJoint = fixed[joint].parentJoint
            own.placement = fixed[joint].placement * obj.placement
        on = next((i for i, f in enumerate(frames) if f.parentJoint == obj.parentJoint), 0)
        frame = frames[obj.parentFrame if obj.parentFrame < len(frames) else on]
        own.parentFrame = bodies.get(frame.name, find_frame(reduced, frame.name) or 0)
        out.addGeometryObject(own)
    return out


def check_joint_names(model: pin.Model, values: Mapping[str, float], what: str) -> None:
    names = [name for name in list(model.names)[1:] if name != "root_joint"]
    for joint, value in values.items():
        if joint not in names:
            raise RobotError(f"{what}: unknown joint {joint!r}{nearest_name(joint, names)}")
        if not isinstance(value, (int, float)) or isinstance(value, bool) or not np.isfinite(value):
            raise RobotError(f"{what}: joint {joint!r} has value {value!r}; it must be a finite number [rad or m]")
        if (count := model.joints[model.getJointId(joint)].nv) > 1 and value != 0.0:
            raise RobotError(
                f"{what}: joint {joint!r} has {count} degrees of freedom, so that {value!r} says nothing about it; "
                "it can only be held where it is neutral (0)"
            )


def reference_configuration(model: pin.Model, values: Mapping[str, float]) -> Array:
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
        if name in values and not low - LIMIT_TOLERANCE <= value <= high + LIMIT_TOLERANCE:
            raise RobotError(f"joint {name!r} = {value:.6g} is outside its limits [{low:.6g}, {high:.6g}]")
        q[joint.idx_q] = min(max(value, low), high)
    return q
