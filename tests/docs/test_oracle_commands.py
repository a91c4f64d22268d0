"""The commands of the oracle that the docs name start from a checkout, without a path that is set for them."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEXTS = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md")))
COMMANDS = sorted({name for text in TEXTS for name in re.findall(r"python (tests/oracle/\w+\.py)", text.read_text())})


def test_the_docs_name_some():
    assert len(COMMANDS) > 3


@pytest.mark.parametrize("command", COMMANDS)
def test_it_starts(command):
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    ended = subprocess.run([sys.executable, command, "--help"], cwd=ROOT, env=clean, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr[-500:]
    assert "usage" in ended.stdout.lower()
