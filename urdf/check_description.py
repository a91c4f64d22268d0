"""Checks the Silvermate's description against what README.md claims; prints the measurements, exits 1 on a failure.

Run `python urdf/check_description.py [--samples 20000]`; needs pin, coal, yourdfpy and trimesh.
"""

# ruff: noqa: T201
import argparse
import sys
from pathlib import Path
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
import trimesh
import yourdfpy

HERE = Path(__file__).resolve().parent
URDF, SRDF = HERE / "silvermate.urdf", HERE / "silvermate.srdf"
ARM = [f"arm_{i}_joint" for i in range(1, 8)]
COVER = 0.01  # [m] a visual may stand out of its link's collision shapes by this much
HOME_MARGIN = 0.03  # [m]
failures: list[str] = []


def check(ok: bool, what: str) -> None:
    """Prints one line and remembers a failure."""
    print(f"{'ok  ' if ok else 'FAIL'} {what}")
    if not ok:
        failures.append(what)


def outside(points: np.ndarray, geometry: yourdfpy.Geometry) -> np.ndarray:
    """Signed distance [m] of points (N, 3) to a box, cylinder or sphere about the origin; negative inside."""
    if geometry.sphere:
        return np.linalg.norm(points, axis=1) - geometry.sphere.radius
    if geometry.cylinder:
        gap = np.c_[
            np.hypot(points[:, 0], points[:, 1]) - geometry.cylinder.radius,
            np.abs(points[:, 2]) - geometry.cylinder.length / 2,
        ]
    else:
        gap = np.abs(points) - np.asarray(geometry.box.size) / 2
    return np.linalg.norm(np.maximum(gap, 0), axis=1) + np.minimum(gap.max(1), 0)


def check_yourdfpy() -> None:
    """Loading with meshes, inertias, collision shapes, and the visuals they have to cover."""
    robot = yourdfpy.URDF.load(str(URDF), load_meshes=True, load_collision_meshes=True)
    check(robot.validate(), "yourdfpy validates")
    shapes, worst = 0, (-1.0, "")
    for link in robot.robot.links:
        if link.inertial is not None:
            inertia = np.asarray(link.inertial.inertia)
            e = np.linalg.eigvalsh(inertia)
            if not (link.inertial.mass > 0 and e[0] > 0 and e[2] <= e[0] + e[1] + 1e-12):
                check(False, f"inertia of {link.name}: principal moments {e}")
        shapes += len(link.collisions)
        for c in link.collisions:
            if not (c.geometry.box or c.geometry.cylinder or c.geometry.sphere):
                check(False, f"{link.name}: collision shape is no primitive")
        for visual in link.visuals:
            if visual.geometry.mesh:
                mesh = trimesh.load_mesh(HERE / visual.geometry.mesh.filename)
                points = np.vstack([mesh.vertices, trimesh.sample.sample_surface(mesh, 4000, seed=0)[0]])
                name = visual.geometry.mesh.filename
            else:
                points = trimesh.creation.icosphere(radius=visual.geometry.sphere.radius).vertices
                name = f"{link.name} sphere"
            points = trimesh.transform_points(points, np.eye(4) if visual.origin is None else visual.origin)
            gaps = []
            for c in link.collisions:
                T = np.eye(4) if c.origin is None else c.origin
                gaps.append(outside(trimesh.transform_points(points, np.linalg.inv(T)), c.geometry))
            out = float(np.min(gaps, axis=0).max())
            worst = max(worst, (out, name))
            if out > COVER:
                check(False, f"{name} stands {1000 * out:.1f} mm out of its link's collision shapes")
    check(worst[0] <= COVER, f"visuals within collision shapes; farthest out {1000 * worst[0]:.1f} mm ({worst[1]})")
    check(12 <= shapes <= 16, f"{shapes} collision shapes, all primitives")


def arm_configuration(model: pin.Model, values: np.ndarray) -> np.ndarray:
    """Neutral configuration with the seven arm joints set."""
    q = pin.neutral(model)
    for name, value in zip(ARM, values, strict=True):
        q[model.joints[model.getJointId(name)].idx_q] = value
    return q


def floor_gap(geometry: pin.GeometryObject, placement: pin.SE3) -> float:
    """Height [m] of a shape's lowest point."""
    g, R = geometry.geometry, placement.rotation
    if isinstance(g, coal.Sphere):
        drop = g.radius
    elif isinstance(g, coal.Cylinder):
        drop = g.halfLength * abs(R[2, 2]) + g.radius * float(np.hypot(R[2, 0], R[2, 1]))
    else:
        drop = float(np.abs(R[2]) @ g.halfSide)
    return float(placement.translation[2] - drop)


def link_of(model: pin.Model, geometry: pin.GeometryObject) -> str:
    return model.frames[geometry.parentFrame].name


def pair_names(model: pin.Model, geometry: pin.GeometryModel) -> list[tuple[str, ...]]:
    """Link names of each collision pair, sorted within the pair."""
    ends = [(geometry.geometryObjects[p.first], geometry.geometryObjects[p.second]) for p in geometry.collisionPairs]
    return [tuple(sorted((link_of(model, a), link_of(model, b)))) for a, b in ends]


