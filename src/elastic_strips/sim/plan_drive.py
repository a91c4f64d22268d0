"""Driving a plan in a simulated world, by the controller of the elastic strip."""

from __future__ import annotations

from elastic_strips.arrays import Array
from elastic_strips.control import DriveParams
from elastic_strips.control.record import DriveResult
from elastic_strips.errors import ParameterError
from elastic_strips.planning import PlanReport
from elastic_strips.scene import Scene, World
from elastic_strips.trajectory import MotionLimits
from elastic_strips.validation import check_type, named_arguments

from .closed_loop import simulation
from .plant import KinematicPlant, PlantParams


@named_arguments
def drive_plan(
    plan: PlanReport,
    world: World | Scene,
    params: DriveParams | None = None,
    *,
    limits: MotionLimits | None = None,
    plant: PlantParams | None = None,
    seed: int = 0,
    time_limit: float | None = None,
    compute: str | float = "free",
) -> tuple[DriveResult, Array]:
    """Drive a plan in a world; returns the result, and the configuration (nq,) at which the robot believes to stand.

    Args:
        plan: the plan; its robot is driven, with everything it holds.
        world: the true obstacles.
        params: parameters of the controller; no more clearance is asked for than the plan has.
        limits: limits of wheels and joints; those of the robot's URDF where None.
        plant: parameters of the simulated machine.
        seed: seed of plant and perception.
        time_limit: longest drive [s]; that of ``params`` where None.
        compute: what computing costs in simulated time, as for :func:`simulation`.

    Raises:
        ParameterError: the plan is not certified (the message has its reason), or the URDF says nothing about wheels.
    """
    check_type("plan", plan, PlanReport, ParameterError)
    if not plan.certified:
        raise ParameterError(f"the plan is not certified: {plan.reason}")
    check_type("plant", plant, PlantParams, none=True)
    strip, robot = plan.strip, plan.strip.robot
    limits = MotionLimits.for_robot(robot) if limits is None else limits
    run = simulation(
        robot,
        world,
        strip.q[0],
        strip.q[-1],
        limits=limits,
        params=params,
        strip=strip,
        seed=seed,
        plant=KinematicPlant(robot, limits, plant, seed=seed),
        compute=compute,
    )
    result = run.run(time_limit=time_limit)
    return result, robot.space.from_coordinates(result.last)
