"""Finds the poses of a recording in the map of an earlier run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from mqslam.auditing.sizes import WINDOW
from mqslam.backend.loops.recognition import DESCRIBED_WITH
from mqslam.backend.measuring import measure
from mqslam.commands.inputs import check_arguments, name_inputs
from mqslam.commands.result import LocaliseResult
from mqslam.commands.run import Job, open_job
from mqslam.commands.work import QUIET, Work
from mqslam.config import Config, ConfigSource, load_config, set_doppler_beta, set_values
from mqslam.core import frontend as frontends
from mqslam.core.frontend import Context
from mqslam.core.keyframes import KeyframeMap
from mqslam.core.recording import LidarRecording, Recording
from mqslam.core.scans import PeakCounts
from mqslam.core.velocity import Detected
from mqslam.core.wording import explain_rest
from mqslam.detection.stage import detect_all, warn_of_unread
from mqslam.errors import DataError, EstimationError, FewReturnsError, NotInMapError, Remedy, to_path
from mqslam.execution.folders import claim_folder, write_folder_aside
from mqslam.execution.runner import Runner
from mqslam.formats.maps.keyframe_folder import find_keyframes, read_keyframes
from mqslam.localisation.localise import Localised
from mqslam.localisation.localise import localise as find_in_map
from mqslam.psi.place import beam_of
from mqslam.report.localise_page import write_localise_page
from mqslam.results.files import add_warnings
from mqslam.results.localise_results import summarise, write_localised

_MAP_REMEDY = "give the folder of a result that `mqslam run` has written"


def localise(  # noqa: PLR0913 - these are the options of the command, each with its default
    data: Path | str,
    out: Path | str,
    *,
    map: Path | str,
    frontend: str = "psi",
    odometry: Path | str = "auto",
    imu: Path | str = "auto",
    extrinsics: Sequence[float] | str = "auto",
    config: ConfigSource = None,
    format: str | None = None,
    range_resolution: float | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    strict: bool = False,
    force: bool = False,
    work: Work = QUIET,
) -> LocaliseResult:
    """Finds the poses of a recording in the map of an earlier run, without a starting guess, and writes them.

    Args:
        data: path of the recording.
        out: folder for the results; it must not exist yet.
        map: folder of the earlier result, of which the folder keyframes/ is read; the recording of that run is not needed.
        frontend: name of the front end that measures motions between scans, or path of a Python file with a front end.
        odometry: `auto` (the recording's own, if it has one), `none`, or the path of a file.
        imu: `auto` (the recording's own gyroscope, if it has one), `none`, or the path of a file.
        extrinsics: where the radar sits on the vehicle: `auto` (what the recording states, if it does), `none`, or
            metres forward, metres to the left and degrees to the left, as numbers or as a text X,Y,YAW.
        config: a `Config`, a dict of the settings that differ, the path of a YAML file, or the name of a shipped
            configuration; None takes the settings that the map was made with.
        format: layout of the recording, such as `oxford` or `rosbag`; None guesses it from the path.
        range_resolution: length of a range bin [m], if the recording states none or a wrong one.
        start_s: scans that begin before this time are left out [s since the recording's start]; None leaves out none.
        end_s: scans that begin at this time or later are left out [s since the recording's start]; None leaves out none.
        strict: whether a fault of the recording, such as a polar scan that cannot be read, is an error instead of a warning.
        force: whether a result that exists at `out` is replaced.
        work: the engine that does the computations, and the functions that get progress and notes.

    Returns:
        The result that was written to `out`.

    Raises:
        NotInMapError: no place of the map was recognised in the recording.
        MqslamError: the localisation is impossible; nothing is written then.

    Example:
        >>> localised = mqslam.localise("second_drive", "localised", map="result")  # doctest: +SKIP
        >>> print(localised.read_trajectory().poses[0], localised.summary["share_on_map"])  # doctest: +SKIP
    """
    (data, out), map = check_arguments(data, out, work), to_path(map, "map")
    with claim_folder(out, force=force, sources=[data]):
        made = _open_map(map)
        settings = load_config(config, partial(read_map_settings, map))
        unit_m = made.keyframes.unit_m
        if settings.sensor.doppler_beta is None:
            settings = set_doppler_beta(settings, made.keyframes.recordings[-1].doppler_beta)
        inputs = name_inputs(odometry, imu, "none", extrinsics)
        span = start_s, end_s
        job = open_job(data, settings, frontend, inputs, format, range_resolution, strict=strict, span=span, unit_m=unit_m)
        _check_sensor(job.recording, map, unit_m)
        for note in job.recording.notes:
            work.tell(note)
        runner = Runner(work.engine, work.progress)
        with runner.time_stage("total"):
            localised, unread = _find(job, made, runner)
        warnings = [*job.warnings, *warn_of_unread(unread), *runner.warnings]
        summary = summarise(localised, job.recording, map, made, frontend, runner.runtime_s, warnings)
        with write_folder_aside(out) as folder:
            write_localised(folder, localised, settings, made.keyframes.georeference, summary, job.recording)
            failures = write_localise_page(folder, localised, made, settings, summary)
            add_warnings(folder / "summary.json", summary, failures)
        return LocaliseResult(out, summary)


def _open_map(path: Path) -> KeyframeMap:
    """Reads the map of keyframes in a result, and checks that its places can be recognised.

    Raises:
        DataError: there is no map, the map is damaged or holds no places, or a version of mqslam with other settings for
            recognising places has written it.
    """
    made = read_keyframes(path)
    if not len(made.keyframes) or not len(made.places.keyframes):
        raise DataError(path, "holds a map without any place that could be recognised", _MAP_REMEDY)
    if made.places.made_with.keys() != DESCRIBED_WITH.keys():
        raise DataError(path, "describes its places by settings that this version does not know", _MAP_REMEDY)
    return made


def read_map_settings(map: Path) -> Config:
    """Returns the settings that a map was made with; default settings if no config.yaml lies beside its keyframes.

    Topics are left out, since they belong to the bag of the map and not to another recording.

    Raises:
        ConfigError: config.yaml holds a mistake.
    """
    folder = find_keyframes(map)
    beside = None if folder is None else folder.parent / "config.yaml"
    settings = load_config(beside if beside is not None and beside.is_file() else None)
    return set_values(settings, "sensor", radar_topic=None, odometry_topic=None, truth_topic=None)


def _check_sensor(recording: Recording, map: Path, unit_m: float | None) -> None:
    """Raises DataError unless recording and map are of the same kind of sensor, radar or lidar.

    Args:
        recording: the recording.
        map: the folder of the map.
        unit_m: unit of length of a lidar's map [m]; None for a radar's map.
    """
    if isinstance(recording, LidarRecording) == (unit_m is not None):
        return
    own, other = ("lidar", "radar") if unit_m is None else ("radar", "lidar")
    problem = f"is a {own}'s recording, but {map} is not the map of a {own}, or an earlier version has made it"
    raise DataError(recording.path, problem, f"give the result of a run of a {own}'s recording, or a {other}'s recording")


def _find(job: Job, made: KeyframeMap, runner: Runner) -> tuple[Localised, dict[int, DataError]]:
    """Localises the recording of a job in the map `made`; also returns the errors of unreadable scans by the scans' numbers.

    Raises:
        DataError: most scans cannot be read, or one cannot be read and the job is strict.
        NotInMapError: no place of the map was recognised in the recording.
        EstimationError: no motion can be estimated from the recording.
    """
    recording, settings = job.recording, job.settings
    beta, unit_m = settings.sensor.doppler_beta or 0.0, made.keyframes.unit_m or 1.0
    context = Context.of(recording, settings, job.odometry, job.sensors, doppler_beta=beta).scale(1.0 / unit_m)
    estimator = context.config.estimator
    beam = beam_of(estimator, beta)
    frontends.create(job.frontend, context)  # raises, before the recording is read, if the front end lacks an input
    detected = Detected([], {}, 0.0, 0.0, PeakCounts())
    if isinstance(recording, LidarRecording):
        scans = recording.scans.scale_ranges(1.0 / unit_m)
    else:
        scans, detected = detect_all(recording, settings.detector, runner, strict=job.strict, with_velocities=True)
    runner.runtime_s |= {"read": detected.read_s, "detect": detected.detect_s}
    try:
        with runner.time_stage("windows"):
            motions = measure(job.frontend, scans, replace(context, velocities=detected.velocities), beam, runner)
    except FewReturnsError as error:
        raise EstimationError(f"{error}: {detected.counts.remedy}") from error
    try:
        localised = find_in_map(scans, motions, made.scale(1.0 / unit_m), estimator, beam, runner).scale_lengths(unit_m)
    except NotInMapError as error:
        assumed = f"the length of a range bin, {recording.range_resolution:g} m, is assumed: {Remedy.GIVE_RANGE_RESOLUTION}"
        hints = [assumed] if recording.is_resolution_assumed else []
        hints += explain_rest(len(recording), recording.left_out, WINDOW)
        raise NotInMapError(f"{recording.path}: {error.message}", *error.remedies, *hints) from error
    return localised, detected.unread
