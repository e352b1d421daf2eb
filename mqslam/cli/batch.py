"""`mqslam batch`: many recordings, one report over all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mqslam.cli.options import CORES, Cluster, Force, Jobs, Json, Quiet, Verbose

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

    from mqslam.cli.progress import progress
    from mqslam.commands.batch_plan import read_plan
    from mqslam.commands.batch_schedule import AGAIN, run_all
    from mqslam.errors import ClusterError
    from mqslam.execution.files import json_text
    from mqslam.execution.workers import chosen
    from mqslam.report.batch_page import write_batch_pages
    from mqslam.results.batch_results import check_batch, summarise, write_batch
    from mqslam.results.files import add_warnings

    orders, plan = read_plan(runs)
    check_batch(out, force=force)
    console = Console(stderr=True, markup=False)
    try:
        with chosen(cluster, jobs) as engine, progress(console, quiet or as_json) as show:
            outcomes = run_all(orders, out.absolute(), engine, show, force=force)
    except ClusterError as error:
        raise ClusterError(f"{error}; {AGAIN}") from error
    except BaseException as error:
        error.add_note(AGAIN)
        raise
    summary = summarise(orders, outcomes)
    write_batch(out, summary)
    add_warnings(out / "batch.json", summary, write_batch_pages(out, runs.stem, summary, plan))
    if as_json:
        typer.echo(json_text(summary))
    elif not quiet:
        Console(soft_wrap=True).print(_table(summary))
        typer.echo(f"report: {out / 'report.html'}")
        for warning in summary["warnings"]:
            console.print(f"warning: {warning}", style="yellow", highlight=False, soft_wrap=True)
    for run in summary["runs"]:
        if run["failure"] and not as_json:
            console.print(f"{run['name']} failed: {run['failure']}", highlight=False, soft_wrap=True)
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
