"""The command group, which loads a command when it is called; and how errors end one."""

from __future__ import annotations

import errno
import logging
import os
import sys
from importlib import import_module

import click

from elastic_strips._version import __version__
from elastic_strips.errors import ElasticStripsError, nearest_name
from elastic_strips.files import command_files
from elastic_strips.progress import LOGGER

from . import interruptible_imports, output

EXIT_UNREAD, EXIT_INPUT = 1, 2
_CLICKS_WORDS = ("No such ", "Missing ", "Invalid ", "Got ", "Option ", "Argument ")
"""How click begins its messages."""
_FULL = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT, errno.EIO)

_HELP = """Certified collision-free whole-body motion of mobile manipulators, by elastic strips.

Start with:

\b
  elastic-strips list                     what can be run
  elastic-strips run case-7 --view        run it and watch it in the browser
  elastic-strips drag case-7              push its obstacles with the mouse
  elastic-strips run case-7 --json r.json write the strip and its certificate
  elastic-strips drive moving-corridor    drive among moving obstacles
  elastic-strips teleop moving-corridor   drive it yourself, and try to crash it
  elastic-strips drive case-1 --record run.npz
  elastic-strips view run.npz             replay what was recorded
  elastic-strips calibrate run.npz        the machine as measured, and as assumed
  elastic-strips certify path.csv --robot panda --scene scene.yaml
  elastic-strips robot my.urdf            what is known about a robot, and what is not checked
  elastic-strips doctor                   what is installed, and what is broken

--json - writes a command's document to standard output. NO_COLOR=1 turns colours off.

Exit codes: 0 certified or reached, 2 wrong input, 3 blocked, broken, refuted or not reached, 130 interrupted;
doctor: 0 no problem, 3 a problem.
"""


_COMMANDS = {
    "calibrate": (
        "calibrate_command",
        "calibrate",
        "Measure a machine from the record of a drive; say which parameters to set.",
    ),
    "certify": ("certify_command", "certify", "Prove that a path is free of collisions, or show where it is not."),
    "doctor": ("doctor_command", "doctor", "Check this installation: what is there, and what is broken."),
    "drag": ("drag_command", "drag", "Push obstacles and the goal with the mouse; the strip gives way."),
    "drive": ("drive_command", "drive", "Drive a scenario: the closed loop in simulated time."),
    "list": ("list_command", "list_command", "List the scenarios, robots and presets that have names."),
    "robot": ("robot_command", "robot", "Show a robot's card: what is planned, what is assumed, what is not checked."),
    "ros2": ("ros2_command", "ros2", "Drive a robot that speaks ROS 2: topics in, velocities out."),
    "run": ("run_command", "run", "Run a scenario: plan, deform, certify."),
    "sweep": ("sweep_command", "sweep", "Run scenarios × parameters × seeds and write a table; can be resumed."),
    "teleop": ("teleop_command", "teleop", "Drive with keys or a stick in the browser, through the guard."),
    "view": ("view_command", "view", "Show a scenario, a result (run --json) or a record (drive --record)."),
}
"""Command → module, name in it, one line about it."""
_IN_A_CHECKOUT = {"bench": "python -m workshop plan | tick | …", "study": "python -m workshop study"}
"""Commands that a user may look for here, and how they are called."""
_REPORTED_BY_COMMANDS = ("elastic_strips.planning.homotopy.alternatives", "elastic_strips.planning.search")
"""Loggers whose warnings are the reasons of reports, which the commands show."""


class LateGroup(click.Group):
    """A group whose commands are imported when they are called: its help need not wait for them."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(_COMMANDS)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] in _IN_A_CHECKOUT:
            ctx.fail(f"{args[0]} is not part of the package: in a checkout of its sources, {_IN_A_CHECKOUT[args[0]]}")
        if args and args[0] not in _COMMANDS and not args[0].startswith("-") and not ctx.resilient_parsing:
            ctx.fail(f"No such command {args[0]!r}{nearest_name(args[0], _COMMANDS)}")
        return super().resolve_command(ctx, args)

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
@click.pass_context
def cli(context: click.Context, verbose: bool) -> None:
    begin(context, verbose)


def begin(context: click.Context, verbose: bool) -> None:
    """Begin a command: its files are remembered, and warnings go to standard error."""
    context.with_resource(command_files())
    if verbose:
        logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s")
        return
    if sys.stderr.isatty():
        progress = logging.getLogger(LOGGER)
        progress.setLevel(logging.INFO)
        progress.propagate = False
        progress.addHandler(logging.StreamHandler())
    handler = logging.StreamHandler()
    handler.addFilter(lambda record: record.name not in _REPORTED_BY_COMMANDS)
    warning = click.style("warning:", fg="yellow") if output.in_colour(sys.stderr) else "warning:"
    logging.basicConfig(level=logging.WARNING, format=f"{warning} %(message)s", handlers=[handler])


def run_cli(arguments: list[str] | None, command: click.Command = cli, program: str = "elastic-strips") -> None:
    """Run a command line; ends the process with the exit codes of the help text."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by whoever started the process
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    try:
        code = command.main(args=arguments, prog_name=program, standalone_mode=False)
        sys.stdout.flush()
        sys.exit(code if isinstance(code, int) else 0)
    except click.exceptions.Abort:  # click's word for Ctrl-C
        raise KeyboardInterrupt from None
    except click.ClickException as error:
        _show(error)
        sys.exit(EXIT_INPUT)
    except ElasticStripsError as error:
        output.say(("error:", output.BAD), f" {error}", err=True)
        sys.exit(EXIT_INPUT)
    except BrokenPipeError:  # whoever read it has seen enough
        output.leave_stdout()
        sys.exit(EXIT_UNREAD)
    except OSError as error:
        if _working_folder_is_gone():
            output.say(("error:", output.BAD), " the working folder was removed: change to another one", err=True)
            sys.exit(EXIT_INPUT)
        if error.errno not in _FULL or error.filename is not None:
            raise
        output.leave_stdout()
        output.say(("error:", output.BAD), f" standard output: cannot write: {error.strerror}", err=True)
        sys.exit(EXIT_INPUT)


def _working_folder_is_gone() -> bool:
    try:
        os.getcwd()
    except OSError:
        return True
    return False


def _show(error: click.ClickException) -> None:
    """Show an error of click's like all others, and where it is said how the command is called."""
    message = error.format_message()
    if isinstance(error, getattr(click.exceptions, "NoArgsIsHelpError", ())):  # its message is the help; not of 8.1
        output.say(message, err=True)
        return
    if message.startswith(_CLICKS_WORDS):
        message = message[0].lower() + message[1:]
    output.say(("error:", output.BAD), f" {message}", err=True)
    if isinstance(error, click.UsageError) and error.ctx is not None:
        output.say(f"  {error.ctx.command_path} --help says how it is called", err=True)
