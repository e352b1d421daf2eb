"""`mqslam batch`: many recordings, one report over all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mqslam.cli.options import CORES, Cluster, Force, Jobs, Json, Quiet, Verbose
from mqslam.cli.remedies import name_options

if TYPE_CHECKING:
    from rich.table import Table


def batch(
    runs: Annotated[Path, typer.Argument(metavar="RUNS.yaml", help="The recordings, as the README shows them.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the results, one in it per run.")],
    jobs: Jobs = CORES,
    cluster: Cluster = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Run many recordings and report over all of them.

    Without a cluster they run one after the other, on a cluster as many at a time as it has workers. One that fails is said
    and the others go on. Called again, what is finished is kept and what is not goes on where it stopped.

    Exit code: 0 where every run is finished, 1 where one failed.

    Example: mqslam batch runs.yaml --out results
    """
    from rich.console import Console

    from mqslam.cli.progress import work_of
    from mqslam.commands.batch import run_batch
    from mqslam.execution.files import json_text

    console = Console(stderr=True, markup=False)
    with work_of(console, cluster, jobs, quiet=quiet, silent=quiet or as_json) as work:
        result = run_batch(runs, out, force=force, work=work)
    summary = result.summary
    if as_json:
        typer.echo(json_text(summary))
    elif not quiet:
        Console(soft_wrap=True).print(_table(summary))
        typer.echo(f"report: {result.report}")
        for warning in summary["warnings"]:
            console.print(f"warning: {warning}", style="yellow", highlight=False, soft_wrap=True)
    for run in summary["runs"]:
        if run["failure"] and not as_json:
            console.print(f"{run['name']} failed: {name_options(run['failure'])}", highlight=False, soft_wrap=True)
    if summary["counts"]["failed"]:
        raise typer.Exit(1)


def _table(summary: dict[str, Any]) -> Table:
    """A row per run."""
    from rich.table import Table

    table = Table(show_edge=False, pad_edge=False)
    for head in ("", "verdict", "revolutions", "path [m]", "psi per point", "loops", "ATE [m]"):
        table.add_column(head.replace("[", r"\["), justify="left" if head in ("", "verdict") else "right")
    forms = {"revolutions": "{}", "length_m": "{:.1f}", "psi_per_point": "{:.4f}", "loops": "{}", "ate_rmse_m": "{:.4g}"}
    for run in summary["runs"]:
        cells = ("" if run[key] is None else form.format(run[key]) for key, form in forms.items())
        table.add_row(run["name"], run["verdict"] or "failed", *cells)
    return table
