"""`mqslam localise`: finds the poses of a recording in the map of an earlier run."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mqslam.cli.options import Options, command, complete_config, option, state_topics
from mqslam.cli.run import describe_pace
from mqslam.cli.terminal import Terminal, echo

if TYPE_CHECKING:
    from rich.table import Table

    from mqslam.commands.result import LocaliseResult
    from mqslam.config import ConfigSource

_OWN: Options = {
    "map": option(
        Path,
        ...,
        "Folder of an earlier result of the same place; its map is in keyframes/.",
        "--map",
        "-m",
        metavar="RESULT",
    ),
    "config": option(
        str | None,
        None,
        "Settings: a YAML file, or the name of one that ships with mqslam; by default the settings of the map.",
        "--config",
        "-c",
        metavar="FILE|NAME",
        rich_help_panel="Settings",
        autocompletion=complete_config,
    ),
}


@command(
    "data map out frontend config changes odometry imu extrinsics format range_resolution topic start_s end_s jobs cluster "
    "strict force as_json quiet verbose",
    _OWN,
)
def localise(terminal: Terminal, *, map: Path, config: ConfigSource, topic: list[str] | None, **given: Any) -> None:
    """Find the poses of a recording in the map of an earlier run, without knowing where in the map the recording begins.

    Places of the map are recognised in the recording. Starting from these places, psi registers every scan on the part of
    the map around the scan. Each pose has a covariance relative to that part of the map, and a status: converged;
    degenerate, if the map leaves the position uncertain along one direction; lost, if too little of the scan lies on the
    map; or outside, if the map is empty there.

    Example: mqslam localise second_drive --map result --out localised
    """
    from mqslam.commands.localise import localise as do
    from mqslam.commands.localise import read_map_settings
    from mqslam.config import load_config

    settings = state_topics(load_config(config, partial(read_map_settings, map)), topic)
    with terminal.open_work() as work:
        result = do(map=map, config=settings, work=work, **given)

    terminal.print_results(result.summary, lambda: print_localised(terminal, result))


def print_localised(terminal: Terminal, result: LocaliseResult) -> None:
    """Prints the results of a localisation as text for people."""
    from rich.console import Console

    terminal.print_warnings(result.warnings)
    Console(soft_wrap=True).print(_tabulate(result.summary))
    echo(f"report: {result.report}")
    if result.evo_command:
        echo(f"compare with evo: {result.evo_command}")


def _tabulate(summary: dict[str, Any]) -> Table:
    """Returns the main results of a localisation as a table, given the content of summary.json."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=None, show_edge=False, pad_edge=False, show_header=False)
    table.add_column("")
    table.add_column("", justify="right")
    for status, number in summary["scans"].items():
        table.add_row(f"scans {status}", str(number))
    sigma = summary["median_sigma"]
    table.add_row(
        "median sigma relative to the map, along and across", f"{sigma['along_m']:.3f} m, {sigma['across_m']:.3f} m"
    )
    table.add_row("median sigma of the heading", f"{math.degrees(sigma['yaw_rad']):.3f} deg")
    table.add_row("matched points", f"{summary['matched']:.1%}")
    if summary["evaluation"]:
        table.add_row("ATE after alignment, all scans", f"{summary['evaluation']['ate_rmse_m']:.3f} m")
    dataset, total = summary["dataset"], summary["runtime_s"]["total"]
    pace = describe_pace(dataset["duration_s"], total)
    table.caption = Text(f"{dataset['scans']} scans, {dataset['duration_s']:.1f} s; computed in {total:.1f} s, {pace}")
    table.caption_justify = "left"
    return table
