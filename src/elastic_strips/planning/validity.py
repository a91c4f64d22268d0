"""Validity: configurations and edges of planned paths, checked by distances and motion bounds."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array

from ..robot import BaseKind, RobotModel
from ..scene import Scene
from ..strip import Deformer, Strip
from ..strip.solver import project_rolling
from ..tunnel import Certificate

_MAX_PAIRED = 400


class Validity:
    """Workspace: tells whether a configuration keeps ``margin`` to every obstacle and does not touch itself.

    Few parts are paired with the links in one Pinocchio geometry model, whose tree broadphase answers in C++; many
    parts (voxels) stand in one Coal tree that each link asks.

    Args:
        robot: the robot.
        scene: the obstacles.
        margin: distance to keep to obstacles [m].
        low, high: (2,) region of the base that will be asked about [m]; parts that the robot cannot reach from there
            are left out. None takes all.
        reach: how far [m] the robot extends from its base.
    """

    def __init__(
        self, robot: RobotModel, scene: Scene, *, margin: float,
        low: Array | None = None, high: Array | None = None, reach: float = 2.0,
    ) -> None:  # fmt: skip
        self.robot, self.checks = robot, 0
        table = scene.table
        rows = np.arange(len(table.parts))
        if low is not None and high is not None and len(rows):
            c, h = table.center[:, :2], table.half_extents[:, :2]
            near = ((c - h <= high + reach) & (c + h >= low - reach)).all(axis=1)
            rows = rows[near]
        shapes = []
        for r in rows:
            part, R, t = table.parts[r], table.rotation[r], table.translation[r]
            if part.geometry is None:
                shapes += [(box, R, t + R @ np.asarray(at)) for box, at in part.boxes]
            else:
                shapes.append((part.geometry, R, t))
        self._data = robot.model.createData()
        self._model = robot.collision_model.clone()
        self._links = len(robot.geometries)
        self._manager = None
        if len(shapes) <= _MAX_PAIRED:
            for k, (geometry, R, t) in enumerate(shapes):
                grown = geometry.clone()
                grown.setSweptSphereRadius(grown.getSweptSphereRadius() + margin)
                grown.computeLocalAABB()
                index = self._model.addGeometryObject(
                    pin.GeometryObject(f"obstacle-part-{k}", 0, 0, pin.SE3(np.asarray(R), np.asarray(t)), grown)
                )
                for link in range(self._links):
                    self._model.addCollisionPair(pin.CollisionPair(link, index))
        else:
            self._keep = [coal.CollisionObject(g, np.asarray(R), np.asarray(t)) for g, R, t in shapes]
            self._manager = coal.DynamicAABBTreeCollisionManager()
            for item in self._keep:
                self._manager.registerObject(item)
            self._manager.setup()
            self._queries = []
            for piece in robot.geometries:
                grown = piece.geometry.clone()
                grown.setSweptSphereRadius(grown.getSweptSphereRadius() + margin)
                grown.computeLocalAABB()
                self._queries.append(coal.CollisionObject(grown))
        self._geometry = self._model.createData()
        self._broadphase = pin.TreeBroadPhaseManager_DynamicAABBTreeCollisionManager(
            robot.model, self._model, self._geometry
        )

    def __call__(self, q: Array) -> bool:
        """Whether the configuration (nq,) is valid."""
        self.checks += 1
        if pin.computeCollisions(self.robot.model, self._data, self._broadphase, q, True):
            return False
        return self._manager is None or not self._hits_tree()

    def _hits_tree(self) -> bool:
        assert self._manager is not None
        for link, query in enumerate(self._queries):
            pose = self._geometry.oMg[link]
            query.setTransform(coal.Transform3s(pose.rotation, pose.translation))
            query.computeAABB()
            callback = coal.CollisionCallBackDefault()
            self._manager.collide(query, callback)
            if callback.data.result.isCollision():
                return True
        return False


def certify_path(deformer: Deformer, scene: Scene, chart: Array) -> Certificate:
    """The certificate of a path as it is, edge by edge, with the clearances of the deformer's parameters.

    A differential drive's waypoints are first moved, as little as possible, until wheels can follow them.

    Args:
        deformer: a workspace of the robot; what it knows of other strips is lost.
        scene: the obstacles.
        chart: waypoints (N, nv).
    """
    robot = deformer.robot
    if robot.base_kind is BaseKind.DIFF_DRIVE:
        chart, _ = project_rolling(robot.space, chart)
    return deformer.certify(Strip.from_chart(robot, chart), scene)
