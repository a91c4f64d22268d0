"""External forces: minus the gradient of potentials whose distances Coal measures anew, and the paper's Eqs. 2–7."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from brute_force import configuration, link_distances, make_obstacle, random_coordinates, self_distances
from cases import each_robot

from elastic_strips.collision import BodySet, MotionBounds, ObstacleProximity, SelfProximity
from elastic_strips.collision.narrowphase import Contacts
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.scene import Box, Scene, Sphere, Voxels
from elastic_strips.strip.forces import add_repulsion, add_self_repulsion, repulsive_magnitude, repulsive_potential
from elastic_strips.strip.paper.equations import control_point_repulsion, map_to_joints
from elastic_strips.strip.solver import System

K_R, INFLUENCE, K_NEAR, NEAR = 1.3, 0.3, 20.0, 0.08


def scene_about(rng: np.random.Generator, shapes: tuple[str, ...], count: int) -> Scene:
    low, high = (-1.0, -1.0, 0.0), (1.0, 1.0, 1.4)
    return Scene([make_obstacle(shapes[k % len(shapes)], rng, low, high) for k in range(count)])


def numeric(robot: RobotModel, row: np.ndarray, potential, h: float = 4e-5) -> tuple[np.ndarray, bool]:
    """Gradient (nv,) of a node's potential by central differences, and whether it is smooth there."""
    slopes = []
    for step in (h, 0.5 * h):
        slope = np.zeros(robot.nv)
        for k in range(robot.nv):
            value = []
            for sign in (1.0, -1.0):
                v = np.zeros(robot.nv)
                v[k] = sign * step
                q = pin.integrate(robot.model, configuration(robot, row), v)
                value.append(potential(robot.space.to_coordinates(q)))
            slope[k] = (value[0] - value[1]) / (2 * step)
        slopes.append(slope)
    coarse, fine = slopes
    best = fine + (fine - coarse) / 3.0  # Richardson
    return best, bool(np.abs(fine - coarse).max() < 1e-5 * max(1.0, np.abs(fine).max()))


def update(robot: RobotModel, scene: Scene, coordinates: np.ndarray) -> tuple[Kinematics, ObstacleProximity]:
    kin = Kinematics(robot.tree, len(coordinates))
    kin.update(coordinates)
    proximity = ObstacleProximity(BodySet.links(robot), influence=INFLUENCE)
    proximity.update(kin, scene)
    return kin, proximity


@pytest.mark.parametrize("name, k_near", [("tiago", K_NEAR), ("silvermate", 0.0)], ids=["near layer", "plain"])
def test_repulsion_is_minus_its_gradient(name, k_near, request):
    """Every shape, separated and penetrating; without the nodes where a nearest point jumps (no gradient there)."""
    robot, rng = request.getfixturevalue(name), np.random.default_rng(6)
    near_seen, checked, deep, jumped = 0, 0, 0, 0

    for _ in range(4):
        scene = scene_about(rng, ("box", "sphere", "cylinder", "capsule", "cone", "convex", "mesh"), 7)
        coordinates = random_coordinates(robot, rng, 6)
        kin, proximity = update(robot, scene, coordinates)
        system = System(6, robot.nv)
        contacts = proximity.contacts()
        add_repulsion(
            system, kin, contacts, proximity.bodies.joint, k_r=K_R, influence=INFLUENCE, k_near=k_near, near=NEAR
        )

        def potential(row: np.ndarray, scene: Scene = scene) -> float:
            d = link_distances(robot, scene, configuration(robot, row))
            v = 0.5 * K_R * np.maximum(INFLUENCE - d, 0.0) ** 2 + 0.5 * k_near * np.maximum(NEAR - d, 0.0) ** 2
            return float(v.sum())

        assert system.energies["repulsion"] == pytest.approx(
            sum(potential(row) for row in coordinates), rel=1e-4, abs=1e-9
        )
        for n in range(6):
            mine = contacts.distance[contacts.node == n]
            if len(mine) == 0:
                np.testing.assert_array_equal(system.force[n], 0.0)
                continue
            slope, smooth = numeric(robot, coordinates[n], potential)
            if not smooth:
                jumped += not (mine < 0.0).any()  # penetrating, Coal's solver itself is not always exact
                continue
            # a normal between round shapes is as good as the square root of what its distance is
            np.testing.assert_allclose(system.force[n], -slope, atol=1e-4 * max(np.abs(slope).max(), 0.1))
            checked += 1
            near_seen += bool((mine < NEAR).any())
            deep += bool((mine < 0.0).any())
    assert checked >= 8
    assert jumped <= 2
    assert near_seen >= 2
    assert deep >= 4


