"""Scene room, quantities: lengths, times, points, quaternions and poses that enter a scene, checked; rotations.

Each check returns a clean value (a float or a read-only array) or raises `SceneError` naming the quantity, its value
and the bound.
"""

from __future__ import annotations

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import SceneError
from elastic_strips.validation import MAX_LENGTH, MIN_LENGTH, check_array, check_number, shown

_MAX_TIME = 1e12
"""Largest time that is accepted [s]."""

QUAT_TOLERANCE = 1e-6
"""A quaternion whose norm differs from 1 by at most this is renormalised; any other one is refused."""

POSE_TOLERANCE = 1e-6
"""A rotation matrix is accepted if its columns are orthonormal to within this."""


def check_time(what: str, value: object) -> float:
    """Check a time [s]."""
    return check_number(what, value, low=-_MAX_TIME, high=_MAX_TIME, unit="s", error=SceneError)


def check_length(what: str, value: object) -> float:
    """Check a size: a number in [MIN_LENGTH, MAX_LENGTH] [m]."""
    return check_number(what, value, low=MIN_LENGTH, high=MAX_LENGTH, unit="m", error=SceneError)


def check_points(what: str, value: object, shape: tuple[int | None, ...], *, limit: float = MAX_LENGTH) -> Array:
    """Check a finite array of this shape (None: any length) with entries within ±``limit``."""
    return check_array(what, value, shape, limit=limit, error=SceneError)


def check_sizes(what: str, value: object, count: int) -> Array:
    """Check a read-only vector of ``count`` sizes in [MIN_LENGTH, MAX_LENGTH] [m]."""
    result = check_points(what, value, (count,))
    if result.min() < MIN_LENGTH:
        raise SceneError(f"{what} is {shown(result.tolist())}; every entry must be at least {MIN_LENGTH:g} m")
    return result


def check_quaternion(what: str, value: object) -> Array:
    """Check a unit quaternion (x, y, z, w) and return it normalised, read-only."""
    result = check_points(what, value, (4,), limit=1e3)
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


def pose_of(at: object, quat: object) -> Array:
    """Pose (4, 4), read-only, of a position [m] and a unit quaternion (x, y, z, w)."""
    pose = np.eye(4)
    pose[:3, 3] = check_points("at", at, (3,))
    pose[:3, :3] = rotation_of(check_quaternion("quat", quat))
    pose.flags.writeable = False
    return pose


def check_pose(value: object) -> Array:
    """Check a pose (4, 4) [m] (or an object with ``.homogeneous`` such as ``pin.SE3``); return a read-only copy.

    A rotation of single precision is made orthonormal.
    """
    value = getattr(value, "homogeneous", value)
    if not isinstance(value, np.ndarray) or value.dtype != np.float64 or value.shape != (4, 4):
        value = check_points("pose", value, (4, 4))
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
            f"the pose is not rigid (orthonormality error {error:.3g}, allowed {POSE_TOLERANCE:g}; last row "
            f"{last}, needed [0, 0, 0, 1])"
        )
    if error > 1e-12:
        u, _, vt = np.linalg.svd(result[:3, :3])
        result[:3, :3] = u @ vt
    result.flags.writeable = False
    return result
