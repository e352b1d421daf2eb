"""`mqslam audit`: how good a map is, where it is torn, and how sure that is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from mqslam.cli.options import CORES, Cluster, ConfigOption, Force, Format, Jobs, Json, Quiet, RangeResolution, Verbose

if TYPE_CHECKING:
    from mqslam.audit.sources import Source
    from mqslam.audit.verdict import VerdictStatus
    from mqslam.config import Config
    from mqslam.core.trajectory import Trajectory
    from mqslam.execution.engine import Engine
    from mqslam.execution.progress import Progress


def audit(
    data: Annotated[Path, typer.Argument(help="A radar or lidar recording, or a cloud with times (PLY, PCD, LAS, NPZ).")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results; must not exist yet.")],
    trajectory: Annotated[
        str | None,
        typer.Option(
            "--trajectory",
            "-t",
            help="A file (TUM, CSV, KITTI with --times, a bag); or odometry, ground_truth or recording: what DATA carries.",
        ),
    ] = None,
    times: Annotated[Path | None, typer.Option(help="Stamps of a KITTI trajectory, one per line.")] = None,
    topic: Annotated[str | None, typer.Option(help="Topic of the trajectory in a bag.")] = None,
    z_range: Annotated[
        str | None, typer.Option(metavar="LOW,HIGH", help=r"Part of a cloud's heights to use \[m]; all by default.")
    ] = None,
    fail_on: Annotated[
        Literal["warn", "fail"] | None,
        typer.Option(help="Exit with 1 on this verdict or a worse one, and with 3 where the map could not be judged."),
    ] = None,
    config: ConfigOption = None,
    format: Format = None,
    range_resolution: RangeResolution = None,
    jobs: Jobs = CORES,
    cluster: Cluster = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Judge the map that a recording makes under a trajectory, without ground truth.

    Every window is compared with its own best: inflation is the correction that psi would make, in units of its
    covariance, a chi-square with 3 degrees of freedom where the map is right. Places passed twice are laid on each other.

    Example: mqslam audit drive --trajectory result/trajectory.tum --out audited --fail-on fail
    """
    from rich.console import Console

    from mqslam.audit.judge import audit as judged
    from mqslam.audit.sources import LIDAR_CONFIG, is_cloud, sweeps_of, sweeps_of_cloud
    from mqslam.cli.progress import print_notes, progress
    from mqslam.config import load_config
    from mqslam.execution.files import json_text
    from mqslam.execution.folders import check_free, whole_folder
    from mqslam.execution.workers import chosen
    from mqslam.formats.clouds import read_cloud
    from mqslam.psi.place import beam_of
    from mqslam.report.audit_page import write_audit_pages
    from mqslam.results.audit_results import summarise, write_audit
    from mqslam.results.files import add_warnings

    check_free(out, force=force, recording=data)
    console = Console(stderr=True, markup=False)
    given = _read(trajectory, times, topic)
    with chosen(cluster, jobs) as engine, progress(console, quiet or as_json) as show:
        if is_cloud(data):
            settings = load_config(config or LIDAR_CONFIG)
            cloud = read_cloud(data, _heights(z_range))
            sweeps = sweeps_of_cloud(cloud, given, beam_of(settings.estimator, 0.0))
            notes, kind = list(cloud.notes), data.suffix.lower()[1:]
        else:
            source, track, settings = _source(
                data, given, trajectory or "recording", config, format, range_resolution, engine, show
            )
            sweeps, notes = sweeps_of(source, track, beam_of(settings.estimator, settings.sensor.doppler_beta or 0.0))
            notes, kind = [*source.notes, *notes], source.format
        if not quiet:
            print_notes(console, notes)
        found = judged(sweeps, settings.audit, settings.estimator, settings.loops, settings.verdict, engine, show)
    dataset = {"format": kind, "path": str(data)}
    summary = summarise(found, sweeps, settings.audit, settings.verdict, dataset, trajectory or "recording", notes)
    with whole_folder(out) as folder:
        write_audit(folder, settings, summary)
        failures = write_audit_pages(folder, data.resolve().name, found, sweeps, settings, summary)
        add_warnings(folder / "audit.json", summary, failures)
    if as_json:
        typer.echo(json_text(summary))
    elif not quiet:
        typer.echo("\n".join(_lines(summary)))
        print_notes(console, summary["warnings"][len(notes) :])
        typer.echo(f"results in {out}; open {out / 'report.html'} in a browser")
    if fail_on is not None:
        raise typer.Exit(exit_code(found.status, fail_on))


