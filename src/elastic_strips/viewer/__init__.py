"""Viewer room: reports become pictures, and dragging in these comes back. The only room that knows meshcat."""

from typing import TYPE_CHECKING

from elastic_strips._late import late_names

if TYPE_CHECKING:
    from .browser import Browser, BrowserError
    from .drag import Drag
    from .dragged_goal import DraggedGoal
    from .live import LiveStrip
    from .path_report import PathReport
    from .sensed import Seen
    from .viewer import Viewer

__all__ = ["Browser", "BrowserError", "Drag", "DraggedGoal", "LiveStrip", "PathReport", "Seen", "Viewer"]

_MODULES = {  # pictures of what stands need no planner
    "browser": ("Browser", "BrowserError"),
    "drag": ("Drag",),
    "dragged_goal": ("DraggedGoal",),
    "live": ("LiveStrip",),
    "path_report": ("PathReport",),
    "sensed": ("Seen",),
    "viewer": ("Viewer",),
}
__getattr__ = late_names(__name__, _MODULES)
