"""`mqslam paper`: reproduces the table and the figures of the paper that psi is from (Chandran and Newman, IROS 2006)."""

from __future__ import annotations

from inspect import Parameter
from pathlib import Path
from typing import Literal

import typer

from mqslam.cli.options import Command, Group, Options, command, option
from mqslam.cli.terminal import Terminal, echo, format_rows

paper = typer.Typer(cls=Group)
_TABLE: Options = {
    "context": (typer.Context, Parameter.empty),
    "seeds": option(int, 3, "Number of seeds; each makes another yard and other noise.", min=1),
    "revolutions": option(int, 4, "Length of a window, in scans.", min=2),
}
_FIGURES: Options = {
    "out": option(Path, ..., "Folder for the figures; it must not exist yet.", "--out", "-o"),
    "seed": option(int, 1, "Seed of the yard and the noise.", min=0),
    "suffix": option(Literal[".pdf", ".png", ".svg"], ".png", "File format of the pictures."),
}


@paper.callback(invoke_without_command=True)
@command("context seeds revolutions jobs as_json quiet verbose", _TABLE)
def table(terminal: Terminal, *, context: typer.Context, seeds: int, revolutions: int) -> None:
    """Reproduce table I and the scores of figure 2 of the paper; `mqslam paper figures` draws figures 2 and 3.

    The paper is "Motion Estimation from Map Quality with Millimeter Wave Radar" (Chandran and Newman, IROS 2006). The table
    lists three constant motions, each with the paper's own result, with the results of an exhaustive search (the paper's
    method) under the published score, and with the result of our estimator. The paper's sensor (2 turns/s, steps of 0.5
    degrees, bins of 0.25 m, range of 400 m) is simulated in a yard between buildings. The search tries v from -0.5 to
    1.5 m/s in steps of 0.1 and omega from -0.6 to 0.6 rad/s in steps of 0.02. Then it tries all pairs within 0.1 m/s and
    0.02 rad/s of the best pair, even outside these ranges, in steps of 0.01 m/s and 0.002 rad/s. "As printed" is
    the score of equations (4), (8), (9) and (10) with the Gaussian in time; "charged" has our defaults, which are a
    plateau in time and a charge for unmatched points; "Algorithm 1" is the paper's listing, whose cost differs from
    equation (10).

    Example: mqslam paper --seeds 1
    """
    if context.invoked_subcommand is not None:
        return
    from mqslam.psi.published import paper as published

    with terminal.show_progress() as show:
        rows = published.compute_table1(seeds, revolutions, terminal.jobs, progress=show)
    scores, notes = published.compute_figure2(), [published.describe_algorithm1(rows), *published.NOTES]
    tree = {"table1": [row.tree() for row in rows], "figure2": scores, "notes": notes}

    def show_tables() -> None:
        lines = format_rows([("", note) for note in notes], 0)
        echo("\n\n".join([published.format_table(rows), published.format_figure2(scores), lines]))

    terminal.print_results(tree, show_tables)


@paper.command(cls=Command)
@command("out seed suffix force as_json quiet verbose", _FIGURES)
def figures(terminal: Terminal, *, out: Path, seed: int, suffix: str, force: bool) -> None:
    """Draw the paper's figures 2 and 3 from simulated drives.

    All maps are scored with the charge for unmatched points, which the table calls "published, charged". Figure 2 shows the
    map of a window under a bad, a better and a good motion. Figure 3 shows the maps of the three motions of table I before
    and after motion compensation.

    Example: mqslam paper figures --out figures
    """
    from mqslam.execution.folders import claim_folder
    from mqslam.psi.published.paper import write_figures

    with claim_folder(out, force=force):
        captions = list(write_figures(out, seed, suffix))
    terminal.print_results(
        [{"path": str(path), "text": text} for path, text in captions],
        lambda: echo("\n".join(f"{path}: {text}" for path, text in captions)),
    )
