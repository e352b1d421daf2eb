"""Builds the command `mqslam` from one file per command.

The files import heavy libraries only when their command runs, so that the help appears fast.
"""

from __future__ import annotations

import errno
import sys
from typing import NoReturn

import typer

import mqslam
from mqslam.cli.audit import audit
from mqslam.cli.batch import batch
from mqslam.cli.check import check
from mqslam.cli.compare import compare
from mqslam.cli.config import config
from mqslam.cli.convert import convert
from mqslam.cli.diff import diff
from mqslam.cli.info import info
from mqslam.cli.localise import localise
from mqslam.cli.merge import merge
from mqslam.cli.optimise import optimise
from mqslam.cli.options import Command, Group
from mqslam.cli.paper import paper
from mqslam.cli.plot import plot
from mqslam.cli.remedies import name_options
from mqslam.cli.run import run
from mqslam.cli.score import score
from mqslam.cli.show import show as show_result
from mqslam.cli.simulate import simulate
from mqslam.cli.view import view
from mqslam.errors import Interrupted, MqslamError, show
from mqslam.execution.interrupts import raise_interrupts

app = typer.Typer(
    name="mqslam",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",  # joins the lines of a paragraph
    context_settings={"help_option_names": ["-h", "--help"]},
    cls=Group,
    epilog="Exit codes: 0 done; 1 `check` found something suspicious, a verdict of run, audit or batch is as bad as "
    "--fail-on or worse, an audit is worse than its --baseline, or a run of batch failed; 2 the command or its input holds "
    "a mistake, which one line describes; 3 run, audit or batch was given --fail-on, but a map could not be judged; 129, "
    "130 and 143 interrupted.",
)
_EVERYDAY, _MAPS, _DATA, _RESEARCH = "Everyday", "Maps", "Data and settings", "Research"
for panel, commands in {
    _EVERYDAY: (run, info, show_result, view, plot, audit, compare, batch),
    _MAPS: (localise, merge, diff),
    _DATA: (check, convert, simulate),
    _RESEARCH: (score, optimise),
}.items():
    for command in commands:
        app.command(cls=Command, rich_help_panel=panel)(command)
app.add_typer(config, name="config", rich_help_panel=_DATA)
app.add_typer(paper, name="paper", rich_help_panel=_RESEARCH)


def _print_version(asked: bool) -> None:
    """Prints the version and ends the command, if `--version` was given."""
    if asked:
        typer.echo(f"mqslam {mqslam.__version__}")
        raise typer.Exit


@app.callback()
def _top(
    version: bool = typer.Option(False, "--version", callback=_print_version, is_eager=True, help="Print the version."),
) -> None:
    """Make trajectories and maps from recordings of a radar or a planar lidar, and judge maps without ground truth.

    Example: mqslam run drive --out result
    """


def _end(error: MqslamError, command: str) -> NoReturn:
    """Prints the error of a command in one line on stderr, and ends the process with exit code 2."""
    print(f"mqslam: error: {show(name_options(str(error), command))}", file=sys.stderr)
    sys.exit(2)


def main() -> None:
    """Runs the command line and ends the process with the command's exit code.

    A mistake that the user can mend is shown as one line on stderr and gives exit code 2. If a signal interrupts the
    command, the exit code is 128 plus the number of the signal.
    """
    command = sys.argv[1] if len(sys.argv) > 1 else ""
    try:
        with raise_interrupts():
            app(prog_name="mqslam")
    except MqslamError as error:
        _end(error, command)
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        _end(MqslamError(f"{error.filename}: is a longer path than the system allows", "give a shorter one"), command)
    except Interrupted as error:
        print(f"mqslam: {show(name_options(str(error), command))}", file=sys.stderr)
        sys.exit(128 + error.number)
