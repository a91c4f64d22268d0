"""Scene room, input checks: every number, vector, quaternion and pose that enters a scene passes here.

Each check returns a clean value (a float or a read-only array) or raises `SceneError` naming the quantity, its value
and the bound.
"""

from __future__ import annotations

import math
import numbers
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_strips.errors import SceneError

from ..validation import shown

Array = NDArray[np.float64]

MAX_LENGTH = 1e6
"""Largest size or coordinate that is accepted [m]."""

MIN_LENGTH = 1e-6
"""Smallest size that is accepted [m]; below it the distances (accurate to about 3e-6 m) mean nothing."""

QUAT_TOLERANCE = 1e-6
"""A quaternion whose norm differs from 1 by no more is renormalised, any other one is refused."""

POSE_TOLERANCE = 1e-6
"""A rotation matrix whose columns are orthonormal to this is accepted."""


def number(
    what: str,
    value: Any,
    *,
    low: float = -MAX_LENGTH,
    high: float = MAX_LENGTH,
    unit: str = "m",
) -> float:
    """Check a finite number in [low, high] (a bool, a string or NaN is none)."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (numbers.Real, np.floating, np.integer)):
        raise SceneError(f"{what} must be a number [{unit}], not {shown(value)}")
    try:
        result = float(value)
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        raise SceneError(f"{what} must be finite, not {shown(value)}")
    if not low <= result <= high:
        raise SceneError(f"{what} is {result:g}, outside [{low:g}, {high:g}] {unit}")
    return result


def length(what: str, value: Any) -> float:
    """Check a size: a number in [MIN_LENGTH, MAX_LENGTH] [m]."""
    return number(what, value, low=MIN_LENGTH, high=MAX_LENGTH)


def array(what: str, value: Any, shape: tuple[int | None, ...], *, limit: float = MAX_LENGTH) -> Array:
    """Check a finite array and return a read-only float copy of it.

    Args:
        what: Name of the quantity for the message.
        value: Anything that numpy can turn into an array of numbers.
        shape: Wanted shape; ``None`` is any length of at least one.
        limit: Bound of every entry's absolute value.
    """
    wanted = "(" + ", ".join("n" if n is None else str(n) for n in shape) + ("," if len(shape) == 1 else "") + ")"
    try:
        raw = np.asarray(value)
    except ValueError:
        raise SceneError(f"{what} must be an array of shape {wanted}, not {shown(value)}") from None
    if raw.dtype.kind not in "fiu" or _holds_bool(value):
        raise SceneError(f"{what} must hold numbers (shape {wanted}), not {shown(value)}")
    if raw.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, raw.shape, strict=True)):
        raise SceneError(f"{what} must have the shape {wanted}, not {raw.shape}: {shown(value)}")
    if raw.size == 0:
        raise SceneError(f"{what} is empty; at least one entry is needed")
    result = np.array(raw, dtype=np.float64)
    bad = ~(np.abs(result) <= limit)
    if bad.any():
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        raise SceneError(f"{what}{list(where)} is {result[where]:g}; it must be finite and within ±{limit:g}")
    result.flags.writeable = False
    return result


def _holds_bool(value: Any) -> bool:
    """Numpy turns ``[True, 1.0]`` into floats; say whether a short sequence holds a bool."""
    if isinstance(value, np.ndarray) or not isinstance(value, (list, tuple)):
        return False
    rows = (v if isinstance(v, (list, tuple)) else (v,) for v in value)
    return any(isinstance(entry, bool) for row in rows for entry in row)


def sizes(what: str, value: Any, count: int) -> Array:
    """Check a read-only vector of ``count`` sizes in [MIN_LENGTH, MAX_LENGTH] [m]."""
    result = array(what, value, (count,))
    if result.min() < MIN_LENGTH:
        raise SceneError(f"{what} is {shown(result.tolist())}; every entry must be at least {MIN_LENGTH:g} m")
    return result


def quaternion(what: str, value: Any) -> Array:
    """Check a unit quaternion (x, y, z, w) and return it normalised, read-only."""
    result = array(what, value, (4,), limit=1e3)
    norm = float(np.linalg.norm(result))
    if abs(norm - 1.0) > QUAT_TOLERANCE:
        raise SceneError(
            f"{what} is {shown(result.tolist())} with norm {norm:.9g}; a unit quaternion (x, y, z, w) is needed "
            f"(norm within {QUAT_TOLERANCE:g} of 1)"
        )
    result = result / norm
    result.flags.writeable = False
    return result


def rotation_of(quat: Array) -> Array:
    """Rotation matrix (3, 3) of a unit quaternion (x, y, z, w)."""
    x, y, z, w = quat.tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_of(rotation: Array) -> Array:
    """Unit quaternion (x, y, z, w), w >= 0, of a rotation matrix (3, 3)."""
    m = rotation
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    i = int(np.argmax([m[0, 0], m[1, 1], m[2, 2], trace]))
    q = np.empty(4)
    if i == 3:
        q[:] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], 1.0 + trace
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q[i] = 1.0 + 2.0 * m[i, i] - trace
        q[j], q[k], q[3] = m[j, i] + m[i, j], m[k, i] + m[i, k], m[k, j] - m[j, k]
    q /= np.linalg.norm(q)
    return -q if q[3] < 0 else q


def placement(at: Any, quat: Any) -> Array:
    """Pose (4, 4), read-only, of a position [m] and a unit quaternion (x, y, z, w)."""
    pose = np.eye(4)
    pose[:3, 3] = array("at", at, (3,))
    pose[:3, :3] = rotation_of(quaternion("quat", quat))
    pose.flags.writeable = False
    return pose


def pose(value: Any) -> Array:
    """Check a pose (4, 4) [m] (or an object with ``.homogeneous`` such as ``pin.SE3``); return a read-only copy."""
    value = getattr(value, "homogeneous", value)
    if not isinstance(value, np.ndarray) or value.dtype != np.float64 or value.shape != (4, 4):
        value = array("pose", value, (4, 4))
    result = value.copy()
    (a, b, c, x), (d, e, f, y), (g, h, i, z), last = result.tolist()
    if not (abs(x) <= MAX_LENGTH and abs(y) <= MAX_LENGTH and abs(z) <= MAX_LENGTH):
        raise SceneError(f"the pose's position is {[x, y, z]}; it must be finite and within ±{MAX_LENGTH:g} m")
    error = max(
        abs(a * a + d * d + g * g - 1),
        abs(b * b + e * e + h * h - 1),
        abs(c * c + f * f + i * i - 1),
        abs(a * b + d * e + g * h),
        abs(a * c + d * f + g * i),
        abs(b * c + e * f + h * i),
        abs(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) - 1),
    )
    if not error <= POSE_TOLERANCE or last != [0.0, 0.0, 0.0, 1.0]:
        raise SceneError(
            f"the pose is no rigid transform (orthonormality error {error:.3g}, allowed {POSE_TOLERANCE:g}; last row "
            f"{last}, needed [0, 0, 0, 1])"
        )
    if error > 1e-12:
        u, _, vt = np.linalg.svd(result[:3, :3])
        result[:3, :3] = u @ vt
    result.flags.writeable = False
    return result


def name(value: Any) -> str | None:
    """Check an obstacle's name: ``None`` or a non-empty printable string of at most 200 characters."""
    if value is None:
        return None
    if not isinstance(value, str) or not value.strip() or not value.isprintable() or len(value) > 200:
        raise SceneError(f"name must be a non-empty printable string of at most 200 characters, not {shown(value)}")
    return value
