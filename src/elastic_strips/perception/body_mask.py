"""The robot in its own images: pixels that its posed bodies may cover say nothing of the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from elastic_strips.arrays import Array, ArrayLike, Mask
from elastic_strips.errors import ParameterError
from elastic_strips.robot import RobotModel
from elastic_strips.validation import check_number

from .own_body import OwnBodies, Posture
from .rays import Nearest, Rays
from .readings import NO_ANSWER, DepthImage, RangeImage

_SAME_PLACE = 1e-9  # [m], and of rotation matrices: nothing has moved


@dataclass(frozen=True, slots=True, eq=False)
class _Outline:
    """The robot in an image: poses of its joints (n, 4, 4) and of the sensor (4, 4) in the base's frame, where pixels
    look (H, W, 3) and how far [m]; lengths (H, W) of these directions, and where rays meet the robot as it is, and
    grown (H, W) [m]."""

    T_base_joint: Array
    T_base_sensor: Array
    directions: Array
    longest: float
    stretch: Array
    as_it_is: Array
    grown: Array

    def of(self, image: DepthImage | RangeImage, T_base_joint: Array) -> bool:
        """Whether another image shows the same of it."""
        longest = image.depth_max if isinstance(image, DepthImage) else image.range_max
        if image.directions() is not self.directions or longest != self.longest:
            return False
        moved = np.abs(T_base_joint - self.T_base_joint).max(), np.abs(image.T_base_sensor - self.T_base_sensor).max()
        return bool(max(moved) < _SAME_PLACE)


class BodyMask:
    """Workspace: tells which pixels of an image may be of the robot itself.

    Args:
        robot: the robot that carries the sensors.
        margin: by how much its bodies are thought thicker [m]: what the joints' positions, the sensor's place on the
            robot and their times may be wrong by at a body's surface.

    Raises:
        ParameterError: a margin below 0.
    """

    def __init__(self, robot: RobotModel, margin: float = 0.03) -> None:
        self.robot: RobotModel = robot
        self.margin: float = check_number("margin", margin, low=0.0, unit="m")
        self._posture = Posture(robot)
        # as they are, too: of a body within whose margin the sensor is, its own surface is what covers
        self._bodies = OwnBodies(robot.geometries, 0.0)
        self._grown = OwnBodies(robot.geometries, self.margin) if self.margin else None
        self._last: dict[str, _Outline] = {}  # sensor → the robot in its last image

    def covered(self, image: DepthImage | RangeImage, q: ArrayLike | None = None) -> Mask:
        """(H, W) pixels along which the robot may be met before, or where, the image says that something is.

        Something nearer than the robot by more than the margin is not of the robot. A body that the sensor is in is its
        housing: it covers nothing.

        Args:
            image: an image.
            q: (nq,) configuration of the robot when it was taken, where the image does not have it.

        Raises:
            ParameterError: neither says how the robot stood.
            ConfigurationError: a configuration that is none of this robot.
        """
        return self._looked(image, q)[0]

    def _looked(self, image: DepthImage | RangeImage, q: ArrayLike | None) -> tuple[Mask, Array]:
        """What is covered (H, W), and where its rays meet the robot as it is (H, W) [m], infinite beside it."""
        if q is None:
            q = image.q
        if q is None:
            raise ParameterError(f"the image of {image.sensor!r} does not say how the robot stood: hand over its q")
        self._posture.place(self.robot.space.to_coordinates(self.robot.check_q(q)))
        T_base_joint = self._posture.T_base_world @ self._posture.T_world_joint
        outline = self._last.get(image.sensor)
        if outline is None or not outline.of(image, T_base_joint):
            outline = self._last[image.sensor] = self._outline(image, T_base_joint)
        measured = image.ranges * outline.stretch
        return np.isfinite(outline.grown) & ~(measured < outline.grown), outline.as_it_is

    def _outline(self, image: DepthImage | RangeImage, T_base_joint: Array) -> _Outline:
        directions = image.directions()
        stretch = np.linalg.norm(directions, axis=-1)
        local = Rays(np.zeros((1, 3)), (directions / stretch[..., None]).reshape(-1, 3))
        longest = image.depth_max if isinstance(image, DepthImage) else image.range_max
        nearest = Nearest(stretch.size)
        rays, reach = local.moved(image.T_base_sensor), longest * float(stretch.max())
        self._bodies.cast(T_base_joint, rays, nearest, reach)
        as_it_is = nearest.distance.reshape(stretch.shape).copy()
        if self._grown is not None:
            self._grown.cast(T_base_joint, rays, nearest, reach)
        grown = nearest.distance.reshape(stretch.shape)
        return _Outline(T_base_joint, image.T_base_sensor, directions, longest, stretch, as_it_is, grown)

    def place_of(self, q: ArrayLike, base: float, top: float, margin: float, cell: float) -> Array:
        """Points (n, 3) [m] of a grid, in the base's frame, where the robot is taken to be: in an upright cylinder of
        radius ``base`` about the base, up to a height ``top``, and within ``margin`` of the capsules about its bodies.

        Args:
            q: (nq,) configuration.
            base, top, margin: these distances [m].
            cell: from point to point [m].
        """
        capsules = self._capsules(q, margin)
        low = np.min([np.minimum(a, b) - r for a, b, r in capsules], axis=0)
        high = np.max([np.maximum(a, b) + r for a, b, r in capsules], axis=0)
        low, high = np.minimum(low, (-base, -base, 0.0)), np.maximum(high, (base, base, top))
        axes = [np.arange(start, end + cell, cell) for start, end in zip(low, high, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        own = (np.hypot(points[:, 0], points[:, 1]) <= base) & (points[:, 2] <= top)
        return points[own | _within(points, capsules)]

    def near(self, points: Array, q: ArrayLike, margin: float) -> Mask:
        """Which of the points (n, 3) [m], in the base's frame, are in one of the capsules about the robot's bodies in
        configuration ``q`` (nq,), larger by ``margin`` [m]."""
        return _within(points, self._capsules(q, margin))

    def above_or_below(self, places: Array, q: ArrayLike, margin: float) -> Mask:
        """Which of the places (n, 2) [m], in the base's plane, have one of the capsules about the
        robot's bodies in configuration ``q`` (nq,), larger by ``margin`` [m], above or below them."""
        return _within(places, [(a[:2], b[:2], r) for a, b, r in self._capsules(q, margin)])

    def _capsules(self, q: ArrayLike, margin: float) -> list[tuple[Array, Array, float]]:
        """About the robot's bodies in the base's frame, larger by ``margin`` [m]: both ends (3,) and radius."""
        self._posture.place(self.robot.space.to_coordinates(self.robot.check_q(q)))
        T = self._posture.T_base_world @ self._posture.T_world_joint
        return [
            (
                T[p.joint, :3, :3] @ p.capsule.a + T[p.joint, :3, 3],
                T[p.joint, :3, :3] @ p.capsule.b + T[p.joint, :3, 3],
                p.capsule.r + margin,
            )
            for p in self.robot.geometries
        ]

    def without(self, image: DepthImage | RangeImage, q: ArrayLike | None = None) -> DepthImage | RangeImage:
        """The image with ``NO_ANSWER`` where the robot may be; arguments and errors are those of :meth:`covered`."""
        return self.apart(image, q)[0]

    def apart(
        self, image: DepthImage | RangeImage, q: ArrayLike | None = None
    ) -> tuple[DepthImage | RangeImage, Array]:
        """The image as :meth:`without` gives it, and the robot: how far along its pixels' rays its bodies as they are
        begin (H, W) [m], infinite where they are not met."""
        covered, own = self._looked(image, q)
        kept = np.where(covered, np.float32(NO_ANSWER), image.ranges)
        return (replace(image, depth=kept) if isinstance(image, DepthImage) else replace(image, ranges=kept)), own


def _within(points: Array, capsules: Sequence[tuple[Array, Array, float]]) -> Mask:
    """Which of the points (n, 3), or (n, 2) of a plane, lie in capsules."""
    inside = np.zeros(len(points), dtype=bool)
    for a, b, r in capsules:
        near = np.flatnonzero(
            ((points >= np.minimum(a, b) - r) & (points <= np.maximum(a, b) + r)).all(axis=1) & ~inside
        )
        along, d = b - a, points[near] - a
        part = np.clip((d @ along) / max(float(along @ along), 1e-12), 0.0, 1.0)
        inside[near] = np.linalg.norm(d - part[:, None] * along, axis=1) <= r
    return inside