def check_pinocchio(samples: int) -> None:
    """Loading below a planar root, floor contact, mass, reach, home, and the SRDF's disabled pairs."""
    model = pin.buildModelFromUrdf(str(URDF), pin.JointModelPlanar())
    visual = pin.buildGeomFromUrdf(model, str(URDF), pin.VISUAL, package_dirs=[str(HERE)])
    collision = pin.buildGeomFromUrdf(model, str(URDF), pin.COLLISION, package_dirs=[str(HERE)])
    data = model.createData()
    check((model.nq, model.nv) == (15, 12), f"pinocchio: nq {model.nq}, nv {model.nv}; joints {list(model.names)[1:]}")
    check(
        visual.ngeoms > 30 and collision.ngeoms == 16, f"{visual.ngeoms} visual, {collision.ngeoms} collision objects"
    )
    mass = pin.computeTotalMass(model)
    check(60 <= mass <= 90, f"total mass {mass:.2f} kg")

    pin.loadReferenceConfigurations(model, str(SRDF), False)
    home, reach = model.referenceConfigurations["home"], model.referenceConfigurations["reach"]
    collision.addAllCollisionPairs()
    tested = collision.clone()
    pin.removeCollisionPairs(model, tested, str(SRDF))
    tested_data = tested.createData()

    placements = collision.createData()
    pin.updateGeometryPlacements(model, data, collision, placements, home)
    low = {link_of(model, g): floor_gap(g, M) for g, M in zip(collision.geometryObjects, placements.oMg, strict=True)}
    for name in ("wheel_left_link", "wheel_right_link", "caster_front_link", "caster_rear_link"):
        check(abs(low[name]) < 1e-6, f"{name} touches the floor: {low[name]:.2e} m")
    check(abs(low["base_link"] - 0.03) < 1e-6, f"base bottom at {low['base_link']:.3f} m")
    far = max(reach_from_axis(g, M) for g, M in zip(collision.geometryObjects, placements.oMg, strict=True))
    check(far < 0.40, f"home: farthest point {far:.3f} m from the base axis")

    hand, shoulder = model.getFrameId("hand_frame"), model.getJointId("arm_1_joint")
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    length = np.linalg.norm(data.oMf[hand].translation - data.oMi[shoulder].translation)
    palm = collision.geometryObjects[collision.getGeometryId("palm_link_0")]
    tip = -floor_gap(palm, data.oMi[palm.parentJoint] * palm.placement) + data.oMi[shoulder].translation[2]
    check(
        abs(tip - 0.80) < 0.02,
        f"arm: shoulder to hand_frame {length:.3f} m, to the fingertips {tip:.3f} m",
    )
    pin.framesForwardKinematics(model, data, reach)
    print(f"     reach puts hand_frame at {np.round(data.oMf[hand].translation, 3)}")

    for name, q in (("home", home), ("reach", reach)):
        pin.computeDistances(model, data, tested, tested_data, q)
        d = [r.min_distance for r in tested_data.distanceResults]
        k = int(np.argmin(d))
        check(
            d[k] >= HOME_MARGIN,
            f"{name}: nearest of {len(d)} enabled pairs {d[k]:.4f} m ({' - '.join(pair_names(model, tested)[k])})",
        )
        com = pin.centerOfMass(model, data, q)
        print(f"     {name}: centre of mass {np.round(com, 3)}")

    pairs, kept = pair_names(model, collision), set(pair_names(model, tested))
    silent = set(pairs) - kept
    adjacent = disabled_as("Adjacent")
    lower = np.array([model.lowerPositionLimit[model.joints[model.getJointId(n)].idx_q] for n in ARM])
    upper = np.array([model.upperPositionLimit[model.joints[model.getJointId(n)].idx_q] for n in ARM])
    collision_data = collision.createData()
    watched = np.array([p in silent and p not in adjacent for p in pairs])
    enabled = np.array([p in kept for p in pairs])
    rng = np.random.default_rng(0)
    nearest, free = np.inf, 0
    for _ in range(samples):
        pin.computeDistances(
            model, data, collision, collision_data, arm_configuration(model, rng.uniform(lower, upper))
        )
        d = np.array([r.min_distance for r in collision_data.distanceResults])
        nearest, free = min(nearest, d[watched].min()), free + bool(d[enabled].min() > 0)
    check(nearest > 0, f"disabled, not adjacent pairs never touch: nearest {nearest:.4f} m in {samples} configurations")
    check(free > 0.5 * samples, f"{100 * free / samples:.1f} % of random arm configurations are free of self-collision")


def disabled_as(reason: str) -> set[tuple[str, ...]]:
    """Link pairs that the SRDF disables for a reason."""
    entries = ElementTree.parse(SRDF).getroot().iter("disable_collisions")
    return {tuple(sorted((e.attrib["link1"], e.attrib["link2"]))) for e in entries if e.attrib["reason"] == reason}


def reach_from_axis(geometry: pin.GeometryObject, placement: pin.SE3) -> float:
    """Largest horizontal distance [m] of a shape from the base axis."""
    g = geometry.geometry
    if isinstance(g, coal.Sphere):
        return float(np.hypot(*placement.translation[:2])) + g.radius
    if isinstance(g, coal.Cylinder):
        t = np.linspace(0, 2 * np.pi, 90)
        points = np.vstack(
            [np.c_[g.radius * np.cos(t), g.radius * np.sin(t), np.full(90, s * g.halfLength)] for s in (-1, 1)]
        )
    else:
        points = np.array(np.meshgrid(*[(-h, h) for h in g.halfSide])).reshape(3, -1).T
    points = points @ placement.rotation.T + placement.translation
    return float(np.hypot(points[:, 0], points[:, 1]).max())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Checks the Silvermate's description.")
    parser.add_argument("--samples", type=int, default=20_000)
    check_yourdfpy()
    check_pinocchio(parser.parse_args().samples)
    sys.exit(f"{len(failures)} failed" if failures else 0)
