"""Scene room, obstacle: the immutable value that all shapes share: a solid, its pose, its motion, its name."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np

from elastic_strips.errors import SceneError
from elastic_strips.scene import checks
from elastic_strips.scene.checks import Array
from elastic_strips.scene.motion import Motion, check_motion
from elastic_strips.scene.parts import Part, Solid
from elastic_strips.summary import shortened

_put = object.__setattr__
_Self = TypeVar("_Self", bound="Obstacle")


class Obstacle:
    """A rigid solid obstacle in the world; make one by `Box`, `Sphere`, … (each of them is an `Obstacle`).

    Attributes:
        name: Name, or None as long as no scene has named it.
        shape: "box", "sphere", "cylinder", "capsule", "cone", "convex", "mesh", "voxels" or "points".
        pose: Pose T_world_obstacle (4, 4) at `time` [m], read-only.
        motion: How the obstacle moves; None if it does not.
        time: Time [s] that `pose` belongs to.
        anchor: Pose (4, 4) at `anchor_time`, from which `motion` starts.
        anchor_time: Time [s]; 0 unless the obstacle was `moved` at another time.
        solid: Parts and bounds in the obstacle's frame, shared by all copies.
        spec: Parameters of the shape, such as {"radius": 0.2}; not to be changed.
    """

    __slots__ = ("anchor", "anchor_time", "motion", "name", "pose", "shape", "solid", "spec", "time")

    name: str | None
    shape: str
    pose: Array
    motion: Motion | None
    time: float
    anchor: Array
    anchor_time: float
    solid: Solid
    spec: dict[str, Any]

    def _fill(
        self, shape: str, spec: dict[str, Any], solid: Solid, *, at: Any, quat: Any, name: Any, motion: Any
    ) -> None:
        anchor = checks.placement(at, quat)
        _put(self, "name", checks.name(name))
        _put(self, "shape", shape)
        _put(self, "motion", check_motion(motion))
        pose = _pose_at(motion, anchor, 0.0)
        if motion is not None and not motion.relative:
            _check_agreement(anchor, pose)
        _put(self, "pose", pose)
        _put(self, "time", 0.0)
        _put(self, "anchor", anchor)
        _put(self, "anchor_time", 0.0)
        _put(self, "solid", solid)
        _put(self, "spec", spec)

    def _copy(self: _Self, name: str | None, pose: Array, time: float, anchor: Array, anchor_time: float) -> _Self:
        new = object.__new__(type(self))
        _put(new, "name", name)
        _put(new, "shape", self.shape)
        _put(new, "pose", pose)
        _put(new, "motion", self.motion)
        _put(new, "time", time)
        _put(new, "anchor", anchor)
        _put(new, "anchor_time", anchor_time)
        _put(new, "solid", self.solid)
        _put(new, "spec", self.spec)
        return new

    @property
    def parts(self) -> tuple[Part, ...]:
        """The convex parts in the obstacle's frame; the same objects in all copies of the obstacle."""
        return self.solid.parts

    @property
    def reach(self) -> float:
        """Radius [m] of a sphere about the obstacle's origin that holds the obstacle."""
        return self.solid.reach

    def speed_bound(self, *, start: float | None = None, end: float | None = None) -> float:
        """Largest speed [m/s] of any point of the obstacle between ``start`` and ``end`` [s] (None: for ever)."""
        if self.motion is None:
            return 0.0
        shift = self._origin_time()
        return self.motion.speed_bound(
            self.reach, start=None if start is None else start - shift, end=None if end is None else end - shift
        )

    def velocity(self) -> tuple[Array, Array]:
        """Velocity of the origin (3,) [m/s] and angular velocity (3,) [rad/s] at `time`, world frame."""
        if self.motion is None:
            return np.zeros(3), np.zeros(3)
        return self.motion.velocity(self.anchor, self.time - self._origin_time())

    def moved(self: _Self, pose: Any) -> _Self:
        """Copy at ``pose`` (4, 4) (or a ``pin.SE3``) [m] now, sharing the parts; a twist goes on from there.

        `Keyframes` are absolute: the copy is back on its track at the next `at`.
        """
        pose = checks.pose(pose)
        return self._copy(self.name, pose, self.time, pose, self.time)

    def sensed(self: _Self, pose: Array, motion: Motion | None) -> _Self:
        """Copy as a sensor sees it: at ``pose`` (4, 4) [m] now, and moving from there as ``motion`` says.

        Shares the parts; ``pose`` and ``motion`` are not checked.
        """
        new = self._copy(self.name, pose, self.time, pose, self.time)
        _put(new, "motion", motion)
        return new

    def at(self: _Self, t: float) -> _Self:
        """Copy at its pose at time ``t`` [s], or itself if it does not move."""
        t = checks.number("time", t, low=-1e12, high=1e12, unit="s")
        if self.motion is None or self.motion.still or t == self.time:
            return self
        pose = _pose_at(self.motion, self.anchor, t - self._origin_time())
        return self._copy(self.name, pose, t, self.anchor, self.anchor_time)

    def named(self: _Self, name: str) -> _Self:
        """Copy with another name."""
        if checks.name(name) is None:
            raise SceneError("name must be a non-empty printable string, not None")
        return self._copy(name, self.pose, self.time, self.anchor, self.anchor_time)

    def _origin_time(self) -> float:
        """Time [s] at which the motion's own clock is zero."""
        return self.anchor_time if self.motion is None or self.motion.relative else 0.0

    def __repr__(self) -> str:
        values = ", ".join(
            f"{k}={v.tolist() if v.size <= 4 else f'<{len(v)} rows>'}" if isinstance(v, np.ndarray) else f"{k}={v!r}"
            for k, v in self.spec.items()
        )
        moving = "" if self.motion is None else f", motion={type(self.motion).__name__}"
        at = [round(x, 6) for x in self.pose[:3, 3].tolist()]
        return f"{type(self).__name__}({shortened(f'{values}, at={at}, name={self.name!r}{moving}')})"

    def __setattr__(self, key: str, value: object) -> None:
        raise AttributeError(f"{type(self).__name__} is immutable; {key!r} cannot be set. Use moved, at or named")

    def __delattr__(self, key: str) -> None:
        raise AttributeError(f"{type(self).__name__} is immutable; {key!r} cannot be deleted")

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (type(self), {key: getattr(self, key) for key in Obstacle.__slots__})


