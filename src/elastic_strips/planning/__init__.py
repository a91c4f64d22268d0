"""Planning: initial strips."""

from .ends import check_ends
from .grid_path import GridPath, grid_path
from .line import straight_line
from .ompl_planner import PathResult, ompl_path
from .plan import PlanReport, plan, plan_report
from .validity import Validity
from .waypoints import waypoint_rows

__all__ = [
    "GridPath",
    "PathResult",
    "PlanReport",
    "Validity",
    "check_ends",
    "grid_path",
    "ompl_path",
    "plan",
    "plan_report",
    "straight_line",
    "waypoint_rows",
]
