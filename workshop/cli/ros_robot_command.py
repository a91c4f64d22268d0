"""``python -m workshop ros-robot | ros-pilot | ros-trials``: a simulated robot on the other side of ROS 2, and who
harms it."""

from __future__ import annotations

import json

import click

from elastic_strips.cli import options, output
from elastic_strips.cli.output import row
from workshop.bench.pilots import PILOTS

from .bench_options import runs_option, seeds_option


@click.command(
    name="ros-robot",
    context_settings={"ignore_unknown_options": True, "allow_interspersed_args": False},
    short_help="A simulated robot as a ROS 2 node, which judges how it is driven.",
)
@options.robot_option("silvermate")
@click.option("--seed", type=options.SEED, default=0, show_default=True, help="Seed of corridor, slip and noise.")
@click.option("--odometry", type=options.Finite(1.0, 200.0), default=50.0, show_default=True, help="Rate [Hz].")
@click.option("--joint-states", type=options.Finite(1.0, 200.0), default=50.0, show_default=True, help="Rate [Hz].")
@click.option("--reliable/--best-effort", default=False, show_default=True, help="How its sensors are published.")
@click.option("--stamped/--twist", default=True, show_default=True, help="TwistStamped or Twist for velocities.")
@click.option("--arm", type=click.Choice(["trajectory", "velocity"]), default="trajectory", show_default=True)
@click.option("--delay", type=options.Finite(0.0, 1.0), default=0.0, help="By so much all comes late [s].")
@click.option("--loss", type=options.Finite(0.0, 1.0), default=0.0, help="Part of messages that is lost.")
@click.option("--for", "seconds", type=options.Finite(1.0, 3600.0), default=60.0, show_default=True)
@click.option("--length", type=options.Finite(2.0, 50.0), default=6.0, show_default=True, help="Of the corridor [m].")
@click.option("--depth/--no-depth", default=False, show_default=True, help="A depth camera on its head.")
@click.option("--magnified", type=click.IntRange(1, 8), default=1, help="Each pixel of it as so many by so many.")
@click.option("--cloud/--no-cloud", default=False, show_default=True, help="What the laser sees as a cloud, too.")
@click.option("--fix", type=options.Finite(0.0, 50.0), default=0.0, help="Rate of its localization [Hz]; 0: none.")
@click.option("--plant", type=click.Choice(["kinematic", "mujoco"]), default="kinematic", show_default=True)
@click.option("--fault", "faults", multiple=True, metavar="KIND:AT[:FOR]", help="What goes wrong once it is fast.")
@click.option("--json", "json_file", metavar="FILE", default="-", show_default=True, help="Where its result goes.")
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED, metavar="[--ros-args …]")
def ros_robot(
    json_file: str, joint_states: float, faults: tuple[str, ...], arguments: tuple[str, ...], **given: object
) -> None:
    """A simulated robot in a corridor with pillars, as a ROS 2 node; Ctrl-C ends it, and it tells what it touched."""
    from workshop.bench.ros_robot import RosRobot, RosRobotParams, TimedFault

    params = RosRobotParams(joints=joint_states, faults=tuple(map(TimedFault.of, faults)), **given)  # type: ignore[arg-type]
    robot = RosRobot(params, list(arguments))
    result = robot.run(lambda text: click.echo(text, err=True))
    text = json.dumps(result, indent=2)
    if json_file == "-":
        click.echo(text)
    else:
        with open(json_file, "w", encoding="utf-8") as file:
            file.write(text + "\n")


@click.command(
    name="ros-pilot",
    context_settings={"ignore_unknown_options": True, "allow_interspersed_args": False},
    short_help="Somebody hostile at the topics that a ROS 2 node guards.",
)
@click.option("--seed", type=options.SEED, default=0, show_default=True, help="Of the corridor and of the pilot.")
@click.option("--kind", type=click.Choice(list(PILOTS)), default="rammer", show_default=True)
@click.option("--for", "seconds", type=options.Finite(1.0, 3600.0), default=10.0, show_default=True)
@click.option("--spoilt/--clean", default=False, show_default=True, help="Some commands are none.")
@click.option("--stamped/--twist", default=True, show_default=True, help="TwistStamped or Twist.")
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED, metavar="[--ros-args …]")
def ros_pilot(kind: str, seed: int, seconds: float, spoilt: bool, stamped: bool, arguments: tuple[str, ...]) -> None:
    """Full speed at the things of a ros-robot's corridor, by cmd_vel_in and joint_velocities_in."""
    from workshop.bench.ros_pilot import fly

    sent = fly(kind, seed, seconds, spoilt=spoilt, stamped=stamped, arguments=list(arguments))
    click.echo(f"{sent} commands were sent")


@click.command(name="ros-trials", short_help="Drive a ros-robot by the ROS 2 node while something goes wrong.")
@click.option(
    "--kind",
    "kinds",
    multiple=True,
    type=options.LateChoice("workshop.bench.ros_trials", "KINDS"),
    help="Only this one; may be given again. Without it: all in which something goes wrong.",
)
@seeds_option(10, "Trials of each kind.")
@click.option("--first", type=options.SEED, default=0, show_default=True, help="First seed.")
@click.option("--odometry", type=options.Finite(1.0, 200.0), default=50.0, show_default=True, help="Rate [Hz].")
@click.option("--reliable/--best-effort", default=False, show_default=True, help="How its sensors are published.")
@runs_option
def ros_trials(
    kinds: tuple[str, ...], seeds: int, first: int, odometry: float, reliable: bool, json_file: str | None
) -> None:
    """Robot and node in processes of their own, over DDS on this machine alone: processes are killed, topics stop, come
    late, twice or in the wrong order. Each drive takes about 15 s by the wall clock, so nothing else should run."""
    from workshop.bench.ros_trials import FAULTS, bench_ros_trials

    chosen, numbers = kinds or FAULTS, range(first, first + seeds)
    with options.LateProgress("driving", seeds * len(chosen)) as bar:
        figures = bench_ros_trials(numbers, bar.step, kinds=chosen, odometry=odometry, reliable=reliable)
    for kind, some in figures["kinds"].items():
        rest, named, gaps, off = (some[key] for key in ("longest_to_rest_s", "named", "gaps_ms", "deviation_m"))
        parts = [
            f"{some['as_it_should']} of {some['count']} as they should be",
            f"{some['contacts_at_speed']} contacts at speed",
            f"{some['made_anew']} made anew, as the robot was not run for a while before" if some["made_anew"] else "",
            "" if rest is None else f"at rest after {rest:.2f} s at most",
            "" if named is None else f"{named} named",
            "" if off is None else f"{off:.2f} m off at most",
            "" if some["median_s"] is None else f"{some['median_s']:.1f} s (median)",
            "" if gaps is None else f"commands every {gaps[0]:.1f}, p99 {gaps[1]:.1f}, at most {gaps[2]:.1f} ms",
            "processors " + ", ".join(f"{name} {share:.2f}" for name, share in some["processors"].items()),
            f"{some['left']} left" if some["left"] else "",
        ]
        row(kind, "; ".join(part for part in parts if part))
    output.write_document("figures", json_file, figures)
