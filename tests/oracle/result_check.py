"""Checks a result of ``elastic-strips run --json`` with Pinocchio and Coal alone; nothing of the library is imported.

As a script: ``python tests/oracle/result_check.py RESULT.json``; exit code 0 if the result is what it says.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

Array = npt.NDArray[np.float64]

STEP = 0.005
"""No point of the robot moves farther than this between two samples [m]."""
SLIP = 1e-6
"""Most sideways travel of a differential drive in a segment [m]."""
UNDER = 1e-4
"""How far a sampled distance may fall below the stated clearance [m]: twice the accuracy that the result claims."""
OVER = 2e-3
"""How far the smallest sampled distance may exceed the stated clearance [m], for robots without meshes."""
_NEAR = 0.02


@dataclass(slots=True)
class Check:
    """What was found: faults (none if the result holds) and the figures that were measured."""

    faults: list[str] = field(default_factory=list)
    clearance: float = float("inf")
    self_clearance: float = float("inf")
    slip: float = 0.0
    samples: int = 0
    meshes: bool = False

    def demand(self, holds: bool, fault: str) -> None:
        """Note a fault unless something holds."""
        if not holds:
            self.faults.append(fault)


@dataclass(frozen=True, slots=True)
class Robot:
    """Pinocchio's models of the robot, locked joints removed, with the obstacles in the collision model."""

    model: Any
    data: Any
    geometry: Any
    geometry_data: Any
    links: int
    planar: bool
    meshes: bool
    reach: Array  # (nv,) most that any point moves for one unit of each velocity [m]


def check(
    document: dict[str, Any], *, step: float = STEP, start: Array | None = None, goal: Array | None = None
) -> Check:
    """Check a result document.

    Args:
        document: what ``run --json`` wrote.
        step: see :data:`STEP`.
        start, goal: configurations (nq,) that the strip must begin and end with, where they are known.
    """
    found = Check()
    q = np.array(document["strip"]["q"], dtype=float)
    robot = load(document)
    found.meshes = robot.meshes
    found.demand(
        q.ndim == 2 and q.shape[1] == robot.model.nq, f"q has shape {q.shape}; the robot has nq = {robot.model.nq}"
    )
    if found.faults:
        return found
    _check_nodes(document, robot, q, found)
    _check_counts(document, robot, q, found)
    for what, given, node in (("start", start, q[0]), ("goal", goal, q[-1])):
        if given is not None:
            apart = float(np.abs(pin.difference(robot.model, np.asarray(given, dtype=float), node)).max())
            found.demand(apart <= 1e-9, f"the strip misses the {what} by {apart:.3g}")
    if not found.faults:
        _sweep(document, robot, q, step, found)
    return found


def load(document: dict[str, Any]) -> Robot:
    """The robot that the document names, and its obstacles."""
    urdf = Path(document["urdf"])
    planar = document["base"] != "fixed"
    folders = [str(p) for p in urdf.parents][:6]
    root = (pin.JointModelPlanar(),) if planar else ()
    model = pin.buildModelFromUrdf(str(urdf), *root)
    geometry = pin.buildGeomFromUrdf(model, str(urdf), pin.COLLISION, package_dirs=folders)
    q = pin.neutral(model)
    for name, value in document["locked"].items():
        joint = model.joints[model.getJointId(name)]
        q[joint.idx_q : joint.idx_q + joint.nq] = (value,) if joint.nq == 1 else (np.cos(value), np.sin(value))
    ids = [model.getJointId(name) for name in document["locked"]]
    model, geometry = pin.buildReducedModel(model, geometry, ids, q)
    meshes = False
    for item in geometry.geometryObjects:
        if isinstance(item.geometry, coal.BVHModelBase):  # hollow: the hull holds the mesh and its inside
            meshes = True
            item.geometry.buildConvexHull(True, "Qt")
            item.geometry = item.geometry.convex
    links = len(geometry.geometryObjects)
    srdf = urdf.with_suffix(".srdf")
    if srdf.is_file():
        geometry.addAllCollisionPairs()
        pin.removeCollisionPairs(model, geometry, str(srdf))
    for entry in document["obstacles"]:
        x, y, z, *quat = entry["pose"]
        pose = pin.SE3(pin.Quaternion(np.array(quat)).matrix(), np.array([x, y, z]))
        index = geometry.addGeometryObject(pin.GeometryObject(f"obstacle {entry['name']}", 0, 0, pose, shape(entry)))
        for link in range(links):
            geometry.addCollisionPair(pin.CollisionPair(link, index))
    return Robot(
        model,
        model.createData(),
        geometry,
        pin.GeometryData(geometry),
        links,
        planar,
        meshes,
        _reach(model, geometry, links),
    )


