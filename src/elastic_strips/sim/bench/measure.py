"""Percentiles and the like, shared by the benchmarks."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from elastic_strips._version import __version__


def percentiles(values: Sequence[float] | npt.NDArray[np.float64], *, scale: float = 1.0) -> dict[str, Any]:
    """p50, p90, p95, p99 and max of values, times ``scale``."""
    array = np.asarray(values, dtype=float) * scale
    if len(array) == 0:
        return {"p50": None, "p90": None, "p95": None, "p99": None, "max": None}
    return {f"p{p}": float(np.percentile(array, p)) for p in (50, 90, 95, 99)} | {"max": float(array.max())}


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    import coal
    import pinocchio as pin

    return {
        "elastic_strips": __version__,
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        "processor": platform.machine(),
        "pinocchio": pin.__version__,
        "coal": coal.__version__,
        "numpy": np.__version__,
    }
