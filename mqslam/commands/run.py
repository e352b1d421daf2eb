"""Makes the trajectory and the map of a recording, and writes them with a report to a folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mqslam.commands.inputs import (
    WHOLE,
    Span,
    check_arguments,
    check_frame,
    choose_odometry,
    choose_sensors,
    name_inputs,
    open_radar_or_lidar,
    place_truth,
)
from mqslam.commands.lidar_inputs import prepare_lidar
from mqslam.commands.result import RunResult
from mqslam.commands.work import QUIET, Work
from mqslam.config import Config, ConfigSource, load_config, set_tolerance
from mqslam.core import frontend as frontends
from mqslam.core.recording import LidarRecording, Recording
from mqslam.core.sensors import NO_SENSORS, RADAR, USUAL_INPUTS, Inputs, Sensors
from mqslam.core.trajectory import Trajectory
from mqslam.errors import Remedy, tolerate
from mqslam.execution.checkpoint import hash_run, keep_checkpoint
from mqslam.execution.files import to_json_values
from mqslam.execution.folders import claim_folder, write_folder_aside
from mqslam.execution.runner import Runner
from mqslam.formats.recordings.azimuths import stamps_in_us
from mqslam.formats.recordings.oxford import find_image_folder
from mqslam.formats.recordings.row_images import RowImageRecording
from mqslam.formats.trajectories import write_boreas_odometry
from mqslam.report.run_page import write_run_page
from mqslam.results.files import add_warnings
from mqslam.results.run_results import summarise, write_run
from mqslam.results.run_verdict import list_warnings
from mqslam.slam import Slam
from mqslam.solution import Run


def run(  # noqa: PLR0913 - these are the options of a run, each with its default
    data: Path | str,
    out: Path | str,
    *,
    frontend: str = "psi",
    odometry: Path | str = "auto",
    imu: Path | str = "auto",
    gnss: Path | str = "auto",
    extrinsics: Sequence[float] | str = "auto",
    frame: str = RADAR,
    tolerance: float | None = None,
    config: ConfigSource = None,
    format: str | None = None,
    range_resolution: float | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    strict: bool = False,
    resume: bool = False,
    force: bool = False,
    work: Work = QUIET,
) -> RunResult:
    """Estimates the trajectory and the map of a recording, and writes them with a report.

    Args:
        data: path of the recording.
        out: folder for the results; it must not exist yet.
        frontend: name of the front end, or path of a Python file with a front end.
        odometry: `auto` (the recording's own, if it has one), `none`, or the path of a file.
        imu: `auto` (the recording's own gyroscope, if it has one), `none`, or the path of a file.
        gnss: `auto` (the recording's own fixes, unless its ground truth was made from them), `none`, or the path of a file.
        extrinsics: where the radar sits on the vehicle: `auto` (what the recording states, if it does), `none`, or
            metres forward, metres to the left and degrees to the left, as numbers or as a text X,Y,YAW.
        frame: whose poses are written, `radar` or `vehicle`; all poses are relative to the first one. For `vehicle`, the
            pose of the radar on the vehicle must be known.
        tolerance: how far two passes of a good map may be apart [m]; all other tolerances of the verdict change in
            proportion. None takes the tolerances of the settings.
        config: a `Config`, a dict of the settings that differ, such as `{"detector": {"threshold": 60}}`, the path of a YAML
            file, or the name of a shipped configuration; None takes the defaults.
        format: layout of the recording, such as `oxford` or `rosbag`; None guesses it from the path.
        range_resolution: length of a range bin [m], if the recording states none or a wrong one.
        start_s: scans that begin before this time are left out [s since the recording's start]; None leaves out none.
        end_s: scans that begin at this time or later are left out [s since the recording's start]; None leaves out none.
        strict: whether a fault of the recording, such as a polar scan that cannot be read, is an error instead of a warning.
        resume: whether an unfinished run at `out` is continued.
        force: whether a result that exists at `out` is replaced.
        work: the engine that does the computations, and the functions that get progress and notes.

    Returns:
        The result that was written to `out`.

    Raises:
        MqslamError: the run is impossible; at most an unfinished part stays at `out`, which `resume` continues.

    Example:
        >>> result = mqslam.run("drive", "result")  # doctest: +SKIP
        >>> print(result.verdict, result.report)  # doctest: +SKIP
    """
    data, out = check_arguments(data, out, work)
    settings = set_tolerance(load_config(config), tolerance)
    inputs = name_inputs(odometry, imu, gnss, extrinsics, frame)
    with claim_folder(out, force=force, resume=resume, sources=[data]):
        job = open_job(data, settings, frontend, inputs, format, range_resolution, strict=strict, span=(start_s, end_s))
        for note in job.recording.notes:
            work.tell(note)
        return RunResult(out, execute(job, out, work, resume=resume))


@dataclass(frozen=True)
class Job:
    """A run that is ready to begin.

    Args:
        recording: the recording, with notes on how its files and the files of the sensors were read.
        odometry: the odometry that the run uses, or None.
        settings: all settings.
        frontend: name of the front end, or path of a Python file with a front end.
        strict: whether a polar scan that cannot be read is an error.
        warnings: sentences on odometry, sensors and settings that are not used, and on a lidar's poses used as odometry.
        sensors: the other sensors that the run uses.
        frame: whose poses the run writes: `radar` or `vehicle`.
    """

    recording: Recording
    odometry: Trajectory | None
    settings: Config
    frontend: str
    strict: bool
    warnings: tuple[str, ...]
    sensors: Sensors = NO_SENSORS
    frame: str = RADAR

    @property
    def key(self) -> str:
        """A text that identifies the run: it changes with recording, settings, front end, odometry, sensors and frame."""
        key = hash_run(self.recording, self.settings, self.frontend, self.odometry, self.sensors)
        return key if self.frame == RADAR else f"{key} {self.frame}"

    def choose_frame(self, run: Run) -> tuple[Run, Recording]:
        """Returns a finished run and its recording, both with poses in the frame of the job, of the radar or the vehicle."""
        mount, truth = self.sensors.mount, self.recording.ground_truth
        if self.frame == RADAR or mount is None:
            return run, self.recording
        carried = None if truth is None else mount.carry_to_vehicle(truth)
        return run.carry_to_vehicle(mount), replace(self.recording, ground_truth=carried)


def open_job(  # noqa: PLR0913 - these are the options of a run, and the unit
    data: Path,
    settings: Config,
    frontend: str = "psi",
    inputs: Inputs = USUAL_INPUTS,
    format: str | None = None,
    range_resolution: float | None = None,
    *,
    strict: bool = False,
    span: Span = WHOLE,
    unit_m: float | None = None,
) -> Job:
    """Opens a recording, and chooses the odometry and the sensors that a run of it uses.

    Args:
        data: path of the recording.
        settings: all settings.
        frontend: name of the front end, or path of a Python file with a front end.
        inputs: the user's choice of odometry, sensors, extrinsics and frame.
        format: layout of the recording; None guesses it from the path.
        range_resolution: length of a range bin [m]; None takes the value in the settings or the recording.
        strict: whether a fault of the recording is an error instead of a warning.
        span: begin and end of the part that is used [s since the recording's start]; None takes the recording's own.
        unit_m: unit of length of the computations on a lidar's scans [m]; None measures it from the scans.

    Raises:
        ConfigError: the format, the front end or the frame is unknown, a lidar's recording is given what only radars use,
            the range resolution cannot be the length of a range bin, the extrinsics are not a pose, or the frame is
            `vehicle` and the pose of the radar on the vehicle is unknown.
        DataError: the recording, the odometry or a sensor's file cannot be used.
    """
    frontends.require(frontend)
    recording = open_radar_or_lidar(data, format, range_resolution, settings, strict=strict, span=span)
    if isinstance(recording, LidarRecording):
        prepared, track, settings, unused = prepare_lidar(recording, settings, inputs, unit_m)
        return Job(prepared, track, settings, frontend, False, tuple(unused))
    chosen = choose_sensors(recording, inputs)
    sensors = chosen.sensor
    track, unused = choose_odometry(recording, inputs.odometry, sensors.mount)
    check_frame(inputs.frame, sensors.mount, data)
    recording = replace(place_truth(recording, sensors.mount), notes=(*recording.notes, *chosen.notes))
    return Job(recording, track, settings, frontend, strict, (*unused, *chosen.faults), sensors, inputs.frame)


def execute(job: Job, out: Path, work: Work, *, resume: bool, how: str = Remedy.RESUME) -> dict[str, Any]:
    """Makes the trajectory and the map of a run, and writes its results.

    Args:
        job: the run.
        out: folder of the results.
        work: the engine that does the computations, and the functions that get progress and notes.
        resume: whether an unfinished run at `out` is continued.
        how: advice on how to continue an interrupted run, for the message of an error.

    Returns:
        The content of summary.json.

    Raises:
        MqslamError: the run is impossible; at most an unfinished part stays at `out`, which `resume` continues.
    """
    with keep_checkpoint(out, job.key, resume=resume, how=how) as checkpoint:
        runner = Runner(work.engine, work.progress, checkpoint, work.watch)
        slam = Slam(job.settings, job.frontend, runner, strict=job.strict)
        result = slam.run(job.recording, job.odometry, job.sensors)
        warnings = [*list_warnings(result, job.recording), *job.warnings]
        shown, recording = job.choose_frame(result)
        summary: dict[str, Any] = to_json_values({**summarise(shown, recording), "warnings": warnings, "run_key": job.key})
        with write_folder_aside(out) as folder:
            write_run(folder, shown, summary, recording)
            failures = write_run_page(folder, shown, recording, summary)
            with tolerate("the file for the leaderboard of Boreas", failures):
                _write_for_leaderboard(folder, job.recording, result.optimised)
            add_warnings(folder / "summary.json", summary, failures)
    return summary


def _write_for_leaderboard(folder: Path, recording: Recording, trajectory: Trajectory) -> None:
    """Writes the odometry of a Boreas sequence in the leaderboard's form, named after the sequence; ignores other layouts.

    Raises:
        OutputError: the file cannot be written.
    """
    if recording.format != "boreas" or not isinstance(recording, RowImageRecording):
        return
    sequence = find_image_folder(recording.path).resolve().parent.name
    write_boreas_odometry(folder / f"{sequence}.txt", trajectory, stamps_in_us(recording.names))
