"""Runs several front ends on the same returns with the same back end, and judges their maps."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from mqslam.commands.inputs import (
    check_arguments,
    choose_gyroscope,
    choose_odometry,
    name_choice,
    open_radar_or_lidar,
)
from mqslam.commands.lidar_inputs import prepare_lidar
from mqslam.commands.result import CompareResult
from mqslam.commands.work import QUIET, Work
from mqslam.comparison.comparison import compare_rows
from mqslam.comparison.judgement import take_common_scans
from mqslam.comparison.rows import Row, make_given_row, run_front_ends, split_row
from mqslam.config import Config, ConfigSource, load_config, set_doppler_beta, set_tolerance, set_values
from mqslam.core import frontend as known_frontends
from mqslam.core.frontend import Context
from mqslam.core.recording import LidarRecording, Recording
from mqslam.core.sensors import NO_SENSORS, Inputs, Sensors
from mqslam.core.trajectory import Trajectory
from mqslam.detection.stage import detect_all, make_scans, warn_of_unread
from mqslam.errors import ConfigError, Remedy, require_type, to_path
from mqslam.execution.checkpoint import hash_run, keep_checkpoint
from mqslam.execution.folders import claim_folder, write_folder_aside
from mqslam.execution.runner import Runner
from mqslam.formats.sensors.reading import Reading
from mqslam.formats.trajectories import read_with_notes
from mqslam.psi.doppler import choose_doppler
from mqslam.report.compare_page import write_compare_page
from mqslam.results.compare_results import summarise, tabulate, write_compare
from mqslam.results.files import add_warnings

FRONT_ENDS = ("psi", "kiss_icp", "open3d_icp", "odometry")
_KISS = "kiss_icp"


def compare(  # noqa: PLR0913 - these are the options of a comparison, each with its default
    data: Path | str,
    out: Path | str,
    *,
    frontends: str | Sequence[str] = FRONT_ENDS,
    trajectories: Mapping[str, Trajectory | Path | str | tuple[Path, Path]] | None = None,
    odometry_only: bool = False,
    kiss_config: Path | str | None = None,
    odometry: Path | str = "auto",
    imu: Path | str = "auto",
    tolerance: float | None = None,
    config: ConfigSource = None,
    format: str | None = None,
    range_resolution: float | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    resume: bool = False,
    force: bool = False,
    work: Work = QUIET,
) -> CompareResult:
    """Runs several front ends on the same returns with the same back end, and judges the maps that result.

    Args:
        data: path of the recording.
        out: folder for the results; it must not exist yet.
        frontends: names or Python files of front ends, each once, as a list or as a text separated by commas; `+gyro` after
            a name adds the gyroscope to the pose graph of that front end.
        trajectories: trajectories to compare with, by the names of their rows; each is a `Trajectory`, the path of a file,
            or the two paths of a KITTI trajectory's poses and times.
        odometry_only: whether the front ends' motions are only chained, without pose graph and loops; `+gyro` is then an
            error.
        kiss_config: YAML file with KISS-ICP's own settings; None takes the file that `config` names, if it names one.
        odometry: `auto` (the recording's own, if it has one), `none`, or the path of a file. With a radar's recording, only
            the front end `odometry` uses it; with a lidar's recording, every front end and pose graph does, as in a run.
        imu: `auto` (the recording's own gyroscope), `none`, or the path of a file; only front ends with `+gyro` use it.
        tolerance: how far two passes of a good map may be apart [m]; all other tolerances of the verdict change in
            proportion. None takes the tolerances of the settings.
        config: a `Config`, a dict of the settings that differ, such as `{"detector": {"threshold": 60}}`, the path of a YAML
            file, or the name of a shipped configuration; None takes the defaults.
        format: layout of the recording, such as `oxford` or `rosbag`; None guesses it from the path.
        range_resolution: length of a range bin [m], if the recording states none or a wrong one.
        start_s: scans that begin before this time are left out [s since the recording's start]; None leaves out none.
        end_s: scans that begin at this time or later are left out [s since the recording's start]; None leaves out none.
        resume: whether an unfinished comparison at `out` is continued.
        force: whether a result that exists at `out` is replaced.
        work: the engine that does the computations, and the functions that get progress and notes.

    Returns:
        The result that was written to `out`.

    Raises:
        MqslamError: the comparison is impossible; at most an unfinished part stays at `out`, which `resume` continues.

    Example:
        >>> compared = mqslam.compare("drive", "compared", frontends=["psi", "kiss_icp"])  # doctest: +SKIP
        >>> print(compared.table)  # doctest: +SKIP
    """
    data, out = check_arguments(data, out, work)
    odometry, imu = name_choice(odometry, "odometry"), name_choice(imu, "imu")
    if isinstance(frontends, str):
        frontends = [name.strip() for name in frontends.split(",") if name.strip()]
    require_type(frontends, Sequence, "frontends", "a list of names, or a text of names separated by commas")
    settings = set_tolerance(_set_kiss_config(load_config(config), kiss_config), tolerance)
    _check_names(frontends, odometry_only=odometry_only)
    require_type(trajectories, Mapping | None, "trajectories", "a dict of trajectories by the names of their rows")
    given, understood = _make_given_rows(trajectories or {}, frontends)
    with claim_folder(out, force=force, resume=resume, sources=[data]):
        recording = open_radar_or_lidar(data, format, range_resolution, settings, span=(start_s, end_s))
        chosen = _choose_gyroscope(recording, imu, frontends)
        if isinstance(recording, LidarRecording):
            recording, track, settings, unused = prepare_lidar(recording, settings, Inputs(odometry, imu))
        else:
            track, unused = choose_odometry(recording, odometry, recording.mount)
        sensors, warnings = chosen.sensor, [*unused, *chosen.faults]
        recording = replace(recording, notes=(*recording.notes, *understood, *chosen.notes))
        for note in recording.notes:
            work.tell(note)
        if kiss_config is not None and _KISS in frontends:  # a wrong file stops the comparison here, not only its row later
            known_frontends.create(_KISS, Context.of(recording, settings))
        is_lidar = isinstance(recording, LidarRecording)
        known = recording.scans if isinstance(recording, LidarRecording) else make_scans(recording)
        take_common_scans(given, known, recording.left_out)  # raises, before scans are read, if the rows share too few scans
        key = hash_run(recording, settings, f"compare {','.join(frontends)} {odometry_only}", track, sensors)
        with keep_checkpoint(out, key, resume=resume) as checkpoint:
            runner = Runner(work.engine, work.progress, checkpoint)
            scans, beta = known, 0.0
            if not is_lidar:
                scans, detected = detect_all(recording, settings.detector, runner)
                warnings += [*recording.faults, *warn_of_unread(detected.unread)]
                beta = choose_doppler(scans, settings, work.engine).beta
            settings = set_doppler_beta(settings, beta)
            alone = Context.of(recording, settings, doppler_beta=beta)
            contexts = {
                name: replace(
                    alone,
                    odometry=track if is_lidar or name == "odometry" else None,
                    sensors=sensors if split_row(name)[1] else NO_SENSORS,
                )
                for name in frontends
            }
            rows = run_front_ends(contexts, scans, work.engine, work.progress, back_end=not odometry_only) + given
            comparison = compare_rows(recording, rows, scans, settings, warnings, work.engine, work.progress)
            summary = summarise(comparison)
            table, marked = tabulate(summary)
            with write_folder_aside(out) as folder:
                write_compare(folder, comparison, summary)
                failed = write_compare_page(folder, comparison, summary, table, marked)
                add_warnings(folder / "compare.json", summary, failed)
        return CompareResult(out, summary, table, marked)


def _set_kiss_config(settings: Config, kiss_config: Path | str | None) -> Config:
    """Returns the settings with the path of KISS-ICP's own YAML file in them, if this path is given.

    Raises:
        ConfigError: the file does not exist.
    """
    if kiss_config is None:
        return settings
    path = to_path(kiss_config, "kiss_config")
    if not path.is_file():
        raise ConfigError(f"{kiss_config}: does not exist; give KISS-ICP's own YAML file")
    return set_values(settings, "kiss_icp", config_file=path)


def _choose_gyroscope(recording: Recording, imu: str, frontends: Sequence[str]) -> Reading[Sensors]:
    """Returns the gyroscope for the front ends with `+gyro`; no sensors if there is no such front end.

    Raises:
        ConfigError: a front end needs the gyroscope, but there is none, or the gyroscope is switched off.
        DataError: the file cannot be read, or shares no time with the recording.
    """
    joined = [name for name in frontends if split_row(name)[1]]
    if not joined:
        return Reading(NO_SENSORS)
    if imu == "none":
        raise ConfigError(f"front end {joined[0]}: the gyroscope is switched off", Remedy.SWITCH_GYROSCOPE_ON)
    reading = choose_gyroscope(recording, imu)
    if reading.sensor is None:
        why = "; ".join(reading.faults) or "the recording has no gyroscope"
        raise ConfigError(f"front end {joined[0]}: {why}", Remedy.NAME_GYROSCOPE)
    return Reading(Sensors(reading.sensor), reading.notes, reading.faults)


def _check_names(frontends: Sequence[str], *, odometry_only: bool) -> None:
    """Raises ConfigError unless every front end exists, is named once, and has a pose graph if a gyroscope is added."""
    if not frontends or len(set(frontends)) < len(frontends):
        raise ConfigError(
            f"front ends '{','.join(map(str, frontends))}': give at least one name and each name once, such as psi,kiss_icp"
        )
    for name in frontends:
        require_type(name, str, "each of frontends", "the name of a front end as a text")
        front_end, has_gyroscope = split_row(name)
        if "+" in front_end:
            bare = front_end.split("+")[0]
            raise ConfigError(f"front end {name}: +gyro is the only sensor that can be added; name {bare} or {bare}+gyro")
        known_frontends.require(front_end)
        if Path(front_end).name != front_end:
            folder, file = Path(front_end).parent, Path(front_end).name
            remedy = f"give {file}, and compare in the folder {folder}"
            raise ConfigError(f"front end {name}: its file must be named without a folder; {remedy}")
        if has_gyroscope and odometry_only:
            raise ConfigError(
                f"front end {name}: +gyro needs a pose graph, and this comparison makes none; name {front_end} alone"
            )


def _make_given_rows(
    trajectories: Mapping[str, Trajectory | Path | str | tuple[Path, Path]], frontends: Sequence[str]
) -> tuple[list[Row], list[str]]:
    """Returns a row for each given trajectory, and notes for the user on how the trajectories' files were read.

    Raises:
        ConfigError: a name cannot be the name of a folder, or is already the name of a front end's row.
        DataError: a file is not a trajectory.
    """
    rows, understood = [], []
    for name, given in trajectories.items():
        if not re.fullmatch(r"[\w.-]*\w", name):
            raise ConfigError(f"trajectory '{name}': cannot be the name of a folder; choose a name of letters and digits")
        if name in frontends:
            raise ConfigError(f"trajectory '{name}': there is a row {name} already; choose another name")
        if isinstance(given, Trajectory):
            track = given
        else:
            track, notes = (
                read_with_notes(Path(given[0]), Path(given[1]))
                if isinstance(given, tuple)
                else read_with_notes(to_path(given, f"trajectory '{name}'"))
            )
            understood += [f"{name}: {note}" for note in notes]
        rows.append(make_given_row(name, track))
    return rows, understood
