"""`mqslam paper`: reproduces the paper's table and figures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from mqslam.cli.terminal.echo import echo
from mqslam.cli.terminal.options import CORES, Force, Jobs, Json, Quiet, Verbose

paper = typer.Typer(help="Reproduce the paper's table and figures.", no_args_is_help=True)


@paper.command()
def table1(
    seeds: Annotated[int, typer.Option(min=1, help="Number of seeds; each makes another yard and other noise.")] = 3,
    revolutions: Annotated[int, typer.Option(min=2, help="Length of a window, in scans.")] = 4,
    jobs: Jobs = CORES,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Reproduce table I: three constant motions, found by exhaustive search of the published score and by our estimator.

    The paper's sensor (2 turns/s, steps of 0.5 degrees, bins of 0.25 m, range of 400 m) is simulated in a yard between
    buildings. The search tries v from -0.5 to 1.5 m/s by 0.1 and omega from -0.6 to 0.6 rad/s by 0.02,
    and then around the best by 0.01 and 0.002. "As printed" is equations (4), (8), (9) and (10) with the Gaussian in
    time; "charged" has our defaults, which are a plateau in time and a charge for unmatched points. Of the paper's own
    results only the largest errors of its table, 0.1 m/s and 0.0227 rad/s, are known and shown.

    Example: mqslam paper table1 --seeds 1
    """
    from rich.console import Console

    from mqslam.cli.terminal.console import show_progress
    from mqslam.psi.published.paper import compute_table1, format_table

    with show_progress(Console(stderr=True, markup=False), quiet or as_json) as show:
        rows = compute_table1(seeds, revolutions, jobs, progress=show)
    typer.echo(json.dumps([row.tree() for row in rows], indent=1) if as_json else format_table(rows))


@paper.command()
def figures(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the figures; it must not exist yet.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of the yard and the noise.")] = 1,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Reproduce figures 2 and 3: a window under a bad, a better and a good motion, and the three cases before and after.

    Example: mqslam paper figures --out figures
    """
    from mqslam.execution.folders import claim_folder
    from mqslam.psi.published.paper import write_figures

    with claim_folder(out, force=force):
        captions = write_figures(out, seed)
    if as_json:
        typer.echo(json.dumps([{"path": str(path), "text": text} for path, text in captions], indent=1))
    elif not quiet:
        echo("\n".join(f"{path}: {text}" for path, text in captions))