def shape(entry: dict[str, Any]) -> Any:
    """Coal's shape of an entry of ``obstacles``."""
    kind, size = entry["shape"], entry["size"]
    if kind == "box":
        return coal.Box(*size)
    if kind == "sphere":
        return coal.Sphere(*size)
    if kind in ("cylinder", "capsule", "cone"):
        return {"cylinder": coal.Cylinder, "capsule": coal.Capsule, "cone": coal.Cone}[kind](*size)
    if kind != "convex":
        raise ValueError(f"unknown shape {kind!r}")
    points = coal.StdVec_Vec3s()
    for vertex in size:
        points.append(np.array(vertex, dtype=float))
    return coal.Convex.convexHull(points, True, "Qt")


def _reach(model: Any, geometry: Any, links: int) -> Array:
    """Most that any point of the robot moves for one unit of each velocity: joint to farthest point along the chain."""
    far = np.zeros(model.njoints)  # from each joint's origin to the farthest point that it carries
    for item in geometry.geometryObjects[:links]:
        item.geometry.computeLocalAABB()
        radius = np.linalg.norm(item.placement.act(np.array(item.geometry.aabb_center))) + item.geometry.aabb_radius
        far[item.parentJoint] = max(far[item.parentJoint], radius)
    for joint in range(model.njoints - 1, 1, -1):
        parent = model.parents[joint]
        way = np.linalg.norm(model.jointPlacements[joint].translation)
        if model.joints[joint].shortname().startswith("JointModelP"):
            i = model.joints[joint].idx_q
            way += max(abs(model.lowerPositionLimit[i]), abs(model.upperPositionLimit[i]))
        far[parent] = max(far[parent], far[joint] + way)
    reach = np.ones(model.nv)
    for joint in range(1, model.njoints):
        i, kind = model.joints[joint].idx_v, model.joints[joint].shortname()
        if kind == "JointModelPlanar":
            reach[i + 2] = far[joint]
        elif not kind.startswith("JointModelP"):
            reach[i] = far[joint]
    return reach


def _check_nodes(document: dict[str, Any], robot: Robot, q: Array, found: Check) -> None:
    found.demand(bool(np.isfinite(q).all()), "q is not finite")
    for joint in list(robot.model.joints)[1:]:
        i = joint.idx_q
        if joint.nq == 1:
            low, high = robot.model.lowerPositionLimit[i], robot.model.upperPositionLimit[i]
            inside = (q[:, i] >= low - 1e-9) & (q[:, i] <= high + 1e-9)
            found.demand(bool(inside.all()), f"q[:, {i}] leaves its limits [{low:g}, {high:g}]")
        else:
            k = i + joint.nq - 2
            error = float(np.abs(np.hypot(q[:, k], q[:, k + 1]) - 1.0).max())
            found.demand(error <= 1e-6, f"(cos, sin) at {k} is not of unit length: off by {error:.3g}")
    if document["base"] == "diff_drive":
        found.slip = max(abs(float(pin.difference(robot.model, a, b)[1])) for a, b in pairwise(q))
        found.demand(found.slip <= SLIP, f"the base slips sideways by {found.slip:.3g} m")
        stated = document["max_lateral_slip_m"]
        found.demand(abs(found.slip - stated) <= 1e-9, f"the slip is {found.slip:.3g} m, not {stated:.3g} m")


