"""``elastic-strips teleop``: drive in the browser, with keys or a stick, through the guard."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import click

from elastic_strips.errors import plural

from . import options, output
from .robot_options import load_robot, robot_options

if TYPE_CHECKING:
    from elastic_strips.control import Desired, GuardedCommand
    from elastic_strips.robot import LoadOptions
    from elastic_strips.sim.teleop import Teleop
    from elastic_strips.trajectory import MotionLimits
    from elastic_strips.viewer.drag import Steer

_SHOWN_EVERY = 5  # control periods from one picture to the next


class _Hands:
    """What somebody steers now, and since when by the wall clock [s]."""

    def __init__(self, limits: MotionLimits) -> None:
        top = limits.drive_speed
        if limits.drive_dim == 2:
            turn = 0.5 * 2.0 * float(top.min()) / limits.track
            self._top = [float(top.min()), 0.0, min(turn, 1.5)]
        else:
            self._top = top.tolist()
        self._held: tuple[float, list[float]] | None = None

    def hear(self, steer: Steer) -> None:
        """Take a message of the page."""
        parts = steer.forward, steer.left, steer.turn
        self._held = time.monotonic(), [part * top for part, top in zip(parts, self._top, strict=True)]

    def desired(self, now: float) -> Desired | None:
        """The command at the simulated time ``now`` [s]; None where nothing was ever said."""
        from elastic_strips.control import Desired

        if self._held is None:
            return None
        at, twist = self._held
        return Desired(twist=twist, time=now - (time.monotonic() - at) if any(twist) else None)  # type: ignore[arg-type]


@click.command()
@click.argument("scenario", metavar="[NAME|FILE.yaml]", default="moving-corridor", type=options.SCENARIO)
@options.robot_option(help="A robot other than the scenario's: a name, or your own URDF file.")
@robot_options
@options.base_option()
@options.limit_options
@click.option(
    "--seed", type=options.SEED, help="Seed of the simulated machine, its noise and generated scenes.  [default: 0]"
)
@click.option("--for", "seconds", type=options.Finite(0.1, 1e5), help="End after this time [s].")
@options.browser_option
def teleop(
    scenario: str,
    robot: str | None,
    described: LoadOptions,
    base: str | None,
    limits: options.GivenLimits,
    seed: int | None,
    seconds: float | None,
    no_browser: bool,
) -> int:
    """Drive the robot of a scenario in the browser, in simulated time that runs with the wall clock: by W A S D or the
    arrow keys, by Q and E sideways where the base can move so, or by the stick on the page.

    Without a name, the scenario is moving-corridor. Try to crash it: a command that cannot be certified down to its
    stop is changed, and the card says what is in its way.

    Exit code 0: nothing was touched at speed. 2: wrong input. 3: something was.
    """
    import numpy as np

    from elastic_strips.sim.scenarios import get_scenario
    from elastic_strips.sim.teleop import Teleop

    options.check_outputs(scenario)
    problem = get_scenario(scenario, seed=seed or 0)
    model = load_robot(problem, robot, described, base=base)
    if not model.space.base_nv:
        raise click.UsageError(f"{model.name!r} stands on a fixed base: there is nothing to drive")
    session = Teleop(
        model, problem.world, problem.ends(model)[0], limits=limits.of(model), seed=seed or 0, meter=time.monotonic
    )
    hands = _Hands(session.guard.limits)
    with options.open_viewer(no_browser=no_browser, title=problem.name) as viewer:
        viewer.show(model, session.world.at(0.0), np.stack(problem.ends(model)))  # both are in the picture
        viewer.steered(hands.hear, slides=session.guard.limits.drive_dim == 3)
        output.say(f"viewer  {viewer.url}  (W A S D, arrows or the stick; Ctrl-C ends)")
        shares: list[float] = []
        began, steps, dt = time.monotonic(), 0, session.guard.params.drive.control_dt
        try:
            while viewer.alive and session.time < (seconds or float("inf")):
                desired = hands.desired(session.time)
                answer = session.step(desired)
                if desired is not None and desired.time is not None:
                    shares.append(answer.share)
                if steps % _SHOWN_EVERY == 0:
                    ahead = session.guard.executor.active.tail(session.time).strip()
                    q = model.space.from_coordinates(session.coordinates)
                    viewer.update(ahead, session.world.at(session.time), q=q, motion=True, notes=guard_notes(answer))
                steps += 1
                time.sleep(max(0.0, began + steps * dt - time.monotonic()))
                began = max(began, time.monotonic() - steps * dt - 0.1)  # a slow computer is not caught up with
        except KeyboardInterrupt:
            pass
    return _report(session, shares)


def guard_notes(answer: GuardedCommand) -> list[tuple[str, str]]:
    """What the card says of a guard's answer."""
    rows = [("guard", answer.outcome.value), ("taken", f"{100 * answer.share:.0f} %")]
    rows.append(("stops in", f"{answer.stops_in:.2f} s"))
    if answer.link:
        distance = "" if answer.distance != answer.distance else f", {1e3 * answer.distance:.0f} mm"
        rows.append((answer.link, f"{answer.obstacle}{distance}"))
    return rows


def _report(session: Teleop, shares: list[float]) -> int:
    found = session.evaluate()
    taken = "" if not shares else f", {100 * sum(shares) / len(shares):.0f} % of what was asked for was taken"
    touched = len(found.collisions)
    output.say(
        f"{session.time:.1f} s, {found.path_m:.2f} m{taken}, ",
        output.verdict(f"{plural(touched, 'contact')} at speed", not touched),
        f", run into {plural(len(found.rest_contacts), 'time')} at rest",
    )
    return options.EXIT_NOT_DONE if touched else options.EXIT_DONE
