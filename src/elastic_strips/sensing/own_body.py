"""Sensing room, own body: where beams meet the robot that sends them: it shall not take itself for a thing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ..robot.geometry import LinkGeometry
from ..robot.space import Array
from .mounting import Posture
from .primitives import Primitives, is_primitive
from .rays import Nearest, Rays
from .triangles import TriangleBody, hull_mesh

_FAR = 1e3  # [m] beyond any robot


class OwnBody:
    """Workspace: a robot's own collision bodies before the beams of one sensor or ring.

    Bodies that are fixed to the joint that carries a sensor never move before it: they are looked at once, as they are.
    The others may be thicker by the padding. A body in which a beam begins is the sensor's housing, and hides nothing.

    Args:
        posture: of the robot.
        joint: (R,) joints that carry the beams.
        local: the beams in the joints' frames.
        padding: of the bodies that move before the sensor [m].

    Raises:
        MissingExtraError: a body has no formulas, and Embree is not installed.
    """

    def __init__(self, posture: Posture, joint: npt.NDArray[np.intp], local: Rays, padding: float) -> None:
        self._posture = posture
        pieces = posture.robot.geometries
        at_rest = np.tile(np.eye(4), (len(posture.T_world_joint), 1, 1))
        self._fixed = np.full(len(local), np.inf)
        self._groups: list[tuple[npt.NDArray[np.intp], list[_Bodies]]] = []
        for j in np.unique(joint):
            rays = np.flatnonzero(joint == j)
            nearest = Nearest(len(rays))
            _Bodies([p for p in pieces if p.joint == j], 0.0).cast(at_rest, local.some(rays), nearest, _FAR)
            self._fixed[rays] = nearest.distance
            others = [p for p in pieces if p.joint != j]
            paddings = (padding, 0.0) if padding > 0.0 else (0.0,)
            self._groups.append((rays, [_Bodies(others, thick) for thick in paddings]))

    def distances(self, rays: Rays, reach: float) -> Array:
        """How far (R,) [m] the beams, now given in the world, go before they meet the robot; infinite beyond reach."""
        out = self._fixed.copy()
        for index, layers in self._groups:
            nearest = Nearest(len(index))
            some = rays if len(index) == len(out) else rays.some(index)
            for bodies in layers:  # the bare ones for beams that begin within the padding
                if not bodies.cast(self._posture.T_world_joint, some, nearest, reach):
                    break
            out[index] = np.minimum(out[index], nearest.distance)
        out[out > reach] = np.inf
        return out


class _Bodies:
    """Some of a robot's collision bodies, thicker by a padding [m], as beams meet them."""

    def __init__(self, pieces: Sequence[LinkGeometry], padding: float) -> None:
        simple = [p for p in pieces if is_primitive(p.geometry, padding)]
        self._primitives = Primitives.of([p.geometry for p in simple], padding)
        order = self._primitives.row
        self._joint = np.array([p.joint for p in simple], dtype=np.intp)[order]
        self._local = np.array([p.placement for p in simple]).reshape(-1, 4, 4)[order]
        self._hulls = [
            (p.joint, p.placement, TriangleBody([hull_mesh(p.geometry, padding)]))
            for p in pieces
            if not is_primitive(p.geometry, padding)
        ]

    def cast(self, T_joint: Array, rays: Rays, nearest: Nearest, reach: float) -> bool:
        """Look where rays meet the bodies, whose joints are at ``T_joint`` (njoints, 4, 4) in the rays' frame.

        Returns:
            Whether any beam came near any of them.
        """
        T = T_joint[self._joint] @ self._local
        near = self._primitives.cast(T[:, :3, :3], T[:, :3, 3], rays, nearest, reach=reach, inside=np.inf)
        for joint, placement, body in self._hulls:
            near |= body.cast(T_joint[joint] @ placement, rays, nearest, reach=reach, inside=np.inf)
        return near
