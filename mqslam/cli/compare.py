"""`mqslam compare`: several front ends on one recording, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mqslam.cli.options import (
    CORES,
    Cluster,
    ConfigOption,
    Data,
    Force,
    Format,
    Jobs,
    Json,
    Odometry,
    Quiet,
    RangeResolution,
    Verbose,
)

if TYPE_CHECKING:
    from mqslam.compare.rows import Row
    from mqslam.config import Config


def compare(
    data: Data,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results; must not exist yet.")],
    frontends: Annotated[
        str, typer.Option(help="Front ends, separated by commas; those of other packages too.")
    ] = "psi,kiss_icp,open3d_icp,odometry",
    trajectory: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=FILE", help="A trajectory to compare with: TUM, CSV, a bag, or KITTI as POSES,TIMES."),
    ] = None,
    odometry_only: Annotated[bool, typer.Option("--odometry-only", help="Chain the motions, no graph, no loops.")] = False,
    kiss_config: Annotated[Path | None, typer.Option("--kiss-config", help="KISS-ICP's own YAML file.")] = None,
    config: ConfigOption = None,
    odometry: Odometry = "auto",
    format: Format = None,
    range_resolution: RangeResolution = None,
    jobs: Jobs = CORES,
    cluster: Cluster = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue an unfinished comparison: read nothing twice.")] = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Run several front ends on the same returns with the same back end, and judge the maps they make.

    Odometry serves the row of that name only. Without ground truth the rows are judged by psi of their maps, by inflation
    (2.37 is the median of a right trajectory) and by how far passes of one place lie apart.

    Example: mqslam compare drive --out compared --frontends psi,kiss_icp
    """
    from rich.console import Console

    from mqslam.cli.progress import print_notes, progress
    from mqslam.commands.opening import choose_odometry, opened
    from mqslam.compare.comparison import Comparison
    from mqslam.compare.judgement import agreement, enough_in_common, judge_rows, places, stations
    from mqslam.compare.rows import front_end_rows
    from mqslam.config import load_config, with_doppler_beta
    from mqslam.core.frontend import Context, load
    from mqslam.detection.stage import detect_all, scans_of, unread_warnings
    from mqslam.errors import EstimationError
    from mqslam.execution.checkpoint import run_key, unfinished
    from mqslam.execution.files import json_text
    from mqslam.execution.folders import check_free, whole_folder
    from mqslam.execution.workers import chosen
    from mqslam.psi.place import beam_of
    from mqslam.psi.tracking.doppler import doppler_beta_of
    from mqslam.report.compare_page import write_compare_pages
    from mqslam.report.compare_report import report_comparison
    from mqslam.results.compare_results import summarise, tabulate, write_compare
    from mqslam.results.files import add_warnings

    settings = _settings(load_config(config), kiss_config)
    names = _names(frontends)
    given = _given(trajectory or [], names)
    check_free(out, force=force, resume=resume, recording=data)
    recording = opened(data, format, range_resolution, settings.sensor)
    track, notes = choose_odometry(recording, odometry)
    console = Console(stderr=True, markup=False)
    if not quiet:
        print_notes(console, recording.notes)
    revolution_s, start_us = recording.revolution_s, recording.start_us
    if kiss_config is not None and "kiss_icp" in names:  # a file that KISS-ICP refuses is a mistake, not a row that fails
        load("kiss_icp")(Context(settings, revolution_s, start_us, None))
    # before the recording is read
    enough_in_common(given, scans_of(recording), settings.audit.window)
    key = run_key(recording, settings, f"compare {','.join(names)} {odometry_only}", track)
    with (
        chosen(cluster, jobs) as engine,
        unfinished(out, key, resume=resume) as checkpoint,
        progress(console, quiet or as_json) as show,
    ):
        scans, detected = detect_all(recording, settings.detector, engine, show, checkpoint)
        notes += [*recording.faults, *unread_warnings(detected.unread)]
        beta = doppler_beta_of(scans, settings.sensor, settings.tracker, settings.estimator)
        settings = with_doppler_beta(settings, beta)
        beam = beam_of(settings.estimator, beta)
        contexts = {
            name: Context(settings, revolution_s, start_us, track if name == "odometry" else None, beta) for name in names
        }
        rows = front_end_rows(contexts, scans, engine, show, back_end=not odometry_only)
        rows += given
        ran = [row for row in rows if row.trajectory is not None]
        if not ran:
            raise EstimationError("; ".join(f"{row.name}: {row.failure}" for row in rows))
        tracks = [row.trajectory for row in ran if row.trajectory is not None]
        common = enough_in_common(ran, scans, settings.audit.window)
        if len(common) < len(scans):
            notes.append(f"{len(common)} of {len(scans)} revolutions are in every trajectory: judged on those")
        where = places(common, tracks, settings.audit.window)
        along = stations(common, settings.audit.window)
        shown = [*where, *along]
        rows, judged = judge_rows(rows, common, recording.ground_truth, shown, settings, beam, engine, show)
        pairs = agreement(ran)
        notes += [f"{row.name}: {warning}" for row in rows for warning in row.warnings]
        comparison = Comparison(
            recording=recording,
            settings=settings,
            doppler_beta=beta,
            rows=tuple(rows),
            judged=judged,
            compared=len(common),
            places=tuple(where),
            stations=tuple(along),
            agreement=tuple(pairs),
            warnings=(*_failures(rows), *notes),
        )
        summary = summarise(comparison)
        report = report_comparison(comparison, summary, tabulate(summary))
        with whole_folder(out) as folder:
            write_compare(folder, comparison, summary)
            add_warnings(folder / "compare.json", summary, write_compare_pages(folder, report))
    if as_json:
        typer.echo(json_text(summary))
    elif not quiet:
        _print(tabulate(summary))
        print_notes(console, summary["warnings"][len(_failures(rows)) :])
        typer.echo(f"results in {out}; open {out / 'report.html'} in a browser")


