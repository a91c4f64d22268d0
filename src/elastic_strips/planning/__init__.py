"""Planning: initial strips, alternatives on other sides of the obstacles, and families of them."""

from .alternatives import Alternative, AlternativesReport, plan_alternatives, strip_cost
from .ends import check_ends
from .family import FamilyParams, FamilyReport, StripFamily
from .grid_path import GridPath, grid_path
from .homotopy import Component, Way, base_class, base_components, distinct_ways, parted_by
from .line import straight_line, tucked_rows, waypoint_rows
from .ompl_planner import PathResult, ompl_path
from .plan import PlanReport, plan, plan_report
from .validity import Validity, certify_path

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
