"""The command group, which loads a command when it is called; how errors end one; and ``list``."""

from __future__ import annotations

import logging
import sys
from importlib import import_module

import click

from elastic_strips._version import __version__
from elastic_strips.errors import ElasticStripsError

from . import interruptible_imports

EXIT_INPUT = 2

_HELP = """Certified collision-free whole-body motion of mobile manipulators, by elastic strips.

Start with:

\b
  elastic-strips list                     what there is to run
  elastic-strips run case-7 --view        run it and watch it in the browser
  elastic-strips run case-7 --json r.json write the strip and its certificate
  elastic-strips drive moving-corridor    drive among moving obstacles
  elastic-strips drive case-1 --record run.npz
  elastic-strips view run.npz             replay what was recorded
  elastic-strips certify path.csv --robot panda --scene scene.yaml

Exit codes: 0 certified or reached, 2 wrong input, 3 blocked, broken, refuted or not reached, 130 interrupted.
"""


_COMMANDS = {
    "bench": ("bench_command", "bench", "Measure planning, replanning, the tick and the closed loop."),
    "certify": ("certify_command", "certify", "Prove that anybody's path is free of collisions, or show where not."),
    "drive": ("drive_command", "drive", "Drive a scenario: the closed loop in simulated time."),
    "list": ("group", "list_command", "Show the scenarios, robots and presets that have names."),
    "run": ("run_command", "run", "Run a scenario: plan, deform, certify."),
    "study": ("bench_command", "study", "Run the paper's simulations again, and write the report."),
    "sweep": ("sweep_command", "sweep", "Run scenarios × parameters × seeds into a table; resumable."),
    "view": ("view_command", "view", "Look at a scenario, a result (run --json) or a record (drive --record)."),
}
"""Command → module, name in it, one line about it."""
_REPORTED_BY_COMMANDS = ("elastic_strips.planning.homotopy.alternatives", "elastic_strips.planning.search")
"""Loggers whose warnings are the reasons of reports, which the commands show."""


class LateGroup(click.Group):
    """A group whose commands are imported when they are called: its help need not wait for them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        module, name, _ = _COMMANDS[cmd_name]
        with interruptible_imports():
            return getattr(import_module(f".{module}", __package__), name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, _COMMANDS[name][2]) for name in self.list_commands(ctx)])


@click.group(
    cls=LateGroup, help=_HELP, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110}
)
@click.version_option(__version__, prog_name="elastic-strips")
@click.option("-v", "--verbose", is_flag=True, help="Log what the library does to standard error.")
def cli(verbose: bool) -> None:
    if verbose:
        logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s")
        return
    handler = logging.StreamHandler()
    handler.addFilter(lambda record: record.name not in _REPORTED_BY_COMMANDS)
    logging.basicConfig(level=logging.WARNING, format="warning: %(message)s", handlers=[handler])


def run_cli(arguments: list[str] | None) -> None:
    """Run the command line; ends the process with the exit codes of the help text."""
    try:
        code = cli.main(args=arguments, prog_name="elastic-strips", standalone_mode=False)
        sys.exit(code if isinstance(code, int) else 0)
    except click.exceptions.Abort:  # click's word for Ctrl-C
        raise KeyboardInterrupt from None
    except click.ClickException as error:
        error.show()
        sys.exit(EXIT_INPUT)
    except ElasticStripsError as error:
        click.echo(f"error: {error}", err=True)
        sys.exit(EXIT_INPUT)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(1)


@click.command(name="list", help="Show the scenarios, robots and presets that have names.")
@click.option("--robots", is_flag=True, help="Only the robots, and all of them: those of example-robot-data too.")
def list_command(robots: bool) -> None:
    from elastic_strips.catalogue import PRESETS, SCENARIOS, find_robot, own_robots, robot_names

    if robots:
        for name in robot_names():
            click.echo(f"{name:<28} {find_robot(name).summary}")
        return
    click.echo("Scenarios (elastic-strips run NAME):")
    for name, summary in SCENARIOS.items():
        click.echo(f"  {name:<18} {summary}")
    click.echo("\nRobots (--robot NAME, or the path of a URDF):")
    for name in own_robots():
        click.echo(f"  {name:<18} {find_robot(name).summary}")
    click.echo(f"  and {len(robot_names()) - len(own_robots())} more: elastic-strips list --robots")
    click.echo("\nPresets (--preset NAME):")
    for name, summary in PRESETS.items():
        click.echo(f"  {name:<18} {summary}")
