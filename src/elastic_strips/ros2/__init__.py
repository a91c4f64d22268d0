"""ROS 2: a robot that speaks ROS 2, driven by a Controller. Only node and driver need rclpy, and load it late."""

from __future__ import annotations

from typing import TYPE_CHECKING

from elastic_strips._late import late_names

if TYPE_CHECKING:
    from .messages import MessageError
    from .params import Ros2Params
    from .running import run_node

__all__ = ["MessageError", "Ros2Params", "run_node"]

_MODULES = {"messages": ("MessageError",), "params": ("Ros2Params",), "running": ("run_node",)}
__getattr__ = late_names(__name__, _MODULES)
