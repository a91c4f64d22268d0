"""Users of a machine process, for processes of their own: what they run has to be found by name."""

from __future__ import annotations

import time
from collections.abc import Callable
from multiprocessing.connection import Connection

import numpy as np

from elastic_strips.control.interfaces import Command
from elastic_strips.sim.machine_process import MachineDriver, MachineProcess
from elastic_strips.sim.plant import Plant

_LONGEST = 300.0  # [s]


def execute(driver: MachineDriver, epoch: float) -> None:
    """Drive straight on until somebody kills this process."""
    end = time.monotonic() + _LONGEST
    while time.monotonic() < end:
        driver.send(time.monotonic() - epoch, Command(np.full(2, 0.3), np.zeros(0)))
        time.sleep(0.01)


def own(make_plant: Callable[[], Plant], coordinates: np.ndarray, told: Connection) -> None:
    """Start a machine, tell its process id, and drive."""
    with MachineProcess(make_plant, coordinates) as machine:
        told.send(machine.pid)
        execute(machine.driver(), machine.epoch)
