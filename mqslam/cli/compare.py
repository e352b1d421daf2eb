"""`mqslam compare`: runs several front ends on one recording and judges their maps side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mqslam.cli.terminal.echo import echo
from mqslam.cli.terminal.options import (
    CORES,
    Cluster,
    ConfigOption,
    Data,
    End,
    Force,
    Format,
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
from mqslam.cli.terminal.remedies import name_options
from mqslam.cli.terminal.topics import state_topics
from mqslam.errors.shown import show

_ASCII_ARROWS = str.maketrans({"↓": "v", "↑": "^", "→": "->"})  # for terminals that know no other letters


def compare(
    data: Data,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results; it must not exist yet.")],
    frontends: Annotated[
        str,
        typer.Option(
            help="Front ends, separated by commas, those of other packages too; `psi+gyro` has the gyroscope in its graph."
        ),
    ] = "psi,kiss_icp,open3d_icp,odometry",
    trajectory: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=FILE",
            help="A trajectory to compare with, which may be given several times: TUM, CSV, a bag, or KITTI as POSES,TIMES.",
        ),
    ] = None,
    odometry_only: Annotated[
        bool, typer.Option("--odometry-only", help="Only chain the front ends' motions, without pose graph and loops.")
    ] = False,
    kiss_config: Annotated[
        Path | None, typer.Option("--kiss-config", help="YAML file with KISS-ICP's own settings.")
    ] = None,
    config: ConfigOption = None,
    odometry: Odometry = "auto",
    imu: Imu = "auto",
    format: Format = None,
    range_resolution: RangeResolution = None,
    topic: Topic = None,
    start: Start = None,
    end: End = None,
    jobs: Jobs = CORES,
    cluster: Cluster = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the unfinished comparison at --out, if there is one.")
    ] = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Run several front ends on the same returns with the same back end, and judge the maps they make.

    Odometry is used by the row of that name only. The last line names the best row: the one with the least drift or ATE,
    or without ground truth the one with the fewest torn windows and revisits. A window is torn if its inflation is too
    large (its median is 2.37 for a right trajectory).

    Example: mqslam compare drive --out compared --frontends psi,kiss_icp
    """
    from rich.console import Console

    from mqslam.cli.terminal.console import set_up_work
    from mqslam.commands.compare import compare as do
    from mqslam.config import load_config
    from mqslam.execution.files import to_json

    console = Console(stderr=True, markup=False)
    given, settings = _parse_trajectories(trajectory or []), state_topics(load_config(config), topic)
    with set_up_work(console, cluster, jobs, quiet=quiet, silent=quiet or as_json) as work:
        result = do(
            data,
            out,
            frontends=frontends,
            trajectories=given,
            odometry_only=odometry_only,
            kiss_config=kiss_config,
            odometry=odometry,
            imu=imu,
            config=settings,
            format=format,
            range_resolution=range_resolution,
            start_s=start,
            end_s=end,
            resume=resume,
            force=force,
            work=work,
        )
    if as_json:
        typer.echo(to_json(result.summary))
    elif not quiet:
        _print_table(result.table, result.marked)
        for row in result.summary["rows"]:
            if row.get("verdict") in ("warn", "fail"):
                echo(f"{row['name']} is judged {row['verdict']}: {name_options(row['reasons'])}")
        echo(f"results in {out}; open {result.report} in a browser")
        if result.conclusion:
            echo(result.conclusion)


def _parse_trajectories(texts: list[str]) -> dict[str, Path | tuple[Path, Path]]:
    """Returns the files of trajectories given as NAME=FILE or NAME=POSES,TIMES, by name.

    Raises:
        ConfigError: a text has another form, or a name occurs twice.
    """
    from mqslam.errors import ConfigError

    files: dict[str, Path | tuple[Path, Path]] = {}
    for text in texts:
        name, _, file = text.partition("=")
        if not name or not file:
            raise ConfigError(f"--trajectory {text}: give NAME=FILE, NAME in letters and digits")
        if name in files:
            raise ConfigError(f"--trajectory {text}: there is a row {name} already; choose another NAME")
        poses, _, times = file.partition(",")
        files[name] = (Path(poses), Path(times)) if times else Path(poses)
    return files


def _print_table(cells: list[list[str]], marked: frozenset[tuple[int, int]]) -> None:
    """Prints the table turned on its side, since a column per row of the comparison fits any terminal.

    Args:
        cells: the lines of the table, its head first.
        marked: line and column of the best values.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(markup=False, highlight=False)
    failed = [line for line in cells[1:] if line[1].startswith("could not run: ")]
    ran = {k: line for k, line in enumerate(cells[1:], 1) if line not in failed}
    shown = Table(show_edge=False, pad_edge=False)
    shown.add_column("")
    for line in ran.values():
        shown.add_column(show(line[0]), justify="right")
    arrows = _ASCII_ARROWS if console.options.ascii_only else {}
    for column, head in enumerate(cells[0][1:], 1):
        values = (
            Text(f"* {line[column]}", "bold") if (k, column) in marked else Text(line[column]) for k, line in ran.items()
        )
        shown.add_row(head.translate(arrows), *values)
    console.print(shown)
    if marked:
        echo("* is the best value; ↓ less is better, ↑ more, → 1 nearer to 1".translate(arrows))
    for line in failed:
        echo(name_options(f"{line[0]} {line[1]}"))