def test_repulsion_matrix_is_gauss_newton(tiago, rng):
    """Σ k ∇d ∇dᵀ with ∇d from finite differences of the distances."""
    scene = scene_about(rng, ("sphere", "box"), 8)
    coordinates = random_coordinates(tiago, rng, 4)
    kin, proximity = update(tiago, scene, coordinates)
    contacts = proximity.contacts()
    system = System(4, tiago.nv)
    add_repulsion(system, kin, contacts, proximity.bodies.joint, k_r=K_R, influence=INFLUENCE, k_near=K_NEAR, near=NEAR)
    h, compared = 1e-5, 0
    for n in range(4):
        slopes = []
        for k in range(tiago.nv):
            v = np.zeros(tiago.nv)
            v[k] = h
            up, down = (
                link_distances(tiago, scene, configuration(tiago, tiago.space.integrate(coordinates[n], s * v)))
                for s in (1.0, -1.0)
            )
            slopes.append((up - down) / (2 * h))
        slope = np.array(slopes)  # (nv, G, P)
        here = link_distances(tiago, scene, configuration(tiago, coordinates[n]))
        weight = np.where(here < INFLUENCE, K_R, 0.0) + np.where(here < NEAR, K_NEAR, 0.0)
        expected = np.einsum("gp,agp,bgp->ab", weight, slope, slope)
        compared += bool(expected.any())
        np.testing.assert_allclose(system.diagonal[n], expected, atol=2e-3 * max(1.0, np.abs(expected).max()))
        assert np.linalg.eigvalsh(system.diagonal[n]).min() > -1e-9
    assert compared >= 2
    np.testing.assert_array_equal(system.upper, 0.0)


def test_repulsion_pushes_away(silvermate):
    coordinates = silvermate.space.to_coordinates(silvermate.home())[None]
    for x, sign in ((0.5, -1.0), (-0.5, 1.0)):
        kin, proximity = update(silvermate, Scene([Sphere(0.1, at=(x, 0.0, 0.15))]), coordinates)
        system = System(1, 10)
        add_repulsion(system, kin, proximity.contacts(), proximity.bodies.joint, k_r=1.0, influence=INFLUENCE)
        assert sign * system.force[0, 0] > 0.01


def test_repulsion_without_contacts_is_nothing(silvermate):
    coordinates = silvermate.space.to_coordinates(silvermate.home())[None]
    kin, proximity = update(silvermate, Scene([Sphere(0.1, at=(9.0, 0.0, 0.15))]), coordinates)
    system = System(1, 10)
    add_repulsion(system, kin, proximity.contacts(), proximity.bodies.joint, k_r=1.0, influence=0.3)
    assert system.energies["repulsion"] == 0.0
    assert not system.force.any()
    assert system.energies == {"repulsion": 0.0}


@pytest.mark.parametrize("name", ["tiago", "gantry"])
def test_self_repulsion_is_minus_its_gradient(name, request):
    robot, rng = request.getfixturevalue(name), np.random.default_rng(1)
    k_s, reach = 5.0, 0.08
    bodies = BodySet.links(robot)
    repulsion = rng.uniform(0.3 * reach, reach, len(robot.self_pairs))
    proximity = SelfProximity(
        bodies, robot.self_pairs, MotionBounds(bodies), influence=reach, repulsion=repulsion, tolerance=0.0
    )
    kin, checked = Kinematics(robot.tree, 4), 0

    def potential(row: np.ndarray) -> float:
        d = self_distances(robot, configuration(robot, row))
        return 0.5 * k_s * float((np.maximum(repulsion - d, 0.0) ** 2).sum())

    for row in random_coordinates(robot, rng, 120):
        if checked == 8:
            break
        if potential(row) < 1e-4:
            continue
        kin.update(row[None])
        proximity.update(kin)
        system = System(1, robot.nv)
        add_self_repulsion(system, kin, proximity, k_s=k_s)
        assert system.energies["self_collision"] == pytest.approx(potential(row), rel=1e-4)
        slope, smooth = numeric(robot, row, potential)
        if not smooth:
            continue
        np.testing.assert_allclose(system.force[0], -slope, atol=1e-5 * max(np.abs(slope).max(), 0.1))
        np.testing.assert_allclose(system.force[0, : robot.space.base_nv], 0.0, atol=1e-12)
        assert np.linalg.eigvalsh(system.diagonal[0]).min() > -1e-9
        checked += 1
    assert checked == 8


def test_eqs_2_and_3():
    d = np.array([-0.1, 0.0, 0.5, 1.0, 2.0])
    np.testing.assert_allclose(repulsive_potential(d, 0.3, 1.0), 0.15 * np.array([1.21, 1.0, 0.25, 0.0, 0.0]))
    np.testing.assert_allclose(repulsive_magnitude(d, 0.3, 1.0), 0.3 * np.array([1.1, 1.0, 0.5, 0.0, 0.0]))


