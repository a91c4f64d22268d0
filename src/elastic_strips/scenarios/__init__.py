"""Scenarios: named problems and YAML files, and running them."""

from .corridor import corridor_scene
from .document import FORMAT, FORMAT_VERSION, result_document
from .passage import passage
from .registry import get_scenario, scenario_names
from .run import RunResult, run_scenario
from .scenario import Scenario

__all__ = [
    "FORMAT",
    "FORMAT_VERSION",
    "result_document",
    "RunResult",
    "Scenario",
    "corridor_scene",
    "get_scenario",
    "passage",
    "run_scenario",
    "scenario_names",
]
