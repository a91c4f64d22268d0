"""Forces: internal, external, joint limits, self-collision, posture, tasks; each usable alone."""

from .external import (
    add_repulsion,
    add_self_repulsion,
    control_point_repulsion,
    map_to_joints,
    repulsive_magnitude,
    repulsive_potential,
)
from .internal import add_elastic, add_rolling, contraction_force, contraction_torque
from .posture import add_joint_limits, add_posture
from .system import System
from .task import add_axis_task, axis_in_world

__all__ = [
    "System",
    "add_axis_task",
    "add_elastic",
    "add_joint_limits",
    "add_posture",
    "add_repulsion",
    "add_rolling",
    "add_self_repulsion",
    "axis_in_world",
    "contraction_force",
    "contraction_torque",
    "control_point_repulsion",
    "map_to_joints",
    "repulsive_magnitude",
    "repulsive_potential",
]