def exit_code(status: VerdictStatus, fail_on: Literal["warn", "fail"]) -> int:
    """The exit code of --fail-on: a map that could not be judged is neither good nor bad, and has its own."""
    from mqslam.audit.verdict import VerdictStatus

    if status is VerdictStatus.NOT_JUDGED:
        return 3
    return int(status is VerdictStatus.FAIL or (status is VerdictStatus.WARN and fail_on == "warn"))


def _read(trajectory: str | None, times: Path | None, topic: str | None) -> Trajectory | None:
    """The trajectory of a file; None where it is the recording's own."""
    from mqslam.errors import ConfigError
    from mqslam.formats.trajectories import read_trajectory

    if trajectory in (None, "recording", "odometry", "ground_truth"):
        if times is not None or topic is not None:
            raise ConfigError("--times and --topic: belong to a trajectory from a file; give --trajectory FILE")
        return None
    assert trajectory is not None
    return read_trajectory(Path(trajectory), times, topic)


def _heights(text: str | None) -> tuple[float, float] | None:
    from mqslam.errors import ConfigError

    if text is None:
        return None
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(f"--z-range {text}: give two heights in metres, such as 0.5,2.0") from None
    return low, high


def _carried(path: Path, tracks: dict[str, Trajectory], name: str) -> Trajectory:
    """The trajectory of a name among those that a recording carries.

    Raises:
        ConfigError: it carries none of that name.
    """
    from mqslam.errors import ConfigError

    if name not in tracks:
        has = f"it carries {', '.join(tracks)}" if tracks else "it carries none"
        raise ConfigError(f"{path}: has no trajectory '{name}' ({has}); give --trajectory FILE")
    return tracks[name]


def _source(
    data: Path,
    given: Trajectory | None,
    name: str,
    config: str | None,
    format: str | None,
    range_resolution: float | None,
    engine: Engine,
    show: Progress,
) -> tuple[Source, Trajectory, Config]:
    """A radar or lidar recording as windows of returns, the trajectory given or carried by name, and the settings."""
    from mqslam.audit.sources import LIDAR_CONFIG, Source, lidar_source
    from mqslam.audit.sweeps import shared
    from mqslam.commands.opening import opened
    from mqslam.config import load_config, with_doppler_beta
    from mqslam.detection.stage import detect_all, scans_of, unread_warnings
    from mqslam.formats import lidars
    from mqslam.psi.tracking.doppler import doppler_beta_of

    if format is None and data.exists() and lidars.recognises(data):
        source = lidar_source(lidars.read_lidar(data))
        return source, given or _carried(data, source.tracks, name), load_config(config or LIDAR_CONFIG)
    settings = load_config(config)
    recording = opened(data, format, range_resolution, settings.sensor)
    carried = {"odometry": recording.odometry, "ground_truth": recording.ground_truth}
    tracks = {name: track for name, track in carried.items() if track is not None}
    track = given or _carried(data, tracks, name)
    shared(scans_of(recording), track)  # before the recording is read
    scans, detected = detect_all(recording, settings.detector, engine, show)
    notes = (*recording.notes, *recording.faults, *unread_warnings(detected.unread))
    source = Source(recording.path, recording.format, scans, tracks, notes)
    beta = doppler_beta_of(scans, settings.sensor, settings.tracker, settings.estimator)
    return source, track, with_doppler_beta(settings, beta)


def _lines(summary: dict[str, Any]) -> list[str]:
    """What a person asks for first."""
    windows, revisits, verdict = summary["windows"], summary["revisits"], summary["verdict"]
    inflation = "no windows"
    if windows["count"]:
        median = windows["inflation_median"]
        tolerance = f"{summary['threshold']:.3g} and off by {summary['bend_m']:g} m"
        inflation = f"median {median:.3g}, 2.37 where a map is right; torn above {tolerance}"
    rows = [
        ("verdict", f"{verdict['status']}: {'; '.join(verdict['reasons'])}"),
        ("windows", f"{windows['torn']} of {windows['count']} torn"),
        ("inflation", inflation),
        ("revisits", f"{revisits['torn']} of {revisits['sure']} torn, {revisits['count'] - revisits['sure']} not sure"),
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
    return [f"{name:<14}{value}" for name, value in rows]
