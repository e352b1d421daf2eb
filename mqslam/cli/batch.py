"""`mqslam batch`: runs many recordings and reports over all of them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mqslam.cli.terminal.echo import echo
from mqslam.cli.terminal.options import CORES, Cluster, Force, Jobs, Json, Quiet, Verbose
from mqslam.cli.terminal.remedies import name_options
from mqslam.errors.shown import show

if TYPE_CHECKING:
    from rich.table import Table


def batch(
    runs: Annotated[
        Path, typer.Argument(metavar="RUNS.yaml", help="The YAML file that lists the runs; the README shows one.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results; each run gets a folder in it.")],
    jobs: Jobs = CORES,
    cluster: Cluster = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Run many recordings and report over all of them.

    They run one after the other, or on a cluster as many at a time as it has workers. If a run fails, its error is shown and
    the others go on. The same command called again keeps the runs that are finished and continues those that are not.

    Exit code: 0 if every run is finished, 1 if one failed.

    Example: mqslam batch runs.yaml --out results
    """
    from rich.console import Console

    from mqslam.cli.terminal.console import print_warnings, set_up_work
    from mqslam.commands.batch import run_batch
    from mqslam.execution.files import to_json

    console = Console(stderr=True, markup=False)
    with set_up_work(console, cluster, jobs, quiet=quiet, silent=quiet or as_json) as work:
        result = run_batch(runs, out, force=force, work=work)
    summary = result.summary
    if as_json:
        typer.echo(to_json(summary))
    elif not quiet:
        Console(soft_wrap=True).print(_tabulate(summary))
        echo(f"report: {result.report}")
        print_warnings(console, summary["warnings"])
    for run in summary["runs"]:
        if run["failure"] and not as_json:
            console.print(f"{run['name']} failed: {show(name_options(run['failure']))}", highlight=False, soft_wrap=True)
    if summary["counts"]["failed"]:
        raise typer.Exit(1)


def _tabulate(summary: dict[str, Any]) -> Table:
    """Returns a table with a row per run."""
    from rich.table import Table

    table = Table(show_edge=False, pad_edge=False)
    for head in ("", "verdict", "scans", "path [m]", "psi per point", "loops", "ATE [m]"):
        table.add_column(head.replace("[", r"\["), justify="left" if head in ("", "verdict") else "right")
    forms = {"revolutions": "{}", "length_m": "{:.1f}", "psi_per_point": "{:.4f}", "loops": "{}", "ate_rmse_m": "{:.4g}"}
    for run in summary["runs"]:
        cells = ("" if run[key] is None else form.format(run[key]) for key, form in forms.items())
        table.add_row(run["name"], run["verdict"] or "failed", *cells)
    return table
