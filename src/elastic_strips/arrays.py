"""Types of arguments and results: arrays of NumPy, and documents as JSON and YAML have them."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
Indices: TypeAlias = npt.NDArray[np.intp]
Mask: TypeAlias = npt.NDArray[np.bool_]
Image: TypeAlias = npt.NDArray[np.float32]
ArrayLike: TypeAlias = npt.ArrayLike
Document: TypeAlias = dict[str, object]
"""What is read from a file or written to one: names and plain values, lists and documents in it."""


def by_rows(*arrays: Array) -> tuple[Array, ...]:
    """The arrays as the native kernel reads them: contiguous float64, by rows; copies only where they are not."""
    return tuple(np.ascontiguousarray(array, dtype=float) for array in arrays)
