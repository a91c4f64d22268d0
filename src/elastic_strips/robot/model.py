"""RobotModel: the frozen value that every other room plans with."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import partial

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, ArrayLike, Indices
from elastic_strips.errors import RobotError

from .card import RobotCard, robot_card
from .cover import uncovered
from .folding import narrowed_ranges
from .geometry import LinkGeometry
from .holding import HeldShape, attached
from .inverse_kinematics import ReachResult, inverse_kinematics
from .kinematics import KinematicTree, default_control_points, find_frame, parse_control_points
from .reduced import (
    bound_sliders,
    carried_over,
    check_joint_names,
    check_wrapping,
    followers_held,
    reduced_model,
    reference_configuration,
    without_shapes,
)
from .self_pairs import pieces_and_pairs
from .space import BaseKind, ConfigurationSpace
from .unchecked_pairs import PairRules
from .urdf import UrdfSource
from .value import RobotValue

_log = logging.getLogger(__name__)


class RobotModel(RobotValue):
    """A robot ready for planning: locked joints are gone, every collision shape is convex.

    It can be pickled, to be sent to another process; the copy draws its collision geometry.

    Examples:
        >>> robot = es.load_robot("silvermate")
        >>> q = robot.home(x=1.0, yaw=0.5, arm_1_joint=0.3)  # a configuration (nq,)
        >>> robot.frame_pose(q, "hand_frame").shape  # in the world
        (4, 4)
    """

    @property
    def seeing(self) -> RobotModel:
        """The robot as its sensors see it: with the joints that look as joints like the others, after those that are
        planned or before them; this one where none looks."""
        return self.eyes if isinstance(self.eyes, RobotModel) else self

    def seeing_row(self, row: Array, values: Array) -> Array:
        """Coordinate row of :attr:`seeing`, from one of this robot (nv,) and the values (L,) of the joints that look
        [rad or m], in the order of ``looking``."""
        base = self.space.base_nv
        named = dict(zip(self.looking, values.tolist(), strict=True))
        named |= dict(zip(self.joint_names, row[base:].tolist(), strict=True))
        return np.array([*row[:base], *(named[name] for name in self.seeing.joint_names)])

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
        return attached(self, shape, frame, q=q, touch=touch, mass=mass, name=name)

    def card(self) -> RobotCard:
        """What is known about the robot, what is assumed and what is not checked; see :class:`.card.RobotCard`.

        It reads the meshes and the URDF a second time, which may take seconds.
        """
        return robot_card(self)

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
        # Long and in one piece: a step for each thing that a robot has, each of which needs others before it.
        kind = _base_kind(model, base)
        values, home = dict(locked or {}), dict(home or {})
        check_joint_names(model, values, "locked")
        check_joint_names(model, home, "home")
        reference = reference_configuration(model, {**home, **values})
        values |= followers_held(model, values, home)
        reduced = reduced_model(model, [model.getJointId(joint) for joint in values], reference)
        bound_sliders(reduced)
        collision = carried_over(model, reduced, collision_model)
        if not collision.ngeoms:
            raise RobotError(f"robot {name or model.name!r} has no collision geometry, so nothing could be certified")
        rules = _rules(disabled_pairs, enabled_pairs, followers)
        made = pieces_and_pairs(model, collision_model, reduced, collision, rules)
        narrowed = narrowed_ranges(
            model, collision_model, made.unchecked, movable=_alone(reduced, rules.followers), said=rules.disabled,
            used=_used([home, *(states or {}).values()]),
        )  # fmt: skip
        for joint, span in narrowed.items():
            k = reduced.joints[reduced.getJointId(joint)].idx_q
            reduced.lowerPositionLimit[k], reduced.upperPositionLimit[k] = span.low, span.high
        space = ConfigurationSpace.from_model(reduced)
        if kind.planar:
            _refuse_other_roots(reduced, made.pieces)
        check_wrapping(reduced)
        q_home = reference_configuration(reduced, home)
        if drawn is None and visual_model is not None and not callable(visual_model):
            drawn = without_shapes(visual_model, collision_model)
        bare = () if drawn is None else uncovered(reduced, carried_over(model, reduced, drawn), made.pieces)

        if control_points is None:
            points = default_control_points(reduced, kind.planar, hand_frame)
        else:
            points = parse_control_points(reduced, control_points)
        for array in (q_home, made.pairs, made.apart):
            array.setflags(write=False)
        return RobotModel(
            name=name or model.name or "robot",
            base_kind=kind,
            model=reduced,
            collision_model=_convex_geometry(reduced, made.pieces, made.pairs),
            space=space,
            tree=KinematicTree.from_model(reduced, space),
            geometries=made.pieces,
            self_pairs=made.pairs,
            self_apart=made.apart,
            unchecked_pairs=made.unchecked,
            control_point_set=points,
            home_q=q_home,
            visual=partial(_drawn, visual_model, model, reduced, collision, name or model.name),
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
            narrowed={joint: str(span) for joint, span in narrowed.items()},
        )


def _drawn(
    given: pin.GeometryModel | Callable[[], pin.GeometryModel] | None,
    model: pin.Model,
    reduced: pin.Model,
    collision: pin.GeometryModel,
    name: str,
) -> pin.GeometryModel:
    """What is drawn of a robot: the visual geometry of all its joints, or else ``collision``, of the reduced model."""
    try:
        shapes = given() if callable(given) else given
    except Exception as error:  # whatever Pinocchio and Coal throw; a picture is all that it is for
        _log.warning("%s: the collision geometry is drawn: %s", name, " ".join(str(error).split()))
        shapes = None
    return collision if shapes is None else carried_over(model, reduced, shapes)


def _base_kind(model: pin.Model, base: str | BaseKind | None) -> BaseKind:
    """How the root moves: as is said, where the model has such a root, or as the model has it."""
    planar = model.njoints > 1 and model.joints[1].shortname() == "JointModelPlanar"
    kind = BaseKind.parse(base) if base is not None else (BaseKind.OMNI if planar else BaseKind.FIXED)
    if kind.planar != planar:
        root = "a planar root" if planar else "no planar root"
        raise RobotError(f"base={kind.value!r}, but the model has {root} (joint 1)")
    if planar and not model.jointPlacements[1].isIdentity(1e-12):
        raise RobotError("the planar root joint must sit at the origin of the world (identity placement)")
    return kind


def _alone(model: pin.Model, followers: Mapping[str, tuple[str, float, float]]) -> set[str]:
    """The planned joints that neither follow another one nor are followed."""
    coupled = {*followers, *(leader for leader, _, _ in followers.values())}
    return set(model.names[1:]) - coupled


def _used(postures: Iterable[Mapping[str, float]]) -> dict[str, list[float]]:
    """Values of joints in postures that somebody has named."""
    found: dict[str, list[float]] = {}
    for posture in postures:
        for joint, value in posture.items():
            found.setdefault(joint, []).append(float(value))
    return found


def _rules(
    disabled: Mapping[frozenset[str], str] | Iterable[Iterable[str]] | None,
    enabled: Iterable[Iterable[str]],
    followers: Mapping[str, tuple[str, float, float]] | None,
) -> PairRules:
    """What is said of pairs of links."""
    reasons = disabled if isinstance(disabled, Mapping) else dict.fromkeys(disabled or (), "")
    return PairRules(
        disabled={frozenset(pair): str(reason) for pair, reason in reasons.items()},
        enabled=frozenset(map(frozenset, enabled)),
        told=disabled is not None,
        followers=dict(followers or {}),
    )


def _convex_geometry(model: pin.Model, pieces: tuple[LinkGeometry, ...], pairs: Indices) -> pin.GeometryModel:
    """The pieces as Pinocchio's geometry, with the pairs (S, 2) of them that are looked at."""
    convex = pin.GeometryModel()
    for piece in pieces:
        pose = pin.SE3(piece.placement[:3, :3], piece.placement[:3, 3])
        frame = find_frame(model, piece.links[0]) or 0
        convex.addGeometryObject(pin.GeometryObject(piece.name, piece.joint, frame, pose, piece.geometry))
    for i, k in pairs:
        convex.addCollisionPair(pin.CollisionPair(int(i), int(k)))
    return convex


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
