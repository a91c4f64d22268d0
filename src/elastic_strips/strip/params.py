"""Parameters of the deformation, validated where they are made."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from typing import Annotated, ClassVar, TypeVar

from elastic_strips.arrays import Document
from elastic_strips.errors import ParameterError, nearest_name
from elastic_strips.validation import Bound, Checked, Count, NonNegative, Positive

P = TypeVar("P", bound="StripParams")


@dataclass(frozen=True, slots=True, kw_only=True)
class StripParams(Checked):
    """Parameters that all presets have; all lengths [m], angles [rad].

    Attributes:
        preset: name of the preset.
        influence: distance d_r within which obstacles push; the paper's *safe distance*.
        clearance: distance that the certificate proves; a hard bound, unlike ``influence``. 0 proves
            that nothing touches.
        self_clearance: distance that the certificate proves between the robot's own links; 0 proves that none touch.
        k_r: repulsion gain.
        k_c: contraction gain.
        rest_step: a strip whose iteration moves less has converged [m or rad].
        max_ticks: largest number of ticks of ``settle``.
        certificate_depth: largest number of halvings of a segment, after which it counts as not decided.
    """

    preset: ClassVar[str]
    influence: Positive
    clearance: NonNegative = 0.005
    self_clearance: NonNegative = 0.001
    k_r: NonNegative
    k_c: Positive
    rest_step: NonNegative
    max_ticks: Count
    certificate_depth: Count = 12

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        if self.clearance >= self.influence:
            raise ParameterError(
                f"clearance={self.clearance} must be below influence={self.influence}: "
                "the force has to act before the bound"
            )

    def replaced(self: P, **overrides: object) -> P:
        """A copy with some values replaced, validated anew.

        Raises:
            ParameterError: an unknown parameter, or a value outside its range.
        """
        valid = {f.name for f in fields(self)}
        for name in overrides:
            if name not in valid:
                raise ParameterError(f"unknown parameter {name!r}{nearest_name(name, valid)}")
        return replace(self, **overrides)

    def as_dict(self) -> Document:
        """All values by name, and the preset's name."""
        return {"preset": self.preset, **asdict(self)}


@dataclass(frozen=True, slots=True, kw_only=True)
class DeformParams(StripParams):
    """Parameters of :class:`Deformer`; all lengths [m], angles [rad]. See :class:`StripParams` for the others.

    Attributes:
        near: distance of the stiff repulsive layer; k_near: its gain.
        k_self, self_influence: gain and distance of repulsion between own links; links that are nearer by design push
            later.
        k_limit, limit_margin: gain and margin of the joint limits.
        k_posture: gain of the pull towards the straight line in joint space from start to goal.
        yaw_lever, joint_lever: lengths that make angles comparable with metres in the spacing [m/rad].
        rolling_stiffness: penalty of sideways travel before the exact projection.
        damping: D of (D + K) δ = Γ.
        max_step: largest motion of a node's base or joints in one iteration [m or rad].
        max_spacing, min_spacing: node spacing that resampling keeps.
        max_nodes: largest number of nodes.

    Examples:
        >>> robot = es.load_robot("silvermate")
        >>> wide = es.DeformParams(influence=0.5, clearance=0.05)  # gives way from 0.5 m on, and proves 0.05 m
        >>> deformer = es.Deformer(robot, params=wide)
    """

    preset: ClassVar[str] = "default"
    influence: Annotated[float, Bound(above=0.0, high=5.0)] = 0.3  # [m]
    k_r: NonNegative = 1.0
    k_c: Positive = 1.0
    near: NonNegative = 0.06
    k_near: NonNegative = 20.0
    k_self: NonNegative = 40.0
    self_influence: NonNegative = 0.03
    k_limit: NonNegative = 1.0
    limit_margin: NonNegative = 0.05
    k_posture: NonNegative = 0.005
    yaw_lever: NonNegative = 0.25
    joint_lever: NonNegative = 0.25
    rolling_stiffness: NonNegative = 200.0
    damping: Positive = 0.3
    max_step: Positive = 0.12
    rest_step: NonNegative = 1e-3
    max_spacing: Positive = 0.2
    min_spacing: NonNegative = 0.06
    max_nodes: Annotated[int, Bound(low=4)] = 512  # turn, drive, turn
    max_ticks: Count = 200

    def __post_init__(self) -> None:
        StripParams.__post_init__(self)
        if self.min_spacing > self.max_spacing:
            raise ParameterError(f"min_spacing={self.min_spacing} must not exceed max_spacing={self.max_spacing}")
