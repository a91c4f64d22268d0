"""Sweeps: scenarios × robots × presets × parameters × seeds, as a table that grows while they run (docs/sweeps.md)."""

from .document import Plot, Sweep, SweepError, read_sweep
from .plot import plot_sweep
from .runs import Run, execute
from .store import SweepStore, run_sweep

__all__ = ["Plot", "Run", "Sweep", "SweepError", "SweepStore", "execute", "plot_sweep", "read_sweep", "run_sweep"]
