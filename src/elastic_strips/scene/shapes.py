"""Scene room, shapes: the classes with which obstacles are made.

Sizes are full lengths in metres. Everything after the first argument (two for shapes of two lengths) is by keyword:
``at`` is the position (3,) of the obstacle's origin [m], ``quat`` its unit quaternion (x, y, z, w), both in the world
frame; ``name`` is unique in a scene; ``motion`` is a `Twist` or `Keyframes`.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from elastic_strips.errors import SceneError
from elastic_strips.scene import checks
from elastic_strips.scene.decompose import convex_pieces, load_mesh
from elastic_strips.scene.motion import Motion
from elastic_strips.scene.obstacle import Obstacle
from elastic_strips.scene.parts import Solid, cluster_solid, coal, hull_part, primitive

_ORIGIN = (0.0, 0.0, 0.0)
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)


class Box(Obstacle):
    """A box.

    Args:
        size: Full lengths (3,) along its x, y, z axes [m].
    """

    __slots__ = ()

    def __init__(
        self,
        size: Any,
        *,
        at: Any = _ORIGIN,
        quat: Any = _UPRIGHT,
        name: str | None = None,
        motion: Motion | None = None,
    ) -> None:
        size = checks.sizes("Box size", size, 3)
        half = 0.5 * size
        solid = primitive(coal.Box(*size.tolist()), half, float(np.linalg.norm(half)))
        self._fill("box", {"size": size}, solid, at=at, quat=quat, name=name, motion=motion)


class Sphere(Obstacle):
    """A sphere.

    Args:
        radius: Radius [m].
    """

    __slots__ = ()

    def __init__(
        self,
        radius: Any,
        *,
        at: Any = _ORIGIN,
        quat: Any = _UPRIGHT,
        name: str | None = None,
        motion: Motion | None = None,
    ) -> None:
        r = checks.length("Sphere radius", radius)
        self._fill(
            "sphere", {"radius": r}, primitive(coal.Sphere(r), (r, r, r), r), at=at, quat=quat, name=name, motion=motion
        )


class Cylinder(Obstacle):
    """A cylinder about its z axis; the origin is at half its length.

    Args:
        radius: Radius [m].
        length: Full length along z [m].
    """

    __slots__ = ()

    def __init__(
        self,
        radius: Any,
        length: Any,
        *,
        at: Any = _ORIGIN,
        quat: Any = _UPRIGHT,
        name: str | None = None,
        motion: Motion | None = None,
    ) -> None:
        r, z = checks.length("Cylinder radius", radius), checks.length("Cylinder length", length)
        solid = primitive(coal.Cylinder(r, z), (r, r, 0.5 * z), math.hypot(r, 0.5 * z))
        self._fill("cylinder", {"radius": r, "length": z}, solid, at=at, quat=quat, name=name, motion=motion)


class Capsule(Obstacle):
    """A capsule about its z axis; the origin is at its centre.

    Args:
        radius: Radius [m].
        length: Length [m] of the cylindrical part along z, without the two half spheres.
    """

    __slots__ = ()

    def __init__(
        self,
        radius: Any,
        length: Any,
        *,
        at: Any = _ORIGIN,
        quat: Any = _UPRIGHT,
        name: str | None = None,
        motion: Motion | None = None,
    ) -> None:
        r, z = checks.length("Capsule radius", radius), checks.length("Capsule length", length)
        solid = primitive(coal.Capsule(r, z), (r, r, 0.5 * z + r), 0.5 * z + r)
        self._fill("capsule", {"radius": r, "length": z}, solid, at=at, quat=quat, name=name, motion=motion)


class Cone(Obstacle):
    """A cone about its z axis, apex at +z; the origin is at half its height.

    Args:
        radius: Radius of the base [m].
        length: Height [m].
    """

    __slots__ = ()

    def __init__(
        self,
        radius: Any,
        length: Any,
        *,
        at: Any = _ORIGIN,
        quat: Any = _UPRIGHT,
        name: str | None = None,
        motion: Motion | None = None,
    ) -> None:
        r, z = checks.length("Cone radius", radius), checks.length("Cone length", length)
        solid = primitive(coal.Cone(r, z), (r, r, 0.5 * z), math.hypot(r, 0.5 * z))
        self._fill("cone", {"radius": r, "length": z}, solid, at=at, quat=quat, name=name, motion=motion)


class ConvexHull(Obstacle):
    """The convex hull of points.

    Args:
        vertices: Points (V, 3) [m] in the obstacle's frame, at least four, not in one plane.
    """

    __slots__ = ()

    def __init__(
        self,
        vertices: Any,
        *,
        at: Any = _ORIGIN,
        quat: Any = _UPRIGHT,
        name: str | None = None,
        motion: Motion | None = None,
    ) -> None:
        points = checks.array("ConvexHull vertices", vertices, (None, 3))
        solid = Solid([hull_part(points, "ConvexHull vertices")])
        self._fill("convex", {"vertices": points}, solid, at=at, quat=quat, name=name, motion=motion)


class Mesh(Obstacle):
    """A solid triangle mesh, made of convex parts; see `elastic_strips.scene.decompose` for how well they fit.

    Args:
        vertices: Vertices (V, 3) [m] in the obstacle's frame.
        faces: Triangles (F, 3), indices of vertices.
    """

    __slots__ = ()

    def __init__(
        self,
        vertices: Any,
        faces: Any,
        *,
        at: Any = _ORIGIN,
        quat: Any = _UPRIGHT,
        name: str | None = None,
        motion: Motion | None = None,
    ) -> None:
        points = checks.array("Mesh vertices", vertices, (None, 3))
        raw = checks.array("Mesh faces", faces, (None, 3), limit=float(2**31))
        triangles = raw.astype(np.int64)
        if (triangles != raw).any() or triangles.min() < 0 or triangles.max() >= len(points):
            raise SceneError(
                f"Mesh faces must be integers in [0, {len(points) - 1}] (there are {len(points)} vertices); "
                f"they range from {raw.min():g} to {raw.max():g}"
            )
        triangles.flags.writeable = False
        solid = Solid([hull_part(piece, "Mesh piece") for piece in convex_pieces(points, triangles)])
        spec = {"vertices": points, "faces": triangles}
        self._fill("mesh", spec, solid, at=at, quat=quat, name=name, motion=motion)

    @classmethod
    def from_file(
        cls,
        path: str | Path,
        *,
        scale: float = 1.0,
        at: Any = _ORIGIN,
        quat: Any = _UPRIGHT,
        name: str | None = None,
        motion: Motion | None = None,
    ) -> Mesh:
        """Read an STL, OBJ, PLY or DAE file; its numbers times ``scale`` are metres.

        Raises:
            SceneError: The file is missing, unreadable, empty, corrupt or of another kind.
        """
        factor = checks.number("Mesh scale", scale, low=1e-9, high=1e9, unit="-")
        vertices, faces = load_mesh(Path(path))
        try:
            mesh = cls(vertices * factor, faces, at=at, quat=quat, name=name, motion=motion)
        except SceneError as error:
            raise SceneError(f"{path}: {error}") from None
        mesh.spec.update(path=str(path), scale=factor)
        return mesh


class Voxels(Obstacle):
    """Equal axis-aligned boxes, such as the occupied cells of a grid map; merged into larger boxes where possible.

    Args:
        centers: Centres of the voxels (V, 3) [m] in the obstacle's frame.
        size: Edge of a voxel [m], or its lengths (3,) along x, y, z.
    """

    __slots__ = ()

    def __init__(
        self,
        centers: Any,
        size: Any,
        *,
        at: Any = _ORIGIN,
        quat: Any = _UPRIGHT,
        name: str | None = None,
        motion: Motion | None = None,
    ) -> None:
        points = checks.array("Voxels centers", centers, (None, 3))
        edges = (
            checks.sizes("Voxels size", size, 3) if np.ndim(size) else np.full(3, checks.length("Voxels size", size))
        )
        edges.flags.writeable = False
        spec = {"centers": points, "size": edges}
        self._fill("voxels", spec, cluster_solid(points, edges), at=at, quat=quat, name=name, motion=motion)


class Points(Obstacle):
    """A point cloud; each point is a box of edge 2 ``radius``, which holds the ball of that radius.

    Args:
        points: Points (V, 3) [m] in the obstacle's frame.
        radius: Half the edge of a point's box [m].
    """

    __slots__ = ()

    def __init__(
        self,
        points: Any,
        radius: Any,
        *,
        at: Any = _ORIGIN,
        quat: Any = _UPRIGHT,
        name: str | None = None,
        motion: Motion | None = None,
    ) -> None:
        cloud = checks.array("Points points", points, (None, 3))
        r = checks.length("Points radius", radius)
        solid = cluster_solid(cloud, np.full(3, 2.0 * r))
        self._fill("points", {"points": cloud, "radius": r}, solid, at=at, quat=quat, name=name, motion=motion)
