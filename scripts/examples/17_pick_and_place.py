"""Fetch a can from a table and put it on a counter: drive, reach in, lift, carry it upright, set it down."""

from dataclasses import replace

import pinocchio as pin

import elastic_strips as es
from elastic_strips.arrays import Array
from elastic_strips.planning import PlanReport, plan_approach, plan_straight
from elastic_strips.sim import PlantParams, drive_plan
from elastic_strips.strip import OrientationConstraint

robot, hand, held = es.load_robot("tiago"), "arm_tool_link", (0.29, 0.02, 0.015)  # where a can is held in the hand
table = es.Box((0.5, 1.2, 0.7), at=(2.8, 0.0, 0.35), name="table")
counter = es.Box((1.2, 0.5, 0.9), at=(0.4, 2.2, 0.45), name="counter")
shelf = es.Box((0.2, 1.5, 1.0), at=(1.2, -0.9, 0.5), name="shelf")
can = es.Cylinder(0.03, 0.12, at=(2.65, 0.2, 0.775), name="can")  # it stands on 15 mm of foam
scene = es.Scene([table, counter, shelf])
far, near = es.DriveParams(), es.DriveParams.standing()


def drive(what: str, plan: PlanReport | None, world: es.Scene, params: es.DriveParams):
    assert plan is not None, f"{what}: no way"
    plant = PlantParams.seen_closely() if params is near else PlantParams()
    result, q = drive_plan(plan, world, params, plant=plant, seed=1)
    print(f"{what}: {result.state.label} after {result.record.duration:.1f} s, certified {plan.certified}")
    return q


rolls = [pin.rpy.rpyToMatrix(roll, 0.0, 0.0) for roll in (0.0, 1.57, 3.14, -1.57)]
grasps = es.HandPose.around(hand, can.pose[:3, 3], held=held, rotations=rolls)
with_can = scene.with_obstacle(can)
lift = (0.0, 0.0, 0.1)


def holding(q: Array) -> es.RobotModel:
    return robot.attached(can, hand, q=q, mass=0.4)


to_can = plan_approach(
    robot, scene, robot.home(), grasps, (0.2, 0.0, 0.0), then=lift, holding=holding, beyond=with_can,
    params=far.strip, near=near.strip,
)  # fmt: skip
drive("drive", to_can.drive, with_can, far)
q = drive("reach in", to_can.reach, scene, near)
laden = holding(q)
q = drive("lift", plan_straight(laden, scene, q, hand, lift, params=near.strip), scene, near)
back = plan_straight(laden, scene, q, hand, (-0.12, 0.0, 0.0), axes="hand", params=near.strip)
q = drive("draw back", back, scene, near)
level = OrientationConstraint.from_configuration(laden, q, hand)  # nothing is spilt
places = es.HandPose.around(hand, (0.4, 2.1, 0.975), held=held, rotations=laden.frame_pose(q, hand)[:3, :3])
to_counter = plan_approach(
    laden, scene, q, places, (0.0, 0.0, -0.12), axes="world", params=far.strip, near=near.strip, constraint=level
)
q = drive("carry", to_counter.drive, scene, replace(far, constraint=level))
drive("set down", to_counter.reach, scene, near)
