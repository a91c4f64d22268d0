"""``elastic-strips drive``: the closed loop; what is driven is evaluated, recorded and shown."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import click

from elastic_strips.catalogue import FAULTS
from elastic_strips.errors import plural, without_numbers

from . import EXIT_INTERRUPTED, options, output
from .robot_options import load_robot, robot_options

if TYPE_CHECKING:
    from elastic_strips.control import Controller, DriveResult, Event
    from elastic_strips.planning import Goal
    from elastic_strips.robot import LoadOptions
    from elastic_strips.sim import Simulation
    from elastic_strips.sim.scenarios import DriveOutcome, Scenario
    from elastic_strips.viewer import Seen, Viewer
    from elastic_strips.viewer.dragged_goal import DraggedGoal


_LASER_MAP = re.compile(r"\bmap--?\d+--?\d+\b")  # a tile of what lasers have met
_STOPS_TOLD = 5  # kinds of stops
_COMPUTING_FACTOR = (
    "ms by the wall clock; {late} late in simulated time, in which computing costs {factor:g} × its processor time"
)
_COMPUTING = {  # by which clock ticks are measured, and by which they are late
    "free": "ms, {late} late, both by the wall clock; computing costs no simulated time",
    "work": "ms by the wall clock; {late} late in simulated time, in which computing costs its counted work",
    "realtime": "ms, {late} late, both by the wall clock",
}


def _base_method(_context: click.Context, _option: click.Parameter, method: str | None) -> None:
    """Say where the option of earlier versions is."""
    if method is not None:
        raise click.UsageError(
            "base methods are not part of the package: in a checkout of its sources, "
            f"python -m workshop base SCENARIO --method {method}"
        )


@click.command()
@click.argument("scenario", metavar="NAME|FILE.yaml", type=options.SCENARIO)
@click.option("--method", hidden=True, expose_value=False, callback=_base_method)
@options.robot_option(help="A robot other than the scenario's.")
@robot_options
@options.base_option()
@options.limit_options
@click.option(
    "--seed", type=options.SEED, help="Seed of the planner, the simulated machine, its noise and generated scenes."
)
@click.option(
    "--plant",
    type=options.PLANT,
    default="kinematic",
    show_default=True,
    help="The machine: kinematic, a base of any kind with slip and lag; or mujoco, MuJoCo physics (the extra sim), for "
    "differential drives.",
)
@options.sensors_option
@options.goals_option
@click.option("--time-limit", type=options.Finite(0.1, 36000), help="Time limit of the drive [s of simulated time].")
@options.evade_option
@click.option(
    "--alternatives",
    type=options.Whole(1, 8),
    default=1,
    show_default=True,
    help="How many strips to keep on different sides of the obstacles; where one is given up, another is followed.",
)
@options.level_option
@click.option(
    "--goal-within",
    type=options.Finite(0.001, 1.0),
    metavar="METRES",
    help="How far off the goal counts as reached: the base [m], and heading and joints [rad or m]; 0.05 by default. A "
    "hand that is to grip something may want 0.005.",
)
@options.compute_option
@click.option(
    "--realtime",
    is_flag=True,
    help="Drive by the wall clock; machine, control loop and planning each run in a process of their own.",
)
@click.option(
    "--log",
    metavar="FILE.jsonl",
    type=click.Path(dir_okay=False, writable=True),
    help="With --realtime: the log that the control loop writes while it drives, one line per control period.",
)
@click.option(
    "--disturb",
    "--fault",
    "faults",
    multiple=True,
    type=options.FAULT,
    metavar="KIND[=SIZE]@START[+DURATION]",
    help="Inject a fault, such as slip-left=0.5@4+2; times in seconds. May be repeated. KIND: "
    + ", ".join(kind.replace("_", "-") for kind in FAULTS)
    + ".",
)
@options.json_option("Write the result.")
@click.option(
    "--record",
    "record_file",
    metavar="FILE.npz|FILE.csv",
    type=click.Path(),
    help="Write a record of everything that happened, for 'elastic-strips view' to replay.",
)
@options.html_option("Write a standalone 3D page of the drive.")
@options.picture_options
@click.option(
    "--view",
    is_flag=True,
    help="Show the drive in the browser, on this machine only; its goal can be dragged. Then its replay until Ctrl-C.",
)
@options.browser_option
def drive(
    scenario: str,
    robot: str | None,
    described: LoadOptions,
    base: str | None,
    limits: options.GivenLimits,
    seed: int | None,
    plant: str,
    sensors: str | None,
    goals: tuple[Goal, ...],
    time_limit: float | None,
    evade: bool | None,
    alternatives: int,
    level: str,
    goal_within: float | None,
    compute: str | None,
    realtime: bool,
    log: str | None,
    faults: tuple[str, ...],
    json_file: str | None,
    record_file: str | None,
    html_file: str | None,
    png_file: str | None,
    film_file: str | None,
    view: bool,
    no_browser: bool,
) -> int:
    """Plan a strip and drive it in a closed loop: at every tick the strip gives way to sensed obstacles, the motion
    ahead is certified down to its stop, and the robot follows it, while moving obstacles go on moving.

    Ctrl-C brings the robot to rest, and the record is written; a second one ends at once and writes nothing.

    Exit code 0: reached. 2: wrong input. 3: not reached, or a collision; the reason is printed. 130: interrupted.
    """
    from elastic_strips.io.record_file import check_record_file
    from elastic_strips.sim import Fault
    from elastic_strips.sim.scenarios import get_scenario, make_simulation
    from elastic_strips.sim.scenarios.drive import DriveSetup, make_realtime

    options.check_outputs(scenario, json_file, record_file, html_file, png_file, film_file, log)
    if record_file is not None:
        check_record_file(record_file)
    problem = get_scenario(scenario, seed=seed or 0)
    model = load_robot(problem, robot, described, "default", base)
    setup = DriveSetup(
        robot=model,
        seed=problem.seed if seed is None else seed,
        plant=plant,
        evade=evade is not False,
        limits=limits.of(model),
        faults=[Fault.parse(text) for text in faults],
        sensors=options.sensors_of(sensors, model.name),
        alternatives=alternatives,
        level=level,
        goal_within=goal_within,
        compute="free" if realtime else compute or "1",
        goals=goals,
    )
    if realtime and (compute or plant != "kinematic"):
        raise click.UsageError(
            "--realtime goes by the wall clock, with the kinematic plant: leave out --compute, and any other --plant"
        )
    if log and not realtime:
        raise click.UsageError("--log is only for --realtime; for other drives, --record writes everything")
    if realtime:
        make = partial(make_realtime, problem, setup, log=log)
    else:
        make = partial(make_simulation, problem, setup, realtime=view)
    outputs = Outputs(json_file, record_file, html_file, png_file, film_file, log)
    return drive_and_report(problem, make, outputs, time_limit=time_limit, view=view, no_browser=no_browser)


class Outputs(NamedTuple):
    """Files that a drive writes; None for those that it does not write."""

    json_file: str | None = None
    record_file: str | None = None
    html_file: str | None = None
    png_file: str | None = None
    film_file: str | None = None
    log: str | None = None


def drive_and_report(
    problem: Scenario,
    make: Callable[..., Simulation[Controller]],
    outputs: Outputs,
    *,
    time_limit: float | None,
    view: bool = False,
    no_browser: bool = False,
) -> int:
    """Make a simulation, run and watch it, write and print its result, and replay it; returns the exit code."""
    viewer = options.open_viewer(no_browser=no_browser, title=problem.name) if view else None
    with viewer or nullcontext():
        driven, result, interrupted = watched_drive(problem, make, time_limit=time_limit, viewer=viewer)
        code = _report(problem, driven, result, outputs, interrupted=interrupted, time_limit=time_limit)
        if viewer is not None and viewer.alive and not interrupted:
            viewer.replay(driven.robot, result.record)
            output.say(f"replay  {viewer.url}  (Ctrl-C ends)")
            viewer.wait()
    return code


def _report(
    problem: Scenario,
    driven: Simulation[Controller],
    result: DriveResult,
    outputs: Outputs,
    *,
    interrupted: bool,
    time_limit: float | None,
) -> int:
    """Write and print the result of a drive; returns the exit code."""
    from elastic_strips.io.record_file import write_record
    from elastic_strips.sim.scenarios import drive_document
    from elastic_strips.sim.scenarios.drive import conclude

    if outputs.record_file is not None:  # before the evaluation, which may take a while: the drive is not to be lost
        write_record(result.record, outputs.record_file)
    outcome = conclude(problem, driven, result)
    late = driven.time >= (driven.params.time_limit if time_limit is None else time_limit)
    _summary(outcome, "interrupted" if interrupted else "the time limit was reached" if late else result.reason)
    log = outputs.log
    unwritten = next((event.reason for event in result.events if log and event.reason.startswith(f"{log}: ")), None)
    if unwritten is not None:  # a log with a hole is not to be taken for whole
        output.say(("note:", output.NOTE), f" {unwritten}", err=True)
    if outputs.json_file is not None:
        output.write_document("result", outputs.json_file, drive_document(outcome))
    if outputs.record_file is not None:
        output.say(f"record  {outputs.record_file}")
    options.write_pictures(
        lambda page: page.replay(driven.robot, result.record),
        outputs.html_file,
        outputs.png_file,
        outputs.film_file,
        title=problem.name,
        moment=float("inf"),
    )
    if interrupted:
        return EXIT_INTERRUPTED
    return options.EXIT_DONE if outcome.reached and not outcome.evaluation.collisions else options.EXIT_NOT_DONE


def watched_drive(
    problem: Scenario,
    make: Callable[..., Simulation[Controller]],
    *,
    time_limit: float | None,
    viewer: Viewer | None,
    stays: bool = False,
) -> tuple[Simulation[Controller], DriveResult, bool]:
    """Make a simulation, run and watch it; it, its result, and whether it was interrupted.

    In the viewer its goal can be dragged. One that ``stays`` ends with the page, not at the goal.
    """
    from elastic_strips.viewer.dragged_goal import DraggedGoal

    dragged: DraggedGoal | None = None
    ways: dict[int, float] = {}
    with options.LateProgress(f"{problem.name}: driving") as bar:

        def watch(driven: Simulation[Controller]) -> None:
            _show_way(bar, driven, time_limit, ways)
            if viewer is None or dragged is None:
                return
            dragged.tell()
            space, goal = driven.robot.space, dragged.shown
            result = driven.controller.result  # None where it stands, or goes on with the motion that it has
            viewer.update(
                driven.controller.executor.active.tail(driven.time).strip() if result is None else result.report,
                driven.world.at(driven.time),
                q=space.from_coordinates(driven.plant.coordinates),
                goal=space.from_coordinates(driven.controller.goal if goal is None else goal),
                motion=result is None,
                notes=_notes(driven.controller, dragged),
                seen=_seen(driven.perception),
            )
            if stays and not viewer.alive:
                driven.stop()

        driven = make(watch=watch)
        driven.stays = stays
        if viewer is not None:
            viewer.show(driven.robot, problem.world.at(0.0), driven.controller.strip)
            dragged = DraggedGoal(viewer, driven.controller)
            output.say(f"viewer  {viewer.url}  (drag the goal's ring, or its hand{'; Ctrl-C ends' if stays else ''})")
        try:
            with _stopping(driven) as interrupted:
                result = driven.run(time_limit=time_limit)
        finally:
            driven.plant.close()
            if viewer is not None:
                viewer.listen(None)
    return driven, result, bool(interrupted)


def _show_way(
    bar: options.LateProgress, driven: Simulation[Controller], time_limit: float | None, ways: dict[int, float]
) -> None:
    """Show how far it is to the goal; ``ways`` remembers how far it was to each of them at first."""
    from elastic_strips.control import RunState

    controller = driven.controller
    if controller.state is RunState.REACHED:  # there is no way left
        return
    left, reached = _left(controller), controller.reached
    way = ways.setdefault(reached, left)
    goal = f", goal {reached + 1} of {reached + 1 + len(controller.goals)}" if reached or controller.goals else ""
    limit = driven.params.time_limit if time_limit is None else time_limit
    note = f"{driven.time:.1f} s of at most {limit:g} s{goal}, {controller.state.label}"
    bar.come(left, way, "m" if driven.robot.space.planar else "rad", note)


def _left(controller: Controller) -> float:
    """How far the strip goes on from where the robot is: of the base [m], or of the joints [rad] of a fixed one.

    The strip may begin behind the robot: what is left of the last motion is driven without another plan.
    """
    import numpy as np

    strip = controller.strip
    counted = slice(2 if strip.robot.space.planar else None)
    steps = np.linalg.norm(strip.velocities[:, counted], axis=1)
    nearest = np.linalg.norm((strip.coordinates - controller.estimate)[:, counted], axis=1).argmin()
    return float(steps[nearest:].sum())


def _seen(perception: object) -> Seen | None:
    """What the sensors see, where the robot drives by them."""
    from elastic_strips.viewer import Seen

    newest = getattr(perception, "newest", None)  # of what faults are wrapped about, too
    if newest is None:
        return None
    target, sensed = getattr(perception, "target", None), getattr(perception, "sensed", None)
    return Seen(readings=tuple(newest.values()), scene=sensed, target=target)


def _notes(controller: Controller, dragged: DraggedGoal) -> list[tuple[str, str]]:
    """What the card says of the drive."""
    from elastic_strips.control import RunState

    told = [("robot", controller.state.label)]
    if dragged.refused or controller.state in (RunState.BRAKING, RunState.STOPPED):
        told.append(("why", dragged.refused or controller.reason))
    return told


@contextmanager
def _stopping(driven: Simulation[Controller]) -> Iterator[list[int]]:
    """The first Ctrl-C brings the robot to rest; a second one ends the program."""
    interrupted: list[int] = []

    def stop(number: int, _frame: object) -> None:
        if interrupted:
            raise KeyboardInterrupt
        interrupted.append(number)
        output.say(("stopping the robot (Ctrl-C again ends at once)", output.NOTE), err=True)
        driven.stop()

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield interrupted
    finally:
        signal.signal(signal.SIGINT, before)


def _summary(outcome: DriveOutcome, reason: str) -> None:
    import numpy as np

    from elastic_strips.control import RunState

    result, evaluation = outcome.result, outcome.evaluation
    if outcome.reached:
        end, why = "reached", ""
    elif result.state is RunState.REACHED:
        end, why = "not reached", ": the robot believes that it is at the goal, but it is not"
    else:
        end, why = "not reached", f": {result.state.label}, {reason}"
        if result.state is RunState.STOPPED and result.reason != reason:
            why += f"; it stands: {result.reason}"
    output.say(
        f"{outcome.scenario.name} · {outcome.robot.name} · {outcome.plant} plant: ",
        output.verdict(end, outcome.reached),
        why,
    )
    if len(result.goals) > 1:
        passed = sum(goal.passed for goal in result.goals)
        output.say(f"  {len(result.goals)} goals, {passed} of them passed without a stop")
    ticks = result.statistics.percentiles()
    clearance = "none" if evaluation.closest is None else f"{evaluation.min_clearance_m:.3f} m"
    output.say(
        f"  {evaluation.time_s:.1f} s, {evaluation.path_m:.2f} m, {plural(len(evaluation.collisions), 'collision')}, "
        f"least clearance {clearance}, {plural(len(result.stops), 'stop')}, replanned {plural(result.replans, 'time')}"
    )
    if outcome.reached and result.goals:
        goal, off = result.goals[-1], []
        if outcome.robot.space.planar:
            off = [f"its base {1e3 * goal.position:.1f} mm and {goal.yaw:.4f} rad"]
        if outcome.robot.joint_names:
            off.append(f"its {goal.frame or 'last control point'} {1e3 * goal.hand:.1f} mm")
        output.say(f"  off the goal, by its own estimate: {', '.join(off)}")
    clocks = _COMPUTING.get(str(result.compute), _COMPUTING_FACTOR).format(
        late=f"{result.statistics.misses} of {len(result.statistics.seconds)}", factor=result.compute
    )
    output.say(f"  planning ticks: p50 {ticks['p50']:.1f}, p95 {ticks['p95']:.1f}, p99 {ticks['p99']:.1f} {clocks}")
    if outcome.constraint_error is not None:
        output.say(f"  tilted from level by at most {np.degrees(outcome.constraint_error):.1f}°")
    if outcome.sensors:
        output.say(f"  driven by {', '.join(outcome.sensors)}")
    for name in outcome.unseen:
        output.say(f"  {name} was in no laser's or camera's view in the second before it was touched")
    _say_contacts(outcome)
    for event in result.events:
        if event.kind == "replanned" and event.reason.startswith("switched"):
            output.say(f"  at {event.time:.2f} s {event.reason}")
    if not outcome.reached and (note := laser_note(why)):
        output.say(("  note:", output.NOTE), f" {note}")
    for stop in said_of_stops(result.stops):
        output.say("  ", ("stopped", output.NOTE), stop)
    why_stopped = " ".join(said for _, said in result.stops)
    for fault in said_of_stops([(e.time, e.reason) for e in result.events if _is_told_as_fault(e, why_stopped)]):
        output.say("  ", ("fault", output.NOTE), fault)


def _is_told_as_fault(event: Event, why_stopped: str) -> bool:
    """Whether an event is a fault that is not told otherwise: late ticks are counted, and stops say why."""
    return event.kind == "fault" and not event.reason.startswith("late tick") and event.reason not in why_stopped


def said_of_stops(stops: Sequence[tuple[float, str]]) -> list[str]:
    """When [s] and why a robot stopped, in words: stops that differ in their numbers alone are said once."""
    alike: dict[str, list[tuple[float, str]]] = {}
    for stop in stops:
        alike.setdefault(without_numbers(stop[1]), []).append(stop)
    said = []
    for (time, reason), *others in alike.values():
        again = f", and {plural(len(others), 'time')} more until {others[-1][0]:.2f} s" if others else ""
        said.append(f" at {time:.2f} s{again}: {reason}")
    left = sum(map(len, list(alike.values())[_STOPS_TOLD:]))
    return [*said[:_STOPS_TOLD], *([f" {plural(left, 'more time')} for other reasons"] if left else [])]


def laser_note(reason: str) -> str:
    """What a reason leaves unsaid that names what a laser has met; empty where it names none."""
    if (met := _LASER_MAP.search(reason)) is None:
        return ""
    return (
        f"{met[0]} is what a laser has met. A planar laser does not tell how high that is, so it is taken to be tall; "
        "a depth camera sees over it"
    )


def _say_contacts(outcome: DriveOutcome) -> None:
    """Say what touched the robot, at rest and while it drove."""
    from elastic_strips.robot.geometry import link_labels

    evaluation, pieces = outcome.evaluation, outcome.robot.geometries
    called = dict(zip((piece.name for piece in pieces), link_labels(pieces), strict=True))
    for contact in evaluation.rest_contacts:
        link = called.get(contact.link, contact.link)
        output.say(f"  {contact.obstacle} ran into {link} while the robot was at rest, from {contact.time:.1f} s on")
    for contact in evaluation.collisions:
        link = called.get(contact.link, contact.link)
        output.say((f"  COLLISION of {link} with {contact.obstacle} at {contact.speed:.2f} m/s", output.BAD))
