"""Fetch a can from a table and put it on a counter: drive, reach in, lift, carry it upright, set it down."""

from dataclasses import replace

import numpy as np
import pinocchio as pin

import elastic_strips as es
from elastic_strips.control import DriveParams
from elastic_strips.control.params import DRIVE_STRIP
from elastic_strips.planning import HandPose, PlanReport, plan_approach, plan_straight
from elastic_strips.sim import simulation
from elastic_strips.sim.plant import KinematicPlant, OdometryParams, PlantParams
from elastic_strips.strip import OrientationConstraint
from elastic_strips.trajectory import MotionLimits

robot, hand, ahead = es.load_robot("tiago"), "arm_tool_link", np.array((0.29, 0.02, 0.015))  # where a can is held
table = es.Box((0.5, 1.2, 0.7), at=(2.8, 0.0, 0.35), name="table")
counter = es.Box((1.2, 0.5, 0.9), at=(0.4, 2.2, 0.45), name="counter")
shelf = es.Box((0.2, 1.5, 1.0), at=(1.2, -0.9, 0.5), name="shelf")
can = es.Cylinder(0.03, 0.12, at=(2.65, 0.2, 0.775), name="can")  # it stands on 15 mm of foam
scene = es.Scene([table, counter, shelf])

FAR = DriveParams()  # 25 mm from everything, of which 20 are for wheels that slip
NEAR = DriveParams(  # the base stands: 8 mm do
    tracking_error=0.007, margin=0.001, evasion=None, goal_position=0.01, goal_angle=0.01, speed_scale=0.3,
    deform=DRIVE_STRIP.replaced(influence=0.1, near=0.03),
)  # fmt: skip
SEES = PlantParams(odometry=OdometryParams(fix_noise=0.0005, fix_angle_noise=0.0005))  # as a camera at the hand does


def grasps(place: np.ndarray, turns: list[np.ndarray]) -> list[HandPose]:
    """The hand about a can at a place, turned by any of the rotations, and by any angle about the vertical."""
    every = [pin.rpy.rpyToMatrix(0.0, 0.0, yaw) @ turn for yaw in np.arange(0.0, 6.2, 0.5) for turn in turns]
    return [HandPose(hand, tuple(place - R @ ahead), tuple(pin.Quaternion(R).coeffs())) for R in every]


def drive(what: str, plan: PlanReport | None, world: es.Scene, params: DriveParams, plant: PlantParams) -> np.ndarray:
    """Drive along a planned strip, and say how it was; where the robot stands then."""
    if plan is None or not plan.certified:
        raise SystemExit(f"{what}: {'no way' if plan is None else plan.reason}")
    who, strip = plan.strip.robot, plan.strip
    machine = KinematicPlant(who, MotionLimits.for_robot(who), plant, seed=1)
    run = simulation(who, world, strip.q[0], strip.q[-1], params=params, plant=machine, strip=strip)
    result = run.run(time_limit=60.0)
    print(f"{what}: {result.state.label} after {result.record.control.time[-1]:.1f} s, certified {plan.certified}")
    return who.space.from_coordinates(result.record.control.reference[-1])


quarters = [pin.rpy.rpyToMatrix(roll, 0.0, 0.0) for roll in (0.0, 1.57, 3.14, -1.57)]
to_can = plan_approach(
    robot, scene, robot.home(), grasps(can.pose[:3, 3], quarters), (0.2, 0.0, 0.0), beyond=scene.with_obstacle(can),
    params=FAR.strip, near=NEAR.strip,
)  # fmt: skip
drive("drive", to_can.drive, scene.with_obstacle(can), FAR, PlantParams())
q = drive("reach in", to_can.reach, scene, NEAR, SEES)
laden = robot.attached(can, hand, q=q, mass=0.4)
q = drive("lift", plan_straight(laden, scene, q, hand, (0.0, 0.0, 0.1), params=NEAR.strip), scene, NEAR, SEES)
data = laden.model.createData()
pin.framesForwardKinematics(laden.model, data, q)
upright = data.oMf[laden.model.getFrameId(hand)].rotation.copy()
back = plan_straight(laden, scene, q, hand, upright @ (-0.2, 0.0, 0.0), params=NEAR.strip)
q = drive("draw back", back, scene, NEAR, SEES)
level = OrientationConstraint.from_configuration(laden, q, hand)  # nothing is spilt
to_counter = plan_approach(
    laden, scene, q, grasps(np.array((0.4, 2.1, 0.975)), [upright]), (0.0, 0.0, -0.12), axes="world",
    params=FAR.strip, near=NEAR.strip, constraint=level,
)  # fmt: skip
q = drive("carry", to_counter.drive, scene, replace(FAR, constraint=level), PlantParams())
drive("set down", to_counter.reach, scene, NEAR, SEES)