def _restored(kind: type[Obstacle], state: dict[str, Any]) -> Obstacle:
    """Rebuild a pickled obstacle."""
    new = object.__new__(kind)
    for key, value in state.items():
        _freeze(value)
        _put(new, key, value)
    return new


def _pose_at(motion: Motion | None, anchor: Array, t: float) -> Array:
    if motion is None:
        return anchor
    pose = motion.pose(anchor, t)
    if not np.abs(pose[:3, 3]).max() <= checks.MAX_LENGTH:
        raise SceneError(f"at t = {t:g} s a motion leads to {pose[:3, 3].tolist()}, beyond {checks.MAX_LENGTH:g} m")
    pose.flags.writeable = False
    return pose


def _check_agreement(given: Array, begin: Array) -> None:
    """A motion with absolute poses says where the obstacle is: a pose that was given as well must not contradict it."""
    at, quat = given[:3, 3], given[:3, :3]
    if at.any() and np.abs(at - begin[:3, 3]).max() > checks.POSE_TOLERANCE:
        where = begin[:3, 3].tolist()
        raise SceneError(f"at is {at.tolist()}, but the keyframes say {where} at time 0; with keyframes leave 'at' out")
    if not np.array_equal(quat, np.eye(3)) and np.abs(quat - begin[:3, :3]).max() > checks.POSE_TOLERANCE:
        raise SceneError("quat contradicts the keyframes' quats at time 0; leave 'quat' out with keyframes' quats")


def _freeze(value: Any) -> None:
    """Numpy pickles no read-only flag: set it again."""
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif isinstance(value, dict):
        for entry in value.values():
            _freeze(entry)
