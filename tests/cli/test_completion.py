"""Completion in a shell: the names that there are, and nothing heavy on the way to them."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from elastic_strips.catalogue import PLANTS, PRESETS, SCENARIOS
from elastic_strips.robot import robot_names
from elastic_strips.sim import FAULTS
from elastic_strips.sim.scenarios.drive import PLANTS as DRIVEN

HEAVY = {"numpy", "pinocchio", "coal", "scipy", "rich", "yaml", "lxml"}
PROGRAM = """
import sys
from elastic_strips.cli import main
try:
    main()
finally:
    sys.stderr.write("LOADED " + " ".join(m for m in sys.modules if "." not in m))
"""


def _completed(line: str) -> tuple[list[str], set[str]]:
    """What bash is offered for the last word of a line, and the top-level modules that were loaded for it."""
    words = line.split(" ")
    env = {
        **os.environ, "_ELASTIC_STRIPS_COMPLETE": "bash_complete", "COMP_WORDS": line,
        "COMP_CWORD": str(len(words) - 1),
    }  # fmt: skip
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=120, env=env)
    told = done.stderr.split("LOADED ")
    assert not told[0], done.stderr
    return [row.partition(",")[2] for row in done.stdout.splitlines()], set(told[1].split())


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("elastic-strips d", ["doctor", "drag", "drive"]),
        ("elastic-strips run ca", [*(name for name in SCENARIOS if name.startswith("ca")), "ca"]),
        ("elastic-strips run case-1 --preset ", list(PRESETS)),
        ("elastic-strips drive case-1 --disturb slip-l", ["slip-left@"]),
        ("elastic-strips certify path.csv --robot silver", ["silvermate", "silver"]),
        ("elastic-strips run case-1 --robot ", [*robot_names(), ""]),
    ],
)
def test_names_are_completed_at_once(line: str, expected: list[str]) -> None:
    found, loaded = _completed(line)
    assert found == expected
    assert not loaded & HEAVY


def test_the_catalogue_has_the_names_that_are_driven() -> None:
    assert tuple(PLANTS) == DRIVEN
    assert FAULTS


@pytest.mark.parametrize(
    ("line", "among"),
    [
        ("elastic-strips certify path.csv --interpolation ", "arc"),
    ],
)
def test_names_of_modules_that_load_late_are_completed_too(line: str, among: str) -> None:
    assert among in _completed(line)[0]
