"""Measurement: percentiles, and a description of the machine."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from elastic_strips._version import __version__

Figures: TypeAlias = dict[str, Any]
"""Measured values by name: numbers, texts, lists and further figures, ready for JSON."""
Note: TypeAlias = Callable[[str], object]
"""Called after each piece of work with a few words, for a progress bar."""


def silent(note: str) -> None:
    """A :data:`Note` that goes nowhere."""


def percentiles(values: Sequence[float] | npt.NDArray[np.float64], *, scale: float = 1.0) -> Figures:
    """p50, p90, p95, p99 and max of values, times ``scale``."""
    array = np.asarray(values, dtype=float) * scale
    if len(array) == 0:
        return {"p50": None, "p90": None, "p95": None, "p99": None, "max": None}
    return {f"p{p}": float(np.percentile(array, p)) for p in (50, 90, 95, 99)} | {"max": float(array.max())}


def head(benchmark: str, **what: object) -> Figures:
    """First figures of a benchmark: its name, the machine, and the values of ``what``."""
    import coal
    import pinocchio as pin

    machine = {
        "elastic_strips": __version__,
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        "processor": platform.machine(),
        "pinocchio": pin.__version__,
        "coal": coal.__version__,
        "numpy": np.__version__,
    }
    return {"benchmark": benchmark, "machine": machine, **what}


def resident() -> float:
    """Resident memory of this process [MB]."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
