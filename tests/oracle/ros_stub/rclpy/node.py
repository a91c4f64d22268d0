"""``rclpy.node``, as far as it is used."""

from . import Node

__all__ = ["Node"]
