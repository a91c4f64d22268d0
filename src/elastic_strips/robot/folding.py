"""Folding: how far a joint may turn until it lays a link along the one before it, where nothing else says so.

A link and its parent are not kept apart: most are drawn in each other at their joint. But a joint whose stated range
is wider than the robot's shapes allow would fold an arm into itself, and the motion would be certified. So its range is
narrowed. Only shapes that the file has exactly are looked at: boxes, cylinders, spheres and capsules, as people write
them by hand; meshes come with limits that somebody has measured.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array, Mask
from elastic_strips.coal_shapes import ShapeKind, shape_of

from .unchecked_pairs import UncheckedPair, WhyUnchecked

_INSIDE = 5e-3  # [m] by which a point of one link has to be within the other one
_STEP = 0.1  # [rad] from one angle that is looked at to the next
_POINTS_ALONG = 25  # along the longest side of a shape
_LEAST_SPACING = 4e-3  # [m] of its points
_AT_JOINT = 2.0  # times the half thickness of a link: as far from their joint two links are in each other when bent
_PART = 1.0 / 3.0  # of the shorter link: so far they may be in each other, too
_LONGER = 1.5  # times as far as they may be: a link that reaches no further from the joint cannot be folded


@dataclass(frozen=True, slots=True)
class NarrowedRange:
    """The range of a joint as its links' shapes allow it.

    Attributes:
        low, high: its limits [rad].
        links: what would be in each other beyond.
    """

    low: float
    high: float
    links: tuple[str, str]

    def __str__(self) -> str:
        one, two = self.links
        return f"planned from {self.low:.3g} to {self.high:.3g} rad: beyond, {one} would lie in {two}"


def narrowed_ranges(
    model: pin.Model,
    collision: pin.GeometryModel,
    unchecked: Iterable[UncheckedPair],
    *,
    movable: Collection[str],
    said: Collection[frozenset[str]] = (),
    used: Mapping[str, Sequence[float]] | None = None,
) -> dict[str, NarrowedRange]:
    """The joints whose range is wider than their links' shapes allow, with what it may be about the neutral posture.

    Two links are folded where they are in each other further from the joint than where it bends them: than their
    thickness, and than a third of the shorter one. Links that are about as thick as long are left alone.

    Args:
        model: the robot as its file has it.
        collision: its shapes, as they are there.
        unchecked: pairs of links that are not kept apart; those that one joint joins are looked at.
        movable: the joints that may be narrowed.
        said: pairs that somebody has said may be in each other.
        used: joint → values [rad] that somebody has said it takes; beyond these it is not narrowed.
    """
    data, found = model.createData(), {}
    solids: dict[str, list[_Solid] | None] = {}
    for obj in collision.geometryObjects:
        if not 0 < obj.parentFrame < model.nframes:  # a shape that belongs to no link
            continue
        link = model.frames[obj.parentFrame].name
        solid, others = _solid(obj), solids.setdefault(link, [])
        solids[link] = None if solid is None or others is None else [*others, solid]
    for pair in unchecked:
        joint = pair.note
        if pair.why is not WhyUnchecked.JOINED or frozenset(pair.links) in said or joint not in movable:
            continue
        index = model.getJointId(joint)
        if model.nqs[index] != 1 or not model.joints[index].shortname().startswith("JointModelR"):
            continue  # what slides, and what turns without end
        parent, child = sorted(pair.links, key=lambda link: link == _carried_by(model, index))
        one, two = solids.get(parent), solids.get(child)
        if not one or not two:
            continue
        stated, allowed = _stated(model, index), _allowed(model, data, index, one, two)
        outside = [value for value in (used or {}).get(joint, ()) if not allowed[0] <= value <= allowed[1]]
        if allowed != stated and not outside:
            found[joint] = NarrowedRange(*allowed, (child, parent))
    return found


@dataclass(frozen=True, slots=True)
class _Solid:
    """A shape of the file: its joint, where it is there, what it is, and points of it (P, 3) in its own frame."""

    joint: int
    at: pin.SE3
    kind: ShapeKind
    size: tuple[float, ...]
    points: Array

    @property
    def half_sides(self) -> Array:
        """(3,) half sides [m] of the box about it."""
        return _half_sides(self.kind, self.size)

    def holds(self, points: Array, margin: float) -> Mask:
        """Which of points (P, 3) in its frame are within it by more than a margin [m]."""
        if self.kind is ShapeKind.BOX:
            return np.asarray((np.abs(points) < np.array(self.size) - margin).all(axis=1))
        radius, half = self.size[0] - margin, self.size[1] if len(self.size) > 1 else 0.0
        across, along = np.hypot(points[:, 0], points[:, 1]), np.abs(points[:, 2])
        if self.kind is ShapeKind.CYLINDER:
            return (across < radius) & (along < half - margin)
        return np.asarray(np.hypot(across, np.maximum(along - half, 0.0)) < radius)


def _half_sides(kind: ShapeKind, size: tuple[float, ...]) -> Array:
    if kind is ShapeKind.BOX:
        return np.array(size)
    radius, half = size[0], size[1] if len(size) > 1 else 0.0
    return np.array([radius, radius, half if kind is ShapeKind.CYLINDER else half + radius])


def _solid(obj: pin.GeometryObject) -> _Solid | None:
    """A shape with points in it, on a grid; None of one that is not exact."""
    kind, size = shape_of(obj.geometry)
    if kind not in (ShapeKind.BOX, ShapeKind.CYLINDER, ShapeKind.SPHERE, ShapeKind.CAPSULE):
        return None
    half = _half_sides(kind, size)
    spacing = max(2.0 * float(half.max()) / (_POINTS_ALONG - 1), _LEAST_SPACING)
    axes = [np.linspace(-x, x, max(3, int(2.0 * x / spacing) + 1)) for x in half]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    solid = _Solid(obj.parentJoint, obj.placement, kind, size, points)
    return _Solid(obj.parentJoint, obj.placement, kind, size, points[solid.holds(points, -1e-9)])


def _carried_by(model: pin.Model, index: int) -> str:
    """The link that a joint carries, of those that hang on it directly."""
    return next(
        (f.name for f in model.frames if f.parentJoint == index and f.type == pin.FrameType.BODY), model.names[index]
    )


def _stated(model: pin.Model, index: int) -> tuple[float, float]:
    at = model.idx_qs[index]
    return float(model.lowerPositionLimit[at]), float(model.upperPositionLimit[at])


def _allowed(
    model: pin.Model, data: pin.Data, index: int, one: Sequence[_Solid], two: Sequence[_Solid]
) -> tuple[float, float]:
    """The range [rad] of a joint about its neutral place in which the links on both sides of it are not folded."""
    low, high = _stated(model, index)
    q = np.clip(pin.neutral(model), model.lowerPositionLimit, model.upperPositionLimit)
    at = model.idx_qs[index]
    first = float(q[at])

    def overlap(angle: float) -> float:
        """How far from the joint the links are in each other [m]; 0 where they are not."""
        q[at] = angle
        pin.forwardKinematics(model, data, q)
        origin = data.oMi[index].translation
        far = 0.0
        for ours, theirs in ((one, two), (two, one)):
            for mine in ours:
                pose = data.oMi[mine.joint] * mine.at
                points = mine.points @ pose.rotation.T + pose.translation
                for other in theirs:
                    there = data.oMi[other.joint] * other.at
                    hit = points[other.holds((points - there.translation) @ there.rotation, _INSIDE)]
                    far = max(far, float(np.linalg.norm(hit - origin, axis=1).max(initial=0.0)))
        return far

    at_first = overlap(first)
    origin = data.oMi[index].translation
    reach = min(_reach(data, origin, each) for each in (one, two))
    thick = max(float(np.sort(solid.half_sides)[1]) for solid in (*one, *two))
    most = max(_AT_JOINT * thick, at_first, _PART * reach)
    if reach < _LONGER * most:
        return low, high

    def end(limit: float) -> float:
        far = min(max(limit - first, -2.0 * math.pi), 2.0 * math.pi)  # after a turn it is as before
        angles = first + np.linspace(0.0, far, math.ceil(abs(far) / _STEP) + 1)
        for before, angle in itertools.pairwise(angles.tolist()):
            if overlap(angle) > most:
                return before
        return limit

    return end(low), end(high)


def _reach(data: pin.Data, origin: Array, solids: Sequence[_Solid]) -> float:
    """How far from a joint's origin (3,) the shapes of a link reach [m]."""
    poses = [(data.oMi[solid.joint] * solid.at, solid.points) for solid in solids]
    placed = (points @ pose.rotation.T + pose.translation for pose, points in poses)
    return max(float(np.linalg.norm(points - origin, axis=1).max()) for points in placed)
