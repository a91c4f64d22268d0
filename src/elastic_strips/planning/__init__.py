"""Planning: an initial strip, or several on different sides of the obstacles, and sets of them kept in a scene."""

from .approach import ApproachReport, plan_approach
from .goal_search import GoalSearch, find_goals
from .goals import AllOf, BasePose, Goal, HandPose
from .grid_path import grid_path
from .homotopy.alternatives import Alternative
from .homotopy.strip_set import StripSet, StripSetParams, StripSetReport
from .initial_strip import straight_line
from .ompl_planner import ompl_path
from .plan import plan, plan_report
from .problem import check_endpoints
from .report import PlanReport
from .straight import plan_straight

__all__ = [
    "AllOf",
    "Alternative",
    "ApproachReport",
    "BasePose",
    "Goal",
    "GoalSearch",
    "HandPose",
    "PlanReport",
    "StripSet",
    "StripSetParams",
    "StripSetReport",
    "check_endpoints",
    "find_goals",
    "grid_path",
    "ompl_path",
    "plan",
    "plan_approach",
    "plan_report",
    "plan_straight",
    "straight_line",
]
