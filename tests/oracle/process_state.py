"""What belongs to a process, and so to all tests that run in it: a test has to leave it as it found it."""

from __future__ import annotations

import logging
import os
import sys

import numpy as np

from elastic_strips.native import kernel


def settings() -> dict[str, object]:
    """What belongs to the process, and so to all tests that run in it."""
    names = (None, "elastic_strips")
    return {
        "logging.disable": logging.root.manager.disable,
        "levels of logs": [logging.getLogger(name).level for name in names],
        "handlers of logs": [
            [h for h in logging.getLogger(name).handlers if not type(h).__module__.startswith("_pytest.")]
            for name in names
        ],
        "propagation of logs": logging.getLogger("elastic_strips").propagate,
        "environment": {k: v for k, v in os.environ.items() if k != "PYTEST_CURRENT_TEST"},
        "folder": os.getcwd(),
        "print options of NumPy": np.get_printoptions(),
        "floating-point errors of NumPy": np.geterr(),
        "native kernel": kernel(),
        "import path": list(sys.path),
    }


def changed(before: dict[str, object]) -> list[str]:
    """What is set otherwise now."""
    now = settings()
    return [f"{name}: {before[name]} → {now[name]}" for name in before if before[name] != now[name]]
