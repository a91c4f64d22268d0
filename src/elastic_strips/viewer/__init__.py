"""Viewer room: reports in, pictures out. The only room that knows meshcat."""

from elastic_strips.viewer.viewer import Viewer

__all__ = ["Viewer"]
