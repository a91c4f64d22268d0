"""``elastic-strips ros2``: the node that drives a robot that speaks ROS 2."""

from __future__ import annotations

import click

from . import options, output

_EXIT_NOT_REACHED = 3


@click.command(
    context_settings={"ignore_unknown_options": True, "allow_interspersed_args": False},
    short_help="Drive a robot that speaks ROS 2.",
)
@click.option("--robot", metavar="NAME|FILE.urdf", help="The robot; if not given, the node's parameter of that name.")
@click.option("--goals", type=options.Whole(1), help="End after this many goals.  [default: never]")
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED, metavar="[--ros-args …]")
def ros2(robot: str | None, goals: int | None, arguments: tuple[str, ...]) -> int:
    """Drive a robot that speaks ROS 2, to goals on /goal_pose: odometry, joint states and scans in, velocities out.

    With -p mode:=guard it has no goals, and passes on what somebody else commands on cmd_vel_in, as far as that is
    safe.

    What follows --ros-args is for ROS: \b--params-file FILE, -p NAME:=VALUE, -r FROM:=TO.

    It needs rclpy: a sourced ROS 2, or the extra ros2. Ctrl-C brings the robot to rest first.
    """
    from elastic_strips.control import RunState
    from elastic_strips.ros2 import run_node

    given = list(arguments)
    if robot is not None:
        given = [*(given or ["--ros-args"]), "-p", f"robot:={robot}"]
    state = run_node(given, goals=goals)
    output.say(f"the robot is at rest: {state.label}")
    return 0 if state is RunState.REACHED else _EXIT_NOT_REACHED
