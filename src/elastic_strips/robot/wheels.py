"""Wheels and casters of a description, by their names or by how they hang on the base."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array

from .coal_shapes import ShapeKind, shape_of, support, vertices
from .urdf import UrdfSource

_LEVEL = 0.05  # how far the axis of a wheel is from level, as a sine; [m] by how much a caster's wheel may be higher
_ROUND = 0.003  # [m] by how much a wheel may stick out farther on one side: its mesh has corners


def wheel_joints(model: pin.Model, source: UrdfSource) -> set[str]:
    """Continuous joints that are called wheel or caster, or that move the base by what hangs on them.

    A wheel turns about a level axis, hangs on the root link by fixed joints, and carries nothing that moves. A caster
    turns about an upright axis and carries nothing but wheels, no higher than the other wheels; without others there
    are at least two of them. So an arm's first joint is neither of them, nor is a head that pans and tilts.
    """
    named = {j for j in source.continuous if any(word in j.lower() for word in ("wheel", "caster", "castor"))}
    if model.njoints < 2 or model.joints[1].shortname() != "JointModelPlanar":
        return named
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    upright = {i: abs(float(data.J[5, model.joints[i].idx_v])) for i in range(2, model.njoints)}  # z of its axis
    height = [float(pose.translation[2]) for pose in data.oMi]
    turning = {i for i in upright if model.names[i] in source.continuous}

    def carried(i: int) -> list[int]:
        return [k for k in model.subtrees[i] if k != i and model.names[k] not in source.mimic]

    rolling = {i for i in turning if upright[i] < _LEVEL and not carried(i)}
    wheels = {i for i in rolling if model.parents[i] == 1}
    casters = {
        i for i in turning
        if model.parents[i] == 1 and upright[i] > 1.0 - _LEVEL and carried(i) and rolling.issuperset(carried(i))
    }  # fmt: skip
    top = max((height[i] for i in wheels), default=float("inf") if len(casters) > 1 else -float("inf"))
    for i in casters:
        if max(height[k] for k in carried(i)) <= top + _LEVEL:
            wheels |= {i, *carried(i)}
    return named | {model.names[i] for i in wheels}


def round_wheels(model: pin.Model, collision: pin.GeometryModel, wheels: Iterable[str]) -> frozenset[str]:
    """The joints whose collision shapes are bodies of revolution about their axes, within 3 mm."""
    round_, elevation = set(), np.linspace(-1.2, 1.2, 7)[:, None]
    turn = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    for name in wheels:
        i = model.getJointId(name)
        if model.joints[i].nv != 1 or len(model.subtrees[i]) > 1:  # what swivels carries its wheel about
            continue
        axis = np.asarray(model.joints[i].createData().S).ravel()[3:]
        side = np.linalg.svd(axis[None])[2][1:]
        flat = np.cos(turn)[:, None] * side[0] + np.sin(turn)[:, None] * side[1]
        directions = np.cos(elevation)[..., None] * flat + np.sin(elevation)[..., None] * axis
        shapes = [obj for obj in collision.geometryObjects if obj.parentJoint == i]
        if all(
            np.ptp(_extent(shape, directions.reshape(-1, 3)).reshape(directions.shape[:2]), axis=1).max() <= _ROUND
            for shape in shapes
        ):
            round_.add(name)
    return frozenset(round_)


def _extent(shape: pin.GeometryObject, directions: Array) -> Array:
    """How far a shape extends along directions (K, 3) from its joint [m]."""
    local = directions @ shape.placement.rotation
    if shape_of(shape.geometry)[0] is ShapeKind.MESH and not len(vertices(shape.geometry)):
        return np.zeros(len(directions))
    few = np.array_split(local, len(local) // 8)  # a mesh of a million corners has as many numbers for each direction
    return np.concatenate([support(shape.geometry, d) for d in few]) + directions @ shape.placement.translation
