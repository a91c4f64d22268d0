"""Planning: an initial strip, or several on different sides of the obstacles, and sets of them kept in a scene."""

from .grid_path import GridPath, grid_path
from .homotopy.alternatives import Alternative, strip_cost
from .homotopy.classes import (
    HomotopyPath,
    ObstacleCluster,
    homotopy_class,
    homotopy_paths,
    obstacle_clusters,
    separating_obstacles,
)
from .homotopy.strip_set import StripSet, StripSetParams, StripSetReport
from .initial_strip import straight_line, tucked_rows, waypoint_rows
from .ompl_planner import PathResult, Validity, certify_path, ompl_path
from .plan import PlanReport, plan, plan_report
from .problem import check_endpoints

__all__ = [
    "Alternative",
    "GridPath",
    "HomotopyPath",
    "ObstacleCluster",
    "PathResult",
    "PlanReport",
    "StripSet",
    "StripSetParams",
    "StripSetReport",
    "Validity",
    "certify_path",
    "check_endpoints",
    "grid_path",
    "homotopy_class",
    "homotopy_paths",
    "obstacle_clusters",
    "ompl_path",
    "plan",
    "plan_report",
    "separating_obstacles",
    "straight_line",
    "strip_cost",
    "tucked_rows",
    "waypoint_rows",
]
