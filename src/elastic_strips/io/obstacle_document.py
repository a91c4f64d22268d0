"""IO room, obstacle documents: a scene resolved into convex shapes with poses, for anyone's own check."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from elastic_strips.scene import Scene


def obstacle_documents(scene: Scene) -> list[dict[str, Any]]:
    """Every convex shape of a scene: name, shape, size as in URDF, pose [x, y, z, qx, qy, qz, qw].

    ``size`` is [x, y, z] of a box, [radius] of a sphere, [radius, length] of a cylinder, capsule (length without the
    caps) or cone, and the vertices [[x, y, z], …] of a convex hull. A mesh or a set of voxels gives one entry a
    convex piece, ``name#k``.
    """
    from scipy.spatial.transform import Rotation  # late: slow to import

    documents = []
    table = scene.table
    counts = np.bincount(table.obstacle_index, minlength=len(scene)) if len(scene) else np.zeros(0, dtype=int)
    number: dict[int, int] = {}
    for row, part in enumerate(table.parts):
        owner = int(table.obstacle_index[row])
        rotation, translation = table.rotation[row], table.translation[row]
        if part.geometry is None:
            pieces = [(box, translation + rotation @ np.asarray(at)) for box, at in part.boxes]
        else:
            pieces = [(part.geometry, translation)]
        for geometry, at in pieces:
            k = number.get(owner, 0)
            number[owner] = k + 1
            single = counts[owner] == 1 and len(pieces) == 1
            shape, size = shape_document(geometry)
            documents.append(
                {
                    "name": scene.names[owner] if single else f"{scene.names[owner]}#{k}",
                    "shape": shape,
                    "size": size,
                    "pose": [*map(float, at), *map(float, Rotation.from_matrix(rotation).as_quat())],
                }
            )
    return documents


def shape_document(geometry: Any) -> tuple[str, list[Any]]:
    """Name and size of a Coal shape, as in :func:`obstacle_documents`."""
    if isinstance(geometry, coal.Box):
        return "box", [float(2 * h) for h in geometry.halfSide]
    if isinstance(geometry, coal.Sphere):
        return "sphere", [float(geometry.radius)]
    for kind, name in ((coal.Cylinder, "cylinder"), (coal.Capsule, "capsule"), (coal.Cone, "cone")):
        if isinstance(geometry, kind):
            return name, [float(geometry.radius), float(2 * geometry.halfLength)]
    return "convex", np.asarray(geometry.points()).reshape(-1, 3).tolist()
