"""Proximity room, contacts: what is near along a strip, as flat arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..robot.space import Array


@dataclass(frozen=True, slots=True)
class Contacts:
    """Body–part pairs of a strip that are within the influence distance.

    Attributes:
        node, body, part: (K,) indices; ``part`` counts in the engine's window.
        distance: (K,) signed distance [m].
        direction: (K, 3) unit vectors away from the obstacle, world frame.
        witness: (K, 3) nearest points on the robot, world frame [m].
    """

    node: npt.NDArray[np.intp]
    body: npt.NDArray[np.intp]
    part: npt.NDArray[np.intp]
    distance: Array
    direction: Array
    witness: Array

    def __len__(self) -> int:
        return len(self.node)
