"""Fetch a can from a table and put it on a counter: drive, reach in, lift, carry, set down; all of it certified."""

import numpy as np
import pinocchio as pin

import elastic_strips as es
from elastic_strips.planning import HandPose, find_goals, plan_straight

robot, hand, ahead = es.load_robot("tiago"), "arm_tool_link", np.array((0.29, 0.02, 0.015))  # where a can is held
table = es.Box((0.5, 1.2, 0.7), at=(2.8, 0.0, 0.35), name="table")
counter = es.Box((1.2, 0.5, 0.9), at=(0.4, 2.2, 0.45), name="counter")
can = es.Cylinder(
    0.03, 0.12, at=(2.65, 0.2, 0.77), name="can"
)  # without its lowest centimetre, which stands on the table
scene = es.Scene([table, counter, es.Box((0.2, 1.5, 1.0), at=(1.2, -0.9, 0.5), name="shelf")])


def reaching(who: es.RobotModel, q: np.ndarray, place: np.ndarray, world: es.Scene) -> tuple[es.Strip, es.Strip]:
    """A drive to before a place, from any side that is free, and the hand's straight way to it."""
    turns = [
        pin.rpy.rpyToMatrix(roll, 0.0, yaw) for yaw in np.arange(0.0, 6.2, 0.5) for roll in (0.0, 1.57, 3.14, -1.57)
    ]
    grasps = [HandPose(hand, tuple(place - R @ ahead), tuple(pin.Quaternion(R).coeffs())) for R in turns]
    for there in find_goals(who, scene, q, grasps, count=20).configurations:
        data = who.model.createData()
        pin.framesForwardKinematics(who.model, data, there)
        back = data.oMf[who.model.getFrameId(hand)].rotation @ (-0.15, 0.0, 0.0)
        way = plan_straight(who, scene, there, hand, back)
        drive = es.plan_report(who, world, q, way.strip.q[-1]) if way.certified else way
        if drive.certified:
            return drive.strip, way.strip.reversed()
    raise SystemExit("no side is free")


out, reach = reaching(robot, robot.home(), can.pose[:3, 3], scene.with_obstacle(can))
laden = robot.attached(can, hand, q=reach.q[-1], mass=0.4)
lift = plan_straight(laden, scene, reach.q[-1], hand, (0.0, 0.0, 0.1)).strip
carry, lower = reaching(laden, lift.q[-1], np.array((0.4, 2.1, 0.97)), scene)
for what, strip in {"drive": out, "reach in": reach, "lift": lift, "carry": carry, "set down": lower}.items():
    report = es.Deformer(strip.robot).assess(strip, scene)
    print(
        f"{what}: {len(strip)} nodes, certified {report.certificate.certified}, {1e3 * report.clearance:.0f} mm clear"
    )
