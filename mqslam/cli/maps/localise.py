"""`mqslam localise`: finds the poses of a recording in the map of an earlier run."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mqslam.cli.terminal.echo import echo
from mqslam.cli.terminal.options import (
    CORES,
    Cluster,
    Data,
    End,
    Extrinsics,
    Force,
    Format,
    Frontend,
    Imu,
    Jobs,
    Json,
    Odometry,
    Quiet,
    RangeResolution,
    Start,
    Topic,
    Verbose,
)
from mqslam.cli.terminal.topics import state_topics

if TYPE_CHECKING:
    from rich.table import Table


def localise(
    data: Data,
    map: Annotated[
        Path,
        typer.Option(
            "--map",
            "-m",
            metavar="RESULT",
            help="Result of an earlier run of the same streets, which keeps its map in keyframes/.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results; it must not exist yet.")],
    frontend: Frontend = "psi",
    config: Annotated[
        str | None,
        typer.Option(
            "--config", "-c", help="Settings: a YAML file or a shipped name; by default those that the map was made with."
        ),
    ] = None,
    odometry: Odometry = "auto",
    imu: Imu = "auto",
    extrinsics: Extrinsics = "auto",
    format: Format = None,
    range_resolution: RangeResolution = None,
    topic: Topic = None,
    start: Start = None,
    end: End = None,
    jobs: Jobs = CORES,
    cluster: Cluster = None,
    strict: Annotated[
        bool,
        typer.Option(
            "--strict", help="Stop at the first scan that cannot be read, instead of leaving it out with a warning."
        ),
    ] = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Find the poses of a recording in the map of an earlier run, without a guess of where it begins.

    Places of the map are recognised in the recording, and every scan is followed from there: psi lays it on the map around
    it. Each pose has a covariance against the map around it, and a status: converged, degenerate, lost or outside.

    Example: mqslam localise second_drive --map result --out localised
    """
    from rich.console import Console

    from mqslam.cli.terminal.console import print_warnings, set_up_work
    from mqslam.commands.maps.localise import localise as do
    from mqslam.commands.maps.localise import read_map_settings
    from mqslam.config import load_config
    from mqslam.execution.files import to_json

    settings = state_topics(read_map_settings(map) if config is None else load_config(config), topic)
    console = Console(stderr=True, markup=False)
    with set_up_work(console, cluster, jobs, quiet=quiet, silent=quiet or as_json) as work:
        result = do(
            data,
            out,
            map=map,
            frontend=frontend,
            odometry=odometry,
            imu=imu,
            extrinsics=extrinsics,
            config=settings,
            format=format,
            range_resolution=range_resolution,
            start_s=start,
            end_s=end,
            strict=strict,
            force=force,
            work=work,
        )
    if as_json:
        typer.echo(to_json(result.summary))
    elif not quiet:
        print_warnings(console, result.warnings)
        Console(soft_wrap=True).print(_tabulate(result.summary))
        echo(f"report: {result.report}")
        if result.evo_command:
            echo(f"compare with evo: {result.evo_command}")


def _tabulate(summary: dict[str, Any]) -> Table:
    """Returns the table that a person reads first: how many scans lie on the map, and how sure their poses are."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=None, show_edge=False, pad_edge=False, show_header=False)
    table.add_column("")
    table.add_column("", justify="right")
    for status, number in summary["scans"].items():
        table.add_row(f"scans {status}", str(number))
    sigma = summary["median_sigma"]
    table.add_row(
        "usual sigma against the map around, along and across", f"{sigma['along_m']:.3f} m, {sigma['across_m']:.3f} m"
    )
    table.add_row("usual sigma of the heading", f"{math.degrees(sigma['yaw_rad']):.3f} deg")
    table.add_row("matched points", f"{summary['matched']:.1%}")
    if summary["evaluation"]:
        table.add_row("ATE after alignment, all scans", f"{summary['evaluation']['ate_rmse_m']:.3f} m")
    dataset, total = summary["dataset"], summary["runtime_s"]["total"]
    speed = dataset["duration_s"] / max(total, 1e-9)
    table.caption = Text(
        f"{dataset['scans']} scans, {dataset['duration_s']:.1f} s; {total:.1f} s of computing, {speed:.1f} times real time"
    )
    table.caption_justify = "left"
    return table
