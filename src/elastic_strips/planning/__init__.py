"""Planning: initial strips, alternatives on other sides of the obstacles, and families of them."""

from .alternatives import Alternative, AlternativesReport, plan_alternatives, strip_cost
from .edges import certify_path
from .ends import check_ends
from .family import FamilyReport, StripFamily
from .family_params import FamilyParams
from .grid_path import GridPath, grid_path
from .homotopy import Component, base_class, base_components, parted_by
from .line import straight_line
from .ompl_planner import PathResult, ompl_path
from .plan import PlanReport, plan, plan_report
from .validity import Validity
from .waypoints import tucked_rows, waypoint_rows
from .ways import Way, distinct_ways

__all__ = [
    "Alternative",
    "AlternativesReport",
    "Component",
    "FamilyParams",
    "FamilyReport",
    "GridPath",
    "PathResult",
    "PlanReport",
    "StripFamily",
    "Validity",
    "Way",
    "base_class",
    "base_components",
    "certify_path",
    "check_ends",
    "distinct_ways",
    "grid_path",
    "ompl_path",
    "parted_by",
    "plan",
    "plan_alternatives",
    "plan_report",
    "straight_line",
    "strip_cost",
    "tucked_rows",
    "waypoint_rows",
]
