"""`mqslam paper`: reproduces the paper's table and figures."""

from __future__ import annotations

import json
from pathlib import Path

import typer

from mqslam.cli.options import Options, command, option
from mqslam.cli.terminal import Terminal, echo

paper = typer.Typer(help="Reproduce the paper's table and figures.", no_args_is_help=True)
_TABLE: Options = {
    "seeds": option(int, 3, "Number of seeds; each makes another yard and other noise.", min=1),
    "revolutions": option(int, 4, "Length of a window, in scans.", min=2),
}
_FIGURES: Options = {
    "out": option(Path, ..., "Folder for the figures; it must not exist yet.", "--out", "-o"),
    "seed": option(int, 1, "Seed of the yard and the noise.", min=0),
}


@paper.command()
@command("seeds revolutions jobs as_json quiet verbose", _TABLE)
def table1(terminal: Terminal, *, seeds: int, revolutions: int) -> None:
    """Reproduce table I: three constant motions, found by exhaustive search of the published score and by our estimator.

    The paper's sensor (2 turns/s, steps of 0.5 degrees, bins of 0.25 m, range of 400 m) is simulated in a yard between
    buildings. The search tries v from -0.5 to 1.5 m/s in steps of 0.1 and omega from -0.6 to 0.6 rad/s in steps of 0.02, and
    then goes on around the best pair in steps of 0.01 and 0.002. "As printed" is equations (4), (8), (9) and (10) with the
    Gaussian in time; "charged" has our defaults, which are a plateau in time and a charge for unmatched points. Of the
    paper's own results only the largest errors of its table, 0.1 m/s and 0.0227 rad/s, are known and shown.

    Example: mqslam paper table1 --seeds 1
    """
    from mqslam.psi.published.paper import compute_table1, format_table

    with terminal.show_progress() as show:
        rows = compute_table1(seeds, revolutions, terminal.jobs, progress=show)
    typer.echo(json.dumps([row.tree() for row in rows], indent=1) if terminal.as_json else format_table(rows))


@paper.command()
@command("out seed force as_json quiet verbose", _FIGURES)
def figures(terminal: Terminal, *, out: Path, seed: int, force: bool) -> None:
    """Reproduce figures 2 and 3: a window under a bad, a better and a good motion, and the three cases before and after.

    Example: mqslam paper figures --out figures
    """
    from mqslam.execution.folders import claim_folder
    from mqslam.psi.published.paper import write_figures

    with claim_folder(out, force=force):
        captions = list(write_figures(out, seed))
    terminal.print_results(
        [{"path": str(path), "text": text} for path, text in captions],
        lambda: echo("\n".join(f"{path}: {text}" for path, text in captions)),
    )
