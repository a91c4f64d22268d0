"""Parameters of the deformation, validated where they are made."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from .. import catalogue
from ..errors import ParameterError, nearest_name
from ..validation import check_choice, check_numbers, shown

PRESETS = tuple(catalogue.PRESETS)
_POSITIVE = (
    "influence", "k_c", "damping", "max_step", "max_spacing", "max_nodes", "max_ticks", "certificate_depth", "updates",
)  # fmt: skip
_PAPER = {
    "influence": 1.5, "k_r": 0.3, "k_c": 0.5, "max_spacing": 0.25, "min_spacing": 0.0, "rest_step": 2e-4,
    "max_ticks": 120,
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class DeformParams:
    """What the tick does; all lengths [m], angles [rad].

    Attributes:
        preset: ``"default"`` (implicit update, witness points) or ``"paper"`` (Eqs. 2–9 as printed).
        influence: distance d_r within which obstacles push; the paper's *safe distance*.
        clearance: distance that the certificate proves; a hard bound, another parameter than ``influence``. 0 proves
            that nothing touches.
        k_r: repulsion gain (Table 1 of the paper: 0.3).
        k_c: contraction gain (Table 1: 0.5).
        near: distance of the stiff repulsive layer; k_near: its gain. Default preset only.
        self_clearance: distance that the certificate proves between the robot's own links; 0 as for ``clearance``.
        k_self, self_influence: repulsion between the robot's own links; links that are nearer by design push later.
        k_limit, limit_margin: joint limits.
        k_posture: pull of the joints towards the straight joint-space line from start to goal.
        yaw_lever, joint_lever: lengths that make angles comparable with metres in the spacing [m/rad].
        rolling_stiffness: penalty of sideways travel before the exact projection.
        damping: D of (D + K) δ = Γ.
        max_step: most that a node's base or joints move in one iteration [m or rad].
        rest_step: a strip whose iteration moves less is at rest.
        max_spacing, min_spacing: node spacing that maintenance keeps.
        max_nodes: upper bound of nodes.
        max_ticks: most ticks of ``settle``.
        certificate_depth: most halvings of a segment before it counts as not decided.
        alpha: joints' rotation coefficient (Eq. 8). Paper preset only, as are the next four.
        transfer_tilt: Table 2's number, which the paper does not define. Here a quarter of it is the mobile's rotation
            coefficient α_m (Eq. 9), and it bounds the turn |δφ| of one update [rad].
        mobile_only: whether only the mobile's control point moves, as in the paper's cases 1–6.
        self_margin: a node's joints are not updated where that would bring its own links nearer than this.
        updates: explicit updates in one tick.
    """

    preset: str = "default"
    influence: float = 0.3
    clearance: float = 0.005
    self_clearance: float = 0.001
    k_r: float = 1.0
    k_c: float = 1.0
    near: float = 0.06
    k_near: float = 20.0
    k_self: float = 5.0
    self_influence: float = 0.03
    k_limit: float = 1.0
    limit_margin: float = 0.05
    k_posture: float = 0.005
    yaw_lever: float = 0.25
    joint_lever: float = 0.25
    rolling_stiffness: float = 200.0
    damping: float = 0.3
    max_step: float = 0.12
    rest_step: float = 1e-3
    max_spacing: float = 0.2
    min_spacing: float = 0.06
    max_nodes: int = 512
    max_ticks: int = 200
    certificate_depth: int = 12
    alpha: float = 0.25
    transfer_tilt: float = np.pi / 3
    mobile_only: bool = False
    self_margin: float = 0.02
    updates: int = 10

    def __post_init__(self) -> None:
        check_choice("preset", self.preset, PRESETS)
        if not isinstance(self.mobile_only, bool):
            raise ParameterError(f"mobile_only={shown(self.mobile_only)} must be True or False")
        check_numbers(self, zero=tuple(f.name for f in fields(self) if f.name not in _POSITIVE))
        if self.clearance >= self.influence:
            raise ParameterError(
                f"clearance={self.clearance} must be below influence={self.influence}: "
                "the force has to act before the bound"
            )
        if self.min_spacing > self.max_spacing:
            raise ParameterError(f"min_spacing={self.min_spacing} must not exceed max_spacing={self.max_spacing}")
        if self.max_nodes < 4:  # turn, drive, turn
            raise ParameterError(f"max_nodes={self.max_nodes} must be at least 4")

    @staticmethod
    def for_preset(preset: str, **overrides: Any) -> DeformParams:
        """Parameters of a preset with some values replaced.

        Raises:
            ParameterError: an unknown preset or parameter, or a value outside its range.
        """
        check_choice("preset", preset, PRESETS)
        base: dict[str, Any] = {"preset": preset}
        if preset == "paper":
            base |= _PAPER
        valid = {f.name for f in fields(DeformParams)} - {"preset"}
        for name in overrides:
            if name not in valid:
                raise ParameterError(f"unknown parameter {name!r}{nearest_name(name, valid)}")
        return DeformParams(**(base | overrides))

    def replaced(self, **overrides: Any) -> DeformParams:
        """A copy with some values replaced, validated anew."""
        valid = {f.name for f in fields(DeformParams)}
        for name in overrides:
            if name not in valid:
                raise ParameterError(f"unknown parameter {name!r}{nearest_name(name, valid)}")
        return replace(self, **overrides)

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)
