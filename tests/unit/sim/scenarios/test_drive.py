"""Driving scenarios: by which sensors, and what was touched without having been seen."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
from cases import refused

from elastic_strips.control import DriveParams
from elastic_strips.control.params import LASER_ASSUMPTIONS
from elastic_strips.errors import ParameterError
from elastic_strips.io import PoseSpec
from elastic_strips.scene import Box, Obstacle, Scene, Sphere, Twist, World
from elastic_strips.sim import Fault, SensorPerception
from elastic_strips.sim.evaluation.drive_evaluation import Contact
from elastic_strips.sim.evaluation.visibility import unseen_contacts
from elastic_strips.sim.scenarios import drive_document, drive_scenario, make_simulation
from elastic_strips.sim.scenarios.scenario import Scenario
from elastic_strips.sim.sensors import DepthParams, SensorConfig
from elastic_strips.strip import LookAt

LASER = SensorConfig().only("laser")
PILLAR = Box((0.4, 0.4, 1.5), at=(1.5, 0.3, 0.75), name="pillar")
BEAM = Box((0.1, 1.0, 0.3), at=(1.5, 0.0, 1.15), name="beam")
"""Hangs across the way, above the laser's plane and as high as the robot's body."""


def scenario(*obstacles: Obstacle) -> Scenario:
    return Scenario(
        name="short", summary="", scene=Scene(obstacles), start=PoseSpec(0.0, 0.0, 0.0), goal=PoseSpec(3.0, 0.0, 0.0)
    )


def test_how_near_counts_as_reached_may_be_said(silvermate):
    assert make_simulation(scenario(), robot=silvermate, goal_within=0.004).params.goal_position == 0.004
    assert make_simulation(scenario(), robot=silvermate).params.goal_position == DriveParams().goal_position
    driven = drive_scenario(scenario(PILLAR), robot=silvermate, goal_within=0.004)
    assert driven.reached
    (goal,) = driven.result.goals
    assert goal.position <= 0.004
    assert goal.joints <= 0.004


def test_the_laser_is_all_that_the_planner_knows(silvermate):
    driven = make_simulation(scenario(PILLAR), robot=silvermate, sensors=LASER)
    assert isinstance(driven.perception, SensorPerception)
    assert driven.params.assumptions == LASER_ASSUMPTIONS
    outcome = drive_scenario(scenario(PILLAR), robot=silvermate, sensors=LASER, time_limit=20.0)
    assert outcome.reached, outcome.result.reason
    assert not outcome.evaluation.contacts
    assert (outcome.sensors, outcome.unseen) == (("laser",), ())
    assert outcome.separation is not None
    assert outcome.separation > 0.0


def test_by_how_much_a_moving_thing_was_not_looked_at_is_by_where_it_truly_was(silvermate):
    problem = scenario(Sphere(0.1, at=(6.0, -1.0, 1.0), name="ball", motion=Twist((0.0, 0.3, 0.0))))
    look = LookAt(frame="hand_frame", axis=(1.0, 0.0, 0.0), at="ball")
    outcome = drive_scenario(problem, robot=silvermate, params=DriveParams(constraint=look), time_limit=40.0)
    assert outcome.reached, "what cannot be satisfied does not stop the robot"
    model, data, off = silvermate.model, silvermate.model.createData(), []
    control = outcome.result.record.control
    for q, t in zip(silvermate.space.from_coordinates(control.coordinates), control.time, strict=True):
        pin.forwardKinematics(model, data, q)
        hand = pin.updateFramePlacement(model, data, model.getFrameId("hand_frame"))
        line = problem.scene.at(float(t)).obstacle("ball").pose[:3, 3] - hand.translation
        off.append(np.arccos(hand.rotation[:, 0] @ line / np.linalg.norm(line)))
    assert outcome.constraint_error is not None
    np.testing.assert_allclose(outcome.constraint_error, max(off), atol=1e-6)
    nobody = replace(look, at="nobody")
    unseen = drive_scenario(problem, robot=silvermate, params=DriveParams(constraint=nobody), time_limit=40.0)
    assert unseen.reached
    assert unseen.constraint_error is None


def test_a_hand_stays_level_all_the_way(silvermate):
    """A ball hangs where the arm comes by."""
    ball = Sphere(0.2, at=(1.5, -0.2, 1.1), name="ball")
    outcome = drive_scenario(scenario(ball), robot=silvermate, level="hand_frame", time_limit=40.0)
    assert outcome.reached, outcome.result.reason
    assert not outcome.evaluation.contacts
    assert outcome.constraint_error is not None
    assert outcome.constraint_error < 0.02
    free = drive_scenario(scenario(ball), robot=silvermate, time_limit=40.0)
    assert free.constraint_error is None
    start, (model, data) = silvermate.home(), (silvermate.model, silvermate.model.createData())
    frame = model.getFrameId("hand_frame")

    def tilt(q: np.ndarray) -> float:
        pin.forwardKinematics(model, data, q)
        up = pin.updateFramePlacement(model, data, frame).rotation @ axis
        return float(np.arccos(np.clip(up[2], -1.0, 1.0)))

    pin.forwardKinematics(model, data, start)
    axis = pin.updateFramePlacement(model, data, frame).rotation.T @ (0.0, 0.0, 1.0)
    kept, tilted = (
        max(tilt(q) for q in silvermate.space.from_coordinates(o.result.record.control.coordinates[::10]))
        for o in (outcome, free)
    )
    assert kept <= outcome.constraint_error + 1e-9
    assert kept < 0.02 < tilted


def test_who_sees_ahead_only_does_not_drive_backwards(silvermate):
    """The goal is behind the robot, and so is a pillar that its laser does not see from the start."""
    pillar = Box((0.4, 0.4, 1.5), at=(-1.5, 0.3, 0.75), name="pillar")
    behind = replace(scenario(pillar), goal=PoseSpec(-3.0, 0.0, 0.0))
    outcome = drive_scenario(behind, robot=silvermate, sensors=LASER, time_limit=40.0)
    assert outcome.reached, outcome.result.reason
    assert not outcome.evaluation.contacts
    drive = outcome.result.record.control
    beside = np.abs(drive.coordinates[:, 0] + 1.5) < 0.4
    assert (drive.v[beside, 0] > 0.0).all(), "it has turned before it is there"
    turning = np.abs(drive.v[:, 2]).max()
    assert turning < 1.2, "who sees ahead only turns slowly enough for what comes into view"
    assert make_simulation(behind, robot=silvermate).params.turn_speed > turning
    assert make_simulation(behind, robot=silvermate).params.backward
    assert make_simulation(behind, robot=silvermate, sensors=SensorConfig()).params.backward, "sonars look behind"


def test_what_hangs_above_the_laser_is_told_apart(silvermate):
    outcome = drive_scenario(scenario(BEAM), robot=silvermate, sensors=LASER, time_limit=7.0)
    assert [contact.obstacle for contact in outcome.evaluation.collisions] == ["beam"]
    assert outcome.unseen == ("beam",)
    assert outcome.seen_collisions == 0
    camera = SensorConfig(sensors=(DepthParams(frame="head_frame", axis="x", tilt=0.35, field_of_view=1.5),))
    record, evaluation, world = outcome.result.record, outcome.evaluation, scenario(BEAM).world
    assert unseen_contacts(record, evaluation, silvermate, world, LASER) == evaluation.contacts
    assert unseen_contacts(record, evaluation, silvermate, world, camera) == (), "it was in the images"
    document = drive_document(outcome)
    assert document["unseen_contacts"] == ["beam"]
    assert document["sensors"] == ["laser"]
    json.dumps(document, allow_nan=False)


def test_glass_is_not_in_view(silvermate):
    """A laser sees through it, and the robot drives against it; where it is opaque, it drives around it."""
    door = Box((0.1, 0.6, 1.5), at=(1.5, 0.0, 0.75), name="door")
    for faults, touched in (([], []), ([Fault("glass", 0.0, 100.0, 1.0)], ["door"])):
        outcome = drive_scenario(scenario(door), robot=silvermate, sensors=LASER, faults=faults, time_limit=20.0)
        assert list(dict.fromkeys(contact.obstacle for contact in outcome.evaluation.collisions)) == touched
        assert list(outcome.unseen) == touched
        assert outcome.seen_collisions == 0


def test_of_a_long_wall_the_place_that_was_touched_has_to_be_in_view(silvermate):
    wall = Box((8.0, 0.2, 1.5), at=(2.0, 0.6, 0.75), name="wall")
    outcome = drive_scenario(scenario(BEAM), robot=silvermate, sensors=LASER, time_limit=1.0)
    record, evaluation, world = outcome.result.record, outcome.evaluation, World(Scene([wall]))
    contact = Contact(time=0.3, end=0.4, link="base_link", obstacle="wall", depth=0.01, speed=0.3)
    touched = replace(evaluation, contacts=(contact,))
    for field_of_view, unseen in ((0.8, touched.contacts), (3.1, ())):  # [rad]; the one sees it only from 1 m ahead on
        laser = SensorConfig(sensors=(replace(LASER.sensors[0], field_of_view=field_of_view),))
        assert unseen_contacts(record, touched, silvermate, world, laser) == unseen


def test_wrong_names_are_refused(silvermate):
    with refused(ParameterError, "'laser'"):
        SensorConfig().only("lazer")
    with refused(ParameterError, "steam"):
        make_simulation(scenario(), robot=silvermate, plant="steam")
