"""Viewer room: reports in, pictures out. The only room that knows meshcat."""

from .viewer import Viewer

__all__ = ["Viewer"]
