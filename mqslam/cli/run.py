"""`mqslam run`: estimates the trajectory and the map of a recording, and writes a report."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from mqslam.cli.options import choose_exit_code, command, option
from mqslam.cli.terminal import Terminal, echo, format_verdict

if TYPE_CHECKING:
    from rich.table import Table

    from mqslam.commands.result import RunResult
    from mqslam.config import Config
    from mqslam.execution.runner import Watch

_VIEWER = "viewer"
_LIVE = option(
    str | None,
    None,
    "Show the map as it grows in Rerun's viewer, or record it in a file; this needs the extra `view`.",
    metavar="viewer|FILE.rrd",
)


@command(
    "data out frontend config changes odometry imu gnss extrinsics frame format range_resolution topic start_s end_s jobs "
    "cluster strict live tolerance fail_on resume force as_json quiet verbose",
    {"live": _LIVE},
)
def run(
    terminal: Terminal,
    *,
    config: Config,
    live: str | None,
    fail_on: Literal["warn", "fail"] | None,
    force: bool,
    **given: Any,
) -> None:
    """Estimate the trajectory and the map of a recording, and report how good the map is.

    A front end measures the motion between successive scans, a pose graph joins these measurements with loop closures and
    odometry, and the map is rendered along the optimised trajectory.

    Example: mqslam run drive --out result
    """
    from mqslam.commands.run import run as do

    with open_watch(live, force=force) as watch, terminal.open_work(watch) as work:
        result = do(config=config, force=force, work=work, **given)
    terminal.print_results(result.summary, lambda: print_run(terminal, result))
    if fail_on is not None:
        raise typer.Exit(choose_exit_code(result.verdict, fail_on))


def print_run(terminal: Terminal, result: RunResult) -> None:
    """Prints the results of a run as text for people."""
    from rich.console import Console

    from mqslam.core.wording import list_sensor_notes

    terminal.print_warnings(result.warnings)
    terminal.print_notes(list_sensor_notes(result.summary))
    Console(soft_wrap=True).print(tabulate_summary(result.summary))
    echo(f"report: {result.report}")
    if result.evo_command:
        echo(f"compare with evo: {result.evo_command}")


@contextmanager
def open_watch(live: str | None, *, force: bool) -> Iterator[Watch | None]:
    """Yields a function that shows the scans of a run one by one while the run goes on; yields None without --live.

    Args:
        live: the value of --live, which is `viewer` or the path of an .rrd file; None without the option.
        force: whether an existing file is replaced.

    Raises:
        ConfigError: the value of --live is neither `viewer` nor an .rrd file.
        OutputError: the file exists already, or cannot be written.
        ViewerError: Rerun is not installed, or there is no display for its viewer.
    """
    from mqslam.errors import ConfigError, OutputError

    if live is None:
        yield None
        return
    if live != _VIEWER and Path(live).suffix != ".rrd":
        raise ConfigError(f"--live {live}: give viewer, or a file that ends in .rrd")
    if live != _VIEWER and Path(live).exists() and not force:
        raise OutputError(f"{live}: exists already; choose another --live or give --force to replace it")
    from mqslam.viewer.rerun_log import record, stream

    with stream() if live == _VIEWER else record(Path(live)) as log:
        yield log.watch


def tabulate_summary(summary: dict[str, Any]) -> Table:
    """Returns a table of psi and errors against ground truth before and after optimisation, with the verdict below."""
    from rich.table import Table
    from rich.text import Text

    from mqslam.core.wording import describe_last_pose, describe_left_out
    from mqslam.evaluation import NO_DRIFT

    table = Table(title=None, show_edge=False, pad_edge=False)
    table.add_column("")
    table.add_column(summary["before"], justify="right")
    table.add_column("optimised", justify="right")
    psi = summary["psi"]
    for key, label, form in (
        ("across_passes", "psi per point across passes", "{:z.4f}"),
        ("per_point", "psi per point", "{:z.4f}"),
        ("matched", "matched points", "{:.1%}"),
    ):
        if key == "across_passes" and psi[f"{key}_optimised"] is None:
            continue  # no place is passed twice
        table.add_row(label, _format(psi[f"{key}_odometry"], form), _format(psi[f"{key}_optimised"], form))
    before, after = summary["evaluation_odometry"], summary["evaluation"]
    if before and after:
        for key, label, unit in (
            ("ate_rmse_m", "ATE", "m"),
            ("drift_percent", "drift", "%"),
            ("drift_deg_per_100m", "drift", "deg/100 m"),
            ("rpe_v_rms", "speed error", "m/s"),
            ("rpe_w_rms", "yaw rate error", "rad/s"),
        ):
            if after[key] is not None:
                numbers = (_format(errors[key], "{:.4g}") for errors in (before, after))
                table.add_row(f"{label} [{unit}]".replace("[", r"\["), *numbers)
    unknown = [("drift", NO_DRIFT)] if after and after["drift_percent"] is None else []
    dataset, runtime = summary["dataset"], summary["runtime_s"]
    table.caption = Text(
        f"{dataset['revolutions']} scans{describe_left_out(dataset)}, "
        f"{dataset['duration_s']:.1f} s, {dataset['length_m']:.1f} m; "
        f"computed in {runtime['total']:.1f} s, {describe_pace(dataset['duration_s'], runtime['total'])}\n"
        + "\n".join(
            f"{name}: {text}"
            for name, text in [*unknown, *format_verdict(summary), ("last pose", describe_last_pose(summary["last_pose"]))]
        )
    )
    table.caption_justify = "left"
    return table


def describe_pace(driven_s: float, computed_s: float) -> str:
    """Describes how many times as fast as real time a run was; below 1, the run was slower than the drive.

    Args:
        driven_s: duration of the recording [s].
        computed_s: time that the run took [s].
    """
    ratio = driven_s / max(computed_s, 1e-9)
    return f"{ratio:{'.1f' if ratio >= 1.0 else '.2g'}} times as fast as real time"


def _format(value: float | None, form: str) -> str:
    """Returns a number in the format `form`, or a dash for None."""
    return "-" if value is None else form.format(value)
