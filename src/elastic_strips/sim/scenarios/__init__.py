"""Scenarios: named problems and YAML files, and running them."""

from typing import TYPE_CHECKING

from elastic_strips._late import late_names

from .corridors import corridor_scene, moving_corridor
from .registry import get_scenario, scenario_names
from .run import RunResult, result_document, run_scenario
from .scenario import Scenario

if TYPE_CHECKING:
    from .drive import DriveOutcome, DriveSetup, drive_document, drive_scenario, make_simulation

__all__ = [
    "DriveOutcome",
    "DriveSetup",
    "drive_document",
    "drive_scenario",
    "make_simulation",
    "result_document",
    "RunResult",
    "Scenario",
    "corridor_scene",
    "get_scenario",
    "moving_corridor",
    "run_scenario",
    "scenario_names",
]

__getattr__ = late_names(  # running a scenario needs nothing of what driving needs
    __name__, {"drive": ("DriveOutcome", "DriveSetup", "drive_document", "drive_scenario", "make_simulation")}
)
