"""The registry of named scenarios."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from elastic_strips.catalogue import SCENARIOS
from elastic_strips.errors import ScenarioError, nearest_name
from elastic_strips.io import PoseSpec, read_scenario
from elastic_strips.validation import named_arguments, shown

from .corridors import CORRIDOR_LENGTH, COURTEOUS, COURTEOUS_SPEEDS, MOVING, corridor_scene, moving_corridor
from .halls import BOTTLENECK, CLOSING, CLUTTER, DEAD_END, bottleneck, closing_side, clutter, dead_end
from .paper_cases import TABLE_2, paper_case
from .scenario import Scenario


def _corridor(seed: int) -> Scenario:
    start, goal = PoseSpec(0.0, 0.0, 0.0), PoseSpec(CORRIDOR_LENGTH, 0.0, 0.0)
    return Scenario("corridor", SCENARIOS["corridor"], corridor_scene(seed), start, goal, seed=seed)


def _case(name: str) -> Callable[[int], Scenario]:
    return lambda seed: paper_case(name)


_REGISTRY: dict[str, Callable[[int], Scenario]] = {
    **{name: _case(name) for name in TABLE_2},
    "corridor": _corridor,
    CLUTTER: clutter,
    CLOSING: closing_side,
    BOTTLENECK: bottleneck,
    DEAD_END: dead_end,
    MOVING: moving_corridor,
    COURTEOUS: lambda seed: moving_corridor(seed, speed=COURTEOUS_SPEEDS, yielding=True),
}
"""Scenario name → maker, given a seed."""


def scenario_names() -> tuple[str, ...]:
    """Names of the scenarios of :func:`get_scenario`."""
    return tuple(_REGISTRY)


@named_arguments
def get_scenario(name_or_path: str | Path, *, seed: int = 0) -> Scenario:
    """A scenario by name, or from a YAML file (a path that ends in .yaml or .yml, or holds a separator, or exists).

    Raises:
        ScenarioError: an unknown name, or an error in the file.
    """
    if not isinstance(name_or_path, (str, Path)):
        raise ScenarioError(f"a scenario has a name or a file, not {shown(name_or_path)}")
    text = str(name_or_path)
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise ScenarioError(f"seed={shown(seed)} must be an integer ≥ 0")
    if text in _REGISTRY:
        return _REGISTRY[text](seed)
    path = Path(text)
    if path.suffix.lower() == ".npz":
        raise ScenarioError(f"{text}: is not a scenario; 'elastic-strips view' replays the record of a drive")
    if text and (path.suffix.lower() in (".yaml", ".yml") or "/" in text or os.path.exists(path)):
        return Scenario.from_spec(read_scenario(path))
    raise ScenarioError(f"unknown scenario {text!r}{nearest_name(text, _REGISTRY)} Or give a .yaml file.")
