"""The command group, and how errors end a command: a message and exit code 2, never a traceback."""

from __future__ import annotations

import logging
import sys

import click

from .._version import __version__
from ..errors import ElasticStripsError
from .bench_command import bench
from .drive_command import drive
from .list_command import list_command
from .run_command import run
from .study_command import study
from .view_command import view

EXIT_INPUT = 2
EXIT_INTERRUPTED = 130

_HELP = """Certified collision-free whole-body motion of mobile manipulators, by elastic strips.

Start with:

\b
  elastic-strips list                     what there is to run
  elastic-strips run case-7 --view        run it and watch it in the browser
  elastic-strips run case-7 --json r.json write the strip and its certificate
  elastic-strips drive moving-corridor    drive among moving obstacles
  elastic-strips drive case-1 --record run.npz
  elastic-strips view run.npz             replay what was recorded

Exit codes: 0 certified or reached, 2 wrong input, 3 blocked, broken or not reached, 130 interrupted.
"""


@click.group(help=_HELP, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="elastic-strips")
@click.option("-v", "--verbose", is_flag=True, help="Log what the library does to standard error.")
def cli(verbose: bool) -> None:
    logging.basicConfig(level=logging.INFO if verbose else logging.ERROR, format="%(name)s: %(message)s")


cli.add_command(run)
cli.add_command(drive)
cli.add_command(view)
cli.add_command(bench)
cli.add_command(study)
cli.add_command(list_command)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; ends the process with the exit codes of the help text."""
    try:
        code = cli.main(args=arguments, prog_name="elastic-strips", standalone_mode=False)
        sys.exit(code if isinstance(code, int) else 0)
    except click.exceptions.Abort:
        click.echo("interrupted", err=True)
        sys.exit(EXIT_INTERRUPTED)
    except click.ClickException as error:
        error.show()
        sys.exit(EXIT_INPUT)
    except KeyboardInterrupt:
        click.echo("interrupted", err=True)
        sys.exit(EXIT_INTERRUPTED)
    except ElasticStripsError as error:
        click.echo(f"error: {error}", err=True)
        sys.exit(EXIT_INPUT)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(1)
