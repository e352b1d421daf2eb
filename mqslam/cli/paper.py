"""`mqslam paper`: the paper's table and figures, made again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from mqslam.cli.options import CORES, Force, Jobs, Json, Quiet, Verbose

paper = typer.Typer(help="The paper's table and figures, made again.", no_args_is_help=True)


@paper.command()
def table1(
    seeds: Annotated[int, typer.Option(min=1, help="Yards and noise to try.")] = 3,
    revolutions: Annotated[int, typer.Option(min=2, help="Length of a window.")] = 4,
    jobs: Jobs = CORES,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Table I: three constant motions found by the published score with exhaustive search, and by our estimator.

    Simulates the paper's sensor (2 turns/s, 0.5 degree steps, 0.25 m bins, 400 m) in a yard between buildings. The
    search looks at v from -0.5 to 1.5 m/s by 0.1 and omega from -0.6 to 0.6 rad/s by 0.02, then around the best by 0.01
    and 0.002. "As printed" is equations (4), (8), (9) and (10) with the Gaussian in time; "charged" has our defaults, a
    plateau in time and a charge for unmatched points. Of the paper's own results only the largest errors of its table,
    0.1 m/s and 0.0227 rad/s, are at hand and shown; what it obtained in each case is not.

    Example: mqslam paper table1 --seeds 1
    """
    from rich.console import Console

    from mqslam.cli.progress import progress
    from mqslam.psi.published.table1 import compute_table1, format_table

    with progress(Console(stderr=True, markup=False), quiet or as_json) as show:
        rows = compute_table1(seeds, revolutions, jobs, progress=show)
    typer.echo(json.dumps([row.tree() for row in rows], indent=1) if as_json else format_table(rows))


@paper.command()
def figures(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the figures; must not exist yet.")],
    seed: Annotated[int, typer.Option(min=0, help="Yard and noise.")] = 1,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Figures 2 and 3: a window under a bad, a better and a good motion; the three cases before and after.

    Example: mqslam paper figures --out figures
    """
    from mqslam.execution.folders import check_free
    from mqslam.psi.published.paper_figures import write_figures

    check_free(out, force=force)
    found = write_figures(out, seed)
    if as_json:
        typer.echo(json.dumps([{"path": str(path), "text": text} for path, text in found], indent=1))
    elif not quiet:
        typer.echo("\n".join(f"{path}: {text}" for path, text in found))