def test_control_points_are_pushed_by_their_nearest_obstacle(silvermate, rng):
    """Eqs. 2–3 written out for spheres and boxes, whose nearest points are known."""
    ball, radius = np.array([0.9, 0.3, 0.8]), 0.25
    crate, half = np.array([-0.6, -0.5, 0.4]), np.array([0.2, 0.3, 0.4])
    scene = Scene([Sphere(radius, at=ball), Box(2 * half, at=crate)])
    coordinates = random_coordinates(silvermate, rng, 10)
    kin = Kinematics(silvermate.tree, 10)
    kin.update(coordinates)
    bodies = BodySet.control_points(silvermate)
    proximity = ObstacleProximity(bodies, influence=1.5, slack=1.0)
    proximity.update(kin, scene)
    force = control_point_repulsion(proximity.contacts(), (10, 9), k_r=0.3, influence=1.5)
    pushed = 0
    for n in range(10):
        points = silvermate.control_points(configuration(silvermate, coordinates[n]))
        for c, p in enumerate(points):
            away = p - ball
            choices = [(np.linalg.norm(away) - radius, away / np.linalg.norm(away))]
            gap = p - np.clip(p, crate - half, crate + half)
            if np.linalg.norm(gap) < 1e-3:
                continue  # inside the crate
            choices.append((np.linalg.norm(gap), gap / np.linalg.norm(gap)))
            d, direction = min(choices, key=lambda x: x[0])
            expected = 0.3 * (1.5 - d) * direction if d < 1.5 else np.zeros(3)
            np.testing.assert_allclose(force[n, c], expected, atol=1e-5)
            pushed += d < 1.5
    assert pushed > 40


def test_the_nearest_of_several_contacts_wins():
    contacts = Contacts(
        node=np.array([0, 0, 1]),
        body=np.array([2, 2, 0]),
        part=np.array([0, 1, 0]),
        distance=np.array([0.1, 0.4, 0.2]),
        direction=np.eye(3),
        witness=np.zeros((3, 3)),
    )
    for order in ([0, 1, 2], [1, 0, 2]):
        mixed = Contacts(*(getattr(contacts, name)[order] for name in contacts.__slots__))
        force = control_point_repulsion(mixed, (2, 3), k_r=2.0, influence=0.5)
        np.testing.assert_allclose(force[0, 2], [0.8, 0.0, 0.0])
        np.testing.assert_allclose(force[1, 0], [0.0, 0.0, 0.6])
        assert np.count_nonzero(force) == 2


@each_robot
def test_mapping_is_the_sum_of_transposed_jacobians(robot, rng):
    """Eqs. 6–7 with Pinocchio's point Jacobians."""
    coordinates = random_coordinates(robot, rng, 4)
    kin = Kinematics(robot.tree, 6)
    kin.update(coordinates)
    bodies = BodySet.control_points(robot)
    c = len(bodies)
    force = rng.normal(size=(4, c, 3))
    points = bodies.capsule_ends(kin)[:, :, 0]
    gamma = map_to_joints(kin, bodies.joint, points, force)
    for n in range(4):
        q = configuration(robot, coordinates[n])
        np.testing.assert_allclose(points[n], robot.control_points(q), atol=1e-12)
        data = robot.model.createData()
        pin.computeJointJacobians(robot.model, data, q)
        expected = np.zeros(robot.nv)
        for i in range(c):
            joint = int(bodies.joint[i])
            J = pin.getJointJacobian(robot.model, data, joint, pin.LOCAL_WORLD_ALIGNED)
            lever = points[n, i] - data.oMi[joint].translation
            J_point = J[:3] + np.cross(J[3:].T, lever).T
            expected += J_point.T @ force[n, i]
        np.testing.assert_allclose(gamma[n], expected, atol=1e-10)


def test_mapped_forces_do_the_same_work(silvermate, rng):
    """Virtual work: Γ·v = Σ F·δp, by finite differences of the control points."""
    row, h = random_coordinates(silvermate, rng, 1), 1e-6
    kin = Kinematics(silvermate.tree, 1)
    kin.update(row)
    bodies = BodySet.control_points(silvermate)
    force = rng.normal(size=(1, 9, 3))
    gamma = map_to_joints(kin, bodies.joint, bodies.capsule_ends(kin)[:, :, 0], force)[0]
    v = rng.normal(size=10)
    moved = [
        silvermate.control_points(configuration(silvermate, silvermate.space.integrate(row[0], s * h * v)))
        for s in (1, -1)
    ]
    work = float((force[0] * (moved[0] - moved[1]) / (2 * h)).sum())
    assert gamma @ v == pytest.approx(work, rel=1e-6)


def test_a_block_pushes_once(silvermate):
    """Of the boxes of one block only the nearest counts, like the one box that they make up."""
    coordinates = silvermate.space.to_coordinates(silvermate.home())[None]
    cells = np.array([[x, y, z] for x in range(2) for y in range(4) for z in range(2)]) * 0.1
    voxels = Scene([Voxels(cells, 0.1, at=(0.5, -0.15, 0.1))])
    box = Scene([Box((0.2, 0.4, 0.2), at=(0.55, 0.0, 0.15))])
    forces = []
    for scene in (voxels, box):
        kin, proximity = update(silvermate, scene, coordinates)
        system = System(1, 10)
        add_repulsion(system, kin, proximity.contacts(), proximity.bodies.joint, k_r=1.0, influence=INFLUENCE)
        forces.append(system.force[0])
    assert np.abs(forces[1]).max() > 0.01
    np.testing.assert_allclose(forces[0], forces[1], atol=1e-4)
