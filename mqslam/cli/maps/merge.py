"""`mqslam merge`: makes one map of the results of several recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from mqslam.cli.terminal.echo import echo
from mqslam.cli.terminal.options import CORES, Cluster, ConfigOption, Force, Jobs, Json, Quiet, Verbose


def merge(
    results: Annotated[
        list[Path],
        typer.Argument(metavar="OUT1 OUT2 ...", help="Folders of results of `mqslam run` or `mqslam merge`, two or more."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the merged result; it must not exist yet.")],
    config: ConfigOption = None,
    jobs: Jobs = CORES,
    cluster: Cluster = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Make one map of several recordings, and show what changed between them.

    Places that the recordings share are found without a guess of where they are, and psi lays them on each other. Where
    several places fit, nothing is merged. The map is in the frame of the first result, and can be merged again.

    Example: mqslam merge monday friday --out both
    """
    from rich.console import Console

    from mqslam.cli.terminal.console import set_up_work
    from mqslam.commands.maps.merge import merge as do
    from mqslam.execution.files import to_json

    console = Console(stderr=True, markup=False)
    with set_up_work(console, cluster, jobs, quiet=quiet, silent=quiet or as_json) as work:
        result = do(results, out, config=config, force=force, work=work)
    if as_json:
        typer.echo(to_json(result.summary))
    elif not quiet:
        echo("\n".join(_format_lines(result.summary)))
        echo(f"results in {out}; open {result.report} in a browser")


def _format_lines(summary: dict[str, Any]) -> list[str]:
    """Returns the lines that a person reads first."""
    from mqslam.core.wording import count_of

    links, psi, changes = summary["links"], summary["psi"], summary["changes"]
    rows = [
        ("merged", summary["conclusion"]),
        ("links", f"{links['count']}, with a median residual of {links['residual_median']:.2f} standard deviations"),
        ("psi across", f"{psi['across_before']:.4f} per point before, {psi['across_after']:.4f} after"),
        ("changes", f"{count_of(len(changes), 'object')} that one recording shows and another contradicts"),
    ]
    return [f"{name:<12}{value}" for name, value in rows]
