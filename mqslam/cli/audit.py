"""`mqslam audit`: judges how good a map is and where it is torn, and says how sure that is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from mqslam.cli.terminal.echo import echo
from mqslam.cli.terminal.fail_on import FailOn, choose_exit_code
from mqslam.cli.terminal.options import (
    CORES,
    Cluster,
    ConfigOption,
    End,
    Force,
    Format,
    Jobs,
    Json,
    Quiet,
    RangeResolution,
    Start,
    Verbose,
)


def audit(
    data: Annotated[
        Path,
        typer.Argument(metavar="DATA", help="A radar or lidar recording, or a point cloud with times (PLY, PCD, LAS, NPZ)."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results; it must not exist yet.")],
    trajectory: Annotated[
        str | None,
        typer.Option(
            "--trajectory",
            "-t",
            help=r"A file (TUM, a CSV whose header names t or timestamp, in a unit such as t\[us], x, y and yaw, KITTI with "
            "--times, a bag), the folder of a result of mqslam, KISS-SLAM, CFEAR or "
            "TBV, or one that DATA has: odometry, ground_truth or recording, which is a lidar log's own and the default.",
        ),
    ] = None,
    times: Annotated[Path | None, typer.Option(help="File with the stamps of a KITTI trajectory, one per line.")] = None,
    topic: Annotated[str | None, typer.Option(help="Topic of the trajectory, if it is in a bag.")] = None,
    frame: Annotated[
        str | None, typer.Option(help="Frame whose pose /tf gives, if the trajectory is in a bag's /tf.")
    ] = None,
    time_offset: Annotated[
        float,
        typer.Option(
            metavar="SECONDS", help="Added to the stamps of the trajectory's file, if its clock is not that of DATA."
        ),
    ] = 0.0,
    extrinsics: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,YAW",
            help=r"Pose of the sensor in the frame of which the trajectory's file is, such as base_link: \[m] forward, \[m] "
            r"to the left, \[degrees] to the left.",
        ),
    ] = None,
    z_range: Annotated[
        str | None,
        typer.Option(metavar="LOW,HIGH", help=r"Lowest and highest points of a cloud to use \[m]; all by default."),
    ] = None,
    covariances: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Covariances of the trajectory's poses, as a run's covariances.csv, which revisits are held against; "
            "those beside a run's own trajectory.tum are found by themselves.",
        ),
    ] = None,
    false_alarms: Annotated[
        float | None,
        typer.Option(
            metavar="RATE",
            help="Probability, below 0.5, with which steps, spans, pooled corrections, shaking and revisits held against "
            "covariances may together call a good recording's map bad; 0.01 by default.",
        ),
    ] = None,
    fail_on: FailOn = None,
    mend: Annotated[
        bool,
        typer.Option(
            "--mend", help="Write the trajectory with the corrections put in as mended.tum, and judge that one, too."
        ),
    ] = False,
    config: ConfigOption = None,
    format: Format = None,
    range_resolution: RangeResolution = None,
    start: Start = None,
    end: End = None,
    jobs: Jobs = CORES,
    cluster: Cluster = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Judge the map that a recording makes under a trajectory, without ground truth.

    Each window, several consecutive scans, is compared with its own best map. Its inflation is the correction that psi would
    make, in units of that correction's covariance: a chi-square with 3 degrees of freedom where the map is right. Where the
    sensor passes a place twice, the two passes are laid on each other.

    Example: mqslam audit drive --trajectory result/trajectory.tum --out audited --fail-on fail
    """
    from rich.console import Console

    from mqslam.cli.terminal.console import set_up_work
    from mqslam.cli.terminal.remedies import name_options
    from mqslam.commands.audit import audit as do
    from mqslam.commands.inputs.extrinsics import parse_extrinsics
    from mqslam.errors import ConfigError
    from mqslam.execution.files import to_json

    of_file = times, topic, frame, extrinsics
    if trajectory is None and (any(option is not None for option in of_file) or time_offset != 0.0):
        options = "--times, --topic, --frame, --time-offset and --extrinsics"
        raise ConfigError(f"{options} belong to a trajectory from a file; give --trajectory FILE")
    if trajectory is None and covariances is not None:
        raise ConfigError("--covariances belongs to a trajectory from a file; give --trajectory FILE")
    heights = _parse_heights(z_range)
    mount = None if extrinsics is None else parse_extrinsics(extrinsics)
    console = Console(stderr=True, markup=False)
    with set_up_work(console, cluster, jobs, quiet=quiet, silent=quiet or as_json) as work:
        result = do(
            data,
            out,
            trajectory=trajectory or "recording",
            times=times,
            topic=topic,
            frame=frame,
            time_offset_s=time_offset,
            extrinsics=mount,
            heights=heights,
            covariances=covariances,
            false_alarms=false_alarms,
            config=config,
            format=format,
            range_resolution=range_resolution,
            start_s=start,
            end_s=end,
            mend=mend,
            force=force,
            work=work,
        )
    if as_json:
        typer.echo(to_json(result.summary))
    elif not quiet:
        echo(name_options("\n".join(_format_lines(result.summary))))
        echo(f"results in {out}; open {result.report} in a browser")
    if fail_on is not None:
        raise typer.Exit(choose_exit_code(result.verdict, fail_on))