def _settings(settings: Config, kiss_config: Path | None) -> Config:
    from mqslam.errors import ConfigError

    if kiss_config is None:
        return settings
    if not kiss_config.is_file():
        raise ConfigError(f"{kiss_config}: does not exist; give KISS-ICP's own YAML file")
    kiss = settings.kiss_icp.model_copy(update={"config_file": kiss_config})
    return settings.model_copy(update={"kiss_icp": kiss})


def _names(frontends: str) -> list[str]:
    """Names of front ends that exist, each once.

    Raises:
        ConfigError: one that does not.
    """
    from mqslam.core import frontend
    from mqslam.errors import ConfigError

    names = [name.strip() for name in frontends.split(",") if name.strip()]
    if not names or len(set(names)) < len(names):
        raise ConfigError(f"--frontends {frontends}: give names, each once, such as psi,kiss_icp")
    for name in names:
        frontend.known(name)
    return names


def _given(trajectories: list[str], names: list[str]) -> list[Row]:
    """Rows of trajectories given as NAME=FILE.

    Raises:
        ConfigError: another form, or a name twice.
        DataError: a file that is no trajectory.
    """
    import re

    from mqslam.compare.rows import given_row
    from mqslam.errors import ConfigError
    from mqslam.formats.trajectories import read_trajectory

    rows: list[Row] = []
    for text in trajectories:
        name, _, file = text.partition("=")
        if not file or not re.fullmatch(r"[\w.-]*\w", name):
            raise ConfigError(f"--trajectory {text}: give NAME=FILE, NAME in letters and digits")
        if name in names or any(row.name == name for row in rows):
            raise ConfigError(f"--trajectory {text}: there is a row {name} already; choose another NAME")
        poses, _, times = file.partition(",")
        rows.append(given_row(name, read_trajectory(Path(poses), Path(times) if times else None)))
    return rows


def _failures(rows: list[Row]) -> list[str]:
    return [f"{row.name} could not run: {row.failure}" for row in rows if row.failure is not None]


def _print(cells: list[list[str]]) -> None:
    """The table turned on its side: a column per row of the comparison fits any terminal."""
    from rich.console import Console
    from rich.table import Table

    failed = [line for line in cells[1:] if line[1].startswith("could not run: ")]
    ran = [line for line in cells[1:] if line not in failed]
    shown = Table(show_edge=False, pad_edge=False)
    shown.add_column("")
    for line in ran:
        shown.add_column(line[0], justify="right")
    for k, head in enumerate(cells[0][1:], 1):
        shown.add_row(head.replace("[", r"\["), *(line[k] for line in ran))
    Console().print(shown)
    for line in failed:
        typer.echo(f"{line[0]} {line[1]}")
