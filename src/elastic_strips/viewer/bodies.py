"""Bodies: what a robot and an obstacle look like, each as few meshes as can be."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_strips.robot import RobotModel
from elastic_strips.scene import Obstacle
from elastic_strips.viewer import meshes
from elastic_strips.viewer.meshes import MeshData

_GHOST_FACES = 20_000
_UNIT_SHAPES = {"box": meshes.box, "sphere": meshes.sphere, "cylinder": meshes.cylinder, "cone": meshes.cone}


@dataclass(frozen=True, slots=True)
class Body:
    """Everything that moves with one joint, as one mesh with vertex colours in the joint's aligned frame."""

    joint: int
    mesh: MeshData


def robot_bodies(robot: RobotModel) -> tuple[Body, ...]:
    """Merge a robot's visual geometry per joint; each distinct mesh is read once.

    Where there is no visual geometry the collision geometry is drawn instead.
    """
    model = robot.visual_model if robot.visual_model.ngeoms else robot.collision_model
    read: dict[Any, MeshData | None] = {}
    parts: dict[int, list[MeshData]] = defaultdict(list)
    for item in model.geometryObjects:
        is_file = "." in item.meshPath  # of a primitive Pinocchio says BOX, CYLINDER, …
        name = (item.meshPath, *np.round(item.meshScale, 9)) if is_file else item.name
        if name not in read:
            read[name] = meshes.from_coal(item.geometry)
        mesh = read[name]
        if mesh is not None and len(mesh.faces):
            color = meshes.linear([float(c) for c in item.meshColor[:3]])
            placement = robot.tree.to_aligned(item.parentJoint, item.placement.homogeneous)
            parts[item.parentJoint].append(mesh.transformed(placement).colored(color))
    return tuple(Body(joint, meshes.merged(found)) for joint, found in sorted(parts.items()))


def ghost_bodies(bodies: tuple[Body, ...]) -> tuple[Body, ...]:
    """Return the bodies without colours, and coarser where they are heavy."""
    heavy = sum(len(body.mesh.faces) for body in bodies) > _GHOST_FACES
    coarse = [meshes.clustered(body.mesh, 0.012) if heavy else body.mesh for body in bodies]
    return tuple(
        Body(body.joint, MeshData(mesh.vertices, mesh.normals, mesh.faces, None))
        for body, mesh in zip(bodies, coarse, strict=True)
    )


def unit_shape(obstacle: Obstacle) -> tuple[str, NDArray[np.float64]] | None:
    """Say which unit mesh, scaled by which factors along its axes, an obstacle is; None if it is none of them."""
    if obstacle.shape not in _UNIT_SHAPES or len(obstacle.parts) != 1:
        return None
    shape = obstacle.parts[0].geometry
    if obstacle.shape == "box":
        return "box", 2.0 * np.asarray(shape.halfSide)
    if obstacle.shape == "sphere":
        return "sphere", np.full(3, float(shape.radius))
    return obstacle.shape, np.array([shape.radius, shape.radius, 2.0 * shape.halfLength])


def unit_mesh(shape: str) -> MeshData:
    """Return the unit mesh of a shape that ``unit_shape`` named."""
    return _UNIT_SHAPES[shape]()


def obstacle_mesh(obstacle: Obstacle) -> MeshData | None:
    """Merge an obstacle's parts into one mesh in the obstacle's frame; None if nothing of it can be drawn.

    What is drawn is what is avoided: the convex parts of a mesh, the merged boxes of voxels.
    """
    found: list[MeshData] = []
    boxes: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
    for part in obstacle.parts:
        if part.geometry is not None:
            mesh = meshes.from_coal(part.geometry)
            if mesh is not None:
                found.append(mesh.transformed(part.T_obstacle_part))
            continue
        T = np.asarray(part.T_obstacle_part)
        for shape, translation in part.boxes:
            center = T[:3, :3] @ np.asarray(translation) + T[:3, 3]
            if hasattr(shape, "halfSide"):
                boxes.append((center, np.asarray(shape.halfSide)))
                continue
            mesh = meshes.from_coal(shape)
            if mesh is not None:
                placed = np.eye(4)
                placed[:3, 3] = center
                found.append(mesh.transformed(placed))
    if boxes:
        found.append(_many_boxes(np.array([b[0] for b in boxes]), np.array([b[1] for b in boxes])))
    return meshes.merged(found) if found else None


def _many_boxes(centers: NDArray[np.float64], half: NDArray[np.float64]) -> MeshData:
    """Axis-aligned boxes, (K, 3) centres and half sizes, as one mesh."""
    unit = meshes.box()
    vertices = centers[:, None, :] + 2.0 * half[:, None, :] * unit.vertices[None]
    offsets = (np.arange(len(centers), dtype=np.uint32) * len(unit.vertices))[:, None, None]
    return MeshData(
        vertices.reshape(-1, 3).astype(np.float32),
        np.tile(unit.normals, (len(centers), 1)),
        (unit.faces[None] + offsets).reshape(-1, 3),
    )