def _parse_heights(text: str | None) -> tuple[float, float] | None:
    """Returns the lowest and the highest height [m] of a text LOW,HIGH.

    Raises:
        ConfigError: the text has another form.
    """
    from mqslam.errors import ConfigError

    if text is None:
        return None
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(f"--z-range {text}: give two heights in metres, such as 0.5,2.0") from None
    return low, high


def _count_undecided(count: int) -> str:
    """Returns how many windows were left undecided; nothing where none was."""
    return f", {count} undecided" if count else ""


def _format_revisits(revisits: dict[str, Any] | None) -> str:
    """Returns what the revisits show in words; a cloud without a trajectory knows none."""
    if revisits is None:
        return "unknown without a trajectory"
    return f"{revisits['torn']} of {revisits['sure']} torn, {revisits['count'] - revisits['sure']} not sure"


def _format_lines(summary: dict[str, Any]) -> list[str]:
    """Returns the lines that a person reads first: the verdict, and what is torn worst."""
    from mqslam.cli.terminal.console import format_verdict
    from mqslam.core.wording import list_judged

    windows, revisits = summary["windows"], summary["revisits"]
    inflation = "no windows"
    if windows["count"]:
        median = windows["inflation_median"]
        tolerance = f"{summary['threshold']:.3g} and off by {summary['bend_m']:g} m"
        inflation = f"median {median:.3g} (2.37 by chance alone); torn above {tolerance}"
    rows = [
        *format_verdict(summary),
        ("windows", f"{windows['torn']} of {windows['count']} torn{_count_undecided(windows['undecided'])}"),
        ("inflation", inflation),
        ("revisits", _format_revisits(revisits)),
    ]
    worst = sorted((w for w in summary["per_window"] if w["torn"]), key=lambda w: -w["size_m"])[:5]
    rows += [
        ("torn window", f"{w['t0']:.1f} to {w['t1']:.1f} s at ({w['x']:.1f}, {w['y']:.1f}) m: bent by {w['size_m']:.2f} m")
        for w in worst
    ]
    torn = [r for r in summary["per_revisit"] if r["torn"]]
    rows += [
        (
            "torn revisit",
            f"{r['t_later']:.1f} s on {r['t_earlier']:.1f} s at ({r['x']:.1f}, {r['y']:.1f}) m: "
            f"off by {r['dx']:.2f} m, {r['dy']:.2f} m, {57.29578 * r['dyaw']:.2f} deg",
        )
        for r in sorted(torn, key=lambda r: -(r["dx"] ** 2 + r["dy"] ** 2))[:5]
    ]
    if "mended" in summary:
        mended = summary["mended"]
        windows, verdict = mended["windows"], mended["verdict"]
        rows += [
            ("mended", mended["sentence"]),
            ("verdict then", f"{verdict['status']}: {'; '.join(list_judged(verdict['reasons'], summary['not_judged']))}"),
            ("windows then", f"{windows['torn']} of {windows['count']} torn{_count_undecided(windows['undecided'])}"),
            ("revisits then", _format_revisits(mended["revisits"])),
        ]
    return [f"{name:<14}{value}" for name, value in rows]
