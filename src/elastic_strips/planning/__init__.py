"""Planning: initial strips."""

from .ends import check_ends
from .line import straight_line
from .ompl_planner import PathResult, ompl_path
from .plan import PlanReport, plan, plan_report
from .validity import Validity

__all__ = ["PathResult", "PlanReport", "Validity", "check_ends", "ompl_path", "plan", "plan_report", "straight_line"]
