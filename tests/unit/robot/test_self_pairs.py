"""Self-collision pairs: what is left out touches by design, nearly always, or never."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from brute_force import configuration, distance, link_poses, random_coordinates, self_distances

from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.robot.geometry import never_touch


def candidates(robot: RobotModel) -> set[tuple[int, int]]:
    """Pairs of pieces whose joints are neither the same nor neighbours."""
    pairs, parents = set(), robot.model.parents
    for i, one in enumerate(robot.geometries):
        for k in range(i + 1, len(robot.geometries)):
            two = robot.geometries[k]
            related = one.joint == two.joint or parents[one.joint] == two.joint or parents[two.joint] == one.joint
            if not related:
                pairs.add((i, k))
    return pairs


def test_pairs_are_of_different_moving_bodies(robot):
    pairs = [tuple(int(x) for x in p) for p in robot.self_pairs]
    assert len(set(pairs)) == len(pairs) > 0
    for i, k in pairs:
        one, two = robot.geometries[i].joint, robot.geometries[k].joint
        assert i < k
        assert one != two


@pytest.mark.parametrize("name", ["tiago", "gantry", "rover"])
def test_omitted_pairs_touch_at_home_nearly_always_or_never(name, request, rng):
    robot: RobotModel = request.getfixturevalue(name)
    kept = {tuple(int(x) for x in p) for p in robot.self_pairs}
    omitted = sorted(p for p in candidates(robot) - kept if min(robot.geometries[i].joint for i in p) > 0)
    assert kept <= candidates(robot) or name == "gantry"
    count, hits = 1500, np.zeros(len(omitted))
    data = robot.model.createData()
    for row in random_coordinates(robot, rng, count):
        poses = link_poses(robot, configuration(robot, row), data)
        for n, (i, k) in enumerate(omitted):
            a, b = robot.geometries[i].geometry, robot.geometries[k].geometry
            hits[n] += distance(a, poses[i], b, poses[k])[0] <= 0.0
    poses = link_poses(robot, robot.home_q)
    for n, (i, k) in enumerate(omitted):
        a, b = robot.geometries[i].geometry, robot.geometries[k].geometry
        at_home = distance(a, poses[i], b, poses[k])[0] <= 0.0
        names = robot.geometries[i].name, robot.geometries[k].name
        assert at_home or hits[n] == 0 or hits[n] > 0.85 * count, (names, hits[n])


def test_home_is_free_of_self_collision(robot):
    if robot.name == "gantry":
        pytest.skip("the gantry's home is not designed")
    assert self_distances(robot, robot.home_q).min() > 0.005


def test_an_srdf_takes_pairs_out(silvermate, tmp_path):
    """Without its SRDF, sampling decides; with it, exactly the pairs that it disables are gone."""
    srdf = tmp_path / "some.srdf"
    one, two = silvermate.geometries[0].links[0], "arm_7_link"
    srdf.write_text(f'<robot name="silvermate"><disable_collisions link1="{one}" link2="{two}" reason="x"/></robot>')
    robot = load_robot(silvermate.urdf_path, srdf=srdf)
    pairs = {tuple(int(x) for x in p) for p in robot.self_pairs}
    names = [g.links[0] for g in robot.geometries]
    gone = {p for p in candidates(robot) - pairs}
    assert gone == {(i, k) for i, k in candidates(robot) if {names[i], names[k]} == {one, two}}
    assert len(gone) == 1


def two_links(limit: float) -> RobotModel:
    """A base post and a bar two joints away that reaches the post only when both joints turn far."""
    import coal

    model, geometry = pin.Model(), pin.GeometryModel()
    root = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "root_joint")
    ids, parent = [root], root
    for name, x in (("a", 0.3), ("b", 0.3)):
        parent = model.addJoint(
            parent, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])), name,
            np.ones(1), np.ones(1), np.array([-limit]), np.array([limit]),
        )  # fmt: skip
        ids.append(parent)
    frames = [model.addJointFrame(i) for i in ids]
    post, bar = coal.Sphere(0.1), coal.Box(0.3, 0.05, 0.05)
    at = pin.SE3(np.eye(3), np.array([0.15, 0.0, 0.0]))
    geometry.addGeometryObject(pin.GeometryObject("post", root, frames[0], pin.SE3.Identity(), post))
    geometry.addGeometryObject(pin.GeometryObject("bar", ids[2], frames[2], at, bar))
    return RobotModel.from_pinocchio(model, geometry, base="omni", disabled_pairs=[])


@pytest.mark.parametrize("limit, never", [(0.5, True), (1.0, True), (2.9, False)])
def test_never_touch_is_a_proof(limit, never, rng):
    robot = two_links(limit)
    rows = random_coordinates(robot, rng, 4000)
    smallest = min(self_distances(robot, configuration(robot, row))[0] for row in rows)
    assert bool(smallest > 0.0) is never
    assert never_touch(robot.model, robot.geometries, 0, 1) is never


def test_too_few_cells_are_no_proof():
    robot = two_links(1.4)
    assert never_touch(robot.model, robot.geometries, 0, 1)
    assert not never_touch(robot.model, robot.geometries, 0, 1, cells=1)