def _check_counts(document: dict[str, Any], robot: Robot, q: Array, found: Check) -> None:
    names = [robot.model.names[i] for i in range(2 if robot.planar else 1, robot.model.njoints)]
    found.demand(document["strip"]["joint_names"] == names, f"the joints are {names}")
    found.demand(document["nodes"] == len(q), f"there are {len(q)} nodes, not {document['nodes']}")
    count = len(document["segments"])
    found.demand(count == len(q) - 1, f"there are {len(q) - 1} segments, not {count}")
    if document["certified"]:
        found.demand(all(document["segments"]), "the strip is called certified, but not all of its segments are")
        found.demand(
            document["status"] == "settled", f"the strip is called certified, but its status is {document['status']}"
        )
    steps = [pin.difference(robot.model, a, b) for a, b in pairwise(q)]
    length = sum(float(np.linalg.norm(v[:2] if robot.planar else v)) for v in steps)
    found.demand(abs(length - document["length_m"]) <= 1e-9 * max(length, 1.0) + 1e-9, f"the length is {length:.6f}")


def _sweep(document: dict[str, Any], robot: Robot, q: Array, step: float, found: Check) -> None:
    """Distances along the strip, sampled so that nothing moves more than ``step`` [m] between two samples."""
    model, data, geometry, gdata = robot.model, robot.data, robot.geometry, robot.geometry_data
    stated = document["clearance_m"]
    pairs = len(geometry.collisionPairs)
    against = np.array([p.second >= robot.links for p in geometry.collisionPairs], dtype=bool)
    wanted = np.where(against, (stated or 0.0) + _NEAR, _NEAR)
    lowest = np.full(pairs, np.inf)
    for a, b in pairwise(q):
        travel = float(np.abs(pin.difference(model, a, b)) @ robot.reach)
        pin.computeDistances(model, data, geometry, gdata, a)
        d = np.array([r.min_distance for r in gdata.distanceResults])
        lowest = np.minimum(lowest, d)
        near = np.flatnonzero(d <= wanted + travel)  # the others stay farther than what is asked about
        count = max(int(np.ceil(travel / step)), 1)
        found.samples += count
        for s in np.arange(1, count) / count if len(near) else ():
            pin.updateGeometryPlacements(model, data, geometry, gdata, pin.interpolate(model, a, b, float(s)))
            for k in near.tolist():
                pin.computeDistance(geometry, gdata, k)
                lowest[k] = min(lowest[k], gdata.distanceResults[k].min_distance)
    pin.computeDistances(model, data, geometry, gdata, q[-1])
    lowest = np.minimum(lowest, [r.min_distance for r in gdata.distanceResults])
    found.clearance = float(lowest[against].min(initial=np.inf))
    found.self_clearance = float(lowest[~against].min(initial=np.inf))
    if document["certified"]:
        found.demand(found.self_clearance > 0.0, f"the robot touches itself: {found.self_clearance:.4f} m")
        least = document["certified_clearance_m"]
        found.demand(
            found.clearance >= least - 1e-5, f"certified for {least} m, but {found.clearance:.5f} m were found"
        )
    if stated is None:
        found.demand(not against.any(), "there are obstacles, but no clearance is stated")
        return
    found.demand(found.clearance >= stated - UNDER, f"clearance {stated:.5f} m stated, {found.clearance:.5f} m found")
    if not robot.meshes:
        found.demand(
            found.clearance <= stated + OVER, f"clearance {stated:.5f} m stated, {found.clearance:.5f} m found"
        )


def main() -> int:
    """Check the file that the command line names; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("result", type=Path)
    parser.add_argument("--step", type=float, default=STEP, help="largest motion between two samples [m]")
    arguments = parser.parse_args()
    found = check(json.loads(arguments.result.read_text(encoding="utf-8")), step=arguments.step)
    for fault in found.faults:
        print(f"FAULT {fault}")
    print(
        f"{found.samples} samples, clearance {found.clearance:.4f} m, own links {found.self_clearance:.4f} m, "
        f"slip {found.slip:.1e} m: {'holds' if not found.faults else 'does not hold'}"
    )
    return 1 if found.faults else 0


if __name__ == "__main__":
    sys.exit(main())
